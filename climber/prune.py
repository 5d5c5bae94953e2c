"""Stances that no posture has, proved for all stances of a graph at once.

The stance graph lets the pelvis turn as it likes: a limb's disk has the limb's whole reach. At a fixed angle of the
pelvis a hip is at a fixed place relative to its origin, and the origin must lie within the limb's own length of the
hold less that place: a smaller disk. A stance is possible only if at some angle these disks meet.

Angles are searched by bisection. Within a cell of half width d a hip that is r from the origin moves by less than r d;
with disks that much larger, a cell whose disks do not meet holds no posture, and a stance without a cell left has none.
A foot may stand anywhere on its patch, so disks are larger by the half width of the hold as well.
"""

from __future__ import annotations

import numpy as np

from climber.geometry import CHUNK, Mask, disks_meet
from climber.graph import StanceGraph
from climber.robot import Robot
from climber.stance import Vector
from climber.wall import Wall

FIRST_CELLS = 8  # cells that a full turn is first cut into
HALVINGS = 8  # after so many bisections a stance that is not decided counts as possible


def out_of_reach(robot: Robot, wall: Wall, stances: np.ndarray) -> Mask:
    """Which stances are proved to have no posture, whichever points of their patches the feet are on.

    Args:
        robot: The robot.
        wall: The wall.
        stances: The hold of each limb, shape (V, n).

    Returns:
        Shape (V,); all False for a robot whose pelvis leaves the wall plane.
    """
    possible = np.ones(len(stances), dtype=bool)
    if not robot.planar:
        return ~possible
    hips = np.array([limb.hip[:2] for limb in robot.limbs])  # (n, 2)
    lengths = robot.reach - np.linalg.norm([limb.hip for limb in robot.limbs], axis=1)
    half_width = np.array([hold.half_width for hold in wall.holds])
    positions = wall.positions[:, :2]
    for first in range(0, len(stances), CHUNK):
        holds = stances[first : first + CHUNK]
        possible[first : first + CHUNK] = _turned(positions[holds], lengths + half_width[holds], hips)
    return ~possible


def _turned(feet: Vector, radii: Vector, hips: Vector) -> Mask:
    """Whether at some angle of the pelvis the disks may meet.

    Args:
        feet: Holds [m], shape (M, n, 2).
        radii: Length of the limbs and half widths of the patches together [m], shape (M, n).
        hips: Hips in the pelvis's frame [m], shape (n, 2).

    Returns:
        Shape (M,). False is proved.
    """
    possible = np.zeros(len(feet), dtype=bool)
    half = np.pi / FIRST_CELLS
    centers = half * (2.0 * np.arange(FIRST_CELLS) + 1.0)
    stance, angle = (grid.ravel() for grid in np.meshgrid(np.arange(len(feet)), centers, indexing="ij"))
    swing = np.linalg.norm(hips, axis=1)
    for _ in range(HALVINGS):
        if not len(stance):
            break
        sin, cos = np.sin(angle)[:, None], np.cos(angle)[:, None]
        x, y = hips.T
        origins = feet[stance] - np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        open_cells = disks_meet(origins, radii[stance] + swing * half)
        stance, angle, origins = stance[open_cells], angle[open_cells], origins[open_cells]
        if len(stance):
            possible[stance[disks_meet(origins, radii[stance])]] = True
        undecided = ~possible[stance]
        stance, angle = stance[undecided], angle[undecided]
        half /= 2.0
        stance, angle = np.repeat(stance, 2), (angle[:, None] + np.array([-half, half])).ravel()
    possible[stance] = True
    return possible


def impossible_moves(graph: StanceGraph, robot: Robot, wall: Wall) -> np.ndarray:
    """The edges into and out of stances that are out of reach.

    Counts them, and the stances, in the graph's `counts`.

    Returns:
        Increasing edge numbers.
    """
    far = out_of_reach(robot, wall, graph.stances)
    edges = np.flatnonzero(far[graph.tail] | far[graph.head])
    graph.counts["vertices_out_of_reach"], graph.counts["edges_out_of_reach"] = int(far.sum()), len(edges)
    return edges
