"""The programs of `climber.programs.double_cones` as Clarabel solves them.

Where pyramids stand for the cones they are linear. With cones it is slower, and there for the few programs in a
thousand that the method of that module does not get to the end of.
"""

from __future__ import annotations

import numpy as np

from climber.programs.blocks import solve_each
from climber.programs.double_cones import ConePrograms, ConeSolutions
from climber.stance import Vector

TOGETHER = 64  # programs in one call of the solver
INSIDE = 1.0 - 1e-12


def maximise_by_clarabel(programs: ConePrograms, start: Vector) -> ConeSolutions:
    """Solves programs.

    The solver is exact but for rounding, which is taken out of its points by going that little towards `start`.

    Args:
        programs: The programs.
        start: Points strictly inside the cones or pyramids with E x = b, shape (3, m, B).
    """
    u, B = programs.b.shape
    x, y = _solved(programs)
    x, y = np.where(np.isnan(x), start, x), np.nan_to_num(y)  # where the solver gives up
    gap = programs.b - (programs.E * x).sum(axis=(1, 2))
    E = programs.E.reshape(u, -1, B).transpose(2, 0, 1)
    x += np.einsum("bnu,ub->nb", np.linalg.pinv(E, rcond=1e-9), gap).reshape(x.shape)
    outside, inside = _size(programs, x).max(axis=0), _size(programs, start).max(axis=0)
    share = np.clip((outside - INSIDE) / np.maximum(outside - inside, 1e-300), 0.0, 1.0)
    x += share * (start - x)
    return ConeSolutions(x, y, (programs.a * x).sum(axis=(0, 1)), programs.bound(y))


def _solved(programs: ConePrograms) -> tuple[Vector, Vector]:
    """X (3, m, B) and y (u, B); NaN where the solver gives up."""
    u, _, m, B = programs.E.shape
    n, sides = 3 * m, programs.section.sides
    R, C = np.zeros((2, len(sides), m, 3, m)), np.zeros((2, m, 3, 3, m))
    for i in range(m):
        R[:, :, i, :2, i] = sides
        R[0, :, i, 2, i], R[1, :, i, 2, i] = 1.0, -1.0
        C[:, i, 1, 0, i] = C[:, i, 2, 1, i] = 1.0
        C[0, i, 0, 2, i], C[1, i, 0, 2, i] = -1.0, 1.0
    rows, cones = R.reshape(-1, n), C.reshape(-1, 3, n) if not len(sides) else np.zeros((0, 3, n))
    tops = np.broadcast_to([1.0, 0.0, 0.0], (B, len(cones), 3))
    x, y, _ = solve_each(
        -programs.a.reshape(n, B).T,
        programs.E.reshape(u, n, B).transpose(2, 0, 1),
        programs.b.T,
        np.broadcast_to(rows, (B, *rows.shape)),
        np.ones((B, len(rows))),
        np.broadcast_to(cones, (B, *cones.shape)),
        tops,
        together=TOGETHER,
    )
    return x.T.reshape(3, m, B), y.T


def _size(programs: ConePrograms, x: Vector) -> Vector:
    """How many times its own size each cone or pyramid must be to hold x, shape (m, B)."""
    result: Vector = programs.section.size(np.moveaxis(x[:2], 0, -1)) + np.abs(x[2])
    return result
