"""The page tells where errors are greatest: the bin, how much greater, and what is alike everywhere."""

import numpy as np
import pandas as pd
import pytest
from gap_documents import KNOWN, document

from quasi.gap.flights.residual_tables import where
from quasi.gap.report.localised import greatest, table_of
from quasi.gap.report.page import page


def made(rows=8000, channels=("Fz", "Mx"), words=("before", "after")):
    """Errors of size 1; of the first channel 3 times that in the lowest eighth of heights, twice in one of headings."""
    rng = np.random.default_rng(5)
    frame = pd.DataFrame({"height": rng.uniform(0.0, 2.0, rows), "heading": rng.uniform(-np.pi, np.pi, rows)})
    size = np.where(frame["height"] < 0.25, 3.0, 1.0) * np.where(frame["heading"] > 0.75 * np.pi, 2.0, 1.0)
    for channel in channels:
        error = rng.choice([-1.0, 1.0], rows) * (size if channel == channels[0] else 1.0)
        for word in words:
            frame[f"{channel}_{word}"] = error if word == "before" else 0.1 * error
    return frame, where(frame, dict.fromkeys(channels, "N"), words)


def test_the_greatest_bin_of_each_place_is_found_with_its_size_there_and_elsewhere():
    frame, table = made()
    first, second = greatest(table[table["channel"] == "Fz"])
    assert (first.place, second.place) == ("height", "heading")
    assert first.low == pytest.approx(0.0, abs=0.01) and first.high == pytest.approx(0.25, abs=0.02)
    inside = frame["height"].between(first.low, first.high)
    rms = [np.sqrt(np.mean(frame.loc[i, "Fz_before"] ** 2)) for i in (inside, ~inside)]
    assert (first.there, first.elsewhere) == pytest.approx(rms, rel=0.01)
    assert first.times == pytest.approx(3.0, rel=0.05)


def test_the_table_names_places_in_their_units_and_what_is_alike_everywhere():
    _, table = made()
    text = table_of({"forces": table}, 0.5)
    assert '<th scope="row">vertical force, N</th>' in text and "<td>height 0 to 0.24 m</td>" in text
    assert "<td>heading 134 to 180 deg</td>" in text  # an eighth of a turn, of rows that are not quite even
    assert "Nowhere that much greater: roll moment." in text
    alone = table_of({"forces": table[table["channel"] == "Mx"]}, 0.5)
    assert "<table" not in alone and "No error is 1.5 times as large in one place as elsewhere." in alone
    assert table_of({}, 0.5) == ""
    one = table[(table["channel"] == "Fz") & (table["low"] < 0.1) & (table["where"] == "height")]
    assert greatest(one) == []  # a single bin has no elsewhere


def test_of_simulations_the_horizon_nearest_to_the_page_s_is_told_driven_by_measured_rotor_speeds():
    _, table = made(channels=("velocity", "velocity x"))
    faint = table.assign(rms_before=1.0)
    parts = [t.assign(driven=line, horizon=h) for line, h, t in
             (("rollouts", 0.1, faint), ("rollouts", 0.6, table), ("rollouts", 1.0, faint),
              ("rollouts from commands", 0.6, faint))]  # fmt: skip
    text = table_of({"rollouts": pd.concat(parts)}, 0.5)
    assert text.count(">velocity, N, simulated for 0.6 s</th>") == 1 and "height" in text
    assert "forward" not in text  # along the axes is in the table of the file
    assert table_of({"rollouts": pd.concat(parts[3:])}, 0.5) == ""


def test_the_page_holds_all_levels_in_their_order():
    _, table = made()
    sensors = made(channels=("north", "p"))[1]
    text = page(document(), KNOWN, None, {}, {"forces": table, "sensors": sensors})
    part = text[text.index("Where the errors live") :]
    assert part.index("northward acceleration") < part.index("vertical force")
    assert "Where the errors live" not in page(document(), KNOWN, None, {})
