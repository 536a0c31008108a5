"""Errors that a user can correct. Each message is one sentence: what, where, found, expected, remedy."""

import difflib
import re
from collections.abc import Iterable

# characters of one word of a message that are shown: paths are rarely longer, what a file holds may be
MAX_WORD = 400
MAX_MESSAGE = 4_000  # characters of a message, about a screen of text
_LONG_WORD = re.compile(rf"\S{{{MAX_WORD + 1},}}")


class QuasiError(ValueError):
    """A fault in the input that a user can correct; the message states the remedy.

    What the message quotes of a file is cut and made printable: no control characters, no text direction marks.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(shorten(message))


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


def shorten(message: object) -> str:
    """Cut long words and messages in their middle; ? replaces what cannot be printed, except line ends and tabs."""
    text = str(message)
    if len(text) > MAX_WORD:
        text = _LONG_WORD.sub(lambda word: f"{word[0][:200]}...{word[0][-60:]}", text)
    if len(text) > MAX_MESSAGE:
        text = f"{text[: MAX_MESSAGE // 2]} ... {text[-MAX_MESSAGE // 2 :]}"
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\t" else "?" for c in text)


def nearest(name: str, known: Iterable[str]) -> str:
    """Suggest the known name most similar to `name`: " (did you mean 'mass'?)", or the list if short.

    >>> nearest("mas", ["mass", "b"])
    " (did you mean 'mass'?)"
    """
    name = str(name)[:100]  # the comparison costs the square of the length
    known = sorted(map(str, known))
    close = difflib.get_close_matches(name.lower(), [k.lower() for k in known], n=1, cutoff=0.6)
    if close:
        # among names that differ only by case, such as U_q and u_q, prefer the written case
        alike = [k for k in known if k.lower() == close[0]]
        meant = max(alike, key=lambda k: difflib.SequenceMatcher(None, k, name).ratio())
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
