"""Clearance between links, pelvis, rock and obstacles of a robot in space, for many configurations at a time.

Links are capsules, balls and convex polyhedra (boxes, meshes, cylinders with flat sides about them), as are rock and
obstacles. Distances are exact where they are less than `NEAR`, and never more than the true ones elsewhere:
bounds by balls and by faces tell most pairs apart. `verify` does not use this module: it asks Drake.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import partial

import numpy as np
import shapely

from climber.clearance import Clearance, link_shapes
from climber.kinematics import Kinematics, Pose
from climber.link_parts import parts
from climber.nearest import closest, least_height, point_to_segment, segment_to_polyhedron
from climber.placed import Block, Hull, Placed, edges_to, solid_over
from climber.robot import Indices
from climber.solids import Solid
from climber.solids import Sphere as Ball
from climber.stance import Vector
from climber.wall import Wall

NEAR = 0.03  # [m] distances less than this are exact
FAR = 1e3  # [m] beyond any wall


@dataclass(frozen=True)
class Nearby:
    """What is near something, at M places.

    Attributes:
        place: Which of the configurations, shape (M,).
        kind: A place in `SpaceClearance.pairs`, or after those the link that is near rock or an obstacle, shape (M,).
        distance: [m], shape (M,).
        links: The links, as places in `Kinematics.links`, shape (M, 2); -1 for rock and obstacles.
        points: The closest points of their axes and polyhedra in W [m], shape (M, 2, 3).
    """

    place: Indices
    kind: Indices
    distance: Vector
    links: Indices
    points: Vector


_NOTHING = Nearby(
    np.zeros(0, dtype=np.int64),
    np.zeros(0, dtype=np.int64),
    np.zeros(0),
    np.zeros((0, 2), dtype=np.int64),
    np.zeros((0, 2, 3)),
)


class SpaceClearance:
    """Distances of a robot in space from itself, from the rock of its wall and from obstacles.

    Attributes:
        pairs: The link pairs of which any bodies are watched, as places in `Kinematics.links`.
        num_kinds: How many pairs and links there are together.
    """

    def __init__(self, kinematics: Kinematics, wall: Wall) -> None:
        links, watched = link_shapes(kinematics)
        self._hulls: list[Hull] = []
        rows: list[tuple[Vector, Vector, float, int, int, int]] = []
        for link, bodies in enumerate(links):
            for body, shapes in bodies.items():
                thick, polyhedra = parts(shapes, f"{kinematics.robot.model.path}: {kinematics.links[link]}")
                rows += [(start, end, radius, link, body, -1) for start, end, radius in thick]
                for polyhedron in polyhedra:
                    edges = polyhedron.corners[polyhedron.edges]
                    rows += [(start, end, 0.0, link, body, len(self._hulls)) for start, end in edges]
                    self._hulls.append(Hull(link, body, polyhedron))
        self._start = np.array([row[0] for row in rows]).reshape(-1, 3)
        self._end = np.array([row[1] for row in rows]).reshape(-1, 3)
        self._radius = np.array([row[2] for row in rows], dtype=float)
        self._link, self._body, hull = np.array([row[3:] for row in rows], dtype=np.int64).reshape(-1, 3).T
        self._thick = np.flatnonzero(hull < 0)
        self._edges = [np.flatnonzero(hull == h) for h in range(len(self._hulls))]
        self._rock = wall.rock
        self._flat = shapely.union_all(wall.obstacles) if wall.obstacles else None
        self._watch(watched)

    def _watch(self, watched: set[tuple[int, int]]) -> None:
        """Lists the pairs of shapes of different links that the model does not filter."""
        link, body = self._link, self._body
        both = [
            (a, b)
            for a, b in itertools.combinations(self._thick.tolist(), 2)
            if link[a] != link[b] and (body[a], body[b]) in watched
        ]
        self._one, self._two = np.array(both, dtype=np.int64).reshape(-1, 2).T
        self._by_hull = [
            np.array(
                [a for a in self._thick if link[a] != hull.link and (hull.body, body[a]) in watched], dtype=np.int64
            )
            for hull in self._hulls
        ]
        self._two_hulls = [
            (g, h)
            for g, h in itertools.combinations(range(len(self._hulls)), 2)
            if self._hulls[g].link != self._hulls[h].link and (self._hulls[g].body, self._hulls[h].body) in watched
        ]
        found = {tuple(sorted(pair)) for pair in zip(link[self._one].tolist(), link[self._two].tolist(), strict=True)}
        for hull, thick in zip(self._hulls, self._by_hull, strict=True):
            found |= {tuple(sorted((hull.link, int(other)))) for other in link[thick]}
        found |= {tuple(sorted((self._hulls[g].link, self._hulls[h].link))) for g, h in self._two_hulls}
        self.pairs = sorted((i, j) for i, j in found)
        self._number = {pair: k for k, pair in enumerate(self.pairs)}
        self.num_kinds = len(self.pairs) + int(link.max(initial=-1)) + 1
        self._of_thick = self._kinds(link[self._one], link[self._two])
        self._of_hull = [
            self._kinds(link[thick], np.array(hull.link))
            for hull, thick in zip(self._hulls, self._by_hull, strict=True)
        ]
        self._outside = self._kinds(link, np.array(-1))
        self._hull_outside = [self._kinds(np.array([hull.link]), np.array(-1)) for hull in self._hulls]

    def __call__(self, poses: list[Pose]) -> Vector:
        """Least distance of watched links from one another, from rock and from obstacles [m], shape (K,).

        Exact where it is less than `NEAR`; not above zero where shapes overlap, but then no penetration depth.
        """
        result = np.full(len(poses[0].origin), np.inf)
        for block in self._blocks(poses, NEAR):
            np.minimum(result, block.distance.min(axis=1, initial=np.inf), out=result)
        return result

    def least(self, poses: list[Pose]) -> Vector:
        """The same kind by kind: watched pairs of links, then each link from rock and obstacles; (K, num_kinds)."""
        result = np.full((len(poses[0].origin), self.num_kinds), np.inf)
        rows = np.arange(len(result))[:, None]
        for block in self._blocks(poses, NEAR):
            np.minimum.at(result, (rows, block.kind), block.distance)
        return result

    def near(self, poses: list[Pose], within: float) -> Nearby:
        """Every two shapes that are nearer than `within` [m] to one another, and where."""
        found = [_NOTHING]
        for block in self._blocks(poses, within):
            place, entry = np.nonzero(block.distance < within)
            points = np.stack(block.points(place, entry), axis=1)
            found.append(Nearby(place, block.kind[entry], block.distance[place, entry], block.links[entry], points))
        names = [field.name for field in fields(Nearby)]
        return Nearby(*(np.concatenate([getattr(part, name) for part in found]) for name in names))

    def _blocks(self, poses: list[Pose], near: float) -> Iterator[Block]:
        """All distances, exact where they are less than `near`, else bounds that are not."""
        rotation, origin = (
            np.stack([getattr(pose, part) for pose in poses], axis=1) for part in ("rotation", "origin")
        )
        rotation, origin = rotation[:, self._link], origin[:, self._link]
        start = np.einsum("ksij,sj->ksi", rotation, self._start) + origin
        end = np.einsum("ksij,sj->ksi", rotation, self._end) + origin
        placed = Placed(poses, start, end)
        if len(self._one):
            yield self._between_thick(placed)
        for h, thick in enumerate(self._by_hull):
            if len(thick):
                yield self._thick_to_hull(placed, h, near)
        for g, h in self._two_hulls:
            yield self._between_hulls(placed, g, h, near)
        for solid in self._rock:
            yield self._to_solid(placed, solid, near)
            for h in range(len(self._hulls)):
                yield self._hull_to_solid(placed, h, solid, near)
        if self._flat is not None:
            yield self._to_flat(placed)
            yield from self._around_flat(placed)

    def _kinds(self, one: Indices, two: Indices) -> tuple[Indices, Indices]:
        """`kind` and `links` of pairs of links, both or only the first of shape (m,)."""
        two = np.broadcast_to(two, one.shape)
        kind = [
            self._number[(min(i, j), max(i, j))] if j >= 0 else len(self.pairs) + i
            for i, j in zip(one.tolist(), two.tolist(), strict=True)
        ]
        return np.array(kind, dtype=np.int64), np.stack([one, two], axis=1)

    def _between_thick(self, placed: Placed) -> Block:
        """Capsules from capsules."""
        one, two = self._one, self._two
        ends = placed.start[:, one], placed.end[:, one], placed.start[:, two], placed.end[:, two]
        s, t, squared = closest(*ends)
        distance = np.sqrt(squared) - self._radius[one] - self._radius[two]

        def points(k: Indices, m: Indices) -> tuple[Vector, Vector]:
            a0, a1, b0, b1 = (end[k, m] for end in ends)
            return a0 + s[k, m, None] * (a1 - a0), b0 + t[k, m, None] * (b1 - b0)

        return Block(*self._of_thick, distance, points)

    def _thick_to_hull(self, placed: Placed, h: int, near: float) -> Block:
        """Capsules from a polyhedron of another link."""
        hull, thick = self._hulls[h], self._by_hull[h]
        middle, radius = hull.shape.ball
        pose = placed.poses[hull.link]
        _, away = point_to_segment(pose.point(middle)[:, None], placed.start[:, thick], placed.end[:, thick])
        distance = away - radius - self._radius[thick]

        def measure(k: Indices, m: Indices) -> tuple[Vector, Vector, Vector]:
            a0, a1 = (placed.within(hull, ends[k, thick[m]], k) for ends in (placed.start, placed.end))
            gap, part, point = segment_to_polyhedron(hull.shape, a0, a1)
            return (
                gap - self._radius[thick[m]],
                placed.out(hull, a0 + part[:, None] * (a1 - a0), k),
                placed.out(hull, point, k),
            )

        k, m = np.nonzero(distance < near)
        if len(k):
            distance[k, m] = np.maximum(distance[k, m], measure(k, m)[0])
        return Block(*self._of_hull[h], distance, lambda k, m: measure(k, m)[1:])

    def _between_hulls(self, placed: Placed, g: int, h: int, near: float) -> Block:
        """Two polyhedra of different links."""
        one, two = self._hulls[g], self._hulls[h]
        (c, r), (d, q) = one.shape.ball, two.shape.ball
        apart = np.linalg.norm(placed.poses[one.link].point(c) - placed.poses[two.link].point(d), axis=1)
        distance = (apart - r - q)[:, None]

        def measure(k: Indices) -> tuple[Vector, Vector, Vector]:
            edges = self._edges[g]
            a0, a1 = (placed.within(two, ends[k[:, None], edges], k) for ends in (placed.start, placed.end))
            gap, on_one, on_two = edges_to(two.shape, a0, a1)
            corners = placed.out(two, np.tile(two.shape.corners, (len(k), 1)), np.repeat(k, len(two.shape.corners)))
            corners = corners.reshape(len(k), -1, 3)
            over, lower, upper = solid_over(one.shape, placed.within(one, corners, k), two.shape.edges)
            closer = (over < gap)[:, None]
            on_one = np.where(closer, placed.out(one, lower, k), placed.out(two, on_one, k))
            on_two = np.where(closer, placed.out(one, upper, k), placed.out(two, on_two, k))
            return np.minimum(gap, over), on_one, on_two

        k = np.flatnonzero(distance[:, 0] < near)
        distance[k, 0] = np.maximum(distance[k, 0], measure(k)[0])
        kind, links = self._kinds(np.array([one.link]), np.array(two.link))
        return Block(kind, links, distance, lambda k, m: measure(k)[1:])

    def _to_solid(self, placed: Placed, solid: Solid, near: float) -> Block:
        """Capsules, and edges of polyhedra, from rock or an obstacle."""
        start, end = placed.start, placed.end
        kind, links = self._outside
        if isinstance(solid, Ball):
            center = np.array(solid.center)
            part, away = point_to_segment(center, start, end)

            def to_center(k: Indices, m: Indices) -> tuple[Vector, Vector]:
                on_link = start[k, m] + part[k, m, None] * (end[k, m] - start[k, m])
                return on_link, np.broadcast_to(center, on_link.shape)

            return Block(kind, links, away - solid.radius - self._radius, to_center)
        shape = solid.polyhedron
        bound, exact = least_height(shape, start, end)
        distance = bound - self._radius

        def measure(k: Indices, m: Indices) -> tuple[Vector, Vector, Vector]:
            gap, part, point = segment_to_polyhedron(shape, start[k, m], end[k, m])
            return gap - self._radius[m], start[k, m] + part[:, None] * (end[k, m] - start[k, m]), point

        k, m = np.nonzero((distance < near) & np.logical_not(exact))
        if len(k):
            distance[k, m] = measure(k, m)[0]
        return Block(kind, links, distance, lambda k, m: measure(k, m)[1:])

    def _hull_to_solid(self, placed: Placed, h: int, solid: Solid, near: float) -> Block:
        """Faces of a polyhedron from rock or an obstacle; its edges are among the segments."""
        hull = self._hulls[h]
        if isinstance(solid, Ball):
            middle, radius = hull.shape.ball
            corners, edges, thickness = np.array([solid.center]), np.zeros((0, 2), dtype=np.int64), solid.radius
            bound = solid.distance(placed.poses[hull.link].point(middle)) - radius
        else:  # the most that a face of the solid has all of the polyhedron in front of it
            corners, edges, thickness = solid.polyhedron.corners, solid.polyhedron.edges, 0.0
            own = self._edges[h]
            ends = np.concatenate([placed.start[:, own], placed.end[:, own]], axis=1)
            bound = solid.polyhedron.above(ends).min(axis=1).max(axis=1)
        distance = bound[:, None]

        def measure(k: Indices) -> tuple[Vector, Vector, Vector]:
            inner = placed.within(hull, np.broadcast_to(corners, (len(k), *corners.shape)), k)
            over, lower, upper = solid_over(hull.shape, inner, edges)
            return over - thickness, placed.out(hull, lower, k), placed.out(hull, upper, k)

        k = np.flatnonzero(bound < near)
        if len(k):
            distance[k, 0] = np.maximum(measure(k)[0], bound[k])
        return Block(*self._hull_outside[h], distance, lambda k, m: measure(k)[1:])

    def _to_flat(self, placed: Placed) -> Block:
        """Projections of capsules and edges onto the wall plane from obstacles in it."""
        start, end, flat = placed.start, placed.end, self._flat
        lines = shapely.linestrings(np.stack([start, end], axis=-2)[..., :2])
        distance = shapely.distance(lines, flat) - self._radius

        def points(k: Indices, m: Indices) -> tuple[Vector, Vector]:
            ends = shapely.get_coordinates(shapely.shortest_line(lines[k, m], flat)).reshape(-1, 2, 2)
            along = end[k, m] - start[k, m]
            part = ((ends[:, 0] - start[k, m, :2]) * along[:, :2]).sum(axis=1)
            part = np.clip(part / np.maximum((along[:, :2] ** 2).sum(axis=1), 1e-18), 0.0, 1.0)
            on_link = start[k, m] + part[:, None] * along
            return on_link, np.column_stack([ends[:, 1], on_link[:, 2]])

        return Block(*self._outside, distance, points)

    def _around_flat(self, placed: Placed) -> Iterator[Block]:
        """Polyhedra whose projection holds an obstacle, so that their edges do not meet it."""
        rows = np.arange(len(placed.start))
        for h, hull in enumerate(self._hulls):
            for part in shapely.get_parts(self._flat):
                x, y = shapely.get_coordinates(part.representative_point())[0]
                plumb = [np.broadcast_to([x, y, z], (len(rows), 3)) for z in (-FAR, FAR)]
                gap, _, point = segment_to_polyhedron(hull.shape, *(placed.within(hull, end, rows) for end in plumb))
                distance = np.where(gap > 0.0, np.inf, 0.0)[:, None]
                yield Block(*self._hull_outside[h], distance, partial(_itself, placed.out(hull, point, rows)))


def clearance_of(kinematics: Kinematics, wall: Wall) -> Clearance | SpaceClearance:
    """The clearance of a robot on a wall."""
    if kinematics.robot.planar:
        return Clearance(kinematics, wall.obstacles)
    return SpaceClearance(kinematics, wall)


def _itself(points: Vector, k: Indices, m: Indices) -> tuple[Vector, Vector]:
    """Where shapes overlap their closest points are one."""
    return points[k], points[k]
