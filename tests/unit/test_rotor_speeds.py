"""Rotor speeds from commands: the map, lag and factors of made flights are found again; bad commands are refused."""

import json

import numpy as np
import pytest
from airframes import LAYOUT, to_draw
from commanded_flights import DELAY, EXPONENT, GAINS, MASS, OPERATING, SLOPE, TAU, flight

from quasi.airframe import read_airframe
from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.identification.geometry import contradicting_places
from quasi.identification.rotor_speeds import (
    actuators_of,
    factors_of,
    identify_rotor_speeds,
    places_of,
    rotor_speeds_of,
)
from quasi.terms.rotor_map import FORMS, delayed, lagged, shape, speeds_of, steady_speeds

MASSES = {"a": MASS, "b": MASS}


@pytest.fixture(scope="module")
def flights():
    return {"a": flight(1, 15.0, hidden=0.004), "b": flight(2, 15.0, hidden=0.004)}


@pytest.fixture(scope="module")
def found(flights):
    return identify_rotor_speeds(flights, to_draw(), MASSES)


def test_map_lag_delay_and_voltage_exponent_are_found(found):
    drive, _ = found
    assert drive["form"] in ("linear", "quadratic")
    lag, late = drive["time constant"]["value"], drive["delay"]["value"]
    assert lag == pytest.approx(TAU, rel=0.15)
    # commands between two samples of the log are unknown, so that delay and lag trade off within half a sample
    assert late == pytest.approx(DELAY, abs=0.006)
    assert lag + late == pytest.approx(TAU + DELAY, rel=0.1)
    # speed over speed at the operating point, against the true map
    commands = np.linspace(0.3, 0.7, 9)[:, None].repeat(4, axis=1)
    for volts in (14.5, 15.5):
        speeds = steady_speeds(drive, commands, np.full(9, volts))
        true = GAINS * (volts / 15.0) ** EXPONENT * (1.0 + SLOPE * (commands / OPERATING - 1.0))
        ratio = speeds / true
        np.testing.assert_allclose(ratio / ratio.mean(), 1.0, atol=0.03)
    assert drive["trims"].keys() == {"a", "b"}


def test_factors_hold_in_closed_loop(found):
    drive, _ = found
    assert drive["factors"]["Mx"]["value"] == pytest.approx(1.0, abs=0.1)
    assert drive["factors"]["My"]["value"] == pytest.approx(1.0, abs=0.1)
    assert drive["factors"]["Mz"]["value"] == pytest.approx(0.02, rel=0.1)
    assert contradicting_places(places_of(drive), to_draw(), 1.0) == []


def test_scale_is_relative_until_something_fixes_it(flights, found):
    drive, notes = found
    assert drive["scale"]["relative"] and any("relative" in n for n in notes)
    hover = {"hover speed": 1234.0}
    known, notes = identify_rotor_speeds(flights, to_draw(), MASSES, hover)
    assert not known["scale"]["relative"] and not any("relative" in n for n in notes)
    assert known["scale"]["thrust factor"]["value"] == pytest.approx(MASS * GRAVITY / 4 / 1234.0**2)
    # the map alone changes its unit
    ratio = np.array(known["speeds"]["value"]) / drive["speeds"]["value"]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)
    simple = factors_of(known, to_draw())
    arm = np.abs(to_draw().hubs[0, 1])
    assert simple["kappaMx"]["value"] / simple["kappaFz"]["value"] == pytest.approx(arm, rel=0.1)
    assert actuators_of(known)["time constants"]["value"] == [known["time constant"]["value"]] * 4


def test_commands_logged_late_shorten_the_delay(found):
    flights = {"a": flight(1, 15.0, late=0.010)}
    drive, _ = identify_rotor_speeds(flights, to_draw(), MASSES)
    assert drive["delay"]["value"] == pytest.approx(found[0]["delay"]["value"] - 0.010, abs=0.004)


def test_rotors_numbered_otherwise_are_named(flights):
    swapped = {**LAYOUT, "rotor config": {"front left": 1, "front right": 3, "aft right": 4, "aft left": 2}}
    plain = {"rotor radius": 0.04, "b": 0.08, "moment of inertia": "[1e-3, 0, 0; 0, 1e-3, 0; 0, 0, 2e-3]"}
    wrong = read_airframe({**swapped, **plain, "rotor1 rotation direction": "CW"}, "wrong.json")
    drive, _ = identify_rotor_speeds({"a": flights["a"]}, wrong, MASSES)
    said = contradicting_places(places_of(drive), wrong, 1.0)
    assert any("rotor 1 pushes" in s for s in said)


def test_without_voltage_the_map_has_none_and_says_so(flights):
    table = flights["a"].drop(columns="battery_voltage")
    drive, notes = identify_rotor_speeds({"a": table}, to_draw(), MASSES)
    assert drive["voltage exponent"] is None and drive["reference voltage"] is None
    assert any("no battery voltage" in n for n in notes)


def test_flights_that_are_too_short_are_refused(flights):
    with pytest.raises(DataError, match=r"hold 3\.\d s"):
        identify_rotor_speeds({"a": flights["a"].iloc[:400]}, to_draw(), MASSES)


def test_both_scales_at_once_are_refused(flights):
    both = {"hover speed": 1000, "thrust factor": "1e-7"}
    with pytest.raises(DataError, match="hover speed and thrust factor"):
        rotor_speeds_of(flights, to_draw(), MASSES, both)


def test_a_drive_is_plain_data(found):
    drive = json.loads(json.dumps(found[0]))
    commands = np.full((50, 4), 0.5)
    speeds = speeds_of(drive, commands, np.full(50, 15.0), 0.01)
    np.testing.assert_allclose(speeds, steady_speeds(drive, commands, np.full(50, 15.0)), rtol=1e-12)


@pytest.mark.parametrize("form", FORMS)
def test_every_form_is_one_at_its_operating_point_and_never_falls(form):
    parameters = FORMS[form].start
    share = np.linspace(0.0, 1.6, 60)[:, None]
    values = shape(form, share, 1.0, 0.7, parameters)
    assert shape(form, np.ones((1, 1)), 1.0, 0.7, parameters)[0, 0] == pytest.approx(1.0)
    assert np.all(np.diff(values[:, 0]) >= 0.0)


def test_lag_and_delay_of_a_sine():
    dt, rate, tau, delay = 0.005, 2.0 * np.pi * 2.0, 0.05, 0.013
    t = np.arange(2000) * dt
    got = lagged(np.sin(rate * t)[:, None], dt, tau, delay)[400:, 0]
    size, phase = 1 / np.hypot(1.0, rate * tau), np.arctan(rate * tau)
    np.testing.assert_allclose(got, (size * np.sin(rate * (t - delay) - phase))[400:], atol=2e-3)
    early = delayed(np.sin(rate * t)[:, None], dt, -0.0075)[10:-10, 0]
    np.testing.assert_allclose(early, np.sin(rate * (t + 0.0075))[10:-10], atol=1e-5)
