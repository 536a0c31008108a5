"""What every export carries besides the arithmetic: constants, inputs, words at its head, and what is refused."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from quasi.airframe import Airframe
from quasi.attitude import GRAVITY
from quasi.errors import ConfigError
from quasi.export.naming import identifier, shown
from quasi.model.extensions import actuators_of, extensions_of, read_rotor_constants
from quasi.model.hover import find_training_median
from quasi.model.model import AXES, ROTORS, Model
from quasi.terms.kernel import INPUTS
from quasi.terms.variables import check_system_inputs

PREFIX = "quasi_"
LATE_AIR = "inflow lag"  # the part of an extension with states of its own that its terms hold to first order


class Voltage(NamedTuple):
    """A battery: V at the start and where commands are true; speeds grow with (voltage / reference) ^ exponent."""

    start: float
    reference: float
    exponent: float


def name_in_source(model: Model) -> str:
    """The identifier that everything of a model begins with: quasi_ and its mapped ID."""
    return identifier(model.id, PREFIX)


def extras_of(model: Model) -> tuple[str, ...]:
    """Columns that a model reads beyond state, rotor speeds and rotor accelerations."""
    return model.inputs[len(INPUTS) :]


def check_exportable(model: Model) -> None:
    """Raises ConfigError naming an extension that no export can carry: one that has states of its own.

    Air through the discs that follows late is carried to first order, by its terms in the rotors' accelerations.
    """
    for extension in extensions_of(model):
        states = [s for s in extension.get("states") or () if s != LATE_AIR]
        if states:
            raise ConfigError(
                f"model {model.id}: its extension '{shown(extension.get('id'))}' has states of its own "
                f"({', '.join(map(shown, states))}), which an export cannot carry; export the model without it, or "
                "simulate it here"
            )
        missing = [a for a in extension.get("terms") or {} if not _stands(model, a, extension.get("id"))]
        if missing:
            raise ConfigError(
                f"model {model.id}: the terms of its extension '{shown(extension.get('id'))}' do not stand among those "
                f"of {shown(missing[0])}, so that predictions leave them out; make the extended model anew"
            )


def check_vehicle(model: Model) -> None:
    """Raises ConfigError naming an extension that a whole vehicle, which moves by itself, would need states for."""
    check_exportable(model)
    for extension in extensions_of(model):
        if LATE_AIR in (extension.get("states") or ()):
            raise ConfigError(
                f"model {model.id}: its extension '{shown(extension.get('id'))}' has states of its own ({LATE_AIR}), "
                "which an exported vehicle cannot carry; use the forces and moments alone, or simulate it here"
            )


def differential_inputs(model: Model) -> tuple[str, ...]:
    """Inputs u of the differential form: those that the model was configured with, else the four rotor speeds.

    () for a model that lacks a moment. Raises ConfigError for inputs that cannot be.
    """
    if any(axis not in model.axes for axis in AXES[3:]):
        return ()
    return configured_inputs(model) or ROTORS


def configured_inputs(model: Model) -> tuple[str, ...]:
    """Inputs u of the differential form that a model names, else (). Raises ConfigError for inputs that cannot be."""
    chosen = model.document.get("differential form")
    u = chosen.get("u") if isinstance(chosen, Mapping) else None
    return check_system_inputs(u, f"model {model.id}") if isinstance(u, list) and u else ()


def has_region(model: Model) -> bool:
    """Whether a model carries the region that its training data covered, and that region has a limit."""
    return bool(model.document.get("envelope")) and model.region.kernel.outputs > 0


def voltage_of(model: Model) -> Voltage | None:
    """The battery of a model: the median voltage of its training flights, and what extensions say of the rotors.

    None for a model that has nothing to do with it. The reference is what the extension's exponent was found at, else
    the flights' voltage; where that is unknown, start is the reference, or both are 1 V: commands are true until both
    are given.
    Raises ConfigError for a model that reads the voltage in its terms but does not know what its flights had.
    """
    rotor_constants = read_rotor_constants(model)
    exponent = rotor_constants.get("voltage exponent", 0.0)
    reads = "battery_voltage" in extras_of(model)
    if not reads and not exponent:
        return None
    start = find_training_median(model, "battery_voltage")
    if start is None and reads:
        raise ConfigError(
            f"model {model.id} reads the battery voltage but does not state that of its flights; make the model anew"
        )
    reference = rotor_constants.get("reference voltage", 1.0 if start is None else start)
    start = reference if start is None else start
    return Voltage(float(start), float(reference), exponent)


def head(model: Model) -> list[str]:
    """The words at the head of every export, harmless in any comment: what it is, units, frames, order, signs."""
    frame = model.airframe
    spins = ", ".join(f"{i} {'clockwise' if s > 0 else 'counter-clockwise'}" for i, s in enumerate(frame.spin, 1))
    lacking = [axis for axis in AXES if axis not in model.axes]
    lines = [
        f"Aerodynamic model {shown(model.id)} of quadrotor {shown(frame.name)}. Made by quasi; do not edit.",
        "",
        "Forces Fx Fy Fz in N and moments Mx My Mz in N m, about the centre of gravity, in body axes:",
        "x forward, y right, z down. Earth axes: x north or forward, y east or right, z down.",
    ]
    lines += (
        [
            "Forces are mass times specific force (hover: Fz = -mass times gravity): in a simulation gravity is to be",
            "added.",
        ]
        if model.with_gravity
        else ["Forces are net forces: gravity is part of them (hover: Fz = 0), a simulation must not add it."]
    )
    lines += [f"Not identified, and NaN: {', '.join(lacking)}."] if lacking else []
    lines += [
        "",
        "Inputs, SI:",
        "state                roll pitch yaw (rad, yaw about z first, then pitch, then roll), u v w (m/s, velocity",
        "                     through the air, body axes), p q r (rad/s, body axes), x y z (m, earth axes)",
        "rotor speeds         w1 w2 w3 w4, mechanical rad/s",
        "rotor accelerations  rad/s2" + ("" if model.uses_rotor_accelerations else "; not used by this model"),
    ]
    extras = extras_of(model)
    lines += [f"extra inputs         {', '.join(shown(name) for name in extras)}"] if extras else []
    lines += ["", f"Rotors, seen from above: {spins}.", "Hubs, m, body axes:"]
    lines += [f"    rotor {i}  x {h[0]:+.6g}  y {h[1]:+.6g}  z {h[2]:+.6g}" for i, h in enumerate(frame.hubs, 1)]
    factor = frame.logged_to_rad_s or model.document.get("logged to rad/s")
    if factor:
        lines.append(f"Where a flight controller logs eRPM/100: mechanical rad/s = {factor:.12g} times that number.")
    extensions = [shown(e.get("id")) for e in extensions_of(model)]
    lines += [f"Extensions: {', '.join(extensions)}."] if extensions else []
    if any(LATE_AIR in (e.get("states") or ()) for e in extensions_of(model)):
        lines += [
            "Air through the discs that follows late stands here to first order in the rotor accelerations; with these",
            "zero, forces and moments are the quasi-steady part.",
        ]
    return lines


def terms_of(model: Model, axis: str) -> list[str]:
    """The terms of an axis as text for a comment: coefficient and expression."""
    scaled = " (of the non-dimensional quantity)" if model.normalisation else ""
    return [
        f"{term['coefficient']:+.6e}  {shown(term['expression'], 90)}{scaled}"
        for term in model.document["axes"].get(axis, {}).get("terms", ())
    ]


def constants_of(model: Model) -> dict[str, float | list[float]]:
    """Numbers of the quadrotor under plain names, SI; NaN where the model does not know them."""
    frame: Airframe = model.airframe
    rotors = actuators_of(model)
    return {
        "mass": float("nan") if frame.mass is None else float(frame.mass),
        "gravity": GRAVITY,
        "inertia": np.asarray(frame.inertia, float).ravel().tolist(),
        "rotor_radius": float(frame.radius),
        "hubs": np.asarray(frame.hubs, float).ravel().tolist(),
        "spin": np.asarray(frame.spin, float).tolist(),
        "hover_speed": float("nan") if model.hover_speed is None else float(model.hover_speed),
        "time_constants_up": rotors.up.tolist(),
        "time_constants_down": rotors.down.tolist(),
        "delay": rotors.delay,
        "lowest_speed": rotors.lowest,
        "highest_speed": rotors.highest,
    }


MEANINGS = {
    "mass": "kg",
    "gravity": "m/s2",
    "inertia": "kg m2, about the centre of gravity, body axes, row by row",
    "rotor_radius": "m",
    "hubs": "m, of rotors 1 to 4, x y z each, from the centre of gravity, body axes",
    "spin": "+1 where a rotor turns clockwise seen from above, else -1",
    "hover_speed": "rad/s",
    "time_constants_up": "s, of rotors 1 to 4 when they speed up",
    "time_constants_down": "s, of rotors 1 to 4 when they slow down",
    "delay": "s, before a command acts",
    "lowest_speed": "rad/s, of a command",
    "highest_speed": "rad/s, of a command; infinite where unknown",
}


def _stands(model: Model, axis: str, name: Any) -> bool:
    terms = model.document["axes"].get(axis, {}).get("terms", ())
    return any(term.get("extension") == name for term in terms)
