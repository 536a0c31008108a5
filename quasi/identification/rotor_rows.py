"""Rows of flights from which the map of commands to rotor speeds and thrust is identified."""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from quasi.airframe import Airframe
from quasi.terms.rotor_map import raw_commands

AFTER_LIMIT = 0.2  # s after a command left its limit: five lags of a brushed motor
SATURATED_SHARE = 0.999  # a share of the command from which on it is at its limit
# Rotor radii above the place where the vehicle stands: one rotor there makes 0.4 % more thrust than in free air
# (Cheeseman & Bennett, ARC R&M 3021, 1955)
FREE_AIR = 4.0
LEAST_FREE = 0.5  # share of a flight's rows in free air; a flight with less stays near the floor, and keeps them all


def rows_in_free_air(
    flights: Mapping[str, pd.DataFrame], chosen: Mapping[str, np.ndarray], airframe: Airframe
) -> dict[str, np.ndarray]:
    """The chosen rows, without those of take-off and landing near the floor.

    There thrust is larger at the same command, so that the map of commands would err along its whole range.
    """
    found = dict(chosen)
    for key, flight in flights.items():
        if not {"z", "in_flight"} <= set(flight):
            continue
        down, standing = flight["z"].to_numpy(float), flight["in_flight"].to_numpy(float) < 0.5
        stand = down[standing & np.isfinite(down)]
        if not (len(stand) and chosen[key].any()):
            continue
        near = np.median(stand) - down < FREE_AIR * airframe.radius
        if near[chosen[key]].mean() <= 1.0 - LEAST_FREE:
            found[key] = chosen[key] & ~near
    return found


def rows_within_limits(
    flights: Mapping[str, pd.DataFrame], chosen: Mapping[str, np.ndarray], notes: list[str]
) -> dict[str, np.ndarray]:
    """The chosen rows, without those where a command is at its limit or was so within AFTER_LIMIT before.

    Beyond the limit the log does not hold what the controller asked for, and a supply that cannot carry full commands
    sags. Notes report how many rows are left out. Of commanded speeds without shares no limit is known.
    """
    found = dict(chosen)
    for key, flight in flights.items():
        commands, t = raw_commands(flight, "share"), flight["t"].to_numpy(float)
        if commands is None:
            continue
        full = commands >= SATURATED_SHARE
        memory = max(round(AFTER_LIMIT / float(np.median(np.diff(t)))), 1)
        last = np.maximum.accumulate(np.where(full.any(axis=1), np.arange(len(t)), -memory - 1))
        rows = chosen[key] & (np.arange(len(t)) - last > memory)
        lost = float(full[chosen[key]].any(axis=1).mean()) if chosen[key].any() else 0.0
        if lost > 0.01:
            most = int(np.argmax(full[chosen[key]].mean(axis=0))) + 1
            notes.append(
                f"flight {key}: a command is at its limit in {100 * lost:.0f} % of the rows, most often that of rotor "
                f"{most}; these rows do not enter the map from commands to rotor speeds"
            )
        found[key] = rows
    return found
