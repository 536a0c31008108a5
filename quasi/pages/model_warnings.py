"""Warnings of a model by kind, collapsed, each kind with a remedy."""

import re
from collections.abc import Iterable

from quasi.pages import frame
from quasi.pages.terms import show_expression

# text in a warning, its kind, its remedy
WARNING_KINDS = (
    (
        "without the data noticing",
        "Terms that another term could replace",
        "Predict with the whole model. Give a single term a physical meaning only after flights that separate the "
        "rivals: other speeds, climbs, or rotor speeds.",
    ),
    (
        "% as well; the data hardly",
        "Close decisions of the stepwise search",
        "Keep the model if its validation is good. To decide between them, add flights or remove one candidate.",
    ),
    (
        "times what it would be alone",
        "Coefficients that are correlated (variance inflation above 10)",
        "Read the sum of the named terms. Add flights in which they vary independently, or remove one candidate.",
    ),
    (
        "from zero, the residuals' memory counted",
        "Terms that are not significant",
        "Remove them from the candidates, or add flights that excite them.",
    ),
    (
        "do not read physics into it",
        "Terms that resamples seldom select",
        "Lower 'regressor cap', or add training flights.",
    ),
    (
        "nearly interchangeable",
        "An ill-conditioned regression",
        "Remove candidates that describe the same effect.",
    ),
    (
        "rotors' delay",
        "Rotor delay",
        "Use the delay in simulations with care; log rotor speeds with their own time stamps, or at a higher rate.",
    ),
)  # fmt: skip
OTHER_WARNINGS = ("Other warnings", "Read each one; it names its subject.")
_TERM = re.compile(
    r"\((?:[^(),;]|\((?:[^(),;]|\([^(),;]*\))*\))*\)(?:\*\((?:[^(),;]|\((?:[^(),;]|\([^(),;]*\))*\))*\))*"
)


def show_warnings(notes: Iterable[str]) -> str:
    """Render one collapsed list per kind of warning, with its remedy; nothing without warnings."""
    groups: dict[tuple[str, str], list[str]] = {}
    for note in notes:
        kind = next(((title, todo) for mark, title, todo in WARNING_KINDS if mark in note), OTHER_WARNINGS)
        groups.setdefault(kind, []).append(show_terms(note))
    order = [*((title, todo) for _, title, todo in WARNING_KINDS), OTHER_WARNINGS]
    return "".join(
        frame.render_details(
            f"{kind[0]} ({len(groups[kind])})",
            frame.render_paragraph(f"What to do: {kind[1]}") + frame.render_list(groups[kind]),
        )
        for kind in order
        if kind in groups
    )


def show_terms(note: str) -> str:
    """Format the terms of a warning by `show_expression`."""
    return _TERM.sub(
        lambda found: show_expression(found[0]) if re.search(r"[a-z_]\w*\^|\)\*\(|\^\(", found[0]) else found[0], note
    )
