"""Figures of an imported flight: as aligned, before and after, from above and from the side."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from quasi.importing.figures import alignment_figure, close_up, trajectory_figure


@pytest.fixture
def imported():
    t = np.arange(0, 40.0, 0.01)
    burst = np.exp(-(((t - 25.0) / 2.0) ** 2))
    roll = 0.3 * burst * np.sin(6 * t)
    zero, one = np.zeros_like(t), np.ones_like(t)
    frame = pd.DataFrame(
        {
            "t": t,
            "p": np.gradient(roll, t),
            "q": zero,
            "r": zero,
            "ax": zero,
            "ay": zero,
            "az": zero - 9.81,
            "roll": roll,
            "pitch": zero,
            "yaw": zero,
            "x": np.cos(t),
            "y": np.sin(t),
            "z": zero - 1,
            "onboard_roll": roll,
            "onboard_pitch": zero,
            "onboard_yaw": zero,
            "u": zero,
            "v": zero,
            "w": zero,
            "attitude_sample": one,
            "position_sample": one,
            "velocity_sample": one,
        }
    )
    metadata = {
        "flight": "f",
        "quadrotor": "Q",
        "attitude source": "capture",
        "position source": "capture",
        "velocity source": "capture position",
        "synchronisation": {
            "lag": {"value": 1.2, "std": 1e-4},
            "clock rate": {"value": 1e-5, "std": 1e-6},
            "moved from beginnings": {"value": 1.0},
        },
    }
    return frame, metadata


def lines(figure, panel):
    return {line.get_label(): line for line in figure.axes[panel].lines}


def test_close_up_shows_the_liveliest_seconds_and_the_capture_where_it_was(imported):
    figure = close_up(*imported)
    low, high = figure.axes[0].get_xlim()
    assert high - low == pytest.approx(8.0, abs=0.02)
    assert 20.0 < 0.5 * (low + high) < 30.0
    drawn = lines(figure, 0)
    before, after = drawn["capture before alignment"], drawn["capture"]
    shown = before.get_xdata() + 1.0
    inside = shown <= after.get_xdata()[-1]
    np.testing.assert_allclose(
        np.interp(shown[inside], after.get_xdata(), after.get_ydata()), before.get_ydata()[inside], atol=1e-6
    )


def test_whole_flight_hides_the_capture_where_it_saw_nothing(imported):
    frame, metadata = imported
    gone = (frame["t"] > 10) & (frame["t"] < 12)
    frame.loc[gone, ["attitude_sample", "position_sample", "velocity_sample"]] = 0.0
    figure = alignment_figure(frame, metadata)
    drawn = lines(figure, 0)
    assert "capture before alignment" not in drawn
    t, roll = drawn["capture"].get_xdata(), drawn["capture"].get_ydata()
    assert np.isnan(roll[(t > 10.1) & (t < 11.9)]).all()
    assert np.isfinite(roll[(t < 9.9) | (t > 12.1)]).all()
    assert all(axis.get_ylabel().count(",") == 1 for axis in figure.axes)
    assert not (10 <= close_up(frame, metadata).axes[0].get_xlim()[0] <= 12)


def test_what_is_not_there_is_not_drawn(imported):
    frame, metadata = imported
    bare = {**metadata, "synchronisation": None, "attitude source": "onboard", "velocity source": "none"}
    assert close_up(frame, bare) is None
    assert set(lines(alignment_figure(frame, bare), 8)) == {"on board"}
    assert isinstance(trajectory_figure(frame, metadata), Figure)
    assert trajectory_figure(frame.drop(columns="x"), metadata) is None
    frame["position_sample"] = 0.0
    assert trajectory_figure(frame, metadata) is None
