"""Conditions of a campaign: what its sensors, firmware, airframe and sessions are like, checked and applied.

All keys are optional; a campaign without them has the sensors and the airframe of `nominal`. Times s, frequencies Hz.
Source of ranges: recordings on vibrating frames and Betaflight 4.2 to 4.5 settings.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from quasi.errors import ConfigError, nearest
from quasi_synthesis.flight import LOOP
from quasi_synthesis.nuisance import Setup
from quasi_synthesis.sensors import BIQUAD, FILTER_KINDS, LOST, NO_FILTER, PT2, REPEATED_PACKET

WHITE_RATE = 2000.0  # Hz, the sampling rate that white noise is stated for


class Number(NamedTuple):
    """Limits and unit of a number; default where it is absent, None if it is required."""

    low: float
    high: float
    unit: str
    default: float | None = None


# keys that hold one number
PLAIN = {
    "accelerometer noise": Number(0.0, 5.0, "m/s2 per sample at 2 kHz"),
    "gyro noise": Number(0.0, 5.0, "deg/s per sample at 2 kHz"),
}
# keys that hold several numbers by name
NUMBER_GROUPS = {
    "sensor delay": {"gyro": Number(0.0, 0.005, "s", 0.0), "accelerometer": Number(0.0, 0.005, "s", 0.0)},
    "telemetry": {"lost": Number(0.0, 0.5, "(share)", 0.0), "repeated": Number(0.0, 0.5, "(share)", 0.0)},
    "sessions": {"between": Number(0.0, 0.1, "(share)"), "within": Number(0.0, 0.1, "(share)")},
    "airframe": {"thrust exponent": Number(1.5, 2.5, "", 2.0), "flapping": Number(0.0, 5.0, "times the usual", 1.0)},
}
MODE = {
    "frequency": Number(5.0, 200.0, "Hz"),
    "damping": Number(0.005, 0.5, "(share of critical)"),
    "acceleration": Number(0.0, 10.0, "m/s2", 0.0),
    "rate": Number(0.0, 20.0, "deg/s", 0.0),
}
FILTER_KEYS = ("firmware", "gyro", "accelerometer")
FIRMWARES = ("4.2.11", "4.3.2", "4.4.3", "4.5.1")
CONDITION_KEYS = (*PLAIN, *NUMBER_GROUPS, "structural modes", "filters", "fixed heading")


def read_conditions(config: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The conditions among a campaign's keys, checked and with defaults; absent keys stay absent.

    Raises ConfigError naming `where`, the key and what is expected.
    """
    found: dict[str, Any] = {}
    for key, limits in PLAIN.items():
        if key in config:
            found[key] = _number(config[key], limits, f"{where}: '{key}'")
    for key, numbers in NUMBER_GROUPS.items():
        if key in config:
            found[key] = _numbers(config[key], numbers, f"{where}: '{key}'")
    if "structural modes" in config:
        found["structural modes"] = _modes(config["structural modes"], f"{where}: 'structural modes'")
    if "filters" in config:
        found["filters"] = _filters(config["filters"], f"{where}: 'filters'")
    if "fixed heading" in config:
        if not isinstance(config["fixed heading"], bool):
            raise ConfigError(f"{where}: 'fixed heading' is {config['fixed heading']!r}, expected true or false")
        found["fixed heading"] = config["fixed heading"]
    return found


def _number(value: Any, limits: Number, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not limits.low <= value <= limits.high:
        expected = f"a number from {limits.low:g} to {limits.high:g} {limits.unit}".rstrip()
        raise ConfigError(f"{what} is {value!r}, expected {expected}; correct it")
    return float(value)


def _numbers(given: Any, numbers: Mapping[str, Number], what: str) -> dict[str, float]:
    if not isinstance(given, Mapping):
        listed = ", ".join(f"'{name}'" for name in numbers)
        raise ConfigError(f"{what} is {given!r}, expected numbers by name ({listed}); correct it")
    for name in given:
        if name not in numbers:
            raise ConfigError(f"{what} has an unknown key '{name}'{nearest(name, numbers)}")
    found = {}
    for name, limits in numbers.items():
        if name not in given and limits.default is None:
            raise ConfigError(f"{what} lacks '{name}', a number from {limits.low:g} to {limits.high:g} {limits.unit}")
        found[name] = _number(given.get(name, limits.default), limits, f"{what}: '{name}'")
    return found


def _modes(given: Any, what: str) -> dict[str, dict[str, float]]:
    if not isinstance(given, Mapping) or not given:
        raise ConfigError(f"{what} is {given!r}, expected a mode by axis ('x', 'y', 'z'); correct it")
    for axis in given:
        if axis not in ("x", "y", "z"):
            raise ConfigError(f"{what} has an unknown axis '{axis}', expected 'x', 'y' or 'z'")
    return {axis: _numbers(mode, MODE, f"{what}: '{axis}'") for axis, mode in given.items()}


def _filters(given: Any, what: str) -> dict[str, Any]:
    if not isinstance(given, Mapping):
        raise ConfigError(f"{what} is {given!r}, expected 'firmware', 'gyro' and 'accelerometer'; correct it")
    for name in given:
        if name not in FILTER_KEYS:
            raise ConfigError(f"{what} has an unknown key '{name}'{nearest(name, FILTER_KEYS)}")
    firmware = given.get("firmware", FIRMWARES[-1])
    if firmware not in FIRMWARES:
        raise ConfigError(f"{what}: 'firmware' is {firmware!r}, expected one of {', '.join(FIRMWARES)}; correct it")
    stages = given.get("gyro", [])
    if not isinstance(stages, list) or len(stages) > 2:
        raise ConfigError(f"{what}: 'gyro' is {stages!r}, expected a list of at most two low-passes; correct it")
    known = ("PT1", "biquad") if firmware < "4.3" else ("PT1", "PT2", "biquad")
    cutoff = Number(10.0, 1000.0, "Hz")
    read = []
    for i, stage in enumerate(stages, start=1):
        here = f"{what}: low-pass {i} of the gyro"
        if not isinstance(stage, Mapping) or set(stage) != {"type", "cutoff"}:
            raise ConfigError(f"{here} is {stage!r}, expected a 'type' and a 'cutoff'; correct it")
        if stage["type"] not in known:
            raise ConfigError(
                f"{here}: 'type' is {stage['type']!r}, expected {', '.join(known)} in firmware {firmware}; correct it"
            )
        read.append({"type": stage["type"], "cutoff": _number(stage["cutoff"], cutoff, f"{here}: 'cutoff'")})
    accelerometer = given.get("accelerometer", 100.0)
    return {"firmware": firmware, "gyro": read,
            "accelerometer": _number(accelerometer, cutoff, f"{what}: 'accelerometer'")}  # fmt: skip


def apply_conditions(setup: Setup, conditions: Mapping[str, Any]) -> Setup:
    """The set-up under checked conditions; sessions and the fixed heading are applied where they are drawn."""
    inertial, vehicle = setup.inertial, setup.vehicle
    # white noise has one density: its variance per sample grows with the sampling rate
    per_step = math.sqrt(LOOP / WHITE_RATE)
    if "accelerometer noise" in conditions:
        inertial = inertial._replace(acc_noise=conditions["accelerometer noise"] * per_step)
    if "gyro noise" in conditions:
        inertial = inertial._replace(gyro_noise=math.radians(conditions["gyro noise"]) * per_step)
    if "sensor delay" in conditions:
        late = conditions["sensor delay"]
        inertial = inertial._replace(gyro_delay=late["gyro"], acc_delay=late["accelerometer"])
    for axis, mode in conditions.get("structural modes", {}).items():
        k = "xyz".index(axis)
        inertial = inertial._replace(
            mode_frequency=_with(inertial.mode_frequency, k, 2.0 * math.pi * mode["frequency"]),
            mode_damping=_with(inertial.mode_damping, k, mode["damping"]),
            mode_acceleration=_with(inertial.mode_acceleration, k, mode["acceleration"]),
            mode_rate=_with(inertial.mode_rate, k, math.radians(mode["rate"])),
        )
    if "filters" in conditions:
        filters = conditions["filters"]
        stages = [(FILTER_KINDS[s["type"]], s["cutoff"]) for s in filters["gyro"]] + 2 * [(NO_FILTER, 0.0)]
        inertial = inertial._replace(
            gyro_kind_1=stages[0][0],
            gyro_cut_1=stages[0][1],
            gyro_kind_2=stages[1][0],
            gyro_cut_2=stages[1][1],
            acc_kind=BIQUAD if filters["firmware"] < "4.3" else PT2,
            acc_cut=filters["accelerometer"],
        )
        setup = setup._replace(firmware=filters["firmware"])
    if "airframe" in conditions:
        airframe, p = conditions["airframe"], vehicle.physics
        more = airframe["flapping"]
        physics = p._replace(
            thrust_exponent=airframe["thrust exponent"],
            disc_tilt=p.disc_tilt * more,
            flapping_moment=p.flapping_moment * more,
            flapping_damping=p.flapping_damping * more,
        )
        vehicle = vehicle._replace(physics=physics)
    return setup._replace(inertial=inertial, vehicle=vehicle)


def _with(array: np.ndarray, k: int, value: float) -> np.ndarray:
    changed = array.copy()
    changed[k] = value
    return changed


BURST = 3.0  # packets lost in a row, mean; radio and timing faults come in bursts


def packet_faults(packets: int, losses: Mapping[str, float], rng: np.random.Generator) -> np.ndarray:
    """What happens to each packet of each rotor's telemetry, (packets, 4) of 0, LOST or REPEATED_PACKET.

    Losses come in bursts of geometric length (mean BURST) at the stated share; repetitions come alone.
    """
    faults = np.zeros((packets, 4), np.int8)
    share = losses["lost"]
    for rotor in range(4):
        faults[rng.random(packets) < losses["repeated"], rotor] = REPEATED_PACKET
        if share > 0.0:
            # lengths of alternating spans, good and lost, both geometric
            good = BURST * (1.0 - share) / share
            rounds = int(packets / (good + BURST) * 2.0) + 50
            spans = np.column_stack([rng.exponential(good, rounds), rng.geometric(1.0 / BURST, rounds)])
            lost = np.repeat(np.tile([0, 1], rounds), np.rint(spans).astype(int).ravel())[:packets]
            faults[: len(lost)][lost > 0, rotor] = LOST
    return faults
