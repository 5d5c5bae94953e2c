"""The closed-chain manifold of a stance: every configuration that keeps its contacts.

Charts parameterise it: in closed form (`climber.chart`) or, where two holding limbs have no inverse kinematics, by
Newton's method (`climber.newton`), and then they are local. A configuration on it is feasible if the robot is clear,
inside its limits and balanced as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from climber.balance import Region
from climber.chart import Chart
from climber.clearance_space import clearance_of
from climber.inverse import limb_inverse
from climber.kinematics import Kinematics, Pose
from climber.newton import NewtonChart
from climber.programs.carried import Precedents
from climber.programs.torque import static_feasible
from climber.robot import Robot
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
        poses = kinematics.link_poses(q)
        result = self.balanced.room(kinematics.center_of_mass(q, poses))
        result = np.minimum(result, kinematics.within_limits(q, self.margins.joint))
        # Distances cost the most, so only where the rest holds.
        good = np.flatnonzero(result >= 0)
        if len(good):
            chosen = Pose(poses.rotation[good], poses.origin[good])
            result[good] = np.minimum(result[good], self.body.clearance(chosen.apart) - self.margins.clearance)
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
