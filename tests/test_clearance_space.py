"""Clearance of robots in space: never more than Drake's distances, and equal to them where shapes are near."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder
from scipy.optimize import linprog

from climber.clearance import Clearance
from climber.clearance_space import NEAR, SpaceClearance, clearance_of
from climber.kinematics import Kinematics, Pose
from climber.nearest import closest, least_height, segment_to_polyhedron
from climber.placed import edges_to, solid_over
from climber.resources import resolve_model
from climber.robot import Robot
from climber.solids import Box, Convex, Cylinder, Facet, Solid, Sphere
from climber.stance import Vector
from climber.wall import Wall

LEMUR = "package://climber/lemur/lemur.urdf"
QUADRUPED = "package://climber/quadruped/quadruped.urdf"
CAPSULE = re.compile(r"<capsule [^>]*/>")
GROUND = Facet(((-2.0, -2.0, -0.1), (2.0, -2.0, -0.1), (2.0, 2.0, -0.1), (-2.0, 2.0, -0.1)))
EDGE = Facet(((0.25, -0.1, 0.0), (0.25, -0.1, 0.4), (0.25, 0.3, 0.4), (0.25, 0.3, 0.0)), 0.05)
SOLIDS: dict[str, tuple[Solid, ...]] = {
    "ground": (),
    "box": (Box((0.3, 0.3, 0.2), (0.1, 0.2, 0.3), (0.3, 0.2, 0.1)),),
    "sphere": (Sphere((-0.3, 0.2, 0.1), 0.08), Sphere((0.1, 0.0, 0.3), 0.01)),
    "convex": (Convex(((0.3, -0.3, 0.0), (0.4, -0.3, 0.0), (0.3, -0.4, 0.1), (0.35, -0.35, 0.3))),),
    "cylinder": (Cylinder((0.0, -0.3, 0.1), (0.6, 0.0, 0.8), 0.05, 0.3),),
}


@cache
def lemur() -> Kinematics:
    return Kinematics(Robot(LEMUR))


@cache
def motley(folder: Path) -> Kinematics:
    """The same robot with fingers of all shapes: a box, a cylinder, a ball with a box fixed to it, and a capsule."""
    path = resolve_model(LEMUR)
    text = path.read_text()
    for limb, shape in (
        ("right_front", '<box size="0.03 0.02 0.12"/>'),
        ("left_front", '<cylinder radius="0.015" length="0.12"/>'),
        ("left_rear", '<sphere radius="0.04"/>'),
    ):
        start = text.index(f'<collision name="{limb}_finger')
        text = text[:start] + CAPSULE.sub(shape, text[start:], count=1)
    (folder / "motley.urdf").write_text(text)
    (folder / "motley.yaml").write_text(path.with_suffix(".yaml").read_text())
    return Kinematics(Robot(folder / "motley.urdf"))


def configurations(kinematics: Kinematics, rng: np.random.Generator, count: int) -> Vector:
    robot = kinematics.robot
    q = np.zeros((count, robot.plant.num_positions()))
    q[:, robot.angle_q] = rng.uniform(-0.6, 0.6, (count, 3))
    q[:, robot.origin_q] = rng.uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 0.3], (count, 3))
    q[:, kinematics.joint_q] = rng.uniform(kinematics.lower, kinematics.upper, (count, len(kinematics.lower)))
    return q


def drake_distances(kinematics: Kinematics, wall: Wall, q: Vector, most: float = 0.1) -> Vector:
    """Least distances by Drake's scene graph, at most `most` [m]."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    kinematics.robot.model.add_to(plant, scene_graph)
    for i, solid in enumerate(wall.rock):
        shape, pose = solid.drake()
        plant.RegisterCollisionGeometry(plant.world_body(), pose, shape, f"rock {i}", CoulombFriction(1.0, 1.0))
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    own = plant.GetMyContextFromRoot(context)
    result = np.full(len(q), most)
    for k, positions in enumerate(q):
        plant.SetPositions(own, positions)
        query = SceneGraph.get_query_output_port(scene_graph).Eval(scene_graph.GetMyContextFromRoot(context))
        found = [pair.distance for pair in query.ComputeSignedDistancePairwiseClosestPoints(most)]
        result[k] = min(found, default=most)
    return result


def compare(kinematics: Kinematics, wall: Wall, q: Vector) -> None:
    """Drake iterates for capsules and meshes, and what comes out may be 0.7 mm too large."""
    here, there = SpaceClearance(kinematics, wall)(kinematics.poses(q)), drake_distances(kinematics, wall, q)
    apart = there > 0.0
    assert (here[apart & (there < 0.1)] <= there[apart & (there < 0.1)] + 1e-8).all()
    assert (here[~apart] <= 1e-9).all()
    near = apart & (here < NEAR)
    np.testing.assert_allclose(here[near], there[near], atol=1e-3)


@pytest.mark.parametrize("kind", SOLIDS)
@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
@example(seed=10088072)  # the cylinder goes right through the pelvis
def test_clearance_is_drake_s_where_near_and_never_more(kind: str, seed: int) -> None:
    wall = Wall((), solids=SOLIDS[kind], facets=(GROUND, EDGE))
    q = configurations(lemur(), np.random.default_rng(seed), 150)
    # A cylinder counts as a prism about it, up to half a per cent of its radius larger.
    compare(lemur(), wall, q)


def test_links_may_be_of_any_shape(tmp_path: Path) -> None:
    kinematics = motley(tmp_path)
    wall = Wall((), solids=(*SOLIDS["box"], *SOLIDS["sphere"]), facets=(GROUND,))
    compare(kinematics, wall, configurations(kinematics, np.random.default_rng(0), 400))


def test_a_small_ball_inside_the_pelvis_is_met() -> None:
    wall = Wall((), solids=(Sphere((0.0, 0.0, 0.3), 0.001), Box((0.0, 0.0, 0.9), (0.001, 0.001, 0.001))))
    q = np.zeros((3, 18))
    q[:, lemur().robot.origin_q] = [[0.0, 0.0, 0.3], [0.0, 0.0, 0.9], [0.0, 0.0, 0.6]]
    here = SpaceClearance(lemur(), wall)(lemur().poses(q))
    assert (here[:2] <= 0.0).all()
    assert here[2] > 0.0


def test_a_pole_right_through_the_pelvis_is_met() -> None:
    """Its corners are on either side of the pelvis, and no edge of the pelvis is near it."""
    pole = Cylinder((0.0, 0.0, 0.3), (0.0, 0.0, 1.0), 0.01, 1.0)
    q = np.zeros((2, 18))
    q[:, lemur().robot.origin_q] = [[0.0, 0.0, 0.3], [0.5, 0.0, 0.3]]
    clearance = SpaceClearance(lemur(), Wall((), solids=(pole,)))
    here = clearance(lemur().poses(q))
    assert here[0] <= 0.0 < here[1]
    near = clearance.near(lemur().poses(q[:1]), 0.01)
    through = near.distance <= 0.0
    np.testing.assert_allclose(near.points[through, 0], near.points[through, 1], atol=1e-9)
    assert np.linalg.norm(near.points[through, 0, :2], axis=1).max() < 0.011


def test_an_obstacle_of_the_plane_reaches_through_all_z() -> None:
    hole = shapely.Point(0.0, 0.0).buffer(0.01)
    wall, robot = Wall((), (hole,)), lemur().robot
    rng = np.random.default_rng(1)
    q = configurations(lemur(), rng, 200)
    poses = lemur().poses(q)
    here, alone = SpaceClearance(lemur(), wall).least(poses), SpaceClearance(lemur(), Wall(()))
    pairs = len(alone.pairs)
    np.testing.assert_array_equal(here[:, :pairs], alone.least(poses)[:, :pairs])
    # The pelvis is a hexagonal prism: its projection holds that of the disk of its inner radius, upright.
    q[:, robot.angle_q] = 0.0
    q[:, robot.origin_q] = rng.uniform([-0.15, -0.15, -5.0], [0.15, 0.15, 5.0], (200, 3))
    here = SpaceClearance(lemur(), wall).least(lemur().poses(q))[:, pairs]
    away = np.linalg.norm(q[:, robot.origin_q[:2]], axis=1)
    assert (here[away < 0.0779 + 0.0099] <= 0.0).all()
    assert (here[away > 0.09 + 0.0101] > 0.0).all()
    assert (here <= away - 0.0779 - 0.0099 + 1e-9).all() or (here[away > 0.2] > 0.0).all()


def test_what_is_near_adds_up_to_the_least_and_its_points_are_that_far_apart() -> None:
    wall = Wall((), tuple(c.outline() for c in SOLIDS["sphere"][:1]), solids=SOLIDS["box"], facets=(GROUND,))
    clearance = SpaceClearance(lemur(), wall)
    poses = lemur().poses(configurations(lemur(), np.random.default_rng(2), 150))
    near, least = clearance.near(poses, NEAR), clearance.least(poses)
    again = np.full(least.shape, np.inf)
    np.minimum.at(again, (near.place, near.kind), near.distance)
    np.testing.assert_allclose(again[least < NEAR], least[least < NEAR], atol=1e-12)
    assert np.isinf(again[least >= NEAR]).all()
    np.testing.assert_array_equal(clearance(poses), least.min(axis=1))
    gap = np.linalg.norm(near.points[:, 0] - near.points[:, 1], axis=1)
    thick = gap - near.distance  # how thick the two shapes are together
    assert (thick > -1e-9).all()
    assert (thick < 0.03).all()
    pair = near.links[:, 1] >= 0
    for kind, links in zip(near.kind[pair], near.links[pair], strict=True):
        assert clearance.pairs[kind] == tuple(sorted(links.tolist()))
    np.testing.assert_array_equal(near.kind[~pair], len(clearance.pairs) + near.links[~pair, 0])


def test_closest_points_move_apart_as_the_distance_grows() -> None:
    wall = Wall((), solids=SOLIDS["box"], facets=(GROUND,))
    clearance = SpaceClearance(lemur(), wall)
    rng = np.random.default_rng(3)
    q = configurations(lemur(), rng, 60)
    step = 1e-6 * rng.normal(size=q.shape)
    one, two = lemur().poses(q), lemur().poses(q + step)
    near, after = clearance.near(one, NEAR), clearance.least(two)
    apart = near.points[:, 0] - near.points[:, 1]
    apart /= np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-12)

    def moved(link: Vector, point: Vector, place: Vector) -> Vector:
        if link < 0:
            return point
        a, b = one[int(link)], two[int(link)]
        local = a.rotation[int(place)].T @ (point - a.origin[int(place)])
        return np.asarray(b.rotation[int(place)] @ local + b.origin[int(place)])

    least = clearance.least(one)
    for place, kind, distance, links, points, normal in zip(
        near.place, near.kind, near.distance, near.links, near.points, apart, strict=True
    ):
        if distance < 1e-3 or distance > least[place, kind]:
            continue
        shift = [moved(link, point, place) - point for link, point in zip(links, points, strict=True)]
        assert after[place, kind] - distance == pytest.approx(float(normal @ (shift[0] - shift[1])), abs=2e-9)


def test_planar_robots_keep_their_clearance_in_the_plane() -> None:
    assert isinstance(clearance_of(Kinematics(Robot(QUADRUPED)), Wall(())), Clearance)
    assert isinstance(clearance_of(lemur(), Wall(())), SpaceClearance)


def test_a_hexagon_of_three_boxes_is_one_polyhedron() -> None:
    assert len(SpaceClearance(lemur(), Wall(()))._hulls) == 1


# Segments and polyhedra


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_segments_are_nowhere_closer_than_where_they_are_closest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a0, a1, b0, b1 = rng.normal(size=(4, 50, 3))
    a1[:5] = a0[:5]  # points
    b1[5:10] = b0[5:10] + (a1 - a0)[5:10]  # parallel
    s, t, squared = closest(a0, a1, b0, b1)
    on_a, on_b = a0 + s[:, None] * (a1 - a0), b0 + t[:, None] * (b1 - b0)
    np.testing.assert_allclose(((on_a - on_b) ** 2).sum(axis=1), squared, atol=1e-12)
    parts = np.linspace(0.0, 1.0, 41)
    grid_a = a0[:, None] + parts[:, None] * (a1 - a0)[:, None]
    grid_b = b0[:, None] + parts[:, None] * (b1 - b0)[:, None]
    every = ((grid_a[:, :, None] - grid_b[:, None]) ** 2).sum(axis=3).min(axis=(1, 2))
    assert (squared <= every + 1e-12).all()
    assert (((s >= 0.0) & (s <= 1.0)) & ((t >= 0.0) & (t <= 1.0))).all()


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_segments_are_as_far_from_a_polyhedron_as_the_nearest_of_their_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = Convex(tuple(map(tuple, rng.uniform(-0.5, 0.5, (8, 3))))).polyhedron
    a0, a1 = rng.uniform(-1.5, 1.5, (2, 30, 3))
    distance, part, point = segment_to_polyhedron(shape, a0, a1)
    parts = np.linspace(0.0, 1.0, 501)
    sampled = shape.distance(a0[:, None] + parts[:, None] * (a1 - a0)[:, None]).min(axis=1)
    assert (distance <= sampled + 1e-9).all()
    np.testing.assert_allclose(distance, sampled, atol=5e-3)
    on_segment = a0 + part[:, None] * (a1 - a0)
    np.testing.assert_allclose(np.linalg.norm(on_segment - point, axis=1), distance, atol=1e-9)
    np.testing.assert_allclose(shape.distance(point), 0.0, atol=1e-8)
    bound, exact = least_height(shape, a0, a1)
    assert (bound <= distance + 1e-9).all()
    np.testing.assert_allclose(bound[exact], distance[exact], atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_polyhedra_meet_where_a_linear_program_finds_a_point_in_both(seed: int) -> None:
    rng = np.random.default_rng(seed)
    flat = Box((0.0, 0.0, 0.0), tuple(rng.uniform(0.05, 0.5, 3))).polyhedron
    for _ in range(20):
        thin = Box(tuple(rng.uniform(-0.3, 0.3, 3)), tuple(rng.uniform(0.02, 0.6, 3)), tuple(rng.uniform(-3.0, 3.0, 3)))
        other = thin.polyhedron
        ends = other.corners[other.edges]
        gap, lower, upper = solid_over(flat, other.corners[None], other.edges)
        turned, on_other, on_flat = edges_to(other, *np.swapaxes(flat.corners[flat.edges], 0, 1)[:, None])
        between, _, _ = edges_to(flat, *np.swapaxes(ends, 0, 1)[:, None])  # knows edges, not its own corners over faces
        distance = min(gap[0], turned[0])
        assert distance <= between[0] + 1e-9
        for least, one, two in ((gap, lower, upper), (turned, on_other, on_flat)):
            assert np.isinf(least[0]) or np.linalg.norm(one - two) == pytest.approx(least[0], abs=1e-9)
        # The greatest depth at which a point is inside both.
        rows = np.vstack([flat.normals, other.normals])
        best = linprog(
            [0.0, 0.0, 0.0, -1.0],
            np.column_stack([rows, np.ones(len(rows))]),
            np.concatenate([flat.heights, other.heights]),
            bounds=[(None, None)] * 4,
        )
        assert (distance == 0.0) == (-best.fun >= 0.0) or abs(best.fun) < 1e-9


def test_poses_of_single_configurations_will_do() -> None:
    clearance = SpaceClearance(lemur(), Wall((), facets=(GROUND,)))
    poses = lemur().poses(configurations(lemur(), np.random.default_rng(4), 30))
    every = clearance(poses)
    for k in range(30):
        alone = [Pose(pose.rotation[k : k + 1], pose.origin[k : k + 1]) for pose in poses]
        assert clearance(alone)[0] == pytest.approx(every[k], abs=1e-12)
