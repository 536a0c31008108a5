"""The job that draws the flights of a model: stills, an animation on demand, flights without a position."""

import pytest
from airframes import BEETLE
from flights import flight
from PIL import Image
from programs import script

from quasi.errors import ConfigError
from quasi.tables import write_table

QUADROTOR = {"file": "test", **BEETLE}
SETTINGS = {"quadrotor": QUADROTOR, "problem": None, "mass": 0.4, "stills": 3, "animate": False, "speed up": 10}


@pytest.fixture(scope="module")
def main():
    return script("standalone_trajectories").main


@pytest.fixture
def flights(tmp_path):
    paths = []
    for seed, key in enumerate(("a", "b")):
        table = flight(seed, rows=1000)
        if key == "b":
            table = table.drop(columns=["x", "y", "z"])
        paths.append(str(tmp_path / f"{key}.parquet"))
        write_table(paths[-1], table)
    return paths


def test_a_picture_per_flight_and_a_warning_without_position(main, flights, tmp_path, caplog):
    main(flights, SETTINGS, str(tmp_path / "out"))
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["a.png"]
    assert Image.open(tmp_path / "out/a.png").convert("L").getextrema() != (255, 255)
    assert "flight b has no trajectory" in caplog.text


def test_an_integrated_position_is_not_drawn(main, tmp_path, caplog):
    used = {"velocity": {"source": "none"}, "position": {"source": "none"}}
    write_table(tmp_path / "drifts.parquet", flight(0, rows=1000), made={"noise": {"measurements": used}})
    main([str(tmp_path / "drifts.parquet")], SETTINGS, str(tmp_path / "out"))
    assert not list((tmp_path / "out").iterdir()) and "the integrated accelerometer drifts" in caplog.text


def test_an_animation_only_when_the_configuration_asks(main, flights, tmp_path):
    main(flights[:1], {**SETTINGS, "animate": True}, str(tmp_path / "out"))
    made = {p.suffix: p.stat().st_size for p in (tmp_path / "out").iterdir()}
    assert set(made) in ({".png", ".mp4"}, {".png", ".gif"})
    assert min(made.values()) > 1000


def test_a_faulty_quadrotor_is_its_sentence(main, flights, tmp_path):
    with pytest.raises(ConfigError, match="broken"):
        main(flights, {**SETTINGS, "problem": "data/q.json is broken; mend it"}, str(tmp_path / "out"))
