"""Rounds of improvement: every one is as good as the last or better, feasible, and the same for the same seed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from climbs import beginning

from climber.climb_search import ClimbSearch
from climber.improve import Improver, Progress
from climber.manifold import Body
from climber.margins import phase_margins
from climber.phases import Curves, PhasePlanner, Stretch, Way
from climber.plan import plan_climb
from climber.plan_parts import OBJECTIVE_KINDS, ObjectiveKind
from climber.scenario import Scenario, load_scenario
from climber.verify import verify

ROUNDS = 8


@cache
def improved(kind: ObjectiveKind, seed: int = 0, rounds: int = ROUNDS) -> tuple[Way, Way, Progress]:
    """The beginning of a climb, and what rounds make of it."""
    planner, way = beginning(objective=kind, free_start=True)
    improver = Improver(planner.phases, planner.budget, seed)
    better, progress = improver.improve(way, time.perf_counter(), rounds)
    assert improver.rounds == rounds
    return way, better, progress


@pytest.mark.parametrize("kind", OBJECTIVE_KINDS)
def test_values_on_record_go_down_and_the_last_is_that_of_the_climb(kind: ObjectiveKind) -> None:
    planner, _ = beginning(objective=kind, free_start=True)
    way, better, progress = improved(kind)
    seconds, values = zip(*progress.entries, strict=True)
    assert all(b < a for a, b in pairwise(values))
    assert list(seconds) == sorted(seconds)
    assert values[0] == planner.objective.value(planner.body, way.motions)
    assert values[-1] == planner.objective.value(planner.body, better.motions)


@pytest.mark.parametrize("kind", OBJECTIVE_KINDS)
def test_improved_climbs_are_feasible_and_go_on_where_they_stop(kind: ObjectiveKind) -> None:
    _, better, _ = improved(kind)
    for stretch, curves, motion in zip(better.stretches, better.curves, better.motions, strict=True):
        assert all(curve.feasible(stretch.manifold, 0.01) for curve in curves)
        assert (np.abs(motion.torque) <= stretch.manifold.body.robot.effort).all()
    for before, after in pairwise(better.chained()):
        assert np.abs(before.samples.q[-1] - after.samples.q[0]).max() < 1e-9


def test_as_many_rounds_with_the_same_seed_give_the_same_climb() -> None:
    one, two = improved("length", seed=1)[1], improved.__wrapped__("length", seed=1)[1]
    other = improved("length", seed=2)[1]
    for a, b in zip(one.motions, two.motions, strict=True):
        np.testing.assert_array_equal(a.samples.q, b.samples.q)
    assert any(not np.array_equal(a.samples.q, b.samples.q) for a, b in zip(one.motions, other.motions, strict=True))


def test_more_rounds_begin_with_the_fewer() -> None:
    few, more = (improved("length", rounds=rounds)[2].entries for rounds in (4, ROUNDS))
    assert [value for _, value in more[: len(few)]] == [value for _, value in few]


def test_rounds_find_shorter_climbs() -> None:
    gains = []
    for seed in range(3):
        _, _, progress = improved("length", seed)
        gains.append(progress.entries[0][1] - progress.entries[-1][1])
    assert min(gains) >= 0.0 and max(gains) > 0.0


def test_one_round_makes_climbs_through_arbitrary_postures_much_the_same_length() -> None:
    lengths = []
    for seed in range(3):
        planner, way = beginning(count=4, seed=seed, free_start=True)
        _, progress = Improver(planner.phases, planner.budget, 0).improve(way, time.perf_counter(), 1)
        lengths.append([value for _, value in progress.entries])
    before, after = ([values[at] for values in lengths] for at in (0, -1))
    assert max(before) > 1.05 * min(before)
    assert max(after) < 1.01 * min(after) and max(after) < min(before)


def test_a_climb_keeps_the_margins_asked_for_where_it_would_give_them_up_for_a_shorter_one() -> None:
    push = 1.0  # [N]
    planner, way = beginning(free_start=True, push=push)
    robot, wall = planner.body.robot, planner.body.wall
    careless = PhasePlanner(Body(robot, wall), planner.objective)
    least = []
    for phases in (planner.phases, careless):
        better, progress = Improver(phases, planner.budget, 0).improve(way, time.perf_counter(), ROUNDS)
        assert len(progress.entries) > 1
        least.append(min(margins["push"].value for margins in phase_margins(robot, wall, better.chained(), ["push"])))
    assert least[0] >= push > least[1]


def test_a_record_ends_with_the_value_of_the_plan_and_forgets_what_was_better() -> None:
    progress = Progress(((1.0, 5.0), (2.0, 4.0), (3.0, 3.0)))
    assert progress.ending(9.0, 3.0).entries == progress.entries
    assert progress.ending(9.0, 3.0 + 1e-12).entries == (*progress.entries[:2], (3.0, 3.0 + 1e-12))
    assert progress.ending(9.0, 4.5).entries == ((1.0, 5.0), (9.0, 4.5))
    assert progress.ending(9.0, 2.0).entries == (*progress.entries, (9.0, 2.0))
    assert Progress().ending(9.0, 2.0).entries == ((9.0, 2.0),)


def small(**budget: object) -> Scenario:
    scenario = load_scenario("three_limbed")
    return replace(scenario, budget=replace(scenario.budget, **budget))


@pytest.mark.parametrize("kind", OBJECTIVE_KINDS)
def test_plans_for_any_objective_hold_and_say_how_good_they_are(kind: ObjectiveKind) -> None:
    plan = plan_climb(small(improve_rounds=4), objective=kind)
    robot = plan.robots[0]
    assert robot.objective is not None and robot.objective.kind == kind
    assert robot.record[-1][1] == robot.objective.value <= robot.record[0][1]
    verdict = verify(plan)
    assert verdict.ok, str(verdict)


def test_each_objective_is_served_best_by_the_climb_planned_for_it() -> None:
    climbs = {kind: beginning(objective=kind, free_start=True) for kind in OBJECTIVE_KINDS}
    for kind, (planner, _) in climbs.items():
        values = {other: planner.objective.value(planner.body, way.motions) for other, (_, way) in climbs.items()}
        assert min(values, key=values.__getitem__) == kind


@pytest.mark.parametrize("kind", ["time", "margin"])
def test_curves_are_refined_together_only_if_the_climb_is_no_worse_for_it(
    kind: ObjectiveKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With this seed and for time it is worse: curves shortened together take longer."""
    search = ClimbSearch(replace(load_scenario("three_limbed"), objective=kind), 1, 60.0, lambda message: None)
    planner, budget = search.planner.phases, search.planner.budget
    joined, given = planner.joined, []

    def noted(stretches: Sequence[Stretch], curves: Sequence[Curves]) -> tuple[Curves, ...]:
        given.append((stretches, curves, joined(stretches, curves)))
        return given[-1][-1]

    monkeypatch.setattr(planner, "joined", noted)
    achieved = search.run().objective
    assert achieved is not None
    stretches, *ways = given[-1]
    for curves in ways:
        motions = planner.all_timed(stretches, curves, budget)
        assert isinstance(motions, list)
        assert achieved.value <= planner.objective.value(search.body, motions) + 1e-9


def test_who_is_interrupted_has_the_best_climb_by_then(monkeypatch: pytest.MonkeyPatch) -> None:
    way, better, _ = improved("length")
    planner, _ = beginning(objective="length", free_start=True)
    improver = Improver(planner.phases, planner.budget, 0)
    offered = iter([better])

    def impatient(given: Way) -> Way:
        for other in offered:
            return other
        raise KeyboardInterrupt

    monkeypatch.setattr(improver, "round", impatient)
    found, progress = improver.improve(way, time.perf_counter(), seconds=3600.0)
    assert found is better and len(progress.entries) == 2


def test_seconds_are_spent_on_top_of_rounds() -> None:
    began = time.perf_counter()
    plan = plan_climb(small(), improve=0.3)
    assert time.perf_counter() - began >= 0.3
    assert plan.timings["improve"] >= 0.3
    assert verify(plan).ok
