"""The compiled equations of motion against a plain slow version, printed relations and the sign of every part."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from quasi import attitude
from quasi.attitude import GRAVITY
from quasi_synthesis import physics
from quasi_synthesis.vehicle import ARM, BASE_HOVER_SPEED, BASE_MASS, base_vehicle, hover_factors

BASE = base_vehicle().physics
HIGH = -2.0  # m, far from the floor


def state(velocity=(0, 0, 0), quaternion=(1, 0, 0, 0), rates=(0, 0, 0), speeds=BASE_HOVER_SPEED, induced=None, z=HIGH):
    x = np.zeros(physics.PLANT_STATES)
    x[2] = z
    x[3:6], x[6:10], x[10:13], x[13:17] = velocity, quaternion, rates, speeds
    hover = math.sqrt(BASE_MASS * GRAVITY / (8 * BASE.density * math.pi * BASE.radius**2))
    x[17:21] = hover if induced is None else induced
    return x


def loads(x, p=BASE, wanted=None, air=None, t=0.0):
    """(dx, force, moment, thrusts, torques) of the compiled kernel."""
    dx, out = np.empty(physics.PLANT_STATES), np.empty(14)
    wanted = x[13:17].copy() if wanted is None else np.asarray(wanted, float)
    physics.derivative(t, x, wanted, np.zeros(7) if air is None else air, p, dx, out)
    return dx, out[:3].copy(), out[3:6].copy(), out[6:10].copy(), out[10:14].copy()


def settled(x, p=BASE):
    """The state with every induced velocity at its equilibrium."""
    for _ in range(200):
        x[17:21] += 0.3 * p.inflow_lag * loads(x, p)[0][17:21]
    return x


def plain(t, x, wanted, air, p):
    """The right-hand side once more, with numpy's vectors and a root finder in place of the kernel's scalars."""
    position, velocity, q, omega = x[:3], x[3:6], x[6:10], x[10:13]
    body = attitude.rotate_inverse(q, velocity - p.wind - air[:3])
    area = math.pi * p.radius**2
    hover = math.sqrt(p.mass * GRAVITY / 4 / (2 * p.density * area))
    plane = np.hypot(body[0], body[1])
    wake = (plane / hover) ** 2 / (0.16 + (plane / hover) ** 2)
    force, moment = np.zeros(3), np.zeros(3)
    angular = np.zeros(3)
    dw, dv = np.zeros(4), np.zeros(4)
    for i in range(4):
        r, n, w, v = p.hubs[i], p.thrust_axis[i], x[13 + i], x[17 + i]
        local = body + np.cross(omega, r)
        climb = local @ n
        inplane = local - climb * n
        tip = w * p.radius
        mu = np.linalg.norm(inplane) / tip

        def blade(induced, tip=tip, mu=mu, climb=climb):
            # thrust coefficient of an untwisted blade: sigma a / 2 (theta / 3 (1 + 3/2 mu2) - lambda / 2)
            inflow = (climb + induced) / tip
            ct = 0.5 * p.solidity * p.lift_slope * (p.pitch / 3 * (1 + 1.5 * mu**2) - inflow / 2)
            return ct * p.density * area * tip**2

        def mismatch(induced, blade=blade, inplane=inplane, climb=climb):
            flow = math.sqrt(inplane @ inplane + (climb + induced) ** 2 + 1e-6)
            return blade(induced) - 2 * p.density * area * induced * flow

        equilibrium = brentq(mismatch, max(-climb, 0.0) + 1e-9, 60.0, xtol=1e-12)
        thrust = blade(v) + min(w / 300, 1) * (p.thrust_constant + p.thrust_per_speed * w) - p.axial_gain * w * climb
        thrust += p.translational_gain / 4 * (inplane @ inplane)
        ratio = -climb / hover
        lost = math.sin(math.pi * ratio / 2) ** 2 * math.exp(-(inplane @ inplane) / hover**2) if 0 < ratio < 2 else 0.0
        thrust *= p.thrust_gain[i] * (1 + p.thrust_drift * t)
        thrust *= 1 - p.vortex_depth * lost * (1 + p.vortex_buffet * air[3 + i])
        if plane > 0:
            behind = -(r[:2] @ body[:2]) / (np.linalg.norm(r[:2]) * plane)
            thrust *= 1 - p.interference * wake * max(behind, 0) ** 2
        hub = position + attitude.rotate(q, r)
        if p.ground_gain:
            thrust /= 1 - min(p.ground_gain * (p.radius / (4 * max(-hub[2], 0.2 * p.radius))) ** 2, 0.6)
        wall = min(p.room[0] - abs(hub[0]), p.room[1] - abs(hub[1]))
        thrust *= 1 - p.proximity_gain * math.exp(-(max(wall, 0) ** 2))
        torque = p.solidity * p.profile_drag / 8 * (1 + 4.6 * mu**2) * p.density * area * tip**2 * p.radius
        torque += thrust * (climb + p.induced_factor * v) / w * min(w / 300, 1)
        drag = -(p.h_force * w + thrust * p.disc_tilt / tip * (1 - mu / 2)) * inplane
        dw[i] = (wanted[i] - w) / (p.lag_up if wanted[i] > w else p.lag_down)
        dv[i] = (equilibrium - v) / p.inflow_lag
        f = thrust * n + drag
        z = np.array([0.0, 0.0, 1.0])
        shaft = -n * p.spin[i]  # direction of the rotor's turning
        flap = p.flapping_moment * w * np.cross(z, inplane) - p.flapping_damping * w * omega * [1, 1, 0]
        moment += np.cross(r, f) - (torque + p.rotor_inertia * dw[i]) * shaft + flap * [1, 1, 0]
        force += f
        angular += p.gyroscopic_inertia * w * p.spin[i] * z
    moment -= np.cross(omega, angular)
    speed = np.linalg.norm(body)
    drag = -p.body_drag * speed * body - [0, 0, p.body_lift * speed * body[0]]
    moment += np.cross(p.drag_centre, drag)
    force += drag
    earth = -p.tether * position
    load = np.zeros(3)
    if p.load_mass:
        line = x[21:24] - position
        length = np.linalg.norm(line)
        stretch = (x[24:27] - velocity) @ line / length
        pull = physics.LOAD_STIFFNESS * (length - p.load_length) + physics.PENDULUM_DAMPING * stretch
        pull = max(pull, 0.0) if length >= p.load_length else 0.0
        earth = earth + pull * line / length
        load = -pull * line / length / p.load_mass + [0, 0, GRAVITY]
    force += attitude.rotate_inverse(q, earth)
    dx = np.zeros(physics.PLANT_STATES)
    dx[:3] = velocity
    dx[3:6] = attitude.rotate(q, force) / p.mass + [0, 0, GRAVITY]
    dx[6:10] = 0.5 * attitude.multiply(q, np.concatenate([[0.0], omega]))
    dx[10:13] = np.linalg.solve(p.inertia, moment - np.cross(omega, p.inertia @ omega))
    dx[13:17], dx[17:21] = dw, dv
    if p.load_mass:
        dx[21:24], dx[24:27] = x[24:27], load
    return dx, force, moment


PRODUCTS = np.array([[9e-4, 3e-5, -2e-5], [3e-5, 1.1e-3, 1e-5], [-2e-5, 1e-5, 1.7e-3]])
FULL = BASE._replace(
    wind=np.array([0.7, -0.4, 0.2]),
    thrust_gain=np.array([1.0, 0.9, 1.05, 0.98]),
    thrust_drift=2e-3,
    thrust_per_speed=1e-5,
    thrust_constant=0.01,
    axial_gain=3e-6,
    translational_gain=0.004,
    ground_gain=3.0,
    proximity_gain=0.1,
    tether=0.3,
    load_mass=0.03,
    load_length=0.4,
    gyroscopic_inertia=9e-7,
    inertia=PRODUCTS,
    inverse_inertia=np.linalg.inv(PRODUCTS),
    hubs=BASE.hubs + [0.002, -0.001, 0.003],
    thrust_axis=attitude.rotate(attitude.exponential(np.array([0.02, -0.03, 0.01])), BASE.thrust_axis),
)


@pytest.mark.parametrize("seed", range(12))
def test_the_compiled_derivative_equals_a_plain_version_with_every_part_switched_on(seed):
    rng = np.random.default_rng(seed)
    x = state(rng.normal(0, 3, 3), attitude.normalise(rng.normal(0, 0.4, 4) + [1.5, 0, 0, 0]), rng.normal(0, 3, 3))
    x[:3] = [rng.uniform(-4.9, 4.9), rng.uniform(-4.9, 4.9), rng.uniform(-3, -0.4)]
    x[13:17] = rng.uniform(1200, 3200, 4)
    x[17:21] = rng.uniform(6, 13, 4)
    x[21:24] = x[:3] + rng.normal(0, 0.1, 3) + [0, 0, 0.405]
    x[24:27] = rng.normal(0, 1, 3)
    x[23] = min(x[23], -0.01)
    wanted, air = rng.uniform(1200, 3200, 4), rng.normal(0, 0.5, 7)
    dx, force, moment, _, _ = loads(x, FULL, wanted, air, 30.0)
    slow, slow_force, slow_moment = plain(30.0, x, wanted, air, FULL)
    np.testing.assert_allclose(force, slow_force, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(moment, slow_moment, rtol=1e-8, atol=1e-11)
    # the kernel's own root finder stops at 1e-7 m/s
    np.testing.assert_allclose(dx, slow, rtol=1e-7, atol=1e-4)


def test_in_hover_four_rotors_carry_the_weight_and_nothing_turns():
    x = settled(state())
    dx, force, moment, thrusts, _ = loads(x)
    np.testing.assert_allclose(force, [0, 0, -BASE_MASS * GRAVITY], atol=1e-6)
    np.testing.assert_allclose(moment, 0, atol=1e-9)
    np.testing.assert_allclose(dx[:17], 0, atol=1e-5)
    # momentum theory's induced velocity of hover, sqrt(T / 2 rho A)
    area = math.pi * BASE.radius**2
    np.testing.assert_allclose(x[17:21], np.sqrt(thrusts / (2 * BASE.density * area)), rtol=1e-6)


@pytest.mark.parametrize("speed", [900.0, 1500.0, 2100.0, 3300.0])
def test_hovering_thrust_and_torque_follow_the_square_of_speed_with_the_stated_factors(speed):
    x = settled(state(speeds=speed, induced=9.0 * speed / BASE_HOVER_SPEED))
    _, _, _, thrusts, torques = loads(x)
    factors = hover_factors(BASE)
    np.testing.assert_allclose(thrusts, factors["thrust"] * speed**2, rtol=1e-5)
    np.testing.assert_allclose(torques, factors["torque"] * speed**2, rtol=1e-5)


def test_thrust_of_a_rotor_turns_the_body_as_r_cross_f():
    base = loads(settled(state()))[2]
    for i, (place, roll, pitch) in enumerate(
        [("aft right", -1, -1), ("front right", -1, 1), ("aft left", 1, -1), ("front left", 1, 1)]
    ):
        x = state()
        x[13 + i] += 100.0
        change = loads(x)[2] - base
        assert np.sign(change[0]) == roll and np.sign(change[1]) == pitch, place


def test_yaw_reaction_is_opposite_to_the_spin_in_torque_and_in_acceleration():
    assert BASE.spin.tolist() == [1.0, -1.0, -1.0, 1.0]  # rotor 1 clockwise, its diagonal neighbour (4) alike
    for i in range(4):
        faster = state()
        faster[13 + i] += 50.0
        assert np.sign(loads(faster)[2][2]) == -BASE.spin[i]
        wanted = np.full(4, BASE_HOVER_SPEED)
        wanted[i] += 100.0
        moment = loads(state(), wanted=wanted)[2] - loads(state())[2]
        np.testing.assert_allclose(moment[2], -BASE.spin[i] * BASE.rotor_inertia * 100.0 / BASE.lag_up, rtol=1e-9)


def test_drag_opposes_motion_in_every_direction_and_has_the_size_of_its_class():
    for direction in np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0.6, 0.8, 0]], float):
        force = loads(settled(state(5.0 * direction)))[1]
        along = force[:2] @ direction[:2]
        assert -1.3 < along < -0.65
        assert abs(force[0] * direction[1] - force[1] * direction[0]) < 0.05
    assert loads(state((0, 0, 4.0)))[1][2] < loads(state())[1][2]  # sinking: drag up and more thrust


def test_forward_flight_pitches_up_and_flight_to_the_right_lowers_the_left_side():
    bare = BASE._replace(interference=0.0, body_drag=np.zeros(3), body_lift=0.0, h_force=0.0, disc_tilt=0.0)
    still = loads(state(), bare)[2]
    forward, right = loads(state((5, 0, 0)), bare)[2] - still, loads(state((0, 5, 0)), bare)[2] - still
    total = bare.flapping_moment * 5.0 * 4 * BASE_HOVER_SPEED
    np.testing.assert_allclose(forward[:2], [0, total], atol=1e-9)
    np.testing.assert_allclose(right[:2], [-total, 0], atol=1e-9)
    hubs_above = BASE._replace(flapping_moment=0.0, interference=0.0, drag_centre=np.zeros(3))
    assert loads(state((5, 0, 0)), hubs_above)[2][1] > 0


def test_hub_damping_and_gyroscopic_moment_have_their_textbook_signs():
    one = BASE._replace(spin=np.ones(4), flapping_damping=0.0)
    spun = 4 * BASE.gyroscopic_inertia * BASE_HOVER_SPEED
    rest = loads(state(), one)[2]
    still_air = one._replace(h_force=0.0, disc_tilt=0.0, lift_slope=1e-9, flapping_moment=0.0, body_drag=np.zeros(3))
    still_air = still_air._replace(body_lift=0.0, induced_factor=0.0)
    turned = loads(state(rates=(2.0, 3.0, 0)), still_air)[2] - loads(state(), still_air)[2]
    np.testing.assert_allclose(turned[:2], [-spun * 3.0, spun * 2.0], rtol=1e-3)
    assert rest[2] < 0
    damped = loads(state(rates=(2.0, 0, 0)))[2] - loads(state())[2]
    assert damped[0] < 0


def test_descent_into_the_own_wake_loses_thrust_and_buffets_it():
    hover = math.sqrt(BASE_MASS * GRAVITY / (8 * BASE.density * math.pi * BASE.radius**2))
    for ratio in (0.3, 1.0, 1.7):
        x = state((0, 0, ratio * hover))
        with_ring, without = loads(x)[3], loads(x, BASE._replace(vortex_depth=0.0))[3]
        np.testing.assert_allclose(with_ring / without, 1 - 0.3 * math.sin(math.pi * ratio / 2) ** 2, rtol=1e-9)
        buffet = np.concatenate([np.zeros(3), np.ones(4)])
        assert np.all(loads(x, air=buffet)[3] < with_ring)
    assert physics.vortex_loss(1.0, 0.0, hover) == 0.0  # climbing
    assert physics.vortex_loss(-hover, 3 * hover, hover) < 2e-4  # swept away in forward flight


def test_climb_costs_thrust_and_forward_flight_gives_some():
    thrust = [loads(settled(state(v)))[3].mean() for v in ((0, 0, 0), (0, 0, -2), (6, 0, 0))]
    assert thrust[1] < thrust[0] < thrust[2]
    # quasi-steady loss per climb speed of the four rotors is near the class's 0.15 N per m/s
    assert 0.05 < 4 * (thrust[0] - thrust[1]) / 2 < 0.3


def test_inflow_lag_lets_thrust_overshoot_a_step_of_rotor_speed():
    x = settled(state())
    x[13:17] *= 1.1
    at_once = loads(x)[3].mean()
    later = loads(settled(x.copy()))[3].mean()
    assert at_once > 1.05 * later


def test_rotor_plane_ground_effect_follows_cheeseman_and_bennett():
    near = BASE._replace(ground_gain=1.0)
    for height, gain in ((1, 1.067), (2, 1.016), (4, 1.004)):  # hub height in radii, thrust ratio
        x = state(z=-(height * BASE.radius + BASE.hubs[0, 2]))
        ratio = loads(x, near)[3] / loads(state(z=-3.0))[3]
        np.testing.assert_allclose(ratio, gain, atol=6e-4)


def test_a_tumbling_body_keeps_its_angular_momentum_and_a_fall_its_acceleration():
    x = state(rates=(3.0, -2.0, 4.0), speeds=0.0, induced=0.0)
    p = BASE._replace(body_drag=np.zeros(3), body_lift=0.0)
    before = attitude.rotate(x[6:10], p.inertia @ x[10:13])
    work = [np.empty(physics.PLANT_STATES) for _ in range(5)]
    for step in range(2000):
        physics.advance(step / 4000, x, np.zeros(4), np.zeros(7), 1 / 4000, p, *work, np.empty(14), np.empty(14))
    np.testing.assert_allclose(attitude.rotate(x[6:10], p.inertia @ x[10:13]), before, rtol=1e-6)
    np.testing.assert_allclose(x[3:6], [0, 0, GRAVITY * 0.5], rtol=1e-9, atol=1e-9)


def test_the_vehicle_rests_on_its_feet():
    x = state(speeds=0.0, induced=0.0, z=-0.03)
    work = [np.empty(physics.PLANT_STATES) for _ in range(5)]
    for step in range(6000):
        physics.advance(step / 4000, x, np.zeros(4), np.zeros(7), 1 / 4000, BASE, *work, np.empty(14), np.empty(14))
    dx, force, moment, _, _ = loads(x)
    np.testing.assert_allclose(force, [0, 0, -BASE_MASS * GRAVITY], atol=1e-4)
    assert abs(x[2] + 0.03) < 1e-3 and np.abs(x[3:6]).max() < 1e-4 and np.abs(moment).max() < 1e-6


def test_arms_and_hubs_lie_where_the_configuration_says():
    np.testing.assert_allclose(np.hypot(BASE.hubs[:, 0], BASE.hubs[:, 1]), ARM)
    assert (np.sign(BASE.hubs[:, 0]) == [-1, 1, -1, 1]).all()  # 1 aft right, 2 front right, 3 aft left, 4 front left
    assert (np.sign(BASE.hubs[:, 1]) == [1, 1, -1, -1]).all()
