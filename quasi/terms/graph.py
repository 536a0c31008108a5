"""The terms of a model as one graph of base columns, in which equal parts stand once; exact derivatives of it.

Trees of the parser name variables (U_p, mu_x, |u|, sin[roll]); the graph knows how each is made from base columns
(w1..w4, u, v, w, ...), so that it can be evaluated, differentiated and written in other languages without them.

A value is (factor, node): the factor is a plain number, so that constants never take part in the arithmetic. Nodes are
whole numbers that stand for plain tuples:

    ("one",)                            the number 1
    ("constant", c)
    ("input", name)                     a base column
    ("held", name, value node)          a variable that derivatives treat as independent
    ("product", ((node, n), ...))       n a whole number of 1 or more
    ("quotient", a, b)
    ("sum", ((node, factor), ...))
    ("power", a, b)
    ("abs" | "sign" | "sqrt" | "sin" | "cos" | "log" | "wrap", a)      wrap brings an angle to +-pi

Source of the variables: `quasi.terms.variables` (QuaSI user manual V1.0.a, Table 2).
"""

import math
from collections.abc import Iterable, Mapping

from quasi.airframe import Airframe
from quasi.errors import ExpressionError
from quasi.terms.expressions import Tree
from quasi.terms.normalisation import Normalisation
from quasi.terms.singularities import ADVANCE_RATIOS, FLOWN_SPEEDS, find_speed_limits
from quasi.terms.variables import SYNONYMS, split_function

Value = tuple[float, int]
Combination = dict[int, float]  # {node: factor}: the sum of factor x node
ONE = 0
_MAX_WHOLE_POWER = 32  # the largest power that is formed by multiplying
_MAX_FACTORS = 64  # the most factors that a product is taken apart into


class Graph:
    """Values of expressions as shared nodes.

    airframe     signs of the rotors and the rotor radius
    hover_speed  rad/s, or None when unknown (then d_w... cannot be asked)
    held         variables, such as U_p, that derivatives treat as independent of everything else
    normalisation  the non-dimensional scheme, under which names stand for other quantities; None for SI
    slowest      (4,) rad/s, lowest speed of each rotor in the training flights; None where unknown
    """

    def __init__(
        self,
        airframe: Airframe,
        hover_speed: float | None,
        held: Iterable[str] = (),
        normalisation: Normalisation | None = None,
        slowest: Iterable[float] | None = None,
    ) -> None:
        self._lowest = find_speed_limits(slowest)
        self.nodes: list[tuple] = []
        self._known: dict[tuple, int] = {}
        self._airframe = airframe
        self._hover = hover_speed
        self._held = frozenset(held)
        self._trees = normalisation.trees if normalisation else {}
        self._plain = False  # whether names stand for their SI quantities at the moment
        self._named: dict[tuple[str, bool], Value] = {}
        self._derivatives: dict[tuple[int, int], Combination] = {}
        self.node("one")

    def node(self, *key) -> int:
        """Number of a node, the same for the same content."""
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(key)
        return self._known[key]

    # ---- values ----

    def value(self, tree: Tree) -> Value:
        """Value of an expression. Raises ExpressionError for d_w... without a hover speed."""
        kind = tree[0]
        if kind == "number":
            return tree[1], ONE
        if kind == "name":
            return self.variable(tree[1])
        if kind == "negative":
            factor, node = self.value(tree[1])
            return -factor, node
        if kind == "power":
            return self._power(self.value(tree[1]), tree[2])
        if kind == "sum":
            return self.sum([(sign * f, n) for sign, (f, n) in ((s, self.value(part)) for s, part in tree[1])])
        result: Value = (1.0, ONE)
        for sign, part in tree[1]:
            value = self.value(part)
            result = self.times(result, value) if sign > 0 else self.over(result, value)
        return result

    def variable(self, name: str) -> Value:
        """Value of a candidate variable; a name outside the manual's table is a base column."""
        key = (name, self._plain)
        if key not in self._named:
            value = self._define(name)
            if name in self._held and (self._plain or not self._trees):
                value = (1.0, self.node("held", name, self.plain(value)))
            self._named[key] = value
        return self._named[key]

    def in_si(self, tree: Tree) -> Value:
        """Value of an expression whose names stand for their SI quantities, whatever the scheme."""
        before, self._plain = self._plain, True
        value = self.value(tree)
        self._plain = before
        return value

    def times(self, a: Value, b: Value) -> Value:
        """Product of two values."""
        factor = a[0] * b[0]
        if not math.isfinite(factor) or (factor == 0.0 and a[0] and b[0]):  # beyond the floats: left to the arithmetic
            return 1.0, self._product([(self.plain(a), 1), (self.plain(b), 1)])
        return factor, self._product([(a[1], 1), (b[1], 1)])

    def over(self, a: Value, b: Value) -> Value:
        """Quotient of two values; a division by the number 0 stays one, and gives inf or NaN."""
        factor = a[0] / b[0] if b[0] else math.inf
        if not math.isfinite(factor) or (factor == 0.0 and a[0]):
            return 1.0, self._quotient(self.plain(a), self.plain(b))
        return factor, self._quotient(a[1], b[1])

    def sum(self, parts: Iterable[Value]) -> Value:
        """Sum of values."""
        gathered: Combination = {}
        for factor, node in parts:
            gathered[node] = gathered.get(node, 0.0) + factor
        if len(gathered) == 1:
            ((node, factor),) = gathered.items()
            return factor, node
        return 1.0, self.node("sum", tuple(gathered.items()))

    def plain(self, value: Value) -> int:
        """Node whose value is the whole value, its factor included."""
        factor, node = value
        if node == ONE:
            return ONE if factor == 1.0 else self.node("constant", factor)
        return node if factor == 1.0 else self.node("sum", ((node, factor),))

    def function(self, name: str, value: Value) -> Value:
        """|a|, sin a, cos a, a^0.5 ("sqrt") of a value."""
        if name == "abs":
            return abs(value[0]), ONE if value[1] == ONE else self.node("abs", value[1])
        return 1.0, self.node(name, self.plain(value))

    def _power(self, base: Value, exponent: Tree) -> Value:
        if exponent[0] == "number":
            n = exponent[1]
            if n == 0.0:
                return 1.0, ONE
            if n == 0.5:
                return self.function("sqrt", base)
            if n == int(n) and abs(n) <= _MAX_WHOLE_POWER:
                whole = self._whole_power(base, abs(int(n)))
                return whole if n > 0 else self.over((1.0, ONE), whole)
        return 1.0, self.node("power", self.plain(base), self.plain(self.value(exponent)))

    def _whole_power(self, base: Value, n: int) -> Value:
        try:
            factor = base[0] ** n
        except OverflowError:
            factor = math.inf
        if not math.isfinite(factor) or (factor == 0.0 and base[0]):
            return 1.0, self._product([(self.plain(base), n)])
        return factor, self._product([(base[1], n)])

    def _product(self, factors: Iterable[tuple[int, int]]) -> int:
        factors = list(factors)
        powers: dict[int, int] = {}
        for node, n in factors:
            inner = self.nodes[node][1] if self.nodes[node][0] == "product" else ((node, 1),)
            for part, m in inner:
                if part != ONE:
                    powers[part] = powers.get(part, 0) + n * m
        if sum(powers.values()) > _MAX_FACTORS:  # powers of powers stay what they are: as lists of factors they explode
            powers = {}
            for node, n in factors:
                if node != ONE:
                    powers[node] = powers.get(node, 0) + n
        if not powers:
            return ONE
        if len(powers) == 1 and next(iter(powers.values())) == 1:
            return next(iter(powers))
        return self.node("product", tuple(sorted(powers.items())))

    def _quotient(self, a: int, b: int) -> int:
        return a if b == ONE else self.node("quotient", a, b)

    def _define(self, name: str) -> Value:
        function, inner = split_function(name)
        if function:
            return self.function(function, self.variable(inner))
        if name in self._trees and not self._plain:
            return self.in_si(self._trees[name])
        if name in SYNONYMS:
            return self.value(SYNONYMS[name])
        if name in ("roll", "pitch", "yaw"):
            return 1.0, self.node("wrap", self.node("input", name))
        if name in ADVANCE_RATIOS:
            average = self.variable("w_avg_flown")
            return self.over(self.variable(ADVANCE_RATIOS[name]), (average[0] * self._airframe.radius, average[1]))
        if name in FLOWN_SPEEDS:
            return self._at_least(self.variable(FLOWN_SPEEDS[name]), self._lowest[FLOWN_SPEEDS[name]])
        if name in ("d_w1", "d_w2", "d_w3", "d_w4", "d_w_tot"):
            if self._hover is None:
                raise ExpressionError(
                    f"variable '{name}' needs the hover speed, which is unknown; give a flight that hovers"
                )
            rotors = 4.0 if name == "d_w_tot" else 1.0
            return self.sum([self.variable(name[2:]), (-rotors * self._hover, ONE)])
        if name == "w_avg":
            return self.function("sqrt", self._rotors(2, (0.25,) * 4))
        frame = self._airframe
        signs = {"w_tot": (1.0,) * 4, "u_p": frame.left, "u_q": frame.front, "u_r": frame.spin}
        if name in signs:
            return self._rotors(1, signs[name])
        if name in ("U_p", "U_q", "U_r"):
            return self._rotors(2, signs[name.lower()])
        if name.endswith("_dot") and name.removesuffix("_dot") in signs:
            return self._rotors(1, signs[name.removesuffix("_dot")], "_dot")
        return 1.0, self.node("input", name)

    def _rotors(self, power: int, weights: Iterable[float], suffix: str = "") -> Value:
        speeds = [self.variable(f"w{i}{suffix}")[1] for i in range(1, 5)]
        return self.sum([(float(s), self._product([(n, power)])) for s, n in zip(weights, speeds)])

    def _at_least(self, value: Value, limit: float) -> Value:
        # the larger of two numbers, without an operation of its own: (a + l + |a - l|)/2
        beyond = self.function("abs", self.sum([value, (-limit, ONE)]))
        return self.sum([(0.5 * value[0], value[1]), (0.5 * limit, ONE), (0.5 * beyond[0], beyond[1])])

    # ---- derivatives ----

    def independent(self, name: str) -> int:
        """Node with respect to which one differentiates: a base column, or a variable that is held."""
        node = self.in_si(("name", name))[1]
        return self.nodes[node][1] if self.nodes[node][0] == "wrap" else node

    def derivative(self, node: int, wrt: int) -> Combination:
        """Exact derivative of a node with respect to an input or a held variable, as a sum of nodes.

        |a| has the derivative sign(a), 0 at 0, and so has the root of a sum of squares (w_avg, the airspeed). What else
        has none (another root at 0) gives inf or NaN where it is evaluated.
        """
        if node == wrt:
            return {ONE: 1.0}
        key = (node, wrt)
        if key not in self._derivatives:
            self._derivatives[key] = {n: f for n, f in self._differentiate(node, wrt).items() if f != 0.0}
        return self._derivatives[key]

    def _differentiate(self, node: int, wrt: int) -> Combination:
        kind, *given = self.nodes[node]
        result: Combination = {}

        def add(inner: Combination, factor: float, *others: tuple[int, int], over: int = ONE) -> None:
            for n, f in inner.items():
                made = self._quotient(self._product([*others, (n, 1)]), over)
                result[made] = result.get(made, 0.0) + factor * f

        if kind == "sum":
            for part, factor in given[0]:
                add(self.derivative(part, wrt), factor)
        elif kind == "product":
            for k, (part, n) in enumerate(given[0]):
                rest = [p for j, p in enumerate(given[0]) if j != k] + ([(part, n - 1)] if n > 1 else [])
                add(self.derivative(part, wrt), float(n), *rest)
        elif kind == "quotient":
            a, b = given
            add(self.derivative(a, wrt), 1.0, over=b)
            add(self.derivative(b, wrt), -1.0, (a, 1), over=self._product([(b, 2)]))
        elif kind == "power":
            a, b = given
            slope_a, slope_b = self.derivative(a, wrt), self.derivative(b, wrt)
            if slope_a:
                lower = self.node("power", a, self.plain(self.sum([(1.0, b), (-1.0, ONE)])))
                add(slope_a, 1.0, (b, 1), (lower, 1))
            if slope_b:
                add(slope_b, 1.0, (node, 1), (self.node("log", a), 1))
        elif kind == "abs":
            add(self.derivative(given[0], wrt), 1.0, (self.node("sign", given[0]), 1))
        elif kind == "sqrt" and self._sums_squares(given[0]):
            # x s/(root + 1 - s) with s = sign(root): the quotient itself, and 0 where the root is 0
            sign = self.node("sign", node)
            below = self.node("sum", ((node, 1.0), (ONE, 1.0), (sign, -1.0)))
            add(self.derivative(given[0], wrt), 0.5, (sign, 1), over=below)
        elif kind == "sqrt":
            add(self.derivative(given[0], wrt), 0.5, over=node)
        elif kind == "sin":
            add(self.derivative(given[0], wrt), 1.0, (self.node("cos", given[0]), 1))
        elif kind == "cos":
            add(self.derivative(given[0], wrt), -1.0, (self.node("sin", given[0]), 1))
        elif kind == "log":
            add(self.derivative(given[0], wrt), 1.0, over=given[0])
        elif kind == "wrap":
            add(self.derivative(given[0], wrt), 1.0)
        return result

    def _sums_squares(self, node: int) -> bool:
        kind, *given = self.nodes[node]
        parts = given[0] if kind == "sum" else ((node, 1.0),)
        products = [(self.nodes[part], factor) for part, factor in parts]
        return all(f > 0.0 and p[0] == "product" and all(n % 2 == 0 for _, n in p[1]) for p, f in products)

    def combine(self, terms: Iterable[tuple[float, Value]], wrt: int | None = None) -> Combination:
        """Sum of coefficient x value, or its derivative, as a sum of nodes."""
        result: Combination = {}
        for coefficient, (factor, node) in terms:
            parts = {node: 1.0} if wrt is None else self.derivative(node, wrt)
            for n, f in parts.items():
                result[n] = result.get(n, 0.0) + coefficient * factor * f
        return result

    def inputs(self, outputs: Iterable[Mapping[int, float]]) -> list[str]:
        """Base columns that some combinations need, in order of first use."""
        return [self.nodes[n][1] for n in self.reachable(outputs) if self.nodes[n][0] == "input"]

    def reachable(self, outputs: Iterable[Mapping[int, float]]) -> list[int]:
        """Nodes that some combinations need, each before those that it is part of."""
        seen: dict[int, None] = {}

        def visit(node: int) -> None:
            if node in seen:
                return
            for child in self.children(node):
                visit(child)
            seen[node] = None

        for combination in outputs:
            for node in combination:
                visit(node)
        return list(seen)

    def children(self, node: int) -> tuple[int, ...]:
        """Nodes that a node is directly made of."""
        kind, *given = self.nodes[node]
        if kind in ("one", "constant", "input"):
            return ()
        if kind in ("product", "sum"):
            return tuple(part for part, _ in given[0])
        return (given[1],) if kind == "held" else tuple(given)
