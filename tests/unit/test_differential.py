"""Derivatives of a model: against complex steps through plain arithmetic, and Euler's equations by differences."""

import cmath
import copy

import numpy as np
import pytest
from flights import AIRFRAME, HOVER, flight
from made_model import SHARED, TERMS, document, part

from quasi.airframe import to_plain
from quasi.errors import ConfigError
from quasi.model.build import add_differential_form, assemble_model
from quasi.model.model import Model
from quasi.terms.differential import cross_matrix, make_differential_system
from quasi.terms.expressions import parse
from quasi.terms.kernel import INPUTS, compute_wrench
from quasi.terms.variables import check_system_inputs

STEP = 1e-30  # of a complex step: no digits are lost, however small

RICH = {
    "Fx": {"|u|*u": -0.01, "sin[pitch]*w_avg": 1e-3, "u/(1 + |mu_x|)": 0.02, "(u^2 + v^2)^0.5*u": 0.01},
    "Fy": {"v*w_tot": -1e-5, "cos[roll]*mu_y": 0.3, "|sin[yaw]|*v^-2": 0.1, "u_p^3": 1e-9},
    "Fz": {"w2_1 + w2_2 + w2_3 + w2_4": -1e-6, "mu_z^2*w_avg^2/d_w_tot": 1e-6, "|w|^1.5": 0.1, "|u|^|v|": 0.01},
    "Mx": {"U_p": 1e-7, "p*w_tot": -1e-7, "q*u_r": 1e-6, "U_p*U_q/U_r": 1e-9, "p*q*r": 1e-3, "r^2": 1e-4},
    "My": {"U_q": 1e-7, "|q|*q": -1e-3, "p*u_r": -1e-6, "q/w_avg": 0.2, "p^2*U_r": 1e-9, "U_q^2": 1e-14},
    "Mz": {"U_r": 2e-8, "u_r_dot": 3e-6, "p*q": 1e-3, "|U_r|*r": 1e-9, "sin[p]*cos[q]": 1e-3, "2^r": 1e-4},
}


def rich(inertia=None):
    parts = {axis: part(axis, terms) for axis, terms in RICH.items()}
    made = assemble_model(parts, SHARED, {"id": "m", "airframe": AIRFRAME})
    if inertia is not None:
        made["airframe"] = to_plain(AIRFRAME) | {"inertia": inertia}
    return Model(made)


@pytest.fixture(scope="module")
def data():
    f = flight(4, rows=60)
    table = f[list(INPUTS)].to_numpy().copy()
    table[:, 12:16] += np.random.default_rng(0).normal(size=(60, 4)) * 80
    return table


def absolute(x):
    """|x| as complex steps want it: it follows the sign of the real part."""
    return x if complex(x).real >= 0 else -x


def variables_by_hand(x):
    """Every variable of the terms from complex base columns, in plain arithmetic."""
    w = [x[f"w{i}"] for i in range(1, 5)]
    squares = [s * s for s in w]
    average = cmath.sqrt(sum(squares) / 4)
    made = dict(x)
    made |= {f"w2_{i}": s for i, s in enumerate(squares, 1)}
    made |= {"w_tot": sum(w), "w_avg": average, "d_w_tot": sum(w) - 4 * HOVER}
    # rotors 3 and 4 left, 2 and 4 in front; 1 and 4 clockwise
    made |= {"u_p": w[2] + w[3] - w[0] - w[1], "u_r": w[0] + w[3] - w[1] - w[2]}
    made |= {"U_p": squares[2] + squares[3] - squares[0] - squares[1]}
    made |= {"U_q": squares[1] + squares[3] - squares[0] - squares[2]}
    made |= {"U_r": squares[0] + squares[3] - squares[1] - squares[2]}
    made |= {"u_r_dot": x["w1_dot"] + x["w4_dot"] - x["w2_dot"] - x["w3_dot"]}
    return made | {f"mu_{a}": x[b] / (average * AIRFRAME.radius) for a, b in zip("xyz", "uvw")}


def by_hand(tree, of):
    kind = tree[0]
    if kind == "number":
        return tree[1]
    if kind == "name":
        name = tree[1]
        if name.startswith("|"):
            return absolute(by_hand(("name", name[1:-1]), of))
        if name.startswith(("sin[", "cos[")):
            return getattr(cmath, name[:3])(by_hand(("name", name[4:-1]), of))
        return of[name]
    if kind == "negative":
        return -by_hand(tree[1], of)
    if kind == "power":
        return by_hand(tree[1], of) ** by_hand(tree[2], of)
    total = by_hand(tree[1][0][1], of)
    for sign, inner in tree[1][1:]:
        value = by_hand(inner, of)
        total = total + sign * value if kind == "sum" else total * value if sign > 0 else total / value
    return total


def wrench_by_hand(terms, of):
    return [
        sum(c * by_hand(parse(e), of) for e, c in terms[axis].items()) for axis in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
    ]


def steps(terms, row, wrt, held=()):
    """Derivatives (6, len(wrt)) of one row by complex steps; a variable in `held` is moved by itself."""
    found = []
    for name in wrt:
        x = {n: complex(v) for n, v in zip(INPUTS, row)}
        if name not in held:
            x[name] += STEP * 1j
        of = variables_by_hand(x)
        if name in held:
            of[name] += STEP * 1j
        found.append([complex(v).imag / STEP for v in wrench_by_hand(terms, of)])
    return np.array(found).T


def test_the_jacobian_equals_complex_steps(data):
    model = rich()
    found = model.jacobian(data[:, :12], data[:, 12:16], data[:, 16:])
    assert found.state.shape == (60, 6, 12)
    assert found.rotor_speeds.shape == found.rotor_accelerations.shape == (60, 6, 4)
    for k in range(0, 60, 3):
        expected = steps(RICH, data[k], INPUTS)
        table = np.hstack([found.state[k], found.rotor_speeds[k], found.rotor_accelerations[k]])
        np.testing.assert_allclose(table, expected, rtol=1e-10, atol=1e-12 * np.abs(expected).max())


def test_one_row_equals_the_batch_and_the_compiled_form(data):
    model = rich()
    batch = model.jacobian(data[:, :12], data[:, 12:16], data[:, 16:])
    single = model.jacobian(data[7, :12], data[7, 12:16], data[7, 16:])
    for one, many in zip(single, batch):
        np.testing.assert_allclose(one, many[7], rtol=1e-13)
    kernel = model.derivative_kernel(INPUTS)
    out = np.empty(kernel.outputs)
    compute_wrench(kernel, data[7], kernel.work, out)
    np.testing.assert_allclose(out.reshape(6, 20)[:, :12], single.state, rtol=1e-13)


def test_predictions_along_a_small_step_follow_the_jacobian(data):
    model = Model(document())
    states, speeds = data[:, :12], data[:, 12:16]
    jacobian = model.jacobian(states, speeds)
    step = np.random.default_rng(1).normal(size=(60, 16)) * np.r_[[1e-5] * 12, [1e-2] * 4]
    ends = [np.hstack(model.predict(states + s * step[:, :12], speeds + s * step[:, 12:])) for s in (0.5, -0.5)]
    expected = np.einsum("nij,nj->ni", jacobian.state, step[:, :12])
    expected += np.einsum("nij,nj->ni", jacobian.rotor_speeds, step[:, 12:])
    change = ends[0] - ends[1]
    np.testing.assert_allclose(change / np.abs(change).max(axis=0), expected / np.abs(change).max(axis=0), atol=1e-6)


INERTIA = [[8e-4, 5e-5, -3e-5], [5e-5, 1.1e-3, 4e-5], [-3e-5, 4e-5, 1.7e-3]]


def acceleration(terms, of, inertia):
    """dw/dt from Euler's equations, cross product and inverse written out by numpy."""
    rates = np.array([of["p"], of["q"], of["r"]])
    moments = np.array(wrench_by_hand(terms, of)[3:])
    return np.linalg.solve(np.array(inertia, complex), moments - np.cross(rates, np.array(inertia) @ rates))


@pytest.mark.parametrize("u", [("U_p", "U_q", "U_r"), ("w1", "w2", "w3", "w4")])
def test_a_and_b_are_the_derivatives_of_eulers_equations_with_full_inertia(data, u):
    model = rich(INERTIA)
    found = make_differential_system(model, data[:, :12], data[:, 12:16], u, data[:, 16:])
    assert found.u == u
    for k in range(0, 60, 7):
        for matrix, names in ((found.A[k], ("p", "q", "r")), (found.B[k], u)):
            for column, name in enumerate(names):
                x = {n: complex(v) for n, v in zip(INPUTS, data[k])}
                if name in x:
                    x[name] += STEP * 1j
                of = variables_by_hand(x)
                if name not in x:
                    of[name] += STEP * 1j
                expected = acceleration(RICH, of, INERTIA).imag / STEP
                np.testing.assert_allclose(matrix[:, column], expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())


def test_off_diagonal_derivatives_reach_every_axis(data):
    # Mx alone depends on q; with a full inertia that moves all three accelerations
    terms = {"Mx": {"q": 1e-3}, "My": {"U_q": 1e-7}, "Mz": {"U_r": 1e-8}}
    made = assemble_model({a: part(a, t) for a, t in terms.items()}, SHARED, {"id": "m", "airframe": AIRFRAME})
    made["airframe"] = to_plain(AIRFRAME) | {"inertia": INERTIA}
    found = make_differential_system(Model(made), np.zeros(12), np.full(4, HOVER), ["U_q"])
    np.testing.assert_allclose(found.A, np.linalg.inv(INERTIA) @ [[0, 1e-3, 0], [0, 0, 0], [0, 0, 0]], rtol=1e-12)
    np.testing.assert_allclose(found.B[:, 0], np.linalg.inv(INERTIA)[:, 1] * 1e-7, rtol=1e-12)
    assert np.isnan(found.forces_x).all()


def test_the_matrix_of_a_cross_product():
    a, b = np.random.default_rng(0).normal(size=(2, 9, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", cross_matrix(a), b), np.cross(a, b), rtol=1e-13)


def test_force_derivatives_come_with_it(data):
    model = rich()
    found = make_differential_system(model, data[3, :12], data[3, 12:16], ["U_p", "u_r"], data[3, 16:])
    expected = steps(RICH, data[3], ("U_p", "u_r"), held=("U_p", "u_r"))
    np.testing.assert_allclose(found.forces_u, expected[:3], rtol=1e-10, atol=1e-20)
    np.testing.assert_allclose(found.moments_u, expected[3:], rtol=1e-10, atol=1e-20)
    np.testing.assert_allclose(
        found.forces_x, model.jacobian(data[3, :12], data[3, 12:16]).state[:3, 6:9], rtol=1e-12, atol=1e-20
    )


def test_what_stays_constant_is_told():
    model = rich()
    assert model.held_constant(["U_p", "U_q", "U_r"]) == ["w_tot", "u_r", "w_avg"]
    assert model.held_constant(["w1", "w2", "w3", "w4"]) == []


@pytest.mark.parametrize(
    ("u", "said"),
    [
        (["p"], "part of x"),
        (["U_w"], "unknown input 'U_w'.*mean"),
        (["|U_p|"], "name 'U_p'"),
        (["w2_1"], "name 'w1'"),
        (["U_p", "U_p"], "twice"),
        (["wtot", "w_tot"], "twice"),
        (["U_p", "w1"], "made of 'w1'"),
        ([], "at least one"),
        (["__import__('os')"], "unknown input"),
    ],
)
def test_inputs_that_cannot_be_are_refused(u, said):
    with pytest.raises(ConfigError, match=said):
        check_system_inputs(u, "config/models/m.json")


def test_without_a_configured_form_the_inputs_are_asked_for(data):
    model = Model(document())
    with pytest.raises(ConfigError, match="made without a differential form"):
        make_differential_system(model, data[0, :12], data[0, 12:16])
    chosen = Model(copy.deepcopy(model.document) | {"differential form": {"x": ["p", "q", "r"], "u": ["U_p"]}})
    assert make_differential_system(chosen, data[0, :12], data[0, 12:16]).B.shape == (3, 1)
    only = assemble_model({"Fz": part("Fz", TERMS["Fz"])}, SHARED, {"id": "m", "airframe": AIRFRAME})
    with pytest.raises(ConfigError, match="lacks Mx, My, Mz"):
        make_differential_system(Model(only), data[0, :12], data[0, 12:16], ["U_p"])


def test_a_configured_form_tells_what_it_keeps_constant_and_what_it_never_uses():
    made = add_differential_form(rich().document, ["U_p", "U_q", "battery_voltage"], "config/models/m.json")
    assert made["differential form"]["u"] == ["U_p", "U_q", "battery_voltage"]
    assert made["differential form"]["kept constant"] == ["w_tot", "u_r", "U_r", "w_avg"]
    said = " ".join(made["notes"])
    assert "depends on the rotor speeds (w_tot, u_r, U_r, w_avg)" in said
    assert "no moment depends on battery_voltage" in said
    assert "no moment depends on U_" not in said
    with pytest.raises(ConfigError, match="Mx, Mz is not identified"):
        add_differential_form(
            assemble_model({"My": part("My", TERMS["My"])}, SHARED, {"id": "m", "airframe": AIRFRAME}), ["U_q"], "here"
        )
