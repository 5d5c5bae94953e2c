"""verify's own equilibrium model against cases solved by hand, and against the planner's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import EQUILIBRIUM_PROBLEMS, MASS_OF_20_N, EquilibriumProblem, hold, random_wall
from test_forces import holds_in_space
from test_regions import climbable

from climber.programs.equilibrium import SupportProgram
from climber.programs.forces import wall_forces
from climber.programs.regions import hold_set_regions, hold_set_supports
from climber.stance import Contact
from climber.verify_equilibrium import support_interval, support_of
from climber.verify_grips import Grip
from climber.verify_polygon import Polygon
from climber.wall import Hold, Wall


@pytest.mark.parametrize("problem", EQUILIBRIUM_PROBLEMS, ids=lambda problem: problem.name)
def test_the_interval_is_the_one_worked_out_by_hand(problem: EquilibriumProblem) -> None:
    holds = [contact.hold for contact in problem.contacts]
    support = support_interval(problem.wall, holds, problem.wall.points(problem.contacts), MASS_OF_20_N)
    if problem.interval is None:
        assert not support.exists
        assert "infeasible" in support.status
    else:
        np.testing.assert_allclose((support.lower, support.upper), problem.interval, atol=1e-7)


def test_no_contacts_support_nothing() -> None:
    support = support_interval(Wall((hold(0.0, 0.0),)), [], np.zeros((0, 3)), 2.0)
    assert not support.exists and support.status == "no contacts"


def test_an_inclined_wall_pulls_less_along_itself() -> None:
    """At 30 degrees only half the weight is along the wall, and holds of half the strength do."""
    holds = (hold(0.0, 0.0, max_force=6.0), hold(1.0, 0.0, max_force=6.0))
    weak = tuple(hold(h.position[0], 0.0, max_force=3.0) for h in holds)
    steep = support_interval(Wall(holds), [0, 1], Wall(holds).positions, MASS_OF_20_N)
    gentle = support_interval(Wall(weak, inclination_deg=30.0), [0, 1], Wall(weak).positions, MASS_OF_20_N)
    assert steep.upper == pytest.approx(gentle.upper, abs=1e-8)
    assert steep.exists and 0.5 < steep.upper < 1.0


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 5))
def test_it_agrees_with_the_planners_program_on_random_contacts(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    wall = random_wall(rng, count)
    contacts = [Contact(i, i, float(rng.uniform(-0.01, 0.01))) for i in range(count)]
    theirs = SupportProgram.of_contacts(wall, contacts, 2.0).solve()
    ours = support_interval(wall, list(range(count)), wall.points(contacts), 2.0)
    if theirs.empty or not ours.exists:
        # Contacts that only just carry the robot, or just do not, may be told either way.
        assert theirs.empty or theirs.width < 1e-4
        assert not ours.exists or ours.upper - ours.lower < 1e-4
    else:
        np.testing.assert_allclose((ours.lower, ours.upper), (theirs.lower, theirs.upper), atol=1e-6)


def test_excess_is_measured_along_the_cone_edges() -> None:
    grip = Grip.of(hold(0.0, 0.0, friction=1.0, min_force=1.0, max_force=10.0))
    edges = np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2.0)
    multiples = np.array([[5.0, 5.0], [10.0, 1.0], [10.5, 5.0], [5.0, 0.2], [5.0, -3.0], [12.0, -1.0]])
    forces = np.hstack([multiples @ edges, np.zeros((6, 1))])
    np.testing.assert_allclose(grip.excess(forces), [-4.0, 0.0, 0.5, 0.8, 4.0, 2.0], atol=1e-12)


def test_a_hold_does_not_push_across_the_wall_plane() -> None:
    grip = Grip.of(hold(0.0, 0.0))
    np.testing.assert_allclose(grip.excess(np.array([[0.0, 10.0, 0.25], [0.0, 10.0, -0.25]])), [0.25, 0.25])


def test_without_friction_any_force_along_the_patch_is_in_excess() -> None:
    grip = Grip.of(hold(0.0, 0.0, friction=0.0, min_force=1.0, max_force=6.0))
    forces = np.array([[0.0, 8.0, 0.0], [0.5, 8.0, 0.0], [0.0, 13.0, 0.0], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(grip.excess(forces), [-2.0, 0.5, 0.5, 0.5], atol=1e-12)


def test_a_pin_pulls_and_a_magnet_pulls_as_far_as_it_is_pressed_on() -> None:
    pin = Grip.of(hold(0.0, 0.0, grip="pin", max_force=8.0))
    np.testing.assert_allclose(pin.excess(np.array([[-7.0, -8.0, 0.0], [9.0, 0.0, 0.0]])), [0.0, 1.0])
    magnet = Grip.of(hold(0.0, 0.0, grip="magnet", adhesion=5.0, friction=1.0, max_force=40.0))
    pulls = np.array([[0.0, -4.0, 0.0], [0.0, -5.0, 0.0], [0.0, -6.0, 0.0]])
    np.testing.assert_allclose(magnet.excess(pulls), [-np.sqrt(0.5), 0.0, np.sqrt(0.5)], atol=1e-12)


# --- In space --------------------------------------------------------------------------------------------------------


def polygon(wall: Wall, mass: float = 2.0) -> Polygon:
    found = support_of(wall, range(len(wall.holds)), wall.positions, mass, planar=False)
    assert isinstance(found, Polygon)
    return found


@pytest.mark.parametrize("problem", EQUILIBRIUM_PROBLEMS, ids=lambda problem: problem.name)
def test_holds_in_a_plane_support_a_robot_in_space_as_far_along_it(problem: EquilibriumProblem) -> None:
    wall, holds = problem.wall, [contact.hold for contact in problem.contacts]
    support = support_of(wall, holds, wall.points(problem.contacts), MASS_OF_20_N, planar=False)
    assert support.exists == (problem.interval is not None)
    if problem.interval is not None:
        ends = np.array([[x + dx, 0.0, 0.0] for x in problem.interval for dx in (-1e-4, 0.0, 1e-4)])
        inside = [-1e-4, 0.0, 1e-4, 1e-4, 0.0, -1e-4]
        if problem.interval[1] - problem.interval[0] < 1e-3:
            inside = [-1e-4, 0.0, -1e-4] * 2
        margin = support.margin(ends)
        # How far inside counts across the plane too, where the polygon may have no width.
        np.testing.assert_allclose(np.minimum(margin, 0.0), np.minimum(inside, 0.0), atol=1e-6)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.sampled_from([2, 4]))
def test_polygons_agree_with_the_planners(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    wall = holds_in_space(rng, count) if seed % 2 else climbable(rng, count)
    ours, theirs = polygon(wall), hold_set_regions(wall, np.arange(count)[None], 2.0, 3, gap=1e-3)
    if theirs.empty[0] or not ours.exists:
        lighter, heavier = (hold_set_regions(wall, np.arange(count)[None], m, 3).empty[0] for m in (1.999, 2.001))
        assert (theirs.empty[0] and not ours.exists) or lighter != heavier or theirs.gap[0] < 1e-3
        return
    corners = theirs.corners[0] @ theirs.basis  # they can be held, and so can what is between them
    assert (ours.margin(corners) >= -1e-6).all()
    middle = corners.mean(axis=0)
    directions = rng.normal(size=(4, 3))
    _, outer = hold_set_supports(wall, np.arange(count)[None], 2.0, directions, 3, gap=1e-7)
    across = directions - np.outer(directions @ wall.gravity, wall.gravity) / (wall.gravity @ wall.gravity)
    steps = (outer[0] - directions @ middle) / (across**2).sum(axis=1)
    assert (ours.margin(middle + 1.01 * (steps + 1e-4)[:, None] * across) < 0.0).all()


def test_a_place_just_inside_the_polygon_is_not_refused() -> None:
    wall = climbable(np.random.default_rng(5), 4)
    theirs = hold_set_regions(wall, np.arange(4)[None], 2.0, 3, gap=1e-5)
    corners = theirs.corners[0, ::12] @ theirs.basis
    inward = corners.mean(axis=0) - corners
    places = corners + 1e-6 * inward / np.linalg.norm(inward, axis=1, keepdims=True)
    margin = polygon(wall).margin(places)
    assert (margin > -1e-7).all()
    assert (polygon(wall).margin(corners - 3e-5 * inward / np.linalg.norm(inward, axis=1, keepdims=True)) < 1e-6).all()


def test_without_contacts_or_strength_there_is_no_polygon() -> None:
    weak = Wall((hold(0.0, 0.0, max_force=1.0),))
    assert not polygon(weak).exists and "infeasible" in polygon(weak).describe()
    assert np.isnan(polygon(weak).margin(np.zeros((2, 3)))).all()
    none = support_of(weak, [], np.zeros((0, 3)), 2.0, planar=False)
    assert not none.exists and none.describe() == "empty (no contacts)"


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_grips_in_space_measure_what_the_planners_limits_lack(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wall = holds_in_space(rng, 3)
    forces = wall_forces(wall, 3)
    t = rng.uniform(-1.5, 1.5, (50, 3, 3)) * forces.upper
    force = forces.offset + np.einsum("kap,nkp->nka", forces.generators, t)
    excess = forces.excess(t)
    for i, h in enumerate(wall.holds):
        if h.friction > 1e-6 or h.grip == "pin":
            np.testing.assert_allclose(Grip.of(h, planar=False).excess(force[:, i]), excess[:, i], atol=1e-8)


def test_a_grip_in_space_is_that_of_the_plane_within_it() -> None:
    rng = np.random.default_rng(1)
    for h in (h for h in random_wall(rng, 20).holds if h.friction > 0.0):
        force = np.column_stack([rng.uniform(-20, 20, (40, 2)), np.zeros(40)])
        plane, space = (Grip.of(h, planar).excess(force) for planar in (True, False))
        np.testing.assert_allclose(plane, space, atol=1e-9)


def test_without_friction_any_force_across_the_normal_is_in_excess_in_space_too() -> None:
    grip = Grip.of(Hold((0, 0, 0), (0.0, 0.6, 0.8), 0.0, min_force=1.0, max_force=6.0), planar=False)
    normal, across = np.array([0.0, 0.6, 0.8]), np.array([0.0, -0.8, 0.6])
    forces = np.array([8.0 * normal, 8.0 * normal + 0.5 * across, 13.0 * normal, normal])
    np.testing.assert_allclose(grip.excess(forces), [-2.0, 0.5, 0.5, 0.5], atol=1e-12)
