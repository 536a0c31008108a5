"""Ties settled by forces and moments: axes turned by rotating what instruments see; the rule on plain numbers."""

from dataclasses import replace

import numpy as np
import pytest
from plain_plant import made_model, with_simple_model
from scipy.spatial.transform import Rotation
from test_gap_halves import flown as fly

from quasi import attitude
from quasi.gap.flights.level import Flown, Level
from quasi.gap.levels.corrections import document
from quasi.gap.levels.tie_breaking import compare, judged, settle
from quasi.importing.calibration import check
from quasi.model.columns import ROTORS
from quasi.model.model import AXES

TURN = np.array([0.03, -0.04, 0.01])
PAIR = ["imu_misalignment", "mocap_misalignment"]
VELOCITY = (("u", "v", "w"),)
ALARM = 0.01 / 3.0


def turned(table, vector, groups):
    """Vectors of the table as seen in axes that are turned by `vector` against the true ones."""
    seen = Rotation.from_rotvec(vector).inv()
    return table.assign(**{c: v for g in groups for c, v in zip(g, seen.apply(table[list(g)].to_numpy(copy=True)).T)})


def felt(table, vector, inertia):
    """The flight as an IMU feels it that is turned by `vector`: forces, rates, and moments that follow from these."""
    w, m = table[list("pqr")].to_numpy(), table[["Mx", "My", "Mz"]].to_numpy()
    spin_up = Rotation.from_rotvec(vector).inv().apply((m - np.cross(w, w @ inertia)) @ np.linalg.inv(inertia))
    anew = turned(table, vector, (("Fx", "Fy", "Fz"), tuple("pqr")))
    w = anew[list("pqr")].to_numpy()
    moments = spin_up @ inertia + np.cross(w, w @ inertia)
    return anew.assign(**dict(zip(("Mx", "My", "Mz"), moments.T)))


@pytest.fixture(scope="module")
def model():
    return with_simple_model(made_model(reaction=0.0), 0.01)


@pytest.fixture(scope="module")
def flights(model):
    """Two reference flights and three to compare, all healthy: turned by each test."""
    return healthy(model, 0.05)


def healthy(model, noise):
    table, _ = fly(model, model, noise=0.0)
    made, scale = [], noise * np.array([1.0, 1.0, 1.0, 0.02, 0.02, 0.02])
    for k in range(5):
        noise = scale * np.random.default_rng(k).standard_normal((len(table), 6))
        noisy = table.assign(**dict(zip(AXES, (table[list(AXES)].to_numpy() + noise).T)))
        made.append(Flown(f"f{k}", k > 1, noisy, {}, noisy, {}, model.airframe))
    return made


def tie(turn=TURN, since="changed"):
    """What the comparison of sensors says of a turn between IMU and markers."""
    names = ("roll", "pitch", "yaw")
    return {
        "ids": list(PAIR), "since": since, "p": 1e-6, "wald": 50.0, "share of resamples": 1.0, "separability": 0.0,
        "parameters": {i: {n: {"value": s * v, "std": 1e-3, "unit": "rad"} for n, v in zip(names, turn)}
                       for i, s in zip(PAIR, (1.0, -1.0))},
    }  # fmt: skip


def process(flown, calibration):
    """Stands in for import and filter: turns back what the calibration says is turned."""
    whole = check(calibration)
    table = felt(flown.filtered, -whole["imu"]["misalignment"], flown.airframe.inertia)
    marked = whole["capture"]["misalignment"]
    table = turned(table, -marked, VELOCITY)
    q = attitude.from_euler(*table[["roll", "pitch", "yaw"]].to_numpy().T)
    euler = attitude.to_euler(attitude.multiply(q, attitude.exponential(-marked)))
    return replace(flown, filtered=table.assign(**dict(zip(("roll", "pitch", "yaw"), euler.T))))


def affected(flights, cause):
    """IMU turned, or markers turned the other way: the comparison of sensors sees the same."""
    made = []
    for f in flights:
        table = f.filtered
        if f.compared and cause == PAIR[0]:
            table = felt(table, TURN, f.airframe.inertia)
        elif f.compared:
            table = turned(table, -TURN, VELOCITY)
        made.append(replace(f, filtered=table))
    return made


@pytest.mark.parametrize("cause", PAIR)
def test_of_turned_imu_and_turned_markers_the_one_that_is_turned_is_named(cause, flights, model):
    level = Level("sensors", ties=[tie()])
    assert settle([level], affected(flights, cause), model, ALARM, process) == [cause]
    assert not level.ties
    assert [e["id"] for e in level.effects] == [cause]
    assert level.effects[0]["since"] == "changed"
    (lost,) = level.candidates
    assert lost["id"] != cause and "leaves more of forces and moments" in lost["why_not"]


def test_a_turn_of_less_than_flights_differ_by_stays_a_tie(flights, model):
    small = 0.002 * TURN / np.linalg.norm(TURN)
    made = [replace(f, filtered=felt(f.filtered, small, f.airframe.inertia)) if f.compared else f for f in flights]
    level = Level("sensors", ties=[tie(small)])
    assert settle([level], made, model, ALARM, process) == []
    assert level.ties and not level.effects
    assert "stay a tie" in level.notes[0]


def test_a_turn_that_all_flights_have_stays_a_tie_whatever_the_model_leaves(flights, model):
    level = Level("sensors", ties=[tie(since="always")])
    assert settle([level], affected(flights, PAIR[0]), model, ALARM, process) == []
    assert level.ties and "the model's own terms may hold it" in level.notes[0]


def test_the_lead_of_a_hypothesis_is_what_its_turn_costs_beyond_seating(flights, model):
    """Seating of 0.2 deg takes up a turned force of x at the price (x / 0.0035)^2: so the lead is about that."""
    turn = np.array([0.0, 0.02, 0.0])
    made = [replace(f, filtered=felt(f.filtered, turn, f.airframe.inertia)) if f.compared else f for f in flights]
    left = compare([Level("sensors", ties=[tie(turn)])], tie(turn), made, model, process)
    lead = left[:, 1] - left[:, 0]
    # moments and constant forces have spreads of their own and take up some
    assert ((lead > 3.0) & (lead < 1.3 * (0.02 / 0.0035) ** 2)).all(), lead


@pytest.mark.parametrize(
    ("lead", "settled"),
    [
        ([30.0, 40.0, 50.0], True),
        ([30.0, -2.0, 50.0], True),  # that flight says nothing
        ([300.0, -20.0, 50.0], False),  # that flight speaks against it
        ([3000.0, 4.0, 5.0], False),  # one flight alone
        ([8.0, 9.0, 10.0], False),
    ],
)
def test_neither_one_flight_nor_a_contradicted_mean_settles(lead, settled, flights, model, monkeypatch):
    left = np.stack([np.full(3, 1000.0), 1000.0 + np.array(lead)], axis=1)
    monkeypatch.setattr("quasi.gap.levels.tie_breaking.compare", lambda *_: left)
    level = Level("sensors", ties=[tie()])
    assert settle([level], flights, model, ALARM, process) == ([PAIR[0]] if settled else [])
    winner, each, odds = judged(left[:, ::-1])
    assert winner == 1 and odds <= each.mean()


@pytest.mark.parametrize("likelier", [0, 1])
def test_of_a_tie_that_stays_the_flights_are_corrected_for_the_likelier(likelier, flights, model, monkeypatch):
    left = np.stack([np.full(3, 1000.0), np.full(3, 1005.0)], axis=1)[:, [likelier, 1 - likelier]]
    monkeypatch.setattr("quasi.gap.levels.tie_breaking.compare", lambda *_: left)
    level = Level("sensors", ties=[tie()])
    assert settle([level], flights, model, ALARM, process) == []
    assert level.ties[0]["ids"] == [PAIR[likelier], PAIR[1 - likelier]]
    assert [c["id"] for c in document([level])["causes"]] == [PAIR[likelier]]


def test_flights_that_are_valid_at_other_times_leave_the_tie_with_the_reason(flights, model):
    def cut(flown, calibration):
        anew = process(flown, calibration)
        late = check(calibration)["capture"]["misalignment"].any()
        return replace(anew, filtered=anew.filtered.assign(valid=(anew.filtered["t"] > (5.0 if late else 0.0)) * 1.0))

    level = Level("sensors", ties=[tie()])
    assert settle([level], flights, model, ALARM, cut) == []
    assert "f2 is valid at other times" in level.notes[0]


def late_tie(delay, since="changed"):
    """What the comparison of the drive says where rotors answer late."""
    found = {"value": delay, "std": 1e-3, "unit": "s"}
    ids = ["telemetry_delay", "command_delay"]
    return {
        "ids": ids, "since": since, "p": 1e-6, "wald": 50.0, "share of resamples": 1.0, "separability": 0.0,
        "parameters": {i: {"delay": found} for i in ids},
    }  # fmt: skip


def logged_late(flights, delay, lag=0.0):
    """Speeds logged late in the compared flights; thrust lags behind the speeds in all, as they would be logged early.

    Interpolated by the same part of a sample in all flights, so that noise is smoothed alike."""
    made = []
    for f in flights:
        t, late = f.filtered["t"].to_numpy(), (delay if f.compared else 0.0) - lag
        columns = [c for c in f.filtered if c in ROTORS or c.removesuffix("_dot") in ROTORS]
        shown = {c: np.interp(t - late, t, f.filtered[c].to_numpy()) for c in columns}
        made.append(replace(f, filtered=f.filtered.assign(**shown)))
    return made


@pytest.mark.parametrize("lag", [0.0, 0.008])
@pytest.mark.parametrize(("delay", "cause"), [(0.04, "telemetry_delay"), (0.0, "command_delay")])
def test_of_late_telemetry_and_late_commands_the_one_that_is_there_is_named(delay, cause, lag, model):
    """Speeds change slowly in these flights, so that noise has to be low for their delay to show."""
    level = Level("drive", ties=[late_tie(0.04)])
    assert settle([level], logged_late(healthy(model, 1e-4), delay, lag), model, ALARM, process) == [cause], level.notes


def test_a_delay_as_large_as_flights_differ_by_stays_a_tie(flights, model):
    level = Level("drive", ties=[late_tie(0.003)])
    assert settle([level], logged_late(flights, 0.003), model, ALARM, process) == [] and level.ties


def test_late_commands_of_all_flights_stay_a_tie_for_thrust_may_lag(flights, model):
    alike = [replace(f, compared=True) for f in flights]
    level = Level("drive", ties=[late_tie(0.02, "always")])
    assert settle([level], alike, model, ALARM, process) == []
    assert "thrust that lags" in level.notes[0]
