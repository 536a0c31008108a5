"""Which of two points sits elsewhere than configured: the IMU, or what the motion capture tracks.

The comparison of sensors sees how far the IMU is from the tracked point and nothing else: an IMU at r from the cg and
markers at -r look
alike. Forces see how far the IMU is from the cg: it feels wdot x r + w x (w x r) too much, whatever the capture says.
The two together determine each point.

Source: rigid-body kinematics; the weighing is least squares on the two estimates of each component, with the scale
factor of Birge, The calculation of errors by the method of least squares, Physical Review 40, 1932.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from quasi import attitude
from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.gap.causes import imu_lever_arm
from quasi.gap.effect import Effect, Limits, vehicle_of
from quasi.gap.flights.evidence import RATE, Evidence
from quasi.gap.flights.gathering import gather
from quasi.gap.flights.level import Flown, Level
from quasi.gap.levels.forces.design import Design, gather_design
from quasi.gap.levels.forces.nonlinear import started
from quasi.gap.levels.sensors.columns import XYZ
from quasi.gap.profile import Profile
from quasi.gap.selection import select_causes
from quasi.gap.statistics.candidates import Candidate
from quasi.gap.statistics.mixed import MixedModel
from quasi.model.model import Model

IMU, OFFSET, CG = "imu_lever_arm", "marker_offset", "cg_offset"
DECIDED = 9.0  # difference of squared standard errors, three of them, from which one explanation wins
TAKEN_UP = 0.1  # share of an arm's forces that the terms of a model may hold by chance
ACROSS = 0.04  # share of the whole arm that they may make up along another axis
LEAST_OWN = 1e-3  # of those forces that the terms leave, rms; below it rounding decides
BREAKER = "sharp turns about all axes, compared with a model that was identified from other flights"


class Points(NamedTuple):
    """Where IMU and tracked point are from where they were taken to be, m: (3,) each, with standard errors.

    between  IMU minus tracked point, by sensors; forces  IMU minus cg, by forces, with the standard error it is
    weighed by
    apart    how much worse the squared errors are if the IMU, or the markers, were where they are configured (3,)
    """

    imu: np.ndarray
    markers: np.ndarray
    imu_std: np.ndarray
    markers_std: np.ndarray
    between: np.ndarray
    forces: np.ndarray
    apart: np.ndarray

    @property
    def is_decided(self) -> bool:
        """Whether any component says which of the points it is."""
        return bool((np.abs(self.apart) > DECIDED).any())


def weigh(
    between: np.ndarray, between_std: np.ndarray, forces: np.ndarray, forces_std: np.ndarray,
    own: np.ndarray | float = 1.0,
) -> Points:  # fmt: skip
    """Share what the comparison of sensors sees between the two points, by what the forces see of one of them.

    between (3,) IMU minus tracked point, m; forces (3,) IMU minus cg, m. Component by component either the IMU or the
    markers are elsewhere, both where neither alone fits; an undecided component follows the decided ones.
    own  see `felt`: where terms of the model can make up more of the arm's forces than is the arm's alone, their error
    counts by the ratio of the two
    """
    made_up = np.maximum(np.sqrt(1.0 - np.square(own)) / own, 1.0)
    sharp = np.sqrt(forces_std**2 + (TAKEN_UP * made_up * between) ** 2 + ACROSS**2 * (between @ between))
    only_imu = (between - forces) ** 2 / (between_std**2 + sharp**2)  # the best common value left free
    only_markers = (forces / sharp) ** 2
    both = (only_imu > DECIDED) & (only_markers > DECIDED)
    apart = only_markers - only_imu  # positive: the markers alone fit worse
    # where even the better explanations leave more than errors do, the errors are too small: two faults that need each
    # other are not made of that
    left = np.minimum(only_imu, only_markers)[~both]
    apart = apart / max(1.0, float(left.mean()) if len(left) else 1.0)
    toward = np.where(np.abs(apart) > DECIDED, apart, apart.sum())
    # where one value serves both estimates, the sharper of them counts more
    weight = between_std**-2.0 + sharp**-2.0
    common, common_std = (between * between_std**-2.0 + forces * sharp**-2.0) / weight, weight**-0.5
    zero = np.zeros(3)
    imu = np.where(both, forces, np.where(toward > 0, common, zero))
    markers = np.where(both, forces - between, np.where(toward > 0, zero, -between))
    imu_std = np.where(both | (toward <= 0), sharp, common_std)
    markers_std = np.where(both | (toward > 0), np.hypot(between_std, sharp), between_std)
    return Points(imu, markers, imu_std, markers_std, between, forces, apart)


def settle(level: Level, flights: Sequence[Flown], model: Model, effects: Mapping[str, Effect], rate: float) -> None:
    """Separate `marker_offset` from `imu_lever_arm` in what the comparison of sensors found, if it found either.

    flights  those that may choose and fit; effects  other causes of forces; rate  their false alarm rate
    Changes the level: its effect becomes either cause or both, or a tie where the forces cannot decide.
    """
    arms = [e for e in level.effects if e["id"] == IMU]
    if not arms:
        # where the one could not be asked, neither could the other
        level.cannot_be_asked += [{**entry, "id": OFFSET} for entry in level.cannot_be_asked if entry["id"] == IMU]
        return
    sinces = [arm["since"] for arm in arms]
    for arm in arms:
        others = [since for since in sinces if since != arm["since"]]
        _settle_arm(level, arm, flights, model, effects, rate, others)


def _settle_arm(
    level: Level,
    arm: dict[str, Any],
    flights: Sequence[Flown],
    model: Model,
    effects: Mapping[str, Effect],
    rate: float,
    others: Sequence[str],
) -> None:
    """`settle` for one arm: that of all flights, or that of the compared ones beyond it. others  see `felt`"""
    try:
        forces, std, own = felt(flights, model, arm["since"], effects, rate, others)
    except DataError as error:
        level.notes.append(f"whether the IMU or the markers sit elsewhere was not asked of the forces: {error}")
        forces, std, own = np.zeros(3), np.full(3, np.inf), np.ones(3)
    between = np.array([arm["parameters"][n]["value"] for n in XYZ])
    between_std = np.array([arm["parameters"][n]["std"] for n in XYZ])
    points = weigh(between, between_std, forces, std, own)
    other = {
        **arm,
        "id": OFFSET,
        "parameters": _named(points.markers if points.is_decided else -between, points.markers_std),
        "evidence": {**arm.get("evidence", {}), "IMU minus cg by forces": forces.tolist(),
                     "standard error": std.tolist(), "apart": points.apart.tolist()},
    }  # fmt: skip
    if not points.is_decided:
        level.effects.remove(arm)
        level.ties.append(
            {"ids": [IMU, OFFSET], "since": arm["since"], "separability": float(np.sqrt(np.abs(points.apart).max())),
             "tie_breaker": BREAKER, "parameters": {IMU: arm["parameters"], OFFSET: other["parameters"]},
             "p": arm.get("evidence", {}).get("p")}
        )  # fmt: skip
        return
    imu_there = _there(points.imu, points.imu_std)
    if _there(points.markers, points.markers_std):
        at = level.effects.index(arm)
        mine = {**other, "id": IMU, "parameters": _named(points.imu, points.imu_std)}
        level.effects[at : at + 1] = [other, mine] if imu_there else [other]
    else:
        arm["evidence"] = other["evidence"]


def _there(value: np.ndarray, std: np.ndarray) -> bool:
    return bool((np.abs(value) > 3.0 * std).any())


def _named(value: np.ndarray, std: np.ndarray) -> dict[str, dict[str, Any]]:
    return {n: {"value": float(v), "std": float(s), "unit": "m"} for n, v, s in zip(XYZ, value, std)}


def _columns(evidence: Evidence, _: Any) -> dict[str, np.ndarray]:
    """Force (n, 6) that an accelerometer at 1 m from the cg shows too much, per axis."""
    turning, rates = evidence.angular_acceleration, evidence.rates
    return {
        name: evidence.forces_only(
            evidence.mass * (np.cross(turning, unit) + np.cross(rates, np.cross(rates, unit)))
        )
        for name, unit in zip(XYZ, np.eye(3))
    }  # fmt: skip


FELT = Effect(
    id=IMU, level="forces", sentence="the inertial sensors sit away from the centre of gravity",
    equation="see the module",
    source="rigid-body kinematics", parameters=imu_lever_arm.EFFECT.parameters, channels=("Fx", "Fy", "Fz"),
    columns=_columns, parts="all",
)  # fmt: skip


def felt(
    flights: Sequence[Flown], model: Model, since: str, effects: Mapping[str, Effect], rate: float,
    others: Sequence[str] = (),
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """IMU minus cg (3,) m by the forces, with standard errors (3,), and the share (3,) of the arm's forces, rms, that
    the model's own terms, which are fitted anew with it, cannot make up.

    since  "always": one arm in all flights; "changed": of the compared ones, beyond what all have
    effects  causes by id; causes of forces other than the arm are taken out, since a tether, say, would bias the arm;
    rate  their false alarm rate; others  since when there are arms that are estimated with this one
    Raises DataError where no flight can be compared with the model.
    """
    seen = []
    for flown in flights:
        try:
            seen.append((flown, _evidence(flown, model)))
        except DataError:  # a flight without valid data is stated where forces are compared
            continue
    if not any(flown.compared for flown, _ in seen):
        raise DataError("no compared flight has valid data")
    evidence, vehicle = [e for _, e in seen], vehicle_of(model)
    compared = np.array([flown.compared for flown, _ in seen])
    asked = {n: e for n, e in effects.items() if e.level == "forces" and not e.finding}
    arm, *rest = (Candidate(IMU, when, (0, 1, 2)) for when in (since, *others))
    study = started(gather_design(evidence, asked | {IMU: FELT}, vehicle), asked | {IMU: FELT}, vehicle, compared)
    given = _other_causes(study, asked, {n: e.limits(vehicle) for n, e in asked.items()}, compared, rate, [arm, *rest])
    mixed = study.mixed(range(len(seen)), compared)
    test = mixed.test(arm, [*given, *rest], [IMU] if since == "changed" else [])
    std = np.asarray(test.std)
    if since == "always" and not rest and not compared.all():
        std = std * _disagreement(mixed, arm, given)
    return np.asarray(test.value), std, _left_by_terms(mixed, arm)


def _disagreement(mixed: MixedModel, arm: Candidate, given: Sequence[Candidate]) -> np.ndarray:
    """Factor (3,) on the standard errors of an arm that all flights should have alike: how many of its own the compared
    and the reference flights are apart, where that is sure. What disturbs one of them passes for an arm there."""
    sides = [arm._replace(since=since) for since in ("changed", "reference")]
    one, other = (mixed.test(side, [*given, *(s for s in sides if s != side)], []) for side in sides)
    apart = (np.asarray(one.value) - other.value) ** 2 / (np.asarray(one.std) ** 2 + np.asarray(other.std) ** 2)
    return np.where(apart > DECIDED, np.sqrt(apart), 1.0)


def _left_by_terms(mixed: MixedModel, arm: Candidate) -> np.ndarray:
    columns, terms = mixed.columns.of(arm), mixed.columns.shared
    total = np.sum(np.asarray(mixed.grams)[mixed.offered(arm.since)], axis=0)
    size = np.sqrt(np.maximum(np.diag(total), 1e-300))
    total = total / np.outer(size, size)
    cross = total[np.ix_(terms, columns)]
    made = np.einsum("ij,ij->j", cross, np.linalg.pinv(total[np.ix_(terms, terms)], hermitian=True) @ cross)
    return np.sqrt(np.clip(1.0 - made, LEAST_OWN**2, 1.0))


def _other_causes(
    study: Design, asked: Mapping[str, Effect], within: Mapping[str, Limits],
    compared: np.ndarray, rate: float, arms: list[Candidate],
) -> list[Candidate]:  # fmt: skip
    """Causes of forces other than the arms.

    A moved centre of gravity is none: what the accelerometer feels is its place from where that is.
    """
    mixed = study.witnessed(range(len(compared)), compared)
    profiles = {n: Profile.of(e, within.get(n)) for n, e in (asked | {IMU: FELT}).items()}
    return select_causes(mixed, profiles, rate, excluded=(*study.lacking, IMU, CG), known=arms).offers


def _evidence(flown: Flown, model: Model) -> Evidence:
    evidence = gather(flown.key, flown.filtered, flown.filtered_metadata, flown.airframe, model, RATE)
    measured = evidence.measured
    if not model.with_gravity:  # the flight is filtered with gravity left out of the forces
        down = attitude.rotate_inverse(evidence.quaternion, np.array([0.0, 0.0, 1.0]))
        measured = measured + evidence.forces_only(evidence.mass * GRAVITY * down)
    taken_off = (flown.metadata.get("corrections") or {}).get("imu position") or {}
    if taken_off.get("applied") and taken_off.get("source") == "hover":
        columns = _columns(evidence, None)
        measured = measured + sum(v * columns[n] for n, v in zip(XYZ, taken_off["value"]))
    return replace(evidence, measured=measured)
