"""Inverse kinematics of one limb, for many pelvis poses at a time, with every branch of the solution."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from climber.exceptions import ModelError
from climber.kinematics import JointStep, LimbChain, Pose
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


def _turn(step: JointStep) -> tuple[float, float]:
    """Offset [rad] and sense (+1 or -1) of a joint that turns about its parent's z axis."""
    rotation = step.c0 + step.c2
    return float(np.arctan2(rotation[1, 0], rotation[0, 0])), float(np.sign(step.axis[2]))


class TwoLinkInverse:
    """Closed form for the last two joints of a planar limb: the elbow bends one way (branch 0) or the other (1).

    With link vectors a (between the two joints) and b (to the foot), the foot is at distance d from the first joint with
    d^2 = |a|^2 + |b|^2 + 2 |a| |b| cos(psi), which fixes the elbow's bend psi up to its sign.
    """

    branches = 2

    def __init__(self, limb: Limb, chain: LimbChain) -> None:
        if len(chain.steps) < 2 or any(abs(abs(step.axis[2]) - 1) > 1e-9 for step in chain.steps):
            raise ModelError(f"limb {limb.name!r}: a planar limb needs at least two joints, all about z")
        self.leading = len(chain.steps) - 2
        self._chain = chain
        shoulder, elbow = chain.steps[-2:]
        (self._offset_1, self._sense_1), (self._offset_2, self._sense_2) = _turn(shoulder), _turn(elbow)
        self._a, self._b = elbow.origin[:2], chain.foot[:2]
        self._length_a, self._length_b = float(np.linalg.norm(self._a)), float(np.linalg.norm(self._b))
        self._angle_a, self._angle_b = (float(np.arctan2(p[1], p[0])) for p in (self._a, self._b))
        self._middle = (limb.lower + limb.upper) / 2

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
            turned = psi + self._angle_a  # direction of b in the frame of a
            chord = np.arctan2(
                self._a[1] + self._length_b * np.sin(turned), self._a[0] + self._length_b * np.cos(turned)
            )
            q[:, branch, -2] = self._sense_1 * (towards - chord - self._offset_1)
            q[:, branch, -1] = self._sense_2 * (turned - self._angle_b - self._offset_2)
        # Of the equivalent angles take the one nearest the middle of the joint's range.
        q[:, :, -2:] -= 2 * np.pi * np.round((q[:, :, -2:] - self._middle[-2:]) / (2 * np.pi))
        return q, slack

    def branch(self, q: Vector) -> int:
        """The branch that the joint angles `q` [rad], shape (num_joints,), lie on."""
        psi = self._sense_2 * q[-1] + self._offset_2 + self._angle_b - self._angle_a
        return int(np.sin(psi) < 0)
