"""How one flight's rotors follow their commands: constants, residuals and their slopes.

Speed follows the commanded one with a first-order lag of its own for speeding up and slowing down, late by one delay;
the commanded speed is a map of the command share and of the battery's voltage, or of a commanded speed itself. What is
wrong in the fit is linear in the slopes, so that flights can be compared on cross-products.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quasi.errors import DataError
from quasi.gap.flights.evidence import RATE
from quasi.gap.flights.level import Flown
from quasi.gap.levels.drive.prediction import EXPONENT, LAG, ExponentErrors, Prediction
from quasi.gap.statistics.whitening import thin
from quasi.identification.regression import bartlett
from quasi.importing.command_fit import RESIDUAL_MEMORY
from quasi.model.extensions import are_estimated, drive_of
from quasi.tables import TELEMETRY_AGE_REMOVED
from quasi.terms.rotor_map import COMMANDED, ROTOR_NUMBERS, SHARES, SPEEDS

DRIVE_BAND = 0.4 * RATE  # Hz, as import resamples
LEAST_DRIVE_NOISE = 0.1  # rad/s: no residual is known better
ODD_T = 4.0  # standard errors by which one rotor differs from the others
LEAST_SAG = 0.003  # natural log of the voltage: below this variation within a flight the exponent is not estimated
# parameters in order: time constants, delay, map, battery exponent, each rotor's speed relative to the common map,
# logarithm of each rotor's time constants over the geometric mean of the four, which the common ones are
CONSTANTS = ("up", "down", "delay", "a0", "a1", "a2", "exponent", *(f"rotor{i}" for i in ROTOR_NUMBERS),
             *(f"lag{i}" for i in ROTOR_NUMBERS))  # fmt: skip
SIZES = np.array([5e-4, 5e-4, 3e-4, 2.0, 20.0, 20.0, 0.02, *[0.002] * 4, *[0.02] * 4])
# prior standard deviations of a flight's constants about the start of the fit, where those without information stay
LOOSE = np.array([0.05, 0.05, 0.05, 300.0, 2000.0, 2000.0, 0.5, *[0.1] * 4, *[0.7] * 4])
# of the map of commanded speeds, rad/s, where that of shares has 1: as large a change, at some 2000 rad/s
MAP_UNITS = {"shares": {}, "speeds": {"a1": 5e-4, "a2": 5e-8}}


class Belief(NamedTuple):
    """Constants that a model or a group of flights holds: values (15,) by CONSTANTS, and the voltage that they hold at.

    aged  whether the age of the rotor telemetry was taken off the delay; None where it is unknown
    """

    values: np.ndarray
    voltage: float | None
    aged: bool | None = None


class DriveFit(NamedTuple):
    """One flight at its best constants.

    values (15,) by CONSTANTS; t (n,) s at `rate` Hz; residual (n, 4) rad/s, what of the error the
    errors before do not predict; slopes (n, 4, 15) of the predicted speed
    held (15,) rad2/s2 per unit squared: how strongly each value was held where the fit began; noise rad/s that weighed
    the residual against that
    plain (15,)  the constants by output error; exponent  how far off the battery's exponent is, which is of these
    """

    key: str
    values: np.ndarray
    t: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray
    volts_vary: bool
    held: np.ndarray
    noise: float
    rate: float
    plain: np.ndarray
    exponent: ExponentErrors

    def covariance(self) -> np.ndarray:
        """Of the values (15, 15), whatever the residuals remember and however they depart from a lag of first order.

        Source: Newey & West, Econometrica 55, 1987 (scores summed over lags with falling weights).
        """
        along, scores = self._along(), self._scores()
        meat = bartlett(scores, [np.arange(len(scores))], _memory(self.rate))
        flat = self.slopes.reshape(-1, len(CONSTANTS))
        # a value that is only held may be off by its looseness, noise / sqrt(held)
        least = LEAST_DRIVE_NOISE**2 * flat.T @ flat + self.noise**2 * np.diag(self.held)
        least[EXPONENT] = least[:, EXPONENT] = 0.0
        least[EXPONENT, EXPONENT] = (LEAST_DRIVE_NOISE * self.exponent.by_noise) ** 2 + self.exponent.held**2
        return along @ (meat + least) @ along.T

    def has_odd_lag(self, usual: np.ndarray) -> bool:
        """Whether a rotor's own lag, where those are free, departs from usual logarithms (4,) as the others' do not."""
        own = self.values[LAG:] - usual
        return bool(np.any(np.abs(own - own.mean()) > ODD_T * self.lag_errors()))

    def lag_errors(self) -> np.ndarray:
        """Standard errors (4,) of the logarithms of the rotors' lags over their mean."""
        centred = np.eye(4) - 0.25  # what all four have in common is no rotor's own
        return np.sqrt(np.diag(centred @ self.covariance()[LAG:, LAG:] @ centred))

    def in_band(self) -> "DriveFit":
        """With residual and slopes in the band of a comparison at RATE, and not many more rows: how large errors are.

        What is new is white, and would drown what a cause does to speeds in noise of the whole band of the telemetry.
        """
        if self.rate <= 2.0 * DRIVE_BAND:
            return self
        columns = np.concatenate([self.residual[:, :, None], self.slopes], axis=2)
        some = thin(columns, self.breaks(), self.t, DRIVE_BAND, 1)
        if len(some.rows) < 2:
            return self
        residual, slopes = some.columns[:, :, 0], some.columns[:, :, 1:]
        rate = 1.0 / float(np.median(np.diff(self.t[some.rows])))
        errors = self.exponent._replace(moves=np.add.reduceat(self.exponent.moves, some.rows))
        return self._replace(t=self.t[some.rows], residual=residual, slopes=slopes, rate=rate, exponent=errors)

    def breaks(self) -> np.ndarray:
        """True (n,) where a stretch without gaps begins."""
        return np.diff(self.t, prepend=-np.inf) > 1.5 / self.rate

    def moves(self, seconds: float) -> np.ndarray:
        """What each block of the flight adds to the values (B, 15), to first order; they sum to nothing much."""
        scores = self._scores()
        number = ((self.t - self.t[0]) / seconds).astype(int)
        parts = np.array([scores[number == n].sum(axis=0) for n in np.unique(number)])
        return (parts - parts.mean(axis=0)) @ self._along().T

    def _scores(self) -> np.ndarray:
        """What each row adds to the slopes of the squared error (n, 15), and to the exponent itself."""
        scores = np.einsum("ncp,nc->np", self.slopes, self.residual)
        scores[:, EXPONENT] = self.exponent.moves
        return scores

    def _along(self) -> np.ndarray:
        """What the values move by per unit of the scores (15, 15); the others follow where the exponent goes."""
        flat = self.slopes.reshape(-1, len(CONSTANTS))
        normal = flat.T @ flat + np.diag(self.held)
        scale = np.sqrt(np.diag(normal))
        scaled = normal / np.outer(scale, scale)
        rest = np.arange(len(CONSTANTS)) != EXPONENT
        along = np.zeros_like(normal)
        along[np.ix_(rest, rest)] = inverse = np.linalg.inv(scaled[np.ix_(rest, rest)])
        along[rest, EXPONENT] = -inverse @ scaled[rest, EXPONENT]
        along[EXPONENT, EXPONENT] = 1.0
        return along / np.outer(scale, np.where(rest, scale, 1.0 / scale))


def commanded(flown: Flown) -> str:
    """ "speeds", "shares" or "" for no commands of all four rotors."""
    frame = flown.filtered
    for kind, names in (("speeds", COMMANDED), ("shares", SHARES)):
        if all(n in frame and np.isfinite(frame[n]).any() for n in names):
            # a speed that was made from the share by a map is that map, no measurement
            made = flown.metadata.get("commanded speeds") if kind == "speeds" else None
            if "map" not in str((made or {}).get("source")):
                return kind
    return ""


def voltage_of(flown: Flown) -> np.ndarray | None:
    """Battery voltage (n,), V, or None."""
    if "battery_voltage" not in flown.filtered:
        return None
    volts = flown.filtered["battery_voltage"].to_numpy(float)
    return volts if np.isfinite(volts).any() and np.nanmedian(volts) > 0 else None


def reference_voltage(flights: Sequence[Flown]) -> float | None:
    """Median voltage over the flights, V; None when none logs it."""
    medians = [float(np.nanmedian(v)) for f in flights if (v := voltage_of(f)) is not None]
    return float(np.median(medians)) if medians else None


def belief_of(document: Mapping[str, Any], kind: str) -> Belief | None:
    """What a model's document holds of its actuators, for commands of this kind; None when it holds none.

    A speed is asked for directly when the commands are speeds; then the map is offset and gain. What extensions say of
    the rotors stands in place of the model's own, as in simulations.
    """
    held = drive_of(document)
    if "time constants" not in held:
        return None

    def mean(name: str, otherwise: float) -> float:
        return float(np.mean(held[name]["value"])) if name in held else otherwise

    values = np.zeros(len(CONSTANTS))
    values[2] = mean("delay", 0.0)
    lags = [held[n if n in held else "time constants"]["value"] for n in ("time constants up", "time constants down")]
    logs = np.log([np.broadcast_to(np.asarray(each, float), 4) for each in lags])  # (2, 4)
    values[:2] = np.exp(logs.mean(axis=1))
    values[LAG:] = logs.mean(axis=0) - logs.mean()
    voltage = None
    if kind == "speeds":
        values[4] = 1.0
    else:
        table = held.get("command map")
        if not table:
            return None
        for power, coefficient in zip(table.get("powers", [0, 1, 2]), table["coefficients"]):
            if power > 2:
                return None
            values[3 + power] = coefficient
        values[6] = float((table.get("voltage exponent") or {}).get("value") or 0.0)
        voltage = table.get("reference voltage")
    aged = held["delay"].get(TELEMETRY_AGE_REMOVED) if "delay" in held else None
    return Belief(values, voltage, aged if isinstance(aged, bool) else None)


def fit_drive(flown: Flown, kind: str, start: Belief, has_own_lags: bool = False) -> DriveFit:
    """The flight's own constants, near `start`. Raises DataError when it flies too little or lacks a column.

    has_own_lags  whether rotors may follow with lags of their own. Logarithms of lags that a flight hardly shows are
    far off to one side, and would take the common lag with them.
    """
    frame = flown.filtered
    if commanded(flown) != kind or not kind:
        raise DataError(f"flight {flown.key} has no rotor commands of the kind that the others log")
    # a speed that was made of the commands follows them by its map, and says nothing of the rotor
    if not all(w in frame for w in SPEEDS) or are_estimated(frame):
        raise DataError(f"flight {flown.key} has no measured rotor speeds")
    command, speed = (
        flown.imported[list(names)].to_numpy(float) for names in (COMMANDED if kind == "speeds" else SHARES, SPEEDS)
    )
    volts = voltage_of(flown) if kind == "shares" and start.voltage else None
    log = Prediction(flown, command, speed, volts, start.voltage, start.values)
    size = SIZES * [MAP_UNITS[kind].get(n, 1.0) for n in CONSTANTS]
    loose = LOOSE if kind == "shares" else np.concatenate([LOOSE[:3], [200.0, 0.3, 1e-9], LOOSE[6:]])
    noise = max(0.02 * float(np.std(log.target)), 1.0)  # rad/s, weighs the looseness against the data
    plain, x, exponent = log.fit(start.values, loose, noise, size, has_own_lags | (np.arange(len(CONSTANTS)) < LAG))
    return DriveFit(
        flown.key, x, log.t[log.kept()], log.errors(x), log.slopes(x),
        volts is not None and float(np.std(log.ratio[log.rows])) > LEAST_SAG, (noise / loose) ** 2, noise, log.rate,
        plain, exponent,
    )  # fmt: skip


def _memory(rate: float) -> int:
    """Rows over which residuals may be correlated, at `rate` Hz; one alone where telemetry is slower than that."""
    return max(round(RESIDUAL_MEMORY * rate), 1)
