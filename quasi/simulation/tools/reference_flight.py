"""Live view of a configured simulation that follows its reference in real time, with pause, restart and end.

Keys: space pauses, r restarts, q ends; closing the window ends as well. At the end of its duration, or where the
simulation ends early, the last picture stays visible.
"""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from quasi.simulation.control.outer_loop import POSITION_SETPOINT
from quasi.simulation.loop.run import Session
from quasi.simulation.tools.keyboard import HeldKeys, Terminal
from quasi.simulation.tools.manual_flight import MAX_PICTURE_RATE, Pace

if TYPE_CHECKING:
    from quasi.simulation.tools.window import Window

REFERENCE_HELP = "space pauses, r starts again, q ends"
MAX_REFERENCE_POINTS = 2000  # of a reference's path; more are not visible


def show_reference_flight(
    flight: Session,
    view: "Window",
    keys: Terminal | None = None,
    clock: Callable[[], float] = time.perf_counter,
    wait: Callable[[float], None] = time.sleep,
) -> str:
    """Show a simulation until q is pressed or the window closes; return a sentence about the flight.

    keys  of a terminal, None for those of the window only; clock s; wait  waits s
    """
    pace, held_keys, ended, paused = Pace(flight.dt, clock()), HeldKeys(), None, False
    errors: list[float] = []
    while view.is_open():
        now = clock()
        pressed = (keys.read() if keys is not None else []) + view.poll(held_keys, now)
        if {"q", "escape"} & set(pressed):
            break
        for key in pressed:
            if key == "space":
                paused = not paused
            elif key == "r":
                flight.restart()
                ended, paused, errors = None, False, []
        left = round((flight.duration - flight.t) / flight.dt)
        steps = min(pace.count_due_steps(now), left)
        if steps > 0 and ended is None and not paused:
            ended = flight.advance(None, steps)
        setpoint, target = flight.setpoint(), None
        if flight.t > 0.0 and setpoint[0] == POSITION_SETPOINT:
            target = setpoint[1:4]
        error = None if target is None else float(np.linalg.norm(flight.state()[10:13] - target))
        if error is not None and steps > 0 and not paused:
            errors.append(error)
        view.show(flight.t, flight.state(), describe_flight(flight, pace, ended, paused, error), target)
        wait(max(1.0 / MAX_PICTURE_RATE - (clock() - now), 0.0))
    text = f"flew {flight.t:.1f} s of {flight.duration:.1f} s"
    if errors:
        text += f", position error {np.sqrt(np.mean(np.square(errors))):.2f} m rms, {max(errors):.2f} m at most"
    return f"{text}; {ended}" if ended else text


def describe_flight(flight: Session, pace: Pace, ended: str | None, paused: bool, error: float | None) -> str:
    """Describe the flight for the view: speed, height, position error, and exceptions."""
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
    return text if pace.speed_ratio > 0.95 else f"{text}   {pace.speed_ratio:.1f} x real time"


def sample_path(evaluate_setpoint: Callable[[float, np.ndarray], None], duration: float) -> np.ndarray:
    """Sample the positions (M, 3), m, earth NED, of a reference over its duration, s; (0, 3) without any."""
    setpoint, path = np.zeros(20), []
    for t in np.linspace(0.0, duration, MAX_REFERENCE_POINTS):
        evaluate_setpoint(t, setpoint)
        if setpoint[0] == POSITION_SETPOINT:
            path.append(setpoint[1:4].copy())
    return np.array(path).reshape(-1, 3)
