"""What keeps the phases of a climb from being faster, as a table for people, and `climber limits`."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

from climber.plan_command import add_plan_command
from climber.plan_parts import Phase, RobotPlan

FEW = 0.05  # share of a phase's time: limits that keep it for less are left out of the table


@dataclass(frozen=True)
class PhaseLimits:
    """What keeps a phase from being faster.

    Attributes:
        phase: Number of the phase.
        label: What it does.
        begin: When it begins [s].
        duration: How long it takes [s].
        method: How it was timed, `conic` or `paced`.
        shares: By limit, the share of the duration in which it is active, the greatest first.
        told: Share of the duration in which any is.
    """

    phase: int
    label: str
    begin: float
    duration: float
    method: str
    shares: dict[str, float]
    told: float


def limits_of(plan: RobotPlan) -> list[PhaseLimits]:
    """What keeps each phase of a robot's climb from being faster."""
    found = []
    for number, phase in enumerate(plan.phases):
        duration = float(phase.time[-1] - phase.time[0])
        shares = {name: _covered(phase, [name]) / duration for name in {name for _, _, name in phase.timing.active}}
        found.append(
            PhaseLimits(
                phase=number,
                label=phase.label,
                begin=float(phase.time[0]),
                duration=duration,
                method=phase.timing.method,
                shares=dict(sorted(shares.items(), key=lambda item: (-item[1], item[0]))),
                told=_covered(phase, shares) / duration,
            )
        )
    return found


def told_in_short(plan: RobotPlan) -> str:
    """For how much of the climb limits of each kind keep it from being faster, in words; "" if nothing is known."""
    seconds: dict[str, float] = {}
    for phase in plan.phases:
        names = {name for _, _, name in phase.timing.active}
        for kind in {name.rpartition(" ")[0] for name in names}:
            own = [name for name in names if name.rpartition(" ")[0] == kind]
            seconds[kind] = seconds.get(kind, 0.0) + _covered(phase, own)
    greatest = sorted(seconds.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{kind} {share / plan.duration:.0%} of the time" for kind, share in greatest)


def _covered(phase: Phase, names: Iterable[str]) -> float:
    """For how long at least one of some limits is active [s]."""
    wanted, end, seconds = set(names), float(phase.time[0]), 0.0
    for begin, until, name in sorted(phase.timing.active):
        if name in wanted and until > end:
            seconds += until - max(begin, end)
            end = until
    return seconds


def limit_table(plan: RobotPlan) -> Table:
    """The limits phase by phase for a rich console."""
    table = Table(title=f"{plan.name} is kept from being faster by", title_justify="left", title_style="", box=None)
    table.add_column("phase", no_wrap=True)
    table.add_column("takes", no_wrap=True, justify="right")
    table.add_column("share of that time in which a limit is reached")
    for each in limits_of(plan):
        words = [f"{name} {share:.0%}" for name, share in each.shares.items() if share >= FEW]
        if each.method == "paced":
            words = ["nothing that is known: it runs by a law of fixed shape"]
        table.add_row(f"{each.phase} {each.label}", f"{each.duration:.2f} s", ", ".join(words))
    return table


def add_limits_command(commands: Any) -> argparse.ArgumentParser:
    """Adds `climber limits`."""
    return add_plan_command(
        commands,
        "limits",
        _facts,
        _tell,
        help="show what keeps a plan from being faster",
        description="Shows, phase by phase, which limits of speed, acceleration, jerk, torque, friction and contact "
        "force the motion runs at, and for how much of its time. Forces are timed with something in reserve, so that "
        "there may be none for a while.",
    )


def _facts(plan: RobotPlan) -> dict[str, Any]:
    return {"phases": [asdict(limits) for limits in limits_of(plan)]}


def _tell(plan: RobotPlan, console: Console) -> None:
    console.print(limit_table(plan))
    console.print(f"in all: {told_in_short(plan) or 'nothing told'}", markup=False)
