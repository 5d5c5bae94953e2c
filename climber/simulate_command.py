"""`climber simulate`: the command that climbs a plan in contact simulation."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from climber.least_margins import WORDS, least_margins
from climber.plan_file import Plan
from climber.simulate import Survival, certified, monte_carlo, simulate
from climber.simulation import (
    SLIP_LIMIT,
    Perturbation,
    Simulation,
    check_count,
    check_scale,
    check_size,
)

START_ERROR = 0.001  # [m], if there are several runs and nothing else is asked for


@dataclass(frozen=True)
class Error:
    """What may not be as planned, and the option for it.

    Attributes:
        field: Of `Perturbation`.
        metavar: Of the option.
        help: Of the option.
        words: The error in words, with {} for its size and {what} for the holds.
        none: Its value where all is as planned; 1 for factors.
        unit: The option's, in SI units.
        shown: How many of the units in `words` are one SI unit.
    """

    field: str
    metavar: str
    help: str
    words: str
    none: float = 0.0
    unit: float = 1.0
    shown: float = 1.0

    @property
    def option(self) -> str:
        """What the option is called."""
        return f"--{self.field.replace('_', '-')}"


ERRORS = (
    Error("friction_scale", "F", "friction of all holds, times this", "friction x {:g}", none=1.0),
    Error("mass_scale", "F", "mass of all bodies, times this", "mass x {:g}", none=1.0),
    Error("hold_error", "M", "holds are off at random by up to this [m]", "{what} off {:g} mm", shown=1e3),
    Error(
        "start_error",
        "M",
        "pelvises start off at random by up to this [m]; 0, or 0.001 with --runs",
        "start off {:g} mm",
        shown=1e3,
    ),
    Error("push", "N", "pushes at the centre of mass, in a direction drawn at random [N]", "push {:g} N"),
    Error(
        "center_error",
        "M",
        "centres of mass are off by this, in a direction drawn at random [m]",
        "centre of mass off {:g} mm",
        shown=1e3,
    ),
    Error(
        "normal_error",
        "DEG",
        "normals of holds are turned at random by up to this [deg]",
        "{what} turned {:g} deg",
        unit=math.radians(1.0),
        shown=math.degrees(1.0),
    ),
)


def add_simulate_command(commands: Any) -> argparse.ArgumentParser:
    """Adds `simulate` to the subcommands of a parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "simulate",
        help="climb a plan in contact simulation",
        description="Climbs a plan in contact simulation, and tells whether the robot falls, how far its feet slip and "
        "how well it keeps to the plan. With --runs, or several values of an option, it climbs under every combination "
        "and tells how often it comes through. The exit code is 1 if a robot falls, or slips beyond the limit, in any "
        "run.",
    )
    parser.add_argument("plan", type=Path)
    parser.add_argument("--out", type=Path, help="folder for simulation.html, which replays the first run")
    for error in ERRORS:
        parser.add_argument(error.option, type=float, nargs="+", metavar=error.metavar, help=error.help)
    parser.add_argument(
        "--hold", type=int, metavar="K", help="only this hold is off or turned, by as much as the options say"
    )
    parser.add_argument("--slip-limit", type=float, default=SLIP_LIMIT, metavar="M", help="for a holding foot [m]")
    parser.add_argument("--runs", type=int, default=1, metavar="N", help="seeds to try each combination with")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="the first of them")
    parser.add_argument("--processes", type=int, metavar="N", help="that share the runs; by default one a processor")
    parser.set_defaults(run=_simulate)
    return parser


def _simulate(options: argparse.Namespace) -> int:
    perturbations = _perturbations(options)
    plan = Plan.load(options.plan)
    console = Console(stderr=options.json, highlight=False, soft_wrap=True)
    with console.status("simulating ..."):
        if len(perturbations) == 1 and options.runs == 1:
            rows = [Survival(perturbations[0], (simulate(plan, perturbations[0], options.slip_limit),))]
        else:
            rows = monte_carlo(plan, perturbations, options.runs, options.slip_limit, options.processes)
        written = [] if options.out is None else [_page(plan, rows[0].runs[0], options.out)]
    ok = all(run.ok for row in rows for run in row.runs)
    if options.json:
        facts = {
            "ok": ok,
            "slip_limit": options.slip_limit,
            "margins": least_margins(plan),
            "runs": [_facts(run) for row in rows for run in row.runs],
            "files": [str(path) for path in written],
        }
        print(json.dumps(facts))
        return 0 if ok else 1
    if len(rows) == len(rows[0].runs) == 1:
        _tell(console, rows[0].runs[0])
    else:
        _tell_all(console, plan, rows)
    if written:
        console.print(f"wrote {written[0]}", markup=False)
    return 0 if ok else 1


def _perturbations(options: argparse.Namespace) -> list[Perturbation]:
    """Every combination of what is asked for, checked."""
    asked: list[list[float]] = []
    for error in ERRORS:
        none = START_ERROR if error.field == "start_error" and options.runs > 1 else error.none
        asked.append(getattr(options, error.field) or [none])
        for value in asked[-1]:
            (check_scale if error.none else check_size)(error.option, value)
    check_size("--slip-limit", options.slip_limit)
    counts = {
        "--runs": (options.runs, 1),
        "--seed": (options.seed, 0),
        "--processes": (options.processes, 1),
        "--hold": (options.hold, 0),
    }
    for name, (count, least) in counts.items():
        if count is not None:
            check_count(name, count, least)
    worlds = (
        {error.field: error.unit * value for error, value in zip(ERRORS, values, strict=True)}
        for values in product(*asked)
    )
    return [Perturbation(**world, seed=options.seed, hold=options.hold) for world in worlds]  # type: ignore[arg-type]


def _page(plan: Plan, run: Simulation, folder: Path) -> Path:
    from climber.simulation_page import draw_recording

    path = folder / "simulation.html"
    draw_recording(plan, run, path)
    return path


def _facts(run: Simulation) -> dict[str, Any]:
    """A run for programs: SI units."""
    return {
        "ok": run.ok,
        "fell": run.fell,
        "slip": run.slip,
        "perturbation": vars(run.perturbation),
        "planned": run.planned,
        "simulated": run.simulated,
        "real_time_factor": round(run.real_time_factor, 3),
        "robots": [
            {
                "name": robot.name,
                "fell": robot.fell,
                "slip": robot.slip,
                "slipped": robot.slipped,
                "pelvis_error": robot.pelvis_error,
                "joint_error": robot.joint_error,
                "torque": robot.torque,
                "effort": {name: limit if limit < float("inf") else None for name, limit in robot.effort.items()},
            }
            for robot in run.robots
        ],
    }


def _tell(console: Console, run: Simulation) -> None:
    """One run for people."""
    for robot in run.robots:
        outcome = f"[red]fell[/red]: {robot.fell}" if robot.fell else "did not fall"
        console.print(f"[bold]{robot.name}[/bold] {outcome}")
        limit = f"the limit is {1e3 * run.slip_limit:g} mm"
        console.print(f"  worst slip of a holding foot {1e3 * robot.slip:.2f} mm: {robot.slipped or 'none'}; {limit}")
        console.print(
            f"  worst tracking error: pelvis {1e3 * robot.pelvis_error:.2f} mm, a free limb's joint "
            f"{robot.joint_error:.4f} rad"
        )
        joint = max(robot.torque, key=lambda name: robot.torque[name] / (robot.effort[name] or float("inf")))
        console.print(
            f"  greatest torques: {max(robot.torque.values()):.2f} N m; nearest to its limit {joint}, "
            f"{robot.torque[joint]:.2f} of {robot.effort[joint]:.2f} N m"
        )
    console.print(
        f"{run.simulated:.2f} s for a plan of {run.planned:.2f} s, simulated in {run.seconds:.1f} s: "
        f"{run.real_time_factor:.2f} times real time"
    )


def _worded(perturbation: Perturbation) -> str:
    """What is not as planned."""
    what = "holds" if perturbation.hold is None else f"hold {perturbation.hold}"
    sizes = [(error, getattr(perturbation, error.field)) for error in ERRORS]
    words = [error.words.format(error.shown * size, what=what) for error, size in sizes if size != error.none]
    return ", ".join(words) or "none"


def _tell_all(console: Console, plan: Plan, rows: list[Survival]) -> None:
    """Every combination for people."""
    table = Table("perturbation", "certified", "survived", "falls", "worst slip", "pelvis off")
    for row in rows:
        upright = [robot.pelvis_error for run in row.runs if not run.fell for robot in run.robots]
        table.add_row(
            _worded(row.perturbation),
            {True: "yes", False: "no", None: ""}[certified(plan, row.perturbation)],
            f"{row.survived} of {len(row.runs)}",
            str(row.falls),
            f"{1e3 * row.slip:.2f} mm" if upright else "",
            f"{1e3 * max(upright):.2f} mm" if upright else "",
        )
    console.print(table)
    console.print(f"survived: no fall, and no holding foot slipped more than {1e3 * rows[0].runs[0].slip_limit:g} mm")
    margins = least_margins(plan)
    told = [WORDS[kind].phrase.format(WORDS[kind].size(value, 2)) for kind, value in margins.items()]
    if told:
        console.print(f"certified by the plan, one error at a time: {', '.join(told)}")
    fallen = [(run, robot) for row in rows for run in row.runs for robot in run.robots if robot.fell]
    if fallen:
        run, robot = fallen[0]
        console.print(f"first fall: seed {run.perturbation.seed}, {robot.name}: {robot.fell}", markup=False)
