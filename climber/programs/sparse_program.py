"""Sparse conic programs, put together from blocks of rows and solved again with other numbers in the same places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import clarabel
import numpy as np
from scipy import sparse

from climber.programs.blocks import plain_settings
from climber.robot import Indices
from climber.stance import Vector

Part = tuple[Indices, Vector]  # columns and values, both of shape (M, w)
GAP = 1e-6  # relative accuracy asked of the cost
FEASIBILITY = 1e-7  # accuracy asked of the constraints
# Added to the diagonal of the matrix that Clarabel factors. Where forces may balance in many ways at the same cost, as
# those of four feet in space, every third program ends in a numerical error with Clarabel's own 1e-8.
REGULARIZATION = 1e-7


@dataclass
class Rows:
    """Rows of a sparse matrix and their right sides, collected block by block."""

    count: int = 0
    rows: list[Indices] = field(default_factory=list)
    columns: list[Indices] = field(default_factory=list)
    values: list[Vector] = field(default_factory=list)
    places: list[Indices] = field(default_factory=list)
    right: list[Vector] = field(default_factory=list)

    def add(self, right: Vector, *parts: Part) -> slice:
        """Adds M rows, the sum of the parts against `right` (M,); where they are."""
        return self._add(self.count + np.arange(len(right)), right, parts)

    def add_cones(self, *axes: tuple[Vector, tuple[Part, ...]]) -> slice:
        """Adds M second-order cones, given as the rows of their first axes, of their second ones, and so on."""
        start, width = self.count, len(axes)
        for axis, (right, parts) in enumerate(axes):
            self._add(start + axis + width * np.arange(len(right)), right, parts)
        return slice(start, self.count)

    def _add(self, places: Indices, right: Vector, parts: Sequence[Part]) -> slice:
        for columns, values in parts:
            self.rows.append(np.broadcast_to(places[:, None], values.shape).ravel())
            self.columns.append(np.broadcast_to(columns, values.shape).ravel())
            self.values.append(values.ravel())
        self.places.append(places)
        self.right.append(right)
        begin, self.count = self.count, self.count + len(right)
        return slice(begin, self.count)


class SparseProgram:
    """min cost . x  subject to  rows = right, rows <= right, and right - rows in second-order cones of three.

    The rows may hold other numbers each time that the program is solved, but in the same places.
    """

    def __init__(self, cost: Vector) -> None:
        """Nothing is built until the rows are known.

        Args:
            cost: Shape (num_variables,).
        """
        self._cost = cost
        self._solver: clarabel.DefaultSolver | None = None

    def solve(self, equal: Rows, below: Sequence[Rows], cones: Rows) -> tuple[Vector, list[Vector]] | None:
        """The solution x, or None if Clarabel finds none, and the prices of the rows that are not equations.

        A price is the multiplier of a row times its right side's size, or 1 where that is less; there is an array of
        them for each of `below`, then one for `cones`.
        """
        parts = [equal, *below, cones]
        offsets = np.cumsum([0, *(part.count for part in parts)])
        values = np.concatenate([value for part in parts for value in part.values])
        right = np.empty(offsets[-1])
        for part, at in zip(parts, offsets, strict=False):
            if part.count:
                right[at + np.concatenate(part.places)] = np.concatenate(part.right)
        if self._solver is None:
            rows = np.concatenate([row + at for part, at in zip(parts, offsets, strict=False) for row in part.rows])
            columns = np.concatenate([column for part in parts for column in part.columns])
            # Column by column, as the matrix is stored; parts of a row that share a column add up.
            keys, self._entry = np.unique(columns * offsets[-1] + rows, return_inverse=True)
            columns, rows = np.divmod(keys, offsets[-1])
            size = len(self._cost)
            starts = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=size))])
            data = np.bincount(self._entry, values)
            matrix = sparse.csc_matrix((data, rows, starts), shape=(int(offsets[-1]), size))
            self._solver = self._clarabel(matrix, right, equal.count, cones.count)
        else:  # what is known of the matrix's pattern stays known
            self._solver.update(A=np.bincount(self._entry, values), b=right)
        solution = self._solver.solve()
        if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
            return None
        prices = np.array(solution.z) * np.maximum(np.abs(right), 1.0)
        return np.array(solution.x), np.split(prices, offsets[1:-1])[1:]

    def _clarabel(
        self, matrix: sparse.csc_matrix, right: Vector, equations: int, in_cones: int
    ) -> clarabel.DefaultSolver:
        """Clarabel with the program, whose first rows are equations and whose last ones are in cones."""
        cones = [clarabel.ZeroConeT(equations), clarabel.NonnegativeConeT(len(right) - equations - in_cones)]
        cones += [clarabel.SecondOrderConeT(3)] * (in_cones // 3)
        settings = plain_settings(FEASIBILITY, GAP)
        settings.static_regularization_constant = REGULARIZATION
        quadratic = sparse.csc_matrix((len(self._cost), len(self._cost)))
        return clarabel.DefaultSolver(quadratic, self._cost, matrix, right, cones, settings)
