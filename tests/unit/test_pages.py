"""Pages: charts hold what was measured, no text becomes HTML, no number breaks a page; the index lists a folder."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from judged import made
from test_flight_page import flight  # noqa: F401

from quasi.identification import warnings as fit_warnings
from quasi.pages import flight as flight_page
from quasi.pages import index, model
from quasi.pages.chart import VENDOR_FOLDER, Chart, Panel, Trace, decimate, pack_panel, render_style
from quasi.pages.flight_traces import draw_path, find_spans, make_panels
from quasi.pages.gyro_spectrum import draw_gyro_spectrum
from quasi.pages.model_warnings import OTHER_WARNINGS, WARNING_KINDS, show_warnings
from quasi.pages.terms import VARIABLES, describe_variable, list_variables, show_expression
from quasi.running.provenance import list_reached_files
from quasi.scoring.summary import make_summary
from quasi.scoring.thinning import thin_rows
from quasi.tables import COLUMNS, read_bytes, read_text, write_json
from quasi.terms.variables import _SOURCE_COLUMNS

EVIL = ['<x-evil onload="1">', '"><x-evil>', "</script><x-evil>", "' onload='1", "<!--<x-evil>", "]]><x-evil>&lt;"]
ODD = [float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 0.0]


class Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.attributes = [], set()

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes |= {name for name, _ in attributes}


def check_harmless(html):
    """Scripts are the page's own three at most, and nothing of EVIL is a tag or an attribute."""
    parsed = Tags()
    parsed.feed(html)
    assert "x-evil" not in parsed.tags
    assert not any(name.startswith("on") or "evil" in name for name in parsed.attributes)
    assert parsed.tags.count("script") in (0, 3)
    assert not re.search(r'(src|href)="(https?:|javascript:|//)', html)


def poison(value, texts, numbers, keep):
    """Plain data with its free texts, and where `numbers` is given its numbers, replaced."""
    if isinstance(value, dict):
        return {k: v if k in keep else poison(v, texts, numbers, keep) for k, v in value.items()}
    if isinstance(value, list):
        return [poison(v, texts, numbers, keep) for v in value]
    if isinstance(value, str):
        return next(texts)
    return next(numbers) if isinstance(value, float) and numbers else value


def cycle(items, seed):
    while True:
        yield items[seed % len(items)]
        seed += 1


@pytest.fixture(scope="module")
def judged():
    return made(rows=1500)


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_no_text_of_a_model_becomes_html(judged, seed):
    portable, _, done = judged
    texts = cycle(EVIL, seed)
    keep = {"verdict", "warnings", "kind", "density", "band"}
    document = poison(portable.document, texts, None, {"actuators", "simple model"})
    summary = poison(make_summary(portable, done.scores, done.diagnosis), texts, None, keep)
    diagnosis = poison(done.diagnosis, texts, None, keep) | {"verdict": next(texts)}
    coverage = done.coverage.assign(variable=[next(texts) for _ in range(len(done.coverage))])
    rows = thin_rows(done.comparisons, ["c"]).assign(flight=next(texts))
    check_harmless(model.render_model_page(document, summary, diagnosis, coverage, rows))


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_no_number_of_a_model_breaks_its_page(judged, seed):
    portable, _, done = judged
    generator = np.random.default_rng(seed)
    rows = thin_rows(done.comparisons, ["c"])
    for column in [c for c in rows if c not in ("flight", "t", "start", "held")]:
        rows.loc[generator.random(len(rows)) < 0.3, column] = ODD[seed % len(ODD)]
    coverage = done.coverage.copy()
    numeric = coverage.columns.drop("variable")
    coverage.loc[generator.integers(len(coverage)), generator.choice(numeric)] = ODD[seed % len(ODD)]
    with np.errstate(all="ignore"):
        html = model.render_model_page(
            portable.document, make_summary(portable, done.scores, done.diagnosis), done.diagnosis, coverage, rows
        )
    json.loads(re.search(r'id="traces">(.*?)</script>', html, re.S)[1], parse_constant=pytest.fail)


@pytest.mark.parametrize("seed", range(12))
def test_no_text_and_no_number_of_a_flight_breaks_its_page(flight, seed):  # noqa: F811
    filtered, imported, about = flight
    texts, generator = cycle(EVIL, seed), np.random.default_rng(seed)
    sources = {"attitude source", "position source", "velocity source", "verdict"}
    m = poison(imported, texts, None, sources) | {"verdict": "usable with care"}
    m |= {"position source": "capture", "velocity source": "capture"}
    f = poison(about, texts, None, set())
    table = filtered.assign(x=filtered["t"], y=-filtered["t"])
    for column in [c for c in table if c not in ("t", "in_flight")]:
        table.loc[generator.random(len(table)) < 0.3, column] = ODD[seed % len(ODD)]
    with np.errstate(all="ignore"):
        html = flight_page.render_flight_page(
            table, m, table, f, {next(texts): (b"\x89PNG", next(texts))}, (b"\x89PNG", next(texts))
        )
        draw_gyro_spectrum(table, np.ones(len(table), bool))
    check_harmless(html)


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_no_text_of_a_folder_becomes_html(seed):
    texts = cycle(EVIL, seed)
    entry = {"name": next(texts), "link": next(texts), "file": next(texts)}
    data = {"verdict": next(texts), "because": next(texts), "summary": next(texts), "model": next(texts)}
    scores = {"Fx": {"scores": {"validation": {"rmse": float("nan"), "r2": next(texts)}}}, "Fy": None}
    found = {
        kind: [entry | {"data": data | {"axes": scores}}, entry | {"fault": next(texts)}]
        for kind in index.ARTIFACT_KINDS
    }
    check_harmless(index.render_index(found, next(texts)))


# ---- charts ----


def unpacked(panel):
    t = panel["begins"] + np.frombuffer(base64.b64decode(panel["t"]), "<f4").astype(float)
    lines = []
    for one in panel["series"]:
        steps = np.frombuffer(base64.b64decode(one["steps"]), "<u2").astype(float)
        lines.append(np.where(steps == 65535, np.nan, one["low"] + one["step"] * steps))
    return t, lines


def test_decimation_keeps_every_peak_and_every_gap():
    generator = np.random.default_rng(1)
    t = np.arange(45_000) / 500.0
    noise = generator.standard_normal((2, len(t)))
    noise[0, 20_001], noise[1, 31_007] = 40.0, -30.0
    noise[0, 10_000:10_002] = np.nan
    at, (first, second) = unpacked(
        pack_panel(Panel("x", t, [Trace("a", noise[0], "red"), Trace("b", noise[1], "red")]))
    )
    assert len(at) <= 1.6 * 8000
    assert at[np.nanargmax(first)] == pytest.approx(t[20_001]) and np.nanmax(first) == pytest.approx(40.0, abs=1e-3)
    assert at[np.argmin(second)] == pytest.approx(t[31_007]) and second.min() == pytest.approx(-30.0, abs=1e-3)
    assert np.isnan(first).any() and not np.isnan(second).any()
    assert list(decimate([noise[0]], 100, 8000)) == list(range(100))


@settings(max_examples=60, deadline=None)
@given(values=st.lists(st.floats(-1e300, 1e300) | st.sampled_from(ODD[:3]), min_size=1, max_size=40))
def test_packed_values_come_back_to_half_a_step_and_unknown_ones_stay_unknown(values):
    values = np.array(values)
    with np.errstate(over="ignore"):
        packed = pack_panel(Panel("x", np.arange(float(len(values))), [Trace("a", values, "red")]))
        _, (back,) = unpacked(json.loads(json.dumps(packed, allow_nan=False)))
        known = np.isfinite(values)
        assert list(np.isfinite(back)) == list(known)
        step = packed["series"][0]["step"]
        assert np.all(np.abs(back[known] - values[known]) <= 0.51 * step + 1e-9 * np.abs(values[known]))


def test_a_flight_of_90_s_at_500_hz_stays_below_3_mb_of_traces():
    t = np.arange(45_000) / 500.0
    wave = np.sin(np.outer(np.arange(1, 5), t)) + np.random.default_rng(0).standard_normal((4, len(t)))
    panels = [Panel(str(k), t, [Trace("a", row, "red") for row in wave]) for k in range(16)]
    assert len(Chart(panels).script() + render_style()) < 2.2e6


# SHA-256 of the copies from the npm package uplot 1.6.32
UPLOT_DIGESTS = {
    "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    "LICENSE.uPlot": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
}


def test_the_copy_of_uplot_is_the_published_one_and_every_page_names_its_licence():
    for name, digest in UPLOT_DIGESTS.items():
        assert hashlib.sha256(bytes(read_bytes(VENDOR_FOLDER / name))).hexdigest() == digest
    html = Chart([Panel("x", np.arange(3.0), [Trace("a", np.zeros(3), "red")])]).script()
    assert "Copyright (c) 2022 Leon Sorokin" in html and "http" not in html
    assert read_text(VENDOR_FOLDER / "LICENSE.uPlot").strip() in html
    assert html.count("</script>") == html.count("<script") == 3


# ---- flights ----


def test_lost_spans_come_from_flags_and_gaps_and_are_red_on_the_path():
    t = np.arange(1000) / 100.0
    flown = pd.DataFrame({"t": t, "x": np.cos(t), "y": np.sin(t), "z": -t, "in_flight": (t > 2).astype(float)})
    imported = pd.DataFrame({"t": t, "onboard_valid": ((t < 5) | (t >= 6)).astype(float)})
    streams = {"capture": {"gaps": [[3.0, 3.5]]}, "gyro": {"gaps": [[7.0, 7.1]]}}
    spans = find_spans(imported, flown, {"streams": streams})
    assert ("uncaptured" in {k for *_, k in spans}) and (3.0, 3.5, "uncaptured") in spans
    assert next(s for s in spans if s[2] == "lost")[:2] == pytest.approx((5.0, 6.0))
    assert next(s for s in spans if s[2] == "idle")[:2] == pytest.approx((0.0, 2.01))
    assert not any(s[0] == 7.0 for s in spans)
    assert draw_path(flown, spans).count("#d62728") == 2 and draw_path(flown, []).count("#d62728") == 0
    assert draw_path(flown.assign(x=np.nan), spans) == ""


def test_traces_of_what_no_source_measured_are_left_out():
    t = np.arange(10) / 10.0
    one = pd.DataFrame({"t": t, "z": -t, "u": t, "p": t, "setpoint_p": t, "setpoint_q": t})
    labels = [panel.label for panel in make_panels(one, one, [])]
    assert labels == ["roll rate, deg/s"]
    assert [p.label for p in make_panels(one, one, ["position", "velocity"])][:2] == ["height, m", "velocity, m/s"]
    height = make_panels(one, one, ["position"])[0].traces[0].values
    np.testing.assert_allclose(height, t)
    rate = make_panels(one, one, [])[0].traces[1]
    np.testing.assert_allclose(rate.values, np.degrees(t))


def test_the_gyro_spectrum_shows_a_shake_at_its_frequency_and_throttle():
    t = np.arange(20_000) / 500.0
    throttle = np.where(t < 20, 0.2, 0.8)
    shake = 0.1 * np.sin(2 * np.pi * np.where(t < 20, 60.0, 150.0) * t)
    table = pd.DataFrame({"t": t, "p": shake, "q": 0 * t, "r": 0 * t, "throttle": throttle})
    mesh = draw_gyro_spectrum(table, t >= 0).axes[0].collections[0]
    power = np.ma.filled(mesh.get_array(), np.nan).reshape(-1, 24)
    rows = np.nanargmax(power[:, [0, 23]], axis=0)
    frequency = np.fft.rfftfreq(200, 1 / 500)
    frequency = frequency[frequency > 2.0]
    assert frequency[rows] == pytest.approx([60.0, 150.0])
    # a sine of amplitude a holds a^2/2, in deg2/s2
    total = np.sum(10 ** (power[:, 0] / 10)) * 2.5
    assert total == pytest.approx(np.degrees(0.1) ** 2 / 2, rel=0.02)
    assert draw_gyro_spectrum(table.iloc[:100], t[:100] >= 0) is None
    assert draw_gyro_spectrum(table.drop(columns="throttle"), t >= 0) is None


# ---- models ----


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("(w_avg^2)*(mu_x^(1.0))", "w_avg² · mu_x"), ("((u^2 + v^2)^0.5)*(U_p^(1.0))", "√(u² + v²) · U_p"),
        ("(w_avg^2)*((mu_x^2 + mu_y^2)^(2.0))", "w_avg² · (mu_x² + mu_y²)²"), ("a/(b*c)", "a / (b · c)"),
        ("a - (b - c)", "a − (b − c)"), ("-u^2", "−u²"), ("(u + v)*w", "(u + v) · w"), ("u^-1", "u⁻¹"),
        ("(-u)^2", "(−u)²"), ("1/u", "1 / u"), ("a/b*c", "a / b · c"), ("<b>(", "<b>("), ("(u^2)^3", "(u²)³"),
    ],
)  # fmt: skip
def test_terms_are_shown_without_needless_brackets_and_mean_the_same(text, shown):
    assert show_expression(text) == shown


def test_every_variable_of_the_manual_has_a_unit_and_a_meaning():
    for name in {*_SOURCE_COLUMNS, *"uvwpqr", "roll", "battery_voltage"}:
        unit, meaning = describe_variable(name)
        assert unit and meaning and (name in VARIABLES or name in COLUMNS)
    assert [row[0] for row in list_variables(["(w_avg^2)*(|u|)", "bias", "<"])] == ["u", "w_avg"]


def test_warnings_of_a_fit_are_grouped_by_kind_with_what_to_do():
    source = read_text(fit_warnings.__file__)
    source = re.sub(r'"\s*\n?\s*f?"', "", source)  # strings that stand in parts
    for mark, _, _ in WARNING_KINDS[:-1]:
        assert mark in source, f"no warning of a fit holds '{mark}'"
    notes = ["Fx: (u^(1.0)) could stand for (v^(1.0)) without the data noticing; its form is not settled", "else <b>"]
    html = show_warnings(notes)
    assert html.count("<details>") == html.count("What to do") == 2
    assert (
        WARNING_KINDS[0][1] in html
        and OTHER_WARNINGS[0] in html
        and "u could stand for v" in html
        and "else &lt;b&gt;" in html
    )


# ---- the index ----


@pytest.mark.parametrize(
    ("verdicts", "headline"),
    [((), "nothing judged"), (("good", "explained"), "explained"), (("good", "unexplained"), "unexplained")],
)
def test_without_pages_of_flights_the_index_begins_with_models_and_gaps(verdicts, headline):
    entries = [{"name": "same", "file": "f", "link": None, "data": {"verdict": v, "axes": {}}} for v in verdicts]
    html = index.render_index({kind: [e] for kind, e in zip(("models", "gaps"), entries)}, "lab")
    assert f"<b>{headline}:</b>" in html and "0 flights" not in html
    assert not verdicts or ("model same</span>" in html and "gap same</span>" in html)


def test_the_index_lists_what_stands_in_a_folder_and_links_it(tmp_path):
    write_json(tmp_path / "results/parts/filtering/Q/one/verdict.json", {"verdict": "good", "because": "all agree"})
    (tmp_path / "results/reports/Q").mkdir(parents=True)
    (tmp_path / "results/reports/Q/one.html").write_text("x")
    scores = {"Fz": {"scores": {"training": {"rmse": 0.1, "r2": 0.9}, "validation": {"rmse": 0.25, "r2": 0.8}}}}
    write_json(tmp_path / "models/m/standalone/summary.json", {"verdict": "unusable", "axes": scores})
    write_json(
        tmp_path / "results/gaps/g/diagnosis.json", {"verdict": "explained", "summary": "The 1.5 m gap. And more."}
    )
    (tmp_path / "results/simulations/s").mkdir(parents=True)
    (tmp_path / "results/simulations/s/summary.json").write_text("{damaged")
    before = index.list_sources(tmp_path)
    found = index.collect_artifacts(tmp_path)
    assert {k: [e["link"] for e in v] for k, v in found.items()} == {
        "flights": ["reports/Q/one.html"], "models": [None], "simulations": ["simulations/s"], "gaps": [None],
    }  # fmt: skip
    html = index.render_index(found, "lab")
    for words in (
        "1 flight (1 good)",
        "1 model",
        'href="reports/Q/one.html"',
        "all agree",
        "0.250 v",
        "The 1.5 m gap.",
    ):
        assert words in html
    assert "And more" not in html and "results/simulations/s/summary.json: " in html
    assert index.list_sources(tmp_path) == before
    write_json(tmp_path / "models/n/standalone/summary.json", {})
    assert index.list_sources(tmp_path) != before


def test_scripts_of_the_model_do_not_reach_the_pages(request):
    root = request.config.rootpath
    names = {p.relative_to(root).as_posix() for p in list_reached_files(root / "scripts/identification.py", root)}
    assert not any(name.startswith("quasi/pages/") for name in names)


def test_every_kind_of_warning_is_one_that_identification_writes():
    root = Path(fit_warnings.__file__).parent
    text = "".join(re.sub(r'"\s*\n\s*f?"', "", p.read_text(encoding="utf-8")) for p in root.glob("*.py"))
    assert [mark for mark, _, _ in WARNING_KINDS if mark not in text] == []
