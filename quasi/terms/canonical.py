"""The algebra of expressions: which of them are multiples of each other."""

from collections.abc import Mapping

from quasi.terms.expressions import MAX_EXPANDED_POWER, Tree, text

_MAX_EXPANDED_TERMS = 400  # a sum with more terms after expansion stays closed


def canonicalise(tree: Tree, synonyms: Mapping[str, Tree] | None = None) -> tuple[float, tuple]:
    """(factor, key): two expressions with equal keys are multiples of each other, their ratio that of the factors.

    Sums are multiplied out (up to a limit) and sorted, powers of one base are gathered, |a|^2 is a^2, and `synonyms`
    replaces names by trees ({"wtot": ("name", "w_tot")}). Equal keys mean proportional expressions; unequal keys do not
    prove the opposite.
    """
    try:
        poly = _expand_polynomial(tree, synonyms or {})
    except (OverflowError, ZeroDivisionError, ValueError):  # numbers beyond the floats: compared as written
        return 1.0, ("as written", text(tree))
    if not poly:
        return 0.0, ()
    factor, (_, key) = _close_polynomial(poly)
    return factor, key


def _gather_powers(powers: dict[tuple, float]) -> tuple:
    merged: dict[tuple, float] = {}
    for atom, exponent in powers.items():
        name = atom[1] if atom[0] == "name" else ""
        if len(name) > 2 and name[0] == name[-1] == "|" and exponent == int(exponent):
            even = exponent - exponent % 2
            inner = ("name", name[1:-1])
            merged[inner] = merged.get(inner, 0.0) + even
            exponent -= even
        merged[atom] = merged.get(atom, 0.0) + exponent
    return tuple(sorted(((a, e) for a, e in merged.items() if e != 0.0), key=repr))


def _multiply(a: dict, b: dict) -> dict:
    result: dict = {}
    for ma, ca in a.items():
        for mb, cb in b.items():
            powers: dict = dict(ma)
            for atom, exponent in mb:
                powers[atom] = powers.get(atom, 0.0) + exponent
            monomial = _gather_powers(powers)
            result[monomial] = result.get(monomial, 0.0) + ca * cb
    return {m: c for m, c in result.items() if c != 0.0}


def _close_polynomial(poly: dict) -> tuple[float, tuple]:
    items = sorted(poly.items(), key=lambda item: repr(item[0]))
    factor = items[0][1]
    # twelve digits: sums that were formed in another order differ in the last ones
    return factor, ("closed", tuple((m, float(f"{c / factor:.12g}")) for m, c in items))


def _raise_polynomial(poly: dict, exponent: float) -> dict:
    if not poly:
        return {} if exponent > 0 else {((("name", "1/0"), 1.0),): 1.0}
    if len(poly) == 1:
        ((monomial, c),) = poly.items()
        whole = exponent == int(exponent)
        roots = whole or all(_is_even(a, e) for a, e in monomial)
        if (c > 0 and roots) or whole:
            powers = [(_make_absolute(a) if not whole and e % 2 == 0 else a, e * exponent) for a, e in monomial]
            gathered: dict = {}
            for atom, e in powers:
                gathered[atom] = gathered.get(atom, 0.0) + e
            return {_gather_powers(gathered): c**exponent}
    if exponent == int(exponent) and 0 <= exponent <= MAX_EXPANDED_POWER:
        result: dict = {(): 1.0}
        for _ in range(int(exponent)):
            if len(result) * len(poly) > _MAX_EXPANDED_TERMS:
                break
            result = _multiply(result, poly)
        else:
            return result
    factor, atom = _close_polynomial(poly)
    if exponent == int(exponent):
        return {((atom, float(exponent)),): factor**exponent}
    # the sign belongs inside: (-s)^0.5 is not a multiple of s^0.5
    sign = 1.0 if factor > 0 else -1.0
    return {(((*atom, sign), float(exponent)),): abs(factor) ** exponent}


def _is_even(atom: tuple, exponent: float) -> bool:
    # of a sum in brackets there is no size to take the root of
    return (exponent % 2 == 0 and atom[0] == "name") or (atom[0] == "name" and atom[1].startswith("|"))


def _make_absolute(atom: tuple) -> tuple:
    return ("name", f"|{atom[1]}|") if atom[0] == "name" and not atom[1].startswith("|") else atom


def _expand_polynomial(tree: Tree, synonyms: Mapping[str, Tree]) -> dict:
    # {monomial: coefficient}, a monomial being sorted pairs (atom, exponent)
    kind = tree[0]
    if kind == "number":
        return {(): tree[1]} if tree[1] != 0.0 else {}
    if kind == "name":
        if tree[1] in synonyms:
            return _expand_polynomial(synonyms[tree[1]], synonyms)
        return {((tree, 1.0),): 1.0}
    if kind == "negative":
        return {m: -c for m, c in _expand_polynomial(tree[1], synonyms).items()}
    if kind == "sum":
        result: dict = {}
        for sign, part in tree[1]:
            for monomial, c in _expand_polynomial(part, synonyms).items():
                result[monomial] = result.get(monomial, 0.0) + sign * c
        return {m: c for m, c in result.items() if c != 0.0}
    if kind == "product":
        result = {(): 1.0}
        for sign, part in tree[1]:
            factor = _expand_polynomial(part, synonyms)
            factor = factor if sign > 0 else _raise_polynomial(factor, -1.0)
            if len(result) * len(factor) > _MAX_EXPANDED_TERMS:
                result, factor = _whole(result), _whole(factor)
            result = _multiply(result, factor)
        return result
    base, exponent = _expand_polynomial(tree[1], synonyms), _expand_polynomial(tree[2], synonyms)
    if not exponent:
        return {(): 1.0}
    if set(exponent) == {()}:
        return _raise_polynomial(base, exponent[()])
    return {((("raised", repr(_sort_monomials(base)), repr(_sort_monomials(exponent))), 1.0),): 1.0}


def _sort_monomials(poly: dict) -> list:
    return sorted(poly.items(), key=repr)


def _whole(poly: dict) -> dict:
    if len(poly) <= 1:
        return poly
    factor, atom = _close_polynomial(poly)
    return {((atom, 1.0),): factor}
