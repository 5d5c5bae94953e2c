"""Postures pulled towards targets: known answers, optimality, and what is never given up."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import thesis_wall
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff

from climber.balance import Region
from climber.manifold import Body, Manifold
from climber.programs.posture import PostureProgram, distance, improve_posture
from climber.robot import Robot
from climber.stance import Contact, Vector
from climber.transition import Postures, find_transition, support_of

WALL, START, _ = thesis_wall("W2")
BODY = Body(Robot("package://climber/quadruped/quadruped.urdf", WALL.gravity), WALL)
CONTACTS = [Contact(limb, hold) for limb, hold in enumerate(START.holds)]


def on(contacts: list[Contact]) -> Manifold:
    support = support_of(BODY, contacts)
    assert support is not None
    return Manifold(BODY, contacts, support)


@pytest.fixture(scope="module")
def postures() -> Postures:
    found = find_transition(BODY, CONTACTS, 1, np.random.default_rng(0))
    assert len(found) > 8
    return found


def alike(postures: Postures) -> tuple[Vector, Vector]:
    """Two postures of the same branches."""
    for i, branches in enumerate(postures.branches):
        same = np.flatnonzero((postures.branches[i + 1 :] == branches).all(axis=1))
        if len(same):
            return postures.q[i], postures.q[i + 1 + same[0]]
    raise AssertionError("no two postures of the same branches")


@pytest.mark.parametrize("free", [None, 1])
def test_feasible_target_is_itself_the_answer(postures: Postures, free: int | None) -> None:
    guess, target = alike(postures)
    better = improve_posture(BODY, on([c for c in CONTACTS if c.limb != free]), guess, [(1.0, target)])
    assert better is not None
    assert np.abs(better - target).max() < 1e-4


def test_target_that_cannot_be_kept_is_approached_as_far_as_its_contacts_allow(postures: Postures) -> None:
    # Turning only the pelvis away from a posture pulls the feet off their holds.
    guess = postures.q[0]
    target = guess.copy()
    target[2] += 0.1
    better = improve_posture(BODY, on(CONTACTS), guess, [(1.0, target)])
    assert better is not None
    assert 0.0 < distance(better[None], [(1.0, target)])[0] < 0.1**2


def test_posture_that_is_already_at_its_target_is_not_improved(postures: Postures) -> None:
    assert improve_posture(BODY, on(CONTACTS), postures.q[0], [(2.0, postures.q[0])]) is None


@pytest.mark.parametrize("free", [None, 1])
def test_answer_is_feasible_nearer_exactly_on_its_holds_and_bends_as_before(
    postures: Postures, free: int | None
) -> None:
    manifold = on([c for c in CONTACTS if c.limb != free])
    improved = 0
    for guess, target in pairwise(postures.q):
        if manifold.slack(guess[None])[0] < 0:
            continue
        targets = [(1.0, target), (0.5, postures.q[0])]
        better = improve_posture(BODY, manifold, guess, targets)
        if better is None:
            continue
        improved += 1
        assert distance(better[None], targets)[0] < distance(guess[None], targets)[0]
        assert manifold.slack(better[None])[0] >= 0
        feet = BODY.kinematics.feet(better[None])[0]
        assert max(np.abs(feet[limb] - point).max() for limb, point in manifold.points.items()) < 1e-12
        holding = sorted(manifold.points)
        assert [BODY.branches(better)[i] for i in holding] == [BODY.branches(guess)[i] for i in holding]
        chart = manifold.chart(better)
        assert chart.expand(chart.coordinates(better[None]))[1][0] >= manifold.margins.reach
    assert improved > len(postures) // 2


def test_no_neighbour_in_the_chart_that_meets_the_constraints_is_nearer_than_the_solution(postures: Postures) -> None:
    manifold, rng = on(CONTACTS), np.random.default_rng(0)
    targets = [(1.0, postures.q[3]), (1.0, postures.q[5])]
    solution = PostureProgram(BODY, manifold, BODY.branches(postures.q[0])).solve(postures.q[0], targets)
    assert solution.violated == ()
    assert solution.cost == pytest.approx(distance(solution.q[None], targets)[0])
    chart = manifold.chart(postures.q[0])
    u = chart.coordinates(solution.q)
    q, reach = chart.expand(u + rng.normal(scale=1e-2, size=(4000, len(u))) / chart.scale)
    lower, upper = manifold.balanced.abscissas
    x = BODY.kinematics.center_of_mass(q)[:, 0]
    met = (reach >= manifold.margins.reach) & (BODY.kinematics.within_limits(q, manifold.margins.joint) >= 0)
    met &= (x >= lower) & (x <= upper)
    assert met.sum() > 100
    assert distance(q[met], targets).min() > solution.cost - 1e-5


def test_program_says_which_constraint_stands_in_the_way(postures: Postures) -> None:
    # The centre of mass would have to be a metre away from the holds.
    manifold = Manifold(BODY, CONTACTS, Region.interval(1.0, 1.1))
    solution = PostureProgram(BODY, manifold, BODY.branches(postures.q[0])).solve(postures.q[0], [(1.0, postures.q[0])])
    assert any("centre of mass" in name or "foot of" in name for name in solution.violated)
    assert improve_posture(BODY, manifold, postures.q[0], [(1.0, postures.q[1])]) is None


def test_every_constraint_is_named() -> None:
    prog = PostureProgram(BODY, on(CONTACTS), (0, 0, 0, 0)).prog
    names = [binding.evaluator().get_description() for binding in prog.GetAllConstraints()]
    assert all(names)
    assert sum(name.startswith("foot of") for name in names) == len(CONTACTS)


def test_gradients_of_constraints_match_finite_differences(postures: Postures) -> None:
    program = PostureProgram(BODY, on(CONTACTS), BODY.branches(postures.q[0]))
    rng, checked = np.random.default_rng(1), 0
    for binding in program.prog.generic_constraints():
        x = rng.uniform(-1.0, 1.0, len(binding.variables()))
        gradient = ExtractGradient(binding.evaluator().Eval(InitializeAutoDiff(x).ravel()))
        h = 1e-6
        for k in range(len(x)):
            step = np.zeros(len(x))
            step[k] = h
            difference = (binding.evaluator().Eval(x + step) - binding.evaluator().Eval(x - step)) / (2 * h)
            assert difference == pytest.approx(gradient[:, k], abs=1e-7)
        checked += 1
    assert checked == len(CONTACTS) + 1


def test_program_used_again_answers_as_a_new_one_does(postures: Postures) -> None:
    guess, manifold = postures.q[0], on(CONTACTS)
    program = PostureProgram(BODY, manifold, BODY.branches(guess))
    for target in postures.q[1:6]:
        again = improve_posture(BODY, manifold, guess, [(1.0, target)], program)
        fresh = improve_posture(BODY, manifold, guess, [(1.0, target)])
        assert (again is None) == (fresh is None)
        if again is not None and fresh is not None:
            assert again == pytest.approx(fresh, abs=1e-6)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 3), st.integers(0, 1), st.floats(-2.6, 2.6), st.floats(0.0005, 0.02))
def test_bend_is_in_its_range_exactly_if_the_limb_is_on_its_branch_and_within_reach(
    limb: int, branch: int, bend: float, margin: float
) -> None:
    joint, low, high = BODY.inverse[limb].bend(branch, margin)
    assert joint == 1
    q = np.zeros((1, BODY.robot.plant.num_positions()))
    q[0, BODY.robot.limbs[limb].q[-1]] = bend
    pelvis = BODY.kinematics.pelvis(q[:, BODY.robot.base_q])
    foot = BODY.kinematics.feet(q)[0, limb]
    _, reach = BODY.inverse[limb].solve(pelvis, np.zeros((1, 0)), foot)
    inside = reach[0, 0] >= margin and BODY.branches(q[0])[limb] == branch
    if min(abs(bend - low), abs(bend - high)) > 1e-6:
        assert (low <= bend <= high) == inside
