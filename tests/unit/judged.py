"""A small model of made flights, judged: for tests of diagnostics, summaries, figures and the page."""

import numpy as np
from flights import AIRFRAME, HOVER, flight

from quasi.identification.partition import ROLES, partition
from quasi.model.build import assemble_model
from quasi.model.envelope import measure_coverage
from quasi.model.model import Model
from quasi.scoring.review import review_model

TERMS = {
    "Fz": ("1", "w1^2 + w2^2 + w3^2 + w4^2", "w*w_tot", "u^2"),
    "My": ("1", "U_q", "q"),
}
NOISE = {"Fz": 0.05, "My": 1e-3}  # N, N m, the same in every flight


def columns(axis, f):
    w = [f[f"w{i}"].to_numpy() for i in range(1, 5)]
    one = np.ones(len(f))
    if axis == "Fz":
        return np.column_stack([one, sum(x * x for x in w), f["w"] * sum(w), f["u"] ** 2])
    front = AIRFRAME.front
    return np.column_stack([one, sum(s * x * x for s, x in zip(front, w)), f["q"]])


def fitted(axis, flights, rows):
    """The axis as plain least squares gives it on the rows that train."""
    a = np.vstack([columns(axis, f)[rows[k]] for k, f in flights.items()])
    z = np.concatenate([f[axis].to_numpy()[rows[k]] for k, f in flights.items()])
    theta, *_ = np.linalg.lstsq(a, z, rcond=None)
    residual = z - a @ theta
    sigma2 = float(residual @ residual) / (len(z) - a.shape[1])
    covariance = sigma2 * np.linalg.inv(a.T @ a)
    std = np.sqrt(np.diag(covariance))
    return {
        "unit": "N" if axis[0] == "F" else "N m",
        "terms": [
            {
                "name": "bias" if e == "1" else e, "expression": e, "coefficient": float(c), "std": float(s),
                "t": float(c / s), "unit": "N s2/rad2", "inclusion frequency": 0.9,
            }
            for e, c, s in zip(TERMS[axis], theta, std)
        ],
        "covariance": covariance.tolist(), "sigma2": sigma2, "R2": 1 - float(np.var(residual) / np.var(z)),
        "RMSE": float(np.sqrt(np.mean(residual**2))), "n": len(z), "effective rows": float(len(z)),
        "confidence level": 0.95, "notes": [],
    }  # fmt: skip


SHARED = {
    "gravity": "withGravity",
    "hover speed": {"value": HOVER, "std": 1.0, "unit": "rad/s"},
    "simple model": {"kappaFz": {"value": 1.3e-6, "std": 1e-8, "unit": "N s2/rad2"}},
    "actuators": {
        "time constants": {"value": [0.03] * 4, "std": [1e-3] * 4, "unit": "s", "spread": [2e-3] * 4},
        "time constants up": {"value": [0.02] * 4, "std": [1e-3] * 4, "unit": "s", "spread": None},
        "delay": {"value": [0.001] * 4, "std": [1e-4] * 4, "unit": "s", "spread": [1e-4] * 4},
        "command map": {"coefficients": [300.0, 3000.0, -600.0], "source": "fitted on 2 training flights"},
    },
    "notes": ["a <note> & more"],
}


def made(change=lambda f: f, options=None, rows=2000, validation=("c",), aside=None):
    """(model, flights, review) of flights a, b and the held-out c, which `change` may alter."""
    flights = {key: flight(seed, rows=rows, noise=0.0) for seed, key in enumerate("abc")}
    r = np.random.default_rng(0)
    for f in flights.values():
        for axis, std in NOISE.items():
            f[axis] = f[axis] + std * r.standard_normal(rows)
    flights["c"] = change(flights["c"].copy())
    options = {"usable data ratio": 1.0, **(options or {})}
    codes = partition(flights, validation, options)
    training = {key: c == ROLES["training"] for key, c in codes.items()}
    parts = {axis: fitted(axis, flights, training) for axis in TERMS}
    keys = [k for k in flights if training[k].any()]
    document = assemble_model(
        parts,
        {**SHARED, "training flights": keys},
        {
            "id": "made_up", "airframe": AIRFRAME, "validation flights": list(validation),
            **measure_coverage(flights, training, AIRFRAME, HOVER, parts),
        },
    )  # fmt: skip
    model = Model(document)
    return model, flights, review_model(model, flights, codes, ROLES, aside, options)
