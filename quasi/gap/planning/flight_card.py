"""A plan's card: as text for the terminal, as plain data, and as one page to print."""

import math
from collections.abc import Sequence
from typing import Any

from quasi.gap.effect import Effect
from quasi.gap.planning.outlook import Row, Sight
from quasi.gap.planning.plan import Card, Proposal
from quasi.gap.report.names import name_of
from quasi.pages import frame as report

SCHEMA = "quasi.plan/2"
MORE = "What to fly as well, one of these after the trajectory in each flight"
MANY_TIMES = 5.0  # times the flights asked for: beyond, another manoeuvre is meant
HEAD = ("cause", "typical size", "expected t", "with rival", "needed", "nearest rival", "verdict")


def verdict_of(sight: Sight) -> str:
    """The verdict in words."""
    if sight.absorbed:
        return "not seen: the model absorbs it; fly reference flights"
    if sight.taken:
        return "not seen: here the model absorbs it"
    if sight.verdict == "tie":
        return f"only as a tie with {name_of(sight.rival or '')}"
    return {"seen": "would be seen", "not seen": "not seen"}[sight.verdict]


def word_of(sight: Sight) -> str:
    """The verdict in a word or two; the rival has a column of its own."""
    if sight.absorbed or sight.taken:
        return "absorbed"
    return {"seen": "seen", "tie": "tie", "not seen": "not seen"}[sight.verdict]


def size_of(effect: Effect, sight: Sight) -> str:
    """The size of the least visible parameter with its name and unit."""
    unit = effect.parameters[sight.parameter].unit
    name = "" if len(effect.parameters) == 1 else f"{sight.parameter} "
    return f"{name}{sight.size:.2g}{'' if unit == '1' else f' {unit}'}"


def _cells(row: Row) -> list[str]:
    sight = row.sight
    numbers = ["–"] * 3 if sight.absorbed else [_t(sight.t), _t(sight.with_rival), _t(sight.needed)]
    rival = name_of(sight.rival) if sight.rival and not sight.absorbed else "–"
    return [name_of(row.effect.id), size_of(row.effect, sight), *numbers, rival, verdict_of(sight)]


def _t(value: float) -> str:
    return f"{value:.1f}" if value < 99.5 else f"{value:.0f}"


def headline(card: Card) -> str:
    """One sentence: how many of the causes would be seen."""
    counts = {v: sum(r.sight.verdict == v for r in card.rows) for v in ("seen", "tie")}
    text = f"{counts['seen']} of {len(card.rows)} causes would be seen at their typical size"
    return text + (f", {counts['tie']} more only as a tie" if counts["tie"] else "")


def flown_as(card: Card) -> str:
    """What the card is about in a line."""
    what = f"{card.compared} flights of {card.seconds:.0f} s" + (
        f" and {card.reference} reference flights" if card.reference else ", no reference flights"
    )
    return f"model {card.model}; {what}: {', '.join(card.flights)}"


def steps(proposal: Proposal) -> list[str]:
    """What a manoeuvre makes of each cause, in words, the most useful first."""
    order = sorted(proposal.raises.items(), key=lambda item: -min(item[1][1].t, item[1][1].with_rival))
    lines = []
    for name, (before, after) in order:
        text = f"{name_of(name)}: t from {_t(before.t)} to {_t(after.t)}"
        if "tie" in (before.verdict, after.verdict):
            text += f", with its rival from {_t(before.with_rival)} to {_t(after.with_rival)}"
        lines.append(f"{text} ({verdict_of(after)})")
    return lines


def hopeless(card: Card) -> list[str]:
    """Causes that no manoeuvre of the library shows, and what would."""
    result = []
    for row in card.rows:
        sight = card.best.get(row.effect.id, row.sight)
        if sight.verdict == "seen" or sight.absorbed:
            continue
        reason = f"t = {_t(sight.t)} of {_t(sight.needed)} needed" if sight.verdict != "tie" else verdict_of(sight)
        count = more_flights(card, sight)
        if count is not None:
            reason += f"; about {count} flights{' of each kind' if card.reference else ''} would show it"
        if sight.taken:
            reason += "; the model absorbs it unless there are reference flights"
        result.append(f"{name_of(row.effect.id)}: {reason}; this would decide: {row.effect.tie_breaker}")
    return result


def more_flights(card: Card, sight: Sight) -> int | None:
    """How many such flights would show a cause, t growing with the root of their number; None beyond MANY_TIMES."""
    t = min(sight.t, sight.with_rival)
    share = sight.needed / t if t > 0.0 else math.inf
    if sight.verdict == "tie" or share > math.sqrt(MANY_TIMES) or t < 0.8 * sight.t:
        return None
    return max(math.ceil(card.compared * share**2), card.compared + 1)


def together(card: Card) -> str:
    """What all proposals in the same flights show; nothing where there are none."""
    if not card.proposals:
        return ""
    count = sum(r.sight.verdict == "seen" for r in card.rows) + sum(s.verdict == "seen" for s in card.after.values())
    lost = [n for n, s in card.after.items() if card.best[n].verdict == "seen" and s.verdict != "seen"]
    text = f"All of it in the same flights would show {count} of {len(card.rows)} causes."
    if lost:
        text += f" {', '.join(map(name_of, lost))}: fly the manoeuvre in flights of its own and compare those alone; "
        text += "stretches that hardly show a cause add their errors to it."
    return text


def text(card: Card) -> str:
    """The card for a terminal."""
    rows = [list(HEAD), *(_cells(r) for r in card.rows)]
    widths = [max(len(r[k]) for r in rows) for k in range(len(HEAD))]
    right = {2, 3, 4}
    lines = [f"{headline(card)}", f"({flown_as(card)}; noise: {card.noise})", ""]
    for r in rows:
        cells = [c.rjust(w) if k in right else c.ljust(w) for k, (c, w) in enumerate(zip(r, widths))]
        lines.append("  ".join(cells).rstrip())
    if card.proposals:
        lines += ["", f"{MORE}:"]
        for k, proposal in enumerate(card.proposals, 1):
            lines.append(f"{k}. {proposal.manoeuvre.name}: {proposal.manoeuvre.text}")
            lines += [f"     {step}" for step in steps(proposal)]
        lines += ["", together(card)]
    left = hopeless(card)
    if left:
        lines += ["", "No manoeuvre of the library shows:", *(f"  {line}" for line in left)]
    if card.not_asked:
        lines += ["", "Not judged:", *(f"  {name_of(n)}: {why}" for n, why in sorted(card.not_asked.items()))]
    lines += [f"note: {note}" for note in card.notes]
    return "\n".join(lines)


def data(card: Card) -> dict[str, Any]:
    """The card as plain data ("quasi.plan/2")."""
    return {
        "schema": SCHEMA,
        "model": card.model,
        "summary": headline(card),
        "flights": card.flights,
        "seconds": card.seconds,
        "compared": card.compared,
        "reference": card.reference,
        "noise": card.noise,
        "causes": [_row(r) for r in card.rows],
        "proposals": [
            {
                "manoeuvre": p.manoeuvre.name,
                "text": p.manoeuvre.text,
                "raises": {n: {"before": _sight(a), "after": _sight(b)} for n, (a, b) in p.raises.items()},
            }
            for p in card.proposals
        ],
        "with the best manoeuvre": {n: _sight(s) for n, s in card.best.items()},
        "with all proposals": {n: _sight(s) for n, s in card.after.items()},
        "not judged": [{"id": n, "why": why} for n, why in sorted(card.not_asked.items())],
        "notes": card.notes,
    }


def _row(row: Row) -> dict[str, Any]:
    unit = {n: p.unit for n, p in row.effect.parameters.items()}
    return {
        "id": row.effect.id,
        "level": row.effect.level,
        **_sight(row.sight),
        "parameters": {s.parameter: _sight(s) | {"unit": unit[s.parameter]} for s in row.all},
    }


def _sight(sight: Sight) -> dict[str, Any]:
    return {
        "parameter": sight.parameter,
        "typical": sight.size,
        "t": None if sight.absorbed else sight.t,
        "t with rival": None if sight.absorbed else sight.with_rival,
        "nearest": sight.rival,
        "needed": sight.needed if math.isfinite(sight.needed) else None,
        "verdict": verdict_of(sight),
    }


def page(card: Card) -> str:
    """The card as one HTML page."""
    proposals: Sequence[str] = [
        report.render_paragraph(f"{k}. {p.manoeuvre.name}: {p.manoeuvre.text}.") + report.render_list(steps(p))
        for k, p in enumerate(card.proposals, 1)
    ]
    about = (
        "Expected t: a cause's typical size over its standard error once the model's own terms, and what flights "
        "differ by anyway, are taken out; with rival: with the most similar other cause taken out as well. "
        f"At the t needed, nine of ten repeats of these flights would name it; absorbed: the model's own "
        "terms can replace it. "
        f"Noise: {card.noise}."
    )
    return report.render_page(
        "Flight card",
        flown_as(card),
        "Outlook",
        headline(card),
        [
            report.render_section(MORE, *proposals, report.render_paragraph(together(card)) if proposals else ""),
            report.render_section(
                "Causes",
                report.render_table(HEAD, [[*_cells(r)[:-1], word_of(r.sight)] for r in card.rows]),
                report.render_paragraph(about),
            ),
            report.render_section("No manoeuvre of the library shows", report.render_list(hopeless(card))),
            report.render_section(
                "Not judged", report.render_list(f"{name_of(n)}: {why}" for n, why in sorted(card.not_asked.items()))
            ),
            report.render_section("Notes", report.render_list(card.notes)),
        ],
    )
