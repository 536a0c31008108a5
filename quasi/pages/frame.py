"""Self-contained HTML pages: text, tables and pictures in one file, without scripts, suitable for print.

Pure functions from plain data to HTML. Every text is escaped here, so callers pass plain text.
"""

import base64
import html
import math
from collections.abc import Container, Iterable, Sequence

PAGE_STYLE = """
:root { --ink: #1c2329; --soft: #5b6770; --line: #d9dee2; --good: #1e7d46; --care: #a86200; --bad: #b3261e; }
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; color: var(--ink); background: #fff;
  max-width: 1080px; margin: 0 auto; padding: 28px 24px 60px; }
h1 { font-size: 26px; margin: 0 0 2px; } h2 { font-size: 19px; margin: 34px 0 8px; }
.under { color: var(--soft); margin: 0 0 18px; }
.verdict { border-left: 6px solid var(--soft); padding: 10px 16px; background: #f6f8f9; font-size: 17px; }
.verdict b { display: inline-block; } .verdict b::first-letter { text-transform: uppercase; }
.verdict .more { display: block; font-size: 15px; margin-top: 6px; }
.verdict.good { border-color: var(--good); }
.verdict.care { border-color: var(--care); } .verdict.bad { border-color: var(--bad); }
.verdict.good b { color: var(--good); } .verdict.care b { color: var(--care); } .verdict.bad b { color: var(--bad); }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; margin: 6px 0 14px; }
th, td { text-align: left; padding: 4px 14px 4px 0; border-bottom: 1px solid var(--line); vertical-align: top; }
th { font-weight: 600; } thead th { color: var(--soft); font-weight: 500; }
tbody th { width: 26%; font-weight: 500; } td.n, th.n { text-align: right; white-space: nowrap; }
td { overflow-wrap: anywhere; }
details { margin: 6px 0 14px; } summary { cursor: pointer; color: var(--soft); }
ul { margin: 6px 0 14px; padding-left: 20px; } li { margin: 2px 0; overflow-wrap: anywhere; }
figure { margin: 14px 0 26px; break-inside: avoid; } img { width: 100%; height: auto; display: block; }
figcaption { color: var(--soft); font-size: 13.5px; margin-top: 4px; }
@media print { body { max-width: none; padding: 0; font-size: 11pt; } h2 { break-after: avoid; }
  tr { break-inside: avoid; } .verdict { background: none; } @page { margin: 15mm; } }
"""
VERDICT_CLASSES = {
    "good": "good", "usable with care": "care", "unusable": "bad", "agrees": "good", "explained": "good",
    "partly explained": "care", "unexplained": "bad", "not judged": "care",
}  # fmt: skip


def escape(text: object) -> str:
    """Escape text for HTML."""
    return html.escape(str(text)).replace(" +- ", " ± ")  # messages of a terminal are ASCII


def format_number(value: object, digits: int = 3) -> str:
    """Format a number with this many significant digits, without needless powers of ten; a dash for missing values."""
    if value is None or isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    if -6 <= places <= 7:
        return f"{value:.{max(places, 0)}f}".replace("-", "−")
    return f"{value:.{digits - 1}e}".replace("-", "−")


def format_row(values: Sequence[float]) -> list[str]:
    """Format numbers of one kind with equal decimals, so that the largest has three significant digits."""
    top = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    places = min(max(2 - math.floor(math.log10(top)), 0), 9) if top > 0 else 0
    texts = (f"{v:.{places}f}" if math.isfinite(v) else "–" for v in values)
    return [t.lstrip("-") if not t.strip("-0.") else t.replace("-", "−") for t in texts]


def format_with_error(value: object, std: object, unit: str = "", scale: float = 1.0) -> str:
    """Format a value ± its standard error, both to the second digit of the error; scale multiplies both."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return "–"
    if not isinstance(std, int | float) or not math.isfinite(std) or std <= 0:
        return f"{format_number(value * scale, 4)} {unit}".rstrip()
    places = min(max(1 - math.floor(math.log10(abs(std * scale))), 0), 9)
    return f"{value * scale:.{places}f} ± {std * scale:.{places}f} {unit}".replace("-", "−").rstrip()


def format_share(value: object) -> str:
    """Format a share as percent."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0 %"
    if 0 < value < 1e-4:
        return "below 0.01 %"
    return f"{100 * value:.2f} %" if value < 0.1 else f"{100 * value:.1f} %"


def render_facts(rows: Iterable[tuple[str, object]]) -> str:
    """Render a table of names and facts; rows without a fact are omitted."""
    lines = [
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(texts)}</td></tr>'
        for name, texts in rows
        if texts not in (None, "")
    ]
    return f"<table><tbody>{''.join(lines)}</tbody></table>" if lines else ""


def render_table(head: Sequence[str], rows: Iterable[Sequence[object]], words: Container[int] = ()) -> str:
    """Render a table: the first column names the row, the others are numbers except the columns `words`."""
    kind = [' class="n"' if i and i not in words else "" for i in range(len(head))]
    top = "".join(f'<th scope="col"{k}>{escape(h)}</th>' for k, h in zip(kind, head))
    lines = [
        f'<tr><th scope="row">{escape(row[0])}</th>'
        + "".join(f"<td{k}>{escape(c)}</td>" for k, c in zip(kind[1:], row[1:]))
        + "</tr>"
        for row in rows
    ]
    return f"<table><thead><tr>{top}</tr></thead><tbody>{''.join(lines)}</tbody></table>" if lines else ""


def render_list(texts: Iterable[str]) -> str:
    """Render a list of sentences."""
    lines = [f"<li>{escape(t)}</li>" for t in texts]
    return f"<ul>{''.join(lines)}</ul>" if lines else ""


def render_paragraph(text: str) -> str:
    """Render a paragraph."""
    return f"<p>{escape(text)}</p>"


def render_details(title: str, body: str) -> str:
    """Render a part that opens on click; nothing where the body is empty."""
    return f"<details><summary>{escape(title)}</summary>{body}</details>" if body else ""


def render_picture(png: bytes, caption: str) -> str:
    """Render a PNG picture inside the page, with its caption."""
    data = base64.b64encode(png).decode("ascii")
    text = escape(caption)
    return f'<figure><img alt="{text}" src="data:image/png;base64,{data}"><figcaption>{text}</figcaption></figure>'


def render_section(title: str, *blocks: str) -> str:
    """Render a section with a title; nothing where all blocks are empty."""
    body = "".join(blocks)
    return f"<section><h2>{escape(title)}</h2>{body}</section>" if body else ""


def render_page(
    title: str, under: str, verdict: str, because: str, sections: Iterable[str], more: str | None = None
) -> str:  # fmt: skip
    """Render the whole page: title, a line under it, the verdict and its reasons, then the sections.

    more  details below the reasons, which are then emphasised; None for neither
    """
    kind, reasons = VERDICT_CLASSES.get(verdict, ""), f"{escape(because)}."
    if more is not None:
        reasons = f"<strong>{reasons}</strong>" + (f'<span class="more">{escape(more)}</span>' if more else "")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{PAGE_STYLE}</style></head><body>"
        f'<h1>{escape(title)}</h1><p class="under">{escape(under)}</p>'
        f'<p class="verdict {kind}"><b>{escape(verdict)}:</b> {reasons}</p>'
        f"{''.join(sections)}</body></html>\n"
    )
