"""What makes one motion better than another along the same moves: length, time, or margin.

A climb is planned with a cost that is quick to work out, between neighbouring postures, and judged by its value, which
is worked out from the motion's samples and stands in the plan file. The value is to be low.

    objective   cost of going from posture to posture              value
    length      |q' - q|_2 over all positions [m, rad]             length in joint space of all phases [m, rad]
    time        |(q' - q) / fastest|_4 over all positions [s]      duration of the climb [s]
    margin      how near the centre of mass is to where the        the least slack of the climb, less than nothing:
                support ends, and a little length                  -min(distance of the centre of mass from the ends of
                                                                   the support over a limb's mean reach, share of the
                                                                   weakest joint's torque that is left)

Length is that of table 5.1 of Gönen 2021: metres and radians count alike. The 4-norm is a smooth stand-in for the
greatest of the joints' times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climber.curve import joint_length
from climber.manifold import Body, Manifold
from climber.phase_motion import PhaseMotion
from climber.plan_parts import ObjectiveKind
from climber.stance import Vector
from climber.transition import support_of

FLIP = 4.0  # what an elbow flip counts as, in joint-space length [rad]
PELVIS = 1.0  # [m/s, rad/s] rate at which the pelvis's own positions are taken to change at most
LITTLE = 0.05  # [1/rad] weight of length beside the logarithm of a margin
SHORTEST = 1e-3  # [rad, s] a step below this counts as this where slopes are taken
LEAST = 1e-4  # [m] a distance from the support's ends below this counts as this


@dataclass(frozen=True)
class Norm:
    """|d| = (sum_j |s_j d_j|^p)^(1/p) of differences of positions.

    Attributes:
        scale: s, shape (nq,).
        power: p, 2 or greater.
    """

    scale: Vector
    power: int = 2

    def __call__(self, d: Vector) -> Vector:
        """Norm of differences, shape (..., nq) to (...)."""
        result: Vector = (np.abs(self.scale * d) ** self.power).sum(axis=-1) ** (1.0 / self.power)
        return result

    def model(self, d: Vector) -> tuple[Vector, Vector]:
        """Gradient (K, nq) and a Hessian (K, nq, nq) of the norm at differences d, shape (K, nq).

        The Hessian is that of half the norm's square, over the norm: for p = 2 the resulting quadratic is nowhere less
        than the norm, so that steps which lower it lower the norm. Norms below `SHORTEST` count as that much.
        """
        x, p = self.scale * d, self.power
        size = np.maximum(self(d), SHORTEST)[:, None]
        share = np.abs(x) / size
        gradient = self.scale * np.sign(x) * share ** (p - 1)
        diagonal = (p - 1) * self.scale**2 * share ** (p - 2) / size
        outer = gradient[:, :, None] * gradient[:, None, :] / size[:, :, None]
        return gradient, diagonal[:, :, None] * np.eye(len(self.scale)) - (p - 2) * outer


@dataclass(frozen=True)
class Objective:
    """What is to be little along a climb of one robot.

    Attributes:
        kind: length, time or margin.
        norm: Of the step from one posture to the next.
        weight: What one unit of it costs.
        centring: What minus the logarithm of the centre of mass's distance from an end of the support costs.
        flip: What bending a limb that holds the other way costs.
    """

    kind: ObjectiveKind
    norm: Norm
    weight: float
    centring: float
    flip: float

    @classmethod
    def of(cls, kind: ObjectiveKind, body: Body) -> Objective:
        """The objective for one robot."""
        robot = body.robot
        ones = np.ones(robot.plant.num_positions())
        if kind == "length":
            return cls(kind, Norm(ones), 1.0, 0.0, FLIP)
        if kind == "margin":
            return cls(kind, Norm(ones), LITTLE, 1.0, LITTLE * FLIP)
        fastest = PELVIS * ones
        for limb in robot.limbs:
            fastest[limb.q] = np.where(np.isfinite(limb.velocity), limb.velocity, 10.0)
        joints = np.concatenate([limb.velocity for limb in robot.limbs])
        return cls(kind, Norm(1.0 / fastest, 4), 1.0, 0.0, FLIP / float(np.median(joints)) if len(joints) else FLIP)

    def step(self, d: Vector) -> Vector:
        """Cost of going from one posture to another by differences of positions, shape (..., nq) to (...)."""
        return self.weight * self.norm(d)

    def standing(self, manifold: Manifold, q: Vector) -> Vector:
        """Cost of postures as such, on a manifold of the instant they are for, shape (K, nq) to (K,)."""
        if not self.centring:
            return np.zeros(len(q))
        rows = manifold.balance(q)
        result: Vector = -self.centring * np.log(np.maximum(rows, LEAST)).sum(axis=1)
        return result

    def value(self, body: Body, phases: Sequence[PhaseMotion]) -> float:
        """The value of a climb, from its samples."""
        if self.kind == "length":
            return sum(joint_length(phase.samples.q) for phase in phases)
        if self.kind == "time":
            return float(sum(phase.samples.time[-1] - phase.samples.time[0] for phase in phases))
        return -least_slack(body, phases)


def least_slack(body: Body, phases: Sequence[PhaseMotion]) -> float:
    """The least slack of a climb: of equilibrium, over a limb's mean reach, and of torque, as a share of its limit.

    At the ends of a phase the centre of mass is in the support of the neighbouring phase too.
    """
    reach = float(body.robot.reach.mean())
    supports = {phase.contacts: support_of(body, phase.contacts) for phase in phases}
    driven = body.robot.effort > 0.0
    slack = 1.0
    for i, phase in enumerate(phases):
        center = body.kinematics.center_of_mass(phase.samples.q)
        over = [(phase, center)]
        over += [(phases[j], center[[row]]) for j, row in ((i - 1, 0), (i + 1, -1)) if 0 <= j < len(phases)]
        for holding, at in over:
            support = supports[holding.contacts]
            room = -np.inf if support is None else float(support.room(at).min())
            slack = min(slack, room / reach)
        used = np.abs(phase.torque[:, driven]) / body.robot.effort[driven]
        slack = min(slack, float((1.0 - used).min(initial=np.inf)))
    return slack
