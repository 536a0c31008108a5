"""Sensor noise, wind and random numbers of the simulator, compiled.

The whole state of a random generator is one unsigned integer, made of a seed and a stream number. Every simulation of a
batch has its own streams, whichever thread it runs in. The compiled loop and the Python loop draw the same numbers.
Generator: splitmix64 (Steele, Lea & Flood, Fast splittable pseudorandom number generators, OOPSLA
2014); normal numbers by the polar method (Marsaglia & Bray, A convenient method for generating normal variables, SIAM
Review 6, 1964).
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.simulation.vehicle.layout import STATE_SIZE
from quasi.terms.lanes import LANES, any_lane, set_entry

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST_MULTIPLIER = np.uint64(0xBF58476D1CE4E5B9)
_SECOND_MULTIPLIER = np.uint64(0x94D049BB133111EB)
SENSOR_ROW, GUST_ROW = 0, 1  # streams of random numbers: without noise the gusts stay the same
MEASUREMENT_SIZE = 26  # entries of a measurement: the state, specific force (17:20), reserved


class Sensors(NamedTuple):
    """Standard deviations of white measurement noise.

    attitude rad, a small rotation about each body axis; velocity m/s; rates rad/s; position m; rotors rad/s;
    acceleration m/s2, of the specific force
    """

    attitude: float
    velocity: float
    rates: float
    position: float
    rotors: float
    acceleration: float


# A wind (9,): steady (3,) m/s; standard deviations of gusts (3,) m/s; their correlation times (3,) s, each a
# first-order Gauss-Markov process. Earth axes. A table (T, 4) of time s and three velocities, or (0, 4), adds to it:
# linear between rows, constant beyond the ends.
STEADY_WIND, GUST_DEVIATION, GUST_TIME = 0, 3, 6


@njit(cache=True, error_model="numpy")
def seed_generator(seed, row):
    """State of the generator for this seed and stream."""
    state = np.uint64(seed) * _GOLDEN + np.uint64(row)
    state = (state ^ (state >> np.uint64(30))) * _FIRST_MULTIPLIER
    return state ^ (state >> np.uint64(27))


@njit(cache=True, error_model="numpy")
def draw_uniform(state):
    """Advance a generator's state (uint64); return it and a number in [0, 1)."""
    state += _GOLDEN
    z = state
    z = (z ^ (z >> np.uint64(30))) * _FIRST_MULTIPLIER
    z = (z ^ (z >> np.uint64(27))) * _SECOND_MULTIPLIER
    z = z ^ (z >> np.uint64(31))
    return state, np.float64(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(cache=True, error_model="numpy")
def _draw_point(state):
    """Draw a point in the unit circle; return the generator's state, both coordinates and the squared radius."""
    s = 2.0
    a = b = 0.0
    while s >= 1.0 or s == 0.0:
        state, first = draw_uniform(state)
        state, second = draw_uniform(state)
        a, b = 2.0 * first - 1.0, 2.0 * second - 1.0
        s = a * a + b * b
    return state, a, b, s


@njit(cache=True, error_model="numpy")
def _polar_factor(s):
    """Factor that makes two normal numbers of a point with squared radius s."""
    return math.sqrt(-2.0 * math.log(s) / s)


@njit(cache=True, error_model="numpy")
def draw_normals(random, row, out, n):
    """Fill out[:n] with standard normal numbers; random (2,) uint64 holds the states of two generators.

    For eight drones: random (2, 8), out a view; the squared radii of the points follow the n + 1 first rows.
    """
    if random.ndim == 1:
        state = random[row]
        for i in range(0, n, 2):
            state, a, b, s = _draw_point(state)
            factor = _polar_factor(s)
            out[i] = a * factor
            if i + 1 < n:
                out[i + 1] = b * factor
        random[row] = state
    else:
        for lane in range(LANES):
            state = random[row, lane]
            for i in range(0, n, 2):
                state, a, b, s = _draw_point(state)
                set_entry(out, i, lane, a)
                set_entry(out, i + 1, lane, b)
                set_entry(out, n + 1 + i // 2, lane, s)
            random[row, lane] = state
        for i in range(0, n, 2):
            factor = _polar_factor(out[n + 1 + i // 2])
            out[i] *= factor
            out[i + 1] *= factor


@njit(cache=True, error_model="numpy")
def add_sensor_noise(x, fx, fy, fz, sensors, speeds, random, random_numbers, measurement):
    """Write sensor readings into seen (26,): the state with noise, the specific force with noise, zeros.

    x (17,); fx fy fz specific force, m/s2; speeds (4,) acting rotor speeds; draws (19,) work array
    """
    for i in range(STATE_SIZE - 4):
        measurement[i] = x[i]
    for i in range(4):
        measurement[13 + i] = speeds[i]
    measurement[17], measurement[18], measurement[19] = fx, fy, fz
    if (
        sensors.attitude + sensors.velocity + sensors.rates + sensors.position + sensors.rotors + sensors.acceleration
        == 0
    ):
        return
    draw_normals(random, SENSOR_ROW, random_numbers, 19)
    # a small rotation about the body axes, second order in its angle, then scaled to unit length
    half = 0.5 * sensors.attitude
    a, b, c = half * random_numbers[0], half * random_numbers[1], half * random_numbers[2]
    w, rx, ry, rz = x[0], x[1], x[2], x[3]
    measurement[0] = w - rx * a - ry * b - rz * c
    measurement[1] = rx + w * a + ry * c - rz * b
    measurement[2] = ry + w * b + rz * a - rx * c
    measurement[3] = rz + w * c + rx * b - ry * a
    w, rx, ry, rz = measurement[0], measurement[1], measurement[2], measurement[3]
    norm = math.sqrt(w * w + rx * rx + ry * ry + rz * rz)
    for i in range(4):
        measurement[i] /= norm
    for i in range(3):
        measurement[4 + i] += sensors.velocity * random_numbers[3 + i]
        measurement[7 + i] += sensors.rates * random_numbers[6 + i]
        measurement[10 + i] += sensors.position * random_numbers[9 + i]
        measurement[17 + i] += sensors.acceleration * random_numbers[12 + i]
    for i in range(4):
        measurement[13 + i] += sensors.rotors * random_numbers[15 + i]


@njit(cache=True, error_model="numpy")
def find_row(table, t):
    """The last row at or before t; the first where t lies before all."""
    return max(np.searchsorted(table[:, 0], t, side="right") - 1, 0)


@njit(cache=True, error_model="numpy")
def interpolate_table(table, t, out):
    """Interpolate table (T, 1 + n) linearly at time t, constant beyond the ends, into out (n,)."""
    last = len(table) - 1
    if t <= table[0, 0] or last == 0:
        for k in range(len(out)):
            out[k] = table[0, 1 + k]
        return
    if t >= table[last, 0]:
        for k in range(len(out)):
            out[k] = table[last, 1 + k]
        return
    row = find_row(table, t)
    share = (t - table[row, 0]) / (table[row + 1, 0] - table[row, 0])
    for k in range(len(out)):
        out[k] = (1.0 - share) * table[row, 1 + k] + share * table[row + 1, 1 + k]


@njit(cache=True, error_model="numpy")
def wind_velocity(wind, table, t, gust, out):
    """Velocity of the air at time t into out (3,), m/s; gust (3,) m/s is the present gust."""
    if len(table):
        interpolate_table(table, t, out)
    else:
        out[0] = out[1] = out[2] = 0.0
    for k in range(3):
        out[k] += wind[STEADY_WIND + k] + gust[k]


@njit(cache=True, error_model="numpy")
def draw_first_gust(wind, random, random_numbers, gust):
    """Draw a gust from the stationary distribution into gust (3,)."""
    if any_lane(wind[GUST_DEVIATION] + wind[GUST_DEVIATION + 1] + wind[GUST_DEVIATION + 2] > 0.0):
        draw_normals(random, GUST_ROW, random_numbers, 3)
        for k in range(3):
            gust[k] = wind[GUST_DEVIATION + k] * random_numbers[k]


@njit(cache=True, error_model="numpy")
def advance_gust(wind, dt, random, random_numbers, gust):
    """Advance gust (3,) by dt, exactly for a first-order Gauss-Markov process."""
    if any_lane(wind[GUST_DEVIATION] + wind[GUST_DEVIATION + 1] + wind[GUST_DEVIATION + 2] > 0.0):
        draw_normals(random, GUST_ROW, random_numbers, 3)
        for k in range(3):
            keep = math.exp(-dt / wind[GUST_TIME + k])
            gust[k] = keep * gust[k] + wind[GUST_DEVIATION + k] * math.sqrt(1.0 - keep * keep) * random_numbers[k]
