"""Many closed loops at once, compiled: eight drones in the lanes of vectors, with the functions of `closed_loop`.

A block of eight drones keeps its whole state in one array (rows, 8), which fits in the nearest cache. Each function of
a step runs once for the block, on views of its rows (`quasi.terms.lanes`). Every lane carries out the operations of the
single loop in the same order and draws from the same streams, so each drone gives the numbers of its own simulation.
Only these run drone by drone: the initial state of the loop and the controller, the reference where drones have
different ones, saturated allocations, and rows of the log.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.simulation.control.controllers import initialise_memory, run_controller
from quasi.simulation.control.parameters import MODEL_START
from quasi.simulation.control.references import STEPS_REFERENCE, TABLE_REFERENCE, evaluate_reference
from quasi.simulation.loop.closed_loop import (
    FAULT_SIZE,
    LOG_STATE,
    LOG_TIME,
    SETPOINT_SIZE,
    STATUS_FINE,
    STATUS_NO_COMMAND,
    LoopParameters,
    actuate_rotors,
    check_state,
    make_loop_state,
    measure,
    update_environment,
)
from quasi.simulation.vehicle.dynamics import compute_loads, integrate_step
from quasi.simulation.vehicle.layout import BODY_SIZE, STATE_SIZE
from quasi.simulation.vehicle.sensors_and_wind import MEASUREMENT_SIZE, advance_gust
from quasi.terms.lanes import LANES, all_lanes, get_entry, make_vectors, reshape_lanes, set_entry, view_lanes

_RANDOM_ROWS = 30  # 19 normal numbers, one left over, and 10 squared radii; see `draw_normals`
_WIND_SIZE = 9


class BatchParameters(NamedTuple):
    """Parameters that differ between the simulations of a batch, one row each.

    x (B, 17 + extra states) initial states; seeds (B, 2) uint64 of noise and gusts; body (B, BODY_SIZE); fault (B, 9);
    wind (B, 9); gains (B, G) of the controller; path (B, R) parameters of the reference
    """

    x: np.ndarray
    seeds: np.ndarray
    body: np.ndarray
    fault: np.ndarray
    wind: np.ndarray
    gains: np.ndarray
    path: np.ndarray


def make_block_memory(parameters: LoopParameters, extra_states: int, memory: int) -> np.ndarray:
    """Work array (rows, 8) of one thread, aligned to its rows; memory  size of the controller's memory."""
    code = parameters.kernel.code
    states, inputs = STATE_SIZE + extra_states, int(code[6])
    ring = 4 * (int(np.floor(parameters.drive.delay / parameters.dt + 1e-9)) + 2)
    rows = 6 * states + 2 * inputs + ring + memory + int(code[0]) + int(code[1]) + int(code[3])
    rows += SETPOINT_SIZE + MEASUREMENT_SIZE + BODY_SIZE + FAULT_SIZE + _WIND_SIZE + MODEL_START + _RANDOM_ROWS
    rows += 4 + 4 + 3 + 3 + 1 + 6 + 6  # commands, speeds, gust, air, voltage, loads at begin and end of a step
    return make_vectors(rows)


@njit(cache=True, error_model="numpy")
def _equal(a, b):
    """Whether two arrays (n,) hold the same numbers; NumPy's `array_equal` takes ten times as long to compile."""
    for i in range(len(a)):  # noqa: SIM110 - no generators in compiled code
        if a[i] != b[i]:
            return False
    return True


@njit(cache=True, error_model="numpy")
def _find_block_end(parameters, batch, first, stop):
    """End of the block that begins with drone `first`: at most eight, with one kind of setpoint and one NDI model."""
    has_kind = parameters.reference == STEPS_REFERENCE or parameters.reference == TABLE_REFERENCE
    end = first + 1
    while end < min(first + LANES, stop):
        if has_kind and batch.path[end, 0] != batch.path[first, 0]:
            break
        if not _equal(batch.gains[end, MODEL_START:], batch.gains[first, MODEL_START:]):
            break
        end += 1
    return end


@njit(cache=True, error_model="numpy")
def _fill_lane(view, lane, values):
    for i in range(min(len(view), len(values))):
        set_entry(view, i, lane, values[i])


@njit(cache=True, error_model="numpy")
def _read_lane(view, lane, values):
    for i in range(min(len(view), len(values))):
        values[i] = get_entry(view, i, lane)


@njit(cache=True, error_model="numpy")
def _vary_parameters(parameters, batch, b):
    p = parameters
    return LoopParameters(
        p.kernel, batch.body[b], p.drive, p.battery, batch.fault[b], p.sensors, batch.wind[b], p.wind_table,
        p.controller, batch.gains[b], p.reference, batch.path[b], p.table, p.dt, p.substeps, p.method, p.limits,
        p.clock,
    )  # fmt: skip


@njit(cache=True, error_model="numpy", nogil=True)
def _run_block(parameters, batch, first, end, memory_size, steps, every, logs, status, done, room):
    """Run drones first .. end - 1, at most eight or none; lanes without a drone repeat the last one.

    It releases Python's global lock, so that several threads can run blocks at once.
    """
    if first == end:
        return
    kernel, _, drive, battery, _, sensors, _, wind_table = parameters[:8]
    kind, _, reference, _, table, dt, substeps, method, limits, clock = parameters[8:]
    drones, states, packed_gains, packed_path = end - first, batch.x.shape[1], batch.gains[first], batch.path[first]
    inputs_size, code = int(kernel.code[6]), kernel.code
    room[:] = 0.0
    cells = view_lanes(room)
    x, cells = cells[:states], cells[states:]
    stage_state, cells = cells[:states], cells[states:]
    derivatives, cells = reshape_lanes(cells[: 4 * states], states), cells[4 * states :]
    step_inputs, cells = cells[:inputs_size], cells[inputs_size:]
    inputs, cells = cells[:inputs_size], cells[inputs_size:]
    size = int(code[0]) + int(code[1]) + int(code[3])
    work, cells = cells[:size], cells[size:]
    memory, cells = cells[:memory_size], cells[memory_size:]
    setpoint, cells = cells[:SETPOINT_SIZE], cells[SETPOINT_SIZE:]
    measurement, cells = cells[:MEASUREMENT_SIZE], cells[MEASUREMENT_SIZE:]
    body, cells = cells[:BODY_SIZE], cells[BODY_SIZE:]
    fault, cells = cells[:FAULT_SIZE], cells[FAULT_SIZE:]
    wind, cells = cells[:_WIND_SIZE], cells[_WIND_SIZE:]
    gains, cells = cells[:MODEL_START], cells[MODEL_START:]
    random_numbers, cells = cells[:_RANDOM_ROWS], cells[_RANDOM_ROWS:]
    commands, speeds, gust, air, voltage = cells[:4], cells[4:8], cells[8:11], cells[11:14], cells[14:15]
    loads, last_loads, cells = cells[15:21], cells[21:27], cells[27:]
    ring = reshape_lanes(cells, 4)
    random = np.empty((2, LANES), np.uint64)
    one_x, one_setpoint = np.empty(STATE_SIZE), np.zeros(SETPOINT_SIZE)
    one_measurement, one_memory, one_gains = np.empty(MEASUREMENT_SIZE), np.zeros(memory_size), np.empty(MODEL_START)
    shared_path = True
    for lane in range(LANES):
        b = min(first + lane, end - 1)
        begin = make_loop_state(
            _vary_parameters(parameters, batch, b), batch.x[b], np.int64(0), batch.seeds[b, 0], batch.seeds[b, 1]
        )
        _fill_lane(x, lane, begin.x)
        _fill_lane(step_inputs, lane, begin.step_inputs)
        _fill_lane(commands, lane, begin.commands)
        _fill_lane(gust, lane, begin.gust)
        _fill_lane(body, lane, batch.body[b])
        _fill_lane(fault, lane, batch.fault[b])
        _fill_lane(wind, lane, batch.wind[b])
        _fill_lane(gains, lane, batch.gains[b])
        for row in range(len(begin.ring)):
            for i in range(4):
                set_entry(cells, 4 * row + i, lane, begin.ring[row, i])
        random[0, lane], random[1, lane] = begin.random[0], begin.random[1]
        shared_path = shared_path and _equal(batch.path[b], batch.path[first])
    running, left, row = np.zeros(LANES, np.bool_), drones, 0
    running[:drones] = True
    for k in range(steps + 1):
        t = k * dt
        update_environment(t, wind, wind_table, fault, battery, clock, x, step_inputs, gust, air, speeds, voltage)
        if k == 0:
            compute_loads(x, step_inputs, kernel, body, inputs, work, last_loads)
        measure(body, sensors, x, last_loads, speeds, random, random_numbers, measurement)
        if shared_path:
            evaluate_reference(reference, packed_path, table, t, one_setpoint)
            for i in range(SETPOINT_SIZE):
                setpoint[i] = one_setpoint[i]
        else:
            for lane in range(drones):
                evaluate_reference(reference, batch.path[first + lane], table, t, one_setpoint)
                _fill_lane(setpoint, lane, one_setpoint)
        if k == 0:
            for lane in range(LANES):
                one_memory[:] = 0.0
                _read_lane(gains, lane, one_gains)
                _read_lane(measurement, lane, one_measurement)
                initialise_memory(one_gains, one_memory, dt, one_measurement)
                _fill_lane(memory, lane, one_memory)
        run_controller(kind, gains, packed_gains, memory, dt, measurement, setpoint, commands)
        finite = abs(commands[0]) < np.inf
        for i in range(1, 4):
            finite = finite & (abs(commands[i]) < np.inf)
        if not all_lanes(finite):
            for lane in range(drones):
                known = True
                for i in range(4):
                    known = known and np.isfinite(get_entry(commands, i, lane))
                if running[lane] and not known:
                    running[lane], left = False, left - 1
                    status[first + lane], done[first + lane] = STATUS_NO_COMMAND, k
        actuate_rotors(k, dt, drive, battery, body, x, step_inputs, ring, commands, voltage, speeds)
        if k % every == 0:
            for lane in range(drones):
                if running[lane]:
                    logs[first + lane, row, LOG_TIME] = t
                    for i in range(STATE_SIZE):
                        logs[first + lane, row, LOG_STATE + i] = get_entry(x, i, lane)
            row += 1
        if k < steps:
            for _ in range(substeps):
                integrate_step(
                    method, dt / substeps, x, step_inputs, kernel, body, inputs, work, loads, last_loads, derivatives,
                    stage_state,
                )  # fmt: skip
            advance_gust(wind, dt, random, random_numbers, gust)
        fine = abs(x[0]) <= limits[0]
        for i in range(1, STATE_SIZE):
            fine = fine & (abs(x[i]) <= limits[i])
        if not all_lanes(fine):
            for lane in range(drones):
                _read_lane(x, lane, one_x)
                found = check_state(one_x, limits)
                if running[lane] and found != STATUS_FINE:
                    running[lane], left = False, left - 1
                    status[first + lane], done[first + lane] = found, k + 1
        if left == 0:
            return
    for lane in range(drones):
        if running[lane]:
            status[first + lane], done[first + lane] = STATUS_FINE, steps


def run_batch_part(parameters, batch, first, stop, memory, steps, every, logs, status, done, room):
    """Run simulations first .. stop - 1 of a batch; fill logs (B, rows, log size), status (B,) and done (B,).

    room  of `make_block_memory`. Plain Python: a compiled loop would have all of a block compiled into it again.
    """
    if first == stop:  # compiles
        _run_block(parameters, batch, first, stop, memory, steps, every, logs, status, done, room)
    while first < stop:
        end = _find_block_end(parameters, batch, first, stop)
        _run_block(parameters, batch, first, end, memory, steps, every, logs, status, done, room)
        first = end
