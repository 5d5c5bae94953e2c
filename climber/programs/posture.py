"""A posture on given contacts that is as near as it can be to postures before and after it.

Sampling finds transition postures that are feasible but arbitrary; a path between arbitrary postures is long. Here
each is pulled towards its neighbours by Drake's `InverseKinematics`. Distances between links are left out of the
program, where they would cost more than everything else together, and what it returns is checked afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.inverse_kinematics import ComPositionConstraint, InverseKinematics
from pydrake.solvers import SnoptSolver, SolverOptions

from climber.manifold import Body, Manifold
from climber.stance import Vector

Target = tuple[float, Vector]  # weight, configuration of shape (nq,)
STEPS = 16  # how many places are tried on the way from the guess to the program's answer


@dataclass(frozen=True)
class PostureSolution:
    """What the solver says.

    Attributes:
        q: The configuration it ended at, shape (nq,); it means something only if nothing is violated.
        cost: The objective there [m^2 or rad^2].
        violated: Descriptions of the constraints that do not hold there; empty if a posture was found.
    """

    q: Vector
    cost: float
    violated: tuple[str, ...]


def distance(q: Vector, targets: Sequence[Target]) -> Vector:
    """Weighted squared distance of configurations `q`, shape (K, nq), to the targets; shape (K,)."""
    result: Vector = np.zeros(len(q))
    for weight, target in targets:
        result += weight * ((q - target) ** 2).sum(axis=1)
    return result


class PostureProgram:
    """The posture on one set of contacts that is nearest to some targets.

    With q the positions of the plant [m, rad], p_WF_i(q) the foot of limb i and p_WC_i its contact [m], c(q) the
    centre of mass [m], q_i the joints of limb i and e_i the one that bends [rad], and (w_k, q_k) the
    targets:

        min   sum_k w_k |q - q_k|^2                                                     (1)
        s.t.  p_WF_i(q) = p_WC_i                for each holding limb i                 (2)
              q_i_lower + m <= q_i <= q_i_upper - m         for each limb i             (3)
              e_i_near <= e_i <= e_i_far        for each holding limb i                 (4)
              A c(q) <= b                                                               (5)

    (2) is Gönen 2021's closed-chain condition, for a planar robot in x and y only. (4) keeps a limb on its branch and
    within reach, away from where it is straight and joint rates grow without bound; a limb without inverse kinematics
    has neither. (5) is the support, an interval in the plane and a polygon in space.
    Links may touch each other or an obstacle in a solution: `improve_posture` rejects that.

    The program owns the context it evaluates kinematics in; do not share one between threads.

    Attributes:
        prog: The `MathematicalProgram`.
        q: Its variables, shape (nq,).
    """

    def __init__(self, body: Body, manifold: Manifold, branches: Sequence[int]) -> None:
        """Builds the program.

        Args:
            body: The robot.
            manifold: The contacts, the support and the margins.
            branches: The branch of each limb; those of limbs in the air are not used.
        """
        robot, margins = body.robot, manifold.margins
        self._ik = InverseKinematics(robot.plant, with_joint_limits=False)
        self.prog, self.q = self._ik.get_mutable_prog(), self._ik.q()
        world = robot.plant.world_frame()
        unconstrained = np.array([0.0, 0.0, np.inf if robot.planar else 0.0])
        for i, limb in enumerate(robot.limbs):
            lower, upper = limb.lower + margins.joint, limb.upper - margins.joint
            self.prog.AddBoundingBoxConstraint(lower, upper, self.q[limb.q]).evaluator().set_description(
                f"joint limits of {limb.name}"
            )
            if i not in manifold.points:
                continue
            point = manifold.points[i]
            foot = robot.plant.GetFrameByName(limb.foot)
            contact = self._ik.AddPositionConstraint(
                foot, np.zeros(3), world, point - unconstrained, point + unconstrained
            )
            contact.evaluator().set_description(f"foot of {limb.name} on its hold")
            inverse = body.inverse[i]
            if inverse is None:
                continue
            joint, near, far = inverse.bend(branches[i], margins.reach)
            self.prog.AddBoundingBoxConstraint(near, far, self.q[limb.q[joint]]).evaluator().set_description(
                f"bend of {limb.name}"
            )
        center = self.prog.NewContinuousVariables(3, "c")
        bind = self.prog.AddConstraint(
            ComPositionConstraint(robot.plant, None, world, self._ik.get_mutable_context()),
            np.concatenate([self.q, center]),
        )
        bind.evaluator().set_description("centre of mass of the configuration")
        balanced = manifold.balanced.ends
        if len(balanced.b):
            inside = self.prog.AddLinearConstraint(balanced.A, np.full(len(balanced.b), -np.inf), balanced.b, center)
            inside.evaluator().set_description("centre of mass in the support")
        self._center, self._kinematics = center, body.kinematics
        nq = len(self.q)
        self._cost = self.prog.AddQuadraticCost(np.eye(nq), np.zeros(nq), 0.0, self.q, is_convex=True).evaluator()
        self._cost.set_description("distance to the targets")
        self._solver, self._options = SnoptSolver(), SolverOptions()
        self._options.SetOption(SnoptSolver.id(), "Major optimality tolerance", 1e-4)
        self._options.SetOption(SnoptSolver.id(), "Major iterations limit", 60)

    def solve(self, guess: Vector, targets: Sequence[Target]) -> PostureSolution:
        """Solves from the configuration `guess`, shape (nq,), for the targets, at least one of positive weight."""
        nq = len(self.q)
        total = sum(weight for weight, _ in targets)
        pull: Vector = np.zeros(nq)
        constant = 0.0
        for weight, target in targets:
            pull += weight * target
            constant += weight * float(target @ target)
        self._cost.UpdateCoefficients(2 * total * np.eye(nq), -2 * pull, constant, is_convex=True)
        self.prog.SetInitialGuess(self.q, guess)
        self.prog.SetInitialGuess(self._center, self._kinematics.center_of_mass(guess[None])[0])
        result = self._solver.Solve(self.prog, None, self._options)
        q: Vector = result.GetSolution(self.q)
        names = () if result.is_success() else tuple(result.GetInfeasibleConstraintNames(self.prog, 1e-6))
        if not result.is_success() and not names:
            names = ("optimality: SNOPT stopped early",)
        return PostureSolution(q, float(distance(q[None], targets)[0]), names)


def improve_posture(
    body: Body,
    manifold: Manifold,
    guess: Vector,
    targets: Sequence[Target],
    program: PostureProgram | None = None,
) -> Vector | None:
    """Moves a posture nearer to some targets.

    Args:
        body: The robot.
        manifold: What makes a posture feasible.
        guess: A configuration that keeps the contacts, shape (nq,).
        targets: Weights and configurations to be near to.
        program: The program for these contacts and the branches of `guess`, to save building it.

    Returns:
        A configuration of the same branches, feasible, with contacts kept to machine precision, and strictly nearer
        to the targets than the guess is; None if none was found.
    """
    if manifold.rigid:
        return None  # there is nothing to choose
    chart = manifold.chart(guess)
    program = program or PostureProgram(body, manifold, chart.branches)
    answer = program.solve(guess, targets).q
    if not np.isfinite(answer).all():
        return None
    # Even where the solver gave up, or its answer touches something, part of the way there may do.
    start = chart.coordinates(guess)
    part = np.linspace(1.0, 0.0, STEPS, endpoint=False)[:, None]
    q, reach = chart.expand(start + part * (chart.coordinates(answer) - start))
    cost, before = distance(q, targets), float(distance(guess[None], targets)[0])
    better = (reach >= manifold.margins.reach) & (cost < before * (1 - 1e-9))
    q, cost = q[better], cost[better]
    if not better.any():
        return None
    cost[manifold.slack(q) < 0] = np.inf
    best = int(np.argmin(cost))
    found: Vector | None = q[best] if np.isfinite(cost[best]) else None
    return found
