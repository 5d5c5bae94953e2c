"""Refining paths and postures on the legs of random climbs: what it costs, and which of two routes is better.

    python -m benchmarks.bench_refine [--legs 40] [--seed 0]

A random climb draws moves until their transition postures exist and joins these by RRT-Connect: legs of shifts and
swings, in plain charts and in rooted ones. "Near" climbs take the pair of postures that bends alike and is nearest, and
shorten the path, as the planner does; "far" climbs take any pair with at most one flip, and the path as it is found.
Run from the checkout. Times are of one processor, in ms, so that other work on the machine counts little.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.rows import Row
from climber.climb_search import ClimbSearch
from climber.curve import Curve, polyline_lengths, rounded, smooth
from climber.manifold import Body, Manifold
from climber.path import Leg, Search, find_path, flips
from climber.phases import Curves, Stretch
from climber.programs.kinematic_trajectory import KinematicTrajectoryProgram
from climber.programs.posture import PostureProgram, distance, improve_posture
from climber.programs.trajectory import NUM_CONTROL, ChartProgram, refine
from climber.robot import Robot
from climber.scenario import load_scenario
from climber.stance import Contact, Vector
from climber.transition import find_transition, support_of


@dataclass(frozen=True)
class Sample:
    """A leg, and the manifold it runs on."""

    manifold: Manifold
    leg: Leg


def manifold_of(body: Body, contacts: list[Contact]) -> Manifold | None:
    support = support_of(body, contacts)
    return None if support is None or support.depth < 0.0 else Manifold(body, contacts, support)


def climb(body: Body, start: list[int], rng: np.random.Generator, near: bool) -> Iterator[Sample]:
    """The legs of a climb of random moves that never ends."""
    stance, here = list(start), None
    search = Search(iterations=200) if near else Search(iterations=200, shortcuts=0)
    while True:
        limb, hold = int(rng.integers(len(start))), int(rng.integers(len(body.wall.holds)))
        others = [h for i, h in enumerate(stance) if i != limb]
        far = np.linalg.norm(body.wall.positions[others] - body.wall.positions[hold], axis=1)
        if hold in stance or (far > 2 * body.robot.reach.max()).any():
            continue
        before = [Contact(i, h) for i, h in enumerate(stance)]
        after = [replace(c, hold=hold) if c.limb == limb else c for c in before]
        shift, swing = manifold_of(body, before), manifold_of(body, [c for c in before if c.limb != limb])
        if shift is None or swing is None:
            continue
        leave = find_transition(body, before, limb, rng, rounds=(2_000, 8_000))
        arrive = find_transition(body, after, limb, rng, rounds=(2_000, 8_000)) if len(leave) else leave
        if not len(leave) or not len(arrive):
            continue
        holding = [c.limb for c in swing.contacts]
        apart = np.linalg.norm(leave.q[:, None] - arrive.q, axis=2)
        apart += 4.0 * (leave.branches[:, None, holding] != arrive.branches[:, holding]).sum(axis=2)
        i, j = np.unravel_index(apart.argmin() if near else rng.integers(apart.size), apart.shape)
        for manifold, a, b in ((shift, here, leave.q[i]), (swing, leave.q[i], arrive.q[j])):
            if a is not None and len(flips(manifold, a, b)) <= 1:
                legs = find_path(manifold, a, b, rng, search) or []
                yield from (Sample(manifold, leg) for leg in legs)
        stance[limb], here = hold, arrive.q[j]


def collect(name: str, count: int, seed: int, near: bool) -> list[Sample]:
    """The first legs of a random climb of a scenario, but for those that lead nowhere."""
    scenario = load_scenario(name)
    robot = Robot(scenario.model_path(0))
    start = [scenario.robots[0].start[limb] for limb in robot.limb_names]
    found: list[Sample] = []
    for sample in climb(Body(robot, scenario.build_wall()), start, np.random.default_rng(seed), near):
        if polyline_lengths(sample.leg.chart, sample.leg.u).sum() > 0.05:
            found.append(sample)
        if len(found) == count:
            return found
    return found


def bend(curve: Curve) -> float:
    """How much a curve turns and changes pace: the mean of |q''|, per length."""
    q = curve.q(np.linspace(0.0, 1.0, 257))
    return float(np.linalg.norm(np.diff(q, n=2, axis=0), axis=1).mean() * 256**2 / max(curve.length, 1e-9))


def row(name: str, times: list[float], curves: list[Curve | None], samples: list[Sample]) -> str:
    """One line of the table; a curve counts if it is feasible on the fine grid."""
    good = [i for i, (c, s) in enumerate(zip(curves, samples, strict=True)) if c and c.feasible(s.manifold)]
    ratio = [curves[i].length / polyline_lengths(samples[i].leg.chart, samples[i].leg.u).sum() for i in good]
    bends = [bend(curves[i]) for i in good]
    if not times:
        return f"  {name:38s} -"
    middle, high = np.percentile(times, [50, 90])
    return (
        f"  {name:38s} {middle:7.1f} {high:7.1f}   {len(good):3d} of {len(samples):3d}   "
        f"{np.mean(ratio):6.3f}   {np.median(bends):6.2f}"
    )


def compare(title: str, samples: list[Sample]) -> None:
    """Prints what every route makes of the legs."""
    routes: dict[str, tuple[list[float], list[Curve | None]]] = {}

    def record(name: str, began: float, curve: Curve | None) -> None:
        times, curves = routes.setdefault(name, ([], []))
        times.append(1e3 * (time.process_time() - began))
        curves.append(curve)

    for sample in samples:
        manifold, chart, u = sample.manifold, sample.leg.chart, sample.leg.u
        began = time.process_time()
        record("corners rounded only", began, smooth(manifold, chart, u))
        began = time.process_time()
        record("refine (rounded, chart program)", began, refine(manifold, chart, u))
        guess = rounded(chart, u, NUM_CONTROL)
        began = time.process_time()
        record("chart program alone", began, ChartProgram(manifold, chart).solve(guess).curve)
        ends = guess.q(np.array([0.0, 1.0]))
        for degree in (guess.degree, 3):
            began = time.process_time()
            program = KinematicTrajectoryProgram(manifold, chart, (ends[0], ends[1]), degree=degree)
            answer = program.solve(guess)
            name = "KinematicTrajectoryOptimization" + (", cubic" if degree == 3 else "")
            record(name, began, answer if isinstance(answer, Curve) else None)
    print(f"{title}: {len(samples)} legs")
    print(f"  {'':38s} {'median':>7s} {'p90':>7s}   {'feasible':>10s}   {'length':>6s}   {'bend':>6s}")
    for name, (times, curves) in routes.items():
        print(row(name, times, curves, samples))
    times, curves = routes["refine (rounded, chart program)"]
    feasible = sum(c is not None and c.feasible(s.manifold) for c, s in zip(curves, samples, strict=True))
    told = f"median; {feasible} of {len(samples)} feasible"
    Row(f"refining a leg: {title}", float(np.median(times)), "ms", note=told).show()


def postures(samples: list[Sample]) -> None:
    """Times pulling the first posture of each leg towards its last one."""
    building, improving, nearer = [], [], []
    for sample in samples:
        q: Vector = sample.leg.chart.expand(sample.leg.u[[0, -1]])[0]
        manifold, targets = sample.manifold, [(1.0, q[1])]
        began = time.process_time()
        PostureProgram(manifold.body, manifold, manifold.body.branches(q[0]))
        building.append(1e3 * (time.process_time() - began))
        began = time.process_time()
        better = improve_posture(manifold.body, manifold, q[0], targets)
        improving.append(1e3 * (time.process_time() - began))
        if better is not None:
            nearer.append(float(np.sqrt(distance(better[None], targets)[0] / distance(q[:1], targets)[0])))
    for name, times in (("build PostureProgram", building), ("improve_posture, building included", improving)):
        print(f"  {name:38s} {np.percentile(times, 50):7.1f} {np.percentile(times, 90):7.1f}")
    print(f"  {len(nearer)} of {len(samples)} came nearer, to {np.mean(nearer):.2f} of the distance in the mean")


def moves(name: str, seed: int) -> None:
    """Times refining the moves of a scenario's climb: the legs of shift and swing one by one, then both as a whole.

    A move counts what its own shift and swing take, and what refining them together with the shift that follows takes.
    """
    search = ClimbSearch(load_scenario(name), seed, 600.0, lambda message: None)
    planner, rng = search.planner.phases, np.random.default_rng(seed)
    joined = planner.joined
    given: list[tuple[Sequence[Stretch], Sequence[Curves]]] = []

    def noted(stretches: Sequence[Stretch], curves: Sequence[Curves]) -> tuple[Curves, ...]:
        given.append((stretches, curves))
        return joined(stretches, curves)

    planner.joined = noted  # type: ignore[method-assign]
    search.run()
    every, whole = given[-1]  # the climb that was planned at last
    times, before, after = [], 0.0, 0.0
    for first in range(0, len(every) - 2, 2):
        stretches, curves = every[first : first + 3], []
        spent = 0.0
        for stretch, own in zip(stretches, whole[first : first + 3], strict=True):
            a, b = own[0].q(np.zeros(1))[0], own[-1].q(np.ones(1))[0]
            legs = find_path(stretch.manifold, a, b, rng, Search(search.planner.budget.iterations)) or []
            began = time.process_time()
            refined = [refine(stretch.manifold, leg.chart, leg.u) for leg in legs]
            spent += (len(curves) < 2) * (time.process_time() - began)
            curves.append(tuple(curve for curve in refined if curve is not None))
        if not all(curves):
            continue
        began = time.process_time()
        together = joined(stretches, curves)
        times.append(1e3 * (spent + time.process_time() - began))
        before += sum(curve.length for own in curves for curve in own)
        after += sum(curve.length for own in together for curve in own)
    middle, high = np.percentile(times, [50, 90])
    note = f"median of {len(times)}; p90 {high:.0f} ms; {after / before:.4f} of the length one by one"
    Row(f"refining a move: {name}", float(middle), "ms", target=200.0, note=note).show()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--legs", type=int, default=40, help="legs of each kind and wall")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print("processor times [ms]; length against the polyline's; bend: mean |q''| over length, feasible curves only")
    for name in ("basic", "higher", "wider"):
        moves(name, arguments.seed)
    for name in ("basic", "higher"):
        for kind in ("near", "far"):
            samples = collect(name, arguments.legs, arguments.seed, kind == "near")
            for what, chosen in (
                ("straight", [s for s in samples if len(s.leg.u) == 2]),
                ("with corners", [s for s in samples if len(s.leg.u) > 2]),
            ):
                if chosen:
                    compare(f"{name}, {kind}, {what}", chosen)
            postures(samples)


if __name__ == "__main__":
    main()
