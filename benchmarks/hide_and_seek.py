"""Hide and seek: causes drawn from a seed are hidden in raw logs; are they named, and nothing else?

    python benchmarks/hide_and_seek.py [--first 1000] [--draws 200] [--out results/benchmarks/hide_and_seek] [--table]

Each draw makes four flights of 30 s, imports and filters the raw logs, settles levels K and A, processes the flights
anew with what these found, asks level W on three of them (one is held out), and compares the names with the truth,
which nothing else reads. One JSON per draw; a study that was stopped goes on where it was. --table makes
docs/hide-and-seek.md of the files that are there, without drawing.

Detectability is the |t| that the true size has, given the noise of the flights, after the model's own terms and what
flights differ by were projected out; separability the same with the nearest other cause of its level projected out as
well.
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
from hidden import (
    ALL,
    DRIVE,
    SENSORS,
    SHOWS,
    STRANGE,
    Recorded,
    affected,
    again,
    deviation,
    drawn,
    healthy_model,
    processed,
    references,
)
from study import run

from quasi.gap import actuation, kinematic, lower, unexplained, wrench
from quasi.gap.calibration import for_flight
from quasi.gap.catalogue import catalogue
from quasi.gap.effect import Effect, room_of, vehicle_of
from quasi.gap.evidence import Evidence, gather
from quasi.gap.gain import after
from quasi.gap.level import Flown, Level, clear
from quasi.gap.mixed import Offer
from quasi.standalone.model import Model
from quasi.synthesis.physics import BEAT, FAN, FAN_WIDTH
from quasi.synthesis.vehicle import base_vehicle
from quasi.tables import read_json, write_text

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "results/benchmarks/hide_and_seek"
RATE, SHARE, SAMPLING = 0.01, 0.05, 100.0  # family-wise false alarms, materiality, Hz
SURE = 0.8  # share of resamples in which a named cause must stand
_P = base_vehicle().physics
_ROOM = _P.room
HEALTHY = {"up": _P.lag_up, "down": _P.lag_down, "exponent": 1.0}  # the made vehicle's drive
ROOM = {"north": [-_ROOM[0], _ROOM[0]], "east": [-_ROOM[1], _ROOM[1]], "height": _ROOM[2]}
CLEAR, VISIBLE = 10.0, 3.0
# what the made vehicle has anyway and a fitted model may lack: named without healthy flights, it is no wrong name
INHERENT = {"rotor_drag", "body_drag", "blade_flapping", "axial_inflow", "vortex_ring", "rotor_interference",
            "inflow_lag", "rotor_gyroscopic", "rotor_acceleration_torque", "translational_lift"}  # fmt: skip


def draw(settings: dict[str, Any], seconds: float = 30.0, folder: Path = OUT) -> dict[str, Any]:
    """Hide, seek, and compare. settings  {"seed"} of `drawn`, or with "hide": what `drawn` would return."""
    seed = settings["seed"]
    hidden = settings.get("hide") or drawn(seed)
    begin = time.perf_counter()
    model = healthy_model(folder / "healthy")
    with tempfile.TemporaryDirectory() as raw:
        recorded = affected(Path(raw), seed, hidden["effects"], seconds)
        flown = [processed(r, True) for r in recorded]
        given = references(folder / "healthy", seed) if hidden["design"] == "reference" else []
        made = time.perf_counter() - begin
        # the first flight has manoeuvres of every kind: what is material shows there
        found = seek([*given, *zip(recorded[1:], flown[1:])], (recorded[0], flown[0]), model)
    study = found.pop("study")
    sizes = {n: _size(n, hidden["effects"][n], study, hidden) for n in hidden["effects"]}
    result = {**hidden, **found, "sizes": sizes, "seconds": {"made": made, "whole": time.perf_counter() - begin}}
    return {**result, **judge(result)}


def seek(learned: Sequence[tuple[Recorded, Flown]], held: tuple[Recorded, Flown], model: Model) -> dict[str, Any]:
    """What the levels say of the flights, without any knowledge of what is hidden."""
    effects = catalogue()
    recorded, flown = [list(part) for part in zip(*learned)]
    raw = {f.key: r for r, f in learned}
    told, levels = lower.examine(
        flown, model.document, {"false alarm rate": RATE}, effects, lambda f, c: again([raw[f.key]], [f], [c])[0]
    )
    anew = [for_flight(told, f.compared) for f in [*flown, held[1]]]
    everything = again([*recorded, held[0]], [*flown, held[1]], anew)
    lower.material_ones(levels, [held[1]], everything[-1:], SHARE)
    evidence = [_evidence(f, model) for f in everything]
    frame = everything[0].airframe
    vehicle = vehicle_of(model, evidence[0].mass, np.asarray(frame.inertia), room_of(ROOM))
    compared = [f.compared for f in flown]
    asked = wrench.examine(
        evidence[:-1], compared, evidence[-1:], model, effects, vehicle, RATE / 3.0, SHARE, "X", "hide and seek"
    )
    accepted = [(c.effect, c.test.offer, c.value) for c in [*asked.causes, *asked.immaterial]]
    accepted += [(effects[t.tests[0].offer.cause], t.tests[0].offer, {}) for _, t in asked.ties]
    left, _ = unexplained.search(
        evidence[:-1], compared, evidence[-1:], accepted, after(Model(asked.extended), model),
        asked.scores["noise_floor"], vehicle, RATE / 3.0, SHARE,
    )  # fmt: skip
    names, ties = [], []
    for level in levels:
        for e in level.effects:
            values = {k: (v["value"], v["std"]) for k, v in e["parameters"].items()}
            names.append({"id": e["id"], "level": level.level, "since": e["since"], "p": e["evidence"]["p"],
                          "probability": e["probability"], "parameters": values})  # fmt: skip
        ties += [{"ids": t["ids"], "level": level.level, "since": t["since"]} for t in level.ties]
    for cause in asked.causes:
        values = {k: (v, cause.std[k]) for k, v in cause.value.items()}
        names.append({"id": cause.effect.id, "level": "W", "since": cause.since, "p": cause.test.p,
                      "probability": cause.probability, "parameters": values})  # fmt: skip
    ties += [{"ids": [t.offer.cause for t in tie.tests], "level": "W", "since": s} for s, tie in asked.ties]
    return {
        "names": names,
        "ties": ties,
        "unexplained": left,
        "findings": [f["id"] for level in levels for f in level.findings],
        "immaterial": [c.effect.id for c in asked.immaterial],
        "ranking": [{"id": t.offer.cause, "since": t.offer.since, "p": t.p} for t in asked.ranking[:6]],
        "processed anew": any(c is not None for c in anew),
        "study": (asked.study, np.array(compared), effects, levels),
    }


def _evidence(flown: Flown, model: Model) -> Evidence:
    return gather(flown.key, flown.filtered, flown.filtered_metadata, flown.airframe, model, SAMPLING)


def _size(name: str, values: Mapping[str, float], study: tuple, hidden: Mapping[str, Any]) -> dict[str, Any]:
    """Detectability and separability of a planted cause; None where no column of the catalogue has its form."""
    examined, compared, effects, levels = study
    since = "changed" if hidden["design"] == "reference" else "always"
    true = deviation(name, values)
    if name in SENSORS or name in DRIVE:
        return _lower_size(name, values, levels, since)
    if name in STRANGE:
        return {"detectability": _strange(name, values, study), "separability": None, "nearest": None}
    effect: Effect | None = effects.get(name)
    if effect is None or name not in examined.columns.causes or (effect.absorbed and since == "always"):
        return {"detectability": 0.0, "separability": 0.0, "nearest": None}
    mixed = examined.mixed(range(len(compared)), compared)
    pooled = [c for c in examined.columns.causes if not effects[c].absorbed] if since == "changed" else []
    which = tuple(effect.fitted.index(k) for k in true if k in effect.fitted)
    theta = np.array([true[effect.fitted[k]] for k in which])

    def shown(given: Sequence[Offer]) -> float:
        test = mixed.test(Offer(name, since, which), given, pooled)
        return float(np.sqrt(max(theta @ np.linalg.solve(test.covariance, theta), 0.0)))

    beside = {}
    for other, columns in examined.columns.causes.items():
        if other != name and not (effects[other].absorbed and since == "always"):
            beside[other] = shown([Offer(other, since, tuple(range(len(columns))))])
    nearest = min(beside, key=beside.get)
    return {"detectability": shown([]), "separability": beside[nearest], "nearest": nearest}


def _lower_size(name: str, values: Mapping[str, float], levels: Sequence[Level], since: str) -> dict[str, Any]:
    """Of a cause of level K or A, by the tests of that level."""
    level = next(x for x in levels if x.level == ("K" if name in SENSORS else "A"))
    if level.tests is None or name not in level.tests.columns.causes:
        return {"detectability": 0.0, "separability": 0.0, "nearest": None}
    size = kinematic.size_of(name, values) if name in SENSORS else actuation.size_of(name, values, HEALTHY)
    shown = clear(level.tests, name, since, size)
    return {"detectability": shown.detectability, "separability": shown.separability, "nearest": shown.nearest}


def _strange(name: str, values: Mapping[str, float], study: tuple) -> float:
    """Of an effect without a name: its true force over the noise of the channel, memory counted."""
    examined, compared, *_ = study
    total = 0.0
    for flight, flag in zip(examined.flights, compared):
        if not flag:
            continue
        force, channel = _strange_force(name, values["size"], flight)
        noise = np.std(flight.residual[:, channel])
        # gusts are remembered for about a second
        total += np.var(force) / noise**2 * (flight.t[-1] - flight.t[0]) / 2.0
    return float(np.sqrt(total))


def _strange_force(name: str, size: float, flight: Evidence) -> tuple[np.ndarray, int]:
    """Force of an effect without a name and its channel, as `quasi.synthesis.physics` has it."""
    c = flight.columns
    if name == "unlisted_heading":
        return size * np.sin(2.0 * c["yaw"]) * flight.force[:, 2], 2
    if name == "unlisted_height":
        return -size * c["z"], 1
    if name == "unlisted_beat":
        return size * np.sin(2.0 * np.pi * BEAT * c["t"]), 0
    return -size * np.exp(-((c["x"] - FAN[0]) ** 2 + (c["y"] - FAN[1]) ** 2) / FAN_WIDTH**2), 2


def judge(result: Mapping[str, Any]) -> dict[str, Any]:
    """Compare what was said with the truth: {"outcome", "wrong", "model's own", "tied", "found", "errors"}.

    outcome  "hit": every hidden cause is named or in a tie of at most three, nothing else is; "extra": named, and
    something else beside it; "partly": some are; "wrong": something else only; "tied elsewhere": a tie without it;
    "missed": nothing; "agrees": nothing, rightly; "false": of clean flights, something; "model's own": of clean
    flights, what the vehicle has and the model lacks
    With healthy flights given only changes count: what all flights have in common is missing in the model, not hidden.
    """
    since = "changed" if result["design"] == "reference" else "always"
    truth = set(result["effects"]) - set(STRANGE)
    said = [n for n in result["names"] if n["since"] == since and n["probability"] >= SURE]
    ties = [t for t in result["ties"] if t["since"] == since]
    named = [n["id"] for n in said]
    found = {c for c in truth if c in named or any(c in t["ids"] and len(t["ids"]) <= 3 for t in ties)}
    own = [n for n in named if n not in truth and since == "always" and n in INHERENT]
    wrong = [n for n in named if n not in truth and n not in own]
    strange_ties = [t["ids"] for t in ties if not truth & set(t["ids"])]
    if not truth:
        outcome = "false" if wrong or strange_ties else "model's own" if own else "agrees"
    elif found == truth:
        outcome = "extra" if wrong or strange_ties else "hit"
    elif wrong:
        outcome = "wrong"
    else:
        outcome = "partly" if found else "tied elsewhere" if strange_ties else "missed"
    errors = {}
    for n in said:
        if n["id"] in truth:
            planted = result["effects"][n["id"]]
            beyond = deviation(n["id"], planted)
            main = max((k for k in beyond if k in n["parameters"]), key=lambda k: abs(beyond[k]), default=None)
            if main is not None and beyond[main]:
                value, std = n["parameters"][main]
                error = value - (beyond[main] if n["level"] == "W" else planted[main])
                errors[n["id"]] = {"relative": error / abs(beyond[main]), "in std": error / std}
    tied = [t["ids"] for t in ties]
    if result["kind"] == "unlisted" and outcome in ("agrees", "model's own"):
        shown = {u["channel"] for u in result["unexplained"]}
        outcome = "unexplained" if SHOWS[next(iter(result["effects"]))] in shown else "missed"
    return {
        "outcome": outcome,
        "wrong": wrong,
        "model's own": own,
        "tied": tied,
        "found": sorted(found),
        "errors": errors,
    }


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


def wilson(k: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """Interval of a share. Source: Wilson, JASA 22, 1927."""
    if n == 0:
        return 0.0, 1.0
    p, d = k / n, 1.0 + z * z / n
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return float((middle - half) / d), float((middle + half) / d)


def page(results: Sequence[Mapping[str, Any]]) -> str:
    """The table of all draws in Markdown."""
    seeds = [r["settings"]["seed"] for r in results]
    absent = sorted(set(range(min(seeds), max(seeds) + 1)) - set(seeds))
    missing = f"not drawn yet: {', '.join(map(str, absent))}" if absent else "none left out"
    median = float(np.median([r["seconds"]["whole"] for r in results]))
    lines = [
        "# Hide and seek", "",
        "Causes drawn from a seed are hidden in made flights; raw logs are imported and filtered, all levels asked,",
        "and only then are the names compared with the truth. Made by `python benchmarks/hide_and_seek.py --table`.",
        "",
        f"{len(results)} draws, seeds {min(seeds)} to {max(seeds)}, {missing}; median {median:.0f} s per draw.", "",
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
    errors = [e for r in results if r["outcome"] in ("hit", "extra") for e in r["errors"].values()]
    if errors:
        relative = np.median([abs(e["relative"]) for e in errors])
        inside = sum(abs(e["in std"]) < 2.0 for e in errors)
        low, high = wilson(inside, len(errors))
        lines += ["", f"Main parameter of {len(errors)} named causes: median error {100 * relative:.1f} %; the truth "
                  f"within two standard errors in {inside} ({low:.2f} to {high:.2f})."]  # fmt: skip
    lines += ["", "## What was hidden and what was said", "", "| hidden | draws | hit | named or tied as |",
              "| --- | --- | --- | --- |"]  # fmt: skip
    for name in [*ALL, "nothing"]:
        own = [r for r in results if r["kind"] != "pair" and (list(r["effects"]) or ["nothing"]) == [name]]
        if own:
            said: dict[str, int] = {}
            for r in own:
                words = r["wrong"] + r["found"] + ["/".join(t) for t in r["tied"] if not set(t) & set(r["found"])]
                for word in words or ["nothing"]:
                    said[word] = said.get(word, 0) + 1
            told = ", ".join(f"{w} {n}" for w, n in sorted(said.items(), key=lambda item: -item[1]))
            lines.append(f"| {name} | {len(own)} | {sum(r['outcome'] == 'hit' for r in own)} | {told} |")
    lines += ["", "## Every draw that was not right", "",
              "| seed | design | hidden | times typical | detectability | separability | said |",
              "| --- | --- | --- | --- | --- | --- | --- |"]  # fmt: skip
    for r in results:
        if r["outcome"] not in GROUPS[group_of(r)][0]:
            numbers = [[f"{s[k]:.1f}" if s[k] is not None else "-" for s in r["sizes"].values()]
                       for k in ("detectability", "separability")]  # fmt: skip
            factors = ", ".join(f"{f:.2f}" for f in r["factors"].values())
            said = ", ".join(r["wrong"] + r["found"] + ["/".join(t) for t in r["tied"]]) or "nothing"
            lines.append(
                f"| {r['settings']['seed']} | {r['design']} | {', '.join(r['effects']) or 'nothing'} | {factors} | "
                f"{', '.join(numbers[0])} | {', '.join(numbers[1])} | {said} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Draw, or make the table of what was drawn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--table", action="store_true", help="the table alone, of the draws that are there")
    arguments = parser.parse_args()
    folder = arguments.out / "draws"
    if arguments.table:
        results = [{**r, **judge(r)} for r in (read_json(p) for p in sorted(folder.glob("*.json")))]
    else:
        many = [{"seed": arguments.first + k} for k in range(arguments.draws)]
        results = run(many, lambda s: draw(s, folder=arguments.out), folder, Path(__file__))
    text = page(results)
    write_text(ROOT / "docs/hide-and-seek.md", text)
    print(text)


if __name__ == "__main__":
    main()
