"""What a folder says of its gaps: flights by role, names of extended models, and what is refused with a sentence."""

import json
import shutil
from pathlib import Path

import pytest

from quasi.errors import ConfigError, LogbookError, QuasiError
from quasi.project.same_recordings import recorded_twice, refuse_trained, same_recordings, unchecked
from quasi.project.workflow import Folder
from quasi.tables import list_recordings, list_telemetry_corrections, sha256_of

ROOT = Path(__file__).parents[2]
MODEL = {
    "logging file": {"filename": "log", "rows of flights to use (all)": ["2-3"]},
    "identification parameters": {"polynomial specification file": "physical"},
}
GAP = {
    "model": "m",
    "logging file": {
        "filename": "log",
        "rows of flights to compare (all)": ["4-6"],
        "rows of flights held out": [6],
        "rows of reference flights": [2],
    },
}
HEADER = "Quadrotor,Onboard Name,OB Path,Flight controller,Drone Config File,Drone Config Path,Has OT data,Mass"


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(ROOT / "config/template", tmp_path, dirs_exist_ok=True)
    (tmp_path / "config/models/my_model.json").unlink()
    (tmp_path / "config/models/m.json").write_text(json.dumps(MODEL))
    (tmp_path / "config/processing.json").write_text(json.dumps({"logging file": {"filename": "log"}}))
    (tmp_path / "config/gaps").mkdir(exist_ok=True)
    rows = [f"Beetle,{n},data/raw,betaflight,my_quadrotor,data,N,433" for n in "abcdef"]
    (tmp_path / "data/log.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    for n in "abcdef":
        (tmp_path / f"data/raw/{n}.bbl").write_text(n)
    write(tmp_path)
    return tmp_path


def write(folder, name="g", rows=None, **changes):
    document = {**GAP, **changes, "logging file": {**GAP["logging file"], **(rows or {})}}
    (folder / f"config/gaps/{name}.json").write_text(json.dumps(document))


def test_flights_have_one_role_each_and_the_extended_model_a_name(folder):
    project = Folder(folder)
    assert project.gaps.roles("g") == {"a": "reference", "c": "compared", "d": "compared", "e": "held out"}
    assert project.gaps.maker_of("m-g") == "g" and project.gaps.maker_of("m") is None
    assert project.gaps.model_path("g") == "models/m/standalone/model.json"
    assert project.gaps.gravity("g") == "withGravity"
    asked = project.gap("g")
    assert asked["settings"]["false alarm rate"] == 0.01 and asked["settings"]["material share"] == 0.05
    assert set(asked["trained"]) == {"Beetle/a", "Beetle/b"}
    assert project.model_jobs.roles("m-g") == {"training": ["a", "c", "d"], "validation": ["e"]}
    assert project.model_jobs.partitioning("m-g") == {"random partition": False}


def test_without_reference_rows_flights_that_trained_the_model_and_are_not_compared_stand_for_them(folder):
    write(folder, rows={"rows of reference flights": []})
    project = Folder(folder)
    assert project.gaps.references("g") == "training"
    assert project.gaps.roles("g") == {
        "a": "reference", "b": "reference", "c": "compared", "d": "compared", "e": "held out"
    }  # fmt: skip
    write(folder, rows={"rows of reference flights": [], "rows of flights to compare (all)": ["2-6"]})
    again = Folder(folder)  # the compared flights trained it: none is left beside them
    assert again.gaps.references("g") == "none" and "reference" not in again.gaps.roles("g").values()
    write(folder, rows={"rows of reference flights": [], "training flights as reference": False})
    assert Folder(folder).gaps.references("g") == "none"
    write(folder)
    assert Folder(folder).gaps.references("g") == "given"


def test_flights_of_a_gap_alone_are_known_to_the_folder(folder):
    header, *rows = (folder / "data/log.csv").read_text().splitlines()
    (folder / "data/other.csv").write_text("\n".join([header, rows[0].replace(",a,", ",z,")]) + "\n")
    (folder / "data/raw/z.bbl").touch()
    places = {"filename": "other", "rows of flights to compare (all)": [2], "rows of flights held out": [],
              "rows of reference flights": []}  # fmt: skip
    write(folder, rows=places)
    assert Folder(folder).recordings.importing("Beetle", "z")["flight"]["onboard"] == "data/raw/z.bbl"


def test_an_extended_model_may_be_compared_again_and_remembers_who_trained_it(folder):
    rows = {"rows of flights to compare (all)": [7], "rows of flights held out": [], "rows of reference flights": []}
    write(folder, "h", rows, model="m-g")
    project = Folder(folder)
    assert project.gaps.model_path("h") == "models/m-g/standalone/model.json"
    assert {r.key for r in project.gaps.trained("h")} == {"a", "b", "c", "d"}


@pytest.mark.parametrize(
    "rows, changes, sentence",
    [
        ({"rows of flights held out": [3]}, {}, "held-out row 3 is not among 'rows of flights to compare (all)'"),
        ({"rows of reference flights": [4]}, {}, "row 4 is compared and a reference flight"),
        ({"rows of flights to compare (all)": ["4-60"]}, {}, "row 8 is selected"),
        ({}, {"model": "mm"}, "neither config/models/mm.json nor models/mm/standalone/model.json exists"),
        ({}, {"extended model ID": "m"}, "config/models/m.json makes a model of that name"),
        ({}, {"extended model ID": "../m"}, "use at most 100 letters, digits"),
        ({}, {"effects": "al"}, "expected \"all\" or a list of ids"),
        ({}, {"horizon": [1]}, "unknown key 'horizon' (did you mean 'horizons'?)"),
        ({}, {"horizons": []}, "'horizons'"),
        ({}, {"false alarm rate": 0}, "'false alarm rate'"),
    ],
)  # fmt: skip
def test_a_faulty_configuration_is_told_in_one_sentence(folder, rows, changes, sentence):
    write(folder, "g", rows, **changes)
    with pytest.raises((ConfigError, LogbookError)) as told:
        Folder(folder).gaps.model_path("g")
        Folder(folder).gap("g")
    assert sentence in str(told.value) and "\n" not in str(told.value)


def test_an_extended_model_is_exported_with_the_settings_of_its_base(folder):
    for section, u in (({"DiffSys u": ["w1"]}, ["w1"]), ({}, ["U_q"]), ({"make moment DiffSys": False}, None)):
        model = {**MODEL, "matlab": section, "standalone": {"DiffSys u": ["U_q"]}}
        (folder / "config/models/m.json").write_text(json.dumps(model))
        assert (
            Folder(folder).model_jobs.matlab("m-g")
            == Folder(folder).model_jobs.matlab("m")
            == {"file": "config/models/m.json", "u": u}
        )
    write(folder, model="put_there")
    assert Folder(folder).model_jobs.matlab("put_there-g") == {"file": None, "u": ["U_p", "U_q", "U_r"]}


@pytest.mark.parametrize(
    "ident, changes, sentence",
    [
        ("m-g", {"horizon": [1]}, "config/gaps/g.json: unknown key 'horizon' (did you mean 'horizons'?)"),
        ("better", {"extended model ID": "better", "effects": ["drug"]}, "config/gaps/g.json: effect 'drug' is not in"),
        ("better", {"extended model": "better"}, "config/gaps/g.json: unknown key 'extended model'"),
    ],
)
def test_who_asks_for_an_extended_model_is_told_the_fault_of_its_gap(folder, ident, changes, sentence):
    write(folder, "g", **changes)
    for ask in (Folder(folder).gaps.maker_of, Folder(folder).model_jobs.portable):
        with pytest.raises(ConfigError) as told:
            ask(ident)
        assert sentence in str(told.value)


def test_a_gap_that_is_no_json_is_told_to_who_asks_for_its_model_alone(folder):
    write(folder, "g", **{"extended model ID": "better"})
    file = folder / "config/gaps/g.json"
    file.write_text(file.read_text().removesuffix("}"))
    with pytest.raises(QuasiError, match=r"config/gaps/g.json is not valid JSON"):
        Folder(folder).gaps.maker_of("better")
    project = Folder(folder)
    assert project.gaps.maker_of("m") is None and project.gaps.maker_of("other") is None
    with pytest.raises(ConfigError, match="neither config/models/other.json nor"):
        project.model_jobs.portable("other")
    write(folder, "h", model="other")  # a fault of its own is not that of another gap
    with pytest.raises(ConfigError, match="config/gaps/h.json: 'model' is 'other', but neither"):
        Folder(folder).gaps.model_path("h")


def test_an_extended_model_of_a_gap_that_is_faulty_since_is_not_taken_for_one_that_was_put_there(folder):
    write(folder, "g", horizon=[1])
    for ident, by in (("m-g", "gap g"), ("other-g", "gap elsewhere")):
        place = folder / f"models/{ident}/standalone/model.json"
        place.parent.mkdir(parents=True)
        place.write_text(json.dumps({"id": ident, "axes": {}, "provenance": {"extended from": "m", "by": by}}))
    with pytest.raises(ConfigError, match="config/gaps/g.json: unknown key 'horizon'"):
        Folder(folder).model_jobs.portable("m-g")
    assert Folder(folder).model_jobs.portable("other-g") == "models/./other-g/standalone/model.json"


def test_two_gaps_may_not_make_the_same_model(folder):
    write(folder, "h", **{"extended model ID": "m-g"})
    with pytest.raises(ConfigError, match="g.json and config/gaps/h.json both make the model 'm-g'"):
        Folder(folder).gaps.maker_of("m-g")


def test_models_may_not_extend_each_other_in_a_circle(folder):
    write(folder, "g", model="two", **{"extended model ID": "one"})
    write(folder, "h", model="one", **{"extended model ID": "two"})
    with pytest.raises(ConfigError, match="in a circle"):
        Folder(folder).gaps.model_path("g")


def test_an_unknown_gap_names_the_nearest(folder):
    write(folder, "hover")
    with pytest.raises(QuasiError, match=r"config/gaps/hoover.json does not exist \(did you mean 'hover'\?\)"):
        Folder(folder).configuration.gap("hoover")


def test_a_recording_that_trained_is_known_by_its_content_whatever_its_name(tmp_path):
    for name, text in {"a": "one", "b": "two", "copy": "one"}.items():
        (tmp_path / name).write_text(text)
    at = {name: [str(tmp_path / name), ""] for name in ("a", "b", "copy")}
    assert same_recordings({"row 4": at["copy"]}, {"row 2": at["a"], "row 3": at["b"]}) == ("row 4", "row 2")
    assert same_recordings({"row 4": at["b"]}, {"row 2": at["a"]}) is None
    # another log of the same file is another flight
    assert same_recordings({"row 4": [at["a"][0], "2"]}, {"row 2": [at["a"][0], "1"]}) is None
    # the same number, written in two ways
    for path in (at["a"][0], str(tmp_path / "absent")):
        assert recorded_twice({"row 2": [path, "1"], "row 4": [path, "01"]}) == ("row 2", "row 4")
    assert same_recordings({"row 4": [at["copy"][0], "02"]}, {"row 2": [at["a"][0], "2"]}) == ("row 4", "row 2")


NAMES = {"Q/h": "row 4"}


def put_there(tmp_path, **changes):
    """What a gap asks that holds out one log, and a model.json that the same recording under another name trained."""
    for name, text in {"held.bbl": "one", "other.bbl": "two"}.items():
        (tmp_path / name).write_text(text)
    asked = {"file": "config/gaps/g.json", "held": {"Q/h": [str(tmp_path / "held.bbl"), ""]},
             "held keys": {"Q/h": "h"}, "put there": True, "quadrotor": {"file": "Q"}}  # fmt: skip
    document = {"id": "m", "airframe": {"name": "Q"}, "flights": {"training": ["x"]},
                "recordings": {"x": {"sha256": sha256_of(tmp_path / "held.bbl"), "log": ""}}}  # fmt: skip
    return asked, document | changes


def test_a_model_tells_by_content_what_trained_it_wherever_it_is_put(tmp_path):
    asked, document = put_there(tmp_path)
    words = "held-out row 4 has the recording of flight x, which trained model m by its model.json; hold out a flight"
    for where in (True, False):
        with pytest.raises(ConfigError, match=words):
            refuse_trained(asked | {"put there": where}, document, NAMES)
    refuse_trained(asked | {"held": {"Q/h": [str(tmp_path / "other.bbl"), ""]}}, document, NAMES)
    # another log of the same file is another flight; which one is the longest is not known
    document["recordings"]["x"]["log"] = "1"
    refuse_trained(asked | {"held": {"Q/h": [str(tmp_path / "held.bbl"), "2"]}}, document, NAMES)
    for number in ("", None):
        document["recordings"]["x"]["log"] = number
        with pytest.raises(ConfigError, match=words):
            refuse_trained(asked | {"held": {"Q/h": [str(tmp_path / "held.bbl"), "2"]}}, document, NAMES)
    assert unchecked(asked, document) == []


@pytest.mark.parametrize("recordings", [{}, None, {"y": {"sha256": "0"}}, ["x"], {"x": "0"}])
def test_an_older_model_is_asked_by_the_names_of_its_flights_and_says_that_content_is_unknown(tmp_path, recordings):
    asked, document = put_there(tmp_path, recordings=recordings, flights={"training": ["h"]})
    with pytest.raises(ConfigError, match="row 4 is flight h, and a flight of that name trained model m, whose"):
        refuse_trained(asked, document, NAMES)
    refuse_trained(asked | {"put there": False}, document, NAMES)  # its rows are known, and compared by content
    refuse_trained(asked | {"quadrotor": {"file": "P"}}, document, NAMES)  # names are those of one quadrotor
    refuse_trained(asked | {"held keys": {"Q/h": "i"}}, document, NAMES)
    (said,) = unchecked(asked, document)
    assert said.startswith("whether a held-out flight trained model m could not be checked by content")
    assert unchecked(asked | {"put there": False}, document) == [] == unchecked(asked | {"held": {}}, document)
    for published in ({}, {"flights": None}, {"flights": ["h"]}, {"flights": {"training": 3}}):  # tells none, or oddly
        refuse_trained(asked, {"id": "m"} | published, NAMES)
        assert unchecked(asked, {"id": "m"} | published)


def test_a_model_keeps_the_recordings_of_flights_that_tell_them():
    onboard = {"sha256": "ab", "log": 2}
    made = {"a": {"imported": {"sources": {"onboard": onboard}}}, "b": {"imported": {"sources": {}}}, "c": {}}
    assert list_recordings(made) == {"a": {"sha256": "ab", "log": "2"}}
    del onboard["log"]
    assert list_recordings(made) == {"a": {"sha256": "ab", "log": ""}}


def test_a_flight_tells_whether_its_rotor_telemetry_was_set_right():
    told = {"a": {"applied": True}, "b": {"applied": False}, "c": None}
    made = {key: {"imported": {"rotor telemetry": about}} for key, about in told.items()} | {"older": {}, "d": {}}
    assert list_telemetry_corrections(made) == {"a": True, "b": False, "c": False}


def test_a_gap_knows_whether_its_model_was_put_there(folder):
    assert Folder(folder).gap("g")["put there"] is False
    assert Folder(folder).gap("g")["held keys"] == {"Beetle/e": "e"}
    place = folder / "models/given/standalone/model.json"
    place.parent.mkdir(parents=True)
    place.write_text(json.dumps({"axes": {"Fz": {"terms": [{"expression": "w_tot"}]}}}))
    write(folder, model="given")
    assert Folder(folder).gap("g")["put there"] is True


def test_a_model_put_there_with_an_unknown_variable_is_refused_before_anything_runs(folder):
    place = folder / "models/given/standalone/model.json"
    place.parent.mkdir(parents=True)
    place.write_text(json.dumps({"axes": {"Fz": {"terms": [{"expression": "U_p"}, {"expression": "w_tot*spede"}]}}}))
    write(folder, model="given")
    for ask in (Folder(folder).gaps.model_path, Folder(folder).gap):
        with pytest.raises(QuasiError, match=r"given/standalone/model.json, Fz, term 'w_tot\*spede': unknown variable"):
            ask("g")
    with pytest.raises(QuasiError, match="unknown variable 'spede'"):
        Folder(folder).model_jobs.portable("given")
