"""What no cause explains is found where it was planted, noise is nothing; and the polynomial of a cause's size."""

import dataclasses
import functools
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from made_model import simple_model
from scipy.signal import lfilter

from quasi.airframe import read_airframe
from quasi.gap.catalogue import catalogue
from quasi.gap.effect import Effect, Parameter, vehicle_of
from quasi.gap.flights.covariates import ROOM_PLACE, basis_of, places
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces import reproducibility as recurring
from quasi.gap.levels.forces import unexplained
from quasi.gap.levels.forces.error_reduction import wrench_score
from quasi.gap.levels.forces.joint_fit import _less
from quasi.gap.levels.forces.polynomial_baseline import polynomial
from quasi.gap.levels.forces.smooth_functions import Place, _certain, _Sums
from quasi.gap.levels.forces.unexplained import outdone, search
from quasi.gap.statistics.candidates import Candidate
from quasi.model.model import AXES
from quasi_synthesis.campaign import quadrotor_configuration, read_campaign

RATE, SECONDS = 100.0, 40.0
ROWS = int(RATE * SECONDS)
NOISE = np.array([0.03, 0.03, 0.03, 5e-4, 5e-4, 1e-4])


def smooth(rng, size, seconds=1.5, rows=ROWS):
    a = np.exp(-1.0 / (RATE * seconds))
    x = lfilter([1.0], [1.0, -2 * a, a * a], rng.standard_normal(rows))
    return size * (x - x.mean()) / x.std()


@pytest.fixture(scope="module")
def ground():
    campaign = read_campaign({"flights": [{"key": "a"}]}, "t")
    airframe = read_airframe(quadrotor_configuration(campaign), "made", 0.433)
    thrust = 0.433 * 9.81 / (4 * 2110.0**2)
    return airframe, simple_model(airframe, thrust, 0.01 * thrust)


@functools.cache
def flown(seed, rows):
    """Columns and noise of a smooth random flight."""
    rng, smooth_ = np.random.default_rng(seed), functools.partial(smooth, rows=rows)
    columns = {"t": np.arange(rows) / RATE}
    sizes = {"u": 2.0, "v": 2.0, "w": 0.5, "p": 1.0, "q": 1.0, "r": 1.0, "roll": 0.2, "pitch": 0.2, "yaw": 1.5}
    columns |= {name: smooth_(rng, size) for name, size in sizes.items()}
    columns |= {"x": smooth_(rng, 1.5), "y": smooth_(rng, 1.5), "z": -1.2 + smooth_(rng, 0.4)}
    columns |= {f"w{i}": 2110.0 + smooth_(rng, 80.0, 0.2) for i in range(1, 5)}
    columns |= {f"w{i}_dot": np.gradient(columns[f"w{i}"]) * RATE for i in range(1, 5)}
    return columns, np.stack([smooth_(rng, s, 0.02) for s in NOISE], axis=1)


SLOPES: dict[tuple, dict] = {}  # of the model, which knows nothing of place and heading, by flight


def flight(ground, seed, planted=None, rows=ROWS):
    """A flight; planted(columns) -> (n, 6) is what the model does not know, beside coloured noise."""
    airframe, model = ground
    columns, noise = flown(seed, rows)
    columns = {name: values.copy() for name, values in columns.items()}
    predicted = model.predict_columns(pd.DataFrame(columns))[list(AXES)].to_numpy()
    wrong = planted(columns) if planted else np.zeros((rows, 6))
    made = Evidence(f"f{seed}", airframe, model, 0.433, airframe.inertia, columns, predicted + wrong + noise, predicted)
    made.__dict__["_slopes"] = SLOPES.setdefault((seed, rows), {})
    return made


def only(k, values):
    wrench = np.zeros((len(values), 6))
    wrench[:, k] = values
    return wrench


def found(ground, planted, references=0):
    rows = 3000
    flights = [flight(ground, s, planted if s >= references else None, rows) for s in range(references + 5)]
    held = [flight(ground, 90, planted, rows)]
    compared = [s >= references for s in range(references + 5)]
    vehicle = vehicle_of(ground[1])
    return search(flights, compared, held, [], lambda f: f.residual, NOISE**2, vehicle, 0.01, 0.05)[0]


def test_noise_alone_is_nothing(ground):
    assert found(ground, None) == []


def test_a_residual_is_found_in_its_channel_along_its_variable(ground):
    said = found(ground, lambda c: only(1, 0.1 * np.tanh(3.0 * (-c["z"] - 1.2))))
    assert (said[0]["channel"], said[0]["where"], said[0]["since"]) == ("Fy", "height", "always")
    assert said[0]["share"] > 0.8 and len(said) == 1


def test_a_residual_along_the_heading_is_periodic(ground):
    said = found(ground, lambda c: only(5, 4e-4 * np.sin(c["yaw"] + 1.0)))
    assert [(u["channel"], u["where"]) for u in said] == [("Mz", "heading")]


def test_a_force_that_turns_with_the_direction_of_flight_is_found(ground):
    # of a side force by the forward speed, RotorPy's flights `agreed`: it has no mean at any speed without direction
    said = found(ground, lambda c: only(1, 0.05 * c["u"] * np.abs(c["u"])), references=4)
    assert [(u["channel"], u["where"], u["since"]) for u in said] == [("Fy", "forward speed", "changed")]


def test_beside_reference_flights_it_is_told_what_changed(ground):
    said = found(ground, lambda c: only(2, 0.1 * np.tanh(c["x"])), references=4)
    assert (said[0]["channel"], said[0]["where"], said[0]["since"]) == ("Fz", "room x", "changed")


def test_what_changed_is_told_although_all_flights_lack_something_in_the_same_channel(ground):
    def all_lack(c):
        return 0.05 * np.tanh(np.hypot(c["u"], c["v"]) - 1.5)

    flights = [
        flight(ground, s, lambda c, on=s >= 4: only(2, all_lack(c) + on * 0.05 * np.tanh(c["x"]))) for s in range(8)
    ]
    held = [flight(ground, 90, lambda c: only(2, all_lack(c) + 0.05 * np.tanh(c["x"])))]
    compared = [s >= 4 for s in range(8)]
    said = search(flights, compared, held, [], lambda f: f.residual, np.full(6, np.inf), vehicle_of(ground[1]), 0.01,
                  0.05)[0]  # fmt: skip
    assert ("Fz", "room x", "changed") in {(u["channel"], u["where"], u["since"]) for u in said}


@pytest.mark.parametrize("drag", [0.0, 0.001])
def test_a_cause_gives_way_to_a_place_that_explains_it_away_and_stays_where_it_is_there(ground, drag):
    effect, offer = catalogue()["body_drag"], Candidate("body_drag", "changed", (0,))

    def dragged(c):
        velocity = np.stack([c["u"], c["v"], c["w"]], axis=1)
        return np.hstack([-drag * np.linalg.norm(velocity, axis=1)[:, None] * velocity, np.zeros((ROWS, 3))])

    def planted(c):
        return dragged(c) + only(0, 0.2 * np.exp(-(c["x"] ** 2 + c["y"] ** 2)))

    flights = [flight(ground, s, planted if s >= 4 else None) for s in range(8)]
    compared = [s >= 4 for s in range(8)]
    left = search(
        flights,
        compared,
        [flight(ground, 90, planted)],
        [(effect, offer, {})],
        lambda f: f.residual - dragged(f.columns),
        np.full(6, np.inf),
        vehicle_of(ground[1]),
        0.01,
        0.05,
    )
    assert ("Fx", "room place") in [(AXES[p.channel], p.choice.where) for p, _ in left.reported]
    why = outdone(left, compared, [offer], offer, ["Fx"], 1e-5, 1e-4, 0.005)
    assert ("room place" in why) is (drag == 0.0)
    assert not outdone(left, compared, [offer], offer, ["Mx"], 1e-5, 1e-4, 0.005)  # another channel


def test_a_constant_error_of_the_held_out_flight_does_not_hide_what_is_wrong_there(ground):
    def planted(c, constant=0.0):
        return only(3, 1.2e-3 * np.tanh(c["x"]) + constant)

    flights = [flight(ground, s, planted if s >= 4 else None) for s in range(9)]
    held = [flight(ground, 90, lambda c: planted(c, 8e-3))]
    compared = [s >= 4 for s in range(9)]
    said = search(flights, compared, held, [], lambda f: f.residual, NOISE**2, vehicle_of(ground[1]), 0.01, 0.05)[0]
    assert [(u["channel"], u["where"], u["since"]) for u in said] == [("Mx", "room x", "changed")]
    assert said[0]["share"] > 0.5


def test_places_are_what_their_names_say(ground):
    one = flight(ground, 1)
    at = places(one)
    np.testing.assert_allclose(at["speed"], np.sqrt(sum(one.columns[a] ** 2 for a in "uvw")))
    np.testing.assert_allclose(at["height"], -one.columns["z"])
    level = np.flatnonzero(np.hypot(one.columns["roll"], one.columns["pitch"]) < 0.02)
    sinking = level[one.columns["w"][level] > 0.3]
    np.testing.assert_allclose(at["descent ratio"][sinking] * one.hover_induced, one.columns["w"][sinking], atol=0.12)


def test_a_polynomial_of_the_right_size_takes_away_what_is_one(ground):
    learn = [flight(ground, s, lambda c: only(3, 0.01 * c["u"] * c["v"])) for s in (1, 2)]
    held = flight(ground, 9, lambda c: only(3, 0.01 * c["u"] * c["v"]))
    left = polynomial(learn, 1)(held)
    assert np.std(held.residual[:, 3]) > 0.02
    np.testing.assert_allclose(np.std(left[:, 3]), NOISE[3], rtol=0.2)
    np.testing.assert_array_equal(left[:, 0], held.residual[:, 0])


def test_a_fan_is_found_at_its_place_in_the_room(ground):
    def fan(c):
        return only(2, -0.3 * np.exp(-((c["x"] - 1.2) ** 2 + (c["y"] + 0.8) ** 2)))

    flights, held = [flight(ground, s, fan) for s in range(5)], [flight(ground, s, fan) for s in (90, 91)]
    vehicle, floor = vehicle_of(ground[1]), np.full(6, np.inf)
    said = search(flights, [True] * 5, held, [], lambda f: f.residual, floor, vehicle, 0.01, 0.05)[0]
    assert (said[0]["channel"], said[0]["where"]) == ("Fz", "room place")
    np.testing.assert_allclose(said[0]["mostly"][0], (1.2, -0.8), atol=0.6)


def test_what_comes_loose_is_found_in_time(ground):
    said = found(ground, lambda c: only(3, 3e-3 * (c["t"] > 20.0)), references=3)
    assert (said[0]["channel"], said[0]["where"], said[0]["since"]) == ("Mx", "time", "changed")
    assert said[0]["mostly"][0][0] == pytest.approx(20.0, abs=1.0)


def test_a_pull_alike_everywhere_is_told_beside_reference_flights(ground):
    said = found(ground, lambda c: only(1, np.full_like(c["t"], 0.4)), references=4)
    assert [(u["channel"], u["where"], u["since"]) for u in said] == [("Fy", "everywhere", "changed")]


@pytest.mark.parametrize(("moved", "placed"), [(0.0015, False), (0.004, True)])
def test_a_moment_that_follows_thrust_as_a_battery_makes_it_is_no_error_along_the_rotor_speed(ground, moved, placed):
    """Millimetres that sessions usually differ by; a clean set of an independent generator had an unexplained Mx."""
    factor = 0.433 * 9.81 / (4 * 2110.0**2)
    said = found(ground, lambda c: only(3, moved * factor * sum(c[f"w{i}"] ** 2 for i in range(1, 5))), references=4)
    assert {u["channel"] for u in said} == {"Mx"}
    assert ("rotor speed" in [u["where"] for u in said]) == placed


def test_a_place_that_each_flight_had_to_itself_is_not_blamed(ground):
    """Each flight turns once, to a heading of its own, and is off from then on by something of its own."""

    def own(c):
        rng = np.random.default_rng(int(1e6 * abs(c["u"][0])))
        late = c["t"] > 20.0
        c["yaw"][:] = 0.05 * c["yaw"] + np.where(late, rng.uniform(-3.0, 3.0), 0.0)
        return only(5, np.where(late, rng.choice([-1.0, 1.0]) * 1e-3, 0.0))

    assert not [u for u in found(ground, own, references=4) if u["where"] == "heading"]


@pytest.mark.parametrize(("between", "told"), [(1.1, True), (0.002, False)])
def test_manoeuvres_of_one_flight_that_err_alike_are_one_witness_of_a_place(ground, monkeypatch, between, told):
    """Each flight has a slope of its own along the room, by chance mostly to one side."""
    monkeypatch.setattr(recurring, "BETWEEN", between)
    sizes = [0.0, 0.1, -0.1, 0.05, 1.6, 0.9, 0.35, 0.8]
    flights = [flight(ground, s, lambda c, k=k: only(5, k * 2e-4 * c["x"])) for s, k in enumerate(sizes)]
    held = [flight(ground, 90, lambda c: only(5, 2e-4 * c["x"]))]
    compared = [s > 3 for s in range(8)]
    vehicle, floor = vehicle_of(ground[1]), np.full(6, np.inf)
    said = search(flights, compared, held, [], lambda f: f.residual, floor, vehicle, 0.01, 0.05)[0]
    assert [(u["channel"], u["where"], u["since"]) for u in said] == [("Mz", "room x", "changed")] * told


@pytest.mark.parametrize(("size", "heard"), [(4e-4, 0.3), (3.5e-5, 0.0), (3.5e-5, 0.3)])
def test_a_held_out_flight_that_does_not_go_there_cannot_judge(ground, monkeypatch, size, heard):
    """Then only what is a good part of the error where it was found is told."""
    monkeypatch.setattr(unexplained, "UNHEARD", heard)

    def push(c):
        return only(5, size * c["x"])

    def still(c):
        c["x"][:] = 0.3
        return push(c)

    flights, held = [flight(ground, s, push if s > 3 else None) for s in range(8)], [flight(ground, 90, still)]
    vehicle, floor = vehicle_of(ground[1]), np.full(6, np.inf)
    compared = [s > 3 for s in range(8)]
    said = search(flights, compared, held, [], lambda f: f.residual, floor, vehicle, 0.01, 0.05)[0]
    told = size > 1e-4 or heard == 0.0
    assert [(u["channel"], u["where"], u["judged"]) for u in said] == [("Mz", "room x", False)] * told


@pytest.mark.parametrize(
    ("axis", "wrong", "still", "sizes", "told"),
    [
        (5, lambda c: 4e-4 * c["x"], "x", [1.0, 1.0, 1.0, 1.0, 1.0], True),
        # flights that differ in it by more than it is are not sure of it
        (5, lambda c: 4e-4 * c["x"], "x", [1.9, 0.3, 1.6, 0.2, 1.5], False),
        # along its own motion it may be the form of the model's terms
        (4, lambda c: 1e-3 * np.abs(c["q"]), "q", [1.0, 1.0, 1.0, 1.0, 1.0], False),
    ],
)
def test_where_no_flight_is_healthy_flights_left_out_may_be_sure_of_a_place(ground, axis, wrong, still, sizes, told):
    """The held-out flight does not go there and cannot be."""

    def away(c):
        c[still][:] = 0.01
        return only(axis, wrong(c))

    flights = [flight(ground, s, lambda c, k=k: only(axis, k * wrong(c))) for s, k in enumerate(sizes)]
    vehicle, floor = vehicle_of(ground[1]), np.full(6, np.inf)
    left = search(flights, [True] * 5, [flight(ground, 90, away)], [], lambda f: f.residual, floor, vehicle, 0.01, 0.05)
    assert [(u["channel"], u["where"], u["judged"]) for u in left.entries] == [("Mz", "room x", False)] * told


def test_what_changed_along_own_motions_is_told_though_the_held_out_flight_cannot_judge(ground):
    """A brake of pitch: beside healthy flights it is no form of the model's own terms."""

    def brake(c):
        return only(4, -1e-3 * c["q"])

    def still(c):
        c["q"][:] = 0.01
        return brake(c)

    held, vehicle, floor = [flight(ground, 90, still)], vehicle_of(ground[1]), np.full(6, np.inf)

    def said(healthy):
        flights = [flight(ground, s, brake if s >= healthy else None) for s in range(8)]
        compared = [s >= healthy for s in range(8)]
        told = search(flights, compared, held, [], lambda f: f.residual, floor, vehicle, 0.01, 0.05)[0]
        return [(u["channel"], u["where"], u["since"], u["judged"]) for u in told]

    assert said(4) == [("My", "pitch rate", "changed", False)]
    assert said(0) == []


def test_two_flights_are_enough(ground):
    flights = [flight(ground, s, lambda c: only(5, 4e-4 * c["x"])) for s in (1, 2)]
    held = [flight(ground, 90, lambda c: only(5, 4e-4 * c["x"]))]
    vehicle, floor = vehicle_of(ground[1]), np.full(6, np.inf)
    said, table, *_ = search(flights, [True] * 2, held, [], lambda f: f.residual, floor, vehicle, 0.01, 0.05)
    assert (said[0]["channel"], said[0]["where"]) == ("Mz", "room x")
    # the mean error in each cell is what was planted there, from each flight's mean
    own = table[(table["channel"] == "Mz") & (table["where"] == "room x")]
    slope = np.polyfit(own["middle"], own["mean"], 1)[0]
    assert slope == pytest.approx(4e-4, rel=0.1) and np.corrcoef(own["mean"], own["fit"])[0, 1] > 0.98


@pytest.mark.parametrize(("drawn", "drift", "told"), [(0.02, 0.0, 0), (0.0, 0.12, 1)])
def test_two_places_that_go_together_do_not_hold_each_other(ground, drawn, drift, told):
    """The volts fall with time and by what the load draws. A force of 0.02 N goes with the load: a function of volts
    tells it as 0.045 N, if an opposite one of time takes off the rest of the volts. A drift is told, once."""

    def sagging(c):
        load = smooth(np.random.default_rng(int(1e6 * abs(c["u"][0]))), 1.0, 0.3, len(c["t"]))
        c["battery_voltage"] = 16.5 - 0.02 * c["t"] - 0.25 * load
        return only(2, drawn * load + drift * (c["t"] / 90.0 - 0.5))

    flights = [flight(ground, s, sagging, 9000) for s in range(4)]
    held, vehicle = [flight(ground, 90, sagging, 9000)], vehicle_of(ground[1])
    said = search(flights, [True] * 4, held, [], lambda f: f.residual, NOISE**2, vehicle, 0.01, 0.05)[0]
    assert [u["channel"] for u in said if u["where"] in ("time", "volts")] == ["Fz"] * told


@pytest.mark.parametrize(("floor", "share"), [(0.0, 0.9), (0.95, None), (2.0, None)])
def test_no_share_is_told_where_nothing_is_removable(ground, floor, share):
    """floor  that the best fit leaves of the squared error"""

    def push(c):
        return only(5, 4e-4 * c["x"])

    flights, held = [flight(ground, s, push) for s in (1, 2)], [flight(ground, 90, push)]
    vehicle = vehicle_of(ground[1])
    least = floor * wrench_score(held, lambda f: f.residual).mean()
    [told] = search(flights, [True] * 2, held, [], lambda f: f.residual, least, vehicle, 0.01, 0.05)[0]
    assert told["judged"] and told["size"] == pytest.approx(4e-4 * 1.5, rel=0.1)
    assert told["share"] == pytest.approx(share, abs=0.1) if share else told["share"] is None


def jerky(ground, seed, planted):
    """A flight with three quick flips a flight, on pitch alone, of a tenth of a second each."""
    plain = flight(ground, seed)
    columns = dict(plain.columns)
    at = np.arange(ROWS) / RATE
    flips = sum(s * np.exp(-(((at - t) / 0.08) ** 2)) for t, s in ((7.0 + 0.3 * seed, 1), (18.0, -1), (31.0, 1)))
    columns["q"] = columns["q"] + 9.0 * flips
    predicted = ground[1].predict_columns(pd.DataFrame(columns))[list(AXES)].to_numpy()
    measured = predicted + plain.residual + (planted(columns) if planted else 0.0)
    made = dataclasses.replace(plain, columns=columns, measured=measured, predicted=predicted)
    made.__dict__.pop("_slopes", None)
    return made


def test_what_lives_in_a_hundredth_of_the_time_is_told_along_its_rate(ground):
    """A brake by the cube of the pitch rate acts in flips alone: beyond what is met nearly all the time."""

    def brake(c):
        return only(4, -5e-6 * c["q"] ** 3)

    flights = [jerky(ground, s, brake if s >= 4 else None) for s in range(8)]
    said = search(flights, [s >= 4 for s in range(8)], [jerky(ground, 90, brake)], [], lambda f: f.residual,
                  np.full(6, np.inf), vehicle_of(ground[1]), 0.01, 0.05)[0]  # fmt: skip
    assert [(u["channel"], u["where"], u["since"]) for u in said] == [("My", "pitch rate", "changed")]


def test_products_without_functions_are_those_of_the_columns_without_them():
    rng = np.random.default_rng(3)
    columns, basis = rng.standard_normal((200, 6, 5)), rng.standard_normal((200, 3))
    functions = [
        (SimpleNamespace(channel=2, choice=SimpleNamespace(which=(0, 2))), np.array([0.5, -1.0])),
        (SimpleNamespace(channel=2, choice=SimpleNamespace(which=(1,))), np.array([2.0])),
        (SimpleNamespace(channel=4, choice=SimpleNamespace(which=(1,))), np.array([-0.7])),
    ]
    left = columns.copy()
    left[:, 2, 0] -= basis @ np.array([0.5, 2.0, -1.0])
    left[:, 4, 0] -= basis[:, 1] * -0.7
    before, expected = (np.einsum("nki,nkj->kij", c, c) for c in (columns, left))
    np.testing.assert_allclose(_less(before, columns, basis, functions), expected, atol=1e-10)


def test_a_cause_that_does_nothing_in_held_out_flights_stays_among_the_columns(ground):
    """Its column was left out of theirs, and the search ended with shapes that do not fit."""
    fast = Effect("fast", "forces", "", "", "", {"c": Parameter("N s/m", 0.0, "a", -5.0, 5.0, 0.05)}, ("Fx",),
                  terms=lambda _: {"c": {"Fx": "0.5*(u - 3 + ((u - 3)^2)^0.5)"}})  # fmt: skip

    def layered(columns):
        return only(2, 0.2 * np.tanh((columns["z"] + 1.2) / 0.3))

    held = flight(ground, 90, layered)
    held = dataclasses.replace(held, columns={**held.columns, "u": 0.2 * held.columns["u"]})
    flights, causes = [flight(ground, s, layered) for s in range(5)], [(fast, Candidate("fast", "always", (0,)), {})]
    vehicle = vehicle_of(ground[1])
    left = search(flights, [True] * 5, [held], causes, lambda f: f.residual, NOISE**2, vehicle, 0.01, 0.05)
    assert [(e["channel"], e["where"]) for e in left.entries] == [("Fz", "height")]


def test_time_varies_however_long_the_log_lay_on_the_ground(ground):
    """Forty seconds after an hour were a fiftieth of the time, and no variable at all."""
    one = flight(ground, 0)
    late = dataclasses.replace(one, columns={**one.columns, "t": one.columns["t"] + 3600.0})
    assert [c.at for c in basis_of([late]).choices if c.where == "time" and c.at] == [
        pytest.approx((3600.0 + k * SECONDS / 6,), abs=0.1) for k in range(1, 6)
    ]


def test_a_constant_error_makes_no_share_of_what_depends_on_a_place_larger(ground):
    """Held against a floor with the constant error, what layers make had been all that could be removed."""

    def wrong(columns, constant=0.0):
        layers = 0.06 * np.tanh((columns["z"] + 1.2) / 0.3)
        return only(2, layers + 0.01 * columns["u"] * columns["v"] + constant)

    flights, floor = [flight(ground, s, wrong) for s in range(5)], NOISE**2
    shares = []
    for constant in (0.0, 0.12):
        held, best = [flight(ground, 90, lambda c, k=constant: wrong(c, k))], floor + only(2, [constant**2])[0]
        left = search(
            flights, [True] * 5, held, [], lambda f: f.residual, best, vehicle_of(ground[1]), 0.01, 0.05, floor
        )
        (entry,) = left.entries
        assert (entry["channel"], entry["where"]) == ("Fz", "height")
        shares.append(entry["share"])
    assert 0.6 < shares[0] < 0.9 and shares == pytest.approx([shares[0]] * 2, rel=0.01)


@pytest.mark.parametrize("logged", ["not at all", "but for a sample"])
def test_no_function_is_offered_along_what_a_held_out_flight_does_not_know(ground, logged):
    """Of the voltage that a held-out flight did not log, the diagnosis ended without a word."""

    def flown_with(seed, volts):
        one = flight(ground, seed, lambda c: only(2, 0.2 * np.tanh((c["z"] + 1.2) / 0.3)))
        return dataclasses.replace(one, columns=one.columns | volts(one.columns["t"]))

    flights = [flown_with(s, lambda t: {"battery_voltage": 16.0 - 0.03 * t}) for s in range(5)]
    gap = {
        "not at all": lambda t: {},
        "but for a sample": lambda t: {"battery_voltage": np.where(t == t[9], np.nan, t)},
    }
    vehicle, held = vehicle_of(ground[1]), [flown_with(90, gap[logged])]
    left = search(flights, [True] * 5, held, [], lambda f: f.residual, NOISE**2, vehicle, 0.01, 0.05)
    assert [(e["channel"], e["where"]) for e in left.entries] == [("Fz", "height")]


def test_a_line_along_a_side_of_the_room_adds_nothing_to_a_polynomial_of_the_floor_that_holds_it(ground):
    basis = basis_of([flight(ground, seed) for seed in (1, 2)])
    floor = next(c for c in basis.choices if c.where == ROOM_PLACE and not c.at)
    line = next(c for c in basis.choices if c.where == "room x" and len(c.which) == 1)
    width = 1 + max(k for c in basis.choices for k in c.which)
    columns = np.random.default_rng(3).standard_normal((200, 1 + 2 * width))
    sums = [_Sums(columns.T @ columns / 200, 0, width, 14.0)] * 6
    other = next(c for c in basis.choices if c.where == "height")
    offered = [Place(0, c, "changed") for c in (line, other)]
    certain = _certain(sums, [Place(0, floor, "changed")], offered)
    assert certain[offered[0]] == 1.0 and 0.0 <= certain[offered[1]] < 1.0
