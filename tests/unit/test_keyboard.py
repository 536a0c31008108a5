"""Keys of a terminal: what it sends, arrows in two parts, the terminal as it was afterwards, how long a key is held."""

import os
import sys

import pytest

from quasi.errors import ConfigError
from quasi.simulation.tools.keyboard import REPEAT_DELAY, HeldKeys, Terminal, decode


@pytest.mark.parametrize(
    ("sent", "keys"),
    [
        ("wW d", ["w", "w", "space", "d"]),
        ("\x1b[A\x1b[B\x1bOC\x1b[D", ["up", "down", "right", "left"]),
        ("\x1b", ["escape"]),
        ("\x1b[15~a\x1b[5~", ["a"]),  # F5 and page up have no meaning, and their letters none either
        ("\x1b[1;5Aq", ["q"]),  # control and an arrow
        ("\r\n\t", ["enter", "enter", "tab"]),
        ("", []),
    ],
)
def test_what_a_terminal_sends_is_named(sent, keys):
    assert decode(sent) == keys


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are POSIX")
def test_keys_arrive_at_once_and_the_terminal_is_as_before_afterwards():
    import termios

    screen, terminal = os.openpty()
    try:
        before = termios.tcgetattr(terminal)
        with pytest.raises(RuntimeError), Terminal(terminal) as keys:
            assert keys.read() == []
            os.write(screen, b"wa")  # no Enter
            assert keys.read() == ["w", "a"]
            os.write(screen, b"d\x1b")
            assert keys.read() == ["d"]
            os.write(screen, b"[A")  # the rest of the arrow
            assert keys.read() == ["up"]
            os.write(screen, b"\x1b")
            assert keys.read() == []
            assert keys.read() == ["escape"]  # nothing followed
            assert termios.tcgetattr(terminal)[3] & termios.ECHO == 0
            assert termios.tcgetattr(terminal)[3] & termios.ISIG  # Ctrl-C still ends the program
            raise RuntimeError
        assert termios.tcgetattr(terminal) == before
    finally:
        os.close(screen)
        os.close(terminal)


def test_without_a_terminal_a_sentence_says_so():
    reading, writing = os.pipe()
    try:
        with pytest.raises(ConfigError, match="no terminal; start it from a terminal"), Terminal(reading):
            pass
    finally:
        os.close(reading)
        os.close(writing)


def test_a_key_is_held_until_its_repeats_stop():
    held = HeldKeys()
    held.press(["w"], 0.0)
    assert held.list_held_keys(0.9 * REPEAT_DELAY) == {"w"}
    held.press(["w"], 0.5)
    held.press(["d"], 0.6)
    assert held.list_held_keys(0.5 + 0.99 * REPEAT_DELAY) == {"w", "d"}
    assert held.list_held_keys(0.5 + 1.01 * REPEAT_DELAY) == {"d"}
    assert held.list_held_keys(2.0) == set()


def test_a_release_between_two_repeats_is_none():
    held = HeldKeys()
    held.press(["w"], 0.0, ends=1e9)
    held.release("w", 1.0)
    held.press(["w"], 1.01, ends=1e9)
    assert held.list_held_keys(5.0) == {"w"}
    held.release("w", 6.0)
    assert held.list_held_keys(6.2) == set()
    held.release("x", 7.0)  # never pressed
    assert held.list_held_keys(7.0) == set()
