"""The robot's mechanics for many instants at once, written for `verify` alone and held to Drake's plant.

A plan has some fifty thousand instants between its samples, and Drake takes them one at a time. `Tree` reads bodies,
joints and inertias from the plant and evaluates poses, feet, centre of mass and the equations of motion for whole
arrays. `DrakeModel` asks the plant itself. `verify` compares the two at every sample and stops trusting the plan if
they differ, so Drake remains the authority.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, MultibodyForces

from climber.exceptions import ModelError
from climber.robot import Robot
from climber.stance import Vector
from climber.verify_joints import Freedom, freedoms, pose, rates


@dataclass(frozen=True)
class Poses:
    """Where every body is at K instants, world first, in W.

    Attributes:
        rotation: Orientations R_WB, shape (num_bodies, K, 3, 3).
        origin: Origins p_WBo [m], shape (num_bodies, K, 3).
        hinge: Origins of the joints' moving frames p_WMo [m], by the joint's child body, shape (num_bodies, K, 3).
        axes: Directions in W along or about which the joint of each child body moves, one for each of its velocities,
            shape (K, 3) or (3,) each.
    """

    rotation: Vector
    origin: Vector
    hinge: Vector
    axes: dict[int, list[Vector]]


class Tree:
    """Kinematics and dynamics of a tree of revolute and welded joints on a planar or floating base, in numpy."""

    def __init__(self, robot: Robot) -> None:
        plant = robot.plant
        context = plant.CreateDefaultContext()
        self._gravity = robot.gravity
        self._joints = _in_order(plant)
        self._freedoms: list[tuple[Freedom, ...]] = []
        for joint in self._joints:
            known = freedoms(joint, joint.parent_body().index() == plant.world_body().index())
            if known is None:
                raise ModelError(
                    f"{robot.model.path}: verify cannot follow the {joint.type_name()} joint {joint.name()!r}"
                )
            self._freedoms.append(known)
        bodies = [plant.get_body(joint.child_body().index()) for joint in self._joints]
        self._num_bodies = plant.num_bodies()
        self._mass = np.zeros(self._num_bodies)
        self._center = np.zeros((self._num_bodies, 3))  # p_BoBcm_B
        self._inertia = np.zeros((self._num_bodies, 3, 3))  # I_BBcm_B
        for body in bodies:
            inertia = body.CalcSpatialInertiaInBodyFrame(context)
            self._mass[int(body.index())] = inertia.get_mass()
            self._center[int(body.index())] = inertia.get_com()
            about_center = inertia.CalcRotationalInertia().ShiftToCenterOfMass(inertia.get_mass(), inertia.get_com())
            self._inertia[int(body.index())] = about_center.CopyToFullMatrix3()
        self._damping = np.zeros(plant.num_velocities())
        for joint in self._joints:
            start = joint.velocity_start()
            self._damping[start : start + joint.num_velocities()] = joint.default_damping_vector()
        self._armature = np.zeros(plant.num_velocities())
        for index in plant.GetJointActuatorIndices():
            actuator = plant.get_joint_actuator(index)
            self._armature[actuator.joint().velocity_start()] += actuator.calc_reflected_inertia(context)
        frames = [plant.GetFrameByName(limb.foot) for limb in robot.limbs]
        self._foot_body = [int(frame.body().index()) for frame in frames]
        self._foot = [frame.GetFixedPoseInBodyFrame().translation() for frame in frames]
        self._pelvis = int(robot.pelvis.index())

    def heavier(self, times: float) -> Tree:
        """The tree with all masses and inertias greater by a factor; what joints themselves resist by stays."""
        result = copy(self)
        result._mass, result._inertia = times * self._mass, times * self._inertia
        return result

    def off_center(self, displacement: Vector) -> Tree:
        """The tree whose centre of mass is displaced, by the pelvis's, with the pelvis's inertia about its origin kept.

        Args:
            displacement: In the pelvis's frame [m], shape (3,).
        """
        result = copy(self)
        result._center, result._inertia = self._center.copy(), self._inertia.copy()
        body, mass = self._pelvis, self._mass[self._pelvis]
        before = self._center[body]
        after = before + self._mass.sum() / mass * displacement
        result._center[body] = after
        result._inertia[body] += mass * (_spread(before) - _spread(after))
        return result

    def held_at(self, points: Vector) -> Tree:
        """The tree whose feet are points of the pelvis, given in its frame [m], shape (N, 3)."""
        result = copy(self)
        result._foot_body, result._foot = [self._pelvis] * len(points), list(points)
        return result

    def pelvis_turned(self, poses: Poses) -> Vector:
        """The pelvis's orientation R_WB, shape (K, 3, 3)."""
        return np.asarray(poses.rotation[self._pelvis])

    def poses(self, q: Vector) -> Poses:
        """Where the bodies are for positions `q`, shape (K, nq)."""
        count = len(q)
        rotation = np.zeros((self._num_bodies, count, 3, 3))
        rotation[0] = np.eye(3)
        origin = np.zeros((self._num_bodies, count, 3))
        hinge = np.zeros((self._num_bodies, count, 3))
        axes: dict[int, list[Vector]] = {}
        for joint, free in zip(self._joints, self._freedoms, strict=True):
            parent, child = int(joint.parent_body().index()), int(joint.child_body().index())
            X_PF = joint.frame_on_parent().GetFixedPoseInBodyFrame()
            X_MB = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
            R_FM, p_FM = pose(joint, _own(joint, q))
            R_WF = rotation[parent] @ X_PF.rotation().matrix()
            R_WM = R_WF @ R_FM
            p_WM = origin[parent] + rotation[parent] @ X_PF.translation() + _times(R_WF, p_FM)
            axes[child] = [R_WF @ freedom.axis for freedom in free]
            rotation[child] = R_WM @ X_MB.rotation().matrix()
            origin[child] = p_WM + R_WM @ X_MB.translation()
            hinge[child] = p_WM
        return Poses(rotation, origin, hinge, axes)

    def is_planar(self) -> bool:
        """Whether every joint moves in, or turns across, the wall plane, so that nothing ever changes its height."""
        poses = self.poses(np.zeros((1, self._damping.size)))
        for joint, free in zip(self._joints, self._freedoms, strict=True):
            for freedom, axis in zip(free, poses.axes[int(joint.child_body().index())], strict=True):
                if abs(axis[0, 2]) > 1e-6 if freedom.slides else abs(axis[0, 2]) < 1 - 1e-9:
                    return False
        return True

    def rates(self, q: Vector, v: Vector, vd: Vector) -> tuple[Vector, Vector]:
        """First and second time derivatives of the positions, shape (K, nq) each.

        Args:
            q: Positions, shape (K, nq).
            v: Velocities, shape (K, nv).
            vd: Accelerations, shape (K, nv).
        """
        first, second = np.zeros(q.shape), np.zeros(q.shape)
        for joint in self._joints:
            at = slice(joint.position_start(), joint.position_start() + joint.num_positions())
            first[:, at], second[:, at] = rates(joint, q[:, at], _own_rates(joint, v), _own_rates(joint, vd))
        return first, second

    def feet(self, poses: Poses) -> Vector:
        """Where the feet are in W [m], shape (K, num_limbs, 3)."""
        at = [poses.origin[b] + poses.rotation[b] @ foot for b, foot in zip(self._foot_body, self._foot, strict=True)]
        return np.stack(at, axis=1)

    def required_of_feet(self, poses: Poses, numbers: Sequence[int]) -> Vector:
        """What a force of 1 N on some of the feet, along each of W's axes, adds to the required force.

        Returns:
            Generalised forces [N, N m], shape (K, len(numbers), nv, 3).
        """
        carrier = {int(joint.child_body().index()): place for place, joint in enumerate(self._joints)}
        result = np.zeros((poses.origin.shape[1], len(numbers), self._damping.size, 3))
        for i, number in enumerate(numbers):
            body = self._foot_body[number]
            foot = poses.origin[body] + poses.rotation[body] @ self._foot[number]
            while body in carrier:
                joint, free = self._joints[carrier[body]], self._freedoms[carrier[body]]
                for place, (freedom, axis) in enumerate(
                    zip(free, poses.axes[body], strict=True), joint.velocity_start()
                ):
                    result[:, i, place] = -axis if freedom.slides else -_cross(axis, foot - poses.hinge[body])
                body = int(joint.parent_body().index())
        return result

    def pelvis(self, poses: Poses) -> Vector:
        """Where the pelvis's origin is in W [m], shape (K, 3)."""
        return np.asarray(poses.origin[self._pelvis])

    def center_of_mass(self, poses: Poses) -> Vector:
        """The robot's centre of mass in W [m], shape (K, 3)."""
        centers = poses.origin + np.einsum("bkij,bj->bki", poses.rotation, self._center)
        return np.asarray(np.einsum("b,bki->ki", self._mass, centers) / self._mass.sum())

    def required_force(
        self, poses: Poses, v: Vector, vd: Vector, force: Vector, moment: Vector | None = None
    ) -> Vector:
        """The generalised force that the actuators must supply: M vd + h - J_c^T f, by Newton and Euler.

        Args:
            poses: The configurations.
            v: Velocities, shape (K, nv).
            vd: Accelerations, shape (K, nv).
            force: Force of each hold on each foot in W [N], shape (K, num_limbs, 3).
            moment: Moment of each hold on each foot about W's z axis [N m], shape (K, num_limbs); none by default.

        Returns:
            Generalised forces [N, N m], shape (K, nv).
        """
        shape = poses.origin.shape
        w, wd, a = np.zeros(shape), np.zeros(shape), np.zeros(shape)  # of the bodies' frames, at their origins
        push, turn = np.zeros(shape), np.zeros(shape)  # wrench on each body, about W's origin
        for joint, free in zip(self._joints, self._freedoms, strict=True):
            parent, child = int(joint.parent_body().index()), int(joint.child_body().index())
            out = poses.hinge[child] - poses.origin[parent]
            a_hinge = a[parent] + _cross(wd[parent], out) + _cross(w[parent], _cross(w[parent], out))
            w[child], wd[child] = w[parent], wd[parent]
            for place, (freedom, axis) in enumerate(zip(free, poses.axes[child], strict=True), joint.velocity_start()):
                if freedom.slides:  # on the world, so nothing carries it along
                    a_hinge = a_hinge + axis * vd[:, place, None]
                else:
                    own = axis * v[:, place, None]
                    w[child] += own
                    wd[child] += axis * vd[:, place, None] + _cross(w[parent], own)
            back = poses.origin[child] - poses.hinge[child]
            a[child] = a_hinge + _cross(wd[child], back) + _cross(w[child], _cross(w[child], back))
            arm = poses.rotation[child] @ self._center[child]
            a_center = a[child] + _cross(wd[child], arm) + _cross(w[child], _cross(w[child], arm))
            inertia = poses.rotation[child] @ self._inertia[child] @ np.swapaxes(poses.rotation[child], 1, 2)
            momentum = _times(inertia, w[child])
            push[child] = self._mass[child] * (a_center - self._gravity)
            turn[child] = _times(inertia, wd[child]) + _cross(w[child], momentum)
            turn[child] += _cross(poses.origin[child] + arm, push[child])
        feet = self.feet(poses)
        for i, body in enumerate(self._foot_body):
            push[body] -= force[:, i]
            turn[body] -= _cross(feet[:, i], force[:, i])
            if moment is not None:
                turn[body, :, 2] -= moment[:, i]
        result = self._damping * v + self._armature * vd
        for joint, free in zip(reversed(self._joints), reversed(self._freedoms), strict=True):
            parent, child = int(joint.parent_body().index()), int(joint.child_body().index())
            about_hinge = turn[child] - _cross(poses.hinge[child], push[child])
            for place, (freedom, axis) in enumerate(zip(free, poses.axes[child], strict=True), joint.velocity_start()):
                felt = push[child] if freedom.slides else about_hinge
                result[:, place] += np.einsum("ki,ki->k", axis, felt)
            push[parent] += push[child]
            turn[parent] += turn[child]
        return result


class DrakeModel:
    """The same quantities from Drake's plant, one instant at a time."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._context = robot.plant.CreateDefaultContext()
        self._forces = MultibodyForces(robot.plant)
        self._bodies = [robot.plant.GetFrameByName(limb.foot).body() for limb in robot.limbs]

    def at(
        self, q: Vector, v: Vector, vd: Vector, force: Vector, moment: Vector | None = None
    ) -> tuple[Vector, Vector, Vector, Vector]:
        """What `Tree` computes, for one instant.

        Args:
            q: Positions, shape (nq,).
            v: Velocities, shape (nv,).
            vd: Accelerations, shape (nv,).
            force: Force of each hold on each foot in W [N], shape (num_limbs, 3).
            moment: Moment of each hold on each foot about W's z axis [N m], shape (num_limbs,); none by default.

        Returns:
            Feet (num_limbs, 3) and centre of mass (3,) in W [m], the required generalised force (nv,) [N, N m], and
            the rates of the positions (nq,).
        """
        plant, context = self._robot.plant, self._context
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        self._forces.SetZero()
        plant.CalcForceElementsContribution(context, self._forces)
        feet = self._robot.foot_positions(context)
        turns = np.zeros((len(force), 3))
        turns[:, 2] = 0.0 if moment is None else moment
        for body, foot, f, n in zip(self._bodies, feet, force, turns, strict=True):
            p_BoFoot_W = foot - body.EvalPoseInWorld(context).translation()
            body.AddInForce(context, p_BoFoot_W, SpatialForce(n, f), plant.world_frame(), self._forces)
        required = plant.CalcInverseDynamics(context, vd, self._forces)
        return feet, self._robot.center_of_mass(context), required, plant.MapVelocityToQDot(context, v)


def _in_order(plant: MultibodyPlant) -> Sequence[Joint]:
    """The joints such that each comes after the one that carries its parent body."""
    waiting = [plant.get_joint(index) for index in plant.GetJointIndices()]
    reached = {plant.world_body().index()}
    ordered: list[Joint] = []
    while waiting:
        ready = [joint for joint in waiting if joint.parent_body().index() in reached]
        ordered += ready
        reached |= {joint.child_body().index() for joint in ready}
        waiting = [joint for joint in waiting if joint not in ready]
    return ordered


def _own(joint: Joint, q: Vector) -> Vector:
    """A joint's own columns of positions (K, nq)."""
    return q[:, joint.position_start() : joint.position_start() + joint.num_positions()]


def _own_rates(joint: Joint, v: Vector) -> Vector:
    """A joint's own columns of velocities or accelerations (K, nv)."""
    return v[:, joint.velocity_start() : joint.velocity_start() + joint.num_velocities()]


def _spread(p: Vector) -> Vector:
    """Inertia about the origin of 1 kg at p [m^2], shape (3, 3)."""
    return np.asarray(p @ p * np.eye(3) - np.outer(p, p))


def _cross(a: Vector, b: Vector) -> Vector:
    """Cross products of rows; several times faster than `np.cross`, shape (K, 3)."""
    x = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    y = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    z = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.stack([x, y, z], axis=1)


def _times(matrices: Vector, vectors: Vector) -> Vector:
    """Each matrix (K, 3, 3) times its vector (K, 3)."""
    return np.asarray(np.einsum("kij,kj->ki", matrices, vectors))
