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


def times(matrix, v):
    """Matrix times vector, as lists of floats: of three numbers, ten times as fast as arrays."""
    return [row[0] * v[0] + row[1] * v[1] + row[2] * v[2] for row in matrix]


def transposed(matrix):
    """The transpose."""
    return [list(column) for column in zip(*matrix)]


def turned(matrix, rates, dt):
    """A matrix turned by rates over dt, by Rodrigues' formula."""
    rate = math.sqrt(sum(w * w for w in rates))
    if rate <= 1e-9:
        return matrix
    (x, y, z), s, c = (w / rate for w in rates), math.sin(rate * dt), 1.0 - math.cos(rate * dt)
    columns = [
        [1 - c * (y * y + z * z), c * x * y + s * z, c * x * z - s * y],
        [c * x * y - s * z, 1 - c * (x * x + z * z), c * y * z + s * x],
        [c * x * z + s * y, c * y * z - s * x, 1 - c * (x * x + y * y)],
    ]
    return transposed([times(matrix, column) for column in columns])


def angles(turn):
    """Roll, pitch, yaw of a matrix, 3-2-1."""
    return math.atan2(turn[2][1], turn[2][2]), -math.asin(turn[2][0]), math.atan2(turn[1][0], turn[0][0])


def across(a, b):
    """Vector product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def ahead(a, dt, b):
    """a + dt b."""
    return [x + dt * y for x, y in zip(a, b)]


def flown(model, seed, share=1.0, drag=0.0, seconds=SECONDS):
    """A filtered flight: rotor 2 makes `share` of its thrust; `drag` N s2/m2 |V| V on top of the model's own."""
    rng = np.random.default_rng(seed)
    of = {a: {t["expression"]: t["coefficient"] for t in p["terms"]} for a, p in model.document["axes"].items()}
    frame = model.airframe
    mass, inertia, hubs = frame.mass, np.asarray(frame.inertia).tolist(), np.asarray(frame.hubs).tolist()
    spin, k, arm = np.asarray(frame.spin).tolist(), -of["Fz"]["w2_1 + w2_2 + w2_3 + w2_4"], 0.0544
    inverse, dt, n = np.linalg.inv(np.asarray(frame.inertia)).tolist(), 1.0 / RATE, int(seconds * RATE)
    # constant, this flight's
    own = (rng.standard_normal(6) * np.r_[np.full(3, 0.004), np.full(3, 3e-5)]).tolist()
    heavier = 1.0 + 0.005 * float(rng.standard_normal())
    gust = [0.0] * 6
    phase, tone = rng.uniform(0, 6.3, (2, 4, 3))
    t, j = np.arange(n)[:, None, None] * dt, np.arange(1, 5)[:, None]
    swings = np.sin(0.9 * j * t * (1 + 0.1 * tone) + phase).sum(axis=1).tolist()
    shape = math.sqrt(2 * dt / 0.5) * np.r_[np.full(3, 0.03), np.full(3, 3e-4)]
    pushes = (shape * rng.standard_normal((n, 6))).tolist()

    def slope(turn, v, w, speeds, gust):
        u = times(transposed(turn), v)
        thrust = [k * speed**2 for speed in speeds]
        thrust[1] *= share
        extra, drawn = ahead(own, 1.0, gust), drag * math.sqrt(sum(a * a for a in u))
        force = [of["Fx"]["u"] * u[0], of["Fy"]["v"] * u[1], of["Fz"]["w"] * u[2] - sum(thrust)]
        force = [f - drawn * a + e for f, a, e in zip(force, u, extra)]
        moment = [
            of["Mx"]["p"] * w[0] + of["Mx"]["v"] * u[1] - sum(h[1] * f for h, f in zip(hubs, thrust)) + extra[3],
            of["My"]["q"] * w[1] + of["My"]["u"] * u[0] + sum(h[0] * f for h, f in zip(hubs, thrust)) + extra[4],
            of["Mz"]["r"] * w[2] - 0.012 * k * sum(s * o**2 for s, o in zip(spin, speeds)) + extra[5],
        ]
        along = [f / (mass * heavier) for f in times(turn, force)]
        about = ahead(moment, -1.0, across(w, times(inertia, w)))
        return [along[0], along[1], along[2] + G], times(inverse, about), force, moment

    turn, v, w, x = np.eye(3).tolist(), [0.0] * 3, [0.0] * 3, [0.0, 0.0, -1.0]
    speeds, rows = [1500.0] * 4, []
    for i, swing in enumerate(swings):
        roll, pitch, _ = angles(turn)
        back = times(transposed(turn), [-0.25 * a - 0.35 * b for a, b in zip((x[0], x[1], x[2] + 1.0), v)])
        back = [min(max(b, -0.5), 0.5) for b in back]
        aim = 0.12 * swing[0] + 0.3 * back[1], 0.12 * swing[1] - 0.3 * back[0]
        command = 60 * (aim[0] - roll) - 15 * w[0], 60 * (aim[1] - pitch) - 15 * w[1], 8 * (0.3 * swing[2] - w[2])
        need = times(inertia, command)
        lift = mass * (G + 1.5 * swing[2] * 0.6 - 4 * back[2]) / max(turn[2][2], 0.5)
        new = []
        for (hx, hy, _), way, speed in zip(hubs, spin, speeds):
            turning = math.copysign(need[1] / arm, hx * need[1]) - math.copysign(need[0] / arm, hy * need[0])
            square = (lift + turning - way * need[2] / 0.012) / (4 * k)
            new.append(speed + (math.sqrt(min(max(square, 4e5), 6e6)) - speed) * dt / 0.03)
        a, b, force, moment = slope(turn, v, w, speeds, gust)
        rows.append([i * dt, *angles(turn), *times(transposed(turn), v), *w, *x, *speeds,
                     *((after - before) / dt for after, before in zip(new, speeds)),
                     *(f / heavier for f in force), *moment])  # fmt: skip
        c, d, *_ = slope(turned(turn, w, dt), ahead(v, dt, a), ahead(w, dt, b), new, gust)
        turn = turned(turn, ahead(w, 0.25 * dt, ahead(b, 1.0, d)), dt)
        x = ahead(ahead(x, dt, v), 0.25 * dt**2, ahead(a, 1.0, c))
        v, w, speeds = ahead(v, 0.5 * dt, ahead(a, 1.0, c)), ahead(w, 0.5 * dt, ahead(b, 1.0, d)), new
        gust = [g - g * dt / 0.5 + push for g, push in zip(gust, pushes[i])]
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
