"""Verdict on an axis from its diagnostics: verdict, reasons, remedies.

A larger RMSE alone does not reject a model, because a more dynamic flight has proportionally larger errors. The verdict
also considers the RMSE relative to the measurement and constant offsets (another trim: centre of gravity, mass, wind).
It also checks whether the validation data leave the region of the training data.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from quasi.model.extensions import are_estimated

VERDICTS = ("good", "usable with care", "unusable")
SIGNIFICANT_PERCENT = 10.0  # %, relative difference in RMSE from which it is significant
MAX_COVERAGE_SHORTFALL = 0.05  # coverage below the confidence level beyond which intervals are too narrow
MIN_OFFSET_SHARE = 0.5  # share of the RMSE that is a constant offset
MIN_R2 = 0.5  # R2 on the training rows below which an axis is hardly explained
MAX_QUARTILE_RATIO = 1.5  # ratio of the RMSE of both outer quartiles, relative to that of the training rows
EXTENDED_REMEDY = "see the gap that made it for its improvement over the base model"
OVERFITTING_REMEDY = "remove regressors (a lower 'regressor cap', fewer candidates) or train on more flights"
TRIM_CAUSES = {
    **dict.fromkeys(("Fx", "Fy"), "accelerometer bias or mounting, wind"),
    "Fz": "mass, propellers, accelerometer bias, wind",
    **dict.fromkeys(("Mx", "My"), "centre of gravity, a weaker rotor"),
    "Mz": "a tilted or weaker rotor",
}


def derive_verdict(axis: str, facts: Mapping[str, Any], extended: bool = False) -> dict[str, Any]:
    """Derive the verdict of one axis: "verdict", "overfits", "because" and "what to do" (sentences), "statement" (all
    in one).

    extended  whether a gap made the model; its regressors were then selected elsewhere
    facts  "rmse", "relative rmse", "r2", "bias" {role: value}, "relative difference", "warnings", "quartiles",
           "interval", "outside", "unit", as the diagnostics hold them; of an extended model "base", {"id", "rmse",
           "r2"} of the model that it extends, on the same validation rows
    """
    if facts["rmse"].get("training") is not None and facts["r2"].get("training") is None:
        return _describe_unmeasured(axis)
    because: list[str] = []
    remedies: list[str] = []
    level, found = 0, []
    difference, interval = facts["relative difference"], facts["interval"]
    holdout = next((r for r in ("validation", "test") if r in facts["rmse"]), None)
    r2 = facts["r2"].get("training")
    if r2 is not None and r2 < MIN_R2:
        level = 1
        because.append(f"explains only {format_percent(r2)} of the variance of its training rows")
        remedies.append(f"fly manoeuvres that excite {axis}, offer richer candidates, or isolate regions of excitation")
    overfits = facts["warnings"]["test"]
    if overfits:
        level = 1
        because.append(f"test RMSE {difference['test above training']:.0f} % above training")
        remedies.append(OVERFITTING_REMEDY)
    if holdout == "validation":
        worse, found = _judge_validation(axis, facts, because, remedies)
        level, overfits = max(level, worse), overfits or "overfit" in found
    elif holdout is None:
        level = max(level, 1)
        because.append("no test or validation rows")
        remedies.append("name 'rows of flights for validation'")
    coverage, wanted = interval["coverage"], interval["confidence"]
    for role in ("test", "validation"):
        if coverage.get(role) is not None and coverage[role] < wanted - MAX_COVERAGE_SHORTFALL:
            level = max(level, 1)
            because.append(
                f"its {format_percent(wanted)} intervals contain {format_percent(coverage[role])} of the {role} rows"
            )
    # the manual's sign of overfitting: intervals cover the training rows but not the test rows
    trained, tested = coverage.get("training"), coverage.get("test")
    if trained is not None and tested is not None and trained - tested > MAX_COVERAGE_SHORTFALL:
        level, overfits = max(level, 1), True
        because.append(
            f"intervals contain {format_percent(trained)} of the training rows, {format_percent(tested)} of "
            "the test rows"
        )
    because += _describe_asymmetry(facts["quartiles"], holdout)
    against_base = _compare_axis_with_base(facts) if holdout == "validation" else None
    if against_base:
        # held-out flights of the base: an error common to both models is no fault of the extension
        kind, text = against_base
        level, overfits = _level_against_base(kind, level, facts["r2"].get("validation")), False
        because.insert(0, text)
        found = [kind]
    if extended and remedies:
        remedies = [*(r for r in remedies if r.startswith("look for another trim")), EXTENDED_REMEDY]
    word = VERDICTS[level]
    return {
        "verdict": word,
        "overfits": bool(overfits),
        "kind": _find_kind(level, [*found, *(["overfit"] if overfits else [])], r2),
        "because": because,
        "what to do": list(dict.fromkeys(remedies)),
        "against its base": against_base[0] if against_base else None,
        "statement": _describe_axis(axis, word, bool(overfits), because, facts, holdout),
    }


def _describe_unmeasured(axis: str) -> dict[str, Any]:
    """As `derive_verdict`, of an axis that stays the same but for rounding (`score.LEAST_MEASURED`)."""
    because = [f"{axis} is constant in the training flights, so no source measured it, and it cannot be judged"]
    return {
        "verdict": VERDICTS[1],
        "overfits": False,
        "kind": "care",
        "because": because,
        "what to do": [f"log what {axis} follows from (docs/your-own-data.md, section 4)"],
        "against its base": None,
        "statement": f"{axis}: {VERDICTS[1]}: {because[0]}",
    }


def _judge_validation(
    axis: str, facts: Mapping[str, Any], because: list[str], remedies: list[str]
) -> tuple[int, list[str]]:
    """Judge the validation rows: level 0 good to 2 unusable, and findings "trim", "beyond", "overfit"."""
    difference = facts["relative difference"]
    above, scaled = difference["validation above training"], difference["validation above training, relative"]
    outside, r2 = facts["outside"], facts["r2"].get("validation")
    rmse, before, bias = facts["rmse"].get("validation"), facts["rmse"].get("training"), facts["bias"].get("validation")
    level, found = 0, []
    offset = bool(rmse and bias is not None and abs(bias) > MIN_OFFSET_SHARE * rmse)
    if offset:
        level = 1
        found.append("trim")
        share = format_percent((bias / rmse) ** 2)
        because.append(f"{share} of its squared validation error is a constant offset of {bias:.3g} {facts['unit']}")
        remedies.append(f"look for another trim on these flights: {TRIM_CAUSES[axis]}")
    if above is not None and above > SIGNIFICANT_PERCENT and (scaled is None or scaled > SIGNIFICANT_PERCENT):
        level = 1
        because.insert(0, f"validation RMSE {above:.0f} % above training")
        inside = outside["rmse inside"]
        if outside["variables"] and inside is not None and inside <= (1 + SIGNIFICANT_PERCENT / 100) * before:
            worst = list(outside["variables"].items())[:3]
            named = ", ".join(f"{n} in {format_percent(s)} of them" for n, s in worst)
            because.append(
                f"the difference comes from the {format_percent(outside['share'])} of the validation rows beyond the "
                f"training data ({named})"
            )
            found.append("beyond")
            remedies.append(f"train on flights with a wider range of {', '.join(n for n, _ in worst)}")
        elif not offset or rmse**2 - bias**2 > ((1 + SIGNIFICANT_PERCENT / 100) * before) ** 2:
            found.append("overfit")
            remedies.append(OVERFITTING_REMEDY)
    elif above is not None and above > SIGNIFICANT_PERCENT:
        because.append(f"validation RMSE {above:.0f} % above training, in proportion to a more dynamic flight")
    if r2 is not None and r2 < 0:
        level = 2
        because.append(f"the mean of the validation rows predicts better (R2 {r2:.2f})")
        remedies.append(f"do not use {axis} beyond its training flights")
    return level, found


def _compare_axis_with_base(facts: Mapping[str, Any]) -> tuple[str, str] | None:
    """Compare an extended model with its base on the validation rows: "better", "alike" or "worse", and a sentence."""
    base, own = facts.get("base"), facts["rmse"].get("validation")
    if not base or not base.get("rmse") or own is None:
        return None
    change, there = 100 * (own / base["rmse"] - 1), f"{base['rmse']:.3g} {facts['unit']}"
    if abs(change) <= SIGNIFICANT_PERCENT:
        return "alike", f"validation RMSE as that of its base {base['id']} on the same flights ({there})"
    if change < 0:
        return "better", f"validation RMSE {-change:.0f} % below that of its base {base['id']} there ({there})"
    return "worse", f"validation RMSE {change:.0f} % above that of its base {base['id']} on the same flights ({there})"


def _level_against_base(kind: str, level: int, r2: float | None) -> int:
    """Level of an axis of an extended model, 0 good to 2 unusable. level  of the axis without a base."""
    if kind == "better":
        return 0 if r2 is None or r2 >= MIN_R2 else 1
    if kind == "alike":
        return min(level, 1)
    return 2 if r2 is not None and r2 < 0 else 1


def compare_with_base(axes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Compare all axes of an extended model with its base in one sentence; nothing for other models."""
    groups = {k: [a for a, f in axes.items() if f["against its base"] == k] for k in ("better", "alike", "worse")}
    text = "; ".join(f"{kind} in {', '.join(members)}" for kind, members in groups.items() if members)
    base = next((f["base"]["id"] for f in axes.values() if f.get("base")), None)
    return [f"compared with its base {base} on the same held-out flights: {text}"] if text else []


KIND_TEXTS = {
    "good": "good",
    "alike": "no better than its base on these flights",
    "better": "better than its base, and still weak",
    "worse": "worse than its base",
    "trim": "a constant offset, another trim on the validation flights",
    "beyond": "the validation flights go beyond the training flights",
    "overfit": "overfitted",
    "weak": "weakly explained",
    "care": "to be used with care",
    "unusable": "not usable beyond the training flights",
}


def _find_kind(level: int, found: list[str], r2: float | None) -> str:
    """Find the main problem of an axis, a key of KIND_TEXTS."""
    if level in (0, 2):
        return "unusable" if level else "good"
    return next(
        (k for k in ("alike", "better", "worse", "trim", "beyond", "overfit") if k in found),
        "weak" if r2 is not None and r2 < MIN_R2 else "care",
    )


def group_axes_by_kind(axes: Mapping[str, Mapping[str, Any]]) -> str:
    """Summarise all axes in one sentence, grouped by their main problem."""
    groups = {kind: [axis for axis, facts in axes.items() if facts["kind"] == kind] for kind in KIND_TEXTS}
    return "; ".join(f"{', '.join(members)}: {KIND_TEXTS[kind]}" for kind, members in groups.items() if members)


def _describe_asymmetry(bands: list[Mapping[str, Any]], holdout: str | None) -> list[str]:
    """Describe an error on one side of the measured range that training did not have."""
    if holdout is None or len(bands) < 3:
        return []
    low, high = bands[0]["rmse"], bands[-1]["rmse"]
    if not all(band.get(role) for band in (low, high) for role in ("training", holdout)):
        return []
    now, before = low[holdout] / high[holdout], low["training"] / high["training"]
    sides = ((now, now / before, "lower", "upper"), (1 / now, before / now, "upper", "lower"))
    for ratio, change, here, there in sides:
        if ratio > MAX_QUARTILE_RATIO and change > MAX_QUARTILE_RATIO:
            return [f"{holdout} errors are {ratio:.1f} times as large in the {here} quartile as in the {there}"]
    return []


def _describe_axis(
    axis: str, word: str, overfits: bool, because: list[str], facts: Mapping[str, Any], holdout: str | None
) -> str:
    reasons = "; ".join(because)
    if word != "good":
        kind = "overfits" if overfits and word != "unusable" else word
        return f"{axis}: {kind}: {reasons}"
    roles = [r for r in ("training", "test", "validation") if r in facts["rmse"]]
    share = facts["relative rmse"].get(holdout)
    error = "" if share is None else f", {holdout} error {format_percent(share)} of the rms value"
    on = " and ".join(roles) if len(roles) < 3 else "all"
    return f"{axis}: good on {on}{error}" + (f"; {reasons}" if reasons else "")


def summarise_axes(axes: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Summarise all good axes in one sentence, and each other axis with its remedy."""
    good = [axis for axis, facts in axes.items() if facts["verdict"] == "good"]
    lines = []
    if good:
        roles = [r for r in ("training", "test", "validation") if any(r in axes[a]["rmse"] for a in good)]
        lines.append(f"{', '.join(good)}: good on {' and '.join(roles) if len(roles) < 3 else 'all'}")
    for facts in axes.values():
        if facts["verdict"] != "good":
            lines.append("; ".join([facts["statement"], *facts["what to do"]]))
    return lines


def describe_unusable_flights(made: Mapping[str, Mapping[str, Any]], validation: Iterable[str]) -> list[str]:
    """Describe each held-out flight with the verdict `unusable`, whose scores cannot judge a model.

    made  {flight: metadata of its filtered table}; validation  keys of the held-out flights
    """
    return [
        f"held-out flight {key} is unusable ({why[0]}): its scores cannot judge the model; hold out another flight"
        for key in validation
        if (why := made.get(key, {}).get("unusable because"))
    ]


def describe_flights_without_voltage(
    flights: Mapping[str, Iterable[str]], drive: Mapping[str, Any] | None, validation: Iterable[str]
) -> list[str]:
    """Describe each held-out flight whose rotor speeds are estimated by a map that needs a voltage it does not log.

    flights  {key: columns of the filtered table}; drive  the model's map from commands to rotor speeds
    validation  keys of the held-out flights
    """
    if not drive or not drive["voltage exponent"]:
        return []
    lacking = [k for k in validation if are_estimated(flights[k]) and "battery_voltage" not in flights[k]]
    return [
        f"held-out flight {key} logs no battery voltage, which the map from commands to rotor speeds needs: its scores "
        "hold the error of a constant voltage; hold out another flight"
        for key in lacking
    ]


def lower_verdict(diagnosis: Mapping[str, Any], sentences: list[str]) -> dict[str, Any]:
    """Lower the verdict of a diagnosis to "usable with care" by sentences, placed first; unchanged without any."""
    if not sentences:
        return dict(diagnosis)
    return {
        **diagnosis,
        "verdict": max(diagnosis["verdict"], VERDICTS[1], key=VERDICTS.index),
        "in short": "; ".join([*sentences, diagnosis["in short"]]),
        "summary": [*sentences, *diagnosis["summary"]],
    }


def format_percent(share: float) -> str:
    """Format a share as percent, with one decimal below ten."""
    return f"{100 * share:.1f} %" if abs(share) < 0.0995 else f"{100 * share:.0f} %"
