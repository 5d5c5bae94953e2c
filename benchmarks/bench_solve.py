"""The command line, from import to files written: how long a climb takes, and what kind of climb comes out.

    python -m benchmarks.bench_solve [--scenarios basic higher random_1000] [--seeds 0 1 2 3 4] [--quick]

Every run is a process of its own, `climber solve` and then `climber verify`, timed from outside. Lengths are Euclidean
over the robot's eleven positions, metres and radians alike, as in table 5.1 of Gönen 2021. Its walls are others than
ours, with as many holds and nearly the same counts; its times are those of motion planning alone, its optimal lengths
those of RRT*, which RRT-Connect's were twice. The exit code is 1 if a climb is not found or does not verify.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.rows import Row
from climber.curve import joint_length
from climber.plan_file import Plan

ROOT = Path(__file__).parents[1]
TARGET_SECONDS = {"basic": 10.0, "higher": 20.0, "lemur_vertical": 60.0}
SPACE = ("lemur_slab", "lemur_vertical", "lemur_overhang", "lemur_corner", "lemur_chimney", "board")


@dataclass(frozen=True)
class Published:
    """What Gönen 2021, table 5.1, has for the like scenario.

    Attributes:
        seconds: Mean time of motion planning [s].
        makespan: Moves.
        optimal: Least length of the motion found.
        length: Mean length of RRT-Connect's.
    """

    seconds: float
    makespan: int
    optimal: float
    length: float


THESIS = {"basic": Published(141.5, 12, 32.205, 65.387), "higher": Published(613.0, 9, 30.330, 55.507)}


@dataclass(frozen=True)
class Run:
    """One climb.

    Attributes:
        seconds: Wall time of `climber solve` [s].
        busy: Its processor time [s]; far less than the wall time if the machine has more to do than this.
        verify_seconds: Wall time of `climber verify` [s]; nan if nothing was found.
        complaint: What went wrong, empty if nothing did.
        moves: Moves of all robots.
        cuts: Moves given up on the way.
        length: Length of the motion in joint space.
        timings: Seconds by stage, as the plan records them.
    """

    seconds: float
    busy: float
    verify_seconds: float
    complaint: str
    moves: int = 0
    cuts: int = 0
    length: float = 0.0
    timings: tuple[tuple[str, float], ...] = ()


def path_length(plan: Plan) -> float:
    """Length of all robots' motions."""
    return sum(joint_length(phase.q) for robot in plan.robots for phase in robot.phases)


def processor_time() -> float:
    """Processor time of all processes that this one has run so far [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def climber(*arguments: str) -> tuple[float, float, str]:
    """Runs a command of climber: its wall time and processor time [s], and what it complained of."""
    began, busy_before = time.perf_counter(), processor_time()
    done = subprocess.run(
        [sys.executable, "-m", "climber.cli", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    seconds, busy = time.perf_counter() - began, processor_time() - busy_before
    if done.returncode == 0:
        return seconds, busy, ""
    if arguments[0] == "verify" and done.stdout:
        failed = (check for check in json.loads(done.stdout)["checks"] if not check["ok"])
        return seconds, busy, "; ".join(f"{check['name']} {check['worst']:.3g}" for check in failed)
    if arguments[0] == "solve" and done.stdout:
        return seconds, busy, json.loads(done.stdout)["reason"]
    return (
        seconds,
        busy,
        (done.stderr.strip() or done.stdout.strip()).splitlines()[-1] or f"exit code {done.returncode}",
    )


def run(scenario: Path, seed: int, *options: str) -> Run:
    """Solves a scenario and verifies the plan."""
    with tempfile.TemporaryDirectory() as folder:
        solve = ("solve", str(scenario), "--seed", str(seed), "--out", folder, "--json", *options)
        seconds, busy, complaint = climber(*solve)
        if complaint:
            return Run(seconds, busy, float("nan"), f"solve: {complaint}")
        file = Path(folder) / "plan.json"
        verify_seconds, _, complaint = climber("verify", str(file), "--json")
        complaint = complaint and f"verify: {complaint}"
        plan = Plan.load(file)
    return Run(
        seconds=seconds,
        busy=busy,
        verify_seconds=verify_seconds,
        complaint=complaint,
        moves=sum(robot.moves for robot in plan.robots),
        cuts=sum(len(robot.cuts) for robot in plan.robots),
        length=path_length(plan),
        timings=tuple(plan.timings.items()),
    )


def report(name: str, runs: Sequence[Run]) -> None:
    """Prints the rows of a scenario."""
    failed = [run for run in runs if run.complaint]
    thesis, target = THESIS.get(name), TARGET_SECONDS.get(name)
    what = f"climber solve scenarios/{name}.yaml, import to files written"
    if failed:
        Row(what, None, "s", target, note=f"{len(failed)} of {len(runs)} failed: {failed[0].complaint}").show()
        return
    middle = statistics.median(run.seconds for run in runs)
    busy = statistics.median(run.busy for run in runs)
    worst = max(run.seconds for run in runs)
    told = f"worst {worst:.1f} s, {busy:.1f} s of processor; {len(runs)} seeds solved and verified"
    beside = f"; thesis {thesis.seconds:.0f} s for the motion alone" if thesis else ""
    Row(what, middle, "s", target, note=told + beside).show()
    moves = sorted({run.moves for run in runs})
    told = f"{' or '.join(map(str, moves))} moves, {max(run.cuts for run in runs)} cut on the way at most"
    if thesis:
        told += f"; thesis {thesis.optimal:.1f} at best, {thesis.length:.1f} in the mean, {thesis.makespan} moves"
    Row(f"  length of the motion, {name}", statistics.median(run.length for run in runs), "rad", note=told).show()
    Row(f"  climber verify of it, {name}", statistics.median(run.verify_seconds for run in runs), "s").show()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    everything = [name for name in ("basic", "higher", "random_1000", *SPACE) if scenario_file(name).exists()]
    parser.add_argument("--scenarios", nargs="*", default=everything, help="names of files in scenarios/")
    parser.add_argument("--seeds", nargs="*", type=int, default=[0, 1, 2, 3, 4])
    parser.add_argument("--quick", action="store_true", help="basic and higher with one seed")
    arguments = parser.parse_args()
    names, seeds = arguments.scenarios, arguments.seeds
    if arguments.quick:
        names, seeds = [name for name in names if name in THESIS], seeds[:1]
    good = True
    for name in names:
        print(f"{name}:", *(f"{head:>8s}" for head in ("seed", "solve", "busy", "verify", "moves", "cuts", "length")))
        runs = []
        # One seed is enough of what has no target here.
        for seed in seeds if name in THESIS else seeds[:1]:
            runs.append(run(scenario_file(name), seed))
            last = runs[-1]
            columns = [f"{last.seconds:6.2f} s", f"{last.busy:6.2f} s", f"{last.verify_seconds:6.2f} s"]
            columns = [str(seed), *columns, str(last.moves), str(last.cuts), f"{last.length:.2f}"]
            told = last.complaint or ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in last.timings)
            print(" " * len(name) + " ", *(f"{column:>8s}" for column in columns), f" {told}", flush=True)
            good &= not last.complaint
        report(name, runs)
    sys.exit(not good)


def scenario_file(name: str) -> Path:
    return ROOT / "scenarios" / f"{name}.yaml"


if __name__ == "__main__":
    main()
