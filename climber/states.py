"""What a robot is asked to do, and the states that takes: where it stands and which waypoints it has visited.

Standing on the same vertex with one waypoint more behind it is another state. So every waypoint, in any order or in a
given one, is part of one graph of states, in which distances and least costs are plain distances and least costs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from climber.exceptions import ClimberError

Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

WAIT = -1  # in place of an edge: the robot stays where it is for a step
MOST_ARCS = 100_000_000


@dataclass(frozen=True)
class RobotTask:
    """A walk to be planned for one robot.

    Attributes:
        num_vertices: Vertices are 0 ... num_vertices - 1.
        tail: Where each edge starts, shape (num_edges,). Parallel edges and loops are allowed.
        head: Where each edge ends, shape (num_edges,).
        cost: Non-negative integer cost of each edge, shape (num_edges,).
        start: The vertex the walk starts from.
        goals: The vertices it may end on; any number.
        holds: The holds that each vertex stands on, shape (num_vertices, n); needed in a team only. Hold numbers mean
            the same for every robot of the team.
        waypoints: For each waypoint, the vertices that count as visiting it. A vertex may count for several.
        ordered: True visits the waypoints in the order given, False in any order, whichever is best.
        avoid: Vertices that must not be stood on.
    """

    num_vertices: int
    tail: ArrayLike
    head: ArrayLike
    cost: ArrayLike
    start: int
    goals: Iterable[int]
    holds: ArrayLike | None = None
    waypoints: Sequence[ArrayLike] = ()
    ordered: bool = False
    avoid: ArrayLike = ()


class States:
    """The graph of states of one robot. State `vertex * stages + stage`, where `stage` says what has been visited.

    With waypoints in a given order `stage` counts them; in any order its bits are they. A waypoint is visited as soon
    as the robot stands on one of its vertices, several at once if the vertex counts for several: to have visited more
    is never worse.

    Args:
        task: What the robot is asked to do.
        waits: Whether the robot may also stay where it is for a step, at no cost. Arcs beyond the edges are these.

    Raises:
        ValueError: If arrays differ in length, or a number is out of range.
        ClimberError: If the waypoints make the graph too large.
    """

    def __init__(self, task: RobotTask, waits: bool = False) -> None:
        self.num_vertices = count = int(task.num_vertices)
        self.edge_tail = integers(task.tail, "tail")
        self.edge_head = integers(task.head, "head")
        cost = integers(task.cost, "cost")
        self.num_edges = len(self.edge_tail)
        if not len(self.edge_tail) == len(self.edge_head) == len(cost):
            lengths = f"{len(self.edge_tail)}, {len(self.edge_head)} and {len(cost)}"
            raise ValueError(f"tail, head and cost have {lengths} entries; they must be one per edge")
        start = int(within([task.start], count, "start")[0])
        goals = np.unique(within(list(task.goals), count, "goals"))
        within(self.edge_tail, count, "tail")
        within(self.edge_head, count, "head")
        if len(cost) and cost.min() < 0:
            raise ValueError(f"cost has the entry {cost.min()}; costs must not be negative")
        avoid = within(np.asarray(task.avoid, dtype=np.int64).reshape(-1), count, "avoid")
        if start in avoid:
            raise ValueError(f"the robot starts on vertex {start}, which it is to avoid")
        self.holds = None if task.holds is None else _matrix(task.holds, count)

        self.waypoints = [within(np.unique(np.asarray(w, np.int64)), count, "waypoints") for w in task.waypoints]
        self.ordered = task.ordered
        self.stages = len(self.waypoints) + 1 if task.ordered else 1 << len(self.waypoints)
        if self.stages * (self.num_edges + count) > MOST_ARCS:
            what = f"{len(self.waypoints)} waypoints among {self.num_edges} edges"
            raise ClimberError(f"{what} are more than can be planned for")
        following = self._following()  # (num_vertices, stages)

        self.num_states = count * self.stages
        stage = np.arange(self.stages)
        self.tail = (self.edge_tail[:, None] * self.stages + stage).ravel()
        self.head = (self.edge_head[:, None] * self.stages + following[self.edge_head]).ravel()
        self.cost = np.repeat(cost, self.stages)
        self.usable: Booleans = np.repeat(~np.isin(self.edge_head, avoid), self.stages)
        self.num_moves = len(self.tail)  # arcs that are moves; those beyond are waits
        if waits:
            every = np.arange(self.num_states)
            self.tail, self.head = np.concatenate([self.tail, every]), np.concatenate([self.head, every])
            self.cost = np.concatenate([self.cost, np.zeros_like(every)])
            self.usable = np.concatenate([self.usable, np.ones(self.num_states, bool)])
        self.start = start * self.stages + int(following[start, 0])
        self.goal_vertices = goals
        self.goals = goals * self.stages + self.stages - 1

    def vertices(self, states: Integers) -> Integers:
        """The vertices that the robot stands on in these states."""
        return states // self.stages

    def of_vertex(self, vertex: int) -> Integers:
        """The states that stand on a vertex, by stage."""
        return np.arange(vertex * self.stages, (vertex + 1) * self.stages)

    def arcs(self, edge: int) -> Integers:
        """The arcs that move along an edge, by stage."""
        return np.arange(edge * self.stages, (edge + 1) * self.stages)

    def waits(self, vertex: int) -> Integers:
        """The arcs that stay on a vertex, by stage."""
        return self.num_moves + self.of_vertex(vertex)

    def edge(self, arc: int) -> int:
        """The edge of an arc, or `WAIT`."""
        return arc // self.stages if arc < self.num_moves else WAIT

    def visited(self, state: int) -> list[int]:
        """The waypoints that are visited in this state."""
        stage = state % self.stages
        if self.ordered:
            return list(range(stage))
        return [waypoint for waypoint in range(len(self.waypoints)) if stage >> waypoint & 1]

    def _following(self) -> Integers:
        """The stage that arriving leads to, by vertex and the stage before, shape (num_vertices, stages)."""
        stages: Integers = np.broadcast_to(np.arange(self.stages), (self.num_vertices, self.stages)).copy()
        if self.ordered:
            for number in reversed(range(len(self.waypoints))):
                there = self.waypoints[number]
                stages[there, number] = stages[there, number + 1]
        else:
            for number, there in enumerate(self.waypoints):
                stages[there] |= 1 << number
        return stages


def integers(values: ArrayLike, name: str) -> Integers:
    """The values as an array of integers; `name` is what an error calls them.

    Raises:
        ValueError: If they are not a row of integers.
    """
    array = np.asarray(values)
    if array.ndim != 1 or (len(array) and array.dtype.kind not in "iu"):
        raise ValueError(f"{name} has shape {array.shape} and type {array.dtype}; it must be a row of integers")
    return array.astype(np.int64)


def within(values: Sequence[int] | Integers, num_vertices: int, name: str) -> Integers:
    """The values as an array of vertices.

    Raises:
        ValueError: If they are not integers, or not all vertices.
    """
    array = integers(values, name)
    if len(array) and (array.min() < 0 or array.max() >= num_vertices):
        raise ValueError(f"{name} reaches from {array.min()} to {array.max()}; vertices are 0 to {num_vertices - 1}")
    return array


def _matrix(holds: ArrayLike, num_vertices: int) -> Integers:
    array = np.asarray(holds)
    if array.ndim != 2 or len(array) != num_vertices or (array.size and array.dtype.kind not in "iu"):
        raise ValueError(f"holds has shape {array.shape}; it must have one row of hold numbers for each vertex")
    return array.astype(np.int64)
