"""A small model and planned trajectories for the tests of plans."""

import math

import numpy as np
import pandas as pd
from flights import AIRFRAME
from made_model import part

from quasi.attitude import GRAVITY
from quasi.gap.catalogue import catalogue
from quasi.gap.effect import vehicle_of
from quasi.gap.planning import plan
from quasi.gap.planning.flatness import planned, read_plan
from quasi.model.build import assemble_model
from quasi.model.model import Model

MASS, ARM, THRUST = 0.433, 0.077 / math.sqrt(2.0), 2.4e-7
HOVER = math.sqrt(MASS * GRAVITY / (4.0 * THRUST))
TERMS = {
    "Fx": {"1": 1e-3, "w_tot*u": -2.6e-5},
    "Fy": {"1": 1e-3, "w_tot*v": -2.6e-5},
    "Fz": {"1": 1e-3, "w1^2 + w2^2 + w3^2 + w4^2": -THRUST, "w_tot*w": -1.5e-5},
    "Mx": {"1": 1e-6, "U_p": THRUST * ARM, "p": -9e-4},
    "My": {"1": 1e-6, "U_q": THRUST * ARM, "q": -9e-4},
    "Mz": {"1": 1e-6, "U_r": -1.8e-9, "r": -1e-3, "u_r_dot": -7e-7},
}
CATALOGUE = catalogue()


def model_of(airframe=AIRFRAME, **more):
    shared = {
        "gravity": "withGravity",
        "hover speed": {"value": HOVER, "unit": "rad/s"},
        "simple model": {"kappaFz": {"value": THRUST, "unit": "-"}, "kappaMz": {"value": 1.8e-9, "unit": "-"}},
        "actuators": None,
        "training flights": ["a"],
        "notes": [],
        **more,
    }
    return Model(
        assemble_model({a: part(a, t) for a, t in TERMS.items()}, shared, {"id": "small", "airframe": airframe})
    )


MODEL = model_of()
VEHICLE = vehicle_of(MODEL)


def begun(t):
    """From 0 to 1 in three seconds, smooth."""
    s = np.clip(t / 3.0, 0.0, 1.0)
    return s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)


def eight(seconds=40.0, turn=0.0, height=1.5, size=1.0):
    """A planned figure: t, x, y, z, yaw at 10 Hz."""
    t = np.arange(0.0, seconds, 0.1)
    s = size * begun(t)
    return pd.DataFrame(
        {"t": t, "x": 2.0 * s * np.sin(1.2 * t), "y": 1.5 * s * np.sin(0.9 * t + 1.0),
         "z": -height + 0.3 * s * np.sin(0.7 * t), "yaw": turn * begun(t) * t}
    )  # fmt: skip


def follow(table, model=MODEL):
    return planned(*read_plan(table, "a plan"), model, "a plan")


def card_of(table, **options):
    return plan.examine([plan.read_flight(table, MODEL, "a plan")], MODEL, CATALOGUE, **{"propose": False, **options})


def rows_of(card):
    return {r.effect.id: r.sight for r in card.rows}
