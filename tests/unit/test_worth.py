"""Which significant causes matter on held-out flights: with errors that are known exactly."""

import numpy as np
import pytest

from quasi.gap.effect import Effect
from quasi.gap.materiality import Cause, Common, Judged, material, simplest
from quasi.gap.statistics import mixed
from quasi.gap.statistics.scores import Score, surely

SHARE = 0.05
BLOCKS = 40


def cause(name, since="changed", channels=("Fz",), p=1e-9, foreign=False, wald=50.0):
    effect = Effect(name, "forces", "", "", "", channels=channels, absent_when_healthy=foreign)
    return Cause(
        effect, since, {}, {}, mixed.Test(mixed.Candidate(name, since, (0,)), np.zeros(1), np.eye(1), 1.0, wald, p), []
    )


def judged(errors, unlikely=None):
    """Errors (6,), alike in every block up to 10 %; as unlikely as the errors are large unless told."""
    wobble = 1.0 + 0.1 * np.sin(np.arange(BLOCKS))[:, None]
    score = Score(np.asarray(errors, float) * wobble, np.ones(BLOCKS))
    return Judged(score, score, float(np.sum(errors)) if unlikely is None else unlikely)


def scored(table, default):
    """Errors by the names of the causes that are taken into account."""
    return lambda of, anew=False: judged(table.get(frozenset(c.effect.id for c in of), default))


def judged_by(causes, score, excited=lambda c: True, old=None, common=None):
    """What `material` says where held-out flights alone judge what all flights have alike."""
    old = judged(OLD if old is None else old).errors
    common = common or Common(lambda of, anew: score(of, anew).centred, old, FLOOR, SHARE)
    return material(causes, score, excited, old, FLOOR, SHARE, common)


OLD = np.array([1.0, 1.0, 4.0, 1.0, 1.0, 1.0])
FLOOR = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0])


def fz(value):
    return np.array([1.0, 1.0, value, 1.0, 1.0, 1.0])


def test_a_cause_that_takes_its_channels_error_away_is_kept_and_one_that_brings_nothing_is_not():
    a, b = cause("a"), cause("b")
    score = scored({frozenset("ab"): fz(1.0), frozenset("a"): fz(1.01), frozenset("b"): fz(4.0)}, OLD)
    kept, out, unjudged = judged_by([a, b], score)
    assert [c.effect.id for c in kept] == ["a"] and out == [b] and unjudged == []
    assert a.gain["Fz"]["value"] == pytest.approx(1.0, abs=0.02)


def test_a_constant_error_of_the_held_out_flight_does_not_hide_what_a_cause_takes_away():
    # its own thrust is off the other way: with the drift taken into account the whole error grows, the rest falls
    def score(of, anew=False):
        return judged(fz(4.5) if of else OLD)._replace(
            centred=judged(fz(1.1) if of else fz(2.0)).errors, unlikely=-len(of)
        )

    drift = cause("a")
    assert judged_by([drift], score)[0] == [drift]
    worse = cause("a")
    assert (
        judged_by([worse], lambda of, anew=False: score(of)._replace(unlikely=len(of), centred=judged(fz(2.0)).errors))[
            0
        ]
        == []
    )


def test_a_gain_in_channels_that_a_cause_does_not_act_on_counts_nothing():
    score = scored({frozenset("a"): fz(1.0)}, OLD)
    elsewhere = cause("a", channels=("Mz",))
    assert judged_by([elsewhere], score)[0] == []


def test_a_cause_that_makes_held_out_flights_worse_and_less_likely_is_left_out():
    a = cause("a", channels=("Fz", "Mx"))
    worse = np.array([1.0, 1.0, 3.9, 3.0, 1.0, 1.0])
    assert judged_by([a], scored({frozenset("a"): worse}, OLD))[0] == []


def test_what_held_out_flights_do_not_excite_they_cannot_refute():
    a = cause("a")
    kept, _, unjudged = judged_by([a], scored({}, OLD), lambda c: False)
    assert kept == [a] and unjudged == [a]


def test_what_all_flights_have_must_gain_on_a_channel_that_is_not_at_its_floor():
    a = cause("a", "always")
    noisy = fz(1.2)  # a sixth of the error could go at best
    for old, new, there in ((OLD, fz(1.0), True), (noisy, fz(1.0), False), (OLD, fz(3.99), False)):
        score = scored({frozenset("a"): new}, old)
        assert (judged_by([a], score, old=old)[0] == [a]) is there


def test_what_all_flights_have_must_gain_on_an_axis_of_its_own():
    # rotor drag was named of all flights for a yaw moment alone, although the model held the force that it makes
    score = scored({frozenset("a"): fz(1.0)}, OLD)
    for channels, there in ((("Fz",), True), (("Mz",), False), (("Fx", "My"), False)):
        a = cause("a", "always", channels=channels)
        assert (judged_by([a], score)[0] == [a]) is there


def test_what_no_sound_vehicle_has_needs_a_smaller_share_where_no_flight_is_healthy():
    """A tenth of what can go. A second one, a fifth as significant, may be the form of the first."""
    for foreign, share, there in ((True, SHARE, True), (False, SHARE, False), (True, None, False)):
        a = cause("a", "always", foreign=foreign)
        score = scored({frozenset("a"): fz(3.7)}, OLD)
        common = Common(
            lambda of, anew, s=score: s(of, anew).centred, judged(OLD).errors, FLOOR, 3 * SHARE, True, share
        )
        assert (judged_by([a], score, common=common)[0] == [a]) is there
    for wald, there in ((40.0, True), (10.0, False)):
        a, b = cause("a", "always", foreign=True), cause("b", "always", foreign=True, wald=wald)
        score = scored({frozenset("a"): fz(2.5), frozenset("b"): fz(2.5), frozenset("ab"): fz(1.0)}, OLD)
        common = Common(
            lambda of, anew, s=score: s(of, anew).centred, judged(OLD).errors, FLOOR, 3 * SHARE, True, SHARE
        )
        assert (b in judged_by([a, b], score, common=common)[0]) is there


@pytest.mark.parametrize("foreign, there", [(True, True), (False, False)])
def test_a_second_cause_that_no_sound_vehicle_has_needs_no_larger_share_than_the_first(foreign, there):
    """A tenth of what can go, beside one that is twice as significant."""
    a, b = cause("a", "always", foreign=True), cause("b", "always", foreign=foreign, wald=40.0)
    score = scored({frozenset("a"): fz(1.5), frozenset("b"): fz(3.7), frozenset("ab"): fz(1.2)}, OLD)
    common = Common(lambda of, anew: score(of, anew).centred, judged(OLD).errors, FLOOR, 3 * SHARE, True, SHARE)
    assert (b in judged_by([a, b], score, common=common)[0]) is there
    assert b.asked == (SHARE if foreign else 3 * SHARE)


def test_a_strong_foreign_cause_that_is_worth_nothing_stands_in_nobodys_way():
    a, b = cause("a", "always", foreign=True), cause("b", "always", foreign=True, wald=10.0)
    score = scored({frozenset("b"): fz(3.7), frozenset("ab"): fz(3.7), frozenset("a"): OLD}, OLD)
    common = Common(lambda of, anew: score(of, anew).centred, judged(OLD).errors, FLOOR, 3 * SHARE, True, SHARE)
    assert judged_by([a, b], score, common=common)[0] == [b]
    assert (a.asked, b.asked) == (SHARE, SHARE)


@pytest.mark.parametrize("needed", [True, False])
def test_what_a_foreign_cause_needs_to_be_seen_stays_beside_it_and_nothing_else_does(needed):
    """b brings nothing itself; where the model's terms stand in for it they take a's place."""
    a, b = cause("a", "always", foreign=True), cause("b", "always")
    both, alone = fz(2.0), fz(3.95) if needed else fz(2.05)
    score = scored({frozenset("ab"): both, frozenset("a"): alone, frozenset("b"): fz(3.0)}, OLD)
    common = Common(lambda of, anew: score(of, anew).centred, judged(OLD).errors, FLOOR, 15 * SHARE, True, SHARE)
    assert judged_by([a, b], score, common=common)[0] == ([a, b] if needed else [a])


def test_of_what_a_model_lacks_of_its_own_vehicle_the_most_significant_are_told():
    causes = [cause(name, "always", p=10.0 ** -(20 - k)) for k, name in enumerate("abcdefgh")]

    def score(of, anew=False):
        return judged(fz(4.0 - 0.35 * len(of)))

    for foreign, told in ((SHARE, "abcdef"), (None, "abcdefgh")):
        common = Common(lambda of, anew: score(of, anew).centred, judged(OLD).errors, FLOOR, SHARE, True, foreign)
        assert "".join(c.effect.id for c in judged_by(causes, score, common=common)[0]) == told


def test_of_what_all_flights_have_that_which_nothing_needs_goes_and_the_rest_stays():
    """b does harm: with it the two together gain nothing, a alone does."""
    a, b = cause("a", "always"), cause("b", "always")
    score = scored({frozenset("ab"): fz(4.1), frozenset("a"): fz(1.0), frozenset("b"): fz(6.0)}, OLD)
    assert judged_by([a, b], score)[0] == [a]


def test_what_other_flights_are_sure_of_the_held_out_one_may_still_refuse():
    a = cause("a", "always")
    sure = scored({frozenset("a"): fz(1.0)}, OLD)
    common = Common(lambda of, anew: sure(of, anew).centred, judged(OLD).errors, FLOOR, SHARE)
    for unlikely, kept in ((-1.0, [a]), (1.0, [])):
        held = scored({frozenset("a"): fz(1.0)}, OLD)
        likely = lambda of, anew=False, held=held, u=unlikely: held(of)._replace(unlikely=u * len(of))  # noqa: E731
        assert judged_by([a], likely, common=common)[0] == kept


def test_two_causes_that_mend_each_other_are_told_by_the_one_that_does_alone():
    a, b = cause("a"), cause("b")
    score = scored({frozenset("ab"): fz(1.0), frozenset("a"): fz(1.05), frozenset("b"): fz(3.0)}, OLD)
    assert simplest([a, b], list, score, judged(OLD).errors, FLOOR, SHARE) == [a]
    both = scored({frozenset("ab"): fz(1.0), frozenset("a"): fz(2.0), frozenset("b"): fz(2.0)}, OLD)
    assert simplest([a, b], list, both, judged(OLD).errors, FLOOR, SHARE) == [a, b]


def test_of_two_that_would_each_do_alone_the_other_flights_choose():
    a, b = cause("a", p=1e-12), cause("b", p=1e-6)
    score = scored({frozenset("ab"): fz(1.0), frozenset("a"): fz(1.1), frozenset("b"): fz(1.0)}, OLD)
    assert simplest([a, b], list, score, judged(OLD).errors, FLOOR, SHARE) == [a]
    score = scored({frozenset("ab"): fz(1.0), frozenset("a"): fz(2.0), frozenset("b"): fz(1.0)}, OLD)
    assert simplest([a, b], list, score, judged(OLD).errors, FLOOR, SHARE) == [b]  # held-out flights rule a out


def test_a_cause_that_held_out_flights_do_not_show_is_not_needless_to_them():
    a, b = cause("a"), cause("b")
    score = scored({frozenset("ab"): fz(1.0), frozenset("a"): fz(1.05), frozenset("b"): fz(3.0)}, OLD)
    assert simplest([a, b], list, score, judged(OLD).errors, FLOOR, SHARE, [b]) == [a, b]
    assert simplest([a, b], list, score, judged(OLD).errors, FLOOR, SHARE, [a]) == [a]


def test_what_is_sure_to_go_is_a_share_of_all_that_can():
    """Half of it goes in every block, but most of it lies in three of six: less than half is sure, but not none."""
    old = Score(np.array([[8.0], [1.0], [9.0], [2.0], [7.0], [1.5]]) * np.ones(6), np.ones(6))
    new = old._replace(values=0.5 * old.values)
    low = surely(old, new, old.mean())
    assert np.all(low < 0.5) and np.all(low > 0.2)
    one = old._replace(values=old.values * np.array([0.5, 1.0, 1.0, 1.0, 1.0, 1.0])[:, None])
    assert np.all(surely(old, one, old.mean()) == 0.0)  # a single block may be chance


def test_a_cause_that_acts_in_a_few_seconds_matters_where_it_acts():
    # 20 blocks of 5 s; the cause makes all of the error of one of them above a floor of 1
    values = np.ones((20, 6))
    values[3, 2] = 1.5
    old, new = Score(values, np.full(20, 500.0)), Score(np.ones((20, 6)), np.full(20, 500.0))
    brief = cause("ground_effect")

    def score(causes, _):
        errors = new if causes else old
        return Judged(errors, errors, 0.0 if causes else 10.0)

    def kept(acting):
        common = Common(lambda of, _: old, old, np.ones(6), 0.4)
        return material([brief], score, lambda _: True, old, np.full(6, 0.5), 0.06, common, acting)[0]

    assert kept(None) == []
    assert kept(lambda _: np.arange(20) == 3) == [brief]
    assert kept(lambda _: np.arange(20) == 4) == []
