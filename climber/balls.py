"""Balls in space, and disks in a plane, many sets of them at a time: do they meet, and in how much of it.

A limb on a hold keeps the pelvis's origin inside a ball around the hold; for a planar robot inside a disk. What
`climber.geometry` has for disks is used where it will do: three balls meet exactly if the disks do that they cut out of
the plane through their centres. In space four by four decide (Helly). All distances in metres; balls that touch meet.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from climber.geometry import (
    CHUNK,
    TOUCH,
    Mask,
    common_points,
    disks_meet,
    disks_meet_region,
    enclosing_squared,
    overlap_areas,
)
from climber.solids import Region, Solid, Sphere
from climber.stance import Vector

FLAT = 1e-9  # [m] points nearer to a plane than this lie in it
NODES = 10  # at which the cross-section of an overlap is taken to integrate it
SLICES = 48  # the same for four balls and more, whose centres are in no plane


def is_flat(points: Vector) -> bool:
    """Whether points (H, d) lie in one plane."""
    if points.shape[1] < 3 or len(points) < 4:
        return True
    return bool(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] < FLAT)


def tetrahedra_fit(corners: Vector, radius: float) -> Mask:
    """Whether tetrahedra fit in a ball of `radius`, if all their faces do.

    The smallest ball around four points touches all of them only if its centre is inside the tetrahedron; else it is
    the smallest ball around some three. With a, b, c the edges from one corner and D = a . (b x c), the centre is at
    o / (2 D) from it with o = |a|^2 b x c + |b|^2 c x a + |c|^2 a x b, and its barycentric coordinates are
    o . (b x c) / (2 D^2) and so on.

    Args:
        corners: Shape (M, 4, 3).
        radius: [m].

    Returns:
        Shape (M,).
    """
    a, b, c = (corners[:, i] - corners[:, 0] for i in (1, 2, 3))
    bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    twice = 2.0 * (a * bc).sum(axis=1)
    o = (
        (a * a).sum(axis=1)[:, None] * bc + (b * b).sum(axis=1)[:, None] * ca + (c * c).sum(axis=1)[:, None] * ab
    )  # (M, 3)
    limit = 0.5 * twice**2  # what the coordinates are to add up to no more than
    shares = np.stack([(o * x).sum(axis=1) for x in (bc, ca, ab)])
    inside = (shares > 0.0).all(axis=0) & (shares.sum(axis=0) < limit)
    result: Mask = ~inside | ((o * o).sum(axis=1) <= (radius + TOUCH) ** 2 * twice**2)
    return result


def balls_meet(centers: Vector, radii: Vector) -> Mask:
    """Whether the balls of each set have a point in common.

    Args:
        centers: Shape (M, k, 3); (M, k, 2) for disks.
        radii: Shape (k,) or (M, k).

    Returns:
        Shape (M,).
    """
    if centers.shape[2] == 2:
        return disks_meet(centers, radii)
    if np.ptp(radii) > TOUCH:
        return ~np.isnan(shared_points(centers, radii)[:, 0])
    meet = disks_meet(centers, radii) if centers.shape[1] > 2 else _pairs_meet(centers, radii)
    for four in combinations(range(centers.shape[1]), 4):
        rows = np.flatnonzero(meet)
        meet[rows] = tetrahedra_fit(centers[rows][:, four], float(np.min(radii)))
    return meet


def _pairs_meet(centers: Vector, radii: Vector) -> Mask:
    """Whether one or two balls of one radius meet."""
    apart = np.linalg.norm(centers - centers[:, :1], axis=2).max(axis=1)
    result: Mask = apart <= 2.0 * (float(np.min(radii)) + TOUCH)
    return result


def shared_points(centers: Vector, radii: Vector) -> Vector:
    """A point of the overlap of each set of balls.

    The point of an overlap with the least x is where one sphere, the circle of two or the two points of three have it.

    Args:
        centers: Shape (M, k, 3); (M, k, 2) for disks.
        radii: Shape (k,) or (M, k).

    Returns:
        The deepest of those points, shape (M, d); NaN where the balls have no common point.
    """
    if centers.shape[2] == 2:
        return common_points(centers, radii)
    radii = np.broadcast_to(radii, centers.shape[:2])
    points = np.full((len(centers), 3), np.nan)
    for first in range(0, len(centers), CHUNK // 4):
        p, r = centers[first : first + CHUNK // 4], radii[first : first + CHUNK // 4]
        k = p.shape[1]
        candidates = [p, p - r[..., None] * np.array([1.0, 0.0, 0.0])]
        for i, j in combinations(range(k), 2):
            candidates.append(_circle_points(p[:, i], p[:, j], r[:, i], r[:, j]))
        for i, j, m in combinations(range(k), 3):
            candidates.append(_triple_points(p[:, [i, j, m]], r[:, [i, j, m]]))
        candidate = np.concatenate(candidates, axis=1)  # (chunk, num_candidates, 3)
        distance = np.linalg.norm(candidate[:, :, None] - p[:, None], axis=-1)
        depth = np.nan_to_num((r[:, None] - distance).min(axis=-1), nan=-np.inf)  # how far inside the worst ball
        best, rows = depth.argmax(axis=1), np.arange(len(p))
        inside = depth[rows, best] >= -TOUCH
        points[first : first + CHUNK // 4][inside] = candidate[rows, best][inside]
    return points


def _circle_points(p: Vector, q: Vector, r: Vector, s: Vector) -> Vector:
    """Of the circles in which spheres around `p` and `q` (M, 3) cross, the middles and the points of least x."""
    between = q - p
    d = np.maximum(np.linalg.norm(between, axis=1), TOUCH)
    u = between / d[:, None]
    along = (d**2 + r**2 - s**2) / (2.0 * d)
    middle = p + along[:, None] * u
    toward = np.array([-1.0, 0.0, 0.0]) + u[:, :1] * u  # -x, less its part along the axis
    length = np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), TOUCH)
    leftmost = middle + np.sqrt(np.maximum(r**2 - along**2, 0.0))[:, None] * toward / length
    return np.stack([middle, leftmost], axis=1)


def _triple_points(p: Vector, r: Vector) -> Vector:
    """The two points, or the nearest to them, where three spheres (M, 3, 3) of radii (M, 3) cross; (M, 2, 3)."""
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    normal = np.cross(a, b)
    square = (normal**2).sum(axis=1, keepdims=True)
    alpha = 0.5 * ((a**2).sum(axis=1) + r[:, 0] ** 2 - r[:, 1] ** 2)[:, None]  # x . a of what x is from the first
    beta = 0.5 * ((b**2).sum(axis=1) + r[:, 0] ** 2 - r[:, 2] ** 2)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        foot = (alpha * np.cross(b, normal) + beta * np.cross(normal, a)) / square
        height = np.sqrt(np.maximum(r[:, :1] ** 2 - (foot**2).sum(axis=1, keepdims=True), 0.0))
        aside = height * normal / np.sqrt(square)
    crossing: Vector = p[:, :1] + np.stack([foot + aside, foot - aside], axis=1)
    return crossing


def overlap_measures(centers: Vector, radii: Vector) -> Vector:
    """Volume of the overlap of each set of balls; area of that of disks, exactly.

    The centres of up to three balls lie in a plane; at a distance h from it they cut disks of radii sqrt(r^2 - h^2) out
    of its parallels, and those overlap up to some h_max. With h = h_max sin(t) the area is smooth enough for Gauss's
    rule to come within a thousandth. Of four and more balls parallel slices are summed up, which comes within a
    hundredth of all but the smallest.

    Args:
        centers: Shape (M, k, 3); (M, k, 2) for disks.
        radii: Shape (k,) or (M, k).

    Returns:
        Volumes [m^3] or areas [m^2], shape (M,); 0 where there is no overlap.
    """
    if centers.shape[2] == 2:
        return overlap_areas(centers, radii)
    radii = np.broadcast_to(radii, centers.shape[:2])
    if not centers.size:
        return np.full(len(centers), np.inf)
    if centers.shape[1] > 3:
        return _sliced(centers, radii)
    flat = _flattened(centers)
    highest = _highest(flat, radii)
    node, weight = np.polynomial.legendre.leggauss(NODES)
    turn = 0.25 * np.pi * (node + 1.0)
    volume = np.zeros(len(centers))
    for t, w in zip(turn, weight, strict=True):
        height = highest * np.sin(t)
        cut = np.sqrt(np.maximum(radii**2 - height[:, None] ** 2, 0.0))
        volume += 2.0 * 0.25 * np.pi * w * np.cos(t) * highest * overlap_areas(flat, cut)
    return volume


def _flattened(centers: Vector) -> Vector:
    """Up to three points in space (M, k, 3) as points of their plane, (M, k, 2)."""
    M, k, _ = centers.shape
    flat = np.zeros((M, k, 2))
    if k > 1:
        along = centers[:, 1] - centers[:, 0]
        length = np.linalg.norm(along, axis=1)
        flat[:, 1, 0] = length
    if k > 2:
        off = centers[:, 2] - centers[:, 0]
        part = (off * along).sum(axis=1) / np.maximum(length, TOUCH)
        flat[:, 2, 0] = part
        flat[:, 2, 1] = np.sqrt(np.maximum((off**2).sum(axis=1) - part**2, 0.0))
    return flat


def _highest(flat: Vector, radii: Vector) -> Vector:
    """How far from the plane of their centres (M, k, 2) balls overlap [m], shape (M,)."""
    if np.ptp(radii) <= TOUCH:
        sides = [((flat[:, i] - flat[:, j]) ** 2).sum(axis=1) for i, j in combinations(range(flat.shape[1]), 2)]
        enclosing = enclosing_squared(*sides) if len(sides) == 3 else sides[0] / 4.0 if sides else np.zeros(len(flat))
        height: Vector = np.sqrt(np.maximum(radii[:, 0] ** 2 - enclosing, 0.0))
        return height
    low, high = np.zeros(len(flat)), radii.min(axis=1)
    met = ~np.isnan(common_points(flat, radii)[:, 0])
    for _ in range(40):
        middle = 0.5 * (low + high)
        meets = ~np.isnan(common_points(flat, np.sqrt(np.maximum(radii**2 - middle[:, None] ** 2, 0.0)))[:, 0])
        low, high = np.where(meets, middle, low), np.where(meets, high, middle)
    return np.where(met, high, 0.0)


def _sliced(centers: Vector, radii: Vector) -> Vector:
    """Volumes of overlaps by the midpoint rule along z."""
    z = centers[..., 2]
    low, high = (z - radii).max(axis=1), (z + radii).min(axis=1)
    step = np.maximum(high - low, 0.0) / SLICES
    volume = np.zeros(len(centers))
    for slice_ in range(SLICES):
        off = (low + (slice_ + 0.5) * step)[:, None] - z
        cut = np.sqrt(np.maximum(radii**2 - off**2, 0.0))
        volume += step * overlap_areas(centers[..., :2], cut)
    return volume


def balls_meet_region(centers: Vector, radii: Vector, region: Region) -> Mask:
    """Whether the overlap of each set of balls may have a point in common with a region.

    Exactly so for disks and a region of their plane, and for balls and a ball. For other regions this is relaxed: of
    balls and a region of the wall plane the projections onto it meet, of balls and another solid a ball around it
    serves, and every ball by itself comes up to the solid.

    Args:
        centers: Shape (M, k, 3); (M, k, 2) for disks.
        radii: Shape (k,).
        region: A shape of the wall plane, or a solid.

    Returns:
        Shape (M,).
    """
    if isinstance(region, BaseGeometry):
        return disks_meet_region(centers[..., :2], radii, region)
    solid: Solid = region
    meets = np.asarray((solid.distance(centers) <= radii + TOUCH).all(axis=1))
    center, radius = (np.array(solid.center), solid.radius) if isinstance(solid, Sphere) else solid.polyhedron.ball
    rows = np.flatnonzero(meets)
    around = np.broadcast_to(center, (len(rows), 1, 3))
    every = np.concatenate([centers[rows], around], axis=1)
    meets[rows] = balls_meet(every, np.append(radii, radius))
    return meets


def quads_fit(positions: Vector, quad: tuple[NDArray[np.integer], ...], radius: float) -> Mask:
    """`tetrahedra_fit` of sets of four points, given as four arrays of numbers (N,)."""
    result = np.ones(len(quad[0]), dtype=bool)
    for first in range(0, len(result), CHUNK):
        rows = slice(first, first + CHUNK)
        result[rows] = tetrahedra_fit(positions[np.stack([corner[rows] for corner in quad], axis=1)], radius)
    return result
