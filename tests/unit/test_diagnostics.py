"""Verdicts on flights that were made to deserve them, and every figure against plain arithmetic."""

import copy
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from judged import TERMS, columns, made

from quasi.errors import DataError
from quasi.identification.partition import ROLES, TRAINING
from quasi.model.model import Model
from quasi.scoring.review import review_model
from quasi.scoring.score import _score_rows, compare_with_measurements, score_comparisons
from quasi.scoring.summary import format_summary
from quasi.scoring.verdict import (
    derive_verdict,
    describe_flights_without_voltage,
    describe_unusable_flights,
    group_axes_by_kind,
    lower_verdict,
    summarise_axes,
)


@pytest.fixture(scope="module")
def good():
    return made()


def plain(model, flights, codes, axis, role):
    """Measured and predicted rows of a role, by hand."""
    theta = [t["coefficient"] for t in model.document["axes"][axis]["terms"]]
    measured, predicted = [], []
    for key, f in flights.items():
        here = codes[key] == ROLES[role]
        measured.append(f[axis].to_numpy()[here])
        predicted.append((columns(axis, f) @ theta)[here])
    return np.concatenate(measured), np.concatenate(predicted)


def codes_of(judged):
    found = judged["Fz"]
    return {key: found.role[found.flight == k] for k, key in enumerate(found.keys)}


def test_a_model_that_holds_is_good_on_all(good):
    _, _, found = good
    diagnosis = found.diagnosis
    assert diagnosis["verdict"] == "good"
    assert diagnosis["summary"] == ["Fz, My: good on all"]
    assert diagnosis["in short"] == "Fz, My: good"
    assert all(not any(f["warnings"].values()) for f in diagnosis["axes"].values())
    assert diagnosis["axes"]["Fz"]["interval"]["coverage"]["validation"] == pytest.approx(0.95, abs=0.02)


def test_a_model_that_contradicts_its_configuration_is_unusable_whatever_its_scores(good):
    model, flights, found = good
    document = copy.deepcopy(model.document) | {"contradictions": ["rotor 1 pushes as if it were elsewhere"]}
    wrong = review_model(Model(document, "made"), flights, codes_of(found.comparisons), ROLES).diagnosis
    assert found.diagnosis["verdict"] == "good" and wrong["verdict"] == "unusable"
    assert wrong["summary"][0] == wrong["in short"].split("; ")[0] == "rotor 1 pushes as if it were elsewhere"


def test_a_held_out_flight_that_is_unusable_judges_no_model(good):
    diagnosis = good[2].diagnosis
    made = {"a": {"unusable because": []}, "c": {"unusable because": ["gyro and attitude contradict each other"]}}
    [sentence] = describe_unusable_flights(made, ["a", "c"])
    assert "flight c " in sentence and "gyro and attitude" in sentence
    lowered = lower_verdict(diagnosis, [sentence])
    assert lowered["verdict"] == "usable with care" and lowered["summary"] == [sentence, *diagnosis["summary"]]
    assert lower_verdict({**diagnosis, "verdict": "unusable"}, [sentence])["verdict"] == "unusable"
    assert lower_verdict(diagnosis, []) == diagnosis


def test_a_held_out_flight_without_the_voltage_that_its_map_needs_is_named():
    commanded = ["w1", "command1_raw", "battery_voltage"]
    flights = {"a": commanded, "b": commanded[:2], "c": ["w1"], "d": commanded[:2]}
    drive = {"voltage exponent": {"value": 0.8}}
    [sentence] = describe_flights_without_voltage(flights, drive, ["a", "b", "c"])
    assert "held-out flight b logs no battery voltage" in sentence
    for known in (None, {"voltage exponent": None}):
        assert describe_flights_without_voltage(flights, known, ["a", "b", "c"]) == []


@pytest.mark.parametrize("axis", list(TERMS))
def test_rmse_differences_and_quartiles_equal_plain_arithmetic(good, axis):
    model, flights, found = good
    facts, codes = found.diagnosis["axes"][axis], codes_of(found.comparisons)
    rms = {}
    everything = np.concatenate([plain(model, flights, codes, axis, r)[0] for r in ROLES])
    low, high = np.quantile(everything, [0.25, 0.75])
    for role in ROLES:
        z, y = plain(model, flights, codes, axis, role)
        rms[role] = np.sqrt(np.mean((z - y) ** 2))
        assert facts["rmse"][role] == pytest.approx(rms[role], rel=1e-9)
        assert facts["relative rmse"][role] == pytest.approx(rms[role] / np.sqrt(np.mean(z**2)), rel=1e-9)
        for band, inside in zip(facts["quartiles"], (z <= low, (z > low) & (z <= high), z > high)):
            assert band["rmse"][role] == pytest.approx(np.sqrt(np.mean((z - y)[inside] ** 2)), rel=1e-9)
            assert band["share"][role] == pytest.approx(inside.mean())
    difference = facts["relative difference"]
    assert difference["test and training"] == pytest.approx(100 - 100 * rms["training"] / rms["test"])
    assert difference["test and validation"] == pytest.approx(100 - 100 * rms["validation"] / rms["test"])
    ratios = facts["quartiles"][0]
    assert ratios["X/T"] == pytest.approx(ratios["rmse"]["training"] / ratios["rmse"]["test"])
    edges, density = np.array(facts["histogram"]["edges"]), facts["histogram"]["density"]
    for values in density.values():
        assert np.sum(np.array(values) * np.diff(edges)) == pytest.approx(1.0)


def test_scores_are_those_of_the_judged_rows(good):
    model, flights, found = good
    codes = codes_of(found.comparisons)
    pd.testing.assert_frame_equal(
        score_comparisons(compare_with_measurements(model, flights, codes), model, ROLES), found.scores
    )
    z, y = plain(model, flights, codes, "My", "validation")
    row = found.scores.query("flight == 'all' and role == 'validation' and axis == 'My'").iloc[0]
    assert row["r2"] == pytest.approx(1 - np.mean((z - y) ** 2) / np.var(z))
    assert row["n"] == len(z) == len(flights["c"])


def test_noise_of_another_kind_is_told_with_its_share_and_remedy():
    r = np.random.default_rng(0)
    _, _, found = made(lambda f: f.assign(My=f["My"] + 1.2e-3 * r.standard_normal(len(f))))
    facts = found.diagnosis["axes"]["My"]
    assert found.diagnosis["verdict"] == "usable with care"
    assert facts["overfits"]
    assert facts["statement"].startswith("My: overfits: validation RMSE ")
    assert "% above training" in facts["statement"]
    assert any("remove regressors" in r for r in facts["what to do"])
    assert found.diagnosis["summary"][0] == "Fz: good on all"
    assert facts["warnings"] == {"test": False, "validation": True}
    assert any("intervals contain" in b for b in facts["because"])


def test_an_offset_is_told_as_another_trim_not_as_overfitting():
    _, _, found = made(lambda f: f.assign(My=f["My"] + 2e-3))
    facts = found.diagnosis["axes"]["My"]
    assert not facts["overfits"]
    assert found.diagnosis["in short"].endswith("My: a constant offset, another trim on the validation flights")
    assert any("is a constant offset of 0.0019" in b for b in facts["because"])
    assert any("centre of gravity" in r for r in facts["what to do"])


def test_rows_beyond_the_training_data_are_the_reason_given():
    def faster(f):
        f["u"] = 3.0 * f["u"]
        f["Fz"] = f["Fz"] - 0.01 * (8 / 9) * f["u"] ** 2  # the same law, as flights.flight has it
        f["Fz"] = f["Fz"] - 0.01 * np.maximum(np.abs(f["u"]) - 10, 0) ** 2  # and another where nobody trained
        return f

    _, _, found = made(faster)
    facts = found.diagnosis["axes"]["Fz"]
    assert facts["outside"]["share"] > 0.05
    assert next(iter(facts["outside"]["variables"])) == "u"
    assert any("training data (u in" in b for b in facts["because"])
    assert facts["outside"]["rmse inside"] < 1.1 * facts["rmse"]["training"] < facts["rmse"]["validation"]
    assert any("range of u" in r for r in facts["what to do"])
    assert facts["kind"] in ("beyond", "unusable")
    line = found.coverage.set_index("variable").loc["u"]
    assert line["below"] + line["above"] == pytest.approx(facts["outside"]["variables"]["u"])
    assert line["max"] > line["training_max"]


def test_a_livelier_flight_with_errors_in_proportion_is_no_fault():
    facts = {
        "rmse": {"training": 1.0, "validation": 1.5},
        "relative rmse": {"training": 0.1, "validation": 0.1},
        "r2": {"training": 0.9, "validation": 0.9},
        "bias": {"training": 0.0, "validation": 0.0},
        "relative difference": {
            "validation above training": 50.0,
            "validation above training, relative": 0.0,
            "test above training": None,
        },
        "warnings": {"test": False, "validation": False},
        "quartiles": [],
        "interval": {"confidence": 0.95, "coverage": {"training": 0.95, "validation": 0.94}},
        "outside": {"share": 0.0, "variables": {}, "rmse inside": 1.5},
        "unit": "N",
    }
    said = derive_verdict("Fx", facts)
    assert said["verdict"] == "good"
    assert "in proportion to a more dynamic flight" in said["statement"]
    worse = derive_verdict("Fx", {**facts, "r2": {"training": 0.3, "validation": -0.4}})
    assert worse["verdict"] == worse["kind"] == "unusable"
    short = {**facts, "interval": {"confidence": 0.95, "coverage": {"training": 0.96, "test": 0.905}}}
    assert derive_verdict("Fx", short)["overfits"]  # the manual's second sign: five points between training and test
    assert "explains only 30 % of the variance" in worse["statement"]
    assert summarise_axes({"Fx": {**said, "rmse": facts["rmse"]}, "My": {**worse, "rmse": facts["rmse"]}}) == [
        "Fx: good on training and validation",
        "; ".join([worse["statement"], *worse["what to do"]]),
    ]


@pytest.mark.parametrize(("axis", "size", "known"), [("Fx", 5e-9, False), ("Fx", 1e-4, True), ("Mx", 1e-8, True)])
def test_an_axis_that_nothing_measured_has_no_r2_and_no_good_verdict(axis, size, known):
    """A log without horizontal motion leaves Fx at rounding, and its R2 was -984610."""
    measured = size * np.random.default_rng(0).standard_normal(500)
    rows = np.column_stack([measured, np.zeros(500), np.full(500, -1.0), np.full(500, 1.0)])
    model = SimpleNamespace(document={"axes": {axis: {"confidence level": 0.95}}})
    r2 = _score_rows("a", "training", axis, rows, model)["r2"]
    assert np.isfinite(r2) == known
    if not known:
        found = derive_verdict(axis, {"rmse": {"training": size}, "r2": {"training": None}})
        assert found["verdict"] == "usable with care" and "no source measured it" in found["statement"]


def test_lopsided_errors_are_told_as_in_the_manuals_example():
    def bent(f):
        return f.assign(My=np.where(f["My"] < -0.02, 1.5 * f["My"], f["My"]))

    _, _, found = made(bent)
    because = found.diagnosis["axes"]["My"]["because"]
    assert any("times as large in the lower quartile as in the upper" in b for b in because)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "leak"),
        ({"partition by": "blocks", "block length": 0.2}, None),
        ({"random partition": False}, "no test rows were drawn"),
    ],
    ids=["samples", "blocks", "none"],
)
def test_what_the_test_rows_are_worth_is_said(options, words):
    note = made(options=options, rows=600)[2].diagnosis["partition"]["note"]
    assert note is None if words is None else words in note


def test_without_validation_flights_the_test_rows_judge():
    _, _, found = made(validation=(), options={"partition by": "blocks", "block length": 0.2})
    assert found.coverage.empty
    assert found.diagnosis["summary"] == ["Fz, My: good on training and test"]
    assert found.diagnosis["axes"]["My"]["outside"]["share"] is None
    _, _, alone = made(validation=(), options={"random partition": False}, rows=600)
    assert "no test or validation rows" in alone.diagnosis["axes"]["Fz"]["because"]


@pytest.mark.parametrize(
    ("rmse", "r2", "base", "expected"),
    [
        (0.0764, -0.27, 0.0764, ("usable with care", "alike", "no better than its base on these flights")),
        (0.0764, -0.27, 0.03, ("unusable", "worse", "not usable beyond the training flights")),
        (0.0764, 0.8, 0.05, ("usable with care", "worse", "worse than its base")),
        (0.0764, 0.8, 0.3, ("good", "better", "good")),
        (0.0764, -0.27, 0.3, ("usable with care", "better", "better than its base, and still weak")),
    ],
)
def test_an_extended_model_is_judged_beside_its_base(rmse, r2, base, expected):
    facts = {
        "rmse": {"training": 0.06, "validation": rmse},
        "relative rmse": {"training": 0.3, "validation": 1.1},
        "r2": {"training": 0.9, "validation": r2},
        "bias": {"training": 0.0, "validation": 0.0},
        "relative difference": {
            "validation above training": 27.0,
            "validation above training, relative": 260.0,
            "test above training": None,
        },
        "warnings": {"test": False, "validation": False},
        "quartiles": [],
        "interval": {"confidence": 0.95, "coverage": {"training": 0.95, "validation": 0.75}},
        "outside": {"share": 0.0, "variables": {}, "rmse inside": rmse},
        "unit": "N",
        "base": {"id": "m", "rmse": base, "r2": 0.0},
    }
    said = derive_verdict("Fx", facts, True)
    assert (said["verdict"], said["against its base"], group_axes_by_kind({"Fx": said})[4:]) == expected
    assert said["because"][0].startswith("validation RMSE") and "its base m" in said["because"][0]
    assert not said["overfits"] and "overfits" not in said["statement"]
    alone = derive_verdict("Fx", {**facts, "base": None}, True)
    assert alone["against its base"] is None and alone["verdict"] != "good"


def test_the_base_is_judged_on_the_same_rows():
    model, flights, whole = made(rows=600)
    weaker = copy.deepcopy(model.document)
    for term in weaker["axes"]["My"]["terms"]:
        term["coefficient"] *= 0.5
    found = review_model(model, flights, codes_of(whole.comparisons), ROLES, base=Model({**weaker, "id": "weaker"}))
    facts = found.diagnosis["axes"]
    assert facts["Fz"]["base"]["rmse"] == pytest.approx(facts["Fz"]["rmse"]["validation"])
    said = "compared with its base weaker on the same held-out flights: better in My; alike in Fz"
    assert found.diagnosis["summary"][0] == said and found.diagnosis["in short"].startswith(said)
    assert whole.diagnosis["axes"]["My"]["base"] is None and "base" not in whole.diagnosis["in short"]


def test_rows_set_aside_neither_train_nor_test():
    _, flights, whole = made(rows=600)
    codes = codes_of(whole.comparisons)
    aside = {"My": {"a": codes["a"] == TRAINING}}
    model, _, found = made(rows=600, aside=aside)
    counts = found.scores[found.scores["role"] == "training"].set_index(["axis", "flight"])["n"]
    assert ("My", "a") not in counts.index
    assert counts["Fz", "a"] == np.count_nonzero(codes["a"] == TRAINING)
    assert counts["My", "all"] == counts["My", "b"]
    with pytest.raises(DataError, match="flight c has no column 'My'"):
        compare_with_measurements(model, {**flights, "c": flights["c"].drop(columns="My")}, codes)


def test_rows_with_missing_values_are_left_out_of_the_scores():
    _, _, whole = made(rows=600)
    model, flights, _ = made(rows=600)
    flights["c"].loc[10:20, "Fz"] = np.nan
    judged = compare_with_measurements(model, flights, codes_of(whole.comparisons))
    table = score_comparisons(judged, model, ROLES)
    row = table.query("flight == 'c' and axis == 'Fz'").iloc[0]
    assert row["n"] == 589
    assert np.isfinite(row["rmse"])


@pytest.mark.parametrize("validation", [(), ("c",)], ids=["none held out", "one held out"])
def test_summary_advises_on_test_rows_only_where_they_have_to_judge(validation):
    model, _, found = made(rows=600, validation=validation)
    text = format_summary(model, found.scores, found.diagnosis)
    assert ("single samples between training samples" in text) == (not validation)


def test_a_model_without_intervals_is_scored_all_the_same(good):
    """A published one knows nothing of its errors."""
    model, _, found = good
    bare = {a: j._replace(lower=np.full_like(j.lower, np.nan), upper=np.full_like(j.upper, np.nan))
            for a, j in found.comparisons.items()}  # fmt: skip
    told = score_comparisons(bare, model, ROLES)
    for column in ("n", "rmse", "r2", "bias"):
        pd.testing.assert_series_equal(told[column], found.scores[column])
    assert told["coverage"].isna().all() and told["interval_width"].isna().all()


def test_without_held_out_flights_none_is_said_to_stand_for_test_rows():
    with_them, without = (made(validation=v, options={"random partition": False}, rows=600)[2].diagnosis["partition"]
                          for v in (("c",), ()))  # fmt: skip
    assert with_them["note"].endswith("the validation flights replace them")
    assert without["note"] == "no test rows were drawn"
