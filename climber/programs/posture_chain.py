"""The postures of a climb's instants, drawn towards one another all at once.

Sampling finds postures that are feasible but arbitrary; a climb through arbitrary postures is long. Pulling one after
the other towards its neighbours creeps along a climb of dozens of them; here they move together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
import shapely
from scipy.sparse import coo_matrix, csc_matrix
from shapely.geometry.base import BaseGeometry

from climber.manifold import Manifold
from climber.objective import Objective
from climber.programs.conditions import Conditions, Linearised
from climber.robot import Indices
from climber.solids import Region, away
from climber.stance import Vector

WATCH = 0.15  # [m] shapes farther apart than this are not looked at in one step
RADIUS = 0.3  # [rad] of the trust region at first
SMALLEST = 5e-3  # [rad] and when to stop
BACKOFF = 1e-5  # [rad or m] room to a condition that a step leaves at first
ENOUGH = 2e-3  # a step that lowers the cost by less than this share is the last one
FRACTIONS = (1.0, 0.5, 0.25, 0.1)  # of its step that a posture takes if the whole of it is not feasible
SUPPORT = "centre of mass"  # what the names of the conditions on equilibrium begin with


@dataclass(frozen=True)
class Instant:
    """A posture of a climb.

    Attributes:
        q: The configuration, shape (nq,).
        manifold: What makes it feasible, in the phases before and after.
        region: Where the pelvis's origin must be; None for anywhere.
        free: Whether it may be moved.
    """

    q: Vector
    manifold: Manifold
    region: Region | None = None
    free: bool = True


class _Posture:
    """One free posture: its chart, its conditions, and how it moves in it."""

    def __init__(self, instant: Instant, origin: Indices) -> None:
        self.manifold, self.region, self._origin = instant.manifold, instant.region, origin
        self.chart = instant.manifold.chart(instant.q)
        self.conditions = Conditions(instant.manifold, self.chart)
        self.u = self.chart.coordinates(instant.q)
        self.backoff = BACKOFF
        self._support = np.array([name.startswith(SUPPORT) for name in self.conditions.names])

    def linearised(self) -> Linearised:
        return self.conditions.linearised(self.u[None], WATCH)

    def inside(self, q: Vector) -> bool:
        """Whether the pelvis is in its region."""
        return self.region is None or bool(away(self.region, q[self._origin]) <= 0.0)

    def rows(self, near: Linearised, radius: float) -> tuple[Vector, Vector]:
        """Conditions as A x <= b on a change x of the coordinates; those that cannot bind are left out."""
        bound = radius / self.chart.scale
        room = near.value - np.minimum(near.value, self.backoff)
        tight = room < np.abs(near.slope) @ bound
        A, b = [-near.slope[tight]], [room[tight]]
        if isinstance(self.region, BaseGeometry):
            # Towards the nearest place on the edge no farther than to it; into a solid's edge a step is just cut short.
            flat = self._origin[:2]
            edge = np.array(shapely.shortest_line(shapely.Point(near.q[0, flat]), self.region.boundary).coords[1])
            outwards = edge - near.q[0, flat]
            distance = float(np.linalg.norm(outwards))
            if distance > 1e-9:
                A.append((outwards / distance @ near.dq[0, flat])[None])
                b.append(np.array([max(0.0, distance - self.backoff)]))
        identity = np.eye(len(bound))
        return np.concatenate([*A, identity, -identity]), np.concatenate([*b, bound, bound])

    def centring(self, near: Linearised, weight: float) -> tuple[Vector, Vector]:
        """Gradient and Hessian of -weight sum log(distance to an end of the support)."""
        these = self._support[near.kind]
        # Conditions are about what the margins leave; the logarithm is of what there is.
        room = self.manifold.balance(near.q)[0]
        ratio = near.slope[these] / np.maximum(room, 1e-4)[:, None]
        return -weight * ratio.sum(axis=0), weight * ratio.T @ ratio

    def step(self, x: Vector) -> tuple[Vector, Vector, bool]:
        """Goes along x as far as is feasible: coordinates, configuration, and whether it went all the way."""
        for part in FRACTIONS:
            u = self.u + part * x
            q, reach = self.chart.expand(u[None])
            if reach[0] >= self.manifold.margins.reach and self.manifold.slack(q)[0] >= 0 and self.inside(q[0]):
                return u, q[0], part == 1.0
        return self.u, self.chart.expand(self.u[None])[0][0], False


class PostureChain:
    """The postures of a climb that cost least together.

    With q_k(u_k) the configuration of instant k in a chart of its contacts [m, rad], |.| the objective's norm and w its
    weight, g_k the conditions of `Conditions` on the contacts of the phases before and after, s_ki the distances of the
    centre of mass from the ends of its support [m] and m the objective's centring:

        min over u_k   sum_k w |q_{k+1}(u_{k+1}) - q_k(u_k)| - m sum_k sum_i log s_ki(u_k)          (1)
        s.t.           g_k(u_k) >= 0                                                                (2)
                       p_k(u_k) in R_k      for the pelvis's origin where it must be in a region    (3)

    Solved by sequential quadratic programming in a trust region, with `Norm.model` for the norm: a majorant's Hessian,
    so that the sum of the norms, not of their squares, goes down. Each posture goes along its step as far as it is
    feasible. Clarabel is handed its matrices, in which only neighbours meet.
    """

    def __init__(self, instants: Sequence[Instant], objective: Objective) -> None:
        self.objective = objective
        self._q = [instant.q for instant in instants]
        origin = instants[0].manifold.body.robot.origin_q
        self._free = {
            k: _Posture(instant, origin)
            for k, instant in enumerate(instants)
            if instant.free and not instant.manifold.rigid
        }
        sizes = [len(self._free[k].u) if k in self._free else 0 for k in range(len(self._q))]
        self._first = np.concatenate([[0], np.cumsum(sizes)])

    def cost(self, q: Sequence[Vector]) -> float:
        """The objective (1) of configurations, one for each instant."""
        total = float(self.objective.step(np.diff(np.array(q), axis=0)).sum())
        for k, posture in self._free.items():
            total += float(self.objective.standing(posture.manifold, q[k][None])[0])
        return total

    def solve(self, iterations: int = 15) -> list[Vector]:
        """Configurations that cost no more than those given, feasible where these were."""
        q, cost, radius = list(self._q), self.cost(self._q), RADIUS
        if not self._free:
            return q
        for _ in range(iterations):
            x = self._direction(q, radius)
            moved, went = {}, list(q)
            for k, posture in self._free.items():
                u, went[k], whole = posture.step(x[self._first[k] : self._first[k + 1]])
                moved[k] = u
                if not whole:
                    posture.backoff *= 3.0
            after = self.cost(went)
            if not after < cost:
                radius *= 0.3
                if radius < SMALLEST:
                    break
                continue
            gained, q, cost = cost - after, went, after
            for k, posture in self._free.items():
                posture.u = moved[k]
            if gained < ENOUGH * abs(cost):
                break
        return q

    def _direction(self, q: list[Vector], radius: float) -> Vector:
        """The step that solves the quadratic program around configurations."""
        objective, size = self.objective, int(self._first[-1])
        near = {k: posture.linearised() for k, posture in self._free.items()}
        gradient, hessian = objective.norm.model(np.diff(np.array(q), axis=0))
        P, c = np.zeros((size, size)), np.zeros(size)
        for k, (g, H) in enumerate(zip(objective.weight * gradient, objective.weight * hessian, strict=True)):
            ends = [(i, sign) for i, sign in ((k, -1.0), (k + 1, 1.0)) if i in near]
            for i, sign in ends:
                at = slice(self._first[i], self._first[i + 1])
                c[at] += sign * g @ near[i].dq[0]
                for j, other in ends:
                    to = slice(self._first[j], self._first[j + 1])
                    P[at, to] += sign * other * near[i].dq[0].T @ H @ near[j].dq[0]
        rows, columns, values, bounds = [], [], [], []
        count = 0
        for k, posture in self._free.items():
            at = slice(self._first[k], self._first[k + 1])
            if objective.centring:
                slope, curvature = posture.centring(near[k], objective.centring)
                c[at] += slope
                P[at, at] += curvature
            A, b = posture.rows(near[k], radius)
            entries = np.nonzero(A)
            rows.append(entries[0] + count)
            columns.append(entries[1] + self._first[k])
            values.append(A[entries])
            bounds.append(b)
            count += len(b)
        A = coo_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(count, size))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        cones = [clarabel.NonnegativeConeT(count)]
        matrices = csc_matrix(np.triu(P)), c, csc_matrix(A), np.concatenate(bounds)
        return np.array(clarabel.DefaultSolver(*matrices, cones, settings).solve().x)
