"""A battery that acts otherwise, where rotor speeds are estimated from commands: thrust follows voltage."""

import dataclasses

import numpy as np
import pytest
from made_model import simple_model

from quasi.airframe import read_airframe
from quasi.gap.catalogue import catalogue, columns_of, whole_of
from quasi.gap.effect import vehicle_of
from quasi.gap.extension import extend
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.instruments import shown
from quasi.gap.levels.forces.design import gather_design
from quasi.gap.levels.forces.estimated_speeds import OF_TELEMETRY, add_battery, with_estimated_speeds
from quasi.gap.statistics.candidates import Candidate
from quasi.model.commands import extended_map, rotor_speeds
from quasi.model.extensions import correct_columns
from quasi.model.model import Model
from quasi.terms.rotor_map import lagged
from quasi_synthesis.campaign import quadrotor_configuration, read_campaign

ROWS, EXPONENT, REFERENCE = 300, 0.9, 16.0
MAP = {
    "source": "commands", "input": "share", "form": "linear", "parameters": {"slope": {"value": 0.7}},
    "operating command": 0.4, "reference voltage": REFERENCE, "voltage exponent": {"value": EXPONENT},
    "speeds": {"value": [2100.0] * 4}, "time constant": {"value": 0.026}, "delay": {"value": 0.0},
}  # fmt: skip


@pytest.fixture(scope="module")
def ground():
    campaign = read_campaign({"flights": [{"key": "a", "profile": "mixed", "seed": 1}], "duration": 18}, "t")
    airframe = read_airframe(quadrotor_configuration(campaign), "made")
    model = simple_model(airframe, 2.4e-7, 3e-9)
    return Model(model.document | {"rotor speeds": MAP})


def evidence_of(model, apart=0.0, estimated=True, agreeing=REFERENCE, volts=(16.6, 14.8), seed=2):
    """A flight whose rotors follow the voltage with an exponent `apart` from the map's; its speeds are the map's.

    agreeing  V at which the two are the same; volts  V at the beginning and at the end
    """
    rng = np.random.default_rng(seed)
    columns = {a: s * rng.standard_normal(ROWS) for a, s in zip("uvwpqr", (2.0, 2.0, 1.0, 2.0, 2.0, 1.0))}
    columns |= {a: 0.2 * rng.standard_normal(ROWS) for a in ("roll", "pitch", "yaw")}
    columns |= {"t": np.arange(ROWS) * 0.01, "battery_voltage": np.linspace(*volts, ROWS)}
    speeds = 2100.0 + 150.0 * rng.standard_normal((ROWS, 4))
    columns |= {f"w{i + 1}": speeds[:, i] for i in range(4)} | {f"w{i + 1}_dot": np.zeros(ROWS) for i in range(4)}
    if estimated:
        columns |= {f"command{i}_raw": np.full(ROWS, 0.4) for i in range(1, 5)}
    state = np.stack([columns[a] for a in ("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r")], axis=1)
    true = speeds * (columns["battery_voltage"][:, None] / agreeing) ** apart
    measured, predicted = (np.hstack(model.predict(state, w)) for w in (true, speeds))
    inertia = np.asarray(model.airframe.inertia)
    return Evidence("a", model.airframe, model, 0.433, inertia, columns, measured, predicted)


def test_thrust_that_leads_estimated_speeds_may_be_faster_rotors(ground):
    """Motors of 17 ms in place of 26 ms had been named inflow_lag."""
    effects = with_estimated_speeds(catalogue(), ground, [evidence_of(ground)])[0]
    assert effects["inflow_lag"].always_tied_with == ("motor_lag", "command_delay")


def test_a_tie_of_thrust_holds_the_battery(ground):
    """A battery had been a tie of thrust_factor and four weak rotors."""
    effects = with_estimated_speeds(catalogue(), ground, [evidence_of(ground)])[0]
    ties = [{"ids": ids, "parameters": {}} for ids in (["rotor_effectiveness", "thrust_factor"], ["mass", "wind"])]
    assert [tie["ids"] for tie in add_battery(ties, effects)] == [[*ties[0]["ids"], "battery_sag"], ties[1]["ids"]]
    assert add_battery(ties, catalogue()) == ties


def sag_of(model, evidence):
    return with_estimated_speeds(catalogue(), model, [evidence])[0]["battery_sag"]


def test_measured_speeds_leave_the_catalogue_as_it_is(ground):
    effects, lists = with_estimated_speeds(catalogue(), ground, [evidence_of(ground, estimated=False)])
    assert effects == catalogue() and not lists


def test_causes_of_the_telemetry_go_where_none_is_logged(ground):
    effects, lists = with_estimated_speeds(catalogue(), ground, [evidence_of(ground)])
    assert set(catalogue()) - set(effects) == set(OF_TELEMETRY) == {entry["id"] for entry in lists}
    assert effects["battery_sag"].level == "forces"
    assert not set(OF_TELEMETRY) & {i for e in effects.values() for i in e.always_tied_with}


def test_a_map_without_voltage_cannot_be_asked(ground):
    model = Model(ground.document | {"rotor speeds": MAP | {"reference voltage": None, "voltage exponent": None}})
    effects, lists = with_estimated_speeds(catalogue(), model, [evidence_of(model)])
    assert effects["battery_sag"].level == "drive"
    assert "battery_sag" in {entry["id"] for entry in lists}


@pytest.mark.parametrize("apart", [0.3, -0.5])
def test_the_effect_is_thrust_at_the_voltage_of_the_flight(ground, apart):
    evidence = evidence_of(ground, apart)
    effect, vehicle = (
        with_estimated_speeds(catalogue(), ground, [evidence])[0]["battery_sag"],
        vehicle_of(ground, 0.433),
    )
    whole = whole_of(effect, evidence, vehicle, {"exponent": apart})
    np.testing.assert_allclose(whole, evidence.residual, atol=1e-9)
    slope = columns_of(effect, evidence, vehicle, {"exponent": 0.0})["exponent"]
    small = evidence_of(ground, 1e-3).residual / 1e-3
    np.testing.assert_allclose(slope, small, rtol=2e-2, atol=2e-2 * np.abs(small).max())


def test_a_level_goes_with_the_exponent(ground):
    """The two batteries agree at 15.2 V, not at the voltage of the model's map."""
    evidence = evidence_of(ground, 0.3, agreeing=15.2)
    values = {"exponent": 0.3, "level": (REFERENCE / 15.2) ** 0.3 - 1.0}
    effect, vehicle = sag_of(ground, evidence), vehicle_of(ground, 0.433)
    np.testing.assert_allclose(whole_of(effect, evidence, vehicle, values), evidence.residual, atol=1e-9)
    extended = Model(extend(ground, [(effect, values)], vehicle, "more", "test"))
    np.testing.assert_allclose(shown(extended, ground, evidence), evidence.measured, atol=1e-9)
    t, commands, volts = evidence.columns["t"], np.full((ROWS, 4), 0.4), np.full(ROWS, 14.0)
    before, after = (rotor_speeds(m.document, t, commands, volts)[0] for m in (ground, extended))
    np.testing.assert_allclose(after / before, (14.0 / 15.2) ** 0.3)


def test_what_changes_thrust_at_the_same_command_is_tied_with_the_battery(ground):
    """A battery of another exponent had been named thrust_curve."""
    effects = with_estimated_speeds(catalogue(), ground, [evidence_of(ground)])[0]
    tied = {n for n, e in effects.items() if "battery_sag" in e.always_tied_with}
    assert tied == {"thrust_factor", "thrust_curve", "thrust_drift"}
    assert not effects["battery_sag"].always_tied_with


@pytest.mark.parametrize(
    ("of_references", "volts", "is_changed"), [(0.6, (16.6, 15.8), False), (0.0, (15.2, 13.2), True)]
)
def test_lower_volts_than_references_had_are_no_other_battery(ground, of_references, volts, is_changed):
    """Reference flights on a full battery do not know the map's exponent; their own values of it belong to the test."""

    def flight(key, apart, volts, seed):
        made = evidence_of(ground, apart, volts=volts, seed=seed)
        noise = np.random.default_rng(seed).standard_normal((ROWS, 6)) * [0.3, 0.3, 0.3, 0.01, 0.01, 0.01]
        return dataclasses.replace(made, key=key, measured=made.measured + noise)

    flights = [flight(f"r{k}", of_references, volts, k) for k in range(3)]
    flights += [flight(f"c{k}", 0.6, (15.2, 13.2), 5 + k) for k in range(2)]
    flights = [dataclasses.replace(f, excluded=(0, 1, 5)) for f in flights]
    effects = {"battery_sag": sag_of(ground, flights[0])}
    compared = np.array([False] * 3 + [True] * 2)
    mixed = gather_design(flights, effects, vehicle_of(ground, 0.433)).witnessed(range(5), compared)
    p = mixed.test(Candidate("battery_sag", "changed", (0,)), [], mixed.pooled("changed")).p
    assert (p < 1e-3) == is_changed, p
    # references that have the map's exponent exactly would have named it in both
    assert mixed.test(Candidate("battery_sag", "changed", (0,))).p < 1e-3


FORMS = {"linear": {"slope": 0.7}, "quadratic": {"slope": 0.7, "curvature": -0.1}, "thrust map": {"saturation": 0.5}}


@pytest.mark.parametrize("form", FORMS)
def test_the_exponent_of_an_extension_is_that_of_the_speed(ground, form):
    """Where the map's voltage acts on the command, its own exponent is another number."""
    drive = MAP | {"form": form, "parameters": {n: {"value": v} for n, v in FORMS[form].items()}}
    model = Model(ground.document | {"rotor speeds": drive})
    evidence = evidence_of(model)
    effect, vehicle = sag_of(model, evidence), vehicle_of(model, 0.433)
    extended = Model(extend(model, [(effect, {"exponent": 0.2})], vehicle, "more", "test"))
    t, commands = evidence.columns["t"], np.full((ROWS, 4), MAP["operating command"])
    volts = np.full(ROWS, REFERENCE * 0.99)
    before, after = (rotor_speeds(m.document, t, commands, volts)[0] for m in (model, extended))
    np.testing.assert_allclose(after / before, 0.99**0.2, atol=1e-4)


def test_the_extended_model_holds_the_exponent(ground):
    """Its forces, its correction of estimated speeds, and its speeds from commands agree."""
    evidence = evidence_of(ground, 0.3)
    effect, vehicle = (
        with_estimated_speeds(catalogue(), ground, [evidence])[0]["battery_sag"],
        vehicle_of(ground, 0.433),
    )
    extended = Model(extend(ground, [(effect, {"exponent": 0.3})], vehicle, "more", "test"))
    np.testing.assert_allclose(shown(extended, ground, evidence), evidence.measured, atol=1e-9)
    corrected = correct_columns(extended, evidence.columns)["w1"]
    ratio = evidence.columns["battery_voltage"] / REFERENCE
    np.testing.assert_allclose(corrected, evidence.columns["w1"] * ratio**0.3)
    measured = {n: v for n, v in evidence.columns.items() if not n.endswith("_raw")}
    np.testing.assert_array_equal(correct_columns(extended, measured)["w1"], evidence.columns["w1"])
    t, commands = evidence.columns["t"], np.full((ROWS, 4), 0.4)
    volts = np.full(ROWS, 15.0)
    before, after = (rotor_speeds(m.document, t, commands, volts)[0] for m in (ground, extended))
    np.testing.assert_allclose(after / before, (15.0 / REFERENCE) ** 0.3)


@pytest.mark.parametrize(("level", "ratio"), [(-1.15, 0.5), (3.0, 2.0), (0.1, 1.1)])
def test_a_level_that_flights_hardly_show_makes_a_model_within_its_range(ground, level, ratio):
    evidence = evidence_of(ground, volts=(16.05, 15.95))
    effect, vehicle = sag_of(ground, evidence), vehicle_of(ground, 0.433)
    extended = Model(extend(ground, [(effect, {"exponent": 0.1, "level": level})], vehicle, "more", "test"))
    expected = ratio * (evidence.columns["battery_voltage"] / REFERENCE) ** 0.1
    np.testing.assert_allclose(
        correct_columns(extended, evidence.columns)["w1"], evidence.columns["w1"] * expected, rtol=1e-6
    )
    whole = whole_of(effect, evidence, vehicle, {"exponent": 0.1, "level": level})
    np.testing.assert_allclose(shown(extended, ground, evidence), evidence.predicted + whole, atol=1e-9)


def test_a_model_that_is_extended_already_is_asked_beyond_it(ground):
    evidence = evidence_of(ground, 0.3)
    effect, vehicle = (
        with_estimated_speeds(catalogue(), ground, [evidence])[0]["battery_sag"],
        vehicle_of(ground, 0.433),
    )
    extended = Model(extend(ground, [(effect, {"exponent": 0.3})], vehicle, "more", "test"))
    columns = correct_columns(extended, evidence.columns)
    again = dataclasses.replace(evidence, model=extended, columns=columns)
    further = sag_of(extended, again)
    assert further.parameters["exponent"].neutral == pytest.approx(EXPONENT + 0.3)


def late_model(ground):
    return Model(ground.document | {"actuators": {"time constants": {"value": [0.026] * 4}, "delay": {"value": 0.001}}})


def test_commands_that_arrive_late_act_before_the_estimated_speeds(ground):
    """A lag and a delay beyond the model's look much the same in forces and moments, and are a tie."""
    model = late_model(ground)
    plain = evidence_of(model)
    # speeds are read linearly between samples: slopes of the interval before each one
    dots = np.diff(plain.speeds, axis=0, prepend=plain.speeds[:1]) / np.diff(plain.columns["t"]).mean()
    columns = {**plain.columns, **{f"w{i + 1}_dot": dots[:, i] for i in range(4)}}
    late = 1e-4
    state = np.stack([columns[a] for a in ("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r")], axis=1)
    true = np.hstack(model.predict(state, plain.speeds - late * dots))
    evidence = dataclasses.replace(plain, columns=columns, measured=true)
    effects, vehicle = with_estimated_speeds(catalogue(), model, [evidence])[0], vehicle_of(model, 0.433)
    effect = effects["command_delay"]
    assert (effect.level, effect.always_tied_with) == ("forces", ("motor_lag",))
    column = columns_of(effect, evidence, vehicle, {"delay": 0.0})["delay"]
    left = evidence.residual
    np.testing.assert_allclose(column * late, left, rtol=2e-2, atol=2e-3 * np.abs(left).max())
    extended = Model(extend(model, [(effect, {"delay": late})], vehicle, "more", "test"))
    np.testing.assert_allclose(shown(extended, model, evidence), true, atol=1e-9)
    assert extended_map(extended.document)["delay"]["value"] == pytest.approx(0.001 + late)


@pytest.mark.parametrize("lag", [0.012, 0.02, 0.04, 0.08])
def test_rotors_that_follow_slower_make_what_another_lag_makes_of_the_commands(ground, lag):
    """Commands that chatter are damped by a lag and not by a delay: a shift in time would leave most of it."""
    model, plain = late_model(ground), evidence_of(ground)
    t, fine = plain.columns["t"], np.arange(-0.5, ROWS * 0.01, 0.0005)
    rng = np.random.default_rng(8)
    tones = [(f, rng.uniform(0, 6.28, 4)) for f in (0.3, 0.9, 2.1, 4.3, 7.7, 12.1)]
    wanted = 2100.0 + 80.0 * sum(np.sin(6.2832 * f * fine[:, None] + phase) for f, phase in tones)

    def logged(speeds):
        slopes = np.gradient(speeds, fine, axis=0)
        at = [np.stack([np.interp(t, fine, c) for c in x.T], axis=1) for x in (speeds, slopes)]
        return {f"w{i + 1}{d}": x[:, i] for d, x in zip(("", "_dot"), at) for i in range(4)}

    state = np.stack([plain.columns[a] for a in ("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r")], axis=1)
    estimated, true = (logged(lagged(wanted, 0.0005, tau, 0.0)) for tau in (0.026, lag))
    predicted, measured = (
        np.hstack(model.predict(state, np.stack([c[f"w{i}"] for i in range(1, 5)], axis=1))) for c in (estimated, true)
    )
    evidence = dataclasses.replace(
        plain, model=model, columns={**plain.columns, **estimated}, predicted=predicted, measured=measured
    )
    effects, vehicle = with_estimated_speeds(catalogue(), model, [evidence])[0], vehicle_of(model, 0.433)
    effect, settled = effects["motor_lag"], slice(50, None)
    assert (effect.level, effect.always_tied_with) == ("forces", ("command_delay",))
    whole, left = whole_of(effect, evidence, vehicle, {"time_constant": lag - 0.026}), evidence.residual
    extended = Model(extend(model, [(effect, {"time_constant": lag - 0.026})], vehicle, "more", "test"))
    rest = (whole - left, shown(extended, model, evidence) - measured)
    for k in (2, 3, 4):
        for part in rest:
            assert np.std(part[settled, k]) < 0.2 * np.std(left[settled, k])
    slope = columns_of(effect, evidence, vehicle, {"time_constant": 0.0})["time_constant"] * (lag - 0.026)
    assert np.std((slope - left)[settled, 2]) > np.std(rest[0][settled, 2])
    assert extended_map(extended.document)["time constant"]["value"] == pytest.approx(lag)


@pytest.mark.parametrize(
    ("name", "parameter", "size"), [("command_delay", "delay", 0.005), ("motor_lag", "time_constant", 0.02)]
)
def test_late_rotors_do_not_move_what_a_model_makes_of_their_speeds_across_them(ground, name, parameter, size):
    """Pitch commands go with the speed that they make: a term of Fx in U_q, moved in time with rotors that were late by
    15 ms, had left what a load that swings corrects."""
    across = simple_model(ground.airframe, 2.4e-7, 3e-9, Fx={"U_q": 1e-7}, Fy={"U_p": 1e-7})
    model = late_model(Model(across.document | {"rotor speeds": MAP}))
    plain = evidence_of(model)
    dots = np.random.default_rng(3).normal(0.0, 2000.0, (ROWS, 4))
    columns = {**plain.columns, **{f"w{i + 1}_dot": dots[:, i] for i in range(4)}}
    evidence, vehicle = dataclasses.replace(plain, columns=columns), vehicle_of(model, 0.433)
    effect = with_estimated_speeds(catalogue(), model, [evidence])[0][name]
    slope = columns_of(effect, evidence, vehicle, {parameter: 0.0})[parameter]
    for made in (slope, whole_of(effect, evidence, vehicle, {parameter: size})):
        assert not made[:, :2].any()
        assert np.all(made[:, 2:].any(axis=0))
