"""Distances between the links, the pelvis and the obstacles of a plan, measured twice.

`Outlines` is exact: a planar robot touches itself or an obstacle where their outlines in the wall plane do, and
shapely measures outlines for whole arrays of postures. `DrakeClearance` asks Drake's SceneGraph, whose signed distances
are good to some hundredths of a millimetre for pairs like ours and never too small (in 12,000 random postures of the
quadruped two capsules less than 1 mm apart came out up to 0.05 mm too far), so it cannot be the only judge; it is there
to catch an outline that is not what the model says. `verify` uses the first at every instant and the second at samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    GeometryId,
    Mesh,
    Role,
    SceneGraphInspector,
    Shape,
    SignedDistancePair,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry import MultiPoint
from shapely.geometry.base import BaseGeometry

from climber.exceptions import ModelError
from climber.robot import Robot
from climber.stance import Vector
from climber.verify_model import Poses

FAR = 0.02  # [m] pairs farther apart than this are not measured
OBSTACLE_DEPTH = 1.0  # [m] thickness of the prisms that Drake has for obstacles, half of it on either side of the wall
NUDGES = (0.0, 1e-8, -1e-8, 1e-7, -1e-7)  # [rad, m] tried in turn when Drake's narrow phase gives up
Regions = Sequence[tuple[str, BaseGeometry]]


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
    scene = _Scene(robot, ())
    return [scene.outline(geometry) for geometry in scene.geometries()]


class Outlines:
    """Exact distances between the parts of a planar robot, and from them to regions of the wall plane."""

    def __init__(self, robot: Robot, regions: Regions) -> None:
        scene = _Scene(robot, ())
        numbers = {geometry: number for number, geometry in enumerate(scene.geometries())}
        self._outlines = [scene.outline(geometry) for geometry in numbers]
        self._pairs = []
        for i, j in scene.candidates():
            a, b = self._outlines[numbers[i]], self._outlines[numbers[j]]
            if a.extent[0] < b.extent[1] and b.extent[0] < a.extent[1]:
                self._pairs.append((numbers[i], numbers[j]))
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
            found = shapely.distance(a.shapes(near), b.shapes(near)) - a.outline.radius - b.outline.radius
            within.values[near, column] = np.minimum(found, FAR)
            within.pairs.append(f"{a.outline.name} and {b.outline.name}")
        outside = Distances(np.full((count, len(placed) * len(self._regions)), FAR), [])
        for name, region in self._regions:
            circle, reach = shapely.minimum_bounding_circle(region).centroid, shapely.minimum_bounding_radius(region)
            for part in placed:
                apart = np.linalg.norm(part.middle - [circle.x, circle.y], axis=1) - part.outline.size - reach
                near = np.flatnonzero(apart < FAR)
                found = shapely.distance(part.shapes(near), region) - part.outline.radius
                outside.values[near, len(outside.pairs)] = np.minimum(found, FAR)
                outside.pairs.append(f"{part.outline.name} and {name}")
        return within, outside


class DrakeClearance:
    """Drake's signed distances within a robot and from it to regions, one posture at a time."""

    def __init__(self, robot: Robot, regions: Regions) -> None:
        self._scene = _Scene(robot, regions)

    def nearest(self, q: Vector) -> tuple[tuple[float, str], tuple[float, str]]:
        """The nearest pair within the robot, and the nearest of a link and a region, at positions `q` (nq,).

        Returns:
            For both, the signed distance [m], at most `FAR` and NaN if Drake cannot tell, and the pair's names.
        """
        best = [(FAR, "by Drake"), (FAR, "by Drake")]
        pairs = self._pairs(q)
        if pairs is None:
            return (np.nan, "not measurable by Drake"), (np.nan, "not measurable by Drake")
        for pair in pairs:
            which = 1 if pair.id_A in self._scene.regions or pair.id_B in self._scene.regions else 0
            if pair.distance < best[which][0]:
                names = f"{self._scene.name(pair.id_A)} and {self._scene.name(pair.id_B)}"
                best[which] = pair.distance, f"{names}, by Drake"
        return best[0], best[1]

    def _pairs(self, q: Vector) -> list[SignedDistancePair] | None:
        """All pairs nearer than `FAR`, or None where FCL throws, as it can for coplanar shapes that penetrate."""
        for nudge in NUDGES:
            try:
                return self._scene.distances(q + nudge * np.arange(len(q)) / len(q))
            except RuntimeError:
                continue
        return None


class _Scene:
    """A robot in a plant with a scene graph of its own, with regions as convex prisms across the wall plane."""

    def __init__(self, robot: Robot, regions: Regions) -> None:
        self._robot = robot
        builder = DiagramBuilder()
        self._plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        robot.model.add_to(self._plant, scene_graph)
        self.regions: dict[GeometryId, str] = {}
        for name, region in regions:
            for piece, corners in enumerate(convex_pieces(region)):
                geometry = self._plant.RegisterCollisionGeometry(
                    self._plant.world_body(),
                    RigidTransform(),
                    _prism(corners),
                    f"{name}, piece {piece}",
                    CoulombFriction(0.0, 0.0),
                )
                self.regions[geometry] = name
        self._plant.Finalize()
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = self._plant.GetMyMutableContextFromRoot(self._root)
        self._query = self._plant.get_geometry_query_input_port()
        self._inspector: SceneGraphInspector = scene_graph.model_inspector()

    def geometries(self) -> list[GeometryId]:
        """The robot's collision geometries."""
        found = [g for g in self._inspector.GetAllGeometryIds(Role.kProximity) if g not in self.regions]
        return sorted(found, key=lambda geometry: int(geometry.get_value()))

    def candidates(self) -> list[tuple[GeometryId, GeometryId]]:
        """The pairs that the model does not exempt from collision."""
        pairs = [(a, b) for a, b in self._inspector.GetCollisionCandidates()]
        return sorted(pairs, key=lambda pair: (int(pair[0].get_value()), int(pair[1].get_value())))

    def distances(self, q: Vector) -> list[SignedDistancePair]:
        """Signed distances of all pairs nearer than `FAR` at positions `q` (nq,)."""
        self._plant.SetPositions(self._context, q)
        query = self._query.Eval(self._context)
        pairs: list[SignedDistancePair] = query.ComputeSignedDistancePairwiseClosestPoints(FAR)
        return pairs

    def name(self, geometry: GeometryId) -> str:
        """The region or the body that a geometry belongs to."""
        if geometry in self.regions:
            return self.regions[geometry]
        return str(self._plant.GetBodyFromFrameId(self._inspector.GetFrameId(geometry)).name())

    def outline(self, geometry: GeometryId) -> Outline:
        """The outline of one of the robot's geometries."""
        shape, name = self._inspector.GetShape(geometry), self.name(geometry)
        body = self._robot.plant.GetBodyByName(name)
        X_WB = body.EvalPoseInWorld(self._robot.context())
        X_WG = X_WB.multiply(self._inspector.GetPoseInFrame(geometry))
        points, radius = _core(shape, X_WG, f"{self._robot.model.path}: {name}")
        hull = MultiPoint(points[:, :2]).convex_hull
        ring = np.asarray(hull.exterior.coords[:-1] if hull.geom_type == "Polygon" else hull.coords)
        X_BW = X_WB.inverse()
        # The base turns about z, so that the height a corner is given does not matter.
        corners = np.array([X_BW.multiply(np.array([x, y, 0.0])) for x, y in ring])
        middle = corners.mean(axis=0)
        size = float(np.linalg.norm(corners - middle, axis=1).max()) + radius
        extent = float(points[:, 2].min() - radius), float(points[:, 2].max() + radius)
        return Outline(int(body.index()), name, corners, radius, extent, middle, size)


def _core(shape: Shape, X_WG: RigidTransform, what: str) -> tuple[Vector, float]:
    """Points (n, 3) in W [m] and a radius [m] such that the shape is the thickened convex hull of the points."""
    radius = 0.0
    if isinstance(shape, Sphere):
        points, radius = np.zeros((1, 3)), shape.radius()
    elif isinstance(shape, Capsule):
        points, radius = np.array([[0.0, 0.0, z * shape.length() / 2] for z in (-1, 1)]), shape.radius()
    elif isinstance(shape, Cylinder):
        # A prism of many sides about it, which overstates it by less than two thousandths of its radius.
        around = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
        ring = shape.radius() / np.cos(np.pi / 64) * np.column_stack([np.cos(around), np.sin(around)])
        points = np.array([[x, y, z * shape.length() / 2] for x, y in ring for z in (-1, 1)])
    elif isinstance(shape, Box):
        points = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * shape.size() / 2
    elif isinstance(shape, Mesh | Convex):
        hull = shape.GetConvexHull()
        points = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    else:
        raise ModelError(f"{what}: verify does not know the outline of a {type(shape).__name__}")
    return np.asarray(X_WG.multiply(points.T)).T, radius


def convex_pieces(region: BaseGeometry) -> list[Vector]:
    """Corners [m], shape (n, 2), of convex polygons that together cover a region exactly."""
    if region.is_empty:
        return []
    if region.geom_type != "Polygon":
        return [corners for part in region.geoms for corners in convex_pieces(part)]
    if region.convex_hull.equals(region):
        return [np.asarray(region.exterior.coords)[:-1]]
    triangles = shapely.constrained_delaunay_triangles(region).geoms
    return [np.asarray(triangle.exterior.coords)[:-1] for triangle in triangles]


def _prism(corners: Vector) -> Convex:
    """A polygon of the wall plane (n, 2) extruded across it."""
    half = np.full((len(corners), 1), OBSTACLE_DEPTH / 2)
    points = np.vstack([np.hstack([corners, half]), np.hstack([corners, -half])])
    return Convex(points=points.T, label="obstacle")
