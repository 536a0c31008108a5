"""A load that swings and air that follows late: against mechanics written apart, closed forms, and each other."""

import math

import numpy as np
import pytest
from plain_plant import made_model
from scipy.integrate import solve_ivp
from simulations import state_derivative

from quasi.attitude import GRAVITY, from_euler, matrix, to_euler
from quasi.errors import ConfigError
from quasi.model.model import Model
from quasi.simulation.loop.python_loop import QuadrotorSimulator
from quasi.simulation.loop.run import Session, simulate, simulate_many
from quasi.simulation.loop.setup import make_setup, make_step_inputs
from quasi.simulation.tools.portable import loop_constants, portable_setup
from quasi.simulation.tools.replay import replay
from quasi.simulation.vehicle.dynamics import (
    RK4,
    append_extra_states,
    integrate_step,
    make_body_constants,
    make_scratch,
)
from quasi.simulation.vehicle.layout import GIVEN_ACCELERATION, ROTOR_SPEEDS, STATE_SIZE, TARGET_SPEED
from quasi.simulation.vehicle.payload_and_inflow import PayloadAndInflow, write_payload_and_inflow

LOAD, LENGTH = 0.06, 0.45
HUNG = {"id": "payload_swing", "states": {"swinging load": {"mass": LOAD, "length": LENGTH}}}
LATE = {"id": "inflow_lag", "states": {"inflow lag": {"time constant": 0.008, "gain": 4e-8}}}
NAMES = ("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z")
SPEEDS = ("w1", "w2", "w3", "w4")


@pytest.fixture(scope="module")
def model():
    return made_model(reaction=0.0)


def bare(model):
    """The model with thrust of its rotors alone: no drag, no damping, no moments."""
    axes = {a: {**p, "terms": [{**t, "coefficient": t["coefficient"] * (a == "Fz" and "w2" in t["expression"])}
                               for t in p["terms"]]} for a, p in model.document["axes"].items()}  # fmt: skip
    return Model({**model.document, "axes": axes})


def of(model, *extensions):
    return Model({**model.document, "extensions": list(extensions)})


def hover(model, load=LOAD):
    return 1500.0 * math.sqrt(1.0 + load / model.airframe.mass)


def swung(model, parts, x, own, speeds, seconds, dt=0.002):
    """Path (N, 17 + own) in still air with constant rotor speeds."""
    body = make_body_constants(
        model.airframe.mass, model.airframe.inertia, model.kernel, GRAVITY if model.with_gravity else 0.0
    )
    write_payload_and_inflow(parts, model.airframe.hubs, body)
    held = make_step_inputs(len(model.inputs), speeds)
    x, scratch = np.concatenate([x, own]), make_scratch(model.kernel, parts.states)
    path = [x.copy()]
    for _ in range(round(seconds / dt)):
        integrate_step(RK4, dt, x, held, model.kernel, body, *scratch)
        path.append(x.copy())
    return np.array(path)


def level(speed, angles=(0.0, 0.0, 0.0)):
    x = np.zeros(STATE_SIZE)
    x[:4], x[ROTOR_SPEEDS:] = from_euler(*angles), speed
    return x


def hanging(angle, rate=(0.0, 0.0, 0.0)):
    return np.array([math.sin(angle), 0.0, math.cos(angle), *rate])


@pytest.mark.parametrize("gravity", ["withGravity", "noGravity"])
def test_vehicle_and_load_move_as_two_bodies_tied_by_a_rod(gravity):
    """Newton's law of both with the tension found from the rod's length: seven equations at a time, rotation matrix."""
    model = made_model(asymmetric=True, reaction=0.0, gravity=gravity)
    m, inertia, down = model.airframe.mass, model.airframe.inertia, np.array([0.0, 0.0, GRAVITY])
    speeds = np.array([1560.0, 1580.0, 1590.0, 1570.0])

    def slope(_, y):
        rotation, place, speed, omega, load, drift = y[:9].reshape(3, 3), y[9:12], y[12:15], y[15:18], y[18:21], y[21:]
        roll, pitch = math.atan2(rotation[2, 1], rotation[2, 2]), -math.asin(rotation[2, 0])
        yaw = math.atan2(rotation[1, 0], rotation[0, 0])
        state = np.array([roll, pitch, yaw, *(rotation.T @ speed), *omega, *place])
        force, moment = model.predict(state, speeds)
        force = rotation @ force + (m * down if model.with_gravity else 0.0)
        n, turn = (load - place) / LENGTH, drift - speed
        # unknown: accelerations of both and the tension
        system = np.zeros((7, 7))
        system[:3, :3], system[:3, 6] = m * np.eye(3), -n
        system[3:6, 3:6], system[3:6, 6] = LOAD * np.eye(3), n
        system[6, :3], system[6, 3:6] = -n, n
        found = np.linalg.solve(system, [*force, *(LOAD * down), -(turn @ turn) / LENGTH])
        skew = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
        turning = np.linalg.solve(inertia, moment - np.cross(omega, inertia @ omega))
        return [*(rotation @ skew).ravel(), *speed, *found[:3], *turning, *drift, *found[3:6]]

    x = level(0.0, (0.1, -0.15, 0.4))
    x[4:7], x[7:10], x[ROTOR_SPEEDS:] = [1.0, -0.5, 0.3], [0.4, -0.3, 0.2], speeds
    n = np.array([0.5, -0.3, math.sqrt(1 - 0.34)])
    rate = np.cross([1.5, 2.0, -1.0], n)
    rotation = matrix(x[:4])
    speed = rotation @ x[4:7]
    start = [*rotation.ravel(), 0, 0, 0, *speed, *x[7:10], *(LENGTH * n), *(speed + LENGTH * rate)]
    expected = solve_ivp(slope, (0, 1.2), start, method="DOP853", rtol=1e-10, atol=1e-11).y[:, -1]
    path = swung(model, PayloadAndInflow(load_mass=LOAD, load_length=LENGTH), x, [*n, *rate], speeds, 1.2, dt=0.001)
    end = path[-1]
    np.testing.assert_allclose(end[10:13], expected[9:12], atol=1e-6)
    np.testing.assert_allclose(matrix(end[:4]) @ end[4:7], expected[12:15], atol=1e-6)
    np.testing.assert_allclose(end[7:10], expected[15:18], atol=1e-6)
    np.testing.assert_allclose(end[10:13] + LENGTH * end[17:20], expected[18:21], atol=1e-6)
    np.testing.assert_allclose(matrix(end[:4]) @ end[4:7] + LENGTH * end[20:23], expected[21:], atol=1e-6)


@pytest.mark.parametrize("load, length", [(0.02, 0.3), (0.1, 0.5), (0.3, 1.0)])
def test_small_swings_below_a_hovering_vehicle_have_the_frequency_of_the_pair(model, load, length):
    free = bare(model)
    path = swung(free, PayloadAndInflow(load_mass=load, load_length=length), level(hover(model, load)), hanging(0.01),
                 hover(model, load), 6.0)  # fmt: skip
    north = path[:, 17]
    zero = np.flatnonzero((north[:-1] > 0) & (north[1:] <= 0))
    times = 0.002 * (zero + north[zero] / (north[zero] - north[zero + 1]))
    expected = math.sqrt(GRAVITY / length * (1.0 + load / model.airframe.mass)) / (2.0 * math.pi)
    assert 1.0 / np.mean(np.diff(times)) == pytest.approx(expected, rel=1e-4)


def sums(model, path, load=LOAD, length=LENGTH):
    """Total momentum (N, 3), energy (N,) of vehicle and load without rotation, thrust's work apart."""
    m = model.airframe.mass
    speed = path[:, 4:7]  # level
    other = speed + length * path[:, 20:23]
    height = path[:, 10:13], path[:, 10:13] + length * path[:, 17:20]
    energy = 0.5 * m * np.sum(speed**2, axis=1) + 0.5 * load * np.sum(other**2, axis=1)
    energy -= GRAVITY * (m * height[0][:, 2] + load * height[1][:, 2])
    return m * speed + load * other, energy


def test_without_damping_momentum_and_energy_are_kept(model):
    free = bare(model)
    own = hanging(1.0, (0.0, 2.0, 0.0))
    speed = hover(model)
    path = swung(free, PayloadAndInflow(load_mass=LOAD, load_length=LENGTH), level(speed), own, speed, 3.0)
    momentum, energy = sums(model, path)
    np.testing.assert_allclose(momentum, momentum[:1].repeat(len(path), 0), atol=1e-8)  # thrust carries both weights
    thrust = (model.airframe.mass + LOAD) * GRAVITY
    energy = energy + thrust * path[:, 12]  # the thrust is a constant force
    np.testing.assert_allclose(energy, energy[0], atol=1e-7)


def test_damping_takes_energy_as_it_says_and_keeps_momentum(model):
    free, ratio, speed = bare(model), 0.05, hover(model)
    parts = PayloadAndInflow(load_mass=LOAD, load_length=LENGTH, load_damping=ratio)
    path = swung(free, parts, level(speed), hanging(0.02), speed, 6.0)
    momentum, energy = sums(model, path)
    np.testing.assert_allclose(momentum, momentum[:1].repeat(len(path), 0), atol=1e-10)
    energy = energy + (model.airframe.mass + LOAD) * GRAVITY * path[:, 12]
    assert np.all(np.diff(energy) < 1e-12)
    north = path[:, 17]
    peaks = north[1:-1][(north[1:-1] > north[:-2]) & (north[1:-1] >= north[2:])]
    expected = 2.0 * math.pi * ratio / math.sqrt(1.0 - ratio**2)
    np.testing.assert_allclose(np.log(peaks[:-1] / peaks[1:]), expected, rtol=5e-3)


def test_a_rod_pushes_where_a_string_would_go_slack(model):
    """Fall without thrust: neither body feels the other, the load keeps circling at its rate."""
    path = swung(
        bare(model),
        PayloadAndInflow(load_mass=LOAD, load_length=LENGTH),
        level(0.0),
        hanging(0.0, (3.0, 0, 0)),
        0.0,
        1.0,
    )
    total = (model.airframe.mass * path[:, 10:13] + LOAD * (path[:, 10:13] + LENGTH * path[:, 17:20])) / (
        model.airframe.mass + LOAD
    )
    t = 0.002 * np.arange(len(path))
    begin = LOAD / (model.airframe.mass + LOAD) * LENGTH * np.array([0.0, 0.0, 1.0])
    drift = LOAD / (model.airframe.mass + LOAD) * LENGTH * 3.0
    np.testing.assert_allclose(total[:, 0], drift * t, atol=1e-8)
    np.testing.assert_allclose(total[:, 2], begin[2] + 0.5 * GRAVITY * t**2, atol=1e-8)
    np.testing.assert_allclose(np.unwrap(np.arctan2(path[:, 17], path[:, 19])), 3.0 * t, atol=1e-7)


@pytest.mark.parametrize("gravity", ["withGravity", "noGravity"])
def test_at_rest_the_load_hangs_along_the_apparent_vertical_and_weighs_as_if_it_were_fixed(gravity):
    model = made_model(asymmetric=True, gravity=gravity)
    x = level(1600.0, (0.2, -0.3, 1.0))
    x[4:7] = [3.0, -1.0, 0.5]
    body = make_body_constants(
        model.airframe.mass, model.airframe.inertia, model.kernel, GRAVITY if model.with_gravity else 0.0
    )
    write_payload_and_inflow(PayloadAndInflow(load_mass=LOAD, load_length=LENGTH), model.airframe.hubs, body)
    held = make_step_inputs(len(model.inputs), 1600.0)
    whole = append_extra_states(x, held, model.kernel, body)
    scratch = make_scratch(model.kernel, 6)
    state_derivative(whole, held, model.kernel, body, scratch.inputs, scratch.work, scratch.loads, scratch.derivatives)
    np.testing.assert_allclose(scratch.derivatives[0, 20:23], 0.0, atol=1e-12)
    state = np.array([*to_euler(x[:4]), *x[4:13]])
    force, _ = model.predict(state, x[ROTOR_SPEEDS:])
    rotation, weight = matrix(x[:4]), model.airframe.mass * np.array([0, 0, GRAVITY])
    force = rotation @ force - (0.0 if model.with_gravity else weight)  # aerodynamic, earth axes
    acceleration = force / (model.airframe.mass + LOAD) + [0, 0, GRAVITY]
    found = rotation @ scratch.loads[:3] / model.airframe.mass + ([0, 0, GRAVITY] if model.with_gravity else 0.0)
    np.testing.assert_allclose(found, acceleration, atol=1e-12)
    np.testing.assert_allclose(whole[17:20], -force / np.linalg.norm(force), atol=1e-12)


def test_air_that_follows_late_makes_the_thrust_of_its_closed_form(model):
    tau, gain, lag = 0.02, 4e-8, 0.03
    body = make_body_constants(model.airframe.mass, model.airframe.inertia, model.kernel, GRAVITY, lag, lag)
    write_payload_and_inflow(PayloadAndInflow(inflow_lag=tau, inflow_gain=gain), model.airframe.hubs, body)
    held = make_step_inputs(len(model.inputs), 1500.0)
    x, scratch = np.concatenate([level(1500.0), np.full(4, 1500.0)]), make_scratch(model.kernel, 4)
    held[GIVEN_ACCELERATION : GIVEN_ACCELERATION + 4] = np.nan
    held[TARGET_SPEED : TARGET_SPEED + 4] = [1800.0, 1500.0, 1500.0, 1500.0]
    for k in range(1, 41):
        integrate_step(RK4, 0.001, x, held, model.kernel, body, *scratch)
        t = 0.001 * k
        # z' = (W - z)/tau under W = 1800 - 300 exp(-t/lag), from rest
        speed = 1800.0 - 300.0 * math.exp(-t / lag)
        missing = 300.0 * tau / (lag - tau) * (math.exp(-t / lag) - math.exp(-t / tau))
        assert x[ROTOR_SPEEDS] == pytest.approx(speed, abs=1e-3)
        assert x[ROTOR_SPEEDS] - x[17] == pytest.approx(missing, abs=2e-3)
    write_payload_and_inflow(PayloadAndInflow(), model.airframe.hubs, plain := body.copy())
    state_derivative(x, held, model.kernel, body, scratch.inputs, scratch.work, scratch.loads, scratch.derivatives)
    with_air = scratch.loads.copy()
    state_derivative(x, held, model.kernel, plain, scratch.inputs, scratch.work, scratch.loads, scratch.derivatives)
    more = gain * speed * missing
    hub = model.airframe.hubs[0]
    expected = [0, 0, -more, *np.cross(hub, [0, 0, -more])]
    np.testing.assert_allclose(with_air - scratch.loads, expected, rtol=1e-4, atol=1e-9)


def flown(model, duration=2.0, **sections):
    settings = {"model": {"model ID": "made"}, "simulation": {"duration": duration, "time step": 0.002},
                "references": {"kind": "figure eight", "amplitude": 1.5, "angular speed": 2.0, "start": 0.0},
                "noise": {"add": False}}  # fmt: skip
    return make_setup({**settings, **sections}, model)


def test_compiled_python_batch_session_and_an_accurate_integrator_agree_on_both_parts(model):
    setup, short = (flown(of(model, HUNG, LATE), seconds) for seconds in (1.0, 0.2))
    assert setup.extra_states == 10 and len(setup.start) == 27
    whole = simulate(setup)
    assert whole.stopped is None
    python = QuadrotorSimulator(setup).fly().table
    for name in ("x", "u", "q", "Fz", "w1", "load_x", "load_z", "az_measured"):
        np.testing.assert_allclose(python[name], whole.table[name], rtol=1e-9, atol=1e-9, err_msg=name)
    stepwise = simulate(setup, steps={"forces_and_moments": lambda bus: bus.forces_and_moments(bus)}).table
    np.testing.assert_allclose(stepwise["load_x"], whole.table["load_x"], atol=1e-9)
    exact = QuadrotorSimulator(short, "DOP853").fly().table
    np.testing.assert_allclose(exact["x"], whole.table["x"][:101], atol=1e-5)
    np.testing.assert_allclose(exact["load_x"], whole.table["load_x"][:101], atol=1e-5)
    many = simulate_many(setup, 2, every=1, x=np.array([setup.start[:STATE_SIZE]] * 2))
    np.testing.assert_array_equal(many.states[1, :, 10], whole.table["x"])
    whole_starts = simulate_many(setup, 2, every=1, x=np.tile(setup.start, (2, 1)))
    np.testing.assert_array_equal(whole_starts.states, many.states)
    session = Session(setup)
    goal = np.zeros(20)
    goal[13] = np.nan
    assert session.advance(goal, 50) is None and session.state().shape == (17,)


def test_a_load_on_board_is_felt_seen_and_told(model):
    setup = flown(of(model, HUNG))
    assert any("load of 0.06 kg swings 0.45 m below" in note for note in setup.notes)
    table = simulate(setup).table
    gap = np.linalg.norm(table[["load_x", "load_y", "load_z"]].to_numpy() - table[["x", "y", "z"]].to_numpy(), axis=1)
    np.testing.assert_allclose(gap, LENGTH, atol=1e-9)
    assert np.ptp(table["load_x"] - table["x"]) > 0.02
    np.testing.assert_allclose(table["Fz"] / model.airframe.mass, table["az_measured"], atol=0.1)
    hovering = simulate(flown(of(model, HUNG), references={"kind": "hover"})).table.iloc[-300:]
    np.testing.assert_allclose(hovering["w1"], hover(model), rtol=1e-3)
    np.testing.assert_allclose(hovering["Fz"], -model.airframe.mass * GRAVITY, rtol=3e-3)


@pytest.mark.parametrize("extension", [HUNG, LATE])
def test_a_flight_is_replayed_with_the_part_and_not_without(model, extension):
    """From rest: how a load swings at other beginnings is not measured."""
    settings = {
        "references": {"kind": "figure eight", "amplitude": 2.0, "angular speed": 2.0, "start": 0.0},
        "duration": 1.0,
    }
    other = of(model, extension)
    table = simulate(flown(other, **settings)).table
    t, states, speeds = (table[c].to_numpy() for c in ("t", [*NAMES], [*SPEEDS]))
    runs = [replay(m, t, states, speeds, np.array([0]), 0.9)[0] for m in (other, model)]
    end = table[["u", "v", "w"]].to_numpy()[450]
    right, wrong = (np.linalg.norm(run[450, 4:7] - end) for run in runs)
    assert right < 2e-3 and wrong > 5 * right


def test_a_load_that_lies_on_the_floor_does_nothing(model):
    t, speeds = 0.002 * np.arange(300), np.full((300, 4), 1550.0)
    states = np.zeros((300, 12))
    states[:, 11] = np.where(np.arange(300) < 10, -0.2, -0.6)  # 0.2 m and 0.6 m above the floor, the string has 0.45 m
    starts = np.array([0, 20])
    hung = replay(of(model, HUNG), t, states, speeds, starts, 0.4, floor=0.0)
    bare = replay(model, t, states, speeds, starts, 0.4)
    np.testing.assert_array_equal(hung[0], bare[0])
    assert np.abs(hung[1] - bare[1]).max() > 0.1
    both = replay(of(model, HUNG), t, states, speeds, starts, 0.4)
    np.testing.assert_array_equal(hung[1], both[1])
    assert np.abs(both[0] - bare[0]).max() > 0.1


def test_recorded_rotor_speeds_are_put_right_before_they_drive(model):
    table = simulate(flown(model, 1.0)).table
    t, states, speeds = (table[c].to_numpy() for c in ("t", [*NAMES], [*SPEEDS]))
    late = np.column_stack([np.interp(t - 0.006, t, column) for column in speeds.T])
    truth = replay(model, t, states, speeds, np.array([100]), 0.5)
    aged = of(model, {"id": "telemetry_delay", "actuators": {"telemetry delay": 0.006}})
    np.testing.assert_allclose(replay(aged, t, states, late, np.array([100]), 0.5), truth, atol=1e-6)
    assert np.abs(replay(model, t, states, late, np.array([100]), 0.5) - truth).max() > 0.01
    scaled = of(model, {"id": "rotor_speed_scale", "actuators": {"rotor speed scale": 1.1}})
    found = replay(scaled, t, states, 1.1 * speeds, np.array([100]), 0.5)
    np.testing.assert_allclose(found, truth, atol=1e-9)
    orders = np.clip(speeds + 20.0, 0.0, 1799.0)
    found = replay(scaled, t, states, 1.1 * speeds, np.array([100]), 0.5, 1.1 * orders)
    np.testing.assert_allclose(found, replay(model, t, states, speeds, np.array([100]), 0.5, orders), atol=1e-9)
    setup = flown(of(model, aged.document["extensions"][0]))
    assert any("recorded rotor speeds" in note for note in setup.notes)


def test_lag_and_delay_of_causes_drive_replays_as_their_closed_form(model):
    other = of(model, {"id": "motor_lag", "actuators": {"time constant": 0.05}},
               {"id": "command_delay", "actuators": {"delay": 0.013}})  # fmt: skip
    t = 0.002 * np.arange(200)
    states, speeds = np.zeros((200, 12)), np.full((200, 4), 1500.0)
    orders = np.where(t[:, None] >= 0.1, 1520.0, 1500.0) * np.ones(4)
    found = replay(other, t, states, speeds, np.array([0]), 0.35, orders)[0, :, ROTOR_SPEEDS]
    # a command half a step late takes the mean of its two neighbours over one step
    since = t[:176] - 0.1 - 0.013
    expected = np.where(since > 0.0, 1520.0 - 20.0 * np.exp(-np.maximum(since, 0.0) / 0.05), 1500.0)
    np.testing.assert_allclose(found, expected, atol=0.3)
    plain = replay(model, t, states, speeds, np.array([0]), 0.35, orders)[0, :, ROTOR_SPEEDS]
    assert np.abs(plain - expected).max() > 3.0


def test_the_wind_of_a_cause_blows_in_replays_unless_another_is_given(model):
    other = of(model, {"id": "wind", "environment": {"wind": [3.0, -1.0, 0.0]}})
    t, states, speeds = 0.002 * np.arange(300), np.zeros((300, 12)), np.full((300, 4), 1500.0)
    air = np.tile([3.0, -1.0, 0.0], (300, 1))
    blown = replay(model, t, states, speeds, np.array([0]), 0.5, wind=air)
    np.testing.assert_array_equal(replay(other, t, states, speeds, np.array([0]), 0.5), blown)
    np.testing.assert_array_equal(
        replay(other, t, states, speeds, np.array([0]), 0.5, wind=0.0 * air),
        replay(model, t, states, speeds, np.array([0]), 0.5),
    )


def test_the_voltage_exponent_of_a_cause_moves_the_speeds_and_is_told_without_a_voltage(model):
    other = of(model, {"id": "battery_sag", "actuators": {"voltage exponent": 0.8}})
    steady = {"controller": "drone_INDI", "allocation": {"learn rotor limits": False}}
    battery = {"voltage": 15.5, "reference voltage": 16.0, "drain": 0.05}
    table = simulate(flown(other, 3.0, battery=battery, references={"kind": "hover"}, controller=steady)).table.iloc[
        -200:
    ]
    ratio = (table["w1"] / table["w1_CMD"]).to_numpy()
    np.testing.assert_allclose(ratio, (table["battery_voltage"].to_numpy() / 16.0) ** 0.8, rtol=1e-3)
    volts = of(model, {"id": "battery_sag", "actuators": {"voltage exponent": 0.8, "reference voltage": 16.0}})
    told = flown(volts, 3.0, battery={"voltage": 15.5, "drain": 0.05})
    assert told.loop_parameters.battery.reference == 16.0 and any(
        "reference voltage" in n and "16.00 V" in n for n in told.notes
    )
    assert flown(volts, 3.0, battery=battery | {"reference voltage": 15.0}).loop_parameters.battery.reference == 15.0
    setup = flown(other)
    assert setup.loop_parameters.battery.exponent == 0.0 and any("no voltage is given" in n for n in setup.notes)


def test_terms_in_the_time_run_with_the_simulation(model):
    terms = {
        "Fz": [{"expression": "(w2_1 + w2_2 + w2_3 + w2_4)*t", "coefficient": 0.01 * 0.43 * 9.81 / (4 * 1500.0**2)}]
    }
    other = of(model, {"id": "thrust_drift", "terms": terms})
    table = simulate(flown(other, 8.0, references={"kind": "hover"})).table
    late = table[table["t"] > 6.0]
    np.testing.assert_allclose(late["w1"], 1500.0 / np.sqrt(1.0 - 0.01 * late["t"]), rtol=1e-3)
    with pytest.raises(ConfigError, match="a term in the time cannot be exported"):
        loop_constants(portable_setup(other))


def test_a_closed_loop_with_a_part_does_not_travel_and_says_which(model):
    for extension, name in ((HUNG, "swinging load"), (LATE, "inflow lag")):
        with pytest.raises(ConfigError, match=f"the {name} of the model's extensions cannot be exported"):
            loop_constants(portable_setup(of(model, extension)))


@pytest.mark.parametrize(
    "states, sentence",
    [
        ({"swinging load": {"mass": 0.05}}, "expected positive numbers for mass, length"),
        ({"swinging load": {"mass": -0.05, "length": 1.0}}, "'swinging load' is .*-0.05"),
        ({"swinging load": {"mass": "heavy", "length": 1.0}}, "heavy"),
        ({"swinging load": {"mass": math.nan, "length": 1.0}}, "nan"),
        ({"swinging load": {"mass": 0.05, "lenght": 1.0}}, "lenght"),
        ({"inflow lag": None}, "'inflow lag' is None"),
        (["swinging load"], "expected positive numbers"),
    ],
)
def test_damaged_parts_are_refused_with_a_sentence(model, states, sentence):
    with pytest.raises(ConfigError, match=sentence):
        flown(of(model, {"id": "some_cause", "states": states}))


def test_two_loads_and_unknown_actuators_are_refused(model):
    with pytest.raises(ConfigError, match="'again' is the second swinging load"):
        flown(of(model, HUNG, {**HUNG, "id": "again"}))
    with pytest.raises(ConfigError, match="'delya', which the simulator does not know.*mean 'delay'"):
        flown(of(model, {"id": "x", "actuators": {"delya": 0.01}}))
    with pytest.raises(ConfigError, match="'time constant' is -1, expected a positive number"):
        flown(of(model, {"id": "x", "actuators": {"time constant": -1}}))


def test_a_step_too_long_for_late_air_is_refused(model):
    fast = {"id": "inflow_lag", "states": {"inflow lag": {"time constant": 0.0006, "gain": 4e-8}}}
    with pytest.raises(ConfigError, match="a step of 0.002 s is unstable"):
        flown(of(model, fast))


@pytest.mark.parametrize("battery", [{"voltage": 15.5, "reference voltage": 16.8, "exponent": 1},
                                     {"voltage": 15.2, "sag": 0.8, "exponent": 1}])  # fmt: skip
def test_rotors_that_are_slow_for_want_of_volts_are_not_taken_for_rotors_at_their_limit(model, battery):
    steady = simulate(flown(model, 3.0, battery=battery, references={"kind": "hover"}))
    assert steady.stopped is None
    late = steady.table[steady.table["t"] > 2.0]
    assert late["z"].abs().max() < 0.3
    np.testing.assert_allclose(late[["w1", "w2", "w3", "w4"]].to_numpy(), 1500.0, rtol=0.02)


def test_a_hover_reference_may_leave_out_its_kind(model):
    setup = flown(model, 0.1, references={"position": [0.0, 0.0, -2.0], "yaw": 1.0})
    np.testing.assert_array_equal(setup.loop_parameters.path[:4], [0.0, 0.0, -2.0, 1.0])
    np.testing.assert_array_equal(flown(model, 0.1, references={}).loop_parameters.path[:4], 0.0)


def test_a_lag_that_an_actuator_without_one_ignores_is_told(model):
    setup = flown(model, 1.0, actuator={"actuator": "none", "time constants": 0.2})
    assert any("'time constants' is not used: 'none' has no lag" in n for n in setup.notes)
