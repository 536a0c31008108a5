"""The map from commands to rotor speeds in Python, C and Octave equals the model's own, form by form."""

import ctypes
import shutil
import subprocess
import types

import numpy as np
import pytest
from made_model import document

from quasi.export.c_source import c_files
from quasi.export.command_map import matlab_map
from quasi.export.python_source import python_file
from quasi.model.commands import rotor_speeds
from quasi.model.model import Model
from quasi.terms.rotor_map import FORMS, steady_speeds

COMMANDS = np.random.default_rng(1).uniform(0.05, 0.95, (40, 4))
VOLTS = np.linspace(13.0, 16.5, 40)


def driven(form):
    names = FORMS[form].names
    drive = {
        "source": "commands", "input": "speed" if form == "speed" else "share", "form": form,
        "parameters": {n: {"value": v + 0.03, "std": 0.01} for n, v in zip(names, FORMS[form].start)},
        "operating command": 0.47, "reference voltage": 15.1, "voltage exponent": {"value": 0.83, "std": 0.1},
        "speeds": {"value": [900.0, 870.0, 915.0, 905.5], "unit": "rad/s"},
        "time constant": {"value": 0.034, "std": 0.001}, "delay": {"value": 0.0123, "std": 0.001},
        "relative error": {"map": 0.01, "between flights": None, "total": 0.01},
        "scale": {"relative": False, "from": "configured hover speed"},
    }  # fmt: skip
    return Model({**document(), "rotor speeds": drive})


@pytest.fixture(params=FORMS)
def model(request):
    return driven(request.param)


def test_python(model):
    module = types.ModuleType("made")
    exec(python_file(model)[1], module.__dict__)
    np.testing.assert_allclose(
        module.steady_speeds(COMMANDS, VOLTS),
        steady_speeds(model.document["rotor speeds"], COMMANDS, VOLTS),
        rtol=1e-12,
    )
    t, state = np.arange(40) * 0.004, np.random.default_rng(2).normal(0, 0.1, (40, 12))
    for got, own in zip(
        module.predict_from_commands(state, COMMANDS, VOLTS, 0.004),
        model.predict_from_commands(t, state, COMMANDS, VOLTS),
    ):
        np.testing.assert_allclose(got, own, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("actuators", "lags"),
    [({"rotor3 lag factor": 16.0}, [0.034, 0.034, 16.0 * 0.034, 0.034]),
     ({"rotor3 lag factor": 16.0, "time constant": 0.04}, [0.02, 0.02, 0.32, 0.02])],
)  # fmt: skip
def test_python_with_rotors_of_an_extension_that_lag_by_themselves(actuators, lags):
    extended = Model({**driven("linear").document, "extensions": [{"id": "motor_lag", "actuators": actuators}]})
    module = types.ModuleType("made")
    exec(python_file(extended)[1], module.__dict__)
    t = np.arange(len(COMMANDS)) * 0.004
    speeds = rotor_speeds(extended.document, t, COMMANDS, VOLTS)
    for got, own in zip(module.rotor_speeds(COMMANDS, VOLTS, 0.004), speeds):
        np.testing.assert_allclose(got, own, rtol=1e-9, atol=1e-6)
    for i, lag in enumerate(lags):
        alone = driven("linear")
        alone.document["rotor speeds"]["time constant"]["value"] = lag
        for own, expected in zip(speeds, rotor_speeds(alone.document, t, COMMANDS, VOLTS)):
            np.testing.assert_allclose(own[:, i], expected[:, i], rtol=1e-9, atol=1e-6)


def test_python_with_motors_that_warm_up():
    model = driven("linear")
    model.document["rotor speeds"] |= {"warm-up drop": {"value": 0.06}, "warm-up time constant": {"value": 8.0}}
    module = types.ModuleType("made")
    exec(python_file(model)[1], module.__dict__)
    commands, t = np.concatenate([np.zeros((20, 4)), COMMANDS[:20]]), np.arange(40) * 0.004
    got, slopes = module.rotor_speeds(commands, 15.0, 0.004)
    own = rotor_speeds(model.document, t, commands, 15.0)
    np.testing.assert_allclose(got, own[0], rtol=1e-12)
    np.testing.assert_allclose(slopes, own[1], rtol=1e-9, atol=1e-9)
    warm = rotor_speeds(driven("linear").document, t, commands, 15.0)[0]
    np.testing.assert_allclose(own[0][-1] / warm[-1], 1.06, atol=2e-3)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_c(model, tmp_path):
    for name, text in c_files(model).items():
        (tmp_path / name).write_text(text)
    source = next(tmp_path.glob("*.c"))
    library = tmp_path / "made.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, str(source), "-lm", "-o", str(library)], check=True)
    function = getattr(ctypes.CDLL(str(library)), f"{source.stem}_steady_speeds")
    four = ctypes.c_double * 4
    got = []
    for commands, volts in zip(COMMANDS, VOLTS):
        out = four()
        function(four(*commands), ctypes.c_double(volts), out)
        got.append(list(out))
    np.testing.assert_allclose(got, steady_speeds(model.document["rotor speeds"], COMMANDS, VOLTS), rtol=1e-12)


@pytest.mark.skipif(shutil.which("octave") is None, reason="no Octave")
def test_octave(tmp_path):
    model = driven("quadratic")
    (tmp_path / "steadySpeeds.m").write_text(matlab_map(model))
    said = subprocess.run(
        ["octave", "--quiet", "--eval", "printf('%.15g ', steadySpeeds([0.3 0.4 0.5 0.6; 0.7 0.2 0.1 0.9], [14; 16]))"],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    commands = np.array([[0.3, 0.4, 0.5, 0.6], [0.7, 0.2, 0.1, 0.9]])
    own = steady_speeds(model.document["rotor speeds"], commands, np.array([14.0, 16.0]))
    np.testing.assert_allclose(np.array(said.split(), float), own.T.ravel(), rtol=1e-12)


def test_a_model_without_a_map_exports_none():
    model = Model(document())
    assert "steady_speeds" not in python_file(model)[1] and matlab_map(model) is None
    assert all("steady_speeds" not in text for text in c_files(model).values())
