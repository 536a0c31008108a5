"""A simulated drone flown by hand: keys to a reference, the simulation in real time, a live view of it.

w s a d: forward, backward, left, right as the drone's heading goes; up down (or i k): height; left right (or j l):
heading; m: velocity or attitude reference; space: halt; r: start again; q: end. Closing the window ends as well.
What the loop needs of a simulation, of keys and of a window are three small interfaces, so that each can be replaced.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from quasi.simulation.tools.keyboard import Held

VELOCITY, ATTITUDE = 1, 2  # kinds of a goal, as the controllers know them
GOAL = 20
SLOWEST = 0.1  # s of simulation at most between two pictures: a slow computer flies slower, not with longer steps
HELP = "w a s d fly, arrows height and heading, m mode, space halt, r again, q end"


@dataclass(frozen=True)
class Handling:
    """What a key that is held asks for: speed m/s, climb m/s, turn rad/s; tilt rad, and lift as a share of the weight
    with an attitude reference. acceleration m/s2 and tilting rad/s bound how fast the reference changes."""

    speed: float = 3.0
    climb: float = 1.5
    turn: float = 1.6
    tilt: float = math.radians(20.0)
    lift: float = 0.2
    acceleration: float = 6.0
    tilting: float = math.radians(120.0)


class Pilot:
    """The reference that held keys make. weight N; yaw rad, the heading at the beginning."""

    def __init__(self, weight: float, yaw: float = 0.0, handling: Handling | None = None) -> None:
        self.weight, self.yaw = weight, yaw
        self.handling = handling or Handling()
        self.kind = VELOCITY
        self._asked = np.zeros(3)  # forward, right, up: m/s, or rad and a share with an attitude reference

    def switch(self) -> None:
        """From a velocity to an attitude reference, or back."""
        self.kind = ATTITUDE if self.kind == VELOCITY else VELOCITY
        self._asked[:] = 0.0

    def halt(self) -> None:
        """Level, or stand, at once."""
        self._asked[:] = 0.0

    def goal(self, held: set[str], dt: float) -> np.ndarray:
        """The goal (20,) after dt s with these keys held: kind; velocity (earth) or angles; yaw, yaw rate; thrust."""
        hand = self.handling

        def pair(more: tuple[str, ...], less: tuple[str, ...]) -> int:
            return bool(held & set(more)) - bool(held & set(less))

        wish = np.array([pair(("w",), ("s",)), pair(("d",), ("a",)), pair(("up", "i"), ("down", "k"))], float)
        turn = hand.turn * pair(("right", "l"), ("left", "j"))
        wish[:2] /= max(math.hypot(wish[0], wish[1]), 1.0)  # no faster across than along
        if self.kind == VELOCITY:
            full, rate = np.array([hand.speed, hand.speed, hand.climb]), hand.acceleration
        else:
            full, rate = np.array([hand.tilt, hand.tilt, hand.lift]), hand.tilting
        self._asked += np.clip(full * wish - self._asked, -rate * dt, rate * dt)
        self.yaw = (self.yaw + turn * dt + math.pi) % (2.0 * math.pi) - math.pi
        goal = np.zeros(GOAL)
        goal[0], goal[9], goal[14] = self.kind, self.yaw, turn
        forward, right, up = self._asked
        if self.kind == VELOCITY:
            c, s = math.cos(self.yaw), math.sin(self.yaw)
            goal[4:7] = c * forward - s * right, s * forward + c * right, -up
            goal[13] = np.nan
        else:
            # nose down to go forward, right side down to go right; more thrust for the tilt
            goal[7:9] = right, -forward
            goal[13] = self.weight * (1.0 + up) / (math.cos(forward) * math.cos(right))
        return goal


class Pace:
    """How many steps of dt (s) make up for the time that has passed."""

    def __init__(self, dt: float, now: float) -> None:
        self.dt, self._behind, self._last = dt, 0.0, now
        self.share = 1.0  # simulated time per real time, over the last second or so

    def due(self, now: float) -> int:
        """Steps to do now; at most what SLOWEST allows, and what is more is never made up for."""
        passed = max(now - self._last, 0.0)
        self._last = now
        self._behind += passed
        allowed = max(int(SLOWEST / self.dt), 1)
        steps = min(int(self._behind / self.dt + 1e-9), allowed)
        self._behind = self._behind - steps * self.dt if steps < allowed else 0.0
        if passed > 0.0:
            weight = min(passed, 1.0)
            self.share += weight * (min(steps * self.dt / passed, 1.0) - self.share) if steps else 0.0
        return steps


class Flight(Protocol):
    """What `fly` needs of a simulation."""

    dt: float  # s
    t: float  # s
    weight: float  # N

    def state(self) -> np.ndarray:
        """(17,) attitude w x y z, u v w, p q r, x y z, rotor speeds."""

    def advance(self, goal: np.ndarray, steps: int) -> str | None:
        """Go on by so many steps; a sentence when the simulation cannot go on."""

    def restart(self) -> None:
        """Begin again."""


class Keys(Protocol):
    """Where keys come from."""

    def read(self) -> list[str]:
        """Keys pressed since the last call."""


class View(Protocol):
    """Where the flight is seen; its window may report keys too."""

    def is_open(self) -> bool:
        """Whether to go on."""

    def poll(self, held: Held, now: float) -> list[str]:
        """Let the window work; put keys held in it into `held`, return those pressed."""

    def show(self, t: float, state: np.ndarray, said: str) -> None:
        """Draw the drone."""


def fly(
    flight: Flight,
    view: View,
    keys: Keys | None = None,
    handling: Handling | None = None,
    clock: Callable[[], float] = time.perf_counter,
    rest: Callable[[float], None] = time.sleep,
    rate: float = 40.0,
) -> str:
    """Fly until q is pressed or the window closes; returns a sentence on the flight.

    keys  of a terminal, None for the window's own alone; rate  pictures per second at most; clock s; rest  waits s
    """
    held, pilot = Held(), Pilot(flight.weight, _yaw(flight.state()), handling)
    pace, ended = Pace(flight.dt, clock()), None
    farthest = fastest = 0.0
    start = flight.state()[10:13].copy()
    while view.is_open():
        now = clock()
        pressed = keys.read() if keys is not None else []
        held.press(pressed, now)
        pressed += view.poll(held, now)
        if {"q", "escape"} & set(pressed):
            break
        for key in pressed:
            if key == "m":
                pilot.switch()
            elif key == "space":
                held.clear()
                pilot.halt()
            elif key == "r":
                flight.restart()
                held.clear()
                pilot, ended = Pilot(flight.weight, _yaw(flight.state()), handling), None
        steps = pace.due(now)
        if steps and ended is None:
            ended = flight.advance(pilot.goal(held.at(now), steps * flight.dt), steps)
            state = flight.state()
            if ended is None:
                farthest = max(farthest, float(np.linalg.norm(state[10:13] - start)))
                fastest = max(fastest, float(np.linalg.norm(state[4:7])))
        view.show(flight.t, flight.state(), describe_flight(flight.state(), pilot, pace, ended))
        rest(max(1.0 / rate - (clock() - now), 0.0))
    return f"flew {flight.t:.1f} s, up to {farthest:.1f} m away and {fastest:.1f} m/s fast"


def describe_flight(state: np.ndarray, pilot: Pilot, pace: Pace, ended: str | None) -> str:
    """What stands in the view: mode, speed, height, and what is out of the ordinary."""
    if ended is not None:
        return f"{ended}; r starts again"
    mode = "velocity" if pilot.kind == VELOCITY else "attitude"
    text = f"{mode}   {np.linalg.norm(state[4:7]):.1f} m/s   height {-state[12]:.1f} m"
    return text if pace.share > 0.95 else f"{text}   {pace.share:.1f} x real time"


def _yaw(state: np.ndarray) -> float:
    w, x, y, z = state[:4]
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
