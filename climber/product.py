"""A team's task plan by dynamic programming over the robots' joint positions.

At each step of a horizon T a robot can only be on nodes that it reaches so soon and from which it can still be at a
goal in time. For a few robots on graphs of some thousand stances that leaves so few joint positions that all of them
can be gone through, step by step, with the least cost to each: the result is exact, and the proof that there is no plan
of T steps is that no joint position is left. Which pairs of stances two robots cannot take up at the same time is one
more matrix here, and costs nothing; a logic program would have to be given every pair at every step.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from climber.components import WHOLE
from climber.exceptions import ClimberError
from climber.layers import FAR, Layers
from climber.states import Booleans, Integers, RobotTask
from climber.task import TaskPlanner, _Tally
from climber.task_plan import Attempt, Impossible, OutOfTime, TaskPlan
from climber.task_program import Answer
from climber.ways import Ways

CHUNK = 50_000  # joint positions expanded at a time
GATHER = 5_000_000  # joint steps kept before only the cheapest to each position are
DOUBTS = (6, 24)  # steps beyond the least at which it is asked whether any number would do
MOST = 40_000_000  # joint positions of one step beyond which this is the wrong method


# Whether pairs of vertices of two robots, both of shape (k,), exclude each other, shape (k,).
Crowded = Callable[[tuple[int, int], Integers, Integers], Booleans]


class _Closed(Exception):
    """No joint position that can be reached is the end; says how many there are."""

    def __init__(self, positions: int, tally: _Tally) -> None:
        super().__init__(f"{positions} positions, none of them the end")
        self.positions, self.tally = positions, tally


class _Nodes(Ways):
    """Also what each way costs, and of each node its vertex, component and steps to a goal."""

    def __init__(self, layers: Layers) -> None:
        super().__init__(layers)
        states, components = layers.states, layers.components
        self.cost = layers.cost[self.arc]
        state = components.states_of_nodes()
        self.to_goal = layers.to_goal[state]
        self.vertex = states.vertices(state)
        self.component = np.full(self.count, WHOLE)
        for vertex in components.counts:
            for one in states.of_vertex(vertex).tolist():
                for component, node in components.nodes(one).items():
                    self.component[node] = component

    def ways(self, nodes: Integers, left: int) -> tuple[Integers, Integers]:
        """For each of `nodes` its ways to nodes at most `left` steps from a goal: place among `nodes`, and way."""
        counts, way = self.leaving(nodes)
        place = np.repeat(np.arange(len(nodes)), counts)
        good = self.to_goal[self.head[way]] <= left
        return place[good], way[good]


@dataclass
class _Step:
    """What is known after one step: every joint position, how it is best reached, and what that costs."""

    keys: Integers
    cost: Integers
    parent: Integers
    ways: Integers  # (num_robots, n)


class ProductPlanner(TaskPlanner):
    """A `TaskPlanner` for a few robots that goes through their joint positions instead of asking clingo.

    Args:
        robots: What each robot is asked to do, with holds.
        crowded: Tells pairs of vertices that two robots cannot be on at the same time; asked once for each pair that
            matters. Where two robots could only swap such a pair, neither moves first.
    """

    def __init__(self, robots: Sequence[RobotTask], crowded: Crowded | None = None) -> None:
        super().__init__(robots)
        self._crowded = crowded
        self._shared: dict[tuple[int, int], Booleans] = {}  # whether two vertices have a hold in common
        self._known: dict[tuple[int, int], NDArray[np.int8]] = {}  # whether they exclude each other; -1 before asking
        for i, j in itertools.combinations(range(len(self.layers)), 2):
            sides = [holds for robot in (i, j) if (holds := self.layers[robot].states.holds) is not None]
            width = int(max(side.max() for side in sides)) + 1
            on = [np.zeros((len(side), width), np.float32) for side in sides]
            for table, side in zip(on, sides, strict=True):
                table[np.arange(len(side))[:, None], side] = 1.0
            self._shared[i, j] = on[0] @ on[1].T > 0
            self._known[i, j] = np.full(self._shared[i, j].shape, -1 if crowded else 0, np.int8)

    def plan(self, time_limit: float | None = None) -> TaskPlan | Impossible | OutOfTime:
        """As `TaskPlanner.plan`; what excludes each other counts in the proof that there is no plan."""
        try:
            return super().plan(time_limit)
        except _Closed as closed:
            return self._together_impossible(closed.positions, closed.tally)

    def exclude(self, robots: tuple[int, int], one: int, two: int) -> None:
        """Two robots, the lower number first, cannot be on these vertices at the same time."""
        self._known[robots][one, two] = 1

    def _excluded(self, i: int, j: int, one: Integers, two: Integers) -> Booleans:
        """Which of the pairs of vertices exclude each other, shape (n,)."""
        known = self._known[i, j]
        if self._crowded is not None:
            asked = known[one, two] < 0
            if asked.any():
                places = np.unique(one[asked] * known.shape[1] + two[asked])
                pairs = places // known.shape[1], places % known.shape[1]
                known[pairs] = self._crowded((i, j), *pairs)
        result: Booleans = known[one, two] == 1
        return result

    def _try(self, horizon: int, tally: _Tally, deadline: float | None) -> Answer:
        """Goes through all joint walks of exactly `horizon` steps."""
        began = time.perf_counter()
        team = [_Nodes(layers) for layers in self.layers]
        sizes = tuple(robot.count for robot in team)
        grids = np.meshgrid(*(robot.starts for robot in team), indexing="ij")
        keys = np.ravel_multi_index(tuple(grid.ravel() for grid in grids), sizes)
        none = np.zeros(len(keys), np.int64)
        steps = [_Step(keys, none, none, np.zeros((len(team), len(keys)), np.int64))]
        answer, total = Answer(exhausted=True), 0
        for t in range(1, horizon + 1):
            if deadline is not None and time.perf_counter() > deadline:
                answer.exhausted = False
                break
            steps.append(self._step(team, sizes, steps[-1], horizon - t))
            total += len(steps[-1].keys)
            if not len(steps[-1].keys):
                break
        else:
            self._read(team, sizes, steps, answer)
        attempt = Attempt(
            horizon=horizon,
            outcome="plan" if answer.moves is not None else "no plan" if answer.exhausted else "out of time",
            pairs=total,
            moves=0,
            rules=0,
            ground_seconds=0.0,
            solve_seconds=time.perf_counter() - began,
            models=int(answer.moves is not None),
            conflicts=0,
        )
        tally.attempts.append(attempt)
        if answer.moves is None and horizon - self.lower_bound() in DOUBTS:
            self._close(team, sizes, keys, tally, deadline)
        return answer

    def _close(
        self, team: list[_Nodes], sizes: tuple[int, ...], starts: Integers, tally: _Tally, deadline: float | None
    ) -> None:
        """Goes through all joint positions that can be reached at all; raises `_Closed` if none is the end."""
        seen, frontier = starts, starts
        while len(frontier):
            if deadline is not None and time.perf_counter() > deadline:
                return
            none = np.zeros(len(frontier), np.int64)
            before = _Step(frontier, none, none, np.zeros((len(team), len(frontier)), np.int64))
            frontier = np.setdiff1d(self._step(team, sizes, before, FAR - 1).keys, seen, assume_unique=True)
            seen = np.union1d(seen, frontier)
            if self._ends(team, sizes, frontier).any():
                return
        raise _Closed(len(seen), tally)

    @staticmethod
    def _ends(team: list[_Nodes], sizes: tuple[int, ...], keys: Integers) -> Booleans:
        """Which joint positions have every robot at a goal, shape (n,)."""
        sides = zip(np.unravel_index(keys, sizes), team, strict=True)
        result: Booleans = np.logical_and.reduce([np.isin(nodes, robot.goals) for nodes, robot in sides])
        return result

    def _step(self, team: list[_Nodes], sizes: tuple[int, ...], before: _Step, left: int) -> _Step:
        """All joint positions one step on, each reached at least cost."""
        found: list[_Step] = []
        for begin in range(0, len(before.keys), CHUNK):
            rows = np.arange(begin, min(begin + CHUNK, len(before.keys)))
            positions = np.array(np.unravel_index(before.keys[rows], sizes))
            ways: list[Integers] = []
            for number, robot in enumerate(team):
                place, way = robot.ways(positions[number], left)
                rows, positions = rows[place], positions[:, place]
                ways = [earlier[place] for earlier in ways]
                keep = np.ones(len(rows), bool)
                for other in range(number):
                    keep &= self._together(team, other, number, positions, ways[other], way)
                rows, positions, way = rows[keep], positions[:, keep], way[keep]
                ways = [*(earlier[keep] for earlier in ways), way]
            heads = tuple(robot.head[way] for robot, way in zip(team, ways, strict=True))
            cost = before.cost[rows] + sum(robot.cost[way] for robot, way in zip(team, ways, strict=True))
            found.append(_Step(np.ravel_multi_index(heads, sizes), cost, rows, np.array(ways)))
            if sum(len(part.keys) for part in found) > GATHER:
                found = [_cheapest(found, sizes)]
        step = _cheapest(found, sizes)
        if len(step.keys) > MOST:
            raise ClimberError(f"the team can be in more than {MOST} positions at once; that is too many to go through")
        return step

    def _together(
        self, team: list[_Nodes], i: int, j: int, positions: Integers, one: Integers, two: Integers
    ) -> Booleans:
        """Whether robots i < j can go these ways in the same step, shape (n,)."""
        a, b = team[i], team[j]
        tails = a.vertex[positions[i]], b.vertex[positions[j]]
        heads = a.vertex[a.head[one]], b.vertex[b.head[two]]
        shared = self._shared[i, j]
        result: Booleans = ~(shared[heads] | shared[heads[0], tails[1]] | shared[tails[0], heads[1]])
        rest = np.flatnonzero(result)
        pairs = [(x[rest], y[rest]) for x, y in (heads, (heads[0], tails[1]), (tails[0], heads[1]))]
        at_the_end, one_first, two_first = (self._excluded(i, j, *pair) for pair in pairs)
        # Robots that cannot pass at once may take turns, if either order is possible.
        result[rest] = ~at_the_end & ~(one_first & two_first)
        for (x, arcs), (y, others) in self._conflicts.values():
            if (x, y) == (i, j):
                result &= ~(np.isin(a.arc[one], arcs) & np.isin(b.arc[two], others))
        return result

    def _read(self, team: list[_Nodes], sizes: tuple[int, ...], steps: list[_Step], answer: Answer) -> None:
        """Puts the cheapest walk to a goal into `answer`, if there is one."""
        good = self._ends(team, sizes, steps[-1].keys)
        if not good.any():
            return
        place = int(np.where(good, steps[-1].cost, FAR).argmin())
        answer.moves, answer.cost = {}, int(steps[-1].cost[place])
        for t in range(len(steps) - 1, -1, -1):
            nodes = np.unravel_index(steps[t].keys[place], sizes)
            for number, (robot, node) in enumerate(zip(team, nodes, strict=True)):
                if robot.component[node] != WHOLE:
                    answer.components[number, t] = int(robot.component[node])
                if t:
                    answer.moves[number, t] = int(robot.arc[steps[t].ways[number, place]])
            place = int(steps[t].parent[place])


def _cheapest(parts: list[_Step], sizes: tuple[int, ...]) -> _Step:
    """Each joint position once, at least cost."""
    step = _Step(
        np.concatenate([part.keys for part in parts]),
        np.concatenate([part.cost for part in parts]),
        np.concatenate([part.parent for part in parts]),
        np.concatenate([part.ways for part in parts], axis=1),
    )
    # A table of all joint positions beats sorting those that there are, as long as it fits into memory.
    if math.prod(sizes) <= MOST:
        least = np.full(math.prod(sizes), FAR)
        np.minimum.at(least, step.keys, step.cost)
        best = np.flatnonzero(step.cost == least[step.keys])
        least[step.keys[best]] = best
        chosen = best[least[step.keys[best]] == best]
        chosen = chosen[np.argsort(step.keys[chosen], kind="stable")]
    else:
        order = np.lexsort((step.cost, step.keys))
        first = np.ones(len(order), bool)
        first[1:] = np.diff(step.keys[order]) > 0
        chosen = order[first]
    return _Step(step.keys[chosen], step.cost[chosen], step.parent[chosen], step.ways[:, chosen])
