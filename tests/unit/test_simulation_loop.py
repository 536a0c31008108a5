"""The closed loop: compiled and Python ways alike, a user's own steps, batches, sessions, where it stops."""

import numpy as np
import pytest
from plain_plant import made_model
from simulations import ROUGH, assert_same, setup_of

from quasi.errors import ConfigError, DataError, ShapeError
from quasi.model.model import Model
from quasi.simulation.loop.python_loop import QuadrotorSimulator
from quasi.simulation.loop.result import format_report
from quasi.simulation.loop.run import Session, simulate, simulate_many


@pytest.fixture(scope="module")
def model():
    return made_model(asymmetric=True)


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
    assert (
        "diverged at t = " in result.stopped and "roll rate p left its limit of 300 rad/s and became" in result.stopped
    )
    assert "use a shorter 'time step' or gentler 'gains'" in result.stopped
    assert 5 < len(result.table) < 500 and np.isfinite(result.table[["p", "x", "Mx"]].to_numpy()).all()
    assert_same(result, simulate(setup, between={"begin": lambda bus: None}))
    summary = result.summary()
    assert summary["ended"] == result.stopped and result.stopped in format_report(summary)
    many = simulate_many(setup, 3)
    assert (many.status == 8).all() and "p left its limit" in many.stopped(setup, 0)


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
    simulator.add_signal("place", np.zeros(3), record=True)
    simulator.add_step("begin", lambda bus: bus.signals.update(height=-bus.state[bus.step, 12]))
    simulator.add_step("begin", lambda bus: bus.signals.update(place=bus.state[bus.step, 10:13]))
    table = simulator.fly().table
    np.testing.assert_allclose(table[["place_1", "place_2", "place_3"]][:-1], table[["x", "y", "z"]][:-1])
    np.testing.assert_allclose(table["height"][:-1], -table["z"][:-1])
    with pytest.raises(ConfigError, match="no signal 'heigth'.*height"):
        _ = simulator.bus["heigth"]


def test_a_changed_reference_is_followed_by_the_built_in_controller(model):
    """The manual's keyboard example: a hook before the controller shifts the position wanted."""

    def shift(bus):
        bus.reference[bus.step, 1] += 1.0

    table = simulate(setup_of(model, 4.0), between={"begin": shift}).table
    assert table["x"].iloc[-1] == pytest.approx(1.0, abs=0.05) and table["x_ref"].iloc[-1] == 1.0
