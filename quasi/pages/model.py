"""The page of a model: verdict and a predicted flight first, then scores, coverage, terms, rotors, warnings.

One self-contained HTML file without network access. Input is plain data, output is text.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.pages import frame
from quasi.pages.causes import REPLACED_CONSTANTS, describe_effects
from quasi.pages.chart import Chart, Panel, Trace, render_style
from quasi.pages.model_ranges import show_coverage, show_quartiles
from quasi.pages.model_warnings import show_warnings
from quasi.pages.terms import list_variables, show_expression
from quasi.tables import TELEMETRY_AGE_REMOVED
from quasi.terms.rotor_map import describe_map

PAUSE_BETWEEN_FLIGHTS = 0.5  # s between two flights on the time axis


def render_model_page(
    model: Mapping[str, Any],
    summary: Mapping[str, Any],
    diagnosis: Mapping[str, Any],
    coverage: pd.DataFrame,
    rows: pd.DataFrame,
) -> str:
    """Render the page as HTML.

    model      the model's document; summary, diagnosis  as plain data; coverage  of `diagnostics.compute_coverage`
    rows       of `thin_rows`
    """
    flights = model["flights"]
    under = (
        f"airframe {model['airframe']['name']} · {model['gravity']} · training {', '.join(flights['training'])}"
        f" · validation {', '.join(flights['validation']) or 'none'}"
    )
    note = diagnosis["partition"]["note"]
    chart = _make_chart(rows, summary)
    terms = [term for part in model["axes"].values() for term in part["terms"]]
    variables = list_variables(str(term.get("expression") or term["name"]) for term in terms)
    sections = [
        render_style(),
        _render_answer(chart, summary),
        frame.render_section(
            "Axes", _render_verdicts(diagnosis), frame.render_paragraph(_capitalise(note)) if note else ""
        ),
        frame.render_section("Scores", _render_scores(summary), _render_differences(diagnosis)),
        frame.render_section("Along the measured range", show_quartiles(diagnosis)),
        frame.render_section("Coverage of the validation flights by the training flights", show_coverage(coverage)),
        _render_causes(model),
        frame.render_section(
            "Terms",
            *(_render_terms(axis, part) for axis, part in model["axes"].items()),
            frame.render_details("Variables", frame.render_table(("variable", "unit", "meaning"), variables, {1, 2})),
        ),
        frame.render_section("Rotors", _render_rotors(model)),
        frame.render_section("Warnings", show_warnings(model["notes"]) or frame.render_paragraph("None.")),
        chart.script() if chart else "",
    ]
    return frame.render_page(f"Model {model['id']}", under, diagnosis["verdict"], diagnosis["in short"], sections)


def _capitalise(text: str) -> str:
    return text[:1].upper() + text[1:] + "."


def _render_verdicts(diagnosis: Mapping[str, Any]) -> str:
    lines = []
    for axis, facts in diagnosis["axes"].items():
        kind = frame.VERDICT_CLASSES[facts["verdict"]]
        text = facts["statement"].removeprefix(f"{axis}: ")
        remedies = "".join(f"<br><i>{frame.escape(_capitalise(r))}</i>" for r in facts["what to do"])
        mark = {"good": "#1e7d46", "care": "#a86200", "bad": "#b3261e"}[kind]
        lines.append(
            f'<tr><th scope="row" style="width:9%;border-left:5px solid {mark};padding-left:10px">'
            f"{frame.escape(axis)}</th><td>{frame.escape(text)}{remedies}</td></tr>"
        )
    return f"<table><tbody>{''.join(lines)}</tbody></table>"


def _render_scores(summary: Mapping[str, Any]) -> str:
    known = {role for axis in summary["axes"].values() for role in axis["scores"]}
    roles = [r for r in ("training", "test", "validation") if r in known]

    def of(titles: Mapping[str, str], shown: Any) -> str:
        head = ["", *(f"{title}, {role}" for role in roles for title in titles.values())]
        rows = []
        for axis, facts in summary["axes"].items():
            found = [facts["scores"].get(role, {}) for role in roles]
            name = f"{axis}, {facts['unit']}".replace(" ", "\u00a0")
            rows.append([name, *(shown(s.get(what)) for s in found for what in titles)])
        return frame.render_table(head, rows)

    return of({"r2": "R²", "rmse": "RMSE"}, lambda v: frame.format_number(v, 4)) + of(
        {"relative_rmse": "error of rms", "coverage": "in interval"}, frame.format_share
    )


def _render_differences(diagnosis: Mapping[str, Any]) -> str:
    columns = ("test and training", "test and validation", "validation above training")
    some = [c for c in columns if any(f["relative difference"][c] is not None for f in diagnosis["axes"].values())]
    rows = []
    for axis, facts in diagnosis["axes"].items():
        marks = {"test and training": facts["warnings"]["test"], "test and validation": facts["warnings"]["validation"]}
        found = facts["relative difference"]
        cells = (("–" if found[c] is None else _format_tenths(found[c])) + (" !" if marks.get(c) else "") for c in some)
        rows.append([axis, *cells])
    text = "100 (1 − training / test) and 100 (1 − validation / test); ! beyond 10 % in the direction of overfitting."
    note = f"<p class=under>{frame.escape(text)}</p>" if set(some) & set(columns[:2]) else ""
    return frame.render_table(("relative difference in RMSE, %", *some), rows) + note if some else ""


def _format_tenths(value: float) -> str:
    return f"{round(value, 1) + 0.0:.1f}".replace("-", "−")


# ---- the prediction ----


def _make_chart(rows: pd.DataFrame, summary: Mapping[str, Any]) -> Chart | None:
    """Chart measurement, prediction and interval of every axis, flight after flight; the first held-out flight
    first.
    """
    if len(rows) < 2:
        return None
    t, views, spans, offset, begin = np.empty(len(rows)), [], [], 0.0, 0
    keys = rows["flight"].to_numpy()
    for end in [*(np.flatnonzero(keys[1:] != keys[:-1]) + 1).tolist(), len(rows)]:
        own = rows["t"].to_numpy(float)[begin:end]
        t[begin:end] = own - own[0] + offset
        held = bool(rows["held"].iloc[begin] > 0)
        views.append((str(keys[begin]), float(t[begin]), float(t[end - 1]), held))
        if held:
            spans.append((float(t[begin]), float(t[end - 1]), "held"))
        offset, begin = float(t[end - 1]) + PAUSE_BETWEEN_FLIGHTS, end
    starts = np.flatnonzero(rows["start"].to_numpy() > 0)[1:]
    panels = []
    for axis, facts in summary["axes"].items():
        measured, model, half = (rows[name].to_numpy(float) for name in (axis, f"{axis}_model", f"{axis}_half"))
        # a row of unknown values before each start, so that no line bridges a gap or two flights
        when = np.insert(t, starts, 0.5 * (t[starts] + t[starts - 1]))
        lines = [np.insert(v, starts, np.nan) for v in (measured, model, model + half, model - half)]
        traces = [
            Trace(name, values, colour, width)
            for name, values, colour, width in zip(
                ("measured", "model", "", ""), lines, ("#3b444b", "#d62728", "#f6d3d3", "#f6d3d3"), (1.0, 1.2, 0, 0)
            )
        ]
        panels.append(Panel(f"{axis}, {facts['unit']}", when, traces, 150, [(2, 3, "rgba(214,39,40,0.18)")]))
    first = next((view for view in views if view[3]), views[0])
    return Chart(panels, spans, views, first[1:3], [view[1] for view in views[1:]])


def _render_answer(chart: Chart | None, summary: Mapping[str, Any]) -> str:
    """Render the first screen: predicted and measured flight, and the error in one sentence."""
    if chart is None:
        return ""
    view = next((v for v in chart.views if v[3]), chart.views[0])
    role = "validation" if view[3] else "training"
    errors = [
        f"{axis} {frame.format_share(facts['scores'][role].get('relative_rmse'))}"
        for axis, facts in summary["axes"].items()
        if facts["scores"].get(role)
    ]
    flown = f"{view[0]}, a held-out flight" if view[3] else f"{view[0]}, a training flight"
    text = f"Prediction (red, with its interval) and measurement (black) of {flown}."
    if errors:
        of = "all held-out flights" if view[3] else "all training flights"
        text += f" Error relative to the rms value over {of}: {', '.join(errors)}."
    return f"<p>{frame.escape(text)}</p>{chart.bar()}{chart.place(range(len(chart.panels)), 2)}"


# ---- tables ----


def _render_causes(model: Mapping[str, Any]) -> str:
    """Render the causes that extend the model and their effects; nothing for a model without extensions."""
    rows = []
    for extension in model.get("extensions") or ():
        found = extension.get("parameters") or {}
        instead = any(name in REPLACED_CONSTANTS for name in extension.get("actuators") or ())
        values = [
            f"{n.replace('_', ' ')} {frame.format_number(p['value'], 4)}"
            + (f" {p['unit']}" if p["unit"] not in ("", "1") else "")
            for n, p in found.items()
            if p["value"] or instead
        ]
        text = ", ".join(values) + (", replaces the value of the model" if values and instead else "")
        text = [extension.get("sentence"), text, f"effects: {describe_effects(extension)}"]
        rows.append((str(extension.get("id")), ". ".join(_capitalise(part)[:-1] for part in text if part) + "."))
    if not rows:
        return ""
    text = (
        "Numbers are deviations from the values of the model, except where they replace them. "
        "Predictions contain the quasi-steady part only."
    )
    return frame.render_section("Causes that extend the model", frame.render_facts(rows), frame.render_paragraph(text))


def _render_terms(axis: str, part: Mapping[str, Any]) -> str:
    often = any("inclusion frequency" in term for term in part["terms"])
    head = [f"{axis}", "coefficient", "std. error", "|t|", *(["inclusion"] if often else []), "unit"]
    rows = []
    for term in part["terms"]:
        t = term.get("t")
        cells = [
            show_expression(term["name"]), f"{term['coefficient']:.4e}".replace("-", "−"),
            "given" if term.get("given") else f"{term['std']:.1e}".replace("-", "−"),
            "–" if t is None else f"{abs(t):.1f}",
        ]  # fmt: skip
        if often:
            cells.append(frame.format_share(term.get("inclusion frequency")))
        rows.append([*cells, term["unit"]])
    return frame.render_table(head, rows)


def _name_delay(found: Mapping[str, Any]) -> str:
    """Name the row of the delay."""
    text = (found.get("delay") or {}).get(TELEMETRY_AGE_REMOVED)
    return "delay" if text is None else "delay of the command" if text else "delay of command and rotor telemetry"


def _render_rotors(model: Mapping[str, Any]) -> str:
    found = model.get("actuators")
    hover = model["hover speed"]
    speed = frame.format_with_error(hover["value"], hover.get("std"), "rad/s") if hover["value"] else "unknown"
    facts = [("hover speed", speed)]
    facts += [("rotor speeds", f"{sentence}.") for sentence in describe_map(model)]
    for name, entry in model.get("simple model", {}).items():
        if not name.endswith("_w"):
            doubt = "" if entry["std"] is None else f" ± {entry['std']:.1g}"  # published ones have none
            digits = f"{entry['value']:.4g}{doubt} {entry['unit']}"
            facts.append((name, digits.replace("-", "−")))
    if not found:
        return frame.render_facts(facts) + frame.render_paragraph("No flight shows the time constants of the rotors.")
    rows = []
    for title, key in (
        ("time constant, up", "time constants up"), ("time constant, down", "time constants down"),
        ("one time constant for both", "time constants"), (_name_delay(found), "delay"),
    ):  # fmt: skip
        entry = found.get(key)
        if entry:
            std = entry.get("std") or [None] * 4
            spread = entry.get("spread")
            between = frame.format_number(1e3 * float(np.mean(spread)), 2) if spread else "–"
            rows.append(
                [
                    f"{title}, ms",
                    *(frame.format_with_error(v, s, "", 1e3) for v, s in zip(entry["value"], std)),
                    between,
                ]
            )
    mapped = found.get("command map")
    if mapped:
        powers = mapped.get("powers") or range(len(mapped["coefficients"]))
        terms = " + ".join(
            f"{c:.5g}" + ("" if k == 0 else " c" if k == 1 else f" c^{k}")
            for k, c in zip(powers, mapped["coefficients"])
        )
        exponent = mapped.get("voltage exponent")
        exponent = exponent["value"] if isinstance(exponent, Mapping) else exponent
        volts = mapped.get("reference voltage")
        law = f"({terms}) rad/s".replace("+ -", "− ")
        if exponent and volts:
            law += f" x (V / {volts:.2f} V)^{exponent:.2f}"
        facts.append(("speed for command c (0 to 1)", f"{law}, {mapped.get('source', '')}".rstrip(", ")))
    head = ("rotor", "1", "2", "3", "4", "spread over flights")
    return frame.render_facts(facts) + frame.render_table(head, rows)
