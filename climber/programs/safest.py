"""The contact forces farthest from slipping, among those that make a motion.

Where more feet hold than must, the motion does not determine the forces. The time-optimal ones of
`climber.programs.time_scaling` press against limits wherever that gains time; those sent to the robot should be as far
inside them as they can be, and smooth.
"""

from __future__ import annotations

import numpy as np

from climber.programs import torque_blocks
from climber.programs.instants import Instants, Mask
from climber.stance import Vector

POWER = 3  # the higher, the more only the nearest limit counts
TORQUE_SCALE = 0.5  # distance from a torque limit, as a share of it, that counts like `scale` from a force limit
SIGNS = np.array([1.0, -1.0, -1.0])  # z_0^2 - z_1^2 - z_2^2 is positive in a cone
STEPS = 60  # of Newton's method at the most; some ten are taken
QUADRATIC = 1e-7  # decrease of the objective, against itself, from which on full steps converge
DONE = 1e-10  # decrease that the last step makes
RIDGE = 1e-14  # keeps the Hessian regular where one limit is so near that the others vanish beside it
STRICT = 0.005  # [N, N m] room inside the limits that there must be
ROOMY = 0.1  # [N, N m] room that is enough to begin with


def safest_forces(instants: Instants, start: Vector, scale: float) -> tuple[Vector, Mask]:
    """Forces far inside all limits, t (K, n), and where such were found, (K,).

    With d_r the distance of t, or of a torque, from its limit r [N, N m]:

        min         sum_r (scale_r / d_r)^p
        subject to  E t = b,  tau = c - A t,  all d_r > 0

    (a round cone |u| < s counts as two limits, by the geometric mean of the distances s - |u| and s + |u|).

    For p to infinity this is the greatest least distance. Unlike that, it has a unique solution (the objective is
    strictly convex), which is a smooth function of the instant, and with it are forces and torques along a motion.

    Args:
        instants: The instants.
        start: Forces to begin with, shape (K, n); the nearest ones that balance are taken. Where these are hardly
            inside all limits, those farthest inside are.
        scale: scale_r of the forces [N]: what a foot usually carries.
    """
    objective = _Objective(instants, scale)
    t = instants.balanced(start)
    tight = np.flatnonzero(objective.room(t) <= ROOMY)
    if len(tight):
        t[tight] = instants[tight].balanced(torque_blocks.least_violation(instants[tight])[0])
    good = (objective.room(t) > STRICT) & (instants.imbalance(t) <= torque_blocks.TOLERANCE)
    chosen = np.flatnonzero(good)
    if len(chosen):
        t[chosen] = _descended(_Objective(instants[chosen], scale), instants.E[chosen], t[chosen])
        t[chosen] = instants[chosen].balanced(t[chosen])
    return t, good


def cone_room(z: Vector) -> Vector:
    """How far vectors, shape (..., 3), are inside the second-order cone, along its axis; shape (...)."""
    result: Vector = z[..., 0] - np.hypot(z[..., 1], z[..., 2])
    return result


class _Objective:
    """The objective of `safest_forces` at K instants."""

    def __init__(self, instants: Instants, scale: float) -> None:
        (forces, most), (torques, highest) = instants.force_limits(), instants.torque_limits()
        limited = instants.limit[np.isfinite(instants.limit)]
        self._rows = np.concatenate([forces, torques], axis=1)
        self._limits = np.concatenate([most, highest], axis=1)
        self._scales = np.concatenate([np.full(most.shape[1], scale), np.tile(TORQUE_SCALE * limited, 2)])
        self._cones, self._tops = instants.force_cones()
        self._scale = scale

    def _distances(self, t: Vector) -> tuple[Vector, Vector]:
        """Distances from the rows' limits, (K, r), and vectors in the cones, (K, c, 3)."""
        cones = self._tops - np.einsum("kcan,kn->kca", self._cones, t)
        return self._limits - np.einsum("krn,kn->kr", self._rows, t), cones

    def room(self, t: Vector) -> Vector:
        """The distance from the nearest limit, shape (K,)."""
        distances, cones = self._distances(t)
        result: Vector = np.minimum(distances.min(axis=1, initial=np.inf), cone_room(cones).min(axis=1, initial=np.inf))
        return result

    def value(self, t: Vector) -> Vector:
        """The objective, shape (K,); infinite outside the limits."""
        distances, cones = self._distances(t)
        inside = self.room(t) > 0.0
        result: Vector = np.full(len(t), np.inf)
        squares: Vector = (cones**2 @ SIGNS)[inside]
        result[inside] = ((self._scales / distances[inside]) ** POWER).sum(axis=1)
        result[inside] += 2.0 * ((self._scale**2 / squares) ** (POWER / 2)).sum(axis=1)
        return result

    def nearing(self, t: Vector, step: Vector) -> Vector:
        """The greatest share of its distance from a row's limit that a step takes away, shape (K,)."""
        distances, _ = self._distances(t)
        result: Vector = (np.einsum("krn,kn->kr", self._rows, step) / distances).max(axis=1, initial=0.0)
        return result

    def derivatives(self, t: Vector) -> tuple[Vector, Vector]:
        """Its gradient, shape (K, n), and Hessian, (K, n, n), inside the limits."""
        distances, cones = self._distances(t)
        pull = POWER * (self._scales / distances) ** POWER / distances
        gradient = np.einsum("krn,kr->kn", self._rows, pull)
        hessian = (np.swapaxes(self._rows, 1, 2) * ((POWER + 1) * pull / distances)[:, None]) @ self._rows
        if self._cones.shape[1]:
            # With D = z_0^2 - z_1^2 - z_2^2 the term is 2 scale^p D^(-p/2).
            squares = cones**2 @ SIGNS
            pull = POWER * (self._scale**2 / squares) ** (POWER / 2) / squares
            slope = -2.0 * np.einsum("kca,kcan->kcn", cones * SIGNS, self._cones)  # of D
            gradient -= np.einsum("kcn,kc->kn", slope, pull)
            hessian += np.einsum("kcn,kc,kcm->knm", slope, (POWER / 2 + 1) * pull / squares, slope)
            hessian -= 2.0 * np.einsum("kcan,a,kc,kcam->knm", self._cones, SIGNS, pull, self._cones)
        return gradient, hessian


def _descended(objective: _Objective, E: Vector, t: Vector) -> Vector:
    """Newton's method within E t = b, from t strictly inside the limits, for all instants side by side."""
    identity = np.eye(t.shape[1])
    along = identity - np.linalg.pinv(E) @ E  # projector on the directions that keep the balance
    value = objective.value(t)
    for _ in range(STEPS):
        gradient, hessian = objective.derivatives(t)
        slope = np.einsum("kij,kj->ki", along, gradient)
        size = np.abs(hessian).max(axis=(1, 2), initial=0.0)[:, None, None]
        curvature = along @ hessian @ along + size * (identity - along + RIDGE * identity)
        step = -np.linalg.solve(curvature, slope[:, :, None])[:, :, 0]
        gain = -(slope * step).sum(axis=1)
        length = np.minimum(1.0, 0.9 / np.maximum(objective.nearing(t, step), 1e-9))
        far = gain > QUADRATIC * value
        while True:  # down by a quarter of what the slope promises, but for the last steps, which rounding may hide
            further = objective.value(t + length[:, None] * step)
            short = np.where(far, further > value - 0.25 * length * gain, further == np.inf)
            if not short.any():
                break
            length[short] *= 0.5
        t, value = t + length[:, None] * step, further
        if (gain <= DONE * value).all():
            break
    return t
