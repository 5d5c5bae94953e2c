"""The walls W1, W2 and W3 of the thesis, and its robot as the stance graph sees it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climber.graph import build_stance_graph
from climber.scenario_fields import CostWeights
from climber.stance import Stance, Vector
from climber.stance_graph import StanceGraph
from climber.wall import Hold, Wall

WALLS = Path(__file__).parent / "walls"


@dataclass(frozen=True)
class Quadruped:
    """What the stance graph asks of the thesis's robot."""

    reach: Vector
    symmetries: tuple[tuple[int, ...], ...] = ((0, 1, 2, 3), (2, 3, 0, 1))
    mass: float = 2.0
    dimension: int = 2


def wall_data(name: str) -> dict:
    """What the file of a wall in `walls/` says."""
    data: dict = json.loads((WALLS / f"{name}.json").read_text())
    return data


def wall_of(data: dict) -> Wall:
    """The wall of such a file."""
    return Wall(
        tuple(
            Hold((h["x"], h["y"], 0.0), (*h["normal"], 0.0), h["mu"], min_force=2.0, max_force=20.0)
            for h in data["holds"]
        )
    )


def graph_of(data: dict) -> StanceGraph:
    """The stance graph of such a file, with the weights of eq. 4.22 that the walls were calibrated with."""
    reach = data["robot"]["r"] + data["robot"]["l1"] + data["robot"]["l2"]
    start = Stance(tuple(data["start"]))
    return build_stance_graph(wall_of(data), Quadruped(np.full(4, reach)), start, CostWeights())
