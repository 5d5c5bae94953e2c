"""Climbing plans in contact simulation: falls, slip, tracking error and speed; and errors beside certified margins.

    python -m benchmarks.bench_simulate [--seeds 20] [--scenarios basic team] [--errors basic] [--cores 2] [--quick]

A seed makes a start that is off by up to a millimetre and, where plans are quickly made, another plan as well; those of
`ONCE` are planned with the scenario's own seed only, and climbed from as many starts. The second table is of one plan
under less friction, wrong masses and pushes, each so many times what the plan is certified to survive, with a quarter
of the seeds. The exit code is 1 if a robot falls or a holding foot slips by more than a millimetre in the first, or a
plan is not found.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import statistics
import sys
from collections.abc import Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

from benchmarks.bench_solve import SPACE
from benchmarks.rows import Row
from climber.exceptions import NoPlanFound
from climber.least_margins import least_by_kind, least_margins
from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.resources import packaged_scenarios
from climber.scenario import load_scenario
from climber.simulate import simulate
from climber.simulation import SLIP_LIMIT, Perturbation, Simulation

START_ERROR = 0.001  # [m]
# Five seconds to two minutes for a plan, and in space half a minute for a climb.
ONCE = ("avoid", "obstacle", "wider", "waypoint", "random_100", "team", *SPACE)
SHARES = (0.5, 0.9, 1.0, 1.2)  # of the certified margin
HEADS = ("scenario", "plans", "runs", "falls", "slip", "pelvis", "joint", "motion", "simulated", "real time")


def planned(name: str, more: int) -> Plan:
    """The plan of a scenario with its own seed, or with so many more."""
    scenario = load_scenario(name)
    return plan_climb(scenario, seed=scenario.seed + more)


def planned_and_climbed(name: str, seed: int) -> Simulation:
    """A scenario, planned with a seed and climbed from that seed's start."""
    return simulate(planned(name, seed), Perturbation(start_error=START_ERROR, seed=seed))


def begun(pool: Executor, name: str, seeds: int) -> list[Future[Simulation]] | Future[Plan]:
    """What there is to begin with for a scenario: its runs, or the one plan that they all need."""
    if name in ONCE:
        return pool.submit(planned, name, 0)
    return [pool.submit(planned_and_climbed, name, seed) for seed in range(seeds)]


def quarter(seeds: int) -> int:
    """A quarter of some seeds, one at least."""
    return max(1, seeds // 4)


def cells(name: str, plans: int, runs: Sequence[Simulation]) -> tuple[str, ...]:
    """A row of the table: worst values, lengths in mm; medians of what takes time."""
    robots = [robot for run in runs for robot in run.robots]
    return (
        name,
        str(plans),
        str(len(runs)),
        str(sum(run.fell for run in runs)),
        f"{1e3 * max(run.slip for run in runs):.2f} mm",
        f"{1e3 * max(robot.pelvis_error for robot in robots):.2f} mm",
        f"{max(robot.joint_error for robot in robots):.3f}",
        f"{statistics.median(run.planned for run in runs):.1f} s",
        f"{statistics.median(run.simulated for run in runs):.1f} s",
        f"x {statistics.median(run.real_time_factor for run in runs):.2f}",
    )


def errors(plan: Plan, share: float) -> tuple[tuple[str, Perturbation], ...]:
    """What is certified to be survived, times a share, and in words; masses off to the side that is worse."""
    certified = least_margins(plan)
    lighter = any(least.kind == "mass" and least.way == "too light" for least in least_by_kind(plan.robots[0]))
    off = share * certified["mass"] * (-1.0 if lighter else 1.0)
    drop, push = share * certified["friction"], share * certified["push"]
    return (
        (f"friction {1e2 * drop:.1f} % less", Perturbation.of("friction", min(drop, 1.0 - 1e-3))),
        (f"masses {1e2 * abs(off):.1f} % {'less' if off < 0.0 else 'more'}", Perturbation.of("mass", off)),
        (f"pushed with {push:.2f} N", Perturbation.of("push", push)),
    )


def compare(pool: Executor, name: str, seeds: int) -> None:
    """Prints how errors in proportion to the certified margins are survived."""
    plan = planned(name, 0)
    kinds = zip(*(errors(plan, share) for share in SHARES), strict=True)
    asked = [
        (share, words, [pool.submit(simulate, plan, replace(perturbation, seed=seed)) for seed in range(seeds)])
        for kind in kinds
        for share, (words, perturbation) in zip(SHARES, kind, strict=True)
    ]
    print(
        f"\n{name + ' with':24s} {'of the margin':>13s} {'certified':>9s} {'survived':>10s} {'falls':>5s} {'slip':>9s}"
    )
    within, survived = 0, 0
    for share, words, futures in asked:
        runs = [future.result() for future in futures]
        good = sum(run.ok for run in runs)
        slip = max((run.slip for run in runs if not run.fell), default=float("nan"))
        print(
            f"{words:24s} {100 * share:11.0f} % {'yes' if share <= 1.0 else 'no':>9s} "
            f"{f'{good} of {len(runs)}':>10s} {sum(run.fell for run in runs):5d} {1e3 * slip:6.2f} mm",
            flush=True,
        )
        within += len(runs) * (share <= 1.0)
        survived += good * (share <= 1.0)
    note = f"{name}; {within} climbs: three errors at {', '.join(f'{s:g}' for s in SHARES[:-1])} of the margin"
    what = "errors within the certified margins that are survived"
    Row(what, 100 * survived / within, "%", 100.0, "at least", note).show()


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
    slips, falls, factors, count, unplanned = [], 0, [], 0, 0
    with ProcessPoolExecutor(arguments.cores, get_context("spawn")) as pool:
        # Plans that take long are begun first and wanted last.
        names = sorted(names, key=lambda name: ONCE.index(name) if name in ONCE else -1)
        work = {name: begun(pool, name, seeds) for name in reversed(names)}
        print(" ".join(f"{head:>12s}" for head in HEADS), flush=True)
        for name in names:
            begin = work.pop(name)
            runs, plans = [], 1
            try:
                if isinstance(begin, Future):
                    plan = begin.result()
                    begin = [
                        pool.submit(simulate, plan, Perturbation(start_error=START_ERROR, seed=seed))
                        for seed in range(seeds)
                    ]
                else:
                    plans = len(begin)
                runs = [future.result() for future in begin]
            except NoPlanFound as error:
                print(f"{name}: {error}", flush=True)
                unplanned += 1
                continue
            print(" ".join(f"{cell:>12s}" for cell in cells(name, plans, runs)), flush=True)
            count += len(runs)
            slips.append(max(run.slip for run in runs))
            falls += sum(run.fell for run in runs)
            factors += [run.real_time_factor for run in runs]
        if not slips:
            sys.exit(1)
        note = f"{len(names)} scenarios, {count} climbs, starts off by up to {1e3 * START_ERROR:g} mm"
        Row("falls in contact simulation", float(falls), "falls", 0.0, note=note).show()
        Row("worst slip of a holding foot", 1e3 * max(slips), "mm", 1e3 * SLIP_LIMIT, note=note).show()
        Row("contact simulation", statistics.median(factors), "times real time", note="median of all runs").show()
        compare(pool, arguments.errors, quarter(seeds))
    sys.exit(unplanned > 0 or falls > 0 or max(slips) > SLIP_LIMIT)


if __name__ == "__main__":
    main()
