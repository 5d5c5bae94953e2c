"""The conditions that make a configuration feasible, one by one, and their derivatives along a chart.

`Manifold.slack` is the least of them and tells whether; a program that moves configurations about needs each by itself,
because each is smooth where their least is not, and needs to know which way it grows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from climber.clearance import segment_distance
from climber.inverse import LimbInverse
from climber.kinematics import Pose
from climber.manifold import AnyChart, Manifold
from climber.stance import Vector

ANYWHERE = 1e6  # [m] stands for the end of an unbounded support
STEP = 1e-6  # [m, rad] of the central differences; their error is about its square, a thousandfold near straight limbs


@dataclass(frozen=True)
class Linearised:
    """Configurations and conditions near K points of a chart, to first order in its n coordinates.

    Attributes:
        q: Configurations, shape (K, nq).
        dq: Their derivatives by the coordinates, shape (K, nq, n).
        place: Which of the K points a condition is at, shape (M,).
        kind: Which condition it is, a place in `Conditions.names`, shape (M,).
        value: By how much it is met, negative where it is not [rad or m], shape (M,).
        slope: Its derivatives by the coordinates, shape (M, n).
    """

    q: Vector
    dq: Vector
    place: NDArray[np.int64]
    kind: NDArray[np.int64]
    value: Vector
    slope: Vector


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


class Conditions:
    """Feasibility on a manifold as separate numbers, each at least zero where its condition is met.

    Attributes:
        names: What each is about: joints, centre of mass, reach of the limbs that hold, pairs of links, links and
            obstacles.
    """

    def __init__(self, manifold: Manifold, chart: AnyChart) -> None:
        self.manifold, self.chart = manifold, chart
        body, clearance = manifold.body, manifold.body.clearance
        kinematics = body.kinematics
        self._tied = sorted(chart.solved)
        # The inverse kinematics of each holding limb, and the link that carries the first joint that it solves for.
        first = 1 + np.cumsum([0] + [len(chain.steps) for chain in kinematics.chains])
        self._inverse: list[tuple[LimbInverse, int]] = []
        for i in self._tied:
            inverse = body.inverse[i]
            assert inverse is not None  # as a chart solves for the limb
            self._inverse.append((inverse, int(first[i]) + inverse.leading - 1 if inverse.leading else 0))
        # Without weight the centre of mass may be anywhere; differences of infinities are no numbers.
        self._balanced = np.clip(manifold.balanced.b, -ANYWHERE, ANYWHERE)
        self._a, self._b = clearance.one, clearance.two
        self._link = np.repeat(np.arange(len(kinematics.links)), np.diff(clearance.first))
        number = {pair: k for k, pair in enumerate(clearance.pairs)}
        links = zip(self._link[self._a].tolist(), self._link[self._b].tolist(), strict=True)
        self._pair: NDArray[np.int64] = np.array([number[pair] for pair in links], dtype=np.int64)
        self._obstacles = shapely.union_all(body.wall.obstacles) if body.wall.obstacles else None
        joints, limbs = body.robot.joint_names, [body.robot.limbs[i].name for i in self._tied]
        rooms = [inverse.room_names for inverse, _ in self._inverse]
        reaches = [f"{limb} {what}" for limb, names in zip(limbs, rooms, strict=True) for what in names]
        self.names: tuple[str, ...] = (
            *(f"{joint} above its lower limit" for joint in joints),
            *(f"{joint} below its upper limit" for joint in joints),
            *manifold.balanced.names,
            *reaches,
            *(f"{kinematics.links[i]} clear of {kinematics.links[j]}" for i, j in clearance.pairs),
            *(f"{link} clear of obstacles" for link in kinematics.links),
        )
        self._outside = len(self.names) - len(kinematics.links)  # where those about obstacles begin
        # How many of them are not distances between shapes.
        self._smooth = 2 * len(joints) + len(self._balanced) + len(reaches)

    def _joints_balance_reach(self, q: Vector, poses: list[Pose]) -> Vector:
        """The conditions other than distances between shapes, shape (K, _smooth)."""
        kinematics, margins = self.manifold.body.kinematics, self.manifold.margins
        joints = q[:, kinematics.joint_q]
        center = kinematics.center_of_mass(q, poses)
        chart = self.chart
        rooms = [
            inverse.room(poses[link], chart.points[i], chart.branches[i]) - margins.reach
            for i, (inverse, link) in zip(self._tied, self._inverse, strict=True)
        ]
        return np.concatenate(
            [
                joints - (kinematics.lower + margins.joint),
                (kinematics.upper - margins.joint) - joints,
                self._balanced - center @ self.manifold.balanced.A.T,
                *rooms,
            ],
            axis=1,
        )

    def _segments(self, poses: list[Pose]) -> tuple[Vector, Vector]:
        """Both ends of all links' segments [m], shapes (K, S, 2)."""
        ends = [self.manifold.body.clearance.segments(i, pose) for i, pose in enumerate(poses)]
        return np.concatenate([s for s, _ in ends], axis=1), np.concatenate([e for _, e in ends], axis=1)

    def _distances(self, start: Vector, end: Vector) -> tuple[Vector, Vector]:
        """Distances less the margin: of watched pairs of segments (K, P), of segments from obstacles (K, S or 0)."""
        radius, margin = self.manifold.body.clearance.radius, self.manifold.margins.clearance
        gap = segment_distance(start[:, self._a], end[:, self._a], start[:, self._b], end[:, self._b])
        apart = gap - radius[self._a] - radius[self._b] - margin
        if self._obstacles is None:
            return apart, np.zeros((len(start), 0))
        lines = shapely.linestrings(np.stack([start, end], axis=2))
        return apart, shapely.distance(lines, self._obstacles) - radius - margin

    def least(self, u: Vector) -> Vector:
        """Every condition at the coordinates `u`, shape (K, n); shape (K, len(names)), inf where nothing is watched."""
        q, _ = self.chart.expand(u)
        poses = self.manifold.body.kinematics.poses(q)
        result = np.full((len(u), len(self.names)), np.inf)
        result[:, : self._smooth] = self._joints_balance_reach(q, poses)
        apart, away = self._distances(*self._segments(poses))
        rows = np.arange(len(u))[:, None]
        np.minimum.at(result, (rows, self._smooth + self._pair), apart)
        if self._obstacles is not None:
            np.minimum.at(result, (rows, self._outside + self._link), away)
        return result

    def linearised(self, u: Vector, near: float) -> Linearised:
        """Conditions to first order around the coordinates `u`, shape (K, n).

        Distances between shapes are included where they are less than `near` [m], segment by segment; their slopes
        are how fast the material points that are closest now move apart.
        """
        K, n = u.shape
        offsets = np.concatenate([np.zeros((1, n)), STEP * np.eye(n), -STEP * np.eye(n)])
        every = (offsets[:, None] + u).reshape(-1, n)  # the points themselves, then shifted each way
        q, _ = self.chart.expand(every)
        poses = self.manifold.body.kinematics.poses(q)
        smooth = self._joints_balance_reach(q, poses).reshape(2 * n + 1, K, -1)
        start, end = (x.reshape(2 * n + 1, K, -1, 2) for x in self._segments(poses))
        q = q.reshape(2 * n + 1, K, -1)

        def slope(values: Vector) -> Vector:
            """From values (2n + 1, ...) to derivatives (..., n)."""
            return np.moveaxis(values[1 : n + 1] - values[n + 1 :], 0, -1) / (2 * STEP)

        def material(place: NDArray[np.int64], segment: NDArray[np.int64], part: Vector) -> Vector:
            """Points a fraction along segments, shape (2n + 1, M, 2)."""
            one, two = start[:, place, segment], end[:, place, segment]
            result: Vector = one + part[:, None] * (two - one)
            return result

        apart, away = self._distances(start[0], end[0])
        place, row = np.nonzero(apart < near)
        a, b = self._a[row], self._b[row]
        s, t = closest(start[0, place, a], end[0, place, a], start[0, place, b], end[0, place, b])
        between = slope(material(place, b, t) - material(place, a, s))  # (M, 2, n)
        normal = material(place, b, t)[0] - material(place, a, s)[0]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        places = [np.repeat(np.arange(K), self._smooth), place]
        kinds = [np.tile(np.arange(self._smooth), K), self._smooth + self._pair[row]]
        values = [smooth[0].ravel(), apart[place, row]]
        slopes = [slope(smooth).reshape(-1, n), np.einsum("mi,min->mn", normal, between)]
        if self._obstacles is not None:
            place, a = np.nonzero(away < near)
            lines = shapely.linestrings(np.stack([start[0, place, a], end[0, place, a]], axis=1))
            ends = shapely.get_coordinates(shapely.shortest_line(lines, self._obstacles)).reshape(-1, 2, 2)
            along = end[0, place, a] - start[0, place, a]
            part = ((ends[:, 0] - start[0, place, a]) * along).sum(axis=1)
            part /= np.maximum((along**2).sum(axis=1), 1e-18)
            normal = ends[:, 0] - ends[:, 1]
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
            places.append(place)
            kinds.append(self._outside + self._link[a])
            values.append(away[place, a])
            slopes.append(np.einsum("mi,min->mn", normal, slope(material(place, a, part))))
        return Linearised(
            q[0],
            slope(q),
            np.concatenate(places),
            np.concatenate(kinds),
            np.concatenate(values),
            np.concatenate(slopes),
        )
