"""Motions: the continuous climb through a sequence of moves, phase by phase.

For every move there are postures to let go in and postures to take hold in (`transition`); one of each is chosen for
the whole climb (`choose`) and improved; between them run paths on the manifold of the limbs that hold (`path`),
smoothed and shortened (`programs.trajectory`), timed (`timing`), and slowed until contact forces inside the friction
cones and torques inside the limits produce them (`programs.torque`). The robot shifts with all limbs in contact, then
swings one, and so on; it stands still whenever contacts change.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from climber.choose import Candidates, Layer
from climber.dynamics import evaluate
from climber.manifold import Body, Manifold, Margins
from climber.path import Search, clear, find_path, unwound
from climber.programs.posture import improve_posture
from climber.programs.torque import phase_torques, static_feasible
from climber.programs.trajectory import refine
from climber.stance import Contact, Move, Vector
from climber.timing import PEAK, PacedPath, Samples, joined
from climber.transition import Failure, Postures, between, find_transition, posture_sampler, support_interval

Stage = Literal["transition", "motion", "torque"]


@dataclass(frozen=True)
class MotionBudget:
    """What motion planning may spend on one climb.

    Attributes:
        samples: Pelvis poses drawn at most while looking for a posture.
        postures: Candidate postures kept for each instant.
        attempts: Pairs of postures tried for one phase before its move is given up.
        iterations: Samples that RRT-Connect draws for one pair.
        pace: Share of the joint rate limits that a motion uses when nothing else slows it.
        rate: Samples per second [Hz].
        slowest: A phase is not slowed beyond this duration [s].
    """

    samples: int = 20_000
    postures: int = 24
    attempts: int = 12
    iterations: int = 100
    pace: float = 0.6
    rate: float = 100.0
    slowest: float = 30.0

    @property
    def rounds(self) -> tuple[int, ...]:
        """Pelvis poses drawn in successive rounds: a few settle most cases."""
        return (*(n for n in (500, 4_000) if n < self.samples), self.samples)


@dataclass(frozen=True)
class PhaseMotion:
    """One phase of a climb in motion.

    Attributes:
        limb: The swinging limb, or None for a shift.
        move: How many moves were complete when it began.
        contacts: The contacts that hold.
        samples: The motion.
        force: Force of each holding contact on the robot in W [N], shape (K, len(contacts), 3).
        torque: Joint torques in the order of `Robot.joint_names` [N m], shape (K, num_joints).
        moment: Moment of each holding contact on the robot about z [N m], shape (K, len(contacts)).
    """

    limb: int | None
    move: int
    contacts: tuple[Contact, ...]
    samples: Samples
    force: Vector
    torque: Vector
    moment: Vector


@dataclass(frozen=True)
class MoveFailure:
    """A move that could not be carried out, and which stage found out.

    Attributes:
        index: Which move of the sequence; its length if the final shift to the goal failed.
        stage: The stage.
        failure: Proved or out of budget, and why.
        end: Which end of the move has no posture ("leave", "arrive"), None if the way between them is the trouble.
    """

    index: int
    stage: Stage
    failure: Failure
    end: Literal["leave", "arrive"] | None = None


@dataclass
class _Phase:
    """A phase to be planned: on which contacts, which limb swings, after how many moves."""

    manifold: Manifold
    limb: int | None
    move: int


class MotionPlanner:
    """Plans motions for one robot on one wall, remembering what it found out about transitions.

    Attributes:
        body: The robot on its wall.
        budget: What may be spent.
        times: Seconds spent in each stage so far.
    """

    def __init__(
        self, body: Body, rng: np.random.Generator, budget: MotionBudget | None = None, margins: Margins | None = None
    ) -> None:
        self.body, self.rng = body, rng
        self.budget, self.margins = budget or MotionBudget(), margins or Margins()
        self.times = {"transitions": 0.0, "motion": 0.0, "torque": 0.0}
        self._transitions: dict[tuple[tuple[Contact, ...], int], Postures] = {}

    # --- transitions -------------------------------------------------------------------------------------------------

    def transition(self, contacts: tuple[Contact, ...], limb: int) -> Postures:
        """Postures on `contacts` in which `limb` may let go or has just taken hold; found once."""
        key = (contacts, limb)
        if key not in self._transitions:
            began = clock.perf_counter()
            found = find_transition(
                self.body, contacts, limb, self.rng, self.margins, self.budget.rounds, self.budget.postures
            )
            holding = [c for c in contacts if c.limb != limb]
            self._transitions[key] = self._carried(self._carried(found, holding), contacts)
            self.times["transitions"] += clock.perf_counter() - began
        return self._transitions[key]

    def _carried(self, postures: Postures, contacts: Sequence[Contact]) -> Postures:
        """Those of the postures that the contacts can carry with the torques there are."""
        if not len(postures):
            return postures
        good = static_feasible(self.body.robot, self.body.wall, postures.q, list(contacts))
        if good.all():
            return postures
        failure = None if good.any() else Failure("budget", f"none of {len(good)} postures can be held by the motors")
        return Postures(postures.contacts, postures.q[good], postures.branches[good], postures.slack[good], failure)

    def arrival(self, support: tuple[Contact, ...], limb: int, hold: int) -> Postures:
        """Postures in which `limb` has just taken `hold`: at the patch's centre, or where else on it one exists."""
        centre = Contact(limb, hold)
        found = self.transition(_ordered((*support, centre)), limb)
        half_width = self.body.wall.holds[hold].half_width
        if len(found) or half_width == 0.0:
            return found
        first = found
        for share in (1.0, -1.0, 0.5, -0.5):
            found = self.transition(_ordered((*support, replace(centre, offset=share * half_width))), limb)
            if len(found):
                return found
        # What is impossible with the foot at the centre is only proved so for the centre.
        failure = first.failure
        assert failure is not None
        if failure.kind == "proved" and "forces" not in failure.reason:
            failure = Failure("budget", f"{failure.reason}, nor at four other points of the patch")
        return replace(first, failure=failure)

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
        contacts = start
        for i, move in enumerate(moves):
            contacts, found = self.contacts_after(contacts, move)
            failures += [replace(failure, index=i) for failure in found]
        return failures

    # --- motions -----------------------------------------------------------------------------------------------------

    def manifold(self, contacts: Sequence[Contact]) -> Manifold | None:
        """The manifold of some contacts, None if these cannot hold the robot."""
        support = support_interval(self.body, contacts)
        return None if support is None else Manifold(self.body, contacts, support, self.margins)

    def standing(self, contacts: tuple[Contact, ...], region: BaseGeometry | None = None) -> Postures:
        """Postures at rest on all contacts, with the pelvis's origin in a region of the wall plane if one is given."""
        empty = Postures(contacts, np.zeros((0, 0)), np.zeros((0, 0), dtype=np.int64), np.zeros(0))
        manifold = self.manifold(contacts)
        if manifold is None:
            return replace(empty, failure=Failure("proved", "no forces of all limbs balance gravity"))
        sampler = posture_sampler(self.body, manifold)
        if sampler.unreachable():
            return replace(empty, failure=Failure("proved", "at no angle of the pelvis do all limbs reach their holds"))
        for count in self.budget.rounds:
            q, branches, slack, _ = sampler.draw(self.rng, count)
            if region is not None and len(q):
                inside = shapely.contains_xy(region, *q[:, self.body.robot.base_q[:2]].T)
                q, branches, slack = q[inside], branches[inside], slack[inside]
            if len(q):
                best = np.argsort(-slack)[: self.budget.postures]
                found = self._carried(Postures(contacts, q[best], branches[best], slack[best]), contacts)
                if len(found):
                    return found
        where = "" if region is None else " with the pelvis in the region"
        return replace(
            empty, failure=Failure("budget", f"no posture{where} among {sum(self.budget.rounds)} pelvis poses")
        )

    def plan(
        self,
        start: Postures,
        moves: Sequence[Move],
        region: BaseGeometry | None,
        report: Callable[[int, int], None] = lambda done, total: None,
    ) -> list[PhaseMotion] | MoveFailure:
        """Plans the whole climb: shift, swing, shift, ..., and a last shift into the goal.

        Args:
            start: Postures the climb may start in.
            moves: The moves, all of whose transitions exist (`survey`).
            region: Where the pelvis's origin must come to rest in the wall plane; None for anywhere.
            report: Called with the number of phases done and in all.
        """
        prepared = self._prepare(start, moves, region)
        if isinstance(prepared, MoveFailure):
            return prepared
        candidates, phases = prepared
        began = clock.perf_counter()
        chosen = candidates.best()
        assert chosen is not None
        chosen = self._improve(candidates, phases, chosen)
        done: dict[tuple[int, int, int], PhaseMotion] = {}
        tried = [0] * len(phases)
        while True:
            torque_before = self.times["torque"]
            for i, phase in enumerate(phases):
                key = (i, chosen[i], chosen[i + 1])
                if key not in done:
                    a, b = candidates.layers[i].q[key[1]], candidates.layers[i + 1].q[key[2]]
                    motion = self._phase(phase, a, b)
                    if isinstance(motion, MoveFailure):
                        tried[i] += 1
                        self._bar(candidates, phase, key)
                        break
                    done[key] = motion
                    report(len({k[0] for k in done}), len(phases))
            else:
                self.times["motion"] += clock.perf_counter() - began - (self.times["torque"] - torque_before)
                return self._chained([done[(i, chosen[i], chosen[i + 1])] for i in range(len(phases))])
            again = candidates.best()
            if again is None or tried[i] >= self.budget.attempts:
                self.times["motion"] += clock.perf_counter() - began
                return motion
            chosen = again

    def _prepare(
        self, start: Postures, moves: Sequence[Move], region: BaseGeometry | None
    ) -> tuple[Candidates, list[_Phase]] | MoveFailure:
        """Layers of candidate postures, and the phases between them."""
        every = tuple(range(len(self.body.robot.limbs)))
        contacts = start.contacts
        layers = [Layer(contacts, start.q, start.branches, every)]
        phases = []
        for i, move in enumerate(moves):
            leaving = self.transition(contacts, move.limb)
            support = tuple(c for c in contacts if c.limb != move.limb)
            arriving = self.arrival(support, move.limb, move.hold)
            for found, end in ((leaving, "leave"), (arriving, "arrive")):
                if found.failure is not None:
                    return MoveFailure(i, "transition", found.failure, "leave" if end == "leave" else "arrive")
            shift, swing = self.manifold(contacts), self.manifold(support)
            assert shift is not None and swing is not None  # their transitions were found
            phases += [_Phase(shift, None, i), _Phase(swing, move.limb, i)]
            layers.append(Layer(contacts, leaving.q, leaving.branches, every))
            holding = tuple(c.limb for c in support)
            layers.append(Layer(arriving.contacts, arriving.q, arriving.branches, holding))
            contacts = arriving.contacts
        final, last = self.standing(contacts, region), self.manifold(contacts)
        if final.failure is not None:
            return MoveFailure(len(moves), "transition", final.failure)
        assert last is not None
        phases.append(_Phase(last, None, len(moves)))
        layers.append(Layer(contacts, final.q, final.branches, every))
        return Candidates(layers, int(self.body.robot.base_q[-1])), phases

    def _bar(self, candidates: Candidates, phase: _Phase, key: tuple[int, int, int]) -> None:
        """Bars a phase that did not work out, and with it all between postures that lie in the same pieces.

        What one straight line joins is one piece of the stance's feasible set. To try its other postures would be to
        try the same again.
        """
        i, *ends = key
        pieces = []
        for layer, end in zip(candidates.layers[i : i + 2], ends, strict=True):
            own = layer.q[end]
            chart = phase.manifold.chart(own)
            others = unwound(layer.q, own, candidates.angle)
            alike = (layer.branches == layer.branches[end])[:, list(layer.holding)].all(axis=1)
            at = chart.coordinates(own)
            pieces.append(
                [
                    j
                    for j in range(len(layer.q))
                    if j == end or (alike[j] and clear(phase.manifold, chart, at, chart.coordinates(others[j])))
                ]
            )
        candidates.barred.update((i, a, b) for a in pieces[0] for b in pieces[1])

    def _improve(self, candidates: Candidates, phases: list[_Phase], chosen: list[int]) -> list[int]:
        """Draws the chosen postures towards their neighbours; each better one joins its layer's candidates."""
        angle = candidates.angle
        chosen = list(chosen)
        for _ in range(2):
            for i in range(1, len(chosen) - 1):
                layer = candidates.layers[i]
                own = layer.q[chosen[i]]
                neighbours = [candidates.layers[j].q[chosen[j]] for j in (i - 1, i + 1)]
                targets = [(1.0, unwound(q, own, angle)) for q in neighbours]
                # The posture stands on the contacts of both phases it joins.
                manifold = between(phases[i - 1].manifold, phases[i].manifold)
                better = improve_posture(self.body, manifold, own, targets)
                if better is None:
                    continue
                if not self._held(better, phases[i - 1].manifold) or not self._held(better, phases[i].manifold):
                    continue
                layer.q = np.concatenate([layer.q, better[None]])
                layer.branches = np.concatenate([layer.branches, layer.branches[chosen[i]][None]])
                chosen[i] = len(layer.q) - 1
        return chosen

    def _held(self, q: Vector, manifold: Manifold) -> bool:
        return bool(static_feasible(self.body.robot, self.body.wall, q[None], list(manifold.contacts))[0])

    def _phase(self, phase: _Phase, a: Vector, b: Vector) -> PhaseMotion | MoveFailure:
        """One phase between two postures."""
        manifold = phase.manifold
        legs = find_path(manifold, a, b, self.rng, Search(self.budget.iterations))
        if legs is None:
            reason = f"no path among {self.budget.iterations} samples of RRT-Connect"
            return MoveFailure(phase.move, "motion", Failure("budget", reason))
        paced = []
        for leg in legs:
            curve = refine(manifold, leg.chart, leg.u)
            if curve is None:
                return MoveFailure(
                    phase.move, "motion", Failure("budget", "the path found grazes a limit when looked at closely")
                )
            paced.append(PacedPath(curve))
        began = clock.perf_counter()
        result = self._timed(phase, paced)
        self.times["torque"] += clock.perf_counter() - began
        return result

    def _timed(self, phase: _Phase, paced: list[PacedPath]) -> PhaseMotion | MoveFailure:
        """The phase as fast as the pace allows, or slowed until forces and torques produce it."""
        holding = [c.limb for c in phase.manifold.contacts]
        slowing, why = 1.0, ""
        while True:
            durations = [max(0.1, slowing * PEAK * path.length / self.budget.pace) for path in paced]
            if sum(durations) > self.budget.slowest and slowing > 1.0:
                return MoveFailure(
                    phase.move, "torque", Failure("budget", f"even slowed to {sum(durations):.0f} s: {why}")
                )
            samples = joined(
                [
                    path.samples(d, int(np.ceil(d * self.budget.rate)) + 1)
                    for path, d in zip(paced, durations, strict=True)
                ]
            )
            dynamics = evaluate(self.body.robot, samples.q, samples.v, holding)
            torques = phase_torques(
                self.body.robot, self.body.wall, list(phase.manifold.contacts), dynamics, samples.vd
            )
            if torques.ok.all():
                return PhaseMotion(
                    phase.limb,
                    phase.move,
                    phase.manifold.contacts,
                    samples,
                    torques.force,
                    torques.torque,
                    torques.moment,
                )
            why = torques.reason
            slowing *= 1.4

    def _chained(self, phases: list[PhaseMotion]) -> list[PhaseMotion]:
        """The phases one after the other in time, the pelvis's angle continuous."""
        angle = int(self.body.robot.base_q[-1])
        result: list[PhaseMotion] = []
        for phase in phases:
            samples = phase.samples
            if result:
                before = result[-1].samples
                q = samples.q.copy()
                q[:, angle] += unwound(q[0], before.q[-1], angle)[angle] - q[0, angle]
                samples = replace(samples, time=samples.time + before.time[-1], q=q)
            result.append(replace(phase, samples=samples))
        return result


def _ordered(contacts: Sequence[Contact] | set[Contact]) -> tuple[Contact, ...]:
    return tuple(sorted(contacts, key=lambda contact: contact.limb))
