"""Stated units and axes against what the numbers do: lengths that are no metres, an accelerometer that feels no g."""

import re
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from quasi.attitude import GRAVITY, body_rates, continuous, interpolate, rotate, rotate_inverse
from quasi.errors import DataError
from quasi.importing.clocks.clock_fit import uniform
from quasi.importing.clocks.synchronisation import Motion
from quasi.importing.series import interpolate_columns
from quasi.sensor_limits import AXES_ANGLE

COMPARED_RATE, COMPARED_BAND = 100.0, 3.0  # Hz
LEAST_TURNING = 0.1  # rad/s, rms body rate below which an attitude is not judged
LEAST_SPEED = 0.3  # m/s, rms velocity below which a position is not judged
FASTEST_ROTOR, FULLEST, HIGHEST_VOLTAGE = 8000.0, 1.5, 100.0  # rad/s, share, V: beyond what flies indoors and out
# times, between gyro and attitude: beyond sensors' scales; beyond any slip but units
WRONG_RATES, REFUSED_RATES = (3.0, 30.0)
LEAST_CORRELATION = 0.6  # correlation from which body rates are those of an attitude but for a factor
MAX_ERROR_LEFT = 0.25  # of the error's variance that another reading may leave: half of its size
STRETCH = 5.0  # s, of which each is asked by itself: one reset of an estimate is no wrong unit
LEAST_MOTION = 0.2  # m/s2, rms acceleration below which nothing is judged


def length_ratio(onboard: Motion, t: np.ndarray, position: np.ndarray) -> float | None:
    """How much a captured position accelerates over what the accelerometer feels; 1 where units agree.

    onboard  needs specific_force and quaternion; t (n,) s on its clock, position (n, 3) m earth NED, NaN where unseen
    None where the flight hardly moves or shares less than two seconds.
    """
    if onboard.quaternion is None:
        return None
    sensed = rotate(onboard.quaternion, onboard.specific_force) + np.array([0.0, 0.0, GRAVITY])
    felt = uniform(onboard.t, sensed, COMPARED_RATE, COMPARED_BAND)
    moved = _slow_acceleration(t, position)
    if felt is None or moved is None:
        return None
    at, acceleration, good = moved
    good = good & (at > felt.t[0] + 1.0) & (at < felt.t[-1] - 1.0)
    if np.count_nonzero(good) < 2 * COMPARED_RATE:
        return None
    there = interpolate_columns(at[good], felt.t, felt.values)
    needed = float(np.sqrt(np.mean((there - there.mean(axis=0)) ** 2) * 3))
    if needed < LEAST_MOTION:
        return None
    here = acceleration[good]
    return float(np.sqrt(np.mean((here - here.mean(axis=0)) ** 2) * 3)) / needed


def _slow_acceleration(
    t: np.ndarray, values: np.ndarray, derivatives: int = 2
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Times (k,), s, acceleration (k, 3), m/s2, of a position (or of a velocity: `derivatives` 1) at low frequency, and
    where it is known (k,)."""
    seen = uniform(t, values, COMPARED_RATE, COMPARED_BAND)
    if seen is None:
        return None
    acceleration = seen.values
    for _ in range(derivatives):
        acceleration = np.gradient(acceleration, seen.step, axis=0)
    inner = slice(edge := int(COMPARED_RATE / COMPARED_BAND), -edge)  # the filter's own ends are no motion
    return seen.t[inner], acceleration[inner], seen.good[inner]


def refuse_wrong_lengths(onboard: Motion, t: np.ndarray, position: np.ndarray, unit: str, where: str) -> None:
    """Raise DataError where captured lengths contradict the accelerometer by thirty times or more.

    Arguments as `length_ratio`; unit  what the capture states.
    """
    ratio = length_ratio(onboard, t, position)
    if ratio is None or 0.03 < ratio < 30.0:
        return
    raise DataError(
        f"{where}: the captured position accelerates {ratio:.2g} times as much as the accelerometer feels, so lengths "
        f"that are stated in {unit} are in another unit; correct 'Length Units' in the export, or export it anew"
    )


def rates_explained(t: np.ndarray, rates: np.ndarray, t_reference: np.ndarray, attitude: np.ndarray) -> float | None:
    """Share of the body rates' variance that an attitude explains; 1 where they agree, below 0 where it misleads.

    t (n,) s with rates (n, 3) rad/s; t_reference (m,) s, same clock, with attitude (m, 4) body to earth, NaN for none
    None where the flight hardly turns or shares less than two seconds.
    """
    turned = _rates_of(t_reference, attitude)
    return None if turned is None else _explained(t, rates, *turned, LEAST_TURNING)


def _rates_of(t: np.ndarray, attitude: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Times (k,), s, and body rates (k, 3) of an attitude (n, 4) where it is known; None for fewer than 8 samples."""
    fine = np.isfinite(attitude).all(axis=1)
    if np.count_nonzero(fine) < 8:
        return None
    return t[fine], body_rates(continuous(attitude[fine]), t[fine])


def exchanged_axes(t: np.ndarray, rates: np.ndarray, t_attitude: np.ndarray, attitude: np.ndarray) -> dict[str, str]:
    """{axis of the gyro: axis of the attitude that turns as it does} of "p", "q", "r", where that is another one.

    Arguments as `rates_explained`. By correlation over the whole flight: above LEAST_CORRELATION with the other axis,
    and with its own less than half of that.
    """
    turned = _rates_of(t_attitude, attitude)
    if turned is None:
        return {}
    pairs = list(_stretches(t, rates, *turned))
    if not pairs:
        return {}
    gyro, own = (np.concatenate([p[k] - p[k].mean(axis=0) for p in pairs]) for k in (0, 1))
    return _exchanged(gyro, own, LEAST_TURNING, ("p", "q", "r"))


def _exchanged(one: np.ndarray, other: np.ndarray, least: float, names: tuple[str, str, str]) -> dict[str, str]:
    """{column of `one` (n, 3): that of `other` (n, 3) which goes with it}, where it is another one; without means.

    least  spread below which columns are not judged; correlations as `exchanged_axes` has them
    An axis that is at rest goes with another one as soon as it is turned a little towards that. A turn by an angle
    makes the sine of it, and of an exchange at least that of AXES_ANGLE, next to the scale of both.
    """
    power, own = np.mean(one**2, axis=0), np.mean(other**2, axis=0)
    sizes = np.sqrt(np.outer(power, own))
    alike = np.abs(one.T @ other / len(one)) / np.where(sizes > 0, sizes, np.inf)
    best = np.argmax(np.where(sizes >= least**2, alike, 0.0), axis=1)
    least_power = np.sin(AXES_ANGLE) ** 2 * power.sum() / max(own.sum(), 1e-300) * own  # (3,) of the other's columns
    return {
        names[k]: names[j]
        for k, j in enumerate(best)
        if j != k and alike[k, j] > LEAST_CORRELATION and alike[k, k] < 0.5 * alike[k, j] and power[k] > least_power[j]
    }


def rate_gains(
    t: np.ndarray, rates: np.ndarray, t_attitude: np.ndarray, attitude: np.ndarray
) -> dict[str, tuple[float, float]]:
    """{"p", "q", "r": bounds of the gyro's rate over that of an attitude}, of the axes that turn; 1 where both agree.

    Arguments as `rates_explained`. Both are noisy, so the gain lies between the slopes of the two regressions, of one
    on the other and the reverse. Axes whose rates correlate by less than LEAST_CORRELATION are left out. Medians over
    stretches, for an estimate may be reset once. Source: Frisch, Statistical Confluence Analysis, 1934 (errors in both
    variables).
    """
    turned = _rates_of(t_attitude, attitude)
    if turned is None:
        return {}
    pairs = [(a - a.mean(axis=0), b - b.mean(axis=0)) for a, b in _stretches(t, rates, *turned)]
    if not pairs:
        return {}
    gyro, own = (np.array([np.mean(p[k] ** 2, axis=0) for p in pairs]) for k in (0, 1))
    both = np.array([np.mean(a * b, axis=0) for a, b in pairs])
    gains = {}
    for k, name in enumerate("pqr"):
        alike = (gyro[:, k] >= LEAST_TURNING**2) & (
            np.abs(both[:, k]) > LEAST_CORRELATION * np.sqrt(gyro[:, k] * own[:, k])
        )
        if alike.any():
            slopes = np.median(both[alike, k] / own[alike, k]), np.median(gyro[alike, k] / both[alike, k])
            gains[name] = (float(min(slopes)), float(max(slopes)))
    return gains


class ForceComparison(NamedTuple):
    """Accelerometer against gravity and a captured motion, at low frequency.

    residual    (3,) m/s2, body FRD, that the accelerometer measures beyond what gravity and motion need; median
    gains       {"ax", "ay", "az": bounds of measured over needed specific force}, of the axes that correlate
    vertical    bounds of the measured over the captured vertical acceleration, None where they do not correlate
    lengths     the same of the whole acceleration
    horizontal  correlation of the horizontal accelerations as they are (after the best turn where headings may differ),
                and after the best turn or mirror
    exchanged   {axis of the accelerometer: axis of the needed specific force that goes with it}, where another one
    tilt        rad, of the vertical by the turn or mirror that brings the path's accelerations nearest to the measured
                ones; None where these do not go together along two directions
    misread     "world" where the accelerometer's values fit the motion as they stand, in the earth's axes; "body" where
                they do once they are turned back, for they stood in the body's; else None
    """

    residual: np.ndarray
    gains: dict[str, tuple[float, float]]
    vertical: tuple[float, float] | None
    lengths: tuple[float, float] | None
    horizontal: tuple[float, float]
    exchanged: dict[str, str]
    tilt: float | None
    misread: str | None


class SharedMotion(NamedTuple):
    """A path, an attitude and an accelerometer at the same times, at COMPARED_RATE and low frequency.

    acceleration  (k, 3) of the path, m/s2 earth NED; attitude (k, 4); force  (k, 3) measured, m/s2 body FRD;
    good (k,) bool  where all of them are known
    """

    acceleration: np.ndarray
    attitude: np.ndarray
    force: np.ndarray
    good: np.ndarray


def align_forces(
    onboard: Motion, t: np.ndarray, path: np.ndarray, t_attitude: np.ndarray, attitude: np.ndarray, derivatives: int
) -> SharedMotion | None:
    """The three on one grid; None where they share less than two seconds. Arguments as `compare_forces`."""
    fine = np.isfinite(attitude).all(axis=1)
    felt = uniform(onboard.t, onboard.specific_force, COMPARED_RATE, COMPARED_BAND)
    moved = _slow_acceleration(t, path, derivatives)
    if felt is None or moved is None or np.count_nonzero(fine) < 8:
        return None
    at, acceleration, good = moved
    q_t = t_attitude[fine]
    good = good & (at > max(felt.t[0], q_t[0]) + 1.0) & (at < min(felt.t[-1], q_t[-1]) - 1.0)
    if np.count_nonzero(good) < 2 * COMPARED_RATE:
        return None
    q = interpolate(attitude[fine], q_t, at)
    return SharedMotion(acceleration, q, interpolate_columns(at, felt.t, felt.values), good)


def compare_forces(
    onboard: Motion,
    t: np.ndarray,
    position: np.ndarray,
    t_attitude: np.ndarray,
    attitude: np.ndarray,
    free_heading: bool,
    derivatives: int = 2,
) -> ForceComparison | None:
    """What the accelerometer measures against what attitude and a position, or velocity, need.

    onboard  needs specific_force; t (n,) s with position (n, 3) m earth NED, or with velocity in m/s and derivatives 1;
    t_attitude (m,) s with attitude (m, 4) body to earth; all times on the on-board clock, NaN where missing;
    free_heading  whether the attitude's heading may differ from the position's axes. None where they share less than
    two seconds.
    """
    shared = align_forces(onboard, t, position, t_attitude, attitude, derivatives)
    if shared is None:
        return None
    gravity = np.array([0.0, 0.0, GRAVITY])
    acceleration, q, there = (v[shared.good] for v in (shared.acceleration, shared.attitude, shared.force))
    needed = rotate_inverse(q, acceleration - gravity)
    sensed = rotate(q, there) + gravity
    found = {n: _slopes(there[:, k], needed[:, k], LEAST_MOTION) for k, n in enumerate(("ax", "ay", "az"))}
    both = sensed - sensed.mean(axis=0), acceleration - acceleration.mean(axis=0)
    one, other = (v[:, 0] + 1j * v[:, 1] for v in both)
    size = float(np.linalg.norm(one) * np.linalg.norm(other)) or 1.0
    turned, mirrored = float(np.abs(np.vdot(other, one))) / size, float(np.abs(np.sum(other * one))) / size
    return ForceComparison(
        np.median(there - needed, axis=0),
        {n: bounds for n, bounds in found.items() if bounds is not None},
        _slopes(sensed[:, 2], acceleration[:, 2], LEAST_MOTION),
        _slopes(both[0].ravel(), both[1].ravel(), LEAST_MOTION),
        (turned if free_heading else float(np.vdot(other, one).real) / size, max(turned, mirrored)),
        _exchanged(there - there.mean(axis=0), needed - needed.mean(axis=0), LEAST_MOTION, ("ax", "ay", "az")),
        _tilt(*both),
        _misread(acceleration, sensed, {"world": there + gravity, "body": rotate(q, sensed - gravity) + gravity}),
    )


def _misread(needed: np.ndarray, sensed: np.ndarray, otherwise: Mapping[str, np.ndarray]) -> str | None:
    """The other reading (n, 3) that goes with the needed acceleration (n, 3) and leaves less than half of its error."""
    own = float(np.sum(np.var(sensed - needed, axis=0)))
    for name, reading in otherwise.items():
        a, b = reading - reading.mean(axis=0), needed - needed.mean(axis=0)
        moving = min(np.mean(np.sum(a * a, axis=1)), np.mean(np.sum(b * b, axis=1))) > LEAST_MOTION**2
        alike = np.sum(a * b) > LEAST_CORRELATION * np.sqrt(np.sum(a * a) * np.sum(b * b))
        if moving and alike and np.sum(np.var(reading - needed, axis=0)) < MAX_ERROR_LEFT * own:
            return name
    return None


def _tilt(one: np.ndarray, other: np.ndarray) -> float | None:
    """As `ForceComparison.tilt`, of accelerations (n, 3) without their means.

    Source: Kabsch, Acta Crystallographica A 32, 1976. Of a motion along two directions the third is theirs by the sign
    of the determinant.
    """
    u, common, vt = np.linalg.svd(one.T @ other)
    sizes = np.linalg.norm(one @ u, axis=0) * np.linalg.norm(other @ vt.T, axis=0)
    if np.any(sizes[:2] < len(one) * LEAST_MOTION**2) or np.any(common[:2] <= LEAST_CORRELATION * sizes[:2]):
        return None
    if sizes[2] < len(one) * LEAST_MOTION**2 or common[2] <= LEAST_CORRELATION * sizes[2]:
        vt[2] *= np.linalg.det(u) * np.linalg.det(vt)
    return float(np.arccos(np.clip((u @ vt)[2, 2], -1.0, 1.0)))


def _slopes(one: np.ndarray, other: np.ndarray, least: float) -> tuple[float, float] | None:
    """Bounds of the slope of `one` (n,) on `other` (n,), both noisy; None where a spread is below `least` or they do
    not correlate."""
    a, b = one - one.mean(), other - other.mean()
    power, own, both = float(np.mean(a * a)), float(np.mean(b * b)), float(np.mean(a * b))
    if min(power, own) < least**2 or abs(both) <= LEAST_CORRELATION * np.sqrt(power * own):
        return None
    slopes = both / own, power / both
    return min(slopes), max(slopes)


def velocity_explained(
    t: np.ndarray, velocity: np.ndarray, t_reference: np.ndarray, position: np.ndarray
) -> float | None:
    """Share of the velocity's variance that a position explains; as `rates_explained`.

    t (n,) s with velocity (n, 3) m/s; t_reference (m,) s, same clock, with position (m, 3) m; same axes, NaN for none
    None where the flight hardly moves or shares less than two seconds.
    """
    fine = np.isfinite(position).all(axis=1)
    if np.count_nonzero(fine) < 8:
        return None
    reference = np.gradient(position[fine], t_reference[fine], axis=0)
    return _explained(t, velocity, t_reference[fine], reference, LEAST_SPEED)


def refuse_wrong_rates(
    t: np.ndarray, rates: np.ndarray, t_reference: np.ndarray, attitude: np.ndarray, whose: str, where: str
) -> str | None:
    """A sentence where body rates go with those of an attitude but are several times as large or small; else None.

    Arguments as `rates_explained`; whose  attitude, for the message
    Raises DataError where they are as much off as degrees are from radians or beyond: no such flight is to be used.
    """
    turned = _rates_of(t_reference, attitude)
    if turned is None:
        return None
    ratios = []
    for there, here in _stretches(t, rates, *turned):
        power, own = np.sum(np.var(there, axis=0)), np.sum(np.var(here, axis=0))
        if max(power, own) < LEAST_TURNING**2 or min(power, own) == 0.0:
            continue
        along = np.sum(np.mean((there - there.mean(axis=0)) * (here - here.mean(axis=0)), axis=0))
        # what does not go together has another cause than a unit
        ratios.append(np.sqrt(power / own) if along / np.sqrt(power * own) > LEAST_CORRELATION else np.nan)
    if not ratios or np.mean(np.isfinite(ratios)) < 0.5:
        return None
    ratio = float(np.nanmedian(ratios))
    if 1.0 / WRONG_RATES < ratio < WRONG_RATES:
        return None
    message = f"{where}: body rates are {ratio:.3g} times those of {whose}"
    if 1.0 / REFUSED_RATES < ratio < REFUSED_RATES:
        return f"{message}; check the unit of the gyro, of the attitude and of time"
    if 40.0 < ratio < 80.0:
        message += ", as with deg/s taken for rad/s, or an attitude in rad taken for deg"
    elif 40.0 < 1.0 / ratio < 80.0:
        message += ", as with rad/s taken for deg/s"
    raise DataError(f"{message}; check the unit of the gyro, of the attitude and of time, and correct it")


def _explained(
    t: np.ndarray, felt: np.ndarray, t_reference: np.ndarray, reference: np.ndarray, least: float
) -> float | None:
    """Share of the variance of `felt` (n, 3) that `reference` (m, 3) explains at low frequency.

    The median of all stretches; None where none reaches `least` rms.
    """
    shares = []
    for there, here in _stretches(t, felt, t_reference, reference):
        moving = np.sum(np.var(there, axis=0))
        if np.sqrt(moving) >= least:
            shares.append(1.0 - np.sum(np.var(here - there, axis=0)) / moving)
    return float(np.median(shares)) if shares else None


def _stretches(
    t: np.ndarray, felt: np.ndarray, t_reference: np.ndarray, reference: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """`felt` (n, 3) and `reference` (m, 3) at low frequency and at the same times, stretch by stretch."""
    one, other = (
        uniform(t, felt, COMPARED_RATE, COMPARED_BAND),
        uniform(t_reference, reference, COMPARED_RATE, COMPARED_BAND),
    )
    if one is None or other is None:
        return
    at = other.t
    good = other.good & (at > t[0] + 1.0 / COMPARED_BAND) & (at < t[-1] - 1.0 / COMPARED_BAND)
    if np.count_nonzero(good) < 2 * COMPARED_RATE:
        return
    there = interpolate_columns(at[good], one.t, one.values)
    here, number = other.values[good], ((at[good] - at[good][0]) / STRETCH).astype(int)
    for rows in (number == k for k in np.unique(number)):
        if np.count_nonzero(rows) >= COMPARED_RATE:
            yield there[rows], here[rows]


def doubtful_units(rates: np.ndarray, force: np.ndarray) -> list[str]:
    """Ends of sentences about body rates (n, 3), rad/s, and specific force (m, 3), m/s2, body FRD, that no vehicle
    shows."""
    found = []
    fastest = float(np.nanmax(np.abs(rates), initial=0.0))
    if fastest > np.radians(4500):
        found.append(f"body rates reach {np.degrees(fastest):.0f} deg/s, beyond any gyro; check their unit")
    force = force[np.isfinite(force).all(axis=1)]
    felt = np.linalg.norm(force, axis=1)
    typical = float(np.median(felt)) / GRAVITY if len(felt) else 1.0
    if not 0.2 < typical < 5.0:
        found.append(f"the specific force is typically {typical:.3g} g, where a flight feels about 1; check its unit")
    elif len(felt) and np.quantile(force[:, 2], 0.1) > 0.5 * typical * GRAVITY:  # not only where it lies after a crash
        found.append(
            "the specific force points down as it does upside down, where at rest and in flight it points up with 1 g; "
            "check its sign and the body axes"
        )
    elif len(felt) and np.quantile(force[:, 2] + np.cos(AXES_ANGLE) * felt, 0.1) > 0.0:
        typically = np.median(force, axis=0)
        k = int(np.argmax(np.abs(typically[:2])))
        side = (("back", "front"), ("left", "right"))[k][int(typically[k] > 0.0)]
        angle = np.degrees(np.arctan2(np.hypot(*typically[:2]), -typically[2]))
        found.append(
            f"the specific force typically points {angle:.0f} deg away from up, to the {side}, where at rest and in "
            "flight it points up; check the body axes"
        )
    return found


def doubtful_values(values: Mapping[str, np.ndarray]) -> list[str]:
    """Ends of sentences about rotor speeds (rad/s), commands (shares) and battery voltage (V) that no vehicle has.

    values  {quantity: (n,)}, NaN where missing
    """
    found = []
    for kind, largest, meant in (
        (r"w[1-8](_CMD)?", FASTEST_ROTOR, "a rotor turns at {:.0f} rad/s at most"),
        (r"command[1-8]", FULLEST, "a command of 1 is full"),
        (r"battery_voltage", HIGHEST_VOLTAGE, "a battery has {:.0f} V at most"),
    ):
        for name in (n for n in values if re.fullmatch(kind, n)):
            # neither a spike nor a stop counts
            reached = float(np.nanquantile(values[name], 0.9)) if np.isfinite(values[name]).any() else 0.0
            if reached > largest:
                found.append(f"{name} reaches {reached:.4g}, where {meant.format(largest)}; check its unit")
                break
    return found
