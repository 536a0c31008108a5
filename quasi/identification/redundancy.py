"""Regressors that the non-dimensional scheme makes equal to others, found from the specification alone.

With w_i/a in place of w_i the sum of the squared rotor speeds is the number 4, and over the airspeed
(u^2 + v^2 + w^2)^0.5 is 1. Such regressors are multiples of the constant term, others become multiples of each other.
They are found by evaluating all regressors at random states in which the scheme's lower limits are not reached:
functions of this kind (sums, products, roots) that are proportional there are proportional everywhere, for the states
at which unlike ones agree have no volume (identity testing: Schwartz, Fast probabilistic algorithms for verification of
polynomial identities, J. ACM 27(4), 1980).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quasi.airframe import Airframe
from quasi.identification.candidates import BIAS, Specification, Term
from quasi.terms.expressions import Program, names
from quasi.terms.normalisation import Normalisation
from quasi.terms.variables import Variables, base_columns

COMPARED_STATES = 48  # random states at which regressors are compared
DEPENDENT = 1e-9  # share of a column left after the others that is no more than rounding
COMPARED_DIGITS = 9  # significant ones to which two proportional columns must agree


def drop_redundant(
    specification: Specification, normalisation: Normalisation, airframe: Airframe
) -> tuple[Specification, list[str]]:
    """The specification without regressors that repeat others under the scheme, and a note on each kind.

    A fixed regressor is left out where it is a combination of the constant term and the fixed ones before it; one whose
    coefficient is given stays. A candidate is left out where it is a multiple of another regressor.
    """
    terms = [*specification.fixed, *specification.candidates]
    table = _at_random_states(terms, normalisation, airframe)
    values = dict(zip((t.expression for t in terms), table))
    axis, notes = specification.axis, []
    kept, basis = [], [np.ones(table.shape[1])] if specification.bias else []
    for term in specification.fixed:
        column = values[term.expression]
        if term.expression not in specification.known and basis and _is_combination(column, basis):
            constant = np.ptp(column) <= DEPENDENT * np.abs(column).max()
            of = "the constant term" if constant else "the other fixed regressors"
            notes.append(
                f"{axis}: the fixed regressor '{term.expression}' is a multiple or combination of {of} under the "
                "non-dimensional scheme and is left out"
            )
            continue
        kept.append(term)
        if term.expression not in specification.known:
            basis.append(column)
    known = {_direction(np.ones(table.shape[1])): BIAS} if specification.bias else {}
    known |= {_direction(values[t.expression]): t.expression for t in kept}
    candidates, duplicates = [], []
    for term in specification.candidates:
        direction = _direction(values[term.expression])
        if direction in known:
            duplicates.append((term.expression, known[direction]))
        else:
            known[direction] = term.expression
            candidates.append(term)
    if duplicates:
        first, of = duplicates[0]
        notes.append(
            f"{axis}: {len(duplicates)} candidates are multiples of other regressors under the non-dimensional scheme "
            f"and are left out ('{first}' of '{of}' first)"
        )
    found = replace(
        specification,
        fixed=tuple(kept),
        candidates=tuple(candidates),
        duplicates=(*specification.duplicates, *duplicates),
    )
    return found, notes


def _at_random_states(terms: Sequence[Term], scheme: Normalisation, airframe: Airframe) -> np.ndarray:
    """Values (terms, rows) of regressors at random states above the scheme's limits."""
    random = np.random.default_rng(0)
    rows = COMPARED_STATES + len(terms[:COMPARED_STATES])
    wanted = {name for term in terms for name in names(term.tree)}
    columns = {}
    # sorted: the same numbers whatever the order of the set
    for name in sorted({"u", "v", "w"}.union(*(base_columns(n, scheme) for n in wanted))):
        if name in ("w1", "w2", "w3", "w4"):
            columns[name] = random.uniform(1.05 * scheme.idle, max(scheme.top, 1.1 * scheme.idle), rows)
        else:
            columns[name] = random.uniform(0.1, 3.0, rows) * random.choice([-1.0, 1.0], rows)
    variables = Variables(columns, airframe, 0.6 * scheme.top, scheme)
    with np.errstate(all="ignore"):
        return Program([t.tree for t in terms]).run(variables.__getitem__, rows)


def _is_combination(column: np.ndarray, basis: Sequence[np.ndarray]) -> bool:
    columns = np.array([b / np.linalg.norm(b) for b in basis]).T
    weights = np.linalg.lstsq(columns, column, rcond=None)[0]
    return bool(np.linalg.norm(column - columns @ weights) <= DEPENDENT * np.linalg.norm(column))


def _direction(column: np.ndarray) -> tuple[str, ...]:
    """The column up to a factor, as text that rounding does not change; a root of a negative number is no number."""
    largest = int(np.argmax(np.nan_to_num(np.abs(column))))
    scale = column[largest] if column[largest] else 1.0
    return tuple(f"{value:.{COMPARED_DIGITS}f}" for value in column / scale)
