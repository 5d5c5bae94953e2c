"""What a motion along a path asks of contacts, motors and joints, in terms of its speed along the path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from climber.stance import Vector

FASTEST = 100.0  # b is bounded by this: no motion is more than ten times as fast as the path's own pace
SLOWEST = 1e-6  # and coefficients of b by this: nor a thousand times as slow
BALANCED = 1e-6  # [N, N m] imbalance that is rounding
LIKELY = 0.3  # share of the greatest jerk, against its limit, that makes another worth watching
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PathDynamics:
    """What a motion along a path q(x) asks of contacts, motors and joints, at N places x on it.

    With b = xdot^2 and a = xddot, velocities are q' sqrt(b) and accelerations q' a + q'' b, the equations of motion
    (Gönen 2021, 4.24) with contact forces f = o + G t are linear in a, b and t but for damping:

        E t = e_0 + e_1 b + e_2 a                           in the rows without a motor (the pelvis)
        tau = c_0 + c_1 b + c_2 a + d sqrt(b) - A t         in the rows with one

    Attributes:
        x: The places, increasing, shape (N,).
        E: Shape (N, u, n).
        e: e_0 (at rest: gravity and springs), e_1, e_2, shape (3, N, u).
        A: Shape (N, j, n).
        c: c_0, c_1, c_2, shape (3, N, j).
        first: q' of the coordinates whose rates are limited, shape (N, l).
        second: q'' of them, likewise.
        speed: Their speed limits, shape (l,); infinite for none, as all limits below.
        acceleration: Their acceleration limits, shape (l,).
        jerk: Their jerk limits, shape (l,).
        torque: Torque limits [N m], shape (N, j).
        rows: Linear limits of contact forces, rows t <= most, shape (r, n).
        most: Their right sides [N], shape (N, r).
        cones: Round limits: tops - cones t is in the second-order cone, shape (s, 3, n).
        tops: Their right sides [N], shape (N, s, 3).
        names: What the rows and cones, then the torques, then the limited coordinates are called.
        damping: d [N m s], shape (N, j); None for none.
    """

    x: Vector
    E: Vector
    e: Vector
    A: Vector
    c: Vector
    first: Vector
    second: Vector
    speed: Vector
    acceleration: Vector
    jerk: Vector
    torque: Vector
    rows: Vector
    most: Vector
    cones: Vector
    tops: Vector
    names: tuple[Sequence[str], Sequence[str], Sequence[str]]
    damping: Vector | None = None

    @cached_property
    def fastest(self) -> tuple[Vector, list[str]]:
        """The greatest b at each place, shape (N,), and the limit that it comes from.

        It is that of speed; at ends where q' and q'' vanish, that of jerk, which is q^(3) b^(3/2) there.
        """
        with np.errstate(divide="ignore", over="ignore"):
            most = (self.speed / np.abs(self.first)) ** 2
            ends = [(self.jerk / np.abs(self._bend[end])) ** (2 / 3) for end in (0, -1)]
        names = [f"speed {self.names[2][j]}" for j in most.argmin(axis=1)]
        most = most.min(axis=1)
        for place, by_jerk in zip((0, -1), ends, strict=True):
            if not self.first[place].any() and by_jerk.min() < most[place]:
                most[place], names[place] = by_jerk.min(), f"jerk {self.names[2][int(by_jerk.argmin())]}"
        return np.minimum(most, FASTEST), names

    @property
    def jerky(self) -> Mask:
        """The coordinates whose jerk limits are likely to count, shape (l,): near to the first in a paced motion."""
        use = np.abs(self._bend).max(axis=0, initial=0.0) / self.jerk
        return np.asarray((use > LIKELY * use.max(initial=0.0)) & np.isfinite(self.jerk))

    @property
    def _bend(self) -> Vector:
        """The mean third derivative of q from each place to the next, shape (N - 1, l)."""
        result: Vector = np.diff(self.second, axis=0) / np.diff(self.x)[:, None]
        return result

    @cached_property
    def _lift(self) -> Vector:
        """The pseudo-inverses of E, shape (N, n, u)."""
        return np.asarray(np.linalg.pinv(self.E))

    def lifted(self, t: Vector, b: Vector, a: Vector) -> Vector:
        """The forces nearest to t, both of shape (N, n), that make the motion with b and a, (N,), if any do."""
        needed = self.e[0] + self.e[1] * b[:, None] + self.e[2] * a[:, None]
        gap = needed - np.einsum("kun,kn->ku", self.E, t)
        result: Vector = t + np.einsum("knu,ku->kn", self._lift, gap)
        return result

    def torques(self, t: Vector, b: Vector, a: Vector) -> Vector:
        """Torques of the motors with forces t [N m], shape (N, j)."""
        torque = self.c[0] + self.c[1] * b[:, None] + self.c[2] * a[:, None] - np.einsum("kjn,kn->kj", self.A, t)
        if self.damping is not None:
            torque = torque + self.damping * np.sqrt(np.maximum(b, 0.0))[:, None]
        return np.asarray(torque)

    def made(self, t: Vector, b: Vector, a: Vector) -> Mask:
        """Where forces t make the motion inside the limits of forces and torques, shape (N,)."""
        needed = self.e[0] + self.e[1] * b[:, None] + self.e[2] * a[:, None]
        good = np.abs(np.einsum("kun,kn->ku", self.E, t) - needed).max(axis=1, initial=0.0) <= BALANCED
        good &= (t @ self.rows.T <= self.most).all(axis=1)
        room = self.tops - np.einsum("san,kn->ksa", self.cones, t)
        good &= (np.linalg.norm(room[:, :, 1:], axis=2) <= room[:, :, 0]).all(axis=1)
        return np.asarray(good & (np.abs(self.torques(t, b, a)) <= self.torque).all(axis=1))

    def paced(self) -> float:
        """The greatest b, the same all along the path, that keeps to the limits of speed, acceleration and jerk."""
        with np.errstate(divide="ignore", over="ignore"):
            by_acceleration = (self.acceleration / np.abs(self.second)).min()
            by_jerk = ((self.jerk / np.abs(self._bend)) ** (2 / 3)).min()
        return float(max(SLOWEST, min(self.fastest[0].min(), by_acceleration, by_jerk)))
