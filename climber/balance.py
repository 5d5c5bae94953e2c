"""Where a robot's centre of mass may be for its contacts to hold it: halfspaces A p <= b in W.

In the plane two of them, the ends of the support interval (Gönen 2021, 4.2); in space one for every edge of the support
polygon, which is a prism along gravity (Bretl 2006, appendix B).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations
from typing import Self

import numpy as np

from climber.robot import Indices
from climber.stance import Vector

LEAST = 0.4  # share of its depth that a margin takes of a region, and no more
SAME = 1e-9  # rows nearer to each other than this are one


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

        It is min over w of w . b with w >= 0, w . A = 0 and the sum of w one, which is what linear programming says of
        max over p and t of t with A p + t <= b. As the rows lie in a plane, three of them have weight, or two.
        """
        A, b = self.ends.A, self.ends.b
        if not len(b):
            return np.inf
        opposite = np.linalg.norm(A[:, None] + A[None], axis=2) < SAME
        best = float(((b[:, None] + b) / 2)[opposite].min(initial=np.inf))
        if len(b) > 2:
            # Coordinates in the plane of the rows.
            rows = A @ np.linalg.svd(A)[2][:2].T
            triples = _triples(len(rows))
            system = np.concatenate([np.swapaxes(rows[triples], 1, 2), np.ones((len(triples), 1, 3))], axis=1)
            regular = np.abs(np.linalg.det(system)) > SAME
            weights = np.linalg.solve(system[regular], np.array([[0.0], [0.0], [1.0]]))[:, :, 0]
            inside = (weights >= 0.0).all(axis=1)
            values = (weights[inside] * b[triples[regular][inside]]).sum(axis=1)
            best = min(best, float(values.min(initial=np.inf)))
        return best

    def shrunk(self, margin: float) -> Self:
        """The region less a margin [m], but never less than `LEAST` of its depth."""
        return replace(self, b=self.b - min(margin, LEAST * max(self.depth, 0.0)))

    def meet(self, other: Region) -> Self:
        """The points of both; of borders that face the same way the nearer counts."""
        A, b = np.concatenate([self.A, other.A]), np.concatenate([self.b, other.b])
        kept: list[int] = []
        for i in np.argsort(b, kind="stable"):
            if all(np.abs(A[i] - A[j]).max() > SAME for j in kept):
                kept.append(int(i))
        order = np.array(kept)[np.lexsort(A[kept].T[::-1])] if kept else np.zeros(0, dtype=int)
        return replace(self, A=A[order], b=b[order])

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


@cache
def _triples(m: int) -> Indices:
    """All triples i < j < k below m, shape (., 3)."""
    return np.array(list(combinations(range(m), 3)), dtype=np.int64).reshape(-1, 3)
