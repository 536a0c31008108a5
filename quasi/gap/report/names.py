"""Ids of causes as words, and words as lists."""

from collections.abc import Sequence

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
