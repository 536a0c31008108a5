"""The order of rotor columns: all 23 wrong ones are found, a right one is not, and import undoes what was found."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from plain_plant import made_model, with_simple_model
from test_gap_halves import flown as fly

from quasi.errors import ConfigError
from quasi.gap.catalogue import catalogue
from quasi.gap.diagnosis import verdict_of
from quasi.gap.flights.level import Flown
from quasi.gap.levels import rotor_order, sensors_and_drive
from quasi.gap.levels.corrections import for_flight
from quasi.gap.levels.rotor_order import ID, ORDERS, effect_of, find_rotor_order, reordered, sentence_of
from quasi.gap.report.wording import happening
from quasi.importing.calibration import calibrated_onboard, check, is_identity
from quasi.importing.onboard_log import Onboard, Track
from quasi.model.model import AXES, Model

NOISE = np.array([0.05, 0.05, 0.05, 1e-3, 1e-3, 1e-3])  # N and N m
SETTINGS = {"false alarm rate": 0.01, "sessions": {}}


@pytest.fixture(scope="module")
def model():
    return with_simple_model(made_model(reaction=0.01), 0.01)


@pytest.fixture(scope="module")
def flights(model):
    """Two reference flights and two to compare, with rotors that differ from each other, and their commands."""
    table, _ = fly(model, model, noise=0.0)
    made = []
    for k in range(4):
        rng = np.random.default_rng(k)
        speeds = {
            f"w{i}": table[f"w{i}"] + 60.0 * np.sin((1.5 + 0.7 * i + 0.1 * k) * table["t"] + i) for i in range(1, 5)
        }
        moved = table.assign(**speeds, **{f"command{i}": speeds[f"w{i}"] / 3000.0 for i in range(1, 5)})
        wrench = model.predict_columns(moved)[list(AXES)].to_numpy() + NOISE * rng.standard_normal((len(table), 6))
        noisy = moved.assign(**dict(zip(AXES, wrench.T)))
        made.append(Flown(f"f{k}", k > 1, noisy, {}, noisy, {}, model.airframe))
    return made


def logged(flown, order, commands):
    """A compared flight as a log shows it in which column order[i] holds rotor i."""
    if not flown.compared:
        return flown
    back = [order.index(i) for i in range(4)]
    table = reordered(flown.filtered, back, back if commands else range(4))
    return replace(flown, filtered=table, imported=table)


@pytest.mark.parametrize("order", ORDERS[1:])
def test_every_wrong_order_is_found(flights, model, order):
    found = find_rotor_order([logged(f, order, True) for f in flights], model)
    assert found.speeds == found.commands == order
    assert found.probability > 0.99 and set(found.odds) == {"f2", "f3"}


def test_speeds_alone_in_another_order_leave_the_commands(flights, model):
    found = find_rotor_order([logged(f, (2, 1, 0, 3), False) for f in flights], model)
    assert found.speeds == (2, 1, 0, 3) and found.commands == (0, 1, 2, 3)
    assert found.calibration() == {"rotors": {"order of speeds": [3, 2, 1, 4]}}


@pytest.mark.parametrize("order", [(0, 2, 1, 3), (0, 1, 2, 3)])
def test_quick_commands_that_speeds_follow_late_keep_their_order(order):
    """At 8 Hz the speeds lag by more than a quarter of a period: as they are, own commands are the least alike."""
    t = np.arange(0.0, 20.0, 0.002)
    phases = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 4)
    commands = np.sin(2.0 * np.pi * 8.0 * t[:, None] + phases)
    table = pd.DataFrame({"t": t} | {f"command{i + 1}": commands[:, k] for i, k in enumerate(order)})
    own = pd.DataFrame(commands)
    late = rotor_order._lagged(rotor_order._lagged(own, 0.025, 0.002), 0.025, 0.002).to_numpy()
    table = table.assign(**{f"w{i + 1}": late[:, k] for i, k in enumerate((0, 2, 1, 3))})
    assert np.mean(late * commands) < 0.0
    assert rotor_order._order_of_commands([table], (0, 2, 1, 3)) == order


def test_the_right_order_a_weak_rotor_and_flights_of_two_orders_are_left_alone(flights, model):
    assert find_rotor_order(flights, model) is None
    weak = [replace(f, filtered=f.filtered.assign(w2=0.85 * f.filtered["w2"])) if f.compared else f for f in flights]
    assert find_rotor_order(weak, model) is None
    assert find_rotor_order([*flights[:3], logged(flights[3], (2, 1, 0, 3), True)], model) is None


def test_a_gentle_flight_that_shows_little_by_itself_goes_with_the_others(flights, model):
    """A ramp with log odds of 6.5 had kept three circles with 24 and more from being put right (NanoBench)."""
    shaken = np.random.default_rng(9).standard_normal((len(flights[3].filtered), 3))
    table = flights[3].filtered.assign(
        **{a: flights[3].filtered[a] + 0.4 * shaken[:, k] for k, a in enumerate(AXES[3:])}
    )
    gentle = replace(flights[3], filtered=table, imported=table)
    found = find_rotor_order([logged(f, (1, 0, 2, 3), True) for f in [*flights[:3], gentle]], model)
    assert found.speeds == (1, 0, 2, 3)
    assert 0.0 < found.odds["f3"] < 7.7 < found.odds["f2"]


def test_moments_that_the_model_predicts_in_no_order_show_none(flights, model):
    """Of orders that explain nothing, the one that predicts least leaves least: a log without yaw has no Mz."""
    rng = np.random.default_rng(3)
    silent = {a: 1e-4 * rng.standard_normal(len(flights[2].filtered)) for a in ("Mx", "My", "Mz")}
    other = [logged(f, (0, 1, 3, 2), True) for f in flights]
    blind = [f if not f.compared else replace(f, filtered=f.filtered.assign(**silent)) for f in other]
    assert find_rotor_order(blind, model) is None


def test_a_model_that_contradicts_its_configuration_shows_no_order(flights, model):
    """Reference flights in a wrong order: the compared ones, in the right one, are not at fault."""
    wrong = Model({**model.document, "contradictions": ["rotor 1 pushes as if it were aft left"]})
    assert find_rotor_order([logged(f, (2, 1, 0, 3), True) for f in flights], wrong) is None


def test_the_finding_reaches_calibration_and_words(flights, model):
    wrong = [logged(f, (2, 1, 0, 3), True) for f in flights]
    effects = {n: catalogue()[n] for n in (ID, "inertia")}
    calibration, _ = sensors_and_drive.examine(wrong, model.document, SETTINGS, effects)
    rotors = {"order of speeds": [3, 2, 1, 4], "order of commands": [3, 2, 1, 4]}
    assert for_flight(calibration, True)["rotors"] == rotors
    assert for_flight(calibration, False) is None
    effect = effect_of(calibration["rotor order"])
    assert {n: p["value"] for n, p in effect["parameters"].items()} == {"rotor1": 3, "rotor3": 1}
    assert happening(effect, effects) == "in the compared flights rotor columns 1 and 3 are exchanged"
    assert verdict_of([effect], [], []) == "explained"


def test_orders_in_words():
    assert sentence_of((1, 0, 3, 2)) == "rotor columns 1 and 2, and 3 and 4 are exchanged"
    assert sentence_of((1, 2, 0, 3)).endswith("column 2 holds rotor 1, column 3 holds rotor 2, column 1 holds rotor 3")


def test_import_puts_columns_right():
    t, rng = np.arange(50) / 100.0, np.random.default_rng(1)
    names = [*(f"w{i}" for i in range(1, 5)), *(f"command{i}" for i in range(1, 5)), "w2_CMD", "battery_voltage"]
    others = {n: Track(t, rng.random((50, 1))) for n in names}
    rotors = Track(t, np.hstack([others[f"w{i}"].values for i in range(1, 5)]))
    still = Track(t, np.zeros((50, 3)))
    board = Onboard(still, still, None, "onboard", 0.0, None, None, None, others, rotors)
    order = {"order of speeds": [2, 3, 1, 4], "order of commands": [1, 4, 3, 2]}
    right = calibrated_onboard(board, {"rotors": order})
    now, before = ({n: track.values[:, 0] for n, track in b.others.items()} for b in (right, board))
    held_by = {"w1": "w2", "w2": "w3", "w3": "w1", "w4": "w4", "command2": "command4", "command1": "command1",
               "w4_CMD": "w2_CMD", "battery_voltage": "battery_voltage"}  # fmt: skip
    for rotor, column in held_by.items():
        np.testing.assert_array_equal(now[rotor], before[column])
    np.testing.assert_array_equal(right.rotors.values, rotors.values[:, [1, 2, 0, 3]])


def test_an_order_names_every_rotor_once():
    assert is_identity({"rotors": {"order of speeds": [1, 2, 3, 4]}})
    assert not is_identity({"rotors": {"order of commands": [1, 2, 4, 3]}})
    with pytest.raises(ConfigError, match="each of 1, 2, 3, 4 once"):
        check({"rotors": {"order of speeds": [1, 1, 3, 4]}})
