"""Run a closed loop: to its end, in chunks, or as a batch.

result = simulate(setup)                                            compiled
result = simulate(setup, steps={"actuator": my_actuator})           in Python, with a user's step
many = simulate_many(setup, 1000, x=..., mass=...)                  compiled, on all threads
"""

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from quasi.attitude import GRAVITY
from quasi.errors import ConfigError, ShapeError, nearest
from quasi.simulation.loop.batch import BatchParameters, make_block_memory, run_batch_part
from quasi.simulation.loop.closed_loop import (
    EXTERNAL_REFERENCE,
    FAULT_SIZE,
    FULL_LOG_SIZE,
    LOG_STATE,
    SHORT_LOG_SIZE,
    STATUS_FINE,
    run_loop,
)
from quasi.simulation.loop.divergence import explain_end, recompute_state_before
from quasi.simulation.loop.result import Result, make_result
from quasi.simulation.loop.setup import STATE_NAMES, Setup
from quasi.simulation.vehicle.dynamics import INTEGRATORS, append_extra_states, make_scratch
from quasi.simulation.vehicle.layout import ADDED_GRAVITY, INERTIA, INVERSE_INERTIA, MASS, STATE_SIZE
from quasi.terms.lanes import LANES


def simulate(
    setup: Setup, steps: Mapping[str, Callable] | None = None, between: Mapping[str, Callable] | None = None
) -> Result:
    """Run a closed loop to its end, or until it diverges.

    steps    functions of the bus that replace steps, {"actuator": function}; see `simulator`
    between  functions of the bus called after a step, {"controller": function}
    With either, or with an adaptive integrator, the loop runs in Python; both loops give the same numbers.
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
    log = np.empty((setup.steps // setup.every + 1, FULL_LOG_SIZE + setup.extra_states))
    loop_state, scratch = setup.make_loop_state(), make_scratch(setup.loop_parameters.kernel, setup.extra_states)
    status, done, rows = run_loop(setup.loop_parameters, loop_state, scratch, 0, setup.steps, setup.every, log, True)
    # where the loads are undefined within a step, the state before it shows which of them
    last = None if status == STATUS_FINE or np.isfinite(loop_state.x).all() else recompute_state_before(setup, done)
    return make_result(setup, log[:rows], status, done, last, loop_state.x)


class Session:
    """A simulation that runs in chunks, for live flights.

    by_hand  True: the setpoint is given with each `advance`; False: it follows the reference of its setup
    dt s, one step; t s, present time; duration s; weight N
    """

    def __init__(self, setup: Setup, by_hand: bool = True) -> None:
        self._setup = (
            replace(setup, loop_parameters=setup.loop_parameters._replace(reference=EXTERNAL_REFERENCE))
            if by_hand
            else setup
        )
        self._by_hand = by_hand
        self.dt, self.duration = setup.dt, setup.steps * setup.dt
        self.weight = float(setup.airframe.mass) * GRAVITY
        self.restart()

    def restart(self) -> None:
        """Restart the simulation."""
        self._loop_state = self._setup.make_loop_state()
        self._scratch = make_scratch(self._setup.loop_parameters.kernel, self._setup.extra_states)
        self._steps = 0

    @property
    def t(self) -> float:
        """Simulated time, s."""
        return self._steps * self.dt

    def state(self) -> np.ndarray:
        """(17,) attitude w x y z, u v w, p q r, x y z, rotor speeds."""
        return self._loop_state.x[:STATE_SIZE].copy()

    def setpoint(self) -> np.ndarray:
        """(20,) setpoint of the last step, see `outer_loop`."""
        return self._loop_state.setpoint.copy()

    def advance(self, setpoint: np.ndarray | None, steps: int) -> str | None:
        """Run this many steps; return a sentence when the simulation ends early.

        setpoint  (20,) the setpoint of a flight by hand; None to follow the setup's reference
        """
        if self._by_hand:
            self._loop_state.setpoint[:] = setpoint
        log = np.empty((steps, SHORT_LOG_SIZE))
        status, done, _ = run_loop(
            self._setup.loop_parameters, self._loop_state, self._scratch, self._steps, steps, 1, log, False
        )
        self._steps += done
        return explain_end(self._setup, status, self._steps, after=self._loop_state.x)


@dataclass(frozen=True)
class BatchResult:
    """Result of a batch: t (R,) s; states (B, R, 17); status, steps (B,); rows after a divergence are NaN."""

    t: np.ndarray
    states: np.ndarray
    status: np.ndarray
    steps: np.ndarray

    def stopped(self, setup: Setup, b: int) -> str | None:
        """Explain why simulation b ended early, or None."""
        return explain_end(setup, int(self.status[b]), int(self.steps[b]))


BATCH_SHAPES = {
    "x": (STATE_SIZE,),
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
) -> BatchResult:
    """Run a batch of simulations that differ from a setup, on all threads.

    count   B simulations; seeds (B,) of noise and gusts, else consecutive ones from the setup's
    every   steps between two rows of the result; None gives about 100 rows
    varied  rows that replace the setup's values, (B, ...): x (17,) initial state with payload and inflow trimmed, or
            (17 + extra states,) including them; mass kg; inertia (3, 3) kg m2;
            fault_time s, effectiveness (4,), cap (4,) rad/s of a fault; wind, gusts (3,) m/s;
            gains of the controller, path of the reference (their parameters, see `controllers`, `references`)
    Raises ConfigError for an unknown name, ShapeError for rows of a wrong shape.
    """
    loop_parameters = setup.loop_parameters
    if setup.settings["simulation"]["integrator"] not in INTEGRATORS:
        raise ConfigError("a batch needs the integrator 'rk4' or 'euler'; choose one of them")
    for name, rows in varied.items():
        if name not in BATCH_SHAPES:
            raise ConfigError(f"a batch cannot vary '{name}'{nearest(name, BATCH_SHAPES)}")
        shape = BATCH_SHAPES[name] if BATCH_SHAPES[name] is not None else getattr(loop_parameters, name).shape
        if name == "x" and np.shape(rows) == (count, len(setup.start)):
            shape = setup.start.shape
        if np.shape(rows) != (count, *shape):
            raise ShapeError(f"'{name}' of a batch must be {(count, *shape)}, got {np.shape(rows)}")
        if not np.all(np.isfinite(rows)) and name not in ("fault_time", "cap"):
            raise ShapeError(f"'{name}' of a batch holds a number that is not finite")

    def rows_of(own: np.ndarray) -> np.ndarray:
        return np.tile(np.asarray(own, float), (count, *[1] * np.ndim(own)))

    body, fault, wind = rows_of(loop_parameters.body), rows_of(loop_parameters.fault), rows_of(loop_parameters.wind)
    if "mass" in varied:
        body[:, MASS] = varied["mass"]
        # net forces hold the weight of the model's own mass
        held = loop_parameters.body[MASS] * (GRAVITY - loop_parameters.body[ADDED_GRAVITY])
        body[:, ADDED_GRAVITY] = GRAVITY - held / body[:, MASS]
    if "inertia" in varied:
        inertia = np.asarray(varied["inertia"], float)
        body[:, INERTIA : INERTIA + 9] = inertia.reshape(count, 9)
        body[:, INVERSE_INERTIA : INVERSE_INERTIA + 9] = np.linalg.inv(inertia).reshape(count, 9)
    for name, part in (("fault_time", 0), ("effectiveness", slice(1, 5)), ("cap", slice(5, FAULT_SIZE))):
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
        step_inputs = setup.make_first_step_inputs()
        starts = np.array(
            [append_extra_states(x, step_inputs, loop_parameters.kernel, b) for x, b in zip(varied["x"], body)]
        )
    first = np.arange(count, dtype=np.uint64)
    if seeds is None:
        both = np.column_stack([first + np.uint64(setup.seeds[0]), first + np.uint64(setup.seeds[1])])
    else:
        both = np.column_stack([np.asarray(seeds, np.uint64)] * 2)
    random_numbers = BatchParameters(
        np.ascontiguousarray(starts, float), np.ascontiguousarray(both), body, fault,
        wind, np.ascontiguousarray(varied.get("gains", rows_of(loop_parameters.gains)), float),
        np.ascontiguousarray(varied.get("path", rows_of(loop_parameters.path)), float),
    )  # fmt: skip
    every = max(setup.steps // 100, 1) if every is None else every
    logs = np.full((count, setup.steps // every + 1, SHORT_LOG_SIZE), np.nan)
    status, done = np.zeros(count, np.int64), np.zeros(count, np.int64)
    threads = max(min(os.cpu_count() or 1, count), 1)
    part = LANES * max(count // (8 * threads * LANES), 1)

    def work(begin: int, end: int) -> None:
        room = make_block_memory(loop_parameters, setup.extra_states, setup.memory)
        run_batch_part(
            loop_parameters, random_numbers, begin, end, setup.memory, setup.steps, every, logs, status, done, room
        )

    work(0, 0)  # an empty part comes first, so that the kernel is compiled once
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda begin: work(begin, min(begin + part, count)), range(0, count, part)))
    t = np.arange(logs.shape[1]) * every * loop_parameters.dt
    return BatchResult(t, logs[:, :, LOG_STATE : LOG_STATE + len(STATE_NAMES)], status, done)
