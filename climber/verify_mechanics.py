"""What the samples of a plan need, and what pushes, other masses and feet elsewhere add to it.

Written for `verify_margins`, on the mechanics of `verify_model`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climber.robot import Robot
from climber.stance import Vector
from climber.verify_model import Poses, Tree
from climber.verify_motion import Motion

STEP = 1e-5  # [m] of differences


class Mechanics:
    """What the samples of a robot's whole plan need, and what errors add to it.

    Attributes:
        load: Generalised force without contacts [N, N m], shape (K, nv).
        columns: Generalised force of each foot's force in W, shape (K, num_limbs, nv, 3), to be added to the load.
        turns: Likewise of each foot's moment about z, shape (K, num_limbs, nv).
        heavier: What twice the masses add to the load, shape (K, nv).
        pushed: Generalised force of a force on the pelvis at the centre of mass, shape (K, nv, 3).
        displaced: What a centre of mass displaced by 1 m adds to the load, fixed to the pelvis, shape (K, nv, 3).
    """

    def __init__(self, robot: Robot, samples: Motion, gripped: bool) -> None:
        """Evaluates all; `gripped` says whether holds can turn feet at all."""
        self._robot, self._tree, self._samples, self.gravity = robot, Tree(robot), samples, robot.gravity
        self._dimension = 2 if robot.planar else 3
        tree, q, v, vd = self._tree, samples.q, samples.v, samples.vd
        poses, limbs = tree.poses(q), len(robot.limbs)
        none = np.zeros((len(q), limbs, 3))
        self.load = tree.required_force(poses, v, vd, none)
        self.columns = self._columns(tree, poses, range(limbs))
        self.turns = np.zeros((len(q), limbs, v.shape[1]))
        for limb in range(limbs) if gripped else ():
            moment = np.zeros((len(q), limbs))
            moment[:, limb] = 1.0
            self.turns[:, limb] = tree.required_force(poses, v, vd, none, moment) - self.load
        self.heavier = tree.heavier(2.0).required_force(poses, v, vd, none) - self.load
        R = tree.pelvis_turned(poses)
        axes = np.eye(3)[: self._dimension]
        own = [tree.off_center(axis).required_force(poses, v, vd, none) - self.load for axis in axes]
        self.displaced = np.einsum("pkv,kwp->kvw", np.array(own), R[:, :, : self._dimension])
        out = np.einsum("kwp,kw->kp", R, tree.center_of_mass(poses) - tree.pelvis(poses))
        points = self._columns(tree.held_at(np.concatenate([np.zeros((1, 3)), axes])), poses, range(1 + len(axes)))
        self.pushed = points[:, 0] + np.einsum("kp,kpvw->kvw", out[:, : len(axes)], points[:, 1:] - points[:, :1])

    def _columns(self, tree: Tree, poses: Poses, limbs: Sequence[int]) -> Vector:
        """What 1 N on some of the feet adds to the required force, (K, len(limbs), nv, 3); in the plane not along z."""
        result = tree.required_of_feet(poses, limbs)
        result[..., self._dimension :] = 0.0
        return result

    def followed(self, rows: Vector) -> tuple[Vector, Vector]:
        """First-order changes when a limb's foot is displaced, per metre along W's axes.

        The limb follows, the pelvis does not move, and only the limb's weight counts.

        Args:
            rows: Samples.

        Returns:
            Of the load, shape (K, num_limbs, nv, 3), and of the limb's own columns, shape (K, num_limbs, nv, 3, 3); the
            displacement last.
        """
        tree, q, limbs = self._tree, self._samples.q[rows], self._robot.limbs
        load = np.zeros((len(q), len(limbs), q.shape[1], 3))
        columns = np.zeros((len(q), len(limbs), q.shape[1], 3, 3))
        axes = slice(0, self._dimension)
        ways = 2 * self._dimension  # there and back along each axis
        rest, none = np.zeros((ways * len(q), q.shape[1])), np.zeros((ways * len(q), len(limbs), 3))
        for number, limb in enumerate(limbs):
            along = -self.columns[rows, number][:, limb.v, axes]  # the foot's velocity by the joints'
            inverse = np.linalg.pinv(np.swapaxes(along, 1, 2))
            moved = np.tile(q, (ways, 1, 1))
            for axis in range(self._dimension):
                moved[2 * axis, :, limb.q] += STEP * inverse[:, :, axis].T
                moved[2 * axis + 1, :, limb.q] -= STEP * inverse[:, :, axis].T
            poses = tree.poses(moved.reshape(-1, q.shape[1]))
            for values, result in (
                (tree.required_force(poses, rest, rest, none), load),
                (self._columns(tree, poses, [number])[:, 0], columns),
            ):
                ends = values.reshape(ways, len(q), *values.shape[1:])
                result[:, number, ..., axes] = np.moveaxis(ends[::2] - ends[1::2], 0, -1) / (2.0 * STEP)
        return load, columns
