"""Margins to errors of what the holds can give: friction that is less, and a normal that is turned.

For forces x that balance, the greatest error e that they keep to the limits with follows in closed form, row by row
(`FrictionError.reach`, `NormalError.reach`). The best forces are found as Dinkelbach does for quotients: given the
error e that is survived so far, forces with the most room in the rows that the error changes,

    max s   subject to   E x = b,   G(e) x + s rate <= g(e),

allow a greater one, and so on; errors between the two are survived with these forces too. As the rows have the rates at
which they change with the error, it converges faster than linearly (Crouzeix and Ferland 1991), and every number on the
way is proved by its forces. Where a phase is known to survive no more than some error elsewhere, e is that error but
for half of `GAP`, so that one program settles it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from climber.programs.blocks import solve_each
from climber.programs.grips import Grips
from climber.programs.margins import GAP, Worst
from climber.programs.survival import LEVEL, NUDGE, Instants
from climber.stance import Vector

SETTLED = 1e-3  # an error that grows by a smaller share in one step has arrived
ASIDE = 0.2  # share of the rates that rows have which the error does not change
SLOWEST = 1e-2  # share of the fastest rate that others have at least


class Error(Protocol):
    """One-parameter errors of holds, several of them to be told apart by a number w."""

    @property
    def count(self) -> int:
        """How many errors there are."""

    @property
    def cap(self) -> float:
        """Greater errors are not looked for."""

    def reach(self, phase: int, which: int, x: Vector, start: Vector) -> Vector:
        """The greatest error up to which forces x, (K, n), survive all errors from `start` on, (K,); at least that."""

    def own(self, which: int, R: int) -> slice:
        """Which of the contacts' rows, R for each, need not hold where there is no error."""

    def program(self, phase: int, which: int, error: float, x: Vector) -> tuple[Vector, Vector, Vector]:
        """Matrix (k R, n) and right side (k R,) of the contacts' rows, and the rates at which the error changes them.

        Rates are those at forces x, shape (n,), and never quite zero; zero for rows that do not change.
        """


class FrictionError:
    """Friction less by a share, at all contacts."""

    count = 1

    def __init__(self, grips: Grips, num_contacts: int, dimension: int, cap: float) -> None:
        """For phases of so many contacts, whose grips follow one another."""
        self.cap = cap
        self._grips, self._k, self._dimension = grips, num_contacts, dimension

    def _of(self, phase: int) -> Grips:
        return self._grips[phase * self._k : (phase + 1) * self._k]

    def own(self, which: int, R: int) -> slice:  # noqa: D102
        return slice(0, 0)

    def reach(self, phase: int, which: int, x: Vector, start: Vector) -> Vector:  # noqa: D102
        grips, f = self._of(phase), _forces(x, self._k, self._dimension)
        with np.errstate(divide="ignore", invalid="ignore"):
            needed = np.einsum("ird,kid->kir", grips.base, f) - grips.most
            given = grips.more - np.einsum("ird,kid->kir", grips.along, f)
            chi = np.where(given > 1e-12, needed / given, np.where(needed > 0.0, np.inf, 0.0))
        rubs = (grips.along != 0.0).any(axis=2)
        most = np.where(rubs, chi, 0.0).max(axis=(1, 2), initial=0.0)
        return np.asarray(np.maximum(np.clip(1.0 - most, 0.0, self.cap), start))

    def program(self, phase: int, which: int, error: float, x: Vector) -> tuple[Vector, Vector, Vector]:  # noqa: D102
        grips, f = self._of(phase), _forces(x[None], self._k, self._dimension)[0]
        rows, most = grips.rows(1.0 - error)
        given = grips.more - np.einsum("ird,id->ir", grips.along, f)
        rate = np.where((grips.along != 0.0).any(axis=2), np.maximum(given, SLOWEST * np.abs(given).max()), 0.0)
        return _placed(rows, self._dimension), most.ravel(), rate.ravel()


class NormalError:
    """One contact's normal turned about one of its axes [rad]."""

    def __init__(self, grips: Grips, num_contacts: int, dimension: int, cap: float) -> None:
        """For phases of so many contacts, whose grips follow one another."""
        self.cap = cap
        self._grips, self._k, self._dimension = grips, num_contacts, dimension
        self._turns = int(grips.axes.shape[1])
        self.count = num_contacts * self._turns

    def contact(self, which: int) -> int:
        """The contact that an error is about."""
        return which // self._turns

    def axis(self, phase: int, which: int) -> Vector:
        """The axis that it turns the normal about, shape (3,)."""
        contact, turn = divmod(which, self._turns)
        return np.asarray(self._grips.axes[phase * self._k + contact, turn])

    def own(self, which: int, R: int) -> slice:  # noqa: D102
        contact = self.contact(which)
        return slice(contact * R, (contact + 1) * R)

    def reach(self, phase: int, which: int, x: Vector, start: Vector) -> Vector:  # noqa: D102
        contact, axis = self.contact(which), self.axis(phase, which)
        rows, most = (part[phase * self._k + contact] for part in self._grips.rows())
        if not axis.any():
            return np.full(len(x), self.cap)
        f = _forces(x, self._k, self._dimension)[:, contact]
        along = (f @ axis)[:, None] * (rows @ axis)
        # A row turned by e is at A cos e + B sin e, to be at most C; between two angles it is more.
        A, B, C = f @ rows.T - along, f @ np.cross(axis, rows).T, most - along
        size, begin = np.hypot(A, B), start[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            width = np.arccos(np.clip(C / size, -1.0, 1.0))
        until = begin + np.mod(np.arctan2(B, A) - width - begin, 2.0 * np.pi)
        level = A * np.cos(begin) + B * np.sin(begin) - C
        rising = B * np.cos(begin) - A * np.sin(begin) >= 0.0
        until = np.where((level > LEVEL) | ((level > -LEVEL) & rising), begin, until)
        until = np.where(size <= C, self.cap, until)
        return np.asarray(np.clip(until.min(axis=1), start, self.cap))

    def program(self, phase: int, which: int, error: float, x: Vector) -> tuple[Vector, Vector, Vector]:  # noqa: D102
        contact, axis = self.contact(which), self.axis(phase, which)
        rows, most = self._grips[phase * self._k : (phase + 1) * self._k].rows()
        own, cos, sin = rows[contact], np.cos(error), np.sin(error)
        rows[contact] = own * cos + np.cross(axis, own) * sin + np.outer(own @ axis, axis) * (1.0 - cos)
        faster = np.cross(axis, rows[contact]) @ _forces(x[None], self._k, self._dimension)[0, contact]
        rate = np.zeros(most.shape)
        rate[contact] = np.where(own.any(axis=1), np.maximum(faster, SLOWEST * np.abs(faster).max()), 0.0)
        return _placed(rows, self._dimension), most.ravel(), rate.ravel()


def _forces(x: Vector, num_contacts: int, dimension: int) -> Vector:
    """The contact forces among the unknowns, (K, n), in W, shape (K, k, 3)."""
    f = np.zeros((len(x), num_contacts, 3))
    f[:, :, :dimension] = x[:, : num_contacts * dimension].reshape(len(x), num_contacts, dimension)
    return f


def _placed(rows: Vector, dimension: int) -> Vector:
    """Rows of k contacts, (k, R, 3), each at the places of its own force, shape (k R, k dimension)."""
    k, R, _ = rows.shape
    result = np.zeros((k, R, k, dimension))
    for i in range(k):
        result[i, :, i] = rows[i, :, :dimension]
    return result.reshape(k * R, k * dimension)


class ErrorMargin:
    """The greatest error of each phase that all of its instants survive, whichever of the errors it is."""

    def __init__(self, instants: Instants, error: Error, rows: int) -> None:
        """Prepares; each contact has so many rows."""
        self.instants, self.error, self._rows = instants, error, rows
        self._room = instants.room(instants.center)
        self.survived = np.zeros((len(instants), error.count))
        self._settled = np.broadcast_to(~instants.sound[:, None], self.survived.shape).copy()
        for p, (start, stop) in enumerate(zip(instants.starts[:-1], instants.starts[1:], strict=True)):
            for w in range(error.count):
                zero = np.zeros(stop - start)
                self.survived[start:stop, w] = error.reach(p, w, instants.center[start:stop], zero)
        self.survived[~instants.sound] = 0.0
        self._x: dict[tuple[int, int], Vector] = {}

    def solve(self) -> Worst:
        """The margins."""
        starts = self.instants.starts
        P = len(starts) - 1
        value, best = np.zeros(P), np.full(P, np.inf)
        worst, which = starts[:-1].copy(), np.zeros(P, dtype=int)
        most = (1.0 - GAP) * self.error.cap
        first: dict[int, tuple[int, int]] = {}  # the error that each phase settles before it looks at others
        unfinished: Sequence[int] = range(P)
        while unfinished:
            wanted: list[tuple[int, int, int]] = []
            for p in unfinished:
                own = self.survived[starts[p] : starts[p + 1]]
                low, w = divmod(int(np.argmin(own)), own.shape[1])
                value[p], k = own[low, w], int(starts[p] + low)
                if self._settled[k, w] and value[p] < best[p]:
                    best[p], worst[p], which[p] = value[p], k, w
                if value[p] < min(most, (1.0 - GAP) * best[p]):
                    k, w = first.setdefault(p, (k, w))
                    wanted.append((p, k, w))
            if wanted:
                self._refine(wanted, np.where(np.isfinite(best), (1.0 - 0.5 * GAP) * best, 0.0))
            for p, k, w in wanted:
                if self._settled[k, w] and self.survived[k, w] < best[p]:
                    best[p], worst[p], which[p] = self.survived[k, w], k, w
                if self._settled[k, w] or self.survived[k, w] >= min(most, (1.0 - GAP) * best[p]):
                    del first[p]
            unfinished = [p for p, _, _ in wanted]
        return Worst(value, worst, which)

    def _refine(self, wanted: list[tuple[int, int, int]], target: Vector) -> None:
        """One step for errors (phase, instant, which); the forces are tried at the other instants of the phases."""
        at = self.instants[np.array([k for _, k, _ in wanted])]
        n = at.E.shape[2]
        rows, right = at.G.copy(), at.g.copy()
        rates = np.zeros((*right.shape, 1))
        for i, (p, k, w) in enumerate(wanted):
            leap = target[p] > 0.0 and (k, w) not in self._x
            goal = max(target[p], self.survived[k, w]) if leap else self.survived[k, w]
            changed, limit, rate = self.error.program(p, w, goal, self._x.get((k, w), self.instants.center[k]))
            rows[i, : len(limit), : changed.shape[1]], right[i, : len(limit)] = changed, limit
            rates[i, : len(limit), 0] = rate
            if leap:  # room in the other rows too, so that the forces serve other instants
                rates[i, :, 0] += ASIDE * rate.max() * self.instants.weight * (rates[i, :, 0] == 0.0)
        most = np.zeros((len(wanted), 1, n + 1))
        most[:, 0, n] = 1.0
        rows = np.concatenate([np.concatenate([rows, rates], axis=2), most], axis=1)
        right = np.concatenate([right, np.full((len(wanted), 1), 1e3)], axis=1)
        cost = -most[:, 0]
        E = np.pad(at.E, ((0, 0), (0, 0), (0, 1)))
        found = solve_each(cost, E, at.balanceable, rows, right, nudge=NUDGE).x
        for (p, k, w), x in zip(wanted, found[:, :n], strict=True):
            before, again = self.survived[k, w], (k, w) in self._x
            if np.isfinite(x).all():
                self._x[k, w] = x
                self._try(p, w, x)
            # A step that leaps, or takes its rates from forces that survive less, need not gain much where more do.
            own = again or not np.isfinite(x).all()
            self._settled[k, w] = own and self.survived[k, w] <= (1.0 + SETTLED) * before + 1e-9

    def _try(self, p: int, w: int, x: Vector) -> None:
        """Follows the way from the center to forces x, at the instants of a phase, as far as the limits go."""
        span = slice(self.instants.starts[p], self.instants.starts[p + 1])
        near, center = self.instants[span], self.instants.center[span]
        step = near.balanced(np.broadcast_to(x, center.shape)) - center
        room = self._room[span].copy()
        room[:, self.error.own(w, self._rows)] = np.inf
        far = np.minimum(near.stepped(room, (near.G @ step[:, :, None])[:, :, 0]), 1.0)
        reach = self.error.reach(p, w, center + far[:, None] * step, self.survived[span, w])
        self.survived[span, w] = np.where(self.instants.sound[span], reach, 0.0)
