"""The base of a robot in space against Drake: poses, rates of positions and velocities, where it is singular."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

from climber.cli import main
from climber.floating import R_WF, base_positions, rotation
from climber.robot import Robot
from climber.stance import Vector

LEMUR = Robot("package://climber/lemur/lemur.urdf")
TREE = Robot("package://climber/quadruped/quadruped.urdf")
seeds = st.integers(0, 2**32 - 1)


def states(seed: int, count: int = 7) -> tuple[Vector, Vector]:
    """Configurations and velocities, shape (count, 18) each; pitch stays off the right angle."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-3, 3, (count, LEMUR.plant.num_positions()))
    q[:, LEMUR.angle_q[1]] = rng.uniform(-1.4, 1.4, count)
    return q, rng.uniform(-2, 2, q.shape)


def test_lemur_is_the_robot_of_the_paper(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", LEMUR.model.source, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["mass"] == pytest.approx(7.0) and not facts["planar"]
    assert [len(limb["joints"]) for limb in facts["limbs"]] == [3] * 4
    for limb in facts["limbs"]:
        assert limb["effort"] == [5.0] * 3
        assert limb["velocity"] == pytest.approx([np.radians(45)] * 3, rel=1e-8)
    assert 2 * LEMUR.reach == pytest.approx([1.0] * 4, abs=1e-8)  # its wingspan [m]
    assert np.isfinite(LEMUR.plant.GetAccelerationUpperLimits()[LEMUR.joint_v]).all()
    assert len(LEMUR.symmetries) == 2


def test_pelvis_that_floats_is_in_the_walls_frame_at_zero_and_its_origin_reads_off_the_positions() -> None:
    context = LEMUR.context()
    q = np.zeros(LEMUR.plant.num_positions())
    LEMUR.plant.SetPositions(context, q)
    assert LEMUR.pelvis.EvalPoseInWorld(context).IsExactlyIdentity()
    q[LEMUR.origin_q] = 1.0, 2.0, 3.0
    LEMUR.plant.SetPositions(context, q)
    assert LEMUR.pelvis.EvalPoseInWorld(context).translation().tolist() == [1.0, 2.0, 3.0]


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_attitude_of_the_pelvis_is_the_plants(seed: int) -> None:
    context = LEMUR.context()
    q, _ = states(seed)
    for row, R in zip(q, rotation(q[:, LEMUR.base_q]), strict=True):
        LEMUR.plant.SetPositions(context, row)
        assert R == pytest.approx(LEMUR.pelvis.EvalPoseInWorld(context).rotation().matrix(), abs=1e-14)


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_rates_of_positions_and_velocities_are_the_plants_each_the_inverse_of_the_other(seed: int) -> None:
    context = LEMUR.context()
    q, v = states(seed)
    qdot, back = LEMUR.qdot(q, v), LEMUR.v_of(q, v)
    for i, row in enumerate(q):
        LEMUR.plant.SetPositions(context, row)
        assert qdot[i] == pytest.approx(LEMUR.plant.MapVelocityToQDot(context, v[i]), abs=1e-12)
        assert back[i] == pytest.approx(LEMUR.plant.MapQDotToVelocity(context, v[i]), abs=1e-12)
    assert LEMUR.v_of(q, qdot) == pytest.approx(v, abs=1e-12)
    assert LEMUR.qdot(q[0], v[0]) == pytest.approx(qdot[0])  # one configuration as well as many


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_accelerations_are_the_change_of_velocities(seed: int) -> None:
    q, qdot = states(seed)
    qddot, h = np.random.default_rng(seed).uniform(-2, 2, q.shape), 1e-5
    before, after = (LEMUR.v_of(q + t * qdot + t**2 / 2 * qddot, qdot + t * qddot) for t in (-h, h))
    vd = LEMUR.vd_of(q, qdot, qddot)
    assert vd == pytest.approx((after - before) / (2 * h), abs=1e-7)
    first, second = LEMUR.rates(q, LEMUR.v_of(q, qdot), vd)
    assert first == pytest.approx(qdot, abs=1e-11) and second == pytest.approx(qddot, abs=1e-10)


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_jacobians_by_positions_do_to_rates_of_positions_what_those_by_velocities_do_to_velocities(seed: int) -> None:
    q, qdot = states(seed)
    J = np.random.default_rng(seed).uniform(-1, 1, (len(q), 2, 3, q.shape[1]))
    by_positions = np.einsum("k...i,ki->k...", LEMUR.by_positions(q, J), qdot)
    assert by_positions == pytest.approx(np.einsum("k...i,ki->k...", J, LEMUR.v_of(q, qdot)), abs=1e-12)


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_a_planar_robots_velocities_are_the_rates_of_its_positions(seed: int) -> None:
    q, v, vd = np.random.default_rng(seed).uniform(-3, 3, (3, 5, TREE.plant.num_positions()))
    assert TREE.dimension == 2 and TREE.angle_q.tolist() == [2] and TREE.origin_q.tolist() == [0, 1]
    assert np.array_equal(TREE.qdot(q, v), v) and np.array_equal(TREE.v_of(q, v), v)
    assert np.array_equal(TREE.vd_of(q, v, vd), vd) and np.array_equal(TREE.by_positions(q, v), v)


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_every_attitude_has_positions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, origin = Rotation.random(6, random_state=rng).as_matrix(), rng.uniform(-1, 1, (6, 3))
    base = base_positions(R, origin)
    assert rotation(base) == pytest.approx(R, abs=1e-9)
    assert base[:, LEMUR.origin_q - LEMUR.base_q[0]] == pytest.approx(origin)
    assert np.abs(base[:, 1]).max() <= np.pi / 2


def test_rates_are_tame_all_round_a_corner_and_all_round_a_spin_and_wild_only_where_the_pelvis_looks_up() -> None:
    turn = np.linspace(-np.pi, np.pi, 60)
    for axis, wild in (("y", False), ("z", False), ("x", True)):  # of W
        base = base_positions(Rotation.from_euler(axis, turn[:, None]).as_matrix(), np.zeros((60, 3)))
        q = np.zeros((60, LEMUR.plant.num_positions()))
        q[:, LEMUR.base_q] = base
        v = np.zeros_like(q)
        v[:, :3] = 1.0
        assert (np.abs(LEMUR.qdot(q, v)).max() > 10) == wild


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_unwound_angles_are_the_same_pose_within_half_a_turn_of_the_reference(seed: int) -> None:
    q, reference = states(seed)
    reference *= 5
    unwound = LEMUR.unwound(q, reference)
    assert rotation(unwound[:, :6]) == pytest.approx(rotation(q[:, :6]), abs=1e-12)
    assert np.abs((unwound - reference)[:, LEMUR.angle_q]).max() <= np.pi + 1e-12
    rest = np.delete(np.arange(q.shape[1]), LEMUR.angle_q)
    assert np.array_equal(unwound[:, rest], q[:, rest])


def test_frames_are_those_that_the_module_names() -> None:
    (base,) = [joint for joint in LEMUR._joints() if joint.type_name() == "rpy_floating"]
    context = LEMUR.context()
    expected = RigidTransform(RotationMatrix(R_WF))
    assert base.frame_on_parent().CalcPoseInWorld(context).IsNearlyEqualTo(expected, 1e-14)
    assert base.frame_on_child().GetFixedPoseInBodyFrame().IsNearlyEqualTo(expected, 1e-14)
    z_W, x_W, y_W = np.eye(3)[[2, 0, 1]]
    assert np.array_equal(R_WF, np.column_stack([z_W, x_W, y_W]))
