"""The base of a robot in space: roll, pitch and yaw between frames that are turned so as to be far from singular.

Drake's `RpyFloatingJoint` between F, fixed in the world, and M, fixed in the pelvis, has positions
(rx, ry, rz, x, y, z) with R_FM = Rz(rz) Ry(ry) Rx(rx), and velocities (w_FM, v_FM), both in F. It is singular where ry
is a right angle. With

    x_F = z_W,  y_F = x_W,  z_F = y_W,   and M likewise in the pelvis's frame P,

rx is the spin in the wall's plane, ry the pitch about W's x and rz the yaw about W's y, and the joint is singular only
where the pelvis looks straight up or down along the wall: spin and going round corners are free. At zero P is W.

Rates of the angles and the angular velocity differ, so that qdot is not v:  w_FM = E(q) (rx', ry', rz').
"""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, Joint, RigidBody, RpyFloatingJoint

from climber.stance import Vector

R_WF: Vector = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
ANGLES = (0, 1, 2)  # places of the angles among the base's positions
ORIGIN = (4, 5, 3)  # places of the pelvis's origin x, y, z in W


def add_floating_joint(plant: MultibodyPlant, pelvis: RigidBody) -> None:
    """Lets a pelvis that no joint carries float, in a plant that is not yet finalised."""
    X = RigidTransform(RotationMatrix(R_WF))
    name, instance = pelvis.name(), pelvis.model_instance()
    F = plant.AddFrame(FixedOffsetFrame(f"{name}_floats_in", plant.world_frame(), X, instance))
    M = plant.AddFrame(FixedOffsetFrame(f"{name}_floating", pelvis.body_frame(), X, instance))
    plant.AddJoint(RpyFloatingJoint(f"{name}_base", F, M))


def floats(base: Joint) -> bool:
    """Whether a joint is one that `add_floating_joint` would add."""
    if not isinstance(base, RpyFloatingJoint) or base.frame_on_parent().body().index() != 0:
        return False
    X = RigidTransform(RotationMatrix(R_WF))
    frames = base.frame_on_parent(), base.frame_on_child()
    return all(frame.GetFixedPoseInBodyFrame().IsNearlyEqualTo(X, 1e-12) for frame in frames)


def rotation(base: Vector) -> Vector:
    """R_WP of the pelvis for base positions, shape (K, 6); shape (K, 3, 3)."""
    (s0, s1, s2), (c0, c1, c2) = np.sin(base[:, :3].T), np.cos(base[:, :3].T)
    R_FM = np.empty((len(base), 3, 3))
    R_FM[:, 0] = np.stack([c2 * c1, c2 * s1 * s0 - s2 * c0, c2 * s1 * c0 + s2 * s0], axis=1)
    R_FM[:, 1] = np.stack([s2 * c1, s2 * s1 * s0 + c2 * c0, s2 * s1 * c0 - c2 * s0], axis=1)
    R_FM[:, 2] = np.stack([-s1, c1 * s0, c1 * c0], axis=1)
    # R_WF permutes axes, F's (x, y, z) to W's (z, x, y).
    order = [1, 2, 0]
    return R_FM[:, order][:, :, order]


def base_positions(R_WP: Vector, origin: Vector) -> Vector:
    """The inverse of `rotation`, with the pelvis's origin in W [m], shape (K, 3); pitch within a right angle.

    Args:
        R_WP: Attitudes of the pelvis, shape (K, 3, 3).
        origin: Where its origin is in W [m], shape (K, 3).

    Returns:
        Base positions, shape (K, 6).
    """
    order = [2, 0, 1]
    R_FM = R_WP[:, order][:, :, order]
    base = np.empty((len(R_WP), 6))
    base[:, 0] = np.arctan2(R_FM[:, 2, 1], R_FM[:, 2, 2])
    base[:, 1] = np.arctan2(-R_FM[:, 2, 0], np.hypot(R_FM[:, 2, 1], R_FM[:, 2, 2]))
    base[:, 2] = np.arctan2(R_FM[:, 1, 0], R_FM[:, 0, 0])
    base[:, list(ORIGIN)] = origin
    return base


def angular_velocity_map(angles: Vector) -> Vector:
    """E with w_FM = E (rx', ry', rz') for angles [rad], shape (K, 3); shape (K, 3, 3).

    Its columns are the axes about which the three angles turn, in F.
    """
    axes = angular_velocity(angles[:, None], np.broadcast_to(np.eye(3), (len(angles), 3, 3)))
    return np.ascontiguousarray(axes.swapaxes(1, 2))


def angular_velocity(angles: Vector, rates: Vector) -> Vector:
    """w_FM = E rates for angles [rad] and their rates [rad/s], all of shape (..., 3)."""
    sin, cos = np.sin(angles), np.cos(angles)
    r0, r1 = rates[..., 0], rates[..., 1]
    s1, s2, along = sin[..., 1], sin[..., 2], cos[..., 1] * r0
    w = rates.copy()
    w[..., 0] = cos[..., 2] * along - s2 * r1
    w[..., 1] = s2 * along + cos[..., 2] * r1
    w[..., 2] -= s1 * r0
    return w


def angular_velocity_map_rate(angles: Vector, rates: Vector) -> Vector:
    """Derivative of `angular_velocity_map` by time for rates of the angles [rad/s], shape (K, 3); shape (K, 3, 3)."""
    (_, s1, s2), (_, c1, c2) = np.sin(angles.T), np.cos(angles.T)
    _, d1, d2 = rates.T
    dE = np.zeros((len(angles), 3, 3))
    dE[:, :, 0] = np.stack([-s2 * c1 * d2 - c2 * s1 * d1, c2 * c1 * d2 - s2 * s1 * d1, -c1 * d1], axis=1)
    dE[:, 0, 1], dE[:, 1, 1] = -c2 * d2, -s2 * d2
    return dE


def angle_rates(angles: Vector, w: Vector) -> Vector:
    """Rates of the angles for angular velocities w_FM in F, both shape (K, 3); infinite where they are singular."""
    (_, s1, s2), (_, c1, c2) = np.sin(angles.T), np.cos(angles.T)
    along = c2 * w[:, 0] + s2 * w[:, 1]  # = cos(ry) rx'
    with np.errstate(divide="ignore", invalid="ignore"):
        d0 = along / c1
    return np.stack([d0, c2 * w[:, 1] - s2 * w[:, 0], w[:, 2] + s1 * d0], axis=1)
