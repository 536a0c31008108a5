"""Whether axes agree on a cause: on flights of a plain simulation, see `plain_flights`, and by hand."""

import dataclasses

import numpy as np
import pytest
from plain_flights import flown, simple_model

from quasi.gap.catalogue import catalogue
from quasi.gap.effect import vehicle_of
from quasi.gap.flights.gathering import gather
from quasi.gap.levels.forces.axis_consistency import Voice, contradiction, disagreement, hear, p_together, voices
from quasi.gap.levels.forces.design import gather_design
from quasi.gap.statistics import mixed

EFFECTS = {n: catalogue()[n] for n in ("rotor_effectiveness", "cg_offset", "body_drag", "tether")}


@pytest.fixture(scope="module")
def model():
    return simple_model()


@pytest.fixture(scope="module")
def study(model):
    """Three flights, rotor 2 at 95 %."""
    about = {"mass": model.airframe.mass, "inertia": model.airframe.inertia}
    tables = {f"f{k}": flown(model, k, share=0.95) for k in range(3)}
    flights = [gather(k, t, about, model.airframe, model, 100.0) for k, t in tables.items()]
    return gather_design(flights, EFFECTS, vehicle_of(model))


def same_drag(flight):
    """The force of a drag of 0.1 N s2/m2 (n, 6)."""
    velocity = flight.take("u", "v", "w")
    force = -0.1 * np.linalg.norm(velocity, axis=1)[:, None] * velocity
    return np.hstack([force, np.zeros_like(force)])


def heard(study, values, which):
    offer = mixed.Candidate("rotor_effectiveness", "always", which)
    test = mixed.Test(offer, np.array(values), np.eye(len(which)), 1.0, 1.0, 0.0)
    return {v.axis: v for v in voices(study, [True] * 3, test, [])}


def test_axes_agree_on_the_true_cause_and_contradict_one_that_resembles_it(model, study):
    """Rotor 2 lacks 5 %: lift and both moments tell it. Of rotor 1 as weak, the lift would tell the same, the moment
    about the axis that the two rotors lie on either side of the opposite."""
    true = heard(study, [-0.05], (1,))
    for axis in ("Mx", "My"):
        assert true[axis].amount == pytest.approx(1.0, abs=4.0 * true[axis].std)
        assert true[axis].std < 0.2
    assert contradiction(list(true.values())) == ""
    hubs = np.asarray(model.airframe.hubs)
    assert hubs[0, 0] * hubs[1, 0] < 0 or hubs[0, 1] * hubs[1, 1] < 0
    opposite = heard(study, [-0.05], (0,))
    assert min(v.amount for v in opposite.values()) < -0.8
    assert "one cause acts on both alike" in contradiction(list(opposite.values()))


def test_axes_of_what_changed_are_heard_whatever_the_base_would_take_up_of_the_others(model):
    """The base holds every cause, alike in all flights: of a drag that some have, two of five parts would find their
    way there by the other axes, and be missed on the one that is heard alone."""
    about = {"mass": model.airframe.mass, "inertia": model.airframe.inertia}
    compared = [False] * 3 + [True] * 3
    tables = [flown(model, 10 + k, drag=0.1 * flag) for k, flag in enumerate(compared)]
    flights = [gather(f"f{k}", t, about, model.airframe, model, 100.0) for k, t in enumerate(tables)]
    both = gather_design(flights, EFFECTS, vehicle_of(model))
    test = mixed.Test(mixed.Candidate("body_drag", "changed", (0,)), np.array([0.1]), np.eye(1), 1.0, 1.0, 0.0)
    every = both.witnessed(range(6), compared).pooled("changed")
    assert "body_drag" in every
    found = voices(both, compared, test, every)
    assert len([v for v in found if v.std < 0.1]) >= 2
    for voice in found:
        assert voice.amount == pytest.approx(1.0, abs=4.0 * voice.std), found
    # as much again that all flights have alike on one axis is no change, and no spread between flights
    usual = [dataclasses.replace(f, measured=f.measured + same_drag(f) * [1, 0, 0, 0, 0, 0]) for f in flights]
    for some in (slice(0, 6), slice(1, 5)):
        study = gather_design(usual[some], EFFECTS, vehicle_of(model))
        for voice in voices(study, compared[some], test, every):
            assert voice.amount == pytest.approx(1.0, abs=0.2) and voice.std < 0.5, voice
    # axes without a say do not make a cause significant
    assert hear(both, compared, test, every, (), [v.axis for v in found])[0] == test.p
    [loud, *_] = sorted(found, key=lambda v: v.std)
    assert hear(both, compared, test, every, (), [loud.axis])[0] == p_together([loud], 1) > test.p
    assert hear(both, compared, test, every, (), [])[0] == 1.0


def test_what_contradicts_a_cause_is_a_sure_axis_with_the_other_sign():
    assert contradiction([Voice("Fz", 1.0, 0.1), Voice("My", -0.9, 0.1)])
    assert not contradiction([Voice("Fz", 1.0, 0.1), Voice("My", -0.9, 0.4)])  # could not have seen it
    assert not contradiction([Voice("Fz", 1.0, 0.1), Voice("My", -0.2, 0.05)])  # sure, but small
    assert not contradiction([Voice("Fz", 1.0, 0.3), Voice("My", 0.0, 0.05)])


def test_axes_that_differ_widen_standard_errors_by_how_much_they_do():
    """Two axes 0.6 apart, each known to 0.1: their mean is known to half of that, 0.3, instead of 0.07."""
    apart = [Voice("Fx", 1.0, 0.1), Voice("Fz", 0.4, 0.1)]
    joint = 0.1 / 2.0**0.5
    assert joint * disagreement(apart, joint**-2) == pytest.approx(0.3, rel=1e-9)
    assert joint * disagreement([*apart, Voice("Mz", 0.7, 5.0)], joint**-2) == pytest.approx(0.3)  # which says nothing
    # a test that is less sure by itself holds part of it already
    assert 0.5 * disagreement(apart, 0.5**-2) == pytest.approx((0.25 + 0.09 - joint**2) ** 0.5)
    assert disagreement([Voice("Fx", 1.0, 0.1), Voice("Fz", 0.9, 0.1)], 100.0) == 1.0
    assert disagreement([Voice("Fx", 1.0, 0.1)], 100.0) == 1.0


def test_axes_that_all_show_a_cause_name_it_although_none_agrees_within_its_own_standard_error():
    """An inertia of which three axes show 1.16, 0.81 and 1.15, known to 3 %: its form errs by a sixth, it is there."""
    heard = [Voice("Mx", 1.16, 0.14), Voice("My", 0.81, 0.03), Voice("Mz", 1.15, 0.02)]
    assert 5.0 < 434.0**0.5 / disagreement(heard, 434.0) < 12.0


def test_the_axes_together_are_tested_by_their_weighted_mean():
    """Mean of 1.0 +- 0.5 and 0.5 +- 0.5: 0.75 +- 0.354, which is 2.12 standard errors."""
    assert p_together([Voice("Fx", 1.0, 0.5), Voice("Fz", 0.5, 0.5)], 1) == pytest.approx(0.0339, abs=1e-4)
    assert p_together([], 1) == 1.0


def test_an_axis_that_shows_an_unknown_parameter_of_a_vector_does_not_disagree(study):
    """Of a moved centre of gravity, x is known and y next to nothing: the axis of y may want many times as much."""
    offer = mixed.Candidate("cg_offset", "always", (0, 1, 2))
    value, std = np.array([3e-3, 1e-5, 1e-5]), np.array([3e-4, 6e-4, 6e-4])
    test = mixed.Test(offer, value, np.diag(std**2), 1.0, float(np.sum((value / std) ** 2)), 0.0)
    of = {v.axis: v for v in voices(study, [True] * 3, test, [])}
    assert of["Mx"].turned > 10.0 > 0.2 > of["My"].turned  # y and z make the rolling moment, x most of the pitching one
    heard = [of["My"]._replace(amount=1.0, std=0.1), of["Mx"]._replace(amount=8.0, std=0.5)]
    assert disagreement(heard, test.wald) < 1.1 < disagreement([v._replace(turned=0.0) for v in heard], test.wald)
    known = test._replace(covariance=np.diag((1e-3 * value) ** 2))
    assert max(v.turned for v in voices(study, [True] * 3, known, [])) < 0.01


def test_a_cause_of_one_parameter_has_no_direction(study):
    assert all(v.turned < 1e-6 for v in heard(study, [-0.05], (1,)).values())
