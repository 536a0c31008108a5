"""Least squares and its covariance against statsmodels and against double loops."""

import numpy as np
import pytest
import statsmodels.api as sm
from scipy.signal import lfilter

from quasi.errors import DataError
from quasi.identification.regression import bartlett, flat_top, least_squares, memory_window


def autocorrelated(seed, n, memory):
    r = np.random.default_rng(seed)
    return lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], r.standard_normal(n))


def columns(seed, n):
    r = np.random.default_rng(seed)
    return np.column_stack([np.ones(n), 1e6 * r.standard_normal(n), 1e-3 * r.standard_normal(n) + 2e-3])


def test_coefficients_and_both_covariances_equal_statsmodels():
    n = 700
    a = columns(1, n)
    z = a @ [2.0, 3e-6, 500.0] + autocorrelated(2, n, 0.8)
    fit = least_squares(a, z, [np.arange(n)], bandwidth=12)
    ours = sm.OLS(z, a).fit()
    np.testing.assert_allclose(fit.coefficients, ours.params, rtol=1e-8)
    np.testing.assert_allclose(fit.plain_covariance, ours.cov_params(), rtol=1e-7)
    robust = ours.get_robustcov_results("HAC", maxlags=11, use_correction=False)
    np.testing.assert_allclose(fit.covariance, robust.cov_params(), rtol=1e-7)


def test_flights_are_not_neighbours():
    n, group = 600, np.repeat([0, 1, 2], 200)
    a = columns(3, n)
    z = a @ [2.0, 3e-6, 500.0] + autocorrelated(4, n, 0.8)
    fit = least_squares(a, z, [np.arange(200)] * 3, bandwidth=8)
    robust = (
        sm.OLS(z, a)
        .fit()
        .get_robustcov_results("hac-panel", groups=group, maxlags=7, use_correction=False, df_correction=False)
    )
    np.testing.assert_allclose(fit.covariance, robust.cov_params(), rtol=1e-7)


def test_missing_rows_keep_their_place_in_time():
    r = np.random.default_rng(5)
    rows = np.sort(r.permutation(90)[:60]) + 13
    scores = r.standard_normal((60, 2))
    expected = np.zeros((2, 2))
    for i in range(60):
        for j in range(60):
            lag = abs(int(rows[i] - rows[j]))
            if lag < 7:
                expected += (1 - lag / 7) * np.outer(scores[i], scores[j])
    np.testing.assert_allclose(bartlett(scores, [rows], 7), expected, atol=1e-12)


@pytest.mark.parametrize("memory", [0.9, 0.98])
def test_effective_rows_are_those_of_the_known_process(memory):
    n = 40_000
    noise = autocorrelated(6, n, memory)
    fit = least_squares(np.ones((n, 1)), noise, [np.arange(n)])
    assert fit.effective_rows == pytest.approx(n * (1 - memory) / (1 + memory), rel=0.35)


def test_the_memory_survives_random_gaps():
    noise = autocorrelated(7, 40_000, 0.95)
    rows = np.sort(np.random.default_rng(8).permutation(40_000)[:30_000])
    whole = memory_window(noise, [np.arange(40_000)])
    assert memory_window(noise[rows], [rows]) == pytest.approx(whole, rel=0.25)
    assert memory_window(np.random.default_rng(9).standard_normal(5000), [np.arange(5000)]) <= 8


def test_standard_errors_hold_what_they_promise():
    # the truth lies within two standard errors in about 95 of 100 draws, though the residuals resemble their neighbours
    inside = []
    for seed in range(120):
        n = 3000
        x = autocorrelated(1000 + seed, n, 0.9)
        z = 1.5 * x + autocorrelated(seed, n, 0.9)
        fit = least_squares(np.column_stack([np.ones(n), x]), z, [np.arange(n)])
        inside.append(abs(fit.coefficients[1] - 1.5) < 2 * np.sqrt(fit.covariance[1, 1]))
    assert 0.88 <= np.mean(inside) <= 1.0


def test_copies_and_too_few_rows_are_refused():
    a = columns(10, 50)
    with pytest.raises(DataError, match="combinations"):
        least_squares(np.column_stack([a, a[:, 1]]), a[:, 0], [np.arange(50)])
    with pytest.raises(DataError, match="too few"):
        least_squares(a[:3], a[:3, 0], [np.arange(3)])
    with pytest.raises(DataError, match="zero or not finite"):
        least_squares(np.column_stack([a, np.zeros(50)]), a[:, 0], [np.arange(50)])


def test_the_flat_top_loses_less_of_a_known_variance_than_bartlett():
    # a first order process: long-run variance of its mean, against the two estimates at five times its memory
    memory, n = 0.9, 20_000
    truth = n * (1 + memory) / (1 - memory)
    window = int(5 * (1 + memory) / (1 - memory))
    noise = [autocorrelated(seed, n, memory)[:, None] for seed in range(30)]
    flat = np.mean([flat_top(x, [np.arange(n)], window)[0, 0] for x in noise]) / truth
    usual = np.mean([bartlett(x, [np.arange(n)], window)[0, 0] for x in noise]) / truth
    assert usual < 0.95
    assert flat == pytest.approx(1.0, abs=0.05)


def test_the_flat_top_is_the_sum_over_lags_with_full_and_falling_weights():
    r = np.random.default_rng(12)
    scores = r.standard_normal((50, 2))
    for bandwidth in (1, 6, 7):
        half = (bandwidth + 1) // 2
        expected = np.zeros((2, 2))
        for i in range(50):
            for j in range(50):
                weight = min(1.0, max(2.0 - abs(i - j) / half, 0.0))
                expected += weight * np.outer(scores[i], scores[j])
        found = flat_top(scores, [np.arange(50)], bandwidth)
        if np.linalg.eigvalsh(expected)[0] > 0:
            np.testing.assert_allclose(found, expected, atol=1e-10)
        else:
            np.testing.assert_allclose(found, bartlett(scores, [np.arange(50)], 2 * half), atol=1e-10)


def test_a_variance_that_would_be_negative_falls_back():
    alternating = np.tile([1.0, -1.0], 20)[:, None] + 0.0
    found = flat_top(alternating, [np.arange(40)], 2)
    assert found[0, 0] >= 0.0


@pytest.mark.parametrize(("seconds", "flights", "low", "high"), [(13.5, 1, 1.15, 1.6), (40.0, 3, 0.9, 1.25)])
def test_errors_of_few_independent_rows_are_as_much_too_small_as_the_limits_page_states(seconds, flights, low, high):
    """Scatter of six coefficients over their stated errors, with regressors and residuals of 0.5 and 0.3 s memory."""
    r, rows = np.random.default_rng(0), round(50 * seconds)

    def coloured(memory, columns):
        keep = np.exp(-0.02 / memory)
        noise = r.standard_normal((rows, columns)) * np.sqrt(1 - keep**2)
        return lfilter([1.0], [1.0, -keep], noise, axis=0)

    values, variances = [], []
    for _ in range(150):
        a = np.concatenate([np.column_stack([np.ones(rows), coloured(0.5, 5)]) for _ in range(flights)])
        z = np.concatenate([coloured(0.3, 1)[:, 0] for _ in range(flights)])
        fit = least_squares(a, z, [np.arange(rows)] * flights)
        values.append(fit.coefficients)
        variances.append(np.diag(fit.covariance))
    assert low < np.sqrt(np.mean(np.var(values, axis=0) / np.mean(variances, axis=0))) < high
