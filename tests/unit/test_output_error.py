"""Output error and confirmation on flights of a plain simulation, see `plain_flights`."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from plain_flights import flown, simple_model

from quasi.errors import DataError
from quasi.gap.catalogue import catalogue
from quasi.gap.effect import vehicle_of
from quasi.gap.flights.gathering import gather
from quasi.gap.levels.forces.design import gather_design
from quasi.gap.levels.rollouts import open_loop, output_error
from quasi.gap.levels.rollouts.confirmation import (
    CONFIRMED,
    REFUTED,
    UNJUDGED,
    Confirmation,
    Maker,
    _honest,
    _lenient,
    confirm,
    outcome_of,
    settle,
)
from quasi.gap.levels.rollouts.linear_response import course_of, responses
from quasi.gap.materiality import Cause
from quasi.gap.statistics import mixed
from quasi.model.model import AXES, Model

EFFECTS = {n: catalogue()[n] for n in ("rotor_effectiveness", "cg_offset", "body_drag", "tether")}


@pytest.fixture(scope="module")
def model():
    return simple_model()


@pytest.fixture(scope="module")
def weak(model):
    """Three flights to learn from and one held out, rotor 2 at 95 %."""
    return {f"f{k}": flown(model, k, share=0.95) for k in range(4)}


@pytest.fixture(scope="module")
def evidence(model, weak):
    about = {"mass": model.airframe.mass, "inertia": model.airframe.inertia}
    return {k: gather(k, t, about, model.airframe, model, 100.0) for k, t in weak.items()}


@pytest.fixture(scope="module")
def study(model, evidence):
    return gather_design([evidence[f"f{k}"] for k in range(3)], EFFECTS, vehicle_of(model))


def cause(name, values, std, since="always"):
    effect = EFFECTS[name]
    which = tuple(effect.fitted.index(n) for n in values)
    covariance = np.diag([std[n] ** 2 for n in values])
    wald = sum((v / std[n]) ** 2 for n, v in values.items())
    test = mixed.Test(mixed.Candidate(name, since, which), np.array(list(values.values())), covariance, 1.0, wald, 1e-9)
    return Cause(effect, since, dict(values), dict(std), test, [])


@dataclasses.dataclass
class Searched:
    """What `settle` and `Maker` take of the search in forces and moments."""

    study: object
    unjudged: tuple = ()


def made(model, study, causes, anew=False):
    return Maker(model, Searched(study), causes, [True] * 3, vehicle_of(model), anew)


def test_the_linear_response_is_what_the_simulator_makes_of_a_small_force_or_moment(model, weak, evidence, study):
    known = cause("rotor_effectiveness", {"rotor2": -0.05}, {"rotor2": 0.01})
    true = made(model, study, [known])([known.value], True)
    flight = open_loop.flight_of("f0", weak["f0"])
    course = course_of(evidence["f0"], flight, [0.1, 0.4], 1.0)
    units = np.broadcast_to(np.eye(6), (len(evidence["f0"]), 6, 6))
    found = responses(course, units)
    horizon = flight.t[course.lags[-1]] - flight.t[0]
    size = np.array([1e-2, 1e-2, 1e-2, 1e-5, 1e-5, 1e-5])
    for k in range(6):
        offsets = np.zeros((len(course.starts), 6))
        offsets[:, k] = size[k]
        plain, moved = (
            open_loop.vectors(
                open_loop.simulated(true, flight, course.starts, horizon, None, o), flight, course.starts, course.lags
            )
            for o in (None, offsets)
        )
        exact = (plain - moved) / size[k]
        scale = np.abs(exact).max(axis=(0, 1))
        np.testing.assert_allclose(found[..., k], exact, atol=0.03 * scale.max(), rtol=0.05)
        assert np.abs(exact).max() > 0.1


def test_the_response_to_a_cause_is_that_of_the_extended_model(model, weak, evidence, study):
    course = output_error.windows_in(evidence["f0"], weak["f0"], study.thinned[0])
    columns = study.thinned[0].columns
    near = cause("rotor_effectiveness", {"rotor2": -0.05}, {"rotor2": 0.01})
    maker = made(model, study, [near])
    first, last = (output_error.deviations(course, maker([{"rotor2": v}], True)) for v in (-0.0495, -0.0505))
    moved = first - last
    place = study.columns.causes["rotor_effectiveness"][1]
    told = output_error.sensitivities(course, columns[:, :, [place]])[..., 0] * -1e-3
    assert np.corrcoef(moved.ravel(), told.ravel())[0, 1] > 0.999
    assert np.std(moved - told) < 0.05 * np.std(moved)


def fitted(model, weak, study, causes):
    windows = output_error.windows_of(study, weak)
    ranges = {n: e.limits(vehicle_of(model)).ranges for n, e in EFFECTS.items()}
    return output_error.fit(study, [True] * 3, causes, made(model, study, causes), windows, ranges)


def test_output_error_finds_a_known_effectiveness_from_a_start_that_is_off(model, weak, study):
    start = cause("rotor_effectiveness", {"rotor2": -0.03}, {"rotor2": 0.02})
    found = fitted(model, weak, study, [start])
    value, std = found.values[0]["rotor2"], found.std[0]["rotor2"]
    assert found.settled and found.used == [True]
    assert value == pytest.approx(-0.05, abs=0.006) and abs(value + 0.05) < 3 * std < 0.03


def test_two_estimates_that_contradict_each_other_are_told_and_not_used(model, weak, study):
    sure = cause("rotor_effectiveness", {"rotor2": 0.05}, {"rotor2": 0.001})
    found = fitted(model, weak, study, [sure])
    assert found.used == [False] and "standard errors off" in found.notes[0]
    unphysical = {"rotor_effectiveness": [(-0.7, 1.0), (-0.01, 1.0), (-0.7, 1.0), (-0.7, 1.0)]}
    windows = output_error.windows_of(study, weak)
    start = cause("rotor_effectiveness", {"rotor2": -0.05}, {"rotor2": 0.01})
    found = output_error.fit(study, [True] * 3, [start], made(model, study, [start]), windows, unphysical)
    assert found.used == [False] and "outside what is physical" in found.notes[0]


def judged(model, weak, evidence, study, one):
    noise = fitted(model, weak, study, [one]).noise
    whole, without = made(model, study, [one])([one.value], True), made(model, study, [])([], True)
    return confirm([evidence["f3"]], weak, noise, whole, [without])[0]


def test_the_true_cause_is_confirmed_and_its_opposite_is_not(model, weak, evidence, study):
    right = judged(model, weak, evidence, study, cause("rotor_effectiveness", {"rotor2": -0.05}, {"rotor2": 0.01}))
    assert right.outcome == CONFIRMED and right.amplitude == pytest.approx(1.0, abs=4 * right.std)
    assert right.predicted > 5
    swapped = judged(model, weak, evidence, study, cause("rotor_effectiveness", {"rotor2": 0.05}, {"rotor2": 0.01}))
    assert swapped.outcome == REFUTED and swapped.amplitude < -0.5 and "do not confirm" in swapped.why


def test_a_wrong_cause_is_not_confirmed_and_one_too_small_to_be_seen_cannot_be_judged(model, weak, evidence, study):
    # a load of drag that the flights do not have
    wrong = judged(model, weak, evidence, study, cause("body_drag", {"c": 0.1}, {"c": 0.01}))
    assert wrong.outcome == REFUTED and abs(wrong.amplitude) < 0.3
    nothing = judged(model, weak, evidence, study, cause("body_drag", {"c": 1e-4}, {"c": 1e-5}))
    assert nothing.outcome == UNJUDGED and nothing.predicted < 1


def test_a_cause_that_the_held_out_flights_refute_is_dropped_and_the_other_stays(model, weak, evidence, study):
    both = [
        cause("rotor_effectiveness", {"rotor2": -0.05}, {"rotor2": 0.002}),
        cause("tether", {"k": 0.4}, {"k": 0.005}),
    ]
    settled = settle(
        Searched(study), both, model, [True] * 3, EFFECTS, vehicle_of(model), [evidence["f3"]], weak
    )  # fmt: skip
    assert [c.effect.id for c in settled.causes] == ["rotor_effectiveness"]
    assert [(c.effect.id, s.outcome) for c, s in settled.dropped] == [("tether", REFUTED)]
    assert settled.confirmations["rotor_effectiveness", "always"].outcome == CONFIRMED
    assert settled.estimates["rotor_effectiveness", "always"].agrees
    hardly = settle(
        Searched(study, tuple(both)), both, model, [True] * 3, EFFECTS, vehicle_of(model), [evidence["f3"]], weak
    )
    assert hardly.causes == both and hardly.confirmations["tether", "always"].outcome == UNJUDGED


def test_errors_of_a_parameter_that_simulations_put_elsewhere_are_as_large_as_that(model, weak, evidence, study):
    """Of a rotor that is healthy, forces may be sure where they err alike in all flights; simulations disagree."""
    one = cause("rotor_effectiveness", {"rotor1": 0.02, "rotor2": -0.044}, {"rotor1": 0.002, "rotor2": 0.002})
    settled = settle(Searched(study), [one], model, [True] * 3, EFFECTS, vehicle_of(model), [evidence["f3"]], weak)
    kept, estimate = settled.causes[0], settled.estimates["rotor_effectiveness", "always"]
    assert not estimate.agrees and kept.value == one.value
    # both are of one fit: the other parameter has made up for it
    one_apart, other_apart = (
        abs(estimate.value[n] - one.value[n]) / np.hypot(estimate.std[n], 0.002) for n in ("rotor1", "rotor2")
    )
    assert one_apart > 4.0 and kept.std["rotor1"] == pytest.approx(0.002 * one_apart)
    assert 1.0 < other_apart < 4.0 and kept.std["rotor2"] == pytest.approx(0.002 * other_apart)


def test_a_cause_of_which_the_base_model_sees_a_part_has_to_be_confirmed(model, weak, evidence, study):
    # at 2.5 standard errors held-out flights cannot judge it: it stands where all of its axes found it
    pitch_is_worthless = [dataclasses.replace(evidence[f"f{k}"], excluded=(AXES.index("My"),)) for k in range(3)]
    in_part = gather_design(pitch_is_worthless, EFFECTS, vehicle_of(model))

    def settled(seen, std):
        one = cause("rotor_effectiveness", {"rotor2": -0.05}, {"rotor2": std})
        return settle(Searched(seen), [one], model, [True] * 3, EFFECTS, vehicle_of(model), [evidence["f3"]], weak)

    assert len(settled(study, 0.02).causes) == 1
    assert len(settled(in_part, 0.002).causes) == 1
    ((_, answer),) = settled(in_part, 0.02).dropped
    assert answer.outcome == REFUTED and "acts on My as well" in answer.why


def test_a_cause_that_its_own_flights_contradict_has_to_be_confirmed(model, weak, evidence, study, monkeypatch):
    """An inertia stood for a chipped rotor: output error did not settle, and held-out flights could not judge it."""
    fit = output_error.fit
    for agrees in (True, False):
        monkeypatch.setattr(output_error, "fit", lambda *a, on=agrees: dataclasses.replace(fit(*a), used=[on]))
        for std, unsure in ((0.02, True), (0.002, False)):
            one = cause("rotor_effectiveness", {"rotor2": -0.05}, {"rotor2": std})
            held = [evidence["f3"]]
            settled = settle(Searched(study), [one], model, [True] * 3, EFFECTS, vehicle_of(model), held, weak)
            assert bool(settled.causes) == (agrees or not unsure), (agrees, std)
            if not settled.causes:
                ((_, answer),) = settled.dropped
                assert answer.outcome == REFUTED and "do not agree with its value" in answer.why


def test_what_cannot_be_simulated_is_neither_confirmed_nor_dropped(model, weak, evidence, study):
    one = cause("rotor_effectiveness", {"rotor2": -0.05}, {"rotor2": 0.01})
    short = {k: t.assign(valid=np.where(np.arange(len(t)) % 60 == 0, 0.0, 1.0)) for k, t in weak.items()}
    settled = settle(
        Searched(study), [one], model, [True] * 3, EFFECTS, vehicle_of(model), [evidence["f3"]], short
    )  # fmt: skip
    assert settled.causes == [one] and "0 windows" in settled.notes[0]
    assert settled.confirmations["rotor_effectiveness", "always"].outcome == UNJUDGED
    # what has to be confirmed is not
    pitch_is_worthless = [dataclasses.replace(evidence[f"f{k}"], excluded=(AXES.index("My"),)) for k in range(3)]
    in_part = Searched(gather_design(pitch_is_worthless, EFFECTS, vehicle_of(model)))
    settled = settle(in_part, [one], model, [True] * 3, EFFECTS, vehicle_of(model), [evidence["f3"]], short)
    assert not settled.causes and settled.notes
    assert [(c, answer.outcome) for c, answer in settled.dropped] == [(one, REFUTED)]


def test_too_few_windows_are_an_error_that_says_so():
    with pytest.raises(DataError, match="3 windows .* expected at least 8"):
        output_error.covariance_of([np.ones((3, 4))], [np.ones((3, 4, 2))], np.ones(2))


def test_a_flight_without_a_window_adds_nothing_to_the_noise():
    rng = np.random.default_rng(0)
    errors, columns, spread = rng.standard_normal((30, 4)), rng.standard_normal((30, 4, 2)), np.ones(2)
    whole = output_error.covariance_of([errors], [columns], spread)
    diverged = np.full((3, 4), np.nan)
    for lacking in (errors[:0], diverged):
        found = output_error.covariance_of([errors, lacking], [columns, columns[: len(lacking)]], spread)
        np.testing.assert_array_equal(found, whole)


def test_one_held_out_flight_refutes_no_more_than_flights_differ_by():
    """A faint cause, |t| = 4 in four flights, shows nothing in one flight: that is chance. A clear one, |t| = 20, is
    not there."""
    told = Confirmation(REFUTED, 0.0, 0.15, 1.0 / 0.15, "why")

    def seen(t):
        cause = SimpleNamespace(test=SimpleNamespace(wald=t**2))
        return _honest(told, cause, 4.0)

    assert seen(4.0).outcome == UNJUDGED and seen(4.0).why == ""
    assert seen(4.0).std == pytest.approx(np.sqrt(1.0 / 16.0 + 4.0 / 16.0))
    assert seen(20.0).outcome == REFUTED and "0.00 +- 0.16" in seen(20.0).why


def test_half_the_motion_divides_gain_from_loss():
    # a gain is there with 95 %, a loss must be sure with 99.5 %, and a missing gain must have been visible
    assert outcome_of(1.0, 0.1) == CONFIRMED
    assert outcome_of(1.0, 0.35) == UNJUDGED
    assert outcome_of(0.4, 0.15) == REFUTED
    assert outcome_of(0.4, 0.3) == UNJUDGED
    assert outcome_of(-1.0, 0.5) == REFUTED
    assert outcome_of(8.0, 1.0) == REFUTED
    assert outcome_of(0.6, 0.1) == UNJUDGED


def test_windows_of_a_shifted_centre_of_gravity_begin_in_the_state_of_the_true_one(model, weak):
    """Rigid-body kinematics: a point at r moves with v + w x r; without forces the end must be carried back as well."""
    shift = np.array([0.004, -0.003, 0.001])
    document = {**model.document, "extensions": [{"id": "cg_offset", "airframe": {"cg offset": shift.tolist()}}]}
    flight = open_loop.flight_of("f0", weak["f0"])
    run = open_loop.simulated(Model(document, "shifted"), flight, np.array([400]), 0.005)
    np.testing.assert_allclose(run[0, 0], flight.states[400], atol=1e-12)


def test_what_flights_each_have_their_own_of_or_hardly_show_cannot_be_refuted(model):
    refuted = Confirmation(REFUTED, 0.1, 0.1, 10.0, "why")
    everything = catalogue()

    def of(name, states, faint=False):
        effect = everything[name]
        one = Cause(effect, "always", {effect.fitted[0]: 0.1}, {}, None, [])
        section = {"id": name, "states": states}
        return _lenient(refuted, one, Model({**model.document, "extensions": [section]}, "extended"), faint)

    assert of("tether", {}) == refuted
    hardly = of("tether", {}, True)
    assert hardly.outcome == UNJUDGED and "hardly show it" in hardly.why
    refuted = refuted._replace(plain=1.1)
    assert of("tether", {}).outcome == UNJUDGED and "1.10 of its motion is there" in of("tether", {}).why
    refuted = refuted._replace(plain=0.2)
    assert of("tether", {}) == refuted
    assert of("wind", {}).outcome == UNJUDGED and "its own value" in of("wind", {}).why
    load = of("payload_swing", {"swinging load": {"mass": 0.02, "length": 0.4}})
    assert load.outcome == UNJUDGED and "not measured" in load.why


def test_windows_that_remember_each_other_count_for_fewer():
    # correlations of a first-order process, 0.5 and its powers, over the next four: 1 + 2 (1/2 + 1/4 + 1/8 + 1/16)
    rng, flights = np.random.default_rng(3), []
    for _ in range(2):
        noise = rng.standard_normal((6000, 3))
        series = np.zeros_like(noise)
        for k in range(1, len(noise)):
            series[k] = 0.5 * series[k - 1] + noise[k]
        flights.append(series)
    whole = np.concatenate(flights)
    assert output_error._repeated(flights, whole.T @ whole / len(whole)) == pytest.approx(2.875, rel=0.05)
    white = [rng.standard_normal((6000, 3))]
    assert output_error._repeated(white, np.eye(3)) == pytest.approx(1.0, abs=0.05)
