"""Summaries, figures and the page of a model: what they say is what was computed, and nothing breaks them."""

import base64
import json
import re
import shutil
import subprocess
from html import escape as html_of
from html.parser import HTMLParser

import numpy as np
import pytest
from judged import made
from matplotlib.figure import Figure

from quasi.identification.isolation import excited
from quasi.pages.model import _name_delay, render_model_page
from quasi.scoring.diagnostics import ANY_PREFIX
from quasi.scoring.figures import (
    draw_actuators,
    draw_closeup,
    draw_comparison,
    draw_coverage,
    draw_isolation,
    draw_quartiles,
)
from quasi.scoring.score import compare_with_measurements
from quasi.scoring.summary import escape_latex, format_latex, format_number, format_summary, format_unit, make_summary
from quasi.scoring.thinning import MAX_PAGE_ROWS, thin_rows
from quasi.tables import TELEMETRY_AGE_REMOVED


@pytest.fixture(scope="module")
def found():
    return made()


@pytest.fixture(scope="module")
def html(found):
    model, _, done = found
    summary = make_summary(model, done.scores, done.diagnosis)
    return render_model_page(model.document, summary, done.diagnosis, done.coverage, thin_rows(done.comparisons, ["c"]))


# ---- summaries ----


def test_the_text_says_the_verdict_first_and_the_page_what_random_samples_are_worth(found, html):
    model, _, done = found
    text = format_summary(model, done.scores, done.diagnosis)
    assert text.startswith("Verdict: good\n  Fz, My: good on all\nModel made_up")
    assert "The test rows are single samples between training samples" in html


def test_the_json_holds_every_term_and_score_and_is_plain(found):
    model, _, done = found
    summary = json.loads(json.dumps(make_summary(model, done.scores, done.diagnosis), allow_nan=False))
    for axis, part in model.document["axes"].items():
        said = summary["axes"][axis]
        assert [t["coefficient"] for t in said["terms"]] == [t["coefficient"] for t in part["terms"]]
        assert all(t["inclusion frequency"] == 0.9 for t in said["terms"])
        row = done.scores.query("flight == 'all' and role == 'validation' and axis == @axis").iloc[0]
        assert said["scores"]["validation"]["rmse"] == row["rmse"]


def test_latex_escapes_every_sign_and_keeps_its_braces_in_balance(found):
    model, _, done = found
    text = format_latex(model, done.scores, done.diagnosis)
    assert r"made\_up" in text
    assert r"\texttt{w*w\_tot}" in text
    assert r"u\textasciicircum{}2" in text
    assert r"90\,\%" in text
    bare = re.sub(r"\\[{}$&%#_]", "", text)
    assert bare.count("{") == bare.count("}")
    assert bare.count("$") % 2 == 0
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 3
    for line in text.splitlines():
        if line.endswith(r"\\"):
            columns = 6 if "texttt" in line or line.startswith("term") else None
            assert columns is None or len(re.findall(r"(?<!\\)&", line)) == columns - 1


def test_latex_of_any_text_compiles_where_a_compiler_is(found, tmp_path):
    model, _, done = found
    every = "".join(map(chr, range(32, 127))) + "µ\n"
    assert not re.search(r"(?<!\\)[&%#_]", escape_latex(every))
    if not shutil.which("pdflatex"):
        return
    body = (
        format_latex(model, done.scores, done.diagnosis)
        + escape_latex(every)
        + r" \texttt{"
        + escape_latex(every)
        + "}\n"
    )
    (tmp_path / "a.tex").write_text("\\documentclass{article}\\begin{document}\n" + body + "\\end{document}\n")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "a.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, errors="replace")
    assert done.returncode == 0, done.stdout[-800:]


@pytest.mark.parametrize(
    ("value", "digits", "said"),
    [
        (0.0123, 2, "$0.012$"), (12345.6, 5, "$12346$"), (-1.25e-9, 3, r"$-1.25\times10^{-9}$"), (0, 3, "$0$"),
        (float("nan"), 3, "--"), (123456.0, 3, r"$1.23\times10^{5}$"),
    ],
)  # fmt: skip
def test_numbers_in_latex(value, digits, said):
    assert format_number(value, digits) == said


def test_units_in_latex():
    assert format_unit("N s2/(m rad2)") == r"N\,s$^{2}$/(m\,rad$^{2}$)"
    assert format_unit("N s0.5") == "N\\,s$^{0.5}$"
    assert format_unit("1") == "1"


# ---- figures ----


def test_comparison_delimits_flights_and_shades_validation(found):
    _, _, done = found
    figure = draw_comparison(done.comparisons["Fz"], "Fz", "N", ["c"])
    top, bottom = figure.axes
    assert top.get_ylabel() == "Fz, N"
    assert [t.get_text() for t in top.texts] == ["a", "b", "c (validation)"]
    ends = [line.get_xdata()[0] for line in top.lines if line.get_color() == "0.6"]
    assert ends == pytest.approx([4.0, 8.0, 12.0], abs=0.05)  # 2000 rows at 500 Hz each
    shaded = [p for p in top.patches if p.get_facecolor()[:3] != (1, 1, 1)]
    assert len(shaded) == 1
    assert shaded[0].get_x() == pytest.approx(8.0, abs=0.05)
    residual = bottom.lines[0].get_ydata()
    assert np.nanstd(residual) == pytest.approx(0.05, rel=0.1)


def test_comparison_does_not_bridge_gaps(found):
    _, _, done = found
    held = done.comparisons["Fz"]
    cut = held._replace(**{
        name: getattr(held, name)[(held.t < 1) | (held.t > 3)]
        for name in ("flight", "t", "role", "measured", "predicted", "lower", "upper")
    })  # fmt: skip
    line = draw_comparison(cut, "Fz", "N").axes[0].lines[0]
    assert np.isnan(line.get_ydata()).sum() == 1


def test_every_figure_is_drawn(found):
    _, flights, done = found
    drawn = [
        draw_quartiles(done.comparisons["My"], "My", done.diagnosis["axes"]["My"]),
        draw_coverage(done.coverage),
        draw_closeup(done.comparisons, "c", {"Fz": "N", "My": "N m"}),
    ]
    assert all(isinstance(f, Figure) for f in drawn)
    assert "validation" in drawn[0].axes[0].get_title(loc="left")
    lines = done.coverage[~done.coverage["variable"].str.startswith(ANY_PREFIX)]
    assert [t.get_text() for t in drawn[1].axes[0].get_yticklabels()] == list(lines["variable"])
    assert draw_coverage(done.coverage.iloc[:0]) is None


def test_a_close_up_shows_the_liveliest_seconds_and_stands_short_flights(found):
    _, flights, done = found
    panel = next(p for p in draw_closeup(done.comparisons, "c", {"Fz": "N", "My": "N m"}, 0.5).axes if p.get_visible())
    shown = panel.lines[0].get_xdata()
    square = (flights["c"]["Fz"] - flights["c"]["Fz"].mean()) ** 2
    liveliest = int(square.rolling(250).sum().idxmax()) - 249
    assert shown[0] == pytest.approx(liveliest / 500, abs=1e-9)
    short = {
        axis: j._replace(**{n: getattr(j, n)[-60:] for n in j._fields[1:]}) for axis, j in done.comparisons.items()
    }
    assert isinstance(draw_closeup(short, "c", {"Fz": "N", "My": "N m"}), Figure)


def test_actuator_boxes_hold_every_flight():
    values = {"time constants up": 0.02, "time constants down": 0.03, "delay": 0.001}
    flights = {
        key: {name: {"value": [v * f] * 4, "std": [1e-4] * 4} for name, v in values.items()}
        for key, f in (("a", 0.9), ("b", 1.0), ("c", 1.1))
    }
    panels = draw_actuators({"flights": flights}).axes
    assert [p.get_ylabel() for p in panels] == ["time constant up, ms", "time constant down, ms", "delay, ms"]
    points = max((line for line in panels[1].lines), key=lambda line: len(line.get_xdata()))
    assert sorted(points.get_ydata()) == pytest.approx(sorted([27.0, 30.0, 33.0] * 4))
    assert draw_actuators(None) is None
    for key in flights:  # of flight c the delay holds the telemetry's age: it is no part of the box
        flights[key]["delay"] |= {TELEMETRY_AGE_REMOVED: key != "c"}
    apart = draw_actuators({"flights": flights}).axes[2]
    assert [t.get_text() for t in apart.get_legend().get_texts()] == ["without telemetry delay", "with telemetry delay"]
    box = [x for line in apart.lines if len(line.get_xdata()) == 5 for x in line.get_ydata()]
    assert max(box) < 1.01 + 1e-9
    titles = [
        _name_delay({"delay": {} if said is None else {TELEMETRY_AGE_REMOVED: said}}) for said in (True, False, None)
    ]
    assert titles == ["delay of the command", "delay of command and rotor telemetry", "delay"]


def test_isolation_shades_its_regions(found):
    model, flights, done = found
    codes = {k: np.ones(len(f), int) for k, f in flights.items()}
    options = {"excitation threshold": 0.7, "spread": 0.01}
    regions = excited(flights, codes, model.airframe, ["Fz"], options)["Fz"]
    panel = draw_isolation(flights, regions, "Fz", "N").axes[0]
    stretches = sum(int(np.sum(np.diff(np.r_[0, r.astype(int)]) == 1)) for r in regions.values())
    assert len(panel.patches) == stretches > 0
    share = np.mean(np.concatenate(list(regions.values())))
    assert f"{100 * share:.0f} % of the rows" in panel.get_xlabel()


# ---- the page ----


class Page(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.links, self.data, self.inside = [], [], "", None

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.links += [v for k, v in attributes.items() if k in ("src", "href") and v]
        if tag not in ("meta", "br", "img", "rect", "polyline"):
            self.open.append(tag)
        self.inside = attributes.get("id") if tag == "script" else None

    def handle_endtag(self, tag):
        if tag not in ("rect", "polyline"):
            assert self.open.pop() == tag

    def handle_startendtag(self, tag, attributes):
        pass

    def handle_data(self, text):
        if self.inside == "traces":
            self.data += text


def read(html):
    parsed = Page()
    parsed.feed(html)
    assert parsed.open == []
    return parsed


def test_the_page_is_whole_needs_nothing_else_and_escapes(html):
    parsed = read(html)
    assert parsed.links == []
    assert not re.search(r"(src|href)=|url\(|@import|fetch\(|XMLHttp", html)
    assert "a &lt;note&gt; &amp; more" in html
    assert html.index("good") < html.index("data-panel") < html.index("Scores") < html.index("Terms")


def test_the_page_tells_where_the_causes_that_extend_the_model_act(found):
    model, _, done = found
    found_sizes = {"mass at 0.5 m": {"value": 0.021, "unit": "kg"}, "mass at 0.2 m": {"value": 0.0, "unit": "kg"}}
    load = {"id": "payload_swing", "sentence": "a load hangs <below>", "states": {"swinging load": {}},
            "parameters": found_sizes}  # fmt: skip
    document = {**model.document, "extensions": [load]}
    summary = make_summary(model, done.scores, done.diagnosis)
    text = render_model_page(document, summary, done.diagnosis, done.coverage, thin_rows(done.comparisons, []))
    assert (
        "Causes that extend the model" in text
        and "A load hangs &lt;below&gt;. Mass at 0.5 m 0.02100 kg. Effects" in text
    )
    assert (
        "predictions contain its quasi-steady part" in text and "0.2 m" not in text.split("Causes that extend")[1][:600]
    )
    assert "Causes that extend the model" not in render_model_page(
        model.document, summary, done.diagnosis, done.coverage, thin_rows(done.comparisons, [])
    )


def line_of(panel, format_number):
    """Times and values (n,) of a trace in a page, NaN where it is unknown."""
    trace = panel["series"][format_number]
    steps = np.frombuffer(base64.b64decode(trace["steps"]), "<u2").astype(float)
    t = panel["begins"] + np.frombuffer(base64.b64decode(panel["t"]), "<f4").astype(float)
    return t, np.where(steps == 65535, np.nan, trace["low"] + trace["step"] * steps)


def test_the_pages_rows_are_the_measurements_to_the_16th_bit(html, found):
    _, flights, _ = found
    data = json.loads(read(html).data)
    assert len(data["views"]) == 3 and len(data["spans"]) == 1
    held = data["views"][2]
    assert data["first"] == held == {k: data["spans"][0][k] for k in ("from", "to")}
    for panel, axis in zip(data["panels"], ("Fz", "My"), strict=True):
        t, values = line_of(panel, 0)
        inside = (t >= held["from"] - 1e-4) & np.isfinite(values)
        every = round(500 / 125)
        step = panel["series"][0]["step"]
        np.testing.assert_allclose(values[inside], flights["c"][axis].to_numpy()[::every], atol=0.51 * step)
        assert np.all(np.diff(t) > 0) and np.isnan(values).sum() == 2  # between flights


def test_a_missing_value_stays_unknown_in_the_page(found):
    model, flights, done = found
    holed = {k: f.copy() for k, f in flights.items()}
    holed["c"].loc[:40, "My"] = np.nan
    held = done.comparisons["Fz"]
    codes = {key: held.role[held.flight == k] for k, key in enumerate(held.keys)}
    rows = thin_rows(compare_with_measurements(model, holed, codes), ["c"])
    text = render_model_page(
        model.document, make_summary(model, done.scores, done.diagnosis), done.diagnosis, done.coverage, rows
    )
    assert np.isnan(line_of(json.loads(read(text).data)["panels"][1], 0)[1]).sum() == 11 + 2


def test_rows_are_thinned_to_what_a_page_can_hold_and_gaps_are_marked():
    _, _, done = made(rows=60_000)
    rows = thin_rows(done.comparisons, ["c"])
    assert 0.4 * MAX_PAGE_ROWS < len(rows) <= 1.01 * MAX_PAGE_ROWS
    assert rows["start"].sum() == 3
    held = rows[rows["held"] > 0]
    assert set(held["flight"]) == {"c"}
    assert len(held) <= MAX_PAGE_ROWS // 2


def test_a_model_without_rotors_validation_or_test_rows_has_a_page():
    model, _, done = made(validation=(), options={"random partition": False}, rows=600)
    document = {**model.document, "actuators": None, "hover speed": {"value": None}, "simple model": {}}
    summary = make_summary(model, done.scores, done.diagnosis)
    text = render_model_page(document, summary, done.diagnosis, done.coverage, thin_rows(done.comparisons, []))
    assert "No validation flights." in text
    assert "No flight shows the time constants" in text
    published = {**document, "simple model": {"kappaFz": {"value": 5e-7, "std": None, "unit": "N s2/rad2"}}}
    assert "5e−07 N s2/rad2" in render_model_page(
        published, summary, done.diagnosis, done.coverage, thin_rows(done.comparisons, [])
    )
    assert "no test or validation rows" in text
    read(text)


def test_names_cannot_break_out_of_the_page(found):
    model, _, done = found
    evil = "</script><b>"
    held = {axis: j._replace(keys=("a", "b", evil)) for axis, j in done.comparisons.items()}
    document = {**model.document, "flights": {"training": ["a", "b"], "validation": [evil]}}
    summary = make_summary(model, done.scores, done.diagnosis)
    text = render_model_page(document, summary, done.diagnosis, done.coverage, thin_rows(held, [evil]))
    assert evil not in text
    assert html_of(evil) in text
