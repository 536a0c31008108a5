"""Flying by hand: keys to a reference, real time, the loop with stand-ins, the window."""

import math
import warnings

import numpy as np
import pytest
from airframes import to_draw
from matplotlib.backend_bases import KeyEvent

from quasi.attitude import from_euler, rotate
from quasi.errors import ConfigError
from quasi.simulation.tools import window
from quasi.simulation.tools.manual_flight import (
    ATTITUDE_SETPOINT,
    MAX_SIMULATED_TIME,
    VELOCITY_SETPOINT,
    Handling,
    Pace,
    Pilot,
    fly_manually,
)
from quasi.simulation.tools.window import Animator, Window

WEIGHT = 5.0


def settle(pilot, held, seconds=2.0, dt=0.02):
    for _ in range(round(seconds / dt)):
        goal = pilot.setpoint(set(held), dt)
    return goal


def test_no_key_asks_to_stand():
    goal = settle(Pilot(WEIGHT), "")
    assert goal[0] == VELOCITY_SETPOINT
    np.testing.assert_array_equal(goal[4:7], 0.0)
    assert goal[14] == 0.0


@pytest.mark.parametrize(
    ("key", "body"),
    [("w", (1, 0, 0)), ("s", (-1, 0, 0)), ("d", (0, 1, 0)), ("a", (0, -1, 0)), ("up", (0, 0, -1)), ("k", (0, 0, 1))],
)
def test_keys_move_as_the_heading_goes(key, body):
    yaw, hand = 2.0, Handling()
    goal = settle(Pilot(WEIGHT, yaw), {key})
    full = hand.climb if body[2] else hand.speed
    np.testing.assert_allclose(goal[4:7], rotate(from_euler(0, 0, yaw), full * np.array(body, float)), atol=1e-12)


def test_right_turns_clockwise_from_above_and_the_heading_stays_where_it_was_left():
    pilot = Pilot(WEIGHT, 3.0)
    goal = settle(pilot, {"right"}, seconds=1.0)
    assert goal[14] == pytest.approx(1.6)
    assert goal[9] == pytest.approx(3.0 + 1.6 - 2 * math.pi)
    assert settle(pilot, "")[9] == pytest.approx(3.0 + 1.6 - 2 * math.pi)


def test_the_reference_changes_no_faster_than_it_may_and_is_no_faster_across():
    pilot, hand = Pilot(WEIGHT), Handling()
    first = pilot.setpoint({"w"}, 0.02)
    assert first[4] == pytest.approx(0.02 * hand.acceleration)
    across = settle(pilot, {"w", "d"})
    assert np.linalg.norm(across[4:7]) == pytest.approx(hand.speed)
    np.testing.assert_array_equal(settle(pilot, {"w", "s"})[4:7], 0.0)  # both at once: neither


def test_an_attitude_reference_carries_the_weight_and_accelerates_the_way_of_the_key():
    pilot, hand = Pilot(WEIGHT), Handling()
    pilot.switch()
    for key, axis, sign in (("w", 0, 1), ("s", 0, -1), ("d", 1, 1), ("a", 1, -1)):
        goal = settle(pilot, {key})
        assert goal[0] == ATTITUDE_SETPOINT
        force = rotate(from_euler(*goal[7:10]), np.array([0.0, 0.0, -goal[13]])) + [0, 0, WEIGHT]
        assert force[axis] == pytest.approx(sign * WEIGHT * math.tan(hand.tilt))
        assert force[2] == pytest.approx(0.0, abs=1e-12)
    assert settle(pilot, {"up"})[13] == pytest.approx(WEIGHT * 1.2)


def test_pace_makes_up_for_the_time_that_passed_to_the_step():
    pace = Pace(0.004, 10.0)
    times = 10.0 + np.cumsum(np.random.default_rng(1).uniform(0.005, 0.05, 400))
    done = np.cumsum([pace.count_due_steps(t) for t in times])
    assert np.all(np.abs(done * 0.004 - (times - 10.0)) <= 0.004 + 1e-9)
    assert pace.speed_ratio > 0.95


def test_a_slow_computer_flies_slower_and_says_so():
    pace = Pace(0.004, 0.0)
    steps = [pace.count_due_steps(0.4 * k) for k in range(1, 20)]
    assert set(steps) == {round(MAX_SIMULATED_TIME / 0.004)}
    assert pace.speed_ratio == pytest.approx(MAX_SIMULATED_TIME / 0.4, abs=0.02)
    assert pace.count_due_steps(19 * 0.4 + 0.02) <= 6  # the rest was not put off


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now

    def wait(self, seconds):
        self.now += seconds


class Toy:
    """Goes exactly as fast as asked for."""

    dt, weight = 0.004, WEIGHT

    def __init__(self, fails_at=math.inf):
        self.fails_at, self.restarts = fails_at, -1
        self.restart()

    def restart(self):
        self.restarts += 1
        self.t, self.x = 0.0, np.zeros(17)
        self.x[0], self.x[12], self.x[13:] = 1.0, -1.0, 1500.0

    def state(self):
        return self.x

    def advance(self, goal, steps):
        self.t += steps * self.dt
        self.x[4:7] = goal[4:7]
        self.x[10:13] += steps * self.dt * goal[4:7]
        return f"diverged at {self.t:.2f} s" if self.t > self.fails_at else None


class Script:
    """Keys pressed at given times; the terminal repeats them while they are down."""

    def __init__(self, clock, spans):
        self.clock, self.spans = clock, spans

    def read(self):
        return [key for key, begin, end in self.spans if begin <= self.clock.now < end]


class Shown:
    def __init__(self, clock, closes=math.inf):
        self.clock, self.closes, self.texts = clock, closes, []

    def is_open(self):
        return self.clock.now < self.closes

    def poll(self, held, now):
        return []

    def show(self, t, state, text):
        self.texts.append((t, text))


def flown(spans, closes=math.inf, flight=None):
    clock = Clock()
    flight, shown = flight or Toy(), Shown(clock, closes)
    return flight, shown, fly_manually(flight, shown, Script(clock, spans), clock=clock, wait=clock.wait)


def test_a_flight_by_keys_goes_where_they_say_and_ends_with_q():
    flight, shown, sentence = flown([("w", 1.0, 3.0), ("q", 6.0, 9.0)])
    assert flight.t == pytest.approx(6.0, abs=0.03)
    # 2 s held and the delay of the terminal's repeats, ramps up and down alike
    assert flight.x[10] == pytest.approx(3.0 * (2.0 + 0.55), rel=0.03)
    assert sentence == f"flew {flight.t:.1f} s, up to {flight.x[10]:.1f} m away and 3.0 m/s fast"
    assert len(shown.texts) == pytest.approx(6.0 * 40, rel=0.02)
    assert shown.texts[20][1] == "velocity   0.0 m/s   height 1.0 m"


def test_closing_the_window_ends_the_flight():
    flight, _, _ = flown([], closes=2.0)
    assert flight.t == pytest.approx(2.0, abs=0.03)


def test_space_halts_and_m_changes_the_reference():
    flight, shown, _ = flown([("w", 0.5, 2.0), ("space", 2.0, 2.03), ("q", 4.0, 9.0)])
    assert flight.x[10] < 3.0 * 1.5
    assert np.all(flight.x[4:7] == 0.0)
    _, shown, _ = flown([("m", 1.0, 1.02), ("q", 2.0, 9.0)])
    assert shown.texts[-1][1].startswith("attitude")


def test_a_simulation_out_of_control_stops_says_so_and_begins_again_with_r():
    flight = Toy(fails_at=1.0)
    _, shown, _ = flown([("r", 3.0, 3.03), ("q", 3.5, 9.0)], flight=flight)
    assert any(text.startswith("diverged at 1.0") and text.endswith("r starts again") for _, text in shown.texts)
    assert flight.restarts == 1
    assert flight.t == pytest.approx(0.5, abs=0.05)  # it stood still between
    assert shown.texts[-1][1].startswith("velocity")


@pytest.fixture
def airframe():
    return to_draw()


@pytest.fixture
def opened(airframe, monkeypatch):
    """A window on matplotlib's canvas without a screen."""
    from matplotlib import pyplot

    pyplot.switch_backend("agg")
    monkeypatch.setattr(window, "_open_pyplot", lambda: pyplot)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # matplotlib warns that this canvas cannot be shown
        made = Window(airframe, "made")
    yield made
    made.close()


def test_the_box_of_the_window_moves_on_with_the_drone(opened):
    state = np.zeros(17)
    state[0] = 1.0
    opened.show(0.0, state, "")
    before = opened.picture()
    state[10] = 0.5
    opened.show(0.1, state, "")
    assert (np.abs(before.astype(int) - opened.picture()) > 60).any()
    state[10:13] = [40.0, -3.0, -20.0]
    opened.show(0.2, state, "")
    axes = opened._figure.axes[0]
    assert axes.get_xlim()[0] < 40.0 < axes.get_xlim()[1]
    assert axes.get_zlim()[1] < -20.0 < axes.get_zlim()[0]


def test_a_window_with_a_reference_holds_its_path_and_marks_the_target(airframe, opened):
    from quasi.simulation.tools.window import Window

    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    path = np.stack([4.0 * np.cos(angle), 4.0 * np.sin(angle), np.full(100, -2.0)], axis=1)
    window = Window(airframe, "round", path=path)
    state = np.zeros(17)
    state[0] = 1.0
    window.show(0.0, state, "")
    plain = window.picture()
    axes = window._figure.axes[0]
    assert axes.get_xlim()[0] <= -4.0 and axes.get_xlim()[1] >= 4.0
    window.show(0.0, state, "", np.array([0.0, 4.0, -2.0]))
    assert (np.abs(plain.astype(int) - window.picture()) > 60).any()
    window.close()


def test_keys_of_the_window_count_while_they_are_down(opened):
    from quasi.simulation.tools.keyboard import HeldKeys

    canvas, held = opened._figure.canvas, HeldKeys()
    for kind, key in (("key_press_event", "w"), ("key_press_event", " ")):
        canvas.callbacks.process(kind, KeyEvent(kind, canvas, key))
    assert opened.poll(held, 1.0) == ["w", "space"]
    assert "w" in held.list_held_keys(1.9)
    canvas.callbacks.process("key_release_event", KeyEvent("key_release_event", canvas, "w"))
    assert opened.poll(held, 1.5) == []
    assert "w" not in held.list_held_keys(1.7)
    canvas.callbacks.process("key_press_event", KeyEvent("key_press_event", canvas, "w"))
    opened.poll(held, 5.0)
    assert "w" not in held.list_held_keys(6.5)  # the window lost the focus: no release was seen


def test_an_animator_shows_an_endless_simulation_in_real_time_until_its_window_is_closed(opened):
    from plain_plant import made_model

    from quasi.simulation.loop.python_loop import QuadrotorSimulator
    from quasi.simulation.loop.setup import make_setup

    setup = make_setup({"model": {"model ID": "made"}}, made_model())
    clock = Clock()
    simulator = QuadrotorSimulator(setup, run_mode="infinite")
    animator = Animator(opened, rate=10.0, clock=clock, wait=clock.wait)
    times = []
    show = opened.show
    opened.show = lambda t, state, text: (times.append(t), show(t, state, text), len(times) == 6 and opened.close())
    simulator.add_step("integrator", animator)
    bus = simulator.run()
    np.testing.assert_allclose(np.diff(times), 0.1, atol=0.0041)  # ten pictures a second of simulated time
    assert bus.time[bus.step] == pytest.approx(times[-1])
    assert clock.now == pytest.approx(times[-1] - times[0])  # as long as it would have taken


def test_a_closed_window_is_noticed(opened):
    assert opened.is_open()
    opened.close()
    assert not opened.is_open()


def test_without_a_display_a_sentence_says_so(airframe, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(ConfigError, match="there is no display"):
        Window(airframe, "made")
