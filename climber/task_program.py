"""Clingo, and what it is told: the program of `programs/climb.lp` and its extensions, grounded once and bit by bit.

Here is how things are said; when, and what follows from the answers, is in `task.py`.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from itertools import product

import clingo
import numpy as np
from clingo import Function, Number, Symbol

from climber.components import WHOLE, Bar, Join
from climber.layers import Layers, Rises
from climber.regrets import Regrets
from climber.states import Integers
from climber.task_facts import Facts, number_symbol

# One thread and a fixed seed: the same question gets the same answer.
_OPTIONS = ("--seed=0", "--parallel-mode=1", "--models=0", "--warn=none")
# For one robot, core-guided search: it starts from the lower bound, which with good potentials is the optimum. A team
# pays for keeping out of each other's way, so search from above: most horizons have no plan, whatever it may cost.
_ALONE, _TEAM = "--opt-strategy=usc", "--opt-strategy=bb,lin"
_PATIENCE = 0.25  # [s] at most between looks at the clock; also how long Ctrl-C waits

Doing = tuple[int, Integers]  # a robot, and the arcs that count as doing it


@cache
def _text(name: str) -> str:
    return files("climber.programs").joinpath(f"{name}.lp").read_text(encoding="utf-8")


@dataclass
class Answer:
    """What the solver said about one horizon.

    Attributes:
        moves: Of the best plan found, the arc of each robot at each step, by (robot, t); None if none was found.
        components: Of that plan, the component of each robot in a split vertex, by (robot, t).
        cost: What the solver counts for it.
        models: Number of plans found, each better than the one before.
        conflicts: Number of dead ends the search ran into.
        exhausted: Nothing is left to be looked at: the plan is best, or there is none.
    """

    moves: dict[tuple[int, int], int] | None = None
    components: dict[tuple[int, int], int] = field(default_factory=dict)
    cost: int = 0
    models: int = 0
    conflicts: int = 0
    exhausted: bool = False


class TaskProgram:
    """The logic program of some robots.

    Args:
        layers: What of each robot's graph matters.
        handover: Whether a hold may be taken in the step in which another robot lets go of it.

    Attributes:
        pairs: Pairs (state, t) given so far.
        moves: Pairs (arc, t) given so far.
        rules: Ground rules given before the last search.
    """

    def __init__(self, layers: list[Layers], handover: bool = False) -> None:
        self.layers = layers
        self.pairs, self.moves, self.rules = len(layers), 0, 0
        self._facts = Facts(layers)
        self._control = clingo.Control([*_OPTIONS, _ALONE if len(layers) == 1 else _TEAM])
        self._control.add("base", [], _text("climb"))
        if any(len(robot.states.waypoints) for robot in layers):
            self._control.add("base", [], _text("waypoints"))
        self._control.ground([("base", [])], self._facts)
        self._asked: set[int] = set()
        self._horizon = -1
        self._ends: dict[tuple[int, int, int, int], int] = {}  # (robot, state, component, t) -> what being there counts
        self._join_atoms: dict[tuple[int, int, Join], int] = {}
        self._teams = len(layers) > 1
        self._claim_steps = (0,) if handover else (0, 1)  # when a hold is had, from when it is stood on
        self._claimants: dict[tuple[int, int], list[int]] = {}
        self._refined: set[tuple[int, int, int]] = set()
        self._refining, self._refine_parts, self._rival_parts = False, 0, 0
        self._said: set[tuple[int, ...]] = set()
        if self._teams:
            self._control.add("base", [], _text("teams"))
            holds = [np.unique(robot.states.holds) for robot in layers if robot.states.holds is not None]
            values, counts = np.unique(np.concatenate(holds), return_counts=True)
            self._shared = values[counts > 1]
            parts = [self._claim(robot, 0, 0, np.array([each.states.start])) for robot, each in enumerate(layers)]
            self._control.ground(parts, self._facts)
            self._ground_rivals()

    def ask(self, horizon: int, new: list[list[int]]) -> None:
        """Makes `horizon` the question, after grounding what it takes.

        Args:
            horizon: Number of steps.
            new: For each robot the t whose layers have a new part.
        """
        parts: list[tuple[str, list[Symbol]]] = []
        claims: list[tuple[str, list[Symbol]]] = []
        for robot, steps in enumerate(new):
            layers = self.layers[robot]
            for t in steps:
                layer = layers.layers[t - 1]
                number = len(layer.parts) - 1
                arcs = layer.arcs[layer.part(-1)]
                heads = np.unique(layers.states.head[arcs])
                self.moves += len(arcs)
                self.pairs += len(heads)
                parts.append(("step", [Number(robot), Number(t), Number(number)]))
                if self._teams:
                    claims.append(self._claim(robot, t, number, heads))
        if horizon not in self._asked:
            parts.append(("check", [Number(horizon)]))
            self._asked.add(horizon)
        if parts:
            self._control.ground(parts + claims, self._facts)
        if claims:
            self._ground_rivals()
        if horizon != self._horizon:
            self._control.assign_external(Function("query", [Number(self._horizon)]), False)
            self._control.assign_external(Function("query", [Number(horizon)]), True)
            self._horizon = horizon

    def refine(self) -> None:
        """Grounds the components of split vertices wherever that has not been done."""
        rows: list[tuple[int, ...]] = []
        waits: list[tuple[int, ...]] = []
        for robot, layers in enumerate(self.layers):
            states = layers.states
            for vertex in layers.components.counts:
                for state in states.of_vertex(vertex).tolist():
                    for t in range(int(layers.given_until[state]) + 1):
                        if (robot, state, t) not in self._refined and self._literal("at", robot, state, t):
                            self._refined.add((robot, state, t))
                            rows.append((robot, state, t, vertex))
            if len(states.tail) > states.num_moves:
                waits += [(robot, states.num_moves + state, state, t) for r, state, t, _ in rows if r == robot]
        if rows:
            self._facts.refined_, self._facts.resting_ = rows, waits
            self._control.ground([("refine", [Number(self._refine_parts)])], self._facts)
            self._refine_parts += 1

    def open(self, robot: int, vertex: int, count: int) -> None:
        """Gives a vertex its first two components, or one more: `count` in all."""
        if not self._refining:
            self._control.add("base", [], _text("refine"))
            self._refining = True
        numbers = [Number(robot), Number(vertex)]
        if count == 2:
            self._control.ground([("open", numbers)], self._facts)
        for component in (0, 1) if count == 2 else (count - 1,):
            self._control.assign_external(Function("open", [*numbers, Number(component)]), True)
        self.refine()

    def cut(self, robot: int, arcs: Integers) -> None:
        """Bars moves along these arcs at whatever step."""
        chosen = np.zeros(len(self.layers[robot].states.tail), bool)
        chosen[arcs] = True
        with self._control.backend() as backend:
            for t, layer in enumerate(self.layers[robot].layers, start=1):
                for arc in layer.arcs[chosen[layer.arcs]].tolist():
                    if literal := self._literal("move", robot, arc, t):
                        backend.add_rule([], [literal])

    def bar(self, robot: int, bars: Iterable[Bar]) -> None:
        """Bars edges between components, at all steps given where that was not said before."""
        layers, rules = self.layers[robot], list[list[int]]()
        for bar in bars:
            for arc in layers.states.arcs(bar.edge).tolist():
                last = int(layers.given_until[layers.states.head[arc]])
                for t in range(1, last + 1):
                    key = (robot, *(WHOLE if c is None else c for c in bar), arc, t)
                    move = 0 if key in self._said else self._literal("move", robot, arc, t)
                    if move:
                        self._said.add(key)
                        join = Join(arc, *(WHOLE if c is None else c for c in bar[1:]))
                        rules.append([move, *self._ends_of(robot, join, t)])
        self._never(rules)

    def bar_start(self, robot: int, component: int) -> None:
        """Bars a component of the vertex that the robot starts on."""
        start = self.layers[robot].states.start
        self._never([[self._literal("component", robot, start, component, 0)]])

    def conflict(self, pairs: Iterable[tuple[Doing, Doing]]) -> None:
        """Bars two robots from two things in the same step, at all steps given where that was not said before."""
        rules: list[list[int]] = []
        for (one, arcs), (other, others) in pairs:
            steps = range(1, 1 + min(len(self.layers[one].layers), len(self.layers[other].layers)))
            for a, b, t in product(arcs.tolist(), others.tolist(), steps):
                if (one, a, other, b, t) in self._said:
                    continue
                literals = [self._literal("move", one, a, t), self._literal("move", other, b, t)]
                if all(literals):
                    self._said.add((one, a, other, b, t))
                    rules.append(literals)
        self._never(rules)

    def adjust(self, horizon: int, changes: list[Rises]) -> None:
        """Corrects what clingo counts: by the difference, since what it was told it keeps.

        Args:
            horizon: Number of steps.
            changes: For each robot, by how much weights rise.
        """
        rises: list[tuple[int, int]] = []
        ends: dict[tuple[int, int, int, int], int] = {}
        for robot, (layers, change) in enumerate(zip(self.layers, changes, strict=True)):
            for t, positions, amounts in change.arcs:
                arcs = layers.layers[t - 1].arcs[positions]
                for arc, amount in zip(arcs.tolist(), amounts.tolist(), strict=True):
                    rises.append((self._literal("move", robot, arc, t), amount))
            rises += [(self._join_atom(robot, t, join), amount) for t, join, amount in change.joins]
            ends |= {(robot, goal, c, horizon): weight for (goal, c), weight in layers.ends.items()}
        for key in self._ends.keys() | ends.keys():
            robot, state, component, t = key
            name, numbers = ("at", [state, t]) if component == WHOLE else ("component", [state, component, t])
            rises.append((self._literal(name, robot, *numbers), ends.get(key, 0) - self._ends.get(key, 0)))
        self._ends = ends
        rises = sorted((literal, amount) for literal, amount in rises if literal and amount)
        if rises:
            with self._control.backend() as backend:
                backend.add_minimize(0, rises)

    def solve(self, deadline: float | None, regrets: list[tuple[int, list[Integers]]] | None = None) -> Answer:
        """Searches until the best plan is proved, none is proved to exist, or the deadline.

        Args:
            deadline: When to stop, by `time.perf_counter` [s].
            regrets: For each robot, what `Layers.regrets` says; moves are then ruled out by the plans found.
        """
        answer = Answer()
        dear = Regrets(self.layers, regrets) if regrets else None
        if self._left(deadline) <= 0:
            return answer  # an easy search would be done before it can be stopped

        def note(model: clingo.Model) -> None:
            answer.moves, answer.components = {}, {}
            for symbol in model.symbols(shown=True):
                robot, number, *rest = (argument.number for argument in symbol.arguments)
                if rest[-1] <= self._horizon:
                    if symbol.name == "move":
                        answer.moves[robot, rest[0]] = number
                    else:
                        answer.components[robot, rest[1]] = rest[0]
            answer.cost = sum(model.cost)
            answer.models += 1
            if dear is not None:
                # No better plan makes a move whose regret alone is as much as all regrets of this one.
                for robot, arc, t in dear.ruled_out(answer.cost):
                    if literal := self._literal("move", robot, arc, t):
                        model.context.add_clause([-literal])

        with self._control.solve(on_model=note, async_=True) as handle:
            left = self._left(deadline)
            while left > 0 and not handle.wait(left):
                left = self._left(deadline)
            handle.cancel()  # without effect on a search that is done
            answer.exhausted = bool(handle.get().exhausted)
        statistics = self._control.statistics
        self.rules = int(statistics["problem"]["lp"]["rules"])
        answer.conflicts = int(statistics["solving"]["solvers"]["conflicts"])
        return answer

    @staticmethod
    def _left(deadline: float | None) -> float:
        """How long to wait before the next look at the clock [s]; not positive once it is too late."""
        return _PATIENCE if deadline is None else min(_PATIENCE, deadline - time.perf_counter())

    def _claim(self, robot: int, t: int, part: int, states: Integers) -> tuple[str, list[Symbol]]:
        """Notes which holds are had in these states after t steps; returns the part that says so."""
        graph = self.layers[robot].states
        assert graph.holds is not None
        holds = graph.holds[graph.vertices(states)]  # (m, n)
        columns = [np.repeat(states, holds.shape[1]), holds.ravel()]
        rows = np.column_stack(columns)[np.isin(columns[1], self._shared)]
        steps = [t + later for later in self._claim_steps]
        key = (robot, t, part)
        self._facts.claims_[key] = np.concatenate([np.column_stack([rows, np.full(len(rows), s)]) for s in steps])
        self._facts.fresh_[key] = []
        for hold, step in product(np.unique(rows[:, 1]).tolist(), steps):
            claimants = self._claimants.setdefault((hold, step), [])
            if robot not in claimants:
                self._facts.fresh_[key].append((hold, step))
                self._facts.rivals_ += [(other, robot, hold, step) for other in claimants]
                claimants.append(robot)
        return "claims", [Number(number) for number in key]

    def _ground_rivals(self) -> None:
        if self._facts.rivals_:
            self._control.ground([("rivals", [Number(self._rival_parts)])], self._facts)
            self._rival_parts += 1
            self._facts.rivals_ = []

    def _join_atom(self, robot: int, t: int, join: Join) -> int:
        """An atom that holds when the join is made at step t."""
        key = (robot, t, join)
        if key not in self._join_atoms:
            body = [self._literal("move", robot, join.arc, t), *self._ends_of(robot, join, t)]
            if not all(body):
                return 0
            with self._control.backend() as backend:
                self._join_atoms[key] = backend.add_atom()
                backend.add_rule([self._join_atoms[key]], body)
        return self._join_atoms[key]

    def _ends_of(self, robot: int, join: Join, t: int) -> list[int]:
        """The literals that say in which components step t begins and ends."""
        states, result = self.layers[robot].states, []
        if join.leaving != WHOLE:
            result.append(self._literal("component", robot, int(states.tail[join.arc]), join.leaving, t - 1))
        if join.arriving != WHOLE:
            result.append(self._literal("component", robot, int(states.head[join.arc]), join.arriving, t))
        return result

    def _never(self, rules: list[list[int]]) -> None:
        """Forbids all of a rule's literals at once, for each rule; a literal 0 cannot be true."""
        with self._control.backend() as backend:
            for literals in rules:
                if all(literals):
                    backend.add_rule([], literals)

    def _literal(self, name: str, *numbers: int) -> int:
        """Clingo's number for an atom; 0 if it has none because it cannot be true."""
        atom = self._control.symbolic_atoms[Function(name, [number_symbol(number) for number in numbers])]
        return 0 if atom is None else atom.literal
