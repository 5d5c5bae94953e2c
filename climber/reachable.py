"""One robot's climb on the stance graph alone: what can be reached, and in how many moves the climb could be made.

No logic program and no cost is needed to say whether there is a climb, only which stances follow one another by way of
the waypoints. The graph is relaxed, so a climb that is missing here is impossible (with feet at the middles of their
patches), and one that is here may still have no motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from climber.geometry import Mask
from climber.graph import build_stance_graph
from climber.holdsets import Ints
from climber.prune import impossible_moves
from climber.robot import Model, Robot
from climber.scenario import Scenario, check_against_robot
from climber.scenario_fields import CostWeights, Place
from climber.solids import Region
from climber.stance import Stance
from climber.stance_graph import StanceGraph
from climber.wall import Wall

UNREACHED = -1
Distances = NDArray[np.int64]


@dataclass(frozen=True)
class Target:
    """A goal or waypoint, as a condition on stances.

    Attributes:
        name: What to call it in a sentence.
        holds: The holds stood on, by whichever limbs.
        stance: The stance.
        region: Where the pelvis must be able to be.
    """

    name: str
    holds: tuple[int, ...] | None
    stance: Stance | None
    region: Region | None

    @classmethod
    def of(cls, place: Place, name: str, limbs: Sequence[str]) -> Target:
        """The target that a place of a scenario stands for."""
        return cls(
            name,
            None if place.holds is None else tuple(place.holds),
            None if place.stance is None else Stance(tuple(place.stance[limb] for limb in limbs)),
            None if place.pelvis is None else place.pelvis.inside(),
        )

    @property
    def demanded(self) -> tuple[int, ...]:
        """The holds that must be stood on; none if only a region is asked for."""
        return self.stance.holds if self.stance is not None else self.holds or ()

    def vertices(self, graph: StanceGraph) -> Ints:
        """The vertices that meet it."""
        return graph.goal_vertices(holds=self.holds, stance=self.stance, region=self.region)


@dataclass(frozen=True)
class Reached:
    """What can be reached on a stance graph.

    Attributes:
        graph: The graph.
        distance: Fewest moves from the start to each vertex, -1 where none lead there, shape (V,).
        moves: Fewest moves of the whole climb, waypoints and goal; None if there is no climb.
    """

    graph: StanceGraph
    distance: Distances
    moves: int | None

    @property
    def vertices(self) -> NDArray[np.int64]:
        """The vertices that can be reached, in increasing order."""
        return np.flatnonzero(self.distance != UNREACHED)

    @cached_property
    def holds(self) -> frozenset[int]:
        """The holds that some reached stance stands on."""
        return frozenset(np.unique(self.graph.stances[self.vertices]).tolist())

    def has(self, stance: Stance) -> bool:
        """Whether a stance can be reached."""
        try:
            return bool(self.distance[self.graph.vertex(stance)] != UNREACHED)
        except KeyError:
            return False


@dataclass(frozen=True)
class RelaxedClimb:
    """The climb that a scenario asks of one robot, on the stance graph.

    Attributes:
        wall: The wall.
        robot: The robot.
        weights: Of the costs.
        start: The start stance.
        waypoints: To be visited on the way.
        in_order: Whether they are to be visited in this order.
        goal: Where to end.
        avoid: Holds that are not stood on.
    """

    wall: Wall
    robot: Robot
    weights: CostWeights
    start: Stance
    waypoints: tuple[Target, ...]
    in_order: bool
    goal: Target
    avoid: tuple[int, ...]

    @classmethod
    def of(cls, scenario: Scenario, index: int = 0) -> RelaxedClimb:
        """The climb of one robot of a scenario.

        Raises:
            ScenarioError: If the scenario does not fit the robot.
            ModelError: If the robot's model cannot be planned for.
        """
        spec, wall = scenario.robots[index], scenario.planning_wall()
        robot = Robot(Model.load(spec.model, scenario.folder), wall.gravity)
        check_against_robot(scenario, index, robot.limb_names, robot.joint_limits, robot.planar)
        limbs = robot.limb_names
        waypoints = [
            Target.of(place, f"waypoint {place.name}" if place.name else f"waypoint {number}", limbs)
            for number, place in enumerate(spec.waypoints)
        ]
        return cls(
            wall,
            robot,
            scenario.cost,
            Stance(tuple(spec.start[limb] for limb in limbs)),
            tuple(waypoints),
            spec.waypoint_order == "given",
            Target.of(spec.goal, "the goal", limbs),
            tuple(spec.avoid.holds),
        )

    @property
    def targets(self) -> tuple[Target, ...]:
        """Waypoints, then the goal."""
        return (*self.waypoints, self.goal)

    def on(self, wall: Wall) -> RelaxedClimb:
        """The same climb on another wall."""
        return replace(self, wall=wall)

    def graph(self) -> StanceGraph:
        """The stance graph.

        Raises:
            ClimberError: If the start itself fails a relaxed check.
        """
        return build_stance_graph(self.wall, self.robot, self.start, self.weights, self.avoid)

    def impossible(self, graph: StanceGraph) -> Mask:
        """The edges that are proved impossible though they pass the graph's checks, shape (E,); see `climber.prune`."""
        mask = np.zeros(graph.num_edges, dtype=bool)
        if graph.num_edges:
            ends = None if self.waypoints else self.goal.vertices(graph)
            mask[impossible_moves(graph, self.robot, self.wall, ends)] = True
        return mask

    def reached(self, graph: StanceGraph | None = None, barred: Mask | None = None) -> Reached:
        """What can be reached, and the fewest moves of the climb.

        Args:
            graph: The stance graph of this climb; built if not given.
            barred: Edges that must not be used, shape (E,).
        """
        graph = graph or self.graph()
        usable: Mask = np.logical_not(np.isin(graph.stances[graph.head], self.avoid).any(axis=1))
        if barred is not None:
            usable &= ~barred
        visits = [np.zeros(graph.num_vertices, dtype=bool) for _ in self.waypoints]
        for visit, waypoint in zip(visits, self.waypoints, strict=True):
            visit[waypoint.vertices(graph)] = True
        distance = _distances(graph, usable, visits, self.in_order)
        moves = None
        if len(goals := self.goal.vertices(graph)) and (final := distance[-1, goals]).max() != UNREACHED:
            moves = int(final[final != UNREACHED].min())
        anyhow = np.where(distance == UNREACHED, np.iinfo(np.int64).max, distance).min(axis=0)
        return Reached(graph, np.where((distance == UNREACHED).all(axis=0), UNREACHED, anyhow), moves)


def _distances(graph: StanceGraph, usable: Mask, visits: Sequence[Mask], in_order: bool) -> Distances:
    """Fewest moves to each vertex with each set of waypoints visited, shape (num_layers, V); the last has all.

    In order, layer l stands for the first l waypoints, otherwise for those whose bits are in l. Whoever stands on a
    waypoint has visited it, so every vertex has one way on in each layer.
    """
    num, layers = graph.num_vertices, len(visits) + 1 if in_order else 1 << len(visits)
    after = np.tile(np.arange(layers)[:, None], (1, num))  # the layer in which one arrives at a vertex
    for place, visit in enumerate(visits):  # in order, one vertex may meet several waypoints in a row
        after[:, visit] = (
            np.where(after[:, visit] == place, place + 1, after[:, visit])
            if in_order
            else (after[:, visit] | 1 << place)
        )
    distance = np.full(layers * num, UNREACHED, dtype=np.int64)
    here = np.array([after[0, graph.start] * num + graph.start])
    moves = 0
    while len(here):
        distance[here] = moves
        layer, vertex = np.divmod(here, num)
        first, end = graph.first_edge[vertex], graph.first_edge[vertex + 1]
        count = end - first
        edges = np.repeat(first - (np.cumsum(count) - count), count) + np.arange(count.sum())
        kept = usable[edges]
        edges, layer = edges[kept], np.repeat(layer, count)[kept]
        there = np.unique(after[layer, graph.head[edges]] * num + graph.head[edges])
        here, moves = there[distance[there] == UNREACHED], moves + 1
    return distance.reshape(layers, num)
