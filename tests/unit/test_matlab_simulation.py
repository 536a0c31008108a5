"""The MATLAB export's simulation environment, run in GNU Octave: the same closed loop as the simulator."""

import re

import numpy as np
import pytest
from flights import AIRFRAME
from made_model import document
from matlab_models import U, flown, octave

from quasi.errors import ConfigError, DataError
from quasi.export.matlab import write_matlab
from quasi.export.matlab_check import run_octave
from quasi.model.model import Model
from quasi.simulation.control.parameters import VELOCITY_INTEGRAL_GAIN
from quasi.simulation.loop.run import simulate
from quasi.simulation.loop.setup import make_setup
from quasi.simulation.tools.portable import loop_constants, portable_setup
from quasi.tables import read_text, write_text


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
    model, dt, duration = flown(), 0.004, 2.5  # s, half a turn of the sine
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
    assert result.stopped is None and setup.loop_parameters.drive.delay == 0.006
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
    # the sine passes at 6 m/s there
    assert np.all(np.abs(found.state[-1, 9:] - [0.0, 0.0, -2.0]) < [0.3, 0.8, 0.3])


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


def air():
    """The made model with velocity through the air under both of its names."""
    found = flown().document
    term = {"name": "drag", "expression": "u_air", "coefficient": -0.2, "std": 0, "unit": "N s/m", "given": True}
    found["axes"]["Fx"]["terms"].append(term)
    return Model(found)


@octave
@pytest.mark.parametrize("make", [flown, net, air])
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
    setup.loop_parameters.gains[VELOCITY_INTEGRAL_GAIN] = 0.8
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


def test_a_simulation_that_cannot_be_flown_says_why():
    found = document()
    found["axes"]["Fx"]["terms"][0]["expression"] = "v_in*u"
    with pytest.raises(ConfigError, match="terms in 'v_in', which a simulation cannot provide"):
        portable_setup(Model(found))
    noisy = make_setup({"model": {"model ID": "m"}, "controller": {"controller": "drone_INDI"}}, flown())
    with pytest.raises(ConfigError, match="sensor noise cannot be exported"):
        loop_constants(noisy)
    other = {"model": {"model ID": "m"}, "noise": {"add": False}, "controller": {"controller": "drone_PID"}}
    with pytest.raises(ConfigError, match="the controller PID cannot be exported"):
        loop_constants(make_setup(other, flown()))
