"""Causes that always were and that changed as well, axes that do not count, flights that differ: one answer for all."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from plain_plant import made_model, with_simple_model
from test_gap_extension import base_of
from test_gap_halves import flown
from test_kinematic import flown as captured

from quasi.gap.catalogue import catalogue, columns_of, in_room, whole_of
from quasi.gap.effect import Effect, Parameter, as_flown, room_of, vehicle_of
from quasi.gap.extension import extend
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.instruments import shown
from quasi.gap.flights.level import Level
from quasi.gap.levels.corrections import document
from quasi.gap.levels.forces import identify as identify_forces
from quasi.gap.levels.forces.design import base_columns, gather_design, refit_with
from quasi.gap.levels.forces.error_reduction import after, wrench_score
from quasi.gap.levels.forces.held_out import HeldOut
from quasi.gap.levels.forces.joint_fit import joint_of, residual_of
from quasi.gap.levels.forces.search import Sought, estimate
from quasi.gap.levels.forces.smooth_functions import grounds_of
from quasi.gap.levels.forces.spectral_peaks import Signal, search
from quasi.gap.levels.rollouts import split_flights
from quasi.gap.levels.sensors import held_out, identify
from quasi.gap.losses import Loss, _of_forces, correction_matters, with_own_terms, wrench_pairs
from quasi.gap.materiality import Cause, material
from quasi.gap.own_effect import effect_of
from quasi.gap.selection import Tie
from quasi.gap.statistics import mixed as tests_on
from quasi.gap.statistics.candidates import Candidate
from quasi.gap.statistics.whitening import autoregression
from quasi.model.model import AXES, Model
from quasi.terms.canonical import canonicalise
from quasi.terms.expressions import parse

CAUSES = catalogue()
BASE = base_of("withGravity")
VEHICLE = vehicle_of(BASE)
COMPARED = np.array([False, False, True, True])


def made(causes, model=BASE):
    return Model(extend(model, causes, vehicle_of(model), "x", "test"), "x")


def flight(seed, heavier=0.0, **more):
    """A made flight of which the model knows all but the noise; forces as of a vehicle that is `heavier` (a share)."""
    rng, t = np.random.default_rng(seed), 0.01 * np.arange(3000)

    def wave(size, f):
        return size * sum(np.sin(2 * np.pi * f * (1 + 0.37 * k) * t + rng.uniform(0, 6.28)) for k in range(4)) / 1.4

    columns = {"t": t, "z": -2 + wave(0.3, 0.1)} | {n: wave(0.5, 0.1) for n in ("x", "y", "yaw")}
    columns |= {"roll": wave(0.2, 0.3), "pitch": wave(0.2, 0.3), "u": wave(1, 0.2), "v": wave(1, 0.2)}
    columns |= {"w": wave(0.5, 0.2), "p": wave(0.5, 0.5), "q": wave(0.5, 0.5), "r": wave(0.3, 0.5)} | more
    for i in range(1, 5):
        columns[f"w{i}"] = 1500 + wave(80, 0.4)
        columns[f"w{i}_dot"] = np.gradient(columns[f"w{i}"], 0.01)
    predicted = BASE.predict_columns(columns)[list(AXES)].to_numpy()
    measured = predicted.copy()
    measured[:, :3] /= 1.0 + heavier
    measured += rng.standard_normal(measured.shape) * np.array([0.02] * 3 + [2e-4] * 3)
    about = (BASE.airframe, BASE, BASE.airframe.mass, np.asarray(BASE.airframe.inertia))
    return Evidence(f"f{seed}", *about, columns, measured, predicted)


def shifted(evidence, wrench, excluded=()):
    measured = evidence.measured.copy()
    for axis, value in wrench.items():
        measured[:, AXES.index(axis)] += value
    return replace(evidence, measured=measured, excluded=excluded)


def push(terms, channels):
    return Effect(
        id="push", level="forces", sentence="s", equation="e", source="s", channels=channels,
        parameters={"c": Parameter("N", 0.0, "s", -5, 5, 0.1)}, terms=lambda vehicle: {"c": terms},
    )  # fmt: skip


def judged(effect, flights, held, compared, since="changed"):
    """Ids of what held-out flights let stand of a cause that the others show."""
    study = gather_design(flights, {effect.id: effect}, VEHICLE)
    mixed = study.witnessed(range(len(flights)), compared)
    test = mixed.test(Candidate(effect.id, since, (0,)), [], mixed.pooled(since) if since == "changed" else [])
    flown_so = as_flown(VEHICLE, flights)
    value, std = estimate(test, effect, flown_so)
    level = dict.fromkeys(("changed", "always"), 1e-3)
    sought = Sought(study, mixed, {True: {}, False: {}}, [], [], [], level, {}, {}, flown_so, None)
    judge = HeldOut(held, sought, {effect.id: effect}, flights, compared, BASE, VEHICLE, 0.05, "test")
    cause = Cause(effect, since, value, std, test, [])
    kept, *_ = material([cause], judge.score, judge.excited, judge.old, judge.floor, 0.05, judge.common(), None)
    return [c.effect.id for c in kept], judge


def test_a_cause_given_in_two_parts_is_a_flights_own_once():
    base = with_simple_model(made_model(reaction=0.0), 0.012)
    vehicle, effect, zero = vehicle_of(base), CAUSES["cg_offset"], {"y": 0.0, "z": 0.0}
    parts = [(effect, {"x": x, **zero}) for x in (0.0003, 0.0006)]
    extended = made(parts, base)
    table, evidence = flown(extended, base)
    other = flown(extended, base, seed=1)[1]
    level = wrench_score([other], after(extended, base)).mean()
    found = []
    for causes in ([(effect, {"x": 0.0009, **zero})], parts, parts[::-1]):
        own = split_flights.own(evidence, extended, base, causes, vehicle, level)
        sides = [(base, []), (extended, causes)]
        gain = split_flights.gain([evidence], {"a": table}, [other], base, sides, vehicle, "rate", 0.5)
        model = split_flights.with_own(extended, base, causes, own, vehicle)
        found.append([own.parameters["cg_offset"]["x"], gain, shown(model, base, evidence)[:, 4].mean()])
    assert found[1] == pytest.approx(found[0], rel=1e-9) and found[2] == pytest.approx(found[0], rel=1e-9)
    assert found[0][0] == pytest.approx(0.0009, rel=0.1) and found[0][1] > 0.9


def test_a_bent_cause_given_in_two_parts_is_bent_once():
    effect, flights = CAUSES["ground_effect"], []
    for seed, size in ((1, 4.0), (2, 4.0), (3, 9.0), (4, 9.0)):
        t = 0.01 * np.arange(3000)
        low = flight(seed, z=-(0.07 + 0.25 * (1 + np.sin(0.9 * t + seed))))
        flights.append(replace(low, measured=low.measured + whole_of(effect, low, VEHICLE, {"c": size})))
    parts = [(effect, Candidate(effect.id, s, (0,)), {"c": c}) for s, c in (("always", 4.0), ("changed", 5.0))]
    for causes in (parts, parts[::-1]):
        joint = joint_of(grounds_of(flights, COMPARED, causes, VEHICLE), COMPARED, causes, [])
        left = residual_of(flights[2], joint._replace(base=None), VEHICLE)[:, 2]
        assert left.std() < 0.022  # of which noise is 0.02, the effect 0.34


def test_a_floor_lies_no_higher_than_what_a_model_that_was_tried_leaves(monkeypatch):
    """A fit of everything at once to noise leaves more than the one cause that is there."""
    monkeypatch.setattr("quasi.gap.levels.forces.held_out.everything", lambda *_: lambda flight: 2.0 * flight.residual)
    flights = [shifted(f, {"Fz": 0.5 * f.columns["w"] * flag}) for flag, f in zip(COMPARED, map(flight, (1, 2, 3, 4)))]
    there = [shifted(f, {"Fz": 0.5 * f.columns["w"]}) for f in map(flight, (5, 6))]
    kept, judge = judged(push({"Fz": "w"}, ("Fz",)), flights, there, COMPARED)
    assert kept == ["push"]
    assert judge.floor[2] < 0.1 * judge.old.mean()[2]


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5])
def test_another_mass_leaves_the_models_thrust_as_it_was(share):
    effect = CAUSES["mass"]
    flights = [flight(1), flight(2), flight(3, share), flight(4, share)]
    study = gather_design(flights, {"mass": effect}, VEHICLE)
    cause = Cause(effect, "changed", {}, {}, None, [])
    values = {"mass": share * VEHICLE.mass}
    changes = refit_with(study, COMPARED, [(cause, values)])
    own = [t["coefficient"] for a in AXES for t in BASE.document["axes"].get(a, {"terms": []})["terms"]]
    thrust = study.names[1 : 1 + len(study.columns.shared)].index(next(n for n in study.names if "w2_1" in n))
    assert abs(changes[thrust] / own[thrust]) < 0.003
    causes = [(effect, Candidate("mass", "changed", (0,)), values)]
    joint = joint_of(grounds_of(flights, COMPARED, causes, VEHICLE), COMPARED, causes, [])
    assert abs(residual_of(flights[2], joint, VEHICLE)[:, 2].mean()) < 0.004 * VEHICLE.mass * 9.81


@pytest.mark.parametrize(("name", "values"), [
    ("mass", {"mass": 0.5 * VEHICLE.mass}), ("mass", {"mass": -0.3 * VEHICLE.mass}),
    ("inertia", {"Ixx": 0.5 * VEHICLE.inertia[0, 0]}),
    ("inertia", {"Ixx": 1e-4, "Iyy": -1e-4, "Izz": 2e-4, "Ixy": 5e-5, "Ixz": -3e-5, "Iyz": 2e-5}),
])  # fmt: skip
def test_what_a_cause_adds_is_what_its_model_makes(name, values):
    effect, one = CAUSES[name], flight(1)
    exact = effect.exact(effect.apparent(values, VEHICLE), VEHICLE)
    if len(values) != 1 or name == "mass":
        assert exact == pytest.approx(values, rel=1e-9)
    right = shown(made([(effect, values)]), BASE, one) - one.predicted
    # of an inertia the columns hold the measured acceleration, noise and all
    close = 1e-6 if name == "mass" else 0.02
    assert whole_of(effect, one, VEHICLE, values) == pytest.approx(right, abs=close * np.abs(right).max())


@pytest.mark.parametrize(
    "stray, term", [({"v^2": 4e-4}, "v^2 (Mz)"), ({"u^2": 2e-4, "v^2": 4e-4}, "v^2 and u^2 (Mz)"), ({}, "")]
)
def test_a_loss_that_terms_of_the_model_make_of_a_wind_names_the_terms(stray, term):
    """A yaw moment with the square of a speed, taken up by chance, answers to a wind that yaws no vehicle."""
    axes = BASE.document["axes"]
    terms = [
        *axes["Mz"]["terms"],
        *(
            {**axes["Mz"]["terms"][0], "name": n, "expression": n, "coefficient": c, "given": True}
            for n, c in stray.items()
        ),
    ]
    base = Model({**BASE.document, "axes": {**axes, "Mz": {**axes["Mz"], "terms": terms}}})
    wind = [(CAUSES["wind"], {"north": -2.0, "east": 2.0, "down": 0.0})]
    still = flight(1)
    measured = shown(made(wind), BASE, still) + still.measured - still.predicted
    measured[:, 5] += 0.0 if stray else 1e-3 * still.columns["u"]
    predicted = base.predict_columns(still.columns)[list(AXES)].to_numpy()
    held = [replace(still, model=base, measured=measured, predicted=predicted)]
    lost = [Loss("forces", "Mz", 0.0, 1e-3, 2e-3), Loss("rollouts", "rate z", 0.5, 0.1, 0.2)]
    found = with_own_terms(lost, base, made(wind, base), held, 0.05)
    assert [loss.terms for loss in found] == [term, term]
    assert found[1].sentence().endswith(f", by what the causes do to the model's own {term}" if term else "0.2")


def test_an_axis_that_does_not_count_neither_makes_nor_spoils_a_name():
    both = push({"Fx": "0.5*u", "Fz": "w"}, ("Fx", "Fz"))
    flights = [shifted(f, {"Fz": 0.5 * f.columns["w"] * flag}, (0,))
               for flag, f in zip(COMPARED, map(flight, (1, 2, 3, 4)))]  # fmt: skip
    there = [shifted(f, {"Fz": 0.5 * f.columns["w"]}, (0,)) for f in map(flight, (5, 6))]
    # half of it: what the cause takes off of Fz it puts on with the other sign
    absent = [shifted(f, {"Fx": 0.25 * f.columns["u"], "Fz": 0.25 * f.columns["w"]}, (0,)) for f in map(flight, (5, 6))]
    assert judged(both, flights, there, COMPARED)[0] == ["push"]
    assert judged(both, flights, absent, COMPARED)[0] == []
    assert _of_forces(wrench_pairs((BASE, made([(both, {"c": 0.5})])), BASE, there), 0.05) == []
    silent = autoregression([np.zeros((500, 1))], [np.arange(500) == 0], 6)
    assert silent.coefficients.tolist() == [[1.0, 0, 0, 0, 0, 0, 0]]


@pytest.mark.parametrize("compared", [np.ones(4, bool), COMPARED], ids=["alone", "with references"])
@pytest.mark.parametrize("size", [0.0, 0.015])
def test_constant_errors_do_not_hide_what_all_flights_lack(size, compared):
    effect = push({"Fz": "u*v"}, ("Fz",))
    signs = size * VEHICLE.mass * 9.81 * np.array([1.0, -1.0, 1.0, -1.0, 1.0])
    whole = [shifted(f, {"Fz": 0.03 * f.columns["u"] * f.columns["v"] + c})
             for f, c in zip(map(flight, (1, 2, 3, 4, 5)), signs)]  # fmt: skip
    names, judge = judged(effect, whole[:4], whole[4:], compared, "always")
    assert names == ["push"] and judge.common().floor[2] < 0.1 * judge.common().old.mean()[2]


@pytest.mark.parametrize("seconds", [(60, 60, 60), (60, 20, 20, 20), (60, 12, 12, 12)])
def test_noise_repeats_nothing_however_long_the_flights_are(seconds):
    rng, alarms = np.random.default_rng(0), 0
    for _ in range(60):
        signals = []
        for n in (int(28 * s) for s in seconds):
            still = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
            noise = rng.standard_normal((n, 6))
            signals.append(Signal(noise, np.arange(n) == 0, np.arange(n) / 28.0, still, np.zeros((n, 6, 1))))
        alarms += bool(search(signals, [True] * len(signals), 0.01))
    assert alarms <= 3  # binomial of 0.01: more has a probability of 0.0003


def test_flights_with_and_without_a_captured_attitude_are_judged_by_what_both_have():
    flights = [captured(s, lever=(0.03, 0, 0)) for s in (1, 2)] + [captured(3, lever=(0.03, 0, 0), onboard_gain=0.0)]
    level = identify.examine(flights, {})
    gains = held_out.gains([*level.effects, *level.ties], flights, corrected=False)
    assert np.nanmin(gains["imu_lever_arm"].removed) > 0.9


def test_walls_without_a_ceiling_are_asked():
    room = room_of({"north": [-4, 4], "east": [-4, 4]})
    vehicle, walls = vehicle_of(BASE, room=room), in_room(CAUSES, room)["proximity"]
    assert list(columns_of(walls, flight(1), vehicle, {})) == ["gain"]
    near = [flight(s, x=3.4 + 0.3 * np.sin(0.01 * np.arange(3000))) for s in (1, 2, 3, 4)]
    made_so = [replace(f, measured=f.measured + 0.3 * flag * columns_of(walls, f, vehicle, {})["gain"])
               for f, flag in zip(near, COMPARED)]  # fmt: skip
    mixed = gather_design(made_so, {"proximity": walls}, vehicle).witnessed(range(4), COMPARED)
    test = mixed.best("proximity", "changed", (), mixed.pooled("changed"), walls.parts)
    assert test.p < 1e-6 and test.value[0] == pytest.approx(0.3, rel=0.1)


def test_a_users_cause_that_names_no_axis_may_show_in_all(tmp_path):
    path = tmp_path / "lift.py"
    path.write_text(
        "from quasi.gap.effect import Effect, Parameter\n"
        "EFFECT = Effect(id='own_lift', level='forces', sentence='s', equation='e', source='s',\n"
        "    parameters={'c': Parameter('N', 0.0, 's', -5, 5, 0.1)}, terms=lambda v: {'c': {'Fz': 'w'}})\n"
    )
    assert effect_of(path).channels == AXES


def test_settling_the_change_of_a_tie_leaves_what_always_was():
    def tie(since, size):
        turned = {n: {a: {"value": s * size} for a in ("roll", "pitch", "yaw")}
                  for n, s in (("imu_misalignment", 1), ("mocap_misalignment", -1))}  # fmt: skip
        return {"ids": list(turned), "since": since, "parameters": turned}

    levels = [Level("sensors", ties=[tie("changed", 0.03), tie("always", 0.01)])]
    found = [document(levels, (c, "changed"))["reference"] for c in ("imu_misalignment", "mocap_misalignment")]
    assert found[0] == found[1] == {"imu": {"misalignment": [0.01] * 3}}


@pytest.mark.parametrize("factor", [0.8, 2.0, 2.5])
def test_a_thrust_factor_acts_with_the_whole_of_its_range(factor):
    one = flight(1)
    model = made([(CAUSES["thrust_factor"], {"factor": factor - 1.0})])
    assert (shown(model, BASE, one)[:, 2] / one.predicted[:, 2]).mean() == pytest.approx(factor, rel=1e-3)


@pytest.mark.parametrize(("one", "other"), [("((u+v)^-2)^0.5", "(u+v)^-1"), ("((u+v)^2)^0.5", "u+v")])
def test_the_size_of_a_sum_is_not_the_sum(one, other):
    assert canonicalise(parse(one))[1] != canonicalise(parse(other))[1]


@pytest.mark.parametrize(("with_the_other", "words"), [
    ((6.0, 1e-9), ""), ((1.0, 0.3), "with body_drag in place of rotor_drag, which look alike, p = 0.3"),
    ((-6.0, 1e-9), "with body_drag in place of rotor_drag, which look alike, it has the other sign"),
])  # fmt: skip
def test_a_name_holds_with_every_cause_of_a_tie(monkeypatch, with_the_other, words):
    """Drag along all axes is a tie of drags; what rotor drag leaves of it in climbs was named axial inflow."""

    class Together:
        def pooled(self, since):
            return []

        def test(self, offer, given, pooled):
            other = offer.cause == "axial_inflow" and "body_drag" in {o.cause for o in given}
            value, p = with_the_other if other else (6.0, 1e-9)
            count = len(offer.which)
            return tests_on.Test(offer, np.full(count, value), np.eye(count), 1.0, value**2, p)

    asked = {n: CAUSES[n] for n in ("rotor_drag", "body_drag", "axial_inflow")}
    tests = {n: Together().test(Candidate(n, "changed", (0,)), [], []) for n in asked}
    monkeypatch.setattr(identify_forces, "hear", lambda _, __, test, *___: (test.p, 1.0))
    sought = SimpleNamespace(
        mixed=Together(), study=None, level={"changed": 1e-3}, flown=None, ranking=[], passed={},
        rules=SimpleNamespace(is_excessive=lambda _: False),
    )  # fmt: skip
    named = [Cause(asked["axial_inflow"], "changed", {}, {}, tests["axial_inflow"], [])]
    tied = [("changed", Tie([tests["rotor_drag"], tests["body_drag"]], 3.0))]
    kept, ties, vague = identify_forces._widened(named, tied, [], sought, COMPARED, asked, {})
    assert ([c.effect.id for c in kept] == ["axial_inflow"]) is not bool(words) and len(ties) == 1
    assert {n: why for n, (_, why) in vague.items()} == ({"axial_inflow": words} if words else {})


def test_a_weak_rotor_acts_through_the_thrust_differences_of_yaw_but_for_those_next_to_a_velocity():
    document = copy.deepcopy(BASE.document)
    for text, size in (("(q)*(U_p^(1.0))", 3e-9), ("(v)*(U_q^(1.0))", 5e-9)):
        term = {"name": text, "expression": text, "coefficient": size, "std": 0.0, "unit": "N m", "given": True}
        document["axes"]["Mz"]["terms"].append(term)
    model, effect = Model(document), CAUSES["rotor_effectiveness"]
    one = replace(flight(1), model=model)
    one = replace(one, predicted=model.predict_columns(one.columns)[list(AXES)].to_numpy())
    weak = shown(made([(effect, {"rotor3": -0.05})], model), model, one) - one.predicted
    column = columns_of(effect, one, vehicle_of(model), {})["rotor3"]
    assert weak[:, 5] == pytest.approx(-0.05 * column[:, 5], abs=1e-3 * np.abs(weak[:, 5]).max())
    left = model.airframe.left[2]
    assert column[:, 5] == pytest.approx(3e-9 * one.columns["q"] * left * one.columns["w3"] ** 2, rel=1e-6)
    # and the model's own term takes up nothing of it by the trim of the others
    own = dict(base_columns(replace(one, columns={**one.columns, "w3": one.columns["w3"] + 40.0})))
    again = dict(base_columns(one))
    (name,) = [n for n in own if "(q)*(U_p" in n]
    along = [float(np.polyfit(one.columns["q"], c[name][:, 5], 1)[0]) for c in (own, again)]
    assert along[0] == pytest.approx(along[1], abs=0.1 * 2 * 1500.0 * 40.0)


@pytest.mark.parametrize(("excluded", "matters"), [((), True), ((5,), False)])
def test_a_correction_of_what_the_model_does_not_know_explains_nothing(excluded, matters):
    """A gyro's scale changed the yaw moment, of which the model explains nothing, and the gap was "explained"."""
    held = [shifted(flight(3), {}, excluded)]
    wave = 1e-3 * np.sin(held[0].t)
    table = pd.DataFrame(dict(held[0].columns))
    sides = [([shifted(held[0], {"Mz": share * wave}, excluded)], {"f3": table}) for share in (1.0, 0.5)]
    assert correction_matters(BASE, *sides, [0.5], 0.05) is matters
