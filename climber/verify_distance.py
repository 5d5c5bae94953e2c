"""Distances between convex hulls of points, for many pairs at once, each with the plane between the two that proves it.

The algorithm is that of Gilbert, Johnson and Keerthi: the distance of two hulls is that of the origin from the hull of
all differences of their points, and the nearest point of that is sought on simplices of at most four differences, to
which the difference farthest towards the origin is added. Where a search ends early, what it returns is still true: the
two hulls lie on either side of a slab of that thickness.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from climber.stance import Vector

STEPS = 60
CONVERGED = 1e-10  # [m] between the nearest point found and the slab that proves it
TOUCHING = 1e-10  # [m]
DEGENERATE = 1e-12  # of a simplex's squared size, below which its part of fewer corners serves

FACES = tuple(face for size in (1, 2, 3, 4) for face in combinations(range(4), size))
# For each face its corners, filled up with the first of them.
MEMBERS = np.array([[corner if corner in face else face[0] for corner in range(4)] for face in FACES])
FREE = np.array([next((corner for corner in range(4) if corner not in face), 0) for face in FACES])


def hull_distances(one: Vector, two: Vector) -> Vector:
    """How far apart two hulls are, or less: never more than they really are.

    Args:
        one: Corners of the first of K pairs of hulls [m], shape (K, m, 3).
        two: Corners of the second, shape (K, n, 3).

    Returns:
        Distances [m], shape (K,); zero where they meet.
    """
    differences = (one[:, :, None] - two[:, None]).reshape(len(one), one.shape[1] * two.shape[1], 3)
    result = np.zeros(len(one))
    if not len(one):
        return result
    pending = np.arange(len(one))
    first = np.argmin((differences**2).sum(axis=2), axis=1)
    simplex = np.repeat(differences[pending, first][:, None], 4, axis=1)
    for _ in range(STEPS):
        near, simplex, free = _nearest(simplex)
        size = np.linalg.norm(near, axis=1)
        ahead = np.einsum("kmi,ki->km", differences[pending], near)
        added = np.argmin(ahead, axis=1)
        rows = np.arange(len(pending))
        proved = ahead[rows, added] / np.maximum(size, TOUCHING)
        result[pending] = np.maximum(result[pending], proved)
        on = (size > TOUCHING) & (size - proved > CONVERGED)
        if not on.any():
            break
        simplex[rows, free] = differences[pending, added]
        pending, simplex = pending[on], simplex[on]
    return result


def _nearest(simplex: Vector) -> tuple[Vector, Vector, NDArray[np.int64]]:
    """The point of each tetrahedron (K, 4, 3), flat or not, that is nearest to the origin.

    Each face of one to four corners is a candidate with the origin's projection on it, where that lies inside.

    Returns:
        The points (K, 3); the corners of the face that they are on, filled up to four, (K, 4, 3); and the place of one
        corner that the face does not need, (K,).
    """
    count = len(simplex)
    points = np.full((count, len(FACES), 3), np.inf)
    for place, face in enumerate(FACES):
        corner, edges = simplex[:, face[0]], simplex[:, face[1:]] - simplex[:, face[:1]]
        if len(face) == 1:
            points[:, place] = corner
            continue
        gram = np.einsum("kai,kbi->kab", edges, edges)
        sizes = np.einsum("kaa->ka", gram)
        determinant = np.linalg.det(gram)
        solid = determinant > DEGENERATE * sizes.prod(axis=1) + 1e-300
        gram[~solid] = np.eye(len(face) - 1)
        weights = np.linalg.solve(gram, -np.einsum("kai,ki->ka", edges, corner)[:, :, None])[:, :, 0]
        inside = solid & (weights >= 0.0).all(axis=1) & (weights.sum(axis=1) <= 1.0)
        at = corner + np.einsum("ka,kai->ki", weights, edges)
        points[inside, place] = at[inside] if len(face) < 4 else 0.0
    best = np.argmin((points**2).sum(axis=2), axis=1)
    rows = np.arange(count)
    return points[rows, best], simplex[rows[:, None], MEMBERS[best]], FREE[best]
