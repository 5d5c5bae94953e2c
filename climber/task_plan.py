"""What the task planner answers: a plan, the proof that there is none, or that it ran out of time. Types only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from climber.layers import Integers


@dataclass(frozen=True)
class Attempt:
    """One horizon put to the solver.

    Attributes:
        horizon: Number of moves asked for.
        outcome: "no plan" is proved; "out of time" proves nothing.
        pairs: Pairs (vertex, number of moves made) it was given that it did not have before.
        moves: Pairs (edge, number of the move) it was given that it did not have before.
        rules: Ground rules it was given that it did not have before.
        ground_seconds: Time to instantiate them [s].
        solve_seconds: Time to search and prove [s].
        models: Plans found, each cheaper than the one before.
        conflicts: Dead ends the search ran into.
    """

    horizon: int
    outcome: Literal["plan", "no plan", "out of time"]
    pairs: int
    moves: int
    rules: int
    ground_seconds: float
    solve_seconds: float
    models: int
    conflicts: int


@dataclass(frozen=True)
class TaskStats:
    """What answering took.

    Attributes:
        shortest: Fewest moves from start to goal in the graph as cut so far: where the search begins.
        attempts: The horizons tried, in order.
        pairs: Pairs (vertex, number of moves made) the solver has been given since the planner was made.
        moves: Pairs (edge, number of the move), likewise.
        layers_seconds: Time for distances and weights [s].
        seconds: Time for everything [s].
    """

    shortest: int | None
    attempts: tuple[Attempt, ...]
    pairs: int
    moves: int
    layers_seconds: float
    seconds: float


@dataclass(frozen=True)
class Proofs:
    """What is proved of a plan, relative to the graph as cut so far.

    Attributes:
        makespan_proved: No plan has fewer moves.
        cost_proved: No plan with as many moves costs less.
    """

    makespan_proved: bool
    cost_proved: bool


@dataclass(frozen=True)
class TaskPlan:
    """A walk from the start to a goal.

    Attributes:
        vertices: The vertices in order, from the start to a goal; one more than `edges`.
        edges: The edges in order, as indices into the planner's arrays.
        cost: Sum of the costs of the edges, penalties included.
        proofs: What is proved of it.
        stats: What it took.
    """

    vertices: tuple[int, ...]
    edges: tuple[int, ...]
    cost: int
    proofs: Proofs
    stats: TaskStats

    @property
    def makespan(self) -> int:
        """Number of moves."""
        return len(self.edges)


@dataclass(frozen=True)
class Impossible:
    """Proof that no walk leads from the start to a goal: all edges out of a set without goals are cut.

    Attributes:
        reached: The vertices that can be reached, ascending: the start among them, no goal, shape (n,).
        blocking: The cut edges that lead from them to other vertices, ascending; empty when the graph itself ends
            there, shape (m,).
        frontier: The reached vertices those edges leave, ascending, shape (k,).
        stats: What it took.
    """

    reached: Integers
    blocking: Integers
    frontier: Integers
    stats: TaskStats

    @property
    def reason(self) -> str:
        """The proof as a sentence."""
        vertices = "1 vertex" if len(self.reached) == 1 else f"{len(self.reached)} vertices"
        leaving = "no edge leads" if not len(self.blocking) else f"all {len(self.blocking)} edges are cut that lead"
        return f"unreachable: no goal is among the {vertices} that can be reached, and {leaving} out of them"


@dataclass(frozen=True)
class OutOfTime:
    """The time limit came first: whether there is a plan is not known.

    Attributes:
        horizon: Every plan has at least so many moves; whether one has exactly so many is what was being asked.
        stats: What it took.
    """

    horizon: int
    stats: TaskStats
