"""A robot with three limbs: nothing depends on there being four. Its climb hangs on one elbow."""

from __future__ import annotations

import numpy as np
import pytest

from climber.chart import Chart
from climber.draw import draw_all
from climber.graph import build_stance_graph
from climber.manifold import Body, Manifold
from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.robot import Robot
from climber.scenario import Scenario, load_scenario
from climber.stance import Contact, Stance
from climber.transition import PostureSampler, find_transition, support_of
from climber.verify import verify

THREE_LIMBED = "package://climber/three_limbed/three_limbed.urdf"
TOP, LEFT, RIGHT = range(3)
START = Stance((0, 2, 4))
TAKEN = (Contact(TOP, 1), Contact(LEFT, 2), Contact(RIGHT, 4))  # the top hand has taken hold 1
DONE = (Contact(TOP, 1), Contact(LEFT, 3), Contact(RIGHT, 4))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(THREE_LIMBED)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("three_limbed")


@pytest.fixture(scope="module")
def body(robot: Robot, scenario: Scenario) -> Body:
    return Body(robot, scenario.build_wall())


@pytest.fixture(scope="module")
def plan(scenario: Scenario) -> Plan:
    return plan_climb(scenario)


def bends(body: Body, contacts: tuple[Contact, ...], limb: int) -> set[int]:
    """The bends of the top elbow among the postures in which `limb` may let go or has just taken hold."""
    rng = np.random.default_rng(1)
    rounds = [find_transition(body, contacts, limb, rng, rounds=(20_000,), most=10_000) for _ in range(5)]
    assert sum(len(found) for found in rounds) > 100
    return {int(bend) for found in rounds for bend in found.branches[:, TOP]}


def postures(body: Body, contacts: tuple[Contact, ...], least: float, most: float) -> int:
    """How many postures on some contacts turn up among many whose top elbow is between two angles [rad].

    The top hand stays where it is and its arm's joints are drawn, so that straight arms are as likely as bent ones.
    """
    support = support_of(body, contacts)
    assert support is not None
    manifold, rng, found = Manifold(body, contacts, support), np.random.default_rng(2), 0
    for right in (0, 1):
        chart = Chart(body, manifold.points, (0, 0, right), root=TOP)
        names = [body.robot.position_names[place] for place in chart.independent]
        u = rng.uniform(-np.pi, np.pi, (100_000, len(names)))
        u[:, names.index("top_elbow")] = rng.uniform(least, most, len(u))
        found += int(manifold.feasible(chart, u).sum())
    return found


def test_turned_by_a_third_of_a_turn_it_is_the_same_robot(robot: Robot) -> None:
    assert robot.limb_names == ("top", "left", "right")
    assert robot.symmetries == ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    angles = np.arctan2(*np.array([limb.hip[1::-1] for limb in robot.limbs]).T)
    np.testing.assert_allclose(np.degrees(np.mod(np.roll(angles, -1) - angles, 2 * np.pi)), 120.0)


def test_its_six_links_are_alike_and_every_joint_has_a_motor(robot: Robot) -> None:
    links = [
        robot.plant.GetBodyByName(f"{limb}_{link}") for limb in robot.limb_names for link in ("upper_arm", "forearm")
    ]
    assert {link.default_mass() for link in links} == {0.1}
    assert robot.mass == pytest.approx(1.2)
    assert (robot.effort > 0).all()
    assert len(robot.joint_names) == 6
    assert robot.reach == pytest.approx([0.275] * 3)


def test_its_stance_graph_counts_a_stance_and_its_turns_once(robot: Robot, scenario: Scenario) -> None:
    wall = scenario.build_wall()
    graph = build_stance_graph(wall, robot, START, scenario.cost)
    assert graph.stances.shape[1] == 3
    turns = [graph.vertex(Stance(tuple(np.roll(START.holds, shift)))) for shift in range(3)]
    assert turns == [graph.start] * 3
    kinds = {tuple(sorted(map(tuple, (np.roll(row, s) for s in range(3))))) for row in graph.stances.tolist()}
    assert len(kinds) == graph.num_vertices


def test_the_climb_verifies(plan: Plan) -> None:
    verdict = verify(plan)
    assert verdict.ok, str(verdict)
    assert [tuple(stance.values()) for stance in plan.robots[0].stances] == [(0, 2, 4), (1, 2, 4), (1, 3, 4)]


def test_hold_1_may_be_taken_with_either_bend_but_only_one_lets_the_next_be_reached(body: Body) -> None:
    assert bends(body, TAKEN, TOP) == {0, 1}
    assert bends(body, DONE, LEFT) == {0}


def test_the_elbow_cannot_change_its_bend_once_the_hold_is_taken(body: Body) -> None:
    left_off = tuple(contact for contact in TAKEN if contact.limb != LEFT)
    assert postures(body, left_off, 0.5, 2.5) > 10
    assert postures(body, left_off, -2.5, -0.5) > 10
    assert postures(body, left_off, -0.3, 0.3) == 0
    # All hands on: the third closes another loop, which the sampler of postures is made for.
    assert postures(body, TAKEN, -0.3, 0.3) == 0
    support = support_of(body, TAKEN)
    assert support is not None
    sampler, rng = PostureSampler(body, Manifold(body, TAKEN, support)), np.random.default_rng(3)
    q = np.concatenate([sampler.draw(rng, 30_000)[0] for _ in range(6)])
    angles = q[:, body.robot.limbs[TOP].q[1]]
    assert len(angles) > 100
    assert (angles < 0).any()
    assert (angles > 0).any()
    assert np.abs(angles).min() > 0.3


def test_the_climb_takes_hold_1_with_the_bend_that_is_needed(plan: Plan, body: Body) -> None:
    robot = plan.robots[0]
    assert robot.positions == body.robot.position_names
    standing = [phase for phase in robot.phases if ("top", 1) in {(c.limb, c.hold) for c in phase.contacts}]
    assert [phase.label for phase in standing] == ["shift", "swing left", "shift"]
    assert {body.branches(q)[TOP] for q in np.concatenate([phase.q for phase in standing[:2]])} == {0}


@pytest.mark.filterwarnings("error")
def test_its_pictures_can_be_drawn(plan: Plan, tmp_path: object) -> None:
    for path in draw_all(plan, str(tmp_path)):
        assert path.stat().st_size > 1000
