"""Whether robots that each have a way have one together: all positions that they can be in at once, searched.

The last resort, for teams that find no plan however many steps they are given: no number of steps proves that more
would not help.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from climber.layers import Layers
from climber.states import Booleans, Integers
from climber.task_program import Doing
from climber.ways import Ways

MOST_POSITIONS = 50_000_000  # whether each was reached is a byte
_CHUNK = 10_000


class _Robot(Ways):
    """Also which way from each node is a wait, and the holds stood on there."""

    def __init__(self, layers: Layers) -> None:
        super().__init__(layers)
        states, components = layers.states, layers.components
        self.stay = np.empty(self.count, np.int64)  # the way that waits
        waits = np.flatnonzero(self.arc >= states.num_moves)
        self.stay[self.tail[waits]] = waits
        assert states.holds is not None
        self.holds = states.holds[states.vertices(components.states_of_nodes())]  # (count, n)


def joint_positions(
    robots: list[Layers], conflicts: list[tuple[Doing, Doing]], handover: bool, deadline: float | None
) -> int | None:
    """Searches all joint positions that a team can reach.

    Returns their number if none of them is the end; None if one is, or they are too many, or it is too late. What
    robots can do at once they can do one after the other, unless there are conflicts or holds are handed over.

    Args:
        robots: The robots of the team.
        conflicts: Pairs of arcs that two robots must not take in the same step.
        handover: Whether a hold may be taken in the step in which another robot lets go of it.
        deadline: When to give up, by `time.perf_counter` [s].
    """
    team = [_Robot(layers) for layers in robots]
    sizes = tuple(robot.count for robot in team)
    if float(np.prod(np.array(sizes, float))) > MOST_POSITIONS:
        return None
    seen = np.zeros(sizes, bool).ravel()
    ends = np.zeros(sizes, bool)
    ends[np.ix_(*(robot.goals for robot in team))] = True
    ends = ends.ravel()
    grids = np.meshgrid(*(robot.starts for robot in team), indexing="ij")
    frontier = np.ravel_multi_index(tuple(grid.ravel() for grid in grids), sizes)
    seen[frontier] = True
    movers = [None] if conflicts or handover else list(range(len(team)))
    while len(frontier):
        if ends[frontier].any() or (deadline is not None and time.perf_counter() > deadline):
            return None
        found = [
            _following(team, np.array(np.unravel_index(frontier[i : i + _CHUNK], sizes)), mover, conflicts, handover)
            for i in range(0, len(frontier), _CHUNK)
            for mover in movers
        ]
        new = np.unique(np.concatenate(found))
        frontier = new[~seen[new]]
        seen[frontier] = True
    return int(seen.sum())


def _following(
    team: list[_Robot],
    positions: Integers,
    mover: int | None,
    conflicts: list[tuple[Doing, Doing]],
    handover: bool,
) -> Integers:
    """The joint positions that one step leads to.

    Args:
        team: The robots.
        positions: Nodes, shape (num_robots, n).
        mover: The one robot that does not wait; None if all may move.
        conflicts: As `joint_positions` takes them.
        handover: Likewise.
    """
    rows = np.arange(positions.shape[1])  # which position each combination of ways starts from
    ways: list[Integers] = []  # for each robot so far, its way in each combination
    for number, robot in enumerate(team):
        nodes = positions[number, rows]
        if mover is None or mover == number:
            counts, way = robot.leaving(nodes)
        else:
            counts, way = np.ones(len(nodes), np.int64), robot.stay[nodes]
        rows, ways = np.repeat(rows, counts), [np.repeat(earlier, counts) for earlier in ways]
        keep: Booleans = np.ones(len(way), bool)
        for other, theirs in enumerate(ways):
            mate = team[other]
            mine = robot.holds[robot.head[way]]
            yours = mate.holds[mate.head[theirs]]
            keep &= ~_share(mine, yours)
            if not handover:
                keep &= ~_share(mine, mate.holds[mate.tail[theirs]]) & ~_share(robot.holds[robot.tail[way]], yours)
            for (one, arcs), (two, others) in conflicts:
                pair = {one: arcs, two: others}
                if pair.keys() == {number, other}:
                    keep &= ~(np.isin(robot.arc[way], pair[number]) & np.isin(mate.arc[theirs], pair[other]))
        rows, ways = rows[keep], [*(earlier[keep] for earlier in ways), way[keep]]
    heads = tuple(robot.head[way] for robot, way in zip(team, ways, strict=True))
    result: Integers = np.unique(np.ravel_multi_index(heads, tuple(robot.count for robot in team)))
    return result


def _share(holds: Integers, others: Integers) -> NDArray[np.bool_]:
    """Whether rows have a hold in common, shape (n,)."""
    result: Booleans = (holds[:, :, None] == others[:, None, :]).any(axis=(1, 2))
    return result
