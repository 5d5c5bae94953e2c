"""Feasible postures on contacts for robots without inverse kinematics: random configurations, projected.

It answers like `climber.transition.PostureSampler`, which draws pelvis poses and is faster where every limb has inverse
kinematics.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from climber.geometry import disks_meet
from climber.manifold import Body, Manifold
from climber.newton import Closure
from climber.space_bases import SpaceBases
from climber.stance import Vector

APART = 1e-6  # [m, rad] isolated postures nearer to each other than this are one
MOST = 512  # postures returned from one draw


class NewtonSampler:
    """Samples feasible postures on a manifold.

    Attributes:
        body: The robot.
        manifold: The contacts and conditions.
    """

    def __init__(self, body: Body, manifold: Manifold) -> None:
        self.body, self.manifold = body, manifold
        holding = sorted(manifold.points)
        points = np.array([manifold.points[i] for i in holding])
        self._feet, self._reach = points[:, :2], body.robot.reach[holding]
        self._bases: SpaceBases | None = None
        if not body.robot.planar:
            hips = np.array([body.robot.limbs[i].hip for i in holding])
            lengths = self._reach - np.linalg.norm(hips, axis=1)
            out = body.wall.facing(np.array([contact.hold for contact in manifold.contacts]))
            self._bases = SpaceBases(hips, lengths, np.array([[-np.inf, np.inf]] * len(hips)), points, out)
        self._closure = Closure(body.kinematics, manifold.points)

    def unreachable(self, spare: float = 0.0) -> bool:
        """Whether no pelvis pose can let all limbs reach, even with feet as far as `spare` [m] from their points."""
        if self._bases is not None:
            return self._bases.unreachable(spare)
        return not bool(disks_meet(self._feet[None], self._reach + spare)[0])

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Vector, NDArray[np.int64], Vector, int]:
        """Draws `count` configurations, takes them to the contacts and keeps those that are feasible there.

        Returns:
            Configurations (M, nq), branches (M, num_limbs), slack (M,), and how many configurations came to lie on the
            contacts at all. Isolated postures are returned once.
        """
        robot, manifold = self.body.robot, self.manifold
        q = np.zeros((count, robot.plant.num_positions()))
        if self._bases is not None:
            base = self._bases.draw(rng, count)
            q = q[: len(base)]
            q[:, robot.base_q] = base
        else:
            # Around the holds, no farther than any of the limbs reaches.
            lower = (self._feet - self._reach[:, None]).max(axis=0)
            upper = (self._feet + self._reach[:, None]).min(axis=0)
            q[:, robot.origin_q] = rng.uniform(np.minimum(lower, upper), np.maximum(lower, upper), (count, 2))
            q[:, robot.angle_q] = rng.uniform(-np.pi, np.pi, (count, 1))
        for limb in robot.limbs:
            q[:, limb.q] = rng.uniform(*limb.one_turn, (len(q), len(limb.q)))
        q, closed = self._closure.project(q)
        q = self._within_a_turn(q[closed])
        closed_count = len(q)
        q = q[self.body.kinematics.within_limits(q, manifold.margins.joint) >= 0.0]
        q = self._distinct(q) if manifold.rigid else q[:MOST]
        slack = manifold.slack(q) if len(q) else np.zeros(0)
        good = slack >= 0.0
        q, slack = q[good], slack[good]
        branches = np.array([self.body.branches(row) for row in q], dtype=np.int64).reshape(len(q), len(robot.limbs))
        return q, branches, slack, closed_count

    def _within_a_turn(self, q: Vector) -> Vector:
        """The same postures with every angle in the turn that planning keeps it in."""
        robot = self.body.robot
        q = q.copy()
        angle = robot.angle_q
        q[:, angle] -= 2 * np.pi * np.round(q[:, angle] / (2 * np.pi))
        for limb in robot.limbs:
            lower, upper = limb.one_turn
            q[:, limb.q] -= 2 * np.pi * np.round((q[:, limb.q] - (lower + upper) / 2) / (2 * np.pi))
        return q

    def _distinct(self, q: Vector) -> Vector:
        """One of each of the isolated postures, in an order that does not depend on which were drawn first."""
        angle = self.body.robot.angle_q
        kept: list[Vector] = []
        for row in q:
            off = [row - other for other in kept]
            for difference in off:
                difference[angle] -= 2 * np.pi * np.round(difference[angle] / (2 * np.pi))
            if all(np.abs(difference).max() > APART for difference in off):
                kept.append(row)
        order = sorted(range(len(kept)), key=lambda i: kept[i].round(6).tolist())
        return np.array([kept[i] for i in order]).reshape(-1, q.shape[1])
