"""Which of many instants contacts and motors can carry, where the answer for one often answers its neighbours.

An instant can be carried if some forces t balance it, E t = b, within their own limits and with torques tau = c - A t
within theirs, |tau_j| <= L_j. For any y and w such forces have

    y . b + w . c = (E^T y + A^T w) . t + w . tau <= max (E^T y + A^T w) . t + sum_j |w_j| L_j

with the greatest over the limits of forces, which is known in closed form (`ContactForces.greatest`). Where this does
not hold there are none, whichever instant y and w come from; they are what multipliers of one instant's program say of
the robot as a whole: move it a little like this, and gravity does more work than contacts and motors can make up for.
Forces, in turn, that carry one instant often carry another after the least change that balances it. So programs are
solved for a few instants, what they say is tried at all others, and then for more of those that are left.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from climber.programs.instants import Instants, Mask
from climber.programs.torque_blocks import TOLERANCE, Least, least_violation, unlimited
from climber.robot import Indices
from climber.stance import Vector

FIRST = 4  # instants whose programs are solved in the first round, twice as many in each that follows
PLAINLY = 10 * TOLERANCE  # [N, N m] a violation that no solver's rounding makes up
MOST_FORCES, MOST_MULTIPLIERS = 8, 32  # that are remembered: those that were of use last


Item = TypeVar("Item")


class Precedents:
    """What solved instants say of others with the same limbs on whatever holds, for instants that come later."""

    def __init__(self) -> None:
        self._forces: list[Vector] = []
        self._multipliers: list[tuple[Vector, Vector]] = []

    def learn(self, least: Least) -> None:
        """Remembers solutions."""
        carried = least.s <= TOLERANCE
        self._forces = [*least.t[carried], *self._forces][:MOST_FORCES]
        no = np.flatnonzero(~carried & np.isfinite(least.s))
        self._multipliers = [*((least.y[i], least.w[i]) for i in no), *self._multipliers][:MOST_MULTIPLIERS]

    def open(self, instants: Instants, left: Indices, result: Mask) -> Indices:
        """Those of some places that nothing is known of; where instants are carried, `result` is set."""
        left = left[~self.refused(instants[left])]
        yes = self.carried(instants[left])
        result[left[yes]] = True
        return left[~yes]

    def carried(self, instants: Instants) -> Mask:
        """Which instants forces that were of use elsewhere carry, shape (K,)."""
        result = np.zeros(len(instants), dtype=bool)
        used: list[int] = []
        for i, t in enumerate(self._forces):
            left = np.flatnonzero(~result)
            if not len(left):
                break
            some = instants[left]
            nearest = some.balanced(np.broadcast_to(t, (len(some), len(t))))
            now = some.inside(nearest) & (some.imbalance(nearest) <= TOLERANCE)
            result[left] = now
            if now.any():
                used.append(i)
        self._forces = _first(self._forces, used)
        return result

    def refused(self, instants: Instants) -> Mask:
        """Which instants no forces carry, as multipliers that were of use elsewhere prove, shape (K,)."""
        result = np.zeros(len(instants), dtype=bool)
        if self._multipliers and len(instants):
            y, w = (np.array(parts) for parts in zip(*self._multipliers, strict=True))
            beyond = shortfall(instants, y, w) > PLAINLY
            result = np.asarray(beyond.any(axis=0), dtype=bool)
            self._multipliers = _first(self._multipliers, np.unique(beyond.argmax(axis=0)[result]).tolist())
        return result


def _first(items: list[Item], places: list[int]) -> list[Item]:
    """The items, those at some places first."""
    chosen = set(places)
    return [items[i] for i in places] + [item for i, item in enumerate(items) if i not in chosen]


def can_carry(instants: Instants, precedents: Precedents | None = None) -> Mask:
    """Which instants some balancing forces carry within all limits, up to rounding, shape (K,).

    Args:
        instants: The instants.
        precedents: What is known from others with the same limbs in contact; grows.
    """
    precedents = precedents or Precedents()
    result = np.zeros(len(instants), dtype=bool)
    left = precedents.open(instants, np.arange(len(instants)), result)
    if not len(left):
        return result
    # Few limits bind where a robot is strong and its holds are good.
    some = instants[left]
    t = unlimited(some)
    balanced, inside = some.imbalance(t) <= TOLERANCE, some.inside(t)
    result[left[balanced & inside]] = True
    left = left[balanced & ~inside]
    count = FIRST
    while len(left):
        chosen = _evenly(len(left), count)
        least = least_violation(instants[left[chosen]])
        precedents.learn(least)
        result[left[chosen]] = least.s <= TOLERANCE
        left = precedents.open(instants, np.delete(left, chosen), result)
        count *= 2
    return result


def _evenly(number: int, most: int) -> Indices:
    """At most so many places among a number of them, from the first to the last."""
    return np.unique(np.linspace(0, number - 1, min(number, most)).round().astype(int))


def shortfall(instants: Instants, y: Vector, w: Vector) -> Vector:
    """By how much contacts and motors fall short of carrying instants [W], as P virtual motions tell, shape (P, K).

    Where it is positive an instant cannot be carried.

    Args:
        instants: The instants.
        y: Rates of the velocities without a motor, shape (P, u).
        w: Rates of the joints with a motor, shape (P, j).
    """
    shape = instants.forces.lower.shape
    forces = replace(instants.forces, lower=instants.lower.reshape(shape), upper=instants.upper.reshape(shape))
    limited = np.isfinite(instants.limit)
    A, c, limit, w = instants.A[:, limited], instants.c[:, limited], instants.limit[limited], w[:, limited]
    slope = np.tensordot(y, instants.E, axes=(1, 1)) + np.tensordot(w, A, axes=(1, 1))  # (P, K, n)
    most = forces.greatest(slope.reshape(*slope.shape[:2], *shape)).sum(axis=-1)
    result: Vector = y @ instants.b.T + w @ c.T - most - (np.abs(w) @ limit)[:, None]
    return result
