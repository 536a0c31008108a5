"""The page of a diagnosis: one sentence first, then what is wrong, why, the rivals, and what the extension gains.

One HTML file that needs nothing else and no network. Plain data and tables in, text out.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from quasi.gap.effect import Effect
from quasi.gap.entries import ALONE, STRONGEST, WEAKER
from quasi.gap.levels.corrections import corrected_at_import
from quasi.gap.levels.rollouts.open_loop import ERROR_UNITS
from quasi.gap.levels.sensors_and_drive import CHANNEL_UNITS as UNITS_OF
from quasi.gap.report.captions import CAPTIONS
from quasi.gap.report.localised import table_of
from quasi.gap.report.names import alternatives, listed, name_of
from quasi.gap.report.next_steps import in_model, steps
from quasi.gap.report.shares import certainty_of, reaches_floor, share_of
from quasi.gap.report.wording import (
    CHANNEL_NAMES,
    confirmation_of,
    happening,
    left_sentence,
    rollout_of,
    since_of,
    summed_up,
    tie_sentence,
    value_of,
    words_of,
)
from quasi.model.model import AXES
from quasi.pages import frame as report
from quasi.pages.chart import Chart, Panel, Trace, render_style

THIN = 2  # every so many rows of the comparison are shown
LINE_TITLES = {
    "rollouts": "measured rotor speeds",
    "rollouts with trim": "measured rotor speeds, trim of the 2 s before each window taken up",
    "rollouts from commands": "commands",
}
MOST_CANDIDATES = 15  # of the causes that are not named
SHOWN_AT = 0.5  # s: rows of the horizon nearest to it, and of the longest, stand on the page; the others open on demand
FLOORS = 3.0  # times its floor that a channel of sensors or drive may keep unmentioned
ROOM_ACCELERATIONS = ("north", "east", "down")  # accelerations along the room's axes
TAKEN_OFF = (
    "Before and after are errors as they stand; they hold what every flight has of its own as well (how markers and "
    "IMU sat, what biases they had), which may hide a gain, or undo it. Removed is computed without these, before "
    "and after alike: the share of the squared error above the floor that the cause removes."
)
LEVEL_TITLES = {"sensors": "sensors against capture", "drive": "rotor speeds against commands"}


def page(
    diagnosis: Mapping[str, Any],
    effects: Mapping[str, Effect],
    residuals: pd.DataFrame | None,
    pictures: Mapping[str, bytes],
    where: Mapping[str, pd.DataFrame] | None = None,
) -> str:
    """The page as HTML.

    diagnosis  "quasi.gap/3"; effects  the catalogue; residuals  the table forces_residuals; pictures {name: PNG}
    where      {level: its table of places}: sensors_where to rollouts_where
    """
    roles = diagnosis["flights"]
    keys = {r: [k for k, role in roles.items() if role == r] for r in ("compared", "held out", "reference")}
    under = f"model {diagnosis['model']} · " + " · ".join(f"{r} {', '.join(k) or 'none'}" for r, k in keys.items())
    shown = {n: report.render_picture(pictures[n], caption) for n, caption in CAPTIONS.items() if n in pictures}
    sections = [
        render_style(),
        shown.get("glance") or shown.get("trim", ""),
        report.render_section("What to do next", report.render_list(steps(diagnosis, effects))),
        report.render_section("What is wrong", _forces(diagnosis), _lower(diagnosis)),
        report.render_section("Why", *(_cause(e, effects) for e in diagnosis["effects"]), _rivals(diagnosis, effects)),
        report.render_section("What cannot be distinguished", _ties(diagnosis)),
        report.render_section(
            "What no cause explains",
            report.render_list(left_sentence(u) for u in diagnosis["unexplained"]),
            shown.get("unexplained", ""),
        ),
        report.render_section(
            "Trim in steady flight",
            report.render_list([diagnosis.get("hover trim", {}).get("text", "")]),
            shown.get("trim", "") if "glance" in shown else "",
        ),
        report.render_section("The extended model", _extended(diagnosis)),
        report.render_section(
            "Simulated and flown",
            shown.get("overlays", ""),
            _rollouts(diagnosis),
            _halves(diagnosis),
            shown.get("horizons", ""),
        ),
        report.render_section("Forces and moments over time", _chart(residuals)),
        report.render_section(
            "Where the errors live", table_of(where or {}, SHOWN_AT), shown.get("where", ""), shown.get("spectra", "")
        ),
        report.render_section(
            "Other findings", report.render_list(words_of(f["text"], effects) for f in diagnosis["findings"])
        ),
        report.render_section("What could not be asked", _unasked(diagnosis, effects)),
        report.render_section(
            "Notes",
            report.render_list(words_of(n, effects) for n in dict.fromkeys([*diagnosis["notes"], _rules(diagnosis)])),
        ),
    ]
    first, *rest = summed_up(diagnosis, effects)
    # what of several would be a wall of words is a list
    if sum(len(diagnosis[part]) for part in ("effects", "ties", "unexplained")) > 1:
        sections.insert(2, report.render_list(rest))
        rest = []
    sections.insert(1, _answers(diagnosis, effects))
    box = (first.rstrip("."), sections, " ".join(rest))
    return report.render_page(f"Gap {diagnosis['name']}", under, diagnosis["verdict"], *box)


def _answers(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> str:
    """What a pilot asks first: what is wrong, since when, how sure, and what to do."""
    rows = [
        [f"{name_of(effect['id'])}: {happening(effect, known)}", since_of(effect), certainty_of(effect)]
        for effect in diagnosis["effects"]
    ]
    rows += [
        [alternatives(tie["ids"]), since_of(tie), "it is one of them; these flights do not separate them"]
        for tie in diagnosis["ties"]
    ]
    left = {CHANNEL_NAMES.get(u["channel"], u["channel"]): since_of(u) for u in diagnosis["unexplained"]}
    rows += [
        [f"{channel}: unexplained", since, "no cause that was asked explains it"] for channel, since in left.items()
    ]
    if not rows:
        return ""
    first = next(iter(steps(diagnosis, known)), "")
    answers = report.render_table(["what is wrong", "since when", "how sure"], rows, words=(1, 2))
    return answers + (report.render_facts([("what to do", first)]) if first else "")


def _rules(diagnosis: Mapping[str, Any]) -> str:
    return (
        "a cause of forces and moments is named at a family-wise false alarm rate of "
        f"{diagnosis['false alarm rate']:g}, which all searches and the held-out flights share, when it removes at "
        f"least {100 * diagnosis['material share']:g} % of the removable error on held-out flights and comes again in "
        "enough resamples of the flights' blocks: "
        f"{100 * ALONE:.0f} % alone, {100 * STRONGEST:.0f} % as the strongest of several or where held-out flights do "
        f"not show it, {100 * WEAKER:.0f} % next to a stronger one, half of that where it is very clear; "
        "what all flights have alike has to gain more than that, beyond doubt, with the model's own "
        "terms fitted anew"
    )


def _value(diagnosis: Mapping[str, Any], key: str, level: str, channel: str) -> float | None:
    return diagnosis["gap"][key].get(level, {}).get(channel, {}).get("0")


def _forces(diagnosis: Mapping[str, Any]) -> str:
    if "forces" not in diagnosis["gap"]["before"]:
        return report.render_paragraph("Forces and moments have no held-out flight to be judged on.")
    removed, rows = diagnosis["scores"].get("removed", {}), []
    wrong = diagnosis["scores"].get("best wrong cause")
    yardsticks = [diagnosis["scores"].get("best wrong cause removed", {}),
                  diagnosis["scores"].get("generic polynomial", {}).get("removed", {})]  # fmt: skip
    for axis in AXES:
        three = [_value(diagnosis, k, "forces", axis) for k in ("before", "after", "noise_floor")]
        unit = "N" if axis[0] == "F" else "N m"
        rows.append(
            [f"{CHANNEL_NAMES[axis]} ({axis}), {unit}", *map(report.format_number, three), _share(removed.get(axis)),
             *(_share(other.get(axis)) for other in yardsticks)]
        )  # fmt: skip
    tail = (
        " Next to it, where the named causes act: what the best wrong cause alone would have removed"
        + (f" ({name_of(wrong)})" if wrong else " (none would have removed anything)")
        + ", and a polynomial with as many terms."
        if diagnosis["scores"].get("generic polynomial")
        else ""
    )
    return report.render_table(
        [
            "root mean square on held-out flights",
            "before",
            "after",
            "noise floor",
            "removed",
            "best wrong cause",
            "same-size polynomial",
        ],
        rows,
    ) + report.render_paragraph(
        "Removed: share of the error above the noise floor (squared) that is gone, with its 95 % interval; a dash "
        "where the floor holds nine tenths of the error. To the floor: nothing that was fitted leaves less." + tail
    )


def _share(found: Mapping[str, float | None] | None) -> str:
    if not found or found["value"] is None:
        return "–"
    value, low, high = (f"{round(100 * found[k]) + 0:d}" for k in ("value", "low", "high"))
    begin = "to the floor" if reaches_floor(found["value"]) else f"{value} %"
    return f"{begin} ({low} to {high})".replace("-", "−")


def _rollouts(diagnosis: Mapping[str, Any]) -> str:
    """Errors of simulations by line, and what of their removable part the extension and its yardsticks remove.

    On the page stand the horizon nearest to SHOWN_AT and the longest one; the others open on demand.
    """
    blocks, rest, yardsticks = [], [], False
    for driven, title in LINE_TITLES.items():
        lines = [r for r in diagnosis["rollouts"].get(driven, []) if r["quantity"] in ERROR_UNITS]
        if not lines:
            continue
        horizons = sorted({r["horizon"] for r in lines})
        seen = {min(horizons, key=lambda h: abs(h - SHOWN_AT)), horizons[-1]}
        yardsticks |= any("removed" in r for r in lines)
        for into, part in (
            (blocks, [r for r in lines if r["horizon"] in seen]),
            (rest, [r for r in lines if r["horizon"] not in seen]),
        ):
            into.append(_rollout_table(title, part))
    blocks.append(report.render_details("Other lengths of the simulation", "".join(rest)))
    if yardsticks:
        wrong = diagnosis["scores"].get("best wrong cause with commands")
        tail = f" With commands, the best wrong cause would have been {name_of(wrong)}." if wrong else ""
        blocks.append(
            report.render_paragraph(
                "Removed, and what the best wrong cause and the polynomial would have removed: shares of the squared "
                "error above the noise floor, with 95 % intervals; a dash where the floor holds nine tenths of the "
                "error. To the floor: nothing that was fitted leaves less. "
                "The floor with commands knows the rotors' drive as estimated from the other flights." + tail
            )
        )
    return "".join(blocks)


def _rollout_table(title: str, lines: Sequence[Mapping[str, Any]]) -> str:
    rows = [
        [f"{quantity}, {unit}, after {r['horizon']:g} s",
         *(report.format_number(r.get(k)) for k in ("before", "after", "noise_floor")), _share(r),
         *(_share(r.get(k)) for k in ("removed", "best_wrong_cause", "generic_polynomial"))]
        for quantity, unit in ERROR_UNITS.items()
        for r in lines
        if r["quantity"] == quantity
    ]  # fmt: skip
    head = ["before", "after", "noise floor", "error falls by", "removed", "best wrong cause", "same-size polynomial"]
    return report.render_table([f"simulated with {title}", *head], rows)


def _halves(diagnosis: Mapping[str, Any]) -> str:
    """Errors on the second halves of held-out flights, with trim and parameters estimated from their first halves."""
    found = diagnosis.get("halves") or {}
    if not found:
        return ""
    errors = found["errors"]
    rows = [
        [f"{q}, {unit}, after {float(h):g} s", *(report.format_number(errors[who][q][h]) for who in errors)]
        for q, unit in ERROR_UNITS.items()
        for h in [max(errors["before"][q], key=float)]
    ]
    trims = [
        f"{axis} = {t['before']:.2g} {'N' if axis[0] == 'F' else 'N m'} in {key}"
        for key, about in found["flights"].items()
        for axis, t in about["trim"].items()
        if abs(t["before"]) > 3.0 * t["std"]
    ]
    return report.render_table(["second halves of the held-out flights", *errors], rows) + report.render_paragraph(
        "Trim, a constant force and moment, and a flight's own parameters of the named causes are estimated from its "
        f"first half. The model lacks {', '.join(trims) or 'no trim'}."
    )


def _lower(diagnosis: Mapping[str, Any]) -> str:
    """Errors of sensors and of the rotors' drive on the held-out flights, and what of them stays without a name."""
    blocks = []
    for level, word in LEVEL_TITLES.items():
        rows, named = [], [e for e in diagnosis["effects"] if e["level"] == level and e.get("removed")]
        for channel in diagnosis["gap"]["before"].get(level, {}):
            three = [_value(diagnosis, k, level, channel) for k in ("before", "after", "noise_floor")]
            name = CHANNEL_NAMES.get(channel, channel) + ("" if channel in ROOM_ACCELERATIONS else f" ({channel})")
            gone = [_removed(e["removed"], channel) for e in named]
            rows.append([f"{name}, {_unit(channel)}", *map(report.format_number, three), *gone])
        head = [word, "before", "after", "noise floor", *(f"removed: {name_of(e['id'])}" for e in named)]
        blocks.append(report.render_table(head, rows))
        if named:
            blocks.append(report.render_paragraph(TAKEN_OFF))
        above = _above(diagnosis, level, word)
        blocks.append(report.render_paragraph(above) if above else "")
    return "".join(blocks)


def _removed(shares: Mapping[str, float], channel: str) -> str:
    share = shares.get(channel)
    if reaches_floor(share):
        return "to the floor"
    return "–" if share is None else f"{max(round(100 * share), 0)} %"


def _unit(channel: str) -> str:
    """Unit of a channel of sensors or drive; north, east and down are accelerations there."""
    return "m/s2" if channel in ROOM_ACCELERATIONS else UNITS_OF.get(channel, "")


def _above(diagnosis: Mapping[str, Any], level: str, word: str) -> str:
    """What stays far above its floor though no cause is named there: a finding without a name, not to be missed."""
    named = {c for e in diagnosis["effects"] if e["level"] == level for c in e["channels"]}
    if named & {"ax", "ay", "az"}:
        named |= {*ROOM_ACCELERATIONS}  # the same readings, along the room's axes
    texts = []
    for channel in diagnosis["gap"]["before"].get(level, {}):
        left, floor = (_value(diagnosis, k, level, channel) for k in ("after", "noise_floor"))
        if left is not None and floor and left > FLOORS * floor and channel not in named:
            texts.append(
                f"{channel} {left / floor:.1f} times ({report.format_number(left)} against "
                f"{report.format_number(floor)} "
                f"{_unit(channel)})"
            )
    if not texts:
        return ""
    return (
        f"{word[:1].upper()}{word[1:]} stay above their noise floor, and no cause is named there: {listed(texts)}. The "
        "floor is what is left when all that is known to go wrong there is fitted to each flight by itself; what is "
        "above it fits no single cause, or differs from flight to flight."
    )


def _cause(effect: Mapping[str, Any], known: Mapping[str, Effect]) -> str:
    about = known.get(effect["id"])
    gains = [f"{a} {_share(g)}" for a, g in effect.get("gains", {}).items() if g["value"] is not None]
    if not effect.get("judged", True):
        gains = ["not judged: held-out flights hardly show it"]
    evidence = effect["evidence"]
    return f"<h3>{report.escape(name_of(effect['id']))}</h3>" + report.render_facts(
        [
            ("what happens", happening(effect, known) if about else ""),
            ("equation", about.equation if about else ""),
            ("source", about.source if about else ""),
            ("since", since_of(effect)),
            *((name_of(n), value_of(p)) for n, p in effect["parameters"].items()),
            ("seen in", ", ".join(effect["channels"])),
            ("removable error it removes", ", ".join(gains) or share_of(effect["gain"]["wrench"], None)),
            (
                "of the simulated motion",
                share_of(effect["gain"]["rollout"], effect.get("rollout gain")) + rollout_of(effect),
            ),
            ("roll-outs of held-out flights", words_of(confirmation_of(effect), known)),
            ("probability of nothing", f"{evidence['p']:.1e}" if "p" in evidence else ""),
            ("how sure", certainty_of(effect)),
            ("standard errors widened, the axes differ", _times(evidence.get("axes apart", 1.0))),
            ("rivals that it beat", ", ".join(map(name_of, effect["confused_with"]))),
        ]
    )


def _times(factor: float) -> str:
    return f"{factor:.1f} times" if factor > 1.0 else ""


def _rivals(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> str:
    lost = sorted(diagnosis["candidates"], key=lambda c: c["p"] if c.get("p") is not None else 1.0)[:MOST_CANDIDATES]
    rows = [[name_of(c["id"]), since_of(c) if c.get("since") else "", words_of(c["why_not"], known)] for c in lost]
    return report.render_table(["tested and not named", "asked as", "why not"], rows, words=(1, 2))


def _ties(diagnosis: Mapping[str, Any]) -> str:
    blocks = [report.render_paragraph(tie_sentence(t)) for t in diagnosis["ties"]]
    for tie in diagnosis["ties"]:
        blocks.append(
            report.render_facts(
                (name_of(i), ", ".join(f"{name_of(n)} = {value_of(p)}" for n, p in found.items()))
                for i, found in tie["parameters"].items()
                if found
            )
        )
    return "".join(blocks)


def _extended(diagnosis: Mapping[str, Any]) -> str:
    ident = diagnosis["extended_model"]
    own = [name_of(e["id"]) for e in diagnosis["effects"] if in_model(e)]
    sensors = [name_of(e["id"]) for e in diagnosis["effects"] if corrected_at_import(e["id"], e["level"])]
    text = (
        f"{ident} is {diagnosis['model']} with {', '.join(own)}."
        if own
        else f"Nothing was added: {ident} is {diagnosis['model']}."
    )
    if diagnosis.get("fitted anew"):
        text += " Its own terms were fitted anew to the flights."
    if sensors:
        text += f" The flights were processed anew with what was found of {', '.join(sensors)}."
    return report.render_paragraph(f"{text} Make it, as any model, with the target models/{ident}/standalone.")


def _unasked(diagnosis: Mapping[str, Any], known: Mapping[str, Effect]) -> str:
    reasons: dict[str, list[str]] = {}
    for entry in diagnosis["cannot_be_asked"]:
        reasons.setdefault(entry["why"], []).append(name_of(entry["id"]))
    return report.render_list(
        f"{', '.join(dict.fromkeys(ids))}: {words_of(why, known)}" for why, ids in reasons.items()
    )


def _chart(table: pd.DataFrame | None) -> str:
    """Measured against each model over time, to zoom into; held-out flights are shaded."""
    if table is None:
        return ""
    rows = table[table["role"] != "reference"].iloc[::THIN].reset_index(drop=True).replace([np.inf, -np.inf], np.nan)
    if len(rows) < 2:
        return ""
    t, views, spans, offset, starts = np.empty(len(rows)), [], [], 0.0, []
    for key, part in rows.groupby("flight", sort=False):
        place, own = part.index.to_numpy(), part["t"].to_numpy(float)
        t[place] = own - own[0] + offset
        first, last, held = int(place[0]), int(place[-1]), part["role"].iloc[0] == "held out"
        views.append((str(key), float(t[first]), float(t[last]), held))
        spans += [(*views[-1][1:3], "held")] if held else []
        starts += [first, *(first + np.flatnonzero(np.diff(own) > 5 * np.median(np.diff(own))) + 1).tolist()]
        offset = float(t[last]) + 0.5
    gaps = np.array(starts[1:], int)
    when = np.insert(t, gaps, 0.5 * (t[gaps] + t[gaps - 1]))
    panels = []
    for axis in AXES:
        measured = rows[f"{axis}_measured"].to_numpy(float)
        lines = (("measured", measured, "#3b444b"), *(
            (word, measured - rows[f"{axis}_{word}"].to_numpy(float), colour)
            for word, colour in (("before", "#e8a0a0"), ("after", "#1d6fb8"))
        ))  # fmt: skip
        traces = [Trace(name, np.insert(values, gaps, np.nan), colour) for name, values, colour in lines]
        panels.append(Panel(f"{axis}, {'N' if axis[0] == 'F' else 'N m'}", when, traces))
    chart = Chart(panels, spans, views, marks=[view[1] for view in views[1:]])
    return chart.bar() + chart.place(range(len(panels)), 2) + chart.script()
