"""A slung payload and dynamic inflow: parts of the vehicle with states of their own.

Their states follow the seventeen of the rigid body and rotors, the inflow first: 4 rotor speeds z_i to which the
present inflow belongs; then the payload's direction n from the cg and its rate (6), earth axes.

Inflow: the induced velocity of a rotor is proportional to its speed and follows it with a first-order lag. The thrust
differs by the missing inflow: dz/dt = (W - z)/tau, dT = gain W (W - z); for slow changes, gain W tau dW/dt.
Source: Pitt & Peters, Theoretical prediction of dynamic-inflow derivatives, Vertica 5, 1981.

Payload: a mass m_L on a light rod of length L, hinged at the cg without moment. With s = g - a, a the cg's
acceleration,
    L n'' = s - (s.n) n - L |n'|^2 n - (c/m_L) L n',  force on the cg  T n + c L n',  T = m_L (s.n + L |n'|^2)
where a includes that force. c = 2 zeta omega m m_L/(m + m_L), omega^2 = (g/L)(1 + m_L/m) small swings below a
hovering vehicle. The damping acts between payload and cg, so momentum is conserved. A rod also pushes, where a string
would go slack.
Source: Goodarzi, Lee & Lee, Geometric control of a quadrotor UAV transporting a payload, IJCAS 13(6), 2015.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from quasi.attitude import GRAVITY
from quasi.simulation.vehicle.layout import (
    ADDED_GRAVITY,
    EXTRA_STATES,
    HUB_POSITIONS,
    INFLOW_GAIN,
    INFLOW_LAG,
    LOAD_DAMPING,
    LOAD_LENGTH,
    LOAD_MASS,
    MASS,
    ROOT_EFFECTIVENESS,
    ROTOR_SPEEDS,
    SPEED_CAP,
    STATE_SIZE,
)
from quasi.terms.lanes import any_lane


class PayloadAndInflow(NamedTuple):
    """Constants of payload and inflow; zero mass or zero lag means that the part does not exist.

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
        """Number of their states."""
        return 4 * (self.inflow_lag > 0.0) + 6 * (self.load_mass > 0.0)


def write_payload_and_inflow(parts: PayloadAndInflow, hubs: np.ndarray, body: np.ndarray) -> None:
    """Write the constants of payload and inflow into the constants of a body. hubs (4, 3) m."""
    body[EXTRA_STATES] = parts.states
    body[INFLOW_LAG], body[INFLOW_GAIN] = parts.inflow_lag, parts.inflow_gain
    body[LOAD_MASS], body[LOAD_LENGTH], body[LOAD_DAMPING] = parts.load_mass, parts.load_length, parts.load_damping
    body[HUB_POSITIONS : HUB_POSITIONS + 8] = np.asarray(hubs, float)[:, :2].ravel()


@njit(cache=True, error_model="numpy")
def _compute_apparent_gravity(x, loads, body):
    """Gravity less the cg's acceleration under forces `loads` of the body, earth axes, m/s2: three numbers."""
    w, rx, ry, rz = x[0], x[1], x[2], x[3]
    ax, ay, az = loads[0] / body[MASS], loads[1] / body[MASS], loads[2] / body[MASS]
    tx, ty, tz = 2.0 * (ry * az - rz * ay), 2.0 * (rz * ax - rx * az), 2.0 * (rx * ay - ry * ax)
    return (
        -(ax + w * tx + ry * tz - rz * ty),
        -(ay + w * ty + rz * tx - rx * tz),
        GRAVITY - body[ADDED_GRAVITY] - (az + w * tz + rx * ty - ry * tx),
    )


@njit(cache=True, error_model="numpy")
def _compute_damping_rate(body):
    """c (1/m + 1/m_L), 1/s."""
    omega = math.sqrt(GRAVITY / body[LOAD_LENGTH] * (1.0 + body[LOAD_MASS] / body[MASS]))
    return 2.0 * body[LOAD_DAMPING] * omega


@njit(cache=True, error_model="numpy")
def add_payload_and_inflow_loads(x, body, inputs, out):
    """Add the loads of payload and inflow to forces and moments out (6,); the model's inputs hold the rotor speeds."""
    at = STATE_SIZE
    if any_lane(body[INFLOW_LAG] > 0.0):
        for i in range(4):
            speed = inputs[12 + i]
            more = body[INFLOW_GAIN] * speed * (speed - x[at + i])
            out[2] -= more
            out[3] -= body[HUB_POSITIONS + 2 * i + 1] * more
            out[4] += body[HUB_POSITIONS + 2 * i] * more
        at += 4
    if any_lane(body[LOAD_MASS] > 0.0):
        s = _compute_apparent_gravity(x, out, body)
        length, share = body[LOAD_LENGTH], body[LOAD_MASS] / (1.0 + body[LOAD_MASS] / body[MASS])
        pull = length * (x[at + 3] * x[at + 3] + x[at + 4] * x[at + 4] + x[at + 5] * x[at + 5])
        for k in range(3):
            pull += s[k] * x[at + k]
        braking = share * _compute_damping_rate(body) * length
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
def differentiate_payload_and_inflow(x, loads, step_inputs, body, derivatives, row):
    """Derivatives of the parts' states into slopes[row, 17:]; loads (6,) include their own."""
    at = STATE_SIZE
    if any_lane(body[INFLOW_LAG] > 0.0):
        for i in range(4):
            speed = min(x[ROTOR_SPEEDS + i], step_inputs[SPEED_CAP + i]) * step_inputs[ROOT_EFFECTIVENESS + i]
            derivatives[row, at + i] = (speed - x[at + i]) / body[INFLOW_LAG]
        at += 4
    if any_lane(body[LOAD_MASS] > 0.0):
        s = _compute_apparent_gravity(x, loads, body)
        length, along, turning = body[LOAD_LENGTH], 0.0, 0.0
        for k in range(3):
            along += s[k] * x[at + k]
            turning += x[at + 3 + k] * x[at + 3 + k]
        braking = _compute_damping_rate(body) / (1.0 + body[LOAD_MASS] / body[MASS])
        for k in range(3):
            derivatives[row, at + k] = x[at + 3 + k]
            across = (s[k] - along * x[at + k]) / length
            derivatives[row, at + 3 + k] = across - turning * x[at + k] - braking * x[at + 3 + k]


@njit(cache=True, error_model="numpy")
def project_constraints(x, body):
    """Project the payload onto its constraints: a direction of unit length, and a rate perpendicular to it."""
    if any_lane(body[LOAD_MASS] > 0.0):
        at = STATE_SIZE + 4 if any_lane(body[INFLOW_LAG] > 0.0) else STATE_SIZE
        size = math.sqrt(x[at] * x[at] + x[at + 1] * x[at + 1] + x[at + 2] * x[at + 2])
        along = 0.0
        for k in range(3):
            x[at + k] /= size
            along += x[at + k] * x[at + 3 + k]
        for k in range(3):
            x[at + 3 + k] -= along * x[at + k]


@njit(cache=True, error_model="numpy")
def trim_payload_and_inflow(x, inputs, bare, body):
    """Trim payload and inflow: the inflow of a steady change of speed, the payload at rest along the apparent vertical.

    inputs  of the model in this state, rotor speeds and accelerations among them; bare (6,) forces and moments without
    the parts
    """
    at = STATE_SIZE
    if body[INFLOW_LAG] > 0.0:
        for i in range(4):
            x[at + i] = inputs[12 + i] - body[INFLOW_LAG] * inputs[16 + i]
        at += 4
    if body[LOAD_MASS] > 0.0:
        s = _compute_apparent_gravity(x, bare, body)
        size = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
        for k in range(3):
            x[at + k] = s[k] / size if size > 1e-9 else 1.0 if k == 2 else 0.0
            x[at + 3 + k] = 0.0
