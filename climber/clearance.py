"""Clearance between links, pelvis and obstacles of a planar robot, for many configurations at a time.

Drake's narrow phase is awkward for shapes that all lie in one plane (penetrating capsules come back with normals out of
the plane, mirror-symmetric poses are a hundred times slower), so planning measures distances between segments of the
plane. `verify` does not use this module: it asks Drake.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Mesh, SceneGraph, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from shapely.geometry.base import BaseGeometry

from climber.exceptions import ModelError
from climber.kinematics import Kinematics, Pose
from climber.stance import Vector

# Collision shapes of a link's bodies, by the body's index, with their poses in the link's frame.
Bodies = dict[int, list[tuple[Shape, RigidTransform]]]


@dataclass(frozen=True)
class Outline:
    """What a link occupies in the plane: segments, each thickened by a radius, and what closed rings of them enclose.

    It contains the projection of the link's collision shapes into the plane. It is equal to it but for cylinders not
    seen end on, which get round ends like capsules, and for holes, which count as filled.

    Attributes:
        start: First ends of the segments in the link's frame [m], shape (S, 3).
        end: Second ends of the segments in the link's frame [m], shape (S, 3).
        radius: Thickness around each segment [m], shape (S,).
        body: Index of the body each segment belongs to, the link or one that is fixed to it, shape (S,).
        rings: Places of the segments, all of thickness zero, that enclose each polygon.
    """

    start: Vector
    end: Vector
    radius: Vector
    body: NDArray[np.int64]
    rings: tuple[range, ...]

    def polygon(self, ring: range) -> shapely.Polygon:
        """What a ring encloses, in the link's frame [m]."""
        return shapely.Polygon(self.start[ring.start : ring.stop, :2])


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


def _outline(bodies: Bodies, what: str) -> Outline:
    """The outline of a link."""
    segments: list[tuple[Vector, Vector, float, int]] = []
    rings = []
    for body, geometries in bodies.items():
        polygons = []
        for shape, pose in geometries:
            thick, corners = _flat(shape, pose, what)
            segments += [(start, end, radius, body) for start, end, radius in thick]
            if corners is not None:
                polygons.append(shapely.MultiPoint(corners[:, :2]).convex_hull)
        # Boxes that overlap (three make a hexagon) are one: only the outline of their union can be touched.
        for part in shapely.get_parts(shapely.unary_union(polygons)) if polygons else ():
            ring = np.asarray(shapely.simplify(part, 1e-9).exterior.coords)
            ring = np.column_stack([ring, np.zeros(len(ring))])
            rings.append(range(len(segments), len(segments) + len(ring) - 1))
            segments += [(a, b, 0.0, body) for a, b in itertools.pairwise(ring)]
    starts, ends, radii, owners = zip(*segments, strict=True) if segments else ((), (), (), ())
    return Outline(
        np.array(starts).reshape(-1, 3),
        np.array(ends).reshape(-1, 3),
        np.array(radii, dtype=float),
        np.array(owners, dtype=np.int64),
        tuple(rings),
    )


def link_shapes(kinematics: Kinematics) -> tuple[list[Bodies], set[tuple[int, int]]]:
    """Each moving link's collision shapes, and the pairs of bodies, both ways round, that the model does not filter."""
    robot = kinematics.robot
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    robot.model.add_to(plant, scene_graph)
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    result = []
    for name in kinematics.links:
        link = plant.GetBodyByName(name)
        bodies: Bodies = {}
        for body in plant.GetBodiesWeldedTo(link):
            to_body = plant.CalcRelativeTransform(context, link.body_frame(), body.body_frame())
            bodies[int(body.index())] = [
                # A copy: shapes that belong to the scene graph end with it.
                (inspector.GetShape(geometry).Clone(), to_body @ inspector.GetPoseInFrame(geometry))
                for geometry in plant.GetCollisionGeometriesForBody(body)
            ]
        result.append(bodies)
    watched = set()
    for geometries in inspector.GetCollisionCandidates():
        i, j = (int(plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)).index()) for geometry in geometries)
        watched |= {(i, j), (j, i)}
    return result, watched


def outlines(kinematics: Kinematics) -> tuple[list[Outline], set[tuple[int, int]]]:
    """Each moving link's outline, and the pairs of bodies, both ways round, that the model does not filter."""
    shapes, watched = link_shapes(kinematics)
    path = kinematics.robot.model.path
    return [_outline(b, f"{path}: {name}") for b, name in zip(shapes, kinematics.links, strict=True)], watched


def segment_distance(a0: Vector, a1: Vector, b0: Vector, b1: Vector) -> Vector:
    """Distance between segments of the plane [m]; arrays broadcast, the last axis is (x, y)."""
    # Coordinate by coordinate: sums over an axis of two cost three times as much.
    ux, uy = a1[..., 0] - a0[..., 0], a1[..., 1] - a0[..., 1]
    vx, vy = b1[..., 0] - b0[..., 0], b1[..., 1] - b0[..., 1]
    wx, wy = b0[..., 0] - a0[..., 0], b0[..., 1] - a0[..., 1]

    def to_segment(from_x: Vector, from_y: Vector, x: Vector, y: Vector) -> Vector:
        """Squared distance of a point from a segment (x, y), the point given from its start."""
        share = np.minimum(np.maximum((from_x * x + from_y * y) / np.maximum(x * x + y * y, 1e-18), 0.0), 1.0)
        off_x, off_y = from_x - share * x, from_y - share * y
        result: Vector = off_x * off_x + off_y * off_y
        return result

    far_x, far_y, near_x, near_y = wx + vx, wy + vy, ux - wx, uy - wy
    squared = np.minimum(
        np.minimum(to_segment(wx, wy, ux, uy), to_segment(far_x, far_y, ux, uy)),
        np.minimum(to_segment(-wx, -wy, vx, vy), to_segment(near_x, near_y, vx, vy)),
    )
    # They cross when each one's ends lie on both sides of the other.
    crossing = ((ux * wy - uy * wx) * (ux * far_y - uy * far_x) < 0) & (
        (vy * wx - vx * wy) * (vx * near_y - vy * near_x) < 0
    )
    result: Vector = np.where(crossing, 0.0, np.sqrt(squared))
    return result


def inside(point: Vector, start: Vector, end: Vector) -> NDArray[np.bool_]:
    """Whether points (..., 2) lie in the rings whose segments run from `start` to `end`, (..., E, 2); shape (...)."""
    point = point[..., None, :]
    upwards = end[..., 1] > start[..., 1]
    across = (start[..., 1] > point[..., 1]) != (end[..., 1] > point[..., 1])
    along, to = end - start, point - start
    left = along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0] > 0
    # A ray towards +x leaves the ring once more often than it enters it.
    crossed: NDArray[np.bool_] = (across & (left == upwards)).sum(axis=-1) % 2 == 1
    return crossed


def _diameter(points: Vector) -> float:
    """Greatest distance between any two of the points (N, 2) [m]."""
    return float(np.linalg.norm(points[:, None] - points[None], axis=2).max())


class Clearance:
    """Distances of a planar robot from itself and from obstacles.

    Attributes:
        pairs: The link pairs of which any bodies are watched, as places in `Kinematics.links`.
        first: Where each link's segments start among all segments, and their number at the end.
        radius: Thickness of every segment [m].
        one: First segment of every pair of segments watched, shape (P,).
        two: Second segment of every pair of segments watched, shape (P,).
    """

    def __init__(self, kinematics: Kinematics, obstacles: tuple[BaseGeometry, ...] = ()) -> None:
        self._outlines, watched = outlines(kinematics)
        self._obstacles = shapely.union_all(obstacles) if obstacles else None
        # Flatten the links' segments into one list, and the pairs of links into pairs of segments.
        self.first = np.cumsum([0, *(len(outline.radius) for outline in self._outlines)])
        self.radius = np.concatenate([outline.radius for outline in self._outlines])
        # Each segment's link, and both its ends in that one's frame [m], shape (S, 3, 2).
        self._link = np.repeat(np.arange(len(self._outlines)), np.diff(self.first))
        self._ends = np.concatenate([np.stack([o.start, o.end], axis=2) for o in self._outlines])
        body = np.concatenate([outline.body for outline in self._outlines])
        chosen = np.array(
            [
                (i, j, a, b)
                for i, j in itertools.combinations(range(len(self._outlines)), 2)
                for a in range(self.first[i], self.first[i + 1])
                for b in range(self.first[j], self.first[j + 1])
                if (body[a], body[b]) in watched
            ],
            dtype=np.int64,
        ).reshape(-1, 4)
        self.pairs = sorted({(int(i), int(j)) for i, j in chosen[:, :2]})
        self.one, self.two = chosen[:, 2], chosen[:, 3]
        self._small = [
            small
            for i, j in self.pairs
            for small in (*self._enclosable(i, j, watched), *self._enclosable(j, i, watched))
        ]
        self._marks = self._obstacle_marks()

    def _enclosable(self, i: int, j: int, watched: set[tuple[int, int]]) -> list[tuple[slice, int]]:
        """Shapes of link j that some ring of link i has room for: the ring, and a segment to look for inside it.

        What lies wholly inside a ring does not come near its segments, and distances between segments do not tell.
        """
        one, two = self._outlines[i], self._outlines[j]
        result = []
        for ring in one.rings:
            polygon = one.polygon(ring)
            closed = [(r.start, polygon, _diameter(two.start[r.start : r.stop, :2])) for r in two.rings]
            thick = [
                (k, polygon.buffer(-two.radius[k]), float(np.linalg.norm((two.end - two.start)[k, :2])))
                for k in set(range(len(two.radius))).difference(*two.rings)
            ]
            for k, room, length in thick + closed:
                apart = (one.body[ring.start], two.body[k]) in watched
                if apart and not room.is_empty and length <= _diameter(shapely.get_coordinates(room)):
                    result.append((self._place(i, ring), int(self.first[j]) + k))
        return result

    def _obstacle_marks(self) -> list[tuple[slice, Vector]]:
        """Rings, and points of the obstacles that they have room for."""
        result = []
        parts = shapely.get_parts(self._obstacles) if self._obstacles is not None else ()
        for i, outline in enumerate(self._outlines):
            for ring in outline.rings:
                size = _diameter(outline.start[ring.start : ring.stop, :2])
                small = [part for part in parts if _diameter(shapely.get_coordinates(part.convex_hull)) <= size]
                for part in small:
                    result.append((self._place(i, ring), shapely.get_coordinates(part.representative_point())[0]))
        return result

    def _place(self, link: int, ring: range) -> slice:
        """Where a link's ring is among all segments."""
        return slice(int(self.first[link]) + ring.start, int(self.first[link]) + ring.stop)

    def segments(self, link: int, pose: Pose) -> tuple[Vector, Vector]:
        """Both ends of a link's segments in the plane [m], shapes (K, S, 2)."""
        outline = self._outlines[link]
        rotation = np.swapaxes(pose.rotation, 1, 2)
        origin = pose.origin[:, None, :]
        return (outline.start @ rotation + origin)[..., :2], (outline.end @ rotation + origin)[..., :2]

    def radii(self, link: int) -> Vector:
        """Thickness of the link's segments [m], shape (S,)."""
        return self._outlines[link].radius

    def rings(self, link: int) -> tuple[range, ...]:
        """Places of the segments, among the link's, that enclose each polygon."""
        return self._outlines[link].rings

    def to_obstacles(self, start: Vector, end: Vector, radius: Vector) -> Vector:
        """Distance of thick segments (..., S, 2) to the nearest obstacle [m], shape (...)."""
        if self._obstacles is None:
            return np.full(start.shape[:-2], np.inf)
        lines = shapely.linestrings(np.stack([start, end], axis=-2))
        result: Vector = (shapely.distance(lines, self._obstacles) - radius).min(axis=-1, initial=np.inf)
        return result

    def ends(self, poses: list[Pose]) -> tuple[Vector, Vector]:
        """Both ends of all links' segments in the plane [m], shapes (K, S, 2)."""
        origin = np.stack([pose.origin[:, :2] for pose in poses], axis=1)[:, self._link]
        ends = np.stack([pose.rotation[:, :2] for pose in poses], axis=1)[:, self._link] @ self._ends
        return ends[..., 0] + origin, ends[..., 1] + origin

    def __call__(self, poses: list[Pose]) -> Vector:
        """Least distance between watched links, and to obstacles [m], shape (K,).

        Where shapes overlap the value is not above zero, but is no penetration depth.
        """
        start, end = self.ends(poses)
        result = np.full(len(start), np.inf)
        if len(self.one):
            gap = segment_distance(start[:, self.one], end[:, self.one], start[:, self.two], end[:, self.two])
            result = (gap - self.radius[self.one] - self.radius[self.two]).min(axis=1)
        if self._obstacles is not None:
            result = np.minimum(result, self.to_obstacles(start, end, self.radius))
        for ring, k in self._small:
            within = inside(start[:, k], start[:, ring], end[:, ring])
            result[within] = -np.abs(result[within])
        for ring, mark in self._marks:
            within = inside(mark, start[:, ring], end[:, ring])
            result[within] = -np.abs(result[within])
        return result
