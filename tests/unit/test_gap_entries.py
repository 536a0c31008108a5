"""How often a cause has to come again in resamples before it is named."""

from types import SimpleNamespace

import numpy as np
import pytest

from quasi.gap.effect import Effect
from quasi.gap.entries import ALONE, BESIDE, SURE, needed
from quasi.gap.statistics import mixed
from quasi.gap.wrench.worth import Cause

LEVEL = 1e-3


def cause(name, p, foreign=False, since="always"):
    effect = Effect(name, "W", "", "", "", foreign=foreign)
    test = mixed.Test(mixed.Offer(name, since, (0,)), np.zeros(1), np.eye(1), 1.0, 50.0, p)
    return Cause(effect, since, {}, {}, test, [])


def share(p, others=(), foreign=False, since="always"):
    own = cause("own", p, foreign, since)
    levels = dict.fromkeys(("always", "changed"), LEVEL)
    return needed(own, SimpleNamespace(causes=[own, *others], stand_ins=[], level=levels))


def test_a_cause_needs_to_come_again_more_often_beside_a_stronger_one():
    assert share(1e-4) == ALONE
    assert share(1e-4, [cause("fainter", 9e-4)]) == SURE
    assert share(1e-4, [cause("stronger", 1e-9)]) == BESIDE
    assert share(1e-4, [cause("elsewhere", 1e-9, since="changed")]) == ALONE


def test_what_is_far_beyond_chance_needs_half_as_many_beside_a_stronger_one():
    stronger = [cause("stronger", 1e-12)]
    assert share(0.009 * LEVEL, stronger) == pytest.approx(0.5 * share(0.011 * LEVEL, stronger))
    for others, least in (([], ALONE), ([cause("fainter", 9e-4)], SURE)):
        assert share(1e-9, others) == least  # a few seconds of flight, or what resembles it, may make all of it


@pytest.mark.parametrize("since, least", [("always", SURE), ("changed", BESIDE)])
def test_what_no_sound_vehicle_has_is_no_remainder_of_what_a_model_lacks_of_its_own(since, least):
    lacking = cause("drag", 1e-20, since=since)
    assert share(1e-4, [lacking], foreign=True, since=since) == least
    assert share(1e-4, [cause("wind", 1e-20, True, since)], foreign=True, since=since) == BESIDE
