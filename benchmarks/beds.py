"""Data of an independent generator: what does the diagnosis name, and what is true?

    python benchmarks/beds.py BED [--sets null-1 ...] [--out results/benchmarks/beds] [--swap]

BED is a folder of archives (`NAME.tar.xz`) or folders, each with data/ (logbook, quadrotor, raw logs) and truth.json.
For each set the workflow makes a model from rows 2 to 5 and a gap of rows 6 to 9, row 9 held out, with rows 2 to 5 as
reference flights; of a set whose name ends in "-all" every flight is affected and no row is a reference. --swap
exchanges reference and compared flights. The results folder stays, so that a second run recomputes only what is stale.
"""

import argparse
import json
import subprocess
import sys
import tarfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FIRST, SECOND = list(range(2, 6)), list(range(6, 10))
# "since: always" is true of these in every set: the airframe's own thrust curve, rotor drag and flapping
OF_THE_AIRFRAME = {"thrust_curve", "rotor_drag", "blade_flapping", "body_drag"}


def unpack(source: Path, out: Path) -> Path:
    """The folder of one set, unpacked once below `out`."""
    if source.is_dir():
        name = source.name
    else:
        name = source.name.removesuffix(".tar.xz")
    folder = out / name
    if not (folder / "truth.json").is_file():
        out.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            folder.mkdir(exist_ok=True)
            (folder / "data").symlink_to(source.resolve() / "data")
            (folder / "truth.json").write_bytes((source / "truth.json").read_bytes())
        else:
            with tarfile.open(source) as archive:
                archive.extractall(out, filter="data")
    return folder


def configure(folder: Path, swap: bool) -> str:
    """Write the configuration of a set; returns the name of its gap."""
    config = folder / "config"
    every = folder.name.endswith("-all")
    flown = {"directory": "data", "filename": "logbook"}
    documents: dict[str, Any] = {
        "processing.json": {"logging file": {**flown, "rows of flights to use (all)": ["2-9"]}},
    }
    name = "swapped" if swap else "bed"
    clean, affected = (SECOND, FIRST) if swap else (FIRST, SECOND)
    documents[f"models/{name}.json"] = {
        "logging file": {
            **flown, "rows of flights to use (all)": clean, "rows of flights for validation": [clean[-1]],
        },
        "filtered data save directory": "withGravity",
        "identification parameters": {"polynomial specification file": "physical"},
    }  # fmt: skip
    logging: dict[str, Any] = {
        **flown, "rows of flights to compare (all)": affected, "rows of flights held out": [affected[-1]],
    }  # fmt: skip
    if not every:
        logging["rows of reference flights"] = clean
    else:
        logging["training flights as reference"] = False
    documents[f"gaps/{name}.json"] = {
        "model": name, "logging file": logging, "extended model ID": f"{name}-extended",
    }  # fmt: skip
    for path, content in documents.items():
        text = json.dumps(content, indent=1)
        target = config / path
        target.parent.mkdir(parents=True, exist_ok=True)
        if not target.is_file() or target.read_text() != text:
            target.write_text(text)
    if not (config / "config.yaml").is_file():
        (config / "config.yaml").write_text("{}\n")
    return name


def judge(diagnosis: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, Any]:
    """Compare a diagnosis with the truth: {"right", "wrong names", "missed", "named", "ties"}.

    A cause counts as found where it is named or in a tie; a name is wrong where it is not planted. What the airframe
    has in every flight is no wrong name where it is reported as always there. A cause with |t| below 3 may be missed.
    """
    planted = {e["id"]: e for e in truth.get("effects", ())}
    shown = {d["id"]: d for d in truth.get("detectability", ())}
    admitted = {i for tie in truth.get("acceptable_tie") or () for i in ([tie] if isinstance(tie, str) else tie)}
    named = {e["id"]: e for e in diagnosis["effects"]}
    ties = [t["ids"] for t in diagnosis["ties"]]
    wrong = [
        i for i, e in named.items()
        if i not in planted and i not in admitted and not (e["since"] == "always" and i in OF_THE_AIRFRAME)
    ]  # fmt: skip
    wrong += ["/".join(t) for t in ties if not set(t) & (set(planted) | admitted)]
    missed = []
    for i in planted:
        size = shown.get(i, {}).get("t", 0.0) if isinstance(shown.get(i), Mapping) else 0.0
        if i not in named and not any(i in t for t in ties) and not (admitted & set(named)) and size >= 3.0:
            missed.append(i)
    clean = not planted or all((shown.get(i) or {}).get("t", 0.0) < 3.0 for i in planted)
    right = not wrong and not missed and (not clean or diagnosis["verdict"] == "agrees" or bool(named or ties))
    return {"right": right, "wrong names": wrong, "missed": missed, "named": list(named), "ties": ties}


def run(folder: Path, swap: bool) -> dict[str, Any]:
    """Make the gap of one set by the workflow; returns the diagnosis."""
    name = configure(folder, swap)
    command = [
        sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(folder), "-j2",
        f"results/gaps/{name}/diagnosis.json",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    if done.returncode:
        raise SystemExit(f"{folder.name}: the workflow failed\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}")
    return json.loads((folder / f"results/gaps/{name}/diagnosis.json").read_text())


def main() -> None:
    """Run all sets and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bed", type=Path)
    parser.add_argument("--sets", nargs="*", default=[], help="parts of names; all without")
    parser.add_argument("--out", type=Path, default=ROOT / "results/benchmarks/beds")
    parser.add_argument("--swap", action="store_true", help="exchange reference and compared flights")
    arguments = parser.parse_args()
    sources = sorted([*arguments.bed.glob("*.tar.xz"), *(p.parent for p in arguments.bed.glob("*/truth.json"))])
    sources = [s for s in sources if not arguments.sets or any(part in s.name for part in arguments.sets)]
    if not sources:
        raise SystemExit(f"{arguments.bed} holds no set (NAME.tar.xz or NAME/truth.json)")
    right = 0
    for source in sources:
        folder = unpack(source, arguments.out)
        if arguments.swap and folder.name.endswith("-all"):
            continue
        began = time.perf_counter()
        diagnosis = run(folder, arguments.swap)
        result = judge(diagnosis, json.loads((folder / "truth.json").read_text()))
        right += result["right"]
        print(f"{folder.name}: {'right' if result['right'] else 'WRONG'}, {diagnosis['verdict']}, "
              f"{time.perf_counter() - began:.0f} s")  # fmt: skip
        for e in diagnosis["effects"]:
            values = ", ".join(f"{k} {p['value']:.4g} +- {p['std']:.2g}" for k, p in e["parameters"].items())
            mark = " (wrong)" if e["id"] in result["wrong names"] else ""
            print(f"   named {e['id']}{mark}, {e['since']}: {values}")
        for tie in diagnosis["ties"]:
            print(f"   tie {' / '.join(tie['ids'])}")
        for left in diagnosis["unexplained"]:
            print(f"   unexplained {left['channel']} along {left['where']}: share {left['share']}")
        for missed in result["missed"]:
            print(f"   missed {missed}")
    print(f"{right} of {len(sources)} right")


if __name__ == "__main__":
    main()
