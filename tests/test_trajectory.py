"""Curves on a stance's manifold: smooth, feasible, short; their derivatives; and two programs that must agree."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import thesis_wall
from pydrake.multibody.tree import JacobianWrtVariable

from climber.balance import Region
from climber.chart import Chart
from climber.clearance import segment_distance
from climber.curve import Curve, clamped_knots, greville, joint_length, polyline_lengths, rounded, smooth
from climber.manifold import Body, Manifold, Margins
from climber.path import Search, find_path, flips
from climber.programs.conditions import Conditions
from climber.programs.gaps import closest
from climber.programs.kinematic_trajectory import KinematicTrajectoryProgram
from climber.programs.trajectory import ChartProgram, minimise, refine
from climber.robot import Robot
from climber.stance import Contact, Vector
from climber.transition import find_transition, support_of
from climber.wall import Wall, circle

WALL, START, _ = thesis_wall("W2")
CONTACTS = [Contact(limb, hold) for limb, hold in enumerate(START.holds)]
FINE = 0.005  # [rad] four times finer than curves are checked when they are made
NARROW = Margins(balance=0.002)  # of the ways that are looked at here, some pass close to the support's border


def body_on(wall: Wall) -> Body:
    return Body(Robot("package://climber/quadruped/quadruped.urdf", wall.gravity), wall)


BODY = body_on(WALL)


@dataclass(frozen=True)
class Way:
    """A polyline to be refined."""

    manifold: Manifold
    chart: Chart
    u: Vector


def ways(count: int, seed: int) -> list[Way]:
    """Paths on the start stance as RRT-Connect finds them, all limbs holding or one free: `count` of each shape."""
    rng = np.random.default_rng(seed)
    straight: list[Way] = []
    cornered: list[Way] = []
    manifolds = []
    for limb in (1, 3):
        q = find_transition(BODY, CONTACTS, limb, rng, NARROW).q
        for contacts in (CONTACTS, [c for c in CONTACTS if c.limb != limb]):
            support = support_of(BODY, contacts)
            assert support is not None
            manifolds.append((Manifold(BODY, contacts, support, NARROW), q))
    while len(straight) < count or len(cornered) < count:
        manifold, q = manifolds[int(rng.integers(len(manifolds)))]
        a, b = q[rng.choice(len(q), 2, replace=False)]
        if manifold.slack(np.array([a, b])).min() < 0 or len(flips(manifold, a, b)) > 1:
            continue
        if np.allclose(a[:3], b[:3]):
            continue  # a swing of the free limb alone is straight and as short as can be
        path = find_path(manifold, a, b, rng, Search(iterations=60, shortcuts=0))
        for leg in path or []:
            (straight if len(leg.u) == 2 else cornered).append(Way(manifold, leg.chart, leg.u))
    return straight[:count] + cornered[:count]


WAYS = ways(6, 4)
CORNERED = [way for way in WAYS if len(way.u) > 2]
STRAIGHT = [way for way in WAYS if len(way.u) == 2]
every_way = pytest.mark.parametrize("way", WAYS, ids=[f"{i}-{len(way.u)}" for i, way in enumerate(WAYS)])


def test_sample_has_straight_and_cornered_ways_in_plain_and_rooted_charts_with_and_without_a_free_limb() -> None:
    assert CORNERED and STRAIGHT
    assert {way.chart.root is None for way in WAYS} == {True, False}
    assert {len(way.chart.points) for way in WAYS} == {3, 4}


# --- curves ----------------------------------------------------------------------------------------------------------


@every_way
def test_derivatives_of_a_curve_match_finite_differences_and_are_continuous(way: Way) -> None:
    curve = rounded(way.chart, way.u, 14)
    s, h = np.linspace(0.01, 0.99, 57), 1e-5
    scale = np.abs(curve.ddu(s)).max() + 1.0
    assert (curve.u(s + h) - curve.u(s - h)) / (2 * h) == pytest.approx(curve.du(s), abs=1e-6 * scale)
    assert (curve.du(s + h) - curve.du(s - h)) / (2 * h) == pytest.approx(curve.ddu(s), abs=1e-2 * scale)
    knots = np.unique(clamped_knots(14))[1:-1]
    assert curve.ddu(knots - 1e-9) == pytest.approx(curve.ddu(knots + 1e-9), abs=1e-5 * scale)


@pytest.mark.parametrize("num_control", [6, 9, 20])
def test_control_points_at_the_greville_abscissae_give_the_parameter_back(num_control: int) -> None:
    curve = Curve(STRAIGHT[0].chart, greville(num_control)[:, None])
    s = np.linspace(0.0, 1.0, 33)
    assert curve.u(s)[:, 0] == pytest.approx(s, abs=1e-14)


@every_way
def test_rounded_curve_meets_both_ends_and_tends_to_its_polyline(way: Way) -> None:
    def apart(num_control: int) -> float:
        points = rounded(way.chart, way.u, num_control).u(np.linspace(0, 1, 400))
        corner_to_curve = np.linalg.norm(points[:, None] - way.u, axis=2).min(axis=0)
        return float(corner_to_curve.max())

    curve = rounded(way.chart, way.u, 12)
    assert curve.u(np.array([0.0, 1.0])) == pytest.approx(way.u[[0, -1]], abs=1e-14)
    size = float(np.linalg.norm(np.diff(way.u, axis=0), axis=1).sum())
    assert apart(300) < 0.02 * size
    if len(way.u) == 2:
        s = np.linspace(0, 1, 50)[:, None]
        assert curve.u(s[:, 0]) == pytest.approx(way.u[0] + s * (way.u[1] - way.u[0]), abs=1e-12)


@every_way
def test_grid_of_a_curve_is_as_fine_as_asked(way: Way) -> None:
    curve = rounded(way.chart, way.u, 12)
    s = curve.grid(0.03)
    assert s[0] == 0.0 and s[-1] == 1.0 and (np.diff(s) > 0).all()
    assert np.linalg.norm(np.diff(curve.q(s), axis=0), axis=1).max() <= 0.03 + 1e-12


@every_way
def test_smooth_curve_is_feasible_has_the_same_ends_and_is_no_longer(way: Way) -> None:
    curve = smooth(way.manifold, way.chart, way.u)
    assert curve is not None
    assert curve.feasible(way.manifold)
    assert curve.u(np.array([0.0, 1.0])) == pytest.approx(way.u[[0, -1]], abs=1e-14)
    assert curve.length <= polyline_lengths(way.chart, way.u).sum() + 1e-9


def test_joint_length_counts_every_position_alike() -> None:
    assert joint_length(np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 2.0]])) == pytest.approx(7.0)


# --- conditions ------------------------------------------------------------------------------------------------------


def around(way: Way, count: int, spread: float, seed: int = 0) -> Vector:
    """Chart points near a way at which its limbs reach their holds."""
    rng = np.random.default_rng(seed)
    u = way.u[rng.integers(len(way.u), size=8 * count)]
    u = u + spread * rng.normal(size=u.shape) / way.chart.scale
    return u[way.chart.expand(u)[1] > 2e-4][:count]


@every_way
def test_least_of_the_conditions_is_the_slack_of_the_manifold(way: Way) -> None:
    u = around(way, 200, 0.2)
    conditions = Conditions(way.manifold, way.chart)
    least = conditions.least(u)
    q, reach = way.chart.expand(u)
    of_reach = np.array(["folded" in name or "stretched" in name for name in conditions.names])
    assert least[:, of_reach].min(axis=1) == pytest.approx(reach - way.manifold.margins.reach, abs=1e-12)
    assert np.array_equal((least >= 0).all(axis=1), way.manifold.feasible(way.chart, u))
    slack = way.manifold.slack(q)
    good = slack >= 0
    assert good.any()
    assert least[good][:, ~of_reach].min(axis=1) == pytest.approx(slack[good], abs=1e-12)


@pytest.mark.parametrize("obstacle", [False, True])
@pytest.mark.parametrize("which", range(4))
def test_slopes_of_conditions_match_finite_differences(which: int, obstacle: bool) -> None:
    way = WAYS[which]
    if obstacle:
        pelvis = way.chart.expand(way.u[:1])[0][0, :2]
        body = body_on(replace(WALL, obstacles=(circle(pelvis + np.array([0.12, 0.02]), 0.02),)))
        manifold = Manifold(body, way.manifold.contacts, way.manifold.support)
        way = Way(manifold, Chart(body, way.chart.points, way.chart.branches, way.chart.root), way.u)
    conditions, u = Conditions(way.manifold, way.chart), around(way, 12, 0.05)
    near, h, compared = conditions.linearised(u, np.inf), 1e-6, 0
    # Several segments may serve one condition; its slope is that of the nearest.
    order = np.lexsort((near.value, near.kind, near.place))
    place, kind = near.place[order], near.kind[order]
    first = np.append(True, (np.diff(place) != 0) | (np.diff(kind) != 0))
    order, place, kind = order[first], place[first], kind[first]
    assert near.value[order] == pytest.approx(conditions.least(u)[place, kind], abs=1e-12)
    for k in range(u.shape[1]):
        step = np.zeros(u.shape[1])
        step[k] = h
        up, middle, down = (conditions.least(u + sign * step)[place, kind] for sign in (1, 0, -1))
        smooth_here = np.abs(up - 2 * middle + down) < 1e-9  # not where the nearest segment changes
        overlapping = middle < -0.012  # shapes that cross have no distance to speak of
        chosen = smooth_here & ~overlapping
        compared += int(chosen.sum())
        assert near.slope[order[chosen], k] == pytest.approx((up - down)[chosen] / (2 * h), abs=2e-4)
    assert compared > 100


@every_way
def test_derivatives_along_a_chart_keep_the_feet_and_move_the_centre_of_mass_as_drake_says(way: Way) -> None:
    u = around(way, 5, 0.05)
    conditions, plant = Conditions(way.manifold, way.chart), BODY.robot.plant
    near, context, world = conditions.linearised(u, 0.0), BODY.robot.context(), BODY.robot.plant.world_frame()
    rightwards = conditions.names.index("centre of mass right of the support interval's lower end")
    for i, q in enumerate(near.q):
        plant.SetPositions(context, q)
        for limb in way.chart.points:
            foot = plant.GetFrameByName(BODY.robot.limbs[limb].foot)
            J = plant.CalcJacobianTranslationalVelocity(
                context, JacobianWrtVariable.kQDot, foot, np.zeros(3), world, world
            )
            assert J @ near.dq[i] == pytest.approx(0.0, abs=1e-6)
        J = plant.CalcJacobianCenterOfMassTranslationalVelocity(context, JacobianWrtVariable.kQDot, world, world)
        (found,) = np.flatnonzero((near.place == i) & (near.kind == rightwards))
        assert near.slope[found] == pytest.approx(J[0] @ near.dq[i], abs=1e-6)


coordinate = st.floats(-1.0, 1.0)
point = st.tuples(coordinate, coordinate)


@settings(deadline=None)
@given(st.lists(st.tuples(point, point, point, point), min_size=1, max_size=5))
def test_closest_points_are_as_far_apart_as_their_segments(segments: list[tuple[tuple[float, float], ...]]) -> None:
    a0, a1, b0, b1 = np.moveaxis(np.array(segments), 1, 0)
    s, t = closest(a0, a1, b0, b1)
    gap = np.linalg.norm(a0 + s[:, None] * (a1 - a0) - (b0 + t[:, None] * (b1 - b0)), axis=1)
    distance = segment_distance(a0, a1, b0, b1)
    apart = distance > 0
    assert gap[apart] == pytest.approx(distance[apart], abs=1e-9)
    assert ((s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)).all()


# --- the program -----------------------------------------------------------------------------------------------------


@every_way
def test_gradient_of_the_cost_matches_finite_differences(way: Way) -> None:
    program = ChartProgram(way.manifold, way.chart)
    control = rounded(way.chart, way.u, program.num_control).control
    c, rng, h = program.subproblem(control, 0.1, 2e-4).c, np.random.default_rng(0), 1e-6
    for _ in range(5):
        step = np.zeros_like(control)
        step[1:-1] = rng.normal(size=step[1:-1].shape)
        difference = (program.cost(control + h * step) - program.cost(control - h * step)) / (2 * h)
        assert c @ step[1:-1].ravel() == pytest.approx(difference, rel=1e-4, abs=1e-4 * np.abs(c).max())


def test_cost_is_at_least_the_square_of_the_length() -> None:
    # By the inequality of Cauchy and Schwarz, with equality for a straight line in joint space at constant pace.
    for way in WAYS:
        curve = rounded(way.chart, way.u, 12)
        program = ChartProgram(way.manifold, way.chart, smoothing=0.0)
        assert program.cost(curve.control) >= joint_length(curve.q(program.s)) ** 2 * (1 - 1e-12)


@every_way
def test_subproblem_admits_staying_where_it_is_and_its_minimiser_promises_a_gain(way: Way) -> None:
    guess = smooth(way.manifold, way.chart, way.u)
    assert guess is not None
    start = guess if len(way.u) > 2 else rounded(way.chart, way.u, 12)
    problem = ChartProgram(way.manifold, way.chart, len(start.control)).subproblem(start.control, 0.2, 2e-4)
    assert (problem.b >= 0).all()
    assert len(problem.names) == len(problem.b) - 2 * len(problem.c)
    assert np.linalg.eigvalsh(problem.P).min() > -1e-9
    x, prices = minimise(problem)
    assert (problem.A @ x <= problem.b + 1e-6).all() and (prices >= -1e-9).all()
    assert x @ problem.P @ x / 2 + problem.c @ x < 0


@every_way
def test_refined_curve_is_feasible_keeps_its_ends_and_is_never_longer(way: Way) -> None:
    curve = refine(way.manifold, way.chart, way.u)
    assert curve is not None
    # Half the margins are for what happens between the points that were checked.
    halves = Margins(0.0005, 0.01, 0.0005, 0.001)
    assert curve.feasible(way.manifold)
    assert curve.feasible(Manifold(BODY, way.manifold.contacts, way.manifold.support, halves), FINE)
    assert curve.u(np.array([0.0, 1.0])) == pytest.approx(way.u[[0, -1]], abs=1e-14)
    assert curve.length <= polyline_lengths(way.chart, way.u).sum() + 1e-9
    feet = BODY.kinematics.feet(curve.q(curve.grid()))
    for limb, hold in way.chart.points.items():
        assert feet[:, limb] == pytest.approx(np.broadcast_to(hold, feet[:, limb].shape), abs=1e-12)


def test_corners_are_cut_by_a_good_share() -> None:
    before = sum(polyline_lengths(way.chart, way.u).sum() for way in CORNERED)
    after = sum(curve.length for way in CORNERED if (curve := refine(way.manifold, way.chart, way.u)))
    assert after < 0.95 * before


def test_same_leg_is_refined_to_the_same_curve() -> None:
    way = CORNERED[0]
    first, second = (refine(way.manifold, way.chart, way.u) for _ in range(2))
    assert first is not None and second is not None
    assert np.array_equal(first.control, second.control)


def test_conditions_that_are_said_to_bind_have_next_to_no_room_left() -> None:
    named = 0
    for way in WAYS:
        guess = smooth(way.manifold, way.chart, way.u)
        assert guess is not None
        start = guess if len(way.u) > 2 else rounded(way.chart, way.u, 12)
        program = ChartProgram(way.manifold, way.chart, len(start.control))
        solution = program.solve(start)
        assert solution.cost <= solution.before
        least = program.conditions.least(solution.curve.u(program.s))
        for name in solution.binding:
            condition, _, s = name.rpartition(" at s=")
            i = int(np.abs(program.s - float(s)).argmin())
            assert least[i, program.conditions.names.index(condition)] < 0.01
            named += 1
    assert named > 0


def test_way_that_leads_nowhere_is_a_curve_that_stays() -> None:
    way = STRAIGHT[0]
    for corners in (2, 4):
        curve = refine(way.manifold, way.chart, np.repeat(way.u[:1], corners, axis=0))
        assert curve is not None
        assert curve.length < 1e-12
        assert curve.u(np.linspace(0, 1, 5)) == pytest.approx(np.repeat(way.u[:1], 5, axis=0), abs=1e-14)


def narrowed(way: Way, beyond: float) -> Manifold:
    """The manifold with a support interval that ends `beyond` [m] short of the polyline's rightmost centre of mass."""
    part = np.linspace(0, 1, 200)[:, None]
    u = np.concatenate([a + part * (b - a) for a, b in zip(way.u[:-1], way.u[1:], strict=True)])
    x = BODY.kinematics.center_of_mass(way.chart.expand(u)[0])[:, 0]
    margin = Margins().balance
    return Manifold(BODY, way.manifold.contacts, Region.interval(x.min() - 0.1, x.max() - beyond + margin))


def test_polyline_that_leaves_the_support_of_is_refused() -> None:
    for way in WAYS[:4]:
        assert smooth(narrowed(way, 0.004), way.chart, way.u) is None
        assert refine(narrowed(way, 0.004), way.chart, way.u) is None


def test_polyline_that_grazes_its_margins_may_use_up_half_of_them() -> None:
    for way in STRAIGHT:
        manifold = narrowed(way, 0.0004)
        assert smooth(manifold, way.chart, way.u) is None
        curve = refine(manifold, way.chart, way.u)
        assert curve is not None
        x = BODY.kinematics.center_of_mass(curve.q(curve.grid(FINE)))[:, 0]
        assert x.max() <= manifold.support.abscissas[1] - 0.0009


# --- Drake's program -------------------------------------------------------------------------------------------------


def by_drake(way: Way, manifold: Manifold | None = None) -> Curve | tuple[str, ...]:
    guess = rounded(way.chart, way.u, 12)
    ends = guess.q(np.array([0.0, 1.0]))
    return KinematicTrajectoryProgram(manifold or way.manifold, way.chart, (ends[0], ends[1])).solve(guess)


def test_both_programs_find_the_same_curve_where_links_keep_apart() -> None:
    compared = 0
    for way in WAYS:
        theirs, ours = by_drake(way), refine(way.manifold, way.chart, way.u)
        assert isinstance(theirs, Curve) and ours is not None
        conditions = Conditions(way.manifold, way.chart)
        least = conditions.least(theirs.u(theirs.grid()))
        shapes = np.array(["clear of" in name for name in conditions.names])
        # What Drake's program knows of, it meets, but for what happens between its samples.
        assert least[:, ~shapes].min() > -2e-3
        if least[:, shapes].min() > 0 and len(ours.control) == 12:
            assert theirs.length == pytest.approx(ours.length, rel=0.01)
            compared += 1
    assert compared >= 6


def test_both_programs_refuse_ends_that_fall() -> None:
    for way in STRAIGHT[:2]:
        q = way.chart.expand(way.u)[0]
        x = BODY.kinematics.center_of_mass(q)[:, 0]
        manifold = Manifold(BODY, way.manifold.contacts, Region.interval(x.max() + 5.0, x.max() + 5.1))
        answer = by_drake(way, manifold)
        assert not isinstance(answer, Curve) and answer
        assert refine(manifold, way.chart, way.u) is None


def test_every_constraint_of_drakes_program_is_named() -> None:
    way = WAYS[0]
    ends = way.chart.expand(way.u)[0][[0, -1]]
    prog = KinematicTrajectoryProgram(way.manifold, way.chart, (ends[0], ends[1])).prog
    names = [binding.evaluator().get_description() for binding in prog.GetAllConstraints()]
    named = [name for name in names if name]
    assert sum("on its hold" in name for name in named) == 10 * len(way.chart.points)
