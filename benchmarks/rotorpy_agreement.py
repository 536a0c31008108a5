"""Reference numbers of another simulator, for the test of the simulator's physics: state derivatives and a roll-out.

rotorpy (MIT, PyPI; Folk, Paulos & Kumar, RotorPy: a Python-based multirotor simulator with aerodynamics for education
and research, 2023) is asked for its state derivative at random states and for one second with changing commands, of an
airframe whose forces and moments are polynomials: quadratic thrust and torque, rotor drag at the hubs, parasitic drag,
rotor lag, full inertia. It is no dependency of quasi: install it anywhere and name the place.

    pip install --no-deps --target /tmp/rotorpy rotorpy
    python benchmarks/rotorpy_agreement.py /tmp/rotorpy          prints the agreement
    python benchmarks/rotorpy_agreement.py /tmp/rotorpy --write  writes tests/unit/rotorpy_reference.json as well
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
from measured_table import record

HERE = Path(__file__).parent
REFERENCE = HERE.parent / "tests" / "unit" / "rotorpy_reference.json"
sys.path.insert(0, str(HERE.parent / "tests" / "unit"))

D = 0.0544  # m, of each hub along x and y
# front left, front right, aft right, aft left are rotors 4, 2, 1, 3; x forward, y left here
HUBS = {"r1": [-D, -D, 0.0], "r2": [D, -D, 0.0], "r3": [-D, D, 0.0], "r4": [D, D, 0.0]}
SPIN = [1.0, -1.0, -1.0, 1.0]
CONSTANTS = {
    "mass": 0.43, "Ixx": 8.65e-4, "Iyy": 1.07e-3, "Izz": 1.71e-3, "Ixy": 2e-5, "Ixz": -3e-5, "Iyz": 4e-5,
    "c_Dx": 0.02, "c_Dy": 0.025, "c_Dz": 0.03, "k_eta": 4.7e-7, "k_m": 6e-9, "k_d": 2e-5, "k_z": 4e-5, "tau_m": 0.03,
    "rotor_speed_min": 200.0, "rotor_speed_max": 2600.0,
}  # fmt: skip


def rotorpy_vehicle(place: str):
    """The vehicle as rotorpy knows it."""
    sys.path.insert(0, place)
    from rotorpy.vehicles.multirotor import Multirotor

    parameters = {
        **CONSTANTS,
        "num_rotors": 4,
        "rotor_pos": {k: np.array(v) for k, v in HUBS.items()},
        "rotor_directions": np.array(SPIN),
    }
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}
    return Multirotor(parameters, control_abstraction="cmd_motor_speeds", integrator_kwargs=options)


def main() -> None:
    """Ask rotorpy, compare, print, and write when asked to."""
    if len(sys.argv) < 2:
        sys.exit(f"name the place of rotorpy\n\n{__doc__}")
    vehicle = rotorpy_vehicle(sys.argv[1])
    rng = np.random.default_rng(20)
    states, derivatives, commands = [], [], []
    for _ in range(12):
        q = rng.standard_normal(4)
        wind = rng.standard_normal(3)
        state = np.concatenate([rng.standard_normal(3), 3 * rng.standard_normal(3), q / np.linalg.norm(q),
                                4 * rng.standard_normal(3), wind, 1500 + 200 * rng.standard_normal(4)])  # fmt: skip
        command = 1500 + 200 * rng.standard_normal(4)
        states.append(state)
        commands.append(command)
        derivatives.append(vehicle._s_dot_fn(0.0, state, command))
    now = {
        "x": np.array([0.5, -0.3, 1.0]), "v": np.array([2.0, -1.0, 0.5]), "q": np.array([0.1, -0.05, 0.3, 0.947]),
        "w": np.array([0.5, -0.4, 0.3]), "wind": np.array([0.5, -0.2, 0.1]),
        "rotor_speeds": np.array([1500.0, 1520.0, 1480.0, 1510.0]),
    }  # fmt: skip
    now["q"] = now["q"] / np.linalg.norm(now["q"])
    t = 0.01 * np.arange(100)
    orders = 1510 + 60 * np.column_stack([np.sin(5 * t + k) for k in range(4)])
    rows = [vehicle._pack_state(now)]
    started = time.perf_counter()
    for order in orders:
        now = vehicle.step(now, {"cmd_motor_speeds": order}, 0.01)
        rows.append(vehicle._pack_state(now))
    spent = time.perf_counter() - started
    reference = {
        "made by": "benchmarks/rotorpy_agreement.py with rotorpy 3.0.0",
        "state": "position, velocity (world, z up), quaternion x y z w, rates (body, z up), wind (world), rotor speeds",
        "constants": CONSTANTS, "hubs": HUBS, "spin": SPIN,
        "states": np.array(states).tolist(), "commands": np.array(commands).tolist(),
        "derivatives": np.array(derivatives).tolist(),
        "roll-out": {"dt": 0.01, "commands": orders.tolist(), "states": np.array(rows)[::10].tolist()},
    }  # fmt: skip
    if "--write" in sys.argv:
        REFERENCE.write_text(json.dumps(reference, indent=0) + "\n", encoding="utf-8")
    from test_rotorpy import derivative_error, rollout_error

    figures = {"derivative": derivative_error(reference), "roll-out": rollout_error(reference)}
    if "--record" in sys.argv:
        record("rotorpy_agreement", figures)
    print(f"state derivative: largest relative difference {figures['derivative']:.1e} (asked: 1e-12)")
    print(f"roll-out of 1 s:  largest difference {figures['roll-out']:.1e} (asked: 1e-6)")
    print(f"rotorpy with DOP853 at 1e-12: {len(orders) / spent:.0f} steps of 10 ms per second")


if __name__ == "__main__":
    main()
