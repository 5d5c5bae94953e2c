"""Paths on manifolds that no single chart covers: RRT-Connect over local charts (Jaillet and Porta's atlas).

Every node of a tree has the chart around it, made when the node is first grown from. A path through nodes is then cut
into as few legs as possible, each in the chart of its first point, for a robot stops where it changes charts.
"""

from __future__ import annotations

import numpy as np

from climber.manifold import Manifold
from climber.newton import NewtonChart
from climber.rrt import Leg, Search, advance, clear, shortened
from climber.stance import Vector

SAME = 1e-8  # [m, rad] configurations nearer to each other than this are one
DRIFT = 1e-6  # [m, rad] a chart that gives a configuration back this closely contains it
GROWTH = 0.6  # how far an edge goes in the coordinates of the chart it starts in


class _Tree:
    """Configurations, each with the chart around it."""

    def __init__(self, manifold: Manifold, root: Vector) -> None:
        self._manifold = manifold
        self.q, self.parent = [root], [-1]
        self._charts: dict[int, NewtonChart] = {}

    def chart(self, node: int) -> NewtonChart:
        """The chart around a node."""
        if node not in self._charts:
            self._charts[node] = self._manifold.newton_chart(self.q[node])
        return self._charts[node]

    def grow(self, target: Vector, scale: Vector, search: Search) -> tuple[int, bool]:
        """Grows from the nearest node towards the configuration `target`: the new node (-1: none), and arrival."""
        near = int(np.linalg.norm((np.array(self.q) - target) * scale, axis=1).argmin())
        chart = self.chart(near)
        goal = chart.coordinates(target)
        far = float(np.linalg.norm(goal))
        if far < SAME:
            return (near, True) if np.abs(self.q[near] - target).max() < DRIFT else (-1, False)
        points, _ = advance(self._manifold, chart, np.zeros(len(goal)), goal * min(1.0, GROWTH / far), search)
        if len(points) == 1:
            return -1, False
        reached = chart.expand(points[-1:])[0][0]
        self.q.append(reached)
        self.parent.append(near)
        arrived = np.abs(reached - target).max() < DRIFT
        if arrived:
            self.q[-1] = target
        return len(self.q) - 1, bool(arrived)

    def branch(self, node: int) -> list[Vector]:
        """Configurations from the root to a node."""
        chain = []
        while node >= 0:
            chain.append(self.q[node])
            node = self.parent[node]
        return chain[::-1]


def atlas_path(manifold: Manifold, a: Vector, b: Vector, rng: np.random.Generator, search: Search) -> list[Leg] | None:
    """A feasible path between two feasible configurations, see `climber.path.find_path`."""
    chart = manifold.newton_chart(a)
    if np.abs(a - b).max() < SAME:
        still = chart.coordinates(a)
        return [Leg(chart, np.array([still, still]))]
    if manifold.rigid:
        return None
    through = _search(manifold, a, b, rng, search)
    return None if through is None else _legs(manifold, through, rng, search)


def _search(manifold: Manifold, a: Vector, b: Vector, rng: np.random.Generator, search: Search) -> list[Vector] | None:
    """Configurations from a to b, each in the chart of the one before or after it."""
    robot = manifold.body.robot
    scale = np.ones(len(a))
    scale[robot.origin_q] = 2.0 / robot.reach.mean()
    lower, upper = np.minimum(a, b) - 0.9 / scale, np.maximum(a, b) + 0.9 / scale
    for limb in robot.limbs:
        lower[limb.q], upper[limb.q] = limb.one_turn
    here, there = _Tree(manifold, a), _Tree(manifold, b)
    target = b
    for _ in range(search.iterations):
        node, arrived = here.grow(target, scale, search)
        other = 0 if arrived and there.q[0] is target else -1
        if node >= 0 and not arrived:
            meeting = here.q[node]
            while True:
                other, arrived = there.grow(meeting, scale, search)
                if other < 0 or arrived:
                    break
        if arrived and other >= 0:
            one, two = here.branch(node), there.branch(other)
            if one[0] is not a:
                one, two = two, one
            return one + two[::-1][1:]
        here, there = there, here
        target = rng.uniform(lower, upper)
    return None


def _legs(manifold: Manifold, q: list[Vector], rng: np.random.Generator, search: Search) -> list[Leg] | None:
    """The configurations as polylines in as few charts as take them; None if no chart takes some step."""
    legs = []
    at = 0
    while at < len(q) - 1:
        best: tuple[int, NewtonChart, Vector] | None = None
        # A chart around the middle of a stretch takes more of it than one around its beginning.
        for centre in range(at, len(q)):
            chart = manifold.newton_chart(q[centre])
            u = chart.coordinates(np.array(q[at:]))
            found, slack = chart.expand(u)
            inside = (slack >= manifold.margins.reach) & (np.abs(found - np.array(q[at:])).max(axis=1) < DRIFT)
            count = 1
            if inside[0]:
                while count < len(u) and inside[count] and clear(manifold, chart, u[count - 1], u[count], search):
                    count += 1
            if count > 1 and (best is None or at + count - 1 > best[0]):
                best = at + count - 1, chart, u[:count]
            elif best is not None and centre > best[0]:
                break
        if best is None:
            return None
        end, chart, u = best
        legs.append(shortened(manifold, Leg(chart, u), rng, search))
        at = end
    return legs
