"""Flights that differ among themselves by more than is usual: is what is no cause of theirs named?

    python benchmarks/restless.py [--first 20000] [--draws 10] [--out results/benchmarks/hide_and_seek]

Nothing is hidden in these draws of `hide_and_seek.py`, but each of their four flights has a value of its own, about
none, of something that flights may differ by: where the battery sits, a draught, how much its rotors give. Named is
what the flights do not have in common, and should not be. One JSON per draw; a run that was stopped goes on where it
was.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hide_and_seek import OUT, draw
from study import run

# what flights differ by, and the standard deviation of each parameter from flight to flight
KINDS: dict[str, tuple[str, dict[str, float]]] = {
    "cg": ("centre of gravity, 1 mm", {"cg_offset": 1e-3}),
    "wind": ("wind, 0.3 m/s", {"wind": 0.3}),
    "rotors": ("each rotor's thrust, 1 %", {"rotor_effectiveness": 0.01}),
    "drag": ("rotor drag, a quarter of its typical size", {"rotor_drag": 2e-6}),
}
DESIGNS = ("reference", "reference", "all")


def seek(settings: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """One draw."""
    nothing = {"kind": "clean", "design": settings["design"], "effects": {}, "factors": {}}
    return draw({"seed": settings["seed"], "hide": nothing, "restless": KINDS[settings["differ by"]][1]}, folder=folder)


def main() -> None:
    """Draw, and print what was said."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=20000)
    parser.add_argument("--draws", type=int, default=10, help="of each kind")
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.draws)
    many = [{"differ by": kind, "seed": s, "design": DESIGNS[s % len(DESIGNS)]} for kind in KINDS for s in seeds]
    found = run(many, lambda s: seek(s, arguments.out), arguments.out / "restless", Path(__file__))
    print(f"{'flights differ by':44s} draws  nothing named  named")
    for kind, (label, _) in KINDS.items():
        own = [r for r in found if r["settings"]["differ by"] == kind]
        named = [
            (r["settings"]["seed"], *r["wrong"], *map("/".join, r["tied"])) for r in own if r["outcome"] == "false"
        ]
        print(f"{label:44s} {len(own):5d} {len(own) - len(named):14d}  {named or ''}")


if __name__ == "__main__":
    main()
