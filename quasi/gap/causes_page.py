"""The catalogue of causes in words: what each is, its parameters, what it is taken for and what distinguishes it."""

import textwrap
from collections.abc import Mapping

from quasi.gap.effect import SCOPES, Effect, Parameter, Vehicle

LEVEL_HEADINGS = {
    "sensors": "Sensors, mounting, frames and clocks",
    "drive": "Rotor drive",
    "forces": "Forces and moments",
}
FINDINGS = "Findings: stated, never named as a cause"
LINE_WIDTH = 120


def text(effects: Mapping[str, Effect], vehicle: Vehicle, whose: str) -> str:
    """All causes in Markdown, by level. vehicle, whose  of which the typical sizes are given"""
    about = (
        'Which causes can a gap name? They are listed by the ids that `"effects"` takes. `quasi causes MODEL` prints '
        f"this page with the sizes typical of your own vehicle; here they are those of {whose}. A typical size is what "
        "a flight should be able to show: hide and seek draws around it, the flight card uses it. A parameter without "
        "one only accompanies others. Scopes: a parameter belongs to the airframe, to a session, or to a single flight."
    )
    lines = ["# Causes", "", *textwrap.wrap(about, LINE_WIDTH)]
    for level, title in LEVEL_HEADINGS.items():
        lines += ["", f"## {title}"]
        for effect in effects.values():
            if effect.level == level and not effect.finding:
                lines += _entry(effect, vehicle)
    lines += ["", f"## {FINDINGS}"]
    for effect in effects.values():
        if effect.finding:
            lines += _entry(effect, vehicle)
    return "\n".join(lines) + "\n"


def _entry(effect: Effect, vehicle: Vehicle) -> list[str]:
    lines = ["", f"### {effect.id}", "", f"{effect.sentence[:1].upper()}{effect.sentence[1:]}.", ""]
    lines.append(f"- `{effect.equation}` ({effect.source})")
    groups: dict[str, list[str]] = {}
    for name, parameter in effect.parameters.items():
        groups.setdefault(_describe_parameter(parameter, vehicle), []).append(f"`{name}`")
    lines += [f"- {', '.join(names)}{about}" for about, names in groups.items()]
    if effect.reported:
        nothing = dict.fromkeys(effect.parameters, 0.0)
        names = [f"`{name}` in {size.unit}" for name, size in effect.reported(nothing, nothing).items()]
        lines.append(f"- reported as {' and '.join(names)}")
    if effect.channels:
        lines.append(f"- shows in {', '.join(effect.channels)}")
    if effect.rivals:
        apart = f"; distinguished by: {effect.tie_breaker}" if effect.tie_breaker else ""
        lines.append(f"- may be taken for {', '.join(effect.rivals)}{apart}")
    return lines


def _describe_parameter(parameter: Parameter, vehicle: Vehicle) -> str:
    unit = "" if parameter.unit in ("", "1") else f" {parameter.unit}"
    typical = parameter.typical(vehicle) if callable(parameter.typical) else parameter.typical
    about = f"{f', {parameter.unit}' if unit else ''}, of the {SCOPES[parameter.scope]}"
    if typical is None:
        return about
    if parameter.neutral is None:
        return f"{about}: typically {typical:.3g}{unit} off"
    return f"{about}: {parameter.neutral:g} where nothing is wrong, typically {typical:.3g}{unit} off"
