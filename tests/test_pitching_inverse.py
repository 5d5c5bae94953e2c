"""Inverse kinematics of limbs in space, on limbs of all shapes that have it in closed form."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from climber.exceptions import ModelError
from climber.inverse import PitchingInverse, TwoLinkInverse, limb_inverse
from climber.kinematics import Kinematics, LimbChain, Pose
from climber.limb import Limb
from climber.robot import Robot
from climber.stance import Vector

seeds = st.integers(0, 2**32 - 1)
shapes = st.integers(0, 7)
LEMUR = Robot("package://climber/lemur/lemur.urdf")
CHAINS = Kinematics(LEMUR).chains


def numbers(x: Vector) -> str:
    return " ".join(f"{value:.17g}" for value in x)


def machine(frames: list[tuple[Vector, Vector, Vector]], limits: list[tuple[float, float]], foot: Vector) -> Robot:
    """A robot that floats, with one limb: of each joint its place, its frame's angles, its axis and its limits."""
    moments = "".join(f'{name}="{value}" ' for name, value in zip(("ixx", "iyy", "izz"), (1e-3,) * 3, strict=True))
    inertial = f'<inertial><mass value="1"/><inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial>'
    text = ['<robot name="m">', f'<link name="link0">{inertial}</link>']
    for i, ((origin, angles, axis), (lower, upper)) in enumerate(zip(frames, limits, strict=True)):
        text += [
            f'<joint name="joint{i}" type="revolute"><parent link="link{i}"/><child link="link{i + 1}"/>',
            f'<origin xyz="{numbers(origin)}" rpy="{numbers(angles)}"/><axis xyz="{numbers(axis)}"/>',
            f'<limit lower="{lower}" upper="{upper}" velocity="1" effort="1"/></joint>',
            f'<link name="link{i + 1}">{inertial}</link>',
        ]
    text += [f'<frame name="foot" link="link{len(frames)}" xyz="{numbers(foot)}" rpy="0 0 0"/>', "</robot>"]
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "m.urdf").write_text("".join(text))
        (Path(folder) / "m.yaml").write_text("pelvis: link0\nlimbs: [{name: only, foot: foot}]\n")
        return Robot(Path(folder) / "m.urdf")


@cache
def limb_of(shape: int) -> tuple[Limb, LimbChain, PitchingInverse]:
    """A limb whose links and frames are turned and shifted any way that leaves two axes parallel and one across."""
    rng = np.random.default_rng(shape)
    hip, knee, wrist = Rotation.random(3, random_state=rng)
    n = Rotation.random(random_state=rng).apply([0.0, 0.0, 1.0])  # in link 1
    # A joint's axis is in the frame of the link it carries.
    second = knee.inv().apply(n)
    across = np.cross(second, rng.normal(size=3))
    third = wrist.inv().apply(across / np.linalg.norm(across))
    frames = [
        (rng.uniform(-0.1, 0.1, 3), hip.as_euler("xyz"), n),
        (rng.uniform(-0.2, 0.2, 3), knee.as_euler("xyz"), (-1) ** shape * second),
        (rng.uniform(-0.2, 0.2, 3), wrist.as_euler("xyz"), third),
    ]
    limits = [(-2.0, 3.0), (-2.5, 2.0), (-3.0, 3.0)]
    if shape % 3 == 0:  # a joint before those that are solved for
        frames.insert(0, (rng.uniform(-0.1, 0.1, 3), rng.uniform(-1, 1, 3), np.array([0.0, 0.6, 0.8])))
        limits.insert(0, (-1.0, 1.0))
    robot = machine(frames, limits, rng.uniform(-0.2, 0.2, 3))
    chain = Kinematics(robot).chains[0]
    inverse = limb_inverse(False, robot.limbs[0], chain)
    assert isinstance(inverse, PitchingInverse)
    return robot.limbs[0], chain, inverse


def poses(rng: np.random.Generator, count: int) -> Pose:
    return Pose(Rotation.random(count, random_state=rng).as_matrix().reshape(-1, 3, 3), rng.uniform(-1, 1, (count, 3)))


def feet(chain: LimbChain, pelvis: Pose, q: Vector) -> Vector:
    return chain.foot_position(pelvis, chain.links(pelvis, q))


def apart(a: Vector, b: Vector) -> Vector:
    result: Vector = np.abs(np.mod(a - b + np.pi, 2 * np.pi) - np.pi)
    return result


@settings(max_examples=50, deadline=None)
@given(shapes, seeds)
def test_every_branch_puts_the_foot_on_a_point_in_reach_and_one_is_where_it_came_from(shape: int, seed: int) -> None:
    limb, chain, inverse = limb_of(shape)
    rng = np.random.default_rng(seed)
    pelvis, joints = poses(rng, 1), rng.uniform(limb.lower, limb.upper)[None]
    target = feet(chain, pelvis, joints)[0]
    q, slack = inverse.solve(pelvis, joints[:, : inverse.leading], target)
    assert q.shape == (1, 4, len(limb.q)) and slack.shape == (1, 4)
    own = inverse.branch(joints[0])
    assert slack[0, own] >= -1e-12
    if slack[0, own] > 1e-6:
        assert apart(q[0, own], joints[0]).max() < 1e-6
    for branch in np.flatnonzero(slack[0] > 1e-9):
        assert feet(chain, pelvis, q[:, branch])[0] == pytest.approx(target, abs=1e-9)
        assert inverse.branch(q[0, branch]) == branch
        assert np.array_equal(q[0, branch, : inverse.leading], joints[0, : inverse.leading])
    middle = np.add(*limb.one_turn) / 2
    assert np.abs(q[0] - middle)[:, inverse.leading :].max() <= np.pi + 1e-9


@settings(max_examples=50, deadline=None)
@given(shapes, seeds)
def test_there_are_no_other_solutions(shape: int, seed: int) -> None:
    """Newton's method from anywhere ends on one of the branches."""
    limb, chain, inverse = limb_of(shape)
    rng = np.random.default_rng(seed)
    count, lead = 30, inverse.leading
    pelvis = poses(rng, 1)
    target = feet(chain, pelvis, rng.uniform(limb.lower, limb.upper)[None])[0]
    many = Pose(np.repeat(pelvis.rotation, count, axis=0), np.repeat(pelvis.origin, count, axis=0))
    q = rng.uniform(-np.pi, np.pi, (count, len(limb.q)))
    q[:, :lead] = 0.3
    for _ in range(30):
        gap = feet(chain, many, q) - target
        steps = 1e-6 * np.eye(len(limb.q))[lead:]
        J = np.stack([(feet(chain, many, q + s) - feet(chain, many, q - s)) / 2e-6 for s in steps], axis=2)
        step = np.linalg.solve(np.swapaxes(J, 1, 2) @ J + 1e-9 * np.eye(3), np.swapaxes(J, 1, 2) @ gap[:, :, None])
        q[:, lead:] -= np.clip(step[:, :, 0], -0.5, 0.5)
    solved, slack = inverse.solve(pelvis, np.full((1, lead), 0.3), target)
    for row in q[np.abs(feet(chain, many, q) - target).max(axis=1) < 1e-9]:
        branch = inverse.branch(row)
        assert slack[0, branch] > -1e-6
        if slack[0, branch] > 1e-4:
            assert apart(solved[0, branch], row).max() < 1e-5


@settings(max_examples=50, deadline=None)
@given(shapes, seeds)
def test_reach_is_the_least_room_and_beyond_it_no_posture_comes_to_the_point(shape: int, seed: int) -> None:
    _, chain, inverse = limb_of(shape)
    rng = np.random.default_rng(seed)
    pelvis, target = poses(rng, 20), rng.uniform(-0.5, 0.5, 3)
    leading = rng.uniform(-1, 1, (20, inverse.leading))
    pelvis = Pose(pelvis.rotation, 0.3 * pelvis.origin)
    q, slack = inverse.solve(pelvis, leading, target)
    carrier = chain.links(pelvis, leading)[-1] if inverse.leading else pelvis
    for branch in range(4):
        assert inverse.room(carrier, target, branch).min(axis=1) == pytest.approx(slack[:, branch], abs=1e-12)
        miss = np.linalg.norm(feet(chain, pelvis, q[:, branch]) - target, axis=1)
        assert (miss[slack[:, branch] >= 0] < 1e-9).all()
        assert (miss[slack[:, branch] < 0] >= -slack[slack[:, branch] < 0, branch] - 1e-9).all()
    assert np.isfinite(q).all()


def test_sides_that_the_limits_rule_out_are_no_branches() -> None:
    for limb, chain in zip(LEMUR.limbs, CHAINS, strict=True):
        inverse = limb_inverse(False, limb, chain)
        assert isinstance(inverse, PitchingInverse) and inverse.branches == 2
        # Straight outwards and 0.1 m towards the wall: the finger pitches down by asin(0.1 / 0.15).
        target = limb.hip + limb.hip / np.linalg.norm(limb.hip) * 0.3 - [0.0, 0.0, 0.1]
        q, slack = inverse.solve(Pose(np.eye(3)[None], np.zeros((1, 3))), np.zeros((1, 0)), target)
        assert q[0, :, 2] == pytest.approx([np.arcsin(0.1 / 0.15)] * 2)
        assert q[0, 0, :2] == pytest.approx(-q[0, 1, :2]) and q[0, 0, 1] > 0
        assert slack[0] == pytest.approx([0.05] * 2)  # to where the finger points straight down


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 3), st.integers(0, 1), st.floats(-2.6, 2.6))
def test_with_the_finger_stretched_out_the_bend_is_in_its_range_exactly_within_reach(
    number: int, branch: int, bend: float
) -> None:
    limb, chain = LEMUR.limbs[number], CHAINS[number]
    inverse = limb_inverse(False, limb, chain)
    assert inverse is not None
    joint, low, high = inverse.bend(branch, 0.002)
    pelvis = Pose(np.eye(3)[None], np.zeros((1, 3)))
    _, slack = inverse.solve(pelvis, np.zeros((1, 0)), feet(chain, pelvis, np.array([[0.4, bend, 0.0]]))[0])
    inside = slack[0, branch] >= 0.002 and inverse.branch(np.array([0.4, bend, 0.0])) == branch
    if min(abs(bend - low), abs(bend - high)) > 1e-6:
        assert joint == 1 and (low <= bend <= high) == inside


def test_limbs_that_are_not_of_the_kind_have_no_closed_form() -> None:
    place, still = np.array([0.1, 0.0, 0.0]), np.zeros(3)
    x, y, z = np.eye(3)
    limit, foot = (-1.0, 1.0), np.array([0.1, 0.05, 0.05])
    for axes, closed in (((z, z, y), True), ((z, -z, x), True), ((z, y, z), False), ((z,) * 3, False), ((z, y), False)):
        robot = machine([(place, still, axis) for axis in axes], [limit] * len(axes), foot)
        chain = Kinematics(robot).chains[0]
        assert (limb_inverse(False, robot.limbs[0], chain) is not None) == closed
        if not closed:
            with pytest.raises(ModelError, match="limb 'only'"):
                PitchingInverse(robot.limbs[0], chain)
    with pytest.raises(ModelError, match="apart"):
        robot = machine([(still, still, axis) for axis in (z, z, y)], [limit] * 3, place)
        PitchingInverse(robot.limbs[0], Kinematics(robot).chains[0])
    with pytest.raises(ModelError, match="all about z"):
        TwoLinkInverse(LEMUR.limbs[0], CHAINS[0])
