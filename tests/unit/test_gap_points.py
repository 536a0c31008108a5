"""IMU or markers: either planted in made flights, through raw logs; the weighing against a search over values."""

import numpy as np
import pytest
from made_model import part

from quasi.airframe import read_airframe
from quasi.filtering.flight import filter_flight
from quasi.gap import calibration, kinematic
from quasi.gap.level import Flown, Level
from quasi.gap.points import APART, TAKEN_UP, settle, weigh
from quasi.importing.flight import import_flight
from quasi.standalone.build import assemble
from quasi.standalone.model import Model
from quasi.synthesis.campaign import make_flight, quadrotor_configuration, read_campaign, write_flight
from quasi.synthesis.nuisance import nominal
from quasi.synthesis.vehicle import hover_factors

PLANTED = {"imu_lever_arm": {"y": -0.007}, "marker_offset": {"x": -0.009, "z": 0.012}}
STD = np.full(3, 4e-4)


def model_of(airframe):
    factors = hover_factors(nominal(120.0, 0.0).vehicle.physics)
    thrust, torque, arm = factors["thrust"], factors["torque"], abs(airframe.hubs[0, 0])
    terms = {
        "Fx": {"u": -0.15}, "Fy": {"v": -0.15}, "Fz": {"(w1^2 + w2^2 + w3^2 + w4^2)": -thrust, "w": -0.15},
        "Mx": {"U_p": thrust * arm, "p": -1e-4}, "My": {"U_q": thrust * arm, "q": -1e-4}, "Mz": {"U_r": -torque},
    }  # fmt: skip
    shared = {
        "gravity": "withGravity", "hover speed": {"value": 2110.0, "unit": "rad/s"}, "actuators": None,
        "simple model": {"kappaFz": {"value": thrust}, "kappaMz": {"value": -torque}},
        "training flights": ["a"], "notes": [],
    }  # fmt: skip
    return Model(assemble({a: part(a, t) for a, t in terms.items()}, shared, {"id": "m", "airframe": airframe}))


def test_arm_and_markers_are_told_apart_from_raw_logs_and_gone_when_these_are_imported_anew(tmp_path):
    sources = []
    for k, profile in enumerate(("mixed", "aggressive")):
        config = {"flights": [{"key": f"a{k}", "profile": profile, "seed": 770 + k, "effects": PLANTED}],
                  "duration": 20.0, "nuisance": 0.3}  # fmt: skip
        campaign = read_campaign(config, "test")
        made, quadrotor = make_flight(campaign, campaign.flights[0]), quadrotor_configuration(campaign)
        write_flight(made, tmp_path / f"{k}.bbl", tmp_path / f"{k}.csv", tmp_path / f"{k}.parquet")
        sources.append(
            {"flight": f"a{k}", "quadrotor": "MadeBeetle", "flight controller": "betaflight",
             "rigid body": "MadeBeetle", "onboard": str(tmp_path / f"{k}.bbl"), "capture": str(tmp_path / f"{k}.csv"),
             "log number": None}
        )  # fmt: skip
    airframe = read_airframe(quadrotor, "made")

    def flown(applied):
        flights = []
        for source in sources:
            imported, about = import_flight(source, quadrotor, {}, applied)
            filtered = filter_flight(imported, about, airframe, {})
            flights.append(
                Flown(source["flight"], True, imported, about, filtered.with_gravity, filtered.metadata, airframe)
            )
        return flights

    flights = flown(None)
    level = kinematic.examine(flights, {})
    assert [e["id"] for e in level.effects] == ["imu_lever_arm"]  # level K alone cannot know
    settle(level, flights, model_of(airframe))
    found = {e["id"]: e["parameters"] for e in level.effects}
    assert set(found) == set(PLANTED)
    for cause, parameters in found.items():
        for axis, p in parameters.items():
            assert abs(p["value"] - PLANTED[cause].get(axis, 0.0)) < min(4.0 * p["std"], 1.5e-3), (cause, axis, p)
    whole = calibration.document([level])
    assert whole["compared"]["capture"]["marker offset"][0] == found["marker_offset"]["x"]["value"]
    assert not kinematic.examine(flown(calibration.for_flight(whole, True)), {}).effects


@pytest.mark.parametrize("arm", [(0.01, 0.0, 0.0), (0.0, -0.004, 0.02)])
def test_the_weighing_names_what_leaves_the_smaller_squared_error(arm):
    arm = np.array(arm)
    for imu, markers in ((arm, 0 * arm), (0 * arm, -arm)):
        points = weigh(imu - markers, STD, imu, STD)
        assert points.told
        np.testing.assert_allclose(points.imu, imu, atol=1e-12)
        np.testing.assert_allclose(points.markers, markers, atol=1e-12)


def test_how_much_worse_one_explanation_is_agrees_with_a_search_over_its_value():
    between, forces = np.array([0.0080, 0.0050, 0.0]), np.array([0.0074, 0.0003, 0.0001])
    between_std, std = np.array([9e-4, 5e-4, 5e-4]), np.array([5e-4, 6e-4, 5e-4])
    values = np.linspace(-0.02, 0.02, 40001)
    for k in range(3):
        sharp = np.hypot(std[k], TAKEN_UP * between[k])
        both = ((between[k] - values) / between_std[k]) ** 2
        imu = (both + ((forces[k] - values) / sharp) ** 2).min()
        markers = (both + (forces[k] / sharp) ** 2).min()
        assert weigh(between, between_std, forces, std).apart[k] == pytest.approx(markers - imu, abs=1e-3)


def test_both_points_are_moved_where_neither_alone_explains_what_is_seen():
    points = weigh(np.array([0.02, 0, 0]), STD, np.array([0.01, 0, 0]), STD)
    np.testing.assert_allclose(points.imu, [0.01, 0, 0])
    np.testing.assert_allclose(points.markers, [-0.01, 0, 0])


def test_forces_that_cannot_tell_leave_a_tie_with_both_ways_to_read_it(monkeypatch):
    arm = {n: {"value": v, "std": 5e-4, "unit": "m"} for n, v in zip("xyz", (0.01, 0.0, -0.02))}
    level = Level("K", effects=[{"id": "imu_lever_arm", "since": "always", "parameters": arm}])
    blunt = np.full(3, 0.01)
    monkeypatch.setattr("quasi.gap.points.felt", lambda *_: (np.array([0.004, 0.001, -0.008]), blunt))
    settle(level, [], None)
    assert not level.effects
    (tie,) = level.ties
    assert tie["ids"] == ["imu_lever_arm", "marker_offset"]
    assert tie["separability"] < APART**0.5
    for axis in "xyz":
        assert tie["parameters"]["marker_offset"][axis]["value"] == -arm[axis]["value"]
