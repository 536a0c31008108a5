"""Shares of an error in words, and how sure a named cause is."""

from collections.abc import Mapping
from typing import Any

ALL = 0.995  # share from which whole percents print as 100
FLOOR = "all above the noise floor"
OFTEN, HALF = 0.8, 0.5  # shares of resamples that a cause needs beside a stronger one, and as the strongest of several


def percent(share: float | None) -> str:
    """A share in whole percent, at most all of it."""
    return "–" if share is None else f"{100 * min(share, 1.0):.0f} %"


def reaches_floor(share: float | None) -> bool:
    """Whether a share prints as all that could be removed: the floor is then the extended model's own error, and a
    percentage would look like a solved problem where the error may have hardly changed."""
    return share is not None and share >= ALL


def interval_of(found: Mapping[str, Any] | None) -> str:
    """The 95 % interval of a share, in percent; nothing where it is not known."""
    if not found or any(found.get(k) is None for k in ("value", "low", "high")):
        return ""
    low = "below -100" if found["low"] < -1.0 else f"{100 * found['low']:.0f}"
    return f" (95 %: {low} to {100 * found['high']:.0f})"


def share_of(gain: float | None, found: Mapping[str, Any] | None) -> str:
    """A share in whole percent, with its 95 % interval where there is one; in words where it reaches the floor."""
    share = found["value"] if found and found.get("value") is not None else gain
    return (FLOOR if reaches_floor(share) else percent(share)) + interval_of(found)


def certainty_of(effect: Mapping[str, Any]) -> str:
    """How sure a named cause is, in words: by simulations of held-out flights and by resamples."""
    outcome, again = (effect.get("confirmation") or {}).get("outcome"), effect.get("probability")
    if effect.get("level") == "trim":
        return f"by the trim in steady flight alone, with the probability {again:.2f}"
    if effect.get("sentence"):
        return f"each compared flight by itself shows it, with the probability {again:.2f} among all orders"
    if not effect.get("judged", True):
        return "suspected: the held-out flights hardly show it"
    gained = (effect.get("gains") or {}).get(effect.get("gain channel")) or {}
    if outcome != "confirmed" and (gained.get("low") or 0.0) < 0.0:
        return "suspected: its gain on the held-out flights may be chance"
    often = again is not None and again >= OFTEN
    if outcome == "confirmed":
        return "very sure: simulations of held-out flights confirm it" if often else "sure: simulations confirm it"
    if again is None:
        return "sure: it passed all tests"
    count = "every resample" if reaches_floor(again) else f"{percent(again)} of resamples"
    return (
        f"{'sure' if often else 'fairly sure' if again >= HALF else 'suspected'}: found again in {count} of the flights"
    )
