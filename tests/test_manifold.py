"""Charts keep the contacts, lose nothing, and pass through straight limbs; feasibility is what its parts say."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import MODELS, Standing, clear_configurations, every_star, kinematics, robot, standing

from climber.balance import Region
from climber.chart import Chart
from climber.manifold import Body, Manifold, Margins
from climber.programs.torque import static_feasible
from climber.stance import Contact, Vector
from climber.wall import Hold, Wall, circle

places = st.integers(0, 5)  # which of a few stances


@cache
def case(model: str, place: int) -> Standing:
    """A robot on pins, every second time with a limb in the air."""
    limbs = len(robot(model).limbs)
    return standing(model, place, (place % limbs,) if place % 2 else ())


def cases(model: str) -> list[Standing]:
    return [case(model, place) for place in range(4)]


def plain(manifold: Manifold, q: Vector, root: int | None = None) -> Chart:
    chart = manifold.chart(q, root)
    assert isinstance(chart, Chart)
    return chart


def charts(here: Standing) -> list[Chart]:
    """The charts around the standing configuration: without a root, and rooted at each limb that holds."""
    return [plain(here.manifold, here.q, root) for root in (None, *sorted(here.manifold.points))]


def off_contacts(here: Standing, q: Vector) -> float:
    """How far any foot is from its contact [m]."""
    feet = here.body.kinematics.feet(q)
    return max(np.linalg.norm(feet[:, i] - point, axis=1).max() for i, point in here.manifold.points.items())


@every_star
@pytest.mark.parametrize("place", range(6))
def test_coordinates_of_a_configuration_expand_to_it(model: str, place: int) -> None:
    here = case(model, place)
    for chart in charts(here):
        q, reach = chart.expand(chart.coordinates(here.q[None]))
        assert q[0] == pytest.approx(here.q, abs=1e-9)
        assert reach[0] > 0
        assert chart.coordinates(q) == pytest.approx(chart.coordinates(here.q[None]), abs=1e-12)


@every_star
@settings(max_examples=25, deadline=None)
@given(place=places, seed=st.integers(0, 2**32 - 1))
def test_postures_on_the_contacts_lie_in_their_charts(model: str, place: int, seed: int) -> None:
    here = case(model, place)
    rng = np.random.default_rng(seed)
    base = plain(here.manifold, here.q)
    u = base.coordinates(here.q) + rng.normal(scale=0.3, size=(60, len(base.independent))) / base.scale
    q, reach = base.expand(u)
    for posture in q[reach > 1e-3][:3]:
        for root in (None, *sorted(here.manifold.points)):
            chart = plain(here.manifold, posture, root)
            again, _ = chart.expand(chart.coordinates(posture[None]))
            assert np.exp(1j * again[0]) == pytest.approx(np.exp(1j * posture), abs=1e-9)  # up to whole turns
            origin = here.body.robot.origin_q
            assert again[0, origin] == pytest.approx(posture[origin], abs=1e-12)


@every_star
@settings(max_examples=25, deadline=None)
@given(place=places, seed=st.integers(0, 2**32 - 1))
def test_whole_chart_keeps_the_contacts_as_far_as_limbs_reach(model: str, place: int, seed: int) -> None:
    here = case(model, place)
    rng = np.random.default_rng(seed)
    for chart in charts(here):
        start = chart.coordinates(here.q)
        u = start + rng.normal(scale=rng.choice([0.05, 0.3, 1.0]), size=(100, len(start))) / chart.scale
        q, reach = chart.expand(u)
        kept = reach >= 0
        assert chart.coordinates(q) == pytest.approx(u, abs=1e-12)
        if kept.any():
            assert off_contacts(here, q[kept]) < 1e-12
        if len(chart.solved):
            missed = reach < -1e-6
            assert not missed.any() or off_contacts(here, q[missed]) > 1e-7


@every_star
def test_reach_is_the_least_of_the_limbs_that_follow(model: str) -> None:
    here = case(model, 0)
    chart = plain(here.manifold, here.q)
    u = (
        chart.coordinates(here.q)
        + np.random.default_rng(0).normal(size=(50, len(chart.independent))) * 0.5 / chart.scale
    )
    q, reach = chart.expand(u)
    pelvis = here.body.kinematics.pelvis(q[:, here.body.robot.base_q])
    slack = []
    for i, point in here.manifold.points.items():
        inverse, limb = here.body.inverse[i], here.body.robot.limbs[i]
        assert inverse is not None
        within = inverse.solve(pelvis, q[:, limb.q[: inverse.leading]], point)[1]
        slack.append(within[:, chart.branches[i]])
    assert reach == pytest.approx(np.min(slack, axis=0), abs=1e-12)


@every_star
@pytest.mark.parametrize("place", range(4))
def test_coordinates_are_as_many_as_the_contacts_leave_free(model: str, place: int) -> None:
    here = case(model, place)
    nq, rows = here.body.robot.plant.num_positions(), here.body.robot.dimension * len(here.contacts)
    for chart in charts(here):
        assert len(chart.independent) == nq - rows
        assert sorted([*chart.independent, *chart.dependent]) == list(range(nq))
        J = here.body.kinematics.foot_jacobians(here.q[None], sorted(chart.points))[0].reshape(-1, nq)
        assert np.linalg.matrix_rank(J[:, chart.dependent]) == rows
        assert np.hstack([chart.free, chart.tied]) == pytest.approx(
            np.eye(nq)[:, [*chart.independent, *chart.dependent]], abs=0
        )


def straight_at(here: Standing, limb: int) -> float:
    """The angle of the joint that bends a limb at which it is straight [rad], within 2 mrad."""
    kinematics, robot = here.body.kinematics, here.body.robot
    joints = np.tile(here.q[robot.limbs[limb].q], (4001, 1))
    inverse = here.body.inverse[limb]
    assert inverse is not None
    joint = inverse.bend(0, 0.0)[0]
    joints[:, joint] = np.linspace(-np.pi, np.pi, 4001)
    pelvis, chain = kinematics.pelvis(np.zeros((4001, len(robot.base_q)))), kinematics.chains[limb]
    links = chain.links(pelvis, joints)
    distance = np.linalg.norm(chain.foot_position(pelvis, links) - links[joint - 1].origin, axis=1)
    return float(joints[distance.argmax(), joint])


@every_star
def test_rooted_chart_passes_smoothly_through_a_straight_limb(model: str) -> None:
    smooth = 0
    for here, root in [(one, root) for one in cases(model) for root in one.manifold.points]:
        places, inverse = here.body.robot.limbs[root].q, here.body.inverse[root]
        assert inverse is not None
        chart = plain(here.manifold, here.q, root)
        u = np.tile(chart.coordinates(here.q), (401, 1))
        joint = places[inverse.bend(0, 0.0)[0]]
        u[:, chart.independent == joint] = straight_at(here, root) + np.linspace(-0.02, 0.02, 401)[:, None]
        q, reach = chart.expand(u)
        branch = [inverse.branch(row[places]) for row in q]
        assert {branch[0], branch[-1]} == {0, 1} and np.abs(np.diff(branch)).sum() == 1
        feet = here.body.kinematics.feet(q)
        assert np.abs(feet[:, root] - here.manifold.points[root]).max() < 1e-12
        if reach.min() > 0.005:  # the other limbs follow, and none of them is straight itself
            assert off_contacts(here, q) < 1e-12
            assert np.linalg.norm(np.diff(q, axis=0), axis=1).max() < 0.01
            assert np.linalg.norm(np.diff(q, n=2, axis=0), axis=1).max() < 1e-4
            smooth += 1
    assert smooth > 0


def test_plain_chart_does_not_contain_the_other_side_of_a_straight_limb() -> None:
    here = case("quadruped", 0)
    chart = plain(here.manifold, here.q)
    for i, inverse in enumerate(here.body.inverse):
        assert inverse is not None
        other = Chart(here.body, here.manifold.points, [b ^ (j == i) for j, b in enumerate(chart.branches)])
        q, _ = other.expand(chart.coordinates(here.q[None]))
        assert off_contacts(here, q) < 1e-12
        places = here.body.robot.limbs[i].q
        assert inverse.branch(q[0, places]) != inverse.branch(here.q[places])
        rest = np.setdiff1d(np.arange(len(here.q)), places)
        assert q[0, rest] == pytest.approx(here.q[rest], abs=1e-9)


@every_star
def test_branches_are_those_of_each_limb(model: str) -> None:
    here = case(model, 0)
    expected = [
        inverse.branch(here.q[limb.q])
        for inverse, limb in zip(here.body.inverse, here.body.robot.limbs, strict=True)
        if inverse is not None
    ]
    assert list(here.body.branches(here.q)) == expected
    assert here.body.without_inverse(range(len(expected))) == ()


def test_metre_of_pelvis_weighs_as_much_as_the_turn_of_a_limb_that_moves_it() -> None:
    here = case("quadruped", 0)
    assert plain(here.manifold, here.q).scale == pytest.approx([8.0, 8.0, 1.0])  # 2 / 0.25 m
    assert plain(here.manifold, here.q, 1).scale == pytest.approx([1.0, 1.0, 1.0])


# --- feasibility -----------------------------------------------------------------------------------------------------


def by_parts(manifold: Manifold, q: Vector) -> float:
    """What `Manifold.slack` must be where it is not negative, from Drake's plant and the limits."""
    machine, margins = manifold.body.robot, manifold.margins
    context = machine.context()
    machine.plant.SetPositions(context, q)
    support = manifold.support
    borders = support.b - support.A @ machine.center_of_mass(context)
    assert manifold.balance(q[None])[0] == pytest.approx(borders, abs=1e-12)
    parts = [borders.min() - min(margins.balance, 0.4 * support.depth)]
    for limb in machine.limbs:
        low, high = limb.one_turn
        parts += [(q[limb.q] - low).min() - margins.joint, (high - q[limb.q]).min() - margins.joint]
    poses = manifold.body.kinematics.poses(q[None])
    parts.append(float(manifold.body.clearance(poses)[0]) - margins.clearance)
    return float(min(parts))


@every_star
@settings(max_examples=20, deadline=None)
@given(place=places, seed=st.integers(0, 2**32 - 1))
def test_slack_is_the_least_of_limits_balance_and_clearance(model: str, place: int, seed: int) -> None:
    here = case(model, place)
    chart = plain(here.manifold, here.q)
    rng = np.random.default_rng(seed)
    u = chart.coordinates(here.q) + rng.normal(scale=0.2, size=(30, len(chart.independent))) / chart.scale
    q, reach = chart.expand(u)
    slack = here.manifold.slack(q)
    expected = np.array([by_parts(here.manifold, row) for row in q])
    assert np.array_equal(slack >= 0, expected >= 0)
    assert slack[slack >= 0] == pytest.approx(expected[slack >= 0], abs=1e-12)
    feasible = here.manifold.feasible(chart, u)
    within = (reach >= here.manifold.margins.reach) & (slack >= 0)
    assert np.array_equal(feasible[within], here.manifold.carried(q[within])) and not feasible[~within].any()


def test_each_margin_is_asked_for() -> None:
    here = case("quadruped", 0)
    slack = {}
    for name, margins in {
        "none": Margins(0, 0, 0, 0),
        "joint": Margins(0, 0.5, 0, 0),
        "clearance": Margins(0, 0, 0.5, 0),
        "balance": Margins(0, 0, 0, 10.0),
    }.items():
        slack[name] = Manifold(here.body, here.contacts, here.manifold.support, margins).slack(here.q[None])[0]
    room = here.body.kinematics.within_limits(here.q[None])[0]
    assert slack["none"] > 0
    assert slack["joint"] <= room - 0.5 + 1e-12
    assert slack["clearance"] < 0
    manifold = Manifold(here.body, here.contacts, here.manifold.support, Margins(0, 0, 0, 10.0))
    lower, upper = here.manifold.support.abscissas
    width = upper - lower
    assert manifold.balanced.abscissas == pytest.approx((lower + 0.2 * width, upper - 0.2 * width))
    chart = plain(here.manifold, here.q)
    far = Manifold(here.body, here.contacts, here.manifold.support, Margins(reach=1.0))
    assert not far.feasible(chart, chart.coordinates(here.q[None])).any()


def test_support_interval_of_a_point_keeps_it() -> None:
    here = case("quadruped", 0)
    assert Manifold(here.body, here.contacts, Region.interval(0.3, 0.3)).balanced.abscissas == (0.3, 0.3)


def test_contact_away_from_the_middle_of_its_patch_is_stood_on_there() -> None:
    machine = robot("quadruped")
    (q,) = clear_configurations("quadruped", np.random.default_rng(7), 1)
    feet = kinematics("quadruped").feet(q[None])[0]
    tilt = np.array([0.6, 0.8, 0.0])
    along = np.cross(tilt, [0.0, 0.0, 1.0])
    holds = tuple(Hold(tuple(foot - 0.005 * along), tuple(tilt), 0.6, half_width=0.01) for foot in feet)
    here = Body(machine, Wall(holds))
    manifold = Manifold(here, [Contact(i, i, 0.005) for i in range(4)], Region.interval(-9.0, 9.0))
    chart = plain(manifold, q)
    again, _ = chart.expand(chart.coordinates(q[None]))
    assert again[0] == pytest.approx(q, abs=1e-9)


def test_obstacle_on_the_wall_makes_what_touches_it_infeasible() -> None:
    here = case("quadruped", 0)
    for center, free in ((here.q[:2], False), (here.q[:2] + 5.0, True)):
        blocked = Body(here.body.robot, Wall(here.body.wall.holds, (circle(center, 0.02),)))
        manifold = Manifold(blocked, here.contacts, here.manifold.support)
        assert (manifold.slack(here.q[None])[0] >= 0) == free


def test_every_model_stands_with_all_limbs_and_with_one_in_the_air() -> None:
    for model in MODELS:
        assert {len(case(model, place).contacts) for place in range(2)} == {
            len(robot(model).limbs),
            len(robot(model).limbs) - 1,
        }


def test_weak_motors_must_hold_what_is_feasible_and_strong_ones_are_not_asked() -> None:
    weak = {model: robot(model).weak for model in ("quadruped", "three_limbed", "lemur")}
    assert weak == {"quadruped": False, "three_limbed": False, "lemur": True}
    here = case("lemur", 1)
    q = here.postures(np.random.default_rng(0), 100)
    carried = here.manifold.carried(q)
    assert np.array_equal(carried, static_feasible(here.body.robot, here.body.wall, q, here.contacts))
    strong = case("quadruped", 1)
    assert strong.manifold.carried(strong.postures(np.random.default_rng(0), 100)).all()
