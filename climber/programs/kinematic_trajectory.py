"""The same curve as in `climber.programs.trajectory`, by Drake's `KinematicTrajectoryOptimization` in all positions.

It plans no motions; `climber.programs.trajectory` says why. It is kept as a check by other means: it shares neither
variables nor derivatives nor solver with the program that does, and where no two links come near each other it finds
the same curve.
"""

from __future__ import annotations

import numpy as np
from pydrake.multibody.inverse_kinematics import ComPositionConstraint, PositionConstraint
from pydrake.planning import KinematicTrajectoryOptimization
from pydrake.solvers import SnoptSolver, SolverOptions
from scipy.interpolate import BSpline

from climber.curve import DEGREE, Curve, clamped_knots, greville
from climber.manifold import AnyChart, Manifold
from climber.stance import Vector


class KinematicTrajectoryProgram:
    """A B-spline of all positions that keeps the contacts at samples.

    With q(s) = sum_j B_j(s) q_j, s in [0, 1], and otherwise the letters of `PostureProgram`:

        min over q_0 ... q_{N-1}   mean_f |q'(s_f)|^2 + w |q''(s_f)|^2                              (1)
        s.t.  q(0) and q(1) given                                                                   (2)
              p_WF_i(q(s_k)) = p_WC_i        for each holding limb i, at K inner samples s_k        (3)
              c_x_lower <= c_x(q(s_k)) <= c_x_upper                                                 (4)
              q_lower + m <= q_j <= q_upper - m       for the joints of every control point         (5)
              e_i_near <= e_ij <= e_i_far    for the last joint of every limb that the chart solves for, likewise  (6)

    (1) is the objective of `ChartProgram`, over a fine grid s_f. A B-spline stays in the hull of its control points,
    so (5) and (6) hold everywhere, and ask for a little more than they must. Contacts hold at the samples only. For a
    planar robot with n_c contacts, (2) and (3) are 2 nq + 2 n_c K equations in nq N unknowns; N must leave some
    freedom.

    Links may touch in a solution: constraints on distances cost several times all the rest, so the caller must check.

    The program owns the context it evaluates kinematics in; do not share one between threads.

    Attributes:
        prog: The `MathematicalProgram`.
        control: Its variables, the control points, shape (nq, N).
    """

    def __init__(
        self,
        manifold: Manifold,
        chart: AnyChart,
        ends: tuple[Vector, Vector],
        num_control: int = 12,
        samples: int = 10,
        smoothing: float = 0.01,
        degree: int = DEGREE,
    ) -> None:
        """Builds the program.

        Args:
            manifold: What makes a configuration feasible.
            chart: The chart that the result is wanted in; its limbs stay on its branches.
            ends: First and last configuration, shape (nq,) each.
            num_control: N.
            samples: K.
            smoothing: w.
            degree: Of the B-spline.
        """
        plant = manifold.body.robot.plant
        self.manifold, self.chart, self.degree = manifold, chart, degree
        self._context = plant.CreateDefaultContext()
        self._optimization = KinematicTrajectoryOptimization(plant.num_positions(), num_control, degree + 1, 1.0)
        self.prog = self._optimization.get_mutable_prog()
        self.control = self._optimization.control_points()
        self._optimization.AddDurationConstraint(1.0, 1.0).evaluator().set_description("unit duration")
        self.prog.SetInitialGuess(self._optimization.duration(), 1.0)
        knots = clamped_knots(num_control, degree)
        self._inner = np.linspace(0.0, 1.0, samples + 2)[1:-1]
        self._add_cost(BSpline(knots, np.eye(num_control), degree), smoothing)
        for s, q in zip((0.0, 1.0), ends, strict=True):
            self._optimization.AddPathPositionConstraint(q, q, s).evaluator().set_description(f"positions at s={s:.0f}")
        self._add_bounds(ends)
        self._add_contacts()
        self._copies = self._add_balance(BSpline.design_matrix(self._inner, knots, degree).toarray())
        self._solver, self._options = SnoptSolver(), SolverOptions()
        self._options.SetOption(SnoptSolver.id(), "Major optimality tolerance", 2e-4)
        self._options.SetOption(SnoptSolver.id(), "Major iterations limit", 200)

    def _add_cost(self, basis: BSpline, smoothing: float) -> None:
        fine = np.linspace(0.0, 1.0, 4 * self.control.shape[1])
        rows = np.concatenate([basis.derivative(1)(fine), np.sqrt(smoothing) * basis.derivative(2)(fine)])
        rows /= np.sqrt(len(fine))
        names = self.manifold.body.robot.position_names
        for name, variables in zip(names, self.control, strict=True):
            cost = self.prog.Add2NormSquaredCost(rows, np.zeros(len(rows)), variables)
            cost.evaluator().set_description(f"length and bending of {name}")

    def _add_bounds(self, ends: tuple[Vector, Vector]) -> None:
        body, margins = self.manifold.body, self.manifold.margins
        lower, upper = np.full(self.control.shape[0], -np.inf), np.full(self.control.shape[0], np.inf)
        for i, limb in enumerate(body.robot.limbs):
            lower[limb.q], upper[limb.q] = limb.lower + margins.joint, limb.upper - margins.joint
            if i in self.chart.points and i != self.chart.root:
                inverse = body.inverse[i]
                assert inverse is not None  # as a chart solves for the limb
                joint, near, far = inverse.bend(self.chart.branches[i], margins.reach)
                elbow = limb.q[joint]
                lower[elbow], upper[elbow] = max(lower[elbow], near), min(upper[elbow], far)
        # Rounding must not put the given ends a hair outside.
        lower, upper = np.minimum(lower, np.min(ends, axis=0)), np.maximum(upper, np.max(ends, axis=0))
        for j, bound in enumerate(self._optimization.AddPositionBounds(lower, upper)):
            bound.evaluator().set_description(f"joint limits and bends at control point {j}")

    def _add_contacts(self) -> None:
        robot = self.manifold.body.robot
        free = np.array([0.0, 0.0, np.inf if robot.planar else 0.0])
        for i, point in sorted(self.chart.points.items()):
            foot = robot.plant.GetFrameByName(robot.limbs[i].foot)
            contact = PositionConstraint(
                robot.plant, robot.plant.world_frame(), point - free, point + free, foot, np.zeros(3), self._context
            )
            for s in self._inner:
                self._optimization.AddPathPositionConstraint(contact, s).evaluator().set_description(
                    f"foot of {robot.limbs[i].name} on its hold"
                )

    def _add_balance(self, basis: Vector) -> list[tuple[Vector, Vector]]:
        """Adds (4). Drake's constraint wants q and c as variables, so each sample gets its own; returns these."""
        plant = self.manifold.body.robot.plant
        relation = ComPositionConstraint(plant, None, plant.world_frame(), self._context)
        copies, balanced = [], self.manifold.balanced.ends
        for s, row in zip(self._inner, basis, strict=True):
            q, c = self.prog.NewContinuousVariables(len(self.control), "q"), self.prog.NewContinuousVariables(3, "c")
            used = np.flatnonzero(row)
            for k, variables in enumerate(self.control):
                self.prog.AddLinearEqualityConstraint(
                    np.append(row[used], -1.0)[None], np.zeros(1), np.append(variables[used], q[k])
                ).evaluator().set_description(f"positions at s={s:.3f}")
            self.prog.AddConstraint(relation, np.append(q, c)).evaluator().set_description("centre of mass")
            if len(balanced.b):
                inside = self.prog.AddLinearConstraint(balanced.A, np.full(len(balanced.b), -np.inf), balanced.b, c)
                inside.evaluator().set_description(f"centre of mass in the support at s={s:.3f}")
            copies.append((q, c))
        return copies

    def solve(self, guess: Curve) -> Curve | tuple[str, ...]:
        """Solves from a curve in the program's chart.

        Returns:
            The answer in the chart, whose contacts are exact, or, if SNOPT finds none, descriptions of what is
            violated.
        """
        self.prog.SetInitialGuess(self.control, guess.q(greville(self.control.shape[1], self.degree)).T)
        here = guess.q(self._inner)
        centers = self.manifold.body.kinematics.center_of_mass(here)
        for (q, c), value, center in zip(self._copies, here, centers, strict=True):
            self.prog.SetInitialGuess(q, value)
            self.prog.SetInitialGuess(c, center)
        result = self._solver.Solve(self.prog, None, self._options)
        if not result.is_success():
            return tuple(result.GetInfeasibleConstraintNames(self.prog)) or ("optimality: SNOPT stopped early",)
        # The chart's coordinates are some of the positions, so their control points are some rows of the answer.
        control = self.chart.coordinates(result.GetSolution(self.control).T)
        control[0], control[-1] = guess.control[0], guess.control[-1]
        return Curve(self.chart, control, self.degree)
