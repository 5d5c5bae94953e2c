"""Moves between poses: reachability, stability and cost (Gönen 2021, section 4.2.2 and eqs. 4.19-4.22)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from climber.balls import balls_meet, is_flat, overlap_measures, quads_fit
from climber.geometry import TOUCH, Mask, overlap_areas, triangle_fits
from climber.holdsets import Ints, Releases, later_partners, squared_distance
from climber.poses import Rotations
from climber.programs.regions import hold_set_supports
from climber.programs.support import hold_set_intervals
from climber.programs.wrenches import across
from climber.stance import Vector
from climber.wall import Wall

DIRECTIONS = 8  # in which the support of a robot in space is measured
LOOSE = 0.01  # [m] by how much it may seem to reach farther than it does
LEAST_WIDTH = 1e-3  # [m] a support counts as at least this wide in the cost
LEAST_AREA = 1e-4  # [m^2, m^3] a body workspace counts as at least this large in the cost
OVERLAP = 1e-9  # [m] support intervals that miss each other by less than this touch


class Weights(Protocol):
    """Weights of the three costs of a move, W1, W2 and W3 of eq. 4.22; `climber.scenario.CostWeights` has them."""

    @property
    def reach(self) -> float:
        """W1, on the distance that the moving limb travels [1/m]."""

    @property
    def stability(self) -> float:
        """W2, on one over the width of the support of the limbs that stay [m]."""

    @property
    def robustness(self) -> float:
        """W3, on one over the area or volume of the body workspace of the limbs that stay [m^2, m^3]."""


@dataclass(frozen=True)
class Setting:
    """A robot on a wall, as far as the checks of moves are concerned.

    Attributes:
        wall: The wall.
        reach: Radius of each limb's ball [m], shape (n,).
        mass: The robot's mass [kg].
        dimension: 2 for a robot in the wall plane, 3 for one in space.
        positions: Where holds are [m], shape (H, 3), or (H, 2) if nothing is out of the wall plane.
    """

    wall: Wall
    reach: Vector
    mass: float
    dimension: int
    positions: Vector

    @cached_property
    def directions(self) -> Vector:
        """Unit directions across gravity in which supports are measured, each followed after half of them by its
        opposite; -x and x in the plane. Shape (D, 3).
        """  # noqa: D205 - one sentence
        if self.dimension == 2:
            return np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        turn = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        result: Vector = np.column_stack([-np.cos(turn), -np.sin(turn)]) @ across(self.wall.gravity)
        return result

    def extents(self, sets: NDArray[np.integer]) -> Vector:
        """How far the centre of mass can be along each of the directions over sets of holds [m], (M, D); NaN if none.

        Exact in the plane. In space the most that it can be, by proof, and no more than `LOOSE` beyond what it can.
        """
        if self.dimension == 2:
            exact: Vector = hold_set_intervals(self.wall, sets, self.mass) * np.array([-1.0, 1.0])
            return exact
        return hold_set_supports(self.wall, sets, self.mass, self.directions, self.dimension, gap=LOOSE)[1]

    def measures(self, holds: NDArray[np.integer], limbs: NDArray[np.integer]) -> Vector:
        """Area [m^2] or, in space, volume [m^3] of the body workspace of limbs on holds, (M, k) each; shape (M,)."""
        centers, radii = self.positions[holds], self.reach[limbs]
        return overlap_areas(centers[..., :2], radii) if self.dimension == 2 else overlap_measures(centers, radii)


@dataclass(frozen=True)
class Supports:
    """The sets of holds that stay during moves.

    Attributes:
        holds: In cyclic order, beginning after the gap of the limb that moves, shape (U, n - 1).
        extents: How far the centre of mass can be along `Setting.directions` [m], shape (U, D); NaN where it cannot be
            anywhere.
        measures: Area or volume of the body workspace [m^2, m^3], shape (U,).
    """

    holds: Ints
    extents: Vector
    measures: Vector

    @property
    def intervals(self) -> Vector:
        """Interval of the centre of mass of a robot in the wall plane [m], SR1 of eq. 4.17, shape (U, 2)."""
        return intervals(self.extents)

    @property
    def stability_costs(self) -> Vector:
        """One over the least width of where the centre of mass can be [1/m] (4.20), shape (U,)."""
        half = self.extents.shape[1] // 2
        width: Vector = (self.extents[:, :half] + self.extents[:, half:]).min(axis=1)
        return 1.0 / np.maximum(width, LEAST_WIDTH)

    @property
    def robustness_costs(self) -> Vector:
        """One over the area or volume of the body workspace [1/m^2, 1/m^3] (4.21), shape (U,)."""
        return 1.0 / np.maximum(self.measures, LEAST_AREA)


def intervals(extents: Vector) -> Vector:
    """Extents along -x and x as intervals."""
    result: Vector = extents * np.array([-1.0, 1.0])
    return result


@dataclass(frozen=True)
class Moves:
    """Directed moves between poses, sorted by tail, then head.

    Attributes:
        tail: Pose each starts from, shape (E,).
        head: Pose each leads to, shape (E,).
        place: Place of the moving limb in the tail's cyclic order, shape (E,).
        turn: By how many periods of the rotation the limbs that stay are further on in the head's order, shape (E,).
        support: Row of what stays in the table of supports, shape (E,).
        cost: Rounded cost (4.22), shape (E,).
    """

    tail: Ints
    head: Ints
    place: NDArray[np.int8]
    turn: NDArray[np.int8]
    support: Ints
    cost: Ints


def reachable_pairs(
    positions: Vector, reach: Vector, rotations: Rotations, poses: Ints, releases: Releases
) -> tuple[Ints, Ints, Vector]:
    """Pairs of releases of the same support whose stances' balls all overlap together (4.7).

    A robot of two limbs hangs from one of them meanwhile, and its pelvis swings round: there all pairs will do.
    Otherwise both stances' own balls are known to overlap, and three by three decide, in space four by four (Helly); so
    only those with the hold let go, the hold taken and others that stay are new.

    Returns:
        Rows of `releases`, shape (N,) twice, sorted by support, and the distance from hold to hold [m], shape (N,).
    """
    n = rotations.num_limbs
    moving = poses[releases.pose, releases.place]
    around = (releases.place[:, None] + np.arange(1, n)) % n
    staying = poses[releases.pose[:, None], around]  # (R, n - 1), the same along a support
    equal, radius, flat = rotations.period == 1, float(reach.max()), is_flat(positions)
    squares = squared_distance(positions, moving[:, None], staying)  # (R, n - 1)
    found = []
    for a, b in later_partners(releases.support):
        apart = squared_distance(positions, moving[a], moving[b])
        if n == 2:
            meet = np.ones(len(a), dtype=bool)
        elif equal:
            meet = apart <= 4.0 * (radius + TOUCH) ** 2
            for i in range(n - 1):
                meet &= triangle_fits(squares[a, i], squares[b, i], apart, radius)
            for i, j in combinations(range(n - 1), 2) if not flat else ():
                rows = np.flatnonzero(meet)
                four = staying[a[rows], i], staying[a[rows], j], moving[a[rows]], moving[b[rows]]
                meet[rows] = quads_fit(positions, four, radius)
        else:
            holds = np.column_stack([staying[a], moving[a], moving[b]])
            places = np.column_stack([around[a], releases.place[a], releases.place[a]])
            meet = balls_meet(positions[holds], reach[places])
        found.append((a[meet].astype(np.int32), b[meet].astype(np.int32), np.sqrt(apart[meet])))
    before, after, distance = zip(*found, strict=True)
    return np.concatenate(before), np.concatenate(after), np.concatenate(distance)


def support_table(setting: Setting, rotations: Rotations, poses: Ints, releases: Releases) -> Supports:
    """Extents and body workspace of the supports that the given releases leave, one row for each release."""
    n = rotations.num_limbs
    around = (releases.place[:, None] + np.arange(1, n)) % n
    holds = poses[releases.pose[:, None], around]
    # A set of holds occurs with the gap at several places; for equal limbs all is the same for each of them.
    sets, which = unique_rows(np.sort(holds, axis=1))
    extents = setting.extents(sets)[which]
    if rotations.period == 1:
        measures = setting.measures(sets, np.arange(1, n))[which]
    else:
        measures = setting.measures(holds, around)
    return Supports(holds, extents, measures)


def find_moves(
    setting: Setting,
    weights: Weights,
    rotations: Rotations,
    poses: Ints,
    reached: Mask,
    releases: Releases,
    counts: dict[str, int],
) -> tuple[Moves, Supports, Vector]:
    """All moves between poses that pass the checks.

    A move is stable if the holds that stay can carry the robot and the centre of mass can be over them and over the
    holds of the stance the move ends in (4.17). In space only the former is asked for: what the holds that stay can
    hold, all holds can, but for a foot that must push with a least force.

    Args:
        setting: The robot on the wall.
        weights: Of the costs.
        rotations: Of the robot.
        poses: Hold at each place, shape (P, n).
        reached: The poses between which to look for moves, shape (P,).
        releases: Their releases, sorted by support.
        counts: Gains `reach_ok`, `stable_pairs`, `stable_directed`, `directed_where_SR2_clause_rejects`, `supports`.

    Returns:
        The moves, their supports, and the extents of the centre of mass on each reached pose [m], shape (P, D), NaN
        elsewhere and where it cannot be anywhere; all NaN in space.
    """
    a, b, distance = reachable_pairs(setting.positions, setting.reach, rotations, poses, releases)
    left, support = _numbered(releases.support[a])
    supports = support_table(setting, rotations, poses, releases[a[left]])

    pose_a, pose_b = releases.pose[a], releases.pose[b]
    extents = np.full((len(poses), len(setting.directions)), np.nan)
    held = supports.extents[support]
    if setting.dimension == 2:
        extents[reached] = setting.extents(poses[reached])
        to_b, to_a = overlap(held, extents[pose_b]), overlap(held, extents[pose_a])
    else:
        to_a = to_b = ~np.isnan(held[:, 0])
    can_hold = int((~np.isnan(held[:, 0])).sum())
    counts["reach_ok"], counts["supports"] = len(a), len(supports.holds)
    counts["stable_pairs"], counts["stable_directed"] = int((to_a | to_b).sum()), int(to_a.sum() + to_b.sum())
    counts["directed_where_SR2_clause_rejects"] = 2 * can_hold - counts["stable_directed"]

    cost = weights.reach * distance
    cost += (weights.stability * supports.stability_costs + weights.robustness * supports.robustness_costs)[support]

    pair = np.concatenate([np.flatnonzero(to_b), np.flatnonzero(to_a)]).astype(np.int32)
    back = np.arange(len(pair)) >= to_b.sum()  # these lead from b to a
    key = np.where(back, pose_b[pair], pose_a[pair]) * np.int64(len(poses)) + np.where(back, pose_a[pair], pose_b[pair])
    order = key.argsort()
    tail, head = np.divmod(key[order], len(poses))
    pair, back, cost = pair[order], back[order], cost[pair[order]]
    if len(cost) and cost.max() > np.iinfo(np.int32).max:
        raise ValueError(
            f"a move costs {cost.max():.3g}, more than a 32-bit number; use smaller weights than {weights}"
        )
    place_a, place_b = releases.place[a][pair], releases.place[b][pair]
    moves = Moves(
        tail.astype(np.int32),
        head.astype(np.int32),
        place=np.where(back, place_b, place_a).astype(np.int8),
        turn=(np.where(back, place_a - place_b, place_b - place_a) // rotations.period).astype(np.int8),
        support=support[pair],
        cost=np.rint(cost).astype(np.int32),
    )
    return moves, supports, extents


def unique_rows(rows: Ints) -> tuple[Ints, Ints]:
    """The distinct rows of an array in lexicographic order, and the number of each row's."""
    order = np.lexsort(rows.T[::-1]) if rows.shape[1] else np.arange(len(rows))
    first, number = _numbered(rows[order])
    which = np.empty(len(rows), dtype=np.int32)
    which[order] = number
    return rows[order[first]], which


def _numbered(runs: NDArray[np.integer]) -> tuple[Ints, Ints]:
    """Where each run of equal entries starts, and the number of the run that each entry is in."""
    changes = runs[1:] != runs[:-1]
    if changes.ndim == 2:
        changes = changes.any(axis=1)
    number = np.zeros(len(runs), dtype=np.int32)
    np.cumsum(changes, out=number[1:])
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    return starts.astype(np.int32), number


def overlap(a: Vector, b: Vector) -> Mask:
    """Whether extents along -x and x overlap; an empty one, NaN, overlaps nothing."""
    result: Mask = np.minimum(a, b).sum(axis=1) >= -OVERLAP
    return result
