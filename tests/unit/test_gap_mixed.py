"""Mixed models on cross-products against a plain solution, against known truths, and when nothing is there."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from quasi.gap.effect import Effect, Limits, Parameter
from quasi.gap.statistics import mixed as tests_on
from quasi.gap.statistics.mixed import SPREADS, Columns, Mixed, Offer, Witnessed
from quasi.gap.statistics.whitening import autoregression, block_grams, thin, whiten
from quasi.gap.wrench.naming import Named, _dominant, _several_or_one, search
from quasi.gap.wrench.study import in_stretches, joined

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
    mixed = Mixed(grams, [True] * 4, LAYOUT)
    test = mixed.test(Offer("a", "always", (0,)))
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

    class Alike(Mixed):
        informed = False

    mixed = Alike(grams, compared, LAYOUT)
    given = [Offer("a", "always", (0,))]

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
        test = mixed.test(Offer(cause, "changed", tuple(range(len(LAYOUT.causes[cause])))), given)
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
        test = Mixed(grams, compared, LAYOUT).test(Offer("a", "changed", (0,)), pooled=["a", "b", "c"])
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
        p.append(Mixed(grams, compared, LAYOUT).test(Offer(cause, "changed", (0,)), pooled=[cause]).p)
    p = np.array(p)
    assert np.mean(p < 0.1) < 0.15
    assert np.mean(p < 0.01) < 0.025


def effects(**parts):
    p = Parameter("1", 0.0, "a", -10.0, 10.0)
    return {
        c: Effect(c, "W", "", "", "", {str(k): p for k in range(len(LAYOUT.causes[c]))}, parts=parts.get(c, "any"))
        for c in LAYOUT.causes
    }


@pytest.mark.parametrize("since", ["changed", "always"])
def test_the_planted_cause_is_named_and_its_lookalike_is_not(since):
    rng = np.random.default_rng(5)
    compared = [False] * 4 + [True] * 4 if since == "changed" else [True] * 8
    grams, _ = flights(rng, 8, {3: 0.5}, compared)
    names = search(Mixed(grams, compared, LAYOUT), effects(), (since,), 0.01)
    assert [n.test.offer.cause for n in names.named] == ["a"]
    assert not names.ties
    assert [r.id for r in names.named[0].rivals] == ["b"]
    assert names.named[0].test.value[0] == pytest.approx(0.5, abs=3.0 * names.named[0].test.std[0])


def test_a_cause_that_explains_many_away_gives_way_to_the_one_that_explains_it_away():
    """a explains b away and leaves c, d and e; b explains these three away and would be a tie with a."""
    alone = dict(zip("abcde", (1e-18, 1e-9, 1e-6, 1e-6, 1e-6)))
    gone = {("b", "a"), *((k, "b") for k in "cde")}  # (which, beside what)

    class Told:
        def test(self, offer, given=(), pooled=()):
            p = 0.1 if any((offer.cause, g.cause) in gone for g in given) else alone[offer.cause]
            return tests_on.Test(offer, np.ones(1), np.eye(1), 1.0, -np.log(p), p)

        def spans(self, wide, narrow, given=()):
            return False

    told = Told()
    tests = [told.test(Offer(c, "changed", (0,))) for c in alone]
    catalogue = {c: Effect(c, "W", "", "", "") for c in alone}
    best, rivals, tie = _dominant(told, tests, [], [], 1e-3, catalogue)
    assert tie is None and best.offer.cause == "a"
    assert [r.id for r in rivals] == ["b"]


def test_causes_that_the_data_cannot_split_are_a_tie():
    rng = np.random.default_rng(6)
    grams, data = flights(rng, 6)
    twins = []
    for z in data:
        z[:, 5] = z[:, 4] + 1e-3 * rng.standard_normal(len(z))
        z[:, 0] += 0.5 * z[:, 4]
        twins.append(z.T @ z)
    names = search(Mixed(twins, [True] * 6, LAYOUT), effects(), ("always",), 0.01)
    assert not names.named
    assert {t.offer.cause for t in names.ties[0].tests} == {"a", "b"}
    assert names.ties[0].separability < 3.0


def test_indistinct_causes_are_a_tie_however_clear_one_of_them_is():
    rng = np.random.default_rng(6)
    compared = [False] * 4 + [True] * 4
    grams, _ = flights(rng, 8, {3: 0.6}, compared)
    mixed = Mixed(grams, compared, LAYOUT)
    plain = effects()
    assert search(mixed, plain, ("changed",), 0.01).named[0].test.offer.cause == "a"
    alike = plain | {"a": replace(plain["a"], indistinct=("b",))}
    found = search(mixed, alike, ("changed",), 0.01)
    assert found.named == [] and {t.offer.cause for t in found.ties[0].tests} == {"a", "b"}


def test_beside_all_that_a_model_lacks_a_faint_cause_is_still_asked():
    names = [f"lacking {k}" for k in range(8)] + ["load"]
    rng, grams = np.random.default_rng(8), []
    for _ in range(6):
        x = rng.standard_normal((400, 11))
        y = x[:, 0] + x[:, 1:9].sum(axis=1) + 0.25 * x[:, 9] + rng.standard_normal(400)
        z = np.column_stack([y, x])
        grams.append(z.T @ z)
    layout = Columns([1], [11], np.array([0.5]), {name: [2 + k] for k, name in enumerate(names)})
    known = {n: Effect(n.replace(" ", "_"), "W", "", "", "", {"k": Parameter("1", 0.0, "a", -9.0, 9.0)}) for n in names}
    found = search(Mixed(grams, [True] * 6, layout), known, ("always",), 0.01)
    assert {n.test.offer.cause for n in found.named} == set(names)


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
        test = Mixed(grams, compared, LAYOUT).best("c", "changed", (), ["a", "b", "c"], "one")
        assert len(test.offer.which) == 1
        right += test.offer.which == (0,)
    assert right >= 19


def test_a_declared_rival_that_is_likelier_though_unsteady_makes_a_tie():
    """What truly acts has another size in each flight; its rival shows half of it, steadily."""
    rng = np.random.default_rng(3)
    compared = [False] * 4 + [True] * 4
    grams = []
    for flag, size in zip(compared, [0.0, 0.0, 0.0, 0.0, 0.6, 1.6, 0.7, 1.5]):
        x = rng.standard_normal((400, 7))
        y = x[:, 0] + 0.5 * rng.standard_normal(400) + flag * (size * x[:, 3] + 0.35 * x[:, 4])
        z = np.column_stack([y, x])
        grams.append(z.T @ z)
    mixed = Mixed(grams, compared, LAYOUT)
    plain = effects()
    assert search(mixed, plain, ("changed",), 1e-4).named[0].test.offer.cause == "b"
    rivals = plain | {"b": replace(plain["b"], rivals=("a",))}
    found = search(mixed, rivals, ("changed",), 1e-4)
    assert not found.named and [t.offer.cause for t in found.ties[0].tests] == ["b", "a"]


def stretched(rng, compared, make, stretches=5, rows=400):
    """Cross-products of the stretches of flights; make(x, flag) -> y of columns x, which it may change."""
    grams = []
    for flag in compared:
        x = rng.standard_normal((rows * stretches, 7))
        z = np.column_stack([make(x, flag), x])
        grams.append(np.array([part.T @ part for part in np.split(z, stretches)]))
    return Mixed(grams, compared, LAYOUT)


def test_a_declared_rival_beside_which_a_cause_is_not_significant_makes_a_tie():
    """b shows four fifths of what a does: suspicious alone, not significant itself, and a does not stand beside it."""
    rng = np.random.default_rng(6)

    def made(x, flag):
        x[:, 4] = 0.8 * x[:, 3] + 0.6 * x[:, 4]
        return x[:, 0] + rng.standard_normal(len(x)) + flag * 0.13 * x[:, 3]

    mixed = stretched(rng, [False] * 4 + [True] * 4, made)
    pooled, level = ["a", "b", "c"], 5e-5
    a, b = (Offer(name, "changed", (0,)) for name in "ab")
    assert mixed.test(a, (), pooled).p < level < mixed.test(b, (), pooled).p < 0.01
    assert mixed.test(a, [b], pooled).p > level
    plain = effects()
    assert search(mixed, plain, ("changed",), 3 * level).named[0].test.offer.cause == "a"
    for declaring in "ab":  # either file may say so
        other = "b" if declaring == "a" else "a"
        known = plain | {declaring: replace(plain[declaring], rivals=(other,))}
        tie = search(mixed, known, ("changed",), 3 * level).ties[0]
        assert [t.offer.cause for t in tie.tests] == ["a", "b"] and tie.separability < 5.0


@pytest.mark.parametrize(("since", "named"), [("changed", {"a"}), ("always", {"a", "c"})])
def test_beside_a_clear_change_a_faint_one_may_be_its_form(since, named):
    """c explains a hundredth of what a does, and that surely."""
    rng = np.random.default_rng(12)
    compared = [False] * 4 + [True] * 4 if since == "changed" else [True] * 8
    mixed = stretched(
        rng, compared, lambda x, flag: x[:, 0] + rng.standard_normal(len(x)) + flag * (1.2 * x[:, 3] + 0.13 * x[:, 5])
    )
    pooled = ["a", "b", "c"] if since == "changed" else []
    assert mixed.test(Offer("c", since, (0,)), [Offer("a", since, (0,))], pooled).p < 1e-4
    found = search(mixed, effects(), (since,), 0.01).named
    assert {n.test.offer.cause for n in found} == named


@pytest.mark.parametrize(("alike", "named"), [(True, []), (False, ["a"])])
def test_manoeuvres_of_one_flight_that_err_alike_are_one_witness(alike, named):
    """Three flights whose eight stretches each err by one size, by chance mostly to one side; a cause errs by none."""
    rng = np.random.default_rng(14)
    sizes = [0.9, 0.4, -0.2] if alike else [0.45, 0.4, 0.5]
    grams = []
    for size in [0.0, 0.1, -0.1, 0.05, *sizes]:
        own = []
        for _ in range(8):
            x = rng.standard_normal((50, 7))
            y = x[:, 0] + size * x[:, 3] + rng.standard_normal(50)
            z = np.column_stack([y, x])
            own.append(z.T @ z)
        grams.append(np.array(own))
    compared = [False] * 4 + [True] * 3
    stretches, witnessed = Mixed(grams, compared, LAYOUT), Witnessed(grams, compared, LAYOUT)
    assert [n.test.offer.cause for n in search(stretches, effects(), ("changed",), 0.01).named] == ["a"]
    assert [n.test.offer.cause for n in search(witnessed, effects(), ("changed",), 0.01).named] == named


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

    offer = Offer("a", "changed", (0,))
    for size in (0.0, 0.3):
        grams = drawn(4, size)
        both, own = Witnessed(grams, compared, LAYOUT).test(offer), Mixed(grams, compared, LAYOUT).test(offer)
        whole = Mixed([g.sum(axis=0) for g in grams], compared, LAYOUT).test(offer)
        assert both.p == pytest.approx(np.sqrt(own.p * whole.p_known_spread))
        assert both._replace(p=0.0).wald == own.wald and both.value == own.value
    assert both.p < 1e-3
    short = drawn(1, 0.3)
    assert Witnessed(short, compared, LAYOUT).test(offer).p == Mixed(short, compared, LAYOUT).test(offer).p


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
    offer = Offer("a", "changed", (0,))
    test = Mixed(grams, compared, LAYOUT).test(offer, pooled=["a"])
    assert test.value[0] == pytest.approx(2.0, abs=0.2) and test.p < 1e-4

    class Alike(Mixed):
        informed = False

    assert Alike(grams, compared, LAYOUT).test(offer, pooled=["a"]).p > 0.01


def test_two_causes_at_once_are_both_named():
    rng = np.random.default_rng(7)
    grams, _ = flights(rng, 6, {3: 0.5, 6: -0.4})
    names = search(Mixed(grams, [True] * 6, LAYOUT), effects(), ("always",), 0.01)
    assert {(n.test.offer.cause, n.test.offer.which) for n in names.named} == {("a", (0,)), ("c", (1,))}


def test_an_estimate_outside_its_physical_range_is_not_named():
    rng = np.random.default_rng(8)
    grams, _ = flights(rng, 6, {3: 0.5})
    names = search(Mixed(grams, [True] * 6, LAYOUT), effects(), ("always",), 0.01, within={"a": Limits([(-0.1, 0.1)])})
    assert "a" not in [n.test.offer.cause for n in names.named]
    assert names.passed[Offer("a", "always", (0,))] == "its size would be outside what is physical"


@pytest.mark.parametrize("about", [0, 1])
def test_a_cause_is_named_by_a_parameter_that_it_is_about_not_by_one_that_accompanies(about):
    rng = np.random.default_rng(10)
    grams, _ = flights(rng, 6, {6: -0.5})
    known = effects(c="all")
    for k in (0, 1):
        known["c"].parameters[str(k)] = Parameter("1", 0.0, "a", -10.0, 10.0, 1.0 if k == about else None)
    names = search(Mixed(grams, [True] * 6, LAYOUT), known, ("always",), 0.01)
    assert [n.test.offer.cause for n in names.named] == (["c"] if about == 1 else [])
    whys = {o.cause: why for o, why in names.passed.items()}
    assert "c" not in whys if about == 1 else "only what accompanies it differs" in whys["c"]


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


def test_beside_a_clear_simple_cause_a_wider_one_needs_more_than_a_little():
    """c nearly holds a's column and has one more, significant, that explains a hundredth as much: the form of a."""
    for size, name in ((0.11, "a"), (1.0, "c")):
        rng = np.random.default_rng(11)
        compared = [False] * 4 + [True] * 4
        grams = []
        for flag in compared:
            x = rng.standard_normal((1500, 7))
            x[:, 5] = x[:, 3] + 0.02 * x[:, 5]
            y = x[:, 0] + 0.3 * rng.standard_normal(1500) + flag * (x[:, 3] + size * x[:, 6])
            z = np.column_stack([y, x])
            grams.append(z.T @ z)
        mixed = Mixed(grams, compared, LAYOUT)
        beside = mixed.test(Offer("c", "changed", (0, 1)), [Offer("a", "changed", (0,))], ["a", "b", "c"])
        assert beside.p < 0.01 / 3
        assert search(mixed, effects(c="all"), ("changed",), 0.01).named[0].test.offer.cause == name


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
    offer = Offer("a", "always", (0,))
    once = Mixed(grams, [True] * 6, LAYOUT._replace(shared=[1])).test(offer)
    twice = Mixed(doubled, [True] * 6, LAYOUT).test(offer)
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


@pytest.mark.parametrize("planted", ["one", "several"])
def test_several_parameters_of_one_cause_give_way_to_one_of_another_that_explains_the_same(planted):
    """Two equally weak rotors on one side are a moved centre of gravity; unequal ones are not."""
    rng = np.random.default_rng(3)
    grams = []
    for _ in range(6):
        x = rng.standard_normal((400, 7))
        x[:, 3] = x[:, 5] + x[:, 6] + 0.05 * rng.standard_normal(400)
        sizes = (0.5, 0.5) if planted == "one" else (0.8, 0.2)
        y = x[:, 0] + sizes[0] * x[:, 5] + sizes[1] * x[:, 6] + rng.standard_normal(400)
        z = np.column_stack([y, x])
        grams.append(z.T @ z)
    mixed, known = Mixed(grams, [True] * 6, LAYOUT), effects()
    parts = [Named(mixed.test(Offer("c", "always", (k,)), [Offer("c", "always", (1 - k,))]), []) for k in (0, 1)]
    named, ties = _several_or_one(mixed, known, parts, [], 1e-3)
    if planted == "one":
        assert named == []
        assert [[t.offer.cause for t in tie.tests] for tie in ties] == [["a", "c"]]
    else:
        assert [n.test.offer.cause for n in named] == ["c", "c"]
        assert ties == []


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
            test = Mixed(grams, compared, layout).test(Offer("a", "changed", (0,)), pooled=["a"])
            errors.append(abs(test.value[0] - 0.4))
        off.append(np.median(errors))
    assert off[0] > 5.0
    assert off[1] < 1.0
