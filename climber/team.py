"""Several robots' motions on one clock.

A team climbs in steps. In each, a robot makes one move or waits; the next begins when all are done, so that what the
task planner says of steps is true of time: a hold left in one step is free in the next. Robots that would come too near
while they move together take turns within the step; where no order helps, the task planner is told what must not happen
in the same step.

Who waits stands still with all limbs on. In the phases that is a longer shift, so that they go on alternating: contacts
change neither while a robot waits nor in the shift that follows, and forces at rest are those the shift begins with.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from climber.encounter import Encounter, Pair, Track
from climber.manifold import Body
from climber.phase_motion import PhaseMotion
from climber.stance import Vector
from climber.timing import Samples, joined

Activity = Literal["at", "move"]
Steps = Sequence[Sequence[PhaseMotion]]
SAME = 1e-9  # [s, m/s, rad/s, m/s^2, rad/s^2] zero


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


@dataclass(frozen=True)
class TeamMotion:
    """A team's motion.

    Attributes:
        phases: Each robot's phases; all begin at time 0 and end together.
        starts: When each step begins and the last one ends [s].
        turns: Steps in which robots take turns.
        nearest: The least distance of any two robots; infinite for a robot alone.
        robots: Which two.
    """

    phases: tuple[tuple[PhaseMotion, ...], ...]
    starts: tuple[float, ...]
    turns: tuple[int, ...]
    nearest: Encounter
    robots: tuple[int, int]


@dataclass
class _Act:
    """What a robot does in a step, timed from the step's begin."""

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
        return float(self.track.time[-1])

    @property
    def activity(self) -> Activity:
        return "move" if self.phases else "at"

    @property
    def ended(self) -> Track:
        return Track.standing(self.track.q[-1])

    @property
    def waiting(self) -> Track:
        return Track.standing(self.start)


def by_step(phases: Sequence[PhaseMotion], moving: Sequence[bool]) -> list[list[PhaseMotion]]:
    """One robot's phases, sorted into the steps of the team.

    Args:
        phases: A climb's phases, as `MotionPlanner.plan` returns them.
        moving: In which steps the robot moves; as often as there are moves.

    Returns:
        Its phases in each step, none where it waits. What comes after the last move belongs to the last move's step; a
        robot that never moves does it in the first.
    """
    steps: list[list[PhaseMotion]] = [[] for _ in moving] or [[]]
    at = [step for step, moves in enumerate(moving) if moves] or [0]
    for phase in phases:
        steps[at[min(phase.move, len(at) - 1)]].append(phase)
    return steps


class Team:
    """Robots on one wall.

    Args:
        bodies: The robots on their walls.
        clearance: How far they must stay from one another [m].
        rate: Samples per second while a robot waits [Hz].
    """

    def __init__(self, bodies: Sequence[Body], clearance: float = 1e-3, rate: float = 100.0) -> None:
        self._count, self._clearance, self._rate = len(bodies), clearance, rate
        self._pairs = {(i, j): Pair(bodies[i], bodies[j]) for i, j in itertools.combinations(range(len(bodies)), 2)}

    def synchronise(self, steps: Sequence[Steps]) -> TeamMotion | tuple[Conflict, ...]:
        """The robots' motions on one clock, clear of one another.

        Args:
            steps: For each robot its phases in each step, none where it waits. They begin and end at rest, follow on
                one another in posture, and a step begins and ends with all limbs on or goes on in a shift.

        Returns:
            The motion, or every step's first conflict.

        Raises:
            ValueError: If robots differ in their number of steps, one has no phase at all, or a step is not at rest
                where it begins and ends.
        """
        acts = self._acts(steps)
        conflicts, turns, begins, starts = [], [], [], [0.0]
        nearest, robots = Encounter(np.inf, 0.0, ("", "")), (0, 0)
        for step, now in enumerate(acts):
            meetings = _Meetings(now, self._pairs, self._clearance)
            rounds = meetings.rounds()
            if rounds is None:
                conflicts.append(replace(meetings.conflict(), step=step))
                continue
            offsets = np.cumsum([0.0, *(max(now[robot].duration for robot in turn) for turn in rounds)])
            begin = {robot: starts[-1] + float(offsets[place]) for place, turn in enumerate(rounds) for robot in turn}
            for pair, encounter in meetings.closest(rounds, begin, starts[-1]):
                if encounter.distance < nearest.distance:
                    nearest, robots = encounter, pair
            if len(rounds) > 1:
                turns.append(step)
            begins.append(begin)
            starts.append(float(starts[-1] + offsets[-1]))
        if conflicts:
            return tuple(conflicts)
        phases = tuple(
            self._on_the_clock(
                [(begin.get(robot, 0.0), step) for begin, step in zip(begins, steps[robot], strict=True) if step],
                starts[-1],
            )
            for robot in range(self._count)
        )
        return TeamMotion(phases, tuple(starts), tuple(turns), nearest, robots)

    def _acts(self, steps: Sequence[Steps]) -> list[list[_Act]]:
        """What each robot does, by step and robot."""
        if len(steps) != self._count or len({len(own) for own in steps}) != 1:
            raise ValueError(f"{self._count} robots need as many lists of steps of one length")
        columns = []
        for robot, own in enumerate(steps):
            phases = [phase for step in own for phase in step]
            if not phases:
                raise ValueError(f"robot {robot} has no phase to say where it stands")
            posture, acts = phases[0].samples.q[0], []
            for step in own:
                for phase, row in ((step[0], 0), (step[-1], -1)) if step else ():
                    if np.abs([phase.samples.v[row], phase.samples.vd[row]]).max() > SAME:
                        raise ValueError(f"robot {robot} is not at rest where a step begins or ends")
                acts.append(_Act(posture, step))
                posture = acts[-1].track.q[-1]
            columns.append(acts)
        return [list(row) for row in zip(*columns, strict=True)]

    def _on_the_clock(self, steps: list[tuple[float, Sequence[PhaseMotion]]], end: float) -> tuple[PhaseMotion, ...]:
        """One robot's phases from time 0 to `end` [s], each step's at its time, shifts lengthened where it waits."""
        result: list[PhaseMotion] = []
        now = 0.0
        for begin, phases in steps:
            for number, phase in enumerate(phases):
                waits = number == 0 and begin - now > SAME
                result.append(_from(self._waiting(phase, begin - now, 0) if waits else phase, now))
                now = float(result[-1].samples.time[-1])
        if end - now > SAME:
            last = self._waiting(result[-1], end - now, -1)
            last.samples.time[-1] = end
            result[-1] = last
        return tuple(result)

    def _waiting(self, phase: PhaseMotion, idle: float, row: Literal[0, -1]) -> PhaseMotion:
        """A shift with `idle` seconds at rest before its first sample (row 0) or after its last (row -1)."""
        if phase.limb is not None:
            raise ValueError("a robot waits with all limbs on; a step begins with a shift, and the last ends with one")
        count = int(np.ceil(idle * self._rate)) + 1
        still = np.zeros((count, phase.samples.v.shape[1]))
        rest = Samples(np.linspace(0.0, idle, count), np.repeat(phase.samples.q[[row]], count, axis=0), still, still)

        def lengthened(values: Vector) -> Vector:
            more = np.repeat(values[[row]], count - 1, axis=0)
            return np.concatenate([more, values] if row == 0 else [values, more])

        moving = replace(phase.samples, time=phase.samples.time - phase.samples.time[0])
        samples = joined([rest, moving] if row == 0 else [moving, rest])
        begun = phase.samples.time[0] if row == -1 else 0.0
        return replace(
            phase,
            samples=replace(samples, time=samples.time + begun),
            force=lengthened(phase.force),
            torque=lengthened(phase.torque),
            moment=lengthened(phase.moment),
            timing=phase.timing.later(idle if row == 0 else 0.0),
        )


def _from(phase: PhaseMotion, begin: float) -> PhaseMotion:
    """The phase, beginning at another time [s]."""
    time = phase.samples.time - phase.samples.time[0] + begin
    time[0] = begin
    return replace(phase, samples=replace(phase.samples, time=time))


class _Meetings:
    """How two and two come near one another in one step, by who goes first; worked out when asked."""

    def __init__(self, acts: list[_Act], pairs: dict[tuple[int, int], Pair], clearance: float) -> None:
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
