"""Plans: what a trajectory asks of the vehicle, what it could reveal, and the manoeuvres that are proposed."""

import dataclasses
import json
import math

import numpy as np
import pandas as pd
import pytest
from flights import AIRFRAME
from made_model import part
from scipy.signal import lfilter

from quasi import attitude, tables
from quasi.attitude import GRAVITY
from quasi.command import main
from quasi.errors import ConfigError, DataError
from quasi.gap import flight_card, kinematic, plan, plan_noise
from quasi.gap.catalogue import catalogue, columns_of
from quasi.gap.effect import vehicle_of
from quasi.gap.evidence import gather
from quasi.gap.flatness import limits_of, planned, read_plan, turning
from quasi.gap.manoeuvres import library
from quasi.gap.mixed import Offer
from quasi.gap.outlook import Outlook, Repeated, Spread
from quasi.gap.study import gather_study, in_stretches
from quasi.standalone.build import assemble
from quasi.standalone.model import AXES, ROTORS, Model

MASS, ARM, THRUST = 0.433, 0.077 / math.sqrt(2.0), 2.4e-7
HOVER = math.sqrt(MASS * GRAVITY / (4.0 * THRUST))
TERMS = {
    "Fx": {"1": 1e-3, "w_tot*u": -2.6e-5},
    "Fy": {"1": 1e-3, "w_tot*v": -2.6e-5},
    "Fz": {"1": 1e-3, "w1^2 + w2^2 + w3^2 + w4^2": -THRUST, "w_tot*w": -1.5e-5},
    "Mx": {"1": 1e-6, "U_p": THRUST * ARM, "p": -9e-4},
    "My": {"1": 1e-6, "U_q": THRUST * ARM, "q": -9e-4},
    "Mz": {"1": 1e-6, "U_r": -1.8e-9, "r": -1e-3, "u_r_dot": -7e-7},
}
CATALOGUE = catalogue()


def model_of(airframe=AIRFRAME, **more):
    shared = {
        "gravity": "withGravity",
        "hover speed": {"value": HOVER, "unit": "rad/s"},
        "simple model": {"kappaFz": {"value": THRUST, "unit": "-"}, "kappaMz": {"value": 1.8e-9, "unit": "-"}},
        "actuators": None,
        "training flights": ["a"],
        "notes": [],
        **more,
    }
    return Model(assemble({a: part(a, t) for a, t in TERMS.items()}, shared, {"id": "small", "airframe": airframe}))


MODEL = model_of()
VEHICLE = vehicle_of(MODEL)


def begun(t):
    """From 0 to 1 in three seconds, smooth."""
    s = np.clip(t / 3.0, 0.0, 1.0)
    return s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)


def eight(seconds=40.0, turn=0.0, height=1.5, size=1.0):
    """A planned figure: t, x, y, z, yaw at 10 Hz."""
    t = np.arange(0.0, seconds, 0.1)
    s = size * begun(t)
    return pd.DataFrame(
        {"t": t, "x": 2.0 * s * np.sin(1.2 * t), "y": 1.5 * s * np.sin(0.9 * t + 1.0),
         "z": -height + 0.3 * s * np.sin(0.7 * t), "yaw": turn * begun(t) * t}
    )  # fmt: skip


def follow(table, model=MODEL):
    return planned(*read_plan(table, "a plan"), model, "a plan")


# what the vehicle has to do


def test_in_hover_every_rotor_turns_at_hover_speed():
    t = np.arange(20) * 0.5
    table = follow(pd.DataFrame({"t": t, "x": 0.0 * t, "y": 0.0 * t, "z": 0.0 * t - 1.0}))
    # the model's small constants are met, too
    np.testing.assert_allclose(table[list(ROTORS)], HOVER, rtol=5e-4)
    np.testing.assert_allclose(table["az"], -GRAVITY)


def test_a_circle_without_drag_leans_by_the_centripetal_acceleration():
    bare = {**TERMS, "Fx": {"1": 0.0}, "Fy": {"1": 0.0}, "Fz": {"w1^2 + w2^2 + w3^2 + w4^2": -THRUST}}
    document = assemble({a: part(a, t) for a, t in bare.items()}, {**MODEL.document, "training flights": ["a"]},
                        {"id": "bare", "airframe": AIRFRAME})  # fmt: skip
    t, radius, omega = np.arange(0.0, 20.0, 0.05), 1.5, 1.6
    table = pd.DataFrame({"t": t, "x": radius * np.cos(omega * t), "y": radius * np.sin(omega * t), "z": -1.0 + 0 * t})
    flight = follow(table, Model(document))[300:-300]
    q = attitude.from_euler(*(flight[a].to_numpy() for a in ("roll", "pitch", "yaw")))
    lean = np.arccos(attitude.rotate(q, np.array([0.0, 0.0, 1.0]))[:, 2])
    pull = radius * omega**2
    np.testing.assert_allclose(lean, math.atan2(pull, GRAVITY), rtol=1e-4)
    np.testing.assert_allclose(flight["Fz"], -MASS * math.hypot(pull, GRAVITY), rtol=1e-4)
    np.testing.assert_allclose(flight["yaw"], 0.0, atol=1e-9)


def test_forces_moments_and_rates_are_those_of_the_path():
    """Newton and Euler with angles differentiated by the textbook's 3-2-1 kinematics, none of the code under test."""
    table = eight(20.0, turn=0.6)
    flight = follow(table)
    t = flight["t"].to_numpy()
    roll, pitch, yaw = (np.unwrap(flight[a].to_numpy()) for a in ("roll", "pitch", "yaw"))
    dr, dp, dy = (np.gradient(a, t) for a in (roll, pitch, yaw))
    rates = np.column_stack([
        dr - dy * np.sin(pitch),
        dp * np.cos(roll) + dy * np.sin(roll) * np.cos(pitch),
        dy * np.cos(roll) * np.cos(pitch) - dp * np.sin(roll),
    ])  # fmt: skip
    inside = slice(100, -100)
    np.testing.assert_allclose(flight[["p", "q", "r"]].to_numpy()[inside], rates[inside], atol=2e-3)
    inertia = AIRFRAME.inertia
    moments = np.gradient(rates, t, axis=0) @ inertia.T + np.cross(rates, rates @ inertia.T)
    quasi_steady = MODEL.predict_columns(flight.drop(columns=[f"{w}_dot" for w in ROTORS]).assign(
        **{f"{w}_dot": 0.0 for w in ROTORS}))  # fmt: skip
    np.testing.assert_allclose(quasi_steady[["Mx", "My", "Mz"]].to_numpy()[inside], moments[inside], atol=3e-5)
    place = flight[["x", "y", "z"]].to_numpy()
    acceleration = np.gradient(np.gradient(place, t, axis=0), t, axis=0)
    q = attitude.from_euler(roll, pitch, yaw)
    felt = attitude.rotate(q, flight[["Fx", "Fy", "Fz"]].to_numpy()) / MASS + [0.0, 0.0, GRAVITY]
    np.testing.assert_allclose(felt[inside], acceleration[inside], atol=0.02)


def test_a_turn_at_a_given_attitude_keeps_its_height():
    t = np.arange(0.0, 2.0, 0.01)
    angles = np.column_stack([0.3 * np.sin(6.0 * t) ** 3, 0.2 * np.sin(6.0 * t) ** 3, 0.0 * t])
    flight = turning(t, angles, np.array([1.0, 2.0, -1.5]), MODEL, "a turn")
    np.testing.assert_allclose(flight["z"], -1.5, atol=1e-9)
    np.testing.assert_allclose(flight[["roll", "pitch", "yaw"]], angles, atol=1e-9)
    with pytest.raises(DataError, match="lies on its side"):
        turning(t, np.column_stack([t, 0 * t, 0 * t]), np.zeros(3), MODEL, "a turn")


def limited():
    return model_of(dataclasses.replace(AIRFRAME, poles=14, idle_rpm=250.0, max_rpm=2000.0))


def test_what_the_rotors_cannot_give_is_told_with_time_and_place():
    low, high = limits_of(limited())
    assert low == pytest.approx(374.0, abs=0.1) and high == pytest.approx(2992.0, abs=0.1)
    t = np.arange(0.0, 10.0, 0.1)
    z = -1.0 - 10.0 * np.maximum(t - 4.0, 0.0) ** 3 * np.exp(-np.maximum(t - 4.0, 0.0))  # a jerk upwards
    table = pd.DataFrame({"t": t, "x": 0.5 + 0 * t, "y": 0 * t, "z": z})
    told = r"more than the rotors give at t = 4\.\d\d s, x y z = 0\.50 0\.00 -\d\.\d\d m"
    with pytest.raises(DataError, match=told):
        follow(table, limited())
    follow(table, MODEL)  # without limits it can be followed
    fall = pd.DataFrame({"t": t, "x": 0 * t, "y": 0 * t, "z": 0.5 * GRAVITY * t**2})
    with pytest.raises(DataError, match=r"falls freely at t = 0\.\d\d s"):
        follow(fall)


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda t: t.drop(columns="z"), "no column 'z'"),
        (lambda t: t.rename(columns={"t": "T"}), "no column 't'"),
        (lambda t: t.assign(x=t["x"].where(t.index != 7)), "column 'x' holds no number in row 8"),
        (lambda t: t.assign(y="north"), "column 'y' holds text"),
        (lambda t: t.assign(t=t["t"].where(t.index != 5, 0.2)), r"time goes from 0.4 to 0.2 s in row 6"),
        (lambda t: t[:4], "has 4 rows, expected more than 5"),
    ],
)
def test_a_table_that_is_no_trajectory_is_refused(change, said):
    with pytest.raises(DataError, match=said):
        plan.read_flight(change(eight()), MODEL, "a plan")


def test_every_manoeuvre_can_be_flown_and_begins_and_ends_at_rest():
    found = library(limited(), [0.0, 0.0, -1.5])
    assert len(found) >= 10 and len({m.name for m in found}) == len(found)
    low, high = limits_of(limited())
    for m in found:
        assert 10.0 < m.flight["t"].iloc[-1] < 40.0
        assert m.flight[list(ROTORS)].to_numpy().max() <= high and m.flight[list(ROTORS)].to_numpy().min() >= low
        assert m.flight["z"].max() < 0.0, m.name  # above the floor
        for row in (0, -1):
            assert np.abs(m.flight[["u", "v", "w", "p", "q", "r"]].iloc[row]).max() < 0.3, m.name


# noise


def test_the_usual_noise_has_the_spectrum_that_is_stated():
    whitener = plan_noise.usual(VEHICLE, 100.0)
    f = np.array([0.2, 0.6, 1.5, 3.0, 6.0])
    z = np.exp(-2j * np.pi * np.outer(f / (100.0 / 3.0), np.arange(whitener.coefficients.shape[1])))
    for c, unit in enumerate(plan_noise.units(VEHICLE)):
        density = 2.0 * whitener.scale[c] ** 2 / np.abs(z @ whitener.coefficients[c]) ** 2 / (100.0 / 3.0)
        told = plan_noise.SLOW[c] / (1 + (f / plan_noise.CORNER[c]) ** 2) ** 1.5 + plan_noise.WHITE[c]
        assert np.all(np.abs(np.log(density / (told * unit**2))) < np.log(1.8))


def test_drawn_residuals_have_the_moments_of_time_series():
    """Against residuals made sample by sample: noise plus terms that are off."""
    rng = np.random.default_rng(3)
    rows, shared, doubt = 400, [1, 2], np.array([0.05, 0.1])
    columns = rng.standard_normal((rows, 6))
    gram = columns.T @ columns
    drawn = plan_noise.drawn(gram, rows, shared, doubt, 4000, rng)
    made = rng.standard_normal((rows, 4000)) + columns[:, shared] @ (doubt[:, None] * rng.standard_normal((2, 4000)))
    cross = columns[:, 1:].T @ made
    np.testing.assert_allclose(np.cov(drawn[1:6, 6:]), np.cov(cross), rtol=0.1, atol=0.15 * rows)
    squares = np.diag(drawn)[6:]
    assert squares.mean() == pytest.approx((made**2).sum(axis=0).mean(), rel=0.02)
    np.testing.assert_array_equal(drawn[1:6, 1:6], gram[1:, 1:])


def test_residuals_of_other_flights_keep_their_size_but_not_their_sign():
    rng = np.random.default_rng(4)
    stretches = [rng.standard_normal((200, 4)) for _ in range(5)]
    for k, s in enumerate(stretches):  # the cause's column 3 is wrong by its own amount in each stretch
        s[:, 0] += (k - 2.0) * s[:, 3] + 7.0 * s[:, 1]
    grams = np.array([s.T @ s for s in stretches])
    found = plan_noise.repeated(grams, [1], [], np.zeros(0), 3, rng)
    own = np.concatenate(stretches)
    slope = own[:, 1] @ own[:, 0] / (own[:, 1] @ own[:, 1])
    for s, gram in zip(stretches, found):
        left = s[:, 0] - slope * s[:, 1]
        np.testing.assert_allclose(np.abs(gram[3, 4:]), abs(s[:, 3] @ left), rtol=1e-3)
        np.testing.assert_allclose(np.diag(gram)[4:], left @ left, rtol=1e-4)


# what could be revealed


@pytest.fixture(scope="module")
def noisy():
    """Three flights whose residual is coloured noise: evidence, study, causes."""
    rng = np.random.default_rng(0)
    names = ("rotor_drag", "body_drag", "mass", "tether", "cg_offset")
    effects = {n: CATALOGUE[n] for n in names}
    evidence = []
    for k in range(3):
        flight = follow(eight(30.0, turn=0.3 * k, size=0.8 + 0.2 * k))
        for axis, unit in zip(AXES, plan_noise.units(VEHICLE)):
            slow = np.convolve(rng.standard_normal(len(flight) + 200), np.exp(-np.arange(200) / 15.0), "valid")[:-1]
            flight[axis] += 0.004 * unit * slow / slow.std()
        evidence.append(gather(str(k), flight, {}, AIRFRAME, MODEL, 100.0))
    return evidence, gather_study(evidence, effects, VEHICLE), effects


def test_expected_standard_errors_are_those_of_the_search_itself(noisy):
    _, study, effects = noisy
    flags = np.array([True, True, False])
    mixed = study.mixed(range(3), flags)
    size = len(study.names)
    flights = []
    for blocks, flag in zip(study.blocks, flags):
        place = [*range(size), 0]  # the measured residual behind the columns
        grams = in_stretches(blocks)[:, place][:, :, place]
        flights.append(Repeated(grams, int(flag), int(not flag)))
    outlook = Outlook(flights, study.columns, size, 1, effects, 0.003)
    pooled = [c for c in effects if not effects[c].absorbed]
    for cause, which in (("rotor_drag", (0,)), ("mass", (0,)), ("cg_offset", (0, 1, 2)), ("tether", (0,))):
        offer = Offer(cause, "changed", which)
        test = mixed.test(offer, (), pooled)
        spread, covariance, _ = outlook.test(offer)
        assert spread.tau == test.tau
        np.testing.assert_allclose(covariance, test.covariance, rtol=1e-6)
    # beside a rival, at the spread that the search finds there
    rival, offer = Offer("body_drag", "changed", (0,)), Offer("rotor_drag", "changed", (0,))
    beside = mixed.test(offer, [rival], pooled)
    found = [outlook.covariance(offer, Spread(beside.tau, informed), rival) for informed in (False, True)]
    assert min(abs(float(c[0, 0] / beside.covariance[0, 0]) - 1.0) for c in found) < 1e-6


def card_of(table, **options):
    return plan.examine([plan.read_flight(table, MODEL, "a plan")], MODEL, CATALOGUE, **{"propose": False, **options})


def rows_of(card):
    return {r.effect.id: r.sight for r in card.rows}


@pytest.fixture(scope="module")
def cards():
    """Fixed heading, turning, near the floor, and with sharp doublets; reference flights beside them."""
    moves = {m.name: m.flight for m in library(MODEL, [0.0, 0.0, -1.5])}
    straight = eight(40.0)
    low = moves["staircase near the floor"]
    return {
        "straight": rows_of(card_of(straight, reference=4)),
        "turning": rows_of(card_of(eight(40.0, turn=0.6), reference=4)),
        "low": rows_of(card_of(low[[c for c in low if c not in AXES]], reference=4)),
        "sharp": rows_of(card_of(moves["doublets"][[c for c in low if c not in AXES]], reference=4)),
        "alone": rows_of(card_of(straight)),
    }


def test_a_turn_of_the_heading_shows_wind_that_a_fixed_heading_hides(cards):
    """The probe of the catalogue: t = 4.8 at fixed heading, 24.6 with a yaw sweep."""
    slow = {"x": 0.2, "y": 0.2}
    still, turned = eight(40.0), eight(40.0, turn=0.6)
    for table in (still, turned):
        for axis, share in slow.items():
            table[axis] *= share
    fixed, swept = (rows_of(card_of(t))["wind"] for t in (still, turned))
    assert swept.t > 2.0 * fixed.t and swept.beside > 2.0 * fixed.beside


def test_ground_effect_is_nothing_unless_flown_low(cards):
    assert cards["straight"]["ground_effect"].t < 0.5
    assert cards["low"]["ground_effect"].t > 10.0


def test_inertia_and_inflow_lag_need_sharp_turns(cards):
    for cause in ("inertia", "inflow_lag"):
        assert cards["sharp"][cause].t > 3.0 * cards["straight"][cause].t
    assert cards["straight"]["inertia"].verdict == "not seen"


def test_what_the_model_takes_up_needs_reference_flights(cards):
    for cause in ("mass", "thrust_factor", "rotor_speed_scale", "inertia"):
        assert cards["alone"][cause].absorbed and cards["alone"][cause].verdict == "not seen"
        assert not cards["straight"][cause].absorbed
    # a term of the model's own is as good as absorbed, though the catalogue does not know
    assert cards["alone"]["axial_inflow"].taken and cards["alone"]["axial_inflow"].t < 1.0
    assert not cards["alone"]["tether"].taken and not cards["straight"]["axial_inflow"].taken


def test_expected_t_grows_with_the_size_and_the_number_of_flights():
    few, many = (rows_of(card_of(eight(30.0), compared=n))["tether"] for n in (3, 12))
    assert many.t == pytest.approx(2.0 * few.t, rel=0.25)


def test_a_planted_cause_of_expected_t_10_measures_about_10():
    """Flights along the plan with the cause and noise made sample by sample, measured by the search itself."""
    names = ("tether", "wind", "thrust_curve", "rotor_effectiveness")
    effects = {n: CATALOGUE[n] for n in names}
    card = plan.examine([plan.read_flight(eight(30.0), MODEL, "a plan")], MODEL, effects, 3, 3, propose=False)
    sight = rows_of(card)["tether"]
    size = 10.0 / sight.t * sight.size
    rng = np.random.default_rng(5)
    whitener = plan_noise.usual(VEHICLE, 100.0)
    found = []
    clean = follow(eight(30.0))
    for _ in range(3):
        evidence = []
        for k in range(6):
            flight = clean.copy()
            one = gather(str(k), flight, {}, AIRFRAME, MODEL, 100.0)
            shown = size * columns_of(effects["tether"], one, VEHICLE, {})["k"] if k < 3 else np.zeros((len(one), 6))
            for c, axis in enumerate(AXES):
                white = whitener.scale[c] * rng.standard_normal(len(flight) // 3 + 40)
                coarse = lfilter([1.0], whitener.coefficients[c], white)
                noise = np.interp(np.arange(len(flight)) / 3.0, np.arange(len(coarse) - 20), coarse[20:])
                flight[axis] += noise + shown[:, c]
            evidence.append(gather(str(k), flight, {}, AIRFRAME, MODEL, 100.0))
        study = gather_study(evidence, effects, VEHICLE)
        test = study.mixed(range(6), [True] * 3 + [False] * 3).test(Offer("tether", "changed", (0,)), (), names)
        found.append(test.wald**0.5)
    assert 5.0 < np.median(found) < 20.0


def test_sensor_faults_count_against_the_usual_spread(cards):
    """Well-moved flights: size over the spread of healthy flights, over the root of their number."""
    alone = 0.03 / kinematic.SPREAD["gyro_bias"] * math.sqrt(4.0)
    assert cards["alone"]["gyro_bias"].t == pytest.approx(alone, rel=0.03)
    assert cards["straight"]["gyro_bias"].t == pytest.approx(alone / math.sqrt(2.0), rel=0.03)
    assert {cards["alone"]["imu_misalignment"].rival, "mocap_misalignment"} == {"mocap_misalignment"}
    assert cards["alone"]["imu_misalignment"].beside < 2.0


def test_a_late_command_is_a_tie_with_late_telemetry_unless_the_motion_tells(cards):
    sight = cards["alone"]["command_delay"]
    assert sight.rival == "telemetry_delay" and sight.beside == 0.0


def test_causes_that_cannot_be_judged_say_why():
    card = card_of(eight(20.0))
    assert "no battery voltage" in card.not_asked["battery_sag"]
    assert "walls" in card.not_asked["proximity"]
    assert "typical size" in card.not_asked["attitude_error"]
    volts = follow(eight(20.0))
    volts["battery_voltage"] = np.linspace(16.5, 15.0, len(volts))
    assert "battery_sag" in rows_of(plan.examine([plan.Flight("a", volts, False)], MODEL, CATALOGUE, propose=False))
    with pytest.raises(ConfigError, match="1 compared and 0 reference flights, expected at least 2"):
        card_of(eight(20.0), compared=1)


def test_every_cause_of_forces_and_moments_has_a_typical_size_within_its_range():
    for name, effect in CATALOGUE.items():
        if effect.finding or name in ("attitude_error", "marker_offset"):
            continue
        sizes = effect.typical(VEHICLE)
        assert sizes, name
        for parameter, size in sizes.items():
            p = effect.parameters[parameter]
            neutral = p.neutral if p.neutral is not None else 0.0
            assert size > 0.0 and neutral + size <= p.high, (name, parameter)


# the card


FEW = ("doublets", "staircase near the floor")


@pytest.fixture(scope="module")
def few():
    """Two manoeuvres of the library."""
    return [m for m in library(MODEL, [0.0, 0.0, -1.5]) if m.name in FEW]


@pytest.fixture(scope="module")
def card(few):
    # slow and straight: much is hidden
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "library", lambda *_: few)
        return plan.examine([plan.read_flight(eight(30.0, size=0.4), MODEL, "slow.csv")], MODEL, CATALOGUE, reference=2)


def test_what_is_proposed_raises_what_was_hidden(card):
    raised = {n: (a, b) for p in card.proposals for n, (a, b) in p.raises.items()}
    assert {p.manoeuvre.name for p in card.proposals} == set(FEW)
    for before, after in raised.values():
        assert before.verdict != "seen"
        assert min(after.t, after.beside) / after.needed > 1.2 * min(before.t, before.beside) / before.needed
    by = {n: p.manoeuvre.name for p in card.proposals for n in p.raises}
    assert by["ground_effect"] == "staircase near the floor"
    assert raised["ground_effect"][1].verdict == "seen"
    assert by["imu_lever_arm"] == "doublets" and raised["imu_lever_arm"][1].verdict == "seen"
    # what no manoeuvre shows is told as such, and what one shows is not
    told = " ".join(flight_card.hopeless(card))
    for name, sight in card.best.items():
        assert (f"{name.replace('_', ' ')}: " in told) == (sight.verdict != "seen")


def test_the_card_reads_the_same_as_text_page_and_data(card):
    text, page, data = flight_card.text(card), flight_card.page(card), flight_card.data(card)
    assert text.startswith(flight_card.headline(card)) and flight_card.headline(card) in page
    plain = json.loads(json.dumps(data))
    assert plain["schema"] == "quasi.plan/1" and len(plain["causes"]) == len(card.rows)
    for row in plain["causes"]:
        assert row["id"].replace("_", " ") in text and row["id"].replace("_", " ") in page
    assert "from" in text and "staircase near the floor" in page
    assert "<script" not in page and "http" not in page
    tied = [r for r in card.rows if r.sight.verdict == "tie"]
    assert all(f"only as a tie with {r.sight.rival.replace('_', ' ')}" in text for r in tied)


def test_the_number_of_flights_that_would_show_a_cause_does():
    table = eight(30.0)
    few = card_of(table, reference=4)
    sight = rows_of(few)["gyro_bias"]
    count = flight_card.more_flights(few, sight)
    assert sight.verdict == "not seen" and 5 < count < 20
    assert rows_of(card_of(table, compared=count, reference=count))["gyro_bias"].verdict == "seen"
    assert flight_card.more_flights(few, sight._replace(t=0.1, beside=0.1)) is None


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("project")
    tables.write_json(place / "models/small/standalone/model.json", MODEL.document)
    eight(15.0).to_csv(place / "eight.csv", index=False)
    return place


def test_the_command_prints_and_writes_the_card(folder, capsys, few, monkeypatch):
    monkeypatch.setattr(plan, "library", lambda *_: few[:1])
    assert main(["plan", "small", "eight.csv", "-d", str(folder), "--references", "2", "--out", "card"]) == 0
    printed = capsys.readouterr().out
    assert "causes would be seen" in printed and "4 flights of 15 s beside 2 reference flights" in printed
    assert tables.read_json(folder / "card/plan.json")["reference"] == 2
    assert (folder / "card/plan.html").is_file()


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["smal", "eight.csv"], "no model 'smal'"),
        (["small", "eigth.csv"], "no trajectory 'eigth.csv'"),
        (["small", "eight.csv", "--gap", "low"], "low"),
        (["small", "eight.csv", "--flights", "1"], "expected at least 2"),
    ],
)
def test_the_command_says_what_is_wrong(folder, capsys, arguments, said):
    assert main(["plan", *arguments, "-d", str(folder)]) == 1
    told = capsys.readouterr().err
    assert said in told and told.startswith("[ERROR]") and len(told.strip().splitlines()) == 1


def test_a_flown_flight_is_judged_by_its_own_residual(folder):
    flight = follow(eight(30.0))
    rng = np.random.default_rng(2)
    loud, calm = (
        flight.assign(**{a: flight[a] + s * rng.standard_normal(len(flight)) for a in AXES}) for s in (0.05, 0.005)
    )
    sights = [rows_of(card_of(f)) for f in (loud, calm)]
    assert sights[1]["tether"].t > 3.0 * sights[0]["tether"].t
    assert plan.read_flight(loud, MODEL, "a").measured and not plan.read_flight(loud, MODEL, "a", True).measured
    with pytest.raises(DataError, match="times do not grow"):
        plan.read_flight(loud.assign(t=0.0), MODEL, "a")


def test_a_simulation_feels_what_its_forces_say_and_the_floor_is_told():
    """The specific force of a table without one is that of the path; for models of net forces, too."""
    flight = follow(eight(15.0))
    bare = flight.drop(columns=["ax", "ay", "az"])
    for gravity in ("withGravity", "noGravity"):
        model = model_of(gravity=gravity)
        if gravity == "noGravity":  # a net force has the weight in it
            bare = bare.drop(columns=list(AXES))
        found = plan.read_flight(bare, model, "s", simulated=True).columns
        down = attitude.rotate_inverse(
            attitude.from_euler(*(flight[a].to_numpy() for a in ("roll", "pitch", "yaw"))),
            np.array([0.0, 0.0, GRAVITY]),
        )
        felt = found[["Fx", "Fy", "Fz"]].to_numpy() / MASS - (down if gravity == "noGravity" else 0.0)
        np.testing.assert_allclose(found[["ax", "ay", "az"]], felt)
    notes = card_of(eight(15.0, height=0.02, size=0.05)).notes
    assert "less than a rotor's radius above the floor" in notes[0]


def test_flights_of_the_other_kind_of_forces_are_refused(folder):
    from quasi.gap.plan_input import flights_of

    flight = follow(eight(15.0))
    tables.write_table(folder / "flown.parquet", flight, dict.fromkeys(flight, ("", "")))
    tables.write_json(folder / "flown.json", {"schema": "quasi.filtered/1", "forces": "noGravity", "mass": 0.43})
    with pytest.raises(ConfigError, match="holds forces noGravity, but model small gives them withGravity"):
        flights_of(["flown.parquet"], MODEL, folder)
    tables.write_json(folder / "flown.json", {"schema": "quasi.filtered/1", "forces": "withGravity", "mass": 0.43})
    found, about = flights_of(["flown.parquet"], MODEL, folder)
    assert about == {"mass": 0.43} and found[0].measured
