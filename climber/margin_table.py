"""The least margins of a climb as a table for people, and `climber margins`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from climber.least_margins import WORDS, least_by_kind
from climber.plan_file import Plan
from climber.plan_parts import RobotPlan

OTHERS = 36  # columns of a terminal that the rest of the table takes


def margin_table(plan: RobotPlan, width: int) -> Table:
    """The least margins as a table for a rich console of `width` columns; angles from x towards y in the wall plane."""
    table = Table(title=f"{plan.name} survives at least", title_justify="left", title_style="", box=None)
    for heading, justify in (("error", "left"), ("size", "right"), ("least in, and worst there", "left")):
        table.add_column(heading, no_wrap=True, justify=justify)  # type: ignore[arg-type]
    rows = []
    for least in least_by_kind(plan):
        worst = ", ".join(part for part in (least.way, "" if least.limb is None else f"under {least.limb}") if part)
        at = f"phase {least.phase}, {least.label}, {least.time:.2f} s"
        rows.append((WORDS[least.kind].error, least.size, at, worst))
    narrow = any(len(at) + len(worst) > width - OTHERS for _, _, at, worst in rows)
    for error, size, at, worst in rows:
        table.add_row(error, size, (",\n" if narrow else ", ").join(part for part in (at, worst) if part))
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
            {"name": robot.name, "margins": [vars(least) for least in least_by_kind(robot)]} for robot in plan.robots
        ]
        print(json.dumps({"robots": robots}))
        return 0
    console = Console(highlight=False)
    for robot in plan.robots:
        console.print(margin_table(robot, console.width))
    return 0
