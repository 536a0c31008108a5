"""Plans: what a trajectory asks of the vehicle, what it cannot follow, and the library's manoeuvres."""

import dataclasses
import math

import numpy as np
import pandas as pd
import pytest
from flights import AIRFRAME
from made_model import part
from made_plan import HOVER, MASS, MODEL, TERMS, THRUST, card_of, eight, follow, model_of

from quasi import attitude
from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.gap.planning import plan
from quasi.gap.planning.flatness import limits_of, turning
from quasi.gap.planning.manoeuvres import library
from quasi.model.build import assemble_model
from quasi.model.columns import ROTORS
from quasi.model.model import AXES, Model


def test_in_hover_every_rotor_turns_at_hover_speed():
    t = np.arange(20) * 0.5
    table = follow(pd.DataFrame({"t": t, "x": 0.0 * t, "y": 0.0 * t, "z": 0.0 * t - 1.0}))
    # the model's small constants are met, too
    np.testing.assert_allclose(table[list(ROTORS)], HOVER, rtol=5e-4)
    np.testing.assert_allclose(table["az"], -GRAVITY)


def test_a_circle_without_drag_leans_by_the_centripetal_acceleration():
    bare = {**TERMS, "Fx": {"1": 0.0}, "Fy": {"1": 0.0}, "Fz": {"w1^2 + w2^2 + w3^2 + w4^2": -THRUST}}
    document = assemble_model({a: part(a, t) for a, t in bare.items()}, {**MODEL.document, "training flights": ["a"]},
                        {"id": "bare", "airframe": AIRFRAME})  # fmt: skip
    t, radius, omega = np.arange(0.0, 20.0, 0.05), 1.5, 1.6
    table = pd.DataFrame({"t": t, "x": radius * np.cos(omega * t), "y": radius * np.sin(omega * t), "z": -1.0 + 0 * t})
    flight = follow(table, Model(document))[300:-300]
    q = attitude.from_euler(*(flight[a].to_numpy() for a in ("roll", "pitch", "yaw")))
    lean = np.arccos(attitude.rotate(q, np.array([0.0, 0.0, 1.0]))[:, 2])
    pull = radius * omega**2
    np.testing.assert_allclose(lean, math.atan2(pull, GRAVITY), rtol=1e-4)
    np.testing.assert_allclose(flight["Fz"], -MASS * math.hypot(pull, GRAVITY), rtol=1e-4)
    np.testing.assert_allclose(flight["yaw"], 0.0, atol=1e-9)


def test_forces_moments_and_rates_are_those_of_the_path():
    """Newton and Euler with angles differentiated by the textbook's 3-2-1 kinematics, none of the code under test."""
    table = eight(20.0, turn=0.6)
    flight = follow(table)
    t = flight["t"].to_numpy()
    roll, pitch, yaw = (np.unwrap(flight[a].to_numpy()) for a in ("roll", "pitch", "yaw"))
    dr, dp, dy = (np.gradient(a, t) for a in (roll, pitch, yaw))
    rates = np.column_stack([
        dr - dy * np.sin(pitch),
        dp * np.cos(roll) + dy * np.sin(roll) * np.cos(pitch),
        dy * np.cos(roll) * np.cos(pitch) - dp * np.sin(roll),
    ])  # fmt: skip
    inside = slice(100, -100)
    np.testing.assert_allclose(flight[["p", "q", "r"]].to_numpy()[inside], rates[inside], atol=2e-3)
    inertia = AIRFRAME.inertia
    moments = np.gradient(rates, t, axis=0) @ inertia.T + np.cross(rates, rates @ inertia.T)
    quasi_steady = MODEL.predict_columns(flight.drop(columns=[f"{w}_dot" for w in ROTORS]).assign(
        **{f"{w}_dot": 0.0 for w in ROTORS}))  # fmt: skip
    np.testing.assert_allclose(quasi_steady[["Mx", "My", "Mz"]].to_numpy()[inside], moments[inside], atol=3e-5)
    place = flight[["x", "y", "z"]].to_numpy()
    acceleration = np.gradient(np.gradient(place, t, axis=0), t, axis=0)
    q = attitude.from_euler(roll, pitch, yaw)
    felt = attitude.rotate(q, flight[["Fx", "Fy", "Fz"]].to_numpy()) / MASS + [0.0, 0.0, GRAVITY]
    np.testing.assert_allclose(felt[inside], acceleration[inside], atol=0.02)


def test_a_turn_at_a_given_attitude_keeps_its_height():
    t = np.arange(0.0, 2.0, 0.01)
    angles = np.column_stack([0.3 * np.sin(6.0 * t) ** 3, 0.2 * np.sin(6.0 * t) ** 3, 0.0 * t])
    flight = turning(t, angles, np.array([1.0, 2.0, -1.5]), MODEL, "a turn")
    np.testing.assert_allclose(flight["z"], -1.5, atol=1e-9)
    np.testing.assert_allclose(flight[["roll", "pitch", "yaw"]], angles, atol=1e-9)
    with pytest.raises(DataError, match="lies on its side"):
        turning(t, np.column_stack([t, 0 * t, 0 * t]), np.zeros(3), MODEL, "a turn")


def limited():
    return model_of(dataclasses.replace(AIRFRAME, poles=14, idle_rpm=250.0, max_rpm=2000.0))


def test_what_the_rotors_cannot_give_is_told_with_time_and_place():
    low, high = limits_of(limited())
    assert low == pytest.approx(374.0, abs=0.1) and high == pytest.approx(2992.0, abs=0.1)
    t = np.arange(0.0, 10.0, 0.1)
    z = -1.0 - 10.0 * np.maximum(t - 4.0, 0.0) ** 3 * np.exp(-np.maximum(t - 4.0, 0.0))  # a jerk upwards
    table = pd.DataFrame({"t": t, "x": 0.5 + 0 * t, "y": 0 * t, "z": z})
    told = r"more than the rotors give at t = 4\.\d\d s, x y z = 0\.50 0\.00 -\d\.\d\d m"
    with pytest.raises(DataError, match=told):
        follow(table, limited())
    follow(table, MODEL)  # without limits it can be followed
    fall = pd.DataFrame({"t": t, "x": 0 * t, "y": 0 * t, "z": 0.5 * GRAVITY * t**2})
    with pytest.raises(DataError, match=r"falls freely at t = 0\.\d\d s"):
        follow(fall)


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda t: t.drop(columns="z"), "no column 'z'"),
        (lambda t: t.rename(columns={"t": "T"}), "no column 't'"),
        (lambda t: t.assign(x=t["x"].where(t.index != 7)), "column 'x' holds no number in row 8"),
        (lambda t: t.assign(y="north"), "column 'y' holds text"),
        (lambda t: t.assign(t=t["t"].where(t.index != 5, 0.2)), r"time goes from 0.4 to 0.2 s in row 6"),
        (lambda t: t[:4], "has 4 rows, expected more than 5"),
    ],
)
def test_a_table_that_is_no_trajectory_is_refused(change, said):
    with pytest.raises(DataError, match=said):
        plan.read_flight(change(eight()), MODEL, "a plan")


def test_every_manoeuvre_can_be_flown_and_begins_and_ends_at_rest():
    found = library(limited(), [0.0, 0.0, -1.5])
    assert len(found) >= 10 and len({m.name for m in found}) == len(found)
    low, high = limits_of(limited())
    for m in found:
        assert 10.0 < m.flight["t"].iloc[-1] < 40.0
        assert m.flight[list(ROTORS)].to_numpy().max() <= high and m.flight[list(ROTORS)].to_numpy().min() >= low
        assert m.flight["z"].max() < 0.0, m.name  # above the floor
        for row in (0, -1):
            assert np.abs(m.flight[["u", "v", "w", "p", "q", "r"]].iloc[row]).max() < 0.3, m.name


def test_a_simulation_feels_what_its_forces_say_and_the_floor_is_told():
    """The specific force of a table without one is that of the path; for models of net forces, too."""
    flight = follow(eight(15.0))
    bare = flight.drop(columns=["ax", "ay", "az"])
    for gravity in ("withGravity", "noGravity"):
        model = model_of(gravity=gravity)
        if gravity == "noGravity":  # a net force has the weight in it
            bare = bare.drop(columns=list(AXES))
        found = plan.read_flight(bare, model, "s", simulated=True).columns
        down = attitude.rotate_inverse(
            attitude.from_euler(*(flight[a].to_numpy() for a in ("roll", "pitch", "yaw"))),
            np.array([0.0, 0.0, GRAVITY]),
        )
        felt = found[["Fx", "Fy", "Fz"]].to_numpy() / MASS - (down if gravity == "noGravity" else 0.0)
        np.testing.assert_allclose(found[["ax", "ay", "az"]], felt)
    notes = card_of(eight(15.0, height=0.02, size=0.05)).notes
    assert "less than a rotor's radius above the floor" in notes[0]


def test_a_model_of_time_and_voltage_is_followed_at_its_usual_voltage():
    document = {
        **MODEL.document,
        "axes": {a: {**p, "terms": list(p["terms"])} for a, p in MODEL.document["axes"].items()},
    }
    first = document["axes"]["Fz"]["terms"][0]
    for expression, size in (("t", 0.01), ("battery_voltage - 15", 0.02)):
        document["axes"]["Fz"]["terms"].append(
            {**first, "given": True, "name": expression, "expression": expression, "coefficient": size})  # fmt: skip
    document["envelope"] = {"battery_voltage": {"percentiles": {"50": 15.0}}}
    t = np.arange(20) * 0.5
    table = pd.DataFrame({"t": t, "x": 0.0 * t, "y": 0.0 * t, "z": 0.0 * t - 1.0})
    flight = follow(table, Model(document))
    np.testing.assert_allclose(flight["battery_voltage"], 15.0)
    np.testing.assert_allclose(flight["Fz"], -MASS * GRAVITY, rtol=1e-4)
    assert flight["w1"].iloc[-1] > flight["w1"].iloc[0] + 1.0  # the lift that time takes away, the rotors make
    assert library(Model(document), [0.0, 0.0, -2.0])
