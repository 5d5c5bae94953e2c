"""The stance graph: every way to stand on the wall that the relaxed checks allow, and every move between two of them.

Gönen 2021, section 4.2, without its permutations. A stance is kept if the balls around its holds overlap (4.2) and its
feet are in limb order around a strictly convex polygon (4.6); a move, if all balls of both its stances overlap (4.7)
and the centre of mass can be over the holds that stay and over the holds of the stance it ends in at once (4.17). In
the wall plane balls are disks; in space feet are in order as they are seen by who faces the wall (`Wall.projected`).

These checks do not change when equal limbs all step round by one place, so they are made once for each *pose*, a stance
up to such rotations (`climber.poses`, `climber.moves`). What a leg can really do does change, so the vertices of the
graph are ordered stances, up to the robot's own symmetries only. `StanceGraph.pose_graph` is the thesis's coarser
graph.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order

from climber.balls import balls_meet, balls_meet_region
from climber.exceptions import ClimberError
from climber.geometry import TOUCH, Mask
from climber.holdsets import Ints, Places, Releases
from climber.moves import Moves, Setting, Supports, Weights, find_moves, intervals
from climber.poses import Rotations, find_poses, start_component
from climber.solids import Region, away
from climber.stance import Stance, Vector
from climber.wall import Wall


class GraphRobot(Protocol):
    """What the graph asks of a robot; `climber.robot.Robot` has it."""

    @property
    def reach(self) -> Vector:
        """Farthest that each foot can be from the pelvis's origin [m], limbs counter-clockwise, shape (n,)."""

    @property
    def symmetries(self) -> Sequence[Sequence[int]]:
        """Limb permutations that map the robot to itself."""

    @property
    def mass(self) -> float:
        """Total mass [kg]."""

    @property
    def dimension(self) -> int:
        """2 for a robot that stays in the wall plane, 3 for one in space."""


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
        sums = self.stances.sum(axis=1, dtype=np.int32)
        result: Ints = sums[self.head] - sums[self.tail] + self.released
        return result

    @cached_property
    def reach_cost(self) -> Vector:
        """How far the foot travels [m] (4.19), shape (E,)."""
        old = self.stances[self.tail, self.limb]
        total = self.stances.sum(axis=1)  # stances that differ in one hold differ in this sum by just that hold
        new = total[self.head] - total[self.tail] + old
        result: Vector = np.linalg.norm(self._positions[old] - self._positions[new], axis=1)
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


def build_stance_graph(
    wall: Wall,
    robot: GraphRobot,
    start: Stance,
    weights: Weights,
    avoid: Sequence[int] = (),
    through_space: bool = False,
) -> StanceGraph:
    """Builds the graph of all that can be reached from a stance.

    `counts` of the result, in the thesis's terms: ordered `tuples` of holds; of them `valid` (disks overlap) and
    `non_crossing`, and these as `poses`; `ordered_states_visited` and `ordered_transitions` from the start without
    further checks, `unique_transitions` between poses; of those `reach_ok` and `stable_pairs`, `stable_directed` by
    direction, without those `directed_where_SR2_clause_rejects`; `graph_nodes` and `graph_edges_undirected` of the
    thesis's graph, and `supports` that its moves stand on meanwhile. In ours, the `vertices` and `edges`.

    Args:
        wall: The wall.
        robot: Limbs in counter-clockwise order, their reach, the robot's mass and symmetries.
        start: The stance to start from.
        weights: Of the costs.
        avoid: Holds that are not stood on.
        through_space: Take a planar robot's wall as one in space, too. It makes no difference but to the time taken.

    Raises:
        ValueError: If `start` is not one hold of the wall for each limb, or a symmetry is not a rotation of the limbs.
        ClimberError: If `start` itself fails a relaxed check.
    """
    reach, space = np.asarray(robot.reach, dtype=float), through_space or robot.dimension == 3
    positions = np.ascontiguousarray(wall.positions if space else wall.positions[:, :2])
    setting = Setting(wall, reach, robot.mass, robot.dimension, positions)
    rotations = Rotations.of(reach, robot.symmetries)
    counts: dict[str, int] = {}
    usable = np.setdiff1d(np.arange(len(positions), dtype=np.int32), np.array(avoid, dtype=np.int32))

    def projected(sets: Ints) -> Vector:
        return wall.projected(usable[sets])

    poses = usable[find_poses(positions[usable], reach, rotations, counts, projected if space else None)]
    start_pose, start_lift = _find_start(start, poses, positions, reach, rotations)
    releases = Releases.of(poses, rotations.period)
    start_state = start_pose * rotations.copies + start_lift
    reached, releases = start_component(releases, len(poses), rotations, start_state, counts)
    moves, supports, extents = find_moves(setting, weights, rotations, poses, reached, releases, counts)
    ends = np.zeros(len(poses), dtype=bool)
    ends[moves.tail] = ends[moves.head] = True
    counts["graph_nodes"], counts["graph_edges_undirected"] = int(ends.sum()), counts["stable_pairs"]

    start_vertex = start_pose * rotations.lifts + start_lift % rotations.lifts
    kept, source, lift, head = _lift(moves, len(poses), rotations, start_vertex)
    number = (np.cumsum(kept) - 1).astype(np.int32)
    vertices = np.flatnonzero(kept)
    pose, turned = np.divmod(vertices, rotations.lifts)
    stances = poses[pose[:, None], (np.arange(len(reach)) + rotations.period * turned[:, None]) % len(reach)]
    counts["vertices"], counts["edges"] = len(vertices), len(source)
    return StanceGraph(
        stances=stances,
        tail=number[moves.tail[source] * rotations.lifts + lift],
        head=number[head],
        limb=rotations.limb(moves.place[source].astype(np.int64), lift).astype(np.int8),
        cost=moves.cost[source],
        support_index=moves.support[source],
        start=int(number[start_vertex]),
        stance_support=intervals(extents[pose]) if robot.dimension == 2 else np.zeros((0, 2)),
        supports=supports,
        counts=counts,
        _rotations=rotations,
        _reach=reach,
        _positions=positions,
        _poses=poses,
        _moves=moves,
    )


def _find_start(start: Stance, poses: Ints, positions: Vector, reach: Vector, rotations: Rotations) -> tuple[int, int]:
    """The pose of the start stance, and by how many periods it is turned."""
    holds = np.array(start.holds, dtype=int)
    n, num_holds = len(reach), len(positions)
    if len(holds) != n or len(set(start.holds)) != n or holds.min() < 0 or holds.max() >= num_holds:
        raise ValueError(
            f"a stance needs {n} different holds of 0 to {num_holds - 1}, one for each limb; given {start}"
        )
    for lift in range(rotations.copies):
        (found,) = np.nonzero((poses == np.roll(holds, lift * rotations.period)).all(axis=1))
        if len(found):
            return int(found[0]), lift
    if not balls_meet(positions[holds][None], reach)[0]:
        reason = f"no place of the pelvis is within reach, {reach.tolist()} m, of all its holds"
    else:
        reason = "its feet are not in limb order, counter-clockwise, around a strictly convex polygon"
    raise ClimberError(f"{start} cannot be stood on: {reason}")


def _lift(moves: Moves, num_poses: int, rotations: Rotations, start: int) -> tuple[Mask, Places, Places, Places]:
    """The vertices that moves lead to from the start, and their edges.

    Vertex `pose * lifts + lift` is a pose turned by `lift` periods; so the vertices of a pose follow one another, and
    so do the edges of each vertex.

    Returns:
        Which vertices are reached, shape (P lifts,); and, for each edge between them, sorted by tail, the move it is
        made of, the lift of its tail, and the vertex of its head, shape (E,).
    """
    lifts, num_moves = rotations.lifts, np.bincount(moves.tail, minlength=num_poses)
    before = np.cumsum(num_moves) - num_moves
    source, lift = np.empty((2, len(moves.tail) * lifts), dtype=np.int64)
    for q in range(lifts):
        edges = (lifts - 1) * before[moves.tail] + q * num_moves[moves.tail] + np.arange(len(moves.tail))
        source[edges], lift[edges] = np.arange(len(moves.tail)), q
    head = moves.head[source].astype(np.int64) * lifts + (lift + moves.turn[source]) % lifts

    degree = np.repeat(num_moves, lifts)
    first_edge = np.append(0, np.cumsum(degree))
    links = csr_array((np.ones(len(head), dtype=np.int8), head, first_edge), shape=(len(degree), len(degree)))
    reached = np.zeros(len(degree), dtype=bool)
    reached[breadth_first_order(links, start, return_predecessors=False)] = True
    kept = np.repeat(reached, degree)
    return reached, source[kept], lift[kept], head[kept]
