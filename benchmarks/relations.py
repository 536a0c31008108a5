"""Real recordings written down differently: does the diagnosis say the same?

    python benchmarks/relations.py DATA [--plants "rotor 2 x 0.95" ...] [--relations mirrored ...]
                                   [--out results/benchmarks/relations]

DATA as in plants.py. Each relation changes how all runs of a plant are written down: mirrored left-right, rotors
renumbered, the room turned, other units, every second row, flights in another order, one flight cut in two, reference
and compared flights exchanged, noise added. What is true of the flights stays true, so that the same causes have to be
named, with their parameters transformed; of noise and of fewer rows a name may be lost, and no other may come. No truth
is needed. One JSON per run; a study that was stopped goes on where it was.
"""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from plants import AS_IT_IS, ERPM, PLANTS, Table, Written, draw
from scipy.spatial.transform import Rotation
from study import ROOT, run

ATTITUDE, ATTITUDE_OF_CAPTURE = ["qx", "qy", "qz", "qw"], [f"{n}_poses" for n in ("qx", "qy", "qz", "qw")]
WORLD = (["x", "y", "z"], ["vx", "vy", "vz"], ["ax", "ay", "az"], ["x_poses", "y_poses", "z_poses"])
TURN = 40.0  # deg, of the room
SHARES = {"rotors": 0.005, "wx": 0.02, "ax": 0.3, "x_poses": 0.0005}  # noise: share; rad/s; m/s2; m
APART = 2.0  # standard errors that a parameter may move
CHOSEN = ("nothing", "rotor 2 x 0.95", "mass 15 % high", "accelerometer x 1.03", "motors 30 ms late")


def mirrored(table: Table) -> Table:
    """Left and right exchanged: y of vectors, x and z of rates and quaternions."""
    table[["y", "vy", "ay", "y_poses", "wx", "wz", "qx", "qz", "qx_poses", "qz_poses"]] *= -1.0
    return table


def mirror_of(quadrotor: dict[str, Any]) -> None:
    """Rotors stand on the other side and turn the other way."""
    quadrotor["rotor config"] = {"front left": 1, "front right": 4, "aft right": 3, "aft left": 2}
    quadrotor["rotor1 rotation direction"] = "CW"


def renumbered(table: Table) -> Table:
    """Rotors 1 to 4 in the columns 2, 3, 4 and 1."""
    for kind in ("m{}_erpm", "m{}_thrust"):
        table[[kind.format(n) for n in (2, 3, 4, 1)]] = table[[kind.format(n) for n in (1, 2, 3, 4)]].to_numpy()
    return table


def numbers_of(quadrotor: dict[str, Any]) -> None:
    """The numbers that `renumbered` gives; rotor 1 is the old rotor 4, which turns clockwise."""
    old = quadrotor["rotor config"]
    quadrotor["rotor config"] = {place: number % 4 + 1 for place, number in old.items()}
    quadrotor["rotor1 rotation direction"] = "CW"


def turned(table: Table) -> Table:
    """The room's axes turned about the vertical."""
    turn = Rotation.from_euler("z", TURN, degrees=True)
    for names in WORLD:
        table[names] = turn.apply(table[names].to_numpy())
    for names in (ATTITUDE, ATTITUDE_OF_CAPTURE):
        known = table[names].notna().all(axis=1)
        if known.any():
            table.loc[known, names] = (turn * Rotation.from_quat(table.loc[known, names].to_numpy())).as_quat()
    return table


def in_other_units(table: Table) -> Table:
    """Lengths of the capture in millimetres, rates in degrees per second, specific force in g, speeds in rad/s."""
    table[["x_poses", "y_poses", "z_poses"]] *= 1e3
    table[["wx", "wy", "wz"]] = np.degrees(table[["wx", "wy", "wz"]])
    table[["ax", "ay", "az"]] /= 9.80665
    table[ERPM] *= 2.0 * np.pi / 60.0 / 6.0  # 12 poles: 6 pairs
    return table


def units_of(quadrotor: dict[str, Any]) -> None:
    """The units that `in_other_units` makes."""
    units = {
        "state": (("p", "q", "r"), "deg/s"), "accelerometer": (("ax", "ay", "az"), "g"),
        "motors": (("w1", "w2", "w3", "w4"), "rad/s"), "poses": (("x", "y", "z"), "mm"),
    }  # fmt: skip
    for source in quadrotor["table columns"]["sources"]:
        names, unit = units[source["name"]]
        for name in names:
            source["columns"][name]["unit"] = unit


def with_noise(table: Table) -> Table:
    """White noise on every sensor, its seed made of the table."""
    rng = np.random.default_rng(len(table) + round(1e3 * float(table["x_poses"].abs().sum())))

    def noise(names: list[str], size: float) -> None:
        table[names] += size * rng.standard_normal((len(table), len(names)))

    noise(["wx", "wy", "wz"], SHARES["wx"])
    noise(["ax", "ay", "az"], SHARES["ax"])
    noise(["x_poses", "y_poses", "z_poses"], SHARES["x_poses"])
    table[ERPM] *= 1.0 + SHARES["rotors"] * rng.standard_normal((len(table), 4))
    return table


def every_second(table: Table) -> Table:
    """Half the log rate."""
    return table.iloc[::2].reset_index(drop=True)


CUT = {
    "run1": (1, "reference"), "run2": (2, "reference"), "run1a-planted": (1, "compared"),
    "run1b-planted": (1, "compared"), "run2-planted": (2, "compared"), "run3-planted": (3, "held out"),
}  # fmt: skip
SWAPPED = {
    "run1-planted": (1, "reference"), "run2-planted": (2, "reference"), "run1": (1, "compared"),
    "run2": (2, "compared"), "run3": (3, "held out"),
}  # fmt: skip


@dataclass(frozen=True)
class Relation:
    """written  how the runs are written down; value  parameter (id, name, value) -> (name, value) as it has to come
    out; may_lose  whether a name may become a tie or nothing."""

    written: Written
    value: Callable[[str, str, float], tuple[str, float]] = lambda _, name, value: (name, value)
    may_lose: bool = False


def _mirrored(cause: str, name: str, value: float) -> tuple[str, float]:
    along = {"marker_offset", "imu_lever_arm", "cg_offset", "accelerometer_bias"}
    return name, -value if cause in along and name == "y" else value


def _renumbered(_: str, name: str, value: float) -> tuple[str, float]:
    return (f"rotor{int(name[5]) % 4 + 1}" if name.startswith("rotor") and name[5:].isdigit() else name), value


def _swapped(cause: str, name: str, value: float) -> tuple[str, float]:
    ratio = cause in {"rotor_effectiveness", "accelerometer_scale", "rotor_speed_scale", "thrust_factor"}
    return name, 1.0 / value if ratio else (value if cause == "mass" else -value)


RELATIONS = {
    "as it is": Relation(AS_IT_IS),
    "mirrored": Relation(Written(change=mirrored, configure=mirror_of), _mirrored),
    "renumbered": Relation(Written(change=renumbered, configure=numbers_of), _renumbered),
    "room turned": Relation(Written(change=turned)),
    "other units": Relation(Written(change=in_other_units, configure=units_of)),
    "another order": Relation(Written(flights=dict(reversed(list(AS_IT_IS.flights.items()))))),
    "cut in two": Relation(
        Written(flights=CUT, parts={"run1a-planted": (0.0, 0.7), "run1b-planted": (0.7, 1.0)}), may_lose=True
    ),
    "every second row": Relation(Written(change=every_second), may_lose=True),
    "noise": Relation(Written(change=with_noise), may_lose=True),
    "swapped": Relation(Written(flights=SWAPPED, healthy=("compared", "held out")), _swapped, may_lose=True),
}


def names_of(found: Mapping[str, Any]) -> set[str]:
    """All causes that are named or stand in a tie."""
    return {e["id"] for e in found["effects"]} | {i for t in found["ties"] for i in t["ids"]}


def judge(relation: str, plain: Mapping[str, Any], found: Mapping[str, Any], plant: str) -> list[str]:
    """What is not as it has to be, in words."""
    rule, faults = RELATIONS[relation], []
    before, after = names_of(plain), names_of(found)
    right = set(PLANTS[plant].right)
    if other := after - before - right:
        faults.append(f"further {', '.join(sorted(other))}")
    if not rule.may_lose and (lost := before - after):
        faults.append(f"lost {', '.join(sorted(lost))}")
    own = {(e["id"], e["since"]): e["parameters"] for e in found["effects"]}
    for effect in plain["effects"]:
        if relation == "swapped" and effect["since"] == "always":
            continue
        parameters = own.get((effect["id"], effect["since"]))
        for name, size in effect["parameters"].items() if parameters else ():
            name, value = rule.value(effect["id"], name, size["value"])
            if name not in parameters:
                faults.append(f"{effect['id']}: no {name}")
                continue
            std = max(np.hypot(parameters[name]["std"], size["std"]), 1e-12)
            apart = (parameters[name]["value"] - value) / std
            if abs(apart) > APART:
                faults.append(f"{effect['id']}: {name} moves by {apart:.1f} standard errors")
    return faults


def main() -> None:
    """Run all relations of the chosen plants and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--plants", nargs="*", default=list(CHOSEN), choices=list(PLANTS))
    parser.add_argument("--relations", nargs="*", default=list(RELATIONS), choices=list(RELATIONS))
    parser.add_argument("--out", type=Path, default=ROOT / "results/benchmarks/relations")
    arguments = parser.parse_args()
    relations = ["as it is", *(r for r in arguments.relations if r != "as it is")]
    settings = [{"plant": p, "relation": r} for p in arguments.plants for r in relations]
    results = run(
        settings, lambda s: draw(s["plant"], arguments.data, RELATIONS[s["relation"]].written), arguments.out,
        Path(__file__),
    )  # fmt: skip
    held = {(s["plant"], s["relation"]): found for s, found in zip(settings, results)}
    kept = 0
    for (plant, relation), found in held.items():
        if relation == "as it is":
            print(f"{plant}: {', '.join(sorted(names_of(found))) or 'nothing'}, {found['verdict']}")
            continue
        faults = judge(relation, held[plant, "as it is"], found, plant)
        lost = sorted(names_of(held[plant, "as it is"]) - names_of(found))
        kept += not faults
        print(f"   {relation}: {'; '.join(faults) or 'the same'}" + (f" (without {', '.join(lost)})" if lost else ""))
    print(f"{kept} of {len(held) - len(arguments.plants)} relations hold")


if __name__ == "__main__":
    main()
