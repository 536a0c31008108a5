"""The simulator's physics against rotation matrices and the model's own prediction, conserved sums, closed forms."""

import math

import numpy as np
import pytest
from plain_plant import made_model
from simulations import state_derivative

from quasi.attitude import GRAVITY, from_euler, matrix
from quasi.model.model import Model
from quasi.simulation.loop.setup import make_step_inputs
from quasi.simulation.vehicle.dynamics import (
    EULER,
    GIVEN_ACCELERATION,
    RK4,
    ROOT_EFFECTIVENESS,
    ROTOR_SPEEDS,
    SPEED_CAP,
    STATE_SIZE,
    TARGET_SPEED,
    WIND_VELOCITY,
    integrate_step,
    make_body_constants,
    make_scratch,
)
from quasi.simulation.vehicle.sensors_and_wind import (
    SENSOR_ROW,
    advance_gust,
    draw_first_gust,
    draw_normals,
    interpolate_table,
    seed_generator,
)

INERTIA = np.array([[8.65e-4, 2e-5, 4e-5], [2e-5, 1.07e-3, -3e-5], [4e-5, -3e-5, 1.71e-3]])


@pytest.fixture(scope="module")
def model():
    return made_model(asymmetric=True)


@pytest.fixture(scope="module")
def nothing():
    """A model without forces and moments."""
    document = dict(made_model().document)
    document["axes"] = {
        a: {**part, "terms": [{**part["terms"][0], "coefficient": 0.0}], "covariance": [[0.0]]}
        for a, part in document["axes"].items()
    }
    return Model(document)


def slopes_of(model, x, held, up=0.03, down=0.05, offset=0.0):
    body = make_body_constants(model.airframe.mass, INERTIA, model.kernel, GRAVITY, up, down, math.inf, offset)
    scratch = make_scratch(model.kernel)
    state_derivative(x, held, model.kernel, body, scratch.inputs, scratch.work, scratch.loads, scratch.derivatives)
    return scratch.derivatives[0].copy(), scratch.loads.copy()


def random_state(rng):
    q = rng.standard_normal(4)
    return np.concatenate([q / np.linalg.norm(q), 3 * rng.standard_normal(9), 1500 + 200 * rng.standard_normal(4)])


@pytest.mark.parametrize("seed", range(4))
def test_the_derivative_is_newtons_and_eulers_with_the_models_own_prediction(model, seed):
    rng = np.random.default_rng(seed)
    x = random_state(rng)
    held = make_step_inputs(len(model.inputs), 1500.0)
    held[GIVEN_ACCELERATION : GIVEN_ACCELERATION + 4] = np.nan
    held[TARGET_SPEED : TARGET_SPEED + 4] = 1500 + 300 * rng.standard_normal(4)
    held[WIND_VELOCITY : WIND_VELOCITY + 3] = rng.standard_normal(3)
    held[SPEED_CAP] = x[ROTOR_SPEEDS] - 100.0  # rotor 1 beyond its cap: it stays there and has no acceleration
    held[ROOT_EFFECTIVENESS + 1] = math.sqrt(0.6)
    offset = 1e-3 * rng.standard_normal(6)
    found, loads = slopes_of(model, x, held, offset=offset)

    rotation, v, omega = matrix(x[:4]), x[4:7], x[7:10]
    gap = held[TARGET_SPEED : TARGET_SPEED + 4] - x[ROTOR_SPEEDS:]
    acceleration = gap / np.where(gap > 0, 0.03, 0.05)
    speeds, felt = x[ROTOR_SPEEDS:].copy(), acceleration.copy()
    speeds[0], felt[0] = held[SPEED_CAP], 0.0
    speeds[1] *= math.sqrt(0.6)
    air = v - rotation.T @ held[WIND_VELOCITY : WIND_VELOCITY + 3]
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    state = np.array([roll, -math.asin(rotation[2, 0]), math.atan2(rotation[1, 0], rotation[0, 0]), *air, *omega,
                      *x[10:13]])  # fmt: skip
    force, moment = model.predict(state, speeds, felt)
    force, moment = force - offset[:3], moment - offset[3:]
    skew = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
    np.testing.assert_allclose(loads, [*force, *moment], rtol=1e-12, atol=1e-14)
    dv = force / model.airframe.mass + rotation.T @ [0, 0, GRAVITY] - skew @ v
    np.testing.assert_allclose(found[4:7], dv, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found[7:10], np.linalg.solve(INERTIA, moment - skew @ INERTIA @ omega), rtol=1e-11)
    np.testing.assert_allclose(found[10:13], rotation @ v, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found[ROTOR_SPEEDS:], acceleration, rtol=1e-13)
    # the attitude: d(R)/dt = R [omega]
    h = 1e-6
    after, before = (matrix((x[:4] + s * h * found[:4]) / np.linalg.norm(x[:4] + s * h * found[:4])) for s in (1, -1))
    np.testing.assert_allclose((after - before) / (2 * h), rotation @ skew, atol=1e-8)


def fly(model, x, held, dt, steps, method=RK4, up=0.03, down=0.05, rate=math.inf, gravity=GRAVITY):
    body = make_body_constants(model.airframe.mass, INERTIA, model.kernel, gravity, up, down, rate)
    scratch = make_scratch(model.kernel)
    x, path = x.copy(), [x.copy()]
    for _ in range(steps):
        integrate_step(method, dt, x, held, model.kernel, body, *scratch)
        path.append(x.copy())
    return np.array(path)


def test_a_tumble_without_moments_keeps_energy_and_angular_momentum(nothing):
    x = np.zeros(STATE_SIZE)
    x[:4], x[7:10] = from_euler(0.3, -0.2, 1.0), [6.0, -4.0, 3.0]
    path = fly(nothing, x, make_step_inputs(20, 0.0), 0.002, 1000, gravity=0.0)
    energy = 0.5 * np.einsum("ni,ij,nj->n", path[:, 7:10], INERTIA, path[:, 7:10])
    np.testing.assert_allclose(energy, energy[0], rtol=1e-8)
    momentum = np.einsum("nij,nj->ni", matrix(path[:, :4]), path[:, 7:10] @ INERTIA)
    np.testing.assert_allclose(momentum, momentum[:1].repeat(len(path), 0), atol=1e-8 * np.linalg.norm(momentum[0]))


def test_free_fall_is_a_parabola_whatever_attitude_and_spin(nothing):
    x = np.zeros(STATE_SIZE)
    x[:4], x[4:7], x[7:10] = from_euler(0.5, -0.4, 1.0), [3.0, -1.0, 0.5], [4.0, -3.0, 5.0]
    end = fly(nothing, x, make_step_inputs(20, 0.0), 0.002, 500)[-1]
    v = matrix(x[:4]) @ x[4:7]
    np.testing.assert_allclose(end[10:13], v + [0, 0, 0.5 * GRAVITY], atol=1e-7)
    np.testing.assert_allclose(matrix(end[:4]) @ end[4:7], v + [0, 0, GRAVITY], atol=1e-7)


@pytest.mark.parametrize("method, order", [(EULER, 1), (RK4, 4)])
def test_integrators_have_their_order(model, method, order):
    x = random_state(np.random.default_rng(3))
    held = make_step_inputs(len(model.inputs), 1500.0)
    held[GIVEN_ACCELERATION : GIVEN_ACCELERATION + 4] = np.nan
    held[TARGET_SPEED : TARGET_SPEED + 4] = x[ROTOR_SPEEDS:] + 100.0  # all of them up: the lag has no kink on the way
    exact = fly(model, x, held, 0.0001, 1000)[-1]
    errors = [np.linalg.norm(fly(model, x, held, h, round(0.1 / h), method)[-1] - exact) for h in (0.005, 0.0025)]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25)


def test_a_body_carried_along_by_the_wind_feels_what_it_feels_in_still_air(model):
    x = random_state(np.random.default_rng(5))
    held = make_step_inputs(len(model.inputs), 1500.0)
    _, calm = slopes_of(model, x, held)
    wind = np.array([2.0, -3.0, 1.0])
    held[WIND_VELOCITY : WIND_VELOCITY + 3] = wind
    x[4:7] += matrix(x[:4]).T @ wind
    _, carried = slopes_of(model, x, held)
    np.testing.assert_allclose(carried, calm, rtol=1e-11, atol=1e-13)


def test_rotors_follow_their_lag_up_and_down_and_their_rate_limit(model):
    x = np.zeros(STATE_SIZE)
    x[0], x[ROTOR_SPEEDS:] = 1.0, 1500.0
    held = make_step_inputs(len(model.inputs), 1500.0)
    held[GIVEN_ACCELERATION : GIVEN_ACCELERATION + 4] = np.nan
    held[TARGET_SPEED : TARGET_SPEED + 4] = [1600.0, 1400.0, 1500.0, 1600.0]
    path = fly(model, x, held, 0.001, 60)
    t = 0.001 * np.arange(61)
    np.testing.assert_allclose(path[:, ROTOR_SPEEDS], 1600 - 100 * np.exp(-t / 0.03), rtol=1e-9)
    np.testing.assert_allclose(path[:, ROTOR_SPEEDS + 1], 1400 + 100 * np.exp(-t / 0.05), rtol=1e-9)
    limited = fly(model, x, held, 0.001, 20, rate=1000.0)
    np.testing.assert_allclose(limited[:, ROTOR_SPEEDS], 1500 + 1000.0 * t[:21], rtol=1e-12)


def test_random_numbers_are_normal_independent_and_repeat():
    random = np.array([seed_generator(7, 0), seed_generator(7, 1)], np.uint64)
    draws = np.empty(200001)
    draw_normals(random, SENSOR_ROW, draws, len(draws))
    n = len(draws)
    assert abs(draws.mean()) < 4 / math.sqrt(n) and abs(draws.var() - 1) < 4 * math.sqrt(2 / n)
    assert abs(np.mean(draws**4) - 3) < 4 * math.sqrt(96 / n) and abs(np.mean(draws**3)) < 4 * math.sqrt(15 / n)
    assert abs(np.mean(draws[1:] * draws[:-1])) < 4 / math.sqrt(n)
    again = np.empty(5)
    draw_normals(np.array([seed_generator(7, 0), 0], np.uint64), SENSOR_ROW, again, 5)
    np.testing.assert_array_equal(again, draws[:5])
    rows = [seed_generator(s, r) for s in range(100) for r in (0, 1)]
    assert len(set(rows)) == 200


def test_gusts_have_their_deviation_and_correlation_time():
    wind = np.array([0, 0, 0, 0.5, 1.0, 0.0, 0.2, 0.4, 1.0], float)
    random, draws, gust = np.array([1, seed_generator(3, 1)], np.uint64), np.zeros(19), np.zeros(3)
    draw_first_gust(wind, random, draws, gust)
    path = np.empty((100000, 3))
    for k in range(len(path)):
        advance_gust(wind, 0.02, random, draws, gust)
        path[k] = gust
    np.testing.assert_allclose(path.std(axis=0), [0.5, 1.0, 0.0], rtol=0.04)
    for axis, lag in ((0, 10), (1, 20)):  # at one correlation time it is 1/e
        both = np.mean(path[lag:, axis] * path[:-lag, axis]) / np.mean(path[:, axis] ** 2)
        assert both == pytest.approx(math.exp(-1), abs=0.05)


def test_tables_are_linear_between_rows_and_held_beyond():
    table = np.array([[0.0, 1.0, 5.0], [1.0, 3.0, 5.0], [4.0, 0.0, 8.0]])
    out = np.zeros(2)
    for t in (-1.0, 0.0, 0.25, 1.0, 2.5, 4.0, 9.0):
        interpolate_table(table, t, out)
        np.testing.assert_allclose(out, [np.interp(t, table[:, 0], table[:, k]) for k in (1, 2)])
