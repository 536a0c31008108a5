"""Noise at rest: planted levels come back, logs that move are refused, the configuration keeps its other characters."""

import json

import numpy as np
import pytest

from quasi import command
from quasi.errors import DataError
from quasi.filtering.noise_statistics import RestLog, noise_statistics, section
from quasi.project.configuration import with_section
from quasi_synthesis.campaign import make_flight, quadrotor_configuration, read_campaign, write_flight

PLANTED = {"p": 0.02, "q": 0.01, "r": 0.015, "ax": 0.05, "ay": 0.06, "az": 0.04}
MEANS = {"p": 0.01, "q": -0.02, "r": 0.0, "ax": 0.1, "ay": -0.05, "az": -9.8}
KEY = "(estimated) imu sensor noise statistics"


def rest(seed=0, n=10000, rate=1000.0, **changes):
    rng = np.random.default_rng(seed)
    columns = {a: MEANS[a] + rng.normal(0, s, n) for a, s in PLANTED.items()}
    return RestLog(f"rest {seed}", np.arange(n) / rate, {**columns, **changes})


def test_planted_noise_comes_back_within_its_statistical_error():
    logs = [rest(seed) for seed in range(3)]
    # each log has a mean of its own, which is no noise
    logs[1].columns["p"][:] += 0.05
    found = noise_statistics(logs)
    for name, std in PLANTED.items():
        assert found.samples[name] == 24000
        assert found.values[name]["std"] == pytest.approx(std, rel=4 / np.sqrt(2 * 24000))
    assert found.values["az"]["mean"] == pytest.approx(-9.8, abs=1e-3)
    assert found.values["p"]["mean"] == pytest.approx(0.01 + 0.05 / 3, abs=1e-3)
    assert list(section(found)) == ["ax", "ay", "az", "p", "q", "r"] and not found.notes


def test_ends_are_cut_and_resting_rotors_left_out():
    log = rest(5)
    log.columns["ax"][:800] += 3.0
    log.columns["ay"][-900:] *= 5.0
    assert noise_statistics([log]).values["ax"]["std"] == pytest.approx(0.05, rel=0.05)
    speeds = np.where(log.t > 4.0, 150.0, 0.0)[:, None] * np.ones(4)
    log = rest(6)
    log.columns["p"][:4000] *= 0.1
    found = noise_statistics([RestLog("armed", log.t, log.columns, speeds)])
    assert found.values["p"]["std"] == pytest.approx(0.02, rel=0.05)
    assert "rotors turn from t = 4.00 s" in found.notes[0]


@pytest.mark.parametrize("size", [0.3, 1.0])
def test_never_finer_than_the_logs_steps(size):
    rng = np.random.default_rng(1)
    step = 0.02
    rounded = step * np.round((0.003 + size * 0.5 * step * rng.standard_normal(10000)) / step)
    log = rest(1, p=rounded)
    for given in ({}, {"p": step}):
        found = noise_statistics([RestLog("r", log.t, log.columns, None, given)])
        assert found.values["p"]["std"] >= step / np.sqrt(12) * (1 - 1e-12)
    # a channel that stands on one step says nothing but that it is finer than it
    stuck = RestLog("r", log.t, {**log.columns, "p": np.full(10000, 0.02)}, None, {"p": step})
    found = noise_statistics([stuck])
    assert found.values["p"]["std"] == pytest.approx(step / np.sqrt(12)) and "own steps" in found.notes[-1]


def test_what_is_no_rest_is_refused():
    moving = rest(2)
    moving.columns["q"][5000:5400] += 0.4
    with pytest.raises(DataError, match=r"rest 2 moves: 'q' is 0\.4 rad/s from its median at t = 5\.\d0 s"):
        noise_statistics([rest(1), moving])
    turning = rest(3)
    turning.columns["r"][:] += 0.5
    with pytest.raises(DataError, match="rest 3 turns: the mean of 'r'"):
        noise_statistics([turning])
    scaled = rest(4)
    scaled.columns["az"][:] *= 0.5
    with pytest.raises(DataError, match="shows 4.90 m/s2"):
        noise_statistics([scaled])
    with pytest.raises(DataError, match="'p' is 0.01 all through the log"):
        noise_statistics([rest(5, p=np.full(10000, 0.01))])
    with pytest.raises(DataError, match="log a longer rest"):
        noise_statistics([rest(6, n=1500)])
    with pytest.raises(DataError, match="'ay' is missing in more than half"):
        noise_statistics([rest(7, ay=np.full(10000, np.nan))])


CONFIG = '{\r\n\t"// a": "Größe",  \r\n\t"b" : [1,\r\n2],\r\n\t"%s": {"p": {"std": 1}} ,\r\n\t"c": {"b": "}"}\r\n}\r\n'


def test_section_replaces_nothing_but_itself():
    value = {"ax": {"mean": 0.1, "std": 0.2}, "p": {"mean": 0, "std": 1e-05}}
    text = CONFIG % KEY
    new = with_section(text, KEY, value)
    assert json.loads(new) == {**json.loads(text), KEY: value}
    before, after = text.split('{"p": {"std": 1}}')
    assert new.startswith(before) and new.endswith(after)
    absent = CONFIG.replace('"%s": {"p": {"std": 1}} ,\r\n\t', "")
    new = with_section("\ufeff" + absent, KEY, value)
    assert list(json.loads(new[1:])) == ["// a", "b", "c", KEY]
    assert new.replace(new[new.index(',\r\n\t"(est') : -len("\r\n}\r\n")], "") == "\ufeff" + absent
    assert json.loads(with_section("{}", KEY, value)) == {KEY: value}
    assert json.loads(with_section('{"a": {}}', KEY, value)) == {"a": {}, KEY: value}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A made rest log of 20 s, and a flight, through the real writers."""
    folder = tmp_path_factory.mktemp("rest")
    flights = [{"key": "rest", "profile": "rest"}, {"key": "flown", "profile": "mixed"}]
    campaign = read_campaign({"flights": flights, "duration": 18, "nuisance": 0.0}, "test")
    truth = {}
    for flight in campaign.flights:
        one = make_flight(campaign, flight)
        write_flight(one, folder / f"{flight.key}.bbl", folder / f"{flight.key}.csv", folder / f"{flight.key}.parquet")
        truth[flight.key] = one
    configuration = quadrotor_configuration(campaign)
    (folder / "made.json").write_text(json.dumps(configuration, indent=2), encoding="utf-8")
    return folder, configuration, truth["rest"]


def test_made_rest_log_through_the_real_reader(made, capsys):
    folder, configuration, truth = made
    text = (folder / "made.json").read_text()
    arguments = ["noise", str(folder / "made.json"), str(folder / "rest.bbl"), str(folder / "rest.csv")]
    arguments += ["--rigid-body", "MadeBeetle"]
    assert command.main(arguments) == 0
    assert (folder / "made.json").read_text() == text and "is unchanged" in capsys.readouterr().out
    assert command.main([*arguments, "--write"]) == 0
    written = json.loads((folder / "made.json").read_text())
    assert list(written) == list(configuration)
    assert {k: v for k, v in written.items() if k != KEY} == {k: v for k, v in configuration.items() if k != KEY}
    # the configuration's own statistics come straight from the made sensors, without writer and reader
    for name, entry in configuration[KEY].items():
        expected = float(entry["std"])
        assert written[KEY][name]["std"] == pytest.approx(expected, rel=0.15, abs=2e-4), name
    assert written[KEY]["az"]["mean"] == pytest.approx(-9.81, abs=0.02)


@pytest.mark.parametrize(
    ("encoding", "mark"),
    [("utf-16-le", "\ufeff"), ("utf-16-be", "\ufeff"), ("utf-8", "\ufeff"), ("utf-8", ""), ("latin-1", "")],
)
def test_the_configuration_keeps_its_encoding(made, tmp_path, encoding, mark):
    folder, configuration, _ = made
    text = mark + json.dumps({**configuration, "// note": "caf\u00e9"}, indent=2, ensure_ascii=False)
    (tmp_path / "q.json").write_bytes(text.encode(encoding))
    assert command.main(["noise", str(tmp_path / "q.json"), str(folder / "rest.bbl"), "--write"]) == 0
    written = (tmp_path / "q.json").read_bytes().decode(encoding)
    assert written.startswith(mark + "{") and "caf\u00e9" in written and written != text
    assert json.loads(written.removeprefix(mark))[KEY]["az"]["std"] > 0


def test_a_flight_is_no_rest_and_leaves_the_configuration_alone(made, capsys):
    folder = made[0]
    text = (folder / "made.json").read_text()
    logs = [str(folder / "rest.bbl"), str(folder / "flown.bbl")]
    assert command.main(["noise", str(folder / "made.json"), *logs, "--write"]) == 1
    assert "flown.bbl moves" in capsys.readouterr().err
    assert (folder / "made.json").read_text() == text
