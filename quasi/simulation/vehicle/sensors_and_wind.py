"""Random numbers, sensors and wind of the simulator, compiled.

Random numbers come from generators whose whole state is one unsigned integer: a seed and a place in a row of draws, so
that every simulation of a batch has its own row, whichever thread it runs in, and the compiled loop and the Python loop
draw the same ones. Generator: splitmix64 (Steele, Lea & Flood, Fast splittable pseudorandom number generators, OOPSLA
2014); normal numbers by the polar method (Marsaglia & Bray, A convenient method for generating normal variables, SIAM
Review 6, 1964).
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.simulation.vehicle.layout import STATES

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
SENSOR_ROW, GUST_ROW = 0, 1  # rows of draws: switching the noise off leaves the gusts as they were
SEEN = 26  # entries of what a controller sees: the state, specific force (17:20), reserved


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
# linear between rows, held beyond the ends.
STEADY, GUST, TIME = 0, 3, 6


@njit(cache=True, error_model="numpy")
def seeded(seed, row):
    """State of a generator for this seed and row of draws."""
    state = np.uint64(seed) * _GOLDEN + np.uint64(row)
    state = (state ^ (state >> np.uint64(30))) * _FIRST
    return state ^ (state >> np.uint64(27))


@njit(cache=True, error_model="numpy")
def uniform(random, row):
    """The next number in [0, 1) of a row of draws; random (2,) uint64 holds the generators' states."""
    random[row] += _GOLDEN
    z = random[row]
    z = (z ^ (z >> np.uint64(30))) * _FIRST
    z = (z ^ (z >> np.uint64(27))) * _SECOND
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(cache=True, error_model="numpy")
def normals(random, row, out, n):
    """Fill out[:n] with standard normal numbers."""
    for i in range(0, n, 2):
        s = 2.0
        a = b = 0.0
        while s >= 1.0 or s == 0.0:
            a = 2.0 * uniform(random, row) - 1.0
            b = 2.0 * uniform(random, row) - 1.0
            s = a * a + b * b
        factor = math.sqrt(-2.0 * math.log(s) / s)
        out[i] = a * factor
        if i + 1 < n:
            out[i + 1] = b * factor


@njit(cache=True, error_model="numpy")
def sense(x, fx, fy, fz, sensors, speeds, random, draws, seen):
    """What the sensors read, into seen (26,): the state with noise, the specific force with noise, zeros.

    x (17,); fx fy fz specific force, m/s2; speeds (4,) rotor speeds that act; draws (19,) room for random numbers
    """
    for i in range(STATES - 4):
        seen[i] = x[i]
    for i in range(4):
        seen[13 + i] = speeds[i]
    seen[17], seen[18], seen[19] = fx, fy, fz
    if (
        sensors.attitude + sensors.velocity + sensors.rates + sensors.position + sensors.rotors + sensors.acceleration
        == 0
    ):
        return
    normals(random, SENSOR_ROW, draws, 19)
    # a small rotation about the body axes, second order in its angle, then scaled to unit length
    half = 0.5 * sensors.attitude
    a, b, c = half * draws[0], half * draws[1], half * draws[2]
    w, rx, ry, rz = x[0], x[1], x[2], x[3]
    seen[0] = w - rx * a - ry * b - rz * c
    seen[1] = rx + w * a + ry * c - rz * b
    seen[2] = ry + w * b + rz * a - rx * c
    seen[3] = rz + w * c + rx * b - ry * a
    norm = math.sqrt(seen[0] ** 2 + seen[1] ** 2 + seen[2] ** 2 + seen[3] ** 2)
    for i in range(4):
        seen[i] /= norm
    for i in range(3):
        seen[4 + i] += sensors.velocity * draws[3 + i]
        seen[7 + i] += sensors.rates * draws[6 + i]
        seen[10 + i] += sensors.position * draws[9 + i]
        seen[17 + i] += sensors.acceleration * draws[12 + i]
    for i in range(4):
        seen[13 + i] += sensors.rotors * draws[15 + i]


@njit(cache=True, error_model="numpy")
def from_table(table, t, out):
    """Linear interpolation of table (T, 1 + n) at time t, held beyond the ends, into out (n,)."""
    last = len(table) - 1
    if t <= table[0, 0] or last == 0:
        for k in range(len(out)):
            out[k] = table[0, 1 + k]
        return
    if t >= table[last, 0]:
        for k in range(len(out)):
            out[k] = table[last, 1 + k]
        return
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle, 0] <= t:
            low = middle
        else:
            high = middle
    share = (t - table[low, 0]) / (table[high, 0] - table[low, 0])
    for k in range(len(out)):
        out[k] = (1.0 - share) * table[low, 1 + k] + share * table[high, 1 + k]


@njit(cache=True, error_model="numpy")
def blow(wind, table, t, gust, out):
    """Velocity of the air at time t into out (3,), m/s; gust (3,) m/s is the present gust."""
    if len(table):
        from_table(table, t, out)
    else:
        out[0] = out[1] = out[2] = 0.0
    for k in range(3):
        out[k] += wind[STEADY + k] + gust[k]


@njit(cache=True, error_model="numpy")
def first_gust(wind, random, draws, gust):
    """A gust drawn from the stationary distribution, into gust (3,)."""
    if wind[GUST] + wind[GUST + 1] + wind[GUST + 2] > 0.0:
        normals(random, GUST_ROW, draws, 3)
        for k in range(3):
            gust[k] = wind[GUST + k] * draws[k]


@njit(cache=True, error_model="numpy")
def next_gust(wind, dt, random, draws, gust):
    """Carry gust (3,) on by dt, exactly for a first-order Gauss-Markov process."""
    if wind[GUST] + wind[GUST + 1] + wind[GUST + 2] > 0.0:
        normals(random, GUST_ROW, draws, 3)
        for k in range(3):
            keep = math.exp(-dt / wind[TIME + k])
            gust[k] = keep * gust[k] + wind[GUST + k] * math.sqrt(1.0 - keep * keep) * draws[k]
