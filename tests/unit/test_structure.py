"""Leaving flights out and resampling, against loops over whole matrices."""

import numpy as np
import pytest
from test_stepwise import choose, plain, pool_of, problem

from quasi.errors import DataError
from quasi.identification.evidence import Totals
from quasi.identification.products import Products
from quasi.identification.stepwise import Options
from quasi.identification.structure import _blocks, inclusion, leave_one_flight_out


def split(n, flights):
    return np.repeat(np.arange(flights), np.diff(np.linspace(0, n, flights + 1).astype(int)))


def plain_left_out(base, z, fixed, flight, cap):
    """Squared error on each left-out flight after 0 .. cap steps chosen and fitted on the others, with lstsq alone."""
    base = base / np.linalg.norm(base, axis=0)
    errors = []
    for f in np.unique(flight):
        train, held = flight != f, flight == f
        chosen = list(range(fixed))
        row = []
        for step in range(cap + 1):
            if step:
                a = np.column_stack([np.ones(train.sum()), base[train][:, chosen]])
                rest = z[train] - a @ np.linalg.lstsq(a, z[train], rcond=None)[0]
                gains = np.zeros(base.shape[1])
                for j in range(base.shape[1]):
                    if j not in chosen:
                        x = base[train, j] - a @ np.linalg.lstsq(a, base[train, j], rcond=None)[0]
                        gains[j] = (x @ rest) ** 2 / (x @ x)
                chosen.append(int(np.argmax(gains)))
            a = np.column_stack([np.ones(train.sum()), base[train][:, chosen]])
            theta = np.linalg.lstsq(a, z[train], rcond=None)[0]
            b = np.column_stack([np.ones(held.sum()), base[held][:, chosen]])
            row.append(np.sum((z[held] - b @ theta) ** 2))
        errors.append(row)
    return np.array(errors)


@pytest.mark.parametrize("seed", range(4))
def test_left_out_errors_equal_plain_loops(seed):
    base, z = problem(seed, m=12)
    pool, names = pool_of(base, z, 2, True, flights=4)
    found = leave_one_flight_out(pool.subset(range(13)), 6, names, True)
    errors = plain_left_out(base, z, 2, split(len(z), 4), 6)
    np.testing.assert_allclose(found["RMSE"], np.sqrt(errors.sum(axis=0) / len(z)), rtol=1e-7)
    best = int(np.argmin(errors.sum(axis=0)))
    assert found["smallest at"] == best
    # one standard error of the difference, over flights
    worse = errors - errors[:, [best]]
    allowed = worse.sum(axis=0) <= 2.0 * worse.std(axis=0, ddof=1)
    assert found["steps"] == int(np.argmax(allowed))


def test_the_number_of_true_terms_is_found_and_noise_is_not_fitted():
    steps = []
    for seed in range(20):
        r = np.random.default_rng(seed)
        base = r.standard_normal((1200, 20))
        z = base[:, 3] - 0.5 * base[:, 7] + 0.3 * base[:, 11] + r.standard_normal(1200)
        pool, names = pool_of(base, z, 0, True, flights=6)
        steps.append(leave_one_flight_out(pool.subset(range(21)), 8, names, True)["steps"])
    assert np.mean(np.array(steps) == 3) >= 0.8
    assert min(steps) >= 2


def test_one_flight_cannot_be_left_out():
    base, z = problem(1)
    pool, names = pool_of(base, z, 1, True, flights=1)
    with pytest.raises(DataError, match="there is one training flight; name more"):
        leave_one_flight_out(pool.subset(range(10)), 3, names, True)


@pytest.mark.parametrize("flights", [3, 8])
def test_a_resample_chooses_what_the_plain_algorithm_chooses_on_the_repeated_rows(flights):
    base, z = problem(7, n=480, m=10)
    pool, names = pool_of(base, z, 1, True, flights=flights)
    found = inclusion(pool.subset(range(11)), Options(cap=6), names, True, 5, bandwidth=4)
    assert found["of"] == ("flights" if flights == 8 else "stretches")
    cells = np.concatenate(pool._cells)
    block = _blocks(pool.flight, 4)
    unit = pool.flight[cells] if flights == 8 else block[cells]
    generator = np.random.default_rng(0)
    for row in found["together"]:
        drawn = generator.integers(0, found["units"], found["units"])
        rows = np.concatenate([np.flatnonzero(unit == u) for u in drawn])
        chosen, _ = plain(base[rows, :1], base[rows, 1:], z[rows], True, 6)
        assert sorted(np.flatnonzero(row)) == sorted(k + 2 for k in chosen)
    np.testing.assert_allclose(found["share"], found["together"].mean(axis=0))


def test_terms_of_the_truth_are_nearly_always_included_and_noise_is_not():
    r = np.random.default_rng(3)
    base = r.standard_normal((4000, 15))
    z = 0.5 * base[:, 2] + 0.4 * base[:, 9] + r.standard_normal(4000)
    pool, names = pool_of(base, z, 0, True)
    options = Options(cap=6, test="significance")
    assert sorted(choose(pool, options, names).chosen) == [2, 9]
    share = inclusion(pool.subset(range(16)), options, names, True, 50, bandwidth=2)["share"][1:]
    assert share[[2, 9]].min() > 0.97
    assert np.delete(share, [2, 9]).max() < 0.3


def test_stretches_stay_within_flights_and_lose_nothing():
    flight = np.repeat([0, 1, 2], [7, 3, 1])
    blocks = _blocks(flight, 3)
    assert blocks.tolist() == [0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 3]
    base, z = problem(2)
    pool, _ = pool_of(base, z, 1, True)
    merged = pool.subset(range(6)).merged(_blocks(pool.flight, 5))
    assert isinstance(merged, Products)
    whole = Totals(pool).gram(range(6))
    scale = np.sqrt(np.outer(np.diag(whole), np.diag(whole)))
    np.testing.assert_allclose(Totals(merged).gram(range(6)) / scale, whole / scale, atol=1e-12)
    assert len(merged.rows) < len(pool.rows)
    assert merged.rows.sum() == len(z)


def test_a_resample_in_which_a_fixed_regressor_vanishes_counts_as_one_that_chose_nothing():
    base, z = problem(9, n=400, m=6)
    base[:, 0] = 0.0
    base[:130, 0] = np.random.default_rng(0).standard_normal(130)  # it moves in the first flight only
    pool, names = pool_of(base, z, 1, True, flights=3)
    found = inclusion(pool.subset(range(7)), Options(cap=4), names, True, 40, bandwidth=200)
    assert 0 < np.count_nonzero(~found["together"].any(axis=1)) < 40
