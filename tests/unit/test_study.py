"""A study goes on where it stopped, and trusts no file of other code or settings."""

import json

import pytest
import study


def test_a_study_goes_on_where_it_was_and_tables_come_from_the_files(tmp_path):
    program = study.HERE.parent / "consistency.py"
    made = []

    def draw(settings):
        made.append(settings["seed"])
        if len(made) == 3:
            raise KeyboardInterrupt
        return {"found": 2.0 * settings["seed"]}

    many = [{"seed": seed, "noise": 1.0} for seed in (1, 2, 3)]
    with pytest.raises(KeyboardInterrupt):
        study.run(many, draw, tmp_path, program)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["1-1.json", "2-1.json"]
    results = study.run(many, draw, tmp_path, program)
    assert made == [1, 2, 3, 3] and [r["found"] for r in results] == [2.0, 4.0, 6.0]
    held = json.loads((tmp_path / "2-1.json").read_text())
    assert held == results[1] and held["settings"] == many[1]

    (tmp_path / "2-1.json").write_text(json.dumps(held | {"code": "older"}))
    study.run(many, draw, tmp_path, program)
    (tmp_path / "1-1.json").write_text(json.dumps(results[0] | {"settings": {"seed": 1, "noise": 2.0}}))
    study.run(many, draw, tmp_path, program)
    assert made == [1, 2, 3, 3, 2, 1]
    assert study.run(many, draw, tmp_path, program) == results


def test_other_programs_do_not_share_draws(tmp_path):
    settings = [{"seed": 1}]
    study.run(settings, lambda s: {"found": "a"}, tmp_path, study.HERE.parent / "consistency.py")
    (other,) = study.run(settings, lambda s: {"found": "b"}, tmp_path, study.HERE.parent / "synchronisation.py")
    assert other["found"] == "b"


def test_root_mean_square():
    assert study.rms([3.0, -4.0]) == pytest.approx(12.5**0.5)
