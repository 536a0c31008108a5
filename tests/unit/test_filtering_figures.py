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
    assert list(made) == [*STATES, "gyro_bias", "accelerometer_bias"]
    end = result.metadata["phases"]["rest"][1]
    for name, figure in made.items():
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
    assert list(figures(frame, result.with_gravity, result.metadata, None)) == STATES
