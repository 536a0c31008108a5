"""Made flights in closed loop with known drive: commands, voltage, and what the filter keeps of the motion."""

import math
from functools import cache

import numpy as np
import pandas as pd
from airframes import to_draw
from scipy.signal import lfilter

from quasi.attitude import GRAVITY

MASS, TAU, DELAY, EXPONENT, SLOPE = 0.5, 0.04, 0.012, 0.8, 0.7
DT = 0.002
WARMING = 8.0  # s
OPERATING, REFERENCE = 0.5, 15.0
GAINS = np.array([1.0, 0.97, 1.02, 1.01])


def flight(*about, **named):
    """A flight of its own, as `made` has it: each is made once."""
    return made(*about, **named).copy()


@cache
def made(
    seed=0,
    seconds=25.0,
    hidden=0.0,
    tau=TAU,
    delay=DELAY,
    exponent=EXPONENT,
    late=0.0,
    every=5,
    sag=1.5,
    cold=0.0,
    tau_yaw=None,
):
    """One flight, logged at 100 Hz: a rate loop and a vertical loop fly through gusts; speeds follow a linear map.

    hidden  std of torque disturbances, N m; late  s by which commands are logged late; sag  V lost over the flight
    tau_yaw  lag, s, of the speed that makes yaw torque, where it is not that of thrust
    cold  speed that cold motors have more than warm ones; the flight then begins cold, after 0.5 s at rest
    """
    rng, frame = np.random.default_rng(seed), to_draw()
    n = round(seconds / DT)
    t = np.arange(n) * DT
    inertia = np.diag(frame.inertia)
    hubs, spin = frame.hubs, frame.spin
    turn = 0.02  # m, torque over thrust
    mix = np.stack([np.ones(4), -hubs[:, 1], hubs[:, 0], -turn * spin])  # thrusts to force up and moments
    back = np.linalg.inv(mix)
    hover = MASS * GRAVITY / 4
    volts = 15.8 - sag * t / seconds
    goal = np.stack([_steps(rng, n, w) for w in (3.0, 3.0, 1.0)], axis=1)
    climb = _steps(rng, n, 2.0)
    gust = _coloured(rng, n, 0.15, 3) * hidden
    lift = _coloured(rng, n, 0.3, 1)[:, 0] * hidden * 8
    keep, keep_yaw = np.exp(-DT / tau), np.exp(-DT / (tau_yaw or tau))
    steps = round(delay / DT)
    # plain floats from here on, ten times as fast as arrays of three and four numbers
    ratios, gains, ways = ((volts / REFERENCE) ** exponent).tolist(), GAINS.tolist(), spin.tolist()
    inverse, mixed, (ix, iy, iz) = back.tolist(), mix.tolist(), inertia.tolist()
    keep, keep_yaw, hover = float(keep), float(keep_yaw), float(hover)
    p = q = r = w = 0.0
    relative, turning, heat = [1.0] * 4, [1.0] * 4, [0.0] * 4
    commands, out = [], []
    for k, ((gx, gy, gz), up, (tx, ty, tz), lifted) in enumerate(
        zip(goal.tolist(), climb.tolist(), gust.tolist(), lift.tolist())
    ):
        wanted = MASS * (GRAVITY + 4.0 * (up - w)), ix * 20.0 * (gx - p), iy * 20.0 * (gy - q), iz * 20.0 * (gz - r)
        ratio = ratios[k]
        asked = []
        for gain, row in zip(gains, inverse):
            thrust = max(sum(a * b for a, b in zip(row, wanted)), 0.02 * hover)
            speed = math.sqrt(thrust / hover) / gain / ratio
            asked.append(min(max(OPERATING * (1.0 + (speed - 1.0) / SLOPE), 0.0), 1.0))
        commands.append(asked)
        late_k = max(k - steps, 0)
        thrusts, torque = [], 0.0
        for i, c in enumerate(commands[late_k]):
            steady = gains[i] * ratios[late_k] * (1.0 + SLOPE * (c / OPERATING - 1.0)) * (1.0 + cold * (1.0 - heat[i]))
            heat[i] += DT / WARMING * (c / OPERATING - heat[i])
            relative[i] = steady + (relative[i] - steady) * keep
            turning[i] = steady + (turning[i] - steady) * keep_yaw
            thrusts.append(hover * relative[i] ** 2)
            torque -= turn * ways[i] * hover * turning[i] ** 2
        acting = [sum(a * b for a, b in zip(row, thrusts)) for row in mixed]
        mx, my, mz, up = acting[1] + tx, acting[2] + ty, torque + tz, acting[0] + lifted
        out.append((p, q, r, mx, my, mz, -up / MASS, w, up))
        hx, hy, hz = ix * p, iy * q, iz * r
        p, q, r = (
            p + DT * (mx - (q * hz - r * hy)) / ix,
            q + DT * (my - (r * hx - p * hz)) / iy,
            r + DT * (mz - (p * hy - q * hx)) / iz,
        )
        w += DT * (up / MASS - GRAVITY)
    commands, out = np.array(commands), np.array(out)
    rows = slice(0, n, every)
    shown = np.stack([np.interp(t - late, t, c) for c in commands.T], axis=1)
    table = {"t": t[rows], "battery_voltage": volts[rows], "u": 0 * t[rows], "v": 0 * t[rows], "w": -out[rows, 7]}
    table |= {f"{name}_raw": out[rows, i] for i, name in enumerate("pqr")}
    table |= {f"a{name}_raw": (out[rows, 6] if name == "z" else 0 * t[rows]) for name in "xyz"}
    table |= {f"command{i + 1}_raw": shown[rows, i] for i in range(4)}
    table |= {"az": out[rows, 6], "valid": 1.0 + 0 * t[rows], "in_flight": 1.0 + 0 * t[rows]}
    if not cold:
        return pd.DataFrame(table)
    rest = {name: np.zeros(50) for name in table} | {"battery_voltage": np.full(50, volts[0])}
    made = pd.concat([pd.DataFrame(rest), pd.DataFrame(table)], ignore_index=True)
    return made.assign(t=np.arange(len(made)) * DT * every)


def _steps(r, n, size):
    """Steps at random times, every 0.4 s on average."""
    held = np.repeat(r.normal(0, size, n // 100 + 1), 100)[:n]
    change = np.repeat(r.random(n // 100 + 1) < 0.5, 100)[:n]
    held[~change] = 0.0
    held[0] = 0.0
    keep = np.exp(-DT / 0.05)
    return lfilter([1 - keep], [1.0, -keep], held)


def _coloured(r, n, memory, columns):
    """First-order noise (n, columns) of unit std; memory s."""
    keep, noise = np.exp(-DT / memory), r.standard_normal((n, columns))
    noise[0] = 0.0
    return lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], noise, axis=0)
