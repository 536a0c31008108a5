"""Flights of foreign simulators: does a gap name the one parameter that was changed in them, and nothing else?

    python benchmarks/foreign.py PLACE OUT [--simulators rotorpy mujoco] [--cases mass ...] [--seeds 1 2] [--record]
                                 [--without speeds accelerometer gyro] [--lab rough]

PLACE is a folder with the simulators, which are no dependency of quasi (`pip install --target PLACE --no-deps rotorpy
mujoco drone-models casadi array-api-compat array-api-extra pyflyt pybullet gymnasium farama-notifications
cloudpickle jsbsim`). For each simulator and seed, OUT holds one project
folder, as a lab would have it: four reference flights, and five flights per case, two of them held out. Each case
changes one parameter of the simulator, or of the sensors when the logs are written. The workflow imports, filters,
identifies and compares. Flights and results stay in OUT, so that a second run makes only what is missing.

--lab gives other sensors: "rough" has ten times the noise, half the rate and gaps, "slow" logs at 100 Hz. --without
diagnoses the same logs without rotor speeds, accelerometer or gyro, in their own project folders. Nothing is recorded
of either.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from foreign_cases import SIMULATORS, Case, vehicle_of
from foreign_flights import LABS, Motion, Sensors, Vehicle, film, measure, write_arrays, write_csv, write_vicon
from foreign_pilot import course
from measured_table import RESULTS, record

from quasi.tables import read_json, write_json
from quasi.terms.rotor_map import SPEEDS

ROOT = Path(__file__).resolve().parents[1]
REFERENCES, COMPARED, HELD_OUT = 4, 5, 2
SIGNALS = {"speeds": SPEEDS, "accelerometer": ("ax", "ay", "az"), "gyro": ("p", "q", "r")}
COLUMNS = (
    "Flight key,Quadrotor,Flight controller,Mass,Batteries,Drone Config File,Drone Config Path,Onboard Name,OB Path,"
    "Has OT data,Raw OptiTrack Name,Raw OT Path,Rigid Body Name"
)


def slug(name: str) -> str:
    """A case's name in file names."""
    return re.sub(r"[^\w-]", "", name.replace(" ", "-"))


def write_flight(folder: Path, simulator: str, key: str, seeds: tuple[int, int], case: Case) -> None:
    """Fly, and write log and capture, where they are not there yet; seeds of the course and of the sensors.

    A folder whose name ends with one of `LABS` gets its sensors.
    """
    module = vehicle_of(simulator)
    arrays = module.vehicle().arrays
    onboard, capture = folder / f"data/raw/{key}.{'npz' if arrays else 'csv'}", folder / f"data/raw/{key}-capture.csv"
    if onboard.is_file():
        return
    onboard.parent.mkdir(parents=True, exist_ok=True)
    motion = flown(folder / f"motions/{seeds[0]}.npz", module, seeds[0], case)
    lab = LABS.get(folder.name.rsplit("-", 1)[-1], {})
    rng, sensors = np.random.default_rng(seeds[1]), Sensors(**{**module.SENSORS, **lab, **case.sensors})
    board, poses = measure(motion, sensors, rng), film(motion, sensors, rng)
    if arrays:
        write_arrays(onboard, board, poses)
    else:
        write_vicon(capture, poses)
        write_csv(onboard, board)


def flown(path: Path, module: Any, seed: int, case: Case) -> Motion:
    """The motion of a course; that of cases which change the sensors alone is flown once."""
    if path.is_file():
        with np.load(path) as held:
            return Motion(**held)
    motion = module.fly(course(seed), **case.change)
    path.parent.mkdir(exist_ok=True)
    np.savez(path, **asdict(motion))
    return motion


def write_project(
    folder: Path, simulator: str, seed: int, cases: Mapping[str, Case], lacking: Sequence[str] = ()
) -> None:
    """Flights, logbook, quadrotor and the configurations of processing, model and gaps; lacking  what is not read."""
    vehicle: Vehicle = vehicle_of(simulator).vehicle()
    numbers = list(SIMULATORS[simulator]())
    keys = [f"reference-{i + 1}" for i in range(REFERENCES)]
    for i, key in enumerate(keys):
        write_flight(folder, simulator, key, (1000 * seed + i, 1000 * seed + i), Case())
    rows: dict[str, list[int]] = {}
    for name, case in cases.items():
        own = [f"{slug(name)}-{i + 1}" for i in range(COMPARED)]
        for i, key in enumerate(own):
            own_seed = 1000 * seed + 20 * (1 + numbers.index(name)) + i
            flown_seed = own_seed if case.change else 1000 * seed + 20 + i
            write_flight(folder, simulator, key, (flown_seed, own_seed), case)
        rows[name] = list(range(2 + len(keys), 2 + len(keys) + COMPARED))
        keys += own
    line = "{0},{1},table,{2:g},1,vehicle,data,{0},data/raw,"
    line += "N,,," if vehicle.arrays else "Y,{0}-capture,data/raw,Quad"
    text = "\n".join([COLUMNS, *(line.format(k, vehicle.name, 1000 * vehicle.mass) for k in keys), ""])
    write_changed(folder / "data/logbook.csv", text)
    flown = {"directory": "data", "filename": "logbook"}
    references = list(range(2, 2 + REFERENCES))
    document = vehicle.document()
    gone = {name for what in lacking for name in SIGNALS[what]}
    for source in document["table columns"]["sources"]:
        source["columns"] = {k: c for k, c in source["columns"].items() if k not in gone}
    document["table columns"]["sources"] = [s for s in document["table columns"]["sources"] if s["columns"]]
    documents: dict[str, Any] = {
        "data/vehicle.json": document,
        "config/processing.json": {"logging file": {**flown, "rows of flights to use (all)": [f"2-{len(keys) + 1}"]}},
        "config/models/base.json": {
            "logging file": {**flown, "rows of flights to use (all)": references,
                             "rows of flights for validation": references[-1:]},
            "filtered data save directory": "withGravity",
            "identification parameters": {"polynomial specification file": "physical"},
        },
    }  # fmt: skip
    for name, own in rows.items():
        documents[f"config/gaps/{slug(name)}.json"] = {
            "model": "base", "extended model ID": f"base-{slug(name)}",
            "logging file": {**flown, "rows of flights to compare (all)": own,
                             "rows of flights held out": own[-HELD_OUT:], "rows of reference flights": references},
        }  # fmt: skip
    for path, content in documents.items():
        write_changed(folder / path, json.dumps(content, indent=1))
    write_changed(folder / "config/config.yaml", "{}\n")


def is_flown(folder: Path, name: str) -> bool:
    """Whether all flights of a case are there."""
    return any((folder / "data/raw").glob(f"{slug(name)}-{COMPARED}.*"))


def write_changed(path: Path, text: str) -> None:
    """Write a file that is new or differs, so that the workflow repeats no more than it must."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.is_file() or path.read_text() != text:
        path.write_text(text)


def diagnose(folder: Path, name: str) -> dict[str, Any]:
    """The diagnosis that the workflow makes of a case."""
    target = f"results/gaps/{slug(name)}/diagnosis.json"
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(folder), "-j1", target]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    if done.returncode:
        raise SystemExit(f"{folder}, {name}: the workflow failed\n{done.stdout[-3000:]}\n{done.stderr[-5000:]}")
    return json.loads((folder / target).read_text())


def judge(case: Case, found: Mapping[str, Any], always: frozenset[str]) -> dict[str, Any]:
    """What is right: {"verdict", "named", "ties", "wrong", "hit", "score"}.

    A name is wrong where neither `right` nor `also` holds it, a tie where no member is there. What the simulator has in
    every flight (`always`) is true where it is reported so; the score adds it.
    """
    named = {e["id"]: e for e in found["effects"]}
    ties = [t["ids"] for t in found["ties"]]
    true = {*case.right, *case.second, *case.also}
    own = [i for i, e in named.items() if i not in true and i in always and e["since"] == "always"]
    wrong = [i for i in named if i not in true and i not in own] + ["/".join(t) for t in ties if not true & set(t)]
    causes = [ids for ids in (case.right, case.second) if ids]
    hits = [any(i in named for i in ids) for ids in causes]
    found_of = [hit or any(set(ids) & set(t) for t in ties) for hit, ids in zip(hits, causes)]
    hit, tied = bool(hits) and all(hits), bool(found_of) and all(found_of)
    if case.unexplained:
        hit = bool(found["unexplained"])
    if wrong:
        score = "WRONG NAME" if case.right or case.unexplained else "FALSE ALARM"
    elif hit or tied:
        score = "right" if hit else "right, in a tie"
    elif case.may_miss and found["verdict"] == "agrees":
        score = "right"
    elif any(found_of):
        score = "missed one"
    else:
        score = "missed" if case.right or case.unexplained else "FALSE ALARM"
    score += "".join(f"; {i} is always there" for i in own)
    return {"verdict": found["verdict"], "named": list(named), "ties": ties, "wrong": wrong, "score": score}


def show(title: str, case: Case, found: Mapping[str, Any], result: Mapping[str, Any], seconds: float) -> None:
    """Print what was found of a case."""
    print(f"{title}: {result['score']} ({found['verdict']}, {seconds:.0f} s)")
    for e in found["effects"]:
        mark = "wrong " if e["id"] in result["wrong"] else ""
        values = []
        for k, p in e["parameters"].items():
            known = case.value.get(k) if e["id"] in case.right + case.second else None
            values.append(
                f"{k} {p['value']:.4g} +- {p['std']:.2g}" + (f" (true {known:.4g})" if known is not None else "")
            )
        print(f"   {mark}name {e['id']}, {e['since']}, probability {e.get('probability')}: {', '.join(values)}")
    for tie in found["ties"]:
        print(f"   tie {' / '.join(tie['ids'])}")
    for left in found["unexplained"]:
        print(f"   unexplained {left['channel']} along {left['where']}, share {left['share']}")
    for loss in found.get("losses", ()):
        print(f"   loss: {loss['text']}")
    if case.right and result["score"] == "missed":
        for c in found["candidates"]:
            if c["id"] in case.right:
                print(f"   candidate {c['id']}: {c.get('why_not')}")
    sys.stdout.flush()


def answer(found: Mapping[str, Any]) -> str:
    """What a diagnosis names, in a cell: the first three parameters of each cause."""
    parts = []
    for e in found["effects"]:
        shown = list(e["parameters"].items())[:3]
        values = ", ".join(f"{k} {p['value']:.4g} ± {p['std']:.2g}" for k, p in shown)
        parts.append(f"`{e['id']}` {values}")
    parts += [f"tie of {', '.join(f'`{i}`' for i in t['ids'])}" for t in found["ties"]]
    parts += [f"unexplained {left['channel']}" for left in found["unexplained"]]
    return "; ".join(parts) or found["verdict"]


def merged(before: list[list[str]], rows: list[list[str]]) -> list[list[str]]:
    """Rows of a table with those that were flown now: by simulator, seed and order of the cases."""
    every = {tuple(row[:2]): row for row in [*before, *rows]}
    order = {name: list(cases()) for name, cases in SIMULATORS.items()}

    def place(row: list[str]) -> tuple[int, int, int]:
        simulator, seed = row[0].split()
        return list(SIMULATORS).index(simulator), int(seed), order[simulator].index(row[1])

    return sorted(every.values(), key=place)


def figures(rows: list[list[str]]) -> dict[str, int]:
    """Counts of a table."""
    clean = [row for row in rows if row[1] == "clean"]
    return {
        "sets": len(rows),
        "clean": len(clean),
        "agree": sum(row[-1] == "right" for row in clean),
        "right": sum(row[-1].startswith("right") for row in rows),
        "missed": sum(row[-1].startswith("missed") for row in rows),
        "wrong": sum(row[-1].startswith(("WRONG NAME", "FALSE ALARM")) for row in rows),
    }


def main() -> None:
    """Fly, diagnose, print, and record when asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("place", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--simulators", nargs="*", default=list(SIMULATORS), choices=list(SIMULATORS))
    parser.add_argument("--cases", nargs="*", default=[], help="parts of names; all without")
    parser.add_argument("--seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--without", nargs="*", default=[], choices=list(SIGNALS), help="signals that are withheld")
    parser.add_argument("--lab", choices=list(LABS), help="other sensors")
    arguments = parser.parse_args()
    if arguments.record and (arguments.without or arguments.lab):
        parser.error("--record is for whole logs of usual sensors")
    sys.path.append(str(arguments.place))
    tally: dict[str, list[str]] = {}
    rows: list[list[str]] = []
    for simulator in arguments.simulators:
        every = SIMULATORS[simulator]()
        cases = {k: c for k, c in every.items() if not arguments.cases or any(p in k for p in arguments.cases)}
        for seed in arguments.seeds:
            folder = arguments.out.resolve() / "-".join(filter(None, (simulator, str(seed), arguments.lab)))
            for name, case in cases.items():
                there = {k: c for k, c in every.items() if k == name or (is_flown(folder, k))}
                write_project(folder, simulator, seed, there)
                project = folder
                if arguments.without:
                    project = folder.with_name("-".join([folder.name, "without", *arguments.without]))
                    (project / "data").mkdir(parents=True, exist_ok=True)
                    if not (project / "data/raw").exists():
                        (project / "data/raw").symlink_to(folder / "data/raw")
                    write_project(project, simulator, seed, there, arguments.without)
                began = time.perf_counter()
                found = diagnose(project, name)
                result = judge(case, found, vehicle_of(simulator).ALWAYS)
                show(f"{simulator} {seed}, {name}", case, found, result, time.perf_counter() - began)
                true = ", ".join(f"{k} {v:.4g}" for k, v in list(case.value.items())[:3]) or "-"
                rows.append(
                    [
                        " ".join(filter(None, (simulator, str(seed), arguments.lab))),
                        name,
                        true,
                        answer(found),
                        result["score"],
                    ]
                )
                tally.setdefault(result["score"], []).append(f"{simulator} {seed} {name}")
    for score, names in tally.items():
        print(f"{score}: {len(names)}")
    if arguments.record:
        document = read_json(RESULTS / "foreign.json")
        document["table"]["rows"] = rows = merged(document["table"]["rows"], rows)
        write_json(RESULTS / "foreign.json", document)
        record("foreign", figures(rows))


if __name__ == "__main__":
    main()
