"""Plants of benchmarks/planted_forces.py, by the balance of forces and moments of what they make."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from quasi.airframe import read_airframe
from quasi_synthesis.campaign import quadrotor_configuration, read_campaign

RATE, SECONDS, EDGE = 500.0, 20.0, 500
PATH = Path(__file__).parents[2] / "benchmarks" / "planted_forces.py"
THRUST, TORQUE = 4e-7, 5e-9  # N and N m per squared speed


@pytest.fixture(scope="module")
def planted():
    spec = importlib.util.spec_from_file_location("planted_forces", PATH)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def airframe():
    campaign = read_campaign({"flights": [{"key": "a", "profile": "mixed", "seed": 1}], "duration": 18}, "t")
    return read_airframe(quadrotor_configuration(campaign), "made")


def wavy(rng, count, size):
    """Slow signals (n, count) with mean 0."""
    t = np.arange(round(RATE * SECONDS)) / RATE
    return size * sum(
        np.sin(2.0 * np.pi * rng.uniform(0.2, 1.0, count) * t[:, None] + rng.uniform(0, 6, count)) for _ in range(3)
    )


@pytest.fixture(scope="module")
def flight(airframe):
    """A flight that leans, turns and drags; its moments are those of its rotors alone."""
    rng = np.random.default_rng(3)
    angles = wavy(rng, 3, 0.08)
    attitude = Rotation.from_euler("ZYX", angles)
    steps = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * RATE
    rates = np.concatenate([steps[:1], steps])
    hover = np.sqrt(airframe.mass * 9.81 / (4.0 * THRUST))
    speeds = hover + wavy(rng, 4, 30.0)
    velocity = wavy(rng, 3, 0.5)
    square, hubs = speeds**2, airframe.hubs
    force = np.column_stack([-0.2 * velocity[:, :2], -THRUST * square.sum(axis=1)])
    moment = np.column_stack(
        [-THRUST * square @ hubs[:, 1], THRUST * square @ hubs[:, 0], -TORQUE * square @ airframe.spin]
    )
    table = pd.DataFrame({"t": np.arange(len(speeds)) / RATE, "valid": 1.0})
    columns = {
        "yaw pitch roll": angles, "p q r": rates, "u v w": velocity, "x y z": wavy(rng, 3, 0.4) - [0, 0, 1.5],
        "Fx Fy Fz": force, "Mx My Mz": moment, "ax ay az": force / airframe.mass, "w1 w2 w3 w4": speeds,
        "command1 command2 command3 command4": speeds / 3000.0,
    }  # fmt: skip
    for names, values in columns.items():
        table[names.split()] = values
    return table


def wrench_left(table, drag, airframe):
    """Force and moment (n, 3) that rotors and drag, as they stand in a table, do not make; about its own axes."""
    square, hubs = table[["w1", "w2", "w3", "w4"]].to_numpy() ** 2, airframe.hubs
    made = np.column_stack([drag, -THRUST * square.sum(axis=1)])
    rates = table[["p", "q", "r"]].to_numpy()
    moment = np.gradient(rates, 1.0 / RATE, axis=0) @ airframe.inertia + np.cross(rates, rates @ airframe.inertia)
    rotors = [-THRUST * square @ hubs[:, 1], THRUST * square @ hubs[:, 0], -TORQUE * square @ airframe.spin]
    return airframe.mass * table[["ax", "ay", "az"]].to_numpy() - made, moment - np.column_stack(rotors)


@pytest.mark.parametrize(("cause", "size"), [("wind", 0.3), ("body_drag", 0.1), ("blade_flapping", 1e-6),
                                             ("ground_effect", 5.0), ("cg_offset", 0.004)])  # fmt: skip
def test_the_planted_wrench_is_what_rotors_and_drag_do_not_make(planted, flight, airframe, cause, size):
    made = planted.plant(flight, flight, airframe, planted.ACTING[cause](size))
    drag = flight[["Fx", "Fy"]].to_numpy()
    before, after = wrench_left(flight, drag, airframe), wrench_left(made, drag, airframe)
    flown = planted.Flown(
        made["t"].to_numpy(), made[["x", "y", "z"]].to_numpy(), made[["u", "v", "w"]].to_numpy(),
        made[["p", "q", "r"]].to_numpy(), Rotation.from_euler("ZYX", made[["yaw", "pitch", "roll"]].to_numpy()),
        made[["w1", "w2", "w3", "w4"]].to_numpy(), THRUST * flight[["w1", "w2", "w3", "w4"]].to_numpy() ** 2,
        flight[["Fx", "Fy", "Fz"]].to_numpy(), airframe,
    )  # fmt: skip
    for k, (wanted, first, last) in enumerate(zip(planted.ACTING[cause](size)(flown), before, after)):
        inside = slice(EDGE, -EDGE)
        error, scale = (last - first - wanted)[inside], np.sqrt(np.mean(wanted[inside] ** 2))
        assert np.sqrt(np.mean(error**2)) <= max(0.05 * scale, (2e-3, 1e-5)[k])


def test_the_path_is_the_same(planted, flight, airframe):
    """Its acceleration, in the room, is that of the recording, and nothing that is planted changes nothing."""
    made = planted.plant(flight, flight, airframe, planted.ACTING["wind"](0.3))

    def in_room(table):
        attitude = Rotation.from_euler("ZYX", table[["yaw", "pitch", "roll"]].to_numpy(copy=True))
        return attitude.apply(table[["ax", "ay", "az"]].to_numpy(copy=True))

    np.testing.assert_allclose(in_room(made), in_room(flight), atol=1e-9)
    assert np.abs(made["pitch"] - flight["pitch"]).max() > 0.02
    same = planted.plant(flight, flight, airframe, planted.ACTING["wind"](0.0))
    pd.testing.assert_frame_equal(same, flight, atol=1e-6, rtol=1e-6)
