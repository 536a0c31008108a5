"""Made flights in closed loop with known drive: commands, voltage, and what the filter keeps of the motion."""

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
    r, frame = np.random.default_rng(seed), to_draw()
    n = round(seconds / DT)
    t = np.arange(n) * DT
    inertia = np.diag(frame.inertia)
    hubs, spin = frame.hubs, frame.spin
    turn = 0.02  # m, torque over thrust
    mix = np.stack([np.ones(4), -hubs[:, 1], hubs[:, 0], -turn * spin])  # thrusts to force up and moments
    back = np.linalg.inv(mix)
    hover = MASS * GRAVITY / 4
    volts = 15.8 - sag * t / seconds
    goal = np.stack([_steps(r, n, w) for w in (3.0, 3.0, 1.0)], axis=1)
    climb = _steps(r, n, 2.0)
    gust = _coloured(r, n, 0.15, 3) * hidden
    lift = _coloured(r, n, 0.3, 1)[:, 0] * hidden * 8
    rates, w = np.zeros(3), 0.0
    relative, heat, turning = np.ones(4), np.zeros(4), np.ones(4)
    keep_yaw = np.exp(-DT / (tau_yaw or tau))
    commands = np.full((n, 4), OPERATING)
    out = np.zeros((n, 9))
    steps = round(delay / DT)
    keep = np.exp(-DT / tau)
    for k in range(n):
        wanted = inertia * 20.0 * (goal[k] - rates)
        force = MASS * (GRAVITY + 4.0 * (climb[k] - w))
        thrust = np.maximum(back @ np.concatenate([[force], wanted]), 0.02 * hover)
        ratio = (volts[k] / REFERENCE) ** exponent
        speed = np.sqrt(thrust / hover) / GAINS / ratio
        commands[k] = np.clip(OPERATING * (1.0 + (speed - 1.0) / SLOPE), 0.0, 1.0)
        late_k = max(k - steps, 0)
        steady = GAINS * (volts[late_k] / REFERENCE) ** exponent * (1.0 + SLOPE * (commands[late_k] / OPERATING - 1.0))
        steady = steady * (1.0 + cold * (1.0 - heat))
        heat = heat + DT / WARMING * (commands[late_k] / OPERATING - heat)
        relative = steady + (relative - steady) * keep
        lifted = hover * relative**2
        acting = mix @ lifted
        turning = steady + (turning - steady) * keep_yaw
        acting[3] = -turn * spin @ (hover * turning**2)
        moments = acting[1:] + gust[k]
        up = acting[0] + lift[k]
        out[k] = [*rates, *moments, -up / MASS, w, up]
        rates = rates + DT * (moments - cross(rates, inertia * rates)) / inertia
        w = w + DT * (up / MASS - GRAVITY)
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


def cross(a, b):
    """Of two vectors (3,): NumPy's own takes five times as long."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


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
