"""The page of a flight says what the data say, escapes what files bring, and needs nothing from outside."""

import re

import numpy as np
import pandas as pd
import pytest

from quasi.importing.streams import stream
from quasi.pages import frame
from quasi.pages.flight import (
    compute_ranges,
    compute_saturation,
    derive_flight_verdict,
    describe_unmeasured,
    render_flight_page,
)

N = 500
T = np.arange(N) / 100.0


@pytest.fixture
def flight():
    zero = np.zeros(N)
    columns = {k: zero.copy() for k in ("p", "q", "r", "roll", "pitch", "u", "v", "w", "ax", "ay", "w2", "command1")}
    filtered = pd.DataFrame(
        {"t": T, **columns, "w1": 1000.0 + T, "az": zero - 9.81, "z": zero - 1.5, "in_flight": zero}
    )
    filtered["battery_voltage"] = 16.0 - 0.1 * T
    filtered.loc[100:, "in_flight"] = 1.0
    filtered.loc[100:, "u"] = 3.0
    imported = {
        "flight": "one <b>",
        "quadrotor": "Q",
        "sampling": {"duration": 4.99, "rate": 100.0},
        "sources": {"onboard": {"path": "data/<log>.bbl", "fields": ["time", "motor[0]", "motor[1]"]}},
        "streams": {"gyro": stream(np.delete(T, np.arange(200, 260)))},
        "synchronisation": None,
        "attitude source": "onboard",
        "position source": "none",
        "velocity source": "none",
        "corrections": {
            "gyro filter delay": {"value": 1e-3, "std": 2e-4, "filters": ["PT1 160 Hz"]},
            "accelerometer filter delay": {"value": 0.0, "std": 0.02, "known": False, "filters": []},
        },
        "rest before take-off": {"value": 1.0},
        "notes": ["data/<log>.bbl: 3 rows & more were lost"],
        "saturation": {
            "p +": {"level": {"value": 34.91, "unit": "rad/s"}, "seconds": 0.125, "span count": 3},
        },
        "verdict": "good",
        "verdict because": "all sources are complete and agree",
    }
    about = {
        "mass": 0.4,
        "consistent": True,
        "phases": {"valid share": 0.8, "in flight share": 0.8, "take-off": 1.0, "rest": [0.0, 0.9]},
        "filters": {"low-pass cutoff Hz": 40.0},
        "biases": {"policy": "rest", "gyro": {"value": [0.01, -0.02, 0.0], "std": [1e-3, 1e-3, 1e-3]}},
        "NIS": {},
        "notes": [],
    }
    return filtered, imported, about


def test_page_is_whole_in_itself_and_escapes_what_files_bring(flight):
    filtered, imported, about = flight
    text = render_flight_page(filtered, imported, filtered, about, {"Attitude": (b"\x89PNG", "roll & more")})
    assert "http" not in text and "<link" not in text
    assert re.findall(r'src="(\w+:\w+)', text) == ["data:image"]
    assert "one &lt;b&gt;" in text and "<b>good:</b>" in text and "<log>" not in text
    assert "&lt;log&gt;.bbl: 3 rows &amp; more were lost" in text
    assert "time, motor[0..1]" in text
    assert "1.00 ± 0.20 ms corrected (PT1 160 Hz)" in text
    assert "unknown, assumed 0 ± 20 ms" in text
    assert "1, at 1.99 to 2.60 s" in text
    assert "16.00 V to" not in text and "15.95 V to 15.55 V" in text
    assert "0.573 ± 0.057" in text
    assert "p at 34.9 rad/s for 0.13 s in 3 spans" in text or "p at 34.9 rad/s for 0.12 s in 3 spans" in text


@pytest.mark.parametrize(
    ("wind", "shown"),
    [({"source": "record", "record": {"path": "tunnel.lvm"}}, "tunnel.lvm"), ({"source": "static"}, "static")],
)
def test_the_source_of_a_wind_is_listed(flight, wind, shown):
    filtered, imported, about = flight
    text = render_flight_page(filtered, imported | {"wind": wind}, filtered, about, {})
    assert f'<th scope="row">wind</th><td>{shown}</td>' in text


@pytest.mark.parametrize(
    ("sources", "engine", "velocity", "height"),
    [
        (("none", "none"), "compiled", "from the accelerometer alone, drifts", "from the accelerometer alone, drifts"),
        (("none", "onboard"), "compiled", "", "from the velocity alone, drifts"),
        (("none", "none"), None, "not measured", "not measured"),
        (("capture", "capture position"), "compiled", "", ""),
    ],
)
def test_what_no_source_measured_is_marked_among_what_was_flown(flight, sources, engine, velocity, height):
    filtered, imported, about = flight
    imported |= dict(zip(("position source", "velocity source"), sources))
    about["engine"] = engine
    names = [
        row[0] for row in compute_ranges(filtered, filtered["t"].to_numpy() >= 0, describe_unmeasured(imported, about))
    ]
    assert f"speed over ground ({velocity})".removesuffix(" ()") in names
    assert f"velocity down (body) ({velocity})".removesuffix(" ()") in names
    assert f"height above the origin ({height})".removesuffix(" ()") in names
    assert {"roll rate", "tilt", "load factor"} <= set(names)
    assert names[0] in render_flight_page(filtered, imported, filtered, about, {})


@pytest.mark.parametrize(
    ("source", "shown"),
    [("capture", "capture&#x27;s"), ("onboard", "on-board attitude&#x27;s"), ("estimated on board", None)],
)
def test_axes_are_laid_on_the_bodys_of_a_source_that_has_axes(flight, source, shown):
    filtered, imported, about = flight
    imported["attitude source"] = source
    about["attitude alignment"] = {"roll": {"value": 0.01, "std": 0.001}}
    text = render_flight_page(filtered, imported, filtered, about, {})
    assert (f"{shown} axes on the body&#x27;s" in text) if shown else ("axes on the body" not in text)


def test_ranges_are_of_the_rows_in_flight(flight):
    filtered = flight[0]
    found = {name: values for name, _, *values in compute_ranges(filtered, filtered["in_flight"].to_numpy() > 0)}
    assert found["speed over ground"] == [3.0, 3.0, 3.0]
    assert found["load factor"] == pytest.approx([9.81 / 9.80665] * 3, rel=1e-3)
    assert found["height above the origin"] == [1.5, 1.5, 1.5]
    assert found["rotor speed"][2] == pytest.approx(1004.99)


def test_motor_commands_at_their_limits_are_counted():
    flown = np.ones(N, bool)
    command = np.full(N, 0.5)
    command[:5], command[5:30] = 0.0, 1.0
    found = compute_saturation(pd.DataFrame({"command1": command}), flown)
    assert found["command1 at its lower limit"] == pytest.approx(5 / N)
    assert found["command1 at its upper limit"] == pytest.approx(25 / N)


def test_verdict_gets_worse_by_what_filtering_finds_and_never_better(flight):
    _, imported, about = flight
    assert derive_flight_verdict(imported, about, {}) == ("good", "all sources are complete and agree")
    word, why = derive_flight_verdict(imported, {**about, "consistent": False}, {"command1 at its upper limit": 0.02})
    assert word == "usable with care" and "innovations" in why and "2.00 %" in why and "agree" not in why
    told = "the filter is not consistent in position: 6 % of the measurements are rejected (limit 5 %)"
    assert derive_flight_verdict(imported, {**about, "consistent": False, "doubts": [told]}, {}) == (
        "usable with care",
        told,
    )
    none = {**about, "phases": {**about["phases"], "valid share": 0.0}}
    none["phases"]["none valid because"] = "no rotor turns (100 % of the flight)"
    assert derive_flight_verdict(imported, none, {}) == (
        "unusable",
        "no row is valid for identification: no rotor turns (100 % of the flight)",
    )
    bad = {**imported, "verdict": "unusable", "verdict because": "nothing was read"}
    assert derive_flight_verdict(bad, {**about, "consistent": False}, {})[0] == "unusable"


def test_colour_follows_the_worst_warning_on_the_page(flight):
    filtered, imported, about = flight
    shakes = "vibration that moves with the rotors' speed passes the low-pass"
    calm = render_flight_page(filtered, imported, filtered, {**about, "notes": ["3 samples are bridged"]}, {})
    shaken = render_flight_page(filtered, imported, filtered, {**about, "notes": [shakes], "doubts": [shakes]}, {})
    assert 'class="verdict good"' in calm and "<b>good:</b>" in calm
    assert 'class="verdict care"' in shaken and "<b>usable with care:</b> <strong>vibration that moves" in shaken


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (frame.format_with_error(-1.914417, 3.1e-5, "ms", 1e3), "−1914.417 ± 0.031 ms"),
        (frame.format_with_error(12.0, None, "V"), "12.00 V"),
        (frame.format_with_error(None, 1.0), "–"),
        (frame.format_number(float("nan")), "–"),
        (frame.format_number(0.00012345), "0.000123"),
        (frame.format_share(0.0), "0 %"),
        (frame.format_share(2e-5), "below 0.01 %"),
        (", ".join(frame.format_row([-5.414, 0.0002, 5.33])), "−5.41, 0.00, 5.33"),
    ],
)
def test_numbers_are_said_to_their_error(said, expected):
    assert said == expected


def test_stream_tells_rate_jitter_and_gaps():
    t = np.delete(T, np.arange(200, 260)) + 5.0
    found = stream(t, zero=5.0)
    assert found["rate"] == pytest.approx(100.0)
    assert found["jitter"] < 1e-12
    assert found["gap count"] == 1 and found["gaps"][0] == pytest.approx([1.99, 2.60])
    assert found["lost"] == pytest.approx(0.60)
    assert stream(t[:2]) is None


def test_texts_of_a_terminal_are_typeset_and_escaped():
    assert frame.escape("0.66 +- 0.32 <b>") == "0.66 ± 0.32 &lt;b&gt;"
