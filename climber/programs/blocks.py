"""Many small quadratic programs of one shape, with second-order cones or without, in one call of Clarabel."""

from __future__ import annotations

from typing import NamedTuple

import clarabel
import numpy as np
from scipy import sparse

from climber.stance import Vector

FEASIBILITY = 1e-9  # accuracy asked of the constraints
GAP = 1e-11  # accuracy asked of the optimal cost; that of x goes with its square root
REDUCED = 1e-7  # accuracy that is still a solution if Clarabel gets no further
SHORTER = 0.9  # share of the way to the border that a step goes, where longer ones go to and fro for ever


class BlockSolutions(NamedTuple):
    """Solutions of K programs, with P x + q + E^T y + G^T z + ... = 0.

    Attributes:
        x: Shape (K, n).
        y: The multipliers of E x = b, shape (K, u).
        z: Those of G x <= g, at least zero, shape (K, r).
    """

    x: Vector
    y: Vector
    z: Vector


def plain_settings(feasibility: float, gap: float) -> clarabel.DefaultSettings:
    """Clarabel as it is quickest with small programs: in one thread, silent, and with the rows as they are.

    Args:
        feasibility: Accuracy asked of the constraints.
        gap: Accuracy asked of the cost, relative and absolute.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.presolve_enable = False
    settings.tol_feas = feasibility
    settings.tol_gap_abs = settings.tol_gap_rel = gap
    return settings


def solve_blocks(
    P: Vector | None,
    q: Vector,
    E: Vector,
    b: Vector,
    G: Vector,
    g: Vector,
    C: Vector | None = None,
    d: Vector | None = None,
) -> BlockSolutions | None:
    """Solves K programs at once as one block-diagonal program.

        min  x^T P x / 2 + q^T x   subject to  E x = b,  G x <= g,  d_i - C_i x in a second-order cone for i = 1..c

    where a vector is in the cone if its first entry is at least the length of the rest.

    Building matrices for one call costs less than K calls, but the program is infeasible when one of the K is.

    Args:
        P: Positive semidefinite, shape (K, n, n); None for linear programs.
        q: Shape (K, n).
        E: Shape (K, u, n).
        b: Shape (K, u).
        G: Shape (K, r, n).
        g: Shape (K, r), finite.
        C: Shape (K, c, m, n); None for no cones.
        d: Shape (K, c, m).

    Returns:
        The solutions, or None if Clarabel found none, be it infeasible or difficult.
    """
    K, n = q.shape
    u, r = E.shape[1], G.shape[1]
    if K == 0:
        return BlockSolutions(np.zeros((0, n)), np.zeros((0, u)), np.zeros((0, r)))
    settings = plain_settings(FEASIBILITY, GAP)
    settings.reduced_tol_feas = settings.reduced_tol_gap_abs = settings.reduced_tol_gap_rel = REDUCED
    rows = [np.arange(K * u).reshape(K, u), K * u + np.arange(K * r).reshape(K, r)]
    blocks, right = [E, G], [b.ravel(), g.ravel()]
    cones: list[object] = [clarabel.ZeroConeT(K * u), clarabel.NonnegativeConeT(K * r)]
    if C is not None and d is not None and d.size:
        _, c, m = d.shape
        rows.append(K * (u + r) + np.arange(K * c * m).reshape(K, c * m))
        blocks.append(C.reshape(K, c * m, n))
        right.append(d.ravel())
        cones += [clarabel.SecondOrderConeT(m)] * (K * c)
    constraints = _stack(np.concatenate(blocks, axis=1), np.concatenate(rows, axis=1), sum(map(len, right)))
    columns = np.arange(K * n).reshape(K, n)
    quadratic = sparse.csc_matrix((K * n, K * n)) if P is None else _stack(np.triu(P), columns, K * n)
    program = quadratic, q.ravel(), constraints, np.concatenate(right), cones
    solution = clarabel.DefaultSolver(*program, settings).solve()
    if solution.status == clarabel.SolverStatus.MaxIterations:
        settings.max_step_fraction = SHORTER
        solution = clarabel.DefaultSolver(*program, settings).solve()
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        return None
    multipliers = np.array(solution.z)
    y, z = multipliers[: K * u].reshape(K, u), multipliers[K * u : K * (u + r)].reshape(K, r)
    return BlockSolutions(np.array(solution.x).reshape(K, n), y, z)


def solve_each(
    q: Vector,
    E: Vector,
    b: Vector,
    G: Vector,
    g: Vector,
    C: Vector | None = None,
    d: Vector | None = None,
    *,
    together: int | None = None,
    nudge: float = 0.0,
) -> BlockSolutions:
    """`solve_blocks` of linear costs, in halves where Clarabel gets no further with all at once.

    One program without a solution spoils the rest, and with cones Clarabel can stop short of a solution of dozens of
    programs each of which it solves.

    Args:
        q: Shape (K, n), as all that follow with shapes as in `solve_blocks`.
        E: The equations.
        b: Their right sides.
        G: The inequalities.
        g: Their right sides.
        C: The cones; None for none.
        d: Their right sides.
        together: How many programs go into one call of the solver; None for all.
        nudge: By how much at the most the inequalities of a program that is not solved alone may give way: a hair's
            breadth of difference can be enough for the solver to get on.

    Returns:
        The solutions, NaN for programs that are not solved alone.
    """
    K, r = g.shape
    x, y, z = np.full(q.shape, np.nan), np.full(b.shape, np.nan), np.full(g.shape, np.nan)

    def solve(first: int, last: int) -> None:
        rows = slice(first, last)
        cones = (None, None) if C is None or d is None else (C[rows], d[rows])
        found = solve_blocks(None, q[rows], E[rows], b[rows], G[rows], g[rows], *cones)
        if found is None and last - first == 1 and nudge:
            more = nudge * np.arange(1, r + 1) / r
            found = solve_blocks(None, q[rows], E[rows], b[rows], G[rows], g[rows] + more, *cones)
        if found is not None:
            x[rows], y[rows], z[rows] = found
        elif last - first > 1:
            middle = (first + last) // 2
            solve(first, middle)
            solve(middle, last)

    step = together or max(K, 1)
    for first in range(0, K, step):
        solve(first, min(first + step, K))
    return BlockSolutions(x, y, z)


def _stack(blocks: Vector, rows: Vector, num_rows: int) -> sparse.csc_matrix:
    """Blocks (K, m, n) side by side in a matrix whose row `rows[k, i]` holds row i of block k."""
    K, _, n = blocks.shape
    # Entries that are zero in every block are left out; column by column is the order of the matrix itself.
    column, row = np.nonzero((blocks != 0.0).any(axis=0).T)
    counts = np.bincount(column, minlength=n)
    starts = np.concatenate([[0], np.cumsum(np.tile(counts, K))])
    return sparse.csc_matrix((blocks[:, row, column].ravel(), rows[:, row].ravel(), starts), shape=(num_rows, K * n))
