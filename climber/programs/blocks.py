"""Many small quadratic programs of one shape, with second-order cones or without, in one call of Clarabel."""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import sparse

from climber.stance import Vector

FEASIBILITY = 1e-9  # accuracy asked of the constraints
GAP = 1e-11  # accuracy asked of the optimal cost; that of x goes with its square root
REDUCED = 1e-7  # accuracy that is still a solution if Clarabel gets no further


def solve_blocks(
    P: Vector | None,
    q: Vector,
    E: Vector,
    b: Vector,
    G: Vector,
    g: Vector,
    C: Vector | None = None,
    d: Vector | None = None,
) -> Vector | None:
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
        The solutions, shape (K, n), or None if Clarabel found none, be it infeasible or difficult.
    """
    found = solve_blocks_and_multipliers(P, q, E, b, G, g, C, d)
    return None if found is None else found[0]


def solve_blocks_and_multipliers(
    P: Vector | None,
    q: Vector,
    E: Vector,
    b: Vector,
    G: Vector,
    g: Vector,
    C: Vector | None = None,
    d: Vector | None = None,
) -> tuple[Vector, Vector, Vector] | None:
    """`solve_blocks`, and the multipliers y of E x = b, shape (K, u), and z >= 0 of G x <= g, shape (K, r).

    They satisfy P x + q + E^T y + G^T z + ... = 0.
    """
    K, n = q.shape
    u, r = E.shape[1], G.shape[1]
    if K == 0:
        return np.zeros((0, n)), np.zeros((0, u)), np.zeros((0, r))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.presolve_enable = False
    settings.tol_feas = FEASIBILITY
    settings.tol_gap_abs = settings.tol_gap_rel = GAP
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
    solver = clarabel.DefaultSolver(quadratic, q.ravel(), constraints, np.concatenate(right), cones, settings)
    solution = solver.solve()
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        return None
    multipliers = np.array(solution.z)
    y, z = multipliers[: K * u].reshape(K, u), multipliers[K * u : K * (u + r)].reshape(K, r)
    return np.array(solution.x).reshape(K, n), y, z


def _stack(blocks: Vector, rows: Vector, num_rows: int) -> sparse.csc_matrix:
    """Blocks (K, m, n) side by side in a matrix whose row `rows[k, i]` holds row i of block k."""
    K, _, n = blocks.shape
    # Entries that are zero in every block are left out; column by column is the order of the matrix itself.
    column, row = np.nonzero((blocks != 0.0).any(axis=0).T)
    counts = np.bincount(column, minlength=n)
    starts = np.concatenate([[0], np.cumsum(np.tile(counts, K))])
    return sparse.csc_matrix((blocks[:, row, column].ravel(), rows[:, row].ravel(), starts), shape=(num_rows, K * n))
