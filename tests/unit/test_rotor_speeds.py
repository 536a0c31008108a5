"""Rotor speeds from commands: the map, lag and factors of made flights are found again; bad commands are refused."""

import copy
import dataclasses
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from airframes import LAYOUT, to_draw
from commanded_flights import DELAY, EXPONENT, GAINS, MASS, OPERATING, SLOPE, TAU, WARMING, flight
from made_model import document

from quasi.airframe import read_airframe
from quasi.attitude import GRAVITY
from quasi.errors import ConfigError, DataError, ShapeError, cautions
from quasi.filtering.rotor_speeds import add_estimated_speeds, trim_of
from quasi.identification.flight_scatter import factor_error, variance_between
from quasi.identification.geometry import contradicting_places
from quasi.identification.joint_fit import JointFit, prepare_flight
from quasi.identification.map_error import add_map_error
from quasi.identification.rotor_rows import rows_in_free_air
from quasi.identification.rotor_speeds import (
    CANDIDATES,
    actuators_of,
    factors_of,
    identify_rotor_speeds,
    places_of,
    rotor_speeds_of,
)
from quasi.identification.taught_map import teach_map
from quasi.importing.command_units import recognise_unit, scale_commands
from quasi.model.model import Model
from quasi.sensor_limits import find_missing_sources, find_silent_rotors
from quasi.terms import rotor_map
from quasi.terms.rotor_map import FORMS, delayed, drive_of_map, lagged, shape, speeds_of, steady_speeds, used_rows

MASSES = {"a": MASS, "b": MASS}


@pytest.fixture(scope="module")
def flights():
    return {"a": flight(1, 12.0, hidden=0.004), "b": flight(2, 12.0, hidden=0.004)}


@pytest.fixture(scope="module")
def found(flights):
    return identify_rotor_speeds(flights, to_draw(), MASSES)


def test_map_lag_delay_and_voltage_exponent_are_found(found):
    drive, _ = found
    assert drive["form"] in ("linear", "quadratic")
    lag, late = drive["time constant"]["value"], drive["delay"]["value"]
    assert lag == pytest.approx(TAU, rel=0.15)
    # commands between two samples of the log are unknown, so that delay and lag trade off within half a sample
    assert late == pytest.approx(DELAY, abs=0.006)
    assert lag + late == pytest.approx(TAU + DELAY, rel=0.15)
    # speed over speed at the operating point, against the true map
    commands = np.linspace(0.3, 0.7, 9)[:, None].repeat(4, axis=1)
    for volts in (14.5, 15.5):
        speeds = steady_speeds(drive, commands, np.full(9, volts))
        true = GAINS * (volts / 15.0) ** EXPONENT * (1.0 + SLOPE * (commands / OPERATING - 1.0))
        ratio = speeds / true
        np.testing.assert_allclose(ratio / ratio.mean(), 1.0, atol=0.03)
    assert drive["trims"].keys() == {"a", "b"}


def test_motors_that_warm_up_are_found_and_others_are_not_taken_for_it(found):
    assert found[0]["warm-up drop"] is None and found[0]["warm-up time constant"] is None
    flights = {k: flight(n, 25.0, hidden=0.004, cold=0.06) for k, n in (("a", 1), ("b", 2))}
    drive, notes = identify_rotor_speeds(flights, to_draw(), MASSES)
    drop, warming = drive["warm-up drop"], drive["warm-up time constant"]
    assert drop["value"] == pytest.approx(0.06, abs=max(3 * drop["std"], 0.01)) and drop["std"] < 0.02
    assert warming["value"] == pytest.approx(WARMING, abs=max(3 * warming["std"], 2.0)) and warming["std"] < 4.0
    assert drive["voltage exponent"]["value"] == pytest.approx(EXPONENT, abs=0.15)
    assert any("warm up" in n for n in notes)
    commands = np.full((5000, 4), OPERATING)
    commands[0] = 0.0
    speeds = speeds_of(drive, commands, np.full(5000, 15.0), 0.01)
    assert speeds[50, 0] / speeds[-1, 0] == pytest.approx(1.0 + drop["value"], abs=0.01)


def test_yaw_torque_behind_another_lag_than_thrust(found):
    assert found[0]["yaw"] is None
    flights = {k: flight(n, 15.0, hidden=0.004, tau_yaw=0.07) for k, n in (("a", 1), ("b", 2))}
    drive, _ = identify_rotor_speeds(flights, to_draw(), MASSES)
    assert drive["time constant"]["value"] == pytest.approx(TAU, rel=0.2)
    own = drive["yaw"]
    together = own["time constant"]["value"] + own["delay"]["value"]
    assert together == pytest.approx(0.07 + DELAY, rel=0.15)
    assert drive["factors"]["Mz"]["value"] == pytest.approx(0.02, rel=0.1)


def test_factors_hold_in_closed_loop(found):
    drive, _ = found
    assert drive["factors"]["Mx"]["value"] == pytest.approx(1.0, abs=0.1)
    assert drive["factors"]["My"]["value"] == pytest.approx(1.0, abs=0.1)
    assert drive["factors"]["Mz"]["value"] == pytest.approx(0.02, rel=0.1)
    assert contradicting_places(places_of(drive), to_draw(), 1.0) == []


def test_errors_of_factors_hold_the_scatter_between_flights():
    airframe = to_draw()
    wide = dataclasses.replace(airframe, inertia=1.4 * np.asarray(airframe.inertia))
    made = [flight(n, 20.0, hidden=0.004) for n in (1, 2, 3)]
    point = OPERATING, 15.0

    def fit_of(frames):
        flights = [
            prepare_flight(f, np.ones(len(f), bool), frame, MASS, "share", point) for f, frame in zip(made, frames)
        ]
        fit = JointFit("linear", flights, airframe, True)
        fit.run()
        return fit

    alike, unlike = fit_of([airframe] * 3), fit_of([airframe, airframe, wide])
    for axis in ("Mx", "My"):
        plain = alike.errors[axis][0]
        std, between = factor_error(alike, axis, plain)
        assert plain <= std < 0.1 and between < 0.1
        # one flight of three at 1.4: the std of (1, 1, 1.4) is 0.23, that of their mean 0.13
        std, between = factor_error(unlike, axis, unlike.errors[axis][0])
        assert 0.15 < between < 0.35 and 0.09 < std < 0.21
    lonely = copy.copy(alike)
    lonely.flights = alike.flights[:1]
    assert factor_error(lonely, "Mx", 0.02) == (0.02, None)


@pytest.mark.parametrize("bound", [0, 1])
def test_errors_are_no_others_where_a_value_meets_its_bound(monkeypatch, bound):
    """Differences that a bound cuts short are taken over what is left of them: the delay by itself, at either bound."""
    airframe, point = to_draw(), (OPERATING, 15.0)
    frame = flight(1, 15.0, hidden=0.004)
    flights = [prepare_flight(frame, np.ones(len(frame), bool), airframe, MASS, "share", point)]

    def errors():
        fit = JointFit("linear", flights, airframe, True)
        fit.x = np.clip(fit.x, fit.low, fit.high)
        fit.run()
        return fit.x[1], np.sqrt(fit.covariance[1, 1]), fit.errors["Mx"][0]

    late, std, factor = errors()
    ends = list(rotor_map.DELAY_RANGE)
    ends[bound] = late
    monkeypatch.setitem(rotor_map._VALUE_RANGES, "delay", tuple(ends))
    at, near, of_factor = errors()
    assert at == pytest.approx(late, abs=1e-3)
    assert near == pytest.approx(std, rel=0.2) and of_factor == pytest.approx(factor, rel=0.2)


def test_errors_of_rotor_places_hold_the_error_that_is_common_to_all_rotors(found):
    drive, _ = found
    for axis, places in drive["geometry"].items():
        common = drive["factors"][axis]["std"] / drive["factors"][axis]["value"]
        assert np.all(np.array(places["std"]) > common * np.abs(places["value"]))


def test_variance_between_flights_is_that_of_what_their_errors_leave():
    r = np.random.default_rng(3)
    draws = [variance_between(r.normal(0, np.sqrt(0.2**2 + 0.1**2), 8), np.full(8, 0.01)) for _ in range(2000)]
    assert np.mean(draws) == pytest.approx(0.04, rel=0.1)
    none = [variance_between(r.normal(0, 0.1, 8), np.full(8, 0.01)) for _ in range(2000)]
    assert np.mean(none) < 0.004 and min(none) == 0.0


def test_scale_is_relative_until_something_fixes_it(flights, found):
    drive, notes = found
    assert drive["scale"]["relative"] and any("relative" in n for n in notes)
    hover = {"hover speed": 1234.0}
    known, notes = identify_rotor_speeds(flights, to_draw(), MASSES, hover)
    assert not known["scale"]["relative"] and not any("relative" in n for n in notes)
    assert known["scale"]["thrust factor"]["value"] == pytest.approx(MASS * GRAVITY / 4 / 1234.0**2)
    # the map alone changes its unit
    ratio = np.array(known["speeds"]["value"]) / drive["speeds"]["value"]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)
    simple = factors_of(known, to_draw())
    arm = np.abs(to_draw().hubs[0, 1])
    assert simple["kappaMx"]["value"] / simple["kappaFz"]["value"] == pytest.approx(arm, rel=0.1)
    assert simple["kappaMz"]["value"] / simple["kappaFz"]["value"] == pytest.approx(-0.02, rel=0.1)
    assert actuators_of(known)["time constants"]["value"] == [known["time constant"]["value"]] * 4


def test_commands_logged_late_shorten_the_delay(found):
    flights = {"a": flight(1, 12.0, late=0.010)}
    drive, _ = identify_rotor_speeds(flights, to_draw(), MASSES)
    assert drive["delay"]["value"] == pytest.approx(found[0]["delay"]["value"] - 0.010, abs=0.004)


def test_rotors_numbered_otherwise_are_named(flights):
    swapped = {**LAYOUT, "rotor config": {"front left": 1, "front right": 3, "aft right": 4, "aft left": 2}}
    plain = {"rotor radius": 0.04, "b": 0.08, "moment of inertia": "[1e-3, 0, 0; 0, 1e-3, 0; 0, 0, 2e-3]"}
    wrong = read_airframe({**swapped, **plain, "rotor1 rotation direction": "CW"}, "wrong.json")
    drive, _ = identify_rotor_speeds({"a": flights["a"]}, wrong, MASSES)
    said = contradicting_places(places_of(drive), wrong, 1.0)
    assert any("rotor 1 pushes" in s for s in said)


def test_without_voltage_the_map_has_none_and_says_so(flights):
    table = flights["a"].drop(columns="battery_voltage")
    drive, notes = identify_rotor_speeds({"a": table}, to_draw(), MASSES)
    assert drive["voltage exponent"] is None and drive["reference voltage"] is None
    assert any("no battery voltage" in n for n in notes)


@pytest.mark.parametrize(("sag", "exponent"), [(0.45, EXPONENT), (0.0, None)])
def test_a_voltage_that_varies_little_counts_where_the_thrust_shows_it(sag, exponent):
    flights = {k: flight(n, 25.0, sag=sag) for k, n in (("a", 1), ("b", 2))}
    assert np.std(flights["a"]["battery_voltage"]) < 0.01 * 15.0
    drive, notes = identify_rotor_speeds(flights, to_draw(), MASSES)
    if exponent is None:
        assert drive["voltage exponent"] is None and any("never varies" in n for n in notes)
    else:
        assert drive["voltage exponent"]["value"] == pytest.approx(exponent, abs=0.15)


def test_noise_of_a_steady_voltage_makes_no_exponent():
    table = flight(1, 25.0, sag=0.0)
    table["battery_voltage"] += 0.01 * np.random.default_rng(0).standard_normal(len(table))
    drive, notes = identify_rotor_speeds({"a": table}, to_draw(), MASSES)
    assert drive["voltage exponent"] is None and drive["reference voltage"] is None
    assert any("hardly varies" in n for n in notes)


def test_take_off_and_landing_near_the_floor_do_not_bend_the_map(flights):
    frame, near = to_draw(), {}
    for key, table in flights.items():
        # the first and the last second next to the floor, where a fifth more thrust lets commands fall
        t, rest = table["t"].to_numpy(), table.iloc[:20].assign(in_flight=0.0, valid=0.0)
        low = (t < 1.0) | (t > t[-1] - 1.0)
        lowered = {f"command{i}_raw": np.where(low, 0.85, 1.0) * table[f"command{i}_raw"] for i in range(1, 5)}
        flown = table.assign(z=np.where(low, -0.5, -10.0) * frame.radius, **lowered)
        made = pd.concat([rest.assign(z=0.0), flown, rest.assign(z=0.0)], ignore_index=True)
        near[key] = made.assign(t=np.arange(len(made)) * 0.01)
    rows = rows_in_free_air(near, {k: used_rows(f) for k, f in near.items()}, frame)
    for key, table in near.items():
        np.testing.assert_array_equal(rows[key], used_rows(table) & (table["z"] < -frame.radius))
    drive, _ = identify_rotor_speeds(near, frame, MASSES)
    for axis in ("Mx", "My"):
        assert drive["factors"][axis]["value"] == pytest.approx(1.0, abs=0.1)
    # a flight that stays low keeps its rows
    low = {"a": near["a"].assign(z=-0.5 * frame.radius * (near["a"]["in_flight"] > 0.5))}
    used = {"a": used_rows(low["a"])}
    np.testing.assert_array_equal(rows_in_free_air(low, used, frame)["a"], used["a"])


def test_flights_that_are_too_short_are_refused(flights):
    with pytest.raises(DataError, match=r"hold 3\.\d s"):
        identify_rotor_speeds({"a": flights["a"].iloc[:400]}, to_draw(), MASSES)


def test_both_scales_at_once_are_refused(flights):
    both = {"hover speed": 1000, "thrust factor": "1e-7"}
    with pytest.raises(DataError, match="hover speed and thrust factor"):
        rotor_speeds_of(flights, to_draw(), MASSES, both)


def test_a_drive_is_plain_data(found):
    drive = json.loads(json.dumps(found[0]))
    commands = np.full((50, 4), 0.5)
    speeds = speeds_of(drive, commands, np.full(50, 15.0), 0.01)
    np.testing.assert_allclose(speeds, steady_speeds(drive, commands, np.full(50, 15.0)), rtol=1e-12)


@pytest.mark.parametrize("form", FORMS)
def test_every_form_is_one_at_its_operating_point_and_never_falls(form):
    parameters = FORMS[form].start
    share = np.linspace(0.0, 1.6, 60)[:, None]
    values = shape(form, share, 1.0, 0.7, parameters)
    assert shape(form, np.ones((1, 1)), 1.0, 0.7, parameters)[0, 0] == pytest.approx(1.0)
    assert np.all(np.diff(values[:, 0]) >= 0.0)


def test_lag_and_delay_of_a_sine():
    dt, rate, tau, delay = 0.005, 2.0 * np.pi * 2.0, 0.05, 0.013
    t = np.arange(2000) * dt
    got = lagged(np.sin(rate * t)[:, None], dt, tau, delay)[400:, 0]
    size, phase = 1 / np.hypot(1.0, rate * tau), np.arctan(rate * tau)
    np.testing.assert_allclose(got, (size * np.sin(rate * (t - delay) - phase))[400:], atol=2e-3)
    early = delayed(np.sin(rate * t)[:, None], dt, -0.0075)[10:-10, 0]
    np.testing.assert_allclose(early, np.sin(rate * (t + 0.0075))[10:-10], atol=1e-5)


@pytest.fixture(scope="module")
def driven(found):
    return Model({**document(), "rotor speeds": json.loads(json.dumps(found[0]))})


def test_a_model_predicts_from_commands_what_it_predicts_from_their_speeds(driven, found):
    t = np.arange(300) * 0.01
    commands = 0.5 + 0.1 * np.sin(2.0 * np.pi * 1.5 * t)[:, None] * np.array([1, -1, 1, -1])
    volts, state = np.linspace(15.5, 14.5, 300), np.zeros((300, 12))
    forces, moments = driven.predict_from_commands(t, state, commands, volts)
    speeds = speeds_of(found[0], commands, volts, 0.01)
    slopes = np.gradient(speeds, 0.01, axis=0)
    expected = driven.predict(state, speeds, slopes)
    np.testing.assert_allclose(forces, expected[0], rtol=1e-9)
    np.testing.assert_allclose(moments[20:-20], expected[1][20:-20], atol=0.02 * np.abs(expected[1]).max())
    with pytest.raises(ShapeError, match="evenly spaced"):
        driven.predict_from_commands(t**2, state, commands, volts)
    with pytest.raises(DataError, match="finite"):
        driven.predict_from_commands(t, state, commands * np.nan, volts)
    with pytest.raises(ConfigError, match="no map from commands"):
        Model(document()).predict_from_commands(t, state, commands, volts)


def test_a_map_on_measured_speeds_predicts_from_commands_too():
    mapped = {"coefficients": [200.0, 3000.0, -400.0], "powers": [0, 1, 2], "voltage exponent": {"value": 0.9},
              "reference voltage": 15.0}  # fmt: skip
    four = {"value": [0.03] * 4}
    model = Model({**document(), "actuators": {"command map": mapped, "time constants": four, "delay": four}})
    held = steady_speeds(drive_of_map(model.document["actuators"]), np.full((1, 4), 0.4), np.array([14.0]))
    np.testing.assert_allclose(held, (14.0 / 15.0) ** 0.9 * (200.0 + 3000.0 * 0.4 - 400.0 * 0.16), rtol=1e-12)


def test_the_error_of_estimated_speeds_widens_intervals(driven):
    names = ("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r")
    rows = {**{n: np.zeros(5) for n in names}, **{f"w{i}": np.full(5, 900.0) for i in range(1, 5)}}
    rows |= {f"w{i}_dot": np.zeros(5) for i in range(1, 5)}
    plain, own = Model(document()).interval(rows), driven.interval(rows)
    scattered = driven.interval(rows, trimmed=False)
    width = [(b["Fz_upper"] - b["Fz_lower"]).iloc[0] for b in (plain, own, scattered)]
    assert width[0] < width[1] < width[2]
    # by hand: dFz/dw_i = 2 c w + d, four rotors with independent errors
    slope = 2.0 * -1.3e-6 * 900.0 + 1e-4
    error = driven.document["rotor speeds"]["relative error"]["map"]
    added = 4.0 * (slope * 900.0 * error) ** 2
    share = (width[1] / width[0]) ** 2
    part = document()["axes"]["Fz"]
    a = np.array([4.0 * 900.0**2, 4.0 * (900.0 - driven.hover_speed), 0.0])
    variance = part["sigma2"] + a @ np.array(part["covariance"]) @ a
    assert share == pytest.approx(1.0 + added / variance, rel=1e-6)


def test_map_errors_enter_the_covariance_of_coefficients(found):
    drive = found[0]
    r = np.random.default_rng(3)
    commands, volts = 0.5 + 0.1 * lagged(r.standard_normal((2000, 4)), 0.01, 0.1, 0.0), np.full(2000, 15.0)

    def speeds(drive):
        table = {f"w{i + 1}": c for i, c in enumerate(speeds_of(drive, commands, volts, 0.01).T)}
        return {"a": pd.DataFrame({**table, "Fz": target})}

    target = -1e-7 * np.sum(speeds_of(drive, commands, volts, 0.01) ** 2, axis=1)
    term = {"expression": "w2_1 + w2_2 + w2_3 + w2_4", "coefficient": -1e-7, "std": 1e-12, "t": -1e5}
    result = {
        "terms": [term],
        "covariance": [[1e-24]],
        "notes": [],
        "share of flight means taken off": {"a": 0.0},
        "offsets of flights": {"a": 0.0},
    }
    made = add_map_error(result, "Fz", drive, speeds, {"a": np.ones(2000, np.int8)}, to_draw(), None)
    assert made["covariance"][0][0] > 1e-24
    assert made["terms"][0]["std"] == pytest.approx(np.sqrt(made["covariance"][0][0]))


@pytest.mark.parametrize(
    ("unit", "scale"),
    [
        ("1", lambda c: c),
        ("%", lambda c: 100 * c),
        ("1000..2000", lambda c: 1000 + 1000 * c),
        ("1/65535", lambda c: 65535 * c),
    ],
)
def test_units_of_commands_are_recognised(unit, scale):
    shares = np.clip(np.random.default_rng(0).normal(0.55, 0.15, 4000), 0.02, 0.98)
    assert recognise_unit(scale(shares), "a.csv") == unit
    notes = []
    made = scale_commands({"command1": scale(shares)}, {"command1": None}, Path("a.csv"), notes)
    np.testing.assert_allclose(made["command1"], shares, atol=1e-12)
    assert any(unit in n for n in notes) == (unit != "1")


def test_commands_in_a_strange_range_are_refused_and_overshoot_is_counted():
    with pytest.raises(DataError, match=r"to 9\.91e\+05"):
        recognise_unit(np.linspace(1e5, 1e6, 500), "a.csv")
    with pytest.raises(DataError, match="none of"):
        recognise_unit(np.linspace(48, 1500, 500), "a.csv")
    notes, values = [], np.full(1000, 30000.0)
    values[:3] = 90000.0
    made = scale_commands({"command1": values}, {"command1": "1/65535"}, Path("a.csv"), notes)
    assert made["command1"].max() == 1.0 and len(notes) == 1 and "3 of 1000" in notes[0]


def test_a_rotor_without_command_is_named():
    assert find_silent_rotors({"command1", "command2", "command4"}) == [3]
    assert find_silent_rotors({"w1_CMD", "w2_CMD", "w3_CMD", "w4_CMD"}) == []
    said = find_missing_sources({"command1": 0, "command2": 0, "command4": 0}, {})
    assert "no command of rotor 3" in said[0]


def test_flights_with_speeds_teach_the_map_for_the_others(flights):
    t = np.arange(1500) * 0.01
    r = np.random.default_rng(5)
    commands = 0.5 + 0.12 * lagged(r.standard_normal((1500, 4)), 0.01, 0.15, 0.0) * 3.0
    volts = np.linspace(15.8, 14.2, 1500)
    wanted = 800.0 * GAINS * (volts[:, None] / 15.0) ** 0.8 * (1.0 + 0.7 * (commands / 0.5 - 1.0))
    speeds = lagged(wanted, 0.01, 0.045, 0.02) + r.normal(0.0, 4.0, (1500, 4))
    table = {"t": t, "battery_voltage": volts}
    table |= {f"command{i + 1}": commands[:, i] for i in range(4)} | {f"w{i + 1}": speeds[:, i] for i in range(4)}
    drive, notes = rotor_speeds_of({"measured": pd.DataFrame(table), **flights}, to_draw(), MASSES, {})
    assert drive["scale"]["relative"] is False and drive["estimated flights"] == ["a", "b"]
    assert drive["time constant"]["value"] == pytest.approx(0.045, abs=4 * drive["time constant"]["std"] + 0.001)
    assert drive["delay"]["value"] == pytest.approx(0.020, abs=0.002)
    there = steady_speeds(drive, np.full((1, 4), 0.6), np.array([14.5]))
    np.testing.assert_allclose(there, 800.0 * GAINS[None] * (14.5 / 15.0) ** 0.8 * 1.14, rtol=0.01)
    assert drive["relative error"]["map"] == pytest.approx(4.0 / 800.0, rel=0.5)
    assert any("teach" in n for n in notes)


def test_a_filtered_flight_gets_speeds_with_their_slopes_in_its_band(flights, found):
    table, made = flights["a"], {"flight": "a", "mass": MASS, "filters": {"low-pass cutoff Hz": 10.0}}
    own, common = (add_estimated_speeds(table, made, found[0], trimmed) for trimmed in (True, False))
    speeds = own[["w1", "w2", "w3", "w4"]].to_numpy()
    apart = [(speeds[50 + k : -50 + k] - speeds[50 - k : -50 - k]) for k in (1, 2)]
    slope = (8.0 * apart[0] - apart[1]) / (12.0 * 0.01)  # central, of fourth order
    np.testing.assert_allclose(
        own[[f"w{i}_dot" for i in range(1, 5)]].to_numpy()[50:-50], slope, atol=0.05 * slope.std()
    )
    # trimmed: mean thrust carries the mean force, and quarters of it balance the moments
    raw = speeds_of(
        found[0], table[[f"command{i}_raw" for i in range(1, 5)]].to_numpy(), table["battery_voltage"], 0.01
    )
    trim = trim_of(table, made, raw, found[0])
    thrust = found[0]["scale"]["thrust factor"]["value"] * np.mean((raw * trim) ** 2, axis=0)
    np.testing.assert_allclose(thrust, -MASS * table["az"].mean() / 4.0, rtol=1e-9)
    np.testing.assert_allclose(own["w1"] / common["w1"], trim[0], rtol=1e-6)
    with pytest.raises(DataError, match="flight a holds no rotor speeds"):
        add_estimated_speeds(table, made, None)


def test_the_form_of_a_joint_map_is_the_same_in_other_units():
    """Mass and inertia a thousand times as large are forces in mN: the same map, lag and warm-up."""
    made = {x: flight(n, 25.0, hidden=0.004, cold=0.06) for x, n in zip("ab", (1, 2))}
    airframe = dataclasses.replace(to_draw(), inertia=1e3 * np.asarray(to_draw().inertia))
    found, _ = identify_rotor_speeds(made, airframe, dict.fromkeys(made, 1e3 * MASS))
    late = found["time constant"]["value"] + found["delay"]["value"]
    assert found["form"] == "linear" and late == pytest.approx(0.052, abs=0.003)
    assert found["warm-up drop"]["value"] == pytest.approx(0.057, abs=0.008)


@pytest.mark.parametrize("noise", [3.0, 8.0])
@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_the_form_of_a_taught_map_is_that_which_fits_whatever_the_noise_and_the_unit(noise, unit):
    """A form that does not fit leaves residuals that remember, and so fewer rows: that must not make it win."""
    rng, made = np.random.default_rng(1), {}
    for key in "ab":
        t = 0.004 * np.arange(10000)
        frame = {"t": t}
        for i in range(1, 5):
            waves = (0.06 * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in (0.2, 0.7, 1.9, 3.1))
            frame[f"command{i}"] = 0.45 + sum(waves)
            speed = lagged(2000.0 * frame[f"command{i}"][:, None], 0.004, 0.04, 0.012)[:, 0]
            frame[f"w{i}"] = unit * (speed + noise * rng.standard_normal(len(t)))
        made[key] = pd.DataFrame(frame)
    found = teach_map(made, {k: np.ones(10000, bool) for k in made}, CANDIDATES)
    assert found["form"] == "linear" and found["time constant"]["value"] == pytest.approx(0.04, abs=0.002)


@pytest.mark.parametrize(("unit", "top", "known"), [
    ("1/65535", 100.0, False), ("%", 1.0, False), ("1/65535", 2000.0, False), ("1/65535", 60000.0, True),
    ("%", 95.0, True), ("1", 0.9, True), ("1000..2000", 1950.0, True),
])  # fmt: skip
def test_a_stated_unit_of_commands_that_they_hardly_use_is_reported(unit, top, known):
    low = 1000.0 if 1000.0 < top <= 2000.0 else 0.2 * top
    notes = []
    commands = {f"command{i}": np.linspace(low, top, 500) for i in range(1, 5)}
    scale_commands(commands, dict.fromkeys(commands, unit), Path("log.csv"), notes)
    assert bool(cautions(notes)) != known
