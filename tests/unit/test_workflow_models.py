"""What the rules learn of a project folder's models."""

import json
from pathlib import Path

import pytest
from three_flights import MODEL, edit, edit_model, lay_folder

from quasi.errors import ConfigError, ExpressionError, LogbookError, QuasiError
from quasi.project.workflow import Folder


@pytest.fixture
def folder(tmp_path):
    return lay_folder(tmp_path)


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


@pytest.mark.parametrize(
    ("sections", "facts"),
    [
        ({"logging_file": {"rows of flights to use (all)": [2, 99]}}, ("row 99 ", "data/log.csv", "2-4")),
        ({"logging_file": {"rows of flights to use (all)": [2, 3]}}, ("validation row 4 ",)),
        ({"identification_parameters": {"polynomial specification file": "phisical"}}, ("'physical.json'",)),
        ({"identification_parameters": {"polynomial": {"regressor cap": "3"}}}, ("'regressor cap' is '3'", "whole")),
    ],
    ids=["row out of range", "validation row", "specification file", "wrong type"],
)
def test_faults_of_selection_specification_and_type_name_file_and_remedy(folder, sections, facts):
    edit_model(folder, **sections)
    project = Folder(folder)
    with pytest.raises(QuasiError) as error:
        project.model_jobs.axis("m", project.model_jobs.axes("m")[0])
        project.logbooks.model_flights("m")
    assert "config/models/m.json" in str(error.value) and all(fact in str(error.value) for fact in facts)


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
    with pytest.raises(
        ConfigError, match=r"m.json: row 2 of .*/data/log.csv and row 4 of .*/data/log.csv have the same recording"
    ):
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
    assert project.model_jobs.changed_selection("m") == []
    made = folder / "results/identified/m/shared.json"
    made.parent.mkdir(parents=True)
    made.write_text(json.dumps({"flights": {"training": ["a", "x"]}}))
    (said,) = project.model_jobs.changed_selection("m")
    assert "now mean the training flights a, b; it was made from a, x" in said


@pytest.mark.parametrize("before", [{"training": ["a"], "selected": ["a", "b"]}, {"training": ["a"]}])
def test_an_unusable_training_flight_is_no_changed_selection(folder, before):
    made = folder / "results/identified/m/shared.json"
    made.parent.mkdir(parents=True)
    made.write_text(json.dumps({"flights": before}))
    assert Folder(folder).model_jobs.changed_selection("m") == []


def test_a_row_added_to_the_selection_is_a_changed_selection(folder):
    made = folder / "results/identified/m/shared.json"
    made.parent.mkdir(parents=True)
    made.write_text(json.dumps({"flights": {"training": ["a"], "selected": ["a"]}}))
    (said,) = Folder(folder).model_jobs.changed_selection("m")
    assert said.endswith("now mean the training flights a, b; it was made from a and will be identified anew")


def test_another_validation_flight_is_a_changed_selection(folder):
    made = folder / "results/parts/standalone/m/model.json"
    made.parent.mkdir(parents=True)
    made.write_text(json.dumps({"flights": {"training": ["a"], "validation": ["c"]}}))
    assert Folder(folder).model_jobs.changed_selection("m") == []
    made.write_text(json.dumps({"flights": {"training": ["a"], "validation": ["x"]}}))
    (said,) = Folder(folder).model_jobs.changed_selection("m")
    words = "model m: the selected rows now mean the validation flights c; it was judged by x and will be judged anew"
    assert said == words


@pytest.mark.parametrize(
    "odd", [[], {}, {"flights": None}, {"flights": {"selected": 3, "training": [[]], "validation": [1]}}]
)
def test_an_odd_file_of_an_earlier_run_is_no_changed_selection(folder, odd):
    for path in ("results/identified/m/shared.json", "results/parts/standalone/m/model.json"):
        (folder / path).parent.mkdir(parents=True)
        (folder / path).write_text(json.dumps(odd))
    assert Folder(folder).model_jobs.changed_selection("m") == []


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
