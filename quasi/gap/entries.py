"""How causes stand in diagnosis.json: parameters as they are, gains, ties, and what was asked and is not named."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quasi.gap.effect import Effect, Vehicle
from quasi.gap.levels.corrections import uncorrected
from quasi.gap.levels.forces.identify import Found
from quasi.gap.levels.forces.search import estimate
from quasi.gap.levels.rollouts.confirmation import Settled
from quasi.gap.materiality import Cause

# shares of resamples in which a cause alone, the strongest of several, another one must be found again
ALONE, STRONGEST, WEAKER = 0.2, 0.5, 0.8
SAME_DELAY = 3.0  # standard errors within which two delays are the same
FAR_BELOW = 0.01  # of the level: so improbable a cause needs half as many next to another; a resample holds two thirds


def needed(cause: Cause, found: Found) -> float:
    """Share of resamples in which a cause must be found again. One alone stands by its significance and by what held-
    out flights say, unless a few seconds of flight make all of it; where these cannot say anything, it has to come
    again more often. Next to a stronger one, it may only correct what that one leaves."""
    unjudged = any((c.effect.id, c.since) == (cause.effect.id, cause.since) for c in found.unjudged)
    others = [c for c in [*found.causes, *found.stand_ins] if c.since == cause.since and c is not cause]
    # what a model misses of its own vehicle leaves nothing that looks like what no sound vehicle has
    foreign = cause.effect.absent_when_healthy and cause.since == "always"
    stronger = [c for c in others if c.test.p <= cause.test.p and c.effect.absent_when_healthy >= foreign]
    if not stronger:
        return STRONGEST if others or unjudged else ALONE
    if cause.test.p >= FAR_BELOW * found.level[cause.since]:
        return WEAKER
    return max(0.5 * WEAKER, STRONGEST) if unjudged else 0.5 * WEAKER


def deviations(effect: Effect, parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Deviations from neutral of parameters as they are stated."""
    return {n: p["value"] - (effect.parameters[n].neutral or 0.0) for n, p in parameters.items()}


def truth(effect: Effect, name: str, deviation: float, vehicle: Vehicle) -> float:
    """A parameter as it is, of its deviation from neutral; masses and inertias from the configured ones."""
    neutral = effect.parameters[name].neutral
    if neutral is not None:
        return neutral + deviation
    if name == "mass":
        return vehicle.mass + deviation
    if len(name) == 3 and name[0] == "I":
        i, j = "xyz".index(name[1]), "xyz".index(name[2])
        # off the diagonal the tensor holds minus the products, which the parameters are
        return float(vehicle.inertia[i, j] if i == j else -vehicle.inertia[i, j]) + deviation
    return deviation


def parameters_of(effect: Effect, value: Mapping[str, float], std: Mapping[str, float], vehicle: Vehicle) -> dict:
    """Parameters as they are, with standard errors and units, of deviations by name."""
    if effect.reported is not None:
        return {n: size._asdict() for n, size in effect.reported(value, std).items()}
    return {
        n: {"value": float(truth(effect, n, v, vehicle)), "std": float(std[n]), "unit": effect.parameters[n].unit}
        for n, v in value.items()
    }


def wrench_effect(cause: Cause, vehicle: Vehicle, settled: Settled) -> dict[str, Any]:
    """An effect of forces and moments. vehicle  of which masses and inertias are stated"""
    key = cause.effect.id, cause.since
    rolled = settled.estimates.get(key)
    return {
        "id": cause.effect.id,
        "level": "forces",
        "since": cause.since,
        "share of resamples": cause.probability,
        "channels": list(cause.effect.channels),
        "parameters": parameters_of(cause.effect, cause.value, cause.std, vehicle),
        **gain_entry(cause, cause.gain),
        "confused_with": [r.id for r in cause.rivals],
        "rivals": [r._asdict() for r in cause.rivals],
        "evidence": {"p": cause.test.p, "wald": cause.test.wald, "between flights": cause.test.tau,
                     "axes apart": cause.apart},
        "confirmation": settled.confirmations[key].document(),
        "output error": rolled and {"agrees": rolled.agrees,
                                    "parameters": parameters_of(cause.effect, rolled.value, rolled.std, vehicle)},
    }  # fmt: skip


def gain_entry(cause: Cause, gains: Mapping[str, Mapping[str, float | None]]) -> dict[str, Any]:
    """What a cause removes of forces and moments, and the one figure: that of its channel where it removes the largest
    share of the whole error. Of what can be removed, two causes that both act there may each remove all."""
    seen = [a for a in cause.effect.channels or gains if a in gains and gains[a]["value"] is not None]
    best = max(seen, key=lambda a: gains[a]["value"] * gains[a].get("removable", 1.0), default=None)
    share = min(gains[best]["value"], 1.0) if best else None
    return {"gain": {"wrench": share, "rollout": None}, "gain channel": best, "gains": gains}


def lower_effect(effect: Mapping[str, Any], level: str, gap: Mapping[str, Any]) -> dict[str, Any]:
    """An effect of sensors or drive; its gain on held-out flights is that of the channel that it removes most of.

    Of one that nothing corrects there is no gain.
    """
    if uncorrected(effect["id"], level):
        kept = {k: v for k, v in effect.items() if k not in ("removed", "removed most of")}
        return {**kept, "level": level, "gain": {"wrench": None, "rollout": None}, "confused_with": []}
    best: tuple[float, float | None] = (0.0, None)
    if effect.get("removed"):
        share = effect["removed"][effect["removed most of"]]
        gain = {"wrench": min(share, 1.0), "rollout": None}
        return {**effect, "level": level, "gain": gain, "confused_with": []}
    for channel in effect["channels"]:
        old, new, floor = (gap[k].get(level, {}).get(channel, {}).get("0") for k in ("before", "after", "noise_floor"))
        if old is None or new is None or floor is None or floor**2 >= 0.9 * old**2:
            continue
        gone = (old**2 - new**2) / (old**2 - floor**2)
        if (old**2 - floor**2) / old**2 > best[0]:
            best = ((old**2 - floor**2) / old**2, float(gone))
    return {**effect, "level": level, "gain": {"wrench": best[1], "rollout": None}, "confused_with": []}


def of_late_telemetry(effects: Sequence[Mapping[str, Any]]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Effects of the drive without a delay of commands that is the other side of late telemetry, and the finding of it.

    A model that was made of flights with late telemetry holds the lateness as a delay of commands: once the telemetry
    is put right that delay is too long by as much. It stays in the extended model, but is no cause of its own.
    """
    delays = {e["id"]: e for e in effects if e["id"] in ("command_delay", "telemetry_delay") and e["since"] == "always"}
    if len(delays) == 2:
        late, own = (delays[n]["parameters"]["delay"] for n in ("telemetry_delay", "command_delay"))
        std = float(np.hypot(late["std"], own["std"]))
        if own["value"] < 0.0 and abs(late["value"] + own["value"]) < SAME_DELAY * std:
            text = (
                "the model's delay of commands holds the late telemetry of the flights that it was made from: in the "
                f"extended model it is {-1e3 * own['value']:.1f} ± {1e3 * own['std']:.1f} ms shorter"
            )
            found = {"id": "command_delay", "text": text, "evidence": {"delay": own}}
            return [dict(e) for e in effects if e is not delays["command_delay"]], [found]
    return [dict(e) for e in effects], []


def tie_entry(since: str, tie: Any, effects: Mapping[str, Effect], vehicle: Vehicle) -> dict[str, Any]:
    """A tie of forces and moments. vehicle  as in `wrench_effect`"""
    ids = [t.offer.cause for t in tie.tests]
    parameters = {}
    for test in tie.tests:
        effect = effects[test.offer.cause]
        parameters[effect.id] = parameters_of(effect, *estimate(test, effect, vehicle), vehicle)
    breaker = next((b for i in ids if (b := effects[i].tie_breaker)), "")
    return {"ids": ids, "since": since, "separability": tie.separability, "tie_breaker": breaker,
            "parameters": parameters, "evidence": {"p": tie.tests[0].p, "axes apart": tie.apart}}  # fmt: skip


def candidates(found: Found, settled: Settled, share: float) -> list[dict[str, Any]]:
    """Causes that were asked and are not named, the most significant first, with the reason."""
    kept = settled.causes
    out = {(c.effect.id, c.since) for c in kept} | {(t.offer.cause, s) for s, tie in found.ties for t in tie.tests}
    entries = []

    def add(cause: str, since: str, test: Any, why: str) -> None:
        if (cause, since) not in out:
            out.add((cause, since))
            entries.append({"id": cause, "since": since, "score": test.wald, "p": test.p, "why_not": why})

    for c, confirmation in settled.dropped:
        add(c.effect.id, c.since, c.test, confirmation.why)
    for name, (test, why) in found.contradicted.items():
        add(name, test.offer.since, test, why)
    for c in [*found.causes, *found.stand_ins]:
        again, least = 100 * c.probability, 100 * (needed(c, found) if c.needed is None else c.needed)
        why = f"found again in {again:.0f} % of the resamples only, expected {least:.0f} %"
        add(c.effect.id, c.since, c.test, why)
    for c in found.immaterial:
        why = f"there, but it removes less than {100 * share:.0f} % of the removable error on held-out flights"
        lead = c.effect.fitted[0]
        if c.effect.parameters[lead].neutral == c.effect.parameters[lead].low and c.value.get(lead, 0.0) < 0.0:
            why = "the reference flights have more of it than the compared ones, which the model fits without it"
        if c.since == "always":
            why = (
                "there, but with the model's own terms fitted anew it is not sure to remove "
                f"{100 * c.asked:.0f} % of the removable error on flights left out"
                if c.asked is not None
                else "so little next to stronger causes that it may be their form"
            )
        add(c.effect.id, c.since, c.test, why)
    for c in kept:
        for r in c.rivals:
            name = c.effect.id
            why = f"with {name} given it adds nothing (p = {r.p_given_cause:.2g}); {name} stays significant with it"
            if (r.id, c.since) not in out:
                out.add((r.id, c.since))
                entries.append({"id": r.id, "since": c.since, "score": None, "p": r.p_given_cause, "why_not": why})
    named = ", ".join(sorted({c.effect.id for c in found.causes})) or "the model's own terms"
    for test in found.ranking:
        level = found.level[test.offer.since]
        why = f"p = {test.p:.2g} with {named} given, not below {level:.2g}"
        if test.p < level:
            why = found.passed.get(test.offer, "others explain what it does")
        add(test.offer.cause, test.offer.since, test, why)
    return entries
