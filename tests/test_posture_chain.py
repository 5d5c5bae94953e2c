"""Postures drawn together: never worse, feasible, and as good as looking around can tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from climbs import beginning
from hypothesis import given, settings
from hypothesis import strategies as st

from climber.objective import Objective
from climber.phases import instants
from climber.plan_parts import OBJECTIVE_KINDS, ObjectiveKind
from climber.programs.posture_chain import Instant, PostureChain
from climber.stance import Vector

seeds = st.integers(0, 2**32 - 1)


def candidates(seed: int, alike: bool = False) -> list[Instant]:
    """The beginning of a climb by transition postures as sampling found them, any of them.

    Args:
        seed: Which of them.
        alike: Whether only by such as bend their limbs as the planner's choice does.
    """
    rng = np.random.default_rng(seed)
    planner, way = beginning()
    result = []
    for k, instant in enumerate(instants(way.stretches, way.postures, first=True)):
        moving = [s.limb for s in way.stretches[max(k - 1, 0) : k + 1] if s.limb is not None]
        q = way.postures[k][None]
        if moving:
            found = planner.transitions.transition(instant.manifold.contacts, moving[0])
            same = (found.branches == planner.body.branches(q[0])).all(axis=1)
            q = found.q[same] if alike else found.q
        result.append(replace(instant, q=q[rng.integers(len(q))]))
    return result


def feasible(instant: Instant, q: Vector) -> bool:
    """Whether a posture keeps the contacts of its instant and meets its conditions, by the manifold alone."""
    body = instant.manifold.body
    feet = body.kinematics.feet(q[None])[0]
    off = max(float(np.linalg.norm((feet[i] - point)[:2])) for i, point in instant.manifold.points.items())
    return off < 1e-9 and float(instant.manifold.slack(q[None])[0]) >= 0.0


@settings(max_examples=8, deadline=None)
@given(seeds, st.sampled_from(OBJECTIVE_KINDS))
def test_postures_drawn_together_cost_no_more_and_are_feasible(seed: int, kind: ObjectiveKind) -> None:
    given_ = candidates(seed)
    chain = PostureChain(given_, Objective.of(kind, beginning()[0].body))
    before = chain.cost([instant.q for instant in given_])
    found = chain.solve()
    assert chain.cost(found) <= before
    for instant, q in zip(given_, found, strict=True):
        assert feasible(instant, q)
        assert instant.manifold.body.branches(q) == instant.manifold.body.branches(instant.q)


@settings(max_examples=5, deadline=None)
@given(seeds)
def test_postures_that_are_not_free_stay(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given_ = [replace(instant, free=bool(rng.random() < 0.5)) for instant in candidates(seed)]
    found = PostureChain(given_, beginning()[0].objective).solve()
    for instant, q in zip(given_, found, strict=True):
        if not instant.free:
            assert np.array_equal(q, instant.q)


@pytest.mark.parametrize("kind", OBJECTIVE_KINDS)
def test_no_posture_nearby_is_better_than_where_the_chain_ends(kind: ObjectiveKind) -> None:
    """A second method: looking around at random."""
    rng = np.random.default_rng(1)
    given_ = candidates(5)
    chain = PostureChain(given_, Objective.of(kind, beginning()[0].body))
    found = chain.solve(iterations=60)
    cost = chain.cost(found)
    for k, instant in enumerate(given_):
        chart = instant.manifold.chart(found[k])
        u = chart.coordinates(found[k]) + rng.normal(0, 0.01, (200, len(chart.independent))) / chart.scale
        q, reach = chart.expand(u)
        q = q[(reach > instant.manifold.margins.reach) & (instant.manifold.slack(q) >= 0)]
        for other in q:
            assert chain.cost([*found[:k], other, *found[k + 1 :]]) > cost - 0.01 * abs(cost)


def test_the_climb_is_much_shorter_by_postures_drawn_together() -> None:
    given_ = candidates(2, alike=True)
    chain = PostureChain(given_, beginning()[0].objective)
    assert chain.cost(chain.solve()) < 0.8 * chain.cost([instant.q for instant in given_])


def test_a_pelvis_that_must_be_in_a_region_stays_in_it_and_goes_to_its_edge() -> None:
    """Alone in its region the pelvis is drawn to where the neighbours are."""
    planner, way = beginning()
    given_ = instants(way.stretches, way.postures)
    here = given_[-1].q[planner.body.robot.origin_q[:2]]
    region = shapely.Point(here[0], here[1] + 0.01).buffer(0.0101)
    away = [replace(instant, free=False) for instant in given_[:-1]]
    far = way.postures[-2].copy()
    far[:2] += [0.0, -0.2]
    chain = PostureChain([*away[:-1], replace(away[-1], q=far), replace(given_[-1], region=region)], planner.objective)
    found = chain.solve()
    assert shapely.contains_xy(region, *found[-1][:2])
    assert region.boundary.distance(shapely.Point(found[-1][:2])) < 2e-3
