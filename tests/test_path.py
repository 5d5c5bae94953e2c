"""Paths: feasible however finely one looks, joined end to end, flipping the elbows that must flip."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely
from robots import STARS, Standing, every_star, robot, standing
from shapely.geometry.base import BaseGeometry

from climber.balance import Region
from climber.chart import Chart
from climber.manifold import Body, Manifold, Margins
from climber.path import Leg, Search, clear, find_path, flips, line, unwound
from climber.roadmap import Roadmap
from climber.robot import Robot
from climber.rrt import advance, connect, shortened
from climber.stance import Contact, Vector
from climber.transition import PostureSampler
from climber.wall import Hold, Wall, circle

QUICK = Search(iterations=40, nodes=60, checks=80)


@dataclass(frozen=True)
class Task:
    """Two postures on a manifold, and the way found between them."""

    manifold: Manifold
    a: Vector
    b: Vector
    legs: list[Leg] | None


@cache
def stance(model: str, seed: int) -> tuple[Standing, Vector]:
    """A robot on pins, every second time with a limb in the air, and postures there."""
    limbs = len(robot(model).limbs)
    here = standing(model, seed, (seed % limbs,) if seed % 2 else ())
    return here, here.postures(np.random.default_rng(seed), 30)


@cache
def tasks(model: str) -> list[Task]:
    """Of several stances pairs of postures that bend none, one, two and three of the holding limbs unlike."""
    result = []
    for seed in range(4):
        here, q = stance(model, seed)
        pairs: dict[int, tuple[Vector, Vector]] = {}
        for a, b in itertools.combinations(q, 2):
            pairs.setdefault(len(flips(here.manifold, a, b)), (a, b))
        for number in sorted(pairs)[:4]:
            a, b = pairs[number]
            legs = find_path(here.manifold, a, b, np.random.default_rng(number), QUICK)
            result.append(Task(here.manifold, a, b, legs))
    return result


def found(model: str) -> list[tuple[Task, list[Leg]]]:
    return [(task, task.legs) for task in tasks(model) if task.legs is not None]


def configurations(leg: Leg, step: float = Search.step) -> Vector:
    """The whole polyline, both ends included, in steps of scaled chart coordinates; configurations (K, nq)."""
    pieces = [leg.u[:1], *(line(leg.chart, a, b, step) for a, b in itertools.pairwise(leg.u))]
    return leg.chart.expand(np.concatenate(pieces))[0]


def same_posture(model: str, one: Vector, two: Vector) -> bool:
    """Whether two configurations differ by whole turns of the pelvis at most."""
    return bool(np.abs(unwound(one, two, robot(model).angle_q) - two).max() < 1e-9)


# --- paths -----------------------------------------------------------------------------------------------------------


@every_star
def test_many_pairs_are_joined_among_them_pairs_that_flip_no_one_and_several_elbows(model: str) -> None:
    joined = found(model)
    assert len(joined) >= 6  # not all can be: a feasible set may be in pieces
    numbers = {len(flips(task.manifold, task.a, task.b)) for task, _ in joined}
    assert numbers >= {0, 1, 2}


@every_star
def test_path_joins_both_postures_each_leg_beginning_where_the_last_one_ended(model: str) -> None:
    for task, legs in found(model):
        ends = [leg.chart.expand(leg.u[[0, -1]])[0] for leg in legs]
        assert ends[0][0] == pytest.approx(task.a, abs=1e-9)
        assert same_posture(model, ends[-1][1], task.b)
        for (_, one), (two, _) in itertools.pairwise(ends):
            assert two == pytest.approx(one, abs=1e-9)
        assert all(len(leg.u) >= 2 for leg in legs)


@every_star
def test_path_is_feasible_when_looked_at_ten_times_as_finely(model: str) -> None:
    # Between checked points it may come nearer to a limit than the margins ask, but by a tenth of them at most.
    for task, legs in found(model):
        m = task.manifold.margins
        most = Margins(0.9 * m.reach, 0.9 * m.joint, 0.9 * m.clearance, 0.9 * m.balance)
        manifold = Manifold(task.manifold.body, task.manifold.contacts, task.manifold.support, most)
        for leg in legs:
            for a, b in itertools.pairwise(leg.u):
                u = np.concatenate([a[None], line(leg.chart, a, b, Search.step / 10)])
                assert manifold.feasible(leg.chart, u).all()


@every_star
def test_contacts_hold_all_along_and_nothing_jumps(model: str) -> None:
    for task, legs in found(model):
        for leg in legs:
            q = configurations(leg, Search.step / 10)
            feet = task.manifold.body.kinematics.feet(q)
            for i, point in task.manifold.points.items():
                assert np.abs(feet[:, i] - point).max() < 1e-12
            assert np.linalg.norm(np.diff(q, axis=0), axis=1).max() < 0.2


@every_star
def test_elbows_flip_in_charts_rooted_at_their_limb_and_nowhere_else(model: str) -> None:
    for task, legs in found(model):
        holding = sorted(task.manifold.points)
        for leg in legs:
            assert isinstance(leg.chart, Chart)
            bends = np.array([task.manifold.body.branches(q) for q in configurations(leg)])
            turned = {i for i in holding if len(set(bends[:, i])) > 1}
            assert turned <= {leg.chart.root}
        roots = {leg.chart.root for leg in legs if isinstance(leg.chart, Chart)}
        assert set(flips(task.manifold, task.a, task.b)) <= roots


@every_star
def test_same_seed_finds_the_same_path(model: str) -> None:
    for task in tasks(model)[:3]:
        again = [find_path(task.manifold, task.a, task.b, np.random.default_rng(7), QUICK) for _ in range(2)]
        assert (again[0] is None) == (again[1] is None)
        for one, two in zip(again[0] or [], again[1] or [], strict=True):
            assert np.array_equal(one.u, two.u)
            assert isinstance(one.chart, Chart) and isinstance(two.chart, Chart)
            assert one.chart.root == two.chart.root and one.chart.branches == two.chart.branches


@every_star
def test_path_back_and_path_from_a_turned_pelvis_exist_as_well(model: str) -> None:
    task = next(task for task, legs in found(model) if len(legs) == 1)
    back = find_path(task.manifold, task.b, task.a, np.random.default_rng(0), QUICK)
    assert back is not None
    turned = task.b.copy()
    turned[robot(model).angle_q[0]] += 4 * np.pi
    again = find_path(task.manifold, task.a, turned, np.random.default_rng(0), QUICK)
    assert again is not None and same_posture(model, configurations(again[-1])[-1], turned)


def test_posture_is_joined_to_itself_by_a_path_of_no_length() -> None:
    here, q = stance("quadruped", 0)
    legs = find_path(here.manifold, q[0], q[0], np.random.default_rng(0))
    assert legs is not None and len(legs) == 1
    assert np.ptp(legs[0].u, axis=0).max() == 0.0


# --- what stands in the way ------------------------------------------------------------------------------------------

ANGLES = np.radians([60.0, 120.0, 240.0, 300.0])
RING = 0.19 * np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
FOUR = [Contact(i, i) for i in range(4)]


def ring(obstacles: tuple[object, ...] = (), air: tuple[int, ...] = ()) -> Manifold:
    """The quadruped on four pins around it, wherever its centre of mass."""
    holds = tuple(Hold((x, y, 0.0), (0.0, 1.0, 0.0), 0.6, max_force=200.0, grip="pin") for x, y in RING)
    body = Body(robot("quadruped"), Wall(holds, obstacles))  # type: ignore[arg-type]
    return Manifold(body, [c for c in FOUR if c.limb not in air], Region.interval(-1.0, 1.0))


def posture(manifold: Manifold, x: float, y: float, branches: tuple[int, ...] = (0, 0, 0, 0)) -> Vector:
    """The pelvis at a place, level, all limbs on their holds."""
    chart = Chart(manifold.body, manifold.points, branches)
    u = np.zeros((1, len(chart.independent)))
    u[0, :2] = x, y
    q, reach = chart.expand(u)
    assert reach[0] > 0.001 and manifold.slack(q)[0] >= 0
    return np.asarray(q[0])


def test_open_way_is_a_straight_line() -> None:
    manifold = ring()
    a, b = posture(manifold, -0.04, 0.0), posture(manifold, 0.04, 0.0)
    legs = find_path(manifold, a, b, np.random.default_rng(0))
    assert legs is not None and len(legs) == 1 and len(legs[0].u) == 2
    assert np.abs(configurations(legs[0])[:, 1:3]).max() < 1e-12


def swing(obstacles: tuple[object, ...] = (), width: float = 1.0) -> tuple[Manifold, Vector, Vector]:
    """The ring with the right front limb in the air, which is to swing through two radians."""
    manifold = ring(obstacles, (0,))
    a, b = posture(manifold, 0.0, 0.0), posture(manifold, 0.0, 0.0)
    a[HIP], b[HIP] = 0.4, -1.6
    a[KNEE] = b[KNEE] = 0.3
    manifold = Manifold(manifold.body, manifold.contacts, Region.interval(-width, width))
    assert manifold.slack(np.array([a, b])).min() >= 0
    return manifold, a, b


HIP, KNEE = robot("quadruped").limbs[0].q
OPEN, LEFT, RIGHT = swing()
HALFWAY = OPEN.body.kinematics.feet((LEFT + RIGHT)[None] / 2)[0, 0, :2]
HIP_AT = robot("quadruped").limbs[0].hip[:2]
OUTWARDS = (HALFWAY - HIP_AT) / np.linalg.norm(HALFWAY - HIP_AT)
PEG = circle(HALFWAY, 0.01)


def bar(near: float) -> BaseGeometry:
    """A bar from `near` the hip outwards [m], half-way of the swing."""
    return shapely.LineString([HIP_AT + near * OUTWARDS, HIP_AT + 0.5 * OUTWARDS]).buffer(0.003)


def test_nothing_in_the_way_of_a_swing_leaves_it_a_straight_line() -> None:
    legs = find_path(OPEN, LEFT, RIGHT, np.random.default_rng(0))
    assert legs is not None and [len(leg.u) for leg in legs] == [2]


@pytest.mark.parametrize("obstacle", [PEG, bar(0.13), bar(0.03)], ids=["peg", "far bar", "near bar"])
def test_obstacle_in_the_way_of_a_swing_is_gone_around(obstacle: BaseGeometry) -> None:
    manifold, a, b = swing((obstacle,))
    chart = manifold.chart(a)
    assert not clear(manifold, chart, chart.coordinates(a), chart.coordinates(b))
    legs = find_path(manifold, a, b, np.random.default_rng(0))
    assert legs is not None and sum(len(leg.u) - 1 for leg in legs) > 1
    q = np.concatenate([configurations(leg, 0.004) for leg in legs])
    assert (manifold.body.clearance(manifold.body.kinematics.poses(q)) > 0.0009).all()
    assert np.ptp(q[:, [0, 1, 2, KNEE]], axis=0).max() > 0.01  # more than the hip turns


def test_bar_that_only_the_whole_body_could_pass_leaves_no_way_if_that_would_fall() -> None:
    manifold, a, b = swing((bar(0.03),), width=0.03)
    assert find_path(manifold, a, b, np.random.default_rng(0)) is None


def test_joints_whose_range_is_wider_than_a_turn_do_not_jump_from_one_end_of_it_to_the_other(tmp_path: Path) -> None:
    source = robot("quadruped").model.path
    text = source.read_text().replace('lower="-2.618" upper="2.618"', 'lower="-4.0" upper="4.0"')
    (tmp_path / "quadruped.urdf").write_text(text)
    (tmp_path / "quadruped.yaml").write_text(source.with_suffix(".yaml").read_text())
    machine = Robot(tmp_path / "quadruped.urdf")
    holds = tuple(Hold((x, y, 0.0), (0.0, 1.0, 0.0), 0.6, max_force=200.0, grip="pin") for x, y in RING)
    # One limb only, so that the pelvis can be where its hip has to turn by half a turn; nothing else is in the way.
    manifold = Manifold(Body(machine, Wall(holds)), [Contact(0, 0)], Region.interval(-1.0, 1.0))
    manifold.body.clearance = lambda poses: np.full(len(poses[0].origin), np.inf)  # type: ignore[method-assign, assignment]
    chart = Chart(manifold.body, manifold.points, (0, 0, 0, 0))
    around = np.zeros((400, len(chart.independent)))
    turn = np.linspace(-np.pi, np.pi, 400)
    around[:, 2] = turn
    hips = np.exp(1j * (turn + np.pi / 3)) * 0.05
    around[:, 0], around[:, 1] = RING[0, 0] - hips.real - 0.1, RING[0, 1] - hips.imag
    q, reach = chart.expand(around)
    hip = machine.limbs[0].q[0]
    jumps = np.flatnonzero(np.abs(np.diff(q[:, hip])) > np.pi)
    assert len(jumps) and (reach > 0.05).all()
    i = int(jumps[0])
    # On either side of the jump the posture is feasible a little way off, and the way between is not.
    before, after = around[max(i - 5, 0)], around[i + 6]
    assert manifold.feasible(chart, np.array([before, after])).all()
    for step in (0.04, 10.0):  # even if next to nothing between is looked at
        assert not clear(manifold, chart, before, after, Search(step=step))
    assert clear(manifold, chart, before, around[i - 3])


# --- straight lines, trees, shortening -------------------------------------------------------------------------------


@every_star
def test_line_ends_at_its_end_in_even_steps_no_longer_than_asked(model: str) -> None:
    here, q = stance(model, 0)
    chart = here.manifold.chart(q[0])
    a, b = chart.coordinates(q[0]), chart.coordinates(q[1])
    points = line(chart, a, b, 0.05)
    steps = np.linalg.norm(np.diff(points, axis=0, prepend=a[None]) * chart.scale, axis=1)
    assert points[-1] == pytest.approx(b, abs=1e-12) and steps.max() <= 0.05 + 1e-12
    assert np.ptp(steps) < 1e-9
    assert len(line(chart, a, a, 0.05)) == 1


@every_star
def test_advance_stops_before_the_first_point_that_is_not_feasible(model: str) -> None:
    here, q = stance(model, 0)
    search = Search()
    stopped = 0
    for posture_ in q:
        chart = here.manifold.chart(posture_)
        start = chart.coordinates(posture_)
        rng = np.random.default_rng(0)
        for _ in range(3):
            direction = rng.normal(size=len(start))
            goal = start + direction / np.linalg.norm(direction) / chart.scale
            points, arrived = advance(here.manifold, chart, start, goal, search)
            assert np.array_equal(points[0], start)
            assert here.manifold.feasible(chart, points[1:]).all()
            assert clear(here.manifold, chart, start, goal, search) == arrived
            if arrived:
                assert points[-1] == pytest.approx(goal, abs=1e-12)
            else:
                beyond = points[-1] + (goal - start) * np.linspace(0, 1, 400)[:, None]
                to_goal = np.linalg.norm((points[-1] - goal) * chart.scale)
                beyond = beyond[np.linalg.norm((beyond - points[-1]) * chart.scale, axis=1) <= min(0.08, to_goal)]
                assert not here.manifold.feasible(chart, beyond).all()
                stopped += 1
    assert stopped > 0


@every_star
def test_checked_configurations_are_close_also_where_a_limb_is_nearly_straight(model: str) -> None:
    search = Search()
    closest = 0.0
    for task, legs in found(model):
        for leg in legs:
            for a, b in itertools.pairwise(leg.u):
                points, arrived = advance(task.manifold, leg.chart, a, b, search)
                q, _ = leg.chart.expand(points)
                assert arrived
                gaps = np.linalg.norm(np.diff(q, axis=0), axis=1)
                assert gaps.max() <= 2 * search.joint_step
                closest = max(closest, float(gaps.max()))
    assert closest > 0.02


def test_tree_search_finds_corners_that_are_joined_by_feasible_lines() -> None:
    manifold, a, b = swing((PEG,))
    chart = manifold.chart(a)
    for seed in range(6):
        u = connect(manifold, chart, chart.coordinates(a), chart.coordinates(b), np.random.default_rng(seed), Search())
        assert u is not None
        assert np.array_equal(u[0], chart.coordinates(a)) and np.array_equal(u[-1], chart.coordinates(b))
        assert all(clear(manifold, chart, p, r) for p, r in itertools.pairwise(u))
    assert connect(manifold, chart, u[0], u[-1], np.random.default_rng(0), Search(iterations=0)) is None


def test_shortening_keeps_both_ends_and_feasibility_and_never_lengthens() -> None:
    manifold, a, b = swing((PEG,))
    chart = manifold.chart(a)
    shorter = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        u = connect(manifold, chart, chart.coordinates(a), chart.coordinates(b), rng, Search())
        assert u is not None
        leg = shortened(manifold, Leg(chart, u), rng, Search())
        before, after = (float(np.linalg.norm(np.diff(x, axis=0) * chart.scale, axis=1).sum()) for x in (u, leg.u))
        assert np.array_equal(leg.u[0], u[0]) and np.array_equal(leg.u[-1], u[-1])
        assert after <= before + 1e-12
        shorter += after < 0.95 * before
        assert all(clear(manifold, chart, p, r) for p, r in itertools.pairwise(leg.u))
        assert np.array_equal(shortened(manifold, leg, rng, Search(shortcuts=0)).u, leg.u)
    assert shorter >= 3


# --- the roadmap -----------------------------------------------------------------------------------------------------


def test_roadmap_remembers_what_it_found_out() -> None:
    task, _ = max(found("quadruped"), key=lambda item: len(flips(item[0].manifold, item[0].a, item[0].b)))
    roadmap = Roadmap(task.manifold, np.random.default_rng(0), QUICK)
    checks = []
    for _ in range(2):
        looked = 0
        original = roadmap._leg

        def counted(*args: object, original: object = original) -> object:
            nonlocal looked
            looked += 1
            return original(*args)  # type: ignore[operator]

        roadmap._leg = counted  # type: ignore[method-assign, assignment]
        assert roadmap.path(task.a, task.b) is not None
        roadmap._leg = original  # type: ignore[method-assign]
        checks.append(looked)
    assert checks[1] < checks[0]


@every_star
def test_roadmap_joins_what_the_direct_way_joins(model: str) -> None:
    task, _ = next((t, legs) for t, legs in found(model) if len(legs) == 1 and len(flips(t.manifold, t.a, t.b)) <= 1)
    roadmap = Roadmap(task.manifold, np.random.default_rng(0))
    legs = roadmap.path(task.a, task.b)
    assert legs is not None
    assert configurations(legs[0])[0] == pytest.approx(task.a, abs=1e-9)
    assert same_posture(model, configurations(legs[-1])[-1], task.b)


def test_roadmap_gives_up_when_its_checks_are_used_up() -> None:
    here, q = stance("quadruped", 0)
    pairs = itertools.combinations(range(len(q)), 2)
    a, b = next((q[i], q[j]) for i, j in pairs if len(flips(here.manifold, q[i], q[j])) >= 2)
    assert Roadmap(here.manifold, np.random.default_rng(0), Search(checks=1)).path(a, b) is None
    assert Roadmap(here.manifold, np.random.default_rng(0), Search(nodes=0)).path(a, b) is None


def test_roadmap_of_a_stance_without_postures_is_empty() -> None:
    here, q = stance("quadruped", 0)
    nowhere = replace_support(here.manifold, Region.interval(50.0, 51.0))
    assert Roadmap(nowhere, np.random.default_rng(0)).path(q[0], q[1]) is None


def replace_support(manifold: Manifold, support: Region) -> Manifold:
    return Manifold(manifold.body, manifold.contacts, support, manifold.margins)


def test_unwound_takes_the_pelvis_within_half_a_turn_and_leaves_the_rest() -> None:
    rng = np.random.default_rng(0)
    q, reference = rng.uniform(-20, 20, (50, 5)), rng.uniform(-20, 20, (50, 5))
    result = unwound(q, reference, 2)
    assert np.abs(result[:, 2] - reference[:, 2]).max() <= np.pi + 1e-12
    assert np.exp(1j * result[:, 2]) == pytest.approx(np.exp(1j * q[:, 2]))
    assert np.array_equal(np.delete(result, 2, axis=1), np.delete(q, 2, axis=1))
    assert unwound(q[0], reference[:3], 2).shape == (3, 5)


def test_every_model_has_room_for_paths() -> None:
    for model in STARS:
        here, q = stance(model, 0)
        assert len(q) == 30 and (here.manifold.slack(q) >= 0).all()
        sampler = PostureSampler(here.body, here.manifold)
        assert not sampler.unreachable()
    assert replace(QUICK, iterations=1).nodes == QUICK.nodes
