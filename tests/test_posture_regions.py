"""Where the centre of mass may be for motors as well as holds: against holds alone, against cvxpy, against statics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest
from test_torque import variant
from test_torque_space import ALL, CONTACTS, clinging

from climber.dynamics import evaluate_at_rest
from climber.programs.instants import Margin
from climber.programs.posture_regions import posture_regions
from climber.programs.regions import contact_regions
from climber.programs.torque import static_feasible
from climber.robot import Robot
from climber.stance import Contact, Vector
from climber.wall import Hold, Wall

NO_MARGIN = Margin(force=0.0, torque=0.0)
LEMUR = "package://climber/lemur/lemur.urdf"
FRONT = (Contact(0, 0), Contact(1, 1))


@pytest.fixture(scope="module")
def lemur() -> Robot:
    return Robot(LEMUR)


@pytest.fixture(scope="module")
def quadruped() -> Robot:
    return Robot("package://climber/quadruped/quadruped.urdf")


def strong(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> Robot:
    """The robot with motors that know no limit."""
    monkeypatch.setitem(vars(robot), "effort", np.where(robot.effort > 0.0, np.inf, 0.0))
    return robot


def standing(robot: Robot, seed: int = 0) -> tuple[Wall, Vector]:
    """A planar posture, not symmetric, and holds under its feet."""
    q = np.array([[0, 0, 0, -0.6, 1.2, 0.6, -1.2, -0.6, 1.2, 0.6, -1.2]], dtype=float)
    q = q + np.random.default_rng(seed).normal(0.0, 0.15, q.shape)
    context = robot.context()
    robot.plant.SetPositions(context, q[0])
    points = robot.foot_positions(context)
    return Wall(tuple(Hold(tuple(p), (0.0, 1.0, 0.0), 0.5, max_force=12.0) for p in points)), q


def test_motors_without_limits_leave_what_the_holds_support_in_space(
    lemur: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    wall, q = clinging(lemur, max_force=40.0)
    holds = contact_regions(wall, [CONTACTS], lemur.mass, 3, gap=1e-4)
    region = posture_regions(strong(lemur, monkeypatch), wall, q, CONTACTS, NO_MARGIN, gap=1e-4)
    angles = np.linspace(0, 2 * np.pi, 40)
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    reach = [(directions @ r.corners[0].T).max(axis=1) for r in (region, holds)]
    np.testing.assert_allclose(reach[0], reach[1], atol=1.2e-4)
    assert region.gap[0] <= 1e-4


def test_motors_without_limits_leave_what_the_holds_support_in_the_plane(
    quadruped: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    wall, q = standing(quadruped)
    holds = contact_regions(wall, [FRONT], quadruped.mass)
    region = posture_regions(strong(quadruped, monkeypatch), wall, q, FRONT, NO_MARGIN)
    np.testing.assert_allclose(region.corners, holds.corners, atol=1e-5)
    assert 0.0 <= region.gap[0] < 1e-6


@pytest.mark.parametrize("limit", [0.6, 1.0])
def test_limits_of_motors_take_their_part_and_no_more(
    lemur: Robot, limit: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The farthest place is that of a program in which forces, torques and the place are variables."""
    wall, q = clinging(lemur)
    monkeypatch.setitem(vars(lemur), "effort", limit * lemur.effort)
    region = posture_regions(lemur, wall, q, CONTACTS, NO_MARGIN, gap=1e-4)
    context = lemur.context()
    lemur.plant.SetPositions(context, q[0])
    weight = lemur.mass * wall.gravity
    # The posture at rest: tau = h - sum J^T f - turn^T (x cross weight) in every row, none in the base's.
    h, J = evaluate_at_rest(lemur, q, ALL)
    f, x = cp.Variable((4, 3)), cp.Variable(2)
    turn = np.zeros((3, 18))
    for i, step in enumerate(np.eye(18)[:6]):  # how the base turns, from where its far point goes
        lemur.plant.SetPositionsAndVelocities(context, np.concatenate([q[0], step]))
        turn[:, i] = lemur.pelvis.EvalSpatialVelocityInWorld(context).rotational()
    couples = np.cross(region.basis, weight)
    tau = h[0] - sum(J[0, 3 * i : 3 * i + 3].T @ f[i] for i in range(4)) - turn.T @ couples.T @ x
    constraints = [tau[:6] == 0, cp.abs(tau[lemur.joint_v]) <= lemur.effort]
    for i, hold in enumerate(wall.holds):
        n = np.array(hold.normal)
        most = 2 * hold.max_force * np.cos(np.arctan(hold.friction))
        across = cp.norm((np.eye(3) - np.outer(n, n)) @ f[i])
        constraints += [across <= hold.friction * (n @ f[i]), across <= hold.friction * (most - n @ f[i])]
    middle = region.basis @ lemur.center_of_mass(context)
    for angle in np.linspace(0.1, 2 * np.pi, 7):
        direction = np.array([np.cos(angle), np.sin(angle)])
        problem = cp.Problem(cp.Maximize(direction @ x), constraints)
        problem.solve(solver=cp.CLARABEL)
        expected = problem.value + direction @ middle
        assert (region.corners[0] @ direction).max() == pytest.approx(expected, abs=1.5e-4)
    if limit < 1.0:
        holds = contact_regions(wall, [CONTACTS], lemur.mass, 3)
        assert np.ptp(region.corners[0], axis=0).prod() < 0.9 * np.ptp(holds.corners[0], axis=0).prod()


def test_a_posture_can_be_held_if_its_own_centre_of_mass_is_inside(lemur: Robot, quadruped: Robot) -> None:
    rng = np.random.default_rng(2)
    for robot, (wall, q), contacts, spread in (
        (lemur, clinging(lemur, lean=0.3, friction=0.45), CONTACTS, 0.1),
        (quadruped, standing(quadruped, 3), FRONT, 0.4),
    ):
        some = q + rng.normal(0.0, spread, (40, q.shape[1]))
        region = posture_regions(robot, wall, some, contacts, gap=1e-3, margin=Margin())
        context, inside = robot.context(), []
        for k, posture in enumerate(some):
            robot.plant.SetPositions(context, posture)
            inside.append(region.margin(robot.center_of_mass(context))[k])
        clear = np.abs(inside) > 1e-3
        good = static_feasible(robot, wall, some, contacts, Margin())
        np.testing.assert_array_equal(np.array(inside)[clear] > 0.0, good[clear])
        assert 3 < good.sum() < 37


def test_weak_motors_hold_nothing(quadruped: Robot, tmp_path: Path) -> None:
    wall, q = standing(quadruped)
    weak = variant(quadruped, tmp_path, ('effort="4.0"', 'effort="0.05"'))
    region = posture_regions(weak, wall, q, FRONT)
    assert region.empty[0] and region.shortfall[0] > 0.01 and region.margin(np.zeros(3))[0] == -np.inf


def test_one_foot_in_space_holds_at_most_what_is_over_it(lemur: Robot) -> None:
    wall, q = clinging(lemur, lean=0.0)
    region = posture_regions(lemur, wall, q, CONTACTS[:1])
    if not region.empty[0]:
        np.testing.assert_allclose(region.corners[0], np.broadcast_to(wall.positions[0, [0, 2]], (4, 2)), atol=1e-5)


def test_on_a_floor_a_planar_robot_is_held_wherever_its_centre_of_mass_is(quadruped: Robot) -> None:
    wall, q = standing(quadruped)
    pinned = Wall(tuple(replace(h, grip="pin") for h in wall.holds), inclination_deg=0.0)
    lying = Robot(quadruped.model, pinned.gravity)
    region = posture_regions(lying, pinned, q, CONTACTS)
    assert not region.empty[0] and region.margin(np.array([9.0, 0.0, 0.0]))[0] == np.inf
