"""Can the holds and the motors make this motion? Contact forces in their cones, torques within their limits.

Inverse dynamics (`climber.dynamics`) gives torques as if holds could push and pull at will. Here the contact forces are
those that holds can really give, and the torques those that the motors can.

`TorqueProgram` is the reference, one `MathematicalProgram` for one instant. `phase_torques` answers the same question
for all samples of a phase at once and agrees with it; `static_feasible` sifts postures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import Binding, ClarabelSolver, MathematicalProgram, SolverOptions

from climber.dynamics import DynamicsBatch, evaluate_at_rest, turning
from climber.programs import torque_blocks
from climber.programs.carried import Precedents, can_carry
from climber.programs.forces import ContactForces, ForceLimits, wall_forces
from climber.programs.instants import Instants, Margin, Mask
from climber.robot import Robot
from climber.stance import Contact, Vector
from climber.wall import Wall

Reason = Literal["", "torque limit", "friction cone", "force balance"]
REASONS: tuple[Reason, ...] = ("", "torque limit", "friction cone", "force balance")  # ever graver
TOLERANCE = torque_blocks.TOLERANCE
MARGIN = Margin()
# Share of its weight by which forces stay inside their limits where a robot with weak motors stands still. Where motors
# are strong, a centre of mass inside its support leaves forces such room; weak ones cut into what it leaves.
ROOM = 0.0075


@dataclass(frozen=True)
class TorqueResult:
    """Forces and torques that make the motion at one instant, or those that come near it and what is missing.

    Attributes:
        force: Forces of the contacts on the robot in W [N], shape (k, 3).
        torque: Torques in the order of `Robot.joint_names` [N m], shape (num_joints,).
        reason: "" if the motion can be made, else the first of these that cannot be met, whatever the rest:
            "force balance": no contact forces, of any size, balance the robot;
            "friction cone": those that do leave the limits of the contacts;
            "torque limit": those that do and stay inside need more torque than there is.
        violation: By how much at least: the imbalance [N, N m], the distance of t from its limits [N], or the torque
            lacking [N m]. Zero if the motion can be made. Limits are those with the margin.
        moment: Moments of the contacts on the robot about z [N m], shape (k,); zero unless a gripper turns its pin.
    """

    force: Vector
    torque: Vector
    reason: Reason
    violation: float
    moment: Vector

    @property
    def ok(self) -> bool:
        """The motion can be made."""
        return self.reason == ""


@dataclass(frozen=True)
class TorqueBatch:
    """`TorqueResult` for K samples.

    Attributes:
        force: Forces of the contacts on the robot in W [N], shape (K, k, 3).
        torque: Torques in the order of `Robot.joint_names` [N m], shape (K, num_joints).
        violation: By how much the motion cannot be made, in the unit that goes with the reason, zero if it can; (K,).
        codes: Place of each sample's reason in `REASONS`, shape (K,).
        moment: Moments of the contacts on the robot about z [N m], shape (K, k).
    """

    force: Vector
    torque: Vector
    violation: Vector
    codes: NDArray[np.int64]
    moment: Vector

    @cached_property
    def ok(self) -> Mask:
        """Which samples of the motion can be made, shape (K,)."""
        return np.asarray(self.codes == 0)

    @property
    def worst(self) -> int:
        """The sample with the gravest reason, and of those the one with the greatest violation."""
        return int(np.lexsort((self.violation, self.codes))[-1])

    @property
    def reason(self) -> Reason:
        """The reason of the worst sample; "" if the whole motion can be made."""
        return REASONS[int(self.codes.max(initial=0))]

    def __getitem__(self, k: int) -> TorqueResult:
        """Sample k."""
        reason, violation = REASONS[self.codes[k]], float(self.violation[k])
        return TorqueResult(self.force[k], self.torque[k], reason, violation, self.moment[k])


class TorqueProgram:
    """Contact forces and torques at one instant of a motion.

    Given the state q, v, the acceleration vd, and contacts i = 1..k with forces f_i = o_i + G_i t_i [N] and Jacobians
    J_i, find forces and torques tau [N m] that satisfy the equations of motion (Gönen 2021, 4.24) within all limits:

        min         sum_j (tau_j / tau_max_j)^2 + w sum_i |(t_i - aim_i) / half_range_i|^2    (2 w for u and s)
        over        t_1, ..., t_k, tau, s_f, s_tau
        subject to  (1) sum_i J_i^T f_i = M vd + h           in the rows without a motor (the pelvis)
                    (2) tau + sum_i J_i^T f_i = M vd + h     in the rows with one
                    (3) lower_i - s_f <= t_i <= upper_i + s_f, or in space, with t_i = (u, s),
                        |u| <= s - lower_i + s_f,  |u| <= upper_i + s_f - s
                    (4) |tau_j| <= limit_j + s_tau
                    (5) s_f = s_tau = 0

    The objective keeps torques small and forces away from the borders of their cones; it is strictly convex, so forces
    and torques are unique and vary continuously along a motion. Limits in (3) and (4) are tighter than the true ones by
    a margin. If there is no solution, (5) is relaxed to find what is missing: first the least s_f >= 0 without (4),
    then, if that is zero, the least s_tau >= 0 with s_f = 0.

    Attributes:
        prog: The program, constraints named; (5) and the objective are added at `solve`.
        t: Its variables t [N], shape (n,).
        tau: Its variables tau [N m], of the joints with a motor, shape (j,).
        s_f: Its slack of the force limits [N].
        s_tau: Its slack of the torque limits [N m].
    """

    def __init__(self, instant: Instants) -> None:
        """Builds the program of `instant`, which must be a single one."""
        self._instant = instant
        (E,), (b,), (A,), (c,) = instant.E, instant.b, instant.A, instant.c
        self.prog = MathematicalProgram()
        self.t = self.prog.NewContinuousVariables(E.shape[1], "t")
        self.tau = self.prog.NewContinuousVariables(len(c), "tau")
        self.s_f, self.s_tau = self.prog.NewContinuousVariables(2, "s")

        if len(self.t):
            balance = self.prog.AddLinearEqualityConstraint(E, b, self.t)
            balance.evaluator().set_description("balance in the rows without a motor")
        torques = self.prog.AddLinearEqualityConstraint(
            np.hstack([np.eye(len(c)), A]), c, np.concatenate([self.tau, self.t])
        )
        torques.evaluator().set_description("torques")
        k, p = instant.forces.lower.shape
        for i in range(k):
            mine = slice(i * p, (i + 1) * p)
            if instant.forces.round is not None and instant.forces.round[i]:
                self._cones(i, self.t[mine], instant.forces[i : i + 1].limits(instant.lower[mine], instant.upper[mine]))
            else:
                self._limit(f"force of contact {i}", self.t[mine], self.s_f, instant.lower[mine], instant.upper[mine])
        for j in np.flatnonzero(np.isfinite(instant.limit)):
            limit = instant.limit[j : j + 1]
            self._limit(f"torque of joint {instant.motors[j]}", self.tau[j : j + 1], self.s_tau, -limit, limit)

    def _limit(self, name: str, x: Vector, slack: object, lower: Vector, upper: Vector) -> None:
        """Adds lower - slack <= x <= upper + slack."""
        rows = np.hstack([np.eye(len(x)), np.ones((len(x), 1))])
        variables, infinity = np.append(x, [slack]), np.full(len(x), np.inf)
        least = self.prog.AddLinearConstraint(rows, lower, infinity, variables)
        least.evaluator().set_description(f"least {name}")
        rows[:, -1] = -1.0
        greatest = self.prog.AddLinearConstraint(rows, -infinity, upper, variables)
        greatest.evaluator().set_description(f"greatest {name}")

    def _cones(self, i: int, t: Vector, limits: ForceLimits) -> None:
        """Adds the friction cones of contact i, or the pyramids that stand for them, the apexes moved by s_f."""
        variables = np.append(t, [self.s_f])
        if len(limits.g):
            rows = np.hstack([limits.R, np.full((len(limits.g), 1), -1.0)])
            row = self.prog.AddLinearConstraint(rows, np.full(len(limits.g), -np.inf), limits.g, variables)
            row.evaluator().set_description(f"linear limits of contact {i}")
        for C, d, name in zip(limits.C, limits.d, ("least", "greatest"), strict=False):
            rows = np.hstack([-C, np.array([[1.0], [0.0], [0.0]])])
            cone = self.prog.AddLorentzConeConstraint(rows, d, variables)
            cone.evaluator().set_description(f"friction cone of contact {i}, {name} force")

    def solve(self) -> TorqueResult:
        """Forces and torques that make the motion, or what cannot be met and by how much."""
        t = self._instant.balanced(np.zeros((1, len(self.t))))
        imbalance = float(self._instant.imbalance(t)[0])
        if imbalance > TOLERANCE:
            return self._result(t, "force balance", imbalance)
        aim, stiffness, effort = self._instant.scales
        weights = 2.0 * np.concatenate([stiffness, 1.0 / effort**2])
        slope = np.concatenate([-2.0 * stiffness * aim, np.zeros(len(effort))])
        smooth = self.prog.AddQuadraticCost(np.diag(weights), slope, np.concatenate([self.t, self.tau]))
        best = self._minimize(smooth, most_s_f=0.0, most_s_tau=0.0)
        if best is not None:
            return self._result(best[0], "", 0.0)
        t, s_f = self._least(self.s_f, most_s_f=np.inf)
        if s_f > TOLERANCE:
            return self._result(t, "friction cone", s_f)
        t, s_tau = self._least(self.s_tau, most_s_f=TOLERANCE)
        if s_tau > TOLERANCE:
            return self._result(t, "torque limit", s_tau)
        return self._result(t, "", 0.0)  # there is no room to choose in, and Clarabel saw none

    def _least(self, slack: object, most_s_f: float) -> tuple[Vector, float]:
        best = self._minimize(self.prog.AddLinearCost(slack), most_s_f, most_s_tau=np.inf)
        if best is None:
            raise RuntimeError("Clarabel finds no forces that balance the robot although there are some")
        return best

    def _minimize(self, cost: Binding, most_s_f: float, most_s_tau: float) -> tuple[Vector, float] | None:
        """The best t, shape (1, n), and its cost, with slacks of at most what is given; None if infeasible."""
        slack = self.prog.AddBoundingBoxConstraint([0.0, 0.0], [most_s_f, most_s_tau], [self.s_f, self.s_tau])
        slack.evaluator().set_description("slack")
        options = SolverOptions()
        for name in ("tol_feas", "tol_gap_abs", "tol_gap_rel"):
            options.SetOption(ClarabelSolver.id(), name, 1e-10)
        result = ClarabelSolver().Solve(self.prog, None, options)
        self.prog.RemoveConstraint(slack)
        self.prog.RemoveCost(cost)
        return (result.GetSolution(self.t)[None], result.get_optimal_cost()) if result.is_success() else None

    def _result(self, t: Vector, reason: Reason, violation: float) -> TorqueResult:
        t = self._instant.balanced(t)
        instant = self._instant
        return TorqueResult(instant.force(t)[0], instant.torque(t)[0], reason, violation, instant.moment(t)[0])


def phase_torques(
    robot: Robot,
    wall: Wall,
    contacts: Sequence[Contact],
    dynamics: DynamicsBatch,
    vd: Vector,
    margin: Margin = MARGIN,
) -> TorqueBatch:
    """Contact forces and torques all along a motion on fixed contacts: `TorqueProgram` at each sample.

    Args:
        robot: The robot.
        wall: The wall.
        contacts: The limbs that hold and their holds.
        dynamics: The equations of motion at K samples, with the feet of `contacts` holding in that order.
        vd: Accelerations [m/s^2, rad/s^2], shape (K, nv).
        margin: How far to stay inside the limits.
    """
    turns = turning(robot, [contact.limb for contact in contacts])
    load = dynamics.load(vd)
    return solve_instants(Instants.of_loads(robot, _forces(robot, wall, contacts), load, dynamics.J, margin, turns))


def solve_instants(instants: Instants) -> TorqueBatch:
    """`TorqueProgram` of each of the instants."""
    unlimited = torque_blocks.unlimited(instants)
    t, codes, violation = unlimited.copy(), np.zeros(len(instants), dtype=int), np.zeros(len(instants))
    imbalance = instants.imbalance(t)
    lost = imbalance > TOLERANCE
    codes[lost], violation[lost] = REASONS.index("force balance"), imbalance[lost]
    # Where the optimum without limits is inside them, it is the optimum.
    rest = np.flatnonzero(~lost & ~instants.inside(t))
    optimum = torque_blocks.optimum(instants[rest], unlimited[rest])
    if optimum is not None:
        t[rest] = optimum
        return TorqueBatch(instants.force(t), instants.torque(t), violation, codes, instants.moment(t))
    # At least one sample is infeasible, or nearly. Which? The optimum of the others is found without them.
    t[rest], slack, *_ = torque_blocks.least_violation(instants[rest])
    roomy, infeasible = rest[slack < -TOLERANCE], rest[slack > TOLERANCE]
    optimum = torque_blocks.optimum(instants[roomy], unlimited[roomy])
    if optimum is not None:  # samples without an optimum keep the forces farthest inside their limits
        t[roomy] = optimum
    # And why?
    t[infeasible], s_f = torque_blocks.least_cone_violation(instants[infeasible])
    fail = s_f > TOLERANCE
    codes[infeasible[fail]], violation[infeasible[fail]] = REASONS.index("friction cone"), s_f[fail]
    infeasible = infeasible[~fail]
    t[infeasible], s_tau = torque_blocks.least_torque_violation(instants[infeasible])
    fail = s_tau > TOLERANCE
    codes[infeasible[fail]], violation[infeasible[fail]] = REASONS.index("torque limit"), s_tau[fail]
    t = instants.balanced(t)
    return TorqueBatch(instants.force(t), instants.torque(t), violation, codes, instants.moment(t))


def static_feasible(
    robot: Robot,
    wall: Wall,
    q: Vector,
    contacts: Sequence[Contact],
    margin: Margin | None = None,
    precedents: Precedents | None = None,
) -> Mask:
    """Which of the postures q, shape (K, nq), can be held still by the contacts and the motors, shape (K,).

    Args:
        robot: The robot.
        wall: The wall.
        q: The postures.
        contacts: The limbs that hold and their holds.
        margin: How far inside the limits; by default so far that a controller has something to correct with.
        precedents: What is known from other postures with the same limbs in contact; grows.
    """
    margin = margin or (Margin(force=ROOM * robot.weight) if robot.weak else MARGIN)
    limbs = [contact.limb for contact in contacts]
    h, J = evaluate_at_rest(robot, q, limbs)
    instants = Instants.of_loads(robot, _forces(robot, wall, contacts), h, J, margin, turning(robot, limbs))
    return can_carry(instants, precedents)


def _forces(robot: Robot, wall: Wall, contacts: Sequence[Contact]) -> ContactForces:
    """The forces of the contacts, leading shape (k,)."""
    return wall_forces(wall, robot.dimension)[np.array([contact.hold for contact in contacts], dtype=int)]
