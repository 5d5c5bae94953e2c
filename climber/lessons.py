"""What a failed motion teaches the task planner.

Gönen 2021 deletes the move from the graph. A stance's feasible set may have several pieces, though, and that one of
them is a dead end says nothing against the others (Bretl 2006): so the stance is split, and the move barred only from
the piece it was tried from. It is cut when there is no piece left to try it from.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from climber.motion import DeadEnd, EmptyPiece
from climber.pieces import REST, Choice
from climber.plan_parts import Cut
from climber.stance import Move, Stance, Vector
from climber.stance_graph import StanceGraph
from climber.states import Integers
from climber.task import TaskPlanner, Walk
from climber.transitions import MoveFailure

OnFailure = Literal["refine", "cut", "penalise"]
PENALTY = 1000  # what a failed move costs more under "penalise"
PATIENCE = 3  # failures under "penalise" after which a move is cut all the same


@dataclass
class Lessons:
    """Tells a task planner what failed motions of one robot taught, and remembers the pieces of stances.

    Attributes:
        graph: The robot's stance graph.
        tasks: The task planner.
        on_failure: What to do about a motion that failed.
        robot: The robot's number in the task planner.
        cuts: The failures so far, the latest last.
        removed: By edge that was cut, the number of the failure it was cut for.
    """

    graph: StanceGraph
    tasks: TaskPlanner
    on_failure: OnFailure = "refine"
    robot: int = 0
    cuts: Sequence[Cut] = ()
    removed: dict[int, int] = field(default_factory=dict)
    _seeds: dict[int, list[tuple[Stance, Vector]]] = field(default_factory=lambda: defaultdict(list))
    _bars: dict[int, list[tuple[int, bool]]] = field(default_factory=lambda: defaultdict(list))
    _failures: dict[int, int] = field(default_factory=lambda: defaultdict(int))

    def choices(self, walk: Walk, stances: Sequence[Stance]) -> dict[int, Choice]:
        """The pieces that a walk through `stances` means, by how many moves are complete.

        A stance that is only the mirror of the one whose pieces are known is left free; if that fails, it is found out.
        """
        result = {}
        for i, (vertex, component, stance) in enumerate(zip(walk.vertices, walk.components, stances, strict=True)):
            known = self._seeds[vertex]
            if component is not None and all(seen == stance for seen, _ in known):
                result[i] = Choice(np.array([seed for _, seed in known]), component)
        return result

    def no_posture(self, walk: Walk, failure: MoveFailure) -> None:
        """A limb cannot let go, or take hold, in any posture of a stance: no move that asks it to is possible."""
        graph, edges = self.graph, walk.edges
        if failure.index == len(edges):  # the stance cannot be stood on as its goal asks
            self._cut(np.flatnonzero(graph.head == walk.vertices[-1]))
            return
        edge = edges[failure.index]
        if failure.end == "leave":
            same = (graph.tail == graph.tail[edge]) & (graph.released == graph.released[edge])
        elif failure.end == "arrive":
            same = (graph.head == graph.head[edge]) & (graph.taken == graph.taken[edge])
        else:  # a region on the way is out of the stance's reach: it is no way to visit it
            same = graph.head == graph.tail[edge]
        self._cut(np.flatnonzero(same))

    def dead_end(self, walk: Walk, dead: DeadEnd) -> None:
        """No motion leads on from the postures the robot can be in."""
        index = dead.failure.index
        vertex, component = walk.vertices[index], walk.components[index]
        edge = walk.edges[index] if dead.purpose != "region" else None
        if self.on_failure == "penalise" and edge is not None:
            self._failures[edge] += 1
            if self._failures[edge] < PATIENCE:
                self.tasks.penalise([edge], PENALTY, robot=self.robot)
                return
        after = walk.components[index + 1] if dead.purpose == "swing" else None
        if self.on_failure != "refine":
            self._cut(np.array([walk.edges[min(index, len(walk.edges) - 1)] if edge is None else edge]))
            return
        if component is None and dead.whole and edge is not None:
            # From wherever in the stance: no piece of it is to be told apart.
            if after is None:
                self._cut(np.array([edge]))
            else:
                self._bar(walk.vertices[index + 1], after, edge, leaving=False)
            return
        if component is None or component == REST:
            stance = Stance(tuple(contact.hold for contact in dead.contacts))
            component = self._carve(vertex, stance, dead.reached[0])
        if component is None:  # as many pieces as there may be
            self._cut(np.array([walk.edges[index - 1] if edge is None else edge]))
        elif edge is None:
            self._bar_arrivals(vertex, component)
        else:
            self.tasks.forbid(self.robot, edge, component, after)

    def empty_piece(self, walk: Walk, empty: EmptyPiece) -> None:
        """A piece holds no posture of the kind needed."""
        component = walk.components[empty.index]
        assert component is not None
        if empty.missing == "start":
            self.tasks.forbid_start(self.robot, component)
        elif empty.missing == "swing":
            edge = walk.edges[empty.index - 1]
            self._bar(walk.vertices[empty.index], component, edge, leaving=False)
        elif empty.missing == "let go":
            edge = walk.edges[empty.index]
            self._bar(walk.vertices[empty.index], component, edge, leaving=True)
        else:
            self._bar_arrivals(walk.vertices[empty.index], component)

    def moves_removed(self) -> list[list[Move]]:
        """For each failure, the moves that were cut for it."""
        moves: list[list[Move]] = [[] for _ in self.cuts]
        for edge, number in self.removed.items():
            start = Stance(tuple(self.graph.stances[self.graph.tail[edge]].tolist()))
            moves[number].append(Move(start, int(self.graph.limb[edge]), int(self.graph.taken[edge])))
        return moves

    def reached(self) -> list[Stance]:
        """The stances that can be reached by what the task planner, when last asked, had left."""
        vertices = self.tasks.layers[self.robot].reached_vertices()
        return [Stance(tuple(holds)) for holds in self.graph.stances[vertices].tolist()]

    def _carve(self, vertex: int, stance: Stance, seed: Vector) -> int | None:
        """Tells the piece around `seed` apart from the rest; its number, or None if there are too many already."""
        count = self.tasks.split(self.robot, vertex)
        if count is None:
            return None
        self._seeds[vertex].append((stance, seed))
        if count > 2:
            # What was barred from all the rest is barred from this part of it too.
            for edge, leaving in self._bars[vertex]:
                self.tasks.forbid(self.robot, edge, count - 1 if leaving else None, None if leaving else count - 1)
        return count - 1

    def _bar_arrivals(self, vertex: int, component: int) -> None:
        """Bars a piece from being arrived in, since it is no way to where the stance is wanted for."""
        for edge in np.flatnonzero(self.graph.head == vertex).tolist():
            self._bar(vertex, component, edge, leaving=False)
        if vertex == self.graph.start:
            self.tasks.forbid_start(self.robot, component)

    def _bar(self, vertex: int, component: int, edge: int, *, leaving: bool) -> None:
        """Bars an edge from leaving a component of its tail, or from arriving in one of its head."""
        self.tasks.forbid(self.robot, edge, component if leaving else None, None if leaving else component)
        if component == REST:
            self._bars[vertex].append((edge, leaving))

    def _cut(self, edges: Integers) -> None:
        self.tasks.cut(edges, robot=self.robot)
        for edge in edges.tolist():
            self.removed.setdefault(edge, len(self.cuts) - 1)
