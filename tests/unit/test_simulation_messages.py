"""What a simulation tells: faults of its configuration and tables in sentences, and its summary."""

import math

import numpy as np
import pytest
from plain_plant import made_model
from simulations import setup_of

from quasi.errors import ConfigError, DataError
from quasi.model.model import Model
from quasi.simulation.control.references import evaluate_reference
from quasi.simulation.loop.result import format_report
from quasi.simulation.loop.run import simulate
from quasi.simulation.loop.setup import make_setup


@pytest.fixture(scope="module")
def model():
    return made_model(asymmetric=True)


def test_a_time_step_that_the_integrator_cannot_take_is_refused(model):
    with pytest.raises(ConfigError, match="a step of 0.1 s is unstable.*time constant 0.03.*use a 'time step' of at"):
        setup_of(model, step=0.1, simulation={"integrator": "euler"})
    # 2 tau is the bound of Euler for a lag
    with pytest.raises(ConfigError):
        setup_of(model, step=0.0602, simulation={"integrator": "euler"})
    fine = setup_of(model, step=0.0598, simulation={"integrator": "euler"})
    assert any("badly" in note for note in fine.notes)
    assert not setup_of(model, step=0.1, simulation={"substeps": 20}).notes


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
        ({"wind": {"file": "wind.csv"}}, "'wind' / 'file' is 'wind.csv', but .*does not exist"),
        ({"references": {"kind": "table", "file": "r.csv"}}, "'references' / 'file' is 'r.csv', but .*does not exist"),
        ({"battery": {"exponent": 1.0}}, "no 'voltage'"),
        ({"controller": {"controller": "INDI", "gains": {"rates": {}}}}, "my_sim: .*lacks the key 'position'"),
        ({"references": {"kind": "position steps", "steps": [[1, 0, 0]]}}, "my_sim: reference steps of .*row 1"),
        ({"simulation": {"time step": math.nan}}, "my_sim: 'simulation' / 'time step' is nan, expected a finite"),
        ({"simulation": {"duration": math.inf}}, "my_sim: 'simulation' / 'duration' is inf, expected a finite"),
        ({"controller": {"limits": {"tilt": math.nan}}}, "'limits' / 'tilt' is nan"),
        ({"simulation": {"time step": 1e-9, "duration": 1e6}}, "exceed the 5,000,000 rows"),
        (
            {"initial state conditions": {"rotor speeds": [1e200] * 4}},
            "in the initial state the model's Fz is not a finite number",
        ),
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
        ({"wind_east": [0.0, math.nan]}, "gust.csv has no number in column 'wind_east', data row 2"),
        ({"t": [1.0, 1.0]}, "gust.csv does not increase in time in data row 2"),
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
        ({"rotor effectiveness after failure": [0.5, 1, 1, 1]}, "'inject failure' is false"),
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
    with pytest.raises(DataError, match="'actuators'.*expected (positive |)(seconds|a section)"):
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
    assert "position error" in format_report(summary)


def test_a_rotor_that_failed_counts_as_saturated_beyond_its_cap(model):
    faults = {"inject failure": True, "time of failure": 0.5, "rotor health after failure": [1, 1, 0.3, 1]}
    result = simulate(setup_of(model, 1.0, controller={"controller": "NDI"}, faults=faults))
    high = result.setup.loop_parameters.drive.high
    command, t = result.table["w3_CMD"].to_numpy(), result.table["t"].to_numpy()
    beyond = np.mean(command >= np.where(t >= 0.5, 0.3 * high, high) * (1 - 1e-6))
    summary = result.summary()
    assert beyond > 0.3 and np.all(command < high)
    assert summary["saturation"]["rotor 3"]["share of time at highest"] == pytest.approx(beyond)
    assert f"rotor 3's command at or beyond its limit {100 * beyond:.1f} % of the time" in format_report(summary)


def test_tables_that_the_settings_name_are_read_from_the_folder(model, tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data/gust.csv").write_text("t,wind_north,wind_east,wind_down\n0,1.5,0,0\n10,1.5,0,0\n")
    (tmp_path / "path.csv").write_text("t,x,y,z\n0,0,0,-1\n2,1,2,-3\n")
    settings = {"model": {"model ID": "made"}, "wind": {"file": "data/gust.csv"},
                "references": {"kind": "table", "file": "path.csv"}, "simulation": {"duration": 0.1}}  # fmt: skip
    table = simulate(make_setup(settings, model, directory=tmp_path)).table
    assert np.allclose(table["wind_north"], 1.5)
    goal = np.zeros(20)
    loop = make_setup(settings, model, directory=tmp_path).loop_parameters
    evaluate_reference(loop.reference, loop.path, loop.table, 2.0, goal)
    assert goal[1:4].tolist() == [1.0, 2.0, -3.0]


def test_faults_without_the_switch_get_a_notice_that_names_it():
    from quasi.project.configuration import check

    def notices(faults):
        return check({"model": {"model ID": "made"}, "faults": faults}, "simulation", "config/simulations/s.json")[1]

    assert any("'inject failure'" in n and "'time of failure'" in n for n in notices({"time of failure": 2}))
    for quiet in ({}, {"inject failure": False, "time of failure": 2}, {"inject failure": True}):
        assert not notices(quiet)


def test_show_names_the_command_that_shows_this_flight():
    from quasi.project.configuration import check

    document = {"model": {"model ID": "made"}, "animation": {"show": True}}
    assert any("`quasi fly windy`" in n for n in check(document, "simulation", "config/simulations/windy.json")[1])


def test_the_text_of_a_summary_states_the_main_settings(model):
    text = format_report(
        simulate(setup_of(model, 0.1, controller={"controller": "drone_NDI"}, noise={"add": False})).summary()
    )
    assert "controller drone_NDI, actuator rotorDynamicsV2, no noise, moment asymmetries corrected, rk4" in text
