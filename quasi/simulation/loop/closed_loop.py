"""The closed loop, compiled: reference, sensors, controller, actuator, model, equations of motion, integrator.

Each part is a function. The Python loop (`python_loop`) calls the same functions in the same order on the same arrays,
so both loops give the same numbers. `run_loop` runs one simulation; `batch` runs eight with the same functions.
LoopParameters hold what is constant during a run; a LoopState and a Scratch hold what changes.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi.simulation.control.controllers import controller_step
from quasi.simulation.control.outer_loop import SETPOINT_SIZE
from quasi.simulation.control.references import evaluate_reference
from quasi.simulation.vehicle.dynamics import compute_loads, count_inputs, integrate_step, rotor_acceleration
from quasi.simulation.vehicle.layout import (
    ADDED_GRAVITY,
    EXTRA_INPUTS,
    GIVEN_ACCELERATION,
    LAG_UP,
    MASS,
    MAX_ROTOR_ACCELERATION,
    ROOT_EFFECTIVENESS,
    ROTOR_SPEEDS,
    SPEED_CAP,
    STATE_SIZE,
    STEP_INPUTS_SIZE,
    TARGET_SPEED,
    WIND_VELOCITY,
)
from quasi.simulation.vehicle.sensors_and_wind import (
    GUST_ROW,
    MEASUREMENT_SIZE,
    SENSOR_ROW,
    Sensors,
    add_sensor_noise,
    advance_gust,
    draw_first_gust,
    seed_generator,
    wind_velocity,
)
from quasi.terms.kernel import Kernel
from quasi.terms.lanes import any_lane, choose

EXTERNAL_REFERENCE = -1  # kind of a reference whose setpoint is set by the caller
# columns of the log
(
    LOG_TIME,
    LOG_STATE,
    LOG_SETPOINT,
    LOG_COMMANDS,
    LOG_LOADS,
    LOG_WIND,
    LOG_VOLTAGE,
    LOG_ROTOR_SPEEDS,
    LOG_ROTOR_ACCELERATIONS,
    LOG_MEASUREMENT,
) = 0, 1, 18, 38, 42, 48, 51, 52, 56, 60
FULL_LOG_SIZE = LOG_MEASUREMENT + 20
SHORT_LOG_SIZE = LOG_STATE + STATE_SIZE
STATUS_FINE, STATUS_NO_COMMAND = 0, 100  # status; 1..17 name the state that left its limits
FAULT_SIZE = 9  # entries of a fault: time s, shares of thrust and torque of four rotors, caps of their speeds


class ActuatorLimits(NamedTuple):
    """Limits of a command: lowest and highest rotor speed, rad/s, and the delay, s, before a command acts."""

    low: float
    high: float
    delay: float


class Battery(NamedTuple):
    """Battery voltage and its effect on the rotors.

    start V at the beginning; drain V/s; sag V at the power of hover, in proportion to the rotor speeds cubed; hover
    rad/s
    reference  V at which the commanded speed is the steady speed of a rotor
    exponent   the steady speed is proportional to (voltage / reference) ** exponent; 0 for a governed motor
    place      index of the voltage among the model's extra inputs, -1 where the model does not use it
    """

    start: float
    drain: float
    sag: float
    hover: float
    reference: float
    exponent: float
    place: int


class LoopParameters(NamedTuple):
    """Parameters of a closed loop: everything that is constant during a simulation.

    kernel, body  see `dynamics`; fault (9,); wind (9,), wind_table (T, 4), see `update_environment`
    controller, gains, reference, path, table  see `controllers` and `references`
    dt s, between two commands; substeps of the integrator in it; method EULER or RK4
    limits (17,): a state beyond them has diverged; clock: index of the time among the model's extra
    inputs, -1 where the model does not use it
    """

    kernel: Kernel
    body: np.ndarray
    drive: ActuatorLimits
    battery: Battery
    fault: np.ndarray
    sensors: Sensors
    wind: np.ndarray
    wind_table: np.ndarray
    controller: int
    gains: np.ndarray
    reference: int
    path: np.ndarray
    table: np.ndarray
    dt: float
    substeps: int
    method: int
    limits: np.ndarray
    clock: int


class LoopState(NamedTuple):
    """State of a closed loop: everything that changes during a simulation; see `make_loop_state`."""

    x: np.ndarray  # (17 + own,)
    step_inputs: np.ndarray
    commands: np.ndarray  # (4,) rad/s
    ring: np.ndarray  # (D, 4) the latest commands
    setpoint: np.ndarray  # (20,)
    measurement: np.ndarray  # (26,)
    memory: np.ndarray  # of the controller
    speeds: np.ndarray  # (4,) acting rotor speeds
    gust: np.ndarray  # (3,)
    air: np.ndarray  # (3,)
    voltage: np.ndarray  # (1,)
    random: np.ndarray  # (2,) uint64
    random_numbers: np.ndarray


@njit(cache=True, error_model="numpy")
def make_loop_state(parameters, x, memory, noise_seed, gust_seed):
    """Make the state of a simulation from x (17 + extra_states,), with commands equal to the rotor speeds."""
    step_inputs = np.zeros(STEP_INPUTS_SIZE + count_inputs(parameters.kernel) - 20)
    rows = math.floor(parameters.drive.delay / parameters.dt + 1e-9) + 2
    ring = np.empty((rows, 4))
    random = np.empty(2, np.uint64)
    random[SENSOR_ROW], random[GUST_ROW] = seed_generator(noise_seed, 0), seed_generator(gust_seed, 1)
    random_numbers, gust = np.zeros(19), np.zeros(3)
    for i in range(4):
        ring[:, i] = x[ROTOR_SPEEDS + i]
        step_inputs[TARGET_SPEED + i], step_inputs[GIVEN_ACCELERATION + i] = x[ROTOR_SPEEDS + i], 0.0
        step_inputs[ROOT_EFFECTIVENESS + i], step_inputs[SPEED_CAP + i] = 1.0, np.inf
    draw_first_gust(parameters.wind, random, random_numbers, gust)
    return LoopState(
        x.copy(), step_inputs, x[ROTOR_SPEEDS:STATE_SIZE].copy(), ring, np.zeros(SETPOINT_SIZE),
        np.zeros(MEASUREMENT_SIZE), np.zeros(memory), np.zeros(4), gust,
        np.zeros(3), np.zeros(1), random, random_numbers,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def update_environment(t, wind, wind_table, fault, battery, clock, x, step_inputs, gust, air, speeds, voltage):
    """Set the step inputs at time t except the commands: wind, faults, battery and time."""
    wind_velocity(wind, wind_table, t, gust, air)
    for i in range(3):
        step_inputs[WIND_VELOCITY + i] = air[i]
    acts = t >= fault[0] - 1e-9
    if any_lane(acts):
        for i in range(4):
            healthy, free = step_inputs[ROOT_EFFECTIVENESS + i], step_inputs[SPEED_CAP + i]
            step_inputs[ROOT_EFFECTIVENESS + i] = choose(acts, math.sqrt(fault[1 + i]), healthy)
            step_inputs[SPEED_CAP + i] = choose(acts, fault[5 + i], free)
    power = 0.0
    for i in range(4):
        speeds[i] = min(x[ROTOR_SPEEDS + i], step_inputs[SPEED_CAP + i])
        power += speeds[i] * speeds[i] * speeds[i]
    voltage[0] = battery.start - battery.drain * t - battery.sag * power / (4.0 * battery.hover**3)
    if battery.place >= 0:
        step_inputs[EXTRA_INPUTS + battery.place] = voltage[0]
    if clock >= 0:
        step_inputs[EXTRA_INPUTS + clock] = t


@njit(cache=True, error_model="numpy")
def measure(body, sensors, x, last_loads, speeds, random, random_numbers, measurement):
    """Write sensor readings to measurement (26,); the accelerometer measures the forces at the last step's end."""
    fx, fy, fz = last_loads[0] / body[MASS], last_loads[1] / body[MASS], last_loads[2] / body[MASS]
    if any_lane(body[ADDED_GRAVITY] != GRAVITY):  # the model's forces are net forces
        w, rx, ry, rz, held = x[0], x[1], x[2], x[3], GRAVITY - body[ADDED_GRAVITY]
        fx -= 2.0 * (rx * rz - w * ry) * held
        fy -= 2.0 * (ry * rz + w * rx) * held
        fz -= (1.0 - 2.0 * (rx * rx + ry * ry)) * held
    add_sensor_noise(x, fx, fy, fz, sensors, speeds, random, random_numbers, measurement)


@njit(cache=True, error_model="numpy")
def actuate_rotors(k, dt, drive, battery, body, x, step_inputs, ring, commands, voltage, speeds):
    """Set the rotors' targets for step k from the commanded speeds: delay, battery, saturation, lag."""
    size = len(ring)
    whole = drive.delay / dt
    late = math.floor(whole + 1e-9)
    share = max(whole - late, 0.0)
    factor = 1.0
    if battery.exponent != 0.0:
        factor = math.pow(max(voltage[0], 0.0) / battery.reference, battery.exponent)
    for i in range(4):
        ring[k % size, i] = commands[i]
        wanted = ring[(k - late) % size, i]
        if share > 0.0:
            wanted = (1.0 - share) * wanted + share * ring[(k - late - 1) % size, i]
        target = min(max(wanted * factor, drive.low), drive.high * factor)
        step_inputs[TARGET_SPEED + i] = target
        lags, fastest = body[LAG_UP + i] > 0.0, body[MAX_ROTOR_ACCELERATION]
        slope = min(max((target - x[ROTOR_SPEEDS + i]) / dt, -fastest), fastest)
        prescribed = choose(fastest == np.inf, 0.0, slope)
        step_inputs[GIVEN_ACCELERATION + i] = choose(lags, np.nan, prescribed)
        moved = choose(fastest == np.inf, target, x[ROTOR_SPEEDS + i])
        x[ROTOR_SPEEDS + i] = choose(lags, x[ROTOR_SPEEDS + i], moved)
        speeds[i] = min(x[ROTOR_SPEEDS + i], step_inputs[SPEED_CAP + i])


@njit(cache=True, error_model="numpy")
def check_state(x, limits):
    """STATUS_FINE, or 1 + the number of the state that exceeds its limit most or is NaN; attitude comes last."""
    status, worst = STATUS_FINE, 1.0
    for i in range(4, STATE_SIZE):
        share = abs(x[i]) / limits[i]
        if share != share:
            return 1 + i
        if share > worst:
            status, worst = 1 + i, share
    if status != STATUS_FINE:
        return status
    for i in range(4):
        if not abs(x[i]) <= limits[i]:
            return 1 + i
    return STATUS_FINE


@njit(cache=True, error_model="numpy")
def log_row(t, body, x, step_inputs, setpoint, commands, loads, air, voltage, speeds, measurement, log, row):
    """Write the beginning of a step to a row of the log."""
    log[row, LOG_TIME] = t
    for i in range(STATE_SIZE):
        log[row, LOG_STATE + i] = x[i]
    if log.shape[1] < FULL_LOG_SIZE:
        return
    for i in range(SETPOINT_SIZE):
        log[row, LOG_SETPOINT + i] = setpoint[i]
        log[row, LOG_MEASUREMENT + i] = measurement[i]
    for i in range(6):
        log[row, LOG_LOADS + i] = loads[i]
    log[row, LOG_VOLTAGE] = voltage[0]
    for i in range(3):
        log[row, LOG_WIND + i] = air[i]
    for i in range(4):
        log[row, LOG_COMMANDS + i] = commands[i]
        log[row, LOG_ROTOR_SPEEDS + i] = speeds[i]
        log[row, LOG_ROTOR_ACCELERATIONS + i] = (
            rotor_acceleration(i, x[ROTOR_SPEEDS + i], step_inputs, body)
            if x[ROTOR_SPEEDS + i] <= step_inputs[SPEED_CAP + i]
            else 0.0
        )
    for i in range(log.shape[1] - FULL_LOG_SIZE):
        log[row, FULL_LOG_SIZE + i] = x[STATE_SIZE + i]


@njit(cache=True, error_model="numpy")
def run_loop(parameters, state, scratch, first, steps, every, log, close):
    """Run `steps` steps from step number `first` on; returns (status, steps done, rows written).

    log    (rows, LOG + own) or, for time and the seventeen states, (rows, SHORT_LOG_SIZE): every `every`-th step
    close  whether the last instant is evaluated and logged too: at the end of a run, not between its chunks
    """
    kernel, body, drive, battery, fault, sensors, wind, wind_table = parameters[:8]
    kind, gains, reference, path, table, dt, substeps, method, limits, clock = parameters[8:]
    (
        x,
        step_inputs,
        commands,
        ring,
        setpoint,
        measurement,
        memory,
        speeds,
        gust,
        air,
        voltage,
        random,
        random_numbers,
    ) = state
    inputs, work, loads, last_loads, derivatives, stage_state = scratch
    begin = np.empty(6)
    row = np.int64(0)  # of a plain 0, the compiler makes a version of `log_row` of its own
    for k in range(first, first + steps + (1 if close else 0)):
        t = k * dt
        update_environment(t, wind, wind_table, fault, battery, clock, x, step_inputs, gust, air, speeds, voltage)
        if k == 0:
            compute_loads(x, step_inputs, kernel, body, inputs, work, last_loads)
        measure(body, sensors, x, last_loads, speeds, random, random_numbers, measurement)
        if reference != EXTERNAL_REFERENCE:
            evaluate_reference(reference, path, table, t, setpoint)
        controller_step(kind, gains, memory, dt, measurement, setpoint, commands)
        for i in range(4):
            if not math.isfinite(commands[i]):
                return STATUS_NO_COMMAND, k - first, row
        actuate_rotors(k, dt, drive, battery, body, x, step_inputs, ring, commands, voltage, speeds)
        wanted = (k - first) % every == 0
        if wanted:
            log_row(t, body, x, step_inputs, setpoint, commands, loads, air, voltage, speeds, measurement, log, row)
        if k == first + steps:
            compute_loads(x, step_inputs, kernel, body, inputs, work, begin)
        else:
            for part in range(substeps):
                integrate_step(
                    method,
                    dt / substeps,
                    x,
                    step_inputs,
                    kernel,
                    body,
                    inputs,
                    work,
                    loads,
                    last_loads,
                    derivatives,
                    stage_state,
                )
                if part == 0:
                    for i in range(6):
                        begin[i] = loads[i]
            advance_gust(wind, dt, random, random_numbers, gust)
        if wanted:
            if log.shape[1] >= FULL_LOG_SIZE:
                for i in range(6):
                    log[row, LOG_LOADS + i] = begin[i]
            row += 1
        status = check_state(x, limits)
        if status != STATUS_FINE:
            return status, k + 1 - first, row
    return STATUS_FINE, steps, row
