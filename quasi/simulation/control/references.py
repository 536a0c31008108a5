"""References: what the controller is asked to follow, as a function of time; compiled.

    kind, parameters, table = make_reference({"kind": "figure eight", "amplitude": 2.0})
    goal_at(kind, parameters, table, t, goal)          fills goal (20,), see outer_loop.py

Positions carry their velocity and acceleration with them where they have any, so that the controller need not wait for
an error. A step has none: it is meant as one, unless "transition" smooths it by the polynomial of fifth degree that
begins and ends without velocity and acceleration.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline

from quasi.errors import ConfigError, DataError, nearest
from quasi.simulation.control.outer_loop import (
    ANGLES,
    ATTITUDE_GOAL,
    FORWARD,
    GOAL,
    KIND,
    PLACE,
    POSITION_GOAL,
    RATES,
    RATES_GOAL,
    SPEED,
    THRUST,
    VELOCITY_GOAL,
    YAW_RATE,
)
from quasi.simulation.vehicle.dynamics import euler_angles

HOVER, STEPS, EIGHT, TABLE, CIRCLE = 0, 1, 2, 3, 4
GOALS = {
    "position": (POSITION_GOAL, PLACE, ("x", "y", "z")),
    "velocity": (VELOCITY_GOAL, SPEED, ("vx", "vy", "vz")),
    "attitude": (ATTITUDE_GOAL, ANGLES, ("roll", "pitch", "yaw")),
    "rates": (RATES_GOAL, RATES, ("p", "q", "r")),
}
# the manual's two built-in references (section 7.1, figure 24a), with the numbers of QuaSI at the manual's date
ALONG_PATH = "along path"  # heading of a circle whose nose points along the velocity
_TRACK = [[0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, -1.0], [6.0, 4.0, -2.0, -1.0]]
_FLAGS = {"do position track": "position steps", "do circle track": "circle"}

Check = Callable[[Any], bool]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_place(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) == 3 and all(map(_is_number, value))


_NUMBER: tuple[Check, str] = (_is_number, "a number")
_PLACE: tuple[Check, str] = (_is_place, "three numbers, m, earth axes (z down)")
_TIME: tuple[Check, str] = (lambda v: _is_number(v) and v >= 0.0, "seconds, 0 or more")
_POSITIVE: tuple[Check, str] = (lambda v: _is_number(v) and v > 0.0, "a positive number")
_ANGULAR_SPEED: tuple[Check, str] = (lambda v: _is_number(v) and v != 0.0, "rad/s, not 0")
_HEADING: tuple[Check, str] = (lambda v: v == ALONG_PATH or _is_number(v), f"rad, or '{ALONG_PATH}'")
_LEVEL: tuple[Check, str] = (
    lambda v: isinstance(v, list | tuple) and len(v) == 2 and all(map(_is_number, v)),
    "two numbers, m, north and east",
)
_ROWS: tuple[Check, str] = (lambda v: isinstance(v, list | tuple) and len(v) > 0, "a list of rows")
# kind: {setting: (default, check, what is expected)}
KINDS: dict[str, dict[str, tuple[Any, Check, str]]] = {
    "hover": {"position": ([0.0, 0.0, 0.0], *_PLACE), "yaw": (0.0, *_NUMBER)},
    "position steps": {"steps": (_TRACK, *_ROWS), "transition": (0.0, *_TIME)},
    "velocity steps": {"steps": ([[0.0, 0.0, 0.0, 0.0]], *_ROWS)},
    "attitude steps": {"steps": ([[0.0, 0.0, 0.0, 0.0]], *_ROWS)},
    "rate steps": {"steps": ([[0.0, 0.0, 0.0, 0.0]], *_ROWS)},
    # 4 m and 1 rad/s from 3 s on: the manual's circle; its height is that of the figure eight
    "circle": {
        "radius": (4.0, *_POSITIVE),
        "rate": (1.0, *_ANGULAR_SPEED),
        "height": (2.0, *_NUMBER),
        "heading": (0.0, *_HEADING),
        "centre": ([0.0, 0.0], *_LEVEL),
        "start": (3.0, *_TIME),
        "transition": (2.0, *_TIME),
        "hold": ([0.0, 0.0, 0.0], *_PLACE),
    },
    "figure eight": {
        "amplitude": (3.0, *_NUMBER),
        "angular speed": (1.0, *_ANGULAR_SPEED),
        "centre": ([0.0, 0.0, -2.0], *_PLACE),
        "start": (3.0, *_TIME),
        "transition": (2.0, *_TIME),
        "hold": ([0.0, 0.0, 0.0], *_PLACE),
        "yaw": (0.0, *_NUMBER),
        "yaw rate": (0.0, *_NUMBER),
    },
    "table": {
        "goal": ("position", lambda v: v in GOALS, f"one of {', '.join(GOALS)}"),
        "interpolation": ("smooth", lambda v: v in ("smooth", "steps"), "'smooth' or 'steps'"),
        "end": ("hold", lambda v: v in ("hold", "repeat"), "'hold' or 'repeat'"),
        "file": (None, lambda v: isinstance(v, str), "a path"),
    },
}
_STEP_GOALS = {"position steps": "position", "velocity steps": "velocity", "attitude steps": "attitude",
               "rate steps": "rates"}  # fmt: skip
# the optional fifth number of a step
_FIFTH = {"position": ("yaw", "rad"), "velocity": ("yaw rate", "rad/s"), "attitude": ("thrust", "N"),
          "rates": ("thrust", "N")}  # fmt: skip


def make_reference(
    settings: Mapping[str, Any] | None, table: Mapping[str, Any] | None = None
) -> tuple[int, np.ndarray, np.ndarray]:
    """Kind, parameters and table (T, 20) for `goal_at`.

    settings  "kind" and its settings, see KINDS; or the manual's "do position track", "do circle track"; nothing: hover
    table     for the kind "table": columns t (s) and x y z, vx vy vz, roll pitch yaw or p q r (each SI, earth axes
              down); optional: velocities beside positions, ax ay az, yaw, yaw_rate, thrust
    Raises ConfigError naming the setting, DataError for a table that cannot be followed.
    """
    kind, chosen = _choose(dict(settings or {}))
    if kind == "hover":
        return HOVER, np.array([*chosen["position"], chosen["yaw"]], float), np.zeros((1, GOAL))
    if kind == "figure eight":
        numbers = [chosen[k] for k in ("amplitude", "angular speed", "start", "transition", "yaw", "yaw rate")]
        return EIGHT, np.array([*numbers, *chosen["centre"], *chosen["hold"]], float), np.zeros((1, GOAL))
    if kind == "circle":
        return CIRCLE, _circle_parameters(chosen), np.zeros((1, GOAL))
    if kind == "table":
        if table is None:
            raise ConfigError("reference 'table' has no table; name one under 'file'")
        return _of_table(chosen, table)
    return _of_steps(_STEP_GOALS[kind], chosen)


def _choose(settings: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    wanted = [kind for flag, kind in _FLAGS.items() if settings.pop(flag, False)]
    named = settings.pop("kind", None)
    if len(wanted) + (named is not None) > 1:
        raise ConfigError(
            "references: only one of 'do position track', 'do circle track' and 'kind' can be followed; switch the "
            "others off"
        )
    kind = named if named is not None else (wanted or ["hover"])[0]
    if kind not in KINDS:
        raise ConfigError(f"references: 'kind' is {kind!r}, which is not known{nearest(str(kind), KINDS)}")
    known = KINDS[kind]
    for key, value in settings.items():
        if key not in known:
            raise ConfigError(f"reference '{kind}': unknown key '{key}'{nearest(key, known)}")
        if not known[key][1](value):
            raise ConfigError(f"reference '{kind}': '{key}' is {value!r}, expected {known[key][2]}")
    return kind, {key: settings.get(key, about[0]) for key, about in known.items()}


def _circle_parameters(chosen: Mapping[str, Any]) -> np.ndarray:
    """Parameters of `_curve_at` for a circle; a positive rate turns clockwise as seen from above (north to east)."""
    radius, rate, heading = chosen["radius"], chosen["rate"], chosen["heading"]
    yaw, yaw_rate = (heading, 0.0) if heading != ALONG_PATH else (math.copysign(0.5 * math.pi, rate), rate)
    centre = [*chosen["centre"], -chosen["height"]]
    return np.array(
        [radius, rate, chosen["start"], chosen["transition"], yaw, yaw_rate, *centre, *chosen["hold"]], float
    )


def _of_steps(goal: str, chosen: Mapping[str, Any]) -> tuple[int, np.ndarray, np.ndarray]:
    number, first, names = GOALS[goal]
    fifth, unit = _FIFTH[goal]
    steps, transition = chosen["steps"], chosen.get("transition", 0.0)
    table = np.zeros((len(steps), GOAL))
    last = -math.inf
    for row, step in enumerate(steps):
        where = f"reference steps of {goal}, row {row + 1}"
        if not (isinstance(step, list | tuple) and len(step) in (4, 5) and all(map(_is_number, step))):
            raise ConfigError(
                f"{where} is {step!r}, expected the time (s), {', '.join(names)} and, if wanted, the {fifth} ({unit})"
            )
        if step[0] <= last or (row and step[0] - last < transition):
            gap = f" by at least the transition of {transition:g} s" if transition else ""
            raise ConfigError(f"{where} is at {step[0]:g} s, after a row at {last:g} s; times must grow{gap}")
        last = step[0]
        table[row, 0] = step[0]
        table[row, first : first + 3] = step[1:4]
        table[row, THRUST] = step[4] if fifth == "thrust" and len(step) == 5 else np.nan
        if fifth == "yaw":  # without one, the heading stays
            table[row, ANGLES + 2] = step[4] if len(step) == 5 else table[max(row - 1, 0), ANGLES + 2]
        if len(step) == 5 and fifth == "yaw rate":
            table[row, YAW_RATE] = step[4]
    # the heading goes on from row to row as the yaw rates turn it
    if goal == "velocity":
        for row in range(1, len(table)):
            turned = table[row - 1, YAW_RATE] * (table[row, 0] - table[row - 1, 0])
            table[row, ANGLES + 2] = table[row - 1, ANGLES + 2] + turned
    return STEPS, np.array([number, transition]), table


def _of_table(chosen: Mapping[str, Any], columns: Mapping[str, Any]) -> tuple[int, np.ndarray, np.ndarray]:
    number, first, names = GOALS[chosen["goal"]]
    missing = [name for name in ("t", *names) if name not in columns]
    if missing:
        raise DataError(
            f"the reference's table lacks the column '{missing[0]}', which the goal '{chosen['goal']}' needs"
            f"{nearest(missing[0], list(columns))}"
        )
    data = {name: np.asarray(columns[name], float) for name in ("t", *names)}
    optional = {"yaw": ANGLES + 2, "yaw_rate": YAW_RATE, "thrust": THRUST}
    if chosen["goal"] == "position":
        optional |= dict(zip(("vx", "vy", "vz", "ax", "ay", "az"), (SPEED, SPEED + 1, SPEED + 2, FORWARD, FORWARD + 1,
                                                                    FORWARD + 2)))  # fmt: skip
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
    table = np.zeros((len(t), GOAL))
    table[:, 0], table[:, THRUST] = t, np.nan
    for k, name in enumerate(names):
        table[:, first + k] = np.unwrap(data[name]) if name in ("roll", "yaw") else data[name]
    for name, place in optional.items():
        if name in data:
            table[:, place] = np.unwrap(data[name]) if name == "yaw" else data[name]
    smooth = chosen["interpolation"] == "smooth"
    if smooth and chosen["goal"] == "position":
        for k in range(3):
            spline = CubicSpline(t, table[:, PLACE + k], bc_type="natural")
            if "v" + "xyz"[k] not in data:
                table[:, SPEED + k] = spline(t, 1)
            if "a" + "xyz"[k] not in data:
                table[:, FORWARD + k] = spline(t, 2)
    if smooth and "yaw" in data and "yaw_rate" not in data:
        table[:, YAW_RATE] = np.gradient(table[:, ANGLES + 2], t)
    if "yaw_rate" in data and "yaw" not in data:  # the heading goes where the rate turns it
        rate = data["yaw_rate"]
        mean = 0.5 * (rate[1:] + rate[:-1]) if smooth else rate[:-1]
        table[1:, ANGLES + 2] = np.cumsum(mean * np.diff(t))
    if not smooth:
        if chosen["end"] == "repeat":
            raise ConfigError("the reference's table: 'end' \"repeat\" goes with 'interpolation' \"smooth\" alone")
        return STEPS, np.array([number, 0.0]), table
    return TABLE, np.array([number, float(chosen["end"] == "repeat")]), table


@njit(cache=True, error_model="numpy")
def goal_at(kind, parameters, table, t, goal):
    """Fill goal (20,) with what is wanted at time t, s; see outer_loop.py for its entries."""
    for k in range(GOAL):
        goal[k] = 0.0
    goal[THRUST] = np.nan
    if kind == HOVER:
        for k in range(3):
            goal[PLACE + k] = parameters[k]
        goal[ANGLES + 2] = parameters[3]
    elif kind == STEPS:
        _steps_at(parameters, table, t, goal)
    elif kind in (EIGHT, CIRCLE):
        _curve_at(kind, parameters, t, goal)
    else:
        _table_at(parameters, table, t, goal)


@njit(cache=True, error_model="numpy")
def _row_at(table, t):
    """The last row at or before t; the first where t lies before all."""
    low, high = 0, len(table)
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle, 0] <= t:
            low = middle
        else:
            high = middle
    return low


@njit(cache=True, error_model="numpy")
def _ease(x, duration):
    """Share of a transition at the part x of it, and its first two derivatives by time."""
    if x >= 1.0 or duration <= 0.0:
        return 1.0, 0.0, 0.0
    s = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
    d = 30.0 * x * x * (1.0 - x) ** 2 / duration
    return s, d, 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (duration * duration)


@njit(cache=True, error_model="numpy")
def _steps_at(parameters, table, t, goal):
    row = _row_at(table, t)
    for k in range(1, GOAL):
        goal[k] = table[row, k]
    goal[KIND] = parameters[0]
    since = t - table[row, 0]
    if since > 0.0:
        goal[ANGLES + 2] += goal[YAW_RATE] * since
    if parameters[1] > 0.0 and row > 0 and since < parameters[1]:
        s, d, dd = _ease(since / parameters[1], parameters[1])
        for k in range(3):
            begin, way = table[row - 1, PLACE + k], table[row, PLACE + k] - table[row - 1, PLACE + k]
            goal[PLACE + k] = begin + s * way
            goal[SPEED + k] = d * way
            goal[FORWARD + k] = dd * way
        way = table[row, ANGLES + 2] - table[row - 1, ANGLES + 2]
        goal[ANGLES + 2] = table[row - 1, ANGLES + 2] + s * way
        goal[YAW_RATE] = d * way


@njit(cache=True, error_model="numpy")
def _curve_at(kind, parameters, t, goal):
    """A closed curve about the centre, reached from "hold" by an eased transition; phi = rate x time since the start.

    Circle: x = A cos(phi), y = A sin(phi). Figure eight: x = A cos(phi), y = A sin(phi) cos(phi).
    """
    a, w, start, duration, yaw, turn = parameters[:6]
    since = t - start
    goal[ANGLES + 2] = yaw
    if since < 0.0:
        for k in range(3):
            goal[PLACE + k] = parameters[9 + k]
        return
    goal[ANGLES + 2] += turn * since
    goal[YAW_RATE] = turn
    cosine, sine = math.cos(w * since), math.sin(w * since)
    s, d, dd = _ease(since / duration if duration > 0.0 else 1.0, duration)
    for k in range(3):
        place, speed, bend = parameters[6 + k], 0.0, 0.0
        if k == 0:
            place, speed, bend = place + a * cosine, -a * w * sine, -a * w * w * cosine
        elif k == 1 and kind == CIRCLE:
            place, speed, bend = place + a * sine, a * w * cosine, -a * w * w * sine
        elif k == 1:
            place += a * sine * cosine
            speed, bend = a * w * (cosine * cosine - sine * sine), -4.0 * a * w * w * sine * cosine
        hold = parameters[9 + k]
        goal[PLACE + k] = hold + s * (place - hold)
        goal[SPEED + k] = d * (place - hold) + s * speed
        goal[FORWARD + k] = dd * (place - hold) + 2.0 * d * speed + s * bend


@njit(cache=True, error_model="numpy")
def _quaternion_at(table, row, out):
    """Attitude w x y z of the angles in a row into out (4,)."""
    cr, sr = math.cos(0.5 * table[row, ANGLES]), math.sin(0.5 * table[row, ANGLES])
    cp, sp = math.cos(0.5 * table[row, ANGLES + 1]), math.sin(0.5 * table[row, ANGLES + 1])
    cy, sy = math.cos(0.5 * table[row, ANGLES + 2]), math.sin(0.5 * table[row, ANGLES + 2])
    out[0], out[1] = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    out[2], out[3] = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy


@njit(cache=True, error_model="numpy")
def _attitude_between(table, row, x, h, goal):
    """The shorter turn from one row to the next at an even rate (slerp): angles, and body rates fed forward, rad/s."""
    a, b = np.empty(4), np.empty(4)
    _quaternion_at(table, row, a)
    _quaternion_at(table, row + 1, b)
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
    goal[RATES], goal[RATES + 1], goal[RATES + 2] = 2.0 * i / h, 2.0 * j / h, 2.0 * k / h
    goal[YAW_RATE] = 0.0
    cosine, sinc = math.cos(half * x), (math.sin(half * x) / half if half > 1e-12 else x)
    i, j, k = sinc * i, sinc * j, sinc * k
    b[0] = a[0] * cosine - a[1] * i - a[2] * j - a[3] * k
    b[1] = a[0] * i + a[1] * cosine + a[2] * k - a[3] * j
    b[2] = a[0] * j - a[1] * k + a[2] * cosine + a[3] * i
    b[3] = a[0] * k + a[1] * j - a[2] * i + a[3] * cosine
    euler_angles(b, goal[ANGLES : ANGLES + 3])


@njit(cache=True, error_model="numpy")
def _table_at(parameters, table, t, goal):
    """Between rows: fifth-degree polynomials through position, velocity and acceleration; attitudes take the shorter
    turn; the rest is linear.

    Before the first row its position is held; after the last one too, or the table begins anew.
    """
    last = len(table) - 1
    first, end = table[0, 0], table[last, 0]
    if parameters[1] > 0.0 and t > end:
        t = first + (t - first) % (end - first)
    goal[KIND] = parameters[0]
    if t <= first or t >= end:
        row = 0 if t <= first else last
        for k in range(1, GOAL):
            goal[k] = table[row, k]
        goal[YAW_RATE] = 0.0
        if parameters[0] == POSITION_GOAL:
            for k in range(3):
                goal[SPEED + k] = goal[FORWARD + k] = 0.0
        return
    row = _row_at(table, t)
    h = table[row + 1, 0] - table[row, 0]
    x = (t - table[row, 0]) / h
    for k in range(1, GOAL):
        goal[k] = (1.0 - x) * table[row, k] + x * table[row + 1, k]
    if parameters[0] == VELOCITY_GOAL:
        for k in range(3):
            goal[FORWARD + k] = (table[row + 1, SPEED + k] - table[row, SPEED + k]) / h
    if parameters[0] == ATTITUDE_GOAL:
        _attitude_between(table, row, x, h, goal)
    if parameters[0] != POSITION_GOAL:
        return
    for k in range(3):
        p0, v0, a0 = table[row, PLACE + k], table[row, SPEED + k] * h, table[row, FORWARD + k] * h * h
        p1, v1, a1 = table[row + 1, PLACE + k], table[row + 1, SPEED + k] * h, table[row + 1, FORWARD + k] * h * h
        way = p1 - p0 - v0 - 0.5 * a0
        slope, bend = v1 - v0 - a0, a1 - a0
        c3, c4 = 10.0 * way - 4.0 * slope + 0.5 * bend, -15.0 * way + 7.0 * slope - bend
        c5 = 6.0 * way - 3.0 * slope + 0.5 * bend
        goal[PLACE + k] = p0 + x * (v0 + x * (0.5 * a0 + x * (c3 + x * (c4 + x * c5))))
        goal[SPEED + k] = (v0 + x * (a0 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))) / h
        goal[FORWARD + k] = (a0 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5))) / (h * h)
