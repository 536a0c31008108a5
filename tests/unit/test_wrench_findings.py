"""Restless air: its size is the one that was planted; sensors' noise, calm air and a model's error are none."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from test_unexplained import RATE, ROWS, flight, ground  # noqa: F401

from quasi.gap import verdict
from quasi.gap.catalogue import catalogue
from quasi.gap.effect import vehicle_of
from quasi.gap.levels.forces.case import Case
from quasi.gap.levels.forces.design import gather_design
from quasi.gap.levels.forces.findings import gusts
from quasi.gap.levels.rollouts.confirmation import Confirmation, Settled
from quasi.gap.statistics.candidates import Candidate

SLOPE = 0.15  # N s/m, of the model of these flights along each axis


def air(size, axes=(1.0, 1.0, 1.0)):
    """A wrench of gusts of `size` m/s with a memory of 0.5 s along the axes."""

    def planted(columns):
        rng = np.random.default_rng(int(1e6 * abs(columns["v"][0])))
        a = np.exp(-1.0 / (0.5 * RATE))
        wind = lfilter([1.0], [1.0, -a], rng.standard_normal((ROWS, 3)), axis=0)
        wind *= size * np.array(axes) / wind.std(axis=0)
        return np.hstack([SLOPE * wind, np.zeros((ROWS, 3))])

    return planted


def found(ground, now, before=None):  # noqa: F811
    flights = [flight(ground, s, now) for s in (1, 2, 3)]
    flights += [flight(ground, s, before) for s in (4, 5, 6)] if before else []
    study = gather_design(flights, {}, vehicle_of(ground[1]))
    return gusts(study, [True] * 3 + [False] * (len(flights) - 3))


def test_gusts_are_stated_with_their_size_and_memory(ground):  # noqa: F811
    [finding] = found(ground, air(1.2))
    evidence = finding["evidence"]
    assert finding["id"] == "gusts" and evidence["p"] < 1e-3
    # what is slower than 0.1 Hz and faster than 3 Hz is not counted, nor what a fit of the terms takes up
    assert evidence["velocity"] == pytest.approx(1.2, rel=0.25)
    assert evidence["memory"] == pytest.approx(0.5, rel=0.4)
    assert evidence["force"]["Fx"] == pytest.approx(SLOPE * 1.2, rel=0.3)


def test_air_as_usual_is_not_remarked(ground):  # noqa: F811
    assert found(ground, air(0.25)) == []


def test_more_than_in_the_reference_flights_is_remarked(ground):  # noqa: F811
    [finding] = found(ground, air(0.42), air(0.08))
    assert finding["evidence"]["times the reference flights"] > 1.5
    assert "as much as in the reference flights" in finding["text"]


def test_an_error_along_one_axis_alone_is_no_air(ground):  # noqa: F811
    assert found(ground, air(1.5, (1.0, 0.1, 0.1))) == []


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (1.0, 0.1, 1.0)])
def test_restless_air_is_nothing_unknown_that_a_name_gives_way_to(ground, axes):  # noqa: F811
    """The air is a finding. Less along one axis, it is an error that nothing explains, and clearer than the name."""
    learning = [flight(ground, s, air(0.1)) for s in (11, 12, 13, 14)]
    learning += [flight(ground, s, air(1.2, axes)) for s in (1, 2, 3, 4)]
    held = [flight(ground, s, air(1.2, axes)) for s in (5, 6)]
    compared, model, effect = [False] * 4 + [True] * 4, ground[1], catalogue()["thrust_factor"]
    vehicle, settings = vehicle_of(model), {"false alarm rate": 0.01, "extended model ID": "x"}
    case = Case(model, {effect.id: effect}, vehicle, learning, compared, held, {}, [], (), settings)
    study = gather_design(learning, {effect.id: effect}, vehicle)
    test = SimpleNamespace(p=3e-4, offer=Candidate(effect.id, "changed", (0,)))
    cause = SimpleNamespace(effect=effect, since="changed", value={"factor": -0.05}, apart=2.0, test=test)
    settled = Settled([cause], [], {(effect.id, "changed"): Confirmation("", 1.0, 0.1, 5.0)}, {}, [])
    found, left = SimpleNamespace(study=study, ties=[], stand_ins=[]), SimpleNamespace(entries=[])
    stands = bool(gusts(study, compared, [effect.id]))
    assert stands == (axes[1] == 1.0)
    assert verdict._fainter_than_unknown(case, settled, found, left).causes == ([cause] if stands else [])
