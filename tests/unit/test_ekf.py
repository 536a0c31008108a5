"""The error-state filter and smoother against plain textbook versions, finite differences and made truth."""

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from rigid_body import measure, move

from quasi import attitude
from quasi.filtering import ekf
from quasi.filtering.smoother import smooth


def inputs_of(motion, frame, **changes):
    n = len(frame)
    used = np.zeros((n, 3), np.int8)
    used[:, ekf.ATTITUDE_KIND] = used[:, ekf.POSITION_KIND] = frame["attitude_sample"]
    deviation = np.repeat([0.02, 0.1, 0.01, 0.1, 0.5, 0.01], 3)
    values = ekf.Inputs(
        dt=motion.t[1] - motion.t[0],
        gyro=frame[["p", "q", "r"]].to_numpy().copy(),
        accel=frame[["ax", "ay", "az"]].to_numpy().copy(),
        noise=np.tile([0.02, 0.021, 0.022, 0.3, 0.31, 0.32], (n, 1)),
        bias_random_walk=np.array([1e-5, 2e-5, 3e-5, 1e-4, 2e-4, 3e-4]),
        used=used,
        attitude=attitude.from_euler(*frame[["roll", "pitch", "yaw"]].to_numpy().T),
        position=frame[["x", "y", "z"]].to_numpy().copy(),
        velocity=motion.v + np.random.default_rng(7).normal(0, 0.05, (n, 3)),
        body=False,
        std=np.array([[0.0035, 0.0036, 0.0037], [0.001, 0.0011, 0.0012], [0.05, 0.051, 0.052]]),
        gate=1e6,
        max_rejections=np.array([100, 100, 100]),
        quaternion=motion.q[0].copy(),
        state=np.concatenate([np.zeros(12), [0.01, -0.02, 0.015]]),
        covariance=np.diag(deviation**2),
    )
    return values._replace(**changes)


def cross(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


class Plain:
    """The same model in explicit 18 x 18 matrices, with filterpy doing predict and update."""

    def __init__(self, inputs):
        self.i = inputs
        self.q, self.x = inputs.quaternion.copy(), inputs.state.copy()
        self.filter = ExtendedKalmanFilter(18, 3)
        self.filter.P = inputs.covariance.copy()

    def predict(self, k):
        i, dt = self.i, self.i.dt
        w = 0.5 * (i.gyro[k - 1] + i.gyro[k]) - self.x[6:9]
        f0, f1 = i.accel[k - 1] - self.x[9:12], i.accel[k] - self.x[9:12]
        q1 = attitude.normalise(attitude.multiply(self.q, attitude.exponential(w * dt)))
        R0, R1, D = attitude.matrix(self.q), attitude.matrix(q1), attitude.matrix(attitude.exponential(w * dt))
        # right Jacobian of SO(3) as the power series sum (-[phi]x)^n / (n + 1)!
        Jr = np.zeros((3, 3))
        term = np.eye(3)
        factorial = 1.0
        for order in range(14):
            factorial *= order + 1
            Jr += term / factorial
            term = term @ -cross(w * dt)
        F, G = np.eye(18), np.zeros((18, 6))
        F[0:3, 0:3], F[0:3, 9:12] = D.T, -Jr * dt
        F[3:6, 0:3] = -dt / 2 * (R0 @ cross(f0) + R1 @ cross(f1) @ D.T)
        F[3:6, 9:12] = -dt / 2 * R1 @ cross(f1) @ F[0:3, 9:12]
        F[3:6, 12:15] = -dt / 2 * (R0 + R1)
        F[6:9] = F[6:9] + dt / 2 * (F[3:6] + np.eye(18)[3:6])
        G[0:3, 0:3] = F[0:3, 9:12]
        G[3:6], G[6:9] = F[3:6, 9:15], F[6:9, 9:15]
        Q = G @ np.diag(i.noise[k] ** 2) @ G.T
        Q[9:15, 9:15] += np.diag(i.bias_random_walk**2) * dt
        v = self.x[:3] + dt / 2 * (R0 @ f0 + R1 @ f1) + dt * np.array([0, 0, attitude.GRAVITY])
        self.x[3:6] += dt / 2 * (self.x[:3] + v)
        self.x[:3], self.q = v, q1
        self.filter.F, self.filter.Q, self.filter.x = F, Q, np.zeros(18)
        self.filter.predict()
        return F, self.filter.P.copy()

    def update(self, kind, k):
        i, H = self.i, np.zeros((3, 18))
        if kind == ekf.ATTITUDE_KIND:
            expected = attitude.multiply(self.q, attitude.exponential(self.x[12:15]))
            y = attitude.logarithm(attitude.multiply(attitude.conjugate(expected), i.attitude[k]))
            H[:, 0:3] = attitude.matrix(attitude.exponential(self.x[12:15])).T
            H[:, 15:18] = np.eye(3)
        elif kind == ekf.POSITION_KIND:
            y = i.position[k] - self.x[3:6]
            H[:, 6:9] = np.eye(3)
        elif i.body:
            R = attitude.matrix(self.q)
            y = i.velocity[k] - R.T @ self.x[:3]
            H[:, 0:3], H[:, 3:6] = cross(R.T @ self.x[:3]), R.T
        else:
            y = i.velocity[k] - self.x[:3]
            H[:, 3:6] = np.eye(3)
        self.filter.x = np.zeros(18)
        self.filter.update(y, lambda x: H, lambda x: H @ x, R=np.diag(i.std[kind] ** 2))
        d = self.filter.x
        self.q = attitude.normalise(attitude.multiply(self.q, attitude.exponential(d[:3])))
        self.x += d[3:]
        return d.copy()

    def run(self):
        n = len(self.i.gyro)
        q, x, P = np.zeros((n, 4)), np.zeros((n, 15)), np.zeros((n, 18, 18))
        steps = []
        for k in range(n):
            F, predicted = self.predict(k) if k else (None, None)
            moved = np.zeros(18)
            for kind in range(3):
                if self.i.used[k, kind]:
                    moved += self.update(kind, k)
            q[k], x[k], P[k] = self.q, self.x, self.filter.P
            steps.append((F, predicted, moved))
        return q, x, P, steps


def plain_smoother(q, x, P, steps):
    """Rauch-Tung-Striebel in explicit matrices, on the error state."""
    qs, xs, Ps = q.copy(), x.copy(), P.copy()
    delta = np.zeros(18)
    for k in range(len(q) - 2, -1, -1):
        F, predicted, moved = steps[k + 1]
        gain = np.linalg.solve(predicted, F @ P[k]).T
        delta = gain @ (moved + delta)
        Ps[k] = P[k] + gain @ (Ps[k + 1] - predicted) @ gain.T
        qs[k] = attitude.multiply(q[k], attitude.exponential(delta[:3]))
        xs[k] = x[k] + delta[3:]
    return qs, xs, Ps


def begun(seconds):
    motion = move(seconds=seconds, rest=0.5, seed=3, loops=False)
    return motion, measure(motion, rest=0.5)[0]


@pytest.fixture(scope="module")
def short():
    return begun(6.0)


@pytest.fixture(scope="module")
def flown():
    motion = move(seconds=40.0, seed=5)
    inputs = inputs_of(
        motion,
        measure(motion, alignment=(0.004, -0.005, 0.003))[0],
        bias_random_walk=np.full(6, 1e-7),
        noise=np.tile([0.02] * 3 + [0.3] * 3, (len(motion.t), 1)),
        std=np.repeat([[0.0035], [0.001], [0.05]], 3, axis=1),
    )
    forward = ekf.forward(inputs)
    return motion, inputs, forward, smooth(inputs, forward)


@pytest.mark.parametrize("body", [False, True])
def test_filter_and_smoother_equal_plain_matrices(body):
    motion, frame = begun(3.0)
    used = inputs_of(motion, frame).used.copy()
    used[::7, ekf.VELOCITY_KIND] = 1
    velocity = attitude.rotate_inverse(motion.q, motion.v) if body else motion.v
    velocity = velocity + np.random.default_rng(7).normal(0, 0.05, velocity.shape)
    inputs = inputs_of(motion, frame, used=used, velocity=velocity, body=body)
    q, x, P, steps = Plain(inputs).run()
    forward = ekf.forward(inputs)
    np.testing.assert_allclose(forward.quaternion, q, atol=1e-9)
    np.testing.assert_allclose(forward.state, x, atol=1e-9)
    ours, size = ekf.unpack(forward.covariance), np.sqrt(np.einsum("kii->ki", P))
    assert np.max(np.abs(ours - P) / (size[:, :, None] * size[:, None, :])) < 1e-9
    qs, xs, Ps = plain_smoother(q, x, P, steps)
    smoothed = smooth(inputs, forward)
    np.testing.assert_allclose(smoothed.quaternion, qs, atol=1e-9)
    np.testing.assert_allclose(smoothed.state, xs, atol=2e-9)
    size = np.sqrt(np.einsum("kii->ki", Ps))
    apart = np.abs(ekf.unpack(smoothed.covariance) - Ps) / (size[:, :, None] * size[:, None, :])
    # at the very start the smoothed variance is a millionth of the prior's, and that many digits go
    assert apart[:100].max() < 1e-6 and apart[100:].max() < 1e-8


def test_prediction_jacobian_equals_finite_differences():
    rng = np.random.default_rng(2)
    q = attitude.normalise(rng.normal(size=4))
    x = rng.normal(size=15)
    gyro, accel, dt = rng.normal(0, 8, (2, 3)), rng.normal(0, 15, (2, 3)), 0.01

    def step(error):
        at = attitude.multiply(q, attitude.exponential(error[:3]))
        new = x + error[3:]
        blocks = np.empty((5, 3, 3))
        ekf.predict(at, new, gyro, accel, 0, dt, blocks, np.empty(ekf.WORK_SHAPE))
        return at, new, blocks

    q1, x1, blocks = step(np.zeros(18))
    size = 1e-5
    numeric = np.zeros((18, 18))
    for i in range(18):
        ends = []
        for sign in (1, -1):
            error = np.zeros(18)
            error[i] = sign * size
            at, new, _ = step(error)
            turn = attitude.logarithm(attitude.multiply(attitude.conjugate(q1), at))
            ends.append(np.concatenate([turn, new - x1]))
        numeric[:, i] = (ends[0] - ends[1]) / (2 * size)
    built = np.eye(18)
    built[0:3, 0:3], built[0:3, 9:12] = blocks[0], blocks[1]
    built[3:6, 0:3], built[3:6, 9:12], built[3:6, 12:15] = blocks[2], blocks[3], blocks[4]
    built[6:9] += dt / 2 * (built[3:6] + np.eye(18)[3:6])
    np.testing.assert_allclose(built, numeric, atol=2e-9)


def test_truth_is_recovered_through_loops(flown):
    motion, _, forward, smoothed = flown
    pitch = attitude.to_euler(motion.q)[:, 1]
    assert np.degrees(np.abs(pitch)).max() > 80
    up = attitude.rotate(motion.q, np.array([0.0, 0.0, 1.0]))[:, 2]
    assert up.min() < -0.9  # upside down
    for run, limit, late in ((forward, 0.1, slice(6000, None)), (smoothed, 0.05, slice(500, None))):
        turn = attitude.logarithm(attitude.multiply(attitude.conjugate(run.quaternion), motion.q))[late]
        assert np.degrees(np.sqrt(np.mean(turn**2))) < limit
        assert np.sqrt(np.mean((run.state[late, :3] - motion.v[late]) ** 2)) < 0.01
        assert np.sqrt(np.mean((run.state[late, 3:6] - motion.p[late]) ** 2)) < 0.001
    truth = np.array([0.02, -0.03, 0.01, 0.1, -0.15, 0.2, 0.004, -0.005, 0.003])
    error = (smoothed.state[-1, 6:] - truth) / ekf.deviations(smoothed.covariance)[-1, 9:]
    assert np.abs(error).max() < 3.5
    assert np.sqrt(np.mean(error**2)) < 1.6


def test_smoother_beats_filter(flown):
    motion, _, forward, smoothed = flown
    late = slice(500, -500)

    def rms(run):
        turn = attitude.logarithm(attitude.multiply(attitude.conjugate(run.quaternion), motion.q))[late]
        return np.sqrt(np.mean(turn**2)), np.sqrt(np.mean((run.state[late, :3] - motion.v[late]) ** 2))

    (a0, v0), (a1, v1) = rms(forward), rms(smoothed)
    assert a1 < 0.8 * a0 and v1 < 0.7 * v0


@pytest.mark.parametrize("which", ["filter", "smoother"])
def test_errors_agree_with_their_covariance(flown, which):
    motion, _, forward, smoothed = flown
    run = forward if which == "filter" else smoothed
    at = np.arange(1000, len(motion.t), 400)
    turn = attitude.logarithm(attitude.multiply(attitude.conjugate(run.quaternion), motion.q))[at]
    error = np.hstack([turn, motion.v[at] - run.state[at, :3], motion.p[at] - run.state[at, 3:6]])
    covariance = ekf.unpack(run.covariance[at])[:, :9, :9]
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(covariance), error)
    assert 0.75 < nees.mean() / 9 < 1.3  # 48 draws of 9 degrees of freedom: 1 +- 0.14 at 95 %, neighbours correlated


def test_covariance_is_positive_and_smoothing_never_enlarges_it(flown):
    _, _, forward, smoothed = flown
    scale = np.repeat([0.01, 0.01, 0.001, 1e-3, 1e-2, 1e-3], 3)
    for run in (forward, smoothed):
        P = ekf.unpack(run.covariance[::97]) / np.outer(scale, scale)
        assert np.linalg.eigvalsh(P).min() > 0
    before, after = ekf.deviations(forward.covariance), ekf.deviations(smoothed.covariance)
    assert np.all(after <= before * (1 + 1e-6))


def test_innovations_are_normal_and_white_when_the_levels_are_right(flown):
    forward = flown[2]
    for kind in (ekf.ATTITUDE_KIND, ekf.POSITION_KIND):
        white = forward.whitened[forward.outcome[:, kind] == 1, kind]
        assert np.mean(white**2) == pytest.approx(1.0, abs=0.06)
        assert abs(np.mean(white[1:] * white[:-1])) < 0.05


def test_outliers_are_rejected_and_counted(short):
    motion, frame = short
    clean = inputs_of(motion, frame, gate=25.0)
    spoiled = clean.position.copy()
    hit = np.flatnonzero(clean.used[:, ekf.POSITION_KIND])[100:700:60]
    spoiled[hit] += 0.3
    run = ekf.forward(clean._replace(position=spoiled))
    assert set(hit) <= set(np.flatnonzero(run.outcome[:, ekf.POSITION_KIND] == 2))
    before = ekf.forward(clean)
    assert np.abs(run.state[-1] - before.state[-1]).max() < 2e-3


def test_filter_gives_in_when_rejections_go_on(short):
    motion, frame = short
    inputs = inputs_of(motion, frame, gate=25.0, max_rejections=np.array([30, 30, 30]))
    shifted = inputs.position.copy()
    shifted[1500:] += 0.5
    run = ekf.forward(inputs._replace(position=shifted))
    assert (run.outcome[:, ekf.POSITION_KIND] == 3).any()
    assert np.abs(run.state[-1, 3:6] - shifted[-1]).max() < 0.02


def test_cost_is_least_at_the_true_noise(short):
    motion, frame = short
    inputs = inputs_of(motion, frame)
    right = ekf.cost(inputs)
    assert right == pytest.approx(ekf.forward(inputs).cost)
    for scale in (0.5, 2.0):
        assert ekf.cost(inputs._replace(std=inputs.std * scale)) > right
        assert ekf.cost(inputs._replace(noise=inputs.noise * scale)) > right


def test_noise_too_small_by_far_never_pays_by_rejecting_everything(short):
    motion, frame = short
    inputs = inputs_of(motion, frame, gate=25.0)
    costs = [ekf.cost(inputs._replace(std=inputs.std * s, noise=inputs.noise * s)) for s in (1.0, 0.1, 0.01, 0.001)]
    assert min(costs[1:]) > costs[0] + 1e4
