"""A model that a gap extended is compared like any other: its flights agree with it, and what it knows stays."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from test_gap_extension import CATALOGUE, base_of, flight

from quasi.errors import ConfigError
from quasi.export.contents import voltage_of
from quasi.gap.catalogue import columns_of
from quasi.gap.causes.inertia import ENTRIES
from quasi.gap.effect import as_flown, vehicle_of
from quasi.gap.extension import extend
from quasi.gap.flights.evidence import model_wrench
from quasi.gap.flights.gathering import gather
from quasi.gap.flights.instruments import shown
from quasi.gap.levels.drive.fit import belief_of
from quasi.gap.levels.drive.prediction import own_lag
from quasi.gap.levels.forces.identify import WEIGHING, _carried
from quasi.gap.preparation import _weighed
from quasi.model.columns import STATE
from quasi.model.extensions import (
    actuators_of,
    correct_columns,
    correct_flight,
    drive_of,
    read_rotor_constants,
    wind_of,
)
from quasi.model.model import AXES, Model
from quasi.simulation.control.control_model import make_control_model
from quasi.simulation.tools.replay import read_actuator_dynamics, replay
from quasi.tables import TELEMETRY_AGE_REMOVED

ONE = {
    "wind": {"north": 1.4, "east": -0.9, "down": 0.0},
    "mass": {"mass": 0.05},
    "inertia": {"Ixx": 2e-4, "Izz": -3e-4},
    "cg_offset": {"x": 0.004, "y": -0.002, "z": 0.0},
    "rotor_speed_scale": {"scale": 0.08},
    "telemetry_delay": {"delay": 0.006},
    "body_drag": {"c": 0.05},
    "inflow_lag": {"tau": 0.02},
    "payload_swing": {"mass at 0.5 m": 0.03},
}


def extended(model, *causes):
    document = extend(model, [(CATALOGUE[n], v) for n, v in causes], vehicle_of(model), "more", "test")
    return Model(document)


def recorded(base, truth):
    """A flight's table that shows what the instruments would if `truth`, an extension of `base`, were right."""
    evidence, _ = flight(base)
    wrench = shown(truth, base, evidence)
    return pd.DataFrame({**evidence.columns, **dict(zip(AXES, wrench.T))}), evidence


def gathered(table, model, base):
    frame = base.airframe
    return gather("a", table, {"mass": frame.mass, "inertia": np.asarray(frame.inertia)}, frame, model, 100.0)


@pytest.mark.parametrize(
    ("name", "gravity"),
    [*((n, "withGravity") for n in ONE), *((n, "noGravity") for n in ONE if n not in WEIGHING)],
)
def test_flights_agree_with_the_model_that_holds_their_cause(name, gravity):
    base = base_of(gravity)
    truth = extended(base, (name, ONE[name]))
    table, _ = recorded(base, truth)
    apart = np.abs(gathered(table, base, base).residual).max(axis=0)
    left = np.abs(gathered(table, truth, base).residual).max(axis=0)
    assert apart.max() > 1e-4
    assert left.max() < 1e-9


@pytest.mark.parametrize(
    ("name", "share"), [("mass", 0.25), ("mass", -0.2), ("Ixx", 0.3), ("Iyy", -0.25), ("Izz", 0.4)]
)
def test_a_large_change_of_mass_or_inertia_comes_out_as_it_is(name, share):
    """A linear fit of a mass that is a quarter larger finds a fifth: the columns hold the model's accelerations."""
    base = base_of("withGravity")
    effect, vehicle = CATALOGUE["mass" if name == "mass" else "inertia"], vehicle_of(base)
    own = vehicle.mass if name == "mass" else vehicle.inertia["xyz".index(name[1]), "xyz".index(name[1])]
    truth = extended(base, (effect.id, {name: share * own}))
    evidence, _ = flight(base)
    added = shown(truth, base, evidence) - evidence.predicted
    column = columns_of(effect, evidence, vehicle, {})[name]
    fitted = float(np.sum(column * added) / np.sum(column**2))
    assert fitted / own == pytest.approx(share / (1.0 + share), rel=0.05)
    assert effect.exact({name: fitted}, vehicle)[name] / own == pytest.approx(share, rel=0.05)
    assert effect.exact({name: 0.0}, vehicle)[name] == 0.0


def test_a_cause_adds_to_the_inertia_that_a_flight_was_processed_with():
    """Nothing found leaves the moments of the model, whatever inertia a flight was processed with."""
    base = base_of("withGravity")
    evidence, _ = flight(base)
    own = np.asarray(base.airframe.inertia)
    evidence = replace(evidence, inertia=1.3 * own)
    nothing = extended(base, ("body_drag", {"c": 0.0}))
    np.testing.assert_allclose(shown(nothing, base, evidence), evidence.predicted, atol=1e-12)
    less = {n: (-0.3 if i == j else 0.3) * own[i, j] for n, (i, j) in ENTRIES.items()}
    back = extended(base, ("inertia", less))
    moments = shown(back, base, evidence)[:, 3:] - evidence.gyroscopic(1.3 * own)
    np.testing.assert_allclose(moments, 1.3 * (evidence.predicted[:, 3:] - evidence.gyroscopic(own)), atol=1e-12)
    assert as_flown(vehicle_of(base), [evidence]).inertia == pytest.approx(1.3 * own)


@pytest.mark.parametrize("name", [n for n in ONE if n not in ("inflow_lag", "payload_swing")])
def test_a_flight_read_with_what_the_model_knows_is_what_it_predicts(name):
    base = base_of("withGravity")
    truth = extended(base, (name, ONE[name]))
    table, _ = recorded(base, truth)
    # the filter's own definition of moments: rates turn as they were measured
    rates, inertia = table[["p", "q", "r"]].to_numpy(), np.asarray(base.airframe.inertia)
    turning = np.linalg.solve(inertia, (table[["Mx", "My", "Mz"]].to_numpy() - np.cross(rates, rates @ inertia.T)).T).T
    table = table.assign(**{f"{c}_dot": turning[:, k] for k, c in enumerate("pqr")})
    for model, close in ((truth, True), (base, False)):
        read = correct_flight(model, table)
        apart = np.abs(model.predict_columns(read)[list(AXES)].to_numpy() - read[list(AXES)].to_numpy()).max()
        assert (apart < 1e-9) == close, apart
    assert correct_flight(base, table) is table


@pytest.mark.parametrize("name", ["wind", "mass", "inertia", "rotor_speed_scale", "telemetry_delay", "body_drag"])
def test_one_step_after_another_is_both_at_once(name):
    base = base_of("withGravity")
    parts = {k: 0.5 * v for k, v in ONE[name].items()}
    whole = ONE[name]
    if name == "rotor_speed_scale":
        parts = {"scale": np.sqrt(1.0 + whole["scale"]) - 1.0}
    twice = extended(extended(base, (name, parts)), (name, parts))
    once = extended(base, (name, whole))
    table, evidence = recorded(base, once)
    np.testing.assert_allclose(shown(twice, base, evidence), shown(once, base, evidence), atol=1e-9)
    # and the second step is judged on flights that were put right by the first
    between = extended(base, (name, parts))
    half = gathered(table, between, base)
    assert np.abs(half.residual).max() > 1e-4
    # half a delay is read between samples of 10 ms, twice
    close = 1e-9 if name != "telemetry_delay" else 5e-4
    np.testing.assert_allclose(shown(twice, between, half), half.measured, atol=close)


def test_what_is_found_comes_on_top_of_the_mass_that_a_flight_was_logged_with():
    """Logged 40 g above the model's mass and 10 g heavier still: measured forces are logged mass x specific force."""
    base, more, found = base_of("withGravity"), 0.04, 0.01
    truth = extended(base, ("mass", {"mass": found}))
    evidence, _ = flight(base)
    own = base.airframe.mass
    evidence = replace(evidence, mass=own + more)
    force = model_wrench(base, evidence.columns)[:, :3]  # of the air: no mass in it
    told = shown(truth, base, evidence)[:, :3]
    np.testing.assert_allclose(told, force * (own + more) / (own + more + found), rtol=1e-12)
    vehicle = as_flown(vehicle_of(base), [evidence])
    assert vehicle.mass == pytest.approx(own + more)
    again = replace(evidence, model=truth)
    assert as_flown(vehicle_of(truth), [again]).mass == pytest.approx(own + more + found)
    still = dict.fromkeys(("p_dot", "q_dot", "r_dot"), 0.0)
    table = pd.DataFrame({**evidence.columns, **dict(zip(AXES, evidence.predicted.T))}).assign(**still)
    read = correct_flight(truth, table, own + more)
    np.testing.assert_allclose(read["Fz"], table["Fz"] * (own + more + found) / (own + more), rtol=1e-12)
    (note,) = _weighed(base, [evidence])
    assert f"logged with {own + more:.4g} kg" in note and not _weighed(base, [flight(base)[0]])


@pytest.mark.parametrize("name", list(ONE))
def test_a_cause_of_old_and_of_new_acts_by_both_together(name):
    """What all flights have and what is new since the reference flights are told apart, and stand in one section."""
    base = base_of("withGravity")
    old, new = ({k: share * v for k, v in ONE[name].items()} for share in (0.3, 0.7))
    both, whole = extended(base, (name, old), (name, new)), extended(base, (name, ONE[name]))
    assert [e["id"] for e in both.document["extensions"]] == [name]
    evidence, _ = flight(base)
    np.testing.assert_allclose(shown(both, base, evidence), shown(whole, base, evidence), atol=1e-9)
    n = len(evidence)
    states = np.stack([evidence.columns[k] for k in STATE], axis=1)
    runs = [replay(m, evidence.t, states, evidence.speeds, np.arange(0, n - 30, 40), 0.2) for m in (both, whole)]
    np.testing.assert_allclose(*runs, atol=1e-9)


def test_constants_of_the_drive_add_up_where_they_are_differences():
    base = base_of("withGravity")
    base = Model({**base.document, "actuators": {"time constants": {"value": [0.03] * 4}, "delay": {"value": 0.004}}})
    late = extended(base, ("command_delay", {"delay": 0.003}), ("command_delay", {"delay": 0.005}))
    assert read_rotor_constants(late)["delay"] == pytest.approx(0.012)
    slow = extended(base, ("motor_lag", {"time_constant": 0.045}), ("motor_lag", {"time_constant": 0.045}))
    assert read_rotor_constants(slow)["time constant"] == pytest.approx(0.045)


def test_what_an_earlier_extension_knows_stays_beside_a_later_one():
    base = base_of("withGravity")
    first = extended(
        base, *((n, ONE[n]) for n in ("wind", "mass", "cg_offset", "rotor_speed_scale", "telemetry_delay"))
    )
    for second in (extended(first), extended(first, ("body_drag", ONE["body_drag"]))):
        assert [e["id"] for e in second.document["extensions"]][:5] == [e["id"] for e in first.document["extensions"]]
        np.testing.assert_allclose(wind_of(second), [1.4, -0.9, 0.0])
        assert second.document["environment"]["wind"] == pytest.approx([1.4, -0.9, 0.0])
        assert read_rotor_constants(second) == read_rotor_constants(first)
        assert second.document["configured mass"] == base.airframe.mass
        assert second.airframe.mass == pytest.approx(base.airframe.mass + 0.05)


def test_a_later_force_is_taken_off_by_an_earlier_load_as_well():
    base = base_of("withGravity")
    later = extended(extended(base, ("payload_swing", ONE["payload_swing"])), ("body_drag", ONE["body_drag"]))
    at_once = extended(base, ("payload_swing", ONE["payload_swing"]), ("body_drag", ONE["body_drag"]))
    evidence, _ = flight(base)
    both = [m.predict_columns(evidence.columns)[list(AXES)].to_numpy() for m in (later, at_once)]
    np.testing.assert_allclose(*both, atol=1e-12)


def test_the_air_of_an_earlier_wind_is_what_forces_are_asked_of():
    base = base_of("withGravity")
    first = extended(base, ("wind", ONE["wind"]))
    evidence, _ = flight(base)
    right = correct_columns(first, evidence.columns)
    level = {**evidence.columns, **dict.fromkeys(("roll", "pitch", "yaw"), 0.0 * evidence.t)}
    assert "u_air" not in evidence.columns and "u_air" in right
    np.testing.assert_allclose(correct_columns(first, level)["u_air"], evidence.columns["u"] - 1.4)
    np.testing.assert_allclose(correct_columns(first, level)["v_air"], evidence.columns["v"] + 0.9)


def test_a_second_load_is_not_asked_of_a_model_that_carries_one():
    model = extended(base_of("withGravity"), ("payload_swing", ONE["payload_swing"]))
    assert list(_carried(CATALOGUE, model)) == ["payload_swing"]
    assert not _carried(CATALOGUE, base_of("withGravity"))


def test_a_lag_that_was_found_is_the_model_s_own_from_then_on():
    base = base_of("withGravity")
    map_of = {"powers": [0, 1, 2], "coefficients": [0.0, 2000.0, 0.0], "voltage exponent": {"value": 0.7}}
    actuators = {"time constants": {"value": [0.03] * 4}, "time constants up": {"value": [0.025] * 4},
                 "time constants down": {"value": [0.035] * 4}, "delay": {"value": [0.004] * 4},
                 "command map": map_of}  # fmt: skip
    base = Model({**base.document, "actuators": actuators})
    lagging = extended(base, ("motor_lag", {"time_constant": 0.045}), ("command_delay", {"delay": 0.01}))
    sagging = extended(lagging, ("battery_sag", {"exponent": 0.9}), ("command_delay", {"delay": 0.002}))
    assert belief_of(base.document, "shares").values[[0, 1, 2, 6]] == pytest.approx([0.025, 0.035, 0.004, 0.7])
    # what was found is the mean of both ways; the ratio of the two is the model's
    lags = [0.0375, 0.0525]
    assert belief_of(lagging.document, "shares").values[[0, 1, 2, 6]] == pytest.approx([*lags, 0.014, 0.7])
    assert belief_of(sagging.document, "shares").values[[0, 1, 2, 6]] == pytest.approx([*lags, 0.016, 0.9])
    # a map that tells no voltage holds at that of the flights which told the exponent; one that tells it keeps its own
    volted = extended(lagging, ("battery_sag", {"exponent": 0.9, "reference voltage": 15.8}))
    assert belief_of(sagging.document, "shares").voltage is None
    assert belief_of(volted.document, "shares").voltage == 15.8
    assert voltage_of(volted)[:2] == (15.8, 15.8) and voltage_of(sagging)[:2] == (1.0, 1.0)
    known = Model({**base.document, "actuators": {"command map": {**map_of, "reference voltage": 15.0}}})
    known = extended(known, ("battery_sag", {"exponent": 0.9, "reference voltage": 15.8}))
    assert drive_of(known.document)["command map"]["reference voltage"] == 15.0
    assert "reference voltage" not in base.document["actuators"]["command map"]
    in_replay, exported = read_actuator_dynamics(lagging), actuators_of(lagging)
    for found in (in_replay, exported):
        np.testing.assert_allclose([found.up, found.down], np.tile(lags, (4, 1)).T)
        assert found.delay == pytest.approx(0.014)
    for said in (True, False, None):  # whether the base's delay holds the telemetry's age stays known
        held = {"value": [0.004] * 4} | ({} if said is None else {TELEMETRY_AGE_REMOVED: said})
        base = Model({**base.document, "actuators": {**actuators, "delay": held}})
        late = extended(base, ("command_delay", {"delay": 0.01}))
        for model in (base, late):
            assert belief_of(model.document, "shares").aged is said
    assert make_control_model(lagging).lag == pytest.approx(0.045)


@pytest.mark.parametrize(
    ("own", "expected"),
    [
        ({}, {"time constants": 0.05}),
        ({"time constants": [0.02, 0.08, 0.08, 0.02]}, {"time constants": [0.025, 0.1, 0.1, 0.025]}),
        ({"time constants up": 0.02}, {"time constants": 0.05}),
        ({"time constants up": 0.02, "time constants down": [0.03] * 4},
         {"time constants": 0.05, "time constants up": 0.04, "time constants down": [0.06] * 4}),
    ],
)  # fmt: skip
def test_a_lag_that_was_found_scales_what_the_model_holds(own, expected):
    sections = [{"id": "motor_lag", "actuators": {"time constant": 0.05}}]
    found = drive_of({"id": "one", "actuators": {k: {"value": v} for k, v in own.items()}, "extensions": sections})
    assert list(found) == list(expected)
    for key, value in expected.items():
        assert found[key]["value"] == pytest.approx(value)


@pytest.mark.parametrize("own", [{}, {"time constants": [0.02] * 4}, {"time constants up": 0.02}])
def test_a_ratio_of_slowing_down_that_was_found_holds_whatever_the_model_states(own):
    sections = [{"id": "motor_lag", "actuators": {"time constant": 0.04, "down over up": 3.0}}]
    found = drive_of({"id": "one", "actuators": {k: {"value": v} for k, v in own.items()}, "extensions": sections})
    assert [np.mean(found[f"time constants{way}"]["value"]) for way in ("", " up", " down")] == (
        pytest.approx([0.04, 0.02, 0.06])
    )


@pytest.mark.parametrize("wind", ["fast", [1.0, 2.0], float("nan")])
def test_a_damaged_wind_is_told(wind):
    document = {**base_of("withGravity").document, "extensions": [{"id": "wind", "environment": {"wind": wind}}]}
    with pytest.raises(ConfigError, match="'wind' is .*expected three numbers"):
        wind_of(Model(document))


def test_the_lag_of_one_rotor_multiplies_its_own_and_shifts_rotors_next_to_that_of_all():
    base = base_of("withGravity")
    held = {"time constants": {"value": [0.025] * 4}, "time constants up": {"value": [0.02] * 4},
            "time constants down": {"value": [0.03, 0.03, 0.03, 0.06]}}  # fmt: skip
    base = Model({**base.document, "actuators": held})
    slow = extended(base, ("motor_lag", {"rotor2": 0.5}))
    np.testing.assert_allclose(actuators_of(slow).up, [0.02, 0.03, 0.02, 0.02])
    np.testing.assert_allclose(actuators_of(slow).down, [0.03, 0.045, 0.03, 0.06])
    # a later finding counts from what the earlier one left
    slower = extended(slow, ("motor_lag", {"rotor2": 1.0, "rotor3": 0.2}))
    np.testing.assert_allclose(actuators_of(slower).up, [0.02, 0.06, 0.024, 0.02])
    known = belief_of(slower.document, "speeds").values
    np.testing.assert_allclose([own_lag(known, i).prod() for i in range(4)],
                               actuators_of(slower).up * actuators_of(slower).down)  # fmt: skip
    # a time constant is that of all four, their mean by logarithms; next to it rotors are shifted against one another
    both = extended(Model({**base.document, "actuators": {"time constants": {"value": [0.02] * 4}}}),
                    ("motor_lag", {"time_constant": 0.04, "rotor2": 15.0}))  # fmt: skip
    np.testing.assert_allclose(actuators_of(both).up, [0.02, 0.32, 0.02, 0.02])
    later = extended(both, ("motor_lag", {"rotor1": 15.0}))
    np.testing.assert_allclose(actuators_of(later).up, [0.32, 0.32, 0.02, 0.02])
    with pytest.raises(ConfigError, match="'rotor1 lag factor' is 0.0, expected a positive"):
        actuators_of(extended(base, ("motor_lag", {"rotor1": -1.0})))


@pytest.mark.parametrize(("always", "changed"), [(2.0, 2.5), (0.35, 0.37)])
def test_factors_on_one_rotors_lag_that_was_always_there_and_that_changed_multiply(always, changed):
    base = base_of("withGravity")
    slow = extended(base, *(("motor_lag", {"rotor2": factor - 1.0}) for factor in (always, changed)))
    np.testing.assert_allclose(actuators_of(slow).up / actuators_of(base).up, [1.0, always * changed, 1.0, 1.0])


def test_a_time_constant_that_was_found_is_what_the_next_comparison_starts_from():
    """Rotors of the model with lags of their own: one of twice the others' had taken 5 % off what was found."""
    base, own = base_of("withGravity"), {"value": [0.02, 0.02, 0.02, 0.04]}
    base = Model({**base.document, "actuators": dict.fromkeys(("time constants", "time constants up"), own)})
    base.document["actuators"]["time constants down"] = {"value": [0.03, 0.03, 0.03, 0.06]}
    slow = extended(base, ("motor_lag", {"time_constant": 0.05}))
    assert belief_of(slow.document, "speeds").values[:2].mean() == pytest.approx(0.05)
