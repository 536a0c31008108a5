"""The one expression parser: text of a polynomial specification to a plain tree, and arrays from the tree.

Grammar, loosest first (blanks count nowhere but between two names or numbers):

    expression = product {("+" | "-") product}
    product    = signed {("*" | "/") signed}            left to right: a/b*c is (a/b)*c
    signed     = {"+" | "-"} power                      -a^2 is -(a^2)
    power      = atom ["^" signed]                      right to left: a^b^c is a^(b^c); a^-1 is allowed
    atom       = number | name | "(" expression ")"

Numbers may be written 2, 0.5, .5, 1e-3. Names hold letters, digits and _ | [ ] ("|u|", "sin[roll]", "w2_1").
Nothing can be called. A tree is made of plain tuples:

    ("number", 2.0)   ("name", "u")   ("negative", a)   ("power", a, b)
    ("sum", ((1, a), (-1, b), ...))          signs
    ("product", ((1, a), (-1, b), ...))      1 multiplies, -1 divides, from left to right
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache

import numpy as np

from quasi.errors import ExpressionError, nearest
from quasi.input_limits import MAX_EXPANDED_TERMS, MAX_EXPRESSION_CHARACTERS

Tree = tuple
MAX_EXPANDED_POWER = 12  # power up to which a sum is multiplied out
MAX_DEPTH = 60  # brackets within brackets; far beyond any regressor, far below Python's own limit

_TOKEN = re.compile(r"\s*(?:((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|([A-Za-z_|][A-Za-z0-9_|\[\]]*)|(\*\*|.))", re.S)


class _Reader:
    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens: list[tuple[str, str, int]] = []  # kind, text, position counted from 1
        at = 0
        end = len(text.rstrip())
        while at < end:
            match = _TOKEN.match(text, at)
            kind = ("number", "name", "sign")[match.lastindex - 1]
            self.tokens.append((kind, match.group(match.lastindex), match.start(match.lastindex) + 1))
            at = match.end()
        self.tokens.append(("end", "", end + 1))
        self.next = 0

    def fail(self, problem: str, remedy: str, at: int | None = None) -> ExpressionError:
        at = self.tokens[self.next][2] if at is None else at
        shown = self.text if len(self.text) <= 80 else f"{self.text[:77]}..."
        return ExpressionError(f"expression '{shown}', character {at}: {problem}; {remedy}")

    def peek(self, *signs: str) -> bool:
        kind, text, _ = self.tokens[self.next]
        return kind == "sign" and text in signs

    def take(self) -> tuple[str, str, int]:
        self.next += 1
        return self.tokens[self.next - 1]

    def expression(self, depth: int) -> Tree:
        parts = [(1, self.product(depth))]
        while self.peek("+", "-"):
            sign = 1 if self.take()[1] == "+" else -1
            parts.append((sign, self.product(depth)))
        return parts[0][1] if len(parts) == 1 else ("sum", tuple(parts))

    def product(self, depth: int) -> Tree:
        parts = [(1, self.signed(depth))]
        while self.peek("*", "/"):
            sign = 1 if self.take()[1] == "*" else -1
            parts.append((sign, self.signed(depth)))
        return parts[0][1] if len(parts) == 1 else ("product", tuple(parts))

    def signed(self, depth: int) -> Tree:
        negative = False
        while self.peek("+", "-"):
            negative ^= self.take()[1] == "-"
        tree = self.power(depth)
        if not negative:
            return tree
        return ("number", -tree[1]) if tree[0] == "number" else ("negative", tree)

    def power(self, depth: int) -> Tree:
        base = self.atom(depth)
        if self.peek("^"):
            self.take()
            if depth >= MAX_DEPTH:
                raise self.fail(f"powers or brackets are nested deeper than {MAX_DEPTH}", "split the expression")
            return ("power", base, self.signed(depth + 1))
        return base

    def atom(self, depth: int) -> Tree:
        kind, text, at = self.take()
        if kind == "number":
            value = float(text)
            if not math.isfinite(value):
                raise self.fail(f"the number {text} is too large", "write a finite number", at)
            return ("number", value)
        if kind == "name":
            if self.peek("("):
                raise self.fail(
                    f"'{text}' is followed by a bracket, but nothing can be called",
                    "write '*' to multiply, or a variable such as sin[roll]",
                )
            return ("name", text)
        if text == "(":
            if depth >= MAX_DEPTH:
                raise self.fail(f"brackets are nested deeper than {MAX_DEPTH}", "split the expression", at)
            inner = self.expression(depth + 1)
            if not self.peek(")"):
                raise self.fail(self.found("')'"), f"close the bracket of character {at}")
            self.take()
            return inner
        self.next -= 1
        if text == "**":
            raise self.fail("'**' is not an operator", "write '^' for a power")
        raise self.fail(self.found("a number, a name or '('"), "complete or correct it")

    def found(self, wanted: str) -> str:
        kind, text, _ = self.tokens[self.next]
        return f"expected {wanted}, found {'the end' if kind == 'end' else repr(text)}"


@lru_cache(maxsize=65536)
def parse(text: str) -> Tree:
    """Tree of an expression. Raises ExpressionError with the position and a remedy.

    >>> parse("-2*u^2")
    ('product', ((1, ('number', -2.0)), (1, ('power', ('name', 'u'), ('number', 2.0)))))
    """
    if not isinstance(text, str):
        raise ExpressionError(f"an expression must be text, found {text!r}; put it in quotes")
    if len(text) > MAX_EXPRESSION_CHARACTERS:
        raise ExpressionError(
            f"expression '{text[:40]}...' has {len(text):,} characters, expected at most "
            f"{MAX_EXPRESSION_CHARACTERS:,}; split it into several regressors"
        )
    reader = _Reader(text)
    tree = reader.expression(0)
    if reader.tokens[reader.next][0] != "end":
        if reader.peek("**"):
            raise reader.fail("'**' is not an operator", "write '^' for a power")
        raise reader.fail(reader.found("an operator or the end"), "put an operator (+ - * / ^) there, or remove it")
    count_expanded_terms(tree, text)
    return tree


def count_expanded_terms(tree: Tree, shown: str) -> int:
    """Upper limit of the number of terms after expansion, from the tree alone.

    shown   the expression's text, for messages
    Raises  ExpressionError where it exceeds MAX_EXPANDED_TERMS: comparing and differentiating it would take minutes.
    """
    kind = tree[0]
    parts = [count_expanded_terms(part, shown) for part in _children(tree)]
    count = 1
    if kind == "sum":
        count = sum(parts)
    elif kind == "product":
        count = math.prod(n for (sign, _), n in zip(tree[1], parts) if sign > 0)
    elif kind == "negative":
        count = parts[0]
    elif kind == "power" and tree[2][0] == "number" and 0 <= tree[2][1] <= MAX_EXPANDED_POWER:
        count = math.comb(parts[0] + int(tree[2][1]) - 1, int(tree[2][1]))
    if count > MAX_EXPANDED_TERMS:
        raise ExpressionError(
            f"expression '{shown[:40]}{'...' if len(shown) > 40 else ''}' has more than {MAX_EXPANDED_TERMS:,} terms "
            "when its brackets are expanded; split it into several regressors"
        )
    return count


def _children(tree: Tree) -> tuple[Tree, ...]:
    kind = tree[0]
    if kind in ("sum", "product"):
        return tuple(part for _, part in tree[1])
    if kind in ("negative", "power"):
        return tree[1:]
    return ()


def names(tree: Tree) -> tuple[str, ...]:
    """Names that a tree uses, each once, in order of appearance."""
    found: dict[str, None] = {}

    def visit(node: Tree) -> None:
        if node[0] == "name":
            found[node[1]] = None
        for child in _children(node):
            visit(child)

    visit(tree)
    return tuple(found)


def _number(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(float(value))


def text(tree: Tree) -> str:
    """Canonical text: no blanks but around + and -, brackets only where needed. `parse` gives the tree back."""
    return _text(tree)[0]


def _text(tree: Tree) -> tuple[str, int]:
    # second value: how tightly the outermost operator binds; 0 sum, 1 product, 2 sign, 3 power, 4 atom
    kind = tree[0]

    def within(node: Tree, least: int) -> str:
        shown, binds = _text(node)
        return shown if binds >= least else f"({shown})"

    if kind == "number":
        return (_number(tree[1]), 4) if math.copysign(1.0, tree[1]) > 0 else (f"-{_number(-tree[1])}", 2)
    if kind == "name":
        return tree[1], 4
    if kind == "negative":
        # a bare number after the sign would be read as a negative number, which is another tree of the same value
        return f"-{within(tree[1], 3) if tree[1][0] != 'number' else f'({_text(tree[1])[0]})'}", 2
    if kind == "power":
        return f"{within(tree[1], 4)}^{within(tree[2], 3)}", 3
    least, symbols = (1, (" + ", " - ")) if kind == "sum" else (2, ("*", "/"))
    shown = within(tree[1][0][1], least)
    for sign, part in tree[1][1:]:
        shown += symbols[0 if sign > 0 else 1] + within(part, least if part[0] != kind else least + 1)
    return shown, 0 if kind == "sum" else 1


class Program:
    """Several expressions as one list of array operations in which equal parts are computed once.

    trees   the expressions; after construction
    names   the names they need, in order of first use
    size    number of expressions
    """

    def __init__(self, trees: Iterable[Tree]) -> None:
        trees = list(trees)
        self.size = len(trees)
        self._steps: list[tuple] = []  # (operation, slot or value, slot or value)
        self._known: dict[tuple, int] = {}
        self.results = [self._add(tree) for tree in trees]
        self.names = tuple(step[1] for step in self._steps if step[0] == "name")

    def _step(self, *step) -> int:
        if step not in self._known:
            self._known[step] = len(self._steps)
            self._steps.append(step)
        return self._known[step]

    def _whole_power(self, slot: int, exponent: int) -> int:
        # u^3 = (u*u)*u: products are many times faster than pow and share the lower powers
        if exponent == 1:
            return slot
        return self._step("*", self._whole_power(slot, exponent - 1), slot)

    def _add(self, tree: Tree) -> int:
        kind = tree[0]
        if kind in ("number", "name"):
            return self._step(kind, tree[1])
        if kind == "negative":
            return self._step("negative", self._add(tree[1]))
        if kind == "power":
            base, exponent = self._add(tree[1]), tree[2]
            if exponent[0] == "number" and exponent[1] == int(exponent[1]) and 1 <= abs(exponent[1]) <= 32:
                whole = self._whole_power(base, abs(int(exponent[1])))
                return whole if exponent[1] > 0 else self._step("/", self._step("number", 1.0), whole)
            if exponent == ("number", 0.5):
                return self._step("root", base)
            return self._step("^", base, self._add(exponent))
        symbols = ("+", "-") if kind == "sum" else ("*", "/")
        slot = self._add(tree[1][0][1])
        for sign, part in tree[1][1:]:
            slot = self._step(symbols[0 if sign > 0 else 1], slot, self._add(part))
        return slot

    def run(
        self, lookup: Mapping[str, np.ndarray] | Callable[[str], np.ndarray], rows: int, out: np.ndarray | None = None
    ):
        """Evaluate on `rows` rows. Returns (size, rows), in `out` when given. Divisions by zero give inf or NaN."""
        get = lookup if callable(lookup) else lookup.__getitem__
        out = np.empty((self.size, rows)) if out is None else out
        place: dict[int, int] = {}
        for row, slot in enumerate(self.results):
            place.setdefault(slot, row)
        values: list = [None] * len(self._steps)
        with np.errstate(all="ignore"):
            for slot, (operation, *given) in enumerate(self._steps):
                if operation == "number":
                    values[slot] = given[0]
                elif operation == "name":
                    values[slot] = get(given[0])
                else:
                    arguments = [values[i] for i in given]
                    target = out[place[slot]] if slot in place else None
                    values[slot] = _UFUNCS[operation](*arguments, out=target)
        for row, slot in enumerate(self.results):
            if place[slot] != row or self._steps[slot][0] in ("number", "name"):
                out[row] = values[slot]
        return out


_UFUNCS = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "^": np.float_power,
    "negative": np.negative,
    "root": np.sqrt,
}


def evaluate(tree: Tree, lookup: Mapping[str, np.ndarray] | Callable[[str], np.ndarray]) -> np.ndarray:
    """Value of a tree for the arrays that `lookup` gives for its names (a scalar array when it uses none).

    Divisions by zero and powers without a real value give inf or NaN in their rows; the caller decides about them.
    Raises ExpressionError for a name that a mapping lacks, with the nearest that it holds.
    """
    if not callable(lookup):
        lookup = require_columns(lookup)
    given = {name: np.asarray(lookup(name), float) for name in names(tree)}
    shape = np.broadcast_shapes(*(a.shape for a in given.values()))
    rows = int(np.prod(shape)) if shape else 1
    flat = {name: np.broadcast_to(a, shape).reshape(-1) for name, a in given.items()}
    return Program([tree]).run(flat, rows)[0].reshape(shape)


def require_columns(columns: Mapping[str, np.ndarray]) -> Callable[[str], np.ndarray]:
    """A lookup on a mapping that raises ExpressionError with the nearest known name."""

    def get(name: str) -> np.ndarray:
        try:
            return columns[name]
        except KeyError:
            raise ExpressionError(f"unknown variable '{name}'{nearest(name, columns)}") from None

    return get
