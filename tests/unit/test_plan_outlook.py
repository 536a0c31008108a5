"""Plans: the noise that is expected, and which causes a flight could reveal."""

import math

import numpy as np
import pytest
from flights import AIRFRAME
from made_plan import CATALOGUE, MODEL, VEHICLE, card_of, eight, follow, rows_of
from scipy.signal import lfilter

from quasi.errors import ConfigError
from quasi.gap.catalogue import columns_of
from quasi.gap.flights.gathering import gather
from quasi.gap.levels.forces.design import gather_design, in_stretches
from quasi.gap.levels.sensors import identify as sensor_level
from quasi.gap.planning import plan, plan_noise
from quasi.gap.planning.manoeuvres import library
from quasi.gap.planning.outlook import Outlook, Repeated, Spread
from quasi.gap.planning.sensors_and_drive import DRIVES, drive_outlook
from quasi.gap.statistics.candidates import Candidate
from quasi.model.model import AXES

# noise


def test_the_usual_noise_has_the_spectrum_that_is_stated():
    whitener = plan_noise.usual(VEHICLE, 100.0)
    f = np.array([0.2, 0.6, 1.5, 3.0, 6.0])
    z = np.exp(-2j * np.pi * np.outer(f / (100.0 / 3.0), np.arange(whitener.coefficients.shape[1])))
    for c, unit in enumerate(plan_noise.units(VEHICLE)):
        density = 2.0 * whitener.scale[c] ** 2 / np.abs(z @ whitener.coefficients[c]) ** 2 / (100.0 / 3.0)
        told = plan_noise.SLOW_PSD[c] / (1 + (f / plan_noise.CORNER_HZ[c]) ** 2) ** 1.5 + plan_noise.WHITE_PSD[c]
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
    return evidence, gather_design(evidence, effects, VEHICLE), effects


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
    for cause, which in (("rotor_drag", (0,)), ("mass", (0,)), ("cg_offset", (0, 1, 2)), ("tether", (0,))):
        offer = Candidate(cause, "changed", which)
        test = mixed.test(offer, (), mixed.pooled("changed"))
        spread, covariance, _ = outlook.test(offer)
        assert spread.tau == test.tau
        np.testing.assert_allclose(covariance, test.covariance, rtol=1e-6)
    # beside a rival, at the spread that the search finds there
    rival, offer = Candidate("body_drag", "changed", (0,)), Candidate("rotor_drag", "changed", (0,))
    beside = mixed.test(offer, [rival], mixed.pooled("changed"))
    found = [outlook.covariance(offer, Spread(beside.tau, informed), rival) for informed in (False, True)]
    assert min(abs(float(c[0, 0] / beside.covariance[0, 0]) - 1.0) for c in found) < 1e-6


@pytest.fixture(scope="module")
def cards():
    """Fixed heading, near the floor, and with sharp doublets; reference flights beside them."""
    moves = {m.name: m.flight for m in library(MODEL, [0.0, 0.0, -1.5])}
    straight = eight(24.0)
    low = moves["staircase near the floor"]
    return {
        "straight": rows_of(card_of(straight, reference=4)),
        "low": rows_of(card_of(low[[c for c in low if c not in AXES]], reference=4)),
        "sharp": rows_of(card_of(moves["doublets"][[c for c in low if c not in AXES]], reference=4)),
        "alone": rows_of(card_of(straight)),
    }


def test_a_turn_of_the_heading_shows_wind_that_a_fixed_heading_hides(cards):
    """The probe of the catalogue: t = 4.8 at fixed heading, 24.6 with a yaw sweep."""
    slow = {"x": 0.2, "y": 0.2}
    still, turned = eight(24.0), eight(24.0, turn=0.6)
    for table in (still, turned):
        for axis, share in slow.items():
            table[axis] *= share
    fixed, swept = (rows_of(card_of(t))["wind"] for t in (still, turned))
    assert swept.t > 2.0 * fixed.t and swept.with_rival > 2.0 * fixed.with_rival


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
        study = gather_design(evidence, effects, VEHICLE)
        test = study.mixed(range(6), [True] * 3 + [False] * 3).test(Candidate("tether", "changed", (0,)), (), names)
        found.append(test.wald**0.5)
    assert 5.0 < np.median(found) < 20.0


def test_sensor_faults_count_against_the_usual_spread(cards):
    """Well-moved flights: size over the spread of healthy flights, over the root of their number."""
    alone = 0.03 / sensor_level.NORMAL_SPREAD["gyro_bias"] * math.sqrt(4.0)
    assert cards["alone"]["gyro_bias"].t == pytest.approx(alone, rel=0.03)
    assert cards["straight"]["gyro_bias"].t == pytest.approx(alone / math.sqrt(2.0), rel=0.03)
    assert {cards["alone"]["imu_misalignment"].rival, "mocap_misalignment"} == {"mocap_misalignment"}
    assert cards["alone"]["imu_misalignment"].with_rival < 2.0


def test_a_late_command_is_a_tie_with_late_telemetry_unless_the_motion_tells(cards):
    sight = cards["alone"]["command_delay"]
    assert sight.rival == "telemetry_delay" and sight.with_rival == 0.0


def test_the_lag_of_the_rotors_is_expected_at_the_level_of_all_that_is_asked_of_them():
    """One lag of all and one of each rotor, as the search of the drive."""
    rng = np.random.default_rng(0)
    products = [x.T @ x for x in rng.standard_normal((3, 500, 6))]
    flights = [Repeated(p[None], 1, 0) for p in products]
    effects = {n: CATALOGUE[n] for n in DRIVES}
    outlook = drive_outlook(flights, MODEL, effects, 0.01)
    lag, delay = (outlook.needed(outlook.whole(n), 1.0) for n in ("motor_lag", "command_delay"))
    outlook.level *= 5.0
    assert lag > delay
    assert outlook.needed(outlook.whole("motor_lag"), 1.0) == pytest.approx(delay)


def test_causes_that_cannot_be_judged_say_why():
    card = card_of(eight(20.0))
    assert "no battery voltage" in card.not_asked["battery_sag"]
    assert "walls" in card.not_asked["proximity"]
    assert card.not_asked["attitude_error"].startswith("only on flights without captured attitude, and its file gives")
    assert card.not_asked["marker_offset"].startswith("looks like the imu lever arm")
    volts = follow(eight(20.0))
    volts["battery_voltage"] = np.linspace(16.5, 15.0, len(volts))
    assert "battery_sag" in rows_of(plan.examine([plan.Flight("a", volts, False)], MODEL, CATALOGUE, propose=False))
    with pytest.raises(ConfigError, match="1 compared and 0 reference flights, expected at least 2"):
        card_of(eight(20.0), compared=1)


def test_every_cause_of_forces_and_moments_has_a_typical_size_within_its_range():
    for name, effect in CATALOGUE.items():
        if effect.finding or name in ("attitude_error", "marker_offset", "rotor_order"):  # an order has no size
            continue
        sizes = effect.typical(VEHICLE)
        assert sizes, name
        for parameter, size in sizes.items():
            p = effect.parameters[parameter]
            neutral = p.neutral if p.neutral is not None else 0.0
            assert size > 0.0 and neutral + size <= p.high, (name, parameter)
