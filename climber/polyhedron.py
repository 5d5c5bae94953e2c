"""Convex polyhedra as corners, edges and faces, and how far points and segments are from them, many at a time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from climber.stance import Vector

COPLANAR = 1e-7  # faces whose normals and heights differ by less than this are one
ROUNDING = 1e-9  # [m]


@dataclass(frozen=True)
class Polyhedron:
    """A convex polyhedron.

    Attributes:
        corners: Its corners [m], shape (V, 3).
        edges: Corners at both ends of each edge, shape (E, 2).
        normals: Unit outward normal of each face, shape (F, 3).
        heights: A point p is outside face f if normals[f] . p > heights[f] [m], shape (F,).
    """

    corners: Vector
    edges: NDArray[np.int64]
    normals: Vector
    heights: Vector

    @classmethod
    def of(cls, points: Vector) -> Polyhedron:
        """The convex hull of points [m], shape (n, 3).

        Raises:
            ValueError: If they all lie in one plane.
        """
        try:
            hull = ConvexHull(points)
        except QhullError as error:
            raise ValueError("these points lie in one plane and have no volume") from error
        equations: list[Vector] = []
        owner = np.empty(len(hull.equations), dtype=np.int64)
        for triangle, equation in enumerate(hull.equations):
            same = [k for k, known in enumerate(equations) if np.abs(known - equation).max() < COPLANAR]
            if not same:
                equations.append(equation)
            owner[triangle] = same[0] if same else len(equations) - 1
        sides: dict[tuple[int, int], list[int]] = {}
        for triangle, simplex in enumerate(hull.simplices):
            for i in range(3):
                side = tuple(sorted((int(simplex[i]), int(simplex[(i + 1) % 3]))))
                sides.setdefault((side[0], side[1]), []).append(int(owner[triangle]))
        edges = [side for side, faces in sides.items() if len(set(faces)) > 1]  # the others divide a face
        used = sorted({corner for edge in edges for corner in edge})
        number = {corner: k for k, corner in enumerate(used)}
        planes = np.array(equations)
        return cls(
            np.asarray(points, dtype=float)[used],
            np.array([[number[a], number[b]] for a, b in edges], dtype=np.int64),
            planes[:, :3],
            -planes[:, 3],
        )

    @cached_property
    def leaning(self) -> Vector:
        """Cosine of the angle between every two normals, shape (F, F)."""
        return self.normals @ self.normals.T

    @cached_property
    def ball(self) -> tuple[Vector, float]:
        """Centre [m], shape (3,), and radius [m] of a ball that contains it."""
        center: Vector = (self.corners.min(axis=0) + self.corners.max(axis=0)) / 2
        return center, float(np.linalg.norm(self.corners - center, axis=1).max())

    def above(self, points: Vector) -> Vector:
        """How high points (..., 3) are above each face [m], shape (..., F)."""
        result: Vector = points @ self.normals.T - self.heights
        return result

    def over_faces(self, points: Vector) -> tuple[Vector, NDArray[np.int64]]:
        """Distance of points (..., 3) from the faces they are straight above [m], and which face; shapes (...).

        Infinite for points nearest to an edge or a corner, zero inside the polyhedron.
        """
        above = self.above(points)
        # Dropped onto face f, a point is at above_g - above_f n_g . n_f above face g.
        dropped = (above[..., None, :] - above[..., :, None] * self.leaning).max(axis=-1)  # (..., F)
        height = np.where((above > 0.0) & (dropped <= ROUNDING), above, np.inf)
        face = height.argmin(axis=-1)
        nearest = np.take_along_axis(height, face[..., None], axis=-1)[..., 0]
        return np.where((above <= 0.0).all(axis=-1), 0.0, nearest), face

    def distance(self, points: Vector) -> Vector:
        """Distance of points (..., 3) from the polyhedron [m], zero inside; shape (...)."""
        start, end = self.corners[self.edges[:, 0]], self.corners[self.edges[:, 1]]
        along, off = end - start, points[..., None, :] - start
        share = np.clip((off * along).sum(axis=-1) / (along**2).sum(axis=-1), 0.0, 1.0)
        to_edges = np.linalg.norm(off - share[..., None] * along, axis=-1).min(axis=-1)
        result: Vector = np.minimum(to_edges, self.over_faces(points)[0])
        return result
