"""Notes that call for care, told apart from those that only say what was done."""

from collections.abc import Iterable


class Doubt(str):
    """A note on what stays in the rows that a regression takes: the flight is to be used with care.

    What was mended, or is marked invalid, calls for none.
    """

    __slots__ = ()


def doubt(notes: list[str], text: str) -> None:
    """Add a note that calls for care."""
    notes.append(Doubt(text))


def doubts(notes: Iterable[str]) -> list[str]:
    """Those of the notes that call for care, as plain text."""
    return [str(note) for note in notes if isinstance(note, Doubt)]


def gravest_first(notes: Iterable[str]) -> list[str]:
    """The notes with those that call for care before the others, which a run may only count."""
    return sorted(notes, key=lambda note: not isinstance(note, Doubt))
