"""The job that draws the flights of a model: stills, an animation on demand, flights without a position."""

import importlib.util
from pathlib import Path

import pytest
from flights import flight
from PIL import Image

from quasi.errors import ConfigError
from quasi.tables import write_table

SCRIPT = Path(__file__).parents[2] / "scripts/standalone_trajectories.py"
QUADROTOR = {
    "file": "test",
    "rotor config": {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3},
    "rotor1 rotation direction": "CW",
    "b": 0.077,
    "rotor radius": 0.0381,
    "moment of inertia": "[8.65e-4, 0, 0; 0, 1.07e-3, 0; 0, 0, 1.71e-3]",
}
SETTINGS = {"quadrotor": QUADROTOR, "problem": None, "mass": 0.4, "stills": 3, "animate": False, "speed up": 10}


@pytest.fixture(scope="module")
def main():
    found = importlib.util.spec_from_file_location("standalone_trajectories", SCRIPT)
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module.main


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


def test_an_animation_only_when_the_configuration_asks(main, flights, tmp_path):
    main(flights[:1], {**SETTINGS, "animate": True}, str(tmp_path / "out"))
    made = {p.suffix: p.stat().st_size for p in (tmp_path / "out").iterdir()}
    assert set(made) in ({".png", ".mp4"}, {".png", ".gif"})
    assert min(made.values()) > 1000


def test_a_faulty_quadrotor_is_its_sentence(main, flights, tmp_path):
    with pytest.raises(ConfigError, match="broken"):
        main(flights, {**SETTINGS, "problem": "data/q.json is broken; mend it"}, str(tmp_path / "out"))
