"""What the MATLAB export writes: one dialect, hostile text, what is refused, and the job that makes the folder."""

import io
import re
import shutil

import numpy as np
import pytest
from made_model import document
from matlab_models import GRAMMAR, ROOT, U, flown, octave
from programs import script
from scipy.io import loadmat

from quasi.errors import ConfigError, ExpressionError
from quasi.export.matlab import FILES, drone_parameters, write_matlab
from quasi.export.matlab_check import check_matlab
from quasi.export.matlab_terms import axis_file, expression
from quasi.model.model import Model
from quasi.project.workflow import Folder
from quasi.simulation.tools.portable import loop_constants, portable_setup
from quasi.tables import read_bytes, read_json, read_text, write_json
from quasi.terms.expressions import parse


def test_brackets_deeper_than_matlab_reads_are_refused(tmp_path):
    found = document()
    found["axes"]["Fx"]["terms"][0]["expression"] = "(u + v*" * 29 + "w" + ")" * 29
    with pytest.raises(ConfigError, match="Fx: term .* nests brackets deeper than MATLAB reads"):
        write_matlab(Model(found), tmp_path, None)
    assert not list(tmp_path.iterdir())


def test_parameters_keep_logged_limits_with_their_factor(tmp_path):
    model = flown()
    write_matlab(model, tmp_path, U)
    load = lambda name: loadmat(io.BytesIO(read_bytes(tmp_path / f"{name}.mat")), squeeze_me=True,  # noqa: E731
                                struct_as_record=False)[name]  # fmt: skip
    drone, about = load("droneParams"), load("modelParams")
    assert (drone.minRPM, drone.maxRPM) == (400.0, 750.0)
    assert drone.loggedToRadS == pytest.approx(100 * 2 * np.pi / 60 / 7)
    assert drone.wHover / drone.wHoverERPM == pytest.approx(drone.loggedToRadS)
    assert np.array_equal(drone.signMask, [[-1, -1, 1, 1], [-1, 1, -1, 1], [1, -1, -1, 1]])
    assert np.array_equal(drone.Iv, model.airframe.inertia) and drone.taus.shape == (4,)
    assert about.modelID == "m" and about.hasGravity == 1 and about.isNormalized == 0
    assert list(about.DiffSysInputs) == U


def test_time_constants_are_those_that_an_extension_found():
    slow = {**flown().document, "actuators": {"time constants": {"value": [0.03] * 4}, "delay": {"value": 0.01}}}
    assert np.array_equal(drone_parameters(Model(slow))["taus"], [[0.03] * 4])
    found = Model({**slow, "extensions": [{"id": "motor_lag", "actuators": {"time constant": 0.08}}]})
    assert np.array_equal(drone_parameters(found)["taus"], [[0.08] * 4])
    assert loop_constants(portable_setup(found))["time constants up"].tolist() == [0.08] * 4


def test_only_what_matlab_and_octave_share_is_written(tmp_path):
    loop = loop_constants(portable_setup(flown()))
    write_matlab(flown(), tmp_path, U, loop)
    for path in tmp_path.rglob("*.m"):
        for line in read_text(path).splitlines():
            code = re.sub(r"'[^']*'", "''", line.split("%")[0]) if "fprintf" not in line else ""
            assert not re.search(
                r'["#!]|\+\+|\+=|-=|\*=|\bend(function|if|for|while)\b|\bprintf\b|\bdo\b|\buntil\b', code
            ), f"{path.name}: {line}"
            assert len(line) <= 120 or path.name.startswith(("get_", "simParameters")), f"{path.name}: {line}"
        first = read_text(path).splitlines()[0]
        assert path.name == "main.m" or re.search(rf"\b{path.stem}\(", first), path.name


def test_every_expression_is_made_of_known_parts():
    for texts in GRAMMAR.values():
        for text in texts:
            shown = expression(parse(text))
            calls = set(re.findall(r"([A-Za-z_]\w*)\(", shown))
            assert calls <= {"abs", "sin", "cos", "rootOf", "powerOf"}, shown
    assert expression(parse("-u^2")) == "-(u.^2)" or expression(parse("-u^2")) == "-u.^2"
    assert expression(parse("u/v/w")) == "u./v./w"
    assert expression(parse("u^-2")) == "1./(u.^2)"


HOSTILE = "a\n%{\nsystem('touch planted');\nquit\n%}\r'); system('touch planted'); %"


@octave
def test_text_of_a_model_stays_in_comments(tmp_path):
    found = document()
    found["airframe"]["name"] = HOSTILE
    for section in found["axes"].values():
        for term in section["terms"]:
            term["name"] = term["unit"] = HOSTILE
    model = Model(found)
    write_matlab(model, tmp_path, U)
    assert max(c.largest for c in check_matlab(model, tmp_path, U)) <= 1e-12
    assert not list(tmp_path.rglob("planted"))
    for line in axis_file(model, "Fx").splitlines():
        assert "system" not in line.split("%")[0]


@pytest.mark.parametrize("name", ["../evil", "a'b", "a\nb", "a;b", "$(touch x)"])
def test_a_model_id_that_leads_elsewhere_is_refused(name):
    with pytest.raises(ConfigError, match="'id' is"):
        Model({**document(), "id": name})


def test_regressors_with_code_are_refused():
    for text in ("system('x')", "u;quit", "u'", "getFM(u)", "u\n+v;quit", "@u", "u.v"):
        with pytest.raises(ExpressionError):
            found = document()
            found["axes"]["Fx"]["terms"][0]["expression"] = text
            Model(found)


def test_extensions_with_states_are_refused_by_name(tmp_path):
    found = {**document(), "extensions": [{"id": "slung_load", "states": ["swing"]}]}
    with pytest.raises(ConfigError, match="slung_load"):
        write_matlab(Model(found), tmp_path, U)
    assert not list(tmp_path.iterdir())


def test_the_fixed_files_are_copied_as_they_stand(tmp_path):
    write_matlab(flown(), tmp_path, U, loop_constants(portable_setup(flown())))
    for path in FILES.rglob("*.m"):
        assert read_text(tmp_path / path.relative_to(FILES)) == read_text(path)
    assert shutil.which("sh")  # the folder is plain files: nothing of ours is needed to use it


def export(document, folder, settings=None):
    write_json(folder / "model.json", document)
    script("export_matlab").main(str(folder / "model.json"), settings or {"file": None, "u": U}, str(folder / "matlab"))
    return read_json(folder / "matlab/agreement.json"), {p.name for p in (folder / "matlab").iterdir()}


@octave
def test_the_job_compares_and_says_what_is_left_out(tmp_path, capsys):
    found = flown().document
    found["axes"]["Fx"]["terms"][0]["expression"] = "v_in*u"
    report, files = export(found, tmp_path)
    assert report["agrees"] is True and [c["rows"] for c in report["checks"]] == [10_000, 10_000]
    (note,) = [n for n in report["notes"] if "left out" in n]
    assert "simulation environment" in note and "'v_in'" in note
    assert "getFM.m" in files and "main.m" not in files and "simulation" not in files
    assert note in capsys.readouterr().out


def test_without_octave_nothing_is_claimed(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("OCTAVE", raising=False)
    report, files = export(flown().document, tmp_path, {"file": None, "u": None})
    assert report["agrees"] is None and "GNU Octave was not found" in report["notes"][-1]
    assert {"main.m", "simulation", "check_model.m", "reference.mat"} <= files and "get_PQRDiffSys.m" not in files


@octave
def test_a_model_that_was_put_there_keeps_the_inputs_it_names(tmp_path):
    report, _ = export({**flown().document, "differential form": {"u": ["U_r", "U_q"]}}, tmp_path)
    assert report["agrees"] is True
    assert "u = [U_r, U_q]'" in read_text(tmp_path / "matlab/get_PQRDiffSys.m")


def test_the_configuration_chooses_the_differential_form(tmp_path):
    folder = Folder(tmp_path)
    assert folder.model_jobs.matlab("imported")["u"] == U
    for section, u in (({}, ["U_p"]), ({"DiffSys u": ["w1"]}, ["w1"]), ({"make moment DiffSys": False}, None)):
        (tmp_path / "config/models").mkdir(parents=True, exist_ok=True)
        config = read_json(ROOT / "config/models/example.json")
        config["matlab"] = {"model ID": "X", "droneConfig path": "data", **section}
        config["standalone"] = {"DiffSys u": ["U_p"]}
        write_json(tmp_path / "config/models/X.json", config)
        assert Folder(tmp_path).model_jobs.matlab("X") == {"file": "config/models/X.json", "u": u}
    config["matlab"] = {"DiffSys": True}
    write_json(tmp_path / "config/models/X.json", config)
    with pytest.raises(ConfigError, match="'DiffSys'.*did you mean 'DiffSys u'"):
        Folder(tmp_path).model_jobs.matlab("X")
