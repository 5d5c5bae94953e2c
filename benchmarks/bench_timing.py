"""Time scaling of the phases of whole climbs: what it costs, and how much faster the climbs get by it.

    python -m benchmarks.bench_timing [--scenarios basic higher waypoint wider] [--quick]

Every scenario is planned once, and every path that the planner had timed is timed again: by the conic program, with
samples, forces and torques, and by the law of fixed shape that went before it, slowed until it can be done. Times are
of one processor, so that other work on the machine counts little. The exit code is 1 if there is a phase that the
program cannot time.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import climber.phases
from benchmarks.rows import Row
from climber.manifold import Body
from climber.phase_motion import MotionBudget, by_fixed_law, timed
from climber.plan import plan_climb
from climber.scenario import load_scenario
from climber.stance import Contact
from climber.timing import PacedPath

STILL = 1e-3  # [s] at full joint rates: a path that leads nowhere is not worth measuring


@dataclass(frozen=True)
class Asked:
    """What `timed` was asked."""

    body: Body
    contacts: tuple[Contact, ...]
    paths: tuple[PacedPath, ...]
    budget: MotionBudget


def asked(name: str) -> list[Asked]:
    """The phases that are timed when a scenario is planned."""
    found: list[Asked] = []

    def noting(body: Body, contacts: Sequence[Contact], paced: Sequence[PacedPath], budget: MotionBudget) -> object:
        found.append(Asked(body, tuple(contacts), tuple(paced), budget))
        return timed(body, contacts, paced, budget)

    climber.phases.timed = noting  # type: ignore[assignment]
    try:
        plan_climb(load_scenario(name))
    finally:
        climber.phases.timed = timed
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=["basic", "higher", "waypoint", "wider"])
    parser.add_argument("--quick", action="store_true", help="basic only")
    arguments = parser.parse_args()
    print(f"{'scenario':14s} {'phases':>6s} {'median':>9s} {'worst':>9s} {'before':>8s} {'after':>8s} {'ratio':>6s}")
    every: list[float] = []
    ratios, failed = [], 0
    for name in ["basic"] if arguments.quick else arguments.scenarios:
        times, before, after = [], 0.0, 0.0
        for phase in asked(name):
            question = phase.body, phase.contacts, phase.paths, phase.budget
            began = time.process_time()
            now = timed(*question)
            spent = time.process_time() - began
            then = by_fixed_law(*question)
            if isinstance(now, str) or isinstance(then, str):
                continue
            failed += now[2].method != "conic"
            before, after = before + then[0].time[-1], after + now[0].time[-1]
            if sum(path.length for path in phase.paths) > STILL:
                times.append(1e3 * spent)
        every += times
        ratios.append(after / before)
        print(
            f"{name:14s} {len(times):6d} {np.median(times):6.1f} ms {max(times):6.1f} ms "
            f"{before:6.1f} s {after:6.1f} s {ratios[-1]:6.2f}"
        )
    told = f"median of {len(every)} phases, greatest {max(every):.0f} ms; processor time, samples and forces included"
    Row("time scaling of a phase", float(np.median(every)), "ms", 100.0, note=told).show()
    told = f"motion of the same paths, conic over fixed law; {min(ratios):.2f} to {max(ratios):.2f}"
    Row("duration of a climb after time scaling, against before", float(np.median(ratios)), "times", note=told).show()
    if failed:
        print(f"{failed} phases were not timed by the conic program")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
