"""What the rules learn of a project folder: flights, logbooks, quadrotors, settings."""

import json
import shutil
from pathlib import Path

import pytest
from three_flights import HEADER, ROOT, edit, edit_model, lay_folder

from quasi.command import main
from quasi.errors import ConfigError, LogbookError
from quasi.project.folder import check_project, check_settings, check_writable, read_settings
from quasi.project.workflow import Folder


@pytest.fixture
def folder(tmp_path):
    return lay_folder(tmp_path)


def test_raw_files_are_found_by_any_usual_ending_binary_before_decoded(folder):
    project = Folder(folder)
    found = {k: project.recordings.importing("Beetle", k)["flight"]["onboard"] for k in "abc"}
    assert found == {"a": "data/raw/a.bbl", "b": "data/raw/b.csv", "c": "data/raw/c.BFL"}


def test_data_prefix_is_replaced_for_raw_files_but_the_folders_own_configuration_stays(folder, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    shutil.move(folder / "data/raw", elsewhere / "raw")
    settings = Folder(folder, data=elsewhere).recordings.importing("Beetle", "a")
    assert settings["flight"]["onboard"] == str(elsewhere / "raw/a.bbl")
    assert settings["problem"] is None


def test_a_raw_file_that_is_absent_under_data_tells_of_the_setting_that_names_another_place(folder, tmp_path_factory):
    shutil.rmtree(folder / "data/raw")
    problem = Folder(folder).recordings.importing("Beetle", "a")["problem"]
    assert "`--config data=PATH`" in problem
    problem = Folder(folder, data=tmp_path_factory.mktemp("elsewhere")).recordings.importing("Beetle", "a")["problem"]
    assert "does not exist" in problem and "--config" not in problem


def test_a_logbook_and_a_quadrotor_that_are_nowhere_are_told_where_they_belong(folder, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    shutil.move(folder / "data/raw", elsewhere / "raw")
    shutil.move(folder / "data/my_quadrotor.json", elsewhere / "my_quadrotor.json")
    assert Folder(folder, data=elsewhere).recordings.importing("Beetle", "a")["problem"] is None  # the other folder's
    (elsewhere / "my_quadrotor.json").unlink()
    problem = Folder(folder, data=elsewhere).recordings.importing("Beetle", "a")["problem"]
    assert f"data/my_quadrotor.json does not exist, nor does {elsewhere}/my_quadrotor.json" in problem
    shutil.move(folder / "data/log.csv", elsewhere / "log.csv")
    assert Folder(folder, data=elsewhere).logbooks.model_flights("m")
    (elsewhere / "log.csv").unlink()
    with pytest.raises(ConfigError, match=r"logbook data/log.csv does not exist, nor does .*elsewhere.*log.csv"):
        Folder(folder, data=elsewhere).logbooks.model_flights("m")
    with pytest.raises(ConfigError, match=r"logbook data/log.csv does not exist( \(|; )"):
        Folder(folder).logbooks.model_flights("m")


def test_flights_settings_hold_its_own_row_only(folder):
    before = {k: Folder(folder).recordings.importing("Beetle", k) for k in "abc"}
    edit(folder, "Beetle,b,data/raw,betaflight,my_quadrotor,data,N", "Beetle,b,data/raw,betaflight,my_quadrotor,data,Y")
    after = {k: Folder(folder).recordings.importing("Beetle", k) for k in "abc"}
    assert before["a"] == after["a"]
    assert before["c"] == after["c"]
    assert "'Raw OptiTrack Name' is empty" in after["b"]["problem"]


def test_mass_is_grams_in_the_logbook_and_else_the_quadrotors(folder):
    edit(
        folder,
        "Beetle,a,data/raw,betaflight,my_quadrotor,data,N,,,433",
        "Beetle,a,data/raw,betaflight,my_quadrotor,data,N,,,450",
    )
    edit(
        folder,
        "Beetle,b,data/raw,betaflight,my_quadrotor,data,N,,,433",
        "Beetle,b,data/raw,betaflight,my_quadrotor,data,N,,,",
    )
    masses = {k: Folder(folder).recordings.filtering("Beetle", k)["mass"] for k in "abc"}
    assert masses == {"a": pytest.approx(0.450), "b": pytest.approx(0.433), "c": pytest.approx(0.433)}


def test_the_folder_lists_what_is_usually_asked_for(folder):
    targets = Folder(folder).targets()
    assert "models/m/standalone" in targets and "processing" in targets
    assert "results/gaps/my_gap" in targets and "results/simulations/my_simulation" in targets


def test_files_that_systems_leave_beside_a_configuration_are_no_models(folder):
    (folder / "config/models/._m.json").write_bytes(b"\0\5")
    assert Folder(folder).configuration.models == ["m"]


def test_flight_whose_name_cannot_be_a_target_fails_alone(folder):
    edit(folder, "Beetle,b,", "Beetle,flight b,")
    edit(folder, "Beetle,c,", ",c,")
    project = Folder(folder)
    rows = {r.number: r for r in project.logbooks.model_flights("m")}
    assert "'flight b' cannot name a flight" in project.recordings.importing("Beetle", rows[3].key)["problem"]
    assert "row 4: 'Quadrotor' is empty" in project.recordings.importing(rows[4].quadrotor, "c")["problem"]
    assert project.recordings.importing("Beetle", "a")["problem"] is None


@pytest.mark.parametrize("mass", ["-433", "0", "0.433", "1e9"])
def test_mass_of_no_quadrotor_is_refused_with_its_row(folder, mass):
    edit(
        folder,
        "Beetle,a,data/raw,betaflight,my_quadrotor,data,N,,,433",
        f"Beetle,a,data/raw,betaflight,my_quadrotor,data,N,,,{mass}",
    )
    value, problem = Folder(folder).recordings.mass(Folder(folder).logbooks.row("Beetle", "a"))
    assert value is None
    assert "data/log.csv row 2, flight a: 'Mass' is" in problem
    assert "the column holds grams" in problem


@pytest.mark.parametrize("mass", ["433", "-1", "abc", "nan"])
def test_mass_of_a_quadrotor_configuration_is_checked_too(folder, mass):
    edit(folder, ",433,", ",,")
    path = folder / "data/my_quadrotor.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "mass": mass}))
    value, problem = Folder(folder).recordings.mass(Folder(folder).logbooks.row("Beetle", "a"))
    assert value is None
    assert "my_quadrotor" in problem
    assert f"'mass' is '{mass}'" in problem


def test_empty_cells_and_names_that_no_file_can_have_are_sentences(folder):
    edit(folder, "Beetle,a,data/raw,betaflight,my_quadrotor,data", "Beetle,a,data/raw,betaflight,,")
    edit(folder, "Beetle,b,data/raw", f"Beetle,b,{'x' * 5000}")
    project = Folder(folder)
    assert "'Drone Config File' is empty" in project.recordings.importing("Beetle", "a")["problem"]
    assert "does not exist" in project.recordings.importing("Beetle", "b")["problem"]


def test_processing_an_empty_logbook_says_what_to_add(folder):
    (folder / "data/log.csv").write_text(HEADER + "\n")
    with pytest.raises(LogbookError, match="holds no flights yet; add one row"):
        Folder(folder).logbooks.processing_flights()


@pytest.mark.parametrize(
    ("header", "cells", "alike"),
    [
        (",Comments,Weather", ",calm,rain", True),
        (",Video,Flight ID,Comments", ",a.mp4,7,", True),
        (",Session", ",monday", False),
        (",Has OJF data,Static wind (m/s)", ",,3", False),
    ],
)
def test_a_flight_of_two_logbooks_may_differ_in_cells_that_nothing_reads(folder, header, cells, alike):
    text = (folder / "data/log.csv").read_text().splitlines()
    (folder / "data/other.csv").write_text("\n".join([text[0] + header, *[line + cells for line in text[1:]]]) + "\n")
    edit_model(folder, logging_file={"filename": "other"})
    if alike:
        assert Folder(folder).recordings.importing("Beetle", "a")["problem"] is None
    else:
        with pytest.raises(LogbookError, match=r"log.csv row 2 and .*other.csv row 2 both mean flight 'a'"):
            Folder(folder).recordings.importing("Beetle", "a")


def test_a_campaign_that_was_removed_says_what_to_do_with_its_flights(folder):
    (folder / "config/synthesis").mkdir(exist_ok=True)
    with pytest.raises(ConfigError) as error:
        Folder(folder).configuration.made_flight("gone", "a")
    assert "config/synthesis/gone.json does not exist" in str(error.value)
    assert "put it back, or move its flights from results/synthesis/gone into data/" in str(error.value)


def test_one_quadrotor_configuration_is_one_however_it_is_written(folder):
    edit(
        folder,
        "Beetle,b,data/raw,betaflight,my_quadrotor,data",
        "Beetle,b,data/raw,betaflight,my_quadrotor.json,./data/",
    )
    assert Folder(folder).model_jobs.identification("m")["quadrotor"]["file"] == "my_quadrotor"
    (folder / "data/old").mkdir()
    shutil.copy(folder / "data/my_quadrotor.json", folder / "data/old")
    edit(folder, "my_quadrotor.json,./data/", "my_quadrotor,data/old")
    with pytest.raises(ConfigError, match="several quadrotor configurations .*data/old/my_quadrotor.json"):
        Folder(folder).model_jobs.identification("m")


def test_folder_without_models_is_told_so(folder):
    (folder / "config/models/m.json").unlink()
    with pytest.raises(ConfigError, match="config/models holds no model; run snakemake in a project folder"):
        Folder(folder).configuration.every_model()
    shutil.copy(ROOT / "config/models/example.json", folder / "config/models/my model.json")
    with pytest.raises(ConfigError, match="my model.json: a model ID may hold"):
        Folder(folder).configuration.every_model()


def test_settings_of_snakemake_may_be_absent_or_comments_alone(tmp_path):
    path = tmp_path / "config.yaml"
    assert read_settings(path) == {}
    for text, settings in (("# nothing\n", {}), ("data: /a b/c\n", {"data": "/a b/c"}), ("{}", {})):
        path.write_text(text)
        assert read_settings(path) == settings


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not valid"),
        ("a: 1\ndata: {", "not valid YAML at line"),
        ("data: [a]", "expected `data:"),
        ("abc", "expected"),
    ],
)
def test_faulty_settings_of_snakemake_name_the_file(tmp_path, text, words):
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(ConfigError, match=f"config.yaml.*{words}"):
        read_settings(tmp_path / "config.yaml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Data: /x\n", "unknown key 'Data' (did you mean 'data'?); correct or remove it"),
        ("data: /x\ndta: /y\n", "unknown key 'dta' (did you mean 'data'?)"),
        ("cores: 4\n", "unknown key 'cores' (known are 'data')"),
        ("7: 4\n", "unknown key '7'"),
    ],
)
def test_settings_that_nothing_reads_are_refused(tmp_path, text, words):
    path = tmp_path / "config.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as error:
        read_settings(path)
    assert str(error.value).startswith(f"{path}: {words}")
    check_settings(["data"], "--config")
    with pytest.raises(ConfigError, match="--config: unknown key 'dta'"):
        check_settings(["dta"], "--config")


@pytest.mark.parametrize(
    ("key", "value"),
    [("motor poles", 13), ("moment of inertia", "[nan, 0, 0; 0, 1, 0; 0, 0, 1]"), ("rotor radius", 0)],
)
def test_fault_of_a_quadrotor_configuration_names_its_file_and_the_row_that_uses_it(folder, key, value):
    path = folder / "data/my_quadrotor.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    problem = Folder(folder).recordings.importing("Beetle", "a")["problem"]
    assert f"data/log.csv row 2, flight a: data/my_quadrotor.json: '{key}'" in problem


def test_a_folder_that_cannot_be_written_is_a_sentence(tmp_path, monkeypatch):
    check_writable(tmp_path)
    (tmp_path / "results").mkdir()
    monkeypatch.setattr("os.access", lambda path, mode: Path(path).name != "results")
    with pytest.raises(ConfigError, match="nothing can be written into .*results; change its permissions"):
        check_writable(tmp_path)
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(ConfigError, match="nothing can be written into .*change its permissions"):
        check_writable(tmp_path)
    (tmp_path / "results").rmdir()
    (tmp_path / "results").touch()
    monkeypatch.setattr("os.access", lambda path, mode: True)
    with pytest.raises(ConfigError, match="results is a file, expected a folder"):
        check_writable(tmp_path)


def test_a_mistyped_model_of_a_simulation_is_answered_with_models_that_were_put_there(folder):
    (folder / "models/beetle/standalone").mkdir(parents=True)
    (folder / "models/beetle/standalone/model.json").write_text("{}")
    (folder / "config/simulations").mkdir(exist_ok=True)
    (folder / "config/simulations/s.json").write_text(json.dumps({"model": {"model ID": "beetel"}}))
    with pytest.raises(ConfigError, match=r"'model ID' is 'beetel'.*did you mean 'beetle'"):
        Folder(folder).simulation("s")


def test_the_path_of_a_model_that_was_put_there_is_the_same_wherever_the_folder_lies(folder, tmp_path_factory):
    (folder / "models/beetle/standalone").mkdir(parents=True)
    (folder / "models/beetle/standalone/model.json").write_text("{}")
    rows = {"filename": "log", "rows of flights to compare (all)": ["2-4"], "rows of flights held out": [4]}
    configured = {"simulations": {"model": {"model ID": "beetle"}}, "gaps": {"model": "beetle", "logging file": rows}}
    for kind, document in configured.items():
        (folder / f"config/{kind}").mkdir(exist_ok=True)
        (folder / f"config/{kind}/s.json").write_text(json.dumps(document))
    moved = tmp_path_factory.mktemp("elsewhere") / "project"
    shutil.copytree(folder, moved)
    for place in (folder, moved):
        project = Folder(place)
        paths = {project.model_jobs.portable("beetle"), project.simulation("s")["model"], project.gaps.model_path("s")}
        assert paths == {"models/./beetle/standalone/model.json"}
        assert project.given(paths) == list(paths) and (place / paths.pop()).is_file()
        assert project.given([project.model_jobs.portable("m")]) == []  # a rule makes it


@pytest.mark.parametrize(
    ("change", "fact"),
    [
        ({"wnd": {}}, "unknown key 'wnd' (did you mean 'wind'?)"),
        ({"model": {"model ID": "maid"}}, "neither config/models/maid.json nor models/maid/standalone/model.json"),
        ({"wind": {"file": "data/wnd.csv"}}, "data/wnd.csv does not exist"),
    ],
)
def test_a_faulty_simulation_names_its_file_and_the_fault(folder, change, fact):
    (folder / "config/simulations").mkdir(exist_ok=True)
    (folder / "config/simulations/s.json").write_text(json.dumps({"model": {"model ID": "m"}, **change}))
    with pytest.raises(ConfigError) as error:
        Folder(folder).simulation("s")
    assert fact in str(error.value)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda place: None, "does not exist"),
        (lambda place: (place / ".snakemake").mkdir(parents=True), "is empty"),
        (lambda place: (place / "data").mkdir(parents=True), "holds neither config/ nor models/"),
    ],
    ids=["absent", "as snakemake makes it", "another folder"],
)
def test_a_slip_in_the_folder_names_it_and_what_belongs_there(tmp_path, capsys, make, words):
    place = tmp_path / "my_lap"
    make(place)
    with pytest.raises(ConfigError, match=f"my_lap is no project folder: it {words}, expected config/ with the"):
        check_project(place)
    assert main(["margins", "-d", str(place), "mine"]) == 1
    assert "my_lap is no project folder" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["config", "models"])
def test_a_folder_of_a_configuration_or_of_models_alone_is_a_project(tmp_path, name):
    (tmp_path / name).mkdir()
    check_project(tmp_path)
