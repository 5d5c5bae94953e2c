"""Small symmetric, positive definite systems of equations, a few microseconds each."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from climber.stance import Vector


def solved(A: Vector, B: Vector) -> Vector:
    """A^-1 B by Cholesky's factorization; by elimination if rounding left A indefinite, by least squares if singular.

    Args:
        A: Symmetric and positive definite, shape (n, n).
        B: Right-hand sides, shape (n,) or (n, m).
    """
    _, X, failed = dposv(A, B)
    if not failed:
        return np.asarray(X)
    try:
        return np.asarray(np.linalg.solve(A, B))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(A, B)[0])
