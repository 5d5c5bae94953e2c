"""Paths within one chart of a stance's manifold: straight lines, RRT-Connect, and shortening what it finds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climber.manifold import AnyChart, Manifold
from climber.robot import Indices
from climber.stance import Vector

ROUNDS = 3  # how often points are put in between configurations that are far apart


@dataclass(frozen=True)
class Leg:
    """A polyline in one chart.

    Attributes:
        chart: The chart.
        u: Corners in its coordinates, shape (M, num_coordinates), M >= 2.
    """

    chart: AnyChart
    u: Vector


@dataclass(frozen=True)
class Search:
    """How hard to look for a path.

    Attributes:
        iterations: Samples that RRT-Connect draws on the direct way before it gives up.
        step: Distance between checked points in scaled chart coordinates [rad].
        joint_step: Distance between checked configurations [rad].
        extension: Longest edge grown at once in scaled chart coordinates [rad].
        shortcuts: Attempts at shortening a path found.
        nodes: Postures in a roadmap.
        checks: Straight lines between them that are looked at for one path; RRT-Connect counts like ten.
    """

    iterations: int = 100
    step: float = 0.04
    joint_step: float = 0.05
    extension: float = 0.8
    shortcuts: int = 40
    nodes: int = 120
    checks: int = 150


def unwound(q: Vector, reference: Vector, angle: Indices | int) -> Vector:
    """`q` with the pelvis's angles (their places in q are `angle`) taken within half a turn of the reference's."""
    result = np.array(np.broadcast_to(q, np.broadcast_shapes(q.shape, reference.shape)))
    result[..., angle] -= 2 * np.pi * np.round((q[..., angle] - reference[..., angle]) / (2 * np.pi))
    return result


def line(chart: AnyChart, a: Vector, b: Vector, step: float) -> Vector:
    """Points from `a` (left out) to `b` in chart coordinates, no farther apart than `step` when scaled."""
    count = max(1, int(np.ceil(np.linalg.norm((b - a) * chart.scale) / step)))
    result: Vector = a + (b - a) * (np.arange(1, count + 1) / count)[:, None]
    return result


def advance(
    manifold: Manifold, chart: AnyChart, a: Vector, b: Vector, search: Search, whole: bool = False
) -> tuple[Vector, bool]:
    """Goes along the straight line from a feasible chart point as far as it is feasible.

    Where a limb is nearly straight its joints move much farther than the chart's coordinates, so points are put in
    until neighbouring configurations are close too.

    Args:
        manifold: What makes a configuration feasible.
        chart: The chart.
        a: Where to start, shape (num_coordinates,); not checked.
        b: Where to, shape (num_coordinates,).
        search: How far apart checked points may be.
        whole: Whether nothing but the whole line is wanted; the answer may then end before the line has to.

    Returns:
        Feasible points from `a` on, itself included, shape (K, num_coordinates), and whether the last is `b`.
    """
    u, arrives = np.concatenate([a[None], line(chart, a, b, search.step)]), True
    for last in (False,) * ROUNDS + (True,):
        q, reach = chart.expand(u)
        reach[0] = np.inf
        free = int(np.argmax(np.append(reach < manifold.margins.reach, True)))
        gaps = np.linalg.norm(np.diff(q[:free], axis=0), axis=1)
        if last:  # a gap that stays open is a jump
            free = min(free, 1 + int(np.argmax(np.append(gaps > 2 * search.joint_step, True))))
        if free < len(u):
            u, q, gaps, arrives = u[:free], q[:free], gaps[: free - 1], False
            if whole:
                return u, False
        pieces = np.maximum(np.ceil(gaps / search.joint_step), 1).astype(int)
        if last or (pieces == 1).all():
            break
        number = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        parts = np.repeat(np.diff(u, axis=0) / pieces[:, None], pieces, axis=0)
        u = np.concatenate([np.repeat(u[:-1], pieces, axis=0) + number[:, None] * parts, u[-1:]])
    # A coarse look settles most failures at a quarter of the cost.
    for every in (max(1, len(u) // 6), 1):
        bad = np.flatnonzero(manifold.slack(q[every : len(u) : every]) < 0)
        if len(bad):
            u, arrives = u[: every * (1 + int(bad[0]))], False
            if whole:
                return u, False
    if manifold.body.robot.weak:
        q = chart.expand(u)[0]
        for every in (max(1, len(u) // 6), 1):
            bad = np.flatnonzero(~manifold.carried(q[every : len(u) : every]))
            if len(bad):
                u, arrives = u[: every * (1 + int(bad[0]))], False
                if whole:
                    break
    return u, arrives


def clear(manifold: Manifold, chart: AnyChart, a: Vector, b: Vector, search: Search | None = None) -> bool:
    """Whether the straight line between two feasible chart points is feasible at every checked point."""
    return advance(manifold, chart, a, b, search or Search(), whole=True)[1]


class _Tree:
    """A tree of chart points, or one from each of several roots, grown towards targets."""

    def __init__(self, roots: list[Vector], capacity: int) -> None:
        self.size = len(roots)
        self.u = np.empty((capacity + self.size, len(roots[0])))
        self.u[: self.size] = roots
        self.parent = np.full(len(self.u), -1, dtype=np.int64)

    def grow(self, manifold: Manifold, chart: AnyChart, target: Vector, search: Search) -> tuple[int, bool]:
        """Grows from the nearest node as far towards `target` as is feasible: the new node (-1: none), and arrival."""
        distances = np.linalg.norm((self.u[: self.size] - target) * chart.scale, axis=1)
        near = int(distances.argmin())
        limited = min(1.0, search.extension / max(distances[near], 1e-12))
        goal = self.u[near] + limited * (target - self.u[near])
        points, arrived = advance(manifold, chart, self.u[near], goal, search)
        if len(points) == 1 or self.size == len(self.u):
            return -1, False
        self.u[self.size], self.parent[self.size] = points[-1], near
        self.size += 1
        return self.size - 1, arrived and limited == 1.0

    def branch(self, node: int) -> list[Vector]:
        """Points from `node`'s root to it."""
        chain = []
        while node >= 0:
            chain.append(self.u[node])
            node = int(self.parent[node])
        return chain[::-1]


def connect(
    manifold: Manifold, chart: AnyChart, a: Vector, b: Vector, rng: np.random.Generator, search: Search
) -> Vector | None:
    """RRT-Connect between two feasible points of one chart; corners of the path, or None.

    The path may end at a point other than `b` that is the same posture, see `Chart.turns`.
    """
    ends = chart.turns(b)
    for end in ends:
        if clear(manifold, chart, a, end, search):
            return np.array([a, end])
    lower, upper = chart.bounds(a, b)
    here, there = _Tree([a], 2 * search.iterations + 2), _Tree(ends, 2 * search.iterations + 2)
    for turn in range(search.iterations):
        node, _ = here.grow(manifold, chart, rng.uniform(lower, upper), search)
        arrived = False
        while node >= 0 and not arrived:
            other, arrived = there.grow(manifold, chart, here.u[node], search)
            if other < 0:
                break
        if arrived:
            one, two = here.branch(node), there.branch(other)
            if turn % 2:  # the trees have changed places
                one, two = two, one
            return np.array(one + two[-2::-1])
        here, there = there, here
    return None


def shortened(manifold: Manifold, leg: Leg, rng: np.random.Generator, search: Search) -> Leg:
    """Replaces stretches of a feasible polyline by straight lines where these are feasible."""
    chart, u = leg.chart, leg.u
    for attempt in range(search.shortcuts):
        if len(u) < 3:
            break
        if attempt % 2:  # a corner left out
            i = int(rng.integers(1, len(u) - 1))
            if clear(manifold, chart, u[i - 1], u[i + 1], search):
                u = np.delete(u, i, axis=0)
            continue
        lengths = np.linalg.norm(np.diff(u, axis=0) * chart.scale, axis=1)
        along = np.append(0.0, np.cumsum(lengths))
        s, t = np.sort(rng.uniform(0.0, along[-1], 2))
        i, j = (min(int(np.searchsorted(along, x, "right")) - 1, len(lengths) - 1) for x in (s, t))
        if i == j:
            continue
        p, r = (u[k] + (x - along[k]) / lengths[k] * (u[k + 1] - u[k]) for k, x in ((i, s), (j, t)))
        if clear(manifold, chart, p, r, search):
            u = np.concatenate([u[: i + 1], [p, r], u[j + 1 :]])
    return Leg(chart, u)
