"""Distances between the links, the pelvis and the obstacles of a plan for a planar robot.

`Outlines` is exact: a planar robot touches itself or an obstacle where their outlines in the wall plane do, and
shapely measures outlines for whole arrays of postures. `verify` uses it at every instant, and Drake (`verify_scene`) at
samples. Robots in space are measured by `verify_space`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from shapely.geometry import MultiPoint
from shapely.geometry.base import BaseGeometry

from climber.robot import Robot
from climber.stance import Vector
from climber.verify_model import Poses
from climber.verify_scene import FAR, Part, Scene, gap


@dataclass(frozen=True)
class Outline:
    """What a collision shape covers of the wall plane: a point, a segment or a convex polygon, thickened.

    Attributes:
        body: Index of the body it moves with.
        name: The body's name.
        corners: The corners in order, in the body's frame [m], shape (k, 3).
        radius: Thickness around them [m].
        extent: Least and greatest z in W [m], which a planar robot does not change.
        middle: A point amid the corners, in the body's frame [m], shape (3,).
        size: How far the shape reaches from its middle [m].
    """

    body: int
    name: str
    corners: Vector
    radius: float
    extent: tuple[float, float]
    middle: Vector
    size: float

    def place(self, poses: Poses) -> Placed:
        """Where the outline is at each posture."""
        points = np.vstack([self.middle, self.corners])
        at = points @ np.swapaxes(poses.rotation[self.body], 1, 2) + poses.origin[self.body][:, None]
        return Placed(self, at[:, 0, :2], at[:, 1:, :2])


@dataclass(frozen=True)
class Placed:
    """An outline at K postures.

    Attributes:
        outline: The outline.
        middle: Its middle in the wall plane [m], shape (K, 2).
        corners: Its corners in the wall plane [m], shape (K, k, 2).
    """

    outline: Outline
    middle: Vector
    corners: Vector

    def shapes(self, which: NDArray[np.int64]) -> NDArray[np.object_]:
        """The outlines without their thickness at the postures `which`, shape (len(which),)."""
        corners = self.corners[which]
        if corners.shape[1] == 1:
            return np.asarray(shapely.points(corners[:, 0]), dtype=object)
        make = shapely.linestrings if corners.shape[1] == 2 else shapely.polygons
        return np.asarray(make(corners), dtype=object)


@dataclass(frozen=True)
class Distances:
    """Distances of pairs at K postures.

    Attributes:
        values: [m], at most `FAR`; where thin parts cross, minus their thickness, shape (K, num_pairs).
        pairs: The two of each pair by name.
    """

    values: Vector
    pairs: list[str]


def outlines(robot: Robot) -> list[Outline]:
    """The outlines of a robot's collision shapes."""
    return [_outline(robot, part) for part in Scene(robot, ()).parts()]


class Outlines:
    """Exact distances between the parts of a planar robot, and from them to regions of the wall plane."""

    def __init__(self, robot: Robot, regions: Sequence[tuple[str, BaseGeometry]]) -> None:
        scene = Scene(robot, ())
        self._outlines = [_outline(robot, part) for part in scene.parts()]
        self._pairs = []
        for i, j in scene.candidates():
            a, b = self._outlines[i], self._outlines[j]
            if a.extent[0] < b.extent[1] and b.extent[0] < a.extent[1]:
                self._pairs.append((i, j))
        self._regions = regions

    def measure(self, poses: Poses) -> tuple[Distances, Distances]:
        """Distances within the robot, and from its parts to the regions."""
        placed = [outline.place(poses) for outline in self._outlines]
        count = poses.origin.shape[1]
        within = Distances(np.full((count, len(self._pairs)), FAR), [])
        for column, (i, j) in enumerate(self._pairs):
            a, b = placed[i], placed[j]
            apart = np.linalg.norm(a.middle - b.middle, axis=1) - a.outline.size - b.outline.size
            near = np.flatnonzero(apart < FAR)
            found = gap(shapely.distance(a.shapes(near), b.shapes(near)), a.outline.radius + b.outline.radius)
            within.values[near, column] = np.minimum(found, FAR)
            within.pairs.append(f"{a.outline.name} and {b.outline.name}")
        outside = Distances(np.full((count, len(placed) * len(self._regions)), FAR), [])
        for name, region in self._regions:
            circle, reach = shapely.minimum_bounding_circle(region).centroid, shapely.minimum_bounding_radius(region)
            for part in placed:
                apart = np.linalg.norm(part.middle - [circle.x, circle.y], axis=1) - part.outline.size - reach
                near = np.flatnonzero(apart < FAR)
                found = gap(shapely.distance(part.shapes(near), region), part.outline.radius)
                outside.values[near, len(outside.pairs)] = np.minimum(found, FAR)
                outside.pairs.append(f"{part.outline.name} and {name}")
        return within, outside


def _outline(robot: Robot, part: Part) -> Outline:
    """What a part of a planar robot covers of the wall plane."""
    body = robot.plant.GetBodyByName(part.name)
    X_WB: RigidTransform = body.EvalPoseInWorld(robot.context())
    points = np.asarray(X_WB.multiply(part.corners.T)).T
    hull = MultiPoint(points[:, :2]).convex_hull
    ring = np.asarray(hull.exterior.coords[:-1] if hull.geom_type == "Polygon" else hull.coords)
    X_BW = X_WB.inverse()
    # The base turns about z, so that the height a corner is given does not matter.
    corners = np.array([X_BW.multiply(np.array([x, y, 0.0])) for x, y in ring])
    middle = corners.mean(axis=0)
    size = float(np.linalg.norm(corners - middle, axis=1).max()) + part.radius
    extent = float(points[:, 2].min() - part.radius), float(points[:, 2].max() + part.radius)
    return Outline(part.body, part.name, corners, part.radius, extent, middle, size)
