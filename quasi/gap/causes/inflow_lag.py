"""The flow through the discs comes late."""

import numpy as np

from quasi.gap.effect import Effect, Extension, Parameter, Terms, Values, Vehicle, at_hubs, number
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.inflow import SHORTEST_LAG, overshoot
from quasi.model.model import Model


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    up = [("", "", f"-({number(vehicle.inflow)}*w{i}*w{i}_dot)") for i in range(1, 5)]
    return {"tau": at_hubs(vehicle, up)}


def _whole(evidence: Evidence, vehicle: Vehicle, values: Values) -> np.ndarray:
    return overshoot(evidence, vehicle.inflow, values["tau"])


def _extension(values: Values, vehicle: Vehicle, _: Model) -> Extension:
    tau = values["tau"]
    terms = {axis: [(text, tau)] for axis, text in _terms(vehicle)["tau"].items()} if tau else {}
    states = {"inflow lag": {"time constant": tau, "gain": vehicle.inflow}} if tau >= SHORTEST_LAG else {}
    return Extension(terms=terms, states=states)


EFFECT = Effect(
    id="inflow_lag",
    level="forces",
    sentence="thrust overshoots when a rotor changes speed, because the air through it follows late",
    equation="dv_i/dt = (v_eq - v_i)/tau, to first order dT = g v/W tau dW/dt, g = -dT/dv at fixed speed",
    source="Pitt & Peters, Theoretical prediction of dynamic-inflow derivatives, Vertica 5, 1981",
    parameters={"tau": Parameter("s", 0.0, "a", 0.0, 0.1, 0.004)},
    channels=("Fz", "Mx", "My"),
    rivals=("telemetry_delay", "rotor_acceleration_torque"),
    tie_breaker="steps of throttle and of roll: a late rotor speed shows in yaw too",
    starts=(0.01, 0.03),
    terms=_terms,
    full_effect=_whole,
    extension=_extension,
)
