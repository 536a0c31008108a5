"""The joint fit of one form of the map from commands to rotor speeds, and of thrust and torque factors.

Equations, disturbance model and sources stand in `rotor_speeds`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.signal import lfilter

from quasi.airframe import Airframe
from quasi.errors import DataError
from quasi.identification.regression import ends_within
from quasi.terms.rotor_map import (
    FORMS,
    RAW,
    WARM_UP_NAMES,
    cold_surplus,
    lagged,
    ranges_of,
    raw_commands,
    raw_volts,
    shape,
)

COMPARED_STEP = 0.01  # s between compared rows: half the shortest lag of a brushed motor, and no finer than slow logs
# of the autoregressive disturbance, 0.12 s: on nanobench the factors rise up to there and are level up to 0.2 s
DISTURBANCE_ORDER = 12
DISTURBANCE_ROUNDS = 3  # disturbance model and map are estimated in turn
WORST_JOINT_CONDITION = 1e12  # of the normal equations of scaled parameters; beyond it doubles hold no digits
JOINT_AXES = ("Fz", "Mx", "My", "Mz")


@dataclass
class PreparedFlight:
    """One flight, averaged to about COMPARED_STEP.

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


def prepare_flight(
    flight: pd.DataFrame, used: np.ndarray, airframe: Airframe, mass: float, kind: str,
    point: tuple[float, float | None],
) -> PreparedFlight:  # fmt: skip
    """point  operating command and reference voltage, V or None"""
    operating, reference = point
    t = flight["t"].to_numpy(float)
    dt = float(np.median(np.diff(t)))
    fine = max(round(COMPARED_STEP / dt), 1)

    def mean(values: np.ndarray) -> np.ndarray:
        return block_means(values, fine)

    def raw(name: str) -> np.ndarray:
        return mean(flight[f"{name}{RAW}"].to_numpy(float))

    h = fine * dt
    rates = np.stack([raw(n) for n in "pqr"], axis=1)
    slope = np.diff(rates, axis=0) / h
    middle = 0.5 * (rates[1:] + rates[:-1])
    inertia = np.asarray(airframe.inertia, float)
    moments = slope @ inertia.T + np.cross(middle, middle @ inertia.T)
    lift = mass * raw("az")
    # like the rates' slopes, between two blocks
    targets = {"Fz": 0.5 * (lift[1:] + lift[:-1]), **{axis: moments[:, i] for i, axis in enumerate(JOINT_AXES[1:])}}
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
    return PreparedFlight(
        fine,
        dt,
        h,
        raw_commands(flight, kind) / operating,
        ratio,
        targets,
        columns,
        rows & (age > DISTURBANCE_ORDER),
        used,
        weight,
    )


def block_means(values: np.ndarray, size: int) -> np.ndarray:
    """Means (M, ...) over blocks of `size` rows of (N, ...)."""
    count = len(values) // size
    return values[: count * size].reshape(count, size, *values.shape[1:]).mean(axis=1)


class JointFit:
    """One form of the map on all flights: parameters x = time constant, delay, shape, voltage exponent, warm-up."""

    def __init__(
        self,
        form: str,
        flights: Sequence[PreparedFlight],
        airframe: Airframe,
        with_voltage: bool,
        warming: bool = False,
    ) -> None:
        self.form, self.flights, self.airframe = form, flights, airframe
        about = FORMS[form]
        self.names = ("time constant", "delay", *about.names, *(("voltage exponent",) if with_voltage else ()))
        self.names += WARM_UP_NAMES if warming else ()
        volts, warm = int(with_voltage), int(warming)
        self.low, self.high = ranges_of(form, self.names)
        self.size = np.array([0.01, 0.005, *[0.2] * (len(about.low) + volts), *[0.02, 2.0] * warm])
        self.x = np.array([0.04, 0.005, *about.start, *[0.7] * volts, *[0.02, 10.0] * warm])
        self.warming = warming
        self.shares = thrust_shares(airframe)
        self.colour = {axis: np.zeros(DISTURBANCE_ORDER) for axis in JOINT_AXES}
        self.scale = dict.fromkeys(JOINT_AXES, 1.0)
        self.with_voltage = with_voltage
        self.independent = 1.0  # independent rows of the vertical force over all its rows
        self.covariance = np.zeros((len(self.x), len(self.x)))

    def thrusts(self, flight: PreparedFlight, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Thrusts (N, 4), N, on the flight's grid, their rotors' speeds over the square root of N, factors (4,)."""
        parts = len(FORMS[self.form].names)
        exponent = x[2 + parts] if self.with_voltage else 0.0
        speeds = shape(self.form, flight.commands, flight.ratio, exponent, x[2 : 2 + parts])
        if self.warming:
            speeds = speeds * cold_surplus(flight.commands, flight.dt, *x[-2:])
        speeds = lagged(speeds, flight.dt, x[0], x[1])
        mean = np.mean(speeds[flight.used] ** 2, axis=0)
        factor = self.shares * flight.thrust / np.maximum(mean, 1e-12)
        return speeds**2 * factor, speeds * np.sqrt(factor), factor

    def equations(self, flight: PreparedFlight, x: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """{axis: (target (M,), columns (M, k))}; the first column of a moment is that of its factor."""
        thrust, speeds, _ = self.thrusts(flight, x)
        blocks, turning = (block_means(v, flight.fine) for v in (thrust, speeds))
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

    def whitened(self, x: np.ndarray, axes: Sequence[str] = JOINT_AXES) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """{axis: (target, columns)} of all compared rows; moments through the inverse of the disturbance model, about
        the means of each flight. Vertical force is compared as it is: its signal is slow, and so is its feedback."""
        found: dict[str, list] = {axis: [] for axis in axes}
        for flight in self.flights:
            equations = self.equations(flight, x)
            for axis in axes:
                target, columns = equations[axis]
                both = np.column_stack([target, columns])
                if axis != "Fz":
                    both = lfilter(np.concatenate([[1.0], -self.colour[axis]]), [1.0], both, axis=0)
                both = both[flight.rows]
                found[axis].append(both - both.mean(axis=0))
        return {axis: ((b := np.concatenate(parts))[:, 0], b[:, 1:]) for axis, parts in found.items()}

    def solve(
        self, x: np.ndarray, axes: Sequence[str] = JOINT_AXES
    ) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """{axis: (coefficients, their covariance up to the variance, residual)}."""
        found = {}
        for axis, (target, columns) in self.whitened(x, axes).items():
            size = np.linalg.norm(columns, axis=0)
            size = np.where(size > 0, size, 1.0)
            scaled = columns / size
            inverse = np.linalg.inv(scaled.T @ scaled + 1e-12 * np.eye(len(size)))
            theta = inverse @ (scaled.T @ target)
            found[axis] = theta / size, inverse / np.outer(size, size), target - scaled @ theta
        return found

    def run(self, begin: "JointFit | None" = None) -> None:
        """Estimate the parameters; those that another fit shares with this one start there."""
        if begin is not None:
            self.colour, self.scale = dict(begin.colour), dict(begin.scale)
            self.independent = begin.independent
            shared = dict(zip(begin.names, begin.x))
            own = () if begin.form == self.form else FORMS[self.form].names
            self.x = np.array([shared[n] if n not in own and n in shared else v
                               for n, v in zip(self.names, self.x)])  # fmt: skip
        else:
            self.update_noise(self.solve(self.x))
        for _ in range(DISTURBANCE_ROUNDS if begin is None else DISTURBANCE_ROUNDS - 1):
            found = least_squares(
                self._error, self.x, bounds=(self.low, self.high), x_scale=self.size, diff_step=1e-2, xtol=1e-5,
                ftol=1e-6, max_nfev=25,
            )  # fmt: skip
            self.x = found.x
            self.update_noise(self.solve(self.x))
        self._finish()

    def improvement(self, other: "JointFit") -> float:
        """By how much another map lowers twice the negative log-likelihood, with the disturbance model of this one."""
        keep = other.colour, other.scale
        other.colour, other.scale = self.colour, self.scale
        gain = float(np.sum(self._error(self.x) ** 2) - np.sum(other._error(other.x) ** 2))
        other.colour, other.scale = keep
        return gain

    def _error(self, x: np.ndarray) -> np.ndarray:
        return self._weighed(self.solve(x))

    def _weighed(self, solved: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> np.ndarray:
        return np.concatenate([part[2] / self.scale[axis] for axis, part in solved.items()])

    def update_noise(self, solved: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
        """The autoregression of the residuals of each axis by least squares, and the std of what it cannot predict.

        Flights are not weighed by their noise: quiet ones have the smallest residuals, but the strongest feedback.
        """
        equations = [self.equations(flight, self.x) for flight in self.flights]
        for axis in JOINT_AXES:
            past, now = [], []
            for flight, known in zip(self.flights, equations):
                target, columns = known[axis]
                left = target - columns @ solved[axis][0]
                left = left - left[flight.rows].mean()
                lags = np.stack(
                    [np.concatenate([np.zeros(k), left[:-k]]) for k in range(1, DISTURBANCE_ORDER + 1)], axis=1
                )
                past.append(lags[flight.rows])
                now.append(left[flight.rows])
            a, b = np.concatenate(past), np.concatenate(now)
            self.colour[axis] = np.linalg.lstsq(a, b, rcond=None)[0]
            self.scale[axis] = float(np.std(b - a @ self.colour[axis]))
            if axis == "Fz":  # about its mean over many memories: the spectrum of the residuals at frequency 0
                slow = self.scale[axis] / max(1.0 - float(np.sum(self.colour[axis])), 0.01)
                self.independent = min((float(np.std(b)) / slow) ** 2, 1.0)
                self.scale[axis] = max(slow, float(np.std(b)))

    def _finish(self) -> None:
        solved = self.solve(self.x)
        count = len(solved["Fz"][2])
        self.sigma = {axis: float(np.std(part[2])) for axis, part in solved.items()}
        self.count, self.free = count, len(self.x) + sum(len(part[0]) for part in solved.values())
        self.coefficients = {axis: part[0] for axis, part in solved.items()}
        self.scale = {a: s / np.sqrt(self.independent if a == "Fz" else 1.0) for a, s in self.sigma.items()}
        jacobian = np.empty((count * len(JOINT_AXES), len(self.x)))
        ends = [ends_within(self.x, k, step, self.low, self.high) for k, step in enumerate(1e-2 * self.size)]
        sides = [(self.solve(up), self.solve(down), apart) for up, down, apart in ends]
        for k, (above, below, apart) in enumerate(sides):
            jacobian[:, k] = (self._weighed(above) - self._weighed(below)) / apart
        scaled = jacobian * self.size
        normal = scaled.T @ scaled
        if np.linalg.cond(normal) > WORST_JOINT_CONDITION:
            raise DataError(
                "the commands vary too little to identify how rotor speeds follow from them; add flights with quick "
                "manoeuvres"
            )
        self.covariance = np.linalg.inv(normal) * np.outer(self.size, self.size)
        # factors of the moments: their own error, and that of the map, by finite differences
        self.errors = {}
        for axis, part in solved.items():
            variance = self.scale[axis] ** 2 * part[1]
            turn = np.array([(above[axis][0] - below[axis][0]) / apart for above, below, apart in sides])
            self.errors[axis] = np.sqrt(np.diag(variance + turn.T @ self.covariance @ turn))

    def criterion(self, independent: float) -> float:
        """BIC. independent  share of the vertical force's rows, the same for all forms that are compared."""
        rows = {axis: self.count * (independent if axis == "Fz" else 1.0) for axis in JOINT_AXES}
        return 2.0 * sum(rows[a] * np.log(s) for a, s in self.sigma.items()) + self.free * np.log(self.count)

    def places(self, axis: str) -> dict[str, list[float]]:
        """Moment per N of thrust of each rotor: "value", "std" (4,) m, each rotor by itself."""
        found = []
        for flight in self.flights:
            thrust = block_means(self.thrusts(flight, self.x)[0], flight.fine)
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
