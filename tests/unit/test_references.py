"""References against their own derivatives by differences, printed formulas and an independent spline."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from quasi.errors import ConfigError, DataError
from quasi.project.configuration import schema
from quasi.simulation.control.references import evaluate_reference, make_reference

X, V, ANGLES, RATES, THRUST, TURN, A = slice(1, 4), slice(4, 7), slice(7, 10), slice(10, 13), 13, 14, slice(15, 18)


def goals(settings, times, table=None):
    made = make_reference(settings, table)
    out = np.full((len(times), 20), 7.7)  # whatever stood there before must go
    for row, t in enumerate(times):
        evaluate_reference(*made, t, out[row])
    return out


def differences(settings, times, table=None, step=1e-5):
    """Velocity and acceleration of the position, and velocity of the heading, by central differences."""
    before, at, after = (goals(settings, times + d, table) for d in (-step, 0.0, step))
    velocity = (after[:, X] - before[:, X]) / (2 * step)
    acceleration = (after[:, V] - before[:, V]) / (2 * step)
    return at, velocity, acceleration, (after[:, 9] - before[:, 9]) / (2 * step)


def test_without_settings_it_hovers_where_it_is_and_carries_the_weight():
    goal = goals(None, [0.0, 5.0])
    assert np.all(np.delete(goal, THRUST, axis=1) == 0.0)
    assert np.all(np.isnan(goal[:, THRUST]))


def test_the_manuals_position_track_steps_down_at_2_s_and_sideways_at_6_s():
    goal = goals({"do position track": True, "do circle track": False}, [1.999, 2.0, 5.999, 6.0, 100.0])
    assert goal[:, X].tolist() == [[0, 0, 0], [0, 0, -1], [0, 0, -1], [4, -2, -1], [4, -2, -1]]
    assert np.all(goal[:, V] == 0.0)


def test_the_figure_eight_is_its_formula_after_its_transition():
    times = np.linspace(5.1, 20.0, 40)
    goal = goals({"kind": "figure eight"}, times)
    phi = times - 3.0
    assert np.allclose(goal[:, 1], 3 * np.cos(phi), atol=1e-12)
    assert np.allclose(goal[:, 2], 3 * np.sin(phi) * np.cos(phi), atol=1e-12)
    assert np.all(goal[:, 3] == -2.0)


def test_the_manuals_circle_is_4_m_at_1_rad_per_s_from_3_s_on():
    before = goals({"do circle track": True}, [0.0, 2.999])
    assert not before[:, X].any() and not before[:, V].any()
    times = np.linspace(5.0, 20.0, 60)
    goal = goals({"do circle track": True}, times)
    phi = times - 3.0
    assert np.allclose(goal[:, X], np.stack([4 * np.cos(phi), 4 * np.sin(phi), np.full(60, -2.0)], 1), atol=1e-12)
    assert np.allclose(goal[:, V], np.stack([-4 * np.sin(phi), 4 * np.cos(phi), np.zeros(60)], 1), atol=1e-12)
    assert np.allclose(goal[:, A], np.stack([-4 * np.cos(phi), -4 * np.sin(phi), np.zeros(60)], 1), atol=1e-12)
    assert not goal[:, [9, TURN]].any()


@pytest.mark.parametrize("rate", [0.8, -0.8])
def test_a_circle_has_the_radius_rate_height_and_heading_that_are_set(rate):
    settings = {"kind": "circle", "radius": 2.5, "rate": rate, "height": 3.0, "heading": "along path",
                "centre": [10.0, -5.0], "start": 1.0, "transition": 0.0}  # fmt: skip
    times = np.linspace(1.0, 12.0, 50)
    goal = goals(settings, times)
    arm = goal[:, 1:3] - [10.0, -5.0]
    assert np.allclose(np.hypot(*arm.T), 2.5) and np.allclose(goal[:, 3], -3.0)
    azimuth = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))
    assert np.allclose(azimuth, rate * (times - 1.0))  # clockwise from above for a positive rate
    course = np.arctan2(goal[:, 5], goal[:, 4])
    assert np.allclose(np.exp(1j * goal[:, 9]), np.exp(1j * course)), "the nose points along the velocity"
    assert np.allclose(goal[:, TURN], rate)
    assert np.allclose(goals({**settings, "heading": 0.3}, times)[:, 9], 0.3)


SAMPLES = {"t": np.array([1.0, 1.7, 2.0, 3.1, 4.0]), "x": np.array([0, 1.0, -2, 0.5, 1]),
           "y": np.array([3.0, 2, 2, 1, 5]), "z": -np.array([1.0, 2, 1, 2, 1]),
           "yaw": np.array([3.0, -3.1, -2.9, 3.0, 2.0])}  # fmt: skip


@pytest.mark.parametrize(
    ("settings", "table"),
    [
        ({"kind": "figure eight", "amplitude": 2.0, "angular speed": 1.7, "yaw rate": 0.4}, None),
        ({"kind": "figure eight", "hold": [1.0, -2.0, 0.5], "transition": 4.0}, None),
        ({"do circle track": True}, None),
        ({"kind": "circle", "rate": -1.7, "height": -0.5, "hold": [1.0, -2.0, 0.5], "transition": 3.0}, None),
        (
            {"kind": "position steps", "steps": [[0, 0, 0, 0, 0], [2, 1, 2, -3, 1.0], [6, 0, 0, 0]], "transition": 2},
            None,
        ),
        ({"kind": "table"}, SAMPLES),
        ({"kind": "table", "end": "repeat"}, SAMPLES),
        ({"kind": "table"}, {**SAMPLES, "vx": np.zeros(5), "ax": np.ones(5)}),
    ],
)
def test_velocity_and_acceleration_are_the_derivatives_of_the_position(settings, table):
    times = np.linspace(0.31, 12.0, 173)
    at, velocity, acceleration, _ = differences(settings, times, table)
    kinks = np.zeros(len(times), bool)
    if table is not None:  # the ends of a table are kinks
        ends = [1.0, 4.0, 7.0, 10.0] if settings.get("end") == "repeat" else [1.0, 4.0]
        kinks = np.min(np.abs(times[:, None] - ends), axis=1) < 1e-3
    assert np.allclose(at[~kinks, V], velocity[~kinks], atol=1e-6)
    assert np.allclose(at[~kinks, A], acceleration[~kinks], atol=1e-5)


def test_the_heading_turns_at_the_stated_yaw_rate():
    times = np.linspace(0.5, 9.5, 61)
    for settings in (
        {"kind": "figure eight", "yaw rate": 0.7},
        {"kind": "circle", "rate": -0.7, "heading": "along path", "start": 0.0},
        {"kind": "velocity steps", "steps": [[0, 1, 0, 0, 0.5], [2.02, 0, 1, 0, -1.0], [5.03, 0, 0, 1]]},
        {"kind": "position steps", "steps": [[0, 0, 0, 0, 0.2], [3.03, 0, 0, 0, 1.0]], "transition": 2},
    ):
        at, _, _, turn = differences(settings, times)
        assert np.allclose(at[:, TURN], turn, atol=1e-6)


def test_a_table_is_a_natural_cubic_spline_through_its_rows():
    times = np.linspace(1.0, 3.999, 50)
    goal = goals({"kind": "table"}, times, SAMPLES)
    for k, name in enumerate("xyz"):
        spline = CubicSpline(SAMPLES["t"], SAMPLES[name], bc_type="natural")
        assert np.allclose(goal[1:, 1 + k], spline(times[1:]), atol=1e-12)
    assert goals({"kind": "table"}, [1.7], SAMPLES)[0, 9] == pytest.approx(2 * np.pi - 3.1), "the shorter way round"


def test_a_table_holds_its_ends_or_begins_anew():
    before, after = goals({"kind": "table"}, [0.0, 9.0], SAMPLES)
    assert before[X].tolist() == [0, 3, -1] and after[X].tolist() == [1, 5, -1]
    assert not before[V].any() and not after[V].any() and not after[A].any()
    again = goals({"kind": "table", "end": "repeat"}, [1.5, 4.5, 7.5], SAMPLES)
    assert np.allclose(again[0, X], again[1:, X], atol=1e-12)


def test_a_table_of_steps_keeps_each_row_until_the_next():
    goal = goals({"kind": "table", "interpolation": "steps"}, [1.699, 1.7], SAMPLES)
    assert goal[0, X].tolist() == [0, 3, -1] and goal[1, X].tolist() == [1, 2, -2]


def test_tables_of_velocity_and_rates_go_linearly_and_attitude_by_the_shorter_turn():
    t = [0.0, 2.0]
    velocity = goals({"kind": "table", "goal": "velocity"}, [1.0], {"t": t, "vx": [0, 1], "vy": [0, 0], "vz": [2, 0]})[
        0
    ]
    assert velocity[0] == 1.0 and velocity[V].tolist() == [0.5, 0, 1] and velocity[A].tolist() == [0.5, 0, -1]
    table = {"t": t, "roll": [0.0, 0.2], "pitch": [0.1, 0.1], "yaw": [0.0, 1.0], "thrust": [4.0, 5.0]}
    attitude = goals({"kind": "table", "goal": "attitude"}, [1.0], table)[0]
    assert (
        attitude[0] == 2.0 and np.allclose(attitude[ANGLES], [0.1, 0.125, 0.5], atol=0.001) and attitude[THRUST] == 4.5
    )
    rates = goals({"kind": "table", "goal": "rates"}, [1.0], {"t": t, "p": [0, 2], "q": [0, 0], "r": [1, 1]})[0]
    assert rates[0] == 3.0 and rates[RATES].tolist() == [1, 0, 1] and np.isnan(rates[THRUST])


def test_steps_of_attitude_and_rates_carry_a_thrust_or_the_weight():
    goal = goals({"kind": "attitude steps", "steps": [[0, 0, 0, 0], [1, 0.3, -0.2, 1.0, 5.5]]}, [0.5, 1.0])
    assert np.isnan(goal[0, THRUST]) and goal[1, THRUST] == 5.5
    assert goal[1, ANGLES].tolist() == [0.3, -0.2, 1.0]
    assert goals({"kind": "rate steps", "steps": [[0, 1, 2, 3]]}, [0.0])[0, RATES].tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"kind": "figure eigth"}, "did you mean 'figure eight'"),
        ({"kind": "figure eight", "amplitud": 1}, "did you mean 'amplitude'"),
        ({"kind": "figure eight", "amplitude": "big"}, "'amplitude' is 'big', expected a number"),
        ({"kind": "figure eight", "angular speed": 0}, "not 0"),
        ({"kind": "circle", "radius": 0}, "'radius' is 0, .*it means: m, above 0"),
        ({"kind": "circle", "heading": "north"}, "'heading' is 'north', .*rad, or 'along path'"),
        ({"kind": "circle", "centre": [0, 0, -2]}, "two numbers, m, north and east"),
        ({"kind": "figure eight", "do circle track": True}, "only one of"),
        ({"do position track": True, "do circle track": True}, "only one of"),
        ({"kind": "hover", "position": [0, 1]}, "three numbers"),
        ({"kind": "position steps", "steps": []}, "a list of rows"),
        ({"kind": "position steps", "steps": [[0, 0, 0, 0], [1, 2, 3]]}, "row 2 is"),
        ({"kind": "position steps", "steps": [[0, 0, 0, float("nan")]]}, "'steps' / entry 1 / entry 4 is nan"),
        ({"kind": "position steps", "steps": [[2, 0, 0, 0], [1, 0, 0, 0]]}, "row 2 is at 1 s"),
        ({"kind": "position steps", "steps": [[0, 0, 0, 0], [1, 0, 0, 0]], "transition": 3}, "transition of 3 s"),
        ({"kind": "position steps", "transition": -1}, "0 or more"),
        ({"kind": "table"}, "has no table"),
        ({"kind": "table", "end": "loop"}, "expected one of 'hold', 'repeat'"),
    ],
)
def test_wrong_settings_are_named(settings, told):
    with pytest.raises(ConfigError, match=told):
        make_reference(settings)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"z": None}, "lacks the column 'z'"),
        ({"t": [0.0, 1, 2, 2, 3]}, "from 2 to 2 s in row 4"),
        ({"y": [0.0, 1, np.nan, 2, 3]}, "column 'y', row 3"),
        ({"t": [0.0], "x": [1.0], "y": [1.0], "z": [1.0], "yaw": [0.0]}, "has 1 rows"),
    ],
)
def test_tables_that_cannot_be_followed_are_named(change, told):
    table = {name: values for name, values in {**SAMPLES, **change}.items() if values is not None}
    with pytest.raises(DataError, match=told):
        make_reference({"kind": "table"}, table)


def test_every_kind_can_be_made_from_its_defaults():
    for kind in schema("simulation")["$defs"]:
        table = SAMPLES if kind == "table" else None
        assert np.all(np.isfinite(np.delete(goals({"kind": kind}, [0.0, 3.3, 50.0], table), THRUST, axis=1)))


@pytest.mark.parametrize("interpolation", ["smooth", "steps"])
def test_a_table_that_tells_the_yaw_rate_alone_turns_by_it(interpolation):
    t = np.linspace(0.0, 2.0, 21)
    table = {"t": t, "x": 0 * t, "y": 0 * t, "z": 0 * t - 1, "yaw_rate": 0 * t + 0.8}
    goal = goals({"kind": "table", "interpolation": interpolation}, [0.55, 1.25], table)
    np.testing.assert_allclose(goal[:, 9], [0.44, 1.0], atol=1e-9)
    np.testing.assert_allclose(goal[:, TURN], 0.8)


def test_steps_that_should_begin_anew_are_refused():
    with pytest.raises(ConfigError, match='"repeat" goes with \'interpolation\' "smooth" alone'):
        goals({"kind": "table", "interpolation": "steps", "end": "repeat"}, [0.0], SAMPLES)
