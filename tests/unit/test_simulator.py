"""Simulations of any system: the mass on a spring of the manual's 7.5 against exact solutions and a plain loop."""

import csv
import json
import subprocess
import sys

import numpy as np
import pytest
from scipy.linalg import expm

from quasi import command
from quasi.errors import ConfigError, DataError, ShapeError
from quasi.simulation.loop.simulator import Simulator, make_signal_columns

M, C, K = 1.0, 1.5, 0.8
A = np.array([[0.0, 1.0], [-K / M, -C / M]])


def forces(bus):
    x, v = bus.state[bus.step]
    return np.array([bus.inputs[bus.step + 1, 0] - C * v - K * x, 0.0, 0.0]), np.zeros(3)


def motion(bus):
    return np.array([bus.state[bus.step, 1], bus.forces[bus.step + 1, 0] / M])


def mass_on_a_spring(integrator="rk4", dt=0.01, duration=2.0, controller=None, actuator=None, **options):
    simulator = Simulator(None, motion, controller, actuator, forces, integrator, **options)
    if options.get("run_mode") == "infinite":
        duration = None
    simulator.set_initial([1.0, -0.5], [0.3], dt, duration)
    return simulator


@pytest.mark.parametrize("integrator, order", [("euler", 1), ("rk4", 4)])
def test_a_free_oscillation_converges_to_the_exact_one_with_its_order(integrator, order):
    steady = np.array([0.3 / K, 0.0])
    exact = steady + expm(2.0 * A) @ (np.array([1.0, -0.5]) - steady)
    errors = [
        np.linalg.norm(mass_on_a_spring(integrator, dt).run().state[round(2.0 / dt)] - exact) for dt in (0.04, 0.02)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau", "LSODA"])
def test_adaptive_integrators_reach_the_exact_solution(method):
    steady = np.array([0.3 / K, 0.0])
    exact = steady + expm(0.2 * A) @ (np.array([1.0, -0.5]) - steady)
    found = mass_on_a_spring(method, 0.05, 0.2).run().state[4]
    np.testing.assert_allclose(found, exact, atol=1e-7)


def test_a_loop_with_controller_and_actuator_equals_a_plain_loop():
    dt, gains, tau = 0.01, (6.0, 4.0, 3.0), 1 / 15
    memory = {"sum": 0.0, "last": None}

    def controller(bus):
        error = bus.reference[bus.step, 0] - bus.state[bus.step, 0]
        change = 0.0 if memory["last"] is None else (error - memory["last"]) / bus.time_step
        memory["sum"] += error * bus.time_step
        memory["last"] = error
        return gains[0] * error + gains[1] * memory["sum"] + gains[2] * change

    def lag(bus):
        k = bus.step
        return bus.inputs[k] + bus.time_step / tau * (bus.commanded_inputs[k + 1] - bus.inputs[k])

    simulator = Simulator(None, motion, controller, lag, forces, "euler")
    reference = np.zeros((501, 2))
    reference[100:, 0] = 1.0
    simulator.set_initial([0.0, 0.0], [0.0], dt, 5.0, reference)
    bus = simulator.run()

    x, v, u, total, last = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(500):
        error = (1.0 if k >= 100 else 0.0) - x
        total += error * dt
        command_ = 6.0 * error + 4.0 * total + 3.0 * (error - last) / dt
        last = error
        u += dt / tau * (command_ - u)
        x, v = x + dt * v, v + dt * (u - C * v - K * x) / M
        assert bus.state[k + 1] == pytest.approx([x, v], abs=1e-10)
    assert bus.state[500, 0] == pytest.approx(1.0, abs=0.05)


def test_the_bus_holds_what_the_manual_lists_indexed_by_the_step():
    bus = mass_on_a_spring().run()
    assert bus.step == 200 and bus.time[200] == pytest.approx(2.0) and bus.duration == 2.0 and bus.time_step == 0.01
    assert bus.state.shape[1] == 2 and bus.inputs.shape[1] == 1 and bus.forces.shape[1] == 3
    # forces and derivative of row k + 1 belong to the state of row k
    x, v = bus.state[7]
    assert bus.forces[8, 0] == pytest.approx(0.3 - C * v - K * x)
    np.testing.assert_allclose(bus.state_derivative[8], [v, bus.forces[8, 0] / M])
    np.testing.assert_array_equal(bus.commanded_inputs[8], bus.commanded_inputs[0])


def test_infinite_mode_grows_beyond_its_first_rows_and_ends_by_its_condition():
    simulator = mass_on_a_spring(dt=0.001, run_mode="infinite")
    simulator.set_termination(lambda bus: bus.time[bus.step] < 3.0)
    bus = simulator.run()
    assert bus.step == 3000
    finite = mass_on_a_spring(dt=0.001, duration=3.0).run()
    np.testing.assert_array_equal(bus.state[:3001], finite.state[:3001])
    with pytest.raises(ConfigError, match="needs a condition to end"):
        mass_on_a_spring(run_mode="infinite").run()


def test_faults_name_what_to_do():
    with pytest.raises(ConfigError, match="integrator 'rk5' is not known.*RK45"):
        mass_on_a_spring("rk5")
    with pytest.raises(ConfigError, match="run_mode is 'endless'"):
        Simulator(None, motion, run_mode="endless")
    with pytest.raises(ConfigError, match="no initial state"):
        Simulator(None, motion).run()
    simulator = Simulator(None, motion)
    with pytest.raises(ConfigError, match="time step is 0"):
        simulator.set_initial([0.0], [0.0], 0, 1.0)
    with pytest.raises(ConfigError, match="duration is None"):
        simulator.set_initial([0.0], [0.0], 0.1)
    with pytest.raises(ShapeError, match="initial state must be one row of finite numbers"):
        simulator.set_initial([np.nan], [0.0], 0.1, 1.0)
    with pytest.raises(ConfigError, match="no step is called 'force'.*forces_and_moments"):
        simulator.add_step("force", print)
    with pytest.raises(ConfigError, match="after the step 'begin' is 5, expected a function of"):
        simulator.add_step("begin", 5)
    simulator = mass_on_a_spring()
    simulator.steps["controller"] = 5
    with pytest.raises(ConfigError, match="the step 'controller' is 5, expected a function"):
        simulator.run()


def test_nan_of_a_step_names_the_step_and_keeps_what_was_computed():
    def controller(bus):
        return np.nan if bus.step == 5 else 0.0

    simulator = mass_on_a_spring(controller=controller)
    with pytest.raises(DataError, match=r"step 'controller' \(.*controller\) at t = 0.05 s returned nan"):
        simulator.run()
    assert simulator.bus.step == 5 and np.isfinite(simulator.table()["state 0"]).all()
    with pytest.raises(DataError, match="expected 1 numbers"):
        mass_on_a_spring(controller=lambda bus: [1.0, 2.0]).run()


def test_divergence_stops_and_says_when():
    simulator = Simulator(None, lambda bus: 1e3 * bus.state[bus.step] ** 3, integrator="euler")
    simulator.set_initial([1.0], [0.0], 0.1, 10.0)
    with np.errstate(over="ignore", invalid="ignore"):
        bus = simulator.run()
    assert "diverged at t = 0." in simulator.stopped and "state 0" in simulator.stopped
    assert bus.step < 20


def test_new_simulation_lays_a_runnable_skeleton_that_tracks_its_reference(tmp_path, capsys):
    assert command.main(["new-simulation", "mass_spring", "-d", str(tmp_path)]) == 0
    assert "mass_spring.py" in capsys.readouterr().out
    folder = tmp_path / "mass_spring"
    assert "NAME" not in (folder / "mass_spring.py").read_text()
    json.loads((folder / "mass_spring.json").read_text())
    done = subprocess.run([sys.executable, folder / "mass_spring.py"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with open(folder / "mass_spring.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["t", "x", "v", "force", "x_ref", "v_ref"] and len(rows) == 1001
    assert float(rows[90]["x"]) == 0.0 and float(rows[-1]["x"]) == pytest.approx(1.0, abs=0.02)
    assert (folder / "mass_spring.png").stat().st_size > 5000
    assert command.main(["new-simulation", "mass_spring", "-d", str(tmp_path)]) == 1
    assert "already exists" in capsys.readouterr().err
    assert command.main(["new-simulation", "../x", "-d", str(tmp_path)]) == 1
    assert "cannot be called" in capsys.readouterr().err


def test_recorded_signals_are_numbers_or_vectors_of_one_size():
    assert {k: v.tolist() for k, v in make_signal_columns("a", [1.0, 2.0]).items()} == {"a": [1.0, 2.0]}
    found = make_signal_columns("b", [np.array([1.0, 2.0]), np.array([3.0, 4.0])])
    assert {k: v.tolist() for k, v in found.items()} == {"b_1": [1.0, 3.0], "b_2": [2.0, 4.0]}
    for wrong in ([1.0, np.zeros(2)], [np.zeros((2, 2))] * 2):
        with pytest.raises(ShapeError, match="signal 'c'"):
            make_signal_columns("c", wrong)
