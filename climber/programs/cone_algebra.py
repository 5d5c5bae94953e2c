"""What `climber.programs.double_cones` reckons with: second-order cones of three dimensions, by the thousand.

A vector of the algebra has its three entries along the first axis, and programs are along the last; s and z have the
shape (3, 2, m, B), the two cones of each of m double cones of B programs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from climber.stance import Vector

ROUNDING = 1e-16
REGULAR = 1e-14  # added to the diagonal of the equations, in parts of their trace, for those that are dependent


def slacks(x: Vector) -> Vector:
    """(1 + s, u) and (1 - s, u), shape (3, 2, m, B)."""
    result = spread(x)
    result[0] += 1.0
    return result


def spread(x: Vector) -> Vector:
    """(s, u) and (-s, u), shape (3, 2, m, B)."""
    result = np.empty((3, 2, *x.shape[1:]))
    result[0, 0], result[0, 1] = x[2], -x[2]
    result[1:] = x[:2, None]
    return result


def gathered(z: Vector) -> Vector:
    """The transpose of `spread`, shape (3, m, B)."""
    result = np.empty((3, *z.shape[2:]))
    result[:2] = z[1:, 0] + z[1:, 1]
    result[2] = z[0, 0] - z[0, 1]
    return result


def det(s: Vector) -> Vector:
    """The product of a vector's eigenvalues in the algebra of the second-order cone: s_0^2 - |s_1|^2."""
    size = np.hypot(s[1], s[2])
    result: Vector = (s[0] - size) * (s[0] + size)
    return result


def turned(w: Vector, z: Vector, sign: float) -> Vector:
    """W z / eta, or eta W^-1 z if the sign is -1."""
    along = sign * (w[1] * z[1] + w[2] * z[2])
    result = np.empty_like(z)
    result[0] = w[0] * z[0] + along
    result[1:] = z[1:] + sign * (z[0] + along / (1.0 + w[0])) * w[1:]
    return result


def product(a: Vector, b: Vector) -> Vector:
    """The product of the algebra: (a . b, a_0 b_1 + b_0 a_1)."""
    result: Vector = a[0] * b + b[0] * a
    result[0] = (a * b).sum(axis=0)
    return result


def divided(a: Vector, b: Vector) -> Vector:
    """The x whose product with a is b."""
    result = np.empty_like(b)
    result[0] = (a[0] * b[0] - a[1] * b[1] - a[2] * b[2]) / det(a)
    result[1:] = (b[1:] - result[0] * a[1:]) / a[0]
    return result


def room(s: Vector, ds: Vector) -> Vector:
    """How many times ds can be added to s, inside its cone, shape (B,)."""
    size, inner = np.hypot(ds[1], ds[2]), det(s)
    square = (ds[0] - size) * (ds[0] + size)
    half = s[0] * ds[0] - s[1] * ds[1] - s[2] * ds[2]
    root = np.sqrt(np.maximum(half**2 - square * inner, 0.0))
    # The positive root nearest to zero of square t^2 + 2 half t + inner, without cancellation.
    least = np.where(half < 0.0, inner / (root - half), (half + root) / -square)
    result: Vector = np.where(ds[0] < size, least, np.inf).min(axis=(0, 1))
    return result


def applied(E: Vector, x: Vector) -> Vector:
    """E x, shape (u, B)."""
    result: Vector = (E * x).sum(axis=(1, 2))
    return result


def transposed(E: Vector, y: Vector) -> Vector:
    """E^T y, shape (3, m, B)."""
    result: Vector = (E * y[:, None, None]).sum(axis=0)
    return result


def factored(E: Vector, w: Vector, eta2: Vector) -> Callable[[Vector, Vector], tuple[Vector, Vector]]:
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
    lower = cholesky(S)

    def solve(r: Vector, g: Vector) -> tuple[Vector, Vector]:
        reduced = forward(r)
        y = cholesky_solved(lower, (weighted * reduced).sum(axis=(1, 2)) - g)
        dx = backward(reduced - transposed(F, y))
        # Close to the border H is all but singular, and what rounding then does to E dx is taken back once.
        dy = cholesky_solved(lower, applied(E, dx) - g)
        return dx - backward(transposed(F, dy)), y + dy

    return solve


def cholesky(S: Vector) -> Vector:
    """The lower triangular L with L L^T = S, shape (u, u, B), of which the lower triangle is used."""
    L = np.zeros_like(S)
    for j in range(len(S)):
        L[j, j] = np.sqrt(S[j, j] - (L[j, :j] ** 2).sum(axis=0))
        for i in range(j + 1, len(S)):
            L[i, j] = (S[i, j] - (L[i, :j] * L[j, :j]).sum(axis=0)) / L[j, j]
    return L


def cholesky_solved(L: Vector, r: Vector) -> Vector:
    """S^-1 r for r of shape (u, B)."""
    y: Vector = r.copy()
    for i in range(len(r)):
        y[i] = (y[i] - (L[i, :i] * y[:i]).sum(axis=0)) / L[i, i]
    for i in reversed(range(len(r))):
        y[i] = (y[i] - (L[i + 1 :, i] * y[i + 1 :]).sum(axis=0)) / L[i, i]
    return y
