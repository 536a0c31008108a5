"""`quasi reach` and `quasi margins` in a project folder, and what they say when something is absent."""

import plain_plant as plain
import pytest

from quasi.command import main
from quasi.tables import read_json, read_table, write_json


@pytest.fixture
def folder(tmp_path):
    write_json(tmp_path / "models/made/standalone/model.json", plain.made_model().document)
    write_json(tmp_path / "config/simulations/first.json", {"model": {"model ID": "made"}, "noise": {"add": False}})
    return tmp_path


def test_reach_writes_positions_summary_and_figure(folder, capsys):
    assert main(["reach", "first", "-d", str(folder), "--horizon", "0.5", "--spacing", "60"]) == 0
    said = capsys.readouterr().out
    made = folder / "results/reach/first"
    summary = read_json(made / "summary.json")
    assert f"{summary['at the horizon']['extremes']['x']['max']:.2f} m" in said
    assert read_table(made / "positions.parquet")["t"].max() == pytest.approx(0.5)
    assert (made / "reach.png").stat().st_size > 10_000


def test_margins_prints_gains_and_margins(folder, capsys):
    assert main(["margins", "first", "-d", str(folder)]) == 0
    said = capsys.readouterr().out
    assert said.startswith("INDI on made") and "time constant" in said and "roll" in said


def test_raw_data_lies_where_the_folder_says(folder, tmp_path, capsys):
    away = tmp_path / "elsewhere"
    (folder / "config/config.yaml").write_text(f"data: {away}\n")
    write_json(folder / "config/simulations/windy.json",
               {"model": {"model ID": "made"}, "noise": {"add": False}, "wind": {"file": "data/wind.csv"}})  # fmt: skip
    assert main(["margins", "windy", "-d", str(folder)]) == 1
    assert f"{away}/wind.csv" in capsys.readouterr().err
    away.mkdir()
    (away / "wind.csv").write_text("t,wind_north,wind_east,wind_down\n0,1,0,0\n60,1,0,0\n")
    assert main(["margins", "windy", "-d", str(folder)]) == 0


@pytest.mark.parametrize("command", ["reach", "margins"])
def test_an_unknown_simulation_is_named(command, folder, capsys):
    assert main([command, "frist", "-d", str(folder)]) == 1
    assert "did you mean 'first'" in capsys.readouterr().err


def test_an_impossible_horizon_is_named(folder, capsys):
    assert main(["reach", "first", "-d", str(folder), "--horizon", "-1"]) == 1
    assert "the horizon is -1.0" in capsys.readouterr().err
