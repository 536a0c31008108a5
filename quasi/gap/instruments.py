"""What the instruments would show if a model were right: read with the configured constants, late, scaled, in wind.

A model that is extended already is compared with flights like any other: their recordings are put right by what it
knows of them (`put_right`), and its wrench is that which the instruments would show.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from quasi import attitude
from quasi.attitude import GRAVITY
from quasi.gap.inflow import overshoot
from quasi.gap.pendulum import pull_of
from quasi.simulation.variants import actuators_of, named, parts_of, wind_of
from quasi.standalone.model import AXES, ROTORS, Model

if TYPE_CHECKING:
    from quasi.gap.evidence import Evidence

CONFIGURED = "configured mass"  # of a model's document, kg: that its flights were processed with


def configured_mass(model: Model) -> float | None:
    """Mass, kg, that flights are read with; the model's own may differ from it by what extensions found."""
    return model.document.get(CONFIGURED, model.airframe.mass)


def put_right(model: Model, columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A flight's columns as they would be without what the model's extensions know of rotor speeds and air."""
    result = _true_speeds(columns, *_telemetry(model))
    wind = wind_of(model)
    if wind.any():
        quaternion = attitude.from_euler(*(columns[c] for c in ("roll", "pitch", "yaw")))
        over_ground = np.stack([columns.get(f"{c}_air", columns[c]) for c in "uvw"], axis=1)
        through_air = over_ground - attitude.rotate_inverse(quaternion, wind)
        result |= {f"{c}_air": through_air[:, k] for k, c in enumerate("uvw")}
    return result


def shown(extended: Model, base: Model, flight: "Evidence") -> np.ndarray:
    """Wrench (n, 6) that the instruments, read with the configured constants, would show if a model were right.

    base  the model whose knowledge of recordings and air the flight's columns were put right by; may be the same
    Parts with states of their own act: a load swings, see `pendulum`, and air follows late, see `inflow`.
    """
    (late, scale), (known, factor) = _telemetry(extended), _telemetry(base)
    columns = _true_speeds(flight.columns, late - known, scale / factor)
    wind = wind_of(extended) - wind_of(base)
    if wind.any():
        along = attitude.rotate_inverse(flight.quaternion, wind)
        columns = {**columns, **{f"{a}_air": flight.velocity[:, k] - along[:, k] for k, a in enumerate("uvw")}}
    wrench = extended.predict_columns(columns)[list(AXES)].to_numpy()
    configured = configured_mass(base)
    mass = configured if extended.airframe.mass is None else extended.airframe.mass
    configured = configured if configured is not None else mass
    inertia, own = np.asarray(extended.airframe.inertia), flight.inertia
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
            driving = bare / mass if "swinging load" in named(parts_of(base)) else None
            force = (bare + weight) * scale + load["mass"] * pull_of(flight, load["length"], driving)
    for extension in sections:
        lag = extension.get("states", {}).get("inflow lag")
        if lag:  # its terms hold the first order
            gain, tau = lag["gain"], lag["time constant"]
            beyond = overshoot(flight, gain, tau) - tau * flight.upward(gain * flight.speeds * flight.spin_up)
            force = force + scale * beyond[:, :3]
            turning = turning + np.linalg.solve(inertia, beyond[:, 3:].T).T
    shift = np.zeros(3)
    for extension in sections:
        shift = shift + np.asarray(extension.get("airframe", {}).get("cg offset", np.zeros(3)), float)
    if shift.any():
        rates = flight.rates
        force = force - flight.mass * (np.cross(turning, shift) + np.cross(rates, np.cross(rates, shift)))
    return np.hstack([force, turning @ own.T + flight.gyroscopic(own)])


def _telemetry(model: Model) -> tuple[float, float]:
    """How late (s) and by which factor too high the recorded rotor speeds are, by the model's extensions."""
    said = actuators_of(model)
    return said.get("telemetry delay", 0.0), said.get("rotor speed scale", 1.0)


def _true_speeds(columns: Mapping[str, np.ndarray], late: float, scale: float) -> dict[str, np.ndarray]:
    """Columns with the rotor speeds as they were."""
    result = dict(columns)
    if late or scale != 1.0:
        for name in ROTORS:
            slope = f"{name}_dot"
            result[name] = (columns[name] + late * columns[slope]) / scale
            result[slope] = columns[slope] / scale
    return result
