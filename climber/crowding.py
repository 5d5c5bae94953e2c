"""Which stances of two robots of a team are too close to be taken at the same time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climber.clearance import segment_distance
from climber.climb_search import ClimbSearch
from climber.stance import Vector
from climber.states import Booleans, Integers


class Crowding:
    """Which stances of two robots are too close: their stars, from amid the feet to each foot, nearly touch."""

    def __init__(self, members: Sequence[ClimbSearch], room: float) -> None:
        self._room = room
        self._feet = [member.body.wall.positions[member.graph.stances][..., :2] for member in members]
        # The pelvis covers a disk as wide as its nearest hip is far from its origin.
        self._pelvis = [min(float(np.linalg.norm(limb.hip[:2])) for limb in member.robot.limbs) for member in members]

    def __call__(self, robots: tuple[int, int], one: Integers, two: Integers) -> Booleans:
        """Which pairs of vertices are too close, shape (k,)."""
        result: Booleans = np.zeros(len(one), bool)
        for begin in range(0, len(one), 50_000):
            part = slice(begin, begin + 50_000)
            result[part] = self._gap(robots, one[part], two[part]) < self._room
        return result

    def _gap(self, robots: tuple[int, int], one: Integers, two: Integers) -> Vector:
        """Distance of the two outlines [m], shape (k,)."""
        (a, b), (r, s) = (self._feet[robots[0]][one], self._feet[robots[1]][two]), (self._pelvis[k] for k in robots)
        at, there = a.mean(axis=1)[:, None], b.mean(axis=1)[:, None]
        limbs = segment_distance(at[:, :, None], a[:, :, None], there[:, None], b[:, None]).min(axis=(1, 2))
        first = segment_distance(at, at, there, b).min(axis=1) - r
        second = segment_distance(at, a, there, there).min(axis=1) - s
        both = np.linalg.norm(at - there, axis=2)[:, 0] - r - s
        result: Vector = np.minimum.reduce([limbs, first, second, both])
        return result
