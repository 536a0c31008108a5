"""Roll-outs of models: against the plain ones of any body, the simulator itself, and closed forms."""

import numpy as np
import pytest
from plain_plant import made_model
from plain_rollout import make_body, rollout_body, trim_before

from quasi.attitude import to_euler
from quasi.errors import DataError, ShapeError
from quasi.model.model import Model
from quasi.simulation.loop.run import simulate
from quasi.simulation.loop.setup import make_setup
from quasi.simulation.tools.replay import ActuatorDynamics, read_actuator_dynamics, replay, to_euler_states
from quasi.simulation.tools.rollout import rollout


@pytest.fixture(scope="module")
def model():
    return made_model(asymmetric=True)


def flight(n=400, dt=0.002, seed=0):
    rng = np.random.default_rng(seed)
    t = dt * np.arange(n)
    speeds = 1500 + 80 * np.column_stack([np.sin((3 + k) * t + k) for k in range(4)])
    return t, 0.3 * rng.standard_normal((n, 12)), speeds


@pytest.mark.parametrize("gravity", ["withGravity", "noGravity"])
@pytest.mark.parametrize("substeps", [1, 3])
def test_compiled_windows_equal_the_plain_ones_to_1e_9(gravity, substeps):
    model = made_model(asymmetric=True, gravity=gravity)
    t, states, speeds = flight()
    starts = np.array([0, 17, 111, 250])
    plain = rollout_body(make_body(model), t, states, speeds, starts, 0.25, substeps)
    compiled = rollout(model, t, states, speeds, starts, 0.25, substeps)
    assert compiled.shape == (4, 126, 12)
    np.testing.assert_allclose(compiled, plain, rtol=1e-9, atol=1e-9)


def test_a_simulated_flight_is_replayed_from_its_own_commands_and_wind(model):
    wind = {"t": [0.0, 3.0], "wind_north": [1.0, 2.0], "wind_east": [0.0, 1.0], "wind_down": [0.2, 0.0]}
    settings = {
        "model": {"model ID": "made", "correct for moment asymmetries": False},
        "noise": {"add": False}, "simulation": {"duration": 2.0}, "actuator": {"delay": 0.010},
        "references": {"kind": "figure eight", "start": 0.0},
    }  # fmt: skip
    table = simulate(make_setup(settings, model, wind=wind)).table
    names = ["roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z"]
    commands, air = (table[c].to_numpy() for c in (["w1_CMD", "w2_CMD", "w3_CMD", "w4_CMD"],
                                                   ["wind_north", "wind_east", "wind_down"]))  # fmt: skip
    speeds = table[["w1", "w2", "w3", "w4"]].to_numpy()
    rotors = read_actuator_dynamics(model)._replace(delay=0.010)
    starts = np.array([10, 200])
    # the simulator holds the wind over a step: so does this table of means
    held = np.repeat(air[:1], len(air), axis=0)
    for k in range(len(air) - 1):
        held[k + 1] = 2 * air[k] - held[k]
    found = replay(model, table["t"], table[names], speeds, starts, 1.0, commands, rotors, held)
    truth = table[names].to_numpy()
    for s, start in enumerate(starts):
        np.testing.assert_allclose(to_euler_states(found[s])[250], truth[start + 250], atol=2e-5)
        np.testing.assert_allclose(found[s, 250, 13:], speeds[start + 250], rtol=1e-9)
    still_air = replay(model, table["t"], table[names], speeds, starts, 1.0, commands, rotors)
    assert np.abs(to_euler_states(still_air)[0, 250] - truth[260]).max() > 0.05


def test_a_planted_constant_moment_is_the_trim_and_nothing_after_the_start_enters_it(model):
    t, states, speeds = flight(600)
    planted = np.array([0.0, 0.02, -0.05, 2e-4, -3e-4, 1e-5])
    states = rollout(model, t, states, speeds, [0], t[-1], offsets=planted[None])[0]
    missing = planted + np.random.default_rng(1).normal(0.0, 1e-7, (600, 6))
    missing[250:260] = np.nan
    starts, margin = np.array([20, 300, 400]), 30
    trim = trim_before(missing, starts, 200, margin)
    np.testing.assert_array_equal(trim[0], 0.0)  # nothing comes before it
    np.testing.assert_allclose(trim[1:], [planted, planted], atol=1e-7)
    later = missing.copy()
    later[400 - margin :] += 1.0
    np.testing.assert_array_equal(trim_before(later, starts, 200, margin), trim)
    plain, trimmed = (rollout(model, t, states, speeds, starts[1:], 0.3, offsets=o) for o in (None, trim[1:]))
    truth = np.stack([states[s : s + plain.shape[1]] for s in starts[1:]])
    assert np.abs(trimmed - truth).max() < 1e-3 < 0.02 < np.abs(plain - truth).max()


def test_commands_act_through_lag_delay_and_saturation(model):
    t, states, speeds = flight(200)
    commands = np.where(t[:, None] < 0.1, 1500.0, 1900.0) * np.ones((1, 4))
    rotors = ActuatorDynamics(0.03, 0.05, delay=0.011, highest=1800.0)
    found = replay(model, t, states, np.full((200, 4), 1500.0), [0], 0.398, commands, rotors)[0, :, 13]
    # 11 ms are five and a half samples: for one sample the mean of both commands acts
    expected = np.full(200, 1500.0)
    for k in range(199):
        wanted = 1800.0 if k > 55 else (min(1700.0, 1800.0) if k == 55 else 1500.0)
        expected[k + 1] = wanted + (expected[k] - wanted) * np.exp(-0.002 / 0.03)
    np.testing.assert_allclose(found, expected[: len(found)], rtol=1e-7)


def test_offsets_are_added_in_each_window_alone(model):
    t, states, speeds = flight()
    starts, offsets = np.array([3, 3, 50]), np.zeros((3, 6))
    offsets[1, 2] = 0.43  # N downwards: 1 m/s2 more along the body's z
    found = replay(model, t, states, speeds, starts, 0.01, offsets=offsets)
    np.testing.assert_array_equal(found[0], replay(model, t, states, speeds, [3], 0.01)[0])
    np.testing.assert_allclose((found[1] - found[0])[-1, 6], 0.01, rtol=0.02)


def test_threads_change_nothing(model):
    t, states, speeds = flight()
    starts = np.arange(0, 300, 7)
    one = replay(model, t, states, speeds, starts, 0.1, threads=1)
    np.testing.assert_array_equal(one, replay(model, t, states, speeds, starts, 0.1, threads=3))


def test_the_first_row_is_the_measured_state(model):
    t, states, speeds = flight()
    found = replay(model, t, states, speeds, [5, 9], 0.02)
    np.testing.assert_allclose(to_euler(found[:, 0, :4]), states[[5, 9], :3], atol=1e-12)
    np.testing.assert_array_equal(found[:, 0, 4:13], states[[5, 9], 3:])
    assert replay(model, t, states, speeds, np.zeros(0, int), 0.02).shape == (0, 11, 17)


def test_wrong_input_is_refused(model):
    t, states, speeds = flight()
    with pytest.raises(DataError, match="leaves the 400 rows"):
        replay(model, t, states, speeds, [399], 0.1)
    with pytest.raises(ShapeError, match=r"commands must be \(400, 4\)"):
        replay(model, t, states, speeds, [0], 0.1, commands=speeds[:10])
    with pytest.raises(ShapeError, match="states must be"):
        replay(model, t, states[:, :9], speeds, [0], 0.1)
    with pytest.raises(DataError, match="evenly spaced"):
        replay(model, t**1.5, states, speeds, [0], 0.1)
    document = {**model.document, "axes": {k: v for k, v in model.document["axes"].items() if k != "Mz"}}
    with pytest.raises(DataError, match="lacks Mz"):
        replay(Model(document), t, states, speeds, [0], 0.1)
    part = model.document["axes"]["Fz"]
    term = {"name": "b", "expression": "battery_voltage", "coefficient": 0.1, "std": 0.0, "unit": "", "given": True}
    axes = {**model.document["axes"], "Fz": {**part, "terms": [*part["terms"], term]}}
    volts = Model({**model.document, "axes": axes})
    with pytest.raises(DataError, match="needs 'battery_voltage' for a roll-out"):
        replay(volts, t, states, speeds, [0], 0.1)
    with_volts = replay(volts, t, states, speeds, [0], 0.01, extra={"battery_voltage": np.full(400, 10.0)})
    assert with_volts[0, -1, 6] - replay(model, t, states, speeds, [0], 0.01)[0, -1, 6] == pytest.approx(
        0.01 / 0.43, rel=0.02
    )
