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
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from climber.encounter import Encounter, Pair
from climber.manifold import Body
from climber.meetings import Act, Conflict, Meetings
from climber.phase_motion import PhaseMotion
from climber.stance import Vector
from climber.timing import Samples, joined

Steps = Sequence[Sequence[PhaseMotion]]
SAME = 1e-9  # [s, m/s, rad/s, m/s^2, rad/s^2] zero


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
            meetings = Meetings(now, self._pairs, self._clearance)
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

    def _acts(self, steps: Sequence[Steps]) -> list[list[Act]]:
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
                acts.append(Act(posture, step))
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
