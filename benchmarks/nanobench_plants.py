"""Faults planted in real flights without rotor speeds: are they named, and nothing that the flights do not show?

    python benchmarks/nanobench_plants.py DATA FOLDER [--plants mass ...] [--jobs 2] [--record]

DATA holds nanobench/: flights of a Crazyflie with commands, battery voltage, IMU and Vicon, of three days. In four of
them rotor 1 is asked for a quarter less, the others for other shares: another vehicle, or other motors. They are left
out. Five make the model. Three of these are the reference flights; the other two, and three that are new, get the
plant; two of the new ones are held out. A plant changes columns of the recordings or keys of the configuration, so that
no physics of ours is involved. What is planted in rotors is planted in their commands: a rotor that is commanded more
for the same thrust is a weak one. Each plant is a gap of the workflow in FOLDER; what is made stays.

Right is what holds a planted cause, by name or in a tie. Wrong is another name of what changed. What is reported as
present in all flights is no plant's: it is printed, and what the flights without a plant do not show is counted. Import
settles late stamps and a turned room: there nothing may be named.
"""

import argparse
import copy
import csv
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from foreign import write_changed
from measured_table import record
from scipy.spatial.transform import Rotation
from study import ROOT, show_found

EXAMPLE = ROOT / "examples/crazyflie"
# flights of NanoBench by their row of the logbook
LEARNING, PLANTED, HELD_OUT = (2, 5, 7, 10, 12), (2, 5, 8, 11, 13), 2
REFERENCES = tuple(row for row in LEARNING if row not in PLANTED)  # a gap refuses a flight in two roles
COMMANDS = [f"motor_motor_m{i}" for i in range(1, 5)]
GYRO, FORCE = ([f"imu_{kind}_{a}" for a in "xyz"] for kind in ("gyro", "acc"))
PLACE, ATTITUDE = ["px", "py", "pz"], ["qx", "qy", "qz", "qw"]
MASS, INERTIA = 0.027, (1.657e-5, 1.666e-5, 2.926e-5)  # kg and kg m2, as configured
Table = pd.DataFrame
Change = Callable[[Table], None]


class Plant(NamedTuple):
    """One fault: right, ids of which one must be named or stand in a tie; empty where import settles it.

    values  {parameter: value to be stated}; change of the table; configure of the quadrotor; mass in the logbook, kg
    """

    right: tuple[str, ...] = ()
    values: Mapping[str, float] = {}
    change: Change = lambda table: None
    configure: Mapping[str, Any] = {}
    mass: float = MASS


def scaled(columns: list[str], *factors: float) -> Change:
    """Columns times factors."""

    def change(table: Table) -> None:
        table[columns] *= np.array(factors)

    return change


def raised(column: str, size: float) -> Change:
    """A constant added to a column."""

    def change(table: Table) -> None:
        table[column] += size

    return change


def later(columns: list[str], rows: int) -> Change:
    """Columns late by some rows of 10 ms; negative: early. The rows without values hold the nearest one."""

    def change(table: Table) -> None:
        table[columns] = table[columns].shift(rows).bfill().ffill()

    return change


def exchanged(first: int, second: int) -> Change:
    """Commands of two rotors logged in the other's column."""

    def change(table: Table) -> None:
        pair = [COMMANDS[first - 1], COMMANDS[second - 1]]
        table[pair] = table[pair[::-1]].to_numpy()

    return change


def turned_imu(*degrees: float) -> Change:
    """What sensor axes turned by a rotation vector, FLU, show."""

    def change(table: Table) -> None:
        for columns in (GYRO, FORCE):
            table[columns] = Rotation.from_rotvec(np.deg2rad(degrees)).inv().apply(table[columns])

    return change


def turned_body(*degrees: float) -> Change:
    """A rigid body whose axes are turned against the vehicle's by a rotation vector, FLU."""

    def change(table: Table) -> None:
        turn = Rotation.from_rotvec(np.deg2rad(degrees))
        table[ATTITUDE] = (Rotation.from_quat(table[ATTITUDE]) * turn).as_quat()

    return change


def turned_room(*degrees: float) -> Change:
    """A capture whose room axes are turned by a rotation vector, z up."""

    def change(table: Table) -> None:
        turn = Rotation.from_rotvec(np.deg2rad(degrees))
        table[PLACE] = turn.apply(table[PLACE])
        table[ATTITUDE] = (turn * Rotation.from_quat(table[ATTITUDE])).as_quat()

    return change


def marker(axis: str, metres: float) -> Plant:
    """A configured place of the markers that is wrong along an axis."""
    place = {a: str(metres if a == axis else 0.0) for a in "xyz"}
    return Plant(("marker_offset", "imu_lever_arm"), {axis: -metres},
                 configure={"optitrack marker cg offset": place})  # fmt: skip


def inertia(*factors: float) -> Plant:
    """A configured inertia (Ixx, Iyy, Izz) that is wrong by factors."""
    rows = (", ".join(str(f * i * (n == k)) for k in range(3)) for n, (f, i) in enumerate(zip(factors, INERTIA)))
    wrong = {f"I{a}{a}": i for a, i, f in zip("xyz", INERTIA, factors) if f != 1.0}
    return Plant(("inertia",), wrong, configure={"moment of inertia": f"[{'; '.join(rows)}]"})


ROTOR, ORDER = ("rotor_effectiveness",), ("rotor_order",)
SHARED = ("thrust_factor", "battery_sag", "thrust_curve", "thrust_drift", "mass", "accelerometer_scale")
LATE = ("motor_lag", "command_delay", "inflow_lag")
BODY, ROOM = ("mocap_misalignment", "imu_misalignment"), ("room_tilt",)
PLANTS: dict[str, Plant] = {
    "nothing": Plant(),
    **{f"commands of rotor {n} x {f}": Plant(ROTOR, {}, scaled([COMMANDS[n - 1]], f)) for n, f in (
        (1, 1.1), (1, 0.85), (2, 1.2), (2, 0.95), (3, 1.15), (3, 0.9), (4, 1.05), (4, 0.8),
    )},
    **{f"all commands x {f}": Plant(SHARED, {}, scaled(COMMANDS, f, f, f, f)) for f in (1.1, 0.9, 0.8)},
    "voltage + 0.3 V": Plant(SHARED, {}, raised("pwr_pm_vbat", 0.3)),
    **{f"mass x {f}": Plant((*SHARED,), {"mass": MASS}, mass=f * MASS) for f in (1.1, 0.9, 0.8, 1.25)},
    "inertia x 1.3": inertia(1.3, 1.3, 1.3),
    "inertia x 0.7": inertia(0.7, 0.7, 0.7),
    "Ixx x 1.4": inertia(1.4, 1.0, 1.0),
    "Izz x 1.5": inertia(1.0, 1.0, 1.5),
    "accelerometer x 1.03": Plant(("accelerometer_scale",), dict.fromkeys("xyz", 1.03), scaled(FORCE, *[1.03] * 3)),
    "accelerometer x 0.95": Plant(("accelerometer_scale",), dict.fromkeys("xyz", 0.95), scaled(FORCE, *[0.95] * 3)),
    "accelerometer z x 1.04": Plant(("accelerometer_scale",), {"z": 1.04}, scaled(FORCE, 1.0, 1.0, 1.04)),
    "gyro x 1.05": Plant(("gyro_scale",), dict.fromkeys("xyz", 1.05), scaled(GYRO, *[1.05] * 3)),
    "gyro z x 0.9": Plant(("gyro_scale",), {"z": 0.9}, scaled(GYRO, 1.0, 1.0, 0.9)),
    "gyro x + 0.1": Plant(("gyro_bias",), {}, raised(GYRO[0], 0.1)),
    "accelerometer y + 0.05 g": Plant(("accelerometer_bias",), {}, raised(FORCE[1], 0.05)),
    "imu turned by 3 deg, x": Plant(BODY, {}, turned_imu(3.0, 0.0, 0.0)),
    "imu turned by 5 deg, z": Plant(BODY, {}, turned_imu(0.0, 0.0, 5.0)),
    "rigid body turned by 4 deg, y": Plant(BODY, {}, turned_body(0.0, 4.0, 0.0)),
    "rigid body turned by 5 deg, z": Plant(BODY, {}, turned_body(0.0, 0.0, 5.0)),
    "room tilted by 3 deg": Plant(ROOM, {}, turned_room(3.0, 0.0, 0.0)),
    "room turned by 40 deg, z": Plant((), {}, turned_room(0.0, 0.0, 40.0)),
    "markers wrong by 20 mm, x": marker("x", 0.02),
    "markers wrong by 30 mm, y": marker("y", 0.03),
    "capture late by 30 ms": Plant((), {}, later([*PLACE, *ATTITUDE], 3)),
    "commands late by 20 ms": Plant(LATE, {}, later(COMMANDS, 2)),
    "commands early by 30 ms": Plant(LATE, {}, later(COMMANDS, -3)),
    "commands of rotors 1 and 2 exchanged": Plant(ORDER, {}, exchanged(1, 2)),
    "commands of rotors 1 and 3 exchanged": Plant(ORDER, {}, exchanged(1, 3)),
}  # fmt: skip


def write_project(data: Path, folder: Path, plants: Mapping[str, Plant]) -> dict[str, str]:
    """The project with the flights of each plant, its configuration and its gap; returns {plant: gap}."""
    book = "data/nanobench_file_log.csv"
    for name in ("config/processing.json", "config/models/nanobench.json"):
        text = json.loads((EXAMPLE / name).read_text(encoding="utf-8"))
        if "processing" in name:
            last = 13 + len(PLANTED) * len(PLANTS)
            text["logging file"] = {"directory": "data", "filename": "nanobench_file_log",
                                    "rows of flights to use (all)": [f"2-{last}"]}  # fmt: skip
        else:
            text["logging file"] |= {"rows of flights to use (all)": list(LEARNING),
                                     "rows of flights for validation": [LEARNING[-1]]}  # fmt: skip
        write_changed(folder / name, json.dumps(text, indent=1))
    write_changed(folder / "config/config.yaml", "{}\n")
    shutil.copytree(data / "nanobench", folder / "data/nanobench", dirs_exist_ok=True)
    with (EXAMPLE / book).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    quadrotor = json.loads((EXAMPLE / "config/Nano.json").read_text(encoding="utf-8"))
    write_changed(folder / "config/Nano.json", json.dumps(quadrotor, indent=1))
    flights, gaps = list(rows), {}
    for number, (name, plant) in enumerate(PLANTS.items()):
        own = f"plant-{number:02d}"
        planted = range(len(flights) + 2, len(flights) + 2 + len(PLANTED))
        for source in PLANTED:
            row = dict(rows[source - 2])
            key = f"{row['Flight key']}-{own}"
            row |= {"Onboard Name": f"{key}.csv", "OB Path": "data/planted", "Flight key": key,
                    "Mass": f"{1e3 * plant.mass:g}", "Flight ID": str(len(flights) + 1),
                    "Drone Config File": own}  # fmt: skip
            path = folder / "data/planted" / row["Onboard Name"]
            if name in plants and not path.is_file():
                table = pd.read_csv(data / "nanobench" / rows[source - 2]["Onboard Name"])
                plant.change(table)
                path.parent.mkdir(exist_ok=True)
                table.to_csv(path, index=False)
            flights.append(row)
        changed = copy.deepcopy(quadrotor) | dict(plant.configure)
        write_changed(folder / f"config/{own}.json", json.dumps(changed, indent=1))
        document = {
            "model": "nanobench", "horizons": [0.1, 0.25, 0.5], "extended model ID": f"nanobench-{own}",
            "logging file": {
                "directory": "data", "filename": "nanobench_file_log",
                "rows of flights to compare (all)": list(planted),
                "rows of flights held out": list(planted)[-HELD_OUT:],
                "rows of reference flights": list(REFERENCES),
            },
        }  # fmt: skip
        write_changed(folder / f"config/gaps/{own}.json", json.dumps(document, indent=1))
        gaps[name] = own
    with (folder / book).open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(flights)
    return {name: gaps[name] for name in plants}


def judge(plant: Plant, found: Mapping[str, Any], plain: set[str]) -> dict[str, Any]:
    """What is right of a diagnosis. plain  names that the flights without a plant have"""
    named = {e["id"] for e in found["effects"]}
    ties = [t["ids"] for t in found["ties"]]
    hit = bool(set(plant.right) & (named | {i for t in ties for i in t}))
    known, new = {*plant.right, *plain}, {e["id"] for e in found["effects"] if e["since"] == "changed"}
    wrong = [i for i in new if i not in known]
    wrong += ["/".join(t["ids"]) for t in found["ties"] if t["since"] == "changed" and not known & set(t["ids"])]
    always = sorted(named - new - known)
    stated = [e["parameters"] for e in found["effects"] if e["id"] in plant.right and e["since"] == "changed"]
    errors = [(p["value"] - plant.values[k]) / p["std"] for own in stated for k, p in own.items()
              if k in plant.values and p["std"]]  # fmt: skip
    return {"right": (hit or not plant.right) and not wrong, "hit": hit, "wrong": wrong, "always": always,
            "errors": errors}  # fmt: skip


def show(name: str, found: Mapping[str, Any], result: Mapping[str, Any]) -> None:
    """Print what was found of a plant."""
    word = "WRONG: " + ", ".join(result["wrong"]) if result["wrong"] else "right" if result["right"] else "MISSED"
    print(f"{name}: {word} ({found['verdict']})")
    show_found(found)


def main() -> None:
    """Plant, diagnose, print, and record when asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--plants", nargs="*", default=[], help="parts of names; all without")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    asked = parser.parse_args()
    chosen = {n: p for n, p in PLANTS.items()
              if n == "nothing" or not asked.plants or any(part in n for part in asked.plants)}  # fmt: skip
    if not (asked.data / "nanobench").is_dir():
        raise SystemExit(f"{asked.data} holds no nanobench/; give the folder that holds NanoBench's flights")
    gaps = write_project(asked.data, asked.folder, chosen)
    targets = {name: asked.folder / f"results/gaps/{gap}/diagnosis.json" for name, gap in gaps.items()}
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(asked.folder),
               f"-j{asked.jobs}", "--keep-going", "--quiet", "all", "--",
               *(str(t.relative_to(asked.folder)) for t in targets.values())]  # fmt: skip
    subprocess.run(command, check=False)  # plants that cannot be diagnosed are reported below
    plain: set[str] = set()
    results: dict[str, dict[str, Any]] = {}
    for name, target in targets.items():
        if not target.is_file():
            print(f"{name}: no diagnosis, see logs/ of the project")
            results[name] = {"right": False, "hit": False, "wrong": [], "always": [], "errors": []}
            continue
        found = json.loads(target.read_text(encoding="utf-8"))
        if name == "nothing":
            plain = {e["id"] for e in found["effects"]} | {i for t in found["ties"] for i in t["ids"]}
        results[name] = judge(PLANTS[name], found, plain)
        show(name, found, results[name])
    errors = np.array([e for r in results.values() for e in r["errors"]])
    values: dict[str, Any] = {
        "plants": len(results), "right": sum(r["right"] for r in results.values()),
        "wrong": sum(bool(r["wrong"]) for r in results.values()),
        "missed": "; ".join(n for n, r in results.items() if not r["right"] and not r["wrong"]) or "none",
        "stated": len(errors), "within": int(np.sum(np.abs(errors) < 2.0)),
        "plain": ", ".join(sorted(plain)) or "nothing", "always": sum(bool(r["always"]) for r in results.values()),
    }  # fmt: skip
    print(values)
    if asked.record:
        record("nanobench_plants", values)


if __name__ == "__main__":
    main()
