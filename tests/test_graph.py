"""The stance graph, against the thesis's counts and against an enumeration of permutations."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations, pairwise, permutations, product
from typing import Any

import numpy as np
import pytest
import shapely
from problems import QUADRUPED, DiskRobot, hold, random_wall, thesis_wall
from scipy.optimize import linprog
from shapely.geometry import Point, Polygon, box

from climber.exceptions import ClimberError
from climber.graph import build_stance_graph
from climber.programs.equilibrium import SupportProgram
from climber.programs.forces import wall_forces, weight_in_plane
from climber.programs.support import hold_set_intervals
from climber.scenario_fields import CostWeights
from climber.stance import Stance
from climber.stance_graph import StanceGraph
from climber.wall import GRIPS, Wall


def _graph(name: str) -> StanceGraph:
    wall, start, _ = thesis_wall(name)
    return build_stance_graph(wall, QUADRUPED, start, CostWeights())


# The plain implementation of the thesis's method gives the same numbers at every stage.
COUNTS = {
    "tuples": (5040, 143640, 2686320),
    "valid": (744, 17712, 51576),
    "non_crossing": (104, 2136, 6196),
    "poses": (26, 534, 1549),
    "ordered_states_visited": (104, 2136, 6192),
    "ordered_transitions": (304, 19304, 59200),
    "unique_transitions": (38, 2413, 7400),
    "reach_ok": (38, 2364, 7244),
    "stable_pairs": (34, 1940, 6056),
    "stable_directed": (65, 3695, 11446),
    "directed_where_SR2_clause_rejects": (9, 493, 1502),
    "graph_nodes": (25, 506, 1484),
    "graph_edges_undirected": (34, 1940, 6056),
}


@pytest.mark.parametrize(("wall", "column"), [("W1", 0), ("W2", 1), ("W3", 2)])
def test_counts_of_every_stage_are_those_of_the_thesis_method(wall: str, column: int) -> None:
    graph = _graph(wall)
    assert {stage: graph.counts[stage] for stage in COUNTS} == {stage: row[column] for stage, row in COUNTS.items()}
    poses = graph.pose_graph()
    assert len(poses.poses) == graph.counts["graph_nodes"]
    assert len(poses.tail) == graph.counts["stable_directed"]
    assert len({frozenset(pair) for pair in zip(poses.tail, poses.head, strict=True)}) == graph.counts["stable_pairs"]


class Enumeration:
    """The same graph by permutations and searches over ordered stances, one check at a time."""

    def __init__(self, wall: Wall, robot: DiskRobot) -> None:
        self.wall, self.robot = wall, robot
        self.xy, self.n = wall.positions[:, :2], len(robot.reach)
        self.answers: dict[object, Any] = {}  # what does not depend on the order is asked once
        every = list(permutations(range(len(wall.holds)), self.n))
        self.valid = [s for s in every if self._overlap(s, range(self.n)) > 0]
        self.stances = {s for s in self.valid if self._ordered(s)}

    def explore(
        self, start: Stance, all_edges: bool = False
    ) -> dict[tuple[Stance, Stance], tuple[float, float, float]]:
        """Edges with their costs from the start on; with `all_edges`, also past moves that are impossible."""
        edges, seen, queue = {}, {start}, deque([start])
        while queue:
            tail = queue.popleft()
            for limb, hold_ in product(range(self.n), range(len(self.wall.holds))):
                head = tail.moved(limb, hold_)
                if hold_ in tail.holds or head.holds not in self.stances:
                    continue
                costs = self._costs(tail, limb, head)
                if costs is not None:
                    edges[tail, head] = costs
                if head not in seen and (costs is not None or all_edges):
                    seen.add(head)
                    queue.append(head)
        return edges

    def name(self, stance: Stance) -> Stance:
        """One stance for all its images."""
        return min(stance.permuted(p) for p in self.robot.symmetries)

    def _overlap(self, holds: Iterable[int], limbs: Iterable[int]) -> float:
        """Area of the body workspace."""
        disks = frozenset(zip(holds, self.robot.reach[list(limbs)], strict=True))
        if disks not in self.answers:
            shapes = [Point(self.xy[h]).buffer(r, quad_segs=256) for h, r in disks]
            self.answers[disks] = shapely.intersection_all(shapes).area
        return float(self.answers[disks])

    def _ordered(self, holds: tuple[int, ...]) -> bool:
        return all(
            Polygon(self.xy[[holds[i] for i in three]]).exterior.is_ccw for three in combinations(range(self.n), 3)
        )

    def _interval(self, holds: frozenset[int]) -> tuple[float, float] | None:
        if holds not in self.answers:
            self.answers[holds] = self._solve_interval(holds)
        return self.answers[holds]  # type: ignore[no-any-return]

    def _solve_interval(self, holds: frozenset[int]) -> tuple[float, float] | None:
        """Eqs. 4.12-4.16 handed to a linear program."""
        forces, mg = wall_forces(self.wall), weight_in_plane(self.wall, self.robot.mass)
        columns, bounds, load = [], [], np.array([0.0, mg, 0.0])
        for h in holds:
            load -= _wrench(*self.xy[h], forces.offset[h])
            for j in range(2):
                columns.append(_wrench(*self.xy[h], forces.generators[h][:, j]))
                bounds.append((forces.lower[h, j], forces.upper[h, j]))
        equations = np.column_stack([*columns, [0.0, 0.0, -mg]])
        ends = []
        for sign in (1.0, -1.0):
            aim = np.append(np.zeros(len(columns)), sign)
            result = linprog(aim, A_eq=equations, b_eq=load, bounds=[*bounds, (None, None)])
            if not result.success:
                return None
            ends.append(float(result.x[-1]))
        return ends[0], ends[1]

    def _costs(self, tail: Stance, limb: int, head: Stance) -> tuple[float, float, float] | None:
        # On one limb the robot swings round; on more its body stays within reach of both stances' holds.
        if self.n > 2 and self._overlap((*tail.holds, head.holds[limb]), (*range(self.n), limb)) == 0:
            return None
        stay = [i for i in range(self.n) if i != limb]
        held = [tail.holds[i] for i in stay]
        sr1, sr2 = self._interval(frozenset(held)), self._interval(frozenset(head.holds))
        if sr1 is None or sr2 is None or max(sr1[0], sr2[0]) > min(sr1[1], sr2[1]) + 1e-9:
            return None
        reach = float(np.linalg.norm(self.xy[tail.holds[limb]] - self.xy[head.holds[limb]]))
        return reach, 1 / max(sr1[1] - sr1[0], 1e-3), 1 / max(self._overlap(held, stay), 1e-4)


def _wrench(x: float, y: float, f: np.ndarray) -> np.ndarray:
    return np.array([f[0], f[1], x * f[1] - y * f[0]])


def _turns(n: int, *steps: int) -> tuple[tuple[int, ...], ...]:
    return tuple(tuple((i + s) % n for i in range(n)) for s in steps)


ROBOTS = {
    "quadruped that looks the same from behind": (DiskRobot.with_limbs(4, fold=2), 8),
    "quadruped without symmetry": (DiskRobot.with_limbs(4), 8),
    "quadruped of four equal quarters": (DiskRobot.with_limbs(4, fold=4), 8),
    "quadruped with longer hind legs": (DiskRobot(np.array([0.25, 0.25, 0.32, 0.32]), _turns(4, 0)), 8),
    "quadruped with two long legs across": (DiskRobot(np.array([0.2, 0.3, 0.2, 0.3]), _turns(4, 0, 2)), 8),
    "tripod": (DiskRobot.with_limbs(3), 8),
    "tripod of three equal thirds": (DiskRobot.with_limbs(3, fold=3), 8),
    "biped": (DiskRobot.with_limbs(2), 8),
    "biped with interchangeable legs": (DiskRobot.with_limbs(2, fold=2), 8),
    "biped with one long leg": (DiskRobot(np.array([0.2, 0.35]), _turns(2, 0)), 8),
    "five limbs": (DiskRobot.with_limbs(5, reach=0.3), 7),
    "hexapod": (DiskRobot.with_limbs(6, reach=0.4, fold=2), 8),
    "one limb": (DiskRobot.with_limbs(1), 5),
}


def _ring(rng: np.random.Generator, num_holds: int, grips: tuple[str, ...]) -> Wall:
    """Holds of all sorts around a ring, so that many sets of them are convex."""
    angle = rng.uniform(0, 2 * np.pi, num_holds)
    position = 0.25 + 0.22 * np.stack([np.cos(angle), np.sin(angle), angle * 0]) + rng.normal(0, 0.02, (3, num_holds))
    holds = random_wall(rng, num_holds, grips).holds
    return Wall(
        tuple(replace(h, position=(float(x), float(y), 0.0)) for h, x, y in zip(holds, *position[:2], strict=True))
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_graph_equals_an_enumeration_of_permutations(name: str) -> None:
    robot, num_holds = ROBOTS[name]
    num_edges = num_walls = 0
    for seed in range(3):
        rng = np.random.default_rng(seed)
        wall = _ring(rng, num_holds, ("pin",) if "biped" in name else GRIPS)  # few other holds carry a robot alone
        truth = Enumeration(wall, robot)
        if not truth.stances:
            continue
        for holds in rng.permutation(sorted(truth.stances))[:5]:  # a start that can be left, if there is one
            start = Stance(tuple(int(h) for h in holds))
            edges = truth.explore(start)
            if edges:
                break
        graph = build_stance_graph(wall, robot, start, CostWeights())

        assert graph.counts["valid"] == len(truth.valid)
        assert graph.counts["non_crossing"] == len(truth.stances)
        names = [truth.name(Stance(tuple(int(h) for h in s))) for s in graph.stances]
        assert len(set(names)) == len(names)
        assert set(names) == {truth.name(s) for pair in edges for s in pair} | {truth.name(start)}
        assert names[graph.start] == truth.name(start)
        expected = {(truth.name(tail), truth.name(head)): costs for (tail, head), costs in edges.items()}
        found = {(names[t], names[h]): e for e, (t, h) in enumerate(zip(graph.tail, graph.head, strict=True))}
        assert len(found) == graph.num_edges and found.keys() == expected.keys()
        for pair, e in found.items():
            costs = (graph.reach_cost[e], graph.stability_cost[e], graph.robustness_cost[e])
            assert costs == pytest.approx(expected[pair], rel=1e-3)
        poses = graph.pose_graph()
        pairs = {(tuple(poses.poses[t]), tuple(poses.poses[h])) for t, h in zip(poses.tail, poses.head, strict=True)}
        everywhere = truth.explore(start, all_edges=True)
        assert pairs == {(tuple(sorted(tail.holds)), tuple(sorted(head.holds))) for tail, head in everywhere}
        num_edges, num_walls = num_edges + len(found), num_walls + 1
    assert num_walls >= 2
    assert (num_edges > 0) == (name != "one limb")  # a robot on one limb has nothing left to hold on with


def test_edges_are_sorted_and_carry_their_limb_support_and_cost() -> None:
    wall, _, _ = thesis_wall("W2")
    graph = _graph("W2")
    assert (np.diff(graph.tail.astype(np.int64) * graph.num_vertices + graph.head) > 0).all()
    cost = 100 * graph.reach_cost + graph.stability_cost + graph.robustness_cost
    np.testing.assert_array_equal(graph.cost, np.rint(cost))
    rng = np.random.default_rng(0)
    for e in rng.choice(graph.num_edges, 40, replace=False):
        tail, limb = Stance(tuple(graph.stances[graph.tail[e]])), int(graph.limb[e])
        (new,) = set(graph.stances[graph.head[e]]) - set(tail.holds)
        assert graph.vertex(tail.moved(limb, int(new))) == graph.head[e]
        assert graph.edge(int(graph.tail[e]), int(graph.head[e])) == e
        held = np.array([h for i, h in enumerate(tail.holds) if i != limb])
        reference = SupportProgram(wall.positions[held], wall_forces(wall)[held], weight_in_plane(wall, 2.0)).solve()
        assert tuple(graph.support[e]) == pytest.approx((reference.lower, reference.upper), abs=1e-6)
    ends = np.unique(graph.head)
    expected = hold_set_intervals(wall, graph.stances[ends], 2.0)
    np.testing.assert_allclose(graph.stance_support[ends], expected, atol=1e-9)


def test_numbering_of_the_holds_does_not_matter() -> None:
    wall, start, _ = thesis_wall("W2")
    shuffled = np.random.default_rng(5).permutation(len(wall.holds))  # new hold i is old hold shuffled[i]
    new_number = np.argsort(shuffled)
    graph = _graph("W2")
    other = build_stance_graph(
        Wall(tuple(wall.holds[i] for i in shuffled)),
        QUADRUPED,
        Stance(tuple(int(new_number[h]) for h in start.holds)),
        CostWeights(),
    )
    assert other.counts == graph.counts
    vertex = {other.vertex(Stance(tuple(int(new_number[h]) for h in s))): v for v, s in enumerate(graph.stances)}
    edges = {
        (vertex[t], vertex[h], c) for t, h, c in zip(other.tail.tolist(), other.head.tolist(), other.cost, strict=True)
    }
    assert edges == set(zip(graph.tail.tolist(), graph.head.tolist(), graph.cost, strict=True))


def test_decoded_walk_moves_one_limb_at_a_time_and_ends_at_its_vertex() -> None:
    _, start, _ = thesis_wall("W2")
    graph, rng = _graph("W2"), np.random.default_rng(7)
    for first in graph.images(start):
        walk = [graph.start]
        for _ in range(30):
            edges = range(graph.first_edge[walk[-1]], graph.first_edge[walk[-1] + 1])
            walk.append(int(graph.head[rng.choice(edges)]))
        stances = graph.decode(first, walk)
        assert stances[0] == first
        for a, b in pairwise(stances):
            assert sum(x != y for x, y in zip(a.holds, b.holds, strict=True)) == 1
        assert [graph.vertex(s) for s in stances] == walk


def test_what_is_not_a_walk_is_not_decoded() -> None:
    _, start, _ = thesis_wall("W1")
    graph = _graph("W1")
    far = int(graph.goal_vertices(holds=(6, 7, 8, 9))[0])
    with pytest.raises(ValueError, match="does not follow"):
        graph.decode(start, [graph.start, far])
    with pytest.raises(ValueError, match="does not follow"):
        graph.decode(start, [far])
    with pytest.raises(KeyError, match="no edge leads"):
        graph.edge(graph.start, far)
    with pytest.raises(KeyError, match="can be reached from the start"):
        graph.vertex(Stance((0, 1, 3, 2)))


def test_a_vertex_stands_for_the_images_of_its_stance_but_not_for_quarter_turns() -> None:
    _, start, _ = thesis_wall("W2")
    graph = _graph("W2")
    half_turn, quarter_turn = start.permuted((2, 3, 0, 1)), start.permuted((1, 2, 3, 0))
    assert graph.images(start) == [start, half_turn]
    assert graph.vertex(half_turn) == graph.vertex(start) == graph.start
    assert graph.vertex(quarter_turn) != graph.start


def test_goal_by_holds_by_stance_and_by_region() -> None:
    wall, start, goal = thesis_wall("W2")
    graph = _graph("W2")
    by_holds = graph.goal_vertices(holds=goal)
    assert len(by_holds) == 2 and all(set(graph.stances[v]) == set(goal) for v in by_holds)
    stance = Stance(tuple(int(h) for h in graph.stances[by_holds[0]]))
    for image in graph.images(stance):
        assert graph.goal_vertices(holds=goal, stance=image).tolist() == [by_holds[0]]
    assert graph.goal_vertices(holds=goal, stance=start).tolist() == []
    assert graph.goal_vertices().tolist() == list(range(graph.num_vertices))

    disks = [Point(p).buffer(0.25, quad_segs=64) for p in wall.positions[:, :2]]
    apart = box(0.10, 0.60, 0.12, 0.62).union(box(0.55, 0.60, 0.57, 0.62))  # each hold is near one, the body at neither
    for region in (box(0.30, 0.70, 0.32, 0.73), apart):
        expected = [
            v for v, s in enumerate(graph.stances) if shapely.intersection_all([disks[h] for h in s]).intersects(region)
        ]
        assert graph.goal_vertices(region=region).tolist() == expected
        assert 0 < len(expected) < graph.num_vertices
    each = [v for v, s in enumerate(graph.stances) if all(disks[h].intersects(apart) for h in s)]
    assert len(each) > len(expected)
    near = set(graph.goal_vertices(region=box(0.30, 0.70, 0.32, 0.73)).tolist())
    both = graph.goal_vertices(holds=goal, region=box(0.30, 0.70, 0.32, 0.73))
    assert set(both.tolist()) == near & set(by_holds.tolist())


def test_start_that_cannot_be_stood_on_says_why() -> None:
    wall, start, _ = thesis_wall("W1")
    with pytest.raises(ClimberError, match="counter-clockwise"):
        build_stance_graph(wall, QUADRUPED, Stance((3, 1, 2, 0)), CostWeights())
    with pytest.raises(ClimberError, match="within reach"):
        build_stance_graph(wall, QUADRUPED, Stance((9, 1, 0, 8)), CostWeights())
    for holds in ((3, 1, 0), (3, 1, 0, 0), (3, 1, 0, 10), (3, 1, 0, -1)):
        with pytest.raises(ValueError, match="different holds of 0 to 9"):
            build_stance_graph(wall, QUADRUPED, Stance(holds), CostWeights())
    assert build_stance_graph(wall, QUADRUPED, start, CostWeights()).start >= 0


def test_symmetry_that_is_not_one_is_refused() -> None:
    wall, start, _ = thesis_wall("W1")
    with pytest.raises(ValueError, match="not a rotation"):
        build_stance_graph(wall, DiskRobot(np.full(4, 0.25), ((1, 0, 3, 2),)), start, CostWeights())
    with pytest.raises(ValueError, match="unlike reach"):
        build_stance_graph(wall, DiskRobot(np.array([0.25, 0.25, 0.3, 0.3]), ((2, 3, 0, 1),)), start, CostWeights())


def test_holds_out_of_reach_of_the_start_add_no_moves() -> None:
    wall, start, _ = thesis_wall("W1")
    far = tuple(replace(h, position=(h.position[0] + 5.0, h.position[1], 0.0)) for h in wall.holds)
    alone, beside = (build_stance_graph(w, QUADRUPED, start, CostWeights()) for w in (wall, Wall(wall.holds + far)))
    assert beside.counts["poses"] == 2 * alone.counts["poses"]
    for stage in (
        "ordered_states_visited",
        "unique_transitions",
        "stable_directed",
        "graph_nodes",
        "vertices",
        "edges",
    ):
        assert beside.counts[stage] == alone.counts[stage]
    np.testing.assert_array_equal(beside.stances, alone.stances)


def test_weights_that_make_costs_too_large_to_count_are_refused() -> None:
    wall, start, _ = thesis_wall("W1")
    with pytest.raises(ValueError, match="use smaller weights"):
        build_stance_graph(wall, QUADRUPED, start, CostWeights(reach=1e11))


def test_a_start_without_moves_is_a_graph_of_one_vertex() -> None:
    wall = Wall(tuple(hold(x, y) for x, y in ((0.2, 0.2), (0.0, 0.2), (0.0, 0.0), (0.2, 0.0), (3.0, 3.0))))
    graph = build_stance_graph(wall, QUADRUPED, Stance((0, 1, 2, 3)), CostWeights())
    assert (graph.num_vertices, graph.num_edges, graph.start) == (1, 0, 0)
    assert graph.stance_support[0] == pytest.approx(hold_set_intervals(wall, np.array([[0, 1, 2, 3]]), 2.0)[0])
    assert graph.goal_vertices(holds=(0, 1, 2, 3)).tolist() == [0]
    assert len(graph.pose_graph().poses) == 0 and graph.decode(Stance((0, 1, 2, 3)), [0]) == [Stance((0, 1, 2, 3))]


def test_a_symmetric_robot_finds_the_same_walks_as_one_whose_symmetry_is_not_known() -> None:
    """The quotient loses nothing: from every start, the same stances by the same moves, twice."""
    wall, start, _ = thesis_wall("W1")
    quotient = build_stance_graph(wall, QUADRUPED, start, CostWeights())
    full = build_stance_graph(wall, DiskRobot.with_limbs(4), start, CostWeights())
    assert full.counts["graph_nodes"] == quotient.counts["graph_nodes"]
    image = [quotient.vertex(Stance(tuple(int(h) for h in s))) for s in full.stances]
    assert set(image) == set(range(quotient.num_vertices))
    edges = {(image[t], image[h]) for t, h in zip(full.tail, full.head, strict=True)}
    assert edges == set(zip(quotient.tail.tolist(), quotient.head.tolist(), strict=True))
