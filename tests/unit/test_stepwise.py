"""Selection on cross-products against a plain slow implementation of the manual's algorithm (6.2) and against numpy."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from quasi.errors import ConfigError, DataError
from quasi.identification import products, stepwise
from quasi.identification.evidence import Totals, probability, standing
from quasi.identification.products import Pool
from quasi.identification.regression import least_squares
from quasi.identification.stepwise import Options, select
from quasi.terms.expressions import parse


def plain(fixed, candidates, z, bias, cap, f_in=4.0, f_out=4.0):
    """Equations (2)-(12) word for word on whole matrices, with the differences that (6) and (10) print.

    fixed (N, k), candidates (N, m). Without a bias nothing is centred. Returns candidates in order of entry, PSEs.
    """
    n = len(z)
    # units chosen so that lstsq keeps its digits; nothing in the algorithm depends on them
    fixed, candidates = fixed / np.linalg.norm(fixed, axis=0), candidates / np.linalg.norm(candidates, axis=0)

    def matrix(chosen):
        return np.column_stack([np.ones((n, int(bias))), fixed, candidates[:, chosen]])

    def least_squares(a):
        return np.linalg.lstsq(a, z, rcond=None)[0]

    def regression_sum(a):
        theta = least_squares(a)
        return theta @ a.T @ z - n * z.mean() ** 2

    def after(a, y):
        return y - a @ np.linalg.lstsq(a, y, rcond=None)[0]

    def error(a):
        return np.sum((z - a @ least_squares(a)) ** 2)

    def pse(a):
        return error(a) / n + np.sum((z - z.mean()) ** 2) / n * a.shape[1] / n

    chosen, scores = [], [pse(matrix([]))]
    for _ in range(cap):
        a = matrix(chosen)
        rest = after(a, z)
        best, pick = 0.0, None
        for j in range(candidates.shape[1]):
            if j in chosen:
                continue
            x = after(a, candidates[:, j])
            if bias:
                x, y = x - x.mean(), rest - rest.mean()
            else:
                y = rest
            if x @ x < 1e-9 * np.sum((candidates[:, j] - bias * candidates[:, j].mean()) ** 2):
                continue
            r = abs(x @ y) / np.sqrt((x @ x) * (y @ y))
            if r > best:
                best, pick = r, j
        if pick is None:
            break
        bigger = matrix([*chosen, pick])
        s2 = error(bigger) / (n - a.shape[1] - 1)
        if (regression_sum(bigger) - regression_sum(a)) / s2 <= f_in:
            break
        now = [*chosen, pick]
        s2 = error(bigger) / (n - bigger.shape[1])
        f = [(regression_sum(bigger) - regression_sum(matrix([c for c in now if c != k]))) / s2 for k in now]
        if min(f) < f_out:
            out = now[int(np.argmin(f))]
            if out == pick:
                break
            now.remove(out)
        if pse(matrix(now)) >= scores[-1]:
            break
        chosen = now
        scores.append(pse(matrix(chosen)))
        if scores[-1] < 1e-3 * scores[0]:
            break
    return chosen, scores


def problem(seed, n=400, m=25, noise=0.3):
    """Correlated candidates, some of which make the target."""
    r = np.random.default_rng(seed)
    base = r.standard_normal((n, 6)) @ r.standard_normal((6, m)) + r.uniform(0.2, 1.5) * r.standard_normal((n, m))
    base = (base + r.uniform(-3, 3, m) * 10.0 ** r.uniform(-2, 1, m)) * 10.0 ** r.uniform(-3, 5, m)
    scale = base.std(axis=0)
    true = r.permutation(m)[: r.integers(2, 6)]
    z = (base[:, true] / scale[true]) @ r.uniform(-2, 2, len(true)) + noise * r.standard_normal(n) + r.uniform(-2, 2)
    return base, z


def pool_of(base, z, fixed, bias, flights=3):
    names = [f"c{k}" for k in range(base.shape[1])]
    cuts = np.linspace(0, len(z), flights + 1).astype(int)
    blocks = [{n: base[i:j, k] for k, n in enumerate(names)} for i, j in pairwise(cuts)]
    targets = [z[i:j] for i, j in pairwise(cuts)]
    trees = [*[parse("1")] * bias, *(parse(n) for n in names)]
    return Pool(trees, fixed + bias, blocks, targets, constant=bias), ["bias"] * bias + names


def choose(pool, options, names, **more):
    """Selection with columns counted from the first after the constant."""
    found = select(pool, options, names, unusable=pool.unusable, constant=pool.constant, **more)
    return replace(found, chosen=[k - pool.constant for k in found.chosen])


@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize("seed", range(25))
def test_structure_equals_the_plain_implementation(seed, bias, monkeypatch):
    monkeypatch.setattr(products, "CHUNK", 77)
    monkeypatch.setattr(products, "PREFETCH", 3)
    base, z = problem(seed)
    pool, names = pool_of(base, z, 2, bias)
    cap = 8
    found = choose(pool, Options(cap=cap), names)
    chosen, scores = plain(base[:, :2], base[:, 2:], z, bias, cap)
    assert [k - 2 for k in found.chosen] == chosen
    np.testing.assert_allclose([e["PSE"] for e in found.log], scores, rtol=1e-8)
    a = np.column_stack([np.ones((len(z), int(bias))), base[:, :2], base[:, found.chosen]])
    scale = np.linalg.norm(a, axis=0)
    expected = np.linalg.lstsq(a / scale, z, rcond=None)[0]
    fit = least_squares(a, z, [np.arange(len(z))])
    np.testing.assert_allclose(fit.coefficients * scale, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


def test_backward_elimination_happens_and_equals_the_plain_implementation():
    # the noisy sum of two true terms correlates best, enters first, and is redundant once both are in
    seen = 0
    for seed in range(12):
        r = np.random.default_rng(seed)
        base = r.standard_normal((600, 8))
        base[:, 2] = base[:, 0] + base[:, 1] + 0.1 * r.standard_normal(600)
        base = np.column_stack([r.standard_normal(600), base])
        z = base[:, 1] + 1.6 * base[:, 2] + 0.05 * r.standard_normal(600)
        pool, names = pool_of(base, z, 1, True)
        found = choose(pool, Options(cap=8), names)
        chosen, scores = plain(base[:, :1], base[:, 1:], z, True, 8)
        assert [k - 1 for k in found.chosen] == chosen
        np.testing.assert_allclose([e["PSE"] for e in found.log], scores, rtol=1e-8)
        seen += any(e["removed"] for e in found.log)
    assert seen >= 10


def test_a_pure_noise_candidate_is_turned_away_at_entry():
    turned_away = 0
    for seed in range(300):
        r = np.random.default_rng(seed)
        base = r.standard_normal((500, 2))
        z = 3.0 + 2.0 * base[:, 0] + r.standard_normal(500)
        pool, names = pool_of(base, z, 1, True)
        found = choose(pool, Options(cap=1), names)
        turned_away += "partial F" in found.reason
    # F(1, 497) exceeds 4 in 4.6 % of the draws
    assert 0.92 < turned_away / 300 < 0.985


def test_without_a_constant_nothing_is_centred():
    x = np.linspace(0.0, 3.0, 301)
    z = 3.0 + 2.0 * x
    pool, _ = pool_of(x[:, None], z, 1, False)
    slope = pool.target.sum() / pool.square.sum()
    assert slope == pytest.approx(np.sum(x * z) / np.sum(x * x), rel=1e-12)
    assert slope > 2.5


def test_large_means_cost_no_digits():
    r = np.random.default_rng(1)
    x = 1e6 + r.standard_normal(20_000)
    base = np.column_stack([x, 1e5 + r.standard_normal(20_000)])
    z = 1e4 + 2.0 * (x - 1e6) + 0.1 * r.standard_normal(20_000)
    pool, _ = pool_of(base, z, 0, True)
    centred = base - base.mean(axis=0)
    totals = Totals(pool)
    mean = totals.cross(0) / totals.rows
    square = totals.square - totals.rows * mean**2
    np.testing.assert_allclose(square[1:], np.sum(centred**2, axis=0), rtol=1e-9)
    product = totals.cross(1)[2] - totals.rows * mean[1] * mean[2]
    np.testing.assert_allclose(product, centred[:, 0] @ centred[:, 1], rtol=1e-6)


def test_exact_copies_are_never_both_taken():
    r = np.random.default_rng(2)
    base = r.standard_normal((300, 4))
    base[:, 2] = 5.0 * base[:, 1]
    z = base[:, 1] + 0.1 * r.standard_normal(300)
    pool, names = pool_of(base, z, 1, True)
    found = choose(pool, Options(cap=5), names)
    assert len({1, 2} & set(found.chosen)) == 1


def test_candidates_that_are_constant_or_not_finite_are_left_out_by_name():
    r = np.random.default_rng(3)
    base = r.standard_normal((300, 4))
    base[:, 2], base[17, 3] = 7.0, np.inf
    z = base[:, 0] + 0.5 * base[:, 1] + 0.1 * r.standard_normal(300)
    pool, names = pool_of(base, z, 1, True)
    found = choose(pool, Options(cap=5), names)
    assert found.chosen == [1]
    assert "constant" in pool.unusable[3]
    assert "not finite" in pool.unusable[4]


@pytest.mark.parametrize(("spoil", "hint"), [("nan", "not finite"), ("constant", "constant"), ("copy", "combination")])
def test_a_spoilt_fixed_regressor_is_refused_by_name(spoil, hint):
    r = np.random.default_rng(4)
    base = r.standard_normal((300, 3))
    if spoil == "nan":
        base[3, 1] = np.nan
    else:
        base[:, 1] = 2.0 if spoil == "constant" else 3.0 * base[:, 0]
    pool, names = pool_of(base, base[:, 0] + r.standard_normal(300), 2, True)
    with pytest.raises(DataError, match=f"fixed regressor 'c1' .*{hint}"):
        choose(pool, Options(), names)


@pytest.mark.parametrize("stop", ["R2", "F"])
def test_the_other_stop_criteria_stop_earlier(stop):
    base, z = problem(5, noise=1.5)
    pool, names = pool_of(base, z, 1, True)
    usual = choose(pool, Options(cap=20), names)
    found = choose(pool, Options(cap=20, stop=stop), names)
    assert len(found.chosen) <= len(usual.chosen)
    assert "would" in found.reason or "partial F" in found.reason


def test_an_unknown_stop_criterion_is_refused():
    with pytest.raises(ConfigError, match="'AIC'"):
        Options(stop="AIC")


def test_the_cap_counts_steps_and_too_few_rows_are_refused():
    base, z = problem(6)
    pool, names = pool_of(base, z, 1, True)
    found = choose(pool, Options(cap=2), names)
    assert len(found.log) == 3
    assert "cap of 2" in found.reason
    assert choose(pool, Options(cap=0), names).chosen == []
    pool, names = pool_of(base[:6], z[:6], 5, True, flights=1)
    with pytest.raises(DataError, match="6 training rows are too few"):
        choose(pool, Options(), names)


BY_SIGNIFICANCE = Options(cap=8, test="significance")


def test_a_mixture_that_enters_first_makes_way_for_the_true_terms():
    right = 0
    for seed in range(20):
        r = np.random.default_rng(seed)
        base = r.standard_normal((3000, 12))
        base[:, 5] = base[:, 2] + base[:, 3] + 0.3 * r.standard_normal(3000)
        z = base[:, 2] + base[:, 3] + 0.5 * r.standard_normal(3000)
        pool, names = pool_of(base, z, 1, True)
        found = choose(pool, BY_SIGNIFICANCE, names)
        assert found.log[1]["selected"] == "c5"
        right += sorted(found.chosen) == [2, 3]
    assert right >= 18


def test_two_terms_that_hide_each_other_enter_on_trial_and_stand(monkeypatch):
    # the target is their small difference: either alone tells little (t about 2.7 beside 40 others), both tell it all
    def share():
        right = 0
        for seed in range(20):
            r = np.random.default_rng(seed)
            base = r.standard_normal((4000, 40))
            small = 0.06 * r.standard_normal(4000)
            base[:, 3] = base[:, 4] + small
            z = small / 0.06 + r.standard_normal(4000)
            pool, names = pool_of(base, z, 0, True)
            right += sorted(choose(pool, BY_SIGNIFICANCE, names).chosen) == [3, 4]
        return right / 20

    with_trials = share()
    assert with_trials >= 0.65  # the partial F of the first must still exceed 4
    monkeypatch.setattr(stepwise, "TRIALS", 0)
    assert share() <= with_trials - 0.3


def test_nothing_of_a_pool_of_noise_is_let_in_more_often_than_the_level_says():
    let_in = 0
    for seed in range(100):
        r = np.random.default_rng(seed)
        base, z = r.standard_normal((800, 40)), r.standard_normal(800)
        pool, names = pool_of(base, z, 0, True)
        let_in += bool(choose(pool, BY_SIGNIFICANCE, names).chosen)
    assert let_in <= 12  # 5 expected; 12 or more happens in 1 of 200 studies


@pytest.mark.parametrize("seed", range(10))
def test_every_chosen_term_stands_by_itself_at_the_end(seed):
    # odd powers of four signals and their products: near copies, the higher ones with few telling moments
    r = np.random.default_rng(seed)
    x = r.standard_normal((1500, 4))
    base = np.column_stack([x, x * np.abs(x), x**3, x**5, x * x[:, [1, 2, 3, 0]], x**3 * np.abs(x[:, [1, 2, 3, 0]])])
    z = base[:, 0] + 0.3 * base[:, 5] - 0.05 * base[:, 10] + 0.1 * base[:, 17] + r.standard_t(4, 1500)
    pool, names = pool_of(base, z, 1, True)
    found = choose(pool, BY_SIGNIFICANCE, names)
    columns = [0, 1, *(k + 1 for k in found.chosen)]
    t, freedom = standing(Totals(pool), columns)
    assert np.all(probability(t, freedom)[2:] < 0.05 / 23)
    # what was dropped does not come back again and again
    assert len(found.log) <= BY_SIGNIFICANCE.cap + 1 + 3 * len(names)
    counted = [e for e in found.log if e["removed"] and not e["selected"]]
    assert (f"{len(counted)} dropped" in found.reason) == bool(counted)


def test_no_model_is_met_twice_once_the_trials_are_over():
    for seed in range(6):
        base, z = problem(seed, n=600, m=25)
        pool, names = pool_of(base, z, 1, True)
        found = choose(pool, BY_SIGNIFICANCE, names)
        present, met = set(), []
        for entry in found.log[1:]:
            present -= {entry["removed"]}
            present |= {entry["selected"]} - {None}
            met.append(frozenset(present))
        assert len(set(met)) == len(met)


def gusty(seed, flights, true=True):
    """Flights in which every column acts in one burst, with noise that remembers itself; the first one may be true."""
    r = np.random.default_rng(seed)
    rows, m = 4000, 40
    base = np.zeros((rows * flights, m))
    for k in range(m):
        for f in range(flights):
            begin = f * rows + r.integers(0, rows - 200)
            base[begin : begin + 200, k] = r.standard_normal() * np.hanning(200)
    noise = lfilter([1.0], [1.0, -0.97], r.standard_normal(len(base)))
    size = np.sqrt(noise.var() / base[:, 0].var())
    return base, noise + true * size * base[:, 0]


def chosen_of(base, z, flights):
    pool, names = pool_of(np.column_stack([base[:, 1] + base[:, 2], base]), z, 1, True, flights)
    options = Options(test="significance")
    return choose(pool, options, names, memory=lambda columns: 1 + round(100 / pool.length)).chosen


def test_a_term_that_left_out_flights_gain_by_stands_though_few_stretches_show_it(monkeypatch):
    found = [chosen_of(*gusty(seed, 4), 4) for seed in range(12)]
    assert sum(1 in c for c in found) >= 11
    assert sum(len(set(c) - {1}) for c in found) <= 1
    monkeypatch.setattr(stepwise, "LEAST_SHARE_TAKEN", np.inf)
    assert sum(1 in chosen_of(*gusty(seed, 4), 4) for seed in range(12)) <= 8


def test_columns_that_are_nothing_are_not_let_in_by_left_out_flights():
    for flights in (2, 3, 5):
        assert sum(len(chosen_of(*gusty(100 + seed, flights, False), flights)) for seed in range(10)) <= 1


def test_what_one_left_out_flight_would_lose_by_does_not_stand():
    """A column that three flights gain by and the fourth loses by."""
    base, z = gusty(3, 4)
    alike, apart = (z + 4.0 * base[:, 7] * np.repeat([1.0, 1.0, 1.0, last], 4000) * z.std() for last in (1.0, -1.0))
    assert 8 in chosen_of(base, alike, 4) and 8 not in chosen_of(base, apart, 4)
