"""What the rules learn of a project folder."""

import json
import shutil
from pathlib import Path

import pytest

from quasi.command import main
from quasi.errors import ConfigError, ExpressionError, LogbookError, QuasiError
from quasi.project.folder import check_project, check_writable, read_settings
from quasi.project.workflow import Folder

ROOT = Path(__file__).parents[2]
MODEL = {
    "logging file": {"filename": "log", "rows of flights to use (all)": ["2-4"], "rows of flights for validation": [4]},
    "identification parameters": {"polynomial specification file": "physical"},
}
HEADER = "Quadrotor,Onboard Name,OB Path,Flight controller,Drone Config File,Drone Config Path,Has OT data"
HEADER += ",Raw OptiTrack Name,Raw OT Path,Mass,Batteries"


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(ROOT / "config/template", tmp_path, dirs_exist_ok=True)
    (tmp_path / "config/models/my_model.json").unlink()
    (tmp_path / "config/models/m.json").write_text(json.dumps(MODEL))
    (tmp_path / "config/processing.json").write_text(json.dumps({"logging file": {"filename": "log"}}))
    rows = [f"Beetle,{n},data/raw,betaflight,my_quadrotor,data,N,,,433,4S" for n in "abc"]
    (tmp_path / "data/log.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    for name in ("a.bbl", "a.csv", "b.csv", "c.BFL"):
        (tmp_path / "data/raw" / name).touch()
    return tmp_path


def edit(folder, old, new):
    path = folder / "data/log.csv"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def edit_model(folder, **sections):
    path = folder / "config/models/m.json"
    document = json.loads(path.read_text())
    for name, values in sections.items():
        document.setdefault(name.replace("_", " "), {}).update(values)
    path.write_text(json.dumps(document))


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


def test_training_and_validation_flights_are_disjoint(folder):
    project = Folder(folder)
    assert [r.key for r in project.logbooks.model_flights("m", "training")] == ["a", "b"]
    assert [r.key for r in project.logbooks.model_flights("m", "validation")] == ["c"]


@pytest.mark.parametrize(
    ("given", "kind"), [("data/processed/filtered/noGravity", "noGravity"), ("withGravity/", "withGravity")]
)
def test_kind_of_force_is_the_last_part_of_the_manuals_folder(folder, given, kind):
    path = folder / "config/models/m.json"
    path.write_text(json.dumps({**MODEL, "filtered data save directory": given}))
    assert Folder(folder).configuration.gravity("m") == kind


def test_candidate_file_of_the_project_comes_before_the_standard_one(folder):
    assert "w_avg" in json.dumps(Folder(folder).model_jobs.specification("m")[1])
    own = {"Fx": {"fixed": ["u"]}}
    (folder / "config/polynomials/physical.json").write_text(json.dumps(own))
    path, document = Folder(folder).model_jobs.specification("m")
    assert path == Path("config/polynomials/physical.json")
    assert document["Fx"]["fixed"] == ["u"]
    with pytest.raises(ConfigError, match=r"physical\.json holds no section 'Fy'"):
        Folder(folder).model_jobs.axis("m", "Fy")


def test_scales_of_the_non_dimensional_scheme_are_candidates_of_a_normalised_model_alone(folder):
    document = {"Fz": {"fixed": ["F_den"], "candidates": [{"vars": ["|M_den|"], "degree": 1, "sets": ["M_den^0.5"]}]}}
    (folder / "config/polynomials/mine.json").write_text(json.dumps(document))
    edit_model(folder, identification_parameters={"polynomial specification file": "mine"})
    with pytest.raises(
        ExpressionError, match=r"mine\.json, Fz, fixed: 'F_den' is a scale of non-dimensional models \("
    ):
        Folder(folder).model_jobs.axis("m", "Fz")
    edit_model(folder, data_normalization={"normalize data": True})
    assert Folder(folder).model_jobs.axis("m", "Fz")["specification"]["fixed"] == ["F_den"]


@pytest.mark.parametrize(
    "axis, sentence",
    [
        ({"fixed": ["w_tott"]}, r"mine\.json, Fz, fixed: unknown variable 'w_tott' \(did you mean 'w_tot'"),
        ({"candidates": [{"vars": ["u", "sin[rol]"], "degree": 1}]}, r"entry 1, vars: .*'sin\[rol\]'.*'roll'"),
        ({"candidates": [{"vars": ["u"], "degree": 1, "sets": [1, "(" * 10_000 + "u" + ")" * 10_000]}]}, "nested"),
        ({"candidates": [{"vars": ["__import__('os')"], "degree": 1}]}, "nothing can be called"),
    ],
)
def test_an_expression_that_means_nothing_is_refused_before_anything_runs(folder, axis, sentence):
    document = {a: {"fixed": ["u", "|battery_voltage|"]} for a in ("Fx", "Fy", "Mx", "My", "Mz")} | {"Fz": axis}
    (folder / "config/polynomials/mine.json").write_text(json.dumps(document))
    edit_model(folder, identification_parameters={"polynomial specification file": "mine"})
    with pytest.raises(ExpressionError, match=sentence) as error:
        Folder(folder).model_jobs.axis("m", "Fx")
    assert "\n" not in str(error.value)


def test_path_of_the_manuals_candidate_file_means_the_standard_one_of_that_name(folder):
    name = "polyCands_DiffSys_quadraticU_symmetric_SIMPLE_FM.json"
    given = {"polynomial specification file": f"droneidentification/polynomialCandidates/{name}"}
    edit_model(folder, identification_parameters=given)
    assert Folder(folder).model_jobs.specification("m")[0].name == name


def test_an_axis_depends_on_its_own_switches_only(folder):
    before = {a: Folder(folder).model_jobs.axis("m", a) for a in ("Fx", "Fy")}
    edit_model(folder, identification_parameters={"add bias term fx": False})
    after = {a: Folder(folder).model_jobs.axis("m", a) for a in ("Fx", "Fy")}
    assert before["Fy"] == after["Fy"]
    assert before["Fx"] != after["Fx"]


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"saving_models": {"model ID": "other"}}, "'model ID' is 'other', but the file's name says 'm'"),
        ({"logging_file": {"rows of flights for validation": ["2-4"]}}, "leave at least one for training"),
        (
            {"identification_parameters": {f"identify {a}": False for a in ("fx", "fy", "fz", "mx", "my", "mz")}},
            "every 'identify ...' is false",
        ),
        (
            {"standalone": {"make moment DiffSys": True, "DiffSys u": ["U_p", "Uq"]}},
            r"'standalone' / 'DiffSys u': unknown input 'Uq' of the differential form.*mean 'U_q'",
        ),
        ({"standalone": {"make moment DiffSys": True, "DiffSys u": []}}, "needs at least one input"),
        (
            {"standalone": {"DiffSys u": []}, "matlab": {"make moment DiffSys": True}},
            "'matlab'.*needs at least one input",
        ),
        ({"matlab": {"DiffSys u": ["U_p", "w1"]}}, r"'matlab' / 'DiffSys u': 'U_p' is made of 'w1'"),
    ],
)
def test_faults_of_a_model_name_file_and_key(folder, sections, message):
    edit_model(folder, **sections)
    with pytest.raises(ConfigError, match=message) as error:
        Folder(folder).model_jobs.identification("m")
    assert "config/models/m.json" in str(error.value)


def test_normalisation_and_differential_form_reach_their_jobs(folder):
    assert Folder(folder).model_jobs.axis("m", "Fx")["normalise"] is False
    assert Folder(folder).model_jobs.standalone("m") == {"file": "config/models/m.json", "u": None}
    chosen = {"make moment DiffSys": True, "DiffSys u": ["U_p", "U_r"]}
    edit_model(folder, data_normalization={"normalize data": True}, standalone=chosen)
    assert Folder(folder).model_jobs.axis("m", "Fx")["normalise"] is True
    assert Folder(folder).model_jobs.standalone("m")["u"] == ["U_p", "U_r"]


@pytest.mark.parametrize("key", ["idle RPM", "max RPM", "motor poles"])
def test_a_normalised_model_of_a_quadrotor_without_its_scales_is_refused_from_the_configuration(folder, key):
    path = folder / "data/my_quadrotor.json"
    quadrotor = json.loads(path.read_text())
    path.write_text(json.dumps({k: v for k, v in quadrotor.items() if k != key}))
    assert Folder(folder).model_jobs.identification("m")["model"] == "m"
    edit_model(folder, data_normalization={"normalize data": True})
    with pytest.raises(ConfigError, match=rf"config/models/m\.json: .*'{key}', which data/my_quadrotor\.json lacks"):
        Folder(folder).model_jobs.identification("m")
    path.write_text(json.dumps(quadrotor))
    assert Folder(folder).model_jobs.identification("m")["model"] == "m"


def test_flights_of_different_batteries_are_not_mixed(folder):
    edit(
        folder,
        "Beetle,a,data/raw,betaflight,my_quadrotor,data,N,,,433,4S",
        "Beetle,a,data/raw,betaflight,my_quadrotor,data,N,,,433,6S",
    )
    with pytest.raises(ConfigError, match=r"different 'Batteries' \(4S, 6S\).*'allow mixed batteries'"):
        Folder(folder).model_jobs.identification("m")


def test_different_batteries_are_mixed_when_the_model_says_so(folder):
    assert Folder(folder).model_jobs.identification("m")["mixed batteries"] == []
    edit(
        folder,
        "Beetle,a,data/raw,betaflight,my_quadrotor,data,N,,,433,4S",
        "Beetle,a,data/raw,betaflight,my_quadrotor,data,N,,,433,6S",
    )
    section = Folder(folder).configuration.model("m")["logging file"]
    edit_model(folder, **{"logging file": {**section, "allow mixed batteries": True}})
    assert Folder(folder).model_jobs.identification("m")["mixed batteries"] == ["4S", "6S"]


@pytest.mark.parametrize("content", ["one log", ""], ids=["a copy", "the same file"])
def test_a_recording_that_trains_is_not_held_out_under_another_name(folder, content):
    (folder / "data/raw/a.bbl").write_text("one log")
    (folder / "data/raw/b.csv").write_text("another")  # as long
    assert Folder(folder).model_jobs.identification("m")["flights"] == ["a", "b"]
    if content:
        (folder / "data/raw/c.BFL").write_text(content)
    else:
        header, *rows = (folder / "data/log.csv").read_text().splitlines()
        rows[2] = rows[2].replace(",c,", ",a,") + ",again"
        (folder / "data/log.csv").write_text("\n".join([header + ",Flight key", *rows]) + "\n")
    with pytest.raises(ConfigError, match=r"m.json: row 2 of log.csv and row 4 of log.csv have the same recording"):
        Folder(folder).model_jobs.identification("m")


@pytest.mark.parametrize("allowed", [False, True])
def test_the_battery_of_a_flight_that_is_held_out_changes_no_fit(folder, allowed):
    section = {**Folder(folder).configuration.model("m")["logging file"], "allow mixed batteries": allowed}
    edit_model(folder, **{"logging file": section})
    before = Folder(folder).model_jobs.identification("m")
    edit(
        folder,
        "Beetle,c,data/raw,betaflight,my_quadrotor,data,N,,,433,4S",
        "Beetle,c,data/raw,betaflight,my_quadrotor,data,N,,,433,6S",
    )
    assert Folder(folder).model_jobs.identification("m") == before


def test_isolation_is_handed_on_only_where_it_is_on(folder):
    edit_model(folder, **{"manoeuvre excitations": {"excitation threshold": 0.3}})
    assert Folder(folder).model_jobs.identification("m")["isolation"] is None
    edit_model(
        folder,
        **{"manoeuvre excitations": {"isolate to regions of excitation": True, "excitation threshold": 0.3}},
    )
    assert Folder(folder).model_jobs.identification("m")["isolation"] == {"excitation threshold": 0.3, "spread": 0.02}


def test_unknown_flight_names_the_nearest(folder):
    with pytest.raises(LogbookError, match="Beetle/d"):
        Folder(folder).logbooks.row("Beetle", "d")


def test_broken_model_does_not_stop_the_others(folder):
    (folder / "config/models/broken.json").write_text("{")
    assert Folder(folder).model_jobs.axes("m") == ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
    assert Folder(folder).recordings.importing("Beetle", "a")["problem"] is None


def test_selection_that_means_other_flights_than_the_model_was_made_from_is_told(folder):
    project = Folder(folder)
    assert project.model_jobs.changed_selection("m") is None
    made = folder / "results/identified/m/shared.json"
    made.parent.mkdir(parents=True)
    made.write_text(json.dumps({"flights": {"training": ["a", "x"]}}))
    assert "now mean the training flights a, b; it was made from a, x" in project.model_jobs.changed_selection("m")


def test_absent_logbook_is_told_with_the_configuration_that_names_it(folder):
    edit_model(folder, logging_file={"filename": "logg"})
    words = (
        r"config/models/m.json: logbook data/logg.csv does not exist .did you mean 'log.csv'\?.; correct 'directory'"
    )
    with pytest.raises(ConfigError, match=words):
        Folder(folder).logbooks.model_flights("m")


def test_absent_configuration_says_that_this_is_no_project_folder(folder):
    (folder / "config/processing.json").unlink()
    with pytest.raises(
        ConfigError, match="config/processing.json does not exist in .*; run snakemake in a project folder"
    ):
        Folder(folder).recordings.importing("Beetle", "a")


@pytest.mark.parametrize(
    "content", ["", "{", json.dumps({**MODEL, "logging file": {**MODEL["logging file"], "filename": "no"}})]
)
def test_a_broken_model_stops_itself_and_no_other(folder, content):
    (folder / "config/models/other.json").write_text(content)
    project = Folder(folder)
    assert project.recordings.importing("Beetle", "a")["problem"] is None
    with pytest.raises(QuasiError, match="other.json"):
        project.logbooks.model_flights("other")


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
