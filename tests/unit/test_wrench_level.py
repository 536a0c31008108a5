"""Forces and moments of flights whose causes are known exactly: large nonlinear ones, and one along one axis only."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from test_unexplained import RATE, ROWS, ground, smooth  # noqa: F401
from test_unexplained import flight as long_flight

from quasi.gap.catalogue import catalogue, whole_of
from quasi.gap.effect import Limits, vehicle_of
from quasi.gap.extension import extend
from quasi.gap.flights.instruments import reread
from quasi.gap.levels.forces import held_out, nonlinear
from quasi.gap.levels.forces import identify as examination
from quasi.gap.levels.forces import search as sought
from quasi.gap.levels.forces.design import gather_design, refit
from quasi.gap.levels.forces.error_reduction import after, wrench_score
from quasi.gap.levels.forces.held_out import everything
from quasi.gap.levels.forces.identify import examine
from quasi.gap.levels.forces.left_out import LeftOut, residual_of_others
from quasi.gap.materiality import Cause
from quasi.gap.selection import UNPHYSICAL, Named, Tie
from quasi.gap.statistics import mixed as tests_on
from quasi.gap.statistics.candidates import Candidate
from quasi.gap.statistics.scores import Score
from quasi.model.model import AXES, Model

EFFECTS = {n: catalogue()[n] for n in ("ground_effect", "mass", "thrust_factor", "rotor_speed_scale", "body_drag")}
SHORT = 3000  # rows of a flight, where those of `test_unexplained` are more than a test needs


def flight(ground, seed, rows=SHORT):  # noqa: F811
    return long_flight(ground, seed, rows=rows)


def low(ground, seed, has, values, affected):  # noqa: F811
    """A flight between 8 cm and a metre above the floor, with a cause exactly as its equation has it."""
    plain = flight(ground, seed, ROWS)
    heights = 0.1 + 0.35 * np.abs(smooth(np.random.default_rng([seed, 5]), 1.0))
    plain = dataclasses.replace(plain, columns={**plain.columns, "z": -heights})
    if not affected:
        return plain
    whole = whole_of(EFFECTS[has], plain, vehicle_of(ground[1]), values)
    return dataclasses.replace(plain, measured=plain.measured + whole)


@pytest.mark.parametrize(
    ("has", "values", "references"),
    [("ground_effect", {"c": 8.0}, 0), ("ground_effect", {"c": 8.0}, 4), ("rotor_speed_scale", {"scale": 0.15}, 4)],
)
def test_a_large_cause_is_estimated_right_with_and_without_reference_flights(ground, has, values, references):  # noqa: F811
    compared = [k >= references for k in range(references + 4)]
    flights = [low(ground, k, has, values, flag) for k, flag in enumerate(compared)]
    held = [low(ground, 90, has, values, True)]
    model = Model(ground[1].document, "test")
    vehicle = vehicle_of(model)
    found = examine(flights, compared, held, model, EFFECTS, vehicle, 0.01, 0.05, "more", "test")
    stand_in = {c.effect.id: c for c in (*found.causes, *found.stand_ins)}
    assert list(stand_in) == [has], [t.offer.cause for t in found.ranking[:3]]
    [(name, size)] = values.items()
    cause = stand_in[has]
    assert cause.since == ("changed" if references else "always")
    assert cause.value[name] == pytest.approx(size, rel=0.08)
    assert abs(cause.value[name] - size) < 3.0 * cause.std[name]
    # and the best that all causes together leave is what noise leaves, the bend of the cause included
    left = everything(found.study, EFFECTS, vehicle, compared, found.study.values[-1])(held[0])
    noise = low(ground, 90, has, values, False).residual
    assert np.mean(left[:, 2] ** 2) < 1.3 * np.mean(noise[:, 2] ** 2)


def quick(ground, seed):  # noqa: F811
    """A flight whose rotors speed up and slow down within hundredths of a second."""
    plain, rng = flight(ground, seed), np.random.default_rng([seed, 6])
    columns = dict(plain.columns)
    for rotor in ("w1", "w2", "w3", "w4"):
        columns[rotor] = 2110.0 + smooth(rng, 60.0, 0.02, SHORT)
        columns[f"{rotor}_dot"] = np.gradient(columns[rotor]) * RATE
    predicted = ground[1].predict_columns(pd.DataFrame(columns))[list(AXES)].to_numpy()
    made = dataclasses.replace(plain, columns=columns, measured=plain.residual + predicted, predicted=predicted)
    made.__dict__.pop("_slopes", None)
    return made


@pytest.mark.parametrize("lags", [(0.0, 0.03), (0.004, 0.03), (0.0, 0.004)])
def test_late_inflow_is_found_whatever_its_size(ground, lags):  # noqa: F811
    """Reference flights have the first lag, all others the second; the slope at nothing holds for a few ms only."""
    model = Model(ground[1].document, "test")
    vehicle, effect = vehicle_of(model), catalogue()["inflow_lag"]

    def made(k):
        plain = quick(ground, k)
        whole = whole_of(effect, plain, vehicle, {"tau": lags[k >= 4]})
        return dataclasses.replace(plain, measured=plain.measured + whole)

    flights, held, compared = [made(k) for k in range(8)], [made(90)], [k >= 4 for k in range(8)]
    effects = {n: catalogue()[n] for n in ("inflow_lag", "telemetry_delay", "thrust_curve", "thrust_factor")}
    found = examine(flights, compared, held, model, effects, vehicle, 0.01, 0.05, "more", "test")
    assert [c.effect.id for c in found.causes] == ["inflow_lag"], found.ranking[:3]
    [cause] = found.causes
    assert cause.value["tau"] == pytest.approx(lags[1] - lags[0], rel=0.1)
    assert abs(cause.value["tau"] - lags[1] + lags[0]) < 3.0 * cause.std["tau"]


def test_a_cause_that_one_axis_has_and_another_has_not_is_no_name(ground):  # noqa: F811
    """Drag along x alone: as body drag, half of it along each axis, it would be wrong along both."""

    def forward(k, share):
        plain = flight(ground, k)
        if k < 4:
            return plain
        drag = whole_of(EFFECTS["body_drag"], plain, vehicle_of(ground[1]), {"c": 0.03})
        return dataclasses.replace(plain, measured=plain.measured + drag * np.array([1.0, share, share, 1.0, 1.0, 1.0]))

    model = Model(ground[1].document, "test")
    for share in (1.0, 0.0):
        flights, held = [forward(k, share) for k in range(8)], [forward(90, share)]
        found = examine(
            flights, [k >= 4 for k in range(8)], held, model, EFFECTS, vehicle_of(model), 0.01, 0.05, "more", "test"
        )
        assert [c.effect.id for c in found.causes] == (["body_drag"] if share else [])
        if not share:
            assert "axes differ" in found.contradicted["body_drag"][1]


def test_flights_that_differ_too_much_are_no_cause_however_alike_their_manoeuvres(ground):  # noqa: F811
    """Drag that each flight has its own size of: every stretch of a flight agrees, the flights do not."""
    model = Model(ground[1].document, "test")
    drag = EFFECTS["body_drag"]

    def made(k, size):
        plain = flight(ground, k, ROWS)
        whole = whole_of(drag, plain, vehicle_of(model), {"c": size})
        return dataclasses.replace(plain, measured=plain.measured + whole)

    for sizes, named in (([0.0] * 4 + [0.030, 0.017, -0.003, 0.015], []), ([0.0] * 4 + [0.015] * 4, ["body_drag"])):
        flights = [made(k, size) for k, size in enumerate(sizes)]
        compared, held = [k >= 4 for k in range(8)], [made(90, 0.015)]
        study = gather_design(flights, {"body_drag": drag}, vehicle_of(model))
        offer = Candidate("body_drag", "changed", (0,))
        assert study.mixed(range(8), compared).test(offer, (), ["body_drag"]).p < 0.005
        found = examine(flights, compared, held, model, {"body_drag": drag}, vehicle_of(model), 0.01, 0.05, "m", "test")
        assert [c.effect.id for c in found.causes] == named


def test_what_all_flights_have_is_no_change_whatever_the_model_s_terms_take_up(ground):  # noqa: F811
    """Rotor speeds late by 4 ms in each flight: a few reference flights agree on it with many compared ones."""
    model = Model(ground[1].document, "test")
    vehicle, delay = vehicle_of(model), catalogue()["telemetry_delay"]

    def late(k):
        plain = flight(ground, k)
        return dataclasses.replace(plain, measured=plain.measured + whole_of(delay, plain, vehicle, {"delay": 0.004}))

    flights, flags = [late(k) for k in range(12)], [False] * 2 + [True] * 10
    mixed = gather_design(flights, {"telemetry_delay": delay}, vehicle).mixed(range(12), flags)
    offer = Candidate("telemetry_delay", "changed", (0,))
    assert delay.absorbed_by_model and mixed.pooled("always") == []
    assert mixed.test(offer).p < 1e-3  # did reference flights not count
    beside = mixed.test(offer, (), mixed.pooled("changed"))
    assert beside.p > 0.05 and abs(beside.value[0]) < 2.0 * beside.std[0]


def test_what_held_out_flights_do_not_show_has_to_be_surer_by_itself(ground, monkeypatch):  # noqa: F811
    model = Model(ground[1].document, "test")
    drag = EFFECTS["body_drag"]

    def made(k):
        plain = flight(ground, k)
        if k < 4:
            return plain
        whole = whole_of(drag, plain, vehicle_of(model), {"c": 0.015})
        return dataclasses.replace(plain, measured=plain.measured + whole)

    monkeypatch.setattr(held_out, "EXCITED_SHARE", 10.0)  # no held-out flight shows that much
    flights, held, compared = [made(k) for k in range(8)], [made(90)], [k >= 4 for k in range(8)]
    for unheard, named in ((None, ["body_drag"]), (1e-45, [])):
        found = examine(
            flights, compared, held, model, {"body_drag": drag}, vehicle_of(model), 0.01, 0.05, "m", "test", unheard
        )
        assert [c.effect.id for c in found.causes] == [c.effect.id for c in found.unjudged] == named
    assert "held-out flights do not show it" in found.contradicted["body_drag"][1]


def hasty(ground, seed, size):  # noqa: F811
    """A slow flight with one fast dash, at another time in each: drag shows for a few seconds of it."""
    plain = flight(ground, seed)
    t = plain.columns["t"]
    dash = 0.05 + np.exp(-(((t - 4.0 - 5.0 * (seed % 7)) / 2.0) ** 2))
    columns = plain.columns | {n: 2.0 * plain.columns[n] * dash for n in ("u", "v")}
    predicted = ground[1].predict_columns(pd.DataFrame(columns))[list(AXES)].to_numpy()
    made = dataclasses.replace(plain, columns=columns, measured=plain.residual + predicted, predicted=predicted)
    made.__dict__.pop("_slopes", None)
    return dataclasses.replace(
        made, measured=made.measured + whole_of(EFFECTS["body_drag"], made, vehicle_of(ground[1]), {"c": size})
    )


def test_what_every_flight_shows_for_seconds_only_all_of_them_are_sure_of_together(ground, monkeypatch):  # noqa: F811
    """Blocks of one held-out flight, drawn anew, may well leave its only dash out."""
    model = Model(ground[1].document, "test")
    flights, held = [hasty(ground, k, 0.03) for k in range(5)], [hasty(ground, 90, 0.03)]

    def names():
        found = examine(flights, [True] * 5, held, model, EFFECTS, vehicle_of(model), 0.01, 0.05, "m", "test")
        return [(c.effect.id, c.since) for c in found.causes]

    assert names() == [("body_drag", "always")]

    class Alone:
        """The held-out flight's word alone."""

        def __init__(self, study, compared):
            pass

        def __call__(self, causes, fitted_anew):
            return Score(np.zeros((0, 6)), np.zeros(0))

    monkeypatch.setattr(held_out, "LeftOut", Alone)
    assert names() == []


def test_flights_left_out_are_judged_by_what_the_others_tell(ground):  # noqa: F811
    """The same errors by another way: a model extended and fitted anew for each flight, and what it leaves there."""
    model = Model(ground[1].document, "test")
    vehicle, drag = vehicle_of(model), EFFECTS["body_drag"]
    flights = [hasty(ground, k, 0.03) for k in range(4)]
    study = gather_design(flights, {"body_drag": drag}, vehicle)
    everyone = [True] * 4
    offer = Candidate("body_drag", "always", (0,))
    cause = Cause(drag, "always", {}, {}, study.witnessed(range(4), everyone).test(offer), [])
    for causes, anew in (([], False), ([cause], False), ([cause], True)):
        expected = []
        for k, left_out in enumerate(flights):
            rest = [f for f in range(4) if f != k]
            size = float(study.mixed(rest, everyone[1:]).test(offer).value[0]) if causes else 0.0
            changes = refit(study, rest, everyone[1:], {("body_drag", "always"): {0: size}}) if anew else None
            document = extend(model, [(drag, {"c": size})], vehicle, "other", "test", changes)
            expected.append(wrench_score([left_out], after(Model(document, "other"), model), True))
        found = LeftOut(study, everyone)(causes, anew)
        assert found.weight == pytest.approx(np.concatenate([e.weight for e in expected]))
        assert found.values == pytest.approx(np.concatenate([e.values for e in expected]), rel=1e-6)


def test_a_flight_that_made_the_model_is_judged_by_what_the_other_ones_made_of_it(ground):  # noqa: F811
    """The same residual by another way, as above."""
    model = Model(ground[1].document, "test")
    vehicle = vehicle_of(model)
    flights = [hasty(ground, k, 0.03) for k in range(4)]
    study = gather_design(flights, {}, vehicle)
    left = residual_of_others(study, flights[:3])  # the last is compared: it teaches nothing
    for k in range(3):
        rest = [f for f in range(3) if f != k]
        changes = refit(study, rest, [False, False], {})
        document = extend(model, [], vehicle, "other", "test", changes)
        expected = after(Model(document, "other"), model)(flights[k])
        assert left(flights[k]) == pytest.approx(expected, abs=1e-9)
        assert np.abs(changes).max() > 0.0


def test_what_rotors_do_is_told_by_their_true_speeds_where_the_logged_ones_are_wrong(ground):  # noqa: F811
    """A leaning rotor makes 1.44 times less of a speed that is logged a fifth too high: that is no smaller lean."""
    model = Model(ground[1].document, "test")
    vehicle, effects = vehicle_of(model), {n: catalogue()[n] for n in ("rotor_speed_scale", "rotor_tilt", "mass")}
    scale, lean = 1.2, {"rotor2": 0.08}

    def made(k, affected):
        plain = flight(ground, k)
        if not affected:
            return plain
        leaning = plain.measured + whole_of(effects["rotor_tilt"], plain, vehicle, lean)
        logged = {n: scale * plain.columns[n] for w in ("w1", "w2", "w3", "w4") for n in (w, f"{w}_dot")}
        return dataclasses.replace(reread(plain, logged), measured=leaning)

    flights, compared = [made(k, k >= 4) for k in range(8)], [k >= 4 for k in range(8)]
    found = examine(flights, compared, [made(90, True)], model, effects, vehicle, 0.01, 0.05, "more", "test")
    named = {c.effect.id: c for c in (*found.causes, *found.stand_ins)}
    assert sorted(named) == ["rotor_speed_scale", "rotor_tilt"]
    assert named["rotor_speed_scale"].value["scale"] == pytest.approx(scale - 1.0, rel=0.02)
    assert list(named["rotor_tilt"].value) == list(lean)
    assert named["rotor_tilt"].value["rotor2"] == pytest.approx(lean["rotor2"], rel=0.03)
    # and so it is the same in the extended model, which reads the logged speeds the same way
    left = wrench_score([flights[-1]], after(Model(found.extended, "more"), model)).mean()
    noise = wrench_score([flight(ground, 7)], lambda f: f.residual).mean()
    assert (left[:2] < 1.3 * noise[:2]).all()


def test_several_angles_at_once_are_no_leaning_rotor(ground):  # noqa: F811
    """Wind that the model's terms do not quite follow looked like two rotors that lean against each other."""
    model = Model(ground[1].document, "test")
    vehicle, effects = vehicle_of(model), {n: catalogue()[n] for n in ("rotor_tilt", "mass")}

    def made(k, affected):
        plain = flight(ground, k)
        lean = {"rotor1": 0.04, "rotor2": -0.03, "rotor3": 0.03}
        turned = plain.measured + whole_of(effects["rotor_tilt"], plain, vehicle, lean)
        return dataclasses.replace(plain, measured=turned) if affected else plain

    flights, compared = [made(k, k >= 4) for k in range(8)], [k >= 4 for k in range(8)]
    found = examine(flights, compared, [made(90, True)], model, effects, vehicle, 0.01, 0.05, "more", "test")
    assert [c.value for c in (*found.causes, *found.stand_ins) if len(c.value) > 1] == []


def test_a_cause_that_is_contradicted_leaves_no_twin_named_alone(ground, monkeypatch):  # noqa: F811
    """Stronger rotors, or speeds logged too low: what speaks against the one alone is what the model makes of it."""
    model = Model(ground[1].document, "test")
    vehicle, effects = vehicle_of(model), {n: catalogue()[n] for n in ("rotor_speed_scale", "thrust_factor", "mass")}

    def made(k, affected):
        plain = flight(ground, k)
        whole = whole_of(effects["thrust_factor"], plain, vehicle, {"factor": 0.3 * affected})
        return dataclasses.replace(plain, measured=plain.measured + whole)

    flights, compared = [made(k, k >= 4) for k in range(8)], [k >= 4 for k in range(8)]
    torn, real = iter([True]), sought._contradicted

    def contradicted(causes, ties, *rest):
        said = real(causes, ties, *rest)
        tests = [t for _, tie in ties for t in tie.tests if t.offer.cause == "rotor_speed_scale"]
        return {**said, "rotor_speed_scale": (tests[0], "axes differ")} if tests and next(torn, False) else said

    monkeypatch.setattr(sought, "_contradicted", contradicted)
    found = examine(flights, compared, [made(90, True)], model, effects, vehicle, 0.01, 0.05, "more", "test")
    assert next(torn, False) is False and not found.causes
    [(since, tie)] = found.ties
    assert since == "changed" and {t.offer.cause for t in tie.tests} == {"rotor_speed_scale", "thrust_factor"}
    assert "rotor_speed_scale" not in found.contradicted


def test_what_was_significant_beside_a_cause_that_axes_contradict_alone_goes_with_it(monkeypatch):
    """Rotor drag mends what body drag does wrong: without it there is nothing of it. Ground effect stands by itself."""
    torn = {"body_drag": 5.0, "rotor_drag": 1.0, "ground_effect": 1.0}
    effects = {n: catalogue()[n] for n in torn}

    class Together:
        def pooled(self, since):
            return []

        def test(self, offer, given, pooled):
            alone = offer.cause == "rotor_drag" and "body_drag" not in {o.cause for o in given}
            p, value = (0.62, 0.5) if alone else (1e-9, 6.0)
            count = len(offer.which)
            return tests_on.Test(offer, np.full(count, value), np.eye(count), 1.0, value**2, p)

    mixed = Together()
    heard = {}  # p-values on the axes where the form holds
    monkeypatch.setattr(
        examination, "hear", lambda _, __, test, *___: (heard.get(test.offer.cause, test.p), torn[test.offer.cause])
    )

    def named(*names):
        offers = [Candidate(n, "changed", (0,)) for n in names]
        found = [Cause(effects[o.cause], o.since, {}, {}, mixed.test(o, offers, []), []) for o in offers]
        sought = SimpleNamespace(
            mixed=mixed, study=None, level={"changed": 1e-3}, flown=None, ranking=[], passed={},
            rules=SimpleNamespace(is_excessive=lambda _: False),
        )  # fmt: skip
        kept, ties, vague = examination._widened(found, tied, [], sought, np.ones(3, bool), effects, within)
        left.extend(ties)
        return kept, vague

    monkeypatch.setattr(examination, "share_on_axes", lambda *_: shared)
    shared, tied, left, within = 0.0, [], [], {}
    kept, vague = named("body_drag", "rotor_drag", "ground_effect")
    assert [c.effect.id for c in kept] == ["ground_effect"]
    within = {"ground_effect": Limits([(0.0, 1.0)])}  # its 6 +- 1 is physical no more
    assert named("ground_effect")[1]["ground_effect"][1] == UNPHYSICAL
    within = {}
    assert "widens its errors 5.0 times" in vague["body_drag"][1]
    assert vague["rotor_drag"][1] == "p = 0.62 without body drag, whose axes differ"
    # a tie whose axes differ goes as well, with all its members
    pair = [mixed.test(Candidate(n, "changed", (0,)), [], []) for n in ("body_drag", "rotor_drag")]
    tied = [("changed", Tie(pair, 3.0))]
    kept, vague = named("ground_effect")
    assert [c.effect.id for c in kept] == ["ground_effect"] and not left
    assert all("widens its errors 5.0 times" in vague[n][1] for n in ("body_drag", "rotor_drag"))
    # what explains too small a share of it on the same axes may be the error of its form
    monkeypatch.setattr(examination, "FORM_ERROR", 1.5)
    tied, shared = [], 1.0
    kept, vague = named("body_drag", "ground_effect")
    assert kept == [] and "error of the form" in vague["ground_effect"][1]
    torn["body_drag"] = 1.0
    assert [c.effect.id for c in named("body_drag", "rotor_drag")[0]] == ["body_drag", "rotor_drag"]
    # the moments of a wind have no known form: a cause that acts on them may be it, one that acts on forces alone not
    effects |= {n: catalogue()[n] for n in ("wind", "cg_offset", "tether")}
    torn |= {"wind": 5.0, "cg_offset": 1.0, "tether": 1.0}
    shared = 0.0
    kept, vague = named("wind", "cg_offset", "tether")
    assert [c.effect.id for c in kept] == ["tether"] and "error of the form" in vague["cg_offset"][1]
    # what only axes without a say show is no cause
    heard["rotor_drag"] = 0.04
    kept, vague = named("body_drag", "rotor_drag")
    assert [c.effect.id for c in kept] == ["body_drag"]
    assert vague["rotor_drag"][1] == "p = 0.04 on the axes where its form holds"
    # nor is what is not significant with standard errors as wide as its axes are apart: 36 / 2^2 is 3 standard errors
    torn["ground_effect"] = 2.0
    assert [c.effect.id for c in named("ground_effect")[0]] == []
    torn["ground_effect"] = 1.5
    assert [c.effect.id for c in named("ground_effect")[0]] == ["ground_effect"]


@pytest.mark.parametrize(("share", "tied"), [(0.07, True), (0.02, False)])
def test_mass_and_inertia_that_grow_in_proportion_may_be_weaker_rotors(share, tied):
    """Air thinner by 7 % and 7 % more mass and inertia fly alike; with 2 % more mass it is not the air."""
    effects = {n: catalogue()[n] for n in ("mass", "inertia", "thrust_factor")}
    own = np.diag([9e-4, 1.1e-3, 1.7e-3])
    about = SimpleNamespace(mass=0.43, inertia=own)

    class Rotors:
        columns = SimpleNamespace(causes={"thrust_factor": [0, 1]})

        def pooled(self, since):
            return []

        def test(self, offer, given, pooled):
            assert offer == Candidate("thrust_factor", "changed", (0, 1)) and not given
            return tests_on.Test(offer, np.array([-share, -share]), np.eye(2), 1.0, 400.0, 1e-20)

    def named(cause, sizes, stds):
        offer = Candidate(cause, "changed", tuple(range(len(sizes))))
        return Named(tests_on.Test(offer, np.array(sizes), np.diag(np.square(stds)), 1.0, 100.0, 1e-9), [])

    turned = named("inertia", 0.07 * np.diag(own), 0.004 * np.diag(own))
    found, ties = sought._with_weaker_rotors(
        [named("mass", [share * 0.43], [0.01 * 0.43]), turned], [], effects, Rotors(), about
    )
    assert [n.test.offer.cause for n in found] == ([] if tied else ["mass", "inertia"])
    assert [[t.offer.cause for t in tie.tests] for _, tie in ties] == ([["thrust_factor", "mass", "inertia"]] * tied)
    # one of them alone is what it is
    assert sought._with_weaker_rotors([turned], [], effects, Rotors(), about) == ([turned], [])


@pytest.mark.parametrize(("share", "tied"), [(-0.07, True), (-0.02, False)])
def test_weaker_rotors_and_less_inertia_in_proportion_may_be_another_mass(share, tied):
    """With 8 % more mass, seven per cent less thrust, and moments that it did not change."""
    effects = {n: catalogue()[n] for n in ("mass", "inertia", "thrust_factor", "rotor_speed_scale")}
    own = np.diag([9e-4, 1.1e-3, 1.7e-3])

    class Rotors:
        columns = SimpleNamespace(causes={"mass": [0]})

        def pooled(self, since):
            return []

        def test(self, offer, given, pooled):
            assert offer == Candidate("mass", "changed", (0,)) and not given
            return tests_on.Test(offer, np.array([0.034]), np.eye(1), 1.0, 400.0, 1e-20)

    def tested(cause, sizes, stds):
        offer = Candidate(cause, "changed", tuple(range(len(sizes))))
        return tests_on.Test(offer, np.array(sizes), np.diag(np.square(stds)), 1.0, 100.0, 1e-9)

    turned = Named(tested("inertia", share * np.diag(own), 0.004 * np.diag(own)), [])
    tie = Tie(
        [tested("thrust_factor", [-0.07, -0.07], [0.005, 0.02]), tested("rotor_speed_scale", [0.03], [0.01])], 2.0
    )
    about = SimpleNamespace(mass=0.43, inertia=own)
    found, ties = sought._with_another_mass([turned], [("changed", tie)], effects, Rotors(), about)
    assert [n.test.offer.cause for n in found] == ([] if tied else ["inertia"])
    ids = ["mass"] * tied + ["thrust_factor", "rotor_speed_scale"]
    assert [[t.offer.cause for t in one.tests] for _, one in ties] == [ids]
    # without an inertia it is what it was
    assert sought._with_another_mass([], [("changed", tie)], effects, Rotors(), about) == ([], [("changed", tie)])


def test_a_component_that_is_not_there_moves_a_wind_by_little():
    old, new = {"north": 2.4, "east": -1.8, "down": -0.6}, {"north": 2.4, "east": -1.8, "down": 0.0}
    assert nonlinear.distance(catalogue()["wind"], new, old) == pytest.approx(0.6 / np.sqrt(2.4**2 + 1.8**2 + 0.6**2))
    assert nonlinear.distance(catalogue()["wind"], {}, old) == pytest.approx(1.0)
    assert nonlinear.distance(catalogue()["rotor_speed_scale"], {"scale": 0.03}, {"scale": 0.02}) == pytest.approx(0.5)
