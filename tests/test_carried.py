"""What solved instants say of others: never anything that their own programs deny."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import robot
from test_torque import ALL, STANDING, instants_of, on, wall_under
from test_torque_space import clinging, instants

from climber.dynamics import evaluate_at_rest
from climber.programs.carried import FIRST, Precedents, can_carry, shortfall
from climber.programs.instants import Instants, Margin
from climber.programs.torque_blocks import least_violation
from climber.robot import Robot
from climber.stance import Vector

LEMUR = Robot("package://climber/lemur/lemur.urdf")
SMALL = 1e-3  # [N, N m] violations smaller than this are left to rounding
seeds = st.integers(0, 2**32 - 1)


def clinging_all_over(seed: int) -> Instants:
    """Sixty postures about one, on holds that lean and rub as it happens, with motors as strong as it happens."""
    rng = np.random.default_rng(seed)
    wall, q = clinging(LEMUR, rng.uniform(-0.2, 0.5), friction=rng.uniform(0.3, 1.0))
    q = q + rng.uniform(0.05, 0.5) * rng.normal(size=(60, 18))
    some = instants(LEMUR, wall, q, Margin())
    return replace(some, limit=rng.uniform(0.1, 1.0) * some.limit)


def standing_all_over(seed: int) -> Instants:
    """Sixty postures of a robot in a plane."""
    rng = np.random.default_rng(seed)
    machine = robot("quadruped")
    wall = wall_under(machine, STANDING, friction=rng.uniform(0.2, 1.0), min_force=rng.uniform(0.0, 1.0))
    q = STANDING + rng.uniform(0.05, 0.5) * rng.normal(size=(60, 11))
    some = instants_of(machine, wall, on(ALL), *evaluate_at_rest(machine, q, ALL))
    return replace(some, limit=rng.uniform(0.05, 1.0) * some.limit)


def violations(some: Instants) -> Vector:
    return np.concatenate([least_violation(some[k : k + 1]).s for k in range(len(some))])


@settings(max_examples=8, deadline=None)
@given(seeds, st.sampled_from([clinging_all_over, standing_all_over]))
def test_instants_that_can_be_carried_are_those_whose_own_program_says_so(seed: int, family) -> None:  # type: ignore[no-untyped-def]
    some = family(seed)
    s = violations(some)
    clear = np.abs(s) > SMALL
    precedents = Precedents()
    parts = [can_carry(some[:20], precedents), can_carry(some[20:], precedents)]
    for answer in (can_carry(some), np.concatenate(parts)):
        assert (answer == (s <= 0.0))[clear].all()


@settings(max_examples=8, deadline=None)
@given(seeds, st.sampled_from([clinging_all_over, standing_all_over]))
def test_no_virtual_motion_speaks_against_what_is_carried(seed: int, family) -> None:  # type: ignore[no-untyped-def]
    some, rng = family(seed), np.random.default_rng(seed)
    least = least_violation(some)
    y = np.concatenate([least.y, rng.normal(size=least.y.shape)])
    w = np.concatenate([least.w, rng.normal(size=least.w.shape)])
    short = shortfall(some, y, w)
    assert (short[:, least.s <= 0.0] <= 1e-7).all()
    # Its own multipliers tell exactly by how much an instant's limits would have to give way, in their units.
    beyond = np.flatnonzero(np.isfinite(least.s) & (least.s > SMALL))
    assert (short[beyond, beyond] > 0.0).all()


def test_few_programs_are_solved_for_many_postures_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    wall, q = clinging(LEMUR)
    q = q + 0.03 * np.random.default_rng(0).normal(size=(200, 18))
    held = instants(LEMUR, wall, q, Margin())
    solved = []

    def counted(some: Instants) -> object:
        solved.append(len(some))
        return least_violation(some)

    monkeypatch.setattr("climber.programs.carried.least_violation", counted)
    for scale, answer in ((1.0, True), (0.1, False)):
        solved.clear()
        some = replace(held, limit=scale * held.limit)
        precedents = Precedents()
        assert (can_carry(some, precedents) == answer).all() and sum(solved) <= 4 * FIRST
        before = len(solved)
        assert (can_carry(some, precedents) == answer).all() and len(solved) == before
