"""The command line: `climber solve | verify | margins | limits | simulate | draw | explain | table | robot | wall`.

Exit codes: 0 all is well, 1 the answer is no (no climb found, a check failed), 2 the input is at fault.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from climber.exceptions import ClimberError, NoPlanFound

OK, NO, BAD_INPUT = 0, 1, 2
OBJECTIVES = ("length", "time", "margin")


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
    from climber.simulate_command import add_simulate_command
    from climber.table_command import add_table_command
    from climber.wall_command import add_wall_command

    parser = argparse.ArgumentParser(prog="climber", description="Plans free climbs of multi-limbed robots.")
    parser.add_argument("--version", action="version", version=f"climber {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    solve = commands.add_parser("solve", help="plan the climb of a scenario")
    solve.add_argument("scenario", help="scenario file, or the name of one that comes with climber, such as basic")
    solve.add_argument("--out", type=Path, required=True, help="folder for plan.json and the pictures")
    solve.add_argument("--seed", type=_natural, help="instead of the scenario's")
    solve.add_argument("--time-limit", type=_positive, metavar="S", help="instead of the scenario's [s]")
    solve.add_argument("--objective", choices=OBJECTIVES, help="what is to be little, instead of the scenario's")
    solve.add_argument(
        "--improve",
        type=_seconds,
        metavar="S",
        help="time for improving the climb once there is one [s]; 0 by default. Ctrl-C ends it",
    )
    solve.add_argument(
        "--min-margin",
        type=_margin,
        action="append",
        default=[],
        metavar="KIND=SIZE",
        help="what every phase must survive: friction or mass (shares), push [N], center or place [m], normal [rad]",
    )
    solve.add_argument("--no-pictures", action="store_true", help="write plan.json only")
    solve.set_defaults(run=_solve)

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

    robot = commands.add_parser("robot", help="show what is read from a robot model")
    robot.add_argument("model", help="URDF or SDF file, or package://climber/...")
    robot.set_defaults(run=_robot)

    explain = add_explain_command(commands)
    wall = add_wall_command(commands)
    table = add_table_command(commands)

    for command in (solve, verify, margins, limits, simulate, draw, robot, explain, wall, table):
        command.add_argument("--json", action="store_true", help="print the result as JSON")
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
    from climber.limit_table import told_in_short
    from climber.margin_table import margin_table
    from climber.plan import plan_climb
    from climber.scenario import load_scenario
    from climber.words import moves_told

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
            written += _pictures(plan, options.out)
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
        return OK
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
    return OK


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


def _pictures(plan: Any, folder: Path) -> list[Path]:
    from climber.draw import draw_all

    return list(draw_all(plan, folder))


def _verify(options: argparse.Namespace) -> int:
    from climber.verify import verify

    verdict = verify(options.plan)
    if options.json:
        print(verdict.to_json())
    else:
        Console(highlight=False).print(verdict)
    return OK if verdict.ok else NO


def _draw(options: argparse.Namespace) -> int:
    from climber.plan_file import Plan

    written = _pictures(Plan.load(options.plan), options.out or options.plan.parent)
    if options.json:
        print(json.dumps({"files": [str(path) for path in written]}))
    else:
        Console(highlight=False, soft_wrap=True).print(f"wrote {', '.join(str(path) for path in written)}")
    return OK


def _finite(limits: Iterable[float]) -> list[float | None]:
    """Limits as JSON has them: null for none."""
    return [float(limit) if math.isfinite(limit) else None for limit in limits]


def _robot(options: argparse.Namespace) -> int:
    from climber.robot import Robot

    robot = Robot(options.model)
    names = robot.limb_names
    if options.json:
        facts = {
            "name": robot.name,
            "mass": robot.mass,
            "planar": robot.planar,
            "positions": list(robot.position_names),
            "limbs": [
                {
                    "name": limb.name,
                    "foot": limb.foot,
                    "reach": limb.reach,
                    "joints": list(limb.joints),
                    "lower": _finite(limb.lower),
                    "upper": _finite(limb.upper),
                    "velocity": _finite(limb.velocity),
                    "effort": _finite(limb.effort),
                }
                for limb in robot.limbs
            ],
            "symmetries": [[names[i] for i in symmetry] for symmetry in robot.symmetries],
        }
        print(json.dumps(facts))
        return OK
    console = Console(highlight=False)
    base = "moves in the wall plane" if robot.planar else "floats freely"
    console.print(f"[bold]{robot.name}[/bold]: {robot.mass:.3g} kg, {len(names)} limbs, its pelvis {base}")
    names_column = [Column(header, no_wrap=True) for header in ("limb", "joint")]
    table = Table(*names_column, "position [rad]", "velocity [rad/s]", "effort [N m]", "reach [m]")
    for limb in robot.limbs:
        if not limb.joints:
            table.add_row(limb.name, "none", "", "", "", f"{limb.reach:.3g}")
        for i, joint in enumerate(limb.joints):
            table.add_row(
                limb.name if i == 0 else "",
                joint,
                f"{limb.lower[i]:.3g} to {limb.upper[i]:.3g}",
                f"{limb.velocity[i]:.3g}",
                f"{limb.effort[i]:.3g}",
                f"{limb.reach:.3g}" if i == 0 else "",
            )
    console.print(table)
    for symmetry in robot.symmetries[1:]:
        console.print("symmetric: " + ", ".join(f"{a} → {names[b]}" for a, b in zip(names, symmetry, strict=True)))
    return OK


if __name__ == "__main__":
    sys.exit(main())
