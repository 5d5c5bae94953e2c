"""Links of robots in space where they are in many configurations, and distances between some of their shapes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climber.kinematics import Pose
from climber.nearest import clipped, segment_to_polyhedron
from climber.polyhedron import Polyhedron
from climber.robot import Indices
from climber.stance import Vector

Points = Callable[[Indices, Indices], tuple[Vector, Vector]]  # closest points, (M, 3) each, of some entries of a block


@dataclass(frozen=True)
class Hull:
    """A convex collision shape in its link's frame; its edges are among the segments."""

    link: int
    body: int
    shape: Polyhedron


@dataclass(frozen=True)
class Placed:
    """Links in W: their poses, and both ends of all segments [m], (K, S, 3) each."""

    poses: list[Pose]
    start: Vector
    end: Vector

    def within(self, hull: Hull, points: Vector, rows: Indices) -> Vector:
        """Points in W (M, ..., 3) of some configurations (M,), in the frame of a hull's link."""
        pose = self.poses[hull.link]
        shift = points - pose.origin[rows].reshape(-1, *[1] * (points.ndim - 2), 3)
        result: Vector = np.einsum("m...i,mij->m...j", shift, pose.rotation[rows])
        return result

    def out(self, hull: Hull, points: Vector, rows: Indices) -> Vector:
        """Points (M, 3) in the frame of a hull's link, in W."""
        pose = self.poses[hull.link]
        result: Vector = np.einsum("mij,mj->mi", pose.rotation[rows], points) + pose.origin[rows]
        return result


@dataclass(frozen=True)
class Block:
    """Distances of some pairs of shapes.

    Attributes:
        kind: As in `climber.clearance_space.Nearby`, shape (m,).
        links: As in `climber.clearance_space.Nearby`, shape (m, 2).
        distance: [m], shape (K, m).
        points: What finds the closest points of entries of `distance`.
    """

    kind: Indices
    links: Indices
    distance: Vector
    points: Points


def edges_to(polyhedron: Polyhedron, a0: Vector, a1: Vector) -> tuple[Vector, Vector, Vector]:
    """Least distance of edges (M, E, 3) from a polyhedron [m], (M,), and the closest points, (M, 3) each."""
    M, E, _ = a0.shape
    gap, part, point = (
        x.reshape(M, E, -1) for x in segment_to_polyhedron(polyhedron, a0.reshape(-1, 3), a1.reshape(-1, 3))
    )
    best, rows = gap[..., 0].argmin(axis=1), np.arange(M)
    on_edge = a0[rows, best] + part[rows, best] * (a1 - a0)[rows, best]
    return gap[rows, best, 0], on_edge, point[rows, best]


def solid_over(polyhedron: Polyhedron, corners: Vector, edges: Indices) -> tuple[Vector, Vector, Vector]:
    """How far a solid's corners are straight above a face of a polyhedron; zero where its corners or edges are inside.

    Args:
        polyhedron: The polyhedron.
        corners: Of the solid, in M places [m], shape (M, V, 3).
        edges: Corners at both ends of each of the solid's edges, shape (E, 2).

    Returns:
        Heights [m], infinite where no corner is above a face and nothing inside, (M,), and the closest points of the
        polyhedron and of the solid, (M, 3) each.
    """
    height, face = polyhedron.over_faces(corners)
    best, rows = height.argmin(axis=1), np.arange(len(corners))
    height, face, upper = height[rows, best], face[rows, best], corners[rows, best]
    lower = upper - np.where(np.isfinite(height), height, 0.0)[:, None] * polyhedron.normals[face]
    out = np.flatnonzero(height > 0.0)
    if len(out) and len(edges):
        # A pole that goes through has its corners on either side of the polyhedron.
        a0, a1 = (corners[out][:, edges[:, end]] for end in (0, 1))
        enter, leave = (x.reshape(a0.shape[:2]) for x in clipped(polyhedron, a0.reshape(-1, 3), a1.reshape(-1, 3)))
        edge, through = (leave - enter).argmax(axis=1), np.flatnonzero((leave >= enter).any(axis=1))
        at = through, edge[through]
        height[out[through]] = 0.0
        inside = a0[at] + 0.5 * (enter[at] + leave[at])[:, None] * (a1[at] - a0[at])
        upper[out[through]] = lower[out[through]] = inside
    return height, lower, upper
