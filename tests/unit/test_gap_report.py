"""The words and the page of a diagnosis: numbers as they are, nothing left out, text escaped, no network."""

import re

import numpy as np
import pandas as pd
import pytest

from quasi.gap.catalogue import catalogue
from quasi.gap.diagnosis import _truth, _verdict
from quasi.gap.effect import Vehicle
from quasi.gap.figures import figures
from quasi.gap.lower import units_of
from quasi.gap.report import page
from quasi.gap.wording import confirmation_of, left_sentence, rollout_of, summary, value_of

KNOWN = catalogue()
ROLES = {"ref-1": "reference", "new-1": "compared", "new-2": "compared", "new-3": "held out"}
GAIN = {"value": 0.86, "low": 0.7, "high": 0.95}
EFFECT = {
    "id": "ground_effect", "level": "W", "since": "changed", "probability": 0.98, "channels": ["Fz", "Mx", "My"],
    "parameters": {"c": {"value": 5.64, "std": 0.48, "unit": "1"}}, "gain": {"wrench": 0.86, "rollout": 0.3},
    "gain channel": "Fz", "rollout channel": "velocity", "gains": {"Fz": GAIN}, "confused_with": ["inflow_lag"],
    "evidence": {"p": 2e-13},
}  # fmt: skip
TIE = {
    "ids": ["mass", "thrust_factor"], "since": "changed", "separability": 1.3, "tie_breaker": "weigh it",
    "parameters": {"mass": {"mass": {"value": 0.45, "std": 0.01, "unit": "kg"}},
                   "thrust_factor": {"factor": {"value": 0.96, "std": 0.01, "unit": "1"}}},
}  # fmt: skip
LEFT = {"channel": "Mz", "where": "heading", "share": 0.4, "since": "always", "evidence": {"p": 1e-6, "wald": 40.0}}
LOST = {"id": "tether", "since": "changed", "score": 0.4, "p": 0.69, "why_not": "p = 0.69 <beside> ground_effect"}


def document(effects=(), ties=(), left=()):
    gap = {
        "before": {"W": {"Fz": {"0": 0.1}}, "R": {"velocity": {"1": 0.5}}, "K": {"p": {"0": 0.003}}},
        "after": {"W": {"Fz": {"0": 0.04}}, "R": {"velocity": {"1": 0.4}}},
        "noise_floor": {"W": {"Fz": {"0": 0.03}}}, "best_wrong_cause": {}, "generic_polynomial": {},
    }  # fmt: skip
    made = {
        "schema": "quasi.gap/1", "name": "low", "model": "X", "extended_model": "X-low", "flights": ROLES, "gap": gap,
        "effects": list(effects), "ties": list(ties), "unexplained": list(left), "findings": [
            {"id": "timestamp_fault", "text": "flight new-1: the log lost 0.2 s", "evidence": {}}],
        "candidates": [LOST], "cannot_be_asked": [{"id": "battery_sag", "why": "no voltage & no commands"}],
        "notes": ["a note"], "material share": 0.05, "false alarm rate": 0.01, "horizons": [1.0],
        "rollouts": {"R": [{"horizon": 1.0, "quantity": "velocity", "before": 0.5, "after": 0.4, **GAIN}]},
        "scores": {"removed": {"Fz": GAIN}, "best wrong cause": "wind"},
    }  # fmt: skip
    made["verdict"] = _verdict(made["effects"], made["ties"], made["unexplained"])
    made["summary"] = summary(made, KNOWN)
    return made


@pytest.mark.parametrize(
    "parts, verdict",
    [
        ({}, "agrees"),
        ({"effects": [EFFECT]}, "explained"),
        ({"effects": [EFFECT], "ties": [TIE]}, "partly explained"),
        ({"effects": [EFFECT], "left": [LEFT]}, "partly explained"),
        ({"ties": [TIE]}, "partly explained"),
        ({"left": [LEFT]}, "unexplained"),
    ],
)
def test_the_verdict_says_what_there_is(parts, verdict):
    assert document(**parts)["verdict"] == verdict


def test_an_unexplained_residual_is_told_with_its_size_and_where_it_lives():
    left = {"channel": "Fz", "share": 0.5, "size": 0.123, "unit": "N", "since": "changed"}
    at = left_sentence({**left, "where": "heading", "mostly": [[0.7, 1.05], [2.0, 2.1]]})
    assert "is off by 0.12 N rms along the heading, mostly at 40.1 to 60.2 and 115 to 120 deg: 50 % of its" in at
    place = left_sentence({**left, "where": "room place", "mostly": [[1.2, -0.8]]})
    assert "along the room place, mostly near x = 1.2 m, y = -0.8 m" in place
    assert "rms in time, at 0.38 to 0.42 Hz" in left_sentence({**left, "where": "frequency", "mostly": [[0.38, 0.42]]})
    nowhere = left_sentence({**left, "where": "everywhere", "mostly": [], "share": None})
    assert "rms everywhere: which cannot be judged on the held-out flights" in nowhere


def test_the_summary_names_cause_size_share_rivals_ties_and_what_is_left():
    text = document([EFFECT], [TIE], [LEFT])["summary"]
    for words in (
        "The rotors make more thrust near the floor (ground effect: c = 5.64 ± 0.48); this is new since the reference",
        "explains 86 % of the removable vertical force error (Fz) on the held-out flight and 30 % of that of the",
        "Tether was tested in place of ground effect and lost (tether: p = 0.69)",
        "Mass or thrust factor: this data cannot tell which (separability 1.3 standard errors); to settle it: weigh",
        "The yaw moment (Mz) is off along the heading: 40 % of its removable error, which no cause explains.",
    ):
        assert words in text
    assert "agree" in document()["summary"] and "5 %" in document()["summary"]


@pytest.mark.parametrize(
    "parameter, words",
    [
        ({"value": 5.644, "std": 0.48, "unit": "1"}, "5.64 ± 0.48"),
        ({"value": 1.56e-05, "std": 9e-07, "unit": "N m"}, "(1.560 ± 0.090)e-5 N m"),
        ({"value": -0.4503, "std": 0.012, "unit": "kg"}, "-0.450 ± 0.012 kg"),
        ({"value": 25.0, "std": 0.0, "unit": "s"}, "25 s"),
    ],
)
def test_a_value_goes_as_far_as_its_standard_error(parameter, words):
    assert value_of(parameter) == words


def test_parameters_are_stated_as_they_are_not_as_deviations():
    vehicle = Vehicle(np.zeros((4, 3)), np.ones(4), 0.04, 1e-7, 1e-9, 0.43, np.diag([1e-3, 2e-3, 3e-3]), 9.7, 0.0, 0.0)
    assert _truth(KNOWN["mass"], "mass", 0.02, vehicle) == pytest.approx(0.45)
    assert _truth(KNOWN["inertia"], "Iyy", 1e-4, vehicle) == pytest.approx(2.1e-3)
    assert _truth(KNOWN["thrust_factor"], "factor", -0.03, vehicle) == pytest.approx(0.97)
    assert _truth(KNOWN["wind"], "north", 1.5, vehicle) == 1.5


def rows():
    t = np.arange(200) / 100.0
    table = {
        "t": np.tile(t, 2),
        "flight": np.repeat(["new-1", "new-3"], 200),
        "role": np.repeat(["compared", "held out"], 200),
    }
    for axis in ("Fx", "Fy", "Fz", "Mx", "My", "Mz"):
        table |= {
            f"{axis}_measured": np.sin(table["t"]),
            f"{axis}_before": 0.1 + 0 * table["t"],
            f"{axis}_after": 0 * table["t"],
        }
    return pd.DataFrame(table)


def test_the_page_tells_everything_escaped_and_without_network():
    made = document([EFFECT], [TIE], [LEFT])
    text = page(made, KNOWN, rows(), {"where": b"\x89PNG"})
    assert "http" not in re.sub(r'lang="en"|charset', "", text)
    for words in ("Partly explained".lower(), "ground effect", "86 % (70 to 95)", "Cheeseman", "X-low", "a note",
                  "no voltage &amp; no commands", "p = 0.69 &lt;beside&gt; ground_effect", "wind", "data:image/png",
                  "the log lost 0.2 s", '"axes":{"Fx before"'):  # fmt: skip
        assert words in text
    assert text.index("ground effect") < text.index("What is wrong") < text.index("What no cause explains")


def test_a_page_without_any_row_or_picture_stands():
    assert "Agrees" in page(document(), KNOWN, None, {}).replace("agrees", "Agrees")


def test_tables_without_rows_draw_nothing_and_every_column_has_a_unit():
    assert figures({"W_where": pd.DataFrame(), "R_overlays": pd.DataFrame({"window": []})}) == {}
    units = units_of(rows())
    assert units["Fz_before"] == ("N", "") and units["My_after"] == ("N m", "") and "t" not in units


def test_the_page_tells_what_roll_outs_say_of_a_cause():
    told = {
        **EFFECT, "rollout channel": "velocity z", "rollout gain": {"horizon": 0.5, "line": "R with trim"},
        "confirmation": {"outcome": "confirmed", "amplitude": {"value": 0.93, "std": 0.11}, "why": ""},
        "output error": {"agrees": False, "parameters": {"c": {"value": 9.1, "std": 0.98, "unit": "1"}}},
    }  # fmt: skip
    assert rollout_of(told) == " of the simulated vertical velocity after 0.5 s, trim taken up"
    expected = "confirmed: 0.93 ± 0.11 of the motion that it should make is there; by output error c = 9.10 ± 0.98"
    assert confirmation_of(told) == f"{expected}, which does not agree"
    text = page(document([told]), KNOWN, None, {})
    assert expected in text and "30 % of the simulated vertical velocity" in text
    blind = {"outcome": "cannot be judged", "amplitude": None, "why": "each flight has its own"}
    assert confirmation_of({**told, "confirmation": blind, "output error": None}) == (
        "cannot be judged: each flight has its own"
    )


def test_the_page_tells_roll_outs_with_commands_beside_wrong_cause_and_polynomial():
    shares = {"removed": GAIN, "best_wrong_cause": {"rms": 0.48, "value": 0.12, "low": -0.03, "high": 0.2},
              "generic_polynomial": {"rms": 0.5, "value": None, "low": None, "high": None}}  # fmt: skip
    row = {"horizon": 0.5, "quantity": "velocity", "before": 0.52, "after": 0.41, "noise_floor": 0.39, **GAIN, **shares}
    made = document([EFFECT])
    made["rollouts"]["R commands"] = [row, {**row, "quantity": "velocity z"}]
    made["scores"]["best wrong cause with commands"] = "motor_lag"
    text = page(made, KNOWN, None, {})
    table = text[text.index("simulated with commands") :]
    cells = re.findall(r"<t[hd][^>]*>([^<]*)</t[hd]>", table[table.index("velocity, m/s, after 0.5 s") - 40 :])[:8]
    assert cells == ["velocity, m/s, after 0.5 s", "0.520", "0.410", "0.390", "86 % (70 to 95)", "86 % (70 to 95)",
                     "12 % (−3 to 20)", "–"]  # fmt: skip
    assert table.count("after 0.5 s</") == 1  # along the axes they are in the table R_gains
    assert "With commands, the best wrong cause would have been motor lag." in text
