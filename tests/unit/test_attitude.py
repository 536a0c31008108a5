"""Frames and quaternions against scipy, printed facts and finite rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quasi import attitude


@pytest.fixture
def quaternions():
    return attitude.normalise(np.random.default_rng(1).normal(size=(500, 4)))


def scipy_of(q):
    return Rotation.from_quat(np.roll(q, -1, axis=-1))


def test_products_rotations_and_matrices_equal_scipy(quaternions):
    a, b = quaternions[:250], quaternions[250:]
    v = np.random.default_rng(2).normal(size=(250, 3))
    product = scipy_of(a) * scipy_of(b)
    np.testing.assert_allclose(scipy_of(attitude.multiply(a, b)).as_matrix(), product.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(attitude.rotate(a, v), scipy_of(a).apply(v), atol=1e-14)
    np.testing.assert_allclose(attitude.rotate_inverse(a, v), scipy_of(a).inv().apply(v), atol=1e-14)
    np.testing.assert_allclose(attitude.matrix(a), scipy_of(a).as_matrix(), atol=1e-14)


def test_euler_angles_are_yaw_pitch_roll_in_that_order(quaternions):
    expected = scipy_of(quaternions).as_euler("ZYX")[:, ::-1]
    np.testing.assert_allclose(attitude.to_euler(quaternions), expected, atol=1e-9)
    back = attitude.from_euler(*attitude.to_euler(quaternions).T)
    np.testing.assert_allclose(np.abs(np.sum(back * quaternions, axis=-1)), 1.0, atol=1e-12)


@pytest.mark.parametrize(
    ("angles", "body", "earth"),
    [
        ((0, 0, np.pi / 2), (1, 0, 0), (0, 1, 0)),  # yawed right, the nose points east
        ((0, np.pi / 2, 0), (1, 0, 0), (0, 0, -1)),  # pitched up, the nose points to the sky
        ((np.pi / 2, 0, 0), (0, 1, 0), (0, 0, 1)),  # rolled right, the right side points to the ground
    ],
)
def test_positive_angles_turn_the_way_the_axes_say(angles, body, earth):
    np.testing.assert_allclose(attitude.rotate(attitude.from_euler(*angles), body), earth, atol=1e-15)


def test_matrix_and_back_is_the_same_rotation_near_every_half_turn(quaternions):
    edge = np.vstack([quaternions, np.eye(4), attitude.normalise(np.eye(4) + 1e-9)])
    back = attitude.from_matrix(attitude.matrix(edge))
    np.testing.assert_allclose(np.abs(np.sum(back * edge, axis=-1)), 1.0, atol=1e-12)


def test_logarithm_inverts_exponential_for_all_sizes_below_half_a_turn():
    rng = np.random.default_rng(3)
    axis = rng.normal(size=(300, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    v = axis * np.concatenate([np.logspace(-14, 0, 150), rng.uniform(0, 3.14, 150)])[:, None]
    np.testing.assert_allclose(attitude.logarithm(attitude.exponential(v)), v, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(attitude.exponential(v), np.roll(Rotation.from_rotvec(v).as_quat(), 1, -1), atol=1e-15)


def test_body_rates_of_a_constant_spin_are_that_spin_also_through_a_loop():
    t = np.sort(np.random.default_rng(4).uniform(0, 3, 400))
    rate = np.array([0.3, 4.0, -1.0])
    q = attitude.multiply(attitude.from_euler(0.2, -0.4, 1.0), attitude.exponential(t[:, None] * rate))
    q *= np.random.default_rng(5).choice([-1, 1], size=(400, 1))  # a quaternion and its negative are one attitude
    np.testing.assert_allclose(attitude.body_rates(q, t), np.broadcast_to(rate, (400, 3)), atol=1e-6)


def test_interpolation_follows_a_constant_spin_and_holds_beyond_the_ends():
    t = np.linspace(0, 1, 11)
    rate = np.array([1.0, -2.0, 0.5])
    q = attitude.exponential(t[:, None] * rate)
    at = np.array([-1.0, 0.03, 0.51, 2.0])
    expected = attitude.exponential(np.clip(at, 0, 1)[:, None] * rate)
    got = attitude.interpolate(-q, t, at)
    np.testing.assert_allclose(np.abs(np.sum(got * expected, -1)), 1.0, atol=1e-12)


def test_jpl_quaternions_mean_the_same_attitude_by_their_own_formulas(quaternions):
    # Trawny & Roumeliotis 2005, eq. (62): C(q) = (2 w^2 - 1) I - 2 w [v x] + 2 v v', earth to body
    j = attitude.to_jpl(quaternions)
    v, w = j[:, :3], j[:, 3]
    zero = np.zeros(len(j))
    skew = np.array([[zero, -v[:, 2], v[:, 1]], [v[:, 2], zero, -v[:, 0]], [-v[:, 1], v[:, 0], zero]])
    c = (2 * w**2 - 1)[:, None, None] * np.eye(3) - 2 * w[:, None, None] * np.moveaxis(skew, -1, 0)
    c += 2 * v[:, :, None] * v[:, None, :]
    np.testing.assert_allclose(np.swapaxes(c, 1, 2), attitude.matrix(quaternions), atol=1e-14)
    np.testing.assert_array_equal(attitude.from_jpl(j), quaternions)
    np.testing.assert_array_equal(attitude.to_jpl([1.0, 0.0, 0.0, 0.0]), [0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-9, 1e-7, 1e-4])
def test_euler_angles_give_the_attitude_back_at_the_poles(pitch, off):
    random = np.random.default_rng(4)
    roll, yaw = random.uniform(-np.pi, np.pi, (2, 200))
    q = attitude.from_euler(roll, np.full(200, pitch - np.sign(pitch) * off), yaw)
    angles = attitude.to_euler(q)
    assert np.all(np.abs(angles[:, [0, 2]]) <= np.pi)
    back = attitude.from_euler(*angles.T)
    np.testing.assert_allclose(attitude.matrix(back), attitude.matrix(q), atol=3e-8)
    # what is defined there: roll - yaw at the upper pole, roll + yaw at the lower one
    left = (angles[:, 0] - np.sign(pitch) * angles[:, 2]) - (roll - np.sign(pitch) * yaw)
    np.testing.assert_allclose(np.sin(left / 2), 0.0, atol=1e-7)
