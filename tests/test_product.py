"""Teams planned through their joint positions: exact, as the search of all of them in `test_task_teams` is."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from test_task_teams import Climber, Team, assert_answers_are_best, climbers, waypoints

from climber.product import ProductPlanner
from climber.states import Booleans, Integers
from climber.task import Impossible, OutOfTime, RobotTask, TaskPlan


@dataclass
class ProductTeam(Team):
    """A team whose robots also keep away from one another.

    Attributes:
        apart: (robot, robot, vertex of the first, vertex of the second) that exclude each other.
    """

    apart: set[tuple[int, int, int, int]] = field(default_factory=set)

    def planner(self) -> ProductPlanner:
        return ProductPlanner([robot.task() for robot in self.robots])

    def compatible(self, steps: tuple[tuple[int, int, int], ...]) -> bool:
        for i, j in itertools.combinations(range(len(steps)), 2):
            (_, tail, head), (_, other_tail, other_head) = steps[i], steps[j]
            turns = [(i, j, head, other_tail), (i, j, tail, other_head)]
            if (i, j, head, other_head) in self.apart or all(turn in self.apart for turn in turns):
                return False
        return super().compatible(steps)


def separate(robots: list[Climber]) -> None:
    starts = [{*robot.holds[robot.start]} for robot in robots]
    assume(not any(one & other for one, other in itertools.combinations(starts, 2)))


@settings(max_examples=60, deadline=None)
@given(robots=st.lists(climbers(3, 6, 5), min_size=2, max_size=2), data=st.data())
def test_two_robots_are_together_fastest_then_cheapest_whatever_was_taught(
    robots: list[Climber], data: st.DataObject
) -> None:
    separate(robots)
    waypoints(data, robots[0], most=1)
    assert_answers_are_best(ProductTeam(robots), data, rounds=5)


@settings(max_examples=30, deadline=None)
@given(robots=st.lists(climbers(2, 4, 2, holds=14), min_size=3, max_size=3), data=st.data())
def test_three_robots_likewise(robots: list[Climber], data: st.DataObject) -> None:
    separate(robots)
    assert_answers_are_best(ProductTeam(robots), data, rounds=3)


PAIRS = st.sets(st.tuples(st.just(0), st.just(1), st.integers(0, 5), st.integers(0, 5)), max_size=8)


@pytest.mark.parametrize("asked", [True, False])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(robots=st.lists(climbers(3, 6, 5, holds=16), min_size=2, max_size=2), apart=PAIRS)
def test_stances_that_exclude_each_other_are_never_taken_up_together(
    asked: bool, robots: list[Climber], apart: set[tuple[int, int, int, int]]
) -> None:
    """Whether they are known when asked for or told one by one."""
    separate(robots)
    sizes = [robot.num_vertices for robot in robots]
    team = ProductTeam(robots, apart={pair for pair in apart if pair[2] < sizes[0] and pair[3] < sizes[1]})
    best = team.best()

    def crowded(robots: tuple[int, int], one: Integers, two: Integers) -> Booleans:
        return np.array([(*robots, int(a), int(b)) in team.apart for a, b in zip(one, two, strict=True)], dtype=bool)

    planner = ProductPlanner([robot.task() for robot in robots], crowded if asked else None)
    if not asked:
        planner.plan(time_limit=60.0)  # what is told later counts too
        for i, j, one, two in team.apart:
            planner.exclude((i, j), one, two)
    answer = planner.plan(time_limit=60.0)
    if best is None:
        assert isinstance(answer, Impossible)
        return
    assert isinstance(answer, TaskPlan)
    assert (answer.makespan, answer.cost) == best
    team.assert_is_plan(answer)


def test_no_time_is_not_the_same_as_no_plan() -> None:
    chain = [RobotTask(3, [0, 1], [1, 2], [1, 1], 0, [2], [[3 * r], [3 * r + 1], [3 * r + 2]]) for r in range(2)]
    assert isinstance(ProductPlanner(chain).plan(time_limit=0.0), OutOfTime)
    answer = ProductPlanner(chain).plan()
    assert isinstance(answer, TaskPlan) and answer.makespan == 2 and answer.cost == 4
