"""Inverse kinematics of one limb, for many pelvis poses at a time, with every branch of the solution."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from climber.exceptions import ModelError
from climber.kinematics import LimbChain, Pose
from climber.robot import Limb
from climber.stance import Vector


class LimbInverse(Protocol):
    """Joint angles that put a foot on a point.

    Attributes:
        branches: How many solutions a reachable point has.
        leading: How many joints nearest the pelvis are given rather than solved for.
    """

    branches: int
    leading: int

    def solve(self, pelvis: Pose, leading: Vector, target: Vector) -> tuple[Vector, Vector]:
        """Solves for the joints behind the leading ones.

        Args:
            pelvis: K poses of the pelvis.
            leading: The leading joints' angles [rad], shape (K, leading).
            target: Where the foot must be in W [m], shape (3,).

        Returns:
            All joint angles [rad], shape (K, branches, num_joints), and by how much the target is within reach [m],
            shape (K,), negative where it is not (the angles are then those of the nearest straight limb).
        """
        ...


class TwoLinkInverse:
    """Closed form for the last two joints of a planar limb: the elbow bends one way (branch 0) or the other (1).

    With link vectors a (between the two joints) and b (to the foot), the foot is at distance d from the first of them,

        d^2 = |a|^2 + |b|^2 + 2 |a| |b| cos(psi),

    which fixes the elbow's bend psi, the angle from a to b, up to its sign. All is expressed in the frame P of the link
    that carries the first joint, so links' own frames may be turned or upside down in whatever way the model has them.
    """

    branches = 2

    def __init__(self, limb: Limb, chain: LimbChain) -> None:
        if len(chain.steps) < 2 or any(abs(abs(step.axis[2]) - 1) > 1e-9 for step in chain.steps):
            raise ModelError(f"limb {limb.name!r}: a planar limb needs at least two joints, all about z")
        self.leading = len(chain.steps) - 2
        self._chain = chain
        shoulder, elbow = chain.steps[-2:]
        # In P, with both joints at zero.
        first = shoulder.c0 + shoulder.c2
        a, b = first @ elbow.origin, first @ (elbow.c0 + elbow.c2) @ chain.foot
        self._sense_1, self._sense_2 = float(np.sign(shoulder.axis[2])), float(np.sign((first @ elbow.axis)[2]))
        self._length_a, self._length_b = float(np.hypot(a[0], a[1])), float(np.hypot(b[0], b[1]))
        if min(self._length_a, self._length_b) < 1e-9:
            raise ModelError(f"limb {limb.name!r}: the last two joints and the foot must lie apart in the x-y plane")
        self._angle_a = float(np.arctan2(a[1], a[0]))
        self._bend = float(np.arctan2(b[1], b[0])) - self._angle_a  # psi at zero
        lower, upper = limb.one_turn
        self._middle = (lower[-2:] + upper[-2:]) / 2

    @property
    def extent(self) -> tuple[float, float]:
        """Least and greatest distance of the foot from the first solved joint [m]."""
        return abs(self._length_a - self._length_b), self._length_a + self._length_b

    def solve(self, pelvis: Pose, leading: Vector, target: Vector) -> tuple[Vector, Vector]:
        """See `LimbInverse.solve`."""
        parent = self._chain.links(pelvis, leading)[-1] if self.leading else pelvis
        shoulder = self._chain.steps[self.leading].origin
        offset = target - parent.point(shoulder)
        d = np.einsum("kji,kj->ki", parent.rotation, offset)[:, :2]
        distance = np.linalg.norm(d, axis=1)
        least, greatest = self.extent
        slack = np.minimum(greatest - distance, distance - least)
        cosine = (distance**2 - self._length_a**2 - self._length_b**2) / (2 * self._length_a * self._length_b)
        bend = np.arccos(np.clip(cosine, -1.0, 1.0))
        q = np.empty((len(distance), 2, self.leading + 2))
        q[:, :, : self.leading] = leading[:, None, :]
        towards = np.arctan2(d[:, 1], d[:, 0])
        for branch, psi in enumerate((bend, -bend)):
            # From a to the foot, turned about the first joint.
            foot = np.arctan2(self._length_b * np.sin(psi), self._length_a + self._length_b * np.cos(psi))
            q[:, branch, -2] = self._sense_1 * (towards - foot - self._angle_a)
            q[:, branch, -1] = self._sense_2 * (psi - self._bend)
        # Of the equivalent angles take the one nearest the middle of the joint's range.
        q[:, :, -2:] -= 2 * np.pi * np.round((q[:, :, -2:] - self._middle) / (2 * np.pi))
        return q, slack

    def branch(self, q: Vector) -> int:
        """The branch that the joint angles `q` [rad], shape (num_joints,), lie on."""
        return int(np.sin(self._bend + self._sense_2 * q[-1]) < 0)
