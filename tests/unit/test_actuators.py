"""Rotors made to follow their commands with known constants: up, down, delay, map, voltage, and noise."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import firwin

from quasi.errors import ConfigError
from quasi.identification.actuators import actuators, flight_lags
from quasi.identification.lag_fit import NO_SLOPES, follow
from quasi.importing.command_map import add_commanded_speeds
from quasi.tables import TELEMETRY_AGE_REMOVED

RATE = 500.0
UP, DOWN, DELAY = 0.02, 0.032, 0.006
MAP = (300.0, 3000.0, -600.0)


def slow_follow(wanted, tau_up, tau_down, delay, fine=10):
    """The same equation by plain Euler steps ten times as short; commands held to straight lines between samples."""
    n = len(wanted)
    at = np.arange(n * fine) / (RATE * fine)
    seen = np.interp(at - delay, np.arange(n) / RATE, wanted)
    y, out = seen[0], np.empty(n)
    for k, w in enumerate(seen):
        if k % fine == 0:
            out[k // fine] = y
        y += (w - y) / ((tau_up if w > y else tau_down) * RATE * fine)
    return out


def made(seed, seconds=30, noise=0.0, up=UP, down=DOWN, delay=DELAY, voltage=None, exponent=0.0, low=None):
    r = np.random.default_rng(seed)
    n = int(seconds * RATE)
    t = np.arange(n) / RATE
    data = {"t": t}
    if voltage is not None:
        data["battery_voltage"] = voltage(t)
    for i in range(1, 5):
        steps = np.repeat(r.uniform(0.2, 0.8, n // 50), 50)
        command = np.convolve(steps, np.ones(10) / 10, "same")
        wanted = MAP[0] + MAP[1] * command + MAP[2] * command**2
        if voltage is not None:
            wanted = wanted * (voltage(t) / 15.0) ** exponent
        speed = slow_follow(wanted, up, down, delay) + noise * r.standard_normal(n)
        if low is not None:
            command, speed = (np.convolve(x, low, "same") for x in (command, speed))
        data[f"command{i}"], data[f"w{i}"], data[f"w{i}_CMD"] = command, speed, wanted
    return pd.DataFrame(data)


def shares(flight):
    return flight[[c for c in flight if not c.endswith("_CMD")]]


def test_the_compiled_lag_equals_an_adaptive_integrator():
    n, dt = 200, 1 / RATE
    t = np.arange(n) * dt
    wanted = 1500 + 600 * np.sin(23 * t) * np.sin(40 * t)
    out = np.empty(n)
    start = np.zeros(n, bool)
    start[0] = True
    follow(wanted, np.full(n, 1000.0), start, 1.6, dt, UP, DOWN, out, NO_SLOPES, NO_SLOPES)

    def slope(at, y):
        w = np.interp(at - 1.6 * dt, t, wanted)
        return (w - y) / (UP if w > y[0] else DOWN)

    exact = solve_ivp(slope, (0, t[-1]), [1000.0], t_eval=t, max_step=dt / 5, rtol=1e-8)
    # of swings of 1000; the turn from up to down falls between two samples
    np.testing.assert_allclose(out, exact.y[0], atol=0.6)


@pytest.mark.parametrize("late", [0.3, 1.6, -0.4])
def test_derivatives_of_the_lag_equal_differences(late):
    r, n, dt = np.random.default_rng(3), 400, 1 / RATE
    command = np.repeat(r.uniform(0.2, 0.8, n // 8), 8)
    start = np.zeros(n, bool)
    start[[0, 150]] = True
    powers = np.stack([np.ones(n), command, command**2], axis=1)
    at = np.array([UP, DOWN, late * dt, *MAP])

    def speeds(x, slopes=NO_SLOPES):
        out = np.empty(n)
        moves = powers if len(slopes) else NO_SLOPES
        follow(powers @ x[3:], np.full(n, 1500.0), start, x[2] / dt, dt, x[0], x[1], out, moves, slopes)
        return out

    slopes = np.empty((n, 6))
    plain = speeds(at)
    np.testing.assert_array_equal(speeds(at, slopes), plain)
    for k, step in enumerate([1e-8, 1e-8, 1e-8, 1e-4, 1e-4, 1e-4]):
        one = np.where(np.arange(6) == k, step, 0.0)
        differences = (speeds(at + one) - speeds(at - one)) / (2.0 * step)
        np.testing.assert_allclose(slopes[:, k], differences, rtol=1e-4, atol=1e-5 * np.abs(slopes[:, k]).max())
        assert np.abs(slopes[start, k]).max() == 0.0


@pytest.mark.parametrize("commanded", ["speed", "share"])
def test_up_down_delay_and_map_are_recovered(commanded):
    flight = made(1)
    lags = flight_lags(flight if commanded == "speed" else shares(flight), np.ones(len(flight), bool))
    for lag in lags:
        assert lag.up == pytest.approx(UP, abs=4e-4)
        assert lag.down == pytest.approx(DOWN, abs=4e-4)
        assert lag.delay == pytest.approx(DELAY, abs=3e-4)
        assert UP < lag.tau < DOWN
        assert lag.explained > 0.999
        if commanded == "share":
            at = np.array([0.3, 0.5, 0.7])
            np.testing.assert_allclose(np.polyval(lag.map[::-1], at), np.polyval(MAP[::-1], at), rtol=5e-3)
        else:
            assert lag.map == pytest.approx([0.0, 1.0], abs=8.0)


def test_one_filter_over_commands_and_speeds_leaves_the_constants():
    flight = made(2, low=firwin(61, 40.0, fs=RATE))
    rows = np.ones(len(flight), bool)
    rows[:60] = rows[-60:] = False
    for lag in flight_lags(shares(flight), rows):
        assert lag.up == pytest.approx(UP, abs=1.5e-3)
        assert lag.down == pytest.approx(DOWN, abs=1.5e-3)
        assert lag.delay == pytest.approx(DELAY, abs=1e-3)


def test_noise_leaves_no_bias_and_standard_errors_are_honest():
    errors = []
    for seed in range(6):
        flight = made(10 + seed, seconds=8, noise=80.0)
        for lag in flight_lags(shares(flight), np.ones(len(flight), bool)):
            errors.append(
                [
                    (lag.up - UP) / lag.std["up"],
                    (lag.down - DOWN) / lag.std["down"],
                    (lag.delay - DELAY) / lag.std["delay"],
                ]
            )
    errors = np.array(errors)
    assert np.all(np.abs(errors.mean(axis=0)) < 0.8)  # 24 draws: three standard errors of their mean
    assert np.all((errors.std(axis=0) > 0.6) & (errors.std(axis=0) < 1.5))


def test_the_exponent_of_the_battery_is_recovered():
    flight = made(3, voltage=lambda t: 16.0 - 0.05 * t - 0.4 * (np.sin(t) > 0.5), exponent=0.8)
    found = actuators({"a": shares(flight)}, {"a": np.ones(len(flight), bool)}, [])
    mapped = found["command map"]
    assert mapped["voltage exponent"]["value"] == pytest.approx(0.8, abs=0.02)
    at_reference = (mapped["reference voltage"] / 15.0) ** 0.8
    assert np.polyval(mapped["coefficients"][::-1], 0.5) == pytest.approx(
        at_reference * np.polyval(MAP[::-1], 0.5), rel=5e-3
    )
    assert found["time constants up"]["value"] == pytest.approx([UP] * 4, abs=5e-4)


def test_spread_over_flights_is_reported_and_the_medians_stand():
    flights = {str(k): shares(made(20 + k, seconds=10, up=UP * f)) for k, f in enumerate((0.9, 1.0, 1.1))}
    found = actuators(flights, {k: np.ones(len(f), bool) for k, f in flights.items()}, [])
    up = found["time constants up"]
    assert up["value"] == pytest.approx([UP] * 4, abs=5e-4)
    assert up["spread"] == pytest.approx([0.1 * UP] * 4, rel=0.3)
    assert up["std"] == pytest.approx([1.2533 * s / np.sqrt(3) for s in up["spread"]])
    assert set(found["per flight"]) == set(found["flights"]) == {"0", "1", "2"}
    assert found["command map"]["source"] == "fitted on 3 training flights"


def test_errors_of_two_flights_hold_what_they_differ_by():
    flights = {str(k): shares(made(20 + k, seconds=10, up=UP * f)) for k, f in enumerate((0.8, 1.2))}
    up = actuators(flights, {k: np.ones(len(f), bool) for k, f in flights.items()}, [])["time constants up"]
    assert up["std"] == pytest.approx([0.2 * UP] * 4, rel=0.1)  # half of the difference


def test_the_error_of_the_exponent_takes_flights_for_independent_not_rotors():
    """The four rotors of a flight share its battery: four equal values are one."""

    def volts(t):
        return 16.0 - 0.1 * t - 0.4 * (np.sin(t) > 0.5)

    flights = {}
    for k, exponent in enumerate((0.7, 0.9, 0.8)):
        flights[str(k)] = shares(made(30 + k, seconds=10, voltage=volts, exponent=exponent))
    found = actuators(flights, {k: np.ones(len(f), bool) for k, f in flights.items()}, [])
    exponent = found["command map"]["voltage exponent"]
    assert exponent["value"] == pytest.approx(0.8, abs=0.02)
    assert exponent["std"] == pytest.approx(1.2533 * 0.1 / np.sqrt(3), rel=0.2)
    one = actuators({"0": flights["0"]}, {"0": np.ones(len(flights["0"]), bool)}, [])
    assert one["command map"]["voltage exponent"]["std"] > 0.0


def test_a_flight_at_a_steady_voltage_does_not_move_the_map_from_its_reference():
    flights = {
        "a": shares(made(3, seconds=10, voltage=lambda t: 16.0 - 0.1 * t - 0.4 * (np.sin(t) > 0.5), exponent=0.8)),
        "b": shares(made(4, seconds=10, voltage=lambda t: 18.0 + 0 * t, exponent=0.8)),
    }
    mapped = actuators(flights, {k: np.ones(len(f), bool) for k, f in flights.items()}, [])["command map"]
    true = (mapped["reference voltage"] / 15.0) ** 0.8 * np.polyval(MAP[::-1], 0.5)
    assert np.polyval(mapped["coefficients"][::-1], 0.5) == pytest.approx(true, rel=1e-2)


def test_gaps_start_anew_and_rows_outside_are_not_compared():
    flight = shares(made(4))
    flight.loc[3000:3400, "command2"] = np.nan
    rows = np.ones(len(flight), bool)
    rows[9000:] = False
    flight.loc[9000:, ["w1", "w2", "w3", "w4"]] = 0.0  # landed
    for lag in flight_lags(flight, rows):
        assert lag.up == pytest.approx(UP, abs=6e-4)
        assert lag.down == pytest.approx(DOWN, abs=6e-4)


def test_the_delay_is_that_of_flights_whose_telemetry_was_set_right():
    ages = {"a": 0.0, "b": 0.003, "c": 0.0}  # s that rotor speeds are still logged late by
    flights = {key: shares(made(30 + k, seconds=10, delay=DELAY + age)) for k, (key, age) in enumerate(ages.items())}
    rows = {key: np.ones(len(f), bool) for key, f in flights.items()}

    def found(**aged):
        notes = []
        return actuators(flights, rows, notes, aged=aged), notes

    told, notes = found(a=True, b=False, c=True)
    assert told["delay"]["value"] == pytest.approx([DELAY] * 4, abs=3e-4)
    assert told["delay"][TELEMETRY_AGE_REMOVED] is True
    assert [told["flights"][key]["delay"][TELEMETRY_AGE_REMOVED] for key in "abc"] == [True, False, True]
    assert told["time constants"]["value"] == found()[0]["time constants"]["value"]
    assert [n for n in notes if "2 of 3 flights: in b import could not" in n]
    none, notes = found(a=False, b=False, c=False)
    assert none["delay"][TELEMETRY_AGE_REMOVED] is False and "no flight gave the age" in notes[0]
    whole = np.median([[lag.delay for lag in flight_lags(f, rows[k], None)] for k, f in flights.items()], axis=0)
    assert none["delay"]["value"] == pytest.approx(whole)
    silent, notes = found(b=False)  # imported before anybody kept it
    assert (
        TELEMETRY_AGE_REMOVED not in silent["delay"]
        and TELEMETRY_AGE_REMOVED not in silent["flights"]["a"]["delay"]
        and not notes
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f[["t", "w1", "w2", "w3", "w4"]], "logs no rotor command"),
        (lambda f: f.assign(w2=1000.0), "rotor 2 hardly changes its speed"),
        (lambda f: f.assign(command3=np.nan), "rotor 3 has 0 rows|logs no rotor command"),
        (
            lambda f: f.assign(command1=np.roll(f["command1"], -3000)),
            "rotor 1 does not follow|rotor 1 moves too little",
        ),
    ],
    ids=["no command", "still", "no finite command", "command of another time"],
)
def test_flights_that_tell_nothing_are_a_note(change, words):
    flight = change(shares(made(5, seconds=10)))
    notes = []
    assert actuators({"a": flight}, {"a": np.ones(len(flight), bool)}, notes) is None
    assert len(notes) == 1
    assert re.search(words, notes[0])


def test_a_configured_map_makes_commanded_speeds_and_stands_in_the_model():
    flight = shares(made(6, seconds=10))
    given = {"coefficients": list(MAP)}
    mapped, source = add_commanded_speeds(flight, given, "a", [])
    assert source == {"source": "configured map"}
    np.testing.assert_allclose(mapped["w3_CMD"], np.polyval(MAP[::-1], flight["command3"]))
    found = actuators({"a": mapped}, {"a": np.ones(len(flight), bool)}, [], given)
    assert found["command map"]["source"] == "configured"
    assert found["command map"]["coefficients"] == list(MAP)
    assert found["time constants down"]["value"] == pytest.approx([DOWN] * 4, abs=5e-4)


def test_a_configured_map_follows_the_battery_and_refuses_to_fall():
    flight = shares(made(7, seconds=5)).assign(battery_voltage=14.0)
    given = {"coefficients": list(MAP), "voltage exponent": 1.0, "reference voltage": 16.0}
    mapped, _ = add_commanded_speeds(flight, given, "a", [])
    np.testing.assert_allclose(mapped["w1_CMD"], 14 / 16 * np.polyval(MAP[::-1], flight["command1"]))
    notes = []
    add_commanded_speeds(flight.drop(columns="battery_voltage"), given, "a", notes)
    assert "no battery voltage" in notes[0]
    with pytest.raises(ConfigError, match="'command map' falls"):
        add_commanded_speeds(flight, {"coefficients": [300, 1000, -1000]}, "a", [])
    logged = flight.assign(w1_CMD=1.0)
    assert add_commanded_speeds(logged, given, "a", [])[1] == {"source": "logged"}


def test_a_battery_that_is_not_measured_does_not_stop_the_rotors():
    """Betaflight logs 0 V without a sensor: commanded speeds were 0. Where it drops out, the rest says what it was."""
    given = {"coefficients": [100.0, 2000.0], "voltage exponent": 0.8, "reference voltage": 16.0}
    made = pd.DataFrame({"t": 0.01 * np.arange(100), **{f"command{i}": np.full(100, 0.5) for i in range(1, 5)}})
    notes = []
    mapped, _ = add_commanded_speeds(made.assign(battery_voltage=0.0), given, "a", notes)
    assert np.all(mapped["w1_CMD"] == 1100.0) and any("battery" in n for n in notes)
    volts = np.where(np.arange(100) % 9 == 5, 0.0, 15.0)
    mapped, _ = add_commanded_speeds(made.assign(battery_voltage=volts), given, "a", [])
    np.testing.assert_allclose(mapped["w4_CMD"], 1100.0 * (15.0 / 16.0) ** 0.8)


def test_a_map_that_does_not_fit_is_told():
    flight = made(8, seconds=10)
    wrong = flight.assign(**{f"w{i}_CMD": 0.7 * flight[f"w{i}_CMD"] for i in range(1, 5)})
    notes = []
    found = actuators({"a": wrong}, {"a": np.ones(len(flight), bool)}, notes)
    assert any("rotors reach 143 %" in n for n in notes)
    assert found["time constants up"]["value"] == pytest.approx([UP] * 4, abs=5e-4)
