"""A made rigid-body motion with IMU and capture, for the tests of the filter; plain numpy, no synthesis."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from airframes import BEETLE

from quasi import attitude
from quasi.airframe import read_airframe

MASS = 0.43
INERTIA = np.diag([8.65e-4, 1.07e-3, 1.71e-3])
CONFIG = {**BEETLE, "moment of inertia": INERTIA.tolist(), "idle RPM": 200, "max RPM": 2100, "mass": MASS}


def quadrotor(**changes):
    """The airframe of the tests."""
    return read_airframe({**CONFIG, **changes}, "test quadrotor")


@dataclass
class Motion:
    """Truth on a uniform grid: earth NED, body FRD, SI."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    p: np.ndarray
    rates: np.ndarray
    rates_dot: np.ndarray
    force: np.ndarray  # specific force, body


def move(seconds=30.0, rate=500.0, rest=3.0, seed=0, loops=True, size=1.0):
    """Rest, then smooth accelerations and rates of all axes; with `loops` a full turn in pitch every 8 s."""
    rng = np.random.default_rng(seed)
    fine = 10
    t = np.arange(int(seconds * rate)) / rate
    dt = 1.0 / (rate * fine)
    tf = (np.arange(len(t) * fine) + 0.5) * dt

    def envelope(at):
        s = np.clip((at - rest) / 1.0, 0.0, 1.0)
        return s**3 * (10 - 15 * s + 6 * s * s), np.where((s > 0) & (s < 1), 30 * s * s * (1 - s) ** 2, 0.0)

    terms = [
        [(rng.uniform(0.3, 1.6) * size, rng.uniform(0.2, 2.0) * 2 * np.pi, rng.uniform(0, 6)) for _ in range(3)]
        for _ in range(3)
    ]

    def rates(at):
        e, de = envelope(at)
        w, dw = np.zeros((len(at), 3)), np.zeros((len(at), 3))
        for axis in range(3):
            for amplitude, f, phase in terms[axis]:
                s, c = np.sin(f * at + phase), np.cos(f * at + phase)
                w[:, axis] += e * amplitude * s
                dw[:, axis] += de * amplitude * s + e * amplitude * f * c
        if loops:
            start = rest + 5.0
            while start + 1.0 < seconds:
                s = np.clip(at - start, 0.0, 1.0)
                inside = (s > 0) & (s < 1)
                w[:, 1] += np.where(inside, 2 * np.pi * (1 - np.cos(2 * np.pi * s)), 0.0)
                dw[:, 1] += np.where(inside, 4 * np.pi**2 * np.sin(2 * np.pi * s), 0.0)
                start += 8.0
        return w, dw

    steps = attitude.exponential(rates(tf)[0] * dt).reshape(len(t), fine, 4)
    whole = steps[:, 0]
    for i in range(1, fine):
        whole = attitude.multiply(whole, steps[:, i])
    q = np.empty((len(t), 4))
    q[0] = attitude.from_euler(0.01, -0.02, 0.7)
    for k in range(1, len(t)):
        q[k] = attitude.multiply(q[k - 1], whole[k - 1])
    q = attitude.normalise(q)

    # velocity and position from the acceleration by Simpson's rule
    waves = [
        [(rng.uniform(0.5, 2.0) * size, rng.uniform(0.15, 0.6) * 2 * np.pi, rng.uniform(0, 6)) for _ in range(3)]
        for _ in range(3)
    ]

    def acceleration(at):
        a = np.zeros((len(at), 3))
        for axis in range(3):
            for amplitude, f, phase in waves[axis]:
                a[:, axis] += amplitude * np.sin(f * at + phase)
        return a * envelope(at)[0][:, None]

    h = 1.0 / rate
    a0, am, a1 = acceleration(t), acceleration(t + h / 2), acceleration(t + h)
    v = np.vstack([np.zeros(3), np.cumsum((a0 + 4 * am + a1) * h / 6, axis=0)[:-1]])
    p = np.vstack([np.zeros(3), np.cumsum(v * h + (a0 + 2 * am) * h * h / 6, axis=0)[:-1]])
    w, dw = rates(t)
    force = attitude.rotate_inverse(q, a0 - np.array([0.0, 0.0, attitude.GRAVITY]))
    return Motion(t, q, v, p, w, dw, force)


def measure(
    motion,
    seed=1,
    gyro_bias=(0.02, -0.03, 0.01),
    accel_bias=(0.1, -0.15, 0.2),
    gyro_noise=0.02,
    accel_noise=0.3,
    attitude_noise=0.0035,
    position_noise=0.001,
    every=4,
    alignment=(0.0, 0.0, 0.0),
    rest=3.0,
):
    """What the import stage would hand over: (DataFrame, metadata). Capture samples on every `every`-th row."""
    rng = np.random.default_rng(seed)
    n = len(motion.t)
    frame = {"t": motion.t}
    hover = 1150.0
    thrust = np.linalg.norm(motion.force, axis=1)
    flying = motion.t >= rest
    speed = np.where(flying, np.maximum(hover * np.sqrt(thrust / attitude.GRAVITY), 150.0), 150.0)
    for i in range(1, 5):
        frame[f"w{i}"] = speed * (1.0 + 0.002 * i) + rng.normal(0, 1.0, n)
    gyro = motion.rates + np.array(gyro_bias) + rng.normal(0, gyro_noise, (n, 3))
    accel = motion.force + np.array(accel_bias) + rng.normal(0, accel_noise, (n, 3))
    for axis in range(3):
        frame["a" + "xyz"[axis]] = accel[:, axis]
        frame["pqr"[axis]] = gyro[:, axis]
    measured = attitude.multiply(motion.q, attitude.exponential(np.array(alignment)))
    measured = attitude.multiply(measured, attitude.exponential(rng.normal(0, attitude_noise, (n, 3))))
    at = motion.t[::every]
    measured = attitude.interpolate(measured[::every], at, motion.t)
    frame["roll"], frame["pitch"], frame["yaw"] = attitude.to_euler(measured).T
    position = motion.p + rng.normal(0, position_noise, (n, 3))
    for axis in range(3):
        frame["xyz"[axis]] = np.interp(motion.t, at, position[::every, axis])
    body = attitude.rotate_inverse(motion.q, motion.v)
    frame["u"], frame["v"], frame["w"] = body.T
    fresh = np.zeros(n)
    fresh[::every] = 1.0
    frame["attitude_sample"], frame["position_sample"] = fresh, fresh.copy()
    frame["velocity_sample"], frame["onboard_valid"] = fresh.copy(), np.ones(n)
    metadata = {
        "schema": "quasi.imported/1",
        "flight": "made",
        "quadrotor": "test",
        "sampling": {"rate": 1.0 / (motion.t[1] - motion.t[0]), "samples": n},
        "attitude source": "capture",
        "position source": "capture",
        "velocity source": "capture position",
        "logged to rad/s": 100.0 * 2.0 * np.pi / 60.0 / 7.0,
        "notes": [],
        "verdict": "good",
    }
    return pd.DataFrame(frame), metadata
