"""Task plans with waypoints, teams, conflicts and components, against a search of all joint positions step by step."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from climber.components import MOST_COMPONENTS
from climber.task import WAIT, Deed, Impossible, RobotTask, TaskPlan, TaskPlanner, Walk
from climber.task_program import _text

Position = tuple[int, int | None, frozenset[int]]  # vertex, component, waypoints visited


@dataclass
class Climber:
    """One robot's problem, and all that was done to it."""

    num_vertices: int
    edges: list[tuple[int, int, int]]  # tail, head, cost
    start: int
    goals: list[int]
    holds: list[list[int]]
    waypoints: list[list[int]] = field(default_factory=list)
    ordered: bool = False
    avoid: list[int] = field(default_factory=list)
    cut: set[int] = field(default_factory=set)
    counts: dict[int, int] = field(default_factory=dict)
    bars: set[tuple[int, int | None, int | None]] = field(default_factory=set)
    start_bars: set[int] = field(default_factory=set)

    def task(self) -> RobotTask:
        tail, head, cost = np.array(self.edges, dtype=int).reshape(-1, 3).T
        return RobotTask(
            self.num_vertices,
            tail,
            head,
            cost,
            self.start,
            self.goals,
            np.array(self.holds),
            [np.array(waypoint, dtype=int) for waypoint in self.waypoints],
            self.ordered,
            self.avoid,
        )

    def components(self, vertex: int) -> list[int | None]:
        return list(range(self.counts[vertex])) if vertex in self.counts else [None]

    def seen(self, vertex: int, before: frozenset[int]) -> frozenset[int]:
        """What is visited on arriving; in a given order, nothing before what comes earlier."""
        after = set(before)
        for number, there in enumerate(self.waypoints):
            if vertex in there and (not self.ordered or after >= set(range(number))):
                after.add(number)
        return frozenset(after)

    def starts(self) -> list[Position]:
        seen = self.seen(self.start, frozenset())
        return [(self.start, c, seen) for c in self.components(self.start) if c is None or c not in self.start_bars]

    def allowed(self, edge: int, leaving: int | None, arriving: int | None) -> bool:
        return edge not in self.cut and not any(
            e == edge and f in (None, leaving) and t in (None, arriving) for e, f, t in self.bars
        )

    def steps(self, position: Position, waits: bool) -> Iterator[tuple[int, Position, int]]:
        """Edge (-1 for a wait), where it leads, what it costs."""
        vertex, component, seen = position
        if waits:
            yield -1, position, 0
        for edge, (tail, head, cost) in enumerate(self.edges):
            if tail == vertex and head not in self.avoid:
                for arriving in self.components(head):
                    if self.allowed(edge, component, arriving):
                        yield edge, (head, arriving, self.seen(head, seen)), cost

    def done(self, position: Position) -> bool:
        return position[0] in self.goals and len(position[2]) == len(self.waypoints)


@dataclass
class Team:
    robots: list[Climber]
    conflicts: set[tuple[Deed, Deed]] = field(default_factory=set)
    handover: bool = False

    def planner(self) -> TaskPlanner:
        return TaskPlanner([robot.task() for robot in self.robots], handover=self.handover)

    def compatible(self, steps: tuple[tuple[int, int, int], ...]) -> bool:
        """Whether robots may make these steps, each an edge and where it begins and ends, all at once."""
        for one, other in itertools.combinations(range(len(steps)), 2):
            ends = [{*self.robots[r].holds[steps[r][2]]} for r in (one, other)]
            both = [ends[i] | {*self.robots[r].holds[steps[r][1]]} for i, r in enumerate((one, other))]
            if set.intersection(*(ends if self.handover else both)):
                return False
        for (one, kind, what), (other, other_kind, other_what) in self.conflicts:
            done = []
            for r, k, w in ((one, kind, what), (other, other_kind, other_what)):
                edge, tail, _ = steps[r]
                done.append(edge == w if k == "move" else edge == -1 and tail == w)
            if all(done):
                return False
        return True

    def best(self) -> tuple[int, int] | None:
        """Fewest steps and then least cost, position by position, step by step; None once nothing new is reached."""
        waits = len(self.robots) > 1
        layer = dict.fromkeys(itertools.product(*(robot.starts() for robot in self.robots)), 0)
        seen, steps = set(layer), 0
        while layer:
            ends = [c for joint, c in layer.items() if all(r.done(p) for r, p in zip(self.robots, joint, strict=True))]
            if ends:
                return steps, min(ends)
            following: dict[tuple[Position, ...], int] = {}
            for joint, cost in layer.items():
                options = [list(robot.steps(p, waits)) for robot, p in zip(self.robots, joint, strict=True)]
                for choice in itertools.product(*options):
                    moves = tuple((e, p[0], q[0]) for (e, q, _), p in zip(choice, joint, strict=True))
                    if self.compatible(moves):
                        reached, total = tuple(q for _, q, _ in choice), cost + sum(c for _, _, c in choice)
                        following[reached] = min(total, following.get(reached, total))
            if following.keys() <= seen:
                return None  # whatever can be reached was reached before, and none of it was the end
            seen |= following.keys()
            layer, steps = following, steps + 1
        return None

    def assert_is_plan(self, plan: TaskPlan) -> None:
        for robot, walk in zip(self.robots, plan.walks, strict=True):
            assert_is_walk(robot, walk)
            assert len(walk.edges) == plan.makespan
        for t in range(plan.makespan):
            assert self.compatible(tuple((w.edges[t], w.vertices[t], w.vertices[t + 1]) for w in plan.walks))
        assert plan.cost == sum(walk.cost for walk in plan.walks)


def assert_is_walk(robot: Climber, walk: Walk) -> None:
    assert walk.vertices[0] == robot.start
    assert walk.vertices[-1] in robot.goals
    assert walk.cost == sum(robot.edges[edge][2] for edge in walk.edges if edge >= 0)
    assert not {*walk.vertices} & {*robot.avoid}
    assert len(walk.visits) == len(robot.waypoints)
    for waypoint, t in zip(robot.waypoints, walk.visits, strict=True):
        assert walk.vertices[t] in waypoint
    assert not robot.ordered or list(walk.visits) == sorted(walk.visits)
    for vertex, component in zip(walk.vertices, walk.components, strict=True):
        assert component in robot.components(vertex)
    assert walk.components[0] is None or walk.components[0] not in robot.start_bars
    places = list(zip(walk.vertices, walk.components, strict=True))
    for edge, before, after in zip(walk.edges, places, places[1:], strict=False):
        if edge < 0:
            assert before == after
        else:
            assert robot.edges[edge][:2] == (before[0], after[0])
            assert robot.allowed(edge, before[1], after[1])


@st.composite
def climbers(draw: st.DrawFn, least: int = 2, most: int = 6, extra: int = 8, holds: int = 9) -> Climber:
    """A chain of vertices to go along, mostly both ways, and some edges besides."""
    count = draw(st.integers(least, most))
    vertices = st.integers(0, count - 1)
    costs = st.integers(0, 6)
    chain = [(v, v + 1, draw(costs)) for v in range(count - 1)]
    back = [(head, tail, cost) for tail, head, cost in chain if draw(st.integers(0, 3))]
    more = draw(st.lists(st.tuples(vertices, vertices, costs), max_size=extra))
    stance = st.lists(st.integers(0, holds), min_size=2, max_size=2, unique=True)
    stances = draw(st.lists(stance, min_size=count, max_size=count))
    ends = draw(st.permutations([0, count - 1]))
    goals = [ends[1], *draw(st.lists(vertices, max_size=1))]
    return Climber(count, chain + back + more, ends[0], goals, stances)


def waypoints(data: st.DataObject, robot: Climber, most: int) -> None:
    places = st.lists(st.integers(0, robot.num_vertices - 1), min_size=1, max_size=2)
    robot.waypoints = data.draw(st.lists(places, max_size=most), label="waypoints")
    robot.ordered = data.draw(st.booleans(), label="ordered")


def teach(data: st.DataObject, team: Team, planner: TaskPlanner, plan: TaskPlan) -> None:
    """Does to the planner, and to the problem, something that a failed motion might."""
    r = data.draw(st.integers(0, len(team.robots) - 1), label="robot")
    robot, walk = team.robots[r], plan.walks[r]
    taken = [edge for edge in walk.edges if edge >= 0]
    edges = st.sampled_from([*taken, *taken, *range(len(robot.edges))])
    kinds = ["cut", "split", "split", "forbid", "forbid", "forbid", "forbid", "start", "penalise"]
    kinds += ["conflict", "conflict"] * (len(team.robots) > 1)
    kind = data.draw(st.sampled_from(kinds), label="kind")
    if kind == "cut":
        edge = data.draw(edges, label="edge")
        planner.cut([edge], r)
        robot.cut.add(edge)
    elif kind == "penalise":
        edge = data.draw(edges, label="edge")
        planner.penalise([edge], 2, r)
        tail, head, cost = robot.edges[edge]
        robot.edges[edge] = tail, head, cost + 2
    elif kind == "split":
        vertex = data.draw(st.sampled_from([*walk.vertices, *range(robot.num_vertices)]), label="vertex")
        count = robot.counts.get(vertex, 1)
        if count < MOST_COMPONENTS:
            robot.counts[vertex] = count + 1
        assert planner.split(r, vertex) == (count + 1 if count < MOST_COMPONENTS else None)
    elif kind == "forbid":
        edge = data.draw(edges, label="edge")
        tail, head, _ = robot.edges[edge]
        leaving = data.draw(st.sampled_from([*robot.components(tail), None]), label="from")
        arriving = data.draw(st.sampled_from([*robot.components(head), None]), label="to")
        planner.forbid(r, edge, leaving, arriving)
        robot.bars.add((edge, leaving, arriving))
    elif kind == "start" and robot.start in robot.counts:
        component = data.draw(st.integers(0, robot.counts[robot.start] - 1), label="component")
        planner.forbid_start(r, component)
        robot.start_bars.add(component)
    elif kind == "conflict":
        deeds = [deed(data, number, plan.walks[number], team.robots[number]) for number in pair(data, len(team.robots))]
        planner.conflict(*deeds)
        team.conflicts.add((deeds[0], deeds[1]))


def pair(data: st.DataObject, count: int) -> list[int]:
    return data.draw(st.lists(st.integers(0, count - 1), min_size=2, max_size=2, unique=True), label="robots")


def deed(data: st.DataObject, number: int, walk: Walk, robot: Climber) -> Deed:
    if data.draw(st.booleans(), label="move"):
        return number, "move", data.draw(st.sampled_from([*(e for e in walk.edges if e >= 0), 0]), label="edge")
    return number, "at", data.draw(st.sampled_from(walk.vertices), label="vertex")


def assert_answers_are_best(team: Team, data: st.DataObject, rounds: int) -> None:
    planner = team.planner()
    for _ in range(rounds):
        answer, best = planner.plan(time_limit=60.0), team.best()
        if best is None:
            assert isinstance(answer, Impossible)
            assert answer.reason.startswith("unreachable")
            return
        assert isinstance(answer, TaskPlan)
        assert (answer.makespan, answer.cost) == best
        assert answer.proofs.makespan_proved
        assert answer.proofs.cost_proved
        team.assert_is_plan(answer)
        for _ in range(data.draw(st.integers(1, 3), label="lessons")):
            teach(data, team, planner, answer)


@settings(max_examples=80, deadline=None)
@given(robot=climbers(), data=st.data())
def test_walks_past_waypoints_are_shortest_then_cheapest(robot: Climber, data: st.DataObject) -> None:
    waypoints(data, robot, most=3)
    robot.avoid = data.draw(st.lists(st.integers(0, robot.num_vertices - 1), max_size=1), label="avoid")
    assume(robot.start not in robot.avoid)
    assert_answers_are_best(Team([robot]), data, rounds=1)


@settings(max_examples=80, deadline=None)
@given(robot=climbers(), data=st.data())
def test_refined_graphs_are_planned_exactly_whatever_they_were_taught(robot: Climber, data: st.DataObject) -> None:
    waypoints(data, robot, most=1)
    assert_answers_are_best(Team([robot]), data, rounds=6)


@settings(max_examples=50, deadline=None)
@given(robots=st.lists(climbers(3, 5, 4), min_size=2, max_size=2), data=st.data())
def test_two_robots_never_share_a_hold_and_are_together_fastest_then_cheapest(
    robots: list[Climber], data: st.DataObject
) -> None:
    assume(not {*robots[0].holds[robots[0].start]} & {*robots[1].holds[robots[1].start]})
    waypoints(data, robots[0], most=1)
    assert_answers_are_best(Team(robots, handover=data.draw(st.booleans(), label="handover")), data, rounds=5)


@settings(max_examples=30, deadline=None)
@given(robots=st.lists(climbers(2, 4, 2, holds=14), min_size=3, max_size=3), data=st.data())
def test_three_robots_likewise(robots: list[Climber], data: st.DataObject) -> None:
    starts = [{*robot.holds[robot.start]} for robot in robots]
    assume(not any(one & other for one, other in itertools.combinations(starts, 2)))
    assert_answers_are_best(Team(robots, handover=data.draw(st.booleans(), label="handover")), data, rounds=4)


def corridor(length: int) -> Climber:
    """Vertices in a row, each on two holds of its own, and both ways along it for 1 each."""
    edges = [(v, v + 1, 1) for v in range(length - 1)] + [(v + 1, v, 1) for v in range(length - 1)]
    return Climber(length, edges, 0, [length - 1], [[2 * v, 2 * v + 1] for v in range(length)])


def reversed_(robot: Climber) -> Climber:
    return replace(robot, start=robot.goals[0], goals=[robot.start], cut=set(), counts={}, bars=set(), start_bars=set())


def test_two_robots_cross_where_one_can_step_aside() -> None:
    robot = corridor(5)
    siding = replace(robot, num_vertices=6, edges=[*robot.edges, (2, 5, 1), (5, 2, 1)], holds=[*robot.holds, [10, 11]])
    team = Team([siding, reversed_(siding)])
    plan = team.planner().plan()
    assert isinstance(plan, TaskPlan)
    assert (plan.makespan, plan.cost) == team.best()
    assert any(5 in walk.vertices for walk in plan.walks)
    assert any(WAIT in walk.edges for walk in plan.walks)
    team.assert_is_plan(plan)


def test_two_robots_in_a_corridor_are_proved_unable_to_pass() -> None:
    robot = corridor(5)
    answer = TaskPlanner([robot.task(), reversed_(robot).task()]).plan()
    assert isinstance(answer, Impossible)
    assert answer.robot is None
    assert answer.joint == 10  # the first is left of the second: 5 choose 2
    assert "every robot has a way to its goal but they have none together; 10 joint positions" in answer.reason


def test_a_hold_is_passed_on_only_after_the_step_that_frees_it() -> None:
    # The second robot goes where the first has been, as soon as it may.
    first = Climber(2, [(0, 1, 1)], 0, [1], [[0, 1], [1, 2]])
    second = Climber(2, [(0, 1, 1)], 0, [1], [[3, 4], [0, 4]])
    plan = TaskPlanner([first.task(), second.task()]).plan()
    assert isinstance(plan, TaskPlan)
    assert [walk.edges for walk in plan.walks] == [(0, WAIT), (WAIT, 0)]
    plan = TaskPlanner([first.task(), second.task()], handover=True).plan()
    assert isinstance(plan, TaskPlan)
    assert [walk.edges for walk in plan.walks] == [(0,), (0,)]


def test_moves_in_conflict_are_made_one_after_the_other() -> None:
    robot = Climber(2, [(0, 1, 1)], 0, [1], [[0, 1], [2, 3]])
    other = replace(robot, holds=[[4, 5], [6, 7]])
    planner = TaskPlanner([robot.task(), other.task()])
    assert planner.plan().stats.shortest == 1
    planner.conflict((0, "move", 0), (1, "move", 0))
    plan = planner.plan()
    assert isinstance(plan, TaskPlan)
    assert (plan.makespan, plan.cost) == (2, 2)
    planner.conflict((1, "at", 1), (0, "move", 0))
    planner.conflict((0, "at", 0), (1, "move", 0))
    planner.conflict((0, "at", 1), (1, "move", 0))
    answer = planner.plan()
    assert isinstance(answer, Impossible)
    assert answer.joint == 2  # where they start, and the first robot waiting for the second at its goal is no end


def test_only_a_way_through_both_components_of_a_stance_is_left() -> None:
    # Bretl 2006: the graph has 0-1-3, but what arrives at 1 from 0 cannot leave it for 3; it can after a detour by 2.
    edges = [(0, 1, 1), (1, 3, 1), (1, 2, 1), (2, 1, 1)]
    planner = TaskPlanner([RobotTask(4, *np.array(edges).T, 0, [3])])
    plan = planner.plan()
    assert isinstance(plan, TaskPlan)
    assert plan.vertices == (0, 1, 3)
    assert planner.split(0, 1) == 2
    planner.forbid(0, 0, to_component=1)
    planner.forbid(0, 1, from_component=0)
    plan = planner.plan()
    assert isinstance(plan, TaskPlan)
    assert plan.walks[0].vertices == (0, 1, 2, 1, 3)
    assert plan.walks[0].components == (None, 0, None, 1, None)
    assert plan.proofs.cost_proved
    planner.forbid(0, 3, to_component=1)
    answer = planner.plan()
    assert isinstance(answer, Impossible)
    assert answer.blocking.tolist() == [1]
    assert answer.barred == 1
    assert "all 1 edges are cut or barred" in answer.reason
    # A third component is a third chance.
    assert planner.split(0, 1) == 3
    plan = planner.plan()
    assert isinstance(plan, TaskPlan)
    assert plan.walks[0].vertices == (0, 1, 3)
    assert plan.walks[0].components == (None, 2, None)


def test_a_vertex_gets_so_many_components_and_no_more() -> None:
    planner = TaskPlanner(2, [0], [1], [1], 0, [1])
    assert [planner.split(0, 0) for _ in range(MOST_COMPONENTS)] == [*range(2, MOST_COMPONENTS + 1), None]
    for component in range(MOST_COMPONENTS):
        assert isinstance(planner.plan(), TaskPlan)
        planner.forbid_start(0, component)
    answer = planner.plan()
    assert isinstance(answer, Impossible)
    assert answer.reached.tolist() == [0]


def test_teaching_grounds_nothing_that_was_grounded() -> None:
    robot = corridor(7)
    team = [robot.task(), replace(robot, holds=[[a + 20, b + 20] for a, b in robot.holds]).task()]
    planner = TaskPlanner(team)
    plan = planner.plan()
    pairs, moves = plan.stats.pairs, plan.stats.moves
    planner.split(0, 3)
    planner.forbid(0, 2, to_component=0)
    planner.penalise([4], 3, robot=1)
    planner.forbid(1, 7)  # a way back, which the plan does not need
    again = planner.plan()
    assert isinstance(again, TaskPlan)
    assert (again.stats.pairs, again.stats.moves) == (pairs, moves)
    assert [(a.pairs, a.moves) for a in again.stats.attempts] == [(0, 0)]
    assert again.walks[0].components[3] == 1


def test_extensions_are_loaded_only_when_they_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[str] = []
    monkeypatch.setattr("climber.task_program._text", lambda name: loaded.append(name) or _text(name))
    robot = corridor(3)
    planner = TaskPlanner(3, *np.array(robot.edges).T, 0, [2])
    planner.cut([0])
    planner.plan()
    assert loaded == ["climb"]
    planner.split(0, 1)
    planner.split(0, 2)
    assert loaded == ["climb", "refine"]
    loaded.clear()
    TaskPlanner([replace(robot, waypoints=[[1]]).task()])
    assert loaded == ["climb", "waypoints"]
    loaded.clear()
    TaskPlanner([robot.task(), reversed_(robot).task()])
    assert loaded == ["climb", "teams"]


def test_waypoints_in_a_given_order_cost_what_any_order_saves() -> None:
    robot = replace(corridor(5), start=2, goals=[2], waypoints=[[4], [0], [4]])
    for ordered, makespan, visits in ((False, 8, None), (True, 12, (2, 6, 10))):
        plan = Team([replace(robot, ordered=ordered)]).planner().plan()
        assert isinstance(plan, TaskPlan)
        assert plan.makespan == makespan
        assert visits is None or plan.walks[0].visits == visits


def test_waypoints_out_of_reach_are_named() -> None:
    robot = replace(corridor(5), waypoints=[[1], [4], [3]], goals=[0])
    planner = Team([robot]).planner()
    planner.cut([2])
    answer = planner.plan()
    assert isinstance(answer, Impossible)
    assert answer.missing == (1, 2)
    assert answer.blocking.tolist() == [2]
    assert "of waypoints 1 and 2 none is among the 3 vertices that can be reached" in answer.reason
    # Each can be reached, but there is no way back from one to the other.
    answer = TaskPlanner([RobotTask(3, [0, 0], [1, 2], [1, 1], 0, [1, 2], waypoints=[[1], [2]])]).plan()
    assert isinstance(answer, Impossible)
    assert answer.missing == ()
    assert "no walk visits all waypoints" in answer.reason


def test_the_same_team_gets_the_same_answers() -> None:
    def answers() -> list[tuple[Walk, ...]]:
        rng = np.random.default_rng(5)
        side = [(v, v + d, 1) for v in range(25) for d in (1, -1, 5, -5) if 0 <= v + d < 25]
        robot = Climber(25, side, 0, [24], [[v, 25 + v % 11] for v in range(25)])
        planner, plans = TaskPlanner([robot.task(), reversed_(robot).task()]), []
        for _ in range(4):
            plan = planner.plan()
            assert isinstance(plan, TaskPlan)
            plans.append(plan.walks)
            planner.cut([int(rng.choice([e for e in plan.walks[0].edges if e >= 0]))])
            planner.split(1, plan.walks[1].vertices[2])
        return plans

    assert answers() == answers()


def test_what_makes_no_sense_is_refused() -> None:
    robot = corridor(3)
    with pytest.raises(ValueError, match="robot 0 comes without the holds"):
        TaskPlanner([replace(robot.task(), holds=None), robot.task()])
    with pytest.raises(ValueError, match="robots 0 and 1 both start on hold 0"):
        TaskPlanner([robot.task(), robot.task()])
    with pytest.raises(ValueError, match="starts on vertex 0, which it is to avoid"):
        TaskPlanner([replace(robot.task(), avoid=[0])])
    with pytest.raises(ValueError, match="waypoints reaches from 3"):
        TaskPlanner([replace(robot.task(), waypoints=[[3]])])
    planner = TaskPlanner([robot.task(), reversed_(robot).task()])
    with pytest.raises(ValueError, match="vertex 1, which has not been split"):
        planner.forbid(0, 0, to_component=0)
    planner.split(0, 1)
    with pytest.raises(ValueError, match="component 2 of vertex 1, which has components 0 to 1"):
        planner.forbid(0, 0, to_component=2)
    with pytest.raises(ValueError, match="both of robot 1"):
        planner.conflict((1, "move", 0), (1, "at", 0))
    with pytest.raises(ValueError, match="vertex is 3"):
        planner.split(0, 3)
