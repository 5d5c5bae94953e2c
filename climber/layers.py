"""Which moves can lie on a climb of so many moves, and what each is worth: the numbers behind the task program.

A vertex can matter after t of T moves only if it is at most t moves from the start and at most T - t from a goal. Only
such pairs, and the edges between them, are handed to the solver, and each only once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from climber.exceptions import ClimberError

Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

FAR = np.iinfo(np.int64).max // 4  # no way at all; a quarter, so that sums of it cannot overflow
MOST = np.iinfo(np.int32).max  # clingo's largest number and weight
UNWEIGHED = -1


@dataclass
class Layer:
    """What may be move t, for one t.

    Attributes:
        edges: The edges, in the order they were given to the solver, shape (n,).
        weights: What the solver counts for each [cost units], shape (n,); `UNWEIGHED` before `Layers.reweigh`.
        parts: Where each part starts that was given to the solver in one go.
    """

    edges: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    weights: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    parts: list[int] = field(default_factory=list)

    def part(self, number: int) -> slice:
        """The moves of one part; -1 is the newest."""
        number %= len(self.parts)
        bounds = [*self.parts, len(self.edges)]
        return slice(bounds[number], bounds[number + 1])


class Layers:
    """A directed graph, unrolled over the number of moves as far as it can matter.

    Args:
        num_vertices: Vertices are 0 ... num_vertices - 1.
        tail: Where each edge starts, shape (num_edges,). Parallel edges and loops are allowed.
        head: Where each edge ends, shape (num_edges,).
        cost: Non-negative integer cost of each edge, shape (num_edges,).
        start: The vertex a walk starts from.
        goals: The vertices a walk may end on.

    Raises:
        ValueError: If arrays differ in length, or a number is out of range.
    """

    def __init__(
        self, num_vertices: int, tail: ArrayLike, head: ArrayLike, cost: ArrayLike, start: int, goals: Iterable[int]
    ) -> None:
        self.num_vertices = num_vertices
        self.tail = integers(tail, "tail")
        self.head = integers(head, "head")
        self.cost = integers(cost, "cost").copy()
        if not len(self.tail) == len(self.head) == len(self.cost):
            lengths = f"{len(self.tail)}, {len(self.head)} and {len(self.cost)}"
            raise ValueError(f"tail, head and cost have {lengths} entries; they must be one per edge")
        self.start = int(_within([start], num_vertices, "start")[0])
        self.goals: Integers = np.unique(_within(list(goals), num_vertices, "goals"))
        _within(self.tail, num_vertices, "tail")
        _within(self.head, num_vertices, "head")
        if len(self.cost) and self.cost.min() < 0:
            raise ValueError(f"cost has the entry {self.cost.min()}; costs must not be negative")

        self.usable: Booleans = np.ones(len(self.tail), bool)
        self.layers: list[Layer] = []  # layers[t - 1] is move t
        self.ends: dict[int, int] = {}  # what ending on a goal counts, for the goals within the last horizon weighed
        self._given_until: Integers = np.full(num_vertices, -1)  # a vertex's pairs are given up to this t
        self._given_until[self.start] = 0
        self._out = _rows(self.tail, num_vertices)
        self._into = _rows(self.head, num_vertices)
        self.measure()

    def measure(self) -> None:
        """Fewest moves from the start and to the nearest goal, over the edges that are still usable."""
        self.from_start = self._distances(np.array([self.start]), *self._out, self.head)
        self.to_goal = self._distances(self.goals, *self._into, self.tail)

    @property
    def shortest(self) -> int:
        """The fewest moves from the start to a goal; `FAR` if there is no way."""
        return int(self.to_goal[self.start])

    def grow(self, horizon: int) -> list[int]:
        """Adds the moves that can lie on a walk of `horizon` moves and are not there yet.

        All edges into a pair (vertex, t) come with the pair: where they come from is at most t - 1 moves from the start
        whatever the horizon, and cuts only take edges away. So the rules of a pair never need to be extended.

        Returns:
            The t whose layers have a new part, ascending.

        Raises:
            ClimberError: If the cost of so many moves could be more than the solver can count. Nothing is added then.
        """
        dearest = int(self.cost[self.usable].max(initial=0))
        if horizon * dearest > MOST:
            raise ClimberError(f"{horizon} moves of cost {dearest} add up to more than the solver counts, {MOST}")
        first = np.maximum(self.from_start[self.tail], self._given_until[self.head]) + 1
        last = horizon - self.to_goal[self.head]
        edges = np.flatnonzero(self.usable & (first <= last))
        counts = (last - first + 1)[edges]
        # The t of each new move: first, first + 1, ..., last, edge by edge.
        ends = np.cumsum(counts)
        steps = np.arange(ends[-1] if len(ends) else 0) + np.repeat(first[edges] - (ends - counts), counts)
        edges = np.repeat(edges, counts)
        order = np.argsort(steps, kind="stable")
        edges, steps = edges[order], steps[order]

        relevant = self.from_start + self.to_goal <= horizon
        self._given_until[relevant] = np.maximum(self._given_until, horizon - self.to_goal)[relevant]
        while len(self.layers) < horizon:
            self.layers.append(Layer())
        numbers, starts = np.unique(steps, return_index=True)
        for t, new in zip(numbers.tolist(), np.split(edges, starts[1:]), strict=False):
            layer = self.layers[t - 1]
            layer.parts.append(len(layer.edges))
            layer.edges = np.concatenate([layer.edges, new])
            layer.weights = np.concatenate([layer.weights, np.full(len(new), UNWEIGHED)])
        result: list[int] = numbers.tolist()
        return result

    def reweigh(self, horizon: int, potentials: bool = True) -> list[tuple[int, Integers, Integers]]:
        """Sets what the solver counts for each move: its cost less what the potential rises along it.

        Give every pair (v, t) a number p(v, t). Counting cost + p(tail, t - 1) - p(head, t) for a move, and p(goal, T)
        for ending there, changes nothing about any whole walk: its inner p cancel, and p(start, 0) = 0. So the count of
        a walk is its cost and the solver's proof is a proof about costs, whatever p is. What a good p does is to make
        that proof short. Here p is the least cost from the start over the moves given, so no count is negative, and a
        move that is not on a cheapest way to its head shows it. On bare costs the solver would have to rule out walks
        one by one, and their number is exponential in T.

        Args:
            horizon: Number of moves T.
            potentials: False counts bare costs.

        Returns:
            For each layer with moves whose weight differs from what it was: t, their positions in the layer, and by how
            much they rise. Moves that had no weight before are left out.
        """
        changes = []
        before = np.full(self.num_vertices, FAR)
        before[self.start] = 0
        for t, layer in enumerate(self.layers[:horizon], start=1):
            tails, heads, costs = self.tail[layer.edges], self.head[layer.edges], self.cost[layer.edges]
            after = np.full(self.num_vertices, FAR)
            # What cannot be reached cannot be made, now or later: its weight is of no account.
            possible = self.usable[layer.edges] & (before[tails] < FAR)
            np.minimum.at(after, heads[possible], (before[tails] + costs)[possible])
            weights = np.where(possible, before[tails] - after[heads] + costs if potentials else costs, 0)
            positions = np.flatnonzero((layer.weights != UNWEIGHED) & possible & (weights != layer.weights))
            if len(positions):
                changes.append((t, positions, (weights - layer.weights)[positions]))
            layer.weights = np.where(possible | (layer.weights == UNWEIGHED), weights, layer.weights)
            before = after
        ends = self.goals[before[self.goals] < FAR]
        totals = before[ends]
        self.ends = dict(zip(ends.tolist(), (totals if potentials else 0 * totals).tolist(), strict=True))
        return changes

    def _distances(self, sources: Integers, bounds: Integers, edges: Integers, ends: Integers) -> Integers:
        """Breadth-first distances from `sources` along the usable edges, shape (num_vertices,); `FAR` if unreached.

        Args:
            sources: Vertices at distance 0.
            bounds: Vertex v has the edges `edges[bounds[v]:bounds[v + 1]]`.
            edges: Edge numbers, by vertex.
            ends: The far end of each edge, by edge number.
        """
        distances = np.full(self.num_vertices, FAR)
        distances[sources] = 0
        last_place = np.empty(self.num_vertices, np.int64)
        frontier, distance = sources, 0
        while len(frontier):
            distance += 1
            counts = bounds[frontier + 1] - bounds[frontier]
            stops = np.cumsum(counts)
            places = np.arange(stops[-1]) + np.repeat(bounds[frontier] - (stops - counts), counts)
            leaving = edges[places]
            found = ends[leaving[self.usable[leaving]]]
            found = found[distances[found] == FAR]
            distances[found] = distance
            # A vertex found several times is kept once: where its place was written last.
            places = np.arange(len(found))
            last_place[found] = places
            frontier = found[last_place[found] == places]
        return distances


def _rows(vertices: Integers, num_vertices: int) -> tuple[Integers, Integers]:
    """Edges by vertex: the edges of v are `order[bounds[v]:bounds[v + 1]]`."""
    order = np.argsort(vertices, kind="stable").astype(np.int64)
    bounds = np.concatenate([[0], np.cumsum(np.bincount(vertices, minlength=num_vertices))]).astype(np.int64)
    return bounds, order


def integers(values: ArrayLike, name: str) -> Integers:
    """The values as an array of integers; `name` is what an error calls them.

    Raises:
        ValueError: If they are not a row of integers.
    """
    array = np.asarray(values)
    if array.ndim != 1 or (len(array) and array.dtype.kind not in "iu"):
        raise ValueError(f"{name} has shape {array.shape} and type {array.dtype}; it must be a row of integers")
    return array.astype(np.int64)


def _within(values: Sequence[int] | Integers, num_vertices: int, name: str) -> Integers:
    array = integers(values, name)
    if len(array) and (array.min() < 0 or array.max() >= num_vertices):
        raise ValueError(f"{name} reaches from {array.min()} to {array.max()}; vertices are 0 to {num_vertices - 1}")
    return array
