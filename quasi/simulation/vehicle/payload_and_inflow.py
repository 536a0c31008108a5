"""Parts of a vehicle with states of their own: air through the discs that follows late, and a load that hangs below.

They stand behind the seventeen states, the air first: 4 rotor speeds z_i that the flow through the discs belongs to;
then the load's direction n from the cg and its rate (6), earth axes.

Late air: the induced velocity of a rotor is in proportion to its speed and follows with a first-order lag, so that
thrust is off by what is missing of it: dz/dt = (W - z)/tau, dT = gain W (W - z); slowly, gain W tau dW/dt.
Source: Pitt & Peters, Theoretical prediction of dynamic-inflow derivatives, Vertica 5, 1981.

Load: a mass m_L on a light rod of length L, hinged at the cg without moment. With s = g - a, a the cg's acceleration,
    L n'' = s - (s.n) n - L |n'|^2 n - (c/m_L) L n',  force on the cg  T n + c L n',  T = m_L (s.n + L |n'|^2)
where a holds that force. c = 2 zeta omega m m_L/(m + m_L), omega^2 = (g/L)(1 + m_L/m) the small swings below a hovering
vehicle; it brakes load and cg against each other, so that momentum is kept. A rod pushes, too: a string would go slack.
Source: Goodarzi, Lee & Lee, Geometric control of a quadrotor UAV transporting a payload, IJCAS 13(6), 2015.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi.simulation.vehicle.layout import (
    CAP,
    GRAVITY_ADDED,
    HUBS,
    INFLOW_GAIN,
    INFLOW_LAG,
    LOAD_DAMPING,
    LOAD_LENGTH,
    LOAD_MASS,
    MASS,
    OWN,
    ROTORS,
    SHARE,
    STATES,
)


class Parts(NamedTuple):
    """Constants of the parts; zero mass and zero lag for none.

    inflow_lag s; inflow_gain N s2: thrust of one rotor per speed x missing speed; load_mass kg; load_length m;
    load_damping  ratio of small swings
    """

    inflow_lag: float = 0.0
    inflow_gain: float = 0.0
    load_mass: float = 0.0
    load_length: float = 1.0
    load_damping: float = 0.0

    @property
    def states(self) -> int:
        """How many states they have."""
        return 4 * (self.inflow_lag > 0.0) + 6 * (self.load_mass > 0.0)


def put(parts: Parts, hubs: np.ndarray, body: np.ndarray) -> None:
    """Write the constants of the parts into those of a body. hubs (4, 3) m."""
    body[OWN] = parts.states
    body[INFLOW_LAG], body[INFLOW_GAIN] = parts.inflow_lag, parts.inflow_gain
    body[LOAD_MASS], body[LOAD_LENGTH], body[LOAD_DAMPING] = parts.load_mass, parts.load_length, parts.load_damping
    body[HUBS : HUBS + 8] = np.asarray(hubs, float)[:, :2].ravel()


@njit(cache=True, error_model="numpy")
def _apparent(x, loads, body, s):
    """Gravity less the cg's acceleration under forces `loads` of the body, earth axes, into s (3,), m/s2."""
    w, rx, ry, rz = x[0], x[1], x[2], x[3]
    ax, ay, az = loads[0] / body[MASS], loads[1] / body[MASS], loads[2] / body[MASS]
    tx, ty, tz = 2.0 * (ry * az - rz * ay), 2.0 * (rz * ax - rx * az), 2.0 * (rx * ay - ry * ax)
    s[0] = -(ax + w * tx + ry * tz - rz * ty)
    s[1] = -(ay + w * ty + rz * tx - rx * tz)
    s[2] = GRAVITY - body[GRAVITY_ADDED] - (az + w * tz + rx * ty - ry * tx)


@njit(cache=True, error_model="numpy")
def _braking(body):
    """c (1/m + 1/m_L), 1/s."""
    omega = math.sqrt(GRAVITY / body[LOAD_LENGTH] * (1.0 + body[LOAD_MASS] / body[MASS]))
    return 2.0 * body[LOAD_DAMPING] * omega


@njit(cache=True, error_model="numpy")
def own_loads(x, body, inputs, out):
    """Add what the parts do to the forces and moments out (6,) of the rest; inputs of the model hold rotor speeds."""
    at = STATES
    if body[INFLOW_LAG] > 0.0:
        for i in range(4):
            speed = inputs[12 + i]
            more = body[INFLOW_GAIN] * speed * (speed - x[at + i])
            out[2] -= more
            out[3] -= body[HUBS + 2 * i + 1] * more
            out[4] += body[HUBS + 2 * i] * more
        at += 4
    if body[LOAD_MASS] > 0.0:
        s = np.empty(3)
        _apparent(x, out, body, s)
        length, share = body[LOAD_LENGTH], body[LOAD_MASS] / (1.0 + body[LOAD_MASS] / body[MASS])
        pull = length * (x[at + 3] * x[at + 3] + x[at + 4] * x[at + 4] + x[at + 5] * x[at + 5])
        for k in range(3):
            pull += s[k] * x[at + k]
        braking = share * _braking(body) * length
        ax = share * pull * x[at] + braking * x[at + 3]
        ay = share * pull * x[at + 1] + braking * x[at + 4]
        az = share * pull * x[at + 2] + braking * x[at + 5]
        # into body axes by the conjugate quaternion
        w, rx, ry, rz = x[0], x[1], x[2], x[3]
        tx, ty, tz = 2.0 * (rz * ay - ry * az), 2.0 * (rx * az - rz * ax), 2.0 * (ry * ax - rx * ay)
        out[0] += ax + w * tx + rz * ty - ry * tz
        out[1] += ay + w * ty + rx * tz - rz * tx
        out[2] += az + w * tz + ry * tx - rx * ty


@njit(cache=True, error_model="numpy")
def own_slopes(x, loads, held, body, slopes, row):
    """Derivatives of the parts' states into slopes[row, 17:]; loads (6,) hold what the parts do."""
    at = STATES
    if body[INFLOW_LAG] > 0.0:
        for i in range(4):
            speed = min(x[ROTORS + i], held[CAP + i]) * held[SHARE + i]
            slopes[row, at + i] = (speed - x[at + i]) / body[INFLOW_LAG]
        at += 4
    if body[LOAD_MASS] > 0.0:
        s = np.empty(3)
        _apparent(x, loads, body, s)
        length, along, turning = body[LOAD_LENGTH], 0.0, 0.0
        for k in range(3):
            along += s[k] * x[at + k]
            turning += x[at + 3 + k] * x[at + 3 + k]
        braking = _braking(body) / (1.0 + body[LOAD_MASS] / body[MASS])
        for k in range(3):
            slopes[row, at + k] = x[at + 3 + k]
            across = (s[k] - along * x[at + k]) / length
            slopes[row, at + 3 + k] = across - turning * x[at + k] - braking * x[at + 3 + k]


@njit(cache=True, error_model="numpy")
def straighten(x, body):
    """Bring the load back to its sphere: a direction of unit length, its rate across it."""
    if body[LOAD_MASS] > 0.0:
        at = STATES + 4 if body[INFLOW_LAG] > 0.0 else STATES
        size = math.sqrt(x[at] * x[at] + x[at + 1] * x[at + 1] + x[at + 2] * x[at + 2])
        along = 0.0
        for k in range(3):
            x[at + k] /= size
            along += x[at + k] * x[at + 3 + k]
        for k in range(3):
            x[at + 3 + k] -= along * x[at + k]


@njit(cache=True, error_model="numpy")
def settle(x, inputs, bare, body):
    """Put the parts to rest: the air behind a steady change of speed, the load still along the apparent vertical.

    inputs  of the model in this state, rotor speeds and accelerations among them; bare (6,) forces and moments without
    the parts
    """
    at = STATES
    if body[INFLOW_LAG] > 0.0:
        for i in range(4):
            x[at + i] = inputs[12 + i] - body[INFLOW_LAG] * inputs[16 + i]
        at += 4
    if body[LOAD_MASS] > 0.0:
        s = np.empty(3)
        _apparent(x, bare, body, s)
        size = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
        for k in range(3):
            x[at + k] = s[k] / size if size > 1e-9 else 1.0 if k == 2 else 0.0
            x[at + 3 + k] = 0.0
