"""Thrust axes that lean."""

import numpy as np

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, at_hubs, number


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    result = {}
    for i in range(4):
        outward = vehicle.hubs[i] * [1.0, 1.0, 0.0]
        lean = np.cross(outward / np.linalg.norm(outward), [0.0, 0.0, -1.0])
        thrust = f"{number(vehicle.thrust)}*w{i + 1}^2"
        forces = [("", "", "")] * 4
        forces[i] = tuple(f"{number(component)}*{thrust}" if component else "" for component in lean)
        result[f"rotor{i + 1}"] = at_hubs(vehicle, forces)
    return result


EFFECT = Effect(
    id="rotor_tilt",
    level="forces",
    sentence="the thrust of a motor leans to the side (bent arm, canted motor)",
    equation="thrust axis turned about the arm's outward direction by the angle; positive makes thrust yaw right",
    source="definition",
    parameters={f"rotor{i}": Parameter("rad", 0.0, "a", -0.3, 0.3, 0.0175) for i in range(1, 5)},
    channels=("Fx", "Fy", "Mz"),
    rivals=("rotor_effectiveness", "imu_misalignment", "torque_factor"),
    tie_breaker="steps of throttle",
    terms=_terms,
    absent_when_healthy=True,
    parts="one",  # one arm bends; several angles at once are most often the form of something else, such as wind
)
