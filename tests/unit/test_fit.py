"""Identification of one axis: the truth is found, and what the data lack is said."""

import json
import re

import numpy as np
import pytest
import statsmodels.api as sm
from flights import AIRFRAME, HOVER, THRUST, flight

from quasi import tables
from quasi.errors import ConfigError, DataError, ExpressionError, QuasiError
from quasi.identification.candidates import read_specification
from quasi.identification.fit import fit_axis, options_of
from quasi.identification.partition import TRAINING, partition
from quasi.identification.steps import describe_steps

SHARED = {"hover speed": {"value": HOVER}}
FM = "config/polynomials/polyCands_DiffSys_quadraticU_symmetric_SIMPLE_FM.json"


@pytest.fixture(scope="module")
def flights():
    return {key: flight(seed) for seed, key in enumerate("abc")}


@pytest.fixture(scope="module")
def roles(flights):
    return partition(flights, ["c"])


def identify(axis, flights, roles, section, bias=True, **config):
    specification = read_specification({axis: section}, axis, "s.json", bias)
    return fit_axis(axis, flights, roles, AIRFRAME, SHARED, config, specification)


def test_the_terms_of_the_truth_are_found_in_the_standard_pool(flights, roles):
    specification = read_specification(tables.read_json(FM), "Fz", FM)
    found = fit_axis("Fz", flights, roles, AIRFRAME, SHARED, {"regressor cap": 2}, specification)
    terms = {t["name"]: t for t in found["terms"]}
    assert {"(|u|^(2.0))", "(d_w_tot)*(w^(1.0))"} <= set(terms)
    thrust = terms["(w2_1 + w2_2 + w2_3 + w2_4)"]
    assert thrust["coefficient"] == pytest.approx(-THRUST, abs=4 * thrust["std"])
    assert thrust["unit"] == "N s2/rad2"
    assert thrust["fixed"]
    assert found["R2"] > 0.99
    assert found["n"] == sum(np.count_nonzero(c == TRAINING) for c in roles.values())
    json.dumps(found, allow_nan=False)


def test_coefficients_equal_statsmodels(flights, roles):
    section = {"fixed": ["u", "w_tot*u"], "candidates": []}
    found = identify("Fx", flights, roles, section)
    rows = [flights[k].iloc[roles[k] == TRAINING] for k in "ab"]
    u = np.concatenate([f["u"] for f in rows])
    total = np.concatenate([f[["w1", "w2", "w3", "w4"]].sum(axis=1) for f in rows])
    z = np.concatenate([f["Fx"] for f in rows])
    a = np.column_stack([np.ones_like(u), u, u * total])
    reference = sm.OLS(z, a).fit()
    np.testing.assert_allclose([t["coefficient"] for t in found["terms"]], reference.params, rtol=1e-8)
    np.testing.assert_allclose([t["plain std"] for t in found["terms"]], reference.bse, rtol=1e-6)
    assert found["R2"] == pytest.approx(reference.rsquared, rel=1e-10)
    assert found["sigma2"] == pytest.approx(reference.mse_resid, rel=1e-10)


def test_without_a_bias_the_fit_is_uncentred(flights, roles):
    found = identify("Fz", flights, roles, {"fixed": ["w2_1 + w2_2 + w2_3 + w2_4"], "candidates": []}, bias=False)
    rows = [flights[k].iloc[roles[k] == TRAINING] for k in "ab"]
    x = np.concatenate([(f[["w1", "w2", "w3", "w4"]] ** 2).sum(axis=1) for f in rows])
    z = np.concatenate([f["Fz"] for f in rows])
    assert [t["name"] for t in found["terms"]] == ["w2_1 + w2_2 + w2_3 + w2_4"]
    assert found["terms"][0]["coefficient"] == pytest.approx(x @ z / (x @ x), rel=1e-10)


def test_a_known_coefficient_is_kept_and_the_rest_fitted(flights, roles):
    section = {"fixed": ["u", "w_tot*u"], "candidates": [], "fixed coefficients": {"w_tot*u": -2e-5}}
    found = identify("Fx", flights, roles, section)
    known = found["terms"][-1]
    assert known["coefficient"] == -2e-5
    assert known["given"]
    assert found["estimated"] == ["bias", "u"]
    assert found["terms"][1]["coefficient"] == pytest.approx(-0.01, abs=5 * found["terms"][1]["std"])


def test_validation_flights_do_not_enter(flights, roles):
    section = {"fixed": ["u"], "candidates": [{"vars": ["u", "q"], "degree": 2, "sets": [1, "w_tot"]}]}
    with_them = identify("Fx", flights, roles, section)
    without = identify("Fx", {k: flights[k] for k in "ab"}, roles, section)
    assert with_them == without


def test_missing_values_are_dropped_and_counted(flights, roles):
    holed = {k: f.copy() for k, f in flights.items()}
    rows = np.flatnonzero(roles["a"] == TRAINING)[:37]
    holed["a"].loc[rows, "q"] = np.nan
    section = {"fixed": ["u"], "candidates": [{"vars": ["q"], "degree": 1}]}
    found = identify("Fx", holed, roles, section)
    assert found["dropped rows"] == {"a": 37}
    assert any("37 training rows of flight a" in n for n in found["notes"])
    # a hole in a column that nothing asks for costs nothing
    assert identify("Fx", holed, roles, {"fixed": ["u"], "candidates": []})["dropped rows"] == {}


def test_a_division_by_zero_leaves_a_candidate_out_with_a_note(flights, roles):
    section = {"fixed": ["u"], "candidates": [{"vars": ["w/(p - p)", "q"], "degree": 1}]}
    found = identify("Fx", flights, roles, section)
    assert "not finite" in found["unusable"]["((w/(p - p))^(1.0))"]
    with pytest.raises(DataError, match="fixed regressor 'u/"):
        identify("Fx", flights, roles, {"fixed": ["u/(p - p)"], "candidates": []})


@pytest.mark.parametrize(
    ("section", "hint"),
    [
        ({"fixed": ["U_x"], "candidates": []}, "Fx, flight a: unknown variable 'U_x'"),
        ({"fixed": ["mu_vin"], "candidates": []}, "Fx, flight a: variable 'mu_vin' needs the column 'v_in'"),
    ],
)
def test_unknown_and_missing_variables_name_axis_and_flight(flights, roles, section, hint):
    with pytest.raises(ExpressionError, match=hint):
        identify("Fx", flights, roles, section)


def test_rows_without_any_value_are_an_error(flights, roles):
    empty = {k: f.assign(q=np.nan) for k, f in flights.items()}
    with pytest.raises(DataError, match="no training rows are left"):
        identify("Fx", empty, roles, {"fixed": ["q"], "candidates": []})
    with pytest.raises(DataError, match="Fx is constant"):
        identify("Fx", {k: f.assign(Fx=1.0) for k, f in flights.items()}, roles, {"fixed": ["q"], "candidates": []})


def test_two_terms_that_do_the_same_are_reported_as_a_tie(flights, roles):
    twins = {k: f.assign(twin=f["w"] + 1e-3 * np.sin(f["t"])) for k, f in flights.items()}
    section = {"fixed": [], "candidates": [{"vars": ["w", "twin"], "degree": 1}]}
    found = identify("Fz", twins, roles, section, **{"regressor cap": 1})
    assert any("hardly distinguish them" in n for n in found["notes"])


def test_false_terms_stay_out_when_the_residuals_memory_is_counted():
    from scipy.signal import butter, sosfiltfilt

    low = butter(2, 1.0, fs=500.0, output="sos")
    plain, counted = 0, 0
    section = {"fixed": [], "candidates": [{"vars": ["u", "v", "w", "p", "q", "r"], "degree": 2}]}
    for seed in range(6):
        f = flight(seed, rows=6000)
        slow = sosfiltfilt(low, np.random.default_rng(100 + seed).standard_normal(6000))
        f["Fx"] = -0.1 * f["u"] + 0.1 * slow / slow.std()
        roles = partition({"a": f})
        plain += len(identify("Fx", {"a": f}, roles, section, **{"F in": 4})["terms"])
        found = identify("Fx", {"a": f}, roles, section)
        assert "(u^(1.0))" in found["estimated"]
        counted += len(found["terms"])
    assert plain > 6 * 8  # every step finds something at a constant F of 4
    assert counted <= 6 * 2 + 2


def test_a_constant_f_is_the_manuals_test_and_significance_the_default():
    assert options_of({}, 10).test == "significance"
    assert options_of({"F in": 4}, 10).test == "F"
    assert options_of({"F in": 4, "significance level": 0.01}, 10).test == "significance"
    assert options_of({"entry test": "F"}, 10).f_in == 4.0
    with pytest.raises(ConfigError, match="entry test is 'AIC'"):
        options_of({"entry test": "AIC"}, 10)


SECTION = {"fixed": ["u"], "candidates": [{"vars": ["u", "v", "q"], "degree": 2, "sets": [1, "w_tot"]}]}


def test_resampling_tells_how_often_each_term_is_chosen(flights, roles):
    found = identify("Fx", flights, roles, SECTION, bootstrap=20)
    drag = next(t for t in found["terms"] if t["name"] == "(w_tot)*(u^(1.0))")
    assert drag["inclusion frequency"] > 0.9
    assert drag["inclusion frequency with rivals"] >= drag["inclusion frequency"]
    assert found["bootstrap"]["resamples"] == 20
    assert found["bootstrap"]["of"] == "stretches"
    assert all(0 < other["inclusion frequency"] <= 1 for other in found["bootstrap"]["others"])
    again = identify("Fx", flights, roles, SECTION, bootstrap=20)
    assert again == found
    json.dumps(found, allow_nan=False)


def test_the_structure_can_be_chosen_by_flights_left_out(flights, roles):
    found = identify("Fx", flights, roles, SECTION, **{"structure choice": "leave one flight out", "regressor cap": 4})
    assert found["structure choice"]["by"] == "leave one flight out"
    assert len(found["structure choice"]["RMSE"]) == 5
    chosen = [t["name"] for t in found["terms"] if not t["fixed"]]
    assert len(chosen) == found["structure choice"]["steps"]
    assert "(w_tot)*(u^(1.0))" in chosen
    with pytest.raises(DataError, match="one training flight"):
        identify("Fx", {"a": flights["a"]}, roles, SECTION, **{"structure choice": "leave one flight out"})


def test_interchangeable_terms_are_named_as_data_and_in_words(flights, roles):
    twins = {k: f.assign(twin=f["w"] + 1e-3 * np.sin(f["t"])) for k, f in flights.items()}
    section = {"fixed": ["w2_1 + w2_2 + w2_3 + w2_4"], "candidates": [{"vars": ["w", "twin"], "degree": 1}]}
    found = identify("Fz", twins, roles, section, **{"regressor cap": 1})
    taken = found["terms"][-1]
    other = {"(w^(1.0))": "(twin^(1.0))", "(twin^(1.0))": "(w^(1.0))"}[taken["name"]]
    assert [r["expression"] for r in taken["interchangeable with"]] == [other]
    assert [r["expression"] for r in found["log"][1]["rivals"]] == [other]
    assert any(f"{other} could stand for {taken['name']} without the data noticing" in n for n in found["notes"])


def test_variances_inflated_by_another_term_are_said_with_its_name(flights, roles):
    twins = {k: f.assign(twin=f["u"] + 0.05 * f["v"]) for k, f in flights.items()}
    found = identify("Fx", twins, roles, {"fixed": ["u", "twin"], "candidates": []})
    note = next(n for n in found["notes"] if "the variance of the coefficient of u is" in n)
    assert "moves with twin" in note
    # next to a constant only what varies about the mean counts: regression of u on the others, by hand
    rows = [twins[k].iloc[roles[k] == TRAINING] for k in "ab"]
    u, twin = (np.concatenate([f[c] for f in rows]) for c in ("u", "twin"))
    share = np.corrcoef(u, twin)[0, 1] ** 2
    assert found["terms"][1]["inflation"] == pytest.approx(1 / (1 - share), rel=1e-8)
    assert found["terms"][0]["inflation"] is None


@pytest.mark.parametrize(
    ("change", "section", "hint"),
    [
        ({"q": 0.0}, {"fixed": ["q"], "candidates": []}, "fixed regressor 'q' is zero"),
        ({"q": 0.3}, {"fixed": ["q"], "candidates": []}, "fixed regressor 'q' is constant"),
        ({}, {"fixed": ["u", "2*u + 0*v"], "candidates": []}, "is a multiple of 'u'"),
        ({"twin": "u"}, {"fixed": ["u", "twin"], "candidates": []}, "'twin' is a combination of the other fixed"),
        ({"Fx": np.nan}, {"fixed": ["u"], "candidates": []}, "no training rows are left"),
        ({}, {"fixed": ["u/(v - v)"], "candidates": []}, "is not finite in some rows"),
        ({}, {"fixed": ["(u)(v)"], "candidates": []}, "expected an operator"),
        ({}, {"fixed": ["__import__(u)"], "candidates": []}, "nothing can be called"),
        ({}, {"fixed": ["(" * 10_000 + "u" + ")" * 10_000], "candidates": []}, "nested deeper"),
        ({}, {"fixed": ["wind"], "candidates": []}, "unknown variable 'wind'"),
    ],
)
def test_bad_input_is_one_sentence(flights, roles, change, section, hint):
    spoilt = {
        k: f.assign(**{c: f[v] if isinstance(v, str) else v for c, v in change.items()}) for k, f in flights.items()
    }
    with pytest.raises(QuasiError, match=re.escape(hint)) as caught:
        identify("Fx", spoilt, roles, section)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("config", [{}, {"F in": 4}, {"structure choice": "leave one flight out"}])
def test_a_force_without_any_noise_is_found_exactly(config):
    clean = {key: flight(seed, noise=0.0) for seed, key in enumerate("ab")}
    found = identify("Fx", clean, partition(clean), SECTION, bootstrap=5, **config)
    coefficients = {t["name"]: t["coefficient"] for t in found["terms"]}
    assert coefficients["u"] == pytest.approx(-0.01, rel=1e-6)
    assert coefficients["(w_tot)*(u^(1.0))"] == pytest.approx(-2e-5, rel=1e-6)
    assert len(coefficients) == 3


@pytest.mark.parametrize("rows", [4, 30])
@pytest.mark.parametrize("config", [{}, {"F in": 4}, {"structure choice": "leave one flight out"}])
def test_a_handful_of_rows_makes_a_model_or_a_sentence(flights, rows, config):
    short = {key: f.iloc[3000 : 3000 + rows].reset_index(drop=True) for key, f in flights.items()}
    every = dict.fromkeys(short, np.full(rows, TRAINING, np.int8))
    try:
        found = identify("Fx", short, every, SECTION, bootstrap=5, **config)
    except DataError as error:
        assert "few" in str(error)
    else:
        assert found["n"] == 3 * rows
        assert len(found["terms"]) < found["n"]


def test_a_section_that_leaves_nothing_to_fit_is_said(flights, roles):
    section = {"fixed": ["u"], "candidates": [], "fixed coefficients": {"u": 1.0}}
    with pytest.raises(DataError, match="there is nothing to fit"):
        identify("Fx", flights, roles, section, bias=False)


def test_the_log_holds_the_bias_of_each_step_and_words_for_it(flights, roles):
    specification = read_specification(tables.read_json(FM), "Fx", FM)
    found = fit_axis("Fx", flights, roles, AIRFRAME, SHARED, {"regressor cap": 3, "entry test": "F"}, specification)
    log = found["log"]
    final = next(t["coefficient"] for t in found["terms"] if t["name"] == "bias")
    assert log[-1]["bias"] == pytest.approx(final, rel=1e-6, abs=1e-9)
    # the first step by an independent least squares: constant and the fixed u
    rows = {key: roles[key] == TRAINING for key in flights}
    u = np.concatenate([flights[key]["u"].to_numpy()[rows[key]] for key in flights])
    z = np.concatenate([flights[key]["Fx"].to_numpy()[rows[key]] for key in flights])
    assert log[0]["bias"] == pytest.approx(sm.OLS(z, sm.add_constant(u)).fit().params[0], rel=1e-6, abs=1e-9)
    lines = describe_steps("Fx", log, found["stop reason"])
    assert len(lines) == len(log) + 1
    for entry, line in zip(log, lines):
        for value in (entry["PSE"], entry["R2"], entry["bias"]):
            assert f"{value:.6f}" in line or f"{value:.6g}" in line
        assert all(entry[key] is None or entry[key] in line for key in ("selected", "removed"))
