"""From the solver's arcs and components to what the planner answers; and why there is no walk if there is none."""

from __future__ import annotations

import numpy as np

from climber.exceptions import ClimberError
from climber.layers import FAR, Layers
from climber.task_plan import Impossible, TaskStats, Walk


def decoded(layers: Layers, arcs: list[int], components: list[int | None]) -> Walk:
    """The walk along some arcs, after checking that it is one.

    Args:
        layers: What of the robot's graph matters.
        arcs: The arc of each step.
        components: The component after 0, 1, ... steps, None where the vertex is not split.

    Raises:
        ClimberError: If it is none.
    """
    states = layers.states
    path = [states.start, *states.head[arcs].tolist()]
    vertices = [state // states.stages for state in path]
    edges = [states.edge(arc) for arc in arcs]
    if not (
        layers.usable[arcs].all()
        and states.tail[arcs].tolist() == path[:-1]
        and path[-1] in states.goals
        and [vertex in layers.components.counts for vertex in vertices] == [c is not None for c in components]
    ):
        raise ClimberError(f"clingo's moves {edges} with the components {components} are no climb")
    visited = [set(states.visited(state)) for state in path]
    visits = [next(t for t, seen in enumerate(visited) if i in seen) for i in range(len(states.waypoints))]
    cost = int(layers.cost[arcs].sum())
    return Walk(tuple(vertices), tuple(edges), tuple(components), tuple(visits), cost)


def why_not(robot: int, layers: Layers, stats: TaskStats) -> Impossible:
    """Why this robot, alone, has no walk."""
    states = layers.states
    reached = np.zeros(states.num_states, bool)
    reached[layers.components.states_of_nodes()[layers.reached < FAR]] = True
    reached[states.start] = True  # if every component of the start is barred it stays there
    leaving = np.flatnonzero(reached[states.tail] & ~reached[states.head])
    blocking = np.unique(leaving // states.stages)
    vertices = np.unique(states.vertices(np.flatnonzero(reached)))
    return Impossible(
        reached=vertices,
        blocking=blocking,
        frontier=np.unique(states.edge_tail[blocking]),
        stats=stats,
        robot=robot,
        missing=tuple(i for i, there in enumerate(states.waypoints) if not np.isin(there, vertices).any()),
        waypoints=len(states.waypoints),
        barred=int(layers.usable[leaving].sum()),
    )
