"""Causes of the drive in flights whose rotor speeds are estimated from commands: they show in forces and moments.

Where speeds are measured, the level of the drive compares them with commands. Estimated speeds follow the model's map
whatever the rotors did, so that a battery that acts otherwise shows as thrust that follows voltage.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from quasi.gap.effect import Effect, Extension, Parameter, Values, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.instruments import reread
from quasi.model.columns import ROTORS
from quasi.model.commands import map_of
from quasi.model.extensions import (
    OfMap,
    are_estimated,
    changes_of_map,
    correct_estimated_speeds,
    correct_rotor_speeds,
    drive_of,
)
from quasi.model.model import AXES, Model
from quasi.terms.rotor_map import LOW_VOLTAGE, speed_exponent

SAG, SCALE = "battery_sag", "rotor_speed_scale"
OF_TELEMETRY = (SCALE, "telemetry_delay")  # causes of measured speeds alone
NO_TELEMETRY = "no flight logs rotor speeds; those estimated from commands have no unit and no delay of a telemetry"
# causes of rotors that follow late: the constant of the model that each changes, its parameter
LATE_OF_FORCES = {"motor_lag": ("time constants", "time_constant"), "command_delay": ("delay", "delay")}
LAG_STARTS, LEAST_SHARE = (-0.4, 0.4, 1.0), 0.1  # changes of the model's own lag that are tried; the least lag
LAG_OF_AIR = "inflow_lag"  # thrust that leads the rotor speed, as it does where rotors are faster than the map says
OF_THRUST = ("thrust_factor", "thrust_curve", "thrust_drift")  # of all rotors alike, at the same speed
SPEED_LEVELS = (0.5, 2.0)  # of speed at the same command: beyond it lies another motor
OF_THE_SAME_THRUST = ("thrust_factor", "mass", "thrust_drift", "thrust_curve")
TIE_BREAKER = "a long flight from a full to an empty battery with pulls of the throttle, or batteries of other charge"


def with_estimated_speeds(
    effects: Mapping[str, Effect], model: Model, flights: Sequence[Evidence]
) -> tuple[dict[str, Effect], list[dict[str, str]]]:
    """The causes to ask of flights, and entries of those that cannot be asked; unchanged where speeds are measured.

    Where all flights hold estimated speeds, a battery that acts otherwise becomes a cause of forces and moments, and
    causes of the telemetry go. Another thrust at the same speed and another speed at the same command look the same:
    where voltage does not show the battery by itself, the two are a tie. Rotors that follow late show in all forces and
    moments at once; a lag and a delay are a tie.
    """
    if not flights or not all(are_estimated(e.columns) for e in flights):
        return dict(effects), []
    gone = [n for n in OF_TELEMETRY if n in effects]
    found = {
        n: replace(e, always_tied_with=tuple(i for i in e.always_tied_with if i not in gone))
        for n, e in effects.items()
        if n not in gone
    }
    lists = [{"id": n, "why": NO_TELEMETRY} for n in gone]
    for name, (key, parameter) in LATE_OF_FORCES.items():
        if name in found:
            found[name] = late_of_forces(found[name], model, key, parameter, [n for n in LATE_OF_FORCES if n != name])
    if LAG_OF_AIR in found:
        found[LAG_OF_AIR] = replace(found[LAG_OF_AIR], always_tied_with=tuple(n for n in LATE_OF_FORCES if n in found))
    reference = changes_of_map(model).reference
    if SAG in found:
        if reference and all("battery_voltage" in e.columns for e in flights):
            found[SAG] = sag_of_forces(found[SAG], model, reference)
            for n in OF_THRUST:
                if n in found:
                    found[n] = replace(found[n], always_tied_with=(*found[n].always_tied_with, SAG))
        else:
            lists.append({"id": SAG, "why": "the model's map from commands to rotor speeds has no voltage"})
    return found, lists


def add_battery(ties: list[dict[str, Any]], effects: Mapping[str, Effect]) -> list[dict[str, Any]]:
    """Ties of diagnosis.json; one with a cause of OF_THRUST holds the battery too, where it is asked of forces."""
    if SAG not in effects or effects[SAG].level != "forces":
        return ties
    return [
        {**tie, "ids": [*tie["ids"], SAG], "parameters": {**tie["parameters"], SAG: {}}}
        if set(OF_THRUST) & set(tie["ids"]) and SAG not in tie["ids"]
        else tie
        for tie in ties
    ]


def late_of_forces(effect: Effect, model: Model, key: str, parameter: str, tied: Sequence[str]) -> Effect:
    """A lag or delay of the rotors beyond the model's as speeds that are estimated too early.

    A delay moves the estimated speeds in time, and the extension's negative delay of recorded speeds holds it where
    flights are compared. A lag makes them anew, see `correct_estimated_speeds`; it is looked for by the whole effect
    of some times the model's own, for commands that chatter are damped by it.
    Only axes that rotors push along or turn about are asked. What a model makes of rotor speeds along the others stands
    for the motion that the controller answers, and does not come later with the rotors: another cause, such as a load
    that swings, would be needed to correct it.
    key  of the model's actuators; parameter  of the cause; tied  ids that look the same
    """
    about = effect.parameters[parameter]
    is_delay = about.neutral is not None
    held = (drive_of(model.document).get(key) or {}).get("value", 0.0)
    own = float(np.mean(held)) if is_delay else changes_of_map(model).after
    common: dict[str, Any] = {
        "level": "forces",
        "parameters": {parameter: about if is_delay else about._replace(neutral=own, low=min(about.low, own))},
        "channels": ("Fz", "Mx", "My", "Mz"),
        "rivals": ("inflow_lag", "rotor_acceleration_torque"),
        "always_tied_with": tuple(tied),
        "absorbed_by_model": True,
    }

    pushed = np.isin(AXES, common["channels"])

    def columns(evidence: Evidence, _: Values) -> dict[str, np.ndarray]:
        return {parameter: pushed * np.einsum("nij,nj->ni", evidence.gradient(*ROTORS), -evidence.spin_up)}

    if is_delay:

        def later(values: Values, _: Vehicle, __: Model) -> Extension:
            return Extension(actuators={"telemetry delay": -values[parameter], "delay": own + values[parameter]})

        return replace(effect, columns=columns, extension=later, **common)

    def full(evidence: Evidence, _: Vehicle, values: Values) -> np.ndarray:
        lag = max(own + values[parameter], LEAST_SHARE * own)
        turned = correct_estimated_speeds(evidence.columns, OfMap(before=own, after=lag))
        late = reread(evidence, {n: turned[n] for n in (*ROTORS, *(f"{w}_dot" for w in ROTORS))})
        return pushed * (late.predicted - evidence.predicted)

    def slower(values: Values, _: Vehicle, __: Model) -> Extension:
        return Extension(actuators={"time constant": max(own + values[parameter], LEAST_SHARE * own)})

    starts = tuple(share * own for share in LAG_STARTS)
    return replace(effect, columns=columns, full_effect=full, extension=slower, starts=starts, **common)


def sag_of_forces(effect: Effect, model: Model, reference: float) -> Effect:
    """The cause `battery_sag` as thrust that follows the voltage otherwise than the model's map says.

    W = (1 + level) (V / V_ref)^(exponent - the map's) W_map: nobody knows the voltage at which both agree, so that a
    level goes with the exponent. A level alone is what a thrust factor is. No term of a model follows the voltage, so
    that reference flights have an exponent of their own: flown with fuller batteries, they may not know the map's.
    reference  V at which the map's voltage factor is 1
    """
    own = speed_exponent(map_of(model.document)) + changes_of_map(model).exponent

    def columns(evidence: Evidence, _: Values) -> dict[str, np.ndarray]:
        ratio = np.maximum(evidence.take("battery_voltage")[:, 0], LOW_VOLTAGE * reference) / reference
        slope = evidence.gradient(*ROTORS)
        parts = {"exponent": evidence.speeds * np.log(ratio)[:, None], "level": evidence.speeds}
        return {name: np.einsum("nij,nj->ni", slope, part) for name, part in parts.items()}

    def scale_of(values: Values) -> float:
        """Estimated over true speed: a level that the flights hardly show may lie outside its range."""
        return 1.0 / float(np.clip(1.0 + values["level"], *SPEED_LEVELS))

    def corrected(evidence: Evidence, values: Values) -> Evidence:
        turned = correct_rotor_speeds(evidence.columns, 0.0, scale_of(values))
        turned = correct_estimated_speeds(turned, OfMap(values["exponent"], reference))
        return reread(evidence, {n: turned[n] for n in (*ROTORS, *(f"{w}_dot" for w in ROTORS)) if n in turned})

    def full(evidence: Evidence, _: Vehicle, values: Values) -> np.ndarray:
        return corrected(evidence, values).predicted - evidence.predicted

    def extension(values: Values, _: Vehicle, __: Model) -> Extension:
        actuators = {"voltage exponent": own + values["exponent"], "reference voltage": reference}
        scale = {"rotor speed scale": scale_of(values)} if values["level"] else {}
        return Extension(actuators={**actuators, **scale})

    known: dict[str, Any] = effect.parameters["exponent"]._asdict()
    exponent = Parameter(**{**known, "neutral": own, "low": min(known["low"], own), "high": max(known["high"], own)})
    return replace(
        effect,
        level="forces",
        equation="W = level W_map (V / V_ref)^(exponent - that of the map)",
        parameters={"exponent": exponent, "level": Parameter("1", 1.0, "a", *SPEED_LEVELS)},
        parts="first",
        channels=("Fz", "Mx", "My"),
        rivals=OF_THE_SAME_THRUST,
        tie_breaker=TIE_BREAKER,
        columns=columns,
        corrected=corrected,
        full_effect=full,
        extension=extension,
    )
