"""Compiled evaluation of a model: flat arrays and one small machine that runs them, per row or for many rows.

    kernel = model.kernel                                   arrays only: an argument of any @njit function
    work, out = kernel.work, np.empty(6)
    compute_wrench(kernel, inputs, work, out)                       one row, no allocation; out = Fx Fy Fz (N), Mx My Mz
    (N m)

inputs (20 + E,), the order of INPUTS and then the model's extra columns, `model.inputs[20:]`, such as battery_voltage:

    0-2 roll pitch yaw, rad       3-5 u v w, m/s through the air     6-8 p q r, rad/s       9-11 x y z, m
    12-15 w1..w4, rad/s           16-19 w1_dot..w4_dot, rad/s2       20.. extra columns

kernel.used (20 + E,) marks the inputs that are read, so that a caller may leave the others unset (and, for instance,
form no Euler angles when `kernel.used[:3]` is all false). An axis that the model lacks gives NaN. Nothing is allocated,
so `work` may serve all calls of one thread.

The graph's nodes become two-operand instructions sorted into runs of one operation each, so that the machine decides
once per run and not once per instruction; every instruction writes the slot after the one before. Products share the
pairs of factors that most products hold. No code is generated, and nothing from a file is run.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import numba as nb
import numpy as np

from quasi.terms.graph import ONE, Graph
from quasi.terms.lanes import choose

INPUTS = (
    "roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z",
    "w1", "w2", "w3", "w4", "w1_dot", "w2_dot", "w3_dot", "w4_dot",
)  # fmt: skip
MULTIPLY, ADD, SUBTRACT, DIVIDE, ABS, SQRT, SIN, COS, POWER, LOG, SIGN, WRAP = range(12)
_OPERATION_OF_NODE = {"abs": ABS, "sqrt": SQRT, "sin": SIN, "cos": COS, "log": LOG, "sign": SIGN, "wrap": WRAP}
_HEADER_SIZE = 7  # sizes at the beginning of the code

_BLOCK_ROWS = 128  # rows that are worked at a time: their slots stay in the nearest cache


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
        return self.code[_HEADER_SIZE : _HEADER_SIZE + self.code[0]]

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
        at = _HEADER_SIZE + int(self.code[0]) + 3 * int(self.code[2]) + 2 * int(self.code[3])
        ends = self.code[at : at + self.outputs + 1]
        offsets = self.numbers[len(self.numbers) - self.outputs :]
        return any(ends[m + 1] > ends[m] or offsets[m] != 0.0 for m in outputs)


@nb.njit(cache=True, error_model="numpy")
def compute_wrench(kernel: Kernel, inputs: np.ndarray, work: np.ndarray, out: np.ndarray) -> None:
    """Evaluate one row: `out` (M,) from `inputs` (20 + E,); `work` (S,) is scratch. See the head of the module.

    Arrays, or views of `quasi.terms.lanes` for eight rows.
    """
    code, numbers = kernel.code, kernel.numbers
    gathered, constants = int(code[0]), int(code[1])
    at = _HEADER_SIZE + gathered
    runs, at = code[at : at + 3 * code[2]], at + 3 * code[2]
    left, at = code[at : at + code[3]], at + code[3]
    right, at = code[at : at + code[3]], at + code[3]
    ends, terms = code[at : at + code[4] + 1], code[at + code[4] + 1 :]
    weights, offsets = numbers[constants:], numbers[constants + code[5] :]
    for k in range(gathered):
        work[k] = inputs[code[_HEADER_SIZE + k]]
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
                work[base + k] = _apply_rare_operation(operation, work[left[k]], work[right[k]])
    for m in range(len(ends) - 1):
        total = offsets[m]
        for k in range(ends[m], ends[m + 1]):
            total += weights[k] * work[terms[k]]
        out[m] = total


@nb.njit(cache=True, error_model="numpy", inline="never")
def _apply_rare_operation(operation, a, b):
    if operation == SQRT:
        return math.sqrt(a)
    if operation == SIN:
        return math.sin(a)
    if operation == COS:
        return math.cos(a)
    if operation == POWER:
        return math.pow(a, b)
    if operation == LOG:
        return math.log(a)
    if operation == SIGN:
        return choose(a > 0.0, 1.0, choose(a < 0.0, -1.0, choose(a == 0.0, 0.0, a)))
    return a - 2.0 * np.pi * np.rint(a / (2.0 * np.pi))  # WRAP


@nb.njit(cache=True, error_model="numpy")
def compute_wrench_rows(kernel: Kernel, columns: np.ndarray, out: np.ndarray) -> None:
    """Evaluate many rows: columns (G, N), the used inputs in the order of `kernel.gather`; out (M, N)."""
    code, numbers = kernel.code, kernel.numbers
    gathered, constants = int(code[0]), int(code[1])
    at = _HEADER_SIZE + gathered
    runs, at = code[at : at + 3 * code[2]], at + 3 * code[2]
    left, at = code[at : at + code[3]], at + code[3]
    right, at = code[at : at + code[3]], at + code[3]
    ends, terms = code[at : at + code[4] + 1], code[at + code[4] + 1 :]
    weights, offsets = numbers[constants:], numbers[constants + code[5] :]
    base = gathered + constants
    work = np.empty((base + len(left), _BLOCK_ROWS))
    for k in range(constants):
        work[gathered + k] = numbers[k]
    rows = out.shape[1]
    for first in range(0, rows, _BLOCK_ROWS):
        n = min(_BLOCK_ROWS, rows - first)
        for k in range(gathered):
            for i in range(n):  # a part assigned to a part would compile the text of an error for 3 s
                work[k, i] = columns[k, first + i]
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
                        to[i] = abs(a[i]) if operation == ABS else _apply_rare_operation(operation, a[i], b[i])
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
    """Two-operand instructions of the nodes that some outputs need.

    Everything that holds a value (input, constant, result of an instruction) is a number, the place of its key in
    `_keys`: ("input", name), ("constant", c) or (operation, number, number).
    """

    def __init__(self, graph: Graph, outputs: Sequence[Mapping[int, float]]) -> None:
        self._graph = graph
        self.inputs: list[str] = []
        self._keys: list[tuple] = []
        self._numbers: dict[tuple, int] = {}
        self._of_node: dict[int, int] = {}
        self._of_pair: dict[int, int] = {}
        self._place: dict[int, int] = {}
        needed = graph.reachable(outputs)
        products, self._pairs = _shared_products(graph, needed)
        for node in needed:
            self._of_node[node] = self._lower(node, products)

    def slot(self, node: int) -> int:
        return self._place[self._of_node[node]]

    def _number(self, *key) -> int:
        if key not in self._numbers:
            self._numbers[key] = len(self._keys)
            self._keys.append(key)
        return self._numbers[key]

    def _do(self, operation: int, a: int, b: int | None = None) -> int:
        return self._number(operation, a, a if b is None else b)

    def _lower(self, node: int, products: Mapping[int, int]) -> int:
        kind, *given = self._graph.nodes[node]
        of = self._of_node
        if kind == "input":
            self.inputs.append(given[0])
            return self._number("input", given[0])
        if kind in ("one", "constant"):
            return self._number("constant", given[0] if given else 1.0)
        if kind == "held":
            return of[given[1]]
        if kind == "quotient":
            return self._do(DIVIDE, of[given[0]], of[given[1]])
        if kind == "power":
            return self._do(POWER, of[given[0]], of[given[1]])
        if kind == "product":
            return self._multiply(products[node])
        if kind == "sum":
            return self._sum(given[0])
        return self._do(_OPERATION_OF_NODE[kind], of[given[0]])

    def _multiply(self, factor: int) -> int:
        if factor >= 0:
            return self._of_node[factor]
        if factor not in self._of_pair:
            a, b = self._pairs[-factor - 1]
            self._of_pair[factor] = self._do(MULTIPLY, self._multiply(a), self._multiply(b))
        return self._of_pair[factor]

    def _sum(self, parts: Iterable[tuple[int, float]]) -> int:
        total = None
        for node, factor in sorted(parts, key=lambda part: part[1] != 1.0):  # a factor of 1 begins, if there is one
            if node == ONE:
                term, negative = self._number("constant", factor), False
            else:
                negative = factor < 0 and total is not None
                size = -factor if negative else factor
                term = self._of_node[node]
                if size != 1.0:
                    term = self._do(MULTIPLY, self._number("constant", size), term)
            total = term if total is None else self._do(SUBTRACT if negative else ADD, total, term)
        return total

    def arranged(self) -> tuple[list[float], list[tuple[int, int, int]], list[int], list[int]]:
        """Constants, runs, and operands' slots; gives every input, constant and instruction its slot."""
        constants = [key[1] for key in self._keys if key[0] == "constant"]
        for key in [("input", name) for name in self.inputs] + [("constant", c) for c in constants]:
            self._place[self._numbers[key]] = len(self._place)
        waiting = [n for n, key in enumerate(self._keys) if len(key) == 3]
        runs, left, right = [], [], []
        while waiting:
            # the operation of which most can be done in a row; within a run one may build on another
            best: list[int] = []
            for operation in sorted({self._keys[n][0] for n in waiting}):
                done: dict[int, None] = {}
                for n in waiting:
                    kind, a, b = self._keys[n]
                    if kind == operation and (a in self._place or a in done) and (b in self._place or b in done):
                        done[n] = None
                if len(done) > len(best):
                    best = list(done)
            runs.append((self._keys[best[0]][0], len(left), len(left) + len(best)))
            for n in best:
                self._place[n] = len(self._place)
                left.append(self._place[self._keys[n][1]])
                right.append(self._place[self._keys[n][2]])
            taken = set(best)
            waiting = [n for n in waiting if n not in taken]
        return constants, runs, left, right


def _shared_products(graph: Graph, nodes: Iterable[int]) -> tuple[dict[int, int], list[tuple[int, int]]]:
    """Products as pairs: again and again the pair of factors that most products hold is formed, and stands for both.

    Returns {product node: factor} and the pairs. A factor that is 0 or more is a node, another, -1 - k, is pair k.
    """
    rows: dict[int, list[int]] = {}
    for node in nodes:
        kind, *given = graph.nodes[node]
        if kind == "product":
            rows[node] = [part for part, n in given[0] for _ in range(n)]

    def pairs_of(row: list[int]) -> set[tuple[int, int]]:
        count = Counter(row)
        factors = sorted(count)
        found = {(a, b) for i, a in enumerate(factors) for b in factors[i + 1 :]}
        return found | {(a, a) for a in factors if count[a] > 1}

    holders: dict[tuple[int, int], set[int]] = {}
    for node, row in rows.items():
        for pair in pairs_of(row):
            holders.setdefault(pair, set()).add(node)
    # most holders first; an entry whose count has changed since is passed over
    queue = [(-len(found), *pair) for pair, found in holders.items()]
    heapify(queue)
    pairs: list[tuple[int, int]] = []
    while queue:
        size, *pair = heappop(queue)
        a, b = pair = tuple(pair)
        if -size != len(holders[pair]) or not size:
            continue
        pairs.append(pair)
        changed: set[tuple[int, int]] = set()
        for node in sorted(holders[pair]):
            row = rows[node]
            before = pairs_of(row)
            times = row.count(a) // 2 if a == b else min(row.count(a), row.count(b))
            for _ in range(times):
                row.remove(a)
                row.remove(b)
            row.extend([-len(pairs)] * times)
            after = pairs_of(row)
            for old in before - after:
                holders[old].discard(node)
            for new in after - before:
                holders.setdefault(new, set()).add(node)
            changed |= before ^ after
        for other in changed:
            heappush(queue, (-len(holders[other]), *other))
    return {node: row[0] for node, row in rows.items()}, pairs
