import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from climber.programs.blocks import solve_blocks, solve_each
from climber.stance import Vector

Problem = tuple[Vector, Vector, Vector, Vector, Vector, Vector]


def random_problem(rng: np.random.Generator, K: int) -> Problem:
    """K feasible, bounded programs of 4 variables, with entries that are zero in all or only in some of them."""
    root, q = rng.normal(size=(K, 4, 4)), rng.normal(size=(K, 4))
    E, point = rng.normal(size=(K, 1, 4)), rng.normal(size=(K, 4))
    E[:, 0, 2] = 0.0
    box = np.broadcast_to(np.concatenate([np.eye(4), -np.eye(4)]), (K, 8, 4)).copy()
    box[rng.random(K) < 0.5, 0, 3] = 0.5
    g = np.einsum("kri,ki->kr", box, point) + rng.uniform(0.1, 1.0, (K, 8))
    return np.swapaxes(root, 1, 2) @ root, q, E, np.einsum("kui,ki->ku", E, point), box, g


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=15, deadline=None)
def test_the_blocks_are_solved_as_if_each_were_alone(seed: int, linear: bool) -> None:
    P, q, E, b, G, g = random_problem(np.random.default_rng(seed), 5)
    found = solve_blocks(None if linear else P, q, E, b, G, g)
    assert found is not None
    together = found.x
    for k in range(5):
        x = cp.Variable(4)
        cost = q[k] @ x + (0 if linear else 0.5 * cp.quad_form(x, cp.psd_wrap(P[k])))
        problem = cp.Problem(cp.Minimize(cost), [E[k] @ x == b[k], G[k] @ x <= g[k]])
        problem.solve(solver=cp.CLARABEL)
        value = q[k] @ together[k] + (0 if linear else 0.5 * together[k] @ P[k] @ together[k])
        assert value == pytest.approx(problem.value, abs=1e-6)
        np.testing.assert_allclose(E[k] @ together[k], b[k], atol=1e-8)
        assert (G[k] @ together[k] <= g[k] + 1e-8).all()


def test_one_infeasible_block_leaves_no_solution() -> None:
    P, q, E, b, G, g = random_problem(np.random.default_rng(1), 3)
    assert solve_blocks(P, q, E, b, G, g) is not None
    g[1, 3], g[1, 7] = -1.0, -1.0  # x_3 at most -1 and at least 1
    assert solve_blocks(P, q, E, b, G, g) is None


def test_no_blocks_have_an_empty_solution() -> None:
    P, q, E, b, G, g = random_problem(np.random.default_rng(1), 1)
    answer = solve_blocks(P[:0], q[:0], E[:0], b[:0], G[:0], g[:0])
    assert answer is not None
    assert answer.x.shape == (0, 4)


@pytest.mark.parametrize("together", [None, 2])
def test_a_block_without_a_solution_spoils_no_other(together: int | None) -> None:
    _, q, E, b, G, g = random_problem(np.random.default_rng(1), 7)
    whole = solve_each(q, E, b, G, g, together=together)
    g[4, 3], g[4, 7] = -1.0, -1.0  # x_3 at most -1 and at least 1
    found = solve_each(q, E, b, G, g, together=together)
    for part, before in zip(found, whole, strict=True):
        assert np.isnan(part[4]).all()
        np.testing.assert_allclose(np.delete(part, 4, axis=0), np.delete(before, 4, axis=0), atol=1e-6)
    assert np.abs(q + np.einsum("kun,ku->kn", E, whole.y) + np.einsum("krn,kr->kn", G, whole.z)).max() < 1e-6
