"""Identification of one axis: the truth is found, and what the data lack is said."""

import json

import numpy as np
import pytest
import statsmodels.api as sm
from flights import AIRFRAME, HOVER, THRUST, flight

from quasi import tables
from quasi.errors import DataError, ExpressionError
from quasi.identification.candidates import read_specification
from quasi.identification.fit import fit_axis
from quasi.identification.partition import TRAINING, partition

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
    assert any("hardly tell them apart" in n for n in found["notes"])


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
