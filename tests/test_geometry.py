"""Disks and polygons, against shapely, cvxpy and plain loops."""

from __future__ import annotations

from itertools import combinations, permutations

import cvxpy as cp
import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, MultiPolygon, Point, Polygon, box

from climber.geometry import (
    common_points,
    counter_clockwise,
    disks_meet,
    disks_meet_region,
    overlap_areas,
)
from climber.stance import Vector

grid = st.integers(-10, 10).map(lambda i: i / 10)
disk = st.tuples(st.tuples(grid, grid), st.sampled_from([0.3, 0.5, 0.9, 1.4]))


def _depth(centers: Vector, radii: Vector) -> float:
    """How far inside the worst of the disks the best point is [m], negative when they have no common point."""
    x, depth = cp.Variable(2), cp.Variable()
    inside = [cp.norm(x - c) + depth <= r for c, r in zip(centers, radii, strict=True)]
    problem = cp.Problem(cp.Maximize(depth), inside)
    problem.solve(solver=cp.CLARABEL)
    return float(problem.value)


@settings(max_examples=150, deadline=None)
@given(st.lists(disk, min_size=1, max_size=5))
def test_disks_meet_exactly_if_a_convex_program_finds_a_common_point(
    disks: list[tuple[tuple[float, float], float]],
) -> None:
    centers, radii = np.array([d[0] for d in disks]), np.array([d[1] for d in disks])
    for r in (radii, np.full(len(radii), radii[0])):
        depth = _depth(centers, r)
        assume(abs(depth) > 1e-6)
        assert disks_meet(centers[None], r)[0] == (depth > 0)
        (point,) = common_points(centers[None], r)
        assert bool(np.isnan(point).any()) == (depth < 0)
        if depth > 0:
            assert (np.linalg.norm(centers - point, axis=1) <= r + 1e-9).all()


@pytest.mark.parametrize("k", [2, 3, 4])
def test_disks_that_touch_meet(k: int) -> None:
    angles = 2 * np.pi * np.arange(k) / k + 0.1
    centers = 0.25 * np.column_stack([np.cos(angles), np.sin(angles)])
    for radii in (np.full(k, 0.25), 0.25 + np.array([0.0, 0.1, 0.0, 0.0])[:k]):
        assert disks_meet(centers[None], radii)[0]
        assert not disks_meet(1.001 * centers[None], np.full(k, 0.25))[0]
    assert overlap_areas(centers[None], np.full(k, 0.25))[0] == pytest.approx(0.0, abs=1e-9)


def test_area_of_a_lens_is_the_textbook_formula() -> None:
    d, r = 0.3, 0.25
    expected = 2 * r**2 * np.arccos(d / (2 * r)) - d / 2 * np.sqrt(4 * r**2 - d**2)
    assert overlap_areas(np.array([[[1.0, 2.0], [1.0 + d, 2.0]]]), np.array([r, r]))[0] == pytest.approx(expected)


def test_area_of_a_disk_inside_the_others_is_its_own() -> None:
    centers = np.array([[[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]])
    assert overlap_areas(centers, np.array([0.2, 0.5, 0.6]))[0] == pytest.approx(np.pi * 0.04)
    assert overlap_areas(np.zeros((1, 3, 2)), np.full(3, 0.2))[0] == pytest.approx(np.pi * 0.04)
    assert overlap_areas(np.zeros((1, 1, 2)), np.array([0.2]))[0] == pytest.approx(np.pi * 0.04)


def test_areas_are_those_of_fine_polygons() -> None:
    rng = np.random.default_rng(0)
    num_apart = 0
    for k in (2, 3, 5):
        centers = rng.uniform(0, 0.5, (150, k, 2))
        for radii in (np.full(k, 0.25), rng.uniform(0.1, 0.5, k)):
            expected = [
                shapely.intersection_all(
                    [Point(p).buffer(r, quad_segs=1000) for p, r in zip(c, radii, strict=True)]
                ).area
                for c in centers
            ]
            areas = overlap_areas(centers, radii)
            assert areas == pytest.approx(np.array(expected), abs=1e-6, rel=1e-5)
            num_apart += int((areas == 0.0).sum())
    assert num_apart > 20


def test_order_is_counter_clockwise_and_convex_exactly_if_every_three_in_it_are() -> None:
    rng = np.random.default_rng(1)
    for k in (3, 4, 5, 6):
        points = rng.integers(-4, 5, (300, k, 2)).astype(float)  # small integers, so that many are collinear
        order, convex = counter_clockwise(points)
        for p, o, c in zip(points, order, convex, strict=True):
            good = [s for s in permutations(range(1, k)) if _all_left(p[[0, *s]])]
            assert c == bool(good)
            if c:
                assert good == [tuple(o[1:])] and o[0] == 0
        assert convex.any() and not convex.all()


def _all_left(p: Vector) -> bool:
    return all(
        (p[b, 0] - p[a, 0]) * (p[c, 1] - p[a, 1]) > (p[b, 1] - p[a, 1]) * (p[c, 0] - p[a, 0])
        for a, b, c in combinations(range(len(p)), 3)
    )


def test_four_feet_are_in_order_exactly_if_the_four_inequalities_of_the_thesis_hold() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(0, 1, (500, 4, 2))
    order, convex = counter_clockwise(points)
    for p, o, c in zip(points, order, convex, strict=True):
        holds = [_eq_4_6(p[list(s)]) for s in permutations(range(4))]
        assert sum(holds) == (4 if c else 0)
        assert _eq_4_6(p[o]) == c


def _eq_4_6(p: Vector) -> bool:
    (xi, yi), (xj, yj), (xk, yk), (xl, yl) = p
    return bool(
        (yi - yk) * (xl - xk) - (xi - xk) * (yl - yk) > 0
        and (yj - yk) * (xi - xk) - (xj - xk) * (yi - yk) > 0
        and (yj - yl) * (xi - xl) - (xj - xl) * (yi - yl) > 0
        and (yk - yl) * (xj - xl) - (xk - xl) * (yj - yl) > 0
    )


REGIONS = {
    "small box": box(0.2, 0.2, 0.25, 0.25),
    "box around everything": box(-5, -5, 5, 5),
    "box with a hole": box(-0.5, -0.5, 1, 1).difference(box(0.05, 0.05, 0.45, 0.45)),
    "two triangles": MultiPolygon(
        [Polygon([(0, 0), (0.1, 0), (0, 0.1)]), Polygon([(0.5, 0.5), (0.4, 0.5), (0.5, 0.4)])]
    ),
    "line": LineString([(0.0, 0.5), (0.2, 0.3), (0.6, 0.35)]),
    "point": Point(0.25, 0.3),
    "circle": Point(0.4, 0.2).buffer(0.03),
}


@pytest.mark.parametrize("name", REGIONS)
def test_overlap_meets_a_region_exactly_if_fine_polygons_do(name: str) -> None:
    rng = np.random.default_rng(3)
    region, answers = REGIONS[name], set()
    for radii in (np.full(3, 0.25), np.array([0.15, 0.3, 0.4])):
        centers = rng.uniform(0, 0.5, (400, 3, 2))
        for c, meets in zip(centers, disks_meet_region(centers, radii, region), strict=True):
            inner, outer = (
                shapely.intersection_all([Point(p).buffer(r + e, quad_segs=500) for p, r in zip(c, radii, strict=True)])
                for e in (-1e-5, 1e-5)
            )
            if inner.intersects(region) == outer.intersects(region):  # not within a hundredth of a millimetre
                assert meets == inner.intersects(region)
                answers.add(bool(meets))
    assert answers == {True, False}


def test_a_region_that_only_touches_the_overlap_meets_it() -> None:
    centers = np.array([[[0.0, 0.0], [0.4, 0.0]]])
    assert disks_meet_region(centers, np.full(2, 0.25), box(0.25, -1, 1, 1))[0]
    assert not disks_meet_region(centers, np.full(2, 0.25), box(0.2501, -1, 1, 1))[0]
    assert not disks_meet_region(centers, np.full(2, 0.1), box(-1, -1, 1, 1))[0]
