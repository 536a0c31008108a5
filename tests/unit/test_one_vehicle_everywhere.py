"""One vehicle in simulator, replay, plans, exports and comparisons: the same limits, battery, weight and errors."""

import copy

import numpy as np
import pandas as pd
import pytest
from flights import AIRFRAME
from made_model import document
from matlab_models import flown, octave

from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.export.contents import voltage_of
from quasi.export.matlab import write_matlab
from quasi.export.matlab_check import run_octave
from quasi.gap.catalogue import catalogue
from quasi.gap.comparing.model_comparison import compare_models
from quasi.gap.levels.rollouts.open_loop import ERROR_UNITS, MOVED_BY, fell, rms
from quasi.gap.planning.flatness import limits_of
from quasi.gap.report.wording import rivals_words
from quasi.model.extensions import actuators_of
from quasi.model.hover import find_hover_speed
from quasi.model.model import AXES, Model
from quasi.pages.model import _render_rotors
from quasi.simulation.control.control_model import make_control_model
from quasi.simulation.control.references import evaluate_reference, make_reference
from quasi.simulation.loop.run import simulate, simulate_many
from quasi.simulation.loop.setup import make_setup
from quasi.simulation.tools.portable import loop_constants
from quasi.simulation.tools.replay import read_actuator_dynamics, replay
from quasi.simulation.vehicle.variants import apply_extensions

QUIET = {"model": {"model ID": "m"}, "noise": {"add": False}}


def made(**more):
    found = copy.deepcopy(document())
    found["airframe"] |= {"motor poles": 14, "idle RPM": 50, "max RPM": 2500}
    return Model(found | more)


def net():
    """The made model with its weight in its forces."""
    found, weight = copy.deepcopy(document()) | {"gravity": "noGravity"}, AIRFRAME.mass * 9.81
    texts = {"Fx": ("sin[pitch]", -weight), "Fy": ("sin[roll]*cos[pitch]", weight)}
    for axis, (text, value) in (texts | {"Fz": ("cos[roll]*cos[pitch]", weight)}).items():
        term = {"name": "weight", "expression": text, "coefficient": value, "std": 0, "unit": "N", "given": True}
        found["axes"][axis]["terms"].append(term)
    return Model(found)


def test_limits_are_those_of_true_speeds_wherever_they_are_read():
    plain, scaled = made(), made(extensions=[{"id": "scale", "actuators": {"rotor speed scale": 1.1}}])
    for model, factor in ((plain, 1.0), (scaled, 1.1)):
        high = 2500 * model.airframe.logged_to_rad_s / factor
        found = [
            read_actuator_dynamics(model).highest, actuators_of(model).highest, limits_of(model)[1],
            make_setup(QUIET, model).loop_parameters.drive.high, make_control_model(model).highest,
        ]  # fmt: skip
        assert found == pytest.approx([high] * 5)


def test_an_extensions_exponent_holds_at_its_own_voltage_in_exports_too():
    covered = {"battery_voltage": {"min": 14.0, "max": 16.0, "percentiles": {"50": 15.0}}}
    sag = {"id": "battery_sag", "actuators": {"voltage exponent": 0.8, "reference voltage": 16.0}}
    model = made(extensions=[sag], envelope=covered)
    found = voltage_of(model)
    battery = make_setup({**QUIET, "battery": {"voltage": 15.0}}, model).loop_parameters.battery
    assert (found.start, found.reference, found.exponent) == (15.0, 16.0, 0.8) and battery.reference == 16.0


@pytest.mark.parametrize("make", [lambda: Model(document()), net])
def test_twice_the_mass_falls_as_fast(make):
    model = make()
    setup = make_setup({**QUIET, "simulation": {"duration": 0.2}}, model)
    start = np.tile(setup.start, (1, 1))
    start[:, 13:] = 100.0  # hardly any thrust
    states = simulate_many(setup, 1, x=start, mass=np.array([2 * AIRFRAME.mass]), every=1).states[0]
    t, at = np.arange(50) / 100, np.zeros((50, 12))
    at[:, 11] = -5.0
    replayed = replay(model, t, at, np.full((50, 4), 50.0), np.array([0]), 0.1, mass=2 * AIRFRAME.mass)
    falls = [(states[1, 6] - states[0, 6]) / setup.settings["simulation"]["time step"], replayed[0, -1, 6] / 0.1]
    light = simulate_many(setup, 1, x=start, every=1).states[0]
    assert falls == pytest.approx([GRAVITY] * 2, rel=0.06)
    assert (light[1, 6] - light[0, 6]) < (states[1, 6] - states[0, 6]) + 1e-9


@octave
def test_lag_and_delay_together_are_no_limit_in_matlab_either(tmp_path):
    base = {
        **QUIET, "simulation": {"time step": 0.004, "duration": 1.6}, "controller": {"controller": "drone_INDI"},
        "actuator": {"time constants": 0.03, "time constants down": 0.03, "delay": 0.03},
        "references": {"kind": "position steps", "steps": [[0, 0, 0, -6], [0.4, 0, 0, 6], [0.8, 0, 0, -10]]},
    }  # fmt: skip
    setup = make_setup(base, flown())
    write_matlab(flown(), tmp_path, None, loop_constants(setup))
    script = """addpath('simulation');
[modelParams, droneParams] = model_init('m');
simParams = simParameters();
reference.time = [0; 0.4; 0.8];
reference.signals.values = [0 0 -6 0; 0 0 6 0; 0 0 -10 0];
omega = [%r %r %r %r];
simdata = simulateQuadrotor(1.6, simParams.dt, zeros(12, 1), omega, reference, modelParams, droneParams, simParams);
save('-v7', 'found.mat', 'simdata');
"""
    found = run_octave(tmp_path, script % tuple(float(w) for w in setup.start[13:]))["simdata"]
    table = simulate(setup).table
    assert np.abs(found.omegaCommand - table[[f"w{i}_CMD" for i in range(1, 5)]].to_numpy()).max() < 1e-6


@pytest.mark.parametrize("goal", ["position", "velocity"])
def test_a_table_that_repeats_has_no_seam(goal):
    t, pace = np.linspace(0.0, 4.0, 81), 0.5 * np.pi
    cosine, sine = np.cos(pace * t), np.sin(pace * t)
    table = {"t": t, "x": cosine / pace, "y": sine / pace, "z": 0 * t, "vx": -sine, "vy": cosine, "vz": 0 * t}
    table |= {"ax": -pace * cosine, "ay": -pace * sine, "az": 0 * t}
    if goal == "velocity":
        table = {n: v for n, v in table.items() if n in ("t", "vx", "vy", "vz")}
    made_so = make_reference({"kind": "table", "goal": goal, "end": "repeat"}, table)
    at = {}
    for time in (0.0, 3.99, 4.0, 4.01, 8.0):
        at[time] = np.zeros(20)
        evaluate_reference(*made_so, time, at[time])
    assert at[4.0] == pytest.approx(at[0.0], abs=1e-9, nan_ok=True) and at[8.0] == pytest.approx(
        at[0.0], abs=1e-9, nan_ok=True
    )
    assert at[4.0] == pytest.approx(0.5 * (at[3.99] + at[4.01]), abs=0.1, nan_ok=True)
    assert at[4.0][5] == pytest.approx(1.0)  # vy
    held = make_reference({"kind": "table", "goal": goal}, table)
    setpoint = np.zeros(20)
    evaluate_reference(*held, 4.0, setpoint)
    assert goal == "velocity" or setpoint[4:10] == pytest.approx(0.0)


def hover(model, seconds=60):
    rng, n = np.random.default_rng(1), 100 * seconds
    flight = {"t": np.arange(n) / 100.0, "z": np.full(n, -1.0), "valid": np.ones(n), "in_flight": np.ones(n)}
    for i in range(1, 5):
        flight |= {f"w{i}": np.full(n, find_hover_speed(model)), f"w{i}_dot": np.zeros(n)}
    flight |= {c: 1e-3 * rng.standard_normal(n) for c in ("roll", "pitch", "yaw", *"uvwpqrxy")}
    flight |= {f"{c}_dot": np.zeros(n) for c in "pqr"}
    predicted = model.predict_columns(pd.DataFrame(flight))
    return pd.DataFrame(flight | {a: predicted[a] + 0.05 * rng.standard_normal(n) for a in AXES})


def test_a_model_that_diverges_is_the_worse_one():
    good, bad = made(), copy.deepcopy(document()) | {"id": "bad"}
    (damping,) = [t for t in bad["axes"]["Mx"]["terms"] if t["expression"] == "p"]
    damping |= {"expression": "p*|p|^9 + p*2000", "coefficient": 1.0}
    for models, worse in (((good, Model(bad)), 1), ((Model(bad), good), 0)):
        rows = {r.name: r for r in compare_models(*models, {"f": hover(good)})}
        row = next(r for name, r in rows.items() if name.startswith("rate after"))
        assert row.differs and (row.change > 0.0) == (worse == 1)
    names = [*ERROR_UNITS, *MOVED_BY.values()]
    windows = pd.DataFrame({"flight": "f", "start": np.arange(40.0), "horizon": 0.5} | dict.fromkeys(names, 1.0))
    lost = windows.assign(**dict.fromkeys(names, np.nan))
    assert all(row["value"] <= 0.0 for row in fell(windows, lost))
    assert all(row["value"] == 0.0 for row in fell(lost, lost))
    assert not np.isfinite(rms(lost)["velocity"]["0.5"]) and rms(windows)["velocity"]["0.5"] == 1.0


def test_terms_of_an_extension_are_added_once():
    extension = {"id": "x", "terms": {"Fx": [{"expression": "u", "coefficient": -0.1}]}}
    once = apply_extensions(made(extensions=[extension]))
    forward = np.eye(12)[3]
    speeds = np.full(4, once.hover_speed)
    assert apply_extensions(once).predict(forward, speeds)[0][0] == once.predict(forward, speeds)[0][0]


def test_three_time_constants_are_refused():
    with pytest.raises(DataError, match="expected positive seconds"):
        actuators_of(made(actuators={"time constants": {"value": [0.02] * 3}}))


def test_a_rival_loses_by_what_was_asked_of_the_same_time():
    known = catalogue()
    rival = known["mass"].rivals[0]
    effect = {"id": "mass", "confused_with": [], "parameters": {}, "since": "always"}
    asked = [{"id": rival, "since": s, "p": p, "why_not": ""} for s, p in (("always", 1e-5), ("changed", 0.43))]
    assert "0.43" not in rivals_words(effect, {"effects": [effect], "candidates": asked}, known)
    assert rivals_words(effect, {"effects": [effect], "candidates": asked[1:]}, known) == ""


def test_the_page_of_a_model_writes_its_map_by_its_powers():
    actuators = {
        "time constants": {"value": [0.03] * 4},
        "command map": {"coefficients": [1000.0, 500.0], "powers": [1, 2]},
    }
    assert "1000 c + 500 c^2" in _render_rotors(document() | {"actuators": actuators})
