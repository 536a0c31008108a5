"""How the rotors follow their commands: time constants up and down, delay, the map from command to speed.

    dW/dt = (wanted(t - delay) - W) / tau,    tau = tau_up where wanted > W, else tau_down
    wanted = commanded speed, or (V / V_ref)^n (a0 + a1 c + a2 c^2) of the commanded share c of the motor output range

The equation is run over the flight and its speed compared with the measured one (output error), so that noise of the
measured speed does not bias the constants, as it does where measured speeds stand on both sides of a regression.
Commands and speeds must have gone through the same filter; a filter of both leaves the equation as it is.
Where disturbances of the rotors come back as commands of the controller, lag and delay are biased all the same; gaps
use `quasi.gap.levels.drive.prediction`.

Source: QuaSI user manual V1.0.a, listing 4 ("show actuator constant estimation"); Klein & Morelli, Aircraft System
Identification, 2006, section 6.3 (output error by modified Newton-Raphson).
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.identification.flight_scatter import variance_between
from quasi.identification.lag_fit import NO_SLOPES, fit_damped, follow
from quasi.identification.regression import bartlett, memory_windows
from quasi.tables import TELEMETRY_AGE_REMOVED
from quasi.terms.rotor_map import DELAY_RANGE, LOW_VOLTAGE, ROTOR_NUMBERS, STEADY_VOLTAGE, TAU_RANGE

STRETCH_WARM_UP = 0.2  # s after the start of a stretch that is not compared: the starting speed is a noisy one
COMPARED_RATE_HZ = 125.0  # Hz at which speeds are compared
FEWEST_ROWS = 100  # compared rows
LIVELY = 0.02  # a rotor whose speed varies less than this share of its mean gives no time constant
WORST_NORMAL_CONDITION = 1e14  # of the normal equations of scaled columns
POWERS = [0, 1, 2]


class Lag(NamedTuple):
    """How one rotor follows its command.

    tau, up, down, delay in s; std {name: standard error}, robust to autocorrelation; map (3,) rad/s and its voltage
    exponent where only a share is commanded, gain and offset (rad/s) of the steady speed where a speed is;
    explained: share of the speed's variance.
    """

    tau: float
    up: float
    down: float
    delay: float
    std: dict[str, float]
    map: list[float] | None
    exponent: float | None
    explained: float


def rotor_lag(
    t: np.ndarray,
    command: np.ndarray,
    speed: np.ndarray,
    rows: np.ndarray,
    commands_speed: bool,
    voltage: np.ndarray | None = None,
    reference: float = 1.0,
) -> Lag | str:
    """The lag of one rotor behind its command, or a few words why there is none.

    t               (n,) s, uniform
    command         (n,) commanded speed (rad/s) when commands_speed, else share of the motor output range
    speed           (n,) measured, rad/s, filtered as the command is; rows (n,) bool, those to compare
    voltage         (n,) V, as a share of a reference voltage, where the wanted speed may go with the battery
    """
    dt = float(np.median(np.diff(t)))
    finite = np.isfinite(command) & np.isfinite(speed)
    if voltage is not None:
        finite &= np.isfinite(voltage) & (voltage > LOW_VOLTAGE * reference)
        if np.std(voltage[finite & rows]) < STEADY_VOLTAGE * reference:
            voltage = None
    start = finite & ~np.concatenate([[False], finite[:-1]])
    start |= ~finite
    age = np.arange(len(t)) - np.maximum.accumulate(np.where(start, np.arange(len(t)), 0))
    use = rows & finite & (age * dt > STRETCH_WARM_UP)
    every = max(round(1.0 / (COMPARED_RATE_HZ * dt)), 1)
    # one compared row per group of neighbours: where rows were drawn at random, whichever trains
    groups, places = np.unique(np.flatnonzero(use) // every, return_index=True)
    chosen = np.flatnonzero(use)[places]
    if len(chosen) < FEWEST_ROWS:
        return f"has {len(chosen)} rows with command and speed"
    target = speed[chosen]
    if np.std(target) < LIVELY * np.mean(np.abs(target)):
        return "hardly changes its speed"
    command, speed = np.where(finite, command, 0.0), np.where(finite, speed, 0.0)
    ratio = np.log(np.where(finite, voltage, reference) / reference) if voltage is not None else None
    scale = float(np.std(target))
    powers = np.stack([command**p for p in ([0, 1] if commands_speed else POWERS)], axis=1)
    out = np.empty(len(t))

    def predict(x: np.ndarray, slopes: np.ndarray = NO_SLOPES) -> np.ndarray:
        """Speeds that are compared, by up, down, delay and map; slopes, where they are asked, take all rows."""
        moves = powers if voltage is None else np.exp(x[-1] * ratio)[:, None] * powers
        wanted = moves @ x[3 : 3 + powers.shape[1]]
        if voltage is not None:
            moves = np.column_stack([moves, wanted * ratio])
        follow(wanted, speed, start, x[2] / dt, dt, x[0], x[1], out, moves if len(slopes) else NO_SLOPES, slopes)
        return out[chosen].copy()

    def slopes(x: np.ndarray) -> np.ndarray:
        rows = np.empty((len(t), len(x)))
        predict(x, rows)
        return rows[chosen]

    def alike(x: np.ndarray) -> np.ndarray:
        """Values of a rotor that speeds up as it slows down."""
        return np.concatenate([x[:1], x])

    shape = _first_map(command[chosen], target, commands_speed, voltage is not None)
    one = _fit(lambda x: predict(alike(x)), lambda x: _summed(slopes(alike(x))), target, [0.03, 0.0, *shape], 1)
    if isinstance(one, str):
        return one
    two = _fit(predict, slopes, target, alike(one[0]).tolist(), 2)
    if isinstance(two, str):
        return two
    values, jacobian, residual = two
    std, alone = standard_errors(jacobian, residual, groups), standard_errors(one[1], one[2], groups)
    if std is None or alone is None:
        return "moves too little to separate its constants"
    names = ["up", "down", "delay", "offset" if commands_speed else "a0", "gain" if commands_speed else "a1"]
    names += [] if commands_speed else ["a2", "exponent"][: len(values) - 5]
    return Lag(
        tau=float(one[0][0]),
        up=float(values[0]),
        down=float(values[1]),
        delay=float(values[2]),
        std={"tau": float(alone[0]), **{name: float(s) for name, s in zip(names, std)}},
        map=values[3 : 3 + powers.shape[1]].tolist(),
        exponent=None if commands_speed else float(values[6]) if voltage is not None else 0.0,
        explained=1.0 - float(residual @ residual) / (scale**2 * len(target)),
    )


def standard_errors(jacobian: np.ndarray, residual: np.ndarray, rows: np.ndarray) -> np.ndarray | None:
    """Standard errors (p,) of least-squares values, robust to autocorrelation; None when they cannot be separated.

    jacobian (n, p) of the prediction; residual (n,); rows (n,) their places in time, increasing
    """
    scale = np.linalg.norm(jacobian, axis=0)
    if not np.all(scale > 0):
        return None
    scaled = jacobian / scale
    normal = scaled.T @ scaled
    if np.linalg.cond(normal) > WORST_NORMAL_CONDITION:
        return None
    bread = np.linalg.inv(normal)
    scores = scaled * residual[:, None]
    bandwidth = max(memory_windows(np.vstack([residual, scores.T]), [rows]))
    covariance = bread @ bartlett(scores, [rows], bandwidth) @ bread
    return np.sqrt(np.diag(covariance)) / scale


def _first_map(command: np.ndarray, target: np.ndarray, commands_speed: bool, has_volts: bool) -> np.ndarray:
    """Map of the steady state, as a start: the regression of speed on command."""
    if commands_speed:
        return np.array([0.0, 1.0])
    columns = np.column_stack([np.ones_like(command), command, command**2])
    return np.concatenate([np.linalg.lstsq(columns, target, rcond=None)[0], np.zeros(int(has_volts))])


def _summed(slopes: np.ndarray) -> np.ndarray:
    """Slopes (n, p - 1) where time constants up and down are one."""
    return np.column_stack([slopes[:, 0] + slopes[:, 1], slopes[:, 2:]])


def _fit(
    run, slopes, target: np.ndarray, begin: list[float], lags: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | str:
    """Values, Jacobian and residual of the best fit, or why there are none.

    The first `lags` values are time constants, the next the delay; what follows is free.
    """
    free = len(begin) - lags - 1
    low = np.array([TAU_RANGE[0]] * lags + [DELAY_RANGE[0]] + [-np.inf] * free)
    high = np.array([TAU_RANGE[1]] * lags + [DELAY_RANGE[1]] + [np.inf] * free)
    size = np.array([0.01] * lags + [0.005] + [max(abs(v), 0.1) for v in begin[lags + 1 :]])
    x, jacobian, predicted = fit_damped(run, slopes, target, np.array(begin), (low, high), size)
    if np.any(x[:lags] <= TAU_RANGE[0]) or np.any(x[:lags] >= TAU_RANGE[1]) or x[lags] >= DELAY_RANGE[1]:
        return "does not follow its command with a lag"
    return x, jacobian, target - predicted


def flight_lags(flight: pd.DataFrame, rows: np.ndarray, reference: float | None = None) -> list[Lag] | str:
    """The lags of the four rotors of a flight, or a few words why there are none.

    flight     columns t, w1.., and w1_CMD.. or command1..; battery_voltage is used where it is logged
    rows       (n,) bool, those to compare; reference  voltage at which the map holds, V
    """
    direct = all(f"w{i}_CMD" in flight and np.isfinite(flight[f"w{i}_CMD"]).any() for i in ROTOR_NUMBERS)
    shares = all(f"command{i}" in flight and np.isfinite(flight[f"command{i}"]).any() for i in ROTOR_NUMBERS)
    if not direct and not shares:
        return "logs no rotor command"
    voltage = flight["battery_voltage"].to_numpy(float) if reference and "battery_voltage" in flight else None
    lags = []
    for i in ROTOR_NUMBERS:
        name = f"w{i}_CMD" if direct else f"command{i}"
        lag = rotor_lag(
            flight["t"].to_numpy(float), flight[name].to_numpy(float), flight[f"w{i}"].to_numpy(float),
            np.asarray(rows, bool), direct, None if direct else voltage, reference or 1.0,
        )  # fmt: skip
        if isinstance(lag, str):
            return f"rotor {i} {lag}"
        lags.append(lag)
    return lags


def actuators(
    flights: Mapping[str, pd.DataFrame],
    rows: Mapping[str, np.ndarray],
    notes: list[str],
    configured: Mapping[str, Any] | None = None,
    aged: Mapping[str, bool] | None = None,
) -> dict[str, Any] | None:
    """Constants of the four rotors, medians over flights with their spread; None when no flight gives any.

    flights     filtered training flights; rows {flight: (n,) bool} those to compare; notes  is added to
    configured  the quadrotor's given map from command to speed, which stands instead of a fitted one
    aged        {flight: whether import took the age of its rotor telemetry off}, flights that know it
    Where import took it off in some flights, the delay is that of these alone: in the others it holds the age too.
    """
    reference = _reference(flights, rows)
    found: dict[str, list[Lag]] = {}
    for key, flight in flights.items():
        lags = flight_lags(flight, rows[key], reference)
        if isinstance(lags, str):
            notes.append(f"flight {key}: {lags}; it does not enter the actuator constants")
        else:
            found[key] = lags
    given = None if configured is None else {**configured, "source": "configured"}
    if not found:
        return None
    result: dict[str, Any] = {}
    for name, field in (
        ("time constants", "tau"),
        ("time constants up", "up"),
        ("time constants down", "down"),
        ("delay", "delay"),
    ):
        lags_by_flight = _without_age(found, aged or {}) if name == "delay" else found
        values = np.array([[getattr(lag, field) for lag in lags] for lags in lags_by_flight.values()])
        errors = np.array([[lag.std[field] for lag in lags] for lags in lags_by_flight.values()])
        result[name] = {"value": np.median(values, axis=0).tolist(), "std": _std(values, errors), "unit": "s",
                        "spread": _spread(values)}  # fmt: skip
    result["spread"] = result["time constants"]["spread"]
    result["per flight"] = {key: [lag.tau for lag in lags] for key, lags in found.items()}
    result["flights"] = {key: _plain(lags) for key, lags in found.items()}
    _report_telemetry_age(found, aged or {}, result, notes)
    result["command map"] = given or _map(found, reference)
    _warn(found, result, notes)
    return result


def _without_age(found: Mapping[str, list[Lag]], aged: Mapping[str, bool]) -> Mapping[str, list[Lag]]:
    """The flights whose delay is the rotors' alone; all of them where there are none."""
    return {key: lags for key, lags in found.items() if aged.get(key)} or found


def _report_telemetry_age(
    found: Mapping[str, list[Lag]], aged: Mapping[str, bool], result: dict[str, Any], notes: list[str]
) -> None:
    """Say of every delay whether it holds the age of the rotor telemetry, as far as it is known."""
    for key in found:
        if key in aged:
            result["flights"][key]["delay"][TELEMETRY_AGE_REMOVED] = bool(aged[key])
    rest = [key for key in found if not aged.get(key)]
    if len(rest) < len(found) or all(key in aged for key in found):
        result["delay"][TELEMETRY_AGE_REMOVED] = len(rest) < len(found)
    if rest and len(rest) < len(found):
        notes.append(
            f"the rotors' delay is that of {len(found) - len(rest)} of {len(found)} flights: in {', '.join(rest)} "
            "import could not take off the age of the rotor telemetry, so that the delay there holds it too"
        )
    elif rest and TELEMETRY_AGE_REMOVED in result["delay"]:
        notes.append(
            "no flight gave the age of its rotor telemetry, so that the rotors' delay includes it; quick yaw inputs "
            "would show it"
        )


def _reference(flights: Mapping[str, pd.DataFrame], rows: Mapping[str, np.ndarray]) -> float | None:
    medians = [
        np.nanmedian(flight["battery_voltage"].to_numpy(float)[rows[key]])
        for key, flight in flights.items()
        if "battery_voltage" in flight and np.isfinite(flight["battery_voltage"].to_numpy(float)[rows[key]]).any()
    ]
    return float(np.median(medians)) if medians and np.median(medians) > 0 else None


def _std(values: np.ndarray, errors: np.ndarray) -> list[float]:
    """Standard errors (4,) of the medians: from the spread over flights where three or more give it. Of two flights
    their own errors stand, and what the flights differ by beyond these."""
    own = np.linalg.norm(errors, axis=0) / len(values)
    if len(values) == 2:
        between = [variance_between(v, e**2) for v, e in zip(values.T, errors.T)]
        return np.sqrt(own**2 + np.array(between) / 2.0).tolist()
    return (own if len(values) < 2 else 1.2533 * np.std(values, axis=0, ddof=1) / np.sqrt(len(values))).tolist()


def _spread(values: np.ndarray) -> list[float] | None:
    return np.std(values, axis=0, ddof=1).tolist() if len(values) > 1 else None


def _plain(lags: list[Lag]) -> dict[str, Any]:
    names = {"time constants": "tau", "time constants up": "up", "time constants down": "down", "delay": "delay"}
    return {
        name: {"value": [getattr(lag, f) for lag in lags], "std": [lag.std[f] for lag in lags]}
        for name, f in names.items()
    } | {"explained": [lag.explained for lag in lags]}


def _map(found: Mapping[str, list[Lag]], reference: float | None) -> dict[str, Any] | None:
    mapped = [lags for lags in found.values() if lags[0].exponent is not None]
    if not mapped:
        return None
    # the rotors of a flight share its battery and its reading: only flights are independent
    each = [lags for lags in mapped if all("exponent" in lag.std for lag in lags)]
    # a flight at a steady voltage gives a map at that voltage, not at the reference
    maps = np.array([[lag.map for lag in lags] for lags in each or mapped])
    exponents = np.array([np.median([lag.exponent for lag in lags]) for lags in each])
    errors = np.array([np.mean([lag.std["exponent"] for lag in lags]) for lags in each])
    return {
        "coefficients": np.median(maps, axis=(0, 1)).tolist(),
        "powers": POWERS,
        "unit": "rad/s",
        "per rotor": np.median(maps, axis=0).tolist(),
        "voltage exponent": {
            "value": float(np.median(exponents)) if each else 0.0,
            "std": _std(exponents[:, None], errors[:, None])[0] if each else None,
        },
        "reference voltage": reference if each else None,
        "source": f"fitted on {len(maps)} training flights",
    }


def _warn(found: Mapping[str, list[Lag]], result: Mapping[str, Any], notes: list[str]) -> None:
    poor = [key for key, lags in found.items() if min(lag.explained for lag in lags) < 0.8]
    if poor:
        notes.append(
            f"commands explain less than 80 % of the rotor speeds in {', '.join(poor)}; a first-order lag does not "
            "describe these rotors"
        )
    early = [f"{i} ({d * 1e3:.1f} ms)" for i, d in enumerate(result["delay"]["value"], 1) if d < -1e-3]
    if early:
        notes.append(
            f"rotors answer before their command: delay of rotor {', '.join(early)}; check the log's time stamps. ESCs "
            "that control the rotor speed show this too: they answer at once and settle late, which no first-order lag "
            "describes"
        )
    gains = [lag.map[1] for lags in found.values() for lag in lags if lag.exponent is None]
    if gains and abs(np.median(gains) - 1.0) > 0.1:
        notes.append(
            f"rotors reach {100 * np.median(gains):.0f} % of what is added to their commanded speed; check the command "
            "map or the pole count"
        )
