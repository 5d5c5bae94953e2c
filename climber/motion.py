"""Motions: the continuous climb through a sequence of moves, phase by phase.

For every move there are postures to let go in and postures to take hold in (`transitions`); one of each is chosen for
the whole climb (`choose`) and improved; between them run paths on the manifold of the limbs that hold (`path`),
smoothed and shortened (`programs.trajectory`), timed (`timing`), and slowed until contact forces inside the friction
cones and torques inside the limits produce them (`programs.torque`). The robot shifts with all limbs in contact, then
swings one, and so on; it stands still whenever contacts change and where it visits a region.
"""

from __future__ import annotations

import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from shapely.geometry.base import BaseGeometry

from climber.apart import why_apart
from climber.choose import Candidates, Layer
from climber.manifold import Manifold
from climber.path import Search, clear, find_path, unwound
from climber.phase_motion import MotionBudget, PhaseMotion, chained, timed
from climber.pieces import Choice, in_component
from climber.programs.posture import improve_posture
from climber.programs.torque import static_feasible
from climber.programs.trajectory import refine
from climber.stance import Contact, Move, Vector
from climber.timing import PacedPath
from climber.transition import Failure, Postures, between
from climber.transitions import MoveFailure, TransitionFinder

Purpose = Literal["let go", "region", "swing"]
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


@dataclass
class _Phase:
    """A phase to be planned: on which contacts, which limb swings, after how many moves, and what it is for."""

    manifold: Manifold
    limb: int | None
    move: int
    purpose: Purpose


class MotionPlanner:
    """Plans motions for one robot on one wall.

    Attributes:
        transitions: Where limbs can let go and take hold.
        budget: What may be spent.
        seconds: Time spent in each stage so far [s].
    """

    def __init__(self, transitions: TransitionFinder, budget: MotionBudget | None = None) -> None:
        self.transitions, self.body, self.rng = transitions, transitions.body, transitions.rng
        self.budget = budget or MotionBudget()
        self.seconds = {"motion": 0.0, "torque": 0.0}

    def plan(
        self,
        start: Postures,
        moves: Sequence[Move],
        regions: Regions,
        pieces: Mapping[int, Choice] | None = None,
    ) -> list[PhaseMotion] | MoveFailure | DeadEnd | EmptyPiece:
        """Plans the whole climb: shift, swing, shift, ..., and a last shift.

        Args:
            start: Postures the climb may start in.
            moves: The moves, all of whose transitions exist (`TransitionFinder.survey`).
            regions: Where in the wall plane the pelvis's origin must come to rest, one after the other, by how many
                moves are complete; None for anywhere. The last entry after the last move is the goal.
            pieces: By how many moves are complete, the piece of the stance's feasible set that the robot must be in.
        """
        layers = self._layers(start, moves, regions, pieces or {})
        if not isinstance(layers, tuple):
            return layers
        candidates, phases = layers
        began, torque_before = clock.perf_counter(), self.seconds["torque"]
        try:
            return self._through(candidates, phases)
        finally:
            spent = clock.perf_counter() - began
            self.seconds["motion"] += spent - (self.seconds["torque"] - torque_before)

    def _through(self, candidates: Candidates, phases: list[_Phase]) -> list[PhaseMotion] | DeadEnd:
        """Motions through the layers, by the cheapest way for which all of them work out."""
        chosen = candidates.best()
        assert chosen is not None
        chosen = self._improve(candidates, phases, chosen)
        done: dict[tuple[int, int, int], PhaseMotion] = {}
        tried = [0] * len(phases)
        while True:
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
            else:
                return chained([done[(i, chosen[i], chosen[i + 1])] for i in range(len(phases))], candidates.angle)
            if tried[i] >= self.budget.attempts:
                candidates.bar_phase(i)
            again = candidates.best()
            if again is None:
                dead, reached = candidates.dead_end()
                layer, phase = candidates.layers[dead], phases[dead]
                failure = replace(motion, index=phase.move)
                whole = len(reached) == len(layer.q)
                return DeadEnd(failure, phase.purpose, layer.contacts, layer.q[reached], whole)
            chosen = again

    def _layers(
        self, start: Postures, moves: Sequence[Move], regions: Regions, pieces: Mapping[int, Choice]
    ) -> tuple[Candidates, list[_Phase]] | MoveFailure | EmptyPiece:
        """Layers of candidate postures, and the phases between them."""
        finder = self.transitions
        every = tuple(range(len(self.body.robot.limbs)))
        contacts = start.contacts
        layers = [Layer(contacts, start.q, start.branches, every)]
        phases: list[_Phase] = []
        for i in range(len(moves) + 1):
            shift = finder.manifold(contacts)
            assert shift is not None  # transitions on it were found
            for region in regions.get(i, ()):
                resting = finder.standing(contacts, region)
                if resting.failure is not None:
                    return MoveFailure(i, "transition", resting.failure)
                phases.append(_Phase(shift, None, i, "region"))
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
            phases += [_Phase(shift, None, i, "let go"), _Phase(swing, move.limb, i, "swing")]
            layers.append(Layer(contacts, leaving.q, leaving.branches, every))
            holding = tuple(c.limb for c in support)
            layers.append(Layer(arriving.contacts, arriving.q, arriving.branches, holding))
            contacts = arriving.contacts
        failure = self._keep(layers, phases, pieces)
        return failure or (Candidates(layers, self.body.robot.angle_q), phases)

    def _keep(self, layers: list[Layer], phases: list[_Phase], pieces: Mapping[int, Choice]) -> EmptyPiece | None:
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
                if phases[i - 1].purpose == "region":  # it might be drawn out of it
                    continue
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
            # A proof is about these two postures only; others may be joined.
            reason = why_apart(manifold, a, b) or f"no path among {self.budget.iterations} samples of RRT-Connect"
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
        motion = timed(self.body, manifold.contacts, paced, self.budget)
        self.seconds["torque"] += clock.perf_counter() - began
        if isinstance(motion, str):
            return MoveFailure(phase.move, "torque", Failure("budget", motion))
        samples, torques = motion
        forces = torques.force, torques.torque, torques.moment
        return PhaseMotion(phase.limb, phase.move, manifold.contacts, samples, *forces)
