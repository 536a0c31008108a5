"""A compiled model as a list of named values, for writing it in another language with the same operations.

A kernel (`quasi.terms.kernel`) is arithmetic in flat arrays. Here it becomes readable again: what is used once
stands inside what uses it, what is used more often gets a name, and variables of the model's own terms (U_p, w_avg)
keep theirs. The order of operations is the kernel's, so that results agree to the last digits.

An expression is a plain tuple:

    ("input", name)   ("number", c)   ("step", name)
    ("*" | "+" | "-" | "/" | "power", a, b)   ("abs" | "sqrt" | "sin" | "cos" | "log" | "sign" | "wrap", a)
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from quasi.model.model import AXES, Model
from quasi.terms import kernel as k
from quasi.terms.differential import list_held_inputs
from quasi.terms.expressions import names
from quasi.terms.graph import Graph, Value
from quasi.terms.kernel import Kernel, compile_outputs
from quasi.terms.variables import plain_name

Expression = tuple
_OF = {
    k.MULTIPLY: "*", k.ADD: "+", k.SUBTRACT: "-", k.DIVIDE: "/", k.POWER: "power", k.ABS: "abs", k.SQRT: "sqrt",
    k.SIN: "sin", k.COS: "cos", k.LOG: "log", k.SIGN: "sign", k.WRAP: "wrap",
}  # fmt: skip
_BINARY = ("*", "+", "-", "/", "power")
_TIGHT = {"+": 1, "-": 1, "*": 2, "/": 2}  # how tightly an operator binds
_INLINE = 70  # characters of an expression that still stands inside another


class Output(NamedTuple):
    """One result: offset + sum of weight x expression."""

    offset: float
    terms: tuple[tuple[float, Expression], ...]


class Listing(NamedTuple):
    """inputs: names of the columns that are read; steps: (name, expression) in order; outputs: the results."""

    inputs: tuple[str, ...]
    steps: tuple[tuple[str, Expression], ...]
    outputs: tuple[Output, ...]

    @property
    def functions(self) -> set[str]:
        """Functions that occur, such as "sin" and "power"."""
        found: set[str] = set()

        def visit(e: Expression) -> None:
            if e[0] in ("input", "number", "step"):
                return
            found.add(e[0])
            for part in e[1:]:
                visit(part)

        for _, expression in self.steps:
            visit(expression)
        for output in self.outputs:
            for _, expression in output.terms:
                visit(expression)
        return found


class Writer(NamedTuple):
    """How a language writes what is not an infix operator.

    number (c) -> text, in brackets where it is negative; call (function, arguments as text) -> text
    given (name of an input) -> its identifier
    """

    number: Callable[[float], str]
    call: Callable[[str, Sequence[str]], str]
    given: Callable[[str], str]

    def text(self, expression: Expression) -> str:
        """An expression as text; brackets keep the order of operations."""
        return self._text(expression)[0]

    def _text(self, e: Expression) -> tuple[str, int]:
        if e[0] == "input":
            return self.given(e[1]), 3
        if e[0] == "step":
            return e[1], 3
        if e[0] == "number":
            return self.number(e[1]), 3
        if e[0] not in _TIGHT:
            return self.call(e[0], [self.text(part) for part in e[1:]]), 3
        tight = _TIGHT[e[0]]
        (left, a), (right, b) = self._text(e[1]), self._text(e[2])
        left = left if a >= tight else f"({left})"
        right = right if b > tight else f"({right})"
        space = " " if tight == 1 else ""
        return f"{left}{space}{e[0]}{space}{right}", tight


_PLAIN = Writer(str, lambda name, parts: f"{name}({', '.join(parts)})", str)


def weighted(writer: Writer, weight: float, expression: Expression) -> str:
    """weight x expression; a weight of 1 is left out, which changes no digit."""
    return writer.text(expression if weight == 1.0 else ("*", ("number", weight), expression))


def listing_of(kernel: Kernel, inputs: Sequence[str], outputs: int, labels: Mapping[int, str] | None = None) -> Listing:
    """The list of a kernel's first `outputs` outputs.

    inputs  names of its columns; labels {slot: name} of values that have one
    """
    labels = labels or {}
    code, numbers = kernel.code.tolist(), kernel.numbers.tolist()
    gathered, constants, runs, count, all_outputs, terms = code[:6]
    at = 7
    gather, at = code[at : at + gathered], at + gathered
    run, at = code[at : at + 3 * runs], at + 3 * runs
    left, at = code[at : at + count], at + count
    right, at = code[at : at + count], at + count
    ends, slots = code[at : at + all_outputs + 1], code[at + all_outputs + 1 :]
    weights, offsets = numbers[constants : constants + terms], numbers[constants + terms :]
    base = gathered + constants
    operation = [0] * count
    for i in range(0, len(run), 3):
        operation[run[i + 1] : run[i + 2]] = [run[i]] * (run[i + 2] - run[i + 1])

    def operands(slot: int) -> list[int]:
        if slot < base:
            return []
        i = slot - base
        return [left[i], right[i]] if _OF[operation[i]] in _BINARY else [left[i]]

    wanted = slots[: ends[outputs]]
    order: dict[int, None] = {}  # slots that are needed, each after its operands
    waiting = list(reversed(wanted))
    while waiting:
        slot = waiting[-1]
        lacking = [s for s in operands(slot) if s not in order]
        if slot in order or not lacking:
            order[slot] = None
            waiting.pop()
        else:
            waiting.extend(reversed(lacking))
    uses = dict.fromkeys(order, 0)
    for used in [*wanted, *(s for slot in order for s in operands(slot))]:
        uses[used] += 1

    taken = {*inputs, *labels.values()}
    steps: list[tuple[str, Expression]] = []
    value: dict[int, Expression] = {}
    number = 0
    for slot in order:
        if slot < gathered:
            value[slot] = ("input", inputs[gather[slot]])
            continue
        if slot < base:
            value[slot] = ("number", numbers[slot - gathered])
            continue
        expression = (_OF[operation[slot - base]], *(value[s] for s in operands(slot)))
        if slot not in labels and uses[slot] == 1 and len(_PLAIN.text(expression)) <= _INLINE:
            value[slot] = expression
            continue
        name = labels.get(slot)
        while name is None or (name in taken and slot not in labels):
            number += 1
            name = f"t{number}"
        steps.append((name, expression))
        value[slot] = ("step", name)
    found = [
        Output(offsets[m], tuple((weights[i], value[slots[i]]) for i in range(ends[m], ends[m + 1])))
        for m in range(outputs)
    ]
    read = [inputs[g] for s, g in enumerate(gather) if s in order]
    return Listing(tuple(sorted(read, key=inputs.index)), tuple(steps), tuple(found))


def of_model(model: Model) -> Listing:
    """Fx .. Mz of a model; an axis that it lacks is NaN."""
    graph, terms = model.graph()
    lacking = [m for m, axis in enumerate(AXES) if axis not in model.axes]
    return _labelled(model, graph, [graph.combine(axis) for axis in terms], lacking)


def of_derivatives(model: Model, by: Sequence[str]) -> Listing:
    """Derivatives of Mx, My, Mz by some variables: outputs (3, len(by)), axis after axis; see `derivative_kernel`."""
    graph, terms = model.graph(list_held_inputs(by))
    wrt = [graph.independent(name) for name in by]
    return _labelled(model, graph, [graph.combine(axis, node) for axis in terms[3:] for node in wrt], [])


def of_region(model: Model) -> Listing:
    """What the covered region of a model compares with its limits, see `quasi.model.envelope`."""
    kernel = model.region.kernel
    return listing_of(kernel, model.inputs, kernel.outputs)


def _labelled(model: Model, graph: Graph, outputs: list[Mapping[int, float]], lacking: Iterable[int]) -> Listing:
    """The list of some outputs in which the variables of the model's terms keep their names."""
    nodes: dict[str, int] = {}
    if not model.normalisation:  # there, names stand for other quantities than what they say
        reachable = set(graph.reachable(outputs))
        trees = [t for axis in model.axes for t in model.trees[axis]]
        for name in dict.fromkeys(plain_name(n) for tree in trees for n in names(tree)):
            value: Value = graph.variable(name)
            kind = graph.nodes[value[1]][0]
            legal = name.isidentifier() and name not in model.inputs
            if legal and value[0] == 1.0 and kind not in ("input", "one") and value[1] in reachable:
                nodes[name] = value[1]
    asked = [*outputs, *({node: 1.0} for node in nodes.values())]
    kernel = compile_outputs(graph, asked, model.inputs, lacking)
    slots = _slots(kernel)
    labels = {slots[len(outputs) + i]: name for i, name in enumerate(nodes)}
    return listing_of(kernel, model.inputs, len(outputs), labels)


def _slots(kernel: Kernel) -> dict[int, int]:
    """{output: slot of its first term}."""
    code = kernel.code.tolist()
    at = 7 + code[0] + 3 * code[2] + 2 * code[3]
    ends, terms = code[at : at + code[4] + 1], code[at + code[4] + 1 :]
    return {m: terms[ends[m]] for m in range(code[4]) if ends[m + 1] > ends[m]}
