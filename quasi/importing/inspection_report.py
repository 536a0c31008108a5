"""The answer of `quasi check`: can what is configured be made of the raw files? A line, a table, sentences."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from quasi.importing.inspection import HOLDINGS, usable_for

PENDING = "to be made"


def report(
    inspected: Mapping[str, Mapping[str, Any]],
    refused: Mapping[str, Sequence[str]],
    pending: Collection[str] = (),
    untouched: Sequence[str] = (),
    notices: Sequence[str] = (),
) -> str:
    """Text of several lines.

    inspected  {"quadrotor/flight": result of inspect_flight} of every flight that the configuration names
    refused    {what is configured, such as "model m": sentences on why it cannot be made; none where it can}
    pending    flights whose raw files a rule is still to make
    untouched  what is configured as `quasi init` laid it, and fits no flights yet
    notices    remarks of the configuration files and logbooks
    """
    lines = [_answer(inspected, refused), ""]
    rows = [("flight", "log", "capture", *HOLDINGS, "usable for")]
    rows += [_row(key, found, key in pending) for key, found in inspected.items()]
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines += ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows]
    faults = list(dict.fromkeys(s for sentences in refused.values() for s in sentences))
    faults += [p for found in inspected.values() if (p := found["problem"]) and p not in faults]
    lines += ["", *(f"- {sentence}" for sentence in faults)] if faults else []
    alike: dict[str, list[str]] = {}
    for found in inspected.values():
        for remark in found["remarks"]:
            alike.setdefault(remark.removeprefix(f"{found['flight']}: "), []).append(found["flight"])
    remarks = [f"- {', '.join(flights)}: {remark}" for remark, flights in alike.items()]
    remarks += [f"- {notice}" for notice in notices]
    remarks += [f"- {name} is as `quasi init` laid it and is left out" for name in untouched]
    return "\n".join([*lines, *([] if faults or not remarks else [""]), *remarks])


def _answer(inspected: Mapping[str, Mapping[str, Any]], refused: Mapping[str, Sequence[str]]) -> str:
    """The first line: whether all is well, else how much is not."""
    broken = [key for key, found in inspected.items() if found["problem"]]
    stopped = [name for name, sentences in refused.items() if sentences]
    count = f"{len(inspected)} flight{'' if len(inspected) == 1 else 's'}"
    flights = f"{len(broken)} of {count} cannot be read" if broken else f"{count} can be read"
    if stopped:
        return f"NOT READY: {flights}; not possible: {', '.join(stopped)}."
    if broken:
        return f"NOT READY: {flights}."
    return f"READY: {flights}; possible: {', '.join(refused) or 'processing'}."


def _row(key: str, found: Mapping[str, Any], pending: bool) -> tuple[str, ...]:
    holds = found["holds"]
    cells = [_sampled(found["onboard"]), _sampled(found["capture"])]
    cells += [f"{holds[name]['rate']:.0f} Hz" if name in holds else "-" for name in HOLDINGS]
    return (key, *cells, PENDING if pending else usable_for(found))


def _sampled(source: Mapping[str, Any] | None) -> str:
    if not source:
        return "-"
    return f"{source['duration']:.1f} s at {source['rate'] or 0:.0f} Hz"
