"""Where the pelvis can be for the centre of mass to be supported: necessary conditions, for many stances at a time.

A limb's links lie between its hip and its foot. The centre of mass of one of them is at most s from the hip and at most
e from the foot, the lengths of chain on either side; its abscissa is therefore at least max(hip - s, foot - e) and at
most min(hip + s, foot + e). Summed over all bodies, these are bounds on the robot's centre of mass that rise with the
pelvis's abscissa, one convex, the other concave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from climber.exceptions import ModelError
from climber.kinematics import Kinematics
from climber.programs.support import BALANCE
from climber.robot import Indices, Robot
from climber.stance import Vector
from climber.stance_graph import StanceGraph
from climber.wall import Wall

NEWTON_STEPS = 4  # each leaves a valid bound; the last ones change little
ANYWHERE = 1e3  # [m] wider than any wall
ROUNDING = 1e-9  # [m]


@dataclass(frozen=True)
class MassBounds:
    """A robot's bodies as far as they matter here.

    Attributes:
        mass: Of the whole robot [kg].
        pelvis_mass: Of the pelvis [kg].
        pelvis_center: Its centre of mass in its own frame [m], shape (2,).
        swing: Distance of each hip from the pelvis's origin [m], shape (n,).
        limb: The limb that each link belongs to, shape (B,).
        masses: Mass of each link [kg], shape (B,).
        from_hip: Most that its centre of mass can be from the hip [m], shape (B,).
        from_foot: Most that it can be from the foot [m], shape (B,).
    """

    mass: float
    pelvis_mass: float
    pelvis_center: Vector
    swing: Vector
    limb: Indices
    masses: Vector
    from_hip: Vector
    from_foot: Vector

    @classmethod
    def of(cls, robot: Robot) -> MassBounds | None:
        """Those of a robot; None if it is not a planar star of limbs with joints."""
        if not robot.planar:
            return None
        try:
            kinematics = Kinematics(robot)
        except ModelError:
            return None
        rows = []
        for i, chain in enumerate(kinematics.chains):
            if not chain.steps:
                return None
            ends = [*(step.origin for step in chain.steps[1:]), chain.foot]  # of each link, in its own frame
            lengths = np.linalg.norm(ends, axis=1)
            to_center = np.linalg.norm(chain.centers, axis=1)
            beyond = np.linalg.norm(np.array(ends) - chain.centers, axis=1)
            before = np.cumsum(lengths) - lengths
            after = lengths.sum() - np.cumsum(lengths)
            columns = zip(chain.masses, before + to_center, beyond + after, strict=True)
            rows += [(i, mass, s, e) for mass, s, e in columns]
        limb, masses, from_hip, from_foot = (np.array(column) for column in zip(*rows, strict=True))
        swing = np.linalg.norm([limb.hip[:2] for limb in robot.limbs], axis=1)
        return cls(
            robot.mass,
            kinematics.pelvis_mass,
            kinematics.pelvis_center[:2],
            swing,
            limb,
            masses,
            from_hip,
            from_foot,
        )

    def pelvis_range(
        self, angle: Vector, hips: Vector, feet: Vector, patches: Vector, intervals: Vector, half: float
    ) -> tuple[Vector, Vector]:
        """Between which abscissas the pelvis's origin is, if the centre of mass is inside an interval.

        Args:
            angle: Of the pelvis [rad], shape (K,).
            hips: Abscissas of the hips relative to the pelvis's origin at that angle [m], shape (K, n).
            feet: Abscissas of the holds [m], shape (K, n).
            patches: Half widths of the holds [m], shape (K, n).
            intervals: Where the centre of mass must be [m], shape (K, 2).
            half: How far the angle may be off [rad].

        Returns:
            Least and greatest abscissa [m], shape (K,) each.
        """
        own = np.cos(angle) * self.pelvis_center[0] - np.sin(angle) * self.pelvis_center[1]
        wobble = half * (
            self.pelvis_mass * float(np.linalg.norm(self.pelvis_center)) + float(self.masses @ self.swing[self.limb])
        )
        right = self._greatest(own, hips, feet, patches, intervals[:, 1], wobble)
        left = -self._greatest(-own, -hips, -feet, patches, -intervals[:, 0], wobble)
        return left - ROUNDING, right + ROUNDING

    def _greatest(
        self, own: Vector, hips: Vector, feet: Vector, patches: Vector, upper: Vector, wobble: float
    ) -> Vector:
        """The greatest x with M upper + wobble >= m (x + own) + sum of m_j max(x + hip_j - s_j, foot_j - e_j), (K,).

        The right-hand side is convex and rises with x, so Newton's steps from where it is too large stay there.
        """
        from_hip = (hips[:, self.limb] - self.from_hip).T  # (B, K)
        from_foot = (feet[:, self.limb] - self.from_foot - patches[:, self.limb]).T
        target = self.mass * upper + wobble - self.pelvis_mass * own
        x: Vector = (target - self.masses @ from_hip) / self.mass
        for _ in range(NEWTON_STEPS):
            hanging = x + from_hip >= from_foot
            excess = self.pelvis_mass * x + self.masses @ np.where(hanging, x + from_hip, from_foot) - target
            slope = self.pelvis_mass + self.masses @ hanging
            x = x - np.divide(excess, slope, out=np.zeros_like(x), where=slope > 0.0)
        return x


def transition_intervals(graph: StanceGraph, wall: Wall, arriving: NDArray[np.int8]) -> Vector:
    """Where the centre of mass must be when a limb lets go of a stance, or has just completed it.

    That is where it is supported with and without that limb, feet anywhere on their patches. Forces that balance the
    weight W do so wherever on the patches they act; shifted by up to w along the patches they move the centre of mass
    by at most w times the sum of their normal parts, over W. A force inside its friction cone lifts by at least
    k = n_y - mu |n_x| times its normal part, so that sum is at most W / min k.

    Args:
        graph: The stance graph.
        wall: The wall.
        arriving: The limb that each edge has moved, in the stance it leads to, shape (E,).

    Returns:
        Intervals [m], shape (V, n, 2); NaN where they are empty, and for limbs that no move moves there.
    """
    V, n = graph.stances.shape
    without = np.full((V, n, 2), np.nan)
    without[graph.tail, graph.limb] = without[graph.head, arriving] = graph.support
    lift = wall.normals[:, 1] - np.array([hold.friction for hold in wall.holds]) * np.abs(wall.normals[:, 0])
    lift[[hold.grip != "friction" for hold in wall.holds]] = 0.0
    lift = lift[graph.stances].min(axis=1)  # (V,)
    widest = np.array([hold.half_width for hold in wall.holds])[graph.stances].max(axis=1)
    most = np.where(widest > 0.0, ANYWHERE, 0.0)
    shift = np.minimum(np.divide(widest, lift, out=most.copy(), where=lift > 0.0), ANYWHERE)[:, None] + BALANCE
    lower = np.maximum(without[..., 0], graph.stance_support[:, None, 0]) - shift
    upper = np.minimum(without[..., 1], graph.stance_support[:, None, 1]) + shift
    result: Vector = np.clip(np.stack([lower, upper], axis=-1), -ANYWHERE, ANYWHERE)  # a floor holds it anywhere
    result[~(lower <= upper)] = np.nan
    return result
