"""Total loss of power, starts with stopped rotors, and what is reported of a simulation that diverges."""

import re

import numpy as np
import pytest
from plain_plant import G, made_model

from quasi.errors import ConfigError
from quasi.model.envelope import measure_coverage
from quasi.model.model import Model
from quasi.simulation.loop.run import Session, simulate, simulate_many
from quasi.simulation.loop.setup import make_setup

CONTROLLERS = ("drone_INDI", "drone_NDI", "drone_PID")
LOSS = {"inject failure": True, "time of failure": 1.0}


def setup_of(model, duration=4.0, **more):
    return make_setup({"model": {"model ID": "made"}, "simulation": {"duration": duration}, **more}, model)


def with_term(axis, expression, coefficient):
    document = dict(made_model().document)
    part = document["axes"][axis]
    term = {"name": expression, "expression": expression, "coefficient": coefficient, "std": 0.0, "unit": ""}
    n = len(part["terms"]) + 1
    part = {**part, "terms": [*part["terms"], term], "covariance": np.zeros((n, n)).tolist()}
    document["axes"] = {**document["axes"], axis: part}
    return Model(document)


@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("key", ["rotor health after failure", "rotor effectiveness after failure"])
def test_total_loss_of_power_is_a_fall_against_the_drag(controller, key):
    result = simulate(setup_of(made_model(), controller={"controller": controller}, noise={"add": False},
                               faults={**LOSS, key: [0, 0, 0, 0]}))  # fmt: skip
    table = result.table
    assert result.stopped is None and result.steps == 1000
    after = table[table["t"] > 1.0]
    if key.startswith("rotor health"):
        assert (after[[f"w{i}" for i in range(1, 5)]] == 0.0).all(axis=None)
    # m dw/dt = m g - 0.15 w from rest, level
    final, t = 0.43 * G / 0.15, after["t"].to_numpy() - 1.0
    speed = final * (1.0 - np.exp(-t * G / final))
    assert np.allclose(after["w"], speed, atol=0.05)
    assert np.allclose(after["z"] - after["z"].iloc[0], final * (t - speed / G), atol=0.15)


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_start_with_stopped_rotors_falls_and_then_hovers(controller):
    result = simulate(setup_of(made_model(), controller={"controller": controller}, noise={"add": False},
                               **{"initial state conditions": {"rotor speeds": [0, 0, 0, 0]}}))  # fmt: skip
    table = result.table
    assert result.stopped is None
    assert (table.loc[0, ["w1", "w2", "w3", "w4"]] == 0.0).all() and table["Fz"].iloc[0] == pytest.approx(0.0, abs=1e-9)
    assert table["w"].iloc[1] == pytest.approx(G * 0.004, rel=0.05)
    assert 0.01 < table["z"].max() < 0.5 and abs(table["z"].iloc[-1]) < 0.05
    assert table[["w1", "w2", "w3", "w4"]].iloc[-1].to_numpy() == pytest.approx(1500.0, rel=0.02)


def test_forces_that_a_fault_makes_undefined_are_named_with_axis_term_and_rotor_speeds():
    model = with_term("Fy", "v/(w1^2)^0.5", 0.5)
    for every in (1, 50):
        setup = setup_of(model, simulation={"duration": 4, "log every": every},
                         faults={**LOSS, "rotor health after failure": [0, 1, 1, 1]})  # fmt: skip
        result = simulate(setup)
        assert result.status != 0
        for fact in ("diverged at t = 1.0", "Fy is not a finite number", "v/(w1^2)^0.5", "at rotor speeds of 0, "):
            assert fact in result.stopped
        if every == 1:
            assert simulate(setup, between={"begin": lambda bus: None}).stopped == result.stopped
    assert "diverged" in simulate_many(setup, 2).stopped(setup, 1)


def test_a_start_in_which_the_model_is_undefined_is_refused_with_axis_and_term():
    with pytest.raises(
        ConfigError, match=r"Fy is not a finite number \(term v/\(w1\^2\)\^0.5\) at rotor speeds of 0, 0, 0, 0"
    ):
        setup_of(with_term("Fy", "v/(w1^2)^0.5", 0.5), **{"initial state conditions": {"rotor speeds": [0, 0, 0, 0]}})


def test_divergence_after_a_fault_names_the_fault_and_its_time():
    setup = setup_of(with_term("Mx", "p", 0.002), duration=20.0, controller={"controller": "drone_NDI"},
                     faults={**LOSS, "rotor effectiveness after failure": [0, 0, 1, 1]})  # fmt: skip
    result = simulate(setup)
    assert result.stopped.startswith("diverged at t = ") and "rotors failed at 1 s" in result.stopped
    assert "left its limit of 300 rad/s" in result.stopped


def test_divergence_outside_the_training_data_names_the_variable_and_the_time():
    grown = with_term("Fx", "u^3", 0.02)
    slow = {"kind": "figure eight", "amplitude": 1.0, "start": 0.0}
    table = simulate(setup_of(grown, 8.0, references=slow)).table
    rows = {"a": np.ones(len(table), bool)}
    axes = grown.document["axes"]
    region = measure_coverage({"a": table}, rows, grown.airframe, 1500.0, axes)
    known = Model({**grown.document, **region})
    fast = {"kind": "velocity steps", "steps": [[0, 0, 0, 0], [1, 8, 0, 0]]}
    sentences = [simulate(setup_of(m, 8.0, references=fast)).stopped for m in (grown, known)]
    assert all("forward velocity u left its limit of 300 m/s" in s for s in sentences)
    assert "left the region" not in sentences[0]
    left = re.search(r"left the region of the model's data at (\S+) s by (\w+)", sentences[1])
    assert 0.9 < float(left[1]) < 2.0, sentences[1]


def test_live_flight_reports_the_quantity_too():
    session = Session(
        setup_of(with_term("Fx", "u^3", 0.02), **{"initial state conditions": {"velocity": [12.0, 0, 0]}})
    )
    goal = np.zeros(20)
    sentence = session.advance(goal, 2000)
    assert sentence.startswith("diverged at t = ") and "forward velocity u" in sentence
