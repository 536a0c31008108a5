"""FMUs of models that say too little, and of models with hostile names."""

from xml.etree import ElementTree

import pytest
from export_models import model
from fmpy.validation import validate_fmu
from made_model import TERMS, document
from programs import script

from quasi.errors import ConfigError, DataError
from quasi.export.compiler import find_compiler, write_files
from quasi.export.fmu_archive import write_fmu
from quasi.export.fmu_source import forces_fmu, vehicle_fmu
from quasi.model.model import AXES, Model
from quasi.tables import read_json, write_json

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")


def test_vehicle_needs_what_a_vehicle_knows():
    with pytest.raises(ConfigError, match="'v_in', which a vehicle cannot supply"):
        vehicle_fmu(model({**TERMS, "Mz": {"r*v_in": 1.0}}))
    with pytest.raises(DataError, match="lacks Mz"):
        vehicle_fmu(model({axis: TERMS[axis] for axis in AXES[:5]}))
    with pytest.raises(DataError, match="has no mass"):
        vehicle_fmu(Model({**document(), "airframe": {**document()["airframe"], "mass": None}}))
    with pytest.raises(ConfigError, match="does not state that of its flights"):
        vehicle_fmu(model({**TERMS, "Mz": {"r*battery_voltage": 1.0}}))
    named = [v.name for v in forces_fmu(model({"Fz": TERMS["Fz"], "Mz": {"r*v_in": 1.0}})).variables]
    assert "v_in" in named and "Mz" in named and "Fx" not in named


def test_script_hands_over_what_can_be_made_and_says_what_cannot(tmp_path, capsys):
    few = model({"Fz": TERMS["Fz"]}, "few")
    write_json(tmp_path / "model.json", few.document)
    script("export_fmu").main(str(tmp_path / "model.json"), str(tmp_path / "fmu"))
    found = read_json(tmp_path / "fmu/agreement.json")
    assert found["agrees"] is True and any("no vehicle was made: model few lacks" in n for n in found["notes"])
    assert [p.name for p in (tmp_path / "fmu").glob("*.fmu")] == ["quasi_few_forces_and_moments.fmu"]
    assert "no vehicle was made" in capsys.readouterr().out


def test_hostile_names_stay_in_attributes(tmp_path):
    hostile = '"/><script>&amp;</x>\n]]>'
    plain = model({"Fz": {"a|b[c]": 1.0, "real": 1.0}}, "a.b+c-d").document
    plain["airframe"]["name"] = hostile
    fmu = forces_fmu(Model(plain))
    root = ElementTree.fromstring(fmu.files["modelDescription.xml"].encode())
    assert fmu.identifier == "quasi_a_x2e_b_x2b_c_x2d_d_forces_and_moments" and fmu.identifier.isidentifier()
    assert {v.get("name") for v in root.iter("ScalarVariable")} >= {"a|b[c]", "real", "Fz"}
    assert not list(root.iter("script"))
    write_fmu(tmp_path / "hostile.fmu", fmu, tmp_path)
    assert validate_fmu(str(tmp_path / "hostile.fmu")) == []
    write_files(tmp_path / "inside", {"../../escape.txt": "x"})
    assert (tmp_path / "inside/escape.txt").is_file()
