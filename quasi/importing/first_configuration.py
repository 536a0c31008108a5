"""From one log to a project folder: what the log says of its vehicle, written where a person corrects it."""

import csv
import io
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from quasi.errors import ReadError
from quasi.importing.inspection import inspect_flight, usable_for
from quasi.importing.readers.arrays import read_arrays
from quasi.importing.readers.dataflash import DataFlashFile
from quasi.importing.readers.guess_columns import guess_columns
from quasi.importing.readers.px4 import UlogFile
from quasi.importing.readers.reader import Request
from quasi.importing.readers.registry import controller_of, read_capture
from quasi.importing.readers.signals import Signals
from quasi.importing.readers.table_reader import ARRAYS
from quasi.importing.readers.table_text import open_table
from quasi.project.logbook import VALID_NAME, key_of
from quasi.project.recognition import HEAD_SIZE, recognise
from quasi.project.templates import lay_folder
from quasi.tables import read_head, read_json, read_text, write_json, write_text

QUADROTOR = "my_quadrotor"
UNEQUAL = 0.02  # share by which the arms of a square frame may differ, beyond which hub positions are written
# {FRAME_TYPE of FRAME_CLASS 1: (places in order of motor number, direction of motor 1)}; source: "Connect ESCs and
# motors" of the ArduPilot guide
ARDUPILOT_FRAMES = {
    1: (("front right", "aft left", "front left", "aft right"), "CCW"),
    3: (("front right", "aft left", "front left", "aft right"), "CW"),
    12: (("aft right", "front right", "aft left", "front left"), "CW"),
    18: (("aft right", "front right", "aft left", "front left"), "CCW"),
}
# Crazyflie 2.1: Bitcraze's data sheet (arm, rotors); inertia: Foerster, System identification of the Crazyflie 2.0,
# ETH Zurich 2015, of 28 g
CRAZYFLIE_FRAME = {
    "rotor config": {"front left": 4, "front right": 1, "aft right": 2, "aft left": 3},
    "rotor1 rotation direction": "CCW",
    "rotor radius": "0.0235",
    "b": "0.046",
    "moment of inertia": "[1.6572e-5, 0, 0; 0, 1.6656e-5, 0; 0, 0, 2.9262e-5]",
    "mass": "0.028",
}


@dataclass
class FirstConfiguration:
    """controller  value of 'Flight controller'; quadrotor  keys of its configuration that the log states; remarks."""

    controller: str
    quadrotor: dict[str, Any] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)


def recognise_log(path: Path) -> FirstConfiguration:
    """What a log says of its vehicle and of how it is read.

    Raises ReadError where no reader knows it, or it is damaged.
    """
    found = recognise(read_head(path, HEAD_SIZE))
    kind = found.kind if found else None
    text = read_text(path) if kind in (None, "gzip") else ""
    if kind in (*ARRAYS, "parquet") or (text and not re.search(r"gyroADC|H Product:Blackbox", text[:HEAD_SIZE])):
        return _recognise_table(path, kind)
    controller = controller_of(path, {})
    first = FirstConfiguration(controller)
    if controller == "px4":
        first.quadrotor, first.remarks = _px4_geometry(UlogFile(path, []).parameters)
    elif controller == "ardupilot":
        first.quadrotor, first.remarks = _ardupilot_geometry(DataFlashFile(path, []).parameters)
    elif controller == "crazyflie":
        first.quadrotor = dict(CRAZYFLIE_FRAME)
        first.remarks.append("geometry and inertia are those of a Crazyflie 2.1; weigh yours")
    elif controller == "betaflight":
        head = read_head(path, 1 << 20)
        if re.search(rb"H Firmware revision:INDIFLIGHT", head, re.IGNORECASE):
            first.controller = "indiflight"
        if poles := re.search(rb"H motor_poles:(\d+)", head):
            first.quadrotor["motor poles"] = int(poles[1])
        first.remarks.append("rotor places are those of Betaflight's default mixer, propellers in; check them")
    else:
        first.remarks.append("a bag says nothing of the geometry; write it into data/my_quadrotor.json")
    return first


def _recognise_table(path: Path, kind: str | None) -> FirstConfiguration:
    notes: list[str] = []
    signals = read_arrays(path, notes) if kind in ARRAYS else Signals({"": open_table(path, notes)})
    guess = guess_columns(signals.frames)
    if guess.mapping is None:
        listed = ", ".join(signals.columns[:12])
        raise ReadError(f"{path}: {guess.remarks[-1]}; its columns are {listed}")
    return FirstConfiguration("table", {"table columns": guess.mapping}, guess.remarks)


def _px4_geometry(parameters: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Places and directions of four rotors from CA_ROTORn: PX forward, PY right, PZ down, m; KM > 0: CCW."""
    count = int(parameters.get("CA_ROTOR_COUNT") or 0)
    if count != 4 or any(f"CA_ROTOR{i}_P{a}" not in parameters for i in range(4) for a in "XY"):
        return {}, ["the log holds no CA_ROTOR parameters of four rotors; write the geometry by hand"]
    hubs = [[float(parameters.get(f"CA_ROTOR{i}_P{a}", 0.0)) for a in "XYZ"] for i in range(4)]
    places = {_place(x, y): i + 1 for i, (x, y, _) in enumerate(hubs)}
    spins = ["CCW" if float(parameters.get(f"CA_ROTOR{i}_KM", 0.05)) > 0 else "CW" for i in range(4)]
    if len(places) != 4:
        return {}, ["the CA_ROTOR parameters are not those of a quadrotor with a rotor in each corner"]
    arms = [math.hypot(x, y) for x, y, _ in hubs]
    keys: dict[str, Any] = {
        "rotor config": {place: places[place] for place in ("front left", "front right", "aft right", "aft left")},
        "rotor1 rotation direction": spins[0],
        "b": f"{sum(arms) / 4:.4g}",
    }
    across = [abs(v) for x, y, _ in hubs for v in (x, y)]
    if max(across) - min(across) > UNEQUAL * max(across):
        keys["rotor positions"] = {str(i + 1): hub for i, hub in enumerate(hubs)}
    diagonal = places[{"front left": "aft right", "front right": "aft left", "aft right": "front left",
                       "aft left": "front right"}[_place(*hubs[0][:2])]]  # fmt: skip
    if any((spins[i] == spins[0]) != (i + 1 in (1, diagonal)) for i in range(4)):
        keys["rotor rotation directions"] = {str(i + 1): spin for i, spin in enumerate(spins)}
    return keys, ["rotor places and directions come from the CA_ROTOR parameters; measure the propeller's radius"]


def _place(x: float, y: float) -> str:
    return f"{'front' if x > 0 else 'aft'} {'right' if y > 0 else 'left'}"


def _ardupilot_geometry(parameters: Mapping[str, float]) -> tuple[dict[str, Any], list[str]]:
    frame = ARDUPILOT_FRAMES.get(int(parameters.get("FRAME_TYPE", -1)))
    if frame is None or int(parameters.get("FRAME_CLASS", 1)) != 1:
        return {}, ["FRAME_CLASS and FRAME_TYPE name no X frame of four rotors; write rotor places by hand"]
    places = {place: motor + 1 for motor, place in enumerate(frame[0])}
    keys = {place: places[place] for place in ("front left", "front right", "aft right", "aft left")}
    remark = "rotor places and directions come from FRAME_CLASS and FRAME_TYPE; measure the arms"
    return {"rotor config": keys, "rotor1 rotation direction": frame[1]}, [remark]


def lay_folder_from(folder: Path, library: Path, log: Path, capture: Path | None = None) -> str:
    """Lay a project folder for one log (and its capture); returns what was recognised and what to do next.

    Raises ConfigError when the folder holds something, ReadError where the log or the capture cannot be read.
    """
    first = recognise_log(log)
    body = read_capture(Request(capture, rigid_body=None)).metadata["rigid body"] if capture is not None else ""
    text = lay_folder(folder, library)
    place = folder / "data" / f"{QUADROTOR}.json"
    quadrotor = {**read_json(place), **first.quadrotor, "flight controller": first.controller}
    write_json(place, quadrotor)
    cells = {
        "Quadrotor": QUADROTOR, "Onboard Name": log.name, "OB Path": _path_from(folder, log.parent),
        "Flight controller": first.controller, "Drone Config File": QUADROTOR, "Drone Config Path": "data",
        "Has OT data": "Y" if capture else "N",
    }  # fmt: skip
    if capture is not None:
        cells |= {"Raw OptiTrack Name": capture.name, "Raw OT Path": _path_from(folder, capture.parent),
                  "Rigid Body Name": body}  # fmt: skip
    key = _key_of(log)
    if key != key_of(log.name):
        cells["Flight key"] = key
    logbook = folder / "data/logbook.csv"
    names = read_text(logbook).splitlines()[0].split(",")
    rows = csv.writer(written := io.StringIO(), lineterminator="\n")
    rows.writerows([names, [cells.get(name, "") for name in names]])
    write_text(logbook, written.getvalue())
    processing = folder / "config/processing.json"
    write_text(processing, re.sub(r'(rows of flights to use \(all\)": )\[[^\]]*\]', r"\1[2]", read_text(processing)))
    flight = {"flight": key, "quadrotor": QUADROTOR, "flight controller": first.controller, "onboard": str(log),
              "capture": str(capture) if capture else None, "rigid body": body, "log number": None}  # fmt: skip
    found = inspect_flight({"flight": flight, "quadrotor": quadrotor, "problem": None})
    return _report(folder, library, first, found, key, text)


def _path_from(folder: Path, target: Path) -> str:
    """A path as the logbook holds it: relative to the project folder where it lies inside, else absolute."""
    target, folder = target.resolve(), folder.resolve()
    return os.path.relpath(target, folder) if target.is_relative_to(folder) else str(target)


def _key_of(log: Path) -> str:
    key = re.sub(r"[^A-Za-z0-9._+-]+", "_", key_of(log.name)).strip(".") or "flight"
    return key if VALID_NAME.fullmatch(key) else f"flight_{key}"


def _report(
    folder: Path, library: Path, first: FirstConfiguration, found: Mapping[str, Any], key: str, text: str
) -> str:
    snakemake = re.search(r"Then:\s+(\S+)", text)
    held = [f"{name} ({about['rate']:.0f} Hz, {about['from']})" for name, about in found["holds"].items()]
    about = found["onboard"] or {}
    lines = [f"Made {folder} for flight {key}: {about.get('format') or first.controller}"]
    if about.get("rate"):
        lines[0] += f", {about['duration']:.1f} s, gyro at {about['rate']:.0f} Hz"
    lines.append(f"  holds: {', '.join(held) or 'nothing that is known'}")
    if found["lacks"]:
        lines.append(f"  lacks: {', '.join(found['lacks'])}")
    lines.append(f"  usable for: {usable_for(found)}")
    lines += [f"  problem: {found['problem']}"] if found["problem"] else []
    lines += [f"  note: {remark}" for remark in (*first.remarks, *found["remarks"])]
    lines.append(f"Edit mass and geometry in {folder / 'data' / QUADROTOR}.json.")
    command = f"{snakemake[1] if snakemake else 'snakemake'} -s {library / 'Snakefile'} -d {folder} -j2 processing"
    lines.append(f"Then:  {command}")
    lines.append(f"which makes {folder / 'results/reports' / QUADROTOR / key}.html")
    return "\n".join(lines)
