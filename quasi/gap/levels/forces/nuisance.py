"""Differences between healthy flights and between healthy sessions: columns with known spreads.

Sizes: real flights of one vehicle differ in mass and thrust by 1 %, in how IMU and markers are seated by a fraction of
a degree, in what is left of biases and of the rotor telemetry's age after import and filtering. The rotors' torque
differs by more than the thrust: it follows thrust and inflow, and healthy made flights show 1.5 to 2 %.

Another propeller scales all that its rotor gives, with its inflow. Columns of squared speeds alone would leave the part
of the inflow, which looks like a moved centre of gravity.

From session to session batteries are seated anew and propellers change. The spreads of the four patterns of thrust (all
rotors, left and right, front and rear, along the spin) are those of the hover trim. There the place of the weight and
propellers look alike; here the place is a column of its own, for a battery that is seated elsewhere moves the centre of
gravity against the IMU as well, and manoeuvres show it otherwise.
Columns are those of the causes `rotor_effectiveness`, `cg_offset` and, of torque, `rotor_speed_scale` as well: with
other forms, the data would take a rotor that is a fifth weaker for a session, or a session for a scale of all speeds.
"""

import numpy as np

from quasi.attitude import GRAVITY
from quasi.gap.causes.cg_offset import EFFECT as CG_OFFSET
from quasi.gap.causes.rotor_effectiveness import EFFECT as ROTOR
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.sessions import SEATED_TO, SESSION_PROPELLERS, SESSION_THRUST, SESSION_YAW
from quasi.model.columns import ROTORS
from quasi.model.model import AXES

MASS_SPREAD, THRUST_SPREAD, TORQUE_SPREAD = 0.01, 0.01, 0.015  # shares
SEATING_TURN, MARKER_TURN = 0.0035, 0.0052  # rad, about each axis
FORCE_BIAS, MOMENT_BIAS = 0.005, 0.0005  # of m g, and of m g times the arm: what filtering leaves of constant errors
TELEMETRY = 0.003  # s, where it is unknown
AGE = "age of the rotor telemetry"  # name of its column
SEATED = ("IMU turned", "markers turned")  # how names of columns begin that are a session's as well as a flight's


def nuisances(evidence: Evidence) -> list[tuple[str, np.ndarray, float]]:
    """(name, column (n, 6), standard deviation) of each way in which a flight may differ."""
    weight = evidence.mass * GRAVITY
    result = []
    for k, axis in enumerate(AXES):
        # as shares, so that flights of different masses have columns of one standard deviation
        size, spread = (weight, FORCE_BIAS) if k < 3 else (weight * evidence.airframe.arm * 10.0, MOMENT_BIAS)
        result.append((f"constant {axis}", evidence.only(axis, size), spread))
    result.append(("mass", evidence.forces_only(-evidence.force), MASS_SPREAD))
    rotors = ROTOR.columns(evidence, {})
    result.append(("thrust", sum(rotors[f"rotor{i}"] for i in range(1, 5)), THRUST_SPREAD))
    result.append(("torque", evidence.only("Mz", -(evidence.spin * evidence.torque).sum(axis=1)), TORQUE_SPREAD))
    by_velocity, by_rates = evidence.gradient("u", "v", "w"), evidence.gradient("p", "q", "r")
    for k, name in enumerate(("roll", "pitch", "yaw")):
        axis = np.eye(3)[k]
        turned = np.einsum("nij,nj->ni", by_velocity, np.cross(axis, evidence.velocity))
        result.append((f"markers turned in {name}", turned, MARKER_TURN))
        seated = turned + np.einsum("nij,nj->ni", by_rates, np.cross(axis, evidence.rates)) + _measured(evidence, axis)
        result.append((f"IMU turned in {name}", seated, SEATING_TURN))
    delay = np.einsum("nij,nj->ni", evidence.gradient(*ROTORS), evidence.spin_up)
    result.append((AGE, delay, TELEMETRY))
    return result


def session_nuisances(evidence: Evidence) -> list[tuple[str, np.ndarray, float]]:
    """(name, column (n, 6), standard deviation) of each way in which sessions differ: thrust by pattern of rotors, and
    the place of the weight; those of this vehicle where its reference flights show them."""
    hubs = np.asarray(evidence.airframe.hubs)
    arm = float(np.hypot(hubs[:, 0], hubs[:, 1]).mean())
    place, yaw = evidence.session_scales
    propellers = place * SESSION_PROPELLERS * arm
    patterns = {
        "all rotors": (np.ones(len(hubs)), place * SESSION_THRUST),
        "left and right": (np.sign(hubs[:, 1]), propellers / np.abs(hubs[:, 1]).mean()),
        "front and rear": (np.sign(hubs[:, 0]), propellers / np.abs(hubs[:, 0]).mean()),
        "along the spin": (np.asarray(evidence.spin, float), yaw * SESSION_YAW),
    }
    result, rotors = [], dict(ROTOR.columns(evidence, {}))
    yaw = (evidence.gradient(*ROTORS) * (0.5 * evidence.speeds)[:, None, :])[:, 5]
    rotors |= {f"yaw{i}": evidence.only("Mz", yaw[:, i - 1]) for i in range(1, 5)}
    for name, (sign, spread) in patterns.items():
        for kind, each in (("thrust", "rotor"), ("torque", "torque"), ("torque by the model", "yaw")):
            column = sum(s * rotors[f"{each}{i}"] for i, s in enumerate(sign, 1))
            result.append((f"session: {kind}, {name}", column, spread))
    for name, column in CG_OFFSET.columns(evidence, {}).items():
        result.append((f"session: centre of gravity, {name}", column, place * SEATED_TO))
    return result


def _measured(evidence: Evidence, axis: np.ndarray) -> np.ndarray:
    """Change of the measured wrench (n, 6) per rad that the IMU is turned about an axis: it shows v - axis x v."""
    rates = -np.cross(axis, evidence.rates)
    acceleration = -np.cross(axis, evidence.angular_acceleration)
    inertia = evidence.inertia
    moment = acceleration @ inertia.T
    moment += np.cross(rates, evidence.rates @ inertia.T) + np.cross(evidence.rates, rates @ inertia.T)
    return np.hstack([-np.cross(axis, evidence.force), moment])
