"""Flights with a hidden cause: drawn from a seed, made as raw logs, imported and filtered.

A draw states which causes of which size are planted in which flights of the made vehicle; the search does not know it.
Draws belong to worlds: sensors, firmware, airframe and sessions. World 0 is the mild one, the others are drawn. Healthy
flights of a world and the model that is identified from some of them are made once and kept.
"""

import dataclasses
import functools
import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from worlds import draw_world

from quasi.airframe import read_airframe
from quasi.filtering.flight import filter_flight
from quasi.filtering.rotor_speeds import add_estimated_speeds
from quasi.gap.causes.payload_swing import LOAD_LENGTHS
from quasi.gap.flights.level import Flown
from quasi.identification.candidates import read_specification
from quasi.identification.fit import fit_axis
from quasi.identification.partition import partition
from quasi.identification.rotor_speeds import rotor_speeds_of
from quasi.identification.shared import shared
from quasi.importing.flight import import_flight
from quasi.model.build import assemble_model
from quasi.model.commands import map_of
from quasi.model.model import AXES, Model
from quasi.tables import list_telemetry_corrections, read_json, read_table, write_json, write_table
from quasi_synthesis.campaign import make_flight, quadrotor_configuration, read_campaign, write_flight
from quasi_synthesis.effects import OFFERED, UNLISTED
from quasi_synthesis.vehicle import BASE_INERTIA, BASE_MASS, base_vehicle

ROOT = Path(__file__).resolve().parents[1]
SECONDS = 30.0
PROFILES = ("mixed", "aggressive", "speed", "heave")
LEARNED, REFERENCE = range(400, 416), range(500, 508)  # seeds of healthy flights
LEARNED_IN_WORLDS = 12  # of LEARNED, in every world but the mild one
WORLDS = 12  # world 0 is mild, the others are `draw_world` of their number
KINDS = {"single": 0.54, "clean": 0.14, "pair": 0.18, "unlisted": 0.14}
DESIGNS = {"reference": 0.6, "all": 0.28, "own": 0.12}
OWN = 6  # affected flights of a draw whose model is identified from them, the held-out one among them
RANGE = 30.0  # largest over smallest size of a cause


class Hidden(NamedTuple):
    """How a cause is drawn: parameters, which of them ("one": the first, "pick": one of them, "vector": a direction),
    typical deviation from neutral, neutral value, whether both signs occur."""

    names: tuple[str, ...]
    which: str
    typical: float
    neutral: float = 0.0
    signed: bool = True


_P = base_vehicle().physics
XYZ, RPY = ("x", "y", "z"), ("roll", "pitch", "yaw")
ROTORS = tuple(f"rotor{i}" for i in range(1, 5))
WRENCH = {
    "rotor_drag": Hidden(("k",), "one", 8e-6),
    "body_drag": Hidden(("c",), "one", 0.02),
    "blade_flapping": Hidden(("k",), "one", 3e-7),
    "translational_lift": Hidden(("k",), "one", 0.01),
    "axial_inflow": Hidden(("k",), "one", 2e-5),
    "vortex_ring": Hidden(("depth",), "one", 0.3, 0.0, False),
    "ground_effect": Hidden(("c",), "one", 4.0, 0.0, False),
    "proximity": Hidden(("gain",), "one", 0.3, 0.0, False),
    "rotor_interference": Hidden(("k",), "one", 0.1),
    "thrust_curve": Hidden(("c1",), "one", 3e-5),
    "thrust_factor": Hidden(("factor",), "one", 0.04, 1.0),
    "torque_factor": Hidden(("factor",), "one", 0.1, 1.0),
    "inflow_lag": Hidden(("tau",), "one", 0.006, _P.inflow_lag, False),
    "rotor_speed_scale": Hidden(("scale",), "one", 0.05, 1.0),
    "thrust_drift": Hidden(("rate",), "one", 0.001),
    "rotor_effectiveness": Hidden(ROTORS, "pick", 0.05, 1.0),
    "rotor_tilt": Hidden(ROTORS, "pick", 0.03),
    "rotor_gyroscopic": Hidden(("inertia",), "one", 1e-6),
    "rotor_acceleration_torque": Hidden(("inertia",), "one", 7e-7),
    "mass": Hidden(("mass",), "one", 0.04 * BASE_MASS, BASE_MASS),
    "inertia": Hidden(("Ixx", "Iyy", "Izz"), "pick", 0.1),
    "cg_offset": Hidden(XYZ, "vector", 0.003),
    "wind": Hidden(("north", "east"), "vector", 1.0),
    "payload_swing": Hidden(("mass",), "one", 0.015, 0.0, False),
    "tether": Hidden(("k",), "one", 0.15, 0.0, False),
}
SENSORS = {
    "imu_lever_arm": Hidden(XYZ, "vector", 0.008),
    "imu_misalignment": Hidden(RPY, "vector", 0.017),
    "accelerometer_bias": Hidden(XYZ, "vector", 0.4),
    "accelerometer_scale": Hidden(XYZ, "pick", 0.01, 1.0),
    "marker_offset": Hidden(XYZ, "vector", 0.012),
    "gyro_bias": Hidden(XYZ, "vector", 0.05),
    "gyro_scale": Hidden(XYZ, "pick", 0.01, 1.0),
    "mocap_misalignment": Hidden(RPY, "vector", 0.025),
    "room_tilt": Hidden(("roll", "pitch"), "vector", 0.008),
    "mocap_delay": Hidden(("delay",), "one", 0.004, 0.0, False),
    "clock_drift": Hidden(("rate",), "one", 3e-4),
}
DRIVE = {
    "battery_sag": Hidden(("exponent",), "one", 0.25, 1.0),
    "motor_lag": Hidden(("time_constant",), "one", 0.008, 0.026),
    "command_delay": Hidden(("delay",), "one", 0.007, 0.0, False),
    "telemetry_delay": Hidden(("delay",), "one", 0.006, 0.0, False),
}
STRANGE = {
    "unlisted_heading": Hidden(("size",), "one", 0.02),
    "unlisted_height": Hidden(("size",), "one", 0.06),
    "unlisted_beat": Hidden(("size",), "one", 0.15),
    "unlisted_fan": Hidden(("size",), "one", 0.3, 0.0, False),
    "unlisted_twist": Hidden(("size",), "one", 4e-4),
    "unlisted_brake": Hidden(("size",), "one", 2e-5),
    "unlisted_shift": Hidden(("size",), "one", 2e-3),
}
ALL = WRENCH | SENSORS | DRIVE | STRANGE
# what the made vehicle has anyway and a fitted model may lack: reported of every flight, it is no wrong name
INHERENT = {"rotor_drag", "body_drag", "blade_flapping", "axial_inflow", "vortex_ring", "rotor_interference",
            "inflow_lag", "rotor_gyroscopic", "rotor_acceleration_torque", "translational_lift"}  # fmt: skip
# without measured rotor speeds these change nothing that is logged
TELEMETRY_CAUSES = ("rotor_speed_scale", "telemetry_delay")
# channel in which an effect of no catalogue shows
SHOWS = {"unlisted_heading": "Fz", "unlisted_height": "Fy", "unlisted_beat": "Fx", "unlisted_fan": "Fz",
         "unlisted_twist": "Mz", "unlisted_brake": "My", "unlisted_shift": "Mx"}  # fmt: skip


def drawn(seed: int, without: Collection[str] = ()) -> dict[str, Any]:
    """What is hidden in the flights of a seed: {"kind", "design", "effects": {id: {parameter: value}}, "factors"}.

    Sizes are log-uniform over a factor of RANGE around the typical one. design  "reference": healthy flights are given
    as well; "all": every flight is affected; "own": and the model was identified from these same flights.
    without  causes that are not hidden
    """
    rng = np.random.default_rng([seed, 7])
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    design = str(rng.choice(list(DESIGNS), p=list(DESIGNS.values())))
    listed = [n for n in (*WRENCH, *SENSORS, *DRIVE) if n not in without]
    ids = {
        "clean": [],
        "single": [listed[seed % len(listed)]],  # every cause is hidden about as often
        "pair": [str(n) for n in rng.choice(listed, 2, replace=False)],
        "unlisted": [list(STRANGE)[seed % len(STRANGE)]],
    }[kind]
    factors = {name: float(RANGE ** rng.uniform(-0.5, 0.5)) for name in ids}
    return {
        "kind": kind,
        "design": design,
        "effects": {name: values_of(name, factors[name], rng) for name in ids},
        "factors": factors,
    }


def values_of(name: str, factor: float, rng: np.random.Generator) -> dict[str, float]:
    """Parameters of a cause of `factor` times its typical size, as they are planted."""
    how = ALL[name]
    size = factor * how.typical * (rng.choice([-1.0, 1.0]) if how.signed else 1.0)
    if how.which == "vector":
        direction = rng.standard_normal(len(how.names))
        deviations = dict(zip(how.names, size * direction / np.linalg.norm(direction)))
    else:
        deviations = {str(rng.choice(how.names)) if how.which == "pick" else how.names[0]: size}
    limits = (OFFERED | UNLISTED)[name][0]
    values = {}
    for key, deviation in deviations.items():
        if name == "inertia":
            # no body has a moment of inertia that is more than the two others together, or less than their difference
            others = [_own_inertia(k) for k in how.names if k != key]
            wanted = _own_inertia(key) + deviation * _own_inertia(key)
            values[key] = float(np.clip(wanted, 1.02 * abs(others[0] - others[1]), 0.98 * sum(others)))
        else:
            values[key] = float(np.clip(how.neutral + deviation, limits[key].low, limits[key].high))
    if name == "payload_swing":
        values["length"] = float(rng.uniform(0.2, 0.9))
    return values


def _own_inertia(name: str) -> float:
    k = "xyz".index(name[1])
    return float(BASE_INERTIA[k, k])


def deviation(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Planted values as deviations from what the vehicle has anyway; a load at the length that the catalogue has."""
    if name == "payload_swing":
        shown = min(LOAD_LENGTHS, key=lambda n: abs(np.log(LOAD_LENGTHS[n] / (0.85 * values["length"]))))
        return {shown: values["mass"]}
    how = ALL[name]
    return {k: v - (_own_inertia(k) if name == "inertia" else how.neutral) for k, v in values.items() if k in how.names}


class World(NamedTuple):
    """Conditions that all flights of a data set share: a number, keys of a campaign; telemetry  are speeds logged?"""

    number: int
    config: dict[str, Any]
    telemetry: bool = True

    @property
    def folder(self) -> str:
        """Folder of its healthy flights, below that of the mild world."""
        own = f"world-{self.number}" if self.number else "."
        return own if self.telemetry else f"{own}/commands-only"

    @property
    def learned(self) -> Sequence[int]:
        """Seeds of the flights that its model is identified from."""
        return LEARNED[:LEARNED_IN_WORLDS] if self.number else LEARNED


MILD = World(0, {})


@functools.cache
def world(number: int, telemetry: bool = True) -> World:
    """The world of a number from 0 to WORLDS - 1."""
    return World(number, draw_world(number) if number else MILD.config, telemetry)


class Recorded(NamedTuple):
    """A flight's raw files and how they are read."""

    source: dict[str, Any]
    quadrotor: dict[str, Any]


def record(
    folder: Path, key: str, profile: str, seed: int, effects: Mapping[str, Any], seconds: float,
    of: World = MILD, session: str = "",
) -> Recorded:  # fmt: skip
    """Make a flight with nuisance and write its raw log and capture into the folder.

    of  its world; session  names the flights that share their session's deviations
    """
    seed += of.number * 1_000_000
    flight = {"key": key, "profile": profile, "seed": seed, "effects": effects, "session": session}
    config = {"duration": seconds, "nuisance": 1.0, **of.config}
    campaign = read_campaign({**config, "seed": max(of.number, 1), "flights": [flight]}, key)
    made = make_flight(campaign, campaign.flights[0])
    onboard, capture = str(folder / f"{key}.bbl"), str(folder / f"{key}.csv")
    write_flight(made, onboard, capture, folder / f"{key}.truth.parquet")
    (folder / f"{key}.truth.parquet").unlink()
    if not of.telemetry:
        withhold_telemetry(Path(onboard))
    source = {
        "flight": key, "quadrotor": campaign.quadrotor, "flight controller": "betaflight", "rigid body": "MadeBeetle",
        "onboard": onboard, "capture": capture, "log number": None,
    }  # fmt: skip
    return Recorded(source, _quadrotor(of.number))


def withhold_telemetry(onboard: Path) -> None:
    """Rename the fields of rotor speeds in a made log, so that readers find none, as with DShot in one direction."""
    text, end, frames = onboard.read_bytes().partition(b"H fields_disabled_mask")
    text = text.replace(b"eRPM[", b"none[").replace(b"H dshot_bidir:1", b"H dshot_bidir:0")
    onboard.write_bytes(text + end + frames)


@functools.cache
def _quadrotor(number: int) -> dict[str, Any]:
    """The configuration that a lab of that world writes, with noise statistics of a rest log."""
    config = {"flights": [{"key": "rest"}], "seed": max(number, 1), **world(number).config}
    return quadrotor_configuration(read_campaign(config, "rest"))


def processed(recorded: Recorded, compared: bool, calibration: Mapping[str, Any] | None = None) -> Flown:
    """Import and filter a flight."""
    airframe = read_airframe(recorded.quadrotor, "made")
    frame, about = import_flight(recorded.source, recorded.quadrotor, {}, calibration)
    filtered = filter_flight(frame, about, airframe, {})
    return Flown(recorded.source["flight"], compared, frame, about, filtered.with_gravity, filtered.metadata, airframe)


def affected(
    folder: Path, seed: int, effects: Mapping[str, Any], seconds: float, number: int = 4,
    restless: Mapping[str, float] | None = None, of: World = MILD,
) -> list[Recorded]:  # fmt: skip
    """Some flights with the same causes, of one session.

    restless  {cause: standard deviation of each of its parameters} that each flight draws its own values of, about none
    """
    rng = np.random.default_rng([seed, 9])
    each = [{**effects, **_own(restless or {}, rng)} for _ in range(number)]
    return [
        record(folder, f"flight-{k}", PROFILES[k % len(PROFILES)], 100_000 + seed * 10 + k, own, seconds, of,
               session_of(seed, of))
        for k, own in enumerate(each)
    ]  # fmt: skip


def session_of(seed: int, of: World) -> str:
    """Session of a flight: two for healthy flights, one for each draw; none in the mild world."""
    if not of.number:
        return ""
    return f"reference-{seed // 4 % 2}" if seed in (*LEARNED, *REFERENCE) else f"draw-{seed}"


def _own(restless: Mapping[str, float], rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """One flight's own values."""
    return {n: {p: ALL[n].neutral + std * float(rng.standard_normal()) for p in ALL[n].names}
            for n, std in restless.items()}  # fmt: skip


def healthy(folder: Path, seed: int, of: World = MILD) -> tuple[Recorded, Flown]:
    """A flight without causes, made once and kept in the world's folder below `folder`."""
    folder, key = folder / of.folder, f"healthy-{seed}"
    recorded = folder / f"{key}.json"
    if recorded.is_file():
        kept = read_json(recorded)
        airframe = read_airframe(kept["quadrotor"], "made")
        tables = [read_table(folder / f"{key}.{kind}.parquet") for kind in ("imported", "filtered")]
        flown = Flown(key, False, tables[0], kept["imported"], tables[1], kept["filtered"], airframe)
        return Recorded(kept["source"], kept["quadrotor"]), flown
    folder.mkdir(parents=True, exist_ok=True)
    made = record(folder, key, PROFILES[seed % len(PROFILES)], seed, {}, SECONDS, of, session_of(seed, of))
    flown = processed(made, False)
    for kind, table in (("imported", flown.imported), ("filtered", flown.filtered)):
        write_table(folder / f"{key}.{kind}.parquet", table, dict.fromkeys(table, ("", "")))
    about = {"imported": flown.metadata, "filtered": flown.filtered_metadata}
    write_json(recorded, json.loads(json.dumps({**made._asdict(), **about}, default=_plain)))
    return made, flown


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)


@functools.cache
def healthy_model(folder: Path, number: int = 0, telemetry: bool = True) -> Model:
    """The model that the bundled example's settings make of a world's healthy flights, identified once and kept."""
    of = world(number, telemetry)
    path = folder / of.folder / "model.json"
    if not path.is_file():
        write_json(path, identified([healthy(folder, seed, of)[1] for seed in of.learned]))
    return Model(read_json(path))


def identified(flown: Sequence[Flown]) -> dict[str, Any]:
    """The document of the model that the bundled example's settings make of some flights of one vehicle."""
    flights, airframe = {f.key: f.filtered for f in flown}, flown[0].airframe
    masses = {f.key: f.filtered_metadata["mass"] for f in flown}
    drive, _ = rotor_speeds_of(flights, airframe, masses, {})
    flights = {f.key: add_estimated_speeds(f.filtered, f.filtered_metadata, drive) for f in flown}
    ages = list_telemetry_corrections({f.key: {"imported": f.metadata} for f in flown})
    settings = read_json(ROOT / "config/models/example.json")
    asked = settings["identification parameters"]
    specification = read_json(ROOT / f"config/polynomials/{asked['polynomial specification file']}.json")
    roles = partition(flights, (), settings["data partitioning"])
    common = shared(flights, roles, airframe, masses=masses, aged=ages, drive=drive)
    parts = {
        axis: fit_axis(
            axis, flights, roles, airframe, common, {**asked["polynomial"], "bootstrap": 0},
            read_specification(specification, axis, "specification"),
        )
        for axis in AXES
    }  # fmt: skip
    return assemble_model(parts, common, {"id": "healthy", "airframe": airframe})


def references(folder: Path, seed: int, number: int = 4, of: World = MILD) -> list[tuple[Recorded, Flown]]:
    """Some healthy flights that did not make the model, one of each profile; of two sessions but in the mild world."""
    rng = np.random.default_rng([seed, 8])
    halves = rng.permutation(np.arange(number) % 2) if of.number else rng.integers(0, 2, number)
    return [healthy(folder, REFERENCE[k], of) for k in halves * 4 + np.arange(number)]


def trained(folder: Path, seed: int, number: int = 4, of: World = MILD) -> list[tuple[Recorded, Flown]]:
    """Some of the flights that made the model, evenly taken from all; the seed changes nothing."""
    seeds = of.learned
    return [healthy(folder, seeds[round(k * (len(seeds) - 1) / (number - 1))], of) for k in range(number)]


def with_speeds(flown: Flown, model: Model) -> Flown:
    """The flight with the rotor speeds that the model's map makes of its commands, where it measures none."""
    table = add_estimated_speeds(flown.filtered, flown.filtered_metadata, map_of(model.document), trimmed=False)
    return dataclasses.replace(flown, filtered=table)


def again(recorded: Sequence[Recorded], flown: Sequence[Flown], calibrations: Sequence[Any]) -> list[Flown]:
    """The flights processed anew, those with a calibration."""
    return [
        f if c is None else dataclasses.replace(processed(r, f.compared, c), compared=f.compared)
        for r, f, c in zip(recorded, flown, calibrations, strict=True)
    ]
