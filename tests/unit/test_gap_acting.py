"""How much a cause does and where: against what its equation says, in words that a pilot understands."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_gap_extension import CATALOGUE, base_of

from quasi.gap.effect import vehicle_of
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.effect_size import acting
from quasi.gap.materiality import Cause
from quasi.gap.report.wording import amount_of
from quasi.model.model import AXES

N = 4000
T = 0.01 * np.arange(N)


def flown(heights=None, **others):
    """A flight of a plain model at 1500 rad/s, level, through some heights, with other columns as given."""
    model = base_of("withGravity")
    columns = dict.fromkeys(("x", "y", "roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r"), 0.0 * T)
    columns |= {"t": T, "z": -2.0 + 0.0 * T if heights is None else -heights}
    columns |= {f"w{i}": 1500.0 + 0.0 * T for i in range(1, 5)} | {f"w{i}_dot": 0.0 * T for i in range(1, 5)} | others
    frame = model.airframe
    predicted = model.predict_columns(columns)[list(AXES)].to_numpy()
    return Evidence("a", frame, model, frame.mass, np.asarray(frame.inertia), columns, predicted, predicted)


def told(name, value, std, flight, channel, correlation=0.0):
    """What is said of a cause, and the sentence."""
    covariance = np.diag(np.square(list(std.values())))
    if len(std) > 1:
        covariance[0, 1] = covariance[1, 0] = correlation * np.sqrt(covariance[0, 0] * covariance[1, 1])
    cause = Cause(CATALOGUE[name], "changed", value, std, SimpleNamespace(covariance=covariance), [])
    found = acting(cause, [flight], vehicle_of(flight.model), channel)
    return found, amount_of({"acts": found})


def test_ground_effect_is_a_share_of_the_thrust_near_the_floor():
    heights = 1.0 + 0.95 * np.sin(T)
    flight = flown(heights)
    found, words = told("ground_effect", {"c": 3.0}, {"c": 0.3}, flight, "Fz")
    low, high = found["range"]
    assert found["where"] == "height" and found["signed"]
    assert low == pytest.approx(0.05, abs=0.001) and high < 0.3
    # Cheeseman & Bennett at the hubs of a level vehicle, whose rotors carry its weight
    hubs = heights - np.asarray(flight.hubs)[0, 2]
    near = 3.0 * (flight.airframe.radius / (4.0 * hubs)) ** 2
    rows = (heights >= low) & (heights <= high)
    simple = 4.0 * flight.thrust[0, 0] / np.mean(-flight.force[rows, 2])
    expected = simple * (near / (1.0 - near))[rows].mean()
    assert found["share"]["value"] == pytest.approx(expected, rel=0.02)
    slope = simple * (near / (1.0 - near) ** 2)[rows].mean() / 3.0
    assert found["share"]["std"] == pytest.approx(0.3 * slope, rel=0.03)
    assert words.endswith("% more thrust at a height of 0.05 to 0.07 m")


def test_drag_whose_sign_changes_is_told_as_rms_at_the_speeds_where_it_is_largest():
    flight = flown(u=6.0 * np.sin(T))
    found, words = told("body_drag", {"c": 0.05}, {"c": 0.005}, flight, "Fx")
    low, high = found["range"]
    rows = np.abs(6.0 * np.sin(T)) >= low
    assert found["where"] == "speed" and not found["signed"] and 4.0 < low < high == pytest.approx(6.0, abs=0.01)
    assert found["value"] == pytest.approx(0.05 * np.sqrt(np.mean((6.0 * np.sin(T[rows])) ** 4)))
    assert found["std"] == pytest.approx(0.1 * found["value"], rel=1e-3)
    assert " N rms of forward force at a speed of " in words


def test_what_acts_everywhere_alike_has_no_place():
    found, words = told("thrust_factor", {"factor": -0.05}, {"factor": 0.01}, flown(), "Fz")
    assert found["where"] is None and found["range"] is None
    assert words == "5.0 ± 1.0 % less thrust"


def test_parameters_that_are_told_together_have_one_doubt():
    """c |u| u alone makes the force; a parameter of the moment plays no part in its doubt, whatever the correlation."""
    flight = flown(u=3.0 + 0.0 * T)
    values, std = {"c": 0.05, "cz": 0.01}, {"c": 0.005, "cz": 0.002}
    for correlation in (0.0, 0.9):
        found, words = told("body_drag", values, std, flight, "Fx", correlation)
        assert (found["value"], found["std"]) == pytest.approx((-0.05 * 9.0, 0.005 * 9.0))
        assert words == "0.450 ± 0.045 N backward force"


@pytest.mark.parametrize("name", ["mass", "cg_offset", "rotor_speed_scale", "wind"])
def test_what_adds_no_force_is_told_by_its_parameters(name):
    names = list(CATALOGUE[name].parameters)
    found, words = told(name, dict.fromkeys(names, 0.01), dict.fromkeys(names, 0.001), flown(), "Fz")
    assert found is None and words == ""
