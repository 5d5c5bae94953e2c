"""Solids of the wall: distances against Drake's, and what stands for them contains them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import SceneGraph
from pydrake.geometry import Sphere as DrakeSphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry import Point

from climber.polyhedron import Polyhedron
from climber.solids import Box, Convex, Cylinder, Facet, Solid, Sphere, away, newell, triple
from climber.stance import Contact, Vector
from climber.wall import Hold, Wall

TINY = 1e-5  # [m] radius of the ball that stands for a point in Drake


def random_solid(kind: str, rng: np.random.Generator) -> Solid:
    center = triple(rng.uniform(-0.3, 0.3, 3))
    if kind == "sphere":
        return Sphere(center, float(rng.uniform(0.05, 0.4)))
    if kind == "box":
        return Box(center, triple(rng.uniform(0.05, 0.6, 3)), triple(rng.uniform(-3.0, 3.0, 3)))
    axis = rng.normal(size=3)
    if kind == "cylinder":
        return Cylinder(center, triple(axis / np.linalg.norm(axis)), *rng.uniform(0.05, 0.5, 2))
    return Convex(tuple(triple(p) for p in rng.uniform(-0.4, 0.4, (int(rng.integers(4, 12)), 3))))


def drake_distance(solid: Solid, points: Vector) -> Vector:
    """Drake's distances, by a tiny ball in place of each point."""
    builder = DiagramBuilder()
    scene_graph = builder.AddSystem(SceneGraph())
    plant = builder.AddSystem(MultibodyPlant(0.0))
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    builder.Connect(scene_graph.get_query_output_port(), plant.get_geometry_query_input_port())
    builder.Connect(plant.get_geometry_pose_output_port(), scene_graph.get_source_pose_port(plant.get_source_id()))
    friction = CoulombFriction(1.0, 1.0)
    shape, pose = solid.drake()
    fixed = plant.RegisterCollisionGeometry(plant.world_body(), pose, shape, "solid", friction)
    model = plant.AddModelInstance("probe")
    probe = plant.AddRigidBody("probe", model, SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    moving = plant.RegisterCollisionGeometry(probe, RigidTransform(), DrakeSphere(TINY), "probe", friction)
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    own = plant.GetMyContextFromRoot(context)
    result = []
    for point in points:
        plant.SetFreeBodyPose(own, probe, RigidTransform(point))
        query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
        result.append(query.ComputeSignedDistancePairClosestPoints(fixed, moving).distance + TINY)
    return np.maximum(np.array(result), 0.0)


@pytest.mark.parametrize("kind", ["sphere", "box", "cylinder", "convex"])
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_distances_are_those_of_drake(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid, points = random_solid(kind, rng), rng.uniform(-0.9, 0.9, (40, 3))
    np.testing.assert_allclose(solid.distance(points), drake_distance(solid, points), atol=2e-5)
    np.testing.assert_allclose(solid.distance(points.reshape(4, 10, 3)).ravel(), solid.distance(points))


@pytest.mark.parametrize("kind", ["sphere", "box", "cylinder", "convex"])
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_outlines_extremes_and_polyhedra_contain_the_solid(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = random_solid(kind, rng)
    points = rng.uniform(-0.9, 0.9, (2000, 3))
    inner = points[solid.distance(points) == 0.0]
    assert all(solid.outline().buffer(1e-9).contains(Point(p)) for p in inner[:, :2])
    assert (inner >= solid.extremes[0]).all()
    assert (inner <= solid.extremes[1]).all()
    if not isinstance(solid, Sphere):
        away_from = solid.polyhedron.distance(points)
        assert (away_from <= solid.distance(points) + 1e-9).all()
        if not isinstance(solid, Cylinder):
            np.testing.assert_allclose(away_from, solid.distance(points), atol=1e-9)
        center, radius = solid.polyhedron.ball
        assert (np.linalg.norm(inner - center, axis=1) <= radius + 1e-9).all()


def test_a_box_has_six_faces_and_twelve_edges() -> None:
    polyhedron = Box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0), (0.3, 0.2, 0.1)).polyhedron
    assert (len(polyhedron.corners), len(polyhedron.edges), len(polyhedron.heights)) == (8, 12, 6)


def test_points_in_a_plane_are_no_polyhedron() -> None:
    with pytest.raises(ValueError, match="one plane"):
        Polyhedron.of(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]))


def test_a_facet_has_its_rock_behind_it() -> None:
    facet = Facet(((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)), thickness=0.2)
    np.testing.assert_allclose(facet.normal, [0.0, 0.0, 1.0])
    heights = np.array([[0.5, 0.5, z] for z in (0.1, 0.0, -0.1, -0.2, -0.5)])
    np.testing.assert_allclose(facet.solid.distance(heights), [0.1, 0.0, 0.0, 0.0, 0.3], atol=1e-12)
    np.testing.assert_allclose(facet.distance(heights), [0.1, 0.0, 0.1, 0.2, 0.5], atol=1e-12)
    np.testing.assert_allclose(facet.distance(np.array([[2.0, 0.5, 0.0], [1.3, 1.4, 0.0]])), [1.0, 0.5])


def test_the_normal_of_corners_on_a_line_is_zero() -> None:
    assert np.linalg.norm(newell(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))) == 0.0


def test_regions_of_the_plane_reach_through_all_z() -> None:
    disk = Point(0.0, 0.0).buffer(1.0)
    np.testing.assert_allclose(away(disk, np.array([[0.0, 0.0, 9.0], [3.0, 0.0, -9.0]])), [0.0, 2.0])
    np.testing.assert_allclose(away(Sphere((0.0, 0.0, 0.0), 1.0), np.array([[0.0, 0.0, 9.0]])), [8.0])


# Holds in space


def corner(degrees: float) -> Wall:
    """Two walls on either side of the y axis, each turned by so much from the wall plane; holds 0 and 1, 2 and 3."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    left = ((0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (-c, 1.0, s), (-c, -1.0, s))
    right = ((0.0, -1.0, 0.0), (c, -1.0, s), (c, 1.0, s), (0.0, 1.0, 0.0))
    places = [(-c, -0.5, s), (-c, 0.5, s), (c, 0.5, s), (c, -0.5, s)]
    holds = tuple(Hold((0.5 * x, y, 0.5 * z + 0.03), (0.0, 1.0, 0.0), 0.5, 0.02) for x, y, z in places)
    return Wall(holds, facets=(Facet(left), Facet(right)))


def test_holds_face_as_the_facet_they_are_on_and_stances_as_their_holds() -> None:
    wall = corner(30.0)
    np.testing.assert_allclose(wall.outward[:2], [[0.5, 0.0, np.sqrt(0.75)]] * 2, atol=1e-12)
    np.testing.assert_allclose(wall.outward[2:], [[-0.5, 0.0, np.sqrt(0.75)]] * 2, atol=1e-12)
    np.testing.assert_allclose(wall.facing(np.array([0, 1, 2, 3])), [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(wall.facing(np.array([[0, 1], [2, 3]])), wall.outward[[0, 2]], atol=1e-12)
    seen = wall.projected(np.array([0, 1]))
    np.testing.assert_allclose(seen[:, 1], [-0.5, 0.5], atol=1e-12)
    np.testing.assert_allclose(seen[:, 0], seen[0, 0], atol=1e-12)
    np.testing.assert_allclose(wall.projected(np.array([0, 1, 2, 3])), wall.positions[:, :2], atol=1e-12)


def test_between_walls_that_face_one_another_stances_are_seen_along_z() -> None:
    wall = corner(89.0)
    for holds in ([0, 1, 2, 3], [0, 2], [0, 1, 2]):
        np.testing.assert_allclose(wall.facing(np.array(holds)), [0.0, 0.0, 1.0], atol=1e-12)
    assert wall.facing(np.array([0, 1]))[0] > 0.99


def test_a_wall_without_facets_faces_along_z_and_is_seen_as_it_is() -> None:
    rng = np.random.default_rng(0)
    wall = Wall(tuple(Hold(triple(p), (0.0, 1.0, 0.0), 0.5) for p in rng.normal(size=(5, 3))))
    assert (wall.outward == [0.0, 0.0, 1.0]).all()
    assert (wall.projected(np.arange(5)) == wall.positions[:, :2]).all()


@given(seed=st.integers(0, 2**32 - 1))
def test_the_patch_is_a_disk_across_the_normal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    wall = Wall((Hold(triple(rng.normal(size=3)), triple(normal / np.linalg.norm(normal)), 0.5, 0.02),))
    axes = np.stack([wall.tangents[0], wall.binormals[0], wall.normals[0]])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert wall.tangents[0][2] == pytest.approx(0.0, abs=1e-12)
    along, across = rng.uniform(-0.01, 0.01, 2)
    off = wall.point(Contact(0, 0, along, across)) - wall.positions[0]
    np.testing.assert_allclose(axes @ off, [along, across, 0.0], atol=1e-12)


def test_closing_regions_leaves_the_wall_as_it_is_elsewhere() -> None:
    wall = corner(10.0)
    assert wall.closing([]) == wall
    assert len(wall.rock) == 2
