"""Smooth curves on a stance's manifold: clamped B-splines in the coordinates of one chart.

A path search returns corners, and at a corner a robot has to stop. Here corners are rounded, without optimising
anything; `climber.programs.trajectory` makes the result short.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline

from climber.manifold import AnyChart, Manifold
from climber.stance import Vector

DEGREE = 5  # accelerations change smoothly, not only continuously
MOST = 384  # control points of a curve through the corners of a polyline
RESOLUTION = 0.02  # [rad] distance in joint space between the places where a curve is checked


def clamped_knots(num_control: int, degree: int = DEGREE) -> Vector:
    """Knots on [0, 1], equally spaced inside, that make a B-spline end at its first and last control points."""
    inner = np.linspace(0.0, 1.0, num_control - degree + 1)
    return np.concatenate([np.zeros(degree), inner, np.ones(degree)])


def greville(num_control: int, degree: int = DEGREE) -> Vector:
    """Where control points have their say: control points g_i give the curve u(s) = s. Shape (num_control,)."""
    knots = clamped_knots(num_control, degree)
    return np.array([knots[i + 1 : i + degree + 1].mean() for i in range(num_control)])


def joint_length(q: Vector) -> float:
    """Length of the polyline through configurations `q`, shape (K, nq): Euclidean over all positions [m, rad].

    The path length of Gönen 2021, table 5.1: metres and radians count alike.
    """
    return float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())


@dataclass(frozen=True)
class Curve:
    """A smooth curve s -> u(s) in a chart, s in [0, 1]; of degree d it has d - 1 continuous derivatives.

    It keeps the contacts exactly, as the chart does. It has no timing: a time law s(t) at rest at both ends makes a
    motion at rest at both ends of it, so du/ds need not vanish there.

    Attributes:
        chart: The chart.
        control: Control points of the clamped B-spline, shape (num_control, num_coordinates).
        degree: Degree of the B-spline.
    """

    chart: AnyChart
    control: Vector
    degree: int = DEGREE

    @cached_property
    def _splines(self) -> tuple[BSpline, BSpline, BSpline]:
        spline = BSpline(clamped_knots(len(self.control), self.degree), self.control, self.degree)
        return spline, spline.derivative(1), spline.derivative(2)

    def u(self, s: Vector) -> Vector:
        """Coordinates at `s`, shape (K,) to (K, num_coordinates)."""
        result: Vector = self._splines[0](s)
        return result

    def du(self, s: Vector) -> Vector:
        """First derivative by s, shape (K, num_coordinates)."""
        result: Vector = self._splines[1](s)
        return result

    def ddu(self, s: Vector) -> Vector:
        """Second derivative by s, shape (K, num_coordinates); continuous."""
        result: Vector = self._splines[2](s)
        return result

    def q(self, s: Vector) -> Vector:
        """Configurations at `s`, shape (K, nq)."""
        return self.chart.expand(self.u(s))[0]

    def grid(self, resolution: float = RESOLUTION) -> Vector:
        """Values of s from 0 to 1, both included, whose configurations lie no farther apart than `resolution` [rad]."""
        s = np.linspace(0.0, 1.0, 65)
        for _ in range(4):  # a few rounds do, unless a limb out of reach jumps, and then no grid does
            steps = np.linalg.norm(np.diff(self.q(s), axis=0), axis=1)
            pieces = np.maximum(np.ceil(steps / resolution), 1).astype(int)
            if (pieces == 1).all():
                break
            number = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
            s = np.append(np.repeat(s[:-1], pieces) + number * np.repeat(np.diff(s) / pieces, pieces), 1.0)
        return s

    def feasible(self, manifold: Manifold, resolution: float = RESOLUTION) -> bool:
        """Whether the curve is feasible everywhere on a grid as fine as `resolution` [rad]."""
        u = self.u(self.grid(resolution))
        # A coarse look settles most failures at a fraction of the cost.
        return all(bool(manifold.feasible(self.chart, u[::every]).all()) for every in (8, 1))

    @cached_property
    def length(self) -> float:
        """Length in joint space [rad], see `joint_length`."""
        return joint_length(self.q(np.linspace(0.0, 1.0, 513)))


def polyline_lengths(chart: AnyChart, u: Vector) -> Vector:
    """Joint-space length of each segment of the polyline `u`, shape (M, num_coordinates); shape (M - 1,)."""
    pieces = max(64, -(-512 // (len(u) - 1)))
    part = np.linspace(0.0, 1.0, pieces + 1)[:, None]
    fine = u[:-1, None] + part * np.diff(u, axis=0)[:, None]  # (M - 1, pieces + 1, num_coordinates)
    q = chart.expand(fine.reshape(-1, u.shape[1]))[0].reshape(len(u) - 1, pieces + 1, -1)
    result: Vector = np.linalg.norm(np.diff(q, axis=1), axis=2).sum(axis=1)
    return result


def rounded(chart: AnyChart, u: Vector, num_control: int) -> Curve:
    """The polyline `u`, shape (M, num_coordinates), as a curve that rounds its corners.

    Schoenberg's variation-diminishing spline: control points on the polyline at the Greville abscissae. It meets both
    ends, reproduces a straight line, and tends to the polyline as control points are added.
    """
    lengths = polyline_lengths(chart, u)
    lengths += 1e-12 * lengths.sum() + 1e-300  # points that repeat must not share a place
    places = np.concatenate([[0.0], np.cumsum(lengths) / lengths.sum()])
    at = greville(num_control)
    control = np.column_stack([np.interp(at, places, column) for column in u.T])
    control[0], control[-1] = u[0], u[-1]
    return Curve(chart, control)


def smooth(
    manifold: Manifold,
    chart: AnyChart,
    u: Vector,
    num_control: int = 12,
) -> Curve | None:
    """The feasible polyline `u` as a feasible curve near it, no longer than it.

    Args:
        manifold: What makes a configuration feasible.
        chart: The chart that `u` is in.
        u: Corners of the polyline, shape (M, num_coordinates), M at least 2.
        num_control: Control points to begin with; they are doubled until the curve is feasible, or there
            would be more than `MOST`.

    Returns:
        The curve, or None if the polyline is not feasible itself when looked at this finely.
    """
    if len(u) == 2:
        curve = rounded(chart, u, DEGREE + 1)
        return curve if curve.feasible(manifold) else None
    longest = float(polyline_lengths(chart, u).sum()) + 1e-9  # [rad] rounding
    while num_control <= MOST:
        curve = rounded(chart, u, num_control)
        # Around a corner the chart is as good as flat, so that fine enough a curve is shorter.
        if curve.length <= longest and curve.feasible(manifold):
            return curve
        num_control *= 2
    return None
