"""The closed-chain manifold of a stance: every configuration that keeps its contacts.

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

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from climber.balance import Region
from climber.clearance_space import clearance_of
from climber.dynamics import turning
from climber.inverse import limb_inverse
from climber.kinematics import Kinematics, Pose
from climber.newton import NewtonChart
from climber.programs.carried import Precedents
from climber.programs.torque import static_feasible
from climber.robot import Indices, Robot
from climber.stance import Contact, Vector
from climber.wall import Wall

if TYPE_CHECKING:
    from climber.demands import Demands


@dataclass(frozen=True)
class Margins:
    """How far inside its limits a configuration must stay.

    Attributes:
        reach: Of a holding limb's workspace [m]; joint rates grow without bound where a limb is straight.
        joint: Of the joint limits [rad].
        clearance: Between links, pelvis and obstacles [m].
        balance: Of the support's border [m], but never more than two fifths of the way to its middle. At the border
            feet have no force to spare: with 2 mm a controller had 0.04 N of room, and a robot fell in simulation.
        line: Of the feet that hold, in space, from any line [m], for one of them at least. Nothing keeps a robot from
            turning about a line on which all its feet stand.
    """

    reach: float = 0.001
    joint: float = 0.02
    clearance: float = 0.001
    balance: float = 0.005
    line: float = 0.02


class Body:
    """A robot's batched kinematics, inverse kinematics and clearance on one wall.

    Attributes:
        robot: The robot.
        wall: The wall.
        demands: The margins that its phases must have, if any.
        kinematics: Its kinematics.
        clearance: Its clearance.
        supports: Where the centre of mass may be over sets of contacts, as far as that is known yet; see `support_of`.
        precedents: What is known of which postures limbs can hold, by the limbs that are in contact.
        inverse: The inverse kinematics of each limb; None for one that has none in closed form, such as one of a single
            joint.
    """

    def __init__(self, robot: Robot, wall: Wall, demands: Demands | None = None) -> None:
        self.robot, self.wall, self.demands = robot, wall, demands
        self.kinematics = Kinematics(robot)
        self.clearance = clearance_of(self.kinematics, wall)
        self.supports: dict[tuple[Contact, ...], Region | None] = {}
        self.precedents: dict[tuple[int, ...], Precedents] = {}
        self.inverse = tuple(
            limb_inverse(robot.planar, limb, chain)
            for limb, chain in zip(robot.limbs, self.kinematics.chains, strict=True)
        )

    @property
    def asked(self) -> str:
        """What to add where a posture cannot be held, as margins may be asked for."""
        return f" with the margins asked for ({self.demands.told()})" if self.demands and self.demands.least else ""

    def held(self, q: Vector, contacts: Sequence[Contact]) -> NDArray[np.bool_]:
        """Which postures q, shape (K, nq), contacts and motors can hold still, shape (K,)."""
        if not len(q):
            return np.zeros(0, dtype=bool)
        known = self.precedents.setdefault(tuple(contact.limb for contact in contacts), Precedents())
        return static_feasible(self.robot, self.wall, q, contacts, precedents=known)

    def branches(self, q: Vector) -> tuple[int, ...]:
        """The branch of every limb at the configuration `q`, shape (nq,).

        Without inverse kinematics it says which way the limb's joint is turned from zero, which tells the two postures
        of a closed chain of two links apart; a limb without joints has but one.
        """
        return tuple(
            int(np.sin(q[limb.q]).min(initial=0.0) < 0) if inverse is None else inverse.branch(q[limb.q])
            for inverse, limb in zip(self.inverse, self.robot.limbs, strict=True)
        )

    def without_inverse(self, limbs: Iterable[int]) -> tuple[int, ...]:
        """Those of some limbs that have no inverse kinematics, in limb order."""
        return tuple(i for i in sorted(limbs) if self.inverse[i] is None)


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
        slack = np.full(len(u), np.inf)
        for i in self.solved:
            limb, inverse = robot.limbs[i], self.body.inverse[i]
            assert inverse is not None  # a chart without is not made
            solved, within = inverse.solve(pelvis, q[:, limb.q[: inverse.leading]], self.points[i])
            q[:, limb.q] = solved[:, self.branches[i]]
            slack = np.minimum(slack, within[:, self.branches[i]])
        return q, slack


AnyChart = Chart | NewtonChart


class Manifold:
    """The configurations on some contacts in which the robot is also clear, inside limits and balanced.

    Attributes:
        body: The robot.
        contacts: The contacts that hold.
        support: Where the centre of mass may be.
        margins: How far inside each limit.
    """

    def __init__(
        self, body: Body, contacts: Sequence[Contact], support: Region, margins: Margins | None = None
    ) -> None:
        self.body, self.contacts, self.support = body, tuple(contacts), support
        self.margins = margins or Margins()
        self.points = {c.limb: body.wall.point(c) for c in self.contacts}

    @cached_property
    def balanced(self) -> Region:
        """The support less its margin."""
        return self.support.shrunk(self.margins.balance)

    def balance(self, q: Vector) -> Vector:
        """How far the centre of mass is from every border of its support [m], shape (K, m); negative outside.

        Without the margin.

        Args:
            q: Configurations, shape (K, nq).
        """
        result: Vector = self.support.b - self.body.kinematics.center_of_mass(q) @ self.support.A.T
        return result

    @cached_property
    def global_charts(self) -> bool:
        """Whether charts are closed forms that reach as far as limbs do, rather than Newton's."""
        return len(self.body.without_inverse(self.points)) < 2

    @cached_property
    def rigid(self) -> bool:
        """Whether the contacts leave no freedom, but at singular configurations: postures are isolated points."""
        return int(self.body.robot.plant.num_positions()) <= self.body.robot.dimension * len(self.points)

    def chart(self, q: Vector, root: int | None = None) -> AnyChart:
        """The chart around the configuration `q`, shape (nq,).

        Args:
            q: The configuration; it keeps the contacts.
            root: The holding limb to root the chart at, or None for where it must be, if anywhere.
        """
        lacking, branches = self.body.without_inverse(self.points), self.body.branches(q)
        if len(lacking) > 1:
            return self.newton_chart(q)
        return Chart(self.body, self.points, branches, lacking[0] if lacking else root)

    def newton_chart(self, q: Vector) -> NewtonChart:
        """The local chart around the configuration `q`, shape (nq,), that Newton's method makes for any robot."""
        return NewtonChart(self.body, self.points, self.body.branches(q), q)

    def slack(self, q: Vector) -> Vector:
        """By how much configurations on the contacts are feasible beyond the margins, shape (K,); negative if not.

        The least of: distance to joint limits [rad], to the border of the support [m] and to collision [m].
        """
        kinematics = self.body.kinematics
        poses: list[Pose] = kinematics.poses(q)
        result = self.balanced.room(kinematics.center_of_mass(q, poses))
        result = np.minimum(result, kinematics.within_limits(q, self.margins.joint))
        # Distances cost the most, so only where the rest holds.
        good = np.flatnonzero(result >= 0)
        if len(good):
            chosen = [Pose(pose.rotation[good], pose.origin[good]) for pose in poses]
            result[good] = np.minimum(result[good], self.body.clearance(chosen) - self.margins.clearance)
        return result

    def carried(self, q: Vector) -> NDArray[np.bool_]:
        """Which configurations on the contacts, shape (K, nq), the motors can hold still, shape (K,).

        Motors that are not weak are taken to hold whatever is balanced; `climber.programs.torque` asks at every sample
        of a motion.
        """
        if not self.body.robot.weak:
            return np.ones(len(q), dtype=bool)
        return self.body.held(q, self.contacts)

    def feasible(self, chart: AnyChart, u: Vector) -> NDArray[np.bool_]:
        """Which chart coordinates `u`, shape (K, num_coordinates), are feasible; shape (K,), bool."""
        q, reach = chart.expand(u)
        good = reach >= self.margins.reach
        if good.any():
            good[good] = self.slack(q[good]) >= 0
            good[good] = self.carried(q[good])
        return good
