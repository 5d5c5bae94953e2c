"""Everything a climb needs to know about postures at its instants, looked for once and remembered."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from climber.demands import can_stand
from climber.manifold import Body, Manifold, Margins
from climber.scenario import Budget
from climber.solids import Solid
from climber.stance import Contact, Move, Vector
from climber.transition import (
    Failure,
    Postures,
    find_supports,
    find_transition,
    first_carried,
    posture_sampler,
    support_of,
)

IN_SPACE = 0.2  # share of the poses allowed that are drawn in space
BRIEFLY = (500,)  # pelvis poses drawn for places on a patch in space beside its middle

Stage = Literal["transition", "motion", "torque"]


@dataclass(frozen=True)
class Effort:
    """How hard postures are looked for.

    Attributes:
        samples: Pelvis poses drawn at most while looking for a posture.
        postures: Candidate postures kept for each instant.
        patience: How many times as many poses are drawn where that takes a second for a million.
    """

    samples: int = 20_000
    postures: int = 24
    patience: int = 1

    @classmethod
    def of(cls, budget: Budget, multiple: int = 1) -> Effort:
        """What a scenario allows, so many times over.

        Of the poses that take next to no time, those drawn at last are as many as the cube of that: the climb of a wall
        may hang on a posture that one pose in a hundred thousand leads to.
        """
        return cls(multiple * budget.posture_samples, multiple * budget.postures, multiple**2)

    @property
    def rounds(self) -> tuple[int, ...]:
        """Pelvis poses drawn in successive rounds: a few settle most cases."""
        return (*(n for n in (500, 4_000) if n < self.samples), self.samples)

    @property
    def patient_rounds(self) -> tuple[int, ...]:
        """The same with patience: as many poses as that in each of several rounds more."""
        return (*self.rounds, *(self.samples for _ in range(self.patience - 1)))


@dataclass(frozen=True)
class MoveFailure:
    """A move that could not be carried out, and which stage found out.

    Attributes:
        index: Which move of the sequence; its length if a last shift to the goal failed.
        stage: The stage.
        failure: Proved or out of budget, and why.
        end: Which end of the move has no posture ("leave", "arrive"), None if the way between them is the trouble.
    """

    index: int
    stage: Stage
    failure: Failure
    end: Literal["leave", "arrive"] | None = None


class TransitionFinder:
    """Transition postures of one robot on one wall, found when first asked for.

    Attributes:
        body: The robot on its wall.
        rng: Source of random numbers.
        effort: How hard to look.
        margins: How far inside the limits.
        seconds: Time spent so far [s].
    """

    def __init__(
        self, body: Body, rng: np.random.Generator, effort: Effort | None = None, margins: Margins | None = None
    ) -> None:
        self.body, self.rng, self.effort, self.margins = body, rng, effort or Effort(), margins or Margins()
        self.seconds = 0.0
        self._found: dict[tuple[tuple[Contact, ...], int], Postures] = {}

    def try_harder(self, effort: Effort) -> None:
        """Looks with more effort from now on, also for what was given up on."""
        self.effort = effort
        self._found = {
            key: found for key, found in self._found.items() if found.failure is None or found.failure.kind == "proved"
        }

    @property
    def rounds(self) -> tuple[int, ...]:
        """Pelvis poses drawn in successive rounds: in space a share of what the effort says.

        There a pose costs several times as much, and between postures that rare there are hardly any motions.
        """
        if self.body.robot.planar:
            return self.effort.rounds
        return replace(self.effort, samples=max(BRIEFLY[0], int(IN_SPACE * self.effort.samples))).rounds

    @property
    def _patient(self) -> tuple[int, ...]:
        """The rounds for what there may be few postures of."""
        quick = self.body.robot.planar and not self.body.without_inverse(range(len(self.body.robot.limbs)))
        return self.effort.patient_rounds if quick else self.rounds

    def transition(self, contacts: tuple[Contact, ...], limb: int, rounds: Sequence[int] | None = None) -> Postures:
        """Postures on `contacts` in which `limb` may let go or has just taken hold; found once.

        Args:
            contacts: The contacts of all limbs.
            limb: The limb.
            rounds: Pelvis poses drawn in each round; as many as the effort says by default.
        """
        key = (contacts, limb)
        if key not in self._found:
            began = clock.perf_counter()
            drawn = self._patient if rounds is None else rounds
            holding = [c for c in contacts if c.limb != limb]

            def carried(q: Vector) -> NDArray[np.bool_]:
                good = self._carried(q, holding)
                good[good] = self._carried(q[good], contacts)
                return good

            self._found[key] = find_transition(
                self.body, contacts, limb, self.rng, self.margins, drawn, self.effort.postures, carried
            )
            self.seconds += clock.perf_counter() - began
        return self._found[key]

    def _carried(self, q: Vector, contacts: Sequence[Contact]) -> NDArray[np.bool_]:
        """Which configurations, shape (M, nq), the contacts can carry with the torques there are."""
        return can_stand(self.body, q, contacts)

    def arrival(self, support: tuple[Contact, ...], limb: int, hold: int) -> Postures:
        """Postures in which `limb` has just taken `hold`: at the patch's centre, or where else on it one exists."""
        centre = Contact(limb, hold)
        found = self.transition(ordered((*support, centre)), limb)
        half_width = self.body.wall.holds[hold].half_width
        if len(found) or half_width == 0.0:
            return found
        if found.failure is not None and found.failure.kind == "proved":  # wherever on the patch
            return found
        first = found
        # In the plane a patch is a segment. In space it is a disk, small beside what a limb reaches: its rim will do.
        planar = self.body.robot.planar
        places = (
            [(s, 0.0) for s in (1.0, -1.0, 0.5, -0.5)] if planar else [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]
        )
        feet = [replace(centre, offset=along * half_width, across=across * half_width) for along, across in places]
        find_supports(self.body, [ordered((*support, moved)) for moved in feet])
        for moved in feet:
            found = self.transition(ordered((*support, moved)), limb, self.rounds if planar else BRIEFLY)
            if len(found):
                return found
        assert first.failure is not None
        return replace(
            first, failure=replace(first.failure, reason=f"{first.failure.reason}, nor elsewhere on the patch")
        )

    def contacts_after(
        self, contacts: tuple[Contact, ...], move: Move
    ) -> tuple[tuple[Contact, ...], list[MoveFailure]]:
        """The contacts after a move, and which of its two ends have no posture."""
        failures = []
        leaving = self.transition(contacts, move.limb)
        if leaving.failure is not None:
            failures.append(MoveFailure(0, "transition", leaving.failure, "leave"))
        support = tuple(c for c in contacts if c.limb != move.limb)
        arriving = self.arrival(support, move.limb, move.hold)
        if arriving.failure is not None:
            failures.append(MoveFailure(0, "transition", arriving.failure, "arrive"))
        return arriving.contacts, failures

    def survey(self, start: tuple[Contact, ...], moves: Sequence[Move]) -> list[MoveFailure]:
        """Every end of every move that has no transition posture, before any motion is planned."""
        failures = []
        self._find_supports(start, moves)
        contacts = start
        for i, move in enumerate(moves):
            contacts, found = self.contacts_after(contacts, move)
            failures += [replace(failure, index=i) for failure in found]
        return failures

    def _find_supports(self, start: tuple[Contact, ...], moves: Sequence[Move]) -> None:
        """Works out the supports all along some moves, if limbs take hold of patches at the middle."""
        sets, contacts = [start], start
        for move in moves:
            support = tuple(c for c in contacts if c.limb != move.limb)
            contacts = ordered((*support, Contact(move.limb, move.hold)))
            sets += [support, contacts]
        find_supports(self.body, sets)

    def manifold(self, contacts: Sequence[Contact]) -> Manifold | None:
        """The manifold of some contacts, None if these cannot hold the robot."""
        support = support_of(self.body, contacts)
        return None if support is None else Manifold(self.body, contacts, support, self.margins)

    def standing(self, contacts: tuple[Contact, ...], region: BaseGeometry | Solid | None = None) -> Postures:
        """Postures at rest on all contacts, with the pelvis's origin in a region if one is given."""
        empty = Postures(contacts, np.zeros((0, 0)), np.zeros((0, 0), dtype=np.int64), np.zeros(0))
        manifold = self.manifold(contacts)
        if manifold is None:
            return replace(empty, failure=Failure("proved", "no forces of all limbs balance gravity"))
        sampler = posture_sampler(self.body, manifold)
        if sampler.unreachable():
            return replace(empty, failure=Failure("proved", "at no angle of the pelvis do all limbs reach their holds"))
        for count in self.rounds:
            q, branches, slack, _ = sampler.draw(self.rng, count)
            if region is not None and len(q):
                inside = _within(region, q[:, self.body.robot.origin_q])
                q, branches, slack = q[inside], branches[inside], slack[inside]
            best = first_carried(np.argsort(-slack), q, self.effort.postures, lambda q: self._carried(q, contacts))
            if len(best):
                return Postures(contacts, q[best], branches[best], slack[best])
        where = "" if region is None else " with the pelvis in the region"
        reason = f"no posture{where} among {sum(self.rounds)} pelvis poses{self.body.asked}"
        return replace(empty, failure=Failure("budget", reason))


def _within(region: BaseGeometry | Solid, points: Vector) -> NDArray[np.bool_]:
    """Which points [m], shape (K, 2) or (K, 3), lie in a region."""
    if isinstance(region, BaseGeometry):
        return np.asarray(shapely.contains_xy(region, *points[:, :2].T))
    return np.asarray(region.distance(points) <= 0.0)


def ordered(contacts: Sequence[Contact] | set[Contact]) -> tuple[Contact, ...]:
    """Contacts in limb order."""
    return tuple(sorted(contacts, key=lambda contact: contact.limb))
