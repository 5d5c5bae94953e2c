"""Balls in space: whether they meet, where and in how much, against other ways to find out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from shapely.geometry import box

from climber.balls import (
    balls_meet,
    balls_meet_region,
    is_flat,
    overlap_measures,
    shared_points,
    tetrahedra_fit,
)
from climber.geometry import disks_meet, overlap_areas
from climber.solids import Box, Sphere
from climber.stance import Vector

SEEDS = st.integers(0, 2**32 - 1)


def least_growth(centers: Vector, radii: Vector) -> float:
    """By how much all balls must grow to meet, by a smooth convex program: min t, |p - c_i| <= r_i + t."""
    t = float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max())
    result = minimize(
        lambda v: v[3],
        np.append(centers.mean(axis=0), t),
        jac=lambda v: np.array([0.0, 0.0, 0.0, 1.0]),
        constraints=[
            {"type": "ineq", "fun": lambda v: v[3] + radii - np.linalg.norm(v[:3] - centers, axis=1)},
        ],
        options={"ftol": 1e-12, "maxiter": 300},
    )
    return float(result.x[3])


@settings(deadline=None, max_examples=40)
@given(seed=SEEDS, k=st.integers(1, 6), equal=st.booleans())
def test_balls_meet_exactly_if_a_convex_program_says_so(seed: int, k: int, equal: bool) -> None:
    rng = np.random.default_rng(seed)
    centers = rng.uniform(-0.45, 0.45, (k, 3))
    radii = np.full(k, 0.5) if equal else rng.uniform(0.3, 0.7, k)
    lacking = least_growth(centers, radii)
    if abs(lacking) < 1e-5:
        return
    assert balls_meet(centers[None], radii)[0] == (lacking < 0.0)
    (point,) = shared_points(centers[None], radii)
    assert np.isnan(point[0]) == (lacking > 0.0)
    if lacking < 0.0:
        assert (np.linalg.norm(point - centers, axis=1) <= radii + 1e-9).all()


@given(seed=SEEDS)
def test_balls_with_centers_in_a_plane_meet_as_their_disks_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    flat = rng.uniform(-0.6, 0.6, (200, 4, 2))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    centers = np.concatenate([flat, np.full((200, 4, 1), 0.3)], axis=2) @ turn
    radii = np.full(4, 0.5)
    np.testing.assert_array_equal(balls_meet(centers, radii), disks_meet(flat, radii))
    assert is_flat(centers.reshape(-1, 3))
    assert not is_flat(centers.reshape(-1, 3) + rng.normal(0.0, 1e-3, (800, 3)))
    unequal = np.array([0.3, 0.4, 0.5, 0.6])
    np.testing.assert_array_equal(balls_meet(centers, unequal), disks_meet(flat, unequal))


def test_a_regular_tetrahedron_just_fits_the_ball_around_it() -> None:
    corners = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])[None]
    assert tetrahedra_fit(corners, np.sqrt(3.0))[0]
    assert not tetrahedra_fit(corners, np.sqrt(3.0) - 1e-6)[0]


def test_volumes_of_lenses_are_exact() -> None:
    r, d = 0.5, np.array([0.0, 0.2, 0.6, 0.99, 1.0, 1.3])
    lens = np.where(d < 2 * r, np.pi * (4 * r + d) * (2 * r - d) ** 2 / 12, 0.0)
    centers = np.zeros((6, 2, 3))
    centers[:, 1, 2] = d
    np.testing.assert_allclose(overlap_measures(centers, np.full(2, r)), lens, atol=1e-5)
    np.testing.assert_allclose(overlap_measures(centers[:, :1], np.full(1, r)), 4 / 3 * np.pi * r**3, rtol=1e-6)


@pytest.mark.parametrize(("k", "equal"), [(3, True), (3, False), (4, True), (5, False)])
def test_volumes_are_those_of_a_count_of_points(k: int, equal: bool) -> None:
    rng = np.random.default_rng(k)
    radii = np.full(k, 0.5) if equal else rng.uniform(0.4, 0.6, k)
    centers = rng.uniform(-0.3, 0.3, (12, k, 3))
    points = rng.uniform(-1.0, 1.0, (400_000, 3))
    for center, volume in zip(centers, overlap_measures(centers, radii), strict=True):
        inside = (np.linalg.norm(points[:, None] - center, axis=2) <= radii).all(axis=1)
        counted = 8.0 * inside.mean()
        assert volume == pytest.approx(counted, abs=5 * 8.0 * np.sqrt(max(counted, 1e-3) / 8.0 / 400_000))


def test_measures_of_disks_are_areas() -> None:
    centers = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 3, 2))
    np.testing.assert_array_equal(overlap_measures(centers, np.full(3, 0.5)), overlap_areas(centers, np.full(3, 0.5)))


def test_balls_meet_a_region_if_a_point_of_it_is_in_all() -> None:
    rng = np.random.default_rng(1)
    centers, radii = rng.uniform(-0.5, 0.5, (60, 3, 3)), np.array([0.4, 0.5, 0.6])
    ball, block = Sphere((0.2, 0.1, 0.0), 0.15), Box((0.2, 0.1, 0.0), (0.2, 0.1, 0.3))
    square = box(0.1, 0.0, 0.4, 0.3)
    points = rng.uniform(-1.0, 1.0, (40_000, 3))
    flat = (np.abs(points[:, :2] - [0.25, 0.15]) <= 0.15).all(axis=1)
    for region, within in (
        (ball, ball.distance(points) == 0.0),
        (block, block.distance(points) == 0.0),
        (square, flat),
    ):
        meets = balls_meet_region(centers, radii, region)
        for center, met in zip(centers, meets, strict=True):
            common = (np.linalg.norm(points[within][:, None] - center, axis=2) <= radii).all(axis=1)
            assert met or not common.any()  # no set that meets it is refused
        assert not meets.all()
    exact = balls_meet(np.concatenate([centers, np.full((60, 1, 3), ball.center)], axis=1), np.append(radii, 0.15))
    np.testing.assert_array_equal(balls_meet_region(centers, radii, ball), exact)
