"""References: setpoints of the controller as a function of time; compiled.

    kind, parameters, table = make_reference({"kind": "figure eight", "amplitude": 2.0})
    evaluate_reference(kind, parameters, table, t, setpoint)          fills setpoint (20,), see outer_loop.py

Positions include velocity and acceleration feedforward where they exist. A step has none, unless "transition" smooths
it by the polynomial of fifth degree that begins and ends without velocity and acceleration.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline

from quasi.errors import ConfigError, DataError, nearest
from quasi.model.document import is_number
from quasi.project import configuration
from quasi.simulation.control.outer_loop import (
    ATTITUDE_SETPOINT,
    POSITION_SETPOINT,
    RATES_SETPOINT,
    SETPOINT_ACCELERATION,
    SETPOINT_ANGLES,
    SETPOINT_KIND,
    SETPOINT_POSITION,
    SETPOINT_RATES,
    SETPOINT_SIZE,
    SETPOINT_THRUST,
    SETPOINT_VELOCITY,
    SETPOINT_YAW_RATE,
    VELOCITY_SETPOINT,
)
from quasi.simulation.vehicle.dynamics import euler_angles
from quasi.simulation.vehicle.sensors_and_wind import find_row

HOVER_REFERENCE, STEPS_REFERENCE, EIGHT_REFERENCE, TABLE_REFERENCE, CIRCLE_REFERENCE = 0, 1, 2, 3, 4
SETPOINT_KINDS = {
    "position": (POSITION_SETPOINT, SETPOINT_POSITION, ("x", "y", "z")),
    "velocity": (VELOCITY_SETPOINT, SETPOINT_VELOCITY, ("vx", "vy", "vz")),
    "attitude": (ATTITUDE_SETPOINT, SETPOINT_ANGLES, ("roll", "pitch", "yaw")),
    "rates": (RATES_SETPOINT, SETPOINT_RATES, ("p", "q", "r")),
}
ALONG_PATH = "along path"  # heading of a circle whose nose points along the velocity
# the manual's two built-in references (section 7.1, figure 24a); their numbers are the defaults of the schema
_FLAGS = {"do position track": "position steps", "do circle track": "circle"}

_SETPOINTS_OF_STEPS = {"position steps": "position", "velocity steps": "velocity", "attitude steps": "attitude",
               "rate steps": "rates"}  # fmt: skip
# meaning of the optional fifth number of a step
_FIFTH_NUMBER = {"position": ("yaw", "rad"), "velocity": ("yaw rate", "rad/s"), "attitude": ("thrust", "N"),
          "rates": ("thrust", "N")}  # fmt: skip


def make_reference(
    settings: Mapping[str, Any] | None, table: Mapping[str, Any] | None = None
) -> tuple[int, np.ndarray, np.ndarray]:
    """Kind, parameters and table (T, 20) for `evaluate_reference`.

    settings  "kind" and its settings, see "$defs" in the schema of simulations; or the manual's "do position track",
              "do circle track"; none: hover
    table     for the kind "table": columns t (s) and x y z, vx vy vz, roll pitch yaw or p q r (each SI, earth axes
              down); optional: velocities with positions, ax ay az, yaw, yaw_rate, thrust
    Raises ConfigError naming the setting, DataError for a table that cannot be followed.
    """
    kind, chosen = _choose_kind(dict(settings or {}))
    if kind == "hover":
        return HOVER_REFERENCE, np.array([*chosen["position"], chosen["yaw"]], float), np.zeros((1, SETPOINT_SIZE))
    if kind == "figure eight":
        numbers = [chosen[k] for k in ("amplitude", "angular speed", "start", "transition", "yaw", "yaw rate")]
        return (
            EIGHT_REFERENCE,
            np.array([*numbers, *chosen["centre"], *chosen["hold"]], float),
            np.zeros((1, SETPOINT_SIZE)),
        )
    if kind == "circle":
        return CIRCLE_REFERENCE, _circle_parameters(chosen), np.zeros((1, SETPOINT_SIZE))
    if kind == "table":
        if table is None:
            raise ConfigError("reference 'table' has no table; name one under 'file'")
        return _make_table_reference(chosen, table)
    return _make_steps_reference(_SETPOINTS_OF_STEPS[kind], chosen)


def _choose_kind(settings: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    wanted = [kind for flag, kind in _FLAGS.items() if settings.pop(flag, False)]
    named = settings.pop("kind", None)
    if len(wanted) + (named is not None) > 1:
        raise ConfigError(
            "references: only one of 'do position track', 'do circle track' and 'kind' can be followed; switch the "
            "others off"
        )
    kind = named if named is not None else (wanted or ["hover"])[0]
    kinds = configuration.schema("simulation")["$defs"]
    if kind not in kinds:
        raise ConfigError(f"references: 'kind' is {kind!r}, which is not known{nearest(str(kind), kinds)}")
    return kind, configuration.check(settings, "simulation", f"reference '{kind}'", "$defs", kind)[0]


def _circle_parameters(chosen: Mapping[str, Any]) -> np.ndarray:
    """Parameters of `_evaluate_curve` for a circle; a positive rate is clockwise seen from above (north to east)."""
    radius, rate, heading = chosen["radius"], chosen["rate"], chosen["heading"]
    yaw, yaw_rate = (heading, 0.0) if heading != ALONG_PATH else (math.copysign(0.5 * math.pi, rate), rate)
    centre = [*chosen["centre"], -chosen["height"]]
    return np.array(
        [radius, rate, chosen["start"], chosen["transition"], yaw, yaw_rate, *centre, *chosen["hold"]], float
    )


def _make_steps_reference(setpoint: str, chosen: Mapping[str, Any]) -> tuple[int, np.ndarray, np.ndarray]:
    number, first, names = SETPOINT_KINDS[setpoint]
    fifth, unit = _FIFTH_NUMBER[setpoint]
    steps, transition = chosen["steps"], chosen.get("transition", 0.0)
    table = np.zeros((len(steps), SETPOINT_SIZE))
    last = -math.inf
    for row, step in enumerate(steps):
        where = f"reference steps of {setpoint}, row {row + 1}"
        if not (isinstance(step, list | tuple) and len(step) in (4, 5) and all(map(is_number, step))):
            raise ConfigError(
                f"{where} is {step!r}, expected the time (s), {', '.join(names)} and, if wanted, the {fifth} ({unit})"
            )
        if step[0] <= last or (row and step[0] - last < transition):
            gap = f" by at least the transition of {transition:g} s" if transition else ""
            raise ConfigError(f"{where} is at {step[0]:g} s, after a row at {last:g} s; times must grow{gap}")
        last = step[0]
        table[row, 0] = step[0]
        table[row, first : first + 3] = step[1:4]
        table[row, SETPOINT_THRUST] = step[4] if fifth == "thrust" and len(step) == 5 else np.nan
        if fifth == "yaw":  # without one, the heading stays
            table[row, SETPOINT_ANGLES + 2] = step[4] if len(step) == 5 else table[max(row - 1, 0), SETPOINT_ANGLES + 2]
        if len(step) == 5 and fifth == "yaw rate":
            table[row, SETPOINT_YAW_RATE] = step[4]
    # integrate the yaw rates from row to row
    if setpoint == "velocity":
        for row in range(1, len(table)):
            turned = table[row - 1, SETPOINT_YAW_RATE] * (table[row, 0] - table[row - 1, 0])
            table[row, SETPOINT_ANGLES + 2] = table[row - 1, SETPOINT_ANGLES + 2] + turned
    return STEPS_REFERENCE, np.array([number, transition]), table


def _make_table_reference(chosen: Mapping[str, Any], columns: Mapping[str, Any]) -> tuple[int, np.ndarray, np.ndarray]:
    number, first, names = SETPOINT_KINDS[chosen["goal"]]
    missing = [name for name in ("t", *names) if name not in columns]
    if missing:
        raise DataError(
            f"the reference's table lacks the column '{missing[0]}', which the goal '{chosen['goal']}' needs"
            f"{nearest(missing[0], list(columns))}"
        )
    data = {name: np.asarray(columns[name], float) for name in ("t", *names)}
    optional = {"yaw": SETPOINT_ANGLES + 2, "yaw_rate": SETPOINT_YAW_RATE, "thrust": SETPOINT_THRUST}
    if chosen["goal"] == "position":
        optional |= {f"v{axis}": SETPOINT_VELOCITY + k for k, axis in enumerate("xyz")}
        optional |= {f"a{axis}": SETPOINT_ACCELERATION + k for k, axis in enumerate("xyz")}
    data |= {name: np.asarray(columns[name], float) for name in optional if name in columns and name not in names}
    t = data["t"]
    if len(t) < 2:
        raise DataError(f"the reference's table has {len(t)} rows, expected two or more")
    for name, values in data.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise DataError(f"the reference's table holds no number in column '{name}', row {bad[0] + 1}; fill it in")
    back = np.flatnonzero(np.diff(t) <= 0.0)
    if len(back):
        raise DataError(f"the reference's table goes from {t[back[0]]:g} to {t[back[0] + 1]:g} s in row {back[0] + 2}; "
                        "times must grow")  # fmt: skip
    table = np.zeros((len(t), SETPOINT_SIZE))
    table[:, 0], table[:, SETPOINT_THRUST] = t, np.nan
    for k, name in enumerate(names):
        table[:, first + k] = np.unwrap(data[name]) if name in ("roll", "yaw") else data[name]
    for name, position in optional.items():
        if name in data:
            table[:, position] = np.unwrap(data[name]) if name == "yaw" else data[name]
    smooth = chosen["interpolation"] == "smooth"
    if smooth and chosen["goal"] == "position":
        for k in range(3):
            spline = CubicSpline(t, table[:, SETPOINT_POSITION + k], bc_type="natural")
            if "v" + "xyz"[k] not in data:
                table[:, SETPOINT_VELOCITY + k] = spline(t, 1)
            if "a" + "xyz"[k] not in data:
                table[:, SETPOINT_ACCELERATION + k] = spline(t, 2)
    if smooth and "yaw" in data and "yaw_rate" not in data:
        table[:, SETPOINT_YAW_RATE] = np.gradient(table[:, SETPOINT_ANGLES + 2], t)
    if "yaw_rate" in data and "yaw" not in data:  # integrate the yaw rate
        rate = data["yaw_rate"]
        mean = 0.5 * (rate[1:] + rate[:-1]) if smooth else rate[:-1]
        table[1:, SETPOINT_ANGLES + 2] = np.cumsum(mean * np.diff(t))
    if not smooth:
        if chosen["end"] == "repeat":
            raise ConfigError("the reference's table: 'end' \"repeat\" goes with 'interpolation' \"smooth\" alone")
        return STEPS_REFERENCE, np.array([number, 0.0]), table
    return TABLE_REFERENCE, np.array([number, float(chosen["end"] == "repeat")]), table


@njit(cache=True, error_model="numpy")
def evaluate_reference(kind, parameters, table, t, setpoint):
    """Fill setpoint (20,) for time t, s; see outer_loop.py for its entries."""
    for k in range(SETPOINT_SIZE):
        setpoint[k] = 0.0
    setpoint[SETPOINT_THRUST] = np.nan
    if kind == HOVER_REFERENCE:
        for k in range(3):
            setpoint[SETPOINT_POSITION + k] = parameters[k]
        setpoint[SETPOINT_ANGLES + 2] = parameters[3]
    elif kind == STEPS_REFERENCE:
        _evaluate_steps(parameters, table, t, setpoint)
    elif kind in (EIGHT_REFERENCE, CIRCLE_REFERENCE):
        _evaluate_curve(kind, parameters, t, setpoint)
    else:
        _evaluate_table(parameters, table, t, setpoint)


@njit(cache=True, error_model="numpy")
def ease_transition(x, duration):
    """Share of a transition at the part x of it, and its first two derivatives by time."""
    if x >= 1.0 or duration <= 0.0:
        return 1.0, 0.0, 0.0
    s = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
    d = 30.0 * x * x * (1.0 - x) ** 2 / duration
    return s, d, 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (duration * duration)


@njit(cache=True, error_model="numpy")
def _evaluate_steps(parameters, table, t, setpoint):
    row = find_row(table, t)
    for k in range(1, SETPOINT_SIZE):
        setpoint[k] = table[row, k]
    setpoint[SETPOINT_KIND] = parameters[0]
    since = t - table[row, 0]
    if since > 0.0:
        setpoint[SETPOINT_ANGLES + 2] += setpoint[SETPOINT_YAW_RATE] * since
    if parameters[1] > 0.0 and row > 0 and since < parameters[1]:
        s, d, dd = ease_transition(since / parameters[1], parameters[1])
        for k in range(3):
            begin, way = (
                table[row - 1, SETPOINT_POSITION + k],
                table[row, SETPOINT_POSITION + k] - table[row - 1, SETPOINT_POSITION + k],
            )
            setpoint[SETPOINT_POSITION + k] = begin + s * way
            setpoint[SETPOINT_VELOCITY + k] = d * way
            setpoint[SETPOINT_ACCELERATION + k] = dd * way
        way = table[row, SETPOINT_ANGLES + 2] - table[row - 1, SETPOINT_ANGLES + 2]
        setpoint[SETPOINT_ANGLES + 2] = table[row - 1, SETPOINT_ANGLES + 2] + s * way
        setpoint[SETPOINT_YAW_RATE] = d * way


@njit(cache=True, error_model="numpy")
def _evaluate_curve(kind, parameters, t, setpoint):
    """A closed curve about the centre, reached from "hold" by an eased transition; phi = rate x time since the start.

    Circle: x = A cos(phi), y = A sin(phi). Figure eight: x = A cos(phi), y = A sin(phi) cos(phi).
    """
    a, w, start, duration, yaw, turn = parameters[:6]
    since = t - start
    setpoint[SETPOINT_ANGLES + 2] = yaw
    if since < 0.0:
        for k in range(3):
            setpoint[SETPOINT_POSITION + k] = parameters[9 + k]
        return
    setpoint[SETPOINT_ANGLES + 2] += turn * since
    setpoint[SETPOINT_YAW_RATE] = turn
    cosine, sine = math.cos(w * since), math.sin(w * since)
    s, d, dd = ease_transition(since / duration if duration > 0.0 else 1.0, duration)
    for k in range(3):
        position, velocity, acceleration = parameters[6 + k], 0.0, 0.0
        if k == 0:
            position, velocity, acceleration = position + a * cosine, -a * w * sine, -a * w * w * cosine
        elif k == 1 and kind == CIRCLE_REFERENCE:
            position, velocity, acceleration = position + a * sine, a * w * cosine, -a * w * w * sine
        elif k == 1:
            position += a * sine * cosine
            velocity, acceleration = a * w * (cosine * cosine - sine * sine), -4.0 * a * w * w * sine * cosine
        hold = parameters[9 + k]
        setpoint[SETPOINT_POSITION + k] = hold + s * (position - hold)
        setpoint[SETPOINT_VELOCITY + k] = d * (position - hold) + s * velocity
        setpoint[SETPOINT_ACCELERATION + k] = dd * (position - hold) + 2.0 * d * velocity + s * acceleration


@njit(cache=True, error_model="numpy")
def _compute_quaternion(table, row, out):
    """Attitude w x y z of the angles in a row into out (4,)."""
    cr, sr = math.cos(0.5 * table[row, SETPOINT_ANGLES]), math.sin(0.5 * table[row, SETPOINT_ANGLES])
    cp, sp = math.cos(0.5 * table[row, SETPOINT_ANGLES + 1]), math.sin(0.5 * table[row, SETPOINT_ANGLES + 1])
    cy, sy = math.cos(0.5 * table[row, SETPOINT_ANGLES + 2]), math.sin(0.5 * table[row, SETPOINT_ANGLES + 2])
    out[0], out[1] = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    out[2], out[3] = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy


@njit(cache=True, error_model="numpy")
def _interpolate_attitude(table, row, x, h, setpoint):
    """The shorter turn from one row to the next at an even rate (slerp): angles, and body rates fed forward, rad/s."""
    a, b = np.empty(4), np.empty(4)
    _compute_quaternion(table, row, a)
    _compute_quaternion(table, row + 1, b)
    # the turn conj(a) b: half its angle by atan2, its axis along (i, j, k)
    w = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    i = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    j = a[0] * b[2] + a[1] * b[3] - a[2] * b[0] - a[3] * b[1]
    k = a[0] * b[3] - a[1] * b[2] + a[2] * b[1] - a[3] * b[0]
    sign = -1.0 if w < 0.0 else 1.0
    size = math.sqrt(i * i + j * j + k * k)
    half = math.atan2(size, sign * w)
    scale = sign * half / size if size > 1e-12 else sign
    i, j, k = scale * i, scale * j, scale * k
    setpoint[SETPOINT_RATES], setpoint[SETPOINT_RATES + 1], setpoint[SETPOINT_RATES + 2] = (
        2.0 * i / h,
        2.0 * j / h,
        2.0 * k / h,
    )
    setpoint[SETPOINT_YAW_RATE] = 0.0
    cosine, sinc = math.cos(half * x), (math.sin(half * x) / half if half > 1e-12 else x)
    i, j, k = sinc * i, sinc * j, sinc * k
    b[0] = a[0] * cosine - a[1] * i - a[2] * j - a[3] * k
    b[1] = a[0] * i + a[1] * cosine + a[2] * k - a[3] * j
    b[2] = a[0] * j - a[1] * k + a[2] * cosine + a[3] * i
    b[3] = a[0] * k + a[1] * j - a[2] * i + a[3] * cosine
    euler_angles(b, setpoint[SETPOINT_ANGLES : SETPOINT_ANGLES + 3])


@njit(cache=True, error_model="numpy")
def _evaluate_table(parameters, table, t, setpoint):
    """Between rows: fifth-degree polynomials through position, velocity and acceleration; attitudes take the shorter
    turn; the rest is linear.

    Before the first row its position is held; after the last one too, or the table begins anew.
    """
    last = len(table) - 1
    first, end = table[0, 0], table[last, 0]
    repeats = parameters[1] > 0.0
    if repeats and t >= end:
        t = first + (t - first) % (end - first)
    setpoint[SETPOINT_KIND] = parameters[0]
    if t < first or (t >= end and not repeats):
        row = 0 if t < first else last
        for k in range(1, SETPOINT_SIZE):
            setpoint[k] = table[row, k]
        setpoint[SETPOINT_YAW_RATE] = 0.0
        if parameters[0] == POSITION_SETPOINT:
            for k in range(3):
                setpoint[SETPOINT_VELOCITY + k] = setpoint[SETPOINT_ACCELERATION + k] = 0.0
        return
    row = find_row(table, t)
    h = table[row + 1, 0] - table[row, 0]
    x = (t - table[row, 0]) / h
    for k in range(1, SETPOINT_SIZE):
        setpoint[k] = (1.0 - x) * table[row, k] + x * table[row + 1, k]
    if parameters[0] == VELOCITY_SETPOINT:
        for k in range(3):
            setpoint[SETPOINT_ACCELERATION + k] = (
                table[row + 1, SETPOINT_VELOCITY + k] - table[row, SETPOINT_VELOCITY + k]
            ) / h
    if parameters[0] == ATTITUDE_SETPOINT:
        _interpolate_attitude(table, row, x, h, setpoint)
    if parameters[0] != POSITION_SETPOINT:
        return
    for k in range(3):
        p0, v0, a0 = (
            table[row, SETPOINT_POSITION + k],
            table[row, SETPOINT_VELOCITY + k] * h,
            table[row, SETPOINT_ACCELERATION + k] * h * h,
        )
        p1, v1, a1 = (
            table[row + 1, SETPOINT_POSITION + k],
            table[row + 1, SETPOINT_VELOCITY + k] * h,
            table[row + 1, SETPOINT_ACCELERATION + k] * h * h,
        )
        way = p1 - p0 - v0 - 0.5 * a0
        slope, acceleration = v1 - v0 - a0, a1 - a0
        c3, c4 = 10.0 * way - 4.0 * slope + 0.5 * acceleration, -15.0 * way + 7.0 * slope - acceleration
        c5 = 6.0 * way - 3.0 * slope + 0.5 * acceleration
        setpoint[SETPOINT_POSITION + k] = p0 + x * (v0 + x * (0.5 * a0 + x * (c3 + x * (c4 + x * c5))))
        setpoint[SETPOINT_VELOCITY + k] = (v0 + x * (a0 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))) / h
        setpoint[SETPOINT_ACCELERATION + k] = (a0 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5))) / (h * h)
