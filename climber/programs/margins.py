"""Margins to disturbances: the greatest that every instant of a phase survives, whatever its direction.

They are sought best first: every instant has a number that forces found so far prove, and programs are solved only at
the instants, and in the directions, where the least of these numbers are. The forces they give are tried at all other
instants of the phase. What is returned is proved at every instant, and is the greatest possible up to `GAP`, in space
up to 10 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climber.programs.blocks import solve_each
from climber.programs.rays import Rays
from climber.programs.survival import NUDGE, Instants
from climber.robot import Indices
from climber.stance import Vector

MEASURED = 16  # instants whose balls are measured at a time
AT_ONCE = 64  # instants that all rays are followed at, at a time, so that what is worked out stays in the cache
GAP = 1e-2  # share of a margin that it may be short of the greatest, in the plane


@dataclass(frozen=True)
class Worst:
    """The margin of each of P phases.

    Attributes:
        value: The margin, shape (P,).
        instant: The instant where it is least, shape (P,).
        which: What is worst there: the number of a direction, or of a contact; shape (P,).
    """

    value: Vector
    instant: Indices
    which: Indices


class DisturbanceMargin:
    """The largest ball of disturbances that every instant of a phase survives.

    The disturbances d that an instant survives, those for which E x = b + B d, G x <= g + C d has a solution x, are a
    convex set. On rays u_m from the origin its border is at

        rho_m = max rho   subject to  E x = b + rho B u_m,   G x <= g + rho C u_m,   rho <= cap,

    and the ball inside the polytope of the points rho_m u_m is proved. In one dimension it is exact, in the plane it is
    the greatest but for the factor cos(pi / M) of M rays.

    The multipliers y and z of such a program with rho < cap say what bounds the disturbances there: E^T y + G^T z = 0
    and z >= 0, so that every one that is survived has

        a . d <= h   with   a = -B^T y - C^T z,   h = y . b + z . g,

    a plane through rho_m u_m, and no ball may be greater than h / |a|. The least of these is the bound that the proved
    ball is compared with, and its a the direction that is worst: to the foot of the plane, which may be far from all
    rays.
    """

    def __init__(self, instants: Instants, B: Vector, C: Vector, cap: float, rays: Rays) -> None:
        """Prepares.

        Args:
            instants: The instants.
            B: Shape (K, u, D).
            C: Shape (K, r, D).
            cap: Greater disturbances are not looked for.
            rays: In D dimensions.
        """
        self.instants, self.rays, self.cap = instants, rays, cap
        self._right = rays.directions @ np.swapaxes(B, 1, 2)
        self._limits = rays.directions @ np.swapaxes(C, 1, 2)
        self._B, self._C = B, C
        K, M = len(instants), len(rays.directions)
        self.rho = np.zeros((K, M))
        self._exact = np.broadcast_to(~instants.sound[:, None], (K, M)).copy()
        answer = self._right @ np.swapaxes(instants.inverse, 1, 2)
        gap = np.abs(answer @ np.swapaxes(instants.E, 1, 2) - self._right).max(axis=2, initial=0.0)
        # A disturbance that no forces balance, of whatever size, is not survived at all.
        self._exact |= gap > 1e-7
        spans = [slice(k, k + AT_ONCE) for k in range(0, K, AT_ONCE)]
        far = np.concatenate([instants.followed(at, answer[at], self._limits[at]) for at in spans])
        self.rho = np.where(self._exact, 0.0, np.minimum(far, cap))
        self._moved = np.zeros(K, dtype=bool)  # instants with points farther out than when their balls were measured

    def solve(self) -> tuple[Worst, Vector]:
        """The margins, `which` being the nearest ray, and the directions that are worst, shape (P, D)."""
        starts = self.instants.starts
        P = len(starts) - 1
        value, best = np.zeros(P), np.full(P, self.cap)
        worst, which = starts[:-1].copy(), np.zeros(P, dtype=int)
        toward = np.zeros((P, self.rays.directions.shape[1]))
        self._radius, self._face, self.rho = self.rays.inscribed(self.rho)
        unfinished: Sequence[int] = range(P)
        while unfinished:
            wanted: list[tuple[int, int]] = []
            for p, k in zip(unfinished, self._least(unfinished), strict=True):
                value[p] = self._radius[k]
                corners = self.rays.faces[self._face[k]]
                nearest = int(corners[np.argmin(self.rho[k, corners])])
                missing = [(k, int(m)) for m in corners if not self._exact[k, m] and self.rho[k, m] < self.cap]
                if not missing and self.rho[k, nearest] < best[p]:
                    best[p], worst[p], which[p] = self.rho[k, nearest], k, nearest
                    toward[p] = self.rays.directions[nearest]
                if value[p] < (1.0 - GAP) * best[p]:
                    wanted += missing
            unfinished = sorted({int(self.instants.phase[k]) for k, _ in wanted})
            if wanted:
                bounds, feet = self._refine(np.array(wanted))
                for (k, m), bound, foot in zip(wanted, bounds, feet, strict=True):
                    p = int(self.instants.phase[k])
                    if bound < best[p]:
                        best[p], worst[p], which[p], toward[p] = bound, k, m, foot
        return Worst(value, worst, which), toward

    def _least(self, phases: Sequence[int]) -> list[int]:
        """The instants of some phases whose balls are the least.

        Points on rays only ever move outwards, so that what an instant measured before is a bound from below. Only
        those are measured again that it does not rule out.
        """
        starts = self.instants.starts
        while True:
            least = [int(starts[p] + np.argmin(self._radius[starts[p] : starts[p + 1]])) for p in phases]
            parts = []
            for p, k in zip(phases, least, strict=True):
                if self._moved[k]:
                    moved = starts[p] + np.flatnonzero(self._moved[starts[p] : starts[p + 1]])
                    parts.append(moved[np.argsort(self._radius[moved])[:MEASURED]])
            if not parts:
                return least
            some = np.concatenate(parts)
            self._radius[some], self._face[some], self.rho[some] = self.rays.inscribed(self.rho[some])
            self._moved[some] = False

    def _refine(self, pairs: Indices) -> tuple[Vector, Vector]:
        """Solves programs of pairs of instants and rays; their forces are tried at the other instants of the phases.

        Returns:
            The greatest ball that each leaves possible, shape (N,), and the unit vector to where it touches, (N, D).
        """
        k, m = pairs.T
        at = self.instants[k]
        n, r = at.E.shape[2], at.G.shape[1]
        B, C = self._right[k, m], self._limits[k, m]
        b = at.balanceable
        cost, most = np.zeros((len(k), n + 1)), np.zeros((len(k), 1, n + 1))
        cost[:, n], most[:, 0, n] = -1.0, 1.0
        rows = np.concatenate([np.concatenate([at.G, -C[:, :, None]], axis=2), most], axis=1)
        right = np.concatenate([at.g, np.full((len(k), 1), self.cap)], axis=1)
        E = np.concatenate([at.E, -B[:, :, None]], axis=2)
        found, y, z = solve_each(cost, E, b, rows, right, nudge=NUDGE)
        some = np.flatnonzero(np.isfinite(found[:, n]) & (found[:, n] > 0.0))
        for p in np.unique(at.phase[some]):
            own = some[at.phase[some] == p]
            self._try(int(p), m[own], found[own, :n], found[own, n])
        self._exact[k, m] = True
        bound, foot = self.rho[k, m], self.rays.directions[m].copy()
        a = -np.einsum("kud,ku->kd", self._B[k], y) - np.einsum("krd,kr->kd", self._C[k], z[:, :r])
        length = np.linalg.norm(a, axis=1)
        # Where the cap is what bounds, a has no part along the ray.
        for i in np.flatnonzero((np.einsum("kd,kd->k", a, foot) > 0.5) & (length > 1.0)):
            bound[i], foot[i] = bound[i] / length[i], a[i] / length[i]
        return bound, foot

    def _try(self, p: int, m: Indices, x: Vector, rho: Vector) -> None:
        """Follows ways from the center at the instants of a phase: to forces x, (T, n), for disturbances rho u_m."""
        instants, at = self.instants, slice(*self.instants.starts[p : p + 2])
        right, limits = (rho[:, None] * part[at][:, m] for part in (self._right, self._limits))
        gap = instants.b[at, None] + right - x @ np.swapaxes(instants.E[at], 1, 2)
        step = x - instants.center[at, None] + gap @ np.swapaxes(instants.inverse[at], 1, 2)
        far = np.minimum(instants.followed(at, step, limits) * rho, self.cap)
        farther = ~self._exact[at][:, m] & (far > self.rho[at][:, m])
        self.rho[at, m] = np.where(farther, far, self.rho[at, m])
        self._moved[at] |= farther.any(axis=1)
