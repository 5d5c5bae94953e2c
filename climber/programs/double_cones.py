"""Many small programs over double cones at once: an interior-point method whose every operation is over all of them.

A contact's force in space is in two cones, apex to apex; scaled, and measured from the middle, it is x = (u_1, u_2, s)
in the unit double cone

    |u| <= 1 + s,  |u| <= 1 - s

An interval is one without use for u. Each program has m of these, and a few equations:

    max a . x   subject to   E x = b,   x_i in the unit double cone, i = 1..m

The method is Mehrotra's predictor-corrector with the scaling of Nesterov and Todd (as in Vandenberghe 2010, "The CVXOPT
linear and quadratic cone program solvers"), from a point strictly inside; its iterates stay strictly inside. The
greatest of c . x over the unit double cone is max(|c_s|, |c_u|), so that by weak duality any y proves

    max a . x <= y . b + sum_i max(|c_i,s|, |c_i,u|),   c = a - E^T y

which is how answers come with a bound that does not rest on the method. It needs about ten steps, each a few
microseconds for a program of four contacts, several times less than a solver that takes one program after another.
Arrays have the programs as their last axis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from climber.programs.cone_algebra import (
    applied,
    det,
    divided,
    factored,
    gathered,
    product,
    room,
    slacks,
    spread,
    transposed,
    turned,
)
from climber.programs.sections import EXACT, Section
from climber.stance import Vector

Mask = NDArray[np.bool_]
Stop = Callable[[Vector, Vector], Mask]

MOST_STEPS = 40
SHORT = 0.98  # of the way to the border at a time
CHUNK = 1024  # programs handled at once, so that they stay in the cache
EVEN = 1e-10  # E x = b holds if it does to this


@dataclass(frozen=True)
class ConePrograms:
    """Programs with the same number m of double cones and u of equations.

    Attributes:
        E: Shape (u, 3, m, B).
        b: Shape (u, B).
        a: Shape (3, m, B).
        section: What stands for the circle |u| <= 1.
    """

    E: Vector
    b: Vector
    a: Vector
    section: Section = EXACT

    def __len__(self) -> int:
        return int(self.b.shape[-1])

    def __getitem__(self, rows: object) -> ConePrograms:
        """The programs at `rows`."""
        i: NDArray[np.int64] = rows  # type: ignore[assignment]
        return ConePrograms(self.E[..., i], self.b[..., i], self.a[..., i], self.section)

    def bound(self, y: Vector) -> Vector:
        """What y, shape (u, B), proves to be at least the maximum, shape (B,)."""
        c = self.a - transposed(self.E, y)
        result: Vector = (y * self.b).sum(axis=0) + greatest(c, self.section).sum(axis=0)
        return result


@dataclass(frozen=True)
class ConeSolutions:
    """What was found, whether or not it is exact.

    Attributes:
        x: Strictly inside the cones, shape (3, m, B).
        y: Multipliers of the equations, shape (u, B).
        value: a . x, at most the maximum, shape (B,).
        bound: What y proves to be at least the maximum, shape (B,).
    """

    x: Vector
    y: Vector
    value: Vector
    bound: Vector

    def improve(self, rows: NDArray[np.int64], other: ConeSolutions) -> None:
        """Takes over what another solution says of the programs at `rows`, where it is better."""
        higher, lower = other.value > self.value[rows], other.bound < self.bound[rows]
        self.x[..., rows[higher]], self.value[rows[higher]] = other.x[..., higher], other.value[higher]
        self.y[:, rows[lower]], self.bound[rows[lower]] = other.y[:, lower], other.bound[lower]


def greatest(c: Vector, section: Section = EXACT) -> Vector:
    """The greatest of c . x over the unit double cone for c of shape (3, ...)."""
    result: Vector = np.maximum(section.greatest(np.moveaxis(c[:2], 0, -1)), np.abs(c[2]))
    return result


def maximise(programs: ConePrograms, start: Vector, stop: Stop) -> ConeSolutions:
    """Solves programs.

    Args:
        programs: The programs.
        start: Points strictly inside the cones with E x = b, shape (3, m, B).
        stop: Given values and bounds, each of shape (n,), says which are good enough.
    """
    u, B = programs.b.shape
    x, y = np.empty_like(start), np.empty((u, B))
    value, bound = np.empty(B), np.empty(B)
    for first in range(0, B, CHUNK):
        rows = slice(first, first + CHUNK)
        some = _maximise(programs[rows], start[..., rows], stop)
        x[..., rows], y[:, rows], value[rows], bound[rows] = some.x, some.y, some.value, some.bound
    return ConeSolutions(x, y, value, bound)


def _maximise(programs: ConePrograms, start: Vector, stop: Stop) -> ConeSolutions:
    """`maximise` for a chunk. Programs that are done are put aside."""
    x, y = start.copy(), np.zeros_like(programs.b)
    found = ConeSolutions(x.copy(), y.copy(), (programs.a * x).sum(axis=(0, 1)), programs.bound(y))
    left = np.arange(len(programs))
    s = slacks(x)
    # On the central path for what the objective is worth, whatever that does to the dual equations at first.
    worth = np.sqrt((programs.a**2).sum(axis=(0, 1)) / len(programs.a[0])) + 1e-9
    z = s * np.array([1.0, -1.0, -1.0]).reshape(3, 1, 1, 1) * (worth / det(s))
    for _ in range(MOST_STEPS):
        done = stop(found.value[left], found.bound[left])
        if done.any():
            keep = ~done
            left, x, y, z = left[keep], x[..., keep], y[:, keep], z[..., keep]
            programs = programs[keep]
        if not len(left):
            break
        with np.errstate(all="ignore"):  # those that rounding stops are left out below
            x, y, z = _step(programs, x, y, z)
            x, balanced = _balanced(programs, x)
        value, bound = (programs.a * x).sum(axis=(0, 1)), programs.bound(y)
        good = np.isfinite(value) & np.isfinite(bound)
        found.improve(
            left, ConeSolutions(x, y, np.where(balanced & good, value, -np.inf), np.where(good, bound, np.inf))
        )
        if not good.all():  # as close as rounding allows
            left, x, y, z, programs = left[good], x[..., good], y[:, good], z[..., good], programs[good]
    return found


def _balanced(programs: ConePrograms, x: Vector) -> tuple[Vector, Mask]:
    """Takes back what rounding did to E x = b, if cones permit, and tells which points satisfy it."""
    gap = programs.b - applied(programs.E, x)
    off = np.flatnonzero(np.abs(gap).max(axis=0) > EVEN)
    if len(off):
        E = programs.E[..., off].reshape(*programs.b.shape[:1], -1, len(off)).transpose(2, 0, 1)
        change = (np.linalg.pinv(E, rcond=1e-9) @ gap.T[off, :, None])[..., 0].T
        moved = x[..., off] + change.reshape(*x.shape[:2], -1)
        inside = (det(slacks(moved)) > 0.0).all(axis=(0, 1)) & (np.abs(moved[2]) < 1.0).all(axis=0)
        x[..., off[inside]] = moved[..., inside]
        gap[:, off] = programs.b[:, off] - applied(programs.E[..., off], x[..., off])
    return x, np.asarray(np.abs(gap).max(axis=0) <= EVEN)


def _step(programs: ConePrograms, x: Vector, y: Vector, z: Vector) -> tuple[Vector, Vector, Vector]:
    """One predictor-corrector step from x, y and z, the multipliers of the cones, shape (3, 2, m, B)."""
    s = slacks(x)
    m = x.shape[1]
    # The scaling: W z = W^-1 s.
    det_s, det_z = np.sqrt(det(s)), np.sqrt(det(z))
    half = 1.0 / np.sqrt(2.0 * (1.0 + (s * z).sum(axis=0) / (det_s * det_z)))
    w = np.empty_like(s)
    w[0] = (s[0] / det_s + z[0] / det_z) * half
    w[1:] = (s[1:] / det_s - z[1:] / det_z) * half
    eta2 = det_s / det_z
    eta = np.sqrt(eta2)
    scaled = eta * turned(w, z, 1.0)  # lambda
    solve = factored(programs.E, w, eta2)
    gap = programs.b - applied(programs.E, x)
    mu = (s * z).sum(axis=(0, 1, 2)) / (2.0 * m)

    def direction(q: Vector | None) -> tuple[Vector, Vector, Vector, Vector]:
        """(dx, y + dy, ds, dz), for q = W^-1 times the target divided by lambda; for none, of the predictor."""
        right = programs.a if q is None else programs.a + gathered(q)
        dx, y_new = solve(right, gap)
        ds = spread(dx)
        vs = (w[0] * ds[0] - w[1] * ds[1] - w[2] * ds[2]) * (2.0 / eta2)  # W^-2 = (2 v v^T - J) / eta^2
        dz = -z
        dz[0] -= vs * w[0] - ds[0] / eta2
        dz[1:] += vs * w[1:] - ds[1:] / eta2
        return dx, y_new, ds, dz if q is None else dz + q

    _, _, ds, dz = direction(None)
    alpha, beta = np.minimum(room(s, ds), 1.0), np.minimum(room(z, dz), 1.0)
    after = ((s + alpha * ds) * (z + beta * dz)).sum(axis=(0, 1, 2)) / (2.0 * m)
    center = np.clip(after / mu, 0.0, 1.0) ** 3
    ds, dz = turned(w, ds, -1.0) / eta, turned(w, dz, 1.0) * eta
    target = -product(ds, dz)
    target[0] += center * mu
    q = turned(w, divided(scaled, target), -1.0) / eta
    dx, y_new, ds, dz = direction(q)
    alpha = np.minimum(SHORT * room(s, ds), 1.0)
    beta = np.minimum(SHORT * room(z, dz), 1.0)
    return x + alpha * dx, y + beta * (y_new - y), z + beta * dz
