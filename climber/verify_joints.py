"""What each kind of joint does with what it carries, for `verify` alone: planar and floating bases, hinges and welds.

A joint lets a frame M, fixed in the child body, move against a frame F, fixed in the parent body. Its velocities are
rates along axes that are fixed in F: a slide moves M's origin along its axis, a turn turns M about its axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.tree import Joint, PlanarJoint, RevoluteJoint, RpyFloatingJoint, WeldJoint

from climber.stance import Vector

X, Y, Z = np.eye(3)


@dataclass(frozen=True)
class Freedom:
    """One velocity of a joint.

    Attributes:
        axis: Unit vector in F, shape (3,).
        slides: Whether M moves along the axis; otherwise it turns about it.
    """

    axis: Vector
    slides: bool


def freedoms(joint: Joint, on_world: bool) -> tuple[Freedom, ...] | None:
    """The velocities of a joint in their order; None if it is of a kind that `verify` cannot follow.

    Args:
        joint: The joint.
        on_world: Whether its parent body is the world, as it must be for one that slides.
    """
    if isinstance(joint, WeldJoint):
        return ()
    if isinstance(joint, RevoluteJoint):
        return (Freedom(joint.revolute_axis(), False),)
    if isinstance(joint, PlanarJoint) and on_world:
        return (Freedom(X, True), Freedom(Y, True), Freedom(Z, False))
    if isinstance(joint, RpyFloatingJoint) and on_world:
        return tuple(Freedom(axis, slides) for slides in (False, True) for axis in (X, Y, Z))
    return None


def pose(joint: Joint, q: Vector) -> tuple[Vector, Vector]:
    """Orientation R_FM (K, 3, 3) and place p_FM (K, 3) [m] for a joint's own positions `q`, shape (K, n)."""
    place = np.zeros((len(q), 3))
    if isinstance(joint, RevoluteJoint):
        return turn(joint.revolute_axis(), q[:, 0]), place
    if isinstance(joint, PlanarJoint):
        place[:, :2] = q[:, :2]
        return turn(Z, q[:, 2]), place
    if isinstance(joint, RpyFloatingJoint):  # roll about x first, then pitch about y, yaw about z last, axes fixed in F
        return turn(Z, q[:, 2]) @ turn(Y, q[:, 1]) @ turn(X, q[:, 0]), q[:, 3:]
    return np.broadcast_to(np.eye(3), (len(q), 3, 3)), place


def rates(joint: Joint, q: Vector, v: Vector, vd: Vector) -> tuple[Vector, Vector]:
    """First and second time derivatives of a joint's positions.

    For all but a floating base these are its velocities and accelerations. The angles roll r, pitch p and yaw y of
    R_FM = Rz(y) Ry(p) Rx(r) turn at rates with

        w_FM = r' (cos y cos p, sin y cos p, -sin p) + p' (-sin y, cos y, 0) + y' (0, 0, 1),

    which is solved with s = cos y w_x + sin y w_y and t = -sin y w_x + cos y w_y as r' = s / cos p, p' = t,
    y' = w_z + s tan p, and differentiated once more.

    Args:
        joint: The joint.
        q: Its positions, shape (K, n).
        v: Its velocities, shape (K, n); of a floating base w_FM [rad/s] and v_FM [m/s] in F.
        vd: Their derivatives, shape (K, n).
    """
    if not isinstance(joint, RpyFloatingJoint):
        return v, vd
    sin_p, cos_p, sin_y, cos_y = np.sin(q[:, 1]), np.cos(q[:, 1]), np.sin(q[:, 2]), np.cos(q[:, 2])
    s, t = cos_y * v[:, 0] + sin_y * v[:, 1], cos_y * v[:, 1] - sin_y * v[:, 0]
    first, second = v.copy(), vd.copy()
    first[:, 0], first[:, 1], first[:, 2] = s / cos_p, t, v[:, 2] + s * sin_p / cos_p
    s_dot = cos_y * vd[:, 0] + sin_y * vd[:, 1] + first[:, 2] * t
    second[:, 0] = s_dot / cos_p + s * t * sin_p / cos_p**2
    second[:, 1] = cos_y * vd[:, 1] - sin_y * vd[:, 0] - first[:, 2] * s
    second[:, 2] = vd[:, 2] + s_dot * sin_p / cos_p + s * t / cos_p**2
    return first, second


def turn(axis: Vector, angle: Vector) -> Vector:
    """Rotations about the unit vector `axis` (3,) by each `angle` [rad], shape (K,), by Rodrigues; shape (K, 3, 3)."""
    x, y, z = axis
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sin, cos = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sin * across + (1.0 - cos) * (across @ across))
