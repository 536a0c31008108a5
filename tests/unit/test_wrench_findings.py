"""Restless air: its size is the one that was planted; sensors' noise, calm air and a model's error are none."""

import numpy as np
import pytest
from scipy.signal import lfilter
from test_unexplained import RATE, ROWS, flight, ground  # noqa: F401

from quasi.gap.effect import vehicle_of
from quasi.gap.levels.forces.design import gather_design
from quasi.gap.levels.forces.findings import gusts

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
