"""One flight in files that differ is found by its samples, and refused before anything is imported."""

import gzip

import numpy as np
import pandas as pd
import pytest
from made_lab import lay_lab

from quasi.command import main
from quasi.importing.inspection import inspect_flight, refusals
from quasi.importing.same_samples import find_same_flights, is_same_flight, sketches_of
from quasi.importing.series import Series, Track
from quasi.project.workflow import Folder


def flight(seed, step=None, number=20000):
    """A gyro's samples (n, 3), rad/s: turns of a hover and noise; step  of a coarse log."""
    rng = np.random.default_rng(seed)
    gyro = 0.3 * np.sin(np.outer(np.arange(number), [0.01, 0.013, 0.007]) + rng.uniform(0, 6, 3))
    gyro += rng.normal(0.0, 0.05, (number, 3))
    return gyro if step is None else step * np.round(gyro / step)


def sketch(gyro, **more):
    """Of a log with this gyro at 500 Hz and further quantities {name: (n, C)}, the force x y z if none is named."""
    t = 0.002 * np.arange(len(gyro))
    force = more.get("force", 9.81 + 3.0 * gyro)
    series = {"onboard": Series(t, dict(zip(("ax", "ay", "az"), force.T)))}
    if "position" in more:
        series["capture"] = Series(t[::5] + more.get("late", 0.0), dict(zip("xyz", more["position"].T)))
    return sketches_of(Track(t, gyro), series)


@pytest.mark.parametrize("step", [None, np.radians(1.0)])
def test_a_recording_in_which_a_fault_is_planted_is_another(step):
    gyro = flight(1, step)
    place = np.random.default_rng(3).normal(size=(4000, 3))
    whole = sketch(gyro, position=place)
    assert is_same_flight(whole, sketch(gyro[1:], position=place, late=-0.002))  # a row less: the same moments
    assert is_same_flight(whole, sketch(gyro))  # without its capture
    assert not is_same_flight(whole, sketch(gyro, force=9.9 + 3.0 * gyro, position=place))
    assert not is_same_flight(whole, sketch(gyro, position=place, late=0.008))
    assert not is_same_flight(whole, sketch(gyro, position=place + [0.01, 0.0, 0.0]))


@pytest.mark.parametrize("step", [None, np.radians(1.0)])
def test_a_flight_is_itself_in_any_part_and_no_other(step):
    whole = sketch(flight(1, step))
    for part in (slice(1, None), slice(None, -700), slice(5000, 15000)):
        assert is_same_flight(whole, sketch(flight(1, step)[part])), part
    plain = flight(1, step)
    assert is_same_flight(whole, sketch(plain.astype(np.float32), force=9.81 + 3.0 * plain))
    others = {str(seed): sketch(flight(seed, step)) for seed in range(2, 40)}
    assert find_same_flights({"1": whole, **others}) == []
    assert find_same_flights({"1": whole, **others, "again": whole}) == [("1", "again")]


@pytest.mark.parametrize("late", [0.0, 0.3e-3, 0.5e-3, 0.7e-3])
def test_a_flight_is_itself_however_its_stamps_are_rounded(late):
    """Speeds midway between two samples of the gyro: which one is nearer was a matter of the last digit."""
    random = np.random.default_rng(1)
    gyro, speeds = random.standard_normal((4000, 3)), random.standard_normal((4, 2000))
    t, later = 12.345 + 1e-3 * np.arange(4000), 12.345 + late + 2e-3 * np.arange(2000)

    def sketched(stamped):
        values = {f"w{i + 1}": speeds[i] for i in range(4)}
        return sketches_of(Track(stamped(t), gyro), {"onboard": Series(stamped(later), values)})

    assert is_same_flight(sketched(lambda x: np.round(x, 6)), sketched(lambda x: x - 12.345))


def test_logs_at_rest_and_short_ones_are_no_one_flight():
    still = sketch(np.zeros((5000, 3)))
    assert not is_same_flight(still, still) and sketch(np.zeros((2, 3)))["gyro"] == []
    assert sketch(np.full((50, 3), np.nan))["gyro"] == []


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
