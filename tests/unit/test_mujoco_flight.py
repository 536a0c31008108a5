"""The exported MJCF, flown in MuJoCo by quasi's controller, against quasi's own simulation of the model."""

import numpy as np
import plain_plant
import pytest
from simulations import setup_of

from quasi.attitude import GRAVITY
from quasi.export.physical_constants import physical_constants
from quasi.export.registry import SIMULATORS
from quasi.simulation.control.controllers import controller_step
from quasi.simulation.control.references import evaluate_reference
from quasi.simulation.loop.run import simulate

mujoco = pytest.importorskip("mujoco", reason="flies the exported MJCF; pip install quasi[test]")
STEP, DURATION, SIZE = 0.004, 2.0, 1.0  # s, s, m


def flip(vector):
    return np.asarray(vector) * [1.0, -1.0, -1.0]


def fly(text, setup, thrust):
    """Positions (N, 3), NED, at each command of the setup's controller, flown in MuJoCo from the setup's start."""
    loop = setup.loop_parameters
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = STEP / 4
    data = mujoco.MjData(model)
    rotors = [model.actuator(f"rotor{i}").id for i in range(1, 5)]
    places = [model.actuator(f"rotor{i}").actadr[0] for i in range(1, 5)]
    start = setup.start
    data.qpos[:3], data.qpos[3:7] = flip(start[10:13]), start[:4] * [1, 1, -1, -1]
    data.act[places] = thrust * start[13:17] ** 2
    memory, goal, seen, command = np.zeros(setup.memory), np.zeros(20), np.zeros(26), np.zeros(4)
    path = []
    for k in range(setup.steps):
        mujoco.mj_forward(model, data)
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, data.qpos[3:7])
        seen[:4] = data.qpos[3:7] * [1, 1, -1, -1]
        seen[4:7] = flip(turn.reshape(3, 3).T @ data.qvel[:3])
        seen[7:10], seen[10:13] = flip(data.qvel[3:6]), flip(data.qpos[:3])
        seen[13:17] = np.sqrt(data.act[places] / thrust)
        seen[17:20] = flip(data.sensor("accelerometer").data)
        evaluate_reference(loop.reference, loop.path, loop.table, k * STEP, goal)
        controller_step(loop.controller, loop.gains, memory, STEP, seen, goal, command)
        data.ctrl[rotors] = thrust * command**2
        path.append(seen[10:13].copy())
        for _ in range(4):
            mujoco.mj_step(model, data)
    return np.array(path)


@pytest.mark.parametrize("controller", ["drone_PID", "drone_INDI"])
@pytest.mark.parametrize("steps", [[[0.0, 0.0, 0.0, -1.0]], [[0.0, 0.0, 0.0, -1.0], [0.1, SIZE, -0.5 * SIZE, -1.0]]])
def test_hover_and_a_step_are_flown_as_in_quasi_s_simulator(controller, steps):
    model = plain_plant.made_model()
    physical = physical_constants(model)
    references = {"kind": "position steps", "steps": steps}
    setup = setup_of(model, DURATION, STEP, references=references, controller={"controller": controller},
                     noise={"add": False}, actuator={"delay": 0.0},
                     **{"initial state conditions": {"position": [0.0, 0.0, -1.0]}})  # fmt: skip
    ours = simulate(setup).table[["x", "y", "z"]].to_numpy()[: setup.steps]
    theirs = fly(SIMULATORS["mjcf"].write(physical)["quadrotor.xml"], setup, physical.thrust.value)
    if len(steps) > 1:
        assert np.linalg.norm(ours[-1] - steps[-1][1:]) < 0.3 * SIZE, "the step is flown"
    assert np.max(np.abs(theirs - ours)) < 0.01 * SIZE


def test_the_mjcf_weighs_and_hovers_as_the_model():
    physical = physical_constants(plain_plant.made_model())
    model = mujoco.MjModel.from_xml_string(SIMULATORS["mjcf"].write(physical)["quadrotor.xml"])
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("hover").id)
    mujoco.mj_forward(model, data)
    assert model.body_mass.sum() == pytest.approx(physical.mass)
    np.testing.assert_allclose(data.qacc, 0.0, atol=1e-6 * GRAVITY)
