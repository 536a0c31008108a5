"""Raw files that a user replaces: content decides what reruns, not time stamps."""

import os
import shutil

import pytest

pytestmark = pytest.mark.workflow
TARGET = "results/imported/MadeBeetle/given.parquet"


def test_an_older_raw_file_in_the_place_of_another_reruns_its_flight_and_a_touch_nothing(project):
    made, raw = project.folder / "results/synthesis/small", project.folder / "data/raw"
    raw.mkdir()
    shutil.copy(made / "onboard/small-1.bbl", raw / "given.bbl")
    shutil.copy(made / "optitrack/small-1.csv", raw / "given.csv")
    places = {"Onboard Name": "given", "Raw OptiTrack Name": "given", "OB Path": "data/raw", "Raw OT Path": "data/raw"}
    project.edit_logbook(lambda rows: rows.append({**rows[0], "Flight ID": "9", **places}))
    code, text = project.snakemake("-j1", TARGET)
    assert code == 0, text
    os.utime(raw / "given.bbl")
    assert project.would_run(TARGET) == {}

    before = (raw / "given.bbl").read_bytes()
    older = project.folder / "older"
    older.write_bytes(before[:-1] + bytes([before[-1] ^ 1]))
    os.utime(older, (1e9, 1e9))
    older.replace(raw / "given.bbl")
    assert (raw / "given.bbl").stat().st_size == len(before)
    assert project.would_run(TARGET) == {"importing": 1}
    (raw / "given.bbl").write_bytes(before)
    assert project.would_run(TARGET) == {}

    older.write_bytes((raw / "given.csv").read_bytes().replace(b"MadeBeetle", b"MadeBeatle"))
    os.utime(older, (1e9, 1e9))
    shutil.copy2(older, raw / "given.csv")
    assert project.would_run(TARGET) == {"importing": 1}
