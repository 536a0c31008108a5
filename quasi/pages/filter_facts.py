"""Facts of the filter on the page of a flight: noise, notches, biases and innovations."""

import math
from collections.abc import Mapping
from typing import Any

from quasi.pages import frame

Section = Mapping[str, Any]  # of the metadata of a flight


def list_filter_facts(f: Section, source: str) -> list[tuple[str, object]]:
    """List facts of the filter. source  of the attitude; an attitude from the IMU has no axes of its own"""
    of = {"capture": "capture's", "onboard": "on-board attitude's"}.get(source)
    turned = (f.get("attitude alignment") or {}) if of else {}
    angles = [
        f"{a} {frame.format_with_error(turned[a]['value'], turned[a]['std'], 'deg', math.degrees(1))}"
        for a in ("roll", "pitch", "yaw")
        if a in turned
    ]
    point = f.get("captured point") or {}
    lever = [f"{a} {frame.format_with_error(x['value'], x['std'], 'mm', 1e3)}" for a, x in point.items()]
    phases = f["phases"]
    rest = phases.get("rest")
    return [
        ("rows valid for identification", frame.format_share(phases["valid share"])),
        (
            "take-off",
            "not found"
            if phases.get("take-off") is None
            else f"{phases['take-off']:.2f} s"
            if phases["take-off"] > 0.0
            else "before the record begins",
        ),
        ("rest used", f"{rest[0]:.2f} to {rest[1]:.2f} s" if rest else "none"),
        ("biases by", (f.get("biases") or {}).get("policy")),
        (f"{of} axes on the body's", ", ".join(angles)),
        ("captured point from where the IMU has it", ", ".join(lever)),
        ("low-pass", f"{f['filters']['low-pass cutoff Hz']:g} Hz"),
        ("notches at the rotors' harmonics", _describe_notches(f["filters"].get("rotor notches"))),
    ]


def _describe_notches(about: Section | None) -> str | None:
    if not about:
        return None
    lines = [
        f"{line['harmonic']} ({line['frequency']['value']:.0f} Hz"
        + (f", aliased to {line['stands at']['value']:.0f} Hz" if line["folded share"] > 0.5 else "")
        + f", in {frame.format_share(line['taken out share'])} of the flight)"
        for line in about["lines"]
        if line["taken out share"] > 0
    ]
    return ", ".join(lines) or "none needed"


def render_biases(f: Section) -> str:
    rows = []
    for key, axes, scale, unit in (
        ("gyro", ("p", "q", "r"), math.degrees(1), "deg/s"),
        ("accelerometer", ("ax", "ay", "az"), 1.0, "m/s²"),
    ):
        bias = (f.get("biases") or {}).get(key)
        if bias and bias.get("value"):
            text = [
                frame.format_with_error(v, s, "", scale) for v, s in zip(bias["value"], bias.get("std") or [None] * 3)
            ]
            rows.append((f"bias of {key} ({', '.join(axes)}), {unit}", *text))
    return frame.render_table(("± standard error", "x", "y", "z"), rows)


def render_innovations(f: Section) -> str:
    rows = [
        (
            f"innovations of {kind}", n["measurements"], frame.format_number(n["mean"]),
            " to ".join(map(frame.format_number, n["bounds"])), frame.format_share(n["gated"]),
            frame.format_number(n["whiteness"], 2),
        )
        for kind, n in (f.get("NIS") or {}).items()
        if n and n.get("mean") is not None
    ]  # fmt: skip
    head = ("", "measurements", "NIS (1 if consistent)", "95 % bounds if white", "gated", "autocorrelation")
    return frame.render_table(head, rows)
