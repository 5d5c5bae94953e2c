"""Stances that fall into components, and which components a move joins.

The postures of a stance may be several sets that no motion joins (Bretl 2006, sections 3.2 and 3.3). A stance that is
found to be so is split: whoever stands there is in exactly one component, and stays in it until the next move. What a
move can do may then depend on the component it leaves and on the one it arrives in.

Every state of a split vertex becomes one *node* for each component; everything else is its own node. A *join* is an arc
together with the components of both its ends, for those arcs that touch a split vertex.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from climber.states import Booleans, Integers, States

MOST_COMPONENTS = 6
WHOLE = -1  # in place of a component, of a vertex that is not split


class Join(NamedTuple):
    """An arc and the components of its ends, `WHOLE` where an end is not split."""

    arc: int
    leaving: int
    arriving: int


class Bar(NamedTuple):
    """What an edge must not do. None stands for any component."""

    edge: int
    leaving: int | None
    arriving: int | None


@dataclass
class Joins:
    """The joins as arrays, sorted by arc.

    Attributes:
        joins: The joins, k of them.
        arc: The arc of each, shape (k,).
        tail: The node it leaves, shape (k,).
        head: The node it arrives at, shape (k,).
        allowed: Whether nothing bars it, shape (k,).
        first: The joins of arc a are first[a] up to, not including, first[a + 1]; none for an arc that touches no split
            vertex.
    """

    joins: list[Join]
    arc: Integers
    tail: Integers
    head: Integers
    allowed: Booleans
    first: Integers

    def of_arcs(self, arcs: Integers) -> tuple[Integers, Integers]:
        """The joins of these arcs: for each, the place of its arc among `arcs`, and its number."""
        counts = self.first[arcs + 1] - self.first[arcs]
        place = np.repeat(np.arange(len(arcs)), counts)
        ends = np.cumsum(counts)
        number = np.arange(len(place)) + np.repeat(self.first[arcs] - (ends - counts), counts)
        return place, number


@dataclass
class Components:
    """The components of one robot's vertices.

    Attributes:
        states: The states of the robot.
        counts: How many components each split vertex has.
        bars: What is barred, in the order it was.
        start_bars: Components that the walk must not start in.
        num_nodes: Number of nodes. The first `states.num_states` are the states, in component 0 if split.
    """

    states: States
    counts: dict[int, int] = field(default_factory=dict)
    bars: list[Bar] = field(default_factory=list)
    start_bars: set[int] = field(default_factory=set)
    num_nodes: int = 0

    def __post_init__(self) -> None:
        self.num_nodes = self.states.num_states
        self._base: dict[tuple[int, int], int] = {}  # (vertex, component) -> its node in stage 0
        self._barred: dict[int, set[tuple[int | None, int | None]]] = {}
        self._joins: Joins | None = None

    def split(self, vertex: int) -> int | None:
        """Gives a vertex one component more, two the first time; None if it has as many as it can have."""
        count = self.counts.get(vertex, 1)
        if count == MOST_COMPONENTS:
            return None
        self._base[vertex, count] = self.num_nodes
        self.num_nodes += self.states.stages
        self.counts[vertex] = count + 1
        self._joins = None
        return count + 1

    def bar(self, bar: Bar) -> bool:
        """Takes note of a bar; False if it was known.

        Raises:
            ValueError: If it names a component that its vertex does not have.
        """
        self.check(int(self.states.edge_tail[bar.edge]), bar.leaving)
        self.check(int(self.states.edge_head[bar.edge]), bar.arriving)
        if bar in self.bars:
            return False
        self.bars.append(bar)
        self._barred.setdefault(bar.edge, set()).add((bar.leaving, bar.arriving))
        self._joins = None
        return True

    def check(self, vertex: int, component: int | None) -> None:
        """Raises ValueError if a vertex has no such component."""
        count = self.counts.get(vertex, 0)
        if component is not None and not 0 <= component < count:
            has = f"components 0 to {count - 1}" if count else "not been split"
            raise ValueError(f"component {component} of vertex {vertex}, which has {has}")

    def node(self, state: int, component: int) -> int:
        """The node of a state in a component, which may be `WHOLE`."""
        if component <= 0:
            return state
        vertex, stage = divmod(state, self.states.stages)
        return self._base[vertex, component] + stage

    def nodes(self, state: int) -> dict[int, int]:
        """The nodes of a state, by component; `WHOLE` if it is not split."""
        return {component: self.node(state, component) for component in self.of_vertex(state // self.states.stages)}

    def of_vertex(self, vertex: int) -> range:
        """The components of a vertex, `WHOLE` alone if it is not split."""
        count = self.counts.get(vertex, 0)
        return range(count) if count else range(WHOLE, WHOLE + 1)

    def states_of_nodes(self) -> Integers:
        """The state of every node, shape (num_nodes,)."""
        states = np.arange(self.num_nodes)
        for (vertex, _), base in self._base.items():
            states[base : base + self.states.stages] = self.states.of_vertex(vertex)
        return states

    def start_nodes(self) -> Integers:
        """The nodes that the walk may start from."""
        nodes = self.nodes(self.states.start)
        return np.array([node for c, node in nodes.items() if c not in self.start_bars], dtype=np.int64)

    def goal_nodes(self) -> Integers:
        """The nodes that the walk may end on."""
        if not self.counts:
            return self.states.goals
        return np.array([n for g in self.states.goals.tolist() for n in self.nodes(g).values()], dtype=np.int64)

    def joins(self) -> Joins:
        """All joins, as things stand."""
        if self._joins is None:
            self._joins = self._find_joins()
        return self._joins

    def _find_joins(self) -> Joins:
        states = self.states
        split = np.zeros(states.num_vertices, bool)
        split[list(self.counts)] = True
        joins: list[Join] = []
        allowed: list[bool] = []
        for edge in np.flatnonzero(split[states.edge_tail] | split[states.edge_head]).tolist():
            barred = self._barred.get(edge, set())
            sides = self.of_vertex(int(states.edge_tail[edge])), self.of_vertex(int(states.edge_head[edge]))
            for arc in states.arcs(edge).tolist():
                for leaving in sides[0]:
                    for arriving in sides[1]:
                        patterns = {(leaving, arriving), (leaving, None), (None, arriving), (None, None)}
                        joins.append(Join(arc, leaving, arriving))
                        allowed.append(not patterns & barred)
        if len(states.tail) > states.num_moves:
            for vertex in sorted(self.counts):
                for arc in states.waits(vertex).tolist():
                    joins += [Join(arc, component, component) for component in self.of_vertex(vertex)]
                    allowed += [True] * self.counts[vertex]
        arcs = np.array([join.arc for join in joins], dtype=np.int64)
        tails = [self.node(int(states.tail[join.arc]), join.leaving) for join in joins]
        heads = [self.node(int(states.head[join.arc]), join.arriving) for join in joins]
        first = np.concatenate([[0], np.cumsum(np.bincount(arcs, minlength=len(states.tail)))]).astype(np.int64)
        return Joins(joins, arcs, np.array(tails, np.int64), np.array(heads, np.int64), np.array(allowed, bool), first)
