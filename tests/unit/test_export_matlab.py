"""The MATLAB export, run in GNU Octave: the same numbers as the model, the same closed loop as the simulator."""

import importlib.util
import io
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from flights import AIRFRAME
from made_model import SHARED, document, part
from scipy.io import loadmat
from test_normalisation import SCHEME, TRUTH

from quasi import attitude
from quasi.errors import ConfigError, DataError, ExpressionError
from quasi.export.agreement import states_of
from quasi.export.matlab import FILES, write_matlab
from quasi.export.matlab_check import check_matlab, find_octave, run_octave
from quasi.export.matlab_terms import axis_file, expression, matlab_name, original_name
from quasi.expressions import Program, parse
from quasi.identification.candidates import read_specification
from quasi.simulation import gains
from quasi.simulation.portable import loop_constants, portable_setup
from quasi.simulation.run import simulate
from quasi.simulation.setup import make_setup
from quasi.standalone.build import assemble
from quasi.standalone.model import Model
from quasi.tables import read_bytes, read_json, read_text, write_json, write_text
from quasi.variables import Variables
from quasi.workflow import Folder

ROOT = Path(__file__).parents[2]
U = ["U_p", "U_q", "U_r"]
octave = pytest.mark.skipif(find_octave() is None, reason="GNU Octave is not installed")

# every production of the grammar, every kind of variable, columns with names that are no identifiers
GRAMMAR = {
    "Fx": ["1", "-u^2", "-(u*v)", "2*u-3*v+1e-3", "u/(v + 20)/(w + 20)", "u/((v + 20)*w_avg)",
           "u*v/(w + 20)*p", "(u + 20)^-1", "(u^2)^3", ".5*|u|*u"],
    "Fy": ["(v + 20)^1.5", "(u^2 + v^2 + w^2)^0.5", "|u|^(v/10)", "2^|u|^0.5", "|v|^0.3^2", "(1 + v/100)^33",
           "v^0", "v^(1.0)", "(u + 20)^-0.5"],
    "Fz": ["w2_1 + w2_2 + w2_3 + w2_4", "wtot", "w_avg", "d_w1 - d_w4", "d_wtot", "mu_x^2 + mu_y^2", "mu_z*|mu_vin|",
           "v_in", "battery_voltage^2", "w1_CMD*w1", "a|b[c]*w", "throttle"],
    "Mx": ["U_p", "p*|p|", "sin[roll]", "cos[pitch]*p", "|sin[roll]|", "yaw*q", "sin[|yaw|]", "u_p", "u_p_dot", "p^3"],
    "My": ["U_q", "q^2/(1 + q^2)", "u_q*q", "u_q_dot", "x*y", "z", "1/(z^2 + 1)", "q/((q + 30)^2)^0.5", "-q^2*-3",
           "(1 + (p*q)^2)^0.5"],
    "Mz": ["U_r", "r", "u_r_dot", "w_tot_dot", "w3_dot", "r*u_r", "|U_r|^0.5", "r^2^0.5", "--r", "((r + 1)^2)^0.5",
           "w1*r - w2*r"],
}  # fmt: skip


def of_terms(expressions, **shared):
    """A model of these terms, {axis: [expression]}, each with a coefficient that makes it of ordinary size."""
    plain = assemble({a: part(a, dict.fromkeys(e, 1.0)) for a, e in expressions.items()}, {**SHARED, **shared},
                     {"id": "m", "airframe": Model(document()).airframe})  # fmt: skip
    model = Model(plain)
    at = states_of(model, 400)
    columns = dict(zip(model.inputs, at.table.T))
    variables = Variables(columns, model.airframe, model.hover_speed)
    for axis, texts in expressions.items():
        values = Program([parse(e) for e in texts]).run(variables.__getitem__, 400)
        for k, term in enumerate(plain["axes"][axis]["terms"]):
            term["coefficient"] = float((-1) ** k * (1 + 0.1 * k) / np.nanmedian(np.abs(values[k])))
    return Model(plain)


def of_pool(name, seed=3):
    """Ten random candidates of a bundled pool in each axis, beside the fixed terms."""
    random = np.random.default_rng(seed)
    pool = read_json(ROOT / f"config/polynomials/{name}.json")
    chosen = {}
    for axis in ("Fx", "Fy", "Fz", "Mx", "My", "Mz"):
        found = read_specification(pool, axis, name)
        few = random.permutation(len(found.candidates))[:10]
        chosen[axis] = list(dict.fromkeys(
            ["1", *(t.expression for t in found.fixed), *(found.candidates[k].expression for k in few)]
        ))  # fmt: skip
    return of_terms(chosen)


def normalised():
    scheme = SCHEME.to_plain()
    parts = {axis: {**part(axis, terms), "normalisation": scheme} for axis, terms in TRUTH.items()}
    return Model(assemble(parts, SHARED, {"id": "m", "airframe": Model(document()).airframe}))


def flown():
    """The made model with rotors that have limits, so that it may be flown."""
    found = document()
    found["airframe"] |= {"motor poles": 14, "idle RPM": 400.0, "max RPM": 750.0}
    found["actuators"] = {"time constants": {"value": [0.03, 0.03, 0.03, 0.03]}, "delay": {"value": 0.006}}
    return Model(found)


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


def sine(dt, duration):
    """The reference of main.m as a table."""
    t = np.arange(round(duration / dt) + 1) * dt
    turn, o = 2 * np.pi / 5, np.zeros(len(t))
    return {
        "t": t, "x": o, "y": 5 * np.sin(turn * t), "z": o - 2, "yaw": o, "vx": o, "vy": 5 * turn * np.cos(turn * t),
        "vz": o, "ax": o, "ay": -5 * turn**2 * np.sin(turn * t), "az": o,
    }  # fmt: skip


@octave
def test_main_flies_the_loop_of_the_simulator(tmp_path):
    model, dt, duration = flown(), 0.004, 5.0
    loop = loop_constants(portable_setup(model))
    write_matlab(model, tmp_path, U, loop)
    main = read_text(tmp_path / "main.m").replace("Tmax = 15;", f"Tmax = {duration};")
    main = main.replace("plotTrajectory(simdata, droneParams);", "error('nothing to draw on');")
    main += "save('-v7', 'found.mat', 'simdata');\n"
    write_text(tmp_path / "short_main.m", main)
    found = run_octave(tmp_path, "short_main;")["simdata"]

    start = {"position": [1, 0, 0], "rotor speeds": [loop["lowest"]] * 4}
    setup = make_setup(
        {"model": {"model ID": "m"}, "simulation": {"time step": dt, "duration": duration},
         "controller": {"controller": "drone_INDI"}, "noise": {"add": False}, "initial state conditions": start,
         "references": {"kind": "table", "file": "-", "interpolation": "steps"}},
        model, reference=sine(dt, duration),
    )  # fmt: skip
    result = simulate(setup)
    assert result.stopped is None and setup.machine.drive.delay == 0.006
    columns = {
        "state": ["roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z"],
        "omega": ["w1", "w2", "w3", "w4"],
        "omegaCommand": ["w1_CMD", "w2_CMD", "w3_CMD", "w4_CMD"], "force": ["Fx", "Fy", "Fz"],
        "moment": ["Mx", "My", "Mz"], "quaternion": ["qw", "qx", "qy", "qz"],
    }  # fmt: skip
    for field, names in columns.items():
        assert np.abs(getattr(found, field) - result.table[names].to_numpy()).max() < 1e-6, field
    # the limits of the rotors were met, and the manual's example was flown
    commands = result.table[columns["omegaCommand"]].to_numpy()
    assert commands.max() > 0.999 * loop["highest"]
    assert np.abs(found.state[-1, 9:] - [0.0, 0.0, -2.0]).max() < 0.3


def net():
    """The made model with gravity in its forces, thrust that grows with the voltage, and limits to its rotors."""
    voltage = {"min": 14.0, "max": 16.0, "percentiles": {"50": 15.0}}
    found = flown().document | {"gravity": "noGravity", "envelope": {"battery_voltage": voltage}}
    weight = AIRFRAME.mass * 9.81
    for axis, text, value in (
        ("Fx", "sin[pitch]", -weight), ("Fy", "sin[roll]*cos[pitch]", weight), ("Fz", "cos[roll]*cos[pitch]", weight)
    ):  # fmt: skip
        term = {"name": "weight", "expression": text, "coefficient": value, "std": 0, "unit": "N", "given": True}
        found["axes"][axis]["terms"].append(term)
    found["axes"]["Fz"]["terms"][0]["expression"] = "w_avg^2*battery_voltage/15*4"
    return Model(found)


@octave
@pytest.mark.parametrize("make", [flown, net])
def test_the_blocks_follow_other_settings_of_the_simulator(make, tmp_path):
    # Euler, substeps, wind, no lag, an integral, the plain inverse, net forces: what the example does not reach
    model = make()
    base = {
        "model": {"model ID": "m"},
        "simulation": {"time step": 0.01, "duration": 1.0, "integrator": "euler", "substeps": 2},
        "controller": {"controller": "drone_INDI", "allocation": {"method": "inverse"}}, "noise": {"add": False},
        "actuator": {"actuator": "rotorDynamicsV1"}, "wind": {"steady": [2.0, -1.0, 0.5]},
        "references": {"kind": "position steps", "steps": [[0, 3, -2, -1, 0.7], [0.5, 0, 0, 0, -0.7]]},
    }  # fmt: skip
    setup = make_setup(base, model)
    setup.machine.gains[gains.VELOCITY_INTEGRAL] = 0.8
    write_matlab(model, tmp_path, None, loop_constants(setup))
    script = """addpath('simulation');
[modelParams, droneParams] = model_init('m');
simParams = simParameters();
reference.time = [0; 0.5];
reference.signals.values = [3 -2 -1 0.7; 0 0 0 -0.7];
omega = [%r %r %r %r];
simdata = simulateQuadrotor(1, simParams.dt, zeros(12, 1), omega, reference, modelParams, droneParams, simParams);
save('-v7', 'found.mat', 'simdata');
"""
    found = run_octave(tmp_path, script % tuple(float(w) for w in setup.start[13:]))["simdata"]
    table = simulate(setup).table
    assert np.ptp(table["x"]) > 0.1
    assert np.abs(found.state[:, 3:] - table[["u", "v", "w", "p", "q", "r", "x", "y", "z"]].to_numpy()).max() < 1e-9
    assert np.abs(found.omegaCommand - table[[f"w{i}_CMD" for i in range(1, 5)]].to_numpy()).max() < 1e-6


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


def test_brackets_deeper_than_matlab_reads_are_refused(tmp_path):
    found = document()
    found["axes"]["Fx"]["terms"][0]["expression"] = "(u + v*" * 29 + "w" + ")" * 29
    with pytest.raises(ConfigError, match="Fx: term .* nests brackets deeper than MATLAB reads"):
        write_matlab(Model(found), tmp_path, None)
    assert not list(tmp_path.iterdir())


@octave
def test_the_trajectory_is_drawn_unmirrored(tmp_path):
    # functions that draw are replaced by ones that note what they are given
    write_matlab(flown(), tmp_path, None, loop_constants(portable_setup(flown())))
    for name in ("figure", "hold", "grid", "axis", "view", "xlabel", "ylabel", "zlabel", "legend"):
        write_text(tmp_path / f"{name}.m", f"function {name}(varargin)\nend\n")
    note = "function plot3(x, y, z, varargin)\nglobal drawn\ndrawn{end + 1} = [x(:) y(:) z(:)];\nend\n"
    write_text(tmp_path / "plot3.m", note)
    script = """warning('off', 'all');
addpath('simulation');
global drawn
drawn = {};
[m, d] = model_init();
simdata.state = [zeros(2, 9), [1 2 -3; 4 6 -5]];
simdata.reference = [7 8 -9 0; 7 8 -9 0];
simdata.quaternion = [1 0 0 0; 1 0 0 0];
plotTrajectory(simdata, d);
save('-v7', 'found.mat', 'drawn');
"""
    drawn = run_octave(tmp_path, script)["drawn"]
    assert np.array_equal(drawn[0], [[8, 7, 9], [8, 7, 9]])  # east, north, height
    assert np.array_equal(drawn[1], [[2, 1, 3], [6, 4, 5]])
    first, second = drawn[2][1] - drawn[2][0], drawn[3][1] - drawn[3][0]
    # rotors 1 and 2 are those at the back and in front on the right: east of the centre, rotor 2 further north
    assert first[0] > 0 > first[1] and second[0] > 0 and second[1] > 0 and len(drawn) == 2 + 12 * 4


@octave
@pytest.mark.parametrize(("change", "says"), [
    ("reference.signals.values = zeros(3, 4);", "reference.signals.values is 3 x 4, expected 2 x 4"),
    ("start = zeros(11, 1);", "must be 12 finite numbers"),
    ("start(3) = NaN;", "must be 12 finite numbers"),
    ("start(7) = 400;", "diverged at t = 0 s"),
])  # fmt: skip
def test_a_simulation_that_cannot_be_is_refused(change, says, tmp_path):
    write_matlab(flown(), tmp_path, None, loop_constants(portable_setup(flown())))
    script = f"""addpath('simulation');
[m, d] = model_init();
reference.time = [0; 1];
reference.signals.values = zeros(2, 4);
start = zeros(12, 1);
{change}
simulateQuadrotor(0.02, 0.004, start, 900*ones(4, 1), reference, m, d, simParameters());
"""
    with pytest.raises(DataError, match=re.escape(says)):
        run_octave(tmp_path, script)


@octave
def test_helpers_follow_the_conventions(tmp_path):
    random = np.random.default_rng(4)
    angles = random.uniform(-1.4, 1.4, (50, 3)) * [2.0, 1.0, 2.0]
    vectors, rates = random.normal(size=(50, 3)), random.normal(size=(50, 3))
    q = attitude.from_euler(*angles.T)
    other = attitude.normalise(random.normal(size=(50, 4)))
    write_matlab(Model(document()), tmp_path, None)
    script = """load('asked.mat');
r.q = Eul2Quat(angles);
r.angles = Quat2Eul(q);
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
    r = run_octave(tmp_path, script, {"angles": angles, "q": q, "other": other, "vectors": vectors, "rates": rates})[
        "r"
    ]
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


def test_parameters_keep_logged_limits_with_their_factor(tmp_path):
    model = flown()
    write_matlab(model, tmp_path, U)
    load = lambda name: loadmat(io.BytesIO(read_bytes(tmp_path / f"{name}.mat")), squeeze_me=True,  # noqa: E731
                                struct_as_record=False)[name]  # fmt: skip
    drone, about = load("droneParams"), load("modelParams")
    assert (drone.minRPM, drone.maxRPM) == (400.0, 750.0)
    assert drone.loggedToRadS == pytest.approx(100 * 2 * np.pi / 60 / 7)
    assert drone.wHover / drone.wHoverERPM == pytest.approx(drone.loggedToRadS)
    assert np.array_equal(drone.signMask, [[-1, -1, 1, 1], [-1, 1, -1, 1], [1, -1, -1, 1]])
    assert np.array_equal(drone.Iv, model.airframe.inertia) and drone.taus.shape == (4,)
    assert about.modelID == "m" and about.hasGravity == 1 and about.isNormalized == 0
    assert list(about.DiffSysInputs) == U


def test_only_what_matlab_and_octave_share_is_written(tmp_path):
    loop = loop_constants(portable_setup(flown()))
    write_matlab(flown(), tmp_path, U, loop)
    for path in tmp_path.rglob("*.m"):
        for line in read_text(path).splitlines():
            code = re.sub(r"'[^']*'", "''", line.split("%")[0]) if "fprintf" not in line else ""
            assert not re.search(
                r'["#!]|\+\+|\+=|-=|\*=|\bend(function|if|for|while)\b|\bprintf\b|\bdo\b|\buntil\b', code
            ), f"{path.name}: {line}"
            assert len(line) <= 120 or path.name.startswith(("get_", "simParameters")), f"{path.name}: {line}"
        first = read_text(path).splitlines()[0]
        assert path.name == "main.m" or re.search(rf"\b{path.stem}\(", first), path.name


def test_every_expression_is_made_of_known_parts():
    for texts in GRAMMAR.values():
        for text in texts:
            shown = expression(parse(text))
            calls = set(re.findall(r"([A-Za-z_]\w*)\(", shown))
            assert calls <= {"abs", "sin", "cos", "rootOf", "powerOf"}, shown
    assert expression(parse("-u^2")) == "-(u.^2)" or expression(parse("-u^2")) == "-u.^2"
    assert expression(parse("u/v/w")) == "u./v./w"
    assert expression(parse("u^-2")) == "1./(u.^2)"


NAMES = ["end", "function", "pi", "abs", "_x", "a|b", "a[b]", "x_y", "x__", "_x5f_", "rootOf", "n1", "d", "Fx", "ans"]


def test_other_names_become_identifiers_and_back():
    made = [matlab_name(name) for name in NAMES]
    assert [original_name(m) for m in made] == NAMES
    assert len(set(made)) == len(NAMES) and all(re.fullmatch(r"x_\w+", m) for m in made)
    assert matlab_name("battery_voltage") == "battery_voltage" == original_name("battery_voltage")
    with pytest.raises(ConfigError, match="of 72 characters, of which 63"):
        matlab_name("a" * 70)


@octave
def test_columns_of_any_name_keep_their_numbers(tmp_path):
    model = of_terms({"Fx": [f"{name}*u" for name in NAMES], "Mx": ["U_p"], "My": ["U_q"], "Mz": ["U_r", "end*r"]})
    write_matlab(model, tmp_path, U)
    assert max(c.largest for c in check_matlab(model, tmp_path, U)) <= 1e-12


HOSTILE = "a\n%{\nsystem('touch planted');\nquit\n%}\r'); system('touch planted'); %"


@octave
def test_text_of_a_model_stays_in_comments(tmp_path):
    found = document()
    found["airframe"]["name"] = HOSTILE
    for section in found["axes"].values():
        for term in section["terms"]:
            term["name"] = term["unit"] = HOSTILE
    model = Model(found)
    write_matlab(model, tmp_path, U)
    assert max(c.largest for c in check_matlab(model, tmp_path, U)) <= 1e-12
    assert not list(tmp_path.rglob("planted"))
    for line in axis_file(model, "Fx").splitlines():
        assert "system" not in line.split("%")[0]


@pytest.mark.parametrize("name", ["../evil", "a'b", "a\nb", "a;b", "$(touch x)"])
def test_a_model_id_that_leads_elsewhere_is_refused(name):
    with pytest.raises(ConfigError, match="'id' is"):
        Model({**document(), "id": name})


def test_regressors_with_code_are_refused():
    for text in ("system('x')", "u;quit", "u'", "getFM(u)", "u\n+v;quit", "@u", "u.v"):
        with pytest.raises(ExpressionError):
            found = document()
            found["axes"]["Fx"]["terms"][0]["expression"] = text
            Model(found)


def test_a_simulation_that_cannot_be_flown_says_why():
    found = document()
    found["axes"]["Fx"]["terms"][0]["expression"] = "v_in*u"
    with pytest.raises(ConfigError, match="terms in 'v_in', which a simulation cannot know"):
        portable_setup(Model(found))
    noisy = make_setup({"model": {"model ID": "m"}, "controller": {"controller": "drone_INDI"}}, flown())
    with pytest.raises(ConfigError, match="sensor noise cannot be exported"):
        loop_constants(noisy)
    other = {"model": {"model ID": "m"}, "noise": {"add": False}, "controller": {"controller": "drone_PID"}}
    with pytest.raises(ConfigError, match="the controller PID cannot be exported"):
        loop_constants(make_setup(other, flown()))


def test_extensions_with_states_are_refused_by_name(tmp_path):
    found = {**document(), "extensions": [{"id": "slung_load", "states": ["swing"]}]}
    with pytest.raises(ConfigError, match="slung_load"):
        write_matlab(Model(found), tmp_path, U)
    assert not list(tmp_path.iterdir())


def test_the_fixed_files_are_copied_as_they_stand(tmp_path):
    write_matlab(flown(), tmp_path, U, loop_constants(portable_setup(flown())))
    for path in FILES.rglob("*.m"):
        assert read_text(tmp_path / path.relative_to(FILES)) == read_text(path)
    assert shutil.which("sh")  # the folder is plain files: nothing of ours is needed to use it


def export(document, folder, settings=None):
    script = load_script("export_matlab")
    write_json(folder / "model.json", document)
    script.main(str(folder / "model.json"), settings or {"file": None, "u": U}, str(folder / "matlab"))
    return read_json(folder / "matlab/agreement.json"), {p.name for p in (folder / "matlab").iterdir()}


def load_script(name):
    found = importlib.util.spec_from_file_location(name, ROOT / f"scripts/{name}.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


@octave
def test_the_job_compares_and_says_what_is_left_out(tmp_path, capsys):
    found = flown().document
    found["axes"]["Fx"]["terms"][0]["expression"] = "v_in*u"
    report, files = export(found, tmp_path)
    assert report["agrees"] is True and [c["rows"] for c in report["checks"]] == [10_000, 10_000]
    (note,) = [n for n in report["notes"] if "left out" in n]
    assert "simulation environment" in note and "'v_in'" in note
    assert "getFM.m" in files and "main.m" not in files and "simulation" not in files
    assert note in capsys.readouterr().out


def test_without_octave_nothing_is_claimed(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("OCTAVE", raising=False)
    report, files = export(flown().document, tmp_path, {"file": None, "u": None})
    assert report["agrees"] is None and "GNU Octave was not found" in report["notes"][-1]
    assert {"main.m", "simulation", "check_model.m", "reference.mat"} <= files and "get_PQRDiffSys.m" not in files


def test_the_configuration_chooses_the_differential_form(tmp_path):
    folder = Folder(tmp_path)
    assert folder.matlab("imported")["u"] == U
    for section, u in (({}, ["U_p"]), ({"DiffSys u": ["w1"]}, ["w1"]), ({"make moment DiffSys": False}, None)):
        (tmp_path / "config/models").mkdir(parents=True, exist_ok=True)
        config = read_json(ROOT / "config/models/example.json")
        config["matlab"] = {"model ID": "X", "droneConfig path": "data", **section}
        config["standalone"] = {"DiffSys u": ["U_p"]}
        write_json(tmp_path / "config/models/X.json", config)
        assert Folder(tmp_path).matlab("X") == {"file": "config/models/X.json", "u": u}
    config["matlab"] = {"DiffSys": True}
    write_json(tmp_path / "config/models/X.json", config)
    with pytest.raises(ConfigError, match="'DiffSys'.*did you mean 'DiffSys u'"):
        Folder(tmp_path).matlab("X")
