"""A simulated flight holds the model that made it: its coefficients come back from the motion alone."""

import numpy as np
import plain_plant as plain
import pytest

from quasi.attitude import rotate_inverse
from quasi.simulation.loop.run import simulate
from quasi.simulation.loop.setup import make_setup
from quasi.terms.expressions import Program, parse
from quasi.terms.variables import Variables

RATE = 1000.0


@pytest.fixture(scope="module")
def model():
    return plain.made_model(asymmetric=True)


@pytest.fixture(scope="module")
def table(model):
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 30.0, 0.02)
    fade = np.clip(t / 3.0, 0.0, 1.0)
    reference = {"t": t}
    for axis, strength in (("x", 2.0), ("y", 2.0), ("z", 1.5), ("yaw", 6.0)):
        w = 2 * np.pi * np.array([0.13, 0.31, 0.57, 0.93]) * rng.uniform(0.9, 1.1, 4)
        reference[axis] = fade**3 * np.sum(strength / w**2 * np.sin(np.outer(t, w) + rng.uniform(0, 6, 4)), axis=1)
    settings = {
        "model": {"model ID": "made", "correct for moment asymmetries": False},
        "noise": {"add": False},
        "simulation": {"time step": 1 / RATE, "duration": 30.0},
        "references": {"kind": "table", "file": "made"},
    }
    result = simulate(make_setup(settings, model, reference=reference))
    assert result.stopped is None
    return result.table


def motion_loads(table, model):
    """Forces and moments that the motion needs, from positions, attitudes and rates by differences alone."""
    mass, inertia = model.airframe.mass, model.airframe.inertia
    place, rates = table[["x", "y", "z"]].to_numpy(), table[["p", "q", "r"]].to_numpy()
    acceleration = (place[2:] - 2 * place[1:-1] + place[:-2]) * RATE**2
    q = table[["qw", "qx", "qy", "qz"]].to_numpy()[1:-1]
    force = mass * rotate_inverse(q, acceleration - np.array([0.0, 0.0, 9.81]))
    turn, w = (rates[2:] - rates[:-2]) * RATE / 2, rates[1:-1]
    return np.column_stack([force, turn @ inertia.T + np.cross(w, w @ inertia.T)])


def test_every_coefficient_comes_back_from_the_motion(table, model):
    loads = motion_loads(table, model)
    columns = {c: table[c].to_numpy()[1:-1] for c in table.columns if not c.endswith("_ref")}
    variables = Variables(columns, model.airframe, model.hover_speed)
    checked = 0
    for k, axis in enumerate(plain.AXES):
        terms = [t for t in model.document["axes"][axis]["terms"] if t["coefficient"] != 0.0]
        a = Program([parse(t["expression"]) for t in terms]).run(variables.__getitem__, len(loads)).T
        scale = np.linalg.norm(a, axis=0)
        found = np.linalg.lstsq(a / scale, loads[:, k], rcond=None)[0] / scale
        for term, value in zip(terms, found):
            assert value == pytest.approx(term["coefficient"], rel=0.02), (axis, term["name"])
            checked += 1
    assert checked == 16


def test_the_logged_forces_and_moments_are_those_of_the_motion(table, model):
    loads = motion_loads(table, model)
    logged = table[["Fx", "Fy", "Fz", "Mx", "My", "Mz"]].to_numpy()[1:-1]
    assert np.all(np.std(loads - logged, axis=0) < 0.05 * np.std(logged, axis=0))
