"""The beginning of a climb, with everything that improves it, for tests that need one with little ado."""

from __future__ import annotations

from functools import cache

import numpy as np

from climber.demands import Demands
from climber.manifold import Body
from climber.motion import MotionPlanner
from climber.phases import Way
from climber.plan_parts import ObjectiveKind
from climber.robot import Model, Robot
from climber.scenario import Scenario, load_scenario, scenario_from_text
from climber.scenario_fields import MinMargin
from climber.stance import Move, Stance
from climber.start import start_postures
from climber.transitions import TransitionFinder

MOVES = ((0, 5), (1, 3), (3, 4), (2, 2))  # limb and hold: how the climb of `basic` begins
GOAL = "holds: [6, 7, 8, 9]\n    pelvis: {circle: {center: [0.699769, 0.132026]"
NEARER = "holds: [2, 3, 4, 5]\n    pelvis: {circle: {center: [0.303501, 0.137414]"


def short() -> Scenario:
    """`basic`, but only as far as its first moves lead."""
    basic = load_scenario("basic")
    assert basic.source.count(GOAL) == 1
    return scenario_from_text(basic.source.replace(GOAL, NEARER), "short.yaml", basic.folder)


@cache
def beginning(
    count: int = 3, seed: int = 0, objective: ObjectiveKind = "length", free_start: bool = False, push: float = 0.0
) -> tuple[MotionPlanner, Way]:
    """The first moves of `basic`, to survive a push [N] throughout, and the planner that planned them."""
    scenario = load_scenario("basic")
    wall = scenario.build_wall()
    robot = Robot(Model.load(scenario.robots[0].model, scenario.folder), wall.gravity)
    body = Body(robot, wall, Demands.of(wall, MinMargin(push=push)))
    finder = TransitionFinder(body, np.random.default_rng(seed))
    stance = Stance(tuple(scenario.robots[0].start[name] for name in robot.limb_names))
    start = start_postures(scenario, 0, finder, stance)
    moves = []
    for limb, hold in MOVES[:count]:
        moves.append(Move(stance, limb, hold))
        stance = moves[-1].end
    assert not finder.survey(start.contacts, moves)
    planner = MotionPlanner(finder, objective=objective)
    way = planner.plan(start, moves, {count: [None]}, free_start=free_start)
    assert isinstance(way, Way)
    return planner, way
