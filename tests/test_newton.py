"""Closed chains by Newton's method: projections, charts, paths, and the robot of two links that needs them."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import pytest
from plans import edited

from climber.apart import Cells, why_apart
from climber.atlas import atlas_path
from climber.balance import Region
from climber.chart import Chart
from climber.curve import rounded
from climber.exceptions import NoPlanFound
from climber.graph import build_stance_graph
from climber.manifold import Body, Manifold, Margins
from climber.motion import DeadEnd, EmptyPiece, MotionPlanner
from climber.newton import Closure, NewtonChart
from climber.newton_sampler import NewtonSampler
from climber.path import Search, find_path, unwound
from climber.phase_motion import MotionBudget
from climber.phases import Way
from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.regrasp import rigid, with_regrasps
from climber.robot import Model, Robot
from climber.scenario import Scenario, load_scenario
from climber.stance import Contact, Move, Stance, Vector
from climber.start import start_postures
from climber.timing import rates
from climber.transition import PostureSampler
from climber.transitions import MoveFailure, TransitionFinder
from climber.verify import verify
from climber.wall import Hold, Wall
from climber.words import moves_told

HOLDS = ((-0.15, -0.15), (0.15, -0.15), (0.15, 0.15), (-0.15, 0.15))
ANYWHERE = Region.interval(-np.inf, np.inf)


@cache
def quadruped() -> Manifold:
    """The quadruped with all feet on a square of pins, no closed form left out."""
    robot = Robot("package://climber/quadruped/quadruped.urdf")
    wall = Wall(tuple(Hold((x, y, 0.0), (0.0, 1.0, 0.0), 0.6, grip="pin") for x, y in HOLDS))
    order = np.argsort([np.arctan2(*limb.hip[1::-1]) for limb in robot.limbs])
    contacts = [Contact(int(limb), hold) for hold, limb in enumerate(order)]
    return Manifold(Body(robot, wall), sorted(contacts, key=lambda c: c.limb), ANYWHERE)


@cache
def standing() -> Vector:
    """Feasible postures of it, from the sampler that uses inverse kinematics."""
    manifold = quadruped()
    q = PostureSampler(manifold.body, manifold).draw(np.random.default_rng(0), 3000)[0]
    assert len(q) > 20
    return q


@cache
def scenario() -> Scenario:
    return load_scenario("scenarios/double_link.yaml")


@cache
def double_link() -> Body:
    wall = scenario().build_wall()
    return Body(Robot(Model.load(scenario().robots[0].model, scenario().folder), wall.gravity), wall)


def hanging(limb: int, hold: int) -> Manifold:
    """The double link on one hand."""
    return Manifold(double_link(), [Contact(limb, hold)], ANYWHERE)


def moves_of(*moves: tuple[int, int]) -> list[Move]:
    """Moves from the scenario's start, as (limb, hold)."""
    stance, result = Stance((1, 0)), []
    for limb, hold in moves:
        result.append(Move(stance, limb, hold))
        stance = result[-1].end
    return result


TO_2, AGAIN, TO_3 = (1, 2), (0, 1), (1, 3)


def planned(*moves: tuple[int, int], seed: int = 0) -> Way | MoveFailure | DeadEnd | EmptyPiece:
    """What the motion planner makes of a sequence of moves."""
    finder = TransitionFinder(double_link(), np.random.default_rng(seed))
    start = start_postures(scenario(), 0, finder, Stance((1, 0)))
    assert not finder.survey(start.contacts, moves_of(*moves))
    planner = MotionPlanner(finder, MotionBudget(iterations=400))
    return planner.plan(start, moves_of(*moves), {len(moves): [None]})


# --- projection ------------------------------------------------------------------------------------------------------


def test_projected_configurations_keep_the_contacts() -> None:
    manifold = quadruped()
    rng = np.random.default_rng(1)
    q = standing()[:20].repeat(20, axis=0)
    q, closed = Closure(manifold.body.kinematics, manifold.points).project(q + rng.normal(0.0, 0.2, q.shape))
    assert closed.mean() > 0.9
    feet = manifold.body.kinematics.feet(q[closed])
    points = np.array([manifold.points[i] for i in range(4)])
    assert np.abs(feet - points).max() < 1e-10


def test_projection_moves_no_farther_than_to_a_known_configuration_nearby() -> None:
    manifold = quadruped()
    rng = np.random.default_rng(2)
    near = standing()[:50] + rng.normal(0.0, 1e-3, standing()[:50].shape)
    closure = Closure(manifold.body.kinematics, manifold.points)
    q, closed = closure.project(near)
    assert closed.all()
    moved, known = (np.linalg.norm((other - near) * closure.scale, axis=1) for other in (q, standing()[:50]))
    assert (moved <= known + 1e-4).all()  # the nearest point, to second order


def test_jacobian_of_the_gap_is_its_derivative() -> None:
    manifold = quadruped()
    closure = Closure(manifold.body.kinematics, manifold.points)
    q = np.random.default_rng(3).uniform(-2.0, 2.0, (5, len(closure.scale)))
    J = closure.jacobian(q)
    for i, weight in enumerate(closure.scale):
        step = 1e-6 * np.eye(q.shape[1])[i] / weight
        assert (closure.gap(q + step) - closure.gap(q - step)) / 2e-6 == pytest.approx(J[:, :, i], abs=1e-8)


def test_every_projected_posture_of_the_quadruped_is_one_that_inverse_kinematics_finds() -> None:
    manifold = quadruped()
    q = NewtonSampler(manifold.body, manifold).draw(np.random.default_rng(4), 2000)[0]
    assert len(q) > 5
    for posture in q:
        chart = manifold.chart(posture)
        assert isinstance(chart, Chart)
        again, reach = chart.expand(chart.coordinates(posture)[None])
        assert reach[0] > 0.0 and np.abs(again[0] - posture).max() < 1e-7


# --- charts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", range(5))
def test_chart_keeps_the_contacts_and_gives_its_coordinates_back(row: int) -> None:
    manifold = quadruped()
    chart = manifold.newton_chart(standing()[row])
    assert chart.dimension == 3
    u = np.random.default_rng(row).uniform(-0.4, 0.4, (200, 3))
    q, slack = chart.expand(u)
    good = slack >= 0.0
    assert good.mean() > 0.5
    assert np.abs(chart.closure.gap(q[good])).max() < 1e-10
    assert np.abs(chart.coordinates(q[good]) - u[good]).max() < 1e-10


def test_chart_and_closed_form_describe_the_same_configurations() -> None:
    manifold = quadruped()
    base = standing()[0]
    local, closed = manifold.newton_chart(base), manifold.chart(base)
    u = np.random.default_rng(5).uniform(-0.3, 0.3, (300, 3))
    q, slack = local.expand(u)
    branches = manifold.body.branches(base)
    same = np.array([slack[k] >= 0.0 and manifold.body.branches(q[k]) == branches for k in range(len(q))])
    assert same.sum() > 50
    again, reach = closed.expand(closed.coordinates(q[same]))
    assert (reach > -1e-9).all()
    assert np.abs(again - q[same]).max() < 1e-6


def test_chart_goes_through_a_straight_limb_where_the_closed_form_ends() -> None:
    manifold = quadruped()
    rng = np.random.default_rng(6)
    crossed = 0
    for base in standing()[:20]:
        chart = manifold.newton_chart(base)
        ray = np.linspace(0.0, 1.2, 60)[:, None] * rng.normal(size=3)
        q, slack = chart.expand(ray)
        q = q[slack >= 0.0]
        branches = {manifold.body.branches(row) for row in q}
        crossed += len(branches) > 1
        assert np.linalg.norm(np.diff(q, axis=0), axis=1).max(initial=0.0) < 1.0  # and does not jump
    assert crossed > 0


def test_beyond_its_border_a_chart_says_so() -> None:
    chart = quadruped().newton_chart(standing()[0])
    _, slack = chart.expand(np.array([[9.0, 0.0, 0.0]]))
    assert slack[0] < 0.0


@pytest.mark.parametrize("kind", ["newton", "closed", "hanging"])
def test_rates_are_derivatives_of_the_chart(kind: str) -> None:
    rng = np.random.default_rng(7)
    if kind == "hanging":
        manifold = hanging(1, 2)
        q0 = NewtonSampler(manifold.body, manifold).draw(rng, 50)[0][0]
        chart: Chart | NewtonChart = manifold.chart(q0)
    else:
        manifold, q0 = quadruped(), standing()[1]
        chart = manifold.newton_chart(q0) if kind == "newton" else manifold.chart(q0)
    u0 = chart.coordinates(q0)
    velocity, acceleration = rng.normal(0.0, 0.3, (2, len(u0)))

    def at(t: float) -> Vector:
        return chart.expand((u0 + velocity * t + acceleration * t**2 / 2)[None])[0][0]

    h = 1e-3
    v, vd = rates(chart, at(0.0)[None], velocity[None], acceleration[None])
    assert vd is not None
    assert v[0] == pytest.approx((at(h) - at(-h)) / (2 * h), abs=1e-4)
    assert vd[0] == pytest.approx((at(h) - 2 * at(0.0) + at(-h)) / h**2, abs=1e-3)


def test_an_isolated_posture_has_a_chart_that_stays_there() -> None:
    manifold = Manifold(double_link(), [Contact(0, 1), Contact(1, 0)], ANYWHERE)
    q = NewtonSampler(manifold.body, manifold).draw(np.random.default_rng(8), 300)[0]
    assert manifold.rigid and len(q) == 2
    chart = manifold.chart(q[0])
    assert isinstance(chart, NewtonChart) and chart.dimension == 0
    u = np.array([chart.coordinates(q[0]), [0.7]])
    assert (chart.expand(u)[0] == q[0]).all()
    v, vd = rates(chart, q[:1], np.ones((1, 1)), np.ones((1, 1)))
    assert vd is not None and not v.any() and np.abs(vd).max() < 1e-9


# --- paths -----------------------------------------------------------------------------------------------------------


def fine(manifold: Manifold, legs: list, a: Vector, b: Vector) -> None:  # type: ignore[type-arg]
    """Asserts that legs lead from a to b (up to whole turns) and are feasible at a thousand points each."""
    q = a
    for leg in legs:
        u = rounded(leg.chart, leg.u[:2], 6).u(np.linspace(0.0, 1.0, 1000)) if len(leg.u) == 2 else leg.u
        if len(leg.u) > 2:
            part = np.linspace(0.0, 1.0, 300)[:, None]
            u = np.concatenate([p + part * (r - p) for p, r in itertools.pairwise(leg.u)])
        at, reach = leg.chart.expand(u)
        assert np.abs(at[0] - q).max() < 1e-6
        q = at[-1]
        assert (reach >= 0.0).all() and manifold.slack(at).min() > -0.5 * manifold.margins.clearance
        feet = manifold.body.kinematics.feet(at)
        assert max(np.abs(feet[:, i] - point).max() for i, point in manifold.points.items()) < 1e-9
    off = q - b
    off[2] -= 2 * np.pi * np.round(off[2] / (2 * np.pi))
    assert np.abs(off).max() < 1e-6


def test_paths_over_an_atlas_are_feasible_looked_at_closely() -> None:
    manifold = quadruped()
    rng = np.random.default_rng(9)
    found = 0
    for a, b in zip(standing()[:3], standing()[6:9], strict=True):
        legs = atlas_path(manifold, a, unwound(b, a, 2), rng, Search(iterations=40, shortcuts=10))
        if legs is not None:
            found += 1
            fine(manifold, legs, a, b)
    assert found > 0


def test_paths_of_a_hanging_robot_are_feasible_looked_at_closely() -> None:
    rng = np.random.default_rng(10)
    found = 0
    for limb, hold in ((0, 1), (1, 1), (1, 2)):
        manifold = hanging(limb, hold)
        q = NewtonSampler(manifold.body, manifold).draw(rng, 40)[0]
        for a, b in zip(q[:8], q[8:16], strict=True):
            legs = find_path(manifold, a, b, rng, Search(iterations=60))
            if legs is not None:
                found += 1
                fine(manifold, legs, a, b)
    assert found > 6


def test_a_hanging_robot_may_turn_all_the_way_round() -> None:
    manifold = Manifold(Body(double_link().robot, Wall(scenario().build_wall().holds)), [Contact(0, 1)], ANYWHERE)
    q = NewtonSampler(manifold.body, manifold).draw(np.random.default_rng(11), 5)[0][0]
    chart = manifold.chart(q)
    assert len(chart.turns(chart.coordinates(q))) == 3
    for u in chart.turns(chart.coordinates(q)):
        off = (chart.expand(u[None])[0][0] - q) / (2 * np.pi)
        assert off == pytest.approx(off.round(), abs=1e-9)


# --- proofs that there is no path ------------------------------------------------------------------------------------


def test_blocked_cells_hold_no_feasible_configuration_and_free_ones_none_that_touches_an_obstacle() -> None:
    manifold = hanging(0, 1)
    cells, chart = Cells(manifold), manifold.chart(np.zeros(4))
    rng = np.random.default_rng(13)
    shape = (256, 228)
    column, row = rng.integers(0, 256, 3000), rng.integers(0, 228, 3000)
    blocked, free = cells._look(column, row, shape)
    assert blocked.sum() > 100 and free.sum() > 100 and not (blocked & free).any()
    lower, upper = double_link().robot.limbs[1].one_turn
    for _ in range(5):
        u = np.empty((3000, 2))
        u[:, 0] = (column + rng.random(3000)) / shape[0] * 2 * np.pi
        u[:, 1] = lower[0] + (row + rng.random(3000)) / shape[1] * (upper - lower)[0]
        clearance = double_link().clearance(double_link().kinematics.poses(chart.expand(u)[0]))
        assert (clearance[blocked] <= 0.0).all() and (clearance[free] > 0.0).all()


@pytest.mark.parametrize(("limb", "hold", "pieces"), [(1, 0, 1), (0, 1, 4), (1, 2, 1), (1, 3, 1)])
def test_what_hangs_from_a_hold_falls_into_as_many_pieces_as_in_bretls_figure(
    limb: int, hold: int, pieces: int
) -> None:
    cells = Cells.of(hanging(limb, hold))
    assert len(set(np.unique(cells._pieces).tolist()) - {0}) == pieces
    assert Cells.of(hanging(limb, hold)) is cells


def test_postures_joined_by_a_path_are_in_one_piece() -> None:
    manifold, rng = hanging(0, 1), np.random.default_rng(14)
    cells = Cells.of(manifold)
    q = NewtonSampler(manifold.body, manifold).draw(rng, 200)[0]
    assert all(cells.component(row) for row in q)
    joined = apart = 0
    for a, b in itertools.pairwise(q[:40]):
        path = find_path(manifold, a, b, rng, Search(iterations=20))
        assert path is None or cells.component(a) == cells.component(b)
        joined, apart = joined + (path is not None), apart + (why_apart(manifold, a, b) is not None)
    assert joined > 5 and apart > 5


def test_isolated_postures_are_proved_apart_and_one_is_not_apart_from_itself() -> None:
    manifold = Manifold(double_link(), [Contact(0, 1), Contact(1, 0)], ANYWHERE)
    one, two = NewtonSampler(manifold.body, manifold).draw(np.random.default_rng(15), 300)[0]
    turned = one + np.array([0.0, 0.0, 2 * np.pi, 0.0])
    assert why_apart(manifold, one, two) is not None and why_apart(manifold, one, turned) is None


def test_nothing_is_proved_of_robots_with_more_freedom() -> None:
    assert why_apart(quadruped(), standing()[0], standing()[1]) is None


# --- the double link -------------------------------------------------------------------------------------------------


def test_double_link_has_a_limb_without_joints_and_one_with_a_single_joint() -> None:
    robot = double_link().robot
    assert [len(limb.q) for limb in robot.limbs] == [0, 1]
    assert double_link().inverse == (None, None) and rigid(double_link()) and not rigid(quadruped().body)


def test_kinematics_of_limbs_without_joints_agree_with_the_plant() -> None:
    body = double_link()
    rng = np.random.default_rng(12)
    context = body.robot.context()
    for q in rng.uniform(-1.0, 1.0, (10, 4)):
        body.robot.plant.SetPositions(context, q)
        assert body.kinematics.feet(q[None])[0] == pytest.approx(body.robot.foot_positions(context), abs=1e-12)
        center = body.kinematics.center_of_mass(q[None])[0]
        assert center == pytest.approx(body.robot.center_of_mass(context), abs=1e-12)


def test_stance_graph_contains_the_short_climb() -> None:
    wall = scenario().build_wall()
    graph = build_stance_graph(wall, double_link().robot, Stance((1, 0)), scenario().cost)
    start, middle, goal = (graph.vertex(Stance((1, hold))) for hold in (0, 2, 3))
    assert graph.num_vertices == 3
    assert graph.edge(start, goal) >= 0  # Bretl's 1-2-4
    assert graph.edge(start, middle) >= 0 and graph.edge(middle, goal) >= 0
    more = with_regrasps(graph, double_link(), scenario().cost)
    assert more.num_edges == graph.num_edges + 6
    loops = more.tail == more.head
    assert loops.sum() == 6 and set(more.limb[loops].tolist()) == {0, 1}
    assert (more.reach_cost[loops] == 0.0).all()


@pytest.mark.parametrize("moves", [(TO_3,), (TO_2, TO_3)], ids=["1-2-4", "1-2-3 without coming back"])
def test_short_climbs_have_no_motion(moves: tuple[tuple[int, int], ...]) -> None:
    outcome = planned(*moves)
    assert isinstance(outcome, DeadEnd)
    assert outcome.failure.index == len(moves) - 1 and outcome.failure.stage == "motion"


def test_the_climb_that_comes_back_has_all_its_motions() -> None:
    way = planned(TO_2, AGAIN, TO_3)
    assert isinstance(way, Way)
    outcome = way.chained()
    hanging_from = [phase.contacts[0].hold for phase in outcome if phase.limb is not None]
    assert hanging_from == [1, 2, 1]  # hold 1, Bretl's 2, is visited twice
    joint = [phase.samples.q[0, 3] for phase in outcome if phase.limb is None]
    assert joint[1] * joint[2] < 0.0  # at the stance taken twice the joint is bent one way, then the other
    for before, after in itertools.pairwise(outcome):
        assert np.abs(before.samples.q[-1] - after.samples.q[0]).max() < 1e-9


def test_margins_of_an_unbounded_support_are_none() -> None:
    assert Manifold(double_link(), [Contact(0, 1)], ANYWHERE, Margins(balance=0.1)).balanced.b.tolist() == [np.inf] * 2


@pytest.mark.parametrize("seed", [0, 1])
def test_refining_finds_the_climb_and_it_verifies(seed: int) -> None:
    plan = plan_climb(load_scenario("double_link"), seed=seed)
    assert [stance["second_hand"] for stance in plan.robots[0].stances] == [0, 2, 2, 3]
    swings = [phase for phase in plan.robots[0].phases if phase.kind == "swing"]
    assert [phase.contacts[0].hold for phase in swings] == [1, 2, 1]
    told = moves_told(plan.robots[0].stances, [phase.limb or "" for phase in swings])
    assert told[1:] == ["first hand lets go of hold 1 and takes it again", "second hand from hold 2 to hold 3"]
    assert any("obstacles cut" in cut.reason for cut in plan.robots[0].cuts)
    verdict = verify(plan)
    assert verdict.ok, str(verdict)
    # A limb of one joint or none does not follow a hold that is out of place.
    claiming = edited(plan, "robots/0/phases/2/margins/place/value", 1e-3)
    assert "margins" in {check.name for check in verify(Plan.from_json(claiming)).failures}


@pytest.mark.parametrize("on_failure", ["cut", "penalise"])
def test_giving_up_whole_moves_does_not_find_it_and_claims_no_proof(on_failure: str) -> None:
    asked = load_scenario("double_link")
    asked.on_failure = on_failure
    with pytest.raises(NoPlanFound) as raised:
        plan_climb(asked)
    assert not raised.value.proved and raised.value.cuts
