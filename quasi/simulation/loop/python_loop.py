"""The closed loop of a quadrotor in Python, from the same compiled functions, so that a user can replace any step.

State (17,) plus the states of payload and inflow, and setpoint (20,), are those of the compiled loop (`dynamics`,
`outer_loop`). Inputs are the four rotor speeds, rad/s. The bus (`simulator`) also holds bus.model, bus.setup,
bus.loop_state (arrays of the compiled loop: wind as bus.loop_state.air, ...), bus.measured_state[k] (the controller's
measurement) and bus.reference[k] (setpoint).

With the built-in actuator the rotors follow their lag within the step. A user's actuator returns the rotor speeds at
the end of the step, and they change linearly until then. A step may also call a built-in one and change its result.
"""

import math
from typing import Any

import numpy as np

from quasi.errors import DataError
from quasi.simulation.loop.closed_loop import (
    EXTERNAL_REFERENCE,
    FULL_LOG_SIZE,
    SETPOINT_SIZE,
    STATUS_FINE,
    STATUS_NO_COMMAND,
    actuate_rotors,
    check_state,
    controller_step,
    evaluate_reference,
    log_row,
    measure,
    update_environment,
)
from quasi.simulation.loop.result import Result, make_result
from quasi.simulation.loop.setup import STATE_NAMES, Setup
from quasi.simulation.loop.simulator import Bus, Simulator, make_signal_columns
from quasi.simulation.vehicle.dynamics import (
    RK4,
    compute_loads,
    equations_of_motion,
    integrate_step,
    make_scratch,
)
from quasi.simulation.vehicle.layout import (
    GIVEN_ACCELERATION,
    LAG_DOWN,
    LAG_UP,
    MAX_ROTOR_ACCELERATION,
    ROTOR_SPEEDS,
    SPEED_CAP,
    STATE_SIZE,
    TARGET_SPEED,
)
from quasi.simulation.vehicle.payload_and_inflow import project_constraints
from quasi.simulation.vehicle.sensors_and_wind import advance_gust


class _NoCommandError(Exception):
    """The built-in controller gave a command that is not finite; the simulation ends as the compiled one does."""


class QuadrotorSimulator(Simulator):
    """A setup as a simulator whose steps can be replaced.

    setup       what is simulated
    integrator  None takes the setup's; else as for Simulator, such as "DOP853" for reference
    run_mode    "finite": the setup's duration; "infinite": until the condition of set_termination ends it
    """

    _trusts_built_in = True

    def __init__(self, setup: Setup, integrator: Any = None, run_mode: str = "finite") -> None:
        loop_parameters = setup.loop_parameters
        built_in = "rk4" if loop_parameters.method == RK4 else "euler"
        super().__init__(
            setup.model,
            self._evaluate_equations,
            self._run_controller,
            self._run_actuator,
            self._forces_and_moments,
            built_in if integrator is None else integrator,
            run_mode,
            quaternion=0,
        )
        self.steps["begin"] = self._built_in["begin"] = self._begin_step
        self.setup, self.state_names = setup, [*STATE_NAMES, *(f"own {i + 1}" for i in range(setup.extra_states))]
        self._compiled = integrator is None
        self.bus.setup = setup
        duration = setup.steps * loop_parameters.dt if run_mode == "finite" else None
        self.set_initial(
            setup.start, setup.start[ROTOR_SPEEDS:STATE_SIZE], loop_parameters.dt, duration, np.zeros(SETPOINT_SIZE)
        )
        bus = self.bus
        bus.measured_state = np.zeros((len(bus.time), 20))
        bus.loop_state = setup.make_loop_state()
        self._scratch = make_scratch(loop_parameters.kernel, setup.extra_states)
        self._derivative = np.empty((1, len(setup.start)))
        self._log: list[np.ndarray] = []
        self.status = STATUS_FINE

    # the built-in steps

    def _begin_step(self, bus: Bus) -> None:
        """Update wind, faults, battery, measurement and setpoint at the beginning of the step."""
        m, state, s, k = self.setup.loop_parameters, bus.loop_state, self._scratch, bus.step
        t = k * m.dt
        state.x[:] = bus.state[k]
        update_environment(
            t, m.wind, m.wind_table, m.fault, m.battery, m.clock, state.x, state.step_inputs, state.gust,
            state.air, state.speeds, state.voltage,
        )  # fmt: skip
        if k == 0:
            compute_loads(state.x, state.step_inputs, m.kernel, m.body, s.inputs, s.work, s.last_loads)
        measure(
            m.body,
            m.sensors,
            state.x,
            s.last_loads,
            state.speeds,
            state.random,
            state.random_numbers,
            state.measurement,
        )
        bus.measured_state[k] = state.measurement[:20]
        if m.reference != EXTERNAL_REFERENCE:
            evaluate_reference(m.reference, m.path, m.table, t, state.setpoint)
            bus.reference[k] = state.setpoint

    def _run_controller(self, bus: Bus) -> np.ndarray:
        """Compute the commanded rotor speeds (4,), rad/s, from bus.measured_state[k] and bus.reference[k]."""
        m, state, k = self.setup.loop_parameters, bus.loop_state, bus.step
        state.measurement[:20] = bus.measured_state[k]
        state.setpoint[:] = bus.reference[k]
        controller_step(m.controller, m.gains, state.memory, m.dt, state.measurement, state.setpoint, state.commands)
        if not np.all(np.isfinite(state.commands)):
            raise _NoCommandError
        return state.commands.copy()

    def _run_actuator(self, bus: Bus) -> np.ndarray:
        """Compute the rotor speeds (4,), rad/s, at the end of the step from bus.commanded_inputs[k + 1]."""
        m, state, k = self.setup.loop_parameters, bus.loop_state, bus.step
        state.commands[:] = bus.commanded_inputs[k + 1]
        actuate_rotors(
            k,
            m.dt,
            m.drive,
            m.battery,
            m.body,
            state.x,
            state.step_inputs,
            state.ring,
            state.commands,
            state.voltage,
            state.speeds,
        )
        # rotors without lag reach their target at once
        bus.state[k, ROTOR_SPEEDS:STATE_SIZE] = state.x[ROTOR_SPEEDS:STATE_SIZE]
        end = np.empty(4)
        for i in range(4):
            speed, target = state.x[ROTOR_SPEEDS + i], state.step_inputs[TARGET_SPEED + i]
            if math.isnan(state.step_inputs[GIVEN_ACCELERATION + i]):
                tau = m.body[LAG_UP + i] if target > speed else m.body[LAG_DOWN + i]
                change = (target - speed) * (1.0 - math.exp(-m.dt / tau))
                limit = m.body[MAX_ROTOR_ACCELERATION] * m.dt
                end[i] = speed + min(max(change, -limit), limit)
            else:
                end[i] = speed + state.step_inputs[GIVEN_ACCELERATION + i] * m.dt
        return np.minimum(end, state.step_inputs[SPEED_CAP : SPEED_CAP + 4])

    def _forces_and_moments(self, bus: Bus) -> tuple[np.ndarray, np.ndarray]:
        """Compute forces (3,) N and moments (3,) N m of the model in bus.state[k]."""
        m, s = self.setup.loop_parameters, self._scratch
        compute_loads(bus.state[bus.step], bus.loop_state.step_inputs, m.kernel, m.body, s.inputs, s.work, s.last_loads)
        return s.last_loads[:3].copy(), s.last_loads[3:].copy()

    def _evaluate_equations(self, bus: Bus) -> np.ndarray:
        """Compute the state derivative (17,) from bus.forces[k + 1] and bus.moments[k + 1]."""
        k = bus.step
        loads = np.concatenate([bus.forces[k + 1], bus.moments[k + 1]])
        equations_of_motion(
            bus.state[k], loads, bus.loop_state.step_inputs, self.setup.loop_parameters.body, self._derivative, 0
        )
        return self._derivative[0].copy()

    # physics and log of a step

    def _evaluate_inputs(self, bus: Bus) -> None:
        super()._evaluate_inputs(bus)
        if self.steps["actuator"] is not self._built_in["actuator"]:
            change = bus.inputs[bus.step + 1] - bus.state[bus.step, ROTOR_SPEEDS:STATE_SIZE]
            bus.loop_state.step_inputs[GIVEN_ACCELERATION : GIVEN_ACCELERATION + 4] = (
                change / self.setup.loop_parameters.dt
            )

    def _evaluate_physics(self, bus: Bus) -> None:
        if not self._uses_compiled_physics():
            super()._evaluate_physics(bus)

    def _uses_compiled_physics(self) -> bool:
        """Whether the physics of the step are the built-in ones and no added step runs between them."""
        same = all(
            self.steps[n] is self._built_in[n] for n in ("forces_and_moments", "equations_of_motion", "integrator")
        )
        looked_at = self._added_steps["forces_and_moments"] or self._added_steps["equations_of_motion"]
        return same and self._compiled and not looked_at

    def _next_state(self, bus: Bus) -> np.ndarray:
        m, state, s, k = self.setup.loop_parameters, bus.loop_state, self._scratch, bus.step
        if self._uses_compiled_physics():
            state.x[:] = bus.state[k]
            first = None
            for _ in range(m.substeps):
                integrate_step(m.method, m.dt / m.substeps, state.x, state.step_inputs, m.kernel, m.body, *s)
                first = (s.loads.copy(), s.derivatives[0].copy()) if first is None else first
            bus.forces[k + 1], bus.moments[k + 1] = first[0][:3], first[0][3:]
            bus.state_derivative[k + 1] = first[1]
            result = state.x.copy()
        else:
            if m.substeps > 1:
                raise DataError(
                    "'substeps' cannot be used with replaced forces, equations of motion or integrator; "
                    "use a shorter 'time step'"
                )
            result = super()._next_state(bus)
            project_constraints(result, m.body)
            # forces for the next accelerometer sample; the last Runge-Kutta stage is already at the end of the step
            if self._method == "euler":
                self.evaluate_derivative(bus.state[k] + m.dt * bus.state_derivative[k + 1])
            elif self._method != "rk4":
                self.evaluate_derivative(result)
            s.last_loads[:3], s.last_loads[3:] = self._last_loads
        self._write_log(bus)
        advance_gust(m.wind, m.dt, state.random, state.random_numbers, state.gust)
        return result

    def _write_log(self, bus: Bus) -> None:
        k, state, body = bus.step, bus.loop_state, self.setup.loop_parameters.body
        if k % self.setup.every:
            return
        row, x = np.zeros((1, FULL_LOG_SIZE + self.setup.extra_states)), bus.state[k]
        loads = np.concatenate([bus.forces[k + 1], bus.moments[k + 1]])
        speeds = np.minimum(x[ROTOR_SPEEDS:STATE_SIZE], state.step_inputs[SPEED_CAP : SPEED_CAP + 4])
        log_row(
            bus.time[k], body, x, state.step_inputs, bus.reference[k], bus.commanded_inputs[k + 1], loads, state.air,
            state.voltage, speeds, bus.measured_state[k], row, 0,
        )  # fmt: skip
        self._log.append(row[0])

    def _check_state(self, bus: Bus) -> None:
        self.status = int(check_state(bus.state[bus.step + 1], self.setup.loop_parameters.limits))
        if self.status != STATUS_FINE:
            self.stopped = "diverged"

    def run(self) -> Bus:
        """Run to the end, or until the termination condition says so, or the state diverges; see Simulator."""
        try:
            return super().run()
        except _NoCommandError:
            self.status, self.stopped = STATUS_NO_COMMAND, "no command"
            return self.bus

    def fly(self) -> Result:
        """Run to the end; the result as `run.simulate` gives it, the last instant included."""
        self.run()
        bus = self.bus
        if self.stopped is None:
            self._log_last_instant(bus)
        result = make_result(
            self.setup,
            np.array(self._log).reshape(-1, FULL_LOG_SIZE + self.setup.extra_states),
            self.status,
            bus.step,
            *bus.state[[max(bus.step - 1, 0), bus.step]],
        )
        for name, values in self._recorded_signals.items():
            for column, array in make_signal_columns(name, values).items():
                result.table[column] = np.concatenate([array, array[-1:]])[:: self.setup.every][: len(result.table)]
        return result

    def _log_last_instant(self, bus: Bus) -> None:
        """Log measurement, command and loads at the end, without a further step."""
        k = bus.step
        self._evaluate_inputs(bus)
        if self.steps["forces_and_moments"] is not None:
            bus.forces[k + 1], bus.moments[k + 1] = self._evaluate_loads(bus)
        self._write_log(bus)
