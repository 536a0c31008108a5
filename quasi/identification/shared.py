"""What the six axes of a model share: hover speed, the simple rotor model, actuator constants.

Source: QuaSI user manual V1.0.a, 6.1 and 6.5; momentum balance in hover for the hover speed.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.airframe import Airframe
from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.identification.actuators import actuators
from quasi.identification.geometry import contradicting_places, rotor_slopes
from quasi.identification.partition import TRAINING
from quasi.identification.regression import least_squares
from quasi.identification.rotor_speeds import actuators_of, command_kind, factors_of, places_of
from quasi.sensor_limits import first_reason
from quasi.terms.expressions import Program, parse
from quasi.terms.variables import Variables

UPRIGHT = 0.99  # share of gravity along body z from which a sample counts as hover
LEAST_HOVER = 50  # samples
MOMENTS = ("Mx", "My", "Mz")
USE_UNUSABLE = "use unusable flights"  # key of a model's configuration
NEEDED_COLUMNS = ("w1", "w2", "w3", "w4", "Fz", "Mx", "My", "Mz", "roll", "pitch", "u", "v", "w", "p", "q", "r")
OPTIONAL_COLUMNS = ("w1_dot", "w2_dot", "w3_dot", "w4_dot", "u_air", "v_air", "w_air")


def refuse_speedless(flights: Mapping[str, pd.DataFrame]) -> None:
    """Raise DataError for filtered flights without rotor speeds, and without commands to estimate them from."""
    lacking = {
        key: [n for n in NEEDED_COLUMNS[:4] if n not in flight]
        for key, flight in flights.items()
        if command_kind(flight) is None
    }
    lacking = {key: names for key, names in lacking.items() if names}
    if lacking:
        keys, names = list(lacking), sorted(set().union(*lacking.values()))
        raise DataError(
            f"flight{'s' * (len(keys) > 1)} {', '.join(keys)}: the log holds no rotor speeds ({', '.join(names)}), "
            "and no commands of all four rotors to estimate them from; log either (docs/your-own-data.md, section 4), "
            f"or leave {'these flights' if len(keys) > 1 else 'this flight'} out"
        )


def unusable_flights(
    made: Mapping[str, Mapping[str, Any]], flights: Mapping[str, pd.DataFrame], use: bool = False
) -> dict[str, str]:
    """{flight: why} of training flights with the verdict `unusable`, which train no model; {} where `use` is true.

    made  {flight: metadata of its filtered table}; flights  filtered flights
    Raises DataError where no flight would be left.
    """
    found = {
        key: first_reason(made[key]["unusable because"])
        for key, flight in flights.items()
        if made[key].get("unusable because") and (flight["valid"].to_numpy() > 0.5).any()
    }
    if use or not found:
        return {}
    if len(found) == len(flights):
        listed = "; ".join(f"flight {key}: {why}" for key, why in found.items())
        raise DataError(
            f"no training flight is usable: {listed}; correct the recordings or their configuration, or set "
            f"'{USE_UNUSABLE}' in 'logging file' of the model's configuration to true"
        )
    return found


def left_out_notes(left_out: Mapping[str, str]) -> list[str]:
    """A sentence for each flight of `unusable_flights`."""
    return [
        f"flight {key} is unusable and trains no model ({why}); '{USE_UNUSABLE}' would force it"
        for key, why in left_out.items()
    ]


def shared(
    flights: Mapping[str, pd.DataFrame],
    partition: Mapping[str, np.ndarray],
    airframe: Airframe,
    gravity: str = "withGravity",
    masses: Mapping[str, float] | None = None,
    command_map: Mapping[str, Any] | None = None,
    aged: Mapping[str, bool] | None = None,
    drive: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Hover speed, simple model and actuator constants of the training rows, as plain data; and "contradictions",
    sentences on rotors that seem to sit or turn otherwise than configured.

    flights    filtered flights; partition  roles of their rows
    gravity    what Fx..Fz hold: "withGravity" (mass x specific force) or "noGravity" (net force)
    masses     kg per flight, where they differ from the airframe's
    command_map  the quadrotor's configured map from command to rotor speed, where there is one
    aged       {flight: whether import took the age of its rotor telemetry off}
    drive      the identified "rotor speeds" (`rotor_speeds.rotor_speeds_of`); where all speeds are estimated from it,
               its thrust and torque factors, lag and geometry stand here, for they hold in closed loop
    Raises DataError when a column or the mass is missing.
    """
    notes: list[str] = []
    training = {key: flight for key, flight in flights.items() if (partition[key] == TRAINING).any()}
    prepared = {}
    for key, flight in training.items():
        rows = np.flatnonzero(partition[key] == TRAINING)
        missing = [c for c in NEEDED_COLUMNS if c not in flight]
        if missing:
            raise DataError(f"flight {key} has no column '{missing[0]}', which every model needs; filter it anew")
        chosen = [*NEEDED_COLUMNS, *(c for c in OPTIONAL_COLUMNS if c in flight)]
        part = flight[chosen].iloc[rows]
        good = np.isfinite(part.to_numpy()).all(axis=1)
        values = {c: part[c].to_numpy(float)[good] for c in chosen}
        mass = (masses or {}).get(key, airframe.mass)
        values["upright"] = np.cos(values["roll"]) * np.cos(values["pitch"])
        if gravity == "noGravity":
            values["Fz"] = values["Fz"] - _mass(mass, key) * GRAVITY * values["upright"]
        prepared[key] = (rows[good], values, mass)
    simple, by_rotor = _simple(prepared, airframe)
    estimated = drive is not None and drive.get("factors") is not None
    if estimated:
        simple |= factors_of(drive, airframe)
        wrong = contradicting_places(places_of(drive), airframe, 1.0)
        constants = actuators_of(drive)
    else:
        wrong = contradicting_places(by_rotor, airframe, simple["kappaFz"]["value"])
        measured = {k: f for k, f in training.items() if drive is None or k not in drive["estimated flights"]}
        constants = actuators(measured, {k: partition[k] == TRAINING for k in measured}, notes, command_map, aged)
    notes += wrong + _on_axes(airframe)
    return {
        "schema": "quasi.shared/1",
        "gravity": gravity,
        "training flights": list(training),
        "hover speed": _hover(prepared, notes),
        "simple model": simple,
        "actuators": constants,
        "rotor speeds": drive,
        "contradictions": wrong,
        "notes": notes,
    }


def _on_axes(airframe: Airframe) -> list[str]:
    """A sentence where rotors sit on the body axes: the signs of U_p and U_q (manual, 6.5) are those of a cross."""
    hubs = np.abs(airframe.hubs[:, :2])
    if (2.0 * hubs >= hubs.max(axis=0)).all():
        return []
    return [
        "rotors sit on the body axes (plus configuration), where U_p and U_q are no roll and pitch: do not use the "
        "simple model; one with terms in w1 to w4, or in all of U_p, U_q, U_r and w_avg^2, holds"
    ]


def _mass(mass: float | None, key: str) -> float:
    if mass is None:
        raise DataError(f"flight {key}: the mass is unknown; fill in 'Mass' in the logbook")
    return mass


def _hover(prepared: Mapping[str, tuple], notes: list[str]) -> dict[str, Any]:
    each = {}
    for key, (_, values, mass) in prepared.items():
        speed = hover_speed(values, _mass(mass, key))
        if speed is None:
            notes.append(f"flight {key} has no usable hover samples; it does not enter the hover speed")
        else:
            each[key] = speed
    if not each:
        notes.append("no flight hovers, so the hover speed is unknown and variables such as d_w_tot cannot be used")
    found = np.array(list(each.values()))
    return {
        "value": float(found.mean()) if len(found) else None,
        "std": float(found.std(ddof=1)) if len(found) > 1 else None,
        "unit": "rad/s",
        "per flight": each,
    }


def hover_speed(values: Mapping[str, np.ndarray], mass: float) -> float | None:
    """Rotor speed (rad/s) at which four rotors carry mass x gravity, or None without enough hover samples.

    values  w1..w4, Fz (N, as the accelerometer feels it), upright (body z share of gravity), each (n,)
    Least squares of Fz on the sum of squared speeds over upright samples, through the origin.
    """
    rows = values["upright"] > UPRIGHT
    if np.count_nonzero(rows) < LEAST_HOVER:
        return None
    squares = sum(values[f"w{i}"][rows] ** 2 for i in range(1, 5))
    factor = -float(squares @ values["Fz"][rows]) / float(squares @ squares) if squares.any() else 0.0
    return float(np.sqrt(mass * GRAVITY / (4 * factor))) if factor > 0 else None


# factor: (axis, power of the rotor speeds); each is fitted together with what else acts on its axis
_FACTORS = {f"kappa{axis}{end}": (axis, power) for end, power in (("", 2), ("_w", 1)) for axis in ("Fz", *MOMENTS)}
_OTHER_FORCES = ("w_tot*w", "u^2 + v^2")


def _simple(
    prepared: Mapping[str, tuple], airframe: Airframe
) -> tuple[dict[str, Any], dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Thrust and torque factors: kappaX on squared speeds, kappaX_w on speeds, in still air with steady rotors; and
    {"Mx", "My", "Mz": slope of the moment by each rotor's squared speed (4,), its standard errors (4,)}.

    Climb, airspeed, flapping, damping and the rotors' acceleration go together with the commands in flight; left out
    of the fit, they would pass for thrust and torque. So would the moment of a displaced cg, by which flights may
    differ. Rotors that differ, and a cg that is not between them, give a change of thrust or yaw a moment about roll
    and pitch, which the controller balances by other rotor speeds; a fit to differences of speeds alone would see these
    without the moment. So a moment has a slope by each rotor, and its factor is that of their pattern. Coefficients of
    what else was fitted are not kept.
    """
    result, by_rotor = {}, {}
    patterns = dict(zip(MOMENTS, (airframe.left, airframe.front, airframe.spin)))
    for name, (axis, power) in _FACTORS.items():
        if axis == "Fz":
            value, std, others = _thrust(prepared, airframe, power)
        else:
            slopes, covariance, others = rotor_slopes(prepared, airframe, axis, power)
            if power == 2:
                by_rotor[axis] = slopes, np.sqrt(np.diag(covariance))
            share = np.asarray(patterns[axis], float) / 4.0
            value, std = float(share @ slopes), float(np.sqrt(share @ covariance @ share))
        unit = ("N" if axis == "Fz" else "N m") + (" s2/rad2" if power == 2 else " s/rad")
        result[name] = {"value": value, "std": std, "unit": unit, "fitted together with": others}
    return result, by_rotor


def _thrust(prepared: Mapping[str, tuple], airframe: Airframe, power: int) -> tuple[float, float, list[str]]:
    """Slope of the thrust, through the origin, by the sum of all speeds to a power, with its standard error and what
    else was in the fit: a constant force cannot be distinguished from the thrust of hover."""
    texts = ["4*w_avg^2" if power == 2 else "w_tot", *_OTHER_FORCES]
    program = Program([parse(e) for e in texts])
    columns = np.hstack([
        program.run(Variables(values, airframe, None).__getitem__, len(rows)) for rows, values, _ in prepared.values()
    ]).T  # fmt: skip
    used = [0, *(k for k in range(1, len(texts)) if columns[:, k].any())]
    thrust = np.concatenate([-values["Fz"] for _, values, _ in prepared.values()])
    fit = least_squares(columns[:, used], thrust, [rows for rows, _, _ in prepared.values()])
    return float(fit.coefficients[0]), float(np.sqrt(fit.covariance[0, 0])), [texts[k] for k in used[1:]]
