"""IMU or markers: either planted in made flights, through raw logs; the weighing against a search over values."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_model import simple_model
from made_recordings import planted
from test_gap_together import BASE, flight

from quasi.gap.catalogue import catalogue
from quasi.gap.flights.level import Level
from quasi.gap.levels import corrections, imu_or_markers
from quasi.gap.levels.imu_or_markers import ACROSS, DECIDED, TAKEN_UP, felt, settle, weigh
from quasi.gap.levels.sensors import identify as sensor_level
from quasi_synthesis.nuisance import nominal
from quasi_synthesis.vehicle import hover_factors

PLANTED = {"imu_lever_arm": {"y": -0.007}, "marker_offset": {"x": -0.009, "z": 0.012}}
STD = np.full(3, 4e-4)


def test_arm_and_markers_are_told_apart_from_raw_logs_and_gone_when_these_are_imported_anew(tmp_path):
    process, airframe = planted(tmp_path, PLANTED, 770, 18.0)
    flights = process(None)
    level = sensor_level.examine(flights, {})
    assert [e["id"] for e in level.effects] == ["imu_lever_arm"]  # the comparison of sensors alone cannot know
    factors = hover_factors(nominal(120.0, 0.0).vehicle.physics)
    model = simple_model(airframe, factors["thrust"], factors["torque"], Mx={"p": -1e-4}, My={"q": -1e-4})
    settle(level, flights, model, catalogue(), 0.01)
    found = {e["id"]: e["parameters"] for e in level.effects}
    assert set(found) == set(PLANTED)
    for cause, parameters in found.items():
        for axis, p in parameters.items():
            assert abs(p["value"] - PLANTED[cause].get(axis, 0.0)) < min(4.0 * p["std"], 1.5e-3), (cause, axis, p)
    whole = corrections.document([level])
    assert whole["compared"]["capture"]["marker offset"][0] == found["marker_offset"]["x"]["value"]
    assert not sensor_level.examine(process(corrections.for_flight(whole, True)), {}).effects


def test_what_pulls_at_the_vehicle_is_not_taken_for_an_arm(tmp_path):
    true = np.array([0.0, -0.007, 0.0])
    process, airframe = planted(tmp_path, {"imu_lever_arm": {"y": -0.007}, "tether": {"k": 1.5}}, 780, 18.0)
    flights = process(None)
    factors = hover_factors(nominal(120.0, 0.0).vehicle.physics)
    model = simple_model(airframe, factors["thrust"], factors["torque"], Mx={"p": -1e-4}, My={"q": -1e-4})
    (drawn_off, *_), (arm, std, own) = (felt(flights, model, "always", some, 0.01) for some in ({}, catalogue()))
    assert np.linalg.norm(arm - true) < 0.4 * np.linalg.norm(drawn_off - true)
    assert np.all(np.abs(arm - true) < 3.0 * std)
    # terms of differences between the rotors make up what an arm along z feels, and leave little of it
    turning = {"Fx": {"U_q": -1e-8, "q": 1e-3}, "Fy": {"U_p": 1e-8, "p": 1e-3}}
    held = simple_model(airframe, factors["thrust"], factors["torque"], Mx={"p": -1e-4}, My={"q": -1e-4}, **turning)
    left = felt(flights, held, "always", {}, 0.01)[2]
    assert np.all(own > 0.5) and left[2] < 0.3 and np.all(left[:2] > 0.5)


def test_what_the_terms_of_the_model_hold_of_an_arm_says_little_of_it():
    between, forces, std = np.array([0.012, -0.006, -0.018]), np.array([0.012, -0.006, -0.010]), np.full(3, 1e-3)
    believed = weigh(between, STD, forces, std)
    assert abs(believed.markers[2]) > 3.0 * believed.markers_std[2]
    points = weigh(between, STD, forces, std, np.array([0.7, 0.7, 0.05]))
    assert points.is_decided
    np.testing.assert_array_equal(points.markers, 0.0)
    np.testing.assert_allclose(points.imu, between, atol=1e-3)


@pytest.mark.parametrize("arm", [(0.01, 0.0, 0.0), (0.0, -0.004, 0.02)])
def test_the_weighing_names_what_leaves_the_smaller_squared_error(arm):
    arm = np.array(arm)
    for imu, markers in ((arm, 0 * arm), (0 * arm, -arm)):
        points = weigh(imu - markers, STD, imu, STD)
        assert points.is_decided
        np.testing.assert_allclose(points.imu, imu, atol=1e-12)
        np.testing.assert_allclose(points.markers, markers, atol=1e-12)


def test_how_much_worse_one_explanation_is_agrees_with_a_search_over_its_value():
    between, forces = np.array([0.0080, 0.0050, 0.0]), np.array([0.0074, 0.0003, 0.0001])
    between_std, std = np.array([9e-4, 5e-4, 5e-4]), np.array([5e-4, 6e-4, 5e-4])
    values = np.linspace(-0.02, 0.02, 40001)
    for k in range(3):
        sharp = np.hypot(np.hypot(std[k], TAKEN_UP * between[k]), ACROSS * np.linalg.norm(between))
        both = ((between[k] - values) / between_std[k]) ** 2
        imu = (both + ((forces[k] - values) / sharp) ** 2).min()
        markers = (both + (forces[k] / sharp) ** 2).min()
        assert weigh(between, between_std, forces, std).apart[k] == pytest.approx(markers - imu, abs=1e-3)


def test_a_component_that_no_explanation_fits_follows_the_others():
    """Forces that a weak battery pulls aside by 6 mm in z made markers of an IMU that sits 9 mm behind."""
    between, forces = np.array([-0.0096, -0.0003, 0.0096]), np.array([-0.0093, 0.0, 0.0036])
    points = weigh(between, np.full(3, 5e-4), forces, np.array([3.8e-4, 2.7e-4, 7e-4]))
    assert points.is_decided and (points.apart[0] > DECIDED) and abs(points.apart[2]) < DECIDED
    np.testing.assert_array_equal(points.markers, 0.0)


def test_both_points_are_moved_where_neither_alone_explains_what_is_seen():
    points = weigh(np.array([0.02, 0, 0]), STD, np.array([0.01, 0, 0]), STD)
    np.testing.assert_allclose(points.imu, [0.01, 0, 0])
    np.testing.assert_allclose(points.markers, [-0.01, 0, 0])


def test_a_little_beside_a_long_arm_is_not_told_as_the_other_point():
    # a twenty-fifth of the arm is what a model's terms may make up on another axis
    points = weigh(np.array([0.015, 0, 0]), STD, np.array([0.014, 0, 0.0015]), STD)
    assert points.is_decided
    np.testing.assert_allclose(points.markers, 0.0)
    assert abs(points.imu[2]) < 5e-4
    alone = weigh(np.array([0.0, 0, 0.002]), STD, np.array([0.0, 0, 0.002]), STD)
    assert alone.is_decided and alone.imu[2] == pytest.approx(0.002)


def test_forces_that_cannot_tell_leave_a_tie_with_both_ways_to_read_it(monkeypatch):
    arm = {n: {"value": v, "std": 5e-4, "unit": "m"} for n, v in zip("xyz", (0.01, 0.0, -0.02))}
    level = Level("sensors", effects=[{"id": "imu_lever_arm", "since": "always", "parameters": arm}])
    blunt = np.full(3, 0.01)
    monkeypatch.setattr(
        "quasi.gap.levels.imu_or_markers.felt", lambda *_: (np.array([0.004, 0.001, -0.008]), blunt, np.ones(3))
    )
    settle(level, [], None, {}, 0.01)
    assert not level.effects
    (tie,) = level.ties
    assert tie["ids"] == ["imu_lever_arm", "marker_offset"]
    assert tie["separability"] < DECIDED**0.5
    for axis in "xyz":
        assert tie["parameters"]["marker_offset"][axis]["value"] == -arm[axis]["value"]


def flown_with(monkeypatch, arm, beyond, compared):
    """Flights whose IMU is off by an arm (3,) m, that of the compared ones by an arm beyond it."""
    flights = {}
    for seed, flag in enumerate(compared):
        clean = flight(seed)
        flights[clean.key] = replace(clean, measured=clean.measured + sum(
            v * column for v, column in zip(arm + beyond * flag, imu_or_markers._columns(clean, None).values())
        ))  # fmt: skip
    monkeypatch.setattr(imu_or_markers, "_evidence", lambda flown, model: flights[flown.key])
    return [SimpleNamespace(key=key, compared=flag) for key, flag in zip(flights, compared)]


def test_an_arm_of_all_flights_is_no_part_of_the_one_that_changed(monkeypatch):
    always, changed = np.array([0.02, -0.01, 0.01]), np.array([0.0, 0.0, 0.008])
    flown = flown_with(monkeypatch, always, changed, [False, False, True, True])
    for since, true, others in (
        ("changed", changed, []), ("changed", changed, ["always"]), ("always", always, ["changed"]),
    ):  # fmt: skip
        arm, std, _ = felt(flown, BASE, since, {}, 0.01, others)
        assert np.all(np.abs(arm - true) < 4.0 * std), (since, others, arm, std)
        assert np.all(std < 4e-3)


@pytest.mark.parametrize("disturbed", [0.0, 0.02])
def test_what_disturbs_the_compared_flights_alone_is_no_arm_of_all_flights(monkeypatch, disturbed):
    arm, beyond = np.array([0.012, -0.006, 0.01]), disturbed * np.array([-1.0, 1.0, 0.0])
    flown = flown_with(monkeypatch, arm, beyond, [False, False, True, True])
    value, std, own = felt(flown, BASE, "always", {}, 0.01)
    points = weigh(arm, STD, value, std, own)
    assert np.all(np.abs(value - arm) < 4.0 * std)
    assert np.all(points.markers == 0.0) and (np.all(std < 4e-3) or disturbed)
