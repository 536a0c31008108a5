"""Mixed models on cross-products against a plain solution, against known truths, and when nothing is there."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from quasi.gap.levels.forces.design import in_stretches, joined
from quasi.gap.statistics.candidates import Candidate, Columns
from quasi.gap.statistics.clustered import ClusteredMixedModel
from quasi.gap.statistics.mixed import SPREADS, MixedModel
from quasi.gap.statistics.whitening import autoregression, block_grams, thin, whiten

LAYOUT = Columns([1, 2], [3], np.array([0.5]), {"a": [4], "b": [5], "c": [6, 7]})


def flights(rng, number, effect=None, compared=None, rows=400, spread=0.0):
    """Cross-products of made flights: base 2 columns, one nuisance, causes a, b and c (two columns), white noise."""
    grams, data = [], []
    for f in range(number):
        x = rng.standard_normal((rows, 7))
        x[:, 4] += 0.9 * x[:, 3]  # b resembles a
        y = x[:, 0] - 2.0 * x[:, 1] + 0.5 * rng.standard_normal() * x[:, 2] + rng.standard_normal(rows)
        if effect is not None and (compared is None or compared[f]):
            for column, value in effect.items():
                y = y + (value + spread * rng.standard_normal()) * x[:, column]
        z = np.column_stack([y, x])
        grams.append(z.T @ z)
        data.append(z)
    return grams, data


def test_estimate_and_covariance_equal_generalised_least_squares():
    """tau at its floor is known; then the whole model is y ~ N(X b, V) with V written out."""
    rng = np.random.default_rng(1)
    grams, data = flights(rng, 4, {3: 0.3})
    mixed = MixedModel(grams, [True] * 4, LAYOUT)
    test = mixed.test(Candidate("a", "always", (0,)))
    unit = 1.0 / np.sqrt(np.mean([g[4, 4] for g in mixed.grams]))
    information, right = np.zeros((3, 3)), np.zeros(3)
    for z in data:
        v = np.eye(len(z)) + 0.25 * np.outer(z[:, 3], z[:, 3]) + (test.tau * unit) ** 2 * np.outer(z[:, 4], z[:, 4])
        x = z[:, [1, 2, 4]]
        information += x.T @ np.linalg.solve(v, x)
        right += x.T @ np.linalg.solve(v, z[:, 0])
    covariance = np.linalg.inv(information)
    assert test.value[0] == pytest.approx((covariance @ right)[2], rel=1e-6)
    assert test.std[0] == pytest.approx(np.sqrt(covariance[2, 2]), rel=1e-6)


def test_stretches_spread_and_likelihood_equal_those_of_the_covariance_written_out():
    """Two parameters that differ between the stretches of a flight, a nuisance per flight, a cause given."""
    rng = np.random.default_rng(11)
    compared = [False, False, True, True]
    grams, data = [], []
    for flag in compared:
        x = rng.standard_normal((240, 7))
        y = x[:, 0] + 0.5 * rng.standard_normal() * x[:, 2] + rng.standard_normal(240)
        for part in (slice(0, 80), slice(80, 160), slice(160, 240)):
            sizes = flag * np.array([0.4, -0.3]) + 0.6 * rng.standard_normal(2)
            y[part] += x[part][:, 5:] @ sizes
        z = np.column_stack([y, x])
        data.append(z)
        grams.append(np.array([z[part].T @ z[part] for part in (slice(0, 80), slice(80, 160), slice(160, 240))]))

    class Alike(MixedModel):
        informed = False

    mixed = Alike(grams, compared, LAYOUT)
    given = [Candidate("a", "always", (0,))]

    def written_out(columns, tau):
        """-2 log restricted likelihood and likelihood, up to constants, estimate and covariance."""
        unit = 1.0 / np.sqrt(sum(g[columns, columns] for g in mixed.grams) / 12)
        size = 3 + len(columns)
        information, right, left, log = np.zeros((size, size)), np.zeros(size), 0.0, 0.0
        for z, flag in zip(data, compared):
            v = np.eye(240) + 0.25 * np.outer(z[:, 3], z[:, 3])
            for part in (slice(0, 80), slice(80, 160), slice(160, 240)):
                own = z[part][:, columns] * unit
                v[part, part] += tau**2 * own @ own.T
            x = np.column_stack([z[:, [1, 2, 4]], z[:, columns] * flag])
            information += x.T @ np.linalg.solve(v, x)
            right += x.T @ np.linalg.solve(v, z[:, 0])
            left += z[:, 0] @ np.linalg.solve(v, z[:, 0])
            log += np.linalg.slogdet(v)[1]
        value = np.linalg.solve(information, right)
        left -= right @ value
        restricted = left + log + np.linalg.slogdet(information)[1]
        return restricted, left + log, value[3:], np.linalg.inv(information)[3:, 3:]

    unlikely = []
    for cause in ("c", "b"):
        test = mixed.test(Candidate(cause, "changed", tuple(range(len(LAYOUT.causes[cause])))), given)
        expected = {tau: written_out(LAYOUT.causes[cause], tau) for tau in SPREADS}
        assert test.tau == min(expected, key=lambda tau: expected[tau][0])
        assert test.value == pytest.approx(expected[test.tau][2], rel=1e-6)
        assert test.covariance == pytest.approx(expected[test.tau][3], rel=1e-6)
        unlikely.append(test.unlikely - expected[test.tau][1])
    assert unlikely[0] == pytest.approx(unlikely[1], abs=1e-5)


def test_truth_lies_within_its_standard_errors():
    inside = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        compared = [False] * 4 + [True] * 4
        grams, _ = flights(rng, 8, {3: 0.4}, compared, spread=0.1)
        test = MixedModel(grams, compared, LAYOUT).test(Candidate("a", "changed", (0,)), pooled=["a", "b", "c"])
        inside += abs(test.value[0] - 0.4) < 2.0 * test.std[0]
    assert 52 <= inside <= 60


def test_p_values_are_no_smaller_than_chance_when_flights_merely_differ():
    """Every flight has its own value of the cause, compared or not: nothing has changed."""
    p = []
    for seed in range(240):
        rng = np.random.default_rng(1000 + seed)
        compared = [False] * 4 + [True] * 4
        column, cause = ((3, "a"), (4, "b"))[seed % 2]
        grams, _ = flights(rng, 8, {column: 0.0}, None, rows=100, spread=0.3)
        p.append(MixedModel(grams, compared, LAYOUT).test(Candidate(cause, "changed", (0,)), pooled=[cause]).p)
    p = np.array(p)
    assert np.mean(p < 0.1) < 0.15
    assert np.mean(p < 0.01) < 0.025


def test_of_alternatives_the_likeliest_is_taken_although_it_differs_more_between_flights():
    """The true column acts with a size of its own in each flight; a neighbour correlates with it and looks steadier."""
    right = 0
    for seed in range(20):
        rng = np.random.default_rng(200 + seed)
        compared = [False] * 4 + [True] * 4
        grams = []
        for f in range(8):
            x = rng.standard_normal((400, 7))
            x[:, 6] = 0.6 * x[:, 5] + 0.8 * x[:, 6]
            y = x[:, 0] + rng.standard_normal(400) + compared[f] * (0.6 + 0.2 * rng.standard_normal()) * x[:, 5]
            z = np.column_stack([y, x])
            grams.append(z.T @ z)
        test = MixedModel(grams, compared, LAYOUT).best("c", "changed", (), ["a", "b", "c"], "one")
        assert len(test.offer.which) == 1
        right += test.offer.which == (0,)
    assert right >= 19


def stretched(rng, compared, make, stretches=5, rows=400):
    """Cross-products of the stretches of flights; make(x, flag) -> y of columns x, which it may change."""
    grams = []
    for flag in compared:
        x = rng.standard_normal((rows * stretches, 7))
        z = np.column_stack([make(x, flag), x])
        grams.append(np.array([part.T @ part for part in np.split(z, stretches)]))
    return MixedModel(grams, compared, LAYOUT)


def test_stretches_and_whole_flights_both_have_a_say_in_p():
    """The geometric mean; estimates are those of the stretches."""
    rng = np.random.default_rng(15)
    compared = [False] * 4 + [True] * 3

    def drawn(count, size):
        parts = []
        for flag in compared:
            x = rng.standard_normal((count, 60, 7))
            y = x[..., 0] + flag * size * x[..., 3] + rng.standard_normal((count, 60))
            z = np.concatenate([y[..., None], x], axis=2)
            parts.append(np.einsum("kni,knj->kij", z, z))
        return parts

    offer = Candidate("a", "changed", (0,))
    for size in (0.0, 0.3):
        grams = drawn(4, size)
        both, own = (
            ClusteredMixedModel(grams, compared, LAYOUT).test(offer),
            MixedModel(grams, compared, LAYOUT).test(offer),
        )
        whole = MixedModel([g.sum(axis=0) for g in grams], compared, LAYOUT).test(offer)
        assert both.p == pytest.approx(np.sqrt(own.p * whole.p_known_spread))
        assert both._replace(p=0.0).wald == own.wald and both.value == own.value
    assert both.p < 1e-3
    short = drawn(1, 0.3)
    assert (
        ClusteredMixedModel(short, compared, LAYOUT).test(offer).p == MixedModel(short, compared, LAYOUT).test(offer).p
    )


def test_a_flight_that_hardly_excites_a_cause_does_not_hide_it():
    """Seven flights agree; an eighth, whose column is a twentieth, has a model error that looks huge."""
    rng = np.random.default_rng(7)
    compared = [False] * 4 + [True] * 4
    grams = []
    for f in range(8):
        x = rng.standard_normal((400, 7))
        x[:, 3] *= 0.05 if f == 7 else 1.0
        value = -12.0 if f == 7 else 2.0 if compared[f] else 0.0
        y = x[:, 0] - 2.0 * x[:, 1] + value * x[:, 3] + rng.standard_normal(400)
        z = np.column_stack([y, x])
        grams.append(z.T @ z)
    offer = Candidate("a", "changed", (0,))
    test = MixedModel(grams, compared, LAYOUT).test(offer, pooled=["a"])
    assert test.value[0] == pytest.approx(2.0, abs=0.2) and test.p < 1e-4

    class Alike(MixedModel):
        informed = False

    assert Alike(grams, compared, LAYOUT).test(offer, pooled=["a"]).p > 0.01


def test_whitening_makes_coloured_noise_white_and_leaves_out_gaps():
    rng = np.random.default_rng(9)
    noise = rng.standard_normal(6000)
    y = np.zeros(6000)
    for k in range(2, 6000):
        y[k] = 1.6 * y[k - 1] - 0.7 * y[k - 2] + noise[k]
    breaks = np.arange(6000) == 0
    breaks[3000] = True
    whitener = autoregression([y[:, None]], [breaks], 4)
    np.testing.assert_allclose(whitener.coefficients[0, 1:3], [-1.6, 0.7], atol=0.05)
    white, rows = whiten(y[:, None, None], breaks, whitener)
    assert len(rows) == 6000 - 2 * 4
    assert not set(range(3000, 3004)) & set(rows.tolist())
    e = white[:, 0, 0]
    assert e.std() == pytest.approx(1.0, abs=0.05)
    assert abs(np.corrcoef(e[1:], e[:-1])[0, 1]) < 0.04
    grams = block_grams(y[:, None, None], breaks, whitener, np.arange(6000) * 0.01, 5.0)
    assert len(grams) == 12
    assert grams.sum() == pytest.approx(e @ e, rel=1e-12)


def test_thinning_keeps_slow_signals_and_their_relations():
    t = np.arange(3000) * 0.01
    slow, fast = np.sin(2 * np.pi * 2.0 * t), np.sin(2 * np.pi * 30.0 * t)
    columns = np.stack([slow + fast, 2.0 * slow, fast], axis=1)[:, None, :]
    breaks = np.arange(3000) == 0
    part = thin(columns, breaks, t, 10.0, 10)
    kept = np.sin(2 * np.pi * 2.0 * t[part.rows])
    np.testing.assert_allclose(part.columns[:, 0, 1], 2.0 * kept, atol=0.02)
    np.testing.assert_allclose(part.columns[:, 0, 0], kept, atol=0.02)
    np.testing.assert_allclose(part.columns[:, 0, 0], 0.5 * part.columns[:, 0, 1] + part.columns[:, 0, 2], atol=1e-12)


def test_of_many_flights_the_stretches_get_longer_and_lose_nothing():
    blocks = np.arange(19.0)[:, None, None] * np.ones((1, 2, 2))
    few, many = in_stretches(blocks), in_stretches(blocks, 40)
    assert few[:, 0, 0].tolist() == [1, 5, 9, 13, 17, 21, 25, 29, 16 + 17 + 18]
    assert len(many) == 4 and many[0, 0, 0] == 0 + 1 + 2 + 3
    assert few.sum() == many.sum() == blocks.sum()
    assert len(in_stretches(blocks, 1000)) == 1 and len(joined(blocks[:2], 5)) == 2


def test_a_known_part_that_rounding_makes_indefinite_does_not_stop_a_test():
    """Twice the same column among the terms, its products off by rounding: as good as known once."""
    rng = np.random.default_rng(13)
    grams, _ = flights(rng, 6, {3: 0.5})
    doubled = []
    for g in grams:
        g = g.copy()
        g[2], g[:, 2] = g[1], g[:, 1]
        g[2, 2] = g[1, 1] * (1.0 - 1e-7)
        doubled.append(g)
    offer = Candidate("a", "always", (0,))
    once = MixedModel(grams, [True] * 6, LAYOUT._replace(shared=[1])).test(offer)
    twice = MixedModel(doubled, [True] * 6, LAYOUT).test(offer)
    assert twice.value == pytest.approx(once.value, abs=0.1 * once.std[0])
    assert twice.std == pytest.approx(once.std, rel=0.05)


@pytest.mark.parametrize("level", [1e-2, 3e-4])
@pytest.mark.parametrize("alike", [0.0, 0.5, 0.9, 0.99])
def test_the_geometric_mean_of_p_that_rise_together_is_no_smaller_than_chance(alike, level):
    """By integration: two normal statistics of correlation `alike` fall below the level together at most that often."""

    def both(z):
        need = min(2.0 * np.log(level) - norm.logsf(z), 0.0)  # log p of the other that does
        other = norm.isf(np.exp(need)) if need < 0.0 else -np.inf
        return norm.pdf(z) * norm.sf((other - alike * z) / np.sqrt(1.0 - alike**2))

    met, _ = quad(both, -8.0, 12.0, limit=500, points=[0.0, 2.0, 3.0, 4.0, 6.0])
    assert met <= level and (alike < 0.99 or met > 0.9 * level)


def test_what_reference_flights_cannot_show_is_bounded_and_does_not_become_the_change():
    """References excite the cause a thousandth as much; left free, their part is noise that the change inherits."""
    compared = [False] * 4 + [True] * 4
    off = []
    for bounds in ({}, {"a": np.array([1.0])}):
        errors = []
        for seed in range(20):
            rng = np.random.default_rng(seed)
            grams = []
            for flag in compared:
                x = rng.standard_normal((200, 7))
                x[:, 3] *= 1.0 if flag else 1e-3
                z = np.column_stack([x[:, 0] + 0.4 * flag * x[:, 3] + rng.standard_normal(200), x])
                grams.append(z.T @ z)
            layout = LAYOUT._replace(bounds=bounds)
            test = MixedModel(grams, compared, layout).test(Candidate("a", "changed", (0,)), pooled=["a"])
            errors.append(abs(test.value[0] - 0.4))
        off.append(np.median(errors))
    assert off[0] > 5.0
    assert off[1] < 1.0


def test_parameters_that_may_be_equal_are_one_where_they_are_and_several_where_they_are_not():
    rng = np.random.default_rng(5)
    layout = LAYOUT._replace(alike={"c": (8,)})
    for sizes, which in (([0.2, 0.2], (2,)), ([0.3, 0.0], (0, 1)), ([0.3, -0.3], (0, 1))):
        grams, _ = flights(rng, 6, dict(zip((5, 6), sizes)))
        summed = np.column_stack([np.eye(8), np.eye(8)[:, 6:].sum(axis=1)])
        mixed = MixedModel([summed.T @ g @ summed for g in grams], [True] * 6, layout)
        best = mixed.best("c", "always", parts="alike")
        assert best.offer.which == which
        columns, values, errors = layout.parameters(best)
        assert columns == [6, 7]
        assert np.all(np.abs(values - sizes) < 3.5 * errors)
        assert mixed.best("c", "always", [best.offer], parts="alike") is None
    # without effect the choice of two does not make significance
    low = 0
    for _ in range(200):
        grams, _ = flights(rng, 6)
        mixed = MixedModel([summed.T @ g @ summed for g in grams], [True] * 6, layout)
        low += mixed.best("c", "always", parts="alike").p < 0.05
    assert low <= 18  # of 200 at 0.05: mean 10 at most, three standard deviations above


def test_a_barred_parameter_is_offered_to_all_flights_but_not_to_the_compared_ones():
    rng = np.random.default_rng(3)
    compared = [False] * 4 + [True] * 4
    grams, _ = flights(rng, 8, {5: 0.5}, compared)
    alone, barred = (MixedModel(grams, compared, LAYOUT._replace(barred=bars)) for bars in ({}, {"c": frozenset({0})}))
    assert alone.best("c", "changed").offer.which == (0,)
    assert barred.best("c", "changed").offer.which == (1,)
    assert barred.best("c", "always").offer == alone.best("c", "always").offer
    assert barred.best("c", "changed", parts="paired") is None  # nor is what accompanies it
    everything = MixedModel(grams, compared, LAYOUT._replace(barred={"a": frozenset({0})}))
    assert everything.best("a", "changed") is None


@pytest.mark.parametrize(("also", "which"), [(0.3, (0, 1)), (0.0, (0,))])
def test_a_parameter_is_offered_together_with_the_one_that_accompanies_it_where_that_is_needed(also, which):
    """One fault with two parameters: each by itself may be fainter than another cause of what one of them makes."""
    rng = np.random.default_rng(4)
    compared = [False] * 4 + [True] * 4
    grams, _ = flights(rng, 8, {5: 0.5, 6: also}, compared)
    mixed = MixedModel(grams, compared, LAYOUT)
    first = mixed.best("c", "changed", parts="paired")
    assert first.offer.which == which
    if also:
        alone = mixed.test(Candidate("c", "changed", (0,)))
        assert first.p < alone.p
    given = [Candidate("c", "changed", (0,))]
    assert mixed.best("c", "changed", given, parts="paired").offer.which == (1,)
