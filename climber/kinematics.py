"""Batched kinematics in numpy, extracted once from a robot's plant.

Drake evaluates one configuration at a time; sampling postures needs thousands. These functions take arrays whose first
axis runs over configurations and agree with the plant to rounding (the tests hold them to it).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import RevoluteJoint, RigidBody
from pydrake.systems.framework import Context

from climber import floating
from climber.exceptions import ModelError
from climber.robot import Indices, Robot
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

    @property
    def apart(self) -> list[Pose]:
        """The poses of several frames, which are along a second axis, frame by frame."""
        return [Pose(self.rotation[:, i], self.origin[:, i]) for i in range(self.origin.shape[1])]


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
        """Poses of the limb's links for joint angles `q` [rad], shape (K, num_joints).

        With fewer columns than joints, poses of the links nearest the pelvis.
        """
        poses = []
        pose = pelvis
        for step, angle in zip(self.steps, q.T, strict=False):
            pose = step.advance(pose, angle)
            poses.append(pose)
        return poses

    def foot_position(self, pelvis: Pose, links: list[Pose]) -> Vector:
        """The foot in W [m], shape (K, 3); without joints it is fixed to the pelvis."""
        return (links[-1] if links else pelvis).point(self.foot)

    def moment(self, links: list[Pose]) -> Vector:
        """Sum over the links of mass times centre of mass in W [kg m], shape (K, 3)."""
        total: Vector = np.zeros_like(links[0].origin) if links else np.zeros((1, 3))
        for pose, mass, center in zip(links, self.masses, self.centers, strict=True):
            total = total + mass * pose.point(center)
        return total


@dataclass(frozen=True)
class _Level:
    """Joints equally many steps from the pelvis, for all limbs that have so many.

    Attributes:
        q: Places of the joints in the plant's positions, shape (L,).
        parents: Places of the links that carry them, in `Kinematics.links`.
        links: Places of the links that they carry.
        c0: See `JointStep`, likewise the rest, shape (L, 3, 3).
        c1: Shape (L, 3, 3).
        c2: Shape (L, 3, 3).
        origin: Shape (L, 3, 1).
    """

    q: Indices
    parents: Indices
    links: Indices
    c0: Vector
    c1: Vector
    c2: Vector
    origin: Vector

    def advance(self, poses: Pose, q: Vector) -> None:
        """Sets the poses (K, N) of the links from those of their parents, for configurations `q`, shape (K, nq)."""
        rotation, origin = poses.rotation[:, self.parents], poses.origin[:, self.parents]
        angle = q[:, self.q, None, None]
        poses.rotation[:, self.links] = rotation @ (self.c0 + np.sin(angle) * self.c1 + np.cos(angle) * self.c2)
        poses.origin[:, self.links] = (rotation @ self.origin)[..., 0] + origin


class Kinematics:
    """Kinematics of one robot for many configurations at a time.

    Attributes:
        robot: The robot.
        chains: One chain per limb, in limb order.
        links: Names of the moving links: the pelvis, then each limb's links outwards.
        pelvis_mass: Mass of the pelvis and what is fixed to it [kg].
        pelvis_center: Their centre of mass in the pelvis's frame [m], shape (3,).
        joint_q: Places of the limbs' joints in the plant's positions, limb by limb, shape (num_joints,).
        lower: Lower limits of those joints [rad], see `Limb.one_turn`, shape (num_joints,).
        upper: Upper limits, likewise.

    Raises:
        ModelError: If the pelvis neither floats nor is planar, a planar robot's foot is not in its plane, or something
            moves that is not pelvis or limb.
    """

    def __init__(self, robot: Robot) -> None:
        if not (robot.planar or robot.floating):
            raise ModelError(
                f"{robot.model.path}: the pelvis must float, or hang from the world by a planar joint about z"
            )
        self.robot = robot
        plant = robot.plant
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, np.zeros(plant.num_positions()))
        joints = [[joint for joint in robot.chain(limb.foot) if joint.num_positions()] for limb in robot.limbs]
        if len(robot.base_q) + sum(map(len, joints)) != plant.num_positions():
            raise ModelError(f"{robot.model.path}: a joint belongs neither to the pelvis nor to a limb")
        self.chains = tuple(
            self._chain(limb.foot, along, context) for limb, along in zip(robot.limbs, joints, strict=True)
        )
        self.links = [robot.pelvis.name(), *(joint.child_body().name() for along in joints for joint in along)]
        self.pelvis_mass, self.pelvis_center = self._mass(robot.pelvis, context)
        moving = self.pelvis_mass + sum(chain.masses.sum() for chain in self.chains)
        if abs(moving - robot.mass) > 1e-9 * robot.mass:
            raise ModelError(
                f"{robot.model.path}: of {robot.mass:.6g} kg only {moving:.6g} kg move with pelvis and limbs"
            )
        heights = self.feet(np.zeros((1, plant.num_positions())))[0, :, 2]
        for limb, height in zip(robot.limbs, heights, strict=True):
            if robot.planar and abs(height) > 1e-6:
                raise ModelError(f"{robot.model.path}: {limb.foot!r} is {height:.3g} m off the plane that holds lie in")
        limits = [limb.one_turn for limb in robot.limbs]
        self.lower = np.concatenate([lower for lower, _ in limits])
        self.upper = np.concatenate([upper for _, upper in limits])
        self.joint_q = np.concatenate([limb.q for limb in robot.limbs])

    def _mass(self, link: RigidBody, context: Context) -> tuple[float, Vector]:
        """Mass [kg] and centre of mass in the link's frame [m] of a link with all that is fixed to it."""
        plant = self.robot.plant
        mass, moment = 0.0, np.zeros(3)
        for body in plant.GetBodiesWeldedTo(link):
            pose: RigidTransform = plant.CalcRelativeTransform(context, link.body_frame(), body.body_frame())
            inertia = body.CalcSpatialInertiaInBodyFrame(context)
            mass += inertia.get_mass()
            moment += inertia.get_mass() * pose.multiply(inertia.get_com())
        return mass, moment / mass if mass else moment

    def _chain(self, foot: str, joints: Sequence[RevoluteJoint], context: Context) -> LimbChain:
        """The chain of one limb, given the joints that move."""
        plant = self.robot.plant
        steps, masses = [], []
        parent = self.robot.pelvis
        for joint in joints:
            to_joint = plant.CalcRelativeTransform(context, parent.body_frame(), joint.frame_on_parent())
            to_child = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
            if np.abs(to_child.translation()).max() > 1e-12:
                raise ModelError(f"{self.robot.model.path}: joint {joint.name()!r} must lie at its child link's origin")
            axis = joint.revolute_axis()
            cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
            before, after = to_joint.rotation().matrix(), to_child.rotation().matrix()
            # Rodrigues: I + sin(q) [a]x + (1 - cos(q)) [a]x^2
            c0, c1, c2 = (before @ m @ after for m in (np.eye(3) + cross @ cross, cross, -cross @ cross))
            steps.append(JointStep(c0, c1, c2, to_joint.translation(), before @ axis))
            parent = joint.child_body()
            masses.append(self._mass(parent, context))
        end = plant.CalcRelativeTransform(context, parent.body_frame(), plant.GetFrameByName(foot)).translation()
        return LimbChain(tuple(steps), end, np.array([m for m, _ in masses]), np.array([c for _, c in masses]))

    def pelvis(self, base: Vector) -> Pose:
        """Poses of the pelvis for base positions in the plant's order [m, rad], shape (K, 3), or (K, 6) in space."""
        if self.robot.floating:
            return Pose(floating.rotation(base), base[:, list(floating.ORIGIN)])
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
        return self.link_poses(q).apart

    def link_poses(self, q: Vector) -> Pose:
        """Poses of every moving link, in the order of `links`, along a second axis: (K, N, 3, 3) and (K, N, 3)."""
        pelvis = self.pelvis(q[:, self.robot.base_q])
        shape = len(q), len(self.links)
        result = Pose(np.empty((*shape, 3, 3)), np.empty((*shape, 3)))
        result.rotation[:, 0], result.origin[:, 0] = pelvis.rotation, pelvis.origin
        # All limbs at a time: what a call costs counts for more than what it computes.
        for level in self._levels:
            level.advance(result, q)
        return result

    @cached_property
    def _levels(self) -> list[_Level]:
        """The limbs' joints, those next to the pelvis first."""
        first = 1 + np.cumsum([0, *(len(chain.steps) for chain in self.chains)])
        result = []
        for depth in range(max(len(chain.steps) for chain in self.chains)):
            limbs = [i for i, chain in enumerate(self.chains) if len(chain.steps) > depth]
            steps = [self.chains[i].steps[depth] for i in limbs]
            links = np.array([first[i] + depth for i in limbs])
            result.append(
                _Level(
                    q=np.array([self.robot.limbs[i].q[depth] for i in limbs]),
                    parents=links - 1 if depth else np.zeros_like(links),
                    links=links,
                    c0=np.stack([step.c0 for step in steps]),
                    c1=np.stack([step.c1 for step in steps]),
                    c2=np.stack([step.c2 for step in steps]),
                    origin=np.stack([step.origin for step in steps])[:, :, None],
                )
            )
        return result

    def feet(self, q: Vector) -> Vector:
        """The feet in W [m], shape (K, num_limbs, 3)."""
        pelvis = self.pelvis(q[:, self.robot.base_q])
        return np.stack(
            [
                chain.foot_position(pelvis, chain.links(pelvis, q[:, limb.q]))
                for limb, chain in zip(self.robot.limbs, self.chains, strict=True)
            ],
            axis=1,
        )

    @cached_property
    def _base_axes(self) -> tuple[list[tuple[Vector, int]], list[tuple[Vector, int]]]:
        """Axes in W that the base's velocities move the pelvis along, and those they turn it about, with their places.

        These are the velocities of Drake's joints: x, y and the angle, or angular and linear velocity in F.
        """
        places = self.robot.base_v.tolist()
        if self.robot.floating:
            axes = list(floating.R_WF.T)
            return list(zip(axes, places[3:], strict=True)), list(zip(axes, places[:3], strict=True))
        x, y, z = np.eye(3)
        return [(x, places[0]), (y, places[1])], [(z, places[2])]

    def foot_jacobians(self, q: Vector, limbs: Sequence[int]) -> Vector:
        """Jacobians of the feet of `limbs` in W by the plant's velocities, shape (K, len(limbs), dimension, nv).

        The rows are x and y and, in space, z: out of the plane a planar robot's feet do not move.
        """
        robot = self.robot
        pelvis = self.pelvis(q[:, robot.base_q])
        result = np.zeros((len(q), len(limbs), robot.dimension, robot.plant.num_velocities()))
        slides, turns = self._base_axes
        for row, i in enumerate(limbs):
            limb, chain = robot.limbs[i], self.chains[i]
            links = chain.links(pelvis, q[:, limb.q])
            foot = chain.foot_position(pelvis, links)
            for axis, column in slides:
                result[:, row, :, column] = axis[: robot.dimension]
            for pose, axis, column in [
                *((pelvis, axis, column) for axis, column in turns),
                *(
                    (link, parent.rotation @ step.axis, v)
                    for link, parent, step, v in zip(links, [pelvis, *links], chain.steps, limb.v, strict=False)
                ),
            ]:
                arm, axis = (foot - pose.origin).T, np.atleast_2d(axis).T
                result[:, row, 0, column] = axis[1] * arm[2] - axis[2] * arm[1]
                result[:, row, 1, column] = axis[2] * arm[0] - axis[0] * arm[2]
                if robot.floating:
                    result[:, row, 2, column] = axis[0] * arm[1] - axis[1] * arm[0]
        return result

    def center_of_mass(self, q: Vector, poses: Pose | None = None) -> Vector:
        """The robot's centre of mass in W [m], shape (K, 3), given its `link_poses` if they are known."""
        poses = self.link_poses(q) if poses is None else poses
        moments, masses = self._moments
        result: Vector = (poses.rotation @ moments)[..., 0].sum(axis=1) + masses @ poses.origin
        return result

    @cached_property
    def _moments(self) -> tuple[Vector, Vector]:
        """Shares of the links in the mass times their centres [m], shape (N, 3, 1), and the shares, shape (N,)."""
        masses = np.concatenate([[self.pelvis_mass], *(chain.masses for chain in self.chains)]) / self.robot.mass
        centers = np.concatenate([self.pelvis_center[None], *(chain.centers.reshape(-1, 3) for chain in self.chains)])
        return (masses[:, None] * centers)[:, :, None], masses

    def within_limits(self, q: Vector, margin: float = 0.0) -> Vector:
        """How far the joint nearest to a limit is from it [rad], less `margin`; negative outside. Shape (K,)."""
        joints = q[:, self.joint_q]
        result: Vector = np.minimum(joints - self.lower, self.upper - joints).min(axis=1) - margin
        return result
