"""Transition postures: each is what it claims to be, and what is called impossible is impossible."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from problems import thesis_wall
from robots import MODELS, clear_configurations, every_model, kinematics, robot, standing

from climber.balance import Region
from climber.manifold import Body, Manifold, Margins
from climber.planar_bases import PlanarBases, enclosing_circles
from climber.programs.equilibrium import SupportProgram
from climber.robot import Model, Robot
from climber.scenario import Budget, load_scenario
from climber.stance import Contact, Vector
from climber.transition import (
    Postures,
    PostureSampler,
    between,
    find_transition,
    spread,
    support_of,
)
from climber.transitions import Effort, TransitionFinder
from climber.wall import Hold, Wall, circle

seeds = st.integers(0, 2**32 - 1)
coordinates = st.one_of(
    st.integers(-2, 2).map(float), st.floats(-2, 2, allow_subnormal=False).map(lambda x: round(x, 9))
)

# --- enclosing circles -----------------------------------------------------------------------------------------------


def through(points: Vector) -> tuple[Vector, float]:
    """The smallest circle with all of one, two or three points on it; radius inf if there is none."""
    if len(points) == 1:
        return points[0], 0.0
    if len(points) == 2:
        return points.mean(axis=0), float(np.linalg.norm(points[1] - points[0]) / 2)
    A = 2 * (points[1:] - points[0])
    if abs(np.linalg.det(A)) < 1e-12:
        return points[0], np.inf
    center = np.linalg.solve(A, (points[1:] ** 2).sum(axis=1) - (points[0] ** 2).sum())
    return center, float(np.linalg.norm(points[0] - center))


def by_trying_all(points: Vector) -> float:
    """Radius of the smallest circle around points: the least of all through one to three of them that hold the rest."""
    best = np.inf
    for size in (1, 2, 3):
        for few in itertools.combinations(points, size):
            center, radius = through(np.array(few))
            if radius < best and (np.linalg.norm(points - center, axis=1) <= radius + 1e-9).all():
                best = radius
    return float(best)


@settings(max_examples=300, deadline=None)
@given(hnp.arrays(float, st.tuples(st.integers(1, 6), st.just(2)), elements=coordinates))
def test_enclosing_circle_is_the_smallest_of_all_circles_through_some_of_the_points(points: Vector) -> None:
    (center,), (radius,) = enclosing_circles(points[None])
    assert radius == pytest.approx(by_trying_all(points), abs=1e-8)
    assert (np.linalg.norm(points - center, axis=1) <= radius + 1e-7).all()


@pytest.mark.parametrize(
    ("points", "center", "radius"),
    [
        ([(1, 2)], (1, 2), 0.0),
        ([(0, 0), (2, 0)], (1, 0), 1.0),
        ([(0, 0), (0, 0), (0, 0)], (0, 0), 0.0),
        ([(0, 0), (1, 0), (4, 0), (2, 0)], (2, 0), 2.0),  # on a line
        ([(0, 0), (2, 0), (1, 0.5)], (1, 0), 1.0),  # an obtuse triangle
        ([(0, 0), (2, 0), (0, 2)], (1, 1), np.sqrt(2)),  # a right one
        ([(0, 0), (2, 0), (1, np.sqrt(3))], (1, 1 / np.sqrt(3)), 2 / np.sqrt(3)),  # an equilateral one
        ([(0, 0), (2, 0), (2, 2), (0, 2), (1, 1)], (1, 1), np.sqrt(2)),
    ],
)
def test_enclosing_circle_worked_by_hand(
    points: list[tuple[float, float]], center: tuple[float, float], radius: float
) -> None:
    c, r = enclosing_circles(np.array([points, points], dtype=float))
    assert c[1] == pytest.approx(center, abs=1e-12) and r == pytest.approx([radius] * 2, abs=1e-12)


# --- what is called unreachable --------------------------------------------------------------------------------------


def on_wall(model: str, points: Vector, **hold: object) -> Body:
    """The robot on a wall with strong pins at some points."""
    defaults: dict[str, object] = {"friction": 0.6, "max_force": 200.0, "grip": "pin"} | hold
    return Body(robot(model), Wall(tuple(Hold((*p[:2], 0.0), (0.0, 1.0, 0.0), **defaults) for p in points)))  # type: ignore[arg-type]


def everywhere(here: Body) -> Manifold:
    """All configurations with every limb on the hold of its number, wherever the centre of mass."""
    contacts = [Contact(i, i) for i in range(len(here.robot.limbs))]
    return Manifold(here, contacts, Region.interval(-np.inf, np.inf), Margins(0.0, 0.0, 0.0, 0.0))


def reachable_on_a_grid(here: Body, angles: int, steps: int) -> bool:
    """Whether at some pose of a grid every hip is within its limb's length of its hold, by trying them all."""
    holds = here.wall.positions[:, :2]
    lengths = np.array([limb.reach - np.linalg.norm(limb.hip) for limb in here.robot.limbs])
    low, high = holds.min(axis=0) - 0.3, holds.max(axis=0) + 0.3
    x, y = np.meshgrid(*(np.linspace(a, b, steps) for a, b in zip(low, high, strict=True)))
    pelvis = x.ravel() + 1j * y.ravel()
    hips = np.array([complex(*limb.hip[:2]) for limb in here.robot.limbs])
    points = holds[:, 0] + 1j * holds[:, 1]
    return any(
        (np.abs(pelvis[:, None] + np.exp(1j * angle) * hips - points) <= lengths).all(axis=1).any()
        for angle in np.linspace(-np.pi, np.pi, angles, endpoint=False)
    )


@every_model
@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_stance_that_a_dense_grid_of_poses_reaches_is_not_called_unreachable(model: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    holds = rng.uniform(-1, 1, (len(robot(model).limbs), 2)) * rng.uniform(0.1, 0.5)
    here = on_wall(model, holds)
    unreachable = PostureSampler(here, everywhere(here)).unreachable()
    if unreachable:
        assert not reachable_on_a_grid(here, 90, 60)


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_unreachable_is_exact_for_equal_limbs_but_for_a_cell_of_the_angle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    holds = rng.uniform(-1, 1, (4, 2)) * rng.uniform(0.2, 0.4)
    here = on_wall("quadruped", holds)
    hips = np.array([complex(*limb.hip[:2]) for limb in here.robot.limbs])
    turned = np.exp(1j * np.linspace(-np.pi, np.pi, 2000, endpoint=False))[:, None] * hips
    centers = holds - np.stack([turned.real, turned.imag], axis=-1)
    radius = min(by_trying_all(points) for points in centers[::25])
    radius = min(radius, float(enclosing_circles(centers)[1].min()))
    slop = 0.05 * np.pi / PlanarBases.CELLS
    unreachable = PostureSampler(here, everywhere(here)).unreachable()
    if unreachable:
        assert radius > 0.2
    else:
        assert radius <= 0.2 + 2 * slop


def test_stances_of_both_kinds_were_among_them() -> None:
    rng = np.random.default_rng(0)
    answers = set()
    for scale in (0.1, 0.3, 0.35, 0.4, 0.5):
        here = on_wall("quadruped", rng.uniform(-1, 1, (4, 2)) * scale)
        answers.add(PostureSampler(here, everywhere(here)).unreachable())
    assert answers == {True, False}


@every_model
@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_stance_that_some_configuration_stands_on_is_not_called_unreachable(model: str, seed: int) -> None:
    q = np.random.default_rng(seed).uniform(-3, 3, (1, robot(model).plant.num_positions()))
    here = on_wall(model, kinematics(model).feet(q)[0])
    assert not PostureSampler(here, everywhere(here)).unreachable()


# --- what is found ---------------------------------------------------------------------------------------------------


@cache
def found(model: str, seed: int) -> tuple[Body, int, Postures]:
    """Transition postures on a stance that has one."""
    here = standing(model, seed)
    limb = seed % len(here.contacts)
    return here.body, limb, find_transition(here.body, here.contacts, limb, np.random.default_rng(seed))


@every_model
@pytest.mark.parametrize("seed", range(6))
def test_every_posture_found_is_on_its_holds_balanced_either_way_inside_limits_and_clear(model: str, seed: int) -> None:
    here, limb, postures = found(model, seed)
    machine, margins = here.robot, Margins()
    context = machine.context()
    support = [c for c in postures.contacts if c.limb != limb]
    intervals = [SupportProgram.of_contacts(here.wall, c, machine.mass).solve() for c in (support, postures.contacts)]
    for i, q in enumerate(postures.q):
        machine.plant.SetPositions(context, q)
        assert np.abs(machine.foot_positions(context) - here.wall.points(postures.contacts)).max() < 1e-12
        x = machine.center_of_mass(context)[0]
        for interval in intervals:
            room = min(margins.balance, 0.2 * interval.width)
            assert interval.lower + room - 1e-9 <= x <= interval.upper - room + 1e-9
        for part in machine.limbs:
            assert (q[part.q] >= part.lower + margins.joint - 1e-12).all()
            assert (q[part.q] <= part.upper - margins.joint + 1e-12).all()
        assert here.clearance(here.kinematics.poses(q[None]))[0] >= margins.clearance
        assert here.branches(q) == tuple(postures.branches[i])
        assert postures.posture(i).branches == here.branches(q)
        assert np.array_equal(postures.posture(i).q, q) and postures.posture(i).contacts == postures.contacts
    assert (postures.slack >= 0).all() and len(postures.slack) == len(postures.branches) == len(postures)
    assert (postures.failure is None) == (len(postures) > 0)
    assert len(np.unique(postures.q, axis=0)) == len(postures) <= 24


@every_model
def test_posture_is_found_where_there_is_one(model: str) -> None:
    # The stances are made from a posture; on most of them it is balanced with and without the limb.
    assert sum(len(found(model, seed)[2]) > 0 for seed in range(6)) >= 4


@every_model
def test_margin_of_reach_is_kept(model: str) -> None:
    here, _, postures = found(model, 0)
    for q in postures.q:
        for limb, chain, inverse in zip(here.robot.limbs, here.kinematics.chains, here.inverse, strict=True):
            assert inverse is not None
            pelvis = here.kinematics.pelvis(q[None, :3])
            links = chain.links(pelvis, q[None, limb.q])
            distance = np.linalg.norm((chain.foot_position(pelvis, links) - links[-2].origin)[0])
            near, far = inverse.extent
            assert near + Margins().reach - 1e-12 <= distance <= far - Margins().reach + 1e-12


@every_model
def test_same_seed_finds_the_same_postures(model: str) -> None:
    here, limb, postures = found(model, 1)
    again = find_transition(here, postures.contacts[::-1], limb, np.random.default_rng(1))
    assert again.contacts == postures.contacts
    assert np.array_equal(again.q, postures.q) and np.array_equal(again.branches, postures.branches)
    other = find_transition(here, postures.contacts, limb, np.random.default_rng(2))
    assert not np.array_equal(other.q, postures.q)


def test_postures_are_spread_over_the_ways_to_bend_with_the_roomiest_first() -> None:
    here, limb, postures = found("quadruped", 0)
    many = find_transition(here, postures.contacts, limb, np.random.default_rng(3), rounds=(20_000,), most=10_000)
    few = find_transition(here, postures.contacts, limb, np.random.default_rng(3), rounds=(20_000,), most=6)
    assert len(few) == 6
    kinds = [tuple(b) for b in few.branches]
    assert len(set(kinds)) == min(6, len({tuple(b) for b in many.branches}))
    first = {kind: few.slack[kinds.index(kind)] for kind in kinds}
    for kind, slack in first.items():
        assert slack == max(s for b, s in zip(many.branches, many.slack, strict=True) if tuple(b) == kind)


def test_spread_takes_the_best_of_each_kind_in_turn() -> None:
    kinds = np.array([[0, 0], [0, 0], [0, 0], [1, 0], [1, 0], [0, 1]])
    value = np.array([1.0, 5.0, 3.0, 2.0, 9.0, 0.5])
    assert list(spread(kinds, value, 10)) == [4, 1, 5, 2, 3, 0]
    assert list(spread(kinds, value, 4)) == [4, 1, 5, 2]
    assert len(spread(np.zeros((0, 2), dtype=int), np.zeros(0), 4)) == 0


def test_sampler_draws_postures_with_a_limb_in_the_air_too() -> None:
    for model in MODELS:
        here = standing(model, 3, (1,))
        sampler = PostureSampler(here.body, here.manifold)
        q, branches, slack, reachable = sampler.draw(np.random.default_rng(0), 20_000)
        assert len(q) and reachable >= len(np.unique(q[:, :3], axis=0))
        assert (here.manifold.slack(q) == slack).all() and (slack >= 0).all()
        feet = here.body.kinematics.feet(q)
        for i, point in here.manifold.points.items():
            assert np.abs(feet[:, i] - point).max() < 1e-12
        held = sorted(here.manifold.points)
        assert [tuple(row[held]) for row in branches] == [tuple(np.array(here.body.branches(x))[held]) for x in q]
        assert np.ptp(q[:, here.body.robot.limbs[1].q], axis=0).min() > 0.5


def test_between_stands_on_the_contacts_of_both_and_keeps_both_margins() -> None:
    here = standing("quadruped", 0)
    some = here.contacts[:3]
    one = Manifold(here.body, some, Region.interval(0.0, 1.0))
    two = Manifold(here.body, here.contacts, Region.interval(0.5, 0.505))
    both = between(one, two)
    assert both.contacts == here.contacts
    assert both.balanced.abscissas == pytest.approx((0.501, 0.504))  # a fifth of 5 mm each side, and 2 mm of the other
    assert both.margins == replace(Margins(), balance=0.0)


# --- what is not -----------------------------------------------------------------------------------------------------

SQUARE = np.array([[0.15, 0.15], [-0.15, 0.15], [-0.15, -0.15], [0.15, -0.15]])
FOUR = [Contact(i, i) for i in range(4)]


def failure_of(here: Body, limb: int = 0, **kwargs: object) -> tuple[str, str]:
    postures = find_transition(here, FOUR, limb, np.random.default_rng(0), **kwargs)  # type: ignore[arg-type]
    assert len(postures) == 0 and postures.q.shape == (0, 11) and postures.branches.shape == (0, 4)
    assert postures.failure is not None
    return postures.failure.kind, postures.failure.reason


def test_square_of_pins_has_postures() -> None:
    assert len(find_transition(on_wall("quadruped", SQUARE), FOUR, 0, np.random.default_rng(0))) > 0


def test_holds_too_far_apart_are_proved_out_of_reach() -> None:
    kind, reason = failure_of(on_wall("quadruped", 2.5 * SQUARE))
    assert kind == "proved" and "no angle of the pelvis" in reason


def test_holds_just_within_reach_of_stretched_limbs_only_are_not_proved_out_of_reach() -> None:
    # Hips at 0.05 m and limbs of 0.2 m reach 0.25 m from the middle; the margin of reach is what fails.
    angles = np.radians([60.0, 120.0, 240.0, 300.0])
    here = on_wall("quadruped", 0.25 * np.column_stack([np.cos(angles), np.sin(angles)]))
    kind, reason = failure_of(here)
    assert kind == "budget" and "with every limb on its hold among 24500 pelvis poses" in reason


def test_limbs_that_cannot_carry_the_robot_alone_are_a_proof() -> None:
    kind, reason = failure_of(on_wall("quadruped", SQUARE, max_force=3.0))
    assert kind == "proved" and reason == "no forces of the limbs other than right_front balance gravity"


def test_limbs_that_cannot_all_press_are_a_proof() -> None:
    # Three frictionless holds carry 19.6 N with forces of 3 to 5 N along each of two edges; four must press 24 N.
    here = on_wall("quadruped", SQUARE, grip="friction", friction=0.0, min_force=3.0, max_force=5.0)
    assert support_of(here, FOUR[1:]) is not None
    kind, reason = failure_of(here)
    assert kind == "proved" and reason == "no forces of all limbs balance gravity"


def test_support_intervals_apart_are_a_proof() -> None:
    # Three holds in a column carry the robot right above them; the fourth presses at least 8 N 0.3 m beside them.
    points = np.array([[0.15, 0.15], [-0.15, 0.15], [-0.15, -0.15], [-0.15, -0.2]])
    holds = on_wall("quadruped", points, grip="friction", friction=0.0, max_force=30.0).wall.holds
    here = Body(robot("quadruped"), Wall((replace(holds[0], min_force=4.0), *holds[1:])))
    kind, reason = failure_of(here)
    assert kind == "proved"
    assert reason == f"the supports with and without right_front lie {0.3 * 8 / (2 * 9.81):.4f} m apart"


def test_centre_of_mass_that_no_posture_brings_over_its_support_is_out_of_budget() -> None:
    # The right front limb's hold is as far away as it reaches, and the others can carry only what is left of -0.06 m.
    points = np.array([[0.25, 0.1], [-0.19, 0.1], [-0.19, -0.1], [-0.06, -0.15]])
    here = on_wall("quadruped", points, grip="friction", friction=0.0, max_force=30.0)
    support = support_of(here, FOUR[1:])
    assert support is not None and support.abscissas == pytest.approx((-0.19, -0.06))
    kind, reason = failure_of(here, rounds=(2000,))
    assert kind == "budget"
    assert reason == "no posture with the centre of mass supported and no collision among 2000 pelvis poses"


def test_obstacle_over_the_holds_leaves_none_within_the_budget() -> None:
    clear = on_wall("quadruped", SQUARE)
    here = Body(clear.robot, Wall(clear.wall.holds, (circle((0.15, 0.15), 0.02),)))
    kind, reason = failure_of(here, rounds=(500, 1000))
    assert kind == "budget"
    assert reason == "no posture with the centre of mass supported and no collision among 1500 pelvis poses"


def test_later_rounds_are_drawn_only_if_those_before_found_nothing() -> None:
    here = on_wall("quadruped", SQUARE)
    one = find_transition(here, FOUR, 0, np.random.default_rng(0), rounds=(500,))
    assert len(one)
    rng = np.random.default_rng(0)
    two = find_transition(here, FOUR, 0, rng, rounds=(500, 10**9))  # would not fit in memory
    assert np.array_equal(one.q, two.q)


def test_a_posture_that_one_pose_in_a_hundred_thousand_leads_to_is_found_with_patience() -> None:
    """The only climb of basic with few moves hangs on it."""
    scenario = load_scenario("basic")
    wall = scenario.build_wall()
    body = Body(Robot(Model.load(scenario.robots[0].model, scenario.folder), wall.gravity), wall)
    contacts = tuple(Contact(limb, hold) for limb, hold in enumerate((6, 7, 2, 4)))
    for seed in range(3):
        finder = TransitionFinder(body, np.random.default_rng(seed), Effort.of(Budget(), 4))
        found = finder.transition(contacts, 2)
        assert len(found)
        for holding in (contacts, contacts[:2] + contacts[3:]):
            manifold = finder.manifold(holding)
            assert manifold is not None and manifold.slack(found.q).min() >= 0.0


def test_postures_on_the_thesis_wall_are_found_for_every_limb_of_the_start() -> None:
    wall, start, _ = thesis_wall("W1")
    here = Body(robot("quadruped"), wall)
    contacts = [Contact(i, hold) for i, hold in enumerate(start.holds)]
    answers = [find_transition(here, contacts, limb, np.random.default_rng(0)) for limb in range(4)]
    assert any(len(answer) for answer in answers)
    assert all(len(answer) or answer.failure is not None for answer in answers)


def test_random_clear_configurations_stand_where_they_are_put() -> None:
    for model in MODELS:
        q = clear_configurations(model, np.random.default_rng(0), 20)
        assert (kinematics(model).within_limits(q) > 0.1).all()
