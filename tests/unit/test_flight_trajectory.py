"""Trajectory and animation of one filtered flight, without a model."""

import numpy as np
import pandas as pd
import pytest
from airframes import BEETLE
from flights import flight
from PIL import Image
from programs import script

from quasi.errors import ConfigError, DataError
from quasi.tables import read_fields, read_table, write_json, write_table

QUADROTOR = {"file": "test", **BEETLE}
SETTINGS = {"flight": "a-1", "quadrotor": QUADROTOR, "problem": None, "mass": 0.4, "stills": 3, "speed up": 4}


def sources(position):
    return {"noise": {"measurements": {"position": {"source": position}, "velocity": {"source": "capture position"}}}}


@pytest.fixture
def made(tmp_path):
    """Writes a flight of 2 s that stands on the ground for the first 0.2 s; gives the paths of its files."""

    def make(position="capture", lost=()):
        table = flight(0, rows=1000).assign(in_flight=1.0)
        table.loc[:99, "in_flight"] = 0.0
        table[list(lost)] = np.nan
        write_table(tmp_path / "a-1.parquet", table, {"x": ("m", "NED", "north")})
        write_json(tmp_path / "a-1.json", sources(position))
        return str(tmp_path / "a-1.parquet"), str(tmp_path / "a-1.json")

    return make


def test_figure_and_table_of_the_rows_in_flight(made, tmp_path):
    paths, table, figure = made(), tmp_path / "out/a-1.parquet", tmp_path / "out/a-1.png"
    script("trajectory").main(*paths, SETTINGS, str(table), str(figure))
    flown, whole = read_table(table), read_table(paths[0])
    pd.testing.assert_frame_equal(flown, whole.loc[100:, list(flown)].reset_index(drop=True))
    assert {"t", "x", "y", "z", "roll", "w4"} <= set(flown) and "Fx" not in flown
    assert read_fields(table)["x"]["unit"] == "m" and read_fields(table)["x"]["frame"] == "NED"
    assert Image.open(figure).convert("L").getextrema() != (255, 255)


def test_an_animation_lasts_as_long_as_the_flight_at_its_speed(made, tmp_path):
    target = tmp_path / "out/a-1.gif"
    script("trajectory_animation").main(*made(), SETTINGS, str(target))
    shown = 0
    with Image.open(target) as film:
        for k in range(film.n_frames):
            film.seek(k)
            shown += film.info["duration"]
    assert shown / 1000 == pytest.approx(1.8 / 4, abs=0.09)  # to two frames


@pytest.mark.parametrize("program, count", [("trajectory", 2), ("trajectory_animation", 1)])
@pytest.mark.parametrize("position, lost", [("none", ()), ("standing still", ()), ("capture", ("x", "roll"))])
def test_a_flight_without_position_is_refused_by_name(made, tmp_path, program, count, position, lost):
    targets = [tmp_path / "out/a-1.parquet", tmp_path / "out/a-1.png"][:count] if count > 1 else [tmp_path / "a-1.gif"]
    with pytest.raises(DataError, match="^flight a-1 has no trajectory"):
        script(program).main(*made(position, lost), SETTINGS, *map(str, targets))
    assert not any(t.exists() for t in targets)


def test_a_faulty_quadrotor_is_refused_first(made, tmp_path):
    with pytest.raises(ConfigError, match="no such airframe"):
        script("trajectory").main("none", "none", {**SETTINGS, "problem": "no such airframe"}, "t", "f")
