"""Transition postures: where a limb may let go, and where it has just taken hold (Bretl's FIND-TRANSITION).

Both are the same thing. On a stance, with one of its limbs about to leave or just arrived, the robot keeps all contacts
while the others alone can already hold it. A move is possible only if such a posture exists at its start stance and at
its end stance; the disks of the stance graph only say that it might. What is found here is shared by all moves that
leave the stance with that limb and all that arrive with it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from climber.kinematics import Pose
from climber.manifold import Body, Manifold, Margins
from climber.newton_sampler import NewtonSampler
from climber.programs.support import contact_intervals
from climber.stance import Contact, Posture, Vector

Kind = Literal["proved", "budget"]
Branches = NDArray[np.int64]
ROUNDING = 1e-9  # [m] nothing is called impossible for less than this


@dataclass(frozen=True)
class Failure:
    """Why something was not found.

    Attributes:
        kind: "proved" if it cannot exist, "budget" if the search ended before one was found.
        reason: In words.
    """

    kind: Kind
    reason: str


@dataclass(frozen=True)
class Postures:
    """Feasible postures on one set of contacts.

    Attributes:
        contacts: The contacts, in limb order.
        q: Configurations, shape (M, nq).
        branches: Branch of each limb, shape (M, num_limbs); that of a limb in the air means nothing.
        slack: By how much each is feasible, see `Manifold.slack`, shape (M,).
        failure: Why there are none, if M is zero.
    """

    contacts: tuple[Contact, ...]
    q: Vector
    branches: Branches
    slack: Vector
    failure: Failure | None = None

    def __len__(self) -> int:
        return len(self.q)

    def posture(self, i: int) -> Posture:
        """The i-th posture."""
        return Posture(self.q[i], self.contacts, tuple(int(b) for b in self.branches[i]))


def support_interval(body: Body, contacts: Sequence[Contact]) -> tuple[float, float] | None:
    """Where the centre of mass's abscissa may be for the contacts to hold the robot [m], or None."""
    lower, upper = contact_intervals(body.wall, [list(contacts)], body.robot.mass)[0]
    return None if np.isnan(lower) else (float(lower), float(upper))


def _enclosing_circles(points: Vector) -> tuple[Vector, Vector]:
    """Centres (K, 2) and radii (K,) of the smallest circles around the points (K, N, 2).

    By Helly's theorem the largest of the circles of all triples is the circle of all.
    """
    num = points.shape[1]
    if num == 1:
        return points[:, 0], np.zeros(len(points))
    best_center, best_radius = np.zeros((len(points), 2)), np.full(len(points), -1.0)

    def offer(center: Vector, radius: Vector, valid: NDArray[np.bool_]) -> None:
        better = valid & (radius > best_radius)
        best_center[better], best_radius[better] = center[better], radius[better]

    for i, j in itertools.combinations(range(num), 2):
        middle = (points[:, i] + points[:, j]) / 2
        offer(middle, np.linalg.norm(points[:, i] - middle, axis=1), np.ones(len(points), dtype=bool))
    for i, j, k in itertools.combinations(range(num), 3):
        a, b, c = points[:, i], points[:, j] - points[:, i], points[:, k] - points[:, i]
        twice = 2 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
        bb, cc = (b**2).sum(axis=1), (c**2).sum(axis=1)
        acute = (
            (bb + cc > ((b - c) ** 2).sum(axis=1)) & ((b * (b - c)).sum(axis=1) > 0) & ((c * (c - b)).sum(axis=1) > 0)
        )
        safe = np.where(np.abs(twice) > 1e-15, twice, 1.0)
        ux, uy = (c[:, 1] * bb - b[:, 1] * cc) / safe, (b[:, 0] * cc - c[:, 0] * bb) / safe
        offer(a + np.column_stack([ux, uy]), np.hypot(ux, uy), acute & (np.abs(twice) > 1e-15))
    return best_center, best_radius


class PostureSampler:
    """Samples feasible postures on a manifold, vectorised over pelvis poses and branches.

    The joints of limbs in the air are drawn uniformly.

    Attributes:
        body: The robot.
        manifold: The contacts and conditions.
    """

    CELLS = 128  # of the pelvis's angle

    def __init__(self, body: Body, manifold: Manifold) -> None:
        self.body, self.manifold = body, manifold
        chains = body.kinematics.chains
        self._hips = np.array([chain.steps[0].origin[:2] for chain in chains])
        self._lengths = np.array([limb.reach for limb in body.robot.limbs] - np.linalg.norm(self._hips, axis=1))
        self._holding = np.array(sorted(manifold.points))
        self._inverse = [inverse for inverse in body.inverse if inverse is not None]
        assert len(self._inverse) == len(body.inverse)  # `posture_sampler` sees to it
        counts = [inverse.branches if i in manifold.points else 1 for i, inverse in enumerate(self._inverse)]
        self._combinations = np.array(list(itertools.product(*(range(count) for count in counts))))

    @cached_property
    def _cells(self) -> tuple[Vector, Vector, Vector, float]:
        """For each cell of the pelvis's angle its middle, and the circle around where the hips would have the pelvis.

        At a fixed angle limb i reaches its hold iff the pelvis lies in a disk; the disks meet iff the smallest circle
        around their centres is no larger than they are. The last value is how large they are [m], with room for the
        angles in a cell, so that a cell whose circle is larger holds no solution at all.
        """
        step = 2 * np.pi / self.CELLS
        angle = -np.pi + step * (np.arange(self.CELLS) + 0.5)
        sin, cos = np.sin(angle)[:, None], np.cos(angle)[:, None]
        hips_in_pelvis, lengths = self._hips[self._holding], self._lengths[self._holding]
        x, y = hips_in_pelvis.T
        hips = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        feet = np.array([self.manifold.points[i][:2] for i in self._holding])
        center, radius = _enclosing_circles(feet - hips)
        length = lengths.max() + np.linalg.norm(hips_in_pelvis, axis=1).max() * step / 2
        return np.asarray(angle, dtype=float), center, radius, float(length)

    @cached_property
    def _angles(self) -> tuple[Vector, Vector, Vector]:
        """Pelvis angles at which the hips could reach, with the centre and radius of where the pelvis may then be.

        Disks of radius L around points whose smallest circle has radius R meet within sqrt(L^2 - R^2) of its centre.
        """
        angle, center, radius, length = self._cells
        possible = radius <= length + ROUNDING
        spread = np.sqrt(np.maximum(length**2 - radius**2, 0.0))
        return angle[possible], center[possible], spread[possible]

    def unreachable(self, spare: float = 0.0) -> bool:
        """Whether it is certain that no pelvis pose lets all limbs reach their holds.

        Args:
            spare: The feet may each be so far from where the manifold has them [m].
        """
        _, _, radius, length = self._cells
        return bool((radius > length + spare + ROUNDING).all())

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Vector, Branches, Vector, int]:
        """Draws `count` pelvis poses and keeps the feasible postures among all their branches.

        Returns:
            Configurations (M, nq), branches (M, num_limbs), slack (M,), and how many pelvis poses had any inverse
            kinematics at all.
        """
        body, robot = self.body, self.body.robot
        nothing = np.zeros((0, robot.plant.num_positions())), np.zeros((0, len(robot.limbs)), dtype=int), np.zeros(0), 0
        angle, center, spread = self._angles
        if not len(angle):
            return nothing
        weights = spread**2 + 1e-6
        cell = rng.choice(len(angle), size=count, p=weights / weights.sum())
        r, phi = spread[cell] * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
        base = np.empty((count, 3))
        base[:, :2] = center[cell] + (r * np.array([np.cos(phi), np.sin(phi)])).T
        base[:, 2] = angle[cell] + (rng.random(count) - 0.5) * 2 * np.pi / self.CELLS
        pelvis = body.kinematics.pelvis(base)
        keep = np.ones(count, dtype=bool)
        for i in self._holding:
            gap = self.manifold.points[i][:2] - pelvis.point(np.append(self._hips[i], 0.0))[:, :2]
            keep &= np.linalg.norm(gap, axis=1) <= self._lengths[i] - self.manifold.margins.reach
        base, pelvis = base[keep], Pose(pelvis.rotation[keep], pelvis.origin[keep])
        angles, fits, moments = [], [], []
        limbs = zip(robot.limbs, self._inverse, body.kinematics.chains, strict=True)
        for i, (limb, inverse, chain) in enumerate(limbs):
            free = inverse.leading if i in self.manifold.points else len(limb.q)
            lower, upper = limb.one_turn
            leading = rng.uniform(lower[:free], upper[:free], (len(base), free))
            if i in self.manifold.points:
                solved, reach = inverse.solve(pelvis, leading, self.manifold.points[i])
            else:
                solved, reach = leading[:, None, :], np.full((len(base), 1), np.inf)
            inside = np.minimum(solved - lower, upper - solved).min(axis=2) >= self.manifold.margins.joint
            fits.append(inside & (reach >= self.manifold.margins.reach))
            angles.append(solved)
            moments.append(
                np.stack([chain.moment(chain.links(pelvis, branch))[:, 0] for branch in solved.swapaxes(0, 1)], axis=1)
            )
        places = self._combinations.T
        fit = np.logical_and.reduce([f[:, b] for f, b in zip(fits, places, strict=True)])
        moment = np.add.reduce([m[:, b] for m, b in zip(moments, places, strict=True)])
        own = body.kinematics.pelvis_mass * pelvis.point(body.kinematics.pelvis_center)[:, :1]
        abscissa = (own + moment) / robot.mass
        left, right = self.manifold.balanced
        pose, combination = np.nonzero(fit & (abscissa >= left) & (abscissa <= right))
        reachable = int(fit.any(axis=1).sum())
        chosen = rng.permutation(len(pose))[:512]
        pose, combination = pose[chosen], combination[chosen]
        q = np.zeros((len(pose), robot.plant.num_positions()))
        q[:, robot.base_q] = base[pose]
        branches = self._combinations[combination]
        for i, limb in enumerate(robot.limbs):
            q[:, limb.q] = angles[i][pose, branches[:, i]]
        slack = self.manifold.slack(q) if len(q) else np.zeros(0)
        good = slack >= 0
        return q[good], branches[good], slack[good], reachable


def posture_sampler(body: Body, manifold: Manifold) -> PostureSampler | NewtonSampler:
    """What draws postures on a manifold: from pelvis poses if every limb has inverse kinematics, else by projection."""
    every = range(len(body.robot.limbs))
    return NewtonSampler(body, manifold) if body.without_inverse(every) else PostureSampler(body, manifold)


def between(before: Manifold, after: Manifold) -> Manifold:
    """The manifold of the instant between two phases: on the contacts of both, balanced for each with its margin."""
    contacts = sorted(set(before.contacts) | set(after.contacts), key=lambda contact: contact.limb)
    lower, upper = (ends for ends in zip(before.balanced, after.balanced, strict=True))
    exact = replace(before.margins, balance=0.0)
    return Manifold(before.body, contacts, (max(lower), min(upper)), exact)


def spread(branches: Branches, value: Vector, most: int) -> NDArray[np.int64]:
    """Places of at most `most` postures: of each branch combination in turn, the one of most value."""
    kind = np.unique(branches, axis=0, return_inverse=True)[1].reshape(-1)
    order = np.lexsort((-value, kind))
    first = np.flatnonzero(np.diff(kind[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(first, np.diff(np.append(first, len(order))))
    result: NDArray[np.int64] = order[np.lexsort((-value[order], rank))][:most]
    return result


def find_transition(
    body: Body,
    contacts: Sequence[Contact],
    limb: int,
    rng: np.random.Generator,
    margins: Margins | None = None,
    rounds: Sequence[int] = (500, 4_000, 20_000),
    most: int = 24,
) -> Postures:
    """Postures on `contacts` in which the limbs other than `limb` can hold the robot on their own.

    Args:
        body: The robot on its wall.
        contacts: One contact for every limb.
        limb: The limb that is about to let go or has just taken hold.
        rng: Source of random numbers.
        margins: How far inside the limits.
        rounds: Pelvis poses drawn in each round; a round is drawn only if those before found nothing.
        most: Postures returned at most, spread over the branch combinations.
    """
    ordered = tuple(sorted(contacts, key=lambda c: c.limb))
    empty = np.zeros((0, body.robot.plant.num_positions())), np.zeros((0, len(ordered)), dtype=int), np.zeros(0)
    holding = support_interval(body, [c for c in ordered if c.limb != limb])
    touching = support_interval(body, ordered)
    name = body.robot.limbs[limb].name
    # A proof must hold wherever on their patches the feet stand, not only where they do.
    spare = max(body.wall.holds[c.hold].half_width + abs(c.offset) for c in ordered)
    if holding is None or touching is None:
        who = f"the limbs other than {name}" if holding is None else "all limbs"
        return Postures(ordered, *empty, Failure("proved", f"no forces of {who} balance gravity"))
    gap = max(holding[0], touching[0]) - min(holding[1], touching[1])
    if gap > ROUNDING:
        reason = f"the support intervals with and without {name} lie {gap:.4f} m apart"
        # On patches the feet might stand elsewhere, where the intervals are a little different.
        return Postures(ordered, *empty, Failure("budget" if spare else "proved", reason))
    both = between(
        Manifold(body, [c for c in ordered if c.limb != limb], holding, margins),
        Manifold(body, ordered, touching, margins),
    )
    if both.support[0] > both.support[1]:
        reason = f"the support intervals with and without {name} share only {-gap:.4f} m, less than the margins ask"
        return Postures(ordered, *empty, Failure("budget", reason))
    sampler = posture_sampler(body, both)
    if sampler.unreachable():
        reason = "at no angle of the pelvis do all limbs reach their holds"
        return Postures(ordered, *empty, Failure("proved" if sampler.unreachable(spare) else "budget", reason))
    reachable = drawn = 0
    for count in rounds:
        q, branches, slack, with_inverse = sampler.draw(rng, count)
        reachable, drawn = reachable + with_inverse, drawn + count
        if len(q):
            chosen = spread(branches, slack, most)
            return Postures(ordered, q[chosen], branches[chosen], slack[chosen])
    what = "with the centre of mass supported and no collision" if reachable else "with every limb on its hold"
    return Postures(ordered, *empty, Failure("budget", f"no posture {what} among {drawn} pelvis poses"))
