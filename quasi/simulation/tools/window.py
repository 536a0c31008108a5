"""Window for live flights: a box of air around the drone that moves when the drone comes near its edge."""

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
from quasi.pages.drone import Look, draw_path_line, make_axes, set_limits, write_caption
from quasi.simulation.loop.simulator import Bus
from quasi.simulation.tools.keyboard import HeldKeys

BOX_HALF_SIDE = 2.5  # m, of the box
MAX_BOX_HALF_SIDE = 50.0  # m; in a larger box the drone is not visible
BOX_EDGE_SHARE = 0.7  # share of the half side at which the box moves
WINDOW_REPEAT_DELAY = 1.0  # s until a desktop repeats a held key at the latest; a window out of focus gets no release
MAX_TRAIL_POINTS = 250  # points of the drawn path
_TOOLKITS = ("qtagg", "tkagg", "gtk4agg", "gtk3agg", "wxagg", "macosx")


class Window:
    """A live view. scale  enlargement of the drone.

    path  (M, 3) m, earth NED, of a reference, drawn dashed; the box contains it up to MAX_BOX_HALF_SIDE m
    Raises ConfigError where no window can be opened.
    """

    def __init__(
        self, airframe: Airframe, name: str, help_text: str = "", scale: float = 3.0, path: np.ndarray | None = None
    ) -> None:
        self._open_pyplot = _open_pyplot()
        self._airframe = airframe
        self._events: deque[tuple[str, str]] = deque()
        with matplotlib.rc_context({"toolbar": "None"}):
            self._figure = self._open_pyplot.figure(f"quasi fly {name}", figsize=(8, 6.4))
        canvas = self._figure.canvas
        # keys fly the drone; disable matplotlib's own key bindings (s saves, q closes)
        canvas.mpl_disconnect(canvas.manager.key_press_handler_id)
        self._closed = False
        canvas.mpl_connect("close_event", self._close)
        canvas.mpl_connect("key_press_event", lambda event: self._events.append(("press", _name_key(event.key))))
        canvas.mpl_connect("key_release_event", lambda event: self._events.append(("release", _name_key(event.key))))
        axes = make_axes(self._figure)
        self._path = np.zeros((0, 3)) if path is None else np.asarray(path, float)
        self._middle, self._half = _find_box(self._path)
        scale *= self._half / BOX_HALF_SIDE
        write_caption(axes, f"{name}\n{help_text}" if help_text else name, scale)
        set_limits(axes, self._middle - self._half, self._middle + self._half)
        self._scene = Scene(axes, [(airframe, Look())], scale)
        nowhere = np.full((1, 3), np.nan)
        self._reference = draw_path_line(axes, nowhere, "0.5", 0.8, linestyle="--")
        self._target = draw_path_line(axes, nowhere, "k", marker="x")
        for line in (self._reference, self._target):
            line.set_animated(True)
        self._trail: deque[np.ndarray] = deque(maxlen=MAX_TRAIL_POINTS)
        self._figure.show()

    def is_open(self) -> bool:
        """Whether the window is still open."""
        return not self._closed and self._open_pyplot.fignum_exists(self._figure.number)

    def _close(self, event: object) -> None:
        self._closed = True

    def poll(self, held_keys: HeldKeys, now: float) -> list[str]:
        """Process window events: register held keys in `held_keys`, return pressed keys."""
        self._figure.canvas.flush_events()
        pressed = []
        while self._events:
            kind, key = self._events.popleft()
            if kind == "press":
                held_keys.press([key], now, WINDOW_REPEAT_DELAY)
                pressed.append(key)
            else:
                held_keys.release(key, now)
        return pressed

    def show(self, t: float, state: np.ndarray, text: str, target: np.ndarray | None = None) -> None:
        """Draw the drone in this state (17,) and a cross at the target (3,); text  for the corner."""
        where = state[10:13]
        if not np.isfinite(state).all() or not self.is_open():
            return
        half = self._half
        if np.abs(where - self._middle).max() > (BOX_EDGE_SHARE if not len(self._path) else 1.0) * half:
            self._middle = where.copy()
            self._scene.limits(where - half, where + half)
        self._trail.append(where.copy())
        trail = np.array(self._trail)
        trail = trail[self._find_inside(trail)]
        self._reference.set_data_3d(*np.where(self._find_inside(self._path)[:, None], self._path, np.nan).T)
        mark = np.full((1, 3), np.nan) if target is None else target[None]
        self._target.set_data_3d(*np.where(self._find_inside(mark)[:, None], mark, np.nan).T)
        motion = Motion(self._airframe, [t], where[None], state[None, :4], state[None, 13:17])
        self._scene.place(0, where, state[:4], motion.opacity(np.array([0]))[0], trail)
        self._scene.clock.set_text(f"{text}   {t:.1f} s".lstrip())
        self._scene.draw([self._reference, self._target])
        self._figure.canvas.blit(self._figure.bbox)

    def _find_inside(self, points: np.ndarray) -> np.ndarray:
        """Find which points (M, 3) lie in the box."""
        return (np.abs(points - self._middle) <= self._half).all(axis=1)

    def picture(self) -> np.ndarray:
        """The content of the window: (height, width, 3) bytes."""
        return self._scene.picture()

    def close(self) -> None:
        """Close the window."""
        self._open_pyplot.close(self._figure)


class Animator:
    """A step that shows a quadrotor during a Python simulation in real time; closing the window ends it.

        animator = Animator(Window(setup.airframe, setup.name))
        simulator.add_step("integrator", animator)

    window  for the view; rate  maximum pictures per second; speed  times real time, None for no limit;
    clock s; rest  waits s
    """

    def __init__(
        self,
        window: Window,
        rate: float = 25.0,
        speed: float | None = 1.0,
        clock: Callable[[], float] = time.perf_counter,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self.window, self.rate, self.speed = window, rate, speed
        self._clock, self._wait = clock, wait
        self._began: float | None = None
        self._shown = -math.inf

    def __call__(self, bus: Bus) -> None:
        """Show the state at the end of the step, at most at the picture rate."""
        t, now = float(bus.time[bus.step + 1]), self._clock()
        if self._began is None:
            self._began = now - (t / self.speed if self.speed else 0.0)
        if self.speed:
            ahead = self._began + t / self.speed - now
            if ahead > 0.0:
                self._wait(ahead)
                now += ahead
            elif ahead < -0.2:
                self._began -= ahead  # too slow for real time: drop the delay
        if now - self._shown >= 1.0 / self.rate:
            self._shown = now
            self.window.poll(HeldKeys(), now)
            self.window.show(t, bus.state[bus.step + 1], "")

    def is_open(self, bus: Bus) -> bool:
        """Whether the window is still open."""
        return self.window.is_open()


def _find_box(path: np.ndarray) -> tuple[np.ndarray, float]:
    """Find middle (3,) and half side, m, of a box around a path (M, 3) with a margin of 1 m."""
    if not len(path):
        return np.zeros(3), BOX_HALF_SIDE
    low, high = path.min(axis=0), path.max(axis=0)
    return 0.5 * (low + high), float(np.clip(0.5 * (high - low).max() + 1.0, BOX_HALF_SIDE, MAX_BOX_HALF_SIDE))


def _name_key(key: str | None) -> str:
    return {" ": "space", None: ""}.get(key, key.lower() if key else "")


def _open_pyplot():
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
            pyplot.close(pyplot.figure())  # some toolkits detect a missing display only now
            return pyplot
        except Exception:
            continue  # toolkits raise different errors; try the next one
    raise ConfigError(
        f"no window can be opened: none of matplotlib's toolkits {', '.join(wanted)} works; install tkinter "
        "(python3-tk) or `pip install PyQt6`, and check the display"
    )
