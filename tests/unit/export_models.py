"""Models for the tests of exports: made terms, every function of the grammar, the candidates that come with quasi."""

from pathlib import Path

import numpy as np
from airframes import BEETLE
from flights import AIRFRAME
from made_model import SHARED, TERMS, document, part

from quasi.airframe import read_airframe
from quasi.identification.candidates import read_specification
from quasi.model.build import assemble_model
from quasi.model.model import Model
from quasi.project.configurations import AXES
from quasi.tables import read_json
from quasi.terms.expressions import text
from quasi.terms.normalisation import make_normalisation

EVERY_FUNCTION = {
    "Fx": {"1": 0.02, "|u|*u": -2e-3, "sin[pitch]": -4.2, "cos[yaw]*u": 1e-2, "mu_x^3*w_avg": 1e-2, "x*v - -2*z": 1e-3},
    "Fy": {"(v^2 + w^2)^0.5*v": -0.01, "sin[roll]*cos[pitch]": 4.2, "|sin[yaw]|": 0.1, "y^-1": 1e-3, "|v|^1.5": 0.02},
    "Fz": {"w2_1 + w2_2 + w2_3 + w2_4": -1.3e-6, "d_w_tot": 1e-4, "mu_z^2": 3.0, "2^(w/10)": 1e-2,
           "U_p/(1 + r^2)": 1e-8, "cos[|w|]": 0.01, "(u - v)/(w_tot - 4*w_avg*0.3)": 0.5},
    "Mx": {"U_p": 1e-7, "p": -5e-4, "q*u_r": 1e-6, "p*|p|^0.5": -1e-4, "w3_dot - w1_dot": 1e-7, "sin[mu_y]": 1e-3,
           "x*U_p": 1e-9},
    "My": {"U_q": 1.1e-7, "|q|*q": -5e-4, "d_w2*q": -1e-7, "battery_voltage*U_q": 1e-9, "|U_q|^0.5*q": -1e-7},
    "Mz": {"U_r": 2e-8, "u_r_dot": 3e-6, "r*v_in": -1e-4, "U_r^2*r": -1e-16, "p*q*r": 1e-5, "u_p*r": 1e-8},
}  # fmt: skip

# velocity through the air under both of its names
THROUGH_THE_AIR = {**TERMS, "Fx": {"u": -0.1, "u_air": -0.2, "|u_air|*v_air": 0.03, "mu_x": 0.5}, "Fy": {"v_air": -0.3}}


def model(terms, name="m", **more):
    parts = {axis: part(axis, found) for axis, found in terms.items()}
    shared = {**SHARED, **{k: more.pop(k) for k in list(more) if k in SHARED}}
    return Model({**assemble_model(parts, shared, {"id": name, "airframe": AIRFRAME}), **more})


def bundled(file=Path(__file__).parents[2] / "config/polynomials/physical_large.json"):
    """Every candidate of a bundled pool, with made coefficients that make the terms of like size."""
    specification = read_json(file)
    random = np.random.default_rng(3)
    terms = {}
    for axis in AXES:
        found = read_specification(specification, axis, str(file))
        trees = dict.fromkeys(text(term.tree) for term in (*found.fixed, *found.candidates))
        terms[axis] = {expression: float(random.normal()) for expression in trees}
    return model(terms, "bundled")


def normalised():
    inertia = "[8.65e-4, 1e-5, 0; 1e-5, 1.07e-3, 0; 0, 0, 1.71e-3]"
    limits = {"mass": 0.433, "motor poles": 14, "idle RPM": 250, "max RPM": 2500}
    frame = read_airframe({**BEETLE, "moment of inertia": inertia, **limits}, "test")
    scheme = make_normalisation(frame, None, "test").to_plain()
    terms = {"U_p": 0.3, "mu_x*w_avg": -0.1, "u": 0.2, "F_den^0.5": 1e-3, "|F_den|*v": 1e-3, "sin[M_den]": 1e-3}
    parts = {axis: {**part(axis, terms), "normalisation": scheme} for axis in AXES}
    return Model(assemble_model(parts, SHARED, {"id": "normalised", "airframe": frame}))


MODELS = {
    "made": lambda: Model(document()),
    "every_function": lambda: model(
        EVERY_FUNCTION, "every-function", **{"differential form": {"u": ["U_p", "U_q", "battery_voltage"]}}
    ),
    "bundled": bundled,
    "air": lambda: model(THROUGH_THE_AIR, "air"),
}
