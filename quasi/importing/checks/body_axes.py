"""Body axes of a flight controller's IMU, decided from the log itself: x forward, with y right and z down, or y left
and z up.

Two tests. The specific force at rest and in mean flight points up with 1 g: against the logged attitude, else by the
sign of its z component at rest. And the gyro turns as the logged attitude does. INDIflight of early 2024 logs its IMU
in x forward, y left, z up, later versions in x forward, y right, z down; Betaflight always logs the former.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from quasi.attitude import GRAVITY, HALF_TURN, rotate
from quasi.errors import ConfigError, DataError, ReadError, add_caution
from quasi.importing.contradictions import rates_explained, refuse_wrong_rates
from quasi.importing.onboard_attitude import rest_at_start
from quasi.importing.series import Recording, Series

KEY = "logged body axes"
FRD, FLU = "x forward, y right, z down", "x forward, y left, z up"
CHOICES = {"from the log": None, "FRD": FRD, "FLU": FLU}
TURNED = ("q", "r", "ay", "az", "setpoint_q", "setpoint_r")  # quantities that the half turn reverses
RATES, FORCE, QUATERNION = ("p", "q", "r"), ("ax", "ay", "az"), ("qw", "qx", "qy", "qz")
LEAST_UP = 0.5  # of the force's size, that has to point up or down to decide; at rest and in mean flight it is about 1
LEAST_AXES_EXPLAINED = 0.3  # share of the gyro's variance that the attitude explains in the right axes, and the margin


def settle_body_axes(recording: Recording, quadrotor: Mapping[str, Any], where: str) -> Recording:
    """The recording with its IMU in x forward, y right, z down, by what the log shows; a note states the decision.

    recording  of a blackbox reader, which turned the IMU by its firmware's convention (metadata "body axes logged")
    quadrotor  its configuration, whose KEY forces the axes
    Raises     ConfigError for a wrong KEY; ReadError where the log fits neither kind
    """
    assumed = recording.metadata["body axes logged"]
    other = FLU if assumed == FRD else FRD
    forced = _forced(quadrotor, where)
    main = recording.series["onboard"]
    found = {name: vote for name, vote in _votes(main, where).items() if vote is not None}
    axes, evidence = assumed, "the firmware's convention, for the log shows neither rest nor attitude"
    turned = set(found.values())
    if forced is not None:
        axes, evidence = forced, f"'{KEY}' of the quadrotor configuration"
    elif turned == {True} and (len(found) == 2 or "qw" in main.values):
        axes, evidence = other, " and ".join(found)
    elif turned == {False}:
        evidence = " and ".join(found)
    elif turned == {True}:
        evidence = "the firmware's convention, for no attitude confirms what the specific force shows"
    elif turned and turned != {True}:
        votes = ", ".join(f"{name} {_fits(vote, assumed, other)}" for name, vote in found.items())
        raise ReadError(
            f"{where}: the body axes of the log are neither {FRD} nor {FLU}: {votes}; check the board alignment and "
            f'the firmware, or force the axes by \'{KEY}\': "FRD" or "FLU" in the quadrotor configuration'
        )
    notes = list(recording.notes)
    notes.append(f"{where}: the IMU is logged in {axes}, by {evidence}")
    wrong = [name for name, vote in found.items() if vote is None or vote != (axes != assumed)]
    if wrong and (forced is not None or axes == assumed):
        add_caution(notes, f"{where}: {' and '.join(wrong)} contradict body axes {axes}; check '{KEY}'")
    about = {"body axes logged": axes, "body axes decided by": evidence}
    values = dict(main.values)
    if axes != assumed:
        values |= {name: -values[name] for name in TURNED if name in values}
    series = {**recording.series, "onboard": Series(main.t, values)}
    return replace(recording, series=series, metadata={**recording.metadata, **about}, notes=notes)


def _forced(quadrotor: Mapping[str, Any], where: str) -> str | None:
    chosen = quadrotor.get(KEY) or "from the log"
    if chosen not in CHOICES:
        raise ConfigError(f"{where}: '{KEY}' is {chosen!r}, expected one of {', '.join(map(repr, CHOICES))}")
    return CHOICES[chosen]


def _fits(vote: bool | str, assumed: str, other: str) -> str:
    return "fits neither" if vote == "neither" else f"fits {other if vote else assumed}"


def _votes(series: Series, where: str) -> dict[str, bool | str | None]:
    """By each test: False for the axes as they are, True for the other kind, "neither", or None where it shows nothing.

    series  t (n,) s with quantities of RATES, FORCE and QUATERNION, as far as logged
    """
    votes: dict[str, bool | str | None] = {}
    rates, force, attitude = (series.matrix(names) for names in (RATES, FORCE, QUATERNION))
    if force is not None:
        votes["the specific force"] = _by_force(series.t, rates, force, attitude)
    if rates is not None and attitude is not None:
        votes["the gyro against the attitude"] = _by_gyro(series.t, rates, attitude, where)
    return votes


def _by_force(
    t: np.ndarray, rates: np.ndarray | None, force: np.ndarray, attitude: np.ndarray | None
) -> bool | str | None:
    fine = np.isfinite(force).all(axis=1)
    if attitude is not None:
        fine &= np.isfinite(attitude).all(axis=1)
    if np.count_nonzero(fine) < 20:
        return None
    felt = force[fine]
    size = float(np.median(np.linalg.norm(felt, axis=1)))
    if size < 0.2 * GRAVITY:
        return None
    if attitude is not None:
        # upwards is minus z of the earth
        up, turned = (
            -float(np.median(rotate(attitude[fine], kind * felt)[:, 2])) / size for kind in (np.ones(3), HALF_TURN)
        )
    else:
        still = 0
        if rates is not None and np.isfinite(rates[fine]).all():
            still = rest_at_start(t[fine], rates[fine], felt)
        up = -float(np.median(felt[: still or None, 2])) / size
        turned = -up
    if max(up, turned) < LEAST_UP:
        return None if attitude is None else "neither"
    return None if min(up, turned) >= LEAST_UP else turned > up


def _by_gyro(t: np.ndarray, rates: np.ndarray, attitude: np.ndarray, where: str) -> bool | str | None:
    fine = np.isfinite(rates).all(axis=1)
    if np.count_nonzero(fine) < 20:
        return None
    shares = [rates_explained(t[fine], kind * rates[fine], t, attitude) for kind in (np.ones(3), HALF_TURN)]
    if None in shares:
        return None
    if max(shares) >= LEAST_AXES_EXPLAINED:
        return shares[1] > shares[0] if abs(shares[1] - shares[0]) > LEAST_AXES_EXPLAINED else None
    try:
        # a wrong unit hides the axes, and is reported where units are checked
        scaled = [refuse_wrong_rates(t[fine], k * rates[fine], t, attitude, "", where) for k in (np.ones(3), HALF_TURN)]
    except DataError:
        return None
    return None if any(scaled) else "neither"
