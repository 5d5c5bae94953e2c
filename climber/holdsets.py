"""Sets of holds within reach of one body, and which of them differ in a single hold. Combinatorics on arrays.

Nothing here enumerates permutations or combinations of all holds: sets grow hold by hold among near neighbours, and
sets that differ in one hold are found by sorting on what they share.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from climber.balls import is_flat, quads_fit
from climber.geometry import TOUCH, triangle_fits
from climber.stance import Vector

Ints = NDArray[np.int32]
Places = NDArray[np.int64]
CHUNK = 1 << 17  # candidate sets looked at together: a few arrays of these stay in the cache


def reachable_sets(positions: Vector, size: int, reach: float) -> Ints:
    """All sets of `size` holds whose balls of radius `reach` have a common point (Gönen 2021, eq. 4.2).

    Pairs come from a KD-tree. A set of m + 1 holds joins two of m that differ in their last hold; of its triples only
    those with both last holds are new, and by Helly's theorem triples decide in a plane. In space its fours with both
    last holds are looked at as well.

    Args:
        positions: Holds [m], shape (H, 3), or (H, 2) in the wall plane.
        size: Number of holds in a set, at least 1.
        reach: Radius of the balls [m].

    Returns:
        Sets as increasing hold numbers, in lexicographic order, shape (M, size).
    """
    if size == 1:
        return np.arange(len(positions), dtype=np.int32)[:, None]
    pairs = cKDTree(positions).query_pairs(2.0 * (reach + TOUCH), output_type="ndarray")
    sets: Ints = np.sort(pairs, axis=1).astype(np.int32)
    sets = sets[np.lexsort((sets[:, 1], sets[:, 0]))]
    squares = squared_distance(positions, sets[:, 0], sets[:, 1])[:, None]  # from the last hold to the others
    flat = is_flat(positions)
    prefix: Ints = sets[:, 0]  # sets with the same number share all but their last hold
    while sets.shape[1] < size:
        found = []
        for a, b in later_partners(prefix):
            apart = squared_distance(positions, sets[a, -1], sets[b, -1])
            fits = apart <= 4.0 * (reach + TOUCH) ** 2
            for to_a, to_b in zip(squares[a].T, squares[b].T, strict=True):
                fits &= triangle_fits(to_a, to_b, apart, reach)
            if not flat:
                for i, j in combinations(range(sets.shape[1] - 1), 2):
                    rows = np.flatnonzero(fits)
                    four = sets[a[rows], i], sets[a[rows], j], sets[a[rows], -1], sets[b[rows], -1]
                    fits[rows] = quads_fit(positions, four, reach)
            a, b = a[fits], b[fits]
            found.append((a.astype(np.int32), sets[b, -1], np.column_stack([squares[b], apart[fits]])))
        prefix, last, squares = (np.concatenate(column) for column in zip(*found, strict=True))
        sets = np.column_stack([sets[prefix], last])
    return sets


@dataclass(frozen=True)
class Releases:
    """Every way in which one limb of a stance lets go, sorted by the *support* that is left.

    Two stances are one move apart exactly if each can let one limb go so that the same support is left: the same holds
    in the same cyclic order, with the gap at the same place.

    Attributes:
        pose: Number of the stance, shape (R,).
        place: Place in the stance's cyclic order of the limb that lets go, shape (R,).
        support: Number of the support that is left, not decreasing, shape (R,).
    """

    pose: Ints
    place: Ints
    support: Ints

    @classmethod
    def of(cls, poses: Ints, period: int) -> Releases:
        """The releases of stances given as holds in counter-clockwise order.

        Args:
            poses: Hold at each place, shape (P, n).
            period: One limb can stand in for another only if their places differ by a multiple of this.
        """
        P, n = poses.shape
        num_holds = int(poses.max(initial=0)) + 1
        key = np.tile(np.arange(n, dtype=np.int64) % period, (P, 1))
        bound = period
        for step in range(1, n):
            if bound > np.iinfo(np.int64).max // num_holds:  # renumber, so that the key stays a 64-bit number
                values, key = np.unique(key, return_inverse=True)
                bound = len(values)
            key = key.reshape(P, n) * num_holds + np.roll(poses, -step, axis=1)
            bound *= num_holds
        key = key.ravel()
        order = key.argsort()  # equal keys in any order: what is built from them is sorted again
        key = key[order]
        support = np.zeros(len(key), dtype=np.int32)
        np.cumsum(key[1:] != key[:-1], out=support[1:])
        pose, place = np.divmod(order.astype(np.int32), np.int32(n))
        return cls(pose, place, support)

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.integer]) -> Releases:
        """Some of the releases."""
        return Releases(self.pose[rows], self.place[rows], self.support[rows])


def later_partners(labels: Ints) -> Iterator[tuple[Places, Places]]:
    """All pairs of rows with the same label, chunk by chunk, at least one chunk.

    Args:
        labels: Not decreasing, shape (N,).

    Yields:
        Rows a and b > a, in lexicographic order, shapes (num_pairs,).
    """
    rows = np.arange(len(labels))
    ends = np.append(np.flatnonzero(labels[1:] != labels[:-1]) + 1, len(labels))  # of the runs of equal labels
    count = np.repeat(ends, np.diff(ends, prepend=0)) - rows - 1  # rows after this one with its label
    total = np.cumsum(count)
    cuts = np.searchsorted(total, np.arange(CHUNK, total[-1] if len(total) else 0, CHUNK))
    for first, end in zip([0, *cuts], [*cuts, len(labels)], strict=True):
        a = np.repeat(rows[first:end], count[first:end])
        started = np.repeat(total[first:end] - count[first:end], count[first:end])
        yield a, a + 1 + np.arange(started[0], started[0] + len(a)) - started if len(a) else a


def squared_distance(positions: Vector, a: Ints, b: Ints) -> Vector:
    """|p_a - p_b|^2 [m^2]."""
    x, y, *rest = positions.T
    result: Vector = (x[a] - x[b]) ** 2 + (y[a] - y[b]) ** 2
    for z in rest:
        result += (z[a] - z[b]) ** 2
    return result
