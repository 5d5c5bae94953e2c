"""The square of the speed along a path, as a B-spline of the place on it.

Of a motion x(t) along a path, b(x) = xdot^2 says everything: xddot = b'(x) / 2 and dt = dx / sqrt(b). Rates and
accelerations are linear in b and b', which is what makes time scaling convex (Verscheure et al. 2009).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline

from climber.curve import clamped_knots
from climber.robot import Indices
from climber.stance import Vector


@dataclass(frozen=True)
class Local:
    """b and a at N places as combinations of the few coefficients that matter there.

    Attributes:
        columns: Which coefficients, shape (N, degree + 1).
        b: Weights that give b, shape (N, degree + 1).
        a: Weights that give a = b' / 2, likewise.
    """

    columns: Indices
    b: Vector
    a: Vector

    def __getitem__(self, index: Indices) -> Local:
        """The places at `index`."""
        return Local(self.columns[index], self.b[index], self.a[index])

    def combined(self, of_b: Vector, of_a: Vector) -> Vector:
        """Weights of the coefficients in of_b * b + of_a * a, both of shape (N,); shape (N, degree + 1)."""
        result: Vector = of_b[:, None] * self.b + of_a[:, None] * self.a
        return result

    def values(self, coefficients: Vector) -> tuple[Vector, Vector]:
        """Both b and a, each of shape (N,)."""
        own = coefficients[self.columns]
        return (self.b * own).sum(axis=1), (self.a * own).sum(axis=1)


@dataclass(frozen=True)
class SpeedProfile:
    """B-splines b(x) on [0, length] with equal intervals.

    Of degree 1 they are piecewise linear, as in the literature: the acceleration is constant in every interval and
    jumps between them. Of degree 3 even the slope of the acceleration is continuous.

    Attributes:
        length: Where the path ends.
        intervals: Number of intervals.
        degree: Degree.
    """

    length: float
    intervals: int
    degree: int = 3

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return self.intervals + self.degree

    @cached_property
    def knots(self) -> Vector:
        """The knots, the outer ones repeated."""
        return self.length * clamped_knots(self.size, self.degree)

    def spline(self, coefficients: Vector) -> BSpline:
        """b(x) with these coefficients, shape (size,)."""
        return BSpline(self.knots, coefficients, self.degree)

    def local(self, x: Vector) -> Local:
        """What b and a are at places x, shape (N,), for any coefficients."""
        basis = self.spline(np.eye(self.size))
        first = np.clip(np.searchsorted(self.knots, x, side="right") - 1, self.degree, self.size - 1) - self.degree
        columns = first[:, None] + np.arange(self.degree + 1)
        b = np.take_along_axis(basis(x), columns, axis=1)
        a = 0.5 * np.take_along_axis(basis.derivative()(x), columns, axis=1)
        return Local(columns, b, a)


class TimeLaw:
    """When a motion along a path is where: x(t) for a speed profile that is positive throughout.

    Attributes:
        profile: The profile.
        coefficients: Its coefficients, shape (profile.size,).
        duration: Time from x = 0 to the end of the path [s].
    """

    CELLS = 8  # to an interval of the profile
    _POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(5)

    def __init__(self, profile: SpeedProfile, coefficients: Vector) -> None:
        self.profile, self.coefficients = profile, coefficients
        self._b = profile.spline(coefficients)
        self._slope = self._b.derivative()
        self._x = np.linspace(0.0, profile.length, self.CELLS * profile.intervals + 1)
        self._time = np.concatenate([[0.0], np.cumsum(self._passing(self._x[:-1], self._x[1:]))])
        self.duration = float(self._time[-1])

    def _passing(self, begin: Vector, end: Vector) -> Vector:
        """Time from one place to another not far from it, all of shape (K,), by Gauss's rule."""
        half = 0.5 * (end - begin)
        x = 0.5 * (begin + end)[:, None] + half[:, None] * self._POINTS
        result: Vector = half * (self._WEIGHTS / np.sqrt(self._b(x))).sum(axis=1)
        return result

    def slowed(self, factor: float) -> TimeLaw:
        """The same motion, taking `factor` times as long."""
        return TimeLaw(self.profile, self.coefficients / factor**2)

    def time(self, x: Vector) -> Vector:
        """When the motion is at places `x`, shape (K,) [s]."""
        cell = np.clip(np.searchsorted(self._x, x, side="right") - 1, 0, len(self._x) - 2)
        result: Vector = self._time[cell] + self._passing(self._x[cell], x)
        return result

    def at(self, time: Vector) -> tuple[Vector, Vector, Vector]:
        """Place, speed and acceleration at instants `time` [s], each of shape (K,)."""
        cell = np.clip(np.searchsorted(self._time, time, side="right") - 1, 0, len(self._x) - 2)
        x = np.interp(time, self._time, self._x)
        for _ in range(3):  # Newton, quadratic from a start that is good to a cell
            late = self._time[cell] + self._passing(self._x[cell], x) - time
            x = np.clip(x - late * np.sqrt(self._b(x)), 0.0, self.profile.length)
        return x, np.sqrt(self._b(x)), 0.5 * self._slope(x)
