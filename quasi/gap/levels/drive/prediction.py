"""Rotor speeds of one flight predicted from its commands and from its past errors, and the constants that do it best.

What disturbs a rotor turns the vehicle; through gyro and controller it changes the commands that follow. Output error
compares speeds with what the commands alone make. It takes a part of the disturbance for an answer to the command, by
which lag and delay come out wrong, and differently in each manoeuvre. So what the errors before predict of an error is
taken off it. What is left is new: commands that were given before cannot depend on it. Noise of the telemetry has no
memory, nothing is predicted of it, and the fit is one by output error.

Commands and speeds are those that were logged. A low-pass without delay mixes in noise to come. So do the straight
lines that import draws between samples, by half an interval; `identify.usual_spreads` allows for that.

The battery's exponent stays the one of output error. A battery's voltage changes slowly, and so do most errors. What is
new at each moment holds little of that voltage, but all the noise of its readings. By what is new alone, the exponent
came out too near to zero, the more so the noisier the readings.
Sources: Ljung, System Identification, 2nd ed., 1999, chapter 13 (direct identification in closed loop); Soederstrom &
Stoica, System Identification, 1989, chapters 7 (errors made white by an autoregression, in turns) and 10; Carroll et
al., Measurement Error in Nonlinear Models, 2nd ed., 2006, chapter 3 (a noisy regressor has too small a coefficient).
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from quasi.errors import DataError
from quasi.gap.flights.evidence import RATE
from quasi.gap.flights.level import Flown
from quasi.gap.statistics.whitening import Whitener, autoregression, whiten
from quasi.identification.actuators import STRETCH_WARM_UP
from quasi.identification.lag_fit import NO_SLOPES, fit_damped, follow
from quasi.terms.rotor_map import LOW_VOLTAGE

AR_ORDER = 8  # of the autoregression, as of the sensors' (`quasi.gap.levels.sensors.products`)
DRIVE_ITERATIONS = 12
DELAY_SEARCHES = 2  # of the delay: the second begins with errors that the first has set right
LEAST_DRIVEN = 3.0  # s
LEAST_LAG, MOST_LAG, EARLIEST, LATEST = 0.002, 0.4, -0.03, 0.1  # s
TRIED_LAGS = np.geomspace(LEAST_LAG, MOST_LAG, 9)  # s, about twice as long each time
MOST_APART = 2.0  # of the logarithm of a rotor's lag over the others'
DELAY = 2  # place of the delay among the constants
MAP = slice(3, 6)  # places of the map's coefficients
EXPONENT = 6  # place of the battery's exponent
SPEED_SHARE = 7  # place of the first rotor's share of the speed
LAG = 11  # place of the logarithm of the first rotor's lag over the others'


class ExponentErrors(NamedTuple):
    """How far a battery's exponent by output error may be off.

    moves (m,)  what the error of each kept row adds to it, to first order; by_noise  standard error per rad/s of noise
    in all compared speeds; held  standard error by where the fit began
    """

    moves: np.ndarray
    by_noise: float
    held: float


class Prediction:
    """Of a flight's rotor speeds by constants x (15,), see `fit.CONSTANTS`.

    t (n,) s, dt its step; rows  places of the samples of the telemetry that are compared, `every` steps apart, at
    `rate` Hz; memory (order + 1,)  weights of an error and of the errors before it in what is new
    ratio (n,)  logarithm of the voltage over that at which the map holds; None where the speed does not go with it
    """

    def __init__(
        self, flown: Flown, command: np.ndarray, speed: np.ndarray, volts: np.ndarray | None, voltage: float | None,
        start: np.ndarray,
    ) -> None:  # fmt: skip
        """command, speed (n, 4) as logged; volts (n,) V, voltage  at which the map holds; start (15,)  of the fit.

        Raises DataError where the flight is too short.
        """
        self.memory = np.ones(1)  # output error
        self.t = flown.filtered["t"].to_numpy(float)
        self.dt = float(np.median(np.diff(self.t)))
        finite = np.isfinite(command).all(axis=1) & np.isfinite(speed).all(axis=1)
        self.ratio = None
        if volts is not None:
            finite &= np.isfinite(volts) & (volts > LOW_VOLTAGE * voltage)
            self.ratio = np.log(np.where(finite, volts, voltage) / voltage)
        self.begins = ~finite | ~np.concatenate([[False], finite[:-1]])
        use = finite & (_since(self.begins) * self.dt > STRETCH_WARM_UP)
        if "valid" in flown.filtered:
            use &= flown.filtered["valid"].to_numpy() > 0.5
        logged = ((flown.metadata.get("streams") or {}).get("rotor speeds") or {}).get("rate")
        self.every = max(round(1.0 / (logged * self.dt)), 1) if logged else 1  # import draws lines between samples
        self.rate = 1.0 / (self.every * self.dt)
        rows = np.arange(0, len(self.t), self.every)
        self.rows = rows[use[rows]]
        self.breaks = np.concatenate([[True], np.diff(self.rows) > self.every])[: len(self.rows)]
        seconds = np.sum(_since(self.breaks) >= AR_ORDER) / self.rate
        if seconds < LEAST_DRIVEN:
            raise DataError(
                f"flight {flown.key} has {seconds:.1f} s of flight with commands and measured rotor speeds, expected "
                f"at least {LEAST_DRIVEN:.0f} s"
            )
        self.commands, self.speeds = (
            [np.where(finite, x, 0.0) for x in columns.T] for columns in (command, speed)
        )  # fmt: skip
        self.target = np.stack([w[self.rows] for w in self.speeds], axis=1)
        # a rotor's own share is one of the speed by a map that stays: map and shares then add, and do not multiply, so
        # that the fit does not creep along what they have in common
        self.first = [_mapped(start, c) for c in self.commands]
        self._buffer, self._exponent, self._factor = np.empty(len(self.t)), np.nan, np.empty(0)
        self._moves: dict[int, np.ndarray] = {}
        # without holes a slice, which copies nothing
        full = len(self.rows) > 0 and self.rows[-1] - self.rows[0] == (len(self.rows) - 1) * self.every
        self._taken = slice(self.rows[0], self.rows[-1] + 1, self.every) if full else self.rows

    def kept(self) -> np.ndarray:
        """Places (m,) of the rows whose errors before are known."""
        return self.rows[self._known()]

    def of_commands(self, i: int, x: np.ndarray, slopes: np.ndarray = NO_SLOPES) -> np.ndarray:
        """Speed (n,) of rotor i that its commands alone make; the next call overwrites it.

        slopes  takes its derivatives (n, 8) by its own time constants, the five next of x and its share of the speed,
        where they are asked
        """
        c, moves = self.commands[i], NO_SLOPES
        volt = self._voltage_factor(x[EXPONENT])
        wanted = volt * (_mapped(x, c) + x[SPEED_SHARE + i] * self.first[i])
        if len(slopes):
            moves = self._map_slopes(i)
            if self.ratio is not None:
                moves[:, 3] = wanted * self.ratio
        late, (up, down) = x[DELAY] / self.dt, own_lag(x, i)
        follow(wanted, self.speeds[i], self.begins, late, self.dt, up, down, self._buffer, moves, slopes)
        return self._buffer

    def _voltage_factor(self, exponent: float) -> np.ndarray:
        """Factor (n,) of the voltage on the speed, kept for the four rotors."""
        if exponent != self._exponent:
            self._exponent = exponent
            self._moves.clear()
            self._factor = np.ones(len(self.t)) if self.ratio is None else np.exp(exponent * self.ratio)
        return self._factor

    def _map_slopes(self, i: int) -> np.ndarray:
        """Derivatives (n, 5) of what rotor i follows by x[3:7] and its share of the speed; that by the exponent, which
        depends on the speed, is 0. Kept while the factor of the voltage stays."""
        if i not in self._moves:
            c, volt = self.commands[i], self._factor
            self._moves[i] = np.stack([volt, volt * c, volt * c * c, np.zeros(len(c)), volt * self.first[i]], axis=1)
        return self._moves[i]

    def errors(self, x: np.ndarray) -> np.ndarray:
        """What of the errors (m, 4), rad/s, the errors before do not predict."""
        return self._new(self._plain(x), self.memory)

    def learn(self, x: np.ndarray) -> None:
        """The memory of the errors at x, one for all: rotors are alike; one of its own would hide one that is not."""
        series = [errors[:, None] for errors in self._plain(x).T]
        self.memory = autoregression(series, [self.breaks] * len(series), AR_ORDER).coefficients[0]

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Derivatives (m, 4, 15) of the predicted speeds, see `_unforeseen`."""
        slopes = self._slopes(x).reshape(-1, 4, len(x))
        return np.stack([self._unforeseen(slopes[:, i], plain) for i, plain in enumerate(self._plain(x).T)], axis=1)

    def _slopes(
        self, x: np.ndarray, every: int = 1, free: np.ndarray | slice = slice(None), more: int = 0
    ) -> np.ndarray:
        """Derivatives (4 m + more, F) of the predicted speeds at each `every`-th row by the free constants.

        The memory stays. free (15,)  bool, or all; more  rows at the end, to be filled
        """
        own, combined, rows = np.empty((len(self.t), 8)), np.empty(0), 0
        for i in range(4):
            self.of_commands(i, x, own)
            white = self._new(own[self._taken][:, None], self.memory)[::every, 0]
            (up, down), weights = own_lag(x, i), np.zeros((8, len(x)))
            weights[:7, :7], weights[7, SPEED_SHARE + i] = np.eye(7), 1.0
            weights[0, 0], weights[1, 1] = up / x[0], down / x[1]
            # a logarithm counts from the mean of the four, which is what the common time constants are
            weights[:2, LAG:] = np.outer((up, down), np.eye(4)[i] - 0.25)
            weights = weights[:, free]
            if i == 0:
                rows = 4 * len(white)
                combined = np.empty((rows + more, weights.shape[1]))
            np.matmul(white, weights, out=combined[i:rows:4])
        return combined

    def fit(
        self, start: np.ndarray, loose: np.ndarray, noise: float, size: np.ndarray, free: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, ExponentErrors]:
        """Constants by output error; those that predict best, with that exponent; how far the exponent may be off.

        start, loose (15,)  where they are held and how loosely; noise  rad/s, weighs that; size (15,)  of a step; free
        (15,)  False for those that stay at start
        """
        low = np.concatenate([[LEAST_LAG, LEAST_LAG, EARLIEST], np.full(LAG - 3, -np.inf), np.full(4, -MOST_APART)])
        high = np.concatenate([[MOST_LAG, MOST_LAG, LATEST], np.full(LAG - 3, np.inf), np.full(4, MOST_APART)])

        def weighed(x: np.ndarray, every: int = 1) -> np.ndarray:
            return np.concatenate([-self.errors(x)[::every].ravel() / noise, (x - start) / loose])

        def descend(x: np.ndarray, free: np.ndarray, every: int = 1) -> tuple[np.ndarray, np.ndarray]:
            """From x to the least error along the constants that are free, and the slopes there."""

            def at(values: np.ndarray) -> np.ndarray:
                there = x.copy()
                there[free] = values
                return there

            def slopes(values: np.ndarray) -> np.ndarray:
                both = self._slopes(at(values), every, free, len(x))
                both[-len(x) :] = np.diag(noise / loose)[:, free]
                both /= noise
                return both

            nothing = np.zeros(len(weighed(x, every)))
            values, along, _ = fit_damped(
                lambda v: weighed(at(v), every), slopes, nothing, x[free], (low[free], high[free]), size[free],
                DRIVE_ITERATIONS,
            )  # fmt: skip
            return at(values), along * size[free]

        def delayed(x: np.ndarray, slopes: np.ndarray) -> np.ndarray:
            """x with the delay, within a step, that leaves least where the others follow along their slopes.

            By itself: where a change of a command meets a sample, the error has an edge that no slope describes.
            """
            inverse = np.linalg.inv(slopes.T @ slopes)

            def at(delay: float) -> np.ndarray:
                return np.where(np.arange(len(x)) == DELAY, delay, x)

            def left(delay: float) -> float:
                error = weighed(at(delay))
                along = slopes.T @ error
                return float(error @ error - along @ inverse @ along)

            near = np.clip([x[DELAY] - self.dt, x[DELAY] + self.dt], EARLIEST, LATEST)
            found = float(minimize_scalar(left, bounds=near, method="bounded").x)
            return at(min((found, x[DELAY]), key=left))

        x = start.copy()
        x[:3] = np.clip(x[:3], low[:3] + 1e-3, high[:3])
        every = max(round(self.rate / RATE), 1)
        plain, slopes = descend(x, free, every)
        weights = np.linalg.solve(slopes.T @ slopes, slopes.T)[np.count_nonzero(free[:EXPONENT])] * size[EXPONENT]
        of_rows, of_held = np.split(weights, [4 * len(self.rows[::every])])
        moves = np.zeros(len(self.rows))
        moves[::every] = -np.sum((of_rows * weighed(plain, every)[: len(of_rows)]).reshape(-1, 4), axis=1)
        x = self._with_own_map(plain, start)
        free = free & (np.arange(len(x)) != EXPONENT)
        rest = free & (np.arange(len(x)) != DELAY)
        for _ in range(DELAY_SEARCHES):
            self.learn(x)
            x, slopes = descend(self._nearest(x), rest)
            self.learn(x)
            x = descend(delayed(x, slopes), rest)[0]
        by_noise, held = float(np.linalg.norm(of_rows)) / noise, float(np.linalg.norm(of_held))
        return plain, x, ExponentErrors(moves[self._known()], by_noise, held)

    def _with_own_map(self, x: np.ndarray, start: np.ndarray) -> np.ndarray:
        """x with shares of the speed by its own map, which takes what all rotors have: the start's may be far off."""
        x, own, old = x.copy(), x[SPEED_SHARE:LAG], np.concatenate(self.first)
        x[MAP] += own.mean() * start[MAP]
        self.first = [_mapped(x, c) for c in self.commands]
        self._moves.clear()
        new = np.concatenate(self.first)
        x[SPEED_SHARE:LAG] = (own - own.mean()) * (old @ new) / (new @ new)
        return x

    def _nearest(self, x: np.ndarray) -> np.ndarray:
        """x with that lag and delay, of all, which leave least: along the delay there is a minimum near each sample.

        The map is that of x. A whole step of the delay moves the speeds that the commands make.
        """
        kept, known, wanted = self.kept(), np.zeros(len(self.t)), np.zeros((4, len(self.t)))
        known[kept], wanted[:, kept] = 1.0, self._new(self.target, self.memory).T
        best, least = x, float(np.sum(self.errors(x) ** 2) - np.sum(wanted**2))
        late = np.arange(round(EARLIEST / self.dt), round(LATEST / self.dt) + 1)
        length = next_fast_len(len(self.t) + int(np.abs(late).max()), real=True)  # no shift wraps round
        of_known, of_wanted = np.conj(rfft(known, length)), np.conj(rfft(wanted, length))
        for lag in TRIED_LAGS:
            tried, spectrum = np.concatenate([[lag, lag, 0.0], x[3:]]), np.zeros(length // 2 + 1, complex)
            for i in range(4):
                weights = np.zeros(self.every * (len(self.memory) - 1) + 1)
                weights[:: self.every] = self.memory
                made = lfilter(weights, [1.0], self.of_commands(i, tried))
                spectrum += of_known * rfft(made**2, length) - 2.0 * of_wanted[i] * rfft(made, length)
            left = irfft(spectrum, length)[-late]  # correlation at every shift; negative places count from the end
            if left.min() < least:
                best, least = np.concatenate([[lag, lag, late[np.argmin(left)] * self.dt], x[3:]]), left.min()
        return best

    def _plain(self, x: np.ndarray) -> np.ndarray:
        """Measured speeds minus those of the commands (rows, 4)."""
        errors = self.target.copy()
        for i in range(4):
            errors[:, i] -= self.of_commands(i, x)[self._taken]
        return errors

    def _new(self, values: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Values (rows, R) or (rows, R, p) with what a memory predicts taken off (m, ...)."""
        new = whiten(values.reshape(len(values), 1, -1), self.breaks, Whitener(memory[None], np.ones(1)))[0]
        return new.reshape(-1, *values.shape[1:])

    def _unforeseen(self, slopes: np.ndarray, plain: np.ndarray) -> np.ndarray:
        """Slopes (m, p) of a rotor without what its errors before (rows,) make of them.

        It is what stays of them where the memory is fitted as well. Source: Frisch & Waugh, Econometrica 1, 1933.
        """
        places = np.flatnonzero(self._known())
        before = np.stack([plain[places - lag] for lag in range(1, len(self.memory))], axis=1)
        return slopes - before @ np.linalg.lstsq(before, slopes, rcond=None)[0]

    def _known(self) -> np.ndarray:
        return _since(self.breaks) >= len(self.memory) - 1


def own_lag(x: np.ndarray, i: int) -> np.ndarray:
    """Time constants up and down (2,), s, of rotor i by constants x (15,)."""
    return x[:2] * math.exp(x[LAG + i] - sum(x[LAG:].tolist()) / 4.0)


def _mapped(x: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Steady speed (n,), rad/s, of a command (n,) by constants x (15,)."""
    return x[3] + x[4] * command + x[5] * command * command


def _since(begins: np.ndarray) -> np.ndarray:
    """Rows (n,) since a stretch began. begins (n,) bool"""
    rows = np.arange(len(begins))
    return rows - np.maximum.accumulate(np.where(begins, rows, 0))
