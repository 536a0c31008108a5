"""Flights whose sources contradict each other take no part in a gap."""

import pytest
from made_plan import MODEL
from programs import script

from quasi.errors import DataError
from quasi.gap.diagnosis import _correction_matters
from quasi.gap.flights.unusable import exclude_unusable, exclusion_notes

ROLES = {"a": "compared", "b": "compared", "c": "compared", "h": "held out", "r": "reference", "s": "reference"}
BAD = {"contradictions": [{"text": "gyro and attitude contradict each other"}, {"text": "another"}]}
GOOD = {"contradictions": []}


def flights(*bad):
    return {key: BAD if key in bad else GOOD for key in ROLES}


def test_contradictory_flights_are_left_out_and_named():
    found = exclude_unusable(flights("a", "h", "r"), ROLES, "config/gaps/g.json")
    assert list(found) == ["a", "h", "r"]
    notes = exclusion_notes(found, ROLES)
    for key, note in zip(found, notes, strict=True):
        assert note.startswith(f"flight {key} is unusable") and "gyro and attitude" in note and "1 more" in note
        assert "use unusable flights" in note


def test_nothing_is_left_out_of_sound_flights_or_by_choice():
    assert exclude_unusable(flights(), ROLES, "g") == {}
    assert exclude_unusable(flights("a", "b", "h"), ROLES, "g", use=True) == {}
    assert exclude_unusable({"a": {}}, ROLES, "g") == {}  # made before contradictions were kept


@pytest.mark.parametrize(
    "bad, role, kept",
    [(("a", "b"), "compared", "1 of 3"), ("abc", "compared", "0 of 3"), ("rs", "reference", "0 of 2")],
)
def test_too_few_flights_are_refused_with_the_file_and_the_key(bad, role, kept):
    with pytest.raises(DataError, match=f"^config/gaps/g.json: {kept} {role} flights .*flight {bad[0]}: gyro") as error:
        exclude_unusable(flights(*bad), ROLES, "config/gaps/g.json")
    assert "'use unusable flights'" in str(error.value)


def test_one_sound_compared_flight_alone_is_no_matter_of_exclusion():
    """The diagnosis itself says that one flight is too few; nothing was left out."""
    assert exclude_unusable({"a": GOOD}, ROLES, "g") == {}


def test_no_held_out_flight_left_is_left_to_the_diagnosis():
    assert list(exclude_unusable({"h": BAD, "a": GOOD, "b": GOOD}, ROLES, "g")) == ["h"]


def test_the_diagnosis_leaves_out_what_the_calibration_left_out_and_what_contradicts_itself_after_it():
    asked = {"file": "config/gaps/g.json", "roles": ROLES, "settings": {"use unusable flights": False}}
    exclude = script("gap_diagnosis")._exclude
    found = exclude({"left out": {"a": "before"}}, flights("h"), asked)
    assert list(found) == ["a", "h"] and found["a"] == "before"
    assert exclude({}, flights(), asked) == {}  # a calibration made before flights were left out
    with pytest.raises(DataError, match="1 of 2 compared flights"):
        exclude({"left out": {"a": "before"}}, flights("b"), asked)


def test_correcting_sensors_matters_where_no_held_out_flight_is_left_to_judge_it():
    assert _correction_matters(MODEL, ([], []), {}) is True
