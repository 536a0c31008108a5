"""A diagnosis as plain data, put together from parts, as pages and sentences take it."""

import numpy as np
import pandas as pd

from quasi.gap.catalogue import catalogue
from quasi.gap.diagnosis import verdict_of
from quasi.gap.report.wording import summary

KNOWN = catalogue()
ROLES = {"ref-1": "reference", "new-1": "compared", "new-2": "compared", "new-3": "held out"}
GAIN = {"value": 0.86, "low": 0.7, "high": 0.95}
EFFECT = {
    "id": "ground_effect", "level": "forces", "since": "changed", "probability": 0.97, "channels": ["Fz", "Mx", "My"],
    "parameters": {"c": {"value": 5.64, "std": 0.48, "unit": "1"}}, "gain": {"wrench": 0.86, "rollout": 0.3},
    "share of resamples": 0.98,
    "gain channel": "Fz", "rollout channel": "velocity", "gains": {"Fz": GAIN}, "confused_with": ["inflow_lag"],
    "evidence": {"p": 2e-13},
}  # fmt: skip
TIE = {
    "ids": ["mass", "thrust_factor"], "since": "changed", "separability": 1.3, "tie_breaker": "weigh it",
    "parameters": {"mass": {"mass": {"value": 0.45, "std": 0.01, "unit": "kg"}},
                   "thrust_factor": {"factor": {"value": 0.96, "std": 0.01, "unit": "1"}}},
}  # fmt: skip
LEFT = {"channel": "Mz", "where": "heading", "judged": True, "share": 0.4, "since": "always",
        "evidence": {"p": 1e-6, "wald": 40.0}}  # fmt: skip
TURN = {
    "id": "marker_offset", "level": "sensors", "since": "changed", "channels": ["ax", "ay", "az"], "confused_with": [],
    "parameters": {"x": {"value": 0.012, "std": 0.001, "unit": "m"}}, "gain": {"wrench": 0.8, "rollout": None},
    "evidence": {"p": 1e-9},
}  # fmt: skip
LEAN = {**TURN, "id": "attitude_error", "channels": ["ax", "ay"], "gain": {"wrench": None, "rollout": None},
        "parameters": {"gain": {"value": 0.48, "std": 0.02, "unit": "s"}}}  # fmt: skip
LAG = {**TURN, "id": "motor_lag", "level": "drive", "channels": ["w1", "w2", "w3", "w4"],
       "parameters": {"time_constant": {"value": 0.03, "std": 0.001, "unit": "s"}}}  # fmt: skip
TOO_FEW = "1 compared flight is left to learn from, and a cause needs at least 2 in addition to those held out"
LOST = {"id": "tether", "since": "changed", "score": 0.4, "p": 0.69, "why_not": "p = 0.69 <beside> ground_effect"}


def document(effects=(), ties=(), left=()):
    gap = {
        "before": {"forces": {"Fz": {"0": 0.1}}, "rollouts": {"velocity": {"1": 0.5}}, "sensors": {"p": {"0": 0.003}}},
        "after": {"forces": {"Fz": {"0": 0.04}}, "rollouts": {"velocity": {"1": 0.4}}},
        "noise_floor": {"forces": {"Fz": {"0": 0.03}}}, "best_wrong_cause": {}, "generic_polynomial": {},
    }  # fmt: skip
    made = {
        "schema": "quasi.gap/3", "name": "low", "model": "X", "extended_model": "X-low", "flights": ROLES, "gap": gap,
        "effects": list(effects), "ties": list(ties), "unexplained": list(left), "findings": [
            {"id": "timestamp_fault", "text": "flight new-1: the log lost 0.2 s", "evidence": {}}],
        "candidates": [LOST], "cannot_be_asked": [{"id": "battery_sag", "why": "no voltage & no commands"}],
        "notes": ["a note"], "material share": 0.05, "false alarm rate": 0.01, "horizons": [1.0],
        "rollouts": {"rollouts": [{"horizon": 1.0, "quantity": "velocity", "before": 0.5, "after": 0.4, **GAIN}]},
        "scores": {"removed": {"Fz": GAIN}, "best wrong cause": "wind"},
    }  # fmt: skip
    made["verdict"] = verdict_of(made["effects"], made["ties"], made["unexplained"])
    made["summary"] = summary(made, KNOWN)
    return made


def not_judged(why=TOO_FEW, **further):
    made = document() | {"verdict": "not judged", **further}
    made["cannot_be_asked"] += [{"id": i, "why": why} for i in ("ground_effect", "wind")]
    return made | {"summary": summary(made, KNOWN)}


def rows():
    t = np.arange(200) / 100.0
    table = {
        "t": np.tile(t, 2),
        "flight": np.repeat(["new-1", "new-3"], 200),
        "role": np.repeat(["compared", "held out"], 200),
    }
    for axis in ("Fx", "Fy", "Fz", "Mx", "My", "Mz"):
        table |= {
            f"{axis}_measured": np.sin(table["t"]),
            f"{axis}_before": 0.1 + 0 * table["t"],
            f"{axis}_after": 0 * table["t"],
        }
    return pd.DataFrame(table)
