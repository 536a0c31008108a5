"""The scripts that draw and animate a simulation, on a simulation that has run."""

import pytest
from PIL import Image
from plain_plant import made_model
from programs import script

from quasi.pages import animation
from quasi.simulation.loop.run import simulate
from quasi.simulation.loop.setup import make_setup
from quasi.tables import write_json, write_table


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulated")
    model = made_model()
    settings = {"model": {"model ID": "made"}, "simulation": {"duration": 2.0}}
    settings |= {"faults": {"inject failure": True, "rotor health after failure": [0.0, 1, 1, 1]}}
    result = simulate(make_setup(settings, model, name="fault"))
    write_table(folder / "flight.parquet", result.table, result.units)
    write_json(folder / "summary.json", result.summary())
    write_json(folder / "model.json", model.document)
    return folder


def test_every_figure_becomes_a_file(made, tmp_path):
    main = script("simulation_figures").main
    main(made / "flight.parquet", made / "summary.json", made / "model.json", tmp_path / "figures")
    names = {"overview", "states", "rotor_speeds", "forces_and_moments", "trajectory", "tracking_error"}
    assert {p.stem for p in (tmp_path / "figures").glob("*.png")} == names


def test_without_an_encoder_the_animation_is_a_gif(made, tmp_path, monkeypatch):
    simulation_animation = script("simulation_animation")
    monkeypatch.setattr(simulation_animation, "can_write_mp4", lambda: False)
    monkeypatch.setattr(animation, "can_write_mp4", lambda: False)
    settings = {"save": True, "speed": 2.0, "frames per second": 10}
    simulation_animation.main(made / "flight.parquet", made / "model.json", "fault", settings, tmp_path / "animation")
    with Image.open(tmp_path / "animation" / "animation.gif") as image:
        assert image.n_frames == 11  # 2 s at twice the speed and 10 frames/s
