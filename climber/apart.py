"""Proofs that no motion on some contacts leads from one posture to another.

A path search that ends without a path proves nothing. Two cases can be decided for certain. Where the contacts leave
no freedom, a posture is a component of the feasible set by itself. Where a robot with a single joint hangs from one
limb, its configurations are a surface (a torus, cut at the joint's limits), which is small enough to be covered with
cells: those in which some link meets an obstacle, wherever in the cell the robot is, are taken away, and what is left
may fall into pieces (Bretl 2006, figs. 4 and 5).
"""

from __future__ import annotations

from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import label

from climber.chart import Chart
from climber.clearance import Clearance
from climber.manifold import Body, Manifold
from climber.robot import Indices
from climber.stance import Vector

SAME = 1e-6  # [m, rad] postures nearer to each other than this are one
COARSEST = 64  # cells that a full turn is first cut into
HALVINGS = 4  # after so many bisections what is not decided counts as possible


def why_apart(manifold: Manifold, a: Vector, b: Vector) -> str | None:
    """Why no path on a manifold joins two configurations on it, shape (nq,), if that can be proved; else None."""
    if manifold.rigid:
        off = a - b
        angle = manifold.body.robot.angle_q
        off[angle] -= 2 * np.pi * np.round(off[angle] / (2 * np.pi))
        isolated = manifold.newton_chart(a).dimension == 0
        return (
            "the contacts leave no freedom, and the postures differ" if isolated and np.abs(off).max() > SAME else None
        )
    if not Cells.cover(manifold):
        return None
    cells = Cells.of(manifold)
    if cells.component(a) == cells.component(b):
        return None
    return f"obstacles cut what can be reached from one posture off from the other ({cells.size} cells searched)"


class Cells:
    """The configurations of a robot with one joint that hangs from one limb, as a grid of cells.

    Coordinates are those of the chart rooted at that limb: the angle of its last link and the joint's angle. In a cell
    of half widths h_1 and h_2, a point at distance r from the foot and d from the joint's axis (zero if the joint does
    not move it) is less than h_1 (r + h_2 d) + h_2 d from where it is at the cell's centre. A link of thickness t whose
    ends move by no more than m still meets an obstacle if its middle line was nearer than t - m to it.

    Margins, balance and links that meet each other are left out: what is cut off without these is so with them.

    Attributes:
        manifold: The contact.
        size: How many cells were looked at.
    """

    def __init__(self, manifold: Manifold) -> None:
        self.manifold, self.size = manifold, 0
        chart = manifold.chart(np.zeros(manifold.body.robot.plant.num_positions()), next(iter(manifold.points)))
        clearance = manifold.body.clearance
        assert isinstance(chart, Chart) and isinstance(clearance, Clearance)  # `cover` sees to it
        self._clearance = clearance
        self._chart = chart
        self._joint = int(chart.independent[0] == manifold.body.robot.angle_q[0])  # its place among the coordinates
        self._lower, self._upper = manifold.body.kinematics.lower[0], manifold.body.kinematics.upper[0]

    @staticmethod
    def cover(manifold: Manifold) -> bool:
        """Whether a manifold is of the kind that cells cover."""
        one_joint = len(manifold.points) == 1 and len(manifold.body.kinematics.joint_q) == 1
        return one_joint and manifold.body.robot.planar

    @classmethod
    def of(cls, manifold: Manifold) -> Cells:
        """The cells of a manifold, remembered for the robot on its wall."""
        known = _KNOWN.setdefault(manifold.body, {})
        ((limb, point),) = manifold.points.items()
        key = limb, tuple(point.tolist())
        if key not in known:
            known[key] = cls(manifold)
        return known[key]

    def component(self, q: Vector) -> int:
        """The number of the piece that the feasible configuration `q`, shape (nq,), lies in; 0 if no cell has it."""
        u = self._chart.coordinates(q)
        columns, rows = self._pieces.shape
        column = int(np.floor((u[1 - self._joint] / (2 * np.pi) % 1.0) * columns)) % columns
        row = int(np.floor((u[self._joint] - self._lower) / (self._upper - self._lower) * rows))
        return int(self._pieces[column, min(max(row, 0), rows - 1)])

    @cached_property
    def _pieces(self) -> NDArray[np.int64]:
        """The number of the piece of each cell of the finest grid, 0 where the robot meets an obstacle."""
        shape = np.array([COARSEST, max(1, round(COARSEST * (self._upper - self._lower) / (2 * np.pi)))])
        possible, decided = np.ones(shape, dtype=bool), np.zeros(shape, dtype=bool)
        for halving in range(HALVINGS + 1):
            if halving:
                possible, decided = (np.repeat(np.repeat(grid, 2, axis=0), 2, axis=1) for grid in (possible, decided))
            column, row = np.nonzero(~decided)
            blocked, free = self._look(column, row, possible.shape)
            possible[column, row] = ~blocked
            decided[column, row] = blocked | free
        pieces, _ = label(possible, structure=np.ones((3, 3)))
        # The first column and the last are neighbours.
        parent = np.arange(pieces.max() + 1)
        for shift in (-1, 0, 1):
            for one, two in {
                (int(a), int(b)) for a, b in zip(pieces[0], np.roll(pieces[-1], shift), strict=True) if a and b
            }:
                parent[parent == parent[one]] = parent[two]
        return np.asarray(parent[pieces], dtype=np.int64)

    def _look(
        self, column: Indices, row: Indices, shape: tuple[int, ...]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Cells in which an obstacle is met wherever the robot is, and cells in which none is."""
        self.size += len(column)
        half = np.pi / shape[0], (self._upper - self._lower) / shape[1] / 2
        u = np.empty((len(column), 2))
        u[:, 1 - self._joint] = half[0] * (2 * column + 1)
        u[:, self._joint] = self._lower + half[1] * (2 * row + 1)
        body = self.manifold.body
        start, end = self._segments(u)
        (foot,) = self.manifold.points.values()
        bend = np.zeros(2)
        bend[self._joint] = 1e-6
        moved = [
            (np.linalg.norm(p - q, axis=2) / 2e-6)
            for p, q in zip(self._segments(u + bend), self._segments(u - bend), strict=True)
        ]
        move = np.max(
            [
                half[0] * (np.linalg.norm(ends - foot[:2], axis=2) + half[1] * d) + half[1] * d
                for ends, d in zip((start, end), moved, strict=True)
            ],
            axis=0,
        ) * (1 + 1e-6)
        obstacles = shapely.union_all(body.wall.obstacles)
        gap = shapely.distance(shapely.linestrings(np.stack([start, end], axis=2)), obstacles) - self._clearance.radius
        return (gap < -move).any(axis=1), (gap > move).all(axis=1)

    def _segments(self, u: Vector) -> tuple[Vector, Vector]:
        """Both ends of all links' segments [m], shapes (K, S, 2)."""
        body = self.manifold.body
        return self._clearance.ends(body.kinematics.poses(self._chart.expand(u)[0]))


_KNOWN: WeakKeyDictionary[Body, dict[tuple[int, tuple[float, ...]], Cells]] = WeakKeyDictionary()
