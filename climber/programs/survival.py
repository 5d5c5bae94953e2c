"""Instants of a motion as inequalities on the contact forces alone, and how far these reach when something is off.

At an instant the contact forces x [N] (and the moments of pins [N m]) must balance the robot in its velocities without
a motor, keep to what the holds can give and need no torque that the motors lack:

    E x = b,   G x <= g

Something that is off by d adds to both: E x = b + B d, G x <= g + C d. Forces that fit another instant, or another d,
are brought to this one by the least change that balances, and are then followed from forces well inside the limits
as far as the limits go: what has been found at one instant serves the others, and every number that comes out stands
on explicit forces that balance and keep to the limits.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from climber.programs.blocks import solve_each
from climber.robot import Indices
from climber.stance import Vector

Mask = NDArray[np.bool_]

LEVEL = 1e-9  # [N, N m] what forces may change a limit's row by and count as not changing it
UNBALANCED = 1e-6  # [N, N m] imbalance that is the rounding of whoever made the motion
ROOM = 1e3  # [N] the most room inside the limits that is looked for
NUDGE = 1e-6  # [N, N m] what limits may give way by where the solver gets stuck
SPARSE = 8  # samples of which the middle of the limits is looked for at one


@dataclass(frozen=True)
class Instants:
    """K instants: E x = b, G x <= g.

    Attributes:
        E: Shape (K, u, n).
        b: [N, N m], shape (K, u).
        G: Shape (K, r, n). The first rows are those of the contacts, R of each, then the pins' moments, then torques.
        g: [N, N m], shape (K, r).
        weight: Room that counts as 1 N in each row [N, N m], shape (r,).
        phase: The number of the phase that each is in, ascending, shape (K,).
        inverse: Pseudo-inverses of E, shape (K, n, u).
    """

    E: Vector
    b: Vector
    G: Vector
    g: Vector
    weight: Vector
    phase: Indices
    inverse: Vector

    def __len__(self) -> int:
        return len(self.b)

    def __getitem__(self, index: Indices | slice | Mask) -> Instants:
        """The instants at `index`."""
        parts = {field.name: getattr(self, field.name) for field in fields(self)}
        return Instants(**{name: part if name == "weight" else part[index] for name, part in parts.items()})

    @property
    def balanceable(self) -> Vector:
        """What the forces balance of b, shape (K, u); all of it unless the motion's rounding is more than they can."""
        result: Vector = (self.E @ (self.inverse @ self.b[:, :, None]))[:, :, 0]
        return result

    @cached_property
    def starts(self) -> Indices:
        """Where each phase starts among the instants, and where the last one ends."""
        return np.append(np.flatnonzero(np.diff(self.phase, prepend=-1)), len(self))

    def balanced(self, x: Vector, extra: Vector | float = 0.0) -> Vector:
        """The forces nearest to x, shape (K, n) or (n,), with E x = b + extra, or the least |E x - b - extra|."""
        gap = self.b + extra - (self.E @ x[..., None])[:, :, 0]
        result: Vector = x + (self.inverse @ gap[:, :, None])[:, :, 0]
        return result

    def room(self, x: Vector) -> Vector:
        """Room inside the limits, g - G x, shape (K, r), for forces x, (K, n)."""
        result: Vector = self.g - (self.G @ x[:, :, None])[:, :, 0]
        return result

    def stepped(self, room: Vector, slope: Vector) -> Vector:
        """How far one can go before a row's room is used up, shape (K, ...).

        Args:
            room: Room at the outset, shape (K, r, ...).
            slope: How fast it is used up, shape (K, r, ...).
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.where(slope > LEVEL, np.maximum(room, 0.0) / slope, np.inf)
        result: Vector = far.min(axis=1, initial=np.inf)
        return result

    @cached_property
    def _measured(self) -> Vector:
        """G with each row in parts of the room that the center leaves in it, transposed, shape (K, n, r)."""
        return np.ascontiguousarray(np.swapaxes(self.G * self._per_room[:, :, None], 1, 2))

    @cached_property
    def _per_room(self) -> Vector:
        """One over the room that the center leaves in each row [1/N, 1/N m], shape (K, r)."""
        return np.asarray(1.0 / np.maximum(self.room(self.center), LEVEL))

    def followed(self, at: slice, step: Vector, extra: Vector) -> Vector:
        """How many steps one can go from the center, shape (L, T).

        Args:
            at: L of the instants.
            step: T steps at each of them, shape (L, T, n).
            extra: What each adds to g, shape (L, T, r).
        """
        slope = step @ self._measured[at] - extra * self._per_room[at, None]
        with np.errstate(divide="ignore"):
            result: Vector = 1.0 / slope.max(axis=2, initial=0.0)
        return result

    @cached_property
    def center(self) -> Vector:
        """Forces well inside the limits, shape (K, n): `inmost` at one sample in `SPARSE`, else between those.

        Where what is between is much nearer to the limits, the best is sought there too.
        """
        places = np.unique(np.concatenate([np.arange(len(self))[::SPARSE], self.starts[:-1], self.starts[1:] - 1]))
        best, depth = self[places].inmost()
        known = np.isfinite(depth)
        if known.any():  # what no forces are found for borrows them
            nearest = np.abs(places[:, None] - places[known]).argmin(axis=1)
            best, depth = best[known][nearest], depth[known][nearest]
        every = np.arange(len(self))
        after = np.searchsorted(places, every)
        before = np.maximum(after - 1, 0)
        share = (every - places[before]) / np.maximum(places[after] - places[before], 1)
        result = self.balanced(best[before] + share[:, None] * (best[after] - best[before]))
        expected = np.minimum(depth[before], depth[after])
        shallow = np.flatnonzero((self.room(result) / self.weight).min(axis=1) < 0.5 * expected)
        if len(shallow):
            result[shallow] = self[shallow].inmost()[0]
        return result

    def inmost(self) -> tuple[Vector, Vector]:
        """Forces as far inside the limits as can be, by at most `ROOM`, shape (K, n), and how far, shape (K,).

        max s  subject to  E x = b,  G x + s weight <= g,  s <= ROOM
        """
        K, n = len(self), self.E.shape[2]
        b = self.balanceable
        cost, most = np.zeros((K, n + 1)), np.zeros((K, 1, n + 1))
        cost[:, n], most[:, 0, n] = -1.0, 1.0
        weight = np.broadcast_to(self.weight[:, None], (K, len(self.weight), 1))
        rows = np.concatenate([np.concatenate([self.G, weight], axis=2), most], axis=1)
        right = np.concatenate([self.g, np.full((K, 1), ROOM)], axis=1)
        found = solve_each(cost, np.pad(self.E, ((0, 0), (0, 0), (0, 1))), b, rows, right, nudge=NUDGE).x
        return self.balanced(found[:, :n]), found[:, n]

    @cached_property
    def sound(self) -> Mask:
        """Whether the center balances and is inside the limits, shape (K,)."""
        gap = np.abs(np.einsum("kun,kn->ku", self.E, self.center) - self.b).max(axis=1, initial=0.0)
        return np.asarray((gap <= UNBALANCED) & (self.room(self.center).min(axis=1, initial=0.0) >= -UNBALANCED))
