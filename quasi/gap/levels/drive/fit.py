"""How one flight's rotors follow their commands: constants by output error, residuals and their slopes.

Speed follows the commanded one with a first-order lag of its own for speeding up and slowing down, late by one delay;
the commanded speed is a map of the command share and of the battery's voltage, or of a commanded speed itself. What is
wrong in the fit is linear in the slopes, so that flights can be compared on cross-products.
Source: Klein & Morelli, Aircraft System Identification, 2006, section 6.3 (output error).
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from quasi.errors import DataError
from quasi.gap.flights.evidence import RATE
from quasi.gap.flights.level import Flown
from quasi.identification.actuators import STRETCH_WARM_UP, fit_damped, follow, slopes_of
from quasi.identification.regression import bartlett
from quasi.importing.command_fit import RESIDUAL_MEMORY
from quasi.model.extensions import are_estimated, drive_of
from quasi.tables import TELEMETRY_AGE_REMOVED
from quasi.terms.rotor_map import COMMANDED, LOW_VOLTAGE, SHARES, SPEEDS

DRIVE_ITERATIONS = 12
FEWEST_DRIVE_ROWS = 300  # rows
LEAST_DRIVE_NOISE = 0.1  # rad/s: no residual is known better
LEAST_SAG = 0.003  # natural log of the voltage: below this variation within a flight the exponent is not estimated
LEAST_LAG, MOST_LAG, EARLIEST, LATEST = 0.002, 0.4, -0.03, 0.1  # s
OWN_LAG = (0.2, 5.0)  # times the common time constants, between which a rotor's own are sought
# parameters in order: time constants, delay, map, battery exponent, each rotor's speed relative to the common map
CONSTANTS = ("up", "down", "delay", "a0", "a1", "a2", "exponent", "rotor1", "rotor2", "rotor3", "rotor4")
DIFFERENCES = np.array([5e-4, 5e-4, 3e-4, 2.0, 20.0, 20.0, 0.02, 0.002, 0.002, 0.002, 0.002])
# prior standard deviations of a flight's constants about the start of the fit, where those without information stay
LOOSE = np.array([0.05, 0.05, 0.05, 300.0, 2000.0, 2000.0, 0.5, 0.1, 0.1, 0.1, 0.1])


class Belief(NamedTuple):
    """Constants that a model or a group of flights holds: values (11,) by CONSTANTS, and the voltage that they hold at.

    aged  whether the age of the rotor telemetry was taken off the delay; None where it is unknown
    """

    values: np.ndarray
    voltage: float | None
    aged: bool | None = None


class DriveFit(NamedTuple):
    """One flight at its best constants.

    values (11,) by CONSTANTS; t (n,) s; breaks (n,) bool; residual (n, 4) rad/s; slopes (n, 4, 11) of modelled speed
    held (11,) rad2/s2 per unit squared: how strongly each value was held where the fit began; noise rad/s that weighed
    the residual against that
    lags (4,)  each rotor's own time constants as multiples of `values`
    """

    key: str
    values: np.ndarray
    t: np.ndarray
    breaks: np.ndarray
    residual: np.ndarray
    slopes: np.ndarray
    volts_vary: bool
    held: np.ndarray
    noise: float
    lags: np.ndarray

    def covariance(self) -> np.ndarray:
        """Of the values (11, 11), whatever the residuals remember and however they depart from a lag of first order.

        Source: Newey & West, Econometrica 55, 1987 (scores summed over lags with falling weights).
        """
        inverse = self._inverse()
        scores = np.einsum("ncp,nc->np", self.slopes, self.residual)
        meat = bartlett(scores, [np.arange(len(scores))], round(RESIDUAL_MEMORY * RATE))
        flat = self.slopes.reshape(-1, len(CONSTANTS))
        # a value that is only held may be off by its looseness, noise / sqrt(held)
        return inverse @ (meat + LEAST_DRIVE_NOISE**2 * flat.T @ flat + self.noise**2 * np.diag(self.held)) @ inverse

    def lag_errors(self) -> np.ndarray:
        """Standard errors (4,) of the logarithms of `lags`, as `covariance` has them."""
        columns = self.slopes[:, :, :2] @ self.values[:2]  # rad/s per unit of the logarithm
        lags = round(RESIDUAL_MEMORY * RATE)
        meat = [bartlett(s[:, None], [np.arange(len(s))], lags)[0, 0] for s in (columns * self.residual).T]
        known = np.sum(columns**2, axis=0)
        return np.sqrt(np.array(meat) + LEAST_DRIVE_NOISE**2 * known) / np.maximum(known, 1e-300)

    def moves(self, seconds: float) -> np.ndarray:
        """What each block of the flight adds to the values (B, 11), to first order; they sum to nothing much."""
        scores = np.einsum("ncp,nc->np", self.slopes, self.residual)
        number = ((self.t - self.t[0]) / seconds).astype(int)
        parts = np.array([scores[number == n].sum(axis=0) for n in np.unique(number)])
        return (parts - parts.mean(axis=0)) @ self._inverse()

    def _inverse(self) -> np.ndarray:
        flat = self.slopes.reshape(-1, len(CONSTANTS))
        normal = flat.T @ flat + np.diag(self.held)
        scale = np.sqrt(np.diag(normal))
        return np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)


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

    tau = mean("time constants", 0.03)
    values = np.zeros(len(CONSTANTS))
    values[:3] = mean("time constants up", tau), mean("time constants down", tau), mean("delay", 0.0)
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


def fit_drive(flown: Flown, kind: str, start: Belief) -> DriveFit:
    """The flight's own constants, near `start`. Raises DataError when it flies too little or lacks a column."""
    frame = flown.filtered
    t = frame["t"].to_numpy(float)
    dt = float(np.median(np.diff(t)))
    if commanded(flown) != kind or not kind:
        raise DataError(f"flight {flown.key} has no rotor commands of the kind that the others log")
    command = np.stack([frame[c] for c in (COMMANDED if kind == "speeds" else SHARES)], axis=1)
    # a speed that was made of the commands follows them by its map, and says nothing of the rotor
    if not all(w in frame for w in SPEEDS) or are_estimated(frame):
        raise DataError(f"flight {flown.key} has no measured rotor speeds")
    speed = np.stack([frame[w] for w in SPEEDS], axis=1)
    volts = voltage_of(flown) if kind == "shares" and start.voltage else None
    finite = np.isfinite(command).all(axis=1) & np.isfinite(speed).all(axis=1)
    ratio = np.zeros(len(t))
    if volts is not None:
        finite &= np.isfinite(volts) & (volts > LOW_VOLTAGE * start.voltage)
        ratio = np.log(np.where(finite, volts, start.voltage) / start.voltage)
    begins = ~finite | ~np.concatenate([[False], finite[:-1]])
    age = np.arange(len(t)) - np.maximum.accumulate(np.where(begins, np.arange(len(t)), 0))
    use = finite & (age * dt > STRETCH_WARM_UP)
    if "valid" in frame:
        use &= frame["valid"].to_numpy() > 0.5
    every = max(round(1.0 / (RATE * dt)), 1)
    rows = np.arange(0, len(t), every)
    rows = rows[use[rows]]
    if len(rows) < FEWEST_DRIVE_ROWS:
        raise DataError(
            f"flight {flown.key} has {len(rows) / RATE:.1f} s of flight with commands and measured rotor speeds, "
            f"expected at least {FEWEST_DRIVE_ROWS / RATE:.0f} s"
        )
    command, speed = (np.where(finite[:, None], x, 0.0) for x in (command, speed))
    buffer = np.empty(len(t))

    def one(i: int, x: np.ndarray) -> np.ndarray:
        c = np.ascontiguousarray(command[:, i])
        wanted = (1.0 + x[7 + i]) * np.exp(x[6] * ratio) * (x[3] + x[4] * c + x[5] * c * c)
        follow(wanted, np.ascontiguousarray(speed[:, i]), begins, x[2] / dt, dt, x[0], x[1], buffer)
        return buffer[rows]

    def run(x: np.ndarray) -> np.ndarray:
        return np.stack([one(i, x) for i in range(4)], axis=1)

    def own_lag(i: int, x: np.ndarray) -> float:
        def left(log: float) -> float:
            return float(np.sum((target[:, i] - one(i, np.concatenate([np.exp(log) * x[:2], x[2:]]))) ** 2))

        return float(np.exp(minimize_scalar(left, bounds=np.log(OWN_LAG), method="bounded").x))

    low = np.concatenate([[LEAST_LAG, LEAST_LAG, EARLIEST], np.full(8, -np.inf)])
    high = np.concatenate([[MOST_LAG, MOST_LAG, LATEST], np.full(8, np.inf)])
    step = DIFFERENCES if kind == "shares" else np.concatenate([DIFFERENCES[:3], [2.0, 0.01, 1e-6], DIFFERENCES[6:]])
    loose = LOOSE if kind == "shares" else np.concatenate([LOOSE[:3], [200.0, 0.3, 1e-9], LOOSE[6:]])
    loose = np.where(np.arange(len(CONSTANTS)) == 6, loose if volts is not None else 1e-6, loose)
    target = speed[rows]
    noise = max(0.02 * float(np.std(target)), 1.0)  # rad/s, weighs the looseness against the data

    def weighed(speeds: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.concatenate([speeds.ravel() / noise, x / loose])

    begin = start.values.copy()
    begin[:3] = np.clip(begin[:3], low[:3] + 1e-3, high[:3])
    x, _, _ = fit_damped(
        lambda x: weighed(run(x), x), weighed(target, start.values), begin, (low, high), step, DRIVE_ITERATIONS
    )
    here = run(x)
    slopes = slopes_of(lambda x: run(x).ravel(), x, here.ravel(), step).reshape(*here.shape, len(x))
    breaks = np.concatenate([[True], np.diff(rows) > every])
    vary = volts is not None and float(np.std(ratio[rows])) > LEAST_SAG
    held = (noise / loose) ** 2
    lags = np.array([own_lag(i, x) for i in range(4)])
    return DriveFit(flown.key, x, t[rows], breaks, target - here, slopes, vary, held, noise, lags)
