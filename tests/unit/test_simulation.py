"""The closed loop: compiled and Python ways alike, batches, sessions, faults, what is refused and what is told."""

import math

import numpy as np
import pandas as pd
import pytest
from plain_plant import made_model

from quasi.errors import ConfigError, DataError, ShapeError
from quasi.simulation.quadrotor import QuadrotorSimulator
from quasi.simulation.result import report
from quasi.simulation.run import Session, simulate, simulate_many
from quasi.simulation.setup import make_setup
from quasi.standalone.model import Model

EIGHT = {"do circle track": True}


@pytest.fixture(scope="module")
def model():
    return made_model(asymmetric=True)


def setup_of(model, duration=2.0, step=0.004, **sections):
    simulation = {"time step": step, "duration": duration, **sections.pop("simulation", {})}
    return make_setup({"model": {"model ID": "made"}, "simulation": simulation, **sections}, model)


ROUGH = {
    "references": {"kind": "figure eight", "start": 0.2, "amplitude": 2.0},
    "wind": {"gusts": [0.5, 0.5, 0.2], "steady": [1, 0, 0]},
    "actuator": {"delay": 0.006},
    "battery": {"voltage": 16.0, "drain": 0.1, "sag": 0.5, "exponent": 0.5},
    "faults": {"inject failure": True, "time of failure": 0.6, "rotor effectiveness after failure": [1, 0.8, 1, 1]},
}
WAYS = {
    "rk4": {},
    "euler": {"simulation": {"integrator": "euler", "time step": 0.002}},
    "substeps, every seventh row": {"simulation": {"substeps": 3, "log every": 7}},
    "PID": {"controller": {"controller": "drone_PID"}},
    "NDI": {"controller": {"controller": "drone_NDI"}},
    "rate limit": {"actuator": {"actuator": "rotorDynamicsV1"}},
    "saturation alone": {"actuator": {"actuator": "rotorDynamicsSaturation"}},
    "no noise": {"noise": {"add": False}},
}


def assert_same(a, b):
    assert a.status == b.status and a.steps == b.steps and a.stopped == b.stopped
    pd.testing.assert_frame_equal(a.table, b.table, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("way", WAYS)
def test_the_python_loop_equals_the_compiled_one(model, way):
    setup = setup_of(model, **{**ROUGH, **WAYS[way]})
    compiled = simulate(setup)
    assert len(compiled.table) == setup.steps // setup.every + 1
    assert_same(compiled, simulate(setup, between={"controller": lambda bus: None}))


@pytest.mark.parametrize("step", ["controller", "forces_and_moments", "equations_of_motion"])
@pytest.mark.parametrize("way", ["rk4", "euler"])
def test_a_users_step_that_calls_the_built_in_one_changes_nothing(model, step, way):
    setup = setup_of(model, duration=0.8, **{**ROUGH, **WAYS[way]})
    assert_same(simulate(setup), simulate(setup, {step: lambda bus: getattr(bus, step)(bus)}))


def test_a_users_actuator_gives_the_speeds_at_the_end_of_each_step(model):
    setup = setup_of(model, duration=0.5, **ROUGH)
    own = simulate(setup, {"actuator": lambda bus: bus.actuator(bus)})
    built_in = simulate(setup)
    # the exact solution of the lag at the ends, straight lines between: second order in the step
    np.testing.assert_allclose(own.table["w1"], built_in.table["w1"], rtol=2e-4)
    np.testing.assert_allclose(own.table["x"], built_in.table["x"], atol=2e-3)


@pytest.mark.parametrize("hook", ["begin", "equations_of_motion"])
def test_the_bus_holds_state_derivatives_and_forces_of_each_step(model, hook):
    simulator = QuadrotorSimulator(setup_of(model, duration=0.1, noise={"add": False}, wind={"steady": [2, 0, 0]}))
    simulator.add_step(hook, lambda bus: None)
    bus, k = simulator.run(), 12
    ahead = (bus.state[k + 1] - bus.state[k - 1]) / (2 * bus.time_step)
    np.testing.assert_allclose(bus.state_derivative[k + 1][4:13], ahead[4:13], atol=0.02)
    np.testing.assert_allclose(bus.quaternion[k], bus.state[k, :4])
    assert bus.forces[k + 1, 2] == pytest.approx(-0.43 * 9.81, rel=0.05)


def test_an_adaptive_integrator_confirms_the_fixed_step(model):
    setup = setup_of(model, duration=0.4, noise={"add": False}, references=ROUGH["references"])
    reference = simulate(setup_of(model, duration=0.4, noise={"add": False}, references=ROUGH["references"],
                                  simulation={"integrator": "DOP853"}))  # fmt: skip
    columns = ["x", "y", "z", "u", "v", "w", "p", "q", "r", "roll", "pitch", "yaw"]
    np.testing.assert_allclose(simulate(setup).table[columns], reference.table[columns], atol=3e-5)


def test_hover_stays_where_it_is_without_noise_once_asymmetries_are_taken_off(model):
    table = simulate(setup_of(model, noise={"add": False})).table
    assert np.abs(table[["x", "y", "z", "u", "v", "w", "p", "q", "r"]].to_numpy()).max() < 1e-9
    np.testing.assert_allclose(table["Fz"], -0.43 * 9.81, rtol=1e-9)
    kept = {"model ID": "made", "correct for moment asymmetries": False}
    crooked = simulate(make_setup({"model": kept, "noise": {"add": False}}, model)).table
    assert crooked[["x", "y", "z"]].abs().to_numpy().max() > 0.001
    end = crooked.iloc[-1]
    assert max(end[f"w{i}"] for i in range(1, 5)) - min(end[f"w{i}"] for i in range(1, 5)) > 10.0


@pytest.mark.parametrize("gravity", ["withGravity", "noGravity"])
def test_a_resting_accelerometer_reads_the_thrust_whatever_the_kind_of_the_models_forces(gravity):
    table = simulate(setup_of(made_model(gravity=gravity), duration=0.1, noise={"add": False})).table
    np.testing.assert_allclose(table[["ax_measured", "ay_measured"]], 0.0, atol=1e-9)
    np.testing.assert_allclose(table["az_measured"], -9.81, atol=1e-6)
    assert table["z"].abs().max() < 1e-8


def test_noise_has_its_seed_and_size_and_leaves_the_gusts_alone(model):
    def run(**noise):
        return simulate(setup_of(model, noise=noise, wind={"gusts": [0.4, 0.4, 0.4]})).table

    a, b, c = run(seed=1), run(seed=1), run(seed=2)
    pd.testing.assert_frame_equal(a, b)
    assert not np.allclose(a["p_measured"], c["p_measured"])
    assert (a["p_measured"] - a["p"]).std() == pytest.approx(0.00934, rel=0.15)
    assert (a["roll_measured"] - a["roll"]).std() == pytest.approx(0.01, rel=0.15)
    quiet = simulate(setup_of(model, noise={"add": False, "seed": 1}, wind={"gusts": [0.4, 0.4, 0.4]})).table
    np.testing.assert_array_equal(quiet["wind_north"], a["wind_north"])


def test_a_delay_shifts_the_commands_by_its_time_fractions_of_a_step_included(model):
    steps = [[0.0, 0.0, 0.0, 0.0], [0.1, 0.0, 0.0, -1.0]]
    ways = [
        simulate(setup_of(model, duration=0.5, noise={"add": False}, actuator={"delay": late, "actuator": kind},
                          references={"kind": "position steps", "steps": steps})).table
        for late, kind in ((0.010, "rotorDynamicsSaturation"),)
    ]  # fmt: skip
    command, speed = ways[0]["w1_CMD"].to_numpy(), ways[0]["w1"].to_numpy()
    # 10 ms are two and a half steps: the mean of the commands two and three steps ago
    np.testing.assert_allclose(speed[3:], 0.5 * (command[1:-2] + command[:-3]), rtol=1e-12)


def test_the_manuals_cap_loses_control_and_full_effectiveness_does_not(model):
    fault = {"inject failure": True, "time of failure": 0.5, "rotor health after failure": [0.5, 1, 0.75, 1]}
    capped = simulate(setup_of(model, 3.0, controller={"controller": "drone_NDI"}, faults=fault))
    after = capped.table[capped.table["t"] > 0.6]
    top = made_model().airframe.max_rpm * made_model().airframe.logged_to_rad_s
    assert after["w1"].max() <= 0.5 * top + 1e-9 and after["w3"].max() <= 0.75 * top + 1e-9
    assert capped.stopped or capped.table[["x", "y", "z"]].abs().to_numpy().max() > 1.0
    whole = simulate(setup_of(model, 3.0, controller={"controller": "drone_NDI"}))
    assert whole.table[["x", "y", "z"]].abs().to_numpy().max() < 0.1


def test_a_cap_as_a_users_actuator_is_the_manuals_listing_13(model):
    top = 0.5 * made_model().airframe.max_rpm * made_model().airframe.logged_to_rad_s

    def capped(bus):
        speeds = bus.actuator(bus)
        if bus.time[bus.step] >= 0.2:
            speeds[0] = min(speeds[0], top)
        return speeds

    table = simulate(setup_of(model, 0.8, noise={"add": False}), {"actuator": capped}).table
    assert table["w1"][table["t"] > 0.25].max() <= top + 1e-9 and table["z"].iloc[-1] > 0.02


def test_a_batch_equals_its_members_alone_and_varies_what_is_varied(model):
    setup = setup_of(model, 1.0, **{k: ROUGH[k] for k in ("references", "wind", "actuator")})
    many = simulate_many(setup, 5, every=1)
    alone = simulate(setup).table
    np.testing.assert_array_equal(many.states[0, :, 4:13], alone[["u", "v", "w", "p", "q", "r", "x", "y", "z"]])
    np.testing.assert_array_equal(many.t, alone["t"])
    assert not np.allclose(many.states[0], many.states[1])
    seeds = np.full(5, setup.seeds[0])
    x = np.tile(setup.start, (5, 1))
    x[:, 10] = np.arange(5)
    mass = np.array([0.43, 0.43, 0.45, 0.43, 0.43])
    share = np.ones((5, 4))
    share[3, 0] = 0.7
    varied = simulate_many(setup, 5, seeds, 1, x=x, mass=mass, effectiveness=share, fault_time=np.zeros(5))
    same = simulate_many(setup, 5, seeds, 1, x=x)
    np.testing.assert_array_equal(varied.states[[0, 1, 4]], same.states[[0, 1, 4]])
    assert np.abs(varied.states[[2, 3]] - same.states[[2, 3]]).max() > 0.01
    assert (many.status == 0).all() and (many.steps == setup.steps).all()


def test_a_batch_refuses_what_it_cannot_vary(model):
    with pytest.raises(ConfigError, match="a batch needs the integrator 'rk4' or 'euler'"):
        simulate_many(setup_of(model, 0.1, simulation={"integrator": "RK45"}), 2)
    setup = setup_of(model, 0.1)
    with pytest.raises(ConfigError, match="cannot vary 'masss'.*mass"):
        simulate_many(setup, 2, masss=np.ones(2))
    with pytest.raises(ShapeError, match=r"'mass' of a batch must be \(2,\)"):
        simulate_many(setup, 2, mass=np.ones(3))


def test_a_session_in_chunks_equals_a_whole_run(model):
    setup = setup_of(model, 0.4, references={"kind": "hover", "position": [1, 0, -1]})
    session = Session(setup)
    goal = np.zeros(20)
    goal[1:4], goal[13] = [1, 0, -1], np.nan
    for steps in (30, 1, 69):
        assert session.advance(goal, steps) is None
    whole = simulate(setup).table.iloc[-1]
    assert session.t == pytest.approx(0.4)
    np.testing.assert_array_equal(session.state()[10:13], whole[["x", "y", "z"]].to_numpy(float))
    session.restart()
    np.testing.assert_array_equal(session.state(), setup.start)


def unstable():
    """A model whose roll rate feeds itself, faster than any rotor."""
    document = dict(made_model().document)
    part = document["axes"]["Mx"]
    terms = [{**t, "coefficient": 0.5} if t["expression"] == "p" else t for t in part["terms"]]
    document["axes"] = {**document["axes"], "Mx": {**part, "terms": terms}}
    return Model(document)


def test_divergence_stops_and_says_when_and_which_and_keeps_what_was_computed():
    setup = setup_of(unstable(), 2.0)
    result = simulate(setup)
    assert "diverged at t = " in result.stopped and ": p left its limit of 300 rad/s" in result.stopped
    assert 5 < len(result.table) < 500 and np.isfinite(result.table[["p", "x", "Mx"]].to_numpy()).all()
    assert_same(result, simulate(setup, between={"begin": lambda bus: None}))
    summary = result.summary()
    assert summary["ended"] == result.stopped and result.stopped in report(summary)
    many = simulate_many(setup, 3)
    assert (many.status == 8).all() and "p left its limit" in many.stopped(setup, 0)


def test_a_time_step_that_the_integrator_cannot_take_is_refused(model):
    with pytest.raises(ConfigError, match="a step of 0.1 s is unstable.*time constant 0.03.*use a 'time step' of at"):
        setup_of(model, step=0.1, simulation={"integrator": "euler"})
    # 2 tau is the bound of Euler for a lag
    with pytest.raises(ConfigError):
        setup_of(model, step=0.0602, simulation={"integrator": "euler"})
    fine = setup_of(model, step=0.0598, simulation={"integrator": "euler"})
    assert any("badly" in note for note in fine.notes)
    assert not setup_of(model, step=0.1, simulation={"substeps": 20}).notes


def test_nan_from_a_users_step_names_the_step_and_the_time(model):
    def broken(bus):
        commands = bus.controller(bus)
        if bus.step == 7:
            commands[2] = np.nan
        return commands

    with pytest.raises(DataError, match=r"step 'controller' \(.*broken\) at t = 0.028 s returned nan as entry 2"):
        simulate(setup_of(model), {"controller": broken})
    with pytest.raises(DataError, match=r"'forces_and_moments'.*expected forces \(3,\) and moments \(3,\)"):
        simulate(setup_of(model), {"forces_and_moments": lambda bus: 1.0})
    with pytest.raises(ConfigError, match="no step is called 'control'.*controller"):
        simulate(setup_of(model), {"control": broken})


def test_infinite_mode_runs_until_its_condition_and_needs_one(model):
    setup = setup_of(model, references={"kind": "velocity steps", "steps": [[0, 2, 0, 0]]})
    simulator = QuadrotorSimulator(setup, run_mode="infinite")
    with pytest.raises(ConfigError, match="needs a condition to end"):
        simulator.run()
    simulator.set_termination(lambda bus: bus.state[bus.step, 10] < 10.0)
    table = simulator.fly().table
    assert len(table) > 1100 and table["x"].iloc[-2] < 10.0 <= table["x"].iloc[-1] + 0.05
    np.testing.assert_array_equal(table["t"], np.arange(len(table)) * setup.dt)


def test_signals_of_the_users_own_are_recorded(model):
    setup = setup_of(model, 0.2)
    simulator = QuadrotorSimulator(setup)
    simulator.add_signal("height", 0.0, record=True)
    simulator.add_step("begin", lambda bus: bus.signals.update(height=-bus.state[bus.step, 12]))
    table = simulator.fly().table
    np.testing.assert_allclose(table["height"][:-1], -table["z"][:-1])
    with pytest.raises(ConfigError, match="no signal 'heigth'.*height"):
        _ = simulator.bus["heigth"]


def test_a_changed_reference_is_followed_by_the_built_in_controller(model):
    """The manual's keyboard example: a hook before the controller shifts the position wanted."""

    def shift(bus):
        bus.reference[bus.step, 1] += 1.0

    table = simulate(setup_of(model, 4.0), between={"begin": shift}).table
    assert table["x"].iloc[-1] == pytest.approx(1.0, abs=0.05) and table["x_ref"].iloc[-1] == 1.0


def test_steady_wind_is_flown_against_and_a_table_adds_to_it(model):
    still_air = simulate(setup_of(model, 3.0, noise={"add": False})).table.iloc[-1]
    wind = {"steady": [3, 0, 0]}
    blown = simulate(setup_of(model, 3.0, noise={"add": False}, wind=wind)).table.iloc[-1]
    # the air pushes from behind with 0.12 N s/m: nose up until the thrust balances it
    assert still_air["pitch"] == pytest.approx(0.0, abs=1e-6) and blown["u_air"] < -2.5
    assert blown["pitch"] == pytest.approx(0.12 * 3.0 / (0.43 * 9.81), rel=0.05)
    table = {"t": [0.0, 1.0], "wind_north": [1.0, 3.0], "wind_east": [0.0, 0.0], "wind_down": [0.0, 0.0]}
    asked = {"model": {"model ID": "made"}, "simulation": {"duration": 2}, "wind": {"steady": [0, 1, 0]}}
    found = simulate(make_setup(asked, model, wind=table)).table
    np.testing.assert_allclose(found["wind_north"], np.interp(found["t"], [0, 1], [1, 3]))
    np.testing.assert_allclose(found["wind_east"], 1.0)
    with pytest.raises(DataError, match="lacks the column 'wind_east'"):
        make_setup(asked, model, wind={"t": [0.0], "wind_north": [1.0]})


def test_a_falling_voltage_slows_the_rotors_by_its_power(model):
    battery = {"voltage": 16.0, "drain": 1.0, "exponent": 0.8, "reference voltage": 16.0}
    quick = {"actuator": "rotorDynamicsSaturation"}
    table = simulate(setup_of(model, 2.0, battery=battery, actuator=quick, noise={"add": False})).table
    np.testing.assert_allclose(table["battery_voltage"], 16.0 - table["t"], atol=1e-9)
    np.testing.assert_allclose(table["w2"], table["w2_CMD"] * ((16.0 - table["t"]) / 16.0) ** 0.8, rtol=1e-9)


def test_terms_in_the_battery_voltage_follow_it_and_hover_is_that_of_the_voltage_at_the_start(model):
    part = model.document["axes"]["Fz"]
    term = {"name": "b", "expression": "battery_voltage", "coefficient": -0.05, "std": 0.0, "unit": "", "given": True}
    axes = {**model.document["axes"], "Fz": {**part, "terms": [*part["terms"], term]}}
    volts = Model({**model.document, "axes": axes})
    asked = {"model": {"model ID": "made"}, "noise": {"add": False}, "simulation": {"duration": 1}}
    with pytest.raises(ConfigError, match="has terms in the battery voltage; give 'battery' / 'voltage'"):
        make_setup(asked, volts)
    table = simulate(make_setup({**asked, "battery": {"voltage": 16.0}}, volts)).table
    # 0.8 N of lift come with the voltage, the rest from the rotors: u = (m g - 0.8) / (m g) u_hover
    weight = 0.43 * 9.81
    assert table["w1"].iloc[0] == pytest.approx(1500.0 * math.sqrt((weight - 0.8) / weight), rel=1e-9)
    # the controller learns of the lift that is not the rotors', and comes back to the same speeds
    np.testing.assert_allclose(table[["w1", "w2", "w3", "w4"]].iloc[-1], table["w1"].iloc[0], rtol=1e-3)
    assert table["z"].abs().max() < 0.02
    drained = simulate(make_setup({**asked, "battery": {"voltage": 16.0, "drain": 2.0}}, volts)).table
    np.testing.assert_allclose(drained["battery_voltage"], 16.0 - 2.0 * drained["t"], atol=1e-9)
    assert drained["w1"].iloc[-1] > table["w1"].iloc[-1] + 5.0


def test_the_simple_model_flies_and_an_extension_adds_its_terms(model):
    document = {**model.document, "simple model": {
        "kappaFz": {"value": 4.7e-7}, "kappaMx": {"value": 2.5e-8}, "kappaMy": {"value": 2.5e-8},
        "kappaMz": {"value": -5e-9}}}  # fmt: skip
    asked = {"model": {"model ID": "made", "use identified model": False}, "simulation": {"duration": 1}}
    simple = simulate(make_setup(asked, Model(document)))
    last = simple.table.iloc[-1]
    assert last["Fz"] == pytest.approx(-4.7e-7 * sum(last[f"w{i}"] ** 2 for i in range(1, 5)))
    assert simple.stopped is None
    with pytest.raises(DataError, match="carries no 'kappaFz'"):
        make_setup(asked, model)
    extension = {"id": "body_drag", "terms": {"Fx": [{"expression": "|u|*u", "coefficient": -0.5}]}}
    heavier = make_setup({"model": {"model ID": "made"}}, Model({**model.document, "extensions": [extension]}))
    state = np.array([0, 0, 0, 3.0, 0, 0, 0, 0, 0, 0, 0, 0])
    speeds = np.full(4, 1500.0)
    difference = heavier.model.predict(state, speeds)[0][0] - model.predict(state, speeds)[0][0]
    assert difference == pytest.approx(-0.5 * 9.0)
    # terms that stand among the axis's own are not added again
    again = make_setup({"model": {"model ID": "made"}}, Model({**heavier.model.document, "axes": {
        a: {**p, "terms": [{**t, "extension": "body_drag"} for t in p["terms"]]}
        for a, p in heavier.model.document["axes"].items()}}))  # fmt: skip
    np.testing.assert_array_equal(again.model.predict(state, speeds), heavier.model.predict(state, speeds))


def test_extensions_change_rotors_and_wind_and_unknown_states_are_refused_by_name(model):
    extensions = [
        {"id": "motor_lag", "actuators": {"time constant": 0.05}},
        {"id": "command_delay", "actuators": {"delay": 0.012}},
        {"id": "wind", "environment": {"wind": [1.0, 0.0, -0.5]}},
    ]
    other = Model({**model.document, "extensions": extensions})
    setup = make_setup({"model": {"model ID": "made"}, "wind": {"steady": [0, 2, 0]}}, other)
    machine = setup.machine
    np.testing.assert_array_equal(machine.body[26:34], 0.05)
    assert machine.drive.delay == 0.012
    np.testing.assert_array_equal(machine.wind[:3], [1.0, 2.0, -0.5])
    own = make_setup({"model": {"model ID": "made"}, "actuator": {"delay": 0.0, "time constants": 0.02}}, other).machine
    assert own.drive.delay == 0.0 and (own.body[26:34] == 0.02).all()
    for states in ({"swinging lode": {"mass": 0.05, "length": 0.5}}, ["swinging lode"]):
        load = {"id": "payload_swing", "states": states}
        told = r"'payload_swing' has states of its own \(swinging lode\).*mean 'swinging"
        with pytest.raises(ConfigError, match=told):
            make_setup({"model": {"model ID": "made"}}, Model({**model.document, "extensions": [load]}))


@pytest.mark.parametrize(
    "settings, sentence",
    [
        ({"controler": {}}, "unknown key 'controler'.*did you mean 'controller'"),
        ({"controller": {"controller": "drone_LQR"}}, "drone_LQR"),
        ({"actuator": {"actuator": "rotorDynamicsV3"}}, "expected one of"),
        ({"actuator": {"lowest speed": 3000}}, "not below the highest|leave no room|hover takes"),
        ({"simulation": {"duration": 0.001}}, "shorter than the 'time step'"),
        ({"references": {"kind": "figure eigth"}}, "figure eight"),
        ({"references": {"do circle track": True, "kind": "hover"}}, "only one of"),
        ({"wind": {"file": "wind.csv"}}, "was not read"),
        ({"battery": {"exponent": 1.0}}, "no 'voltage'"),
        ({"controller": {"controller": "INDI", "gains": {"rates": {}}}}, "my_sim: .*lacks the block 'position'"),
        ({"references": {"kind": "position steps", "steps": [[1, 0, 0]]}}, "my_sim: reference steps of .*row 1"),
        ({"simulation": {"time step": math.nan}}, "my_sim: 'simulation' / 'time step' is nan, expected a finite"),
        ({"simulation": {"duration": math.inf}}, "my_sim: 'simulation' / 'duration' is inf, expected a finite"),
        ({"controller": {"gains": {"rates": {"time constant": math.nan}}}}, "'rates' / 'time constant' is nan"),
        ({"simulation": {"time step": 1e-9, "duration": 1e6}}, "more rows than memory holds"),
        ({"initial state conditions": {"rotor speeds": [1e200] * 4}}, "are no numbers in the initial state"),
    ],
)
def test_faults_of_a_configuration_are_sentences(model, settings, sentence):
    with pytest.raises((ConfigError, DataError), match=sentence):
        make_setup({"model": {"model ID": "made"}, **settings}, model, name="my_sim")


WIND = {"t": [0.0, 1.0], "wind_north": [0.0, 1.0], "wind_east": [0.0, 0.0], "wind_down": [0.0, 0.0]}


@pytest.mark.parametrize(
    "change, sentence",
    [
        ({"wind_nort": WIND["wind_north"], "wind_north": None}, "gust.csv lacks the column 'wind_north' .*'wind_nort'"),
        ({"wind_east": [0.0, math.nan]}, "gust.csv holds no number in column 'wind_east', data row 2"),
        ({"t": [1.0, 1.0]}, "gust.csv goes back in time, or stands still, in data row 2"),
        (dict.fromkeys(WIND, ()), "gust.csv has no rows"),
    ],
)
def test_faults_of_a_wind_table_name_the_simulation_and_the_file(model, change, sentence):
    table = {k: v for k, v in {**WIND, **change}.items() if v is not None}
    with pytest.raises(DataError, match="my_sim: the wind's table data/" + sentence):
        make_setup({"model": {"model ID": "made"}, "wind": {"file": "data/gust.csv"}}, model, table, name="my_sim")


@pytest.mark.parametrize(
    "faults, note",
    [
        ({"rotor effectiveness after failure": [0.5, 1, 1, 1]}, "'inject failure' is false: nothing fails"),
        ({"inject failure": True}, "every rotor keeps its health"),
        ({"inject failure": True, "time of failure": 9, "rotor health after failure": [0.1, 1, 1, 1]}, "after the end"),
    ],
)
def test_a_fault_that_cannot_be_seen_is_told(model, faults, note):
    assert note in setup_of(model, faults=faults).notes[-1]


@pytest.mark.parametrize(
    "actuators",
    ["fast", {"time constants": 0.02}, {"time constants up": {"value": "fast"}}, {"delay": {"value": [1, 2]}},
     {"time constants": {"value": [0.02, 0.02, -0.02, 0.02]}}],
)  # fmt: skip
def test_damaged_actuators_of_a_model_are_a_sentence(model, actuators):
    with pytest.raises(DataError, match="'actuators'.*make the model anew"):
        setup_of(Model({**model.document, "actuators": actuators}))


def test_a_summary_is_plain_data_with_tracking_saturation_and_region(model):
    result = simulate(setup_of(model, 3.0, references={"kind": "figure eight", "start": 0.5}))
    summary = result.summary()
    error = np.linalg.norm(
        result.table[["x", "y", "z"]].to_numpy() - result.table[["x_ref", "y_ref", "z_ref"]].to_numpy(), axis=1
    )
    assert summary["tracking"]["position"]["rms"] == pytest.approx(math.sqrt(np.mean(error**2)))
    assert summary["tracking"]["position"]["greatest"] == pytest.approx(error.max())
    assert summary["outside the model's region"] is None and any("no region" in n for n in summary["notes"])
    assert set(summary["saturation"]) == {f"rotor {i}" for i in range(1, 5)}
    assert "position error" in report(summary)


def test_a_rotor_that_failed_counts_as_saturated_beyond_its_cap(model):
    faults = {"inject failure": True, "time of failure": 0.5, "rotor health after failure": [1, 1, 0.3, 1]}
    result = simulate(setup_of(model, 1.0, controller={"controller": "NDI"}, faults=faults))
    high = result.setup.machine.drive.high
    command, t = result.table["w3_CMD"].to_numpy(), result.table["t"].to_numpy()
    beyond = np.mean(command >= np.where(t >= 0.5, 0.3 * high, high) * (1 - 1e-6))
    summary = result.summary()
    assert beyond > 0.3 and np.all(command < high)
    assert summary["saturation"]["rotor 3"]["share of time at highest"] == pytest.approx(beyond)
    assert f"rotor 3's command at or beyond its limit {100 * beyond:.1f} % of the time" in report(summary)
