"""Nothing that a file holds becomes HTML, shell, C, MATLAB or Python code: hostile text over pages and exports."""

import ast
import contextlib
import copy
import json
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import plain_plant
import pytest
from gap_documents import EFFECT, KNOWN, LEFT, TIE, document, rows
from hypothesis import given, settings
from hypothesis import strategies as st

from quasi.errors import QuasiError, quoted
from quasi.export.c_source import c_files
from quasi.export.fmu_source import forces_fmu, vehicle_fmu
from quasi.export.matlab_terms import axis_file, wrench_file
from quasi.export.mcap.plotjuggler import layout_text
from quasi.export.mcap.vehicles import Vehicle
from quasi.export.physical_constants import physical_constants
from quasi.export.python_source import python_file
from quasi.export.registry import SIMULATORS
from quasi.export.xml_text import comment
from quasi.gap.planning import flight_card
from quasi.gap.planning.plan import Card
from quasi.gap.report.page import page
from quasi.model.model import Model

MARK = "pwned"  # stands in each hostile text; code that holds it outside comments and strings has left its place
HOSTILE = [
    "<pwned onload='1'>", "</script><pwned>", '"><pwned>', "]]>--><pwned/>---", "&lt;pwned&gt;<!--<pwned>",
    '"; touch pwned; #', "$(touch pwned)`touch pwned`\ntouch pwned", "');system('pwned'); %", "%{\npwned();\n%}",
    "%s{0}%(pwned)s", "*/ int pwned(void); /*", '"""\nimport pwned\n"""\\', "x\r\npwned()\u2028pwned()", "../../pwned",
    "\u202epwned\u2066", "\x1b[2Jpwned\x00", "'''\npwned = 1\n", '"]\npwned = "1', "pwned\\", "$\\pwned{$",
    "??/\npwned",
]  # fmt: skip
# of the gap's plain data, words that code compares
FIXED = {"id", "ids", "level", "since", "role", "channel", "channels", "gain channel", "rollout channel", "quantity"}
FIXED |= {"schema", "flights", "confused_with", "best wrong cause", "where"}


class Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.attributes = [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += [name for name, _ in attributes]


def bare_c(text):
    """C without comments and literals."""
    return re.sub(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'', " ", text, flags=re.S)


def bare_matlab(text):
    """MATLAB without comments, block comments and strings; ' after a name or bracket transposes."""
    text = re.sub(r"^\s*%\{\s*\n.*?^\s*%\}\s*$", "", text, flags=re.S | re.M)
    lines = (re.sub(r"(?<![\w\])}'.])'(?:''|[^'\n])*'|\"(?:\"\"|[^\"\n])*\"", " ", line) for line in text.split("\n"))
    return "\n".join(line.partition("%")[0] for line in lines)


def names_of_python(text):
    """Every identifier of Python source."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        found |= {str(v) for f in ("id", "attr", "name", "arg", "module") if (v := getattr(node, f, None)) is not None}
    return found


def names_of_xml(text):
    return {n for e in ElementTree.fromstring(text.encode()).iter() for n in (e.tag, *e.attrib)}


def check_source(file, text):
    """No hostile text stands as code in a written file; the file is still of its language."""
    if file.endswith((".c", ".h")):
        assert MARK not in bare_c(text), file
    elif file.endswith(".m"):
        assert MARK not in bare_matlab(text), file
    elif file.endswith(".py"):
        assert not any(MARK in name for name in names_of_python(text)), file
    elif file.endswith((".xml", ".sdf", ".urdf", ".config")):
        assert not any(MARK in name for name in names_of_xml(text)), file
    elif file.endswith(".toml"):
        (table,) = tomllib.loads(text).values()
        assert not any(MARK in key for key in table), file
    elif file.endswith((".sh", ".params")):
        assert not any(MARK in line.partition("#")[0] for line in text.splitlines()), file
    elif file.endswith(".json"):
        json.loads(text)
    else:
        assert MARK not in text, f"{file}: no check of this kind of file"


def check_page(text):
    parsed = Tags()
    parsed.feed(text)
    assert not any(MARK in name for name in (*parsed.tags, *parsed.attributes))
    assert not any(name.startswith("on") for name in parsed.attributes)
    for script in re.findall(r"<script[^>]*>(.*?)</script>", text, re.S):
        if MARK in script:
            assert MARK in json.dumps(json.loads(script)), "hostile text in a script that is no data"


def poisoned(value, texts, keep=frozenset()):
    """Plain data with every text replaced by the next hostile one, but those of the keys `keep`."""
    if isinstance(value, dict):
        return {k: v if k in keep else poisoned(v, texts, keep) for k, v in value.items()}
    if isinstance(value, list):
        return [poisoned(v, texts, keep) for v in value]
    return next(texts) if isinstance(value, str) else value


def cycle(seed):
    while True:
        yield HOSTILE[seed % len(HOSTILE)]
        seed += 1


def leaves(value, path=()):
    """Paths of all texts in plain data."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    if isinstance(value, str):
        yield path
    for key, one in inside:
        yield from leaves(one, (*path, key))


def replaced(value, path, text):
    value = copy.deepcopy(value)
    place = value
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = text
    return value


def plant():
    made = plain_plant.made_model().document
    constants = {f"time constants {way}": {"value": [0.02] * 4, "std": [1e-3] * 4} for way in ("up", "down")}
    constants |= {"delay": {"value": [0.004] * 4}, "command map": {"coefficients": [300.0, 2100.0, 0.0]}}
    hubs = (np.array(made["airframe"]["hubs"]) + [0.0, 0.0, -0.012]).tolist()
    made = {**made, "actuators": constants, "airframe": {**made["airframe"], "hubs": hubs}, "notes": ["a note"]}
    return json.loads(json.dumps(made))


PLANT = plant()


def exported(model):
    """{file: text} of every export that is text."""
    files = dict(c_files(model)) | dict([python_file(model)])
    files |= {f"{axis}.m": axis_file(model, axis) for axis in model.axes} | {"wrench.m": wrench_file(model)}
    for name, fmu in (("forces", forces_fmu(model)), ("vehicle", vehicle_fmu(model))):
        files |= {f"{name}/{file}": text for file, text in fmu.files.items()}
    physical = physical_constants(model)
    for name, target in SIMULATORS.items():
        files |= {f"{name}/{file}": text for file, text in target.write(physical).items()}
    return files


def test_the_check_finds_code_that_left_its_place():
    for file, text in (("a.c", "/* x */ pwned(); /* */"), ("a.m", "x = 1; % y\npwned();"), ("a.py", '"x"\npwned()'),
                       ("a.xml", "<a><pwned/></a>"), ("a.toml", '["x"]\npwned = 1'), ("a.sh", "#\npwned")):  # fmt: skip
        with pytest.raises(AssertionError):
            check_source(file, text)
    for text in ("<p><pwned></p>", "<p onload='1'>", "<script>pwned</script>"):
        with pytest.raises((AssertionError, ValueError)):
            check_page(text)


def test_every_free_text_of_a_model_stays_text_in_every_export():
    """All texts at once that the model's checks do not refuse one by one."""
    free = []
    for path in leaves(PLANT):
        with contextlib.suppress(QuasiError):  # refused: an ID, an expression, a word that code compares
            Model(replaced(PLANT, path, HOSTILE[0]))
            free.append(path)
    assert {path[-1] for path in free} >= {"name", "unit", 0} and len(free) > 20
    for seed in range(len(HOSTILE)):
        texts, made = cycle(seed), PLANT
        for path in free:
            made = replaced(made, path, next(texts))
        for file, text in exported(Model(made)).items():
            check_source(file, text)


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_names_of_flights_and_models_are_refused(text):
    with pytest.raises(QuasiError, match="id") as error:
        Model(replaced(PLANT, ("id",), text))
    assert all(c.isprintable() for c in str(error.value))


def test_expressions_of_hostile_text_are_refused_or_name_a_column():
    place = ("axes", "Fz", "terms", 0, "expression")
    for text in HOSTILE:
        with pytest.raises(QuasiError):
            Model(replaced(PLANT, place, text))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_no_text_of_a_gap_becomes_html(seed):
    texts = cycle(seed)
    made = poisoned(document([EFFECT], [TIE], [LEFT]), texts, FIXED) | {"name": next(texts)}
    made["flights"] = {f"{next(texts)}{k}": role for k, role in enumerate(document()["flights"].values())}
    table = rows().assign(flight=next(texts))
    check_page(page(made, KNOWN, table, {"where": b"\x89PNG"}))


@pytest.mark.parametrize("seed", range(len(HOSTILE)))
def test_no_text_of_a_plan_becomes_html(seed):
    texts = cycle(seed)
    names, notes = [next(texts), next(texts)], [next(texts) for _ in range(5)]
    card = Card(next(texts), names, 30.0, 2, 1, next(texts), [], not_asked={next(texts): next(texts)}, notes=notes)
    text = flight_card.page(card)
    check_page(text)
    assert MARK in text


@pytest.mark.parametrize("text", HOSTILE)
def test_names_of_signals_stay_attributes_in_a_layout(text):
    t = np.arange(3.0)
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    vehicle = Vehicle(text, t, np.zeros((3, 3)), turns, {text: pd.DataFrame({text: t})}, {text: text}, (1.0, 0.0, 0.0))
    assert not any(MARK in name for name in names_of_xml(layout_text([vehicle])))


def test_a_comment_cannot_end_early():
    for hyphens in range(1, 9):
        text = "\n".join(["<a>", *comment(["-" * hyphens, f"x{'-' * hyphens}>", *HOSTILE]), "</a>"])
        assert names_of_xml(text) == {"a"}


@pytest.mark.parametrize("text", HOSTILE)
def test_what_an_error_echoes_is_printable_and_cut(text):
    shown = str(QuasiError(f"a.csv: found {text}{'9' * 1_000_000}, expected a number; correct it"))
    assert len(shown) < 1000 and shown.startswith("a.csv: found") and shown.endswith("correct it")
    assert all(c.isprintable() or c == "\n" for c in shown)
    assert quoted(text).isprintable()
