"""A better climb for more time: the motion found is improved round by round, and never made worse.

In the first round, and now and then, all postures of the climb are given up for the cheapest way through many drawn
anew; else a few neighbouring ones are, for some near them or drawn anew, perhaps with limbs bent the other way. These
are drawn together (`programs.posture_chain`), and if the climb is cheaper by them the phases between are planned again,
refined as a whole and timed. What comes out is kept only if the objective's value is better, so that the record of
values against planning time goes down. The random numbers are the improver's own: as many rounds with the same seed
give the same climb.
"""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from climber.choose import Candidates, Layer
from climber.path import unwound
from climber.phase_motion import MotionBudget, PhaseMotion
from climber.phases import Curves, PhasePlanner, Stretch, Way, instants
from climber.plan_parts import ObjectiveKind
from climber.programs.posture_chain import Instant
from climber.solids import away
from climber.stance import Vector
from climber.transition import posture_sampler
from climber.transitions import MoveFailure

MOST = 8  # postures given up at once, where it is not all of them
WHOLE = 0.1  # share of the rounds, after the first, that give up all of them
DRAWN = 300  # pelvis poses drawn for a posture that is to be quite another
MANY = 1500  # and if all are: the more there are, the better the way through them
OFF = 0.1  # how far off costs are that choose among these, in flips
TRIED = 16  # places tried for one that is to be near
NEAR = (0.03, 0.6)  # [rad] how far from the posture it replaces one that is to be near it may be, least and most
ROUNDING = 1e-9  # share by which the same value may differ when summed in another order
# How many times as long, in the objective's norm, curves may be for it to be worth the while to time them.
LONGER: dict[ObjectiveKind, float] = {"length": 1.0, "time": 1.05, "margin": np.inf}
SHARE = 1e-6  # a value must be lower by this share to be better


@dataclass(frozen=True)
class Progress:
    """How the best value went down.

    Attributes:
        entries: Seconds of planning and the best value by then.
    """

    entries: tuple[tuple[float, float], ...] = ()

    def then(self, seconds: float, value: float) -> Progress:
        """The record with another value, which is the best by then."""
        return Progress((*self.entries, (seconds, value)))

    def ending(self, seconds: float, value: float) -> Progress:
        """The record of a plan with this value: without what was better, and with it at the end."""
        kept = [entry for entry in self.entries if entry[1] > value + ROUNDING * abs(value)]
        same = [entry for entry in self.entries if abs(entry[1] - value) <= ROUNDING * abs(value)]
        return Progress(tuple(kept)).then(same[0][0] if same else seconds, value)


class Improver:
    """Looks for better climbs near one that works out.

    Attributes:
        rounds: Rounds so far.
    """

    def __init__(self, planner: PhasePlanner, budget: MotionBudget, seed: int) -> None:
        self._planner, self._budget = planner, budget
        self._rng = np.random.default_rng([seed, 1])
        self.rounds = 0

    def improve(self, way: Way, began: float, rounds: int = 0, seconds: float = 0.0) -> tuple[Way, Progress]:
        """The best climb found; if interrupted from the keyboard, the best by then.

        Args:
            way: The climb to begin with.
            began: When planning began, by `time.perf_counter` [s].
            rounds: Rounds, however long they take.
            seconds: Time for more of them after these [s].
        """
        value = self._planner.objective.value(self._planner.body, way.motions)
        progress = Progress().then(clock.perf_counter() - began, value)
        try:
            for _ in range(rounds):
                way, value, progress = self._step(way, value, progress, began)
            until = clock.perf_counter() + seconds
            while clock.perf_counter() < until:
                way, value, progress = self._step(way, value, progress, began)
        except KeyboardInterrupt:
            pass  # whoever has waited long enough wants what there is
        return way, progress

    def _step(self, way: Way, value: float, progress: Progress, began: float) -> tuple[Way, float, Progress]:
        other = self.round(way)
        if other is not None:
            after = self._planner.objective.value(self._planner.body, other.motions)
            if after < value - SHARE * abs(value):
                return other, after, progress.then(clock.perf_counter() - began, after)
        return way, value, progress

    def round(self, way: Way) -> Way | None:
        """Another climb, which may be better, or None if the attempt came to nothing."""
        self.rounds += 1
        whole = self.rounds == 1 or self._rng.random() < WHOLE
        first, last = self._window(way, whole)
        # The phases from before the first posture that is given up to after the last one.
        begin, end = max(first - 1, 0), min(last + 1, len(way.stretches))
        stretches, old = way.stretches[begin:end], way.postures[begin : end + 1]
        free = first == 0, last == len(way.stretches)
        given = instants(stretches, _continuous(old, way), *free)
        postures = self._anew(given, stretches, MANY, 0.0) if whole else self._others(given, stretches)
        if postures is None:
            return None
        before = self._cost(given, [instant.q for instant in given], stretches)
        together = [replace(instant, q=q) for instant, q in zip(given, postures, strict=True)]
        postures = self._planner.drawn_together(together, stretches)
        if not self._cost(given, postures, stretches) < before - SHARE * abs(before):
            return self._refined(way, begin, end) if self._rng.random() < 0.1 else None
        curves: list[Curves] = []
        for stretch, a, b in zip(stretches, postures[:-1], postures[1:], strict=True):
            found = self._planner.curves(stretch, a, b, self._budget, self._rng)
            if isinstance(found, MoveFailure):
                return None
            curves.append(found)
        return self._replaced(way, begin, self._planner.joined(stretches, curves))

    def _window(self, way: Way, whole: bool) -> tuple[int, int]:
        """The first and the last posture to be given up, of all if the whole climb is."""
        count = len(way.stretches)
        least = 0 if way.free_start and way.stretches[0].limb is None else 1
        most = count if way.stretches[-1].limb is None else count - 1
        if whole:
            return least, max(least, most)
        first = int(self._rng.integers(least, most + 1)) if most >= least else least
        return first, min(first + int(self._rng.integers(MOST)), most)

    def _others(self, given: Sequence[Instant], stretches: Sequence[Stretch]) -> list[Vector] | None:
        """Other postures in place of the free ones; None if there are none."""
        if self._rng.random() < 0.5:
            return self._anew(given, stretches, DRAWN, OFF)
        result = [self._near(instant) if instant.free else instant.q for instant in given]
        changed = any(not np.array_equal(q, instant.q) for q, instant in zip(result, given, strict=True))
        return result if changed else None

    def _near(self, instant: Instant) -> Vector:
        """A posture near one, if one of some tried is feasible, else that one."""
        if instant.manifold.rigid:
            return instant.q
        chart = instant.manifold.chart(instant.q)
        size = np.exp(self._rng.uniform(*np.log(NEAR)))
        at = chart.coordinates(instant.q)
        q, reach = chart.expand(at + self._rng.normal(0.0, size, (TRIED, len(at))) / chart.scale)
        good = reach >= instant.manifold.margins.reach
        good[good] = instant.manifold.slack(q[good]) >= 0
        near = self._in_region(instant, q[good])
        return np.asarray(near[0]) if len(near) else instant.q

    def _anew(
        self, given: Sequence[Instant], stretches: Sequence[Stretch], count: int, off: float
    ) -> list[Vector] | None:
        """The cheapest way through postures drawn anew in place of the free ones.

        Args:
            given: The postures, and what others must satisfy.
            stretches: The phases between.
            count: Pelvis poses drawn for each.
            off: How far off costs are, in flips.
        """
        body = self._planner.body
        layers = []
        for k, instant in enumerate(given):
            q, own = instant.q[None], stretches[max(k - 1, 0)].manifold.points
            if instant.free and not instant.manifold.rigid:
                drawn = self._in_region(instant, posture_sampler(body, instant.manifold).draw(self._rng, count)[0])
                q = unwound(drawn, instant.q, body.robot.angle_q) if len(drawn) else q
            branches = np.array([body.branches(row) for row in q], dtype=np.int64)
            cost = self._planner.objective.standing(instant.manifold, q)
            cost = cost + self._rng.exponential(off * self._planner.objective.flip, len(q))
            layers.append(Layer(instant.manifold.contacts, q, branches, tuple(sorted(own)), cost))
        best = Candidates(layers, body.robot.angle_q, self._planner.objective).best()
        return None if best is None else [layer.q[j] for layer, j in zip(layers, best, strict=True)]

    def _in_region(self, instant: Instant, q: Vector) -> Vector:
        """Those of some postures that are in the instant's region."""
        if instant.region is None or not len(q):
            return q
        return np.asarray(q[away(instant.region, q[:, self._planner.body.robot.origin_q]) <= 0.0])

    def _cost(self, given: Sequence[Instant], postures: Sequence[Vector], stretches: Sequence[Stretch]) -> float:
        """What postures cost, straight lines between them, limbs that bend otherwise counted."""
        objective, body = self._planner.objective, self._planner.body
        total = float(objective.step(np.diff(np.array(postures), axis=0)).sum())
        for instant, q in zip(given, postures, strict=True):
            total += float(objective.standing(instant.manifold, q[None])[0])
        branches = [body.branches(q) for q in postures]
        for stretch, here, there in zip(stretches, branches[:-1], branches[1:], strict=True):
            total += objective.flip * sum(here[limb] != there[limb] for limb in stretch.manifold.points)
        return total

    def _refined(self, way: Way, begin: int, end: int) -> Way | None:
        """The climb with the phases from `begin` to `end` refined together once more."""
        return self._replaced(way, begin, self._planner.joined(way.stretches[begin:end], way.curves[begin:end]))

    def _replaced(self, way: Way, begin: int, curves: Sequence[Curves]) -> Way | None:
        """The climb along other curves from phase `begin` on, or None if these have no timing."""
        end = begin + len(curves)
        before, after = (
            self._planner.length([leg for own in part for leg in own]) for part in (way.curves[begin:end], curves)
        )
        if after > LONGER[self._planner.objective.kind] * before:
            return None  # timing it would be a waste of time
        motions = self._planner.all_timed(way.stretches[begin:end], curves, self._budget)
        if not isinstance(motions, list):
            return None
        every: tuple[PhaseMotion, ...] = (*way.motions[:begin], *motions, *way.motions[end:])
        return Way.of(way.stretches, (*way.curves[:begin], *curves, *way.curves[end:]), every, way.free_start)


def _continuous(postures: Sequence[Vector], way: Way) -> list[Vector]:
    """Postures without whole turns of the pelvis between them."""
    angles = way.stretches[0].manifold.body.robot.angle_q
    result = [postures[0]]
    for q in postures[1:]:
        result.append(unwound(q, result[-1], angles))
    return result
