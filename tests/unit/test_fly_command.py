"""Flying a model by hand as the command does it: the simulation behind the keys, names that are wrong, no window."""

import shutil

import numpy as np
import pytest
from plain_plant import made_model
from test_fly import Clock, Script, Shown

import quasi.simulation.tools.manual_flight as fly_module
import quasi.simulation.tools.reference_flight as watch_module
from quasi import command
from quasi.commands.simulations import fly_live
from quasi.simulation.loop.run import Session
from quasi.simulation.loop.setup import make_setup
from quasi.simulation.tools import fly_command as live
from quasi.simulation.tools.manual_flight import fly_manually
from quasi.tables import write_json


@pytest.fixture(scope="module")
def session():
    settings = {"model": {"model ID": "made"}, "initial state conditions": {"position": [0, 0, -1.5]}}
    return Session(make_setup(settings | {"noise": {"add": False}}, made_model()))


def flown(session, spans):
    clock = Clock()
    session.restart()
    shown = Shown(clock)
    sentence = fly_manually(session, shown, Script(clock, spans), clock=clock, wait=clock.wait)
    return session.state(), shown, sentence


def test_a_model_stands_where_it_is_without_a_key(session):
    x, shown, _ = flown(session, [("q", 5.0, 9.0)])
    assert session.t == pytest.approx(5.0, abs=0.05)
    np.testing.assert_allclose(x[10:13], [0, 0, -1.5], atol=0.02)
    assert shown.texts[-1][1] == "velocity   0.0 m/s   height 1.5 m"


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
    assert shown.texts[-1][1].startswith("attitude")
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


def error_of(capsys, *arguments):
    assert command.main(["fly", *arguments]) == 1
    return capsys.readouterr().err


def test_what_cannot_be_flown_is_named(folder, capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    here = ("-d", str(folder))
    assert "no model 'mad'" in error_of(capsys, "--by-hand", "mad", *here)
    assert "did you mean 'made'?" in error_of(capsys, "--by-hand", "mad", *here)
    assert "'windy'" in error_of(capsys, "wind", *here)
    assert "`quasi fly --by-hand made`" in error_of(capsys, "made", *here)
    for names in ([], ["windy"], ["--by-hand"], ["--by-hand", "made"], ["--by-hand", "windy"]):
        assert "no window can be opened: there is no display" in error_of(capsys, *names, *here)
    shutil.copytree(folder / "models/made", folder / "models/other")
    assert "holds 2 models (known are 'made', 'other'); give its name" in error_of(capsys, "--by-hand", *here)
    shutil.rmtree(folder / "models")
    assert "holds no models; make a model first" in error_of(capsys, "--by-hand", *here)
    assert "make it with" in error_of(capsys, "windy", *here) or "'model ID' is 'made'" in error_of(
        capsys, "windy", *here
    )


class Seen(Shown):
    def __init__(self, clock, airframe, name, text="", path=None, closes=8.0):
        super().__init__(clock, closes)
        self.path, self.targets, self.states = path, [], []

    def show(self, t, state, text, target=None):
        super().show(t, state, text)
        self.targets.append(None if target is None else target.copy())
        self.states.append(state.copy())

    def close(self):
        pass


@pytest.fixture
def windows(monkeypatch):
    clock, opened = Clock(), []

    def window(*arguments, **more):
        opened.append(Seen(clock, *arguments, **more))
        return opened[-1]

    monkeypatch.setattr(live, "Window", window)
    for module, name in ((watch_module, "show_reference_flight"), (fly_module, "fly_manually")):
        run = getattr(module, name)
        monkeypatch.setattr(module, name, lambda s, v, k=None, run=run: run(s, v, k, clock=clock, wait=clock.wait))
    return opened


CIRCLE = {
    "model": {"model ID": "made"}, "noise": {"add": False}, "simulation": {"duration": 6},
    "references": {"kind": "circle", "radius": 2.0, "start": 0.5, "transition": 1.0},
    "animation": {"show": True},
}  # fmt: skip


def test_a_configured_flight_is_shown_with_its_reference_until_its_end(folder, windows):
    write_json(folder / "config/simulations/round.json", CIRCLE)
    sentence = fly_live("round", folder, by_hand=False)
    (window,) = windows
    assert sentence.startswith("flew 6.0 s of 6.0 s, position error ")
    assert np.abs(np.hypot(*window.path[-100:, :2].T) - 2.0).max() < 1e-9 and window.path[-1, 2] == -2.0
    late = [k for k, (t, _) in enumerate(window.texts) if 3.0 < t < 6.0]
    places = np.array([window.states[k][10:12] for k in late])
    assert np.allclose(np.hypot(*places.T), 2.0, atol=0.15), "the reference is flown, not the keys"
    assert np.allclose([np.hypot(*window.targets[k][:2]) for k in late], 2.0)
    assert "end; r starts again" in window.texts[-1][1] and window.texts[-1][0] == pytest.approx(6.0)


def test_by_hand_the_reference_of_the_simulation_takes_no_part(folder, windows):
    write_json(folder / "config/simulations/round.json", CIRCLE)
    fly_live("round", folder, by_hand=True)
    (window,) = windows
    assert window.path is None and window.texts[-1][0] > 7.0
    assert np.linalg.norm(window.states[-1][10:13]) < 0.1


def test_space_pauses_and_r_starts_again():
    clock = Clock()
    setup = make_setup({**CIRCLE, "animation": {}}, made_model())
    flight, view = Session(setup, by_hand=False), Seen(clock, None, "", closes=20.0)
    keys = Script(clock, [("space", 1.0, 1.026), ("space", 3.0, 3.026), ("r", 5.0, 5.026), ("q", 7.0, 9.0)])
    sentence = watch_module.show_reference_flight(flight, view, keys, clock=clock, wait=clock.wait)
    assert flight.t == pytest.approx(2.0, abs=0.1) and sentence.startswith("flew 2.0 s of 6.0 s")
    assert any(text.endswith("paused") for _, text in view.texts)
    before = max(t for t, _ in view.texts)
    assert before == pytest.approx(3.0, abs=0.15)
