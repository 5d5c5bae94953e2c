"""What a wall is made of in space: the pieces of its surface, and solids that stand on it. All are convex.

Distances are exact and zero inside. A region of a scenario is one of these or a polygon of the wall plane, which for a
robot in space stands for everything in front of and behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import shapely
from pydrake.geometry import Box as DrakeBox
from pydrake.geometry import Convex as DrakeConvex
from pydrake.geometry import Cylinder as DrakeCylinder
from pydrake.geometry import Shape
from pydrake.geometry import Sphere as DrakeSphere
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from shapely.geometry import MultiPoint, Point, Polygon
from shapely.geometry.base import BaseGeometry

from climber.polyhedron import Polyhedron
from climber.stance import Vector

Triple = tuple[float, float, float]
SIDES = 32  # of the prism that stands for a cylinder where a polyhedron is needed


@dataclass(frozen=True)
class Sphere:
    """A ball.

    Attributes:
        center: In W [m].
        radius: [m].
    """

    center: Triple
    radius: float

    def distance(self, points: Vector) -> Vector:
        """Distance of points (..., 3) in W [m]; zero inside. Shape (...)."""
        away = np.linalg.norm(np.asarray(points) - self.center, axis=-1)
        result: Vector = np.maximum(away - self.radius, 0.0)
        return result

    def outline(self) -> Polygon:
        """A polygon of the wall plane that contains the projection onto it."""
        return Point(self.center[:2]).buffer(self.radius / np.cos(np.pi / 64), quad_segs=16)

    def drake(self) -> tuple[Shape, RigidTransform]:
        """Drake's shape, and its pose in W."""
        return DrakeSphere(self.radius), RigidTransform(np.array(self.center))

    @property
    def extremes(self) -> Vector:
        """Two points that span a box around it [m], shape (2, 3)."""
        return np.array(self.center) + self.radius * np.array([[-1.0], [1.0]])


class _Cornered:
    """What solids have in common that a polyhedron can stand for."""

    @property
    def polyhedron(self) -> Polyhedron:
        """A polyhedron that contains it, and is equal to it if it is one."""
        raise NotImplementedError

    def outline(self) -> Polygon:
        """A polygon of the wall plane that contains the projection onto it."""
        return MultiPoint(self.polyhedron.corners[:, :2]).convex_hull

    @property
    def extremes(self) -> Vector:
        """Two points that span a box around it [m], shape (2, 3)."""
        corners = self.polyhedron.corners
        return np.array([corners.min(axis=0), corners.max(axis=0)])


@dataclass(frozen=True)
class Box(_Cornered):
    """A box.

    Attributes:
        center: In W [m].
        size: Along its own axes [m].
        rpy: Roll, pitch and yaw that turn W's axes into its own [rad].
    """

    center: Triple
    size: Triple
    rpy: Triple = (0.0, 0.0, 0.0)

    @cached_property
    def _rotation(self) -> Vector:
        return np.asarray(RollPitchYaw(np.array(self.rpy)).ToRotationMatrix().matrix())

    @cached_property
    def polyhedron(self) -> Polyhedron:
        """The box as a polyhedron."""
        signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
        return Polyhedron.of(signs * self.size @ self._rotation.T + self.center)

    def distance(self, points: Vector) -> Vector:
        """Distance of points (..., 3) in W [m]; zero inside. Shape (...)."""
        inner = np.abs((np.asarray(points) - self.center) @ self._rotation) - np.array(self.size) / 2
        result: Vector = np.linalg.norm(np.maximum(inner, 0.0), axis=-1)
        return result

    def drake(self) -> tuple[Shape, RigidTransform]:
        """Drake's shape, and its pose in W."""
        return DrakeBox(np.array(self.size)), RigidTransform(RollPitchYaw(np.array(self.rpy)), np.array(self.center))


@dataclass(frozen=True)
class Cylinder(_Cornered):
    """A cylinder.

    Attributes:
        center: In W [m].
        axis: Its unit axis in W.
        radius: [m].
        length: Along the axis [m].
    """

    center: Triple
    axis: Triple
    radius: float
    length: float

    @cached_property
    def polyhedron(self) -> Polyhedron:
        """A prism about the cylinder."""
        angles = 2 * np.pi * np.arange(SIDES) / SIDES
        ring = self.radius / np.cos(np.pi / SIDES) * np.column_stack([np.cos(angles), np.sin(angles)])
        corners = np.vstack([np.column_stack([ring, np.full(SIDES, z)]) for z in (-self.length / 2, self.length / 2)])
        return Polyhedron.of(corners @ self._pose.rotation().matrix().T + self.center)

    @cached_property
    def _pose(self) -> RigidTransform:
        return RigidTransform(RotationMatrix.MakeFromOneVector(np.array(self.axis), 2), np.array(self.center))

    def distance(self, points: Vector) -> Vector:
        """Distance of points (..., 3) in W [m]; zero inside. Shape (...)."""
        off = np.asarray(points) - self.center
        along = off @ np.array(self.axis)
        across = np.linalg.norm(off - along[..., None] * np.array(self.axis), axis=-1)
        result: Vector = np.hypot(
            np.maximum(across - self.radius, 0.0), np.maximum(np.abs(along) - self.length / 2, 0.0)
        )
        return result

    def drake(self) -> tuple[Shape, RigidTransform]:
        """Drake's shape, and its pose in W."""
        return DrakeCylinder(self.radius, self.length), self._pose


@dataclass(frozen=True)
class Convex(_Cornered):
    """The convex hull of some points.

    Attributes:
        vertices: The points in W [m], not all in one plane.
    """

    vertices: tuple[Triple, ...]

    @cached_property
    def polyhedron(self) -> Polyhedron:
        """The hull as a polyhedron."""
        return Polyhedron.of(np.array(self.vertices))

    def distance(self, points: Vector) -> Vector:
        """Distance of points (..., 3) in W [m]; zero inside. Shape (...)."""
        return self.polyhedron.distance(np.asarray(points, dtype=float))

    def drake(self) -> tuple[Shape, RigidTransform]:
        """Drake's shape, and its pose in W."""
        return DrakeConvex(points=self.polyhedron.corners.T, label="convex"), RigidTransform()


Solid = Sphere | Box | Cylinder | Convex
Region: TypeAlias = BaseGeometry | Solid  # where something is to come to lie, or keep out of


@dataclass(frozen=True)
class Facet:
    """A flat piece of the wall's surface, with rock behind it.

    Attributes:
        corners: Of a convex polygon in W [m], counter-clockwise as seen from outside.
        thickness: How far the rock goes back behind it [m].
    """

    corners: tuple[Triple, ...]
    thickness: float = 0.3

    @cached_property
    def normal(self) -> Vector:
        """Unit outward normal in W, shape (3,)."""
        return newell(np.array(self.corners))

    @cached_property
    def solid(self) -> Convex:
        """The rock."""
        front = np.array(self.corners)
        every = np.vstack([front, front - self.thickness * self.normal])
        return Convex(tuple((float(x), float(y), float(z)) for x, y, z in every))

    def distance(self, points: Vector) -> Vector:
        """Distance of points (..., 3) in W from the surface, front and back alike [m]; shape (...)."""
        points, corners = np.asarray(points, dtype=float), np.array(self.corners)
        off = points[..., None, :] - corners
        along = np.roll(corners, -1, axis=0) - corners
        height = off[..., 0, :] @ self.normal
        within = ((np.cross(self.normal, along) * off).sum(axis=-1) >= 0.0).all(axis=-1)
        share = np.clip((off * along).sum(axis=-1) / (along**2).sum(axis=-1), 0.0, 1.0)
        to_edges = np.linalg.norm(off - share[..., None] * along, axis=-1).min(axis=-1)
        result: Vector = np.where(within, np.abs(height), to_edges)
        return result


def newell(corners: Vector) -> Vector:
    """Unit normal of a polygon in space, shape (n, 3), about which it goes counter-clockwise (Newell's method).

    Zero for corners on one line.
    """
    normal = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
    length = float(np.linalg.norm(normal))
    result: Vector = normal / length if length > 0.0 else normal
    return result


def away(region: Region, points: Vector) -> Vector:
    """Distance of points from a region [m], zero inside.

    Args:
        region: A solid, or a shape of the wall plane, of which only x and y of the points matter.
        points: In W [m], shape (..., 3); (..., 2) will do for a shape of the wall plane.
    """
    if isinstance(region, BaseGeometry):
        result: Vector = shapely.distance(region, shapely.points(np.asarray(points)[..., :2]))
        return result
    solid: Solid = region
    return solid.distance(points)


def triple(values: Sequence[float]) -> Triple:
    """Three numbers as a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z
