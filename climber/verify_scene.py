"""A robot and what it must keep clear of in a scene graph of Drake's: the shapes, their pairs, and Drake's distances.

Drake's signed distances are never too small but can be too large: two capsules of ours less than 1 mm apart came out up
to 0.05 mm too far in the plane and up to 0.5 mm in space. So Drake cannot be the only judge of a distance; it is there
to catch a shape that is not what the model says. `verify_clearance` and `verify_space` measure by themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
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
from shapely.geometry.base import BaseGeometry

from climber.exceptions import ModelError
from climber.robot import Robot
from climber.solids import Solid
from climber.stance import Vector

FAR = 0.02  # [m] pairs farther apart than this are not measured
OBSTACLE_DEPTH = 1.0  # [m] thickness of the prisms that Drake has for planar obstacles, half of it on either side
OVERLAP = 1e-3  # [m] reported for the depth of parts without thickness that meet, which is not measured
EVERYWHERE = 100.0  # [m] the same in space, where such an obstacle is in the way at every height
NUDGES = (0.0, 1e-8, -1e-8, 1e-7, -1e-7)  # [rad, m] tried in turn when Drake's narrow phase gives up
Regions = Sequence[tuple[str, BaseGeometry | Solid]]


@dataclass(frozen=True)
class Part:
    """A collision shape: the convex hull of its corners, thickened.

    Attributes:
        body: Index of the body it moves with, 0 for what stands still in W.
        name: The body's name, or the region's.
        corners: Corners in the body's frame [m], shape (k, 3).
        radius: Thickness around them [m].
    """

    body: int
    name: str
    corners: Vector
    radius: float


class Scene:
    """A robot in a plant with a scene graph of its own, with regions of the wall plane as convex prisms across it."""

    def __init__(self, robot: Robot, regions: Regions) -> None:
        self._robot = robot
        builder = DiagramBuilder()
        self._plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        robot.model.add_to(self._plant, scene_graph)
        self.regions: dict[GeometryId, str] = {}
        for name, region in regions:
            for piece, (shape, X_WG) in enumerate(_shapes(region, OBSTACLE_DEPTH if robot.planar else EVERYWHERE)):
                geometry = self._plant.RegisterCollisionGeometry(
                    self._plant.world_body(), X_WG, shape, f"{name}, piece {piece}", CoulombFriction(0.0, 0.0)
                )
                self.regions[geometry] = name
        self._plant.Finalize()
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = self._plant.GetMyMutableContextFromRoot(self._root)
        self._query = self._plant.get_geometry_query_input_port()
        self._inspector: SceneGraphInspector = scene_graph.model_inspector()
        found = self._inspector.GetAllGeometryIds(Role.kProximity)
        self._geometries = sorted(found, key=lambda geometry: int(geometry.get_value()))

    def parts(self) -> list[Part]:
        """Every shape of the robot and of the regions."""
        return [self._part(geometry) for geometry in self._geometries]

    def candidates(self) -> list[tuple[int, int]]:
        """The pairs of parts, by their places in `parts`, that the model does not exempt from collision."""
        places = {geometry: place for place, geometry in enumerate(self._geometries)}
        pairs = [(places[a], places[b]) for a, b in self._inspector.GetCollisionCandidates()]
        return sorted((min(pair), max(pair)) for pair in pairs)

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

    def _part(self, geometry: GeometryId) -> Part:
        name = self.name(geometry)
        body = self._plant.GetBodyFromFrameId(self._inspector.GetFrameId(geometry))
        X_BG, what = self._inspector.GetPoseInFrame(geometry), f"{self._robot.model.path}: {name}"
        points, radius = _core(self._inspector.GetShape(geometry), what)
        return Part(int(body.index()), name, np.asarray(X_BG.multiply(points.T)).T, radius)


class DrakeClearance:
    """Drake's signed distances within a robot and from it to regions, one posture at a time."""

    def __init__(self, robot: Robot, regions: Regions) -> None:
        self._scene = Scene(robot, regions)

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


def _core(shape: Shape, what: str) -> tuple[Vector, float]:
    """Points (n, 3) in the shape's frame [m] and a radius [m]: the shape is their thickened convex hull."""
    if isinstance(shape, Sphere):
        return np.zeros((1, 3)), shape.radius()
    if isinstance(shape, Capsule):
        return np.array([[0.0, 0.0, z * shape.length() / 2] for z in (-1, 1)]), shape.radius()
    if isinstance(shape, Cylinder):
        # A prism of many sides about it, which overstates it by less than two thousandths of its radius.
        around = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
        ring = shape.radius() / np.cos(np.pi / 64) * np.column_stack([np.cos(around), np.sin(around)])
        return np.array([[x, y, z * shape.length() / 2] for x, y in ring for z in (-1, 1)]), 0.0
    if isinstance(shape, Box):
        return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * shape.size() / 2, 0.0
    if isinstance(shape, Mesh | Convex):
        hull = shape.GetConvexHull()
        return np.array([hull.vertex(i) for i in range(hull.num_vertices())]), 0.0
    raise ModelError(f"{what}: verify does not know the outline of a {type(shape).__name__}")


def _shapes(region: BaseGeometry | Solid, depth: float) -> list[tuple[Shape, RigidTransform]]:
    """A region as convex shapes of Drake's and where they are in W; of the wall plane, prisms of that depth [m]."""
    if isinstance(region, BaseGeometry):
        return [(_prism(corners, depth), RigidTransform()) for corners in convex_pieces(region)]
    return [region.drake()]


def gap(cores: Vector, radius: Vector | float) -> Vector:
    """Distance of parts whose cores are so far apart and so thick together [m]; minus the thickness where they meet."""
    return np.where(cores > 0.0, cores - radius, -np.maximum(radius, OVERLAP))


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


def _prism(corners: Vector, depth: float) -> Convex:
    """A polygon of the wall plane (n, 2) extruded across it."""
    half = np.full((len(corners), 1), depth / 2)
    points = np.vstack([np.hstack([corners, half]), np.hstack([corners, -half])])
    return Convex(points=points.T, label="obstacle")
