"""What pushes a robot that it was not told of, found out from how it moves.

Holding feet keep a robot from moving other than by N nu, where nu are the velocities of the pelvis and of the joints of
limbs that hold nothing. A disturbance d, a generalised force, is felt as f = N^T d: it changes nu by Lambda^-1 f dt in
a time dt, Lambda = N^T M N, and that is what is observed (the observer of momentum, De Luca and Mattone 2003, Haddadin
et al. 2017, 4.2, in these coordinates and discrete):

    (1) f' = f'_expected + k Lambda (nu - nu_expected) / dt

All d with N^T d = f move the robot alike, but they press differently on the feet that hold. Three causes are told
apart: a robot that is heavier than its model by a share s, a push F at its centre of mass, and a centre of mass that is
off, which makes a moment m across gravity. With the Jacobians P of that point as one of the pelvis and R of the
pelvis's turning,

    (2) f = -s N^T (M vd + h),   f = N^T P^T F,   or   f = N^T R^T m.

While all limbs hold there are too few numbers in f to add causes up, so the one that by itself comes nearest in the
sense of least squares, of late, is taken for it, and its mass if that is as near, which has the fewest numbers: errors
come one at a time. A robot that is heavier has d = -s (M vd + h), h without the damping of joints, which changes as
soon as it is to move otherwise or a limb lets go; what remains of f acts on the pelvis and the free limbs themselves,
and is expected to stay as it is.
"""

from __future__ import annotations

import math

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable

from climber.definite import solved
from climber.robot import Indices, Robot
from climber.stance import Vector

FINDING = 50.0  # k [1/s]
WEIGHING = 20.0  # how fast it is told how much heavier the robot is [1/s]
LEVER = 0.1  # a torque counts as a force at this distance [m]
ALIKE = 1e-3  # share of the square of what is felt; causes that miss it by so little more than the nearest are as near
MOST = 50.0  # acceleration that is taken for a disturbance within one time step at most [m/s^2, rad/s^2]
LIGHTEST, HEAVIEST = -0.95, 3.0  # shares beyond which no robot is lighter or heavier than its model
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
        self._step, self._rest = time_step, np.zeros(len(robot.velocity_names))
        self._scale = np.full(len(robot.velocity_names), 1.0 / LEVER)
        self._scale[robot.origin_q] = 1.0  # the pelvis's velocities are in the order of its positions
        self._turns, self._pelvis = self._couples(robot), robot.base_v
        self._missed = np.zeros(3)
        self._expected: Vector | None = None

    @staticmethod
    def _couples(robot: Robot) -> Vector:
        """Moments on the pelvis that gravity makes if the centre of mass is off, as generalised forces, (c, nv)."""
        context, world, pelvis = robot.context(), robot.plant.world_frame(), robot.pelvis.body_frame()
        wrt = JacobianWrtVariable.kV
        turning = robot.plant.CalcJacobianAngularVelocity(context, wrt, pelvis, world, world)
        down = robot.gravity / max(float(np.linalg.norm(robot.gravity)), LITTLE)
        moments = np.cross(np.eye(3)[: robot.dimension], down) @ turning
        _, sizes, ways = np.linalg.svd(moments, full_matrices=False)
        return np.asarray(ways * (sizes > LITTLE)[:, None])

    def forget(self, joints: Indices) -> None:
        """A limb lets go or takes hold: what its joints feel from then on is something else, at first their weight.

        Args:
            joints: Places of its joints among the velocities.
        """
        self._rest[joints], self._expected = 0.0, None

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
        self._rest[free] += FINDING * (inertia @ off)

    def weigh(self, load: Vector, push: Vector, free: Indices, motions: Vector) -> None:
        """Looks for the cause of what is felt.

        Args:
            load: What the model's masses need, M vd + h less what damping and rotors do [N, N m], shape (nv,).
            push: P, shape (axes, nv).
            free: As in `observe`.
            motions: N, shape (nv, n).
        """
        scale, needed = self._scale[free], motions.T @ load
        felt, mass = (self._rest[free] - self.heavier * needed) * scale, -needed * scale
        share, missed = 0.0, np.zeros(3)
        for number, cause in enumerate((mass[None], push[:, free] * scale, self._turns[:, free] * scale)):
            found = solved(cause @ cause.T + LITTLE * np.eye(len(cause)), cause @ felt)
            off = felt - found @ cause
            missed[number] = off @ off
            share = share if number else min(max(float(found[0]), LIGHTEST), HEAVIEST)
        self._missed += WEIGHING * self._step * (missed - self._missed)
        if self._missed[0] > self._missed.min() + ALIKE * (felt @ felt):
            share = 0.0
        more = WEIGHING * self._step * (share - self.heavier)
        self.heavier += more
        self._rest[free] += more * needed

    def parts(self, load: Vector, free: Indices) -> tuple[Vector, Vector]:
        """What disturbs the robot as generalised forces [N, N m], shape (nv,): by its masses, and the rest.

        Args:
            load: As in `weigh`.
            free: As in `observe`.
        """
        rest = np.zeros(len(load))
        rest[free] = self._rest[free]
        return -self.heavier * load, rest

    def size(self, rest: Vector) -> float:
        """How hard the pelvis is pushed and turned by what disturbs it [N], `rest` as `parts` has it."""
        return math.hypot(*(rest * self._scale)[self._pelvis].tolist())
