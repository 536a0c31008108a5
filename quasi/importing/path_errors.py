"""A path logged on board that is late, or a velocity in other axes than stated: the readings that fit are compared."""

import numpy as np
from scipy.ndimage import minimum_filter1d

from quasi.attitude import GRAVITY, interpolate, rotate, rotate_inverse
from quasi.importing.artefacts import LARGEST_FLOWN_ACCELERATION, USUAL_SCATTERS, unflyable_steps
from quasi.importing.clocks.clock_fit import RESIDUAL_BLOCK
from quasi.importing.clocks.synchronisation import Motion
from quasi.importing.contradictions import (
    COMPARED_RATE,
    LEAST_CORRELATION,
    LEAST_MOTION,
    MAX_ERROR_LEFT,
    SharedMotion,
    align_forces,
)
from quasi.importing.series import Track, interpolate_columns
from quasi.sensor_limits import LENGTH_RATIO, MIN_BIAS_SIGMAS

SAME_CLOCK_LAG = 1.0  # s, the most that anything logged on board, a capture too, may be late
_G = np.array([0.0, 0.0, GRAVITY])


def find_delay(shared: SharedMotion | None) -> tuple[str, float] | None:
    """("path" or "accelerometer", s by which it is late, negative: early), None where both fit as they stand.

    A delay counts where the error as logged is beyond what the limits on lengths allow, and where a shift leaves less
    than half of it.
    """
    if shared is None:
        return None
    reach = round(SAME_CLOCK_LAG * COMPARED_RATE)
    rows = np.flatnonzero(minimum_filter1d(shared.good.astype(np.int8), 2 * reach + 1, mode="constant"))
    if len(rows) < 2 * COMPARED_RATE:
        return None
    sensed = rotate(shared.attitude, shared.force) + _G
    needed = rotate_inverse(shared.attitude, shared.acceleration - _G)
    steps, best = np.arange(-reach, reach + 1), None
    for name, fixed, moved in (("path", sensed, shared.acceleration), ("accelerometer", needed, shared.force)):
        here = fixed[rows] - fixed[rows].mean(axis=0)
        errors = np.array([np.sum(np.var(here - moved[rows + k], axis=0)) for k in steps])
        k, own, power = int(np.argmin(errors)), errors[reach], np.mean(np.sum(here * here, axis=1))
        if not 0 < k < 2 * reach or power < LEAST_MOTION**2 or own <= (LENGTH_RATIO[1] - 1.0) ** 2 * power:
            continue
        there = moved[rows + steps[k]] - moved[rows + steps[k]].mean(axis=0)
        alike = np.sum(here * there) > LEAST_CORRELATION * np.sqrt(np.sum(here * here) * np.sum(there * there))
        if alike and errors[k] < MAX_ERROR_LEFT * own and (best is None or errors[k] / own < best[0]):
            best = errors[k] / own, name, steps[k] / COMPARED_RATE
    return None if best is None else (best[1], float(best[2]))


def is_velocity_of_body(onboard: Motion, velocity: Track, t_attitude: np.ndarray, attitude: np.ndarray) -> bool:
    """Whether a velocity stated in the earth's axes fits the accelerometer better in the body's.

    onboard  needs specific_force; velocity  (n, 3) m/s; t_attitude (m,) s with attitude (m, 4), NaN where missing
    The errors of both readings differ by more than MIN_BIAS_SIGMAS standard errors, over blocks of RESIDUAL_BLOCK.
    """
    fine = np.isfinite(attitude).all(axis=1)
    if np.count_nonzero(fine) < 8:
        return False
    turned = rotate(interpolate(attitude[fine], t_attitude[fine], velocity.t), velocity.values)
    readings = [align_forces(onboard, velocity.t, v, t_attitude, attitude, 1) for v in (velocity.values, turned)]
    if any(reading is None for reading in readings):
        return False
    size = round(RESIDUAL_BLOCK * COMPARED_RATE)
    good = np.logical_and(*(reading.good for reading in readings))
    errors = []
    for reading in readings:
        error = rotate(reading.attitude, reading.force) + _G - reading.acceleration
        errors.append(np.sum((error - error[good].mean(axis=0)) ** 2, axis=1))
    gained = np.where(good, errors[0] - errors[1], np.nan)
    blocks = gained[: len(gained) // size * size].reshape(-1, size)
    means = blocks.mean(axis=1)
    means = means[np.isfinite(means)]
    return len(means) > 2 and means.mean() > MIN_BIAS_SIGMAS * means.std(ddof=1) / np.sqrt(len(means))


def find_jumps(place: Track, velocity: Track) -> list[tuple[float, float]]:
    """(time, s, size, m) of each jump of a position (n, 3), m, that its velocity (m, 3), m/s, does not share.

    A jump is a step that cannot be flown, after which the position keeps another distance from the integral of the
    velocity: beyond USUAL_SCATTERS times the usual change of that distance. A late sample is none.
    """
    fine, known = (np.isfinite(track.values).all(axis=1) for track in (place, velocity))
    t, x = place.t[fine], np.ascontiguousarray(place.values[fine])
    half = round(0.5 * RESIDUAL_BLOCK / float(np.median(np.diff(t)))) if len(t) > 1 else 0
    if half < 2 or len(t) < 4 * half or np.count_nonzero(known) < 2:
        return []
    speed = interpolate_columns(t, velocity.t[known], velocity.values[known])
    step = 0.5 * (speed[1:] + speed[:-1]) * np.diff(t)[:, None]
    away = x - np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    level = np.median(np.lib.stride_tricks.sliding_window_view(away, half, axis=0), axis=-1)
    change = np.linalg.norm(level[half:] - level[:-half], axis=1)  # between sample i + half and those before it
    unflyable, floor, _ = unflyable_steps(t, x, np.zeros((1, 4)), False)
    cut = np.flatnonzero(unflyable) + 1 - half
    cut = cut[(cut >= 0) & (cut < len(change))]
    flown = floor + 2.0 * LARGEST_FLOWN_ACCELERATION * float(np.median(np.diff(t))) ** 2
    jumps = cut[change[cut] > max(flown, USUAL_SCATTERS * 1.4826 * float(np.median(change)))]
    return [(float(t[i + half]), float(change[i])) for i in jumps]
