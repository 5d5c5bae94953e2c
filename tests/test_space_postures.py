"""Postures in space: drawn where limbs may reach, and found where a limb may let go, by Drake's word."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from climber import floating
from climber.manifold import Body, Manifold, Margins
from climber.newton import NewtonChart
from climber.newton_sampler import NewtonSampler
from climber.programs.instants import Margin
from climber.programs.torque import ROOM, static_feasible
from climber.robot import Robot
from climber.solids import Facet
from climber.space_bases import SpaceBases
from climber.stance import Contact, Vector
from climber.transition import Postures, PostureSampler, find_transition, posture_sampler, support_of
from climber.wall import Hold, Wall

seeds = st.integers(0, 2**32 - 1)
LEMUR = "package://climber/lemur/lemur.urdf"
FOUR = [Contact(i, i) for i in range(4)]


def face(normal_deg: float = 75.0, inclination_deg: float = 90.0, seed: int = 0) -> Wall:
    """A flat wall with four ledges that stand off it by 4 cm, their normals so far up from straight out of it."""
    places = np.array([[0.22, 0.25], [-0.22, 0.25], [-0.22, -0.25], [0.22, -0.25]])
    places += np.random.default_rng(seed).uniform(-0.04, 0.04, (4, 2))
    tilt = np.radians(normal_deg)
    normal = (0.0, float(np.sin(tilt)), float(np.cos(tilt)))
    holds = tuple(Hold((float(x), float(y), 0.04), normal, 0.8, max_force=100.0) for x, y in places)
    corners = ((-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0))
    return Wall(holds, (), inclination_deg, (), (Facet(corners),))


@cache
def body(inclination_deg: float = 90.0, normal_deg: float = 75.0, seed: int = 0) -> Body:
    wall = face(normal_deg, inclination_deg, seed)
    return Body(Robot(LEMUR, wall.gravity), wall)


# --- poses of the pelvis ---------------------------------------------------------------------------------------------


def bases(here: Body, limbs: tuple[int, ...] = (0, 1, 2, 3)) -> SpaceBases:
    """Poses for the limbs on the holds of their numbers."""
    sampler = posture_sampler(here, Manifold(here, [FOUR[i] for i in limbs], support_of(here, FOUR), Margins()))
    assert isinstance(sampler, PostureSampler) and isinstance(sampler._bases, SpaceBases)
    return sampler._bases


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_poses_drawn_have_the_holds_between_the_levels_that_limbs_reach_and_near_enough(seed: int) -> None:
    drawn = bases(body())
    base = drawn.draw(np.random.default_rng(seed), 300)
    assert base.shape == (300, 6)
    R, origin = floating.rotation(base), base[:, list(floating.ORIGIN)]
    feet = (drawn.points - origin[:, None]) @ R
    offsets = feet - drawn.hips
    assert (offsets[..., 2] >= drawn.levels[:, 0] - 1e-9).all() and (offsets[..., 2] <= drawn.levels[:, 1] + 1e-9).all()
    near = np.linalg.norm(offsets[..., :2], axis=2) <= drawn.lengths + 1e-9
    assert near.all(axis=1).mean() > 0.1  # what is drawn from contains the common part of disks, and more


def test_poses_face_the_wall_mostly_but_may_be_turned_and_tilted_otherwise() -> None:
    base = bases(body()).draw(np.random.default_rng(0), 4000)
    R = floating.rotation(base)
    assert (R[:, 2, 2] > 0.8).mean() > 0.9
    spin = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    assert (np.abs(spin) > 1.5).any() and np.median(np.abs(spin)) < 0.5
    assert (base[:, 3] > 0.04).mean() > 0.7  # farther off the wall than the feet


@given(seeds)
@settings(max_examples=50, deadline=None)
def test_holds_that_some_posture_stands_on_are_never_called_unreachable(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinematics = body().kinematics
    q = np.zeros((1, 18))
    q[:, :6] = floating.base_positions(Rotation.random(1, random_state=rng).as_matrix(), rng.uniform(-1, 1, (1, 3)))
    q[:, kinematics.joint_q] = rng.uniform(kinematics.lower, kinematics.upper)
    drawn = bases(body())
    there = SpaceBases(drawn.hips, drawn.lengths, drawn.levels, kinematics.feet(q)[0], drawn.out)
    assert not there.unreachable()


def test_holds_farther_apart_than_two_limbs_are_unreachable() -> None:
    drawn = bases(body())
    # Of opposite limbs, hips are 0.18 m apart and reach 0.41 m each.
    for distance, unreachable in ((0.999, False), (1.001, True)):
        points = drawn.points.copy()
        points[2] = points[0] + distance * np.array([0.6, 0.0, 0.8])
        points[1] = points[3] = (points[0] + points[2]) / 2
        there = SpaceBases(drawn.hips, drawn.lengths, drawn.levels, points, drawn.out)
        assert there.unreachable() == unreachable
        assert not there.unreachable(0.01)
    assert there.draw(np.random.default_rng(0), 10).shape == (0, 6)


# --- postures --------------------------------------------------------------------------------------------------------

WALLS = [(90.0, 75.0), (60.0, 60.0), (110.0, 100.0)]


@cache
def found(wall: int, limb: int) -> tuple[Body, Postures]:
    here = body(*WALLS[wall], wall)
    return here, find_transition(here, FOUR, limb, np.random.default_rng(limb))


@pytest.mark.parametrize("limb", range(4))
@pytest.mark.parametrize("wall", range(len(WALLS)))
def test_transition_postures_stand_on_their_holds_balanced_either_way_inside_limits_and_clear(
    wall: int, limb: int
) -> None:
    here, postures = found(wall, limb)
    assert len(postures)
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    here.robot.model.add_to(plant, scene_graph)
    for i, facet in enumerate(here.wall.facets):
        shape, pose = facet.solid.drake()
        plant.RegisterCollisionGeometry(plant.world_body(), pose, shape, f"facet{i}", CoulombFriction(0.5, 0.5))
    plant.Finalize()
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyContextFromRoot(root)
    supports = [support_of(here, contacts) for contacts in (FOUR, [c for c in FOUR if c.limb != limb])]
    for q, branches in zip(postures.q, postures.branches, strict=True):
        plant.SetPositions(context, q)
        here.robot.plant.SetPositions(own := here.robot.context(), q)
        assert np.abs(here.robot.foot_positions(own) - here.wall.positions).max() < 1e-9
        center = here.robot.center_of_mass(own)
        for support in supports:
            assert support is not None and support.room(center[None])[0] >= 0.0019
        for part in here.robot.limbs:
            assert (q[part.q] >= part.lower).all() and (q[part.q] <= part.upper).all()
        near = plant.get_geometry_query_input_port().Eval(context).ComputeSignedDistancePairwiseClosestPoints(0.01)
        assert min((pair.distance for pair in near), default=1.0) > 0.0008  # of 1 mm; FCL's convex shapes are inexact
        assert here.branches(q) == tuple(branches)


@pytest.mark.parametrize("wall", range(len(WALLS)))
def test_most_of_them_can_be_held_by_the_motors(wall: int) -> None:
    here, postures = found(wall, 0)
    for contacts in (FOUR, FOUR[1:]):
        assert static_feasible(here.robot, here.wall, postures.q, contacts).mean() > 0.5


@pytest.mark.parametrize(("aside", "in_line"), [(0.01, True), (0.05, False)])
def test_no_limb_is_let_go_where_the_others_stand_in_a_line(aside: float, in_line: bool) -> None:
    # The others hold a robot that does not turn about their line, but nothing keeps it from turning.
    wall = face()
    places = [(0.0, 0.25), (-0.22, 0.0), (0.0, -0.25), (1.5 * aside, 0.0)]
    holds = tuple(
        replace(hold, position=(x, y, hold.position[2])) for hold, (x, y) in zip(wall.holds, places, strict=True)
    )
    here = Body(Robot(LEMUR, wall.gravity), replace(wall, holds=holds))
    assert support_of(here, [FOUR[0], FOUR[2], FOUR[3]]) is not None
    found = find_transition(here, FOUR, 1, np.random.default_rng(0), rounds=(10,))
    assert (found.failure is not None and "of a line" in found.failure.reason) == in_line


@pytest.mark.parametrize("wall", range(len(WALLS)))
def test_weak_motors_leave_forces_room_where_they_hold_a_posture(wall: int) -> None:
    here, postures = found(wall, 0)
    held = postures.q[static_feasible(here.robot, here.wall, postures.q, FOUR[1:])]
    room = 0.99 * ROOM * here.robot.weight
    assert room > 0.5 and len(held)
    assert static_feasible(here.robot, here.wall, held, FOUR[1:], Margin(force=room, torque=0.099)).all()


def test_postures_with_a_limb_in_the_air_leave_it_anywhere() -> None:
    here = body()
    support = support_of(here, FOUR[1:])
    assert support is not None
    manifold = Manifold(here, FOUR[1:], support)
    q, _, slack, _ = PostureSampler(here, manifold).draw(np.random.default_rng(0), 4000)
    assert len(q) > 20 and np.array_equal(manifold.slack(q), slack)
    assert np.abs(here.kinematics.feet(q)[:, 1:] - here.wall.positions[1:]).max() < 1e-12
    assert np.ptp(q[:, here.robot.limbs[0].q], axis=0).min() > 1.0


# --- limbs at odd angles ---------------------------------------------------------------------------------------------


@cache
def odd(folder: Path) -> Body:
    """A lemur whose fingers turn about axes askew, which leaves its limbs without inverse kinematics."""
    source = Path(Robot(LEMUR).model.path)
    (folder / "odd.urdf").write_text(source.read_text().replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0.8 0.6"/>'))
    (folder / "odd.yaml").write_text(source.with_suffix(".yaml").read_text())
    wall = face()
    return Body(Robot(folder / "odd.urdf", wall.gravity), wall)


@pytest.fixture(scope="module")
def askew(tmp_path_factory: pytest.TempPathFactory) -> Body:
    return odd(tmp_path_factory.mktemp("odd"))


def test_without_inverse_kinematics_newtons_method_finds_postures(askew: Body) -> None:
    assert askew.inverse == (None,) * 4
    support = support_of(askew, FOUR)
    assert support is not None
    manifold = Manifold(askew, FOUR, support)
    sampler = posture_sampler(askew, manifold)
    assert isinstance(sampler, NewtonSampler) and not sampler.unreachable()
    q, _, slack, closed = sampler.draw(np.random.default_rng(0), 1000)
    assert len(q) and closed > len(q) and (slack >= 0).all()
    assert np.abs(askew.kinematics.feet(q) - askew.wall.positions).max() < 1e-11
    chart = manifold.chart(q[0])
    assert isinstance(chart, NewtonChart) and chart.dimension == 6
    u: Vector = np.random.default_rng(1).normal(scale=0.1, size=(40, 6))
    there, reach = chart.expand(u)
    kept = reach >= 0
    assert kept.sum() > 20
    assert np.abs(askew.kinematics.feet(there[kept]) - askew.wall.positions).max() < 1e-10
    assert chart.coordinates(there[kept]) == pytest.approx(u[kept], abs=1e-9)
