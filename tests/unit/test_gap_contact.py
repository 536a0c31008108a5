"""Rows in which a flight touches the ground are left out of the comparison of forces."""

import numpy as np
import pandas as pd
import pytest

from quasi.gap.flights.gathering import TOUCHING, touching

RATE = 100.0  # Hz
LEGS = 0.04  # m, height of the centre of gravity where the vehicle stands


def flight(ends, hop=1.0):
    """Standing for 1 s, a climb to `hop` m and back, 2 s on the ground with turning rotors, standing for 1 s."""
    path = [np.zeros(100), np.linspace(0, hop, 400), np.linspace(hop, 0, 400), np.zeros(200), np.zeros(100)]
    height = LEGS + np.concatenate(path)
    flying = np.ones(len(height))
    flying[:100] = flying[-100:] = 0.0
    if not ends:
        flying[:] = 1.0
    return pd.DataFrame({"t": np.arange(len(height)) / RATE, "z": -height, "in_flight": flying}), height


def test_a_landing_with_turning_rotors_touches_and_the_flight_does_not():
    table, height = flight(ends=True)
    memory = 10
    touched = touching(table, memory)
    assert touched[900 - 1 : 1100].all()
    high = height > LEGS + TOUCHING + memory / RATE * 0.25  # the climb rate is 0.25 m/s
    assert not touched[high].any()


def test_another_height_of_the_landing_place_counts_for_the_second_half_alone():
    table, _ = flight(ends=True)
    table.loc[900:, "z"] = -(LEGS + 0.5)  # on a table
    touched = touching(table, 0)
    assert touched[900:1100].all()
    assert touched[100] and not touched[250:400].any()


@pytest.mark.parametrize("missing", ["z", "in_flight", "rest"])
def test_without_a_place_where_it_stands_nothing_is_left_out(missing):
    table, _ = flight(ends=missing != "rest")
    table = table.drop(columns=[missing] if missing in table else [])
    assert not touching(table, 10).any()
