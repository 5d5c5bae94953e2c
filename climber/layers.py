"""Which moves can lie on a climb of so many steps, and what each is worth: the numbers behind the task program.

A state can matter after t of T steps only if it is at most t steps from the start and at most T - t from a goal. Only
such pairs, and the arcs between them, are handed to the solver, and each only once.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from climber.components import Components, Join, Joins
from climber.exceptions import ClimberError
from climber.states import Booleans, Integers, States

FAR = np.iinfo(np.int64).max // 4  # no way at all; a quarter, so that sums of it cannot overflow
MOST = np.iinfo(np.int32).max  # clingo's largest number and weight
UNWEIGHED = -1


@dataclass
class Layer:
    """What may be step t, for one t.

    Attributes:
        arcs: The arcs, in the order they were given to the solver, shape (n,).
        weights: What the solver counts for each [cost units], shape (n,); `UNWEIGHED` before `Layers.reweigh`.
        parts: Where each part starts that was given to the solver in one go.
    """

    arcs: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    weights: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    parts: list[int] = field(default_factory=list)

    def part(self, number: int) -> slice:
        """The steps of one part; -1 is the newest."""
        number %= len(self.parts)
        bounds = [*self.parts, len(self.arcs)]
        return slice(bounds[number], bounds[number + 1])


@dataclass
class Rises:
    """By how much what the solver counts has to rise, or fall.

    Attributes:
        arcs: (t, positions in the layer, amounts), for moves that had a weight before.
        joins: (t, join, amount): counted when the arc is step t between those components, besides what the arc counts.
    """

    arcs: list[tuple[int, Integers, Integers]] = field(default_factory=list)
    joins: list[tuple[int, Join, int]] = field(default_factory=list)


class Layers:
    """The states of one robot, unrolled over the number of steps as far as it can matter.

    Args:
        states: The graph of states.

    Attributes:
        from_start: Fewest steps from the start to every state, whatever the components, shape (num_states,).
        to_goal: Fewest steps from every state to a goal, likewise.
        reached: Fewest steps from the start to every node, shape (num_nodes,).
        given_until: A state's pairs are in the layers up to this t, -1 if none is, shape (num_states,).
        shortest: The fewest steps from the start to a goal; `FAR` if there is no way.
    """

    def __init__(self, states: States) -> None:
        self.states = states
        self.components = Components(states)
        self.cost = states.cost.copy()
        self.usable: Booleans = states.usable.copy()
        self.layers: list[Layer] = []  # layers[t - 1] is step t
        self.ends: dict[tuple[int, int], int] = {}  # what ending counts, by goal state and component, as last weighed
        self.given_until: Integers = np.full(states.num_states, -1)
        self.given_until[states.start] = 0
        self._join_weights: dict[tuple[int, Join], int] = {}
        self._out = _rows(states.tail, states.num_states)
        self._into = _rows(states.head, states.num_states)
        self.measure()

    def measure(self) -> None:
        """Distances over what is still usable."""
        states, components = self.states, self.components
        self.from_start = self._distances(np.array([states.start]), self._out, states.head, self.usable)
        self.to_goal = self._distances(states.goals, self._into, states.tail, self.usable)
        if components.counts:
            joins = components.joins()
            free = self.usable & (np.diff(joins.first) == 0)
            tail, head = np.concatenate([states.tail, joins.tail]), np.concatenate([states.head, joins.head])
            usable = np.concatenate([free, self.usable[joins.arc] & joins.allowed])
            rows = _rows(tail, components.num_nodes)
            self.reached = self._distances(components.start_nodes(), rows, head, usable)
        else:
            self.reached = self.from_start
        self.shortest = int(self.reached[components.goal_nodes()].min(initial=FAR))

    def reached_vertices(self) -> Integers:
        """The vertices that some walk from the start comes by, whatever it has visited, in increasing order."""
        states = self.components.states_of_nodes()[self.reached < FAR]
        return np.unique(states // self.states.stages)

    def grow(self, horizon: int) -> list[int]:
        """Adds the moves that can lie on a walk of `horizon` steps and are not there yet.

        All arcs into a pair (state, t) come with the pair: where they come from is at most t - 1 steps from the start
        whatever the horizon, and cuts only take arcs away. So the rules of a pair never need to be extended. What bars
        moves between components is not looked at, since the next component may lift it.

        Returns:
            The t whose layers have a new part, ascending.

        Raises:
            ClimberError: If the cost of so many moves could be more than the solver can count. Nothing is added then.
        """
        dearest = int(self.cost[self.usable].max(initial=0))
        if horizon * dearest > MOST:
            raise ClimberError(f"{horizon} moves of cost {dearest} add up to more than the solver counts, {MOST}")
        tail, head = self.states.tail, self.states.head
        first = np.maximum(self.from_start[tail], self.given_until[head]) + 1
        last = horizon - self.to_goal[head]
        arcs = np.flatnonzero(self.usable & (first <= last))
        counts = (last - first + 1)[arcs]
        # The t of each new move: first, first + 1, ..., last, arc by arc.
        ends = np.cumsum(counts)
        steps = np.arange(ends[-1] if len(ends) else 0) + np.repeat(first[arcs] - (ends - counts), counts)
        arcs = np.repeat(arcs, counts)
        order = np.argsort(steps, kind="stable")
        arcs, steps = arcs[order], steps[order]

        relevant = self.from_start + self.to_goal <= horizon
        self.given_until[relevant] = np.maximum(self.given_until, horizon - self.to_goal)[relevant]
        while len(self.layers) < horizon:
            self.layers.append(Layer())
        numbers, starts = np.unique(steps, return_index=True)
        for t, new in zip(numbers.tolist(), np.split(arcs, starts[1:]), strict=False):
            layer = self.layers[t - 1]
            layer.parts.append(len(layer.arcs))
            layer.arcs = np.concatenate([layer.arcs, new])
            layer.weights = np.concatenate([layer.weights, np.full(len(new), UNWEIGHED)])
        result: list[int] = numbers.tolist()
        return result

    def reweigh(self, horizon: int, potentials: bool = True) -> Rises:
        """Sets what the solver counts for each move: its cost less what the potential rises along it.

        Give every node n at every t a number p(n, t). Counting cost + p(tail, t - 1) - p(head, t) for a move, and
        p(goal, T) for ending there, changes nothing about any whole walk: its inner p cancel, and p(start, 0) = 0. So
        the count of a walk is its cost and the solver's proof is a proof about costs, whatever p is. What a good p does
        is to make that proof short. Here p is the least cost from the start over the moves given and the components
        they join, so no count is negative, and a move that is not on a cheapest way to its head shows it. On bare costs
        the solver would have to rule out walks one by one, and their number is exponential in T. In a team the counts
        are added: the solver starts from the sum of what each robot would pay if it were alone.

        Args:
            horizon: Number of steps T.
            potentials: False counts bare costs.

        Returns:
            What changed of weights that the solver knows; those of new moves are in the layers.
        """
        rises, counts = Rises(), dict[tuple[int, Join], int]()
        joins = self.components.joins() if self.components.counts else None
        before = np.full(self.components.num_nodes, FAR)
        before[self.components.start_nodes()] = 0
        for t, layer in enumerate(self.layers[:horizon], start=1):
            before, weights, possible = self._weigh(layer, before, joins, potentials, t, counts)
            positions = np.flatnonzero((layer.weights != UNWEIGHED) & possible & (weights != layer.weights))
            if len(positions):
                rises.arcs.append((t, positions, (weights - layer.weights)[positions]))
            layer.weights = np.where(possible | (layer.weights == UNWEIGHED), weights, layer.weights)
        known = {key for key in self._join_weights if key[0] <= horizon}
        for t, join in sorted(known | counts.keys()):
            wanted = counts.get((t, join), 0)
            if amount := wanted - self._join_weights.get((t, join), 0):
                rises.joins.append((t, join, amount))
                self._join_weights[t, join] = wanted
        self.ends = {}
        for goal in self.states.goals.tolist():
            totals = {c: int(before[node]) for c, node in self.components.nodes(goal).items() if before[node] < FAR}
            self.ends |= {(goal, c): total if potentials else 0 for c, total in totals.items()}
        return rises

    def regrets(self, horizon: int) -> tuple[int, list[Integers]]:
        """How much dearer than the cheapest walk every walk is that makes a move.

        After `reweigh` with potentials, something that the solver counts nothing for leads to every pair that can be
        reached. So what is missing of a walk through a move is what that move counts, and the least that can follow.

        Args:
            horizon: Number of steps T, as last weighed.

        Returns:
            The cost of the cheapest walk of T steps, and for each layer a lower bound of the regret of each move,
            shape (n,); `FAR` or more if no walk makes it.
        """
        after = np.full(self.states.num_states, FAR)
        least = min(self.ends.values(), default=FAR)
        for (goal, _), total in self.ends.items():
            after[goal] = min(after[goal], total - least)
        result: list[Integers] = []
        for layer in reversed(self.layers[:horizon]):
            regrets = np.where(self.usable[layer.arcs], layer.weights + after[self.states.head[layer.arcs]], FAR)
            after = np.full(self.states.num_states, FAR)
            np.minimum.at(after, self.states.tail[layer.arcs], regrets)
            result.append(regrets)
        return least, result[::-1]

    def _weigh(
        self,
        layer: Layer,
        before: Integers,
        joins: Joins | None,
        potentials: bool,
        t: int,
        counts: dict[tuple[int, Join], int],
    ) -> tuple[Integers, Integers, Booleans]:
        """One step of the dynamic program.

        Args:
            layer: Step t.
            before: Least cost to every node after t - 1 steps, `FAR` if it cannot be reached.
            joins: The joins, if any vertex is split.
            potentials: False counts bare costs.
            t: Number of the step.
            counts: What joins count besides their arc is added here.

        Returns:
            Least costs after t steps; what each move of the layer counts, 0 if it cannot be made; and whether it can.
        """
        arcs = layer.arcs
        tails, heads, costs = self.states.tail[arcs], self.states.head[arcs], self.cost[arcs]
        after = np.full(len(before), FAR)
        usable = self.usable[arcs]
        # What cannot be reached cannot be made: its weight is of no account.
        possible = usable & (before[tails] < FAR)
        if joins is None:
            np.minimum.at(after, heads[possible], (before[tails] + costs)[possible])
            return after, np.where(possible, before[tails] - after[heads] + costs if potentials else costs, 0), possible

        place, number = joins.of_arcs(arcs)
        possible[place] = False  # what joins components is dealt with below
        join_tails, join_heads, join_costs = joins.tail[number], joins.head[number], costs[place]
        open_ = usable[place] & joins.allowed[number] & (before[join_tails] < FAR)
        np.minimum.at(after, heads[possible], (before[tails] + costs)[possible])
        np.minimum.at(after, join_heads[open_], (before[join_tails] + join_costs)[open_])
        weights = np.where(possible, before[tails] - after[heads] + costs if potentials else costs, FAR)
        of_joins = before[join_tails] - after[join_heads] + join_costs if potentials else join_costs
        np.minimum.at(weights, place[open_], of_joins[open_])
        possible[place[open_]] = True
        for i in np.flatnonzero(open_ & (of_joins > weights[place])).tolist():
            counts[t, joins.joins[int(number[i])]] = int(of_joins[i] - weights[place[i]])
        return after, np.where(possible, weights, 0), possible

    @staticmethod
    def _distances(sources: Integers, rows: tuple[Integers, Integers], ends: Integers, usable: Booleans) -> Integers:
        """Breadth-first distances from `sources`, one for each row; `FAR` if unreached.

        Args:
            sources: At distance 0.
            rows: The arcs at everything that has a distance, as `_rows` makes them.
            ends: The far end of each arc.
            usable: Whether an arc may be taken.
        """
        bounds, arcs = rows
        distances = np.full(len(bounds) - 1, FAR)
        distances[sources] = 0
        last_place = np.empty(len(distances), np.int64)
        frontier, distance = sources, 0
        while len(frontier):
            distance += 1
            counts = bounds[frontier + 1] - bounds[frontier]
            stops = np.cumsum(counts)
            places = np.arange(stops[-1]) + np.repeat(bounds[frontier] - (stops - counts), counts)
            leaving = arcs[places]
            found = ends[leaving[usable[leaving]]]
            found = found[distances[found] == FAR]
            distances[found] = distance
            # What is found several times is kept once: where its place was written last.
            places = np.arange(len(found))
            last_place[found] = places
            frontier = found[last_place[found] == places]
        return distances


def _rows(ends: Integers, count: int) -> tuple[Integers, Integers]:
    """Arcs by one of their ends: those of n are `order[bounds[n]:bounds[n + 1]]`."""
    order = np.argsort(ends, kind="stable").astype(np.int64)
    bounds = np.concatenate([[0], np.cumsum(np.bincount(ends, minlength=count))]).astype(np.int64)
    return bounds, order
