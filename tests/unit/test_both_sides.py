"""A change that errors of rotor speeds make is distinguished from one that the motion shows."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from test_unexplained import ground  # noqa: F401
from test_wrench_level import flight

from quasi.gap.catalogue import catalogue, whole_of
from quasi.gap.effect import vehicle_of
from quasi.gap.levels.forces.both_sides import within_errors
from quasi.model.model import Model

EFFECTS = catalogue()


@pytest.fixture
def vehicle(ground):  # noqa: F811
    return vehicle_of(Model(ground[1].document, "test"))


def asked(name, which, **more):
    return SimpleNamespace(effect=EFFECTS[name], test=SimpleNamespace(offer=SimpleNamespace(which=which)), **more)


def moving(ground, k, amplitude, errors, vehicle, own=None):  # noqa: F811
    """A flight with roll moments of a size, N m, that the model knows but for `errors`, N m, of both sides."""
    rng, plain = np.random.default_rng(k), flight(ground, k)
    n = len(plain)
    turning = np.zeros((n, 6))
    turning[:, 3] = amplitude * np.sin(5.0 * plain.t + k)
    predicted = plain.predicted + turning
    predicted[:, 3] += errors * rng.standard_normal(n)
    right = dataclasses.replace(plain, predicted=plain.predicted + turning)
    measured = right.predicted + (whole_of(EFFECTS["inertia"], right, vehicle, own) if own else 0.0)
    measured = measured + (plain.measured - plain.predicted)
    measured[:, 3] += 0.5 * errors * rng.standard_normal(n)
    return dataclasses.replace(plain, predicted=predicted, measured=measured)


def test_in_gentle_flight_errors_look_like_a_larger_inertia_on_one_side_only(ground, vehicle):  # noqa: F811
    brisk = [moving(ground, k, 0.02, 0.001, vehicle) for k in range(2)]
    gentle = [moving(ground, k, 0.001, 0.001, vehicle) for k in range(2, 4)]
    inertia = asked("inertia", (0,))
    assert within_errors([*brisk, *gentle], [False, False, True, True], inertia, (), vehicle)
    assert within_errors(gentle, [True, True], inertia, (), vehicle)


@pytest.mark.parametrize("share", [0.1, -0.1])
def test_another_inertia_shows_on_both_sides(ground, vehicle, share):  # noqa: F811
    own = {"Ixx": share * vehicle.inertia[0, 0]}
    brisk = [moving(ground, k, 0.02, 0.001, vehicle) for k in range(2)]
    heavier = [moving(ground, k, 0.02, 0.001, vehicle, own) for k in range(2, 4)]
    inertia = asked("inertia", (0,))
    assert not within_errors([*brisk, *heavier], [False, False, True, True], inertia, (), vehicle)
    there = asked("inertia", (0,), since="changed", value=own)
    assert within_errors([*brisk, *heavier], [False, False, True, True], inertia, [there], vehicle)


def test_of_causes_that_do_not_divide_the_wrench_nothing_is_asked(ground, vehicle):  # noqa: F811
    gentle = [moving(ground, k, 0.001, 0.001, vehicle) for k in range(2)]
    assert not within_errors(gentle, [True, True], asked("cg_offset", (0,)), (), vehicle)
