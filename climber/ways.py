"""One robot's nodes and the ways between them, for searches that go through positions of a whole team."""

from __future__ import annotations

import numpy as np

from climber.layers import Layers
from climber.states import Integers


class Ways:
    """The ways from each node of a robot to others, moves and waits, sorted by where they leave from.

    Attributes:
        tail: Node that each way leaves from, shape (num_ways,).
        head: Node that it leads to, shape (num_ways,).
        arc: The arc of the robot's states that it takes, shape (num_ways,).
        count: Number of nodes.
        first: The first way from each node, shape (count + 1,).
        starts: Nodes that the robot can start on.
        goals: Nodes that it may end on.
    """

    def __init__(self, layers: Layers) -> None:
        states, components = layers.states, layers.components
        joins = components.joins()
        whole = np.flatnonzero(layers.usable & (np.diff(joins.first) == 0))
        joined = np.flatnonzero(layers.usable[joins.arc] & joins.allowed)
        tail = np.concatenate([states.tail[whole], joins.tail[joined]])
        order = np.argsort(tail, kind="stable")
        self.tail: Integers = tail[order]
        self.head: Integers = np.concatenate([states.head[whole], joins.head[joined]])[order]
        self.arc: Integers = np.concatenate([whole, joins.arc[joined]])[order]
        self.count = components.num_nodes
        self.first: Integers = np.searchsorted(self.tail, np.arange(self.count + 1))
        self.starts, self.goals = components.start_nodes(), components.goal_nodes()

    def leaving(self, nodes: Integers) -> tuple[Integers, Integers]:
        """For each of `nodes` how many ways leave it, and those of all one after another."""
        counts = self.first[nodes + 1] - self.first[nodes]
        stops = np.cumsum(counts)
        way = np.arange(stops[-1] if len(stops) else 0) + np.repeat(self.first[nodes] - (stops - counts), counts)
        return counts, way
