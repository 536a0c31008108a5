"""The search of forces: what the trim contradicts, and mass or thrust."""

import copy
import dataclasses
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from test_unexplained import ground  # noqa: F401
from test_wrench_level import EFFECTS, flight

from quasi.gap.catalogue import catalogue, whole_of
from quasi.gap.effect import vehicle_of
from quasi.gap.levels.forces import design, nonlinear
from quasi.gap.levels.forces import search as sought
from quasi.gap.levels.forces.axis_consistency import Voice
from quasi.gap.selection import Named, Tie
from quasi.gap.statistics import mixed as tests_on
from quasi.gap.statistics.candidates import Candidate
from quasi.model.model import AXES, Model


def test_a_cause_that_the_trim_contradicts_is_left_out_and_the_others_are_sought_without_it(ground):  # noqa: F811
    """Another mass that the rotors do not carry is none: what stands next to it is found as if it were not asked."""
    model = Model(ground[1].document, "test")
    vehicle = vehicle_of(model)

    def made(k, has, size):
        plain = flight(ground, k)
        whole = whole_of(EFFECTS[has], plain, vehicle, size) if k >= 4 else 0.0
        return dataclasses.replace(plain, measured=plain.measured + whole)

    heavier = {"mass": 0.1 * vehicle.mass}
    flights, compared = [made(k, "mass", heavier) for k in range(8)], np.arange(8) >= 4
    within = {n: e.limits(vehicle) for n, e in EFFECTS.items()}
    asked_of = []

    def contradict(causes):
        asked_of.append([cause for cause, _ in causes])
        return {k: "the trim" for k, (cause, _) in enumerate(causes) if cause == "mass"}

    sides = [sought.seek(flights, EFFECTS, vehicle, compared, 0.01, within, says) for says in (None, contradict)]
    names = [[n.test.offer.cause for n in side.named if n.test.offer.since == "changed"] for side in sides]
    assert names[0] == ["mass"] and "mass" not in names[1]
    assert sides[1].contradicted["mass"][1] == "the trim" and not sides[0].contradicted
    assert asked_of[0] == ["mass"] and "mass" not in asked_of[-1]
    alike = {n: EFFECTS[n] for n in EFFECTS if n != "mass"}
    without = sought.seek(flights, alike, vehicle, compared, 0.01, within)
    assert [n.test.offer for n in sides[1].named] == [n.test.offer for n in without.named]
    assert [[t.offer for t in tie.tests] for _, tie in sides[1].ties] == [
        [t.offer for t in tie.tests] for _, tie in without.ties
    ]


def test_strong_wind_is_found_where_its_slope_in_still_air_hardly_shows_it(ground):  # noqa: F811
    """Drag with the square of airspeed, at a tenth of the wind's speed; moments that no wind changes in truth."""
    airframe, simple = ground
    document = copy.deepcopy(simple.document)
    for axis, expression, coefficient in (
        ("Fx", "(u^2 + v^2 + w^2)^0.5*u", -0.01), ("Fy", "(u^2 + v^2 + w^2)^0.5*v", -0.01), ("Mx", "u*v", 1e-4),
    ):  # fmt: skip
        terms = document["axes"][axis]["terms"]
        terms.append({**terms[0], "name": expression, "expression": expression, "coefficient": coefficient})
        terms[-1]["given"] = True
    for axis in ("Fx", "Fy", "Fz"):
        for term in document["axes"][axis]["terms"]:
            term["coefficient"] *= 0.01 if term["expression"] in ("u", "v", "w") else 1.0
    model, wind = Model(document, "test"), {"north": 4.8, "east": -3.6, "down": 0.0}
    vehicle, asked = vehicle_of(model), {n: catalogue()[n] for n in ("wind", "rotor_drag", "body_drag", "tether")}

    def made(k):
        plain = flight(ground, k)
        columns = {**plain.columns, "u": 0.3 * plain.columns["u"], "v": 0.3 * plain.columns["v"]}
        predicted = model.predict_columns(pd.DataFrame(columns))[list(AXES)].to_numpy()
        slow = dataclasses.replace(
            plain, model=model, columns=columns, predicted=predicted, measured=predicted + plain.residual
        )
        blown = whole_of(catalogue()["wind"], slow, vehicle, wind) * [1, 1, 1, 0, 0, 0] if k >= 4 else 0.0
        return dataclasses.replace(slow, measured=slow.measured + blown)

    within = {n: e.limits(vehicle) for n, e in asked.items()}
    found = sought.seek([made(k) for k in range(8)], asked, vehicle, np.arange(8) >= 4, 0.01, within)
    (named,) = found.named
    assert named.test.offer[:2] == ("wind", "changed") and not found.ties
    assert named.test.value[:2] == pytest.approx([4.8, -3.6], abs=0.3)


def test_a_cause_that_stands_alone_is_sized_by_deviations_from_what_is_neutral(ground, monkeypatch):  # noqa: F811
    """A scale of speeds of 0.86, for 12 magnets in place of 14: neutral is 1, and the deviation is below 0."""
    model, effect = Model(ground[1].document, "test"), catalogue()["rotor_speed_scale"]
    vehicle, compared = vehicle_of(model), np.arange(8) >= 4

    def made(k):
        plain = flight(ground, k)
        return dataclasses.replace(
            plain, measured=plain.measured + (whole_of(effect, plain, vehicle, {"scale": -1 / 7}) if k >= 4 else 0.0)
        )

    tried = []

    def recorded(study, effects, vehicle, values):
        tried.extend(own["rotor_speed_scale"]["scale"] for own in values if "rotor_speed_scale" in own)
        return design.moved(study, effects, vehicle, values)

    monkeypatch.setattr(nonlinear, "moved", recorded)
    study = design.gather_design([made(k) for k in range(8)], {effect.id: effect}, vehicle)
    nonlinear.found_alone(study, {effect.id: effect}, vehicle, compared, 0.01)
    assert tried[-1] == pytest.approx(-1 / 7, abs=0.02)


@pytest.mark.parametrize(
    ("std", "rival_p", "first", "ties"),
    [
        (0.2, 1e-5, "mass", False), (0.8, 1e-5, "mass", True), (0.8, 0.1, "mass", False),
        (0.2, 1e-5, "thrust_factor", False), (0.8, 1e-5, "thrust_factor", True),
    ],
)  # fmt: skip
def test_mass_and_thrust_are_a_tie_where_no_other_axis_than_the_vertical_decides(
    monkeypatch, std, rival_p, first, ties
):
    """std  of each axis on which one of them acts alone: two of force, two of moment"""
    asked_axes = []

    def heard(study, compared, test, pooled, given, channels):
        asked_axes.append(set(channels))
        return [Voice(axis, 1.0, std) for axis in channels]

    monkeypatch.setattr(sought, "voices", heard)

    class Stated:
        columns = SimpleNamespace(causes={"mass": [1], "thrust_factor": [2], "wind": [3]})

        def pooled(self, since):
            return []

        def test(self, offer, given=(), pooled=()):
            return tests_on.Test(offer, np.ones(1), np.eye(1), 1.0, 30.0, 1e-9 if offer.cause == first else rival_p)

    mixed, other = Stated(), "thrust_factor" if first == "mass" else "mass"
    one = mixed.test(Candidate(first, "changed", (0,)))
    wind = mixed.test(Candidate("wind", "changed", (0,)))
    args = (EFFECTS, mixed, None, np.ones(4, bool))
    named, tied = sought._with_mass_or_thrust([Named(one, []), Named(wind, [])], [], *args)
    assert [n.test.offer.cause for n in named] == (["wind"] if ties else [first, "wind"])
    assert [[t.offer.cause for t in tie.tests] for _, tie in tied] == ([[first, other]] if ties else [])
    assert {frozenset(a) for a in asked_axes} == {frozenset({"Fx", "Fy"}), frozenset({"Mx", "My"})}
    # a tie that it stands first in is widened, one that holds both already is left alone
    third = mixed.test(Candidate("wind", "changed", (0,)))
    named, tied = sought._with_mass_or_thrust([], [("changed", Tie([one, third], 1.0))], *args)
    names = [first, other, "wind"] if ties else [first, "wind"]
    assert not named and [t.offer.cause for t in tied[0][1].tests] == names
    both = [("changed", Tie([one, mixed.test(Candidate(other, "changed", (0,)))], 1.0))]
    assert sought._with_mass_or_thrust([], both, *args) == ([], both)


def test_a_rotor_that_the_trim_contradicts_by_itself_leaves_the_others_to_ask():
    """What it contradicts only together with another cause helps the form of that one, if it was accepted later."""

    def cause(name, which, since="changed"):
        effect = catalogue()[name]
        test = SimpleNamespace(offer=Candidate(name, since, which))
        return SimpleNamespace(effect=effect, since=since, value={effect.fitted[n]: 0.1 for n in which}, test=test)

    rotor, cg, wind = cause("rotor_effectiveness", (0, 3, 7)), cause("cg_offset", (0, 1, 2)), cause("wind", (0, 1))

    def against_rotor_4(causes):
        return {k: "why" for k, (_, value) in enumerate(causes) if "rotor4" in value}

    order = [rotor.test.offer, cg.test.offer, wind.test.offer]
    assert sought._against_trim([cg, rotor], against_rotor_4, order) == ({"rotor_effectiveness": frozenset({3})}, {})

    def together(causes):
        names = [name for name, _ in causes]
        return {names.index("rotor_effectiveness"): "why"} if {"rotor_effectiveness", "cg_offset"} <= set(names) else {}

    for accepted, last in ((order, cg), (order[::-1], rotor)):
        found = sought._against_trim([cg, wind, rotor], together, accepted)
        assert found == ({}, {last.effect.id: (last.test, "why")})

    def against_cg(causes):
        return {k: "why" for k, (name, _) in enumerate(causes) if name == "cg_offset"}

    assert sought._against_trim([rotor, cg], against_cg, order) == ({}, {"cg_offset": (cg.test, "why")})
    for says in (lambda causes: {}, None):
        assert sought._against_trim([rotor, cg], says, order) == ({}, {})
    assert sought._against_trim([cause("cg_offset", (0, 1, 2), "always")], against_cg, order) == ({}, {})


def test_of_a_rotor_that_changed_otherwise_than_the_trim_shows_what_all_flights_have_stands():
    """No change of rotor 1 was asked, and a rotor 1 that is weak in all flights lost its name without a word."""

    def one(cause, since, which):
        return Named(tests_on.Test(Candidate(cause, since, which), *[None] * 5), [])

    named = [one("rotor_effectiveness", since, (k,)) for since in ("changed", "always") for k in (0, 1)]
    found = sought._standing([*named, one("mass", "changed", (0,))], {"mass": ()}, {"rotor_effectiveness": {0}})
    assert found == named[1:]


def test_a_cause_that_errors_may_make_is_left_out_with_its_reason(ground, monkeypatch):  # noqa: F811
    model = Model(ground[1].document, "test")
    vehicle = vehicle_of(model)

    def made(k):
        plain = flight(ground, k)
        whole = whole_of(EFFECTS["mass"], plain, vehicle, {"mass": 0.1 * vehicle.mass}) if k >= 4 else 0.0
        return dataclasses.replace(plain, measured=plain.measured + whole)

    flights, compared = [made(k) for k in range(8)], np.arange(8) >= 4
    within = {n: e.limits(vehicle) for n, e in EFFECTS.items()}
    monkeypatch.setattr(sought, "within_errors", lambda flights, compared, cause, *others: cause.effect.id == "mass")
    found = sought.seek(flights, EFFECTS, vehicle, compared, 0.01, within)
    assert "mass" not in [n.test.offer.cause for n in found.named] and "mass" not in found.contradicted
    [(offer, why)] = [(o, w) for o, w in found.passed.items() if w == sought.BY_ERRORS]
    assert offer == Candidate("mass", "changed", (0,))
    assert offer in [t.offer for t in found.ranking]
