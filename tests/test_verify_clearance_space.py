"""Clearance in space: hulls against a program, steps against dense instants, solids of all kinds against Drake."""

from __future__ import annotations

from functools import cache

import cvxpy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon

from climber.robot import Model, Robot
from climber.solids import Box, Convex, Cylinder, Facet, Sphere
from climber.stance import Vector
from climber.verify_distance import hull_distances
from climber.verify_model import Tree
from climber.verify_scene import FAR, OVERLAP, DrakeClearance, Regions, Scene
from climber.verify_space import ENOUGH, SHARE, SpaceClearance, Sweep, levers

LEMUR = "package://climber/lemur/lemur.urdf"
REGIONS: Regions = [
    ("facet 0", Facet(((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0))).solid),
    ("ball", Sphere((0.3, 0.0, 0.25), 0.08)),
    ("box", Box((-0.3, 0.05, 0.2), (0.1, 0.2, 0.1), (0.3, 0.2, 0.1))),
    ("rod", Cylinder((0.0, 0.35, 0.2), (0.0, 0.6, 0.8), 0.03, 0.2)),
    ("rock", Convex(((0.0, -0.3, 0.1), (0.1, -0.35, 0.1), (-0.1, -0.4, 0.12), (0.0, -0.35, 0.3)))),
    ("pillar", Polygon([(0.35, 0.35), (0.45, 0.35), (0.45, 0.45), (0.40, 0.38)])),
]


@cache
def lemur() -> Robot:
    return Robot(Model.load(LEMUR))


@cache
def sweep() -> Sweep:
    """Every pair of parts of the robot among the regions."""
    scene = Scene(lemur(), REGIONS)
    return Sweep([lemur()], [(0, part) for part in scene.parts()], scene.candidates())


@cache
def clearance() -> SpaceClearance:
    return SpaceClearance(lemur(), REGIONS)


def every_pair(q: Vector) -> Vector:
    """Distances of all pairs at each of the positions (K, nq), shape (K, num_pairs)."""
    count = len(sweep().pairs)
    rows, pairs = np.repeat(np.arange(len(q)), count), np.tile(np.arange(count), len(q))
    return sweep().distances(q, rows, pairs).reshape(len(q), count)


def positions(rng: np.random.Generator, count: int) -> Vector:
    """The lemur before the wall with its limbs anywhere, shape (count, nq)."""
    q = rng.uniform(-1.0, 1.0, (count, lemur().plant.num_positions()))
    q[:, :6] = rng.uniform(-0.1, 0.1, (count, 6))
    q[:, 3] += 0.2
    return q


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), sizes=st.sampled_from([(1, 2), (2, 2), (2, 8), (8, 8), (5, 30)]))
def test_distances_of_hulls_are_those_of_a_quadratic_program(seed: int, sizes: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    one, two = (rng.normal(size=(1, size, 3)) * rng.uniform(0.02, 0.3) for size in sizes)
    two = two + rng.normal(size=3) * rng.uniform(0.0, 1.0)
    a, b = cvxpy.Variable(sizes[0], nonneg=True), cvxpy.Variable(sizes[1], nonneg=True)
    apart = cvxpy.Minimize(cvxpy.norm(one[0].T @ a - two[0].T @ b))
    problem = cvxpy.Problem(apart, [cvxpy.sum(a) == 1, cvxpy.sum(b) == 1])
    problem.solve(solver=cvxpy.CLARABEL, tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    (found,) = hull_distances(one, two)
    assert found <= problem.value + 1e-6  # never more than it is
    assert found == pytest.approx(problem.value, abs=1e-5)


def test_distances_of_flat_and_parallel_hulls() -> None:
    box = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    rod = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    cases = [
        (box, box + np.array([0.25, 0.0, 0.0]), 0.05),  # face to face
        (box, box + np.array([0.25, 0.25, 0.0]), np.hypot(0.05, 0.05)),  # edge to edge
        (box, box + np.array([0.25, 0.25, 0.25]), np.sqrt(3) * 0.05),  # corner to corner
        (box, box + np.array([0.15, 0.0, 0.0]), 0.0),
        (box, box, 0.0),
        (rod, rod + np.array([0.5, 0.02, 0.0]), 0.02),  # side by side
        (rod, rod + np.array([1.5, 0.0, 0.0]), 0.5),  # one behind the other
        (rod, np.array([[0.5, -1.0, 0.03], [0.5, 1.0, 0.03]]), 0.03),  # across
        (rod[:1], rod[:1], 0.0),
    ]
    for one, two, expected in cases:
        assert hull_distances(one[None], two[None]) == pytest.approx(expected, abs=1e-9)
    assert hull_distances(np.zeros((0, 2, 3)), np.zeros((0, 8, 3))).shape == (0,)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_nothing_is_missed_between_instants(seed: int) -> None:
    """Two instants far apart, against hundreds between them; and what is proved is not much less than what is so."""
    rng = np.random.default_rng(seed)
    ends = positions(rng, 1) + np.vstack([np.zeros(18), rng.uniform(-0.3, 0.3, 18)])
    part = np.linspace(0.0, 1.0, 301)[:, None]
    found = every_pair(ends[0] * (1 - part) + ends[1] * part)
    outside = np.array([any(name in dict(REGIONS) for name in pair) for pair in names()])
    for least, group in zip(clearance().least(np.array([0.0, 1.0]), ends), (~outside, outside), strict=True):
        true = found[:, group].min()
        if true < 0.0:
            assert least.value < 0.0
        else:
            assert least.value <= true + 1e-9
            assert least.value >= min(SHARE * true, ENOUGH) - 1e-3
        assert 0.0 <= least.time <= 1.0


@cache
def names() -> list[tuple[str, str]]:
    """The names of each pair."""
    parts = Scene(lemur(), REGIONS).parts()
    return [(parts[a].name, parts[b].name) for a, b in sweep().pairs]


def test_no_point_of_a_part_moves_farther_than_its_levers_say() -> None:
    tree, rng = Tree(lemur()), np.random.default_rng(4)
    parts = Scene(lemur(), ()).parts()
    q = positions(rng, 300)
    step = rng.uniform(-0.05, 0.05, q.shape) * (rng.random(q.shape) < 0.2)
    before, after = tree.poses(q), tree.poses(q + step)
    for part in parts:
        at = [
            part.corners @ np.swapaxes(p.rotation[part.body], 1, 2) + p.origin[part.body][:, None]
            for p in (before, after)
        ]
        went = np.linalg.norm(at[1] - at[0], axis=2).max(axis=1)
        most = np.abs(step) @ levers(lemur(), part)
        assert (went <= most + 1e-12).all()
        assert (went > 0.2 * most).any()


def test_drake_agrees_on_solids_of_all_kinds_and_never_says_less() -> None:
    drake, rng, near = DrakeClearance(lemur(), REGIONS), np.random.default_rng(5), 0
    for q in positions(rng, 150):
        for least, (distance, _) in zip(clearance().least(np.zeros(1), q[None]), drake.nearest(q), strict=True):
            if least.value > 0.0:
                assert -1e-4 < distance - least.value < 2e-3
                near += least.value < FAR
            else:
                assert distance < 2e-3
    assert near > 20


def test_bodies_without_thickness_that_meet_are_no_distance_apart() -> None:
    """The pelvis, a union of boxes, in a box."""
    inside = SpaceClearance(lemur(), [("box", Box((0.0, 0.0, 0.0), (0.05, 0.05, 0.05)))])
    _, outside = inside.least(np.zeros(1), np.zeros((1, 18)))
    assert outside.value == -OVERLAP
    assert outside.pair in ("pelvis and box", "box and pelvis")


def test_robots_are_measured_against_one_another() -> None:
    """Two that come towards each other: the gap closes at the sum of their speeds."""
    robot = lemur()
    parts = [(owner, part) for owner in (0, 1) for part in Scene(robot, ()).parts()]
    count = len(parts) // 2
    pairs = [(i, j) for i in range(count) for j in range(count, 2 * count)]
    both = Sweep([robot, robot], parts, pairs)
    q = np.zeros((2, 36))
    q[:, 18 + 4] = 0.9  # x of the second pelvis
    q[1, 4], q[1, 18 + 4] = 0.15, 0.66
    least = both.least(np.array([0.0, 1.0]), q, np.ones(len(pairs), bool))
    assert least.time == 1.0
    (alone,) = both.distances(q[1:], np.zeros(len(pairs), int), np.arange(len(pairs)))[None].min(axis=1)
    assert SHARE * min(alone, ENOUGH) <= least.value <= alone
