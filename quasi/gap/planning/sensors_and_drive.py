"""What the levels below aerodynamics could show on a trajectory: sensors against capture, rotors against commands.

The sensor level uses the columns that it compares flights with; the drive level closed forms of first order about the
measured speeds:
    lag tau               dW/dtau = -(dW/dt) low-passed by the lag itself
    delay d               dW/dd   = -dW/dt
    voltage exponent e    dW/de   = W ln(V / V_mean)
What healthy flights differ by (as the levels themselves count with) is nuisance in every flight. Samples are plentiful
on these levels, so that this spread, not the noise, decides, unless the trajectory hides a cause.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from quasi.errors import DataError
from quasi.gap.effect import Effect
from quasi.gap.flights.level import PRIOR_FREEDOM, Flown
from quasi.gap.levels.drive import identify as drive_level
from quasi.gap.levels.sensors import identify as sensor_level
from quasi.gap.levels.sensors.columns import weak_form
from quasi.gap.planning.outlook import Outlook, Repeated, Row
from quasi.gap.statistics.candidates import Columns
from quasi.model.columns import ROTORS
from quasi.model.extensions import drive_of
from quasi.model.model import Model

# of the averaged residuals of sensors: p q r (rad/s) and earth accelerations (m/s2) of good captures; white
SENSED = np.array([3.7e-3] * 3 + [1.6e-2] * 3)
DRIVEN = 5.0  # rad/s, of commanded against measured rotor speeds at 100 Hz
PAIR = ("command_delay", "telemetry_delay")
USUAL_LAG = 0.03  # s, where the model does not say how its rotors follow commands
STATE_COLUMNS = ("p", "q", "r", "ax", "ay", "az", "roll", "pitch", "yaw", "x", "y", "z")
DRIVES = ("motor_lag", "command_delay", "battery_sag")


def sensed(flight: pd.DataFrame, model: Model) -> tuple[np.ndarray, list[str]]:
    """Cross-products (1, P, P) of the columns of sensors over the noise of a good capture, and their names.

    flight  columns of a filtered flight. Raises DataError where it lacks one or is too short.
    """
    missing = [c for c in STATE_COLUMNS if c not in flight]
    if missing:
        raise DataError(f"no column '{missing[0]}'")
    ones = dict.fromkeys(("position_sample", "attitude_sample", "onboard_valid"), 1.0)
    about = {"position source": "capture", "attitude source": "capture"}
    table = flight[["t", *STATE_COLUMNS]].assign(**ones)
    weak = weak_form(Flown("the plan", True, table, about, pd.DataFrame(), {}, model.airframe))
    columns = weak.columns / SENSED[None, :, None]
    columns[:, :, 0] = 0.0  # nothing is measured yet
    flat = columns.reshape(-1, columns.shape[2])
    return (flat.T @ flat)[None], weak.names


def sensor_outlook(
    flights: Sequence[Repeated], names: Sequence[str], effects: Mapping[str, Effect], rate: float
) -> Outlook:
    """Sensors on cross-products of `sensed`: what healthy flights differ by stands in every flight."""
    causes, nuisance, spread = sensor_level.layout(names, effects, sensor_level.NORMAL_SPREAD)
    return _outlook(flights, [], nuisance, spread, causes, effects, rate, PRIOR_FREEDOM)


def driven(flight: pd.DataFrame, model: Model) -> np.ndarray:
    """Cross-products (1, P, P) of the closed forms of the drive; without voltages those of the sag are nothing."""
    t = flight["t"].to_numpy(float)
    step = float(np.median(np.diff(t)))
    keep = np.exp(-step / _lag(model))
    volt = flight["battery_voltage"].to_numpy(float) if "battery_voltage" in flight else np.ones(len(t))
    parts = []
    for rotor in ROTORS:
        speed, slope = flight[rotor].to_numpy(float), flight[f"{rotor}_dot"].to_numpy(float)
        lagged = lfilter([1.0 - keep], [1.0, -keep], slope)
        sag, one = speed * np.log(volt / np.nanmean(volt)), np.ones(len(t))
        parts.append(np.column_stack([0.0 * one, -lagged, -slope, sag, one, speed / np.nanmean(speed)]))
    flat = np.concatenate(parts) / DRIVEN
    flat = flat[np.isfinite(flat).all(axis=1)]
    return (flat.T @ flat)[None] * (100.0 * step)  # at other rates than 100 Hz, as much noise per second


def drive_outlook(flights: Sequence[Repeated], model: Model, effects: Mapping[str, Effect], rate: float) -> Outlook:
    """Drive on cross-products of `driven`. effects  those of DRIVES that can be asked"""
    unit = {"motor_lag": _lag(model), "command_delay": 1.0, "battery_sag": 1.0}
    key = {"motor_lag": "up", "command_delay": "delay", "battery_sag": "exponent"}
    causes = {n: [1 + k] for k, n in enumerate(DRIVES) if n in effects}
    spread = [unit[n] * drive_level.NORMAL[key[n]] / (np.sqrt(2.0) if n in causes else 1.0) for n in DRIVES]
    spread += [drive_level.NORMAL["a0"], drive_level.NORMAL["a1"]]
    prior = np.diag([1.0 / (unit[n] * drive_level.BELIEVED[key[n]]) ** 2 for n in DRIVES])
    return _outlook(flights, [1, 2, 3], [1, 2, 3, 4, 5], spread, causes, effects, rate, PRIOR_FREEDOM, prior)


def _outlook(
    flights: Sequence[Repeated], shared: Sequence[int], nuisance: Sequence[int], spread: Sequence[float],
    causes: Mapping[str, list[int]], effects: Mapping[str, Effect], rate: float, freedom: float,
    prior: np.ndarray | None = None,
) -> Outlook:  # fmt: skip
    """With the nuisances and the shared columns as columns of their own, next to those of the causes."""
    width = flights[0].stretches.shape[1]
    place = [*range(width), *nuisance, *shared]
    own = list(range(width, width + len(nuisance)))
    # rotors are asked for one lag of all and for each one's own
    tries = {n: 1 + len(ROTORS) for n in drive_level.ALIKE_COLUMNS if n in causes}
    columns = Columns(list(range(width + len(own), len(place))), own, np.array(spread), dict(causes), tries=tries)
    wide = [f._replace(stretches=f.stretches[:, place][:, :, place]) for f in flights]
    return Outlook(wide, columns, len(place), 0, effects, rate, True, freedom, prior)


def _lag(model: Model) -> float:
    held = drive_of(model.document).get("time constants") or {}
    return float(np.mean(held["value"])) if held.get("value") else USUAL_LAG


def judged_by_motion(rows: Sequence[Row]) -> list[Row]:
    """A late command with its twin, late telemetry: what the motion would show of the latter separates them."""
    found = [s for row in rows for s in row.all if s.cause == PAIR[1]]
    result = []
    for row in rows:
        if row.effect.id == PAIR[0]:
            shown = max((s.t * abs(row.sight.size / s.size) for s in found), default=0.0)
            if shown < row.sight.with_rival:
                sight = row.sight._replace(with_rival=shown, rival=PAIR[1])
                row = Row(row.effect, sight, (sight,))
        result.append(row)
    return result
