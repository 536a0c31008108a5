"""Rotor speeds of flights without rotor telemetry: the map of command and voltage, lag and delay, identified jointly
with thrust and torque factors over all training flights of a model.

Commands make speeds (`quasi.terms.rotor_map`), squared speeds make thrusts T_i, and with hub i at (x_i, y_i)

    Fz = -sum T_i + c w sum W + c (u2 + v2)         Mx = -a_x sum y_i T_i + c p + c v sum W
    My =  a_y sum x_i T_i + c q + c u sum W         Mz = -a_z sum s_i T_i + c r + c sum s_i dW_i/dt

a_x and a_y are 1 where arms, mass and inertia are as configured. In flight a controller answers every disturbance, so
that commands and disturbances are correlated and least squares underestimates the factors; it does even more so after a
zero-phase filter. The equations are therefore compared before any low-pass, as predictions one step ahead, with an
autoregressive model of the disturbance (a prediction-error method, consistent in closed loop).

The trim of a flight cannot be known from commands: propellers, motors and batteries differ from day to day. Each rotor
gets a factor a flight with which the flight's mean thrust and moments balance; the scatter of these factors is the
error of speeds that are estimated from commands alone.

Source: Ljung, System Identification, 2nd ed., 1999, sections 7.2, 10.2 (prediction error, generalised least squares)
and 13.4 (closed loop); Schwarz, Annals of Statistics 6, 1978 (BIC); Golub & Pereyra, SIAM J. Numer. Anal. 10, 1973.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.signal import lfilter

from quasi.airframe import Airframe, number
from quasi.attitude import AIR_DENSITY, GRAVITY
from quasi.errors import DataError
from quasi.identification.partition import usable
from quasi.terms.rotor_map import (
    DELAY_RANGE,
    EXPONENT_RANGE,
    FORMS,
    RAW,
    SPEEDS,
    TAU_RANGE,
    lagged,
    raw_commands,
    raw_volts,
    shape,
    used_rows,
)

STEP = 0.01  # s between compared rows: half the shortest lag of a brushed motor, and no finer than slow logs
ORDER = (
    12  # of the autoregressive disturbance: 0.12 s. On nanobench the factors rise up to there, and are level to 0.2 s
)
ROUNDS = 3  # disturbance model and map are estimated in turn
SHORTEST = 5.0  # s of compared rows of all flights together: ten times the longest time constant
MIN_VOLTAGE_VARIATION = 0.01  # std over median of the voltage, as in the identification of actuators
LIMIT = 0.999  # a share of the command from which on it is at its limit
WORST_CONDITION = 1e12  # of the normal equations of scaled parameters; beyond it doubles hold no digits
# Static thrust coefficient T / (rho n2 D4) of small propellers is 0.08 to 0.14 (Deters, Ananda & Selig, AIAA 2014-2151,
# 2.25 to 9 inch); its middle, as T = C rho A (W R)2: times 4 / pi3
NOMINAL_THRUST_COEFFICIENT = 0.11 * 4.0 / np.pi**3
KNOWN_SCALES = ("hover speed", "thrust factor")  # keys of the quadrotor configuration, rad/s and N s2/rad2
AXES = ("Fz", "Mx", "My", "Mz")


@dataclass
class _Flight:
    """One flight, averaged to about STEP.

    fine: rows of the log's grid in a compared row; dt, h  s of the grid and of compared rows; commands (N, 4) in units
    of the operating command; ratio (N, 1) of voltages or None; targets {axis: (M,)}; columns {name: (M,)} of rates and
    velocities; rows (M,) compared; thrust  its mean, N
    """

    fine: int
    dt: float
    h: float
    commands: np.ndarray
    ratio: np.ndarray | float
    targets: dict[str, np.ndarray]
    columns: dict[str, np.ndarray]
    rows: np.ndarray
    used: np.ndarray
    thrust: float
    noise: dict[str, np.ndarray] = field(default_factory=dict)


def lacking_speeds(flights: Mapping[str, pd.DataFrame]) -> list[str]:
    """Keys of flights without the speeds of all four rotors."""
    return [key for key, flight in flights.items() if not all(w in flight for w in SPEEDS)]


def command_kind(flight: pd.DataFrame) -> str | None:
    """ "speed" where a filtered flight keeps commanded speeds, "share" where it keeps shares, else None."""
    return next((kind for kind in ("speed", "share") if raw_commands(flight, kind) is not None), None)


def identify_rotor_speeds(
    flights: Mapping[str, pd.DataFrame],
    airframe: Airframe,
    masses: Mapping[str, float],
    known: Mapping[str, float] | None = None,
    chosen: Mapping[str, np.ndarray] | None = None,
) -> tuple[dict[str, Any], list[str]]:
    """The section "rotor speeds" of a model from filtered flights that hold no rotor speeds, and notes.

    flights  filtered training flights with the columns that the filter keeps where speeds lack (`rotor_map.RAW`)
    chosen   {flight: (n,) bool} rows to use, stretches rather than single rows; None takes those valid and in flight
    masses   kg per flight; known  "hover speed" (rad/s) or "thrust factor" (N s2/rad2) of the quadrotor's configuration
    Raises DataError where the flights are too short, or their commands move too little.
    """
    notes: list[str] = []
    kinds = {command_kind(flight) for flight in flights.values()}
    if len(kinds) != 1:
        raise DataError(
            f"of the flights {', '.join(flights)} some log commanded speeds and some shares of the motor output range; "
            "train the model on flights of one kind, or give the quadrotor a 'command map'"
        )
    kind = next(iter(kinds))
    chosen = chosen or {key: used_rows(flight) for key, flight in flights.items()}
    operating, reference = _operating_point(flights, chosen, kind, notes)
    made = {k: _prepare(f, chosen[k], airframe, masses[k], kind, (operating, reference)) for k, f in flights.items()}
    made = {k: f for k, f in made.items() if f.rows.any()}
    seconds = sum(float(f.rows.sum()) * f.h for f in made.values())
    if seconds < SHORTEST:
        raise DataError(
            f"flights {', '.join(flights)} hold {seconds:.1f} s from which rotor speeds could be estimated, "
            f"{SHORTEST:g} s are needed; add flights"
        )
    names = ["speed"] if kind == "speed" else [n for n in FORMS if n != "speed"]
    fits, begin = {}, None
    for name in names:
        fits[name] = _Fit(name, list(made.values()), airframe, reference is not None)
        fits[name].run(begin)
        begin = begin if begin is not None else fits[name]
    best = min(fits, key=lambda n: fits[n].criterion)
    fit = fits[best]
    if kind == "share":
        _note_limits(flights, chosen, notes)
    drive = _as_plain(fit, best, kind, operating, reference, list(made), airframe, masses, known or {})
    drive["candidates"] = [
        {"form": n, "BIC": f.criterion - fit.criterion, "parameters": len(f.x)} for n, f in fits.items()
    ]
    drive["geometry"] = {axis: fit.places(axis) for axis in AXES[1:]}
    _note_errors(drive, notes)
    return drive, notes


def _operating_point(
    flights: Mapping[str, pd.DataFrame], chosen: Mapping[str, np.ndarray], kind: str, notes: list[str]
) -> tuple[float, float | None]:
    """Median command of the used rows, and the median voltage, V; None where a flight logs none or it never varies."""
    commands = np.concatenate([raw_commands(f, kind)[chosen[k]].ravel() for k, f in flights.items()])
    operating = float(np.median(commands)) if len(commands) else 0.0
    if not operating > 0.0:
        raise DataError(f"the commands of the flights {', '.join(flights)} are 0 in flight; check their columns")
    silent = [k for k, f in flights.items() if raw_volts(f) is None]
    if silent:
        notes.append(
            f"flight{'s' * (len(silent) > 1)} {', '.join(silent)} log{'s' * (len(silent) == 1)} no battery voltage: "
            "the map from command to rotor speed is identified without it"
        )
        return operating, None
    volts = [raw_volts(f)[chosen[k]] for k, f in flights.items()]
    median = float(np.median(np.concatenate(volts)))
    if not median > 0.0 or max(np.std(v) for v in volts if len(v)) < MIN_VOLTAGE_VARIATION * median:
        notes.append("the battery voltage hardly varies: the map from command to rotor speed is identified without it")
        return operating, None
    return operating, median


def _prepare(
    flight: pd.DataFrame, used: np.ndarray, airframe: Airframe, mass: float, kind: str,
    point: tuple[float, float | None],
) -> _Flight:  # fmt: skip
    """point  operating command and reference voltage, V or None"""
    operating, reference = point
    t = flight["t"].to_numpy(float)
    dt = float(np.median(np.diff(t)))
    fine = max(round(STEP / dt), 1)

    def mean(values: np.ndarray) -> np.ndarray:
        return _block_means(values, fine)

    def raw(name: str) -> np.ndarray:
        return mean(flight[f"{name}{RAW}"].to_numpy(float))

    h = fine * dt
    rates = np.stack([raw(n) for n in "pqr"], axis=1)
    slope = np.diff(rates, axis=0) / h
    middle = 0.5 * (rates[1:] + rates[:-1])
    inertia = np.asarray(airframe.inertia, float)
    moments = slope @ inertia.T + np.cross(middle, middle @ inertia.T)
    targets = {"Fz": mass * raw("az")[1:], **{axis: moments[:, i] for i, axis in enumerate(AXES[1:])}}
    air = {n: f"{n}_air" if f"{n}_air" in flight else n for n in "uvw"}
    columns = {n: mean(flight[air[n]].to_numpy(float)) for n in "uvw"}
    columns = {n: 0.5 * (c[1:] + c[:-1]) for n, c in columns.items()}
    columns |= {n: rates[:-1, i] for i, n in enumerate("pqr")}  # known before the step, as in a prediction
    whole = mean(used.astype(float)) > 0.99
    rows = whole[1:] & whole[:-1]
    # a prediction needs the rows before it
    age = np.arange(len(rows)) - np.maximum.accumulate(np.where(rows, -1, np.arange(len(rows))))
    ratio: np.ndarray | float = 1.0
    if reference is not None:
        ratio = raw_volts(flight)[:, None] / reference
    weight = -float(np.mean(targets["Fz"][rows])) if rows.any() else 0.0
    return _Flight(
        fine, dt, h, raw_commands(flight, kind) / operating, ratio, targets, columns, rows & (age > ORDER), used, weight
    )


def _block_means(values: np.ndarray, size: int) -> np.ndarray:
    """Means (M, ...) over blocks of `size` rows of (N, ...)."""
    count = len(values) // size
    return values[: count * size].reshape(count, size, *values.shape[1:]).mean(axis=1)


class _Fit:
    """One form of the map on all flights: parameters x = time constant, delay, shape, voltage exponent."""

    def __init__(self, form: str, flights: Sequence[_Flight], airframe: Airframe, with_voltage: bool) -> None:
        self.form, self.flights, self.airframe = form, flights, airframe
        about = FORMS[form]
        self.names = ("time constant", "delay", *about.names, *(("voltage exponent",) if with_voltage else ()))
        last = len(self.names) - 2 - len(about.names)
        self.low = np.array([TAU_RANGE[0], DELAY_RANGE[0], *about.low, *[EXPONENT_RANGE[0]] * last])
        self.high = np.array([TAU_RANGE[1], DELAY_RANGE[1], *about.high, *[EXPONENT_RANGE[1]] * last])
        self.size = np.array([0.01, 0.005, *[0.2] * (len(self.low) - 2)])
        self.x = np.array([0.04, 0.005, *about.start, *[0.7] * last])
        self.shares = thrust_shares(airframe)
        self.colour = {axis: np.zeros(ORDER) for axis in AXES}
        self.scale = dict.fromkeys(AXES, 1.0)
        self.with_voltage = with_voltage
        self.criterion = np.inf
        self.covariance = np.zeros((len(self.x), len(self.x)))

    def thrusts(self, flight: _Flight, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Thrusts (N, 4), N, on the flight's grid, their rotors' speeds over the square root of N, factors (4,)."""
        parts = len(FORMS[self.form].names)
        exponent = x[-1] if self.with_voltage else 0.0
        speeds = shape(self.form, flight.commands, flight.ratio, exponent, x[2 : 2 + parts])
        speeds = lagged(speeds, flight.dt, x[0], x[1])
        mean = np.mean(speeds[flight.used] ** 2, axis=0)
        factor = self.shares * flight.thrust / np.maximum(mean, 1e-12)
        return speeds**2 * factor, speeds * np.sqrt(factor), factor

    def equations(self, flight: _Flight, x: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """{axis: (target (M,), columns (M, k))}; the first column of a moment is that of its factor."""
        thrust, speeds, _ = self.thrusts(flight, x)
        blocks, turning = (_block_means(v, flight.fine) for v in (thrust, speeds))
        mid, total = 0.5 * (blocks[1:] + blocks[:-1]), 0.5 * (turning[1:] + turning[:-1]).sum(axis=1)
        c, hubs, spin = flight.columns, self.airframe.hubs, self.airframe.spin
        faster = np.diff(turning, axis=0) @ spin / flight.h
        return {
            "Fz": (
                flight.targets["Fz"] + mid.sum(axis=1),
                np.stack([c["w"] * total, c["u"] ** 2 + c["v"] ** 2], axis=1),
            ),
            "Mx": (flight.targets["Mx"], np.stack([-mid @ hubs[:, 1], c["p"], c["v"] * total], axis=1)),
            "My": (flight.targets["My"], np.stack([mid @ hubs[:, 0], c["q"], c["u"] * total], axis=1)),
            "Mz": (flight.targets["Mz"], np.stack([-mid @ spin, c["r"], faster], axis=1)),
        }

    def whitened(self, x: np.ndarray, white: bool = True) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """{axis: (target, columns)} of all compared rows, through the inverse of the disturbance model, about the means
        of each flight."""
        found: dict[str, list] = {axis: [] for axis in AXES}
        for flight in self.flights:
            for axis, (target, columns) in self.equations(flight, x).items():
                both = np.column_stack([target, columns])
                if white:
                    both = lfilter(np.concatenate([[1.0], -self.colour[axis]]), [1.0], both, axis=0)
                both = both[flight.rows]
                found[axis].append(both - both.mean(axis=0))
        return {axis: ((b := np.concatenate(parts))[:, 0], b[:, 1:]) for axis, parts in found.items()}

    def solve(self, x: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """{axis: (coefficients, their covariance up to the variance, residual)}."""
        found = {}
        for axis, (target, columns) in self.whitened(x).items():
            size = np.linalg.norm(columns, axis=0)
            size = np.where(size > 0, size, 1.0)
            normal = (columns / size).T @ (columns / size) + 1e-12 * np.eye(len(size))
            inverse = np.linalg.inv(normal)
            theta = inverse @ ((columns / size).T @ target)
            found[axis] = theta / size, inverse / np.outer(size, size), target - (columns / size) @ theta
        return found

    def run(self, begin: "_Fit | None" = None) -> None:
        """Estimate the parameters; those that another fit shares with this one start there."""
        if begin is not None:
            self.colour, self.scale = dict(begin.colour), dict(begin.scale)
            shared = dict(zip(begin.names, begin.x))
            self.x = np.array([shared[n] if n not in FORMS[self.form].names and n in shared else v
                               for n, v in zip(self.names, self.x)])  # fmt: skip
        else:
            self._update_noise(self.solve(self.x))
        for _ in range(ROUNDS if begin is None else ROUNDS - 1):
            found = least_squares(
                self._error, self.x, bounds=(self.low, self.high), x_scale=self.size, diff_step=1e-2, xtol=1e-5,
                ftol=1e-6, max_nfev=25,
            )  # fmt: skip
            self.x = found.x
            self._update_noise(self.solve(self.x))
        self._finish()

    def _error(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([part[2] / self.scale[axis] for axis, part in self.solve(x).items()])

    def _update_noise(self, solved: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
        """The autoregression of the residuals of each axis by least squares, and the std of what it cannot predict."""
        for axis in AXES:
            past, now = [], []
            for flight in self.flights:
                target, columns = self.equations(flight, self.x)[axis]
                left = target - columns @ solved[axis][0]
                left = left - left[flight.rows].mean()
                lags = np.stack([np.concatenate([np.zeros(k), left[:-k]]) for k in range(1, ORDER + 1)], axis=1)
                past.append(lags[flight.rows])
                now.append(left[flight.rows])
            a, b = np.concatenate(past), np.concatenate(now)
            self.colour[axis] = np.linalg.lstsq(a, b, rcond=None)[0]
            self.scale[axis] = float(np.std(b - a @ self.colour[axis]))

    def _finish(self) -> None:
        solved = self.solve(self.x)
        count = len(solved["Fz"][2])
        self.sigma = {axis: float(np.std(part[2])) for axis, part in solved.items()}
        free = len(self.x) + sum(len(part[0]) for part in solved.values())
        self.criterion = 2.0 * count * sum(np.log(s) for s in self.sigma.values()) + free * np.log(count)
        self.coefficients = {axis: part[0] for axis, part in solved.items()}
        self.scale = dict(self.sigma)
        jacobian = np.empty((count * len(AXES), len(self.x)))
        for k, step in enumerate(1e-2 * self.size):
            ends = [self._error(np.clip(self.x + sign * step * (np.arange(len(self.x)) == k), self.low, self.high))
                    for sign in (1, -1)]  # fmt: skip
            jacobian[:, k] = (ends[0] - ends[1]) / (2 * step)
        scaled = jacobian * self.size
        normal = scaled.T @ scaled
        if np.linalg.cond(normal) > WORST_CONDITION:
            raise DataError(
                "the commands vary too little to identify how rotor speeds follow from them; add flights with quick "
                "manoeuvres"
            )
        self.covariance = np.linalg.inv(normal) * np.outer(self.size, self.size)
        # factors of the moments: their own error, and that of the map, by finite differences
        self.errors = {}
        for axis, part in solved.items():
            variance = self.sigma[axis] ** 2 * part[1]
            slopes = []
            for k, step in enumerate(1e-2 * self.size):
                moved = np.clip(self.x + step * (np.arange(len(self.x)) == k), self.low, self.high)
                slopes.append((self.solve(moved)[axis][0] - part[0]) / step)
            turn = np.array(slopes)
            self.errors[axis] = np.sqrt(np.diag(variance + turn.T @ self.covariance @ turn))

    def places(self, axis: str) -> dict[str, list[float]]:
        """Moment per N of thrust of each rotor: "value", "std" (4,) m, each rotor by itself."""
        found = []
        for flight in self.flights:
            thrust = _block_means(self.thrusts(flight, self.x)[0], flight.fine)
            target, columns = self.equations(flight, self.x)[axis]
            both = np.column_stack([target, 0.5 * (thrust[1:] + thrust[:-1]), columns[:, 1:]])
            both = lfilter(np.concatenate([[1.0], -self.colour[axis]]), [1.0], both, axis=0)[flight.rows]
            found.append(both - both.mean(axis=0))
        table = np.concatenate(found)
        size = np.linalg.norm(table[:, 1:], axis=0)
        size = np.where(size > 0, size, 1.0)
        columns = table[:, 1:] / size
        inverse = np.linalg.pinv(columns.T @ columns)
        theta = inverse @ (columns.T @ table[:, 0])
        variance = np.var(table[:, 0] - columns @ theta)
        std = np.sqrt(variance * np.diag(inverse)) / size
        return {"value": (theta / size)[:4].tolist(), "std": std[:4].tolist()}


def thrust_shares(airframe: Airframe) -> np.ndarray:
    """Shares (4,) of the total thrust with which the moments of thrust and drag vanish; quarters on a symmetric frame.

    Raises DataError where no such shares exist, as with all hubs on one side of the cg.
    """
    rows = np.stack([np.ones(4), -airframe.hubs[:, 1], airframe.hubs[:, 0], -airframe.spin])
    shares = np.linalg.lstsq(rows, np.array([1.0, 0.0, 0.0, 0.0]), rcond=None)[0]
    if not np.all(shares > 0.0):
        raise DataError(
            f"{airframe.name}: no thrusts of the four rotors balance their moments; correct 'rotor positions'"
        )
    return shares


def _note_limits(flights: Mapping[str, pd.DataFrame], chosen: Mapping[str, np.ndarray], notes: list[str]) -> None:
    """Report how often commands are at their limits."""
    for key, flight in flights.items():
        commands = raw_commands(flight, "share")[chosen[key]]
        full = (commands >= LIMIT).mean(axis=0) if len(commands) else np.zeros(4)
        if full.max() > 0.01:
            notes.append(
                f"flight {key}: the command of rotor {int(np.argmax(full)) + 1} is at its upper limit in "
                f"{100 * full.max():.0f} % of the rows"
            )


def _as_plain(
    fit: _Fit, form: str, kind: str, operating: float, reference: float | None, keys: list[str], airframe: Airframe,
    masses: Mapping[str, float], known: Mapping[str, float],
) -> dict[str, Any]:  # fmt: skip
    std = dict(zip(fit.names, np.sqrt(np.diag(fit.covariance))))
    value = dict(zip(fit.names, fit.x))

    def entry(name: str, unit: str) -> dict[str, Any]:
        return {"value": float(value[name]), "std": float(std[name]), "unit": unit}

    factors = np.array([fit.thrusts(f, fit.x)[2] for f in fit.flights])
    common = np.exp(np.mean(np.log(factors), axis=0))  # N at the operating point, per rotor
    trims = np.sqrt(factors / common)
    mass = float(np.mean([masses[k] for k in keys]))
    factor, scale = _thrust_factor(airframe, mass, known)
    relative_map = _relative_error(fit)
    scatter = float(np.std(np.log(trims), ddof=1)) if len(keys) > 1 else None
    total = float(np.hypot(relative_map, scatter or 0.0))
    arms = {axis: {"value": float(fit.coefficients[axis][0]), "std": float(fit.errors[axis][0])} for axis in AXES[1:]}
    return {
        "source": "commands",
        "input": kind,
        "form": form,
        "parameters": {n: entry(n, "") for n in FORMS[form].names},
        "operating command": operating,
        "reference voltage": reference,
        "voltage exponent": entry("voltage exponent", "") if fit.with_voltage else None,
        "speeds": {"value": np.sqrt(common / factor).tolist(), "unit": "rad/s"},
        "time constant": entry("time constant", "s"),
        "delay": entry("delay", "s"),
        "estimated": list(fit.names),
        "covariance": fit.covariance.tolist(),
        "relative error": {"map": relative_map, "between flights": scatter, "total": total},
        "scale": {**scale, "thrust factor": {"value": factor, "unit": "N s2/rad2"}, "shares": fit.shares.tolist(),
                  "trimmed": True},
        "factors": arms,
        "trims": {key: row.tolist() for key, row in zip(keys, trims)},
        "disturbance": {axis: colour.tolist() for axis, colour in fit.colour.items()},
        "flights": keys,
    }  # fmt: skip


def _thrust_factor(airframe: Airframe, mass: float, known: Mapping[str, float]) -> tuple[float, dict[str, Any]]:
    """Thrust over squared speed of one rotor, N s2/rad2, by which speeds get their unit; and what fixes it."""
    if known.get("thrust factor"):
        return float(known["thrust factor"]), {"relative": False, "from": "configured thrust factor"}
    if known.get("hover speed"):
        factor = mass * GRAVITY / (4.0 * float(known["hover speed"]) ** 2)
        return factor, {"relative": False, "from": "configured hover speed"}
    factor = NOMINAL_THRUST_COEFFICIENT * AIR_DENSITY * np.pi * airframe.radius**4
    return float(factor), {
        "relative": True,
        "from": f"nominal thrust coefficient {NOMINAL_THRUST_COEFFICIENT:.4f} of T = C rho A (W R)2",
    }


def _relative_error(fit: _Fit) -> float:
    """Root mean square, over compared rows, of the relative error of the speeds from the map's parameters."""
    total, count = 0.0, 0
    for flight in fit.flights:
        centre = np.log(np.maximum(fit.thrusts(flight, fit.x)[1][flight.used], 1e-9))
        slopes = []
        for k, step in enumerate(1e-2 * fit.size):
            moved = np.clip(fit.x + step * (np.arange(len(fit.x)) == k), fit.low, fit.high)
            there = np.log(np.maximum(fit.thrusts(flight, moved)[1][flight.used], 1e-9))
            slopes.append((there - centre) / step)
        a = np.stack(slopes, axis=-1)
        total += float(np.einsum("nrk,kl,nrl->", a, fit.covariance, a))
        count += centre.size
    return float(np.sqrt(total / max(count, 1)))


def _note_errors(drive: Mapping[str, Any], notes: list[str]) -> None:
    error, scale = drive["relative error"], drive["scale"]
    notes.append(
        f"rotor speeds are estimated from commands, +- {100 * error['total']:.1f} % "
        f"({drive['form']} map, time constant {1e3 * drive['time constant']['value']:.0f} ms, delay "
        f"{1e3 * drive['delay']['value']:.0f} ms)"
    )
    if scale["relative"]:
        notes.append(
            f"rotor speeds are relative: their scale is fixed by a {scale['from']}; give 'hover speed' (rad/s) or "
            "'thrust factor' (N s2/rad2) in the quadrotor configuration"
        )


def rotor_speeds_of(
    flights: Mapping[str, pd.DataFrame],
    airframe: Airframe,
    masses: Mapping[str, float],
    quadrotor: Mapping[str, Any],
    ratio: float = 1.0,
) -> tuple[dict[str, Any] | None, list[str]]:
    """The section "rotor speeds" of a model and notes; (None, []) where all its flights hold measured speeds.

    flights  filtered training flights; quadrotor  its configuration ("hover speed" or "thrust factor" fix the scale)
    ratio    middle part of each flight that is used, "usable data ratio" of the model
    """
    lacking = lacking_speeds(flights)
    if not lacking:
        return None, []
    known = {key: number(quadrotor, key, "quadrotor configuration") for key in KNOWN_SCALES}
    known = {key: value for key, value in known.items() if value is not None}
    if len(known) > 1:
        raise DataError(f"the quadrotor configuration gives {' and '.join(known)}; give one of them")
    if any(not value > 0.0 for value in known.values()):
        raise DataError(f"the quadrotor configuration: '{next(iter(known))}' must be positive")
    unknown = [key for key in flights if masses.get(key) is None]
    if unknown:
        raise DataError(f"flight {unknown[0]}: the mass is unknown; fill in 'Mass' in the logbook")
    chosen = {}
    for key in lacking:
        chosen[key] = np.zeros(len(flights[key]), bool)
        middle = usable(len(flights[key]), ratio)
        chosen[key][middle] = used_rows(flights[key])[middle]
    drive, notes = identify_rotor_speeds({key: flights[key] for key in lacking}, airframe, masses, known, chosen)
    drive["estimated flights"] = lacking
    return drive, notes


def factors_of(drive: Mapping[str, Any], airframe: Airframe) -> dict[str, Any]:
    """Entries of the simple model: thrust and torque factors on squared speeds, from the joint identification."""
    factor = float(drive["scale"]["thrust factor"]["value"])
    # all thrust factors follow from the scale; what the commands leave open is how thrust changes with them
    error = 2.0 * float(drive["relative error"]["map"]) * factor
    lever = {
        "kappaMx": ("Mx", float(np.mean(np.abs(airframe.hubs[:, 1])))),
        "kappaMy": ("My", float(np.mean(np.abs(airframe.hubs[:, 0])))),
        "kappaMz": ("Mz", 1.0),
    }
    beside = {"fitted beside": [], "estimated": "jointly with the rotor speeds"}
    found: dict[str, Any] = {"kappaFz": {"value": factor, "std": error, "unit": "N s2/rad2", **beside}}
    for name, (axis, arm) in lever.items():
        part = drive["factors"][axis]
        found[name] = {
            "value": factor * arm * part["value"], "std": factor * arm * part["std"], "unit": "N m s2/rad2", **beside
        }  # fmt: skip
    return found


def places_of(drive: Mapping[str, Any]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """{axis: (moment per N of thrust of each rotor (4,) m, standard errors)} as `geometry` compares them."""
    return {axis: (np.array(p["value"]), np.array(p["std"])) for axis, p in drive["geometry"].items()}


def actuators_of(drive: Mapping[str, Any]) -> dict[str, Any]:
    """The section "actuators" of a model whose rotor speeds are all estimated: one lag for the four rotors."""
    lag, late = drive["time constant"], drive["delay"]

    def four(entry: Mapping[str, Any]) -> dict[str, Any]:
        return {"value": [entry["value"]] * 4, "std": [entry["std"]] * 4, "unit": "s", "spread": None}

    return {
        "time constants": four(lag),
        "time constants up": four(lag),
        "time constants down": four(lag),
        "delay": four(late),
        "spread": None,
        "per flight": {},
        "flights": {},
        "command map": None,
        "source": "identified jointly with thrust and torque factors",
    }
