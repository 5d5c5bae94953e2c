"""The checks of a robot's margins, by programs of their own on verify's own mechanics.

A margin says that the motion of a phase survives errors of one kind up to a size: at every sample there are contact
forces that balance the robot, keep to what the holds can then give, and need no torque beyond the motors' limits. The
claim is tried at every sample (a hold's place: at one in `verify_errors.SPARSE`) in directions all around: first with
forces near ones well inside the limits, then near forces found for other samples; where these will not do, a conic
program finds the least by which limits must be left. At the instant that the plan names as the worst, an error greater
by a share of `SHORT` must not be survived (in space with a little less friction), but for errors of a hold's place, of
which the plan gives a lower bound only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from climber.plan_parts import MARGIN_KINDS, MarginKind, Phase, PhaseMargin, RobotPlan
from climber.robot import Robot
from climber.stance import Vector
from climber.verdict import Ledger
from climber.verify_errors import Error, PhaseNeeds, Trial
from climber.verify_mechanics import Mechanics
from climber.verify_motion import Motion
from climber.verify_rules import MARGIN
from climber.verify_survival import Need, shortages
from climber.wall import Wall

# By which share, and by how much in its own unit, a margin may be less than what forces can do, of which it is 95 % at
# the most: in the plane and in space.
SHORT = {2: 0.085, 3: 0.18}
SMALLEST = 1e-4
NARROW = 0.02  # share of friction that a planner may leave unused which fits pyramids into cones in space
UNSURVIVED = 1e-8  # [N, N m] what must be lacking at a greater error
TIME = 1e-5  # [s] the same instant
UNIT = 1e-6  # of unit vectors
ALIKE: tuple[MarginKind, ...] = ("friction", "normal")  # errors of all holds, which have no direction
AROUND = np.array([(np.cos(a), np.sin(a), 0.0) for a in 2.0 * np.pi * (np.arange(8) + 0.5) / 8])
EVERYWHERE = np.array(
    [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], dtype=float
)
EVERYWHERE /= np.linalg.norm(EVERYWHERE, axis=1, keepdims=True)
# Greater margins than these are given as these: shares, N, m, rad.
MOST: dict[MarginKind, float] = {
    "friction": 0.95,
    "push": 950.0,
    "mass": 0.665,
    "center": 0.019,
    "place": 0.019,
    "normal": 0.19,
}


def _samples(phase: Phase, margin: PhaseMargin) -> NDArray[np.bool_]:
    """Which of a phase's samples a margin names as the worst, shape (N,)."""
    return np.asarray(np.abs(phase.time - margin.time) <= TIME)


def _in_parts(needs: list[Need], dimension: int) -> tuple[list[Vector], Vector]:
    """`shortages`, a few hundred at a time."""
    parts = [shortages(needs[i : i + 300], dimension) for i in range(0, len(needs), 300)]
    return [x for forces, _ in parts for x in forces], np.concatenate([np.zeros(0), *(lacking for _, lacking in parts)])


class MarginChecks:
    """Goes through the margins of a robot's phases and takes down what it finds."""

    def __init__(
        self, robot: Robot, wall: Wall, asked: Mapping[MarginKind, float], plan: RobotPlan, ledger: Ledger
    ) -> None:
        self._robot, self._wall, self._plan, self._ledger, self._asked = robot, wall, plan, ledger, asked
        self._planar = robot.planar
        self._dimension = 2 if robot.planar else 3
        samples = [Motion.samples(phase, plan, robot) for phase in plan.phases]
        ends = np.cumsum([0, *(len(motion.time) for motion in samples)])
        self._spans = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        whole = Motion(*(np.concatenate([vars(motion)[name] for motion in samples]) for name in vars(samples[0])))
        self._time, self._mechanics = whole.time, Mechanics(robot, whole, any(hold.max_moment for hold in wall.holds))
        self._phases = [
            PhaseNeeds(robot, wall, phase, span, self._mechanics, whole)
            for phase, span in zip(plan.phases, self._spans, strict=True)
        ]

    def check(self) -> None:
        """Checks every margin of every phase."""
        for number, phase in enumerate(self._plan.phases):
            for kind in MARGIN_KINDS:
                if asked := self._asked[kind]:
                    short = np.array([1.0 - phase.margins[kind].value / asked])
                    self._ledger.note("asked margins", short, [self._label(number, kind)])
        self._ledger.faults("worst instants", [fault for n in range(len(self._plan.phases)) for fault in self._odd(n)])
        self._settle()
        knots = np.concatenate(
            [needs.knots + span.start for needs, span in zip(self._phases, self._spans, strict=True)]
        )
        followed = self._mechanics.followed(knots)
        for needs, span in zip(self._phases, self._spans, strict=True):
            mine = (span.start <= knots) & (knots < span.stop)
            needs.levers = followed[0][mine], followed[1][mine]
        trials = [
            Trial(needs, number, error) for number, needs in enumerate(self._phases) for error in self._errors(number)
        ]
        self._survive(trials)
        self._follow()
        self._tight()

    def _label(self, number: int, kind: str) -> str:
        return f"{self._plan.name}, phase {number} ({self._plan.phases[number].label}), {kind}"

    def _odd(self, number: int) -> Iterator[str]:
        """What is written down of a margin must have a meaning."""
        phase = self._plan.phases[number]
        limbs = {contact.limb for contact in phase.contacts}
        for kind in MARGIN_KINDS:
            margin, at = phase.margins[kind], self._label(number, kind)
            if not np.any(_samples(phase, margin)):
                yield f"{at}: t = {margin.time:.4f} s is no sample of the phase"
            if margin.value > MOST[kind]:
                yield f"{at}: {margin.value:g} is greater than {MOST[kind]:g}, beyond which margins are not told"
            narrowest = min(self._wall.holds[contact.hold].half_width for contact in phase.contacts)
            if kind == "place" and margin.value > narrowest:
                yield f"{at}: {margin.value:g} is greater than half the width of a patch, {narrowest:g}"
            told = kind not in ALIKE and not self._open(kind, margin)
            if not told and margin.direction is None and margin.limb is None:
                continue
            if (margin.limb is not None) != (kind == "place") or margin.limb not in {None, *limbs}:
                yield f"{at}: {margin.limb or 'no limb'} is named as the limb of the hold"
            elif kind in ALIKE:
                yield f"{at}: it has no direction"
            elif margin.direction is None or abs(float(np.linalg.norm(margin.direction)) - 1.0) > UNIT:
                yield f"{at}: a unit direction is expected"
            elif self._sideways(kind, margin) > UNIT:
                yield f"{at}: errors of this kind have no such direction"

    def _sideways(self, kind: MarginKind, margin: PhaseMargin) -> float:
        """How far the direction of a margin is from those that errors of its kind have, as the sine of an angle."""
        direction = np.array(margin.direction)
        if kind == "mass":
            gravity = self._wall.gravity / np.linalg.norm(self._wall.gravity)
            return float(np.linalg.norm(np.cross(gravity, direction)))
        return float(abs(direction[2])) if self._planar else 0.0

    def _open(self, kind: MarginKind, margin: PhaseMargin) -> bool:
        """Whether a margin is as great as they come, so that nothing is known of a worst case."""
        return margin.value * (1.0 + SHORT[self._dimension]) + SMALLEST >= MOST[kind]

    def _errors(self, number: int) -> Iterator[Error]:
        """The errors that a phase claims to survive."""
        phase = self._plan.phases[number]
        gravity = self._wall.gravity / np.linalg.norm(self._wall.gravity)
        around = AROUND if self._planar else EVERYWHERE
        for kind in MARGIN_KINDS:
            size = phase.margins[kind].value
            if size == 0.0:  # nothing is claimed
                continue
            if kind in ALIKE:
                yield Error(kind, size, np.zeros(3))
            elif kind == "mass":
                yield from (Error(kind, size, sign * gravity) for sign in (1.0, -1.0))
            elif kind in ("push", "center"):
                named = self._named(phase.margins[kind])
                yield from (Error(kind, size, direction) for direction in [*around, *named])
            else:
                for i, contact in enumerate(phase.contacts):
                    worst = self._named(phase.margins[kind]) if contact.limb == phase.margins[kind].limb else []
                    yield from (Error(kind, size, direction, i) for direction in [*around, *worst])

    def _named(self, margin: PhaseMargin) -> list[Vector]:
        """The unit direction that a margin names as the worst, if it names one."""
        if margin.direction is None:
            return []
        return [np.array(margin.direction) / max(float(np.linalg.norm(margin.direction)), 1e-9)]

    def _settle(self) -> None:
        """Finds forces well inside the limits at some samples of each phase, and between them by interpolation."""
        needs, owners = [], []
        for phase in self._phases:
            for row in phase.knots:
                needs.append(phase.need(int(row), phase.demand(None)))
                owners.append(phase)
        forces, _ = _in_parts(needs, self._dimension)
        for phase in self._phases:
            phase.settle(np.array([x for x, owner in zip(forces, owners, strict=True) if owner is phase]))

    def _survive(self, trials: list[Trial]) -> None:
        """Tries all errors at all samples, programs for those at which none of the forces known will do."""
        for trial in trials:
            trial.attempt(trial.phase.inner)
        while open_trials := [trial for trial in trials if len(trial.left)]:
            rows = [trial.worst() for trial in open_trials]
            needs = [trial.phase.need(row, trial.demand) for trial, row in zip(open_trials, rows, strict=True)]
            forces, shortage = _in_parts(needs, self._dimension)
            # Where balance is sensitive a little of it may have been given up for room; that refutes nothing.
            for i in np.flatnonzero(~(shortage <= MARGIN)).tolist():
                (x,), (least,) = shortages([needs[i]], self._dimension, room=0.0)
                if least <= MARGIN:
                    forces[i], shortage[i] = x, least
            for trial, row, x, lacking in zip(open_trials, rows, forces, shortage, strict=True):
                trial.learn(row, x, float(lacking))
        for trial in trials:
            at = self._label(trial.number, trial.error.kind)
            self._ledger.note("margins", np.array([trial.lacking]), [f"{at}, t = {trial.where:.4f} s"])

    def _follow(self) -> None:
        """A limb follows a hold that is displaced if motors drive all of its joints, and there are enough of them."""
        stuck = {
            limb.name
            for limb in self._robot.limbs
            if len(limb.joints) < self._dimension or not np.all(limb.effort > 0.0)
        }
        for number, phase in enumerate(self._plan.phases):
            held = stuck & {contact.limb for contact in phase.contacts}
            if held and phase.margins["place"].value > 0.0:
                at = self._label(number, "place")
                self._ledger.note("margins", np.array([np.inf]), [f"{at}, {min(held)} cannot follow its hold"])

    def _tight(self) -> None:
        """At the worst instant a greater error is not survived."""
        needs, labels = [], []
        for number, phase in enumerate(self._plan.phases):
            for kind in MARGIN_KINDS:
                margin = phase.margins[kind]
                rows = np.flatnonzero(_samples(phase, margin))
                if kind == "place" or self._open(kind, margin) or not len(rows):
                    continue
                names = [contact.limb for contact in phase.contacts]
                contact = names.index(margin.limb) if margin.limb in names else -1
                direction = np.zeros(3) if margin.direction is None else np.array(margin.direction)
                size = margin.value * (1.0 + SHORT[self._dimension]) + SMALLEST
                demand = self._phases[number].demand(Error(kind, size, direction, contact))
                if not self._planar:
                    demand = replace(demand, gives=tuple(give.slippery(NARROW) for give in demand.gives))
                needs.append(self._phases[number].need(int(rows[0]), demand))
                labels.append(f"{self._label(number, kind)}: {size:.4g} is survived at t = {margin.time:.4f} s")
        _, lacking = _in_parts(needs, self._dimension)
        self._ledger.faults(
            "worst instants", [label for label, s in zip(labels, lacking, strict=True) if not s > UNSURVIVED]
        )
