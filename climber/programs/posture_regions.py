"""Where the centre of mass of a robot in a posture may be for holds and motors to hold it still.

The posture stays what it is, and the centre of mass moves as a load does that the pelvis carries. Limbs then bear the
same weight of their own, and their torques change with the contact forces only (Orsolino et al. 2020, "Feasible region:
an actuation-aware extension of the support region"). With motors that know no limit it is the region of
`climber.programs.regions`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable

from climber.dynamics import evaluate_at_rest, turning
from climber.programs.blocks import solve_each
from climber.programs.forces import wall_forces, weight_in_plane
from climber.programs.instants import Instants, Margin
from climber.programs.outlines import outline
from climber.programs.regions import GAP, SupportRegions, as_intervals, as_polygons
from climber.programs.wrenches import across
from climber.robot import Indices, Robot
from climber.stance import Contact, Vector
from climber.wall import Wall

TOGETHER = 32  # programs in one call of the solver
MOST_ROOM = 1.0  # [N, N m] room inside the limits that is looked for, no more
HELD = 1e-6  # [N, N m] a violation below this is the solver's rounding


@dataclass(frozen=True)
class _Shifted:
    """K postures in which the centre of mass is moved by x along `basis`: E t = b + B x, the rest as in `Instants`.

    Attributes:
        instants: The postures at rest.
        B: What the pelvis's rows need for each metre [N], shape (K, u, d).
        center: Where the centre of mass is along `basis` [m], shape (K, d).
    """

    instants: Instants
    B: Vector
    center: Vector

    def program(self, rows: Indices) -> tuple[Vector, Vector, Vector, Vector, Vector, Vector]:
        """E, b, G, g, C and d of `solve_blocks` in the variables (t, x)."""
        some, d = self.instants[rows], self.B.shape[2]
        (R, g), (T, limit), (C, tops) = some.force_limits(), some.torque_limits(), some.force_cones()
        E = np.concatenate([some.E, -self.B[rows]], axis=2)
        G = np.pad(np.concatenate([R, T], axis=1), ((0, 0), (0, 0), (0, d)))
        return E, some.b, G, np.concatenate([g, limit], axis=1), np.pad(C, ((0, 0),) * 3 + ((0, d),)), tops

    def violation(self, rows: Indices, v: Vector) -> Vector:
        """By how much v = (t, x), shape (R, n + d), breaks the limits [N, N m], shape (R,); negative inside."""
        some, shape = self.instants[rows], self.instants.forces.lower.shape
        t = v[:, : some.E.shape[2]]
        lower, upper = some.lower.reshape(shape), some.upper.reshape(shape)
        forces = some.forces.excess(t.reshape(len(t), *shape), lower, upper).max(axis=1, initial=-np.inf)
        torques = (np.abs(some.motor_torque(t)) - some.limit).max(axis=1, initial=-np.inf)
        return np.asarray(np.maximum(forces, torques))

    def balanced(self, rows: Indices, v: Vector) -> Vector:
        """The v nearest to the given ones with E t = b + B x."""
        E, b = self.program(rows)[:2]
        gap = b - np.einsum("kun,kn->ku", E, v)
        result: Vector = v + np.einsum("knu,ku->kn", np.linalg.pinv(E), gap)
        return result

    def bound(self, rows: Indices, direction: Vector, y: Vector, z: Vector) -> Vector:
        """What multipliers prove that direction . x is at most, shape (R,).

        Of weak duality: with B^T y = -direction and z >= 0, direction . x <= y . b + z . limit + the greatest
        -(E^T y + T^T z) . t within the limits of forces.
        """
        some = self.instants[rows]
        B, (T, limit) = np.swapaxes(self.B[rows], 1, 2), some.torque_limits()
        y = y - np.einsum("kud,kd->ku", np.linalg.pinv(B), direction + np.einsum("kdu,ku->kd", B, y))
        z = np.maximum(z[:, z.shape[1] - T.shape[1] :], 0.0)
        c = -np.einsum("kun,ku->kn", some.E, y) - np.einsum("krn,kr->kn", T, z)
        shape = self.instants.forces.lower.shape
        forces = replace(some.forces, lower=some.lower.reshape(shape), upper=some.upper.reshape(shape))
        most = forces.greatest(c.reshape(len(c), *shape)).sum(axis=1)
        result: Vector = (y * some.b).sum(axis=1) + (z * limit).sum(axis=1) + most
        return result


def posture_regions(
    robot: Robot,
    wall: Wall,
    q: Vector,
    contacts: Sequence[Contact],
    margin: Margin | None = None,
    gap: float = GAP,
) -> SupportRegions:
    """Which centres of mass the contacts and the motors can hold at K postures.

    Args:
        robot: The robot.
        wall: The wall.
        q: The postures, shape (K, nq).
        contacts: The contacts that hold; the feet of their limbs are on them in every posture.
        margin: How far to stay inside the limits of forces and torques.
        gap: In space, how closely to enclose the polygons [m].
    """
    pull = robot.mass * wall.gravity
    basis = np.array([[1.0, 0.0, 0.0]]) if robot.planar else across(pull)
    limbs = [contact.limb for contact in contacts]
    forces = wall_forces(wall, robot.dimension)[np.array([contact.hold for contact in contacts], dtype=int)]
    h, J = evaluate_at_rest(robot, q, limbs)
    instants = Instants.of_loads(robot, forces, h, J, margin or Margin(), turning(robot, limbs))
    center, B = _moved(robot, q, basis, pull)
    shifted = _Shifted(instants, B, center)
    inside, lack = _roomiest(shifted)
    held = np.flatnonzero(lack <= HELD)

    def ask(figures: Indices, direction: Vector) -> tuple[Vector, Vector]:
        point, reach = _farthest(shifted, figures, direction, inside[figures])
        middle = center[figures]
        return middle + point, reach + (middle * direction).sum(axis=1)

    nothing = np.full((len(q), 3), np.nan)
    shortfall = np.where(lack <= HELD, np.nan, lack)
    if robot.planar:
        ends = np.full((2, len(q), 2), np.nan)
        if not weight_in_plane(wall, robot.mass):
            ends[:, held] = [-np.inf, np.inf]  # nothing ties the centre of mass
            return as_intervals(ends[0], ends[1], shortfall)
        for side, sign in enumerate((-1.0, 1.0)):
            point, reach = ask(held, np.full((len(held), 1), sign))
            ends[0, held, side], ends[1, held, side] = point[:, 0], sign * reach
        return as_intervals(ends[0], ends[1], shortfall)
    return as_polygons(outline(held, len(q), ask, gap), pull, nothing, nothing[:, 0], shortfall)


def _moved(robot: Robot, q: Vector, basis: Vector, pull: Vector) -> tuple[Vector, Vector]:
    """Where the centre of mass is along `basis` [m], and what the rows without a motor need for moving it a metre [N].

    Moved by x, the weight turns the pelvis by x cross weight more.
    """
    context, plant = robot.context(), robot.plant
    free = np.setdiff1d(np.arange(plant.num_velocities()), robot.joint_v[robot.effort > 0.0])
    couples = np.cross(basis, pull)  # for each metre along each vector of the basis
    center, B = np.empty((len(q), len(basis))), np.empty((len(q), len(free), len(basis)))
    world, frame = plant.world_frame(), robot.pelvis.body_frame()
    for k, posture in enumerate(q):
        plant.SetPositions(context, posture)
        center[k] = basis @ robot.center_of_mass(context)
        turn = plant.CalcJacobianAngularVelocity(context, JacobianWrtVariable.kV, frame, world, world)
        B[k] = -(turn[:, free].T @ couples.T)
    return center, B


def _roomiest(shifted: _Shifted) -> tuple[Vector, Vector]:
    """(t, x) farthest inside all limits, or least outside, shape (K, n + d), and by how much [N, N m], shape (K,)."""
    rows = np.arange(len(shifted.instants))
    E, b, G, g, C, d = shifted.program(rows)
    n = E.shape[2]
    extra = ((0, 0), (0, 0), (0, 1))
    G, C = np.pad(G, extra, constant_values=-1.0), np.pad(C, ((0, 0), *extra))
    C[:, :, 0, n] = -1.0
    cost, least = np.zeros((len(rows), n + 1)), np.zeros((len(rows), 1, n + 1))
    cost[:, n], least[:, 0, n] = 1.0, -1.0
    G, g = np.concatenate([G, least], axis=1), np.concatenate([g, np.full((len(rows), 1), MOST_ROOM)], axis=1)
    v = shifted.balanced(rows, solve_each(cost, np.pad(E, extra), b, G, g, C, d, together=TOGETHER).x[:, :n])
    off = np.abs(np.einsum("kun,kn->ku", E, v) - b).max(axis=1, initial=0.0)
    lack = np.where(off <= HELD, shifted.violation(rows, v), off)
    return v, np.where(np.isnan(lack), np.inf, lack)  # no forces of any size balance those


def _farthest(shifted: _Shifted, rows: Indices, direction: Vector, inside: Vector) -> tuple[Vector, Vector]:
    """X that can be held, shape (R, d), and bounds on direction . x [m], shape (R,)."""
    E, b, G, g, C, d = shifted.program(rows)
    n = shifted.instants.E.shape[2]
    cost = np.pad(-direction, ((0, 0), (n, 0)))
    v, y, z = solve_each(cost, E, b, G, g, C, d, together=TOGETHER)
    lost = np.isnan(v[:, 0])
    v, y, z = np.where(lost[:, None], inside, v), np.nan_to_num(y), np.nan_to_num(z)
    v = shifted.balanced(rows, v)
    outside, least = shifted.violation(rows, v), shifted.violation(rows, inside)
    # What rounding leaves outside the limits goes back by going a little towards what is inside.
    share = np.where(least < 0.0, np.clip(outside / np.maximum(outside - least, 1e-300), 0.0, 1.0), 0.0)
    v = v + share[:, None] * (inside - v)
    return v[:, n:], shifted.bound(rows, direction, y, z)
