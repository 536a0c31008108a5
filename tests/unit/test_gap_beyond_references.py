"""Errors beyond those of the reference flights that no place orders: found, and not where flights were flown harder."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_unexplained import flight as made_flight
from test_unexplained import ground  # noqa: F401

from quasi.gap import verdict
from quasi.gap.causes import cg_offset
from quasi.gap.flights.covariates import UNPLACED
from quasi.gap.levels.forces.beyond_references import left_beyond_references, less_usual_differences
from quasi.gap.report.next_steps import _visit
from quasi.gap.report.wording import left_sentence
from quasi.gap.statistics.candidates import Candidate
from quasi.gap.statistics.log_ratio import larger, two_larger
from quasi.model.model import AXES

ROWS, RATE = 500, 0.5 * 0.01 / 4


def flight(seed, error=0.05, effort=1.0, offset=0.0, excluded=()):
    """A flight whose errors have a spread of `error` N or N m and 10 % of difference between flights."""
    random = np.random.default_rng(seed)
    size = error * np.exp(0.1 * random.standard_normal())
    left = size * random.standard_normal((ROWS, 6)) + offset
    measured = effort * random.standard_normal((ROWS, 6))
    t, breaks = 0.01 * np.arange(ROWS), np.arange(ROWS) == 0
    return SimpleNamespace(left=left, measured=measured, excluded=excluded, metadata={}, t=t, breaks=breaks)


def entries(references, others, rate=RATE):
    return left_beyond_references(references, others, lambda f: f.left, lambda f: f.left, rate)


def healthy(first, count, **how):
    return [flight(first + k, **how) for k in range(count)]


def layered(seed, size):
    """A healthy flight with an additional vertical force in layers of height."""
    made = flight(seed)
    made.left[:, 2] += size * np.sign(np.sin(np.linspace(0.0, 40.0, ROWS)))
    return made


def test_a_force_in_layers_is_found_in_its_channel_with_its_size():
    found = entries(healthy(0, 4), [layered(10 + k, 0.2) for k in range(5)])
    assert [e["channel"] for e in found] == ["Fz"]
    entry = found[0]
    assert entry["where"] == UNPLACED
    assert entry["size"] == pytest.approx(0.2, rel=0.15)
    assert entry["unit"] == "N"
    assert entry["evidence"]["times the reference flights"] == pytest.approx(np.hypot(0.2, 0.05) / 0.05, rel=0.2)
    times = entry["evidence"]["times the reference flights"]
    assert f"beyond what the reference flights leave ({times:.1f} times as much)" in left_sentence(entry)
    assert "another height" in _visit(entry)


@pytest.mark.parametrize(("showing", "axes"), [(2, ["Fz"]), (1, [])])
def test_an_effect_that_two_of_four_flights_have_the_manoeuvre_for_is_found(showing, axes):
    """A side force by yaw rate and speed at once, in laps alone, had spread the errors so that their mean was open; so
    had shares of what was flown, where steps move less than laps and errors are mostly noise."""
    flights = [layered(10 + k, 0.5 if k < showing else 0.0) for k in range(4)]
    references = [flight(k, effort=(0.2, 1.0)[k % 2]) for k in range(6)]
    assert [e["channel"] for e in entries(references, flights)] == axes


def test_two_flights_beyond_the_prediction_of_the_earlier_ones():
    before = np.exp([-0.1, 0.1, -0.1, 0.1])  # mean 0, standard deviation 0.1155 of the logarithm
    second = 1.0 / (0.2 / np.sqrt(3.0) * np.sqrt(1.25))
    # Student's distribution with 3 degrees of freedom, by its closed form (Abramowitz & Stegun 26.7.3)
    angle = np.arctan(second / np.sqrt(3.0))
    tail = 0.5 - (angle + np.sin(angle) * np.cos(angle)) / np.pi
    assert two_larger(np.exp([3.0, 1.0, 0.0]), before) == pytest.approx(1.5 * tail, rel=1e-9)
    assert two_larger(np.exp([3.0, 1.0]), before[:2]) == 1.0


@pytest.mark.parametrize(("logged", "axes"), [({"low-pass cutoff Hz": 40.0}, ["Fz"]), ({}, list(AXES))])
def test_larger_noise_of_instruments_is_no_error_of_the_model(logged, axes):
    """A log at a quarter of the rate folds vibration into its samples. Unknown filters leave noise and error alike."""
    noisy = [flight(10 + k, error=0.1) for k in range(5)]
    for one in noisy:
        one.left[:, 2] += 0.2 * np.sign(np.sin(np.linspace(0.0, 40.0, ROWS)))
    flights = [healthy(0, 4), noisy]
    for one in (*flights[0], *noisy):
        one.metadata = {"filters": logged}
    assert [e["channel"] for e in entries(*flights)] == axes


def test_smaller_errors_are_no_finding():
    assert not entries([layered(10 + k, 0.2) for k in range(4)], healthy(0, 5))


def test_healthy_flights_alarm_as_seldom_as_stated():
    rate = 0.2
    alarms = sum(bool(entries(healthy(20 * k, 3), healthy(20 * k + 10, 4), rate)) for k in range(200))
    # the binomial spread of 200 trials at 0.2 is 5.7; the share of the effort makes it rarer
    assert alarms < 0.2 * 200 + 3 * 5.7


def test_flights_flown_harder_have_larger_errors_of_any_model():
    harder = healthy(10, 5, error=0.2, effort=4.0)
    assert not entries(healthy(0, 4), harder)
    assert len(entries(healthy(0, 4), healthy(10, 5, error=0.2))) == 6


def test_constant_errors_are_left_to_the_trim():
    assert not entries(healthy(0, 4), healthy(10, 5, offset=1.0))


def test_a_weight_seated_elsewhere_is_no_error_beyond_the_references(ground):  # noqa: F811
    """0.7 mm to the side make a moment that follows the thrust: in climbs it is larger than a good model's errors."""
    flights = [made_flight(ground, seed, rows=1200) for seed in range(7)]
    random, errors = np.random.default_rng(1), {}
    for number, one in enumerate(flights):
        noise = 5e-5 * random.standard_normal((1200, 6)) * np.exp(0.1 * random.standard_normal(6))
        moved = cg_offset.EFFECT.columns(one, {})["y"]
        layers = np.zeros((1200, 6))
        layers[:, 3] = 1e-3 * np.sign(np.sin(np.linspace(0.0, 40.0, 1200)))
        errors[id(one)] = {"seated": noise + (7e-4 * moved if number > 3 else 0.0), "layers": noise + layers}
        errors[id(one)]["healthy"] = noise

    def channels(kind, of=less_usual_differences):
        left = [of(lambda f, name=name: errors[id(f)][name]) for name in ("healthy", kind)]
        return [e["channel"] for e in left_beyond_references(flights[:4], flights[4:], *left, RATE)]

    assert "Mx" in channels("seated", lambda left: left)
    assert channels("seated") == []
    assert channels("layers") == ["Mx"]


def test_an_axis_that_the_model_does_not_explain_is_left_out():
    assert not entries(healthy(0, 4), [layered(10 + k, 0.2) for k in range(4)] + [flight(30, excluded=(2,))])


@pytest.mark.parametrize(("before", "now"), [(1, 5), (5, 1), (0, 5)])
def test_one_flight_has_no_spread(before, now):
    assert not entries(healthy(0, before), [layered(10 + k, 0.5) for k in range(now)])


def test_without_a_prior_the_flights_state_their_own_spread():
    now, before = np.array([4.0, 4.4, 3.6]), np.array([1.0, 1.1, 0.9, 1.05])
    gain, p = larger(now, before)
    logs = np.log(now), np.log(before)
    squares = sum(np.var(x) * len(x) for x in logs)
    t = gain / np.sqrt(squares / 5 * (1 / 3 + 1 / 4))
    assert gain == pytest.approx(logs[0].mean() - logs[1].mean())
    # Student's distribution with 5 degrees of freedom, by its closed form (Abramowitz & Stegun 26.7.4)
    angle = np.arctan(t / np.sqrt(5))
    inside = 2 / np.pi * (angle + np.sin(angle) * (np.cos(angle) + 2 / 3 * np.cos(angle) ** 3))
    assert p == pytest.approx((1 - inside) / 2, rel=1e-6)


@pytest.mark.parametrize("stands", [True, False])
def test_a_tie_that_has_gone_explains_nothing_any_more(monkeypatch, stands):
    """Its first cause was kept to be named among the candidates, and was taken off what stays unexplained."""
    test = SimpleNamespace(offer=Candidate("wind", "changed", (0,)))
    first = SimpleNamespace(effect=SimpleNamespace(id="wind"), since="changed", test=test)
    ties = [("changed", SimpleNamespace(tests=[test]))] if stands else []
    found, settled, taken = SimpleNamespace(stand_ins=[first], ties=ties, study=None), SimpleNamespace(causes=[]), []
    monkeypatch.setattr(verdict, "Model", lambda document, where: document)
    monkeypatch.setattr(verdict, "after", lambda model, base: None)
    monkeypatch.setattr(verdict, "made_of", lambda model, flights: False)
    monkeypatch.setattr(verdict, "left_beyond_references", lambda *given: [])
    case = SimpleNamespace(
        learning=[], compared=[], held=[], model=None, settings={"false alarm rate": 0.01}, anew=lambda causes: False,
        extended=lambda causes, study, where, anew: taken.extend(causes),
    )  # fmt: skip
    verdict.errors_beyond_references(case, settled, found)
    assert taken == ([first] if stands else [])


@pytest.mark.parametrize(
    ("since", "channel", "restless", "also"),
    [
        ("always", "My", [], ["Fy"]),
        ("always", "Fy", [], []),
        ("changed", "My", [], []),
        ("always", "My", ["gusts"], []),
    ],
)
def test_what_all_flights_show_does_not_hide_a_change_on_another_axis(monkeypatch, since, channel, restless, also):
    beyond = {"channel": "Fy", "where": UNPLACED, "since": "changed"}
    monkeypatch.setattr(verdict, "errors_beyond_references", lambda *given: [beyond])
    entry = {"channel": channel, "where": "downward speed", "since": since}
    found = verdict.with_errors_beyond_references([entry], restless, None, None, None)
    assert [e["channel"] for e in found] == [channel, *also]
