"""The closed loop, compiled: reference, sensors, controller, actuator, model, equations of motion, integrator.

Each part is a function. The Python loop (`python_loop`) calls the same functions in the same order on the same arrays,
so both loops give the same numbers. `fly` runs one simulation, `fly_some` runs part of a batch. A Machine holds what
is constant during a run; a Live and a Scratch hold what changes.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi.simulation.control.controllers import controller_step
from quasi.simulation.control.references import goal_at
from quasi.simulation.vehicle.dynamics import advance, inputs_of, loads_at, rotor_slope, scratch_of
from quasi.simulation.vehicle.layout import (
    CAP,
    EXTRAS,
    GRAVITY_ADDED,
    HELD,
    MASS,
    RATE,
    ROTORS,
    SHARE,
    SLOPE,
    STATES,
    TARGET,
    UP,
    WIND,
)
from quasi.simulation.vehicle.sensors_and_wind import (
    GUST_ROW,
    SEEN,
    SENSOR_ROW,
    Sensors,
    blow,
    first_gust,
    next_gust,
    seeded,
    sense,
)
from quasi.terms.kernel import Kernel

GOAL = 20
EXTERNAL = -1  # kind of a reference whose goal is set from outside
# columns of the log
T, X, AIMED, COMMANDS, LOADS, AIR, VOLTAGE, SPEEDS, SLOPES, SEEN_AT = 0, 1, 18, 38, 42, 48, 51, 52, 56, 60
LOG = SEEN_AT + 20
SHORT_LOG = X + STATES
FINE, NO_COMMAND = 0, 100  # status; 1..17 name the state that left its limits
FAULT = 9  # entries of a fault: time s, shares of thrust and torque of four rotors, caps of their speeds


class Drive(NamedTuple):
    """What bounds a command: lowest and highest rotor speed, rad/s, and the delay, s, before a command acts."""

    low: float
    high: float
    delay: float


class Battery(NamedTuple):
    """Voltage and what it does to the rotors.

    start V at the beginning; drain V/s; sag V at the power of hover, growing with the third power of the rotor speeds;
    hover rad/s; reference V at which a command is the speed that a rotor settles at; exponent: that speed grows with
    (voltage / reference) ** exponent, 0 for a governed motor; place of the voltage among the model's extra inputs, -1
    where it is none
    """

    start: float
    drain: float
    sag: float
    hover: float
    reference: float
    exponent: float
    place: int


class Machine(NamedTuple):
    """A closed loop, ready to run: everything that stays the same during a simulation.

    kernel, body  see `dynamics`; fault (9,); wind (9,), wind_table (T, 4), see `environment`
    controller, gains, reference, path, table  see `controllers` and `references`
    dt s, between two commands; substeps of the integrator within it; method EULER or RK4
    limits (17,): a state beyond them has diverged; clock: place of the time among the model's extra inputs, -1 for none
    """

    kernel: Kernel
    body: np.ndarray
    drive: Drive
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


class Live(NamedTuple):
    """What changes during a simulation; `live_of` makes it."""

    x: np.ndarray  # (17 + own,)
    held: np.ndarray
    commands: np.ndarray  # (4,) rad/s
    ring: np.ndarray  # (D, 4) the latest commands
    goal: np.ndarray  # (20,)
    seen: np.ndarray  # (26,)
    memory: np.ndarray  # of the controller
    speeds: np.ndarray  # (4,) rotor speeds that act
    gust: np.ndarray  # (3,)
    air: np.ndarray  # (3,)
    voltage: np.ndarray  # (1,)
    random: np.ndarray  # (2,) uint64
    draws: np.ndarray


@njit(cache=True, error_model="numpy")
def live_of(machine, x, memory, noise_seed, gust_seed):
    """What changes during a simulation that begins in state x (17 + own,), rotors in balance with commands."""
    held = np.zeros(HELD + inputs_of(machine.kernel) - 20)
    rows = math.floor(machine.drive.delay / machine.dt + 1e-9) + 2
    ring = np.empty((rows, 4))
    random = np.empty(2, np.uint64)
    random[SENSOR_ROW], random[GUST_ROW] = seeded(noise_seed, 0), seeded(gust_seed, 1)
    draws, gust = np.zeros(19), np.zeros(3)
    for i in range(4):
        ring[:, i] = x[ROTORS + i]
        held[TARGET + i], held[SLOPE + i], held[SHARE + i], held[CAP + i] = x[ROTORS + i], 0.0, 1.0, np.inf
    first_gust(machine.wind, random, draws, gust)
    return Live(
        x.copy(), held, x[ROTORS:STATES].copy(), ring, np.zeros(GOAL), np.zeros(SEEN), np.zeros(memory), np.zeros(4),
        gust, np.zeros(3), np.zeros(1), random, draws,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def environment(t, wind, wind_table, fault, battery, clock, x, held, gust, air, speeds, voltage):
    """Wind, faults, battery and time itself at time t: what is held over a step, apart from the commands."""
    blow(wind, wind_table, t, gust, air)
    for i in range(3):
        held[WIND + i] = air[i]
    if t >= fault[0] - 1e-9:
        for i in range(4):
            held[SHARE + i] = math.sqrt(fault[1 + i])
            held[CAP + i] = fault[5 + i]
    power = 0.0
    for i in range(4):
        speeds[i] = min(x[ROTORS + i], held[CAP + i])
        power += speeds[i] * speeds[i] * speeds[i]
    voltage[0] = battery.start - battery.drain * t - battery.sag * power / (4.0 * battery.hover**3)
    if battery.place >= 0:
        held[EXTRAS + battery.place] = voltage[0]
    if clock >= 0:
        held[EXTRAS + clock] = t


@njit(cache=True, error_model="numpy")
def observe(body, sensors, x, last, speeds, random, draws, seen):
    """What the sensors read now, into seen (26,); the accelerometer feels the forces at the end of the last step."""
    fx, fy, fz = last[0] / body[MASS], last[1] / body[MASS], last[2] / body[MASS]
    if body[GRAVITY_ADDED] == 0.0:  # the model's forces are net forces
        w, rx, ry, rz = x[0], x[1], x[2], x[3]
        fx -= 2.0 * (rx * rz - w * ry) * GRAVITY
        fy -= 2.0 * (ry * rz + w * rx) * GRAVITY
        fz -= (1.0 - 2.0 * (rx * rx + ry * ry)) * GRAVITY
    sense(x, fx, fy, fz, sensors, speeds, random, draws, seen)


@njit(cache=True, error_model="numpy")
def actuate(k, dt, drive, battery, body, x, held, ring, commands, voltage, speeds):
    """From commanded rotor speeds to what the rotors do during step k: delay, battery, saturation, lag."""
    size = len(ring)
    whole = drive.delay / dt
    late = math.floor(whole + 1e-9)
    share = max(whole - late, 0.0)
    factor = 1.0
    if battery.exponent != 0.0:
        factor = (max(voltage[0], 0.0) / battery.reference) ** battery.exponent
    for i in range(4):
        ring[k % size, i] = commands[i]
        wanted = ring[(k - late) % size, i]
        if share > 0.0:
            wanted = (1.0 - share) * wanted + share * ring[(k - late - 1) % size, i]
        target = min(max(wanted * factor, drive.low), drive.high * factor)
        held[TARGET + i] = target
        if body[UP + i] > 0.0:
            held[SLOPE + i] = np.nan
        elif body[RATE] == np.inf:
            x[ROTORS + i] = target
            held[SLOPE + i] = 0.0
        else:
            slope = (target - x[ROTORS + i]) / dt
            held[SLOPE + i] = min(max(slope, -body[RATE]), body[RATE])
        speeds[i] = min(x[ROTORS + i], held[CAP + i])


@njit(cache=True, error_model="numpy")
def status_of(x, limits):
    """FINE, or 1 + the number of the state that is farthest beyond its limit or is NaN; attitude comes last."""
    status, worst = FINE, 1.0
    for i in range(4, STATES):
        share = abs(x[i]) / limits[i]
        if share != share:
            return 1 + i
        if share > worst:
            status, worst = 1 + i, share
    if status != FINE:
        return status
    for i in range(4):
        if not abs(x[i]) <= limits[i]:
            return 1 + i
    return FINE


@njit(cache=True, error_model="numpy")
def note(t, body, x, held, goal, commands, loads, air, voltage, speeds, seen, log, row):
    """Write the beginning of a step into a row of the log."""
    log[row, T] = t
    for i in range(STATES):
        log[row, X + i] = x[i]
    if log.shape[1] < LOG:
        return
    for i in range(GOAL):
        log[row, AIMED + i] = goal[i]
        log[row, SEEN_AT + i] = seen[i]
    for i in range(6):
        log[row, LOADS + i] = loads[i]
    log[row, VOLTAGE] = voltage[0]
    for i in range(3):
        log[row, AIR + i] = air[i]
    for i in range(4):
        log[row, COMMANDS + i] = commands[i]
        log[row, SPEEDS + i] = speeds[i]
        log[row, SLOPES + i] = rotor_slope(i, x[ROTORS + i], held, body) if x[ROTORS + i] <= held[CAP + i] else 0.0
    for i in range(log.shape[1] - LOG):
        log[row, LOG + i] = x[STATES + i]


@njit(cache=True, error_model="numpy")
def fly(machine, live, scratch, first, steps, every, log, close):
    """Run `steps` steps from step number `first` on; returns (status, steps done, rows written).

    log    (rows, LOG + own) or, for time and the seventeen states, (rows, SHORT_LOG): every `every`-th step
    close  whether the last instant is looked at and logged too: at the end of a run, not between chunks of one
    """
    kernel, body, drive, battery, fault, sensors, wind, wind_table = machine[:8]
    kind, gains, reference, path, table, dt, substeps, method, limits, clock = machine[8:]
    x, held, commands, ring, goal, seen, memory, speeds, gust, air, voltage, random, draws = live
    inputs, work, loads, last, slopes, middle = scratch
    begin = np.empty(6)
    row = 0
    for k in range(first, first + steps + (1 if close else 0)):
        t = k * dt
        environment(t, wind, wind_table, fault, battery, clock, x, held, gust, air, speeds, voltage)
        if k == 0:
            loads_at(x, held, kernel, body, inputs, work, last)
        observe(body, sensors, x, last, speeds, random, draws, seen)
        if reference != EXTERNAL:
            goal_at(reference, path, table, t, goal)
        controller_step(kind, gains, memory, t, dt, seen, goal, commands)
        for i in range(4):
            if not math.isfinite(commands[i]):
                return NO_COMMAND, k - first, row
        actuate(k, dt, drive, battery, body, x, held, ring, commands, voltage, speeds)
        wanted = (k - first) % every == 0
        if wanted:
            note(t, body, x, held, goal, commands, loads, air, voltage, speeds, seen, log, row)
        if k == first + steps:
            loads_at(x, held, kernel, body, inputs, work, begin)
        else:
            for part in range(substeps):
                advance(method, dt / substeps, x, held, kernel, body, inputs, work, loads, last, slopes, middle)
                if part == 0:
                    begin[:] = loads
            next_gust(wind, dt, random, draws, gust)
        if wanted:
            if log.shape[1] >= LOG:
                for i in range(6):
                    log[row, LOADS + i] = begin[i]
            row += 1
        status = status_of(x, limits)
        if status != FINE:
            return status, k + 1 - first, row
    return FINE, steps, row


class Draws(NamedTuple):
    """What differs between the simulations of a batch, one row each.

    x (B, 17 + own) initial states; seeds (B, 2) uint64 of noise and gusts; body (B, BODY); fault (B, 9); wind (B, 9);
    gains (B, G) of the controller; path (B, R) parameters of the reference
    """

    x: np.ndarray
    seeds: np.ndarray
    body: np.ndarray
    fault: np.ndarray
    wind: np.ndarray
    gains: np.ndarray
    path: np.ndarray


@njit(cache=True, error_model="numpy")
def one_of_many(machine, draws, b, memory, steps, every, log):
    """Simulation number b of a batch; returns (status, steps done)."""
    mine = Machine(
        machine.kernel, draws.body[b], machine.drive, machine.battery, draws.fault[b], machine.sensors, draws.wind[b],
        machine.wind_table, machine.controller, draws.gains[b], machine.reference, draws.path[b], machine.table,
        machine.dt, machine.substeps, machine.method, machine.limits, machine.clock,
    )  # fmt: skip
    live = live_of(mine, draws.x[b], memory, draws.seeds[b, 0], draws.seeds[b, 1])
    status, done, _ = fly(mine, live, scratch_of(machine.kernel, len(live.x) - STATES), 0, steps, every, log, True)
    return status, done


@njit(cache=True, error_model="numpy", nogil=True)
def fly_some(machine, draws, first, stop, memory, steps, every, logs, status, done):
    """Simulations first .. stop - 1 of a batch: logs (B, rows, SHORT_LOG or LOG), status (B,), done (B,) are filled.

    It holds no lock of Python's, so that several threads can work at a batch, each on simulations of its own.
    """
    for b in range(first, stop):
        status[b], done[b] = one_of_many(machine, draws, b, memory, steps, every, logs[b])
