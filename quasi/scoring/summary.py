"""The summary of a model: its scores and verdict as text, all of it as plain data, its terms as LaTeX tables."""

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from quasi.model.document import is_number
from quasi.model.model import Model
from quasi.scoring.score import POOLED, format_scores
from quasi.terms.rotor_map import describe_map

SUMMARY_SCHEMA = "quasi.summary/1"
SUMMARY_TERM_KEYS = (
    "name",
    "expression",
    "coefficient",
    "std",
    "t",
    "unit",
    "fixed",
    "given",
    "inflation",
    "inclusion frequency",
)
_TEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "%": r"\%", "#": r"\#", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"{\char34}", "'": r"{\char39}", "`": r"{\char96}",
}  # fmt: skip


def format_summary(model: Model, scores: pd.DataFrame, diagnosis: Mapping[str, Any]) -> str:
    """Format verdict and scores; without held-out flights, add a note on the value of the test rows."""
    lines = [f"Verdict: {diagnosis['verdict']}", *(f"  {line}" for line in diagnosis["summary"]), ""]
    text = "\n".join(lines) + format_scores(scores, model)
    # the page always has the note; with held-out flights it needs no action
    note = None if (scores["role"] == "validation").any() else diagnosis["partition"]["note"]
    text += "".join(f"{sentence}\n" for sentence in describe_map(model.document))
    return text + (f"note: {note}\n" if note else "")


def make_summary(model: Model, scores: pd.DataFrame, diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """Make terms, scores and verdict per axis as plain data ("quasi.summary/1")."""
    pooled = scores[scores["flight"] == POOLED]
    axes = {}
    for axis in model.axes:
        part, facts = model.document["axes"][axis], diagnosis["axes"][axis]
        rows = pooled[pooled["axis"] == axis].drop(columns=["flight", "axis"])
        axes[axis] = {
            "unit": part["unit"],
            "verdict": facts["verdict"],
            "because": facts["because"],
            "what to do": facts["what to do"],
            "terms": [{k: term[k] for k in SUMMARY_TERM_KEYS if k in term} for term in part["terms"]],
            "scores": {
                row.pop("role"): {k: v if is_number(v) else None for k, v in row.items()}
                for row in rows.to_dict("records")
            },
            "training rows": part["n"],
            "effective rows": part["effective rows"],
        }
    return {
        "schema": SUMMARY_SCHEMA,
        "model": model.id,
        "verdict": diagnosis["verdict"],
        "summary": diagnosis["summary"],
        "hover speed": model.document["hover speed"],
        "actuators": model.document.get("actuators"),
        "rotor speeds": describe_map(model.document) or None,
        "flights": model.document["flights"],
        "axes": axes,
    }


def format_latex(model: Model, scores: pd.DataFrame, diagnosis: Mapping[str, Any]) -> str:
    r"""Tables for \input in a LaTeX document: scores of all axes, then the terms of each. No packages are needed."""
    lines = [
        f"% Model {' '.join(model.id.split())}: scores and terms; include it with \\input{{...}}, no packages needed",
        *_format_scores(model, scores, diagnosis),
    ]
    for axis in model.axes:
        lines += _format_terms(model, axis)
    return "\n".join(lines) + "\n"


def _format_scores(model: Model, scores: pd.DataFrame, diagnosis: Mapping[str, Any]) -> list[str]:
    pooled = scores[scores["flight"] == POOLED].set_index(["role", "axis"])
    roles = [r for r in ("training", "test", "validation") if r in pooled.index.get_level_values("role")]
    lines = [
        r"\begin{table}[htbp]", r"\centering",
        rf"\caption{{Model {escape_latex(model.id)}: $R^2$ and RMSE (N, N\,m).}}",
        rf"\begin{{tabular}}{{l{'rr' * len(roles)}l}}", r"\hline",
        " & ".join(["", *(rf"\multicolumn{{2}}{{c}}{{{role}}}" for role in roles), ""]) + r" \\",
        " & ".join(["axis", *["$R^2$ & RMSE"] * len(roles), "verdict"]) + r" \\", r"\hline",
    ]  # fmt: skip
    for axis in model.axes:
        cells = [escape_latex(axis)]
        for role in roles:
            row = pooled.loc[(role, axis)]
            cells += [format_number(row["r2"], 4), format_number(row["rmse"], 4)]
        lines.append(" & ".join([*cells, escape_latex(diagnosis["axes"][axis]["verdict"])]) + r" \\")
    return [*lines, r"\hline", r"\end{tabular}", r"\end{table}"]


def _format_terms(model: Model, axis: str) -> list[str]:
    part = model.document["axes"][axis]
    often = any("inclusion frequency" in term for term in part["terms"])
    head = ["term", "coefficient", "std.~error", "$|t|$", *(["inclusion"] if often else []), "unit"]
    lines = [
        "", r"\begin{table}[htbp]", r"\centering",
        rf"\caption{{{escape_latex(axis)} of model {escape_latex(model.id)}: $R^2 = {part['R2']:.4f}$, RMSE "
        rf"{format_number(part['RMSE'], 4)} {format_unit(part['unit'])} on {part['n']} training rows.}}",
        rf"\begin{{tabular}}{{l{'r' * (len(head) - 2)}l}}", r"\hline", " & ".join(head) + r" \\", r"\hline",
    ]  # fmt: skip
    for term in part["terms"]:
        t = term.get("t")
        cells = [
            rf"\texttt{{{escape_latex(term['name'])}}}",
            format_number(term["coefficient"], 5),
            "given" if term.get("given") else format_number(term["std"], 2),
            "--" if t is None else f"{abs(t):.1f}",
        ]
        if often:
            share = term.get("inclusion frequency")
            cells.append("--" if share is None else rf"{100 * share:.0f}\,\%")
        lines.append(" & ".join([*cells, format_unit(term["unit"])]) + r" \\")
    return [*lines, r"\hline", r"\end{tabular}", r"\end{table}"]


def escape_latex(text: object) -> str:
    """Escape text for LaTeX; characters outside ASCII become question marks."""
    return "".join(_TEX.get(c, c) if " " <= c <= "~" else "?" for c in str(text))


def format_number(value: float, digits: int) -> str:
    """Format a number in mathematical mode with this many significant digits, powers of ten only where needed."""
    if not is_number(value):
        return "--"
    if value == 0:
        return "$0$"
    power = math.floor(math.log10(abs(value)))
    if -3 <= power < digits:
        return f"${value:.{max(digits - 1 - power, 0)}f}$"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return rf"${mantissa}\times10^{{{int(exponent)}}}$"


def format_unit(text: str) -> str:
    """Format a unit such as "N s2/rad2" with superscripts."""
    out, digits = [], ""
    for c in [*text, ""]:
        if (c.isdigit() and (digits or (out and out[-1].isalpha()))) or (c == "." and digits):
            digits += c
            continue
        if digits:
            out.append(f"$^{{{digits}}}$")
            digits = ""
        out.append(r"\," if c == " " else escape_latex(c))
    return "".join(out)
