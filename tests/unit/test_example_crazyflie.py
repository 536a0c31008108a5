"""The example of real Crazyflie flights: its configurations are sound, and its logbooks name every recording."""

import csv
from pathlib import Path

import pytest
from recordings import SHARED

from quasi.project.workflow import Folder

ROOT = Path(__file__).parents[2] / "examples" / "crazyflie"
DATA = SHARED.parent
TRUTH = {
    "normal": "normal_flight",
    "cut": "cut_propeller_M3",
    "weight": "add_weight",
    "tape": "tape_on_propeller",
    "string": "weight_on_string",
}
BOOKS = {"crazypad": 85, "nanobench": 12}
needs_data = pytest.mark.skipif(not (DATA / "crazypad").is_dir(), reason=f"the recordings are not at {DATA}")


def rows(name):
    with (ROOT / "data" / f"{name}_file_log.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("name", BOOKS)
def test_keys_are_unique_and_sessions_are_given(name):
    flights = rows(name)
    assert len(flights) == BOOKS[name] == len({f["Flight key"] for f in flights})
    assert all(f["Session"] for f in flights)


def test_the_names_of_flights_follow_the_folders_that_are_their_truth():
    for flight in rows("crazypad"):
        folder = flight["OB Path"].rpartition("/")[2]
        kind = flight["Flight key"].partition("-")[0]
        assert TRUTH[kind] in folder
        assert flight["Flight key"][-2:] == flight["Onboard Name"][-2:]


@needs_data
@pytest.mark.parametrize("name", BOOKS)
def test_every_flight_can_be_imported_and_filtered_by_the_configurations(name):
    folder = Folder(ROOT, DATA)
    assert sorted(folder.configuration.models) == sorted(BOOKS)
    assert folder.configuration.model(name)
    for flight in rows(name):
        settings = folder.recordings.importing(flight["Quadrotor"], flight["Flight key"])
        assert settings["problem"] is None, settings["problem"]
        assert Path(settings["flight"]["onboard"]).is_file()
        assert folder.recordings.filtering(flight["Quadrotor"], flight["Flight key"])["problem"] is None


@needs_data
@pytest.mark.parametrize("gap", ["cut-5mm", "weight-M4", "tape-M3", "string-W3"])
def test_gaps_compare_one_condition_with_normal_flights(gap):
    settings = Folder(ROOT, DATA).gap(gap)
    roles = settings["roles"]
    assert sorted(k.rpartition("/")[2][:6] for k, r in roles.items() if r == "reference") == ["normal"] * 7
    assert len([r for r in roles.values() if r in ("compared", "held out")]) == 3
