"""Margins against eigenvalues of the loop with its gain or delay changed; the linear loop against the real one."""

import math

import numpy as np
import plain_plant as plain
import pytest
from scipy import signal

from quasi.errors import ConfigError
from quasi.model.model import Model
from quasi.simulation.loop.setup import make_setup
from quasi.simulation.tools.margins import DIRECTIONS, _compute_margin, compute_margins, describe_margins, linearise

KINDS = ("PID", "NDI", "INDI")


@pytest.fixture(scope="module")
def model():
    return plain.made_model()


def radius(loop, factors):
    """Largest eigenvalue with the gains of the four directions multiplied."""
    change = loop.directions @ np.diag(factors) @ np.linalg.inv(loop.directions)
    return np.max(np.abs(np.linalg.eigvals(loop.a + loop.b @ change @ loop.c)))


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("dt", [0.002, 0.004])
def test_default_gains_leave_6_db_and_30_degrees_in_every_direction(name, dt, model):
    found = compute_margins({"controller": name, "time step": dt}, model, dt)
    assert found.stable and found.least_damping > 0.4
    for margin in found.by_direction.values():
        assert margin.gain_up > 6.0 and margin.gain_down > 6.0
        assert margin.phase > 35.0 and margin.delay > 20.0
    assert found.all_at_once > 0.55


@pytest.mark.parametrize("name", KINDS)
def test_gain_margins_are_where_the_closed_loop_becomes_unstable(name, model):
    loop = linearise({"controller": name}, model)
    found = compute_margins({"controller": name}, model)
    checked = 0
    for k, direction in enumerate(DIRECTIONS):
        margin = found.by_direction[direction]
        for decibel in (margin.gain_up, -margin.gain_down):
            if not math.isfinite(decibel):
                continue
            factors = np.ones(4)
            factors[k] = 10 ** (decibel * 0.95 / 20)
            assert radius(loop, factors) < 1.0, direction
            factors[k] = 10 ** (decibel * 1.05 / 20)
            assert radius(loop, factors) > 1.0, direction
            checked += 1
    assert checked >= 6


@pytest.mark.parametrize("name", KINDS)
def test_the_delay_margin_is_where_waiting_steps_make_the_loop_unstable(name, model):
    dt = 0.002
    loop = linearise({"controller": name}, model, dt)
    margin = compute_margins({"controller": name}, model, dt).by_direction["roll"]
    n, spot = len(loop.a), np.linalg.inv(loop.directions)[0]

    def late(steps):
        # a chain of `steps` numbers delays the roll direction
        a = np.zeros((n + steps, n + steps))
        keep = loop.directions[:, 1:] @ np.linalg.inv(loop.directions)[1:]
        a[:n, :n] = loop.a + loop.b @ keep @ loop.c
        a[:n, n] = loop.b @ loop.directions[:, 0]
        a[n + steps - 1, :n] = spot @ loop.c
        for k in range(steps - 1):
            a[n + k, n + k + 1] = 1.0
        return np.max(np.abs(np.linalg.eigvals(a)))

    assert late(int(0.93 * margin.delay / 2.0)) < 1.0
    assert late(math.ceil(1.07 * margin.delay / 2.0)) > 1.0


def test_the_disk_margin_bounds_gain_and_phase_together(model):
    for margin in compute_margins({"controller": "INDI"}, model).by_direction.values():
        if margin.disk < 2.0:
            assert margin.gain_down >= 20 * math.log10((2 + margin.disk) / (2 - margin.disk)) - 0.1
        assert margin.phase >= 2 * math.degrees(math.atan(margin.disk / 2)) - 0.2


def test_margins_of_a_known_loop_are_the_printed_ones():
    # 10/(s (s + 1) (s + 10)): gain margin 20 log 11 = 20.8 dB; crossover and phase by scipy's own roots
    w = np.geomspace(0.01, 1e3, 20000)
    _, response = signal.freqs([10.0], [1.0, 11.0, 10.0, 0.0], w)
    found = _compute_margin(response, w)
    roots = np.roots([1.0, 0, 101.0, 0, 100.0, 0, -100.0])  # w^2 (w^2 + 1)(w^2 + 100) = 100
    crossover = roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)].real[0]
    phase = 90 - math.degrees(math.atan(crossover) + math.atan(crossover / 10))
    assert found.gain_up == pytest.approx(20 * math.log10(11), abs=0.01) and math.isinf(found.gain_down)
    assert found.crossover == pytest.approx(crossover, rel=1e-4)
    assert found.phase == pytest.approx(phase, abs=0.01)
    assert found.delay == pytest.approx(1e3 * math.radians(phase) / crossover, rel=1e-3)


@pytest.mark.parametrize("name", KINDS)
def test_the_linear_loop_moves_as_the_real_one_after_a_small_disturbance(name, model):
    loop = linearise({"controller": name}, model)
    start = np.zeros(13)
    start[0:3], start[3:6], start[6:9] = [0.004, -0.002, 0.003], [0.01, 0.0, -0.005], [0.02, 0.01, -0.02]
    log = plain.fly({"controller": name}, model, plain.still(300), start=start, fine=80)
    state = np.zeros(len(loop.a))
    state[3:6], state[6:9], state[9:12] = start[3:6], start[6:9], start[0:3]
    # a controller's filter begins at what it sees first: there the two differ, for as long as the filter remembers
    first = {"PID": 9, "NDI": 0, "INDI": 9}[name]
    if first:
        at = 20 + {"PID": 10, "INDI": 4}[name]
        for k in range(3):
            state[at + 3 * k] = state[at + 3 * k + 2] = start[6 + k]
    moved = np.empty((300, 6))
    for step in range(300):
        moved[step] = np.concatenate([state[9:12], state[6:9]])
        state = loop.closed @ state
    assert np.max(np.abs(moved[:, :3] - log[:, :3])) < 2e-4
    assert np.max(np.abs(moved[:, 3:] - log[:, 6:9])) < 3e-3


def test_slow_actuators_and_delay_cost_margin(model):
    quick = compute_margins({"controller": "INDI"}, model)
    gains = {"position": {}, "velocity": {}, "attitude": {}, "rates": {}}
    same = {"controller": "INDI", "gains": gains}
    late = compute_margins({**same}, model, actuators={"delay": 0.02})
    assert late.by_direction["roll"].crossover < quick.by_direction["roll"].crossover, "default gains give way"
    frozen = {"position": 0.57, "velocity": 0.28, "attitude": 0.14, "rates": 0.07}
    fixed = {"controller": "INDI", "gains": {k: {"time constant": v} for k, v in frozen.items()}}
    a, b = (compute_margins(fixed, model, actuators={"delay": d}).by_direction["roll"].delay for d in (0.0, 0.012))
    assert a - b == pytest.approx(12.0, abs=1.0)


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize(("lag", "delay", "dt"), [(0.005, 0.0, 0.004), (0.015, 0.03, 0.001), (0.05, 0.0, 0.01)])
def test_default_gains_suit_quick_and_slow_rotors(name, lag, delay, dt):
    found = compute_margins({"controller": name, "time step": dt}, plain.made_model(lag=lag), dt, {"delay": delay})
    assert found.stable
    for margin in found.by_direction.values():
        assert min(margin.gain_up, margin.gain_down) > 5.5 and margin.phase > 30.0


def test_the_text_tells_gains_and_margins(model):
    setup = make_setup({"model": {"model ID": "made"}, "controller": {"controller": "drone_PID"}}, model)
    text = describe_margins(setup)
    assert text.startswith("PID on made, every 4 ms: stable") and "integral time" in text
    roll = compute_margins({"controller": "PID", "time step": 0.004}, model).by_direction["roll"]
    assert f"{roll.gain_down:.1f} dB" in text and f"{roll.crossover:.1f} rad/s" in text


def test_an_impossible_time_step_is_named(model):
    with pytest.raises(ConfigError, match="expected a positive number"):
        compute_margins({"controller": "INDI"}, model, 0.0)


def test_margins_are_those_of_the_height_at_which_the_model_hovers(model):
    """Terms in the height that vanish where it was flown change nothing there."""
    document = {
        **model.document,
        "axes": {a: {**p, "terms": list(p["terms"])} for a, p in model.document["axes"].items()},
    }
    term = {**document["axes"]["Fz"]["terms"][0], "given": True, "name": "floor", "coefficient": -2.0,
            "expression": "(z + 2)^2"}  # fmt: skip
    document["axes"]["Fz"]["terms"].append(term)
    low = Model({**document, "envelope": {n: {"percentiles": {"50": v}} for n, v in zip("xyz", (0.0, 0.0, -2.0))}})
    base, near = (compute_margins({"controller": "INDI"}, m) for m in (model, low))
    assert near.least_damping == pytest.approx(base.least_damping, rel=0.02)
