"""The closed-chain manifold of a stance: every configuration that keeps its contacts.

Given where the pelvis is, the limbs decouple: the pelvis's pose, the joints of limbs in the air and the leading joints
of redundant limbs are free, and each holding limb follows by inverse kinematics on one of its branches. A `Chart` is
such a parameterisation. Its configurations keep the contacts to machine precision, so paths in it do not drift.

Where a holding limb is straight its two branches meet and the pelvis's pose is no smooth coordinate any more. A chart
*rooted* at that limb takes the limb's own joints instead, and the pelvis's position follows from them; a path
crosses from one branch to the other in it without noticing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from climber.clearance import Clearance
from climber.inverse import TwoLinkInverse
from climber.kinematics import Kinematics, Pose
from climber.robot import Indices, Robot
from climber.stance import Contact, Vector
from climber.wall import Wall


@dataclass(frozen=True)
class Margins:
    """How far inside its limits a configuration must stay.

    Attributes:
        reach: Of a holding limb's workspace [m]; joint rates grow without bound where a limb is straight.
        joint: Of the joint limits [rad].
        clearance: Between links, pelvis and obstacles [m].
        balance: Of the support interval [m], but never more than a fifth of its width.
    """

    reach: float = 0.001
    joint: float = 0.02
    clearance: float = 0.001
    balance: float = 0.002


class Body:
    """A robot's batched kinematics, inverse kinematics and clearance on one wall."""

    def __init__(self, robot: Robot, wall: Wall) -> None:
        self.robot, self.wall = robot, wall
        self.kinematics = Kinematics(robot)
        self.clearance = Clearance(self.kinematics, wall.obstacles)
        self.inverse = tuple(
            TwoLinkInverse(limb, chain) for limb, chain in zip(robot.limbs, self.kinematics.chains, strict=True)
        )

    def branches(self, q: Vector) -> tuple[int, ...]:
        """The branch of every limb at the configuration `q`, shape (nq,)."""
        return tuple(inverse.branch(q[limb.q]) for inverse, limb in zip(self.inverse, self.robot.limbs, strict=True))


class Chart:
    """Independent coordinates `u` of the configurations that keep some contacts.

    Attributes:
        body: The robot.
        points: Where each holding limb's foot stands in W [m], by limb.
        branches: The branch of each limb; that of a limb in the air or at the root means nothing.
        root: The holding limb whose joints stand in for the pelvis's position, or None.
        independent: Places of the coordinates `u` in the plant's positions.
    """

    def __init__(
        self, body: Body, points: Mapping[int, Vector], branches: Sequence[int], root: int | None = None
    ) -> None:
        self.body, self.points, self.branches, self.root = body, dict(points), tuple(branches), root
        places: list[int] = list(body.robot.base_q if root is None else body.robot.base_q[2:])
        for i, (limb, inverse) in enumerate(zip(body.robot.limbs, body.inverse, strict=True)):
            free = len(limb.q) if i == root or i not in self.points else inverse.leading
            places += list(limb.q[:free])
        self.independent = np.array(places, dtype=np.int64)

    @cached_property
    def dependent(self) -> Indices:
        """Places in the plant's positions of what follows from `u`."""
        return np.setdiff1d(np.arange(self.body.robot.plant.num_positions()), self.independent)

    @cached_property
    def scale(self) -> Vector:
        """Weights that make the coordinates commensurate: a metre of pelvis counts as its turn over a limb's length."""
        weights = np.ones(len(self.independent))
        base = self.body.robot.base_q[:2]
        weights[np.isin(self.independent, base)] = 2.0 / self.body.robot.reach.mean()
        return weights

    def coordinates(self, q: Vector) -> Vector:
        """The coordinates of configurations on this chart, shape (..., nq) to (..., num_coordinates)."""
        result: Vector = q[..., self.independent]
        return result

    def expand(self, u: Vector) -> tuple[Vector, Vector]:
        """The whole configurations with coordinates `u`, shape (K, num_coordinates).

        Returns:
            Configurations, shape (K, nq), and by how much every dependent limb reaches its hold [m], shape (K,);
            where that is negative the configuration does not keep the contacts.
        """
        robot = self.body.robot
        q = np.zeros((len(u), robot.plant.num_positions()))
        q[:, self.independent] = u
        if self.root is not None:
            turned = self.body.kinematics.pelvis(q[:, robot.base_q])
            chain = self.body.kinematics.chains[self.root]
            foot = chain.foot_position(chain.links(turned, q[:, robot.limbs[self.root].q]))
            q[:, robot.base_q[:2]] = (self.points[self.root] - foot)[:, :2]
        pelvis = self.body.kinematics.pelvis(q[:, robot.base_q])
        slack = np.full(len(u), np.inf)
        for i, point in self.points.items():
            if i == self.root:
                continue
            limb, inverse = robot.limbs[i], self.body.inverse[i]
            solved, within = inverse.solve(pelvis, q[:, limb.q[: inverse.leading]], point)
            q[:, limb.q] = solved[:, self.branches[i]]
            slack = np.minimum(slack, within)
        return q, slack


class Manifold:
    """The configurations on some contacts in which the robot is also clear, inside limits and balanced.

    Attributes:
        body: The robot.
        contacts: The contacts that hold.
        support: Where the centre of mass's abscissa may be [m], (lower, upper).
        margins: How far inside each limit.
    """

    def __init__(
        self, body: Body, contacts: Sequence[Contact], support: tuple[float, float], margins: Margins | None = None
    ) -> None:
        self.body, self.contacts, self.support = body, tuple(contacts), support
        self.margins = margins or Margins()
        self.points = {c.limb: body.wall.point(c) for c in self.contacts}

    @cached_property
    def balanced(self) -> tuple[float, float]:
        """The support interval less its margin [m]."""
        lower, upper = self.support
        margin = min(self.margins.balance, 0.2 * (upper - lower))
        return lower + margin, upper - margin

    def chart(self, q: Vector, root: int | None = None) -> Chart:
        """The chart around the configuration `q`, shape (nq,)."""
        return Chart(self.body, self.points, self.body.branches(q), root)

    def slack(self, q: Vector) -> Vector:
        """By how much configurations on the contacts are feasible beyond the margins, shape (K,); negative if not.

        The least of: distance to joint limits [rad], to the ends of the support interval [m] and to collision [m].
        """
        kinematics = self.body.kinematics
        poses: list[Pose] = kinematics.poses(q)
        lower, upper = self.balanced
        abscissa = kinematics.center_of_mass(q, poses)[:, 0]
        result = np.minimum(abscissa - lower, upper - abscissa)
        result = np.minimum(result, kinematics.within_limits(q, self.margins.joint))
        # Distances cost the most, so only where the rest holds.
        good = np.flatnonzero(result >= 0)
        if len(good):
            chosen = [Pose(pose.rotation[good], pose.origin[good]) for pose in poses]
            result[good] = np.minimum(result[good], self.body.clearance(chosen) - self.margins.clearance)
        return result

    def feasible(self, chart: Chart, u: Vector) -> NDArray[np.bool_]:
        """Which chart coordinates `u`, shape (K, num_coordinates), are feasible; shape (K,), bool."""
        q, reach = chart.expand(u)
        good = reach >= self.margins.reach
        if good.any():
            good[good] = self.slack(q[good]) >= 0
        return good
