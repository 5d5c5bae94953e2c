"""Poses of a planar robot's pelvis from which its limbs may reach their holds, drawn at random."""

from __future__ import annotations

import itertools
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from climber.stance import Vector

ROUNDING = 1e-9  # [m] nothing is called impossible for less than this


def enclosing_circles(points: Vector) -> tuple[Vector, Vector]:
    """Centres (K, 2) and radii (K,) of the smallest circles around the points (K, N, 2).

    By Helly's theorem the largest of the circles of all triples is the circle of all.
    """
    num = points.shape[1]
    if num == 1:
        return points[:, 0], np.zeros(len(points))
    best_center, best_radius = np.zeros((len(points), 2)), np.full(len(points), -1.0)

    def offer(center: Vector, radius: Vector, valid: NDArray[np.bool_]) -> None:
        better = valid & (radius > best_radius)
        best_center[better], best_radius[better] = center[better], radius[better]

    for i, j in itertools.combinations(range(num), 2):
        middle = (points[:, i] + points[:, j]) / 2
        offer(middle, np.linalg.norm(points[:, i] - middle, axis=1), np.ones(len(points), dtype=bool))
    for i, j, k in itertools.combinations(range(num), 3):
        a, b, c = points[:, i], points[:, j] - points[:, i], points[:, k] - points[:, i]
        twice = 2 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
        bb, cc = (b**2).sum(axis=1), (c**2).sum(axis=1)
        acute = (
            (bb + cc > ((b - c) ** 2).sum(axis=1)) & ((b * (b - c)).sum(axis=1) > 0) & ((c * (c - b)).sum(axis=1) > 0)
        )
        safe = np.where(np.abs(twice) > 1e-15, twice, 1.0)
        ux, uy = (c[:, 1] * bb - b[:, 1] * cc) / safe, (b[:, 0] * cc - c[:, 0] * bb) / safe
        offer(a + np.column_stack([ux, uy]), np.hypot(ux, uy), acute & (np.abs(twice) > 1e-15))
    return best_center, best_radius


class PlanarBases:
    """Base positions (x, y, angle) at which every hip is within a limb's length of its hold.

    Attributes:
        hips: Where the limbs that hold begin, in the pelvis's frame [m], shape (k, 3).
        lengths: How far they reach from there [m], shape (k,).
        points: Where they must reach to in W [m], shape (k, 3).
    """

    CELLS = 128  # of the pelvis's angle

    def __init__(self, hips: Vector, lengths: Vector, points: Vector) -> None:
        self.hips, self.lengths, self.points = hips, lengths, points

    @cached_property
    def _cells(self) -> tuple[Vector, Vector, Vector, float]:
        """For each cell of the pelvis's angle its middle, and the circle around where the hips would have the pelvis.

        At a fixed angle limb i reaches its hold iff the pelvis lies in a disk; the disks meet iff the smallest circle
        around their centres is no larger than they are. The last value is how large they are [m], with room for the
        angles in a cell, so that a cell whose circle is larger holds no solution at all.
        """
        step = 2 * np.pi / self.CELLS
        angle = -np.pi + step * (np.arange(self.CELLS) + 0.5)
        sin, cos = np.sin(angle)[:, None], np.cos(angle)[:, None]
        x, y, _ = self.hips.T
        hips = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        center, radius = enclosing_circles(self.points[:, :2] - hips)
        length = self.lengths.max() + np.linalg.norm(self.hips[:, :2], axis=1).max() * step / 2
        return np.asarray(angle, dtype=float), center, radius, float(length)

    @cached_property
    def _angles(self) -> tuple[Vector, Vector, Vector]:
        """Pelvis angles at which the hips could reach, with the centre and radius of where the pelvis may then be.

        Disks of radius L around points whose smallest circle has radius R meet within sqrt(L^2 - R^2) of its centre.
        """
        angle, center, radius, length = self._cells
        possible = radius <= length + ROUNDING
        spread = np.sqrt(np.maximum(length**2 - radius**2, 0.0))
        return angle[possible], center[possible], spread[possible]

    def unreachable(self, spare: float = 0.0) -> bool:
        """Whether it is certain that no base position lets all limbs reach their holds.

        Args:
            spare: The feet may each be so far from where `points` has them [m].
        """
        _, _, radius, length = self._cells
        return bool((radius > length + spare + ROUNDING).all())

    def draw(self, rng: np.random.Generator, count: int) -> Vector:
        """Draws base positions, shape (count, 3), or (0, 3) where there are none."""
        angle, center, spread = self._angles
        if not len(angle):
            return np.zeros((0, 3))
        weights = spread**2 + 1e-6
        cell = rng.choice(len(angle), size=count, p=weights / weights.sum())
        r, phi = spread[cell] * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
        base = np.empty((count, 3))
        base[:, :2] = center[cell] + (r * np.array([np.cos(phi), np.sin(phi)])).T
        base[:, 2] = angle[cell] + (rng.random(count) - 0.5) * 2 * np.pi / self.CELLS
        return base
