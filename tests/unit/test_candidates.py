"""Polynomial specifications of the manual's syntax."""

import math
from pathlib import Path

import pytest

from quasi import tables
from quasi.errors import ConfigError, ExpressionError
from quasi.identification.candidates import read_specification
from quasi.model.document import AXES
from quasi.project import configuration
from quasi.terms.expressions import Program

LISTING = "config/polynomials/manual_listing_17.json"
FM = "config/polynomials/polyCands_DiffSys_quadraticU_symmetric_SIMPLE_FM.json"


def section(*candidates, **more):
    return {"Fx": {"candidates": list(candidates), **more}}


def pool(*candidates, **more):
    return [t.expression for t in read_specification(section(*candidates, **more), "Fx", "spec.json").candidates]


def test_names_are_those_of_the_manual():
    assert pool({"vars": ["u"], "degree": 2, "sets": [1, "w_tot"]}) == [
        "(u^(1.0))",
        "(u^(2.0))",
        "(w_tot)*(u^(1.0))",
        "(w_tot)*(u^(2.0))",
    ]


@pytest.mark.parametrize(("variables", "degree"), [(1, 4), (2, 2), (3, 4), (4, 3)])
def test_all_monomials_up_to_the_degree_are_there(variables, degree):
    found = pool({"vars": list("uvwp")[:variables], "degree": degree})
    assert len(found) == math.comb(variables + degree, degree) - 1


def test_the_two_spellings_of_the_manuals_equation_19_are_one():
    compact = {"vars": ["x", "z"], "degree": 2, "sets": [1, "u"]}
    apart = [{"vars": ["x", "z"], "degree": 2, "sets": [1]}, {"vars": ["x", "z"], "degree": 2, "sets": ["u"]}]
    assert set(pool(compact)) == set(pool(*apart))


def test_expressions_serve_as_vars_sets_and_fixed():
    entry = {"vars": ["(u + v - w)", "q*q"], "degree": 1, "sets": ["U_q + 3.47"]}
    found = read_specification(section(entry, fixed=["u*(sin[pitch]+u)*v"]), "Fx", "spec.json")
    assert [t.expression for t in found.candidates] == [
        "(U_q + 3.47)*(((u + v - w))^(1.0))",
        "(U_q + 3.47)*((q*q)^(1.0))",
    ]
    assert found.fixed[0].expression == "u*(sin[pitch]+u)*v"


def test_duplicates_go_whether_equal_scaled_or_rearranged():
    entries = [
        {"vars": ["u", "v"], "degree": 2, "sets": [1, 2]},
        {"vars": ["v*u", "3*u + 3*u", "|u|"], "degree": 2},
        {"vars": ["w"], "degree": 1, "sets": ["u", 0]},
        {"vars": ["u"], "degree": 1, "sets": ["w"]},
    ]
    found = read_specification(section(*entries, fixed=["v"]), "Fx", "spec.json")
    assert "(v^(1.0))" not in [t.expression for t in found.candidates]
    texts = [t.expression for t in found.candidates]
    assert "(|u|^(1.0))" in texts
    assert "(|u|^(2.0))" not in texts
    assert "(2)*(u^(1.0))" not in texts
    assert "(w)*(u^(1.0))" not in texts
    assert ("(2)*(u^(1.0))", "(u^(1.0))") in found.duplicates
    assert not any(t.startswith("(0)*") for t in texts)


def test_zero_mean_candidates_are_not_mistaken_for_duplicates():
    assert pool({"vars": ["p", "q", "r"], "degree": 1}) == ["(p^(1.0))", "(q^(1.0))", "(r^(1.0))"]


def test_constants_are_no_candidates_beside_a_bias():
    assert pool({"vars": ["2"], "degree": 1}) == []


def test_no_bias_and_no_fixed_regressor_is_refused():
    with pytest.raises(ConfigError, match=r"spec.json, Fx.*add bias term fx"):
        read_specification(section({"vars": ["u"], "degree": 1}), "Fx", "spec.json", bias=False)


def test_fixed_coefficients_belong_to_fixed_regressors():
    found = read_specification(section(fixed=["u"], **{"fixed coefficients": {"u": 2}}), "Fx", "spec.json")
    assert found.known == {"u": 2.0}
    with pytest.raises(ConfigError, match="not under 'fixed'"):
        read_specification(section(fixed=["u"], **{"fixed coefficients": {"w": 2}}), "Fx", "spec.json")


@pytest.mark.parametrize(
    ("entry", "hint"),
    [
        ({"vars": ["sin(u)"], "degree": 1}, "nothing can be called"),
        ({"vars": ["(" * 10_000 + "u"], "degree": 1}, "nested"),
        ({"vars": list("uvwpqrxyz"), "degree": 20}, "candidates; lower 'degree'"),
    ],
)
def test_a_wrong_entry_is_a_sentence_with_file_and_place(entry, hint, monkeypatch):
    monkeypatch.setattr("quasi.identification.candidates.LARGEST_POOL", 2000)
    with pytest.raises((ConfigError, ExpressionError), match=r"spec\.json, Fx") as caught:
        pool(entry)
    assert hint in str(caught.value)


@pytest.mark.parametrize(
    ("part", "hint"),
    [
        ({"candidates": [{"vars": [], "degree": 1}]}, "'vars'"),
        ({"candidates": [{"vars": ["u"], "degree": 0}]}, "'degree' is 0"),
        ({"candidates": [{"vars": ["u"], "degree": 1, "sets": []}]}, "'sets'"),
        ({"candidates": [{"vars": [None], "degree": 1}]}, "is null, expected text"),
        ({"candidates": {}}, "expected a list"),
        ({"fixed": [True]}, "expected text or a number"),
        ({"fixed": ["u"], "fixed coefficients": {"u": "2"}}, "'u' is '2', expected a number"),
    ],
)
def test_a_section_of_the_wrong_form_is_refused_by_the_schema(part, hint):
    with pytest.raises(ConfigError, match=r"spec\.json: 'Fx'") as caught:
        configuration.check({"Fx": part}, "polynomials", "spec.json")
    assert hint in str(caught.value)


@pytest.mark.parametrize("name", sorted(str(p) for p in Path("config/polynomials").glob("*.json")))
def test_the_standard_files_can_be_read(name):
    document = tables.read_json(name)
    for axis in AXES:
        found = read_specification(document, axis, name)
        assert found.candidates
        assert found.fixed


def test_the_printed_pool_of_fz_has_the_printed_entries():
    # 34 monomials of 3 variables to degree 4 times 8 sets, 19 of 3 to degree 3 times 2, 4 of 1, less the fixed w
    found = read_specification(tables.read_json(LISTING), "Fz", LISTING)
    assert len(found.candidates) == 34 * 8 + 19 * 2 + 4 - 1
    assert found.duplicates == (("(w^(1.0))", "w"),)


def test_the_standard_fm_pool_of_fz_has_as_many_candidates_as_the_reference_counts():
    # the printed pool, the same 34 x 8 in advance ratios, and 19 of the three differential thrusts times 2
    found = read_specification(tables.read_json(FM), "Fz", FM)
    assert len(found.candidates) == 623
    printed = read_specification(tables.read_json(LISTING), "Fz", LISTING)
    assert {t.expression for t in printed.candidates} <= {t.expression for t in found.candidates}


def test_the_manuals_printed_formulation_is_read_whole_and_evaluates():
    # section 9.2: 69 monomials of 4 expressions to degree 4 times 4 sets, 9 of 2 to degree 3 times 2
    entries = [
        {
            "vars": ["(u + v - w)", "u", "w1 - w2 + w3 - w4", "sin[roll]"],
            "degree": 4,
            "sets": [1, "w_tot", "q^(10 - p*r)", "U_q + 3.47"],
        },
        {"vars": ["q/(p - r)", "q*q"], "degree": 3, "sets": [1, "w_tot*((u + v)^(w-2))"]},
    ]
    fixed = "u*(sin[pitch]+u)*v + w^(u/(v) + p*r + q)"
    found = read_specification(section(*entries, fixed=[fixed]), "Fx", "spec.json")
    assert len(found.candidates) == 69 * 4 + 9 * 2
    at = {"u": 2.0, "v": 1.0, "w": 2.5, "p": 0.5, "q": 1.5, "r": -0.5, "w1": 9.0, "w2": 8.0, "w3": 7.0, "w4": 6.0}
    at |= {"sin[roll]": 0.1, "sin[pitch]": 0.2, "w_tot": 30.0, "U_q": 4.0}
    values = dict(zip([fixed, *(t.expression for t in found.candidates)], Program(found.trees).run(at, 1)[:, 0]))
    assert values[fixed] == pytest.approx(2 * 2.2 * 1 + 2.5 ** (2 - 0.25 + 1.5))
    last = "(w_tot*((u + v)^(w-2)))*((q/(p - r))^(1.0) * (q*q)^(2.0))"
    assert values[last] == pytest.approx(30 * 3**0.5 * 1.5 * 1.5**4)
    powered = "(q^(10 - p*r))*(((u + v - w))^(1.0) * u^(3.0))"
    assert values[powered] == pytest.approx(1.5**10.25 * 0.5 * 8)
