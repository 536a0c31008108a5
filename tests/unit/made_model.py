"""A made model of known terms for tests: every kind of variable, six axes."""

import numpy as np
from flights import AIRFRAME, HOVER

from quasi.model.build import assemble_model
from quasi.model.model import Model

TERMS = {
    "Fx": {"1": 0.02, "(w_tot)*(u^(1.0))": -2e-5},
    "Fy": {"v": -0.01, "v*(u^2 + v^2 + w^2)^0.5": -0.003},
    "Fz": {"(w2_1 + w2_2 + w2_3 + w2_4)": -1.3e-6, "d_w_tot": 1e-4, "mu_z^2": 3.0},
    "Mx": {"U_p": 1e-7, "p": -5e-4, "q*u_r": 1e-6},
    "My": {"U_q": 1.1e-7, "|q|*q": -5e-4},
    "Mz": {"U_r": 2e-8, "u_r_dot": 3e-6},
}


def part(axis, terms, sigma=0.1):
    n = len(terms)
    return {
        "unit": "N" if axis[0] == "F" else "N m",
        "terms": [
            {
                "name": "bias" if e == "1" else e,
                "expression": e,
                "coefficient": c,
                "std": 0.01 * abs(c),
                "t": 100.0,
                "unit": "-",
            }
            for e, c in terms.items()
        ],
        "covariance": np.diag([(0.01 * c) ** 2 for c in terms.values()]).tolist(),
        "sigma2": sigma**2,
        "R2": 0.99,
        "RMSE": sigma,
        "n": 1000,
        "effective rows": 200.0 + n,
        "confidence level": 0.95,
        "notes": [],
    }


SHARED = {
    "gravity": "withGravity",
    "hover speed": {"value": HOVER, "unit": "rad/s"},
    "simple model": {},
    "actuators": None,
    "training flights": ["a"],
    "notes": ["a note"],
}


def document(**more):
    parts = {axis: part(axis, terms) for axis, terms in TERMS.items()}
    return assemble_model(parts, SHARED, {"id": "m", "airframe": AIRFRAME, **more})


def simple_model(airframe, thrust, torque, **more):
    """Thrust and torque by the squares of the rotor speeds, drag, and no damping but what `more` adds by axis."""
    arm = abs(airframe.hubs[0, 0])
    terms = {
        "Fx": {"u": -0.15}, "Fy": {"v": -0.15}, "Fz": {"(w1^2 + w2^2 + w3^2 + w4^2)": -thrust, "w": -0.15},
        "Mx": {"U_p": thrust * arm}, "My": {"U_q": thrust * arm}, "Mz": {"U_r": -torque},
    }  # fmt: skip
    shared = {
        **SHARED, "hover speed": {"value": 2110.0, "unit": "rad/s"}, "notes": [],
        "simple model": {"kappaFz": {"value": thrust}, "kappaMz": {"value": -torque}},
    }  # fmt: skip
    parts = {axis: part(axis, {**of, **more.get(axis, {})}) for axis, of in terms.items()}
    return Model(assemble_model(parts, shared, {"id": "m", "airframe": airframe}))
