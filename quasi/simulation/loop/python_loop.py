"""The closed loop of a quadrotor in Python, through the same compiled parts, so that any step can be the user's own.

State (17,), longer where parts have states of their own (`parts`), and goal (20,) as in the compiled loop (`dynamics`,
`outer_loop`); inputs are the four rotor speeds, rad/s. Beside what every bus holds (`quasi.simulation.loop.simulator`):
bus.model (the model), bus.setup, bus.live (arrays of the compiled loop: wind as bus.live.air, ...),
bus.measured_state[k] (what the controller sees), bus.reference[k] (goal).

With the built-in actuator the rotors follow their lag within the step; a user's actuator gives the rotor speeds at the
end of the step, and they change evenly until then. Steps that call a built-in one and change what it returns work, too.
"""

import math
from typing import Any

import numpy as np

from quasi.errors import DataError
from quasi.simulation.loop.closed_loop import (
    AIMED,
    AIR,
    COMMANDS,
    EXTERNAL,
    FINE,
    GOAL,
    LOADS,
    LOG,
    NO_COMMAND,
    SEEN_AT,
    SLOPES,
    SPEEDS,
    VOLTAGE,
    T,
    X,
    actuate,
    controller_step,
    environment,
    goal_at,
    observe,
    status_of,
)
from quasi.simulation.loop.result import Result, result_of
from quasi.simulation.loop.setup import STATE_NAMES, Setup
from quasi.simulation.loop.simulator import Bus, Simulator, signal_columns
from quasi.simulation.vehicle.dynamics import RK4, advance, equations, loads_at, rotor_slope, scratch_of
from quasi.simulation.vehicle.layout import CAP, DOWN, RATE, ROTORS, SLOPE, STATES, TARGET, UP
from quasi.simulation.vehicle.payload_and_inflow import straighten
from quasi.simulation.vehicle.sensors_and_wind import next_gust


class _NoCommandError(Exception):
    """The built-in controller gave a command that is no number: the simulation ends as the compiled one does."""


class QuadrotorSimulator(Simulator):
    """A setup as a simulator whose steps can be replaced.

    setup       what is simulated
    integrator  None takes the setup's; else as for Simulator, such as "DOP853" for reference
    run_mode    "finite": the setup's duration; "infinite": until the condition of set_termination ends it
    """

    _trust_own = True

    def __init__(self, setup: Setup, integrator: Any = None, run_mode: str = "finite") -> None:
        machine = setup.machine
        own = "rk4" if machine.method == RK4 else "euler"
        super().__init__(
            setup.model,
            self._equations,
            self._control,
            self._actuate,
            self._forces_and_moments,
            own if integrator is None else integrator,
            run_mode,
            quaternion=0,
        )
        self.steps["begin"] = self._own["begin"] = self._begin
        self.setup, self.state_names = setup, [*STATE_NAMES, *(f"own {i + 1}" for i in range(setup.own))]
        self._compiled = integrator is None
        self.bus.setup = setup
        duration = setup.steps * machine.dt if run_mode == "finite" else None
        self.set_initial(setup.start, setup.start[ROTORS:STATES], machine.dt, duration, np.zeros(GOAL))
        bus = self.bus
        bus.measured_state = np.zeros((len(bus.time), 20))
        bus.live = setup.live()
        self._scratch = scratch_of(machine.kernel, setup.own)
        self._stage = np.empty((1, len(setup.start)))
        self._log: list[np.ndarray] = []
        self.status = FINE

    # the built-in steps

    def _begin(self, bus: Bus) -> None:
        """Wind, faults, battery, sensors and reference at the beginning of the step."""
        m, live, s, k = self.setup.machine, bus.live, self._scratch, bus.step
        t = k * m.dt
        live.x[:] = bus.state[k]
        environment(
            t, m.wind, m.wind_table, m.fault, m.battery, m.clock, live.x, live.held, live.gust, live.air, live.speeds,
            live.voltage,
        )  # fmt: skip
        if k == 0:
            loads_at(live.x, live.held, m.kernel, m.body, s.inputs, s.work, s.last)
        observe(m.body, m.sensors, live.x, s.last, live.speeds, live.random, live.draws, live.seen)
        bus.measured_state[k] = live.seen[:20]
        if m.reference != EXTERNAL:
            goal_at(m.reference, m.path, m.table, t, live.goal)
            bus.reference[k] = live.goal

    def _control(self, bus: Bus) -> np.ndarray:
        """Commanded rotor speeds (4,), rad/s, from bus.measured_state[k] and bus.reference[k]."""
        m, live, k = self.setup.machine, bus.live, bus.step
        live.seen[:20] = bus.measured_state[k]
        live.goal[:] = bus.reference[k]
        controller_step(m.controller, m.gains, live.memory, k * m.dt, m.dt, live.seen, live.goal, live.commands)
        if not np.all(np.isfinite(live.commands)):
            raise _NoCommandError
        return live.commands.copy()

    def _actuate(self, bus: Bus) -> np.ndarray:
        """Rotor speeds (4,), rad/s, that bus.commanded_inputs[k + 1] lead to at the end of the step."""
        m, live, k = self.setup.machine, bus.live, bus.step
        live.commands[:] = bus.commanded_inputs[k + 1]
        actuate(
            k, m.dt, m.drive, m.battery, m.body, live.x, live.held, live.ring, live.commands, live.voltage, live.speeds
        )
        bus.state[k, ROTORS:STATES] = live.x[ROTORS:STATES]  # rotors without lag are at once where they are wanted
        end = np.empty(4)
        for i in range(4):
            speed, target = live.x[ROTORS + i], live.held[TARGET + i]
            if math.isnan(live.held[SLOPE + i]):
                tau = m.body[UP + i] if target > speed else m.body[DOWN + i]
                change = (target - speed) * (1.0 - math.exp(-m.dt / tau))
                most = m.body[RATE] * m.dt
                end[i] = speed + min(max(change, -most), most)
            else:
                end[i] = speed + live.held[SLOPE + i] * m.dt
        return np.minimum(end, live.held[CAP : CAP + 4])

    def _forces_and_moments(self, bus: Bus) -> tuple[np.ndarray, np.ndarray]:
        """Forces (3,) N and moments (3,) N m of the model in bus.state[k]."""
        m, s = self.setup.machine, self._scratch
        loads_at(bus.state[bus.step], bus.live.held, m.kernel, m.body, s.inputs, s.work, s.last)
        return s.last[:3].copy(), s.last[3:].copy()

    def _equations(self, bus: Bus) -> np.ndarray:
        """State derivative (17,) from bus.forces[k + 1] and bus.moments[k + 1]."""
        k = bus.step
        loads = np.concatenate([bus.forces[k + 1], bus.moments[k + 1]])
        equations(bus.state[k], loads, bus.live.held, self.setup.machine.body, self._stage, 0)
        return self._stage[0].copy()

    # what a step needs beside

    def _physics(self, bus: Bus) -> None:
        if self.steps["actuator"] is not self._own["actuator"]:
            k, live, dt = bus.step, bus.live, self.setup.machine.dt
            if self.steps["actuator"] is None:
                bus.inputs[k + 1] = bus.commanded_inputs[k + 1]
            live.held[SLOPE : SLOPE + 4] = (bus.inputs[k + 1] - bus.state[k, ROTORS:STATES]) / dt
        if not self._whole():
            super()._physics(bus)

    def _whole(self) -> bool:
        """Whether the physics of the step are the built-in ones, and none wants to look between them."""
        same = all(self.steps[n] is self._own[n] for n in ("forces_and_moments", "equations_of_motion", "integrator"))
        looked_at = self._between["forces_and_moments"] or self._between["equations_of_motion"]
        return same and self._compiled and not looked_at

    def _next_state(self, bus: Bus) -> np.ndarray:
        m, live, s, k = self.setup.machine, bus.live, self._scratch, bus.step
        if self._whole():
            live.x[:] = bus.state[k]
            first = None
            for _ in range(m.substeps):
                advance(m.method, m.dt / m.substeps, live.x, live.held, m.kernel, m.body, *s)
                first = (s.loads.copy(), s.slopes[0].copy()) if first is None else first
            bus.forces[k + 1], bus.moments[k + 1] = first[0][:3], first[0][3:]
            bus.state_derivative[k + 1] = first[1]
            result = live.x.copy()
        else:
            if m.substeps > 1:
                raise DataError(
                    "'substeps' cannot be used with own forces, equations of motion or integrator; "
                    "use a shorter 'time step'"
                )
            result = super()._next_state(bus)
            straighten(result, m.body)
            # what the accelerometer feels next: Runge-Kutta's last stage lies at the end of the step by itself
            if self._method == "euler":
                self.slope(bus.state[k] + m.dt * bus.state_derivative[k + 1])
            elif self._method != "rk4":
                self.slope(result)
            s.last[:3], s.last[3:] = self._latest
        self._write_log(bus)
        next_gust(m.wind, m.dt, live.random, live.draws, live.gust)
        return result

    def _write_log(self, bus: Bus) -> None:
        k, live, body = bus.step, bus.live, self.setup.machine.body
        if k % self.setup.every:
            return
        row = np.zeros(LOG + self.setup.own)
        x = bus.state[k]
        row[T] = bus.time[k]
        row[X : X + STATES], row[LOG:] = x[:STATES], x[STATES:]
        row[AIMED : AIMED + GOAL], row[SEEN_AT : SEEN_AT + 20] = bus.reference[k], bus.measured_state[k]
        row[COMMANDS : COMMANDS + 4] = bus.commanded_inputs[k + 1]
        row[LOADS : LOADS + 3], row[LOADS + 3 : LOADS + 6] = bus.forces[k + 1], bus.moments[k + 1]
        row[AIR : AIR + 3], row[VOLTAGE] = live.air, live.voltage[0]
        for i in range(4):
            cap = live.held[CAP + i]
            row[SPEEDS + i] = min(x[ROTORS + i], cap)
            row[SLOPES + i] = rotor_slope(i, x[ROTORS + i], live.held, body) if x[ROTORS + i] <= cap else 0.0
        self._log.append(row)

    def _check_state(self, bus: Bus) -> None:
        self.status = int(status_of(bus.state[bus.step + 1], self.setup.machine.limits))
        if self.status != FINE:
            self.stopped = "diverged"

    def run(self) -> Bus:
        """Run to the end, or until the termination condition says so, or the state diverges; see Simulator."""
        try:
            return super().run()
        except _NoCommandError:
            self.status, self.stopped = NO_COMMAND, "no command"
            return self.bus

    def fly(self) -> Result:
        """Run to the end; the result as `run.simulate` gives it, the last instant included."""
        self.run()
        bus = self.bus
        if self.stopped is None:
            self._last_instant(bus)
        result = result_of(
            self.setup,
            np.array(self._log).reshape(-1, LOG + self.setup.own),
            self.status,
            bus.step,
            *bus.state[[max(bus.step - 1, 0), bus.step]],
        )
        for name, values in self._recorded.items():
            for column, array in signal_columns(name, values).items():
                result.table[column] = np.concatenate([array, array[-1:]])[:: self.setup.every][: len(result.table)]
        return result

    def _last_instant(self, bus: Bus) -> None:
        """What is seen, commanded and felt at the end, without a step after it."""
        k = bus.step
        self.steps["begin"](bus)
        self._also("begin", bus)
        for name, to in (("controller", bus.commanded_inputs), ("actuator", bus.inputs)):
            step = self.steps[name]
            to[k + 1] = step(bus) if step is not None else bus.commanded_inputs[k + (name == "actuator")]
            self._also(name, bus)
        if self.steps["actuator"] is not self._own["actuator"]:
            change = bus.inputs[k + 1] - bus.state[k, ROTORS:STATES]
            bus.live.held[SLOPE : SLOPE + 4] = change / self.setup.machine.dt
        if self.steps["forces_and_moments"] is not None:
            bus.forces[k + 1], bus.moments[k + 1] = self._loads(bus)
        self._write_log(bus)
