"""What the trim in steady flight says of a gap: its statement, and the causes of forces and moments that it rejects."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from quasi.gap.effect import Vehicle
from quasi.gap.levels.forces.estimated_speeds import OF_THE_SAME_THRUST, SAG
from quasi.gap.levels.hover_trim import (
    N_ROTORS,
    Comparison,
    Flight,
    Geometry,
    Hypothesis,
    compare,
    conclude,
    geometry_of,
    hypotheses,
    session_scales,
)
from quasi.gap.levels.steady_flight import steady_flight

# Log likelihood by which the trim has to be less probable with a cause than without, so that it rejects the cause: 1 to
# 100, "decisive" (Kass & Raftery, Bayes factors, JASA 90, 1995).
REJECTED_LOG = -np.log(100.0)
HYPOTHESES = {
    "mass": "another mass or another thrust of all rotors",
    "cg": "a moved centre of gravity",
    "weight": "a weight that was added or moved",
    "yaw": "another balance about yaw (a tilted rotor)",
}
TRIM_CHANNELS = {"rotor_effectiveness": ["Fz", "Mx", "My"], "mass": ["Fz"], "thrust_factor": ["Fz"],
            "cg_offset": ["Mx", "My"], "rotor_tilt": ["Mz"]}  # fmt: skip
NEEDLESS = {"mass": "other total thrust", "cg": "moved centre of gravity", "yaw": "tilted rotor"}
OF_MOMENTS = {"cg_offset": "cg", "rotor_tilt": "yaw"}  # causes of a constant moment: their hypotheses
BALANCE_ALONE = ["yaw"]  # names of the trim where nothing else changed
TRIM = "trim"  # id of the finding
NO_VOLTAGE = "its battery voltage is unknown, that of other flights is known"
OF_TOTAL_THRUST = (*OF_THE_SAME_THRUST, SAG)  # of all rotors alike
OF_WRONG_SPEEDS = ("rotor_order", "rotor_speed_scale")  # they change the measured speeds, and not the thrust


@dataclass(frozen=True)
class TrimEvidence:
    """document  plain data for diagnosis.json; comparison and geometry, None where nothing could be compared; scales
    of the spreads between sessions, see `quasi.gap.levels.hover_trim.session_scales`."""

    document: dict[str, Any]
    comparison: Comparison | None = None
    geometry: Geometry | None = None
    scales: tuple[float, float] = (1.0, 1.0)


def gather_trim(
    tables: Mapping[str, pd.DataFrame], roles: Mapping[str, str], sessions: Mapping[str, str], vehicle: Vehicle,
    masses: Mapping[str, float] | None = None,
) -> TrimEvidence:  # fmt: skip
    """Compare the trim of compared flights with that of reference flights.

    tables  filtered flights by key; roles {key: "compared", "reference", "held out"}, of which the last are left out
    masses  {key: kg} that flights were logged with, where they differ: thrust counts relative to the logged weight, so
            that a wrong logged mass shows as the mass that a correction of it takes off, and a right one does not show
    """
    flights, facts, lacking, found = [], {}, {}, {}
    for key, table in tables.items():
        if roles.get(key) not in ("compared", "reference"):
            continue
        try:
            found[key] = steady_flight(table, vehicle.radius)
        except ValueError as error:
            lacking[key] = str(error)
    mapped = any(np.isfinite(steady.volts) for steady in found.values())
    for key, steady in found.items():
        if mapped and steady.source == "commands" and not np.isfinite(steady.volts):
            lacking[key] = NO_VOLTAGE
            continue
        weight = (masses or {}).get(key, np.nan) / vehicle.mass
        thrust = steady.thrust / (weight if np.isfinite(weight) and weight > 0.0 else 1.0)
        flights.append(Flight(key, thrust, steady.volts, sessions.get(key, ""), roles[key] == "compared"))
        facts[key] = {"seconds": steady.seconds, "contacts": steady.contacts, "source": steady.source}
        facts[key]["role"] = roles[key]
    document: dict[str, Any] = {"word": "not asked", "flights": facts, "left out": lacking}
    missing = [r for r in ("reference", "compared") if not any(f.is_compared is (r == "compared") for f in flights)]
    if missing or len({f["source"] for f in facts.values()}) > 1:
        why = f"no {missing[0]} flight has a steady part" if missing else "some flights hold speeds, others commands"
        why += f", or {NO_VOLTAGE}" if missing and NO_VOLTAGE in lacking.values() else ""
        return TrimEvidence(document | {"text": f"The trim in steady flight was not compared: {why}."})
    usual = np.mean([np.log(f.thrust) for f in flights if not f.is_compared], axis=0)
    for flight in flights:
        facts[flight.key]["asked"] = np.expm1(np.log(flight.thrust) - usual).tolist()
    geometry = geometry_of(np.asarray(vehicle.hubs)[:, :2], np.asarray(vehicle.spin))
    found = compare(flights, hypotheses(geometry), geometry)
    word, names = conclude(found)
    document |= {
        "word": word,
        "names": names,
        "source": next(iter(facts.values()))["source"],
        "causes": list(dict.fromkeys(i for h in hypotheses(geometry) if h.name in names for i in h.ids)),
        "probability": found.probability,
        "change": {"value": found.change.tolist(), "std": np.sqrt(np.diag(found.covariance)).tolist(), "unit": "1"},
        "parameters": {n: _parameters(n, found, geometry, vehicle) for n in names},
        "spread": found.spread,
    }
    document["text"] = _text(word, names, found, document["parameters"])
    return TrimEvidence(document, found, geometry, session_scales([f for f in flights if not f.is_compared], geometry))


def probably_changed(trim: Mapping[str, Any]) -> bool:
    """Whether the trim has no name for a change that is likelier than none. trim  "hover trim" of diagnosis.json"""
    shares = trim.get("probability") or {}
    return trim.get("word") == "open" and max(shares, key=shares.get) not in ("healthy", "unexplained")


def is_unanswered(diagnosis: Mapping[str, Any]) -> bool:
    """Whether the trim shows a change that is likelier than none, and what is named is of sensors alone, which is no
    reason for it."""
    explaining = [t for t in diagnosis["ties"] if t.get("explains", True)]
    named = [*explaining, *(e for e in diagnosis["effects"] if e.get("level") != "sensors")]
    return not named and probably_changed(diagnosis.get("hover trim") or {})


def is_undecided(diagnosis: Mapping[str, Any]) -> bool:
    """Whether a diagnosis is not judged although all was asked: its trim shows a change that is likelier than none."""
    unjudged = diagnosis.get("verdict") == "not judged" and not diagnosis.get("unable")
    return unjudged and probably_changed(diagnosis.get("hover trim") or {})


def _parameters(name: str, found: Comparison, geometry: Geometry, vehicle: Vehicle) -> dict[str, dict[str, Any]]:
    """Parameters of a hypothesis as the catalogue has them: effectiveness, kg, m from the configured cg."""
    result = {}
    for key, (value, std) in found.parameters[name].items():
        if key.startswith("rotor"):
            size = float(np.exp(value))
            result[key] = {"value": size, "std": size * std, "unit": "1"}
        elif key == "mass":
            mass = vehicle.mass * float(np.exp(value))
            result[key] = {"value": mass, "std": mass * std, "unit": "kg"}
        elif key.endswith("_cg"):
            result[key[0]] = {"value": geometry.arm * value, "std": geometry.arm * std, "unit": "m"}
        else:
            result[key] = {"value": value, "std": std, "unit": "1"}
    return result


def _text(word: str, names: Sequence[str], found: Comparison, parameters: Mapping[str, Any]) -> str:
    """The statement, in sentences for the page."""
    change, std = 100 * np.expm1(found.change), 100 * np.sqrt(np.diag(found.covariance))
    shown = ", ".join(f"{c:+.0f}" for c in change)
    first = (
        f"In steady flight the rotors 1 to 4 are asked for {shown} % more thrust than in the reference flights "
        f"(standard error {std.max():.0f} %, the spread between sessions included)."
    )
    if word in ("healthy", "open"):
        likeliest = max(found.probability, key=found.probability.get)
        if likeliest in ("healthy", "unexplained"):
            return f"{first} The trim names no cause."
        shares = f"{found.probability[likeliest]:.2f}, no change {found.probability['healthy']:.2f}"
        return (
            f"{first} The trim names no cause: {HYPOTHESES.get(likeliest, likeliest)} has the probability {shares}. "
            "Compared flights of one more session would decide."
        )
    if word == "changed":
        likely = ", ".join(
            f"{HYPOTHESES.get(n, n)} {p:.2f}" for n, p in sorted(found.probability.items(), key=lambda pair: -pair[1])
            if n not in ("healthy", "unexplained") and p > found.probability["healthy"]
        )  # fmt: skip
        named = f" Probabilities: {likely}." if likely else ""
        return f"{first} That is a change, but no single cause that a trim can show is likely enough.{named}"
    share = sum(found.probability[n] for n in names)
    answer = " or ".join(_words(n, parameters[n]) for n in names)
    return f"{first} The trim shows {answer}, with the probability {share:.2f}."


def _words(name: str, parameters: Mapping[str, Mapping[str, Any]]) -> str:
    if name.startswith("rotor "):
        (size,) = parameters.values()
        return f"{name} with the effectiveness {size['value']:.2f} ± {size['std']:.2f}"
    return HYPOTHESES[name]


def expected_change(cause: str, deviations: Mapping[str, float], evidence: TrimEvidence, mass: float) -> np.ndarray:
    """Change (4,) of log thrust asked for that a cause of forces and moments makes; zeros where it makes none here.

    deviations  of its parameters from neutral, as the search has them; mass  configured, kg
    """
    change = np.zeros(N_ROTORS)
    if cause == "rotor_effectiveness":
        for name, deviation in deviations.items():
            if name.startswith("rotor"):
                change[int(name[-1]) - 1] = -np.log(max(1.0 + deviation, 0.01))
    elif cause == "thrust_factor":
        change -= np.log(max(1.0 + deviations.get("factor", 0.0), 0.01))
    elif cause == "mass":
        change += np.log(max(1.0 + sum(deviations.values()) / mass, 0.01))
    elif cause == "cg_offset" and evidence.geometry is not None:
        arm, relative = evidence.geometry
        change += relative[:, 1] * deviations.get("y", 0.0) / arm + relative[:, 2] * deviations.get("x", 0.0) / arm
    return change


def named_rotor(evidence: TrimEvidence | None) -> str:
    """Name of the one rotor that the trim names of flights with commands in place of measured speeds; "" without."""
    if evidence is None or evidence.document.get("source") != "commands" or evidence.document["word"] != "named":
        return ""
    (name,) = evidence.document["names"]
    known = {h.name: h for h in hypotheses(evidence.geometry)}
    return name if known[name].ids == ("rotor_effectiveness",) else ""


def why_rotor_is_enough(evidence: TrimEvidence | None, other: str = "mass") -> str:
    """Why the trim needs no other cause next to the one rotor that it names; "" where it does, or names none.

    other  name of the cause's hypothesis: "mass" for another total thrust, "cg" or "yaw"
    Of flights with commands in place of measured speeds alone. Under the named rotor the trim's change c is normal with
    the covariance C + D S D'; the other cause adds its own. It is not needed where it makes c no more probable. Forces
    hold no more: a rotor that is weaker by a fifth takes a twentieth of the vertical force, and a constant moment is
    the trim of a flight.
    """
    name = named_rotor(evidence)
    if not name:
        return ""
    known, found = {h.name: h for h in hypotheses(evidence.geometry)}, evidence.comparison

    def spread(hypothesis: Hypothesis) -> np.ndarray:
        own = hypothesis.directions * np.array(hypothesis.std)
        return own @ own.T

    alone = found.covariance + spread(known[name])
    if _log_density(found.change, alone + spread(known[other])) > _log_density(found.change, alone):
        return ""
    shown = _words(name, evidence.document["parameters"][name])
    return f"the trim shows {shown}, and needs no {NEEDLESS[other]}"


def _log_density(x: np.ndarray, covariance: np.ndarray) -> float:
    """Of a normal distribution about 0, up to a constant."""
    return float(-0.5 * x @ np.linalg.solve(covariance, x) - 0.5 * np.linalg.slogdet(covariance)[1])


def rejected_by_trim(
    evidence: TrimEvidence | None, causes: Sequence[tuple[str, Mapping[str, float]]], mass: float
) -> dict[int, str]:
    """Causes, by position, that the trim contradicts, and why; or those that it does not need next to a rotor.

    causes  [(id, deviations)] that compared flights have and reference flights lack, all together
    """
    if evidence is None or evidence.comparison is None or not causes:
        return {}
    needless = {k: why for k, (cause, _) in enumerate(causes)
                if cause in OF_MOMENTS and (why := why_rotor_is_enough(evidence, OF_MOMENTS[cause]))}  # fmt: skip
    if needless:
        return needless
    enough = why_rotor_is_enough(evidence)
    if enough and not any(cause == "rotor_effectiveness" for cause, _ in causes):
        needless = {k: enough for k, (cause, _) in enumerate(causes) if cause in OF_TOTAL_THRUST}
    return needless or contradicted_by_trim(evidence, causes, mass)


def contradicted_by_trim(
    evidence: TrimEvidence | None, causes: Sequence[tuple[str, Mapping[str, float]]], mass: float
) -> dict[int, str]:
    """Causes, by position, without which the trim is exp(REJECTED_LOG) more probable, and why; the worst one first.

    causes  as for `rejected_by_trim`
    """
    if evidence is None or evidence.comparison is None or not causes:
        return {}
    found = evidence.comparison
    precision = np.linalg.inv(found.covariance)
    effects = [expected_change(cause, deviations, evidence, mass) for cause, deviations in causes]

    def log_likelihood(expected: np.ndarray) -> float:
        away = found.change - expected
        return float(-0.5 * away @ precision @ away)

    together = np.sum(effects, axis=0)
    gains = [log_likelihood(together) - log_likelihood(together - effect) for effect in effects]
    result = {}
    for k in np.argsort(gains):
        if gains[k] < REJECTED_LOG:
            i = int(np.argmax(np.abs(effects[k])))
            result[int(k)] = (
                f"with it rotor {i + 1} would be asked for {100 * np.expm1(together[i]):+.0f} % more thrust in "
                f"steady flight, where the flights show {100 * np.expm1(found.change[i]):+.0f} % (log likelihood "
                f"{gains[k]:.1f})"
            )
    return result


def unnamed_change(evidence: TrimEvidence, taken: Collection[str], acting: bool = False) -> list[dict[str, Any]]:
    """A finding where the trim changed, no cause that a trim names fits it, and none is there.

    Of measured speeds only where no cause of forces and moments has a name: wind, for one, is leant against, and
    changes the trim as well. The balance about yaw alone is one of commands only, see `trim_entries`.
    taken  ids of the causes that have a name or stand in a tie; acting  whether one of forces and moments does
    """
    document = evidence.document
    commands = document.get("source") == "commands"
    if document["word"] != "changed" and not (commands and document["names"] == BALANCE_ALONE):
        return []
    if set(taken) & {*TRIM_CHANNELS, *OF_TOTAL_THRUST, *OF_WRONG_SPEEDS} or (acting and not commands):
        return []
    other = "another vehicle, other motors" if commands else "a load, air of another density"
    text = f"{document['text']} It may be {other} or propellers, or several causes at once"
    return [{"id": TRIM, "text": text, "evidence": {"change": document["change"]}}]


def trim_entries(
    evidence: TrimEvidence, taken: Sequence[str] = (), acting: Collection[str] = ()
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Effects and ties of diagnosis.json that the trim names alone.

    Forces and moments ask whether a constant part is beyond what flights differ by, and a few sessions leave that open.
    The trim knows by what healthy vehicles differ between sessions. Never where one of its causes has a name or stands
    in a tie already, nor where measured speeds are wrong: then they changed and the thrust did not. A named cause of
    the vertical force, such as a load that hangs, changes the total thrust of the trim as well: then the trim names no
    other reason for it. A balance about yaw that changed alone is stated and names no tilted rotor: torque factors
    differ between the sessions of some vehicles by more than the prior spread, and moments show a tilt themselves.
    taken  ids of these; acting  channels of the named causes of forces and moments
    """
    document = evidence.document
    if document["word"] not in ("named", "tied"):
        return [], []
    ids, parameters, commands = list(document["causes"]), document["parameters"], document["source"] == "commands"
    if commands and "thrust_factor" in ids:
        ids.append("battery_sag")  # more command for the same thrust: a battery asks for it as propellers do
    if document["names"] == BALANCE_ALONE:
        return [], []
    known = "Fz" in acting and all(TRIM_CHANNELS[i] == ["Fz"] for i in document["causes"])
    if known or set(taken) & {*ids, *OF_WRONG_SPEEDS}:
        return [], []
    share = sum(document["probability"][name] for name in document["names"])
    if len(ids) == 1:
        entry = {
            "id": ids[0], "level": "trim", "since": "changed", "probability": share, "channels": TRIM_CHANNELS[ids[0]],
            "parameters": {n: size for name in document["names"] for n, size in parameters[name].items()},
            "gain": {"wrench": None, "rollout": None}, "confused_with": [], "evidence": {"trim": share},
        }  # fmt: skip
        return [entry], []
    tie = {
        "ids": ids, "since": "changed", "separability": 0.0, "parameters": {i: {} for i in ids},
        "tie_breaker": "weigh the vehicle and balance it on a string; fly heaves and steps of each axis",
        "trim": parameters, "probability": share,
    }  # fmt: skip
    return [], [tie]
