"""Moving pictures of drones: a scene that is redrawn fast, and animations to a file or into a figure of the user's.

Only what moves is drawn anew; axes, grid and labels are kept as a picture until the limits or the view change.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from PIL import GifImagePlugin, Image

from quasi.airframe import Airframe
from quasi.attitude import interpolate
from quasi.errors import ConfigError, DataError
from quasi.pages import drawing
from quasi.pages.drawing import Motion
from quasi.pages.drone import Drone, Look, draw_path_line, get_limits, make_axes, make_shape, set_limits, write_caption
from quasi.tables import replace_file, write_bytes

Limits = tuple[np.ndarray, np.ndarray]
Wrapper = Callable[[float, Axes3D], Iterable[Artist] | None]
MAX_FRAMES = 20_000  # more frames are a mistaken setting
ANIMATION_SUFFIXES = (".mp4", ".gif")


class Scene:
    """Drones with their trails in 3-D axes, redrawn many times.

    axes    of `drone.make_axes`, with their limits set; the canvas of their figure must be an Agg one
    drones  airframe and look of each; scale  by which they are enlarged
    """

    def __init__(self, axes: Axes3D, drones: Sequence[tuple[Airframe, Look]], scale: float = 1.0) -> None:
        self.axes = axes
        self.canvas = axes.figure.canvas
        self.drones = [Drone(axes, make_shape(airframe, scale), look) for airframe, look in drones]
        nowhere = np.full((1, 3), np.nan)
        self._trails = [draw_path_line(axes, nowhere, look.history) for _, look in drones]
        self._shadows = [draw_path_line(axes, nowhere, "0.8", 0.9) for _ in drones]
        self.clock = axes.text2D(0.98, 0.98, "", transform=axes.transAxes, fontsize=9, ha="right", va="top")
        self._moving: list[Artist] = [*self._shadows, *self._trails, self.clock]
        for artist in (*self._moving, *(a for d in self.drones for a in d.artists)):
            artist.set_animated(True)
        self._background = None
        self.canvas.mpl_connect("draw_event", self._keep)

    def _keep(self, event: object) -> None:
        self._background = self.canvas.copy_from_bbox(self.axes.figure.bbox)

    def place(
        self, number: int, position: np.ndarray, quaternion: np.ndarray, opacity: np.ndarray, trail: np.ndarray
    ) -> None:
        """Move a drone to position (3,) m, quaternion (4,), opacity (4,) of the discs, with its trail (M, 3)."""
        self.drones[number].pose(position, quaternion, opacity)
        self._trails[number].set_data_3d(*trail.T)
        floor = get_limits(self.axes)[1][2]
        self._shadows[number].set_data_3d(trail[:, 0], trail[:, 1], np.where(np.isnan(trail[:, 2]), np.nan, floor))

    def limits(self, low: np.ndarray, high: np.ndarray) -> None:
        """Set the visible box, m, NED."""
        set_limits(self.axes, low, high)
        self._background = None

    def draw(self, more: Iterable[Artist] = (), anew: bool = False) -> None:
        """Draw the picture; more  further artists that moved; anew  redraws axes and grid as well."""
        more = list(more)
        fresh = [a for a in more if not a.get_animated()]
        for artist in fresh:
            artist.set_animated(True)
        # matplotlib fills faces up to the longest one's length with what memory holds
        with np.errstate(all="ignore"):
            if self._background is None or anew or fresh:
                self.canvas.draw()
            # the farther drone first, as matplotlib itself sorts
            depth = [(max(a.do_3d_projection() for a in d.artists), k) for k, d in enumerate(self.drones)]
        self.canvas.restore_region(self._background)
        for artist in self._moving:
            self.axes.draw_artist(artist)
        for _, k in sorted(depth, reverse=True):
            for artist in self.drones[k].artists:
                self.axes.draw_artist(artist)
        for artist in more:
            if hasattr(artist, "do_3d_projection"):
                artist.do_3d_projection()
            artist.axes.draw_artist(artist)

    def rest(self) -> None:
        """Turn the animated artists into ordinary parts of the figure."""
        for artist in (*self._moving, *(a for d in self.drones for a in d.artists)):
            artist.set_animated(False)

    def picture(self) -> np.ndarray:
        """The last picture: (height, width, 3) bytes."""
        return np.asarray(self.canvas.buffer_rgba())[..., :3].copy()


def follow_drone(motion: Motion, half: float = 1.0) -> Callable[[float], Limits]:
    """Limits that keep one drone in the middle of a cube of 2 x half, m; for `animate`. Every frame is redrawn."""

    def box(time: float) -> Limits:
        where = motion.position[motion.row_at(time)]
        return where - half, where + half

    return box


def list_frame_times(motions: Sequence[Motion], fps: float, speed_up: float) -> np.ndarray:
    """List the times, s, of the frames of an animation, from the first to the last drawable one."""
    _check_rates(fps, speed_up)
    first = min(float(m.t[m.drawable][0]) for m in motions)
    last = max(float(m.t[m.drawable][-1]) for m in motions)
    count = math.floor((last - first) * fps / speed_up + 1e-9) + 1
    if count > MAX_FRAMES:
        raise ConfigError(
            f"animation: {last - first:.0f} s at {fps:g} frames/s and speed {speed_up:g} are {count} frames, more than "
            f"{MAX_FRAMES}; speed it up or show a part"
        )
    return first + np.arange(count) * speed_up / fps


def render_frames(
    motions: Sequence[Motion],
    fps: float = 25.0,
    speed_up: float = 1.0,
    axes: Axes3D | None = None,
    figure: Figure | None = None,
    wrapper: Wrapper | None = None,
    limits: Limits | Callable[[float], Limits] | None = None,
    trail: float = math.inf,
    scale: float | None = None,
    title: str = "",
) -> Iterator[np.ndarray]:
    """Render the pictures (height, width, 3) of an animation in sequence.

    axes      3-D axes in a figure of the user's; figure  draws in its last axes; neither: a figure of its own
    wrapper   called for each frame with the time, s, and the axes, after the drones were moved: it may draw more, in
              other axes of the figure too; it returns what it moved, or None to have the whole figure drawn anew
    limits    low (3,), high (3,), m, NED; or a function of the time, s, that gives them (`follow_drone` makes one)
    trail     s of the path behind each drone; scale  by which drones are enlarged, None: so that they can be seen
    """
    if not motions:
        raise DataError("there is no motion to animate; give at least one")
    motions = drawing.assign_colours(motions)
    times = list_frame_times(motions, fps, speed_up)
    axes = _check_axes(axes, figure)
    moving_box = limits if callable(limits) else None
    low, high = moving_box(times[0]) if moving_box else limits or drawing.find_extent(motions)
    if scale is None:
        scale = 1.0 if moving_box else drawing.choose_enlargement(motions)
    if limits is None:
        room = 0.5 * max(make_shape(m.airframe, scale).span for m in motions)
        low, high = low - room, high + room
    set_limits(axes, low, high)
    shown_on = axes.figure.canvas
    FigureCanvasAgg(axes.figure)
    text = f"{title}{', ' if title else ''}speed x {speed_up:g}" if speed_up != 1 else title
    write_caption(axes, text, scale)
    scene = Scene(axes, [(m.airframe, m.look) for m in motions], scale)
    courses = [_Course(m, times, trail) for m in motions]
    try:
        for k, time in enumerate(times):
            if moving_box:
                scene.limits(*moving_box(float(time)))
            for number, course in enumerate(courses):
                scene.drones[number].set_look(motions[number].choose_look(float(time)))
                scene.place(number, *course.at(k))
            scene.clock.set_text(f"{time:.2f} s")
            more = wrapper(float(time), axes) if wrapper else ()
            # a wrapper that returns no artists may have moved any
            scene.draw(more or (), anew=more is None)
            yield scene.picture()
    finally:
        scene.rest()
        axes.figure.set_canvas(shown_on)


def animate(
    motions: Sequence[Motion], path: str | Path, fps: float = 25.0, speed_up: float = 1.0, **options: Any
) -> int:
    """Write an animation of one or several drones to a file; returns the number of frames.

    path      .mp4 (needs the extra "animation") or .gif; speed_up  2 shows twice as fast
    fps       frames per second; a GIF takes the nearest whose frames last whole hundredths of a second
    options   axes, figure, wrapper, limits, trail, scale, title of `render_frames`
    Raises DataError, ConfigError for what cannot be made.
    """
    path = Path(path)
    if path.suffix.lower() not in ANIMATION_SUFFIXES:
        raise ConfigError(f"animation {path}: '{path.suffix}' is not an animation format; use .mp4 or .gif")
    _check_rates(fps, speed_up)
    gif = path.suffix.lower() == ".gif"
    if gif:
        fps = 100.0 / compute_gif_delay(fps)  # so that the speed stays true
    pictures = render_frames(motions, fps, speed_up, **options)
    return write_gif(path, pictures, fps) if gif else write_mp4(path, pictures, fps)


def can_write_mp4() -> bool:
    """Whether the extra "animation" is installed."""
    try:
        import imageio_ffmpeg

        return bool(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        return False


def write_mp4(path: Path, pictures: Iterable[np.ndarray], fps: float) -> int:
    """Write pictures (height, width, 3) as H.264; returns their number. Raises ConfigError without the extra."""
    if not can_write_mp4():
        raise ConfigError(
            f"animation {path}: no encoder for mp4 is installed; `pip install 'quasi[animation]'`, or name it .gif"
        )
    import imageio_ffmpeg

    count = 0
    form = ["-f", "mp4", "-movflags", "+faststart"]
    with replace_file(path) as part:
        writer = None
        try:
            for picture in pictures:
                # the colour format wants even sides
                picture = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
                if writer is None:
                    size = picture.shape[1::-1]
                    more = {"codec": "libx264", "macro_block_size": 2, "output_params": form}
                    writer = imageio_ffmpeg.write_frames(str(part), size, fps=fps, quality=6, **more)
                    writer.send(None)
                writer.send(np.ascontiguousarray(picture))
                count += 1
        finally:
            if writer is not None:
                writer.close()
    return count


def write_gif(path: Path, pictures: Iterable[np.ndarray], fps: float) -> int:
    """Write pictures (height, width, 3) as an endless GIF; returns their number.

    Each frame holds only the rectangle that changed, and no more than two pictures are kept in memory at a time.
    """
    palette, hundredths = _make_palette(), compute_gif_delay(fps)
    parts: list[bytes] = []
    before, count = np.zeros((0, 0), np.uint8), 0
    for picture in pictures:
        image = Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
        now = np.asarray(image)
        box = (0, 0, *image.size)
        if not count:
            parts += GifImagePlugin.getheader(image, info={"loop": 0})[0]
        elif (changed := now != before).any():
            rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
            box = (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
        else:
            box = (0, 0, 1, 1)
        parts += GifImagePlugin.getdata(image.crop(box), box[:2], duration=10 * hundredths)
        before, count = now, count + 1
    write_bytes(path, b"".join([*parts, b";"]))
    return count


def compute_gif_delay(fps: float) -> int:
    """Compute the duration of a GIF frame: whole hundredths of a second, at least the minimum of players."""
    return max(round(100.0 / fps), 2)


def _make_palette() -> Image.Image:
    """Make a palette of greys, the most frequent colours, and evenly spaced other colours for wrappers."""
    greys = np.repeat(np.linspace(0, 255, 40), 3).reshape(-1, 3)
    cube = np.stack(np.meshgrid(*3 * [np.linspace(0, 255, 6)]), axis=-1).reshape(-1, 3)
    image = Image.new("P", (1, 1))
    image.putpalette(np.vstack([greys, cube]).round().astype(np.uint8).tobytes())
    return image


class _Course:
    """A motion at the times of the frames."""

    def __init__(self, motion: Motion, times: np.ndarray, trail: float) -> None:
        drawable = motion.drawable
        t = motion.t[drawable]
        self.motion, self.times, self.trail = motion, times, trail
        self.quaternion = interpolate(motion.quaternion[drawable], t, times)
        self.position = np.stack([np.interp(times, t, column) for column in motion.position[drawable].T], axis=1)
        rows = np.flatnonzero(drawable)
        self.opacity = motion.opacity(rows[np.clip(np.searchsorted(t, times), 0, len(rows) - 1)])
        self.path = drawing.thin_path(motion)
        self.path_t = motion.t[:: max(1, len(motion.t) // drawing.MAX_DRAWN_POINTS)]

    def at(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        now = self.times[k]
        behind = self.path[(self.path_t <= now) & (self.path_t >= now - self.trail)]
        return self.position[k], self.quaternion[k], self.opacity[k], np.vstack([behind, self.position[k]])


def _check_rates(fps: float, speed_up: float) -> None:
    for name, value in (("fps", fps), ("speed up factor", speed_up)):
        if not (math.isfinite(value) and value > 0):
            raise ConfigError(f"animation: '{name}' is {value!r}, expected a positive number")


def _check_axes(axes: Axes3D | None, figure: Figure | None) -> Axes3D:
    if axes is None and figure is not None and figure.axes:
        axes = figure.axes[-1]
    if axes is None:
        return make_axes(figure or Figure(figsize=(7.2, 5.76), dpi=100))
    if not isinstance(axes, Axes3D):
        raise ConfigError(
            "animation: the axes are not three-dimensional; make them with "
            "`quasi.pages.drone.make_axes`, or put them last in the figure"
        )
    return axes
