"""Hide and seek with fixed causes: raw logs in, names out; and the judge that compares them with the truth."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import hidden
from clarity import NOTHING, Asked, clarity, of_the_error
from conftest import SECONDS
from fixed_causes import TESTED, list_faults, seek_case
from hidden import ALL, STRANGE, deviation, drawn
from hide_and_seek import judge
from hide_and_seek_page import group_of, page, wilson
from probability import Stated, bin_table, brier, fit, left_out, stated

from quasi.gap.catalogue import catalogue
from quasi.gap.probability import decades, probability_of
from quasi.gap.statistics.candidates import Candidate, Columns
from quasi_synthesis.effects import check
from quasi_synthesis.vehicle import BASE_MASS


@pytest.mark.workflow
@pytest.mark.parametrize("name", TESTED)
def test_what_is_hidden_is_named_and_nothing_else(name, healthy):
    """Two levels at once, and nothing; `benchmarks/fixed_causes.py` has every level, both designs, and no catalogue."""
    assert not list_faults(seek_case(name, healthy.parent, SECONDS))


def test_a_case_fails_by_a_wrong_name_an_outcome_or_a_poor_estimate():
    right = {"kind": "single", "wrong": [], "outcome": "hit", "summary": "", "verdict": "explained"}
    right["errors"] = {"mass": {"relative": 0.1}}
    assert not list_faults(right)
    poor = {"mass": {"relative": float("nan")}}
    changes = ("wrong", ["wind"]), ("outcome", "missed"), ("verdict", "agrees"), ("errors", poor)
    for key, value in (*changes, ("kind", "clean"), ("kind", "unlisted")):
        assert len(list_faults({**right, key: value})) == 1, key


def said(truth, names=(), ties=(), design="reference", kind="single", everywhere=False):
    about = {"since": "always", "in training flights": everywhere}
    if design == "reference":
        about = {"since": "always" if everywhere else "changed"}
    evidence = {"evidence": {"p": 1e-20}}
    effects = [{"id": n, "level": "forces", **evidence, "parameters": p, **about} for n, p in names]
    tied = [{"ids": list(t), **about} for t in ties]
    verdict = "explained" if effects else "partly explained" if tied else "agrees"
    return {"kind": kind, "design": design, "effects": truth, "unexplained": [], "effects said": effects, "ties": tied,
            "verdict": verdict, "sizes": {}}  # fmt: skip


def heavier(value, std):
    return [("mass", {"mass": {"value": BASE_MASS + value, "std": std}})]


def test_a_swapped_truth_turns_a_hit_into_a_wrong_name():
    right = judge(said({"mass": {"mass": BASE_MASS + 0.04}}, heavier(0.043, 0.002)))
    assert right["outcome"] == "hit" and right["first"]
    assert right["errors"]["mass"]["relative"] == pytest.approx(0.003 / 0.04)
    assert right["errors"]["mass"]["in std"] == pytest.approx(1.5)
    swapped = judge(said({"tether": {"k": 0.2}}, heavier(0.043, 0.002)))
    assert (swapped["outcome"], swapped["wrong"]) == ("wrong", ["mass"])


def test_the_judge_knows_ties_misses_and_what_the_model_lacks():
    truth = {"wind": {"north": 1.0, "east": 0.0}}
    assert judge(said(truth, ties=[("wind", "tether")]))["outcome"] == "hit"
    told_apart = {**said(truth, ties=[("wind", "tether")]), "sizes": {"wind": {"separability": 20.0}}}
    assert judge(told_apart)["outcome"] == "missed"
    assert judge(said(truth, ties=[("mass", "tether")]))["outcome"] == "tied elsewhere"
    assert judge(said(truth))["outcome"] == "missed"
    assert judge(said(truth, [("wind", {}), ("mass", {})]))["outcome"] == "extra"
    for design in ("reference", "all"):
        lacks = said({}, [("rotor_drag", {})], design=design, kind="clean", everywhere=True)
        assert judge(lacks)["outcome"] == "model's own"
        assert judge(said({}, [("rotor_drag", {})], design=design, kind="clean"))["outcome"] == "false"
        assert judge(said({}, [("mass", {})], design=design, kind="clean", everywhere=True))["outcome"] == "false"
    assert judge(said({}, kind="clean"))["outcome"] == "agrees"
    assert judge({**said({}, kind="clean"), "verdict": "unexplained"})["outcome"] != "agrees"
    strange = {"unlisted_fan": {"size": 1.0}}
    assert judge(said(strange, kind="unlisted"))["outcome"] == "missed"
    assert judge({**said(strange, kind="unlisted"), "unexplained": [{"channel": "Fz"}]})["outcome"] == "unexplained"
    assert judge(said(strange, [("mass", {})], kind="unlisted"))["outcome"] == "false"


def test_draws_come_from_their_seed_alone_and_spread_over_everything():
    draws = [drawn(seed) for seed in range(400)]
    assert draws[17] == drawn(17)
    hidden = {name for d in draws for name in d["effects"]}
    causes = {n for n, e in catalogue().items() if not e.finding}
    causes -= {"attitude_error"}  # needs flights without capture
    causes -= {"rotor_order"}  # exact, not drawn by size: tests/unit/test_rotor_order.py
    assert hidden == causes | set(STRANGE) == set(ALL)
    factors = np.array([f for d in draws for f in d["factors"].values()])
    assert 30**-0.5 < factors.min() < 0.25
    assert 4.0 < factors.max() < 30**0.5
    for d in draws:
        check(d["effects"], "draw")  # all can be planted
        for name, values in d["effects"].items():
            assert any(deviation(name, values).values())


def test_shares_have_wilsons_interval_and_the_page_every_draw():
    assert wilson(9, 10) == (pytest.approx(0.596, abs=1e-3), pytest.approx(0.982, abs=1e-3))
    size = {"detectability": 20.0, "separability": 15.0, "nearest": "tether"}
    hit = said({"mass": {"mass": BASE_MASS + 0.04}}, heavier(0.04, 0.002))
    miss = said({"wind": {"north": 1.0, "east": 0.0}}, [("tether", {})])
    results = []
    for seed, result in enumerate((hit, miss)):
        whole = {**result, "settings": {"seed": seed}, "sizes": dict.fromkeys(result["effects"], size),
                 "factors": dict.fromkeys(result["effects"], 1.0), "seconds": {"whole": 20.0}}  # fmt: skip
        results.append({**whole, **judge(whole)})
    assert {group_of(r) for r in results} == {"single, above 10, separable"}
    text = page(results)
    assert "| single, above 10, separable | 1 | 2 | 0.50 |" in text
    assert "| wind | 1 | 0 | tether 1 |" in text and "At a false alarm rate" not in text
    assert "Of 2 names stated with a probability of 0.9 or more, 1 are right." in text
    others = [{**r, "settings": {**r["settings"], "rate": 0.05}} for r in (results[0], results[0])]
    others[1]["settings"]["seed"] = 1  # what was missed is found
    text = page(results, others)
    assert "## At a false alarm rate of 0.05" in text
    assert "| single, above 10, separable | 2 | 1 | 2 | 1 | 0 |" in text


def entries(number, intercept, slope, seed=2):
    """Entries that are right with the probability of a logistic function, five to a data set."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.0, 10.0, number)
    right = rng.random(number) < 1.0 / (1.0 + np.exp(-intercept - slope * x))
    return [Stated("effects", float(a), bool(b), str(k // 5)) for k, (a, b) in enumerate(zip(x, right))]


def test_the_calibration_finds_a_known_function_and_is_finite_where_outcomes_are_separated():
    assert fit(entries(4000, -3.0, 0.8)) == (pytest.approx(-3.0, abs=0.3), pytest.approx(0.8, abs=0.06))
    apart = [Stated("effects", x, x > 5.0, str(x)) for x in (1.0, 2.0, 8.0, 9.0)]
    intercept, slope = fit(apart)
    assert 0.1 < slope < 3.0 and -15.0 < intercept < 0.0
    opposite = [Stated("effects", x, x < 5.0, str(x)) for x in (1.0, 2.0, 8.0, 9.0)]
    assert fit(opposite)[1] == 0.0  # more evidence is never less probable


def test_probabilities_of_data_sets_left_out_are_right_as_often_as_they_say():
    own = entries(600, -3.0, 0.8)
    chance, right = left_out(own), np.array([e.right for e in own])
    sure = chance >= 0.9
    assert abs(right[sure].mean() - chance[sure].mean()) < 0.05
    assert brier(chance, right) < brier(np.full(len(own), right.mean()), right)
    assert brier([1.0, 0.0, 0.5], [True, False, True]) == pytest.approx(0.25 / 3.0)
    assert bin_table([0.05, 0.95, 1.0], [False, True, False])[2:] == [
        "| 0 to 0.1 | 1 | 0.050 | 0 | 0.000 |", "| 0.9 to 1 | 2 | 0.975 | 1 | 0.500 |"
    ]  # fmt: skip


def test_what_healthy_flights_show_as_well_counts_for_no_calibration():
    truth = {"wind": {"north": 1.0, "east": 0.0}}
    case = {**said(truth, [("wind", {}), ("tether", {})]), "settings": {"seed": 1}}
    assert [e.right for e in stated(case)] == [True, False]
    assert stated({**said({}, [("rotor_drag", {})], design="all", everywhere=True), "settings": {"seed": 1}}) == []
    own = {**said({}, [("rotor_drag", {}), ("mass", {})], design="own", everywhere=True), "settings": {"seed": 1}}
    assert [e.right for e in stated(own)] == [False]


def test_a_model_holds_the_drive_of_the_flights_that_it_was_made_of():
    """What is hidden in their motors' lag leaves no gap, and counts as not shown."""
    asked = Asked(None, None, np.array([True]), {}, (), True)
    assert clarity("motor_lag", {"time_constant": 0.045}, asked) == NOTHING
    with pytest.raises(StopIteration):  # of other flights, the drive is asked
        clarity("motor_lag", {"time_constant": 0.045}, asked._replace(own=False))


def test_what_a_model_took_up_of_the_flights_that_it_was_made_of_is_no_error_of_theirs():
    rng = np.random.default_rng(3)
    term, beyond, noise = rng.standard_normal((3, 4000, 6))
    cause = 0.8 * term + 0.6 * beyond  # 0.36 of its square stands out
    flight = SimpleNamespace(columns=np.stack([0.5 * cause + noise, term, cause], axis=2))
    reference = SimpleNamespace(columns=np.full((10, 6, 3), 7.0))
    columns = Columns([1], [], np.zeros(0), {"drag": [2]})
    study = SimpleNamespace(thinned=[reference, flight], columns=columns)
    asked = Asked(study, None, np.array([False, True]), {}, (), False)
    offer, size = Candidate("drag", "always", (0,)), np.array([0.5])
    assert of_the_error(study, offer, size, asked) == pytest.approx(0.25 / 1.25, rel=0.1)
    assert of_the_error(study, offer, size, asked._replace(own=True)) == pytest.approx(0.09 / 1.25, rel=0.1)


def test_draws_of_worlds_have_references_of_two_sessions_and_a_table_of_their_conditions(monkeypatch):
    drawn_world = hidden.world(3)
    assert hidden.world(0).config == {} and hidden.session_of(501, hidden.world(0)) == ""
    monkeypatch.setattr(hidden, "healthy", lambda folder, seed, of: (seed, hidden.session_of(seed, of)))
    for seed in range(6):
        of_each = [session for _, session in hidden.references(Path("none"), seed, of=drawn_world)]
        assert sorted(of_each) == ["reference-0"] * 2 + ["reference-1"] * 2
    assert {s for _, s in hidden.trained(Path("none"), 1, of=drawn_world)} == {"reference-0", "reference-1"}
    assert hidden.session_of(30_003, drawn_world) not in ("", hidden.session_of(30_015, drawn_world))
    results = []
    for number, names in ((0, ()), (3, [("tether", {})])):
        result = {**said({}, names, kind="clean"), "world": number}
        whole = {**result, "settings": {"seed": number}, "factors": {}, "seconds": {"whole": 20.0}}
        results.append({**whole, **judge(whole)})
    text = page(results)
    config = drawn_world.config
    assert f"| 3 | {config['log rate']} | {config['accelerometer noise']:.2f} |" in text
    assert "A wrong name in 1 of 2 data sets" in text
    # the one name is wrong: its score is the square of its probability
    assert "Of 1 names stated with a probability of 0.9 or more, 0 are right" in text
    assert f"of 1 names: {probability_of('effects', decades(1e-20)) ** 2:.3f}" in text
