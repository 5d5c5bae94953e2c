"""Can these contacts carry the robot, and where may its centre of mass be?

In the plane contact forces are zonotopes: a contact pushes with `f = offset + G t`, `lower <= t <= upper`, so that
friction (Gönen 2021, eqs. 4.8-4.11), pins and magnets are one model (`climber.programs.forces`) and every question
below stays linear.

`SupportProgram` is the reference, one `MathematicalProgram` for one set of contacts; `climber.programs.support` answers
the same question for many sets at once and must agree with it. So does `climber.programs.regions` with `RegionProgram`,
for robots in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.solvers import ClarabelSolver, ClpSolver, MathematicalProgram, SolverOptions

from climber.programs.forces import ContactForces, wall_forces, weight_in_plane
from climber.programs.wrenches import across
from climber.stance import Contact, Vector
from climber.wall import Wall


@dataclass(frozen=True)
class SupportInterval:
    """Where the centre of mass may be, or why it may be nowhere.

    Attributes:
        lower: Least abscissa of the centre of mass in W [m]; NaN when empty, -inf where there is no weight to hold.
        upper: Greatest abscissa of the centre of mass in W [m]; NaN when empty, inf where there is no weight to hold.
        direction: When empty, the unit direction in W in which the contacts cannot push enough, shape (3,). Without
            weight it may also be z or -z: they cannot turn enough about it.
        shortfall: When empty, by how much they cannot [N]: `direction . (-weight)` exceeds the greatest
            `direction . force` of the contacts by this. For z or -z, of moments about the contacts' mean [N m].
    """

    lower: float
    upper: float
    direction: Vector | None = None
    shortfall: float = 0.0

    @property
    def empty(self) -> bool:
        """No centre of mass can be held."""
        return self.direction is not None

    @property
    def width(self) -> float:
        """Width of the interval [m]; 0 when empty."""
        return 0.0 if self.empty else self.upper - self.lower

    def margin(self, x_com: float) -> float:
        """Distance from `x_com` to the nearer end [m], negative outside, -inf when the interval is empty."""
        return -np.inf if self.empty else min(x_com - self.lower, self.upper - x_com)


class SupportProgram:
    """The interval of the centre of mass's abscissa in static equilibrium (Gönen 2021, eqs. 4.12-4.16).

    Given contacts i = 1..k at p_i [m] with forces f_i = o_i + G_i t_i [N], the weight m g [N] down along -y, and the
    reference point p_0, the mean of the p_i (any point serves; a near one keeps the numbers small):

        min or max  x_CM
        over        t_1, ..., t_k, x_CM
        subject to  (1) sum_i f_i = (0, m g)                                 force balance, x and y
                    (2) sum_i (p_i - p_0) x f_i + n_i = (x_CM - x_0) m g     torque balance about p_0
                    (3) lower_i <= t_i <= upper_i                            force limits (4.9)

    n_i is the moment of a gripper that turns its pin, if any. Without weight any x_CM will do if there is a solution.
    Every force in a friction cone is a nonnegative sum of its two edges, so in the plane the cone is exact. The limits
    are the thesis's, on each edge: the contact force itself can be up to twice `max_force` where the cone is narrow.

    Attributes:
        prog: The program, constraints named; its costs are added at `solve`.
        t: Its variables [N], shape (k, p).
        x_com: Its variable x_CM - x_0 [m].
    """

    def __init__(self, points: Vector, forces: ContactForces, weight: float) -> None:
        """Builds the program.

        Args:
            points: Contact points in W [m], shape (k, 3).
            forces: Forces of the contacts, leading shape (k,).
            weight: The robot's weight along the wall [N].
        """
        self._points, self._forces, self._weight = points.reshape(-1, 3), forces, weight
        self._x0 = float(self._points[:, 0].mean()) if len(points) else 0.0
        k, p = forces.lower.shape
        self.prog = MathematicalProgram()
        self.t = self.prog.NewContinuousVariables(k, p, "t")
        self.x_com = self.prog.NewContinuousVariables(1, "x_com")[0]

        arms = self._points - self._points.mean(axis=0) if k else self._points
        balance = np.zeros((3, k * p + 1))
        for i in range(k):
            columns = slice(i * p, (i + 1) * p)
            balance[:2, columns] = forces.generators[i, :2]
            balance[2, columns] = _cross(arms[i], forces.generators[i])
            if forces.moments is not None:
                balance[2, columns] += forces.moments[i]
        balance[2, -1] = -weight
        constant = np.append(forces.offset.sum(axis=0)[:2], _cross(arms.T, forces.offset.T).sum())
        load = np.array([0.0, weight, 0.0]) - constant
        self._balance, self._load = balance, load
        variables = np.append(self.t.ravel(), self.x_com)
        for rows, name in (([0], "force balance along x"), ([1], "force balance along y"), ([2], "torque balance")):
            row = self.prog.AddLinearEqualityConstraint(balance[rows], load[rows], variables)
            row.evaluator().set_description(name)
        for i in range(k):
            limits = self.prog.AddBoundingBoxConstraint(forces.lower[i], forces.upper[i], self.t[i])
            limits.evaluator().set_description(f"force limits of contact {i}")

    @classmethod
    def of_contacts(cls, wall: Wall, contacts: Sequence[Contact], mass: float) -> SupportProgram:
        """The program for feet on a wall; `mass` in kg."""
        holds = np.array([c.hold for c in contacts], dtype=int)
        return cls(wall.points(contacts), wall_forces(wall)[holds], weight_in_plane(wall, mass))

    def solve(self) -> SupportInterval:
        """Both ends of the interval, or the direction in which the contacts fail."""
        if self._weight == 0.0:
            balanced = ClpSolver().Solve(self.prog).is_success()
            return SupportInterval(-np.inf, np.inf) if balanced else self._failure()
        ends = []
        for sign in (1.0, -1.0):
            cost = self.prog.AddLinearCost(sign * self.x_com)
            result = ClpSolver().Solve(self.prog)
            self.prog.RemoveCost(cost)
            if not result.is_success():
                return self._failure()
            ends.append(self._x0 + float(result.GetSolution(self.x_com)))
        return SupportInterval(ends[0], ends[1])

    @cached_property
    def interval(self) -> SupportInterval:
        """`solve()`, remembered."""
        return self.solve()

    def margin(self, x_com: float) -> float:
        """How far `x_com` [m] is inside the interval [m], negative outside, -inf when nothing can be held."""
        return self.interval.margin(x_com)

    def _failure(self) -> SupportInterval:
        certificate = ShortfallProgram(self._forces, self._weight).solve()
        if certificate is None and self._weight == 0.0:
            certificate = self._moment_shortfall()
        if certificate is None:  # the torque row is free through x_CM, so only force balance can fail
            raise RuntimeError("Clp calls a load infeasible that the contacts can carry")
        return SupportInterval(np.nan, np.nan, *certificate)

    def _moment_shortfall(self) -> tuple[Vector, float] | None:
        """About which of z and -z balanced forces cannot turn enough, and by how much [N m]."""
        prog = MathematicalProgram()
        t = prog.NewContinuousVariables(self.t.size, "t")
        prog.AddLinearEqualityConstraint(self._balance[:2, :-1], self._load[:2], t)
        prog.AddBoundingBoxConstraint(self._forces.lower.ravel(), self._forces.upper.ravel(), t)
        for sign in (1.0, -1.0):
            cost = prog.AddLinearCost(-sign * self._balance[2, :-1], 0.0, t)
            result = ClpSolver().Solve(prog)
            prog.RemoveCost(cost)
            shortfall = sign * self._load[2] + result.get_optimal_cost() if result.is_success() else 0.0
            if shortfall > 0.0:
                return np.array([0.0, 0.0, sign]), float(shortfall)
        return None


class RegionProgram:
    """How far the centre of mass can be in a direction, for a robot in space in static equilibrium (Bretl 2006, B1-B3).

    Given contacts i = 1..k at p_i [m] with forces f_i = o_i + G_i t_i [N], the weight w [N], the mean p_0 of the p_i,
    and unit vectors e_1 and e_2 across gravity:

        max         u . c
        over        t_1, ..., t_k, c in R^2
        subject to  (1) sum_i f_i + w = 0                                                          force balance
                    (2) sum_i (p_i - p_0) x f_i + (c_1 e_1 + c_2 e_2 - p_0) x w = 0                torque balance
                    (3) t_i in two second-order cones, in pyramids, or in a box                    force limits

    Attributes:
        prog: The program, constraints named; its cost is added at `solve`.
        t: Its variables t [N], shape (k, p).
        c: Its variables c [m], shape (2,), measured from p_0.
        origin: p_0 along e_1 and e_2 [m], shape (2,).
    """

    def __init__(self, points: Vector, forces: ContactForces, pull: Vector) -> None:
        """Builds the program.

        Args:
            points: Contact points in W [m], shape (k, 3).
            forces: Forces of the contacts in space, leading shape (k,).
            pull: The weight in W [N], shape (3,).
        """
        center = points.mean(axis=0)
        basis = across(pull)
        self.origin: Vector = basis @ center
        k, p = forces.lower.shape
        self.prog = MathematicalProgram()
        self.t = self.prog.NewContinuousVariables(k, p, "t")
        self.c = self.prog.NewContinuousVariables(2, "c")
        arms = points - center
        turns = np.cross(arms[:, None], np.swapaxes(forces.generators, 1, 2))  # (k, p, 3)
        variables = np.concatenate([self.t.ravel(), self.c])
        force = np.hstack([np.moveaxis(forces.generators, 0, 1).reshape(3, -1), np.zeros((3, 2))])
        row = self.prog.AddLinearEqualityConstraint(force, -pull - forces.offset.sum(axis=0), variables)
        row.evaluator().set_description("force balance")
        torque = np.hstack([turns.reshape(-1, 3).T, np.cross(basis, pull).T])
        row = self.prog.AddLinearEqualityConstraint(torque, -np.cross(arms, forces.offset).sum(axis=0), variables)
        row.evaluator().set_description("torque balance")
        for i in range(k):
            limits = forces[i : i + 1].limits()
            if len(limits.g):
                most = self.prog.AddLinearConstraint(limits.R, np.full(len(limits.g), -np.inf), limits.g, self.t[i])
                most.evaluator().set_description(f"force limits of contact {i}")
            for C, d, name in zip(limits.C, limits.d, ("least", "greatest"), strict=False):
                cone = self.prog.AddLorentzConeConstraint(-C, d, self.t[i])
                cone.evaluator().set_description(f"friction cone of contact {i}, {name} force")

    def solve(self, direction: Vector) -> Vector | None:
        """The place farthest in a direction, or None if there is none [m]; both along e_1 and e_2, shape (2,)."""
        cost = self.prog.AddLinearCost(-np.asarray(direction, dtype=float), 0.0, self.c)
        options = SolverOptions()
        for name in ("tol_feas", "tol_gap_abs", "tol_gap_rel"):
            options.SetOption(ClarabelSolver.id(), name, 1e-10)
        result = ClarabelSolver().Solve(self.prog, None, options)
        self.prog.RemoveCost(cost)
        return self.origin + result.GetSolution(self.c) if result.is_success() else None


class ShortfallProgram:
    """The least force that the contacts lack to carry the weight.

        min         |(0, m g) - sum_i (o_i + G_i t_i)|^2
        over        t_1, ..., t_k
        subject to  lower_i <= t_i <= upper_i

    The forces the contacts can make together are a convex set, so the gap to its nearest point is the normal of a
    plane that separates the weight from all of them. Along that normal the shortfall is then evaluated in closed form,
    so that direction and shortfall prove infeasibility whatever the solver's rounding.
    """

    def __init__(self, forces: ContactForces, weight: float) -> None:
        """Builds the program; arguments as for `SupportProgram`."""
        self._forces = forces
        self._directions = np.moveaxis(forces.generators, 0, 1).reshape(3, -1)  # (3, k p)
        self._load = np.array([0.0, weight, 0.0]) - forces.offset.sum(axis=0)
        self.prog = MathematicalProgram()
        self.t = self.prog.NewContinuousVariables(self._directions.shape[1], "t")
        if len(self.t):
            limits = self.prog.AddBoundingBoxConstraint(forces.lower.ravel(), forces.upper.ravel(), self.t)
            limits.evaluator().set_description("force limits")
            gap = self.prog.Add2NormSquaredCost(self._directions, self._load, self.t)
            gap.evaluator().set_description("force that is lacking, squared")

    def solve(self) -> tuple[Vector, float] | None:
        """The unit direction in W, shape (3,), and the shortfall along it [N]; None when the load can be carried."""
        gap = self._load
        if len(self.t):
            gap = self._load - self._directions @ ClarabelSolver().Solve(self.prog).GetSolution(self.t)
        direction = gap / max(float(np.linalg.norm(gap)), 1e-300)
        along = direction @ self._directions  # per generator
        most = np.maximum(along * self._forces.lower.ravel(), along * self._forces.upper.ravel()).sum()
        shortfall = float(direction @ self._load - most)
        return (direction, shortfall) if shortfall > 0.0 else None


def _cross(arm: Vector, force: Vector) -> Vector:
    """The z component of arm x force; vectors along the first axis."""
    result: Vector = arm[0] * force[1] - arm[1] * force[0]
    return result
