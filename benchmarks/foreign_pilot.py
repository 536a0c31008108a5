"""Courses of a lab's flights: hover, circles, lemniscates, steps, heave, yaw and sprints, ordered by a seed; and a
cascade that follows them, for simulators without a controller."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

RATE = 250  # Hz
REST, RISE = 3.0, 2.5  # s
HEIGHT = 1.2  # m


class Course(NamedTuple):
    """Wanted position (n, 3) m, velocity, acceleration, yaw (n,) rad and its rate, world z up; armed (n,)."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    yaw: np.ndarray
    yaw_rate: np.ndarray
    armed: np.ndarray


def blend(t: np.ndarray, length: float) -> np.ndarray:
    """From 0 to 1 in `length` s, with two continuous derivatives."""
    s = np.clip(t / length, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def there_and_back(t: np.ndarray, length: float, ramp: float) -> np.ndarray:
    """0, then 1, then 0 again at `length`."""
    return blend(t, ramp) - blend(t - length + ramp, ramp)


def manoeuvre(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smooth path (n, 3), jumps of the wanted position (n, 3) and yaw (n,)."""
    length = {"hover": 2.5, "circle": 6.0, "lemniscate": 6.0, "heave": 5.0, "sprint x": 5.0, "sprint y": 5.0}.get(
        kind, 4.0
    )
    t = np.arange(0.0, length, 1 / RATE)
    path, jump, yaw = np.zeros((len(t), 3)), np.zeros((len(t), 3)), np.zeros(len(t))
    window, sign = there_and_back(t, length, 1.2), rng.choice([-1.0, 1.0])
    if kind == "circle":
        radius, angle = rng.uniform(0.7, 1.1), sign * rng.uniform(2.0, 2.6) * t
        path[:, 0], path[:, 1] = radius * window * np.cos(angle), radius * window * np.sin(angle)
    elif kind == "lemniscate":
        size, angle = rng.uniform(1.2, 1.6), rng.uniform(1.5, 1.9) * t
        path[:, 0], path[:, 1] = size * window * np.sin(angle), sign * size / 2 * window * np.sin(2 * angle)
    elif kind == "heave":
        rate = np.linspace(0.4, rng.uniform(0.9, 1.1), len(t))
        path[:, 2] = 0.22 * window * np.sin(2 * np.pi * np.cumsum(rate) / RATE)
    elif kind.startswith("sprint"):
        path[:, "xy".index(kind[-1])] = sign * rng.uniform(2.2, 2.8) * there_and_back(t, length, 1.7)
    elif kind == "yaw":
        yaw = sign * rng.uniform(0.5, 0.8) * window * np.sin(2 * np.pi * rng.uniform(0.35, 0.5) * t)
        yaw += sign * rng.uniform(0.3, 0.4) * there_and_back(t - 1.0, 2.0, 0.5)
    elif kind.startswith("steps"):
        size = {"x": 0.5, "y": 0.5, "z": 0.25}[kind[-1]]
        jump[:, "xyz".index(kind[-1])] = (
            sign * size * np.where((t > 0.5) & (t < 1.6), 1.0, np.where((t > 1.6) & (t < 2.7), -0.7, 0.0))
        )
    return path, jump, yaw


KINDS = ("hover", "circle", "lemniscate", "steps x", "steps y", "steps z", "heave", "yaw", "sprint x", "sprint y")


def course(seed: int) -> Course:
    """Rest, rise, eight or nine manoeuvres of the ten, landing and rest: about 45 s at 250 Hz."""
    rng = np.random.default_rng(seed)
    kinds = [k for k in rng.permutation(KINDS) if k not in rng.choice(["hover", "heave", "circle", "lemniscate"], 1)]
    parts = [manoeuvre(k, rng) for k in kinds]
    path, jump, yaw = (np.concatenate([p[i] for p in parts]) for i in range(3))
    up = np.arange(0.0, RISE, 1 / RATE)
    rest, land, end = int(REST * RATE), len(up), int(1.2 * RATE)
    zeros = np.zeros((rest + land, 3))
    path = np.concatenate([zeros, path, np.zeros((land + end, 3))])
    jump = np.concatenate([zeros, jump, np.zeros((land + end, 3))])
    yaw = np.concatenate([zeros[:, 0], yaw, np.zeros(land + end)])
    yaw = yaw + rng.uniform(-3.0, 3.0) * blend(np.arange(len(yaw)) / RATE - REST - RISE, len(yaw) / RATE - 10.0)
    lift = np.concatenate([np.zeros(rest), blend(up, RISE), np.ones(len(path) - rest - 2 * land - end)])
    path[:, 2] += HEIGHT * np.concatenate([lift, 1 - blend(up, RISE), np.full(end, -0.02)])
    velocity = np.gradient(path, 1 / RATE, axis=0)
    armed = np.ones(len(path), bool)
    armed[:rest] = armed[-end // 2 :] = False
    return Course(
        path + jump, velocity, np.gradient(velocity, 1 / RATE, axis=0), yaw, np.gradient(yaw, 1 / RATE), armed
    )


class Cascade:
    """Position, velocity, attitude and rate loops; it knows the nominal vehicle.

    mass kg; inertia (3,) kg m2; hubs (4, 3) m, x forward, y left; torques (4,) N m about z up per N of thrust
    thrust  least and most of a rotor, N; stiffness (3,) 1/s, angular acceleration for an error of the rates;
    wound  rad, the most that this error's integral holds
    """

    def __init__(
        self, mass: float, inertia: Sequence[float], hubs: np.ndarray, torques: np.ndarray,
        thrust: tuple[float, float], stiffness: tuple[float, float, float] = (25.0, 25.0, 12.0),
        wound: float = 0.5,
    ) -> None:  # fmt: skip
        """Integrators at zero; the mixer from the nominal geometry."""
        self.mass, self.inertia, self.limits = mass, np.array(inertia), thrust
        self.drift, self.turned, self.stiffness, self.wound = np.zeros(3), np.zeros(3), stiffness, wound
        self.mixer = np.linalg.inv(np.array([np.ones(4), hubs[:, 1], -hubs[:, 0], torques]))

    def thrusts(self, course: Course, k: int, state: np.ndarray, h: float) -> np.ndarray:
        """Of each rotor, N; state: position, quaternion w x y z, velocity (world), rates (body)."""
        turn = Rotation.from_quat(state[3:7], scalar_first=True)
        error = np.clip(course.position[k] - state[:3], -0.8, 0.8)
        speed = course.velocity[k] + 2.5 * error - state[7:10]
        self.drift = np.clip(self.drift + 1.0 * h * speed, -2.0, 2.0)
        wanted = course.acceleration[k] + 4.0 * speed + self.drift + [0.0, 0.0, 9.81]
        wanted[2] = max(wanted[2], 3.0)
        up = wanted / np.linalg.norm(wanted)
        left = np.cross(up, [np.cos(course.yaw[k]), np.sin(course.yaw[k]), 0.0])
        left /= np.linalg.norm(left)
        goal = Rotation.from_matrix(np.column_stack([np.cross(left, up), left, up]))
        rates = np.array([9.0, 9.0, 4.0]) * (turn.inv() * goal).as_rotvec()
        rates[2] += course.yaw_rate[k]
        off = np.clip(rates, -8.0, 8.0) - state[10:13]
        self.turned = np.clip(self.turned + h * off, -self.wound, self.wound)
        moment = self.inertia * (self.stiffness * off + 15.0 * self.turned)
        lift = self.mass * max(float(wanted @ turn.apply([0.0, 0.0, 1.0])), 2.0)
        turning, (least, most) = self.mixer @ [0.0, *moment], self.limits
        level = self.mixer @ [1.0, 0.0, 0.0, 0.0]
        # a vehicle that has to turn gives up lift for it
        lift = max(min(lift, ((most - turning) / level).min()), ((least - turning) / level).max())
        return np.clip(lift * level + turning, least, most)
