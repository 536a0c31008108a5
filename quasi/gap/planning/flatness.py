"""What a planned trajectory asks of the vehicle: attitude, rates and rotor speeds, by the model turned round.

Position and heading over time fix everything else of a quadrotor: the force that the trajectory needs gives the
attitude, its change the rates and the moments, and force and moments the rotor speeds. The model's own side forces
(drag) are counted, so that the vehicle leans as far as it has to. Source: Mellinger & Kumar, Minimum snap trajectory
generation and control for quadrotors, ICRA 2011, section III.
"""

import math
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.interpolate import make_interp_spline

from quasi import attitude
from quasi.attitude import GRAVITY
from quasi.errors import ConfigError, DataError, nearest
from quasi.gap.flights.evidence import RATE
from quasi.model.columns import ROTORS
from quasi.model.extensions import read_speed_limits
from quasi.model.hover import list_usual_inputs
from quasi.model.model import AXES, Model

MOST_TIME = 1800.0  # s of a trajectory: more than a battery gives, and more columns than memory holds
LEANS = 6  # rounds of attitude and side force
SOLVES = 12  # Newton steps for the rotor speeds
CONVERGED = 1e-6  # of the weight, or of weight times arm: good enough
DOWN = np.array([0.0, 0.0, 1.0])
DEGREE = 5  # of the splines through planned points: the fourth derivative of position sets the moments


class Motion(NamedTuple):
    """A rigid motion, all arrays over time: t (n,), s; earth NED position, velocity and acceleration (n, 3), SI;
    quaternion (n, 4) body to earth."""

    t: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    quaternion: np.ndarray


def read_plan(table: pd.DataFrame, where: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """t (n,), position (n, 3) and yaw (n,) of a planned trajectory: columns t, x, y, z and, if it turns, yaw.

    Seconds, metres in earth NED (z down), rad. Raises DataError naming column and row of what cannot be flown.
    """
    for name in ("t", "x", "y", "z"):
        if name not in table:
            raise DataError(
                f"{where} has no column '{name}'{nearest(name, list(table))}; a planned trajectory holds t (s), "
                "x, y, z (m, z down) and yaw (rad)"
            )
    names = ["t", "x", "y", "z", *(["yaw"] if "yaw" in table else [])]
    for name in names:
        if not pd.api.types.is_numeric_dtype(table[name]):
            raise DataError(f"{where}: column '{name}' holds text, expected numbers; correct it")
        bad = np.flatnonzero(~np.isfinite(table[name].to_numpy(float)))
        if len(bad):
            raise DataError(f"{where}: column '{name}' holds no number in row {bad[0] + 1}; fill it in")
    t = table["t"].to_numpy(float)
    if len(t) <= DEGREE:
        raise DataError(f"{where} has {len(t)} rows, expected more than {DEGREE}; give more points of the trajectory")
    back = np.flatnonzero(np.diff(t) <= 0.0)
    if len(back):
        raise DataError(
            f"{where}: time goes from {t[back[0]]:g} to {t[back[0] + 1]:g} s in row {back[0] + 2}; times must grow"
        )
    if t[-1] - t[0] > MOST_TIME:
        raise DataError(
            f"{where}: the trajectory lasts {t[-1] - t[0]:.0f} s, expected {MOST_TIME:.0f} s at most; times are in s, "
            "and a part of a long flight holds as much information"
        )
    yaw = np.unwrap(table["yaw"].to_numpy(float)) if "yaw" in table else np.zeros(len(t))
    return t, table[["x", "y", "z"]].to_numpy(float), yaw


def planned(t: np.ndarray, position: np.ndarray, yaw: np.ndarray, model: Model, where: str) -> pd.DataFrame:
    """The flight that follows a trajectory: the columns of a filtered flight at RATE, forces as the model has them.

    t (n,), s; position (n, 3), m, earth NED; yaw (n,), rad: points that a smooth curve goes through.
    Raises DataError where the vehicle cannot follow, saying when and where.
    """
    at = np.arange(t[0], t[-1] + 1e-9, 1.0 / RATE)
    curve = make_interp_spline(t, np.column_stack([position, yaw]), k=DEGREE)
    values, slopes, bends = (curve.derivative(k)(at) if k else curve(at) for k in range(3))
    place, velocity, acceleration, heading = values[:, :3], slopes[:, :3], bends[:, :3], values[:, 3]
    quaternion = _leaning(acceleration, velocity, place, heading, model, where, at)
    return flown(Motion(at, place, velocity, acceleration, quaternion), model, where)


def turning(t: np.ndarray, angles: np.ndarray, start: np.ndarray, model: Model, where: str) -> pd.DataFrame:
    """The flight with a prescribed attitude that keeps its height: for sharp turns that no path would ask for.

    t (n,) uniform, s; angles (n, 3) roll, pitch, yaw, rad; start (3,) place where it begins at rest, earth NED, m
    """
    quaternion = attitude.from_euler(*angles.T)
    up = -attitude.rotate(quaternion, DOWN)
    if np.min(-up[:, 2]) < 0.2:
        raise DataError(f"{where}: the vehicle lies on its side, where no thrust keeps its height; turn less")
    acceleration = GRAVITY * (up / -up[:, 2:3] + DOWN)
    step = float(t[1] - t[0])
    velocity = _integral(acceleration, step)
    return flown(
        Motion(t, start + _integral(velocity, step), velocity, acceleration, attitude.continuous(quaternion)),
        model,
        where,
    )


def _integral(values: np.ndarray, step: float) -> np.ndarray:
    return np.vstack([np.zeros(values.shape[1]), np.cumsum(0.5 * step * (values[1:] + values[:-1]), axis=0)])


def _leaning(
    acceleration: np.ndarray,
    velocity: np.ndarray,
    place: np.ndarray,
    heading: np.ndarray,
    model: Model,
    where: str,
    t: np.ndarray,
) -> np.ndarray:
    """Attitude (n, 4) in which thrust along body z and the model's side forces make the acceleration."""
    mass = mass_of(model)
    asked = mass * (acceleration - GRAVITY * DOWN)
    side = np.zeros_like(asked)
    speeds = np.full((len(asked), 4), hover_speed_of(model))
    quaternion = np.empty((len(asked), 4))
    for _ in range(LEANS):
        thrust = asked - side
        size = np.linalg.norm(thrust, axis=1)
        falling = np.flatnonzero(size < 0.05 * mass * GRAVITY)
        if len(falling):
            raise DataError(
                f"{where}: the trajectory falls freely at {_when(t, place, falling[0])}, "
                "where the attitude is undetermined; sink more slowly"
            )
        down = -thrust / size[:, None]
        # 3-2-1 angles: body x lies in the vertical plane of the heading
        across = np.stack([-np.sin(heading), np.cos(heading), np.zeros(len(heading))], axis=1)
        forward = np.cross(across, down)
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
        quaternion = attitude.from_matrix(np.stack([forward, np.cross(down, forward), down], axis=2))
        state = np.hstack([
            np.stack(attitude.to_euler(quaternion).T, axis=1),
            attitude.rotate_inverse(quaternion, velocity), np.zeros_like(place), place,
        ])  # fmt: skip
        # the rotors' share of drag goes with their speed
        speeds = hover_speed_of(model) * np.sqrt(size / (mass * GRAVITY))[:, None] * np.ones(4)
        force = _forces(model, state, speeds, quaternion, t)
        force[:, 2] = 0.0
        side = attitude.rotate(quaternion, force)
    return attitude.continuous(quaternion)


def _further(model: Model, t: np.ndarray) -> dict[str, np.ndarray]:
    """What the model reads beyond state and rotor speeds (n,): the time, and the usual values of anything else."""
    usual = dict(zip(model.inputs[20:], list_usual_inputs(model)))
    return {name: t if name == "t" else np.full(len(t), value) for name, value in usual.items()}


def _forces(model: Model, state: np.ndarray, speeds: np.ndarray, quaternion: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Aerodynamic forces (n, 3) of the model, N, body axes; an axis that it lacks counts as nothing."""
    forces = np.nan_to_num(model.predict(state, speeds, extra=_further(model, t))[0])
    if not model.with_gravity:
        forces = forces - mass_of(model) * attitude.rotate_inverse(quaternion, GRAVITY * DOWN)
    return forces


def flown(motion: Motion, model: Model, where: str) -> pd.DataFrame:
    """Columns of a filtered flight, rotor speeds with them, of a motion. Raises DataError where it cannot be flown."""
    t, q = motion.t, motion.quaternion
    rates = attitude.body_rates(q, t)
    spin_up = np.gradient(rates, t, axis=0)
    inertia = np.asarray(model.airframe.inertia, float)
    body = attitude.rotate_inverse(q, motion.velocity)
    specific = attitude.rotate_inverse(q, motion.acceleration - GRAVITY * DOWN)
    state = np.hstack([np.stack(attitude.to_euler(q).T, axis=1), body, rates, motion.position])
    moments = spin_up @ inertia.T + np.cross(rates, rates @ inertia.T)
    wanted = np.column_stack([mass_of(model) * specific[:, 2], moments])
    if not model.with_gravity:
        wanted[:, 0] += mass_of(model) * GRAVITY * attitude.rotate_inverse(q, DOWN)[:, 2]
    speeds = _speeds(model, state, wanted, t, motion.position, where)
    columns = {"t": t, **dict(zip(ROTORS, speeds.T))}
    columns |= {f"{name}_dot": np.gradient(columns[name], t) for name in ROTORS}
    columns |= dict(zip(("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z"), state.T))
    columns |= dict(zip(("ax", "ay", "az"), specific.T))
    return with_forces(pd.DataFrame(columns), model)


def with_forces(flight: pd.DataFrame, model: Model) -> pd.DataFrame:
    """The table with forces and moments as the model has them, and the specific force where it lacks that.

    Raises ConfigError for a model that lacks an axis.
    """
    lacking = [axis for axis in AXES if axis not in model.axes]
    if lacking:
        raise ConfigError(f"model {model.id} has no {lacking[0]}; identify all six axes to plan with it")
    further = _further(model, flight["t"].to_numpy(float))
    flight = flight.assign(**{name: values for name, values in further.items() if name not in flight})
    own = model.predict_columns(flight)
    flight = flight.assign(**{axis: own[axis].to_numpy() for axis in AXES})
    if not {"ax", "ay", "az"} <= set(flight):
        felt = flight[["Fx", "Fy", "Fz"]].to_numpy() / mass_of(model)
        if not model.with_gravity:
            turned = attitude.from_euler(*(flight[a].to_numpy(float) for a in ("roll", "pitch", "yaw")))
            felt = felt - attitude.rotate_inverse(turned, GRAVITY * DOWN)
        flight = flight.assign(**dict(zip(("ax", "ay", "az"), felt.T)))
    return flight


def _speeds(
    model: Model, state: np.ndarray, wanted: np.ndarray, t: np.ndarray, place: np.ndarray, where: str
) -> np.ndarray:
    """Rotor speeds (n, 4) with which the model gives Fz, Mx, My, Mz (n, 4); Newton, all rows at once."""
    hover, low, high = hover_speed_of(model), *limits_of(model)
    unit = mass_of(model) * GRAVITY * np.array([1.0, *[model.airframe.arm] * 3])
    speeds, further = np.full((len(state), 4), hover), _further(model, t)

    def miss(at: np.ndarray) -> np.ndarray:
        forces, moments = model.predict(state, at, extra=further)
        return (np.column_stack([forces[:, 2], moments]) - wanted) / unit

    left = miss(speeds)
    if not np.isfinite(left).all():
        raise ConfigError(f"model {model.id} gives no number for Fz, Mx, My or Mz on {where}; identify all six axes")
    step = 1e-3 * hover
    for _ in range(SOLVES):
        slope = np.stack([(miss(speeds + step * np.eye(4)[i]) - left) / step for i in range(4)], axis=2)
        move = np.linalg.solve(slope, left[..., None])[..., 0]
        speeds = np.clip(speeds - np.clip(move, -0.5 * hover, 0.5 * hover), 0.02 * hover, 4.0 * hover)
        left = miss(speeds)
        if np.abs(left).max() < CONVERGED:
            break
    beyond = np.maximum(speeds.max(axis=1) - high, low - speeds.min(axis=1))
    beyond = np.where(np.abs(left).max(axis=1) > 1e-3, np.inf, beyond)
    first = np.flatnonzero(beyond > 0.0)
    if len(first):
        k = int(first[0])
        rotor = int(np.argmax(np.maximum(speeds[k] - high, low - speeds[k])))
        bounds = f"{low:.0f} to {high:.0f}" if math.isfinite(high) else f"{low:.0f} or more"
        found = f"rotor {rotor + 1} at {speeds[k, rotor]:.0f} rad/s, expected {bounds} rad/s"
        if low <= speeds[k].min() and speeds[k].max() <= high:
            found = "no rotor speeds make its force and moments"
        raise DataError(
            f"{where}: the trajectory asks more than the rotors give at {_when(t, place, k)}: {found}; fly it slower "
            "or smoother"
        )
    return speeds


def _when(t: np.ndarray, place: np.ndarray, row: int) -> str:
    return f"t = {t[row]:.2f} s, x y z = {place[row, 0]:.2f} {place[row, 1]:.2f} {place[row, 2]:.2f} m"


def mass_of(model: Model) -> float:
    """kg. Raises ConfigError where the model's airframe has none."""
    if model.airframe.mass is None:
        raise ConfigError(f"the airframe of model {model.id} has no mass, which a plan needs; give it in the quadrotor")
    return float(model.airframe.mass)


def hover_speed_of(model: Model) -> float:
    """rad/s, of each rotor. Raises ConfigError where the model has none."""
    if model.hover_speed is None:
        raise ConfigError(f"model {model.id} has no hover speed, which a plan needs; identify it anew")
    return float(model.hover_speed)


def limits_of(model: Model) -> tuple[float, float]:
    """Lowest and highest rotor speed, rad/s, by the airframe; 0 and infinity where it does not say."""
    low, high = read_speed_limits(model)
    return (0.0 if low is None else low), (math.inf if high is None else high)
