"""Gains of Betaflight and PX4 that give the loop of quasi's PID controller, computed from the model. Not flown.

quasi's PID controller asks for angular accelerations (error + integral / T_i - T_d slope of the rate) / T. A flight
controller asks for a share of its output range instead; what this share does to the vehicle comes from the model.

PX4: a torque set-point is spread by the pseudo-inverse of the rotors' moments at full thrust, scaled so that roll and
pitch columns have a norm of sqrt(rotors / 2) at most and the largest entry of yaw is 1; THR_MDL_FAC makes thrust linear
in the output. Source: PX4's control allocation (ControlAllocationPseudoInverse) and parameter reference (MC_*).
Betaflight: the sum of the terms over 1000 is added to or taken off each motor's share of its output range; P, I and D
in the configurator's units are scaled by PTERM_SCALE, ITERM_SCALE and DTERM_SCALE, with errors in deg/s; the angle
mode's set-point is level P / 10 x the error. Source: constants of Betaflight 4.x.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from quasi.errors import DataError
from quasi.model.extensions import drive_of
from quasi.model.model import Model
from quasi.simulation.control.control_model import ControlModel, make_control_model, use_geometric_mixer
from quasi.simulation.control.gains import complete_settings
from quasi.simulation.control.registry import PID, find_law
from quasi.simulation.loop.setup import Setup
from quasi.simulation.tools.margins import Margins, actuators_of_setup, compute_margins

PTERM_SCALE, ITERM_SCALE, DTERM_SCALE = 0.032029, 0.244381, 0.000529  # Betaflight 4.x, per deg/s
PID_MIXER_SCALING = 1000.0  # Betaflight: sum of the terms that takes a motor through its whole range
LEVEL_SCALE = 10.0  # Betaflight: level P over the rate set-point per angle, 1/s
MOST_BETAFLIGHT = 250  # largest P, I or D that the configurator takes
FIRMWARE_AXES = ("roll", "pitch", "yaw")


class FirmwareGains(NamedTuple):
    """Gains by axis roll, pitch, yaw.

    px4         {"P", "I", "D", "attitude P": (3,)} of MC_*RATE_P, _I, _D and MC_*_P, or None where the highest rotor
                speed is unknown
    betaflight  {"P", "I", "D": (3,)} in the configurator's units, and "level P" one number
    margins     of the loop that they give; notes: what was assumed
    """

    px4: dict[str, np.ndarray] | None
    betaflight: dict[str, Any]
    margins: Margins
    notes: tuple[str, ...]


def firmware_gains(
    settings: Mapping[str, Any], model: Model, dt: float, actuators: Mapping[str, Any] | None = None
) -> FirmwareGains:
    """Gains that give quasi's PID loop on this model, and its margins.

    settings, actuators  as for `compute_margins`; another controller than PID is replaced by PID with its default gains
    dt                   s, of the loop
    Raises DataError for a model whose command map does not rise at hover, and what `compute_margins` raises.
    """
    asked = dict(settings) if find_law(settings.get("controller", "INDI")) is PID else {"controller": "PID"}
    asked["time step"] = dt
    known = use_geometric_mixer(make_control_model(model, actuators))
    settled = complete_settings(asked, known)["gains"]
    slope, notes = command_slope(model, known)
    rates, attitude = settled["rates"], settled["attitude"]
    constants = np.array([rates["time constant"]] * 2 + [rates["yaw time constant"]])
    # share of the output per rad/s: what makes an angular acceleration of 1 / T
    betaflight = 1.0 / (constants * betaflight_effect(known, slope)) * PID_MIXER_SCALING * math.pi / 180.0
    integral = 1.0 / rates["integral time"] if rates["integral time"] > 0.0 else 0.0
    derivative = rates["derivative time"]
    found_betaflight = {
        "P": betaflight / PTERM_SCALE,
        "I": betaflight * integral / ITERM_SCALE,
        "D": betaflight * derivative / DTERM_SCALE,
        "level P": LEVEL_SCALE / attitude["time constant"],
    }
    px4, full = None, _full_speed(model, known, actuators)
    if full is None:
        notes.append("PX4's gains are left out: the highest rotor speed is unknown; give 'max RPM' and 'motor poles'")
    else:
        p = 1.0 / (constants * px4_effect(known, full))
        outer = np.array([1.0 / attitude["time constant"]] * 2 + [1.0 / attitude["yaw time constant"]])
        px4 = {"P": p, "I": p * integral, "D": p * derivative, "attitude P": outer}
    return FirmwareGains(px4, found_betaflight, compute_margins(asked, model, dt, actuators), tuple(notes))


def px4_effect(known: ControlModel, full: float) -> np.ndarray:
    """(3,) rad/s2 of roll, pitch, yaw per unit of PX4's torque set-point; full  rad/s at full output."""
    moments = known.effectiveness * full**2  # Mx My Mz Fz by the thrust of each rotor as a share of the full one
    mix = np.linalg.pinv(moments)
    columns = np.linalg.norm(mix[:, :2], axis=0) / math.sqrt(mix.shape[0] / 2.0)
    scale = np.array([columns.max(), columns.max(), np.abs(mix[:, 2]).max()])
    return np.diag(moments[:3] @ (mix[:, :3] / scale)) / np.diag(known.inertia)


def betaflight_effect(known: ControlModel, slope: float) -> np.ndarray:
    """(3,) rad/s2 of roll, pitch, yaw where each motor moves by its whole output range, about hover.

    slope  rad/s of rotor speed per share of the output range in hover
    """
    moments = np.abs(known.effectiveness[:3]).sum(axis=1) * 2.0 * known.hover_speed * slope
    return moments / np.diag(known.inertia)


def command_slope(model: Model, known: ControlModel) -> tuple[float, list[str]]:
    """Rotor speed by command in hover, rad/s per share of the output range, and what was assumed.

    Raises DataError where the model's command map falls or never reaches the hover speed.
    """
    table = drive_of(model.document).get("command map")
    if not table:
        return known.highest - known.lowest, [
            "no command map is known: rotor speed is taken as linear in the command between its limits"
        ]
    powers = [float(p) for p in table.get("powers") or range(len(table["coefficients"]))]
    coefficients = [float(c) for c in table["coefficients"]]
    command = np.linspace(0.0, 1.0, 2001)
    speed = sum(c * command**p for c, p in zip(coefficients, powers))
    k = int(np.argmin(np.abs(speed - known.hover_speed)))
    slope = float(np.gradient(speed, command)[k])
    if slope <= 0.0 or not speed.min() <= known.hover_speed <= speed.max():
        raise DataError(
            f"model {model.id}: its command map gives {speed.min():.0f} to {speed.max():.0f} rad/s, in which the hover "
            f"speed {known.hover_speed:.0f} rad/s does not lie on a rising part; correct 'command map'"
        )
    return slope, []


def gains_of_setup(setup: Setup) -> str:
    """The table of gains for a simulation's model, with its actuators and time step."""
    found = firmware_gains(setup.settings["controller"], setup.model, setup.dt, actuators_of_setup(setup))
    return gains_text(found)


def gains_text(found: FirmwareGains) -> str:
    """The table of gains, with the margins of the loop."""
    lines = ["gains for flight controllers: computed from the model, not flown"]
    lines.append(f"  {'':<24}{'roll':>9}{'pitch':>9}{'yaw':>9}")
    if found.px4 is not None:
        names = {"P": "RATE_P", "I": "RATE_I", "D": "RATE_D", "attitude P": "_P"}
        for key, values in found.px4.items():
            lines.append(f"  {'PX4 MC_<axis>' + names[key]:<24}" + "".join(f"{v:>9.3g}" for v in values))
    for key in ("P", "I", "D"):
        lines.append(f"  {'Betaflight ' + key:<24}" + "".join(f"{v:>9.0f}" for v in found.betaflight[key]))
    lines.append(f"  {'Betaflight level P':<24}{found.betaflight['level P']:>9.0f}")
    by_axis = [found.margins.by_direction[axis] for axis in FIRMWARE_AXES]
    for name, unit, values in (
        ("gain up", "dB", [m.gain_up for m in by_axis]),
        ("gain down", "dB", [m.gain_down for m in by_axis]),
        ("phase", "°", [m.phase for m in by_axis]),
        ("delay", "ms", [m.delay for m in by_axis]),
    ):
        lines.append(f"  {f'margin, {name} {unit}':<24}" + "".join(_plain(v) for v in values))
    notes = list(found.notes)
    if any(np.max(found.betaflight[key]) > MOST_BETAFLIGHT for key in ("P", "I", "D")):
        notes.append(f"Betaflight takes {MOST_BETAFLIGHT} at most; a larger number points at a wrong inertia or map")
    notes.append(
        "the firmware's gyro and D-term filters are not in the loop: their delay must stay well below the delay margin"
    )
    return "\n".join([*lines, *(f"  note: {note}" for note in notes)])


def _full_speed(model: Model, known: ControlModel, actuators: Mapping[str, Any] | None) -> float | None:
    frame = model.airframe
    table = drive_of(model.document).get("command map")
    if table:
        return float(sum(float(c) for c in table["coefficients"]))
    limited = (actuators or {}).get("highest") is not None
    return known.highest if limited or (frame.max_rpm and frame.logged_to_rad_s) else None


def _plain(value: float) -> str:
    return f"{value:>9.1f}" if math.isfinite(value) else f"{'none':>9}"
