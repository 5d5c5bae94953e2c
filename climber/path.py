"""Paths on a stance's manifold: RRT-Connect in charts, and through straight limbs where an elbow must flip.

Two postures whose holding limbs bend the same way share a chart, and most often the straight line in it already joins
them. Where one limb bends the other way, the chart rooted at that limb contains both. Where several do, they flip one
after the other through postures in between.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from climber.manifold import Chart, Manifold
from climber.stance import Vector
from climber.transition import Branches, PostureSampler


@dataclass(frozen=True)
class Leg:
    """A polyline in one chart.

    Attributes:
        chart: The chart.
        u: Corners in its coordinates, shape (M, num_coordinates), M >= 2.
    """

    chart: Chart
    u: Vector


@dataclass(frozen=True)
class Search:
    """How hard to look for a path.

    Attributes:
        iterations: Samples that RRT-Connect draws before it gives up.
        step: Distance between checked points in scaled chart coordinates [rad].
        extension: Longest edge grown at once, likewise.
        shortcuts: Attempts at shortening a path found.
        vias: Postures in between that are tried where several limbs must flip.
    """

    iterations: int = 400
    step: float = 0.04
    extension: float = 0.8
    shortcuts: int = 40
    vias: int = 6


def unwound(q: Vector, reference: Vector, angle: int) -> Vector:
    """`q` with the pelvis's angle (its place in q is `angle`) taken within half a turn of the reference's."""
    result = np.array(np.broadcast_to(q, np.broadcast_shapes(q.shape, reference.shape)))
    result[..., angle] -= 2 * np.pi * np.round((q[..., angle] - reference[..., angle]) / (2 * np.pi))
    return result


def line(chart: Chart, a: Vector, b: Vector, step: float) -> Vector:
    """Points from `a` (left out) to `b` in chart coordinates, no farther apart than `step` when scaled."""
    count = max(1, int(np.ceil(np.linalg.norm((b - a) * chart.scale) / step)))
    result: Vector = a + (b - a) * (np.arange(1, count + 1) / count)[:, None]
    return result


def clear(manifold: Manifold, chart: Chart, a: Vector, b: Vector, step: float = Search.step) -> bool:
    """Whether the straight line between two chart points is feasible at every checked point."""
    points = line(chart, a, b, step)
    # Trouble is likeliest in the middle, and a coarse look settles most failures at a quarter of the cost.
    coarse = points[:: max(1, len(points) // 6)]
    return bool(manifold.feasible(chart, coarse).all() and manifold.feasible(chart, points).all())


class _Tree:
    """A tree of chart points, grown towards targets."""

    def __init__(self, root: Vector, capacity: int) -> None:
        self.u = np.empty((capacity, len(root)))
        self.parent = np.zeros(capacity, dtype=np.int64)
        self.u[0], self.parent[0], self.size = root, -1, 1

    def grow(self, manifold: Manifold, chart: Chart, target: Vector, search: Search) -> tuple[int, bool]:
        """Grows from the nearest node as far towards `target` as is feasible: the new node (-1: none), and arrival."""
        distances = np.linalg.norm((self.u[: self.size] - target) * chart.scale, axis=1)
        near = int(distances.argmin())
        limited = min(1.0, search.extension / max(distances[near], 1e-12))
        goal = self.u[near] + limited * (target - self.u[near])
        points = line(chart, self.u[near], goal, search.step)
        good = manifold.feasible(chart, points)
        free = len(points) if good.all() else int(good.argmin())
        if free == 0 or self.size == len(self.u):
            return -1, False
        self.u[self.size], self.parent[self.size] = points[free - 1], near
        self.size += 1
        return self.size - 1, bool(free == len(points) and limited == 1.0)

    def branch(self, node: int) -> list[Vector]:
        """Points from the root to `node`."""
        chain = []
        while node >= 0:
            chain.append(self.u[node])
            node = int(self.parent[node])
        return chain[::-1]


def _box(chart: Chart, a: Vector, b: Vector) -> tuple[Vector, Vector]:
    """Where to draw chart samples: around both ends, and no farther than joint limits."""
    lower, upper = np.minimum(a, b) - 0.9 / chart.scale, np.maximum(a, b) + 0.9 / chart.scale
    for limb in chart.body.robot.limbs:
        for place, low, high in zip(limb.q, limb.lower, limb.upper, strict=True):
            at = np.flatnonzero(chart.independent == place)
            lower[at], upper[at] = np.maximum(lower[at], low), np.minimum(upper[at], high)
    return lower, upper


def _connect(
    manifold: Manifold, chart: Chart, a: Vector, b: Vector, rng: np.random.Generator, search: Search
) -> Vector | None:
    """RRT-Connect between two points of one chart; corners of the path, shortened, or None."""
    if clear(manifold, chart, a, b, search.step):
        return np.array([a, b])
    lower, upper = _box(chart, a, b)
    here, there = _Tree(a, 2 * search.iterations + 2), _Tree(b, 2 * search.iterations + 2)
    for _ in range(search.iterations):
        node, _ = here.grow(manifold, chart, rng.uniform(lower, upper), search)
        if node >= 0:
            target = here.u[node]
            while True:
                other, arrived = there.grow(manifold, chart, target, search)
                if other < 0 or arrived:
                    break
            if arrived:
                one, two = here.branch(node), there.branch(other)
                if not np.array_equal(one[0], a):
                    one, two = two, one
                corners = np.array(one + two[::-1][1:])
                return _shortened(manifold, chart, corners, rng, search)
        here, there = there, here
    return None


def _shortened(manifold: Manifold, chart: Chart, u: Vector, rng: np.random.Generator, search: Search) -> Vector:
    """Replaces stretches of a polyline by straight lines where these are feasible."""
    for _ in range(search.shortcuts):
        if len(u) < 3:
            break
        lengths = np.linalg.norm(np.diff(u, axis=0) * chart.scale, axis=1)
        along = np.append(0.0, np.cumsum(lengths))
        s, t = np.sort(rng.uniform(0, along[-1], 2)) if _ % 2 else (0.0, along[-1])
        if _ % 2 == 0 and _ > 0:  # a random corner skipped
            i = int(rng.integers(1, len(u) - 1))
            if clear(manifold, chart, u[i - 1], u[i + 1], search.step):
                u = np.delete(u, i, axis=0)
            continue
        i, j = int(np.searchsorted(along, s, "right")) - 1, int(np.searchsorted(along, t, "left")) - 1
        if i >= j:
            continue
        p = u[i] + (s - along[i]) / lengths[i] * (u[i + 1] - u[i])
        r = u[j] + (t - along[j]) / lengths[j] * (u[j + 1] - u[j])
        if clear(manifold, chart, p, r, search.step):
            u = np.concatenate([u[: i + 1], [p, r], u[j + 1 :]])
            keep = np.linalg.norm(np.diff(u, axis=0) * chart.scale, axis=1) > 1e-9
            u = u[np.append(True, keep)] if keep[-1] else np.concatenate([u[:-1][np.append(True, keep[:-1])], u[-1:]])
    return u


def flips(manifold: Manifold, a: Vector, b: Vector) -> tuple[int, ...]:
    """The holding limbs that bend differently in two configurations."""
    one, two = manifold.body.branches(a), manifold.body.branches(b)
    return tuple(i for i in sorted(manifold.points) if one[i] != two[i])


def find_path(
    manifold: Manifold, a: Vector, b: Vector, rng: np.random.Generator, search: Search | None = None
) -> list[Leg] | None:
    """A feasible path between two feasible configurations on a manifold, or None when the search ends without one.

    `b` may differ from the path's last configuration by whole turns of the pelvis.
    """
    search = search or Search()
    b = unwound(b, a, int(manifold.body.robot.base_q[-1]))
    turning = flips(manifold, a, b)
    if len(turning) > 1:
        return _through_vias(manifold, a, b, turning, rng, search)
    chart = manifold.chart(a, turning[0] if turning else None)
    u = _connect(manifold, chart, chart.coordinates(a), chart.coordinates(b), rng, search)
    return None if u is None else [Leg(chart, u)]


def _through_vias(
    manifold: Manifold, a: Vector, b: Vector, turning: tuple[int, ...], rng: np.random.Generator, search: Search
) -> list[Leg] | None:
    """Flips several limbs one after the other, by way of sampled postures."""
    sampler = PostureSampler(manifold.body, manifold)
    q, branches, _, _ = sampler.draw(rng, 4000)
    here = np.array(manifold.body.branches(a))
    holding = sorted(manifold.points)
    for limb, via in _vias(manifold, a, b, turning, q, branches, here, holding, search):
        first = find_path(manifold, a, via, rng, search)
        if first is None:
            continue
        rest = tuple(i for i in turning if i != limb)
        reached = first[-1].chart.expand(first[-1].u[-1:])[0][0]
        second = find_path(manifold, reached, b, rng, search) if len(rest) else None
        if second is not None:
            return first + second
    return None


def _vias(
    manifold: Manifold,
    a: Vector,
    b: Vector,
    turning: tuple[int, ...],
    q: Vector,
    branches: Branches,
    here: Vector,
    holding: list[int],
    search: Search,
) -> Iterator[tuple[int, Vector]]:
    """Postures with exactly one of the turning limbs flipped, the nearest to both ends first, limbs in turn."""
    candidates: list[list[tuple[int, Vector]]] = []
    for limb in turning:
        wanted = here.copy()
        wanted[limb] = manifold.body.branches(b)[limb]
        matching = q[(branches[:, holding] == wanted[holding]).all(axis=1)]
        if len(matching):
            matching = unwound(matching, a, int(manifold.body.robot.base_q[-1]))
            far = np.linalg.norm(matching - a, axis=1) + np.linalg.norm(matching - b, axis=1)
            candidates.append([(limb, matching[i]) for i in np.argsort(far)[: search.vias]])
    for row in itertools.zip_longest(*candidates):
        yield from (item for item in row if item is not None)
