"""Margins against contact simulation: stretches of climbs under errors as great as their plans certify.

    python -m benchmarks.bench_margins [--scenarios basic three_limbed] [--share 1] [--phases 3] [--seeds 2] [--cores 2]

Every so many successive phases of a plan are climbed by themselves, with errors of each kind as great as the least of
the margins of just these phases: in the direction that is worst, in the opposite one, and in random ones, as many as
there are seeds. The exit code is 1 if a robot falls; that a holding foot slips by more than a millimetre is told.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

from benchmarks.rows import Row
from climber.least_margins import WORDS, LeastMargin, least_by_kind
from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.plan_parts import MARGIN_KINDS
from climber.scenario import load_scenario
from climber.simulate import simulate
from climber.simulation import Perturbation, Simulation

NEARLY_ALL = 0.99  # of friction or mass may be missing
PLANAR = ("basic", "higher", "three_limbed", "avoid", "double_link")


def planned(name: str) -> Plan:
    """The plan of a scenario."""
    return plan_climb(load_scenario(name))


def stretches(plan: Plan, length: int) -> Iterator[tuple[int, Plan]]:
    """The first phase, and the plan, of every `length` successive phases; the last of one is the first of the next."""
    (robot,) = plan.robots
    starts = [*range(0, max(len(robot.phases) - length, 0), max(length - 1, 1)), max(len(robot.phases) - length, 0)]
    for first in starts:
        yield first, replace(plan, robots=(replace(robot, phases=robot.phases[first : first + length]),))


def errors(plan: Plan, share: float, seeds: int) -> Iterator[tuple[LeastMargin, Perturbation]]:
    """The errors that a plan is certified to survive, times a share."""
    (robot,) = plan.robots
    for least in least_by_kind(robot):
        x, y, z = least.direction or (1.0, 0.0, 0.0)
        size = share * least.value
        if least.kind in ("friction", "mass"):
            signs = (1.0,) if least.kind == "friction" else (1.0, -1.0)
            some = [Perturbation.of(least.kind, sign * min(size, NEARLY_ALL)) for sign in signs]
        else:
            holds: list[int | None] = [None]
            if least.kind == "place":
                holds = [contact.hold for contact in robot.phases[least.phase].contacts if contact.limb == least.limb]
            ways: tuple[tuple[float, float, float], ...] = ((x, y, z), (-x, -y, -z))
            if least.kind == "normal":  # turned about the axis of the plane, where robots climb in one
                in_space = any(name.endswith("base_z") for name in robot.positions)
                ways = () if in_space else ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0))
            some = [Perturbation.of(least.kind, size, way, hold=hold) for hold in holds for way in ways]
            some += [Perturbation.of(least.kind, size, None, seed, hold) for hold in holds for seed in range(seeds)]
        yield from ((least, one) for one in some)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="*", default=PLANAR, help="names of scenarios of a single robot")
    parser.add_argument("--share", type=float, default=1.0, help="of the certified margins")
    parser.add_argument("--phases", type=int, default=3, metavar="N", help="of a stretch")
    parser.add_argument("--seeds", type=int, default=2, help="of directions that are drawn at random")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="three_limbed with one seed")
    arguments = parser.parse_args()
    names, seeds = (("three_limbed",), 1) if arguments.quick else (arguments.scenarios, arguments.seeds)
    told: dict[str, list[tuple[float, Simulation]]] = {kind: [] for kind in MARGIN_KINDS}
    with ProcessPoolExecutor(arguments.cores, get_context("spawn")) as pool:
        plans = [(name, pool.submit(planned, name)) for name in names]
        work = [
            (name, first, least, one, pool.submit(simulate, part, one))
            for name, future in plans
            for first, part in stretches(future.result(), arguments.phases)
            for least, one in errors(part, arguments.share, seeds)
        ]
        for name, first, least, one, running in work:
            run = running.result()
            told[least.kind].append((least.value, run))
            if not run.ok:
                (robot,) = run.robots
                error = f"{WORDS[least.kind].error} {WORDS[least.kind].size(arguments.share * least.value, 3)}"
                what = f"{1e3 * run.slip:.2f} mm {robot.fell or robot.slipped}"
                print(f"{name}, phases from {first} on, {error}: {what}; {one}", flush=True)
    print(f"{'error':20s} {'margins':>22s} {'survived':>12s} {'falls':>5s} {'slip':>9s}")
    for kind, runs in told.items():
        if not runs:
            continue
        sizes = " to ".join(WORDS[kind].size(value, 3) for value in (min(runs, key=_size)[0], max(runs, key=_size)[0]))
        good, falls = sum(run.ok for _, run in runs), sum(run.fell for _, run in runs)
        slip = max((run.slip for _, run in runs if not run.fell), default=float("nan"))
        print(f"{WORDS[kind].error:20s} {sizes:>22s} {good:5d} of {len(runs):3d} {falls:5d} {1e3 * slip:6.2f} mm")
    every = [run for runs in told.values() for _, run in runs]
    good = sum(run.ok for run in every)
    note = f"{', '.join(names)}: {len(every)} stretches of {arguments.phases} phases"
    Row("certified errors survived in simulation", 100.0 * good / len(every), "%", 100.0, "at least", note).show()
    sys.exit(any(run.fell for run in every))


def _size(run: tuple[float, Simulation]) -> float:
    return run[0]


if __name__ == "__main__":
    main()
