"""Distances between a robot's links, and of them from obstacles, with their derivatives along a chart.

The distances are those of the robot's clearance, kind by kind: of each watched pair of links, and of each link from
obstacles and rock. Their slopes are how fast the material points that are closest now move apart.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import shapely

from climber.clearance import Clearance, segment_distance
from climber.clearance_space import SpaceClearance
from climber.kinematics import Pose
from climber.manifold import Body
from climber.robot import Indices
from climber.stance import Vector

Slope = Callable[[Vector], Vector]  # from values at shifted configurations (2n + 1, ...) to derivatives (..., n)
Found = tuple[Indices, Indices, Vector, Vector]  # see `Gaps.near`


class Gaps(Protocol):
    """Distances of one robot on its wall.

    Attributes:
        names: What each kind of distance is about.
    """

    names: tuple[str, ...]

    def least(self, poses: list[Pose]) -> Vector:
        """The least distance of each kind [m], shape (K, len(names)); inf where nothing is watched."""
        ...

    def near(self, poses: list[Pose], count: int, within: float, slope: Slope) -> Found:
        """Distances less than `within` [m], shape by shape, with their slopes.

        Args:
            poses: Poses of the links at `count` configurations, then at those shifted along each of n coordinates, one
                way and the other.
            count: K, how many configurations there are.
            within: How near counts [m].
            slope: Takes differences.

        Returns:
            Which configuration, which kind, the distance [m], each of shape (M,), and slopes, shape (M, n).
        """
        ...


def closest(a0: Vector, a1: Vector, b0: Vector, b1: Vector) -> tuple[Vector, Vector]:
    """Where segments that do not cross are closest, as fractions of their lengths; arrays (M, 2) to (M,)."""
    u, v = a1 - a0, b1 - b0

    def fraction(point: Vector, start: Vector, along: Vector) -> Vector:
        squared = np.maximum((along**2).sum(axis=1), 1e-18)
        result: Vector = np.clip(((point - start) * along).sum(axis=1) / squared, 0.0, 1.0)
        return result

    zero, one = np.zeros(len(a0)), np.ones(len(a0))
    # One of the four ends is always among the closest points.
    s = np.stack([fraction(b0, a0, u), fraction(b1, a0, u), zero, one])
    t = np.stack([zero, one, fraction(a0, b0, v), fraction(a1, b0, v)])
    squared = (((a0 + s[..., None] * u) - (b0 + t[..., None] * v)) ** 2).sum(axis=2)
    best, which = squared.argmin(axis=0), np.arange(len(a0))
    return s[best, which], t[best, which]


def _unit(normal: Vector) -> Vector:
    result: Vector = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return result


class PlanarGaps:
    """See `Gaps`; between the outlines of a planar robot's links in the plane."""

    def __init__(self, body: Body, clearance: Clearance) -> None:
        self._clearance, links = clearance, body.kinematics.links
        self._a, self._b, self._radius = clearance.one, clearance.two, clearance.radius
        self._link = np.repeat(np.arange(len(links)), np.diff(clearance.first))
        number = {pair: k for k, pair in enumerate(clearance.pairs)}
        pairs = zip(self._link[self._a].tolist(), self._link[self._b].tolist(), strict=True)
        self._pair: Indices = np.array([number[pair] for pair in pairs], dtype=np.int64)
        self._obstacles = shapely.union_all(body.wall.obstacles) if body.wall.obstacles else None
        self._outside = len(clearance.pairs)  # where kinds about obstacles begin
        self.names: tuple[str, ...] = (
            *(f"{links[i]} clear of {links[j]}" for i, j in clearance.pairs),
            *(f"{link} clear of obstacles" for link in links),
        )

    def _distances(self, start: Vector, end: Vector) -> tuple[Vector, Vector]:
        """Distances of watched pairs of segments (K, P), and of segments from obstacles (K, S or 0)."""
        gap = segment_distance(start[:, self._a], end[:, self._a], start[:, self._b], end[:, self._b])
        apart = gap - self._radius[self._a] - self._radius[self._b]
        if self._obstacles is None:
            return apart, np.zeros((len(start), 0))
        lines = shapely.linestrings(np.stack([start, end], axis=2))
        return apart, shapely.distance(lines, self._obstacles) - self._radius

    def least(self, poses: list[Pose]) -> Vector:
        """See `Gaps.least`."""
        apart, away = self._distances(*self._clearance.ends(poses))
        result = np.full((len(apart), len(self.names)), np.inf)
        rows = np.arange(len(apart))[:, None]
        np.minimum.at(result, (rows, self._pair), apart)
        if self._obstacles is not None:
            np.minimum.at(result, (rows, self._outside + self._link), away)
        return result

    def near(self, poses: list[Pose], count: int, within: float, slope: Slope) -> Found:
        """See `Gaps.near`."""
        ends = self._clearance.ends(poses)
        start, end = (x.reshape(-1, count, *x.shape[1:]) for x in ends)

        def material(place: Indices, segment: Indices, part: Vector) -> Vector:
            """Points a fraction along segments, shape (2n + 1, M, 2)."""
            one, two = start[:, place, segment], end[:, place, segment]
            result: Vector = one + part[:, None] * (two - one)
            return result

        apart, away = self._distances(start[0], end[0])
        place, row = np.nonzero(apart < within)
        a, b = self._a[row], self._b[row]
        s, t = closest(start[0, place, a], end[0, place, a], start[0, place, b], end[0, place, b])
        between = material(place, b, t) - material(place, a, s)
        places, kinds, values = [place], [self._pair[row]], [apart[place, row]]
        slopes = [np.einsum("mi,min->mn", _unit(between[0]), slope(between))]
        if self._obstacles is not None:
            place, a = np.nonzero(away < within)
            lines = shapely.linestrings(np.stack([start[0, place, a], end[0, place, a]], axis=1))
            nearest = shapely.get_coordinates(shapely.shortest_line(lines, self._obstacles)).reshape(-1, 2, 2)
            along = end[0, place, a] - start[0, place, a]
            part = ((nearest[:, 0] - start[0, place, a]) * along).sum(axis=1)
            part /= np.maximum((along**2).sum(axis=1), 1e-18)
            normal = _unit(nearest[:, 0] - nearest[:, 1])
            places.append(place)
            kinds.append(self._outside + self._link[a])
            values.append(away[place, a])
            slopes.append(np.einsum("mi,min->mn", normal, slope(material(place, a, part))))
        return np.concatenate(places), np.concatenate(kinds), np.concatenate(values), np.concatenate(slopes)


class SpaceGaps:
    """See `Gaps`; between the shapes of a robot in space, rock and obstacles."""

    def __init__(self, body: Body, clearance: SpaceClearance) -> None:
        self._clearance, links = clearance, body.kinematics.links
        self.names: tuple[str, ...] = (
            *(f"{links[i]} clear of {links[j]}" for i, j in clearance.pairs),
            *(f"{link} clear of rock and obstacles" for link in links[: clearance.num_kinds - len(clearance.pairs)]),
        )

    def least(self, poses: list[Pose]) -> Vector:
        """See `Gaps.least`."""
        return self._clearance.least(poses)

    def near(self, poses: list[Pose], count: int, within: float, slope: Slope) -> Found:
        """See `Gaps.near`."""
        rotation, origin = (
            np.stack([getattr(pose, part) for pose in poses], axis=1).reshape(-1, count, len(poses), *shape)
            for part, shape in (("rotation", (3, 3)), ("origin", (3,)))
        )
        found = self._clearance.near([Pose(pose.rotation[:count], pose.origin[:count]) for pose in poses], within)
        moved = []
        for link, point in zip(found.links.T, np.swapaxes(found.points, 0, 1), strict=True):
            R, p = rotation[:, found.place, link], origin[:, found.place, link]
            inside = np.einsum("mij,mi->mj", R[0], point - p[0])  # in the link's frame
            at = np.einsum("smij,mj->smi", R, inside) + p
            # Rock and obstacles, which are link -1, stay where they are.
            moved.append(np.where((link < 0)[:, None], point, at))
        between = moved[1] - moved[0]
        slopes = np.einsum("mi,min->mn", _unit(between[0]), slope(between))
        return found.place, found.kind, found.distance, slopes


def gaps_of(body: Body) -> Gaps:
    """The distances of a robot on its wall."""
    clearance = body.clearance
    return PlanarGaps(body, clearance) if isinstance(clearance, Clearance) else SpaceGaps(body, clearance)
