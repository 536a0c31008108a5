"""QuaSI's configuration files in a folder: each is recognised and its place named."""

import json
import shutil

import pytest

from quasi.errors import ConfigError
from quasi.project.folder import check_project
from quasi.project.misplaced_files import misplaced_files
from quasi.project.workflow import Folder

IDENTIFICATION = {"identification parameters": {}, "saving models": {"model ID": "HDBeetle_v2"}}


def put(folder, name, document):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document))


def test_a_folder_of_quasi_is_no_project_and_each_file_gets_its_place(tmp_path):
    put(tmp_path, "processConfig.json", {})
    put(tmp_path, "src/identificationConfig.json", IDENTIFICATION)
    put(tmp_path, "droneSimConfig.json", {})
    with pytest.raises(ConfigError) as refused:
        check_project(tmp_path)
    said = str(refused.value)
    assert "processConfig.json belongs in config/processing.json" in said
    assert "src/identificationConfig.json belongs in config/models/HDBeetle_v2.json" in said
    assert "droneSimConfig.json belongs in config/simulations/<name>.json" in said


def test_files_copied_into_config_under_their_old_names_are_named_where_their_place_is_empty(tmp_path):
    put(tmp_path, "config/processConfig.json", {})
    put(tmp_path, "config/identificationConfig.json", IDENTIFICATION)
    folder = Folder(tmp_path)
    for ask, lacking in (
        (lambda: folder.configuration.processing, "processing.json"),
        (folder.configuration.every_model, "config/models"),
    ):
        with pytest.raises(ConfigError) as refused:
            ask()
        assert lacking in str(refused.value)
        assert "config/identificationConfig.json belongs in config/models/HDBeetle_v2.json" in str(refused.value)


@pytest.mark.parametrize("content", ["{", "[1]", '{"saving models": 3, "identification parameters": {}}'])
def test_what_the_file_holds_or_lacks_breaks_nothing(tmp_path, content):
    (tmp_path / "identificationConfig.json").write_text(content)
    assert "belongs in config/models/<model ID>.json" in misplaced_files(tmp_path)


def test_a_file_under_a_name_of_ones_own_is_known_by_what_it_holds_and_others_are_left_alone(tmp_path):
    put(tmp_path, "config/beetle.json", {"data importing": {}, "data filtering": {}})
    put(tmp_path, "data/beetle_quad.json", {"rotor config": {}, "mass": 0.4})
    said = misplaced_files(tmp_path)
    assert "config/beetle.json belongs in config/processing.json" in said and "beetle_quad" not in said
    shutil.move(tmp_path / "config/beetle.json", tmp_path / "config/processing.json")
    assert misplaced_files(tmp_path) == ""
