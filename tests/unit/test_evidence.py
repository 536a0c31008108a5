"""Evidence from sums over cells against plain loops over rows, and against what is known of made processes."""

import numpy as np
import pytest
from scipy.signal import lfilter
from test_stepwise import pool_of

from quasi.identification.evidence import Totals, entering, interchangeable, left_out, probability, standing
from quasi.identification.stepwise import State


def autocorrelated(generator, n, memory):
    return lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], generator.standard_normal(n))


def problem(seed, n=600, m=6):
    r = np.random.default_rng(seed)
    base = r.standard_normal((n, m)) @ r.standard_normal((m, m)) * 10.0 ** r.uniform(-3, 4, m) + r.uniform(-2, 2, m)
    z = base[:, 0] / base[:, 0].std() + 0.5 * base[:, 3] / base[:, 3].std() + r.standard_normal(n)
    return base, z


def plain_t(a, z, k, cells, flight_of_cell, bandwidth):
    """t and degrees of freedom of column k of a, word for word: leave out, take apart, sum over cells, weigh lags."""
    others = np.delete(a, k, axis=1)
    x = a[:, k] - others @ np.linalg.lstsq(others, a[:, k], rcond=None)[0]
    rest = z - a @ np.linalg.lstsq(a, z, rcond=None)[0]
    count = cells.max() + 1
    whole = x @ x
    score = np.array([x[cells == b] @ rest[cells == b] for b in range(count)])
    share = np.array([x[cells == b] @ x[cells == b] for b in range(count)]) / whole
    score = score / np.sqrt(1 - share)
    variance = shared = 0.0
    for b in range(count):
        for c in range(count):
            if flight_of_cell[b] == flight_of_cell[c] and abs(b - c) < bandwidth:
                weight = 1 - abs(b - c) / bandwidth
                variance += weight * score[b] * score[c]
                shared += weight**2 * share[b] * share[c]
    return (x @ z) / np.sqrt(variance), 1 / shared - 1


@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize("bandwidth", [1, 4])
def test_t_and_degrees_of_freedom_equal_plain_loops(bias, bandwidth):
    base, z = problem(1)
    pool, _ = pool_of(base, z, 2, bias)
    cells = np.concatenate(pool._cells)
    columns = list(range(2 + bias))
    t, freedom = entering(Totals(pool), columns, bandwidth)
    fixed = np.column_stack([np.ones((len(z), int(bias))), base[:, :2]])
    for j in range(2, 6):
        expected = plain_t(np.column_stack([fixed, base[:, j]]), z, -1, cells, pool.flight, bandwidth)
        np.testing.assert_allclose((t[j + bias], freedom[j + bias]), expected, rtol=1e-7)
    t, freedom = standing(Totals(pool), [*columns, 4 + bias], bandwidth)
    a = np.column_stack([fixed, base[:, 4]])
    # the constant's own coefficient depends on what the columns are counted from, and is never judged
    for k in range(int(bias), a.shape[1]):
        expected = plain_t(a, z, k, cells, pool.flight, bandwidth)
        np.testing.assert_allclose((t[k], freedom[k]), expected, rtol=1e-7)


def test_cells_counted_twice_are_cells_that_stand_there_twice():
    base, z = problem(2)
    pool, _ = pool_of(base, z, 1, True, flights=1)
    weights = np.random.default_rng(0).integers(0, 3, len(pool.rows))
    own = [np.flatnonzero(pool._cells[0] == b) for b in range(len(weights))]
    twice = np.concatenate([rows for rows, times in zip(own, weights) for _ in range(times)])
    t, _ = entering(Totals(pool, weights), [0, 1])
    again, _ = pool_of(base[twice], z[twice], 1, True, flights=1)
    totals = Totals(pool, weights)
    np.testing.assert_allclose(totals.rows, len(twice))
    a = np.column_stack([np.ones(len(twice)), base[twice, 0]])
    for j in range(1, 6):
        x = base[twice, j] - a @ np.linalg.lstsq(a, base[twice, j], rcond=None)[0]
        full = np.column_stack([a, base[twice, j]])
        theta = np.linalg.lstsq(full, z[twice], rcond=None)[0]
        gain = np.sum((z[twice] - a @ np.linalg.lstsq(a, z[twice], rcond=None)[0]) ** 2) - np.sum(
            (z[twice] - full @ theta) ** 2
        )
        state = State(totals)
        state.add(0)
        state.add(1)
        assert state.gain()[j + 1] == pytest.approx(gain, rel=1e-8)
        assert np.sign(t[j + 1]) == np.sign(x @ z[twice])
    assert again.rows.sum() == totals.rows


def test_nothing_passes_for_something_as_often_as_the_level_says():
    # 40 columns that are nothing, residuals and columns that remember themselves, few strong moments in half of them
    below = []
    for seed in range(60):
        r = np.random.default_rng(seed)
        n = 4000
        base = np.column_stack([autocorrelated(r, n, 0.9) for _ in range(40)])
        base[:, 20:] **= 3
        pool, _ = pool_of(base, autocorrelated(r, n, 0.95), 0, True, flights=2)
        # the residuals' window is about 195 rows, twelve cells
        t, freedom = entering(Totals(pool), [0], 13)
        below.append(probability(t[1:], freedom[1:]) < 0.01)
    assert 0.003 < np.mean(below) < 0.02


def test_a_plain_t_would_be_many_times_too_sure():
    r = np.random.default_rng(3)
    n = 6000
    x = np.column_stack([autocorrelated(r, n, 0.98) for _ in range(30)])
    z = autocorrelated(r, n, 0.98)
    pool, _ = pool_of(x, z, 0, True)
    t, _ = entering(Totals(pool), [0], 2)
    plain = [np.corrcoef(x[:, j], z)[0, 1] * np.sqrt(n) for j in range(30)]
    assert np.std(plain) > 5
    assert np.std(t[1:]) < 2


def test_gains_in_place_of_a_term_are_those_of_the_model_without_it():
    base, z = problem(4, m=8)
    pool, _ = pool_of(base, z, 1, True)
    totals = Totals(pool)
    state = State(totals)
    for k in (0, 1, 4, 6, 3):
        state.add(k)
    found = state.gains_in_place_of([4, 6, 3])
    for row, out in zip(found, (4, 6, 3)):
        np.testing.assert_allclose(row, state.without(out).gain(), rtol=1e-6, atol=1e-9 * row.max())


def test_a_column_that_is_almost_another_is_interchangeable_and_one_that_is_not_is_not():
    r = np.random.default_rng(5)
    n = 3000
    x = autocorrelated(r, n, 0.9)
    other = autocorrelated(r, n, 0.9)
    base = np.column_stack([x, x + 0.02 * autocorrelated(r, n, 0.9), other, x + autocorrelated(r, n, 0.9)])
    z = x + other + autocorrelated(r, n, 0.5)
    pool, _ = pool_of(base, z, 0, True)
    found = interchangeable(Totals(pool), [0, 1, 3])
    assert [e["column"] for e in found[1]] == [2]
    assert found[1][0]["share of gain"] == pytest.approx(1.0, abs=0.01)
    assert found[3] == []
    noisy = z + 60.0 * autocorrelated(r, n, 0.9)
    pool, _ = pool_of(base, noisy, 0, True)
    assert 2 in [e["column"] for e in interchangeable(Totals(pool), [0, 1, 3])[1]]


def test_errors_of_left_out_flights_equal_fits_of_the_rows_of_the_others():
    base, z = problem(4)
    pool, _ = pool_of(base, z, 2, True)
    columns, flight = [0, 1, 2, 5], np.repeat([0, 1, 2], 200)
    a = np.column_stack([np.ones(len(z)), base[:, [0, 1, 4]]])
    expected = []
    for f in range(3):
        theta = np.linalg.lstsq(a[flight != f], z[flight != f], rcond=None)[0]
        expected.append(np.sum((z[flight == f] - a[flight == f] @ theta) ** 2))
    np.testing.assert_allclose(left_out(Totals(pool), columns), expected, rtol=1e-7)
    weights = np.where(pool.flight == 1, 0.0, 1.0)
    assert len(left_out(Totals(pool, weights), columns)) == 2


def test_a_column_that_only_one_flight_moves_says_nothing_of_it():
    base, z = problem(5)
    base[:400, 5] = base[:400, 4]  # of three flights the last alone tells the two apart
    pool, _ = pool_of(base, z, 2, True)
    errors = left_out(Totals(pool), [0, 5, 6])
    assert np.isinf(errors[2]) and np.isfinite(errors[:2]).all()
