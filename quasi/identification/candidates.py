"""Polynomial specifications: the fixed regressors and the pool of candidates of one axis.

Syntax of the manual's 6.4, 9.2 and 9.3: P^degree(vars) x {sets}, that is all monomials of the vars with total degree
1..degree, each times every member of the sets. vars, sets and fixed regressors alike may be expressions.

Source: QuaSI user manual V1.0.a, sections 6.4, 9.2, 9.3.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from quasi.errors import ConfigError, ExpressionError, nearest
from quasi.terms.canonical import canonicalise
from quasi.terms.expressions import Tree, parse
from quasi.terms.variables import SYNONYMS

LARGEST_POOL = 200_000
BIAS = "bias"


@dataclass(frozen=True)
class Term:
    """One regressor: its text, which is its name too, and its tree."""

    expression: str
    tree: Tree


@dataclass(frozen=True)
class Specification:
    """What one axis may be made of.

    bias          whether a constant belongs to the model
    fixed         regressors that are always in it (without the constant)
    known         {fixed expression: coefficient} for those whose coefficient is given, not estimated
    candidates    the pool, each member unlike every other and unlike the fixed ones, in the order of the file
    duplicates    candidates left out because they are multiples of another regressor: (left out, kept)
    """

    axis: str
    bias: bool
    fixed: tuple[Term, ...]
    known: dict[str, float]
    candidates: tuple[Term, ...]
    duplicates: tuple[tuple[str, str], ...] = field(default=())

    @property
    def trees(self) -> tuple[Tree, ...]:
        """Trees of the fixed regressors, then of the candidates."""
        return tuple(t.tree for t in (*self.fixed, *self.candidates))


def read_specification(document: Mapping[str, Any], axis: str, where: str, bias: bool = True) -> Specification:
    """Fixed regressors and candidates of one axis.

    document  a specification {"Fx": {...}, ...} as the schema of polynomials has it
    axis      a section of it; where  the file, for messages; bias  whether a constant belongs to the model
    Raises ConfigError for a wrong section, ExpressionError for an expression that cannot be read; both name the place.
    """
    section = document[axis]
    place = f"{where}, {axis}"
    fixed = tuple(_term(text, f"{place}, fixed") for text in section.get("fixed", []))
    if not bias and not fixed:
        raise ConfigError(
            f"{place}: the constant term is switched off and no fixed regressor starts the regression; "
            f"add a fixed regressor or set 'add bias term {axis.lower()}' to true"
        )
    known = _known(section.get("fixed coefficients", {}), fixed, place)

    kept: dict[tuple, str] = {_key(("number", 1.0)): BIAS}
    for term in fixed:
        key = _key(term.tree)
        if not key or (key in kept and (kept[key] != BIAS or bias)):
            other = kept.get(key, "0")
            raise ConfigError(
                f"{place}: the fixed regressor '{term.expression}' is a multiple of '{other}'; remove one"
            )
        kept[key] = term.expression
    candidates, duplicates = [], []
    for term in _pool(section.get("candidates", []), place):
        key = _key(term.tree)
        if key in kept:
            duplicates.append((term.expression, kept[key]))
        elif key:
            kept[key] = term.expression
            candidates.append(term)
            if len(candidates) > LARGEST_POOL:
                raise ConfigError(
                    f"{place}: more than {LARGEST_POOL} candidates; lower a 'degree' or shorten 'vars' or 'sets'"
                )
    return Specification(axis, bias, fixed, known, tuple(candidates), tuple(duplicates))


def _key(tree: Tree) -> tuple:
    return canonicalise(tree, SYNONYMS)[1]


def _term(value: str | float, place: str) -> Term:
    text = value.strip() if isinstance(value, str) else f"{value:g}"
    try:
        return Term(text, parse(text))
    except ExpressionError as error:
        raise ExpressionError(f"{place}: {error}") from None


def _known(given: Mapping[str, float], fixed: Sequence[Term], place: str) -> dict[str, float]:
    texts = [t.expression for t in fixed]
    result = {}
    for text, value in given.items():
        if text not in texts:
            raise ConfigError(
                f"{place}: 'fixed coefficients' names '{text}', which is not under 'fixed'{nearest(text, texts)}"
            )
        result[text] = float(value)
    return result


def _pool(entries: Sequence[Mapping[str, Any]], place: str) -> Iterator[Term]:
    for number, entry in enumerate(entries, 1):
        here = f"{place}, candidates entry {number}"
        variables = [_term(v, f"{here}, vars") for v in entry["vars"]]
        factors = [_term(s, f"{here}, sets") for s in entry.get("sets", [1])]
        # by their number, before any is formed: repeated variables make duplicates that the pool's size does not count
        degree = min(int(entry["degree"]), LARGEST_POOL)
        if len(factors) * (math.comb(len(variables) + degree, degree) - 1) > LARGEST_POOL:
            raise ConfigError(
                f"{here}: {len(variables)} variables at degree {degree} with {len(factors)} sets make more than "
                f"{LARGEST_POOL:,} candidates; lower 'degree' or shorten 'vars' or 'sets'"
            )
        for factor in factors:
            for powers in _exponents(len(variables), degree):
                yield _monomial(factor, variables, powers)


def _exponents(variables: int, degree: int) -> Iterator[tuple[int, ...]]:
    # by total degree, then the earlier variables first
    for total in range(1, degree + 1):
        for chosen in itertools.combinations_with_replacement(range(variables), total):
            yield tuple(chosen.count(i) for i in range(variables))


def _monomial(factor: Term, variables: Sequence[Term], powers: tuple[int, ...]) -> Term:
    parts, trees = [], []
    for variable, power in zip(variables, powers):
        if power:
            parts.append(f"{_bracketed(variable)}^({float(power)})")
            trees.append((1, ("power", variable.tree, ("number", float(power)))))
    text = f"({' * '.join(parts)})"
    if factor.tree != ("number", 1.0):
        text = f"({factor.expression})*{text}"
        trees.insert(0, (1, factor.tree))
    # a flat product, so that a program shares the leading factors between neighbours of the pool
    return Term(text, ("product", tuple(trees)) if len(trees) > 1 else trees[0][1])


def _bracketed(variable: Term) -> str:
    return variable.expression if variable.tree[0] == "name" else f"({variable.expression})"
