"""Who may go first in a step of a team: how two and two come near one another, together or in turns."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from climber.encounter import Encounter, Pair, Track
from climber.phase_motion import PhaseMotion
from climber.stance import Vector

Activity = Literal["at", "move"]


@dataclass(frozen=True)
class Conflict:
    """Two robots that cannot both do in the same step what they did in this one.

    Attributes:
        step: The step.
        one: A robot, and whether it moves or waits.
        two: The other, likewise; one of them moves.
        encounter: Where they come too near if both begin together; time since the step began.
        standing: "start" or "end" if it is in the postures they begin or end the step in that they are too near, None
            if it is only on the way.
    """

    step: int
    one: tuple[int, Activity]
    two: tuple[int, Activity]
    encounter: Encounter
    standing: Literal["start", "end"] | None


@dataclass
class Act:
    """What a robot does in a step, timed from the step's begin.

    Attributes:
        start: The posture it begins in, shape (nq,).
        phases: Its phases; none if it waits.
        track: Its way.
    """

    start: Vector
    phases: Sequence[PhaseMotion]
    track: Track = field(init=False)

    def __post_init__(self) -> None:
        if not self.phases:
            self.track = Track.standing(self.start)
            return
        pieces = [phase.samples for phase in self.phases]
        offsets = np.cumsum([0.0, *(piece.time[-1] - piece.time[0] for piece in pieces)])
        times = [piece.time - piece.time[0] + offset for piece, offset in zip(pieces, offsets, strict=False)]
        self.track = Track(
            np.concatenate([times[0], *(time[1:] for time in times[1:])]),
            np.concatenate([pieces[0].q, *(piece.q[1:] for piece in pieces[1:])]),
        )

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.track.time[-1])

    @property
    def activity(self) -> Activity:
        """Whether it moves."""
        return "move" if self.phases else "at"

    @property
    def ended(self) -> Track:
        """It stands where it ends."""
        return Track.standing(self.track.q[-1])

    @property
    def waiting(self) -> Track:
        """It stands where it begins."""
        return Track.standing(self.start)


class Meetings:
    """How two and two come near one another in one step, by who goes first; worked out when asked."""

    def __init__(self, acts: list[Act], pairs: dict[tuple[int, int], Pair], clearance: float) -> None:
        self._acts, self._pairs, self._clearance = acts, pairs, clearance
        self._known: dict[tuple[int, int, int], list[tuple[int, Encounter]]] = {}

    def _encounters(self, i: int, j: int, first: int) -> list[tuple[int, Encounter]]:
        """Encounters of robots i < j if both begin together (`first` is -1) or one goes first, and who moves then.

        Each comes with the robot whose begin its time counts from.
        """
        key = (i, j, first)
        if key not in self._known:
            a, b = self._acts[i], self._acts[j]
            if first == -1:
                met = [(i if a.phases else j, a.track, b.track)]
            elif first == i:
                met = [(i, a.track, b.waiting), (j, a.ended, b.track)]
            else:
                met = [(j, a.waiting, b.track), (i, a.track, b.ended)]
            pair = self._pairs[i, j]
            self._known[key] = [(who, pair.nearest(one, two, self._clearance)) for who, one, two in met]
        return self._known[key]

    def _clear(self, i: int, j: int, first: int) -> bool:
        i, j = min(i, j), max(i, j)
        return all(encounter.distance >= self._clearance for _, encounter in self._encounters(i, j, first))

    def rounds(self) -> list[list[int]] | None:
        """Who moves in the first round of the step, who in the next, ..., in the least time; None if all collide."""
        movers = [robot for robot, act in enumerate(self._acts) if act.phases]
        waiters = [robot for robot, act in enumerate(self._acts) if not act.phases]
        if not all(self._clear(one, two, -1) for one in movers for two in waiters):
            return None
        if all(self._clear(i, j, -1) for i, j in itertools.combinations(movers, 2)):
            return [movers] if movers else []
        return min(self._orders([], movers), key=self._duration, default=None)

    def _duration(self, rounds: list[list[int]]) -> tuple[float, int]:
        return sum(max(self._acts[robot].duration for robot in turn) for turn in rounds), len(rounds)

    def _orders(self, rounds: list[list[int]], rest: list[int]) -> Iterator[list[list[int]]]:
        """Every order, with ties, in which all keep clear: each robot in turn joins a round or gets one of its own."""
        if not rest:
            yield rounds
            return
        robot, rest = rest[0], rest[1:]
        for place in range(2 * len(rounds) + 1):
            at, own = place // 2, place % 2 == 0
            before, after = rounds[:at], rounds[at:] if own else rounds[at + 1 :]
            beside = [] if own else rounds[at]
            if (
                all(self._clear(robot, other, other) for turn in before for other in turn)
                and all(self._clear(robot, other, robot) for turn in after for other in turn)
                and all(self._clear(robot, other, -1) for other in beside)
            ):
                yield from self._orders([*before, [*beside, robot], *after], rest)

    def conflict(self) -> Conflict:
        """Two robots to blame when there is no order: two for whom none is clear if there are such."""
        pairs = [pair for pair in self._pairs if any(self._acts[robot].phases for robot in pair)]

        def ways(pair: tuple[int, int]) -> int:
            if all(self._acts[robot].phases for robot in pair):
                return sum(self._clear(*pair, first) for first in (-1, *pair))
            return 3 * self._clear(*pair, -1)

        i, j = min(pairs, key=lambda pair: (ways(pair), self._together(pair).distance))
        a, b, near = self._acts[i], self._acts[j], self._pairs[i, j].nearest
        standing: Literal["start", "end"] | None = None
        if near(a.waiting, b.waiting, self._clearance).distance < self._clearance:
            standing = "start"
        elif near(a.ended, b.ended, self._clearance).distance < self._clearance:
            standing = "end"
        return Conflict(0, (i, a.activity), (j, b.activity), self._together((i, j)), standing)

    def _together(self, pair: tuple[int, int]) -> Encounter:
        return self._encounters(*pair, -1)[0][1]

    def closest(
        self, rounds: list[list[int]], begin: dict[int, float], start: float
    ) -> Iterator[tuple[tuple[int, int], Encounter]]:
        """The encounters of all pairs in the step as it takes place, at times since the climb began."""
        place = {robot: number for number, turn in enumerate(rounds) for robot in turn}
        for i, j in self._pairs:
            if i not in place and j not in place:
                continue
            both = i in place and j in place and place[i] != place[j]
            first = min(i, j, key=lambda robot: place[robot]) if both else -1
            for who, encounter in self._encounters(i, j, first):
                yield (i, j), replace(encounter, time=encounter.time + begin.get(who, start))
