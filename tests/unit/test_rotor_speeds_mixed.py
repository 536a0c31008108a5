"""Flights with and without rotor speeds in one model: which map they get, what fixes its scale, how sure it is."""

import numpy as np
import pandas as pd
import pytest
from airframes import to_draw
from commanded_flights import EXPONENT, GAINS, MASS, OPERATING, SLOPE, flight

from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.identification.joint_fit import JointFit, prepare_flight
from quasi.identification.map_error import add_map_error
from quasi.identification.partition import TEST, TRAINING
from quasi.identification.rotor_speeds import _relative_error, identify_rotor_speeds, rotor_speeds_of
from quasi.terms.rotor_map import describe_map, lagged, speeds_of

ROWS = 1500
MASSES = dict.fromkeys(("a", "b", "m", "n"), MASS)
SHARE_COLUMNS = [f"command{i}_raw" for i in range(1, 5)]


def teacher(seed, valid=1.0, scale=1.0):
    """Commands and measured speeds of a linear map, 15 s at 100 Hz."""
    t, r = np.arange(ROWS) * 0.01, np.random.default_rng(seed)
    commands = 0.5 + 0.36 * lagged(r.standard_normal((ROWS, 4)), 0.01, 0.15, 0.0)
    volts = np.linspace(15.8, 14.2, ROWS)
    wanted = scale * 800.0 * GAINS * (volts[:, None] / 15.0) ** 0.8 * (1.0 + 0.7 * (commands / 0.5 - 1.0))
    speeds = lagged(wanted, 0.01, 0.045, 0.02) + r.normal(0.0, 4.0, (ROWS, 4))
    table = {"t": t, "battery_voltage": volts, "valid": valid + 0 * t, "in_flight": 1.0 + 0 * t}
    table |= {f"command{i + 1}": commands[:, i] for i in range(4)} | {f"w{i + 1}": speeds[:, i] for i in range(4)}
    return pd.DataFrame(table)


def silent(seed):
    """The same flight as a filter keeps it without speeds, and the speeds (N, 4)."""
    table = teacher(seed)
    speeds = table[[f"w{i}" for i in range(1, 5)]].to_numpy()
    kept = table.drop(columns=[f"w{i}" for i in range(1, 5)])
    return kept.rename(columns={f"command{i}": f"command{i}_raw" for i in range(1, 5)}), speeds


def with_commanded_speeds(table, speed=1000.0):
    """A made flight whose commands are a speed that its rotors reach."""
    volts = (table["battery_voltage"].to_numpy()[:, None] / 15.0) ** EXPONENT
    wanted = speed * volts * (1.0 + SLOPE * (table[SHARE_COLUMNS].to_numpy() / OPERATING - 1.0))
    return table.assign(**{f"w{i + 1}_CMD_raw": w for i, w in enumerate(wanted.T)})


def test_the_scatter_between_teaching_flights_counts_what_is_common_to_them():
    flights = {"m": teacher(1, scale=1.02), "n": teacher(2, scale=0.98), "a": silent(3)[0]}
    drive, _ = rotor_speeds_of(flights, to_draw(), MASSES, {})
    # eight deviations of 2 % about four means: four degrees of freedom
    assert drive["relative error"]["between flights"] == pytest.approx(0.02 * np.sqrt(8 / 4), rel=0.05)


def test_the_scatter_of_trims_counts_what_is_common_to_the_flights():
    flights = {k: with_commanded_speeds(flight(n, 12.0, hidden=0.004)) for k, n in (("a", 1), ("b", 2))}
    drive, _ = identify_rotor_speeds(flights, to_draw(), MASSES)
    logs = np.log([drive["trims"][k] for k in "ab"])
    assert drive["relative error"]["between flights"] == pytest.approx(np.sqrt(np.sum(logs**2) / 4), rel=1e-6)


def test_a_teaching_flight_without_a_valid_row_leaves_the_error_a_number():
    flights = {"m": teacher(1), "n": teacher(2, valid=0.0), "a": silent(3)[0]}
    drive, notes = rotor_speeds_of(flights, to_draw(), MASSES, {})
    assert drive["relative error"]["between flights"] is None and drive["flights"] == ["m"]
    assert 0.0 < drive["relative error"]["total"] < 0.02
    assert describe_map({"rotor speeds": drive}) and not any("nan" in note for note in notes)


def test_a_flight_without_voltage_is_not_estimated_by_a_map_that_needs_it():
    table, speeds = silent(3)
    table = table.drop(columns="battery_voltage")
    drive, notes = rotor_speeds_of({"m": teacher(1), "a": table}, to_draw(), MASSES, {})
    found = speeds_of(drive, table[SHARE_COLUMNS].to_numpy(), None, 0.01)
    off = np.sqrt(np.mean((found / speeds - 1.0)[50:] ** 2))
    assert drive["relative error"]["total"] == pytest.approx(off, rel=0.3)  # of 2.3 %
    assert any("flight a logs no battery voltage" in note for note in notes)


def test_flights_that_log_shares_and_commanded_speeds_are_taught_and_trained_with_those_that_log_shares():
    table, _ = silent(3)
    drive, _ = rotor_speeds_of({"m": teacher(1), "a": with_commanded_speeds(table)}, to_draw(), MASSES, {})
    assert drive["input"] == "share" and not drive["scale"]["relative"]
    both = {"a": with_commanded_speeds(flight(1, 12.0, hidden=0.004)), "b": flight(2, 12.0, hidden=0.004)}
    drive, _ = identify_rotor_speeds(both, to_draw(), MASSES)
    assert drive["input"] == "share"


def test_commanded_speeds_fix_the_scale_and_rows_at_their_limit_are_left_out():
    table = with_commanded_speeds(flight(1, 15.0, hidden=0.004))
    drive, notes = identify_rotor_speeds({"a": table}, to_draw(), MASSES)
    assert drive["input"] == "speed" and drive["scale"]["from"] == "commanded speeds"
    assert not drive["scale"]["relative"] and not any("relative" in note for note in notes)
    commanded = table[[f"w{i}_CMD_raw" for i in range(1, 5)]].to_numpy()
    speeds = speeds_of(drive, commanded, table["battery_voltage"].to_numpy(), 0.01)
    assert speeds.mean() == pytest.approx(commanded.mean(), rel=0.01)
    full = table.copy()
    full.loc[500:600, "command2_raw"] = 1.0
    _, notes = identify_rotor_speeds({"a": full}, to_draw(), MASSES)
    assert any("at its limit in 7 % of the rows" in note for note in notes)


def test_measured_speeds_of_flights_without_commands_fix_the_scale():
    t, hover = np.arange(ROWS) * 0.01, 1234.0
    measured = pd.DataFrame({"t": t, "az": 0 * t - GRAVITY} | {f"w{i}": hover + 0 * t for i in range(1, 5)})
    table = flight(1, 12.0, hidden=0.004)
    drive, notes = rotor_speeds_of({"m": measured, "a": table}, to_draw(), MASSES, {})
    assert drive["scale"]["thrust factor"]["value"] == pytest.approx(MASS * GRAVITY / (4.0 * hover**2))
    assert not drive["scale"]["relative"] and not any("relative" in note for note in notes)
    assert "speeds measured in other flights" in describe_map({"rotor speeds": drive})[1]
    assert drive["estimated flights"] == ["a"]


@pytest.mark.parametrize("taught", [True, False])
def test_flights_that_only_test_have_no_part_in_the_map(taught):
    made = {k: with_commanded_speeds(flight(n, 12.0, hidden=0.004)) for k, n in (("a", 1), ("b", 2))}
    if taught:
        made = {"a": teacher(1), "b": teacher(2), "n": silent(3)[0]}
    roles = {k: np.full(len(f), TEST if k == "b" else TRAINING, np.int8) for k, f in made.items()}
    drive, _ = rotor_speeds_of(made, to_draw(), MASSES, {}, roles)
    alone, _ = rotor_speeds_of({k: f for k, f in made.items() if k != "b"}, to_draw(), MASSES, {})
    assert drive["time constant"] == alone["time constant"] and drive["flights"] == ["a"]
    assert drive["relative error"] == alone["relative error"]


@pytest.mark.parametrize("taught", [True, False])
def test_a_rotor_whose_command_never_changes_is_refused_by_number(taught):
    table = silent(3)[0].assign(command3_raw=0.0)
    flights = {"m": teacher(1), "a": table} if taught else {"a": table}
    with pytest.raises(DataError, match="flight a: the command of rotor 3 is constant"):
        rotor_speeds_of(flights, to_draw(), MASSES, {})


def test_a_refusal_says_that_commands_were_at_their_limit():
    table = flight(1, 12.0, hidden=0.004)
    table[SHARE_COLUMNS] = np.minimum(1.9 * table[SHARE_COLUMNS], 1.0)
    with pytest.raises(DataError, match=r"s are needed; flight a: a command is at its limit"):
        identify_rotor_speeds({"a": table}, to_draw(), MASSES)


@pytest.mark.parametrize(("late", "ends"), [(0.06, True), (-0.13, True), (0.0, False)])
def test_commands_further_from_the_motion_than_any_rotor_are_a_note(late, ends):
    table = with_commanded_speeds(flight(1, 12.0, hidden=0.004))
    names = [f"w{i}_CMD_raw" for i in range(1, 5)]
    t = table["t"].to_numpy()
    table[names] = np.stack([np.interp(t - late, t, table[name]) for name in names], axis=1)
    drive, notes = identify_rotor_speeds({"a": table}, to_draw(), MASSES)
    assert any("the delay of the rotors lies at the end of its range" in note for note in notes) == ends
    assert (drive["factors"]["Mx"]["value"] < 0.9) == (late > 0.0)  # of a truth of 1


def test_the_error_of_speeds_is_no_other_where_a_value_meets_its_bound():
    table = flight(1, 12.0, hidden=0.004)
    made = [prepare_flight(table, np.ones(len(table), bool), to_draw(), MASS, "share", (OPERATING, 15.0))]
    fit = JointFit("linear", made, to_draw(), True)
    fit.run()
    free = _relative_error(fit)
    for k, ends in ((k, ends) for k in range(len(fit.x)) for ends in ("low", "high")):
        at = getattr(fit, ends).copy()
        getattr(fit, ends)[k] = fit.x[k]
        assert _relative_error(fit) == pytest.approx(free, rel=0.05), (fit.names[k], ends)
        setattr(fit, ends, at)


def drive_of(form, value, std):
    shape = next(iter(value))
    return {
        "input": "share", "form": form, "parameters": {shape: {"value": value[shape]}}, "operating command": 0.5,
        "reference voltage": None, "voltage exponent": None, "speeds": {"value": [800.0] * 4},
        "time constant": {"value": 0.04}, "delay": {"value": 0.01}, "estimated": ["time constant", "delay", shape],
        "covariance": np.diag([1e-6, 1e-6, std**2]).tolist(),
    }  # fmt: skip


def error_of(drive, terms, lost=0):
    """Covariance of an axis with the error of a map; of the first rows the induced velocity lacks."""
    commands = 0.5 + 0.1 * lagged(np.random.default_rng(3).standard_normal((2000, 4)), 0.01, 0.1, 0.0)
    induced = np.where(np.arange(2000) < lost, np.nan, 3.0 + 0.2 * np.sin(0.05 * np.arange(2000)))

    def table(drive):
        return {f"w{i + 1}": c for i, c in enumerate(speeds_of(drive, commands, None, 0.01).T)}

    target = -1e-7 * sum(w**2 for w in table(drive).values()) - 1e-4 * induced * sum(table(drive).values())

    def speeds(drive):
        return {"a": pd.DataFrame({**table(drive), "Fz": target, "v_in": induced})}

    listed = [{"expression": e, "coefficient": -1e-7, "std": 1e-12, "t": -1e5} for e in terms]
    roles = {"a": np.ones(2000, np.int8)}
    covariance, shares = np.zeros((len(terms),) * 2).tolist(), dict.fromkeys(roles, 0.0)
    result = {
        "terms": listed,
        "covariance": covariance,
        "share of flight means taken off": shares,
        "offsets of flights": shares,
    }
    return np.array(add_map_error(result, "Fz", drive, speeds, roles, to_draw(), None)["covariance"])


def test_map_errors_at_the_end_of_a_range_are_those_inside_it():
    squares = ["w2_1 + w2_2 + w2_3 + w2_4"]
    wide, narrow = (error_of(drive_of("thrust map", {"saturation": 0.97}, s), squares)[0, 0] for s in (0.1, 0.001))
    assert np.isfinite(wide) and 1.0 < wide / narrow < 1e6


def test_map_errors_leave_out_the_rows_that_the_fit_leaves_out():
    terms = ["w2_1 + w2_2 + w2_3 + w2_4", "v_in*w_tot"]
    some, every = (error_of(drive_of("linear", {"slope": 0.7}, 0.01), terms, lost) for lost in (20, 0))
    np.testing.assert_allclose(some, every, rtol=0.2)
    assert np.all(np.diag(some) > 0.0)
