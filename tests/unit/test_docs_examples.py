"""What the pages print to be copied works as printed."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from flights import AIRFRAME, HOVER, flight
from made_model import SHARED, TERMS, part

import quasi
from quasi.command import _parser
from quasi.errors import ReadError
from quasi.gap.own_effect import effect_of
from quasi.importing.readers.table_mapping import read_mapping
from quasi.model.build import assemble_model
from quasi.model.envelope import measure_coverage
from quasi.model.model import Model
from quasi.project.model_files import model_place
from quasi_synthesis.campaign import read_campaign

DOCS = Path(__file__).parents[2] / "docs"


def printed(page, begin, language="json"):
    """The block of code of a page that begins so."""
    (found,) = re.findall(
        rf"```{language}\n({re.escape(begin)}.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.S
    )
    return found


def test_the_table_of_the_page_on_formats_is_a_mapping():
    section = json.loads("{" + printed("log-formats.md", '"table columns"') + "}")["table columns"]
    mapping = read_mapping(section, 14, "the page")
    assert [s.name for s in mapping.sources] == ["state", "motors", "capture"]


def test_the_cause_of_your_own_is_sound(tmp_path):
    file = tmp_path / "foam_wing.py"
    file.write_text(printed("gaps.md", "from quasi.gap.effect", "python"))
    assert effect_of(file).id == "foam_wing"


def test_the_made_flights_can_be_made():
    campaign = read_campaign(json.loads(printed("made-flights.md", '{"quadrotor"')), "the page")
    assert [f.key for f in campaign.flights] == ["ref-1", "new-1"]


@pytest.fixture(scope="module")
def model():
    """A made model of six axes with the region of made flights."""
    table = flight(1, rows=2000)
    parts = {axis: part(axis, terms) for axis, terms in TERMS.items()}
    region = measure_coverage({"a": table}, {"a": np.ones(len(table), bool)}, AIRFRAME, HOVER, parts)
    return Model(assemble_model(parts, SHARED, {"id": "example", "airframe": AIRFRAME, **region}))


@pytest.mark.parametrize(
    "page, checked",
    [
        ("../README.md", "np.shape(forces) == (3,)"),
        ("portable-model.md", "form.A.shape == (3, 3) and np.all(np.isfinite(out))"),
        ("simulating.md", "result.table['w1'].max() > 0"),
        ("controllers.md", "np.all(commands > 0)"),
    ],
    ids=["README", "portable-model", "simulating", "controllers"],
)
def test_the_python_of_a_page_runs_in_order(page, checked, model, tmp_path, monkeypatch):
    text = (DOCS / page).read_text(encoding="utf-8")
    monkeypatch.setattr(quasi, "read_model", lambda path: model)
    monkeypatch.chdir(tmp_path)
    names = {"np": np}
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.S)
    for block in blocks:
        # a batch of fewer flights, the rest as written
        exec(block.replace("1000", "20"), names)
    assert blocks and eval(checked, names)


def test_the_page_of_commands_lists_every_command():
    (commands,) = (a for a in _parser()._actions if a.dest == "command")
    text = (DOCS / "commands.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `quasi ([\w-]+)", text, flags=re.M)) == set(commands.choices)


def test_every_option_of_a_command_on_a_page_exists():
    (commands,) = (a for a in _parser()._actions if a.dest == "command")
    lines = "".join(
        p.read_text(encoding="utf-8").replace("\\\n", " ") for p in [*DOCS.glob("*.md"), DOCS / "../README.md"]
    )
    found = re.findall(r"(?:^|[ `/])quasi ([a-z-]+)((?:[^`#\n]|`-)*)", lines)
    wrong = []
    for name, rest in found:
        if name in commands.choices:
            known = {option for action in commands.choices[name]._actions for option in action.option_strings}
            wrong += [
                (name, option) for option in re.findall(r"(?<=[ \[])--?[a-z][a-z-]*", rest) if option not in known
            ]
    assert sum(name in commands.choices for name, _ in found) > 20
    assert not wrong


@pytest.mark.parametrize("given", ["made", "models/made/standalone", "models/made/standalone/model.json"])
def test_a_model_that_does_not_exist_is_refused_with_the_target_that_makes_it(given, tmp_path):
    with pytest.raises(ReadError, match=r"`snakemake -j2 models/made/standalone`"):
        model_place(given, tmp_path)
