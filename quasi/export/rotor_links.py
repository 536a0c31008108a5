"""A vehicle split into a base and four rotor links that together have its mass, centre of gravity and inertia."""

from typing import NamedTuple

import numpy as np

from quasi.errors import DataError
from quasi.export.frames import swap_inertia, swap_vector
from quasi.export.physical_constants import Physical

ROTOR_MASS = 0.008  # of the vehicle's mass per rotor link: 0.016 kg of 2.06 kg in PX4's Gazebo model x500


class Links(NamedTuple):
    """Masses kg, positions m and inertias kg m2 in body axes x forward, y left, z up.

    centre (3,) of the base's mass; base (3, 3) about it; rotor (3, 3) of each rotor link about its own centre
    """

    base_mass: float
    centre: np.ndarray
    base: np.ndarray
    rotor_mass: float
    rotor: np.ndarray
    positions: np.ndarray


def check_inertia(physical: Physical, simulator: str) -> None:
    """Raises DataError where no rigid body has this inertia: one principal moment exceeds the sum of the others."""
    moments = np.linalg.eigvalsh(physical.inertia)
    if moments[2] > moments[0] + moments[1]:
        raise DataError(
            f"model {physical.name}: no rigid body has the principal inertias {moments[0]:.4g}, {moments[1]:.4g}, "
            f"{moments[2]:.4g} kg m2, the largest may be the sum of the others at most; {simulator} rejects it: "
            "correct 'moment of inertia' of the quadrotor configuration"
        )


def split_rotors(physical: Physical, simulator: str, height: float | None = None) -> Links:
    """Split a vehicle. The share of the rotor links is halved until the base is a possible rigid body.

    height  m, of all rotors above the centre of gravity; None for those of their hubs

    Raises DataError for an impossible inertia of the whole.
    """
    check_inertia(physical, simulator)
    positions, inertia = swap_vector(physical.positions), swap_inertia(physical.inertia)
    if height is not None:
        positions[:, 2] = height
    share = ROTOR_MASS
    while True:
        links = _split(physical, positions, inertia, share)
        moments = np.linalg.eigvalsh(links.base)
        if moments[0] > 0.0 and moments[2] <= moments[0] + moments[1]:
            return links
        if share < 1e-9:  # the whole is the limit: a flat plate has no inertia to spare
            return _split(physical, positions, inertia, 0.0)
        share *= 0.5


def join_rotors(links: Links) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of gravity (3,) and inertia (3, 3) about the origin of base and rotors together."""
    mass = links.base_mass + 4.0 * links.rotor_mass
    centre = (links.base_mass * links.centre + links.rotor_mass * links.positions.sum(axis=0)) / mass
    inertia = links.base + _displaced(links.base_mass, links.centre)
    for position in links.positions:
        inertia = inertia + links.rotor + _displaced(links.rotor_mass, position)
    return mass, centre, inertia


def _split(physical: Physical, positions: np.ndarray, inertia: np.ndarray, share: float) -> Links:
    rotor_mass = share * physical.mass
    base_mass = physical.mass - 4.0 * rotor_mass
    centre = -rotor_mass * positions.sum(axis=0) / base_mass
    disc = rotor_mass * physical.radius**2 * np.diag([0.25, 0.25, 0.5])  # a thin disc
    base = inertia - _displaced(base_mass, centre)
    for position in positions:
        base = base - disc - _displaced(rotor_mass, position)
    return Links(base_mass, centre, base, rotor_mass, disc, positions)


def _displaced(mass: float, position: np.ndarray) -> np.ndarray:
    """Steiner's part of an inertia."""
    return mass * (position @ position * np.eye(3) - np.outer(position, position))
