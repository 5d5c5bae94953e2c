"""Where the centre of mass may be: Gönen's model for a robot in the wall plane, Bretl's for one in space, written anew.

The planner's programs are Drake's; these are cvxpy's, solved by Clarabel, and share no line with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from climber.stance import Vector
from climber.verify_grips import Grip, PlaneGrip
from climber.verify_polygon import Polygon
from climber.wall import Wall

ACCURATE = {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11}


@dataclass(frozen=True)
class Support:
    """The interval of the centre of mass's abscissa, or why there is none.

    Attributes:
        lower: Least abscissa [m]; NaN if there is none.
        upper: Greatest abscissa [m]; NaN if there is none.
        status: What the solver said of the two programs.
    """

    lower: float
    upper: float
    status: str

    @property
    def exists(self) -> bool:
        """Whether there is an interval at all."""
        return self.lower <= self.upper

    def margin(self, center: Vector) -> Vector:
        """How far places of the centre of mass, shape (K, 3), are inside [m], shape (K,); NaN without an interval."""
        return np.asarray(np.minimum(center[:, 0] - self.lower, self.upper - center[:, 0]))

    def describe(self) -> str:
        """What it looks like, in words."""
        return f"[{self.lower:.4f}, {self.upper:.4f}] m" if self.exists else f"empty ({self.status})"


def support_of(wall: Wall, holds: Sequence[int], points: Vector, mass: float, planar: bool) -> Support | Polygon:
    """Where the centre of mass may be for feet at `points` on `holds`.

    Args:
        wall: The wall.
        holds: Number of the hold under each foot, k of them.
        points: Where the feet are in W [m], shape (k, 3).
        mass: The robot's mass [kg].
        planar: Whether the robot is in the wall plane, where it needs no support across it.
    """
    if planar:
        return support_interval(wall, holds, points, mass)
    return Polygon([Grip.of(wall.holds[hold], planar=False) for hold in holds], points, mass * wall.gravity)


class _SupportProgram:
    """Extreme abscissae at which k contacts hold the robot up (Gönen eqs 4.8-4.17).

    Variables: multiples t of the generators [N], shape (2k,); the sum n of the moments that grippers exert on their
    pins [N m]; abscissa x of the centre of mass from the contacts' centroid [m].

        minimise, then maximise   x
        subject to   sum_i G_i t_i            = -(sum_i offset_i) - m g        force balance       (4.13, lines 1-2)
                     sum_i r_i x (G_i t_i) + n = -(sum_i r_i x offset_i) + W x torque balance      (4.13, line 3)
                     lower <= t <= upper,  |n| <= sum_i moment_i               cones and limits    (4.9, 4.11)

    with the contact points r_i taken from the centroid, W the in-plane weight and gravity along -y. Where W is zero
    the centre of mass is anywhere if there are such t and n at all.
    """

    def __init__(self, contacts: int) -> None:
        import cvxpy  # takes half a second, which planning need not wait for

        self.t = cvxpy.Variable(2 * contacts)
        self.x, self.n = cvxpy.Variable(), cvxpy.Variable()
        self.turning = cvxpy.Parameter()
        self.wrench = cvxpy.Parameter((3, 2 * contacts))
        self.load = cvxpy.Parameter(3)
        self.lever = cvxpy.Parameter(3)
        self.lower = cvxpy.Parameter(2 * contacts)
        self.upper = cvxpy.Parameter(2 * contacts)
        constraints = [
            self.wrench @ self.t + np.array([0.0, 0.0, 1.0]) * self.n == self.load + self.lever * self.x,
            self.n <= self.turning,
            -self.n <= self.turning,
            self.t >= self.lower,
            self.t <= self.upper,
        ]
        self.least = cvxpy.Problem(cvxpy.Minimize(self.x), constraints)
        self.greatest = cvxpy.Problem(cvxpy.Maximize(self.x), constraints)
        self.anywhere = cvxpy.Problem(cvxpy.Minimize(0), [*constraints, self.x == 0])


@lru_cache
def _program(contacts: int) -> _SupportProgram:
    return _SupportProgram(contacts)


def support_interval(wall: Wall, holds: Sequence[int], points: Vector, mass: float) -> Support:
    """The interval of the centre of mass's abscissa for feet at `points` on `holds`.

    Args:
        wall: The wall.
        holds: Number of the hold under each foot, k of them.
        points: Where the feet are in W [m], shape (k, 3).
        mass: The robot's mass [kg].
    """
    if not holds:
        return Support(np.nan, np.nan, "no contacts")
    grips = [grip for hold in holds if isinstance(grip := Grip.of(wall.holds[hold]), PlaneGrip)]
    import cvxpy

    weight = -mass * float(wall.gravity[1])
    centroid = points[:, :2].mean(axis=0)
    arms = points[:, :2] - centroid
    generators = np.hstack([grip.generators for grip in grips])
    offset = np.array([grip.offset for grip in grips])
    around = np.repeat(arms, 2, axis=0)
    program = _program(len(grips))
    program.wrench.value = np.vstack([generators, around[:, 0] * generators[1] - around[:, 1] * generators[0]])
    twist = float((arms[:, 0] * offset[:, 1] - arms[:, 1] * offset[:, 0]).sum())
    program.load.value = np.array([-offset[:, 0].sum(), weight - offset[:, 1].sum(), -twist])
    program.lever.value = np.array([0.0, 0.0, weight])
    program.lower.value = np.concatenate([grip.lower for grip in grips])
    program.upper.value = np.concatenate([grip.upper for grip in grips])
    program.turning.value = float(sum(grip.moment for grip in grips))
    weightless = weight < 1e-9
    ends = []
    for problem in (program.anywhere,) if weightless else (program.least, program.greatest):
        try:
            problem.solve(solver=cvxpy.CLARABEL, **ACCURATE)
        except cvxpy.SolverError as error:
            return Support(np.nan, np.nan, str(error))
        if problem.status != cvxpy.OPTIMAL:
            return Support(np.nan, np.nan, str(problem.status))
        ends.append(float(problem.value) + float(centroid[0]))
    return Support(-np.inf, np.inf, cvxpy.OPTIMAL) if weightless else Support(ends[0], ends[1], cvxpy.OPTIMAL)
