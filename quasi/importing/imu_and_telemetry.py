"""Corrections of one flight before fusion: the place of the IMU, and the age of the rotor telemetry."""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from quasi.airframe import read_airframe, read_triple
from quasi.importing.clocks.telemetry import YAW_EXPLAINED, rotor_age
from quasi.importing.lever_arm import felt_too_much, hover_arm
from quasi.importing.onboard_log import Onboard, Track

SHARP_AGE = 0.6e-3  # s, standard error up to which an age of the rotor telemetry is corrected
LEAST_AGE = -1e-3  # s: telemetry cannot run ahead of the motion by more than filter delays are uncertain


def lever_arm_term(
    rates: np.ndarray, force: np.ndarray, at: np.ndarray, columns: Mapping[str, np.ndarray],
    quadrotor: Mapping[str, Any], chosen: Mapping[str, Any], where: str, notes: list[str],
) -> dict[str, Any] | None:  # fmt: skip
    """What an IMU away from the cg measures too much; None when not asked for or not known."""
    arm = read_triple(quadrotor.get("imu position"), "imu position")
    if not chosen["do onboard c.g. correction"]:
        if arm is not None and np.any(arm):
            notes.append(
                f"{where}: the quadrotor's 'imu position' is not used; set 'do onboard c.g. correction' of 'data "
                "importing' to true to correct by it, or take it out"
            )
        return None
    about: dict[str, Any] = {"source": "configuration"}
    if arm is None:
        hover = None
        if all(f"w{i}" in columns for i in range(1, 5)) and "rotor config" in quadrotor:
            hubs = read_airframe(quadrotor, str(quadrotor.get("file", where)), np.nan).hubs
            hover = hover_arm(at, rates, force, np.stack([columns[f"w{i}"] for i in range(1, 5)], axis=1), hubs)
        if hover is None:
            notes.append(
                f"{where}: 'do onboard c.g. correction' is on, but the flight does not hover long enough to give the "
                "IMU's place and the quadrotor configuration has no 'imu position'; nothing was corrected"
            )
            return None
        arm = hover.position
        about = {"source": "hover", "std": hover.std.tolist(), "hover": {"value": hover.seconds, "unit": "s"}}
        notes.append(
            f"{where}: the IMU is taken to sit {1e3 * arm[0]:+.1f} mm ahead and {1e3 * arm[1]:+.1f} mm right of "
            "the cg, from rotor speeds in hover; a weak rotor would look the same"
        )
    return {
        "term": felt_too_much(at, rates, arm),
        "about": {"value": arm.tolist(), "unit": "m", "applied": True, **about},
    }


def remove_telemetry_age(board: Onboard, where: str, notes: list[str]) -> tuple[Onboard, dict[str, Any] | None]:
    """Take the age of the rotor telemetry off its times where the flight gives it precisely; and what was found."""
    if board.rotors is None or board.rotors.values.shape[1] < 4:
        return board, None
    age = rotor_age(board.rotors.t, board.rotors.values, board.gyro.t, board.gyro.values)
    if age is None:
        notes.append(f"{where}: too little flying with all rotors to give the age of the rotor telemetry; taken as 0")
        return board, None
    # the gyro's own delay may be wrong by this much; what is left of it makes the telemetry seem younger
    late = board.delays["gyro"]["std"]
    sharp = age.std < SHARP_AGE and age.explained > YAW_EXPLAINED and age.value > min(LEAST_AGE, -late)
    about = {
        "age": {"value": age.value, "std": float(np.hypot(age.std, late)), "unit": "s"},
        "explained variance": age.explained,
        "applied": sharp,
    }
    if not sharp:
        found = f"({1e3 * age.value:.1f} +- {1e3 * about['age']['std']:.1f} ms); taken as 0"
        if age.std < SHARP_AGE and age.explained > YAW_EXPLAINED:
            notes.append(f"{where}: the rotor telemetry seems to be ahead of the gyro {found}, check their time stamps")
        else:
            notes.append(
                f"{where}: the age of the rotor telemetry is not known from this flight {found}. Quick yaw inputs "
                "would show it"
            )
        return board, about

    def earlier(track: Track) -> Track:
        return Track(track.t - age.value, track.values)

    others = {n: earlier(k) if re.fullmatch(r"w[1-8]", n) else k for n, k in board.others.items()}
    return replace(board, rotors=earlier(board.rotors), others=others), about
