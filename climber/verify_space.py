"""Clearance of robots in space, at every instant of a motion: between parts of robots, and from them to the wall.

Between two instants whose positions are joined by straight lines, no point of a part moves farther against another part
than the sum, over the joints between the two, of how far the joint goes times the part's greatest distance from its
axis. If that is s, and the two are d0 apart at the beginning and d1 at the end, they are never closer than
(d0 + d1 - s) / 2: a distance along the way is at least d0 less what was moved since, and d1 less what is still to be
moved. Where that proves too little the step is halved. So nothing is missed between instants, however coarse they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import BodyIndex, Joint

from climber.robot import Robot
from climber.stance import Vector
from climber.verify_distance import hull_distances
from climber.verify_joints import freedoms
from climber.verify_model import Tree
from climber.verify_scene import FAR, Part, Regions, Scene, gap

ENOUGH = 0.005  # [m] distances are proved up to this, not beyond
SHARE = 0.8  # of the least distance found at any instant, up to which it is proved for what lies between
HALVINGS = 14  # of a step; its 16,000th part moves no link by a thousandth of a millimetre
CHUNK = 20_000  # pairs measured at a time
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Least:
    """The least distance of a motion.

    Attributes:
        value: That no pair is ever closer than [m], at most `FAR`; where thick parts cross, minus their thickness.
        time: When, or at the end of which step [s].
        pair: The two by name.
    """

    value: float
    time: float
    pair: str


class Sweep:
    """Pairs of parts of one or several robots, and of the wall, whose distances are followed along motions.

    Attributes:
        pairs: The two places among the parts of each pair, shape (num_pairs, 2).
    """

    def __init__(
        self, robots: Sequence[Robot], parts: Sequence[tuple[int, Part]], pairs: Sequence[tuple[int, int]]
    ) -> None:
        """Prepares.

        Args:
            robots: The robots; the positions of all of them, one robot after the other, are what is called q here.
            parts: The parts, each with the place of its robot; what stands still may be of any.
            pairs: The two places in `parts` of each pair.
        """
        self._trees = [Tree(robot) for robot in robots]
        self._ends = np.cumsum([robot.plant.num_positions() for robot in robots])
        self._owners, self._parts = [owner for owner, _ in parts], [part for _, part in parts]
        self.pairs = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        counts = np.array([len(part.corners) for part in self._parts])
        self._kinds = counts[self.pairs]  # pairs of as many corners are measured together
        self._radius = np.array([part.radius for part in self._parts])
        moved = np.zeros((len(parts), self._ends[-1]))
        for place, (owner, part) in enumerate(parts):
            moved[place, self._own(owner)] = levers(robots[owner], part)
        one, two = moved[self.pairs[:, 0]], moved[self.pairs[:, 1]]
        # What carries both moves neither against the other.
        self._moved = np.where((one > 0.0) & (two > 0.0), 0.0, one + two)

    def _own(self, owner: int) -> slice:
        return slice(self._ends[owner - 1] if owner else 0, self._ends[owner])

    def least(self, time: Vector, q: Vector, which: NDArray[np.bool_]) -> Least:
        """The least distance of some pairs over a motion.

        Args:
            time: Instants [s], shape (N,).
            q: Positions at them, joined by straight lines, shape (N, nq).
            which: Which of the pairs, shape (num_pairs,).
        """
        places = np.flatnonzero(which)
        if not len(places):
            return Least(FAR, float(time[0]), "all pairs")
        rows, pairs = np.repeat(np.arange(len(q)), len(places)), np.tile(places, len(q))
        found = self.distances(q, rows, pairs)
        nearest = int(np.argmin(found))
        best = float(found[nearest])
        least = Least(best, float(time[rows[nearest]]), self._name(pairs[nearest]))
        # A step of a pair from the instant `begin`, a fraction of a row of q, to `end`; distances there; way between.
        step = (np.abs(np.diff(q, axis=0)) @ self._moved[places].T).ravel()
        begin, pairs = rows[: len(step)].astype(float), pairs[: len(step)]
        end, first, last = begin + 1.0, found[: len(step)], found[len(places) :]
        for _ in range(HALVINGS):
            if best < 0.0:
                return least  # which is proof enough
            proved = (first + last - step) / 2
            doubtful = proved < min(SHARE * best, ENOUGH)
            least = self._lower(least, time, proved[~doubtful], end[~doubtful], pairs[~doubtful])
            if not doubtful.any():
                return least
            begin, end, first, last, step, pairs = (x[doubtful] for x in (begin, end, first, last, step, pairs))
            middle = (begin + end) / 2
            instants, rows = np.unique(middle, return_inverse=True)
            row = np.minimum(instants.astype(int), len(q) - 2)
            part = (instants - row)[:, None]
            found = self.distances(q[row] * (1.0 - part) + q[row + 1] * part, rows, pairs)
            least = self._lower(least, time, found, middle, pairs)
            best = min(best, float(found.min()))
            begin, end = np.concatenate([begin, middle]), np.concatenate([middle, end])
            first, last = np.concatenate([first, found]), np.concatenate([found, last])
            step, pairs = np.tile(step / 2, 2), np.tile(pairs, 2)
        return self._lower(least, time, (first + last - step) / 2, end, pairs)

    def _lower(self, least: Least, time: Vector, values: Vector, at: Vector, pairs: Indices) -> Least:
        """The lesser of `least` and the least of `values` of `pairs` at fractional rows `at`, all of shape (K,)."""
        if not len(values) or values.min() >= least.value:
            return least
        place = int(np.argmin(values))
        when = float(np.interp(at[place], np.arange(len(time)), time))
        return Least(float(values[place]), when, self._name(pairs[place]))

    def _name(self, pair: int) -> str:
        one, two = (self._parts[place].name for place in self.pairs[pair])
        return f"{one} and {two}"

    def distances(self, q: Vector, rows: Indices, pairs: Indices) -> Vector:
        """Distances of the pairs `pairs[k]` at positions `q[rows[k]]` [m], at most `FAR`, shape (K,).

        Boxes along W's axes around the parts tell which pairs are near enough to be measured. Where cores meet it is
        minus the thickness around them.
        """
        corners = self._placed(q)
        low, high = (np.stack([end(at, axis=1) for at in corners]) for end in (np.min, np.max))  # (num_parts, K, 3)
        one, two = self.pairs[pairs].T
        aside = np.maximum(low[one, rows] - high[two, rows], low[two, rows] - high[one, rows])
        radius = self._radius[one] + self._radius[two]
        near = np.linalg.norm(np.maximum(aside, 0.0), axis=1) - radius < FAR
        result = np.full(len(rows), FAR)
        for kind in np.unique(self._kinds[pairs[near]], axis=0):
            alike = np.flatnonzero(near & (self._kinds[pairs] == kind).all(axis=1))
            for some in np.array_split(alike, len(alike) * kind.prod() // CHUNK + 1):
                hulls = [
                    np.array([corners[part][row] for part, row in zip(parts, rows[some], strict=True)])
                    for parts in (one[some], two[some])
                ]
                result[some] = np.minimum(gap(hull_distances(*hulls), radius[some]), FAR)
        return result

    def _placed(self, q: Vector) -> list[Vector]:
        """Where the corners of each part are in W [m] at positions `q` (K, nq), shape (K, number of corners, 3)."""
        poses = [tree.poses(q[:, self._own(owner)]) for owner, tree in enumerate(self._trees)]
        return [
            part.corners @ np.swapaxes(poses[owner].rotation[part.body], 1, 2) + poses[owner].origin[part.body][:, None]
            for owner, part in zip(self._owners, self._parts, strict=True)
        ]


class SpaceClearance:
    """Least distances within a robot in space, and from it to the wall and to other regions."""

    def __init__(self, robot: Robot, regions: Regions) -> None:
        scene = Scene(robot, regions)
        parts = scene.parts()
        self._sweep = Sweep([robot], [(0, part) for part in parts], scene.candidates())
        self._outside = np.array([any(parts[place].body == 0 for place in pair) for pair in self._sweep.pairs], bool)

    def least(self, time: Vector, q: Vector) -> tuple[Least, Least]:
        """The least distance within the robot, and the least from it to regions, over a motion.

        Args:
            time: Instants [s], shape (N,).
            q: Positions at them, joined by straight lines, shape (N, nq).
        """
        return self._sweep.least(time, q, ~self._outside), self._sweep.least(time, q, self._outside)


def levers(robot: Robot, part: Part) -> Vector:
    """How far points of a part move at most for each position of the robot that changes by one, shape (nq,).

    That is the greatest distance of the part from the axis of a joint that turns, bounded by the pieces between the
    joints on the way; and one for a joint that slides. The angles of a floating base turn it about three unit axes.
    """
    result = np.zeros(robot.plant.num_positions())
    carriers = {joint.child_body().index(): joint for joint in _joints(robot)}
    joint = carriers.get(robot.plant.get_body(BodyIndex(part.body)).index())
    points, far = part.corners, part.radius
    while joint is not None:
        hinge = joint.frame_on_child().GetFixedPoseInBodyFrame().translation()
        far += float(np.linalg.norm(points - hinge, axis=1).max())
        on_world = joint.parent_body().index() == robot.plant.world_body().index()
        for place, freedom in enumerate(freedoms(joint, on_world) or (), joint.position_start()):
            result[place] = 1.0 if freedom.slides else far
        points = joint.frame_on_parent().GetFixedPoseInBodyFrame().translation()[None]
        joint = carriers.get(joint.parent_body().index())
    return result


def _joints(robot: Robot) -> list[Joint]:
    return [robot.plant.get_joint(index) for index in robot.plant.GetJointIndices()]
