"""A whole move at once: the curves before and after a change of contacts, and the posture in which it takes place.

`climber.programs.trajectory` makes the curve between two postures short. Which postures these are was decided with
straight lines in mind; here they move along with the curves that meet in them, shift and swing joined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climber.curve import RESOLUTION, Curve
from climber.manifold import Manifold
from climber.objective import Norm
from climber.programs.conditions import Conditions
from climber.programs.trajectory import WATCH, ChartProgram, Subproblem, minimise
from climber.stance import Vector

RADIUS = 0.3  # [rad] of the trust region at first
SMALLEST = 1e-2  # [rad] and when to stop
BACKOFF = 2e-4  # [rad or m] room to a condition that a step leaves at first
ENOUGH = 2e-3  # a step that lowers the cost by less than this share is the last one


@dataclass(frozen=True)
class Meeting:
    """Where one curve ends and the next begins.

    Attributes:
        manifold: What the posture must satisfy there, for both.
        free: Whether it may be moved.
    """

    manifold: Manifold
    free: bool = True


@dataclass(frozen=True)
class Joined:
    """What became of the curves.

    Attributes:
        curves: The curves.
        cost: What they cost together.
        before: What they cost to begin with.
        iterations: Subproblems solved.
    """

    curves: tuple[Curve, ...]
    cost: float
    before: float
    iterations: int


class MoveProgram:
    """Curves that follow one another, and the postures in which they meet, as short as they can be together.

    Curve p is a B-spline q_p(s) on its own contacts, with the letters of `ChartProgram` and its objective E_p; D scales
    positions as the objective's norm does, and l_p is the length of curve p to begin with. With v_k the coordinates of
    the k-th meeting in a chart of all contacts that hold there and g_k the conditions of `Conditions` for both sides:

        min   sum_p E_p(D q_p) / (2 l_p)                                                            (1)
        s.t.  g(q_p(s_i)) >= 0                 for samples strictly inside each curve               (2)
              g_k(v_k) >= 0                                                                         (3)
              q_p(1) = q_{p+1}(0) = q(v_k)                                                          (4)

    l + (l'^2 / l - l) / 2 >= l', so what lowers (1) but for its smoothing lowers the sum of the lengths. (4) puts the
    last control point of one curve and the first of the next where v_k says, which is linear in the configuration.
    The ends of the whole do not move. Solved as `ChartProgram` is, and a step is kept only if every curve is feasible
    on the fine grid and every meeting as well.
    """

    def __init__(
        self, parts: Sequence[tuple[Manifold, Curve]], meetings: Sequence[Meeting], norm: Norm, smoothing: float = 0.01
    ) -> None:
        """Builds the program.

        Args:
            parts: The curves and what makes their configurations feasible; each begins where the one before ends.
            meetings: One between every two.
            norm: Whose scales lengths are measured with.
            smoothing: Weight of bending against length.
        """
        if len(meetings) != len(parts) - 1:
            raise ValueError(f"{len(parts)} curves meet {len(parts) - 1} times, not {len(meetings)}")
        self._parts, self._scale = list(parts), norm.scale
        self._programs = [
            ChartProgram(manifold, curve.chart, len(curve.control), smoothing) for manifold, curve in parts
        ]
        lengths = [max(self._length(curve), 1e-3) for _, curve in parts]
        self._weights = [1.0 / (2.0 * length) for length in lengths]
        postures = [curve.q(np.ones(1))[0] for _, curve in parts[:-1]]
        self._manifolds = [meeting.manifold for meeting in meetings]
        self._charts = [manifold.chart(q) for manifold, q in zip(self._manifolds, postures, strict=True)]
        self._conditions = [Conditions(m, chart) for m, chart in zip(self._manifolds, self._charts, strict=True)]
        self._start = [chart.coordinates(q) for chart, q in zip(self._charts, postures, strict=True)]
        # The unknowns: the inner control points of each curve, then the meetings that are free.
        sizes = [(len(curve.control) - 2) * curve.control.shape[1] for _, curve in parts]
        sizes += [
            len(v) if meeting.free and not meeting.manifold.rigid else 0
            for v, meeting in zip(self._start, meetings, strict=True)
        ]
        self._first = np.concatenate([[0], np.cumsum(sizes)])

    def _length(self, curve: Curve) -> float:
        q = curve.q(np.linspace(0.0, 1.0, 257)) * self._scale
        return float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())

    def length(self, curves: Sequence[Curve]) -> float:
        """The scaled lengths of curves together."""
        return sum(self._length(curve) for curve in curves)

    def cost(self, curves: Sequence[Curve]) -> float:
        """The objective (1)."""
        return sum(
            weight * program.cost(curve.control, self._scale)
            for weight, program, curve in zip(self._weights, self._programs, curves, strict=True)
        )

    def _place(self, k: int) -> slice:
        """Where the unknowns of the k-th meeting are."""
        at = len(self._parts) + k
        return slice(int(self._first[at]), int(self._first[at + 1]))

    def subproblem(
        self, curves: Sequence[Curve], meetings: Sequence[Vector], radius: float, backoff: float
    ) -> Subproblem:
        """The quadratic program around curves and the coordinates of their meetings."""
        size = int(self._first[-1])
        near = [c.linearised(v[None], WATCH) for c, v in zip(self._conditions, meetings, strict=True)]
        P, c = np.zeros((size, size)), np.zeros(size)
        A: list[Vector] = []
        b: list[Vector] = []
        names: list[str] = []
        for p, (program, curve) in enumerate(zip(self._programs, curves, strict=True)):
            own, n = slice(int(self._first[p]), int(self._first[p + 1])), curve.control.shape[1]
            part = program.whole(curve.control, radius, backoff, self._scale)
            # How control points of the curve follow from the unknowns: the inner ones are, the ends follow meetings.
            follow = [(slice(n, -n), own, np.eye(curve.control.size - 2 * n))]
            for k, rows in ((p - 1, slice(0, n)), (p, slice(-n, None))):
                if 0 <= k < len(meetings) and (place := self._place(k)).start < place.stop:
                    still = curve.chart.coordinates(near[k].q[0])
                    E = (curve.chart.coordinates(near[k].q[0] + near[k].dq[0].T) - still).T
                    follow.append((rows, place, E))
            held = np.zeros((len(part.b), size))
            for rows, place, E in follow:
                for others, beside, F in follow:
                    P[place, beside] += self._weights[p] * E.T @ part.P[rows, others] @ F
                c[place] += self._weights[p] * part.c[rows] @ E
                held[:, place] += part.A[:, rows] @ E
            A.append(held)
            b.append(part.b)
            names += part.names
            bound = np.tile(radius / curve.chart.scale, len(curve.control) - 2)
            identity = np.eye(size)[own]
            A += [identity, -identity]
            b += [bound, bound]
        for k, (here, chart) in enumerate(zip(near, self._charts, strict=True)):
            place = self._place(k)
            if place.start == place.stop:
                continue
            bound = radius / chart.scale
            room = here.value - np.minimum(here.value, backoff)
            tight = room < np.abs(here.slope) @ bound
            held = np.zeros((int(tight.sum()), size))
            held[:, place] = -here.slope[tight]
            identity = np.eye(size)[place]
            A += [held, identity, -identity]
            b += [room[tight], bound, bound]
        return Subproblem(P, c, np.concatenate(A), np.concatenate(b), tuple(names))

    def _moved(
        self, curves: Sequence[Curve], meetings: Sequence[Vector], x: Vector
    ) -> tuple[list[Curve], list[Vector]]:
        """Curves and meetings after a step."""
        went = [v.copy() for v in meetings]
        ends = []
        for k, v in enumerate(went):
            if (place := self._place(k)).start < place.stop:
                v += x[place]
            ends.append(self._charts[k].expand(v[None])[0][0])
        trial = []
        for p, curve in enumerate(curves):
            control = curve.control.copy()
            control[1:-1] += x[self._first[p] : self._first[p + 1]].reshape(-1, control.shape[1])
            for k, row in ((p - 1, 0), (p, -1)):
                if 0 <= k < len(went) and (place := self._place(k)).start < place.stop:
                    control[row] = curve.chart.coordinates(ends[k])
            trial.append(Curve(curve.chart, control, curve.degree))
        return trial, went

    def feasible(self, curves: Sequence[Curve], meetings: Sequence[Vector], resolution: float = RESOLUTION) -> bool:
        """Whether curves are feasible on a fine grid and so are their meetings."""
        for manifold, chart, v in zip(self._manifolds, self._charts, meetings, strict=True):
            if not manifold.feasible(chart, v[None])[0]:
                return False
        return all(
            curve.feasible(manifold, resolution) for (manifold, _), curve in zip(self._parts, curves, strict=True)
        )

    def solve(self, iterations: int = 8, resolution: float = RESOLUTION) -> Joined:
        """Improves the curves; the result is feasible on the fine grid, or the curves that were given."""
        curves, meetings = [curve for _, curve in self._parts], list(self._start)
        cost = before = self.cost(curves)
        solved, radius, backoff = 0, RADIUS, BACKOFF
        while solved < iterations and radius > SMALLEST:
            problem = self.subproblem(curves, meetings, radius, backoff)
            x, _ = minimise(problem)
            solved += 1
            if not -float(x @ problem.P @ x / 2 + problem.c @ x) > ENOUGH * cost:
                break
            trial, went = self._moved(curves, meetings, x)
            after = self.cost(trial)
            if not after < cost:
                radius *= 0.3
            elif not self.feasible(trial, went, resolution):
                radius, backoff = 0.3 * radius, 3.0 * backoff
            else:
                gained = cost - after
                curves, meetings, cost = trial, went, after
                if gained < ENOUGH * cost:
                    break
        return Joined(tuple(curves), cost, before, solved)


def refine_together(
    parts: Sequence[tuple[Manifold, Curve]], meetings: Sequence[Meeting], norm: Norm, smoothing: float = 0.01
) -> list[Curve]:
    """Curves that follow one another, shortened together with the postures in which they meet.

    Args:
        parts: The curves and what makes their configurations feasible; each begins where the one before ends.
        meetings: One between every two.
        norm: Whose scales lengths are measured with.
        smoothing: Weight of bending against length.

    Returns:
        As many curves with the same first and last posture: together no longer than those given and, looked at closely,
        feasible each on its manifold as are the postures in which they meet. If there are no such, those given.
    """
    program = MoveProgram(parts, meetings, norm, smoothing)
    given = [curve for _, curve in parts]
    found = list(program.solve().curves)
    return found if program.length(found) < program.length(given) else given
