"""Transition postures: where a limb may let go, and where it has just taken hold (Bretl's FIND-TRANSITION).

Both are the same thing. On a stance, with one of its limbs about to leave or just arrived, the robot keeps all contacts
while the others alone can already hold it. A move is possible only if such a posture exists at its start stance and at
its end stance; the disks of the stance graph only say that it might. What is found here is shared by all moves that
leave the stance with that limb and all that arrive with it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from climber.balance import Region
from climber.kinematics import Pose
from climber.manifold import Body, Manifold, Margins
from climber.newton_sampler import NewtonSampler
from climber.planar_bases import ROUNDING, PlanarBases
from climber.programs.regions import contact_regions
from climber.programs.support import contact_intervals
from climber.space_bases import SpaceBases
from climber.stance import Contact, Posture, Vector

Kind = Literal["proved", "budget"]
Branches = NDArray[np.int64]
ENCLOSED = 0.004  # [m] how closely polygons in space need be enclosed; a tenth of it takes three times the edges


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


def support_of(body: Body, contacts: Sequence[Contact]) -> Region | None:
    """Where the centre of mass may be for the contacts to hold the robot, or None if they cannot."""
    if body.robot.planar:
        lower, upper = contact_intervals(body.wall, [list(contacts)], body.robot.mass)[0]
        return None if np.isnan(lower) else Region.interval(float(lower), float(upper))
    key = tuple(contacts)
    find_supports(body, [key])
    return body.supports[key]


def find_supports(body: Body, sets: Iterable[tuple[Contact, ...]]) -> None:
    """Works out for many sets of contacts at once what `support_of` then knows of each.

    In space a hundred polygons found together take little more time than a few found one after the other. In the plane
    nothing need be found beforehand.
    """
    unknown = [] if body.robot.planar else [key for key in dict.fromkeys(sets) if key not in body.supports]
    for count in sorted({len(key) for key in unknown}):
        alike = [key for key in unknown if len(key) == count]
        found = contact_regions(body.wall, alike, body.robot.mass, body.robot.dimension, gap=ENCLOSED)
        for key, empty, A, b in zip(alike, found.empty, found.A, found.b, strict=True):
            body.supports[key] = None if empty else Region(A, b).distinct


class Bases(Protocol):
    """Poses of the pelvis from which limbs may reach their holds."""

    def unreachable(self, spare: float = 0.0) -> bool:
        """Whether it is certain that there are none, even with the holds as far as `spare` [m] from where they are."""

    def draw(self, rng: np.random.Generator, count: int) -> Vector:
        """Draws `count` base positions, or none where there are none; shape (., len(base_q))."""


class PostureSampler:
    """Samples feasible postures on a manifold, vectorised over pelvis poses and branches.

    The joints of limbs in the air are drawn uniformly.

    Attributes:
        body: The robot.
        manifold: The contacts and conditions.
    """

    def __init__(self, body: Body, manifold: Manifold) -> None:
        self.body, self.manifold = body, manifold
        robot, chains = body.robot, body.kinematics.chains
        self._inverse = [inverse for inverse in body.inverse if inverse is not None]
        assert len(self._inverse) == len(body.inverse)  # `posture_sampler` sees to it
        self._holding = np.array(sorted(manifold.points))
        hips = np.array([chains[i].steps[0].origin for i in self._holding])
        swing = np.linalg.norm(hips[:, : robot.dimension], axis=1)
        self._hips, self._lengths = hips, robot.reach[self._holding] - swing
        points = np.array([manifold.points[i] for i in self._holding])
        self._bases: Bases
        if robot.planar:
            self._bases = PlanarBases(hips, self._lengths, points)
        else:
            levels = [self._inverse[i].levels for i in self._holding]
            out = body.wall.facing(np.array([contact.hold for contact in manifold.contacts]))
            self._bases = SpaceBases(hips, self._lengths, np.array(levels), points, out)
        counts = [inverse.branches if i in manifold.points else 1 for i, inverse in enumerate(self._inverse)]
        self._combinations = np.array(list(itertools.product(*(range(count) for count in counts))))

    def unreachable(self, spare: float = 0.0) -> bool:
        """Whether it is certain that no pelvis pose lets all limbs reach their holds.

        Args:
            spare: The feet may each be so far from where the manifold has them [m].
        """
        return self._bases.unreachable(spare)

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Vector, Branches, Vector, int]:
        """Draws `count` pelvis poses and keeps the feasible postures among all their branches.

        Returns:
            Configurations (M, nq), branches (M, num_limbs), slack (M,), and how many pelvis poses had any inverse
            kinematics at all.
        """
        body, robot = self.body, self.body.robot
        base = self._bases.draw(rng, count)
        pelvis = body.kinematics.pelvis(base)
        keep = np.ones(len(base), dtype=bool)
        for i, hip, length in zip(self._holding, self._hips, self._lengths, strict=True):
            gap = (self.manifold.points[i] - pelvis.point(hip))[:, : robot.dimension]
            keep &= np.linalg.norm(gap, axis=1) <= length - self.manifold.margins.reach
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
                np.stack([chain.moment(chain.links(pelvis, branch)) for branch in solved.swapaxes(0, 1)], axis=1)
            )
        places = self._combinations.T
        fit = np.logical_and.reduce([f[:, b] for f, b in zip(fits, places, strict=True)])
        pose, combination = np.nonzero(fit)
        moment = body.kinematics.pelvis_mass * pelvis.point(body.kinematics.pelvis_center)[pose]
        for each, b in zip(moments, places, strict=True):
            moment += each[pose, b[combination]]
        balanced = self.manifold.balanced.room(moment / robot.mass) >= 0.0
        pose, combination = pose[balanced], combination[balanced]
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
    exact = replace(before.margins, balance=0.0)
    return Manifold(before.body, contacts, before.balanced.meet(after.balanced), exact)


def _off_line(points: Vector) -> float:
    """How far the farthest of some points, shape (k, 3), is from the line that is nearest to all of them [m]."""
    centered = points - points.mean(axis=0)
    along = np.linalg.svd(centered)[2][0]
    return float(np.linalg.norm(centered - np.outer(centered @ along, along), axis=1).max())


def spread(branches: Branches, value: Vector, most: int) -> NDArray[np.int64]:
    """Places of at most `most` postures: of each branch combination in turn, the one of most value."""
    kind = np.unique(branches, axis=0, return_inverse=True)[1].reshape(-1)
    order = np.lexsort((-value, kind))
    first = np.flatnonzero(np.diff(kind[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(first, np.diff(np.append(first, len(order))))
    result: NDArray[np.int64] = order[np.lexsort((-value[order], rank))][:most]
    return result


def first_carried(
    order: NDArray[np.int64], q: Vector, most: int, carried: Callable[[Vector], NDArray[np.bool_]] | None
) -> NDArray[np.int64]:
    """The first of some postures, at most `most` of them, that the motors can hold.

    Args:
        order: Places of the postures in `q`, the best first.
        q: Configurations, shape (M, nq).
        most: How many are wanted.
        carried: Which of some configurations the motors can hold; all of them if None.
    """
    if carried is None:
        return order[:most]
    chosen, begin, size = order[:0], 0, max(most, 1)
    while begin < len(order) and len(chosen) < most:
        batch = order[begin : begin + size]
        chosen = np.concatenate([chosen, batch[carried(q[batch])]])
        begin, size = begin + size, 4 * size  # many at once cost less than a few at a time
    return chosen[:most]


def find_transition(
    body: Body,
    contacts: Sequence[Contact],
    limb: int,
    rng: np.random.Generator,
    margins: Margins | None = None,
    rounds: Sequence[int] = (500, 4_000, 20_000),
    most: int = 24,
    carried: Callable[[Vector], NDArray[np.bool_]] | None = None,
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
        carried: Which of some configurations the motors can hold; all of them by default.
    """
    ordered = tuple(sorted(contacts, key=lambda c: c.limb))
    empty = np.zeros((0, body.robot.plant.num_positions())), np.zeros((0, len(ordered)), dtype=int), np.zeros(0)
    holding = support_of(body, [c for c in ordered if c.limb != limb])
    touching = support_of(body, ordered)
    name = body.robot.limbs[limb].name
    # A proof must hold wherever on their patches the feet stand, not only where they do.
    spare = max(body.wall.holds[c.hold].half_width + np.hypot(c.offset, c.across) for c in ordered)
    if holding is None or touching is None:
        who = f"the limbs other than {name}" if holding is None else "all limbs"
        # In space moments about gravity must balance, and these depend on where the feet are.
        sure = body.robot.planar or spare == 0.0
        return Postures(ordered, *empty, Failure("proved" if sure else "budget", f"no forces of {who} balance gravity"))
    off = _off_line(np.array([body.wall.point(c) for c in ordered if c.limb != limb]))
    if not body.robot.planar and off < (margins or Margins()).line:
        reason = f"the feet of the limbs other than {name} stand within {off:.3f} m of a line"
        return Postures(ordered, *empty, Failure("budget", reason))
    both = between(
        Manifold(body, [c for c in ordered if c.limb != limb], holding, margins),
        Manifold(body, ordered, touching, margins),
    )
    if both.support.depth < 0.0:
        gap = -2.0 * holding.meet(touching).depth
        if gap > ROUNDING:
            reason = f"the supports with and without {name} lie {gap:.4f} m apart"
            # On patches the feet might stand elsewhere, where the supports are a little different; and in space they
            # are a little larger than the polygons enclosed in them.
            sure = not spare and (body.robot.planar or gap > 4 * ENCLOSED)
            return Postures(ordered, *empty, Failure("proved" if sure else "budget", reason))
        reason = f"the supports with and without {name} share only {-gap:.4f} m, less than the margins ask"
        return Postures(ordered, *empty, Failure("budget", reason))
    sampler = posture_sampler(body, both)
    if sampler.unreachable():
        reason = "at no angle of the pelvis do all limbs reach their holds"
        return Postures(ordered, *empty, Failure("proved" if sampler.unreachable(spare) else "budget", reason))
    reachable = drawn = too_heavy = 0
    for count in rounds:
        q, branches, slack, with_inverse = sampler.draw(rng, count)
        reachable, drawn = reachable + with_inverse, drawn + count
        chosen = first_carried(spread(branches, slack, len(q)), q, most, carried)
        if len(chosen):
            return Postures(ordered, q[chosen], branches[chosen], slack[chosen])
        too_heavy += len(q)
    if too_heavy:
        reason = f"none of {too_heavy} postures can be held by the motors{body.asked}"
        return Postures(ordered, *empty, Failure("budget", reason))
    what = "with the centre of mass supported and no collision" if reachable else "with every limb on its hold"
    return Postures(ordered, *empty, Failure("budget", f"no posture {what} among {drawn} pelvis poses"))
