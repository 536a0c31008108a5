"""Hide and seek: causes drawn from a seed are hidden in raw logs; are they named, and nothing else?

    python benchmarks/hide_and_seek.py [--first 30000] [--draws 300] [--world drawn] [--rate 0.05] [--table]
                                       [--commands-only] [--out results/benchmarks/hide_and_seek]

The study has the seeds from 30000. Its draws belong to WORLDS worlds by turns: `--world drawn` takes the seed modulo
their number. World 0 is mild; `--world mild` takes it for every seed, as the study of seeds 10300 to 10699 did.

Each draw makes four flights of 30 s, imports and filters the raw logs, settles sensors and drive, processes the flights
anew with what these found, diagnoses them (one is held out) as the workflow does, and compares the diagnosis with the
truth, which nothing else reads. One JSON per draw; a study that was stopped goes on where it was. --table makes
docs/hide-and-seek.md of the files that are there, without drawing. --rate seeks in the same flights at another false
alarm rate; such draws are in a table of their own.

--commands-only withholds the rotor speeds from every log: the model's map makes them of commands and battery voltage.
Such draws are counted on the terminal and stand in no page. What cannot show without measured speeds is not hidden
there (`TELEMETRY_CAUSES`).

The model was identified from sixteen other healthy flights. Half and more of the draws have four healthy reference
flights in addition to the affected ones ("reference"); in others every flight is affected, and four of those that made
the model stand for reference flights ("all"), or the model was identified from the affected flights themselves ("own").
`clarity` measures how clearly a hidden cause shows.
"""

import argparse
import os
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from clarity import Asked, clarity
from hidden import (
    INHERENT,
    OWN,
    SHOWS,
    STRANGE,
    TELEMETRY_CAUSES,
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
    with_speeds,
    world,
)
from hide_and_seek_page import CLEAR, page
from study import run

from quasi.errors import DataError
from quasi.gap.catalogue import catalogue
from quasi.gap.diagnosis import diagnose
from quasi.gap.effect import room_of, vehicle_of
from quasi.gap.flights.gathering import gather
from quasi.gap.flights.level import Flown
from quasi.gap.levels import sensors_and_drive
from quasi.gap.levels.corrections import for_flight
from quasi.model.model import Model
from quasi.tables import read_json, write_text
from quasi_synthesis.vehicle import base_vehicle

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "results/benchmarks/hide_and_seek"
SAMPLING = 100.0  # Hz, of the comparison of forces and moments
_ROOM = base_vehicle().physics.room
SETTINGS = {
    "model": "healthy", "extended model ID": "healthy-extended", "horizons": [0.1, 0.5], "false alarm rate": 0.01,
    "material share": 0.05,
    "room": {"north": [-_ROOM[0], _ROOM[0]], "east": [-_ROOM[1], _ROOM[1]], "height": _ROOM[2]},
}  # fmt: skip
INDISTINCT = {"thrust_factor", "rotor_speed_scale"}  # the torque alone tells them apart: always a tie

# without measured speeds: more thrust at the same command, or rotors that follow late
INDISTINCT_BY_COMMANDS = {"thrust_factor", "thrust_curve", "thrust_drift", "battery_sag", "motor_lag", "command_delay",
                          "inflow_lag"}  # fmt: skip


def draw(settings: dict[str, Any], seconds: float = 30.0, folder: Path = OUT) -> dict[str, Any]:
    """Hide, seek, and compare.

    settings  {"seed"} of `drawn`; "world": number of its world (0, the mild one); "hide": what `drawn` would return;
    "rate": another false alarm rate; "restless": see `hidden.affected`; "telemetry":
              False withholds the rotor speeds
    """
    seed, telemetry = settings["seed"], settings.get("telemetry", True)
    hidden = settings.get("hide") or drawn(seed, () if telemetry else TELEMETRY_CAUSES)
    of = world(settings.get("world", 0), telemetry)
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
            model = healthy_model(folder / "healthy", of.number, telemetry)
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
    return {**result, **judge({**result, "settings": settings})}


def seek(
    learned: Sequence[tuple[Recorded, Flown]], held: tuple[Recorded, Flown], model: Model, given: str,
    settings: Mapping[str, Any] = SETTINGS,
) -> tuple[dict[str, Any], Asked]:  # fmt: skip
    """The diagnosis of flights, without any knowledge of what is hidden, and what it was made of."""
    effects = catalogue()
    recorded, flown = [list(part) for part in zip(*learned)]
    flown, last = [with_speeds(f, model) for f in flown], with_speeds(held[1], model)
    raw = {f.key: r for r, f in learned}

    def process(flight: Flown, calibration: Mapping[str, Any] | None) -> Flown:
        return with_speeds(again([raw[flight.key]], [flight], [calibration])[0], model)

    told, levels = sensors_and_drive.examine(flown, model.document, settings, effects, process, 1)
    calibrations = [for_flight(told, f.compared) for f in [*flown, last]]
    everything = [with_speeds(f, model) for f in again([*recorded, held[0]], [*flown, last], calibrations)]
    roles = {f.key: "compared" if f.compared else "reference" for f in everything}
    roles[last.key] = "held out"
    evidence = {f.key: gather(f.key, f.filtered, f.filtered_metadata, f.airframe, model, SAMPLING) for f in everything}
    found = diagnose(
        model, told, evidence, {f.key: f.filtered for f in everything}, roles, effects, settings,
        ([last], [everything[-1]]), "hidden", (), given,
    )  # fmt: skip
    vehicle = vehicle_of(model, room=room_of(SETTINGS["room"]))
    compared = np.array([f.compared for f in flown])
    return found.document, Asked(found.found and found.found.study, vehicle, compared, effects, levels, given == "none")


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
    apart -= INDISTINCT if result.get("settings", {}).get("telemetry", True) else INDISTINCT_BY_COMMANDS
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
    if said["level"] == "forces" and said["id"] == "inflow_lag":
        true = beyond[main]  # told beyond what the model has
    error = value - true
    return {"relative": error / abs(beyond[main]), "in std": error / max(std, 1e-300)}


def print_draws(results: Sequence[Mapping[str, Any]]) -> None:
    """Print each draw's truth and names, and the counts of outcomes."""
    for r in results:
        ties = "; ".join(" or ".join(ids) for ids in r.get("tied", ()))
        truth = ", ".join(f"{n} {r['factors'][n]:.1f}" for n in r["effects"]) or "-"
        named = ", ".join(f"{e['id']} ({e['level']}, {e['since']})" for e in r.get("effects said", ()))
        print(f"{r['settings']['seed']} {r['design']:9s} {r['outcome']:14s} {truth} | {named or '-'} | {ties or '-'}")
    print(dict(Counter(r["outcome"] for r in results)), f"wrong names: {sum(len(r.get('wrong', ())) for r in results)}")


def main() -> None:
    """Draw, or make the table of what was drawn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=30000)
    parser.add_argument("--draws", type=int, default=300)
    parser.add_argument("--world", choices=("drawn", "mild"), default="drawn")
    parser.add_argument("--rate", type=float, help="another false alarm rate")
    parser.add_argument("--commands-only", action="store_true", help="withhold the rotor speeds")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--table", action="store_true", help="the table alone, of the draws that are there")
    arguments = parser.parse_args()
    folder = arguments.out / "draws"
    seeds = range(arguments.first, arguments.first + arguments.draws)
    if not arguments.table:
        other = {"rate": arguments.rate} if arguments.rate else {}
        other |= {"telemetry": False} if arguments.commands_only else {}
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
    if arguments.commands_only:
        print_draws([r for r in results if not r["settings"].get("telemetry", True)])
        return
    results = [r for r in results if r["settings"].get("telemetry", True)]
    plain = [r for r in results if "rate" not in r["settings"]]
    if not plain:
        raise SystemExit(
            f"nothing in {folder} was sought at {SETTINGS['false alarm rate']:g}: run without --rate as well"
        )
    text = page(plain, [r for r in results if "rate" in r["settings"]], SETTINGS["false alarm rate"])
    write_text(ROOT / "docs/hide-and-seek.md", text)
    print(text)


if __name__ == "__main__":
    main()
