"""The index page of a project folder: flights with verdicts, models side by side, gaps and simulations, all linked.

It shows what stands in the folder and makes nothing. An artifact that cannot be read is listed with the reason.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from quasi.errors import QuasiError
from quasi.pages import frame
from quasi.tables import read_json, write_text

TARGET = "results/index.html"
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
MARKS = {"good": "#1e7d46", "care": "#a86200", "bad": "#b3261e", "": "#5b6770"}
# kind: where its summaries stand, and the page of each, from the names that the stars stand for
KINDS = {
    "flights": ("results/parts/filtering/*/*/verdict.json", "results/reports/{0}/{1}.html"),
    "models": ("models/*/standalone/summary.json", "models/{0}/standalone/report.html"),
    "simulations": ("results/simulations/*/summary.json", "results/simulations/{0}"),
    "gaps": ("results/gaps/*/diagnosis.json", "results/gaps/{0}/report.html"),
}


def list_sources(root: str | Path) -> list[str]:
    """Absolute paths of the files that the index is made from: as such no rule of the workflow makes them."""
    place = Path(root).absolute()
    return sorted(str(path) for pattern, _ in KINDS.values() for path in place.glob(pattern))


def collect(root: str | Path) -> dict[str, list[dict[str, Any]]]:
    """What stands in a project folder: {kind: entries with "name", "link", "file" and "data" or "fault"}.

    link  relative to results/, None where the page is absent
    """
    found: dict[str, list[dict[str, Any]]] = {}
    for kind, (pattern, target) in KINDS.items():
        stars = [k for k, part in enumerate(Path(pattern).parts) if part == "*"]
        for path in sorted(Path(root).glob(pattern)):
            place = path.relative_to(root)
            names = [place.parts[k] for k in stars]
            page = Path(target.format(*names))
            entry: dict[str, Any] = {"name": " ".join(names), "file": place.as_posix(), "link": None}
            if (Path(root) / page).exists():
                entry["link"] = page.relative_to("results").as_posix() if page.parts[0] == "results" else f"../{page}"
            try:
                data = read_json(path)
                entry |= {"data": data} if isinstance(data, dict) else {"fault": "expected an object"}
            except (QuasiError, OSError, ValueError) as fault:
                entry["fault"] = str(fault)
            found.setdefault(kind, []).append(entry)
    return found


def page(found: Mapping[str, Sequence[Mapping[str, Any]]], folder: str) -> str:
    """The index page as HTML. found  of `collect`; folder  the name of the project folder"""
    flights, models = list(found.get("flights", ())), list(found.get("models", ()))
    gaps, simulations = list(found.get("gaps", ())), list(found.get("simulations", ()))
    counts = Counter(_word(entry) for entry in flights)
    parts = [
        _count(len(flights), "flight") + (f" ({', '.join(f'{n} {w}' for w, n in counts.items())})" if counts else "")
    ]
    parts += [_count(len(models), "model"), _count(len(simulations), "simulation"), _count(len(gaps), "gap")]
    faulty = [e for entries in found.values() for e in entries if "fault" in e]
    sections = [
        _tiles([*flights, *models, *gaps]),
        frame.section("Models", _models(models)),
        frame.section("Gaps", _rows(gaps, _gap_sentence)),
        frame.section("Flights", _rows(flights, lambda data: str(data.get("because", "")))),
        frame.section("Simulations", _rows(simulations, _simulation_sentence)),
        frame.section("Could not be read", frame.sentences(f"{e['file']}: {e['fault']}" for e in faulty)),
    ]
    worst = next((w for w in ("unusable", "unexplained", "usable with care") if any(map(w.__eq__, counts))), "good")
    return frame.page(f"Project {folder}", "what stands in the folder", worst if flights else "nothing judged",
                      ", ".join(parts), sections)  # fmt: skip


def write_index(root: str | Path, target: str | Path) -> None:
    """Read the summaries that stand in a project folder; write its index page."""
    write_text(target, page(collect(root), Path(root).absolute().name))


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def _word(entry: Mapping[str, Any]) -> str:
    """The verdict of an entry; "not judged" where it has none."""
    word = (entry.get("data") or {}).get("verdict")
    return word if isinstance(word, str) and word else "not judged"


def _linked(entry: Mapping[str, Any], text: str) -> str:
    shown = frame.escape(text)
    link = entry.get("link")
    return f'<a href="{frame.escape(quote(str(link)))}">{shown}</a>' if link else shown


def _colour(word: str) -> str:
    return MARKS[frame.KINDS.get(word, "")]


def _tiles(entries: Sequence[Mapping[str, Any]]) -> str:
    """One tile per flight, model and gap, in the colour of its verdict."""
    tiles = "".join(
        f'<span style="display:inline-block;border-left:6px solid {_colour(_word(e))};background:#f6f8f9;'
        f'margin:3px 6px 3px 0;padding:3px 10px">{_linked(e, str(e["name"]))}</span>'
        for e in entries
    )
    key = " · ".join(
        f'<span style="color:{MARKS[k]}">{w}</span>'
        for k, w in (("good", "good"), ("care", "with care"), ("bad", "unusable or unexplained"))
    )
    return f'<div>{tiles}</div><p class="under">{key}</p>' if tiles else ""


def _rows(entries: Sequence[Mapping[str, Any]], describe: Any) -> str:
    """A table of entries: name with link, verdict, one sentence."""
    lines = [
        f'<tr><th scope="row">{_linked(e, str(e["name"]))}</th>'
        f'<td style="color:{_colour(_word(e))};white-space:nowrap">{frame.escape(_word(e))}</td>'
        f"<td>{frame.escape(describe(e['data']))}</td></tr>"
        for e in entries
        if "data" in e
    ]
    return f"<table><tbody>{''.join(lines)}</tbody></table>" if lines else ""


def _models(entries: Sequence[Mapping[str, Any]]) -> str:
    """Scores of all models side by side: R2 and RMSE per axis on validation rows, else test, else training rows."""
    lines = []
    for entry in entries:
        axes = (entry.get("data") or {}).get("axes")
        if "data" not in entry or not isinstance(axes, Mapping):
            continue
        cells = "".join(f'<td class="n">{_score(axes.get(axis))}</td>' for axis in AXES)
        word = _word(entry)
        lines.append(
            f'<tr><th scope="row">{_linked(entry, str(entry["name"]))}</th>'
            f'<td style="color:{_colour(word)}">{frame.escape(word)}</td>{cells}</tr>'
        )
    if not lines:
        return ""
    head = "".join(f'<th class="n">{a}, {"N" if a[0] == "F" else "N m"}</th>' for a in AXES)
    note = frame.paragraph("RMSE and R², on validation flights (v), else test rows (t), else training rows.")
    top = f"<thead><tr><th>model</th><th>verdict</th>{head}</tr></thead>"
    return f"<table>{top}<tbody>{''.join(lines)}</tbody></table>{note}"


def _score(axis: object) -> str:
    scores = axis.get("scores") if isinstance(axis, Mapping) else None
    if not isinstance(scores, Mapping):
        return "–"
    for role, mark in (("validation", " v"), ("test", " t"), ("training", "")):
        one = scores.get(role)
        if isinstance(one, Mapping) and one:
            return f"{frame.number(one.get('rmse'))}{mark}<br>R² {frame.number(one.get('r2'))}"
    return "–"


def _gap_sentence(data: Mapping[str, Any]) -> str:
    """The first sentence of a diagnosis."""
    text = str(data.get("summary", ""))
    first, dot, _ = text.partition(". ")
    return first + dot.strip()


def _simulation_sentence(data: Mapping[str, Any]) -> str:
    model = data.get("model")
    model = model.get("id") if isinstance(model, Mapping) else model
    ended = data.get("ended")
    parts = [f"model {model}"] if model else []
    return ", ".join([*parts, f"ended: {ended}" if ended else "flown to its end"])
