"""Selection of causes: dominance, ties, elimination, physical ranges, several parameters against one."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from test_gap_mixed import LAYOUT, flights, stretched

from quasi.gap.effect import Effect, Limits, Parameter
from quasi.gap.levels.forces.search import excess_of, share_in_common
from quasi.gap.profile import Profile
from quasi.gap.selection import FORM_ERROR, Named, Search
from quasi.gap.statistics import mixed as tests_on
from quasi.gap.statistics.candidates import Candidate, Columns
from quasi.gap.statistics.clustered import ClusteredMixedModel
from quasi.gap.statistics.mixed import MixedModel


def searching(mixed, effects, since="always", rate=0.01, within=None):
    """A search for one kind of cause, ready to run."""
    profiles = {n: Profile.of(e, (within or {}).get(n)) for n, e in effects.items()}
    return Search(mixed, profiles, since, rate)


def select(mixed, effects, since, rate, within=None):
    profiles = {n: Profile.of(e, (within or {}).get(n)) for n, e in effects.items()}
    return Search(mixed, profiles, since[0], rate).run()


def effects(**parts):
    p = Parameter("1", 0.0, "a", -10.0, 10.0)
    return {
        c: Effect(c, "forces", "", "", "", {str(k): p for k in range(len(LAYOUT.causes[c]))}, parts=parts.get(c, "any"))
        for c in LAYOUT.causes
    }


@pytest.mark.parametrize("since", ["changed", "always"])
def test_the_planted_cause_is_named_and_its_lookalike_is_not(since):
    rng = np.random.default_rng(5)
    compared = [False] * 4 + [True] * 4 if since == "changed" else [True] * 8
    grams, _ = flights(rng, 8, {3: 0.5}, compared)
    names = select(MixedModel(grams, compared, LAYOUT), effects(), (since,), 0.01)
    assert [n.test.offer.cause for n in names.named] == ["a"]
    assert not names.ties
    assert [r.id for r in names.named[0].rivals] == ["b"]
    assert names.named[0].test.value[0] == pytest.approx(0.5, abs=3.0 * names.named[0].test.std[0])


class Stated:
    """Tests with p-values as stated: of each cause alone, and 0.1 with something given that explains it away."""

    def __init__(self, alone, gone):
        self.alone, self.gone = alone, gone
        self.columns = Columns([], [], np.zeros(0), {c: [1 + k] for k, c in enumerate(alone)})

    def pooled(self, since):
        return []

    def test(self, offer, given=(), pooled=()):
        p = 0.1 if any((offer.cause, g.cause) in self.gone for g in given) else self.alone[offer.cause]
        return tests_on.Test(offer, np.ones(1), np.eye(1), 1.0, -np.log(p), p)

    def spans(self, wide, narrow, given=()):
        return False


def dominant(alone, gone):
    """The best of causes (name: p-value) and the rivals that it explains away. gone  (which, with what given)"""
    stated = Stated(alone, gone)
    tests = [stated.test(Candidate(c, "changed", (0,))) for c in alone]
    catalogue = {c: Effect(c, "forces", "", "", "") for c in alone}
    best, rivals, tie = searching(stated, catalogue, "changed", 5e-3)._dominant(tests)
    assert tie is None
    return best.offer.cause, [r.id for r in rivals]


def test_a_cause_that_explains_many_away_gives_way_to_the_one_that_explains_it_away():
    """a explains b away and leaves c, d and e; b explains these three away and would be a tie with a."""
    alone = dict(zip("abcde", (1e-18, 1e-9, 1e-6, 1e-6, 1e-6)))
    assert dominant(alone, {("b", "a"), *((k, "b") for k in "cde")}) == ("a", ["b"])


@pytest.mark.parametrize(("p", "first"), [(1e-25, "a"), (0.9e-31, "b")])
def test_of_undisputed_causes_a_clearly_fainter_one_is_not_first_for_the_rivals_that_it_explains_away(p, first):
    """b explains c away, which a leaves: that counts where b is as clear as a but for what forms err by."""
    assert dominant({"a": 1e-32, "b": p, "c": 1e-9}, {("c", "b")}) == (first, ["c"] if first == "b" else [])


def test_a_tie_counts_every_column_of_a_cause_of_equal_parameters():
    class Equal(Stated):
        def test(self, offer, given=(), pooled=()):
            columns = 2 if offer.which == (1,) else 1
            return super().test(offer, given, pooled)._replace(value=np.ones(columns), covariance=np.eye(columns))

    stated = Equal({"a": 1e-9, "b": 1e-8}, {("a", "b"), ("b", "a")})
    catalogue = {c: Effect(c, "forces", "", "", "", rivals=tuple("ab")) for c in "ab"}
    tests = [stated.test(Candidate("a", "changed", (1,))), stated.test(Candidate("b", "changed", (0,)))]
    search = searching(stated, catalogue, "changed", 5e-3)
    for tie in (search._dominant(tests)[2], search._not_ruled_out(tests[0], tests)):
        assert tie.tests[0].offer.cause == "a"
        assert tie.separability == pytest.approx((-np.log(0.1) / 2) ** 0.5)


def test_causes_that_the_data_cannot_split_are_a_tie():
    rng = np.random.default_rng(6)
    grams, data = flights(rng, 6)
    twins = []
    for z in data:
        z[:, 5] = z[:, 4] + 1e-3 * rng.standard_normal(len(z))
        z[:, 0] += 0.5 * z[:, 4]
        twins.append(z.T @ z)
    names = select(MixedModel(twins, [True] * 6, LAYOUT), effects(), ("always",), 0.01)
    assert not names.named
    assert {t.offer.cause for t in names.ties[0].tests} == {"a", "b"}
    assert names.ties[0].separability < 3.0


def test_indistinct_causes_are_a_tie_however_clear_one_of_them_is():
    rng = np.random.default_rng(6)
    compared = [False] * 4 + [True] * 4
    grams, _ = flights(rng, 8, {3: 0.6}, compared)
    mixed = MixedModel(grams, compared, LAYOUT)
    plain = effects()
    assert select(mixed, plain, ("changed",), 0.01).named[0].test.offer.cause == "a"
    alike = plain | {"a": replace(plain["a"], always_tied_with=("b",))}
    found = select(mixed, alike, ("changed",), 0.01)
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
    known = {
        n: Effect(n.replace(" ", "_"), "forces", "", "", "", {"k": Parameter("1", 0.0, "a", -9.0, 9.0)}) for n in names
    }
    found = select(MixedModel(grams, [True] * 6, layout), known, ("always",), 0.01)
    assert {n.test.offer.cause for n in found.named} == set(names)


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
    mixed = MixedModel(grams, compared, LAYOUT)
    plain = effects()
    assert select(mixed, plain, ("changed",), 1e-4).named[0].test.offer.cause == "b"
    rivals = plain | {"b": replace(plain["b"], rivals=("a",))}
    found = select(mixed, rivals, ("changed",), 1e-4)
    assert not found.named and [t.offer.cause for t in found.ties[0].tests] == ["b", "a"]


def test_a_declared_rival_beside_which_a_cause_is_not_significant_makes_a_tie():
    """b shows four fifths of what a does: suspicious alone, not significant itself, and a does not stand beside it."""
    rng = np.random.default_rng(6)

    def made(x, flag):
        x[:, 4] = 0.8 * x[:, 3] + 0.6 * x[:, 4]
        return x[:, 0] + rng.standard_normal(len(x)) + flag * 0.13 * x[:, 3]

    mixed = stretched(rng, [False] * 4 + [True] * 4, made)
    pooled, level = ["a", "b", "c"], 5e-5
    a, b = (Candidate(name, "changed", (0,)) for name in "ab")
    assert mixed.test(a, (), pooled).p < level < mixed.test(b, (), pooled).p < 0.01
    assert mixed.test(a, [b], pooled).p > level
    plain = effects()
    assert select(mixed, plain, ("changed",), 3 * level).named[0].test.offer.cause == "a"
    for declaring in "ab":  # either file may say so
        other = "b" if declaring == "a" else "a"
        known = plain | {declaring: replace(plain[declaring], rivals=(other,))}
        tie = select(mixed, known, ("changed",), 3 * level).ties[0]
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
    assert mixed.test(Candidate("c", since, (0,)), [Candidate("a", since, (0,))], pooled).p < 1e-4
    found = select(mixed, effects(), (since,), 0.01).named
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
    stretches, witnessed = MixedModel(grams, compared, LAYOUT), ClusteredMixedModel(grams, compared, LAYOUT)
    assert [n.test.offer.cause for n in select(stretches, effects(), ("changed",), 0.01).named] == ["a"]
    assert [n.test.offer.cause for n in select(witnessed, effects(), ("changed",), 0.01).named] == named


def test_two_causes_at_once_are_both_named():
    rng = np.random.default_rng(7)
    grams, _ = flights(rng, 6, {3: 0.5, 6: -0.4})
    names = select(MixedModel(grams, [True] * 6, LAYOUT), effects(), ("always",), 0.01)
    assert {(n.test.offer.cause, n.test.offer.which) for n in names.named} == {("a", (0,)), ("c", (1,))}


def test_an_estimate_outside_its_physical_range_is_not_named():
    rng = np.random.default_rng(8)
    grams, _ = flights(rng, 6, {3: 0.5})
    names = select(
        MixedModel(grams, [True] * 6, LAYOUT), effects(), ("always",), 0.01, within={"a": Limits([(-0.1, 0.1)])}
    )
    assert "a" not in [n.test.offer.cause for n in names.named]
    assert names.rejected[Candidate("a", "always", (0,))] == "its size would be outside what is physical"


@pytest.mark.parametrize("shown", [True, False], ids=["references show it", "nobody shows it"])
def test_a_change_below_zero_is_physical_where_reference_flights_show_the_cause(shown):
    rng = np.random.default_rng(9)
    compared = [False] * 4 + [True] * 4
    planted = [not c for c in compared] if shown else compared
    grams, _ = flights(rng, 8, {3: 0.5 if shown else -0.5}, planted)
    within = {"a": Limits([(0.0, 10.0)])}
    names = select(MixedModel(grams, compared, LAYOUT), effects(), ("changed",), 0.01, within=within)
    found = {n.test.offer: n.test for n in names.named}
    change = Candidate("a", "changed", (0,))
    assert (change in found) == shown
    if shown:
        assert found[change].value[0] == pytest.approx(-0.5, abs=3.0 * found[change].std[0])
    else:
        assert names.rejected[change] == "its size would be outside what is physical"


@pytest.mark.parametrize("size", [0.5, 3.0])
def test_two_causes_that_cancel_are_not_named_where_each_makes_far_more_than_the_model_leaves(size):
    """F = m a: a drag that grew is what a mass and a thrust that shrank in proportion leave, whatever their size."""
    rng = np.random.default_rng(13)
    compared = [False] * 4 + [True] * 4
    thrust = [2.0 + 0.5 * rng.standard_normal(400) for _ in compared]
    drag = [0.2 * rng.standard_normal(400) for _ in compared]
    data = []
    for flag, push, pull in zip(compared, thrust, drag):
        measured = push + pull + 1e-3 * rng.standard_normal(400)
        y = flag * size * pull + 0.02 * rng.standard_normal(400)
        data.append(np.column_stack([y, rng.standard_normal((400, 3)), measured, push]))
    layout = Columns([1, 2], [3], np.array([0.5]), {"a": [4], "b": [5]})
    mixed = MixedModel([z.T @ z for z in data], compared, layout)
    design = SimpleNamespace(columns=layout, raw=[np.stack([z.T @ z] * 6) for z in data])
    known = {n: e for n, e in effects().items() if n in layout.causes}
    one = searching(mixed, known, "changed")
    pair = [Candidate(n, "changed", (0,)) for n in "ab"]
    both = [mixed.test(pair[0], pair[1:]), mixed.test(pair[1], pair[:1])]
    assert both[0].p < one.level and excess_of(design, compared, both[0]) > 1.0 / FORM_ERROR
    one.rules = one.rules._replace(excess=partial(excess_of, design, compared))
    one.given, one.found = list(pair), {key: [] for key in pair}
    assert len(one._eliminate()) < 2
    always = both[0]._replace(offer=pair[0]._replace(since="always"))  # the model's own terms take part of it
    assert excess_of(design, compared, always) == 0.0


@pytest.mark.parametrize(
    ("planted", "found"), [({5: 0.5, 6: 0.4}, {0, 1}), ({5: 0.5}, {0}), ({6: 0.4}, set())],
    ids=["both", "the first alone", "the companion alone"],
)  # fmt: skip
def test_a_parameter_that_accompanies_another_is_asked_only_where_that_one_is_there(planted, found):
    rng = np.random.default_rng(12)
    grams, _ = flights(rng, 6, planted)
    known = effects(c="paired")
    layout = LAYOUT._replace(causes={"c": LAYOUT.causes["c"]})
    names = select(MixedModel(grams, [True] * 6, layout), {"c": known["c"]}, ("always",), 0.01)
    assert {k for n in names.named for k in n.test.offer.which} == found


@pytest.mark.parametrize("about", [0, 1])
def test_a_cause_is_named_by_a_parameter_that_it_is_about_not_by_one_that_accompanies(about):
    rng = np.random.default_rng(10)
    grams, _ = flights(rng, 6, {6: -0.5})
    known = effects(c="all")
    for k in (0, 1):
        known["c"].parameters[str(k)] = Parameter("1", 0.0, "a", -10.0, 10.0, 1.0 if k == about else None)
    names = select(MixedModel(grams, [True] * 6, LAYOUT), known, ("always",), 0.01)
    assert [n.test.offer.cause for n in names.named] == (["c"] if about == 1 else [])
    whys = {o.cause: why for o, why in names.rejected.items()}
    assert "c" not in whys if about == 1 else "only its accompanying parameters differ" in whys["c"]


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
        mixed = MixedModel(grams, compared, LAYOUT)
        beside = mixed.test(Candidate("c", "changed", (0, 1)), [Candidate("a", "changed", (0,))], ["a", "b", "c"])
        assert beside.p < 0.01 / 3
        assert select(mixed, effects(c="all"), ("changed",), 0.01).named[0].test.offer.cause == name


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
    mixed, known = MixedModel(grams, [True] * 6, LAYOUT), effects()
    parts = [
        Named(mixed.test(Candidate("c", "always", (k,)), [Candidate("c", "always", (1 - k,))]), []) for k in (0, 1)
    ]
    one = searching(mixed, known, rate=3e-3)
    one.given = [part.test.offer for part in parts]
    one.found = dict.fromkeys(one.given)
    named, ties = one._one_for_several(parts)
    if planted == "one":
        assert named == []
        assert [[t.offer.cause for t in tie.tests] for tie in ties] == [["a", "c"]]
    else:
        assert [n.test.offer.cause for n in named] == ["c", "c"]
        assert ties == []


@pytest.mark.parametrize(
    ("first", "second", "common"),
    [((0.5, 0.45, 0.05), (0.0, 0.0, 1.0), 0.05),  # wind and a weight: little of it is vertical
     ((0.5, 0.45, 0.05), (0.6, 0.3, 0.1), 0.85), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.0),
     ((0.2, 0.3, 0.5), (0.2, 0.3, 0.5), 1.0)],
)  # fmt: skip
def test_causes_share_what_lies_on_the_same_axes(first, second, common):
    """Shares of power in units of each axis' error, which is 2 here."""
    raw = np.zeros((6, 3, 3))
    raw[:, 0, 0] = 2.0
    raw[:3, 1, 1], raw[:3, 2, 2] = first, second
    study = SimpleNamespace(columns=SimpleNamespace(causes={"a": [1], "b": [2]}), raw=[100.0 * raw, raw])
    one, other = (
        tests_on.Test(Candidate(n, "changed", (0,)), np.array([v]), np.eye(1), 1.0, 1.0, 1.0)
        for n, v in (("a", 3.0), ("b", 0.1))
    )
    assert share_in_common(study, [False, True], one, other) == pytest.approx(common)
    assert share_in_common(study, [False, True], other, one) == pytest.approx(common)
