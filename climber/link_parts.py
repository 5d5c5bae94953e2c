"""Collision shapes of links in space, as thick segments and convex polyhedra."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Mesh, Shape, Sphere
from pydrake.math import RigidTransform

from climber.exceptions import ModelError
from climber.polyhedron import Polyhedron
from climber.solids import Cylinder as Round
from climber.stance import Vector

DECIMALS = 9  # to which corners of shapes are rounded [m]

Thick = tuple[Vector, Vector, float]  # both ends of a segment [m], shape (3,) each, and the thickness around it [m]


def parts(shapes: Sequence[tuple[Shape, RigidTransform]], what: str) -> tuple[list[Thick], list[Polyhedron]]:
    """Collision shapes of a body as thick segments and as polyhedra, in the link's frame."""
    thick: list[Thick] = []
    corners: list[Vector] = []
    for shape, pose in shapes:
        if isinstance(shape, Sphere):
            thick.append((pose.translation(), pose.translation(), shape.radius()))
        elif isinstance(shape, Capsule):
            half = np.array([0.0, 0.0, shape.length() / 2])
            thick.append((pose.multiply(-half), pose.multiply(half), shape.radius()))
        elif isinstance(shape, Box | Cylinder | Convex | Mesh):
            corners.append(np.array([pose.multiply(corner) for corner in _corners(shape)]))
        else:
            raise ModelError(f"{what}: clearance in space knows no collision shape {type(shape).__name__}")
    return thick, [Polyhedron.of(points) for points in _merged(corners)]


def _corners(shape: Box | Cylinder | Convex | Mesh) -> Vector:
    """Corners of the shape, of a prism about it if it is round, in its own frame [m], shape (n, 3)."""
    if isinstance(shape, Box):
        signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
        result: Vector = signs * shape.size()
        return result
    if isinstance(shape, Cylinder):
        upright = Round((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), shape.radius(), shape.length())
        return upright.polyhedron.corners
    hull = shape.GetConvexHull()
    return np.array([hull.vertex(i) for i in range(hull.num_vertices())])


def _merged(bodies: list[Vector]) -> list[Vector]:
    """Corners of convex bodies; of all together if their union is convex, as it is of three boxes that make a hexagon.

    That is told for upright prisms between the same heights only.
    """
    bodies = [np.unique(corners.round(DECIMALS), axis=0) for corners in bodies]
    if len(bodies) < 2 or len({tuple(np.unique(corners[:, 2])) for corners in bodies}) > 1:
        return bodies
    if len(np.unique(bodies[0][:, 2])) != 2:
        return bodies
    flat = [shapely.MultiPoint(corners[:, :2]).convex_hull for corners in bodies]
    upright = all(2 * len(np.unique(corners[:, :2], axis=0)) == len(corners) for corners in bodies)
    union, whole = shapely.union_all(flat), shapely.MultiPoint(np.vstack(bodies)[:, :2]).convex_hull
    if upright and union.area > (1.0 - 1e-6) * whole.area:
        return [np.unique(np.vstack(bodies), axis=0)]
    return bodies
