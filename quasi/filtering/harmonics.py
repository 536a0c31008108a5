"""Notches at the harmonics of the rotors' speeds: the same zero-phase operator for everything a regression compares.

A line of known angle is turned down to zero frequency, low-passed forward and backward, turned back and subtracted:
x becomes x - 2 Re(E* w L w E x), with E the turning by the line's angle, w its weight and L the low-pass both ways.
The lines are gone through from the first to the last and back again, so that the whole is a symmetric operator: it has
no phase, also where the lines' frequencies move and cross. All this is done to what lies above the lowest frequency of
a notch, and what it takes out is confined to there, for a notch that sweeps would shake off sidebands of the motion,
which is a thousand times stronger. With a second-order Butterworth L the gain at a distance d from a line is
(x^4 / (1 + x^4))^2 with x = 2 (1 + sqrt 2)^(1/4) d / width, one half at d = width / 2.

Where a line stands in the log: sampling at a rate f_s shows a frequency f at its distance from the nearest multiple of
f_s, so that at 500 Hz a line of 350 Hz stands at 150 Hz.
Sources: Vold & Leuridan, High resolution order tracking at extreme slew rates, SAE 931288, 1993 (lines by their angle);
Oppenheim & Schafer, Discrete-Time Signal Processing, 3rd ed., 2010, sections 4.2 (folding) and 7.3 (Butterworth).
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.signal import butter, lfilter

from quasi.filtering import forces

# a log denser than this many times the grid was low-passed at its import, below half the grid's rate
DENSER = 4.0 / 3.0
RAMP = 0.25  # of the lowest frequency: over which a line that rises from below is faded in
RINGING = 3.0  # time constants after which a notch has forgotten
CLEAR = 3.0  # power of a line over that of its neighbourhood from which it is called seen
HALF = (1.0 + np.sqrt(2.0)) ** 0.25  # x where the gain is one half
LOOKED_FOR = 3  # harmonics looked for where no notch is asked for
# Hz, below which a folded line disturbs velocity; errors double below and are usual above twice it:
# benchmarks/consistency.py --nuisance 1
VELOCITY_BAND = 8.0


class Lines(NamedTuple):
    """Rotor lines over time, L of them: harmonic by harmonic, and rotor by rotor within.

    harmonic  (L,) int, from 1; true (N, L) Hz, of the rotor's motion; frequency (N, L) Hz, where it stands on
    the grid; weight (N, L) from 0 (left in) to 1 (taken out); width Hz, between the points of half gain; lowest Hz,
    below which nothing is touched; rate Hz
    """

    harmonic: np.ndarray
    true: np.ndarray
    frequency: np.ndarray
    weight: np.ndarray
    width: float
    lowest: float
    rate: float


def fold(frequency: np.ndarray, rate: float) -> np.ndarray:
    """Frequency at which samples taken at `rate` Hz show `frequency` (any shape, Hz): from 0 to half the rate."""
    frequency = np.asarray(frequency, float)
    return np.abs(frequency - rate * np.round(frequency / rate))


def on_grid(frequency: np.ndarray, log_rate: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Where a line (any shape, Hz) of a log stands on the grid, Hz, and whether the import has left it there."""
    logged = fold(frequency, log_rate)
    return fold(logged, rate), (logged <= 0.5 * rate) | (log_rate <= DENSER * rate)


def _fade(distance: np.ndarray, over: float) -> np.ndarray:
    """From 0 at distances <= 0 smoothly to 1 at `over`."""
    s = np.clip(distance / over, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


def lines(
    speeds: np.ndarray,
    flying: np.ndarray,
    harmonics: int,
    centre: str,
    width: float,
    lowest: float,
    log_rate: float,
    rate: float,
) -> Lines:
    """Where the rotors' harmonics stand on the grid.

    speeds    (N, R) rad/s, finite and smooth; flying (N,) bool; harmonics  from the first to this one
    centre    "measured speed": every line follows its rotor, or "median speed": it stays at its median in flight
    width     Hz, less than `lowest`, below which a line is left in; log_rate  Hz of the log; rate  Hz of the grid
    """
    turning = np.abs(np.asarray(speeds, float)) / (2.0 * np.pi)
    if centre == "median speed":
        part = flying if flying.any() else np.ones(len(turning), bool)
        turning = np.tile(np.median(turning[part], axis=0), (len(turning), 1))
    order, rotor = (
        a.ravel() for a in np.meshgrid(np.arange(harmonics) + 1, np.arange(turning.shape[1]), indexing="ij")
    )
    true = turning[:, rotor] * order
    frequency, there = on_grid(true, log_rate, rate)
    weight = _fade(frequency - lowest, RAMP * lowest)
    # nearer to half the rate a line and its mirror image fall into one notch
    weight *= _fade(0.5 * rate - frequency - width, width)
    weight[~there] = 0.0
    return Lines(order, true, frequency, weight, float(width), float(lowest), float(rate))


def near_zero(speeds: np.ndarray, log_rate: float, rate: float) -> np.ndarray:
    """Share (N,) of the strongest line's power that folding has moved among the motion: 1 at 0 Hz, 0 far above.

    A line that folds to nearly 0 Hz acts like an acceleration of the vehicle, and no filter can separate the two. The
    share is the power gain of a second-order Butterworth low-pass of VELOCITY_BAND; only lines above twice this band
    count, for a slower one is no folded line.

    speeds    (N, R) rad/s, finite; log_rate  Hz of the log; rate  Hz of the grid
    Source: Oppenheim & Schafer, Discrete-Time Signal Processing, 3rd ed., 2010, sections 4.2 and 7.3.
    """
    true = np.abs(speeds)[:, None, :] / (2.0 * np.pi) * (1.0 + np.arange(LOOKED_FOR))[:, None]
    stands, there = on_grid(true, log_rate, rate)
    share = np.where(there & (true > 2.0 * VELOCITY_BAND), 1.0 / (1.0 + (stands / VELOCITY_BAND) ** 4), 0.0)
    return share.max(axis=(1, 2))


def _low_pass(width: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
    return butter(2, 0.5 * width / HALF, fs=rate)


def _line(
    values: np.ndarray, frequency: np.ndarray, weight: np.ndarray, rate: float, b: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The line of one frequency (N,) in each column of values (N, m), as its two slow parts (2, N, m); and their
    carriers (2, N, 1), cosine and sine."""
    angle = np.concatenate([[0.0], np.cumsum(np.pi * (frequency[:-1] + frequency[1:]) / rate)])
    carriers = np.stack([np.cos(angle), np.sin(angle)])[:, :, None]
    ahead = lfilter(b, a, carriers * (weight[:, None] * values), axis=1)
    return lfilter(b, a, ahead[:, ::-1], axis=1)[:, ::-1], carriers


def high_pass(values: np.ndarray, lowest: float, rate: float) -> np.ndarray:
    """What of columns (N, m) lies above the lowest frequency of a notch, zero phase."""
    return values - forces.low_pass(values, lowest / (1.0 + 0.5 * forces.TRANSITION), rate)


def take_out(values: np.ndarray, found: Lines) -> np.ndarray:
    """Columns (N, m), finite, without the lines; the same operator for each column. Same shape.

    Within a time constant of the record's ends a line is taken out in part only; see `reach`.
    Raises DataError for a record shorter than the filter that sets motion apart.
    """
    values = np.asarray(values, float)
    b, a = _low_pass(found.width, found.rate)
    high = high_pass(values, found.lowest, found.rate)
    left = high.copy()
    there = range(len(found.harmonic))
    for i in (*there, *reversed(there)):
        weight = found.weight[:, i]
        if not weight.any():
            continue
        slow, carriers = _line(left, found.frequency[:, i], weight, found.rate, b, a)
        left -= 2.0 * weight[:, None] * (carriers * slow).sum(axis=0)
    return values - high_pass(high - left, found.lowest, found.rate)


def reach(found: Lines) -> int:
    """Samples on either side after which the notches have forgotten a knock, to some 5 %."""
    width, rate = found.width, found.rate
    return int(np.ceil(RINGING * HALF * np.sqrt(2.0) / (np.pi * width) * rate))


def clearness(high: np.ndarray, found: Lines, i: int, part: np.ndarray) -> float:
    """Power of line i in columns over what its neighbourhood would give there; about 1 where there is no line.

    high (N, m)  the columns after `high_pass`; part  (N,) bool, the rows that count, at least one. The neighbourhood
    is that of three widths, without the line's own. The greatest of the columns.
    """
    power = []
    for width in (found.width, 3.0 * found.width):
        line = (high, found.frequency[:, i], found.weight[:, i], found.rate, *_low_pass(width, found.rate))
        slow, _ = _line(*line)
        power.append(np.sum(slow**2, axis=0)[part].mean(axis=0))
    around = np.maximum((power[1] - power[0]) / 2.0, 1e-300)
    return float(np.max(power[0] / around))


def report(found: Lines, before: np.ndarray, after: np.ndarray, flying: np.ndarray) -> dict[str, Any]:
    """What the notches met, in flight: of each harmonic the frequency (median), where it stands on the grid, whether
    it folds and in what share its lines were taken out; and what was taken out in all, rms.

    before, after (N, 6) gyro and accelerometer without and with the notches; flying (N,) bool
    """
    part = flying if flying.any() else np.ones(len(flying), bool)
    entries: list[dict[str, Any]] = []
    for order in np.unique(found.harmonic):
        of = found.harmonic == order
        true, stands = found.true[part][:, of], found.frequency[part][:, of]
        entries.append(
            {
                "harmonic": int(order),
                "frequency": {"value": float(np.median(true)), "unit": "Hz"},
                "stands at": {"value": float(np.median(stands)), "unit": "Hz"},
                "folded share": float((true > stands + 1e-6).mean()),
                "taken out share": float((found.weight[part][:, of] > 0.5).mean()),
            }
        )
    taken = np.sqrt(np.mean((before - after)[part] ** 2, axis=0)).tolist()
    return {
        "width": {"value": found.width, "unit": "Hz"},
        "lines": entries,
        "taken out, rms": {
            "gyro": {"value": taken[:3], "unit": "rad/s"},
            "accelerometer": {"value": taken[3:], "unit": "m/s2"},
        },
    }
