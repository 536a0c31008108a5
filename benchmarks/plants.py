"""Faults planted in real recordings: are they named, and nothing that the unplanted recording does not show?

    python benchmarks/plants.py DATA [--plants accelerometer_scale ...] [--out results/benchmarks/plants]

DATA is the folder that holds nanodrone/square_run1..3.csv (public nano-drone identification benchmark). A model is
identified from runs 1 and 2, which are the reference flights as well. The same two runs, compared, and run 3, held out,
get the plant: a column of the file or a key of the configuration is changed, so that no physics of ours is involved.
Run 3 differs from the others by its own trim. One JSON per plant; a run that was stopped goes on where it was.
"""

import argparse
import copy
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
import planted_forces
from hidden import identified
from scipy.spatial.transform import Rotation
from study import ROOT, run, show_found

from quasi.airframe import read_airframe
from quasi.filtering.flight import filter_flight
from quasi.gap.catalogue import catalogue
from quasi.gap.diagnosis import diagnose
from quasi.gap.flights.gathering import gather_all
from quasi.gap.flights.level import Flown
from quasi.gap.levels import sensors_and_drive
from quasi.gap.levels.corrections import for_flight
from quasi.importing.flight import import_flight
from quasi.model.model import Model
from quasi.tables import read_json

EXAMPLE = ROOT / "examples/nanodrone"
SETTINGS = {
    "model": "nanodrone", "extended model ID": "nanodrone-plant", "horizons": [0.1, 0.25, 0.5],
    "false alarm rate": 0.01, "material share": 0.05, "room": None,
}  # fmt: skip
MASS = 0.045  # kg
# flight: run, role
FLIGHTS = {
    "run1": (1, "reference"), "run2": (2, "reference"), "run1-planted": (1, "compared"),
    "run2-planted": (2, "compared"), "run3-planted": (3, "held out"),
}  # fmt: skip
Table = pd.DataFrame
Act = Callable[[Table, str], Table]  # imported flight, its key -> the same with what acts on it


class Plant(NamedTuple):
    """One fault.

    right  ids of which one must be named or stand in a tie, empty where this data cannot ask: then nothing may be named
    value  of the parameter that is stated, None where no single one is; change  of the table; configure  of quadrotor
    and mass; acting  the cause of `planted_forces` and its size
    """

    right: tuple[str, ...]
    parameter: str = ""
    value: float | None = None
    change: Callable[[Table], None] | None = None
    configure: Callable[[dict[str, Any]], None] | None = None
    mass: float = MASS
    acting: tuple[str, float] | None = None


class Written(NamedTuple):
    """How the same recordings are written down: flights {key: (run, role)} in their order; change of every table, the
    planted ones included; configure of every quadrotor; parts {key: (first, last) share of the rows}; healthy: the
    role that has no plant."""

    flights: Mapping[str, tuple[int, str]] = FLIGHTS
    change: Callable[[Table], Table] = lambda table: table
    configure: Callable[[dict[str, Any]], None] = lambda quadrotor: None
    parts: Mapping[str, tuple[float, float]] = {}
    healthy: tuple[str, ...] = ("reference",)

    @property
    def roles(self) -> dict[str, str]:
        """{key: role}."""
        return {key: role for key, (_, role) in self.flights.items()}


AS_IT_IS = Written()


def scaled(columns: list[str], factor: float) -> Callable[[Table], None]:
    """Columns times a factor."""

    def change(table: Table) -> None:
        table[columns] *= factor

    return change


def force_in_body(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Table], None]:
    """The specific force, logged in world axes, changed in body axes (x forward, y left, z up)."""

    def applied(table: Table) -> None:
        q = Rotation.from_quat(table[["qx", "qy", "qz", "qw"]].to_numpy())
        table[["ax", "ay", "az"]] = q.apply(change(q.inv().apply(table[["ax", "ay", "az"]].to_numpy())))

    return applied


def later(column: str, seconds: float) -> Callable[[Table], None]:
    """A time stamp column late by some seconds."""

    def change(table: Table) -> None:
        table[column] += seconds

    return change


def turned(values: np.ndarray, vector: tuple[float, float, float]) -> np.ndarray:
    """What sensor axes turned by a rotation vector (rad, FLU) show."""
    return Rotation.from_rotvec(vector).inv().apply(values)


def moved_marker(x: float) -> Callable[[dict[str, Any]], None]:
    """The configured marker offset is wrong by x, m."""

    def configure(quadrotor: dict[str, Any]) -> None:
        quadrotor["optitrack marker cg offset"] = {"x": str(x), "y": "0", "z": "0"}

    return configure


def configured(**changes: str) -> Callable[[dict[str, Any]], None]:
    """Keys of the quadrotor's configuration with other values; `_` in a name stands for a space."""

    def configure(quadrotor: dict[str, Any]) -> None:
        quadrotor |= {name.replace("_", " "): value for name, value in changes.items()}

    return configure


def stretched(column: str, rate: float) -> Callable[[Table], None]:
    """A time stamp column whose clock runs too fast by a rate, s/s."""

    def change(table: Table) -> None:
        first = table[column].iloc[0]
        table[column] = first + (1.0 + rate) * (table[column] - first)

    return change


def reordered(*order: int, kinds: tuple[str, ...] = ("m{}_erpm", "m{}_thrust")) -> Callable[[Table], None]:
    """Rotor 1 to 4 logged in the columns of these numbers."""

    def change(table: Table) -> None:
        for kind in kinds:
            table[[kind.format(n) for n in order]] = table[[kind.format(i) for i in range(1, 5)]].to_numpy()

    return change


def raised(column: str, size: float) -> Callable[[Table], None]:
    """A constant added to a column."""

    def change(table: Table) -> None:
        table[column] += size

    return change


ERPM = [f"m{i}_erpm" for i in range(1, 5)]
IXX, IZZ = 2.3951e-5, 3.2347e-6  # kg m2, as configured
ACCELEROMETER, ROTOR = ("accelerometer_scale",), ("rotor_effectiveness",)
POINTS, SPEEDS = ("marker_offset", "imu_lever_arm"), ("rotor_speed_scale", "thrust_factor")
NOTHING, ORDER = (), ("rotor_order",)


def rotor(number: int, factor: float) -> Plant:
    """The speed column of one rotor scaled: it makes 1/factor^2 of the thrust that its speed says."""
    return Plant(ROTOR, f"rotor{number}", factor**-2.0, scaled([f"m{number}_erpm"], factor))


def inertia(roll_and_pitch: float, yaw: float, parameter: str, value: float) -> Plant:
    """A configured inertia that is wrong by factors."""
    wrong = f"[{roll_and_pitch * IXX}, 0, 0; 0, {roll_and_pitch * IXX}, 0; 0, 0, {yaw * IZZ}]"
    return Plant(("inertia",), parameter, value, configure=configured(moment_of_inertia=wrong))


def acting(cause: str, size: float, parameter: str) -> Plant:
    """A force or moment that the vehicle flew the same path in spite of."""
    return Plant((cause,), parameter, 1.0 + size if parameter == "factor" else size, acting=(cause, size))


PLANTS: dict[str, Plant] = {
    "nothing": Plant(NOTHING),
    "accelerometer x 1.03": Plant(ACCELEROMETER, "z", 1.03, force_in_body(lambda f: 1.03 * f)),
    "accelerometer x 0.96": Plant(ACCELEROMETER, "z", 0.96, force_in_body(lambda f: 0.96 * f)),
    "accelerometer x 1.015": Plant(ACCELEROMETER, "z", 1.015, force_in_body(lambda f: 1.015 * f)),
    "accelerometer z x 1.05": Plant(ACCELEROMETER, "z", 1.05, force_in_body(lambda f: f * [1.0, 1.0, 1.05])),
    "accelerometer z x 0.97": Plant(ACCELEROMETER, "z", 0.97, force_in_body(lambda f: f * [1.0, 1.0, 0.97])),
    "markers 15 mm ahead": Plant(POINTS, "x", -0.015, configure=moved_marker(0.015)),
    "markers 15 mm behind": Plant(POINTS, "x", 0.015, configure=moved_marker(-0.015)),
    "markers 25 mm ahead": Plant(POINTS, "x", -0.025, configure=moved_marker(0.025)),
    "markers 25 mm behind": Plant(POINTS, "x", 0.025, configure=moved_marker(-0.025)),
    **{f"rotor {i} x {f}": rotor(i, f) for i, f in (
        (1, 0.9), (1, 0.95), (1, 0.96), (1, 1.05), (2, 0.9), (2, 0.95), (2, 1.05), (3, 0.97), (3, 0.95), (3, 1.06),
        (3, 1.1), (4, 0.95), (4, 1.04), (4, 1.1),
    )},
    "all rotors x 0.9": Plant(SPEEDS, "scale", 0.9, scaled(ERPM, 0.9)),
    "all rotors x 1.07": Plant(SPEEDS, "scale", 1.07, scaled(ERPM, 1.07)),
    "all rotors x 12/14": Plant(SPEEDS, "scale", 12 / 14, configure=lambda q: q.update({"motor poles": 14})),
    "mass 10 % low": Plant(("mass",), "mass", MASS, mass=MASS / 1.1),
    "mass 8 % high": Plant(("mass",), "mass", MASS, mass=MASS * 1.08),
    "mass 15 % high": Plant(("mass",), "mass", MASS, mass=MASS * 1.15),
    "inertia x 1.3": inertia(1.3, 1.3, "Ixx", IXX),
    "inertia x 0.75": inertia(0.75, 0.75, "Ixx", IXX),
    "yaw inertia x 1.5": inertia(1.0, 1.5, "Izz", IZZ),
    # a configured arm takes part in nothing that is measured, and the model has its own
    "arm x 1.1": Plant(NOTHING, configure=configured(b="0.0549")),
    "rotors 1 and 3 exchanged": Plant(ORDER, "rotor1", 3.0, change=reordered(3, 2, 1, 4)),
    "rotors 1 and 2 exchanged": Plant(ORDER, "rotor1", 2.0, change=reordered(2, 1, 3, 4)),
    "rotors numbered from another corner": Plant(ORDER, "rotor1", 2.0, change=reordered(2, 3, 4, 1)),
    "speeds of rotors 2 and 4 exchanged": Plant(
        ORDER, "rotor2", 4.0, change=reordered(1, 4, 3, 2, kinds=("m{}_erpm",))
    ),
    # import settles the stamps and the filter takes constant biases off; without captured attitude no more can be asked
    "motors 30 ms late": Plant(NOTHING, change=later("ros_timestamp_motors", 0.03)),
    "motors 15 ms late": Plant(NOTHING, change=later("ros_timestamp_motors", 0.015)),
    "motors 20 ms early": Plant(NOTHING, change=later("ros_timestamp_motors", -0.02)),
    "motors' clock 300 ppm fast": Plant(NOTHING, change=stretched("ros_timestamp_motors", 3e-4)),
    "accelerometer 20 ms late": Plant(NOTHING, change=later("ros_timestamp_image_accel", 0.02)),
    "accelerometer z + 0.5": Plant(NOTHING, change=force_in_body(lambda f: f + [0.0, 0.0, 0.5])),
    "accelerometer x + 0.6": Plant(NOTHING, change=force_in_body(lambda f: f + [0.6, 0.0, 0.0])),
    "imu pitched 3 deg": Plant(NOTHING, change=force_in_body(lambda f: turned(f, (0.0, 0.052, 0.0)))),
    "imu rolled 3 deg": Plant(NOTHING, change=force_in_body(lambda f: turned(f, (0.052, 0.0, 0.0)))),
    "gyro x 1.05": Plant(NOTHING, change=scaled(["wx", "wy", "wz"], 1.05)),
    "gyro x + 0.1": Plant(NOTHING, change=raised("wx", 0.1)),
    # forces of some percent of the weight at 1 m/s; what holds a yaw moment is known to a half only
    "rotor_drag of 4e-06": Plant(("rotor_drag",), "k", 4e-6, acting=("drag_at_centre", 4e-6)),
    **{f"{cause} of {size:g}": acting(cause, size, name) for cause, name, size in (
        ("body_drag", "c", 0.02), ("blade_flapping", "k", 2e-8),
        ("translational_lift", "k", 0.015), ("axial_inflow", "k", 4e-6), ("ground_effect", "c", 4.0),
        ("rotor_interference", "k", 0.2), ("thrust_drift", "rate", 0.002), ("thrust_factor", "factor", 0.08),
        ("cg_offset", "x", 0.002), ("tether", "k", 0.02), ("wind", "", 0.02),
    )},
}  # fmt: skip


def read(
    data: Path, key: str, planted: Plant, folder: Path, written: Written
) -> tuple[Flown, dict[str, Any], dict[str, Any], Act | None]:
    """A run imported and filtered, with its source, quadrotor and what acts on it for another import."""
    run_number, role = written.flights[key]
    table = pd.read_csv(data / f"nanodrone/square_run{run_number}.csv")
    first, last = (round(share * len(table)) for share in written.parts.get(key, (0.0, 1.0)))
    table = table.iloc[first:last].reset_index(drop=True)
    quadrotor = copy.deepcopy(read_json(EXAMPLE / "config/NanoDroneConfig.json"))
    mass = MASS
    plant = None if role in written.healthy else planted
    if plant is not None:
        mass = plant.mass
        if plant.change is not None:
            plant.change(table)
        if plant.configure is not None:
            plant.configure(quadrotor)
    table = written.change(table)
    written.configure(quadrotor)
    path = folder / f"{key}.csv"
    table.to_csv(path, index=False)
    quadrotor["file"] = "NanoDroneConfig.json"
    source = {
        "flight": key, "quadrotor": "NanoDrone", "flight controller": "table", "rigid body": "", "onboard": str(path),
        "capture": None, "log number": None,
    }  # fmt: skip
    airframe = read_airframe(quadrotor, quadrotor["file"], mass)
    flown = processed(source, quadrotor, airframe, role != "reference", None)
    if plant is not None and plant.acting is not None:
        act = planted_forces.planted({key: flown}, *plant.acting)
        return processed(source, quadrotor, airframe, flown.compared, None, act), source, quadrotor, act
    return flown, source, quadrotor, None


def processed(
    source: Mapping[str, Any], quadrotor: Mapping[str, Any], airframe: Any, compared: bool,
    calibration: Mapping[str, Any] | None, act: Act | None = None,
) -> Flown:  # fmt: skip
    """A flight imported, with what acts on it, and filtered as the example's processing configuration asks."""
    options = read_json(EXAMPLE / "config/processing.json")
    imported, about = import_flight(source, quadrotor, options["data importing"], calibration)
    if act is not None:
        imported = act(imported, source["flight"])
    made = filter_flight(imported, about, airframe, options["data filtering"])
    return Flown(source["flight"], compared, imported, about, made.with_gravity, made.metadata, airframe)


def draw(name: str, data: Path, written: Written = AS_IT_IS) -> dict[str, Any]:
    """Plant, diagnose and compare."""
    plant, effects, roles = PLANTS[name], catalogue(), written.roles
    with tempfile.TemporaryDirectory() as folder:
        made = {key: read(data, key, plant, Path(folder), written) for key in roles}
        flights = {k: flown for k, (flown, *_) in made.items()}
        model = Model(identified([flights[k] for k, r in roles.items() if r == "reference"]))

        def again(flown: Flown, calibration: Mapping[str, Any] | None) -> Flown:
            if calibration is None:
                return flown
            _, source, quadrotor, act = made[flown.key]
            return processed(source, quadrotor, flown.airframe, flown.compared, calibration, act)

        learning = [f for k, f in flights.items() if roles[k] != "held out"]
        found, _ = sensors_and_drive.examine(learning, model.document, SETTINGS, effects, again, 1)
        after = {k: again(f, for_flight(found, f.compared)) for k, f in flights.items()}
        read_flights = {k: (f.filtered, f.filtered_metadata, f.airframe) for k, f in after.items()}
        evidence, lost = gather_all(read_flights, model, 100.0)
        document = diagnose(
            model, found, evidence, {k: f.filtered for k, f in after.items()}, roles, effects, SETTINGS,
            tuple([f for k, f in part.items() if roles[k] == "held out"] for part in (flights, after)), name, lost,
        ).document  # fmt: skip
    kept = ("verdict", "summary", "effects", "ties", "unexplained", "losses", "candidates", "base model", "notes")
    return {k: document[k] for k in kept}


def judge(name: str, found: Mapping[str, Any], plain: Mapping[str, Any]) -> dict[str, Any]:
    """What is right of a diagnosis, against that of the unplanted recording."""
    plant = PLANTS[name]
    before = {e["id"] for e in plain["effects"]} | {i for t in plain["ties"] for i in t["ids"]}
    named = [e["id"] for e in found["effects"]]
    ties = [t["ids"] for t in found["ties"]]
    hit = any(i in plant.right for i in named) or any(set(t) & set(plant.right) for t in ties)
    extra = [i for i in named if i not in plant.right and i not in before]
    extra += ["/".join(t) for t in ties if not set(t) & (set(plant.right) | before)]
    error = None
    for e in found["effects"]:
        if e["id"] in plant.right and plant.value is not None and plant.parameter in e["parameters"]:
            own = e["parameters"][plant.parameter]
            error = (own["value"] - plant.value) / max(own["std"], 1e-12)
    return {"right": hit or not plant.right, "extra": extra, "error in std": error}


def main() -> None:
    """Run all plants and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--plants", nargs="*", default=[], help="parts of names; all without")
    parser.add_argument("--out", type=Path, default=ROOT / "results/benchmarks/plants")
    arguments = parser.parse_args()
    names = [n for n in PLANTS if n == "nothing" or not arguments.plants or any(p in n for p in arguments.plants)]
    results = run(
        [{"plant": n} for n in names], lambda s: draw(s["plant"], arguments.data), arguments.out, Path(__file__)
    )
    plain = results[0]
    right = clean = 0
    for name, found in zip(names, results):
        told = judge(name, found, plain)
        right, clean = right + told["right"], clean + (not told["extra"])
        print(f"{name}: {'right' if told['right'] else 'MISSED'}, {found['verdict']}"
              + (f", further: {', '.join(told['extra'])}" if told["extra"] and name != "nothing" else ""))  # fmt: skip
        show_found(found)
        if told["error in std"] is not None:
            print(f"   parameter off by {told['error in std']:.1f} standard errors")
    print(f"{right} of {len(names)} right, {clean} without further names")


if __name__ == "__main__":
    main()
