"""Configuration files: defaults, comments, notices, and faults that name file, key and remedy."""

import jsonschema
import pytest

from quasi.errors import ConfigError
from quasi.project import configuration
from quasi.tables import read_json

SCHEMAS = sorted(p.name.removesuffix(".schema.json") for p in configuration.SCHEMAS.glob("*.schema.json"))
LOGBOOK = {"logging file": {"filename": "log"}}


def properties(rules, path=""):
    for key, about in rules.get("properties", {}).items():
        yield f"{path}/{key}", about
        yield from properties(about, f"{path}/{key}")


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_schema_is_valid_and_describes_every_key(name):
    rules = read_json(configuration.SCHEMAS / f"{name}.schema.json")
    jsonschema.Draft202012Validator.check_schema(rules)
    for key, about in properties(rules):
        assert "description" in about or "enum" in about or "$ref" in about or "properties" in about, key


def test_defaults_are_filled_in_and_comments_dropped():
    document, notices = configuration.check({**LOGBOOK, "// hint": "x", "data importing": {"//": 1}}, "processing", "p")
    assert document["data importing"]["resampling rate"] == 500
    assert document["data filtering"]["bias policy"] == "automatic"
    assert not any(k.startswith("//") for k in document)
    assert notices == []


def test_keys_that_show_or_save_are_accepted_with_a_notice():
    given = {**LOGBOOK, "data filtering": {"show filtering results": True, "save filtered data": False}}
    _, notices = configuration.check(given, "processing", "config/processing.json")
    assert len(notices) == 2
    assert all("accepted but not used" in n for n in notices)


def test_the_manuals_own_processing_file_is_accepted_word_for_word():
    listing_3 = {
        "logging file": {
            "directory": "data",
            "filename": "HDBeetle_file_log",
            "rows of flights to use (all)": ["2-5", 8, 13],
        },
        "data importing": {
            "import raw data": True,
            "resampling rate": 500,
            "use onboard attitude": True,
            "do onboard c.g. correction": True,
            "filter optitrack outliers": True,
            "optitrack velocity Hz cutoff": 10,
            "save raw data": True,
            "imported data save directory": "data/processed/imported",
            "align with optitrack using": ["pitch", "yaw"],
            "max permitted lag for optitrack": 25,
            "show onboard and optitrack alignment plots": True,
        },
        "data filtering": {
            "use noise statistics in drone config": True,
            "run extended kalman filter": True,
            "save kalman filter convergence results": False,
            "remove influence of gravity": False,
            "show filtering results": True,
            "add induced velocity": False,
            "save filtered data": True,
            "filtered data save directory": "data/processed/filtered",
        },
    }
    configuration.check(listing_3, "processing", "p")


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"loging file": {}}, "p.json: unknown key 'loging file' (did you mean 'logging file'?)"),
        ({}, "p.json: the file lacks the key 'logging file'"),
        ({**LOGBOOK, "data importing": {"resampling rat": 1}}, "in 'data importing' (did you mean 'resampling rate'?)"),
        ({**LOGBOOK, "data importing": {"resampling rate": "5"}}, "'resampling rate' is '5', expected a number"),
        ({**LOGBOOK, "data filtering": {"bias policy": "x"}}, "expected one of 'automatic', 'rest', 'whole flight'"),
        ([], "p.json: the file is [], expected a section"),
    ],
)
def test_faults_are_sentences(document, message):
    with pytest.raises(ConfigError) as error:
        configuration.check(document, "processing", "p.json")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("document", "message"), [({}, "table columns lacks the key 'sources'"), ([], "table columns is [], expected a")]
)
def test_a_section_is_no_file(document, message):
    with pytest.raises(ConfigError) as error:
        configuration.check(document, "quadrotor", "table columns", "properties", "table columns")
    assert str(error.value).startswith(message)


def test_key_of_ones_own_in_a_quadrotor_is_allowed_but_a_slip_of_the_pen_is_refused():
    beetle = {
        "rotor config": {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3},
        "rotor1 rotation direction": "CW",
        "rotor radius": "0.0381",
        "b": "0.077",
        "moment of inertia": "[1, 0, 0; 0, 1, 0; 0, 0, 1]",
    }
    assert configuration.check({**beetle, "owner": "lab"}, "quadrotor", "q")[1] == []
    notices = configuration.check({**beetle, "rotor size": 14}, "quadrotor", "q")[1]
    assert len(notices) == 1 and notices[0].startswith("q: 'rotor size' is not a key of quasi (did you mean 'rotor")
    for slip, meant in (("motor pole", "motor poles"), ("rotor hub hight", "rotor hub height")):
        with pytest.raises(ConfigError, match=f"q: '{slip}' is not a key of quasi .did you mean '{meant}'"):
            configuration.check({**beetle, slip: 14}, "quadrotor", "q")
    for slip in ("rotor radus", "Rotor Radius"):
        mistyped = {slip if k == "rotor radius" else k: v for k, v in beetle.items()}
        with pytest.raises(ConfigError, match=f"lacks the key 'rotor radius', found '{slip}': correct the name"):
            configuration.check({**mistyped, "owner": "lab"}, "quadrotor", "q")
    with pytest.raises(ConfigError, match="lacks the key 'rotor radius'; add it"):
        configuration.check({k: v for k, v in beetle.items() if k != "rotor radius"}, "quadrotor", "q")


def test_campaign_schema_holds_the_keys_that_the_synthesis_takes():
    from quasi_synthesis.campaign import CAMPAIGN_KEYS, FLIGHT_KEYS
    from quasi_synthesis.conditions import CONDITION_KEYS as CONDITIONS

    rules = configuration.schema("synthesis")["properties"]
    assert set(rules) == {*CAMPAIGN_KEYS, *CONDITIONS}
    assert set(rules["flights"]["items"]["properties"]) == set(FLIGHT_KEYS)
    assert {k: v["default"] for k, v in rules.items() if "default" in v} == {
        k: v[0] for k, v in CAMPAIGN_KEYS.items() if v[0] is not None
    } | {"fixed heading": False}


@pytest.mark.parametrize(
    ("key", "value"),
    [("rotor radius", "3 inch"), ("max RPM", "-5"), ("mass", "nan"), ("optitrack marker cg offset", {"z": "1,5"})],
)
def test_text_of_a_quadrotor_where_a_number_is_meant_names_the_key(key, value):
    given = read_json(configuration.SCHEMAS.parent / "template/data/my_quadrotor.json")
    with pytest.raises(ConfigError, match=f"q.json: .*'{key}'.* expected a number"):
        configuration.check({**given, key: value}, "quadrotor", "q.json")


def test_nesting_beyond_reason_is_a_sentence():
    document = 1
    for _ in range(5000):
        document = {"a": document}
    with pytest.raises(ConfigError, match="p.json is nested too deeply"):
        configuration.check(document, "processing", "p.json")


def test_unknown_key_beside_numbered_ones_is_the_one_that_is_named():
    given = read_json(configuration.SCHEMAS.parent / "template/data/my_quadrotor.json")
    with pytest.raises(ConfigError, match="unknown key '5' in 'rotor rotation directions'"):
        configuration.check({**given, "rotor rotation directions": {"1": "CW", "5": "CW"}}, "quadrotor", "q.json")


@pytest.mark.parametrize(("value", "shown"), [(None, "null"), (True, "true")])
def test_constants_are_shown_as_the_file_writes_them(value, shown):
    with pytest.raises(ConfigError, match=f"'resampling rate' is {shown}, expected a number"):
        configuration.check({**LOGBOOK, "data importing": {"resampling rate": value}}, "processing", "p.json")
