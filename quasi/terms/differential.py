"""Derivatives of a model: Jacobians of its forces and moments, and the differential form of its moments.

The rotational equations of motion I dw/dt = M - w x I w, with w = (p, q, r), M the model's moments and u any inputs:

    d/dt (dw/dt) = A(x, u) dw/dt + B(x, u) du/dt
    A = I^-1 (dM/dw - d(w x I w)/dw),     B = I^-1 dM/du,     d(w x I w)/dw = [w x] I - [(I w) x]

All nine entries of each Jacobian and the full inertia take part. Derivatives are exact: they come from the expressions,
not from differences. |a| has the derivative sign(a), 0 at 0; where none exists (a root at 0) they are inf or NaN.

An input u is either a base column (w1..w4, battery_voltage, ...), and then every variable that is made of it moves with
it; or a variable such as U_p, and then everything else stays as it is, other combinations of the rotor speeds included.

Source: QuaSI user manual V1.0.a, listing 5 ("make moment DiffSys"); Euler's equations as in Stevens, Lewis & Johnson,
Aircraft Control and Simulation, 3rd ed., 2016, section 1.7.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from quasi.errors import ConfigError
from quasi.terms.kernel import INPUTS
from quasi.terms.variables import base_columns, check_system_inputs, plain_name

RATES = ("p", "q", "r")


class Jacobian(NamedTuple):
    """Derivatives of Fx Fy Fz Mx My Mz (the six rows; N, N m) for N rows of data; one row drops the leading axis.

    state (N, 6, 12) by roll pitch yaw, u v w, p q r, x y z; rotor_speeds and rotor_accelerations (N, 6, 4)
    """

    state: np.ndarray
    rotor_speeds: np.ndarray
    rotor_accelerations: np.ndarray


class DifferentialSystem(NamedTuple):
    """Differential form for N rows of data; one row drops the leading axis. x = (p, q, r), u the inputs asked for.

    A (N, 3, 3), B (N, 3, k)  d/dt (dx/dt) = A dx/dt + B du/dt, in rad/s2 per unit of x and u, each per second
    moments_x (N, 3, 3), moments_u (N, 3, k)  derivatives of Mx My Mz (N m); forces_x, forces_u  of Fx Fy Fz (N)
    u  names of the inputs
    """

    A: np.ndarray
    B: np.ndarray
    moments_x: np.ndarray
    moments_u: np.ndarray
    forces_x: np.ndarray
    forces_u: np.ndarray
    u: tuple[str, ...]


def split_jacobian(values: np.ndarray) -> Jacobian:
    """Jacobian from (120, N) derivatives by INPUTS, axis after axis."""
    table = values.reshape(6, len(INPUTS), -1).transpose(2, 0, 1)
    return Jacobian(table[:, :, :12], table[:, :, 12:16], table[:, :, 16:])


def form_system(values: np.ndarray, rates: np.ndarray, inertia: np.ndarray, u: Sequence[str]) -> DifferentialSystem:
    """Differential form from derivatives (6 (3 + k), N) by p q r and u, axis after axis.

    rates (N, 3) rad/s; inertia (3, 3) kg m2, body axes
    """
    table = values.reshape(6, 3 + len(u), -1).transpose(2, 0, 1)
    moments_x, moments_u = table[:, 3:, :3], table[:, 3:, 3:]
    gyroscopic = cross_matrix(rates) @ inertia - cross_matrix(rates @ inertia.T)
    inverse = np.linalg.inv(inertia)
    with np.errstate(invalid="ignore", over="ignore"):  # rows that have no derivative come out as NaN
        a, b = inverse @ (moments_x - gyroscopic), inverse @ moments_u
    return DifferentialSystem(
        a, b,
        moments_x, moments_u, table[:, :3, :3], table[:, :3, 3:], tuple(u),
    )  # fmt: skip


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Matrices (N, 3, 3) with [a x] b = a x b, of vectors (N, 3)."""
    x, y, z = vectors.T
    o = np.zeros(len(vectors))
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)


def make_differential_system(
    model: Any,
    state: np.ndarray,
    rotor_speeds: np.ndarray,
    u: Iterable[str] | None = None,
    rotor_accelerations: np.ndarray | None = None,
    extra: Mapping[str, np.ndarray] | None = None,
) -> DifferentialSystem:
    """The rotational dynamics of a model in differential form, see the head of the module.

    model  a Model; u  inputs, None takes those that the model was configured with
    The other arguments as for `Model.predict`; one row of them drops the leading axis of the result.
    Raises ShapeError, ExpressionError, or ConfigError for inputs that cannot be, and when a moment is missing.
    """
    if u is None:
        chosen = model.document.get("differential form")
        if not isinstance(chosen, Mapping) or not isinstance(chosen.get("u"), list):
            raise ConfigError(
                f"model {model.id} was made without a differential form; name the inputs u, "
                "or set 'make moment DiffSys' in the model's configuration"
            )
        u = chosen["u"]
    u = check_system_inputs(u, f"model {model.id}")
    lacking = [axis for axis in ("Mx", "My", "Mz") if axis not in model.axes]
    if lacking:
        raise ConfigError(f"model {model.id} lacks {', '.join(lacking)}; a differential form needs all three moments")
    kernel = model.derivative_kernel((*RATES, *u))
    values = model.run(kernel, state, rotor_speeds, rotor_accelerations, extra)
    rates = np.atleast_2d(np.asarray(state, float))[:, 6:9]
    found = form_system(values, rates, model.airframe.inertia, u)
    return DifferentialSystem(*(part[0] for part in found[:-1]), u) if np.ndim(state) == 1 else found


def list_held_inputs(u: Iterable[str]) -> tuple[str, ...]:
    """Those of the inputs that are no base columns: derivatives treat them as independent."""
    return tuple(name for name in u if base_columns(name) != {name})


def list_held_variables(names: Iterable[str], u: Iterable[str]) -> list[str]:
    """Variables of a model that move with the same columns as a held input, and stay as they are in its derivative."""
    held = list_held_inputs(u)
    columns = set().union(*(base_columns(n) for n in held), set())
    found = []
    for name in names:
        plain = plain_name(name)
        if plain not in held and base_columns(plain) & columns and plain not in found:
            found.append(plain)
    return found
