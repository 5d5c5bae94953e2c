"""The equations of motion along a trajectory, and inverse dynamics by orthogonal decomposition (Gönen 2021, 4.5).

A robot that holds on with some of its feet moves by

    M(q) vd + h(q, v) = S^T tau + J_c(q)^T lambda        (4.24)
    J_c v = 0,  J_c vd + Jdot_c v = 0                    (4.25), (4.26)

M is the mass matrix, h the Coriolis and centripetal terms less gravity and the forces of springs and dampers, S selects
the actuated joints, and J_c has two rows for a foot on a planar wall, three in space. A contact force in lambda acts on
the robot, in the axes of W.

The decomposition says which torques make a motion, were the holds able to push and pull at will. Whether they can is
the question of `climber.programs.torque`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces
from pydrake.systems.framework import Context

from climber.robot import Indices, Robot
from climber.stance import Vector

RANK_TOLERANCE = 1e-9  # a singular value this small beside the greatest counts as zero


@dataclass(frozen=True)
class DynamicsBatch:
    """Equation 4.24 at K samples, for feet that hold on with m rows of J_c in all.

    Attributes:
        M: Mass matrices [kg, kg m, kg m^2], shape (K, nv, nv).
        h: Bias forces [N, N m], shape (K, nv).
        J: Contact Jacobians, the rows of one foot after those of another, shape (K, m, nv).
        Jdot_v: Jdot_c v, acceleration of the feet at vd = 0 [m/s^2], shape (K, m).
        actuated: Places of the actuated joints in the velocities, in the order of `Robot.joint_names`, (num_joints,).
    """

    M: Vector
    h: Vector
    J: Vector
    Jdot_v: Vector
    actuated: Indices

    def load(self, vd: Vector) -> Vector:
        """M vd + h, what torques and contact forces must supply for accelerations `vd`, both of shape (K, nv)."""
        result: Vector = np.einsum("kij,kj->ki", self.M, vd) + self.h
        return result

    def residual(self, vd: Vector, torque: Vector, force: Vector) -> Vector:
        """M vd + h - S^T tau - J_c^T lambda, shape (K, nv), for torques (K, num_joints) and lambda (K, m)."""
        rest: Vector = self.load(vd) - np.einsum("kmi,km->ki", self.J, force)
        rest[:, self.actuated] -= torque
        return rest

    def slip(self, vd: Vector) -> Vector:
        """Acceleration of the holding feet [m/s^2], shape (K, m), for `vd` (K, nv); zero where they stay put (4.26)."""
        result: Vector = np.einsum("kmi,ki->km", self.J, vd) + self.Jdot_v
        return result


class Sampler:
    """Asks Drake for the terms of equation 4.24 at one state after another, a few microseconds a term."""

    def __init__(self, robot: Robot, holding: Sequence[int], context: Context | None = None) -> None:
        self.plant, self.context = robot.plant, context or robot.context()
        self._feet = [self.plant.GetFrameByName(robot.limbs[limb].foot) for limb in holding]
        # An axis across the wall carries no force of a planar robot: its planar joint does.
        self._axes = 2 if robot.planar else 3
        self._forces = MultibodyForces(self.plant)
        # Any, for Drake's stubs spell array types in a way that mypy refuses.
        self._rest: Any = np.zeros(self.plant.num_velocities())
        self._origin: Any = np.zeros(3)
        self.num_rows = self._axes * len(self._feet)

    def h(self) -> Vector:
        """The bias at the context's state, shape (nv,). The force elements are gravity, springs and dampers."""
        return self.load(self._rest)

    def load(self, vd: Vector) -> Vector:
        """M vd + h, shape (nv,), for accelerations of that shape."""
        self.plant.CalcForceElementsContribution(self.context, self._forces)
        return np.asarray(self.plant.CalcInverseDynamics(self.context, vd, self._forces))

    def J(self, out: Vector) -> None:
        """Fills the contact Jacobian, shape (num_rows, nv)."""
        world, n = self.plant.world_frame(), self._axes
        for i, foot in enumerate(self._feet):
            out[n * i : n * i + n] = self.plant.CalcJacobianTranslationalVelocity(
                self.context, JacobianWrtVariable.kV, foot, self._origin, world, world
            )[:n]

    def Jdot_v(self, out: Vector) -> None:
        """Fills the acceleration of the feet at vd = 0, shape (num_rows,)."""
        world, n = self.plant.world_frame(), self._axes
        for i, foot in enumerate(self._feet):
            out[n * i : n * i + n] = self.plant.CalcBiasTranslationalAcceleration(
                self.context, JacobianWrtVariable.kV, foot, self._origin, world, world
            )[:n, 0]


def turning(robot: Robot, limbs: Sequence[int]) -> Vector:
    """How fast the feet of a planar robot's limbs turn about z by its velocities, shape (len(limbs), nv); constant."""
    result: Vector = robot.turning[np.array(limbs, dtype=int)]
    return result


def passive(robot: Robot) -> tuple[Vector, Vector]:
    """Damping [N m s/rad] and reflected inertia of the rotors [kg m^2] by velocity, shape (nv,) each."""
    plant, context = robot.plant, robot.context()
    damping, rotors = np.zeros(plant.num_velocities()), np.zeros(plant.num_velocities())
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        start = joint.velocity_start()
        damping[start : start + joint.num_velocities()] = joint.default_damping_vector()
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        rotors[actuator.joint().velocity_start()] += actuator.calc_reflected_inertia(context)
    return damping, rotors


def evaluate(robot: Robot, q: Vector, v: Vector, holding: Sequence[int]) -> DynamicsBatch:
    """The equations of motion at K samples.

    Args:
        robot: The robot.
        q: Positions [m, rad], shape (K, nq).
        v: Velocities [m/s, rad/s], shape (K, nv).
        holding: The limbs whose feet hold on; their order is that of the rows of J_c.
    """
    sampler, K, nv = Sampler(robot, holding, robot.workspace), len(q), robot.plant.num_velocities()
    M, h = np.empty((K, nv, nv)), np.empty((K, nv))
    J, Jdot_v = np.empty((K, sampler.num_rows, nv)), np.empty((K, sampler.num_rows))
    for k, state in enumerate(np.concatenate([q, v], axis=1)):
        sampler.plant.SetPositionsAndVelocities(sampler.context, state)
        M[k] = sampler.plant.CalcMassMatrix(sampler.context)
        h[k] = sampler.h()
        sampler.J(J[k])
        sampler.Jdot_v(Jdot_v[k])
    return DynamicsBatch(M, h, J, Jdot_v, robot.joint_v)


def evaluate_at_rest(robot: Robot, q: Vector, holding: Sequence[int]) -> tuple[Vector, Vector]:
    """The bias h, shape (K, nv), and the contact Jacobians, shape (K, m, nv), of `evaluate` for postures q at v = 0."""
    sampler, K, nv = Sampler(robot, holding, robot.workspace), len(q), robot.plant.num_velocities()
    h, J = np.empty((K, nv)), np.empty((K, sampler.num_rows, nv))
    plant, context = sampler.plant, sampler.context
    gravity_alone = plant.num_force_elements() == 1  # no springs: quicker
    for k, state in enumerate(np.pad(q, ((0, 0), (0, nv)))):
        plant.SetPositionsAndVelocities(context, state)
        h[k] = -plant.CalcGravityGeneralizedForces(context) if gravity_alone else sampler.h()
        sampler.J(J[k])
    return h, J


@dataclass(frozen=True)
class InverseDynamics:
    """Torques and contact forces that make a motion, holds permitting.

    Attributes:
        torque: Joint torques [N m], shape (K, num_joints).
        force: lambda, forces of the holds on the feet in W [N], row by row of J_c, shape (K, m).
    """

    torque: Vector
    force: Vector


def inverse_dynamics(dynamics: DynamicsBatch, vd: Vector) -> InverseDynamics:
    """The least torques that make the accelerations `vd`, shape (K, nv), and the contact forces that go with them.

    The QR decomposition J_c^T = Q [R; 0] (4.27) splits equation 4.24. The rows free of contact forces give the torques
    by a pseudo-inverse (4.32), the others then give the forces (4.33). The equations are met exactly when J_c has full
    row rank and the torques can act in all directions left free; `DynamicsBatch.residual` tells.
    """
    J, actuated = dynamics.J, dynamics.actuated
    m = J.shape[1]
    Q, R = np.linalg.qr(np.swapaxes(J, 1, 2), mode="complete")
    load = np.einsum("kji,kj->ki", Q, dynamics.load(vd))  # Q^T (M vd + h)
    QtSt = np.swapaxes(Q[:, actuated], 1, 2)  # Q^T S^T, shape (K, nv, num_joints)
    free = np.linalg.pinv(QtSt[:, m:], rcond=RANK_TOLERANCE)
    torque = np.einsum("kji,ki->kj", free, load[:, m:])
    # pinv(R) is the inverse of R when J_c has full row rank.
    inverse = np.linalg.pinv(R[:, :m], rcond=RANK_TOLERANCE)
    force = np.einsum("kij,kj->ki", inverse, load[:, :m] - np.einsum("kij,kj->ki", QtSt[:, :m], torque))
    return InverseDynamics(torque, force)
