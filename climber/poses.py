"""Poses and the moves between them: the checks of the stance graph, each made once for all rotations of equal limbs.

A pose is a stance up to rotations of its limbs that leave every place in the cyclic order with the same reach; for
limbs of one reach that is a set of holds. Moving round by one such step turns a stance into another that passes the
same checks, so what is found out about poses here holds for all their stances.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from climber.balls import balls_meet
from climber.geometry import TOUCH, Mask, counter_clockwise
from climber.holdsets import Ints, Places, Releases, reachable_sets
from climber.stance import Vector


@dataclass(frozen=True)
class Rotations:
    """How a cyclic order of limbs can be turned.

    Attributes:
        num_limbs: Number of limbs n.
        period: Least number of places after which the reaches repeat.
        turn: Least number of places by which a symmetry of the robot turns its limbs; n if there is none.
    """

    num_limbs: int
    period: int
    turn: int

    @classmethod
    def of(cls, reach: Vector, symmetries: Sequence[Sequence[int]]) -> Rotations:
        """The rotations of a robot.

        Raises:
            ValueError: If a symmetry is not a rotation of the limbs' cyclic order, or maps limbs of unlike reach.
        """
        n = len(reach)
        turn = n
        for permutation in symmetries:
            step = permutation[0]
            if list(permutation) != [(i + step) % n for i in range(n)]:
                raise ValueError(f"symmetry {tuple(permutation)} is not a rotation of {n} limbs in cyclic order")
            if np.abs(reach - np.roll(reach, step)).max() > TOUCH:
                raise ValueError(f"symmetry {tuple(permutation)} maps limbs of unlike reach {reach.tolist()} m")
            turn = math.gcd(turn, step)
        steps = (s for s in range(1, n + 1) if n % s == 0)
        return cls(n, next(s for s in steps if np.abs(reach - np.roll(reach, s)).max() <= TOUCH), turn)

    @property
    def copies(self) -> int:
        """Ordered stances of a pose."""
        return self.num_limbs // self.period

    @property
    def lifts(self) -> int:
        """Ordered stances of a pose that the robot's symmetries do not map onto each other."""
        return self.turn // self.period

    def limb(self, place: Places, lift: Places) -> Places:
        """The limb at a place of a pose's cyclic order, in the stance that is the pose turned by `lift` periods."""
        return (place - self.period * lift) % self.num_limbs


def find_poses(
    positions: Vector,
    reach: Vector,
    rotations: Rotations,
    counts: dict[str, int],
    projected: Callable[[Ints], Vector] | None = None,
) -> Ints:
    """All poses whose balls overlap and whose feet are in limb order around a strictly convex polygon.

    Args:
        positions: Holds [m], shape (H, 3), or (H, 2) in the wall plane.
        reach: Radius of each limb's ball [m], shape (n,).
        rotations: Of the robot.
        counts: Gains `tuples`, `valid`, `non_crossing` (ordered stances after each check) and `poses`.
        projected: Where sets of holds (M, n) are seen [m], shape (M, n, 2), see `Wall.projected`; their x and y if not
            given.

    Returns:
        The hold of each place, counter-clockwise, shape (P, n). Limb i at place i is one of the pose's stances.
    """
    n, num_holds = rotations.num_limbs, len(positions)
    sets = reachable_sets(positions, n, float(reach.max()))
    seen = positions[sets][..., :2] if projected is None else projected(sets)
    order, convex = counter_clockwise(seen)
    cycles: Ints = np.take_along_axis(sets, order, axis=1)[convex]
    if rotations.period == 1:
        valid = len(sets) * math.factorial(n)
    else:
        assignments = set(permutations(reach.round(9).tolist()))
        valid = sum(int(balls_meet(positions[sets], np.array(radii)).sum()) for radii in assignments)
        valid *= math.factorial(n) // len(assignments)
        cycles = np.concatenate([np.roll(cycles, -s, axis=1) for s in range(rotations.period)])
        cycles = cycles[balls_meet(positions[cycles], reach)]
    counts["tuples"], counts["valid"] = math.perm(num_holds, n), valid
    counts["poses"], counts["non_crossing"] = len(cycles), len(cycles) * rotations.copies
    return cycles


def start_component(
    releases: Releases, num_poses: int, rotations: Rotations, start: int, counts: dict[str, int]
) -> tuple[Mask, Releases]:
    """What can be reached from a stance by moving limb after limb, before any check on moves.

    Stances and supports are the two sides of a graph: a move is a step to a support and back.

    Args:
        releases: All releases of all poses.
        num_poses: Number of poses P.
        rotations: Of the robot.
        start: Ordered stance to start from, as pose times `copies` plus lift.
        counts: Gains `ordered_states_visited`, `ordered_transitions` and, between poses, `unique_transitions`.

    Returns:
        Which poses are reached, shape (P,), and the releases to supports that are reached.
    """
    n, copies = rotations.num_limbs, rotations.copies
    num_supports = int(releases.support[-1]) + 1
    num_stances, lift = num_poses * copies, np.arange(copies)[:, None]
    left = np.empty((num_poses, n), dtype=np.int32)  # support left by the release of each place
    left[releases.pose, releases.place] = releases.support
    freed = rotations.limb(np.arange(n), lift) // rotations.period  # (copies, n)
    columns = num_stances + left[:, None] * copies + freed.astype(np.int32)  # (P, copies, n)
    size = num_stances + num_supports * copies
    rows = np.minimum(np.arange(size + 1, dtype=np.int32), num_stances) * n
    links = csr_array((np.ones(columns.size, dtype=np.int8), columns.ravel(), rows), shape=(size, size))
    label = connected_components(links, directed=False)[1]
    reached = label == label[start]

    supports = reached[num_stances:].reshape(num_supports, copies)
    users = np.bincount(releases.support)  # stances that leave the same support
    counts["ordered_states_visited"] = int(reached[:num_stances].sum())
    counts["ordered_transitions"] = int((supports.sum(axis=1) * users * (users - 1)).sum())
    any_copy = supports.any(axis=1)
    counts["unique_transitions"] = int((any_copy * users * (users - 1)).sum()) // 2
    return reached[:num_stances].reshape(num_poses, copies).any(axis=1), releases[any_copy[releases.support]]
