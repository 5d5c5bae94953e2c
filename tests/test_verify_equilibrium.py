"""verify's own equilibrium model against cases solved by hand, and against the planner's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import EQUILIBRIUM_PROBLEMS, MASS_OF_20_N, EquilibriumProblem, hold, random_wall

from climber.programs.equilibrium import SupportProgram
from climber.stance import Contact
from climber.verify_equilibrium import Grip, support_interval
from climber.wall import Wall


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
