"""A roadmap of a stance's feasible set: postures of every bend of the limbs, and ways between them.

The feasible set of a stance comes in pieces, and from one end of a phase to the other the way may lead through several
of them (Bretl 2006, section 3.2). A roadmap spans them: its nodes are sampled postures, its edges join two that bend
all holding limbs alike, or all but one. An edge is looked at only when it lies on the shortest way (Bohlin and Kavraki,
Path planning using lazy PRM, ICRA 2000): first as a straight line in its chart and, if that fails and no way round is
much shorter, by RRT-Connect.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.csgraph import csgraph_from_dense, dijkstra

from climber.manifold import Manifold
from climber.robot import Indices
from climber.rrt import Leg, Search, clear, connect, shortened, unwound
from climber.stance import Vector
from climber.transition import PostureSampler, spread

DRAWN = 4000  # pelvis poses drawn for the nodes
FLIP = 1.0  # [rad] what flipping an elbow adds to an edge's length
POWER = 1.5  # an edge weighs its length to this power: two short edges sooner than a long one
DOUBT = 10.0  # an edge whose straight line failed weighs so much more
LAST_RESORT = 40  # samples of RRT-Connect for such an edge
EFFORT = 10  # checks that it counts as

Edge = tuple[int, int]  # nodes, the smaller first


@dataclass(frozen=True)
class _Nodes:
    """Configurations (N, nq) and the branches of their holding limbs (N, num_holding)."""

    q: Vector
    branches: Indices

    def joined(self, other: _Nodes) -> _Nodes:
        return _Nodes(np.concatenate([self.q, other.q]), np.concatenate([self.branches, other.branches]))

    def weights(self, other: _Nodes, angle: Indices) -> Vector:
        """Weights of the edges to other nodes, shape (N, M); inf where more than one limb bends differently."""
        here = self.q[:, None]
        length = np.linalg.norm(unwound(other.q[None], here, angle) - here, axis=2) + 1e-9
        flipped = (self.branches[:, None] != other.branches[None]).sum(axis=2)
        result: Vector = np.where(flipped <= 1, (length + FLIP * flipped) ** POWER, np.inf)
        return result


class Roadmap:
    """Postures on a manifold and ways between them, remembered from one search to the next.

    Attributes:
        manifold: The manifold.
        search: How hard to look.
    """

    def __init__(self, manifold: Manifold, rng: np.random.Generator, search: Search | None = None) -> None:
        self.manifold, self.search, self._rng = manifold, search or Search(), rng
        self._holding = sorted(manifold.points)
        self._angle = manifold.body.robot.angle_q
        q, branches, _, _ = PostureSampler(manifold.body, manifold).draw(rng, DRAWN)
        branches = branches[:, self._holding]
        chosen = spread(
            branches, -np.arange(float(len(q))), self.search.nodes
        )  # in the random order they were drawn in
        self._nodes = _Nodes(q[chosen], branches[chosen])
        self._weight = self._nodes.weights(self._nodes, self._angle)
        np.fill_diagonal(self._weight, np.inf)
        self._doubted: set[Edge] = set()
        self._known: dict[Edge, Leg] = {}

    def path(self, a: Vector, b: Vector) -> list[Leg] | None:
        """A feasible path from `a` to `b`, up to whole turns of the pelvis, or None when the checks are used up."""
        n = len(self._nodes.q)
        ends = np.array([a, b])
        bends = np.array([self.manifold.body.branches(x) for x in ends], dtype=np.int64)[:, self._holding]
        nodes = self._nodes.joined(_Nodes(ends, bends))
        weight = np.full((n + 2, n + 2), np.inf)
        weight[:n, :n] = self._weight
        weight[n:] = _Nodes(ends, bends).weights(nodes, self._angle)
        weight[:, n:] = weight[n:].T
        np.fill_diagonal(weight, np.inf)
        way = self._search(nodes, weight)
        legs = None if way is None else self._legs(way, a)
        # What was found out between the roadmap's own nodes stays.
        self._weight = weight[:n, :n]
        self._doubted = {edge for edge in self._doubted if max(edge) < n}
        self._known = {edge: leg for edge, leg in self._known.items() if max(edge) < n}
        return legs

    def _search(self, nodes: _Nodes, weight: Vector) -> list[int] | None:
        """The nodes along a way from the last node but one to the last, all edges known; `weight` learns."""
        start, goal = len(weight) - 2, len(weight) - 1
        checks = 0
        graph = csgraph_from_dense(weight, null_value=np.inf)  # made once: Dijkstra would do so every time
        while checks < self.search.checks:
            distance, before = dijkstra(graph, indices=start, return_predecessors=True)
            if not np.isfinite(distance[goal]):
                return None
            way = [goal]
            while way[-1] != start:
                way.append(int(before[way[-1]]))
            way.reverse()
            open_edges = [edge for edge in map(_edge, itertools.pairwise(way)) if edge not in self._known]
            if not open_edges:
                return way
            # The edge likeliest to fail first.
            edge = max(open_edges, key=lambda e: float(weight[e]))
            hard = edge in self._doubted
            checks += EFFORT if hard else 1
            leg = self._leg(nodes, edge, hard)
            if leg is not None:
                self._known[edge] = leg
                continue
            self._doubted.add(edge)
            weight[edge] = weight[edge[::-1]] = np.inf if hard else DOUBT * weight[edge]
            graph[edge] = graph[edge[::-1]] = weight[edge]
        return None

    def _leg(self, nodes: _Nodes, edge: Edge, hard: bool) -> Leg | None:
        """The way between two nodes, straight or, if that is known to fail, by RRT-Connect."""
        i, j = edge
        a, b = nodes.q[i], unwound(nodes.q[j], nodes.q[i], self._angle)
        turning = np.flatnonzero(nodes.branches[i] != nodes.branches[j])
        chart = self.manifold.chart(a, self._holding[turning[0]] if len(turning) else None)
        start, end = chart.coordinates(a), chart.coordinates(b)
        if not hard:
            return Leg(chart, np.array([start, end])) if clear(self.manifold, chart, start, end, self.search) else None
        u = connect(self.manifold, chart, start, end, self._rng, replace(self.search, iterations=LAST_RESORT))
        return None if u is None else Leg(chart, u)

    def _legs(self, way: list[int], a: Vector) -> list[Leg]:
        """The legs along a way, the first from `a`, joined where one chart contains several, and shortened."""
        result: list[Leg] = []
        q = a
        for pair in itertools.pairwise(way):
            leg = self._known[_edge(pair)]
            u = leg.u if pair[0] < pair[1] else leg.u[::-1]
            # The pelvis may have turned round since.
            turned = leg.chart.free[self._angle]  # (num_angles, num_coordinates)
            first = leg.chart.expand(u[:1])[0][0]
            leg = Leg(leg.chart, u + (unwound(first, q, self._angle) - first)[self._angle] @ turned)
            q = leg.chart.expand(leg.u[-1:])[0][0]
            one = self._joined(result[-1], leg) if result else None
            if one is None:
                result.append(leg)
            else:
                result[-1] = one
        return [shortened(self.manifold, leg, self._rng, self.search) for leg in result]

    def _joined(self, one: Leg, two: Leg) -> Leg | None:
        """Two legs that follow each other as a single one, if the chart of either contains both."""
        if one.chart.root == two.chart.root:
            # All limbs but the root bend the same way throughout each leg, and where they meet.
            return Leg(one.chart, np.concatenate([one.u, two.u[1:]]))
        for chart, other in ((one.chart, two), (two.chart, one)):
            if chart.root is None or other.chart.root is not None:
                continue
            u = chart.coordinates(other.chart.expand(other.u)[0])
            if all(clear(self.manifold, chart, p, r, self.search) for p, r in itertools.pairwise(u)):
                return Leg(chart, np.concatenate([one.u, u[1:]] if other is two else [u, two.u[1:]]))
        return None


def _edge(pair: tuple[int, int]) -> Edge:
    return min(pair), max(pair)
