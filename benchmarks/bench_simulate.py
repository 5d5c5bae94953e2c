"""Climbing plans in contact simulation: falls, slip, tracking error and speed; and errors beside certified margins.

    python -m benchmarks.bench_simulate [--seeds 20] [--scenarios basic team] [--errors basic] [--cores 2] [--quick]

A seed makes a start that is off by up to a millimetre and, where plans are quickly made, another plan as well. Those of
`ONCE` are planned with the scenario's own seed only and climbed from as many starts, the first time to the end and then
until the climb is the same as one before (`climber.simulate.simulate_starts`). The second table is of one plan
under every kind of error, each so many times what the whole climb is certified to survive: in the direction that is
worst, in the opposite one, and in random ones, a quarter as many as there are seeds. The exit code is 1 if a robot
falls or a holding foot slips by more than a millimetre in the first, or a plan is not found, or a climb not simulated
to its end.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import statistics
import sys
from collections.abc import Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing import get_context

from benchmarks.bench_margins import errors
from benchmarks.bench_solve import SPACE
from benchmarks.rows import Row
from climber.least_margins import WORDS
from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.plan_parts import MARGIN_KINDS
from climber.resources import packaged_scenarios
from climber.scenario import load_scenario
from climber.simulate import simulate_starts
from climber.simulation import SLIP_LIMIT, Perturbation, Simulation

START_ERROR = 0.001  # [m]
# Five seconds to two minutes for a plan, and in space half a minute for a climb.
ONCE = ("avoid", "obstacle", "wider", "waypoint", "random_100", "team", *SPACE)
SHARES = (0.5, 1.0, 1.5)  # of the certified margin
# Worst values of all climbs of a scenario; of the plans' durations the median.
HEADS = ("scenario", "plans", "climbs", "to the end", "falls", "slip", "pelvis off", "joint off", "plan", "climb")
HEADS += ("real time",)
WIDTHS = (15, 5, 6, 10, 5, 8, 10, 10, 7, 7, 9)


def planned(name: str, more: int) -> Plan:
    """The plan of a scenario with its own seed, or with so many more."""
    scenario = load_scenario(name)
    return plan_climb(scenario, seed=scenario.seed + more)


def climbed(name: str, more: int, starts: Sequence[int]) -> list[Simulation]:
    """A scenario, planned with its own seed or with so many more, and climbed from the starts of these seeds."""
    return simulate_starts(planned(name, more), [Perturbation(start_error=START_ERROR, seed=seed) for seed in starts])


def begun(pool: Executor, name: str, seeds: int) -> list[Future[list[Simulation]]]:
    """The climbs of a scenario, plan by plan."""
    if name in ONCE:
        return [pool.submit(climbed, name, 0, range(seeds))]
    return [pool.submit(climbed, name, seed, [seed]) for seed in range(seeds)]


def ended(name: str, works: Sequence[Future[list[Simulation]]]) -> list[Simulation]:
    """The climbs that came of some work; where none did, why is printed."""
    result = []
    for work in works:
        try:
            result += work.result()
        except Exception as error:  # whatever it is, the others are measured
            print(f"{name}: {type(error).__name__}: {error}", flush=True)
    return result


def line(cells: Sequence[str]) -> str:
    """A line of the table, the name at the left."""
    name, *rest = (f"{cell:>{width}s}" for cell, width in zip(cells, WIDTHS, strict=True))
    return "  ".join([f"{name.strip():{WIDTHS[0]}s}", *rest])


def tell(name: str, seeds: int, runs: Sequence[Simulation]) -> None:
    """Prints a line and a row of a scenario."""
    what = f"worst slip of a holding foot, {name}"
    if not runs:
        Row(what, None, "mm", 1e3 * SLIP_LIMIT, note="not simulated, see above").show()
        return
    robots = [robot for run in runs for robot in run.robots]
    plans, falls = 1 if name in ONCE else len(runs), sum(run.fell for run in runs)
    slip, pelvis = 1e3 * max(run.slip for run in runs), 1e3 * max(robot.pelvis_error for robot in robots)
    whole = [run for run in runs if run.simulated >= run.planned]
    pace = statistics.median(run.real_time_factor for run in whole or runs)
    cells = [name, str(plans), str(len(runs)), str(len(whole)), str(falls), f"{slip:.2f} mm", f"{pelvis:.2f} mm"]
    cells += [f"{max(robot.joint_error for robot in robots):.3f} rad"]
    cells += [f"{statistics.median(run.planned for run in runs):.1f} s"]
    cells += [f"{max(run.simulated for run in runs):.1f} s", f"x {pace:.2f}"]
    print(line(cells), flush=True)
    note = f"{falls} falls; {len(runs)} climbs of {plans} plan{'s' * (plans > 1)}, {len(whole)} of them to the end"
    note += f"; {seeds - len(runs)} climbs broken off, see above" * (len(runs) < seeds)
    note += f"; {pace:.2f} times real time"
    Row(what, slip, "mm", 1e3 * SLIP_LIMIT, note=note).show()


def compare(pool: Executor, name: str, seeds: int) -> None:
    """Prints how errors in proportion to the certified margins are survived."""
    plan = planned(name, 0)
    cases = [(least, share, one) for share in SHARES for least, one in errors(plan, share, seeds)]
    cases.sort(key=lambda case: MARGIN_KINDS.index(case[0].kind))  # as they are told
    asked = [(least, share, one, pool.submit(simulate_starts, plan, [one])) for least, share, one in cases]
    title = f"{name} with"
    print(f"\n{title:20s} {'margin':>10s} {'error':>10s} {'of it':>6s} {'survived':>9s} {'falls':>5s} {'slip':>8s}")
    within, survived = 0, 0
    for kind in MARGIN_KINDS:
        words = WORDS[kind]
        for share in SHARES:
            its = [case for case in asked if (case[0].kind, case[1]) == (kind, share)]
            if not its:
                continue
            runs = ended(f"{name}, {words.error}", [run for *_, run in its])
            least, _, one, _ = its[0]
            good, falls = sum(run.ok for run in runs), sum(run.fell for run in runs)
            slips = [1e3 * run.slip for run in runs if not run.fell]
            slip = f"{max(slips):.2f} mm" if slips else "-"
            size = words.size(one.errors[kind], 3)
            print(
                f"{words.error:20s} {words.size(least.value, 3):>10s} {size:>10s} {100 * share:4.0f} % "
                f"{f'{good} of {len(its)}':>9s} {falls:5d} {slip:>8s}",
                flush=True,
            )
            within += len(its) * (share <= 1.0)
            survived += good * (share <= 1.0)
    note = f"{name}; {within} climbs, errors of {' or '.join(f'{s:g}' for s in SHARES if s <= 1.0)} of the margin"
    Row("certified errors of a whole climb survived", 100 * survived / within, "%", 100.0, "at least", note).show()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    everything = [name for name in packaged_scenarios() if name != "random_1000"]
    parser.add_argument("--scenarios", nargs="*", default=everything, help="names of scenarios that come with climber")
    parser.add_argument("--errors", default="basic", metavar="SCENARIO", help="whose margins errors are compared with")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="basic and three_limbed with two seeds")
    arguments = parser.parse_args()
    names, seeds = arguments.scenarios, arguments.seeds
    if arguments.quick:
        names, seeds, arguments.errors = ["basic", "three_limbed"], 2, "three_limbed"
    slips, falls, lost = [], 0, 0
    with ProcessPoolExecutor(arguments.cores, get_context("spawn")) as pool:
        names = sorted(names, key=lambda name: ONCE.index(name) if name in ONCE else -1)
        works = {name: begun(pool, name, seeds) for name in names}
        print(line(HEADS), flush=True)
        for name in names:
            runs = ended(name, works.pop(name))
            tell(name, seeds, runs)
            lost += seeds - len(runs)
            slips += [run.slip for run in runs]
            falls += sum(run.fell for run in runs)
        if slips:
            note = f"{len(names)} scenarios, {len(slips)} climbs, starts off by up to {1e3 * START_ERROR:g} mm"
            Row("falls in contact simulation", float(falls), "falls", 0.0, note=note).show()
        compare(pool, arguments.errors, max(1, seeds // 4))
    sys.exit(lost > 0 or falls > 0 or max(slips, default=0.0) > SLIP_LIMIT)


if __name__ == "__main__":
    main()
