"""Inverse kinematics of one limb, for many pelvis poses at a time, with every branch of the solution.

A limb of a planar robot is two links, one of a robot in space two links that turn about parallel axes and a third that
pitches out of their plane. Both come down to a triangle. A limb that is neither has none in closed form, and Newton's
method takes its place (`climber.newton`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from climber.exceptions import ModelError
from climber.kinematics import LimbChain, Pose
from climber.limb import Limb
from climber.stance import Vector

SQUARE = 1e-9  # [rad] axes nearer to parallel, or to a right angle, than this are so


class LimbInverse(Protocol):
    """Joint angles that put a foot on a point.

    Attributes:
        branches: How many solutions a reachable point has.
        leading: How many joints nearest the pelvis are given rather than solved for.
        room_names: What each number of `room` is about, as a condition that it is not negative.
    """

    branches: int
    leading: int
    room_names: tuple[str, ...]

    @property
    def levels(self) -> tuple[float, float]:
        """Between which heights along the pelvis's z the foot can be, from where the limb begins [m].

        These are bounds: infinite for a limb that leaves its plane.
        """
        ...

    def solve(self, pelvis: Pose, leading: Vector, target: Vector) -> tuple[Vector, Vector]:
        """Solves for the joints behind the leading ones.

        Args:
            pelvis: K poses of the pelvis.
            leading: The leading joints' angles [rad], shape (K, leading).
            target: Where the foot must be in W [m], shape (3,).

        Returns:
            All joint angles [rad], shape (K, branches, num_joints), and by how much the target is within reach [m],
            shape (K, branches), negative where it is not (the angles are then those of the limb that comes nearest
            with its links in line).
        """
        ...

    def branch(self, q: Vector) -> int:
        """The branch that the joint angles `q` [rad], shape (num_joints,), lie on."""
        ...

    def room(self, parent: Pose, target: Vector, branch: int) -> Vector:
        """What `solve` takes the least of as the reach, each smooth where it is positive.

        Args:
            parent: K poses of the link that carries the first joint solved for.
            target: Where the foot must be in W [m], shape (3,), or (K, 3).
            branch: The branch.

        Returns:
            Distances [m], shape (K, len(room_names)).
        """
        ...

    def bend(self, branch: int, margin: float) -> tuple[int, float, float]:
        """The joint that bends, as a place in the limb's, and its range on a branch [rad].

        Args:
            branch: The branch.
            margin: The range leaves out where the limb is so near to its longest and shortest [m].
        """
        ...


def _parent(chain: LimbChain, pelvis: Pose, leading: Vector) -> Pose:
    """Poses of the link that carries the first joint behind the leading ones."""
    return chain.links(pelvis, leading)[-1] if leading.shape[1] else pelvis


def _bends(distance: Vector, a: Vector | float, b: Vector | float) -> Vector:
    """The bend psi of two links from 0 to pi at which their ends are `distance` apart; straight or folded beyond."""
    cosine = (distance**2 - a**2 - b**2) / (2 * a * b)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


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

    room_names: tuple[str, ...] = ("not folded too far", "not stretched too far")

    @property
    def levels(self) -> tuple[float, float]:
        """See `LimbInverse.levels`: not bounded, as a planar robot's limbs need no bounds."""
        return -np.inf, np.inf

    @property
    def extent(self) -> tuple[float, float]:
        """Least and greatest distance of the foot from the first solved joint [m]."""
        return abs(self._length_a - self._length_b), self._length_a + self._length_b

    def _towards(self, parent: Pose, target: Vector) -> Vector:
        """From the first solved joint to the target in the parent's x-y plane [m], shape (K, 2)."""
        offset = target - parent.point(self._chain.steps[self.leading].origin)
        result: Vector = np.einsum("kji,kj->ki", parent.rotation, offset)[:, :2]
        return result

    def room(self, parent: Pose, target: Vector, branch: int) -> Vector:
        """See `LimbInverse.room`."""
        distance = np.linalg.norm(self._towards(parent, target), axis=1)
        least, greatest = self.extent
        return np.stack([distance - least, greatest - distance], axis=1)

    def solve(self, pelvis: Pose, leading: Vector, target: Vector) -> tuple[Vector, Vector]:
        """See `LimbInverse.solve`."""
        d = self._towards(_parent(self._chain, pelvis, leading), target)
        distance = np.linalg.norm(d, axis=1)
        least, greatest = self.extent
        slack = np.minimum(greatest - distance, distance - least)
        bend = _bends(distance, self._length_a, self._length_b)
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
        return q, np.stack([slack, slack], axis=1)

    def branch(self, q: Vector) -> int:
        """See `LimbInverse.branch`."""
        return int(np.sin(self._bend + self._sense_2 * q[-1]) < 0)

    def bend(self, branch: int, margin: float) -> tuple[int, float, float]:
        """See `LimbInverse.bend`: a limb's reach depends on nothing but the bend of its last joint."""
        least, greatest = self.extent
        psi = _bends(np.array([least + margin, greatest - margin]), self._length_a, self._length_b)
        angles = self._sense_2 * ((-psi if branch else psi) - self._bend)
        angles -= 2 * np.pi * np.round((angles - self._middle[1]) / (2 * np.pi))
        return self.leading + 1, float(angles.min()), float(angles.max())


class TwoLinkInverses:
    """Several limbs of two joints at once, each on one branch: what a call costs counts for more than what it computes.

    See `TwoLinkInverse`, whose numbers are along the limbs here.
    """

    def __init__(self, inverses: Sequence[TwoLinkInverse], branches: Sequence[int]) -> None:
        if any(inverse.leading for inverse in inverses):
            raise ValueError("a limb has joints that are given")
        self._shoulders = np.stack([inverse._chain.steps[0].origin for inverse in inverses], axis=1)  # (3, L)
        self._a = np.array([inverse._length_a for inverse in inverses])
        self._b = np.array([inverse._length_b for inverse in inverses])
        self._least, self._greatest = np.array([inverse.extent for inverse in inverses]).T
        self._sign = np.where(np.array(branches) == 1, -1.0, 1.0)
        self._angle_a = np.array([inverse._angle_a for inverse in inverses])
        self._bend = np.array([inverse._bend for inverse in inverses])
        self._sense_1 = np.array([inverse._sense_1 for inverse in inverses])
        self._sense_2 = np.array([inverse._sense_2 for inverse in inverses])
        self._middle = np.stack([inverse._middle for inverse in inverses])

    def solve(self, pelvis: Pose, targets: Vector) -> tuple[Vector, Vector]:
        """Joint angles that put feet on points.

        Args:
            pelvis: K poses of the pelvis.
            targets: Where the feet must be in W [m], shape (L, 3).

        Returns:
            The angles [rad], shape (K, L, 2), and by how much targets are within reach [m], shape (K, L).
        """
        offset = targets - pelvis.origin[:, None] - np.swapaxes(pelvis.rotation @ self._shoulders, 1, 2)
        d = offset @ pelvis.rotation
        distance = np.sqrt(d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1])
        psi = self._sign * _bends(distance, self._a, self._b)
        foot = np.arctan2(self._b * np.sin(psi), self._a + self._b * np.cos(psi))
        towards = np.arctan2(d[..., 1], d[..., 0])
        angles = (self._sense_1 * (towards - foot - self._angle_a), self._sense_2 * (psi - self._bend))
        q = np.stack(angles, axis=-1)
        q -= 2 * np.pi * np.round((q - self._middle) / (2 * np.pi))
        return q, np.minimum(self._greatest - distance, distance - self._least)


class PitchingInverse:
    """Closed form for two joints about parallel axes n and a third about an axis m across them.

    Seen along n, the limb is two links: a, from the first joint to the second, and b, from there to the foot, whose
    length depends on the pitch p of the third joint. What p must be follows from how far along n the foot is,

        h = f_n cos p - f_t sin p = r cos(p - delta),   so   p = delta +- arccos(h / r),

    with f the last link in coordinates along m, n and t = m x n, at p = 0. What is left is that of `TwoLinkInverse`.
    Four branches: the elbow's bend from a to b is positive or negative (0 or 1), and p is on one side of delta or the
    other (plus 2 for the negative side). A side that the limits of the third joint rule out is left out.
    """

    room_names: tuple[str, ...] = ("not too low", "not too high", "not folded too far", "not stretched too far")

    def __init__(self, limb: Limb, chain: LimbChain) -> None:
        if not self.fits(chain):
            raise ModelError(f"limb {limb.name!r}: the last joints must be two about parallel axes and one across")
        self.leading = len(chain.steps) - 3
        self._chain = chain
        shoulder, elbow, wrist = chain.steps[-3:]
        first = shoulder.c0 + shoulder.c2
        second = first @ (elbow.c0 + elbow.c2)
        third = second @ (wrist.c0 + wrist.c2)
        n, m = shoulder.axis, second @ wrist.axis
        # Coordinates of the parent link along t, m, n with the joints at zero: a right-handed system.
        t = np.cross(m, n)
        self._axes = np.stack([t, m, n])
        self._sense_2 = float(np.sign(n @ first @ elbow.axis))
        a, c, f = (self._axes @ x for x in (first @ elbow.origin, second @ wrist.origin, third @ chain.foot))
        self._length_a, self._angle_a = float(np.hypot(a[0], a[1])), float(np.arctan2(a[1], a[0]))
        self._height = float(a[2] + c[2])
        self._across, self._offset = f, c  # in link 2's coordinates, from joint 3 and from joint 2
        self._radius, self._delta = float(np.hypot(f[0], f[2])), float(np.arctan2(-f[0], f[2]))
        if min(self._length_a, self._radius) < SQUARE:
            raise ModelError(f"limb {limb.name!r}: its joints and its foot must lie apart")
        lower, upper = limb.one_turn
        self._middle = (lower[-3:] + upper[-3:]) / 2
        self._sides = [
            side
            for side in (1.0, -1.0)
            if any(
                min(upper[-1], high + turn) - max(lower[-1], low + turn) > SQUARE
                for low, high in [sorted((self._delta, self._delta + side * np.pi))]
                for turn in 2 * np.pi * np.arange(-2, 3)
            )
        ]
        self.branches = 2 * len(self._sides)

    @staticmethod
    def fits(chain: LimbChain) -> bool:
        """Whether the last three joints are of this kind."""
        if len(chain.steps) < 3:
            return False
        shoulder, elbow, wrist = chain.steps[-3:]
        first = shoulder.c0 + shoulder.c2
        n, second = shoulder.axis, first @ (elbow.c0 + elbow.c2)
        return bool(abs(abs(n @ first @ elbow.axis) - 1) < SQUARE and abs(n @ second @ wrist.axis) < SQUARE)

    @property
    def levels(self) -> tuple[float, float]:
        """See `LimbInverse.levels`: the first two joints keep to a plane, if it is the pelvis's."""
        n = self._axes[2]
        if self.leading or abs(abs(n[2]) - 1) > SQUARE:
            return -np.inf, np.inf
        middle = float(n[2]) * self._height
        return middle - self._radius, middle + self._radius

    def _outer(self, pitch: Vector) -> tuple[Vector, Vector]:
        """Length [m] and direction [rad] of link b, seen along n, with the second joint at zero; shape of `pitch`."""
        f = self._across
        t = self._offset[0] + f[0] * np.cos(pitch) + f[2] * np.sin(pitch)
        m = self._offset[1] + f[1]
        return np.hypot(t, m), np.arctan2(m, t)

    def _towards(self, parent: Pose, target: Vector) -> Vector:
        """From the first solved joint to the target along t, m and n [m], shape (K, 3)."""
        offset = target - parent.point(self._chain.steps[self.leading].origin)
        result: Vector = np.einsum("kji,kj->ki", parent.rotation, offset) @ self._axes.T
        return result

    def _pitch(self, d: Vector, side: float) -> Vector:
        """The pitch at which the foot is as far along n as `d`, shape (K, 3), asks [rad], shape (K,)."""
        height = np.clip((d[:, 2] - self._height) / self._radius, -1.0, 1.0)
        result: Vector = self._delta + side * np.arccos(height)
        return result

    def room(self, parent: Pose, target: Vector, branch: int) -> Vector:
        """See `LimbInverse.room`."""
        d = self._towards(parent, target)
        length, _ = self._outer(self._pitch(d, self._sides[branch // 2]))
        distance, height = np.hypot(d[:, 0], d[:, 1]), d[:, 2] - self._height
        return np.stack(
            [
                height + self._radius,
                self._radius - height,
                distance - np.abs(self._length_a - length),
                self._length_a + length - distance,
            ],
            axis=1,
        )

    def solve(self, pelvis: Pose, leading: Vector, target: Vector) -> tuple[Vector, Vector]:
        """See `LimbInverse.solve`."""
        d = self._towards(_parent(self._chain, pelvis, leading), target)
        distance, towards = np.hypot(d[:, 0], d[:, 1]), np.arctan2(d[:, 1], d[:, 0])
        too_far = self._radius - np.abs(d[:, 2] - self._height)
        q, slack = np.empty((len(d), self.branches, self.leading + 3)), np.empty((len(d), self.branches))
        q[:, :, : self.leading] = leading[:, None, :]
        for number, side in enumerate(self._sides):
            pitch = self._pitch(d, side)
            length, angle = self._outer(pitch)
            reach = np.minimum(self._length_a + length - distance, distance - np.abs(self._length_a - length))
            bend = _bends(distance, self._length_a, length)
            for branch, psi in ((2 * number, bend), (2 * number + 1, -bend)):
                foot = np.arctan2(length * np.sin(psi), self._length_a + length * np.cos(psi))
                q[:, branch, -3] = towards - foot - self._angle_a
                q[:, branch, -2] = self._sense_2 * (psi + self._angle_a - angle)
                q[:, branch, -1] = pitch
                slack[:, branch] = np.minimum(reach, too_far)
        q[:, :, -3:] -= 2 * np.pi * np.round((q[:, :, -3:] - self._middle) / (2 * np.pi))
        return q, slack

    def branch(self, q: Vector) -> int:
        """See `LimbInverse.branch`; on a side that the limits rule out, that of the elbow alone."""
        _, angle = self._outer(q[-1])
        elbow = int(np.sin(float(angle) - self._angle_a + self._sense_2 * q[-2]) < 0)
        side = 1.0 if np.sin(q[-1] - self._delta) >= 0 else -1.0
        return elbow + 2 * (self._sides.index(side) if side in self._sides else 0)

    def bend(self, branch: int, margin: float) -> tuple[int, float, float]:
        """See `LimbInverse.bend`: of the second joint, with the last link stretched out."""
        length, angle = self._outer(np.array(self._delta + self._sides[branch // 2] * np.pi / 2))
        least, greatest = abs(self._length_a - float(length)), self._length_a + float(length)
        psi = _bends(np.array([least + margin, greatest - margin]), self._length_a, float(length))
        angles = self._sense_2 * ((-psi if branch % 2 else psi) + self._angle_a - float(angle))
        angles -= 2 * np.pi * np.round((angles - self._middle[1]) / (2 * np.pi))
        return self.leading + 1, float(angles.min()), float(angles.max())


def limb_inverse(planar: bool, limb: Limb, chain: LimbChain) -> LimbInverse | None:
    """The inverse kinematics of a limb in closed form, or None if it has none: too few joints, or at odd angles.

    Raises:
        ModelError: If a planar robot's limb does not move in the plane.
    """
    if planar:
        return TwoLinkInverse(limb, chain) if len(limb.q) > 1 else None
    return PitchingInverse(limb, chain) if PitchingInverse.fits(chain) else None
