"""What is proved away has no posture, and what obviously has none is proved away."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from climber.balance import Region
from climber.graph import build_stance_graph
from climber.manifold import Body, Manifold, Margins
from climber.prune import distances, impossible_moves, out_of_reach
from climber.prune_balance import MassBounds, transition_intervals
from climber.random_scenario import find_climb
from climber.random_wall import Recipe
from climber.robot import Robot
from climber.scenario import load_scenario
from climber.stance import Contact, Stance
from climber.stance_graph import StanceGraph
from climber.transition import PostureSampler, find_transition, support_of
from climber.wall import Hold, Wall
from climber.wall_command import MODEL
from climber.wall_kinds import make_wall

NO_MARGINS = Margins(reach=0.0, joint=0.0, clearance=0.0, balance=0.0)


@cache
def _robot() -> Robot:
    return Robot("package://climber/quadruped/quadruped.urdf")


@cache
def _higher() -> tuple[Wall, StanceGraph]:
    scenario = load_scenario("higher")
    start = Stance(tuple(scenario.robots[0].start[name] for name in _robot().limb_names))
    wall = scenario.build_wall()
    return wall, build_stance_graph(wall, _robot(), start, scenario.cost)


def _square(half: float, half_width: float = 0.0) -> Wall:
    corners = [(half, half), (-half, half), (-half, -half), (half, -half)]
    return Wall(tuple(Hold((x, y, 0.0), (0.0, 1.0, 0.0), 0.6, half_width) for x, y in corners))


def test_a_square_is_out_of_reach_from_where_the_legs_end() -> None:
    """At each angle the farthest corner less its hip decides: the least of that over all angles is the border."""
    robot = _robot()
    hips = np.array([limb.hip[:2] for limb in robot.limbs])
    length = float(robot.reach[0] - np.linalg.norm(hips[0]))
    sign = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    angles = np.linspace(-np.pi, np.pi, 40_001)
    turn = np.stack([np.cos(angles), -np.sin(angles), np.sin(angles), np.cos(angles)], axis=1).reshape(-1, 2, 2)
    turned = np.einsum("kij,nj->kni", turn, hips)

    def least(half: float) -> float:
        # Square and hips are the same turned by half a turn, so the pelvis's origin is best at the middle.
        return float(np.linalg.norm(half * sign - turned, axis=2).max(axis=1).min())

    low, high = 0.05, 0.3
    for _ in range(50):
        low, high = ((low + high) / 2, high) if least((low + high) / 2) <= length else (low, (low + high) / 2)
    stance = np.array([[0, 1, 2, 3]])
    assert not out_of_reach(robot, _square(low - 1e-4), stance)[0]
    assert out_of_reach(robot, _square(low + 1e-4), stance)[0]
    # On patches a foot may be nearer by their half width, and not by more.
    assert not out_of_reach(robot, _square(low + 0.006, half_width=0.01), stance)[0]
    assert out_of_reach(robot, _square(low + 0.0101, half_width=0.01), stance)[0]


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**31))
def test_a_stance_with_a_posture_is_never_out_of_reach(seed: int) -> None:
    """From a random posture to holds under its feet, which are anywhere on their patches."""
    rng, robot = np.random.default_rng(seed), _robot()
    body = Body(robot, Wall(()))
    low, high = (np.concatenate(ends) for ends in zip(*(limb.one_turn for limb in robot.limbs), strict=True))
    q = np.zeros((200, robot.plant.num_positions()))
    q[:, robot.base_q] = rng.uniform([-1, -1, -np.pi], [1, 1, np.pi], (200, 3))
    q[:, np.concatenate([limb.q for limb in robot.limbs])] = rng.uniform(low, high, (200, len(low)))
    q[:50, np.concatenate([limb.q[1:] for limb in robot.limbs])] = 0.0  # straight legs, at the border of reach
    feet = body.kinematics.feet(q)
    holds, stances = [], []
    for k in range(200):
        stances.append(list(range(4 * k, 4 * k + 4)))
        for i in range(4):
            slope, width = rng.uniform(-1.5, 1.5), float(rng.choice([0.0, 0.01, 0.03]))
            normal = np.array([-np.sin(slope), np.cos(slope), 0.0])
            offset = rng.uniform(-width, width) * np.array([normal[1], -normal[0], 0.0])
            point = feet[k, i] - offset
            holds.append(Hold((point[0], point[1], 0.0), tuple(normal), 0.6, width))
    assert not out_of_reach(robot, Wall(tuple(holds)), np.array(stances)).any()


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**31))
def test_the_pelvis_is_where_the_bounds_on_the_centre_of_mass_leave_it(seed: int) -> None:
    rng, robot = np.random.default_rng(seed), _robot()
    body, bounds = Body(robot, Wall(())), MassBounds.of(robot)
    assert bounds is not None
    low, high = (np.concatenate(ends) for ends in zip(*(limb.one_turn for limb in robot.limbs), strict=True))
    q = np.zeros((300, robot.plant.num_positions()))
    q[:, robot.base_q] = rng.uniform([-1, -1, -np.pi], [1, 1, np.pi], (300, 3))
    q[:, np.concatenate([limb.q for limb in robot.limbs])] = rng.uniform(low, high, (300, len(low)))
    x, angle = q[:, robot.base_q[0]], q[:, robot.base_q[2]]
    mass = body.kinematics.center_of_mass(q)[:, 0]
    feet = body.kinematics.feet(q)[..., 0]
    half = float(rng.choice([0.0, 0.1]))
    width = rng.choice([0.0, 0.01], feet.shape)
    near = angle + rng.uniform(-half, half, 300)
    hips = np.array([limb.hip[:2] for limb in robot.limbs])
    turned = np.cos(near)[:, None] * hips[:, 0] - np.sin(near)[:, None] * hips[:, 1]
    inside = np.column_stack([mass, mass])
    on_patch = feet + rng.uniform(-1, 1, feet.shape) * width
    left, right = bounds.pelvis_range(near, turned, on_patch, width, inside, half)
    assert (left <= x).all() and (x <= right).all()
    exact = bounds.pelvis_range(
        angle, np.cos(angle)[:, None] * hips[:, 0] - np.sin(angle)[:, None] * hips[:, 1], feet, 0 * width, inside, 0.0
    )
    assert (exact[1] - exact[0]).max() < 0.12  # the legs weigh two fifths and are a tenth long: no idle bounds


def test_moves_with_postures_at_both_ends_are_kept() -> None:
    """On the wall of `higher`, sampled: no transition found by chance is among those proved impossible."""
    wall, graph = _higher()
    robot = _robot()
    body, rng = Body(robot, wall), np.random.default_rng(1)
    removed = impossible_moves(graph, robot, wall)
    assert 0 < len(removed) < graph.num_edges / 4
    for edge in rng.choice(removed, 40, replace=False):
        tail, head = (Stance(tuple(int(h) for h in graph.stances[v])) for v in (graph.tail[edge], graph.head[edge]))
        limb = int(graph.limb[edge])
        taken = (set(head.holds) - set(tail.holds)).pop()
        ends = ((tail, limb), (tail.moved(limb, taken), limb))
        found = []
        for stance, moving in ends:
            offsets = rng.uniform(-1, 1, 4) * [wall.holds[h].half_width for h in stance.holds]
            contacts = [Contact(i, h, float(o)) for i, (h, o) in enumerate(zip(stance.holds, offsets, strict=True))]
            found.append(len(find_transition(body, contacts, moving, rng, NO_MARGINS, rounds=(2000,))))
        assert min(found) == 0


def test_stances_proved_out_of_reach_have_no_sampled_posture() -> None:
    wall, graph = _higher()
    body, rng = Body(_robot(), wall), np.random.default_rng(2)
    far = np.flatnonzero(out_of_reach(_robot(), wall, graph.stances))
    assert len(far) > 30
    for vertex in rng.choice(far, 30, replace=False):
        holds = graph.stances[vertex].tolist()
        contacts = [Contact(i, h, float(rng.uniform(-1, 1)) * wall.holds[h].half_width) for i, h in enumerate(holds)]
        manifold = Manifold(body, contacts, Region.interval(-9.0, 9.0), NO_MARGINS)
        assert PostureSampler(body, manifold).draw(rng, 2000)[3] == 0


def test_on_points_all_that_the_sampler_finds_out_of_reach_is_proved_so_at_once() -> None:
    wall, graph = _higher()
    points = replace(wall, holds=tuple(replace(hold, half_width=0.0) for hold in wall.holds))
    body = Body(_robot(), points)
    far = out_of_reach(_robot(), points, graph.stances)
    for vertex in range(0, graph.num_vertices, 5):
        contacts = [Contact(i, h) for i, h in enumerate(graph.stances[vertex].tolist())]
        unreachable = PostureSampler(body, Manifold(body, contacts, Region.interval(-9.0, 9.0))).unreachable()
        assert far[vertex] or not unreachable


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**31))
def test_support_anywhere_on_the_patches_is_within_the_interval(seed: int) -> None:
    wall, graph = _higher()
    rng = np.random.default_rng(seed)
    total = graph.stances.sum(axis=1)
    taken = total[graph.head] - total[graph.tail] + graph.stances[graph.tail, graph.limb]
    arriving = (graph.stances[graph.head] == taken[:, None]).argmax(axis=1).astype(np.int8)
    intervals = transition_intervals(graph, wall, arriving)
    edge = int(rng.integers(graph.num_edges))
    vertex, limb = (graph.tail[edge], graph.limb[edge]) if seed % 2 else (graph.head[edge], arriving[edge])
    holds = graph.stances[vertex].tolist()
    offsets = rng.choice([-1.0, 1.0], 4) * [wall.holds[h].half_width for h in holds]
    contacts = [Contact(i, h, float(o)) for i, (h, o) in enumerate(zip(holds, offsets, strict=True))]
    every, others = (support_of(_body(), c) for c in (contacts, [c for c in contacts if c.limb != limb]))
    if every is None or others is None:
        return
    lower, upper = every.meet(others).abscissas
    if lower <= upper:
        assert intervals[vertex, limb, 0] <= lower and upper <= intervals[vertex, limb, 1]


@cache
def _body() -> Body:
    return Body(_robot(), _higher()[0])


def test_a_large_graph_looked_at_near_short_climbs_has_the_same_shortest(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = Recipe(holds=60, seed=4)
    wall = make_wall(recipe)
    climb = find_climb(recipe, MODEL)
    start = Stance(tuple(climb.start[name] for name in _robot().limb_names))
    lengths = []
    for most in (10**9, 0):
        monkeypatch.setattr("climber.prune.MOST_KEYS", most)
        graph = build_stance_graph(wall, _robot(), start, load_scenario("basic").cost)
        goals = np.array([v for v in range(graph.num_vertices) if wall.positions[graph.stances[v], 1].mean() > 1.0])
        removed = impossible_moves(graph, _robot(), wall, goals)
        usable = np.ones(graph.num_edges, dtype=bool)
        usable[removed] = False
        every = np.arange(graph.num_edges)
        away = distances(np.array([graph.start]), graph.first_edge, every, graph.head, usable)
        lengths.append(away[goals].min())
        counted = graph.counts["edges_out_of_reach"] + graph.counts["edges_out_of_balance"]
        assert counted == len(removed)
    assert lengths[0] == lengths[1] < np.inf
