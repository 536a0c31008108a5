"""What sound sensors can show: limits beyond which two sources of a flight contradict each other, and clipped channels.

Each limit lies beyond what a sound sensor, mounting or capture shows. Beyond it one of the two named sources is wrong,
in its unit, axes, sign, scale or time stamps, and the flight is unusable.

Clipped channels have flat tops, with a known or unknown full scale. A sensor beyond its range repeats one extreme
value, for a long time or repeatedly. A smooth peak of a quantised signal is flat too, but leaves its top slowly: half
its length later it has fallen by about three steps, a clipped signal by many. A signal held between slow updates
repeats all its values, and not only the extreme.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quasi.attitude import GRAVITY

# m/s2. Twice the largest zero-g offset of the consumer IMUs on flight controllers: 80 mg along z (InvenSense MPU-6000
# product specification rev. 3.4, table 6.2); Bosch BMI088 and TDK ICM-42688-P state 20 mg
ACCELEROMETER_BIAS = 2 * 0.080 * 9.80665
GYRO_BIAS = np.radians(20.0)  # rad/s, initial zero-rate output of the MPU-6000 (table 6.1); newer ones state 0.5 to 1
MIN_BIAS_SIGMAS = 3.0  # standard errors that a bias must also exceed: an uncertain bias contradicts nothing
# rad. Rigid bodies are aligned by eye to some degrees; ours were off by 0.2 to 1.1 deg (nano-drone runs, null-1-told)
MOUNTING_ANGLE = np.radians(10.0)
AXES_ANGLE = np.radians(45.0)  # rad, half of what an exchange of axes turns the vertical by
# rad, by which an allowed accelerometer bias tilts gravity at rest
REST_ANGLE = np.arcsin(ACCELEROMETER_BIAS / 9.80665)
# Innovations of five times their standard errors on average, after the noise levels were re-estimated. Sound flights
# showed 0.2 to 6 (nano-drone runs, null-1-told), a filter that lost the attitude 116 to 909
MAX_NIS = 25.0
# Body rates of a gyro over those of an attitude; scale errors of data sheets are 3 % (MPU-6000), ours were 0.87 to 1.01
RATE_GAIN = (2 / 3, 3 / 2)
# Accelerations of a captured position over those measured; sound flights showed 0.92 to 1.01
LENGTH_RATIO = (3 / 4, 4 / 3)
MIN_CORRELATION = 0.6  # of horizontal accelerations after a turn or mirror, from which they are the same motion's
INERTIA_ROUNDING = 1e-3  # share by which rounded moments may break the triangle inequality
# the same of measured ones: each moment by a bifilar pendulum errs by some percent, and three of them enter (Jardin &
# Mueller, Journal of Aircraft 46(3), 2009)
INERTIA_ERROR = 0.1
AXIS_OF_RATE = {"p": "roll", "q": "pitch", "r": "yaw"}


class Contradiction(NamedTuple):
    """between  the two sources, as the messages name them; quantity, value, limit, unit  what exceeds what; text"""

    between: tuple[str, str]
    quantity: str
    value: float
    limit: float
    unit: str
    text: str


def to_plain(found: Sequence[Contradiction]) -> list[dict[str, Any]]:
    """For the metadata of a flight."""
    return [{**c._asdict(), "between": list(c.between)} for c in found]


def list_reasons(found: Sequence[Mapping[str, Any]]) -> list[str]:
    """The sentences of contradictions as `to_plain` makes them."""
    return [str(c["text"]) for c in found]


def first_reason(reasons: Sequence[str]) -> str:
    """The first of some reasons, and how many more a flight's page has."""
    more = f"; its page has {len(reasons) - 1} more reasons" if len(reasons) > 1 else ""
    return f"{reasons[0]}{more}"


def _contradict(one: str, other: str, how: str, advice: str) -> str:
    return f"{one} and {other} contradict each other: {how}; {advice}"


def check_rate_gains(gains: Mapping[str, tuple[float, float]], attitude: str) -> list[Contradiction]:
    """gains  {"p", "q", "r": bounds of the rate of the gyro over that of the attitude}; attitude  name of its source"""
    low, high = RATE_GAIN
    wrong = {axis: 0.5 * (a + b) for axis, (a, b) in gains.items() if b < low or a > high}
    if not wrong:
        return []
    axis, gain = max(wrong.items(), key=lambda item: abs(item[1] - 1.0))
    listed = ", ".join(f"{n} ({AXIS_OF_RATE[n]}) is {g:.2f} times that of the attitude" for n, g in wrong.items())
    limits = f"limits {low:.2f} to {high:.2f}"
    text = _contradict("gyro", attitude, f"{listed}, {limits}", "check sign, unit, order and axes of both")
    return [Contradiction(("gyro", attitude), f"gain of {axis}", gain, low if gain < low else high, "1", text)]


def check_axis_order(exchanged: Mapping[str, str], attitude: str) -> list[Contradiction]:
    """exchanged  {axis of the gyro: axis of the attitude that turns as it does}; attitude  name of its source"""
    if not exchanged:
        return []
    how = ", ".join(
        f"{one} of the gyro turns as {AXIS_OF_RATE[other]} of the attitude" for one, other in exchanged.items()
    )
    text = _contradict("gyro", attitude, how, "check the order of the axes of both")
    return [Contradiction(("gyro", attitude), "order of axes", float(len(exchanged)), 0.0, "1", text)]


def check_directions(forces: Any, attitude: str, position: str) -> list[Contradiction]:
    """Axes of accelerometer, attitude and a position that are reversed, mirrored, turned or those of another frame.

    forces  `contradictions.ForceComparison`; attitude, position  names of their sources
    """
    aligned, best = forces.horizontal
    vertical, tilt = forces.vertical, forces.tilt
    wrong = [axis for axis, bounds in forces.gains.items() if bounds[1] < 0.0]
    other, unit, remedy = position, "1", "check the axes of the position, z-up or NED"
    if vertical is not None and vertical[1] < 0.0:
        what, value, limit = "direction", vertical[1], 0.0
        how = "it accelerates down where it should accelerate up"
    elif best > MIN_CORRELATION and aligned < 0.5 * best:
        what, value, limit = "direction", aligned, 0.0 if aligned < 0.0 else 0.5 * best
        how = "its horizontal axes are turned or mirrored, as by x and y exchanged or one reversed"
    elif tilt is not None and tilt > AXES_ANGLE:
        what, value, limit, unit = "vertical", tilt, AXES_ANGLE, "rad"
        how = f"its vertical is turned by {np.degrees(tilt):.0f} deg against gravity's, as by y-up taken for z-up"
    elif wrong:
        what, value, limit, other = "sign", forces.gains[wrong[0]][1], 0.0, attitude
        how = f"{', '.join(wrong)} has the opposite sign of what gravity and the motion need"
        remedy = "check signs and axes of both"
    elif forces.exchanged:
        what, value, limit, other = "order of axes", float(len(forces.exchanged)), 0.0, attitude
        pairs = ", ".join(f"its {one} goes with {needed}" for one, needed in forces.exchanged.items())
        how = f"{pairs} of what gravity and the motion need"
        remedy = "check the order of the axes of both"
    elif forces.misread:
        what, value, limit, other = "frame", 1.0, 0.0, attitude
        stands, stated = ("earth's", "body's") if forces.misread == "world" else ("body's", "earth's")
        how = f"its values fit the motion in the {stands} axes, and are read as in the {stated}"
        remedy = "correct the frame of the accelerometer's columns"
    else:
        return []
    text = _contradict("accelerometer", other, how, remedy)
    return [Contradiction(("accelerometer", other), what, float(value), float(limit), unit, text)]


def check_length_ratio(ratio: float | None, position: str) -> list[Contradiction]:
    """ratio  of the accelerations of a position over those that the accelerometer measures, None where unknown"""
    low, high = LENGTH_RATIO
    if ratio is None or low < ratio < high:
        return []
    what = position.rpartition(" ")[2]
    how = f"the {what} accelerates {ratio:.2f} times as much as is measured, limits {low:.2f} to {high:.2f}"
    text = _contradict("accelerometer", position, how, "check the length unit and the accelerometer's scale")
    limit = low if ratio <= low else high
    return [Contradiction(("accelerometer", position), "acceleration ratio", ratio, limit, "1", text)]


def check_length_bounds(bounds: tuple[float, float] | None, position: str) -> list[Contradiction]:
    """bounds  of the accelerations that the accelerometer measures over those of a position, None where unknown"""
    low, high = LENGTH_RATIO
    if bounds is None or bounds[0] <= 0.0 or (bounds[0] * low < 1.0 and bounds[1] * high > 1.0):
        return []
    return check_length_ratio(2.0 / sum(bounds), position)


def check_delay(delay: tuple[str, float] | None, position: str) -> list[Contradiction]:
    """delay  ("path" or "accelerometer", s by which it is late) as `path_errors.find_delay` has it, None for none"""
    if delay is None:
        return []
    late = position.rpartition(" ")[2] if delay[0] == "path" else "accelerometer"
    how = f"the {late} is {abs(delay[1]):.2f} s {'late' if delay[1] > 0.0 else 'early'}"
    text = _contradict("accelerometer", position, how, "check the time stamps of both")
    return [Contradiction(("accelerometer", position), f"delay of the {late}", delay[1], 0.0, "s", text)]


def check_velocity_axes(in_body: bool, velocity: str) -> list[Contradiction]:
    """in_body  whether a velocity that is stated in the earth's axes fits the accelerometer in the body's"""
    if not in_body:
        return []
    how = "its values fit the accelerometer in the body's axes, and are read as in the earth's"
    text = _contradict("accelerometer", velocity, how, "correct the frame of the velocity's columns")
    return [Contradiction(("accelerometer", velocity), "frame", 1.0, 0.0, "1", text)]


def check_residual(residual: np.ndarray | None, attitude: str | None, position: str) -> list[Contradiction]:
    """residual  (3,) m/s2, body FRD, that the accelerometer measures beyond what attitude and motion need, or None

    attitude  name of its source, None where it was estimated from the accelerometer; position  that of the motion
    """
    if residual is None:
        return []
    across, along = float(np.hypot(*residual[:2])), abs(float(residual[2]))
    if attitude is None:
        across = 0.0  # an attitude that was levelled by the accelerometer agrees with it
    size = float(np.hypot(across, along))
    if size <= ACCELEROMETER_BIAS:
        return []
    other = attitude if attitude is not None and across > along else position
    how = (
        f"it measures ({', '.join(f'{v:+.1f}' for v in residual)}) m/s2 more than gravity and the motion need, limit "
        f"{ACCELEROMETER_BIAS:.1f}"
    )
    if other == attitude:
        how += f", as if one were tilted by {np.degrees(np.arctan2(across, GRAVITY)):.0f} deg"
    text = _contradict("accelerometer", other, how, "check axes, unit, offset and time stamps of both")
    return [Contradiction(("accelerometer", other), "specific force", size, ACCELEROMETER_BIAS, "m/s2", text)]


def check_biases(value: np.ndarray, std: np.ndarray, sources: Mapping[str, str]) -> list[Contradiction]:
    """value, std  (6,) biases of p q r (rad/s) and ax ay az (m/s2) with standard errors; sources  names by kind"""
    found = []
    against = {
        "gyro": sources.get("attitude") or sources.get("position") or "accelerometer",
        "accelerometer": sources.get("position") or sources.get("velocity") or sources.get("attitude") or "gravity",
    }
    for sensor, part, limit, unit, names in (
        ("gyro", slice(0, 3), GYRO_BIAS, "rad/s", "pqr"),
        ("accelerometer", slice(3, 6), ACCELEROMETER_BIAS, "m/s2", ("ax", "ay", "az")),
    ):
        bias, error = np.asarray(value[part], float), np.nan_to_num(np.asarray(std[part], float))
        over = (np.abs(bias) > limit) & (np.abs(bias) > MIN_BIAS_SIGMAS * error)
        if not over.any():
            continue
        listed = ", ".join(f"{n} {b:+.2g}" for n, b, o in zip(names, bias, over) if o)
        how = f"they agree only with a bias of {listed} {unit} of the {sensor}, limit {limit:.2g} {unit}"
        text = _contradict(sensor, against[sensor], how, "check axes, units and time stamps of both")
        largest = float(np.max(np.abs(bias[over])))
        found.append(Contradiction((sensor, against[sensor]), f"bias of the {sensor}", largest, limit, unit, text))
    return found


def check_angle(angle: float | None, limit: float, quantity: str, attitude: str) -> list[Contradiction]:
    """angle  rad between the accelerometer's and the attitude's vertical or axes, None where unknown"""
    if angle is None or angle <= limit:
        return []
    how = f"{quantity} is {np.degrees(angle):.1f} deg, limit {np.degrees(limit):.1f} deg"
    text = _contradict("accelerometer", attitude, how, "check the axes of both, or align the rigid body again")
    return [Contradiction(("accelerometer", attitude), quantity, float(angle), float(limit), "rad", text)]


def check_innovations(nis: Mapping[str, Mapping[str, Any]], sources: Mapping[str, str]) -> list[Contradiction]:
    """nis  {kind of measurement: "mean" normalised innovation squared per degree of freedom}; sources  names by kind"""
    found = []
    for kind, entry in nis.items():
        mean = entry.get("mean")
        if mean is None or not mean > MAX_NIS or kind not in sources:
            continue
        other = "gyro" if kind == "attitude" else "accelerometer"
        how = (
            f"the filter predicts the {kind} wrong by {np.sqrt(mean):.0f} standard errors on average (mean normalised "
            f"innovation squared {mean:.3g}, limit {MAX_NIS:g})"
        )
        text = _contradict(other, sources[kind], how, "check axes, units and time stamps of both")
        found.append(Contradiction((other, sources[kind]), f"innovations of {kind}", mean, MAX_NIS, "1", text))
    return found


def describe_impossible_inertia(inertia: np.ndarray, beyond_errors: bool = False) -> str | None:
    """End of a sentence where no body has such an inertia (3, 3), kg m2, positive definite; else None.

    beyond_errors  only where no measurement errs that much. A flat vehicle comes near the limit, and moments that were
                   measured or published one by one often lie a little beyond it
    Each principal moment is at most the sum of the others: Goldstein, Classical Mechanics, 3rd ed., section 5.4.
    """
    principal = np.linalg.eigvalsh(0.5 * (np.asarray(inertia, float) + np.asarray(inertia, float).T))
    excess = principal[2] / (principal[0] + principal[1]) - 1.0
    if excess <= (INERTIA_ERROR if beyond_errors else INERTIA_ROUNDING):
        return None
    moments = f"'moment of inertia' has principal moments of {', '.join(f'{m:.3g}' for m in principal)} kg m2, of which"
    if excess <= INERTIA_ERROR:
        return (
            f"{moments} the greatest exceeds the sum of the others by {100 * excess:.1f} %, as that of no body does; "
            "measurements err by as much, so it is taken as it is"
        )
    return f"{moments} the greatest exceeds the sum of the others, which is impossible; measure it again"


def name_sources(metadata: Mapping[str, Any]) -> dict[str, str]:
    """{"attitude", "position", "velocity": name of its source in messages} of what an import measured"""
    names = {}
    for kind in ("attitude", "position", "velocity"):
        source = str(metadata.get(f"{kind} source") or "none")
        if source.startswith("capture"):
            names[kind] = f"captured {kind if kind == 'attitude' else 'position'}"
        elif source == "onboard":
            names[kind] = f"on-board {kind}"
    return names


UNMEASURED = ("none", "standing still")  # sources of velocity or position that measure nothing in flight


def find_silent_rotors(columns: Any) -> list[int]:
    """Rotors without a command from which their speed could be estimated; [] where all four have one of a kind.

    columns  anything that `in` works on
    """
    kinds = [[i for i in range(1, 5) if form.format(i) not in columns] for form in ("command{}", "w{}_CMD")]
    return min(kinds, key=len)


def find_missing_sources(frame: Any, metadata: Mapping[str, Any]) -> list[str]:
    """Why a flight without some source is unusable for identification, however good the rest is.

    frame  columns of the flight (anything that `in` works on); metadata  of the import
    """
    lacking = [str(i) for i in range(1, 5) if f"w{i}" not in frame]
    found = []
    if metadata.get("position source") == "none" and metadata.get("velocity source") == "none":
        found.append("unusable for identification: neither position nor velocity")
    silent = find_silent_rotors(frame)
    if lacking and silent:
        of = f" of {', '.join(lacking)}" if len(lacking) < 4 else ""
        commands = "" if len(silent) == 4 else f", and no command of rotor {', '.join(map(str, silent))}"
        found.append(f"unusable for identification: no rotor speeds{of}{commands}")
    if not found:
        return []
    shown = {
        "body rates": "p", "specific force": "ax", "attitude": "roll", "path": "x", "velocity": "u",
        "rotor speeds": "w1", "motor commands": "command1", "battery voltage": "battery_voltage",
    }  # fmt: skip
    offered = ", ".join(name for name, column in shown.items() if column in frame)
    return [*found, f"its page still shows {offered}"]


def check_measured_motion(metadata: Mapping[str, Any]) -> tuple[bool, bool]:
    """Whether a source other than the accelerometer measured a filtered flight's velocity, and its position.

    metadata  of the filtered flight; a source that it does not name counts as measured
    """
    used = (metadata.get("noise") or {}).get("measurements")
    if used is None:  # the Kalman filter was not run: states are those imported, and what was not imported is zero
        imported = metadata.get("imported") or {}
        return imported.get("velocity source") not in UNMEASURED, imported.get("position source") not in UNMEASURED
    speed, place = (used.get(kind, {}).get("source", "none") not in UNMEASURED for kind in ("velocity", "position"))
    return speed or place, place


# usual full scales of inertial sensors, rad/s and m/s2
FULL_SCALES = {
    "gyro": tuple(float(x) for x in np.radians([125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0])),
    "accelerometer": tuple(GRAVITY * x for x in (2.0, 4.0, 8.0, 16.0, 24.0, 32.0)),
}
MIN_CLIPPED_LEVEL = {"gyro": 1.0, "accelerometer": 12.0}  # half of the smallest full scale, and more than in hover
MAX_LEVEL_ERROR = 0.01  # of a full scale; bias and alignment change the clipping level
MAX_CREEP = 0.005  # of a full scale; on-board filters let a clipped signal approach it slowly
LEVEL_TOLERANCE = 1e-6  # of the extreme, for an unknown full scale
MIN_FLAT_SAMPLES, MIN_TOTAL_SAMPLES = 3, 6  # samples of one flat top, and of all flat tops of a level
# fall of a clipped signal next to a flat top: steps of the log, and share of the extreme
MIN_FALL_STEPS, MIN_FALL_SHARE = 6.0, 0.01
MIN_FALL_WIDTHS = 8.0  # times the width of the top band; a smooth peak falls by 4 widths
MIN_HOLD_RATIO = 3.0  # hold of the top over the usual hold of the signal
# for tops shortened by noise: separate visits of the extreme, and its samples over those of neighbouring values
# (2.4 at the top of a smooth peak)
MIN_VISITS, MIN_PILE_RATIO = 6, 5.0
NEIGHBOUR_WIDTH = 0.002  # of the extreme, for an unknown step of the log: width of the neighbouring values


class Clipped(NamedTuple):
    """One end of one channel: its level (signed, SI), the full scale it belongs to or None, and where (N,) bool."""

    level: float
    full_scale: float | None
    where: np.ndarray


def runs_of(mask: np.ndarray) -> np.ndarray:
    """First and one-past-last index (k, 2) of each run of True in mask (N,)."""
    return np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask, np.int8), [0]]))).reshape(-1, 2)


def _measure_fall(signal: np.ndarray, first: np.ndarray, last: np.ndarray, top: float) -> np.ndarray:
    """Measure the fall of a signal half a run's length before and after each run [first, last): the smaller one."""
    margin = np.maximum(2, (last - first) // 2)
    before, after = first - margin, last - 1 + margin
    left = np.where(before >= 0, top - signal[np.maximum(before, 0)], np.inf)
    right = np.where(after < len(signal), top - signal[np.minimum(after, len(signal) - 1)], np.inf)
    fall = np.minimum(left, right)
    return np.where(np.isfinite(fall), fall, -np.inf)  # a record that is flat throughout has no fall


def _find_usual_hold(signal: np.ndarray, top: float, at_top: np.ndarray) -> float:
    """Find the usual hold of a value, in samples, where the signal is large but not at its top."""
    large = (np.abs(signal) > 0.3 * top) & ~at_top
    changes = np.count_nonzero(large[1:] & (np.diff(signal) != 0.0))
    return np.count_nonzero(large) / changes if changes else 1.0


def _is_piled(signal: np.ndarray, top: float, at_top: np.ndarray, step: float, within: float) -> bool:
    """Whether the extreme, a band of width `within`, has far more samples than its neighbours, on many visits.

    The neighbours' band is as wide as that of the extreme at least: else a wide one would have none.
    """
    near = (signal >= top - within - max(1.5 * (step or NEIGHBOUR_WIDTH * top), within)) & ~at_top
    return len(runs_of(at_top)) >= MIN_VISITS and int(at_top.sum()) > MIN_PILE_RATIO * int(near.sum())


def find_clipping(values: np.ndarray, sensor: str, step: float = 0.0) -> list[Clipped]:
    """Find the ends at which one channel is clipped: none, one or both.

    values  (N,) rad/s or m/s2, finite, evenly sampled; sensor  "gyro" or "accelerometer"; step  of the log's numbers,
    in the same unit, 0 where it is not known
    A flat top that no step explains counts where it recurs or lasts, one near a full scale from MIN_FLAT_SAMPLES
    samples on; peaks below MIN_CLIPPED_LEVEL are ignored, because no sensor has such a small range.
    """
    found: list[Clipped] = []
    values = np.asarray(values, float)
    for sign in (1.0, -1.0):
        signal = sign * values
        top = float(signal.max()) if len(signal) else 0.0
        if top < MIN_CLIPPED_LEVEL[sensor]:
            continue
        full = next((r for r in FULL_SCALES[sensor] if abs(top - r) <= MAX_LEVEL_ERROR * r), None)
        within = MAX_CREEP * full if full is not None else LEVEL_TOLERANCE * top
        at_top = signal >= top - within
        first, last = runs_of(at_top).T
        long = last - first >= max(MIN_FLAT_SAMPLES, MIN_HOLD_RATIO * _find_usual_hold(signal, top, at_top))
        first, last = first[long], last[long]
        steep = _measure_fall(signal, first, last, top) > max(
            MIN_FALL_STEPS * step, MIN_FALL_SHARE * top, MIN_FALL_WIDTHS * within
        )
        together = int(np.sum((last - first)[steep]))
        if together >= (MIN_TOTAL_SAMPLES if full is None else MIN_FLAT_SAMPLES) or _is_piled(
            signal, top, at_top, step, within
        ):
            found.append(Clipped(sign * top, full, at_top))
    return found
