"""Where a robot's centre of mass may be for its contacts to hold it: halfspaces A p <= b in W.

In the plane two of them, the ends of the support interval (Gönen 2021, 4.2); in space one for every edge of the support
polygon, which is a prism along gravity (Bretl 2006, appendix B).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.optimize import linprog

from climber.stance import Vector

LEAST = 0.4  # share of its depth that a margin takes of a region, and no more
SAME = 1e-9  # rows nearer to each other than this are one
UNBOUNDED = 3  # what linprog says of a program without an optimum


@dataclass(frozen=True)
class Region:
    """Points p of W with A p <= b.

    Attributes:
        A: Unit outward normals, shape (m, 3).
        b: How far along them the region reaches [m], shape (m,); infinite where it does not end.
    """

    A: Vector
    b: Vector

    @classmethod
    def interval(cls, lower: float, upper: float) -> Self:
        """The points with abscissas from `lower` to `upper` [m]."""
        return cls(np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.array([-lower, upper]))

    @property
    def abscissas(self) -> tuple[float, float]:
        """The ends of a planar robot's support interval [m]."""
        lower, upper = self.b
        return float(-lower), float(upper)

    def room(self, p: Vector) -> Vector:
        """How far points, shape (K, 3), are from the nearest border [m], shape (K,); negative outside."""
        result: Vector = (self.b - p @ self.A.T).min(axis=1, initial=np.inf)
        return result

    @cached_property
    def depth(self) -> float:
        """The most that the borders can all be moved inwards until nothing is left [m]; negative if nothing there is.

        That is max over p and t of t with A p + t <= b. For an interval it is half its length.
        """
        A, b = self.ends.A, self.ends.b
        if len(b) < 2:
            return np.inf
        if len(b) == 2 and np.abs(A[0] + A[1]).max() < SAME:
            return float(b[0] + b[1]) / 2
        rows = np.column_stack([A, np.ones(len(b))])
        answer = linprog([0.0, 0.0, 0.0, -1.0], rows, b, bounds=[(None, None)] * 4, method="highs")
        return np.inf if answer.status == UNBOUNDED else float(answer.x[3])

    def shrunk(self, margin: float) -> Self:
        """The region less a margin [m], but never less than `LEAST` of its depth."""
        return replace(self, b=self.b - min(margin, LEAST * max(self.depth, 0.0)))

    def meet(self, other: Region) -> Self:
        """The points of both; of borders that face the same way the nearer counts."""
        A, b = np.concatenate([self.A, other.A]), np.concatenate([self.b, other.b])
        _, first, number = np.unique(np.round(A / SAME), axis=0, return_index=True, return_inverse=True)
        nearest = np.full(len(first), np.inf)
        np.minimum.at(nearest, number.reshape(-1), b)
        return replace(self, A=A[first], b=nearest)

    @property
    def distinct(self) -> Self:
        """The region with every row once; of those that face the same way the nearest."""
        return self.meet(replace(self, A=self.A[:0], b=self.b[:0]))

    @property
    def ends(self) -> Self:
        """The region without rows at which it does not end."""
        finite = np.isfinite(self.b)
        return replace(self, A=self.A[finite], b=self.b[finite])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """What it means to be inside of each border, in words."""
        if len(self.b) == 2 and np.array_equal(self.A, Region.interval(0.0, 0.0).A):
            ends = "right of the support interval's lower end", "left of the support interval's upper end"
            return tuple(f"centre of mass {end}" for end in ends)
        return tuple(f"centre of mass inside edge {i} of the support polygon" for i in range(len(self.b)))
