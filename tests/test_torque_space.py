"""Torques and contact forces with exact cones: a robot in space, and planar robots through the same programs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from climber.dynamics import evaluate, evaluate_at_rest
from climber.programs.forces import wall_forces
from climber.programs.instants import Instants, Margin
from climber.programs.sections import EXACT, Section
from climber.programs.torque import TorqueProgram, phase_torques, solve_instants, static_feasible
from climber.robot import Robot
from climber.stance import Contact, Vector
from climber.wall import Hold, Wall

ALL = (0, 1, 2, 3)
CONTACTS = tuple(Contact(i, i) for i in ALL)
BENT = (0.5, -1.0, 0.6, -0.5, 1.0, 0.6, 0.5, -1.0, 0.6, -0.5, 1.0, 0.6)
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def lemur() -> Robot:
    return Robot("package://climber/lemur/lemur.urdf")


@pytest.fixture(scope="module")
def quadruped() -> Robot:
    return Robot("package://climber/quadruped/quadruped.urdf")


def clinging(robot: Robot, lean: float = 0.1, **kwargs: float) -> tuple[Wall, Vector]:
    """A posture flat before a vertical wall, and holds under its feet whose normals lean out of the wall from up."""
    q = np.zeros((1, 18))
    q[0, 6:] = BENT
    context = robot.context()
    robot.plant.SetPositions(context, q[0])
    normal = (0.0, np.cos(lean), np.sin(lean))
    defaults = {"friction": 0.6, "max_force": 60.0}
    return Wall(tuple(Hold(tuple(p), normal, **(defaults | kwargs)) for p in robot.foot_positions(context))), q


def instants(robot: Robot, wall: Wall, q: Vector, margin: Margin, section: Section = EXACT) -> Instants:
    h, J = evaluate_at_rest(robot, q, ALL)
    return Instants.of_loads(robot, wall_forces(wall, 3, section)[np.arange(4)], h, J, margin)


def test_a_robot_in_space_clings_to_a_wall_with_every_force_in_its_cones(lemur: Robot) -> None:
    wall, q = clinging(lemur)
    result = phase_torques(lemur, wall, CONTACTS, evaluate(lemur, q, 0 * q, ALL), 0 * q)
    assert result.reason == "" and static_feasible(lemur, wall, q, CONTACTS)[0]
    force = result.force[0]
    np.testing.assert_allclose(force.sum(axis=0), -lemur.mass * wall.gravity, atol=1e-8)
    along = force @ wall.normals[0]
    aside = np.linalg.norm(force - np.outer(along, wall.normals[0]), axis=1)
    assert (aside <= 0.6 * along).all()
    assert np.ptp(force[:, 0]) > 0.1 and np.abs(result.torque).max() < 5.0


@pytest.mark.parametrize(
    ("change", "reason"),
    [({"friction": 0.05}, "friction cone"), ({"max_force": 8.0}, "friction cone"), ({}, "torque limit")],
)
def test_what_is_missing_is_named_as_in_the_plane(lemur: Robot, change: dict[str, float], reason: str) -> None:
    wall, q = clinging(lemur, **change)
    instant = instants(lemur, wall, q, Margin())
    if reason == "torque limit":
        instant = replace(instant, limit=0.2 * instant.limit)
    single, batch = TorqueProgram(instant).solve(), solve_instants(instant)[0]
    assert single.reason == batch.reason == reason
    assert single.violation == pytest.approx(batch.violation, abs=1e-5) and batch.violation > 0.01


def test_two_feet_cannot_keep_a_robot_in_space_from_turning_about_the_line_between_them(lemur: Robot) -> None:
    wall, q = clinging(lemur)
    h, J = evaluate_at_rest(lemur, q, (0, 1))
    instant = Instants.of_loads(lemur, wall_forces(wall, 3)[np.arange(2)], h, J, Margin())
    assert TorqueProgram(instant).solve().reason == solve_instants(instant).reason == "force balance"


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_the_batch_is_the_program_of_each_instant(lemur: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    wall, q = clinging(
        lemur, lean=rng.uniform(-0.1, 0.5), friction=rng.uniform(0.2, 1.0), max_force=rng.uniform(15, 60)
    )
    section = [EXACT, Section("inscribed", 6), Section("circumscribed", 4)][rng.integers(3)]
    margin = Margin(rng.choice([0.0, 0.2]), rng.choice([0.05, 0.5]))
    q = q + rng.normal(0.0, 0.1, (3, 18))
    batch_of = instants(lemur, wall, q, margin, section)
    batch = solve_instants(batch_of)
    for k in range(3):
        single = TorqueProgram(batch_of[[k]]).solve()
        if single.violation < 1e-5 and batch[k].violation < 1e-5:
            np.testing.assert_allclose(single.force, batch.force[k], atol=2e-3)
        else:
            assert single.reason == batch[k].reason
            assert single.violation == pytest.approx(batch[k].violation, abs=1e-5)


def test_forces_vary_continuously_while_cones_bind(lemur: Robot) -> None:
    wall, q = clinging(lemur, lean=0.25, friction=0.5)
    way = np.linspace(0.0, 1.0, 41)[:, None]
    q = q + way * np.random.default_rng(0).normal(0.0, 0.04, (1, 18))
    some = instants(lemur, wall, q, Margin())
    result = solve_instants(some)
    assert result.reason == ""
    t = np.linalg.solve(some.forces.generators, result.force[..., None])[..., 0]
    slack = -some.forces.excess(t, some.lower.reshape(4, 3), some.upper.reshape(4, 3))
    assert slack.min() > -1e-6 and (slack < 1e-4).any(axis=1).mean() > 0.5  # cones do bind
    assert np.abs(np.diff(result.force, axis=0)).max() < 0.2


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_a_planar_robot_has_the_same_forces_through_cones(quadruped: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = np.array([[0, 0, 0, -0.6, 1.2, 0.6, -1.2, -0.6, 1.2, 0.6, -1.2]]) + rng.normal(0, 0.1, (3, 11))
    normals = np.array([(np.sin(a), np.cos(a), 0.0) for a in rng.uniform(-0.5, 0.5, 4)])
    wall = Wall(tuple(Hold((0, 0, 0), tuple(n), rng.uniform(0.2, 0.9), min_force=0.5, max_force=9.0) for n in normals))
    h, J = evaluate_at_rest(quadruped, q, ALL)
    plane, space = (
        solve_instants(Instants.of_loads(quadruped, wall_forces(wall, dimension), h, J, Margin()))
        for dimension in (2, 3)
    )
    np.testing.assert_array_equal(plane.codes, space.codes)
    np.testing.assert_allclose(plane.violation, space.violation, atol=1e-6)
    good = plane.ok
    np.testing.assert_allclose(plane.force[good], space.force[good], atol=1e-3)
    np.testing.assert_allclose(space.force[good][..., 2], 0.0, atol=1e-4)
