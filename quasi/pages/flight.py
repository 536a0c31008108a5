"""The page of one flight: verdict, sources, losses, timing, ranges, biases; plain data to HTML."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from quasi.attitude import GRAVITY
from quasi.pages import frame
from quasi.pages.chart import Chart, render_style
from quasi.pages.filter_facts import Section, list_filter_facts, render_biases, render_innovations
from quasi.pages.flight_traces import draw_path, find_spans, make_panels

VERDICTS = ("good", "usable with care", "unusable")
MIN_VALID_SHARE = 0.3  # share of the rows; a flight with fewer valid rows calls for care
MAX_SATURATED_SHARE = 0.01  # share of the flight; more saturation calls for care
COMMAND_LOW, COMMAND_HIGH = 0.001, 0.999
MAX_LISTED_GAPS = 8
REASON_SEPARATOR = re.compile(r"; (?![^()]*\))")  # between reasons, not inside brackets
FIRST_SCREEN_PANELS = 3  # panels of the first screen
VELOCITY_KEYS = {"u", "v", "w", "u_air", "v_air", "w_air"}


def describe_unmeasured(imported: Section, filtered: Section) -> dict[str, str]:
    """Describe "velocity" and "position" that no source measured, {quantity: remark}."""
    position, velocity = (imported[f"{kind} source"] != "none" for kind in ("position", "velocity"))
    if position:
        return {}
    if filtered.get("engine") is None:  # without filtering nothing was integrated
        return {"position": "not measured"} | ({} if velocity else {"velocity": "not measured"})
    if velocity:
        return {"position": "from the velocity alone, drifts"}
    return dict.fromkeys(("position", "velocity"), "from the accelerometer alone, drifts")


def compute_ranges(
    frame: pd.DataFrame, used: np.ndarray, doubtful: Mapping[str, str] | None = None
) -> list[tuple[str, str, float, float, float]]:
    """Compute name, unit, least, median and largest of the flown quantities over the rows `used` (n,).

    doubtful  of `describe_unmeasured`
    """
    one = frame[used] if used.any() else frame
    found: list[tuple[str, str, np.ndarray]] = []

    def add(name: str, unit: str, needs: Sequence[str], of: Any) -> None:
        if set(needs) <= set(one):
            kind = "velocity" if set(needs) & VELOCITY_KEYS else "position" if "z" in needs else ""
            if doubtful and kind in doubtful:
                name = f"{name} ({doubtful[kind]})"
            found.append((name, unit, of(*(one[n].to_numpy(float) for n in needs))))

    add("speed over ground", "m/s", "uvw", lambda u, v, w: np.sqrt(u * u + v * v + w * w))
    add("speed through the air", "m/s", ["u_air", "v_air", "w_air"], lambda u, v, w: np.sqrt(u * u + v * v + w * w))
    for name, axis in (("forward", "u"), ("right", "v"), ("down", "w")):
        add(f"velocity {name} (body)", "m/s", [axis], lambda x: x)
    for name, axis in (("roll", "p"), ("pitch", "q"), ("yaw", "r")):
        add(f"{name} rate", "deg/s", [axis], np.degrees)
    add("height above the origin", "m", ["z"], lambda z: -z)
    add("tilt", "deg", ["roll", "pitch"], lambda a, b: np.degrees(np.arccos(np.clip(np.cos(a) * np.cos(b), -1, 1))))
    add("load factor", "g", ["ax", "ay", "az"], lambda x, y, z: np.sqrt(x * x + y * y + z * z) / GRAVITY)
    rotors = [c for c in one if c[0] == "w" and c[1:].isdigit()]
    add("rotor speed", "rad/s", rotors or ["w1"], lambda *w: np.concatenate(w))
    add("battery voltage", "V", ["battery_voltage"], lambda x: x)
    add("battery current", "A", ["battery_current"], lambda x: x)
    rows = []
    for name, unit, values in found:
        values = values[np.isfinite(values)]
        if len(values):
            rows.append((name, unit, float(values.min()), float(np.median(values)), float(values.max())))
    return rows


def compute_saturation(imported: pd.DataFrame, used: np.ndarray) -> dict[str, float]:
    """Compute the share of the rows `used` (n,) with a motor command at its lower or upper limit."""
    out = {}
    rows = max(int(used.sum()), 1)
    for name in [c for c in imported if c.startswith("command")]:
        value = imported[name].to_numpy(float)
        out[f"{name} at its lower limit"] = float(np.sum((value <= COMMAND_LOW) & used) / rows)
        out[f"{name} at its upper limit"] = float(np.sum((value >= COMMAND_HIGH) & used) / rows)
    return out


def derive_flight_verdict(imported: Section, filtered: Section, saturated: Mapping[str, float]) -> tuple[str, str]:
    """Derive the verdict from that of the import, lowered by filtering, its doubts and saturation; with reasons."""
    word, reasons = imported["verdict"], [imported["verdict because"]]
    doubts = list(filtered.get("doubts", []))
    valid = filtered["phases"]["valid share"]
    if filtered.get("consistent") is False and not any("not consistent" in d for d in doubts):
        doubts.append("the filter's innovations do not match its standard errors")
    if 0 < valid < MIN_VALID_SHARE:
        doubts.append(f"only {frame.format_share(valid)} of the rows are valid for identification")
    full = max((v for k, v in saturated.items() if k.endswith("upper limit")), default=0.0)
    if full > MAX_SATURATED_SHARE:
        doubts.append(f"a motor was at its upper limit in {frame.format_share(full)} of the flight")
    if doubts and word == "good":
        word = VERDICTS[1]
    if (doubts or valid == 0) and imported["verdict"] == "good":
        reasons = []
    if valid == 0:
        why = filtered["phases"].get("none valid because")
        word = "unusable"
        reasons.insert(0, "no row is valid for identification" + (f": {why}" if why else ""))
    if filtered.get("verdict") == VERDICTS[2]:  # with its contradictions and what is lacking
        word, because = VERDICTS[2], filtered["verdict because"]
        reasons, doubts = [because], [d for d in doubts if d not in because]
    return word, "; ".join([*reasons, *doubts])


def render_flight_page(
    imported: pd.DataFrame,
    imported_metadata: Section,
    filtered: pd.DataFrame,
    filtered_metadata: Section,
    pictures: Mapping[str, tuple[bytes, str]],
    spectrum: tuple[bytes, str] | None = None,
) -> str:
    """Render the page of a flight.

    imported, filtered  the flight's tables with their metadata; pictures  {heading: (PNG, caption)} in order;
    spectrum  PNG and caption of the gyro's spectrum, on the first screen of a flight whose position was not measured
    """
    m, f = imported_metadata, filtered_metadata
    flying = filtered["in_flight"].to_numpy() > 0
    saturated = compute_saturation(imported, flying)
    word, because = derive_flight_verdict(m, f, saturated)
    battery = _list_battery(filtered)
    measured = [kind for kind in ("position", "velocity") if m[f"{kind} source"] != "none"]
    spans = find_spans(imported, filtered, m)
    chart = Chart(make_panels(imported, filtered, measured), spans)
    sections = [
        render_style(),
        _render_answer(chart, draw_path(filtered, spans) if "position" in measured else "", spectrum),
        frame.render_section("Sources", frame.render_facts(_list_sources(m)), _render_streams(m)),
        frame.render_section("Losses and assumptions", _render_losses(m), frame.render_list(_shorten_notes(m))),
        frame.render_section("Clocks and delays", frame.render_facts(_list_timing(m))),
        frame.render_section(
            "Flown range",
            frame.render_facts([("rows in flight", frame.format_share(f["phases"]["in flight share"])), *battery]),
            frame.render_table(
                ("between take-off and landing", "unit", "least", "median", "largest"),
                [
                    (n, u, *frame.format_row(values))
                    for n, u, *values in compute_ranges(filtered, flying, describe_unmeasured(m, f))
                ],
            ),
            frame.render_facts(
                [
                    ("sensors at the end of their range", _describe_clipping(m["saturation"])),
                    *_list_saturation(saturated),
                ]
            ),
        ),
        frame.render_section(
            "States and biases",
            frame.render_facts(list_filter_facts(f, m["attitude source"])),
            render_biases(f),
            render_innovations(f),
            frame.render_list(f["notes"]),
        ),
        *(frame.render_section(heading, frame.render_picture(png, text)) for heading, (png, text) in pictures.items()),
        chart.script() if chart.panels else "",
    ]
    under = (
        f"{m['quadrotor']} · {m['sampling']['duration']:.1f} s at {m['sampling']['rate']:g} Hz · mass {f['mass']:g} kg"
    )
    first, *more = REASON_SEPARATOR.split(because)
    more_text = f"{'; '.join(more)}." if more else ""
    return frame.render_page(f"Flight {m['flight']}", under, word, first, sections, more_text)


def _render_answer(chart: Chart, path: str, spectrum: tuple[bytes, str] | None) -> str:
    """Render the first screen: the path or the gyro spectrum, with key traces; the other traces follow."""
    shown = frame.render_picture(*spectrum) if spectrum else ""
    numbers = range(len(chart.panels))
    side = path or shown
    if not numbers:
        return side
    first = f'<div class="answer"><div>{side}</div>{chart.place(numbers[:FIRST_SCREEN_PANELS])}</div>' if side else ""
    rest = chart.place(numbers[FIRST_SCREEN_PANELS:] if side else numbers, 2)
    return f"{chart.bar()}{first}{frame.render_section('Traces', rest)}{shown if path else ''}"


def _list_sources(m: Section) -> list[tuple[str, object]]:
    board, capture = (m["sources"].get(k) or {} for k in ("onboard", "capture"))
    wind = m.get("wind") or {}
    firmware = board.get("firmware") or {}
    poles = m.get("motor poles") or {}
    return [
        ("on-board log", board.get("path") or board.get("file")),
        ("reader", board.get("reader") or board.get("format")),
        ("firmware", ", ".join(firmware[k] for k in ("revision", "board") if firmware.get(k))),
        ("logs in the file", _describe_logs(board)),
        ("fields", _group_fields(board.get("fields") or [])),
        ("motion capture", capture.get("file")),
        ("rigid body", _describe_body(capture)),
        ("capture", _describe_capture(capture)),
        ("wind", (wind.get("record") or {}).get("path") or wind.get("source")),
        ("attitude from", m["attitude source"]),
        ("reconstructed signals", _describe_reconstructed(m.get("reconstructed") or {})),
        ("position from", m["position source"]),
        ("velocity from", m["velocity source"]),
        ("motor poles", f"{poles['value']} ({poles.get('source', '')})" if poles.get("value") else None),
        ("rest before take-off", f"{frame.format_number(m['rest before take-off']['value'])} s"),
    ]


def _describe_reconstructed(entries: Mapping[str, Mapping[str, Any]]) -> str:
    """Describe signals that import reconstructed: source, bandwidth, standard error."""
    return "; ".join(
        f"{' and '.join(about.get('angles', [name]))} from {about['from']}, up to "
        f"{frame.format_number(about['bandwidth']['value'])} Hz, ± {frame.format_number(about['std']['value'])} "
        f"{about['std']['unit']}"
        for name, about in entries.items()
    )


def _group_fields(names: Sequence[str]) -> str:
    """Group numbered field names: motor[0..3]."""
    last: dict[str, list[str]] = {}
    for name in map(str, names):
        base, bracket, index = name.partition("[")
        last.setdefault(base if bracket else name, []).append(index.rstrip("]"))
    return ", ".join(
        base if i == [""] else f"{base}[{i[0]}]" if len(i) == 1 else f"{base}[{i[0]}..{i[-1]}]"
        for base, i in last.items()
    )


def _shorten_notes(m: Section) -> list[str]:
    """Shorten paths in the notes of the import to file names; the page shows the paths above."""
    paths = [str(s.get(k)) for s in m["sources"].values() for k in ("path", "file") if s.get(k)]
    notes = list(m["notes"])
    for path in paths:
        notes = [note.replace(path, path.rsplit("/", 1)[-1]) for note in notes]
    return notes


def _describe_logs(board: Section) -> str | None:
    logs = board.get("logs") or []
    if not logs:
        return None
    listed = "; ".join(
        f"{log['number']}: {frame.format_number(log.get('duration'))} s"
        + (f" ({log['fault']})" if log.get("fault") else "")
        for log in logs[:20]
    )
    more = f" and {len(logs) - 20} more" if len(logs) > 20 else ""
    return f"{len(logs)}; number {board.get('log')} was read" + (f" — {listed}{more}" if len(logs) > 1 else "")


def _describe_body(capture: Section) -> str | None:
    if not capture.get("rigid body"):
        return None
    others = [b for b in capture.get("rigid bodies", []) if b != capture["rigid body"]]
    return capture["rigid body"] + (f" (also in the take: {', '.join(others)})" if others else "")


def _describe_capture(capture: Section) -> str | None:
    if not capture.get("frames"):
        return None
    parts = [
        f"{capture['frames']} frames at {frame.format_number(capture.get('export rate'), 4)} Hz",
        f"format version {capture.get('format version')}",
        f"rotation {capture.get('rotation')}",
        f"lengths in {str(capture.get('length unit', '')).lower()}",
    ]
    return ", ".join(parts)


def _render_streams(m: Section) -> str:
    rows = [
        (
            name, s["samples"], frame.format_number(s["rate"], 4), frame.format_number(1e3 * s["jitter"], 2),
            s["gap count"], frame.format_number(s["lost"], 3),
        )
        for name, s in (m.get("streams") or {}).items()
    ]  # fmt: skip
    return frame.render_table(("source", "samples", "rate, Hz", "jitter, ms", "gaps", "in gaps, s"), rows)


def _render_losses(m: Section) -> str:
    board, capture = (m["sources"].get(k) or {} for k in ("onboard", "capture"))
    spans = board.get("corrupt spans") or []
    text = [f"{s['start']:.3f} to {s['end']:.3f} s ({s.get('bytes', 0)} bytes)" for s in spans[:20]]
    rows: list[tuple[str, object]] = [("damaged parts of the log", "; ".join(text) if spans else None)]
    alike: dict[str, list[str]] = {}
    for name, s in (m.get("streams") or {}).items():
        if s["gap count"]:
            longest = sorted(s["gaps"], key=lambda g: g[0] - g[1])[:MAX_LISTED_GAPS]
            listed = ", ".join(f"{a:.2f} to {b:.2f}" for a, b in sorted(longest)).replace("-", "−")
            all_of_them = "at" if s["gap count"] <= len(longest) else "the longest at"
            alike.setdefault(f"{s['gap count']}, {all_of_them} {listed} s", []).append(name)
    rows += [(f"gaps of {', '.join(names)}", text) for text, names in alike.items()]
    if capture.get("frames"):
        rows += [
            ("frames without the body", f"{capture['frames lost']} of {capture['frames']}"),
            ("frames with a repeated pose", f"{capture['frames held']} of {capture['frames']}"),
            ("frames removed as outliers", f"{capture['frames removed']} of {capture['frames']}"),
            ("corrected quaternion sign flips", capture.get("quaternion sign flips")),
        ]
    return frame.render_facts(rows) or frame.render_paragraph("Nothing was lost.")


def _list_timing(m: Section) -> list[tuple[str, object]]:
    sync = m.get("synchronisation")
    rows: list[tuple[str, object]] = []
    if sync:
        lag, rate = sync["lag"], sync["clock rate"]
        rows += [
            ("lag of the capture", frame.format_with_error(lag["value"], lag["std"], "ms", 1e3)),
            (
                "clock rate",
                frame.format_with_error(rate["value"], rate["std"], "ppm", 1e6) if rate["std"] else "not estimated",
            ),
            ("estimated by", f"{sync['method']}, over {sync['common span']['value']:.1f} s"),
            (
                "explained variance",
                ", ".join(f"{k}: {frame.format_share(v)}" for k, v in sync["explained variance"].items()),
            ),
            ("heading offset", f"{frame.format_number(math.degrees(sync['yaw offset']['value']))} deg"),
        ]
    for name, c in m["corrections"].items():
        if name.endswith("delay") and c and c["filters"]:
            rows.append(
                (
                    name,
                    f"{frame.format_with_error(c['value'], c.get('std'), 'ms', 1e3)} corrected "
                    f"({', '.join(c['filters'])})",
                )
            )
        elif name.endswith("delay") and c and not c.get("known", True):
            rows.append((name, f"unknown, assumed {frame.format_with_error(c['value'], c['std'], 'ms', 1e3)}"))
        elif name == "imu position" and c:
            rows.append(("IMU position", f"{c['value']} m, corrected"))
    for part, quantities in (m.get("sensor calibration") or {}).items():
        rows += [(f"{name} of the {part}", f"{value}, as configured, corrected") for name, value in quantities.items()]
    rotors = m.get("rotor telemetry")
    if rotors and rotors.get("age"):
        age = rotors["age"]
        done = "corrected" if rotors.get("applied") else "not corrected"
        rows.append(
            ("delay of rotor telemetry", f"{frame.format_with_error(age['value'], age['std'], 'ms', 1e3)}, {done}")
        )
    return rows


def _list_battery(filtered: pd.DataFrame) -> list[tuple[str, object]]:
    if "battery_voltage" not in filtered:
        return []
    t, volts = filtered["t"].to_numpy(), filtered["battery_voltage"].to_numpy(float)
    fine = np.isfinite(volts)
    if not fine.any():
        return []
    first, last = (float(np.median(volts[fine & part])) for part in (t <= t[fine][0] + 1, t >= t[fine][-1] - 1))
    return [("battery, first and last second", f"{first:.2f} V to {last:.2f} V")]


def _describe_clipping(facts: Section) -> str:
    each = [
        f"{key.split(' ')[0]} at {frame.format_number(one['level']['value'])} {one['level']['unit']} for "
        f"{frame.format_number(one['seconds'], 2)} s in {one['span count']} spans"
        for key, one in facts.items()
    ]
    return ", ".join(each) or "never"


def _list_saturation(shares: Mapping[str, float]) -> list[tuple[str, object]]:
    rows: list[tuple[str, object]] = []
    for end in ("lower limit", "upper limit"):
        found = {k: v for k, v in shares.items() if end in k}
        if found:
            each = ", ".join(f"{k.split(' at ')[0]} {frame.format_share(v)}" for k, v in found.items() if v)
            rows.append((f"motor command at its {end}", each if any(found.values()) else "never"))
    return rows
