"""Real flights with known causes: every condition of CrazyPAD against its normal flights, by the trim in hover.

    python benchmarks/real_causes.py [PATH of crazypad] [--splits 200] [--seed 0]
    python benchmarks/real_causes.py [PATH of crazypad] --gaps FOLDER [--jobs 2]

The folder's name is the truth. Sessions: flights of one folder, in the order of their numbers, belong together as long
as the battery's voltage at rest falls; where it rises by 20 mV or more the battery was changed, and a session begins.
(The files' dates are those of the copy; the logs hold no date.)

Printed are the answer for each condition, a confusion matrix of truth and answer, and false alarms of normal against
normal: each session left out, each three flights of seven, and bootstrap splits over flights. The count by hand that it
is compared with: rotors whose mean square root of the command lies beyond three spreads of the normal flights.

With --gaps each condition is a whole gap of the workflow, made in FOLDER (examples/crazyflie, one gap a condition): the
model of the normal flights with speeds estimated from commands, its first two flights compared, the third held out. The
names are those of diagnosis.json. It takes a quarter of an hour; what is made stays, so that it can be continued.
"""

import argparse
import csv
import itertools
import json
import re
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from quasi.gap.levels.hover_trim import Flight, Geometry, compare, conclude, geometry_of, hypotheses
from quasi.gap.levels.steady_flight import steady_flight
from quasi.importing.readers.crazyflie import read_crazyflie

ARM = 0.046 / np.sqrt(2.0)  # m, lateral and longitudinal distance of the hubs of a Crazyflie 2.1
HUBS = np.array([[ARM, ARM], [-ARM, ARM], [-ARM, -ARM], [ARM, -ARM]])  # M1 front right, then clockwise
SPINS = np.array([1.0, -1.0, 1.0, -1.0])  # M1 counter-clockwise
RADIUS = 0.0235  # m
NEW_BATTERY = 0.02  # V of rise at rest
NORMAL = "normal_flight"
NOT_MADE = "not made"  # a gap whose flights import refuses
ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples/crazyflie"
SHORT = {"cg_offset": "cg"}


class Log(NamedTuple):
    """One flight: condition, file, trim, mean square roots of the commands (4,) in steady flight, volts at rest."""

    condition: str
    file: str
    flight: Flight
    roots: np.ndarray
    rest_volts: float


def read_logs(folder: Path) -> dict[str, list[Log]]:
    """{condition: flights in the order of their numbers}, with their sessions. Raises SystemExit without flights."""
    found: dict[str, list[Log]] = defaultdict(list)
    for path in sorted(folder.glob("*/*_log*")):
        series = read_crazyflie(path).series["onboard"]
        at = np.arange(series.t[0], series.t[-1], 0.01)
        frame = pd.DataFrame({"t": at} | {n: np.interp(at, series.t, v) for n, v in series.values.items()})
        frame = frame.rename(columns={"vx": "u", "vy": "v", "vz": "w"})
        steady = steady_flight(frame, RADIUS)
        commands = frame[[f"command{i}" for i in range(1, 5)]].to_numpy()
        aloft = frame["z"].to_numpy() < -0.3
        rest = float(frame["battery_voltage"][commands.max(axis=1) <= 0.0].median())
        condition, before = path.parent.name, found[path.parent.name]
        number = 1 if not before else int(before[-1].flight.session.rpartition(" ")[2])
        number += bool(before) and rest > before[-1].rest_volts + NEW_BATTERY
        flight = Flight(path.name, steady.thrust, steady.volts, f"{condition} {number}", condition != NORMAL)
        before.append(Log(condition, path.name, flight, np.sqrt(commands[aloft]).mean(axis=0), rest))
    if NORMAL not in found:
        raise SystemExit(f"{folder} holds no {NORMAL}/*_log*; give the folder of CrazyPAD")
    return dict(found)


def cut_length(condition: str) -> float | None:
    """Millimetres by which a condition's propeller is shorter, both blades together; None for another condition."""
    if not condition.startswith("cut_propeller"):
        return None
    sizes = [float(s) for s in re.findall(r"([0-9.]+)mm", condition)]
    return sum(s for s in sizes if s < 20.0)  # the last is the length that is left


def truth_of(condition: str) -> str:
    """The row of the confusion matrix."""
    cut = cut_length(condition)
    if cut is not None:
        return "cut of 3 mm and more" if cut >= 3.0 else "cut below 3 mm"
    return condition.partition("_W")[0].partition("_on_propeller")[0].replace("_", " ")


def answer_of(flights: list[Flight], geometry: Geometry) -> tuple[str, tuple[str, ...], float]:
    """Word, names, and the probability that they have together."""
    found = compare(flights, hypotheses(geometry), geometry)
    word, names = conclude(found)
    return word, tuple(names), sum(found.probability[n] for n in names) if names else found.probability["healthy"]


def by_hand(normal: list[Log], condition: list[Log]) -> list[int]:
    """Rotors, from 1, whose mean square root of the command lies beyond three spreads of the normal flights."""
    usual = np.stack([log.roots for log in normal])
    away = np.mean([log.roots for log in condition], axis=0) - usual.mean(axis=0)
    return [i + 1 for i in range(4) if abs(away[i]) > 3.0 * usual.std(axis=0, ddof=1)[i]]


def normal_splits(normal: list[Log], count: int, seed: int) -> Iterator[tuple[str, list[Flight]]]:
    """Normal flights divided into reference and compared ones."""
    flights = [log.flight for log in normal]

    def divided(taken: set[int], among: range | list[int]) -> list[Flight]:
        return [flights[i]._replace(is_compared=i in taken) for i in sorted(set(among) | taken)]

    everything = range(len(flights))
    for session in dict.fromkeys(f.session for f in flights):
        yield "session left out", divided({i for i in everything if flights[i].session == session}, everything)
    for taken in itertools.combinations(everything, 3):
        yield "three left out", divided(set(taken), everything)
    rng, drawn = np.random.default_rng(seed), 0
    while drawn < count:
        reference = rng.integers(0, len(flights), len(flights)).tolist()
        taken = set(everything) - set(reference)
        if len(taken) > 1:
            drawn += 1
            yield "bootstrap", divided(taken, reference)


def print_conditions(logs: dict[str, list[Log]], geometry: Geometry) -> dict[str, tuple[str, ...]]:
    """Print the answer for each condition; return the names."""
    normal, answers = logs[NORMAL], {}
    print(f"{'condition':36s} {'cut':>5s} {'answer':8s} {'p':>5s}  names; by hand")
    for condition in sorted(set(logs) - {NORMAL}, key=lambda c: (cut_length(c) or 0.0, c)):
        flights = [log.flight for log in [*normal, *logs[condition]]]
        word, names, p = answer_of(flights, geometry)
        answers[condition] = names
        hand = by_hand(normal, logs[condition])
        cut = cut_length(condition)
        print(
            f"{condition[:36]:36s} {'' if cut is None else f'{cut:g}':>5s} {word:8s} {p:5.2f}  "
            f"{', '.join(names) or '-'}; {', '.join(f'rotor {i}' for i in hand) or '-'}"
        )
    return answers


def print_matrix(answers: dict[str, tuple[str, ...]]) -> None:
    """Print truth against answer, and the shares that are asked for."""
    table: dict[str, Counter] = defaultdict(Counter)
    for condition, names in answers.items():
        table[truth_of(condition)][" or ".join(names) or "no name"] += 1
    columns = sorted({name for row in table.values() for name in row}, key=lambda n: (n == "no name", n))
    print(f"\n{'truth':28s}" + "".join(f"{c:>22s}" for c in columns))
    for truth in sorted(table):
        print(f"{truth:28s}" + "".join(f"{table[truth][c]:22d}" for c in columns))
    large = [names for c, names in answers.items() if (cut_length(c) or 0.0) >= 3.0]
    held = sum("rotor 3" in names for names in large)
    wrong = [c for c, names in answers.items() if set(names) - {NOT_MADE} and not _is_admitted(c, names)]
    print(f"\ncuts of 3 mm and more: rotor 3 named or in the tie in {held} of {len(large)} conditions")
    print(f"wrong names: {len(wrong)} of {len(answers)} conditions{': ' + ', '.join(wrong) if wrong else ''}")


def _is_admitted(condition: str, names: tuple[str, ...]) -> bool:
    """Whether names hold the truth, as far as it has one."""
    if cut_length(condition) is not None:
        return "rotor 3" in names
    if "weight" in condition:
        return bool({"mass", "cg", "weight"} & set(names))
    return "rotor 3" in names  # tape on propellers, rotor 3 among them in each condition


def print_normals(logs: dict[str, list[Log]], geometry: Geometry, count: int, seed: int) -> None:
    """Print how often normal flights get a name against normal flights."""
    tried, named = Counter(), Counter()
    for kind, flights in normal_splits(logs[NORMAL], count, seed):
        tried[kind] += 1
        named[kind] += bool(answer_of(flights, geometry)[1])
    print(
        "\nnormal against normal: "
        + "; ".join(f"{kind}: {named[kind]} names in {tried[kind]} splits" for kind in tried)
    )


def write_gaps(folder: Path) -> dict[str, str]:
    """Lay the example in a folder, with a gap a condition; return {condition: gap}."""
    shutil.copytree(EXAMPLE, folder, dirs_exist_ok=True)
    with (folder / "data/crazypad_file_log.csv").open(newline="", encoding="utf-8") as file:
        flights = list(csv.DictReader(file))
    rows: dict[str, list[int]] = defaultdict(list)
    for number, flight in enumerate(flights, 2):
        rows[flight["OB Path"].rpartition("/")[2]].append(number)
    normal, gaps = rows.pop(NORMAL), {}
    example = json.loads((folder / "config/gaps/cut-5mm.json").read_text(encoding="utf-8"))
    for number, (condition, own) in enumerate(rows.items(), 1):
        gaps[condition] = f"condition-{number:02d}"
        book = {**example["logging file"], "rows of flights to compare (all)": own,
                "rows of flights held out": own[-1:], "rows of reference flights": normal}  # fmt: skip
        document = {**example, "logging file": book, "extended model ID": f"crazypad-{gaps[condition]}"}
        (folder / f"config/gaps/{gaps[condition]}.json").write_text(json.dumps(document, indent=2), encoding="utf-8")
    return gaps


def names_of(diagnosis: Path) -> tuple[str, ...]:
    """Names in a diagnosis: rotors by their number, other causes by their id; a tie as its members."""
    if not diagnosis.is_file():
        return (NOT_MADE,)
    found = json.loads(diagnosis.read_text(encoding="utf-8"))
    names: list[str] = []
    for effect in found["effects"]:
        rotors = [n for n in effect["parameters"] if n.startswith("rotor") and n[5:].isdigit()]
        is_rotor = effect["id"] == "rotor_effectiveness"
        names += [f"rotor {n[5:]}" for n in rotors] if is_rotor else [SHORT.get(effect["id"], effect["id"])]
    for tie in found["ties"]:
        trim = tie.get("trim") or {}
        names += list(trim) or [SHORT.get(i, i) for i in tie["ids"]]
    return tuple(dict.fromkeys(names))


def run_gaps(data: Path, folder: Path, jobs: int) -> dict[str, tuple[str, ...]]:
    """Make the gaps of all conditions; return their names, after a table of them."""
    gaps = write_gaps(folder)
    targets = [f"results/gaps/{gap}/diagnosis.json" for gap in gaps.values()]
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(folder), f"-j{jobs}",
               "--keep-going", "--config", f"data={data.resolve().parent}", "--", *targets]  # fmt: skip
    subprocess.run(command, check=False)  # conditions that cannot be made are reported below
    answers = {c: names_of(folder / f"results/gaps/{gap}/diagnosis.json") for c, gap in gaps.items()}
    for condition, names in answers.items():
        print(f"{condition[:36]:36s} {', '.join(names) or '-'}")
    return answers


def main() -> None:
    """Read, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    here = Path(__file__).parents[2] / "shared" / "data" / "crazypad"
    parser.add_argument("path", nargs="?", type=Path, default=here)
    parser.add_argument("--splits", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--gaps", type=Path)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    if asked.gaps is not None:
        print_matrix(run_gaps(asked.path, asked.gaps, asked.jobs))
        return
    logs, geometry = read_logs(asked.path), geometry_of(HUBS, SPINS)
    sessions = {log.flight.session for flights in logs.values() for log in flights}
    print(
        f"{sum(map(len, logs.values()))} flights, {len(logs)} conditions, {len(sessions)} sessions by battery voltage"
    )
    print_matrix(print_conditions(logs, geometry))
    print_normals(logs, geometry, asked.splits, asked.seed)


if __name__ == "__main__":
    main()
