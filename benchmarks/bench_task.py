"""The task planner against the thesis's encoding on the same graphs, and asked again after cuts.

    python -m benchmarks.bench_task [--walls W1 W2 W3] [--repeat 5] [--questions 100] [--skip-peers]

Both planners plan on the thesis's graph of poses and must agree on makespan and cost; they run in turn, and a ratio is
that of medians. Then the graph of ordered stances is asked again and again, as when motions fail: each time three moves
of the plan just given are cut. Run on one core, from the checkout. The exit code is 1 if the planners disagree.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers import thesis_asp
from benchmarks.rows import Row
from benchmarks.thesis import graph_of, wall_data
from climber.task import TaskPlan, TaskPlanner

Ints = NDArray[np.signedinteger[Any]]

TARGET_RATIO = {"W3": 100.0}  # times faster than the thesis's encoding
TARGET_AGAIN = 0.2  # [s]


@dataclass(frozen=True)
class Problem:
    """A directed graph with a start and goals, and the holds of its vertices."""

    holds: list[list[int]]
    tail: Ints
    head: Ints
    cost: Ints
    start: int
    goals: list[int]

    def planner(self, potentials: bool = True) -> TaskPlanner:
        return TaskPlanner(
            len(self.holds), self.tail, self.head, self.cost, self.start, self.goals, potentials=potentials
        )

    def peer(self, encoding: str) -> thesis_asp.PeerPlan:
        edges = [
            (self.holds[tail], self.holds[head], cost)
            for tail, head, cost in zip(self.tail.tolist(), self.head.tolist(), self.cost.tolist(), strict=True)
        ]
        # In a process of its own: a heap that once held five million rules slows down whoever comes next.
        with ProcessPoolExecutor(1, get_context("spawn")) as alone:
            start, goal = self.holds[self.start], self.holds[self.goals[0]]
            return alone.submit(thesis_asp.plan, edges, start, goal, encoding).result()


def problems(name: str) -> tuple[Problem, Problem]:
    """The graphs of a wall: of poses, as in the thesis, and of ordered stances."""
    data = wall_data(name)
    graph = graph_of(data)
    poses = graph.pose_graph()
    number = {tuple(pose): vertex for vertex, pose in enumerate(poses.poses.tolist())}
    start, goal = tuple(sorted(data["start"])), tuple(sorted(data["goal"]))
    of_poses = Problem(poses.poses.tolist(), poses.tail, poses.head, poses.cost, number[start], [number[goal]])
    goals = graph.goal_vertices(holds=goal).tolist()
    return of_poses, Problem(graph.stances.tolist(), graph.tail, graph.head, graph.cost, graph.start, goals)


def against_peers(name: str, problem: Problem, repeat: int) -> bool:
    """Prints the comparison; False if the planners disagree."""
    encodings = ("literal", "lean")
    theirs: dict[str, list[thesis_asp.PeerPlan]] = {encoding: [] for encoding in encodings}
    ours: list[TaskPlan] = []
    seconds: list[float] = []
    for turn in range(repeat):
        for encoding in encodings:
            # Half a minute each on the widest wall: once is enough there, in the midst of ours.
            if turn == 0 or theirs[encoding][0].seconds < 2.0:
                theirs[encoding].append(problem.peer(encoding))
        began = time.perf_counter()
        plan = problem.planner().plan()
        seconds.append(time.perf_counter() - began)
        assert isinstance(plan, TaskPlan)
        ours.append(plan)
    mine, plan = float(np.median(seconds)), ours[0]
    attempt = plan.stats.attempts[-1]
    print(f"{name}, {len(problem.holds)} poses, {len(problem.tail)} edges: {plan.makespan} moves, cost {plan.cost}")
    print(f"  {'ours':10s} {mine:9.4f} s   {attempt.rules:9d} rules, {plan.stats.pairs} pairs, proofs {plan.proofs}")
    agree = True
    for encoding, runs in theirs.items():
        peer, peer_seconds = runs[0], float(np.median([run.seconds for run in runs]))
        target = TARGET_RATIO.get(name) if encoding == "literal" else None
        aim = f", target {target:.0f}" if target else ""
        print(f"  {encoding:10s} {peer_seconds:9.4f} s   {peer.rules:9d} rules   {peer_seconds / mine:.0f} times{aim}")
        if target:
            told = f"{1e3 * mine:.1f} ms and {peer_seconds:.1f} s"
            what = f"{name}, proved optimum, against the thesis's encoding"
            Row(what, peer_seconds / mine, "times", target, "at least", told).show()
        agree &= (peer.makespan, peer.cost) == (plan.makespan, plan.cost)
    if not agree:
        print(f"  DISAGREE: {[(run[0].makespan, run[0].cost) for run in theirs.values()]}")
    return agree


def questions(problem: Problem, most: int) -> Iterator[tuple[TaskPlan, float, list[int]]]:
    """Plans after cuts, with the time each took, the cut included, and all edges cut so far."""
    rng = np.random.default_rng(0)
    planner, cut = problem.planner(), list[int]()
    plan = planner.plan()
    for _ in range(most):
        if not isinstance(plan, TaskPlan):
            return
        # Near the start and the goal few moves lead anywhere; cutting them would end the game at once.
        inner = plan.edges[3:-3] or plan.edges
        new = rng.choice(inner, size=min(3, len(inner)), replace=False)
        cut += new.tolist()
        began = time.perf_counter()
        planner.cut(new)
        plan = planner.plan()
        seconds = time.perf_counter() - began
        if isinstance(plan, TaskPlan):
            yield plan, seconds, list(cut)


def asked_again(name: str, problem: Problem, most: int) -> None:
    """Prints how long answers take after cuts, by what they need, and by a planner made afresh."""
    again, longer, afresh, makespans = list[float](), list[float](), list[float](), list[int]()
    for plan, seconds, cut in questions(problem, most):
        (again if plan.stats.attempts[-1].pairs == 0 else longer).append(1e3 * seconds)
        makespans.append(plan.makespan)
        began = time.perf_counter()
        fresh = problem.planner()
        fresh.cut(cut)
        other = fresh.plan()
        afresh.append(1e3 * (time.perf_counter() - began))
        assert isinstance(other, TaskPlan)
        assert (other.makespan, other.cost) == (plan.makespan, plan.cost)
    if not makespans:
        return
    print(f"{name}: {len(problem.holds)} vertices, {len(problem.tail)} edges, {len(makespans)} questions after cuts")
    print(f"  moves grow from {makespans[0]} to {makespans[-1]}; target {1e3 * TARGET_AGAIN:.0f} ms each")
    for what, times in (("nothing new", again), ("longer climb", longer), ("planner afresh", afresh)):
        if times:
            print(f"  {what:14s} {len(times):3d} times, median {np.median(times):6.1f} ms, worst {max(times):6.1f} ms")
    if name.startswith("W3"):
        worst = max(again + longer) / 1e3
        told = f"the worst of {len(makespans)} questions; median {np.median(again + longer):.0f} ms"
        Row(f"asking again after a cut, {name}", worst, "s", TARGET_AGAIN, note=told).show()


def lattice(width: int, height: int) -> Problem:
    """Moves to the right of random cost between the rows of a lattice: exponentially many shortest walks."""
    rng = np.random.default_rng(0)
    ends = []
    for x in range(width - 1):
        for y in range(height):
            for z in range(max(0, y - 1), min(height, y + 2)):
                ends.append((y * width + x, z * width + x + 1))
    middle = (height // 2) * width
    tail, head = np.array(ends).T
    costs = rng.integers(20, 400, len(ends))
    return Problem([[vertex] for vertex in range(width * height)], tail, head, costs, middle, [middle + width - 1])


def what_potentials_do(limit: float = 10.0) -> None:
    """Prints times on lattices with the costs as they are and with the planner's potentials."""
    print(f"potentials, on lattices; time limit {limit:.0f} s")
    for width, height in ((10, 5), (20, 5), (40, 15), (200, 50)):
        problem = lattice(width, height)
        for potentials in (False, True):
            began = time.perf_counter()
            plan = problem.planner(potentials).plan(limit)
            seconds = time.perf_counter() - began
            answer = "proved" if isinstance(plan, TaskPlan) and plan.proofs.cost_proved else "not proved"
            print(f"  {width} x {height}, {'potentials' if potentials else 'bare costs'}: {seconds:8.4f} s, {answer}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--walls", nargs="*", default=["W1", "W2", "W3"], choices=["W1", "W2", "W3"])
    parser.add_argument("--repeat", type=int, default=5, help="runs of each planner")
    parser.add_argument("--questions", type=int, default=100, help="most questions after cuts")
    parser.add_argument("--skip-peers", action="store_true", help="only ask again after cuts")
    arguments = parser.parse_args()
    agree = True
    for name in arguments.walls:
        of_poses, of_stances = problems(name)
        if not arguments.skip_peers:
            agree &= against_peers(name, of_poses, arguments.repeat)
        asked_again(f"{name} poses", of_poses, arguments.questions)
        asked_again(f"{name} stances", of_stances, arguments.questions)
    what_potentials_do()
    sys.exit(not agree)


if __name__ == "__main__":
    main()
