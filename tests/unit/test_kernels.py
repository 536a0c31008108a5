"""Kernels that are compiled ahead of the jobs are those that the jobs call, with the same types of arguments."""

import sys

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from rigid_body import measure, move, quadrotor

from quasi.filtering import kernels as filtering
from quasi.filtering.flight import filter_flight
from quasi.identification import kernels as identification
from quasi.identification.actuators import rotor_lag
from quasi.identification.lag_fit import follow
from quasi.importing import kernels as importing
from quasi.importing.flight import import_flight
from quasi_synthesis import kernels as synthesis
from quasi_synthesis.campaign import make_flight, read_campaign, write_flight


def compiled(room):
    return {
        (name, key): set(thing.signatures)
        for name, module in list(sys.modules.items())
        if name.startswith(f"{room}.")
        for key, thing in vars(module).items()
        if isinstance(thing, Dispatcher)
    }


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flown")
    synthesis.compile_kernels()
    before = compiled("quasi_synthesis")
    campaign = read_campaign({"flights": [{"key": "short"}], "duration": 20.0})
    files = [folder / name for name in ("short.bbl", "short.csv", "short.parquet")]
    write_flight(make_flight(campaign, campaign.flights[0]), *files)
    return files, before


def test_a_made_flight_compiles_nothing_else(flown):
    _, before = flown
    assert len(before["quasi_synthesis.flight", "fly"]) == 1
    assert compiled("quasi_synthesis") == before


def test_an_imported_flight_compiles_nothing_else(flown):
    (onboard, capture, _), _ = flown
    importing.compile_kernels()
    before = compiled("quasi.importing")
    about = {
        "flight": "short",
        "flight controller": "betaflight",
        "quadrotor": "MadeBeetle",
        "rigid body": "MadeBeetle",
    }
    import_flight({**about, "onboard": str(onboard), "capture": str(capture)}, {}, {})
    names = {name for (_, name), signatures in before.items() if signatures}
    assert names >= {"decode_frames", "_filter", "_steps", "_chain"}
    assert compiled("quasi.importing") == before


def test_a_filtered_flight_compiles_nothing_else():
    filtering.compile_kernels()
    before = compiled("quasi.filtering")
    filter_flight(*measure(move(seconds=18.0, seed=4)), quadrotor(), {"rotor notch harmonics": 1})
    assert len(before["quasi.filtering.ekf", "_forward"]) == len(before["quasi.filtering.smoother", "_backward"]) == 1
    assert compiled("quasi.filtering") == before


def test_a_rotor_lag_compiles_nothing_else():
    identification.compile_kernels()
    before = set(follow.signatures)
    t = np.arange(2000) / 250.0
    command = 800.0 + 100.0 * np.sin(3.0 * t)
    rotor_lag(t, command, np.append(command[5:], command[:5]), np.ones(2000, bool), commands_speed=True)
    assert len(before) == 1
    assert set(follow.signatures) == before
