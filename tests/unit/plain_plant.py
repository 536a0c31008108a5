"""A plain closed loop for the tests of the controllers: rigid body by rotation matrix, rotor lag, any compiled model.

Written apart from the simulator: attitude as a matrix that is turned by Rodrigues' formula, velocity in earth axes.
"""

import math

import numpy as np
from numba import njit

from quasi.attitude import from_euler
from quasi.model.model import Model
from quasi.simulation.control.controllers import controller_step, make_controller
from quasi.terms.kernel import compute_wrench

G = 9.81
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
KINDS = ("PID", "NDI", "INDI")
# columns of what fly() returns
POSITION, RATES, TARGETS, UPRIGHT, YAW = slice(0, 3), slice(6, 9), slice(13, 17), 17, 18


def made_model(hover=1500.0, asymmetric=False, lag=0.03, reaction=6e-7, damping=5e-4, gravity="withGravity"):
    """A six-axis quadrotor model of a dozen terms, with drag, damping and the moment of rotor accelerations."""
    mass = 0.43
    hubs = [[-0.0544, 0.0544, 0], [0.0544, 0.0544, 0], [-0.0544, -0.0544, 0], [0.0544, -0.0544, 0]]
    thrust = mass * G / (4 * hover**2)
    bias = float(asymmetric)
    terms = {
        "Fx": {"1": 0.0, "u": -0.12},
        "Fy": {"1": 0.0, "v": -0.12},
        "Fz": {"1": 0.0, "w": -0.15, "w2_1 + w2_2 + w2_3 + w2_4": -thrust},
        "Mx": {"1": 1.5e-3 * bias, "p": -8e-4, "U_p": 0.0544 * thrust, "v": -2e-3},
        "My": {"1": -1e-3 * bias, "q": -8e-4, "U_q": 0.0544 * thrust, "u": 2e-3},
        "Mz": {"1": 3e-4 * bias, "r": -damping, "U_r": -0.012 * thrust, "u_r_dot": -reaction},
    }
    if gravity == "noGravity":
        # net force: the weight in body axes, in the model's own variables
        terms["Fx"]["sin[pitch]"] = -mass * G
        terms["Fy"]["sin[roll]*cos[pitch]"] = mass * G
        terms["Fz"]["cos[roll]*cos[pitch]"] = mass * G
    document = {
        "schema": "quasi.model/1",
        "id": "made",
        "gravity": gravity,
        "airframe": {
            "name": "made", "mass": mass, "inertia": [[8.65e-4, 2e-5, 0], [2e-5, 1.07e-3, 0], [0, 0, 1.71e-3]],
            "rotor radius": 0.0381, "b": 0.077, "hubs": hubs, "spin": [1, -1, -1, 1], "motor poles": 14,
            "idle RPM": 200.0, "max RPM": 1800.0, "marker offset": [0, 0, 0], "noise": {},
            "rotor config": {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3},
            "rotor1 clockwise": True,
        },
        "hover speed": {"value": hover},
        "actuators": {"time constants": {"value": [lag] * 4, "unit": "s"}},
        "axes": {
            axis: {
                "unit": "N", "R2": 1.0, "RMSE": 0.0, "n": 100, "sigma2": 0.0, "effective rows": 100,
                "confidence level": 0.95, "covariance": np.zeros((len(of), len(of))).tolist(),
                "terms": [
                    {"name": e, "expression": e, "coefficient": c, "std": 0.0, "unit": ""} for e, c in of.items()
                ],
            }
            for axis, of in terms.items()
        },
    }  # fmt: skip
    return Model(document)


def with_simple_model(model, torque):
    """The model with a simple one of thrust alone; torque  m, of a rotor for its thrust."""
    thrust = model.airframe.mass * G / (4 * model.hover_speed**2)
    simple = {"kappaFz": {"value": thrust}, "kappaMz": {"value": -torque * thrust}}
    return Model({**model.document, "simple model": simple})


@njit(cache=True)
def _wrench_of(kernel, rot, velocity, rates, position, speeds, slopes, inputs, work, out):
    inputs[0] = math.atan2(rot[2, 1], rot[2, 2])
    inputs[1] = -math.asin(min(max(rot[2, 0], -1.0), 1.0))
    inputs[2] = math.atan2(rot[1, 0], rot[0, 0])
    for k in range(3):
        inputs[3 + k] = rot[0, k] * velocity[0] + rot[1, k] * velocity[1] + rot[2, k] * velocity[2]
        inputs[6 + k] = rates[k]
        inputs[9 + k] = position[k]
    for i in range(4):
        inputs[12 + i], inputs[16 + i] = speeds[i], slopes[i]
    compute_wrench(kernel, inputs, work, out)


@njit(cache=True)
def _root(square, sign):
    return math.copysign(0.5 * math.sqrt(max(1.0 + square, 0.0)), sign)


@njit(cache=True)
def _loop(
    kind, p, memory, goals, dt, fine, kernel, constants, inertia, inverse, offset, rot, state, share, cap, fault, noise,
    log
):  # fmt: skip
    """noise (N, 6) of velocity and rates; products are written out, for those of NumPy take seconds to compile.

    constants: mass, gravity to add, lag, lowest, highest; state (13,): x (3), v earth (3), rates (3), rotors (4).
    """
    mass, gravity, lag, lowest, highest = constants
    inputs, work, out = np.zeros(64), np.zeros(len(kernel.code) + len(kernel.numbers)), np.zeros(6)
    seen, command, slopes, acting = np.zeros(26), np.zeros(4), np.zeros(4), np.zeros(4)
    turn, turned, target = np.zeros((3, 3)), np.zeros((3, 3)), state[9:13].copy()
    momentum, about = np.zeros(3), np.zeros(3)
    h = dt / fine
    for step in range(len(goals)):
        position, velocity, rates, rotors = state[0:3], state[3:6], state[6:9], state[9:13]
        for part in range(fine):
            faulty = step * dt >= fault
            for i in range(4):
                slopes[i] = (target[i] - rotors[i]) / lag
                acting[i] = min(rotors[i], cap[i]) * math.sqrt(share[i]) if faulty else rotors[i]
                if faulty and rotors[i] > cap[i]:
                    slopes[i] = 0.0
            _wrench_of(kernel, rot, velocity, rates, position, acting, slopes, inputs, work, out)
            for k in range(6):
                out[k] -= offset[k]
            if part == 0:
                for i in range(9):
                    log[step, i] = state[i]
                for i in range(4):
                    log[step, 9 + i] = min(rotors[i], cap[i]) if faulty else rotors[i]
                    log[step, 13 + i] = target[i]
                log[step, 17] = rot[2, 2]
                log[step, 18] = math.atan2(rot[1, 0], rot[0, 0])
                # quaternion by its four squares; any sign of w will do
                w = _root(rot[0, 0] + rot[1, 1] + rot[2, 2], 1.0)
                x = _root(rot[0, 0] - rot[1, 1] - rot[2, 2], rot[2, 1] - rot[1, 2])
                y = _root(rot[1, 1] - rot[0, 0] - rot[2, 2], rot[0, 2] - rot[2, 0])
                z = _root(rot[2, 2] - rot[0, 0] - rot[1, 1], rot[1, 0] - rot[0, 1])
                seen[0], seen[1], seen[2], seen[3] = w, x, y, z
                for k in range(3):
                    seen[4 + k] = rot[0, k] * velocity[0] + rot[1, k] * velocity[1] + rot[2, k] * velocity[2]
                    seen[4 + k] += noise[step, k]
                    seen[7 + k] = rates[k] + noise[step, 3 + k]
                    seen[10 + k] = position[k]
                    seen[17 + k] = out[k] / mass
                    if gravity == 0.0:
                        seen[17 + k] -= G * rot[2, k]
                for i in range(4):
                    seen[13 + i] = log[step, 9 + i]
                controller_step(kind, p, memory, dt, seen, goals[step], command)
                for i in range(4):
                    target[i] = min(max(command[i], lowest), highest)
            for k in range(3):
                momentum[k] = inertia[k, 0] * rates[0] + inertia[k, 1] * rates[1] + inertia[k, 2] * rates[2]
            for k in range(3):
                i, j = (k + 1) % 3, (k + 2) % 3
                about[k] = out[3 + k] - (rates[i] * momentum[j] - rates[j] * momentum[i])
            for k in range(3):
                force = rot[k, 0] * out[0] + rot[k, 1] * out[1] + rot[k, 2] * out[2]
                velocity[k] += h * (force / mass + (gravity if k == 2 else 0.0))
                rates[k] += h * (inverse[k, 0] * about[0] + inverse[k, 1] * about[1] + inverse[k, 2] * about[2])
                position[k] += h * velocity[k]
            angle = math.sqrt(rates[0] ** 2 + rates[1] ** 2 + rates[2] ** 2) * h
            s, c = (math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2) if angle > 1e-12 else (1.0, 0.5)
            a, b, d = rates[0] * h, rates[1] * h, rates[2] * h
            turn[0, 0], turn[0, 1], turn[0, 2] = 1 - c * (b * b + d * d), c * a * b - s * d, c * a * d + s * b
            turn[1, 0], turn[1, 1], turn[1, 2] = c * a * b + s * d, 1 - c * (a * a + d * d), c * b * d - s * a
            turn[2, 0], turn[2, 1], turn[2, 2] = c * a * d - s * b, c * b * d + s * a, 1 - c * (a * a + b * b)
            for i in range(3):
                for j in range(3):
                    turned[i, j] = rot[i, 0] * turn[0, j] + rot[i, 1] * turn[1, j] + rot[i, 2] * turn[2, j]
            for i in range(3):
                for j in range(3):
                    rot[i, j] = turned[i, j]
            for i in range(4):
                rotors[i] = target[i] + (rotors[i] - target[i]) * math.exp(-h / lag)


def fly(
    settings,
    model,
    goals,
    dt=0.004,
    fine=8,
    start=None,
    angles=(0.0, 0.0, 0.0),
    share=(1, 1, 1, 1),
    cap=(np.inf,) * 4,
    fault=np.inf,
    noise=0.0,
    offset=None,
    speeds=1500.0,
    belief=None,
):
    """Closed loop over goals (N, 20); returns (N, 19): x y z, v earth, p q r, rotors (4), targets (4), cos tilt, yaw.

    belief  the model that the controller is made from, when it is not the one that flies.
    """
    offset = np.zeros(6) if offset is None else np.asarray(offset, float)
    inertia = np.ascontiguousarray(model.airframe.inertia, float)
    kind, p, size = make_controller(settings, belief or model, offset=offset)
    lag = model.document["actuators"]["time constants"]["value"][0]
    factor = model.airframe.logged_to_rad_s
    limits = model.airframe.idle_rpm * factor, model.airframe.max_rpm * factor
    constants = np.array([model.airframe.mass, G if model.with_gravity else 0.0, lag, *limits])
    q = from_euler(*angles)
    w, v = q[0], q[1:]
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    rot = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    state = np.zeros(13) if start is None else np.array(start, float)
    state[9:13] = speeds
    log = np.zeros((len(goals), 19))
    # the reference's sensors: 0.01 m/s and sqrt(8.73e-5) rad/s
    white = noise * np.random.default_rng(1).normal(0.0, [0.01] * 3 + [0.0093] * 3, (len(goals), 6))
    _loop(
        kind, p, np.zeros(size), np.asarray(goals, float), dt, fine, model.kernel, constants, inertia,
        np.linalg.inv(inertia), offset, rot, state, np.array(share, float), np.array(cap, float), fault, white, log,
    )  # fmt: skip
    return log


def still(n, place=(0.0, 0.0, 0.0), yaw=0.0):
    """Goals (n, 20) that hold a position and heading."""
    goals = np.zeros((n, 20))
    goals[:, 1:4] = place
    goals[:, 9] = yaw
    goals[:, 13] = np.nan
    return goals


def rate_goals(n, **rates):
    """Goals (n, 20) of body rates, from the first step on."""
    goals = still(n)
    goals[:, 0] = 3.0
    for name, value in rates.items():
        goals[:, 10 + "pqr".index(name)] = value
    return goals
