"""Inverse kinematics of one limb: every branch stands on the point, and what is out of reach is said to be."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import FOLDER, MODELS, body, kinematics, robot

from climber.exceptions import ModelError
from climber.inverse import TwoLinkInverse, TwoLinkInverses
from climber.kinematics import Kinematics, LimbChain, Pose
from climber.limb import Limb
from climber.robot import Robot
from climber.stance import Vector

seeds = st.integers(0, 2**32 - 1)
every_limb = pytest.mark.parametrize(
    ("model", "number"), [(model, number) for model in MODELS for number in range(len(robot(model).limbs))]
)


def limb_of(model: str, number: int) -> tuple[Limb, LimbChain, TwoLinkInverse]:
    inverse = body(model).inverse[number]
    assert isinstance(inverse, TwoLinkInverse)
    return robot(model).limbs[number], kinematics(model).chains[number], inverse


def pelvis_poses(model: str, rng: np.random.Generator, count: int) -> Pose:
    return kinematics(model).pelvis(rng.uniform([-1, -1, -4], [1, 1, 4], (count, 3)))


def feet(chain: LimbChain, pelvis: Pose, q: Vector) -> Vector:
    """The foot in W for joint angles (K, num_joints)."""
    return chain.foot_position(pelvis, chain.links(pelvis, q))


def angle_between(a: Vector, b: Vector) -> Vector:
    """Differences of angles, within half a turn."""
    result: Vector = np.mod(a - b + np.pi, 2 * np.pi) - np.pi
    return result


def base_joint(chain: LimbChain, pelvis: Pose, leading: Vector, inverse: TwoLinkInverse) -> Vector:
    """Where the first joint solved for is in W, shape (K, 3)."""
    parent = chain.links(pelvis, leading)[-1] if inverse.leading else pelvis
    return parent.point(chain.steps[inverse.leading].origin)


@every_limb
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_every_branch_puts_the_foot_on_a_point_in_reach(model: str, number: int, seed: int) -> None:
    limb, chain, inverse = limb_of(model, number)
    rng = np.random.default_rng(seed)
    pelvis, joints = pelvis_poses(model, rng, 1), rng.uniform(-4, 4, (1, len(limb.q)))
    target = feet(chain, pelvis, joints)[0]
    leading = joints[:, : inverse.leading]
    q, slack = inverse.solve(pelvis, leading, target)
    assert q.shape == (1, inverse.branches, len(limb.q)) and inverse.branches == 2
    assert slack.shape == (1, 2) and slack.min() >= -1e-12
    for branch in range(2):
        assert feet(chain, pelvis, q[:, branch])[0] == pytest.approx(target, abs=1e-12)
        assert np.array_equal(q[:, branch, : inverse.leading], leading)
    # The joints we started from are one of the two, up to whole turns.
    off = np.abs(angle_between(q[0], joints)).max(axis=1)
    near_straight = slack[0, 0] < 1e-6
    assert off.min() < (1e-3 if near_straight else 1e-6)
    if not near_straight:
        assert int(off.argmin()) == inverse.branch(joints[0])


@every_limb
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_branch_of_a_solution_is_the_branch_it_was_found_on(model: str, number: int, seed: int) -> None:
    limb, chain, inverse = limb_of(model, number)
    rng = np.random.default_rng(seed)
    pelvis, leading = pelvis_poses(model, rng, 30), rng.uniform(-4, 4, (30, inverse.leading))
    near, far = inverse.extent
    target = base_joint(chain, pelvis, leading, inverse)[0] + rng.uniform(near, far) * np.array([0.6, -0.8, 0.0])
    q, slack = inverse.solve(pelvis, leading, target)
    for k in np.flatnonzero(slack[:, 0] > 1e-9):
        assert [inverse.branch(q[k, branch]) for branch in range(2)] == [0, 1]
        turns = rng.integers(-2, 3, len(limb.q)) * 2 * np.pi
        assert [inverse.branch(q[k, branch] + turns) for branch in range(2)] == [0, 1]
    assert slack[0, 0] > 0 or near == far


@every_limb
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_solved_joints_lie_within_half_a_turn_of_the_middle_of_their_range(model: str, number: int, seed: int) -> None:
    limb, _, inverse = limb_of(model, number)
    rng = np.random.default_rng(seed)
    q, _ = inverse.solve(
        pelvis_poses(model, rng, 50), rng.uniform(-3, 3, (50, inverse.leading)), np.append(rng.uniform(-1, 1, 2), 0.0)
    )
    lower, upper = (np.array(side)[-2:] for side in limb.one_turn)
    assert np.isfinite(q).all()
    assert np.abs(q[..., -2:] - (lower + upper) / 2).max() <= np.pi + 1e-9


@every_limb
def test_slack_is_how_far_the_point_is_inside_the_ring_that_the_limb_reaches(model: str, number: int) -> None:
    _, chain, inverse = limb_of(model, number)
    rng = np.random.default_rng(0)
    pelvis, leading = pelvis_poses(model, rng, 200), rng.uniform(-3, 3, (200, inverse.leading))
    target = np.array([0.1, 0.2, 0.0])
    q, slack = inverse.solve(pelvis, leading, target)
    distance = np.linalg.norm(base_joint(chain, pelvis, leading, inverse) - target, axis=1)
    near, far = inverse.extent
    assert np.array_equal(slack[:, 0], slack[:, 1])
    slack = slack[:, 0]
    assert slack == pytest.approx(np.minimum(far - distance, distance - near), abs=1e-12)
    carrier = chain.links(pelvis, leading)[-1] if inverse.leading else pelvis
    assert inverse.room(carrier, target, 0).min(axis=1) == pytest.approx(slack, abs=1e-12)
    # Where it is negative the foot misses by just so much: the limb points at the target, or away from it.
    for branch in range(2):
        miss = np.linalg.norm(feet(chain, pelvis, q[:, branch]) - target, axis=1)
        assert miss == pytest.approx(np.maximum(-slack, 0.0), abs=1e-9)
    assert (slack < -0.01).any()


@every_limb
def test_extent_is_the_least_and_greatest_distance_of_the_foot_from_the_first_joint_solved_for(
    model: str, number: int
) -> None:
    limb, chain, inverse = limb_of(model, number)
    joints = np.zeros((4001, len(limb.q)))
    joints[:, -1] = np.linspace(-np.pi, np.pi, 4001)
    pelvis = kinematics(model).pelvis(np.zeros((4001, 3)))
    origin = base_joint(chain, pelvis, joints[:, : inverse.leading], inverse)
    distance = np.linalg.norm(feet(chain, pelvis, joints) - origin, axis=1)
    assert (distance.min(), distance.max()) == pytest.approx(inverse.extent, abs=1e-4)
    assert inverse.extent[0] <= distance.min() + 1e-12 and distance.max() <= inverse.extent[1] + 1e-12


@every_limb
def test_branches_meet_where_the_limb_is_straight_and_nowhere_else(model: str, number: int) -> None:
    _, chain, inverse = limb_of(model, number)
    pelvis = kinematics(model).pelvis(np.zeros((1, 3)))
    leading = np.zeros((1, inverse.leading))
    origin = base_joint(chain, pelvis, leading, inverse)[0]
    near, far = inverse.extent
    for distance, straight in ((far, True), (near, True), ((near + far) / 2, False), (far - 1e-3, False)):
        q, _ = inverse.solve(pelvis, leading, origin + distance * np.array([1.0, 0.0, 0.0]))
        apart = np.abs(angle_between(q[0, 0], q[0, 1])).max()
        # cos(psi) = 1 - eps leaves sqrt(2 eps); a foot at its own hip may come from any direction.
        assert (apart < 1e-5) == straight or (straight and distance < 1e-9)


def test_branch_bends_the_same_way_whichever_way_the_axes_point() -> None:
    # Seen in the frame of the link that carries the limb, branch 0 turns counter-clockwise at the elbow.
    for number in (0, 2, 3, 4):  # limb 1 hangs from a link that lies upside down
        _, chain, inverse = limb_of("long_limbed", number)
        pelvis = kinematics("long_limbed").pelvis(np.zeros((1, 3)))
        leading = np.zeros((1, inverse.leading))
        origin = base_joint(chain, pelvis, leading, inverse)[0]
        target = origin + np.mean(inverse.extent) * np.array([0.0, 1.0, 0.0])
        q, _ = inverse.solve(pelvis, leading, target)
        for branch, sign in ((0, 1.0), (1, -1.0)):
            links = chain.links(pelvis, q[:, branch])
            upper, lower = links[-1].origin[0] - links[-2].origin[0], target - links[-1].origin[0]
            assert np.sign(np.cross(upper, lower)[2]) == sign


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<axis xyz="0 0 1"/>\n    <limit lower="-0.5"', '<axis xyz="0 1 0"/>\n    <limit lower="-0.5"', "all about z"),
        (
            '<axis xyz="0 0 1"/>\n    <limit lower="-0.5"',
            '<axis xyz="0 0.1 1"/>\n    <limit lower="-0.5"',
            "all about z",
        ),
        ('xyz="0.13 0 0"', 'xyz="0 0 0"', "must lie apart"),
    ],
)
def test_limb_that_is_not_planar_or_has_no_length_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    urdf = (FOLDER / "three_limbed.urdf").read_text()
    assert old in urdf
    (tmp_path / "machine.urdf").write_text(urdf.replace(old, new))
    (tmp_path / "machine.yaml").write_text((FOLDER / "three_limbed.yaml").read_text())
    machine = Robot(tmp_path / "machine.urdf")
    with pytest.raises(ModelError, match=re.escape("limb 'top': ")) as caught:
        TwoLinkInverse(machine.limbs[0], Kinematics(machine).chains[0])
    assert said in str(caught.value)


def test_no_poses_give_no_solutions() -> None:
    _, _, inverse = limb_of("long_limbed", 0)
    q, slack = inverse.solve(kinematics("long_limbed").pelvis(np.zeros((0, 3))), np.zeros((0, 1)), np.zeros(3))
    assert q.shape == (0, 2, 3) and slack.shape == (0, 2)


@pytest.mark.parametrize("model", [model for model in MODELS if all(len(limb.q) == 2 for limb in robot(model).limbs)])
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_limbs_of_two_joints_are_solved_together_as_they_are_one_by_one(model: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    inverses = [limb_of(model, number)[2] for number in range(len(robot(model).limbs))]
    pelvis, branches = pelvis_poses(model, rng, 30), rng.integers(0, 2, len(inverses)).tolist()
    targets = np.append(rng.uniform(-1, 1, (len(inverses), 2)), np.zeros((len(inverses), 1)), axis=1)
    q, rooms = TwoLinkInverses(inverses, branches).solve(pelvis, targets)
    for i, (inverse, branch) in enumerate(zip(inverses, branches, strict=True)):
        alone, slack = inverse.solve(pelvis, np.zeros((30, 0)), targets[i])
        # Where the limb is straight or folded, the cosine of its bend loses half the digits.
        assert np.abs(angle_between(q[:, i], alone[:, branch])).max() < 1e-6
        assert rooms[:, i] == pytest.approx(slack[:, branch], abs=1e-12)


def test_limbs_with_leading_joints_are_not_solved_together() -> None:
    leading = [inverse for m in MODELS for inverse in body(m).inverse if getattr(inverse, "leading", 0)]
    assert leading
    with pytest.raises(ValueError, match="joints that are given"):
        TwoLinkInverses(leading[:1], [0])
