"""One flight in files that differ is found by its samples, and refused before anything is imported."""

import gzip

import numpy as np
import pandas as pd
import pytest
from made_lab import lay_lab

from quasi.command import main
from quasi.importing.inspection import inspect_flight, refusals
from quasi.importing.same_samples import find_same_flights, is_same_flight, sketch
from quasi.project.workflow import Folder


def flight(seed, step=None, number=20000):
    """A gyro's samples (n, 3), rad/s: turns of a hover and noise; step  of a coarse log."""
    rng = np.random.default_rng(seed)
    gyro = 0.3 * np.sin(np.outer(np.arange(number), [0.01, 0.013, 0.007]) + rng.uniform(0, 6, 3))
    gyro += rng.normal(0.0, 0.05, (number, 3))
    return gyro if step is None else step * np.round(gyro / step)


@pytest.mark.parametrize("step", [None, np.radians(1.0)])
def test_a_flight_is_itself_in_any_part_and_no_other(step):
    whole = sketch(flight(1, step))
    for part in (slice(1, None), slice(None, -700), slice(5000, 15000)):
        assert is_same_flight(whole, sketch(flight(1, step)[part])), part
    assert is_same_flight(whole, sketch(flight(1, step).astype(np.float32)))
    others = {str(seed): sketch(flight(seed, step)) for seed in range(2, 40)}
    assert find_same_flights({"1": whole, **others}) == []
    assert find_same_flights({"1": whole, **others, "again": whole}) == [("1", "again")]


def test_logs_at_rest_and_short_ones_are_no_one_flight():
    still = sketch(np.zeros((5000, 3)))
    assert not is_same_flight(still, still) and sketch(np.zeros((2, 3))) == []
    assert sketch(np.full((50, 3), np.nan)) == []


def copy(kind, source, target):
    text = source.read_bytes()
    if kind == "compressed":
        target = target.with_suffix(".csv.gz")
        target.write_bytes(gzip.compress(text))
    elif kind == "one row shorter":
        target.write_bytes(text[: text.rstrip().rfind(b"\n") + 1])
    else:
        pd.read_csv(source).to_csv(target, sep=";", decimal=",", index=False)
    return target


@pytest.mark.parametrize("kind", ["compressed", "one row shorter", "semicolons and decimal commas"])
def test_a_flight_judged_by_itself_in_another_file_is_refused(tmp_path, monkeypatch, capsys, kind):
    lab = lay_lab(tmp_path)
    monkeypatch.chdir(lab)
    (lab / "data/raw/c.csv").unlink()
    made = copy(kind, lab / "data/raw/a.csv", lab / "data/raw/c.csv")
    if made.suffix == ".gz":
        book = lab / "data/logbook.csv"
        book.write_text(book.read_text().replace("Lab,c,data/raw", "Lab,c.csv.gz,data/raw"))
    asked = Folder(".").inspection("models", "my_model")
    found = {key: inspect_flight(about["settings"]) for key, about in asked["flights"].items()}
    (sentence,) = refusals(asked, found)
    assert "model my_model: the logs of a and c" in sentence and "hold the same flight" in sentence
    assert main(["check"]) == 1
    assert "hold the same flight" in capsys.readouterr().out
