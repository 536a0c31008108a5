"""Where residuals of all levels live: places of a flight, bins along them, windows by the place where they begin."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from test_actuation import FRAME, MODEL
from test_actuation import flown as driven
from test_gap_extension import base_of, flight
from test_kinematic import flown as sensed

from quasi.attitude import AIR_DENSITY, GRAVITY
from quasi.gap.flights.level import Flown
from quasi.gap.flights.residual_tables import FAR_LAG, LEAST_BIN_ROWS, places_at, where, whiteness
from quasi.gap.levels.drive import identify as drive_level
from quasi.gap.levels.forces.tables import _merged, _spectrum, wrench_tables
from quasi.gap.levels.rollouts.covariates import UNIT_OF, channels_of, placed, where_of
from quasi.gap.levels.sensors import identify as sensor_level
from quasi.gap.levels.sensors_and_drive import units_of
from quasi.model.model import AXES

N = 400
T = np.arange(N) / 100.0


def frame():
    """A vehicle that sinks at 2 m/s, turned upside down, and passes the south."""
    columns = {"t": T, "u": 0.0 * T, "v": 0.0 * T, "w": -2.0 + 0.0 * T, "roll": np.pi + 0.0 * T, "pitch": 0.0 * T}
    columns |= {"yaw": np.angle(np.exp(1j * (np.pi - 1.0 + 0.5 * T))), "x": 0.3 * T, "y": -0.2 * T, "z": -8.0 + 2.0 * T}
    columns |= {f"w{i}": 1000.0 + 100.0 * i + 0.0 * T for i in range(1, 5)} | {"battery_voltage": 16.0 - 0.1 * T}
    return pd.DataFrame(columns)


def test_a_flight_tells_all_places_that_it_knows():
    flight = Flown("a", True, frame()[["t", "z"]], {}, frame(), {}, FRAME)
    at = np.array([0.505, 2.003])
    found = places_at(flight, at)
    induced = np.sqrt(FRAME.mass * GRAVITY / (2.0 * AIR_DENSITY * 4.0 * np.pi * FRAME.radius**2))
    for name, value in {
        "speed": 2.0, "height": 8.0 - 2.0 * at, "heading": [np.pi - 0.7475, 0.0015 - np.pi], "room_x": 0.3 * at,
        "room_y": -0.2 * at, "volts": 16.0 - 0.1 * at, "rotor_speed": 1250.0, "descent_ratio": 2.0 / induced,
    }.items():  # fmt: skip
        np.testing.assert_allclose(found.pop(name), np.broadcast_to(value, 2), atol=1e-4, err_msg=name)
    assert not found
    assert set(places_at(Flown("a", True, frame()[["t", "z"]], {}, frame()[["t"]], {}, FRAME), at)) == {"height"}


def test_bins_show_where_an_error_lives_and_hold_enough_rows():
    near = T < 0.5
    table = pd.DataFrame({"height": T, "Fz_before": np.where(near, -0.3, 0.0), "Fz_after": 0.1, "speed": np.nan})
    found = where(table, {"Fz": "N"}, ("before", "after"))
    assert len(found) == 8 and set(found["where"]) == {"height"} and set(found["where_unit"]) == {"m"}
    first, rest = found.iloc[0], found.iloc[1:]
    assert first["mean_before"] == pytest.approx(-0.3) and first["rms_before"] == pytest.approx(0.3)
    assert first["middle"] < 0.5 and rest["mean_before"].abs().max() < 0.02
    np.testing.assert_allclose(found["mean_after"], 0.1)
    few = where(table.iloc[::8], {"Fz": "N"}, ("before", "after"))
    assert len(few) == 2 and (few["rows"] >= LEAST_BIN_ROWS).all()
    assert not len(where(table.iloc[: LEAST_BIN_ROWS - 1], {"Fz": "N"}, ("before", "after")))


def test_levels_of_sensors_and_drive_tell_where_their_errors_live():
    sensors = sensor_level.examine([sensed(s) for s in (1, 2, 3)], {}).tables
    assert set(sensors["where"]["where"]) == {"t", "height", "heading", "room_x", "room_y"}
    assert set(sensors["where"]["channel"]) == {"p", "q", "r", "north", "east", "down"}
    slow = [driven(s, up=0.04, down=0.045) for s in (1, 2)]
    tables = drive_level.examine([driven(3, compared=False), *slow], MODEL, {}).tables
    found, rows = tables["where"], tables["residuals"]
    assert {"rotor_speed", "volts"} <= set(rows) and set(found["where"]) == {"t", "rotor_speed", "volts"}
    one = found.query("channel == 'w1' and where == 'volts'").iloc[0]
    rows = rows[
        (rows["flight"] != "f3") & rows["volts"].between(one["low"], one["high"])
    ]  # not of the reference flight
    assert one["rows"] == len(rows)
    assert one["rms_before"] == pytest.approx(np.sqrt(np.mean(rows["w1_before"] ** 2)))
    assert one["mean_floor"] == pytest.approx(rows["w1_floor"].mean())


def autoregressive(rate, memory, n=40000, seed=5):
    """An autoregression of first order whose correlation `memory` s later is exp(-1), by its own recursion."""
    keep, draw = np.exp(-1.0 / (memory * rate)), np.random.default_rng(seed).standard_normal(n)
    values = np.empty(n)
    values[0] = draw[0] / np.sqrt(1.0 - keep**2)
    for k in range(1, n):
        values[k] = keep * values[k - 1] + draw[k]
    return values


def one_break(n):
    return np.arange(n) == 0


@pytest.mark.parametrize("rate", [20.0, 100.0, 125.0])
def test_whiteness_is_the_correlation_of_the_residual_with_itself_at_any_rate(rate):
    slow, n = autoregressive(rate, 0.5), 40000
    noise = np.random.default_rng(6).standard_normal(n)
    t = np.arange(n) / rate
    series = {"before": np.column_stack([7.0 + slow, noise]), "floor": np.column_stack([noise, 0.0 * noise])}
    first, second = whiteness(series, t, one_break(n))
    assert first["whiteness_before"] == pytest.approx(np.exp(-FAR_LAG / 0.5), abs=0.05)
    assert first["whiteness_floor"] == second["whiteness_before"] == pytest.approx(0.0, abs=0.03)
    assert np.isnan(second["whiteness_floor"])


def test_whiteness_reaches_over_no_break():
    """Each stretch is one number: places_at its neighbours it is at random, within itself it stays."""
    length, n = 60, 6000  # rows of 0.01 s: a stretch of 0.6 s
    levels = np.repeat(np.random.default_rng(7).standard_normal(n // length), length)[:, None]
    t, starts = np.arange(n) / 100.0, np.arange(n) % length == 0
    (inside,) = whiteness({"before": levels}, t, starts)
    (across,) = whiteness({"before": levels}, t, one_break(n))
    assert inside["whiteness_before"] == pytest.approx(1.0) and across["whiteness_before"] < 0.5
    (short,) = whiteness({"before": levels}, t, np.arange(n) % 40 == 0)
    assert np.isnan(short["whiteness_before"])


def test_every_level_tells_the_whiteness_of_its_own_rows():
    """By numpy's own correlation of the rows of the tables."""
    base = base_of("withGravity")
    evidence, truth = flight(base)
    slow = autoregressive(100.0, 0.5, len(truth))
    wrench = wrench_tables(
        {"a": replace(evidence, measured=truth + 0.01 * slow[:, None])}, {"a": "compared"},
        lambda one: 0.5 * one.residual,
    )  # fmt: skip
    levels = [sensor_level.examine([sensed(1, gyro_bias=(0.02, 0.0, 0.0)), sensed(2)], {}).tables,
              drive_level.examine([driven(1, up=0.04), driven(2, up=0.04)], MODEL, {}).tables,
              {"channels": wrench["forces_channels"], "residuals": wrench["forces_residuals"]}]  # fmt: skip
    for tables in levels:
        for _, row in tables["channels"].iterrows():
            rows = tables["residuals"].query(f"flight == {row['flight']!r}")
            step = round(FAR_LAG / np.median(np.diff(rows["t"])))
            for word in ("before", "after", "floor"):
                if f"whiteness_{word}" in row:
                    x = rows[f"{row['channel']}_{word}"].to_numpy()
                    expected = np.corrcoef(x[step:], x[:-step])[0, 1]
                    assert row[f"whiteness_{word}"] == pytest.approx(expected, abs=0.03)
    assert wrench["forces_channels"]["whiteness_before"].max() > 0.2


@pytest.fixture(name="errors")
def windows():
    """End errors of two models at 1 s; the first errs by 3 below 4 m and by 1 above, one of its windows diverged."""
    starts = T[::5]
    flight = SimpleNamespace(key="a", t=T, columns={n: c.to_numpy() for n, c in frame().items()}, hover_induced=5.0,
                             down=np.tile([0.0, 0.0, -1.0], (N, 1)))  # fmt: skip
    parts = []
    for model, low in (("before", 3.0), ("after", 1.0)):
        for horizon in (0.5, 1.0):
            size = np.where(8.0 - 2.0 * starts < 4.05, low, 1.0) * horizon
            size = np.where((model == "before") & (starts == starts[-1]), np.nan, size)
            parts.append(pd.DataFrame({"flight": "a", "start": starts, "horizon": horizon, "driven": "rollouts",
                                       "model": model, **dict.fromkeys(UNIT_OF, size)}))  # fmt: skip
    return placed(pd.concat(parts, ignore_index=True), [flight])


def test_windows_are_told_with_the_place_where_they_begin(errors):
    np.testing.assert_allclose(errors["height"], 8.0 - 2.0 * errors["start"])
    np.testing.assert_allclose(errors["descent_ratio"], 0.4)
    assert errors["model"].tolist() == sorted(errors["model"], reverse=True)  # rows stand as they stood


def test_end_errors_are_binned_by_line_and_horizon_along_these_places(errors):
    found = where_of(errors).query("channel == 'velocity x' and where == 'height' and horizon == 1.0")
    assert len(found) == 4 and found["rows"].sum() == 80 and set(found["unit"]) == {"m/s"}
    low = found["high"] < 4.1
    assert low.sum() == 2
    np.testing.assert_allclose(found.loc[low, "rms_before"], 3.0)  # the diverged one counts with the largest finite one
    np.testing.assert_allclose(found.loc[~low, "mean_before"], 1.0)
    np.testing.assert_allclose(found["rms_after"], 1.0)
    halves = where_of(errors).query("channel == 'rate' and where == 'height' and horizon == 0.5")
    assert halves["rms_before"].max() == pytest.approx(1.5)


def test_new_columns_have_their_units(errors):
    units = units_of(errors)
    for name, unit in {"room_x": "m", "rotor_speed": "rad/s", "descent_ratio": "", "volts": "V", "velocity x": "m/s",
                       "rate z": "rad/s", "start": "s"}.items():  # fmt: skip
        assert units[name] == (unit, ""), name


@pytest.mark.parametrize("memory, expected", [("none", 0.0), ("overlap", 0.0), ("long", 1.0), ("opposite", -1.0)])
def test_errors_come_again_where_windows_that_do_not_overlap_are_alike(memory, expected):
    """Windows of 0.5 s begin every 0.2 s: the third next one is the first that shares nothing with a window."""
    rng, n = np.random.default_rng(3), 1200
    noise = rng.standard_normal((n + 2, 12))
    errors = {
        "none": noise[:n], "overlap": noise[:n] + noise[1:-1] + noise[2:],
        "long": np.sin(2e-2 * np.arange(n))[:, None] * np.ones(12),
        "opposite": np.sin(np.pi / 3.0 * np.arange(n) + 0.3)[:, None] * np.ones(12),
    }[memory][:, None]  # fmt: skip
    errors[700] = np.nan  # diverged
    flight = SimpleNamespace(key="a", t=np.arange(20 * n) / 100.0)
    table = channels_of(flight, 20 * np.arange(n), [0.5], {"before": errors}, "rollouts").set_index("channel")
    assert len(table) == 10 and table["unit"]["rate x"] == "rad/s" and table["unit"]["velocity x"] == "m/s"
    np.testing.assert_allclose(table["whiteness_before"], expected, atol=0.1)
    known = errors[np.isfinite(errors).all(axis=(1, 2))][:, 0]
    assert table["before"]["velocity z"] == pytest.approx(np.sqrt(np.mean(known[:, 2] ** 2)), rel=0.02)


def test_too_few_windows_tell_nothing_of_the_next():
    flight = SimpleNamespace(key="a", t=np.arange(200) / 100.0)
    table = channels_of(flight, 20 * np.arange(9), [0.5], {"before": np.ones((9, 1, 12))}, "rollouts")
    assert table["whiteness_before"].isna().all() and np.allclose(table["before"][table["channel"] == "rate z"], 1.0)


def test_spectra_of_flights_of_several_rates_are_averaged_where_both_tell_them():
    """White noise of unit variance per hertz: the one-sided density is 2 / rate times the variance at every rate."""
    rng = np.random.default_rng(4)
    found = {(role, word): [] for role in ("compared",) for word in ("before", "after")}
    for rate, seconds in ((100.0, 200.0), (125.0, 200.0)):
        t = np.arange(round(rate * seconds)) / rate
        flight = SimpleNamespace(t=t, breaks=np.arange(len(t)) == 0)
        for word, size in (("before", 1.0), ("after", 0.5)):
            values = size * np.sqrt(rate / 2.0) * rng.standard_normal((len(t), 6))
            _spectrum(flight, values, found["compared", word])
    table = _merged(found)
    assert set(table["channel"]) == set(AXES) and table["frequency"].max() > 5.0
    inside = table[table["frequency"] > 0.5]  # the mean of each segment is taken off
    assert inside["density_before"].mean() == pytest.approx(1.0, rel=0.05)
    assert inside["density_after"].mean() == pytest.approx(0.25, rel=0.05)
    assert _merged({("compared", "before"): [], ("compared", "after"): []}).empty
