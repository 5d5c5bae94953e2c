"""Which of the transition postures found to use: a shortest path through layers of candidates.

Along a climb, layers follow one another: postures to start from, then for every move where its limb may let go and
where it has taken hold, then postures that reach the goal. Between neighbouring layers the robot shifts or swings.
Motions whose ends bend the holding limbs alike are nearly always easy, so a flip of an elbow counts like a long way.
What else counts is the objective's business.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from climber.objective import Objective
from climber.path import unwound
from climber.robot import Indices
from climber.stance import Contact, Vector

DOUBT = 3.0  # flips of an elbow that a phase counts as which no straight line will do for


@dataclass
class Layer:
    """Candidate postures for one instant of a climb.

    Attributes:
        contacts: The contacts they stand on, in limb order.
        q: Configurations, shape (M, nq).
        branches: Branch of each limb, shape (M, num_limbs).
        holding: The limbs that hold on during the phase that ends here.
        cost: What each costs as such, shape (M,); nothing if left out.
    """

    contacts: tuple[Contact, ...]
    q: Vector
    branches: Indices
    holding: tuple[int, ...]
    cost: Vector | None = None


@dataclass
class Candidates:
    """Layers of candidate postures and what is known of the phases between them.

    Attributes:
        layers: The layers, first to last.
        angle: Places of the pelvis's angles in the positions.
        objective: What a phase costs.
        barred: Phases that did not work out: (layer before, candidate there, candidate in the next layer).
        doubted: Phases that no straight line will do for, likewise.
    """

    layers: list[Layer]
    angle: Indices
    objective: Objective
    barred: set[tuple[int, int, int]] = field(default_factory=set)
    doubted: set[tuple[int, int, int]] = field(default_factory=set)

    def costs(self, i: int) -> Vector:
        """Cost of every phase from layer i to layer i + 1, shape (M_i, M_{i+1}); inf where barred."""
        here, there = self.layers[i], self.layers[i + 1]
        step = unwound(there.q[None], here.q[:, None], self.angle) - here.q[:, None]
        holding = list(there.holding)
        flips = (here.branches[:, None, holding] != there.branches[None, :, holding]).sum(axis=2)
        result: Vector = self.objective.step(step) + self.objective.flip * flips
        if there.cost is not None:
            result = result + there.cost
        for layer, a, b in self.doubted:
            if layer == i:
                result[a, b] += DOUBT * self.objective.flip
        for layer, a, b in self.barred:
            if layer == i:
                result[a, b] = np.inf
        return result

    def best(self) -> list[int] | None:
        """The candidate of each layer on the cheapest way through, or None when there is none."""
        if not all(len(layer.q) for layer in self.layers):
            return None
        first = self.layers[0]
        total = np.zeros(len(first.q)) if first.cost is None else first.cost
        before = []
        for i in range(len(self.layers) - 1):
            through = total[:, None] + self.costs(i)
            before.append(through.argmin(axis=0))
            total = through.min(axis=0)
        if not np.isfinite(total.min()):
            return None
        chosen = [int(total.argmin())]
        for back in reversed(before):
            chosen.append(int(back[chosen[-1]]))
        return chosen[::-1]

    def bar_phase(self, i: int) -> None:
        """Bars all phases from layer i to the next."""
        here, there = len(self.layers[i].q), len(self.layers[i + 1].q)
        self.barred.update((i, a, b) for a in range(here) for b in range(there))

    def dead_end(self) -> tuple[int, Indices]:
        """The first layer from which nothing leads on, and the candidates there that can be reached."""
        reached = np.arange(len(self.layers[0].q))
        for i in range(len(self.layers) - 1):
            onwards = np.flatnonzero(np.isfinite(self.costs(i)[reached]).any(axis=0))
            if not len(onwards):
                return i, reached
            reached = onwards
        raise ValueError("there is a way through all layers")
