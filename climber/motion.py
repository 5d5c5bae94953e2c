"""Motions: the continuous climb through a sequence of moves, phase by phase.

For every move there are postures to let go in and postures to take hold in (`transitions`); one of each is chosen for
the whole climb (`choose`), and all are drawn together (`programs.posture_chain`). Between them run paths on the
manifold of the limbs that hold (`path`), shortened each by itself (`programs.trajectory`) and then move by move with
the postures they meet in (`programs.whole_move`), and timed so that contact forces inside the friction cones and
torques inside the limits produce them. The robot shifts with all limbs in contact, then swings one, and so on; it
stands still whenever contacts change and where it visits a region.
"""

from __future__ import annotations

import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from shapely.geometry.base import BaseGeometry

from climber.choose import Candidates, Layer
from climber.objective import Objective
from climber.path import clear, direct, unwound
from climber.phase_motion import MotionBudget
from climber.phases import Curves, PhasePlanner, Purpose, Stretch, Way, instants
from climber.pieces import Choice, in_component
from climber.plan_parts import ObjectiveKind
from climber.stance import Contact, Move, Vector
from climber.transition import Postures
from climber.transitions import MoveFailure, TransitionFinder

WEAK_SHARE = 0.3  # of the attempts that the budget allows for a phase, where motors are weak: each takes a second
LOOKS = 60  # ways through the candidates that are looked at for straight lines, at a few hundredths of a second each

Regions = Mapping[int, Sequence[BaseGeometry | None]]


@dataclass(frozen=True)
class DeadEnd:
    """A phase that nothing tried got through, from where the robot can be as it begins.

    Attributes:
        failure: What the last attempt came to; its index is the number of moves complete by then.
        purpose: What the phase was for.
        contacts: Every limb's contact as it begins.
        reached: Postures the robot can be in as it begins, shape (M, nq).
        whole: Whether these are all the postures known there, however the robot came.
    """

    failure: MoveFailure
    purpose: Purpose
    contacts: tuple[Contact, ...]
    reached: Vector
    whole: bool


@dataclass(frozen=True)
class EmptyPiece:
    """A piece of a stance's feasible set that holds no posture of the kind needed.

    Attributes:
        index: How many moves are complete at that stance.
        missing: "swing" for a posture to arrive in, "let go", "region", or "start" for one to start the climb in.
    """

    index: int
    missing: Purpose | Literal["start"]


class MotionPlanner:
    """Plans motions for one robot on one wall.

    Attributes:
        transitions: Where limbs can let go and take hold.
        budget: What may be spent.
        objective: What is to be little along the climb.
        phases: Plans single phases.
    """

    def __init__(
        self, transitions: TransitionFinder, budget: MotionBudget | None = None, objective: ObjectiveKind = "length"
    ) -> None:
        self.transitions, self.body, self.rng = transitions, transitions.body, transitions.rng
        self.objective = Objective.of(objective, self.body)
        self.phases = PhasePlanner(self.body, self.objective)
        self.budget = budget or MotionBudget()
        self._seconds = 0.0

    @property
    def seconds(self) -> dict[str, float]:
        """Time spent in each stage so far [s]."""
        return {"motion": self._seconds - self.phases.timing, "torque": self.phases.timing}

    def plan(
        self,
        start: Postures,
        moves: Sequence[Move],
        regions: Regions,
        pieces: Mapping[int, Choice] | None = None,
        free_start: bool = False,
    ) -> Way | MoveFailure | DeadEnd | EmptyPiece:
        """Plans the whole climb: shift, swing, shift, ..., and a last shift.

        Args:
            start: Postures the climb may start in.
            moves: The moves, all of whose transitions exist (`TransitionFinder.survey`).
            regions: Where in the wall plane the pelvis's origin must come to rest, one after the other, by how many
                moves are complete; None for anywhere. The last entry after the last move is the goal.
            pieces: By how many moves are complete, the piece of the stance's feasible set that the robot must be in.
            free_start: Whether any other posture on the same contacts will do for a start.
        """
        layers = self._layers(start, moves, regions, pieces or {})
        if not isinstance(layers, tuple):
            return layers
        candidates, phases = layers
        began = clock.perf_counter()
        try:
            return self._through(candidates, phases, free_start)
        finally:
            self._seconds += clock.perf_counter() - began

    def _through(self, candidates: Candidates, phases: list[Stretch], free_start: bool) -> Way | DeadEnd:
        """Motions through the layers, by the cheapest way for which all of them work out."""
        chosen = self._straightest(candidates, phases)
        chosen = self._together(candidates, phases, chosen, free_start)
        if self.body.robot.weak:  # what was drawn together may ask too much of the motors in between
            chosen = self._straightest(candidates, phases)
        known: dict[tuple[int, int, int], Curves] = {}
        tried = [0] * len(phases)
        attempts = self.budget.attempts
        if self.body.robot.weak:
            attempts = max(1, round(WEAK_SHARE * attempts))
        while True:
            outcome = self._by(candidates, phases, chosen, known, free_start)
            if isinstance(outcome, Way):
                return outcome
            i, failure = outcome
            tried[i] += 1
            self._bar(candidates, phases[i], (i, chosen[i], chosen[i + 1]))
            if tried[i] >= attempts:
                candidates.bar_phase(i)
            again = candidates.best()
            if again is None:
                dead, reached = candidates.dead_end()
                layer, phase = candidates.layers[dead], phases[dead]
                whole = len(reached) == len(layer.q)
                last = replace(failure, index=phase.move)
                return DeadEnd(last, phase.purpose, layer.contacts, layer.q[reached], whole)
            chosen = again

    def _straightest(self, candidates: Candidates, phases: list[Stretch]) -> list[int]:
        """The cheapest way; where motors are weak the cheapest among those looked at that straight lines will do for.

        Between postures that weak motors can hold there are many that they cannot, and to find a way around these takes
        a hundred times as long as to try other postures.
        """
        chosen = candidates.best()
        assert chosen is not None
        if not self.body.robot.weak:
            return chosen
        known: set[tuple[int, int, int]] = set()
        for _ in range(LOOKS):
            postures = self._along(candidates, chosen)
            fresh = {(i, chosen[i], chosen[i + 1]) for i in range(len(phases))} - known
            if not fresh:
                break
            known |= fresh
            candidates.doubted |= {
                (i, a, b) for i, a, b in fresh if not direct(phases[i].manifold, postures[i], postures[i + 1])
            }
            again = candidates.best()
            assert again is not None
            chosen = again
        return chosen

    def _by(
        self,
        candidates: Candidates,
        phases: list[Stretch],
        chosen: list[int],
        known: dict[tuple[int, int, int], Curves],
        free_start: bool,
    ) -> Way | tuple[int, MoveFailure]:
        """The way by the chosen postures, or the first phase that did not work out and why."""
        curves = self._curves(candidates, phases, chosen, known)
        if isinstance(curves, tuple):
            return curves
        if candidates.barred:  # some of the postures have taken the place of others, and have not been drawn together
            other = self._together(candidates, phases, chosen, free_start)
            better = self._curves(candidates, phases, other, known) if other != chosen else curves
            curves = curves if isinstance(better, tuple) else better
        # Should a phase have no timing on curves that were shortened together, it may on its own. Together they are no
        # longer than alone, but what is shorter need not be faster, nor have a greater margin.
        best, least, failure = None, np.inf, None
        for legs in (self.phases.joined(phases, curves), tuple(curves)):
            motions = self.phases.all_timed(phases, legs, self.budget)
            if not isinstance(motions, list):
                failure = motions
                continue
            value = self.objective.value(self.body, motions)
            if best is None or value < least:
                best, least = Way.of(phases, legs, motions, free_start), value
            if self.objective.kind == "length":
                break
        if best is not None:
            return best
        assert failure is not None
        return failure

    def _curves(
        self,
        candidates: Candidates,
        phases: list[Stretch],
        chosen: list[int],
        known: dict[tuple[int, int, int], Curves],
    ) -> list[Curves] | tuple[int, MoveFailure]:
        """The curves of each phase between the chosen postures, or the first that has none and why."""
        postures, curves = self._along(candidates, chosen), []
        for i, phase in enumerate(phases):
            key = (i, chosen[i], chosen[i + 1])
            if key not in known:
                found = self.phases.curves(phase, postures[i], postures[i + 1], self.budget, self.rng)
                if isinstance(found, MoveFailure):
                    return i, found
                known[key] = found
            curves.append(known[key])
        return curves

    def _layers(
        self, start: Postures, moves: Sequence[Move], regions: Regions, pieces: Mapping[int, Choice]
    ) -> tuple[Candidates, list[Stretch]] | MoveFailure | EmptyPiece:
        """Layers of candidate postures, and the phases between them."""
        finder = self.transitions
        every = tuple(range(len(self.body.robot.limbs)))
        contacts = start.contacts
        layers = [Layer(contacts, start.q, start.branches, every)]
        phases: list[Stretch] = []
        for i in range(len(moves) + 1):
            shift = finder.manifold(contacts)
            assert shift is not None  # transitions on it were found
            for region in regions.get(i, ()):
                resting = finder.standing(contacts, region)
                if resting.failure is not None:
                    return MoveFailure(i, "transition", resting.failure)
                phases.append(Stretch(shift, None, i, "region", region))
                layers.append(Layer(contacts, resting.q, resting.branches, every))
            if i == len(moves):
                break
            move = moves[i]
            support = tuple(c for c in contacts if c.limb != move.limb)
            leaving, arriving = finder.transition(contacts, move.limb), finder.arrival(support, move.limb, move.hold)
            if leaving.failure is not None:
                return MoveFailure(i, "transition", leaving.failure, "leave")
            if arriving.failure is not None:
                return MoveFailure(i, "transition", arriving.failure, "arrive")
            swing = finder.manifold(support)
            assert swing is not None
            phases += [Stretch(shift, None, i, "let go"), Stretch(swing, move.limb, i, "swing")]
            layers.append(Layer(contacts, leaving.q, leaving.branches, every))
            holding = tuple(c.limb for c in support)
            layers.append(Layer(arriving.contacts, arriving.q, arriving.branches, holding))
            contacts = arriving.contacts
        failure = self._keep(layers, phases, pieces)
        if failure:
            return failure
        for layer, instant in zip(layers, instants(phases, [layer.q for layer in layers]), strict=True):
            layer.cost = self.objective.standing(instant.manifold, layer.q)
        return Candidates(layers, self.body.robot.angle_q, self.objective), phases

    def _keep(self, layers: list[Layer], phases: list[Stretch], pieces: Mapping[int, Choice]) -> EmptyPiece | None:
        """Leaves only candidates in the pieces asked for; what is missing if none is left."""
        shifts = {phase.move: phase.manifold for phase in phases if phase.limb is None}
        after = [0, *(phase.move + (phase.limb is not None) for phase in phases)]
        for number, (layer, moves) in enumerate(zip(layers, after, strict=True)):
            if moves not in pieces:
                continue
            kept = in_component(shifts[moves], pieces[moves], layer.q, self.rng)
            if not len(kept):
                return EmptyPiece(moves, phases[number - 1].purpose if number else "start")
            layer.q, layer.branches = layer.q[kept], layer.branches[kept]
        return None

    def _bar(self, candidates: Candidates, phase: Stretch, key: tuple[int, int, int]) -> None:
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

    def _together(self, candidates: Candidates, phases: list[Stretch], chosen: list[int], free: bool) -> list[int]:
        """Draws the chosen postures together; those that moved join their layers' candidates."""
        given = instants(phases, self._along(candidates, chosen), first=free)
        drawn = self.phases.drawn_together(given, phases)
        result = []
        for layer, old, q, instant in zip(candidates.layers, chosen, drawn, given, strict=True):
            if np.array_equal(q, instant.q):
                result.append(old)
                continue
            result.append(len(layer.q))
            layer.q = np.concatenate([layer.q, q[None]])
            layer.branches = np.concatenate([layer.branches, layer.branches[old][None]])
            assert layer.cost is not None
            layer.cost = np.append(layer.cost, self.objective.standing(instant.manifold, q[None]))
        return result

    def _along(self, candidates: Candidates, chosen: list[int]) -> list[Vector]:
        """The chosen postures, the pelvis's angle continuous."""
        result = [candidates.layers[0].q[chosen[0]]]
        for layer, j in zip(candidates.layers[1:], chosen[1:], strict=True):
            result.append(unwound(layer.q[j], result[-1], candidates.angle))
        return result
