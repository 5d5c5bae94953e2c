"""Climbing plans in contact simulation: falls, slip, tracking error and speed.

    python -m benchmarks.bench_simulate [--seeds 20] [--scenarios basic team] [--cores 2] [--quick]

Every scenario is planned with its own seed, and its plan is climbed once for each seed, from a start that is off by up
to a millimetre. The exit code is 1 if a robot falls or a holding foot slips by more than a millimetre.
"""

from __future__ import annotations

import argparse
import statistics
import sys

from benchmarks.rows import Row
from climber.plan import plan_climb
from climber.resources import packaged_scenarios
from climber.scenario import load_scenario
from climber.simulate import Survival, monte_carlo
from climber.simulation import SLIP_LIMIT, Perturbation

START_ERROR = 0.001  # [m]
HEADS = ("scenario", "runs", "falls", "slip", "pelvis", "joint", "motion", "simulated", "real time")


def climbed(name: str, seeds: int, cores: int) -> Survival:
    """A scenario's plan, climbed with so many seeds."""
    plan = plan_climb(load_scenario(name))
    (survival,) = monte_carlo(plan, [Perturbation(start_error=START_ERROR)], seeds, processes=cores)
    return survival


def cells(name: str, survival: Survival) -> tuple[str, ...]:
    """A row of the table: worst values, lengths in mm; medians of what takes time."""
    runs = survival.runs
    robots = [robot for run in runs for robot in run.robots]
    return (
        name,
        str(len(runs)),
        str(survival.falls),
        f"{1e3 * max(run.slip for run in runs):.2f} mm",
        f"{1e3 * max(robot.pelvis_error for robot in robots):.2f} mm",
        f"{max(robot.joint_error for robot in robots):.3f}",
        f"{runs[0].planned:.1f} s",
        f"{statistics.median(run.simulated for run in runs):.1f} s",
        f"x {statistics.median(run.real_time_factor for run in runs):.2f}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    everything = [name for name in packaged_scenarios() if name != "random_1000"]
    parser.add_argument("--scenarios", nargs="*", default=everything, help="names of scenarios that come with climber")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="basic and three_limbed with two seeds")
    arguments = parser.parse_args()
    names, seeds = arguments.scenarios, arguments.seeds
    if arguments.quick:
        names, seeds = ["basic", "three_limbed"], 2
    print(" ".join(f"{head:>12s}" for head in HEADS), flush=True)
    slips, falls, factors = [], 0, []
    for name in names:
        survival = climbed(name, seeds, arguments.cores)
        print(" ".join(f"{cell:>12s}" for cell in cells(name, survival)), flush=True)
        slips.append(max(run.slip for run in survival.runs))
        falls += survival.falls
        factors += [run.real_time_factor for run in survival.runs]
    note = f"{len(names)} scenarios, {seeds} seeds each, starts off by up to {1e3 * START_ERROR:g} mm"
    Row("falls in contact simulation", float(falls), "falls", 0.0, note=note).show()
    Row("worst slip of a holding foot", 1e3 * max(slips), "mm", 1e3 * SLIP_LIMIT, note=note).show()
    Row("contact simulation", statistics.median(factors), "times real time", note="median of all runs").show()
    sys.exit(falls > 0 or max(slips) > SLIP_LIMIT)


if __name__ == "__main__":
    main()
