"""Coordinates of the configurations in which a robot keeps some contacts, in closed form.

Given where the pelvis is, the limbs decouple: the pelvis's pose, the joints of limbs in the air and the leading joints
of redundant limbs are free, and each holding limb follows by inverse kinematics on one of its branches. A `Chart` is
such a parameterisation. Its configurations keep the contacts to machine precision, so paths in it do not drift.

Where a holding limb is straight its two branches meet and the pelvis's pose is no smooth coordinate any more. A chart
*rooted* at that limb takes the limb's own joints instead, and the pelvis's position follows from them; a path
crosses from one branch to the other in it without noticing. The limb at the root needs no inverse kinematics, so a limb
that has none (with fewer than two joints) can be there. Where two such limbs hold, charts come from Newton's method
(`climber.newton`), and they are local.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from climber.dynamics import turning
from climber.inverse import TwoLinkInverse, TwoLinkInverses
from climber.robot import Indices
from climber.stance import Vector

if TYPE_CHECKING:
    from climber.manifold import Body


class Chart:
    """Independent coordinates `u` of the configurations that keep some contacts.

    Attributes:
        body: The robot.
        points: Where each holding limb's foot stands in W [m], by limb.
        branches: The branch of each limb; that of a limb in the air or at the root means nothing.
        root: The holding limb whose joints stand in for the pelvis's position, or None.
        solved: The holding limbs whose joints follow by inverse kinematics.
        independent: Places in the plant's positions of those that the coordinates `u` give, one for each.
    """

    def __init__(
        self, body: Body, points: Mapping[int, Vector], branches: Sequence[int], root: int | None = None
    ) -> None:
        self.body, self.points, self.branches, self.root = body, dict(points), tuple(branches), root
        self.solved = tuple(i for i in self.points if i != root)
        if lacking := body.without_inverse(self.solved):
            raise ValueError(f"limb {lacking[0]} holds and has no inverse kinematics; it must be the chart's root")
        places: list[int] = list(body.robot.base_q if root is None else body.robot.angle_q)
        for i, (limb, inverse) in enumerate(zip(body.robot.limbs, body.inverse, strict=True)):
            leading = 0 if inverse is None else inverse.leading
            places += list(limb.q[: leading if i in self.solved else len(limb.q)])
        self.independent = np.array(places, dtype=np.int64)

    @cached_property
    def dependent(self) -> Indices:
        """Places in the plant's positions of what follows from `u`."""
        return np.setdiff1d(np.arange(self.body.robot.plant.num_positions()), self.independent)

    @cached_property
    def free(self) -> Vector:
        """Directions of the coordinates, shape (nq, num_coordinates)."""
        identity = np.eye(self.body.robot.plant.num_positions())
        result: Vector = identity[:, self.independent] @ self._from_coordinates
        return result

    @cached_property
    def _hanging(self) -> bool:
        """Whether no limb but the one at the root holds, and the robot is planar and may turn about it."""
        return self.body.robot.planar and tuple(self.points) == (self.root,)

    @cached_property
    def _to_coordinates(self) -> Vector:
        """From the independent positions to the coordinates, shape (num_coordinates, num_coordinates).

        They are the same, unless the robot hangs from the limb at the root. Then the angle of that limb's last link
        takes the place of the pelvis's, so that joints can bend as far as they go while it turns little.
        """
        result = np.eye(len(self.independent))
        if self._hanging:
            assert self.root is not None
            turning_rate = turning(self.body.robot, [self.root])[0]
            # A planar robot's velocities are the rates of its positions.
            result[self._angle] = turning_rate[self.independent]
        return result

    @cached_property
    def _from_coordinates(self) -> Vector:
        return np.asarray(np.linalg.inv(self._to_coordinates))

    @cached_property
    def tied(self) -> Vector:
        """Directions of what follows from them, columns of the identity, shape (nq, nq - num_coordinates)."""
        return np.eye(self.body.robot.plant.num_positions())[:, self.dependent]

    @cached_property
    def _angle(self) -> int:
        """Place of a planar pelvis's angle among the coordinates."""
        return int(np.flatnonzero(self.independent == self.body.robot.angle_q[0])[0])

    def bounds(self, a: Vector, b: Vector) -> tuple[Vector, Vector]:
        """Where to look for a path between two points: around both, and no farther than joint limits.

        A robot that hangs from one limb may turn all the way round.
        """
        lower, upper = np.minimum(a, b) - 0.9 / self.scale, np.maximum(a, b) + 0.9 / self.scale
        hanging = self._hanging
        if hanging:
            lower[self._angle], upper[self._angle] = a[self._angle] - 1.5 * np.pi, a[self._angle] + 1.5 * np.pi
        for limb in self.body.robot.limbs:
            for place, low, high in zip(limb.q, *limb.one_turn, strict=True):
                at = np.flatnonzero(self.independent == place)
                lower[at] = low if hanging else np.maximum(lower[at], low)
                upper[at] = high if hanging else np.minimum(upper[at], high)
        return lower, upper

    def turns(self, u: Vector) -> list[Vector]:
        """The points that are the same posture as `u`, that is itself, but for a robot that hangs from one limb.

        That one may come to the posture by turning round either way.
        """
        turn = np.zeros(len(u))
        turn[self._angle] = 2 * np.pi
        return [u, u + turn, u - turn] if self._hanging else [u]

    @cached_property
    def scale(self) -> Vector:
        """Weights that make the coordinates commensurate: a metre of pelvis counts as its turn over a limb's length."""
        weights = np.ones(len(self.independent))
        weights[np.isin(self.independent, self.body.robot.origin_q)] = 2.0 / self.body.robot.reach.mean()
        return weights

    def coordinates(self, q: Vector) -> Vector:
        """The coordinates of configurations on this chart, shape (..., nq) to (..., num_coordinates)."""
        result: Vector = q[..., self.independent] @ self._to_coordinates.T
        return result

    @cached_property
    def _alike(self) -> tuple[TwoLinkInverses, Indices, Vector] | None:
        """The limbs solved for, if all have two joints: together, with the places of these (L, 2), and their holds."""
        inverses = [self.body.inverse[i] for i in self.solved]
        two = [inverse for inverse in inverses if isinstance(inverse, TwoLinkInverse) and not inverse.leading]
        if not two or len(two) < len(inverses):
            return None
        together = TwoLinkInverses(two, [self.branches[i] for i in self.solved])
        places = np.stack([self.body.robot.limbs[i].q for i in self.solved])
        return together, places, np.stack([self.points[i] for i in self.solved])

    def expand(self, u: Vector) -> tuple[Vector, Vector]:
        """The whole configurations with coordinates `u`, shape (K, num_coordinates).

        Returns:
            Configurations, shape (K, nq), and by how much every dependent limb reaches its hold [m], shape (K,);
            where that is negative the configuration does not keep the contacts.
        """
        robot = self.body.robot
        q = np.zeros((len(u), robot.plant.num_positions()))
        q[:, self.independent] = u @ self._from_coordinates.T
        if self.root is not None:
            turned = self.body.kinematics.pelvis(q[:, robot.base_q])
            chain = self.body.kinematics.chains[self.root]
            foot = chain.foot_position(turned, chain.links(turned, q[:, robot.limbs[self.root].q]))
            q[:, robot.origin_q] = (self.points[self.root] - foot)[:, : robot.dimension]
        pelvis = self.body.kinematics.pelvis(q[:, robot.base_q])
        if self._alike is not None:
            inverses, places, targets = self._alike
            angles, rooms = inverses.solve(pelvis, targets)
            q[:, places] = angles
            return q, rooms.min(axis=1)
        slack = np.full(len(u), np.inf)
        for i in self.solved:
            limb, inverse = robot.limbs[i], self.body.inverse[i]
            assert inverse is not None  # a chart without is not made
            solved, within = inverse.solve(pelvis, q[:, limb.q[: inverse.leading]], self.points[i])
            q[:, limb.q] = solved[:, self.branches[i]]
            slack = np.minimum(slack, within[:, self.branches[i]])
        return q, slack
