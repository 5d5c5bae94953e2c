"""Which moves a plan found rules out for every better one: a robot's detour costs the team what it costs the robot."""

from __future__ import annotations

import numpy as np

from climber.layers import Layers
from climber.states import Integers


class Regrets:
    """The moves of a team, by how dear they are.

    Args:
        layers: What of each robot's graph matters.
        regrets: For each robot, what `Layers.regrets` says.
    """

    def __init__(self, layers: list[Layers], regrets: list[tuple[int, list[Integers]]]) -> None:
        self.least = sum(least for least, _ in regrets)  # what the robots would pay if each were alone
        columns = [
            (np.full(len(regret), robot), layers[robot].layers[t].arcs, np.full(len(regret), t + 1), regret)
            for robot, (_, by_layer) in enumerate(regrets)
            for t, regret in enumerate(by_layer)
        ]
        moves = np.concatenate([np.column_stack(column) for column in columns]) if columns else np.empty((0, 4), int)
        self._moves = moves[np.argsort(-moves[:, 3], kind="stable")]
        self._done = 0

    def ruled_out(self, cost: int) -> list[tuple[int, int, int]]:
        """What no plan cheaper than this does and was not ruled out before: robot, arc, t."""
        end = int(np.searchsorted(-self._moves[:, 3], self.least - cost, side="right"))
        new = self._moves[self._done : end, :3]
        self._done = max(end, self._done)
        return [(robot, arc, t) for robot, arc, t in new.tolist()]
