"""Vectors of eight numbers: their operations equal plain ones, and batches equal single simulations in every option."""

import math

import numpy as np
import pytest
from numba import njit
from plain_plant import made_model
from simulations import ROUGH, setup_of

from quasi.simulation.loop.run import simulate, simulate_many
from quasi.simulation.loop.setup import STATE_NAMES
from quasi.terms.lanes import (
    LANES,
    all_lanes,
    any_lane,
    choose,
    common_value,
    count_lanes,
    get_entry,
    make_vectors,
    reshape_lanes,
    set_entry,
    view_lanes,
)


@pytest.fixture(scope="module")
def model():
    return made_model(asymmetric=True)


@njit
def calculate(x, out):
    """The same text for arrays (3,) and views of them; out (8,)."""
    total = 0.25
    for i in range(len(x)):
        total += 2 * x[i]
    out[0] = total
    out[1] = math.sqrt(abs(x[0] * 2.0 - x[1])) + min(x[0], 0.5) - max(0.1, x[2])
    out[2] = choose((x[0] > x[1]) & (x[1] < 0.3) | (x[2] >= 0.9), -x[0], 7.0)
    out[3] = math.atan2(x[0], x[1]) + math.sin(x[2]) * math.cos(x[0]) + math.exp(x[1]) + math.log(x[2] + 0.1)
    out[4] = math.pow(x[0] + 0.1, 1.7) / x[1] + np.rint(9.0 * x[2])
    out[5] = choose(x[0] != x[0], 1.0, choose(x[0] == x[0], 2.0, 3.0))
    part = out[5:7]
    part[1] = x[0]
    part[1] -= x[1] / x[2]
    return any_lane(x[0] > 0.999), all_lanes(x[0] <= 1.0)


@njit
def calculate_lanes(cells, out):
    return calculate(view_lanes(cells), view_lanes(out))


@njit
def move_entries(cells, out):
    rows, table = view_lanes(cells), reshape_lanes(view_lanes(out), 2)
    table[1, 0] = rows[0]
    table[0, 1] = 3.0
    table[0, 1] += table[1, 0]
    set_entry(view_lanes(out), 3, 2, get_entry(rows, 1, 7))
    return common_value(rows[2]), count_lanes(rows), count_lanes(cells[0])


def test_every_operation_equals_its_plain_form_to_the_last_bit():
    cells, out = make_vectors(3), make_vectors(8)
    cells[:] = np.random.default_rng(3).random((3, LANES))
    assert cells.ctypes.data % 64 == 0
    calculate_lanes(cells, out)
    for lane in range(LANES):
        plain = np.zeros(8)
        calculate(cells[:, lane].copy(), plain)
        np.testing.assert_array_equal(out[:, lane], plain)


def test_conditions_of_some_and_of_all_lanes():
    cells, out = make_vectors(3), make_vectors(8)
    cells[:] = 0.5
    assert calculate_lanes(cells, out) == (False, True)
    cells[0, 5] = 1.0
    assert calculate_lanes(cells, out) == (True, True)
    cells[0, 2] = np.nan
    assert calculate_lanes(cells, out) == (True, False)
    assert out[5, 2] == 1.0 and out[5, 3] == 2.0


def test_entries_of_lanes_and_tables_of_vectors():
    cells, out = make_vectors(3), make_vectors(4)
    cells[:] = np.random.default_rng(4).random((3, LANES))
    assert move_entries(cells, out) == (cells[2, 0], LANES, 1)
    np.testing.assert_array_equal(out[2], cells[0])
    np.testing.assert_array_equal(out[1], 3.0 + cells[0])
    assert out[3, 2] == cells[1, 7] and not out[3, 3]


def test_the_processor_gets_vector_instructions():
    cells, out = make_vectors(3), make_vectors(8)
    calculate_lanes(cells, out)
    text = "".join(calculate_lanes.inspect_asm().values())
    assert any(name in text for name in ("sqrtpd", "fsqrt\tv"))


OPTIONS = {
    "hover, PID": {"controller": {"controller": "PID"}, "references": {"kind": "hover", "position": [1, 0, -1]}},
    "everything, NDI": {"controller": {"controller": "NDI"}, **ROUGH},
    "everything, INDI": {"controller": {"controller": "INDI"}, "simulation": {"substeps": 2}, **ROUGH},
    "Euler, weak rotor": {
        "simulation": {"integrator": "euler"},
        "faults": {**ROUGH["faults"], "time of failure": 0.1, "rotor effectiveness after failure": [0.55, 1, 1, 1]},
    },
}  # fmt: skip


@pytest.mark.parametrize("name", OPTIONS)
def test_each_drone_of_a_batch_equals_its_own_simulation(model, name):
    setup = setup_of(model, 0.6, noise={"add": True, "specific force": 0.1, "rotor speeds": 5.0}, **OPTIONS[name])
    count = LANES + 3
    many = simulate_many(setup, count, every=1)
    whole = np.column_stack([simulate(setup).table[n] for n in STATE_NAMES])
    np.testing.assert_array_equal(many.states[0], whole)
    assert len(np.unique(many.states[:, -1, 4])) == count


def test_drones_with_paths_of_their_own_equal_single_simulations(model):
    setup = setup_of(model, 0.6, references=ROUGH["references"])
    path = np.tile(setup.loop_parameters.path, (9, 1))
    path[:, 0] += 0.01 * np.arange(9)
    many = simulate_many(setup, 9, seeds=np.full(9, setup.seeds[0]), every=1, path=path)
    for b in (0, 4, 8):
        alone = simulate_many(setup, 1, seeds=np.full(1, setup.seeds[0]), every=1, path=path[b : b + 1])
        np.testing.assert_array_equal(many.states[b], alone.states[0])
    assert not np.allclose(many.states[0], many.states[8])
