"""Flights of a plain simulation written apart, with nuisance, gusts and noise.

The vehicle: attitude as a matrix turned by Rodrigues' formula, velocity in earth axes, steps of Heun; thrust and drag
rotor by rotor. It is held near hover by a plain controller and shaken by known references.
"""

import math

import numpy as np
import pandas as pd
from plain_plant import made_model

from quasi.model.model import Model

G, RATE, SECONDS = 9.81, 200.0, 20.0


def simple_model():
    """A model whose thrust and torque are those of the plain flights."""
    made = made_model(reaction=0.0)
    thrust = -next(t["coefficient"] for t in made.document["axes"]["Fz"]["terms"] if "w2_1" in t["expression"])
    simple = {"kappaFz": {"value": thrust, "std": 0.0}, "kappaMz": {"value": -0.012 * thrust, "std": 0.0}}
    return Model({**made.document, "simple model": simple}, "made")


def turned(axis, angle):
    """Rodrigues' formula."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


def angles(turn):
    """Roll, pitch, yaw of a matrix, 3-2-1."""
    return math.atan2(turn[2, 1], turn[2, 2]), -math.asin(turn[2, 0]), math.atan2(turn[1, 0], turn[0, 0])


def across(a, b):
    """Vector product."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def flown(model, seed, share=1.0, drag=0.0, seconds=SECONDS):
    """A filtered flight: rotor 2 makes `share` of its thrust; `drag` N s2/m2 |V| V on top of the model's own."""
    rng = np.random.default_rng(seed)
    of = {a: {t["expression"]: t["coefficient"] for t in p["terms"]} for a, p in model.document["axes"].items()}
    frame = model.airframe
    mass, inertia, hubs = frame.mass, np.asarray(frame.inertia), np.asarray(frame.hubs)
    spin, k, arm = np.asarray(frame.spin), -of["Fz"]["w2_1 + w2_2 + w2_3 + w2_4"], 0.0544
    inverse, dt, n = np.linalg.inv(inertia), 1.0 / RATE, int(seconds * RATE)
    own = rng.standard_normal(6) * np.r_[np.full(3, 0.004), np.full(3, 3e-5)]  # constant, this flight's
    heavier = 1.0 + 0.005 * rng.standard_normal()
    gust, shape = np.zeros(6), np.r_[np.full(3, 0.03), np.full(3, 3e-4)]
    phase, tone = rng.uniform(0, 6.3, (2, 4, 3))

    def wrench(turn, v, w, speeds, gust):
        u = turn.T @ v
        thrust = k * speeds**2
        thrust[1] *= share
        force = np.array([of["Fx"]["u"] * u[0], of["Fy"]["v"] * u[1], of["Fz"]["w"] * u[2] - thrust.sum()])
        moment = np.array([
            of["Mx"]["p"] * w[0] + of["Mx"]["v"] * u[1] - hubs[:, 1] @ thrust,
            of["My"]["q"] * w[1] + of["My"]["u"] * u[0] + hubs[:, 0] @ thrust,
            of["Mz"]["r"] * w[2] - 0.012 * k * (spin @ speeds**2),
        ])  # fmt: skip
        force = force - drag * np.linalg.norm(u) * u
        extra = own + gust
        return force + extra[:3], moment + extra[3:]

    def slope(turn, v, w, speeds, gust):
        force, moment = wrench(turn, v, w, speeds, gust)
        return turn @ force / (mass * heavier) + [0, 0, G], inverse @ (moment - across(w, inertia @ w)), force, moment

    turn, v, w, x = np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -1.0])
    speeds, rows = np.full(4, 1500.0), []
    for i in range(n):
        t = i * dt
        swing = np.array([np.sin(0.9 * (j + 1) * t * (1 + 0.1 * tone[j]) + phase[j]) for j in range(4)]).sum(axis=0)
        wanted = np.array([0.12, 0.12, 0.3]) * swing
        roll, pitch, _ = angles(turn)
        back = np.clip(turn.T @ (0.25 * (-x - np.array([0, 0, 1.0])) - 0.35 * v), -0.5, 0.5)
        aim = np.array([wanted[0] + 0.3 * back[1], wanted[1] - 0.3 * back[0]])
        command = np.array([60 * (aim[0] - roll), 60 * (aim[1] - pitch), 8 * (wanted[2] - w[2])]) - [15, 15, 0] * w
        need = inertia @ command
        lift = mass * (G + 1.5 * swing[2] * 0.6 - 4 * back[2]) / max(turn[2, 2], 0.5)
        squares = lift / (4 * k) + (
            -np.sign(hubs[:, 1]) * need[0] / arm + np.sign(hubs[:, 0]) * need[1] / arm - spin * need[2] / 0.012
        ) / (4 * k)
        new = speeds + (np.sqrt(np.clip(squares, 4e5, 6e6)) - speeds) * dt / 0.03
        a, b, force, moment = slope(turn, v, w, speeds, gust)
        rows.append([t, *angles(turn), *(turn.T @ v), *w, *x, *speeds, *((new - speeds) / dt),
                     *(mass / (mass * heavier) * force), *moment])  # fmt: skip
        rate = np.linalg.norm(w)
        after = turn @ turned(w / rate, rate * dt) if rate > 1e-9 else turn
        c, d, *_ = slope(after, v + dt * a, w + dt * b, new, gust)
        middle = w + 0.25 * dt * (b + d)
        rate = np.linalg.norm(middle)
        turn = turn @ turned(middle / rate, rate * dt) if rate > 1e-9 else turn
        x = x + dt * v + 0.25 * dt**2 * (a + c)
        v, w, speeds = v + 0.5 * dt * (a + c), w + 0.5 * dt * (b + d), new
        gust = gust - gust * dt / 0.5 + shape * math.sqrt(2 * dt / 0.5) * rng.standard_normal(6)
    names = ["t", "roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z"]
    names += [f"w{i}" for i in range(1, 5)] + [f"w{i}_dot" for i in range(1, 5)] + ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
    table = pd.DataFrame(rows, columns=names).assign(valid=1.0)
    noise = {
        "roll": 1e-3,
        "pitch": 1e-3,
        "yaw": 1e-3,
        "u": 0.005,
        "v": 0.005,
        "w": 0.005,
        "p": 0.01,
        "q": 0.01,
        "r": 0.01,
    }
    for name, size in noise.items():
        table[name] += size * rng.standard_normal(n)
    return table
