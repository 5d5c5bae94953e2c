"""Regions for the centre of mass: depth, margins and intersections against linear programming and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from climber.balance import LEAST, Region
from climber.stance import Vector

seeds = st.integers(0, 2**32 - 1)


def polygon(seed: int, most: int = 9) -> Region:
    """A random region across a random direction, which may be open or empty."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0][:, :2]
    angles = rng.uniform(-np.pi, np.pi, rng.integers(1, most))
    A = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ axes.T
    return Region(A, rng.uniform(-0.1, 1.0, len(A)))


def depth(region: Region) -> float:
    """max t with A p + t <= b, by linear programming."""
    m = len(region.b)
    answer = linprog(
        [0, 0, 0, -1], np.hstack([region.A, np.ones((m, 1))]), region.b, bounds=[(None, None)] * 4, method="highs"
    )
    return np.inf if answer.status == 3 else float(-answer.fun)


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_depth_is_what_linear_programming_finds(seed: int) -> None:
    region = polygon(seed)
    expected = depth(region)
    if expected < 1e3:  # nearly parallel borders meet too far away to matter
        assert region.depth == pytest.approx(expected, abs=1e-6)
    else:
        assert region.depth >= 1e3 - 1


@settings(max_examples=50, deadline=None)
@given(seeds, st.floats(0.0, 0.5))
def test_margin_moves_borders_inwards_but_never_past_two_fifths_of_the_depth(seed: int, margin: float) -> None:
    region = polygon(seed)
    shrunk = region.shrunk(margin)
    moved = region.b - shrunk.b
    assert moved == pytest.approx(np.full(len(moved), min(margin, LEAST * max(region.depth, 0.0))))
    if region.depth > 1e-9:
        assert shrunk.depth >= (1 - LEAST) * region.depth - 1e-9


@settings(max_examples=50, deadline=None)
@given(seeds, seeds)
def test_points_of_the_intersection_are_those_of_both(one: int, two: int) -> None:
    a, b = polygon(one), polygon(two)
    p: Vector = np.random.default_rng(one).uniform(-1, 1, (50, 3))
    both = a.meet(b)
    assert both.room(p) == pytest.approx(np.minimum(a.room(p), b.room(p)))
    assert len(a.meet(a).b) == len(a.b)


@settings(max_examples=50, deadline=None)
@given(st.floats(-1, 1), st.floats(-1, 1))
def test_interval_is_two_halfspaces(lower: float, upper: float) -> None:
    region = Region.interval(lower, upper)
    assert region.depth == pytest.approx((upper - lower) / 2)
    assert region.abscissas == (lower, upper)
    assert region.meet(Region.interval(0.25, 0.5)).abscissas == (max(lower, 0.25), min(upper, 0.5))
    p = np.array([[0.25, 7.0, -8.0]])
    assert region.room(p)[0] == pytest.approx(min(0.25 - lower, upper - 0.25))
    assert region.names[0] == "centre of mass right of the support interval's lower end"
    assert region.meet(Region.interval(0.25, 0.5)).names == region.names


def test_region_without_borders_is_everywhere() -> None:
    anywhere = Region.interval(-np.inf, np.inf)
    assert anywhere.depth == np.inf and anywhere.shrunk(1.0).b.tolist() == [np.inf, np.inf]
    assert len(anywhere.ends.b) == 0 and anywhere.ends.depth == np.inf
    assert anywhere.ends.room(np.zeros((2, 3))).tolist() == [np.inf] * 2
    half = Region.interval(-np.inf, 1.0)
    assert half.depth == np.inf and half.shrunk(0.1).abscissas == (-np.inf, 0.9)
