"""`climber simulate`: the command that climbs a plan in contact simulation."""

from __future__ import annotations

import argparse
import json
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
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
    parser.add_argument(
        "--push",
        type=float,
        nargs="+",
        default=[0.0],
        metavar="N",
        help="pushes at the centre of mass, in a direction drawn at random [N]",
    )
    parser.add_argument(
        "--center-error",
        type=float,
        nargs="+",
        default=[0.0],
        metavar="M",
        help="centres of mass are off by this, in a direction drawn at random [m]",
    )
    parser.add_argument(
        "--normal-error",
        type=float,
        nargs="+",
        default=[0.0],
        metavar="DEG",
        help="normals of holds are turned at random by up to this [deg]",
    )
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
    start = options.start_error or [START_ERROR if options.runs > 1 else 0.0]
    scales = {"--friction-scale": options.friction_scale, "--mass-scale": options.mass_scale}
    sizes = {
        "--hold-error": options.hold_error,
        "--start-error": start,
        "--push": options.push,
        "--center-error": options.center_error,
        "--normal-error": options.normal_error,
    }
    for name, values in scales.items():
        for value in values:
            check_scale(name, value)
    for name, values in {**sizes, "--slip-limit": [options.slip_limit]}.items():
        for value in values:
            check_size(name, value)
    counts = {
        "--runs": (options.runs, 1),
        "--seed": (options.seed, 0),
        "--processes": (options.processes, 1),
        "--hold": (options.hold, 0),
    }
    for name, (count, least) in counts.items():
        if count is not None:
            check_count(name, count, least)
    every = product(
        options.friction_scale,
        options.mass_scale,
        options.hold_error,
        start,
        options.push,
        options.center_error,
        np.radians(options.normal_error).tolist(),
    )
    return [
        Perturbation(
            friction_scale=friction,
            mass_scale=mass,
            hold_error=away,
            start_error=astray,
            push=push,
            seed=options.seed,
            normal_error=turn,
            center_error=center,
            hold=options.hold,
        )
        for friction, mass, away, astray, push, center, turn in every
    ]


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
    words = {
        f"friction x {perturbation.friction_scale:g}": perturbation.friction_scale != 1.0,
        f"mass x {perturbation.mass_scale:g}": perturbation.mass_scale != 1.0,
        f"{what} off {1e3 * perturbation.hold_error:g} mm": perturbation.hold_error > 0.0,
        f"start off {1e3 * perturbation.start_error:g} mm": perturbation.start_error > 0.0,
        f"push {perturbation.push:g} N": perturbation.push > 0.0,
        f"centre of mass off {1e3 * perturbation.center_error:g} mm": perturbation.center_error > 0.0,
        f"{what} turned {np.degrees(perturbation.normal_error):g} deg": perturbation.normal_error > 0.0,
    }
    return ", ".join(word for word, said in words.items() if said) or "none"


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
