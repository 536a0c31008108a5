"""Rotor speeds from motor commands: a static map of command and battery voltage, a delay, a first-order lag.

    dW/dt = (wanted(t - delay) - W) / tau,    wanted_i = S_i f(c_i, V / V_ref)

S_i is the speed of rotor i at the operating command and the reference voltage, so f is 1 there. With c0 the operating
command, v = V / V_ref and n the voltage exponent, the forms of f are given below. Where a map has a warm-up, wanted_i
is multiplied by 1 + d (1 - h_i): h_i is c_i / c0 behind a lag of seconds, 0 for cold motors and 1 for warm ones.

    linear        v^n (1 + b (c / c0 - 1))
    square root   v^n sqrt(1 + b (c / c0 - 1)), a thrust that is linear in the command
    polynomial    v^n (1 + b (c / c0 - 1) + d (c / c0 - 1)^2), as maps on measured speeds are
    quadratic     1 + b (z - 1) + d (z - 1)^2 with z = v^n c / c0: duty times volts where n = 1
    thrust map    sqrt((1 - sqrt(1 - k z)) / (1 - sqrt(1 - k))), volts that are a quadratic of the thrust
    speed         the command is a speed already (rad/s); f is v^n c / c0

Source: the thrust map inverts the battery compensation of the Crazyflie firmware (volts = a T - b T^2 per motor); the
others are steady states of a DC motor with a propeller, linearised or not.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from quasi.errors import DataError

ROTOR_NUMBERS = range(1, 5)
LAG_FACTORS = tuple(f"rotor{i} lag factor" for i in ROTOR_NUMBERS)  # in extensions: on the time constants of one
WAYS_RATIO = "down over up"  # in extensions: time constant of slowing down over that of speeding up
LOW_VOLTAGE = 0.1  # of a reference voltage, below which a reading is none
STEADY_VOLTAGE = 0.01  # std over median of the voltage, below which a battery gives no exponent
SPEEDS = tuple(f"w{i}" for i in ROTOR_NUMBERS)
SHARES = tuple(f"command{i}" for i in ROTOR_NUMBERS)
COMMANDED = tuple(f"w{i}_CMD" for i in ROTOR_NUMBERS)
RAW = "_raw"  # ending of columns that the filter keeps without its low-pass, where rotor speeds are to be estimated
TAU_RANGE = (0.002, 0.5)  # s, of a time constant
DELAY_RANGE = (-0.025, 0.1)  # s; negative where commands are logged late
EXPONENT_RANGE = (-1.0, 3.0)  # of the voltage; 0 with ideal battery compensation, 1 for duty times volts


WARM_UP_NAMES = ("warm-up drop", "warm-up time constant")  # of a map: share of the speed that cold motors have more, s
DROP_RANGE = (0.0, 0.3)  # motors lose speed as they warm; copper gains 30 % of resistance over 75 K
# s. Faster changes look like those of the battery. On nanobench, R2 of vertical force with one flight left out is
# highest at 8 s, and level from 4 to 30 s
WARM_UP_RANGE = (5.0, 60.0)


class Form(NamedTuple):
    """Shape parameters of a map: names, starting values, bounds; speed(c / c0, v, n, parameters)."""

    names: tuple[str, ...]
    start: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


# Bounds: a speed falls with its command nowhere, and no form is steeper than a thrust that grows with the command
# cubed (slope 1.5 of the speed).
FORMS = {
    "linear": Form(("slope",), (0.7,), (0.05,), (1.5,)),
    "square root": Form(("slope",), (1.0,), (0.1,), (3.0,)),
    "polynomial": Form(("slope", "curvature"), (0.7, 0.0), (0.05, -1.0), (1.5, 1.0)),
    "quadratic": Form(("slope", "curvature"), (0.7, 0.0), (0.05, -1.0), (1.5, 1.0)),
    "thrust map": Form(("saturation",), (0.5,), (0.01,), (0.98,)),
    "speed": Form((), (), (), ()),
}
_VALUE_RANGES = {"time constant": TAU_RANGE, "delay": DELAY_RANGE, "voltage exponent": EXPONENT_RANGE}
_VALUE_RANGES |= dict(zip(WARM_UP_NAMES, (DROP_RANGE, WARM_UP_RANGE)))


def ranges_of(form: str, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Bounds low and high (p,) of parameters of a map; names  of its shape and of what all forms have."""
    about = FORMS[form]
    known = _VALUE_RANGES | dict(zip(about.names, zip(about.low, about.high)))
    low, high = np.array([known[name] for name in names], float).T
    return low, high


def shape(form: str, share: np.ndarray, ratio: np.ndarray | float, exponent: float, parameters: Any) -> np.ndarray:
    """f of the module's head: steady speed over that at the operating point.

    share  (N, R) command over the operating command; ratio (N, 1) voltage over the reference, or 1.0; parameters  of
    the form, in the order of FORMS
    """
    factor = np.maximum(ratio, 0.0) ** exponent
    if form == "linear":
        return factor * np.maximum(1.0 + parameters[0] * (share - 1.0), 0.0)
    if form == "square root":
        return factor * np.sqrt(np.maximum(1.0 + parameters[0] * (share - 1.0), 0.0))
    if form == "polynomial":
        change = share - 1.0
        return factor * np.maximum(1.0 + parameters[0] * change + parameters[1] * change**2, 0.0)
    z = factor * share
    if form == "quadratic":
        return np.maximum(1.0 + parameters[0] * (z - 1.0) + parameters[1] * (z - 1.0) ** 2, 0.0)
    if form == "thrust map":
        k = parameters[0]
        thrust = (1.0 - np.sqrt(np.clip(1.0 - k * np.maximum(z, 0.0), 0.0, 1.0))) / (1.0 - np.sqrt(1.0 - k))
        return np.sqrt(thrust)
    return np.maximum(z, 0.0)


def voltage_elasticity(drive: Mapping[str, Any]) -> float:
    """d ln W / d ln V at the operating command over the map's exponent; 1 unless voltage acts on the command."""
    parameters = [drive["parameters"][name]["value"] for name in FORMS[drive["form"]].names]
    step, one = 1e-4, np.ones((1, 1))
    ends = [float(shape(drive["form"], one, one + sign * step, 1.0, parameters)[0, 0]) for sign in (1, -1)]
    return (ends[0] - ends[1]) / (2.0 * step)


def speed_exponent(drive: Mapping[str, Any]) -> float:
    """Exponent of the voltage that the steady speed follows at the operating command; 0 for a map without voltage."""
    return drive["voltage exponent"]["value"] * voltage_elasticity(drive) if drive["voltage exponent"] else 0.0


def cold_surplus(share: np.ndarray, dt: float, drop: float, tau: float) -> np.ndarray:
    """Speed (N, R) over that of warm motors: 1 + drop (1 - h), where h is the share behind a lag of tau, s.

    share  (N, R) command over the operating command, in steps of dt, s. A log that begins with motors at rest begins
    with cold motors; one that begins in flight begins at the steady state of its first command.

    A winding that warms gains resistance, and the motor loses speed at the same command and voltage.
    Source: Hughes & Drury, Electric Motors and Drives, 5th ed., 2019, chapter 3.
    """
    return 1.0 + drop * (1.0 - lagged(share, dt, tau, 0.0))


def lagged(wanted: np.ndarray, dt: float, tau: float | np.ndarray, delay: float) -> np.ndarray:
    """What follows wanted (N, R) late by `delay`, s, and with a first-order lag, s; linear between samples.

    tau  s, of all or of each (R,)
    """
    if np.ndim(tau):
        return np.stack([lagged(w, dt, each, delay) for w, each in zip(wanted.T, tau, strict=True)], axis=1)
    keep, share = np.exp(-dt / tau), dt / tau
    last = 1.0 - (1.0 - keep) / share
    first = (1.0 - keep) / share - keep
    late = delayed(wanted, dt, delay)
    start = (1.0 - last) * late[:1]
    return lfilter([last, first], [1.0, -keep], late, axis=0, zi=start)[0]


def delayed(values: np.ndarray, dt: float, delay: float) -> np.ndarray:
    """values (N, R) at times earlier by `delay`, s, by cubics through four samples; the ends are held.

    Straight lines would damp fast commands most where the delay lies between samples, and draw an estimate of the delay
    to whole samples. Source: Laakso et al., Splitting the unit delay, IEEE Signal Processing Magazine 13, 1996.
    """
    whole = int(np.floor(delay / dt))
    x = delay / dt - whole  # 0 to 1, back in time from the sample `whole` steps ago
    weights = {
        -1: -x * (x - 1.0) * (x - 2.0) / 6.0,
        0: (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
        1: -(x + 1.0) * x * (x - 2.0) / 2.0,
        2: (x + 1.0) * x * (x - 1.0) / 6.0,
    }
    count = len(values)
    held = values[np.clip(np.arange(-2, count + 1) - whole, 0, count - 1)]  # from two samples earlier to one later
    return sum(w * held[2 - k : 2 - k + count] for k, w in weights.items())


def steady_speeds(drive: Mapping[str, Any], commands: np.ndarray, volts: np.ndarray | None = None) -> np.ndarray:
    """Speeds (N, 4), rad/s, at which the rotors settle for constant commands, with warm motors.

    drive     section "rotor speeds" of a model; commands (N, 4) as its "input" says: shares 0 to 1, or rad/s
    volts     (N,) V; None takes the reference voltage
    Raises DataError where commands or volts hold what is no number.
    """
    commands = np.asarray(commands, float)
    if not np.isfinite(commands).all():
        raise DataError("commands must be finite numbers")
    exponent, ratio = 0.0, 1.0
    if drive["voltage exponent"] is not None and volts is not None:
        volts = np.asarray(volts, float)
        if not np.isfinite(volts).all():
            raise DataError("the battery voltage must be finite numbers")
        exponent, ratio = drive["voltage exponent"]["value"], volts[:, None] / drive["reference voltage"]
    parameters = [drive["parameters"][name]["value"] for name in FORMS[drive["form"]].names]
    if drive["input"] == "share":
        commands = np.clip(commands, 0.0, 1.0)
    share = commands / drive["operating command"]
    return np.asarray(drive["speeds"]["value"]) * shape(drive["form"], share, ratio, exponent, parameters)


def speeds_of(drive: Mapping[str, Any], commands: np.ndarray, volts: np.ndarray | None, dt: float) -> np.ndarray:
    """Rotor speeds (N, 4), rad/s, of commands in even steps of dt, s, from the steady state of the first.

    Arguments as `steady_speeds`.
    """
    wanted = commanded_speeds(drive, commands, volts, dt)
    return lagged(wanted, dt, drive["time constant"]["value"], drive["delay"]["value"])


def commanded_speeds(drive: Mapping[str, Any], commands: np.ndarray, volts: np.ndarray | None, dt: float) -> np.ndarray:
    """Speeds (N, 4), rad/s, that the rotors follow: `steady_speeds` of motors that warm up. Arguments as there."""
    wanted = steady_speeds(drive, commands, volts)
    drop, tau = (drive.get(name) for name in WARM_UP_NAMES)
    if not drop:
        return wanted
    commands = np.asarray(commands, float)
    commands = np.clip(commands, 0.0, 1.0) if drive["input"] == "share" else commands
    return wanted * cold_surplus(commands / drive["operating command"], dt, drop["value"], tau["value"])


def drive_of_map(actuators: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """The section "actuators" of a model on measured speeds as a drive of this module; None without its "command map".

    The operating command is the middle of the range; one lag and one map stand for the four rotors.
    """
    held = (actuators or {}).get("command map")
    lags, late = (actuators or {}).get("time constants"), (actuators or {}).get("delay")
    if not held or not lags:
        return None
    coefficients = dict(zip(held.get("powers", range(len(held["coefficients"]))), held["coefficients"]))
    if set(coefficients) - {0, 1, 2}:
        return None
    a0, a1, a2 = (float(coefficients.get(k, 0.0)) for k in range(3))
    half = 0.5
    speed = a0 + a1 * half + a2 * half**2
    if not speed > 0.0:
        return None
    exponent, reference = held.get("voltage exponent"), held.get("reference voltage")
    exponent = exponent if isinstance(exponent, Mapping) else {"value": exponent}
    return {
        "source": "commands",
        "input": "share",
        "form": "polynomial",
        "parameters": {
            "slope": {"value": (a1 * half + 2.0 * a2 * half**2) / speed},
            "curvature": {"value": a2 * half**2 / speed},
        },
        "operating command": half,
        "reference voltage": reference,
        "voltage exponent": exponent if exponent.get("value") and reference else None,
        "speeds": {"value": [speed] * 4, "unit": "rad/s"},
        "time constant": {"value": float(np.mean(lags["value"])), "unit": "s"},
        "delay": {"value": float(np.mean(late["value"])) if late else 0.0, "unit": "s"},
    }


def describe_map(document: Mapping[str, Any]) -> list[str]:
    """Sentences on rotor speeds that are estimated from commands; [] for a model on measured speeds."""
    drive = document.get("rotor speeds")
    if not drive:
        return []
    error = drive["relative error"]
    between = error.get("between flights")
    parts = f"{100 * error['map']:.2g} % by the map"
    parts += f", {100 * between:.2g} % from flight to flight" if between is not None else ""
    sentences = [
        f"Rotor speeds estimated from commands, +- {100 * error['total']:.2g} % ({parts}): {drive['form']} map, time "
        f"constant {1e3 * drive['time constant']['value']:.1f} ms, delay {1e3 * drive['delay']['value']:.1f} ms"
    ]
    if drive["voltage exponent"]:
        sentences[0] += f", voltage exponent {drive['voltage exponent']['value']:.2f}"
    if drive.get("warm-up drop"):
        drop, tau = (drive[name]["value"] for name in WARM_UP_NAMES)
        sentences[0] += f", {100 * drop:.1f} % faster with cold motors, which warm up in {tau:.0f} s"
    if drive["scale"]["relative"]:
        sentences.append(f"Rotor speeds are relative; their scale is fixed by a {drive['scale']['from']}")
    else:
        sentences.append(f"The scale of the rotor speeds is that of the {drive['scale']['from']}")
    if drive.get("yaw"):
        sentences.append(
            f"The rotors' own time constant, by yaw moments, is {1e3 * drive['yaw']['time constant']['value']:.1f} ms; "
            "the lag of thrust differs, because air follows the blades late"
        )
    if drive.get("factors"):
        roll, pitch = (drive["factors"][axis] for axis in ("Mx", "My"))
        sentences.append(
            f"Arms by roll and pitch moments over those configured: {roll['value']:.2f} +- {roll['std']:.2f}, "
            f"{pitch['value']:.2f} +- {pitch['std']:.2f}"
        )
        if roll.get("between flights") is not None:
            sentences[-1] += f"; std between flights {roll['between flights']:.2f}, {pitch['between flights']:.2f}"
    return sentences


def raw_commands(table: pd.DataFrame, kind: str) -> np.ndarray | None:
    """Commands (N, 4) of a filtered flight as logged; kind "share" or "speed". None where it keeps none."""
    names = [f"{n}{RAW}" for n in (SHARES if kind == "share" else COMMANDED)]
    return table[names].to_numpy(float) if all(n in table for n in names) else None


def raw_volts(table: pd.DataFrame) -> np.ndarray | None:
    """Battery voltage (N,), V, of a filtered flight; None where it was not logged."""
    return table["battery_voltage"].to_numpy(float) if "battery_voltage" in table else None


def used_rows(table: pd.DataFrame) -> np.ndarray:
    """True (N,) in the rows of a filtered flight that are valid and in flight."""
    rows = np.ones(len(table), bool)
    for flag in ("valid", "in_flight"):
        if flag in table:
            rows &= table[flag].to_numpy(float) > 0.5
    return rows
