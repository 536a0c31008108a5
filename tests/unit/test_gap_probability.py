"""Probability of names, ties and candidates: in [0, 1], rising with the evidence, right as often as it says."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from gap_documents import EFFECT, KNOWN, LOST, TIE

from quasi.gap.entries import tie_entry
from quasi.gap.probability import KINDS, MOST_DECADES, add_probabilities, decades, probability_of
from quasi.gap.report.shares import certainty_of, separability_of
from quasi.gap.selection import Tie
from quasi.gap.statistics.candidates import Candidate
from quasi.gap.statistics.candidates import Test as CauseTest


def stated(**parts):
    diagnosis = {"effects": [], "ties": [], "candidates": [], **parts}
    add_probabilities(diagnosis)
    return diagnosis


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "ties"])
def test_more_evidence_means_a_higher_probability(kind):
    chances = [probability_of(kind, decades(p)) for p in (1.0, 1e-2, 1e-4, 1e-8, 1e-12)]
    assert all(0.0 < a < b < 1.0 for a, b in pairwise(chances))
    assert probability_of(kind, decades(0.0)) == probability_of(kind, MOST_DECADES)


def test_the_evidence_of_a_tie_sorts_nothing():
    assert 0.0 < probability_of("ties", 0.0) == probability_of("ties", MOST_DECADES) < 1.0


def test_a_rejected_cause_is_less_probable_than_a_named_one_with_the_same_p_value():
    assert all(probability_of("candidates", x) < probability_of("effects", x) for x in np.linspace(0.0, 12.0, 25))


def test_every_entry_gets_a_probability_and_keeps_one_of_its_own():
    bare = {k: v for k, v in EFFECT.items() if k != "probability"}
    trim = {**bare, "level": "trim", "probability": 0.93, "evidence": {"trim": 0.93}}
    force = {**TIE, "constant force": {"p": 1e-7}}
    made = stated(effects=[dict(bare), trim], ties=[dict(TIE), force], candidates=[dict(LOST)])
    assert made["effects"][0]["probability"] == probability_of("effects", MOST_DECADES)
    assert made["effects"][1]["probability"] == 0.93
    assert made["ties"][0]["probability"] is None  # it holds no p-value
    assert made["ties"][1]["probability"] == probability_of("ties", 7.0)
    assert made["candidates"][0]["probability"] == probability_of("candidates", -np.log10(LOST["p"]))


def test_the_order_of_the_causes_changes_no_probability():
    effects = [{**EFFECT, "id": str(k), "probability": None, "evidence": {"p": 10.0**-k}} for k in range(2, 12)]
    forward, backward = (stated(effects=[dict(e) for e in order])["effects"] for order in (effects, effects[::-1]))
    assert [e["probability"] for e in forward] == [e["probability"] for e in reversed(backward)]


@pytest.mark.parametrize("chance, word", [
    (0.999, "very sure"), (0.95, "sure"), (0.9, "sure"), (0.8, "fairly sure"), (0.6, "suspected"), (0.2, "doubtful"),
])  # fmt: skip
def test_the_word_follows_from_the_probability_alone(chance, word):
    for further in ({}, {"judged": False}, {"confirmation": {"outcome": "confirmed"}}, {"level": "trim"}):
        assert certainty_of({**EFFECT, **further, "probability": chance}).split(",")[0].split(":")[0] == word


def test_a_tie_states_its_probability_where_it_has_one():
    assert "0.91" in separability_of({**TIE, "probability": 0.912})
    assert "probability" not in separability_of(TIE)
    # what noise would decide is a tie for another reason, which a sentence that it is none must not hide
    assert ["form" in separability_of({**TIE, "separability": size}) for size in (1.3, 11.7)] == [False, True]


def test_a_tie_of_forces_holds_what_its_probability_is_made_of():
    test = CauseTest(Candidate("mass", "changed", (0,)), np.array([0.02]), np.array([[1e-6]]), 1.0, 400.0, 1e-9)
    rival = test._replace(offer=Candidate("thrust_factor", "changed", (0,)))
    vehicle = SimpleNamespace(mass=0.4)
    entry = tie_entry("changed", Tie([test, rival], 1.3, 3.0), KNOWN, vehicle)
    assert stated(ties=[entry])["ties"][0]["probability"] == pytest.approx(probability_of("ties", 9.0))
