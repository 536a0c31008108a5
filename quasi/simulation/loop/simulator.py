"""A simulation of any system, step by step in Python; a user can replace every step by a function.

Order of a step k (QuaSI user manual V1.0.a, figure 23), with what each writes to the bus:

    begin                 measurement, wind and reference before the controller
    controller            bus.commanded_inputs[k + 1]
    actuator              bus.inputs[k + 1]
    forces_and_moments    bus.forces[k + 1], bus.moments[k + 1]
    equations_of_motion   bus.state_derivative[k + 1]
    integrator            bus.state[k + 1]

Each step is a function of the bus alone. Replace one by simulator.steps["actuator"] = my_actuator. The built-in step
remains available as bus.actuator and so on, so that the new one can call it. `add_step` inserts further steps, and
`add_signal` adds further signals to the bus.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from quasi.errors import ConfigError, DataError, ShapeError, nearest

STEP_ORDER = ("begin", "controller", "actuator", "forces_and_moments", "equations_of_motion", "integrator")
_METHODS = ("euler", "rk4", "RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA")  # the latter of scipy's solve_ivp
_MAX_STATE = 1e12  # in any unit; a larger state has diverged
_ADDED_ROWS = 1024  # rows added at a time to a simulation without an end
Step = Callable[["Bus"], Any]


class Bus:
    """Data that the steps of a simulation share; arrays are indexed by the step.

    time (N + 1,) s; duration s or None; time_step s; step: the present k
    state, measured_state, state_derivative (N + 1, X); reference (N + 1, R); inputs, commanded_inputs (N + 1, U)
    forces (N + 1, 3) N, moments (N + 1, 3) N m; quaternion (N + 1, 4) or None
    model, controller, actuator, forces_and_moments, equations_of_motion, integrator: the simulation's own steps
    signals: added by users, by name; bus["name"] reads one and bus["name"] = value writes it
    """

    def __init__(self) -> None:
        self.time = np.zeros(0)
        self.duration: float | None = None
        self.time_step = 0.0
        self.step = 0
        self.state = self.measured_state = self.state_derivative = np.zeros((0, 0))
        self.reference = self.inputs = self.commanded_inputs = np.zeros((0, 0))
        self.forces = self.moments = np.zeros((0, 3))
        self.quaternion: np.ndarray | None = None
        self.model: Any = None
        self.controller: Step | None = None
        self.actuator: Step | None = None
        self.forces_and_moments: Step | None = None
        self.equations_of_motion: Step | None = None
        self.integrator: Step | None = None
        self.integrator_options: dict[str, Any] = {}
        self.signals: dict[str, Any] = {}
        self.setup: Any = None  # of a quadrotor: see quasi.simulation.loop.python_loop
        self.loop_state: Any = None

    def __getitem__(self, name: str) -> Any:
        if name not in self.signals:
            raise ConfigError(
                f"the simulation has no signal '{name}'{nearest(name, self.signals)}; add it with add_signal"
            )
        return self.signals[name]

    def __setitem__(self, name: str, value: Any) -> None:
        self.signals[name] = value


class Simulator:
    """A simulation whose steps are functions of the bus.

    model                any object that the steps use; it is on the bus
    controller, actuator, forces_and_moments, equations_of_motion  functions of the bus: commanded inputs (U,), inputs
                         (U,), (forces (3,), moments (3,)), state derivative (X,). None leaves a step out: no controller
                         keeps the commanded inputs, no actuator passes them on
    integrator           "euler", "rk4", the name of a method of scipy's solve_ivp ("RK45", "DOP853", "Radau" ...), or a
                         function of the bus that returns the next state
    run_mode             "finite", or "infinite" with a condition set by `set_termination`
    quaternion           (first entry of a unit quaternion in the state) or None: it is kept at unit length
    """

    _trusts_built_in = False  # whether the outputs of the built-in steps need no check

    def __init__(
        self,
        model: Any,
        equations_of_motion: Step,
        controller: Step | None = None,
        actuator: Step | None = None,
        forces_and_moments: Step | None = None,
        integrator: str | Step = "rk4",
        run_mode: str = "finite",
        quaternion: int | None = None,
    ) -> None:
        if run_mode not in ("finite", "infinite"):
            raise ConfigError(f"run_mode is {run_mode!r}{nearest(run_mode, ('finite', 'infinite'))}")
        self.bus = Bus()
        self.bus.model = model
        self.run_mode = run_mode
        self.stopped: str | None = None  # why the simulation ended before its time
        self.limits: np.ndarray | None = None
        self._last_loads: tuple[np.ndarray, ...] = (np.zeros(3), np.zeros(3))  # the latest forces and moments
        self.state_names: list[str] = []
        built_in = {
            "begin": None,
            "controller": controller,
            "actuator": actuator,
            "forces_and_moments": forces_and_moments,
            "equations_of_motion": equations_of_motion,
            "integrator": integrator if callable(integrator) else self._integrate,
        }
        self._method = integrator if isinstance(integrator, str) else "own"
        if self._method not in (*_METHODS, "own"):
            raise ConfigError(f"integrator '{self._method}' is not known{nearest(self._method, _METHODS)}")
        self._built_in: dict[str, Step | None] = built_in
        self.steps: dict[str, Step | None] = dict(built_in)
        self._added_steps: dict[str, list[Step]] = {name: [] for name in STEP_ORDER}
        self._quaternion = quaternion
        self._recorded_signals: dict[str, list] = {}
        self._condition: Callable[[Bus], bool] | None = None
        for name in STEP_ORDER[1:]:
            setattr(self.bus, name, built_in[name])

    def set_initial(
        self,
        state: np.ndarray,
        inputs: np.ndarray,
        time_step: float,
        duration: float | None = None,
        reference: np.ndarray | None = None,
    ) -> None:
        """Set the initial state, inputs and reference.

        state (X,); inputs (U,); time_step s; duration s, None in infinite mode
        reference  (R,) for all times, or (N + 1, R) by step; the last row also holds beyond its end
        Raises ConfigError or ShapeError.
        """
        state, inputs = np.atleast_1d(np.asarray(state, float)), np.atleast_1d(np.asarray(inputs, float))
        if not (math.isfinite(time_step) and time_step > 0.0):
            raise ConfigError(f"the time step is {time_step!r}, expected a positive number of seconds")
        if self.run_mode == "finite" and not (duration is not None and math.isfinite(duration) and duration > 0.0):
            raise ConfigError(f"the duration is {duration!r}, expected a positive number of seconds in finite mode")
        for name, values in (("state", state), ("inputs", inputs)):
            if values.ndim != 1 or not np.all(np.isfinite(values)):
                raise ShapeError(f"the initial {name} must be one row of finite numbers, got {values!r}")
        bus = self.bus
        bus.time_step, bus.duration = time_step, duration if self.run_mode == "finite" else None
        self._steps = round(duration / time_step) if bus.duration is not None else None
        rows = (self._steps if self._steps is not None else _ADDED_ROWS) + 2
        bus.time = np.arange(rows) * time_step
        for name in ("state", "measured_state", "state_derivative"):
            setattr(bus, name, np.zeros((rows, len(state))))
        for name in ("inputs", "commanded_inputs"):
            setattr(bus, name, np.tile(inputs, (rows, 1)))
        bus.forces, bus.moments = np.zeros((rows, 3)), np.zeros((rows, 3))
        given = np.zeros((1, len(state))) if reference is None else np.atleast_2d(np.asarray(reference, float))
        bus.reference = given[np.minimum(np.arange(rows), len(given) - 1)]
        bus.state[0] = bus.measured_state[0] = state
        bus.quaternion = None if self._quaternion is None else np.zeros((rows, 4))
        bus.step = 0
        self.stopped = None
        self._recorded_signals = {name: [] for name in self._recorded_signals}

    def set_termination(self, condition: Callable[[Bus], bool]) -> None:
        """Continue only while this function of the bus returns True; it is called after each step."""
        self._condition = condition

    def add_signal(self, name: str, value: Any, record: bool = False) -> None:
        """Add a signal to the bus as bus[name]; with `record` its value after each step is stored.

        The table then has the column `name`, or `name_1`, `name_2` ... for a vector.
        """
        self.bus.signals[name] = value
        if record:
            self._recorded_signals[name] = []

    def add_step(self, after: str, function: Step) -> None:
        """Call a function of the bus after one of STEP_ORDER in every step; its result is not used."""
        if after not in STEP_ORDER:
            raise ConfigError(f"no step is called '{after}'{nearest(after, STEP_ORDER)}")
        if not callable(function):
            raise ConfigError(f"the function after the step '{after}' is {function!r}, expected a function of the bus")
        self._added_steps[after].append(function)

    def run(self) -> Bus:
        """Run to the end, or until the termination condition is False; return the bus.

        A state beyond its limits stops the simulation: `stopped` names it and the time; earlier rows remain.
        Raises ConfigError for a missing setting, DataError naming the step when a step gives NaN or a wrong shape.
        """
        bus = self.bus
        if not len(bus.time):
            raise ConfigError("the simulation has no initial state; call set_initial before run")
        if self.run_mode == "infinite" and self._condition is None:
            # a step that shows the simulation ends it when its window is closed
            shown = [f for steps in self._added_steps.values() for f in steps if hasattr(f, "is_open")]
            self._condition = shown[0].is_open if shown else None
        if self.run_mode == "infinite" and self._condition is None:
            raise ConfigError("a simulation in infinite mode needs a condition to end; set it with set_termination")
        unknown = [name for name in self.steps if name not in STEP_ORDER]
        if unknown:
            raise ConfigError(f"no step is called '{unknown[0]}'{nearest(unknown[0], STEP_ORDER)}")
        for name, step in self.steps.items():
            if step is not None and not callable(step):
                raise ConfigError(f"the step '{name}' is {step!r}, expected a function of the bus")
        while True:
            self._run_step(bus)
            last = self._steps is not None and bus.step >= self._steps
            self._record_signals(bus)
            if last or self.stopped or (self._condition is not None and not self._condition(bus)):
                return bus

    def _run_step(self, bus: Bus) -> None:
        k = bus.step
        if k + 2 > len(bus.time) - 1:
            self._add_rows(bus)
        self._evaluate_inputs(bus)
        self._evaluate_physics(bus)
        self._run_added_steps("equations_of_motion", bus)
        bus.state[k + 1] = self._next_state(bus)
        if self._quaternion is not None:
            part = slice(self._quaternion, self._quaternion + 4)
            bus.quaternion[k] = bus.state[k, part]
            bus.quaternion[k + 1] = bus.state[k + 1, part]
        self._run_added_steps("integrator", bus)
        self._check_state(bus)
        bus.step = k + 1

    def _evaluate_inputs(self, bus: Bus) -> None:
        """Evaluate the steps before the physics: begin, controller, actuator."""
        k, steps = bus.step, self.steps
        if steps["begin"] is not None:
            steps["begin"](bus)
        self._run_added_steps("begin", bus)
        controller, actuator = steps["controller"], steps["actuator"]
        if controller is not None:
            bus.commanded_inputs[k + 1] = self._check_output(controller(bus), "controller", bus.commanded_inputs[k])
        else:
            bus.commanded_inputs[k + 1] = bus.commanded_inputs[k]
        self._run_added_steps("controller", bus)
        if actuator is not None:
            bus.inputs[k + 1] = self._check_output(actuator(bus), "actuator", bus.inputs[k])
        else:
            bus.inputs[k + 1] = bus.commanded_inputs[k + 1]
        self._run_added_steps("actuator", bus)

    def _evaluate_physics(self, bus: Bus) -> None:
        """Evaluate forces, moments and the state derivative at the beginning of the step, for the log."""
        k = bus.step
        if self.steps["forces_and_moments"] is not None:
            bus.forces[k + 1], bus.moments[k + 1] = self._evaluate_loads(bus)
        self._run_added_steps("forces_and_moments", bus)
        derivative = self.steps["equations_of_motion"](bus)
        bus.state_derivative[k + 1] = self._check_output(derivative, "equations_of_motion", bus.state[k])

    def _evaluate_loads(self, bus: Bus) -> tuple[np.ndarray, np.ndarray]:
        found = self.steps["forces_and_moments"](bus)
        try:
            forces, moments = found
        except (TypeError, ValueError):
            raise DataError(
                f"{self._describe_step('forces_and_moments', bus)} returned {found!r}, "
                "expected forces (3,) and moments (3,)"
            ) from None
        zero = bus.forces[0]
        self._last_loads = tuple(self._check_output(part, "forces_and_moments", zero) for part in (forces, moments))
        return self._last_loads

    def _next_state(self, bus: Bus) -> np.ndarray:
        if self.steps["integrator"] is self._built_in["integrator"] and self._method != "own":
            return self._integrate(bus)
        return self._check_output(self.steps["integrator"](bus), "integrator", bus.state[bus.step])

    def evaluate_derivative(self, state: np.ndarray) -> np.ndarray:
        """Evaluate the state derivative (X,) at a trial state of the present step, with unchanged inputs.

        bus.state[bus.step] is the trial state during the call.
        """
        bus, k = self.bus, self.bus.step
        kept, forces, moments = bus.state[k].copy(), bus.forces[k + 1].copy(), bus.moments[k + 1].copy()
        bus.state[k] = state
        try:
            if self.steps["forces_and_moments"] is not None:
                bus.forces[k + 1], bus.moments[k + 1] = self._evaluate_loads(bus)
            return self._check_output(self.steps["equations_of_motion"](bus), "equations_of_motion", kept)
        finally:
            bus.state[k], bus.forces[k + 1], bus.moments[k + 1] = kept, forces, moments

    def _integrate(self, bus: Bus) -> np.ndarray:
        """Integrate one step with the selected method."""
        dt, k = bus.time_step, bus.step
        state, first = bus.state[k].copy(), bus.state_derivative[k + 1]
        if self._method == "euler":
            result = state + dt * first
        elif self._method == "rk4":
            second = self.evaluate_derivative(state + 0.5 * dt * first)
            third = self.evaluate_derivative(state + 0.5 * dt * second)
            fourth = self.evaluate_derivative(state + dt * third)
            result = state + dt / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        else:
            result = self._integrate_adaptively(state, dt)
        if self._quaternion is not None:
            part = slice(self._quaternion, self._quaternion + 4)
            result[part] /= math.sqrt(float(result[part] @ result[part]))
        return result

    def _integrate_adaptively(self, state: np.ndarray, dt: float) -> np.ndarray:
        from scipy.integrate import solve_ivp

        options = {"rtol": 1e-9, "atol": 1e-12, **self.bus.integrator_options}
        found = solve_ivp(lambda _, y: self.evaluate_derivative(y), (0.0, dt), state, method=self._method, **options)
        if not found.success:
            raise DataError(
                f"the integrator {self._method} failed at t = {self.bus.time[self.bus.step]:.6g} s ({found.message}); "
                "use a shorter time step"
            )
        return found.y[:, -1]

    def _run_added_steps(self, after: str, bus: Bus) -> None:
        for function in self._added_steps[after]:
            function(bus)

    def _check_output(self, values: Any, name: str, like: np.ndarray) -> np.ndarray:
        """Check that a step returned finite numbers of the expected shape; return them as an array."""
        if self._trusts_built_in and self.steps[name] is self._built_in[name]:
            return values
        try:
            values = np.asarray(values, float).reshape(like.shape)
        except (TypeError, ValueError):
            raise DataError(
                f"{self._describe_step(name, self.bus)} returned {values!r}, "
                f"expected {len(like)} numbers; correct the step"
            ) from None
        if not np.all(np.isfinite(values)):
            entry = int(np.flatnonzero(~np.isfinite(values))[0])
            raise DataError(
                f"{self._describe_step(name, self.bus)} returned {values[entry]} as entry {entry}; correct the step, "
                "or end the simulation earlier with set_termination"
            )
        return values

    def _describe_step(self, name: str, bus: Bus) -> str:
        function = self.steps[name]
        called = getattr(function, "__qualname__", type(function).__name__)
        return f"the step '{name}' ({called}) at t = {bus.time[bus.step]:.6g} s"

    def _check_state(self, bus: Bus) -> None:
        state = bus.state[bus.step + 1]
        limits = _MAX_STATE if self.limits is None else self.limits
        bad = ~(np.abs(state) <= limits) | ~np.isfinite(state)
        if bad.any():
            entry = int(np.flatnonzero(bad)[0])
            name = self.state_names[entry] if self.state_names else f"state {entry}"
            self.stopped = (
                f"diverged at t = {bus.time[bus.step + 1]:.6g} s: {name} became {state[entry]:.4g}; "
                "use a shorter time step, or gentler gains"
            )

    def _record_signals(self, bus: Bus) -> None:
        for name, rows in self._recorded_signals.items():
            value = bus.signals[name]
            rows.append(np.array(value, float) if np.ndim(value) else float(value))

    def _add_rows(self, bus: Bus) -> None:
        """Extend the arrays by half their rows, as copies of the last row."""
        old = len(bus.time)
        more = max(_ADDED_ROWS, old // 2)
        bus.time = np.arange(old + more) * bus.time_step
        names = ("state", "measured_state", "state_derivative", "reference", "inputs", "commanded_inputs", "forces",
                 "moments", "quaternion")  # fmt: skip
        for name in names:
            array = getattr(bus, name)
            if array is not None:
                setattr(bus, name, np.concatenate([array, np.repeat(array[-1:], more, axis=0)]))

    def table(self, names: Mapping[str, list[str]] | None = None) -> dict[str, np.ndarray]:
        """Return states and inputs by step as columns: "t", then the given names, else "state 0", "input 0" and so on.

        names  {"state": [...], "inputs": [...], "reference": [...]}
        """
        bus, rows = self.bus, self.bus.step + 1
        columns = {"t": bus.time[:rows]}
        for what, array in (("state", bus.state), ("inputs", bus.inputs), ("reference", bus.reference)):
            given = (names or {}).get(what) or [f"{what.removesuffix('s')} {i}" for i in range(array.shape[1])]
            columns |= {name: array[:rows, i].copy() for i, name in enumerate(given)}
        for name, values in self._recorded_signals.items():
            columns |= {n: np.concatenate([c[:1], c])[:rows] for n, c in make_signal_columns(name, values).items()}
        return columns


def make_signal_columns(name: str, values: list[Any]) -> dict[str, np.ndarray]:
    """Make columns of a recorded signal: its name for numbers; for vectors the name and the entry's number from 1.

    values  one number or vector (M,) per step. Raises ShapeError where its size changes or it has two dimensions.
    """
    sizes = {np.shape(value) for value in values}
    if len(sizes) > 1 or any(len(size) > 1 for size in sizes):
        shown = ", ".join(map(str, sorted(sizes)))
        raise ShapeError(f"signal '{name}' was recorded with shapes {shown}, expected a number or a vector of one size")
    array = np.array(values, float)
    if array.ndim <= 1:
        return {name: array} if len(array) else {}
    return {f"{name}_{k + 1}": array[:, k] for k in range(array.shape[1])}
