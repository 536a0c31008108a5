"""How far an imported flight can be trusted."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.airframe import DEFAULT_POLES
from quasi.errors import cautions
from quasi.importing import limits
from quasi.importing.contradictions import doubtful_units
from quasi.importing.onboard_log import Onboard
from quasi.importing.resampling import LONGEST_BRIDGE, covered
from quasi.sensor_limits import find_missing_sources, list_reasons


def verdict(frame: pd.DataFrame, board: Onboard, metadata: Mapping[str, Any]) -> dict[str, str]:
    """One word and why."""
    bad, care = list_reasons(metadata["contradictions"]) + find_missing_sources(frame, metadata), []
    valid = float(frame["onboard_valid"].mean())
    duration = float(frame["t"].iloc[-1])
    if valid < 0.5:
        bad.append(f"the on-board log covers only {100 * valid:.0f} % of the flight{made_too(board.made)}")
    elif valid < 0.98:
        care.append(f"the on-board log lost {100 * (1 - valid):.1f} % of the flight{made_too(board.made)}")
    bad += doubtful_units(board.gyro.values, board.force.values)
    care += limits.describe_clipping(metadata["saturation"])
    if duration < 2.0:
        bad.append(f"only {duration:.1f} s are common to all sources")
    onboard = metadata["sources"]["onboard"]
    if onboard.get("ended") is False:
        care.append("the on-board log ends without its end mark: it may be cut short")
    stated = (onboard.get("header") or {}).get("motor_poles")
    poles = metadata["motor poles"]
    if stated and stated != DEFAULT_POLES and poles.get("source") == "configuration" and stated != poles["value"]:
        care.append(f"its header states {stated} motor poles, the configuration {poles['value']}")
    if metadata["attitude source"] == "estimated on board":
        care.append("the attitude is estimated from gyro and accelerometer alone")
    at = frame["t"].to_numpy()
    if metadata["position source"] == "capture":
        lost = 1 - float(covered(at[frame["position_sample"] > 0], at, LONGEST_BRIDGE).mean())
        whose = "the capture lost the quadrotor"
    else:
        tracks = [track for track in (board.position, board.velocity, board.body_velocity) if track is not None]
        logged = [track.t[np.isfinite(track.values).all(axis=1)] for track in tracks]
        held = [covered(t, at + metadata["start"]["value"]) for t in logged]
        lost = 1 - float(np.any(held, axis=0).mean()) if held else 0.0
        whose = "the on-board log holds neither position nor velocity"
    if lost > 0.2:
        care.append(f"{whose} for {100 * lost:.0f} % of the flight")
    sync = metadata["synchronisation"]
    if sync and (sync["lag"]["std"] > 0.005 or min(sync["explained variance"].values()) < 0.5):
        care.append(f"the capture's lag is known to {1e3 * sync['lag']['std']:.1f} ms only")
    if metadata["rest before take-off"]["value"] < 1.0:
        care.append("it has no rest before take-off, so sensor biases rest on the flight itself")
    care += cautions(metadata["notes"])
    if bad:
        return {"verdict": "unusable", "verdict because": "; ".join(bad + care)}
    if care:
        return {"verdict": "usable with care", "verdict because": "; ".join(care)}
    return {"verdict": "good", "verdict because": "all sources are complete and agree"}


def made_too(made: Mapping[str, Mapping[str, Any]]) -> str:
    """What counts as lost as well, where sensors are made of other signals; nothing where all are logged."""
    parts = [f"the {name} made from {how['from']}" for name, how in made.items() if how.get("from")]
    return f", rows without {' and '.join(parts)} included" if parts else ""
