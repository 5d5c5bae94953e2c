"""From a path to a motion: a leg's pace, and the velocities and accelerations of the whole robot along it.

The path is retraced at a pace that keeps the fastest joint's share of its rate limit constant. Along that pace
`climber.fastest` finds the fastest motion; a minimum-jerk law from rest to rest is what there is where it finds none,
mended by one number, its duration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import maximum_filter1d

from climber.curve import Curve
from climber.manifold import AnyChart
from climber.stance import Vector

PEAK = 1.875  # greatest rate of the minimum-jerk law, against the mean


@dataclass(frozen=True)
class Samples:
    """A motion sampled in time.

    Attributes:
        time: [s], shape (K,).
        q: Positions, shape (K, nq).
        v: Velocities, shape (K, nv).
        vd: Accelerations, shape (K, nv).
    """

    time: Vector
    q: Vector
    v: Vector
    vd: Vector


def rates(chart: AnyChart, q: Vector, du: Vector, ddu: Vector | None = None) -> tuple[Vector, Vector | None]:
    """Velocities and accelerations of the whole robot from those of the chart's coordinates.

    With F and D the directions of the chart's coordinates and of what follows from them, q' = F du + D y. The contacts
    stay put, J q' = 0 with J their derivative by q, so that J D y = -J F du; and for q'' = F ddu + D z likewise
    J D z = -J F ddu - J' q'. Velocities and accelerations follow from q' and q''; in the plane they are the same.
    """
    body, robot = chart.body, chart.body.robot
    limbs = sorted(chart.points)
    free, tied = chart.free, chart.tied

    def jacobian(at: Vector) -> Vector:
        J = robot.by_positions(at, body.kinematics.foot_jacobians(at, limbs))
        return J.reshape(len(at), J.shape[1] * J.shape[2], J.shape[3])

    J = jacobian(q)
    along = du @ free.T
    dq = along - np.linalg.solve(J @ tied, J @ along[:, :, None])[:, :, 0] @ tied.T
    if ddu is None:
        return robot.v_of(q, dq), None
    # Central difference of J along the motion, exact enough (1e-9 of its size) and the same for every robot.
    h = 1e-5
    drift = ((jacobian(q + h * dq) - jacobian(q - h * dq)) @ dq[:, :, None])[:, :, 0] / (2 * h)
    along = ddu @ free.T
    ddq = along - np.linalg.solve(J @ tied, J @ along[:, :, None] + drift[:, :, None])[:, :, 0] @ tied.T
    return robot.v_of(q, dq), robot.vd_of(q, dq, ddq)


class PacedPath:
    """One leg of a path, paced: the coordinates as functions of sigma, the time it takes at full joint rates [s].

    No joint is faster than its limit while sigma runs no faster than time; the pelvis, which has no limit of its own,
    keeps to 1 m/s and 1 rad/s.

    Attributes:
        chart: The leg's chart.
        length: sigma at the end [s].
    """

    GRID = 33  # coarse on purpose: a pace that follows every turn of the path jerks
    FINER = 8  # times finer is the grid on which rates are held to their limits

    def __init__(self, curve: Curve) -> None:
        self.chart, self._curve = curve.chart, curve
        chart = curve.chart
        s = np.linspace(0.0, 1.0, self.FINER * (self.GRID - 1) + 1)
        q, _ = chart.expand(curve.u(s))
        dq, _ = rates(chart, q, curve.du(s))
        limits = np.full(q.shape[1], 1.0)
        for limb in chart.body.robot.limbs:
            limits[limb.v] = limb.velocity
        used = np.abs(dq / np.where(np.isfinite(limits), limits, 10.0))  # shares of the limits, per unit of s
        # A smooth stand-in for the largest share, at each knot as large as anywhere up to the next.
        smooth = (used**4).sum(axis=1) ** (1 / 4)
        share = maximum_filter1d(smooth, 2 * self.FINER + 1, mode="nearest")[:: self.FINER]
        # Crawl rather than jump where the path hardly moves the joints.
        share = share + 0.05 * share.mean() + 1e-9
        knots = s[:: self.FINER]
        pace = CubicSpline(knots, share)
        if pace(s).min() < 0.5 * share.min():  # it swings too far down beside a sharp peak
            pace = PchipInterpolator(knots, share)
        # Should anything still stand out between the knots, it slows the whole leg.
        pace.c *= max(1.0, float((used.max(axis=1) / pace(s)).max()))
        self._sigma, self._pace, self._pace_rate = pace.antiderivative(), pace, pace.derivative()
        self._grid = s, self._sigma(s)
        self.length = float(self._sigma(1.0))

    def _place(self, sigma: Vector) -> Vector:
        """The s at which the path has come as far as `sigma`, shape (K,)."""
        s, known = self._grid
        guess: Vector = np.interp(sigma, known, s)
        for _ in range(4):  # Newton; the pace is smooth and positive
            guess = np.clip(guess - (self._sigma(guess) - sigma) / self._pace(guess), 0.0, 1.0)
        return guess

    def at(self, sigma: Vector, rate: Vector, acceleration: Vector) -> tuple[Vector, Vector, Vector]:
        """Positions, velocities and accelerations at sigma, its rate and its acceleration, each of shape (K,)."""
        s = self._place(sigma)
        first = 1 / self._pace(s)
        second = -self._pace_rate(s) * first**3
        ds, dds = first * rate, second * rate**2 + first * acceleration
        du, ddu = self._curve.du(s), self._curve.ddu(s)
        q, _ = self.chart.expand(self._curve.u(s))
        v, vd = rates(self.chart, q, du * ds[:, None], ddu * ds[:, None] ** 2 + du * dds[:, None])
        assert vd is not None
        return q, v, vd

    def samples(self, duration: float, count: int) -> Samples:
        """The leg run from rest to rest in `duration` [s] at `count` even instants, both ends included."""
        tau = np.linspace(0.0, 1.0, count)
        law = tau**3 * (10 - 15 * tau + 6 * tau**2)
        first = 30 * tau**2 * (1 - tau) ** 2 / duration
        second = 60 * tau * (1 - tau) * (1 - 2 * tau) / duration**2
        q, v, vd = self.at(self.length * law, self.length * first, self.length * second)
        return Samples(duration * tau, q, v, vd)


def joined(pieces: Sequence[Samples]) -> Samples:
    """Pieces run one after the other; each begins where, and at rest as, the one before it ends."""
    time, q, v, vd = [pieces[0].time], [pieces[0].q], [pieces[0].v], [pieces[0].vd]
    for piece in pieces[1:]:
        time.append(time[-1][-1] + piece.time[1:])
        q.append(piece.q[1:])
        v.append(piece.v[1:])
        vd.append(piece.vd[1:])
    return Samples(np.concatenate(time), np.concatenate(q), np.concatenate(v), np.concatenate(vd))
