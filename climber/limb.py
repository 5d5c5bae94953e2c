"""A limb as the model has it: its joints from the pelvis outwards, their limits, and the foot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import Frame, Joint, RevoluteJoint, RigidBody

from climber.exceptions import ModelError
from climber.stance import Vector


@dataclass(frozen=True)
class Limb:
    """A serial chain of revolute joints from the pelvis to a point foot; of none, if the foot is fixed to the pelvis.

    Attributes:
        name: The limb's name, as scenarios use it.
        foot: Name of the foot's frame in the model; the foot is its origin.
        joints: Names of the joints from the pelvis outwards.
        q: Places of the joints in the plant's positions, shape (num_joints,).
        v: Places of the joints in the plant's velocities, shape (num_joints,).
        lower: Lower position limits [rad], shape (num_joints,).
        upper: Upper position limits [rad], shape (num_joints,).
        velocity: Velocity limits, the same in both directions [rad/s], shape (num_joints,).
        acceleration: Acceleration limits, likewise [rad/s^2], infinite where there are none, shape (num_joints,).
        effort: Effort limits [N m], zero for joints without a motor, shape (num_joints,).
        hip: Where the first joint, or the foot of a limb without joints, is in the pelvis's frame [m], shape (3,).
        reach: Farthest that the foot can be from the pelvis's origin [m].
    """

    name: str
    foot: str
    joints: tuple[str, ...]
    q: NDArray[np.int64]
    v: NDArray[np.int64]
    lower: Vector
    upper: Vector
    velocity: Vector
    acceleration: Vector
    effort: Vector
    hip: Vector
    reach: float

    @property
    def one_turn(self) -> tuple[Vector, Vector]:
        """Position limits [rad], cut to one turn about their middle where they leave more; about zero for a free joint.

        Planning keeps joints within these, so that every attitude of a link is one angle.
        """
        lower, upper = self.lower.copy(), self.upper.copy()
        for i, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if np.isfinite(low) and np.isfinite(high):
                middle = (low + high) / 2
            else:
                middle = low + np.pi if np.isfinite(low) else high - np.pi if np.isfinite(high) else 0.0
            lower[i], upper[i] = max(low, middle - np.pi), min(high, middle + np.pi)
        return lower, upper


def limb_of(name: str, foot: Frame, pelvis: RigidBody, chain: Sequence[Joint], file: Path) -> Limb:
    """Reads a limb from its plant.

    Args:
        name: What it is to be called.
        foot: The foot's frame.
        pelvis: The pelvis.
        chain: The joints, fixed ones too, from the pelvis out to the foot's body.
        file: Where the model is from, for messages.

    Raises:
        ModelError: If there are other joints than revolute ones, or one that may not move both ways.
    """
    joints = [joint for joint in chain if joint.num_positions()]
    for joint in joints:
        if not isinstance(joint, RevoluteJoint):
            raise ModelError(f"{file}: joint {joint.name()!r} is {joint.type_name()}; limbs revolve only")
        if not min(joint.velocity_upper_limits()[0], -joint.velocity_lower_limits()[0]) > 0:
            raise ModelError(f"{file}: joint {joint.name()!r} must be allowed to move both ways")
    # The pieces between successive joint axes; no chain reaches farther than their lengths together.
    frames = [joint.frame_on_child() for joint in joints] + [foot]
    plant = pelvis.GetParentPlant()
    context = plant.CreateDefaultContext()
    points = [pelvis.EvalPoseInWorld(context).translation()]
    points += [frame.CalcPoseInWorld(context).translation() for frame in frames]
    actuators = {
        plant.get_joint_actuator(index).joint().name(): plant.get_joint_actuator(index).effort_limit()
        for index in plant.GetJointActuatorIndices()
    }
    return Limb(
        name=name,
        foot=foot.name(),
        joints=tuple(joint.name() for joint in joints),
        q=np.array([joint.position_start() for joint in joints], dtype=np.int64),
        v=np.array([joint.velocity_start() for joint in joints], dtype=np.int64),
        lower=np.array([joint.position_lower_limit() for joint in joints]),
        upper=np.array([joint.position_upper_limit() for joint in joints]),
        velocity=np.array([min(joint.velocity_upper_limit(), -joint.velocity_lower_limit()) for joint in joints]),
        acceleration=np.array(
            [min(joint.acceleration_upper_limits()[0], -joint.acceleration_lower_limits()[0]) for joint in joints]
        ),
        effort=np.array([actuators.get(joint.name(), 0.0) for joint in joints]),
        hip=pelvis.EvalPoseInWorld(context).inverse().multiply(points[1]),
        reach=float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()),
    )
