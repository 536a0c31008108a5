"""NAME: a simulation of a system of your own. Run it:  python NAME.py

The example is a mass on a spring with a damper, pushed by a slow actuator under a PID controller. Replace the five
parts below by your own; each is a function of the bus. The arrays of the bus are indexed by the step k = bus.step:
bus.state[k] and bus.reference[k] are known, a step writes row k + 1 by what it returns. Settings are in NAME.json.
"""

import csv
import json
import sys
from pathlib import Path

import numpy as np

from quasi.errors import QuasiError
from quasi.simulation.loop.simulator import Bus, Simulator

HERE = Path(__file__).parent
STATES, INPUTS = ["x", "v"], ["force"]  # m, m/s; N


class Model:
    """The constants of the system, for every part to read as bus.model."""

    def __init__(self, mass: float, damping: float, stiffness: float) -> None:
        self.mass, self.damping, self.stiffness = mass, damping, stiffness  # kg, N s/m, N/m


class Controller:
    """What is commanded, from what is measured: a PID controller of the position."""

    def __init__(self, proportional: float, integral: float, derivative: float, noise: list[float], seed: int) -> None:
        self.gains, self.noise = (proportional, integral, derivative), noise
        self.random = np.random.default_rng(seed)
        self.sum, self.last = 0.0, None

    def __call__(self, bus: Bus) -> np.ndarray:
        k, dt = bus.step, bus.time_step
        bus.measured_state[k] = bus.state[k] + self.noise * self.random.standard_normal(2)
        error = bus.reference[k, 0] - bus.measured_state[k, 0]
        change = 0.0 if self.last is None else (error - self.last) / dt
        self.sum, self.last = self.sum + error * dt, error
        p, i, d = self.gains
        return np.array([p * error + i * self.sum + d * change])


class Actuator:
    """What really acts, from what is commanded: a lag of first order, solved exactly over the step."""

    def __init__(self, time_constant: float) -> None:
        self.time_constant = time_constant

    def __call__(self, bus: Bus) -> np.ndarray:
        k = bus.step
        share = 1.0 - np.exp(-bus.time_step / self.time_constant)
        return bus.inputs[k] + share * (bus.commanded_inputs[k + 1] - bus.inputs[k])


def forces_and_moments(bus: Bus) -> tuple[np.ndarray, np.ndarray]:
    """Forces (3,), N, and moments (3,), N m, in the present state with the present inputs."""
    k, model = bus.step, bus.model
    x, v = bus.state[k]
    force = bus.inputs[k + 1, 0] - model.damping * v - model.stiffness * x
    return np.array([force, 0.0, 0.0]), np.zeros(3)


def equations_of_motion(bus: Bus) -> np.ndarray:
    """Time derivative of the state, from forces and moments."""
    k = bus.step
    return np.array([bus.state[k, 1], bus.forces[k + 1, 0] / bus.model.mass])


def simulation(settings: dict) -> Simulator:
    """Put the parts together: a step of the reference after one second, from rest."""
    controller = Controller(**settings["controller"])
    simulator = Simulator(
        Model(**settings["model"]),
        equations_of_motion,
        controller,
        Actuator(**settings["actuator"]),
        forces_and_moments,
        integrator=settings["integrator"],
    )
    dt, duration = settings["time step"], settings["duration"]
    reference = np.zeros((round(duration / dt) + 1, 2))
    reference[round(1.0 / dt) :, 0] = 1.0
    simulator.set_initial(state=[0.0, 0.0], inputs=[0.0], time_step=dt, duration=duration, reference=reference)
    return simulator


def main() -> None:
    """Simulate, write a table, draw it."""
    simulator = simulation(json.loads((HERE / "NAME.json").read_text(encoding="utf-8")))
    simulator.run()
    if simulator.stopped:
        print(simulator.stopped)
    table = simulator.table({"state": STATES, "inputs": INPUTS, "reference": ["x_ref", "v_ref"]})
    with open(HERE / "NAME.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        writer.writerows(zip(*table.values()))
    from matplotlib.figure import Figure

    axes = (figure := Figure(figsize=(7, 4), layout="constrained")).subplots()
    axes.plot(table["t"], table["x"], label="position x, m")
    axes.plot(table["t"], table["v"], label="velocity v, m/s")
    axes.plot(table["t"], table["x_ref"], "k--", label="reference of x, m")
    axes.set_xlabel("time, s")
    axes.legend()
    figure.savefig(HERE / "NAME.png", dpi=150)
    print(f"simulated {table['t'][-1]:g} s; x ends at {table['x'][-1]:.3f} m. Made NAME.csv and NAME.png in {HERE}")


if __name__ == "__main__":
    try:
        main()
    except QuasiError as error:
        sys.exit(f"[ERROR] {error}")
