"""A study over many draws that can be stopped and goes on where it was: one JSON per draw, tables made from the files.

results = run(settings_of_each_draw, draw, folder, Path(__file__))
"""

import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from quasi.importing.flight import import_flight
from quasi.running.provenance import compute_code_digest
from quasi.tables import read_json, write_json
from quasi_synthesis.campaign import Made, make_flight, quadrotor_configuration, read_campaign, write_flight

HERE = Path(__file__).resolve()
ROOT = HERE.parents[1]


def name_of(settings: dict) -> str:
    """Name of a draw's file: its settings in their order."""
    return "-".join(f"{v:g}" if isinstance(v, float) else str(v) for v in settings.values())


def run(many: Iterable[dict], draw: Callable[[dict], dict], folder: Path, program: Path) -> list[dict]:
    """The results of all draws, in order: {"settings", "code", ...}, as their files in `folder` hold them.

    many     settings of each draw: plain values, in an order that names the draw
    draw     makes one draw of its settings, a plain dictionary
    program  the file that holds `draw`; a draw made by other code of it, of this file, or of what they import from
             quasi is made anew
    """
    code = "-".join(compute_code_digest(path, ROOT) for path in (program.resolve(), HERE))
    wanted, results = list(many), []
    for i, settings in enumerate(wanted):
        path = folder / f"{name_of(settings)}.json"
        result = read_json(path) if path.is_file() else {}
        if result.get("code") != code or result.get("settings") != settings:
            write_json(path, {"settings": settings, "code": code, **draw(settings)})
            result = read_json(path)
        results.append(result)
        print(f"\r{i + 1} of {len(wanted)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return results


def show_found(found: Mapping[str, Any]) -> None:
    """Print what a diagnosis names, ties and leaves."""
    for e in found["effects"]:
        values = ", ".join(f"{k} {p['value']:.4g} +- {p['std'] or np.nan:.2g}" for k, p in e["parameters"].items())
        print(f"   named {e['id']}, {e['since']}: {values}")
    for tie in found["ties"]:
        print(f"   tie {' / '.join(tie['ids'])}")
    for left in found["unexplained"]:
        print(f"   unexplained {left['channel']} along {left['where']}")


def rms(values: object) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, float)))))


def fly(name: str, **config: object) -> tuple[Made, pd.DataFrame, dict, dict]:
    """A made flight, written as raw log and capture and imported: what was made, table, metadata, quadrotor.

    config  keys of one flight ("profile", "seed") and of the campaign ("duration", "nuisance", ...)
    """
    of_flight = {k: config.pop(k) for k in ("profile", "seed")}
    campaign = read_campaign({"flights": [{"key": name, **of_flight}], **config}, name)
    made, quadrotor = make_flight(campaign, campaign.flights[0]), quadrotor_configuration(campaign)
    with tempfile.TemporaryDirectory() as folder:
        onboard, capture = f"{folder}/{name}.bbl", f"{folder}/{name}.csv"
        write_flight(made, onboard, capture, f"{folder}/{name}.parquet")
        source = {
            "flight": name, "quadrotor": campaign.quadrotor, "flight controller": "betaflight",
            "rigid body": "MadeBeetle", "onboard": onboard, "capture": capture, "log number": None,
        }  # fmt: skip
        frame, about = import_flight(source, quadrotor, {})
    return made, frame, about, quadrotor
