"""The relaxed checks of robots in space: they agree with the graph, and their numbers can be worked out again."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from problems import DiskRobot

from climber.balls import balls_meet
from climber.explain import explain_climb
from climber.graph import build_stance_graph
from climber.poses import Rotations, find_poses
from climber.programs.forces import wall_forces
from climber.relaxed import RelaxedChecks
from climber.scenario import CostWeights, scenario_from_text
from climber.solids import Sphere
from climber.stance import Move, Stance
from climber.stance_graph import StanceGraph
from climber.wall import Wall
from climber.wall_kinds import KINDS, make_wall

LIMBS = ("right_front", "left_front", "left_rear", "right_rear")
ROBOT = DiskRobot(np.full(4, 0.4), ((0, 1, 2, 3),), 7.0, 3)


def graph_on(wall: Wall) -> StanceGraph:
    rotations = Rotations.of(ROBOT.reach, ROBOT.symmetries)
    for holds in find_poses(wall.positions, ROBOT.reach, rotations, {}, wall.projected).tolist():
        graph = build_stance_graph(wall, ROBOT, Stance(tuple(holds)), CostWeights())
        if graph.num_edges:
            return graph
    raise AssertionError("no stance")


@pytest.mark.parametrize("kind", ["outside_corner", "chimney"])
def test_the_checks_pass_for_the_moves_of_the_graph_and_no_others(kind: str) -> None:
    wall = make_wall(replace(KINDS[kind], holds=12, seed=1, spacing=0.05, density=40.0 if kind == "chimney" else 20.0))
    if kind == "chimney":  # some holds are too smooth
        wall = replace(wall, holds=tuple(replace(h, friction=0.3 if i % 3 else 1.2) for i, h in enumerate(wall.holds)))
    graph, checks = graph_on(wall), RelaxedChecks(wall, ROBOT, LIMBS)
    edges = set(zip(graph.tail.tolist(), graph.limb.tolist(), graph.taken.tolist(), strict=True))
    rng, failed = np.random.default_rng(0), set()
    for _ in range(100):
        vertex, limb, hold = (int(rng.integers(n)) for n in (graph.num_vertices, 4, len(wall.holds)))
        stance = Stance(tuple(graph.stances[vertex].tolist()))
        if hold in stance.holds:
            continue
        failure = checks.first_failure(checks.of_move(Move(stance, limb, hold)))
        assert (failure is None) == ((vertex, limb, hold) in edges)
        if failure is not None:
            failed.add(failure.name)
            assert failure.amount >= 0.0  # feet in a line are out of order by nothing
    assert failed >= ({"order", "support"} if kind == "chimney" else {"reach", "order"})


def test_reach_is_short_by_the_radius_of_the_smallest_ball() -> None:
    wall = make_wall(replace(KINDS["inside_corner"], holds=12, seed=1, density=10.0))
    checks = RelaxedChecks(wall, ROBOT, LIMBS)
    for holds in list(combinations(range(12), 4))[::9]:
        check = checks.reach(list(enumerate(holds)), "these")
        if check.ok:
            continue
        centers, radius = wall.positions[list(holds)][None], check.numbers["enclosing_radius"]
        assert balls_meet(centers, np.full(4, radius + 1e-6))[0]
        assert not balls_meet(centers, np.full(4, radius - 1e-6))[0]
        point = np.array(check.numbers["nearest_pelvis"])
        assert np.linalg.norm(point - centers[0], axis=1).max() == pytest.approx(radius, abs=1e-5)
        assert "ball" in check.sentence


def test_what_contacts_lack_in_a_direction_is_no_more_than_they_can_push() -> None:
    wall = make_wall(replace(KINDS["chimney"], holds=12, seed=1, spacing=0.05, density=40.0))
    wall = replace(wall, holds=tuple(replace(hold, friction=0.3) for hold in wall.holds))
    checks, forces, failed = RelaxedChecks(wall, ROBOT, LIMBS), wall_forces(wall, 3), 0
    for holds in combinations(range(12), 3):
        check = checks.support(list(enumerate(holds)), "these")
        if check.ok:
            continue
        failed += 1
        direction, turning = np.array(check.numbers["direction"]), check.numbers["turning"]
        arms = wall.positions[list(holds)] - wall.positions[list(holds)].mean(axis=0)
        down = wall.gravity / np.linalg.norm(wall.gravity)
        aim = direction + turning * np.cross(down, arms)  # down . (arm x force) = (down x arm) . force
        most = forces[list(holds)].greatest(np.einsum("kdp,kd->kp", forces[list(holds)].generators, aim)).sum()
        assert most + check.amount == pytest.approx(-7.0 * direction @ wall.gravity, abs=1e-3)
        assert "cannot balance gravity" in check.sentence
    assert failed > 5


def test_a_region_of_space_that_is_too_far_is_told_of_by_how_much() -> None:
    wall = make_wall(replace(KINDS["vertical"], holds=12, seed=1, density=30.0))
    graph, checks = graph_on(wall), RelaxedChecks(wall, ROBOT, LIMBS)
    stance = Stance(tuple(graph.stances[0].tolist()))
    far = Sphere((0.3, 0.3, 1.5), 0.05)
    check = checks.region(stance, far, "it")
    grown = np.append(ROBOT.reach + check.amount, 0.05)
    every = np.concatenate([wall.positions[list(stance.holds)], [far.center]])[None]
    assert balls_meet(every, grown + 1e-6)[0]
    assert not balls_meet(every, grown - np.array([1e-5] * 4 + [0.0]))[0]
    assert checks.region(stance, Sphere((*wall.positions[list(stance.holds)].mean(axis=0),), 0.05), "it").ok


def test_a_climb_in_space_that_does_not_exist_is_explained() -> None:
    ledges = [[0.3 * column, 0.3 * row] for row in range(3) for column in range(3)]
    holds = "\n".join(f"  - {{position: [{x:.2f}, {y:.2f}], normal: [0, 1, 0]}}" for x, y in ledges)
    text = f"""
wall:
  hold_defaults: {{friction: 0.8, min_force: 0.0, max_force: 100.0}}
  facets: [{{corners: [[-1, -1, -0.04], [2, -1, -0.04], [2, 2, -0.04], [-1, 2, -0.04]]}}]
  holds:
{holds}
robots:
- model: package://climber/lemur/lemur.urdf
  start: {{right_front: 4, left_front: 3, left_rear: 0, right_rear: 1}}
  goal: {{pelvis: {{sphere: {{center: [0.3, 3.0, 0.1], radius: 0.1}}}}}}
"""
    told = explain_climb(scenario_from_text(text), seconds=0.0)
    said = " ".join(told.sentences)
    assert "There is no climb: the region of the goal cannot be reached" in said
    assert "too short for the pelvis to be in the region" in said
