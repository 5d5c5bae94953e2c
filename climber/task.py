"""The task plan: which stances to go through, in the fewest moves and, among those, at least cost, both proved.

The logic is in `programs/climb.lp`; `layers.py` says what of the graph it is given; here clingo is driven. The proofs
are about the graph that was given and the cuts made so far, and about nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files

import clingo
import numpy as np
from clingo import Function, Number, Symbol
from numpy.typing import ArrayLike

from climber.exceptions import ClimberError
from climber.layers import FAR, Booleans, Integers, Layers, integers
from climber.task_plan import Attempt, Impossible, OutOfTime, Proofs, TaskPlan, TaskStats

__all__ = ["Attempt", "Impossible", "OutOfTime", "Proofs", "TaskPlan", "TaskPlanner", "TaskStats"]

_OPTIONS = ("--seed=0", "--parallel-mode=1", "--models=0", "--warn=none")  # same question, same answer
# With good potentials the lower bound is the optimum or close to it, and search guided by cores starts from there. On
# bare costs it does not get off the ground, and branch and bound at least finds plans.
_FROM_BELOW, _FROM_ABOVE = "--opt-strategy=usc", "--opt-strategy=bb"
_PATIENCE = 0.25  # [s] at most between looks at the clock; also how long Ctrl-C waits


@cache
def _program() -> str:
    return files("climber.programs").joinpath("climb.lp").read_text(encoding="utf-8")


@dataclass
class _Answer:
    """What the solver said about one horizon. `edges` is the best plan found, or None."""

    edges: list[int] | None = None
    cost: int = 0
    models: int = 0
    exhausted: bool = False


@dataclass
class _Facts:
    """Answers the logic program's questions about the graph. Nothing but numbers passes."""

    layers: Layers
    goals_within: int = 0

    def start(self) -> Symbol:
        return Number(self.layers.start)

    def goals(self) -> list[Symbol]:
        near = self.layers.from_start[self.layers.goals] <= self.goals_within
        return [Number(goal) for goal in self.layers.goals[near].tolist()]

    def arcs(self, t: Symbol, part: Symbol) -> list[Symbol]:
        layer = self.layers.layers[t.number - 1]
        new = layer.part(part.number)
        edges = layer.edges[new]
        columns = (edges, self.layers.tail[edges], self.layers.head[edges], layer.weights[new])
        rows = np.column_stack(columns).tolist()
        return [clingo.Tuple_([Number(number) for number in row]) for row in rows]


@dataclass
class _Tally:
    """Statistics of one call, as they accrue."""

    began: float = field(default_factory=time.perf_counter)
    layers_seconds: float = 0.0
    attempts: list[Attempt] = field(default_factory=list)


class TaskPlanner:
    """Plans walks through a directed graph, again and again as edges are cut from it.

    What clingo was once given it keeps: a cut adds a constraint, a longer horizon adds the pairs it brings, and nothing
    is grounded twice.

    Args:
        num_vertices: Vertices are 0 ... num_vertices - 1.
        tail: Where each edge starts, shape (num_edges,). Parallel edges are allowed.
        head: Where each edge ends, shape (num_edges,).
        cost: Non-negative integer cost of each edge, shape (num_edges,).
        start: The vertex the climb starts from.
        goals: The vertices it may end on; any number.
        potentials: False minimises bare costs, to the same result but in exponential time (see `Layers.reweigh`).

    Raises:
        ValueError: If arrays differ in length, or a number is out of range.
    """

    def __init__(
        self,
        num_vertices: int,
        tail: ArrayLike,
        head: ArrayLike,
        cost: ArrayLike,
        start: int,
        goals: Iterable[int],
        potentials: bool = True,
    ) -> None:
        self.layers = Layers(num_vertices, tail, head, cost, start, goals)
        self._potentials = potentials
        self._facts = _Facts(self.layers)
        self._control = clingo.Control([*_OPTIONS, _FROM_BELOW if potentials else _FROM_ABOVE])
        self._control.add("base", [], _program())
        self._control.ground([("base", [])], self._facts)
        self._horizon = -1  # the horizon last asked for
        self._refuted = -1  # no plan has so few moves
        self._pairs, self._moves, self._rules = 1, 0, 0
        self._ends: dict[tuple[int, int], int] = {}  # (goal, t) -> what clingo counts for being there

    def lower_bound(self) -> int:
        """A number of moves that no plan can do with less of; `FAR` if there is no plan. The search begins there."""
        return self.layers.shortest

    def cut(self, edges: ArrayLike) -> None:
        """Takes edges out of the graph for good.

        Args:
            edges: Indices into the arrays the planner was made with; cutting one again changes nothing.
        """
        cut = self._chosen(edges)
        self.layers.usable[cut] = False
        with self._control.backend() as backend:
            for t, layer in enumerate(self.layers.layers, start=1):
                for edge in layer.edges[cut[layer.edges]].tolist():
                    if literal := self._literal("move", edge, t):
                        backend.add_rule([], [literal])

    def penalise(self, edges: ArrayLike, extra_cost: int) -> None:
        """Makes edges dearer, each by `extra_cost` [cost units], without forbidding them.

        Args:
            edges: Indices into the arrays the planner was made with.
            extra_cost: Added to the cost of each; not negative.
        """
        if extra_cost < 0:
            raise ValueError(f"extra_cost is {extra_cost}; it must not be negative")
        self.layers.cost[self._chosen(edges)] += extra_cost

    def plan(self, time_limit: float | None = None) -> TaskPlan | Impossible | OutOfTime:
        """The cheapest of the shortest climbs on what is left of the graph.

        Args:
            time_limit: Give up after so long [s]; search is interrupted, grounding is not. A plan that was found but
                not proved cheapest by then is returned with `proofs.cost_proved` False.

        Returns:
            A plan; the proof that there is none; or that time ran out before either.

        Raises:
            ClimberError: If the cost of a climb could be more than the solver can count.
        """
        tally = _Tally()
        deadline = None if time_limit is None else tally.began + time_limit
        self.layers.measure()
        tally.layers_seconds += time.perf_counter() - tally.began
        if self.layers.shortest == FAR:
            return self._impossible(tally)
        horizon = max(self.lower_bound(), self._refuted + 1)
        while self._left(deadline) > 0:
            answer = self._try(horizon, tally, deadline)
            if answer.edges is not None:
                # Every smaller number of moves is below the bound or was refuted, so the makespan is always proved.
                return self._decoded(answer, Proofs(makespan_proved=True, cost_proved=answer.exhausted), tally)
            if not answer.exhausted:
                break
            self._refuted = horizon
            horizon += 1
        return OutOfTime(horizon, self._stats(tally))

    def _try(self, horizon: int, tally: _Tally, deadline: float | None) -> _Answer:
        """Asks for a climb of exactly `horizon` moves."""
        began = time.perf_counter()
        pairs, moves = self._pairs, self._moves
        new = self.layers.grow(horizon)
        changes = self.layers.reweigh(horizon, self._potentials)
        weighed = time.perf_counter()
        self._ground(horizon, new)
        self._adjust(horizon, changes)
        grounded = time.perf_counter()
        answer = self._solve(deadline)
        solved = time.perf_counter()
        tally.layers_seconds += weighed - began
        statistics = self._control.statistics
        rules = int(statistics["problem"]["lp"]["rules"])
        attempt = Attempt(
            horizon=horizon,
            outcome="plan" if answer.edges is not None else "no plan" if answer.exhausted else "out of time",
            pairs=self._pairs - pairs,
            moves=self._moves - moves,
            rules=rules - self._rules,
            ground_seconds=grounded - weighed,
            solve_seconds=solved - grounded,
            models=answer.models,
            conflicts=int(statistics["solving"]["solvers"]["conflicts"]),
        )
        self._rules = rules
        tally.attempts.append(attempt)
        return answer

    def _ground(self, horizon: int, new: list[int]) -> None:
        """Hands clingo the newest parts of the layers `new`, and the question whether a climb ends at `horizon`."""
        layers = self.layers.layers
        parts = [("step", [Number(t), Number(len(layers[t - 1].parts) - 1)]) for t in new]
        for t in new:
            added = layers[t - 1].edges[layers[t - 1].part(-1)]
            self._moves += len(added)
            self._pairs += len(np.unique(self.layers.head[added]))
        if horizon != self._horizon:
            self._facts.goals_within = horizon
            parts.append(("check", [Number(horizon)]))
        if parts:
            self._control.ground(parts, self._facts)
        if horizon != self._horizon:
            self._control.release_external(Function("query", [Number(self._horizon)]))
            self._control.assign_external(Function("query", [Number(horizon)]), True)
            self._horizon = horizon

    def _adjust(self, horizon: int, changes: list[tuple[int, Integers, Integers]]) -> None:
        """Corrects what clingo counts: by the difference, since what it was told it keeps."""
        rises: list[tuple[int, int]] = []
        for t, positions, amounts in changes:
            edges = self.layers.layers[t - 1].edges[positions]
            for edge, amount in zip(edges.tolist(), amounts.tolist(), strict=True):
                rises.append((self._literal("move", edge, t), amount))
        wanted = {(goal, horizon): weight for goal, weight in self.layers.ends.items()}
        for end in self._ends.keys() | wanted.keys():
            amount = wanted.get(end, 0) - self._ends.get(end, 0)
            rises.append((self._literal("at", *end), amount))
        self._ends = wanted
        rises = [(literal, amount) for literal, amount in rises if literal and amount]
        if rises:
            with self._control.backend() as backend:
                backend.add_minimize(0, rises)

    def _solve(self, deadline: float | None) -> _Answer:
        """Searches until the best plan is proved, none is proved to exist, or the deadline."""
        answer = _Answer()

        def note(model: clingo.Model) -> None:
            steps = sorted((s.arguments[1].number, s.arguments[0].number) for s in model.symbols(shown=True))
            answer.edges, answer.cost = [edge for _, edge in steps], sum(model.cost)
            answer.models += 1

        with self._control.solve(on_model=note, async_=True) as handle:
            left = self._left(deadline)
            while left > 0 and not handle.wait(left):
                left = self._left(deadline)
            handle.cancel()  # without effect on a search that is done
            answer.exhausted = bool(handle.get().exhausted)
        return answer

    @staticmethod
    def _left(deadline: float | None) -> float:
        """How long to wait before the next look at the clock [s]; not positive once it is too late."""
        return _PATIENCE if deadline is None else min(_PATIENCE, deadline - time.perf_counter())

    def _decoded(self, answer: _Answer, proofs: Proofs, tally: _Tally) -> TaskPlan:
        """The plan, after checking that it is one and costs what the solver says."""
        edges = answer.edges or []
        layers = self.layers
        vertices = [layers.start, *layers.head[edges].tolist()]
        cost = int(layers.cost[edges].sum())
        if not (
            layers.usable[edges].all()
            and layers.tail[edges].tolist() == vertices[:-1]
            and vertices[-1] in layers.goals
            and cost == answer.cost
        ):
            raise ClimberError(f"clingo counts {answer.cost} for the moves {edges}: no climb, or one that costs {cost}")
        return TaskPlan(tuple(vertices), tuple(edges), cost, proofs, self._stats(tally))

    def _impossible(self, tally: _Tally) -> Impossible:
        layers = self.layers
        reached = layers.from_start < FAR
        blocking = np.flatnonzero(~layers.usable & reached[layers.tail] & ~reached[layers.head])
        frontier = np.unique(layers.tail[blocking])
        return Impossible(np.flatnonzero(reached), blocking, frontier, self._stats(tally))

    def _stats(self, tally: _Tally) -> TaskStats:
        shortest = self.layers.shortest
        return TaskStats(
            shortest=None if shortest == FAR else shortest,
            attempts=tuple(tally.attempts),
            pairs=self._pairs,
            moves=self._moves,
            layers_seconds=tally.layers_seconds,
            seconds=time.perf_counter() - tally.began,
        )

    def _chosen(self, edges: ArrayLike) -> Booleans:
        """A mask over all edges."""
        indices = integers(np.atleast_1d(edges), "edges")
        count = len(self.layers.usable)
        if len(indices) and (indices.min() < 0 or indices.max() >= count):
            raise ValueError(f"edges reach from {indices.min()} to {indices.max()}; they are numbered 0 to {count - 1}")
        chosen = np.zeros(count, bool)
        chosen[indices] = True
        return chosen

    def _literal(self, name: str, number: int, t: int) -> int:
        """Clingo's number for the atom `name(number, t)`; 0 if it has none because it cannot be true."""
        atom = self._control.symbolic_atoms[Function(name, [Number(number), Number(t)])]
        return 0 if atom is None else atom.literal
