"""Programs over double cones, all at once and by Clarabel, against cvxpy."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from climber.programs.cone_solver import maximise_by_clarabel
from climber.programs.double_cones import ConePrograms, greatest, maximise
from climber.programs.sections import EXACT, Section
from climber.stance import Vector

SECTIONS = [EXACT, Section("inscribed", 4), Section("circumscribed", 7)]


def random_programs(rng: np.random.Generator, m: int, B: int, section: Section) -> tuple[ConePrograms, Vector]:
    """Feasible programs with columns and equations that are zero or dependent here and there, and their starts."""
    E = rng.normal(size=(4, 3, m, B)) * rng.uniform(0.1, 10.0, (1, 1, m, B))
    E[:, :2, 0, ::3] = 0.0  # an interval
    E[3, :, :, ::4] = 2.0 * E[0, :, :, ::4]
    start = rng.uniform(-0.3, 0.3, (3, m, B))
    return ConePrograms(E, np.einsum("ucmb,cmb->ub", E, start), rng.normal(size=(3, m, B)), section), start


def size(x: Vector, section: Section) -> Vector:
    result: Vector = section.size(np.moveaxis(x[:2], 0, -1)) + np.abs(x[2])
    return result


@pytest.mark.parametrize("section", [None, *SECTIONS], ids=lambda s: s.name if s else "all at once")
@given(st.integers(0, 2**32 - 1), st.integers(2, 5))
@settings(max_examples=8, deadline=None)
def test_many_programs_are_solved_as_each_is_alone(section: Section | None, seed: int, m: int) -> None:
    programs, start = random_programs(np.random.default_rng(seed), m, 6, section or EXACT)
    if section is None:
        section = EXACT
        found = maximise(programs, start, lambda value, bound: bound - value < 1e-6)
        assert (found.bound - found.value < 1e-6).mean() > 0.8  # and what is not reached is told
    else:
        found = maximise_by_clarabel(programs, start)
        assert (found.bound - found.value < 1e-6).all()
    assert size(found.x, section).max() <= 1.0
    np.testing.assert_allclose(np.einsum("ucmb,cmb->ub", programs.E, found.x), programs.b, atol=1e-8)
    for i in range(6):
        x = cp.Variable((3, m))
        across = cp.norm(x[:2], axis=0) if section is EXACT else cp.max(section.sides @ x[:2], axis=0)
        balance = [cp.sum(cp.multiply(E, x)) == b for E, b in zip(programs.E[..., i], programs.b[:, i], strict=True)]
        problem = cp.Problem(
            cp.Maximize(cp.sum(cp.multiply(programs.a[..., i], x))), [across <= 1 - cp.abs(x[2]), *balance]
        )
        problem.solve(solver=cp.CLARABEL)
        assert found.value[i] - 1e-6 <= problem.value <= found.bound[i] + 1e-6


@pytest.mark.parametrize("section", SECTIONS, ids=lambda s: s.name)
def test_any_multipliers_bound_the_maximum(section: Section) -> None:
    rng = np.random.default_rng(1)
    programs, start = random_programs(rng, 3, 40, section)
    x = rng.normal(size=(200, 3, 3, 40))
    x /= np.maximum(size(x.transpose(1, 0, 2, 3), section), 1.0)[:, None]
    assert (np.einsum("cmb,ncmb->nmb", programs.a, x) <= greatest(programs.a, section) + 1e-12).all()
    for _ in range(20):
        assert (programs.bound(rng.normal(size=(4, 40))) >= (programs.a * start).sum(axis=(0, 1))).all()


def test_programs_that_are_good_enough_at_once_keep_their_start() -> None:
    programs, start = random_programs(np.random.default_rng(2), 3, 5, EXACT)
    found = maximise(programs, start, lambda value, bound: np.ones(len(value), dtype=bool))
    np.testing.assert_array_equal(found.x, start)
    assert (found.bound >= found.value).all()


def test_no_programs_have_no_solutions() -> None:
    programs, start = random_programs(np.random.default_rng(2), 3, 5, EXACT)
    none = np.zeros(0, dtype=int)
    assert maximise(programs[none], start[..., none], lambda value, bound: bound < value).x.shape == (3, 3, 0)
