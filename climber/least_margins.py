"""The least margins of a climb, and what margins are called."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from climber.plan_file import Plan
from climber.plan_parts import CAPS, MARGIN_KINDS, MarginKind, RobotPlan


@dataclass(frozen=True)
class Words:
    """How people read a margin.

    Attributes:
        error: What the error is called.
        phrase: The error with a size that takes the place of {}.
        unit: The size's unit.
        times: What to multiply with, for this unit.
        si: The unit of plan files and scenarios; "" for shares.
    """

    error: str
    phrase: str
    unit: str
    times: float
    si: str = ""

    def size(self, value: float, digits: int) -> str:
        """A margin as plan files have it, in this unit."""
        return f"{self.times * value:.{digits}g} {self.unit}"


WORDS: dict[MarginKind, Words] = {
    "friction": Words("less friction", "friction less by {}", "%", 100.0),
    "push": Words("push", "a push of {}", "N", 1.0, "N"),
    "mass": Words("mass off", "mass off by {}", "%", 100.0),
    "center": Words("centre of mass off", "centre of mass off by {}", "mm", 1000.0, "m"),
    "place": Words("hold displaced", "one hold off by {}", "mm", 1000.0, "m"),
    "normal": Words("normals turned", "holds turned by {}", "deg", 180.0 / math.pi, "rad"),
}
NEARLY = 0.98  # share of the greatest margins that are told, from which on they are as great as that


def with_unit(kind: MarginKind, value: float, digits: int = 6) -> str:
    """A margin as plan files and scenarios have it, in SI units."""
    return f"{value:.{digits}g} {WORDS[kind].si}".rstrip()


@dataclass(frozen=True)
class LeastMargin:
    """The least margin of one kind of a robot's climb.

    Attributes:
        kind: Its kind.
        value: In the unit of the plan file.
        phase: Number of the phase.
        label: What the phase does.
        time: When it is least [s].
        direction: Worst direction in W, if one is told.
        limb: The limb on the hold that is worst, if one is told.
    """

    kind: MarginKind
    value: float
    phase: int
    label: str
    time: float
    direction: tuple[float, float, float] | None
    limb: str | None

    @property
    def size(self) -> str:
        """The value as people read it."""
        most = self.direction is None and self.value > NEARLY * CAPS[self.kind]
        return f"{'≥ ' if most else ''}{WORDS[self.kind].size(self.value, 3)}"

    @property
    def way(self) -> str:
        """The direction in words."""
        if self.direction is None:
            return ""
        x, y, z = self.direction
        if self.kind == "mass":
            return "too light" if y > 0 or (y == 0 and z > 0) else "too heavy"
        if abs(z) > 1e-3:
            return f"towards ({x:.2f}, {y:.2f}, {z:.2f})"
        return f"towards {math.degrees(math.atan2(y, x)) % 360.0:.0f} deg"


def least_by_kind(plan: RobotPlan) -> Iterator[LeastMargin]:
    """The least margin of every kind that all phases of a robot's climb have."""
    for kind in MARGIN_KINDS:
        told = [(phase.margins[kind], number) for number, phase in enumerate(plan.phases) if kind in phase.margins]
        if told and len(told) == len(plan.phases):
            margin, number = min(told, key=lambda pair: pair[0].value)
            label = plan.phases[number].label
            yield LeastMargin(kind, margin.value, number, label, margin.time, margin.direction, margin.limb)


def least_margins(plan: Plan) -> dict[MarginKind, float]:
    """What the whole plan is certified to survive, by kind of error: the least margin of any phase of its robots.

    Units are those of `climber.plan_parts.PhaseMargin`.
    """
    robots = [{least.kind: least.value for least in least_by_kind(robot)} for robot in plan.robots]
    return {kind: min(r[kind] for r in robots) for kind in MARGIN_KINDS if all(kind in r for r in robots)}
