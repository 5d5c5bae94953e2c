"""Stances without a posture and moves without a transition, proved away for a whole stance graph at once.

The stance graph lets the pelvis turn as it likes: a limb's disk has the limb's whole reach. At a fixed angle of the
pelvis a hip is at a fixed place relative to its origin, and the origin must lie within the limb's own length of the
hold less that place: a smaller disk. A stance is possible only if at some angle these disks meet.

When a limb lets go or has just taken hold, moreover, the centre of mass must be within the support intervals with and
without it. Where the pelvis's origin is tells where the centre of mass can be, `climber.prune_balance`; so at each
angle the origin also lies in a strip, and the disks must meet in there.

Angles are searched by bisection. In a cell of half width d a hip that is r from the origin moves by less than r d; with
disks that much larger, a cell whose disks do not meet holds no posture, and a stance without a cell left has none. A
foot may stand anywhere on its patch, so disks are larger by the half width of the hold as well.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from climber.geometry import CHUNK, TOUCH, Mask, common_points, disks_meet
from climber.holdsets import Ints, Places
from climber.prune_balance import MassBounds, transition_intervals
from climber.robot import Robot
from climber.stance import Vector
from climber.stance_graph import StanceGraph
from climber.wall import Wall

CELLS = 8  # that a full turn is first cut into
HALVINGS = 8  # after so many bisections what is not decided counts as possible
MOST_KEYS = 200_000  # ends of moves looked at one and all; of more, those that short climbs can come by
DETOUR = 3  # moves more than the fewest that such a climb has


def out_of_reach(robot: Robot, wall: Wall, stances: NDArray[np.integer]) -> Mask:
    """Which stances are proved to have no posture, whichever points of their patches the feet are on.

    For a robot in space only what holds in any attitude is asked: no two feet are farther apart than their limbs are
    long and their hips apart.

    Args:
        robot: The robot.
        wall: The wall.
        stances: The hold of each limb, shape (V, n).

    Returns:
        Shape (V,).
    """
    impossible = np.zeros(len(stances), dtype=bool)
    if not robot.planar:
        return _too_far_apart(robot, wall, stances)
    for first in range(0, len(stances), CHUNK):
        rows = slice(first, first + CHUNK)
        impossible[rows] = ~_Turns(robot, wall, stances[rows]).possible()
    return impossible


def _too_far_apart(robot: Robot, wall: Wall, stances: NDArray[np.integer]) -> Mask:
    """Stances (V, n) two feet of which are too far apart in any attitude of the pelvis, shape (V,)."""
    hips = np.array([limb.hip for limb in robot.limbs])
    lengths = robot.reach - np.linalg.norm(hips, axis=1)
    patches = np.array([hold.half_width for hold in wall.holds])
    far = np.zeros(len(stances), dtype=bool)
    for i, j in combinations(range(len(hips)), 2):
        one, two = stances[:, i], stances[:, j]
        most = lengths[i] + lengths[j] + float(np.linalg.norm(hips[i] - hips[j])) + patches[one] + patches[two]
        far |= np.linalg.norm(wall.positions[one] - wall.positions[two], axis=1) > most + TOUCH
    return far


class _Turns:
    """A search for angles of the pelvis at which stances are possible.

    Args:
        robot: The robot, planar.
        wall: The wall.
        stances: The hold of each limb, shape (M, n).
        bounds: What is known of the robot's centre of mass, if it matters.
        intervals: Then, where that must be [m], shape (M, 2).
    """

    def __init__(
        self,
        robot: Robot,
        wall: Wall,
        stances: NDArray[np.integer],
        bounds: MassBounds | None = None,
        intervals: Vector | None = None,
    ) -> None:
        self._hips = np.array([limb.hip[:2] for limb in robot.limbs])  # (n, 2)
        lengths = robot.reach - np.linalg.norm([limb.hip for limb in robot.limbs], axis=1)
        self._swing = np.linalg.norm(self._hips, axis=1)  # (n,) what a hip moves by, to the radian [m]
        self._patches = np.array([hold.half_width for hold in wall.holds])[stances]  # (M, n)
        self._radii = lengths + self._patches
        self._feet = wall.positions[:, :2][stances]  # (M, n, 2)
        self._bounds, self._intervals = bounds, intervals

    def possible(self) -> Mask:
        """Whether each stance has an angle at which it may be possible, shape (M,). False is proved."""
        count = len(self._feet)
        possible = np.zeros(count, dtype=bool)
        half = np.pi / CELLS
        kept = []
        for center in half * (2.0 * np.arange(CELLS) + 1.0):
            rows = np.flatnonzero(~possible)
            rows, angle = self._look(rows, np.full(len(rows), center), half, possible)
            kept.append((rows, angle))
        stance, angle = (np.concatenate(column) for column in zip(*kept, strict=True))
        for _ in range(HALVINGS):
            undecided = ~possible[stance]
            stance, angle, half = stance[undecided], angle[undecided], half / 2.0
            if not len(stance):
                break
            stance, angle = np.repeat(stance, 2), (angle[:, None] + np.array([-half, half])).ravel()
            stance, angle = self._look(stance, angle, half, possible)
        possible[stance] = True
        return possible

    def _look(self, stance: Places, angle: Vector, half: float, possible: Mask) -> tuple[Places, Vector]:
        """The cells that may hold a posture; `possible` is set where the middle of one does for all we can tell."""
        for width in (half, 0.0):
            if not len(stance):
                break
            fits = self._fits(stance, angle, width)
            if width:
                stance, angle = stance[fits], angle[fits]
            else:
                possible[stance[fits]] = True
        return stance, angle

    def _fits(self, stance: Places, angle: Vector, half: float) -> Mask:
        """Whether disks meet, within the strip, for angles no more than `half` from those given; shape (K,)."""
        sin, cos = np.sin(angle)[:, None], np.cos(angle)[:, None]
        x, y = self._hips.T
        hips = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)  # (K, n, 2)
        centers, radii = self._feet[stance] - hips, self._radii[stance] + self._swing * half
        fits = disks_meet(centers, radii)
        if self._bounds is not None and self._intervals is not None:
            rows = np.flatnonzero(fits)
            stance, feet = stance[rows], self._feet[stance[rows], :, 0]
            left, right = self._bounds.pelvis_range(
                angle[rows], hips[rows, :, 0], feet, self._patches[stance], self._intervals[stance], half
            )
            fits[rows] = _meet_in_strip(centers[rows], radii[rows], left, right)
        return fits


def _meet_in_strip(centers: Vector, radii: Vector, left: Vector, right: Vector) -> Mask:
    """Whether disks that meet, (K, n, 2) and (K, n), do so at some abscissa from `left` to `right`, (K,).

    Their overlap is convex. So either it crosses one side of the strip, or it is inside or outside as a whole.
    """
    meet = left <= right
    crosses = np.zeros(len(meet), dtype=bool)
    for side in (left, right):
        height = radii**2 - (side[:, None] - centers[..., 0]) ** 2
        over = (height >= 0.0).all(axis=1)
        height = np.sqrt(np.maximum(height, 0.0))
        crosses |= over & ((centers[..., 1] - height).max(axis=1) <= (centers[..., 1] + height).min(axis=1))
    unsure = np.flatnonzero(meet & ~crosses)
    x = common_points(centers[unsure], radii[unsure])[:, 0]
    outside = (x < left[unsure]) | (x > right[unsure])  # no witness, by rounding, is no proof
    meet[unsure[outside]] = False
    return meet


def impossible_moves(graph: StanceGraph, robot: Robot, wall: Wall, goals: Ints | None = None) -> Places:
    """The moves of a graph that are proved impossible, and how many in its `counts`.

    Args:
        graph: The stance graph.
        robot: The robot it was built for.
        wall: The wall.
        goals: Where climbs end. If given, a large graph is looked at only where short climbs come by.

    Returns:
        Increasing edge numbers.
    """
    far = out_of_reach(robot, wall, graph.stances)
    usable = ~(far[graph.tail] | far[graph.head])
    graph.counts["vertices_out_of_reach"], graph.counts["edges_out_of_reach"] = int(far.sum()), int((~usable).sum())
    bounds = MassBounds.of(robot)
    if bounds is None:
        return np.flatnonzero(~usable)
    arriving = _arriving(graph)
    intervals = transition_intervals(graph, wall, arriving)  # (V, n, 2)
    fails = np.isnan(intervals[..., 0])  # transitions proved impossible, or that no move asks for
    tested = far.copy()
    ways = _Ways(graph)
    while True:
        relevant = ~tested
        if goals is not None and fails.size > MOST_KEYS:
            relevant &= ways.near(usable, goals)
        if not relevant.any():
            break
        vertex, limb = np.nonzero(relevant[:, None] & ~fails)
        for first in range(0, len(vertex), CHUNK):
            v, i = vertex[first : first + CHUNK], limb[first : first + CHUNK]
            fails[v, i] = ~_Turns(robot, wall, graph.stances[v], bounds, intervals[v, i]).possible()
        tested |= relevant
        usable &= ~(fails[graph.tail, graph.limb] | fails[graph.head, arriving])
    graph.counts["edges_out_of_balance"] = int((~usable).sum()) - graph.counts["edges_out_of_reach"]
    return np.flatnonzero(~usable)


def _arriving(graph: StanceGraph) -> NDArray[np.int8]:
    """The limb that each move has moved, as `stances[head]` numbers the limbs, shape (E,)."""
    total = graph.stances.sum(axis=1)
    taken = total[graph.head] - total[graph.tail] + graph.stances[graph.tail, graph.limb]
    limb = np.zeros(graph.num_edges, dtype=np.int8)
    for i in range(1, graph.stances.shape[1]):
        limb[graph.stances[graph.head, i] == taken] = i
    return limb


class _Ways:
    """Which vertices short climbs through a graph can come by."""

    def __init__(self, graph: StanceGraph) -> None:
        self._graph = graph
        self._into = np.argsort(graph.head, kind="stable")
        self._last_edge = np.searchsorted(graph.head[self._into], np.arange(graph.num_vertices + 1))

    def near(self, usable: Mask, goals: Ints) -> Mask:
        """Vertices on walks to a goal that are no more than `DETOUR` moves longer than the shortest, shape (V,)."""
        graph = self._graph
        every = np.arange(graph.num_edges)
        from_start = distances(np.array([graph.start]), graph.first_edge, every, graph.head, usable)
        to_goal = distances(np.asarray(goals), self._last_edge, self._into, graph.tail, usable)
        length = from_start + to_goal
        near: Mask = length <= length.min() + DETOUR
        return near & np.isfinite(length)


def distances(sources: Places, first: Places, edges: Places, ends: Ints, usable: Mask) -> Vector:
    """Fewest moves from `sources` to each vertex, infinite if there is no way; vertex v's edges lead to `ends`."""
    distance = np.full(len(first) - 1, np.inf)
    distance[sources] = 0
    frontier, steps = np.asarray(sources), 0
    while len(frontier):
        steps += 1
        counts = first[frontier + 1] - first[frontier]
        stops = np.cumsum(counts)
        leaving = edges[np.arange(stops[-1]) + np.repeat(first[frontier] - (stops - counts), counts)]
        found = ends[leaving[usable[leaving]]]
        distance[found[np.isinf(distance[found])]] = steps
        frontier = np.unique(found[distance[found] == steps])
    return distance
