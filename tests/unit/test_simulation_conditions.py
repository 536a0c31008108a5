"""What a simulation flies in: hover, noise, delays, faults, wind, battery, extensions of the model."""

import math

import numpy as np
import pandas as pd
import pytest
from plain_plant import made_model
from simulations import setup_of

from quasi.errors import ConfigError, DataError
from quasi.model.model import Model
from quasi.simulation.loop.run import simulate
from quasi.simulation.loop.setup import make_setup


@pytest.fixture(scope="module")
def model():
    return made_model(asymmetric=True)


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
    net = Model({**made_model(asymmetric=True, gravity="noGravity").document, "simple model": document["simple model"]})
    weighed = simulate(make_setup(asked, net)).table
    np.testing.assert_allclose(weighed["z"], simple.table["z"], atol=1e-9)
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
    loop = setup.loop_parameters
    np.testing.assert_allclose(loop.body[26:34], 0.05, rtol=1e-14)
    assert loop.drive.delay == 0.012
    np.testing.assert_array_equal(loop.wind[:3], [1.0, 2.0, -0.5])
    own = make_setup(
        {"model": {"model ID": "made"}, "actuator": {"delay": 0.0, "time constants": 0.02}}, other
    ).loop_parameters
    assert own.drive.delay == 0.0 and (own.body[26:34] == 0.02).all()
    for states in ({"swinging lode": {"mass": 0.05, "length": 0.5}}, ["swinging lode"]):
        load = {"id": "payload_swing", "states": states}
        told = r"'payload_swing' has states of its own \(swinging lode\).*mean 'swinging"
        with pytest.raises(ConfigError, match=told):
            make_setup({"model": {"model ID": "made"}}, Model({**model.document, "extensions": [load]}))
