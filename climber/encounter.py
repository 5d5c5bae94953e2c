"""How near two robots come to one another while both move.

Distances are those of `clearance`, between outlines in the plane. Whatever the height of the shapes, they must not
overlap in it: two robots pass beside each other, never one in front of the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climber.clearance import Clearance, inside, segment_distance
from climber.kinematics import Pose
from climber.manifold import Body
from climber.robot import Indices
from climber.stance import Vector

BETWEEN = 10  # instants looked at between two samples that leave doubt


@dataclass(frozen=True)
class Track:
    """Where a robot is over a stretch of time; between samples everything is interpolated linearly.

    Attributes:
        time: [s], increasing, shape (K,).
        q: Positions, shape (K, nq).
    """

    time: Vector
    q: Vector

    @classmethod
    def standing(cls, q: Vector) -> Track:
        """A robot that stays in the posture `q`, shape (nq,), whenever it is looked at."""
        return cls(np.zeros(1), q[None])

    def at(self, time: Vector) -> Vector:
        """Positions at instants [s], shape (M,), the first or last ones outside the stretch; shape (M, nq)."""
        return np.stack([np.interp(time, self.time, column) for column in self.q.T], axis=1)


@dataclass(frozen=True)
class Encounter:
    """The least distance of two robots.

    Attributes:
        distance: [m]; not above zero where they overlap, but no penetration depth.
        time: When they are so near [s].
        links: The link of each that is nearest, by name.
    """

    distance: float
    time: float
    links: tuple[str, str]


@dataclass(frozen=True)
class _Placed:
    """A robot's links in the plane at K instants.

    Attributes:
        ends: Both ends of each link's segments [m], two arrays of shape (K, S, 2) by link.
        center: Amid each link's segments [m], shape (K, L, 2).
        moved: How far any point of a segment goes from one instant to the next [m], shape (K - 1,).
    """

    ends: list[tuple[Vector, Vector]]
    center: Vector
    moved: Vector


class _Links:
    """A robot's links as thick segments of the plane."""

    def __init__(self, body: Body) -> None:
        assert isinstance(body.clearance, Clearance)  # teams are of planar robots
        self.clearance, self.body, self.names = body.clearance, body, body.kinematics.links
        still = [Pose(np.eye(3)[None], np.zeros((1, 3)))] * len(self.names)
        # A link without a collision shape cannot be met.
        self.solid = [link for link in range(len(self.names)) if len(body.clearance.radii(link))]
        self.radii = [body.clearance.radii(link) for link in self.solid]
        self.rings = [body.clearance.rings(link) for link in self.solid]
        placed = self.place(still)
        self.size = np.array(
            [
                max(float((np.linalg.norm(end - placed.center[:, i, None], axis=2) + radius).max()) for end in ends)
                for i, (ends, radius) in enumerate(zip(placed.ends, self.radii, strict=True))
            ]
        )

    def place(self, poses: list[Pose]) -> _Placed:
        """The links at the poses of `Kinematics.poses`."""
        ends = [self.clearance.segments(link, poses[link]) for link in self.solid]
        center = np.stack([(start + end).mean(axis=1) / 2 for start, end in ends], axis=1)
        points = np.concatenate([point for pair in ends for point in pair], axis=1)
        return _Placed(ends, center, np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1))

    def at(self, q: Vector) -> _Placed:
        """The links at configurations `q`, shape (K, nq)."""
        return self.place(self.body.kinematics.poses(q))


class Pair:
    """Two robots and the distance between them."""

    def __init__(self, one: Body, two: Body) -> None:
        self._one, self._two = _Links(one), _Links(two)

    def nearest(self, one: Track, two: Track, wanted: float) -> Encounter:
        """The least distance of the two while they move.

        They are measured at every sample of either. A point that goes a way w between two samples at which it is
        d_1 and d_2 from another is never nearer than (d_1 + d_2 - w) / 2; where that leaves it open whether the
        robots come nearer than `wanted`, or than at any sample, instants between are measured too.

        Args:
            one: How the first moves.
            two: How the second moves, on the same clock.
            wanted: Distance that matters [m].
        """
        time = np.union1d(one.time, two.time)
        distance, links, way = self._measure(one, two, time)
        low = (distance[:-1] + distance[1:] - way) / 2
        doubt = np.flatnonzero(low < max(wanted, float(distance.min())))
        if len(doubt):
            part = np.arange(1, BETWEEN + 1) / (BETWEEN + 1)
            more = (time[doubt, None] + np.diff(time)[doubt, None] * part).ravel()
            closer, their_links, _ = self._measure(one, two, more)
            distance, time = np.concatenate([distance, closer]), np.concatenate([time, more])
            links = np.concatenate([links, their_links])
        k = int(distance.argmin())
        i, j = links[k]
        names = self._one.names[self._one.solid[i]], self._two.names[self._two.solid[j]]
        return Encounter(float(distance[k]), float(time[k]), names)

    def _measure(self, one: Track, two: Track, time: Vector) -> tuple[Vector, Indices, Vector]:
        """At instants (K,): the least distance (K,), which two links (K, 2), and the way to the next instant (K-1,)."""
        a, b = self._one.at(one.at(time)), self._two.at(two.at(time))
        apart = np.linalg.norm(a.center[:, :, None] - b.center[:, None], axis=3)
        low = apart - self._one.size[:, None] - self._two.size
        # The farthest that the nearest pair of links can be is how far any pair can be.
        best = (apart + self._one.size[:, None] + self._two.size).min(axis=(1, 2))
        links = np.zeros((len(time), 2), dtype=np.int64)
        order = np.dstack(np.unravel_index(np.argsort(low.min(axis=0), axis=None), low.shape[1:]))[0]
        for i, j in order:
            near = np.flatnonzero(low[:, i, j] < best)
            if len(near):
                found = self._distance(a, b, i, j, near)
                closer = found < best[near]
                best[near[closer]], links[near[closer]] = found[closer], (i, j)
        return best, links, a.moved + b.moved

    def _distance(self, a: _Placed, b: _Placed, i: int, j: int, near: Indices) -> Vector:
        """Distance of link i of the first from link j of the second at the instants `near` [m]."""
        (a0, a1), (b0, b1) = ((start[near], end[near]) for start, end in (a.ends[i], b.ends[j]))
        gap = segment_distance(a0[:, :, None], a1[:, :, None], b0[:, None], b1[:, None])
        result: Vector = (gap - self._one.radii[i][:, None] - self._two.radii[j]).min(axis=(1, 2))
        # What lies wholly inside a ring does not come near its segments.
        for rings, start, end, other in ((self._one.rings[i], a0, a1, b0), (self._two.rings[j], b0, b1, a0)):
            for ring in rings:
                for k in range(other.shape[1]):
                    within = inside(other[:, k], start[:, ring], end[:, ring])
                    result[within] = -np.abs(result[within])
        return result
