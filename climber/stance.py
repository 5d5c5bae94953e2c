"""Stances, moves, contacts and postures: the nouns every stage shares. Types only, no search."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True, order=True)
class Stance:
    """Which hold each limb is on.

    Attributes:
        holds: The hold number of each limb, in the robot's own limb order.
    """

    holds: tuple[int, ...]

    def moved(self, limb: int, hold: int) -> Stance:
        """The stance after `limb` has gone to `hold`, the other limbs staying."""
        return Stance((*self.holds[:limb], hold, *self.holds[limb + 1 :]))

    def permuted(self, permutation: Iterable[int]) -> Stance:
        """The stance in which limb `i` stands where limb `permutation[i]` stood."""
        return Stance(tuple(self.holds[i] for i in permutation))


@dataclass(frozen=True, order=True)
class Move:
    """One limb leaves its hold for another while all the others hold on."""

    start: Stance
    limb: int
    hold: int

    @property
    def end(self) -> Stance:
        """The stance the move leads to."""
        return self.start.moved(self.limb, self.hold)

    @property
    def released(self) -> int:
        """The hold that the moving limb leaves."""
        return self.start.holds[self.limb]


@dataclass(frozen=True)
class Contact:
    """A limb's foot on a hold, at a definite point of the hold's patch.

    Attributes:
        limb: Index of the limb in the robot's limb order.
        hold: Number of the hold on the wall.
        offset: Signed distance of the foot from the patch's centre along the patch's tangent [m]. The centre leaves the
            most room for error and is where a foot lands unless only another point of the patch will do.
        across: Signed distance along the other direction of the patch, out of the wall plane on a planar wall [m].
            Feet of planar robots have none.
    """

    limb: int
    hold: int
    offset: float = 0.0
    across: float = 0.0


@dataclass(frozen=True)
class Posture:
    """A configuration of the whole robot on the contacts of one stance.

    Attributes:
        q: Positions of the plant [m, rad], shape (nq,).
        contacts: The contacts it stands on, in limb order.
        branches: The inverse-kinematics branch of each limb (elbow bend), in limb order.
    """

    q: Vector
    contacts: tuple[Contact, ...]
    branches: tuple[int, ...]
