"""Every cause that can extend a model, at its typical size: built, read back, predicted, flown, exported, told."""

import html
import json

import numpy as np
import pytest
from plain_plant import made_model

from quasi.errors import ConfigError
from quasi.export.c_source import c_files
from quasi.export.fmu_source import forces_fmu, vehicle_fmu
from quasi.export.matlab import write_matlab
from quasi.export.python_source import python_file
from quasi.gap.catalogue import catalogue
from quasi.gap.effect import Room, vehicle_of
from quasi.gap.extension import extend
from quasi.model.document import AXES
from quasi.model.model import Model, read_model
from quasi.pages.causes import describe_effects
from quasi.pages.model import _render_causes
from quasi.simulation.loop.run import simulate
from quasi.simulation.loop.setup import make_setup
from quasi.simulation.tools.portable import loop_constants, portable_setup

CATALOGUE = catalogue()
EXTENDING = sorted(i for i, e in CATALOGUE.items() if not e.finding and (e.terms or e.nonlinear_terms or e.extension))
ROOM = Room((-3.0, 3.0), (-3.0, 3.0), 4.0)
RECORDED = {"telemetry_delay", "rotor_speed_scale"}  # of recordings: nothing to see in a simulation
STATEFUL = {"payload_swing": "swinging load", "inflow_lag": "inflow lag"}
FLIGHT = {
    "simulation": {"duration": 1.0, "time step": 0.002},
    "references": {"kind": "figure eight", "amplitude": 1.0, "start": 0.0, "centre": [0.0, 0.0, -0.3]},
    "initial state conditions": {"position": [0.0, 0.0, -0.3]}, "noise": {"add": False},
    "battery": {"voltage": 15.0, "reference voltage": 16.0},
}  # fmt: skip


@pytest.fixture(scope="module")
def base():
    model = made_model(reaction=0.0)
    thrust = 0.43 * 9.81 / (4 * 1500.0**2)
    simple = {"kappaFz": {"value": thrust}, "kappaMx": {"value": 0.05 * thrust}, "kappaMy": {"value": 0.05 * thrust},
              "kappaMz": {"value": -0.012 * thrust}}  # fmt: skip
    return Model({**model.document, "simple model": simple})


def values_of(effect, vehicle):
    found = {}
    for name, parameter in effect.parameters.items():
        size = parameter.typical(vehicle) if callable(parameter.typical) else parameter.typical
        if size is not None and not (found and effect.parts == "any"):
            neutral = {"motor_lag": 0.03, "battery_sag": 0.5}.get(effect.id, 0.0)  # A: the value itself
            found[name] = neutral + float(size)
    return found


def extended(base, name, folder):
    effect, vehicle = CATALOGUE[name], vehicle_of(base, room=ROOM)
    values = values_of(effect, vehicle)
    assert values, f"{name} tells no typical size"
    document = extend(base, [(effect, values)], vehicle, f"with-{name}", "test")
    (folder / "model.json").write_text(json.dumps(document, allow_nan=False))
    return read_model(folder)


@pytest.mark.parametrize("name", EXTENDING)
def test_an_extended_model_lives_like_any_other(base, name, tmp_path):
    model = extended(base, name, tmp_path)
    state = np.array([0.1, -0.1, 0.3, 2.0, -1.0, 0.5, 0.4, -0.3, 0.2, 0.1, 0.2, -0.2])
    force, moment = model.predict(
        state, np.full(4, 1500.0), np.full(4, 2000.0), {"t": 5.0} if "t" in model.inputs else None
    )
    assert np.isfinite([*force, *moment]).all()
    assert name in model.summary() and describe_effects(model.document["extensions"][0])

    runs = [simulate(make_setup({"model": {"model ID": m.id}, **FLIGHT}, m)) for m in (base, model)]
    assert all(run.stopped is None for run in runs)
    old, new = (run.table for run in runs)
    assert np.isfinite(new[list(AXES)].to_numpy()).all()
    shift = np.abs(
        new[["x", "y", "z", "w1", "w2", "w3", "w4"]].to_numpy() - old[["x", "y", "z", "w1", "w2", "w3", "w4"]]
    )
    assert (shift.to_numpy().max() == 0.0) == (name in RECORDED)
    if name not in STATEFUL:  # what the simulation feels is what the model predicts
        through = new.assign(**{a: new[f"{a}_air"] for a in "uvw"}) if "u_air" in new else new
        found = model.predict_columns(through)[list(AXES)].to_numpy()
        offset = runs[1].setup.loop_parameters.body[20:26]
        np.testing.assert_allclose(new[list(AXES)].to_numpy(), found - offset, rtol=1e-9, atol=1e-9)


def tried(work):
    try:
        return work(), None
    except ConfigError as error:
        return None, str(error)


@pytest.mark.parametrize("name", EXTENDING)
def test_exports_carry_an_extended_model_or_refuse_by_name(base, name, tmp_path):
    model = extended(base, name, tmp_path)
    functions = {
        "C": lambda: c_files(model), "Python": lambda: python_file(model), "FMU": lambda: forces_fmu(model),
        "MATLAB": lambda: write_matlab(model, tmp_path / "m", ("U_p", "U_q", "U_r")),
    }  # fmt: skip
    for made, refusal in (tried(work) for work in functions.values()):
        if name == "payload_swing":
            assert made is None and "'payload_swing' has states of its own (swinging load)" in refusal
        else:
            assert made is not None, refusal
    made, refusal = tried(lambda: vehicle_fmu(model))
    _, no_loop = tried(lambda: loop_constants(portable_setup(model)))
    if name in STATEFUL:
        assert f"'{name}' has states of its own ({STATEFUL[name]})" in refusal
        assert f"the {STATEFUL[name]} of the model's extensions cannot be exported" in no_loop
    elif name == "thrust_drift":  # time stands in its terms
        assert "has terms in 't'" in refusal and "a term in the time cannot be exported" in no_loop
    else:
        assert made is not None and no_loop is None, (refusal, no_loop)


def test_a_load_at_rest_in_predictions_is_the_mass_fixed_at_the_cg(base, tmp_path):
    """Specific force of vehicle and load as one body, from the aerodynamic force alone; moments unchanged."""
    model = extended(base, "payload_swing", tmp_path)
    load = model.document["extensions"][0]["states"]["swinging load"]["mass"]
    state, speeds = (
        np.array([0.2, -0.3, 0.1, 3.0, 1.0, -0.5, 0.3, 0.1, 0.2, 0, 0, 0]),
        np.array([1500, 1550, 1480, 1600]),
    )
    (bare, moment), (force, same) = base.predict(state, speeds), model.predict(state, speeds)
    np.testing.assert_allclose(force / base.airframe.mass, bare / (base.airframe.mass + load), rtol=1e-12)
    np.testing.assert_array_equal(same, moment)
    # and of a model of net forces the net force of that one body's acceleration
    net = made_model(reaction=0.0, gravity="noGravity")
    net = Model({**net.document, "simple model": base.document["simple model"]})
    found = Model(extend(net, [(CATALOGUE["payload_swing"], {"mass at 0.5 m": load})], vehicle_of(net), "n", "test"))
    weight = net.predict(state, speeds)[0] - bare
    np.testing.assert_allclose(found.predict(state, speeds)[0] - weight, force, rtol=1e-12)


def test_late_air_in_predictions_is_the_slow_limit_of_the_simulated_one(base, tmp_path):
    """Rotors that speed up evenly for long: what the simulator's states have become is the term of first order."""
    model = extended(base, "inflow_lag", tmp_path)
    part = model.document["extensions"][0]["states"]["inflow lag"]
    state, speeds, slopes = np.zeros(12), np.full(4, 1500.0), np.array([800.0, 800.0, 400.0, 400.0])
    (bare, still), (force, moment) = base.predict(state, speeds, slopes), model.predict(state, speeds, slopes)
    thrust = part["gain"] * speeds * part["time constant"] * slopes
    np.testing.assert_allclose(force - bare, [0.0, 0.0, -thrust.sum()], rtol=1e-12, atol=1e-15)
    hubs = base.airframe.hubs
    arms = np.cross(hubs, np.column_stack([np.zeros(4), np.zeros(4), -thrust])).sum(axis=0)
    np.testing.assert_allclose(moment - still, arms, rtol=1e-9, atol=1e-15)


def test_a_load_needs_a_mass_and_all_forces(base):
    for change in ({"airframe": {**base.document["airframe"], "mass": None}},
                   {"axes": {a: p for a, p in base.document["axes"].items() if a != "Fy"}}):  # fmt: skip
        model = Model({**base.document, **change})
        with pytest.raises(
            ConfigError, match="'payload_swing' is a load that pulls at the vehicle, but the model knows no"
        ):
            extend(model, [(CATALOGUE["payload_swing"], {"mass at 0.5 m": 0.02})], vehicle_of(base), "n", "test")


def test_near_the_floor_less_speed_hovers_by_the_formula_up_to_its_limit(base):
    effect, vehicle = CATALOGUE["ground_effect"], vehicle_of(base)
    model = Model(extend(base, [(effect, {"c": 5.0})], vehicle, "low", "test"))
    settings = {"model": {"model ID": "low"}}
    for height in (0.0, 0.03, 0.06, 0.2, 1.0):
        place = {"initial state conditions": {"position": [0.0, 0.0, -height]}}
        speeds = make_setup({**settings, **place}, model).start[13:17]
        near = min(5.0 * (vehicle.radius / (4.0 * max(height, 0.5 * vehicle.radius))) ** 2, 0.6)
        np.testing.assert_allclose(speeds, 1500.0 * np.sqrt(1.0 - near), rtol=1e-4)


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("motor_lag", {"time_constant": 0.045}, "Time constant 0.04500 s, replaces the value of the model."),
        ("battery_sag", {"exponent": 0.0, "reference voltage": 15.8},
         "Exponent 0, reference voltage 15.80 V, replaces the value of the model."),
        ("mass", {"mass": 0.02}, "Mass 0.02000 kg."),
        ("command_delay", {"delay": -0.004}, "Delay −0.004000 s."),
    ],
)  # fmt: skip
def test_the_page_says_which_numbers_are_deviations(base, name, values, said):
    """A lag of 45 ms of the vehicle is no deviation of 45 ms; a delay 4 ms shorter than the model's is one."""
    document = extend(base, [(CATALOGUE[name], values)], vehicle_of(base), "x", "test")
    text = html.unescape(_render_causes(document))
    assert f". {said} Effects" in text
    assert "Numbers are deviations" in text and "replace them" in text
