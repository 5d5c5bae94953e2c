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

from climber.programs.sections import EXACT, Section
from climber.stance import Vector

Mask = NDArray[np.bool_]
Stop = Callable[[Vector, Vector], Mask]

MOST_STEPS = 40
SHORT = 0.98  # of the way to the border at a time
CHUNK = 1024  # programs handled at once, so that they stay in the cache
ROUNDING = 1e-16
EVEN = 1e-10  # E x = b holds if it does to this
REGULAR = 1e-14  # added to the diagonal of the equations, in parts of their trace, for those that are dependent


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
        c = self.a - _transposed(self.E, y)
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
    s = _slacks(x)
    # On the central path for what the objective is worth, whatever that does to the dual equations at first.
    worth = np.sqrt((programs.a**2).sum(axis=(0, 1)) / len(programs.a[0])) + 1e-9
    z = s * np.array([1.0, -1.0, -1.0]).reshape(3, 1, 1, 1) * (worth / _det(s))
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
        higher, lower = balanced & (value > found.value[left]), good & (bound < found.bound[left])
        found.x[..., left[higher]], found.value[left[higher]] = x[..., higher], value[higher]
        found.y[:, left[lower]], found.bound[left[lower]] = y[:, lower], bound[lower]
        if not good.all():  # as close as rounding allows
            left, x, y, z, programs = left[good], x[..., good], y[:, good], z[..., good], programs[good]
    return found


def _balanced(programs: ConePrograms, x: Vector) -> tuple[Vector, Mask]:
    """Takes back what rounding did to E x = b, if cones permit, and tells which points satisfy it."""
    gap = programs.b - _applied(programs.E, x)
    off = np.flatnonzero(np.abs(gap).max(axis=0) > EVEN)
    if len(off):
        E = programs.E[..., off].reshape(*programs.b.shape[:1], -1, len(off)).transpose(2, 0, 1)
        change = (np.linalg.pinv(E, rcond=1e-9) @ gap.T[off, :, None])[..., 0].T
        moved = x[..., off] + change.reshape(*x.shape[:2], -1)
        inside = (_det(_slacks(moved)) > 0.0).all(axis=(0, 1)) & (np.abs(moved[2]) < 1.0).all(axis=0)
        x[..., off[inside]] = moved[..., inside]
        gap[:, off] = programs.b[:, off] - _applied(programs.E[..., off], x[..., off])
    return x, np.asarray(np.abs(gap).max(axis=0) <= EVEN)


def _step(programs: ConePrograms, x: Vector, y: Vector, z: Vector) -> tuple[Vector, Vector, Vector]:
    """One predictor-corrector step from x, y and z, the multipliers of the cones, shape (3, 2, m, B)."""
    s = _slacks(x)
    m = x.shape[1]
    # The scaling: W z = W^-1 s.
    det_s, det_z = np.sqrt(_det(s)), np.sqrt(_det(z))
    half = 1.0 / np.sqrt(2.0 * (1.0 + (s * z).sum(axis=0) / (det_s * det_z)))
    w = np.empty_like(s)
    w[0] = (s[0] / det_s + z[0] / det_z) * half
    w[1:] = (s[1:] / det_s - z[1:] / det_z) * half
    eta2 = det_s / det_z
    eta = np.sqrt(eta2)
    scaled = eta * _turned(w, z, 1.0)  # lambda
    solve = _factored(programs.E, w, eta2)
    gap = programs.b - _applied(programs.E, x)
    mu = (s * z).sum(axis=(0, 1, 2)) / (2.0 * m)

    def direction(q: Vector | None) -> tuple[Vector, Vector, Vector, Vector]:
        """(dx, y + dy, ds, dz), for q = W^-1 times the target divided by lambda; for none, of the predictor."""
        right = programs.a if q is None else programs.a + _gathered(q)
        dx, y_new = solve(right, gap)
        ds = _spread(dx)
        vs = (w[0] * ds[0] - w[1] * ds[1] - w[2] * ds[2]) * (2.0 / eta2)  # W^-2 = (2 v v^T - J) / eta^2
        dz = -z
        dz[0] -= vs * w[0] - ds[0] / eta2
        dz[1:] += vs * w[1:] - ds[1:] / eta2
        return dx, y_new, ds, dz if q is None else dz + q

    _, _, ds, dz = direction(None)
    alpha, beta = np.minimum(_room(s, ds), 1.0), np.minimum(_room(z, dz), 1.0)
    after = ((s + alpha * ds) * (z + beta * dz)).sum(axis=(0, 1, 2)) / (2.0 * m)
    center = np.clip(after / mu, 0.0, 1.0) ** 3
    ds, dz = _turned(w, ds, -1.0) / eta, _turned(w, dz, 1.0) * eta
    target = -_product(ds, dz)
    target[0] += center * mu
    q = _turned(w, _divided(scaled, target), -1.0) / eta
    dx, y_new, ds, dz = direction(q)
    alpha = np.minimum(SHORT * _room(s, ds), 1.0)
    beta = np.minimum(SHORT * _room(z, dz), 1.0)
    return x + alpha * dx, y + beta * (y_new - y), z + beta * dz


def _slacks(x: Vector) -> Vector:
    """(1 + s, u) and (1 - s, u), shape (3, 2, m, B)."""
    result = _spread(x)
    result[0] += 1.0
    return result


def _spread(x: Vector) -> Vector:
    """(s, u) and (-s, u), shape (3, 2, m, B)."""
    result = np.empty((3, 2, *x.shape[1:]))
    result[0, 0], result[0, 1] = x[2], -x[2]
    result[1:] = x[:2, None]
    return result


def _gathered(z: Vector) -> Vector:
    """The transpose of `_spread`, shape (3, m, B)."""
    result = np.empty((3, *z.shape[2:]))
    result[:2] = z[1:, 0] + z[1:, 1]
    result[2] = z[0, 0] - z[0, 1]
    return result


def _det(s: Vector) -> Vector:
    """The product of a vector's eigenvalues in the algebra of the second-order cone: s_0^2 - |s_1|^2."""
    size = np.hypot(s[1], s[2])
    result: Vector = (s[0] - size) * (s[0] + size)
    return result


def _turned(w: Vector, z: Vector, sign: float) -> Vector:
    """W z / eta, or eta W^-1 z if the sign is -1."""
    along = sign * (w[1] * z[1] + w[2] * z[2])
    result = np.empty_like(z)
    result[0] = w[0] * z[0] + along
    result[1:] = z[1:] + sign * (z[0] + along / (1.0 + w[0])) * w[1:]
    return result


def _product(a: Vector, b: Vector) -> Vector:
    """The product of the algebra: (a . b, a_0 b_1 + b_0 a_1)."""
    result: Vector = a[0] * b + b[0] * a
    result[0] = (a * b).sum(axis=0)
    return result


def _divided(a: Vector, b: Vector) -> Vector:
    """The x whose product with a is b."""
    result = np.empty_like(b)
    result[0] = (a[0] * b[0] - a[1] * b[1] - a[2] * b[2]) / _det(a)
    result[1:] = (b[1:] - result[0] * a[1:]) / a[0]
    return result


def _room(s: Vector, ds: Vector) -> Vector:
    """How many times ds can be added to s, inside its cone, shape (B,)."""
    size, det = np.hypot(ds[1], ds[2]), _det(s)
    square = (ds[0] - size) * (ds[0] + size)
    half = s[0] * ds[0] - s[1] * ds[1] - s[2] * ds[2]
    root = np.sqrt(np.maximum(half**2 - square * det, 0.0))
    # The positive root nearest to zero of square t^2 + 2 half t + det, without cancellation.
    room = np.where(half < 0.0, det / (root - half), (half + root) / -square)
    result: Vector = np.where(ds[0] < size, room, np.inf).min(axis=(0, 1))
    return result


def _applied(E: Vector, x: Vector) -> Vector:
    """E x, shape (u, B)."""
    result: Vector = (E * x).sum(axis=(1, 2))
    return result


def _transposed(E: Vector, y: Vector) -> Vector:
    """E^T y, shape (3, m, B)."""
    result: Vector = (E * y[:, None, None]).sum(axis=0)
    return result


def _factored(E: Vector, w: Vector, eta2: Vector) -> Callable[[Vector, Vector], tuple[Vector, Vector]]:
    """Solves H dx + E^T y = r, E dx = g with H the sum of both cones' S^T W^-2 S, blocks of three by three."""
    inverse = 1.0 / eta2
    twice = 2.0 * inverse
    total = inverse.sum(axis=0)
    h00, h11 = total + (twice * w[1] ** 2).sum(axis=0), total + (twice * w[2] ** 2).sum(axis=0)
    h01, h22 = (twice * w[1] * w[2]).sum(axis=0), (twice * w[0] ** 2).sum(axis=0) - total
    cross = twice * w[0]
    h02 = cross[1] * w[1, 1] - cross[0] * w[1, 0]
    h12 = cross[1] * w[2, 1] - cross[0] * w[2, 0]
    # H = L D L^T
    l10, l20 = h01 / h00, h02 / h00
    d1 = np.maximum(h11 - l10 * h01, ROUNDING * h11)
    l21 = (h12 - l10 * h02) / d1
    d2 = np.maximum(h22 - l20 * h02 - l21**2 * d1, ROUNDING * h22)
    D = np.stack([h00, d1, d2])

    def forward(r: Vector) -> Vector:
        """L^-1 r for r of shape (..., 3, m, B)."""
        result: Vector = r.copy()
        result[..., 1, :, :] -= l10 * r[..., 0, :, :]
        result[..., 2, :, :] -= l20 * r[..., 0, :, :] + l21 * result[..., 1, :, :]
        return result

    def backward(r: Vector) -> Vector:
        """L^-T D^-1 r for r of shape (3, m, B)."""
        result: Vector = r / D
        result[1] -= l21 * result[2]
        result[0] -= l10 * result[1] + l20 * result[2]
        return result

    F = forward(E)
    weighted = F / D
    u = len(E)
    S = np.empty((u, u, E.shape[-1]))
    for i in range(u):
        for j in range(i + 1):
            S[i, j] = (F[i] * weighted[j]).sum(axis=(0, 1))
    S[np.arange(u), np.arange(u)] += REGULAR * np.einsum("iib->b", S) + 1e-300
    cholesky = _cholesky(S)

    def solve(r: Vector, g: Vector) -> tuple[Vector, Vector]:
        reduced = forward(r)
        y = _cholesky_solved(cholesky, (weighted * reduced).sum(axis=(1, 2)) - g)
        dx = backward(reduced - _transposed(F, y))
        # Close to the border H is all but singular, and what rounding then does to E dx is taken back once.
        dy = _cholesky_solved(cholesky, _applied(E, dx) - g)
        return dx - backward(_transposed(F, dy)), y + dy

    return solve


def _cholesky(S: Vector) -> Vector:
    """The lower triangular L with L L^T = S, shape (u, u, B), of which the lower triangle is used."""
    L = np.zeros_like(S)
    for j in range(len(S)):
        L[j, j] = np.sqrt(S[j, j] - (L[j, :j] ** 2).sum(axis=0))
        for i in range(j + 1, len(S)):
            L[i, j] = (S[i, j] - (L[i, :j] * L[j, :j]).sum(axis=0)) / L[j, j]
    return L


def _cholesky_solved(L: Vector, r: Vector) -> Vector:
    """S^-1 r for r of shape (u, B)."""
    y: Vector = r.copy()
    for i in range(len(r)):
        y[i] = (y[i] - (L[i, :i] * y[:i]).sum(axis=0)) / L[i, i]
    for i in reversed(range(len(r))):
        y[i] = (y[i] - (L[i + 1 :, i] * y[i + 1 :]).sum(axis=0)) / L[i, i]
    return y
