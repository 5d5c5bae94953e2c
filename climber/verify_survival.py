"""What holds give when something is off, as second-order cones, and by how much limits must be left at least.

Written anew for `verify_margins`: a hold with friction mu, unit normal n and tangents T gives the forces f with
|T f| <= mu (n.f - lo) and |T f| <= mu (hi - n.f), lo and hi the normal forces that go with the least and greatest
force along the edges of its cone; a magnet the same of f + adhesion n; a pin any force of at most `max_force` along
each axis of W.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import clarabel
import numpy as np
from scipy import sparse

from climber.stance import Vector
from climber.wall import Hold

IMBALANCE = 10.0  # how much dearer it is to miss balance than to leave limits


@dataclass(frozen=True)
class Give:
    """What one hold gives.

    Attributes:
        normal: Unit normal in W, shape (3,).
        tangents: Unit vectors across it that forces may have parts along, shape (1 or 2, 3).
        friction: Coefficient.
        least: Least normal force [N].
        most: Greatest normal force [N]; for a pin, along each axis of W.
        pin: Whether it is one.
        moment: Greatest moment about z [N m].
    """

    normal: Vector
    tangents: Vector
    friction: float
    least: float
    most: float
    pin: bool
    moment: float

    @classmethod
    def of(cls, hold: Hold, planar: bool) -> Give:
        """What a hold gives as it is."""
        normal = np.array(hold.normal)
        across = np.cross([0.0, 0.0, 1.0], normal) if planar else np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        across = across / max(float(np.linalg.norm(across)), 1e-12)
        tangents = np.array([across] if planar else [across, np.cross(normal, across)])
        if hold.grip == "pin":
            return cls(normal, tangents, 0.0, 0.0, hold.max_force, True, hold.max_moment)
        edge = 2.0 / np.hypot(1.0, hold.friction)
        adhesion = hold.adhesion if hold.grip == "magnet" else 0.0
        least, most = edge * hold.min_force - adhesion, edge * hold.max_force - adhesion
        return cls(normal, tangents, hold.friction, least, most, False, 0.0)

    def slippery(self, drop: float) -> Give:
        """With friction less by a share."""
        return replace(self, friction=(1.0 - drop) * self.friction)

    def turned(self, angle: float) -> Give:
        """What it gives whichever way its normal is turned by up to an angle: forces so far inside the cone's edges."""
        return replace(self, friction=float(np.tan(np.arctan(self.friction) - angle)))

    def excess(self, f: Vector) -> Vector:
        """By how much forces (K, 3) are not given [N], shape (K,); negative inside."""
        if self.pin:
            return np.asarray(np.abs(f).max(axis=1) - self.most)
        along, across = f @ self.normal, np.linalg.norm(f @ self.tangents.T, axis=1)
        room = np.minimum(along - self.least, self.most - along)
        return np.asarray(np.maximum(across - self.friction * room, -room))


@dataclass(frozen=True)
class Need:
    """What one instant needs: contact forces x with E x = b, given by the holds, and torques |c - A x| <= effort.

    Attributes:
        E: Shape (u, n); the forces of one contact after those of another, then the moments of pins if there are any.
        b: [N, N m], shape (u,).
        A: Shape (j, n).
        c: [N m], shape (j,).
        effort: [N m], shape (j,).
        gives: What each contact's hold gives.
    """

    E: Vector
    b: Vector
    A: Vector
    c: Vector
    effort: Vector
    gives: tuple[Give, ...]


def shortages(needs: list[Need], dimension: int, room: float = 1.0) -> tuple[list[Vector], Vector]:
    """The least by which limits must be left at each instant, less than zero where there is room, and the forces.

        min  s + 10 e   subject to   |E x - b| <= e,   all limits left by at most s,   s >= -room,   e >= 0

    Returns:
        Forces for each, and the greater of s and e for each [N, N m], shape (K,).
    """
    columns, flat, flat_right, round_, round_right, sizes, cost = 0, [], [], [], [], [], []
    for need in needs:
        n = need.E.shape[1] + 2
        linear, limits, cones = _program(need, dimension, room)
        flat.append((columns, linear))
        flat_right.append(limits)
        for matrix, right in cones:
            round_.append((columns, matrix))
            round_right.append(right)
            sizes.append(len(right))
        cost.append(np.concatenate([np.zeros(n - 2), [1.0, IMBALANCE]]))
        columns += n
    if not needs:
        return [], np.zeros(0)
    matrix, right = _stacked(flat + round_, columns), np.concatenate(flat_right + round_right)
    shapes = [clarabel.NonnegativeConeT(sum(map(len, flat_right)))] + [
        clarabel.SecondOrderConeT(size) for size in sizes
    ]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = 1e-9
    empty = sparse.csc_matrix((columns, columns))
    solution = clarabel.DefaultSolver(empty, np.concatenate(cost), matrix, right, shapes, settings).solve()
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        return [np.full(need.E.shape[1], np.nan) for need in needs], np.full(len(needs), np.nan)
    parts = np.split(np.array(solution.x), np.cumsum([len(part) for part in cost])[:-1])
    return [part[:-2] for part in parts], np.array([max(part[-2], part[-1]) for part in parts])


def _program(need: Need, dimension: int, room: float) -> tuple[Vector, Vector, list[tuple[Vector, Vector]]]:
    """Rows R x <= r of one instant, and its cones: r - R x in the second-order cone, for the unknowns x, s, e."""
    u, n = need.E.shape
    k = len(need.gives)
    balance, torque = np.zeros((u, 1)), np.ones((len(need.A), 1))
    rows = [
        np.hstack([need.E, balance, balance - 1.0]),
        np.hstack([-need.E, balance, balance - 1.0]),
        np.hstack([-need.A, -torque, 0.0 * torque]),
        np.hstack([need.A, -torque, 0.0 * torque]),
        np.hstack([np.zeros((2, n)), -np.eye(2)]),
    ]
    right = [need.b, -need.b, need.effort - need.c, need.effort + need.c, np.array([room, 0.0])]
    cones = []
    for i, give in enumerate(need.gives):
        own = slice(i * dimension, (i + 1) * dimension)
        if n > k * dimension:
            turning = np.zeros((2, n + 2))
            turning[:, k * dimension + i] = 1.0, -1.0
            turning[:, n] = -1.0
            rows.append(turning)
            right.append(np.full(2, give.moment))
        if give.pin:
            sides = np.zeros((2 * dimension, n + 2))
            sides[:, own] = np.concatenate([np.eye(dimension), -np.eye(dimension)])
            sides[:, n] = -1.0
            rows.append(sides)
            right.append(np.full(2 * dimension, give.most))
            continue
        normal, tangents = give.normal[:dimension], give.tangents[:, :dimension]
        for sign, limit in ((1.0, -give.least), (-1.0, give.most)):
            bound = np.zeros((1, n + 2))
            bound[0, own], bound[0, n] = -sign * normal, -1.0
            rows.append(bound)
            right.append(np.array([limit]))
            cone, top = np.zeros((1 + len(tangents), n + 2)), np.zeros(1 + len(tangents))
            cone[0, own], cone[0, n] = -sign * give.friction * normal, -1.0
            cone[1:, own], top[0] = -tangents, give.friction * limit
            cones.append((cone, top))
    return np.vstack(rows), np.concatenate(right), cones


def _stacked(blocks: list[tuple[int, Vector]], columns: int) -> sparse.csc_matrix:
    """Blocks one below the other, each from a column of its own on."""
    heights = np.cumsum([0, *(len(block) for _, block in blocks)])
    places = [np.nonzero(block) for _, block in blocks]
    row = np.concatenate([place[0] + top for place, top in zip(places, heights[:-1], strict=True)])
    column = np.concatenate([place[1] + left for place, (left, _) in zip(places, blocks, strict=True)])
    values = np.concatenate([block[place] for place, (_, block) in zip(places, blocks, strict=True)])
    return sparse.csc_matrix((values, (row, column)), shape=(int(heights[-1]), columns))
