"""From a scenario with several robots to a plan that holds."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import shapely
from climbs import short

from climber.crowding import Crowding
from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.scenario import Scenario, load_scenario, scenario_from_text
from climber.task import TaskPlan, TaskPlanner, Walk
from climber.team_plan import Recorder, TeamSearch, without_waits
from climber.verify import verify

APART = 3.0  # [m] between the wall and its copy


def two_walls() -> Scenario:
    """The beginning of `basic` twice, side by side, each with a robot."""
    text = short().source
    holds = re.findall(r"  - \{position: \[.*\n", text)
    count = len(holds)

    def moved(match: re.Match[str]) -> str:
        return f"[{float(match[1]) + APART}, {match[2]}]"

    copies = [re.sub(r"(?<=position: )\[([-\d.]+), ([-\d.]+)\]", moved, hold) for hold in holds]
    wall, robot = text.split("robots:\n")
    again = re.sub(r"(?<=_front: |._rear: )\d+", lambda match: str(int(match[0]) + count), robot)
    again = re.sub(r"(?<=holds: )\[(.*)\]", lambda match: str([int(h) + count for h in match[1].split(",")]), again)
    again = re.sub(r"(?<=center: )\[([-\d.]+), ([-\d.]+)\]", moved, again).replace("name: quadruped", "name: other")
    wall = wall.replace(holds[-1], holds[-1] + "".join(copies))
    return scenario_from_text(f"{wall}robots:\n{robot}{again}", "two walls")


@pytest.fixture(scope="module")
def team() -> Plan:
    return plan_climb(two_walls())


def test_two_robots_on_walls_of_their_own_climb_at_the_same_time(team: Plan) -> None:
    verdict = verify(team)
    assert verdict.ok, str(verdict)
    assert verdict["robot clearance"].worst is not None and verdict["robot clearance"].worst > 2.0
    alone = plan_climb(short()).robots[0]
    for robot in team.robots:
        assert (robot.moves, robot.proofs["steps"]) == (alone.moves, alone.moves)
        assert robot.proofs["moves"] is True and robot.proofs["cost"] is True
        assert robot.duration == pytest.approx(team.robots[0].duration, abs=1e-9)


def test_one_waits_for_the_other_at_the_end_of_every_step(team: Plan) -> None:
    """Each swing of the one that is done sooner is followed by rest until the other is done too."""
    swings = [[phase for phase in robot.phases if phase.kind == "swing"] for robot in team.robots]
    rests = 0
    for one, two, after in zip(*swings, zip(*(robot.phases[2::2] for robot in team.robots), strict=True), strict=True):
        begin, end = sorted((float(one.time[-1]), float(two.time[-1])))
        first = after[0] if one.time[-1] <= two.time[-1] else after[1]
        within = (first.time >= begin) & (first.time <= end)
        assert not first.v[within].any()
        rests += int(within.sum())
    assert rests > 0


def test_each_robot_of_a_team_improves_and_they_still_keep_their_clock(team: Plan) -> None:
    scenario = two_walls()
    better = plan_climb(replace(scenario, budget=replace(scenario.budget, improve_rounds=8)))
    verdict = verify(better)
    assert verdict.ok, str(verdict)
    for one, two in zip(team.robots, better.robots, strict=True):
        assert one.objective is not None and two.objective is not None
        assert two.objective.value <= one.objective.value + 1e-9
        assert two.record[0][1] == pytest.approx(one.objective.value)
    assert sum(len(robot.record) for robot in better.robots) > 2


def test_a_walk_without_its_waits_is_the_walk_of_a_robot_alone() -> None:
    walk = Walk((5, 5, 7, 7, 8), (-1, 3, -1, 4), (0, 0, None, None, 1), (0, 2, 4), 12)
    assert without_waits(walk) == Walk((5, 7, 8), (3, 4), (0, None, 1), (0, 1, 2), 12)
    still = Walk((5, 5), (-1,), (None, None), (0,), 0)
    assert without_waits(still) == Walk((5,), (), (None,), (0,), 0)


def test_what_one_planner_was_told_another_can_be_told_of_another_robot() -> None:
    task = (4, [0, 1, 0, 2, 0], [1, 3, 2, 3, 3], [1, 1, 2, 2, 9], 0, [3])
    recorder = Recorder(TaskPlanner(*task))
    recorder.cut([4])
    assert recorder.plan(time_limit=10.0).cost == 2
    assert recorder.split(0, 1) == 2
    recorder.forbid(0, 1, 0, None)
    recorder.forbid(0, 1, 1, None)
    alone = recorder.plan(time_limit=10.0)
    assert alone.vertices == (0, 2, 3)
    from climber.task import RobotTask

    other = RobotTask(2, [0], [1], [1], 0, [1], [[8], [9]])
    mine = RobotTask(*task, holds=[[0], [1], [2], [3]])
    both = TaskPlanner([other, mine])
    recorder.repeat(both, 1)
    plan = both.plan(time_limit=10.0)
    assert isinstance(plan, TaskPlan)
    assert without_waits(plan.walks[1]).vertices == (0, 2, 3)


def test_stances_are_crowded_when_their_stars_nearly_touch() -> None:
    """Against shapely, for stances of two robots on the wall that they cross."""
    search = TeamSearch(load_scenario("team"), 0, 60.0, lambda message: None)
    crowded, rng = Crowding(search.members, 0.02), np.random.default_rng(0)
    one, two = (rng.integers(0, member.graph.num_vertices, 300) for member in search.members)
    positions = search.members[0].body.wall.positions[:, :2]
    expected = []
    for a, b in zip(one, two, strict=True):
        shapes = []
        for member, vertex in zip(search.members, (a, b), strict=True):
            feet = positions[member.graph.stances[vertex]]
            limbs = shapely.MultiLineString([[feet.mean(axis=0), foot] for foot in feet])
            pelvis = shapely.Point(feet.mean(axis=0)).buffer(0.05, quad_segs=64)
            shapes.append(limbs.union(pelvis))
        expected.append(shapes[0].distance(shapes[1]))
    clear = np.abs(np.array(expected) - 0.02) > 1e-4
    found = crowded((0, 1), one, two)
    np.testing.assert_array_equal(found[clear], (np.array(expected) < 0.02)[clear])
    assert 0 < found.sum() < len(found)


def test_robots_alike_on_one_wall_learn_from_each_other() -> None:
    search = TeamSearch(load_scenario("team"), 0, 60.0, lambda message: None)
    assert search.members[0].finder is search.members[1].finder
    separate = TeamSearch(two_walls(), 0, 60.0, lambda message: None)
    assert separate.members[0].finder is not separate.members[1].finder


def test_what_robots_share_is_timed_once() -> None:
    search = TeamSearch(load_scenario("team"), 0, 60.0, lambda message: None)
    one, two = search.members
    assert one.finder is two.finder
    one.finder.seconds = 3.0
    assert search.timings()["transitions"] == 3.0
