"""Ids of causes as words, words as lists, and values with their errors."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

GROWN_ALIKE = {"mass", "inertia"}  # both, in proportion, are what weaker rotors look like: neither is an answer alone


def name_of(ident: str) -> str:
    """An id as words."""
    return ident.replace("_", " ")


def listed(texts: Sequence[str], last: str = "and") -> str:
    """Texts as a list in words."""
    texts = list(texts)
    return texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} {last} {texts[-1]}"


def alternatives(ids: Sequence[str]) -> str:
    """The causes of a tie, each by its name, between which the data cannot decide."""
    alike = GROWN_ALIKE if set(ids) > GROWN_ALIKE else set()
    names = [name_of(i) for i in ids if i not in alike]
    return listed([*names, *(["both mass and inertia"] if alike else [])], "or")


def value_of(parameter: Mapping[str, Any]) -> str:
    """A value ± its standard error with the unit, to the error's second digit."""
    value, std, unit = parameter["value"], parameter.get("std") or 0.0, parameter.get("unit") or ""
    unit = "" if unit == "1" else f" {unit}"
    if not std > 0 or not math.isfinite(std):
        return f"{value:.4g}{unit}"
    power = math.floor(math.log10(max(abs(value), std)))
    if power < -3:
        digits = max(power - math.floor(math.log10(std)) + 1, 0)
        return f"({value / 10.0**power:.{digits}f} ± {std / 10.0**power:.{digits}f})e{power}{unit}"
    places = max(1 - math.floor(math.log10(std)), 0)
    return f"{value:.{places}f} ± {std:.{places}f}{unit}"


def parameters_of(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Parameters as a list in words."""
    return ", ".join(f"{name_of(n)} = {value_of(p)}" for n, p in parameters.items())
