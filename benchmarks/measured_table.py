"""The tables of docs/measured.md and README.md, made from benchmarks/results/*.json.

    python benchmarks/measured_table.py            # write the tables into both pages
    python benchmarks/measured_table.py --check    # exit code 1 where a page differs from what the files give

A file of benchmarks/results belongs to one program and holds

    schema   "quasi.measured/1"
    program  what measures it: a file of benchmarks/, or a command
    rows     of the table: order, what, figure, values, date, commit, machine; README: readme {order, what, figure}
    table    name, columns and rows of a table of its own

`figure` is text with places for the values: {key}, {key:.2f}, or {key*1e6:.2f} in another unit. A benchmark that is run
with `--record` writes its values, the date, the commit and the machine through `record`; text is changed by hand.
"""

import argparse
import os
import platform
import re
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from quasi.tables import read_json, write_json

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGES = ("docs/measured.md", "docs/other-simulators.md", "README.md")
PLACE = re.compile(r"\{([^{}*:]+)(?:\*([0-9.e+-]+))?(?::([^{}]*))?\}")


def fill(figure: str, values: Mapping[str, Any]) -> str:
    """The text of a figure with its values. Raises KeyError for a value that is missing."""

    def value(match: re.Match) -> str:
        name, factor, form = match.groups()
        number = values[name]
        return format(number * float(factor) if factor else number, form or "")

    return PLACE.sub(value, figure)


def documents() -> list[dict[str, Any]]:
    """All files of results, by name."""
    return [read_json(path) for path in sorted(RESULTS.glob("*.json"))]


def summary_table() -> list[str]:
    """The large table of the page: one row a figure."""
    rows = [(row, d["program"]) for d in documents() for row in d.get("rows", ())]
    lines = ["| what | figure | program | measured |", "| --- | --- | --- | --- |"]
    for row, program in sorted(rows, key=lambda pair: pair[0]["order"]):
        figure = fill(row["figure"], row.get("values", {}))
        lines.append(f"| {row['what']} | {figure} | {row.get('program', program)} | {row['date']}, `{row['commit']}` |")
    return lines


def readme_table() -> list[str]:
    """The figures of the README."""
    rows = [row for d in documents() for row in d.get("rows", ()) if "readme" in row]
    lines = ["| what | figure |", "| --- | --- |"]
    for row in sorted(rows, key=lambda row: row["readme"]["order"]):
        lines.append(f"| {row['readme']['what']} | {fill(row['readme']['figure'], row['values'])} |")
    return lines


def named_tables() -> dict[str, list[str]]:
    """{name: lines} of the tables that stand alone."""
    made = {"summary": summary_table(), "readme": readme_table()}
    for document in documents():
        if table := document.get("table"):
            body = [
                [str(cell) for cell in row]
                for row in [table["columns"], ["---"] * len(table["columns"]), *table["rows"]]
            ]
            made[table["name"]] = [f"| {' | '.join(row)} |" for row in body]
    return made


def rendered(text: str) -> str:
    """A page with its tables made anew, between the comments that name them."""
    for name, lines in named_tables().items():
        begin, end = f"<!-- table {name} -->", f"<!-- end of table {name} -->"
        if begin in text:
            before, rest = text.split(begin, 1)
            text = "\n".join([before + begin, "", *lines, "", end + rest.split(end, 1)[1]])
    return text


def record(name: str, values: Mapping[str, Any]) -> None:
    """Store what a benchmark measured in results/<name>.json: values of the rows that use them, and when and where."""
    path = RESULTS / f"{name}.json"
    document = read_json(path)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    where = {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "commit": commit.stdout.strip(),
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, {platform.system()}",
    }
    for row in document["rows"]:
        used = [key for key in row.get("values", {}) if key in values]
        if used:
            row["values"] |= {key: values[key] for key in used}
            row.update(where)
    write_json(path, document)


def main() -> int:
    """Write or check both pages."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    stale = []
    for name in PAGES:
        path = ROOT / name
        text = path.read_text(encoding="utf-8")
        made = rendered(text)
        if made != text:
            stale.append(name)
            if not check:
                path.write_text(made, encoding="utf-8")
    print(f"{'differ' if check else 'written'}: {', '.join(stale) or 'nothing'}")
    return int(check and bool(stale))


if __name__ == "__main__":
    raise SystemExit(main())
