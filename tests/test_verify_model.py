"""verify's own mechanics and clearances against Drake's plant and against plane geometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from plans import QUADRUPED
from plans_space import LEMUR
from shapely.geometry import LineString, Point, Polygon, box

from climber.exceptions import ModelError
from climber.robot import Model, Robot
from climber.stance import Vector
from climber.verify_clearance import Outlines
from climber.verify_model import DrakeModel, Tree
from climber.verify_motion import Motion, drift
from climber.verify_scene import FAR, NUDGES, OVERLAP, DrakeClearance, convex_pieces

# A robot with nothing in its place: welded links, skew frames, masses off their frames, geared and
# damped joints, three joints in one limb and one in the other.
ODD = """\
<robot name="odd" xmlns:drake="drake.mit.edu">
  <link name="body"><inertial><origin xyz="0.02 -0.03 0.01" rpy="0.1 0.2 0.3"/><mass value="1.5"/>
    <inertia ixx="0.003" iyy="0.004" izz="0.005" ixy="0.0002" ixz="0" iyz="0.0001"/></inertial></link>
  BASE
  LINKS
</robot>
"""
PLANAR = '<joint name="base" type="planar"><parent link="world"/><child link="body"/><axis xyz="0 0 1"/></joint>'


def odd_robot(folder: Path, floating: bool = False) -> Robot:
    links = []
    actuators = []
    chains = {"left": ["a1", "a2", "a3"], "right": ["b1"]}
    for limb, names in chains.items():
        parent = "body"
        for i, name in enumerate(names):
            links.append(
                f"""<link name="{name}"><inertial><origin xyz="0.05 0.01 {0.01 * i}" rpy="0 0 0.2"/>
                <mass value="0.{2 + i}"/>
                <inertia ixx="0.0002" iyy="0.0003" izz="0.0004" ixy="0.00002" ixz="0" iyz="0"/></inertial></link>
                <joint name="{name}_joint" type="revolute"><parent link="{parent}"/><child link="{name}"/>
                <origin xyz="0.1 {0.02 * i} 0" rpy="{0.3 * i} 0 {0.5 - i}"/><axis xyz="0 {0.2 * i} 1"/>
                <limit lower="-2" upper="2" velocity="3" effort="5"/><dynamics damping="0.{i + 1}"/></joint>"""
            )
            actuators.append(
                f"""<transmission><type>transmission_interface/SimpleTransmission</type><joint name="{name}_joint"/>
                <actuator name="{name}_motor"><drake:rotor_inertia value="0.00001"/>
                <drake:gear_ratio value="{50 + i}"/></actuator></transmission>"""
            )
            parent = name
        links.append(
            f"""<link name="{limb}_toe"><inertial><origin xyz="0.01 0 0"/><mass value="0.05"/>
            <inertia ixx="0.00002" iyy="0.00003" izz="0.00004" ixy="0" ixz="0" iyz="0"/></inertial></link>
            <joint name="{limb}_weld" type="fixed"><parent link="{parent}"/><child link="{limb}_toe"/>
            <origin xyz="0.1 0 0.01" rpy="0.1 0.2 0.3"/></joint>
            <frame name="{limb}_foot" link="{limb}_toe" xyz="0.02 0.01 0" rpy="0 0 1"/>"""
        )
    path = folder / "odd.urdf"
    path.write_text(ODD.replace("LINKS", "\n".join(links + actuators)).replace("BASE", "" if floating else PLANAR))
    feet = "".join(f"- {{name: {limb}, foot: {limb}_foot}}\n" for limb in chains)
    path.with_suffix(".yaml").write_text(f"pelvis: body\nlimbs:\n{feet}")
    return Robot(Model.load(path), gravity=(0.0, -8.0, -3.0))


def robot_of(which: str, folder: Path) -> Robot:
    if which.startswith("odd"):
        return odd_robot(folder, floating=which == "odd floating")
    return Robot(Model.load(f"package://climber/{which}/{which}.urdf"), (1.0, -9.0, -2.0))


@pytest.mark.parametrize("which", ["quadruped", "odd", "odd floating", "lemur"])
def test_mechanics_agree_with_drake(which: str, tmp_path: Path) -> None:
    robot = robot_of(which, tmp_path)
    tree, drake, rng = Tree(robot), DrakeModel(robot), np.random.default_rng(0)
    size, count = robot.plant.num_positions(), 50
    q, v, vd = rng.normal(size=(3, count, size))
    force = 10.0 * rng.normal(size=(count, len(robot.limbs), 3))
    moment = rng.normal(size=(count, len(robot.limbs)))
    poses = tree.poses(q)
    ours = tree.feet(poses), tree.center_of_mass(poses), tree.required_force(poses, v, vd, force, moment)
    rates, _ = tree.rates(q, v, vd)
    context = robot.context()
    for k in range(count):
        for a, b in zip((*ours, rates), drake.at(q[k], v[k], vd[k], force[k], moment[k]), strict=True):
            np.testing.assert_allclose(a[k], b, atol=1e-11, rtol=1e-10)
        robot.plant.SetPositions(context, q[k])
        pelvis = robot.pelvis.EvalPoseInWorld(context).translation()
        np.testing.assert_allclose(tree.pelvis(poses)[k], pelvis, atol=1e-12)


@pytest.mark.parametrize("which", ["quadruped", "odd floating", "lemur"])
def test_rates_of_positions_are_those_that_the_velocities_were_made_from(which: str, tmp_path: Path) -> None:
    """The robot turns rates of positions into velocities and accelerations, and verify turns these back."""
    robot, rng = robot_of(which, tmp_path), np.random.default_rng(1)
    q, first, second = rng.uniform(-1.2, 1.2, (3, 50, robot.plant.num_positions()))
    found = Tree(robot).rates(q, robot.v_of(q, first), robot.vd_of(q, first, second))
    for rates, expected in zip(found, (first, second), strict=True):
        np.testing.assert_allclose(rates, expected, atol=1e-12)


def test_a_contact_force_enters_through_the_transposed_jacobian() -> None:
    """Lifting one foot by its weight's worth changes the required force by -J^T f, J by finite differences."""
    robot = Robot(Model.load(QUADRUPED))
    tree, rng = Tree(robot), np.random.default_rng(3)
    q, force = rng.uniform(-1.0, 1.0, (1, 11)), np.zeros((1, 4, 3))
    force[0, 2] = [3.0, 5.0, 0.0]
    still = np.zeros((1, 11))
    poses = tree.poses(q)
    change = tree.required_force(poses, still, still, force) - tree.required_force(poses, still, still, 0.0 * force)
    step = 1e-6 * np.eye(11)
    J = (tree.feet(tree.poses(q + step))[:, 2] - tree.feet(tree.poses(q - step))[:, 2]) / 2e-6
    np.testing.assert_allclose(change[0], -J @ force[0, 2], atol=1e-8)


@pytest.mark.parametrize("model", [QUADRUPED, LEMUR])
def test_unit_forces_on_feet_need_what_they_change(model: str) -> None:
    tree, rng = Tree(Robot(Model.load(model))), np.random.default_rng(4)
    size = Robot(Model.load(model)).plant.num_velocities()
    poses, still, none = tree.poses(rng.uniform(-1.0, 1.0, (5, size))), np.zeros((5, size)), np.zeros((5, 4, 3))
    needed = tree.required_of_feet(poses, [3, 1])
    for place, foot in enumerate([3, 1]):
        for axis in range(3):
            force = none.copy()
            force[:, foot, axis] = 1.0
            change = tree.required_force(poses, still, still, force) - tree.required_force(poses, still, still, none)
            np.testing.assert_allclose(needed[:, place, :, axis], change, atol=1e-12)


def test_a_base_that_is_not_planar_is_refused(tmp_path: Path) -> None:
    source = Model.load(QUADRUPED).path
    (tmp_path / "rail.urdf").write_text(source.read_text().replace('type="planar"', 'type="prismatic"', 1))
    (tmp_path / "rail.yaml").write_text(source.with_suffix(".yaml").read_text())
    with pytest.raises(ModelError, match="prismatic"):
        Tree(Robot(Model.load(tmp_path / "rail.urdf")))


def flat(robot: Robot, q: Vector) -> dict[str, shapely.Geometry]:
    """The quadruped's links as shapes of the wall plane: segments for the limbs' capsules, a hexagon for the pelvis."""
    context = robot.context()
    robot.plant.SetPositions(context, q)
    shapes: dict[str, shapely.Geometry] = {}
    for limb in robot.limb_names:
        for part in ("thigh", "shank"):
            X_WB = robot.plant.GetBodyByName(f"{limb}_{part}").EvalPoseInWorld(context)
            ends = [X_WB.multiply(np.array([x, 0.0, 0.0]))[:2] for x in (0.006, 0.094)]
            shapes[f"{limb}_{part}"] = LineString(ends)
    X_WP = robot.pelvis.EvalPoseInWorld(context)
    corners = [0.05 * np.array([np.cos(a), np.sin(a), 0.0]) for a in np.radians(np.arange(0, 360, 60))]
    shapes["pelvis"] = Polygon([X_WP.multiply(corner)[:2] for corner in corners])
    return shapes


ROBOT = Robot(Model.load(QUADRUPED))
OBSTACLES = [
    ("obstacle 0", Point(0.15, 0.1).buffer(0.03)),
    ("obstacle 1", Polygon([(-0.3, -0.1), (-0.1, -0.1), (-0.1, 0.1), (-0.2, -0.05)])),
]


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), symmetric=st.booleans())
def test_outlines_are_measured_exactly_and_drake_does_not_say_less(seed: int, symmetric: bool) -> None:
    """Against capsules and a hexagon in the plane, in mirror-symmetric postures too."""
    rng = np.random.default_rng(seed)
    q = np.concatenate([[0.0, 0.0, 0.0], rng.uniform(-2.0, 2.0, 8)])
    if symmetric:
        q[5:7], q[9:11] = -q[3:5], -q[7:9]
    shapes, radius = flat(ROBOT, q), 0.006
    own = {
        frozenset((a, b)): shapes[a].distance(shapes[b]) - radius * (1 if "pelvis" in (a, b) else 2)
        for a in shapes
        for b in shapes
        if a < b and not (a.rsplit("_", 1)[0] == b.rsplit("_", 1)[0] or ("pelvis" in (a, b) and "thigh" in a + b))
    }
    outside = {
        frozenset((name, obstacle)): shape.distance(outline) - radius * (name != "pelvis")
        for name, shape in shapes.items()
        for obstacle, outline in OBSTACLES
    }
    measured = Outlines(ROBOT, OBSTACLES).measure(Tree(ROBOT).poses(q[None]))
    by_drake = DrakeClearance(ROBOT, OBSTACLES).nearest(q)
    for found, expected, (drake, _) in zip(measured, (own, outside), by_drake, strict=True):
        named: dict[frozenset[str], float] = {}
        for pair, value in zip(found.pairs, found.values[0], strict=True):
            key = frozenset(pair.split(" and "))
            named[key] = min(value, named.get(key, FAR))
        assert set(named) == set(expected)
        for key, value in named.items():
            # Nothing tells how deep a pelvis is in an obstacle: neither has any thickness.
            shallow = -OVERLAP if expected[key] == 0.0 else expected[key]
            assert value == pytest.approx(min(shallow, FAR), abs=1e-9)
        least = min(named.values())
        if least in (-OVERLAP, -radius, -2 * radius):  # or more: where shapes' cores cross, outlines do not measure
            assert drake < least + 1e-3
        else:
            assert least - 1e-6 < drake < least + 1e-3


SHAPES = """\
<robot name="shapes">
  <link name="body">INERTIA
    <collision><origin xyz="0.02 0 0.1" rpy="0.3 0 0.5"/><geometry><box size="0.1 0.06 0.04"/></geometry></collision>
  </link>
  <joint name="base" type="planar"><parent link="world"/><child link="body"/><axis xyz="0 0 1"/></joint>
  <link name="rod">INERTIA
    <collision><origin xyz="0.1 0 0.1" rpy="0 1.5708 0"/>
      <geometry><cylinder radius="0.01" length="0.12"/></geometry></collision>
  </link>
  <joint name="hip" type="revolute"><parent link="body"/><child link="rod"/><axis xyz="0 0 1"/>
    <origin xyz="0.08 0 0" rpy="0 0 0"/><limit lower="-3" upper="3" velocity="3" effort="5"/></joint>
  <link name="disk">INERTIA
    <collision><origin xyz="0.05 0 0.1"/><geometry><cylinder radius="0.03" length="0.05"/></geometry></collision></link>
  <joint name="knee" type="revolute"><parent link="rod"/><child link="disk"/><axis xyz="0 0 1"/>
    <origin xyz="0.2 0 0" rpy="0 0 0"/><limit lower="-3" upper="3" velocity="3" effort="5"/></joint>
  <link name="ball">INERTIA
    <collision><origin xyz="0.05 0 HEIGHT"/><geometry><sphere radius="0.02"/></geometry></collision></link>
  <joint name="ankle" type="revolute"><parent link="disk"/><child link="ball"/><axis xyz="0 0 1"/>
    <origin xyz="0.1 0 0" rpy="0 0 0"/><limit lower="-3" upper="3" velocity="3" effort="5"/></joint>
  <frame name="foot" link="ball" xyz="0.1 0 0" rpy="0 0 0"/>
</robot>
"""
INERTIA = (
    """<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>"""
)


def shapes_robot(folder: Path, height: float) -> Robot:
    path = folder / "shapes.urdf"
    path.write_text(SHAPES.replace("INERTIA", INERTIA).replace("HEIGHT", str(height)))
    path.with_suffix(".yaml").write_text("pelvis: body\nlimbs: [{name: arm, foot: foot}]\n")
    return Robot(Model.load(path))


def test_outlines_of_all_kinds_of_shapes_are_those_that_drake_measures(tmp_path: Path) -> None:
    robot = shapes_robot(tmp_path, 0.1)
    outlines, drake, tree = Outlines(robot, OBSTACLES), DrakeClearance(robot, OBSTACLES), Tree(robot)
    rng, near = np.random.default_rng(5), 0
    for q in rng.uniform(-3.0, 3.0, (400, 6)) * [0.1, 0.1, 1, 1, 1, 1]:
        for found, (distance, _) in zip(outlines.measure(tree.poses(q[None])), drake.nearest(q), strict=True):
            least = found.values.min()
            if least > 0.0:
                # A round rod and a tilted box in space can be a little farther apart than their outlines.
                assert -2e-4 < distance - least < 2e-3
                near += least < FAR
            else:
                assert distance < 2e-3
    assert near > 30


def test_parts_that_pass_above_each_other_do_not_touch(tmp_path: Path) -> None:
    for height, can_touch in ((0.1, True), (0.2, False)):
        robot = shapes_robot(tmp_path, height)
        found, _ = Outlines(robot, []).measure(Tree(robot).poses(np.zeros((1, 6))))
        assert any("ball" in pair for pair in found.pairs) is can_touch


def test_a_robot_whose_limbs_leave_the_plane_is_not_planar(tmp_path: Path) -> None:
    assert not Tree(odd_robot(tmp_path)).is_planar()
    assert Tree(ROBOT).is_planar()


@pytest.mark.parametrize(("times", "expected"), [(2, FAR), (len(NUDGES), np.nan)])
def test_where_drake_gives_up_a_posture_is_measured_beside_it(
    monkeypatch: pytest.MonkeyPatch, times: int, expected: float
) -> None:
    clearance, tried = DrakeClearance(ROBOT, []), []

    def fails(q: Vector) -> list[object]:
        """Throws as FCL does, until it has been asked often enough."""
        tried.append(q)
        if len(tried) <= times:
            raise RuntimeError("FCL: the origin is outside of the polytope")
        return []

    monkeypatch.setattr(clearance._scene, "distances", fails)
    (own, _), (outside, _) = clearance.nearest(np.zeros(11))
    np.testing.assert_equal([own, outside], [expected, expected])
    assert max(np.abs(q).max() for q in tried) < 1e-6


def test_regions_are_cut_into_convex_pieces_that_cover_them_exactly() -> None:
    ring = box(0, 0, 4, 4).difference(box(1, 1, 2, 2))
    ell = Polygon([(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)])
    for region in (ring, ell, box(0, 0, 1, 1), shapely.MultiPolygon([box(0, 0, 1, 1), box(2, 0, 3, 2)]), Polygon()):
        pieces = [Polygon(corners) for corners in convex_pieces(region)]
        assert all(piece.convex_hull.equals(piece) for piece in pieces)
        assert sum(piece.area for piece in pieces) == pytest.approx(region.area)
        assert shapely.union_all(pieces).symmetric_difference(region).area < 1e-12
    assert len(convex_pieces(box(0, 0, 1, 1))) == 1


def motion(time: Vector, q: Vector, v: Vector, vd: Vector) -> Motion:
    """A motion of one coordinate."""
    column, nothing = (lambda x: x[:, None]), np.zeros((len(time), 1))
    sampled = np.ones(len(time), bool)
    return Motion(time, column(q), column(v), column(vd), nothing, nothing[:, :, None], nothing, sampled)


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_smooth_and_kinked_motions_pass_as_their_own_derivatives_and_one_wrong_sample_does_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 1.0, 101)
    # A few sines of up to 5 Hz, and an acceleration with a kink anywhere but in the first and last steps.
    w, amplitude, phase = rng.uniform(1.0, 30.0, 3), rng.normal(size=3), rng.uniform(0.0, 6.0, 3)
    angle = np.outer(time, w) + phase
    q = (amplitude * np.sin(angle)).sum(axis=1)
    v = (amplitude * w * np.cos(angle)).sum(axis=1)
    vd = (-amplitude * w**2 * np.sin(angle)).sum(axis=1)
    late = np.maximum(time - rng.uniform(0.02, 0.98), 0.0)
    jerk = 100.0 * rng.normal()
    q, v, vd = q + jerk * late**3 / 6, v + jerk * late**2 / 2, vd + jerk * late
    position, velocity = drift(motion(time, q, v, vd))
    assert max(position.max(), velocity.max()) <= 1.0
    row, scale = int(rng.integers(0, 101)), float(rng.choice([-1.0, 1.0]))
    bend = np.abs(np.diff(vd, 2)).max()
    wrong = vd.copy()
    wrong[row] += scale * (0.1 + 20.0 * bend)
    assert drift(motion(time, q, v, wrong))[1].max() > 1.0
    wrong = v.copy()
    wrong[row] += scale * (1e-4 + 0.02 * bend)
    assert drift(motion(time, q, wrong, vd))[1].max() > 1.0
    wrong = q.copy()
    wrong[row] += scale * (1e-5 + 1e-4 * bend)
    assert drift(motion(time, wrong, v, vd))[0].max() > 1.0


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_motions_that_meet_in_a_standstill_are_judged_each_by_itself_whatever_their_steps(seed: int) -> None:
    """As shifts on one stance are, that are one phase of the plan."""
    rng = np.random.default_rng(seed)
    series: list[Vector] = []
    errors: list[tuple[Vector, Vector]] = []
    begin = np.zeros(2)
    for far in (rng.normal(), 0.0, rng.normal()):
        u, lasts = np.linspace(0.0, 1.0, int(rng.integers(10, 80))), 10.0 ** rng.uniform(-2.0, 1.0)
        q = far * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        v = far * 30.0 * u**2 * (1.0 - u) ** 2 / lasts
        vd = far * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / lasts**2
        part = np.array([begin[0] + lasts * u, begin[1] + q, v, vd])
        errors.append(drift(motion(*part)))
        series.append(part if not series else part[:, 1:])
        begin = part[:2, -1]
    together = drift(motion(*np.concatenate(series, axis=1)))
    for whole, *parts in zip(together, *errors, strict=True):
        np.testing.assert_allclose(whole, np.concatenate(parts), rtol=1e-6, atol=1e-6)


def test_two_samples_make_a_phase() -> None:
    still = np.zeros(2)
    for part in drift(motion(np.array([0.0, 0.01]), still, still, still)):
        assert part.shape == (1, 1) and part.max() == 0.0
