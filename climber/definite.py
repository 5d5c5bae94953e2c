"""Small symmetric, positive definite systems of equations, a few microseconds each."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from climber.stance import Vector


class Factored:
    """A symmetric and positive definite matrix, by its Cholesky factorization."""

    def __init__(self, A: Vector) -> None:
        """Factors A, shape (n, n)."""
        self._A = A
        self._factor, self._failed = dpotrf(A)

    def solved(self, B: Vector) -> Vector:
        """A^-1 B, shape (n,) or (n, m) as B; by elimination if rounding has left A indefinite."""
        return np.asarray(np.linalg.solve(self._A, B) if self._failed else dpotrs(self._factor, B)[0])


def solved(A: Vector, B: Vector) -> Vector:
    """A^-1 B for A symmetric and positive definite, shapes (n, n) and (n,) or (n, m)."""
    return Factored(A).solved(B)
