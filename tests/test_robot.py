"""What is read from a robot's model and its description, for several robots, and every way these can be wrong."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from robots import EVERYTHING, FOLDER, MODELS, configurations, every_model, every_robot, robot
from scipy.optimize import minimize

from climber.exceptions import ModelError
from climber.robot import Model, Robot
from climber.stance import Vector

URDF = (FOLDER / "three_limbed.urdf").read_text()
YAML = (FOLDER / "three_limbed.yaml").read_text()


def written(folder: Path, urdf: str = URDF, yaml: str | bytes = YAML) -> Path:
    """A model of its own in a folder."""
    (folder / "machine.urdf").write_text(urdf)
    (folder / "machine.yaml").write_bytes(yaml if isinstance(yaml, bytes) else yaml.encode())
    return folder / "machine.urdf"


def replaced(text: str, old: str, new: str, count: int = 1) -> str:
    assert old in text
    return text.replace(old, new, count)


# --- what is read ----------------------------------------------------------------------------------------------------


def test_robots_of_the_tests_differ_in_limbs_and_joints() -> None:
    joints = {model: [len(limb.joints) for limb in robot(model).limbs] for model in MODELS}
    assert joints == {"quadruped": [2] * 4, "three_limbed": [2] * 3, "long_limbed": [3, 3, 2, 3, 3]}


@every_model
def test_limbs_are_those_of_the_description_with_joints_outwards_from_the_pelvis(model: str) -> None:
    machine = robot(model)
    assert machine.limb_names == tuple(machine.model.feet)
    for limb in machine.limbs:
        assert all(joint.startswith(f"{limb.name}_") for joint in limb.joints)
        body = machine.pelvis
        for joint in map(machine.plant.GetJointByName, limb.joints):
            below = machine.plant.GetBodiesKinematicallyAffectedBy([joint.index()])
            assert body.index() not in below and joint.child_body().index() in below
            body = joint.child_body()
        assert machine.plant.GetFrameByName(limb.foot).body().index() in {
            b.index() for b in machine.plant.GetBodiesWeldedTo(body)
        }


@every_robot
def test_limits_and_places_of_joints_are_those_of_the_plant(model: str) -> None:
    machine = robot(model)
    plant = machine.plant
    for limb in machine.limbs:
        for i, name in enumerate(limb.joints):
            joint = plant.GetJointByName(name)
            assert limb.q[i] == joint.position_start() and limb.v[i] == joint.velocity_start()
            assert machine.position_names[limb.q[i]] == name
            assert machine.velocity_names[limb.v[i]] == name
            assert limb.lower[i] == plant.GetPositionLowerLimits()[limb.q[i]]
            assert limb.upper[i] == plant.GetPositionUpperLimits()[limb.q[i]]
            assert limb.velocity[i] == plant.GetVelocityUpperLimits()[limb.v[i]]
            assert machine.joint_limits[name] == (limb.lower[i], limb.upper[i])
    motors = {
        plant.get_joint_actuator(i).joint().name(): plant.get_joint_actuator(i).effort_limit()
        for i in plant.GetJointActuatorIndices()
    }
    assert dict(zip(machine.joint_names, machine.effort, strict=True)) == {
        name: motors.get(name, 0.0) for name in machine.joint_names
    }
    assert list(machine.joint_v) == [plant.GetJointByName(name).velocity_start() for name in machine.joint_names]


@every_robot
def test_positions_and_velocities_stand_in_the_same_order_with_the_pelvis_first_in_its_frame(model: str) -> None:
    machine = robot(model)
    assert np.array_equal(machine.base_q, machine.base_v) and np.array_equal(machine.base_q, range(len(machine.base_q)))
    assert sorted([*machine.origin_q, *machine.angle_q]) == machine.base_q.tolist()
    assert all(np.array_equal(limb.q, limb.v) for limb in machine.limbs)
    context, rng = machine.context(), np.random.default_rng(0)
    q = rng.uniform(-1, 1, machine.plant.num_positions())
    machine.plant.SetPositions(context, q)
    pose = machine.pelvis.EvalPoseInWorld(context)
    assert pose.translation()[: machine.dimension] == pytest.approx(q[machine.origin_q], abs=1e-15)
    if machine.planar:
        assert pose.translation()[2] == 0.0
        (angle,) = q[machine.angle_q]
        assert pose.rotation().ToRollPitchYaw().vector() == pytest.approx([0.0, 0.0, angle], abs=1e-15)


@every_robot
def test_mass_is_the_sum_of_the_links_masses(model: str) -> None:
    text = Path(robot(model).model.path).read_text()
    assert robot(model).mass == pytest.approx(sum(map(float, re.findall(r'<mass value="([^"]+)"', text))))


@every_robot
def test_gravity_is_the_one_asked_for(model: str) -> None:
    machine = Robot(EVERYTHING[model], (0.0, -5.0, -2.0))
    assert machine.plant.gravity_field().gravity_vector() == pytest.approx([0.0, -5.0, -2.0])
    assert machine.gravity == pytest.approx([0.0, -5.0, -2.0])


@every_model
def test_reach_is_the_farthest_that_a_foot_can_be_from_the_pelvis(model: str) -> None:
    machine = robot(model)
    context = machine.context()

    def distance(angles: Vector, number: int) -> float:
        q = np.zeros(machine.plant.num_positions())
        q[machine.limbs[number].q] = angles
        machine.plant.SetPositions(context, q)
        return float(np.linalg.norm(machine.foot_positions(context)[number]))

    rng = np.random.default_rng(0)
    for i, limb in enumerate(machine.limbs):
        n = len(limb.q)
        assert max(distance(angles, i) for angles in rng.uniform(-np.pi, np.pi, (200, n))) <= limb.reach + 1e-12
        farthest = max(
            -minimize(lambda a, i=i: -distance(a, i), start, tol=1e-12).fun for start in rng.uniform(-2, 2, (6, n))
        )
        assert farthest == pytest.approx(limb.reach, abs=1e-7)
        assert machine.reach[i] == limb.reach


@every_robot
def test_hip_is_where_the_first_joint_is_or_a_foot_without_any_whatever_the_posture(model: str) -> None:
    machine = robot(model)
    context = machine.context()
    for q in configurations(model, np.random.default_rng(1), 5):
        machine.plant.SetPositions(context, q)
        X_WP = machine.pelvis.EvalPoseInWorld(context)
        for limb in machine.limbs:
            first = [machine.plant.GetJointByName(name).frame_on_parent() for name in limb.joints[:1]]
            origin = (first or [machine.plant.GetFrameByName(limb.foot)])[0].CalcPoseInWorld(context)
            assert X_WP @ limb.hip == pytest.approx(origin.translation(), abs=1e-12)


def test_ranges_wider_than_a_turn_are_cut_to_one_about_their_middle() -> None:
    (limb,) = (limb for limb in robot("long_limbed").limbs if limb.name == "south_west")
    assert np.isinf(limb.lower[0]) and np.isinf(limb.velocity[0]) and limb.effort[0] == 0.0
    lower, upper = limb.one_turn
    assert (lower[0], upper[0]) == (-np.pi, np.pi)
    assert np.array_equal(lower[1:], limb.lower[1:]) and np.array_equal(upper[1:], limb.upper[1:])


def test_one_turn_of_ranges_that_are_wide_or_open_at_one_end(tmp_path: Path) -> None:
    old = 'lower="-2.3" upper="2.3"'
    wide = written(tmp_path, replaced(URDF, old, 'lower="-3" upper="5"', 3))
    lower, upper = Robot(wide).limbs[0].one_turn
    assert (lower[0], upper[0]) == pytest.approx((1 - np.pi, 1 + np.pi))
    limb = robot("three_limbed").limbs[0]
    half_open = replace(limb, lower=np.array([-1.0, -np.inf]), upper=np.array([np.inf, 2.0]))
    lower, upper = half_open.one_turn
    assert lower == pytest.approx([-1.0, 2.0 - 2 * np.pi]) and upper == pytest.approx([2 * np.pi - 1.0, 2.0])


# --- symmetries ------------------------------------------------------------------------------------------------------


@every_model
def test_symmetries_are_a_group_with_the_identity_first(model: str) -> None:
    group = robot(model).symmetries
    assert group[0] == tuple(range(len(robot(model).limbs)))
    assert {tuple(p[i] for i in q) for p in group for q in group} == set(group)
    assert len(group) == {"quadruped": 2, "three_limbed": 3, "long_limbed": 1}[model]


@every_robot
def test_turning_the_pelvis_and_handing_joint_angles_on_leaves_feet_and_centre_of_mass(model: str) -> None:
    machine = robot(model)
    context = machine.context()
    for permutation in machine.symmetries:
        hips = [complex(*limb.hip[:2]) for limb in machine.limbs]
        turn = np.angle(hips[permutation[0]] / hips[0])
        for q in configurations(model, np.random.default_rng(2), 10):
            machine.plant.SetPositions(context, q)
            feet, center = machine.foot_positions(context), machine.center_of_mass(context)
            handed = q.copy()
            handed[machine.angle_q[0]] -= turn  # in space the spin, which comes first
            for limb, other in zip(machine.limbs, permutation, strict=True):
                handed[machine.limbs[other].q] = q[limb.q]
            machine.plant.SetPositions(context, handed)
            # Limb i has taken the place of limb permutation[i]: that limb's foot is now where limb i's was.
            assert machine.foot_positions(context)[list(permutation)] == pytest.approx(feet, abs=1e-7)
            assert machine.center_of_mass(context) == pytest.approx(center, abs=1e-7)


QUADRUPED_URDF = (Path(robot("quadruped").model.path)).read_text()
QUADRUPED_YAML = Path(robot("quadruped").model.path).with_suffix(".yaml").read_text()
HALF_TURN = "[left_rear, right_rear, right_front, left_front]"


@pytest.mark.parametrize(
    ("urdf", "order", "said"),
    [
        (
            QUADRUPED_URDF,
            "[left_front, left_rear, right_rear, right_front]",
            "m apart",
        ),  # hips are not 90 degrees apart
        (QUADRUPED_URDF, "[left_front, right_front, right_rear, left_rear]", "m apart"),  # a mirror image
        (QUADRUPED_URDF, "[right_front, left_rear, left_front, right_rear]", "m apart"),
        (QUADRUPED_URDF.replace('xyz="0.1 0 0" rpy="0 0 0"', 'xyz="0.1 0.01 0" rpy="0 0 0"', 1), HALF_TURN, "m apart"),
        (QUADRUPED_URDF.replace('lower="-2.618"', 'lower="-2.5"', 1), HALF_TURN, "limits"),
        (QUADRUPED_URDF.replace('effort="4.0"', 'effort="5.0"', 1), HALF_TURN, "limits"),
        (QUADRUPED_URDF.replace('<mass value="0.1"/>', '<mass value="0.11"/>', 1), HALF_TURN, "m apart"),
        (
            QUADRUPED_URDF.replace('<mass value="1.2"/>', '<origin xyz="0.01 0 0"/><mass value="1.2"/>'),
            HALF_TURN,
            "centre of mass",
        ),
    ],
)
def test_declared_symmetry_that_is_none_is_refused(tmp_path: Path, urdf: str, order: str, said: str) -> None:
    assert HALF_TURN in QUADRUPED_YAML
    path = written(tmp_path, urdf, QUADRUPED_YAML.replace(HALF_TURN, order))
    with pytest.raises(ModelError, match=re.escape(f"{path.with_suffix('.yaml')}: symmetries[0]: ")) as caught:
        Robot(path)
    assert said in str(caught.value)
    Robot(written(tmp_path, urdf, QUADRUPED_YAML.replace(f"- {HALF_TURN}", "").replace("symmetries:", "")))


def test_symmetry_between_limbs_of_unlike_joints_is_refused(tmp_path: Path) -> None:
    long_limbed = FOLDER / "long_limbed"
    yaml = long_limbed.with_suffix(".yaml").read_text() + "symmetries:\n- [north, west, south_west, south_east, east]\n"
    path = written(tmp_path, long_limbed.with_suffix(".urdf").read_text(), yaml)
    with pytest.raises(ModelError, match=r"symmetries\[0\]"):
        Robot(path)


# --- descriptions that do not say what they must ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("pelvis: pelvis\n", "", "pelvis: nothing given"),
        ("pelvis: pelvis", "pelvis: 3", "pelvis: given 3"),
        ("pelvis: pelvis", "pelvis: pelvis\npelvis: pelvis", "pelvis: given 'pelvis'; allowed: each field once"),
        ("pelvis: pelvis", "pelvis: pelvis\ntail: tail", "tail: given 'tail'"),
        ("pelvis: pelvis", "pelvis: pelvi", "pelvis: given 'pelvi'"),
        ("pelvis: pelvis", "pelvis: WorldBody", "pelvis: given 'WorldBody'"),
        ("limbs:", "limbs: []\nlegs:", "legs: given"),
        ("- {name: top, foot: top_foot}\n", "- top\n", "limbs[0]: given 'top'"),
        ("name: top, ", "", "limbs[0].name: nothing given"),
        ("name: left", "name: top", "limbs[0].name: given 'top'"),
        ("foot: left_foot", "foot: top_foot", "limbs[0].foot: given 'top_foot'"),
        ("foot: left_foot", "foot: left_food", "limbs[1].foot: given 'left_food'"),
        ("foot: left_foot", "foot: world", "limbs[1].foot: given 'world'"),
        ("foot: left_foot", "foot: top_lower", "limbs[1].foot: given 'top_lower'"),  # on a joint of another limb
        ("foot: left_foot", "foot: [1]", "limbs[1].foot: given [1]"),
        ("- {name: left", "- {name: left, colour: red", "limbs[1].colour: given 'red'"),
        ("[left, right, top]", "[left, right]", "symmetries[0]: given ['left', 'right']"),
        ("[left, right, top]", "[left, right, tip]", "symmetries[0]: given"),
        ("[left, right, top]", "[left, left, top]", "symmetries[0]: given"),
        ("[left, right, top]", "top", "symmetries[0]: given 'top'"),
        ("- [left, right, top]", "  7", "symmetries: given 7"),
    ],
)
def test_mistake_in_the_description_names_file_and_field(tmp_path: Path, old: str, new: str, field: str) -> None:
    path = written(tmp_path, yaml=replaced(YAML, old, new))
    with pytest.raises(ModelError, match=re.escape(f"{path.with_suffix('.yaml')}: {field}")):
        Robot(path)


def test_empty_list_of_limbs_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, yaml="pelvis: pelvis\nlimbs: []\n")
    with pytest.raises(ModelError, match=r"limbs: given \[\]"):
        Robot(path)


def test_limbs_that_are_not_counter_clockwise_are_refused_with_the_right_order(tmp_path: Path) -> None:
    swapped = replaced(YAML, "- {name: left, foot: left_foot}\n- {name: right, foot: right_foot}\n",
                       "- {name: right, foot: right_foot}\n- {name: left, foot: left_foot}\n")  # fmt: skip
    path = written(tmp_path, yaml=swapped)
    with pytest.raises(ModelError, match=r"limbs: given .*; allowed: counter-clockwise .*: top, left, right"):
        Robot(path)


def test_any_limb_may_come_first(tmp_path: Path) -> None:
    turned = replaced(YAML, "- {name: top, foot: top_foot}\n", "")
    turned = replaced(turned, "foot: right_foot}\n", "foot: right_foot}\n- {name: top, foot: top_foot}\n")
    assert Robot(written(tmp_path, yaml=turned)).limb_names == ("left", "right", "top")


@pytest.mark.parametrize("yaml", ["", "just words", "pelvis: [", b"pelvis: \xff\xfe", "- 1\n- 2", "pelvis: pelvis"])
def test_description_that_is_not_one_names_the_file(tmp_path: Path, yaml: str | bytes) -> None:
    path = written(tmp_path, yaml=yaml)
    with pytest.raises(ModelError, match=re.escape(str(path.with_suffix(".yaml")))):
        Model.load(path)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_description_is_read_or_refused_as_a_model_error(tmp_path: Path, data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(YAML)))
    cut = data.draw(st.integers(0, 12))
    text = YAML[:place] + data.draw(st.text(max_size=6)) + YAML[place + cut :]
    path = written(tmp_path, yaml=text.encode("utf-8", "surrogatepass"))
    try:
        model = Model.load(path)
    except ModelError as error:
        assert str(path.with_suffix(".yaml")) in str(error)
    else:
        assert len(model.feet) >= 1


# --- models that cannot be used --------------------------------------------------------------------------------------

PLANAR = '  <joint name="base" type="planar">\n    <parent link="world"/><child link="pelvis"/>\n'
AXIS = '    <axis xyz="0 0 1"/>\n  </joint>'
assert PLANAR + AXIS in URDF


def test_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"nowhere\.urdf: no such robot model"):
        Robot(tmp_path / "nowhere.urdf")
    (tmp_path / "lonely.urdf").write_text(URDF)
    with pytest.raises(ModelError, match=r"lonely\.yaml: missing"):
        Robot(tmp_path / "lonely.urdf")
    with pytest.raises(ModelError, match="no package 'elsewhere'"):
        Robot("package://elsewhere/robot.urdf")


def test_relative_path_starts_from_the_folder_given(tmp_path: Path) -> None:
    path = written(tmp_path)
    assert Model.load("machine.urdf", tmp_path).path == path
    with pytest.raises(ModelError, match="no such robot model"):
        Model.load("machine.urdf", tmp_path / "elsewhere")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<robot name", "<robt name", "Drake cannot read"),
        ("</robot>", "", "Drake cannot read"),
        (
            '<parent link="pelvis"/><child link="top_upper"/>',
            '<parent link="pelvi"/><child link="top_upper"/>',
            "Drake",
        ),
        ('name="top_shoulder" type="revolute"', 'name="top_shoulder" type="prismatic"', "'top_shoulder' is prismatic"),
        (PLANAR + AXIS, PLANAR + "  </joint>", "URDF's default axis is x"),
        (PLANAR + AXIS, PLANAR + '    <origin xyz="0 0 0.1"/>\n' + AXIS, "no offset"),
        (PLANAR + AXIS, PLANAR + '    <axis xyz="0 0 -1"/>\n  </joint>', "about z"),
        ('velocity="3.0"', 'velocity="0"', "'top_shoulder' must be allowed to move both ways"),
    ],
)
def test_model_that_cannot_be_used_is_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = written(tmp_path, replaced(URDF, old, new))
    with pytest.raises(ModelError, match=re.escape(str(path))) as caught:
        Robot(path)
    assert said in str(caught.value)


def test_two_models_in_one_file_are_refused(tmp_path: Path) -> None:
    sdf = '<sdf version="1.9"><world name="w">{}{}</world></sdf>'
    one = '<model name="{}"><link name="pelvis"/></model>'
    (tmp_path / "pair.sdf").write_text(sdf.format(one.format("a"), one.format("b")))
    (tmp_path / "pair.yaml").write_text(YAML)
    with pytest.raises(ModelError, match=r"pair\.sdf: Drake cannot read this model"):
        Robot(tmp_path / "pair.sdf")


def test_robot_without_a_joint_to_the_world_floats(tmp_path: Path) -> None:
    machine = Robot(written(tmp_path, replaced(URDF, PLANAR + AXIS, "")))
    assert not machine.planar and machine.dimension == 3
    assert machine.base_q.tolist() == machine.base_v.tolist() == [0, 1, 2, 3, 4, 5]
    assert len(machine.symmetries) == 3
    assert math.isclose(machine.mass, robot("three_limbed").mass)
