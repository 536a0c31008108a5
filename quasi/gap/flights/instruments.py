"""What the instruments would show if a model were right: read with the configured constants, late, scaled, in wind.

A model that is extended already is compared with flights like any other: their recordings are put right by what it
knows of them (`quasi.model.extensions`), and its wrench is that which the instruments would show.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from quasi import attitude
from quasi.attitude import GRAVITY
from quasi.gap.flights.evidence import Evidence, model_wrench
from quasi.gap.flights.inflow import overshoot
from quasi.gap.flights.pendulum import pull_of
from quasi.model.extensions import (
    changes_of_map,
    compute_flight_inertia,
    compute_flight_mass,
    configured_mass,
    correct_estimated_speeds,
    correct_rotor_speeds,
    shift_of,
    telemetry_of,
    wind_of,
)
from quasi.model.model import Model
from quasi.simulation.vehicle.variants import list_part_names, read_payload_and_inflow


def as_shown(flight: Evidence) -> np.ndarray:
    """Wrench (n, 6) of a flight's model as its instruments would show it, also where it was extended before."""
    extended = flight.model.document.get("extensions")
    return shown(flight.model, flight.model, flight) if extended else flight.predicted


def reread(flight: Evidence, columns: Mapping[str, np.ndarray]) -> Evidence:
    """The flight with some of its columns replaced, and what the model makes of them."""
    merged = {**flight.columns, **columns}
    found = replace(flight, columns=merged, predicted=model_wrench(flight.model, merged))
    return replace(found, predicted=as_shown(found))


def shown(extended: Model, base: Model, flight: Evidence) -> np.ndarray:
    """Wrench (n, 6) that the instruments, read with the configured constants, would show if a model were right.

    base  the model whose knowledge of recordings and air the flight's columns were put right by; may be the same
    Parts with states of their own act: a load swings, see `pendulum`, and air follows late, see `inflow`.
    """
    (late, scale), (known, factor) = telemetry_of(extended), telemetry_of(base)
    columns = correct_rotor_speeds(flight.columns, late - known, scale / factor)
    columns = correct_estimated_speeds(columns, changes_of_map(extended).beyond(changes_of_map(base)))
    wind = wind_of(extended) - wind_of(base)
    if wind.any():
        along = attitude.rotate_inverse(flight.quaternion, wind)
        columns = {**columns, **{f"{a}_air": flight.velocity[:, k] - along[:, k] for k, a in enumerate("uvw")}}
    wrench = model_wrench(extended, columns)
    configured = flight.mass if np.isfinite(flight.mass) else configured_mass(base)
    mass = compute_flight_mass(extended, flight.mass)
    mass = configured if mass is None else mass
    configured = configured if configured is not None else mass
    inertia, own = compute_flight_inertia(extended, flight.inertia), flight.inertia
    turning = np.linalg.solve(inertia, (wrench[:, 3:] - flight.gyroscopic(inertia)).T).T
    scale = configured / mass if mass else 1.0
    force = wrench[:, :3] * scale
    sections = extended.document.get("extensions", [])
    for extension in sections:
        load = extension.get("states", {}).get("swinging load")
        if load:  # it swings instead of hanging at rest
            weight = 0.0 if extended.with_gravity else mass * GRAVITY * flight.down
            bare = (wrench[:, :3] - weight) * (mass + load["mass"]) / mass
            # what a model that carries the load already predicts holds it hanging at rest
            driving = bare / mass if "swinging load" in list_part_names(read_payload_and_inflow(base)) else None
            # the accelerometer feels the string's pull as well as the rotors' thrust, over the true mass
            force = scale * (bare + weight + load["mass"] * pull_of(flight, load["length"], driving))
    for extension in sections:
        lag = extension.get("states", {}).get("inflow lag")
        if lag:  # its terms hold the first order
            gain, tau = lag["gain"], lag["time constant"]
            beyond = overshoot(flight, gain, tau) - tau * flight.upward(gain * flight.speeds * flight.spin_up)
            force = force + scale * beyond[:, :3]
            turning = turning + np.linalg.solve(inertia, beyond[:, 3:].T).T
    shift = shift_of(extended)
    if shift.any():
        rates = flight.rates
        force = force - flight.mass * (np.cross(turning, shift) + np.cross(rates, np.cross(rates, shift)))
    return np.hstack([force, turning @ own.T + flight.gyroscopic(own)])
