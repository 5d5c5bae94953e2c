"""Batched kinematics: held to Drake's plant on every robot, and to finite differences."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.multibody.tree import JacobianWrtVariable
from robots import FOLDER, configurations, every_robot, kinematics, robot

from climber.exceptions import ModelError
from climber.kinematics import Kinematics
from climber.robot import Robot
from climber.stance import Vector

seeds = st.integers(0, 2**32 - 1)
URDF = (FOLDER / "three_limbed.urdf").read_text()
YAML = (FOLDER / "three_limbed.yaml").read_text().partition("# One turn")[0]


@every_robot
@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_links_feet_and_centre_of_mass_are_where_drake_has_them(model: str, seed: int) -> None:
    machine, ours = robot(model), kinematics(model)
    q = np.random.default_rng(seed).uniform(-5, 5, (4, machine.plant.num_positions()))
    poses, feet, center = ours.poses(q), ours.feet(q), ours.center_of_mass(q)
    assert len(poses) == len(ours.links)
    context = machine.context()
    for k in range(len(q)):
        machine.plant.SetPositions(context, q[k])
        assert feet[k] == pytest.approx(machine.foot_positions(context), abs=1e-13)
        assert center[k] == pytest.approx(machine.center_of_mass(context), abs=1e-13)
        for name, pose in zip(ours.links, poses, strict=True):
            X_WL = machine.plant.GetBodyByName(name).EvalPoseInWorld(context)
            assert pose.origin[k] == pytest.approx(X_WL.translation(), abs=1e-13)
            assert pose.rotation[k] == pytest.approx(X_WL.rotation().matrix(), abs=1e-13)
    assert ours.center_of_mass(q, ours.link_poses(q)) == pytest.approx(center, abs=0)


@every_robot
@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_foot_jacobians_are_drakes(model: str, seed: int) -> None:
    machine = robot(model)
    rng = np.random.default_rng(seed)
    q = rng.uniform(-5, 5, (3, machine.plant.num_positions()))
    limbs = [int(i) for i in rng.permutation(len(machine.limbs))[:2]]
    ours = kinematics(model).foot_jacobians(q, limbs)
    context, world = machine.context(), machine.plant.world_frame()
    for k in range(len(q)):
        machine.plant.SetPositions(context, q[k])
        for row, i in enumerate(limbs):
            foot = machine.plant.GetFrameByName(machine.limbs[i].foot)
            J = machine.plant.CalcJacobianTranslationalVelocity(
                context, JacobianWrtVariable.kV, foot, np.zeros(3), world, world
            )
            assert ours[k, row] == pytest.approx(J[: machine.dimension], abs=1e-13)
            assert J[machine.dimension :] == pytest.approx(0.0, abs=1e-13)  # in the plane; so the third row is left out


@every_robot
def test_foot_jacobians_match_finite_differences(model: str) -> None:
    ours = kinematics(model)
    q = configurations(model, np.random.default_rng(0), 5)
    every = range(len(ours.chains))
    J = robot(model).by_positions(q, ours.foot_jacobians(q, every))
    h = 1e-6
    for column in range(q.shape[1]):
        step = np.zeros(q.shape[1])
        step[column] = h
        difference = (ours.feet(q + step) - ours.feet(q - step))[..., : J.shape[2]] / (2 * h)
        assert J[..., column] == pytest.approx(difference, abs=1e-9)


@every_robot
def test_fewer_angles_than_joints_give_the_links_nearest_the_pelvis(model: str) -> None:
    ours = kinematics(model)
    q = configurations(model, np.random.default_rng(1), 6)
    pelvis = ours.pelvis(q[:, robot(model).base_q])
    for limb, chain in zip(robot(model).limbs, ours.chains, strict=True):
        whole = chain.links(pelvis, q[:, limb.q])
        assert len(whole) == len(limb.q)
        for few in range(len(limb.q)):
            part = chain.links(pelvis, q[:, limb.q[:few]])
            assert len(part) == few
            assert all(np.array_equal(a.origin, b.origin) for a, b in zip(part, whole, strict=False))


@every_robot
def test_moments_and_masses_of_limbs_and_pelvis_make_up_the_centre_of_mass(model: str) -> None:
    ours = kinematics(model)
    q = configurations(model, np.random.default_rng(2), 4)
    pelvis = ours.pelvis(q[:, robot(model).base_q])
    total = ours.pelvis_mass * pelvis.point(ours.pelvis_center)
    for limb, chain in zip(robot(model).limbs, ours.chains, strict=True):
        total = total + chain.moment(chain.links(pelvis, q[:, limb.q]))
    assert total / robot(model).mass == pytest.approx(ours.center_of_mass(q), abs=1e-13)
    assert ours.pelvis_mass + sum(c.masses.sum() for c in ours.chains) == pytest.approx(robot(model).mass)


@every_robot
def test_distance_to_joint_limits_is_that_of_the_nearest_joint_less_the_margin(model: str) -> None:
    machine, ours = robot(model), kinematics(model)
    q = np.random.default_rng(3).uniform(-3.5, 3.5, (50, machine.plant.num_positions()))
    room = ours.within_limits(q, 0.1)

    def nearest(row: Vector) -> float:
        distances = []
        for limb in machine.limbs:
            for place, low, high in zip(limb.q, *limb.one_turn, strict=True):
                distances += [row[place] - low, high - row[place]]
        return min(distances) - 0.1

    assert room == pytest.approx([nearest(row) for row in q], abs=1e-12)
    assert (room < 0).any() and (ours.within_limits(configurations(model, np.random.default_rng(4), 50)) >= 0).all()


def test_no_configurations_give_no_results() -> None:
    q = np.zeros((0, robot("quadruped").plant.num_positions()))
    assert kinematics("quadruped").feet(q).shape == (0, 4, 3)
    assert kinematics("quadruped").center_of_mass(q).shape == (0, 3)
    assert kinematics("quadruped").within_limits(q).shape == (0,)


# --- robots it cannot follow -----------------------------------------------------------------------------------------

BASE = URDF[URDF.index('  <joint name="base"') : URDF.index('  <joint name="top_shoulder"')]
TAIL = (
    '<joint name="tail" type="revolute"><parent link="pelvis"/><child link="tail"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint><link name="tail"><inertial><mass value="0.1"/>'
    '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
ANCHOR = (
    '<joint name="anchor" type="fixed"><parent link="world"/><child link="anchor"/></joint><link name="anchor">'
    '<inertial><mass value="0.1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (BASE, BASE.replace('type="planar"', 'type="fixed"').replace('<axis xyz="0 0 1"/>', ""), "planar joint"),
        ("</robot>", f"{TAIL}</robot>", "a joint belongs neither to the pelvis nor to a limb"),
        ("</robot>", f"{ANCHOR}</robot>", "of 1.63 kg only 1.53 kg move"),
        ('link="left_toe" xyz="0.01 0.002 0"', 'link="left_toe" xyz="0.01 0.002 0.005"', "'left_foot' is 0.005 m off"),
    ],
)
def test_robot_that_cannot_be_followed_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in URDF
    (tmp_path / "machine.urdf").write_text(URDF.replace(old, new))
    (tmp_path / "machine.yaml").write_text(YAML)
    with pytest.raises(ModelError, match=re.escape(str(tmp_path / "machine.urdf"))) as caught:
        Kinematics(Robot(tmp_path / "machine.urdf"))
    assert said in str(caught.value)


def link(name: str, mass: float) -> str:
    """A link in SDF."""
    moments = "".join(f"<{i}>{mass}</{i}>" for i in ("ixx", "iyy", "izz")) + "<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz>"
    return f'<link name="{name}"><inertial><mass>{mass}</mass><inertia>{moments}</inertia></inertial></link>'


def sdf(knee: str) -> str:
    """A robot of one limb in SDF, its planar joint on a link welded to the world; `knee` is the pose of a joint."""
    joint = '<joint name="{}" type="{}"><parent>{}</parent><child>{}</child>{}<axis><xyz>0 0 1</xyz></axis></joint>'
    return (
        '<sdf version="1.9" xmlns:drake="http://drake.mit.edu"><model name="m">'
        + link("ground", 1e-12)
        + "".join(link(name, 1.0) for name in ("pelvis", "thigh", "shank"))
        + '<frame name="foot" attached_to="shank"><pose>0.3 0 0 0 0 0</pose></frame>'
        + '<joint name="weld" type="fixed"><parent>world</parent><child>ground</child></joint>'
        + '<drake:joint name="base" type="planar"><drake:parent>ground</drake:parent>'
        + "<drake:child>pelvis</drake:child><drake:damping>0 0 0</drake:damping></drake:joint>"
        + joint.format("hip", "revolute", "pelvis", "thigh", "")
        + joint.format("knee", "revolute", "thigh", "shank", knee)
        + "</model></sdf>"
    )


def test_robot_in_sdf_is_followed(tmp_path: Path) -> None:
    (tmp_path / "machine.sdf").write_text(sdf('<pose relative_to="thigh">0 0 0 0 0 0</pose>'))
    (tmp_path / "machine.yaml").write_text("pelvis: pelvis\nlimbs: [{name: only, foot: foot}]\n")
    machine = Robot(tmp_path / "machine.sdf")
    assert machine.planar and machine.limb_names == ("only",)
    (feet,) = Kinematics(machine).feet(np.array([[1.0, 2.0, 0.0, np.pi / 2, 0.0]]))
    assert feet[0] == pytest.approx([1.0, 2.3, 0.0])


def test_joint_away_from_its_links_origin_is_refused(tmp_path: Path) -> None:
    (tmp_path / "machine.sdf").write_text(sdf('<pose relative_to="shank">0.1 0 0 0 0 0</pose>'))
    (tmp_path / "machine.yaml").write_text("pelvis: pelvis\nlimbs: [{name: only, foot: foot}]\n")
    with pytest.raises(ModelError, match="joint 'knee' must lie at its child link's origin"):
        Kinematics(Robot(tmp_path / "machine.sdf"))
