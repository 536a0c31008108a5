"""Rotor speeds of a model from commands: which map a model carries, and how far its speeds are off."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from quasi.errors import ConfigError, ShapeError
from quasi.terms.rotor_map import LAG_FACTORS, commanded_speeds, delayed, drive_of_map, lagged, voltage_elasticity


def map_of(document: Mapping[str, Any]) -> dict[str, Any] | None:
    """The map from commands to rotor speeds that a model carries, as `rotor_map` takes it; None without one."""
    return document.get("rotor speeds") or drive_of_map(document.get("actuators"))


def extended_map(document: Mapping[str, Any]) -> dict[str, Any] | None:
    """`map_of` with what the model's extensions know of voltage, time constant, delay and scale; the last one counts.

    An extension's exponent is that of the speed at the operating command. Where one knows rotors with lags of their
    own, the time constant is one of each rotor, (4,).
    """
    own = drive = map_of(document)
    factors, of_all = np.ones(4), False
    for extension in document.get("extensions") or ():
        found = extension.get("actuators") or {}
        if drive is None or not found:
            continue
        reference = drive["reference voltage"] or found.get("reference voltage")
        drive = drive | {n: {"value": float(found[n]), "unit": "s"} for n in ("time constant", "delay") if n in found}
        if "voltage exponent" in found and reference:
            exponent = float(found["voltage exponent"]) / voltage_elasticity(drive)
            drive |= {"voltage exponent": {"value": exponent}, "reference voltage": reference}
        if "rotor speed scale" in found:
            true = (np.asarray(own["speeds"]["value"], float) / float(found["rotor speed scale"])).tolist()
            drive |= {"speeds": {**own["speeds"], "value": true}}
        factors = np.array([float(found.get(n, f)) for n, f in zip(LAG_FACTORS, factors)])
        of_all |= "time constant" in found
    if drive is not None and np.any(factors != 1.0):
        # as in `extensions.drive_of`: next to a time constant, that of all rotors, factors shift them
        shares = factors / np.exp(np.mean(np.log(factors))) if of_all else factors
        drive |= {"time constant": {"value": (drive["time constant"]["value"] * shares).tolist(), "unit": "s"}}
    return drive


def relative_speed_error(document: Mapping[str, Any], trimmed: bool) -> float:
    """Standard error of estimated rotor speeds over the speeds; 0 for a model on measured speeds.

    trimmed  without the scatter between flights, for speeds that were scaled to the flight's own balance
    """
    drive = document.get("rotor speeds") or {}
    return float((drive.get("relative error") or {}).get("map" if trimmed else "total") or 0.0)


def rotor_speeds(
    document: Mapping[str, Any], t: np.ndarray, commands: np.ndarray, volts: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Rotor speeds (N, 4), rad/s, and their slopes (N, 4), rad/s2; arguments as `Model.predict_from_commands`."""
    drive = extended_map(document)
    if drive is None:
        raise ConfigError(
            f"model {document.get('id')} carries no map from commands to rotor speeds; identify it on flights whose "
            "log holds commands"
        )
    t, commands = np.asarray(t, float), np.asarray(commands, float)
    if t.ndim != 1 or len(t) < 2 or commands.shape != (len(t), 4):
        raise ShapeError(f"t must be (N,) and commands (N, 4) with N of at least 2, got {t.shape} and {commands.shape}")
    if volts is not None:
        volts = np.broadcast_to(np.asarray(volts, float), t.shape)
    step = np.diff(t)
    if not np.all(np.abs(step - step.mean()) <= 0.01 * step.mean()):
        raise ShapeError("t must be evenly spaced and increasing; resample commands and states first")
    dt, tau, delay = float(step.mean()), np.array(drive["time constant"]["value"]), drive["delay"]["value"]
    wanted = commanded_speeds(drive, commands, volts, dt)
    speeds = lagged(wanted, dt, tau, delay)
    return speeds, (delayed(wanted, dt, delay) - speeds) / tau
