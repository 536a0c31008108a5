"""Roll-outs against analytic motion, conserved quantities and an independent integrator."""

import numpy as np
import pytest
from plain_rollout import Body, hold_states, rollout_body
from scipy.integrate import solve_ivp

from quasi.attitude import GRAVITY, from_euler, matrix, rotate
from quasi.errors import DataError, ShapeError
from quasi.simulation.tools.rollout import compute_errors

INERTIA = np.array([[8.65e-4, 2e-5, 4e-5], [2e-5, 1.07e-3, -3e-5], [4e-5, -3e-5, 1.71e-3]])
MASS = 0.433


def nothing(state, speeds, accelerations):
    return np.zeros((len(state), 3)), np.zeros((len(state), 3))


def grid(n, dt=0.002):
    return np.arange(n) * dt


def states(n, **values):
    names = ["roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z"]
    s = np.zeros((n, 12))
    for name, value in values.items():
        s[:, names.index(name)] = value
    return s


def test_free_fall_is_a_parabola_whatever_the_attitude_and_spin():
    n = 501
    s = states(n, roll=0.5, pitch=-0.4, yaw=1.0, u=3.0, v=-1.0, w=0.5, p=4.0, q=-3.0, r=5.0, x=1.0, z=-2.0)
    out = rollout_body(Body(MASS, INERTIA, nothing), grid(n), s, np.zeros((n, 4)), np.array([0]), 1.0)[0]
    v0 = rotate(from_euler(0.5, -0.4, 1.0), np.array([3.0, -1.0, 0.5]))
    expected = np.array([1.0, 0.0, -2.0]) + v0 + 0.5 * np.array([0, 0, GRAVITY])
    np.testing.assert_allclose(out[-1, 9:], expected, atol=1e-7)
    velocity = rotate(from_euler(*out[-1, :3]), out[-1, 3:6])
    np.testing.assert_allclose(velocity, v0 + np.array([0, 0, GRAVITY]), atol=1e-7)


def test_net_forces_need_no_gravity():
    n = 101
    out = rollout_body(Body(MASS, INERTIA, nothing, False), grid(n), states(n, u=1.0), np.zeros((n, 4)), [0], 0.2)[0]
    np.testing.assert_allclose(out[-1, 9:], [0.2, 0, 0], atol=1e-12)


def test_a_symmetric_top_precesses_at_the_printed_rate():
    # Goldstein, Classical Mechanics, 3rd ed., eq. (5.47): body-cone rate (I3 - I1) r / I1
    n, dt = 501, 0.001
    inertia = np.diag([1e-3, 1e-3, 1.8e-3])
    r, p = 12.0, 1.5
    out = rollout_body(
        Body(1.0, inertia, nothing, False), grid(n, dt), states(n, p=p, r=r), np.zeros((n, 4)), [0], 0.5
    )[0]
    rate = (1.8e-3 - 1e-3) / 1e-3 * r
    t = grid(n, dt)
    np.testing.assert_allclose(out[:, 6], p * np.cos(rate * t), atol=1e-7)
    np.testing.assert_allclose(out[:, 7], p * np.sin(rate * t), atol=1e-7)
    np.testing.assert_allclose(out[:, 8], r, atol=1e-12)


def test_a_torque_free_body_keeps_energy_and_angular_momentum_in_the_earth_frame():
    n = 501
    s = states(n, roll=0.2, pitch=0.1, p=6.0, q=-4.0, r=3.0)
    out = rollout_body(Body(MASS, INERTIA, nothing, False), grid(n), s, np.zeros((n, 4)), [0], 1.0)[0]
    energy = 0.5 * np.einsum("ni,ij,nj->n", out[:, 6:9], INERTIA, out[:, 6:9])
    np.testing.assert_allclose(energy, energy[0], rtol=1e-8)
    momentum = rotate(from_euler(*out[:, :3].T), out[:, 6:9] @ INERTIA)
    np.testing.assert_allclose(momentum, np.repeat(momentum[:1], n, axis=0), atol=1e-8 * np.linalg.norm(momentum[0]))


def lively(state, speeds, accelerations):
    """Forces and moments that depend on everything."""
    u, v, w = state[:, 3:6].T
    p, q, r = state[:, 6:9].T
    thrust = 1.3e-6 * np.sum(speeds**2, axis=1)
    forces = np.column_stack([-0.05 * u, -0.05 * v, -thrust - 0.02 * w * np.abs(w)])
    moments = np.column_stack(
        [
            1e-7 * (speeds[:, 3] ** 2 + speeds[:, 2] ** 2 - speeds[:, 1] ** 2 - speeds[:, 0] ** 2) - 1e-3 * p,
            2e-4 * u - 1e-3 * q,
            3e-6 * np.sum(accelerations, axis=1) - 1e-3 * r + 1e-4 * np.sin(state[:, 0]),
        ]
    )
    return forces, moments


def test_a_window_equals_an_independent_integrator():
    n, dt = 251, 0.002
    t = grid(n, dt)
    speeds = 900 + 40 * np.column_stack([np.sin((3 + k) * t + k) for k in range(4)])
    s = states(n, roll=0.3, pitch=-0.2, yaw=2.0, u=2.0, v=1.0, w=-0.5, p=1.0, q=0.5, r=-1.0)
    start, steps = 20, 100
    out = rollout_body(Body(MASS, INERTIA, lively), t, s, speeds, np.array([start]), steps * dt)[0]

    def equations(time, y):
        # rotation matrix instead of quaternion, linear interpolation by numpy
        rotation, v, omega = y[:9].reshape(3, 3), y[9:12], y[12:15]
        now = np.array([np.interp(time, t, speeds[:, k]) for k in range(4)])
        cell = min(int(time / dt + 1e-9), n - 2)
        slope = (speeds[cell + 1] - speeds[cell]) / dt
        roll = np.arctan2(rotation[2, 1], rotation[2, 2])
        state = np.concatenate([[roll, -np.arcsin(rotation[2, 0]), 0.0], v, omega, np.zeros(3)])
        force, moment = lively(state[None], now[None], slope[None])
        skew = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
        return np.concatenate(
            [
                (rotation @ skew).ravel(),
                force[0] / MASS + rotation.T @ [0, 0, GRAVITY] - skew @ v,
                np.linalg.solve(INERTIA, moment[0] - skew @ INERTIA @ omega),
                rotation @ v,
            ]
        )

    y = np.concatenate([matrix(from_euler(*s[0, :3])).ravel(), s[0, 3:]])
    for k in range(steps):  # cell by cell, so that the kinks of the speeds lie between the integrator's steps
        y = solve_ivp(equations, (t[start + k], t[start + k + 1]), y, rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(out[-1, 3:], y[9:], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(matrix(from_euler(*out[-1, :3])), y[:9].reshape(3, 3), atol=1e-7)


def test_windows_together_equal_windows_alone_and_substeps_agree():
    n = 300
    t = grid(n)
    r = np.random.default_rng(0)
    s = states(n) + 0.3 * r.standard_normal((n, 12))
    speeds = 900 + 10 * r.standard_normal((n, 4))
    body = Body(MASS, INERTIA, lively)
    starts = np.array([0, 50, 190])
    together = rollout_body(body, t, s, speeds, starts, 0.2)
    assert together.shape == (3, 101, 12)
    np.testing.assert_array_equal(together[:, 0, 3:], s[starts, 3:])
    for k, start in enumerate(starts):
        np.testing.assert_allclose(
            rollout_body(body, t, s, speeds, [start], 0.2)[0], together[k], rtol=1e-12, atol=1e-14
        )
    np.testing.assert_allclose(rollout_body(body, t, s, speeds, starts, 0.2, substeps=4), together, atol=1e-6)


def test_errors_are_angles_and_earth_frame_vectors():
    truth = states(3, yaw=3.1, u=2.0, p=1.0)
    guess = truth[None].copy()
    guess[..., 2] = -3.1
    guess[..., 6] = 1.5
    found = compute_errors(guess, truth, [0])
    np.testing.assert_allclose(found["attitude"], 2 * np.pi - 6.2, atol=1e-7)
    np.testing.assert_allclose(found["rate"], 0.5)
    np.testing.assert_allclose(found["velocity"], 2 * 2.0 * np.sin((2 * np.pi - 6.2) / 2), rtol=1e-6)
    np.testing.assert_allclose(found["position"], 0.0)


def test_holding_keeps_the_start():
    s = np.random.default_rng(1).standard_normal((10, 12))
    kept = hold_states(s, [2, 5], 3)
    assert kept.shape == (2, 4, 12)
    np.testing.assert_array_equal(kept[1], np.repeat(s[5:6], 4, axis=0))


def test_wrong_input_is_refused():
    body = Body(MASS, INERTIA, nothing)
    with pytest.raises(DataError, match="leaves the 50 rows"):
        rollout_body(body, grid(50), states(50), np.zeros((50, 4)), [40], 0.1)
    with pytest.raises(ShapeError, match="states must be"):
        rollout_body(body, grid(50), states(49), np.zeros((50, 4)), [0], 0.01)
    with pytest.raises(DataError, match="evenly spaced"):
        rollout_body(body, np.sort(np.random.default_rng(0).random(50)), states(50), np.zeros((50, 4)), [0], 0.01)
