"""The robot: a Drake plant in the wall frame, and what the planner asks of it.

Everything is read from the model (URDF or SDF) and from a small YAML file of the same stem beside it, which names the
pelvis, the limbs with their feet in counter-clockwise order, and the robot's symmetries. The plant's world frame is
the wall frame W, so an inclined wall only changes the plant's gravity vector.

The pelvis moves in W's x-y plane, by a planar joint in the model, or floats in space, for want of any joint (see
`climber.floating`). What differs between the two is asked of `Robot`, so that nothing else needs to know.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, Joint, PlanarJoint
from pydrake.systems.framework import Context

from climber.exceptions import ModelError
from climber.floating import (
    ANGLES,
    ORIGIN,
    angle_rates,
    angular_velocity,
    angular_velocity_map,
    angular_velocity_map_rate,
    floats,
)
from climber.limb import Limb, limb_of
from climber.model import Model as Model  # robots and models go together
from climber.stance import Vector
from climber.symmetry import symmetry_group
from climber.wall import GRAVITY

Indices = NDArray[np.int64]
WEAK = 2.0  # times what a motor gives is far more than it gives


class Robot:
    """A model in a plant of its own, finalised, with gravity as the wall's inclination has it.

    Attributes:
        model: Where it came from.
        plant: The plant; its world frame is the wall frame W.
        pelvis: The pelvis's body.
        limbs: The limbs in limb order.
        mass: Total mass [kg].
        gravity: Gravity in W [m/s^2], shape (3,).
        planar: Whether the pelvis moves in W's x-y plane only.
        dimension: 2 for a planar robot, 3 for one in space.
        base_q: Places of the pelvis's own positions in the plant's.
        base_v: Places of its velocities.
        origin_q: Places of the positions that are the pelvis's origin in W: x, y and, in space, z; shape (dimension,).
        angle_q: Places of the positions that are the pelvis's angles, a whole turn of which changes nothing.
        symmetries: Limb permutations, the identity first: limb `i` takes the place of limb `permutation[i]`.
        position_names: Name of each position, in the plant's order.
        velocity_names: Name of each velocity, in the plant's order.
    """

    def __init__(self, model: Model | str | Path, gravity: Sequence[float] | Vector = (0.0, -GRAVITY, 0.0)) -> None:
        self.model = model if isinstance(model, Model) else Model.load(model)
        self.gravity: Vector = np.asarray(gravity, dtype=float)
        self.plant = MultibodyPlant(0.0)
        instance = self.model.add_to(self.plant)
        self.plant.mutable_gravity_field().set_gravity_vector(self.gravity)
        try:
            self.plant.Finalize()
        except RuntimeError as error:
            raise ModelError(f"{self.model.path}: Drake cannot use this model: {error}") from error
        self.name = self.plant.GetModelInstanceName(instance)
        bodies = [self.plant.get_body(index).name() for index in self.plant.GetBodyIndices(instance)]
        if self.model.pelvis not in bodies:
            raise self.model.unknown("pelvis", self.model.pelvis, "body", bodies)
        self.pelvis = self.plant.GetBodyByName(self.model.pelvis, instance)
        self._parents = {joint.child_body().index(): joint for joint in self._joints()}
        base = self._parents[self.pelvis.index()]
        self.planar = isinstance(base, PlanarJoint)
        if self.planar:
            self._check_planar(base)
        self.base_q = np.arange(base.position_start(), base.position_start() + base.num_positions())
        self.base_v = np.arange(base.velocity_start(), base.velocity_start() + base.num_velocities())
        self.floating = floats(base)
        self.dimension = 2 if self.planar else 3
        angles, origin = (ANGLES, ORIGIN) if self.floating else ((2,), (0, 1))
        self.angle_q, self.origin_q = (
            self.base_q[[place for place in places if place < len(self.base_q)]] for places in (angles, origin)
        )
        self.mass = float(self.plant.CalcTotalMass(self.plant.CreateDefaultContext()))
        self.position_names = tuple(self.plant.GetPositionNames(instance, False, False))
        self.velocity_names = tuple(self.plant.GetVelocityNames(instance, False, False))
        self.limbs = tuple(
            self._limb(number, name, foot) for number, (name, foot) in enumerate(self.model.feet.items())
        )
        self._check_apart()
        self._check_order()
        self.symmetries = symmetry_group(self)

    def _joints(self) -> list[Joint]:
        return [self.plant.get_joint(index) for index in self.plant.GetJointIndices()]

    def _check_planar(self, base: PlanarJoint) -> None:
        """Refuses a planar joint whose positions are not the pelvis's own x, y and angle in W."""
        poses = [base.frame_on_child().GetFixedPoseInBodyFrame()]
        # An SDF file cannot name the world as the parent of a planar joint, but a body that is welded to it.
        ground = {body.index() for body in self.plant.GetBodiesWeldedTo(self.plant.world_body())}
        if base.parent_body().index() in ground:
            poses.append(base.frame_on_parent().CalcPoseInWorld(self.plant.CreateDefaultContext()))
        if len(poses) < 2 or not all(pose.IsNearlyIdentity(1e-12) for pose in poses):
            raise ModelError(
                f"{self.model.path}: the planar joint {base.name()!r} must join the frame of the pelvis to that of the "
                f"world, with no offset, and about z (URDF's default axis is x)"
            )

    def _check_apart(self) -> None:
        """Refuses limbs that share a joint."""
        owner: dict[str, str] = {}
        for number, limb in enumerate(self.limbs):
            for joint in limb.joints:
                if joint in owner:
                    allowed = f"a foot behind joints of its own; limb {owner[joint]} has {joint} too"
                    raise self.model.error(f"limbs[{number}].foot", limb.foot, allowed)
                owner[joint] = limb.name

    def _check_order(self) -> None:
        """Refuses limbs that are not listed counter-clockwise; which legs cross is told by that order."""
        hips = np.array([limb.hip[:2] for limb in self.limbs])
        if np.linalg.norm(hips, axis=1).min() < 1e-6:
            return  # a limb in the middle has no place in the order
        angles = np.arctan2(hips[:, 1], hips[:, 0])
        if np.mod(np.roll(angles, -1) - angles, 2 * np.pi).sum() > 2 * np.pi + 1e-6:
            order = np.argsort(np.mod(angles - angles[0], 2 * np.pi), kind="stable")
            allowed = f"counter-clockwise around the pelvis: {', '.join(self.limb_names[i] for i in order)}"
            raise self.model.error("limbs", list(self.limb_names), allowed)

    def chain(self, foot: str) -> list[Joint]:
        """The joints, fixed ones too, from the pelvis out to the body that carries the frame `foot`."""
        joints: list[Joint] = []
        body = self.plant.GetFrameByName(foot).body()
        while body.index() != self.pelvis.index():
            joint = self._parents.get(body.index())
            if joint is None:
                field = f"limbs[{list(self.model.feet.values()).index(foot)}].foot"
                raise self.model.error(field, foot, f"a frame that hangs from the pelvis {self.model.pelvis}")
            joints.append(joint)
            body = joint.parent_body()
        return joints[::-1]

    def _limb(self, number: int, name: str, foot: str) -> Limb:
        if not self.plant.HasFrameNamed(foot):
            frames = [
                self.plant.get_frame(index).name() for index in self.plant.GetFrameIndices(self.pelvis.model_instance())
            ]
            raise self.model.unknown(f"limbs[{number}].foot", foot, "frame", frames)
        return limb_of(name, self.plant.GetFrameByName(foot), self.pelvis, self.chain(foot), self.model.path)

    @property
    def limb_names(self) -> tuple[str, ...]:
        """The limbs' names in limb order."""
        return tuple(limb.name for limb in self.limbs)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """All actuated limb joints, limb by limb."""
        return tuple(joint for limb in self.limbs for joint in limb.joints)

    @property
    def reach(self) -> Vector:
        """Each limb's reach from the pelvis's origin [m], shape (num_limbs,)."""
        return np.array([limb.reach for limb in self.limbs])

    @cached_property
    def joint_v(self) -> Indices:
        """Places of `joint_names` in the plant's velocities, shape (num_joints,)."""
        return np.concatenate([limb.v for limb in self.limbs])

    @cached_property
    def effort(self) -> Vector:
        """Effort limits of `joint_names` [N m], shape (num_joints,)."""
        return np.concatenate([limb.effort for limb in self.limbs])

    @property
    def weight(self) -> float:
        """What its contacts carry where it stands still [N]."""
        return self.mass * float(np.linalg.norm(self.gravity))

    @cached_property
    def weak(self) -> bool:
        """Whether motors cannot hold just any posture: if a limb stretched out would take far more than they give."""
        driven = self.effort[self.effort > 0.0]
        return bool(self.weight * self.reach.max() > WEAK * driven.min(initial=np.inf))

    @cached_property
    def joint_limits(self) -> dict[str, tuple[float, float]]:
        """Lower and upper position limit of each limb joint by name [rad]."""
        return {
            joint: (float(low), float(high))
            for limb in self.limbs
            for joint, low, high in zip(limb.joints, limb.lower, limb.upper, strict=True)
        }

    def v_of(self, q: Vector, qdot: Vector) -> Vector:
        """Velocities v for rates of the positions, shape (..., nq) to (..., nv); the same for a planar robot."""
        v = qdot.copy()
        if self.floating:
            v[..., self.base_v[:3]] = angular_velocity(q[..., self.angle_q], qdot[..., self.angle_q])
        return v

    def vd_of(self, q: Vector, qdot: Vector, qddot: Vector) -> Vector:
        """Accelerations dv/dt = E qddot + dE/dt qdot, shape (..., nq) to (..., nv)."""
        vd = self.v_of(q, qddot)
        if self.floating:
            angles, rates = (x[..., self.angle_q] for x in (q, qdot))
            dE = angular_velocity_map_rate(angles.reshape(-1, 3), rates.reshape(-1, 3)).reshape(*q.shape[:-1], 3, 3)
            vd[..., self.base_v[:3]] += np.einsum("...ij,...j->...i", dE, rates)
        return vd

    def qdot(self, q: Vector, v: Vector) -> Vector:
        """Rates of the positions for velocities v, shape (..., nv) to (..., nq); the same for a planar robot."""
        result = v.copy()
        if self.floating:
            w = v[..., self.base_v[:3]].reshape(-1, 3)
            rates = angle_rates(q[..., self.angle_q].reshape(-1, 3), w)
            result[..., self.angle_q] = rates.reshape(*v.shape[:-1], 3)
        return result

    def rates(self, q: Vector, v: Vector, vd: Vector) -> tuple[Vector, Vector]:
        """First and second derivatives of the positions by time for velocities and accelerations, shapes (..., nq)."""
        qdot = self.qdot(q, v)
        return qdot, self.qdot(q, vd - self.vd_of(q, qdot, np.zeros_like(qdot)))

    def by_positions(self, q: Vector, J: Vector) -> Vector:
        """Jacobians by the rates of the positions, J E(q), from those by velocities.

        Args:
            q: Configurations, shape (K, nq).
            J: Jacobians, shape (K, ..., nv).

        Returns:
            Shape (K, ..., nq).
        """
        if not self.floating:
            return J
        result = J.copy()
        E = angular_velocity_map(q[:, self.angle_q])
        result[..., self.angle_q] = np.einsum("k...i,kij->k...j", J[..., self.base_v[:3]], E)
        return result

    def unwound(self, q: Vector, reference: Vector) -> Vector:
        """`q` with each angle of the pelvis taken within half a turn of the reference's, shapes (..., nq)."""
        result = np.array(np.broadcast_to(q, np.broadcast_shapes(q.shape, reference.shape)))
        angle = self.angle_q
        result[..., angle] -= 2 * np.pi * np.round((q[..., angle] - reference[..., angle]) / (2 * np.pi))
        return result

    @cached_property
    def turning(self) -> Vector:
        """How fast each limb's foot turns about z by the velocities of a planar robot, shape (num_limbs, nv)."""
        plant, context = self.plant, self.workspace
        world, kind = plant.world_frame(), JacobianWrtVariable.kV
        plant.SetPositions(context, np.zeros(plant.num_positions()))
        feet = [plant.GetFrameByName(limb.foot) for limb in self.limbs]
        return np.array([plant.CalcJacobianAngularVelocity(context, kind, foot, world, world)[2] for foot in feet])

    @cached_property
    def workspace(self) -> Context:
        """A context for who sets the state before asking for anything and keeps nothing in it."""
        return self.context()

    def context(self) -> Context:
        """A fresh context of the plant."""
        return self.plant.CreateDefaultContext()

    def foot_positions(self, context: Context) -> Vector:
        """Where the feet are in W [m], shape (num_limbs, 3)."""
        frames = [self.plant.GetFrameByName(limb.foot) for limb in self.limbs]
        return np.array([frame.CalcPoseInWorld(context).translation() for frame in frames])

    def center_of_mass(self, context: Context) -> Vector:
        """The robot's centre of mass in W [m], shape (3,)."""
        return np.asarray(self.plant.CalcCenterOfMassPositionInWorld(context))
