"""The parser against Python's own arithmetic, and the algebra of duplicates against numbers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quasi.errors import ExpressionError, nearest
from quasi.terms.canonical import canonicalise
from quasi.terms.expressions import Program, evaluate, names, parse, text

VALUES = {"a": np.array([1.5, -0.7, 3.0]), "b": np.array([0.3, 2.0, -1.1]), "c": np.array([2.0, 2.5, 0.4])}


def python(expression: str) -> np.ndarray:
    """The same text by Python's own parser: ** has the precedence and the associativity that ^ has here."""
    with np.errstate(all="ignore"):
        return eval(expression.replace("^", "**"), {"__builtins__": {}}, {**VALUES, "d": VALUES["a"]})


numbers = st.sampled_from(["1", "2", "0.5", ".25", "1e-3", "2.5E+1", "3."])
atoms = st.one_of(st.sampled_from(["a", "b", "c"]), numbers)
expressions = st.recursive(
    atoms,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*", "/", " - ", "*-"]), inner).map("".join),
        inner.map(lambda e: f"({e})"),
        inner.map(lambda e: f"-({e})"),
        st.tuples(atoms, st.sampled_from(["^2", "^3", "^-1", "^(2)", "^0.5", "^2^2"])).map("".join),
    ),
    max_leaves=8,
)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(expressions)
def test_values_equal_pythons(expression):
    mine = evaluate(parse(expression), VALUES)
    np.testing.assert_allclose(mine, np.broadcast_to(python(expression), mine.shape), rtol=1e-12, equal_nan=True)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(expressions)
def test_canonical_text_reads_back_as_the_same_tree(expression):
    tree = parse(expression)
    assert parse(text(tree)) == tree


@settings(max_examples=200, deadline=None, derandomize=True)
@given(expressions, expressions)
def test_equal_keys_mean_proportional_values(one, other):
    (f, key), (g, same) = canonicalise(parse(one)), canonicalise(parse(other))
    if key == same and key:
        x, y = np.broadcast_arrays(evaluate(parse(one), VALUES) * g, evaluate(parse(other), VALUES) * f)
        good = np.isfinite(x) & np.isfinite(y)
        np.testing.assert_allclose(x[good], y[good], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("one", "other", "ratio"),
    [
        ("2*u*v", "v*u", 2.0),
        ("(a + b)^2", "a^2 + 2*a*b + b^2", 1.0),
        ("u^(1.0)*u^(2.0)", "u^3", 1.0),
        ("|u|^2", "u*u", 1.0),
        ("|u|*|u|*|u|", "u^2*|u|", 1.0),
        ("3*(a - b)", "b - a", -3.0),
        ("(w2_1 + w2_2)/4", "w2_2 + w2_1", 0.25),
        ("a/b*c", "c*a/b", 1.0),
        ("a*(b/c)", "a/(c/b)", 1.0),
        ("(4*u^2)^0.5", "|u|", 2.0),
        ("1/(a + b)", "2/(2*a + 2*b)", 1.0),
        ("(u^2 + v^2)^0.5*u", "u*(v^2 + u^2)^0.5", 1.0),
        ("5", "1", 5.0),
    ],
)
def test_multiples_are_found_by_algebra(one, other, ratio):
    (f, key), (g, same) = canonicalise(parse(one)), canonicalise(parse(other))
    assert key == same
    assert f / g == pytest.approx(ratio)


@pytest.mark.parametrize(
    ("one", "other"), [("u", "|u|"), ("u^2", "u^3"), ("a - b", "a + b"), ("(a - b)^0.5", "(b - a)^0.5"), ("a/b", "b/a")]
)
def test_unlike_expressions_keep_unlike_keys(one, other):
    assert canonicalise(parse(one))[1] != canonicalise(parse(other))[1]


def test_synonyms_are_replaced_before_comparison():
    synonyms = {"w2_1": parse("w1^2")}
    assert canonicalise(parse("w2_1*u"), synonyms)[1] == canonicalise(parse("u*w1*w1"), synonyms)[1]


def test_numbers_beyond_floats_do_not_break_the_comparison():
    assert canonicalise(parse("(1e300*a)^5"))[1] == canonicalise(parse("(1e300*a)^5"))[1]


def test_the_manuals_examples_of_section_9_2():
    d = {k: np.array([v]) for k, v in {"a": 3.0, "b": 2.0, "c": 5.0, "d": 0.5}.items()}
    assert evaluate(parse("1 + 40/(2)"), d) == pytest.approx(21)
    assert evaluate(parse("1/(a-1) + b - (c + d/(b))"), d)[0] == pytest.approx(0.5 + 2 - (5 + 0.25))
    assert evaluate(parse("(a + b)^(1.234)"), d)[0] == pytest.approx(5**1.234)
    exponent = 0.5 / (5 - 3) * 2**2
    assert evaluate(parse("c*(a + b + 3.14)^(d/(c-a)*b^(2))"), d)[0] == pytest.approx(5 * 8.14**exponent)


def test_names_hold_bars_and_square_brackets():
    tree = parse("|u|*sin[roll] - w2_1/|U_p|")
    assert names(tree) == ("|u|", "sin[roll]", "w2_1", "|U_p|")


@pytest.mark.parametrize(
    ("wrong", "place", "hint"),
    [
        ("a + ", "character 4", "the end"),
        ("a b", "character 3", "operator"),
        ("(a + b", "character 7", "close the bracket of character 1"),
        ("a)", "character 2", "operator"),
        ("sin(a)", "character 4", "nothing can be called"),
        ("__import__('os')", "character 11", "nothing can be called"),
        ("a ** 2", "character 3", "'^'"),
        ("a $ b", "character 3", "operator"),
        ("", "character 1", "a number, a name"),
        ("2 u", "character 3", "operator"),
        ("1e999", "character 1", "too large"),
        ("(" * 10_000 + "a" + ")" * 10_000, "character 61", "nested"),
        ("a" + "^a" * 10_000, "character", "nested"),
    ],
)
def test_a_wrong_expression_is_a_sentence_with_place_and_remedy(wrong, place, hint):
    with pytest.raises(ExpressionError, match="expression '") as caught:
        parse(wrong)
    assert place in str(caught.value)
    assert hint in str(caught.value)
    assert len(str(caught.value)) < 300


def test_long_flat_expressions_are_no_trouble():
    long = " + ".join(["a*b"] * 5000)
    np.testing.assert_allclose(evaluate(parse(long), VALUES), 5000 * VALUES["a"] * VALUES["b"])
    assert evaluate(parse("-" * 5000 + "a"), VALUES)[0] == 1.5


@pytest.mark.parametrize(("name", "meant"), [("Uq", "U_q"), ("uq", "u_q"), ("MASS", "mass")])
def test_of_names_that_differ_by_case_the_written_one_is_meant(name, meant):
    for known in (["u_q", "U_q", "mass"], ["mass", "U_q", "u_q"]):
        assert nearest(name, known) == f" (did you mean '{meant}'?)"


def test_an_unknown_name_names_the_nearest():
    with pytest.raises(ExpressionError, match=r"unknown variable 'w_tto'.*did you mean 'w_tot'"):
        evaluate(parse("w_tto*2"), {"w_tot": np.ones(2), "u": np.ones(2)})


def test_division_by_zero_touches_its_own_rows_only():
    value = evaluate(parse("1/a"), {"a": np.array([0.0, 2.0])})
    assert np.isinf(value[0])
    assert value[1] == 0.5


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.lists(expressions, min_size=1, max_size=6))
def test_a_program_gives_what_single_evaluation_gives(several):
    trees = [parse(e) for e in several]
    out = Program(trees).run(VALUES, 3)
    for row, tree in zip(out, trees):
        np.testing.assert_allclose(row, np.broadcast_to(evaluate(tree, VALUES), 3), equal_nan=True)
