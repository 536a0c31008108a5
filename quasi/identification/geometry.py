"""Whether rotors sit and turn where the configuration says, from the effect of each one's speed on the moments.

A thrust k W^2 at the hub (x, y) makes the moments -y k W^2 about x and x k W^2 about y; its drag turns the body against
the rotor's sense. A wrong rotor order or sense leaves every score of an identified model as it was, and turns up
only where the model is flown.
"""

from collections.abc import Mapping

import numpy as np

from quasi.airframe import Airframe
from quasi.identification.offsets import fit_with_offsets
from quasi.sensor_limits import describe_impossible_inertia
from quasi.terms.expressions import Program, parse
from quasi.terms.variables import Variables

SURE = 5.0  # standard errors
LARGEST_MISPLACEMENT = 0.6  # of the arm, between where a rotor is configured and where it seems to be
LARGEST_COMMON_RATIO = 1.5  # between the factors of roll and pitch that are reported as one
# what acts on a moment besides the rotors' thrusts and drag
OTHER_MOMENT_TERMS = {"Mx": ("p", "w_tot*v", "u_p_dot"), "My": ("q", "w_tot*u", "u_q_dot"), "Mz": ("r", "u_r_dot")}


def contradicting_places(
    slopes: Mapping[str, tuple[np.ndarray, np.ndarray]], airframe: Airframe, thrust: float
) -> list[str]:
    """Sentences on rotors that seem to be elsewhere, or to turn the other way, than the airframe says.

    slopes  {"Mx", "My", "Mz": slope of the moment by what each rotor's thrust is in proportion to (4,), its standard
            errors (4,)}; thrust  the same slope of one rotor's thrust
    """
    if not thrust > 0.0:
        return [
            f"the faster the rotors turn, the less they lift (thrust factor {thrust:.2g} N s2/rad2): check the sign "
            "and axes of the accelerometer, and the rotor speeds"
        ]
    hubs = airframe.hubs[:, :2]
    seen = np.stack([slopes["My"][0], -slopes["Mx"][0]], axis=1) / thrust
    std = np.stack([slopes["My"][1], slopes["Mx"][1]], axis=1) / thrust
    elsewhere = (np.abs(seen - hubs) > np.maximum(LARGEST_MISPLACEMENT * airframe.arm, SURE * std)).any(axis=1)
    scaled = _scaled(seen, std, hubs, airframe.arm) if elsewhere.any() else None
    # rotors that push nowhere are in moments that do not hold their answer (rates without a gyro), not elsewhere
    reach = np.hypot(*seen.T) + SURE * np.hypot(*std.T)
    if not scaled and (reach < (1.0 - LARGEST_MISPLACEMENT) * airframe.arm).all():
        elsewhere[:] = False
    places = [
        f"rotor {i + 1} pushes as if it were {_side(*seen[i])} (x = {seen[i, 0]:.2f} m, y = {seen[i, 1]:.2f} m), "
        f"the configuration has it {_side(*hubs[i])} (x = {hubs[i, 0]:.2f} m, y = {hubs[i, 1]:.2f} m)"
        for i in np.flatnonzero(elsewhere)
    ]
    notes = [fault] if (fault := describe_impossible_inertia(airframe.inertia, True)) else []
    if scaled:
        notes.append(scaled)
    elif places:
        notes.append(
            f"{'; '.join(places)}: correct the rotors' numbers or places in the quadrotor's configuration, and import "
            "anew"
        )
    value, std = slopes["Mz"]
    against = [str(i + 1) for i in range(4) if value[i] * airframe.spin[i] > SURE * std[i]]
    if against:
        notes.append(
            f"the faster rotor{'s' * (len(against) > 1)} {', '.join(against)}, the more the body turns in the "
            "sense that the configuration gives the rotor, seen from above, where drag turns it the other way: "
            "correct 'rotor1 rotation direction' or the rotors' numbers in the quadrotor's configuration"
        )
    return notes


def _scaled(seen: np.ndarray, std: np.ndarray, hubs: np.ndarray, arm: float) -> str | None:
    """A sentence where rotors push from their own directions, but as if all arms were longer or shorter; else None.

    seen, std, hubs  (4, 2), x and y, m. A moment about x gives y: the factor on y is that of roll.
    """
    factor = np.sum(seen * hubs, axis=0) / np.sum(hubs**2, axis=0)
    doubt = np.sqrt(np.sum((std * hubs) ** 2, axis=0)) / np.sum(hubs**2, axis=0)
    left = np.abs(seen - factor * hubs)
    if (factor <= SURE * doubt).any() or (left > np.maximum(LARGEST_MISPLACEMENT * arm * factor, SURE * std)).any():
        return None

    def words(f: float) -> str:
        return f"{max(f, 1 / f):.2g} times {'longer' if f > 1 else 'shorter'} than configured"

    pitch, roll = factor.tolist()
    if max(pitch, roll) < LARGEST_COMMON_RATIO * min(pitch, roll):
        ratio = words(float(np.sqrt(pitch * roll)))
    else:
        ratio = f"{words(roll)} in roll and {words(pitch)} in pitch"
    return (
        f"all rotors push from the directions in which the configuration has them, but as if their arms were {ratio}: "
        "check the mass, the moments of inertia, 'b' and the unit of the gyro, and import anew"
    )


def rotor_slopes(
    prepared: Mapping[str, tuple], airframe: Airframe, axis: str, power: int = 2
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Slope of a moment by each rotor's speed to a power (4,), its covariance (4, 4), and what else was in the fit.

    prepared  {flight: (rows, values by column, mass)} of training rows
    Raises DataError where the flights give none: too few rows, a rotor that stands still.
    """
    accelerating = all("w1_dot" in values for _, values, _ in prepared.values())
    others = [e for e in OTHER_MOMENT_TERMS[axis] if accelerating or not e.endswith("_dot")]
    program = Program([parse(e) for e in (*(f"w{i}^{power}" for i in range(1, 5)), *others)])
    columns, target, series = [], [], []
    for rows, values, _ in prepared.values():
        variables = Variables(values, airframe, None)
        columns.append(np.asarray(program.run(variables.__getitem__, len(rows))).T)
        target.append(values[axis])
        series.append(rows)
    stacked = np.concatenate(columns)
    used = [k for k in range(stacked.shape[1]) if k < 4 or stacked[:, k].any()]
    fit = fit_with_offsets(stacked[:, used], np.concatenate(target), series)
    return fit.coefficients[:4], fit.covariance[:4, :4], [others[k - 4] for k in used[4:]]


def _side(x: float, y: float) -> str:
    return f"{'front' if x > 0 else 'aft'} {'right' if y > 0 else 'left'}"
