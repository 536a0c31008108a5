"""Drones in 3-D figures: where their parts stand, which way is up, what opacity says, what cannot be drawn."""

import warnings

import numpy as np
import pandas as pd
import pytest
from airframes import to_draw
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from quasi.attitude import from_euler
from quasi.errors import DataError, ShapeError
from quasi.pages import drawing
from quasi.pages.drawing import Motion, make_motion, trajectories, trajectory
from quasi.pages.drone import Look, make_axes

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def airframe():
    return to_draw(**{"max RPM": 2500, "motor poles": 14})


@pytest.fixture
def turn(airframe):
    """A level circle of 2 m at a height of 1.5 m, nose along the path."""
    t = np.linspace(3.0, 9.0, 601)
    angle = (t - 3.0) * np.pi / 3.0
    where = np.stack([2 * np.cos(angle), 2 * np.sin(angle), np.full_like(t, -1.5)], axis=1)
    attitude = from_euler(0 * t, 0 * t, angle + np.pi / 2)
    speeds = np.linspace(0, 1, len(t))[:, None] * np.ones(4) * 1000.0
    return Motion(airframe, t, where, attitude, speeds, "made")


def render(figure):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.canvas.draw()


def test_the_faster_a_rotor_the_more_opaque_and_the_limit_is_opaque(airframe, turn):
    limit = 2500 * airframe.logged_to_rad_s
    speeds = np.array([[0.0, 0.25 * limit, limit, 2 * limit]])
    motion = Motion(airframe, [0.0], np.zeros((1, 3)), LEVEL[None], speeds)
    np.testing.assert_allclose(motion.opacity(np.array([0])), [[0.0, 0.25, 1.0, 1.0]])
    alike = Motion(airframe, [0.0], np.zeros((1, 3)), LEVEL[None], speeds, look=Look(rotor_opacity=False))
    assert len(np.unique(alike.opacity(np.array([0])))) == 1


def test_the_more_recent_a_still_the_more_opaque_its_frame(turn):
    figure = trajectories([turn], stills=4)
    lines = next(c for c in figure.axes[0].collections if hasattr(c, "_segments3d"))
    alpha = lines.get_colors()[::4, 3]
    np.testing.assert_allclose(alpha, np.linspace(drawing.MIN_STILL_OPACITY, 1.0, 4), atol=1e-12)
    render(figure)


def test_stills_are_even_in_time_or_at_the_times_asked_for(turn):
    assert list(turn.t[drawing._choose_still_rows(turn, 4, None)]) == pytest.approx([3.0, 5.0, 7.0, 9.0])
    assert list(turn.t[drawing._choose_still_rows(turn, 4, [8.004, 3.5])]) == pytest.approx([3.5, 8.0])
    assert len(drawing._choose_still_rows(turn, 0, None)) == 0


def test_options_of_the_look_reach_the_picture(turn):
    look = Look(frame="tab:green", rotors="tab:blue", thickness=5.0, history="tab:pink", body_axes=True)
    figure = trajectory(None, turn.airframe, turn.t, turn.position, turn.quaternion, turn.rotor_speeds, 1, look)
    axes = figure.axes[0]
    lines, faces = axes.collections
    assert lines.get_linewidth()[0] == 5.0
    assert tuple(lines.get_colors()[0]) == to_rgba("tab:green")
    assert len(lines._segments3d) == 4 + 3
    assert tuple(faces.get_edgecolor()[0][:3]) == to_rgba("tab:blue")[:3]
    assert axes.lines[0].get_color() == "tab:pink"


def test_a_second_drone_in_the_same_axes_widens_the_limits(turn, airframe):
    axes = make_axes(Figure())
    trajectories([turn], axes=axes)
    first = drawing.get_limits(axes)
    away = Motion(airframe, turn.t, turn.position + [10.0, 0.0, 0.0], turn.quaternion)
    trajectories([away], axes=axes)
    low, high = drawing.get_limits(axes)
    assert low[0] <= first[0][0] + 1e-9
    assert high[0] > 11.0
    assert len([t for t in axes.texts if t.get_gid() == "caption"]) == 1
    floors = {float(line.get_data_3d()[2][0]) for line in axes.lines if line.get_gid() == "shadow"}
    assert floors == {high[2]}  # both shadows on one floor


def test_enlarged_drones_are_said_to_be_so(turn):
    figure = trajectories([turn])
    factor = drawing.choose_enlargement([turn])
    assert factor > 1
    said = " ".join(t.get_text() for t in figure.axes[0].texts)
    assert f"{factor:g} times their size" in said
    plain = trajectories([turn], scale=1.0)
    assert not any("times their size" in t.get_text() for t in plain.axes[0].texts)


def test_rows_without_a_position_leave_gaps_and_no_still(turn):
    where = turn.position.copy()
    where[:200] = np.nan
    motion = Motion(turn.airframe, turn.t, where, turn.quaternion, turn.rotor_speeds)
    assert turn.t[drawing._choose_still_rows(motion, 2, None)][0] == pytest.approx(5.0)
    assert np.isnan(drawing.thin_path(motion)[:200]).all()
    render(trajectories([motion]))


def test_what_cannot_be_drawn_is_told(turn, airframe):
    with pytest.raises(ShapeError, match=r"position must be \(601, 3\) like t, got \(600, 3\)"):
        Motion(airframe, turn.t, turn.position[1:], turn.quaternion)
    with pytest.raises(DataError, match="no row with finite time, position and attitude"):
        Motion(airframe, turn.t, turn.position * np.nan, turn.quaternion)
    with pytest.raises(DataError, match="time steps back"):
        Motion(airframe, turn.t[::-1], turn.position, turn.quaternion)
    with pytest.raises(DataError, match="no column 'yaw'"):
        make_motion(pd.DataFrame({c: [0.0] for c in ("t", "x", "y", "z", "roll", "pitch")}), airframe, "flight a")
    with pytest.raises(DataError, match="nothing to draw at 20 s; choose times from 3 to 9 s"):
        drawing.snapshots([turn], [4.0, 20.0])
    with pytest.raises(DataError, match="no motion"):
        trajectories([])


def test_a_snapshot_shows_the_path_up_to_its_time_only(turn):
    figure = drawing.snapshots([turn], [4.0, 9.0])
    first, last = figure.axes
    history = first.lines[0].get_data_3d()
    np.testing.assert_allclose([h[-1] for h in history], turn.position[100])
    np.testing.assert_allclose(drawing.get_limits(first), drawing.get_limits(last))
    render(figure)


def test_a_hover_on_the_spot_can_be_drawn(airframe):
    t = np.arange(5.0)
    figure = trajectory(None, airframe, t, np.zeros((5, 3)), np.tile(LEVEL, (5, 1)))
    render(figure)
    low, high = drawing.get_limits(figure.axes[0])
    assert np.all(high - low >= 0.24 * 0.99)  # the drone itself fits


def test_several_drones_that_nobody_chose_a_look_for_are_told_apart(turn, airframe):
    away = Motion(airframe, turn.t, turn.position + [1.0, 0.0, 0.0], turn.quaternion, name="away")
    colours = [m.look.history for m in drawing.assign_colours([turn, away])]
    assert len(set(colours)) == 2
    chosen = Motion(airframe, turn.t, turn.position, turn.quaternion, look=Look(frame="red"))
    assert [m.look for m in drawing.assign_colours([turn, chosen])] == [turn.look, chosen.look]
    assert drawing.assign_colours([turn])[0].look == Look()
    legend = trajectories([turn, away]).axes[0].get_legend()
    assert [t.get_text() for t in legend.get_texts()] == ["made", "away"]


def test_where_stills_stand_in_one_place_the_last_one_says_the_time(airframe):
    t = np.linspace(0.0, 4.0, 41)
    where = np.zeros((41, 3))
    where[30:, 0] = 5.0
    figure = trajectory(None, airframe, t, where, np.tile(LEVEL, (41, 1)), stills=5)
    said = [text.get_text() for text in figure.axes[0].texts if text.get_text().endswith(" s")]
    assert said == ["2.0 s", "4.0 s"]


def test_a_look_may_change_on_the_way(turn):
    broken = Look(rotors=("red", "black", "black", "black"), history="turquoise")
    motion = drawing.replace(turn, changes=[(6.0, broken)])
    assert motion.choose_look(5.9) == turn.look
    assert motion.choose_look(6.0) == broken
    figure = trajectories([motion], stills=3)
    before, after = [c for c in figure.axes[0].collections if hasattr(c, "_faces")]
    assert not np.any(before._facecolor3d[:4, 0] == 1.0)
    assert after._facecolor3d[0, 0] == 1.0
    assert len(after._facecolor3d) == 2 * 5  # the stills at 6 s and 9 s
