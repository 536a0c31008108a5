"""Whether rotors sit and turn where the configuration says: what each one's speed does to the moments tells.

A thrust k W^2 at the hub (x, y) makes the moments -y k W^2 about x and x k W^2 about y; its drag turns the body against
the rotor's sense. A wrong rotor order or sense leaves every score of an identified model as it was, and turns up
only where the model is flown.
"""

from collections.abc import Mapping

import numpy as np

from quasi.airframe import Airframe
from quasi.errors import DataError
from quasi.expressions import Program, parse
from quasi.identification.regression import least_squares
from quasi.variables import Variables

SURE = 5.0  # standard errors
APART = 0.6  # of the arm, between where a rotor is said to be and where it seems to be
# what acts on a moment beside the rotors' thrusts and drag
BESIDE = {
    "Mx": ("p", "w_tot*v", "u_p_dot"),
    "My": ("q", "w_tot*u", "u_q_dot"),
    "Mz": ("r", "u_r_dot"),
}


def contradictions(prepared: Mapping[str, tuple], airframe: Airframe, thrust: float) -> list[str]:
    """Sentences on rotors that seem to be elsewhere, or to turn the other way, than the airframe says.

    prepared  {flight: (rows, values by column, mass)} of training rows; thrust  of one rotor, N s2/rad2
    """
    if not thrust > 0.0:
        return []
    slopes = {axis: _slopes(prepared, airframe, axis) for axis in BESIDE}
    places = []
    for i, (x, y, _) in enumerate(airframe.hubs):
        if slopes["Mx"] is None or slopes["My"] is None:
            break
        seen = np.array([slopes["My"][0][i], -slopes["Mx"][0][i]]) / thrust
        std = np.array([slopes["My"][1][i], slopes["Mx"][1][i]]) / thrust
        away = np.abs(seen - [x, y])
        if (away > np.maximum(APART * airframe.arm, SURE * std)).any():
            places.append(
                f"rotor {i + 1} pushes as if it were {_side(*seen)} (x = {seen[0]:.2f} m, y = {seen[1]:.2f} m), the "
                f"configuration has it {_side(x, y)} (x = {x:.2f} m, y = {y:.2f} m)"
            )
    notes = []
    if places:
        notes.append(
            f"{'; '.join(places)}: correct the rotors' numbers or places in the quadrotor's configuration, and import "
            "anew"
        )
    if slopes["Mz"] is not None:
        value, std = slopes["Mz"]
        against = [str(i + 1) for i in range(4) if value[i] * airframe.spin[i] > SURE * std[i]]
        if against:
            notes.append(
                f"the faster rotor{'s' * (len(against) > 1)} {', '.join(against)}, the more the body turns in the "
                "sense that the configuration gives the rotor, seen from above, where drag turns it the other way: "
                "correct 'rotor1 rotation direction' or the rotors' numbers in the quadrotor's configuration"
            )
    return notes


def _slopes(prepared: Mapping[str, tuple], airframe: Airframe, axis: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Slope of a moment by each rotor's squared speed (4,) with standard errors; None where these flights tell none."""
    accelerating = all("w1_dot" in values for _, values, _ in prepared.values())
    beside = [e for e in BESIDE[axis] if accelerating or not e.endswith("_dot")]
    program = Program([parse(e) for e in (*(f"w{i}^2" for i in range(1, 5)), *beside)])
    columns, target, series = [], [], []
    for rows, values, _ in prepared.values():
        variables = Variables(values, airframe, None)
        columns.append(np.asarray(program.run(variables.__getitem__, len(rows))).T)
        target.append(values[axis])
        series.append(rows)
    stacked = np.concatenate(columns)
    used = [k for k in range(stacked.shape[1]) if k < 4 or stacked[:, k].any()]
    try:
        fit = least_squares(stacked[:, used], np.concatenate(target), series)
    except DataError:  # too few rows, a rotor that stands still: others say so
        return None
    return fit.coefficients[:4], np.sqrt(np.diag(fit.covariance)[:4])


def _side(x: float, y: float) -> str:
    return f"{'front' if x > 0 else 'aft'} {'right' if y > 0 else 'left'}"
