"""The MATLAB export's model functions, run in GNU Octave: the same numbers as the model, and calls that are refused."""

import re

import numpy as np
import pytest
from export_models import MODELS as EXPORTED
from flights import AIRFRAME
from made_model import document
from matlab_models import GRAMMAR, U, normalised, octave, of_pool, of_terms

from quasi import attitude
from quasi.errors import ConfigError, DataError
from quasi.export.matlab import write_matlab
from quasi.export.matlab_check import check_matlab, run_octave
from quasi.export.matlab_terms import EXTRA, matlab_name
from quasi.export.naming import name_of
from quasi.model.model import Model
from quasi.tables import read_text, write_text

# "without values": rows whose powers and quotients have none give NaN and Inf in the same places
MODELS = {
    "made": lambda: Model(document()),
    "without values": lambda: of_terms(
        {
            "Fx": ["u^1.5", "u"],
            "Fy": ["v^w", "1/p"],
            "Fz": ["(u*v)^0.5", "w_tot^2"],
            "Mx": ["U_p", "(p^2 - 4)^-0.5"],
            "My": ["U_q", "q^-1"],
            "Mz": ["U_r", "|r|^0.5"],
        }
    ),
    "grammar": lambda: of_terms(GRAMMAR),
    "physical": lambda: of_pool("physical_large"),
    "quadratic": lambda: of_pool("polyCands_DiffSys_quadraticU_symmetric_SIMPLE_FM"),
    "normalised": normalised,
    "air": EXPORTED["air"],
}


@octave
@pytest.mark.parametrize("name", MODELS)
def test_forces_moments_and_differential_form_are_those_of_the_model(name, tmp_path):
    model = MODELS[name]()
    written = write_matlab(model, tmp_path, U)
    assert written.u == tuple(U) and not written.notes
    checks = check_matlab(model, tmp_path, U)
    assert [c.rows for c in checks] == [10_000, 10_000]
    assert max(c.largest for c in checks) <= 1e-12, checks


@octave
@pytest.mark.parametrize(("file", "old", "new"), [
    ("get_Fz.m", "Fz + (", "Fz - ("), ("get_Mx.m", "Mx + (", "Mx - ("),
    ("getDroneInputs.m", "d.u_r = s(1)", "d.u_r = -s(1)"),
    ("get_PQRDiffSys.m", "dMdx(1, 1, :) = -", "dMdx(1, 1, :) = "),
    ("get_PQRDiffSys.m", "slopes = dMdx - turn", "slopes = dMdx + turn"),
])  # fmt: skip
def test_a_wrong_sign_is_found_by_both_checks(file, old, new, tmp_path):
    model = Model(document())
    write_matlab(model, tmp_path, U)
    text = read_text(tmp_path / file)
    assert old in text
    write_text(tmp_path / file, text.replace(old, new, 1))
    assert max(c.largest for c in check_matlab(model, tmp_path, U)) > 1e-4
    with pytest.raises(DataError, match="differs by"):
        run_octave(tmp_path, "check_model();")
    write_text(tmp_path / file, text)
    run_octave(tmp_path, "check_model();")


@octave
def test_the_simple_model_maps_forces_to_rotor_speeds(tmp_path):
    simple = {"kappaFz": 1.3e-6, "kappaMx": 1e-7, "kappaMy": 1.1e-7, "kappaMz": 2e-8}
    found = document() | {"simple model": {k: {"value": v} for k, v in simple.items()}}
    write_matlab(Model(found), tmp_path, None)
    script = "[m, d] = model_init();\nsquares = d.FM2OmegaMapping*[0.01 0.02 0.003 -4]';\n"
    script += "save('-v7', 'found.mat', 'squares');"
    squares = run_octave(tmp_path, script)["squares"]
    assert AIRFRAME.left @ squares * 1e-7 == pytest.approx(0.01)
    assert AIRFRAME.front @ squares * 1.1e-7 == pytest.approx(0.02)
    assert AIRFRAME.spin @ squares * 2e-8 == pytest.approx(0.003)
    assert -1.3e-6 * squares.sum() == pytest.approx(-4)


@octave
def test_helpers_follow_the_conventions(tmp_path):
    random = np.random.default_rng(4)
    angles = random.uniform(-1.4, 1.4, (50, 3)) * [2.0, 1.0, 2.0]
    vectors, rates = random.normal(size=(50, 3)), random.normal(size=(50, 3))
    q = attitude.from_euler(*angles.T)
    other = attitude.normalise(random.normal(size=(50, 4)))
    up = attitude.from_euler(angles[:, 0], np.repeat([np.pi / 2, -np.pi / 2], 25), angles[:, 2])
    write_matlab(Model(document()), tmp_path, None)
    script = """load('asked.mat');
r.q = Eul2Quat(angles);
r.angles = Quat2Eul(q);
r.poles = Quat2Eul(upright);
r.product = QuatMul(q, other);
r.earth = QuatRot(q, vectors);
r.body = QuatRot(QuatConj(q), vectors);
r.euler = BodyRates2EulerRates(angles, rates);
r.back = EulerRates2BodyRates(angles, r.euler);
r.wrapped = wrapAngle([pi -pi 3*pi -3*pi 4 -4 0 NaN]);
r.power = powerOf([-8 -8 4 0 NaN], [1/3 2 0.5 -1 2]);
r.root = rootOf([-1 4 NaN]);
r.log = logOf([-1 0 exp(1)]);
save('-v7', 'found.mat', 'r');
"""
    r = run_octave(tmp_path, script, {"angles": angles, "q": q, "other": other, "vectors": vectors, "rates": rates,
                                   "upright": up})["r"]  # fmt: skip
    assert np.allclose(attitude.matrix(attitude.from_euler(*r.poles.T)), attitude.matrix(up), atol=1e-7)
    assert np.allclose(r.q * np.sign(np.sum(r.q * q, axis=1))[:, None], q, atol=1e-14)
    assert np.allclose(r.angles, angles, atol=1e-13)
    assert np.allclose(r.product, attitude.multiply(q, other), atol=1e-14)
    assert np.allclose(r.earth, attitude.rotate(q, vectors), atol=1e-14)
    assert np.allclose(r.body, attitude.rotate_inverse(q, vectors), atol=1e-14)
    # body rates turn the quaternion by q (0, omega)/2: the angles of a short step show their rates
    step = 1e-6
    turned = attitude.normalise(q + step * 0.5 * attitude.multiply(q, np.column_stack([np.zeros(50), rates])))
    assert np.allclose(r.euler, (attitude.to_euler(turned) - angles) / step, atol=1e-3)
    assert np.allclose(r.back, rates, atol=1e-12)
    assert np.allclose(
        r.wrapped, [np.pi, -np.pi, -np.pi, np.pi, 4 - 2 * np.pi, 2 * np.pi - 4, 0, np.nan], equal_nan=True
    )
    assert np.array_equal(r.power, [np.nan, 64, 2, np.inf, np.nan], equal_nan=True)
    assert np.array_equal(r.root, [np.nan, 2, np.nan], equal_nan=True)
    assert np.allclose(r.log, [np.nan, -np.inf, 1], equal_nan=True)


@octave
def test_one_column_no_position_and_missing_axes(tmp_path):
    found = document()
    found["axes"] = {axis: found["axes"][axis] for axis in ("Fz", "Mx", "My")}
    model = Model(found)
    written = write_matlab(model, tmp_path, U)
    assert written.u is None and "lacks Mz" in written.notes[0]
    script = """[m, d] = model_init();
state = [0 0 0 1 2 3 0.1 0.2 0.3]';
[F, M] = getFM([state; 0; 0; 0], [900 910 920 930]', m, d);
[G, N] = getFM(repmat(state', 3, 1), repmat([900 910 920 930], 3, 1), m, d);
save('-v7', 'found.mat', 'F', 'M', 'G', 'N');
"""
    got = run_octave(tmp_path, script)
    forces, moments = model.predict([0, 0, 0, 1, 2, 3, 0.1, 0.2, 0.3], [900, 910, 920, 930])
    assert np.allclose(got["F"], forces, rtol=1e-13, equal_nan=True) and np.isnan(got["F"][0])
    assert np.allclose(got["N"], np.tile(moments, (3, 1)), rtol=1e-13, equal_nan=True)
    assert got["G"].shape == (3, 3) and not (tmp_path / "get_Fx.m").exists()


@octave
@pytest.mark.parametrize(("call", "says"), [
    ("getFM(zeros(5, 12), zeros(4, 4), m, d, e)", "expected 5 x 4 rotor speeds"),
    ("getFM(zeros(5, 11), zeros(5, 4), m, d, e)", "expected N x 12"),
    ("getFM(zeros(5, 9), ones(5, 4), m, d, e)", "terms in the position"),
    ("getFM(zeros(5, 12), ones(5, 4), m, d)", "terms in a|b[c]; give it as extra.x_a_x7c_b_x5b_c_x5d_"),
    ("getFM(zeros(5, 12), ones(5, 4), m, d, setfield(e, 'v_in', [1 2]))", "extra.v_in has 2 values, expected one or 5"),
    ("getFM(zeros(5, 12), ones(5, 4), m, d, setfield(e, 'w1_dot', 1))", "some rotor accelerations"),
    ("model_init('other')", "holds model m, not other"),
])  # fmt: skip
def test_wrong_calls_are_answered_in_a_sentence(call, says, wrong_calls):
    with pytest.raises(DataError, match=re.escape(says)):
        run_octave(wrong_calls, f"[m, d] = model_init();\ne = struct('v_in', 1, 'battery_voltage', 15, 'w1_CMD', 1, "
                                f"'throttle', 1, 'x_a_x7c_b_x5b_c_x5d_', 1);\n{call};")  # fmt: skip


@pytest.fixture(scope="module")
def wrong_calls(tmp_path_factory):
    folder = tmp_path_factory.mktemp("matlab")
    write_matlab(of_terms(GRAMMAR), folder, U)
    return folder


NAMES = ["end", "function", "pi", "abs", "_x", "a|b", "a[b]", "x_y", "x__", "_x5f_", "rootOf", "n1", "d", "Fx", "ans"]


def test_other_names_become_identifiers_and_back():
    made = [matlab_name(name) for name in NAMES]
    assert [name_of(m, EXTRA) for m in made] == NAMES
    assert len(set(made)) == len(NAMES) and all(re.fullmatch(r"x_\w+", m) for m in made)
    assert matlab_name("battery_voltage") == "battery_voltage"
    with pytest.raises(ConfigError, match="of 72 characters, of which 63"):
        matlab_name("a" * 70)


@octave
def test_columns_of_any_name_keep_their_numbers(tmp_path):
    model = of_terms({"Fx": [f"{name}*u" for name in NAMES], "Mx": ["U_p"], "My": ["U_q"], "Mz": ["U_r", "end*r"]})
    write_matlab(model, tmp_path, U)
    assert max(c.largest for c in check_matlab(model, tmp_path, U)) <= 1e-12
