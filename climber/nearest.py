"""Where segments and convex polyhedra in space are closest, for many of them at a time.

The squared distance of two points that move along two segments is convex, so it is least either where its slope is
zero or with one of the points at an end. Of a segment and a polyhedron apart from it the closest points are either an
end and a face that it is straight above, or on the segment and an edge.
"""

from __future__ import annotations

import numpy as np

from climber.polyhedron import ROUNDING, Polyhedron
from climber.stance import Vector

TINY = 1e-18  # [m^2] squared length under which a segment is a point


def closest(a0: Vector, a1: Vector, b0: Vector, b1: Vector) -> tuple[Vector, Vector, Vector]:
    """Where segments in space are closest; arrays of points (..., 3) broadcast.

    Returns:
        Fractions along the first and the second segments, and the squared distance there [m^2], shape (...).
    """
    u, v, w = a1 - a0, b1 - b0, b0 - a0
    uu, vv, ww = (np.einsum("...i,...i->...", x, x) for x in (u, v, w))
    uv, uw, vw = (np.einsum("...i,...i->...", x, y) for x, y in ((u, v), (u, w), (v, w)))
    u_safe, v_safe = np.maximum(uu, TINY), np.maximum(vv, TINY)

    def squared(s: Vector, t: Vector) -> Vector:
        """|w + t v - s u|^2."""
        result: Vector = ww + s * (s * uu - 2.0 * t * uv - 2.0 * uw) + t * (t * vv + 2.0 * vw)
        return result

    zero, one = np.zeros_like(uw + vw), np.ones_like(uw + vw)
    s, t = zero, np.clip(-vw / v_safe, 0.0, 1.0)
    best = squared(s, t)
    for s_new, t_new in (
        (one, np.clip((uv - vw) / v_safe, 0.0, 1.0)),
        (np.clip(uw / u_safe, 0.0, 1.0), zero),
        (np.clip((uw + uv) / u_safe, 0.0, 1.0), one),
    ):
        found = squared(s_new, t_new)
        closer = found < best
        s, t, best = np.where(closer, s_new, s), np.where(closer, t_new, t), np.where(closer, found, best)
    det = uu * vv - uv * uv
    safe = np.where(det > 1e-12 * uu * vv, det, np.inf)  # parallel segments are closest at an end as well
    s_in, t_in = (uw * vv - uv * vw) / safe, (uw * uv - uu * vw) / safe
    within = (s_in > 0.0) & (s_in < 1.0) & (t_in > 0.0) & (t_in < 1.0) & np.isfinite(safe)
    s, t = np.where(within, s_in, s), np.where(within, t_in, t)
    return s, t, np.maximum(np.where(within, squared(s, t), best), 0.0)


def point_to_segment(point: Vector, a0: Vector, a1: Vector) -> tuple[Vector, Vector]:
    """Where points (..., 3) are closest to segments: fractions along them, and distances [m]."""
    u, w = a1 - a0, point - a0
    s = np.clip(np.einsum("...i,...i->...", u, w) / np.maximum(np.einsum("...i,...i->...", u, u), TINY), 0.0, 1.0)
    return s, np.linalg.norm(w - s[..., None] * u, axis=-1)


def least_height(polyhedron: Polyhedron, a0: Vector, a1: Vector) -> tuple[Vector, Vector]:
    """Bounds on the distance of segments (..., 3) from a polyhedron: the most that a face has all of them above it.

    Returns:
        The bounds [m], never more than the distances, negative where no face has a segment in front of it; and whether
        each is the distance itself. Shapes (...).
    """
    above0, above1 = polyhedron.above(a0), polyhedron.above(a1)
    least = np.minimum(above0, above1)
    face = least.argmax(axis=-1)[..., None]
    bound = np.take_along_axis(least, face, axis=-1)
    leaning = polyhedron.leaning[face[..., 0]]  # (..., F)
    nearer = np.take_along_axis(above0, face, axis=-1) <= np.take_along_axis(above1, face, axis=-1)
    dropped = np.where(nearer, above0, above1) - bound * leaning
    exact = (bound[..., 0] > 0.0) & (dropped <= ROUNDING).all(axis=-1)
    return bound[..., 0], exact


def segment_to_polyhedron(polyhedron: Polyhedron, a0: Vector, a1: Vector) -> tuple[Vector, Vector, Vector]:
    """Distance of segments (M, 3) from a polyhedron [m], zero where they meet, and where they are closest.

    Returns:
        Distances, shape (M,); fractions along the segments, shape (M,), and points of the polyhedron, shape (M, 3).
    """
    corners = polyhedron.corners[polyhedron.edges]  # (E, 2, 3)
    s, t, squared = closest(a0[:, None], a1[:, None], corners[None, :, 0], corners[None, :, 1])
    edge, rows = squared.argmin(axis=1), np.arange(len(a0))
    part, share = s[rows, edge], t[rows, edge]
    distance = np.sqrt(squared[rows, edge])
    point = corners[edge, 0] + share[:, None] * (corners[edge, 1] - corners[edge, 0])
    for end, at in ((a0, 0.0), (a1, 1.0)):
        height, face = polyhedron.over_faces(end)
        closer = height < distance
        distance, part = np.where(closer, height, distance), np.where(closer, at, part)
        dropped = end - np.where(closer, height, 0.0)[:, None] * polyhedron.normals[face]
        point = np.where(closer[:, None], dropped, point)
    enter, leave = clipped(polyhedron, a0, a1)
    meets = enter <= leave
    middle = 0.5 * (np.maximum(enter, 0.0) + np.minimum(leave, 1.0))
    part = np.where(meets, middle, part)
    point = np.where(meets[:, None], a0 + part[:, None] * (a1 - a0), point)
    return np.where(meets, 0.0, distance), part, point


def clipped(polyhedron: Polyhedron, a0: Vector, a1: Vector) -> tuple[Vector, Vector]:
    """Between which fractions segments (M, 3) are inside a polyhedron; the first is greater if they never are."""
    above0, above1 = polyhedron.above(a0), polyhedron.above(a1)  # (M, F)
    fall = above0 - above1
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = above0 / fall
    enter = np.where(fall > 0.0, crossing, np.where((fall == 0.0) & (above0 > 0.0), np.inf, 0.0)).max(axis=1)
    leave = np.where(fall < 0.0, crossing, 1.0).min(axis=1)
    return np.maximum(enter, 0.0), np.minimum(leave, 1.0)
