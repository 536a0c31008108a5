"""What to do about a diagnosis: for every cause, tie and residual one step, in words that name files and commands."""

from collections.abc import Mapping
from typing import Any

from quasi.gap.effect import Effect
from quasi.gap.flights.covariates import UNPLACED
from quasi.gap.levels.corrections import corrected_at_import, uncorrected
from quasi.gap.levels.trim_evidence import is_unanswered, is_undecided
from quasi.gap.report.names import alternatives, listed, name_of, parameters_of
from quasi.gap.report.wording import CHANNEL_NAMES, ranges_of, unasked, words_of

LISTED = 4  # names in a row, before the rest are counted
VEHICLE = "the quadrotor's configuration"
# what a named fault of sensors, mounting or logging asks for, where flights are made or read
CORRECT = {
    "imu_lever_arm": f"add it to 'imu position' of {VEHICLE} (it counts from 0 where none stands there), and set "
    "'do onboard c.g. correction'",
    "marker_offset": f"add it to 'optitrack marker cg offset' of {VEHICLE}",
    "imu_misalignment": "mount the flight controller straight, or set its board alignment",
    "mocap_misalignment": "align the rigid body with the vehicle's axes in the capture's software",
    "room_tilt": "level the capture's ground plane anew",
    "mocap_delay": "look at what the capture's software smooths of rotations, and at the filters of gyro and "
    "accelerometer",
    "gyro_bias": "keep the vehicle still while its flight controller starts, which calibrates the gyro then",
    "accelerometer_bias": "let the vehicle rest for five seconds before take-off, on a level floor, and calibrate its "
    "accelerometer",
    "gyro_scale": "calibrate the gyro, or exchange it",
    "accelerometer_scale": "calibrate the accelerometer, or exchange it",
    "clock_drift": "let one clock stamp log and capture, where that can be",
    "attitude_error": "let the capture measure the attitude as well ('use onboard attitude' false, with orientations "
    "in its export), or tune the attitude estimator of the flight controller, and fly again",
    "telemetry_delay": "log rotor speeds as often and as little filtered as the flight controller can",
    "rotor_order": f"number the rotors in 'rotor config' of {VEHICLE} as the log has them, or map the columns anew; "
    "where all rotors seem turned by a quarter or half, look at how the flight controller is mounted as well",
    "rotor_speed_scale": f"multiply 'motor poles' of {VEHICLE} by it, if the poles are what is wrong",
}


def steps(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> list[str]:
    """What to do next, a sentence each; the first is the most useful one."""
    effects = diagnosis["effects"]
    sentences = [
        "The trim in steady flight changed: look at the compared flights' propellers, motors and battery, and whether "
        "they are of the same vehicle."
        for finding in diagnosis.get("findings", ())
        if finding["id"] == "trim"
    ]
    if is_unanswered(diagnosis):
        sentences.append(
            "The trim in steady flight has probably changed. These flights are too few to be sure: fly the compared "
            "set-up in one more session."
        )
    own = [e for e in effects if in_model(e)]
    if own:
        sentences.append(
            f"Make the extended model, {diagnosis['model']} with {listed([name_of(e['id']) for e in own])}: "
            f"snakemake models/{diagnosis['extended_model']}/standalone. A gap of its own ('model': "
            f"'{diagnosis['extended_model']}') shows what is left."
        )
    sentences += [_corrected(e) for e in effects if corrected_at_import(e["id"], e["level"])]
    sentences += [
        f"{_begun(e)}: {CORRECT.get(e['id'], 'set it right where it arises')}. Nothing corrects it in these flights."
        for e in effects
        if uncorrected(e["id"], e["level"])
    ]
    sentences += [
        f"{_begun(e)}: look at the vehicle first (propellers, motors, battery, payload). The trim in steady flight "
        "shows it, and the extended model does not hold it."
        for e in effects
        if e["level"] == "trim"
    ]
    sentences += [f"{_begun(e)}: {CORRECT[e['id']]}." for e in own if e["id"] in CORRECT]
    for tie in diagnosis["ties"]:
        how = tie["tie_breaker"] or "fly other manoeuvres (quasi plan lists them), or measure one of them"
        sentences.append(
            f"To find out whether it is {alternatives(tie['ids'])}: {words_of(how, known)}; then compare again with "
            "these flights as well."
        )
    sentences += [_visit(left) for left in diagnosis["unexplained"]]
    if diagnosis["unexplained"]:
        sentences.append("Add a cause that you suspect there, and it is tested ('effect files', docs/gaps.md).")
    if diagnosis["verdict"] == "not judged" and not is_undecided(diagnosis):
        sentences.append(
            f"Forces and moments are not judged yet: {unasked(diagnosis, known)}. Add flights to 'rows of flights to "
            "compare (all)' and 'rows of flights held out' of the gap accordingly."
        )
    elif not sentences:
        sentences.append(
            "Nothing has to be done. How large a cause would have to be to show in such flights: quasi plan "
            f"{diagnosis['model']} FLIGHT --gap {diagnosis['name']} (docs/flight-card.md)."
        )
    return sentences + _askable(diagnosis, known)


def in_model(effect: Mapping[str, Any]) -> bool:
    """Whether a named cause is part of the extended model."""
    if effect["level"] == "trim":
        return False
    return not corrected_at_import(effect["id"], effect["level"]) and not uncorrected(effect["id"], effect["level"])


def _begun(effect: Mapping[str, Any]) -> str:
    name = name_of(effect["id"])
    return f"{name[:1].upper()}{name[1:]} ({parameters_of(effect['parameters'])})"


def _corrected(effect: Mapping[str, Any]) -> str:
    """A fault of sensors or mounting is set right where flights are made or read: the gap's own flights already are."""
    how = CORRECT.get(effect["id"], "set it right where it arises")
    if effect["since"] == "always" and VEHICLE not in how:
        how += f", or copy it from 'reference' of the gap's calibration.json to 'sensor calibration' of {VEHICLE}"
    whose = (
        ", for flights like the compared ones only: the reference flights do not have it"
        if effect["since"] == "changed" and VEHICLE in how
        else ""
    )
    return (
        f"{_begun(effect)}: {how}{whose}. This gap's own flights are corrected already; other flights of this "
        "vehicle are not."
    )


def _visit(left: Mapping[str, Any]) -> str:
    """Where to go and look for what no cause explains."""
    channel, where, mostly = left["channel"], left["where"], left.get("mostly")
    name = f"{CHANNEL_NAMES.get(channel, channel)} ({channel})"
    if where == "frequency" and mostly:
        return (
            f"The {name}: look for what turns or swings at {mostly[0][0]:.2f} to {mostly[0][1]:.2f} Hz; hover for a "
            "minute, so that the beat is distinct from the motion."
        )
    if where == UNPLACED:
        return (
            f"The {name}: the pictures below show its mean by what was tried, and its frequencies; fly the same figure "
            "at another height, speed, heading and place, one flight each."
        )
    if where == "everywhere" or where == "frequency":
        return f"The {name} is off everywhere: look for what is mounted, loaded or configured otherwise."
    if where == "time":
        return f"The {name} changes in time{_at(where, mostly)}: look for what came loose, warmed up or ran empty."
    judge = "to see whether it comes again" if left["judged"] else "so that it can be judged there"
    return f"The {name}: look and fly along the {where}{_at(where, mostly)}, in a held-out flight too, {judge}."


def _at(where: str, mostly: Any) -> str:
    return f", mostly {ranges_of(where, mostly)}" if mostly else ""


def _askable(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> list[str]:
    """What would make askable what was not; reasons given for forces and moments as a whole are not repeated."""
    reasons: dict[str, list[str]] = {}
    for entry in diagnosis["cannot_be_asked"]:
        reasons.setdefault(entry["why"], []).append(name_of(entry["id"]))
    if diagnosis["verdict"] == "not judged" and not is_undecided(diagnosis):
        reasons.pop(unasked(diagnosis, known), None)
    sentences = []
    for why, names in reasons.items():
        names = list(dict.fromkeys(names))
        few = listed(names) if len(names) <= LISTED else f"{', '.join(names[:LISTED])} and {len(names) - LISTED} more"
        sentences.append(f"Not asked: {few}. {why[:1].upper()}{words_of(why[1:], known)}.")
    return sentences
