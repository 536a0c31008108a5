"""Faults planted in raw logs of an independent generator: are they named, with their size, and nothing else?

    python benchmarks/bed_plants.py BED [--plants mass ...] [--commands-only] [--everywhere]
                                    [--forces] [--out results/benchmarks/bed_plants] [--record]

BED is a fault-free set (a folder or archive, see beds.py). Rows 2 to 5 of its logbook make the model and are the
reference flights; rows 6 to 9 get the plant, and row 9 is held out. A plant changes a stream of the raw log as it is
read, or the configured vehicle: no physics of ours is involved. One JSON per plant; a run that was stopped goes on.

--commands-only withholds the rotor speeds of every flight. What is planted in speeds is then planted in the commands: a
rotor that is commanded more for the same thrust is a weak one.

--forces plants forces and moments instead: the recording of a vehicle that flew the same path in spite of them, see
planted_forces.py.

--everywhere plants the fault in all rows, and takes no reference flights: the model is made of what it is asked about.
Most of a fault then is in the model. It is right to name nothing, or the plant, and wrong to name anything else.
"""

import argparse
import copy
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")

import hidden
import numpy as np
import pandas as pd
import planted_forces
from beds import FIRST, OF_THE_AIRFRAME, SECOND, unpack
from hidden import Recorded, identified, processed
from hide_and_seek import SETTINGS, seek
from measured_table import record
from scipy.spatial.transform import Rotation
from study import ROOT, run, show_found

import quasi.importing.flight as importing
from quasi.importing.calibration import felt_too_much
from quasi.importing.onboard_log import Onboard
from quasi.model.model import Model
from quasi.tables import read_json
from quasi.terms.rotor_map import SHARES, SPEEDS

Change = Callable[[Onboard], Onboard]


class Plant(NamedTuple):
    """One fault.

    right   ids of which one must be named or stand in a tie; empty where import or filter settles it: nothing is named
    values  {parameter: value to be stated} of the first; change  of the streams; configure  of the quadrotor; acting
    the cause of `planted_forces` and its size
    """

    right: tuple[str, ...] = ()
    values: Mapping[str, float] = {}
    change: Change | None = None
    configure: Mapping[str, Any] = {}
    acting: tuple[str, float] | None = None


def rotors(change: Callable[[np.ndarray], np.ndarray], late: float = 0.0) -> Change:
    """Logged speeds (n, 4), or without them commands, changed, and late by some seconds."""

    def applied(board: Onboard) -> Onboard:
        # rotors that follow late are late behind commands, and early in a log whose commands are late
        names, shift = (SPEEDS, late) if board.rotors is not None else (SHARES, -late)
        values = change(np.stack([np.ravel(board.others[n].values) for n in names], axis=1))
        others = {
            n: replace(track, t=track.t + shift, values=values[:, names.index(n)].reshape(track.values.shape))
            if n in names else track for n, track in board.others.items()
        }  # fmt: skip
        if board.rotors is None:
            return replace(board, others=others)
        together = replace(board.rotors, t=board.rotors.t + late, values=change(board.rotors.values))
        return replace(board, rotors=together, others=others)

    return applied


def one_rotor(number: int, factor: float) -> Plant:
    """The speeds of one rotor scaled: it makes 1/factor^2 of the thrust and torque that its speed says."""
    factors = np.where(np.arange(1, 5) == number, factor, 1.0)
    return Plant(("rotor_effectiveness",), {f"rotor{number}": factor**-2.0}, rotors(lambda w: w * factors))


def imu(force: Callable[[np.ndarray], np.ndarray], gyro: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Specific force (n, 3) and body rates (n, 3) changed."""
    return lambda board: replace(
        board,
        force=replace(board.force, values=force(board.force.values)),
        gyro=replace(board.gyro, values=gyro(board.gyro.values)),
    )


def same(values: np.ndarray) -> np.ndarray:
    """Nothing changed."""
    return values


def times(*factors: float) -> Callable[[np.ndarray], np.ndarray]:
    """Axes times factors."""
    return lambda values: values * np.array(factors)


def turned(*degrees: float) -> Callable[[np.ndarray], np.ndarray]:
    """What sensor axes turned by a rotation vector show."""
    return Rotation.from_rotvec(np.deg2rad(degrees)).inv().apply


def moved_imu(*arm: float) -> Change:
    """An accelerometer that stands `arm` (m, body axes) further from the centre of gravity."""

    def applied(board: Onboard) -> Onboard:
        gyro, force = board.gyro, board.force
        even = np.arange(len(gyro.t)) * float(np.median(np.diff(gyro.t)))
        felt = felt_too_much(even, gyro.values, np.array(arm))
        felt = np.stack([np.interp(force.t, gyro.t, column) for column in felt.T], axis=1)
        return replace(board, force=replace(force, values=force.values + felt))

    return applied


def curved(share: float) -> Change:
    """Speeds that are wrong in proportion to their distance from those in hover."""

    def change(speeds: np.ndarray) -> np.ndarray:
        hover = np.nanmedian(speeds)
        return speeds * (1.0 + share * (speeds / hover - 1.0))

    return rotors(change)


def inertia(*factors: float) -> Plant:
    """A configured inertia (Ixx, Iyy, Izz) that is wrong by factors."""
    text = "; ".join(", ".join(str(f * i if k == n else 0) for k in range(3)) for n, (f, i) in enumerate(
        zip(factors, INERTIA)))  # fmt: skip
    wrong = {f"I{a}{a}": i for a, i, f in zip("xyz", INERTIA, factors) if f != 1.0}
    return Plant(("inertia",), wrong, configure={"moment of inertia": f"[{text}]"})


def mass(factor: float) -> Plant:
    """A configured mass that is wrong by a factor."""
    return Plant(("mass",), {"mass": MASS}, configure={"mass": repr(factor * MASS)})


def marker(axis: str, wrong: float) -> Plant:
    """A configured place of the marker that is wrong by some metres."""
    place = {**MARKER, axis: MARKER[axis] + wrong}
    return Plant(("marker_offset", "imu_lever_arm"), {axis: -wrong},
                 configure={"optitrack marker cg offset": {k: str(v) for k, v in place.items()}})  # fmt: skip


def acting(cause: str, size: float, parameter: str = "", *rivals: str) -> Plant:
    """A force or moment that the vehicle flew the same path in spite of."""
    value = 1.0 + size if parameter == "factor" else size
    return Plant((cause, *rivals), {parameter: value} if parameter else {}, acting=(cause, size))


# as the set's configuration has them: kg, kg m2, m
MASS, INERTIA, MARKER = 0.433, (0.000865, 0.00107, 0.00171), {"x": 0.0, "y": -0.01, "z": -0.048}
SCALE, LATE, TURNED = ("rotor_speed_scale", "thrust_factor"), ("telemetry_delay",), ("imu_misalignment",)
PLANTS: dict[str, Plant] = {
    "nothing": Plant(),
    **{f"rotor {n} x {f}": one_rotor(n, f) for n, f in (
        (1, 1.03), (1, 0.9), (2, 0.97), (2, 1.02), (3, 0.95), (3, 1.08), (4, 1.05), (4, 0.985),
    )},
    **{f"all rotors x {f}": Plant(SCALE, {"scale": f}, rotors(times(f, f, f, f))) for f in (1.03, 0.95, 0.9)},
    **{f"mass x {f}": mass(f) for f in (0.95, 1.03, 1.08, 0.9)},
    "inertia x 1.2": inertia(1.2, 1.2, 1.2),
    "Ixx x 0.8": inertia(0.8, 1.0, 1.0),
    "Iyy x 1.15": inertia(1.0, 1.15, 1.0),
    "Izz x 1.3": inertia(1.0, 1.0, 1.3),
    "accelerometer x 1.02": Plant(
        ("accelerometer_scale",), dict.fromkeys("xyz", 1.02), imu(times(1.02, 1.02, 1.02), same)
    ),
    "accelerometer z x 0.97": Plant(("accelerometer_scale",), {"z": 0.97}, imu(times(1.0, 1.0, 0.97), same)),
    "gyro x 1.03": Plant(("gyro_scale",), dict.fromkeys("xyz", 1.03), imu(same, times(1.03, 1.03, 1.03))),
    "gyro z x 0.97": Plant(("gyro_scale",), {"z": 0.97}, imu(same, times(1.0, 1.0, 0.97))),
    "gyro y x 1.01": Plant(("gyro_scale",), {"y": 1.01}, imu(same, times(1.0, 1.01, 1.0))),
    **{f"imu turned by {v} deg": Plant(TURNED, {}, imu(turned(*v), turned(*v)))
       for v in ((0.0, 0.0, 2.0), (2.0, 0.0, 0.0), (0.0, -2.0, 0.0))},
    **{f"imu moved by {v} m": Plant(("imu_lever_arm",), dict(zip("xyz", v)), moved_imu(*v))
       for v in ((0.02, 0.0, 0.0), (0.0, -0.02, 0.0))},
    **{f"marker wrong by {v} m along {a}": marker(a, v) for a, v in (("x", 0.01), ("z", 0.01), ("y", -0.015))},
    "speeds 5 ms late": Plant(LATE, {"delay": 0.005}, rotors(same, 0.005)),
    "speeds 10 ms late": Plant(LATE, {"delay": 0.010}, rotors(same, 0.010)),
    "speeds curved 0.06": Plant(("thrust_curve",), {}, curved(0.06)),
    "speeds curved -0.1": Plant(("thrust_curve",), {}, curved(-0.1)),
    "speeds of rotors 1 and 2 exchanged": Plant(("rotor_order",), {}, rotors(lambda w: w[:, [1, 0, 2, 3]])),
    "speeds of rotors 2 and 4 exchanged": Plant(("rotor_order",), {}, rotors(lambda w: w[:, [0, 3, 2, 1]])),
    # constant biases, which the filter takes off
    "gyro x + 0.05": Plant(("gyro_bias",), change=imu(same, lambda v: v + [0.05, 0.0, 0.0])),
    "accelerometer y + 0.3": Plant(("accelerometer_bias",), change=imu(lambda v: v + [0.0, 0.3, 0.0], same)),
    "rotor 2 x 0.96, mass x 0.95": Plant(
        ("rotor_effectiveness", "mass"), {"rotor2": 0.96**-2.0}, one_rotor(2, 0.96).change, mass(0.95).configure
    ),
    "rotor 4 x 1.04, inertia x 1.2": Plant(
        ("rotor_effectiveness", "inertia"), {"rotor4": 1.04**-2.0}, one_rotor(4, 1.04).change,
        inertia(1.2, 1.2, 1.2).configure,
    ),
    # sizes: those that hidden.py draws about, and twice as much
    **{f"{cause} of {size:g}": acting(cause, size, name) for cause, name, *sizes in (
        ("rotor_drag", "k", 8e-6, 1.6e-5), ("body_drag", "c", 0.02, 0.04), ("blade_flapping", "k", 3e-7, 6e-7),
        ("translational_lift", "k", 0.01, 0.02), ("axial_inflow", "k", 2e-5, 4e-5), ("ground_effect", "c", 4.0, 8.0),
        ("rotor_interference", "k", 0.1, 0.2), ("thrust_drift", "rate", 0.001, 0.002),
        ("thrust_factor", "factor", 0.04, 0.08), ("rotor_gyroscopic", "inertia", 1e-6, 2e-6),
        ("cg_offset", "x", 0.003, 0.006), ("tether", "k", 0.1, 0.2),
    ) for size in sizes},
    # as simulators have it that know no hubs
    **{f"{cause} of {size:g} at the centre": Plant((cause,), {"k": size}, acting=(f"{name}_at_centre", size))
       for cause, name, *sizes in (("rotor_drag", "drag", 8e-6, 1.6e-5), ("axial_inflow", "inflow", 2e-5, 4e-5),
                                    ("translational_lift", "lift", 0.01, 0.02), ("ground_effect", "ground", 4.0, 8.0))
       for size in sizes},
    **{f"tether of {size:g} fixed aside": Plant(("tether",), {"k": size}, acting=("tether_aside", size))
       for size in (0.1, 0.2)},
    **{f"wind of {size:g} N": acting("wind", size) for size in (0.05, 0.1)},
}  # fmt: skip


# by commands alone a rotor's scale is that of its thrust, and what all rotors share may be of the battery
BY_COMMANDS = {
    **dict.fromkeys((SCALE, SCALE[1:], ("thrust_drift",)), (*SCALE, "battery_sag", "thrust_curve", "thrust_drift")),
    LATE: ("motor_lag", "command_delay", "inflow_lag"),
}  # fmt: skip


def without_speeds(board: Onboard) -> Onboard:
    """The log of a flight controller that does not log the rotor speeds."""
    return replace(board, rotors=None, others={n: track for n, track in board.others.items() if n not in SPEEDS})


def find_flights(bed: Path) -> dict[int, Recorded]:
    """Flights of a set by their row of the logbook."""
    log, found = pd.read_csv(bed / "data/logbook.csv"), {}
    for row in (*FIRST, *SECOND):
        cells = log.iloc[row - 2]
        raw = {
            kind: str(next((bed / "data/raw" / kind).glob(f"{cells[column]}.*")))
            for kind, column in (("onboard", "Onboard Name"), ("optitrack", "Raw OptiTrack Name"))
        }
        source = {
            "flight": f"row-{row}", "quadrotor": cells["Quadrotor"], "flight controller": cells["Flight controller"],
            "rigid body": cells["Rigid Body Name"], "onboard": raw["onboard"], "capture": raw["optitrack"],
            "log number": None,
        }  # fmt: skip
        quadrotor = read_json(bed / f"data/{cells['Drone Config File']}.json")
        found[row] = Recorded(source, {**quadrotor, "file": cells["Drone Config File"]})
    return found


def draw(name: str, bed: Path, telemetry: bool, everywhere: bool) -> dict[str, Any]:
    """Plant and diagnose."""
    plant, flights, gather = PLANTS[name], find_flights(bed), importing.gather
    rows = (*FIRST, *SECOND) if everywhere else SECOND
    planted = {flights[row].source["flight"] for row in rows}
    act, import_flight = None, hidden.import_flight
    if plant.acting is not None:
        before = {flights[row].source["flight"]: processed(flights[row], row in SECOND) for row in rows}
        act = planted_forces.planted(before, *plant.acting)

    def gather_planted(recording: Any, where: str, *others: Any) -> Onboard:
        board = gather(recording, where, *others)
        board = board if telemetry else without_speeds(board)
        return plant.change(board) if plant.change is not None and where in planted else board

    def import_planted(source: Mapping[str, Any], *others: Any) -> tuple[pd.DataFrame, dict[str, Any]]:
        frame, about = import_flight(source, *others)
        return (act(frame, source["flight"]) if act is not None and source["flight"] in planted else frame), about

    for row in rows:
        flights[row].quadrotor.update(copy.deepcopy(plant.configure))
    importing.gather, hidden.import_flight = gather_planted, import_planted
    try:
        flown = {row: processed(recorded, row in SECOND) for row, recorded in flights.items()}
        model = Model(identified([flown[row] for row in FIRST]))
        compared = SECOND if everywhere else (*FIRST, *SECOND)
        *learned, held = [(flights[row], flown[row]) for row in compared]
        document, _ = seek(learned, held, model, "none" if everywhere else "given", SETTINGS)
    finally:
        importing.gather, hidden.import_flight = gather, import_flight
    return {k: document[k] for k in ("verdict", "summary", "effects", "ties", "unexplained", "losses", "candidates")}


def judge(name: str, found: dict[str, Any], telemetry: bool, everywhere: bool) -> dict[str, Any]:
    """Whether all planted causes are named or stand in a tie, what else is named, and errors of what is stated."""
    plant, named = PLANTS[name], {e["id"]: e["parameters"] for e in found["effects"]}
    if not telemetry and plant.change is not None:  # how thrust follows a command is the model's to say
        of_rotors = set(plant.right) & {"rotor_effectiveness", *SCALE, *LATE, "thrust_curve"}
        plant = plant._replace(
            right=BY_COMMANDS.get(plant.right, plant.right), values={} if of_rotors else plant.values
        )
    ties = [t["ids"] for t in found["ties"]]
    both = "," in name  # two causes: each must be there; else one of those that are admitted
    there = [i in named or any(i in t for t in ties) for i in plant.right]
    wrong = [i for i in named if i not in plant.right]
    wrong += ["/".join(t) for t in ties if not set(t) & set(plant.right)]
    errors = {
        k: (own["value"] - plant.values[k]) / own["std"]
        for i in plant.right[:1] for k, own in named.get(i, {}).items() if k in plant.values and own["std"]
    }  # fmt: skip
    if everywhere:  # the model holds the fault, or part of it
        wrong = [i for i in wrong if i not in OF_THE_AIRFRAME]
        return {"right": not wrong, "wrong": wrong, "in std": {}}
    return {"right": (all(there) if both else any(there)) or not plant.right, "wrong": wrong, "in std": errors}


def main() -> None:
    """Run all plants, print a table, and record its figures when asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bed", type=Path)
    parser.add_argument("--plants", nargs="*", default=[], help="parts of names; all without")
    parser.add_argument("--commands-only", action="store_true", help="withhold the rotor speeds")
    parser.add_argument("--forces", action="store_true", help="plant forces and moments")
    parser.add_argument("--everywhere", action="store_true", help="plant in all rows, no row is a reference")
    parser.add_argument("--out", type=Path, default=ROOT / "results/benchmarks/bed_plants")
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    arguments = parser.parse_args()
    bed = unpack(arguments.bed, arguments.out)
    names = [n for n, plant in PLANTS.items() if (plant.acting is not None) == arguments.forces]
    names = [n for n in names if not arguments.plants or any(p in n for p in arguments.plants)]
    telemetry, everywhere = not arguments.commands_only, arguments.everywhere
    way = ["by_commands"] * arguments.commands_only + ["everywhere"] * everywhere
    kind = "_".join(["bed_forces" if arguments.forces else "bed_plants", *way])
    out = arguments.out / "_".join(way).replace("by_commands", "commands-only")
    results = run(
        [{"plant": n} for n in names], lambda s: draw(s["plant"], bed, telemetry, everywhere), out, Path(__file__)
    )  # fmt: skip
    judged = {name: judge(name, found, telemetry, everywhere) for name, found in zip(names, results)}
    for name, found in zip(names, results):
        one = judged[name]
        print(f"{name}: {'right' if one['right'] else 'MISSED'}, {found['verdict']}"
              + (f", wrong: {', '.join(one['wrong'])}" if one["wrong"] else ""))  # fmt: skip
        show_found(found)
    errors = np.array([e for one in judged.values() for e in one["in std"].values()])
    values: dict[str, Any] = {
        "plants": len(names), "right": sum(one["right"] for one in judged.values()),
        "wrong": sum(bool(one["wrong"]) for one in judged.values()), "stated": len(errors),
        "within": int(np.sum(np.abs(errors) < 2.0)),
        "named": sum(bool(found["effects"] or found["ties"]) for found in results),
        "refused": sum(found["verdict"] == "not judged" for found in results),
        "missed": "; ".join(n for n, one in judged.items() if not one["right"]) or "none",
    }  # fmt: skip
    print(values)
    if arguments.record:
        record(kind, values)


if __name__ == "__main__":
    main()
