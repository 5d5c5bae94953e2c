"""Shorter, smoother curves on a stance's manifold.

`refine` turns the polyline of a path search into a curve that is feasible, short and smooth. Of two programs that do so
it uses `ChartProgram`, a B-spline in the chart's coordinates, rather than Drake's `KinematicTrajectoryOptimization` in
all positions (`climber.programs.kinematic_trajectory`). On 240 legs of random climbs of the scenarios basic and higher
(benchmarks/bench_refine.py --legs 60 --seed 1; medians of processor time on an AMD EPYC):

    program                                  straight legs   legs with corners   feasible    length, near and far
    ChartProgram, with rounding and checks     17 to 25 ms         33 to 52 ms  240 of 240   0.99, 0.95 to 0.55
    KinematicTrajectoryOptimization          195 to 245 ms       204 to 320 ms  233 of 240   the same to 1 %
    the same with cubic splines              119 to 138 ms       125 to 200 ms  231 of 240   the same to 1 %

Both stop at the same curves, so the difference is in the cost and in what is guaranteed. Drake's program solves for all
positions and must be told of the contacts, which it then keeps at samples only (up to 0.3 mm off between; projecting to
the chart mends that); it cannot afford distances between links, so that legs with little room come out infeasible.
In the chart there are a third to a half as many unknowns, contacts hold exactly, and distances cost little.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import clarabel
import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csc_matrix

from climber.curve import DEGREE, RESOLUTION, Curve, clamped_knots, polyline_lengths, rounded, smooth
from climber.manifold import AnyChart, Manifold, Margins
from climber.programs.conditions import Conditions
from climber.stance import Vector

__all__ = ["ChartProgram", "Curve", "Solution", "Subproblem", "minimise", "refine", "smooth"]

NUM_CONTROL = 12  # control points, unless the guess needs more to be feasible
SMOOTHING = 0.01  # weight of bending against length
SAMPLES = 27  # intervals between samples, at least
WATCH = 0.04  # [m] shapes farther apart than this are not looked at in one step
ENOUGH = 1e-3  # a step that promises to lower the cost by less than this share is not taken
SETTLED = 0.03  # after a step that lowered it by less than this share there is no other
LARGEST_STEP = 1.0  # [rad] of the trust region


@dataclass(frozen=True)
class Subproblem:
    """A convex quadratic program in the change x of the inner control points: min x'Px/2 + c'x s.t. Ax <= b.

    Attributes:
        P: Shape (size, size), size being inner control points times coordinates, a control point's together.
        c: Shape (size,).
        A: Shape (rows, size).
        b: Shape (rows,).
        names: What each row is about; the trust region's rows come last and have none.
    """

    P: Vector
    c: Vector
    A: Vector
    b: Vector
    names: tuple[str, ...]


@dataclass(frozen=True)
class Solution:
    """What sequential quadratic programming made of a curve.

    Attributes:
        curve: The curve.
        cost: Its objective [rad^2].
        before: The objective it began with [rad^2].
        iterations: Subproblems solved.
        binding: The conditions that keep the cost from being lower, as of the last subproblem.
    """

    curve: Curve
    cost: float
    before: float
    iterations: int
    binding: tuple[str, ...]


class ChartProgram:
    """The smoothest short curve between two points of a chart.

    With u(s) = sum_j B_j(s) u_j the clamped B-spline of N control points in the chart's coordinates, q(u) the
    configuration [m, rad], g(u) the conditions of `Conditions` [m, rad], and samples s_0 = 0 < ... < s_S = 1 that are
    ds apart:

        min over u_1 ... u_{N-2}   sum_i |q_{i+1} - q_i|^2 / ds
                                   + w sum_i |q_{i+1} - 2 q_i + q_{i-1}|^2 / ds^3                   (1)
        s.t.  g(u(s_i)) >= 0   for 0 < i < S                                                        (2)

    (1) discretises int |q'|^2 + w |q''|^2 ds. The first part is least, and is the squared length, where the curve is
    shortest and run through at constant pace; the second rounds corners. The ends u_0 and u_{N-1} are given. Contacts
    need no constraint: the chart keeps them everywhere. (2) says nothing between samples, so `solve` keeps an iterate
    only if it is feasible on a finer grid.

    Solved by sequential quadratic programming with Gauss-Newton Hessians in a trust region. With r(u) the stacked
    residuals of (1), J their Jacobian and G_k the gradient of condition k,

        min over x   |r + J x|^2   s.t.  g_k + G_k x >= min(g_k, backoff),   |x_jc| <= radius / scale_c       (3)

    x = 0 satisfies (3), so it always has a solution. Clarabel is handed its matrices.
    """

    def __init__(
        self, manifold: Manifold, chart: AnyChart, num_control: int = NUM_CONTROL, smoothing: float = SMOOTHING
    ) -> None:
        self.manifold, self.chart, self.num_control = manifold, chart, num_control
        self.conditions = Conditions(manifold, chart)
        count = max(SAMPLES, 2 * (num_control - DEGREE))
        self.s = np.linspace(0.0, 1.0, count + 1)
        spline = BSpline(clamped_knots(num_control), np.eye(num_control), DEGREE)
        self.basis: Vector = spline(self.s)  # (S + 1, N)
        ds = 1.0 / count
        first = np.diff(np.eye(count + 1), axis=0) / np.sqrt(ds)
        second = np.diff(np.eye(count + 1), n=2, axis=0) * np.sqrt(smoothing / ds**3)
        self._difference = np.concatenate([first, second])  # r = difference @ q
        self._normal = self._difference.T @ self._difference  # (S + 1, S + 1)
        # Samples farther apart than two have no difference in common: of the pairs of samples, only those nearer count.
        self._pairs = np.array([(s, t) for s in range(count + 1) for t in range(s - 2, s + 3) if 0 <= t <= count]).T
        s, t = self._pairs
        weights = self._normal[s, t][:, None, None] * self.basis[s][:, :, None] * self.basis[t][:, None]
        self._weights = weights.reshape(len(s), -1).T  # (N * N, pairs)

    def cost(self, control: Vector, scale: Vector | float = 1.0) -> float:
        """The objective (1) of control points, shape (num_control, num_coordinates).

        Args:
            control: The control points.
            scale: What positions are multiplied by, shape (nq,).
        """
        q, _ = self.chart.expand(self.basis @ control)
        return float(((self._difference @ (q * scale)) ** 2).sum())

    def subproblem(self, control: Vector, radius: float, backoff: float) -> Subproblem:
        """The quadratic program (3) around control points, shape (num_control, num_coordinates)."""
        whole, n = self.whole(control, radius, backoff), control.shape[1]
        inner = slice(n, -n)
        box = np.tile(radius / self.chart.scale, len(control) - 2)
        identity = np.eye(len(box))
        A = np.concatenate([whole.A[:, inner], identity, -identity])
        b = np.concatenate([whole.b, box, box])
        return Subproblem(whole.P[inner, inner], whole.c[inner], A, b, whole.names)

    def whole(self, control: Vector, radius: float, backoff: float, scale: Vector | float = 1.0) -> Subproblem:
        """The same in the change of all control points, those at the ends included, and without a trust region.

        Conditions that nothing within the trust region can violate are left out all the same.
        """
        size = control.size
        near = self.conditions.linearised(self.basis @ control, WATCH)
        # dq_i/du_jc = B_j(s_i) dq/du_c
        dq = near.dq * np.broadcast_to(scale, near.q.shape[1:])[:, None]
        s, t = self._pairs
        N, n = control.shape
        products = dq.swapaxes(1, 2)[s] @ dq[t]  # (pairs, n, n)
        P = 2 * (self._weights @ products.reshape(len(s), -1)).reshape(N, N, n, n).swapaxes(1, 2).reshape(size, size)
        c = 2 * (self.basis.T @ np.einsum("sq,sqc->sc", self._normal @ (near.q * scale), dq)).ravel()
        bound = radius / self.chart.scale
        room = near.value - np.minimum(near.value, backoff)
        # The basis adds up to one, so no sample leaves the trust region, and most conditions have room for all of it.
        tight = (room < np.abs(near.slope) @ bound) & (near.place > 0) & (near.place < len(self.s) - 1)
        rows = np.einsum("mj,mc->mjc", self.basis[near.place[tight]], near.slope[tight]).reshape(-1, size)
        names = (
            f"{self.conditions.names[k]} at s={self.s[i]:.3f}"
            for i, k in zip(near.place[tight], near.kind[tight], strict=True)
        )
        return Subproblem(P, c, -rows, room[tight], tuple(names))

    def solve(
        self, guess: Curve, check: Manifold | None = None, iterations: int = 12, resolution: float = RESOLUTION
    ) -> Solution:
        """Improves a curve of `num_control` control points.

        Args:
            guess: The curve to begin with; the result has its ends.
            check: What a better curve must satisfy on the fine grid; the program's manifold by default.
            iterations: Subproblems solved at most.
            resolution: Of the fine grid [rad].
        """
        check = check or self.manifold
        curve, cost = guess, self.cost(guess.control)
        before, solved = cost, 0
        binding: tuple[str, ...] = ()
        radius, backoff = 0.6, 2e-4
        while solved < iterations and radius > 5e-3:
            problem = self.subproblem(curve.control, radius, backoff)
            x, prices = minimise(problem)
            solved += 1
            binding = tuple(name for name, price in zip(problem.names, prices, strict=False) if price > 1e-4 * cost)
            promised = -float(x @ problem.P @ x / 2 + problem.c @ x)
            if not promised > ENOUGH * cost:
                break
            control = curve.control.copy()
            control[1:-1] += x.reshape(-1, control.shape[1])
            trial, after = Curve(self.chart, control), self.cost(control)
            if not after < cost:
                radius *= 0.3
            elif not trial.feasible(check, resolution):
                radius, backoff = 0.3 * radius, 3 * backoff
            else:
                gained = cost - after
                curve, cost = trial, after
                if gained < SETTLED * cost:
                    break
                if gained > 0.7 * promised:
                    radius = min(2 * radius, LARGEST_STEP)
        return Solution(curve, cost, before, solved, binding)


def minimise(problem: Subproblem) -> tuple[Vector, Vector]:
    """The minimiser of a subproblem, shape (size,), and what each row's bound costs it, shape (rows,)."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-6
    cones = [clarabel.NonnegativeConeT(len(problem.b))]
    P, A = csc_matrix(np.triu(problem.P)), csc_matrix(problem.A)
    solution = clarabel.DefaultSolver(P, problem.c, A, problem.b, cones, settings).solve()
    return np.array(solution.x), np.array(solution.z)


def _loosened(manifold: Manifold) -> Manifold:
    """The manifold with its margins halved."""
    halves = Margins(*(getattr(manifold.margins, field.name) / 2 for field in fields(Margins)))
    return Manifold(manifold.body, manifold.contacts, manifold.support, halves)


def refine(manifold: Manifold, chart: AnyChart, u: Vector, smoothing: float = SMOOTHING) -> Curve | None:
    """A short and smooth curve in place of a polyline.

    Args:
        manifold: What makes a configuration feasible.
        chart: The chart that `u` is in.
        u: Corners of a feasible polyline, shape (M, num_coordinates), M at least 2.
        smoothing: Weight of bending against length, see `ChartProgram`.

    Returns:
        A curve with the ends of `u`, no longer than it in joint space, feasible wherever it was looked at (see
        `Curve.feasible`). A polyline that a coarser search let graze its margins may use up half of them. None if the
        polyline is infeasible beyond that.
    """
    for check in (manifold, _loosened(manifold)):
        guess = smooth(check, chart, u, NUM_CONTROL)
        if guess is not None:
            break
    else:
        return None
    longest = float(polyline_lengths(chart, u).sum())
    if longest < 1e-6:
        return guess
    start = guess if len(u) > 2 else rounded(chart, u, NUM_CONTROL)
    better = ChartProgram(manifold, chart, len(start.control), smoothing).solve(start, check).curve
    return better if better is not start and better.length <= longest else guess
