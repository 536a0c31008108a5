"""Stability margins of a controller on a model: the closed loop about hover, linearised as it is, sample by sample.

The controller's own compiled step is differentiated numerically, with its filters and memory; the vehicle is the model
about hover with its rotors' lag, discretised exactly for commands held over a step, and a delay of whole steps.
The loop is cut where commands go to the actuators, in the four directions roll, pitch, yaw and thrust.

Disk margins (gain and phase at once): Seiler, Packard, Gahinet, An introduction to disk margins, IEEE Control Systems
40(5), 2020. The others: Astrom, Murray, Feedback Systems, 2nd ed., 2021, section 10.3.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from scipy.linalg import expm, schur

from quasi.attitude import GRAVITY, exponential, rotate_inverse
from quasi.errors import ConfigError
from quasi.model.model import Model
from quasi.simulation.control import controllers as c
from quasi.simulation.control import gains as g
from quasi.simulation.control.control_model import control_model, extras, usual_place
from quasi.simulation.control.outer_loop import GOAL, INTEGRAL, PLACE, THRUST
from quasi.simulation.loop.setup import Setup
from quasi.simulation.vehicle.dynamics import UP

DIRECTIONS = ("roll", "pitch", "yaw", "thrust")
_MOTION = 12  # rotation vector, u v w, p q r, x y z; then the rotor speeds


class Margin(NamedTuple):
    """Margins of one loop with the others closed.

    gain_up, gain_down  factors (dB, both positive; inf for none) by which the gain may grow or shrink
    phase deg and delay ms that may be lost; disk: the disk margin alpha; crossover rad/s, the highest of the loop
    """

    gain_up: float
    gain_down: float
    phase: float
    delay: float
    disk: float
    crossover: float


class Loop(NamedTuple):
    """The loop about hover, sampled at dt, s: x+ = a x + b v, y = c x, from commands v (4,) to those asked for.

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

    stable; least_damping of its oscillations; largest_eigenvalue (size, of the sampled loop); Margin by_direction;
    all_at_once: the disk margin alpha when gain and phase of all four directions change at once, each as it likes
    """

    stable: bool
    least_damping: float
    largest_eigenvalue: float
    by_direction: dict[str, Margin]
    all_at_once: float


def margins(
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
    response = _response(loop, frequencies)
    mixed = np.linalg.solve(loop.directions, response @ loop.directions)
    found = {name: _margin(_one_open(mixed, k), frequencies) for k, name in enumerate(DIRECTIONS)}
    identity = np.eye(4)
    sensitivity = np.linalg.inv(identity + mixed)
    together = 1.0 / np.max(np.linalg.norm(sensitivity - 0.5 * identity, ord=2, axis=(-2, -1)))
    return Margins(largest < 1.0, damping, largest, found, float(together))


def actuators_of_setup(setup: Setup) -> dict[str, Any]:
    """The actuators of a simulation as `controllers.make_controller` takes them."""
    machine = setup.machine
    return {
        "time constants": np.maximum(machine.body[UP : UP + 4], 1e-4),
        "delay": machine.drive.delay,
        "lowest": machine.drive.low,
        "highest": machine.drive.high if math.isfinite(machine.drive.high) else None,
    }


def margins_of_setup(setup: Setup) -> str:
    """Gains in force and margins of a simulation's controller, as text."""
    actuators = actuators_of_setup(setup)
    asked = {**setup.settings["controller"], "time step": setup.dt}
    settled = g.settle(asked, control_model(setup.model, actuators))
    found = margins(asked, setup.model, setup.dt, actuators)
    said = "stable" if found.stable else "NOT STABLE"
    lines = [
        f"{settled['controller']} on {setup.model.id}, every {1e3 * setup.dt:g} ms: {said} about hover, least damping "
        f"{found.least_damping:.2f}",
        "gains, s",
    ]
    for block, values in settled["gains"].items():
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
    """The loop of a controller that holds a position on this model about hover, its constant moments taken off."""
    if not (math.isfinite(dt) and dt > 0.0):
        raise ConfigError(f"margins: the time step is {dt!r} s, expected a positive number")
    known = control_model(model, actuators)
    level = np.zeros(_MOTION + 4)
    level[_MOTION:] = known.hover_speed
    level[9:12] = usual_place(model)
    offset = _loads(model, level, np.zeros(4), 0.0)
    offset[2] += known.mass * GRAVITY if model.with_gravity else 0.0
    plant = _Plant(model, known, offset)
    a, b = _slopes(plant.derivative, level, level[_MOTION:])
    see, at_once = _slopes(plant.seen, level, level[_MOTION:])
    n = len(level)
    held = expm(np.block([[a, b], [np.zeros((4, n + 4))]]) * dt)
    # commands that are on their way, the eldest acts
    wait = max(round(known.delay / dt), 0) + 1
    size = n + 4 * wait
    step = np.zeros((size, size))
    step[:n, :n] = held[:n, :n]
    for k in range(wait - 1):
        step[n + 4 * k : n + 4 * k + 4, n + 4 * k + 4 : n + 4 * k + 8] = np.eye(4)
    # the first of them acted up to now and is what is seen; the next one acts from this step on, which without a delay
    # is the newest command: the input itself, not yet a state
    inward = np.zeros((size, 4))
    inward[size - 4 :] = np.eye(4)
    if wait == 1:
        inward[:n] = held[:n, n:]
    else:
        step[:n, n + 4 : n + 8] = held[:n, n:]
    look = np.zeros((26, size))
    look[:, :n], look[:, n : n + 4] = see, at_once
    ours, into, out, through = _linear_controller(
        settings, model, actuators, offset, dt, plant.seen(level, level[_MOTION:])
    )
    m = len(ours)
    whole = np.block([[step, np.zeros((size, m))], [into @ look, ours]])
    inputs = np.vstack([inward, np.zeros((m, 4))])
    outputs = np.hstack([through @ look, out])
    directions = np.linalg.inv(known.effectiveness)
    directions = directions / np.linalg.norm(directions, axis=0)
    return Loop(whole, inputs, outputs, whole + inputs @ outputs, directions, dt)


class _Plant:
    """The vehicle about hover: derivative and what is seen, of a state (16,) and the speeds the rotors move to (4,)."""

    def __init__(self, model: Model, known: Any, offset: np.ndarray) -> None:
        self.model, self.known, self.offset = model, known, offset
        self.inverse = np.linalg.inv(known.inertia)

    def derivative(self, x: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Body axes; the attitude as a rotation vector, whose rate is that of the body to first order."""
        slope = (target - x[_MOTION:]) / self.known.lag
        loads = _loads(self.model, x, slope, 1.0) - self.offset
        q, v, w = exponential(x[:3]), x[3:6], x[6:9]
        weight = rotate_inverse(q, np.array([0.0, 0.0, GRAVITY])) if self.model.with_gravity else np.zeros(3)
        acceleration = loads[:3] / self.known.mass + weight - np.cross(w, v)
        turn = self.inverse @ (loads[3:] - np.cross(w, self.known.inertia @ w))
        return np.concatenate([w + 0.5 * np.cross(x[:3], w), acceleration, turn, v + np.cross(x[:3], v), slope])

    def seen(self, x: np.ndarray, target: np.ndarray) -> np.ndarray:
        """(26,) as the controllers take it."""
        slope = (target - x[_MOTION:]) / self.known.lag
        force = (_loads(self.model, x, slope, 1.0) - self.offset)[:3] / self.known.mass
        q = exponential(x[:3])
        if not self.model.with_gravity:
            force = force - rotate_inverse(q, np.array([0.0, 0.0, GRAVITY]))
        return np.concatenate([q, x[3:], force, np.zeros(6)])


def _loads(model: Model, x: np.ndarray, slope: np.ndarray, angles: float) -> np.ndarray:
    """Forces and moments (6,); small rotation vectors are Euler angles to first order."""
    state = np.concatenate([angles * x[:3], x[3:_MOTION]])[None]
    further = dict(zip(model.inputs[20:], extras(model)))
    force, moment = model.predict(state, x[None, _MOTION:], slope[None], further)
    return np.concatenate([force[0], moment[0]])


def _slopes(function: Any, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives by state and input, central differences; steps of 1e-5, for speeds relative."""
    steps = np.where(np.arange(len(x)) < _MOTION, 1e-5, 1e-5 * x[-1])
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
    seen: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Matrices of the controller: next memory by memory and by what is seen, commands by memory and by what is seen."""
    kind, parameters, size = c.make_controller(settings, model, actuators, offset)
    goal, memory = np.zeros(GOAL), np.zeros(size)
    goal[THRUST] = np.nan
    goal[PLACE : PLACE + 3] = seen[10:13]
    commands = np.zeros(4)
    for _ in range(3):
        c.controller_step(kind, parameters, memory, 0.0, dt, seen, goal, commands)
    squares = seen[13] ** 2
    places = {  # what the controller remembers: (first, how many, size of a small step)
        g.PID: ((c.SENT, 4, squares), (INTEGRAL, 3, 1.0), (c.RATE_INTEGRAL, 3, 1.0), (c.RATES, 9, 1.0)),
        g.NDI: ((c.SENT, 4, squares), (INTEGRAL, 3, 1.0)),
        g.INDI: ((c.SENT, 4, squares), (c.RATES, 9, 1.0), (c.SQUARES, 12, squares), (c.OTHER, 9, 1.0)),
    }[kind]
    entries = np.concatenate([np.arange(first, first + n) for first, n, _ in places])
    steps = np.concatenate([np.full(n, 1e-6 * s) for _, n, s in places])

    def act(entry: int | None, by: float, sees: np.ndarray) -> np.ndarray:
        trial = memory.copy()
        if entry is not None:
            trial[entry] += by
        out = np.zeros(4)
        c.controller_step(kind, parameters, trial, 0.0, dt, sees, goal, out)
        return np.concatenate([trial[entries], out])

    by_memory = np.column_stack([(act(e, s, seen) - act(e, -s, seen)) / (2 * s) for e, s in zip(entries, steps)])
    small = np.where((np.arange(26) >= 13) & (np.arange(26) < 17), 1e-6 * seen[13], 1e-6)
    by_seen = np.column_stack(
        [(act(None, 0.0, seen + d) - act(None, 0.0, seen - d)) / (2 * s) for s, d in zip(small, np.diag(small))]
    )
    # squared speeds are millions: in units of the steps the matrices are well balanced
    n, unit = len(entries), 1e6 * steps
    return by_memory[:n] * unit / unit[:, None], by_seen[:n] / unit[:, None], by_memory[n:] * unit, by_seen[n:]


def _response(loop: Loop, frequencies: np.ndarray) -> np.ndarray:
    """Loop transfer (F, 4, 4), negative feedback counted in: -1 is the critical point."""
    # one Schur form serves all frequencies, and does not mind repeated eigenvalues (rows of integrators)
    triangle, turn = schur(loop.a, output="complex")
    out = np.empty((len(frequencies), 4, 4), complex)
    _solve_at(triangle, turn.conj().T @ loop.b, loop.c @ turn, np.exp(1j * frequencies * loop.dt), out)
    return out


@njit(cache=True)
def _solve_at(triangle, left, right, z, out):
    """out[f] = -right (z[f] - triangle)^-1 left, triangle (n, n) upper triangular."""
    n = len(triangle)
    x = np.empty((n, left.shape[1]), np.complex128)
    for f in range(len(z)):
        for j in range(left.shape[1]):
            for i in range(n - 1, -1, -1):
                value = left[i, j]
                for k in range(i + 1, n):
                    value += triangle[i, k] * x[k, j]
                x[i, j] = value / (z[f] - triangle[i, i])
            for i in range(len(right)):
                value = 0j
                for k in range(n):
                    value -= right[i, k] * x[k, j]
                out[f, i, j] = value


def _one_open(loop: np.ndarray, k: int) -> np.ndarray:
    """Transfer of direction k with the others closed."""
    others = [i for i in range(4) if i != k]
    rest = loop[:, others][:, :, others] + np.eye(3)
    back = np.linalg.solve(rest, loop[:, others, k][:, :, None])
    return loop[:, k, k] - np.einsum("fi,fi->f", loop[:, k, others], back[:, :, 0])


def _margin(l: np.ndarray, frequencies: np.ndarray) -> Margin:
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
    # only a lag is made worse by a delay: the way round to -180 degrees, downwards
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
