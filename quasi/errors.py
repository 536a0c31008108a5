"""Errors that a user can correct. Each message is one sentence: what, where, found, expected, remedy."""

import difflib
from collections.abc import Iterable


class QuasiError(ValueError):
    """A fault in the input that a user can correct; the message states the remedy."""


class ConfigError(QuasiError):
    """A configuration file holds an unknown key, a wrong type or an impossible value."""


class LogbookError(QuasiError):
    """The logbook lacks a column, a row or a value, or two of its rows clash."""


class ReadError(QuasiError):
    """A raw recording is absent, unusable or of another format than its name."""


class DataError(QuasiError):
    """A recording is readable, but its data cannot be used for the requested step."""


class ShapeError(QuasiError):
    """An array has the wrong shape."""


class ExpressionError(QuasiError):
    """An expression of a polynomial specification cannot be parsed or computed."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Suggest the known name most similar to `name`: " (did you mean 'mass'?)", or the list if short.

    >>> nearest("mas", ["mass", "b"])
    " (did you mean 'mass'?)"
    """
    known = sorted(map(str, known))
    close = difflib.get_close_matches(str(name).lower(), [k.lower() for k in known], n=1, cutoff=0.6)
    if close:
        # among names that differ only by case, such as U_q and u_q, prefer the written case
        alike = [k for k in known if k.lower() == close[0]]
        meant = max(alike, key=lambda k: difflib.SequenceMatcher(None, k, str(name)).ratio())
        return f" (did you mean '{meant}'?)"
    if not known:
        return ""
    shown = ", ".join(f"'{k}'" for k in known[:12]) + (", ..." if len(known) > 12 else "")
    return f" (known are {shown})"


def quoted(text: object, longest: int = 40) -> str:
    """Format text from a file for a message: in quotes, printable, cut to `longest` characters.

    >>> quoted("2I" + chr(1))
    "'2I?'"
    """
    plain = "".join(c if c.isprintable() else "?" for c in str(text)[: longest + 1])
    return f"'{plain[:longest]}...'" if len(plain) > longest else f"'{plain}'"


class Caution(str):
    """A note on a fault that remains in the rows for regression: the flight needs care.

    Faults that were corrected, or whose rows are marked invalid, need no caution.
    """

    __slots__ = ()


def add_caution(notes: list[str], text: str) -> None:
    """Append a caution to the notes."""
    notes.append(Caution(text))


def cautions(notes: Iterable[str]) -> list[str]:
    """List the cautions as plain text."""
    return [str(note) for note in notes if isinstance(note, Caution)]


def cautions_first(notes: Iterable[str]) -> list[str]:
    """Order the notes with cautions first, because a run may print only the first ones."""
    return sorted(notes, key=lambda note: not isinstance(note, Caution))
