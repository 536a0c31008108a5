"""Manual flight of a simulated drone: keys to setpoints, the simulation in real time, and a live view.

w s a d: forward, backward, left, right relative to the heading; up down (or i k): height; left right (or j l): heading;
m: velocity or attitude setpoint; space: stop; r: restart; q: end. Closing the window ends the flight as well.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quasi.attitude import to_euler
from quasi.simulation.control.outer_loop import ATTITUDE_SETPOINT, SETPOINT_SIZE, VELOCITY_SETPOINT
from quasi.simulation.loop.run import Session
from quasi.simulation.tools.keyboard import HeldKeys, Terminal

if TYPE_CHECKING:
    from quasi.simulation.tools.window import Window

MAX_SIMULATED_TIME = (
    0.1  # s of simulation between two pictures at most; a slow computer then simulates slower than real time
)
MAX_PICTURE_RATE = 40.0  # per second
MANUAL_HELP = "w a s d fly, arrows height and heading, m mode, space halt, r again, q end"


@dataclass(frozen=True)
class Handling:
    """Setpoints of a held key: speed m/s, climb m/s, turn rad/s; tilt rad and lift (share of the weight) for attitude.

    acceleration m/s2 and tilting rad/s limit how fast the setpoint changes.
    """

    speed: float = 3.0
    climb: float = 1.5
    turn: float = 1.6
    tilt: float = math.radians(20.0)
    lift: float = 0.2
    acceleration: float = 6.0
    tilting: float = math.radians(120.0)


class Pilot:
    """Converts held keys to setpoints. weight N; yaw rad, the initial heading."""

    def __init__(self, weight: float, yaw: float = 0.0) -> None:
        self.weight, self.yaw = weight, yaw
        self.handling = Handling()
        self.kind = VELOCITY_SETPOINT
        self._commanded = np.zeros(3)  # forward, right, up: m/s, or rad and a share with an attitude reference

    def switch(self) -> None:
        """Switch between velocity and attitude setpoints."""
        self.kind = ATTITUDE_SETPOINT if self.kind == VELOCITY_SETPOINT else VELOCITY_SETPOINT
        self._commanded[:] = 0.0

    def halt(self) -> None:
        """Stop at once: zero velocity, or level attitude."""
        self._commanded[:] = 0.0

    def setpoint(self, held_keys: set[str], dt: float) -> np.ndarray:
        """Return the setpoint (20,) after dt s with keys: kind; velocity (earth) or angles; yaw, yaw rate; thrust."""

        def difference(more: tuple[str, ...], less: tuple[str, ...]) -> int:
            return bool(held_keys & set(more)) - bool(held_keys & set(less))

        wanted = np.array(
            [difference(("w",), ("s",)), difference(("d",), ("a",)), difference(("up", "i"), ("down", "k"))], float
        )
        turn = self.handling.turn * difference(("right", "l"), ("left", "j"))
        wanted[:2] /= max(math.hypot(wanted[0], wanted[1]), 1.0)  # a diagonal is not faster
        limits = self.handling
        if self.kind == VELOCITY_SETPOINT:
            full, rate = np.array([limits.speed, limits.speed, limits.climb]), limits.acceleration
        else:
            full, rate = np.array([limits.tilt, limits.tilt, limits.lift]), limits.tilting
        self._commanded += np.clip(full * wanted - self._commanded, -rate * dt, rate * dt)
        self.yaw = (self.yaw + turn * dt + math.pi) % (2.0 * math.pi) - math.pi
        setpoint = np.zeros(SETPOINT_SIZE)
        setpoint[0], setpoint[9], setpoint[14] = self.kind, self.yaw, turn
        forward, right, up = self._commanded
        if self.kind == VELOCITY_SETPOINT:
            c, s = math.cos(self.yaw), math.sin(self.yaw)
            setpoint[4:7] = c * forward - s * right, s * forward + c * right, -up
            setpoint[13] = np.nan
        else:
            # nose down to go forward, right side down to go right; more thrust for the tilt
            setpoint[7:9] = right, -forward
            setpoint[13] = self.weight * (1.0 + up) / (math.cos(forward) * math.cos(right))
        return setpoint


class Pace:
    """Counts the simulation steps of dt (s) that are due in real time."""

    def __init__(self, dt: float, now: float) -> None:
        self.dt, self._behind, self._last = dt, 0.0, now
        self.speed_ratio = 1.0  # simulated time per real time, over the last second or so

    def count_due_steps(self, now: float) -> int:
        """Count the steps due now, at most MAX_SIMULATED_TIME; further delay is dropped."""
        passed = max(now - self._last, 0.0)
        self._last = now
        self._behind += passed
        allowed = max(int(MAX_SIMULATED_TIME / self.dt), 1)
        steps = min(int(self._behind / self.dt + 1e-9), allowed)
        self._behind = self._behind - steps * self.dt if steps < allowed else 0.0
        if passed > 0.0:
            weight = min(passed, 1.0)
            self.speed_ratio += weight * (min(steps * self.dt / passed, 1.0) - self.speed_ratio) if steps else 0.0
        return steps


def fly_manually(
    flight: Session,
    view: "Window",
    keys: Terminal | None = None,
    clock: Callable[[], float] = time.perf_counter,
    wait: Callable[[float], None] = time.sleep,
) -> str:
    """Fly until q is pressed or the window closes; return a sentence about the flight.

    keys  of a terminal, None for those of the window only; clock s; wait  waits s
    """
    held_keys, pilot = HeldKeys(), Pilot(flight.weight, to_euler(flight.state()[:4])[2])
    pace, ended = Pace(flight.dt, clock()), None
    farthest = fastest = 0.0
    start = flight.state()[10:13].copy()
    while view.is_open():
        now = clock()
        pressed = keys.read() if keys is not None else []
        held_keys.press(pressed, now)
        pressed += view.poll(held_keys, now)
        if {"q", "escape"} & set(pressed):
            break
        for key in pressed:
            if key == "m":
                pilot.switch()
            elif key == "space":
                held_keys.clear()
                pilot.halt()
            elif key == "r":
                flight.restart()
                held_keys.clear()
                pilot, ended = Pilot(flight.weight, to_euler(flight.state()[:4])[2]), None
        steps = pace.count_due_steps(now)
        if steps and ended is None:
            ended = flight.advance(pilot.setpoint(held_keys.list_held_keys(now), steps * flight.dt), steps)
            state = flight.state()
            if ended is None:
                farthest = max(farthest, float(np.linalg.norm(state[10:13] - start)))
                fastest = max(fastest, float(np.linalg.norm(state[4:7])))
        view.show(flight.t, flight.state(), describe_flight(flight.state(), pilot, pace, ended))
        wait(max(1.0 / MAX_PICTURE_RATE - (clock() - now), 0.0))
    return f"flew {flight.t:.1f} s, up to {farthest:.1f} m away and {fastest:.1f} m/s fast"


def describe_flight(state: np.ndarray, pilot: Pilot, pace: Pace, ended: str | None) -> str:
    """Describe the flight for the view: mode, speed, height, and exceptions."""
    if ended is not None:
        return f"{ended}; r starts again"
    mode = "velocity" if pilot.kind == VELOCITY_SETPOINT else "attitude"
    text = f"{mode}   {np.linalg.norm(state[4:7]):.1f} m/s   height {-state[12]:.1f} m"
    return text if pace.speed_ratio > 0.95 else f"{text}   {pace.speed_ratio:.1f} x real time"
