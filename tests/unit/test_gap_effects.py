"""Each cause's columns against independent physics: the made vehicle with the cause planted, per rotor, and without."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from made_model import simple_model

from quasi import attitude
from quasi.airframe import read_airframe
from quasi.attitude import GRAVITY
from quasi.errors import ConfigError, DataError
from quasi.gap.catalogue import beyond_slope, catalogue, chosen, columns_of, whole_of, wrench_of
from quasi.gap.effect import Effect, Parameter, room_of, vehicle_of
from quasi.gap.flights.evidence import Evidence, model_wrench
from quasi.gap.flights.inflow import overshoot
from quasi.gap.levels.corrections import CORRECTS
from quasi.gap.profile import Profile
from quasi.gap.statistics import mixed
from quasi.model.model import AXES, Model
from quasi_synthesis.campaign import quadrotor_configuration, read_campaign
from quasi_synthesis.effects import check, plant
from quasi_synthesis.nuisance import nominal
from quasi_synthesis.physics import PLANT_STATES, derivative, induced_velocity
from quasi_synthesis.vehicle import hover_factors

ROWS = 400
CATALOGUE = catalogue()
ROOM = room_of({"north": [-5, 5], "east": [-5, 5], "height": 5})
LEVELS = {  # what the catalogue promises
    "forces": "rotor_drag body_drag blade_flapping translational_lift axial_inflow vortex_ring ground_effect proximity "
    "rotor_interference thrust_curve thrust_factor inflow_lag rotor_speed_scale thrust_drift rotor_effectiveness "
    "rotor_tilt rotor_gyroscopic rotor_acceleration_torque mass inertia cg_offset wind gusts payload_swing tether "
    "telemetry_delay torque_factor",
    "drive": "battery_sag motor_lag command_delay actuator_saturation weak_motor",
    "sensors": "imu_lever_arm marker_offset imu_misalignment accelerometer_bias accelerometer_scale gyro_bias "
    "gyro_scale mocap_misalignment room_tilt mocap_delay clock_drift attitude_error timestamp_fault vibration "
    "rotor_order",
}
FINDINGS = {"gusts", "vibration", "timestamp_fault", "actuator_saturation", "weak_motor"}


def states(rng, spread=1.0):
    """Random flight states: position, attitude, velocity through still air, rates, rotor speeds and accelerations."""
    n = ROWS
    return {
        "t": np.arange(n) * 0.01 + 5.0,
        "x": rng.uniform(-2, 2, n), "y": rng.uniform(-2, 2, n), "z": -rng.uniform(0.08, 2.0, n),
        "roll": 0.3 * spread * rng.standard_normal(n), "pitch": 0.3 * spread * rng.standard_normal(n),
        "yaw": rng.uniform(-3, 3, n),
        **{a: s * spread * rng.standard_normal(n) for a, s in (("u", 2.0), ("v", 2.0), ("w", 1.0))},
        **{a: s * spread * rng.standard_normal(n) for a, s in (("p", 2.0), ("q", 2.0), ("r", 1.0))},
        **{f"w{i}": 2100.0 + 150.0 * spread * rng.standard_normal(n) for i in range(1, 5)},
        **{f"w{i}_dot": 3000.0 * spread * rng.standard_normal(n) for i in range(1, 5)},
    }  # fmt: skip


def physics(columns, setup):
    """Wrench about the true cg (n, 6) and angular acceleration (n, 3) of the made vehicle."""
    p = setup.vehicle.physics
    quaternion = attitude.from_euler(columns["roll"], columns["pitch"], columns["yaw"])
    velocity = attitude.rotate(quaternion, np.stack([columns[a] for a in "uvw"], axis=1))
    wrench, turning = np.empty((ROWS, 6)), np.empty((ROWS, 3))
    dx, out = np.empty(PLANT_STATES), np.empty(14)
    for k in range(ROWS):
        x = np.zeros(PLANT_STATES)
        x[:3] = [columns[a][k] for a in "xyz"]
        x[3:6], x[6:10] = velocity[k], quaternion[k]
        x[10:13] = [columns[a][k] for a in "pqr"]
        x[13:17] = [columns[f"w{i}"][k] for i in range(1, 5)]
        change = np.array([columns[f"w{i}_dot"][k] for i in range(1, 5)])
        wanted = x[13:17] + change * np.where(change > 0, p.lag_up, p.lag_down)
        through = np.array([columns[a][k] for a in "uvw"])
        for i in range(4):
            at = through + np.cross(x[10:13], p.hubs[i])
            climb, inplane = float(-at[2]), float(np.hypot(at[0], at[1]))
            x[17 + i] = induced_velocity(x[13 + i], climb, inplane, 9.7, p)
        derivative(columns["t"][k], x, wanted, np.zeros(7), p, dx, out)
        wrench[k], turning[k] = out[:6], dx[10:13]
    return wrench, turning


def measured(columns, setup, mass, inertia):
    """What the instruments say (n, 6), mass and inertia as configured, accelerometer carried to the configured cg."""
    wrench, turning = physics(columns, setup)
    p = setup.vehicle.physics
    rates = np.stack([columns[a] for a in "pqr"], axis=1)
    back = -np.broadcast_to(setup.vehicle.cg_offset, (ROWS, 3))
    specific = wrench[:, :3] / p.mass + np.cross(turning, back) + np.cross(rates, np.cross(rates, back))
    moment = turning @ inertia.T + np.cross(rates, rates @ inertia.T)
    return np.hstack([mass * specific, moment])


@pytest.fixture(scope="module")
def ground():
    campaign = read_campaign({"flights": [{"key": "a", "profile": "mixed", "seed": 1}], "duration": 18}, "t")
    airframe = read_airframe(quadrotor_configuration(campaign), "made")
    setup = nominal(120.0, 0.0)
    factors = hover_factors(setup.vehicle.physics)
    return airframe, setup, simple_model(airframe, factors["thrust"], factors["torque"])


def residual_of(ground, effects, seed=3, spread=1.0):
    """Evidence whose model is the physics without the effect, measured with it: only the effect is left."""
    airframe, setup, model = ground
    columns = states(np.random.default_rng(seed), spread)
    if "proximity" in effects:  # beside the north wall
        columns["x"] = columns["x"] + 2.6
    healthy, _ = physics(columns, setup)
    planted = plant(setup, check(effects, "test"))
    mass, inertia = airframe.mass or setup.vehicle.physics.mass, np.asarray(airframe.inertia)
    columns |= {axis: healthy[:, k] for k, axis in enumerate(AXES)}
    evidence = Evidence(
        "a", airframe, model, mass, inertia, columns, measured(columns, planted, mass, inertia), healthy
    )
    # the healthy vehicle's own mass and inertia are the configured ones
    np.testing.assert_allclose(measured(columns, setup, mass, inertia), healthy, atol=2e-3 * GRAVITY)
    return evidence


CASES = {
    "rotor_drag": ({"k": 1e-5}, {"k": 1e-5, "lever": 0.0, "yaw": 1e-5}, 0.02),  # the hubs' height is configured
    "body_drag": ({"c": 0.02}, {"c": 0.02, "cz": -0.02 * 0.004}, 0.01),  # it acts 4 mm above the cg
    "blade_flapping": ({"k": 3e-7}, {"k": 3e-7}, 0.02),
    "translational_lift": ({"k": 0.01}, {"k": 0.01}, 0.06),  # some is lost in the wakes of the rotors ahead
    "axial_inflow": ({"k": 3e-5}, {"k": 3e-5, "damping": 3e-5}, 0.05),
    "thrust_curve": ({"c1": 3e-5}, {"c1": 3e-5}, 0.05),
    "thrust_factor": ({"factor": 0.97}, {"factor": -0.03}, 0.2),
    "torque_factor": ({"factor": 1.2}, {"factor": 0.2}, 0.3),
    "thrust_drift": ({"rate": -0.002}, {"rate": -0.002}, 0.2),
    "rotor_effectiveness": ({"rotor2": 0.95}, {"rotor2": -0.05}, 0.2),
    "rotor_tilt": ({"rotor1": 0.03}, {"rotor1": 0.03}, 0.3),
    "rotor_gyroscopic": ({"inertia": 2e-6}, {"inertia": 2e-6}, 0.02),
    "rotor_acceleration_torque": ({"inertia": 2e-6}, {"inertia": 2e-6}, 0.02),
    "rotor_interference": ({"k": 0.1}, {"k": 0.1}, 0.2),
    "tether": ({"k": 0.2}, {"k": 0.2}, 0.02),
    "ground_effect": ({"c": 2.0}, {"c": 2.0, "levelling": 2.0}, 0.15),
    "mass": ({"mass": 0.44}, None, 0.03),
    "inertia": ({"Ixx": 9e-4, "Ixz": 2e-5}, None, 0.1),
    "cg_offset": ({"x": 0.002, "y": -0.001, "z": 0.001}, {"x": 0.002, "y": -0.001, "z": 0.001}, 0.1),
    "vortex_ring": ({"depth": 0.1}, {"depth": 0.1}, 0.6),
    "proximity": ({"gain": 0.2}, {"gain": 0.2}, 0.2),
}


@pytest.mark.parametrize("name", CASES)
def test_columns_have_the_sign_and_size_of_independent_physics(ground, name):
    planted, expected, tolerance = CASES[name]
    airframe, setup, model = ground
    evidence = residual_of(ground, {name: planted})
    vehicle = vehicle_of(model, evidence.mass, evidence.inertia, ROOM)
    effect = CATALOGUE[name]
    columns = columns_of(effect, evidence, vehicle, dict.fromkeys(effect.parameters, 0.0))
    if name == "mass":
        expected = {"mass": planted["mass"] - evidence.mass}
    if name == "inertia":
        expected = {"Ixx": planted["Ixx"] - evidence.inertia[0, 0], "Ixz": planted["Ixz"]}
    predicted = sum(columns[p] * value for p, value in expected.items())
    scale = np.array([1.0, 1.0, 1.0, 20.0, 20.0, 20.0])  # N and N m side by side
    residual = evidence.residual * scale
    error = residual - predicted * scale
    share = np.sqrt(np.mean(error**2) / np.mean(residual**2))
    assert share < tolerance, f"{name}: columns leave {share:.2f} of what the physics makes"


def test_a_cable_is_fixed_at_any_point_of_the_floor(ground):
    evidence, k = residual_of(ground, {"tether": {"k": 0.2}}), 0.2
    # the same flight in a room whose origin is elsewhere: the cable is fixed at (1.5, -1, 0) m
    columns = evidence.columns | {"x": evidence.columns["x"] + 1.5, "y": evidence.columns["y"] - 1.0}
    moved, vehicle = replace(evidence, columns=columns), vehicle_of(ground[2], evidence.mass, evidence.inertia, ROOM)
    effect = CATALOGUE["tether"]
    slopes = columns_of(effect, moved, vehicle, dict.fromkeys(effect.parameters, 0.0))
    found = np.linalg.lstsq(
        np.column_stack([slopes[name][:, :3].ravel() for name in effect.parameters]), moved.residual[:, :3].ravel()
    )[0]
    np.testing.assert_allclose(found, [k, 1.5 * k, -1.0 * k], rtol=0.02)


@pytest.mark.parametrize("name", ["thrust_curve", "thrust_factor", "rotor_effectiveness"])
def test_the_flow_that_thrust_drives_draws_torque(ground, name):
    """Momentum theory's power T v, which the physics' blade elements make without it."""
    planted, expected, _ = CASES[name]
    evidence = residual_of(ground, {name: planted})
    vehicle = vehicle_of(ground[2], evidence.mass, evidence.inertia, ROOM)
    columns = columns_of(CATALOGUE[name], evidence, vehicle, dict.fromkeys(CATALOGUE[name].parameters, 0.0))
    torques = {p.replace("rotor", "torque").replace("factor", "torque"): v for p, v in expected.items()}
    share = vehicle.drawn / vehicle.torque
    expected = expected | {p: share * v for p, v in torques.items() if name != "thrust_curve"}
    yaw, predicted = evidence.residual[:, 5], sum(columns[p] * value for p, value in expected.items())[:, 5]
    assert np.square(yaw - predicted).mean() < 0.25 * np.square(yaw).mean()


def test_every_wrench_cause_of_the_catalogue_is_tested_for_its_sign():
    elsewhere = {"payload_swing", "inflow_lag", "telemetry_delay", "rotor_speed_scale", "wind"}
    wrench = {name for name, e in CATALOGUE.items() if e.level == "forces" and not e.finding}
    assert wrench - elsewhere <= set(CASES)


@pytest.mark.parametrize("name", ["wind", "telemetry_delay", "rotor_speed_scale"])
def test_columns_through_the_model_follow_from_differences(ground, name):
    """Wind, late and mis-scaled speeds act through the model's own arguments: shift those and subtract."""
    airframe, setup, model = ground
    columns = states(np.random.default_rng(4))
    speeds = np.stack([columns[f"w{i}"] for i in range(1, 5)], axis=1)
    dots = np.stack([columns[f"w{i}_dot"] for i in range(1, 5)], axis=1)

    def wrench(velocity, rotors):
        state = np.zeros((ROWS, 9))
        state[:, 3:6], state[:, 6:] = velocity, np.stack([columns[a] for a in "pqr"], axis=1)
        return np.hstack(model.predict(state, rotors))

    velocity = np.stack([columns[a] for a in "uvw"], axis=1)
    now = wrench(velocity, speeds)
    if name == "wind":
        value, parameter = 0.1, "east"
        quaternion = attitude.from_euler(columns["roll"], columns["pitch"], columns["yaw"])
        true = wrench(velocity - attitude.rotate_inverse(quaternion, np.array([0.0, value, 0.0])), speeds)
    elif name == "telemetry_delay":
        value, parameter = 1e-4, "delay"
        true = wrench(velocity, speeds + dots * value)  # the true speed is ahead of the logged one
    else:
        value, parameter = 1e-4, "scale"
        true = wrench(velocity, speeds / (1.0 + value))
    evidence = Evidence("a", airframe, model, 0.433, np.asarray(airframe.inertia), columns, true, now)
    effect, vehicle = CATALOGUE[name], vehicle_of(model, 0.433)
    column = columns_of(effect, evidence, vehicle, dict.fromkeys(effect.parameters, 0.0))[parameter]
    np.testing.assert_allclose(
        column * value, evidence.residual, rtol=2e-2, atol=2e-3 * np.abs(evidence.residual).max()
    )


def test_a_large_wrong_scale_of_rotor_speeds_bends(ground):
    """Twelve poles for fourteen: thrust goes with the square, which a slope alone misses by a fifth."""
    airframe, _, model = ground
    columns = states(np.random.default_rng(4))
    speeds = np.stack([columns[f"w{i}"] for i in range(1, 5)], axis=1)
    state = np.zeros((ROWS, 9))
    state[:, 3:6] = np.stack([columns[a] for a in "uvw"], axis=1)
    state[:, 6:] = np.stack([columns[a] for a in "pqr"], axis=1)
    now, true = (np.hstack(model.predict(state, rotors)) for rotors in (speeds, speeds / (12.0 / 14.0)))
    evidence = Evidence("a", airframe, model, 0.433, np.asarray(airframe.inertia), columns, true, now)
    effect, vehicle, value = CATALOGUE["rotor_speed_scale"], vehicle_of(model, 0.433), {"scale": 12.0 / 14.0 - 1.0}
    np.testing.assert_allclose(whole_of(effect, evidence, vehicle, value), evidence.residual, atol=1e-9)
    slope = columns_of(effect, evidence, vehicle, {"scale": 0.0})["scale"] * value["scale"]
    assert np.abs(slope[:, 2]).mean() < 0.85 * np.abs(evidence.residual[:, 2]).mean()


def test_a_wind_is_a_shift_of_airspeed_where_lift_goes_with_its_square_and_forces_size_it(ground):
    """At 3 m/s in hover a slope at no wind has no lift at all."""
    airframe, _, simple = ground
    document = copy.deepcopy(simple.document)
    for axis, expression, coefficient in (("Fz", "u^2 + v^2", -0.0045), ("Mx", "v", 0.001)):
        one = {**document["axes"][axis]["terms"][0], "name": expression, "expression": expression}
        document["axes"][axis]["terms"].append({**one, "coefficient": coefficient, "given": True})
    model, columns = Model(document, "test"), states(np.random.default_rng(4), spread=0.2)
    along = attitude.rotate_inverse(
        attitude.from_euler(*(columns[a] for a in ("roll", "pitch", "yaw"))), np.array([2.4, -1.8, 0.0])
    )
    now, true = (model_wrench(model, {**columns, **{a: columns[a] - s * along[:, k] for k, a in enumerate("uvw")}})
                 for s in (0, 1))  # fmt: skip
    evidence = Evidence("a", airframe, model, 0.433, np.asarray(airframe.inertia), columns, true, now)
    effect, vehicle, value = CATALOGUE["wind"], vehicle_of(model, 0.433), {"north": 2.4, "east": -1.8, "down": 0.0}
    np.testing.assert_allclose(whole_of(effect, evidence, vehicle, value), evidence.residual, atol=1e-9)
    slopes = columns_of(effect, evidence, vehicle, {})
    lift = sum(slopes[n][:, 2] * v for n, v in value.items())
    assert evidence.residual[:, 2].mean() == pytest.approx(-0.0045 * 9.0, rel=0.1) and abs(lift.mean()) < 0.008
    there = columns_of(effect, evidence, vehicle, value)
    assert not any(np.any(c[:, 3:]) for c in there.values()) and np.any(evidence.residual[:, 3])
    more = beyond_slope(effect, evidence, vehicle, value, there)
    forces = sum(there[n][:, :3] * v for n, v in value.items()) + more[:, :3]
    np.testing.assert_allclose(forces, evidence.residual[:, :3], atol=1e-9)


def test_inflow_that_lags_makes_thrust_overshoot_as_the_physics_say(ground):
    """Ramp of rotor speed in hover: the induced velocity follows by its own equation, thrust is ahead."""
    airframe, setup, model = ground
    p = setup.vehicle.physics
    tau, rate, speed = 0.004, 2000.0, 2110.0
    gain = 0.25 * p.density * p.lift_slope * p.solidity * np.pi * p.radius**2 * speed * p.radius
    equilibrium = [induced_velocity(s, 0.0, 0.0, 9.7, p) for s in (speed - 1.0, speed + 1.0)]
    behind = -tau * rate * (equilibrium[1] - equilibrium[0]) / 2.0  # a ramp is followed tau late
    surplus = -gain * behind  # of one rotor
    vehicle = vehicle_of(model, 0.433)
    assert vehicle.inflow * speed * rate * tau == pytest.approx(surplus, rel=0.35)


def test_late_inflow_overshoots_as_a_plain_integration_of_its_lag(ground):
    """Squares of rotor speed less what a first-order lag makes of them, step by step."""
    airframe, _, model = ground
    lag, gain = 0.03, 2e-8
    t = 0.01 * np.arange(120)
    t[60:] += 0.5  # a gap
    speeds = 2000.0 + 300.0 * np.sin(np.outer(t, [9.0, 14.0, 20.0, 31.0]))
    dots = 300.0 * np.array([9.0, 14.0, 20.0, 31.0]) * np.cos(np.outer(t, [9.0, 14.0, 20.0, 31.0]))
    columns = {"t": t} | {f"w{i + 1}": speeds[:, i] for i in range(4)} | {f"w{i + 1}_dot": dots[:, i] for i in range(4)}
    nothing = np.zeros((len(t), 6))
    evidence = Evidence("a", airframe, model, 0.433, np.asarray(airframe.inertia), columns, nothing, nothing)
    late = np.empty_like(evidence.speeds)
    late[0] = evidence.speeds[0] ** 2
    step = float(np.median(np.diff(evidence.t)))
    fine = 200
    for k in range(1, len(evidence)):
        state = late[k - 1].copy()
        for j in range(fine):
            share = (j + 0.5) / fine
            target = (1.0 - share) * evidence.speeds[k - 1] ** 2 + share * evidence.speeds[k] ** 2
            state += step / fine * (target - state) / lag
        late[k] = speeds[k] ** 2 if evidence.breaks[k] else state
    expected = evidence.upward(0.5 * gain * (evidence.speeds**2 - late))
    np.testing.assert_allclose(overshoot(evidence, gain, lag), expected, atol=1e-3 * np.abs(expected).max())
    small = overshoot(evidence, gain, 4.9e-4)
    first = evidence.upward(gain * 4.9e-4 * evidence.speeds * evidence.spin_up)
    np.testing.assert_allclose(small, first)


def test_the_catalogue_is_complete():
    promised = {name: level for level, names in LEVELS.items() for name in names.split()}
    assert {name: effect.level for name, effect in CATALOGUE.items()} == promised
    assert {name for name, effect in CATALOGUE.items() if effect.finding} == FINDINGS


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_definition_says_everything(name):
    effect = CATALOGUE[name]
    for text in (effect.sentence, effect.equation, effect.source, effect.tie_breaker):
        assert text and len(text) < 250
    assert not effect.sentence.endswith(".") and effect.channels
    assert effect.rivals and set(effect.rivals) <= set(CATALOGUE) - {name}
    for parameter in effect.parameters.values():
        assert parameter.neutral is None or parameter.low <= parameter.neutral <= parameter.high
    if effect.finding:
        assert not effect.parameters and effect.terms is None and effect.columns is None
    elif effect.level == "forces":
        assert effect.terms is not None or (effect.columns is not None and effect.extension is not None)
    elif effect.level == "drive":
        assert effect.parameters and effect.extension is not None
    else:  # a sensor's fault is corrected by import; how an estimate leans is not undone there
        assert effect.parameters and (name in CORRECTS or name == "attitude_error")
        if name in CORRECTS:
            assert tuple(effect.parameters) == CORRECTS[name][2]


def test_walls_and_ceiling_by_a_plain_loop(ground):
    """Thrust of each rotor by where its hub is, one row after the other."""
    evidence = residual_of(ground, {"proximity": {"gain": 0.1}})
    vehicle = vehicle_of(ground[2], evidence.mass, None, room_of({"north": [-1, 5.5], "east": [-5, 4], "height": 2.2}))
    columns = columns_of(CATALOGUE["proximity"], evidence, vehicle, {})
    quaternion = evidence.quaternion
    for k in range(0, ROWS, 29):
        wall = ceiling = 0.0
        for i in range(4):
            x, y, z = evidence.position[k] + attitude.matrix(quaternion[k]) @ vehicle.hubs[i]
            distance = max(min(x + 1.0, 5.5 - x, y + 5.0, 4.0 - y), 0.0)
            thrust = vehicle.thrust * evidence.speeds[k, i] ** 2
            wall += thrust * np.exp(-(distance**2))
            ceiling -= thrust * (vehicle.radius / (4.0 * max(2.2 + z, 0.2 * vehicle.radius))) ** 2
        assert columns["gain"][k, 2] == pytest.approx(wall, rel=1e-9)
        assert columns["ceiling"][k, 2] == pytest.approx(ceiling, rel=1e-9)


def test_without_a_room_nobody_asks_for_walls(ground):
    evidence = residual_of(ground, {})
    with pytest.raises(DataError, match="the walls are unknown"):
        columns_of(CATALOGUE["proximity"], evidence, vehicle_of(ground[2], evidence.mass), {})
    for wrong in ({"north": [5, -5], "east": [0, 1]}, {"north": [0, 1]}, {"north": "ab", "east": [0, 1]}, 3):
        with pytest.raises(ConfigError, match="expected walls in m"):
            room_of(wrong)
    assert room_of(None) is None


def test_a_curved_effect_starts_with_its_slope(ground):
    evidence = residual_of(ground, {})
    vehicle = vehicle_of(ground[2], evidence.mass)
    effect = CATALOGUE["ground_effect"]
    slopes = columns_of(effect, evidence, vehicle, {})
    for name, slope in slopes.items():
        small = wrench_of(effect.nonlinear_terms(vehicle, {name: 1e-4}), evidence)
        np.testing.assert_allclose(small, slope * 1e-4, rtol=1e-2, atol=1e-12)


def test_a_take_off_does_not_hide_the_effect_of_the_ground(ground):
    """Next to the floor rotors gain far less than the formula gives, and a few seconds there decided its factor."""
    evidence = residual_of(ground, {})
    vehicle, effect = vehicle_of(ground[2], evidence.mass), CATALOGUE["ground_effect"]
    rows = len(evidence)
    heights = np.where(np.arange(rows) % 10 == 0, 0.1, np.linspace(1.0, 3.0, rows)) * vehicle.radius  # of the hubs
    place = {"roll": np.zeros(rows), "pitch": np.zeros(rows), "z": -heights - ground[0].hubs[0][2]}
    near = replace(evidence, columns={**evidence.columns, **place})
    thrust = vehicle.thrust * sum(near.columns[f"w{i}"] ** 2 for i in range(1, 5))
    slope = -columns_of(effect, near, vehicle, {})["c"][:, 2] / thrust
    gain = 0.04 * (vehicle.radius / np.maximum(heights, 0.5 * vehicle.radius)) ** 2  # of the thrust, as it levels off
    assert slope @ gain / (slope @ slope) == pytest.approx(16 * 0.04, rel=0.1)


def test_a_user_adds_a_cause_with_one_file(tmp_path):
    path = tmp_path / "sticky.py"
    path.write_text(
        "from quasi.gap.effect import Effect, Parameter\n"
        "EFFECT = Effect(id='sticky', level='forces', sentence='s', equation='e', source='s',\n"
        "    parameters={'k': Parameter('N', 0.0, 'a', 0.0, 1.0)}, terms=lambda vehicle: {'k': {'Fx': '1'}})\n"
    )
    assert "sticky" in catalogue([path])
    path.write_text("EFFECT = 3\n")
    with pytest.raises(ConfigError, match=r"sticky\.py defines no EFFECT"):
        catalogue([path])
    path.write_text("def (:\n")
    with pytest.raises(ConfigError, match=r"sticky\.py: SyntaxError"):
        catalogue([path])


def test_wrong_effects_are_refused_with_a_sentence():
    with pytest.raises(ConfigError, match="did you mean 'ground_effect'"):
        chosen(["ground_efect"], CATALOGUE, "config/gaps/g.json")
    with pytest.raises(ConfigError, match="level is 'Q'"):
        Effect("a", "Q", "", "", "")
    with pytest.raises(ConfigError, match="parameter 'k'"):
        Effect("a", "forces", "", "", "", {"k": Parameter("1", 0.0, "x", 0.0, 1.0)})


def test_inertias_of_bodies_are_possible_and_others_are_not(ground):
    """Of clouds of point masses, and of a disc that turns more heavily than it tilts."""
    vehicle, effect = vehicle_of(ground[2]), CATALOGUE["inertia"]
    limits, rng = effect.limits(vehicle), np.random.default_rng(4)

    def told(tensor, std=1e-7):
        own = tensor - vehicle.inertia
        value = np.array([own[0, 0], own[1, 1], own[2, 2], -own[0, 1], -own[0, 2], -own[1, 2]])
        offer = mixed.Candidate("inertia", "changed", tuple(range(6)))
        return mixed.Test(offer, value, np.eye(6) * std**2, 0.0, 100.0, 1e-9)

    for _ in range(50):
        points = rng.standard_normal((5, 3)) * rng.uniform(0.01, 0.1, 3)
        tensor = 0.1 * (np.eye(3) * np.sum(points**2) - points.T @ points)
        assert Profile(limits=limits).is_possible(told(tensor))
    assert Profile(limits=limits).is_possible(told(np.diag([1e-3, 1e-3, 1.99e-3])))
    assert not Profile(limits=limits).is_possible(told(np.diag([1e-3, 1e-3, 2.5e-3])))
    assert Profile(limits=limits).is_possible(told(np.diag([1e-3, 1e-3, 2.5e-3]), 2e-4))


def test_a_constant_error_of_the_models_moment_turns_no_vehicle(ground):
    """A Crazyflie whose cg is 3 mm off: the model turned it by 43 rad/s2, and the offset was refused for its force."""
    evidence = residual_of(ground, {"mass": {"mass": 0.44}})
    turned = evidence.predicted + np.array([0.0, 0.0, 0.0, 0.02, -0.03, 0.0])
    effect = CATALOGUE["cg_offset"]
    for values in ({}, {"x": 0.003, "y": 0.002, "z": 0.0}):
        first, last = (effect.columns(replace(evidence, predicted=p), values) for p in (evidence.predicted, turned))
        for name in "xyz":
            np.testing.assert_allclose(first[name], last[name], atol=1e-9)
