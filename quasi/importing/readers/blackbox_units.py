"""From the raw numbers of a flight controller's log to SI quantities in body axes FRD.

Betaflight's body axes are x forward, y left, z up; so p = gx, q = -gy, r = -gz, and likewise for specific force and
set-points. INDIflight logs FRD already.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from quasi.airframe import DEFAULT_POLES, erpm100_to_rad_s
from quasi.attitude import GRAVITY
from quasi.errors import add_caution, quoted
from quasi.importing.readers.blackbox_header import hex_float, is_other_firmware, version

_AXIS_INDICES = range(3)
_MOTORS = range(8)
DEG = math.pi / 180.0
STANDARD_ACC_1G = 2048.0
QUATERNION_FULL = 32767.0  # Betaflight: x y z as 16-bit fractions, w positive
INDI_QUATERNION_FULL = 8127.0  # INDIflight: (127 << 6) - 1
FEATURE_3D = 1 << 12
# main fields that carry a quantity of ours
WANTED = {
    *(
        f"{name}[{i}]"
        for name in ("gyroADC", "accSmooth", "imuQuaternion", "setpoint", "extPos", "extVel", "pos", "vel")
        for i in _AXIS_INDICES
    ),
    *(f"{name}[{i}]" for name in ("gyroADCafterRpm", "accADCafterRpm") for i in _AXIS_INDICES),
    *(f"{name}[{i}]" for name in ("motor", "eRPM", "omega", "omegaUnfiltered") for i in _MOTORS),
    *(f"{name}[{i}]" for name in ("debug", "quat") for i in range(4)),
    "setpoint[3]",
    "rcCommand[3]",
    "vbatLatest",
    "amperageLatest",
}


@dataclass
class Resolved:
    """Quantities in SI units with what was assumed: values {quantity: (n,)}, about (plain data), notes (sentences).

    external  captured position and velocity as the log repeats them in every row: see `external.external_series`
    """

    values: dict[str, np.ndarray] = field(default_factory=dict)
    external: dict[str, np.ndarray] = field(default_factory=dict)
    about: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def debug_mode(header: Mapping[str, str]) -> dict[str, Any] | None:
    """Number and, where this reader uses it, name of the debug mode of a log: what debug[0..] hold.

    The numbers follow the firmware version: DSHOT_RPM_TELEMETRY is 45 from Betaflight 4.1 to 4.5 and in 2025.12; builds
    of 4.0 with two more dual-gyro modes have it at 47. Source: the tables of the crate blackbox-log (MIT, Apache-2.0).
    """
    text = header.get("debug_mode")
    if text is None or not re.fullmatch("-?[0-9]{1,9}", text):
        return None
    number, release = int(text), version(header)
    if is_other_firmware(header):
        return {"number": number, "name": ""}  # each firmware numbers its modes in its own way
    rpm = 47 if release is not None and release < (4, 1) else 45
    name = {0: "NONE", rpm: "DSHOT_RPM_TELEMETRY", rpm + 1: "RPM_FILTER"}.get(number, "")
    return {"number": number, "name": name}


def other_firmware_note(header: Mapping[str, str]) -> str | None:
    """A sentence that calls for care where a log comes from a firmware that this reader does not know; else None."""
    if not is_other_firmware(header):
        return None
    return (
        f"the log was written by {quoted(header['Firmware revision'])}, neither Betaflight nor INDIflight; it is read "
        "as Betaflight's, and its debug fields are left out: check units, body axes, rotor numbers and motor range"
    )


def is_indiflight(header: Mapping[str, str], names: set[str]) -> bool:
    """Whether a log comes from INDIflight, whose body axes are FRD."""
    return "indiflight" in header.get("Firmware revision", "").lower() or "quat[0]" in names or "omega[0]" in names


def resolve(
    raw: dict[str, np.ndarray],
    header: Mapping[str, str],
    poles: int | None,
    known: Mapping[str, tuple[float, str]] | None = None,
) -> Resolved:
    """Turn raw main fields into quantities; the arrays are scaled in place.

    raw     {field: (n,) float}, numbers as logged
    header  the log's header; what it lacks is assumed and noted
    poles   the configured number of motor magnets, or None
    known   {"gyro", "accelerometer", "rotor speed", "battery voltage", "battery current": (factor to SI, source)} where
            the numbers carry their own unit, which then counts instead of the header
    """
    out = Resolved()
    known = known or {}
    indi = is_indiflight(header, set(raw))
    sign = (1.0, 1.0, 1.0) if indi else (1.0, -1.0, -1.0)
    out.about["body axes logged"] = "x forward, y right, z down" if indi else "x forward, y left, z up"
    out.about["units"] = {}
    fine = _resolution(raw, header, out)
    if indi:
        # the firmware's own units, where the log comes without its header
        header = {"gyro_scale": "1", "acc_1G": f"{STANDARD_ACC_1G:g}"} | dict(header)
    _gyro(raw, header, sign, fine, known, out)
    _acceleration(raw, header, sign, known, out)
    for i, rate in enumerate("pqr"):
        if f"setpoint[{i}]" in raw:
            out.values[f"setpoint_{rate}"] = _scaled(raw[f"setpoint[{i}]"], sign[i] * DEG / fine)
            out.about["units"]["setpoint"] = {"factor": DEG / fine, "to": "rad/s"}
    _attitude(raw, out)
    _motors(raw, header, out)
    _rotor_speeds(raw, header, poles, known, out)
    _battery(raw, header, known, out)
    if "setpoint[3]" in raw:
        out.values["throttle"] = _scaled(raw["setpoint[3]"], 1e-3 / fine)
    elif "rcCommand[3]" in raw:
        throttle = _scaled(raw["rcCommand[3]"], 1e-3 / fine)
        throttle -= 1.0
        out.values["throttle"] = throttle
    for i, axis in enumerate("xyz"):
        for prefix, values in (("", out.values), ("ext", out.external)):
            place, speed = (f"{prefix}{name}[{i}]" for name in (("Pos", "Vel") if prefix else ("pos", "vel")))
            if place in raw:
                values[axis] = _scaled(raw[place], 1e-3)
            if speed in raw:
                values[f"v{axis}"] = _scaled(raw[speed], 1e-2)
    return out


def _resolution(raw: Mapping[str, np.ndarray], header: Mapping[str, str], out: Resolved) -> float:
    """10 for a high-resolution log (gyro, set-points and sticks in tenths), else 1: by its throttle, then its header.

    rcCommand[3] lies between 1000 and 2000, ten times that in high resolution (Betaflight 4.3 on).
    """
    stated = (hex_float(header.get("blackbox_high_resolution")) or 0) > 0
    throttle = raw.get("rcCommand[3]", np.zeros(0))
    throttle = throttle[np.isfinite(throttle)]
    middle = float(np.median(throttle)) if len(throttle) else 0.0
    shown = True if 9_000 <= middle <= 21_000 else False if 900 <= middle <= 2_100 else None
    if shown is None or shown == stated:
        return 10.0 if stated else 1.0
    if shown and "blackbox_high_resolution" not in header:
        out.notes.append(
            f"a log of high resolution: rcCommand[3] is typically {middle:.0f}, where 1000 to 2000 is usual; gyro, "
            "set-points and throttle were divided by 10"
        )
    else:
        add_caution(
            out.notes,
            f"rcCommand[3] is typically {middle:.0f}, but the header's blackbox_high_resolution is "
            f"{quoted(header.get('blackbox_high_resolution', ''))}; gyro, set-points and throttle are scaled by the "
            "former",
        )
    out.about["high resolution"] = shown
    return 10.0 if shown else 1.0


def _scaled(values: np.ndarray, factor: float) -> np.ndarray:
    values *= factor
    return values


def _gyro(raw, header, sign, fine, known, out: Resolved) -> None:
    name = "gyroADCafterRpm" if "gyroADCafterRpm[0]" in raw else "gyroADC"
    if f"{name}[0]" not in raw:
        out.notes.append("the log holds no gyro (gyroADC); body rates are missing")
        return
    key = "gyro_scale" if "gyro_scale" in header else "gyro.scale"
    scale = hex_float(header.get(key))
    if "gyro" not in known and (scale is None or not 0 < scale < 1e4):
        add_caution(
            out.notes, f"the header's gyro_scale is {quoted(header.get(key, ''))}; 1 deg/s per count is assumed"
        )
        scale = 1.0
    if "gyro" in known:
        factor, source = known["gyro"]
        if fine > 1.0 and not _is_scaled(raw, name, factor / DEG):
            # blackbox_decode prints the tenths of a high-resolution log as whole deg/s
            factor, source = factor / fine, f"{source}, divided by 10"
    elif scale < 1e-5:
        # firmware before Betaflight 3.1 states rad/us per count
        factor, source = scale * 1e6, "header, rad/us"
    else:
        # high resolution logs ten times deg/s; a scale of 0.1 would say so already
        factor, source = scale * DEG / (fine if scale > 0.5 else 1.0), "header, deg/s"
    out.about["units"]["gyro"] = {"factor": factor, "to": "rad/s", "source": source, "field": name}
    fastest = 0.0
    for i, rate in enumerate("pqr"):
        if f"{name}[{i}]" in raw:
            values = _scaled(raw[f"{name}[{i}]"], sign[i] * factor)
            out.values[rate] = values
            fastest = max(fastest, float(np.nanmax(np.abs(values), initial=0.0)))
    if fastest > 4500 * DEG:
        out.notes.append(
            f"body rates reach {fastest / DEG:.0f} deg/s, beyond any gyro; the header's gyro_scale contradicts the data"
        )


def _is_scaled(raw: Mapping[str, np.ndarray], name: str, to_deg: float) -> bool:
    """Whether a decoder took the tenths of a high-resolution gyro into account: by its gain on set-points in tenths."""
    both = power = 0.0
    for i in _AXIS_INDICES:
        if f"setpoint[{i}]" in raw and f"{name}[{i}]" in raw:
            rate, setpoint = to_deg * raw[f"{name}[{i}]"], raw[f"setpoint[{i}]"]
            fine = np.isfinite(rate) & np.isfinite(setpoint)
            both += float(rate[fine] @ setpoint[fine])
            power += float(setpoint[fine] @ setpoint[fine])
    # the gyro follows the set-point: gain 1 where both are in tenths, 0.1 where the gyro is in deg/s; between lies 0.3
    return power > 0 and 0.03 < both / power < 0.3


def _acceleration(raw, header, sign, known, out: Resolved) -> None:
    name = "accADCafterRpm" if "accADCafterRpm[0]" in raw else "accSmooth"
    if f"{name}[0]" not in raw:
        out.notes.append("the log holds no accelerometer (accSmooth); specific forces are missing")
        return
    if "accelerometer" in known:
        factor, source = known["accelerometer"]
    else:
        one, source = hex_float(header.get("acc_1G")), "acc_1G"
        if one is None or not 0 < one < 1e6:
            add_caution(
                out.notes, f"the header's acc_1G is {quoted(header.get('acc_1G', ''))}; 2048 counts per g are assumed"
            )
            one, source = STANDARD_ACC_1G, "assumed"
        factor = GRAVITY / one
    out.about["units"]["accelerometer"] = {"factor": factor, "to": "m/s2", "source": source, "field": name}
    square = 0.0
    for i, axis in enumerate("xyz"):
        if f"{name}[{i}]" in raw:
            values = _scaled(raw[f"{name}[{i}]"], sign[i] * factor)
            out.values[f"a{axis}"] = values
            square = square + values[:: max(1, len(values) // 2000)] ** 2
    typical = float(np.sqrt(np.nanmedian(square))) / GRAVITY if np.any(np.isfinite(square)) else 1.0
    if not 0.2 < typical < 5.0:
        out.notes.append(f"the specific force is typically {typical:.3g} g; the header's acc_1G contradicts the data")


def _attitude(raw, out: Resolved) -> None:
    if all(f"imuQuaternion[{i}]" in raw for i in _AXIS_INDICES):
        x, y, z = (_scaled(raw[f"imuQuaternion[{i}]"], 1.0 / QUATERNION_FULL) for i in _AXIS_INDICES)
        w = np.sqrt(np.clip(1.0 - x * x - y * y - z * z, 0.0, None))
        # from x north, y west, z up and x forward, y left, z up: half a turn about x on both sides
        q = [w, x, -y, -z]
        source = "imuQuaternion"
    elif all(f"quat[{i}]" in raw for i in range(4)):
        q = [_scaled(raw[f"quat[{i}]"], 1.0 / INDI_QUATERNION_FULL) for i in range(4)]
        source = "quat"
    else:
        return
    length = np.sqrt(sum(c * c for c in q))
    length[length < 0.5] = np.nan
    for name, component in zip(("qw", "qx", "qy", "qz"), q):
        out.values[name] = component / length
    out.about["attitude"] = f"estimated on board, field {source}"


def _motors(raw, header, out: Resolved) -> None:
    motors = [i for i in _MOTORS if f"motor[{i}]" in raw]
    if not motors:
        return
    low, high, source = None, None, "motorOutput"
    for low_key, high_key in (("motorOutput", "motorOutput"), ("minthrottle", "maxthrottle")):
        low = hex_float(header.get(low_key, "").split(",")[0] or None)
        high = hex_float(header.get(high_key, "").split(",")[-1] or None)
        if low is not None and high is not None and high > low:
            source = low_key if low_key == high_key else f"{low_key}, {high_key}"
            break
    else:
        out.notes.append("the header states no motor output range; commands are missing")
        return
    if source != "motorOutput":
        out.notes.append(f"the header lacks motorOutput; commands are scaled by {source} ({low:g} to {high:g})")
    features = hex_float(header.get("features")) or 0.0
    three = bool(int(features) & FEATURE_3D)
    if three:
        out.notes.append("the 3D (reversible motors) feature is on; commands are scaled linearly over the whole range")
    out.about["units"]["motor"] = {"low": low, "high": high, "to": "1", "source": source, "3D": three}
    for i in motors:
        values = raw[f"motor[{i}]"]
        values -= low
        values /= high - low
        out.values[f"command{i + 1}"] = values
    below = np.mean([np.mean(out.values[f"command{i + 1}"] < -0.002) for i in motors]) if len(values) else 0.0
    if below > 0:
        out.notes.append(
            f"motor values lie below the output range in {100 * below:.3g} % of the samples (motors stopped)"
        )


def _rotor_speeds(raw, header, poles: int | None, known, out: Resolved) -> None:
    mode = debug_mode(header)
    if mode is not None:
        out.about["debug mode"] = mode
    if "omegaUnfiltered[0]" in raw or "omega[0]" in raw:
        name = "omegaUnfiltered" if "omegaUnfiltered[0]" in raw else "omega"
        # the firmware has room for eight; places without a motor stay at zero
        turning = [i for i in _MOTORS if f"{name}[{i}]" in raw and (i < 4 or np.nanmax(raw[f"{name}[{i}]"]) > 0)]
        _speeds(raw, name, turning, 1.0, name, out)
        out.about["motor poles"] = {"value": None, "source": "not needed, the log holds mechanical speeds"}
        return
    if "eRPM[0]" in raw:
        name, motors = "eRPM", _MOTORS
    elif mode is not None and mode["name"] == "DSHOT_RPM_TELEMETRY" and "debug[0]" in raw:
        name, motors = "debug", range(4)
        out.notes.append(f"rotor speeds come from the debug fields (debug mode {mode['number']}, DSHOT_RPM_TELEMETRY)")
    else:
        out.notes.append("the log holds no rotor speeds (no eRPM fields, debug mode is not DSHOT_RPM_TELEMETRY)")
        return
    if "rotor speed" in known:
        factor, source = known["rotor speed"]
        if poles is None:
            out.about["motor poles"] = {"value": None, "source": "not needed, the log holds mechanical speeds"}
        _speeds(raw, name, motors, factor, source, out)
        return
    logged = hex_float(header.get("motor_poles"))
    if poles is not None:
        count, source = int(poles), "configuration"
        if logged is not None and int(logged) != count:
            out.notes.append(
                f"the header states {int(logged)} motor poles, the configuration {count}; the latter is used"
            )
    elif logged is not None and 2 <= logged <= 254:
        count, source = int(logged), "header"
        if count == DEFAULT_POLES:
            out.notes.append("the header's 14 motor poles are Betaflight's default, which few change; check the motors")
    else:
        count, source = DEFAULT_POLES, "assumed"
        add_caution(out.notes, "warning: neither configuration nor header state the motor poles; 14 are assumed")
    out.about["motor poles"] = {"value": count, "source": source}
    _speeds(raw, name, motors, erpm100_to_rad_s(count), name, out)


def _speeds(raw, name: str, motors, factor: float, source: str, out: Resolved) -> None:
    out.about["units"]["rotor speed"] = {"factor": factor, "to": "rad/s", "source": source}
    for i in motors:
        if f"{name}[{i}]" in raw:
            out.values[f"w{i + 1}"] = _scaled(raw[f"{name}[{i}]"], factor)


def _battery(raw, header, known, out: Resolved) -> None:
    if "vbatLatest" in raw:
        # the cell limits stand in the header in the unit of the log: 330,350,430 = 0.01 V, 33,35,43 = 0.1 V
        cell = hex_float(header.get("vbatcellvoltage", "").split(",")[-1] or None)
        release = version(header)
        if "battery voltage" in known:
            factor, source = known["battery voltage"]
        elif cell is not None and cell > 0:
            factor, source = (0.01 if cell > 100 else 0.1), "vbatcellvoltage"
        elif release is not None:
            factor, source = (0.01 if release >= (4, 0) else 0.1), "firmware version"
        else:
            factor, source = 0.01, "assumed"
        out.about["units"]["battery voltage"] = {"factor": factor, "to": "V", "source": source}
        out.values["battery_voltage"] = _scaled(raw["vbatLatest"], factor)
    if "amperageLatest" in raw:
        factor, source = known.get("battery current", (0.01, "Betaflight"))
        out.about["units"]["battery current"] = {"factor": factor, "to": "A", "source": source}
        out.values["battery_current"] = _scaled(raw["amperageLatest"], factor)
