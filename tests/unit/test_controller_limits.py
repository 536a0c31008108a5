"""Controllers at their limits: rotors' ranges, weak and lost rotors, integrals, numbers that are none."""

import math

import numpy as np
import plain_plant as plain
import pytest
from plain_plant import KINDS, POSITION, TARGETS, UPRIGHT

from quasi.simulation.control import parameters as g
from quasi.simulation.control.control_model import make_control_model
from quasi.simulation.control.controllers import controller_step, make_controller
from quasi.simulation.control.law import LEARNT_LIMITS


@pytest.fixture(scope="module")
def model():
    return plain.made_model()


def test_integrals_stay_within_their_limit_and_do_not_wind_up_on_a_long_way(model):
    goals = plain.still(4000, (60.0, 0.0, -8.0))
    log = plain.fly({"controller": "PID"}, model, goals)
    assert np.max(log[:, 0]) < 60.6 and abs(log[-1, 0] - 60.0) < 0.3
    assert np.max(np.hypot(log[:, 3], log[:, 4])) < 8.6, "the speed limit holds"
    assert np.degrees(np.arccos(np.min(log[:, UPRIGHT]))) < 60.0


@pytest.mark.parametrize("name", KINDS)
def test_commands_never_leave_the_rotors_range(name, model):
    goals = plain.still(800)
    goals[100:, 1:4] = [30.0, -30.0, -30.0]
    goals[100:, 9] = 3.0
    log = plain.fly({"controller": name}, model, goals, noise=5.0)
    known = make_control_model(model)
    assert log[:, TARGETS].min() >= known.lowest * (1 - 1e-12)
    assert log[:, TARGETS].max() <= known.highest * (1 + 1e-12)


def test_half_the_effectiveness_of_a_rotor_is_survived(model):
    log = plain.fly({"controller": "INDI"}, model, plain.still(2500), share=(0.5, 1, 1, 1), fault=2.0, noise=1.0)
    assert np.max(np.linalg.norm(log[:, POSITION], axis=1)) < 0.5
    assert np.linalg.norm(log[-1, POSITION]) < 0.05
    assert log[-1, 9] == pytest.approx(1500.0 * math.sqrt(2.0), rel=0.02), "the weak rotor turns faster"


def test_half_the_effectiveness_where_the_rotors_are_near_their_limit_costs_yaw_and_nothing_else():
    tight = plain.made_model(hover=2150.0)  # rotors reach 1.57 times the hover's thrust: half of it is 0.78
    log = plain.fly({"controller": "INDI"}, tight, plain.still(2500), share=(0.5, 1, 1, 1), fault=2.0, noise=1.0,
                    speeds=2150.0)  # fmt: skip
    assert np.max(np.linalg.norm(log[:, POSITION], axis=1)) < 0.8
    assert np.linalg.norm(log[-1, POSITION]) < 0.15
    assert abs(log[-1, 8]) > 1.0, "it spins"


CAP = {"cap": (0.5 * 2692.8, np.inf, 0.75 * 2692.8, np.inf), "fault": 2.0, "noise": 1.0}


def test_the_manuals_cap_is_loss_of_control_for_a_controller_that_holds_on_to_yaw(model):
    tight = plain.made_model(hover=1500.0)
    weights = {"allocation": {"method": "inverse", "learn rotor limits": False}}
    for name in ("NDI", "INDI"):
        log = plain.fly({"controller": name, **weights}, tight, plain.still(1500), speeds=1500.0, **CAP)
        assert np.linalg.norm(log[-1, POSITION]) > 5.0, name
        assert np.max(np.linalg.norm(log[:500, POSITION], axis=1)) < 0.1, "until the fault it hovers"


def test_the_manuals_cap_is_survived_when_rotor_limits_are_learnt_and_yaw_is_given_up(model):
    log = plain.fly({"controller": "INDI"}, model, plain.still(3000), **CAP)
    assert np.max(np.linalg.norm(log[:, POSITION], axis=1)) < 0.5
    assert abs(log[-1, 8]) > 1.0, "it spins"


def test_even_the_loss_of_a_whole_rotor_leaves_it_spinning_at_its_place(model):
    log = plain.fly({"controller": "INDI"}, plain.made_model(damping=2e-3), plain.still(2500), fault=2.0,
                    cap=(np.inf, np.inf, np.inf, 0.0))  # fmt: skip
    assert np.max(np.linalg.norm(log[:, POSITION], axis=1)) < 1.5
    assert np.linalg.norm(log[-1, POSITION]) < 0.3 and abs(log[-1, 8]) > 15.0


def test_a_learnt_limit_is_forgotten_when_the_rotor_follows_again(model):
    kind, p, size = make_controller({"controller": "INDI"}, model)
    memory, goal, out, seen = np.zeros(size), np.zeros(20), np.empty(4), np.zeros(26)
    goal[13], seen[0], seen[19] = np.nan, 1.0, -9.81
    seen[13:17] = 1500.0
    limits = []
    for step in range(1500):
        goal[3] = -5.0 if step < 300 else 0.0
        capped = 1400.0 if step < 300 else np.inf
        controller_step(kind, p, memory, 0.004, seen, goal, out)
        limits.append(memory[LEARNT_LIMITS])
        seen[13:17] += (np.clip(out, 0, np.inf) - seen[13:17]) * (1 - math.exp(-0.004 / 0.03))
        seen[13] = min(seen[13], capped)
    assert min(limits[:300]) < 1450.0
    assert limits[-1] == pytest.approx(p[g.HIGHEST_SPEED])


@pytest.mark.parametrize("name", KINDS)
def test_whatever_is_seen_and_wanted_the_commands_are_speeds_that_rotors_can_have(name, model):
    kind, p, size = make_controller({"controller": name}, model)
    rng = np.random.default_rng(6)
    for _ in range(300):
        memory, out = np.zeros(size), np.zeros(4)
        for _ in range(5):
            seen, goal = np.zeros(26), np.zeros(20)
            seen[:4] = rng.normal(size=4)
            seen[:4] /= np.linalg.norm(seen[:4])
            seen[4:13] = rng.normal(size=9) * 10 ** rng.uniform(-2, 3)
            seen[13:17], seen[17:20] = rng.uniform(0, 3000, 4), rng.normal(size=3) * 50
            goal[0], goal[1:18] = rng.integers(4), rng.normal(size=17) * 10 ** rng.uniform(-2, 3)
            goal[13] = np.nan if rng.random() < 0.3 else goal[13]
            controller_step(kind, p, memory, 0.004, seen, goal, out)
            assert np.all(np.isfinite(out)), "no number"
            assert p[g.LOWEST_SPEED] * (1 - 1e-9) <= out.min() and out.max() <= p[g.HIGHEST_SPEED] * (1 + 1e-9)


def test_what_is_no_number_is_passed_on_and_not_hidden(model):
    for name in KINDS:
        kind, p, size = make_controller({"controller": name}, model)
        seen, goal, memory, out = np.zeros(26), np.zeros(20), np.zeros(size), np.zeros(4)
        seen[0], seen[13:17], seen[19], seen[7] = 1.0, 1500.0, -9.81, np.nan
        controller_step(kind, p, memory, 0.004, seen, goal, out)
        assert not np.all(np.isfinite(out))
