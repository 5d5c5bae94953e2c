"""Task plans against breadth-first search and a layered dynamic program, which the planner does not contain."""

import itertools
from collections import deque
from dataclasses import dataclass

import clingo
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from climber.exceptions import ClimberError
from climber.task import Impossible, OutOfTime, TaskPlan, TaskPlanner


@dataclass
class Graph:
    num_vertices: int
    edges: list[tuple[int, int, int]]  # tail, head, cost
    start: int
    goals: list[int]

    def planner(self, kind: type[TaskPlanner] = TaskPlanner, potentials: bool = True) -> TaskPlanner:
        tail, head, cost = np.array(self.edges, dtype=int).reshape(-1, 3).T
        return kind(self.num_vertices, tail, head, cost, self.start, self.goals, potentials=potentials)

    def without(self, cut: set[int]) -> list[tuple[int, int, int]]:
        return [edge for number, edge in enumerate(self.edges) if number not in cut]


def fewest_moves(graph: Graph, cut: set[int]) -> int | None:
    """Breadth-first search, one vertex after the other."""
    distances, queue = {graph.start: 0}, deque([graph.start])
    while queue:
        vertex = queue.popleft()
        if vertex in graph.goals:
            return distances[vertex]
        for tail, head, _ in graph.without(cut):
            if tail == vertex and head not in distances:
                distances[head] = distances[vertex] + 1
                queue.append(head)
    return None


def least_cost(graph: Graph, cut: set[int], moves: int) -> float:
    """The least cost of a walk of exactly `moves` moves to a goal: a program over layers; inf if there is none."""
    layer = np.full(graph.num_vertices, np.inf)
    layer[graph.start] = 0
    for _ in range(moves):
        following = np.full(graph.num_vertices, np.inf)
        for tail, head, cost in graph.without(cut):
            following[head] = min(following[head], layer[tail] + cost)
        layer = following
    return float(min((layer[goal] for goal in graph.goals), default=np.inf))


def assert_is_walk(graph: Graph, plan: TaskPlan, cut: set[int]) -> None:
    assert plan.vertices[0] == graph.start
    assert plan.vertices[-1] in graph.goals
    assert len(plan.edges) == plan.makespan == len(plan.vertices) - 1
    assert not cut & set(plan.edges)
    for edge, tail, head in zip(plan.edges, plan.vertices, plan.vertices[1:], strict=False):
        assert graph.edges[edge][:2] == (tail, head)
    assert plan.cost == sum(graph.edges[edge][2] for edge in plan.edges)


def assert_certificate(graph: Graph, answer: Impossible, cut: set[int]) -> None:
    """Nothing but the certificate itself is needed to see that there is no plan."""
    reached = set(answer.reached.tolist())
    leaving = {n for n, (tail, head, _) in enumerate(graph.edges) if tail in reached and head not in reached}
    assert graph.start in reached
    assert not reached & set(graph.goals)
    assert leaving <= cut
    assert leaving == set(answer.blocking.tolist())
    assert {graph.edges[edge][0] for edge in leaving} == set(answer.frontier.tolist())


def assert_given_once(planner: TaskPlanner) -> None:
    """No (edge, t) is in two parts, and neither is any (vertex, t)."""
    pairs = moves = 0
    (layers,) = planner.layers
    for layer in layers.layers:
        parts = [layer.arcs[layer.part(k)].tolist() for k in range(len(layer.parts))]
        heads = [set(layers.states.head[part].tolist()) for part in parts]
        assert len(set(layer.arcs.tolist())) == len(layer.arcs) == sum(map(len, parts))
        assert len(set().union(*heads)) == sum(map(len, heads))
        pairs, moves = pairs + sum(map(len, heads)), moves + len(layer.arcs)
    stats = planner.plan().stats
    assert (stats.pairs, stats.moves) == (pairs + 1, moves)


@st.composite
def graphs(draw: st.DrawFn, most_edges: int = 30) -> Graph:
    num_vertices = draw(st.integers(2, 9))
    vertices = st.integers(0, num_vertices - 1)
    edge = st.tuples(vertices, vertices, st.integers(0, 6))
    edges = draw(st.lists(edge, min_size=1, max_size=most_edges))
    return Graph(num_vertices, edges, draw(vertices), draw(st.lists(vertices, min_size=1, max_size=3)))


@settings(max_examples=150, deadline=None)
@given(graph=graphs(), potentials=st.booleans(), data=st.data())
def test_plans_are_shortest_then_cheapest_after_every_cut(graph: Graph, potentials: bool, data: st.DataObject) -> None:
    planner = graph.planner(potentials=potentials)
    cut = data.draw(st.sets(st.integers(0, len(graph.edges) - 1), max_size=3), label="cut before any plan")
    planner.cut(sorted(cut))
    for _ in range(8):
        answer, moves = planner.plan(), fewest_moves(graph, cut)
        if isinstance(answer, Impossible):
            assert moves is None
            assert_certificate(graph, answer, cut)
            break
        assert isinstance(answer, TaskPlan)
        assert answer.makespan == moves
        assert answer.cost == least_cost(graph, cut, moves)
        assert answer.proofs.makespan_proved
        assert answer.proofs.cost_proved
        assert_is_walk(graph, answer, cut)
        # Mostly edges of the plan, as when motions fail, and some that may never have been looked at.
        candidates = [*answer.edges, *answer.edges, *range(len(graph.edges))]
        new = data.draw(st.lists(st.sampled_from(candidates), min_size=1, max_size=3), label="cut")
        planner.cut(new)
        cut |= set(new)
    assert_given_once(planner)


class LatePlanner(TaskPlanner):
    """Claims that no plan has fewer than two moves more than breadth-first search finds, so that pairs have slack."""

    def lower_bound(self) -> int:
        return super().lower_bound() + 2


class EarlyPlanner(TaskPlanner):
    """Knows nothing of breadth-first search: every smaller number of moves has to be refuted."""

    def lower_bound(self) -> int:
        return 0


@settings(max_examples=150, deadline=None)
@given(graph=graphs(), potentials=st.booleans(), data=st.data())
def test_horizons_longer_than_the_shortest_are_planned_exactly(
    graph: Graph, potentials: bool, data: st.DataObject
) -> None:
    planner, asked = graph.planner(LatePlanner, potentials), 0
    cut = data.draw(st.sets(st.integers(0, len(graph.edges) - 1), max_size=3), label="cut before any plan")
    planner.cut(sorted(cut))
    for _ in range(6):
        shortest = fewest_moves(graph, cut)
        if shortest is None:
            assert isinstance(planner.plan(), Impossible)
            break
        first = max(asked, shortest + 2)
        possible = [n for n in range(first, first + 8) if least_cost(graph, cut, n) < np.inf]
        if not possible:
            break  # there may be no walk of this many moves at all
        answer = planner.plan()
        assert isinstance(answer, TaskPlan)
        assert answer.makespan == possible[0]
        assert answer.cost == least_cost(graph, cut, possible[0])
        assert [a.outcome for a in answer.stats.attempts] == ["no plan"] * (possible[0] - first) + ["plan"]
        assert_is_walk(graph, answer, cut)
        asked = possible[0]
        new = data.draw(st.lists(st.integers(0, len(graph.edges) - 1), min_size=1, max_size=3), label="cut")
        planner.cut(new)
        cut |= set(new)


@settings(max_examples=50, deadline=None)
@given(graph=graphs())
def test_every_horizon_below_the_shortest_is_refuted(graph: Graph) -> None:
    answer, moves = graph.planner(EarlyPlanner).plan(), fewest_moves(graph, set())
    if moves is not None:
        assert isinstance(answer, TaskPlan)
        assert [a.horizon for a in answer.stats.attempts] == list(range(moves + 1))
        assert answer.cost == least_cost(graph, set(), moves)


@settings(max_examples=100, deadline=None)
@given(graph=graphs(), data=st.data())
def test_penalties_change_which_plan_is_cheapest(graph: Graph, data: st.DataObject) -> None:
    planner, cut = graph.planner(), set[int]()
    numbers = st.lists(st.integers(0, len(graph.edges) - 1), max_size=4)
    for _ in range(5):
        answer, moves = planner.plan(), fewest_moves(graph, cut)
        if moves is None:
            break
        assert isinstance(answer, TaskPlan)
        assert answer.cost == least_cost(graph, cut, moves)
        new, dearer = set(data.draw(numbers, label="cut")), set(data.draw(numbers, label="penalise"))
        planner.cut(sorted(new))
        planner.penalise(sorted(dearer), 3)
        cut |= new
        graph.edges = [(t, h, c + 3 * (n in dearer)) for n, (t, h, c) in enumerate(graph.edges)]


def lattice(width: int, height: int, seed: int = 0) -> Graph:
    """Right, up-right and down-right moves of random cost: exponentially many walks of the same length."""
    rng = np.random.default_rng(seed)
    edges = [
        (y * width + x, (y + rise) * width + x + 1, int(rng.integers(20, 400)))
        for y in range(height)
        for x in range(width - 1)
        for rise in (-1, 0, 1)
        if 0 <= y + rise < height
    ]
    middle = (height // 2) * width
    return Graph(width * height, edges, middle, [middle + width - 1])


def test_start_that_is_a_goal_takes_no_moves() -> None:
    plan = Graph(2, [(0, 1, 1), (1, 0, 1)], 0, [1, 0]).planner().plan()
    assert isinstance(plan, TaskPlan)
    assert (plan.vertices, plan.edges, plan.cost) == ((0,), (), 0)
    assert plan.proofs.cost_proved


def test_no_goal_is_proved_impossible() -> None:
    graph = Graph(2, [(0, 1, 1)], 0, [])
    answer = graph.planner().plan()
    assert isinstance(answer, Impossible)
    assert_certificate(graph, answer, set())


def test_unreachable_goal_names_the_cut_edges_it_takes() -> None:
    graph = Graph(5, [(0, 1, 1), (1, 2, 1), (2, 3, 1), (1, 3, 1), (4, 3, 1)], 0, [3])
    planner = graph.planner()
    planner.cut([3])
    planner.cut([1, 1])
    answer = planner.plan()
    assert isinstance(answer, Impossible)
    assert answer.reached.tolist() == [0, 1]
    assert answer.blocking.tolist() == [1, 3]
    assert answer.frontier.tolist() == [1]
    assert "2 vertices that can be reached, and all 2 edges are cut" in answer.reason


def test_goal_without_edges_towards_it_needs_no_cut_to_be_impossible() -> None:
    answer = Graph(3, [(0, 1, 1), (2, 1, 1)], 0, [2]).planner().plan()
    assert isinstance(answer, Impossible)
    assert answer.reached.tolist() == [0, 1]
    assert len(answer.blocking) == len(answer.frontier) == 0


def test_nearest_goal_wins_over_cheapest_and_cheapest_among_nearest() -> None:
    edges = [(0, 1, 50), (0, 2, 40), (0, 3, 1), (3, 4, 1)]
    plan = Graph(5, edges, 0, [1, 2, 4]).planner().plan()
    assert isinstance(plan, TaskPlan)
    assert plan.vertices == (0, 2)


def test_cheapest_of_parallel_edges_is_taken_then_the_next() -> None:
    graph = Graph(2, [(0, 1, 7), (0, 1, 3), (0, 1, 5)], 0, [1])
    planner, taken = graph.planner(), []
    while isinstance(plan := planner.plan(), TaskPlan):
        taken.append(plan.edges)
        planner.cut(plan.edges)
    assert taken == [(1,), (2,), (0,)]


def test_equal_costs_count_every_time() -> None:
    # 5 + 5 is dearer than 4 + 5, though the set {5} weighs less than the set {4, 5}.
    plan = Graph(4, [(0, 1, 5), (1, 3, 5), (0, 2, 4), (2, 3, 5)], 0, [3]).planner().plan()
    assert isinstance(plan, TaskPlan)
    assert (plan.vertices, plan.cost) == ((0, 2, 3), 9)


def test_zero_costs_are_proved_least_without_enumerating_plans() -> None:
    graph = lattice(12, 7)
    graph.edges = [(tail, head, 0) for tail, head, _ in graph.edges]
    plan = graph.planner().plan()
    assert isinstance(plan, TaskPlan)
    assert (plan.makespan, plan.cost, plan.proofs.cost_proved) == (11, 0, True)
    assert plan.stats.attempts[-1].models == 1


def test_exponentially_many_walks_are_proved_at_once() -> None:
    graph = lattice(60, 15)
    plan = graph.planner().plan()
    assert isinstance(plan, TaskPlan)
    assert plan.cost == least_cost(graph, set(), 59)
    assert plan.proofs.cost_proved
    assert plan.stats.attempts[-1].conflicts < 100


def test_only_pairs_on_shortest_walks_are_given_at_first() -> None:
    graph = lattice(9, 5)
    # Something beyond the goal, something behind the start, and a detour: none of it can matter.
    graph.edges += [(26, 40, 1), (9, 18, 1), (18, 9, 1), (18, 0, 1), (0, 19, 1)]
    planner = graph.planner()
    plan = planner.plan()
    (layers,) = planner.layers
    given = {(int(layers.states.head[arc]), t) for t, y in enumerate(layers.layers, 1) for arc in y.arcs}
    forwards = layers.from_start
    on_shortest = {(v, int(forwards[v])) for v in range(graph.num_vertices) if forwards[v] + layers.to_goal[v] == 8}
    assert given | {(18, 0)} == on_shortest
    assert plan.stats.pairs == len(on_shortest) < graph.num_vertices


def test_cut_that_leaves_the_makespan_grounds_nothing() -> None:
    graph = lattice(10, 5)
    planner = graph.planner()
    plan = planner.plan()
    assert isinstance(plan, TaskPlan)
    planner.cut(plan.edges[3:5])
    again = planner.plan()
    assert isinstance(again, TaskPlan)
    assert again.makespan == plan.makespan
    assert [(a.pairs, a.moves) for a in again.stats.attempts] == [(0, 0)]
    assert again.cost == least_cost(graph, set(plan.edges[3:5]), plan.makespan)


def test_no_two_moves_are_made_at_once_however_they_were_given() -> None:
    # Ways of two to five moves that share nothing: the first move of each is given in a call of its own.
    edges, firsts, lasts, vertex = list[tuple[int, int, int]](), list[int](), list[int](), 2
    for length in (2, 3, 4, 5):
        chain = [0, *range(vertex, vertex + length - 1), 1]
        vertex += length - 1
        firsts.append(len(edges))
        edges += [(tail, head, 0) for tail, head in itertools.pairwise(chain)]
        lasts.append(len(edges) - 1)
    planner = Graph(vertex, edges, 0, [1]).planner()
    for last in lasts[:-1]:
        assert isinstance(planner.plan(), TaskPlan)
        planner.cut([last])
    assert isinstance(planner.plan(), TaskPlan)
    assert len(planner.layers[0].layers[0].parts) == 4
    symbols = [clingo.Function("move", [clingo.Number(number) for number in (0, edge, 1)]) for edge in firsts]
    control = planner._program._control
    for one, other in itertools.combinations(symbols, 2):
        assert control.solve(assumptions=[(one, True), (other, True)]).unsatisfiable
    assert control.solve(assumptions=[(symbols[-1], True)]).satisfiable


def test_same_questions_get_the_same_answers() -> None:
    def answers() -> list[tuple[tuple[int, ...], int]]:
        graph = lattice(12, 6, seed=3)
        graph.edges = [(tail, head, cost // 100) for tail, head, cost in graph.edges]  # many ties
        planner, plans = graph.planner(), []
        while isinstance(plan := planner.plan(), TaskPlan):
            plans.append((plan.edges, plan.cost))
            planner.cut(plan.edges[2:9:3])
        return plans

    first = answers()
    assert len(first) > 3
    assert answers() == first


def test_time_limit_proves_nothing_and_the_planner_lives_on() -> None:
    graph = lattice(40, 15)
    planner = graph.planner(potentials=False)  # bare costs: far too many walks to rule out
    answer = planner.plan(time_limit=0.2)
    assert isinstance(answer, OutOfTime | TaskPlan)
    if isinstance(answer, TaskPlan):
        assert answer.proofs.makespan_proved
        assert not answer.proofs.cost_proved
    # Cut down to one way, it is found.
    keep = {n for n, (tail, head, _) in enumerate(graph.edges) if tail // 40 == head // 40}
    cut = set(range(len(graph.edges))) - keep
    planner.cut(sorted(cut))
    plan = planner.plan()
    assert isinstance(plan, TaskPlan)
    assert plan.cost == least_cost(graph, cut, 39)


def test_no_time_at_all_is_out_of_time_and_not_impossible() -> None:
    planner = lattice(5, 3).planner()
    answer = planner.plan(time_limit=0.0)
    assert isinstance(answer, OutOfTime)
    assert (answer.horizon, answer.stats.attempts) == (4, ())
    assert isinstance(planner.plan(time_limit=60.0), TaskPlan)


def test_costs_beyond_the_solvers_numbers_are_refused_and_not_wrapped() -> None:
    graph = Graph(3, [(0, 1, 2**30), (1, 2, 2**30)], 0, [2])
    with pytest.raises(ClimberError, match="2 moves of cost 1073741824"):
        graph.planner().plan()
    graph.edges = [(0, 1, 2**30 - 1), (1, 2, 2**30 - 1)]
    plan = graph.planner().plan()
    assert isinstance(plan, TaskPlan)
    assert plan.cost == 2**31 - 2


@pytest.mark.parametrize(
    ("graph", "message"),
    [
        (Graph(2, [(0, 2, 1)], 0, [1]), "head reaches from 2 to 2; vertices are 0 to 1"),
        (Graph(2, [(-1, 1, 1)], 0, [1]), "tail reaches from -1"),
        (Graph(2, [(0, 1, -1)], 0, [1]), "cost has the entry -1"),
        (Graph(2, [(0, 1, 1)], 2, [1]), "start reaches"),
        (Graph(2, [(0, 1, 1)], 0, [7]), "goals reaches"),
    ],
)
def test_numbers_out_of_range_are_refused(graph: Graph, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        graph.planner()


def test_nothing_but_integers_reaches_the_logic_program() -> None:
    with pytest.raises(ValueError, match="row of integers"):
        TaskPlanner(2, ["0). at(1,0"], [1], [1], 0, [1])
    with pytest.raises(ValueError, match="row of integers"):
        TaskPlanner(2, [0], [1], [0.5], 0, [1])
    with pytest.raises(ValueError, match="one per edge"):
        TaskPlanner(2, [0, 1], [1], [1], 0, [1])
    with pytest.raises(ValueError, match="edges reach from 1 to 1; they are numbered 0 to 0"):
        TaskPlanner(2, [0], [1], [1], 0, [1]).cut([1])
    with pytest.raises(ValueError, match=r"edges has .* type bool; it must be a row of integers"):
        TaskPlanner(2, [0], [1], [1], 0, [1]).cut(np.array([True]))  # a mask is not a list of edges
    with pytest.raises(ValueError, match="must not be negative"):
        TaskPlanner(2, [0], [1], [1], 0, [1]).penalise([0], -1)
