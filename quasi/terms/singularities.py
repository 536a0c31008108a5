"""Regressors at stopped rotors: singularities that cancel are cancelled, the others are bounded.

`w_avg*mu_x` is u/R, but computed as written it is 0 x inf where the rotors stand still. An expression is therefore
rewritten as a sum of products in the speeds S = w_avg, w_tot, w1..w4, with whole or fractional exponents:

    sum over k of  c_k  w_avg^a_k  w_tot^b_k  w1^..       c_k free of S

mu_x stands for u / (R w_avg), and equal speeds cancel within each product. This is exact: the rewritten expression
equals the written one wherever that is finite, and has its limit where the singularity is removable.

A speed that keeps a negative exponent has a pole, or a limit that depends on how the rotors stop. There the speed is
not taken below the lowest one of the training flights: `w_avg_flown` = max(w_avg, lowest). Predictions within the
flown range do not change, those at slower rotors are an extrapolation that stays finite.

Under the non-dimensional scheme the speeds have a lower limit already; nothing is rewritten there.
"""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from quasi.terms.expressions import MAX_EXPANDED_POWER, Tree, names

MIN_DENOMINATOR_SPEED = (
    1.0  # rad/s, one turn in 6 s: lower limit of a speed in a denominator where no flown speed is known
)
SPEED_VARIABLES = ("w_avg", "w_tot", "w1", "w2", "w3", "w4")
FLOWN_SPEEDS = {f"{name}_flown": name for name in SPEED_VARIABLES}
ADVANCE_RATIOS = {"mu_x": "u", "mu_y": "v", "mu_z": "w", "mu_vin": "v_in"}  # over the tip speed w_avg R
_SAME = {"wavg": "w_avg", "wtot": "w_tot"}
_MAX_PRODUCTS = 64  # products that one regressor is multiplied out to; a larger sum keeps its form

Exponents = tuple[tuple[str, float], ...]
Parts = dict[Exponents, Tree]
_UNIT_NUMBER: Tree = ("number", 1.0)


def find_speed_limits(slowest: Iterable[float] | None) -> dict[str, float]:
    """Lower limits {speed: rad/s} of the speeds in a denominator.

    slowest  (4,) lowest speed of each rotor in the training flights, rad/s; None where unknown
    Each limit is at most what the flights had at any time: the rotors need not have been slowest together.
    """
    each = np.maximum(np.zeros(4) if slowest is None else np.asarray(list(slowest), float), MIN_DENOMINATOR_SPEED)
    limits = {"w_avg": float(np.sqrt(np.mean(each**2))), "w_tot": float(each.sum())}
    return limits | {f"w{i}": float(each[i - 1]) for i in range(1, 5)}


@lru_cache(maxsize=65536)
def remove_singularities(tree: Tree, radius: float) -> Tree:
    """The same expression without singularities at stopped rotors, see the head of the module.

    tree  of SI variables; radius  of the rotors, m
    A tree that neither divides nor holds an advance ratio is returned as it is.
    """
    if not _may_be_singular(tree):
        return tree
    return _join(_expand(tree, radius))


def _may_be_singular(tree: Tree) -> bool:
    if any(name.strip("|") in ADVANCE_RATIOS for name in names(tree)):
        return True
    return _divides(tree) and any(
        name in SPEED_VARIABLES or name in _SAME or name.startswith("w2_") for name in names(tree)
    )


def _divides(tree: Tree) -> bool:
    kind = tree[0]
    if kind in ("number", "name"):
        return False
    if kind in ("sum", "product"):
        return any((kind == "product" and sign < 0) or _divides(part) for sign, part in tree[1])
    if kind == "power":
        exponent = _constant(tree[2])
        return exponent is None or exponent < 0 or _divides(tree[1])
    return _divides(tree[1])


def _constant(tree: Tree) -> float | None:
    if tree[0] == "number":
        return tree[1]
    if tree[0] == "negative":
        inner = _constant(tree[1])
        return None if inner is None else -inner
    return None


def _expand(tree: Tree, radius: float) -> Parts:
    kind = tree[0]
    if kind == "name":
        return _expand_name(tree[1], radius)
    if kind == "number":
        return {(): tree}
    if kind == "negative":
        return {key: ("negative", part) for key, part in _expand(tree[1], radius).items()}
    if kind == "sum":
        return _add([(sign, _expand(part, radius)) for sign, part in tree[1]])
    if kind == "product":
        result: Parts = {(): _UNIT_NUMBER}
        for sign, part in tree[1]:
            factor = _expand(part, radius)
            result = _multiply(result, factor if sign > 0 else _raise(factor, -1.0))
        return result
    exponent = _constant(tree[2])
    if exponent is None:
        return {(): ("power", _join(_expand(tree[1], radius)), _join(_expand(tree[2], radius)))}
    return _raise(_expand(tree[1], radius), exponent)


def _expand_name(name: str, radius: float) -> Parts:
    name = _SAME.get(name, name)
    if name in SPEED_VARIABLES:
        return {((name, 1.0),): _UNIT_NUMBER}
    if name.startswith("w2_"):
        return {((f"w{name[3:]}", 2.0),): _UNIT_NUMBER}
    magnitude = len(name) > 2 and name[0] == name[-1] == "|"
    inner = name.strip("|") if magnitude else name
    if inner in ADVANCE_RATIOS:
        velocity = f"|{ADVANCE_RATIOS[inner]}|" if magnitude else ADVANCE_RATIOS[inner]
        return {(("w_avg", -1.0),): ("product", ((1, ("name", velocity)), (-1, ("number", radius))))}
    return {(): ("name", name)}


def _add(parts: Iterable[tuple[int, Parts]]) -> Parts:
    gathered: dict[Exponents, list[tuple[int, Tree]]] = {}
    for sign, part in parts:
        for key, tree in part.items():
            gathered.setdefault(key, []).append((sign, tree))
    return {key: _sum(trees) for key, trees in gathered.items()}


def _sum(signed: list[tuple[int, Tree]]) -> Tree:
    if len(signed) == 1:
        sign, tree = signed[0]
        return tree if sign > 0 else ("negative", tree)
    return ("sum", tuple(signed))


def _multiply(a: Parts, b: Parts) -> Parts:
    if len(a) * len(b) > _MAX_PRODUCTS:
        a, b = ({(): _join(p)} if len(p) > 1 else p for p in (a, b))
    made = []
    for left, first in a.items():
        for right, second in b.items():
            exponents = dict(left)
            for name, exponent in right:
                exponents[name] = exponents.get(name, 0.0) + exponent
            key = tuple(sorted((n, e) for n, e in exponents.items() if e != 0.0))
            made.append((1, {key: _product(first, second)}))
    return _add(made)


def _product(a: Tree, b: Tree) -> Tree:
    factors = [*_factors(a), *_factors(b)]
    if not factors:
        return _UNIT_NUMBER
    return factors[0][1] if len(factors) == 1 and factors[0][0] > 0 else ("product", tuple(factors))


def _factors(tree: Tree) -> list[tuple[int, Tree]]:
    if tree == _UNIT_NUMBER:
        return []
    return list(tree[1]) if tree[0] == "product" else [(1, tree)]


def _raise(parts: Parts, exponent: float) -> Parts:
    if exponent == 0.0:
        return {(): _UNIT_NUMBER}
    whole = exponent == int(exponent)
    if len(parts) == 1:
        ((key, tree),) = parts.items()
        # a root may only be taken of what is never negative: the root mean square, and even powers
        if whole or all(name == "w_avg" for name, _ in key):
            raised = tuple((name, e * exponent) for name, e in key)
            return {raised: _UNIT_NUMBER if tree == _UNIT_NUMBER else _power(tree, exponent)}
    elif whole and 2 <= exponent <= MAX_EXPANDED_POWER:
        result = parts
        for _ in range(int(exponent) - 1):
            result = _multiply(result, parts)
        return result
    return {(): _power(_join(parts), exponent)}


def _power(tree: Tree, exponent: float) -> Tree:
    if exponent == 1.0:
        return tree
    if exponent == -1.0:
        return ("product", ((1, _UNIT_NUMBER), (-1, tree)))
    return ("power", tree, ("number", exponent))


def _join(parts: Parts) -> Tree:
    terms = []
    for key, tree in parts.items():
        factors = _factors(tree)
        for name, exponent in key:
            speed = ("name", name if exponent > 0 else f"{name}_flown")
            size = abs(exponent)
            factors.append((1 if exponent > 0 else -1, speed if size == 1.0 else ("power", speed, ("number", size))))
        if not factors:
            terms.append((1, _UNIT_NUMBER))
        elif len(factors) == 1 and factors[0][0] > 0:
            terms.append((1, factors[0][1]))
        else:
            terms.append((1, ("product", tuple([(1, _UNIT_NUMBER), *factors] if factors[0][0] < 0 else factors))))
    return _sum(terms)
