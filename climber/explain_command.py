"""`climber explain`: the command that tells why a climb or a move is not possible."""

from __future__ import annotations

import argparse
import json
from typing import Any

from rich.console import Console

from climber.explain import SECONDS, ask, explain_climb
from climber.explain_move import MoveExplanation, explain_move
from climber.explanation import Explanation
from climber.move_question import MoveQuestion
from climber.scenario import Scenario, load_scenario


def add_explain_command(commands: Any) -> argparse.ArgumentParser:
    """Adds `explain` to the subcommands of a parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "explain",
        help="tell why a climb or a move is not possible",
        description="Tells what keeps a scenario from having a climb, and what little change would make one; or, of "
        "one move or stance, the first check that fails and by how much.",
    )
    parser.add_argument("scenario", help="scenario file, or the name of one that comes with climber, such as basic")
    parser.add_argument("--move", metavar="LIMB:FROM:TO", help="a move to explain, such as right_front:3:7")
    parser.add_argument(
        "--stance",
        metavar="HOLDS",
        help="where it starts, hold,hold,... in limb order or limb=hold,limb=hold,...; by default the start, or else "
        "the first stance from which the move can be asked about",
    )
    parser.add_argument("--robot", metavar="NAME", help="which robot of several; the first by default")
    parser.add_argument("--plan", action="store_true", help="ask the planner too: for the climb, and for each change")
    parser.add_argument(
        "--time-limit", type=float, metavar="S", default=SECONDS, help="for trying changes, and for each plan [s]"
    )
    parser.set_defaults(run=_explain)
    return parser


def _explain(options: argparse.Namespace) -> int:
    scenario = load_scenario(options.scenario)
    index = _robot_index(scenario, options.robot)
    if not 0.0 < options.time_limit < float("inf"):
        raise scenario.error("--time-limit", options.time_limit, "a number of seconds, greater than 0")
    told: MoveExplanation | Explanation
    if options.move is not None or options.stance is not None:
        told = explain_move(scenario, MoveQuestion.parse(scenario, options.move, options.stance), index)
    elif options.plan:
        told = ask(scenario, index, options.time_limit)
    else:
        told = explain_climb(scenario, index, seconds=options.time_limit)
    if options.json:
        print(json.dumps({"scenario": scenario.name, **told.to_dict()}))
        return 0
    console = Console(highlight=False, soft_wrap=True)
    console.print(f"[bold]{scenario.name}[/bold]")
    for sentence in told.sentences:
        console.print(sentence, markup=False)
    return 0


def _robot_index(scenario: Scenario, name: str | None) -> int:
    names = [robot.name for robot in scenario.robots]
    if name is not None and name not in names:
        raise scenario.error("--robot", name, f"a robot of this scenario: {', '.join(names)}")
    return 0 if name is None else names.index(name)
