"""Sessions: flights of one sitting share trim, battery seating and biases; they are no independent evidence.

A flight's session is what the logbook's column "Session" says, else the date of its recording, else one for all.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

_DAY = re.compile(r"(?<!\d)(\d{4}-[01]\d-[0-3]\d)(?!\d)")
# Standard deviations between healthy sessions. Measured on flights of CrazyPAD by `benchmarks/real_causes.py`: 1.5 % of
# thrust by weight and by its place, 0.8 % along the spin. Assumed: of the place on its arm of 46 mm, a hand that seats
# a battery makes 0.65 mm, whatever the size of the vehicle, and propellers make the rest, half a percent of any arm.
SESSION_THRUST, SESSION_YAW = 0.015, 0.008
SEATED_TO, SESSION_PROPELLERS = 0.00065, 0.005  # m of the centre of gravity; share of an arm
UNSET = "0000-"  # a flight controller without a clock writes the year 0


def date_of(metadata: Mapping[str, Any]) -> str:
    """The day of a recording, "yyyy-mm-dd", by the capture's start or the log's header; "" where neither holds one.

    metadata  of a filtered or an imported flight
    """
    sources = (metadata.get("imported") or metadata).get("sources") or {}
    written = [
        str((sources.get("capture") or {}).get("capture start") or ""),
        str(((sources.get("onboard") or {}).get("header") or {}).get("Log start datetime") or ""),
    ]
    for text in written:
        found = _DAY.search(text)
        if found and not found[1].startswith(UNSET):
            return found[1]
    return ""


def sessions_of(cells: Mapping[str, str], metadata: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """{flight: session}. cells {flight: the logbook's "Session"}, "" where empty; metadata by flight."""
    return {key: str(cells.get(key) or "").strip() or date_of(about) for key, about in metadata.items()}


def units(sessions: Sequence[str], compared: Sequence[bool]) -> list[list[int]] | None:
    """Flights (positions) of each session and group, or None where sessions are no independent witnesses of a change.

    That takes two sessions among the compared flights, and two among the reference flights where there are any.
    """
    groups: dict[tuple[str, bool], list[int]] = {}
    for k, (session, flag) in enumerate(zip(sessions, compared)):
        groups.setdefault((session, bool(flag)), []).append(k)
    counts = {flag: sum(1 for _, f in groups if f is flag) for flag in {f for _, f in groups}}
    if not counts or min(counts.values()) < 2 or len(groups) == len(sessions):
        return None
    return list(groups.values())


def seating_spread(arm: float) -> float:
    """Standard deviation between healthy sessions of the place that the rotors balance about, in arms.

    arm  mean distance of the hubs from the centre of gravity, m
    """
    return float(np.hypot(SEATED_TO / arm, SESSION_PROPELLERS))


def session_sentence(sessions: Mapping[str, str], roles: Mapping[str, str]) -> str:
    """What one session of reference flights leaves open, "" where the question does not arise."""
    of = {r: {sessions.get(k, "") for k, role in roles.items() if role == r} for r in ("reference", "compared")}
    if len(of["reference"]) != 1 or not of["compared"]:
        return ""
    (only,) = of["reference"]
    named = f" ({only})" if only else ""
    if of["compared"] == {only}:
        return ""
    return (
        f"All reference flights are of one session{named}, so that a difference between sessions looks the same as a "
        "change; fly references in two sessions, and name them in the logbook's column 'Session'"
    )
