"""The errors a user can mend. Each message is one sentence: what, where, found, expected, remedy."""

import difflib
from collections.abc import Iterable


class QuasiError(ValueError):
    """A fault in the input that a user can mend; the message is a sentence that says how."""


class ConfigError(QuasiError):
    """A configuration file holds an unknown key, a wrong type or an impossible value."""


class LogbookError(QuasiError):
    """The logbook lacks a column, a row or a value, or two of its rows clash."""


class ReadError(QuasiError):
    """A raw recording is absent, damaged beyond use, or not what its name says."""


class DataError(QuasiError):
    """A recording can be read, but what it holds cannot be used for what was asked."""


class ShapeError(QuasiError):
    """An array has the wrong shape."""


class ExpressionError(QuasiError):
    """An expression of a polynomial specification cannot be understood or computed."""


def nearest(name: str, known: Iterable[str]) -> str:
    """An aside that proposes the known name most like `name`: " (did you mean 'mass'?)", or the list if short.

    >>> nearest("mas", ["mass", "b"])
    " (did you mean 'mass'?)"
    """
    known = sorted(map(str, known))
    close = difflib.get_close_matches(str(name).lower(), [k.lower() for k in known], n=1, cutoff=0.6)
    if close:
        # of names that differ by case alone, such as U_q and u_q, the one in the case that was written
        alike = [k for k in known if k.lower() == close[0]]
        meant = max(alike, key=lambda k: difflib.SequenceMatcher(None, k, str(name)).ratio())
        return f" (did you mean '{meant}'?)"
    if not known:
        return ""
    shown = ", ".join(f"'{k}'" for k in known[:12]) + (", ..." if len(known) > 12 else "")
    return f" (known are {shown})"


def quoted(text: object, longest: int = 40) -> str:
    """Text from a file as a message shows it: in quotes, printable, cut to `longest` characters.

    >>> quoted("2I" + chr(1))
    "'2I?'"
    """
    plain = "".join(c if c.isprintable() else "?" for c in str(text)[: longest + 1])
    return f"'{plain[:longest]}...'" if len(plain) > longest else f"'{plain}'"


class Caution(str):
    """A note on a fault that stays in the rows used for regression: the flight is to be used with care.

    Faults that were corrected, or whose rows are marked invalid, need no caution.
    """

    __slots__ = ()


def add_caution(notes: list[str], text: str) -> None:
    """Append a note that asks for care."""
    notes.append(Caution(text))


def cautions(notes: Iterable[str]) -> list[str]:
    """The notes that ask for care, as plain text."""
    return [str(note) for note in notes if isinstance(note, Caution)]


def cautions_first(notes: Iterable[str]) -> list[str]:
    """The notes in their order, those that ask for care first: a run may print only the first ones."""
    return sorted(notes, key=lambda note: not isinstance(note, Caution))
