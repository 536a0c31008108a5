"""The one band of everything that a regression compares: rotor notches where asked for, then the low-pass filter.

Rotor speeds, commands, rates, accelerations and their derivatives go through the same linear zero-phase operator, so
that what holds between the signals holds between the filtered ones, delays and gains included.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from quasi.errors import ConfigError, add_caution
from quasi.filtering import forces, harmonics

KIND = "zero-phase, the same for rates, accelerations, rotor speeds and commands: a Kaiser-windowed sinc"
SELDOM = 0.05  # share of the flight below which a line in the wrong place is not worth a word


@dataclass(frozen=True)
class Band:
    """cutoff Hz of the low-pass, rate Hz of the grid, the lines to take out or None; metadata, plain."""

    cutoff: float
    rate: float
    lines: harmonics.Lines | None
    metadata: dict[str, Any]

    @property
    def reach(self) -> int:
        """Samples on either side that a filtered value depends on."""
        ringing = harmonics.reach(self.lines) if self.lines is not None else 0
        return forces.half_length(self.cutoff, self.rate) + ringing

    def without_lines(self, values: np.ndarray) -> np.ndarray:
        """Columns (N, m), finite, through the notches alone."""
        return values if self.lines is None else harmonics.take_out(values, self.lines)

    def both(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns (N, m), finite, in the band, and their time derivatives, per second."""
        clean = self.without_lines(values)
        return forces.low_pass(clean, self.cutoff, self.rate), forces.derivative(clean, self.cutoff, self.rate)

    def low_pass(self, values: np.ndarray) -> np.ndarray:
        """Columns (N, m), finite, in the band."""
        return forces.low_pass(self.without_lines(values), self.cutoff, self.rate)


def check(chosen: Mapping[str, Any]) -> None:
    """Raises ConfigError for options of the band that contradict each other, which the schema cannot say."""
    width, lowest = float(chosen["rotor notch width Hz"]), float(chosen["rotor notch lowest Hz"])
    if chosen["rotor notch harmonics"] and width >= lowest:
        raise ConfigError(
            f"'rotor notch width Hz' is {width:g} and 'rotor notch lowest Hz' {lowest:g}; the width must be less, or "
            "a notch reaches down to the motion itself"
        )


def choose(
    chosen: Mapping[str, Any],
    speeds: np.ndarray | None,
    imu: np.ndarray,
    flying: np.ndarray,
    log_rate: float | None,
    rate: float,
    notes: list[str],
) -> Band:
    """The band of one flight.

    speeds    (N, R) rad/s, finite, or None; imu (N, 6) gyro and accelerometer; flying (N,) bool
    log_rate  Hz of the gyro in the log, None where it is not known (then that of the grid counts); rate  Hz, grid
    notes     receives what was lowered, left in, or looks like a rotor's line inside the band
    Raises    ConfigError where no notch fits below half the grid's rate
    """
    logged = float(log_rate or rate)
    cutoff = _cutoff(float(chosen["low-pass cutoff Hz"]), logged, rate, notes)
    width, lowest = float(chosen["rotor notch width Hz"]), float(chosen["rotor notch lowest Hz"])
    wanted = int(chosen["rotor notch harmonics"])
    metadata: dict[str, Any] = {"kind": KIND, "low-pass cutoff Hz": cutoff, "rotor notches": None}
    if speeds is None or not speeds.any():
        if wanted:
            add_caution(notes, "'rotor notch harmonics' asks for notches, but no rotor speed is known: none were made")
        return Band(cutoff, rate, None, metadata)
    if not 0.5 * rate - 2.0 * width > lowest:
        if not wanted:  # nothing to look for on so slow a grid
            return Band(cutoff, rate, None, metadata)
        raise ConfigError(
            f"no notch of 'rotor notch width Hz' {width:g} fits between 'rotor notch lowest Hz' {lowest:g} and half "
            f"the grid's rate, {0.5 * rate:g} Hz; lower one of them"
        )
    smooth = forces.low_pass(speeds, cutoff, rate)
    count = wanted or harmonics.LOOKED_FOR
    found = harmonics.lines(smooth, flying, count, chosen["rotor notch centre"], width, lowest, logged, rate)
    if not wanted:
        _warn(found, imu, flying, cutoff, logged, notes)
        return Band(cutoff, rate, None, metadata)
    _left_in(found, flying, lowest, logged, notes)
    metadata["rotor notches"] = {
        "centre": chosen["rotor notch centre"],
        "lowest": {"value": lowest, "unit": "Hz"},
        "log rate": {"value": logged, "unit": "Hz"},
        **harmonics.report(found, imu, harmonics.take_out(imu, found), flying),
    }
    return Band(cutoff, rate, found, metadata)


def _cutoff(wanted: float, logged: float, rate: float, notes: list[str]) -> float:
    highest = forces.HIGHEST_CUTOFF * rate
    if f"{wanted:g}" != f"{min(wanted, highest):g}":  # else they differ by the grid's rounding
        notes.append(
            f"the low-pass cut-off of {wanted:g} Hz is too high for a grid of {rate:g} Hz; {highest:g} Hz is used"
        )
    wanted = min(wanted, highest)
    if wanted > 0.5 * logged:
        add_caution(
            notes,
            f"the low-pass cut-off of {wanted:g} Hz is beyond half the log's rate of {logged:.0f} Hz: nothing between "
            "was measured; log faster, or lower 'low-pass cutoff Hz'",
        )
    return wanted


def _left_in(found: harmonics.Lines, flying: np.ndarray, lowest: float, logged: float, notes: list[str]) -> None:
    """Say which harmonics stand below the lowest frequency of a notch in flight, as folded ones do."""
    low = (found.frequency < lowest) & (found.true > lowest)
    for order in np.unique(found.harmonic):
        share = float(low[flying][:, found.harmonic == order].mean()) if flying.any() else 0.0
        if share > SELDOM:
            add_caution(
                notes,
                f"harmonic {order} of the rotors folds below {lowest:g} Hz at the log's rate of {logged:.0f} Hz in "
                f"{100 * share:.3g} % of the flight, where motion is, and stays in; log at another rate",
            )


def _warn(
    found: harmonics.Lines, imu: np.ndarray, flying: np.ndarray, cutoff: float, logged: float, notes: list[str]
) -> None:
    """Say which harmonics show up inside the band of the low-pass, where no notch was asked for."""
    inside = (found.frequency < (1.0 + 0.5 * forces.TRANSITION) * cutoff) & (found.weight > 0.5) & flying[:, None]
    often = inside.sum(axis=0) > SELDOM * max(int(flying.sum()), 1)
    high = harmonics.high_pass(imu, found.lowest, found.rate) if often.any() else imu
    listed = []
    for order in np.unique(found.harmonic):
        seen = [
            int(i)
            for i in np.flatnonzero((found.harmonic == order) & often)
            if harmonics.clearness(high, found, int(i), inside[:, i]) > harmonics.CLEAR
        ]
        if seen:
            stands, true = (float(np.median(x[:, seen][inside[:, seen]])) for x in (found.frequency, found.true))
            folded = f", folded from {true:.0f} Hz" if true > stands + 1.0 else ""
            listed.append(f"harmonic {order} near {stands:.0f} Hz{folded}")
    if listed:
        add_caution(
            notes,
            f"vibration that moves with the rotors' speed ({'; '.join(listed)}; the log's rate is {logged:.0f} Hz) "
            f"passes the low-pass of {cutoff:g} Hz; lower 'low-pass cutoff Hz' or set 'rotor notch harmonics' to "
            f"{listed[-1].split(' ')[1]}",
        )
