"""Batched kinematics in numpy, extracted once from a robot's plant.

Drake evaluates one configuration at a time; sampling postures needs thousands. These functions take arrays whose first
axis runs over configurations and agree with the plant to rounding (the tests hold them to it).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import RevoluteJoint, RigidBody

from climber.exceptions import ModelError
from climber.robot import Robot
from climber.stance import Vector


@dataclass(frozen=True)
class Pose:
    """Poses of a frame in W for many configurations: rotations (K, 3, 3) and origins [m] (K, 3)."""

    rotation: Vector
    origin: Vector

    def point(self, p: Vector) -> Vector:
        """The point with coordinates `p` [m], shape (3,), of this frame, in W; shape (K, 3)."""
        result: Vector = self.rotation @ p + self.origin
        return result


@dataclass(frozen=True)
class JointStep:
    """From one link to the next through a revolute joint: R = R_parent (c0 + sin(q) c1 + cos(q) c2).

    Attributes:
        c0: Constant part of the rotation, shape (3, 3).
        c1: Part that goes with the sine, shape (3, 3).
        c2: Part that goes with the cosine, shape (3, 3).
        origin: The joint's origin in the parent link's frame [m], shape (3,).
        axis: The joint's axis in the parent link's frame, shape (3,).
    """

    c0: Vector
    c1: Vector
    c2: Vector
    origin: Vector
    axis: Vector

    def advance(self, parent: Pose, q: Vector) -> Pose:
        """Poses of the next link for joint angles `q` [rad], shape (K,)."""
        sin, cos = np.sin(q)[:, None, None], np.cos(q)[:, None, None]
        rotation = parent.rotation @ (self.c0 + sin * self.c1 + cos * self.c2)
        return Pose(rotation, parent.point(self.origin))


@dataclass(frozen=True)
class LimbChain:
    """One limb as steps from the pelvis to the foot.

    Attributes:
        steps: One per joint, from the pelvis outwards.
        foot: The foot in the last link's frame [m], shape (3,).
        masses: Mass of each link [kg], shape (num_joints,).
        centers: Centre of mass of each link in its frame [m], shape (num_joints, 3).
    """

    steps: tuple[JointStep, ...]
    foot: Vector
    masses: Vector
    centers: Vector

    def links(self, pelvis: Pose, q: Vector) -> list[Pose]:
        """Poses of the limb's links for joint angles `q` [rad], shape (K, num_joints)."""
        poses = []
        pose = pelvis
        for i, step in enumerate(self.steps):
            pose = step.advance(pose, q[:, i])
            poses.append(pose)
        return poses

    def foot_position(self, links: list[Pose]) -> Vector:
        """The foot in W [m], shape (K, 3)."""
        return links[-1].point(self.foot)

    def moment(self, links: list[Pose]) -> Vector:
        """Sum over the links of mass times centre of mass in W [kg m], shape (K, 3)."""
        total: Vector = np.zeros_like(links[0].origin)
        for pose, mass, center in zip(links, self.masses, self.centers, strict=True):
            total = total + mass * pose.point(center)
        return total


class Kinematics:
    """Kinematics of one robot for many configurations at a time.

    Attributes:
        robot: The robot.
        chains: One chain per limb, in limb order.
        links: Names of the moving links: the pelvis, then each limb's links outwards.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        plant = robot.plant
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, np.zeros(plant.num_positions()))
        chains = []
        self.links: list[str] = [robot.pelvis.name()]
        # A body fixed to a link moves with it and adds to its mass.
        links: list[RigidBody] = [robot.pelvis]
        joints_of_limbs: list[list[RevoluteJoint]] = []
        for limb in robot.limbs:
            joints = [joint for joint in robot.chain(limb.foot) if joint.num_positions()]
            joints_of_limbs.append(joints)
            links += [joint.child_body() for joint in joints]
            self.links += [joint.child_body().name() for joint in joints]
        if len(robot.base_q) + sum(len(joints) for joints in joints_of_limbs) != plant.num_positions():
            raise ModelError(f"{robot.model.path}: a joint belongs neither to the pelvis nor to a limb")
        masses: dict[int, float] = {}
        moments: dict[int, Vector] = {}
        for link in links:
            mass, moment = 0.0, np.zeros(3)
            for body in plant.GetBodiesWeldedTo(link):
                spatial = body.CalcSpatialInertiaInBodyFrame(context)
                pose: RigidTransform = plant.CalcRelativeTransform(context, link.body_frame(), body.body_frame())
                mass += spatial.get_mass()
                moment += spatial.get_mass() * pose.multiply(spatial.get_com())
            masses[int(link.index())], moments[int(link.index())] = mass, moment
        for limb, joints in zip(robot.limbs, joints_of_limbs, strict=True):
            steps = []
            parent = robot.pelvis
            for joint in joints:
                child = joint.child_body()
                to_joint = plant.CalcRelativeTransform(context, parent.body_frame(), joint.frame_on_parent())
                to_child = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
                axis = joint.revolute_axis()
                cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
                before, after = to_joint.rotation().matrix(), to_child.rotation().matrix()
                if np.abs(to_child.translation()).max() > 1e-12:
                    raise ModelError(f"{robot.model.path}: joint {joint.name()!r} must lie at its child link's origin")
                steps.append(
                    JointStep(
                        before @ (np.eye(3) + cross @ cross) @ after,
                        before @ cross @ after,
                        -before @ cross @ cross @ after,
                        to_joint.translation(),
                        before @ axis,
                    )
                )
                parent = child
            foot_frame = plant.GetFrameByName(limb.foot)
            foot = plant.CalcRelativeTransform(context, parent.body_frame(), foot_frame).translation()
            indices = [int(joint.child_body().index()) for joint in joints]
            chains.append(
                LimbChain(
                    tuple(steps),
                    foot,
                    np.array([masses[i] for i in indices]),
                    np.array([moments[i] / masses[i] if masses[i] else np.zeros(3) for i in indices]),
                )
            )
        self.chains = tuple(chains)
        pelvis = int(robot.pelvis.index())
        self.pelvis_mass = masses[pelvis]
        self.pelvis_center: Vector = moments[pelvis] / masses[pelvis] if masses[pelvis] else np.zeros(3)
        self.lower = np.concatenate([limb.lower for limb in robot.limbs])
        self.upper = np.concatenate([limb.upper for limb in robot.limbs])
        self.joint_q = np.concatenate([limb.q for limb in robot.limbs])

    def pelvis(self, base: Vector) -> Pose:
        """Poses of the pelvis for base positions (x, y, angle) [m, rad], shape (K, 3)."""
        sin, cos = np.sin(base[:, 2]), np.cos(base[:, 2])
        rotation = np.zeros((len(base), 3, 3))
        rotation[:, 0, 0] = rotation[:, 1, 1] = cos
        rotation[:, 1, 0], rotation[:, 0, 1] = sin, -sin
        rotation[:, 2, 2] = 1.0
        origin = np.zeros((len(base), 3))
        origin[:, :2] = base[:, :2]
        return Pose(rotation, origin)

    def poses(self, q: Vector) -> list[Pose]:
        """Poses of every moving link, in the order of `links`, for configurations `q`, shape (K, nq)."""
        pelvis = self.pelvis(q[:, self.robot.base_q])
        poses = [pelvis]
        for limb, chain in zip(self.robot.limbs, self.chains, strict=True):
            poses += chain.links(pelvis, q[:, limb.q])
        return poses

    def feet(self, q: Vector) -> Vector:
        """The feet in W [m], shape (K, num_limbs, 3)."""
        pelvis = self.pelvis(q[:, self.robot.base_q])
        return np.stack(
            [
                chain.foot_position(chain.links(pelvis, q[:, limb.q]))
                for limb, chain in zip(self.robot.limbs, self.chains, strict=True)
            ],
            axis=1,
        )

    def foot_jacobians(self, q: Vector, limbs: Sequence[int]) -> Vector:
        """Jacobians of the feet of `limbs` in W by the plant's velocities, shape (K, len(limbs), 2, nv).

        The rows are x and y: out of the plane a planar robot's feet do not move.
        """
        robot = self.robot
        pelvis = self.pelvis(q[:, robot.base_q])
        result = np.zeros((len(q), len(limbs), 2, robot.plant.num_velocities()))
        for row, i in enumerate(limbs):
            limb, chain = robot.limbs[i], self.chains[i]
            links = chain.links(pelvis, q[:, limb.q])
            foot = chain.foot_position(links)
            result[:, row, 0, robot.base_v[0]] = result[:, row, 1, robot.base_v[1]] = 1.0
            for pose, axis, column in [
                (pelvis, np.array([0.0, 0.0, 1.0]), robot.base_v[2]),
                *((link, parent.rotation @ step.axis, v) for link, parent, step, v in
                  zip(links, [pelvis, *links], chain.steps, limb.v, strict=False)),
            ]:
                result[:, row, :, column] = np.cross(np.broadcast_to(axis, foot.shape), foot - pose.origin)[:, :2]
        return result

    def center_of_mass(self, q: Vector, poses: list[Pose] | None = None) -> Vector:
        """The robot's centre of mass in W [m], shape (K, 3)."""
        poses = self.poses(q) if poses is None else poses
        total = self.pelvis_mass * poses[0].point(self.pelvis_center)
        place = 1
        for chain in self.chains:
            total = total + chain.moment(poses[place : place + len(chain.steps)])
            place += len(chain.steps)
        result: Vector = total / self.robot.mass
        return result

    def within_limits(self, q: Vector, margin: float = 0.0) -> Vector:
        """How far the joint nearest to a limit is from it [rad], less `margin`; negative outside. Shape (K,)."""
        joints = q[:, self.joint_q]
        result: Vector = np.minimum(joints - self.lower, self.upper - joints).min(axis=1) - margin
        return result
