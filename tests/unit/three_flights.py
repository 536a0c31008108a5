"""A project folder with a logbook of three flights and one model, of which nothing is made."""

import json
import shutil
from pathlib import Path

ROOT = Path(__file__).parents[2]
MODEL = {
    "logging file": {"filename": "log", "rows of flights to use (all)": ["2-4"], "rows of flights for validation": [4]},
    "identification parameters": {"polynomial specification file": "physical"},
}
HEADER = "Quadrotor,Onboard Name,OB Path,Flight controller,Drone Config File,Drone Config Path,Has OT data"
HEADER += ",Raw OptiTrack Name,Raw OT Path,Mass,Batteries"


def lay_folder(folder):
    shutil.copytree(ROOT / "config/template", folder, dirs_exist_ok=True)
    (folder / "config/models/my_model.json").unlink()
    (folder / "config/models/m.json").write_text(json.dumps(MODEL))
    (folder / "config/processing.json").write_text(json.dumps({"logging file": {"filename": "log"}}))
    rows = [f"Beetle,{n},data/raw,betaflight,my_quadrotor,data,N,,,433,4S" for n in "abc"]
    (folder / "data/log.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    for name in ("a.bbl", "a.csv", "b.csv", "c.BFL"):
        (folder / "data/raw" / name).touch()
    return folder


def edit(folder, old, new):
    path = folder / "data/log.csv"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def edit_model(folder, **sections):
    path = folder / "config/models/m.json"
    document = json.loads(path.read_text())
    for name, values in sections.items():
        document.setdefault(name.replace("_", " "), {}).update(values)
    path.write_text(json.dumps(document))
