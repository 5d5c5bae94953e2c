"""Commands that tell something of each robot of a plan file."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from climber.plan_file import Plan
from climber.plan_parts import RobotPlan


def add_plan_command(
    commands: Any,
    name: str,
    facts: Callable[[RobotPlan], dict[str, Any]],
    tell: Callable[[RobotPlan, Console], None],
    **words: str,
) -> argparse.ArgumentParser:
    """Adds a command to the subcommands of a parser.

    Args:
        commands: The subcommands.
        name: The command's.
        facts: What there is to tell of a robot, for programs.
        tell: Tells it to people.
        words: `help` and `description` of the command.
    """
    command: argparse.ArgumentParser = commands.add_parser(name, **words)
    command.add_argument("plan", type=Path)

    def run(options: argparse.Namespace) -> int:
        plan = Plan.load(options.plan)
        if options.json:
            print(json.dumps({"robots": [{"name": robot.name, **facts(robot)} for robot in plan.robots]}))
            return 0
        console = Console(highlight=False)
        for robot in plan.robots:
            tell(robot, console)
        return 0

    command.set_defaults(run=run)
    return command
