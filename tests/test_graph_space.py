"""The stance graph in space: against an enumeration one check at a time, and planar walls taken as walls in space."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import combinations, permutations, product

import numpy as np
import pytest
from problems import QUADRUPED, DiskRobot, random_wall, thesis_wall

from climber.balls import balls_meet
from climber.exceptions import ClimberError
from climber.graph import build_stance_graph
from climber.kinematics import Kinematics
from climber.polygon import in_order
from climber.poses import Rotations, find_poses
from climber.programs.regions import hold_set_regions, hold_sets_carried
from climber.prune import impossible_moves, out_of_reach
from climber.robot import Robot
from climber.scenario import CostWeights
from climber.solids import Box, Sphere, triple
from climber.stance import Stance
from climber.stance_graph import StanceGraph
from climber.wall import Hold, Wall
from climber.wall_kinds import KINDS, make_wall

WEIGHTS = CostWeights()
LEMUR = DiskRobot(np.full(4, 0.5), ((0, 1, 2, 3), (2, 3, 0, 1)), 7.0, 3)


@pytest.mark.parametrize("name", ["W1", "W2"])
def test_a_planar_wall_taken_as_one_in_space_has_the_same_graph(name: str) -> None:
    wall, start, _ = thesis_wall(name)
    plane, space = (
        build_stance_graph(wall, QUADRUPED, start, WEIGHTS, through_space=through) for through in (False, True)
    )
    same(plane, space)


def test_planar_walls_of_all_sorts_taken_as_walls_in_space_have_the_same_graph() -> None:
    robots = [
        DiskRobot.with_limbs(3),
        DiskRobot(np.array([0.25, 0.25, 0.32, 0.32]), ((0, 1, 2, 3),)),
        DiskRobot.with_limbs(5, reach=0.4),
        DiskRobot.with_limbs(2),
    ]
    compared = 0
    for seed, robot in product(range(6), robots):
        wall = random_wall(np.random.default_rng(seed), 10, size=0.5)
        for holds in ([0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [5, 2, 7, 1, 8]):
            start = Stance(tuple(holds[: len(robot.reach)]))
            try:
                plane = build_stance_graph(wall, robot, start, WEIGHTS)
            except ClimberError:
                continue
            same(plane, build_stance_graph(wall, robot, start, WEIGHTS, through_space=True))
            compared += 1
    assert compared > 5


def same(a: StanceGraph, b: StanceGraph) -> None:
    for name in ("stances", "tail", "head", "limb", "cost", "support_index", "start"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    for name in ("reach_cost", "stability_cost", "robustness_cost", "support", "stance_support"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-6)
    assert a.counts == b.counts


class Enumeration:
    """The graph by searches over ordered stances, one check at a time, each set of holds looked at once."""

    def __init__(self, wall: Wall, robot: DiskRobot) -> None:
        self.wall, self.robot, self.n = wall, robot, len(robot.reach)
        sets = np.array(list(combinations(range(len(wall.holds)), self.n - 1)))
        carried = hold_sets_carried(wall, sets, robot.mass, 3)
        self.carried = {frozenset(row) for row in sets[carried].tolist()}
        self.met: dict[frozenset[int], bool] = {}
        every = list(permutations(range(len(wall.holds)), self.n))
        self.stances = {s for s in every if self.meet(s) and in_order(wall.projected(np.array(s)))}

    def meet(self, holds: tuple[int, ...]) -> bool:
        """Whether balls of one reach around all the holds meet."""
        key = frozenset(holds)
        if key not in self.met:
            centers = self.wall.positions[sorted(key)][None]
            self.met[key] = bool(balls_meet(centers, np.full(len(key), self.robot.reach[0]))[0])
        return self.met[key]

    def edges(self, start: Stance) -> set[tuple[Stance, Stance]]:
        edges, seen, queue = set(), {start}, deque([start])
        while queue:
            tail = queue.popleft()
            for limb, hold in product(range(self.n), range(len(self.wall.holds))):
                head = tail.moved(limb, hold)
                stay = frozenset(h for i, h in enumerate(tail.holds) if i != limb)
                if hold in tail.holds or head.holds not in self.stances or stay not in self.carried:
                    continue
                if not self.meet((*tail.holds, hold)):
                    continue
                edges.add((tail, head))
                if head not in seen:
                    seen.add(head)
                    queue.append(head)
        return edges


def some_start(wall: Wall, robot: DiskRobot | Robot) -> Stance:
    """A stance that has moves."""
    rotations = Rotations.of(robot.reach, robot.symmetries)
    poses = find_poses(wall.positions, robot.reach, rotations, {}, wall.projected)
    for holds in poses.tolist():
        if build_stance_graph(wall, robot, Stance(tuple(holds)), WEIGHTS).num_edges:
            return Stance(tuple(holds))
    raise AssertionError("no stance")


@pytest.mark.parametrize("kind", ["slab", "inside_corner", "outside_corner", "chimney"])
def test_graph_equals_an_enumeration(kind: str) -> None:
    base = KINDS[kind]
    wall = make_wall(replace(base, holds=9, seed=2, spacing=0.05, density=60.0 if kind != "chimney" else 40.0))
    rng = np.random.default_rng(0)
    shift = rng.uniform(-0.05, 0.05, (len(wall.holds), 3))
    bumped = tuple(
        replace(hold, position=triple(p)) for hold, p in zip(wall.holds, wall.positions + shift, strict=True)
    )
    robot = replace(LEMUR, reach=np.full(4, 0.36), symmetries=((0, 1, 2, 3),))
    wall = replace(wall, holds=bumped)
    start = some_start(wall, robot)
    graph = build_stance_graph(wall, robot, start, WEIGHTS)
    expected = Enumeration(wall, robot).edges(start)
    found = {
        (Stance(tuple(graph.stances[tail].tolist())), Stance(tuple(graph.stances[head].tolist())))
        for tail, head in zip(graph.tail, graph.head, strict=True)
    }
    assert found == expected
    assert len(found) > 10


def test_costs_are_of_distance_width_and_volume() -> None:
    wall = make_wall(replace(KINDS["vertical"], holds=14, seed=1, density=25.0))
    graph = build_stance_graph(wall, LEMUR, some_start(wall, LEMUR), WEIGHTS)
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (200_000, 3))
    for edge in rng.choice(graph.num_edges, 5, replace=False):
        tail, head, limb = graph.stances[graph.tail[edge]], graph.stances[graph.head[edge]], graph.limb[edge]
        old, new = wall.positions[graph.released[edge]], wall.positions[graph.taken[edge]]
        assert graph.reach_cost[edge] == pytest.approx(np.linalg.norm(old - new))
        assert set(tail.tolist()) ^ set(head.tolist()) == {int(graph.released[edge]), int(graph.taken[edge])}
        stay = np.delete(tail, limb)
        middle = wall.positions[stay].mean(axis=0)
        inside = (np.linalg.norm(points[:, None] + middle - wall.positions[stay], axis=2) <= 0.5).all(axis=1)
        assert 1.0 / graph.robustness_cost[edge] == pytest.approx(8.0 * inside.mean(), abs=0.01)
        corners = hold_set_regions(wall, np.sort(stay)[None], 7.0, 3, gap=1e-3).corners[0]
        turn = np.pi * np.arange(4) / 4
        widths = np.ptp(corners @ np.stack([np.cos(turn), np.sin(turn)]), axis=0)
        assert 1.0 / graph.stability_cost[edge] == pytest.approx(widths.min(), abs=0.025)
        expected = 100.0 * graph.reach_cost[edge] + graph.stability_cost[edge] + graph.robustness_cost[edge]
        assert graph.cost[edge] == round(expected)
    assert graph.stance_support.shape == (0, 2)


def test_goals_are_stances_whose_bodies_can_be_in_a_region_of_space() -> None:
    wall = make_wall(replace(KINDS["vertical"], holds=14, seed=1, density=25.0))
    graph = build_stance_graph(wall, LEMUR, some_start(wall, LEMUR), WEIGHTS)
    ball = Sphere((0.4, 0.5, 0.1), 0.05)
    goals = graph.goal_vertices(region=ball)
    every = np.concatenate([wall.positions[graph.stances], np.full((graph.num_vertices, 1, 3), ball.center)], axis=1)
    np.testing.assert_array_equal(goals, np.flatnonzero(balls_meet(every, np.append(LEMUR.reach, 0.05))))
    assert 0 < len(goals)
    assert len(graph.goal_vertices(region=Sphere((0.4, 0.5, 0.6), 0.05))) == 0  # no limb is so long
    assert set(goals) <= set(graph.goal_vertices(region=Box(ball.center, (0.1, 0.1, 0.1))))


def test_five_limbs_in_space() -> None:
    robot = DiskRobot(np.full(5, 0.45), ((0, 1, 2, 3, 4),), 4.0, 3)
    wall = make_wall(replace(KINDS["inside_corner"], holds=8, seed=3, spacing=0.05, density=40.0))
    start = some_start(wall, robot)
    graph = build_stance_graph(wall, robot, start, WEIGHTS)
    found = {
        (Stance(tuple(graph.stances[tail].tolist())), Stance(tuple(graph.stances[head].tolist())))
        for tail, head in zip(graph.tail, graph.head, strict=True)
    }
    assert found == Enumeration(wall, robot).edges(start)


def test_stances_proved_out_of_reach_have_no_posture_and_moves_between_them_are_pruned() -> None:
    recipe = replace(KINDS["vertical"], holds=24, seed=1)
    wall = make_wall(recipe)
    robot = Robot("package://climber/lemur/lemur.urdf", wall.gravity)
    graph = build_stance_graph(wall, robot, some_start(wall, robot), WEIGHTS)
    far = out_of_reach(robot, wall, graph.stances)
    assert 0.01 < far.mean() < 0.5
    cut = impossible_moves(graph, robot, wall)
    np.testing.assert_array_equal(cut, np.flatnonzero(far[graph.tail] | far[graph.head]))
    # Feet where a posture has them are never called too far apart.
    kinematics, rng = Kinematics(robot), np.random.default_rng(0)
    q = np.zeros((500, robot.plant.num_positions()))
    q[:, robot.angle_q] = rng.uniform(-1.0, 1.0, (500, 3))
    q[:, kinematics.joint_q] = 0.2 * rng.uniform(kinematics.lower, kinematics.upper, (500, len(kinematics.lower)))
    for feet in kinematics.feet(q):
        there = Wall(tuple(Hold(triple(p), (0.0, 1.0, 0.0), 0.5) for p in feet))
        assert not out_of_reach(robot, there, np.array([[0, 1, 2, 3]]))[0]


@pytest.mark.parametrize("robot", [QUADRUPED, LEMUR])
def test_holds_to_avoid_take_no_part_and_the_rest_of_the_graph_is_as_it_was(robot: DiskRobot) -> None:
    kind, density = ("vertical", 25.0) if robot.dimension == 3 else ("plane", 60.0)
    wall = make_wall(replace(KINDS[kind], holds=16, seed=1, density=density, spacing=0.05))
    start = some_start(wall, robot)
    whole = build_stance_graph(wall, robot, start, WEIGHTS)
    avoid = next(hold for hold in range(16) if hold not in start.holds and (whole.stances == hold).any())
    less = build_stance_graph(wall, robot, start, WEIGHTS, [avoid])
    assert not (less.stances == avoid).any()

    def edges(graph: StanceGraph) -> dict[tuple[tuple[int, ...], tuple[int, ...]], int]:
        ends = graph.stances.tolist()
        columns = zip(graph.tail, graph.head, graph.cost.tolist(), strict=True)
        return {(tuple(ends[tail]), tuple(ends[head])): cost for tail, head, cost in columns}

    kept = {ends: cost for ends, cost in edges(whole).items() if avoid not in ends[0] + ends[1]}
    found = edges(less)
    assert found.items() <= kept.items()
    # What is missing starts where only stances on the hold to be avoided lead to.
    reached = {tail for tail, _ in found} | {head for _, head in found}
    assert not any(tail in reached for tail, _ in kept.keys() - found.keys())
