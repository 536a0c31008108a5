"""One rotor weaker than the others.

A rotor of effectiveness e acts as one whose squared speed is e times the logged one. The fit takes what the model makes
of that in every row. Its levers of hover, which the extended model's terms have, are the mean of it: terms such as the
change of all rotors times a difference let them differ by a third from row to row. With levers of hover the deviations
of rotors planted in real recordings came out 10 to 18 % too small, with the slopes of each row within 5 %.
"""

import numpy as np

from quasi.gap.effect import Effect, Parameter, Terms, Values, Vehicle, number, thrust_wrench, total, vehicle_of
from quasi.gap.flights.evidence import Evidence
from quasi.model.model import ROTORS

SLOPES_KNOWN = 0.05  # share, from rotors planted in real recordings: docs/measured.md
THRUST = slice(2, 5)  # Fz, Mx, My: Fx and Fy of rotor speeds come from an IMU next to the configured place


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    result = {}
    for i in range(1, 5):
        thrusts = ["", "", "", ""]
        thrusts[i - 1] = f"{number(vehicle.thrust)}*w{i}^2"
        yaw = {"Mz": f"{number(-vehicle.spin[i - 1] * vehicle.drawn)}*w{i}^2"}
        result[f"rotor{i}"] = total([thrust_wrench(vehicle, thrusts), yaw])
    return result


def _columns(evidence: Evidence, _: Values) -> dict[str, np.ndarray]:
    slopes = evidence.gradient(*ROTORS) * (0.5 * evidence.speeds)[:, None, :]  # by the logarithm of squared speed
    drawn = vehicle_of(evidence.model, evidence.mass, evidence.inertia).drawn
    result = {}
    for i, spin in enumerate(evidence.spin):
        column = np.zeros((len(evidence), 6))
        column[:, THRUST] = slopes[:, THRUST, i]
        column[:, 5] = -spin * drawn * evidence.speeds[:, i] ** 2
        result[f"rotor{i + 1}"] = column
    return result


EFFECT = Effect(
    id="rotor_effectiveness",
    level="forces",
    sentence="one rotor makes less or more thrust than its speed says (chipped or wrong propeller)",
    equation="T_i = e_i T0_i: dFz : dMx : dMy in the ratio of the hub's place, dMz by the power saved",
    source="definition",
    parameters={f"rotor{i}": Parameter("1", 1.0, "s", 0.3, 2.0, 0.1) for i in range(1, 5)},
    channels=("Fz", "Mx", "My"),
    rivals=("cg_offset", "rotor_tilt"),
    tie_breaker="heave with a large range of thrust, and steps of each axis",
    terms=_terms,
    columns=_columns,
    absent_when_healthy=True,
    form_uncertainty=SLOPES_KNOWN,
)
