"""Distances between the links, the pelvis and the obstacles of a plan, measured by Drake's SceneGraph.

The planner measures distances between segments of the wall plane; here the collision geometry of the model itself is
measured in space, so that no outline of the planner's is taken on trust. Drake is quick enough for every instant of a
plan as long as only near pairs are asked for (20 us an instant, against 70 us for all pairs). Obstacles and
avoided regions are added to the world as convex prisms across the wall plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from pydrake.geometry import Convex, GeometryId, SignedDistancePair
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry.base import BaseGeometry

from climber.robot import Model
from climber.stance import Vector

FAR = 0.02  # [m] pairs farther apart than this are not measured
OBSTACLE_DEPTH = 1.0  # [m] thickness of the prisms, half of it on either side of the wall plane
NUDGES = (0.0, 1e-8, -1e-8, 1e-7, -1e-7)  # [rad, m] tried in turn when Drake's narrow phase gives up


@dataclass(frozen=True)
class Nearest:
    """The nearest pair at one instant.

    Attributes:
        distance: Signed distance [m]; `FAR` if no pair is nearer, NaN if Drake could not tell.
        pair: The two by name.
    """

    distance: float
    pair: str


class Clearance:
    """Signed distances within a robot and from it to obstacles, one configuration at a time."""

    def __init__(self, model: Model, regions: Sequence[tuple[str, BaseGeometry]]) -> None:
        """Sets up the geometry.

        Args:
            model: The robot's model.
            regions: Names and outlines of what the robot may not touch.
        """
        builder = DiagramBuilder()
        self._plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        model.add_to(self._plant, scene_graph)
        self._obstacles: dict[GeometryId, str] = {}
        for name, region in regions:
            for piece, corners in enumerate(convex_pieces(region)):
                geometry = self._plant.RegisterCollisionGeometry(
                    self._plant.world_body(),
                    RigidTransform(),
                    _prism(corners),
                    f"{name}, piece {piece}",
                    CoulombFriction(0.0, 0.0),
                )
                self._obstacles[geometry] = name
        self._plant.Finalize()
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = self._plant.GetMyMutableContextFromRoot(self._root)
        self._query = self._plant.get_geometry_query_input_port()
        self._inspector = scene_graph.model_inspector()

    def nearest(self, q: Vector) -> tuple[Nearest, Nearest]:
        """The nearest pair within the robot, and the nearest link and obstacle, at positions `q` (nq,)."""
        own = outside = None
        pairs = self._pairs(q)
        if pairs is None:
            lost = Nearest(np.nan, "Drake cannot measure a pair here")
            return lost, lost
        for pair in pairs:
            if pair.id_A in self._obstacles or pair.id_B in self._obstacles:
                if outside is None or pair.distance < outside.distance:
                    outside = pair
            elif own is None or pair.distance < own.distance:
                own = pair
        return self._named(own), self._named(outside)

    def _pairs(self, q: Vector) -> list[SignedDistancePair] | None:
        """All pairs nearer than `FAR`, or None where FCL throws, as it can for coplanar shapes that penetrate."""
        for nudge in NUDGES:
            self._plant.SetPositions(self._context, q + nudge * np.arange(len(q)) / len(q))
            try:
                pairs: list[SignedDistancePair] = self._query.Eval(
                    self._context
                ).ComputeSignedDistancePairwiseClosestPoints(FAR)
            except RuntimeError:
                continue
            return pairs
        return None

    def _named(self, pair: SignedDistancePair | None) -> Nearest:
        if pair is None:
            return Nearest(FAR, f"no pair is nearer than {1000 * FAR:g} mm")
        return Nearest(pair.distance, f"{self._name(pair.id_A)} and {self._name(pair.id_B)}")

    def _name(self, geometry: GeometryId) -> str:
        if geometry in self._obstacles:
            return self._obstacles[geometry]
        return str(self._plant.GetBodyFromFrameId(self._inspector.GetFrameId(geometry)).name())


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
