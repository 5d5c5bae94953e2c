"""Closed chains without inverse kinematics: Newton's method on the contacts, and local charts that it makes.

A robot whose limbs have a closed form needs none of this (`climber.chart.Chart`). Where limbs have one joint, or
none because the foot is fixed to the pelvis, whole configurations are projected onto the contacts instead. Around a
configuration q0 that keeps them, with the scaled Jacobian's null space T and row space N (S makes metres and radians
commensurate),

    q(u) = q0 + S^-1 (T u + N w(u)),    w(u) solving  p_WF_i(q) = p_WC_i  for each holding limb i,

is a chart: the manifold as a graph over its tangent space at q0 (Jaillet and Porta's atlas). Where the contacts leave
no freedom there is no T, and q0 is an isolated point of the manifold.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from climber.kinematics import Kinematics
from climber.stance import Vector

if TYPE_CHECKING:
    from climber.manifold import Body

CLOSED = 1e-11  # [m] feet nearer to their contacts than this are on them
SINGULAR = 1e-6  # singular values of the scaled Jacobian this small beside the greatest count as zero
STRIDE = 0.25  # how far a chart goes with one round of Newton's method, in its coordinates
RADIUS = 1.5  # how far a chart reaches at most, in its coordinates
FLATTEST = 0.1  # a chart ends where the normal Jacobian's least singular value has shrunk to this share


@dataclass(frozen=True)
class Closure:
    """The contacts as equations of the configuration.

    Attributes:
        kinematics: The robot.
        points: Where each holding limb's foot stands in W [m], by limb.
    """

    kinematics: Kinematics
    points: Mapping[int, Vector]

    @cached_property
    def limbs(self) -> tuple[int, ...]:
        """The limbs that hold, in limb order."""
        return tuple(sorted(self.points))

    @cached_property
    def scale(self) -> Vector:
        """Diagonal of S: a metre of the pelvis counts as its turn over a limb's length; shape (nq,)."""
        robot = self.kinematics.robot
        weights = np.ones(robot.plant.num_positions())
        weights[robot.origin_q] = 2.0 / robot.reach.mean()
        return weights

    def gap(self, q: Vector) -> Vector:
        """How far the feet are from their contacts [m], x, y and in space z limb by limb, shape (K, dimension k)."""
        dimension = self.kinematics.robot.dimension
        wanted = np.array([self.points[i][:dimension] for i in self.limbs]).reshape(-1, dimension)
        feet = self.kinematics.feet(q)[:, list(self.limbs), :dimension]
        return np.asarray((feet - wanted).reshape(len(q), wanted.size))

    def jacobian(self, q: Vector) -> Vector:
        """Derivative of `gap` by the scaled configuration S q, shape (K, dimension k, nq)."""
        J = self.kinematics.robot.by_positions(q, self.kinematics.foot_jacobians(q, self.limbs))
        result: Vector = J.reshape(len(q), J.shape[1] * J.shape[2], len(self.scale)) / self.scale
        return result

    def project(self, q: Vector, iterations: int = 30) -> tuple[Vector, NDArray[np.bool_]]:
        """Takes configurations to the contacts by Gauss-Newton steps of least norm.

        Args:
            q: Configurations anywhere, shape (K, nq).
            iterations: Steps at most.

        Returns:
            Configurations, shape (K, nq), and which of them keep the contacts, shape (K,).
        """
        q = q.copy()
        todo = np.arange(len(q))
        for _ in range(iterations):
            gap = self.gap(q[todo])
            todo, gap = todo[far := np.abs(gap).max(axis=1, initial=0.0) > CLOSED], gap[far]
            if not len(todo):
                break
            J = self.jacobian(q[todo])
            # A little damping where the Jacobian is nearly singular; elsewhere it does not slow the last steps down.
            damping = 1e-3 * (gap**2).sum(axis=1)[:, None, None] * np.eye(J.shape[1])
            step = np.linalg.solve(J @ np.swapaxes(J, 1, 2) + damping + 1e-18 * np.eye(J.shape[1]), gap[:, :, None])
            q[todo] -= (np.swapaxes(J, 1, 2) @ step)[:, :, 0] / self.scale
        closed = np.abs(self.gap(q)).max(axis=1, initial=0.0) <= CLOSED
        # Newton's method converges quadratically: one step more, and only rounding is left.
        J = self.jacobian(q[closed])
        step = np.einsum("knm,km->kn", np.linalg.pinv(J, rcond=SINGULAR), self.gap(q[closed]))
        q[closed] -= step / self.scale
        return q, closed


class NewtonChart:
    """Coordinates u of the configurations near one that keeps some contacts; see the module.

    It has the interface of `climber.chart.Chart`. An isolated configuration gets one coordinate that moves nothing,
    so that a path that stays where it is has a chart like any other.

    Attributes:
        body: The robot.
        points: Where each holding limb's foot stands in W [m], by limb.
        branches: The branch of each limb at the base.
        root: None, as no limb is at the chart's root.
        solved: Empty, as no limb follows by inverse kinematics.
        base: The configuration q0, shape (nq,).
        dimension: Freedom that the contacts leave.
        free: S^-1 T, directions of the coordinates, shape (nq, num_coordinates).
        tied: S^-1 N, directions in which contacts pull, shape (nq, nq - dimension).
    """

    def __init__(self, body: Body, points: Mapping[int, Vector], branches: tuple[int, ...], base: Vector) -> None:
        self.body, self.points, self.branches = body, dict(points), branches
        self.root: int | None = None
        self.solved: tuple[int, ...] = ()
        self.base = np.array(base, dtype=float)
        self.closure = Closure(body.kinematics, self.points)
        J = self.closure.jacobian(self.base[None])[0]
        _, sizes, rows = np.linalg.svd(J, full_matrices=True)
        rank = int((sizes > SINGULAR * sizes.max(initial=0.0)).sum())
        self._steepness = float(sizes[rank - 1])
        self.dimension = len(rows) - rank
        S = self.closure.scale[:, None]
        self.free = rows[rank:].T / S if self.dimension else np.zeros((len(rows), 1))
        self.tied = rows[:rank].T / S
        self._tangent = rows[rank:] * self.closure.scale if self.dimension else np.zeros((1, len(rows)))

    @cached_property
    def scale(self) -> Vector:
        """Weights of the coordinates in distances, which are commensurate as they are."""
        return np.ones(self.free.shape[1])

    def coordinates(self, q: Vector) -> Vector:
        """The coordinates of configurations near the base, shape (..., nq) to (..., num_coordinates)."""
        result: Vector = (q - self.base) @ self._tangent.T
        return result

    def bounds(self, a: Vector, b: Vector) -> tuple[Vector, Vector]:
        """Where to look for a path between two points of the chart: all of it, for it is small."""
        reach = np.full(self.free.shape[1], RADIUS)
        return np.minimum(-reach, np.minimum(a, b)), np.maximum(reach, np.maximum(a, b))

    def turns(self, u: Vector) -> list[Vector]:
        """The points of the chart that are the same posture as `u`: it alone."""
        return [u]

    def expand(self, u: Vector) -> tuple[Vector, Vector]:
        """The whole configurations with coordinates `u`, shape (K, num_coordinates).

        They are reached stride by stride from the base, so that all lie on one sheet of the manifold.

        Returns:
            Configurations, shape (K, nq), and how far inside the chart they are, shape (K,): the share of the normal
            Jacobian's least singular value that is left, beyond what must be; negative where Newton's method does not
            converge or the point is beyond the chart's border.
        """
        K, rank = len(u), self.tied.shape[1]
        if not self.dimension:
            return np.tile(self.base, (K, 1)), np.full(K, np.inf)
        inside = np.linalg.norm(u, axis=1) <= RADIUS
        strides = max(1, int(np.ceil(np.linalg.norm(u[inside], axis=1).max(initial=0.0) / STRIDE)))
        w = np.zeros((K, rank))
        slack = np.where(inside, np.inf, -1.0)
        q = np.tile(self.base, (K, 1))
        going = np.flatnonzero(inside)
        for stride in range(1, strides + 1):
            along = u[going] * (stride / strides)
            q[going], w[going], least = self._solve(along, w[going])
            slack[going] = np.minimum(slack[going], least / self._steepness - FLATTEST)
            going = going[slack[going] >= 0.0]
        # Where nothing was solved the tangent's point serves: something that is not on the contacts, but is near.
        lost = np.flatnonzero(slack < 0.0)
        q[lost] = self.base + u[lost] @ self.free.T
        return q, slack

    def _solve(self, u: Vector, w: Vector) -> tuple[Vector, Vector, Vector]:
        """Newton's method for w from a guess; configurations, w, and the least singular value (0: not converged)."""
        flat = self.base + u @ self.free.T
        todo = np.arange(len(u))
        w = w.copy()
        least = np.zeros(len(u))
        for _ in range(12):
            q = flat[todo] + w[todo] @ self.tied.T
            gap = self.closure.gap(q)
            normal = self.closure.jacobian(q) @ (self.tied * self.closure.scale[:, None])
            done = np.abs(gap).max(axis=1) <= CLOSED
            if done.any():
                least[todo[done]] = np.linalg.svd(normal[done], compute_uv=False)[:, -1]
            todo, gap, normal = todo[~done], gap[~done], normal[~done]
            if not len(todo):
                break
            step = np.einsum("krm,km->kr", np.linalg.pinv(normal, rcond=SINGULAR), gap)
            # Newton's method is trusted no farther than a stride.
            size = np.linalg.norm(step, axis=1)
            w[todo] -= step * np.minimum(1.0, STRIDE / np.maximum(size, 1e-300))[:, None]
        return flat + w @ self.tied.T, w, least
