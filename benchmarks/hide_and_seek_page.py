"""The page of the hide and seek study: tables of its draws in Markdown, and the groups that draws belong to."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from hidden import ALL, world
from probability import bin_table, brier, stated

CLEAR, VISIBLE = 10.0, 3.0  # |t| above which a cause has to be named, and below which none is expected to be
SURE = 0.9  # probability from which a name has to be right nine times of ten
SEEN = 5.0  # |t| at which a cause is usually named


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

The model is identified from sixteen healthy flights of 30 s, in all worlds but the mild one from twelve. The designs
differ in the flights that are compared:

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


def page(results: Sequence[Mapping[str, Any]], others: Sequence[Mapping[str, Any]] = (), rate: float = 0.01) -> str:
    """The table of all draws at one false alarm rate. others  draws of the same seeds at other rates"""
    seeds = [r["settings"]["seed"] for r in results]
    lost = [r for r in results if r["outcome"] == "lost"]
    results = [r for r in results if r["outcome"] != "lost"]
    absent = sorted(set(range(min(seeds), max(seeds) + 1)) - set(seeds))
    missing = f"not drawn yet: {_ranges(absent)}" if absent else "none left out"
    median = float(np.median([r["seconds"]["whole"] for r in results]))
    lines = [
        HEAD,
        f"{len(seeds)} draws, seeds {min(seeds)} to {max(seeds)}, {missing}; median {median:.0f} s per draw. The false "
        f"alarm rate is {rate:g}.", "",
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
    bad = sum(bool(r["wrong"]) for r in results)
    low, high = wilson(bad, len(results))
    lines += ["", f"A wrong name in {bad} of {len(results)} data sets ({low:.2f} to {high:.2f}; to reach: 0.03).",
              *_calibration(results)]  # fmt: skip
    lines += ["", "| flights | right | of | a wrong name |", "| --- | --- | --- | --- |"]
    for design, words in DESIGNS.items():
        own = [r for r in results if r["design"] == design]
        good, bad = sum(_right(r) for r in own), sum(bool(r["wrong"]) for r in own)
        lines.append(f"| `{design}`: {words} | {good} | {len(own)} | {bad} |")
    lines += _worlds(results)
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
              "| seed | world | design | hidden | times typical | detectability | separability | of the error | "
              "reported |",
              "| --- |" + " --- |" * 8]  # fmt: skip
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
                f"| {r['settings']['seed']} | {r.get('world', 0)} | {r['design']} | "
                f"{', '.join(r['effects']) or 'nothing'} | {factors} | "
                f"{', '.join(numbers[0])} | {', '.join(numbers[1])} | {', '.join(of)} | {named} |"
            )
    return "\n".join(lines) + "\n"


def _calibration(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """How often names, ties and candidates are right that are stated with a probability, and its Brier score."""
    lines: list[str] = []
    entries = [e for r in results for e in stated(r)]
    for kind, words in {"effects": "names", "ties": "ties", "candidates": "candidates"}.items():
        own = [e for e in entries if e.kind == kind]
        if not own:
            continue
        chance, right = [e.probability for e in own], [e.right for e in own]
        sure = [r for p, r in zip(chance, right) if p >= SURE]
        score = f"Brier score of the stated probabilities of {len(own)} {words}: {brier(chance, right):.3f}."
        if sure:
            known = f"{len(sure)} {words} stated with a probability of {SURE} or more, {sum(sure)} are right"
            score = f"Of {known}. {score}"
        lines += ["", score, "", *bin_table(chance, right)]
    fitted = "The [calibration](probability.md) was fitted with seeds 36000 to 36299: of these it is no prediction."
    return [*lines, "", fitted] if lines else []


def _worlds(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """Conditions of each world and how its draws came out; nothing where all draws are of the mild one."""
    numbers = sorted({r.get("world", 0) for r in results})
    if numbers == [0]:
        return []
    lines = ["", "## Worlds", "",
             "White noise per sample at 2 kHz; undeclared delay of gyro and accelerometer; lost packets of the rotor "
             "telemetry. World 0 is mild and has no sessions. In the others reference flights are of two sessions and "
             "compared flights of a third.", "",
             "| world | log rate, Hz | noise, m/s2 | deg/s | modes, Hz | firmware, filters of the gyro | delay, ms | "
             "lost, % | heading | thrust exponent | right | of | a wrong name |",
             "| --- |" + " --- |" * 12]  # fmt: skip
    for number in numbers:
        own = [r for r in results if r.get("world", 0) == number]
        c = world(number).config
        cells = ["1000", "0.06", "0.25", "-", "4.5.1, PT1 250, PT1 500", "0, 0", "0", "free", "2"]
        if c:
            modes = ", ".join(f"{m['frequency']:.0f}" for m in c["structural modes"].values())
            stages = ", ".join(f"{s['type']} {s['cutoff']:.0f}" for s in c["filters"]["gyro"])
            late = ", ".join(f"{1000 * x:.1f}" for x in c["sensor delay"].values())
            cells = [f"{c['log rate']}", f"{c['accelerometer noise']:.2f}", f"{c['gyro noise']:.2f}", modes,
                     f"{c['filters']['firmware']}, {stages}", late, f"{100 * c['telemetry']['lost']:.0f}",
                     "fixed" if c["fixed heading"] else "free",
                     f"{c['airframe']['thrust exponent']:.2f}"]  # fmt: skip
        good, bad = sum(_right(r) for r in own), sum(bool(r["wrong"]) for r in own)
        lines.append("| " + " | ".join([str(number), *cells, str(good), str(len(own)), str(bad)]) + " |")
    return lines


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
