"""The command line: `climber solve | verify | margins | limits | simulate | draw | explain | table | robot | wall`.

Exit codes: 0 all is well, 1 the answer is no (no climb found, a check failed), 2 the input is at fault.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from climber.exceptions import ClimberError, NoPlanFound

OK, NO, BAD_INPUT = 0, 1, 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    options = _parser().parse_args(arguments)
    errors = Console(stderr=True, highlight=False, soft_wrap=True)
    try:
        result: int = options.run(options)
        return result
    except NoPlanFound as answer:
        from climber.explain import explain_failure

        told = explain_failure(answer)
        if options.json:
            facts = {"ok": False, "proved": answer.proved, "reason": str(answer), "counts": answer.counts}
            print(json.dumps({**facts, "explanation": None if told is None else told.to_dict()}))
        errors.print("no plan:", style="bold", end=" ")
        errors.print(str(answer), markup=False)
        for sentence in () if told is None else told.sentences:
            errors.print(f"  {sentence}", markup=False)
        return NO
    except ClimberError as error:
        errors.print(f"error: {error}", style="red", markup=False)
        return BAD_INPUT
    except OSError as error:
        errors.print(f"error: {error.filename or ''}: {error.strerror or error}", style="red", markup=False)
        return BAD_INPUT
    except KeyboardInterrupt:
        errors.print("interrupted", style="red")
        return BAD_INPUT


def _parser() -> argparse.ArgumentParser:
    from climber import __version__
    from climber.explain_command import add_explain_command
    from climber.limit_table import add_limits_command
    from climber.margin_table import add_margins_command
    from climber.robot_command import add_robot_command
    from climber.simulate_command import add_simulate_command
    from climber.solve_command import add_solve_command
    from climber.table_command import add_table_command
    from climber.wall_command import add_wall_command

    parser = argparse.ArgumentParser(prog="climber", description="Plans free climbs of multi-limbed robots.")
    parser.add_argument("--version", action="version", version=f"climber {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    solve = add_solve_command(commands)

    verify = commands.add_parser("verify", help="re-check a plan file from nothing")
    verify.add_argument("plan", type=Path)
    verify.set_defaults(run=_verify)

    margins = add_margins_command(commands)
    limits = add_limits_command(commands)
    simulate = add_simulate_command(commands)

    draw = commands.add_parser("draw", help="draw the pictures of a plan file")
    draw.add_argument("plan", type=Path)
    draw.add_argument("--out", type=Path, help="folder for the pictures; the plan's own by default")
    draw.set_defaults(run=_draw)

    robot = add_robot_command(commands)
    explain = add_explain_command(commands)
    wall = add_wall_command(commands)
    table = add_table_command(commands)

    for command in (solve, verify, margins, limits, simulate, draw, robot, explain, wall, table):
        command.add_argument("--json", action="store_true", help="print the result as JSON")
    return parser


def _verify(options: argparse.Namespace) -> int:
    from climber.verify import verify

    verdict = verify(options.plan)
    if options.json:
        print(verdict.to_json())
    else:
        Console(highlight=False).print(verdict)
    return OK if verdict.ok else NO


def _draw(options: argparse.Namespace) -> int:
    from climber.draw import draw_all
    from climber.plan_file import Plan

    written = list(draw_all(Plan.load(options.plan), options.out or options.plan.parent))
    if options.json:
        print(json.dumps({"files": [str(path) for path in written]}))
    else:
        Console(highlight=False, soft_wrap=True).print(f"wrote {', '.join(str(path) for path in written)}")
    return OK


if __name__ == "__main__":
    sys.exit(main())
