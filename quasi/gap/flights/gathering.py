"""Filtered flights made ready for the search for causes: compared with the model's vehicle, thinned, put right."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from quasi.airframe import Airframe
from quasi.attitude import GRAVITY
from quasi.errors import ConfigError, DataError, ExpressionError
from quasi.gap.flights.evidence import GAP_SAMPLES, PLACE, REQUIRED, Evidence, model_wrench
from quasi.gap.flights.instruments import as_shown
from quasi.model.columns import ROTORS
from quasi.model.extensions import correct_columns
from quasi.model.model import AXES, Model
from quasi.sensor_limits import check_measured_motion

HEAVIER = 2.0  # a factor of mass that no load explains
ELSEWHERE = 0.5  # of the arm: rotors are numbered otherwise, or it is another frame
SECOND = 1.0  # s: what low-pass filters and whiteners leave of less is nothing
SENSELESS = 1e4  # times the weight, and the weight at the arm: no model of a quadrotor means that
SAMPLES = 2.5  # per period of the filters' cut-off: what they let pass is then not folded


def refuse_another_vehicle(where: str, airframe: Airframe, model: Model) -> None:
    """Raise ConfigError where a flight cannot be of the quadrotor that the model describes.

    Loads, batteries and shifted rotors are what a comparison looks for; this is about mistaken configurations.
    """
    ours, head = model.airframe, f"{where} is not of the quadrotor that model {model.id} describes"
    remedy = "compare it with its own model, or correct the quadrotor's configuration or 'Mass' in the logbook"
    if ours.mass and airframe.mass and not 1.0 / HEAVIER < airframe.mass / ours.mass < HEAVIER:
        raise ConfigError(
            f"{head}: its mass is {airframe.mass:g} kg, the model's {ours.mass:g} kg, expected less than a factor of "
            f"{HEAVIER:g} between them; {remedy}"
        )
    far = np.linalg.norm(np.asarray(airframe.hubs) - np.asarray(ours.hubs), axis=1)
    rotor = int(np.argmax(far))
    if far[rotor] > ELSEWHERE * ours.arm:
        raise ConfigError(
            f"{head}: rotor {rotor + 1} lies {far[rotor]:.3f} m from where the model has it, expected less than "
            f"{ELSEWHERE * ours.arm:.3f} m; {remedy}"
        )
    if not np.array_equal(np.sign(airframe.spin), np.sign(ours.spin)):
        raise ConfigError(f"{head}: its rotors turn the other way; {remedy}")


def gather_all(
    flights: Mapping[str, tuple[pd.DataFrame, Mapping[str, Any], Airframe]], model: Model, rate: float
) -> tuple[dict[str, Evidence], list[str]]:
    """Evidence of the flights that can be compared, by key, and a sentence on each that cannot; see `gather`.

    flights  {key: filtered flight, its metadata, airframe}
    Where some flight's position was not measured it is used of none: a height that drifts is no height, and what only
    some flights know cannot be asked of all. Raises DataError when no flight can be compared, unless it is for want of
    a velocity: then nothing is wrong with model and flights, and the levels below can be asked.
    """
    found, lost, drifting, nowhere = {}, [], False, []
    rate = max([rate, *(_least_rate(metadata) for _, metadata, _ in flights.values())])
    for key, (table, metadata, airframe) in flights.items():
        speed, place = check_measured_motion(metadata)
        if not speed:
            drifting = True
            lost.append(
                f"flight {key} has no source of velocity but the accelerometer, which drifts, and forces and moments "
                "depend on it; fly it with motion capture, or bring velocity or position in its log"
            )
            continue
        try:
            known = table if place else table.drop(columns=list(PLACE), errors="ignore")
            found[key] = gather(key, known, metadata, airframe, model, rate)
            nowhere += [] if place else [key]
        except DataError as error:
            lost.append(str(error))
    if not found and not drifting:
        raise DataError(f"no flight can be compared with model {model.id}: {lost[0] if lost else 'none is given'}")
    lost = [f"{why}; it is left out of the comparison of forces and moments" for why in lost]
    if nowhere:
        found = {
            key: replace(one, columns={n: v for n, v in one.columns.items() if n not in PLACE})
            for key, one in found.items()
        }
        lost.append(
            f"flight {nowhere[0]} has no source of position (what its velocity adds up to drifts); what depends on "
            "height or place is not asked"
        )
    return found, lost


def _least_rate(metadata: Mapping[str, Any]) -> float:
    """Hz that a flight's forces need, by the low-pass that they went through; 0 where it is unknown."""
    return SAMPLES * float((metadata.get("filters") or {}).get("low-pass cutoff Hz") or 0.0)


def gather(
    key: str, flight: pd.DataFrame, metadata: Mapping[str, object], airframe: Airframe, model: Model, rate: float
) -> Evidence:
    """Evidence of a filtered flight, thinned to about `rate` Hz, to more where its filters let higher frequencies pass.

    flight  filtered, of the kind (with or without gravity) that the model predicts; its forces are band-limited, so
            that thinning to 2.5 times their cut-off loses nothing
    Rows that are not valid or hold missing values are left out. Raises DataError when a column is missing or less than
    a second is left, ConfigError for a model without some of the six axes.
    """
    unknown = [a for a in AXES if a not in model.axes]
    if unknown:
        raise ConfigError(
            f"model {model.id} says nothing of {', '.join(unknown)}, which a comparison with flights needs; identify "
            "all six axes"
        )
    if model.normalisation:
        raise ConfigError(
            f"model {model.id} is normalised; a comparison with flights needs one that was identified with 'normalize "
            "data' false"
        )
    missing = [c for c in REQUIRED if c not in flight]
    if missing:
        raise DataError(f"flight {key} has no column '{missing[0]}', which a comparison with a model needs")
    sampling = 1.0 / float(np.median(np.diff(flight["t"].to_numpy())))
    # the step of time is known to rounding alone: 499.99.. Hz are no less than 500
    every = max(int((sampling + 1e-6) // max(rate, _least_rate(metadata))), 1)
    good = np.isfinite(flight[list(REQUIRED)].to_numpy()).all(axis=1)
    if "valid" in flight:
        good &= flight["valid"].to_numpy() > 0.5
    rows = np.flatnonzero(good)
    rows = rows[rows % every == 0]
    if len(rows) * every < SECOND * sampling:
        raise DataError(f"flight {key} has {len(rows) * every / sampling:.1f} s of valid data, expected more than 1 s")
    ends = np.flatnonzero(np.append(np.diff(rows) > GAP_SAMPLES * every, True))
    longest = int(np.max(np.diff(ends, prepend=-1))) * every / sampling
    if longest < SECOND:
        raise DataError(
            f"flight {key} has {longest:.1f} s of valid data without a gap, expected more than {SECOND:g} s; fly longer"
        )
    columns = {
        name: flight[name].to_numpy(float)[rows] for name in flight if pd.api.types.is_numeric_dtype(flight[name])
    }
    columns = correct_columns(model, columns)
    try:
        predicted = model_wrench(model, columns)
    except ExpressionError as error:
        raise DataError(f"flight {key} cannot be compared with model {model.id}: {error}") from None
    still = [name for name in ROTORS if not np.ptp(columns[name])]
    if still:
        raise DataError(
            f"flight {key} holds {columns[still[0]][0]:g} rad/s as the speed of rotor {still[0][1:]} throughout, where "
            "that of a flying rotor changes; check its telemetry"
        )
    weight = GRAVITY * (model.airframe.mass or 1.0)
    most = np.array([SENSELESS * weight] * 3 + [SENSELESS * weight * max(model.airframe.arm, 0.1)] * 3)
    worst = np.abs(predicted).max(axis=0) / most
    if np.isfinite(predicted).all() and worst.max() > 1.0:
        k = int(np.argmax(worst))
        raise DataError(
            f"flight {key} cannot be compared with model {model.id}: it predicts {AXES[k]} up to "
            f"{np.abs(predicted[:, k]).max():.3g} {'N' if k < 3 else 'N m'}, which no quadrotor makes; correct the "
            f"coefficients of {AXES[k]} in its model.json, or make the model anew"
        )
    if not np.isfinite(predicted).all():
        lacking = [a for k, a in enumerate(AXES) if not np.isfinite(predicted[:, k]).all()]
        raise DataError(f"model {model.id} has no value for {', '.join(lacking)} on flight {key}")
    found = Evidence(
        key,
        airframe,
        model,
        float(metadata.get("mass") or airframe.mass or np.nan),
        np.asarray(metadata.get("inertia", airframe.inertia), float),
        columns,
        np.stack([columns[a] for a in AXES], axis=1),
        predicted,
        metadata,
    )
    return replace(found, predicted=as_shown(found))
