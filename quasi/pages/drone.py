"""A quadrotor in 3-D axes: shape, look, axes with z upwards, captions. Nothing is shown or saved here.

Data coordinates of the axes are earth NED as everywhere. The y and z axes run backwards, which turns the picture half
round about x: up is up, and nothing is mirrored, as it would be with the z axis alone turned round.
"""

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3D, Line3DCollection, Poly3DCollection

from quasi.airframe import Airframe
from quasi.attitude import rotate

_DISC_CORNERS = 28  # of a rotor disc
_ELEVATION, _AZIMUTH = 24.0, -128.0  # deg, from which figures are seen at first
_AXES_COLOURS = ("tab:red", "tab:green", "tab:blue")  # body x, y, z, as usual


@dataclass(frozen=True)
class Look:
    """Look of a drone: matplotlib colours, line width (points), and visible parts.

    rotors         one colour, or four in the order of the rotors' numbers
    rotor_opacity  a disc's opacity is its rotor's speed as a share of the greatest one; otherwise all are alike
    body_axes      x, y, z of the body as red, green, blue lines
    """

    frame: str = "black"
    rotors: str | tuple[str, str, str, str] = "black"
    nose: str = "tab:red"
    history: str = "turquoise"
    thickness: float = 2.0
    rotor_opacity: bool = True
    body_axes: bool = False


@dataclass(frozen=True)
class Shape:
    """A drone's lines (S, 2, 3), rotor discs (4, C, 3) and nose (3, 3), body axes, m; body axes (3, 2, 3)."""

    arms: np.ndarray
    discs: np.ndarray
    nose: np.ndarray
    axes: np.ndarray
    span: float


def make_shape(airframe: Airframe, scale: float = 1.0) -> Shape:
    """Make the outline of an airframe from its hubs and rotor radius, enlarged by `scale`."""
    arms = np.stack([np.zeros((4, 3)), airframe.hubs], axis=1)
    angle = np.linspace(0.0, 2.0 * np.pi, _DISC_CORNERS, endpoint=False)
    circle = airframe.radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(_DISC_CORNERS)], axis=1)
    reach = float(np.linalg.norm(airframe.hubs, axis=1).max())
    nose = reach * np.array([[1.05, 0.0, 0.0], [0.55, -0.2, 0.0], [0.55, 0.2, 0.0]])
    axes = np.stack([np.zeros((3, 3)), 1.6 * reach * np.eye(3)], axis=1)
    discs = airframe.hubs[:, None, :] + circle
    return Shape(scale * arms, scale * discs, scale * nose, scale * axes, 2.0 * scale * (reach + airframe.radius))


def make_axes(figure: Figure, place: tuple[int, int, int] = (1, 1, 1)) -> Axes3D:
    """Make 3-D axes in a figure: NED coordinates, drawn with up upwards; place  rows, columns, number of the panel."""
    axes = figure.add_subplot(*place, projection="3d")
    if place[:2] == (1, 1):
        axes.set_position((0.05, 0.0, 0.93, 1.0))
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0.97, 0.97, 0.97))
        axis._axinfo["grid"].update(color=(0.85, 0.85, 0.85), linewidth=0.6)
    axes.tick_params(labelsize=8)
    axes.set_xlabel("x north, m")
    axes.set_ylabel("y east, m")
    axes.set_zlabel("z down, m")
    return axes


def set_limits(axes: Axes3D, low: np.ndarray, high: np.ndarray, least: float = 0.45) -> None:
    """Show the box from low (3,) to high (3,), m, NED, at one scale on all axes, with up upwards.

    least  a side shorter than this share of the longest is widened to it, so that a level flight stays readable
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    size = np.maximum(high - low, 1e-6)
    size = np.maximum(size, least * size.max())
    centre = 0.5 * (low + high)
    low, high = centre - 0.5 * size, centre + 0.5 * size
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(high[1], low[1])
    axes.set_zlim(high[2], low[2])
    # height and width of the box in the picture; matplotlib gives every box the same diagonal
    side, up, round_ = size / np.linalg.norm(size), math.radians(_ELEVATION), math.radians(_AZIMUTH)
    across = np.abs([math.cos(round_), math.sin(round_)])
    tall = side[2] * math.cos(up) + side[:2] @ across * math.sin(up)
    axes.set_box_aspect(size, zoom=min(0.84 / tall, 0.92 / (side[:2] @ across[::-1])))


def get_limits(axes: Axes3D) -> tuple[np.ndarray, np.ndarray]:
    """Return the visible box: low (3,) and high (3,), m, NED."""
    sides = np.array([sorted(axes.get_xlim()), sorted(axes.get_ylim()), sorted(axes.get_zlim())])
    return sides[:, 0], sides[:, 1]


class Drone:
    """A drone, or several stills of one, in 3-D axes; `pose` moves it without a new drawing."""

    def __init__(self, axes: Axes3D, shape: Shape, look: Look | None = None) -> None:
        self.shape, self.look = shape, look or Look()
        self._lines = Line3DCollection([np.zeros((2, 3))], linewidths=self.look.thickness, capstyle="round")
        self._faces = Poly3DCollection([np.zeros((3, 3))], linewidths=0.4 * self.look.thickness)
        # the drone's points must not move the limits
        axes.add_collection3d(self._lines, autolim=False)
        axes.add_collection3d(self._faces, autolim=False)

    @property
    def artists(self) -> tuple[Line3DCollection, Poly3DCollection]:
        """Drawn artists, back to front."""
        return self._lines, self._faces

    def set_look(self, look: Look) -> None:
        """Change the look from the next `pose` on."""
        if look != self.look:
            self.look = look
            self._lines.set_linewidth(look.thickness)
            self._faces.set_linewidth(0.4 * look.thickness)

    def pose(
        self, position: np.ndarray, quaternion: np.ndarray, opacity: np.ndarray, age: np.ndarray | None = None
    ) -> None:
        """Place one still per row.

        position (M, 3); quaternion (M, 4); opacity (M, 4) of the discs; age (M,) opacity of the frame, None for 1
        """
        position, quaternion = np.atleast_2d(position), np.atleast_2d(quaternion)
        quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
        opacity = np.atleast_2d(opacity)
        m = len(position)
        age = np.ones(m) if age is None else np.clip(age, 0.0, 1.0)

        def placed(vertices: np.ndarray) -> np.ndarray:
            flat = vertices.reshape(-1, 3)
            turned = rotate(quaternion[:, None, :], flat[None]) + position[:, None, :]
            return turned.reshape(m * (len(flat) // vertices.shape[-2]), vertices.shape[-2], 3)

        def coloured(colours: str | tuple[str, ...], alpha: np.ndarray) -> np.ndarray:
            each = np.array([to_rgb(c) for c in ((colours,) if isinstance(colours, str) else colours)])
            return np.column_stack([np.tile(each, (alpha.size // len(each), 1)), alpha.reshape(-1)])

        each = np.repeat(age, 4)
        lines, line_colours = [placed(self.shape.arms)], [coloured(self.look.frame, each)]
        if self.look.body_axes:
            lines.append(placed(self.shape.axes))
            three = np.array([to_rgb(c) for c in _AXES_COLOURS])
            line_colours.append(np.column_stack([np.tile(three, (m, 1)), np.repeat(age, 3)]))
        self._lines.set_segments(np.concatenate(lines))
        self._lines.set_color(np.concatenate(line_colours))
        faces = [*placed(self.shape.discs), *placed(self.shape.nose)]
        self._faces.set_verts(faces)
        self._faces.set_facecolor(np.concatenate([coloured(self.look.rotors, opacity), coloured(self.look.nose, age)]))
        rims = np.concatenate([coloured(self.look.rotors, each), coloured(self.look.nose, age)])
        self._faces.set_edgecolor(rims)


def draw_path_line(axes: Axes3D, path: np.ndarray, colour: str, width: float = 1.2, **more: object) -> Line3D:
    """Draw a path (M, 3) without moving the limits."""
    line = Line3D(*path.T, color=colour, linewidth=width, **more)
    axes.add_line(line)
    return line


def write_caption(axes: Axes3D, title: str, scale: float) -> None:
    """Write title and enlargement of the drones in the upper left corner; replaces an earlier caption."""
    lines = [title] if title else []
    if scale > 1.0:
        lines.append(f"drones drawn {scale:g} times their size")
    for text in [t for t in axes.texts if t.get_gid() == "caption"]:
        text.remove()
    if lines:
        axes.text2D(
            0.02, 0.98, "\n".join(lines), transform=axes.transAxes, fontsize=9, ha="left", va="top", gid="caption"
        )
