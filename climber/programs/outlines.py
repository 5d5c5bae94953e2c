"""Convex figures in a plane known by their extreme points: enclosed from inside and outside, many at a time.

Asked for a direction, an oracle gives a point of the figure and a bound on how far the figure reaches in it. The hull
of the points is inside the figure; what satisfies all bounds is outside. Between neighbouring directions the outer
figure has one corner; its distance from the inner figure's edge tells where to ask next (as in Bretl and Lall 2008,
"Testing static equilibrium for legged robots"), along the normal of that edge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from climber.stance import Vector

Indices = NDArray[np.int64]
Oracle = Callable[[Indices, Vector], tuple[Vector, Vector]]

ROUNDS = 12  # each asks once between all neighbours that are not near enough; errors fall fourfold at least
SAME = 1e-8  # [m] corners closer than this count as one


@dataclass(frozen=True)
class Outlines:
    """R supports of M figures, by figure and then counter-clockwise.

    Attributes:
        figure: Which figure each support is of, shape (R,).
        direction: Unit directions asked for, shape (R, 2).
        point: Points of the figures [m], shape (R, 2).
        bound: Most that the figure reaches in that direction [m], shape (R,).
        gap: No point within a figure's bounds is farther than this from the hull of its points [m], shape (M,).
    """

    figure: Indices
    direction: Vector
    point: Vector
    bound: Vector
    gap: Vector


def outline(figures: Indices, num_figures: int, ask: Oracle, gap: float) -> Outlines:
    """Encloses figures.

    Args:
        figures: Numbers of those that are not empty.
        num_figures: How many there are, M.
        ask: Given figures, shape (n,), and unit directions, (n, 2), the points (n, 2) and the bounds (n,).
        gap: How near inside and outside should be [m].
    """
    if not len(figures):
        nothing = np.zeros((0, 2))
        return Outlines(figures, nothing, nothing, np.zeros(0), np.full(num_figures, np.nan))
    figure = np.repeat(figures, 4)
    angle = np.tile([-np.pi, -np.pi / 2, 0.0, np.pi / 2], len(figures))
    point, bound = ask(figure, _unit(angle))
    for _ in range(ROUNDS):
        order = np.lexsort((angle, figure))
        figure, angle, point, bound = figure[order], angle[order], point[order], bound[order]
        after, between, apart = _corners(figure, angle, point, bound)
        far = np.flatnonzero(apart > gap)
        if not len(far):
            break
        along = point[after[far]] - point[far]
        normal = np.arctan2(-along[:, 0], along[:, 1])
        turn = (normal - angle[far]) % (2 * np.pi)
        # Points may coincide, or be as wrong as rounding is.
        usable = (turn > 0.01 * between[far]) & (turn < 0.99 * between[far])
        turn = np.where(usable, turn, 0.5 * between[far])
        new = (angle[far] + turn + np.pi) % (2 * np.pi) - np.pi
        more_points, more_bounds = ask(figure[far], _unit(new))
        figure, angle = np.concatenate([figure, figure[far]]), np.concatenate([angle, new])
        point, bound = np.concatenate([point, more_points]), np.concatenate([bound, more_bounds])
    order = np.lexsort((angle, figure))
    figure, angle, point, bound = figure[order], angle[order], point[order], bound[order]
    worst = np.full(num_figures, np.nan)
    worst[figures] = 0.0
    np.maximum.at(worst, figure, _corners(figure, angle, point, bound)[2])
    return Outlines(figure, _unit(angle), point, bound, worst)


def _unit(angle: Vector) -> Vector:
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _corners(figure: Indices, angle: Vector, point: Vector, bound: Vector) -> tuple[Indices, Vector, Vector]:
    """Each support's neighbour, the angle to it, and how far the outer corner between them is from the inner edge."""
    n = len(figure)
    after = np.arange(1, n + 1)
    first = np.flatnonzero(np.append(True, figure[1:] != figure[:-1]))
    after[np.append(first[1:], n) - 1] = first
    between = (angle[after] - angle) % (2 * np.pi)
    d, e = _unit(angle), _unit(angle[after])
    sine = np.maximum(np.sin(between), 1e-12)
    corner = np.column_stack(
        [(bound * e[:, 1] - bound[after] * d[:, 1]) / sine, (bound[after] * d[:, 0] - bound * e[:, 0]) / sine]
    )
    start, along = point, point[after] - point
    share = np.clip(((corner - start) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-30), 0.0, 1.0)
    apart = np.linalg.norm(corner - start - share[:, None] * along, axis=1)
    return after, between, np.where(between > 1e-9, apart, 0.0)


def hulls(outlines: Outlines, num_figures: int) -> tuple[Vector, Vector, Vector]:
    """The hulls of the points as halfplanes.

    Returns:
        Unit normals N, shape (M, r, 2), right sides c of N p <= c [m], shape (M, r), and corners [m], shape (M, r, 2).
        Figures with fewer sides than r repeat their last one; a segment and a point have sides too. NaN if empty.
    """
    count = np.bincount(outlines.figure, minlength=num_figures)
    some = np.flatnonzero(count)
    corners: list[Vector] = [np.zeros((0, 2))] * num_figures
    if len(some):
        shapes = shapely.convex_hull(shapely.multipoints(outlines.point, indices=_ranks(outlines.figure)))
        for i, shape in zip(some.tolist(), shapes, strict=True):
            ring = shapely.get_coordinates(shape)
            if len(ring) > 3:
                ring = ring[-1:0:-1] if not shapely.is_ccw(shape.exterior) else ring[:-1]
            corners[i] = _plain(ring, float(shape.area))
    sides = max(4, max((len(c) for c in corners), default=4))
    N, c = np.full((num_figures, sides, 2), np.nan), np.full((num_figures, sides), np.nan)
    padded = np.full((num_figures, sides, 2), np.nan)
    for i in some.tolist():
        normals, at = _sides(corners[i])
        places = np.minimum(np.arange(sides), len(at) - 1)
        N[i] = normals[places]
        c[i] = (normals * at).sum(axis=1)[places]
        padded[i] = corners[i][np.minimum(np.arange(sides), len(corners[i]) - 1)]
    return N, c, padded


def _plain(ring: Vector, area: float) -> Vector:
    """The corners of a convex polygon without those that are as good as others; two or one if it is that narrow."""
    apart = np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1) > SAME
    ring = ring[apart] if apart.any() else ring[:1]
    distance = np.linalg.norm(ring[:, None] - ring, axis=2)
    if len(ring) > 2 and 2.0 * area < SAME * distance.max():
        # The sides would say next to nothing of where it ends.
        return ring[list(np.unravel_index(distance.argmax(), distance.shape))]
    return ring


def _ranks(figure: Indices) -> Indices:
    """Numbers from 0 without gaps for sorted figures."""
    return np.cumsum(np.append(0, figure[1:] != figure[:-1]))


def _sides(corners: Vector) -> tuple[Vector, Vector]:
    """Outward unit normals of a convex polygon's sides, and a point of each; those of a segment or a point are four."""
    if len(corners) > 2:
        along = np.roll(corners, -1, axis=0) - corners
        normals = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
        return normals, corners
    along = corners[-1] - corners[0]
    length = float(np.linalg.norm(along))
    t = along / length if length > 0.0 else np.array([1.0, 0.0])
    normals = np.array([[t[1], -t[0]], t, [-t[1], t[0]], -t])
    return normals, corners[[0, -1, -1, 0]]
