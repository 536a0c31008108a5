"""The figures hold what they say."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from rigid_body import measure, move, quadrotor

from quasi.filtering.figures import figures
from quasi.filtering.flight import filter_flight

STATES = ["attitude", "velocity", "position", "forces", "moments"]


@pytest.fixture(scope="module")
def flown():
    frame, metadata = measure(move(seconds=8.0, loops=False))
    return frame, filter_flight(frame, metadata, quadrotor(), {"re-estimate noise": False})


def test_figures_with_bounds_and_the_end_of_the_rest(flown):
    frame, result = flown
    made = figures(frame, result.with_gravity, result.metadata, result.convergence)
    assert list(made) == [*STATES, "gyro_bias", "accelerometer_bias", "vibration"]
    end = result.metadata["phases"]["rest"][1]
    for name, figure in list(made.items())[:-1]:
        assert isinstance(figure, Figure) and len(figure.axes) == 3
        for axis in figure.axes:
            verticals = [line for line in axis.lines if np.ptp(line.get_xdata()) == 0]
            assert [line.get_xdata()[0] for line in verticals] == [end], name
            assert axis.get_ylabel().count(",") == 1
    lines = {line.get_label(): line for line in made["gyro_bias"].axes[0].lines}
    upper, value = lines["± 2 standard errors"].get_ydata(), lines["forward filter"].get_ydata()
    std = result.convergence["filter_bias_std_p"].to_numpy()
    np.testing.assert_allclose(upper - value, 2 * std[:: max(1, len(std) // 8000)])


def test_without_filter_there_are_no_figures_of_biases(flown):
    frame, result = flown
    assert list(figures(frame, result.with_gravity, result.metadata, None)) == [*STATES, "vibration"]


def test_spectra_show_what_the_filters_take_out_and_where_the_rotors_lines_stand(flown):
    frame, result = flown
    # a line of 0.2 rad/s at 90 Hz, beyond the cut-off, and rotors whose first harmonic stands there
    shaken = frame.assign(p=frame["p"] + 0.2 * np.sin(2 * np.pi * 90.0 * frame["t"]))
    table = result.with_gravity.assign(**{f"w{i}": 2 * np.pi * 90.0 for i in range(1, 5)})
    panel = figures(shaken, table, result.metadata, None)["vibration"].axes[0]
    lines = {line.get_label(): line for line in panel.lines}
    frequency, before = lines["imported"].get_xdata(), lines["imported"].get_ydata()
    at = int(np.argmin(np.abs(frequency - 90.0)))
    assert np.argmax(before[frequency > 50.0]) == np.argmax(frequency[frequency > 50.0] >= frequency[at])
    # Hann window: 1.5 bins hold the line's mean square
    assert before[at] ** 2 * 1.5 * frequency[0] == pytest.approx(0.02, rel=0.1)
    assert lines["filtered"].get_ydata()[at] < 0.01 * before[at]
    bands = [p.get_x() + p.get_width() / 2 for p in panel.patches]
    assert bands == pytest.approx([90.0, 180.0, 230.0]) and lines["cut-off"].get_xdata()[0] == 40.0
    # of a log at 1 kHz the import takes out what lies beyond 250 Hz, and rotors may be unknown
    metadata = result.metadata | {"imported": {"streams": {"gyro": {"rate": 1000.0}}}}
    panel = figures(shaken, table, metadata, None)["vibration"].axes[0]
    assert [p.get_x() + p.get_width() / 2 for p in panel.patches] == pytest.approx([90.0, 180.0])
    without = table.drop(columns=[f"w{i}" for i in range(1, 5)])
    assert not figures(shaken, without, metadata, None)["vibration"].axes[0].patches
