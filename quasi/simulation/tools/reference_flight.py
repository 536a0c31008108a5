"""A configured simulation shown live: its own reference is followed, in real time, with pause, restart and end.

Keys: space pauses, r starts again, q ends; closing the window ends as well. At the end of its duration, or where the
simulation cannot go on, the last picture stays until then.
"""

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from quasi.simulation.tools.keyboard import Held
from quasi.simulation.tools.manual_flight import Keys, Pace

HELP = "space pauses, r starts again, q ends"
POSITION_GOAL = 0.0
PATH_POINTS = 2000  # of a reference's path; more cannot be seen


class Followed(Protocol):
    """What `watch` needs of a simulation."""

    dt: float  # s
    t: float  # s
    duration: float  # s

    def state(self) -> np.ndarray:
        """(17,) attitude w x y z, u v w, p q r, x y z, rotor speeds."""

    def setpoint(self) -> np.ndarray:
        """(20,) what the reference asks for now, see `outer_loop`."""

    def advance(self, goal: np.ndarray | None, steps: int) -> str | None:
        """Go on by so many steps; a sentence when the simulation cannot go on."""

    def restart(self) -> None:
        """Begin again."""


class View(Protocol):
    """Where the flight is seen."""

    def is_open(self) -> bool:
        """Whether to go on."""

    def poll(self, held: Held, now: float) -> list[str]:
        """Let the window work; return the keys pressed in it."""

    def show(self, t: float, state: np.ndarray, said: str, target: np.ndarray | None = None) -> None:
        """Draw the drone, and a mark at the target (3,), m, earth NED."""


def watch(
    flight: Followed,
    view: View,
    keys: Keys | None = None,
    clock: Callable[[], float] = time.perf_counter,
    rest: Callable[[float], None] = time.sleep,
    rate: float = 40.0,
) -> str:
    """Show a simulation until q is pressed or the window closes; returns a sentence on what was flown.

    keys  of a terminal, None for the window's own alone; rate  pictures per second at most; clock s; rest  waits s
    """
    pace, held, ended, paused = Pace(flight.dt, clock()), Held(), None, False
    errors: list[float] = []
    while view.is_open():
        now = clock()
        pressed = (keys.read() if keys is not None else []) + view.poll(held, now)
        if {"q", "escape"} & set(pressed):
            break
        for key in pressed:
            if key == "space":
                paused = not paused
            elif key == "r":
                flight.restart()
                ended, paused, errors = None, False, []
        left = round((flight.duration - flight.t) / flight.dt)
        steps = min(pace.due(now), left)
        if steps > 0 and ended is None and not paused:
            ended = flight.advance(None, steps)
        target = _target(flight.setpoint()) if flight.t > 0.0 else None
        error = None if target is None else float(np.linalg.norm(flight.state()[10:13] - target))
        if error is not None and steps > 0 and not paused:
            errors.append(error)
        view.show(flight.t, flight.state(), describe(flight, pace, ended, paused, error), target)
        rest(max(1.0 / rate - (clock() - now), 0.0))
    text = f"flew {flight.t:.1f} s of {flight.duration:.1f} s"
    if errors:
        text += f", position error {np.sqrt(np.mean(np.square(errors))):.2f} m rms, {max(errors):.2f} m at most"
    return f"{text}; {ended}" if ended else text


def _target(setpoint: np.ndarray) -> np.ndarray | None:
    return setpoint[1:4].copy() if setpoint[0] == POSITION_GOAL else None


def describe(flight: Followed, pace: Pace, ended: str | None, paused: bool, error: float | None) -> str:
    """What stands in the view: speed, height, position error, and what is out of the ordinary."""
    if ended is not None:
        return f"{ended}; r starts again"
    state = flight.state()
    text = f"{np.linalg.norm(state[4:7]):.1f} m/s   height {-state[12]:.1f} m"
    if error is not None:
        text += f"   position error {error:.2f} m"
    if flight.t >= flight.duration - 0.5 * flight.dt:
        return f"{text}   end; r starts again"
    if paused:
        return f"{text}   paused"
    return text if pace.share > 0.95 else f"{text}   {pace.share:.1f} x real time"


def path_of(goal_at: Callable[[float, np.ndarray], None], duration: float) -> np.ndarray:
    """Positions (M, 3), m, earth NED, that a reference asks for over its duration, s; (0, 3) where it asks for none."""
    goal, path = np.zeros(20), []
    for t in np.linspace(0.0, duration, PATH_POINTS):
        goal_at(t, goal)
        if goal[0] == POSITION_GOAL:
            path.append(goal[1:4].copy())
    return np.array(path).reshape(-1, 3)
