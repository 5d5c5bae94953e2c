"""The margin to an error of a hold's place: by how much one hold may be off, in any direction.

The pelvis stays on its plan and the limb follows the displaced hold, to first order in the displacement d. Then the
force f of that contact has another lever: its moment about the pelvis changes by d x f, the moment of the limb's weight
by no more than omega |d|, and the torque of joint a of that limb by no more than (kappa_a |f| + nu_a) |d|. (What the
limb's inertia adds when it moves along another way is left out.) There is a posture in which the limb follows if
|d| <= sigma^2 / (2 H), where sigma is the least singular value of its Jacobian and H the norm of how this changes
(Newton-Kantorovich): near a straight limb there is hardly room. And a foot that is led to where the hold should be is
on it if its patch is half as wide. The forces that balance the robot all change by these, and so does the change
itself: d x f depends on f.

A fixed point settles it. Suppose that for every moment w with |w| <= rho (F + omega) there are forces that balance the
robot with w, keep to the limits of the holds and of the other motors, leave (kappa_a F + nu_a) rho of the torque of
each joint a, have |f| <= F, and depend continuously on w. For a displacement |d| <= rho the map that takes w to the
moment which d causes with the forces for w then takes the ball |w| <= rho (F + omega) into itself, continuously, and
by Brouwer there is a w that is its own image: with its forces the displaced robot is balanced inside all limits.

Forces for the corners w_v of a polytope about the ball, and between them by linear interpolation, are continuous. With
y = x / (F + omega) and s = 1 / (F + omega) the greatest rho is a linear program, v = 1, 2, ... as many as corners:

    max rho   subject to   E y_v = b s + rho B w_v,   G y_v + rho tight <= g s,   |f part of y_v| <= 1 - omega s

with the ball of the last replaced by a polytope inside it. It is a lower bound of what is survived, the less below it
the less the force must change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climber.programs.blocks import solve_each
from climber.programs.margins import GAP, Worst
from climber.programs.rays import rays
from climber.programs.survival import NUDGE, Instants
from climber.robot import Indices
from climber.stance import Vector


@dataclass(frozen=True)
class Lever:
    """How a displacement of each of k contacts changes what the robot needs, at K instants.

    Attributes:
        B: Moments on the pelvis about the axes that count, as additions to E x = b, shape (K, u, A); A = 1 in the
            plane, else 3.
        omega: Change of the moment of the limb's weight [N], shape (K, k).
        tight: Of the rows G x <= g, what is lost for each (F + omega) of 1 N and displacement of 1 m, shape (K, k, r).
        most: Displacement that the limb can follow and the patch allows for, shape (K, k).
        hard: Direction in which it is hardest to follow, shape (K, k, 2 or 3).
    """

    B: Vector
    omega: Vector
    tight: Vector
    most: Vector
    hard: Vector


def _corners(axes: int) -> Vector:
    """Corners of a polytope about the unit ball, shape (V, axes)."""
    if axes == 1:
        return np.array([[1.0], [-1.0]])
    return np.asarray(np.sqrt(3.0) * np.concatenate([np.eye(3), -np.eye(3)]))


class PlaceMargin:
    """The least of what the instants of each phase survive, whichever hold is off."""

    def __init__(self, instants: Instants, lever: Lever, dimension: int, cap: float) -> None:
        """Prepares; `dimension` numbers for each contact force; greater errors than `cap` [m] are not looked for."""
        self.instants, self.lever, self._dimension, self._cap = instants, lever, dimension, cap
        self._corners = _corners(lever.B.shape[2])
        self._around = rays(dimension).directions
        # The polytope {f : around . f <= inside} is in the unit ball.
        spread = np.pi / len(self._around) if dimension == 2 else 0.22
        self._inside = np.cos(spread)
        self._wrench = np.einsum("kua,va->kvu", lever.B, self._corners)
        self._room = instants.room(instants.center)
        K, k = lever.omega.shape
        self.survived = np.zeros((K, k))
        self._most = np.minimum(lever.most, cap)
        self._settled = np.broadcast_to(~instants.sound[:, None], (K, k)) | (lever.most == 0.0)
        answer = np.einsum("knu,kvu->kvn", instants.inverse, self._wrench)
        gap = np.abs(np.einsum("kun,kvn->kvu", instants.E, answer) - self._wrench).max(axis=(1, 2), initial=0.0)
        self._settled |= (gap > 1e-7)[:, None]
        for contact in range(k):
            self._follow(slice(0, K), contact, answer, 1.0)

    def _follow(self, span: slice, contact: int, steps: Vector, moment: float) -> None:
        """Follows ways from the center, (K, V, n), that take up moments of the corners times `moment`."""
        near, center = self.instants[span], self.instants.center[span]
        slope = np.einsum("krn,kvn->krv", near.G, steps) + moment * self.lever.tight[span, contact, :, None]
        far = near.stepped(self._room[span, :, None], slope).min(axis=1)
        far = np.minimum(far, self._cap * 1e3 / moment)
        own = slice(contact * self._dimension, (contact + 1) * self._dimension)
        force = center[:, None, own] + far[:, None, None] * steps[:, :, own]
        most = np.linalg.norm(force, axis=2).max(axis=1) + self.lever.omega[span, contact]
        rho = np.minimum(far * moment / np.maximum(most, 1e-9), self._most[span, contact])
        better = ~self._settled[span, contact] & (rho > self.survived[span, contact])
        self.survived[span, contact] = np.where(better, rho, self.survived[span, contact])
        self._settled[span, contact] |= rho >= self._most[span, contact]

    def solve(self) -> tuple[Worst, Vector]:
        """The margins, `which` being the contact, and the direction of displacement that is worst, (P, dimension)."""
        starts = self.instants.starts
        P = len(starts) - 1
        value, best = np.zeros(P), np.full(P, self._cap)
        worst, which, direction = starts[:-1].copy(), np.zeros(P, dtype=int), np.zeros((P, self._dimension))
        unfinished = list(range(P))
        while unfinished:
            wanted = []
            for p in unfinished:
                own = self.survived[starts[p] : starts[p + 1]]
                low, contact = divmod(int(np.argmin(own)), own.shape[1])
                value[p], k = own[low, contact], int(starts[p] + low)
                if self._settled[k, contact] and value[p] < best[p]:
                    best[p], worst[p], which[p] = value[p], k, contact
                    direction[p] = self.lever.hard[k, contact]
                if value[p] < (1.0 - GAP) * best[p]:
                    wanted.append((k, contact))
            if wanted:
                for (k, contact), toward in zip(wanted, self._refine(np.array(wanted)), strict=True):
                    p = int(self.instants.phase[k])
                    if self.survived[k, contact] < best[p]:
                        best[p], worst[p], which[p] = self.survived[k, contact], k, contact
                        direction[p] = toward
            unfinished = sorted({int(self.instants.phase[k]) for k, _ in wanted})
        return Worst(value, worst, which), direction

    def _refine(self, pairs: Indices) -> Vector:
        """Solves the programs of pairs of instants and contacts; the displacements that are worst, (N, dimension)."""
        k, contact = pairs.T
        at, dimension = self.instants[k], self._dimension
        (N, u, n), r, V, M = at.E.shape, at.G.shape[1], len(self._corners), len(self._around)
        omega, tight = self.lever.omega[k, contact], self.lever.tight[k, contact]
        size = V * n + 2  # y_1, ..., y_V, s, rho
        E, b = np.zeros((N, V * u, size)), np.zeros((N, V * u))
        G, g = np.zeros((N, V * (r + M) + 2, size)), np.zeros((N, V * (r + M) + 2))
        for v in range(V):
            columns, rows = slice(v * n, (v + 1) * n), slice(v * (r + M), v * (r + M) + r)
            E[:, v * u : (v + 1) * u, columns] = at.E
            E[:, v * u : (v + 1) * u, -2] = -at.balanceable
            E[:, v * u : (v + 1) * u, -1] = -self._wrench[k, v]
            G[:, rows, columns], G[:, rows, -2], G[:, rows, -1] = at.G, -at.g, tight
            rows = slice(rows.stop, rows.stop + M)
            for i in range(N):
                first = v * n + int(contact[i]) * dimension
                G[i, rows, first : first + dimension] = self._around
            G[:, rows, -2] = self._inside * omega[:, None]
            g[:, rows] = self._inside
        G[:, -2, -1], g[:, -2] = 1.0, self._most[k, contact]
        G[:, -1, -2] = -1.0
        cost = np.zeros((N, size))
        cost[:, -1] = -1.0
        found = solve_each(cost, E, b, G, g, nudge=NUDGE).x
        toward = np.zeros((N, dimension))
        for i in np.flatnonzero(np.isfinite(found).all(axis=1)).tolist():
            s, rho = found[i, -2:].tolist()
            x = found[i, :-2].reshape(V, n) / s
            force = x[:, contact[i] * dimension : (contact[i] + 1) * dimension]
            own_phase = int(at.phase[i])
            span = slice(self.instants.starts[own_phase], self.instants.starts[own_phase + 1])
            near = self.instants[span]
            steps = np.stack(
                [
                    near.balanced(np.broadcast_to(x[v], (len(near), n)), rho / s * self._wrench[span, v])
                    - self.instants.center[span]
                    for v in range(V)
                ],
                axis=1,
            )
            self._follow(span, int(contact[i]), steps, rho / s)
            self.survived[k[i], contact[i]] = max(self.survived[k[i], contact[i]], rho * (1.0 - 1e-6))
            room = at.g[i] - x @ at.G[i].T - rho / s * tight[i]
            tightest = int((room / self.instants.weight).min(axis=1).argmin())
            toward[i] = _across(self._corners[tightest], force[tightest])
        self._settled[k, contact] = True
        return toward


def _across(moment: Vector, force: Vector) -> Vector:
    """The unit displacement d whose d x f is farthest against a moment."""
    d = moment[0] * np.array([-force[1], force[0]]) if len(moment) == 1 else np.cross(moment, force)
    length = float(np.linalg.norm(d))
    return np.asarray(d / length if length > 0.0 else np.eye(len(force))[0])
