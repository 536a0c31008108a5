"""Hide and seek: causes drawn from a seed are hidden in raw logs; are they named, and nothing else?

    python benchmarks/hide_and_seek.py [--first 30000] [--draws 300] [--world drawn] [--rate 0.05] [--table]
                                       [--out results/benchmarks/hide_and_seek]

The study has the seeds from 30000. Its draws belong to WORLDS worlds by turns: `--world drawn` takes the seed modulo
their number. World 0 is mild; `--world mild` takes it for every seed, as the study of seeds 10300 to 10699 did.

Each draw makes four flights of 30 s, imports and filters the raw logs, settles levels K and A, processes the flights
anew with what these found, diagnoses them (one is held out) as the workflow does, and compares the diagnosis with the
truth, which nothing else reads. One JSON per draw; a study that was stopped goes on where it was. --table makes
docs/hide-and-seek.md of the files that are there, without drawing. --rate seeks in the same flights at another false
alarm rate; such draws are in a table of their own.

The model was identified from sixteen other healthy flights. Half and more of the draws have four healthy reference
flights in addition to the affected ones ("reference"); in others every flight is affected, and four of those that made
the model stand for reference flights ("all"), or the model was identified from the affected flights themselves ("own").
`clarity` measures how clearly a hidden cause shows.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from clarity import Asked, clarity
from hidden import (
    ALL,
    OWN,
    SHOWS,
    STRANGE,
    WORLDS,
    Recorded,
    affected,
    again,
    deviation,
    drawn,
    healthy_model,
    identified,
    processed,
    references,
    session_of,
    trained,
    world,
)
from study import run

from quasi.errors import DataError
from quasi.gap.calibration import lower
from quasi.gap.calibration.corrections import for_flight
from quasi.gap.catalogue import catalogue
from quasi.gap.diagnosis import diagnose
from quasi.gap.effect import room_of, vehicle_of
from quasi.gap.flights.gathering import gather
from quasi.gap.flights.level import Flown
from quasi.model.model import Model
from quasi.synthesis.vehicle import base_vehicle
from quasi.tables import read_json, write_text

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "results/benchmarks/hide_and_seek"
SAMPLING = 100.0  # Hz, of the comparison of forces and moments
_ROOM = base_vehicle().physics.room
SETTINGS = {
    "model": "healthy", "extended model ID": "healthy-extended", "horizons": [0.1, 0.5], "false alarm rate": 0.01,
    "material share": 0.05,
    "room": {"north": [-_ROOM[0], _ROOM[0]], "east": [-_ROOM[1], _ROOM[1]], "height": _ROOM[2]},
}  # fmt: skip
CLEAR, VISIBLE = 10.0, 3.0
INDISTINCT = {"thrust_factor", "rotor_speed_scale"}  # the torque alone tells them apart: always a tie
SEEN = 5.0  # |t| at which a cause is usually named
# what the made vehicle has anyway and a fitted model may lack: reported of every flight, it is no wrong name
INHERENT = {"rotor_drag", "body_drag", "blade_flapping", "axial_inflow", "vortex_ring", "rotor_interference",
            "inflow_lag", "rotor_gyroscopic", "rotor_acceleration_torque", "translational_lift"}  # fmt: skip


def draw(settings: dict[str, Any], seconds: float = 30.0, folder: Path = OUT) -> dict[str, Any]:
    """Hide, seek, and compare.

    settings  {"seed"} of `drawn`; "world": number of its world (0, the mild one); "hide": what `drawn` would return;
    "rate": another false alarm rate; "restless": see `hidden.affected`
    """
    seed = settings["seed"]
    hidden, of = settings.get("hide") or drawn(seed), world(settings.get("world", 0))
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as raw:
        own = hidden["design"] == "own"
        number, restless = OWN if own else 4, settings.get("restless")
        recorded = affected(Path(raw), seed, hidden["effects"], seconds, number, restless, of)
        try:
            flown = [processed(r, True) for r in recorded]
        except DataError as error:  # the vehicle was lost, or its log cannot be read
            return {**hidden, "outcome": "lost", "why": str(error), "sizes": {}, "seconds": {"whole": 0.0}}
        beside, given = {"reference": (references, "given"), "all": (trained, "training"), "own": (None, "none")}[
            hidden["design"]
        ]
        made = time.perf_counter() - begin
        # the first flight has manoeuvres of every kind: what is material shows there
        learned = [*(beside(folder / "healthy", seed, of=of) if beside else ()), *zip(recorded[1:], flown[1:])]
        if own:
            model = Model(identified(flown[1:]))
        else:
            model = healthy_model(folder / "healthy", of.number)
        asked_with = {**SETTINGS, "false alarm rate": settings.get("rate", SETTINGS["false alarm rate"])}
        if of.number:
            healthy_seeds = {r.source["flight"]: int(r.source["flight"].split("-")[1]) for r, f in learned
                             if not f.compared}  # fmt: skip
            asked_with["sessions"] = {r.source["flight"]: session_of(seed, of) for r in recorded} | {
                key: session_of(own_seed, of) for key, own_seed in healthy_seeds.items()
            }
        document, asked = seek(learned, (recorded[0], flown[0]), model, given, asked_with)
    sizes = {name: clarity(name, hidden["effects"][name], asked) for name in hidden["effects"]}
    kept = ("verdict", "summary", "ties", "unexplained", "findings", "candidates", "notes")
    result = {
        "world": of.number,
        **hidden,
        "effects said": document["effects"],
        **{k: document[k] for k in kept},
        "sizes": sizes,
    }
    result["seconds"] = {"made": made, "whole": time.perf_counter() - begin}
    return {**result, **judge(result)}


def seek(
    learned: Sequence[tuple[Recorded, Flown]], held: tuple[Recorded, Flown], model: Model, given: str,
    settings: Mapping[str, Any] = SETTINGS,
) -> tuple[dict[str, Any], Asked]:  # fmt: skip
    """The diagnosis of flights, without any knowledge of what is hidden, and what it was made of."""
    effects = catalogue()
    recorded, flown = [list(part) for part in zip(*learned)]
    raw = {f.key: r for r, f in learned}
    told, levels = lower.examine(
        flown, model.document, settings, effects, lambda f, c: again([raw[f.key]], [f], [c])[0], 1
    )
    calibrations = [for_flight(told, f.compared) for f in [*flown, held[1]]]
    everything = again([*recorded, held[0]], [*flown, held[1]], calibrations)
    roles = {f.key: "compared" if f.compared else "reference" for f in everything}
    roles[held[1].key] = "held out"
    evidence = {f.key: gather(f.key, f.filtered, f.filtered_metadata, f.airframe, model, SAMPLING) for f in everything}
    found = diagnose(
        model, told, evidence, {f.key: f.filtered for f in everything}, roles, effects, settings,
        ([held[1]], [everything[-1]]), "hidden", (), given,
    )  # fmt: skip
    vehicle = vehicle_of(model, room=room_of(SETTINGS["room"]))
    compared = np.array([f.compared for f in flown])
    return found.document, Asked(found.found.study, vehicle, compared, effects, levels, given == "none")


def judge(result: Mapping[str, Any]) -> dict[str, Any]:
    """Compare the report with the truth: {"outcome", "wrong", "model's own", "tied", "found", "first", "errors"}.

    outcome  "hit": every hidden cause is named or in a tie of at most three, nothing else is; "extra": named, and
    something else beside it; "partly": some are; "wrong": something else only; "tied elsewhere": a tie without it;
    "missed": nothing; "agrees": nothing, rightly; "false": of clean flights, something; "model's own": of clean
    flights, what the vehicle has in every flight and the model lacks
    """
    truth = set(result["effects"]) - set(STRANGE)
    named = [e["id"] for e in result["effects said"]]
    ties = [t["ids"] for t in result["ties"]]
    # what the data can tell apart has to be named
    apart = {c for c in truth if (result["sizes"].get(c, {}).get("separability") or 0.0) > CLEAR}
    apart -= {c for c in truth if c in INDISTINCT}
    found = {c for c in truth if c in named or any(c in t and len(t) <= 3 and c not in apart for t in ties)}
    inherent = INHERENT | ({"thrust_curve"} if result.get("world", 0) else set())
    own = [e["id"] for e in result["effects said"] if e["id"] not in truth and e["id"] in inherent and in_all(e)]
    wrong = [n for n in named if n not in truth and n not in own]
    strange_ties = [t["ids"] for t in result["ties"] if not truth & set(t["ids"]) and not in_all(t)]
    if not truth:
        outcome = "false" if wrong or strange_ties else "agrees" if result["verdict"] == "agrees" else "model's own"
    elif found == truth:
        outcome = "extra" if wrong or strange_ties else "hit"
    elif wrong:
        outcome = "wrong"
    else:
        outcome = "partly" if found else "tied elsewhere" if strange_ties else "missed"
    if result["kind"] == "unlisted" and outcome in ("agrees", "model's own"):
        shown = {u["channel"] for u in result["unexplained"]}
        outcome = "unexplained" if SHOWS[next(iter(result["effects"]))] in shown else "missed"
    return {
        "outcome": outcome,
        "wrong": wrong,
        "model's own": own,
        "tied": ties,
        "found": sorted(found),
        "first": bool(named) and named[0] in truth,
        "errors": {e["id"]: error for e in result["effects said"] if (error := _error(e, result["effects"]))},
    }


def in_all(entry: Mapping[str, Any]) -> bool:
    """Whether healthy flights show it as well."""
    return entry.get("in training flights", entry["since"] == "always")


def _error(said: Mapping[str, Any], planted: Mapping[str, Mapping[str, float]]) -> dict[str, float] | None:
    """Of the main parameter of a rightly named cause, relative and in standard errors; None where there is none."""
    if said["id"] not in planted:
        return None
    beyond = deviation(said["id"], planted[said["id"]])
    if said["id"] == "payload_swing":
        beyond = {"mass": planted["payload_swing"]["mass"]}  # told of the whole load
    main = max((k for k in beyond if k in said["parameters"]), key=lambda k: abs(beyond[k]), default=None)
    if main is None or not beyond[main]:
        return None
    value, std = said["parameters"][main]["value"], said["parameters"][main]["std"]
    true = planted[said["id"]].get(main, beyond[main])
    if said["level"] == "W" and said["id"] == "inflow_lag":
        true = beyond[main]  # told beyond what the model has
    error = value - true
    return {"relative": error / abs(beyond[main]), "in std": error / max(std, 1e-300)}


def group_of(result: Mapping[str, Any]) -> str:
    """The row of the table that a draw belongs to."""
    sizes = list(result["sizes"].values())
    if not sizes:
        return "clean"
    if result["kind"] == "unlisted":
        return "in no catalogue, above 10" if sizes[0]["detectability"] > CLEAR else "in no catalogue, below 10"
    least = min(s["detectability"] for s in sizes)
    apart = min(s["separability"] for s in sizes)
    if result["kind"] == "pair":
        return "pair, both above 10" if min(least, apart) > CLEAR else "pair, below 10"
    if least < VISIBLE:
        return "single, below 3"
    if least < CLEAR:
        return "single, 3 to 10"
    return "single, above 10, separable" if apart > CLEAR else "single, above 10, not separable"


GROUPS = {  # group: outcomes that are right, share that should be
    "clean": (("agrees",), 0.95),
    "single, above 10, separable": (("hit",), 0.95),
    "single, above 10, not separable": (("hit",), 0.90),
    "single, 3 to 10": (("hit",), 0.75),
    "single, below 3": (("hit", "missed"), 0.97),
    "pair, both above 10": (("hit",), 0.85),
    "pair, below 10": (("hit", "partly", "missed"), None),
    "in no catalogue, above 10": (("unexplained",), 0.90),
    "in no catalogue, below 10": (("unexplained", "missed"), 0.95),
}


DESIGNS = {"reference": "healthy reference flights and affected ones",
           "all": "every flight affected, the model from healthy ones",
           "own": "every flight affected, the model from these same flights"}  # fmt: skip


def _right(result: Mapping[str, Any]) -> bool:
    return result["outcome"] in GROUPS[group_of(result)][0]


def wilson(k: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """Interval of a share. Source: Wilson, JASA 22, 1927."""
    if n == 0:
        return 0.0, 1.0
    p, d = k / n, 1.0 + z * z / n
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return float((middle - half) / d), float((middle + half) / d)


HEAD = """# Hide and seek

Does quasi find causes that it does not know? Causes drawn from a seed are hidden in made flights. Raw logs are
imported and filtered, all levels are tested, and only then are the names compared with the truth. `python
benchmarks/hide_and_seek.py --table` makes this page.

The model is identified from sixteen healthy flights of 30 s. The designs differ in the flights that are compared:

- `reference`: four flights with the cause, one of them held out, and four other healthy ones.
- `all`: four flights with the cause, one of them held out, and four of those that made the model.
- `own`: six flights with the cause, one of them held out; the model is identified from the other five. It has
  absorbed lag, delay and battery of these flights, so causes of the drive leave no error and count as not shown.

Detectability and separability are the |t| of the true size, alone and next to its nearest rival. They contain the
differences between manoeuvres. Fault-free flights are right only with the verdict `agrees`. A cause with a
separability above 10 is right only where it is named, not in a tie.
"""


def _ranges(numbers: Sequence[int]) -> str:
    """Sorted numbers as text, runs as first to last."""
    runs: list[list[int]] = []
    for n in numbers:
        if runs and n == runs[-1][-1] + 1:
            runs[-1] = [runs[-1][0], n]
        else:
            runs.append([n])
    return ", ".join(" to ".join(map(str, run)) for run in runs)


def page(results: Sequence[Mapping[str, Any]], others: Sequence[Mapping[str, Any]] = ()) -> str:
    """The table of all draws in Markdown. others  draws of the same seeds at other false alarm rates"""
    seeds = [r["settings"]["seed"] for r in results]
    lost = [r for r in results if r["outcome"] == "lost"]
    results = [r for r in results if r["outcome"] != "lost"]
    absent = sorted(set(range(min(seeds), max(seeds) + 1)) - set(seeds))
    missing = f"not drawn yet: {_ranges(absent)}" if absent else "none left out"
    median = float(np.median([r["seconds"]["whole"] for r in results]))
    lines = [
        HEAD,
        f"{len(seeds)} draws, seeds {min(seeds)} to {max(seeds)}, {missing}; median {median:.0f} s per draw. The false "
        f"alarm rate is {SETTINGS['false alarm rate']:g}.", "",
        "| draws | right | of | share | 95 % interval | to reach | a wrong name |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]  # fmt: skip
    for group, (right, aim) in GROUPS.items():
        own = [r for r in results if group_of(r) == group]
        good = sum(r["outcome"] in right for r in own)
        bad = sum(bool(r["wrong"]) for r in own)
        low, high = wilson(good, len(own))
        share = f"{good / len(own):.2f} | {low:.2f} to {high:.2f}" if own else "- | -"
        lines.append(f"| {group} | {good} | {len(own)} | {share} | {aim or '-'} | {bad} |")
    lacks = [r for r in results if r["outcome"] == "model's own" and r["kind"] == "clean"]
    if lacks:
        names = ", ".join(sorted({n for r in lacks for n in r["model's own"]}))
        bare = sum(not r["model's own"] for r in lacks)
        of = "/".join(sorted({f"`{r['design']}`" for r in lacks}))
        reports = {
            f"what the made vehicle has in all flights and the model lacks ({names})": len(lacks) - bare,
            "where the model's error stays unexplained": bare,
        }
        counts = "; ".join(f"{words}: {count}" for words, count in reports.items() if count)
        lines += [
            "",
            f"Fault-free draws (of {of}) that name no change and do not count as right, by their report: {counts}.",
        ]
    errors = [e for r in results if r["outcome"] in ("hit", "extra") for e in r["errors"].values()]
    if errors:
        relative = np.median([abs(e["relative"]) for e in errors])
        inside = sum(abs(e["in std"]) < 2.0 for e in errors)
        low, high = wilson(inside, len(errors))
        lines += ["", f"Main parameter of {len(errors)} named causes: median error {100 * relative:.1f} %; the truth "
                  f"within two standard errors in {inside} ({low:.2f} to {high:.2f})."]  # fmt: skip
    lines += ["", "| flights | right | of | a wrong name |", "| --- | --- | --- | --- |"]
    for design, words in DESIGNS.items():
        own = [r for r in results if r["design"] == design]
        good, bad = sum(_right(r) for r in own), sum(bool(r["wrong"]) for r in own)
        lines.append(f"| `{design}`: {words} | {good} | {len(own)} | {bad} |")
    lines += _rates(results, others)
    lines += ["", "## What was hidden and what was reported", "", "| hidden | draws | right | named or tied as |",
              "| --- | --- | --- | --- |"]  # fmt: skip
    for name in [*ALL, "nothing"]:
        own = [r for r in results if r["kind"] != "pair" and (list(r["effects"]) or ["nothing"]) == [name]]
        if own:
            answers: dict[str, int] = {}
            for r in own:
                words = r["wrong"] + r["found"] + ["/".join(t) for t in r["tied"] if not set(t) & set(r["found"])]
                words += ["unexplained"] if r["outcome"] == "unexplained" else []
                words += ["a lack of the model"] if r["outcome"] == "model's own" else []
                for word in words or ["nothing"]:
                    answers[word] = answers.get(word, 0) + 1
            counts = ", ".join(f"{w} {n}" for w, n in sorted(answers.items(), key=lambda item: -item[1]))
            lines.append(f"| {name} | {len(own)} | {sum(_right(r) for r in own)} | {counts} |")
    lines += _smallest(results)
    if lost:
        lines += ["", "## Flights that could not be read", "",
                  "The vehicle was lost, or its log could not be tied to the capture; these are in no table above.", "",
                  "| seed | hidden | why |", "| --- | --- | --- |"]  # fmt: skip
        lines += [f"| {r['settings']['seed']} | {', '.join(r['effects']) or 'nothing'} | {r['why']} |" for r in lost]
    lines += ["", "## Every draw that was not right", "",
              "Of the error: share of the truth in the squared error of forces and moments, without what a model of "
              "the same flights absorbs. The axis with the largest share counts.", "",
              "| seed | design | hidden | times typical | detectability | separability | of the error | reported |",
              "| --- | --- | --- | --- | --- | --- | --- | --- |"]  # fmt: skip
    for r in results:
        if not _right(r):
            numbers = [[f"{s[k]:.1f}" if s[k] is not None else "-" for s in r["sizes"].values()]
                       for k in ("detectability", "separability")]  # fmt: skip
            of = [
                "-" if (share := s.get("of the error")) is None else f"{100 * share:.1f} %" for s in r["sizes"].values()
            ]
            factors = ", ".join(f"{f:.2f}" for f in r["factors"].values())
            named = ", ".join(r["wrong"] + r["found"] + ["/".join(t) for t in r["tied"]]) or "nothing"
            lines.append(
                f"| {r['settings']['seed']} | {r['design']} | {', '.join(r['effects']) or 'nothing'} | {factors} | "
                f"{', '.join(numbers[0])} | {', '.join(numbers[1])} | {', '.join(of)} | {named} |"
            )
    return "\n".join(lines) + "\n"


def _rates(results: Sequence[Mapping[str, Any]], others: Sequence[Mapping[str, Any]]) -> list[str]:
    """The same draws at other false alarm rates, in the groups that they are in anyway."""
    lines: list[str] = []
    before = {r["settings"]["seed"]: r for r in results}
    for rate in sorted({r["settings"]["rate"] for r in others}):
        after = {r["settings"]["seed"]: r for r in others if r["settings"]["rate"] == rate}
        both = [(before[s], after[s]) for s in sorted(before.keys() & after.keys()) if after[s]["outcome"] != "lost"]
        lines += ["", f"## At a false alarm rate of {rate:g}", "",
                  f"{len(both)} of these draws, searched once more.", "",
                  f"| draws | of | right | right at {rate:g} | a wrong name | a wrong name at {rate:g} |",
                  "| --- | --- | --- | --- | --- | --- |"]  # fmt: skip
        for group, (right, _) in GROUPS.items():
            own = [pair for pair in both if group_of(pair[0]) == group]
            good = [sum(pair[k]["outcome"] in right for pair in own) for k in (0, 1)]
            bad = [sum(bool(pair[k]["wrong"]) for pair in own) for k in (0, 1)]
            lines.append(f"| {group} | {len(own)} | {good[0]} | {good[1]} | {bad[0]} | {bad[1]} |")
    return lines


def _smallest(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """Sizes that would show with |t| = SEEN, against the length of the four flights."""
    heading = f"Times the typical size, for |t| = {SEEN:g} in three flights of this length (median over the draws)."
    lines = ["", "## Smallest sizes that show", "", heading, ""]
    found: dict[str, dict[float, list[float]]] = {}
    for r in results:
        for name, size in r["sizes"].items():
            lengths = {**size.get("of shorter flights", {}), "30": size["detectability"]}
            for seconds, shown in lengths.items():
                if shown and size.get("of shorter flights"):
                    found.setdefault(name, {}).setdefault(float(seconds), []).append(SEEN * r["factors"][name] / shown)
    lengths = sorted({t for by in found.values() for t in by})
    lines += ["| cause | " + " | ".join(f"{t:g} s" for t in lengths) + " |", "| --- |" + " --- |" * len(lengths)]
    for name in [n for n in ALL if n in found]:
        cells = [f"{np.median(found[name][t]):.2f}" if t in found[name] else "-" for t in lengths]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines if found else []


def main() -> None:
    """Draw, or make the table of what was drawn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=30000)
    parser.add_argument("--draws", type=int, default=300)
    parser.add_argument("--world", choices=("drawn", "mild"), default="drawn")
    parser.add_argument("--rate", type=float, help="another false alarm rate")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--table", action="store_true", help="the table alone, of the draws that are there")
    arguments = parser.parse_args()
    folder = arguments.out / "draws"
    seeds = range(arguments.first, arguments.first + arguments.draws)
    if not arguments.table:
        other = {"rate": arguments.rate} if arguments.rate else {}
        number = {s: s % WORLDS if arguments.world == "drawn" else 0 for s in seeds}
        run(
            [{"seed": s, "world": number[s], **other} for s in seeds],
            lambda s: draw(s, folder=arguments.out),
            folder,
            Path(__file__),
        )
    read = [
        r for r in map(read_json, sorted(folder.glob("*.json"))) if arguments.table or r["settings"]["seed"] in seeds
    ]
    results = [{**r, **judge(r)} if r["outcome"] != "lost" else r for r in read]
    plain = [r for r in results if "rate" not in r["settings"]]
    if not plain:
        raise SystemExit(
            f"nothing in {folder} was sought at {SETTINGS['false alarm rate']:g}: run without --rate as well"
        )
    text = page(plain, [r for r in results if "rate" in r["settings"]])
    write_text(ROOT / "docs/hide-and-seek.md", text)
    print(text)


if __name__ == "__main__":
    main()
