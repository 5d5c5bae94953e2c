"""The task plan: which stances to go through, in the fewest steps and, among those, at least cost, both proved.

The logic is in `programs/climb.lp` and, for waypoints, teams and refinement, in a file beside it for each;
`task_program.py` hands it to clingo, `layers.py` says what of the graphs it is given. Here is how planning proceeds.
The proofs are about the graphs that were given, less what was cut, barred or found in conflict, and nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from climber.components import Bar
from climber.exceptions import ClimberError
from climber.joint import joint_positions
from climber.layers import FAR, Layers
from climber.states import WAIT, Integers, RobotTask, States, integers
from climber.task_answer import decoded, why_not
from climber.task_plan import Attempt, Impossible, OutOfTime, Proofs, TaskPlan, TaskStats, Walk
from climber.task_program import Answer, Doing, TaskProgram

__all__ = [
    "WAIT",
    "Attempt",
    "Impossible",
    "OutOfTime",
    "Proofs",
    "RobotTask",
    "TaskPlan",
    "TaskPlanner",
    "TaskStats",
    "Walk",
]

Deed = tuple[int, Literal["at", "move"], int]  # a robot that waits at a vertex, or moves along an edge, for a step
_DOUBTS = 6  # after so many horizons without a plan a team is asked whether it can have any


@dataclass
class _Tally:
    """Statistics of one call, as they accrue."""

    began: float = field(default_factory=time.perf_counter)
    layers_seconds: float = 0.0
    attempts: list[Attempt] = field(default_factory=list)


class TaskPlanner:
    """Plans walks through directed graphs for one robot or a team, again and again as the graphs are refined.

    A team moves in synchronous steps: in each, every robot goes along one edge or waits. During a step the holds that
    a robot stands on before and after it are its own, and no other robot's. What clingo was once given it keeps: a cut
    adds a constraint, a longer horizon adds the pairs it brings, and nothing is grounded twice.

    Args:
        robots: What each robot is asked to do. For one robot the arguments of its `RobotTask` may stand here instead:
            `TaskPlanner(num_vertices, tail, head, cost, start, goals)`.
        task: The rest of those arguments.
        potentials: False minimises bare costs, to the same result but in exponential time (see `Layers.reweigh`).
        handover: True lets a robot take a hold in the very step in which another lets go of it.

    Attributes:
        layers: For each robot, what of its graph matters.

    Raises:
        ValueError: If arrays differ in length, or a number is out of range; if a robot of a team comes without holds,
            or two robots start on the same hold.
    """

    def __init__(
        self,
        robots: Sequence[RobotTask] | int,
        *task: ArrayLike | Iterable[int],
        potentials: bool = True,
        handover: bool = False,
    ) -> None:
        tasks = robots if isinstance(robots, Sequence) else [RobotTask(robots, *task)]  # type: ignore[arg-type]
        if not tasks:
            raise ValueError("robots is empty; there must be one at least")
        self.layers = [Layers(States(task, waits=len(tasks) > 1)) for task in tasks]
        _refuse_shared_starts(self.layers)
        self._potentials, self._handover = potentials, handover
        self._program = TaskProgram(self.layers, handover)
        self._conflicts: dict[tuple[Deed, Deed], tuple[Doing, Doing]] = {}
        self._refuted = -1  # no plan has so few steps

    def lower_bound(self) -> int:
        """A number of steps that no plan can do with less of; `FAR` if there is no plan. The search begins there."""
        return max(layers.shortest for layers in self.layers)

    def cut(self, edges: ArrayLike, robot: int = 0) -> None:
        """Takes edges out of a robot's graph for good.

        Args:
            edges: Indices into the arrays of its task; cutting one again changes nothing.
            robot: Number of the robot.
        """
        arcs = self._arcs(robot, edges)
        self.layers[robot].usable[arcs] = False
        self._program.cut(robot, arcs)

    def penalise(self, edges: ArrayLike, extra_cost: int, robot: int = 0) -> None:
        """Makes edges dearer, each by `extra_cost` [cost units], without forbidding them.

        Args:
            edges: Indices into the arrays of the robot's task.
            extra_cost: Added to the cost of each; not negative.
            robot: Number of the robot.
        """
        if extra_cost < 0:
            raise ValueError(f"extra_cost is {extra_cost}; it must not be negative")
        self.layers[robot].cost[self._arcs(robot, edges)] += extra_cost

    def split(self, robot: int, vertex: int) -> int | None:
        """Gives a vertex one component more: 0 and 1 the first time, then 2, and so on.

        A robot on a split vertex is in exactly one of its components until its next move. Any move may lead into any
        component, and out of any, unless `forbid` says otherwise. A new component lifts what was proved so far.

        Returns:
            How many components it has now; None if it has `climber.components.MOST_COMPONENTS` and gets no more.
        """
        count = self.layers[robot].components.split(_number(vertex, self.layers[robot].states.num_vertices, "vertex"))
        if count is not None:
            self._program.open(robot, vertex, count)
            if count > 2:
                self._refuted = -1
        return count

    def forbid(self, robot: int, edge: int, from_component: int | None = None, to_component: int | None = None) -> None:
        """Bars an edge from leaving one component of its tail for one component of its head.

        Args:
            robot: Number of the robot.
            edge: Index into the arrays of its task.
            from_component: A component of the tail; None for any, or when the tail is not split.
            to_component: A component of the head; None for any, or when the head is not split.

        Raises:
            ValueError: If a vertex does not have the component.
        """
        layers = self.layers[robot]
        bar = Bar(_number(edge, layers.states.num_edges, "edge"), from_component, to_component)
        if from_component is None and to_component is None:
            self.cut([edge], robot)
        elif layers.components.bar(bar):
            self._program.bar(robot, [bar])

    def forbid_start(self, robot: int, component: int) -> None:
        """Bars a walk from starting in a component of the vertex it starts on, which has been split."""
        layers = self.layers[robot]
        layers.components.check(int(layers.states.vertices(np.array(layers.states.start))), component)
        if component not in layers.components.start_bars:
            layers.components.start_bars.add(component)
            self._program.bar_start(robot, component)

    def conflict(self, a: Deed, b: Deed) -> None:
        """Bars two robots from two things in the same step.

        Args:
            a: (robot, "move", edge): it goes along the edge. (robot, "at", vertex): it waits there all the step.
            b: Likewise, of another robot.
        """
        if a[0] == b[0]:
            raise ValueError(f"{a} and {b} are both of robot {a[0]}; a conflict is between two robots")
        key = (min(a, b), max(a, b))
        if key not in self._conflicts:
            self._conflicts[key] = (self._doing(key[0]), self._doing(key[1]))
            self._program.conflict([self._conflicts[key]])

    def plan(self, time_limit: float | None = None) -> TaskPlan | Impossible | OutOfTime:
        """The cheapest of the shortest climbs on what is left of the graphs.

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
        for layers in self.layers:
            layers.measure()
        tally.layers_seconds += time.perf_counter() - tally.began
        for robot, layers in enumerate(self.layers):
            if layers.shortest == FAR:
                return why_not(robot, layers, self._stats(tally))
        horizon = max(self.lower_bound(), self._refuted + 1)
        while deadline is None or time.perf_counter() < deadline:
            answer = self._try(horizon, tally, deadline)
            if answer.moves is not None:
                # Every smaller number of steps is below the bound or was refuted, so the makespan is always proved.
                return self._decoded(answer, horizon, Proofs(True, cost_proved=answer.exhausted), tally)
            if not answer.exhausted:
                break
            self._refuted = horizon
            horizon += 1
            if len(tally.attempts) == _DOUBTS and len(self.layers) > 1:
                positions = joint_positions(self.layers, list(self._conflicts.values()), self._handover, deadline)
                if positions is not None:
                    return self._together_impossible(positions, tally)
        return OutOfTime(horizon, self._stats(tally))

    def _try(self, horizon: int, tally: _Tally, deadline: float | None) -> Answer:
        """Asks for a climb of exactly `horizon` steps."""
        began = time.perf_counter()
        program = self._program
        pairs, moves, rules = program.pairs, program.moves, program.rules
        new = [layers.grow(horizon) for layers in self.layers]
        changes = [layers.reweigh(horizon, self._potentials) for layers in self.layers]
        weighed = time.perf_counter()
        program.ask(horizon, new)
        if any(new):
            program.refine()
            for robot, layers in enumerate(self.layers):
                program.bar(robot, layers.components.bars)
            program.conflict(self._conflicts.values())
        program.adjust(horizon, changes)
        grounded = time.perf_counter()
        team = len(self.layers) > 1 and self._potentials
        answer = program.solve(deadline, [layers.regrets(horizon) for layers in self.layers] if team else None)
        solved = time.perf_counter()
        tally.layers_seconds += weighed - began
        attempt = Attempt(
            horizon=horizon,
            outcome="plan" if answer.moves is not None else "no plan" if answer.exhausted else "out of time",
            pairs=program.pairs - pairs,
            moves=program.moves - moves,
            rules=program.rules - rules,
            ground_seconds=grounded - weighed,
            solve_seconds=solved - grounded,
            models=answer.models,
            conflicts=answer.conflicts,
        )
        tally.attempts.append(attempt)
        return answer

    def _decoded(self, answer: Answer, horizon: int, proofs: Proofs, tally: _Tally) -> TaskPlan:
        """The plan, after checking that it is one and costs what the solver says."""
        assert answer.moves is not None
        walks: list[Walk] = []
        for robot, layers in enumerate(self.layers):
            arcs = [answer.moves[robot, t] for t in range(1, horizon + 1) if (robot, t) in answer.moves]
            components = [answer.components.get((robot, t)) for t in range(horizon + 1)]
            walks.append(decoded(layers, arcs, components))
        cost = sum(walk.cost for walk in walks)
        if cost != answer.cost or any(len(walk.edges) != horizon for walk in walks):
            raise ClimberError(f"clingo counts {answer.cost} for {walks}: no climb of {horizon} steps and cost {cost}")
        return TaskPlan(tuple(walks), cost, proofs, self._stats(tally))

    def _together_impossible(self, positions: int, tally: _Tally) -> Impossible:
        nothing = np.empty(0, np.int64)
        return Impossible(nothing, nothing, nothing, self._stats(tally), robot=None, joint=positions)

    def _stats(self, tally: _Tally) -> TaskStats:
        shortest = self.lower_bound()
        return TaskStats(
            shortest=None if shortest == FAR else shortest,
            attempts=tuple(tally.attempts),
            pairs=self._program.pairs,
            moves=self._program.moves,
            layers_seconds=tally.layers_seconds,
            seconds=time.perf_counter() - tally.began,
        )

    def _arcs(self, robot: int, edges: ArrayLike) -> Integers:
        """The arcs along some edges."""
        states = self.layers[robot].states
        indices, count = integers(np.atleast_1d(edges), "edges"), states.num_edges
        if len(indices) and (indices.min() < 0 or indices.max() >= count):
            raise ValueError(f"edges reach from {indices.min()} to {indices.max()}; they are numbered 0 to {count - 1}")
        return (indices[:, None] * states.stages + np.arange(states.stages)).ravel()

    def _doing(self, deed: Deed) -> Doing:
        """The arcs that count as a deed."""
        robot, kind, number = deed
        states = self.layers[robot].states
        if kind == "move":
            return robot, states.arcs(_number(number, states.num_edges, "edge"))
        if kind == "at":
            return robot, states.waits(_number(number, states.num_vertices, "vertex"))
        raise ValueError(f'a conflict is "at" a vertex or a "move", not {kind!r}')


def _number(number: int, count: int, name: str) -> int:
    if not 0 <= number < count:
        raise ValueError(f"{name} is {number}; it must be 0 to {count - 1}")
    return int(number)


def _refuse_shared_starts(robots: list[Layers]) -> None:
    """Says so if two robots start on the same hold, or it cannot be known."""
    if len(robots) == 1:
        return
    starts: list[set[int]] = []
    for number, layers in enumerate(robots):
        if layers.states.holds is None:
            raise ValueError(f"robot {number} comes without the holds of its vertices; a team needs them")
        starts.append(set(layers.states.holds[layers.states.start // layers.states.stages].tolist()))
    for one, other in combinations(range(len(robots)), 2):
        if shared := sorted(starts[one] & starts[other]):
            raise ValueError(f"robots {one} and {other} both start on hold {shared[0]}")
