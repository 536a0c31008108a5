"""Stability margins of a controller on a model: the sampled closed loop, linearised about hover.

The compiled step of the controller is differentiated numerically, with its filters and memory. The vehicle is the model
about hover with the rotors' lag, discretised exactly for commands constant over a step, and a delay of whole steps.
The loop is opened at the actuator commands, in the four directions roll, pitch, yaw and thrust.

Disk margins (gain and phase at once): Seiler, Packard, Gahinet, An introduction to disk margins, IEEE Control Systems
40(5), 2020. The others: Astrom, Murray, Feedback Systems, 2nd ed., 2021, section 10.3.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm, schur, solve_triangular

from quasi.attitude import GRAVITY, exponential, rotate_inverse
from quasi.errors import ConfigError
from quasi.model.hover import find_hover_position, list_usual_inputs
from quasi.model.model import Model
from quasi.simulation.control.control_model import make_control_model
from quasi.simulation.control.controllers import controller_step, make_controller
from quasi.simulation.control.gains import complete_settings
from quasi.simulation.control.outer_loop import SETPOINT_POSITION, SETPOINT_SIZE, SETPOINT_THRUST
from quasi.simulation.control.registry import LAWS
from quasi.simulation.loop.setup import Setup, list_actuators
from quasi.simulation.vehicle.dynamics import LAG_UP

DIRECTIONS = ("roll", "pitch", "yaw", "thrust")
_MOTION_SIZE = 12  # rotation vector, u v w, p q r, x y z; then the rotor speeds


class Margin(NamedTuple):
    """Margins of one loop with the others closed.

    gain_up, gain_down  factors (dB, both positive; inf for none) by which the gain may rise or fall
    phase deg and delay ms that the loop tolerates; disk: the disk margin alpha; crossover rad/s, the highest of the
    loop
    """

    gain_up: float
    gain_down: float
    phase: float
    delay: float
    disk: float
    crossover: float


class Loop(NamedTuple):
    """The loop about hover, sampled at dt, s: x+ = a x + b v, y = c x, from commands v (4,) to the computed commands.

    closed (n, n): the matrix with the loop closed; its eigenvalues within the unit circle mean stability
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    closed: np.ndarray
    directions: np.ndarray  # (4, 4) columns: rotor speeds of roll, pitch, yaw, thrust
    dt: float


class Margins(NamedTuple):
    """The closed loop about hover.

    stable; least_damping of its oscillations; Margin by_direction;
    all_at_once: the disk margin alpha for independent simultaneous changes of gain and phase in all four directions
    """

    stable: bool
    least_damping: float
    by_direction: dict[str, Margin]
    all_at_once: float


def compute_margins(
    settings: Mapping[str, Any], model: Model, dt: float = 0.004, actuators: Mapping[str, Any] | None = None
) -> Margins:
    """Margins of a controller that holds a position on this model, sampled at dt, s; see the head of the module.

    settings, actuators as for `controllers.make_controller`. Raises ConfigError for an impossible time step.
    """
    loop = linearise(settings, model, dt, actuators)
    eigenvalues = np.linalg.eigvals(loop.closed)
    moving = eigenvalues[(np.abs(eigenvalues) > 1e-6) & (np.abs(eigenvalues.imag) > 1e-9)]
    poles = np.log(moving) / dt
    damping = float(np.min(-poles.real / np.abs(poles))) if len(poles) else 1.0
    largest = float(np.max(np.abs(eigenvalues)))
    frequencies = np.geomspace(1e-2, math.pi / dt, 3000)  # up to half the sampling rate, where the loop is real
    response = _compute_response(loop, frequencies)
    mixed = np.linalg.solve(loop.directions, response @ loop.directions)
    found = {name: _compute_margin(_open_one_loop(mixed, k), frequencies) for k, name in enumerate(DIRECTIONS)}
    identity = np.eye(4)
    sensitivity = np.linalg.inv(identity + mixed)
    together = 1.0 / np.max(np.linalg.norm(sensitivity - 0.5 * identity, ord=2, axis=(-2, -1)))
    return Margins(largest < 1.0, damping, found, float(together))


def actuators_of_setup(setup: Setup) -> dict[str, Any]:
    """The actuators of a simulation, as `controllers.make_controller` takes them."""
    parameters = setup.loop_parameters
    return list_actuators(parameters.body[LAG_UP : LAG_UP + 4], parameters.drive)


def describe_margins(setup: Setup) -> str:
    """Describe gains and margins of a simulation's controller as text."""
    actuators = actuators_of_setup(setup)
    asked = {**setup.settings["controller"], "time step": setup.dt}
    complete = complete_settings(asked, make_control_model(setup.model, actuators))
    found = compute_margins(asked, setup.model, setup.dt, actuators)
    stability = "stable" if found.stable else "NOT STABLE"
    lines = [
        f"{complete['controller']} on {setup.model.id}, every {1e3 * setup.dt:g} ms: {stability} about hover, "
        f"least damping {found.least_damping:.2f}",
        "gains, s",
    ]
    for block, values in complete["gains"].items():
        lines.append(f"  {block:<10}" + ", ".join(f"{key} {value:.3g}" for key, value in values.items()))
    lines.append(f"{'margins':<12}{'gain up':>9}{'gain down':>11}{'phase':>8}{'delay':>9}{'disk':>7}{'crossover':>12}")
    for name, margin in found.by_direction.items():
        up, down = (f"{v:.1f} dB" if math.isfinite(v) else "none" for v in (margin.gain_up, margin.gain_down))
        lines.append(
            f"  {name:<10}{up:>9}{down:>11}{margin.phase:>6.0f} °{margin.delay:>6.0f} ms{margin.disk:>7.2f}"
            f"{margin.crossover:>6.1f} rad/s"
        )
    lines.append(f"disk margin of all four at once {found.all_at_once:.2f}")
    return "\n".join(lines)


def linearise(
    settings: Mapping[str, Any], model: Model, dt: float = 0.004, actuators: Mapping[str, Any] | None = None
) -> Loop:
    """Linearise the position loop of a controller on this model about hover, without constant moments."""
    if not (math.isfinite(dt) and dt > 0.0):
        raise ConfigError(f"margins: the time step is {dt!r} s, expected a positive number")
    vehicle = make_control_model(model, actuators)
    level = np.zeros(_MOTION_SIZE + 4)
    level[_MOTION_SIZE:] = vehicle.hover_speed
    level[9:12] = find_hover_position(model)
    offset = _predict_loads(model, level, np.zeros(4), 0.0)
    offset[2] += vehicle.mass * GRAVITY if model.with_gravity else 0.0
    plant = _Plant(model, vehicle, offset)
    a, b = _differentiate(plant.derivative, level, level[_MOTION_SIZE:])
    output, feedthrough = _differentiate(plant.measure, level, level[_MOTION_SIZE:])
    n = len(level)
    discrete = expm(np.block([[a, b], [np.zeros((4, n + 4))]]) * dt)
    # commands in the delay line; the oldest one acts
    steps_delayed = max(round(vehicle.delay / dt), 0) + 1
    size = n + 4 * steps_delayed
    step = np.zeros((size, size))
    step[:n, :n] = discrete[:n, :n]
    for k in range(steps_delayed - 1):
        step[n + 4 * k : n + 4 * k + 4, n + 4 * k + 4 : n + 4 * k + 8] = np.eye(4)
    # the first of them acted until now and is measured; the next one acts from this step on. Without delay this is the
    # newest command, an input and not yet a state
    input_matrix = np.zeros((size, 4))
    input_matrix[size - 4 :] = np.eye(4)
    if steps_delayed == 1:
        input_matrix[:n] = discrete[:n, n:]
    else:
        step[:n, n + 4 : n + 8] = discrete[:n, n:]
    measure_matrix = np.zeros((26, size))
    measure_matrix[:, :n], measure_matrix[:, n : n + 4] = output, feedthrough
    memory_matrix, from_measurement, out, command_from_measurement = _linear_controller(
        settings, model, actuators, offset, dt, plant.measure(level, level[_MOTION_SIZE:])
    )
    m = len(memory_matrix)
    system = np.block([[step, np.zeros((size, m))], [from_measurement @ measure_matrix, memory_matrix]])
    inputs = np.vstack([input_matrix, np.zeros((m, 4))])
    outputs = np.hstack([command_from_measurement @ measure_matrix, out])
    directions = np.linalg.inv(vehicle.effectiveness)
    directions = directions / np.linalg.norm(directions, axis=0)
    return Loop(system, inputs, outputs, system + inputs @ outputs, directions, dt)


class _Plant:
    """The vehicle about hover: derivative and measurement, from a state (16,) and target rotor speeds (4,)."""

    def __init__(self, model: Model, vehicle: Any, offset: np.ndarray) -> None:
        self.model, self.vehicle, self.offset = model, vehicle, offset
        self.inverse = np.linalg.inv(vehicle.inertia)

    def derivative(self, x: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Body axes; the attitude as a rotation vector, whose rate is that of the body to first order."""
        slope = (target - x[_MOTION_SIZE:]) / self.vehicle.lag
        loads = _predict_loads(self.model, x, slope, 1.0) - self.offset
        q, v, w = exponential(x[:3]), x[3:6], x[6:9]
        weight = rotate_inverse(q, np.array([0.0, 0.0, GRAVITY])) if self.model.with_gravity else np.zeros(3)
        acceleration = loads[:3] / self.vehicle.mass + weight - np.cross(w, v)
        turn = self.inverse @ (loads[3:] - np.cross(w, self.vehicle.inertia @ w))
        return np.concatenate([w + 0.5 * np.cross(x[:3], w), acceleration, turn, v + np.cross(x[:3], v), slope])

    def measure(self, x: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return the measurement (26,) of the controllers."""
        slope = (target - x[_MOTION_SIZE:]) / self.vehicle.lag
        force = (_predict_loads(self.model, x, slope, 1.0) - self.offset)[:3] / self.vehicle.mass
        q = exponential(x[:3])
        if not self.model.with_gravity:
            force = force - rotate_inverse(q, np.array([0.0, 0.0, GRAVITY]))
        return np.concatenate([q, x[3:], force, np.zeros(6)])


def _predict_loads(model: Model, x: np.ndarray, slope: np.ndarray, angles: float) -> np.ndarray:
    """Forces and moments (6,); small rotation vectors are Euler angles to first order."""
    state = np.concatenate([angles * x[:3], x[3:_MOTION_SIZE]])[None]
    further = dict(zip(model.inputs[20:], list_usual_inputs(model)))
    force, moment = model.predict(state, x[None, _MOTION_SIZE:], slope[None], further)
    return np.concatenate([force[0], moment[0]])


def _differentiate(function: Any, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives by state and input, central differences; steps of 1e-5, for speeds relative."""
    steps = np.where(np.arange(len(x)) < _MOTION_SIZE, 1e-5, 1e-5 * x[-1])
    by_state = [(function(x + d, v) - function(x - d, v)) / (2 * s) for s, d in zip(steps, np.diag(steps))]
    step = 1e-5 * x[-1]
    by_input = [(function(x, v + d) - function(x, v - d)) / (2 * step) for d in step * np.eye(4)]
    return np.column_stack(by_state), np.column_stack(by_input)


def _linear_controller(
    settings: Mapping[str, Any],
    model: Model,
    actuators: Mapping[str, Any] | None,
    offset: np.ndarray,
    dt: float,
    measurement: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Matrices of the controller: next memory and commands, each by memory and by measurement."""
    kind, parameters, size = make_controller(settings, model, actuators, offset)
    setpoint, memory = np.zeros(SETPOINT_SIZE), np.zeros(size)
    setpoint[SETPOINT_THRUST] = np.nan
    setpoint[SETPOINT_POSITION : SETPOINT_POSITION + 3] = measurement[10:13]
    commands = np.zeros(4)
    for _ in range(3):
        controller_step(kind, parameters, memory, dt, measurement, setpoint, commands)
    carried = LAWS[kind].memory
    entries = np.concatenate([np.arange(first, first + n) for first, n, _ in carried])
    steps = np.concatenate([np.full(n, 1e-6 * (measurement[13] ** 2 if squared else 1.0)) for _, n, squared in carried])

    def run_step(entry: int | None, by: float, measurement: np.ndarray) -> np.ndarray:
        trial = memory.copy()
        if entry is not None:
            trial[entry] += by
        out = np.zeros(4)
        controller_step(kind, parameters, trial, dt, measurement, setpoint, out)
        return np.concatenate([trial[entries], out])

    by_memory = np.column_stack(
        [(run_step(e, s, measurement) - run_step(e, -s, measurement)) / (2 * s) for e, s in zip(entries, steps)]
    )
    small = np.where((np.arange(26) >= 13) & (np.arange(26) < 17), 1e-6 * measurement[13], 1e-6)
    by_seen = np.column_stack(
        [
            (run_step(None, 0.0, measurement + d) - run_step(None, 0.0, measurement - d)) / (2 * s)
            for s, d in zip(small, np.diag(small))
        ]
    )
    # squared speeds are millions: in units of the steps the matrices are well balanced
    n, unit = len(entries), 1e6 * steps
    return by_memory[:n] * unit / unit[:, None], by_seen[:n] / unit[:, None], by_memory[n:] * unit, by_seen[n:]


def _compute_response(loop: Loop, frequencies: np.ndarray) -> np.ndarray:
    """Loop transfer (F, 4, 4), negative feedback counted in: -1 is the critical point."""
    # one Schur form serves all frequencies, and does not mind repeated eigenvalues (rows of integrators)
    triangle, turn = schur(loop.a, output="complex")
    left, right, identity = turn.conj().T @ loop.b, loop.c @ turn, np.eye(len(triangle))
    z = np.exp(1j * frequencies * loop.dt)
    return np.array([-right @ solve_triangular(p * identity - triangle, left, check_finite=False) for p in z])


def _open_one_loop(loop: np.ndarray, k: int) -> np.ndarray:
    """Transfer of direction k with the others closed."""
    others = [i for i in range(4) if i != k]
    rest = loop[:, others][:, :, others] + np.eye(3)
    back = np.linalg.solve(rest, loop[:, others, k][:, :, None])
    return loop[:, k, k] - np.einsum("fi,fi->f", loop[:, k, others], back[:, :, 0])


def _compute_margin(l: np.ndarray, frequencies: np.ndarray) -> Margin:
    size, real = np.abs(l), l.real
    # crossings of the negative real axis, interpolated in frequency
    turn = np.flatnonzero((np.sign(l.imag[:-1]) != np.sign(l.imag[1:])) & (real[:-1] < 0.0))
    share = l.imag[turn] / (l.imag[turn] - l.imag[turn + 1])
    crossing = np.append(-(real[turn] + share * (real[turn + 1] - real[turn])), -real[-1])
    up = crossing[(crossing > 0.0) & (crossing < 1.0)]
    down = crossing[crossing >= 1.0]
    over = np.flatnonzero((size[:-1] - 1.0) * (size[1:] - 1.0) <= 0.0)
    share = (size[over] - 1.0) / (size[over] - size[over + 1])
    at, when = l[over] + share * (l[over + 1] - l[over]), frequencies[over] + share * np.diff(frequencies)[over]
    phases = np.degrees(np.abs(np.angle(-at)))
    # only phase lag reduces the delay margin: distance to -180 degrees, downwards
    lag = np.mod(np.angle(-at), 2.0 * math.pi)
    disk = 1.0 / np.max(np.abs(1.0 / (1.0 + l) - 0.5))
    return Margin(
        gain_up=float(-20.0 * math.log10(up.max())) if len(up) else math.inf,
        gain_down=float(20.0 * math.log10(down.min())) if len(down) else math.inf,
        phase=float(phases.min()) if len(over) else math.inf,
        delay=float(1e3 * np.min(lag / when)) if len(over) else math.inf,
        disk=float(disk),
        crossover=float(when.max()) if len(over) else 0.0,
    )
