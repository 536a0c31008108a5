"""Read the keys of a terminal without waiting, and track which keys are held down."""

import os
import sys
from collections.abc import Iterable
from types import TracebackType

from quasi.errors import ConfigError

# escape sequences of keys that are not one character
_SEQUENCES = {"[A": "up", "[B": "down", "[C": "right", "[D": "left"}
_NAMED = {" ": "space", "\r": "enter", "\n": "enter", "\t": "tab", "\x7f": "backspace"}
REPEAT_DELAY = 0.55  # s, longest time until a terminal begins to repeat a held key
RELEASE_DELAY = 0.06  # s, shortest release that is not a gap between two repeats


def decode(text: str) -> list[str]:
    """Decode terminal input to key names: characters as they are, "space", "up", "escape" and so on."""
    keys, k = [], 0
    while k < len(text):
        if text[k] == "\x1b":
            # arrows come as ESC [ A or, from some terminals, as ESC O A
            sequence = text[k + 1 : k + 3].replace("O", "[")
            if sequence in _SEQUENCES:
                keys.append(_SEQUENCES[sequence])
                k += 3
                continue
            if text[k + 1 : k + 2] in ("[", "O"):
                # another key (F5, page up): skip its whole sequence
                k += 2
                while k < len(text) and not ("@" <= text[k] <= "~"):
                    k += 1
                k += 1
                continue
            keys.append("escape")
        else:
            keys.append(_NAMED.get(text[k], text[k].lower()))
        k += 1
    return keys


class Terminal:
    """The keys pressed in a terminal: `with Terminal() as keys:`, then `keys.read()` repeatedly.

    Inside the block, characters are not echoed and do not wait for Enter; Ctrl-C still ends the program.
    file  number of the terminal's file, standard input if not given
    Raises ConfigError where there is no terminal.
    """

    def __init__(self, file: int | None = None) -> None:
        self._file = file
        self._before: list | None = None
        self._rest = ""

    def __enter__(self) -> "Terminal":
        if self._file is None:
            try:
                self._file = sys.stdin.fileno()
            except (AttributeError, OSError, ValueError):
                self._file = -1
        if self._file < 0 or not os.isatty(self._file):
            raise ConfigError("the keyboard cannot be read: standard input is no terminal; start it from a terminal")
        if sys.platform != "win32":
            import termios
            import tty

            self._before = termios.tcgetattr(self._file)
            tty.setcbreak(self._file)
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._before is not None:
            import termios

            termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)
            self._before = None

    def read(self) -> list[str]:
        """Read the keys pressed since the last call, oldest first."""
        if sys.platform == "win32":
            return self._read_windows()
        import select

        data = b""
        while select.select([self._file], [], [], 0.0)[0]:
            part = os.read(self._file, 1024)
            if not part:
                break
            data += part
        text, waited = self._rest + data.decode("utf-8", errors="ignore"), bool(self._rest)
        self._rest = ""
        # the rest of an arrow sequence may arrive later; otherwise it was the escape key
        if text.endswith(("\x1b", "\x1b[", "\x1bO")) and not (waited and not data):
            cut = text.rindex("\x1b")
            text, self._rest = text[:cut], text[cut:]
        return decode(text)

    def _read_windows(self) -> list[str]:
        import msvcrt

        arrows = {"H": "up", "P": "down", "M": "right", "K": "left"}
        keys = []
        while msvcrt.kbhit():
            character = msvcrt.getwch()
            if character in "\x00\xe0":
                keys += [arrows[c]] if (c := msvcrt.getwch()) in arrows else []
            else:
                keys += decode(character)
        return keys


class HeldKeys:
    """Keys that are held down.

    A terminal reports key presses only, repeatedly while a key is down. A window also reports releases, on some systems
    even between the repeats of a held key.
    """

    def __init__(self) -> None:
        self._until: dict[str, float] = {}

    def press(self, keys: Iterable[str], now: float, ends: float = REPEAT_DELAY) -> None:
        """Register keys pressed at time now, s; they stay held for `ends` s unless pressed again."""
        for key in keys:
            self._until[key] = max(now + ends, self._until.get(key, now))

    def release(self, key: str, now: float) -> None:
        """Register the release of a key at time now, s."""
        if key in self._until:
            self._until[key] = now + RELEASE_DELAY

    def clear(self) -> None:
        """Release all keys."""
        self._until.clear()

    def list_held_keys(self, now: float) -> set[str]:
        """List the keys that are held at time now, s."""
        self._until = {key: until for key, until in self._until.items() if until > now}
        return set(self._until)
