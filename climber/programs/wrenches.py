"""Sets of contacts in space as programs over double cones: force balance, and where the centre of mass is.

With contacts at p_i and forces f_i, the weight `pull` = W d downwards, d its unit direction, and all
measured from the mean p_0 of the contacts,

    sum f_i + pull = 0                                    force balance
    d . sum (p_i - p_0) x f_i = 0                         turning about the direction of gravity
    W e . (c - p_0) = (d x e) . sum (p_i - p_0) x f_i     for e across gravity

the last being the rest of torque balance, which says where across gravity the centre of mass c is (Bretl 2006, B1-B3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climber.programs.cone_solver import maximise_by_clarabel
from climber.programs.double_cones import ConePrograms, ConeSolutions, Mask, Stop, greatest, maximise
from climber.programs.forces import ContactForces
from climber.programs.sections import Section
from climber.robot import Indices
from climber.stance import Vector

BALANCE = 1e-9  # contacts that can carry this fraction less than the load count as carrying it
ROOMY = 1.1  # of the load; contacts that can carry this carry it well inside their limits
WIDER = 1e-8  # by this fraction limits are widened where contacts can only just carry the load
LEAST_ARM = 1e-3  # [m] moments are measured in weights times the greatest arm, or this


def across(pull: Vector) -> Vector:
    """Two unit vectors across gravity and each other, the first as near to x as can be, shape (2, 3)."""
    down = pull / np.linalg.norm(pull)
    axis = np.array([1.0, 0.0, 0.0]) if abs(down[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = axis - (axis @ down) * down
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(down, first)])


@dataclass(frozen=True)
class Wrenches:
    """M sets of contacts whose multiples are scaled to m unit double cones.

    Attributes:
        E: Force over weight and turn over weight and arm of each multiple, shape (4, 3, m, M).
        b: What they must come to, shape (4, M).
        place: Where they put the centre of mass across gravity [m], shape (2, 3, m, M).
        origin: Where it is without them [m], shape (2, M).
        arm: Length that turns are measured in [m], shape (M,).
        weight: The weight [N].
        section: What stands for the circle across the cones.
    """

    E: Vector
    b: Vector
    place: Vector
    origin: Vector
    arm: Vector
    weight: float
    section: Section

    @classmethod
    def of(cls, points: Vector, forces: ContactForces, pull: Vector) -> Wrenches:
        """Those of contacts in space.

        Args:
            points: Contact points in W [m], shape (M, k, 3).
            forces: Forces of the contacts, leading shape (M, k).
            pull: The weight in W [N], shape (3,).
        """
        M, k = forces.lower.shape[:2]
        weight = float(np.linalg.norm(pull))
        down, basis = pull / weight, across(pull)
        center = points.mean(axis=1)
        arms = points - center[:, None]
        arm = np.maximum(np.linalg.norm(arms, axis=2).max(axis=1, initial=0.0), LEAST_ARM)
        middle, half = 0.5 * (forces.upper + forces.lower), 0.5 * (forces.upper - forces.lower)
        wide = np.zeros((M, k), dtype=bool) if forces.round is None else forces.round
        half[..., :2] = np.where(wide[..., None], half[..., 2:3], half[..., :2])
        constant = forces.offset + np.einsum("mkap,mkp->mka", forces.generators, middle)
        twist = np.cross(arms, constant)
        scaled = forces.generators * half[..., None, :]  # (M, k, 3, p)
        moment = np.cross(arms[:, :, None], np.swapaxes(scaled, 2, 3))  # (M, k, p, 3)
        turns, at_rest = np.cross(down, basis) / weight, twist.sum(axis=1)
        rows = np.concatenate(
            [
                np.moveaxis(scaled, 2, 0) / weight,  # (3, M, k, p)
                (moment @ down)[None] / (weight * arm[:, None, None]),
                np.moveaxis(moment @ turns.T, 3, 0),
            ]
        )
        cones = _cones(rows, wide)
        b = np.concatenate([-(pull + constant.sum(axis=1)).T / weight, -(at_rest @ down)[None] / (weight * arm)])
        return cls(cones[:4], b, cones[4:], basis @ center.T + turns @ at_rest.T, arm, weight, forces.section)

    def __len__(self) -> int:
        return int(self.b.shape[-1])

    def capacity(self, decided: bool = False) -> tuple[Vector, Vector, Vector, Vector]:
        """How much of the load the contacts can carry.

        The load scaled by 0 <= theta <= 2, how great can theta be? That is a program that zero forces satisfy.

        Args:
            decided: Stop as soon as it is clear whether all of it; else go on to forces well inside the limits.

        Returns:
            A part of the load that can be carried and one that nothing beyond can be, shapes (M,); multiples for all
            of the load, where they exist, shape (3, m, M); multipliers that prove the second part, shape (4, M).
        """
        u, _, m, M = self.E.shape
        E = np.concatenate([self.E, np.zeros((u, 3, 1, M))], axis=2)
        E[:, 2, m] = -2.0 * self.b
        a = np.zeros((3, m + 1, M))
        a[2, m] = 2.0
        enough = 1.0 + 1e-6 if decided else ROOMY

        def stop(value: Vector, bound: Vector) -> Mask:
            done: Mask = (value >= enough) | (bound < 1.0 - BALANCE) | (bound - value < 0.5 * BALANCE)
            return done

        programs = ConePrograms(E, np.zeros_like(self.b), a, self.section)
        found = self._maximise(programs, np.zeros_like(a), stop)
        return found.value, found.bound, found.x[:, :m] / np.maximum(found.value, 1e-12), -found.y

    def _maximise(self, programs: ConePrograms, start: Vector, stop: Stop) -> ConeSolutions:
        if self.section.edges:
            return maximise_by_clarabel(programs, start)
        found = maximise(programs, start, stop)
        doubtful = np.flatnonzero(~stop(found.value, found.bound))
        if len(doubtful):
            found.improve(doubtful, maximise_by_clarabel(programs[doubtful], start[..., doubtful]))
        return found

    def reach(self, sets: Indices, direction: Vector, start: Vector, gap: float) -> tuple[Vector, Vector]:
        """How far the centre of mass can be in a direction across gravity.

        Args:
            sets: Which sets of contacts, shape (n,).
            direction: In the coordinates of `across`, shape (n, 2).
            start: Multiples strictly inside their cones that carry the load, shape (3, m, n).
            gap: How near the bound should be to the reach of the point [m].

        Returns:
            Places that can be held, in the coordinates of `across` [m], shape (n, 2), and bounds on reach [m], (n,).
        """
        a = np.einsum("ni,icmn->cmn", direction, self.place[..., sets])
        programs = ConePrograms(self.E[..., sets], self.b[:, sets], a, self.section)
        found = self._maximise(programs, start, lambda value, bound: bound - value <= gap)
        origin = self.origin[:, sets]
        point = origin + np.einsum("icmn,cmn->in", self.place[..., sets], found.x)
        return point.T, found.bound + (direction.T * origin).sum(axis=0)

    def with_center(self, place: Vector) -> Wrenches:
        """The same with the centre of mass tied to a place, in the coordinates of `across` [m], shape (2, M)."""
        E = np.concatenate([self.E, self.place / self.arm])
        return replace(self, E=E, b=np.concatenate([self.b, (place - self.origin) / self.arm]))

    def widened(self, by: Vector) -> Wrenches:
        """The same with limits wider by a fraction of their range, shape (M,)."""
        return replace(self, E=self.E * (1.0 + by), place=self.place * (1.0 + by))

    def shortfall(self, y: Vector) -> tuple[Vector, Vector, Vector]:
        """What multipliers prove of contacts that cannot carry the load.

        Returns:
            Unit directions in W, shape (M, 3), turns about gravity that go with them [1/m], shape (M,), and by how much
            the load exceeds the contacts' forces and turns along them [N], shape (M,).
        """
        force, turn = y[:3], y[3] / self.arm
        size = np.linalg.norm(force, axis=0)
        size = np.where(size > 1e-9 * np.abs(turn), size, np.maximum(np.abs(turn), 1e-300))
        most = greatest((self.E * y[:, None, None]).sum(axis=0), self.section).sum(axis=0)
        return (force / size).T, turn / size, ((y * self.b).sum(axis=0) - most) * self.weight / size


def _cones(rows: Vector, wide: Mask) -> Vector:
    """Multiples as unit double cones: (r, M, k, 3) to (r, 3, m, M); those of boxes are intervals, one cone each."""
    if wide.all():
        return _last(rows)
    cones = np.zeros((*rows.shape, 3))
    for j in range(3):
        cones[..., j, 2] = rows[..., j] * ~wide
    cones[..., 0, :] += rows * wide[..., None]
    return _last(cones.reshape(*rows.shape[:2], -1, 3))


def _last(rows: Vector) -> Vector:
    """(r, M, m, 3) to (r, 3, m, M)."""
    return np.ascontiguousarray(rows.transpose(0, 3, 2, 1))
