"""Poses in space of a robot's pelvis from which its limbs may reach their holds, drawn at random.

A climber's pelvis lies along the wall, in front of its feet and turned so that its hips are near them. Poses of that
kind are drawn most often, with its z axis across the plane that best fits the feet or along the direction that the
wall faces, but every pose that could do may be drawn: else not to have found a posture would say little.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from climber import floating
from climber.planar_bases import ROUNDING, enclosing_circles
from climber.stance import Vector

OVERSAMPLING = 4  # attitudes looked at for each pose drawn
TILT = 0.15  # [rad] standard deviation of the z axis from where it is expected
SPIN = 0.4  # [rad] standard deviation of the turn about it
ANYHOW = 0.1  # share of attitudes with any tilt, and of those with any spin
BEHIND = 0.2  # the pelvis is no farther behind its feet on the average than this share of how far limbs reach down


class SpaceBases:
    """Base positions (rx, ry, rz, z, x, y) at which every hip is within reach of its hold.

    Attributes:
        hips: Where the limbs that hold begin, in the pelvis's frame [m], shape (k, 3).
        lengths: How far they reach from there [m], shape (k,).
        levels: Between which heights along the pelvis's z, from there [m], shape (k, 2); may be infinite.
        points: Where they must reach to in W [m], shape (k, 3).
        out: The direction that the wall faces there in W, shape (3,).
    """

    def __init__(self, hips: Vector, lengths: Vector, levels: Vector, points: Vector, out: Vector) -> None:
        self.hips, self.lengths, self.points, self.out = hips, lengths, points, out
        self.levels = np.clip(levels, -lengths[:, None], lengths[:, None])

    def unreachable(self, spare: float = 0.0) -> bool:
        """Whether it is certain that no base position lets all limbs reach their holds.

        Whatever the pelvis's attitude, two feet are no farther apart than their limbs' lengths and the hips' distance.

        Args:
            spare: The feet may each be so far from where `points` has them [m].
        """
        apart = np.linalg.norm(self.points[:, None] - self.points, axis=2)
        between = np.linalg.norm(self.hips[:, None] - self.hips, axis=2)
        most = self.lengths[:, None] + self.lengths + between + 2 * spare
        return bool((apart > most + ROUNDING)[~np.eye(len(apart), dtype=bool)].any())

    @cached_property
    def _across(self) -> Vector:
        """The direction across the plane that best fits the feet, on the side that the wall faces; shape (3,)."""
        offsets = self.points - self.points.mean(axis=0)
        _, sizes, rows = np.linalg.svd(offsets, full_matrices=True)
        if len(sizes) < 2 or sizes[1] < 0.05:  # [m] feet in a line leave the plane open
            return self.out
        normal = rows[-1]
        side = float(normal @ self.out)
        # Seen along the wall's face the plane may be steep, and then it says little.
        return normal * np.sign(side) if abs(side) > 0.5 else self.out

    def _attitudes(self, rng: np.random.Generator, count: int) -> Vector:
        """Random attitudes R_WP, shape (count, 3, 3)."""
        expected = np.where(rng.random(count)[:, None] < 0.5, self._across, self.out)
        tilt = np.where(rng.random(count) < ANYHOW, 3.0, 1.0) * TILT
        z = expected + tilt[:, None] * rng.normal(size=(count, 3))
        z /= np.linalg.norm(z, axis=1, keepdims=True)
        # Any axes across z, then turned about it.
        right = np.cross(np.where(np.abs(z[:, 1:2]) < 0.9, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]), z)
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        R = np.stack([right, np.cross(z, right), z], axis=2)
        feet = (self.points - self.points.mean(axis=0)) @ R  # (count, k, 3)
        hips = self.hips - self.hips.mean(axis=0)
        # The turn that takes the hips nearest to the directions of the feet, as for complex numbers.
        turn = ((feet[..., 0] + 1j * feet[..., 1]) * (hips[:, 0] - 1j * hips[:, 1])).sum(axis=1)
        spin = np.angle(turn) + SPIN * rng.normal(size=count)
        anyhow = (rng.random(count) < ANYHOW) | (np.abs(turn) < ROUNDING)
        spin = np.where(anyhow, 2 * np.pi * rng.random(count), spin)
        sin, cos = np.sin(spin)[:, None], np.cos(spin)[:, None]
        x, y, z = R[..., 0], R[..., 1], R[..., 2]
        return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=2)

    def draw(self, rng: np.random.Generator, count: int) -> Vector:
        """Draws base positions, shape (count, 6), or (0, 6) where there are none."""
        R = self._attitudes(rng, OVERSAMPLING * count)
        # Everything in the axes of the pelvis: a limb reaches its hold from where the pelvis is at its offset.
        feet = self.points @ R  # (., k, 3)
        offsets = feet - self.hips
        low = (offsets[..., 2] - self.levels[:, 1]).max(axis=1)
        high = (offsets[..., 2] - self.levels[:, 0]).min(axis=1)
        low = np.maximum(low, feet[..., 2].mean(axis=1) + BEHIND * self.levels[:, 0].min())
        center, radius = enclosing_circles(offsets[..., :2])
        spread = np.sqrt(np.maximum(self.lengths.max() ** 2 - radius**2, 0.0))
        weights = np.where(high > low, (high - low) * spread**2, 0.0)
        if not weights.any():
            return np.zeros((0, 6))
        chosen = rng.choice(len(R), size=count, p=weights / weights.sum())
        r, phi = spread[chosen] * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
        place = np.empty((count, 3))
        place[:, :2] = center[chosen] + (r * np.array([np.cos(phi), np.sin(phi)])).T
        place[:, 2] = rng.uniform(low[chosen], high[chosen])
        origin = np.einsum("kij,kj->ki", R[chosen], place)
        return floating.base_positions(R[chosen], origin)
