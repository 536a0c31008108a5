"""Cross-products of a pool of columns, kept per stretch of flight; no matrix of all columns is ever held.

Columns are evaluated in chunks of rows. A first pass gathers every column's products with itself, with the target and
with the fixed columns; a further pass is made only when a column's products with all others are asked for, and then
for the most promising columns together. Everything is kept per cell, a stretch of one flight: sums over cells are the
normal equations, sums over some of them are those of other flights or of a resample, and their scatter shows how much
the residuals' memory takes from the evidence.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from quasi.terms.expressions import Program, Tree

CHUNK = 4096  # rows at a time: a pool of a thousand columns then takes 32 MB
CELLS = 256  # stretches over all flights
SHORTEST_CELL = 4  # rows of a cell
BYTES_IN_ONE_PASS = 2e8  # bytes of products formed in one pass
PREFETCH = 24  # columns whose products are formed in one pass


@dataclass
class Products:
    """Products of columns per cell. The first `fixed` columns are always in the model.

    rows (B,) rows of each cell; flight (B,) number of its flight, cells of one flight stand in its time order
    square (B, m); target (B, m) products with the target; target_square (B,), target_sum (B,) of the target itself
    crossed  {column: (B, m)} products of a column with all columns
    """

    fixed: int
    rows: np.ndarray
    flight: np.ndarray
    square: np.ndarray
    target: np.ndarray
    target_square: np.ndarray
    target_sum: np.ndarray
    crossed: dict[int, np.ndarray] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of columns."""
        return self.square.shape[1]

    def cross(self, column: int, promising: np.ndarray | None = None) -> np.ndarray:
        """Products (B, m) of a column with all columns; `promising` (m,) ranks what else may be wanted soon."""
        return self.crossed[column]

    def coefficients(self, columns: Sequence[int]) -> np.ndarray:
        """Least squares (p,) of the target on some columns."""
        columns = list(columns)
        gram = np.array([self.cross(k)[:, columns].sum(axis=0) for k in columns])
        scale = np.sqrt(np.diag(gram))
        return np.linalg.solve(gram / np.outer(scale, scale), self.target[:, columns].sum(axis=0) / scale) / scale

    def merged(self, group: np.ndarray) -> "Products":
        """The same over larger stretches: group (B,) is the new number of each cell, every cell of one flight."""
        count = int(group.max()) + 1
        gather = np.zeros((count, len(group)))
        gather[group, np.arange(len(group))] = 1.0
        first = np.array([np.flatnonzero(group == g)[0] for g in range(count)])
        crossed = {k: gather @ c for k, c in self.crossed.items()}
        return Products(
            self.fixed, gather @ self.rows, self.flight[first], gather @ self.square, gather @ self.target,
            gather @ self.target_square, gather @ self.target_sum, crossed,
        )  # fmt: skip


class Bend(NamedTuple):
    """Products per cell of what an offset of 1 does beyond a constant: with columns (B, m), itself (B,), the target
    (B,); and its sum (B,)."""

    columns: np.ndarray
    square: np.ndarray
    target: np.ndarray
    total: np.ndarray


class Pool(Products):
    """Products of columns given by expressions.

    trees     expressions of all columns; where `constant`, the first is the number 1
    fixed     how many of them are always in the model
    blocks    one {variable: (n_f,)} per flight; targets (n_f,) per flight
    series    row numbers (n_f,) per flight in its time order, increasing; consecutive when None
    constant  whether a constant is in the model: then the other columns are kept about (nearly) their means, which
              changes nothing but the digits, and the constant's coefficient
    shapes    (n_f,) per flight, of mean 1: how an offset of the flight acts; constant when None
    unusable  {column: why} after construction; such columns hold zeros
    length    rows that a cell spans, missing ones counted
    """

    def __init__(
        self,
        trees: Sequence[Tree],
        fixed: int,
        blocks: Sequence[dict[str, np.ndarray]],
        targets: Sequence[np.ndarray],
        series: Sequence[np.ndarray] | None = None,
        constant: bool = True,
        shapes: Sequence[np.ndarray] | None = None,
    ) -> None:
        self._trees, self._blocks, self.targets = list(trees), blocks, list(targets)
        self.shapes = [np.ones(len(z)) for z in targets] if shapes is None else shapes
        self._program = Program(trees)
        series = series or [np.arange(len(z)) for z in targets]
        self._cells, flight = _cells(series, len(trees))
        self.length = sum(int(rows[-1] - rows[0]) + 1 for rows in series if len(rows)) / max(len(flight), 1)
        count, size = len(flight), len(trees)
        super().__init__(
            fixed,
            np.bincount(np.concatenate(self._cells), minlength=count).astype(float),
            flight,
            np.zeros((count, size)),
            np.zeros((count, size)),
            np.zeros(count),
            np.zeros(count),
        )
        self.constant = constant
        self._chunk = int(np.clip(8 * CHUNK * 256 // max(size, 1), 256, CHUNK))
        self.shift, self.target_shift = self._shifts()
        self._first_pass()
        self.unusable = self._unusable()
        self._blank(self.square)
        self._blank(self.target)
        self._blank(self._bend.columns)
        for products in self.crossed.values():
            self._blank(products)

    def _chunks(self, program: Program) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, list[tuple[int, slice]]]]:
        out = np.empty((program.size, self._chunk))
        for block, z, shape, cells in zip(self._blocks, self.targets, self.shapes, self._cells):
            for start in range(0, len(z), self._chunk):
                rows = slice(start, min(start + self._chunk, len(z)))
                n = rows.stop - rows.start
                chunk = {name: block[name][rows] for name in program.names}
                into = out if n == self._chunk else np.empty((program.size, n))
                bounds = np.flatnonzero(np.diff(cells[rows])) + 1
                edges = [0, *bounds.tolist(), n]
                parts = [(int(cells[start + i]), slice(i, j)) for i, j in pairwise(edges)]
                yield program.run(chunk, n, into), z[rows] - self.target_shift, shape[rows] - 1.0, parts

    def _shifts(self) -> tuple[np.ndarray, float]:
        # means over a few thousand rows from everywhere: near enough for all the digits
        self.target_shift = 0.0
        shift = np.zeros(self.size)
        if not self.constant:
            return shift, 0.0
        rows = sum(map(len, self.targets))
        step = max(rows // CHUNK, 1)
        sums, count, target = np.zeros(self.size), 0, 0.0
        with np.errstate(all="ignore"):
            for block, z in zip(self._blocks, self.targets):
                some = {name: block[name][::step] for name in self._program.names}
                n = len(z[::step])
                sums += self._program.run(some, n).sum(axis=1)
                target += float(z[::step].sum())
                count += n
        shift = np.where(np.isfinite(sums), sums / count, 0.0)
        shift[0] = 0.0
        return shift, target / count

    def _first_pass(self) -> None:
        fixed = self.fixed
        products = np.zeros((len(self.rows), fixed + 2, self.size))
        bend = np.zeros((3, len(self.rows)))
        shift = self.shift[:, None]
        with np.errstate(all="ignore"):
            for x, z, more, parts in self._chunks(self._program):
                x -= shift
                y = np.vstack([x[:fixed], z, more])
                for cell, rows in parts:
                    part = x[:, rows]
                    products[cell] += y[:, rows] @ part.T
                    self.square[cell] += np.einsum("ij,ij->i", part, part)
                    self.target_square[cell] += float(z[rows] @ z[rows])
                    self.target_sum[cell] += float(z[rows].sum())
                    bend[:, cell] += more[rows] @ more[rows], more[rows] @ z[rows], more[rows].sum()
        self.target = products[:, fixed]
        self._bend = Bend(products[:, fixed + 1], *bend)
        for k in range(fixed):
            self.crossed[k] = np.ascontiguousarray(products[:, k])

    def _unusable(self) -> dict[int, str]:
        reasons = {}
        n, square = self.rows.sum(), self.square.sum(axis=0)
        for k in np.flatnonzero(~np.isfinite(square) | ~np.isfinite(self.target.sum(axis=0))):
            reasons[int(k)] = "is not finite in some rows (a division by zero, or a power without a real value)"
        for k in np.flatnonzero((square == 0) & (self.shift == 0)):
            reasons.setdefault(int(k), "is zero over the training rows")
        if self.constant:
            with np.errstate(all="ignore"):
                offset = self.crossed[0].sum(axis=0) / n
                spread = square - n * offset**2
                # exactly constant columns leave rounding behind
                flat = spread <= 1e-24 * n * (self.shift + offset) ** 2
            for k in np.flatnonzero(flat)[1:] if flat[0] else np.flatnonzero(flat):
                reasons.setdefault(int(k), "is constant over the training rows")
        return reasons

    def _blank(self, products: np.ndarray) -> None:
        products[:, list(self.unusable)] = 0.0

    def cross(self, column: int, promising: np.ndarray | None = None) -> np.ndarray:
        """Products (B, m) of a column with all columns; `promising` (m,) ranks what else may be wanted soon."""
        if column not in self.crossed:
            wanted = [column]
            if promising is not None:
                most = int(np.clip(BYTES_IN_ONE_PASS // (8 * self.square.size), 1, PREFETCH))
                order = np.argsort(-promising)[: PREFETCH + len(self.crossed)]
                wanted += [int(k) for k in order if int(k) not in self.crossed and k != column][: most - 1]
            self._form(wanted)
        return self.crossed[column]

    def _form(self, wanted: list[int]) -> None:
        result = np.zeros((len(wanted), len(self.rows), self.size))
        sums = np.zeros((len(wanted), len(self.rows)))
        shift = self.shift[wanted][:, None]
        with np.errstate(all="ignore"):
            for x, _, _, parts in self._chunks(self._program):
                y = x[wanted] - shift
                for cell, rows in parts:
                    result[:, cell] += y[:, rows] @ x[:, rows].T
                    sums[:, cell] += y[:, rows].sum(axis=1)
            # one of two factors about its mean is enough for the digits
            for products, own in zip(result, sums):
                products -= np.outer(own, self.shift)
        for k, products in zip(wanted, result):
            self._blank(products)
            self.crossed[k] = products

    def residuals(self, columns: Sequence[int], theta: np.ndarray) -> np.ndarray:
        """What is left (n,) of the target after some columns with coefficients theta; a constant is not taken off."""
        columns = list(columns)
        shift = self.shift[columns][:, None]
        program = Program([self._trees[k] for k in columns])
        return np.concatenate([z - theta @ (x - shift) for x, z, *_ in self._chunks(program)])

    @property
    def bends(self) -> bool:
        """Whether an offset of a flight is more than a constant."""
        return bool(self._bend.square.any())

    def less_bends(self, offsets: np.ndarray) -> "Pool":
        """The pool without what offsets of the flights (F,) do beyond a constant."""
        part, size, bend = copy(self), np.asarray(offsets)[self.flight], self._bend
        part.targets = [z - u * (shape - 1.0) for z, u, shape in zip(self.targets, offsets, self.shapes)]
        part.target = self.target - size[:, None] * bend.columns
        part.target_square = self.target_square - 2.0 * size * bend.target + size**2 * bend.square
        part.target_sum = self.target_sum - size * bend.total
        return part

    def subset(self, columns: Sequence[int]) -> Products:
        """All products among some of the columns, the fixed ones first; one pass over these alone."""
        columns = list(columns)
        part = Pool.__new__(Pool)
        part.__dict__.update(self.__dict__)
        part._program = Program([self._trees[k] for k in columns])
        part.shift, part.unusable = self.shift[columns], {}
        part.square, part.target, part.crossed = self.square[:, columns], self.target[:, columns], {}
        part._form(list(range(len(columns))))
        return Products(
            self.fixed,
            self.rows,
            self.flight,
            part.square,
            part.target,
            self.target_square,
            self.target_sum,
            part.crossed,
        )


def _cells(series: Sequence[np.ndarray], columns: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Cell of every row per flight, and the flight of every cell; cells last equally long."""
    spans = [int(rows[-1] - rows[0]) + 1 if len(rows) else 0 for rows in series]
    wanted = max(min(CELLS, int(2e6 // max(columns, 1))), 64)
    length = max(sum(spans) / wanted, SHORTEST_CELL)
    cells, flight = [], []
    for number, (rows, span) in enumerate(zip(series, spans)):
        count = max(round(span / length), 1) if span else 0
        cells.append(len(flight) + ((rows - rows[0]) * count) // span if span else np.zeros(0, int))
        flight += [number] * count
    return cells, np.array(flight)
