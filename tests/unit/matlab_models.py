"""Models for the tests of the MATLAB export: the whole grammar, bundled pools, one that may be flown."""

from pathlib import Path

import numpy as np
import pytest
from made_model import SHARED, document, part
from test_normalisation import SCHEME, TRUTH

from quasi.export.agreement import states_of
from quasi.export.matlab_check import find_octave
from quasi.identification.candidates import read_specification
from quasi.model.build import assemble_model
from quasi.model.model import Model
from quasi.tables import read_json
from quasi.terms.expressions import Program, parse
from quasi.terms.variables import Variables

ROOT = Path(__file__).parents[2]
U = ["U_p", "U_q", "U_r"]
octave = pytest.mark.skipif(find_octave() is None, reason="GNU Octave is not installed")

# every production of the grammar, every kind of variable, columns with names that are no identifiers
GRAMMAR = {
    "Fx": ["1", "-u^2", "-(u*v)", "2*u-3*v+1e-3", "u/(v + 20)/(w + 20)", "u/((v + 20)*w_avg)",
           "u*v/(w + 20)*p", "(u + 20)^-1", "(u^2)^3", ".5*|u|*u"],
    "Fy": ["(v + 20)^1.5", "(u^2 + v^2 + w^2)^0.5", "|u|^(v/10)", "2^|u|^0.5", "|v|^0.3^2", "(1 + v/100)^33",
           "v^0", "v^(1.0)", "(u + 20)^-0.5"],
    "Fz": ["w2_1 + w2_2 + w2_3 + w2_4", "wtot", "w_avg", "d_w1 - d_w4", "d_wtot", "mu_x^2 + mu_y^2", "mu_z*|mu_vin|",
           "v_in", "battery_voltage^2", "w1_CMD*w1", "a|b[c]*w", "throttle"],
    "Mx": ["U_p", "p*|p|", "sin[roll]", "cos[pitch]*p", "|sin[roll]|", "yaw*q", "sin[|yaw|]", "u_p", "u_p_dot", "p^3"],
    "My": ["U_q", "q^2/(1 + q^2)", "u_q*q", "u_q_dot", "x*y", "z", "1/(z^2 + 1)", "q/((q + 30)^2)^0.5", "-q^2*-3",
           "(1 + (p*q)^2)^0.5"],
    "Mz": ["U_r", "r", "u_r_dot", "w_tot_dot", "w3_dot", "r*u_r", "|U_r|^0.5", "r^2^0.5", "--r", "((r + 1)^2)^0.5",
           "w1*r - w2*r"],
}  # fmt: skip


def of_terms(expressions, **shared):
    """A model of these terms, {axis: [expression]}, each with a coefficient that makes it of ordinary size."""
    plain = assemble_model({a: part(a, dict.fromkeys(e, 1.0)) for a, e in expressions.items()}, {**SHARED, **shared},
                     {"id": "m", "airframe": Model(document()).airframe})  # fmt: skip
    model = Model(plain)
    at = states_of(model, 400)
    columns = dict(zip(model.inputs, at.table.T))
    variables = Variables(columns, model.airframe, model.hover_speed)
    for axis, texts in expressions.items():
        values = Program([parse(e) for e in texts]).run(variables.__getitem__, 400)
        for k, term in enumerate(plain["axes"][axis]["terms"]):
            term["coefficient"] = float((-1) ** k * (1 + 0.1 * k) / np.nanmedian(np.abs(values[k])))
    return Model(plain)


def of_pool(name, seed=3):
    """Ten random candidates of a bundled pool in each axis, beside the fixed terms."""
    random = np.random.default_rng(seed)
    pool = read_json(ROOT / f"config/polynomials/{name}.json")
    chosen = {}
    for axis in ("Fx", "Fy", "Fz", "Mx", "My", "Mz"):
        found = read_specification(pool, axis, name)
        few = random.permutation(len(found.candidates))[:10]
        chosen[axis] = list(dict.fromkeys(
            ["1", *(t.expression for t in found.fixed), *(found.candidates[k].expression for k in few)]
        ))  # fmt: skip
    return of_terms(chosen)


def normalised():
    scheme = SCHEME.to_plain()
    parts = {axis: {**part(axis, terms), "normalisation": scheme} for axis, terms in TRUTH.items()}
    return Model(assemble_model(parts, SHARED, {"id": "m", "airframe": Model(document()).airframe}))


def flown():
    """The made model with rotors that have limits, so that it may be flown."""
    found = document()
    found["airframe"] |= {"motor poles": 14, "idle RPM": 400.0, "max RPM": 750.0}
    found["actuators"] = {"time constants": {"value": [0.03, 0.03, 0.03, 0.03]}, "delay": {"value": 0.006}}
    return Model(found)
