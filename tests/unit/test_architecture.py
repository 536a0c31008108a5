"""The page on architecture: its paths exist, and each of its recipes works as written."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from flights import AIRFRAME
from made_model import SHARED, TERMS, document, part
from simulations import setup_of

from quasi.export.matlab_terms import axis_file
from quasi.gap import causes as effects
from quasi.gap.catalogue import catalogue
from quasi.importing.readers import registry
from quasi.importing.readers.reader import Reader, Request
from quasi.importing.series import Recording, Series
from quasi.model.build import assemble_model
from quasi.model.model import Model
from quasi.pages.terms import describe_variable
from quasi.project import recognition
from quasi.simulation.loop.run import simulate
from quasi.terms import variables
from quasi.terms.expressions import parse

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_every_path_of_the_page_exists():
    found = re.findall(r"`((?:quasi(?:_synthesis)?|rules|scripts|tests|docs|config)/[^`]*)`", PAGE)
    paths = [p for p in found if "<" not in p]
    assert len(paths) > 25
    missing = [p for p in paths if not (ROOT / p).exists()]
    assert not missing


def test_every_room_has_its_row():
    rooms = {p.parent.name for p in (ROOT / "quasi").glob("*/__init__.py")}
    assert rooms == set(re.findall(r"^\| `quasi/(\w+)` \|", PAGE, flags=re.M))


def test_the_glossary_has_forty_terms_in_alphabetic_order():
    rows = re.findall(r"^\| (\w[^|]*?) \| [^|]+ \|$", PAGE.split("## Glossary")[1], flags=re.M)[1:]
    assert len(rows) == 40
    assert rows == sorted(rows, key=str.lower)


def test_recipe_of_a_log_format(tmp_path, monkeypatch):
    def read(request: Request) -> Recording:
        t, p = np.loadtxt(request.path, skiprows=1).T
        return Recording({"onboard": Series(t, {"p": np.radians(p)})})

    reader = Reader("a log of the toy recorder", ("toy",), read, ("toy",))
    found = recognition.Format("toy", reader.name, recognition.SET.format("toy"))
    monkeypatch.setattr(registry, "READERS", (*registry.READERS, reader))
    monkeypatch.setattr(recognition, "STARTS", (*recognition.STARTS, (b"TOYLOG 1", found)))
    monkeypatch.setitem(recognition.CONTROLLERS, "toy", (".toy",))
    file = tmp_path / "flight.bin"  # the content decides, not the extension
    file.write_text("TOYLOG 1\n0.0 0\n0.1 90\n")
    series = registry.read_log(Request(file, "toy")).series["onboard"]
    np.testing.assert_allclose(series.values["p"], [0.0, np.pi / 2])
    with pytest.raises(registry.ReadError, match="toy recorder"):
        registry.read_log(Request(file, "betaflight"))


CAUSE = '''"""Lift of a foam wing."""

from quasi.gap.effect import Effect, Parameter

EFFECT = Effect(
    id="toy_wing",
    level="forces",
    sentence="the wing lifts in forward flight",
    equation="dFz = -c u |u|",
    source="this test",
    parameters={"c": Parameter("N s2/m2", 0.0, "a", -0.5, 0.5, 0.02)},
    channels=("Fz",),
    rivals=("translational_lift",),
    tie_breaker="the same speeds forward and sideways",
    terms=lambda vehicle: {"c": {"Fz": "-u*|u|"}},
)
'''


def test_recipe_of_a_cause(tmp_path, monkeypatch):
    (tmp_path / "toy_wing.py").write_text(CAUSE)
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    found = catalogue()
    assert found["toy_wing"].channels == ("Fz",)
    assert set(found) > {"toy_wing", "wind", "mass"}


def test_recipe_of_a_regressor_variable(monkeypatch):
    formula, meaning = "p*u_r/w_avg", "roll rate over the mean speed, weighted by spin"
    monkeypatch.setitem(variables.FORMULAS, "toy", (formula, meaning))
    monkeypatch.setitem(variables.SYNONYMS, "toy", parse(formula))

    def model(expression):
        parts = {axis: part(axis, terms) for axis, terms in TERMS.items()}
        parts["Mz"] = part("Mz", {"1": 1e-3, expression: 2e-4})
        return Model(assemble_model(parts, SHARED, {"id": "m", "airframe": AIRFRAME}))

    named, written = model("toy"), model(f"({formula})")
    r = np.random.default_rng(0)
    state, speeds = r.normal(size=(20, 12)), 1500.0 + 100.0 * r.normal(size=(20, 4))
    for one, other in zip(named.predict(state, speeds), written.predict(state, speeds)):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(named.jacobian(state, speeds), written.jacobian(state, speeds)):
        np.testing.assert_allclose(one, other, rtol=1e-13)
    assert variables.derive_unit(parse("toy"), "Mz") == variables.derive_unit(parse(formula), "Mz") == "N m s/rad"
    assert "(p.*u_r./w_avg)" in axis_file(named, "Mz")
    assert describe_variable("toy")[0] == "rad/s"
    variables.check_expression("toy^2", "here")


def test_recipe_of_a_controller():
    model = Model(document())
    hover = model.hover_speed

    def mine(bus):
        """Height alone: thrust by the error of position and velocity along z, metres and m/s, z down."""
        state = bus.state[bus.step]
        climb = 0.3 * (state[12] + 1.0) + 0.4 * state[6]
        return np.full(4, hover * np.sqrt(np.clip(1.0 + climb, 0.5, 1.5)))

    setup = setup_of(model, duration=4.0, noise={"add": False})
    result = simulate(setup, steps={"controller": mine})
    assert not result.stopped
    assert result.table["z"].iloc[-1] == pytest.approx(-1.0, abs=0.1)


LAW = '''"""The weight as thrust, and no moments."""

from numba import njit

from quasi.simulation.control import law
from quasi.simulation.control import parameters as g


@njit(cache=True, error_model="numpy")
def run_toy(p, m, dt, measurement, setpoint):
    """Set the wanted loads."""
    law.set_wanted_loads(p, m, dt, 0.0, 0.0, 0.0, 9.81 * p[g.CONTROL_MASS])


TOY = law.Law("toy", gains={"velocity": ("integral time",)}, memory=())
'''
LISTED = (
    ("import PID, run_pid\n", "import PID, run_pid\nfrom quasi.simulation.control.toy import TOY, run_toy\n"),
    ("LAWS = (PID, NDI, INDI)", "LAWS = (PID, NDI, INDI, TOY)"),
    ("    else:\n", "    elif kind == 3:\n        run_toy(parameters, memory, dt, measurement, setpoint)\n    else:\n"),
)
ASKED = """
import json
import numpy as np
from plain_plant import made_model
from quasi.simulation.control.control_model import make_control_model
from quasi.simulation.control.controllers import make_controller
from quasi.simulation.control.gains import complete_settings
from quasi.simulation.control.law import WANTED_LOADS
from quasi.simulation.control.registry import run_law
model = made_model()
settled = complete_settings({"controller": "drone_toy"}, make_control_model(model))
kind, parameters, size = make_controller(settled, model)
memory = np.zeros(size)
run_law(kind, parameters, parameters, memory, 0.004, np.zeros(26), np.zeros(20))
hover = make_control_model(model).hover_speed
print(json.dumps([settled["gains"], memory[WANTED_LOADS : WANTED_LOADS + 4].tolist(), hover]))
"""


def test_recipe_of_a_compiled_controller(tmp_path):
    shutil.copytree(ROOT / "quasi", tmp_path / "quasi", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "config/schemas", tmp_path / "config/schemas")
    control = tmp_path / "quasi/simulation/control"
    (control / "toy.py").write_text(LAW)
    text = (control / "registry.py").read_text()
    for sound, listed in LISTED:
        assert text.count(sound) == 1
        text = text.replace(sound, listed)
    (control / "registry.py").write_text(text)
    places = os.pathsep.join([str(tmp_path), str(ROOT / "tests/unit")])
    done = subprocess.run(
        [sys.executable, "-c", ASKED], cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": places},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    gains, loads, hover = json.loads(done.stdout)
    assert set(gains["velocity"]) == {"time constant", "integral time"} and "integral time" not in gains["rates"]
    # Fz of four rotors at hover is the weight, which is what the rotors' squared speeds have to give
    effectiveness = -0.43 * 9.81 / (4 * hover**2)
    assert loads == pytest.approx([0.0, 0.0, 0.0, 4 * effectiveness * hover**2], rel=1e-6)
