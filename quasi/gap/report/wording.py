"""The words of a diagnosis: sentences that a pilot understands, with the numbers that an engineer checks."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from quasi.gap.catalogue import catalogue
from quasi.gap.effect import Effect
from quasi.gap.flights.covariates import EVERYWHERE, UNITS_AT, UNPLACED
from quasi.gap.levels.corrections import uncorrected
from quasi.gap.levels.trim_evidence import is_unanswered, is_undecided
from quasi.gap.report.names import alternatives, listed, name_of, parameters_of, value_of
from quasi.gap.report.shares import interval_of, percent, reaches_floor, separability_of, share_of, support_of

CHANNEL_NAMES = {
    "Fx": "forward force", "Fy": "sideward force", "Fz": "vertical force", "Mx": "roll moment", "My": "pitch moment",
    "Mz": "yaw moment", "p": "roll rate", "q": "pitch rate", "r": "yaw rate", "ax": "forward acceleration",
    "ay": "sideward acceleration", "az": "vertical acceleration", "position": "position", "velocity": "velocity",
    "attitude": "attitude", "rate": "body rate", "velocity x": "forward velocity", "velocity y": "sideward velocity",
    "velocity z": "vertical velocity", "rate x": "roll rate", "rate y": "pitch rate", "rate z": "yaw rate",
    "north": "northward acceleration", "east": "eastward acceleration", "down": "downward acceleration",
    "w1": "speed of rotor 1", "w2": "speed of rotor 2", "w3": "speed of rotor 3", "w4": "speed of rotor 4",
}  # fmt: skip
WAYS = {
    "Fx": ("forward", "backward"),
    "Fy": ("rightward", "leftward"),
    "Fz": ("downward", "upward"),
    "Mx": ("right roll", "left roll"),
    "My": ("nose-up", "nose-down"),
    "Mz": ("right yaw", "left yaw"),
}  # what a positive and a negative force or moment means to a pilot
RIVAL_P = 0.01  # probability from which a rival adds nothing
STAYS = 0.02  # share of a simulated error; smaller changes are reported as no change
MOST_DESCRIBED = 2  # causes that one sentence describes in a pilot's words
REMOVABLE = {
    True: "Removable error of forces, moments and motion is what lies (squared) above the best fit of the model's "
    "terms and all causes together, or above the extended model where that is better.",
    False: "Removable error of sensors and rotor speeds is what lies (squared) above a fit, to each flight by itself, "
    "of all that is known to go wrong there.",
}  # by whether it is one of forces and moments
ALONG = {EVERYWHERE: EVERYWHERE, UNPLACED: "beyond what the reference flights leave, along nothing that was tried"}
LEVEL_WORDS = {"sensors": ("sensors", "clocks"), "drive": ("the rotor drive",)}  # what stands below forces and moments
LINE_WORDS = {"rollouts": "", "rollouts from commands": " from commands"}
SINCE = {
    "changed": "this is new since the reference flights",
    "always": "it is there in every flight",
}


def since_of(entry: Mapping[str, Any]) -> str:
    """Since when a cause is there, in words."""
    if "in training flights" in entry and not entry["in training flights"]:
        return "flights that the model was made from do not show it"
    return SINCE[entry["since"]]


def words_of(text: str, known: Mapping[str, Effect]) -> str:
    """A text with the ids in it as words; what is part of a longer name stays."""
    ids = [i for i in known if "_" in i]
    return re.sub(rf"(?<![\w/-])({'|'.join(ids)})(?![\w/-])", lambda m: name_of(m[0]), text) if ids else text


def flights_of(roles: Mapping[str, str], role: str) -> str:
    """How many flights of a role there are, in words."""
    count = sum(1 for r in roles.values() if r == role)
    return f"the {role.replace('held out', 'held-out')} flight{'s' * (count != 1)}"


def happening(effect: Mapping[str, Any], known: Mapping[str, Effect]) -> str:
    """What a cause of these parameters does, for a pilot."""
    if effect.get("sentence"):
        return effect["sentence"]
    if effect["id"] not in known:
        return name_of(effect["id"])
    return known[effect["id"]].happens({n: p["value"] for n, p in effect["parameters"].items()})


def _state(effect: Mapping[str, Any], known: Mapping[str, Effect]) -> str:
    """What a cause does, with its name and parameters, how much it does and where."""
    sentence, amount = happening(effect, known), amount_of(effect)
    text = f"{sentence[:1].upper()}{sentence[1:]} ({name_of(effect['id'])}: {parameters_of(effect['parameters'])})"
    return text + (f", which is {amount}" if amount else "")


def amount_of(effect: Mapping[str, Any]) -> str:
    """How much a cause does to its channel where it does most; nothing where that is not known."""
    acts = effect.get("acts")
    if not acts:
        return ""
    if acts["share"]:
        found = {n: 100.0 * v for n, v in acts["share"].items()}
        way = (" more" if found["value"] > 0.0 else " less") if acts["signed"] else ""
        text = f"{value_of({**found, 'value': abs(found['value']), 'unit': '%'})}{way or ' of'} thrust"
    else:
        of = {"F": "force", "M": "moment"}[acts["channel"][0]]
        channel = acts["channel"]
        way = WAYS[channel][acts["value"] < 0.0] if acts["signed"] else CHANNEL_NAMES[channel].split()[0]
        size = value_of({"value": abs(acts["value"]), "std": acts["std"], "unit": acts["unit"]})
        text = f"{size} {way} {of}" if acts["signed"] else f"{size} rms of {way} {of}"
    return text + (f" {at_place(acts['where'], [acts['range']])}" if acts["where"] else "")


def cause_sentence(effect: Mapping[str, Any], known: Mapping[str, Effect], roles: Mapping[str, str]) -> str:
    """What a named cause is, how large and since when; then what it explains and how sure that is."""
    explains = _explains(effect, roles)
    texts = [f"{_state(effect, known)}; {since_of(effect)}.", _sentence(explains and f"it {explains}"), _beyond(effect)]
    return " ".join(t for t in texts if t)


def _explains(effect: Mapping[str, Any], roles: Mapping[str, str]) -> str:
    """What a cause explains on held-out flights: what follows "it"; nothing where that is not known."""
    gain, channel = effect["gain"]["wrench"], effect.get("gain channel")
    if uncorrected(effect["id"], effect["level"]):
        return "is not corrected: the flights hold it, and results on forces and moments contain it"
    at = f" on {flights_of(roles, 'held out')}" if "held out" in roles.values() else ""
    if not effect.get("judged", True):
        return f"is hardly shown by {flights_of(roles, 'held out')} and so not judged there"
    if gain is None:
        return ""
    if channel:
        name = f"{CHANNEL_NAMES.get(channel, channel)} error ({channel})"
        found = effect.get("gains", {}).get(channel) or {"value": gain}
        if reaches_floor(found["value"]):
            return f"brings the {name} down to the noise floor{interval_of(found)}{at}"
        return f"explains {share_of(gain, found)} of the removable {name}{at}"
    if effect["level"] == "drive":
        if reaches_floor(gain):
            return f"brings the error of rotor speeds at given commands down to the noise floor{at}"
        return f"explains {percent(gain)} of the removable error of rotor speeds at given commands{at}"
    best = effect.get("removed most of")
    which = f"{CHANNEL_NAMES.get(best, best)} error" if best else "error"
    if reaches_floor(gain):
        return f"brings the {which} down to the noise floor{at}, corrected at import"
    return f"takes {percent(gain)} of the removable {which} away{at}, corrected at import"


def _beyond(effect: Mapping[str, Any]) -> str:
    """What a cause explains of the simulated motion, and what else speaks for it."""
    rolled = ""
    gained = effect["gain"].get("rollout")
    # what reaches the floor of simulations is stated by their errors, before and after, alone
    if effect.get("judged", True) and gained is not None and not reaches_floor(gained):
        share = share_of(effect["gain"]["rollout"], effect.get("rollout gain"))
        rolled = f"It explains {share} of the removable error{rollout_of(effect)}."
    return " ".join(t for t in (rolled, _sentence(_sureness(effect))) if t)


def _sureness(effect: Mapping[str, Any]) -> str:
    """What else speaks for a cause: roll-outs of held-out flights, and resamples."""
    confirmation, parts = effect.get("confirmation") or {}, []
    if confirmation.get("outcome") == "confirmed" and confirmation.get("amplitude"):
        there = value_of({**confirmation["amplitude"], "unit": "1"})
        parts.append(f"confirmed in simulation: {there} of the motion it should make is there")
    elif confirmation.get("outcome"):
        why = f" ({confirmation['why']})" if confirmation.get("why") else ""
        parts.append(f"in simulation it {confirmation['outcome']}{why}")
    return "; ".join([*parts, *support_of(effect)])


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def rollout_of(effect: Mapping[str, Any]) -> str:
    """Which simulated quantity a cause's gain in roll-outs belongs to."""
    channel, at = effect.get("rollout channel"), effect.get("rollout gain") or {}
    if not channel:
        return ""
    text = f" of the simulated {CHANNEL_NAMES.get(channel, channel)}"
    return (
        text
        + (f" after {at['horizon']:g} s" if at else "")
        + (", trim taken up" if "trim" in at.get("line", "") else "")
    )


def confirmation_of(effect: Mapping[str, Any]) -> str:
    """What roll-outs of the held-out flights say of a cause, and its parameters by output error."""
    confirmation, other = effect.get("confirmation"), effect.get("output error")
    if not confirmation:
        return ""
    text = confirmation["outcome"]
    if confirmation["amplitude"]:
        share = {**confirmation["amplitude"], "unit": "1"}
        text += f": {value_of(share)} of the motion that it should make is there"
    elif confirmation["why"]:
        text += f": {confirmation['why']}"
    if other:
        text += f"; by output error {parameters_of(other['parameters'])}"
        text += "" if other["agrees"] else ", which does not agree"
    return text


def _lost(effect: Mapping[str, Any], diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> list[str]:
    """Ids of the rivals of a named cause that were tested and lost."""
    rivals = known[effect["id"]].rivals if effect["id"] in known else ()
    named = {e["id"] for e in diagnosis["effects"]}
    names = dict.fromkeys([*effect.get("confused_with", []), *rivals])
    tested = {c["id"] for c in diagnosis["candidates"] if c.get("since") == effect["since"]}
    return [i for i in names if i in tested and i not in named]


def rivals_words(effect: Mapping[str, Any], diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> str:
    """Which rivals of a named cause were tested, and how they lost."""
    tested = _lost(effect, diagnosis, known)
    if not tested:
        return ""
    lost = {c["id"]: c for c in diagnosis["candidates"] if c.get("since") == effect["since"]}
    were = "were" if len(tested) > 1 else "was"
    # of one that is there as well, only too little of it, its p would say the opposite
    why = next((f" ({name_of(i)}: p = {lost[i]['p']:.2g})" for i in tested if (lost[i].get("p") or 0.0) > RIVAL_P), "")
    return f"{listed([name_of(i) for i in tested])} {were} tested in place of {name_of(effect['id'])} and lost{why}"


def tie_sentence(tie: Mapping[str, Any]) -> str:
    """A tie and what would break it."""
    names = alternatives(tie["ids"])
    if "constant force" in tie:
        force = tie["constant force"]
        axes = [n for n in ("north", "east", "down") if n in force]
        return (
            f"A constant {'vertical' if 'down' in axes else 'horizontal'} force of "
            f"{100 * force['share of the weight']:.0f} % of the weight pushes the vehicle "
            f"({parameters_of({n: force[n] for n in axes})}): {names}. To find out which: {tie['tie_breaker']}."
        )
    return (
        f"{names[:1].upper()}{names[1:]}: this data cannot decide which "
        f"({separability_of(tie)})"
        + (f"; to settle it: {tie['tie_breaker']}" if tie["tie_breaker"] else "")
        + "."
        + ("" if tie.get("explains", True) else " Correcting it changes neither forces nor simulations.")
    )


def left_sentence(left: Mapping[str, Any]) -> str:
    """An unexplained residual and where it lives."""
    channel, where = left["channel"], left["where"]
    # what keeps time is measured on held-out flights, all else where it was found
    found = "" if where == "frequency" else " in the compared flights"
    size = f" by {left['size']:.2g} {left['unit']} rms{found}" if "size" in left else ""
    at = f", mostly {ranges_of(where, left['mostly'])}" if left.get("mostly") and where != "frequency" else ""
    along = ALONG.get(where) or f"along the {where}"
    times = (left.get("evidence") or {}).get("times the reference flights")
    if where == UNPLACED and times is not None:
        along = along.replace("leave", f"leave ({times:.1f} times as much)", 1)
    if where == "frequency" and left.get("mostly"):
        low, high = left["mostly"][0]
        along = f"in time, at {low:.2f} to {high:.2f} Hz"
    refused = (left.get("evidence") or {}).get("looks like")
    if refused:
        share = f". It looks like {name_of(refused)}, which is refused: {left['evidence']['why not']}"
    elif not left["judged"]:
        share = "; the held-out flights do not go there and cannot judge it"
    elif left["share"] is None:
        share = ", on the held-out flights too"
    else:
        share = f", with {percent(left['share'])} of its removable error on the held-out flights"
    name = f"{CHANNEL_NAMES.get(channel, channel)} ({channel})"
    return f"The {name} is off{size} {along}{at}{share}. No cause explains this."


def at_place(where: str, mostly: Sequence[Sequence[float]]) -> str:
    """Ranges of a place with its name."""
    return ranges_of(where, mostly).replace("at ", f"at a {where} of ", 1)


def ranges_of(where: str, mostly: Sequence[Sequence[float]]) -> str:
    """Where along a place, in words."""
    if where == "room place":
        x, y = mostly[0]
        return f"near x = {x:.1f} m, y = {y:.1f} m"
    factor, unit = (math.degrees(1.0), "deg") if where == "heading" else (1.0, UNITS_AT.get(where, ""))
    texts = [_range(low * factor, high * factor) for low, high in mostly[:3]]
    return f"at {listed(texts)}{' ' if unit else ''}{unit}"


def _range(low: float, high: float) -> str:
    """Two numbers, as fine as two digits of what lies between them."""
    places = max(1 - math.floor(math.log10(high - low)), 0) if high > low else 3
    return f"{round(low, places) + 0.0:g} to {round(high, places) + 0.0:g}"


def rollout_sentence(diagnosis: Mapping[str, Any]) -> str:
    """How much nearer the extended model's simulation stays, at the longest horizon; nothing where it has nothing new.

    Causes of the rotors' drive alone act only where commands drive the simulation.
    """
    levels = {e["level"] for e in diagnosis["effects"]}
    if not levels & {"forces", "drive"} and not diagnosis.get("fitted anew"):
        return ""
    line = "rollouts" if "forces" in levels or diagnosis.get("fitted anew") else "rollouts from commands"
    rows = [r for r in diagnosis["rollouts"].get(line) or [] if r["quantity"] in ("velocity", "rate")]
    if not rows:
        return ""
    longest = max(r["horizon"] for r in rows)
    stay, texts, floors = [], [], []
    for r in (row for row in rows if row["horizon"] == longest):
        name, unit = CHANNEL_NAMES[r["quantity"]], {"velocity": "m/s", "rate": "rad/s"}[r["quantity"]]
        if abs(r["after"] - r["before"]) < STAYS * r["before"]:
            stay.append(f"{name} ({r['before']:.3g} {unit})")
            floors.append((r["after"], r.get("noise_floor")))
        else:
            texts.append(f"the {name} error goes from {r['before']:.3g} to {r['after']:.3g} {unit}")
    # what nothing that can be fitted takes away is no sign of a cause that is missing
    least = all(f is not None and f > (1.0 - STAYS) * after for after, f in floors)
    why = ", even with the best fit of all causes" if least else ""
    if len(stay) > 1:
        texts.append(f"{listed(stay)} errors stay as they are{why}")
    elif stay:
        texts.append(f"the error of {stay[0]} stays as it is{why}")
    return f"Simulated{LINE_WORDS[line]} for {longest:g} s, {listed(texts)}."


def unasked(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> str:
    """Why forces and moments could not be asked, of a diagnosis that is not judged."""
    whys = [c["why"] for c in diagnosis["cannot_be_asked"] if c["id"] in known and known[c["id"]].level == "forces"]
    return diagnosis.get("unable") or (whys[0] if whys else "the flights hold too little")


def silent_levels(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> dict[str, str]:
    """{level: why not one cause of it could be asked, "" where some could} of those of sensors and drive that the gap
    asks of. Without measured rotor speeds, causes of the drive are asked of forces and moments."""
    wanted, found = diagnosis.get("effects asked") or "all", {}
    moved = {e.level for n, e in catalogue().items() if n in known and known[n].level != e.level}
    whys = {c["id"]: c["why"] for c in diagnosis["cannot_be_asked"]}
    for level in LEVEL_WORDS:
        of = [n for n, e in known.items() if e.level == level and not e.finding and (wanted == "all" or n in wanted)]
        if of:
            found[level] = whys[of[0]] if level not in moved and all(n in whys for n in of) else ""
    return found


def asked_in_vain(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> list[str]:
    """Sentences on causes that the gap names itself and that could not be asked, and, where it names none, on levels
    of which none could; not on single causes that nobody named."""
    wanted, reasons = diagnosis.get("effects asked") or (), {}
    if wanted == "all":
        for level, why in silent_levels(diagnosis, known).items():
            if why:
                reasons.setdefault(why, []).extend(LEVEL_WORDS[level])
    for entry in diagnosis["cannot_be_asked"]:
        if not isinstance(wanted, str) and entry["id"] in wanted:
            reasons.setdefault(entry["why"], []).append(name_of(entry["id"]))
    if diagnosis.get("verdict") == "not judged" and not is_undecided(diagnosis):
        reasons.pop(unasked(diagnosis, known), None)
    return [
        _sentence(f"{listed(list(dict.fromkeys(names)))} could not be asked: {words_of(why, known)}")
        for why, names in reasons.items()
    ]


def summary(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> str:
    """The first paragraph of the report."""
    return " ".join(summed_up(diagnosis, known))


def headline(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> str:
    """Named causes in one sentence: what happens, what of the error it explains, what lost, what stays open."""
    roles, effects = diagnosis["flights"], diagnosis["effects"]
    if len(effects) == 1:
        explains = _explains(effects[0], roles)
        clauses = [_state(effects[0], known), explains and f"it {explains}", rivals_words(effects[0], diagnosis, known)]
    else:
        few = len(effects) <= MOST_DESCRIBED
        causes = [
            (f"{happening(e, known)} ({name_of(e['id'])})" if few else name_of(e["id"]))
            + (f", which {_explains(e, roles)}" if _explains(e, roles) else "")
            for e in effects
        ]
        lost = list(dict.fromkeys(name_of(i) for e in effects for i in _lost(e, diagnosis, known)))
        clauses = [f"{len(effects)} causes are named: {'; '.join(causes)}"]
        clauses.append(f"tested in their place and lost: {listed(lost)}" if lost else "")
    idle = [
        alternatives(e.get("ids") or [e["id"]]) for e in [*effects, *diagnosis["ties"]] if not e.get("explains", True)
    ]
    clauses.append(f"correcting {listed(idle)} changes neither forces nor simulations" if idle else "")
    ties = [alternatives(t["ids"]) for t in diagnosis["ties"]]
    clauses.append(f"the data cannot decide whether {listed(ties)} is there" if ties else "")
    left = dict.fromkeys(CHANNEL_NAMES.get(u["channel"], u["channel"]) for u in diagnosis["unexplained"])
    clauses.append(f"something in {listed(list(left))} stays unexplained" if left else "")
    return _sentence("; ".join(c for c in clauses if c))


def summed_up(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> list[str]:
    """One sentence that says it all; then a paragraph on each named cause, each tie, what stays, what the extension
    does."""
    roles, effects = diagnosis["flights"], diagnosis["effects"]
    limits = [s for s in [(diagnosis.get("base model") or {}).get("sentence")] if s]
    worse = [_sentence(loss["text"]) for loss in (diagnosis.get("losses") or [])[:1]]
    texts = [headline(diagnosis, known)] if effects else []
    if len(effects) == 1:  # the headline contains the rest
        since = since_of(effects[0])
        if diagnosis["ties"] or diagnosis["unexplained"]:  # which the sentence ended with
            since = f"{name_of(effects[0]['id'])}: {since}"
        texts.append(" ".join(t for t in (_sentence(since), _beyond(effects[0])) if t))
    else:
        texts += [
            " ".join(t for t in (cause_sentence(e, known, roles), _sentence(rivals_words(e, diagnosis, known))) if t)
            for e in effects
        ]
    shown = {*(e["id"] for e in effects), "trim", "sensor_error"}
    texts += [_sentence(f["text"]) for f in diagnosis.get("findings", ()) if f["id"] in shown]
    idle = [t for t in diagnosis["ties"] if not t.get("explains", True)]
    texts += [tie_sentence(t) for t in diagnosis["ties"] if t not in idle]
    texts += [left_sentence(u) for u in diagnosis["unexplained"][:3]]
    if len(diagnosis["unexplained"]) > 3:
        texts.append(f"{len(diagnosis['unexplained']) - 3} more residuals are listed in the report.")
    texts += [rollout_sentence(diagnosis), *worse] if effects else []
    nothing, missing = not texts, asked_in_vain(diagnosis, known)
    unjudged = diagnosis.get("verdict") == "not judged" and not is_undecided(diagnosis)
    if is_undecided(diagnosis) or (effects and is_unanswered(diagnosis)):
        missing.insert(0, f"A change is likelier than none, but not certain. {diagnosis['hover trim']['text']}")
    if nothing and unjudged:
        why = unasked(diagnosis, known)
        texts.append(_sentence(f"{_sound(diagnosis, known)}forces and moments could not be asked: {why}"))
    if not nothing and diagnosis.get("unable"):
        texts.append(f"Forces and moments could not be asked: {diagnosis['unable']}.")
    texts += missing
    if nothing and not unjudged:
        begin = "Nothing else that was asked" if missing else "Simulation and flights agree: nothing in the catalogue"
        texts.append(
            f"{begin}, and nothing outside it, is both significant and at least "
            f"{100 * diagnosis['material share']:.0f} % of the error that could be removed."
        )
    texts = [t for t in [*texts, *map(tie_sentence, idle)] if t]
    texts[1:1] = limits  # the first text is what a pilot reads first
    if not any("removable" in t or "noise floor" in t for t in texts):
        return texts
    levels = {e["level"] == "forces" for e in effects} | ({True} if diagnosis["unexplained"] else set())
    return [*texts, " ".join(text for level, text in REMOVABLE.items() if level in levels)]


def _sound(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> str:
    """How a sentence on sensors and drive begins that found nothing; "" where none of them was asked."""
    asked = [word for level, why in silent_levels(diagnosis, known).items() if not why for word in LEVEL_WORDS[level]]
    return f"Nothing is wrong with {listed(asked)} as far as this data shows; " if asked else ""
