"""Compiled evaluation of a model: flat arrays and one small machine that runs them, per row or for many rows.

    kernel = model.kernel                                   arrays only: an argument of any @njit function
    work, out = kernel.work, np.empty(6)
    wrench(kernel, inputs, work, out)                       one row, no allocation; out = Fx Fy Fz (N), Mx My Mz (N m)

inputs (20 + E,), the order of INPUTS and then the model's extra columns, `model.inputs[20:]`, such as battery_voltage:

    0-2 roll pitch yaw, rad       3-5 u v w, m/s through the air     6-8 p q r, rad/s       9-11 x y z, m
    12-15 w1..w4, rad/s           16-19 w1_dot..w4_dot, rad/s2       20.. extra columns

kernel.used (20 + E,) tells which of them are read, so that a caller may leave the others unset (and, for instance, form
no Euler angles when `kernel.used[:3]` is all false). An axis that the model lacks gives NaN. Nothing is allocated, so
`work` may serve all calls of one thread.

The graph's nodes become two-operand instructions sorted into runs of one operation each, so that the machine decides
once per run and not once per instruction; every instruction writes the slot after the one before. Products share the
pairs of factors that most products hold. No code is generated, and nothing from a file is run.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numba as nb
import numpy as np

from quasi.standalone.graph import ONE, Graph

INPUTS = (
    "roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z",
    "w1", "w2", "w3", "w4", "w1_dot", "w2_dot", "w3_dot", "w4_dot",
)  # fmt: skip
MULTIPLY, ADD, SUBTRACT, DIVIDE, ABS, SQRT, SIN, COS, POWER, LOG, SIGN, WRAP = range(12)
_OF_KIND = {"abs": ABS, "sqrt": SQRT, "sin": SIN, "cos": COS, "log": LOG, "sign": SIGN, "wrap": WRAP}
_HEAD = 7  # sizes at the beginning of the code

_BLOCK = 128  # rows that are worked at a time: their slots stay in the nearest cache


class Kernel(NamedTuple):
    """A model as two flat arrays (an argument of many arrays would cost each call more than its work).

    code     the sizes G, C, R, I, M, T and the number of inputs; then, one after another,
             gather (G,) positions of the inputs that slots 0..G-1 take
             runs (R, 3) operation, first and last-plus-one instruction
             left (I,) and right (I,) slots of the operands; instruction k writes slot G + C + k
             ends (M + 1,) where the terms of each output begin; terms (T,) their slots
    numbers  constants (C,), which slots G..G+C-1 take; weights (T,) of the terms; offsets (M,) of the outputs
    """

    code: np.ndarray
    numbers: np.ndarray

    @property
    def gather(self) -> np.ndarray:
        """(G,) positions of the inputs that are read."""
        return self.code[_HEAD : _HEAD + self.code[0]]

    @property
    def used(self) -> np.ndarray:
        """(20 + E,) bool, which inputs are read."""
        used = np.zeros(self.code[6], bool)
        used[self.gather] = True
        return used

    @property
    def work(self) -> np.ndarray:
        """(S,) zeros: a new scratch array."""
        return np.zeros(int(self.code[0]) + int(self.code[1]) + int(self.code[3]))

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return int(self.code[4])

    def depends(self, outputs: Iterable[int]) -> bool:
        """Whether one of these outputs is anything but the number 0."""
        at = _HEAD + int(self.code[0]) + 3 * int(self.code[2]) + 2 * int(self.code[3])
        ends = self.code[at : at + self.outputs + 1]
        offsets = self.numbers[len(self.numbers) - self.outputs :]
        return any(ends[m + 1] > ends[m] or offsets[m] != 0.0 for m in outputs)


@nb.njit(cache=True, error_model="numpy")
def wrench(kernel: Kernel, inputs: np.ndarray, work: np.ndarray, out: np.ndarray) -> None:
    """Evaluate one row: `out` (M,) from `inputs` (20 + E,); `work` (S,) is scratch. See the head of the module."""
    code, numbers = kernel.code, kernel.numbers
    gathered, constants = int(code[0]), int(code[1])
    at = _HEAD + gathered
    runs, at = code[at : at + 3 * code[2]], at + 3 * code[2]
    left, at = code[at : at + code[3]], at + code[3]
    right, at = code[at : at + code[3]], at + code[3]
    ends, terms = code[at : at + code[4] + 1], code[at + code[4] + 1 :]
    weights, offsets = numbers[constants:], numbers[constants + code[5] :]
    for k in range(gathered):
        work[k] = inputs[code[_HEAD + k]]
    for k in range(constants):
        work[gathered + k] = numbers[k]
    base = gathered + constants
    for run in range(0, len(runs), 3):
        operation, start, stop = runs[run], runs[run + 1], runs[run + 2]
        if operation == MULTIPLY:
            for k in range(start, stop):
                work[base + k] = work[left[k]] * work[right[k]]
        elif operation == ADD:
            for k in range(start, stop):
                work[base + k] = work[left[k]] + work[right[k]]
        elif operation == SUBTRACT:
            for k in range(start, stop):
                work[base + k] = work[left[k]] - work[right[k]]
        elif operation == DIVIDE:
            for k in range(start, stop):
                work[base + k] = work[left[k]] / work[right[k]]
        elif operation == ABS:
            for k in range(start, stop):
                work[base + k] = abs(work[left[k]])
        else:
            for k in range(start, stop):
                work[base + k] = _seldom(operation, work[left[k]], work[right[k]])
    for m in range(len(ends) - 1):
        total = offsets[m]
        for k in range(ends[m], ends[m + 1]):
            total += weights[k] * work[terms[k]]
        out[m] = total


@nb.njit(cache=True, error_model="numpy", inline="never")
def _seldom(operation: int, a: float, b: float) -> float:
    if operation == SQRT:
        return np.sqrt(a)
    if operation == SIN:
        return np.sin(a)
    if operation == COS:
        return np.cos(a)
    if operation == POWER:
        return np.power(a, b)
    if operation == LOG:
        return np.log(a)
    if operation == SIGN:
        return np.sign(a)
    return a - 2.0 * np.pi * np.rint(a / (2.0 * np.pi))  # WRAP


@nb.njit(cache=True, error_model="numpy")
def wrench_rows(kernel: Kernel, columns: np.ndarray, out: np.ndarray) -> None:
    """Evaluate many rows: columns (G, N), the used inputs in the order of `kernel.gather`; out (M, N)."""
    code, numbers = kernel.code, kernel.numbers
    gathered, constants = int(code[0]), int(code[1])
    at = _HEAD + gathered
    runs, at = code[at : at + 3 * code[2]], at + 3 * code[2]
    left, at = code[at : at + code[3]], at + code[3]
    right, at = code[at : at + code[3]], at + code[3]
    ends, terms = code[at : at + code[4] + 1], code[at + code[4] + 1 :]
    weights, offsets = numbers[constants:], numbers[constants + code[5] :]
    base = gathered + constants
    work = np.empty((base + len(left), _BLOCK))
    for k in range(constants):
        work[gathered + k] = numbers[k]
    rows = out.shape[1]
    for first in range(0, rows, _BLOCK):
        n = min(_BLOCK, rows - first)
        for k in range(gathered):
            work[k, :n] = columns[k, first : first + n]
        for run in range(0, len(runs), 3):
            operation = runs[run]
            for k in range(runs[run + 1], runs[run + 2]):
                a, b, to = work[left[k]], work[right[k]], work[base + k]
                if operation == MULTIPLY:
                    for i in range(n):
                        to[i] = a[i] * b[i]
                elif operation == ADD:
                    for i in range(n):
                        to[i] = a[i] + b[i]
                elif operation == SUBTRACT:
                    for i in range(n):
                        to[i] = a[i] - b[i]
                elif operation == DIVIDE:
                    for i in range(n):
                        to[i] = a[i] / b[i]
                else:
                    for i in range(n):
                        to[i] = abs(a[i]) if operation == ABS else _seldom(operation, a[i], b[i])
        for m in range(len(ends) - 1):
            total = out[m, first : first + n]
            total[:] = offsets[m]
            for k in range(ends[m], ends[m + 1]):
                term, weight = work[terms[k]], weights[k]
                for i in range(n):
                    total[i] += weight * term[i]


def compile_outputs(
    graph: Graph, outputs: Sequence[Mapping[int, float]], inputs: Sequence[str], lacking: Iterable[int] = ()
) -> Kernel:
    """Kernel of some combinations of a graph's nodes.

    outputs  {node: factor} each; inputs  names of the columns, the first 20 being INPUTS
    lacking  outputs that are NaN
    """
    code = _Code(graph, outputs)
    gather = [inputs.index(name) for name in code.inputs]
    constants, runs, left, right = code.arranged()
    ends, terms, weights, offsets = [0], [], [], []
    for combination in outputs:
        for node, factor in combination.items():
            if node != ONE:
                terms.append(code.slot(node))
                weights.append(factor)
        ends.append(len(terms))
        offsets.append(combination.get(ONE, 0.0))
    for m in lacking:
        offsets[m] = np.nan
    head = [len(gather), len(constants), len(runs), len(left), len(outputs), len(terms), len(inputs)]
    flat = [*head, *gather, *(n for run in runs for n in run), *left, *right, *ends, *terms]
    # unsigned: no test for negative indices in the inner loops
    return Kernel(np.array(flat, np.uint32), np.array([*constants, *weights, *offsets], float))


class _Code:
    """Two-operand instructions of the nodes that some outputs need."""

    def __init__(self, graph: Graph, outputs: Sequence[Mapping[int, float]]) -> None:
        self._graph = graph
        self.inputs: list[str] = []
        self._constants: dict[float, tuple] = {}
        self._instructions: dict[tuple, None] = {}  # (operation, operand, operand), operands being such keys themselves
        self._of_node: dict[int, tuple] = {}
        needed = graph.reachable(outputs)
        pairs = _shared_products(graph, needed)
        for node in needed:
            self._of_node[node] = self._lower(node, pairs)
        self._place: dict[tuple, int] = {}

    def slot(self, node: int) -> int:
        return self._place[self._of_node[node]]

    def _constant(self, value: float) -> tuple:
        return self._constants.setdefault(value, ("constant", value))

    def _do(self, operation: int, a: tuple, b: tuple | None = None) -> tuple:
        key = (operation, a, b if b is not None else a)
        self._instructions.setdefault(key)
        return key

    def _lower(self, node: int, pairs: Mapping[int, tuple]) -> tuple:
        kind, *given = self._graph.nodes[node]
        of = self._of_node
        if kind == "input":
            self.inputs.append(given[0])
            return ("input", given[0])
        if kind in ("one", "constant"):
            return self._constant(given[0] if given else 1.0)
        if kind == "held":
            return of[given[1]]
        if kind == "quotient":
            return self._do(DIVIDE, of[given[0]], of[given[1]])
        if kind == "power":
            return self._do(POWER, of[given[0]], of[given[1]])
        if kind == "product":
            return self._multiply(pairs[node])
        if kind == "sum":
            return self._sum(given[0])
        return self._do(_OF_KIND[kind], of[given[0]])

    def _multiply(self, pair: tuple | int) -> tuple:
        if isinstance(pair, int):
            return self._of_node[pair]
        return self._do(MULTIPLY, self._multiply(pair[0]), self._multiply(pair[1]))

    def _sum(self, parts: Iterable[tuple[int, float]]) -> tuple:
        total = None
        for node, factor in sorted(
            parts, key=lambda part: part[1] != 1.0
        ):  # begins with a factor of 1, if there is one
            if node == ONE:
                term, negative = self._constant(factor), False
            else:
                negative = factor < 0 and total is not None
                size = -factor if negative else factor
                term = self._of_node[node]
                if size != 1.0:
                    term = self._do(MULTIPLY, self._constant(size), term)
            total = term if total is None else self._do(SUBTRACT if negative else ADD, total, term)
        return total

    def arranged(self) -> tuple[list[float], list[tuple[int, int, int]], list[int], list[int]]:
        """Constants, runs, and operands' slots; gives every input, constant and instruction its slot."""
        for name in self.inputs:
            self._place[("input", name)] = len(self._place)
        for key in self._constants.values():
            self._place[key] = len(self._place)
        waiting = list(self._instructions)
        runs, left, right = [], [], []
        while waiting:
            # the operation of which most can be done in a row; within a run one may build on another
            best: list[tuple] = []
            for operation in sorted({key[0] for key in waiting}):
                done: dict[tuple, None] = {}
                for key in waiting:
                    ready = all(a in self._place or a in done for a in key[1:])
                    if key[0] == operation and ready:
                        done[key] = None
                if len(done) > len(best):
                    best = list(done)
            runs.append((best[0][0], len(left), len(left) + len(best)))
            for key in best:
                self._place[key] = len(self._place)
                left.append(self._place[key[1]])
                right.append(self._place[key[2]])
            taken = set(best)
            waiting = [key for key in waiting if key not in taken]
        return list(self._constants), runs, left, right


def _shared_products(graph: Graph, nodes: Iterable[int]) -> dict[int, tuple]:
    """{product node: nested pairs of nodes}: again and again the pair of factors that most products hold is formed."""
    rows: dict[int, list] = {}
    for node in nodes:
        kind, *given = graph.nodes[node]
        if kind == "product":
            rows[node] = [part for part, n in given[0] for _ in range(n)]
    order: dict = {}  # factors get numbers in order of first appearance, so that the outcome does not vary

    def number(factor) -> int:
        return order.setdefault(factor, len(order))

    def pairs_of(row: list) -> set[tuple]:
        count = Counter(row)
        factors = sorted(count, key=number)
        found = {(a, b) for i, a in enumerate(factors) for b in factors[i + 1 :]}
        return found | {(a, a) for a in factors if count[a] > 1}

    holders: dict[tuple, set[int]] = {}
    for node, row in rows.items():
        for pair in pairs_of(row):
            holders.setdefault(pair, set()).add(node)
    while holders:
        pair = max(holders, key=lambda p: (len(holders[p]), -number(p[0]), -number(p[1])))
        for node in sorted(holders[pair]):
            for old in pairs_of(rows[node]):
                holders[old].discard(node)
                if not holders[old] and old != pair:
                    del holders[old]
            row = rows[node]
            while row.count(pair[0]) >= 1 + (pair[0] == pair[1]) and pair[1] in row:
                row.remove(pair[0])
                row.remove(pair[1])
                row.append(pair)
            for new in pairs_of(row):
                holders.setdefault(new, set()).add(node)
        holders.pop(pair, None)
    return {node: row[0] for node, row in rows.items()}
