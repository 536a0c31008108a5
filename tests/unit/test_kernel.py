"""The compiled model: equal to the plain evaluation of its expressions, for every operation and every variable."""

import numpy as np
import pytest
from flights import AIRFRAME, HOVER
from hypothesis import given, settings
from hypothesis import strategies as st

from quasi.errors import ExpressionError
from quasi.terms.expressions import Program, parse
from quasi.terms.graph import Graph
from quasi.terms.kernel import INPUTS, compile_outputs, compute_wrench, compute_wrench_rows
from quasi.terms.variables import Variables

NAMES = [
    *INPUTS, "w2_1", "w2_3", "w_tot", "wtot", "w_avg", "wavg", "u_p", "u_q", "u_r", "U_p", "U_q", "U_r", "d_w2",
    "d_w_tot", "d_wtot", "mu_x", "mu_y", "mu_z", "mu_vin", "w_tot_dot", "u_p_dot", "u_q_dot", "u_r_dot", "v_in",
    "battery_voltage", "|u|", "|U_p|", "|mu_z|", "sin[roll]", "cos[yaw]", "sin[mu_x]", "|sin[pitch]|", "cos[|w|]",
]  # fmt: skip
ROWS = 60


def columns(rows=ROWS, seed=0):
    r = np.random.default_rng(seed)
    made = {name: r.normal(size=rows) * 2 for name in INPUTS[:12]}
    made |= {name: r.normal(size=rows) * 4 for name in ("roll", "pitch", "yaw")}
    made |= {f"w{i}": r.uniform(300, 1500, rows) for i in range(1, 5)}
    made |= {f"w{i}_dot": r.normal(size=rows) * 3000 for i in range(1, 5)}
    return made | {"v_in": r.uniform(1, 9, rows), "battery_voltage": r.uniform(14, 17, rows)}


def compiled(terms, data):
    """Values (terms, rows) by single rows, after a check that many rows at a time give the same."""
    graph = Graph(AIRFRAME, HOVER)
    outputs = [graph.combine([(1.0, graph.value(parse(term)))]) for term in terms]
    names = [*INPUTS, *(n for n in graph.inputs(outputs) if n not in INPUTS)]
    kernel = compile_outputs(graph, outputs, names)
    rows = len(data["u"])
    table = np.column_stack([data[name] if kernel.used[k] else np.full(rows, np.nan) for k, name in enumerate(names)])
    result, work = np.empty((len(terms), rows)), kernel.work
    for k in range(rows):
        out = np.empty(len(terms))
        compute_wrench(kernel, table[k], work, out)
        result[:, k] = out
    many = np.empty((len(terms), rows))
    compute_wrench_rows(kernel, np.ascontiguousarray(table[:, kernel.gather].T), many)
    np.testing.assert_allclose(many, result, rtol=1e-13)
    return result


def plain(terms, data):
    with np.errstate(all="ignore"):
        return Program([parse(t) for t in terms]).run(Variables(data, AIRFRAME, HOVER).__getitem__, len(data["u"]))


def test_every_variable_is_made_as_the_identification_makes_it():
    data = columns()
    np.testing.assert_allclose(compiled(NAMES, data), plain(NAMES, data), rtol=1e-12, atol=1e-12)


OPERATIONS = [
    "1", "-2.5", "u + v - w", "u*v/w*p", "u/v/w", "-u^2", "u^-3", "u^32", "u^0", "2^u", "|u|^0.5", "|u|^1.7", "u^0.5",
    "(u + v)^3", "(2*u)^-2", "3*(u - 1)*(u - 1)", "(u*v)^2*(v*u)^3", "u - u", "0*u", "u^2^0.5", "1/(1 + U_p^2/1e12)",
    "(u + 2*v)*(u + 2*v)", "sin[u]*cos[v] - cos[u]*sin[v]", "|u|*|u|*u", "u^40", "(-2)^3*u", "(u*1e200)*1e200*1e-200",
    "1e-200*1e-200*U_p^5", "((u/9)^32)^32", "((((u/9)^2*v)^3*w)^2)^9",
    "u/0.5", "(((u)))", "-(-(u))", "|u|^|v|", "(u^2 + v^2 + w^2)^0.5*u",
]  # fmt: skip


def test_every_operation_gives_what_the_plain_evaluation_gives():
    data = columns()
    np.testing.assert_allclose(compiled(OPERATIONS, data), plain(OPERATIONS, data), rtol=1e-12)


def test_division_by_zero_gives_what_floats_give():
    data = columns(4)
    data["u"] = np.array([0.0, 1.0, -1.0, np.nan])
    terms = ["1/u", "u/0", "0/u", "u^-2", "mu_x/u", "|u|^-0.5"]
    np.testing.assert_allclose(compiled(terms, data), plain(terms, data), rtol=1e-15)


# nothing but positive quantities, so that no digits cancel and one tolerance holds for all
POSITIVE = [
    "|u|",
    "|v|",
    "|p|",
    "w1",
    "w2",
    "w3",
    "w2_4",
    "w_tot",
    "w_avg",
    "|mu_x|",
    "|U_p|",
    "v_in",
    "battery_voltage",
]
TREE = st.recursive(
    st.sampled_from([*POSITIVE, "2", "0.5", "1.25", "7e-1"]),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+*/"), inner).map(lambda t: f"({t[0]}{t[1]}{t[2]})"),
        st.tuples(inner, st.sampled_from(["0", "1", "2", "3", "5", "-1", "-2", "0.5", "1.3"])).map(
            lambda t: f"({t[0]})^{t[1]}"
        ),
    ),
    max_leaves=12,
)


@settings(max_examples=100, deadline=None)
@given(st.lists(TREE, min_size=1, max_size=5))
def test_random_expressions_agree(terms):
    data = columns(20)
    found, expected = compiled(terms, data), plain(terms, data)
    ordinary = (np.abs(expected) < 1e250) & (np.abs(expected) > 1e-250)
    np.testing.assert_allclose(found[ordinary], expected[ordinary], rtol=1e-11)


def test_equal_parts_are_computed_once():
    graph = Graph(AIRFRAME, HOVER)
    outputs = [
        graph.combine([(2.0, graph.value(parse(t)))])
        for t in ("(w1^2 + w2^2)*u*v*p", "u*v*p*(w1^2+w2^2)*q", "3*p*v*u*(w1^2 + w2^2)*r", "w1^2")
    ]
    kernel = compile_outputs(graph, outputs, INPUTS)
    assert kernel.code[3] == 2 + 1 + 3 + 2  # two squares, their sum, one common product, times q, times r


def test_powers_of_powers_stay_small():
    graph = Graph(AIRFRAME, HOVER)
    kernel = compile_outputs(graph, [graph.combine([(1.0, graph.value(parse("((((u^32)^32)^32)^32)^32")))])], INPUTS)
    assert kernel.code[3] == 25  # five squarings per level
    out = np.empty(1)
    compute_wrench(kernel, np.full(20, 1.0 + 1e-9), kernel.work, out)
    assert out[0] == pytest.approx((1.0 + 1e-9) ** (32**5), rel=1e-6)


def test_used_tells_which_inputs_are_read():
    graph = Graph(AIRFRAME, HOVER)
    kernel = compile_outputs(graph, [graph.combine([(1.0, graph.value(parse("u_r*|q|*q")))])], INPUTS)
    assert [INPUTS[k] for k in np.flatnonzero(kernel.used)] == ["q", "w1", "w2", "w3", "w4"]
    assert not kernel.used[:3].any()


def test_a_difference_from_an_unknown_hover_speed_is_refused():
    with pytest.raises(ExpressionError, match="hover speed"):
        Graph(AIRFRAME, None).value(parse("d_w1"))
