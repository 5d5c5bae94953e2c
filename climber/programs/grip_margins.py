"""Margins to errors of what the holds can give: friction that is less, and normals that are turned.

Both make cones narrower, all of them (`climber.programs.grips`), so that forces that survive an error survive a smaller
one. For forces x that balance, the greatest error e that they keep to the limits with follows in closed form, row by
row (`FrictionError.reach`). The best forces are found as Dinkelbach does for quotients: given the error e that is
survived so far, forces with the most room in the rows that the error changes,

    max s   subject to   E x = b,   G(e) x + s rate <= g(e),

allow a greater one, and so on; errors between the two are survived with these forces too. As the rows have the rates at
which they change with the error, it converges faster than linearly (Crouzeix and Ferland 1991), and every number on the
way is proved by its forces. Where a phase is known to survive no more than some error elsewhere, e is that error but
for half of `GAP`, so that one program settles it.

Nobody needs to know of a normal that is turned for these forces to be right, and they are right if all of them are,
each its own way. Forces chosen for the one way in which one hold is turned would survive more; but a controller that is
not told cannot choose them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climber.programs.blocks import solve_each
from climber.programs.grips import Grips
from climber.programs.margins import GAP, Worst
from climber.programs.survival import NUDGE, Instants
from climber.stance import Vector

SETTLED = 1e-3  # an error that grows by a smaller share in one step has arrived
ASIDE = 0.2  # share of the rates that rows have which the error does not change
TINY = 1e-9
HOPELESS = 1e9  # times its friction that a hold needs which does not hold
SLOWEST = 1e-2  # share of the fastest rate that others have at least


class FrictionError:
    """Friction less by a share, at all contacts.

    Attributes:
        cap: Greater errors are not looked for.
    """

    def __init__(self, grips: Grips, num_contacts: int, dimension: int, cap: float) -> None:
        """For phases of so many contacts, whose grips follow one another."""
        self.cap = cap
        self._grips, self._k, self._dimension = grips, num_contacts, dimension

    def chi(self, friction: Vector, error: float) -> Vector:
        """What share of its friction each contact has left, shape (k,)."""
        return np.full(len(friction), 1.0 - error)

    def rate(self, friction: Vector, error: float) -> Vector:
        """How fast it goes down with the error, shape (k,)."""
        return np.ones(len(friction))

    def error(self, friction: Vector, chi: Vector) -> Vector:
        """The error at which each contact has a share chi left, shapes (k,) and (K, k)."""
        return np.asarray(1.0 - chi)

    def reach(self, phase: int, x: Vector, start: Vector) -> Vector:
        """The greatest error that forces x, (K, n), survive, (K,); at least `start`."""
        grips, f = self._of(phase), _forces(x, self._k, self._dimension)
        with np.errstate(divide="ignore", invalid="ignore"):
            needed = np.einsum("ird,kid->kir", grips.base, f) - grips.most
            given = grips.more - np.einsum("ird,kid->kir", grips.along, f)
            chi = np.where(given > 1e-12, needed / given, np.where(needed > 0.0, HOPELESS, 0.0))
        rubs = (grips.along != 0.0).any(axis=2)
        most = self.error(grips.friction, np.where(rubs, chi, 0.0).max(axis=2, initial=0.0))
        survived = np.where(rubs.any(axis=1), most, self.cap).min(axis=1, initial=self.cap)
        return np.asarray(np.maximum(np.clip(survived, 0.0, self.cap), start))

    def program(self, phase: int, error: float, x: Vector) -> tuple[Vector, Vector, Vector]:
        """Matrix (k R, n) and right side (k R,) of the contacts' rows, and the rates at which the error changes them.

        Rates are those at forces x, shape (n,), and never quite zero; zero for rows that do not change.
        """
        grips, f = self._of(phase), _forces(x[None], self._k, self._dimension)[0]
        rows, most = grips.rows(self.chi(grips.friction, error))
        given = grips.more - np.einsum("ird,id->ir", grips.along, f)
        given = self.rate(grips.friction, error)[:, None] * given
        rate = np.where((grips.along != 0.0).any(axis=2), np.maximum(given, SLOWEST * np.abs(given).max()), 0.0)
        return _placed(rows, self._dimension), most.ravel(), rate.ravel()

    def _of(self, phase: int) -> Grips:
        return self._grips[phase * self._k : (phase + 1) * self._k]


class NormalError(FrictionError):
    """The normals of all contacts turned by up to an angle [rad], each its own way, and nobody knows how."""

    def chi(self, friction: Vector, error: float) -> Vector:  # noqa: D102
        left = np.tan(np.maximum(np.arctan(friction) - error, 0.0))
        return np.asarray(left / np.maximum(friction, TINY))

    def rate(self, friction: Vector, error: float) -> Vector:  # noqa: D102
        left = np.tan(np.maximum(np.arctan(friction) - error, 0.0))
        return np.asarray((1.0 + left**2) / np.maximum(friction, TINY))

    def error(self, friction: Vector, chi: Vector) -> Vector:  # noqa: D102
        return np.asarray(np.arctan(friction) - np.arctan(chi * friction))


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
    """The greatest error of each phase that all of its instants survive."""

    def __init__(self, instants: Instants, error: FrictionError) -> None:
        """Prepares."""
        self.instants, self.error = instants, error
        self._room = instants.room(instants.center)
        self.survived = np.zeros(len(instants))
        self._settled = ~instants.sound
        for p, (start, stop) in enumerate(zip(instants.starts[:-1], instants.starts[1:], strict=True)):
            self.survived[start:stop] = error.reach(p, instants.center[start:stop], np.zeros(stop - start))
        self.survived[~instants.sound] = 0.0
        self._x: dict[int, Vector] = {}

    def solve(self) -> Worst:
        """The margins; `which` tells nothing."""
        starts = self.instants.starts
        P = len(starts) - 1
        value, best = np.zeros(P), np.full(P, np.inf)
        worst = starts[:-1].copy()
        most = (1.0 - GAP) * self.error.cap
        first: dict[int, int] = {}  # the instant that each phase settles before it looks at others
        unfinished: Sequence[int] = range(P)
        while unfinished:
            wanted: list[tuple[int, int]] = []
            for p in unfinished:
                k = int(starts[p] + np.argmin(self.survived[starts[p] : starts[p + 1]]))
                value[p] = self.survived[k]
                if self._settled[k] and value[p] < best[p]:
                    best[p], worst[p] = value[p], k
                if value[p] < min(most, (1.0 - GAP) * best[p]):
                    wanted.append((p, first.setdefault(p, k)))
            if wanted:
                self._refine(wanted, np.where(np.isfinite(best), (1.0 - 0.5 * GAP) * best, 0.0))
            for p, k in wanted:
                if self._settled[k] and self.survived[k] < best[p]:
                    best[p], worst[p] = self.survived[k], k
                if self._settled[k] or self.survived[k] >= min(most, (1.0 - GAP) * best[p]):
                    del first[p]
            unfinished = [p for p, _ in wanted]
        return Worst(value, worst, np.zeros(P, dtype=int))

    def _refine(self, wanted: list[tuple[int, int]], target: Vector) -> None:
        """One step at instants (phase, instant); the forces are tried at the other instants of the phases."""
        at = self.instants[np.array([k for _, k in wanted])]
        n = at.E.shape[2]
        rows, right = at.G.copy(), at.g.copy()
        rates = np.zeros((*right.shape, 1))
        for i, (p, k) in enumerate(wanted):
            leap = target[p] > 0.0 and k not in self._x
            goal = max(target[p], self.survived[k]) if leap else self.survived[k]
            changed, limit, rate = self.error.program(p, goal, self._x.get(k, self.instants.center[k]))
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
        for (p, k), x in zip(wanted, found[:, :n], strict=True):
            before, again = self.survived[k], k in self._x
            if np.isfinite(x).all():
                self._x[k] = x
                self._try(p, x)
            # A step that leaps, or takes its rates from forces that survive less, need not gain much where more do.
            own = again or not np.isfinite(x).all()
            self._settled[k] = own and self.survived[k] <= (1.0 + SETTLED) * before + 1e-9

    def _try(self, p: int, x: Vector) -> None:
        """Follows the way from the center to forces x, at the instants of a phase, as far as the limits go."""
        span = slice(self.instants.starts[p], self.instants.starts[p + 1])
        near, center = self.instants[span], self.instants.center[span]
        step = near.balanced(np.broadcast_to(x, center.shape)) - center
        far = np.minimum(near.stepped(self._room[span], (near.G @ step[:, :, None])[:, :, 0]), 1.0)
        reach = self.error.reach(p, center + far[:, None] * step, self.survived[span])
        self.survived[span] = np.where(self.instants.sound[span], reach, 0.0)
