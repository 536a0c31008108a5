"""Roll-outs with commands: the drive in the loop, floor, best wrong cause and polynomial, with intervals."""

import numpy as np
import pandas as pd
import pytest
from plain_plant import made_model

from quasi.gap.catalogue import catalogue
from quasi.gap.diagnosis import count_found
from quasi.gap.effect import Vehicle
from quasi.gap.flights.gathering import gather
from quasi.gap.levels.drive.fit import CONSTANTS
from quasi.gap.levels.rollouts import commanded, error_reduction, open_loop
from quasi.model.model import Model
from quasi.simulation.tools.replay import replay, to_euler_states

RATE, SECONDS, LAG = 200.0, 8.0, 0.03
HORIZONS = [0.2, 0.5]
WORDS = ("removed", "best_wrong_cause", "generic_polynomial")


@pytest.fixture(scope="module")
def model():
    return made_model(reaction=0.0, lag=LAG)


@pytest.fixture(scope="module")
def table(model):
    """A flight that the model flew by commanded speeds, which its rotors follow with their lag."""
    t = np.arange(round(RATE * SECONDS)) / RATE
    rng = np.random.default_rng(2)
    steps = np.repeat(rng.normal(0.0, 25.0, (round(SECONDS / 0.2), 1)), round(0.2 * RATE), axis=0)
    commands = 1500.0 + steps + 2.0 * np.sin(5.0 * t)[:, None] * np.array([1, -1, 1, -1])
    first = np.full((len(t), 4), 1500.0)
    x = replay(model, t, np.zeros((len(t), 12)), first, np.array([0]), t[-1] - 0.5 / RATE, commands)[0]
    names = ("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z")
    found = pd.DataFrame({"t": t[: len(x)], **dict(zip(names, to_euler_states(x).T))})
    for i in range(4):
        found[f"w{i + 1}"], found[f"w{i + 1}_CMD"] = x[:, 13 + i], commands[: len(x), i]
        found[f"w{i + 1}_dot"] = np.gradient(found[f"w{i + 1}"], found["t"])
    rows = model.predict_columns(found)
    return found.assign(**{a: rows[a] for a in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")}, valid=1.0)


def slower(model, lag):
    actuators = {"time constants": {"value": [lag] * 4, "unit": "s"}}
    return Model({**model.document, "actuators": actuators})


def pushed(model, force, axis="Fz"):
    """The model with a constant force more, N, downward where no other axis is given."""
    axes = {**model.document["axes"]}
    more = {**axes["Fz"]["terms"][0], "coefficient": force, "given": True}
    axes[axis] = {**axes[axis], "terms": [*axes[axis]["terms"], more]}
    return Model({**model.document, "axes": axes})


def evidence_of(model, table):
    about = {"mass": model.airframe.mass, "inertia": model.airframe.inertia}
    return gather("a", table, about, model.airframe, model, 100.0)


def constants(lag):
    return [lag, lag, 0.0, 0.0, 1.0, *[0.0] * 10]


def known(lag):
    return {"kind": "speeds", "values": constants(lag), "voltage": None}


def predicted(model, flight):
    return model.predict_columns(pd.DataFrame(flight.columns))[["Fx", "Fy", "Fz", "Mx", "My", "Mz"]].to_numpy()


def test_the_floor_knows_the_drive_that_the_other_flights_tell(model, table):
    lazy = slower(model, 0.09)
    held = [evidence_of(lazy, table)]
    yardsticks = error_reduction.Yardsticks(lambda f: f.residual, drive=known(LAG))
    rolled = error_reduction.score(lazy, lazy, {"a": table}, held, HORIZONS, yardsticks)
    rows = {(r["quantity"], r["horizon"]): r for r in rolled["fell"]["rollouts from commands"]}
    row = rows["velocity z", 0.5]
    assert row["before"] == row["after"] > 0.01
    assert row["noise_floor"] < 0.02 * row["before"] and row["removed"]["value"] == pytest.approx(0.0, abs=1e-9)
    # with measured speeds the lag plays no part, and nothing can be removed
    assert rolled["rms"]["before"]["rollouts"]["velocity z"]["0.5"] < 1e-3
    # a drive that the others tell worse than the model does is no floor
    worse = error_reduction.score(lazy, lazy, {"a": table}, held, HORIZONS, yardsticks._replace(drive=known(0.3)))
    found = worse["rms"]["noise_floor"]["rollouts from commands"]["velocity z"]["0.5"]
    assert found == pytest.approx(row["before"], rel=1e-6)


def test_every_quantity_and_horizon_has_floor_wrong_cause_and_polynomial_with_intervals(model, table):
    wrong = pushed(slower(model, 0.09), 0.05)
    extended, held = pushed(wrong, -0.04), [evidence_of(wrong, table)]
    yardsticks = error_reduction.Yardsticks(
        lambda f: f.measured - predicted(model, f),
        {"wind": pushed(wrong, -0.01)},
        lambda f: f.residual + np.array([0, 0, 0.02, 0, 0, 0]),
        known(LAG),
        {"motor_lag": slower(pushed(model, 0.05), 0.06), "command_delay": slower(pushed(model, 0.05), 0.12)},
    )
    rolled = error_reduction.score(wrong, extended, {"a": table}, held, HORIZONS, yardsticks)
    rows = rolled["fell"]["rollouts from commands"]
    names = [*open_loop.ERROR_UNITS, *open_loop.MOVED_BY.values()]
    assert [(r["quantity"], r["horizon"]) for r in rows] == [(q, h) for q in names for h in HORIZONS]
    for row in rows:
        assert 0.0 <= row["noise_floor"] <= row["after"] * 1.000001
        for word in WORDS:
            share = row[word]
            assert (share["value"] is None) == (row["removable"] <= 0.1)
            assert share["value"] is None or share["low"] <= share["value"] <= share["high"]
    best = next(r for r in rows if (r["quantity"], r["horizon"]) == ("velocity z", 0.5))
    # the push is four fifths gone; with measured speeds a fifth of it is the whole rest
    measured = next(r for r in rolled["fell"]["rollouts"] if (r["quantity"], r["horizon"]) == ("velocity z", 0.5))
    assert measured["removed"]["value"] == pytest.approx(1.0 - 0.2**2, abs=0.01)
    assert measured["best_wrong_cause"]["value"] == pytest.approx(1.0 - 0.8**2, abs=0.01)
    assert measured["generic_polynomial"]["value"] == pytest.approx(1.0 - 0.6**2, abs=0.02)
    assert best["removed"]["value"] > best["generic_polynomial"]["value"] > 0.0
    # a drive that is named asks for a polynomial with more terms, with commands alone
    larger = yardsticks._replace(commanded_polynomial=lambda f: f.residual + np.array([0, 0, 0.03, 0, 0, 0]))
    other = error_reduction.score(wrong, extended, {"a": table}, held, HORIZONS, larger)
    for line, gained in (("rollouts", False), ("rollouts from commands", True)):
        first, last = (r["rms"]["generic_polynomial"][line]["velocity z"]["0.5"] for r in (rolled, other))
        assert (last < 0.99 * first) == gained
    # with commands a cause of the drive may be the best wrong one; the worse of two is not
    assert rolled["wrong"] == {"rollouts": "wind", "rollouts with trim": "wind", "rollouts from commands": "motor_lag"}
    table_ = rolled["rollouts_gains"]
    assert set(table_["driven"]) == {"rollouts", "rollouts with trim", "rollouts from commands"}
    assert set(table_["model"]) == {"after", "best_wrong_cause", "generic_polynomial"} and len(table_) == 3 * 3 * 20
    one = table_.query(
        "driven == 'rollouts from commands' and quantity == 'velocity z' and horizon == 0.5 and model == 'after'"
    )
    told = one[["rms", "removed", "low", "high"]].to_numpy()[0]
    np.testing.assert_allclose(told, [best["after"], *best["removed"].values()])


def test_a_change_of_forces_moves_command_driven_windows_as_the_changed_model_does(model, table):
    wrong = pushed(model, 0.05)
    tracks = error_reduction.tracks_of([evidence_of(wrong, table)], {"a": table}, HORIZONS, [wrong])
    errors = error_reduction.simulated_errors(tracks, wrong, wrong, [open_loop.COMMANDED])
    better = error_reduction.moved_errors(
        tracks, errors, lambda f: f.residual, lambda f: f.measured - predicted(model, f)
    )
    assert np.abs(better[open_loop.COMMANDED][0]).max() < 0.02 * np.abs(errors[open_loop.COMMANDED][0]).max()


def test_windows_without_commands_all_along_are_left_to_measured_speeds(model, table):
    gone = table.assign(w2_CMD=table["w2_CMD"].where(~table["t"].between(3.0, 3.1)))
    track = error_reduction.tracks_of([evidence_of(model, gone)], {"a": gone}, HORIZONS, [model])[0]
    starts = track.course.flight.t[track.course.starts]
    expected = (starts + 0.5 < 3.0 - 1e-9) | (starts > 3.1 + 1e-9)
    np.testing.assert_array_equal(track.has_commands, expected)
    assert 0 < (~track.has_commands).sum() < 5
    line = "rollouts from commands"
    errors = error_reduction.simulated_errors([track], model, model, [line])
    found = error_reduction.end_table([track], errors[line], HORIZONS, line)
    assert len(found) == 2 * track.has_commands.sum() and found["velocity"].max() < 1e-3
    bare = gone.drop(columns=[f"w{i}_CMD" for i in range(1, 5)])
    alone = error_reduction.tracks_of([evidence_of(model, bare)], {"a": bare}, HORIZONS, [model])
    assert error_reduction.lines_of(alone) == error_reduction.SPEED_LINES


def test_learned_constants_make_speeds_of_commands(model, table):
    values = dict(
        zip(CONSTANTS, [0.02, 0.04, 0.005, 400.0, 3000.0, -500.0, 0.5, 0.01, 0.0, 0.0, -0.01, 0.4, 0.0, 0.0, 0.0])
    )
    about = {"kind": "shares", "values": list(values.values()), "voltage": 16.0}
    shares = table.assign(**{f"command{i}": 0.1 * i for i in range(1, 5)}, battery_voltage=14.0)
    found, rotors = commanded.learned(about, open_loop.flight_of("a", shares), model)
    expected = np.array([(400 + 300 * i - 5 * i**2) * (14 / 16) ** 0.5 for i in range(1, 5)]) * [1.01, 1, 1, 0.99]
    np.testing.assert_allclose(found[7], expected)
    own = np.exp([0.3, -0.1, -0.1, -0.1])  # the first rotor is slower, the mean of the logarithms stays
    np.testing.assert_allclose([rotors.up, rotors.down], [0.02 * own, 0.04 * own])
    assert rotors.delay == 0.005
    aged = Model({**model.document, "extensions": [{"id": "x", "actuators": {"telemetry delay": 0.004}}]})
    assert commanded.learned(about, open_loop.flight_of("a", shares), aged)[1].delay == pytest.approx(0.001)
    assert commanded.learned(about, open_loop.flight_of("a", table), model) is None


@pytest.mark.parametrize("quantity, name", [("velocity z", "motor_lag"), ("velocity y", "battery_sag")])
def test_with_commands_the_best_wrong_cause_is_the_best_in_what_the_named_ones_move(model, table, quantity, name):
    """One candidate mends the vertical motion, the other the sideward one."""
    wrong = pushed(pushed(model, 0.05), 0.05, "Fy")
    drives = {"motor_lag": pushed(model, 0.05, "Fy"), "battery_sag": pushed(model, 0.05)}
    yardsticks = error_reduction.Yardsticks(wrong_drives=drives, quantities=[quantity])
    held = [evidence_of(wrong, table)]
    assert error_reduction.score(wrong, wrong, {"a": table}, held, HORIZONS, yardsticks)["wrong"] == {
        "rollouts from commands": name
    }


def test_causes_of_the_drive_that_are_not_named_are_wrong_ones(model):
    vehicle = Vehicle(np.zeros((4, 3)), np.ones(4), 0.04, 1e-7, 1e-9, 0.43, np.diag([1e-3, 2e-3, 3e-3]), 9.7, 0.0, 0.0)
    healthy = {"alone": {"motor_lag": {"time_constant": 0.045}, "command_delay": {"delay": 0.004},
                         "telemetry_delay": {"delay": 0.01}}}  # fmt: skip
    found = commanded.wrong_ones(healthy, ["command_delay"], catalogue(), model, vehicle)
    assert list(found) == ["motor_lag"]  # late telemetry is no cause of the drive
    assert found["motor_lag"].document["extensions"][0]["actuators"] == {"time constant": pytest.approx(0.045)}
    assert commanded.wrong_ones({}, [], catalogue(), model, vehicle) == {}
    slow = commanded.wrong_ones({"alone": {"motor_lag": {"rotor2": 1.4}}}, [], catalogue(), model, vehicle)
    assert slow["motor_lag"].document["extensions"][0]["actuators"] == {"rotor2 lag factor": pytest.approx(1.4)}
    sagging = {"alone": {"battery_sag": {"exponent": 0.7, "reference voltage": 15.8}}}
    (found,) = commanded.wrong_ones(sagging, [], catalogue(), model, vehicle).values()
    drive = found.document["extensions"][0]["actuators"]
    assert drive == {"voltage exponent": pytest.approx(0.7), "reference voltage": 15.8}


def test_the_polynomial_has_a_term_for_each_parameter_that_was_found_of_the_drive():
    sizes = {"motor_lag": {"time_constant": 0.03, "rotor2": 1.0, "rotor4": -0.3}, "command_delay": {"delay": 0.004},
             "battery_sag": {"exponent": 0.5, "reference voltage": 15.0}}  # fmt: skip
    assert [count_found([(catalogue()[n], values)]) for n, values in sizes.items()] == [3, 1, 1]
