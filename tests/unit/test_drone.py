"""One drone in 3-D axes: which way is up, one scale, where its parts stand, its look."""

import numpy as np
import pytest
from airframes import to_draw
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import proj3d

from quasi.attitude import from_euler
from quasi.pages.drone import Drone, Look, get_limits, make_axes, make_shape, set_limits


@pytest.fixture
def airframe():
    return to_draw(**{"max RPM": 2500, "motor poles": 14})


def on_screen(axes, point):
    axes.figure.canvas.draw() if axes.figure.canvas else None
    x, y, _ = proj3d.proj_transform(*point, axes.get_proj())
    return np.array([x, y])


def test_up_is_up_and_the_picture_is_no_mirror_image():
    axes = make_axes(Figure())
    set_limits(axes, -np.ones(3), np.ones(3))
    centre = on_screen(axes, (0, 0, 0))
    assert on_screen(axes, (0, 0, -1))[1] > centre[1]  # NED: negative z is above
    axes.view_init(elev=90, azim=-128)
    north, east = on_screen(axes, (1, 0, 0)) - centre, on_screen(axes, (0, 1, 0)) - centre
    # from above, east lies a right angle clockwise of north, as on a map
    assert north[0] * east[1] - north[1] * east[0] < -0.5 * np.linalg.norm(north) * np.linalg.norm(east)


def test_a_metre_is_as_long_along_every_axis():
    axes = make_axes(Figure())
    set_limits(axes, np.array([-3.0, -1.0, -2.0]), np.array([3.0, 1.0, -1.5]))
    low, high = get_limits(axes)
    aspect = np.array(axes._box_aspect)
    np.testing.assert_allclose(aspect / (high - low), (aspect / (high - low))[0])
    np.testing.assert_allclose(0.5 * (low + high), [0.0, 0.0, -1.75])


def test_discs_stand_on_the_hubs_with_the_rotor_radius(airframe):
    shape = make_shape(airframe, 3.0)
    np.testing.assert_allclose(shape.discs.mean(axis=1), 3.0 * airframe.hubs, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(shape.discs - 3.0 * airframe.hubs[:, None], axis=2), 0.12)
    assert shape.span == pytest.approx(2 * 3 * (0.08 + 0.04))
    assert shape.nose[0, 0] > shape.nose[1:, 0].max()  # the arrow points forward


def test_a_posed_drone_stands_where_the_rotation_matrix_puts_it(airframe):
    drone = Drone(make_axes(Figure()), make_shape(airframe))
    # nose east (yaw 90 deg): body x is earth y, body y is earth -x
    drone.pose([5.0, 6.0, -7.0], from_euler(0.0, 0.0, np.pi / 2), np.ones(4))
    plain = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    hubs = np.array([face[:-1].mean(axis=0) if len(face) == 29 else face.mean(axis=0) for face in _faces(drone)[:4]])
    np.testing.assert_allclose(hubs, airframe.hubs @ plain.T + [5.0, 6.0, -7.0], atol=1e-12)


def _faces(drone):
    faces = drone.artists[1]._faces
    return [np.asarray(face)[~np.asarray(np.ma.getmaskarray(face)).any(axis=1)] for face in faces]


@pytest.mark.parametrize("size", [(1, 1, 1), (8, 6, 0.1), (0.1, 0.1, 30), (0.1, 50, 2), (5, 5, 2)])
def test_the_whole_box_is_in_the_picture_whatever_its_shape(size):
    figure = Figure(figsize=(8, 6.4), dpi=100)
    axes = make_axes(figure)
    set_limits(axes, np.zeros(3), np.array(size, float))
    figure.canvas.draw()
    low, high = get_limits(axes)
    corners = np.array(np.meshgrid(*zip(low, high))).reshape(3, -1)
    x, y, _ = proj3d.proj_transform(*corners, axes.get_proj())
    pixels = axes.transData.transform(np.column_stack([x, y]))
    assert pixels.min() > 0
    assert np.all(pixels.max(axis=0) < [800, 640])


def test_rotors_may_have_a_colour_each_and_a_drone_may_change_its_look(airframe):
    drone = Drone(make_axes(Figure()), make_shape(airframe), Look(rotors=("red", "lime", "blue", "black")))
    drone.pose(np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.full((2, 4), 0.5))
    lines, faces = drone.artists
    colours = faces._facecolor3d  # get_facecolor sorts by depth
    np.testing.assert_allclose(colours[:4, :3], [to_rgb(c) for c in ("red", "lime", "blue", "black")])
    np.testing.assert_allclose(colours[4:8], colours[:4])  # the second still alike
    np.testing.assert_allclose(colours[:8, 3], 0.5)
    drone.set_look(Look(frame="red", thickness=6.0))
    drone.pose(np.zeros(3), [1.0, 0, 0, 0], np.ones(4))
    assert lines.get_linewidth()[0] == 6.0
    np.testing.assert_allclose(lines.get_colors()[:, :3], [to_rgb("red")] * 4)
