"""Fixed causes of every level, of pairs, of none and of one in no catalogue: each must be named, and nothing else.

    python benchmarks/fixed_causes.py [CASE ...] [--out results/benchmarks/hide_and_seek]

`hide_and_seek.py` draws causes at random; these are the same on every run. One case takes about 20 s. The tests run
those of TESTED: causes of the drive and of forces together, and none; the exit code is the number of cases that fail.
"""

import argparse
import os
import sys
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

from hidden import STRANGE
from hide_and_seek import OUT, draw

from quasi_synthesis.vehicle import BASE_MASS

CASES = {
    "ground effect": ("reference", {"ground_effect": {"c": 12.0}}),
    "weak rotor": ("reference", {"rotor_effectiveness": {"rotor2": 0.9}}),
    "moved battery": ("reference", {"cg_offset": {"x": 0.004, "y": -0.003}}),
    "heavier": ("reference", {"mass": {"mass": 1.15 * BASE_MASS}}),
    "tether": ("reference", {"tether": {"k": 0.4}}),
    "drag": ("reference", {"rotor_drag": {"k": 2.5e-5}}),
    "lever arm": ("reference", {"imu_lever_arm": {"x": 0.015, "y": -0.01}}),
    "tilted room, every flight": ("all", {"room_tilt": {"roll": 0.015, "pitch": -0.01}}),
    "slow motors": ("reference", {"motor_lag": {"time_constant": 0.045}}),
    "gyro scale and weak rotor": (
        "reference",
        {"gyro_scale": {"z": 1.03}, "rotor_effectiveness": {"rotor4": 0.9}},
    ),
    "slow motors and tether": ("reference", {"motor_lag": {"time_constant": 0.045}, "tether": {"k": 0.4}}),
    "nothing": ("reference", {}),
    "nothing again": ("reference", {}),
    "fan": ("reference", {"unlisted_fan": {"size": 0.6}}),
}
TESTED = ("slow motors and tether", "nothing")
FIRST_SEED = 50_000
LARGEST_ERROR = 0.35  # of a parameter, relative to its deviation from neutral; the study's median is 0.03


def seek_case(name: str, folder: Path = OUT, seconds: float = 30.0) -> dict[str, Any]:
    """Hide a case's causes and diagnose its flights; `hide_and_seek.draw` says what is returned."""
    design, effects = CASES[name]
    kind = "clean" if not effects else "unlisted" if set(effects) <= set(STRANGE) else "single"
    hide = {"kind": kind, "design": design, "effects": effects, "factors": dict.fromkeys(effects, 1.0)}
    return draw({"seed": FIRST_SEED + list(CASES).index(name), "hide": hide}, seconds, folder)


def list_faults(result: dict[str, Any]) -> list[str]:
    """List what the diagnosis of a case got wrong; empty where all is right."""
    faults = [f"{name} is named and was not hidden" for name in result["wrong"]]
    right = {"clean": "agrees", "single": "hit", "unlisted": "unexplained"}[result["kind"]]
    if result["outcome"] != right:
        faults.append(f"the outcome is {result['outcome']}, expected {right}: {result['summary']}")
    if result["kind"] == "single":
        if result["verdict"] not in ("explained", "partly explained"):
            faults.append(f"the verdict is {result['verdict']}")
        for name, error in result["errors"].items():
            if not abs(error["relative"]) < LARGEST_ERROR:
                faults.append(f"{name} is estimated with a relative error of {error['relative']:.2f}")
    return faults


def main() -> int:
    """Run the cases that the command line names, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    if unknown := [n for n in arguments.cases if n not in CASES]:
        parser.error(f"unknown case {unknown[0]!r}; the cases are {', '.join(CASES)}")
    failed = 0
    for name in arguments.cases or CASES:
        faults = list_faults(seek_case(name, arguments.out))
        failed += bool(faults)
        print(f"{name}: {'; '.join(faults) or 'right'}", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main())
