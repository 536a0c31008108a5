"""The window in which a flight is seen: a box of air around the drone, moved on when the drone comes near its edge."""

import math
import os
import sys
import time
from collections import deque
from collections.abc import Callable

import matplotlib
import numpy as np

from quasi.airframe import Airframe
from quasi.errors import ConfigError
from quasi.pages.animation import Scene
from quasi.pages.drawing import Motion
from quasi.pages.drone import Look, caption, new_axes, path_line, set_limits
from quasi.simulation.loop.simulator import Bus
from quasi.simulation.tools.keyboard import Held

HALF = 2.5  # m, of the box
LARGEST = 50.0  # m, half side of a box: in a larger one the drone cannot be seen
EDGE = 0.7  # of it: the drone's way from the middle before the box moves on
WINDOW_REPEAT = 1.0  # s, within which a desktop repeats a key that is down; a window out of focus sees no release
TRAIL = 250  # points of the path that are kept
_TOOLKITS = ("qtagg", "tkagg", "gtk4agg", "gtk3agg", "wxagg", "macosx")


class Window:
    """A live view; see `quasi.simulation.tools.manual_flight.View`. scale  by which the drone is enlarged.

    path  (M, 3) m, earth NED, of a reference, drawn dashed; the box then holds all of it, up to LARGEST m
    Raises ConfigError where no window can be opened.
    """

    def __init__(
        self, airframe: Airframe, name: str, help_text: str = "", scale: float = 3.0, path: np.ndarray | None = None
    ) -> None:
        self._pyplot = _pyplot()
        self._airframe = airframe
        self._events: deque[tuple[str, str]] = deque()
        with matplotlib.rc_context({"toolbar": "None"}):
            self._figure = self._pyplot.figure(f"quasi fly {name}", figsize=(8, 6.4))
        canvas = self._figure.canvas
        # keys fly the drone here; matplotlib's own meanings of them (s saves, q closes) would get in the way
        canvas.mpl_disconnect(canvas.manager.key_press_handler_id)
        self._closed = False
        canvas.mpl_connect("close_event", self._close)
        canvas.mpl_connect("key_press_event", lambda event: self._events.append(("press", _name(event.key))))
        canvas.mpl_connect("key_release_event", lambda event: self._events.append(("release", _name(event.key))))
        axes = new_axes(self._figure)
        self._path = np.zeros((0, 3)) if path is None else np.asarray(path, float)
        self._middle, self._half = _box_of(self._path)
        scale *= self._half / HALF
        caption(axes, f"{name}\n{help_text}" if help_text else name, scale)
        set_limits(axes, self._middle - self._half, self._middle + self._half)
        self._scene = Scene(axes, [(airframe, Look())], scale)
        nowhere = np.full((1, 3), np.nan)
        self._reference = path_line(axes, nowhere, "0.5", 0.8, linestyle="--")
        self._target = path_line(axes, nowhere, "k", marker="x")
        for line in (self._reference, self._target):
            line.set_animated(True)
        self._trail: deque[np.ndarray] = deque(maxlen=TRAIL)
        self._figure.show()

    def is_open(self) -> bool:
        """Whether the window has not been closed."""
        return not self._closed and self._pyplot.fignum_exists(self._figure.number)

    def _close(self, event: object) -> None:
        self._closed = True

    def poll(self, held: Held, now: float) -> list[str]:
        """Let the window work; keys held in it go into `held`, those pressed are returned."""
        self._figure.canvas.flush_events()
        pressed = []
        while self._events:
            kind, key = self._events.popleft()
            if kind == "press":
                held.press([key], now, WINDOW_REPEAT)
                pressed.append(key)
            else:
                held.release(key, now)
        return pressed

    def show(self, t: float, state: np.ndarray, said: str, target: np.ndarray | None = None) -> None:
        """Draw the drone in this state (17,), and a cross at the target (3,); said  stands in the corner."""
        where = state[10:13]
        if not np.isfinite(state).all() or not self.is_open():
            return
        half = self._half
        if np.abs(where - self._middle).max() > (EDGE if not len(self._path) else 1.0) * half:
            self._middle = where.copy()
            self._scene.limits(where - half, where + half)
        self._trail.append(where.copy())
        trail = np.array(self._trail)
        trail = trail[self._inside(trail)]
        self._reference.set_data_3d(*np.where(self._inside(self._path)[:, None], self._path, np.nan).T)
        mark = np.full((1, 3), np.nan) if target is None else target[None]
        self._target.set_data_3d(*np.where(self._inside(mark)[:, None], mark, np.nan).T)
        motion = Motion(self._airframe, [t], where[None], state[None, :4], state[None, 13:17])
        self._scene.place(0, where, state[:4], motion.opacity(np.array([0]))[0], trail)
        self._scene.clock.set_text(f"{said}   {t:.1f} s".lstrip())
        self._scene.draw([self._reference, self._target])
        self._figure.canvas.blit(self._figure.bbox)

    def _inside(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (M, 3) lie in the box."""
        return (np.abs(points - self._middle) <= self._half).all(axis=1)

    def picture(self) -> np.ndarray:
        """What the window shows: (height, width, 3) bytes."""
        return self._scene.picture()

    def close(self) -> None:
        """Close the window."""
        self._pyplot.close(self._figure)


class Animator:
    """A step that shows a quadrotor while it is simulated in Python, in real time; closing the window ends it.

        animator = Animator(Window(setup.airframe, setup.name))
        simulator.add_step("integrator", animator)

    window  where it is shown; rate  pictures per second at most; speed  times real time, None as fast as it goes;
    clock s; rest  waits s
    """

    def __init__(
        self,
        window: Window,
        rate: float = 25.0,
        speed: float | None = 1.0,
        clock: Callable[[], float] = time.perf_counter,
        rest: Callable[[float], None] = time.sleep,
    ) -> None:
        self.window, self.rate, self.speed = window, rate, speed
        self._clock, self._rest = clock, rest
        self._began: float | None = None
        self._shown = -math.inf

    def __call__(self, bus: Bus) -> None:
        """Show the state at the end of the step, unless a picture was shown a moment ago."""
        t, now = float(bus.time[bus.step + 1]), self._clock()
        if self._began is None:
            self._began = now - (t / self.speed if self.speed else 0.0)
        if self.speed:
            ahead = self._began + t / self.speed - now
            if ahead > 0.0:
                self._rest(ahead)
                now += ahead
            elif ahead < -0.2:
                self._began -= ahead  # too slow for real time: what is lost is not made up for
        if now - self._shown >= 1.0 / self.rate:
            self._shown = now
            self.window.poll(Held(), now)
            self.window.show(t, bus.state[bus.step + 1], "")

    def going(self, bus: Bus) -> bool:
        """Whether the window is still open."""
        return self.window.is_open()


def _box_of(path: np.ndarray) -> tuple[np.ndarray, float]:
    """Middle (3,) and half side, m, of a box that holds a path (M, 3) with a metre around it."""
    if not len(path):
        return np.zeros(3), HALF
    low, high = path.min(axis=0), path.max(axis=0)
    return 0.5 * (low + high), float(np.clip(0.5 * (high - low).max() + 1.0, HALF, LARGEST))


def _name(key: str | None) -> str:
    return {" ": "space", None: ""}.get(key, key.lower() if key else "")


def _pyplot():
    """matplotlib's pyplot on a toolkit that can open windows, or a sentence."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ConfigError(
            "no window can be opened: there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set); run it in a "
            "desktop session, or simulate with a configuration and look at the animation"
        )
    from matplotlib import pyplot

    chosen = os.environ.get("MPLBACKEND", "").lower()
    wanted = [chosen] if chosen in _TOOLKITS else list(_TOOLKITS)
    for toolkit in wanted:
        try:
            pyplot.switch_backend(toolkit)
            pyplot.close(pyplot.figure())  # some toolkits only now find that there is no display to be had
            return pyplot
        except Exception:
            continue  # each toolkit fails in its own way; the next may do
    raise ConfigError(
        f"no window can be opened: matplotlib finds none of {', '.join(wanted)} at work; install tkinter (python3-tk) "
        "or `pip install PyQt6`, and check the display"
    )
