"""Phases of a climb one by one and together: their postures, their curves, their timing.

A phase is a stretch of a climb on the same contacts. What is here plans one of them between two postures, draws the
postures of several together, and makes the curves of a whole move shorter along with the posture they meet in.
`climber.motion` searches with it for a climb that works out at all, `climber.improve` for a better one.
"""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from climber.apart import why_apart
from climber.curve import Curve, rounded
from climber.demands import can_stand
from climber.manifold import Body, Manifold
from climber.objective import Objective
from climber.path import Search, find_path
from climber.phase_motion import MotionBudget, PhaseMotion, chained, timed
from climber.programs.posture_chain import Instant, PostureChain
from climber.programs.trajectory import NUM_CONTROL, refine
from climber.programs.whole_move import Meeting, refine_together
from climber.solids import Region
from climber.stance import Vector
from climber.timing import PacedPath
from climber.transition import Failure, between
from climber.transitions import MoveFailure

Purpose = Literal["let go", "region", "swing"]
BACK = (1.0, 0.7, 0.4, 0.2)  # how far a posture goes that cannot be held all the way
STRAIGHT = 3e-3  # share by which a curve may be longer than a straight line and pass for one
SLOWER = (1.0, 1.4, 2.0, 3.0, 5.0)  # how much slower a phase is tried that lacks some of a margin
AT_ONCE = 3  # legs that are refined together: a shift, a swing, and the shift that follows


@dataclass(frozen=True)
class Stretch:
    """A phase to be planned.

    Attributes:
        manifold: The contacts that hold, and what is feasible on them.
        limb: The limb that swings, or None.
        move: How many moves are complete as it begins.
        purpose: What it is for.
        region: Where the pelvis's origin must be as it ends; None for anywhere.
    """

    manifold: Manifold
    limb: int | None
    move: int
    purpose: Purpose
    region: Region | None = None


Curves = tuple[Curve, ...]


@dataclass(frozen=True)
class Way:
    """A climb that works out.

    Attributes:
        stretches: Its phases.
        postures: Where they begin and end, one more.
        curves: The legs of each phase.
        motions: The phases in motion, each from time zero.
        free_start: Whether the first posture may be another.
    """

    stretches: tuple[Stretch, ...]
    postures: tuple[Vector, ...]
    curves: tuple[Curves, ...]
    motions: tuple[PhaseMotion, ...]
    free_start: bool

    @classmethod
    def of(
        cls,
        stretches: Sequence[Stretch],
        curves: Sequence[Curves],
        motions: Sequence[PhaseMotion],
        free_start: bool,
    ) -> Way:
        """The way along curves."""
        ends = [curves[0][0].q(np.zeros(1))[0], *(own[-1].q(np.ones(1))[0] for own in curves)]
        return cls(tuple(stretches), tuple(ends), tuple(curves), tuple(motions), free_start)

    def chained(self) -> list[PhaseMotion]:
        """The phases one after the other in time, shifts on one stance made one."""
        return chained(self.motions, self.stretches[0].manifold.body.robot.angle_q)


def instants(
    stretches: Sequence[Stretch], postures: Sequence[Vector], first: bool = False, last: bool = True
) -> list[Instant]:
    """The postures between phases, with what each must satisfy.

    Args:
        stretches: The phases.
        postures: One more than there are phases.
        first: Whether the first posture may be moved; never if a swing begins there, as its contacts are not all.
        last: Whether the last one may; never if a swing ends there.
    """
    inner = [between(before.manifold, after.manifold) for before, after in pairwise(stretches)]
    manifolds = [stretches[0].manifold, *inner, stretches[-1].manifold]
    regions = [None, *(stretch.region for stretch in stretches)]
    swings = [stretches[end].limb is not None for end in (0, -1)]
    free = [first and not swings[0], *(True for _ in inner), last and not swings[1]]
    return [Instant(*each) for each in zip(postures, manifolds, regions, free, strict=True)]


class PhasePlanner:
    """Plans phases of one robot on one wall.

    Attributes:
        body: The robot.
        objective: What is to be little.
        timing: Seconds spent on timing, forces and torques so far [s].
    """

    def __init__(self, body: Body, objective: Objective) -> None:
        self.body, self.objective = body, objective
        self.timing = 0.0

    def drawn_together(self, instants: Sequence[Instant], stretches: Sequence[Stretch]) -> list[Vector]:
        """Postures that cost no more than those given, each of which motors can hold on the contacts of both sides."""
        chain = PostureChain(instants, self.objective)
        before = [instant.q for instant in instants]
        after = chain.solve()
        for k, instant in enumerate(instants):
            if not np.array_equal(after[k], instant.q):
                sides = stretches[max(k - 1, 0)], stretches[min(k, len(stretches) - 1)]
                after[k] = self._held_on_the_way(instant, after[k], [side.manifold for side in sides])
        return after if chain.cost(after) < chain.cost(before) else before

    def _held_on_the_way(self, instant: Instant, q: Vector, manifolds: Sequence[Manifold]) -> Vector:
        """The posture, or one on the way back to where it came from, that motors can hold on each of the manifolds."""
        chart = instant.manifold.chart(instant.q)
        back, there = chart.coordinates(np.stack([instant.q, q]))
        for part in BACK:
            at, reach = chart.expand((back + part * (there - back))[None])
            fine = reach[0] >= instant.manifold.margins.reach and instant.manifold.slack(at)[0] >= 0
            if fine and self.held(at[0], manifolds):
                return np.asarray(at[0])
        return instant.q

    def _as_good_as_straight(self, legs: Sequence[Curve]) -> bool:
        """Whether legs are hardly longer than straight lines; postures drawn together are best for those already."""
        ends = [leg.q(np.array([0.0, 1.0])) for leg in legs]
        straight = sum(float(self.objective.norm(q[1] - q[0])) for q in ends)
        return self.length(legs) <= (1.0 + STRAIGHT) * straight

    def length(self, legs: Sequence[Curve]) -> float:
        """The length of curves in the objective's norm."""
        s = np.linspace(0.0, 1.0, 65)
        return sum(float(self.objective.norm(np.diff(leg.q(s), axis=0)).sum()) for leg in legs)

    def held(self, q: Vector, manifolds: Sequence[Manifold]) -> bool:
        """Whether contacts and motors can hold a posture still on each of the manifolds."""
        every = {manifold.contacts: None for manifold in manifolds}
        return all(bool(can_stand(self.body, q[None], contacts)[0]) for contacts in every)

    def curves(
        self, stretch: Stretch, a: Vector, b: Vector, budget: MotionBudget, rng: np.random.Generator
    ) -> Curves | MoveFailure:
        """The legs of one phase from posture to posture, short and smooth."""
        manifold = stretch.manifold
        legs = find_path(manifold, a, b, rng, Search(budget.iterations))
        if legs is None:
            # A proof is about these two postures only; others may be joined.
            reason = why_apart(manifold, a, b) or f"no path among {budget.iterations} samples of RRT-Connect"
            return MoveFailure(stretch.move, "motion", Failure("budget", reason))
        curves = [refine(manifold, leg.chart, leg.u) for leg in legs]
        if None in curves:
            reason = "the path found grazes a limit when looked at closely"
            return MoveFailure(stretch.move, "motion", Failure("budget", reason))
        return tuple(curve for curve in curves if curve is not None)

    def timed(self, stretch: Stretch, curves: Curves, budget: MotionBudget) -> PhaseMotion | MoveFailure:
        """One phase in motion."""
        began = clock.perf_counter()
        contacts = stretch.manifold.contacts
        paced, demands = [PacedPath(curve) for curve in curves], self.body.demands
        try:
            for slower in SLOWER if demands is not None and demands.looked_at else (1.0,):
                motion = timed(self.body, contacts, paced, replace(budget, pace=budget.pace / slower))
                if isinstance(motion, str):
                    return MoveFailure(stretch.move, "torque", Failure("budget", motion))
                samples, torques, timing = motion
                forces = torques.force, torques.torque, torques.moment
                result = PhaseMotion(stretch.limb, stretch.move, contacts, samples, *forces, timing)
                if demands is None or not (lacking := demands.lacking(self.body.robot, [result])[0]):
                    return result
                if slower == 1.0 and demands.at_rest(self.body.robot, result):
                    break
            return MoveFailure(stretch.move, "torque", Failure("budget", lacking))
        finally:
            self.timing += clock.perf_counter() - began

    def all_timed(
        self, stretches: Sequence[Stretch], curves: Sequence[Curves], budget: MotionBudget
    ) -> list[PhaseMotion] | tuple[int, MoveFailure]:
        """Phases in motion, or the first that has no timing and why."""
        motions: list[PhaseMotion] = []
        for i, (stretch, own) in enumerate(zip(stretches, curves, strict=True)):
            motion = self.timed(stretch, own, budget)
            if isinstance(motion, MoveFailure):
                return i, motion
            motions.append(motion)
        return motions

    def joined(self, stretches: Sequence[Stretch], curves: Sequence[Curves]) -> tuple[Curves, ...]:
        """The curves of several phases, move by move as short as they are together with the postures between them.

        The first posture and the last stay where they are, and so do those in a region.
        """
        owners = [i for i, own in enumerate(curves) for _ in own]
        legs = [_with_freedom(curve) for own in curves for curve in own]
        for first in range(0, len(legs) - 1, AT_ONCE - 1):
            window = slice(first, first + AT_ONCE)
            of = [stretches[i] for i in owners[window]]
            meetings = [
                Meeting(
                    one.manifold if one is two else between(one.manifold, two.manifold),
                    _touching(*ends) and (one is two or one.region is None),
                )
                for (one, two), ends in zip(pairwise(of), pairwise(legs[window]), strict=True)
            ]
            parts = list(zip((stretch.manifold for stretch in of), legs[window], strict=True))
            if self._as_good_as_straight(legs[window]):
                continue
            better = refine_together(parts, meetings, self.objective.norm)
            ends = [curve.q(np.ones(1))[0] for curve in better[:-1]]
            sides = [(one.manifold, two.manifold) for one, two in pairwise(of)]
            if all(self.held(q, both) for q, both in zip(ends, sides, strict=True)):
                legs[window] = better
        return tuple(
            tuple(leg for owner, leg in zip(owners, legs, strict=True) if owner == i) for i in range(len(curves))
        )


def _touching(one: Curve, two: Curve) -> bool:
    """Whether a curve begins where another ends, with the pelvis not turned by whole turns in between."""
    return bool(np.abs(one.q(np.ones(1)) - two.q(np.zeros(1))).max() < 1e-6)


def _with_freedom(curve: Curve) -> Curve:
    """The curve with enough control points to bend; a straight line has hardly any."""
    if len(curve.control) >= NUM_CONTROL:
        return curve
    return rounded(curve.chart, curve.control[[0, -1]], NUM_CONTROL)
