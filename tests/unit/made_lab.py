"""A project folder of three short table flights, whose raw files a test may spoil."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
from made_motion import at_times, body, motive_text

ROOT = Path(__file__).parents[2]
HEADER = "Quadrotor,Onboard Name,OB Path,Flight controller,Drone Config File,Drone Config Path,Has OT data"
HEADER += ",Raw OptiTrack Name,Raw OT Path,Rigid Body Name,Mass"
IMU = ("p", "q", "r", "ax", "ay", "az")
PLACE = ("x", "y", "z")
ROTORS = ("w1", "w2", "w3", "w4")


def optional(*names):
    return {name: {"column": name, "optional": True} for name in names}


def log(path, *names, **values):
    """A table of 10 s at 100 Hz with these columns."""
    generator, n = np.random.default_rng([len(names), *path.stem.encode()]), 1000
    table = {"t": np.arange(n) / 100.0} | {name: generator.standard_normal(n) for name in (*IMU, *PLACE)}
    table |= {w: 900.0 + 10.0 * generator.standard_normal(n) for w in ROTORS} | {"battery": np.full(n, 15.5)}
    table = {name: table[name] for name in ("t", *names)} | {k: np.full(n, v) for k, v in values.items()}
    pd.DataFrame(table).to_csv(path, index=False, float_format="%.6f")


def lay_lab(tmp_path):
    """A project of three flights: a (all there), b (capture in a Motive export), c (all there, held out)."""
    shutil.copytree(ROOT / "config/template", tmp_path, dirs_exist_ok=True)
    columns = {n: n for n in IMU} | optional(*ROTORS, "command1", "command2", "command3", "command4")
    columns |= {"battery_voltage": {"column": "battery", "unit": "V", "optional": True}} | optional(*PLACE)
    mapping = {"time": {"column": "t"}, "sources": [{"name": "all", "columns": columns}]}
    quadrotor = json.loads((ROOT / "data/MadeBeetleConfig.json").read_text()) | {"table columns": mapping}
    (tmp_path / "data/my_quadrotor.json").write_text(json.dumps(quadrotor))
    rows = [
        "Lab,a,data/raw,table,my_quadrotor,data,N,,,,433",
        "Lab,b,data/raw,table,my_quadrotor,data,Y,b_ot,data/raw,Quad,433",
    ]
    rows.append("Lab,c,data/raw,table,my_quadrotor,data,N,,,,433")
    (tmp_path / "data/logbook.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    for key, names in (("a", (*PLACE, *ROTORS, "battery")), ("b", ROTORS), ("c", (*PLACE, *ROTORS))):
        log(tmp_path / f"data/raw/{key}.csv", *IMU, *names)
    frame = np.arange(1200)
    (tmp_path / "data/raw/b_ot.csv").write_text(
        motive_text(frame, np.round(frame / 120.0, 3), *at_times(body(12.0), frame / 120.0))
    )
    for name in ("config/processing.json", "config/models/my_model.json"):
        text = (tmp_path / name).read_text().replace('"2-3"', '"2-4"').replace('validation": [3]', 'validation": [4]')
        (tmp_path / name).write_text(text)
    return tmp_path


def edit(lab, old, new):
    path = lab / "data/logbook.csv"
    assert path.read_text().count(old) == 1
    path.write_text(path.read_text().replace(old, new))
