"""Planted effects against the catalogue's equations, signs and references."""

import math

import numpy as np
import pytest

from quasi import attitude
from quasi.attitude import GRAVITY
from quasi.errors import ConfigError
from quasi_synthesis import nuisance, physics, sensors
from quasi_synthesis.campaign import make_flight, read_campaign
from quasi_synthesis.effects import OFFERED, check, plant
from quasi_synthesis.vehicle import ARM, BASE_HOVER_SPEED, BASE_MASS, RADIUS

NOMINAL = nuisance.nominal(120.0, 0.0)
V = np.array([4.0, -3.0, 1.5])  # m/s, body = earth
RATES = np.array([1.0, -2.0, 0.5])


def planted(**effects):
    return plant(NOMINAL, check(effects, "test"))


def loads(setup, velocity=V, rates=RATES, z=-2.0, t=0.0, speeds=BASE_HOVER_SPEED, place=(0.0, 0.0)):
    x = np.zeros(physics.PLANT_STATES)
    x[:2], x[2], x[3:6], x[6], x[10:13], x[13:17], x[17:21] = place, z, velocity, 1.0, rates, speeds, 9.5
    dx, out = np.empty(physics.PLANT_STATES), np.empty(14)
    physics.derivative(t, x, x[13:17].copy(), np.zeros(7), setup.vehicle.physics, dx, out)
    return out[:3].copy(), out[3:6].copy(), dx


def change(velocity=V, rates=RATES, **effects):
    base, with_it = loads(NOMINAL, velocity, rates), loads(planted(**effects), velocity, rates)
    return with_it[0] - base[0], with_it[1] - base[1]


TOTAL = 4 * BASE_HOVER_SPEED
NONE = np.zeros(3)


def test_rotor_drag_is_minus_k_sum_w_times_the_airspeed_in_the_plane():
    force, moment = change(rates=NONE, rotor_drag={"k": 1e-5})
    np.testing.assert_allclose(force, [-1e-5 * TOTAL * V[0], -1e-5 * TOTAL * V[1], 0], rtol=1e-9, atol=1e-12)
    height = -NOMINAL.vehicle.physics.hubs[0, 2]  # hubs above the cg
    np.testing.assert_allclose(moment, [force[1] * height, -force[0] * height, 0], rtol=1e-9, atol=1e-12)


def test_body_drag_is_minus_c_norm_v_times_v():
    np.testing.assert_allclose(change(body_drag={"c": 0.01})[0], -0.01 * np.linalg.norm(V) * V, rtol=1e-9)


def test_flapping_lift_and_axial_inflow_follow_their_equations():
    _, moment = change(rates=NONE, blade_flapping={"k": 1e-7})
    np.testing.assert_allclose(moment, 1e-7 * TOTAL * np.array([-V[1], V[0], 0]), rtol=1e-9, atol=1e-13)
    force, _ = change(rates=NONE, translational_lift={"k": 0.004})
    lift = 0.004 * (V[0] ** 2 + V[1] ** 2)  # some is lost in the wakes ahead, some tilts with the discs
    np.testing.assert_allclose(force, [0, 0, -lift], atol=0.05 * lift)
    # yaw to the right in forward flight: the hubs on the left have more of the flow, and roll to the right
    turning, slow = (
        change(np.array([3.0, 0, 0]), np.array([0, 0, r]), translational_lift={"k": 0.004})[1] for r in (1, 0)
    )
    more = 2 * 0.25 * 0.004 * 3.0 * sum(hub[1] ** 2 for hub in NOMINAL.vehicle.physics.hubs)
    assert (turning - slow)[0] == pytest.approx(more, rel=0.1)
    still = np.array([0, 0, -2.0])  # climbing at 2 m/s
    force, _ = change(velocity=still, rates=NONE, axial_inflow={"k": 1e-5})
    np.testing.assert_allclose(force, [0, 0, -1e-5 * TOTAL * still[2]], rtol=1e-9)


def test_thrust_effects_scale_or_add_thrust():
    base = loads(NOMINAL, NONE, NONE)[0][2]
    assert loads(planted(thrust_factor={"factor": 0.95}), NONE, NONE)[0][2] == pytest.approx(0.95 * base)
    speeds = BASE_HOVER_SPEED + np.array([50.0, -50.0, -50.0, 50.0])
    plain, more = (loads(s, NONE, NONE, speeds=speeds) for s in (NOMINAL, planted(torque_factor={"factor": 1.2})))
    assert more[1][2] == pytest.approx(1.2 * plain[1][2], rel=0.02)
    np.testing.assert_allclose(more[0], plain[0])
    assert loads(planted(thrust_drift={"rate": -1e-3}), NONE, NONE, t=50.0)[0][2] == pytest.approx(0.95 * base)
    curve = loads(planted(thrust_curve={"c1": 1e-5, "c0": 0.02}), NONE, NONE)[0][2]
    assert curve - base == pytest.approx(-(1e-5 * TOTAL + 4 * 0.02))
    weak = change(NONE, NONE, rotor_effectiveness={"rotor2": 0.9})  # front right
    one = -base / 4
    np.testing.assert_allclose(weak[0], [0, 0, 0.1 * one], atol=1e-9)
    half = ARM / math.sqrt(2)
    # the front right side is lighter: it sinks
    np.testing.assert_allclose(weak[1][:2], [0.1 * one * half, -0.1 * one * half], atol=2e-4)
    assert weak[1][2] < 0  # less thrust asks less torque of a rotor that turns left


def test_ground_effect_tether_and_walls_act_where_they_stand():
    ground = planted(ground_effect={"c": 3.0})
    hub = 2 * RADIUS
    low = loads(ground, NONE, NONE, z=-(hub - 0.012))[0][2] / loads(NOMINAL, NONE, NONE, z=-(hub - 0.012))[0][2]
    assert low == pytest.approx(1 / (1 - 3.0 / 64), rel=1e-9)
    force = loads(planted(tether={"k": 0.2}), NONE, NONE, z=-2.0, place=(1.0, 0.0))[0] - loads(NOMINAL, NONE, NONE)[0]
    np.testing.assert_allclose(force, [-0.2, 0, 0.4], atol=1e-9)
    near = loads(planted(proximity={"gain": 0.1}), NONE, NONE, place=(4.9, 0.0))[0][2]
    far = loads(planted(proximity={"gain": 0.1}), NONE, NONE)[0][2]
    assert near / far == pytest.approx(0.9, abs=0.01)


def test_tilt_and_rotor_inertias_turn_the_body_as_the_catalogue_says():
    _, moment = change(NONE, NONE, rotor_tilt={f"rotor{i}": math.radians(1) for i in range(1, 5)})
    assert moment[2] == pytest.approx(4 * 1.4e-3, rel=0.1)  # "1 deg: 1.4e-3 N m" each
    one = change(NONE, NONE, rotor_tilt={"rotor1": 0.02})[1]
    assert one[2] > 0
    speeds = np.array([2300.0, 1900, 1900, 2300])  # both clockwise rotors faster
    spin = NOMINAL.vehicle.physics.spin
    base = loads(NOMINAL, NONE, RATES, speeds=speeds)[1]
    gyro = loads(planted(rotor_gyroscopic={"inertia": 1e-6}), NONE, RATES, speeds=speeds)[1] - base
    total = (spin * speeds).sum()
    np.testing.assert_allclose(gyro, [-1e-6 * RATES[1] * total, 1e-6 * RATES[0] * total, 0], atol=1e-12)


def test_wind_is_the_velocity_of_the_air():
    moving = loads(planted(wind={"north": 3.0, "east": -1.0, "down": 0.5}), velocity=np.array([3.0, -1.0, 0.5]))
    still = loads(NOMINAL, velocity=NONE)
    np.testing.assert_allclose(moving[0], still[0], atol=1e-9)


def test_mass_and_inertia_are_absolute_and_products_carry_the_tensors_sign():
    p = planted(mass={"mass": 0.5}, inertia={"Ixx": 1e-3, "Ixz": 4e-5}).vehicle.physics
    assert p.mass == 0.5
    np.testing.assert_allclose(p.inertia, [[1e-3, 0, -4e-5], [0, 1.07e-3, 0], [-4e-5, 0, 1.71e-3]])
    np.testing.assert_allclose(p.inertia @ p.inverse_inertia, np.eye(3), atol=1e-12)


def test_cg_offset_moves_hubs_imu_and_markers_the_other_way_and_turns_by_minus_r_cross_f():
    setup = planted(cg_offset={"x": 0.002, "y": -0.001, "z": 0.003})
    shift = np.array([0.002, -0.001, 0.003])
    np.testing.assert_allclose(setup.vehicle.physics.hubs, NOMINAL.vehicle.physics.hubs - shift)
    np.testing.assert_allclose(setup.inertial.position, -shift)
    np.testing.assert_allclose(setup.capture.offset, NOMINAL.capture.offset - shift)
    force, moment, _ = loads(setup, NONE, NONE)
    np.testing.assert_allclose(moment - loads(NOMINAL, NONE, NONE)[1], -np.cross(shift, force), atol=1e-9)


def reading(setup, rates=RATES, force=(1.0, 2.0, -9.0)):
    raw = np.empty(6)
    spin_up = np.array([30.0, -20.0, 10.0])
    sensors.read_inertial(rates, spin_up, np.array(force), np.zeros(4), np.zeros(4), setup.inertial, raw)
    return raw


def test_inertial_errors_have_their_stated_signs():
    base = reading(NOMINAL)
    np.testing.assert_allclose(base, [*RATES, 1.0, 2.0, -9.0])
    bias = reading(planted(gyro_bias={"x": 0.1}, accelerometer_bias={"z": 0.2}))
    np.testing.assert_allclose(bias - base, [0.1, 0, 0, 0, 0, 0.2], atol=1e-12)
    scale = reading(planted(gyro_scale={"y": 1.02}, accelerometer_scale={"x": 0.99, "z": 1.01}))
    np.testing.assert_allclose(scale / base, [1, 1.02, 1, 0.99, 1, 1.01])
    arm = np.array([0.01, -0.02, 0.03])
    lever = reading(planted(imu_lever_arm=dict(zip("xyz", arm.tolist()))))
    spin_up = np.array([30.0, -20.0, 10.0])
    expected = np.cross(spin_up, arm) + np.cross(RATES, np.cross(RATES, arm))
    np.testing.assert_allclose((lever - base)[3:], expected, atol=1e-12)
    turn = np.array([0.02, -0.01, 0.03])
    skewed = reading(planted(imu_misalignment=dict(zip(("roll", "pitch", "yaw"), turn.tolist()))))
    # axes turned by +turn see a fixed vector turned by -turn
    back = attitude.rotate(attitude.exponential(-turn), np.array([RATES, [1.0, 2.0, -9.0]]))
    np.testing.assert_allclose(skewed, back.ravel(), atol=1e-12)


def test_a_hover_needs_the_weight_of_what_hangs_below():
    setup = planted(payload_swing={"mass": 0.02, "length": 0.5})
    x = np.zeros(physics.PLANT_STATES)
    x[2], x[6], x[13:17], x[17:21] = -2.0, 1.0, BASE_HOVER_SPEED, 9.5
    x[23] = -2.0 + 0.5 + 0.02 * GRAVITY / physics.LOAD_STIFFNESS
    dx, out = np.empty(physics.PLANT_STATES), np.empty(14)
    physics.derivative(0.0, x, x[13:17].copy(), np.zeros(7), setup.vehicle.physics, dx, out)
    np.testing.assert_allclose(dx[24:27], 0, atol=1e-9)
    assert out[2] - loads(NOMINAL, NONE, NONE)[0][2] == pytest.approx(0.02 * GRAVITY)


def same(a, b) -> bool:
    if isinstance(a, tuple):
        return all(same(x, y) for x, y in zip(a, b))
    return bool(np.all(np.asarray(a) == np.asarray(b)))


@pytest.mark.parametrize("name", OFFERED)
def test_every_effect_changes_the_setup_and_its_neutral_value_does_not(name):
    parameters = OFFERED[name][0]
    shaking = nuisance.nominal(120.0, 1.0)
    neutral = {k: p.neutral for k, p in parameters.items() if p.neutral is not None}
    if len(neutral) == len(parameters):
        assert same(plant(shaking, check({name: neutral}, "test")), shaking)
    for key, p in parameters.items():
        strong = {"mass": {"mass": 0.45}, "payload_swing": {"mass": 0.02, "length": 0.4}}.get(name, {})
        value = 0.9 if p.neutral == 1.0 else (p.low + 3 * p.high) / 4
        if name == "inertia":
            value = 9e-4 if key[1] == key[2] else 1e-5
        if name == "rotor_speed_scale":
            value = 1.2
        assert not same(plant(shaking, check({name: strong or {key: value}}, "test")), shaking), key


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        ({"ground_efect": {"c": 1}}, ["ground_efect", "did you mean 'ground_effect'", "flight 3"]),
        ({"ground_effect": {"k": 1}}, ["ground_effect", "'k'", "'c'"]),
        ({"ground_effect": {"c": "two"}}, ["'c'", "'two'", "0 to 20"]),
        ({"mass": {"mass": -1}}, ["'mass'", "-1"]),
        ({"mass": {}}, ["lacks", "kg"]),
        ({"wind": 3}, ["wind", "expected parameters"]),
        ({"gyro_bias": {"x": True}}, ["True"]),
    ],
)
def test_a_wrong_effect_is_named_with_the_nearest_right_one(effects, words):
    with pytest.raises(ConfigError) as error:
        check(effects, "campaign 'a', flight 3")
    assert all(word in str(error.value) for word in words), str(error.value)


def test_an_inertia_that_no_body_can_have_is_refused():
    with pytest.raises(ConfigError, match="positive definite"):
        planted(inertia={"Ixz": 5e-3})


def test_the_base_vehicle_is_of_the_stated_class():
    assert NOMINAL.vehicle.physics.mass == BASE_MASS == 0.433
    assert 1900 <= BASE_HOVER_SPEED <= 2300


def test_what_is_in_no_catalogue_acts_as_it_is_described():
    """Heading, height, time and place each by its own formula, at rest in the air."""
    still = {"velocity": NONE, "rates": NONE}
    base, base_moment = loads(NOMINAL, **still)[:2]
    thrust = -base[2]
    assert loads(planted(unlisted_heading={"size": 0.1}), **still)[0][2] == pytest.approx(-thrust)  # nose north
    east = planted(unlisted_height={"size": 0.2})
    assert loads(east, z=-3.0, **still)[0][1] - base[1] == pytest.approx(0.6)
    beat = planted(unlisted_beat={"size": 0.3})
    assert loads(beat, t=0.3, **still)[0][0] - base[0] == pytest.approx(0.3 * math.sin(0.8 * math.pi * 0.3))
    fan = planted(unlisted_fan={"size": 0.5})
    above = loads(fan, place=physics.FAN, **still)[0][2] - base[2]
    beside = loads(fan, place=(physics.FAN[0] + 1.0, physics.FAN[1]), **still)[0][2] - base[2]
    assert (above, beside) == (pytest.approx(-0.5), pytest.approx(-0.5 * math.exp(-1.0)))
    twist = planted(unlisted_twist={"size": 3e-3})
    assert loads(twist, place=(2.0, 1.0), **still)[1][2] - base_moment[2] == pytest.approx(6e-3)
    brake, turning = planted(unlisted_brake={"size": 1e-4}), {"velocity": NONE, "rates": (0.0, 3.0, 0.0)}
    difference = loads(brake, **turning)[1] - loads(NOMINAL, **turning)[1]
    np.testing.assert_allclose(difference, [0.0, -1e-4 * 27.0, 0.0], atol=1e-12)
    loose = planted(unlisted_shift={"size": 4e-3})
    early, late = (loads(loose, t=physics.SHIFT + s, **still)[1][0] - base_moment[0] for s in (-0.1, 0.1))
    assert (early, late) == (pytest.approx(0.0, abs=1e-12), pytest.approx(4e-3))
    x = np.zeros(physics.PLANT_STATES)
    x[2], x[6], x[9], x[13:17], x[17:21] = -2.0, math.cos(math.pi / 8), math.sin(math.pi / 8), BASE_HOVER_SPEED, 9.5
    dx, out = np.empty(physics.PLANT_STATES), np.empty(14)
    turned = planted(unlisted_heading={"size": 0.1}).vehicle.physics  # nose to the north-east
    physics.derivative(0.0, x, x[13:17].copy(), np.zeros(7), turned, dx, out)
    assert -out[2] == pytest.approx(1.1 * thrust)


@pytest.mark.parametrize("effects", [{"payload_swing": {"mass": 0.03, "length": 0.2}}, {"cg_offset": {"z": -0.02}}])
def test_a_flight_begins_at_rest_on_its_feet_whatever_hangs_from_it(effects):
    config = {"duration": 10, "flights": [{"key": "a", "profile": "rest", "effects": effects, "nuisance": 0.0}]}
    campaign = read_campaign(config, "test")
    begin = make_flight(campaign, campaign.flights[0]).truth.iloc[:100]  # 0.2 s
    assert begin[["u", "v", "w"]].abs().to_numpy().max() < 0.05
    assert begin[["p", "q", "r"]].abs().to_numpy().max() < 0.2


def test_telemetry_is_never_ahead_of_the_motion_however_much_flights_vary():
    drawn = [nuisance.vary(nuisance.nominal(120.0, 0.0), 5.0, np.random.default_rng(seed))[1] for seed in range(60)]
    ages = [d["telemetry age"] for d in drawn]
    assert min(ages) == 0.0 < max(ages)
