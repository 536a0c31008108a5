"""Models at stopped rotors: removable singularities have their limits, in the library and in every export."""

from fractions import Fraction

import numpy as np
import pytest
from export_models import model
from flights import AIRFRAME, HOVER
from matlab_models import octave

from quasi.export.agreement import States, states_of
from quasi.export.c_source import c_files
from quasi.export.compiler import find_compiler
from quasi.export.matlab import write_matlab
from quasi.export.matlab_check import run_octave
from quasi.export.python_source import python_file
from quasi.export.running import run_c, run_python
from quasi.terms.expressions import Program, evaluate, names, parse
from quasi.terms.singularities import MIN_DENOMINATOR_SPEED, remove_singularities
from quasi.terms.variables import Variables

R = AIRFRAME.radius
U, V, W = 1.5, -0.75, 0.5
SPEEDS = {"u": U, "v": V, "w": W}
# limits for rotors that slow down together, derived by hand from mu_x = u/(w_avg R)
LIMITS = {
    "w_avg*mu_x": U / R,
    "w_avg^2*mu_x": 0.0,
    "w_avg^2*mu_x^2": U**2 / R**2,
    "(mu_x^2 + mu_y^2)*w_avg^2": (U**2 + V**2) / R**2,
    "(mu_x^2 + mu_z)*w_avg^2": U**2 / R**2,
    "(mu_x^2 + mu_y^2)^0.5*wavg": (U**2 + V**2) ** 0.5 / R,
    "|mu_y|*w_avg": abs(V) / R,
    "U_p*mu_x": 0.0,
    "w_avg^2*(mu_x*mu_z)^1": U * W / R**2,
    "w_tot^2*u/w_tot^2": U,
    "w2_1/w1*v": 0.0,
    "d_w_tot*w_avg*mu_z": -4 * HOVER * W / R,
}
POLES = ["mu_x", "w_avg^2*mu_x^3", "U_q/w_tot", "w_tot*mu_z", "u/w1"]


def columns(speeds):
    rows = len(speeds)
    return {k: np.full(rows, v) for k, v in SPEEDS.items()} | {f"w{i + 1}": speeds[:, i] for i in range(4)}


@pytest.mark.parametrize("text", LIMITS)
def test_regressors_take_the_limit_that_was_derived_by_hand(text):
    tree = remove_singularities(parse(text), R)
    variables = Variables(columns(np.zeros((1, 4))), AIRFRAME, HOVER)
    assert evaluate(tree, variables.__getitem__)[0] == pytest.approx(LIMITS[text], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("text", [*LIMITS, *POLES])
def test_regressors_keep_their_values_in_flight(text):
    speeds = np.random.default_rng(0).uniform(200.0, 900.0, (50, 4))
    variables = Variables(columns(speeds), AIRFRAME, HOVER)
    plain = Program([parse(text)]).run(variables.__getitem__, 50)
    found = Program([remove_singularities(parse(text), R)]).run(variables.__getitem__, 50)
    np.testing.assert_allclose(found, plain, rtol=1e-12)


def test_a_limit_agrees_with_exact_arithmetic_at_vanishing_speed():
    # w_avg^2 (mu_x^2 + mu_z) with rational numbers: no rounding hides a term
    radius, u, w, speed = Fraction(1, 16), Fraction(3, 2), Fraction(1, 2), Fraction(1, 10**18)
    exact = speed**2 * ((u / (speed * radius)) ** 2 + w / (speed * radius))
    variables = Variables(columns(np.zeros((1, 4))), AIRFRAME, HOVER)
    tree = remove_singularities(parse("w_avg^2*(mu_x^2 + mu_z)"), float(radius))
    assert evaluate(tree, variables.__getitem__)[0] == pytest.approx(float(exact), rel=1e-12)


def test_expressions_without_division_are_left_alone():
    for text in ("(w_tot)*(u^(1.0))", "|U_p|^0.5*q", "u*v - 2", "q/(1 + r^2)"):
        tree = parse(text)
        assert remove_singularities(tree, R) == tree


def test_a_pole_is_held_at_the_lowest_flown_speed():
    slowest = [400.0, 300.0, 350.0, 500.0]
    floor = np.sqrt(np.mean(np.square(slowest)))
    variables = Variables(columns(np.array([[0.0] * 4, slowest])), AIRFRAME, HOVER, slowest=slowest)
    np.testing.assert_allclose(variables["mu_x"], U / (floor * R))
    assert set(names(remove_singularities(parse("w_avg*mu_x^2"), R))) == {"w_avg_flown", "u"}
    unknown = Variables(columns(np.zeros((1, 4))), AIRFRAME, HOVER)
    assert unknown["mu_x"][0] == pytest.approx(U / (MIN_DENOMINATOR_SPEED * R))


TERMS = {
    "Fx": {"w_avg*mu_x": -0.01, "w_avg^2*mu_x^3": 1e-6, "u": -0.1},
    "Fy": {"mu_y^2*w_avg^2": 1e-4, "w_tot*mu_y": -1e-2},
    "Fz": {"w2_1 + w2_2 + w2_3 + w2_4": -1.3e-6, "(mu_x^2 + mu_y^2)*w_avg^2": 1e-4, "d_w_tot*mu_z": 1e-4},
    "Mx": {"U_p": 1e-7, "U_p*mu_x": 1e-7, "w_avg*p": -1e-6},
    "My": {"U_q": 1e-7, "U_q*mu_z/w_avg": 1e-6, "q": -1e-4},
    "Mz": {"U_r": 2e-8, "|mu_z|*w_avg": 1e-6, "u_r/w_tot*r": 1e-5},
}


@pytest.fixture(scope="module")
def stopped():
    made = model(TERMS)
    at = states_of(made, 40)
    speeds = at.speeds.copy()
    speeds[:20] = 0.0
    speeds[20:24] *= [0.0, 1.0, 0.0, 0.0]  # one rotor turns
    speeds[24:28] = 1e-9
    return made, at._replace(speeds=speeds)


def test_predictions_intervals_and_derivatives_are_finite(stopped):
    made, at = stopped
    forces, moments = made.predict(at.state, at.speeds)
    one = [np.hstack(made.predict(s, w)) for s, w in zip(at.state, at.speeds)]
    np.testing.assert_allclose(np.hstack([forces, moments]), one, rtol=1e-12, atol=1e-15)
    u = at.state[:20, 3]
    cubic = 1e-6 * u**3 / (R**3 * MIN_DENOMINATOR_SPEED)  # the pole, at the limit where no flown speed is known
    np.testing.assert_allclose(forces[:20, 0], -0.01 * u / R + cubic - 0.1 * u, rtol=1e-12)
    assert np.isfinite(moments).all()
    for part in made.jacobian(at.state, at.speeds):
        assert np.isfinite(part).all()
    table = {name: at.state[:, k] for k, name in enumerate(made.inputs[:12])}
    table |= {f"w{i + 1}": at.speeds[:, i] for i in range(4)}
    found = made.interval(table)
    assert np.isfinite(found.to_numpy()).all()
    np.testing.assert_allclose(found[["Fx", "Fy", "Fz"]], forces, rtol=1e-9, atol=1e-12)


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_c_and_python_give_the_same(stopped):
    made, at = stopped
    wrench = np.hstack(made.predict(at.state, at.speeds))
    assert isinstance(at, States)
    np.testing.assert_allclose(run_c(made, c_files(made), at).wrench, wrench, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(run_python(made, *python_file(made), at).wrench, wrench, rtol=1e-12, atol=1e-15)


@octave
def test_matlab_gives_the_same(stopped, tmp_path):
    made, at = stopped
    write_matlab(made, tmp_path, None)
    script = "load asked.mat; load modelParams.mat; load droneParams.mat;\n"
    script += "[F, M] = getFM(state, inputs, modelParams, droneParams);\nsave -v6 found.mat F M\n"
    found = run_octave(tmp_path, script, {"state": at.state, "inputs": at.speeds})
    wrench = np.hstack(made.predict(at.state, at.speeds))
    np.testing.assert_allclose(np.hstack([found["F"], found["M"]]), wrench, rtol=1e-12, atol=1e-15)
