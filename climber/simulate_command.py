"""`climber simulate`: the command that climbs a plan in contact simulation."""

from __future__ import annotations

import argparse
import json
from itertools import product
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from climber.exceptions import ClimberError
from climber.plan_file import Plan
from climber.simulate import Survival, monte_carlo, simulate
from climber.simulation import SLIP_LIMIT, Perturbation, Simulation

START_ERROR = 0.001  # [m], if there are several runs and nothing else is asked for


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
    parser.add_argument(
        "--friction-scale", type=float, nargs="+", default=[1.0], metavar="F", help="friction of all holds, times this"
    )
    parser.add_argument(
        "--mass-scale", type=float, nargs="+", default=[1.0], metavar="F", help="mass of all bodies, times this"
    )
    parser.add_argument(
        "--hold-error",
        type=float,
        nargs="+",
        default=[0.0],
        metavar="M",
        help="holds are off at random by up to this [m]",
    )
    parser.add_argument(
        "--start-error",
        type=float,
        nargs="+",
        metavar="M",
        help="pelvises start off at random by up to this [m]; 0, or 0.001 with --runs",
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
        facts = {"ok": ok, "slip_limit": options.slip_limit, "runs": [_facts(run) for row in rows for run in row.runs]}
        print(json.dumps({**facts, "files": [str(path) for path in written]}))
        return 0 if ok else 1
    if len(rows) == len(rows[0].runs) == 1:
        _tell(console, rows[0].runs[0])
    else:
        _tell_all(console, rows)
    if written:
        console.print(f"wrote {written[0]}", markup=False)
    return 0 if ok else 1


def _perturbations(options: argparse.Namespace) -> list[Perturbation]:
    """Every combination of what is asked for, checked."""
    start = options.start_error or [START_ERROR if options.runs > 1 else 0.0]
    scales = {"--friction-scale": options.friction_scale, "--mass-scale": options.mass_scale}
    lengths = {"--hold-error": options.hold_error, "--start-error": start, "--slip-limit": [options.slip_limit]}
    for name, values in scales.items():
        for value in values:
            if not 0.0 < value < float("inf"):
                raise ClimberError(f"{name}: given {value:g}; allowed: a number greater than 0")
    for name, values in lengths.items():
        for value in values:
            if not 0.0 <= value < float("inf"):
                raise ClimberError(f"{name}: given {value:g}; allowed: a number of metres, 0 or greater")
    counts = {"--runs": (options.runs, 1), "--seed": (options.seed, 0), "--processes": (options.processes, 1)}
    for name, (count, least) in counts.items():
        if count is not None and count < least:
            raise ClimberError(f"{name}: given {count}; allowed: a whole number, {least} or greater")
    every = product(options.friction_scale, options.mass_scale, options.hold_error, start)
    return [Perturbation(*values, seed=options.seed) for values in every]


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
                "effort": robot.effort,
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


def _tell_all(console: Console, rows: list[Survival]) -> None:
    """Every combination for people."""
    table = Table("friction", "mass", "hold error", "start error", "survived", "falls", "worst slip", "pelvis error")
    for row in rows:
        it = row.perturbation
        upright = [robot.pelvis_error for run in row.runs if not run.fell for robot in run.robots]
        table.add_row(
            f"x {it.friction_scale:g}",
            f"x {it.mass_scale:g}",
            f"{1e3 * it.hold_error:g} mm",
            f"{1e3 * it.start_error:g} mm",
            f"{row.survived} of {len(row.runs)}",
            str(row.falls),
            f"{1e3 * row.slip:.2f} mm" if upright else "",
            f"{1e3 * max(upright):.2f} mm" if upright else "",
        )
    console.print(table)
    console.print(f"survived: no fall, and no holding foot slipped more than {1e3 * rows[0].runs[0].slip_limit:g} mm")
    fallen = [(row, run, robot) for row in rows for run in row.runs for robot in run.robots if robot.fell]
    if fallen:
        _, run, robot = fallen[0]
        console.print(f"first fall: seed {run.perturbation.seed}, {robot.name}: {robot.fell}", markup=False)
