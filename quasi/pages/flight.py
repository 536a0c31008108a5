"""What the page of one flight says: verdict, what was read and lost, timing, ranges, biases; plain data to HTML."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from quasi.attitude import GRAVITY
from quasi.pages import frame
from quasi.pages.chart import Chart, style
from quasi.pages.flight_traces import draw_path, find_spans, make_panels

ORDER = ("good", "usable with care", "unusable")
LEAST_VALID = 0.3  # share of the rows below which a flight teaches little
SATURATED = 0.01  # share of the flight in saturation that calls for care
COMMAND_LOW, COMMAND_HIGH = 0.001, 0.999
MOST_GAPS = 8
REASONS = re.compile(r"; (?![^()]*\))")  # between reasons, not inside brackets
FIRST = 3  # panels of the first screen
MOVING = {"u", "v", "w", "u_air", "v_air", "w_air"}
Section = Mapping[str, Any]


def unmeasured(imported: Section, filtered: Section) -> dict[str, str]:
    """{"velocity", "position": what to say beside values of it that no source measured}."""
    position, velocity = (imported[f"{kind} source"] != "none" for kind in ("position", "velocity"))
    if position:
        return {}
    if filtered.get("engine") is None:  # nothing was integrated either
        return {"position": "not measured"} | ({} if velocity else {"velocity": "not measured"})
    if velocity:
        return {"position": "from the velocity alone, drifts"}
    return dict.fromkeys(("position", "velocity"), "from the accelerometer alone, drifts")


def ranges(
    frame: pd.DataFrame, used: np.ndarray, doubtful: Mapping[str, str] | None = None
) -> list[tuple[str, str, float, float, float]]:
    """Name, unit, least, median and largest of what was flown, over the rows `used` (n,).

    doubtful  of `unmeasured`
    """
    one = frame[used] if used.any() else frame
    found: list[tuple[str, str, np.ndarray]] = []

    def add(name: str, unit: str, needs: Sequence[str], of: Any) -> None:
        if set(needs) <= set(one):
            kind = "velocity" if set(needs) & MOVING else "position" if "z" in needs else ""
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


def saturation(imported: pd.DataFrame, used: np.ndarray) -> dict[str, float]:
    """Share of the rows `used` (n,) in which a motor command is at its lower or upper limit."""
    out = {}
    rows = max(int(used.sum()), 1)
    for name in [c for c in imported if c.startswith("command")]:
        value = imported[name].to_numpy(float)
        out[f"{name} at its lower limit"] = float(np.sum((value <= COMMAND_LOW) & used) / rows)
        out[f"{name} at its upper limit"] = float(np.sum((value >= COMMAND_HIGH) & used) / rows)
    return out


def verdict(imported: Section, filtered: Section, saturated: Mapping[str, float]) -> tuple[str, str]:
    """The import's verdict, made worse by what filtering, its doubts and the motors say; and the reasons."""
    word, reasons = imported["verdict"], [imported["verdict because"]]
    doubts = list(filtered.get("doubts", []))
    valid = filtered["phases"]["valid share"]
    if filtered.get("consistent") is False and not any("not consistent" in d for d in doubts):
        doubts.append("the filter's innovations are larger or smaller than its own standard errors say")
    if 0 < valid < LEAST_VALID:
        doubts.append(f"only {frame.share(valid)} of the rows are valid for identification")
    full = max((v for k, v in saturated.items() if k.endswith("upper limit")), default=0.0)
    if full > SATURATED:
        doubts.append(f"a motor was at its upper limit in {frame.share(full)} of the flight")
    if doubts and word == "good":
        word = ORDER[1]
    if (doubts or valid == 0) and imported["verdict"] == "good":
        reasons = []
    if valid == 0:
        why = filtered["phases"].get("none valid because")
        word = "unusable"
        reasons.insert(0, "no row is valid for identification" + (f": {why}" if why else ""))
    if filtered.get("verdict") == ORDER[2]:  # with its contradictions and what is lacking
        word, because = ORDER[2], filtered["verdict because"]
        reasons, doubts = [because], [d for d in doubts if d not in because]
    return word, "; ".join([*reasons, *doubts])


def page(
    imported: pd.DataFrame,
    imported_metadata: Section,
    filtered: pd.DataFrame,
    filtered_metadata: Section,
    pictures: Mapping[str, tuple[bytes, str]],
    spectrum: tuple[bytes, str] | None = None,
) -> str:
    """The page of a flight.

    imported, filtered  the flight's tables with their metadata; pictures  {heading: (PNG, caption)} in order;
    spectrum  PNG and caption of the gyro's spectrum, on the first screen of a flight whose position was not measured
    """
    m, f = imported_metadata, filtered_metadata
    flying = filtered["in_flight"].to_numpy() > 0
    saturated = saturation(imported, flying)
    word, because = verdict(m, f, saturated)
    battery = _battery(filtered)
    measured = [kind for kind in ("position", "velocity") if m[f"{kind} source"] != "none"]
    spans = find_spans(imported, filtered, m)
    chart = Chart(make_panels(imported, filtered, measured), spans)
    sections = [
        style(),
        _answer(chart, draw_path(filtered, spans) if "position" in measured else "", spectrum),
        frame.section("What was read", frame.facts(_read(m)), _streams(m)),
        frame.section("What was lost or assumed", _lost(m), frame.sentences(_notes(m))),
        frame.section("Clocks and delays", frame.facts(_timing(m))),
        frame.section(
            "What was flown",
            frame.facts([("rows in flight", frame.share(f["phases"]["in flight share"])), *battery]),
            frame.table(
                ("between take-off and landing", "unit", "least", "median", "largest"),
                [(n, u, *frame.row_of(values)) for n, u, *values in ranges(filtered, flying, unmeasured(m, f))],
            ),
            frame.facts(
                [("sensors at the end of their range", _clipped(m.get("saturation"))), *_saturation(saturated)]
            ),
        ),
        frame.section(
            "States and biases",
            frame.facts(_filter(f, m["attitude source"])),
            _biases(f),
            _innovations(f),
            frame.sentences(f["notes"]),
        ),
        *(frame.section(heading, frame.picture(png, said)) for heading, (png, said) in pictures.items()),
        chart.script() if chart.panels else "",
    ]
    under = (
        f"{m['quadrotor']} · {m['sampling']['duration']:.1f} s at {m['sampling']['rate']:g} Hz · mass {f['mass']:g} kg"
    )
    first, *more = REASONS.split(because)
    more_text = f"{'; '.join(more)}." if more else ""
    return frame.page(f"Flight {m['flight']}", under, word, first, sections, more_text)


def _answer(chart: Chart, path: str, spectrum: tuple[bytes, str] | None) -> str:
    """The first screen: the path, or else the gyro's spectrum, beside key traces; the other traces follow."""
    shown = frame.picture(*spectrum) if spectrum else ""
    numbers = range(len(chart.panels))
    side = path or shown
    if not numbers:
        return side
    first = f'<div class="answer"><div>{side}</div>{chart.place(numbers[:FIRST])}</div>' if side else ""
    rest = chart.place(numbers[FIRST:] if side else numbers, 2)
    return f"{chart.bar()}{first}{frame.section('Traces', rest)}{shown if path else ''}"


def _read(m: Section) -> list[tuple[str, object]]:
    board, capture, wind = (m["sources"].get(k) or {} for k in ("onboard", "capture", "wind"))
    firmware = board.get("firmware") or {}
    firmware = firmware.get("revision") if isinstance(firmware, Mapping) else firmware
    board_name = (board.get("firmware") or {}).get("board") if isinstance(board.get("firmware"), Mapping) else None
    poles = m.get("motor poles") or {}
    return [
        ("on-board log", board.get("path") or board.get("file")),
        ("reader", board.get("reader") or board.get("format")),
        ("firmware", ", ".join(t for t in (firmware, board_name) if t)),
        ("logs in the file", _logs(board)),
        ("fields", _fields(board.get("fields") or [])),
        ("motion capture", capture.get("file") or capture.get("path")),
        ("rigid body", _body(capture)),
        ("capture", _capture(capture)),
        ("wind", wind.get("path") or wind.get("file")),
        ("attitude from", m["attitude source"]),
        ("made from other signals", _made(m.get("reconstructed") or {})),
        ("position from", m["position source"]),
        ("velocity from", m["velocity source"]),
        ("motor poles", f"{poles['value']} ({poles.get('source', '')})" if poles.get("value") else None),
        ("rest before take-off", f"{frame.number(m['rest before take-off']['value'])} s"),
    ]


def _made(entries: Mapping[str, Mapping[str, Any]]) -> str:
    """What the log lacks and import made: of what, up to which frequency, how well."""
    return "; ".join(
        f"{' and '.join(about.get('angles', [name]))} from {about['from']}, up to "
        f"{frame.number(about['bandwidth']['value'])} Hz, ± {frame.number(about['std']['value'])} "
        f"{about['std']['unit']}"
        for name, about in entries.items()
    )


def _fields(names: Sequence[str]) -> str:
    """Field names with numbered ones put together: motor[0..3]."""
    last: dict[str, list[str]] = {}
    for name in map(str, names):
        base, bracket, index = name.partition("[")
        last.setdefault(base if bracket else name, []).append(index.rstrip("]"))
    return ", ".join(
        base if i == [""] else f"{base}[{i[0]}]" if len(i) == 1 else f"{base}[{i[0]}..{i[-1]}]"
        for base, i in last.items()
    )


def _notes(m: Section) -> list[str]:
    """The import's sentences, with the files' names in place of their whole paths, which stand above."""
    paths = [str(s.get(k)) for s in m["sources"].values() for k in ("path", "file") if s.get(k)]
    told = list(m["notes"])
    for path in paths:
        told = [note.replace(path, path.rsplit("/", 1)[-1]) for note in told]
    return told


def _logs(board: Section) -> str | None:
    logs = board.get("logs") or []
    if not logs:
        return None
    listed = "; ".join(
        f"{log['number']}: {frame.number(log.get('duration'))} s" + (f" ({log['fault']})" if log.get("fault") else "")
        for log in logs[:20]
    )
    more = f" and {len(logs) - 20} more" if len(logs) > 20 else ""
    return f"{len(logs)}; number {board.get('log')} was read" + (f" — {listed}{more}" if len(logs) > 1 else "")


def _body(capture: Section) -> str | None:
    if not capture.get("rigid body"):
        return None
    others = [b for b in capture.get("rigid bodies", []) if b != capture["rigid body"]]
    return capture["rigid body"] + (f" (also in the take: {', '.join(others)})" if others else "")


def _capture(capture: Section) -> str | None:
    if not capture.get("frames"):
        return None
    parts = [
        f"{capture['frames']} frames at {frame.number(capture.get('export rate'), 4)} Hz",
        f"format version {capture.get('format version')}",
        f"rotation {capture.get('rotation')}",
        f"lengths in {str(capture.get('length unit', '')).lower()}",
    ]
    return ", ".join(parts)


def _streams(m: Section) -> str:
    rows = [
        (
            name, s["samples"], frame.number(s["rate"], 4), frame.number(1e3 * s["jitter"], 2), s["gap count"],
            frame.number(s["lost"], 3),
        )
        for name, s in (m.get("streams") or {}).items()
    ]  # fmt: skip
    return frame.table(("source", "samples", "rate, Hz", "jitter, ms", "gaps", "in gaps, s"), rows)


def _lost(m: Section) -> str:
    board, capture = (m["sources"].get(k) or {} for k in ("onboard", "capture"))
    spans = board.get("corrupt spans") or []
    said = [f"{s['start']:.3f} to {s['end']:.3f} s ({s.get('bytes', 0)} bytes)" for s in spans[:20]]
    rows: list[tuple[str, object]] = [("damaged stretches of the log", "; ".join(said) if spans else None)]
    alike: dict[str, list[str]] = {}
    for name, s in (m.get("streams") or {}).items():
        if s["gap count"]:
            longest = sorted(s["gaps"], key=lambda g: g[0] - g[1])[:MOST_GAPS]
            listed = ", ".join(f"{a:.2f} to {b:.2f}" for a, b in sorted(longest)).replace("-", "−")
            all_of_them = "at" if s["gap count"] <= len(longest) else "the longest at"
            alike.setdefault(f"{s['gap count']}, {all_of_them} {listed} s", []).append(name)
    rows += [(f"gaps of {', '.join(names)}", said) for said, names in alike.items()]
    if capture.get("frames"):
        rows += [
            ("frames without the body", f"{capture['frames lost']} of {capture['frames']}"),
            ("frames that hold an older pose", f"{capture['frames held']} of {capture['frames']}"),
            ("frames removed as outliers", f"{capture['frames removed']} of {capture['frames']}"),
            ("quaternion sign flips mended", capture.get("quaternion sign flips")),
        ]
    return frame.facts(rows) or frame.paragraph("Nothing was lost.")


def _timing(m: Section) -> list[tuple[str, object]]:
    sync = m.get("synchronisation")
    rows: list[tuple[str, object]] = []
    if sync:
        lag, rate = sync["lag"], sync["clock rate"]
        rows += [
            ("lag of the capture", frame.with_error(lag["value"], lag["std"], "ms", 1e3)),
            ("clock rate", frame.with_error(rate["value"], rate["std"], "ppm", 1e6) if rate["std"] else "not sought"),
            ("found by", f"{sync['method']}, over {sync['common span']['value']:.1f} s"),
            (
                "explained of each other",
                ", ".join(f"{k}: {frame.share(v)}" for k, v in sync["explained variance"].items()),
            ),
            ("heading offset", f"{frame.number(math.degrees(sync['yaw offset']['value']))} deg"),
        ]
    for name, c in m["corrections"].items():
        if name.endswith("delay") and c and c["filters"]:
            rows.append(
                (name, f"{frame.with_error(c['value'], c.get('std'), 'ms', 1e3)} undone ({', '.join(c['filters'])})")
            )
        elif name.endswith("delay") and c and not c.get("known", True):
            rows.append((name, f"not known, taken as {frame.with_error(c['value'], c['std'], 'ms', 1e3)}"))
        elif name == "imu position" and c:
            rows.append(("IMU position", f"{c['value']} m, corrected for"))
    rotors = m.get("rotor telemetry")
    if rotors and rotors.get("age"):
        age = rotors["age"]
        done = "taken off" if rotors.get("applied") else "not corrected"
        rows.append(("age of rotor telemetry", f"{frame.with_error(age['value'], age['std'], 'ms', 1e3)}, {done}"))
    return rows


def _battery(filtered: pd.DataFrame) -> list[tuple[str, object]]:
    if "battery_voltage" not in filtered:
        return []
    t, volts = filtered["t"].to_numpy(), filtered["battery_voltage"].to_numpy(float)
    fine = np.isfinite(volts)
    if not fine.any():
        return []
    first, last = (float(np.median(volts[fine & part])) for part in (t <= t[fine][0] + 1, t >= t[fine][-1] - 1))
    return [("battery, first and last second", f"{first:.2f} V to {last:.2f} V")]


def _clipped(facts: Section | None) -> str | None:
    """None for an import that did not look."""
    if facts is None:
        return None
    each = [
        f"{key.split(' ')[0]} at {frame.number(one['level']['value'])} {one['level']['unit']} for "
        f"{frame.number(one['seconds'], 2)} s in {one['span count']} spans"
        for key, one in facts.items()
    ]
    return ", ".join(each) or "never"


def _saturation(shares: Mapping[str, float]) -> list[tuple[str, object]]:
    rows: list[tuple[str, object]] = []
    for end in ("lower limit", "upper limit"):
        found = {k: v for k, v in shares.items() if end in k}
        if found:
            each = ", ".join(f"{k.split(' at ')[0]} {frame.share(v)}" for k, v in found.items() if v)
            rows.append((f"motor command at its {end}", each if any(found.values()) else "never"))
    return rows


def _filter(f: Section, source: str) -> list[tuple[str, object]]:
    """source  of the attitude: one that was estimated from the IMU has no axes of its own"""
    of = {"capture": "capture's", "onboard": "on-board attitude's"}.get(source)
    turned = (f.get("attitude alignment") or {}) if of else {}
    angles = [
        f"{a} {frame.with_error(turned[a]['value'], turned[a]['std'], 'deg', math.degrees(1))}"
        for a in ("roll", "pitch", "yaw")
        if a in turned
    ]
    phases = f["phases"]
    rest = phases.get("rest")
    return [
        ("rows valid for identification", frame.share(phases["valid share"])),
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
        ("low-pass", f"{f['filters']['low-pass cutoff Hz']:g} Hz"),
        ("notches at the rotors' harmonics", _notches(f["filters"].get("rotor notches"))),
    ]


def _notches(about: Section | None) -> str | None:
    if not about:
        return None
    lines = [
        f"{line['harmonic']} ({line['frequency']['value']:.0f} Hz"
        + (f", seen at {line['stands at']['value']:.0f} Hz" if line["folded share"] > 0.5 else "")
        + f", in {frame.share(line['taken out share'])} of the flight)"
        for line in about["lines"]
        if line["taken out share"] > 0
    ]
    return ", ".join(lines) or "none needed"


def _biases(f: Section) -> str:
    rows = []
    for key, axes, scale, unit in (
        ("gyro", ("p", "q", "r"), math.degrees(1), "deg/s"),
        ("accelerometer", ("ax", "ay", "az"), 1.0, "m/s²"),
    ):
        bias = (f.get("biases") or {}).get(key)
        if bias and bias.get("value"):
            said = [frame.with_error(v, s, "", scale) for v, s in zip(bias["value"], bias.get("std") or [None] * 3)]
            rows.append((f"bias of {key} ({', '.join(axes)}), {unit}", *said))
    return frame.table(("± standard error", "x", "y", "z"), rows)


def _innovations(f: Section) -> str:
    rows = [
        (
            f"innovations of {kind}", n["measurements"], frame.number(n["mean"]),
            " to ".join(map(frame.number, n["bounds"])), frame.share(n["gated"]), frame.number(n["whiteness"], 2),
        )
        for kind, n in (f.get("NIS") or {}).items()
        if n and n.get("mean") is not None
    ]  # fmt: skip
    head = ("", "measurements", "NIS (1 if honest)", "95 % bounds of white ones", "gated", "autocorrelation")
    return frame.table(head, rows)
