"""Disks and convex polygons in the wall plane, many at a time.

A limb on a hold keeps the pelvis's origin inside a disk around the hold; a stance's *body workspace* is where the disks
of its limbs overlap (Gönen 2021, eq. 4.2). All distances in metres, points in W's x-y plane. Disks that touch meet.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from climber.stance import Vector

Mask = NDArray[np.bool_]
TOUCH = 1e-9  # [m] disks that miss each other by less than this touch
CHUNK = 1 << 16  # sets handled at once where the work space is many times the answer


def triangle_fits(a: Vector, b: Vector, c: Vector, radius: float) -> Mask:
    """Whether triangles fit in a circle of `radius`, which is whether equal disks around their corners meet.

    Disks of radius R meet exactly if the smallest circle that encloses their centres has radius at most R, and any
    number of disks meet exactly if every three of them do (Helly).

    Args:
        a: Squared lengths of the first sides [m^2], any shape.
        b: Of the second sides.
        c: Of the third sides.
        radius: Radius R [m].
    """
    limit = (radius + TOUCH) ** 2
    longest = np.maximum(np.maximum(a, b), c)
    obtuse = a + b + c <= 2.0 * longest  # then the longest side is a diameter
    four_areas_squared = 4.0 * a * b - (a + b - c) ** 2  # 16 area^2; circumradius^2 = a b c / (16 area^2)
    result: Mask = (longest <= 4.0 * limit) & (obtuse | (a * b * c <= limit * four_areas_squared))
    return result


def enclosing_squared(a: Vector, b: Vector, c: Vector) -> Vector:
    """Squared radii of the smallest circles around triangles with sides of these squared lengths [m^2]."""
    longest = np.maximum(np.maximum(a, b), c)
    obtuse = a + b + c <= 2.0 * longest
    four_areas_squared = np.where(obtuse, 1.0, 4.0 * a * b - (a + b - c) ** 2)
    result: Vector = np.where(obtuse, longest / 4.0, a * b * c / four_areas_squared)
    return result


def disks_meet(centers: Vector, radii: Vector) -> Mask:
    """Whether the disks of each set have a point in common.

    Args:
        centers: Shape (M, k, 2).
        radii: Shape (k,) or (M, k).

    Returns:
        Shape (M,).
    """
    k = centers.shape[1]
    if np.ptp(radii) > TOUCH or k < 3:
        return ~np.isnan(common_points(centers, radii)[:, 0])
    radius, meet = float(np.min(radii)), np.ones(len(centers), dtype=bool)
    side = {(i, j): ((centers[:, i] - centers[:, j]) ** 2).sum(axis=1) for i, j in combinations(range(k), 2)}
    for a, b, c in combinations(range(k), 3):
        meet &= triangle_fits(side[a, b], side[a, c], side[b, c], radius)
    return meet


def common_points(centers: Vector, radii: Vector) -> Vector:
    """A point of the overlap of each set of disks.

    If disks overlap, then either the centre of one of them or a point where two of their circles cross is in all.

    Args:
        centers: Shape (M, k, 2).
        radii: Shape (k,) or (M, k).

    Returns:
        The deepest of those points, shape (M, 2); NaN where the disks have no common point.
    """
    radii = np.broadcast_to(radii, centers.shape[:2])
    points = np.full((len(centers), 2), np.nan)
    for first in range(0, len(centers), CHUNK):
        p, r = centers[first : first + CHUNK], radii[first : first + CHUNK]
        candidates = [p]
        for i, j in combinations(range(p.shape[1]), 2):
            candidates.append(_crossings(p[:, i], p[:, j], r[:, i], r[:, j]))
        candidate = np.concatenate(candidates, axis=1)  # (chunk, num_candidates, 2)
        distance = np.linalg.norm(candidate[:, :, None] - p[:, None], axis=-1)
        depth = (r[:, None] - distance).min(axis=-1)  # how far inside the worst disk
        best = depth.argmax(axis=1)
        rows = np.arange(len(p))
        inside = depth[rows, best] >= -TOUCH
        points[first : first + CHUNK][inside] = candidate[rows, best][inside]
    return points


def _crossings(p: Vector, q: Vector, r: Vector, s: Vector) -> Vector:
    """Where circles around `p` and `q` (M, 2) of radii `r` and `s` (M,) cross, or pass nearest, shape (M, 2, 2)."""
    between = q - p
    d = np.maximum(np.linalg.norm(between, axis=1), TOUCH)  # circles of one centre do not cross
    along = (d**2 + r**2 - s**2) / (2.0 * d)
    aside = np.sqrt(np.maximum(r**2 - along**2, 0.0))
    u = between / d[:, None]
    foot, normal = p + along[:, None] * u, aside[:, None] * np.stack([-u[:, 1], u[:, 0]], axis=1)
    return np.stack([foot + normal, foot - normal], axis=1)


def overlap_areas(centers: Vector, radii: Vector) -> Vector:
    """Exact area of the overlap of each set of disks.

    The border of the overlap is made of arcs. Every circle is cut where the other circles cross it; the pieces inside
    all other disks are the border, and Green's theorem gives the area, 1/2 of the integral of x dy - y dx along it.

    Args:
        centers: Shape (M, k, 2).
        radii: Shape (k,) or (M, k).

    Returns:
        Areas [m^2], shape (M,); 0 where the disks have no common point.
    """
    radii = np.broadcast_to(radii, centers.shape[:2])
    size = max(1, CHUNK // 8)
    chunks = [_overlap_areas(centers[i : i + size], radii[i : i + size]) for i in range(0, len(centers), size)]
    return np.concatenate(chunks) if chunks else np.zeros(0)


def _overlap_areas(centers: Vector, radii: Vector) -> Vector:
    M, k, _ = centers.shape
    if k < 2:
        whole: Vector = np.pi * radii[:, 0] ** 2 if k else np.full(M, np.inf)
        return whole
    centers = centers - centers.mean(axis=1, keepdims=True)
    areas = np.zeros(M)
    for i in range(k):
        others = [j for j in range(k) if j != i]
        to = centers[:, others] - centers[:, i : i + 1]  # (M, k-1, 2)
        d, r, s = np.hypot(to[..., 0], to[..., 1]), radii[:, i : i + 1], radii[:, others]
        # On circle i, the disk j covers the directions within `half` of the direction to its centre.
        cosine = np.divide(d**2 + r**2 - s**2, 2.0 * d * r, out=np.empty_like(d), where=d > 1e-12)
        same = (s == r) & (np.array(others) > i)  # of coincident circles, the first is the border
        np.copyto(cosine, np.where((s > r) | same, -2.0, 2.0), where=d <= 1e-12)
        direction, half = np.arctan2(to[..., 1], to[..., 0]), np.arccos(np.clip(cosine, -1.0, 1.0))
        cuts = np.sort(np.concatenate([direction - half, direction + half], axis=1) % (2.0 * np.pi), axis=1)
        ends = np.concatenate([cuts[:, 1:], cuts[:, :1] + 2.0 * np.pi], axis=1)  # (M, 2(k-1)) arcs from cuts to ends
        middle = 0.5 * (cuts + ends)
        on_border = (np.cos(middle[:, :, None] - direction[:, None]) >= cosine[:, None]).all(axis=-1)
        x, y = centers[:, i, :1], centers[:, i, 1:]
        twice = r * (ends - cuts) + x * (np.sin(ends) - np.sin(cuts)) - y * (np.cos(ends) - np.cos(cuts))
        areas += 0.5 * (r * np.where(on_border, twice, 0.0)).sum(axis=1)
    return areas


def counter_clockwise(points: Vector) -> tuple[NDArray[np.int64], Mask]:
    """The counter-clockwise order of points around their polygon, and whether the polygon is strictly convex.

    For four points this is the thesis's check against leg crossing: eqs. 4.6 are the four turns of the quadrilateral.

    Args:
        points: Shape (M, k, 2).

    Returns:
        Places in the set in counter-clockwise order, place 0 first, shape (M, k), and whether every corner turns
        strictly left, shape (M,). One and two points are always in order.
    """
    M, k, _ = points.shape
    if k < 3:
        return np.tile(np.arange(k), (M, 1)), np.ones(M, dtype=bool)
    x, y = points[..., 0], points[..., 1]
    dx, dy = x[:, 1:] - x[:, :1], y[:, 1:] - y[:, :1]
    # Seen from a corner of a convex polygon the other corners are within a half turn, on both sides of their mean.
    # Sorted so, the path sweeps less than one turn around that corner, and left turns only make it convex.
    mx, my = dx.sum(axis=1, keepdims=True), dy.sum(axis=1, keepdims=True)
    angles = np.arctan2(mx * dy - my * dx, mx * dx + my * dy)
    order = np.zeros((M, k), dtype=np.int64)
    order[:, 1:] = angles.argsort(axis=1) + 1
    x, y = np.take_along_axis(x, order, axis=1), np.take_along_axis(y, order, axis=1)
    convex = np.ones(M, dtype=bool)
    for a in range(k):
        b, c = (a + 1) % k, (a + 2) % k
        turn = (x[:, b] - x[:, a]) * (y[:, c] - y[:, a]) - (y[:, b] - y[:, a]) * (x[:, c] - x[:, a])
        convex &= turn > 0.0
    return order, convex


def disks_meet_region(centers: Vector, radii: Vector, region: BaseGeometry) -> Mask:
    """Whether the overlap of each set of disks has a point in common with a region.

    The overlap is convex, so if it meets the region then either it crosses the region's border or all of it, one of its
    points for instance, is inside. Along a segment of the border each disk is an interval.

    Args:
        centers: Shape (M, k, 2).
        radii: Shape (k,).
        region: Points, lines, polygons in W's x-y plane [m].

    Returns:
        Shape (M,).
    """
    witness = common_points(centers, radii)
    inside = shapely.intersects_xy(region, witness[:, 0], witness[:, 1])  # False where there is no witness
    meets: Mask = np.asarray(inside, dtype=bool)
    for start, end in _segments(region):
        open_sets = np.flatnonzero(~meets & ~np.isnan(witness[:, 0]))
        from_center, along = start - centers[open_sets], end - start  # (num_open, k, 2), (2,)
        a, b = along @ along, from_center @ along
        c = (from_center**2).sum(axis=-1) - (radii + TOUCH) ** 2
        if a == 0.0:
            meets[open_sets] = (c <= 0.0).all(axis=1)
            continue
        root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
        crosses = (b**2 >= a * c).all(axis=1)
        enter, leave = ((-b - root) / a).max(axis=1), ((-b + root) / a).min(axis=1)
        meets[open_sets] = crosses & (np.maximum(enter, 0.0) <= np.minimum(leave, 1.0))
    return meets


def _segments(region: BaseGeometry) -> Vector:
    """The segments of a region's lines and borders; a point is a segment of no length. Shape (num_segments, 2, 2)."""
    parts = shapely.get_parts(shapely.get_parts(region))
    rings = shapely.get_rings(parts)
    lines = [*rings, *parts[shapely.get_type_id(parts) < 3]]
    segments = []
    for line in lines:
        xy = shapely.get_coordinates(line)
        segments.append(np.stack([xy[: max(1, len(xy) - 1)], xy[min(1, len(xy) - 1) :]], axis=1))
    return np.concatenate(segments) if segments else np.zeros((0, 2, 2))
