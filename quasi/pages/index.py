"""The index page of a project folder: flights with verdicts, models side by side, gaps and simulations, all linked.

It shows existing results and makes none. An unreadable file is listed with the reason.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from quasi.errors import QuasiError
from quasi.pages import frame
from quasi.tables import read_json, write_text

INDEX_TARGET = "results/index.html"
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
VERDICT_COLOURS = {"good": "#1e7d46", "care": "#a86200", "bad": "#b3261e", "": "#5b6770"}
# kind: (pattern of its summaries, page of each; {0}, {1} are the names matched by the stars)
ARTIFACT_KINDS = {
    "flights": ("results/parts/filtering/*/*/verdict.json", "results/reports/{0}/{1}.html"),
    "models": ("models/*/standalone/summary.json", "models/{0}/standalone/report.html"),
    "simulations": ("results/simulations/*/summary.json", "results/simulations/{0}"),
    "gaps": ("results/gaps/*/diagnosis.json", "results/gaps/{0}/report.html"),
}

# words of verdicts, as the page begins
WORST_FIRST = (
    "unusable", "unexplained", "not judged", "partly explained", "usable with care", "explained", "agrees", "good",
)  # fmt: skip


def list_sources(root: str | Path) -> list[str]:
    """List absolute paths of the source files of the index; no rule of the workflow makes absolute paths."""
    place = Path(root).absolute()
    return sorted(str(path) for pattern, _ in ARTIFACT_KINDS.values() for path in place.glob(pattern))


def collect_artifacts(root: str | Path) -> dict[str, list[dict[str, Any]]]:
    """Collect the results of a project folder: {kind: entries with "name", "link", "file" and "data" or "fault"}.

    link  relative to results/, None where the page is absent
    """
    found: dict[str, list[dict[str, Any]]] = {}
    for kind, (pattern, target) in ARTIFACT_KINDS.items():
        stars = [k for k, part in enumerate(Path(pattern).parts) if part == "*"]
        for path in sorted(Path(root).glob(pattern)):
            place = path.relative_to(root)
            names = [place.parts[k] for k in stars]
            render_index = Path(target.format(*names))
            entry: dict[str, Any] = {"name": " ".join(names), "file": place.as_posix(), "link": None}
            if (Path(root) / render_index).exists():
                entry["link"] = (
                    render_index.relative_to("results").as_posix()
                    if render_index.parts[0] == "results"
                    else f"../{render_index}"
                )
            try:
                data = read_json(path)
                entry |= {"data": data} if isinstance(data, dict) else {"fault": "expected an object"}
            except (QuasiError, OSError, ValueError) as fault:
                entry["fault"] = str(fault)
            found.setdefault(kind, []).append(entry)
    return found


def render_index(found: Mapping[str, Sequence[Mapping[str, Any]]], folder: str) -> str:
    """Render the index page as HTML. found  of `collect_artifacts`; folder  the name of the project folder"""
    flights, models = list(found.get("flights", ())), list(found.get("models", ()))
    gaps, simulations = list(found.get("gaps", ())), list(found.get("simulations", ()))
    kinds = (("flight", flights), ("model", models), ("simulation", simulations), ("gap", gaps))
    parts = [_format_kind(noun, entries) for noun, entries in kinds if entries]
    faulty = [e for entries in found.values() for e in entries if "fault" in e]
    sections = [
        _render_tiles(
            [(e, str(e["name"])) for e in flights]
            + [(e, f"{noun} {e['name']}") for noun, kind in (kinds[1], kinds[3]) for e in kind]
        ),
        frame.render_section("Models", _render_models(models)),
        frame.render_section("Gaps", _render_rows(gaps, _read_gap_sentence)),
        frame.render_section("Flights", _render_rows(flights, lambda data: str(data.get("because", "")))),
        frame.render_section("Simulations", _render_rows(simulations, _describe_simulation)),
        frame.render_section("Could not be read", frame.render_list(f"{e['file']}: {e['fault']}" for e in faulty)),
    ]
    # of the flights, or where none was asked for a page, of what was made of them
    counts = Counter(map(_read_verdict, flights or [*models, *gaps]))
    worst = next((w for w in WORST_FIRST if counts[w]), "nothing judged")
    return frame.render_page(f"Project {folder}", "results in the folder", worst, ", ".join(parts), sections)


def write_index(root: str | Path, target: str | Path) -> None:
    """Read the summaries in a project folder and write its index page."""
    write_text(target, render_index(collect_artifacts(root), Path(root).absolute().name))


def _format_kind(noun: str, entries: Sequence[Mapping[str, Any]]) -> str:
    """Count entries, flights by their verdicts as well."""
    counts = Counter(map(_read_verdict, entries)) if noun == "flight" else {}
    by_verdict = f" ({', '.join(f'{n} {w}' for w, n in counts.items())})" if counts else ""
    return f"{len(entries)} {noun}" + ("" if len(entries) == 1 else "s") + by_verdict


def _read_verdict(entry: Mapping[str, Any]) -> str:
    """Read the verdict of an entry; "not judged" without one."""
    word = (entry.get("data") or {}).get("verdict")
    return word if isinstance(word, str) and word else "not judged"


def _render_link(entry: Mapping[str, Any], text: str) -> str:
    shown = frame.escape(text)
    link = entry.get("link")
    return f'<a href="{frame.escape(quote(str(link)))}">{shown}</a>' if link else shown


def _choose_colour(word: str) -> str:
    return VERDICT_COLOURS[frame.VERDICT_CLASSES.get(word, "")]


def _render_tiles(entries: Sequence[tuple[Mapping[str, Any], str]]) -> str:
    """Render one tile per flight, model and gap, each with its text, in the colour of its verdict."""
    tiles = "".join(
        f'<span style="display:inline-block;border-left:6px solid {_choose_colour(_read_verdict(e))};'
        f'background:#f6f8f9;margin:3px 6px 3px 0;padding:3px 10px">{_render_link(e, text)}</span>'
        for e, text in entries
    )
    key = " · ".join(
        f'<span style="color:{VERDICT_COLOURS[k]}">{w}</span>'
        for k, w in (("good", "good"), ("care", "with care"), ("bad", "unusable or unexplained"))
    )
    return f'<div>{tiles}</div><p class="under">{key}</p>' if tiles else ""


def _render_rows(entries: Sequence[Mapping[str, Any]], describe: Any) -> str:
    """Render a table of entries: name with link, verdict, one sentence."""
    lines = [
        f'<tr><th scope="row">{_render_link(e, str(e["name"]))}</th>'
        f'<td style="color:{_choose_colour(_read_verdict(e))};white-space:nowrap">{frame.escape(_read_verdict(e))}</td>'
        f"<td>{frame.escape(describe(e['data']))}</td></tr>"
        for e in entries
        if "data" in e
    ]
    return f"<table><tbody>{''.join(lines)}</tbody></table>" if lines else ""


def _render_models(entries: Sequence[Mapping[str, Any]]) -> str:
    """Render the scores of all models: R2 and RMSE per axis on validation rows, else test, else training rows."""
    lines = []
    for entry in entries:
        axes = (entry.get("data") or {}).get("axes")
        if "data" not in entry or not isinstance(axes, Mapping):
            continue
        cells = "".join(f'<td class="n">{_format_score(axes.get(axis))}</td>' for axis in AXES)
        word = _read_verdict(entry)
        lines.append(
            f'<tr><th scope="row">{_render_link(entry, str(entry["name"]))}</th>'
            f'<td style="color:{_choose_colour(word)}">{frame.escape(word)}</td>{cells}</tr>'
        )
    if not lines:
        return ""
    head = "".join(f'<th class="n">{a}, {"N" if a[0] == "F" else "N m"}</th>' for a in AXES)
    note = frame.render_paragraph("RMSE and R², on validation flights (v), else test rows (t), else training rows.")
    top = f"<thead><tr><th>model</th><th>verdict</th>{head}</tr></thead>"
    return f"<table>{top}<tbody>{''.join(lines)}</tbody></table>{note}"


def _format_score(axis: object) -> str:
    scores = axis.get("scores") if isinstance(axis, Mapping) else None
    if not isinstance(scores, Mapping):
        return "–"
    for role, mark in (("validation", " v"), ("test", " t"), ("training", "")):
        one = scores.get(role)
        if isinstance(one, Mapping) and one:
            return f"{frame.format_number(one.get('rmse'))}{mark}<br>R² {frame.format_number(one.get('r2'))}"
    return "–"


def _read_gap_sentence(data: Mapping[str, Any]) -> str:
    """Read the first sentence of a diagnosis."""
    text = str(data.get("summary", ""))
    first, dot, _ = text.partition(". ")
    return first + dot.strip()


def _describe_simulation(data: Mapping[str, Any]) -> str:
    model = data.get("model")
    model = model.get("id") if isinstance(model, Mapping) else model
    ended = data.get("ended")
    parts = [f"model {model}"] if model else []
    return ", ".join([*parts, f"ended: {ended}" if ended else "flown to its end"])
