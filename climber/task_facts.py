"""The functions that the logic programs call: each is named and explained at the head of the program that calls it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache

import clingo
import numpy as np
from clingo import Number, Symbol

from climber.components import MOST_COMPONENTS
from climber.layers import Layers
from climber.states import Integers


@lru_cache(1 << 16)
def number_symbol(number: int) -> Symbol:
    """The symbol of a number, made once: the same few come again and again."""
    return Number(number)


@dataclass
class Facts:
    """Answers the logic programs' questions. Nothing but numbers passes.

    Attributes:
        layers: What of each robot's graph matters.
        claims_: (state, hold, step) by robot, t and part.
        fresh_: (hold, step) likewise.
        rivals_: (robot, other robot, hold, step), of the part to be grounded next.
        refined_: (robot, state, t, vertex), likewise.
        resting_: (robot, arc, state, t), likewise.
    """

    layers: list[Layers]
    claims_: dict[tuple[int, int, int], Integers] = field(default_factory=dict)
    fresh_: dict[tuple[int, int, int], list[tuple[int, int]]] = field(default_factory=dict)
    rivals_: list[tuple[int, ...]] = field(default_factory=list)
    refined_: list[tuple[int, ...]] = field(default_factory=list)
    resting_: list[tuple[int, ...]] = field(default_factory=list)

    def robots(self) -> list[Symbol]:
        """Their numbers."""
        return [Number(robot) for robot in range(len(self.layers))]

    def start(self, robot: Symbol) -> Symbol:
        """The state that a robot starts in."""
        return Number(self.layers[robot.number].states.start)

    def goals(self, robot: Symbol) -> list[Symbol]:
        """All states that stand on a goal, whatever has been visited."""
        states = self.layers[robot.number].states
        return [Number(n) for goal in states.goal_vertices.tolist() for n in states.of_vertex(goal).tolist()]

    def arcs(self, robot: Symbol, t: Symbol, part: Symbol) -> list[Symbol]:
        """A part of a layer: arc, tail, head, weight."""
        layers = self.layers[robot.number]
        layer = layers.layers[t.number - 1]
        new = layer.part(part.number)
        arcs = layer.arcs[new]
        columns = (arcs, layers.states.tail[arcs], layers.states.head[arcs], layer.weights[new])
        return _tuples(np.column_stack(columns).tolist())

    def waypoints(self, robot: Symbol) -> list[Symbol]:
        """The numbers of a robot's waypoints."""
        return [Number(i) for i in range(len(self.layers[robot.number].states.waypoints))]

    def visited(self, robot: Symbol, state: Symbol) -> list[Symbol]:
        """Those that are visited in a state."""
        return [Number(i) for i in self.layers[robot.number].states.visited(state.number)]

    def claims(self, robot: Symbol, t: Symbol, part: Symbol) -> list[Symbol]:
        """Whose holds are which, in the states of a part: state, hold, step."""
        return _tuples(self.claims_[robot.number, t.number, part.number].tolist())

    def fresh(self, robot: Symbol, t: Symbol, part: Symbol) -> list[Symbol]:
        """The holds and steps among these that are the robot's first claim to them."""
        return _tuples(self.fresh_[robot.number, t.number, part.number])

    def rivals(self, _: Symbol) -> list[Symbol]:
        """Two robots, and a hold and a step that both may claim."""
        return _tuples(self.rivals_)

    def refined(self, _: Symbol) -> list[Symbol]:
        """States of split vertices, and when."""
        return _tuples(self.refined_)

    def resting(self, _: Symbol) -> list[Symbol]:
        """The waits there."""
        return _tuples(self.resting_)

    def most(self) -> Symbol:
        """The most components that a vertex can have."""
        return Number(MOST_COMPONENTS)


def _tuples(rows: Iterable[Iterable[int]]) -> list[Symbol]:
    return [clingo.Tuple_([number_symbol(number) for number in row]) for row in rows]
