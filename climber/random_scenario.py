"""A random wall with a climb to look for: from a stance near its bottom to a place near its top.

That the start can be held, that the goal has a posture of its own, and that the stance graph leads from one to the
other is checked. Whether the motions exist is for the planner to find out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climber.exceptions import ClimberError
from climber.graph import build_stance_graph
from climber.holdsets import Ints
from climber.manifold import Body
from climber.poses import Rotations, find_poses
from climber.programs.regions import hold_sets_carried
from climber.prune import distances, impossible_moves, out_of_reach
from climber.random_wall import Recipe, hold_defaults
from climber.robot import Model, Robot
from climber.scenario_fields import CostWeights
from climber.scenario_shapes import CircleSpec, RegionSpec
from climber.stance import Contact, Stance, Vector
from climber.stance_graph import StanceGraph
from climber.transition import Postures
from climber.transitions import TransitionFinder
from climber.wall_kinds import facet_specs, hold_specs, make_wall, off_problem

NEIGHBOURS = 24  # holds around a place that stances there are made of
TRIES = 12  # stances that can be held, tried at most at either end
GOAL_RADIUS = 0.06  # [m]
SECONDS, SECONDS_IN_SPACE = 120, 600  # for a climb, and half a second more for each hold


@dataclass(frozen=True)
class RandomClimb:
    """Where to climb on a random wall.

    Attributes:
        start: The hold of each limb, by name.
        goal: Region for the pelvis's origin.
        moves: No climb there has fewer moves.
    """

    start: dict[str, int]
    goal: CircleSpec
    moves: int


def find_climb(recipe: Recipe, model: str, folder: Path | None = None) -> RandomClimb:
    """Makes the wall and looks for a start and a goal.

    Args:
        recipe: What the wall is made by.
        model: The robot's model, `package://climber/...` or a path.
        folder: Where a relative path starts.

    Raises:
        ClimberError: If no wall can be made by the recipe, no stance near either end of it can be held, or the stance
            graph does not lead from one end to the other.
        ModelError: If the model cannot be planned for.
    """
    wall = make_wall(recipe)
    robot = Robot(Model.load(model, folder), wall.gravity)
    finder = TransitionFinder(Body(robot, wall), np.random.default_rng(recipe.seed))
    barred = off_problem(recipe)
    width, height = recipe.size
    if (room := float(robot.reach.max())) > height:
        raise ClimberError(
            f"the wall is only {height:.3g} m high and the robot reaches {room:.3g} m: no room for a climb; "
            f"take more holds, a smaller density or a greater aspect"
        )
    middle = 0.0 if recipe.kind.endswith("corner") else width / 2  # x = 0 is the edge of a corner
    places = np.array([[middle, room / 2], [middle, height - room / 2]])
    starts, tops = (list(_held(finder, end, barred)) for end in places)
    if not starts or not tops:
        where = "top" if starts else "bottom"
        raise ClimberError(
            f"no stance near the {where} of the wall can be held; take another seed or density, or rougher holds"
        )
    origin = robot.origin_q[:2]
    goals = [CircleSpec([round(float(x), 3) for x in found.q[0, origin]], GOAL_RADIUS) for found in tops]
    for found in starts:
        start = Stance(tuple(contact.hold for contact in found.contacts))
        graph = build_stance_graph(wall, robot, start, CostWeights(), barred)
        usable = np.ones(graph.num_edges, dtype=bool)
        usable[impossible_moves(graph, robot, wall, ends(graph, goals[0]))] = False
        moves = distances(np.array([graph.start]), graph.first_edge, np.arange(graph.num_edges), graph.head, usable)
        for goal in goals:
            least = moves[ends(graph, goal)].min(initial=np.inf)
            if 0 < least < np.inf:
                return RandomClimb(dict(zip(robot.limb_names, start.holds, strict=True)), goal, int(least))
    raise ClimberError(
        f"from none of {len(starts)} stances near the bottom does the stance graph lead to the top; "
        f"take another seed, a greater density, or rougher holds"
    )


def _held(finder: TransitionFinder, place: Vector, barred: Sequence[int]) -> Iterator[Postures]:
    """Postures on stances around a place in the wall plane that can be held, the nearest and most upright first."""
    body = finder.body
    wall, robot = body.wall, body.robot
    usable = np.setdiff1d(np.arange(len(wall.holds)), barred)
    positions = wall.positions[:, : robot.dimension]
    distance = np.linalg.norm(positions[usable, :2] - place, axis=1)
    near = np.sort(usable[distance.argsort()[:NEIGHBOURS]])
    if len(near) < len(robot.limbs):
        return
    rotations = Rotations.of(robot.reach, robot.symmetries)
    poses = near[find_poses(positions[near], robot.reach, rotations, {}, lambda sets: wall.projected(near[sets]))]
    turned = [np.roll(poses, rotations.period * lift, axis=1) for lift in range(rotations.copies)]
    stances = np.concatenate(turned)
    stances = stances[hold_sets_carried(wall, stances, robot.mass, robot.dimension)]
    stances = stances[~out_of_reach(robot, wall, stances)]
    seen = wall.projected(stances)
    centers = wall.positions[stances][..., :2].mean(axis=1)
    hips = np.array([limb.hip[:2] for limb in robot.limbs])
    hips /= np.maximum(np.linalg.norm(hips, axis=1, keepdims=True), 1e-9)
    away = seen - seen.mean(axis=1, keepdims=True)
    away /= np.maximum(np.linalg.norm(away, axis=2, keepdims=True), 1e-9)
    upright = (away * hips).sum(axis=2).mean(axis=1)  # 1 if every limb points where its hip does
    held = 0
    for holds in stances[np.argsort(np.linalg.norm(centers - place, axis=1) - robot.reach.max() * upright)].tolist():
        found = finder.standing(tuple(Contact(limb, hold) for limb, hold in enumerate(holds)))
        if found.failure is None:
            yield found
            held += 1
            if held == TRIES:
                return


def ends(graph: StanceGraph, goal: CircleSpec) -> Ints:
    """The vertices at which the pelvis can be in the goal."""
    return graph.goal_vertices(region=RegionSpec(circle=goal).inside())


def scenario_text(recipe: Recipe, model: str, climb: RandomClimb, name: str, made_by: str) -> str:
    """The scenario as YAML, one line to a hold.

    Args:
        recipe: What the wall is made by.
        model: The robot's model, as the file is to name it.
        climb: The climb on it.
        name: The scenario's name.
        made_by: The command that makes this file, for the comment on top.
    """
    defaults = hold_defaults(recipe)
    lines = [
        f"# Made by: {made_by}",
        f"name: {name}",
        f"description: {_what(recipe)}; at least {climb.moves} moves from bottom to top.",
        f"seed: {recipe.seed}",
        "wall:",
        f"  inclination_deg: {recipe.inclination_deg!r}",
        f"  hold_defaults: {{half_width: {defaults.half_width:g}, min_force: {defaults.min_force:g}, "
        f"max_force: {defaults.max_force:g}, grip: {defaults.grip}}}",
        "  holds:",
    ]
    lines += [
        f"  - {{position: {spec.position}, normal: {spec.normal}, friction: {spec.friction}}}  # {number}"
        for number, spec in enumerate(hold_specs(recipe))
    ]
    facets = facet_specs(recipe)
    if facets:
        lines += ["  facets:", *(f"  - {{corners: {facet.corners}, thickness: {facet.thickness}}}" for facet in facets)]
    start = ", ".join(f"{limb}: {hold}" for limb, hold in climb.start.items())
    seconds = SECONDS if recipe.kind == "plane" else SECONDS_IN_SPACE
    lines += [
        "robots:",
        "- name: climber",
        f"  model: {model}",
        f"  start: {{{start}}}",
        "  goal:",
        f"    pelvis: {{circle: {{center: {climb.goal.center}, radius: {climb.goal.radius}}}}}",
        *([f"  avoid: {{holds: {barred}}}  # these are not of the problem"] if (barred := off_problem(recipe)) else []),
        f"budget: {{time_limit_s: {seconds + recipe.holds // 2}}}",
    ]
    return "\n".join(lines) + "\n"


def _what(recipe: Recipe) -> str:
    """The wall in words."""
    width, height = recipe.size
    if recipe.kind == "board":
        return f"A board that leans {recipe.inclination_deg - 90.0:g} degrees past vertical, with a problem set on it"
    if recipe.kind == "chimney":
        return f"{recipe.holds} holds in a chimney {width:.2f} m wide and {height:.2f} m high"
    place = {"plane": "", "inside_corner": " of an inside corner", "outside_corner": " of an outside corner"}
    return (
        f"{recipe.holds} holds at random, {recipe.density:g} to the square metre, on {width:.2f} m x "
        f"{height:.2f} m{place.get(recipe.kind, '')}"
    )
