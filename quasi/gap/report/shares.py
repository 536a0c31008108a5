"""Shares of an error in words, and how sure a named cause is."""

from collections.abc import Mapping
from typing import Any

ALL = 0.995  # share from which whole percents print as 100
SEPARATED = 3.0  # standard errors from which noise leaves no doubt (p = 0.003)
TO_THE_FLOOR = "all above the noise floor"
# least probability of a word: 0.9 is what `hover_trim.NAMED` asks for, 0.99 is one error in a hundred names
CERTAINTY_WORDS = ((0.99, "very sure"), (0.9, "sure"), (0.7, "fairly sure"), (0.5, "suspected"))


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
    return (TO_THE_FLOOR if reaches_floor(share) else percent(share)) + interval_of(found)


def certainty_of(effect: Mapping[str, Any]) -> str:
    """How sure a named cause is, in words: the word follows from the probability alone; then what else is known."""
    chance, again = effect.get("probability"), effect.get("share of resamples")
    if effect.get("level") == "trim":
        return f"{_word(chance)}: by the trim in steady flight alone, with the probability {chance:.2f}"
    if effect.get("sentence"):
        shown = "each compared flight by itself shows it"
        return f"{_word(chance)}: {shown}, with the probability {chance:.2f} among all orders"
    outcome, reasons = (effect.get("confirmation") or {}).get("outcome"), []
    if outcome == "confirmed":
        reasons.append("simulations of held-out flights confirm it")
    elif not effect.get("judged", True):
        reasons.append("the held-out flights hardly show it")
    elif (((effect.get("gains") or {}).get(effect.get("gain channel")) or {}).get("low") or 0.0) < 0.0:
        reasons.append("its gain on the held-out flights may be chance")
    if again is not None:
        reasons.append(
            f"found again in {'every resample' if reaches_floor(again) else f'{percent(again)} of resamples'}"
        )
    begin = _word(chance) + (f", with the probability {chance_of(chance)}" if chance is not None else "")
    return f"{begin}: {'; '.join(reasons)}" if reasons else begin


def support_of(effect: Mapping[str, Any]) -> list[str]:
    """What resamples say of a cause, and its probability, a clause each."""
    if effect.get("level") == "trim" or effect.get("sentence"):
        return [certainty_of(effect)]
    chance, again, parts = effect.get("probability"), effect.get("share of resamples"), []
    if again is not None:
        parts.append(f"named again in {'every resample' if reaches_floor(again) else f'{percent(again)} of resamples'}")
    return parts + ([f"the probability that it is there is {chance_of(chance)}"] if chance is not None else [])


def separability_of(tie: Mapping[str, Any]) -> str:
    """How far the causes of a tie are apart, and the probability that one of them is there, where it is known."""
    chance, text = tie.get("probability"), f"separability {tie['separability']:.1f} standard errors"
    if tie["separability"] > SEPARATED:
        text += " of noise, which is within the error of a model's form"
    return text if chance is None else f"{text}; one of them is there with the probability {chance_of(chance)}"


def chance_of(probability: float) -> str:
    """A probability in two digits; values that round to certainty are printed as bounds."""
    return "above 0.99" if probability >= ALL else "below 0.01" if probability < 1.0 - ALL else f"{probability:.2f}"


def _word(probability: float | None) -> str:
    """A probability as a word. Without one, all tests were passed and nothing else is known."""
    if probability is None:
        return "it passed all tests"
    return next((word for least, word in CERTAINTY_WORDS if probability >= least), "doubtful")
