"""Animations: the picture is the one a full draw makes, times and speed, files, a figure of the user's."""

import numpy as np
import pytest
from airframes import to_draw
from matplotlib.figure import Figure
from PIL import Image

from quasi.attitude import from_euler
from quasi.errors import ConfigError, DataError
from quasi.pages import animation, drawing
from quasi.pages.animation import Scene, animate, follow_drone, list_frame_times, render_frames
from quasi.pages.drawing import Look, Motion


@pytest.fixture
def airframe():
    return to_draw()


@pytest.fixture
def flight(airframe):
    t = np.linspace(2.0, 4.0, 401)
    where = np.stack([3 * (t - 3), np.sin(3 * t), -t], axis=1)
    return Motion(airframe, t, where, from_euler(0.3 * np.sin(5 * t), 0.2 + 0 * t, t), np.full((401, 4), 900.0), "a")


def small():
    return drawing.make_axes(Figure(figsize=(3.2, 2.56), dpi=100))


def test_a_picture_from_the_kept_background_is_the_picture_drawn_whole(flight):
    axes = small()
    made = render_frames([flight], fps=2, axes=axes)
    next(made)
    kept = next(made).astype(int)  # the second one is drawn on the background of the first
    canvas = axes.figure.canvas

    def whole(moving):
        for artist in [*axes.lines, *axes.collections, *axes.texts]:
            artist.set_animated(False)
            artist.set_visible(moving)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].astype(int)

    assert (np.abs(kept - whole(True)).max(axis=2) > 40).mean() < 0.001
    assert (np.abs(kept - whole(False)).max(axis=2) > 40).mean() > 0.01


def test_frames_show_the_whole_flight_at_the_speed_asked_for(flight):
    np.testing.assert_allclose(list_frame_times([flight], 25.0, 1.0), 2.0 + np.arange(51) / 25.0)
    np.testing.assert_allclose(list_frame_times([flight], 10.0, 4.0), 2.0 + np.arange(6) * 0.4)


def test_the_drone_stands_where_the_motion_is_at_the_time_of_the_frame(flight):
    axes = small()
    centres = []
    for _ in render_frames([flight], fps=4, axes=axes, scale=1.0):
        arms = np.asarray(axes.collections[0]._segments3d)
        centres.append(arms[0, 0])
    expected = [np.interp(np.linspace(2, 4, 9), flight.t, column) for column in flight.position.T]
    np.testing.assert_allclose(centres, np.transpose(expected), atol=1e-12)


def test_a_gif_plays_at_its_rate_and_moves(flight, tmp_path):
    count = animate([flight], tmp_path / "flight.gif", fps=10, axes=small())
    assert count == 21
    with Image.open(tmp_path / "flight.gif") as image:
        assert image.n_frames == 21
        assert image.info["duration"] == 100
        assert image.info["loop"] == 0
        first = np.asarray(image.convert("RGB"), int)
        image.seek(20)
        last = np.asarray(image.convert("RGB"), int)
    assert (np.abs(first - last).max(axis=2) > 60).mean() > 0.005


def test_a_gif_holds_every_picture_whole(tmp_path):
    # colours of the palette, so that nothing is rounded; a part that changes, none, and all of it
    rng = np.random.default_rng(1)
    first = 51 * rng.integers(0, 6, (40, 60, 3)).astype(np.uint8)
    second = first.copy()
    second[10:20, 30:50] = (255, 0, 51)
    made = [first, second, second, 255 - second, first]
    assert animation.write_gif(tmp_path / "a.gif", made, 20.0) == 5
    with Image.open(tmp_path / "a.gif") as image:
        for k, picture in enumerate(made):
            image.seek(k)
            # the palette is searched coarsely: a grey may stand for one 5 shades away
            np.testing.assert_allclose(np.asarray(image.convert("RGB"), int), picture.astype(int), atol=8)
            assert image.info["duration"] == 50


def test_a_gif_keeps_true_time_at_rates_that_it_cannot_play(flight, tmp_path):
    # 30 frames/s would last 3.33 hundredths of a second each; 3 are played, so frames are made for that
    count = animate([flight], tmp_path / "flight.gif", fps=30, axes=small())
    with Image.open(tmp_path / "flight.gif") as image:
        assert (count - 1) * image.info["duration"] / 1e3 == pytest.approx(2.0, abs=0.03)


def test_colours_survive_the_gif(flight, tmp_path):
    animate([flight], tmp_path / "flight.gif", fps=2, axes=small())
    with Image.open(tmp_path / "flight.gif") as image:
        image.seek(image.n_frames - 1)
        colours = np.asarray(image.convert("RGB"), int).reshape(-1, 3)
    turquoise = np.array([64, 224, 208])
    assert np.abs(colours - turquoise).max(axis=1).min() < 30


def test_an_mp4_holds_as_many_frames_as_were_drawn(flight, tmp_path):
    encoder = pytest.importorskip("imageio_ffmpeg", reason="the extra 'animation' is not installed")
    count = animate([flight], tmp_path / "flight.mp4", fps=10, axes=small(), speed_up=2.0)
    assert count == 11
    assert encoder.count_frames_and_secs(str(tmp_path / "flight.mp4"))[0] == 11
    assert list(tmp_path.iterdir()) == [tmp_path / "flight.mp4"]


def test_without_an_encoder_mp4_is_refused_with_the_remedy(flight, tmp_path, monkeypatch):
    monkeypatch.setattr(animation, "can_write_mp4", lambda: False)
    with pytest.raises(ConfigError, match=r"pip install 'quasi\[animation\]'.*or name it \.gif"):
        animate([flight], tmp_path / "flight.mp4")
    assert not list(tmp_path.iterdir())


def test_an_animation_goes_into_a_figure_of_the_users_with_a_wrapper(flight):
    figure = Figure(figsize=(6.4, 2.56), dpi=100)
    height = figure.add_subplot(1, 2, 1)
    height.set(xlim=(2, 4), ylim=(2, 4))
    (line,) = height.plot([], [], "r", linewidth=4)
    drawing.make_axes(figure, (1, 2, 2))  # last, so that the animation goes there
    canvas = figure.canvas
    seen = []

    def wrapper(time, axes):
        seen.append((time, axes))
        line.set_data([2, time], [2, time])
        return [line]

    red = []
    for picture in render_frames([flight], fps=2, figure=figure, wrapper=wrapper):
        left = picture[:, :300].astype(int)
        red.append(int(((left[..., 0] > 200) & (left[..., 1] < 80)).sum()))
    assert [time for time, _ in seen] == [2.0, 2.5, 3.0, 3.5, 4.0]
    assert all(axes is figure.axes[-1] for _, axes in seen)
    assert np.all(np.diff(red) > 0)  # the line grows, and nothing of it stays behind
    assert figure.canvas is canvas


def test_what_a_silent_wrapper_moves_is_drawn_as_well(flight):
    figure = Figure(figsize=(6.4, 2.56), dpi=100)
    panel = figure.add_subplot(1, 2, 1)
    panel.set(xticks=[], yticks=[])
    axes = drawing.make_axes(figure, (1, 2, 2))

    def wrapper(time, axes):
        panel.set_facecolor("red" if time > 2.9 else "blue")

    shown = [picture[128, 150] for picture in render_frames([flight], fps=1, axes=axes, wrapper=wrapper)]
    np.testing.assert_array_equal(shown, [[0, 0, 255], [255, 0, 0], [255, 0, 0]])


def test_limits_may_follow_the_drone(flight):
    axes = small()
    boxes = [
        drawing.get_limits(axes) for _ in render_frames([flight], fps=1, axes=axes, limits=follow_drone(flight, 0.5))
    ]
    where = [flight.position[flight.row_at(t)] for t in (2.0, 3.0, 4.0)]
    np.testing.assert_allclose([0.5 * (low + high) for low, high in boxes], where, atol=1e-12)
    np.testing.assert_allclose([high - low for low, high in boxes], 1.0)


def test_several_drones_move_at_once_and_the_nearer_hides_the_farther(airframe):
    t = np.array([0.0, 1.0])
    level = np.tile([1.0, 0, 0, 0], (2, 1))
    full = np.full((2, 4), 1.0)
    axes = small()
    axes.view_init(elev=90, azim=-128)  # from above
    low = Motion(airframe, t, np.array([[0, 0, 0.0]] * 2), level, full, look=Look(rotors="red"), fastest=1.0)
    high = Motion(airframe, t, np.array([[0, 0, -0.1]] * 2), level, full, look=Look(rotors="blue"), fastest=1.0)
    for order in ([low, high], [high, low]):
        axes = small()
        axes.view_init(elev=90, azim=-128)
        picture = next(iter(render_frames(order, axes=axes, scale=1.0))).astype(int)
        red = ((picture[..., 0] > 200) & (picture[..., 2] < 60)).sum()
        blue = ((picture[..., 2] > 200) & (picture[..., 0] < 60)).sum()
        assert blue > 4 * red
        assert blue > 200


def test_a_scene_on_a_window_keeps_up_with_redraws_from_outside(flight):
    axes = small()
    animation.FigureCanvasAgg(axes.figure)
    drawing.set_limits(axes, *drawing.find_extent([flight]))
    scene = Scene(axes, [(flight.airframe, flight.look)])
    scene.place(0, flight.position[0], flight.quaternion[0], np.ones(4), flight.position[:1])
    scene.draw()
    axes.view_init(elev=60)
    axes.figure.canvas.draw()  # as a window does when it is turned or resized
    scene.draw()
    turned = scene.picture()
    scene.draw(anew=True)
    np.testing.assert_array_equal(turned, scene.picture())


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"path": "a.avi"}, "'.avi' is not an animation format"),
        ({"fps": 0.0}, "'fps' is 0.0, expected a positive number"),
        ({"speed_up": float("nan")}, "'speed up factor' is nan"),
        ({"speed_up": 1e-5}, "frames, more than 20000; speed it up"),
    ],
)
def test_impossible_settings_are_told(flight, tmp_path, changed, says):
    settings = {"path": "a.gif", **changed}
    with pytest.raises(ConfigError, match=says.replace(".", r"\.")):
        animate([flight], tmp_path / settings.pop("path"), **settings)
    assert not list(tmp_path.iterdir())


def test_flat_axes_and_no_motion_are_told(flight, tmp_path):
    figure = Figure()
    figure.subplots()
    with pytest.raises(ConfigError, match="not three-dimensional"):
        animate([flight], tmp_path / "a.gif", figure=figure)
    with pytest.raises(DataError, match="no motion to animate"):
        animate([], tmp_path / "a.gif")


def test_a_look_changes_in_the_middle_of_an_animation(flight):
    axes = small()
    changed = Motion(
        flight.airframe, flight.t, flight.position, flight.quaternion, changes=[(3.0, Look(frame="red", thickness=7.0))]
    )
    seen = []
    for _ in render_frames([changed], fps=2, axes=axes):
        lines = axes.collections[0]
        seen.append((lines.get_linewidth()[0], lines.get_colors()[0, 0]))
    assert seen == [(2.0, 0.0)] * 2 + [(7.0, 1.0)] * 3
