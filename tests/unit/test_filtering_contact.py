"""Rows in which a flight touches the ground are not valid: the floor pushes there."""

import numpy as np

from quasi.attitude import GRAVITY
from quasi.filtering.bias import LIFTED
from quasi.filtering.contact import TOUCHING, find_contacts

LEGS = 0.04  # m, height of the centre of gravity where the vehicle stands
CALM = np.tile([0.0, 0.0, -GRAVITY], (1200, 1))
DT = 0.01  # s
IN_FLIGHT = np.repeat([False, True, False], [100, 1000, 100])


def heights(hop=1.0):
    """Standing, a climb to `hop` m and back, on the ground with turning rotors, standing."""
    path = [np.zeros(100), np.linspace(0, hop, 400), np.linspace(hop, 0, 400), np.zeros(200), np.zeros(100)]
    return LEGS + np.concatenate(path)


def test_a_landing_with_turning_rotors_touches_and_the_flight_does_not():
    height = heights()
    touched = find_contacts(height, CALM, IN_FLIGHT, DT)
    assert touched[900:1100].all()
    assert not touched[height > LEGS + TOUCHING].any()
    assert not touched[~IN_FLIGHT].any()  # standing is no contact in flight


def test_another_height_of_the_landing_place_counts_for_the_second_half_alone():
    height = heights()
    height[600:] = np.maximum(height[600:], LEGS + 0.5)  # lands on a table
    touched = find_contacts(height, CALM, IN_FLIGHT, DT)
    assert touched[900:1100].all()
    assert touched[100] and not touched[250:400].any()


def test_without_a_place_where_it_stands_nothing_touches():
    assert not find_contacts(heights(), CALM, np.ones(1200, bool), DT).any()


def test_a_bounce_touches_where_the_vehicle_tilts_or_springs():
    height, felt = heights(), CALM.copy()
    height[900:1100] += 0.75 * LIFTED
    felt[905:910] *= 2.0
    felt[500:505] *= 2.0  # a manoeuvre
    touched = find_contacts(height, felt, IN_FLIGHT, DT)
    assert (
        touched[905:910].all()
        and not touched[885:890].any()
        and not touched[910:1100].any()
        and not touched[500:505].any()
    )


def test_what_a_vehicle_flies_below_is_a_stand():
    height = heights()
    height[500:600] = LEGS - 0.5
    assert not find_contacts(height, CALM, IN_FLIGHT, DT)[:590].any()
