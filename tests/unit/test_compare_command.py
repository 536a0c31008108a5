"""`quasi compare`: what was changed is marked, and nothing else, on made flights and models."""

import json

import numpy as np
import pytest
from flights import AIRFRAME, PITCH, ROLL, THRUST, YAW, flight
from made_model import simple_model

from quasi.command import main
from quasi.errors import DataError
from quasi.gap.comparing.differences import Estimate, differences, reject_by_holm
from quasi.gap.comparing.flight_comparison import compare_flights, flights_plain, spread_between
from quasi.gap.comparing.flight_quantities import QUANTITY_UNITS, patterns_of, quantities_of
from quasi.gap.comparing.model_comparison import compare_models
from quasi.tables import write_json, write_table


def flown(seed, **changes):
    """A made flight of 48 s; changes multiply a column (thrust=0.95: Fz) or add to it (roll: N m)."""
    table = flight(seed, rows=12000, rate=250.0)
    table["Fz"] *= changes.get("thrust", 1.0)
    table["Mx"] += changes.get("roll", 0.0)
    return table


@pytest.fixture(scope="module")
def clean():
    return {f"clean-{seed}": flown(seed) for seed in range(1, 5)}


def test_quantities_are_those_that_the_flight_was_made_with(clean):
    found = quantities_of(clean["clean-1"], "flight")
    assert set(found) <= set(QUANTITY_UNITS)
    # the flight has a term in u^2 that the quantities lack
    assert found["thrust coefficient"].value == pytest.approx(THRUST, rel=0.03)
    for name, made in (("roll", ROLL), ("pitch", PITCH), ("yaw", YAW)):
        assert abs(found[f"{name} effectiveness"].value) == pytest.approx(made, rel=0.02)
        assert found[f"{name} damping"].value == pytest.approx(5e-4, rel=0.05)
    # Fx = -(2e-5 sum w + 0.01) u
    speeds = sum(clean["clean-1"][f"w{i}"].mean() for i in range(1, 5))
    assert found["drag x"].value == pytest.approx(2e-5 * speeds + 0.01, rel=0.02)
    assert sum(found[f"share of rotor {i}"].value for i in range(1, 5)) == pytest.approx(1.0)


def test_moments_are_matched_with_the_pattern_of_the_geometry(clean):
    # U_p of the test's airframe: w4 + w3 - w2 - w1, as a sum of squares with signs (-, -, +, +)
    assert patterns_of(clean["clean-1"]) == {"Mx": 0, "My": 1, "Mz": 2}


@pytest.mark.parametrize(
    ("change", "named"), [({"thrust": 0.95}, {"thrust coefficient"}), ({"roll": 6e-3}, {"roll moment, constant"})]
)
def test_what_was_changed_differs_and_nothing_else(change, named, clean):
    rows = compare_flights(("a", clean["clean-1"]), ("b", flown(9, **change)))
    assert {row.name for row in rows if row.differs} == named
    row = next(r for r in rows if r.name in named)
    expected = -0.05 * THRUST if "thrust" in change else change["roll"]
    assert abs(row.change - expected) < 4 * row.std


def test_flights_of_one_vehicle_are_rarely_said_to_differ():
    """24 pairs of other manoeuvres at 1 % family-wise: 3 alarms have a probability of 0.2 %."""
    flights = [flown(seed) for seed in range(30, 37)]
    pairs = [(a, b) for k, a in enumerate(flights) for b in flights[k + 1 :]]
    alarms = [[r.name for r in compare_flights(("a", a), ("b", b)) if r.differs] for a, b in pairs]
    assert len(pairs) == 21
    assert sum(map(bool, alarms)) <= 2, alarms


def test_repeats_widen_the_spread_by_their_scatter(clean):
    offset = {k: flown(40 + k, roll=size) for k, size in enumerate((4e-3, -3e-3, 5e-3, -5e-3))}
    other = flown(9, roll=6e-3)
    plain = compare_flights(("a", clean["clean-1"]), ("b", other))
    wide = compare_flights(("a", clean["clean-1"]), ("b", other), {str(k): v for k, v in offset.items()})
    assert any(r.differs for r in plain) and not any(r.differs for r in wide)
    extra = spread_between([quantities_of(t, "x", patterns_of(clean["clean-1"])) for t in offset.values()])
    assert extra["roll moment, constant"].value == pytest.approx(np.std([4e-3, -3e-3, 5e-3, -5e-3], ddof=1), rel=0.3)
    with pytest.raises(DataError, match="2 repeated flights"):
        compare_flights(("a", clean["clean-1"]), ("b", other), {str(k): offset[k] for k in (0, 1)})


def test_a_short_flight_and_one_without_forces_are_refused(clean):
    with pytest.raises(DataError, match="at least 4"):
        quantities_of(clean["clean-1"].head(2500), "short")
    with pytest.raises(DataError, match="'Fz'"):
        quantities_of(clean["clean-1"].drop(columns="Fz"), "bare")


def test_holm_s_decision_is_the_textbook_s():
    # m = 4 at 5 %: bounds 0.0125, 0.0167, 0.025, 0.05
    assert reject_by_holm([0.01, 0.04, 0.03, 0.005], 0.05) == [True, False, False, True]


def test_welch_s_t_is_that_of_scipy():
    from scipy import stats

    rng = np.random.default_rng(1)
    a, b = rng.normal(0, 1, 9), rng.normal(0.8, 3, 14)
    sides = [{"m": Estimate(x.mean(), x.std(ddof=1) / np.sqrt(len(x)), len(x) - 1)} for x in (a, b)]
    (row,) = differences(*sides, {})
    assert row.p_value == pytest.approx(stats.ttest_ind(a, b, equal_var=False).pvalue, rel=1e-9)


# ---- models ----


@pytest.fixture(scope="module")
def models():
    good = simple_model(AIRFRAME, THRUST, YAW)
    wrong = simple_model(AIRFRAME, 1.25 * THRUST, YAW)
    return good, wrong


def test_the_model_with_the_wrong_thrust_has_larger_errors_there_alone(models, clean):
    rows = {r.name: r for r in compare_models(*models, {"clean-1": clean["clean-1"]})}
    assert rows["Fz"].differs and rows["Fz"].change > 0.0
    assert not rows["Fy"].differs and rows["Fy"].change == 0.0
    error = clean["clean-1"]["Fz"] - models[0].predict_columns(clean["clean-1"])["Fz"]
    assert rows["Fz"].a.value == pytest.approx(float(np.sqrt(np.mean(error**2))), rel=0.02)


def test_a_model_equals_itself(models, clean):
    assert not any(r.differs for r in compare_models(models[0], models[0], {"clean-1": clean["clean-1"]}))


# ---- the command ----


@pytest.fixture(scope="module")
def project(models, clean, tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare")
    for key, table in (*clean.items(), ("weak", flown(9, thrust=0.95))):
        write_table(folder / f"results/filtered/Q/withGravity/{key}.parquet", table, {}, {"mass": 0.433})
    for name, model in zip(("good", "wrong"), models):
        document = {**model.document, "id": name, "flights": {"training": ["clean-1"], "validation": ["clean-2"]}}
        write_json(folder / f"models/{name}/standalone/model.json", document)
    return folder


def test_the_command_compares_flights_and_models(project, capsys):
    where = ["-d", str(project)]
    assert main(["compare", "clean-1", "weak", *where]) == 0
    assert "* thrust coefficient" in capsys.readouterr().out
    assert main(["compare", "clean-1", "weak", "--json", *where]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == "quasi.comparison/1" and found["kind"] == "flights"
    assert [d["quantity"] for d in found["differences"] if d["differs"]] == ["thrust coefficient"]
    assert main(["compare", "good", "wrong", "--json", *where]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["kind"] == "models" and found["flights"] == ["clean-2"]
    assert "Fz" in [d["quantity"] for d in found["errors"] if d["differs"]]
    assert main(["compare", "good", "wrong", "--flights", "clean-1", *where]) == 0
    assert "good was trained on clean-1" in capsys.readouterr().out


def test_a_flight_and_a_model_and_an_unknown_flight_are_refused(project, capsys):
    where = ["-d", str(project)]
    assert main(["compare", "clean-1", "good", *where]) == 1
    error = capsys.readouterr().err
    assert "'clean-1' is a flight" in error and "'good' is not" in error
    assert main(["compare", "good", "wrong", "--flights", "clean-9", *where]) == 1
    assert "clean-9" in capsys.readouterr().err
    assert main(["compare", "results/none.parquet", "clean-1", *where]) == 1
    assert "none.parquet" in capsys.readouterr().err


def test_the_plain_comparison_is_json(clean):
    rows = compare_flights(("a", clean["clean-1"]), ("b", clean["clean-2"]))
    json.dumps(flights_plain(rows, ("a", "b"), 0), allow_nan=False)
