"""Project folders with odd names, CRLF line ends, or in another place: the same jobs and the same numbers."""

import json
import shutil

import numpy as np
import pytest
from reader_round_trips import ROUND_TRIPS
from test_workflow import edit, folder  # noqa: F401

from quasi import tables
from quasi.command import main
from quasi.errors import ConfigError
from quasi.project.folder import check_project
from quasi.project.workflow import Folder
from quasi.running.checksums import Checksums

NAMES = ["my flights 2026", r"C\drones\beetle", "Flüge (2), #1 100%", "a'b$(c);d"]
FLIGHTS = ("a", "b", "c")


def jobs_of(place):
    """What the rules learn of each flight and of the model, and the targets."""
    project = Folder(place)
    flights = {k: project.recordings.importing("Beetle", k) for k in FLIGHTS}
    trained = [(row.quadrotor, row.key) for row in project.logbooks.model_flights("m", "training")]
    return flights, project.configuration.model("m"), project.targets(), trained


def texts_of(place):
    return [p for p in place.rglob("*") if p.suffix in (".csv", ".json", ".yaml") and p.stat().st_size]


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_that_was_moved_has_the_same_jobs_so_that_nothing_reruns(folder, tmp_path_factory, name):  # noqa: F811
    before = jobs_of(folder)
    sums = Checksums(folder / "sums.json")
    digest = sums.compute(folder / "data/log.csv")
    moved = tmp_path_factory.mktemp("place") / name
    shutil.move(folder, moved)
    check_project(moved)
    assert jobs_of(moved) == before
    assert Checksums(moved / "sums.json").compute(moved / "data/log.csv") == digest


def test_crlf_line_ends_change_nothing(folder):  # noqa: F811
    before = jobs_of(folder)
    for path in texts_of(folder):
        path.write_bytes(path.read_bytes().replace(b"\r\n", b"\n").replace(b"\n", b"\r\n"))
    assert b"\r\n" in (folder / "config/models/m.json").read_bytes() + (folder / "data/log.csv").read_bytes()
    assert jobs_of(folder) == before


def test_backslashes_in_the_paths_of_a_logbook_are_slashes(folder):  # noqa: F811
    before = jobs_of(folder)
    edit(folder, "data/raw", "data\\raw")
    assert jobs_of(folder) == before


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("reader", ("crazyflie", "motive", "table", "gzip", "npz", "vicon"))
def test_recordings_in_odd_folders_are_read_sample_by_sample(tmp_path, name, reader):
    place = tmp_path / name
    place.mkdir(parents=True)
    ROUND_TRIPS[reader](np.random.default_rng(4), place)


@pytest.mark.parametrize("name", NAMES)
def test_tables_and_documents_in_odd_folders_come_back(tmp_path, name):
    place = tmp_path / name
    tables.write_json(place / "a b.json", {"name": name})
    assert tables.read_json(place / "a b.json") == {"name": name}
    tables.write_text(place / "t.csv", "t,u\r\n0,1\r\n1,2\r\n")
    assert tables.read_numbers(place / "t.csv")["u"].tolist() == [1.0, 2.0]


def check_refuses(place, capsys, *words, options=()):
    assert main(["check", str(place), *options]) != 0
    shown = capsys.readouterr()
    for word in (*words, "holds a brace, which Snakemake reads as a wildcard; rename the folder"):
        assert word in shown.out + shown.err


@pytest.mark.parametrize("name", ["fl{a}t", "{", "b}"])
def test_braces_in_a_path_of_recordings_are_refused_for_their_row(folder, capsys, name):  # noqa: F811
    (folder / "data/raw").rename(folder / "data" / name)
    edit(folder, "Beetle,b,data/raw", f"Beetle,b,data/{name}")
    problem = Folder(folder).recordings.importing("Beetle", "b")
    assert problem["flight"]["onboard"] is None
    check_refuses(folder, capsys, f"row 3, 'OB Path' and 'Onboard Name': the path data/{name}/b holds")


def test_braces_in_the_place_of_data_are_refused(folder, capsys):  # noqa: F811
    words = "'data' of --config or config/config.yaml: the path /mnt/{a} holds"
    check_refuses(folder, capsys, words, options=["--data", "/mnt/{a}"])
    (folder / "config/config.yaml").write_text("data: /mnt/{a}\n")
    check_refuses(folder, capsys, words)


def test_braces_in_the_place_of_the_project_are_refused(folder, capsys):  # noqa: F811
    place = folder.rename(folder.with_name("lab {2026}"))
    check_refuses(place, capsys, f"project folder: the path {place} holds")


def test_braces_in_the_files_of_a_simulation_are_refused(folder):  # noqa: F811
    for change in ({"wind": {"file": "data/{w}.csv"}}, {"model": {"model ID": "m", "model path": "mo{d}els"}}):
        (folder / "config/simulations").mkdir(exist_ok=True)
        (folder / "config/simulations/s.json").write_text(json.dumps({"model": {"model ID": "m"}, **change}))
        with pytest.raises(ConfigError, match="config/simulations/s.json, .* holds a brace"):
            Folder(folder).simulation("s")
