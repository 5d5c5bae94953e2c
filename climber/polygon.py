"""The feet of a stance as corners of a polygon: which of them is out of order, and by how much."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np

from climber.geometry import counter_clockwise
from climber.stance import Vector

Corner = tuple[int, int, int]


def turn(points: Vector) -> float:
    """Twice the signed area of a triangle, shape (3, 2); positive if it turns left [m^2]."""
    (ax, ay), (bx, by), (cx, cy) = points
    return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))


def in_order(points: Vector) -> bool:
    """Whether points, shape (n, 2), go counter-clockwise around a strictly convex polygon (Gönen 2021, eqs. 4.6)."""
    order, convex = counter_clockwise(points[None])
    return bool(convex[0] and (order[0] == np.arange(len(points))).all())


def corners(n: int) -> list[Corner]:
    """The corners that must all turn left: three points in a row, and the fan of triangles around the first."""
    around = [] if n < 3 else [(i, (i + 1) % n, (i + 2) % n) for i in range(n)]
    return around + [(0, i, i + 1) for i in range(2, n - 2)]


def worst_corner(points: Vector) -> tuple[float, Corner] | None:
    """The corner whose middle point lies farthest on the inner side of the line through its neighbours.

    Returns:
        How far inside [m], negative if all corners turn left, and the corner; None for fewer than three points.
    """
    inside = []
    for corner in corners(len(points)):
        a, _, c = points[list(corner)]
        inside.append((-turn(points[list(corner)]) / max(float(np.linalg.norm(c - a)), 1e-12), corner))
    return max(inside, default=None)


def swaps(points: Vector) -> list[tuple[int, int]]:
    """Pairs of points whose change of places would put all in order."""
    found = []
    for i, j in combinations(range(len(points)), 2):
        places = np.arange(len(points))
        places[[i, j]] = j, i
        if in_order(points[places]):
            found.append((i, j))
    return found


def crossing_sides(points: Vector) -> list[tuple[int, int]]:
    """Pairs of sides that cross in their insides; side i goes from point i to the next."""
    n = len(points)
    found = []
    for i, j in combinations(range(n), 2):
        a, b, c, d = i, (i + 1) % n, j, (j + 1) % n
        if len({a, b, c, d}) == 4:
            over = turn(points[[a, b, c]]) * turn(points[[a, b, d]])
            under = turn(points[[c, d, a]]) * turn(points[[c, d, b]])
            if over < 0.0 and under < 0.0:
                found.append((i, j))
    return found


def out_of_order_anywhere(points: Vector, aside: Vector) -> bool:
    """Whether one corner turns the wrong way wherever the points are on segments around them.

    The turn of a corner is linear in each of its three offsets, so it is greatest at a corner of the box they are in.

    Args:
        points: Middles of the segments [m], shape (n, 2).
        aside: From the middles to their ends [m], shape (n, 2).
    """
    signs = [np.array(s)[:, None] for s in product((-1.0, 1.0), repeat=3)]
    for corner in corners(len(points)):
        at = list(corner)
        if max(turn(points[at] + s * aside[at]) for s in signs) <= 0.0:
            return True
    return False
