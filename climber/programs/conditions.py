"""The conditions that make a configuration feasible, one by one, and their derivatives along a chart.

`Manifold.slack` is the least of them and tells whether; a program that moves configurations about needs each by itself,
because each is smooth where their least is not, and needs to know which way it grows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from climber.inverse import LimbInverse
from climber.kinematics import Pose
from climber.manifold import AnyChart, Manifold
from climber.programs.gaps import gaps_of
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


class Conditions:
    """Feasibility on a manifold as separate numbers, each at least zero where its condition is met.

    Attributes:
        names: What each is about: joints, centre of mass, reach of the limbs that hold, pairs of links, links and
            obstacles.
    """

    def __init__(self, manifold: Manifold, chart: AnyChart) -> None:
        self.manifold, self.chart = manifold, chart
        body, kinematics = manifold.body, manifold.body.kinematics
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
        self._gaps = gaps_of(body)
        joints, limbs = body.robot.joint_names, [body.robot.limbs[i].name for i in self._tied]
        rooms = [inverse.room_names for inverse, _ in self._inverse]
        reaches = [f"{limb} {what}" for limb, names in zip(limbs, rooms, strict=True) for what in names]
        self.names: tuple[str, ...] = (
            *(f"{joint} above its lower limit" for joint in joints),
            *(f"{joint} below its upper limit" for joint in joints),
            *manifold.balanced.names,
            *reaches,
            *self._gaps.names,
        )
        # How many of them are not distances between shapes.
        self._smooth = 2 * len(joints) + len(self._balanced) + len(reaches)

    def _joints_balance_reach(self, q: Vector, poses: Pose) -> Vector:
        """The conditions other than distances between shapes, shape (K, _smooth)."""
        kinematics, margins = self.manifold.body.kinematics, self.manifold.margins
        joints = q[:, kinematics.joint_q]
        center = kinematics.center_of_mass(q, poses)
        chart, links = self.chart, poses.apart
        rooms = [
            inverse.room(links[link], chart.points[i], chart.branches[i]) - margins.reach
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

    def least(self, u: Vector) -> Vector:
        """Every condition at the coordinates `u`, shape (K, n); shape (K, len(names)), inf where nothing is watched."""
        q, _ = self.chart.expand(u)
        poses = self.manifold.body.kinematics.link_poses(q)
        gaps = self._gaps.least(poses.apart) - self.manifold.margins.clearance
        return np.concatenate([self._joints_balance_reach(q, poses), gaps], axis=1)

    def linearised(self, u: Vector, near: float) -> Linearised:
        """Conditions to first order around the coordinates `u`, shape (K, n).

        Distances between shapes are included where they are less than `near` [m], segment by segment; their slopes
        are how fast the material points that are closest now move apart.
        """
        K, n = u.shape
        offsets = np.concatenate([np.zeros((1, n)), STEP * np.eye(n), -STEP * np.eye(n)])
        every = (offsets[:, None] + u).reshape(-1, n)  # the points themselves, then shifted each way
        q, _ = self.chart.expand(every)
        poses = self.manifold.body.kinematics.link_poses(q)
        smooth = self._joints_balance_reach(q, poses).reshape(2 * n + 1, K, -1)
        q = q.reshape(2 * n + 1, K, -1)

        def slope(values: Vector) -> Vector:
            """From values (2n + 1, ...) to derivatives (..., n)."""
            return np.moveaxis(values[1 : n + 1] - values[n + 1 :], 0, -1) / (2 * STEP)

        place, kind, distance, away = self._gaps.near(poses.apart, K, near + self.manifold.margins.clearance, slope)
        return Linearised(
            q[0],
            slope(q),
            np.concatenate([np.repeat(np.arange(K), self._smooth), place]),
            np.concatenate([np.tile(np.arange(self._smooth), K), self._smooth + kind]),
            np.concatenate([smooth[0].ravel(), distance - self.manifold.margins.clearance]),
            np.concatenate([slope(smooth).reshape(-1, n), away]),
        )
