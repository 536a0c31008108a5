"""Flying a model by hand as the command does it: the simulation behind the keys, names that are wrong, no window."""

import shutil

import numpy as np
import pytest
from plain_plant import made_model
from test_fly import Clock, Script, Shown

from quasi import command
from quasi.simulation.fly import fly
from quasi.simulation.run import Session
from quasi.simulation.setup import make_setup
from quasi.tables import write_json


@pytest.fixture(scope="module")
def session():
    settings = {"model": {"model ID": "made"}, "initial state conditions": {"position": [0, 0, -1.5]}}
    return Session(make_setup(settings | {"noise": {"add": False}}, made_model()))


def flown(session, spans):
    clock = Clock()
    session.restart()
    shown = Shown(clock)
    sentence = fly(session, shown, Script(clock, spans), clock=clock, rest=clock.rest)
    return session.state(), shown, sentence


def test_a_model_stands_where_it_is_without_a_key(session):
    x, shown, _ = flown(session, [("q", 5.0, 9.0)])
    assert session.t == pytest.approx(5.0, abs=0.05)
    np.testing.assert_allclose(x[10:13], [0, 0, -1.5], atol=0.02)
    assert shown.said[-1][1] == "velocity   0.0 m/s   height 1.5 m"


def test_a_model_goes_the_way_of_the_keys(session):
    x, _, sentence = flown(session, [("w", 0.5, 4.0), ("q", 4.0, 9.0)])
    assert x[4] == pytest.approx(3.0, abs=0.3)  # forward at the speed that a held key asks for
    assert abs(x[11]) < 0.2
    assert "3." in sentence.split("away and ")[1]
    x, _, _ = flown(session, [("up", 0.5, 3.0), ("right", 0.5, 1.5), ("q", 6.0, 9.0)])
    assert -x[12] == pytest.approx(1.5 + 1.5 * (2.5 + 0.55), abs=0.3)
    assert 2.0 * np.arctan2(x[3], x[0]) == pytest.approx(1.6 * (1.0 + 0.55), abs=0.1)  # turned clockwise from above


def test_a_model_with_an_attitude_reference_leans_and_gathers_speed(session):
    x, shown, _ = flown(session, [("m", 0.2, 0.23), ("w", 0.5, 1.6), ("q", 1.6, 9.0)])
    assert shown.said[-1][1].startswith("attitude")
    pitch = np.arcsin(2.0 * (x[0] * x[2] - x[3] * x[1]))
    assert np.degrees(pitch) == pytest.approx(-20.0, abs=2.0)
    assert x[10] > 0.5


def test_starting_again_is_starting_the_same(session):
    first, _, _ = flown(session, [("d", 0.5, 2.0), ("q", 3.0, 9.0)])
    again, _, _ = flown(session, [("d", 0.5, 2.0), ("q", 3.0, 9.0)])
    np.testing.assert_array_equal(first, again)


@pytest.fixture
def folder(tmp_path):
    write_json(tmp_path / "models/made/standalone/model.json", made_model().document)
    (tmp_path / "config/simulations").mkdir(parents=True)
    write_json(
        tmp_path / "config/simulations/windy.json", {"model": {"model ID": "made"}, "wind": {"steady": [2, 0, 0]}}
    )
    return tmp_path


def told(capsys, *arguments):
    assert command.main(["fly", *arguments]) == 1
    return capsys.readouterr().err


def test_what_cannot_be_flown_is_told(folder, capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert "no model 'mad'" in told(capsys, "mad", "-d", str(folder))
    assert "did you mean 'made'?" in told(capsys, "mad", "-d", str(folder))
    assert "windy" in told(capsys, "--simulation", "wind", "-d", str(folder))
    for names in ([], ["made"], ["--simulation", "windy"]):
        assert "no window can be opened: there is no display" in told(capsys, *names, "-d", str(folder))
    shutil.copytree(folder / "models/made", folder / "models/other")
    assert "holds 2 models (known are 'made', 'other'); name the one to fly" in told(capsys, "-d", str(folder))
    shutil.rmtree(folder / "models")
    assert "holds no models; make one first" in told(capsys, "-d", str(folder))
