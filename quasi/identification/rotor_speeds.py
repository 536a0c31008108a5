"""Rotor speeds of flights without rotor telemetry: the map of command and voltage, lag and delay, identified jointly
with thrust and torque factors over all training flights of a model.

Commands make speeds (`quasi.terms.rotor_map`), squared speeds make thrusts T_i, and with hub i at (x_i, y_i)

    Fz = -sum T_i + c w sum W + c (u2 + v2)         Mx = -a_x sum y_i T_i + c p + c v sum W
    My =  a_y sum x_i T_i + c q + c u sum W         Mz = -a_z sum s_i T_i + c r + c sum s_i dW_i/dt

a_x and a_y are 1 where arms, mass and inertia are as configured. In flight a controller answers every disturbance, so
that commands and disturbances are correlated and least squares underestimates the factors; it does even more so after a
zero-phase filter. Moments are therefore compared before any low-pass, as predictions one step ahead, with an
autoregressive model of the disturbance (a prediction-error method, consistent in closed loop). Fz is compared as it is.

The trim of a flight cannot be known from commands: propellers, motors and batteries differ from day to day. Each rotor
gets a factor a flight with which the flight's mean thrust and moments balance; the scatter of these factors is the
error of speeds that are estimated from commands alone.

Source: Ljung, System Identification, 2nd ed., 1999, sections 7.2, 10.2 (prediction error, generalised least squares)
and 13.4 (closed loop); Schwarz, Annals of Statistics 6, 1978 (BIC); Golub & Pereyra, SIAM J. Numer. Anal. 10, 1973.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.airframe import Airframe, number
from quasi.attitude import AIR_DENSITY, GRAVITY
from quasi.errors import DataError
from quasi.identification.flight_scatter import factor_error
from quasi.identification.joint_fit import JOINT_AXES, JointFit, prepare_flight
from quasi.identification.partition import TRAINING, UNUSED
from quasi.identification.regression import ends_within
from quasi.identification.rotor_rows import rows_in_free_air, rows_within_limits
from quasi.identification.taught_map import SHORTEST_COMPARED, teach_map, teaching_flights
from quasi.identification.yaw_fit import fit_yaw
from quasi.terms.rotor_map import (
    FORMS,
    SPEEDS,
    STEADY_VOLTAGE,
    WARM_UP_NAMES,
    ranges_of,
    raw_commands,
    raw_volts,
    used_rows,
)

# Static thrust coefficient T / (rho n2 D4) of small propellers is 0.08 to 0.14 (Deters, Ananda & Selig, AIAA 2014-2151,
# 2.25 to 9 inch); its middle, as T = C rho A (W R)2: times 4 / pi3
NOMINAL_THRUST_COEFFICIENT = 0.11 * 4.0 / np.pi**3
CONSTANT_VOLTAGE = 1e-6  # std over median: a number that stands still, as a bench supply is logged
CANDIDATES = ("linear", "square root", "quadratic", "thrust map")  # forms of maps from shares, compared by BIC
MEASURED_SPEEDS = "speeds measured in other flights"  # of the same model, which fix the scale
KNOWN_SCALES = ("hover speed", "thrust factor")  # keys of the quadrotor configuration, rad/s and N s2/rad2


def lacking_speeds(flights: Mapping[str, pd.DataFrame]) -> list[str]:
    """Keys of flights without the speeds of all four rotors."""
    return [key for key, flight in flights.items() if not all(w in flight for w in SPEEDS)]


def command_kind(*flights: pd.DataFrame) -> str | None:
    """ "speed" where filtered flights all keep commanded speeds, else "share" where all keep shares, else None."""
    kinds = ("speed", "share")
    return next((kind for kind in kinds if all(raw_commands(f, kind) is not None for f in flights)), None)


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
             or, as MEASURED_SPEEDS, the thrust factor of flights that measure speeds
    Raises DataError where the flights are too short, or their commands move too little.
    """
    notes: list[str] = []
    kind = command_kind(*flights.values())
    if kind is None:
        raise DataError(
            f"of the flights {', '.join(flights)} some log commanded speeds and some shares of the motor output range; "
            "train the model on flights of one kind, or give the quadrotor a 'command map'"
        )
    chosen = chosen or {key: used_rows(flight) for key, flight in flights.items()}
    chosen = rows_within_limits(flights, rows_in_free_air(flights, chosen, airframe), notes)
    operating, reference, steady = _operating_point(flights, chosen, kind, notes)
    point = operating, reference
    made = {k: prepare_flight(f, chosen[k], airframe, masses[k], kind, point) for k, f in flights.items()}
    made = {k: f for k, f in made.items() if f.rows.any()}
    seconds = sum(float(f.rows.sum()) * f.h for f in made.values())
    if seconds < SHORTEST_COMPARED:
        raise DataError(
            f"flights {', '.join(flights)} hold {seconds:.1f} s from which rotor speeds could be estimated, "
            f"{SHORTEST_COMPARED:g} s are needed; {'; '.join([*notes, 'add flights'])}"
        )
    names = ["speed"] if kind == "speed" else list(CANDIDATES)
    fits, begin = {}, None
    for name in names:
        fits[name] = JointFit(name, list(made.values()), airframe, reference is not None)
        fits[name].run(begin)
        if begin is None and steady and not _shows_voltage(fits[name]):
            notes.append(
                "the battery voltage hardly varies: the map from command to rotor speed is identified without it"
            )
            reference = None
            fits[name] = JointFit(name, list(made.values()), airframe, False)
            fits[name].run()
        begin = begin if begin is not None else fits[name]
    share = next(iter(fits.values())).independent
    scores = {n: fit.criterion(share) for n, fit in fits.items()}
    best = min(scores, key=lambda n: scores[n])
    fit = _with_warm_up(fits[best], notes)
    yaw = fit_yaw(fit)
    drive = _as_plain(fit, best, kind, operating, reference, list(made), airframe, masses, known or {})
    drive["yaw"] = {n: yaw[n] for n in ("time constant", "delay")} if yaw else None
    if yaw:
        drive["factors"]["Mz"] = yaw["factor"]
    for axis, factor in drive["factors"].items():
        factor["std"], factor["between flights"] = factor_error(fit, axis, factor["std"])
    drive["candidates"] = [
        {"form": n, "BIC": scores[n] - scores[best], "parameters": len(f.x)} for n, f in fits.items()
    ]
    drive["geometry"] = {axis: _places(fit, axis, drive["factors"][axis]) for axis in JOINT_AXES[1:]}
    _note_errors(drive, notes)
    return drive, notes


def _shows_voltage(fit: JointFit) -> bool:
    """Whether the flights show that speeds follow the voltage: its exponent lowers BIC."""
    place = fit.names.index("voltage exponent")
    return bool(fit.x[place] ** 2 > np.log(fit.count) * fit.covariance[place, place])


def _with_warm_up(fit: JointFit, notes: list[str]) -> JointFit:
    """The fit with motors that warm up where that lowers BIC, else the fit as it is.

    Both are compared with the disturbance model of the fit without it, which takes slow errors for noise.
    """
    warm = JointFit(fit.form, fit.flights, fit.airframe, fit.with_voltage, warming=True)
    try:
        warm.run(fit)
    except DataError:
        return fit  # cold and warm motors cannot be distinguished
    rows = sum(int(f.rows.sum()) for f in fit.flights)
    gain = fit.improvement(warm)
    penalty = len(WARM_UP_NAMES) * np.log(rows)
    if gain < penalty:
        return fit
    drop, tau = warm.x[-2:]
    notes.append(
        f"at the same command and voltage the rotors lose {100 * drop:.1f} % of their speed after take-off, with a "
        f"time constant of {tau:.0f} s, as motors that warm up do (BIC lower by {gain - penalty:.0f}); "
        "exports of the map hold warm motors"
    )
    return warm


def _places(fit: JointFit, axis: str, factor: Mapping[str, float]) -> dict[str, list[float]]:
    """Moment per N of thrust of each rotor, m; its standard errors hold those of the map and between flights, which
    scale all four rotors alike."""
    places = fit.places(axis)
    common = factor["std"] / max(abs(factor["value"]), 1e-12)
    return places | {"std": np.hypot(places["std"], common * np.abs(places["value"])).tolist()}


def _operating_point(
    flights: Mapping[str, pd.DataFrame], chosen: Mapping[str, np.ndarray], kind: str, notes: list[str]
) -> tuple[float, float | None, bool]:
    """Median command of the used rows; the median voltage, V, None where a flight logs none or it never varies; whether
    it varies so little that the flights have to show its exponent. One percent of voltage is two of thrust."""
    commands = np.concatenate([raw_commands(f, kind)[chosen[k]].ravel() for k, f in flights.items()])
    operating = float(np.median(commands)) if len(commands) else 0.0
    if not operating > 0.0:
        raise DataError(
            f"the flights {', '.join(flights)} hold no commands between 0 and their limit while they fly; check their "
            "columns and units"
        )
    if not _log_voltage(flights, notes):
        return operating, None, False
    volts = [raw_volts(f)[chosen[k]] for k, f in flights.items()]
    median = float(np.median(np.concatenate(volts)))
    varies = max(float(np.std(v)) for v in volts if len(v)) / median if median > 0.0 else 0.0
    if not varies > CONSTANT_VOLTAGE:
        notes.append("the battery voltage never varies: the map from command to rotor speed is identified without it")
        return operating, None, False
    return operating, median, varies < STEADY_VOLTAGE


def _log_voltage(flights: Mapping[str, pd.DataFrame], notes: list[str]) -> bool:
    """Whether all flights log the battery voltage; a note names those that do not."""
    silent = [k for k, f in flights.items() if raw_volts(f) is None]
    if silent:
        notes.append(
            f"flight{'s' * (len(silent) > 1)} {', '.join(silent)} log{'s' * (len(silent) == 1)} no battery voltage: "
            "the map from command to rotor speed is identified without it"
        )
    return not silent


def _as_plain(
    fit: JointFit, form: str, kind: str, operating: float, reference: float | None, keys: list[str], airframe: Airframe,
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
    commanded = float(np.mean(common)) / operating**2 if kind == "speed" else None
    factor, scale = _thrust_factor(airframe, mass, known, commanded)
    relative_map = _relative_error(fit)
    # the mean of each of the four rotors is taken off
    scatter = float(np.std(np.log(trims), ddof=4)) if len(keys) > 1 else None
    # another flight differs from the mean of these
    total = float(np.hypot(relative_map, (scatter or 0.0) * np.sqrt(1.0 + 1.0 / len(keys))))
    arms = {
        axis: {"value": float(fit.coefficients[axis][0]), "std": float(fit.errors[axis][0])} for axis in JOINT_AXES[1:]
    }
    return {
        "source": "commands",
        "input": kind,
        "form": form,
        "parameters": {n: entry(n, "") for n in FORMS[form].names},
        "operating command": operating,
        "reference voltage": reference,
        "voltage exponent": entry("voltage exponent", "") if fit.with_voltage else None,
        "speeds": {"value": np.sqrt(common / factor).tolist(), "unit": "rad/s"},
        **{n: entry(n, u) if n in fit.names else None for n, u in zip(WARM_UP_NAMES, ("", "s"))},
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


def _thrust_factor(
    airframe: Airframe, mass: float, known: Mapping[str, float], commanded: float | None
) -> tuple[float, dict[str, Any]]:
    """Thrust over squared speed of one rotor, N s2/rad2, by which speeds get their unit; and what fixes it.

    commanded  the same of commanded speeds; None of commands that are shares
    """
    if known.get("thrust factor"):
        return float(known["thrust factor"]), {"relative": False, "from": "configured thrust factor"}
    if known.get("hover speed"):
        factor = mass * GRAVITY / (4.0 * float(known["hover speed"]) ** 2)
        return factor, {"relative": False, "from": "configured hover speed"}
    if known.get(MEASURED_SPEEDS):
        return float(known[MEASURED_SPEEDS]), {"relative": False, "from": MEASURED_SPEEDS}
    if commanded is not None:
        return commanded, {"relative": False, "from": "commanded speeds"}
    factor = NOMINAL_THRUST_COEFFICIENT * AIR_DENSITY * np.pi * airframe.radius**4
    return float(factor), {
        "relative": True,
        "from": f"nominal thrust coefficient {NOMINAL_THRUST_COEFFICIENT:.4f} of T = C rho A (W R)2",
    }


def _relative_error(fit: JointFit) -> float:
    """Root mean square, over compared rows, of the relative error of the speeds from the map's parameters."""
    total, count = 0.0, 0
    for flight in fit.flights:
        slopes = []
        for k, step in enumerate(1e-2 * fit.size):
            *ends, apart = ends_within(fit.x, k, step, fit.low, fit.high)
            up, down = (np.log(np.maximum(fit.thrusts(flight, x)[1][flight.used], 1e-9)) for x in ends)
            slopes.append((up - down) / apart)
        a = np.stack(slopes, axis=-1)
        total += float(np.einsum("nrk,kl,nrl->", a, fit.covariance, a))
        count += a[..., 0].size
    return float(np.sqrt(total / max(count, 1)))


def _note_errors(drive: Mapping[str, Any], notes: list[str]) -> None:
    error, scale = drive["relative error"], drive["scale"]
    notes.append(
        f"rotor speeds are estimated from commands, +- {100 * error['total']:.1f} % ({drive['form']} map, time "
        f"constant {1e3 * drive['time constant']['value']:.0f} ms, delay {1e3 * drive['delay']['value']:.0f} ms)"
    )
    for name in ("time constant", "delay"):
        (low,), (high,) = ranges_of(drive["form"], [name])
        value, std = drive[name]["value"], drive[name]["std"]
        # a lag at its lower end is that of fast rotors
        if value >= high - std or (name == "delay" and value <= low + std):
            notes.append(
                f"the {name} of the rotors lies at the end of its range ({1e3 * low:.0f} to {1e3 * high:.0f} ms), so "
                "that lag and factors may be wrong: commands and motion are further apart; check the clock of "
                "the commands"
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
    roles: Mapping[str, np.ndarray] | None = None,
) -> tuple[dict[str, Any] | None, list[str]]:
    """The section "rotor speeds" of a model and notes; (None, []) where all its flights hold measured speeds.

    flights  filtered training flights; quadrotor  its configuration ("hover speed" or "thrust factor" fix the scale)
    roles    role codes of their rows by `partition`; a flight that trains in no row takes no part. Of the others all
             used rows do: a lag needs stretches rather than the single rows of a random draw. None takes all that are
             valid and in flight
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
    unknown = [key for key in lacking if masses.get(key) is None]
    if unknown:
        raise DataError(f"flight {unknown[0]}: the mass is unknown; fill in 'Mass' in the logbook")
    if roles is None:
        chosen = {key: used_rows(flight) for key, flight in flights.items()}
    else:
        chosen = {key: (roles[key] != UNUSED) & (roles[key] == TRAINING).any() for key in flights}
    teachers = [key for key in teaching_flights(flights) if chosen[key].any()]
    estimated = {key: flights[key] for key in lacking}
    for key, flight in estimated.items():
        _refuse_constant_commands(key, flight)
    if teachers and all(raw_commands(flight, "share") is not None for flight in estimated.values()):
        notes = [f"the flights {', '.join(teachers)} measure rotor speeds; they teach the map for {', '.join(lacking)}"]
        volts = _log_voltage(estimated, notes)
        drive = teach_map({key: flights[key] for key in teachers}, chosen, CANDIDATES, volts)
        _note_errors(drive, notes)
    else:
        measured = {k: f[chosen[k]] for k, f in flights.items() if k not in lacking and masses.get(k) is not None}
        if any(map(len, measured.values())) and not known:
            known = {MEASURED_SPEEDS: _measured_factor(measured, masses)}
        drive, notes = identify_rotor_speeds(estimated, airframe, masses, known, chosen)
    drive["estimated flights"] = lacking
    return drive, notes


def _refuse_constant_commands(key: str, flight: pd.DataFrame) -> None:
    """Raise DataError for a rotor whose command is one number all through a flight: no controller flies so."""
    kind = command_kind(flight)
    still = [str(i) for i, c in enumerate(raw_commands(flight, kind).T, 1) if np.ptp(c) == 0.0] if kind else []
    if still:
        raise DataError(
            f"flight {key}: the command of rotor {', '.join(still)} is constant all through the flight; correct the "
            "columns of the log, or leave the flight out"
        )


def _measured_factor(flights: Mapping[str, pd.DataFrame], masses: Mapping[str, float]) -> float:
    """Thrust over squared speed of one rotor, N s2/rad2, of rows that measure both: least squares of the vertical
    force on the sum of squared speeds."""
    x = np.concatenate([np.sum(f[list(SPEEDS)].to_numpy(float) ** 2, axis=1) for f in flights.values()])
    z = np.concatenate([-masses[key] * f["az"].to_numpy(float) for key, f in flights.items()])
    factor = float(x @ z / (x @ x)) if x.any() else 0.0
    if not factor > 0.0:
        raise DataError(
            f"the flights {', '.join(flights)} measure rotor speeds that carry no weight; check their columns and units"
        )
    return factor


def factors_of(drive: Mapping[str, Any], airframe: Airframe) -> dict[str, Any]:
    """Entries of the simple model: thrust and torque factors on squared speeds, from the joint identification."""
    factor = float(drive["scale"]["thrust factor"]["value"])
    # all thrust factors follow from the scale; what the commands leave open is how thrust changes with them
    error = 2.0 * float(drive["relative error"]["map"]) * factor
    # U_p and U_q count rotors left and in front as positive, U_r those that turn clockwise, whose drag is negative
    lever = {
        "kappaMx": ("Mx", float(np.mean(np.abs(airframe.hubs[:, 1])))),
        "kappaMy": ("My", float(np.mean(np.abs(airframe.hubs[:, 0])))),
        "kappaMz": ("Mz", -1.0),
    }
    how = {"fitted together with": [], "estimated": "jointly with the rotor speeds"}
    found: dict[str, Any] = {"kappaFz": {"value": factor, "std": error, "unit": "N s2/rad2", **how}}
    for name, (axis, arm) in lever.items():
        part = drive["factors"][axis]
        found[name] = {
            "value": factor * arm * part["value"], "std": factor * abs(arm) * part["std"], "unit": "N m s2/rad2",
            **how,
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
