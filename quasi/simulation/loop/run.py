"""Ways to run a closed loop: whole, in chunks, and as a batch.

result = simulate(setup)                                            compiled
result = simulate(setup, steps={"actuator": my_actuator})           in Python, with a step of the user's own
many = simulate_many(setup, 1000, x=..., mass=...)                  compiled, on all threads
"""

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from quasi.attitude import GRAVITY
from quasi.errors import ConfigError, ShapeError, nearest
from quasi.simulation.loop.closed_loop import EXTERNAL, FAULT, FINE, LOG, SHORT_LOG, Draws, X, fly, fly_some
from quasi.simulation.loop.divergence import explain_end, state_before
from quasi.simulation.loop.result import Result, result_of
from quasi.simulation.loop.setup import STATE_NAMES, Setup
from quasi.simulation.vehicle.dynamics import INTEGRATORS, scratch_of, with_rest
from quasi.simulation.vehicle.layout import INERTIA, INVERSE, MASS, STATES


def simulate(
    setup: Setup,
    steps: Mapping[str, Callable] | None = None,
    between: Mapping[str, Callable] | None = None,
) -> Result:
    """Run a closed loop to its end, or until it diverges.

    steps    functions of the bus that take the place of steps, {"actuator": function}; see `simulator`
    between  functions of the bus called after a step, {"controller": function}
    With either, or an adaptive integrator, the loop runs in Python, else compiled; both give the same numbers.
    """
    method = setup.settings["simulation"]["integrator"]
    adaptive = None if method in INTEGRATORS else method
    if steps or between or adaptive:
        from quasi.simulation.loop.python_loop import QuadrotorSimulator

        simulator = QuadrotorSimulator(setup, adaptive)
        simulator.steps |= dict(steps or {})
        for after, function in (between or {}).items():
            simulator.add_step(after, function)
        return simulator.fly()
    log = np.empty((setup.steps // setup.every + 1, LOG + setup.own))
    live, scratch = setup.live(), scratch_of(setup.machine.kernel, setup.own)
    status, done, rows = fly(setup.machine, live, scratch, 0, setup.steps, setup.every, log, True)
    # where the model loses its forces within a step, the state before it shows which
    last = None if status == FINE or np.isfinite(live.x).all() else state_before(setup, done)
    return result_of(setup, log[:rows], status, done, last, live.x)


class Session:
    """A simulation that goes on in chunks: what live flying needs.

    by_hand  True: its setpoint comes with each `advance`; False: it follows the reference of its setup
    dt s, one step; t s, now; duration s; weight N
    """

    def __init__(self, setup: Setup, by_hand: bool = True) -> None:
        self._setup = replace(setup, machine=setup.machine._replace(reference=EXTERNAL)) if by_hand else setup
        self._by_hand = by_hand
        self.dt, self.duration = setup.dt, setup.steps * setup.dt
        self.weight = float(setup.airframe.mass) * GRAVITY
        self.restart()

    def restart(self) -> None:
        """Begin again."""
        self._live = self._setup.live()
        self._scratch = scratch_of(self._setup.machine.kernel, self._setup.own)
        self._steps = 0

    @property
    def t(self) -> float:
        """Simulated time, s."""
        return self._steps * self.dt

    def state(self) -> np.ndarray:
        """(17,) attitude w x y z, u v w, p q r, x y z, rotor speeds."""
        return self._live.x[:STATES].copy()

    def setpoint(self) -> np.ndarray:
        """(20,) what was asked for in the last step, see `outer_loop`."""
        return self._live.goal.copy()

    def advance(self, goal: np.ndarray | None, steps: int) -> str | None:
        """Go on by so many steps; a sentence when the simulation cannot go on.

        goal  (20,) the setpoint of a flight by hand; None where the setup's reference is followed
        """
        if self._by_hand:
            self._live.goal[:] = goal
        log = np.empty((steps, SHORT_LOG))
        status, done, _ = fly(self._setup.machine, self._live, self._scratch, self._steps, steps, 1, log, False)
        self._steps += done
        return explain_end(self._setup, status, self._steps, after=self._live.x)


@dataclass(frozen=True)
class Many:
    """A batch that has run: t (R,) s; states (B, R, 17); status, steps (B,); rows beyond a divergence hold NaN."""

    t: np.ndarray
    states: np.ndarray
    status: np.ndarray
    steps: np.ndarray

    def stopped(self, setup: Setup, b: int) -> str | None:
        """Why simulation b ended before its time, or None."""
        return explain_end(setup, int(self.status[b]), int(self.steps[b]))


VARIED = {
    "x": (STATES,),
    "mass": (),
    "inertia": (3, 3),
    "fault_time": (),
    "effectiveness": (4,),
    "cap": (4,),
    "wind": (3,),
    "gusts": (3,),
    "gains": None,
    "path": None,
}


def simulate_many(
    setup: Setup, count: int, seeds: np.ndarray | None = None, every: int | None = None, **varied: np.ndarray
) -> Many:
    """Run a batch of simulations that differ from a setup, on all threads.

    count   B simulations; seeds (B,) of noise and gusts, else the setup's seed and those after it
    every   steps between two rows of the result, else such that there are about 100
    varied  rows that replace the setup's own, (B, ...): x (17,) initial state, parts with states of their own at rest,
            or (17 + own,) with these; mass kg; inertia (3, 3) kg m2;
            fault_time s, effectiveness (4,), cap (4,) rad/s of a fault; wind, gusts (3,) m/s;
            gains of the controller, path of the reference (their parameters, see `controllers`, `references`)
    Raises ConfigError for an unknown name, ShapeError for rows of a wrong shape.
    """
    machine = setup.machine
    if setup.settings["simulation"]["integrator"] not in INTEGRATORS:
        raise ConfigError("a batch needs the integrator 'rk4' or 'euler'; choose one of them")
    for name, rows in varied.items():
        if name not in VARIED:
            raise ConfigError(f"a batch cannot vary '{name}'{nearest(name, VARIED)}")
        shape = VARIED[name] if VARIED[name] is not None else getattr(machine, name).shape
        if name == "x" and np.shape(rows) == (count, len(setup.start)):
            shape = setup.start.shape
        if np.shape(rows) != (count, *shape):
            raise ShapeError(f"'{name}' of a batch must be {(count, *shape)}, got {np.shape(rows)}")
        if not np.all(np.isfinite(rows)) and name not in ("fault_time", "cap"):
            raise ShapeError(f"'{name}' of a batch holds a number that is not finite")

    def rows_of(own: np.ndarray) -> np.ndarray:
        return np.tile(np.asarray(own, float), (count, *[1] * np.ndim(own)))

    body, fault, wind = rows_of(machine.body), rows_of(machine.fault), rows_of(machine.wind)
    if "mass" in varied:
        body[:, MASS] = varied["mass"]
    if "inertia" in varied:
        inertia = np.asarray(varied["inertia"], float)
        body[:, INERTIA : INERTIA + 9] = inertia.reshape(count, 9)
        body[:, INVERSE : INVERSE + 9] = np.linalg.inv(inertia).reshape(count, 9)
    for name, part in (("fault_time", 0), ("effectiveness", slice(1, 5)), ("cap", slice(5, FAULT))):
        if name in varied:
            fault[:, part] = varied[name]
    if "wind" in varied:
        wind[:, :3] = varied["wind"]
    if "gusts" in varied:
        wind[:, 3:6] = varied["gusts"]
    starts = rows_of(setup.start)
    if "x" in varied and np.shape(varied["x"])[1] == len(setup.start):
        starts = varied["x"]
    elif "x" in varied:
        held = setup.held()
        starts = np.array([with_rest(x, held, machine.kernel, b) for x, b in zip(varied["x"], body)])
    first = np.arange(count, dtype=np.uint64)
    if seeds is None:
        both = np.column_stack([first + np.uint64(setup.seeds[0]), first + np.uint64(setup.seeds[1])])
    else:
        both = np.column_stack([np.asarray(seeds, np.uint64)] * 2)
    draws = Draws(
        np.ascontiguousarray(starts, float), np.ascontiguousarray(both), body, fault,
        wind, np.ascontiguousarray(varied.get("gains", rows_of(machine.gains)), float),
        np.ascontiguousarray(varied.get("path", rows_of(machine.path)), float),
    )  # fmt: skip
    every = max(setup.steps // 100, 1) if every is None else every
    logs = np.full((count, setup.steps // every + 1, SHORT_LOG), np.nan)
    status, done = np.zeros(count, np.int64), np.zeros(count, np.int64)
    threads = max(min(os.cpu_count() or 1, count), 1)
    part = max(count // (8 * threads), 1)

    def work(begin: int) -> None:
        end = min(begin + part, count)
        fly_some(machine, draws, begin, end, setup.memory, setup.steps, every, logs, status, done)

    work(0)  # the first part alone, so that it is compiled once and not by every thread
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, range(part, count, part)))
    t = np.arange(logs.shape[1]) * every * machine.dt
    return Many(t, logs[:, :, X : X + len(STATE_NAMES)], status, done)
