"""Distances in the plane: against shapely, shape by shape, and against Drake where shapes are apart."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pydrake.geometry import Box, Capsule, Cylinder, SceneGraphInspector, Sphere
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from robots import clear_configurations, configurations, every_model, kinematics, robot
from shapely.geometry.base import BaseGeometry

from climber.clearance import Clearance, inside, segment_distance
from climber.exceptions import ModelError
from climber.kinematics import Kinematics
from climber.robot import Robot
from climber.stance import Vector
from climber.wall import circle

numbers = st.one_of(
    st.floats(-1, 1, allow_subnormal=False).map(lambda x: round(x, 6)), st.sampled_from([0.0, 0.5, 1.0])
)
four_points = hnp.arrays(float, (4, 2), elements=numbers)
seeds = st.integers(0, 2**32 - 1)

# --- segments --------------------------------------------------------------------------------------------------------


@settings(max_examples=300, deadline=None)
@given(four_points)
def test_segment_distance_is_shapelys(points: Vector) -> None:
    a0, a1, b0, b1 = points
    expected = shapely.distance(shapely.LineString([a0, a1]), shapely.LineString([b0, b1]))
    assert segment_distance(a0, a1, b0, b1) == pytest.approx(expected, abs=1e-9)


@settings(max_examples=100, deadline=None)
@given(four_points)
def test_segment_distance_does_not_depend_on_order_or_direction(points: Vector) -> None:
    a0, a1, b0, b1 = points
    d = segment_distance(a0, a1, b0, b1)
    for p, q, r, s in [(b0, b1, a0, a1), (a1, a0, b0, b1), (a0, a1, b1, b0)]:
        assert segment_distance(p, q, r, s) == pytest.approx(d, abs=1e-12)


@settings(max_examples=100, deadline=None)
@given(four_points, st.floats(0.05, 0.95), st.floats(0.05, 0.95))
def test_segments_that_cross_are_at_distance_zero(points: Vector, s: float, t: float) -> None:
    a0, a1, b0, _ = points
    assume(np.linalg.norm(a1 - a0) > 1e-3 and np.linalg.norm(a0 + s * (a1 - a0) - b0) > 1e-3)
    b1 = b0 + (a0 + s * (a1 - a0) - b0) / t  # passes through a point of the first
    assert segment_distance(a0, a1, b0, b1) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("a", "b", "distance"),
    [
        ([(0, 0), (1, 0)], [(0, 1), (1, 1)], 1.0),  # parallel
        ([(0, 0), (1, 0)], [(0.5, 0), (2, 0)], 0.0),  # on one line, overlapping
        ([(0, 0), (1, 0)], [(3, 0), (2, 0)], 1.0),  # on one line, apart
        ([(0, 0), (1, 0)], [(1, 0), (1, 1)], 0.0),  # end to end
        ([(0, 0), (1, 0)], [(0.5, 0), (0.5, 1)], 0.0),  # an end on the other
        ([(0, 0), (0, 0)], [(3, 4), (3, 4)], 5.0),  # two points
        ([(0, 0), (2, 0)], [(1, 1), (1, 1)], 1.0),  # a point
        ([(0, 0), (2, 0)], [(1, 0), (1, 0)], 0.0),  # a point on it
        ([(0, 0), (1, 1)], [(0, 1), (1, 0)], 0.0),  # crossing
        ([(0, 0), (1, 0)], [(4, 4), (5, 8)], 5.0),  # ends nearest
    ],
)
def test_segment_distance_worked_by_hand(
    a: list[tuple[float, float]], b: list[tuple[float, float]], distance: float
) -> None:
    (a0, a1), (b0, b1) = np.array(a, dtype=float), np.array(b, dtype=float)
    assert segment_distance(a0, a1, b0, b1) == pytest.approx(distance, abs=1e-15)


def test_segment_distance_broadcasts() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 5, 1, 2)), rng.normal(size=(2, 7, 2))
    table = segment_distance(a[0], a[1], b[0], b[1])
    assert table.shape == (5, 7)
    assert table[3, 4] == segment_distance(a[0, 3, 0], a[1, 3, 0], b[0, 4], b[1, 4])


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_inside_is_shapelys_also_for_rings_that_are_not_convex(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 9)))
    ring = (rng.uniform(0.2, 1.0, len(angle)) * np.array([np.cos(angle), np.sin(angle)])).T[:: rng.choice([-1, 1])]
    polygon = shapely.Polygon(ring)
    assume(polygon.is_valid)
    points = rng.uniform(-1, 1, (200, 2))
    expected = shapely.contains_xy(polygon, *points.T)
    assert np.array_equal(inside(points, ring, np.roll(ring, -1, axis=0)), expected)


# --- robots ----------------------------------------------------------------------------------------------------------


class Shapes:
    """A robot's collision geometry one by one, as Drake and as shapely see it."""

    def __init__(self, machine: Robot) -> None:
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        machine.model.add_to(self.plant, self.scene_graph)
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)
        self.inspector: SceneGraphInspector = self.scene_graph.model_inspector()
        self.pairs = list(self.inspector.GetCollisionCandidates())

    def flat(self, geometry: object) -> tuple[BaseGeometry, float]:
        """A shape in the plane at the present configuration, as points within a distance of something."""
        body = self.plant.GetBodyFromFrameId(self.inspector.GetFrameId(geometry))
        X = body.EvalPoseInWorld(self.context) @ self.inspector.GetPoseInFrame(geometry)
        shape = self.inspector.GetShape(geometry)
        if isinstance(shape, Sphere):
            return shapely.Point(X.translation()[:2]), shape.radius()
        if isinstance(shape, Cylinder):  # seen end on
            assert abs(X.rotation().matrix()[2, 2]) == pytest.approx(1.0)
            return shapely.Point(X.translation()[:2]), shape.radius()
        if isinstance(shape, Capsule):
            ends = [(X @ np.array([0, 0, s * shape.length() / 2]))[:2] for s in (-1, 1)]
            return shapely.LineString(ends), shape.radius()
        assert isinstance(shape, Box)
        corners = [(X @ (np.array([x, y, 0]) * shape.size() / 2))[:2] for x in (-1, 1) for y in (-1, 1)]
        return shapely.MultiPoint(corners).convex_hull, 0.0

    def nearest(self, q: Vector, obstacles: tuple[BaseGeometry, ...] = ()) -> float:
        """Least distance at a configuration by shapely [m]; overlapping shapes count no less than -radius."""
        self.plant.SetPositions(self.context, q)
        flat = {geometry: self.flat(geometry) for geometry in {g for pair in self.pairs for g in pair}}
        result = [shapely.distance(flat[a][0], flat[b][0]) - flat[a][1] - flat[b][1] for a, b in self.pairs]
        result += [shapely.distance(shape, obstacle) - r for shape, r in flat.values() for obstacle in obstacles]
        return float(min(result))

    def by_drake(self, q: Vector) -> float:
        """Least distance at a configuration by Drake [m]."""
        self.plant.SetPositions(self.context, q)
        query = self.plant.get_geometry_query_input_port().Eval(self.context)
        return float(min(pair.distance for pair in query.ComputeSignedDistancePairwiseClosestPoints(10.0)))


@cache
def shapes(model: str) -> Shapes:
    return Shapes(robot(model))


@cache
def clearance(model: str, obstacles: tuple[BaseGeometry, ...] = ()) -> Clearance:
    return Clearance(kinematics(model), obstacles)


def agree(ours: Vector, expected: Vector) -> None:
    """Equal where nothing touches, and touching where it touches."""
    apart = expected > 1e-9
    assert ours[apart] == pytest.approx(expected[apart], abs=1e-9)
    assert (ours[~apart] <= 1e-9).all()


@every_model
@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_clearance_of_links_is_that_of_their_shapes_one_by_one(model: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = np.concatenate([configurations(model, rng, 6), clear_configurations(model, rng, 2)])
    ours = clearance(model)(kinematics(model).poses(q))
    agree(ours, np.array([shapes(model).nearest(row) for row in q]))
    assert (ours[-2:] > 0).all()


OBSTACLES = (
    circle((0.3, 0.2), 0.08),
    circle((-0.4, 0.1), 0.01),
    shapely.Polygon([(-0.2, -0.2), (0.05, -0.5), (0.2, -0.25), (0.02, -0.4)]),
    shapely.box(-0.7, 0.4, 0.7, 0.42),
)


@every_model
@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_clearance_from_obstacles_is_that_of_the_shapes_one_by_one(model: str, seed: int) -> None:
    q = clear_configurations(model, np.random.default_rng(seed), 8)
    ours = clearance(model, OBSTACLES)(kinematics(model).poses(q))
    agree(ours, np.array([shapes(model).nearest(row, OBSTACLES) for row in q]))


@every_model
def test_clearance_is_drakes_signed_distance_where_shapes_are_apart(model: str) -> None:
    q = clear_configurations(model, np.random.default_rng(1), 25)
    ours = clearance(model)(kinematics(model).poses(q))
    by_drake = np.array([shapes(model).by_drake(row) for row in q])
    # Drake's narrow phase stops a little short of the nearest points, so its distances err to the far side.
    assert (by_drake > ours - 2e-6).all() and (by_drake < ours + 2e-4).all()


@every_model
def test_clearance_is_negative_where_drake_says_that_shapes_overlap(model: str) -> None:
    q = configurations(model, np.random.default_rng(2), 60)
    ours = clearance(model)(kinematics(model).poses(q))
    overlapping = 0
    for row, distance in zip(q, ours, strict=True):
        try:
            by_drake = shapes(model).by_drake(row)
        except RuntimeError:  # FCL gives up on some coplanar shapes that overlap
            continue
        if abs(by_drake) > 1e-5:
            assert (distance > 0) == (by_drake > 0)
            overlapping += by_drake < 0
    assert overlapping >= 10


@every_model
def test_obstacle_inside_the_pelvis_is_not_clear_although_it_touches_no_outline(model: str) -> None:
    (q,) = clear_configurations(model, np.random.default_rng(3), 1)
    speck = circle(q[:2], 0.002)
    poses = kinematics(model).poses(q[None])
    assert clearance(model)(poses)[0] > 0
    assert clearance(model, (speck,))(poses)[0] <= 0
    assert shapes(model).nearest(q, (speck,)) <= 0


@every_model
def test_robot_inside_an_obstacle_is_not_clear(model: str) -> None:
    q = clear_configurations(model, np.random.default_rng(4), 5)
    assert (clearance(model, (shapely.box(-9, -9, 9, 9),))(kinematics(model).poses(q)) <= 0).all()


def test_small_link_wholly_inside_another_is_not_clear() -> None:
    # At zero the square at the end of one arm lies inside the plate at the end of the other, 9 mm from its edges.
    for elbow, distance in ((0.0, -0.0089), (0.3, None)):
        q = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, elbow]])
        (ours,) = clearance_of("plates")(Kinematics(robot_of("plates")).poses(q))
        expected = shapes_of("plates").nearest(q[0])
        assert ours == pytest.approx(expected if distance is None else distance, abs=1e-9)
        assert (expected > 0) == (distance is None)


def link(name: str, shape: str, at: str = "0 0 0", rpy: str = "0 0 0") -> str:
    collision = f'<collision><origin xyz="{at}" rpy="{rpy}"/><geometry>{shape}</geometry></collision>' if shape else ""
    return (
        f'<link name="{name}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        f"</inertial>{collision}</link>"
    )


def joint(name: str, parent: str, child: str, at: str) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>'
        '<axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>'
    )


def two_arms(left: str, right: str) -> str:
    """A robot of two arms of two links each, the last of which have shapes at their feet."""
    return (
        f'<robot name="two_arms">{link("pelvis", "")}'
        '<joint name="base" type="planar"><parent link="world"/><child link="pelvis"/><axis xyz="0 0 1"/></joint>'
        + joint("a1", "pelvis", "upper_a", "0.1 0 0")
        + link("upper_a", "")
        + joint("a2", "upper_a", "lower_a", "0.1 0 0")
        + left
        + '<frame name="foot_a" link="lower_a" xyz="0.1 0 0" rpy="0 0 0"/>'
        + joint("b1", "pelvis", "upper_b", "-0.1 0 0")
        + link("upper_b", "")
        + joint("b2", "upper_b", "lower_b", "0.1 0 0")
        + right
        + '<frame name="foot_b" link="lower_b" xyz="0.1 0 0" rpy="0 0 0"/></robot>'
    )


@cache
def robot_of(name: str) -> Robot:
    urdf = {
        "plates": two_arms(
            link("lower_a", '<box size="0.06 0.06 0.01"/>', "0.05 0 0"),
            link("lower_b", '<box size="0.02 0.02 0.01"/>', "0.2611 0.005 0"),
        ),
        "lying": two_arms(
            link("lower_a", '<cylinder radius="0.01" length="0.1"/>', "0.05 0 0", "0 1.5707963 0"),
            link("lower_b", '<cylinder radius="0.02" length="0.05"/>', "0.05 0 0", "1.5707963 0 0"),
        ),
        "bare": two_arms(link("lower_a", ""), link("lower_b", "")),
        "egg": two_arms(link("lower_a", '<ellipsoid a="0.01" b="0.02" c="0.03"/>'), link("lower_b", "")),
    }[name]
    urdf = urdf.replace("<ellipsoid", "<drake:ellipsoid").replace(
        'name="two_arms"', 'name="two_arms" xmlns:drake="drake"'
    )
    folder = Path(tempfile.mkdtemp())
    (folder / "machine.urdf").write_text(urdf)
    (folder / "machine.yaml").write_text("pelvis: pelvis\nlimbs: [{name: a, foot: foot_a}, {name: b, foot: foot_b}]\n")
    return Robot(folder / "machine.urdf")


@cache
def clearance_of(name: str, obstacles: tuple[BaseGeometry, ...] = ()) -> Clearance:
    return Clearance(Kinematics(robot_of(name)), obstacles)


@cache
def shapes_of(name: str) -> Shapes:
    return Shapes(robot_of(name))


def test_cylinder_on_its_side_counts_as_no_smaller_than_it_is() -> None:
    rng = np.random.default_rng(5)
    q = np.concatenate([rng.uniform(-1, 1, (80, 3)), rng.uniform(-3, 3, (80, 4))], axis=1)
    ours = clearance_of("lying")(Kinematics(robot_of("lying")).poses(q))
    by_drake = np.array([shapes_of("lying").by_drake(row) for row in q])
    assert (ours <= by_drake + 2e-6).all()
    assert (ours > 0).sum() > 40


def test_robot_without_collision_shapes_is_clear_of_everything() -> None:
    poses = Kinematics(robot_of("bare")).poses(np.zeros((3, 7)))
    assert np.array_equal(clearance_of("bare")(poses), np.full(3, np.inf))
    assert np.array_equal(clearance_of("bare", OBSTACLES)(poses), np.full(3, np.inf))


def test_shape_without_an_outline_is_refused() -> None:
    with pytest.raises(ModelError, match="lower_a: no planar outline is known for the collision shape Ellipsoid"):
        clearance_of("egg")


def test_toe_welded_on_does_not_collide_with_what_its_link_hangs_from() -> None:
    # Drake filters neighbours only: toe and upper link are a pair, lower and upper link are none.
    ours = clearance("three_limbed")
    names = kinematics("three_limbed").links
    pair = (names.index("top_upper"), names.index("top_lower"))
    assert pair in ours.pairs
    watched = {
        (ours.radius[a], ours.radius[b])
        for a, b in zip(ours.one, ours.two, strict=True)
        if ours.first[pair[0]] <= a < ours.first[pair[0] + 1] and ours.first[pair[1]] <= b < ours.first[pair[1] + 1]
    }
    assert watched == {(0.0, 0.006)}  # the sides of the upper link's box against the toe's sphere


def test_overlapping_boxes_of_a_link_are_one_outline() -> None:
    ours = clearance("quadruped")
    pelvis = slice(ours.first[0], ours.first[1])
    start, _ = ours.segments(0, kinematics("quadruped").poses(np.zeros((1, 11)))[0])
    assert len(ours.radius[pelvis]) == 6 and (ours.radius[pelvis] == 0).all()
    assert np.linalg.norm(start[0], axis=1) == pytest.approx(np.full(6, 0.05), abs=1e-9)


def test_neighbouring_links_are_not_watched() -> None:
    for model in ("quadruped", "long_limbed"):
        plant = robot(model).plant
        assert isinstance(plant, MultibodyPlant)
        names = kinematics(model).links
        pairs = {frozenset((names[i], names[j])) for i, j in clearance(model).pairs}
        for limb in robot(model).limbs:
            for name in limb.joints[:-1]:
                neighbours = plant.GetJointByName(name)
                assert frozenset((neighbours.parent_body().name(), neighbours.child_body().name())) not in pairs
