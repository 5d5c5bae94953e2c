"""Pieces of a stance's feasible set, as far as failed motions have shown that there are several.

A stance's postures need not all be joined by motions that keep its contacts (Bretl 2006, sections 3.2 and 3.3, figs.
10 and 13). At first a stance counts as whole. When no motion leads on from the postures that the robot can be in there,
the piece around these is told apart from the rest, and from then on the task planner says which of the two it means.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climber.manifold import Manifold
from climber.path import Search, find_path
from climber.robot import Indices
from climber.stance import Vector

REST = 0  # the component of what is in no known piece
SHORT = Search(iterations=30, nodes=40, checks=60)


@dataclass(frozen=True)
class Choice:
    """The component of a stance that a climb must be in.

    Attributes:
        seeds: One posture of each known piece, shape (num_pieces, nq).
        component: The number of a piece, from 1, or `REST` for what is in none of them.
    """

    seeds: Vector
    component: int


def component(manifold: Manifold, seeds: Sequence[Vector] | Vector, q: Vector, rng: np.random.Generator) -> int:
    """The number of the piece, from 1, in which the configuration `q` lies, or `REST`.

    A piece is recognised by a motion to its seed; what the search does not find is taken to be apart.
    """
    for number, seed in enumerate(seeds, start=1):
        if find_path(manifold, seed, q, rng, SHORT) is not None:
            return number
    return REST


def in_component(manifold: Manifold, choice: Choice, q: Vector, rng: np.random.Generator) -> Indices:
    """Which of the configurations `q`, shape (M, nq), lie in the component chosen."""
    return np.flatnonzero([component(manifold, choice.seeds, row, rng) == choice.component for row in q])
