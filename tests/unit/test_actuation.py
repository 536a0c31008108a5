"""Drive: rotors integrated by a plain loop, each fault of the drive found under its name with its size."""

import dataclasses
import functools

import numpy as np
import pandas as pd
import pytest
from clarity import clear, drive_size
from drive_fits import fitted_once

from quasi.airframe import Airframe
from quasi.gap.catalogue import catalogue
from quasi.gap.flights.level import Flown
from quasi.gap.levels.drive.findings import saturated
from quasi.gap.levels.drive.fit import LOOSE, Belief, belief_of, fit_drive
from quasi.gap.levels.drive.held_out import gains
from quasi.gap.levels.drive.identify import NORMAL, examine
from quasi.tables import TELEMETRY_AGE_REMOVED

RATE, SECONDS, FINER = 500.0, 4.0, 4
MAP, VOLTS, UP, DOWN = (380.0, 4650.0, -1200.0), 15.2, 0.022, 0.030
FRAME = Airframe("Made", 0.43, np.eye(3) * 1e-3, 0.04, 0.08, np.zeros((4, 3)), np.ones(4))
MODEL = {
    "id": "made",
    "actuators": {
        "time constants": {"value": [0.026] * 4},
        "time constants up": {"value": [UP] * 4},
        "time constants down": {"value": [DOWN] * 4},
        "delay": {"value": [0.0] * 4},
        "command map": {
            "coefficients": list(MAP), "powers": [0, 1, 2], "reference voltage": VOLTS,
            "voltage exponent": {"value": 1.0},
        },
    },
}  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def kept_fits():
    with fitted_once():
        yield


@functools.cache
def flown(
    seed, compared=True, up=UP, down=DOWN, late=0.0, age=0.002, told=False, exponent=1.0, limit=1.0,
    gains=(1.0, 1.0, 1.0, 1.0), slower=(1.0, 1.0, 1.0, 1.0), voltage=True,
    noise=2.0, reading=0.0, sag=1.2, seconds=SECONDS,
):  # fmt: skip
    """One flight; every rotor follows dW/dt = (wanted - W) / tau by Euler steps at four times the rate.

    noise  rad/s, of the logged speeds; reading  V, of the logged voltage; sag  V lost over the flight
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    fine = np.arange(0.0, seconds, 1.0 / (FINER * RATE))
    volts = 16.4 - sag * t / seconds + 0.05 * np.sin(3.0 * t)
    columns = {"t": t, "valid": np.ones(len(t))}
    spread = rng.normal(1.0, 0.02)  # motors differ from flight to flight
    for i in range(4):
        f, a, phase = rng.uniform(0.2, 9.0, 12), rng.uniform(0.01, 0.04, 12), rng.uniform(0, 6.28, 12)
        asked = 0.4 + sum(ai * np.sin(6.2832 * fi * fine + pi) for ai, fi, pi in zip(a, f, phase))
        asked = np.clip(asked, 0.02, limit)
        delayed = np.interp(fine - late, fine, asked)
        factor = gains[i] * (np.interp(fine, t, volts) / VOLTS) ** exponent
        wanted = factor * (MAP[0] + MAP[1] * delayed + MAP[2] * delayed**2)
        # plain floats, faster than those of NumPy
        speed, now = [], float(wanted[0])
        lag_up, lag_down = float(spread * slower[i] * up), float(spread * slower[i] * down)
        for target in wanted.tolist():
            speed.append(now)
            now += (target - now) / (lag_up if target > now else lag_down) / (FINER * RATE)
        logged = np.interp(t - age, fine, speed) + noise * rng.standard_normal(len(t))
        columns[f"w{i + 1}"] = np.interp(t + age, t, logged) if told else logged
        columns[f"command{i + 1}"] = np.interp(t, fine, asked)
    if voltage:
        columns["battery_voltage"] = volts + reading * rng.standard_normal(len(t))
    telemetry = {"age": {"value": age, "std": 1e-4}, "explained variance": 0.99, "applied": True} if told else None
    frame = pd.DataFrame(columns)
    return Flown(f"f{seed}", compared, frame, {"rotor telemetry": telemetry}, frame, {}, FRAME)


def only(level):
    assert not level.ties, level.ties
    (effect,) = level.effects
    return effect["id"], effect["since"], {n: (p["value"], p["std"]) for n, p in effect["parameters"].items()}


def test_the_fit_recovers_what_the_plain_loop_was_given():
    fit = fit_drive(
        flown(1, up=0.03, down=0.045, late=0.006, age=0.0, exponent=0.8), "shares", belief_of(MODEL, "shares")
    )
    ratio = fit.values[1] / fit.values[0]
    assert ratio == pytest.approx(1.5, rel=0.02)
    assert fit.values[2] == pytest.approx(0.006, abs=3e-4)
    assert fit.values[6] == pytest.approx(0.8, abs=0.02)
    assert fit.residual.std() < 3.0


def test_rotors_that_do_what_the_model_says_show_nothing():
    level = examine([flown(s) for s in (1, 2, 3)], MODEL, {})
    assert not level.effects
    assert not level.ties
    assert not level.findings
    assert level.noise_floor["w1"] < 3.0


@pytest.mark.parametrize("references", [(), (11, 12)])
@pytest.mark.parametrize(
    ("fault", "cause", "name", "truth"),
    [
        ({"up": 0.04, "down": 0.04}, "motor_lag", "time_constant", 0.04),
        ({"exponent": 0.5}, "battery_sag", "exponent", 0.5),
    ],
)
def test_a_fault_of_the_drive_is_found_with_its_size(fault, cause, name, truth, references):
    flights = [flown(s, compared=False) for s in references] + [flown(s, **fault) for s in (1, 2, 3)]
    found, since, parameters = only(examine(flights, MODEL, {}))
    assert (found, since) == (cause, "changed" if references else "always")
    value, std = parameters[name]
    assert abs(value - truth) < 3 * std + 0.02 * truth
    assert parameters.get("reference voltage") == ((VOLTS, 0.0) if cause == "battery_sag" else None)


@pytest.mark.parametrize("references", [(), (11, 12)])
@pytest.mark.parametrize("exponent", [1.0, 0.5])
def test_noise_of_the_voltage_readings_makes_no_exponent_smaller(exponent, references):
    """What is new of speeds that are logged well is that noise; by it alone, 1 came out below 0.1."""
    logged = {"noise": 0.2, "reading": 0.05, "sag": 0.3, "seconds": 8.0}
    flights = [flown(s, exponent=exponent, **logged) for s in (1, 2, 3)]
    fit = fit_drive(flights[0], "shares", belief_of(MODEL, "shares"))
    assert fit.values[6] == pytest.approx(exponent, abs=0.02)
    assert abs(fit.values[6] - exponent) < 4.0 * np.sqrt(fit.covariance()[6, 6])
    level = examine([*(flown(s, compared=False, **logged) for s in references), *flights], MODEL, {})
    if exponent == 1.0:
        assert not level.effects and not level.ties
    else:
        found, since, parameters = only(level)
        assert (found, since) == ("battery_sag", "changed" if references else "always")
        assert parameters["exponent"][0] == pytest.approx(exponent, abs=0.02)


def steady(seed):
    """A flight at the map's own voltage all along: its speeds say nothing of the battery."""
    plain = flown(seed, exponent=0.0)
    table = plain.filtered.assign(battery_voltage=VOLTS)
    return dataclasses.replace(plain, filtered=table, imported=table)


def test_a_battery_exponent_is_that_of_flights_whose_voltage_varies():
    flights = [flown(s, exponent=0.5) for s in (1, 2, 3)]
    found, _, parameters = only(examine([*flights, steady(4)], MODEL, {}))
    alone = only(examine(flights, MODEL, {}))[2]
    assert found == "battery_sag"
    assert parameters["exponent"] == pytest.approx(alone["exponent"], rel=1e-3)
    learned = examine([*flights, steady(4)], MODEL, {}).healthy["learned"]["values"]
    assert learned[6] == pytest.approx(0.5, abs=0.01)


def test_flights_without_a_battery_voltage_do_not_speak_against_its_exponent():
    flights = [flown(s, exponent=0.5) for s in (1, 2, 3)]
    without = [flown(s, exponent=0.5, voltage=False) for s in (4, 5)]
    found, _, parameters = only(examine([*flights, *without], MODEL, {}))
    assert found == "battery_sag"
    assert parameters["exponent"][0] == pytest.approx(0.5, abs=0.01)


def test_what_a_flight_does_not_tell_is_as_doubtful_as_its_fit_left_it_free():
    """At the reference voltage itself (V/V_ref)^e is 1 for every e: the doubt is the looseness, whatever the noise."""
    start = belief_of(MODEL, "shares")
    one = fit_drive(steady(4), "shares", start)
    assert one.values[6] == start.values[6]
    assert np.sqrt(one.covariance()[6, 6]) == pytest.approx(LOOSE[6])
    varying = fit_drive(flown(1), "shares", start)
    assert np.sqrt(varying.covariance()[6, 6]) < 0.1 * LOOSE[6]


def test_reference_flights_whose_voltage_stays_make_the_others_battery_no_change():
    references = [dataclasses.replace(steady(s), compared=False) for s in (11, 12)]
    level = examine([*references, *(flown(s) for s in (1, 2, 3))], {"id": "bare"}, {})
    assert not level.effects and not level.ties
    drooping = [flown(s, compared=False, exponent=0.5) for s in (13, 14)]
    level = examine([*references, *drooping, *(flown(s) for s in (1, 2, 3))], {"id": "bare"}, {})
    (effect,) = level.effects
    assert (effect["id"], effect["since"]) == ("battery_sag", "changed")
    # no map tells a voltage: the exponent is about that of the flights
    assert effect["parameters"]["reference voltage"]["value"] == pytest.approx(15.8, abs=0.3)


def test_late_commands_and_late_telemetry_are_a_tie_unless_the_motion_told_the_age():
    level = examine([flown(s, late=0.008) for s in (1, 2, 3)], MODEL, {})
    assert not level.effects
    assert set(level.ties[0]["ids"]) == {"command_delay", "telemetry_delay"}
    assert "yaw" in level.ties[0]["tie_breaker"]
    for fault, cause in (({"late": 0.008}, "command_delay"), ({"age": 0.010}, "telemetry_delay")):
        found, _, parameters = only(examine([flown(s, told=True, **fault) for s in (1, 2, 3)], MODEL, {}))
        assert found == cause
        value, std = parameters["delay"]
        assert abs(value - 0.008) < 3 * std


def test_stamps_that_import_moved_to_fit_the_motion_say_nothing_of_the_age():
    """Late telemetry in a source with stamps of its own: moved with its commands, it had the name of late commands."""
    lag = {"applied": True, "from": "angular acceleration and rotor speeds"}
    moved = {"sources": {"onboard": {"sources": {"esc": {"lag of main stamps": lag}}}}}
    flights = [flown(s, told=True, late=0.008) for s in (1, 2, 3)]
    level = examine([dataclasses.replace(f, metadata={**f.metadata, **moved}) for f in flights], MODEL, {})
    assert not level.effects
    assert set(level.ties[0]["ids"]) == {"command_delay", "telemetry_delay"}


@pytest.mark.parametrize("held", [0.0, 0.002])
def test_a_model_whose_delay_holds_the_age_of_the_telemetry_or_not_makes_no_healthy_flight_late(held):
    document = {**MODEL, "actuators": {**MODEL["actuators"], "delay": {"value": [held] * 4}}}
    for told in (False, True):
        level = examine([flown(s, told=told) for s in (1, 2, 3)], document, {})
        assert not level.effects and not level.ties
        late = {c["id"]: c["p"] for c in level.candidates}
        assert min(late["command_delay"], late["telemetry_delay"]) > 0.05


@pytest.mark.parametrize(("held", "aged"), [(0.0, True), (0.002, False)])
def test_a_model_that_tells_whether_its_delay_holds_the_age_is_compared_like_with_like(held, aged):
    delay = {"value": [held] * 4}

    def examined(delay, **fault):
        document = {**MODEL, "actuators": {**MODEL["actuators"], "delay": delay}}
        return examine([flown(s, **fault) for s in (1, 2, 3)], document, {})

    def wald(level):
        """Of late commands, named or not."""
        said = [(c["id"], c["score"]) for c in level.candidates]
        said += [(e["id"], e["evidence"]["wald"]) for e in level.effects]
        said += [(name, tie["wald"]) for tie in level.ties for name in tie["ids"]]
        return dict(said)["command_delay"]

    def beyond(level):
        """Error of the speeds before, beside what the flights' own constants leave."""
        squares = level.tables["channels"][["before", "floor"]].pow(2).mean()
        return float(squares["before"] / squares["floor"])

    told, silent = examined({**delay, TELEMETRY_AGE_REMOVED: aged}), examined(delay)
    assert not told.effects and not told.ties
    assert beyond(told) < beyond(silent)
    for fault in ({"late": 0.004}, {"late": 0.004, "told": True}):
        sharp, blunt = (examined(d, **fault) for d in ({**delay, TELEMETRY_AGE_REMOVED: aged}, delay))
        assert sharp.effects or sharp.ties
        assert wald(sharp) > wald(blunt)


def test_how_clearly_a_size_shows_by_level_a():
    level = examine([flown(s) for s in (1, 2, 3)], MODEL, {})
    healthy = {"up": UP, "down": DOWN, "exponent": 1.0}
    sag = clear(level.tests, "battery_sag", "always", drive_size("battery_sag", {"exponent": 0.7}, healthy))
    # spread between three flights, and as much doubt about the model's own exponent
    assert sag.detectability == pytest.approx(0.3 / np.hypot(NORMAL["exponent"] / np.sqrt(3.0), 0.03), rel=0.3)
    late = clear(level.tests, "command_delay", "always", drive_size("command_delay", {"delay": 0.008}, healthy))
    assert late.nearest == "telemetry_delay"
    assert late.separability < 0.3 * late.detectability
    lag = drive_size("motor_lag", {"time_constant": 0.04}, healthy)
    np.testing.assert_allclose(lag, np.log(0.08 / (UP + DOWN)))
    assert lag.shape == (4,) and clear(level.tests, "motor_lag", "always", lag).detectability > 4.0
    np.testing.assert_allclose(drive_size("motor_lag", {"rotor2": 1.4}, healthy), [0.0, np.log(1.4), 0.0, 0.0])


def test_rotors_that_are_switched_off_in_the_air_sit_at_no_limit():
    def cut(rotors):
        """The last fiftieth of each flight with some rotors' commands at nothing."""
        flights = []
        for plain in (flown(1), flown(2)):
            table, end = plain.imported.copy(), int(0.98 * len(plain.imported))
            for i in rotors:
                table.loc[end:, f"command{i}"] = 0.0
            flights.append(dataclasses.replace(plain, imported=table))
        return flights

    assert not saturated(cut([1, 2, 3, 4]), "shares")
    (finding,) = saturated(cut([1, 2]), "shares")  # these two, while the others fly on, are out of reach
    assert "a lower limit" in finding["text"]
    assert finding["evidence"]["share"]["rotor1"] == pytest.approx(0.02, abs=0.002)


def test_commands_at_a_limit_and_a_slow_motor_are_findings():
    limited = [flown(s, limit=0.48) for s in (1, 2)]
    (finding,) = saturated(limited, "shares")
    assert finding["evidence"]["limit"] == pytest.approx(0.48, abs=0.003)
    at = np.mean([[np.mean(f.imported[f"command{i}"] > 0.4785) for i in range(1, 5)] for f in limited], axis=0)
    np.testing.assert_allclose(list(finding["evidence"]["share"].values()), at, atol=0.03)
    assert not saturated([flown(s) for s in (1, 2)], "shares")
    level = examine([flown(s, gains=(1.0, 0.94, 1.0, 1.0)) for s in (1, 2, 3)], MODEL, {})
    (weak,) = level.findings
    assert catalogue()[weak["id"]].finding
    assert weak["evidence"]["rotor"] == 2
    assert weak["evidence"]["speed"] == pytest.approx(0.94, abs=0.01)


@pytest.mark.parametrize("gain", [0.75, 1.3])
def test_a_slow_motor_is_slow_by_its_share_however_far_off_the_models_map_is(gain):
    gains = gain * np.array([1.0, 0.94, 1.0, 1.0])
    level = examine([flown(s, gains=tuple(gains)) for s in (1, 2)], MODEL, {})
    assert level.findings[0]["evidence"]["speed"] == pytest.approx(0.94, abs=0.003)
    # and of commands the speeds are what they were
    learned = level.healthy["learned"]["values"]
    speeds, own = (np.polyval(np.array(m)[::-1], 0.4) for m in (MAP, learned[3:6]))
    np.testing.assert_allclose(own * (1.0 + np.array(learned[7:11])), gains * speeds, rtol=2e-3)


@pytest.mark.parametrize(
    ("rotor", "factor", "references"), [(1, 0.6, ()), (4, 2.0, ()), (4, 1.4, (11, 12)), (1, 2.0, (11, 12))]
)
def test_the_rotor_that_follows_later_than_the_others_is_named(rotor, factor, references):
    slower = tuple(factor if i == rotor - 1 else 1.0 for i in range(4))
    flights = [flown(s, compared=False) for s in references] + [flown(s, slower=slower) for s in (1, 2, 3)]
    level = examine(flights, MODEL, {})
    (finding,) = (f for f in level.findings if f["id"] == "motor_lag")
    assert finding["evidence"]["rotor"] == rotor
    assert finding["evidence"]["factor"] == pytest.approx(factor, abs=3.0 * finding["evidence"]["std"])
    assert f"rotor {rotor} follows" in finding["text"]
    (effect,) = level.effects
    assert effect["id"] == "motor_lag" and not level.ties
    ((name, own),) = effect["parameters"].items()
    assert name == f"rotor{rotor}"
    assert own["value"] == pytest.approx(factor, abs=3.0 * own["std"])


def test_a_rotor_that_follows_later_is_named_from_short_flights_as_well():
    """With one lag for all, the errors that the slow one makes hid it in flights as short as these."""
    tables = [flown(s, slower=(1.0, 1.0, 1.8, 1.0)).filtered.query("t < 5") for s in (1, 2, 3)]
    flights = [dataclasses.replace(flown(s), imported=t, filtered=t) for s, t in zip((1, 2, 3), tables)]
    found, _, parameters = only(examine(flights, MODEL, {}))
    assert found == "motor_lag" and set(parameters) == {"rotor3"}
    assert parameters["rotor3"][0] == pytest.approx(1.8, rel=0.05)


def test_a_rotor_that_always_follows_later_is_no_change_and_four_slow_ones_are_none():
    late = (1.0, 1.4, 1.0, 1.0)
    flights = [flown(s, compared=False, slower=late) for s in (11, 12)] + [flown(s, slower=late) for s in (1, 2, 3)]
    assert not examine(flights, MODEL, {}).findings
    assert not examine([flown(s, slower=(1.5,) * 4) for s in (1, 2, 3)], MODEL, {}).findings


def test_two_slow_rotors_are_findings_and_the_healthy_ones_are_not_called_fast():
    flights = [flown(s, slower=(1.0, 1.6, 1.6, 1.0), gains=(0.94, 1.0, 1.0, 0.94)) for s in (1, 2, 3)]
    found = [(f["id"], f["evidence"]["rotor"]) for f in examine(flights, MODEL, {}).findings]
    assert found == [("weak_motor", 1), ("weak_motor", 4), ("motor_lag", 2), ("motor_lag", 3)]


def test_what_is_not_logged_cannot_be_asked():
    bare = flown(1)
    without = bare.filtered.drop(columns=[f"command{i}" for i in range(1, 5)])
    level = examine([Flown("f", True, without, {}, without, {}, FRAME)], MODEL, {})
    assert {c["id"] for c in level.cannot_be_asked} >= {"motor_lag", "actuator_saturation", "weak_motor"}
    level = examine([flown(s, voltage=False) for s in (1, 2)], MODEL, {})
    assert [c["id"] for c in level.cannot_be_asked] == ["battery_sag"]
    level = examine([flown(1)], {"id": "bare"}, {})
    assert "does not say how its rotors follow" in level.notes[0]
    assert not level.effects
    map_alone = {k: v for k, v in MODEL["actuators"]["command map"].items() if k != "reference voltage"}
    level = examine([flown(1)], {**MODEL, "actuators": {**MODEL["actuators"], "command map": map_alone}}, {})
    assert "does not say at which battery voltage its command map holds" in level.notes[0]


def test_speeds_that_were_made_of_the_commands_say_nothing_of_the_rotors():
    """They follow their map whatever the rotors did; a fit of them has no errors, and no tests can be made of it."""
    of = [flown(seed, compared=seed < 3) for seed in (1, 2, 3, 4)]
    made = [f.filtered.assign(**{f"command{i}_raw": f.filtered[f"command{i}"] for i in range(1, 5)}) for f in of]
    made_of = [dataclasses.replace(f, filtered=frame) for f, frame in zip(of, made)]
    level = examine(made_of, MODEL, {})
    causes = {"motor_lag", "command_delay", "telemetry_delay", "battery_sag", "weak_motor"}
    assert {c["id"] for c in level.cannot_be_asked} == causes
    assert not level.effects and not level.notes and level.tests is None
    mixed = examine([of[0], of[1], *made_of[2:]], MODEL, {})
    assert mixed.tests is not None
    assert len([n for n in mixed.notes if "no measured rotor speeds" in n]) == 2
    assert not [f for f in level.findings if f["id"] != "actuator_saturation"]


def test_a_model_that_tells_speeds_holds_gain_one():
    belief = belief_of(MODEL, "speeds")
    assert isinstance(belief, Belief)
    np.testing.assert_allclose(belief.values[:7], [UP, DOWN, 0, 0, 1, 0, 0])
    assert belief_of({}, "shares") is None


def with_commanded_speeds(plain):
    """The flight of a speed controller: the log holds the speeds that the map makes of its shares, and no shares."""
    shares = [plain.imported[f"command{i}"] for i in range(1, 5)]
    factor = plain.imported["battery_voltage"] / VOLTS
    speeds = {f"w{i}_CMD": factor * np.polyval(MAP[::-1], c) for i, c in enumerate(shares, 1)}
    table = plain.imported.drop(columns=[c.name for c in shares]).assign(**speeds)
    return dataclasses.replace(plain, imported=table, filtered=table)


def test_commanded_speeds_show_a_lag_as_shares_do():
    slow = {"up": 0.04, "down": 0.045}
    references = [with_commanded_speeds(flown(s, compared=False)) for s in (11, 12)]
    level = examine([*references, *(with_commanded_speeds(flown(s, **slow)) for s in (1, 2, 3))], MODEL, {})
    found, since, parameters = only(level)
    assert (found, since) == ("motor_lag", "changed")
    value, std = parameters["time_constant"]
    assert abs(value - 0.0425) < 3 * std
    # a held-out flight of the other kind of commands shows nothing
    held = [flown(4, **slow), with_commanded_speeds(flown(5, **slow))]
    both, own = (gains(level.effects, flights, level.healthy)["motor_lag"].removed for flights in (held, held[1:]))
    assert own.min() > 0.7
    np.testing.assert_array_equal(both, own)
    healthy = [*references, *(with_commanded_speeds(flown(s)) for s in (1, 2, 3))]
    assert not examine(healthy, MODEL, {}).effects
