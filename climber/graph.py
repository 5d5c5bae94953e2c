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

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order

from climber.balls import balls_meet
from climber.exceptions import ClimberError
from climber.geometry import Mask
from climber.holdsets import Ints, Places, Releases
from climber.moves import Moves, Setting, Weights, find_moves, intervals
from climber.poses import Rotations, find_poses, start_component
from climber.stance import Stance, Vector
from climber.stance_graph import StanceGraph
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
