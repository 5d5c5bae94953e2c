"""`climber solve`: the command that plans a climb."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

from rich.console import Console

from climber.limit_table import told_in_short
from climber.margin_table import margin_table
from climber.plan import plan_climb
from climber.plan_parts import OBJECTIVE_KINDS
from climber.scenario import load_scenario
from climber.words import moves_told


def add_solve_command(commands: Any) -> argparse.ArgumentParser:
    """Adds `solve` to the subcommands of a parser."""
    parser: argparse.ArgumentParser = commands.add_parser("solve", help="plan the climb of a scenario")
    parser.add_argument("scenario", help="scenario file, or the name of one that comes with climber, such as basic")
    parser.add_argument("--out", type=Path, required=True, help="folder for plan.json and the pictures")
    parser.add_argument("--seed", type=_natural, help="instead of the scenario's")
    parser.add_argument("--time-limit", type=_positive, metavar="S", help="instead of the scenario's [s]")
    parser.add_argument("--objective", choices=OBJECTIVE_KINDS, help="what is to be little, instead of the scenario's")
    parser.add_argument(
        "--improve",
        type=_seconds,
        metavar="S",
        help="time for improving the climb once there is one [s]; 0 by default. Ctrl-C ends it",
    )
    parser.add_argument(
        "--min-margin",
        type=_margin,
        action="append",
        default=[],
        metavar="KIND=SIZE",
        help="what every phase must survive: friction or mass (shares), push [N], center or place [m], normal [rad]",
    )
    parser.add_argument("--no-pictures", action="store_true", help="write plan.json only")
    parser.set_defaults(run=_solve)
    return parser


def _natural(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text}: a whole number, 0 or greater")
    return int(text)


def _margin(text: str) -> tuple[str, float]:
    kind, _, size = text.partition("=")
    try:
        return kind, float(size)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: KIND=SIZE is expected, such as friction=0.1") from None


def _positive(text: str) -> float:
    if not 0.0 < _number(text) < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: a number of seconds, greater than 0")
    return float(text)


def _seconds(text: str) -> float:
    if not 0.0 <= _number(text) < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: a number of seconds, 0 or greater")
    return float(text)


def _number(text: str) -> float:
    """The number that a text stands for, NaN if it stands for none."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _solve(options: argparse.Namespace) -> int:
    began = time.perf_counter()
    # What a program reads goes to stdout alone; what a person watches then goes to stderr.
    console = Console(stderr=options.json, highlight=False, soft_wrap=True)
    scenario = load_scenario(options.scenario)
    with console.status(f"planning {scenario.name} ...") as status:

        def report(message: str) -> None:
            console.print(f"  {message}", style="dim", markup=False)
            status.update(f"planning {scenario.name} ...")

        plan = plan_climb(
            scenario,
            seed=options.seed,
            time_limit=options.time_limit,
            objective=options.objective,
            improve=options.improve,
            min_margin=dict(options.min_margin),
            report=report,
        )
        written = [options.out / "plan.json"]
        plan.save(written[0])
        if not options.no_pictures:
            status.update("drawing ...")
            from climber.draw import draw_all

            written += draw_all(plan, options.out)
    robots = plan.robots
    moves, cost = sum(robot.moves for robot in robots), sum(robot.cost for robot in robots)
    duration, cuts = max(robot.duration for robot in robots), sum(len(robot.cuts) for robot in robots)
    seconds = time.perf_counter() - began
    if options.json:
        facts: dict[str, Any] = {
            "ok": True,
            "moves": moves,
            "cost": cost,
            "duration": round(duration, 3),
            "cuts": cuts,
            "proofs": robots[0].proofs,
            "counts": robots[0].counts,
            "robots": [
                {
                    "name": robot.name,
                    "moves": robot.moves,
                    "cost": robot.cost,
                    "objective": None if robot.objective is None else vars(robot.objective),
                    "record": robot.record,
                }
                for robot in robots
            ],
            "timings": plan.timings,
            "seconds": round(seconds, 2),
            "files": [str(path) for path in written],
        }
        print(json.dumps(facts))
        return 0
    console.print(
        f"[bold]{scenario.name}[/bold]: {moves} moves of cost {cost:g}, {duration:.1f} s of motion, "
        f"{cuts} moves cut, found in {plan.timings['total']:.1f} s"
    )
    for robot in robots:
        if len(robots) > 1:
            console.print(f"  {robot.name}: {robot.moves} moves of cost {robot.cost:g}", markup=False)
        if robot.objective is not None:
            (_, first), (_, last) = robot.record[0], robot.record[-1]
            better = f", improved from {_size(first)}" if len(robot.record) > 1 else ""
            console.print(f"  {_worded(robot.objective.kind, last)}{better}", markup=False)
        if limits := told_in_short(robot):
            console.print(f"  kept from being faster by {limits}", markup=False)
        swings = [phase.limb for phase in robot.phases if phase.limb is not None]
        for number, move in enumerate(moves_told(robot.stances, swings), start=1):
            console.print(f"  {number:3d}. {move}", style="dim", markup=False)
        console.print(margin_table(robot, console.width))
    console.print(f"wrote {', '.join(str(path) for path in written)}")
    return 0


def _size(value: float) -> str:
    """The value of an objective; that of `margin` is less than zero, so that less is better."""
    return f"{abs(value):.4g}"


def _worded(kind: str, value: float) -> str:
    """An objective and its value for people."""
    units = {
        "length": "m and rad, in joint space",
        "time": "s",
        "margin": "of a limb's reach to where the support ends, or of a motor's torque left",
    }
    return f"{kind} {_size(value)} {units[kind]}"
