"""Figures of a simulation: what the lines hold, what references, limits and faults add, and a flight out of control."""

import numpy as np
import pandas as pd
import pytest
from airframes import to_draw
from scipy.spatial.transform import Rotation

from quasi.errors import DataError
from quasi.simulation.tools.figures import draw_simulation


@pytest.fixture
def airframe():
    return to_draw(**{"idle RPM": 250, "max RPM": 2500, "motor poles": 14})


@pytest.fixture
def table():
    t = np.arange(0.0, 4.0, 0.01)
    columns = {"t": t, "x": np.sin(t), "y": np.cos(t), "z": -1 - 0.1 * t}
    columns |= {"roll": 0.1 * np.sin(t), "pitch": 0.2 * np.cos(t), "yaw": 2.0 * t}
    columns |= {name: np.cos(t + k) for k, name in enumerate(["u", "v", "w", "p", "q", "r"])}
    columns |= {f"w{i}": 1500 + 100 * np.sin(t + i) for i in range(1, 5)}
    columns |= {name: np.sin(t * k) for k, name in enumerate(["Fx", "Fy", "Fz", "Mx", "My", "Mz"], 1)}
    return pd.DataFrame(columns)


def line(axis, label):
    return next(li for li in axis.lines if li.get_label().startswith(label)).get_ydata()


def panel(figure, label):
    return next(axis for axis in figure.axes if axis.get_ylabel().replace("\n", " ").startswith(label))


def test_lines_hold_the_table_in_the_units_of_their_labels(table, airframe):
    figures = draw_simulation(table, airframe, {"name": "made"})
    assert set(figures) == {"overview", "states", "rotor_speeds", "forces_and_moments", "trajectory"}
    states = figures["states"]
    np.testing.assert_array_equal(line(panel(states, "north x, m"), "simulated"), table["x"])
    np.testing.assert_allclose(line(panel(states, "roll rate p, deg/s"), "simulated"), table["p"] * 180 / np.pi)
    yaw = line(panel(states, "yaw, deg"), "simulated")
    wrapped = (table["yaw"].to_numpy() * 180 / np.pi + 180) % 360 - 180
    shown = np.isfinite(yaw)
    np.testing.assert_allclose(yaw[shown], wrapped[shown], atol=1e-9)
    assert (~shown).sum() == 1  # 8 rad pass half a turn once: one gap in place of a vertical line
    np.testing.assert_array_equal(figures["forces_and_moments"].axes[5].lines[0].get_ydata(), table["Mz"])
    for figure in figures.values():
        figure.canvas.draw()


def test_down_is_drawn_downwards(table, airframe):
    low, high = panel(draw_simulation(table, airframe, {})["states"], "down z").get_ylim()
    assert low > high


def test_rotor_speeds_come_with_commands_places_and_limits(table, airframe):
    table["w2_CMD"] = 1600.0
    figure = draw_simulation(table, airframe, {})["rotor_speeds"]
    axis = panel(figure, "rotor 2 (front right)")
    np.testing.assert_array_equal(line(axis, "command"), table["w2_CMD"])
    factor = 100 * 2 * np.pi / 60 / 7
    heights = sorted(li.get_ydata()[0] for li in axis.lines if li.get_label() == "limits")
    np.testing.assert_allclose(heights, [250 * factor, 2500 * factor])
    own = draw_simulation(table, airframe, {"speed limits": [100.0, 3000.0]})["rotor_speeds"]
    assert sorted(li.get_ydata()[0] for li in own.axes[0].lines if li.get_label() == "limits") == [100.0, 3000.0]


def test_tracking_error_is_reference_less_simulated_and_angles_take_the_short_way(table, airframe):
    table["x_ref"] = table["x"] + 0.3
    table["yaw_ref"] = table["yaw"] + 2 * np.pi - 0.1
    figure = draw_simulation(table, airframe, {})["tracking_error"]
    assert len(figure.axes) == 2  # position and attitude; nothing is referred to elsewhere
    np.testing.assert_allclose(line(panel(figure, "position"), "x, rms 0.3 m"), 0.3)
    np.testing.assert_allclose(line(panel(figure, "attitude"), "yaw"), np.degrees(-0.1))


def test_a_velocity_reference_in_earth_axes_is_shown_in_body_axes(table, airframe):
    earth = np.array([1.0, -2.0, 0.5])
    table[["vx_ref", "vy_ref", "vz_ref"]] = earth
    figure = draw_simulation(table, airframe, {})["states"]
    turn = Rotation.from_euler("ZYX", table[["yaw", "pitch", "roll"]].to_numpy())
    expected = turn.inv().apply(np.tile(earth, (len(table), 1)))
    np.testing.assert_allclose(line(panel(figure, "forward u"), "reference"), expected[:, 0], atol=1e-12)
    np.testing.assert_allclose(line(panel(figure, "down w"), "reference"), expected[:, 2], atol=1e-12)


def test_a_reference_that_is_nowhere_given_is_not_drawn(table, airframe):
    table["x_ref"] = np.nan
    figures = draw_simulation(table, airframe, {})
    assert "tracking_error" not in figures
    assert not any(li.get_label() == "reference" for li in panel(figures["states"], "north x").lines)


def test_a_fault_is_marked_and_an_early_end_said(table, airframe):
    figures = draw_simulation(table, airframe, {"name": "made", "fault time": 2.0, "ended": "diverged at 4 s"})
    for name in ("states", "rotor_speeds", "forces_and_moments"):
        assert figures[name].get_suptitle().endswith("(diverged at 4 s)")
        assert all(any(li.get_label() == "fault" for li in axis.lines) for axis in figures[name].axes)


def test_the_last_rows_of_a_flight_out_of_control_do_not_hide_the_rest(table, airframe):
    table.loc[table.index[-2:], ["x", "p", "Mz"]] = 1e7
    figures = draw_simulation(table, airframe, {})
    for figure, label in (("states", "north x"), ("states", "roll rate p"), ("forces_and_moments", "Mz")):
        assert abs(panel(figures[figure], label).get_ylim()[1]) < 500
    assert abs(figures["trajectory"].axes[0].get_xlim()[1]) < 5


def test_a_table_that_lacks_something_is_told(table, airframe):
    with pytest.raises(DataError, match="no column 'w3'"):
        draw_simulation(table.drop(columns="w3"), airframe, {})
    with pytest.raises(DataError, match="no rows"):
        draw_simulation(table.iloc[:0], airframe, {})


@pytest.mark.parametrize("rows", [1, 2])
def test_a_simulation_that_ended_at_once_has_figures_as_well(table, airframe, rows):
    table["x_ref"] = 1.0
    for figure in draw_simulation(table.iloc[:rows].copy(), airframe, {"ended": "diverged at 0.004 s"}).values():
        figure.canvas.draw()


def test_rows_that_are_no_numbers_are_left_blank(table, airframe):
    table.loc[table.index[200:], ["u", "v", "w", "x", "y", "z", "roll", "pitch", "yaw"]] = np.nan
    for figure in draw_simulation(table, airframe, {}).values():
        figure.canvas.draw()
