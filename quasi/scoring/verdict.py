"""What the diagnostics of an axis mean, in words: verdict, reasons, what to do.

A larger RMSE alone does not condemn a model: a livelier flight has larger errors in proportion. The verdict therefore
also looks at the RMSE relative to the measurement, at constant offsets (another trim: centre of gravity, mass, wind)
and at whether the validation data leave the region that the training data covered.
"""

from collections.abc import Iterable, Mapping
from typing import Any

ORDER = ("good", "usable with care", "unusable")
RULE = 10.0  # %, relative difference in RMSE from which it is significant
SHORT = 0.05  # coverage below the confidence level by which intervals are too narrow
OFFSET = 0.5  # share of the RMSE that is a constant offset
WEAK = 0.5  # R2 on the training rows below which an axis is hardly explained
LOPSIDED = 1.5  # of one outer quartile's RMSE over the other's, beyond what the training rows show
EXTENDED = "the gap that made it tells what it gains over the model that it extends"
FEWER = "remove regressors (a lower 'regressor cap', fewer candidates) or train on more flights"
TRIM = {
    **dict.fromkeys(("Fx", "Fy"), "accelerometer bias or mounting, wind"),
    "Fz": "mass, propellers, accelerometer bias, wind",
    **dict.fromkeys(("Mx", "My"), "centre of gravity, a weaker rotor"),
    "Mz": "a tilted or weaker rotor",
}


def verdict(axis: str, facts: Mapping[str, Any], extended: bool = False) -> dict[str, Any]:
    """Verdict of one axis: "verdict", "overfits", "because" and "what to do" (sentences), "said" (all in one).

    extended  whether a gap made the model: its regressors were chosen elsewhere
    facts  "rmse", "relative rmse", "r2", "bias" {role: value}, "relative difference", "warnings", "quartiles",
           "interval", "outside", "unit", as the diagnostics hold them; of an extended model "base", {"id", "rmse",
           "r2"} of the model that it extends, on the same validation rows
    """
    because: list[str] = []
    remedies: list[str] = []
    level, found = 0, []
    difference, interval = facts["relative difference"], facts["interval"]
    holdout = next((r for r in ("validation", "test") if r in facts["rmse"]), None)
    r2 = facts["r2"].get("training")
    if r2 is not None and r2 < WEAK:
        level = 1
        because.append(f"explains {percent(r2)} of the variance of its training rows only")
        remedies.append(f"fly manoeuvres that excite {axis}, offer richer candidates, or isolate regions of excitation")
    overfits = facts["warnings"]["test"]
    if overfits:
        level = 1
        because.append(f"test RMSE {difference['test above training']:.0f} % above training")
        remedies.append(FEWER)
    if holdout == "validation":
        worse, found = _validation(axis, facts, because, remedies)
        level, overfits = max(level, worse), overfits or "overfit" in found
    elif holdout is None:
        level = max(level, 1)
        because.append("no test or validation rows judge it")
        remedies.append("name 'rows of flights for validation'")
    coverage, wanted = interval["coverage"], interval["confidence"]
    for role in ("test", "validation"):
        if coverage.get(role) is not None and coverage[role] < wanted - SHORT:
            level = max(level, 1)
            because.append(f"its {percent(wanted)} intervals hold {percent(coverage[role])} of the {role} rows")
    # the manual's sign of overfitting: intervals that fit the training rows and not the test rows
    trained, tested = coverage.get("training"), coverage.get("test")
    if trained is not None and tested is not None and trained - tested > SHORT:
        level, overfits = max(level, 1), True
        because.append(f"intervals hold {percent(trained)} of the training rows, {percent(tested)} of the test rows")
    because += _lopsided(facts["quartiles"], holdout)
    beside = _beside_base(facts) if holdout == "validation" else None
    if beside:
        # flights that another model was made of: what both get wrong is no fault of the extension
        kind, said = beside
        level, overfits = _level_beside(kind, level, facts["r2"].get("validation")), False
        because.insert(0, said)
        found = [kind]
    if extended and remedies:
        remedies = [*(r for r in remedies if r.startswith("look for another trim")), EXTENDED]
    word = ORDER[level]
    return {
        "verdict": word,
        "overfits": bool(overfits),
        "kind": _kind(level, [*found, *(["overfit"] if overfits else [])], r2),
        "because": because,
        "what to do": list(dict.fromkeys(remedies)),
        "beside its base": beside[0] if beside else None,
        "said": _said(axis, word, bool(overfits), because, facts, holdout),
    }


def _validation(axis: str, facts: Mapping[str, Any], because: list[str], remedies: list[str]) -> tuple[int, list[str]]:
    """Level that the validation rows give, 0 good to 2 unusable, and what they show: "trim", "beyond", "overfit"."""
    difference = facts["relative difference"]
    above, scaled = difference["validation above training"], difference["validation above training, relative"]
    outside, r2 = facts["outside"], facts["r2"].get("validation")
    rmse, before, bias = facts["rmse"].get("validation"), facts["rmse"].get("training"), facts["bias"].get("validation")
    level, found = 0, []
    offset = bool(rmse and bias is not None and abs(bias) > OFFSET * rmse)
    if offset:
        level = 1
        found.append("trim")
        share = percent((bias / rmse) ** 2)
        because.append(f"{share} of its squared validation error is a constant offset of {bias:.3g} {facts['unit']}")
        remedies.append(f"look for another trim there: {TRIM[axis]}")
    if above is not None and above > RULE and (scaled is None or scaled > RULE):
        level = 1
        because.insert(0, f"validation RMSE {above:.0f} % above training")
        inside = outside["rmse inside"]
        if outside["variables"] and inside is not None and inside <= (1 + RULE / 100) * before:
            worst = list(outside["variables"].items())[:3]
            named = ", ".join(f"{n} in {percent(s)} of them" for n, s in worst)
            because.append(
                f"the {percent(outside['share'])} of the validation rows that lie beyond the training data ({named}) "
                "make the difference"
            )
            found.append("beyond")
            remedies.append(f"train on flights that reach further in {', '.join(n for n, _ in worst)}")
        elif not offset or rmse**2 - bias**2 > ((1 + RULE / 100) * before) ** 2:
            found.append("overfit")
            remedies.append(FEWER)
    elif above is not None and above > RULE:
        because.append(f"validation RMSE {above:.0f} % above training, in proportion to a livelier flight")
    if r2 is not None and r2 < 0:
        level = 2
        because.append(f"the mean of the validation rows would do better (R2 {r2:.2f})")
        remedies.append(f"do not use {axis} beyond its training flights")
    return level, found


def _beside_base(facts: Mapping[str, Any]) -> tuple[str, str] | None:
    """Whether an extended model does "better", "alike" or "worse" than its base on the validation rows; in words."""
    base, own = facts.get("base"), facts["rmse"].get("validation")
    if not base or not base.get("rmse") or own is None:
        return None
    change, there = 100 * (own / base["rmse"] - 1), f"{base['rmse']:.3g} {facts['unit']}"
    if abs(change) <= RULE:
        return "alike", f"validation RMSE as that of its base {base['id']} on the same flights ({there})"
    if change < 0:
        return "better", f"validation RMSE {-change:.0f} % below that of its base {base['id']} there ({there})"
    return "worse", f"validation RMSE {change:.0f} % above that of its base {base['id']} on the same flights ({there})"


def _level_beside(kind: str, level: int, r2: float | None) -> int:
    """Level of an axis of an extended model, 0 good to 2 unusable. level  what it would be for a model of its own."""
    if kind == "better":
        return 0 if r2 is None or r2 >= WEAK else 1
    if kind == "alike":
        return min(level, 1)
    return 2 if r2 is not None and r2 < 0 else 1


def beside_base(axes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """A sentence on all axes of an extended model beside its base; nothing for another model."""
    groups = {k: [a for a, f in axes.items() if f["beside its base"] == k] for k in ("better", "alike", "worse")}
    said = "; ".join(f"{kind} in {', '.join(members)}" for kind, members in groups.items() if members)
    base = next((f["base"]["id"] for f in axes.values() if f.get("base")), None)
    return [f"beside its base {base} on the same held-out flights: {said}"] if said else []


KINDS = {
    "good": "good",
    "alike": "no better than its base on these flights",
    "better": "better than its base, and still weak",
    "worse": "worse than its base",
    "trim": "a constant offset, another trim on the validation flights",
    "beyond": "the validation flights go beyond the training flights",
    "overfit": "overfitted",
    "weak": "hardly explained",
    "care": "to be used with care",
    "unusable": "not usable beyond the training flights",
}


def _kind(level: int, found: list[str], r2: float | None) -> str:
    """What an axis suffers from first, a key of KINDS."""
    if level in (0, 2):
        return "unusable" if level else "good"
    return next(
        (k for k in ("alike", "better", "worse", "trim", "beyond", "overfit") if k in found),
        "weak" if r2 is not None and r2 < WEAK else "care",
    )


def shortly(axes: Mapping[str, Mapping[str, Any]]) -> str:
    """All axes in one sentence, gathered by what they suffer from."""
    groups = {kind: [axis for axis, facts in axes.items() if facts["kind"] == kind] for kind in KINDS}
    return "; ".join(f"{', '.join(members)}: {KINDS[kind]}" for kind, members in groups.items() if members)


def _lopsided(bands: list[Mapping[str, Any]], holdout: str | None) -> list[str]:
    """Words for an error that lies on one side of the measured range and did not do so in training."""
    if holdout is None or len(bands) < 3:
        return []
    low, high = bands[0]["rmse"], bands[-1]["rmse"]
    if not all(band.get(role) for band in (low, high) for role in ("training", holdout)):
        return []
    now, before = low[holdout] / high[holdout], low["training"] / high["training"]
    sides = ((now, now / before, "lower", "upper"), (1 / now, before / now, "upper", "lower"))
    for ratio, change, here, there in sides:
        if ratio > LOPSIDED and change > LOPSIDED:
            return [f"{holdout} errors are {ratio:.1f} times as large in the {here} quartile as in the {there}"]
    return []


def _said(
    axis: str, word: str, overfits: bool, because: list[str], facts: Mapping[str, Any], holdout: str | None
) -> str:
    reasons = "; ".join(because)
    if word != "good":
        kind = "overfits" if overfits and word != "unusable" else word
        return f"{axis}: {kind}: {reasons}"
    roles = [r for r in ("training", "test", "validation") if r in facts["rmse"]]
    share = facts["relative rmse"].get(holdout)
    error = "" if share is None else f", {holdout} error {percent(share)} of the rms value"
    on = " and ".join(roles) if len(roles) < 3 else "all"
    return f"{axis}: good on {on}{error}" + (f"; {reasons}" if reasons else "")


def headline(axes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """One sentence for all good axes, one with its remedy for each other."""
    good = [axis for axis, facts in axes.items() if facts["verdict"] == "good"]
    lines = []
    if good:
        roles = [r for r in ("training", "test", "validation") if any(r in axes[a]["rmse"] for a in good)]
        lines.append(f"{', '.join(good)}: good on {' and '.join(roles) if len(roles) < 3 else 'all'}")
    for facts in axes.values():
        if facts["verdict"] != "good":
            lines.append("; ".join([facts["said"], *facts["what to do"]]))
    return lines


def unusable_held_out(made: Mapping[str, Mapping[str, Any]], validation: Iterable[str]) -> list[str]:
    """A sentence for each held-out flight with the verdict `unusable`, whose scores judge no model.

    made  {flight: metadata of its filtered table}; validation  keys of the held-out flights
    """
    return [
        f"held-out flight {key} is unusable ({why[0]}): its scores do not judge the model; hold out another flight"
        for key in validation
        if (why := made.get(key, {}).get("unusable because"))
    ]


def lower(diagnosis: Mapping[str, Any], sentences: list[str]) -> dict[str, Any]:
    """The diagnosis of a model with sentences that call for care, first in its words; as it is without any."""
    if not sentences:
        return dict(diagnosis)
    return {
        **diagnosis,
        "verdict": max(diagnosis["verdict"], ORDER[1], key=ORDER.index),
        "shortly": "; ".join([*sentences, diagnosis["shortly"]]),
        "summary": [*sentences, *diagnosis["summary"]],
    }


def percent(share: float) -> str:
    """A share as percent, with a digit behind the point below ten."""
    return f"{100 * share:.1f} %" if abs(share) < 0.0995 else f"{100 * share:.0f} %"
