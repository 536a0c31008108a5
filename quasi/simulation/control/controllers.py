"""Controllers from measurement and setpoint to commanded rotor speeds; compiled. `registry.LAWS` lists them.

All share the outer loops (outer_loop.py) and the allocation. They differ in how they compute the loads for a wanted
angular acceleration and thrust: pid.py, ndi.py, indi.py. Where a rotor lags more than the actuators' lag explains, its
limit is learnt, so that the allocation can reduce yaw.

    kind, parameters, size = make_controller({"controller": "INDI"}, model)
    memory = np.zeros(size)
    controller_step(kind, parameters, memory, dt, measurement, setpoint, commands)

measurement (26,): attitude w x y z, u v w, p q r, x y z, rotor speeds (rad/s), specific force ax ay az (m/s2),
reserved; setpoint (20,): see outer_loop.py; commands (4,): filled with rotor speeds, rad/s. dt must be constant.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit

from quasi.model.model import Model
from quasi.simulation.control import law
from quasi.simulation.control import parameters as g
from quasi.simulation.control.allocation import allocate_rotors, invert_matrix
from quasi.simulation.control.control_model import make_control_model
from quasi.simulation.control.gains import complete_settings
from quasi.simulation.control.outer_loop import CONTROLLER_STATUS, RUNNING, SATURATED
from quasi.simulation.control.registry import LAWS, find_law, run_law
from quasi.terms.lanes import all_lanes, any_lane, choose, count_lanes, get_entry, set_entry

_MAX_TIME_BEHIND = 0.05  # s that a rotor may lag before its limit is learnt
_LIMIT_RECOVERY_TIME = 0.5  # s in which an outdated learnt limit doubles


def make_controller(
    settings: Mapping[str, Any],
    model: Model,
    actuators: Mapping[str, Any] | None = None,
    offset: np.ndarray | None = None,
) -> tuple[int, np.ndarray, int]:
    """Kind, parameters and size of the memory for `controller_step`.

    settings   see `gains.complete_settings`; {"controller": "INDI"} takes every default
    model      the vehicle; its forces and moments about hover give the effectiveness
    actuators  see `make_control_model`
    offset     (6,) N, N m that the simulation subtracts from the model's forces and moments; NDI subtracts it too
    Raises ConfigError for impossible settings, DataError for a model that cannot be controlled.
    """
    vehicle = make_control_model(model, actuators)
    complete = complete_settings(settings, vehicle)
    chosen = find_law(complete["controller"])
    parameters = g.pack_parameters(complete, chosen.vehicle(vehicle))
    further, memory = chosen.pack(model, np.zeros(6) if offset is None else np.asarray(offset, float))
    return LAWS.index(chosen), np.concatenate([parameters, further]), law.MODEL_INPUTS + memory


@njit(cache=True, error_model="numpy")
def controller_step(kind, parameters, memory, dt, measurement, setpoint, commands):
    """Run one step of the controller `kind`: fill commands (4,), rad/s, and update the memory."""
    if memory[CONTROLLER_STATUS] == 0.0:
        initialise_memory(parameters, memory, dt, measurement)
    run_controller(kind, parameters, parameters, memory, dt, measurement, setpoint, commands)


@njit(cache=True, error_model="numpy")
def run_controller(kind, parameters, packed, memory, dt, measurement, setpoint, commands):
    """Run one step with an initialised memory; arrays, or views of eight drones (`quasi.terms.lanes`).

    packed  parameters of one drone as an array, of which NDI reads its model
    """
    run_law(kind, parameters, packed, memory, dt, measurement, setpoint)
    _allocate_commands(parameters, memory, dt, measurement, commands)


@njit(cache=True, error_model="numpy")
def initialise_memory(p, m, dt, measurement):
    """Initialise the filters with the measurement and invert the effectiveness of one step."""
    for k in range(16):
        m[law.STEP_EFFECTIVENESS + k] = p[g.EFFECTIVENESS + k]
    for i in range(4):
        m[law.STEP_EFFECTIVENESS + 8 + i] += p[g.YAW_REACTION + i] / (2.0 * p[g.HOVER_SPEED] * dt)
        m[law.LAST_COMMANDS_SQUARED + i] = measurement[13 + i] ** 2
        m[law.EXPECTED_SPEEDS + i] = m[law.LAST_COMMANDS + i] = measurement[13 + i]
        m[law.LEARNT_LIMITS + i] = p[g.HIGHEST_SPEED]
        m[law.SPEED_FILTERS + 3 * i] = m[law.SPEED_FILTERS + 3 * i + 2] = measurement[13 + i] ** 2
    for k in range(3):
        m[law.RATE_FILTERS + 3 * k] = m[law.RATE_FILTERS + 3 * k + 2] = measurement[7 + k]
    invert_matrix(
        m[law.STEP_EFFECTIVENESS : law.STEP_EFFECTIVENESS + 16],
        m[law.INVERSE_EFFECTIVENESS : law.INVERSE_EFFECTIVENESS + 16],
    )
    w, half = p[g.FILTER_FREQUENCY], 0.5 * dt
    damp, stiff = 2.0 * p[g.FILTER_DAMPING] * w * half, (w * half) ** 2
    m[law.FILTER_KEEP] = (1.0 - damp - stiff) / (1.0 + damp + stiff)
    m[law.FILTER_GAIN] = w * w * half / (1.0 + damp + stiff)
    m[law.LAG_SHARE] = 1.0 - math.exp(-dt / p[g.ACTUATOR_LAG])
    m[CONTROLLER_STATUS] = RUNNING


@njit(cache=True, error_model="numpy")
def _allocate_commands(p, m, dt, measurement, commands):
    """Compute rotor speeds for the wanted loads within the rotors' limits, and monitor whether the rotors follow."""
    if any_lane(p[g.LEARNS_ROTOR_LIMITS] > 0.0):
        _learn_limits(p, m, dt, measurement)
    inside = True
    for i in range(4):
        low, high = p[g.LOWEST_SPEED] * p[g.LOWEST_SPEED], m[law.LEARNT_LIMITS + i] * m[law.LEARNT_LIMITS + i]
        u = 0.0
        for k in range(4):
            u += m[law.INVERSE_EFFECTIVENESS + 4 * i + k] * m[law.WANTED_LOADS + k]
        inside = inside & (low <= u) & (u <= high)
        m[law.LOWEST_INPUTS + i], m[law.HIGHEST_INPUTS + i] = low, high
        m[law.ALLOCATED_INPUTS + i] = min(max(u, low), high)
    m[CONTROLLER_STATUS] = choose(inside, RUNNING, SATURATED)
    if not all_lanes(inside):
        _allocate_saturated(p, m)
    for i in range(4):
        u = m[law.ALLOCATED_INPUTS + i]
        m[law.LAST_COMMANDS_SQUARED + i] = u
        commands[i] = m[law.LAST_COMMANDS + i] = math.sqrt(u)


@njit(cache=True, error_model="numpy")
def _allocate_saturated(p, m):
    """Solve the weighted allocation of each drone whose rotors reach a limit, one after another."""
    first = law.STEP_EFFECTIVENESS
    known = np.empty(law.ALLOCATION_SCRATCH + 64 - first)  # of the memory, so that offsets stay the same
    weights = np.empty(4)
    for lane in range(count_lanes(m)):
        if get_entry(m, CONTROLLER_STATUS, lane) == RUNNING or get_entry(p, g.USES_WEIGHTED_ALLOCATION, lane) == 0.0:
            continue
        for part, size in ((first, 16), (law.WANTED_LOADS, 16)):
            for i in range(part, part + size):
                known[i - first] = get_entry(m, i, lane)
        for i in range(4):
            weights[i] = get_entry(p, g.ALLOCATION_WEIGHTS + i, lane)
        hover = get_entry(p, g.HOVER_SPEED, lane)
        wanted, low, high = (
            known[law.WANTED_LOADS - first :], known[law.LOWEST_INPUTS - first :], known[law.HIGHEST_INPUTS - first :]
        )  # fmt: skip
        u, scratch = known[law.ALLOCATED_INPUTS - first :], known[law.ALLOCATION_SCRATCH - first :]
        allocate_rotors(known, wanted, weights, low, high, hover * hover, u, scratch)
        for i in range(4):
            set_entry(m, law.ALLOCATED_INPUTS + i, lane, u[i])


@njit(cache=True, error_model="numpy")
def _learn_limits(p, m, dt, measurement):
    """Learn upper limits of the rotors, rad/s, from how they follow the commands with the actuators' lag.

    The shortfall of the best rotor is attributed to low voltage, common to all rotors, and to no limit.
    """
    alike = 0.0
    for i in range(4):
        m[law.EXPECTED_SPEEDS + i] += (m[law.LAST_COMMANDS + i] - m[law.EXPECTED_SPEEDS + i]) * m[law.LAG_SHARE]
        alike = max(alike, measurement[13 + i] / max(m[law.EXPECTED_SPEEDS + i], 1e-3))
    alike = min(alike, 1.0)
    for i in range(4):
        limit, speed = m[law.LEARNT_LIMITS + i], measurement[13 + i]
        behind = alike * m[law.EXPECTED_SPEEDS + i] - speed > 0.03 * p[g.HOVER_SPEED]
        time = max(m[law.TIME_BEHIND + i] + choose(behind, dt, -dt), 0.0)
        learns = (time > _MAX_TIME_BEHIND) & (p[g.LEARNS_ROTOR_LIMITS] > 0.0)
        recovered = min(limit * (1.0 + dt / _LIMIT_RECOVERY_TIME), p[g.HIGHEST_SPEED])
        kept = choose(behind, limit, choose(limit < p[g.HIGHEST_SPEED], recovered, limit))
        m[law.LEARNT_LIMITS + i] = choose(learns, max(1.01 * speed, 1.001 * p[g.LOWEST_SPEED]), kept)
        m[law.EXPECTED_SPEEDS + i] = choose(learns, speed, m[law.EXPECTED_SPEEDS + i])
        m[law.TIME_BEHIND + i] = choose(learns, 0.0, time)
