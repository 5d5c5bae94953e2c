"""Instants of a motion as linear equations: which contact forces and torques make the robot move as it should?

The equations of motion M vd + h = S^T tau + J_c^T f (Gönen 2021, 4.24) with contact forces `f = offset + G t` that the
holds can give (`climber.programs.forces`) are linear in t; the rows without a motor restrict t, the others give
the torques. `climber.programs.torque` solves for t.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from climber.programs.forces import ContactForces, ForceLimits
from climber.robot import Indices, Robot
from climber.stance import Vector

Mask = NDArray[np.bool_]

EXACT = 1e-10  # of the identity that a matrix times its inverse is
GUARD = 1e-5  # [N, N m] limits are always tightened by this, so that rounding does not leave the true ones
# What forces and torques to prefer where there is a choice. A robot in balance pushes little more than it must, so that
# forces drawn to the very middle of their limits would end up at a border in most postures; a third of the way serves.
MIDWAY = 0.3  # of the way from the weakest force to the middle of the limits
CENTERING = 10.0  # weight of the force preferred against small torques, both as fractions of the limits


def right_inverse(E: Vector) -> Vector:
    """The pseudo-inverses of matrices with few rows, (K, u, n) to (K, n, u), by their small normal equations.

    Where those are too nearly singular to say, by singular values, which take several times as long.
    """
    try:
        result = np.swapaxes(E, 1, 2) @ np.linalg.inv(E @ np.swapaxes(E, 1, 2))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(E))
    off = np.abs(E @ result - np.eye(E.shape[1])).max(axis=(1, 2), initial=0.0)
    singular = ~(off <= EXACT)
    if singular.any():
        result[singular] = np.linalg.pinv(E[singular])
    return result


@dataclass(frozen=True)
class Margin:
    """How far forces and torques stay inside their limits.

    Attributes:
        force: Distance of each generator's multiple from both its limits [N]; less if these are closer than twice that.
            In space, how far both apexes of a cone move towards each other.
        torque: Part of each torque limit that is left unused.
    """

    force: float = 0.01
    torque: float = 0.1


@dataclass(frozen=True)
class Instants:
    """K instants of a motion as equations in t, the multiples of the contacts' generators, n of them.

    A multiple of a generator of moments is in [N m] where the attributes say [N].

        E t = b,  tau = c - A t,  lower <= t <= upper,  |tau| <= limit

    and, in space, t in the friction cones whose apexes `lower` and `upper` hold.

    Attributes:
        E: Wrench of the generators on the velocities without a motor, shape (K, u, n).
        b: What those velocities need [N, N m], shape (K, u).
        A: Torque of the generators on the joints with a motor [m], shape (K, j, n).
        c: Torques without contact forces [N m], shape (K, j).
        forces: The contacts, leading shape (k,), with their true limits; n = k p.
        lower: Least multiples with the margin [N], shape (n,).
        upper: Greatest multiples with the margin [N], shape (n,).
        effort: True torque limits [N m], shape (j,); infinite for a motor without one.
        limit: Torque limits with the margin [N m], shape (j,).
        motors: Places of the joints with a motor among all joints, shape (j,).
        num_joints: Number of all joints; the torque of one without a motor is zero.
    """

    E: Vector
    b: Vector
    A: Vector
    c: Vector
    forces: ContactForces
    lower: Vector
    upper: Vector
    effort: Vector
    limit: Vector
    motors: Indices
    num_joints: int

    @classmethod
    def of_loads(
        cls,
        robot: Robot,
        forces: ContactForces,
        load: Vector,
        J: Vector,
        margin: Margin,
        turning: Vector | None = None,
    ) -> Instants:
        """The instants at which contact forces and torques must supply given generalised forces.

        Args:
            robot: The robot.
            forces: The forces of the contacts that hold, leading shape (k,).
            load: M vd + h [N, N m], shape (K, nv).
            J: Contact Jacobians of the feet in the order of `forces`, shape (K, m, nv), m = 2 k or 3 k.
            margin: How far to stay inside the limits.
            turning: How fast the feet turn about z by the velocities, see `climber.dynamics.turning`, shape (k, nv);
                needed where contacts take moments.
        """
        K, nv = load.shape
        k, p = forces.lower.shape
        axes = J.shape[1] // k if k else 3
        J = J.reshape(K, k, axes, nv)
        wrench: Vector = np.einsum("skav,kap->svkp", J, forces.generators[:, :axes])
        if forces.moments is not None and turning is not None:
            wrench = wrench + np.einsum("kv,kp->vkp", turning, forces.moments)
        wrench = wrench.reshape(K, nv, k * p)
        rest: Vector = load - np.einsum("skav,ka->sv", J, forces.offset[:, :axes])
        motors = np.flatnonzero(robot.effort > 0.0)
        driven, effort = robot.joint_v[motors], robot.effort[motors]
        free = np.setdiff1d(np.arange(nv), driven)
        lower, upper = forces.lower.ravel(), forces.upper.ravel()
        inward = np.minimum(max(margin.force, GUARD), 0.5 * (upper - lower))
        return cls(
            E=wrench[:, free],
            b=rest[:, free],
            A=wrench[:, driven],
            c=rest[:, driven],
            forces=forces,
            lower=lower + inward,
            upper=upper - inward,
            effort=effort,
            limit=np.minimum((1.0 - margin.torque) * effort, effort - GUARD),
            motors=motors,
            num_joints=len(robot.effort),
        )

    def __len__(self) -> int:
        return len(self.b)

    def __getitem__(self, index: Indices | Mask | slice) -> Instants:
        """The instants at `index`."""
        result = replace(self, E=self.E[index], b=self.b[index], A=self.A[index], c=self.c[index])
        # What takes long is worked out once.
        vars(result).update(lift=self.lift[index], scales=self.scales, _force_limits=self._force_limits)
        return result

    def objective(self) -> tuple[Vector, Vector]:
        """H, shape (K, n, n), and g, (K, n), of the objective t^T H t / 2 + g^T t: small torques, forces amid limits.

        It is sum_j (tau_j / tau_max_j)^2 + w sum_i ((t_i - aim_i) / half_range_i)^2 up to a constant.
        """
        aim, stiffness, effort = self.scales
        scaled = self.A / effort[:, None]
        H: Vector = 2.0 * (np.einsum("sji,sjl->sil", scaled, scaled) + np.diag(stiffness))
        g: Vector = -2.0 * (np.einsum("sji,sj->si", scaled, self.c / effort) + stiffness * aim)
        return H, g

    @cached_property
    def scales(self) -> tuple[Vector, Vector, Vector]:
        """Multiples preferred [N], cost of the square of leaving them [1/N^2], torque limits [N m] (1 if none).

        The cost is w / half_range^2, where there is no range w; in space a cone's multiples weigh as their two do in
        the plane.
        """
        lower, upper = self.forces.lower.ravel(), self.forces.upper.ravel()
        half, weight = (x.ravel() for x in self.forces.scales())
        aim = (1.0 - MIDWAY) * np.clip(0.0, lower, upper) + MIDWAY * 0.5 * (lower + upper)
        stiffness = CENTERING * weight / np.where(half > 0.0, half, 1.0) ** 2
        return aim, stiffness, np.where(self.effort < np.inf, self.effort, 1.0)

    @cached_property
    def _force_limits(self) -> ForceLimits:
        return self.forces.limits(self.lower, self.upper)

    def force_limits(self) -> tuple[Vector, Vector]:
        """Matrix, shape (K, r, n), and right side, (K, r), of the linear limits, lower <= t <= upper in the plane."""
        K, (R, g) = len(self), (self._force_limits.R, self._force_limits.g)
        return np.broadcast_to(R, (K, *R.shape)), np.broadcast_to(g, (K, *g.shape))

    def force_cones(self) -> tuple[Vector, Vector]:
        """C, shape (K, c, 3, n), and d, (K, c, 3), of the limits d - C t in second-order cones; none in the plane."""
        K, (C, d) = len(self), (self._force_limits.C, self._force_limits.d)
        return np.broadcast_to(C, (K, *C.shape)), np.broadcast_to(d, (K, *d.shape))

    def torque_limits(self) -> tuple[Vector, Vector]:
        """Matrix, shape (K, 2 l, n), and right side, (K, 2 l), of |c - A t| <= limit for the l motors that have one."""
        limited = np.isfinite(self.limit)
        A, c, limit = self.A[:, limited], self.c[:, limited], self.limit[limited]
        return np.concatenate([-A, A], axis=1), np.concatenate([limit - c, limit + c], axis=1)

    def balanced(self, t: Vector) -> Vector:
        """The t nearest to the given ones, both of shape (K, n), with E t = b, or with the least |E t - b|."""
        gap = self.b - np.einsum("sun,sn->su", self.E, t)
        result: Vector = t + np.einsum("snu,su->sn", self.lift, gap)
        return result

    @cached_property
    def lift(self) -> Vector:
        """The pseudo-inverses of E, shape (K, n, u): the least change of t that changes E t."""
        return right_inverse(self.E)

    def imbalance(self, t: Vector) -> Vector:
        """The greatest entry of |E t - b| [N, N m], shape (K,), for t of shape (K, n)."""
        result: Vector = np.abs(np.einsum("sun,sn->su", self.E, t) - self.b).max(axis=1, initial=0.0)
        return result

    def inside(self, t: Vector) -> Mask:
        """Whether t, shape (K, n), and its torques are inside all limits, shape (K,)."""
        shape = self.forces.lower.shape
        excess = self.forces.excess(t.reshape(len(t), *shape), self.lower.reshape(shape), self.upper.reshape(shape))
        torques = np.abs(self.motor_torque(t)) <= self.limit
        return np.asarray((excess <= 0.0).all(axis=1) & torques.all(axis=1))

    def motor_torque(self, t: Vector) -> Vector:
        """Torques of the joints with a motor, c - A t [N m], shape (K, j), for t of shape (K, n)."""
        result: Vector = self.c - np.einsum("sjn,sn->sj", self.A, t)
        return result

    def torque(self, t: Vector) -> Vector:
        """Torques of all joints [N m], shape (K, num_joints), for t of shape (K, n)."""
        result = np.zeros((len(t), self.num_joints))
        result[:, self.motors] = self.motor_torque(t)
        return result

    def moment(self, t: Vector) -> Vector:
        """Moments of the contacts on the robot about z [N m], shape (K, k), for t of shape (K, n)."""
        k, p = self.forces.lower.shape
        if self.forces.moments is None:
            return np.zeros((len(t), k))
        result: Vector = np.einsum("kp,skp->sk", self.forces.moments, t.reshape(len(t), k, p))
        return result

    def force(self, t: Vector) -> Vector:
        """Forces of the contacts on the robot in W [N], shape (K, k, 3), for t of shape (K, n)."""
        k, p = self.forces.lower.shape
        result: Vector = self.forces.offset + np.einsum("kap,skp->ska", self.forces.generators, t.reshape(len(t), k, p))
        return result
