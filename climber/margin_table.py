"""The least margins of a climb as a table for people, and `climber margins`."""

from __future__ import annotations

import argparse
from typing import Any

from rich.console import Console
from rich.table import Table

from climber.least_margins import WORDS, least_by_kind
from climber.plan_command import add_plan_command
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
    return add_plan_command(commands, "margins", _facts, _tell, help="show what a plan survives")


def _facts(plan: RobotPlan) -> dict[str, Any]:
    return {"margins": [vars(least) for least in least_by_kind(plan)]}


def _tell(plan: RobotPlan, console: Console) -> None:
    console.print(margin_table(plan, console.width))
