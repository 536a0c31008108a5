"""The page of a model: verdict first, then scores, a comparison to zoom into, coverage, terms, actuators, warnings.

One HTML file that needs nothing else and no network. Plain data in, text out; only the comparison runs a script, ours.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.pages import frame
from quasi.pages.causes import REPLACED, where_it_acts
from quasi.pages.chart import STYLE, chart, packed, step_of
from quasi.tables import AGE_OFF, ANY

COLOURS = {"training": "#59636b", "test": "#d97706", "validation": "#1d6fb8"}
BANDS = ("#fde8e6", "#eef5ec", "#e6effa")


def page(
    model: Mapping[str, Any],
    summary: Mapping[str, Any],
    diagnosis: Mapping[str, Any],
    coverage: pd.DataFrame,
    rows: pd.DataFrame,
) -> str:
    """The page as HTML.

    model      the model's document; summary, diagnosis  as plain data; coverage  of `diagnostics.covered_share`
    rows       of `thin`
    """
    flights = model["flights"]
    under = (
        f"airframe {model['airframe']['name']} · {model['gravity']} · training {', '.join(flights['training'])}"
        f" · validation {', '.join(flights['validation']) or 'none'}"
    )
    note = diagnosis["partition"]["note"]
    sections = [
        f"<style>{STYLE}</style>",
        frame.section("Axes", _verdicts(diagnosis), frame.paragraph(_sentence(note)) if note else ""),
        frame.section("Scores", _scores(summary), _differences(diagnosis)),
        frame.section("Measured and modelled", _comparison(rows, summary)),
        frame.section("Along the measured range", _quartiles(diagnosis)),
        frame.section("Coverage of the validation flights by the training flights", _coverage(coverage)),
        _causes(model),
        frame.section("Terms", *(_terms(axis, part) for axis, part in model["axes"].items())),
        frame.section("Rotors", _rotors(model)),
        frame.section("Warnings", frame.sentences(model["notes"]) or frame.paragraph("None.")),
    ]
    return frame.page(f"Model {model['id']}", under, diagnosis["verdict"], diagnosis["shortly"], sections)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + "."


def _verdicts(diagnosis: Mapping[str, Any]) -> str:
    lines = []
    for axis, facts in diagnosis["axes"].items():
        kind = frame.KINDS[facts["verdict"]]
        said = facts["said"].removeprefix(f"{axis}: ")
        remedies = "".join(f"<br><i>{frame.escape(_sentence(r))}</i>" for r in facts["what to do"])
        mark = {"good": "#1e7d46", "care": "#a86200", "bad": "#b3261e"}[kind]
        lines.append(
            f'<tr><th scope="row" style="width:9%;border-left:5px solid {mark};padding-left:10px">{axis}</th>'
            f"<td>{frame.escape(said)}{remedies}</td></tr>"
        )
    return f"<table><tbody>{''.join(lines)}</tbody></table>"


def _roles(summary: Mapping[str, Any]) -> list[str]:
    known = {role for axis in summary["axes"].values() for role in axis["scores"]}
    return [r for r in ("training", "test", "validation") if r in known]


def _scores(summary: Mapping[str, Any]) -> str:
    roles = _roles(summary)

    def of(titles: Mapping[str, str], shown: Any) -> str:
        head = ["", *(f"{title}, {role}" for role in roles for title in titles.values())]
        rows = []
        for axis, facts in summary["axes"].items():
            found = [facts["scores"].get(role, {}) for role in roles]
            name = f"{axis}, {facts['unit']}".replace(" ", "\u00a0")
            rows.append([name, *(shown(s.get(what)) for s in found for what in titles)])
        return frame.table(head, rows)

    return of({"r2": "R²", "rmse": "RMSE"}, lambda v: frame.number(v, 4)) + of(
        {"relative_rmse": "error of rms", "coverage": "in interval"}, frame.share
    )


def _differences(diagnosis: Mapping[str, Any]) -> str:
    columns = ("test and training", "test and validation", "validation above training")
    some = [c for c in columns if any(f["relative difference"][c] is not None for f in diagnosis["axes"].values())]
    rows = []
    for axis, facts in diagnosis["axes"].items():
        marks = {"test and training": facts["warnings"]["test"], "test and validation": facts["warnings"]["validation"]}
        found = facts["relative difference"]
        cells = (("–" if found[c] is None else _tenths(found[c])) + (" !" if marks.get(c) else "") for c in some)
        rows.append([axis, *cells])
    said = (
        "100 (1 − training / test) and 100 (1 − validation / test); ! beyond 10 % on the side that means overfitting."
    )
    note = f"<p class=under>{frame.escape(said)}</p>" if set(some) & set(columns[:2]) else ""
    return frame.table(("relative difference in RMSE, %", *some), rows) + note if some else ""


def _tenths(value: float) -> str:
    return f"{round(value, 1) + 0.0:.1f}".replace("-", "−")


# ---- the comparison ----


def _comparison(rows: pd.DataFrame, summary: Mapping[str, Any]) -> str:
    if len(rows) < 2:
        return ""
    t, flights, offset, begin = np.empty(len(rows)), [], 0.0, 0
    keys = rows["flight"].to_numpy()
    for end in [*(np.flatnonzero(keys[1:] != keys[:-1]) + 1).tolist(), len(rows)]:
        own = rows["t"].to_numpy()[begin:end]
        t[begin:end] = own - own[0] + offset
        role = "validation" if rows["held"].iloc[begin] > 0 else "training"
        flights.append({"key": keys[begin], "role": role, "from": begin, "to": end, "begins": float(own[0])})
        offset, begin = float(t[end - 1]) + 0.5, end
    axes = {}
    for axis, facts in summary["axes"].items():
        three = [rows[name].to_numpy(float) for name in (axis, f"{axis}_model", f"{axis}_half")]
        low = float(min(np.nanmin(three[0]), np.nanmin(three[1])))
        high = float(max(np.nanmax(three[0]), np.nanmax(three[1]), low + np.nanmax(three[2])))
        step = step_of(low, high)
        axes[axis] = {
            "unit": facts["unit"], "low": low, "step": step, "measured": packed(three[0], low, step),
            "model": packed(three[1], low, step), "half": packed(three[2], 0.0, step),
        }  # fmt: skip
    starts = np.flatnonzero(rows["start"].to_numpy() > 0).tolist()
    return chart(t, starts, flights, axes, "the figures beside this page show the same", interval=True)


# ---- pictures drawn as SVG ----


def _quartiles(diagnosis: Mapping[str, Any]) -> str:
    rows, pictures, roles = [], [], []
    for axis, facts in diagnosis["axes"].items():
        roles = list(facts["histogram"]["density"]) or roles
        for band in facts["quartiles"]:
            bounds = f"{frame.number(band['from'])} to {frame.number(band['to'])} {facts['unit']}"
            ratios = [f"{band[k]:.2f}" if band[k] is not None else "–" for k in ("X/T", "V/T") if "test" in roles]
            rows.append(
                (f"{axis}, {band['band']}", bounds, *(frame.number(band["rmse"].get(r)) for r in roles), *ratios)
            )
        pictures.append(_histogram(axis, facts))
    said = (
        "How the measured values of each kind of row are spread (logarithmic); colours part the lower 25 %, middle "
        "50 % and upper 25 %."
    )
    head = ["RMSE by quartile", "measured", *roles]
    head += ["training/test", "validation/test"] if "test" in roles else []
    return frame.table(head, rows) + f"<figure>{''.join(pictures)}<figcaption>{said}</figcaption></figure>"


def _histogram(axis: str, facts: Mapping[str, Any]) -> str:
    """How the rows of each role are spread over the measured range, logarithmic; the quartiles in colour."""
    edges, density = np.array(facts["histogram"]["edges"]), facts["histogram"]["density"]
    top = max((max(d) for d in density.values()), default=0.0)
    if not len(edges) or top <= 0:
        return ""
    least = top * 1e-4
    width, height = 1000, 88
    low, span = edges[0], edges[-1] - edges[0]

    def x(value: float) -> float:
        return float(np.clip((value - low) / span, 0, 1)) * width

    def y(value: float) -> float:
        return height - 17 - (np.log(max(value, least) / least) / np.log(top / least)) * (height - 24)

    parts = []
    for k, (band, colour) in enumerate(zip(facts["quartiles"], BANDS)):
        a, b = x(band["from"]) if k else 0.0, x(band["to"]) if k < 2 else float(width)
        parts.append(f'<rect x="{a:.1f}" y="0" width="{max(b - a, 0.5):.1f}" height="{height - 17}" fill="{colour}"/>')
    for role, values in density.items():
        steps = " ".join(f"{x(edges[k + side]):.1f},{y(v):.1f}" for k, v in enumerate(values) for side in (0, 1))
        parts.append(f'<polyline points="{steps}" fill="none" stroke="{COLOURS[role]}" stroke-width="1.5"/>')
    for place, anchor in ((low, "start"), (edges[-1], "end")):
        parts.append(
            f'<text x="{x(place):.0f}" y="{height - 5}" font-size="12" fill="#5b6770" text-anchor="{anchor}">'
            f"{frame.number(float(place))} {frame.escape(facts['unit'])}</text>"
        )
    parts.append(f'<text x="6" y="15" font-size="13" fill="#1c2329">{axis}</text>')
    key = " · ".join(f'<tspan fill="{COLOURS[r]}">{r}</tspan>' for r in density)
    parts.append(f'<text x="{width / 2}" y="{height - 5}" font-size="12" text-anchor="middle">{key}</text>')
    return f'<svg viewBox="0 0 {width} {height}" width="100%" role="img">{"".join(parts)}</svg>'


def _coverage(coverage: pd.DataFrame) -> str:
    if not len(coverage):
        return frame.paragraph("No validation flights.")
    beyond = [
        f"{line.variable.removeprefix(ANY)} {frame.share(line.above)}"
        for line in coverage.itertuples()
        if line.variable.startswith(ANY)
    ]
    lines = [line for line in coverage.itertuples() if not line.variable.startswith(ANY)]
    lines = [line for line in lines if line.training_max > line.training_min]
    height, left, right = 24, 130, 110
    width = 1000
    parts = []

    def x(line: Any, value: float) -> float:
        share = (value - line.training_min) / (line.training_max - line.training_min)
        return left + float(np.clip(0.1 + 0.8 * share, 0, 1)) * (width - left - right)

    for k, line in enumerate(lines):
        y = k * height
        for a, b, top, tall, colour in (
            (line.training_min, line.training_max, 4, 16, "#e7eaed"),
            (line.training_p1, line.training_p99, 4, 16, "#c3cad0"),
            (line.min, line.max, 11, 2, COLOURS["validation"]),
            (line.p1, line.p99, 9, 6, COLOURS["validation"]),
        ):
            parts.append(
                f'<rect x="{x(line, a):.1f}" y="{y + top}" width="{max(x(line, b) - x(line, a), 1):.1f}" '
                f'height="{tall}" fill="{colour}"/>'
            )
        share = line.below + line.above
        said = frame.share(share) + " beyond" if share > 5e-4 else ""
        parts.append(
            f'<text x="{left - 8}" y="{y + 16}" font-size="13" text-anchor="end">{frame.escape(line.variable)}</text>'
            f'<text x="{width}" y="{y + 16}" font-size="12" fill="#b3261e" text-anchor="end">{said}</text>'
        )
    drawn = f'<svg viewBox="0 0 {width} {height * len(lines)}" width="100%" role="img">{"".join(parts)}</svg>'
    said = (
        "Grey: range of the training rows, dark its 1 to 99 %. Blue: the validation rows, thick their 1 to 99 %. "
        "Validation rows with some variable beyond the training rows' 0.01 to 99.99 %: " + ", ".join(beyond) + "."
    )
    return f"<figure>{drawn}<figcaption>{frame.escape(said)}</figcaption></figure>"


# ---- tables ----


def _causes(model: Mapping[str, Any]) -> str:
    """What extends the model, and where it acts; nothing for a model that nothing extends."""
    rows = []
    for extension in model.get("extensions") or ():
        found = extension.get("parameters") or {}
        instead = any(name in REPLACED for name in extension.get("actuators") or ())
        values = [
            f"{n.replace('_', ' ')} {frame.number(p['value'], 4)}"
            + (f" {p['unit']}" if p["unit"] not in ("", "1") else "")
            for n, p in found.items()
            if p["value"] or instead
        ]
        told = ", ".join(values) + (", in place of the model's own" if values and instead else "")
        said = [extension.get("sentence"), told, f"where it acts: {where_it_acts(extension)}"]
        rows.append((str(extension.get("id")), ". ".join(_sentence(part)[:-1] for part in said if part) + "."))
    if not rows:
        return ""
    told = (
        "Numbers are deviations from what the model said before, but where they are said to stand in place of its own; "
        "predictions are its quasi-steady part."
    )
    return frame.section("Causes that extend it", frame.facts(rows), frame.paragraph(told))


def _terms(axis: str, part: Mapping[str, Any]) -> str:
    often = any("inclusion frequency" in term for term in part["terms"])
    head = [f"{axis}", "coefficient", "std. error", "|t|", *(["inclusion"] if often else []), "unit"]
    rows = []
    for term in part["terms"]:
        t = term.get("t")
        cells = [
            term["name"], f"{term['coefficient']:.4e}".replace("-", "−"),
            "given" if term.get("given") else f"{term['std']:.1e}".replace("-", "−"),
            "–" if t is None else f"{abs(t):.1f}",
        ]  # fmt: skip
        if often:
            cells.append(frame.share(term.get("inclusion frequency")))
        rows.append([*cells, term["unit"]])
    return frame.table(head, rows)


def _delay(found: Mapping[str, Any]) -> str:
    """What the row of the delay is called."""
    said = (found.get("delay") or {}).get(AGE_OFF)
    return "delay" if said is None else "delay of the command" if said else "delay of command and rotor telemetry"


def _rotors(model: Mapping[str, Any]) -> str:
    found = model.get("actuators")
    hover = model["hover speed"]
    speed = frame.with_error(hover["value"], hover.get("std"), "rad/s") if hover["value"] else "unknown"
    facts = [("hover speed", speed)]
    for name, entry in model.get("simple model", {}).items():
        if not name.endswith("_w"):
            doubt = "" if entry["std"] is None else f" ± {entry['std']:.1g}"  # published ones have none
            digits = f"{entry['value']:.4g}{doubt} {entry['unit']}"
            facts.append((name, digits.replace("-", "−")))
    if not found:
        return frame.facts(facts) + frame.paragraph("No flight told the rotors' time constants.")
    rows = []
    for title, key in (
        ("time constant, up", "time constants up"), ("time constant, down", "time constants down"),
        ("one time constant for both", "time constants"), (_delay(found), "delay"),
    ):  # fmt: skip
        entry = found.get(key)
        if entry:
            std = entry.get("std") or [None] * 4
            spread = entry.get("spread")
            between = frame.number(1e3 * float(np.mean(spread)), 2) if spread else "–"
            rows.append(
                [f"{title}, ms", *(frame.with_error(v, s, "", 1e3) for v, s in zip(entry["value"], std)), between]
            )
    mapped = found.get("command map")
    if mapped:
        terms = " + ".join(
            f"{c:.5g}" + ("" if k == 0 else " c" if k == 1 else f" c^{k}") for k, c in enumerate(mapped["coefficients"])
        )
        exponent = mapped.get("voltage exponent")
        exponent = exponent["value"] if isinstance(exponent, Mapping) else exponent
        volts = mapped.get("reference voltage")
        law = f"({terms}) rad/s".replace("+ -", "− ")
        if exponent and volts:
            law += f" x (V / {volts:.2f} V)^{exponent:.2f}"
        facts.append(("speed for command c (0 to 1)", f"{law}, {mapped.get('source', '')}".rstrip(", ")))
    head = ("rotor", "1", "2", "3", "4", "spread over flights")
    return frame.facts(facts) + frame.table(head, rows)
