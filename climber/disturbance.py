"""What pushes a robot that it was not told of, found out from how it moves.

Holding feet keep a robot from moving other than by N nu, where nu are the velocities of the pelvis and of the joints of
limbs that hold nothing. A disturbance d, a generalised force, is felt as f = N^T d: it changes nu by Lambda^-1 f dt in
a time dt, Lambda = N^T M N, and that is what is observed (the observer of momentum, De Luca and Mattone 2003, Haddadin
et al. 2017, 4.2, in these coordinates and discrete):

    (1) f' = k Lambda (nu - nu_expected) / dt

All d with N^T d = f move the robot alike, but they press differently on the feet that hold. Two causes are told apart,
a robot that is heavier than its model by a share s, and a push F at its centre of mass: with the weights w, and the
Jacobian P of that point as one of the pelvis,

    (2) f = N^T (s w + P^T F)

in the sense of least squares. Links that hang from a limb that swings, and legs that stand aslant, feel their weight
and do not feel the push. While all limbs hold, the two are much alike; then a robot that seems lighter is taken for
that, and one that seems heavier for one that is pushed, since legs that press on holds with the weight they do not have
make light feet slip. What remains of f acts on the pelvis and the free limbs themselves: d = s w + [f - N^T s w].
"""

from __future__ import annotations

import math

import numpy as np

from climber.definite import solved
from climber.robot import Indices, Robot
from climber.stance import Vector

FINDING = 50.0  # k [1/s]
WEIGHING = 20.0  # how fast it is told how much heavier the robot is [1/s]
RIDGE = 0.02  # causes that differ by a smaller share are not told apart
LEVER = 0.1  # a torque counts as a force at this distance [m]
MOST = 50.0  # acceleration that is taken for a disturbance within one time step at most [m/s^2, rad/s^2]
LITTLE = 1e-9  # [N]


class Disturbance:
    """What disturbs one robot.

    Attributes:
        heavier: Share by which the robot is heavier than its model.
    """

    def __init__(self, robot: Robot, time_step: float) -> None:
        """Nothing is felt yet.

        Args:
            robot: The robot.
            time_step: Between observations [s].
        """
        self.heavier = 0.0
        self._step, self._felt = time_step, np.zeros(len(robot.velocity_names))
        self._pelvis = len(robot.base_v)
        self._scale = np.full(len(robot.velocity_names), 1.0 / LEVER)
        self._scale[robot.origin_q] = 1.0  # the pelvis's velocities are in the order of its positions
        self._expected: Vector | None = None

    def forget(self, joints: Indices) -> None:
        """A limb lets go or takes hold: what its joints feel from then on is something else."""
        self._felt[joints], self._expected = 0.0, None

    def expect(self, nu: Vector) -> None:
        """The velocities of free motions that there will be at the next observation if nothing disturbs the robot."""
        self._expected = nu

    def observe(self, nu: Vector, free: Indices, inertia: Vector) -> None:
        """Looks at the velocities.

        Args:
            nu: Of the pelvis, and of the joints of free limbs after those [m/s, rad/s], shape (n,).
            free: Their places among the robot's velocities, shape (n,).
            inertia: Lambda, shape (n, n).
        """
        if self._expected is None:
            return
        most = MOST * self._step
        off = np.minimum(np.maximum(nu - self._expected, -most), most)
        self._felt[free] += FINDING * (inertia @ off)

    def weigh(self, weight: Vector, push: Vector, free: Indices, motions: Vector) -> None:
        """Looks for the cause of what is felt.

        Args:
            weight: Of the model as generalised forces [N, N m], shape (nv,).
            push: P, shape (axes, nv).
            free: As in `observe`.
            motions: N, shape (nv, n).
        """
        scale = self._scale[free]
        hanging = motions.T @ weight
        size = math.sqrt(hanging @ hanging) + LITTLE
        causes = np.concatenate([hanging[None] / size, push[:, free]]) * scale
        found = solved(causes @ causes.T + RIDGE**2 * np.eye(len(causes)), causes @ (self._felt[free] * scale))
        share = float(found[0]) / size
        if len(free) == self._pelvis:
            share = min(share, 0.0)
        self.heavier += WEIGHING * self._step * (share - self.heavier)

    def parts(self, weight: Vector, free: Indices, motions: Vector) -> tuple[Vector, Vector]:
        """What disturbs the robot as generalised forces [N, N m], shape (nv,): by weight, and the rest.

        Args:
            weight: Of the model [N, N m], shape (nv,).
            free: As in `observe`.
            motions: N, shape (nv, n).
        """
        more, rest = self.heavier * weight, np.zeros(len(weight))
        rest[free] = self._felt[free] - motions.T @ more
        return more, rest
