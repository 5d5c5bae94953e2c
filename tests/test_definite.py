"""Positive definite systems of equations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from climber.definite import solved


@given(seed=st.integers(0, 10**6), n=st.integers(1, 12), m=st.integers(0, 18))
def test_what_is_solved_meets_the_equations(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    A, B = root @ root.T + np.eye(n), rng.normal(size=(n, m))
    before = A.copy()
    assert A @ solved(A, B) == pytest.approx(B, abs=1e-9)
    assert A @ solved(A, B.sum(axis=1)) == pytest.approx(B.sum(axis=1), abs=1e-9)
    assert np.array_equal(A, before)


def test_a_matrix_that_is_not_quite_definite_is_solved_all_the_same() -> None:
    A = np.diag([1.0, -1e-12])
    assert solved(A, np.array([2.0, 1e-12])) == pytest.approx([2.0, -1.0])


def test_of_a_singular_matrix_the_least_solution_is_given() -> None:
    A = np.zeros((3, 3))
    A[:2, :2] = 1e19
    assert solved(A, np.array([2e19, 2e19, 0.0])) == pytest.approx([1.0, 1.0, 0.0])
