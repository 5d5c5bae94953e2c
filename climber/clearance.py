"""Clearance between links, pelvis and obstacles of a planar robot, for many configurations at a time.

Drake's narrow phase is awkward for shapes that all lie in one plane (penetrating capsules come back with normals out of
the plane, mirror-symmetric poses are a hundred times slower), so planning measures distances between segments of the
plane. `verify` does not use this module: it asks Drake.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Mesh, SceneGraph, SceneGraphInspector, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from climber.exceptions import ModelError
from climber.kinematics import Kinematics, Pose
from climber.stance import Vector


@dataclass(frozen=True)
class Outline:
    """What a link occupies in the plane: segments, each thickened by a radius.

    Attributes:
        start: First ends of the segments in the link's frame [m], shape (S, 3).
        end: Second ends of the segments in the link's frame [m], shape (S, 3).
        radius: Thickness around each segment [m], shape (S,).
    """

    start: Vector
    end: Vector
    radius: Vector


def _flat(shape: Shape, pose: RigidTransform, what: str) -> tuple[list[tuple[Vector, Vector, float]], Vector | None]:
    """A collision shape as thick segments, or as the corners of a convex body, in the link's frame."""
    if isinstance(shape, Sphere):
        return [(pose.translation(), pose.translation(), shape.radius())], None
    if isinstance(shape, Capsule | Cylinder):
        half = np.array([0.0, 0.0, shape.length() / 2])
        if isinstance(shape, Cylinder) and abs(pose.rotation().matrix()[2, 2]) > 0.999:  # seen end on: a disk
            half = np.zeros(3)
        return [(pose.multiply(-half), pose.multiply(half), shape.radius())], None
    if isinstance(shape, Box):
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return [], np.array([pose.multiply(corner) for corner in signs * shape.size() / 2])
    if isinstance(shape, Convex | Mesh):
        hull = shape.GetConvexHull()
        return [], np.array([pose.multiply(hull.vertex(i)) for i in range(hull.num_vertices())])
    raise ModelError(f"{what}: no planar outline is known for the collision shape {type(shape).__name__}")


def _outline(inspector: SceneGraphInspector, geometries: list[tuple[object, RigidTransform]], what: str) -> Outline:
    segments: list[tuple[Vector, Vector, float]] = []
    polygons = []
    for geometry, pose in geometries:
        thick, corners = _flat(inspector.GetShape(geometry), pose, what)
        segments += thick
        if corners is not None:
            polygons.append(shapely.MultiPoint(corners[:, :2]).convex_hull)
    # Boxes that overlap (three make a hexagon) are one body: only the outline of their union can be touched.
    for part in shapely.get_parts(shapely.unary_union(polygons)) if polygons else ():
        ring = np.asarray(shapely.simplify(part, 1e-9).exterior.coords)
        ring = np.column_stack([ring, np.zeros(len(ring))])
        segments += [(a, b, 0.0) for a, b in zip(ring[:-1], ring[1:], strict=True)]
    starts, ends, radii = zip(*segments, strict=True) if segments else ((), (), ())
    return Outline(np.array(starts).reshape(-1, 3), np.array(ends).reshape(-1, 3), np.array(radii, dtype=float))


def outlines(kinematics: Kinematics) -> tuple[list[Outline], list[tuple[int, int]]]:
    """Each moving link's outline, and the pairs of links that the model does not filter from collision.

    Pairs are places in `kinematics.links`, smaller first.
    """
    robot = kinematics.robot
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    robot.model.add_to(plant, scene_graph)
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    place: dict[BodyIndex, int] = {}
    result = []
    for i, name in enumerate(kinematics.links):
        link = plant.GetBodyByName(name)
        geometries = []
        for body in plant.GetBodiesWeldedTo(link):
            place[body.index()] = i
            to_body = plant.CalcRelativeTransform(context, link.body_frame(), body.body_frame())
            for geometry in plant.GetCollisionGeometriesForBody(body):
                geometries.append((geometry, to_body @ inspector.GetPoseInFrame(geometry)))
        result.append(_outline(inspector, geometries, f"{robot.model.path}: {name}"))
    pairs = set()
    for a, b in inspector.GetCollisionCandidates():
        bodies = [plant.GetBodyFromFrameId(inspector.GetFrameId(g)) for g in (a, b)]
        if all(body.index() in place for body in bodies):
            i, j = sorted(place[body.index()] for body in bodies)
            pairs.add((i, j))
    return result, sorted(pairs)


def segment_distance(a0: Vector, a1: Vector, b0: Vector, b1: Vector) -> Vector:
    """Distance between segments of the plane [m]; arrays broadcast, the last axis is (x, y)."""
    u, v, w = a1 - a0, b1 - b0, b0 - a0

    def cross(p: Vector, q: Vector) -> Vector:
        result: Vector = p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]
        return result

    def to_segment(from_start: Vector, along: Vector) -> Vector:
        length = np.einsum("...i,...i->...", along, along)
        s = np.clip(np.einsum("...i,...i->...", from_start, along) / np.maximum(length, 1e-18), 0.0, 1.0)
        rest = from_start - s[..., None] * along
        result: Vector = np.einsum("...i,...i->...", rest, rest)
        return result

    squared = np.minimum(
        np.minimum(to_segment(w, u), to_segment(w + v, u)), np.minimum(to_segment(-w, v), to_segment(u - w, v))
    )
    # They cross when each one's ends lie on both sides of the other.
    crossing = (cross(u, w) * cross(u, w + v) < 0) & (cross(v, -w) * cross(v, u - w) < 0)
    result: Vector = np.where(crossing, 0.0, np.sqrt(squared))
    return result


class Clearance:
    """Distances of a planar robot from itself and from obstacles.

    Attributes:
        pairs: The link pairs watched, as places in `Kinematics.links`.
    """

    def __init__(self, kinematics: Kinematics, obstacles: tuple[shapely.geometry.base.BaseGeometry, ...] = ()) -> None:
        self._outlines, self.pairs = outlines(kinematics)
        self._obstacles = shapely.union_all(obstacles) if obstacles else None
        # Flatten the links' segments into one list, and the pairs of links into pairs of segments.
        counts = [len(outline.radius) for outline in self._outlines]
        self.first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self.radius = np.concatenate([outline.radius for outline in self._outlines])
        chosen = [
            (a, b)
            for i, j in self.pairs
            for a in range(self.first[i], self.first[i + 1])
            for b in range(self.first[j], self.first[j + 1])
        ]
        self._a: NDArray[np.int64] = np.array([a for a, _ in chosen], dtype=np.int64)
        self._b: NDArray[np.int64] = np.array([b for _, b in chosen], dtype=np.int64)

    def segments(self, link: int, pose: Pose) -> tuple[Vector, Vector]:
        """Both ends of a link's segments in the plane [m], shapes (K, S, 2)."""
        outline = self._outlines[link]
        rotation = np.swapaxes(pose.rotation, 1, 2)
        origin = pose.origin[:, None, :]
        return (outline.start @ rotation + origin)[..., :2], (outline.end @ rotation + origin)[..., :2]

    def radii(self, link: int) -> Vector:
        """Thickness of the link's segments [m], shape (S,)."""
        return self._outlines[link].radius

    def to_obstacles(self, start: Vector, end: Vector, radius: Vector) -> Vector:
        """Distance of thick segments (..., S, 2) to the nearest obstacle [m], shape (...)."""
        if self._obstacles is None:
            return np.full(start.shape[:-2], np.inf)
        lines = shapely.linestrings(np.stack([start, end], axis=-2))
        result: Vector = (shapely.distance(lines, self._obstacles) - radius).min(axis=-1)
        return result

    def __call__(self, poses: list[Pose]) -> Vector:
        """Least distance between watched links, and to obstacles [m], shape (K,).

        Where shapes overlap the value is negative but is not a penetration depth.
        """
        ends = [self.segments(i, pose) for i, pose in enumerate(poses)]
        start = np.concatenate([s for s, _ in ends], axis=1)
        end = np.concatenate([e for _, e in ends], axis=1)
        result = np.full(len(start), np.inf)
        if len(self._a):
            gap = segment_distance(start[:, self._a], end[:, self._a], start[:, self._b], end[:, self._b])
            result = (gap - self.radius[self._a] - self.radius[self._b]).min(axis=1)
        if self._obstacles is not None:
            result = np.minimum(result, self.to_obstacles(start, end, self.radius))
        return result
