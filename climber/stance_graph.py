"""A stance graph: stances, the moves between them, and what can be asked of both. `climber.graph` builds it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from climber.balls import balls_meet_region
from climber.geometry import TOUCH
from climber.holdsets import Ints, Places
from climber.moves import Moves, Supports
from climber.poses import Rotations
from climber.solids import Region, away
from climber.stance import Stance, Vector


class PoseGraph(NamedTuple):
    """The thesis's graph, in which a pose is a set of holds, whichever limb stands where.

    If limbs differ in reach, poses also differ by the reaches that stand on the holds, and rows may repeat.

    Attributes:
        poses: Increasing hold numbers of every pose that has a move, shape (P, n).
        tail: Pose each directed edge starts from, shape (E,).
        head: Pose each directed edge leads to, shape (E,).
        cost: Rounded cost of each (4.22), shape (E,).
    """

    poses: Ints
    tail: Ints
    head: Ints
    cost: Ints


@dataclass(frozen=True)
class StanceGraph:
    """Stances that can be reached from the start, and the moves between them.

    All checks are relaxed: a stance or a move that is missing is impossible, one that is here need not be possible.

    Attributes:
        stances: One ordered stance for each vertex, the hold of each limb, shape (V, n). The vertex stands for its
            images under the robot's symmetries as well.
        tail: Vertex each edge starts from, not decreasing, shape (E,).
        head: Vertex each edge leads to, increasing along a tail, shape (E,).
        limb: The limb that moves if the robot stands as `stances[tail]` has it, shape (E,).
        cost: Rounded weighted cost (4.22), shape (E,).
        support_index: Row of `supports` that says what stays on the wall, shape (E,).
        start: Vertex of the start stance.
        stance_support: Interval of the centre of mass of a planar robot with all limbs on, SR2 of eq. 4.17 [m], shape
            (V, 2). In space none is asked for, and there is none.
        supports: What stays on the wall during moves.
        counts: How many candidates each stage left, as `build_stance_graph` lists them.
    """

    stances: Ints
    tail: Ints
    head: Ints
    limb: NDArray[np.int8]
    cost: Ints
    support_index: Ints
    start: int
    stance_support: Vector
    supports: Supports
    counts: dict[str, int]
    _rotations: Rotations = field(repr=False)
    _reach: Vector = field(repr=False)  # (n,)
    _positions: Vector = field(repr=False)  # (H, 3), or (H, 2) in the wall plane
    _poses: Ints = field(repr=False)
    _moves: Moves = field(repr=False)

    @property
    def num_vertices(self) -> int:
        """Number of vertices V."""
        return len(self.stances)

    @property
    def num_edges(self) -> int:
        """Number of edges E."""
        return len(self.tail)

    @cached_property
    def first_edge(self) -> Places:
        """The edges of vertex v are first_edge[v] up to, not including, first_edge[v + 1]; shape (V + 1,)."""
        result: Places = np.searchsorted(self.tail, np.arange(self.num_vertices + 1))
        return result

    @cached_property
    def released(self) -> Ints:
        """The hold that each edge's limb leaves, shape (E,)."""
        result: Ints = self.stances[self.tail, self.limb]
        return result

    @cached_property
    def taken(self) -> Ints:
        """The hold that each edge's limb takes, shape (E,)."""
        # Stances that differ in one hold differ in their sum by just that hold.
        sums = self.stances.sum(axis=1, dtype=np.int32)
        result: Ints = sums[self.head] - sums[self.tail] + self.released
        return result

    @cached_property
    def reach_cost(self) -> Vector:
        """How far the foot travels [m] (4.19), shape (E,)."""
        result: Vector = np.linalg.norm(self._positions[self.released] - self._positions[self.taken], axis=1)
        return result

    @cached_property
    def stability_cost(self) -> Vector:
        """One over the width of the support of the limbs that stay [1/m] (4.20), shape (E,)."""
        return self.supports.stability_costs[self.support_index]

    @cached_property
    def robustness_cost(self) -> Vector:
        """One over the area, or volume, of the body workspace of the limbs that stay [1/m^2, 1/m^3] (4.21), (E,)."""
        return self.supports.robustness_costs[self.support_index]

    @cached_property
    def support(self) -> Vector:
        """Interval of a planar robot's centre of mass on the limbs that stay, SR1 of eq. 4.17 [m], shape (E, 2)."""
        return self.supports.intervals[self.support_index]

    def images(self, stance: Stance) -> list[Stance]:
        """The stances that the robot's symmetries make of this one, itself first."""
        n = self._rotations.num_limbs
        return [stance.permuted((i + s) % n for i in range(n)) for s in range(0, n, self._rotations.turn)]

    def vertex(self, stance: Stance) -> int:
        """The vertex of a stance.

        Raises:
            KeyError: If no sequence of moves leads there from the start.
        """
        for image in self.images(stance):
            (found,) = np.nonzero((self.stances == np.array(image.holds)).all(axis=1))
            if len(found):
                return int(found[0])
        raise KeyError(f"{stance} is not among the {self.num_vertices} stances that can be reached from the start")

    def edge(self, tail: int, head: int) -> int:
        """The edge from one vertex to another.

        Raises:
            KeyError: If there is none.
        """
        first, end = self.first_edge[tail], self.first_edge[tail + 1]
        edge = int(first + np.searchsorted(self.head[first:end], head))
        if edge < end and self.head[edge] == head:
            return edge
        raise KeyError(f"no edge leads from vertex {tail} to vertex {head}")

    def decode(self, start: Stance, vertices: Iterable[int]) -> list[Stance]:
        """The ordered stances of a walk, each one limb away from the one before.

        Args:
            start: How the robot really stands at the first vertex.
            vertices: The walk, the vertex of `start` first.

        Raises:
            ValueError: If the walk does not begin at `start`, or two vertices in a row are not one move apart.
        """
        stances: list[Stance] = []
        for vertex in vertices:
            images = self.images(Stance(tuple(int(hold) for hold in self.stances[vertex])))
            if not stances:
                close = [image for image in images if image == start]
            else:
                holds = stances[-1].holds
                close = [i for i in images if sum(a != b for a, b in zip(i.holds, holds, strict=True)) == 1]
            if not close:
                raise ValueError(f"vertex {vertex}, {images[0]}, does not follow {stances[-1] if stances else start}")
            stances.append(close[0])
        return stances

    def goal_vertices(
        self,
        holds: Iterable[int] | None = None,
        stance: Stance | None = None,
        region: Region | None = None,
    ) -> Ints:
        """The vertices that meet all the given conditions.

        Args:
            holds: The set of holds stood on, by whichever limbs.
            stance: The stance, up to the robot's symmetries.
            region: Where [m] the pelvis's origin can be, as far as reach allows; see `balls_meet_region`.

        Returns:
            Increasing vertex numbers, possibly none.
        """
        meets = np.ones(self.num_vertices, dtype=bool)
        if holds is not None:
            meets &= (np.sort(self.stances, axis=1) == np.sort(np.array(list(holds), dtype=int))).all(axis=1)
        if stance is not None:
            images = np.array([image.holds for image in self.images(stance)])
            meets &= (self.stances[:, None] == images).all(axis=-1).any(axis=1)
        if region is not None:
            distances = away(region, self._positions)  # (H,)
            meets &= (distances[self.stances] <= self._reach + TOUCH).all(axis=1)
            (near,) = np.nonzero(meets)
            meets[near] = balls_meet_region(self._positions[self.stances[near]], self._reach, region)
        return np.flatnonzero(meets).astype(np.int32)

    def pose_graph(self) -> PoseGraph:
        """The graph of the thesis: every pose connected to the start's by moves that may themselves be impossible."""
        used = np.zeros(len(self._poses), dtype=bool)
        used[self._moves.tail] = used[self._moves.head] = True
        poses = np.sort(self._poses[used], axis=1)
        order = np.lexsort(poses.T[::-1])
        number = np.zeros(len(self._poses), dtype=np.int32)
        number[np.flatnonzero(used)[order]] = np.arange(len(order))
        return PoseGraph(poses[order], number[self._moves.tail], number[self._moves.head], self._moves.cost)
