"""The least margins of a climb as a table for people, and `climber margins`."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from climber.plan_file import Plan
from climber.plan_parts import MARGIN_KINDS, MarginKind, RobotPlan

# What each margin is called, how it is written, and what to multiply it with before.
TOLD: dict[MarginKind, tuple[str, str, float]] = {
    "friction": ("less friction", "%", 100.0),
    "push": ("push", "N", 1.0),
    "mass": ("mass off", "%", 100.0),
    "center": ("centre of mass off", "mm", 1000.0),
    "place": ("hold displaced", "mm", 1000.0),
    "normal": ("normal turned", "deg", 180.0 / math.pi),
}


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
        _, unit, times = TOLD[self.kind]
        # Where nothing is worst the value is as great as they are told.
        most = self.direction is None and (self.kind != "friction" or self.value > 0.98)
        return f"{'≥ ' if most else ''}{times * self.value:.3g} {unit}"

    @property
    def way(self) -> str:
        """The direction in words."""
        if self.direction is None:
            return ""
        x, y, z = self.direction
        if self.kind == "mass":
            return "too light" if y > 0 or (y == 0 and z > 0) else "too heavy"
        if self.kind == "normal":
            if abs(z) > 0.999:
                return "to the left" if z > 0 else "to the right"
            return f"about ({x:.2f}, {y:.2f}, {z:.2f})"
        if abs(z) > 1e-3:
            return f"towards ({x:.2f}, {y:.2f}, {z:.2f})"
        return f"towards {math.degrees(math.atan2(y, x)) % 360.0:.0f} deg"


def least_margins(plan: RobotPlan) -> Iterator[LeastMargin]:
    """The least margin of every kind."""
    for kind in MARGIN_KINDS:
        told = [(phase.margins[kind], number) for number, phase in enumerate(plan.phases) if kind in phase.margins]
        if told:
            margin, number = min(told, key=lambda pair: pair[0].value)
            label = plan.phases[number].label
            yield LeastMargin(kind, margin.value, number, label, margin.time, margin.direction, margin.limb)


def margin_table(plan: RobotPlan) -> Table:
    """The least margins as a table for a rich console; angles from x towards y in the wall plane."""
    table = Table(title=f"{plan.name} survives at least", title_justify="left", title_style="", box=None)
    for heading, justify in (("error", "left"), ("size", "right"), ("least in", "left"), ("worst", "left")):
        table.add_column(heading, no_wrap=heading != "worst", justify=justify)  # type: ignore[arg-type]
    for least in least_margins(plan):
        worst = ", ".join(part for part in (least.way, "" if least.limb is None else f"under {least.limb}") if part)
        at = f"phase {least.phase}, {least.label}, {least.time:.2f} s"
        table.add_row(TOLD[least.kind][0], least.size, at, worst)
    return table


def add_margins_command(commands: Any) -> argparse.ArgumentParser:
    """Adds `climber margins`."""
    command: argparse.ArgumentParser = commands.add_parser("margins", help="show what a plan survives")
    command.add_argument("plan", type=Path)
    command.set_defaults(run=_run)
    return command


def _run(options: argparse.Namespace) -> int:
    plan = Plan.load(options.plan)
    if options.json:
        robots = [
            {"name": robot.name, "margins": [vars(least) for least in least_margins(robot)]} for robot in plan.robots
        ]
        print(json.dumps({"robots": robots}))
        return 0
    console = Console(highlight=False)
    for robot in plan.robots:
        console.print(margin_table(robot))
    return 0
