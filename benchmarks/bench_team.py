"""The task planner's extensions on W3: waypoint, two robots, asked again after splits; and a wall of 1000 holds.

    python -m benchmarks.bench_team [--wall W3] [--repeat 5] [--encodings literal lean] [--questions 60] [--holds 1000]
        [--skip-peers]

Waypoint and second robot are those of the wall's file, on the thesis's graph of poses, and the peers run the thesis's
encoding; they run in turn with ours, each in a process of its own, and must agree on makespan and cost. In the peers'
reading a robot may take a hold in the step in which another lets go of it (`handover=True`); ours, stricter, is timed
as well. A waypoint visited "by the horizon" and one visited "at any step that was grounded", the two ways to write it
in the thesis's encoding, are the same problem. The exit code is 1 if the planners disagree.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np

from benchmarks import bench_graph
from benchmarks.bench_task import TARGET_AGAIN, Problem, problems
from benchmarks.peers import thesis_asp
from benchmarks.rows import Row
from benchmarks.thesis import Quadruped, wall_data
from climber.graph import build_stance_graph
from climber.layers import FAR
from climber.poses import Rotations, find_poses
from climber.programs.support import hold_set_intervals
from climber.scenario_fields import CostWeights
from climber.stance import Stance
from climber.task import RobotTask, TaskPlan, TaskPlanner

TARGETS = {"waypoint": 100.0, "two robots": 50.0}  # times faster than the thesis's encoding
TARGET_ACROSS = 5.0  # [s]


def vertex(problem: Problem, holds: list[int]) -> int:
    """The pose that stands on these holds."""
    return problem.holds.index(sorted(holds))


def task(problem: Problem, start: int, goals: list[int], **options: Any) -> RobotTask:
    return RobotTask(
        len(problem.holds), problem.tail, problem.head, problem.cost, start, goals, np.array(problem.holds), **options
    )


def timed(make: Callable[[], TaskPlanner]) -> tuple[TaskPlan, float]:
    """A plan, and the time from the graph to it [s]."""
    began = time.perf_counter()
    plan = make().plan()
    seconds = time.perf_counter() - began
    assert isinstance(plan, TaskPlan)
    assert plan.proofs.makespan_proved
    assert plan.proofs.cost_proved
    return plan, seconds


def against_peers(
    name: str,
    problem: Problem,
    make: Callable[[], TaskPlanner],
    encodings: dict[str, str],
    options: dict[str, Any],
    repeat: int,
) -> bool:
    """Prints the comparison of one case; False if the planners disagree.

    Args:
        name: The case.
        problem: The graph.
        make: Ours.
        encodings: What to call the peers, and which program they run.
        options: What else `thesis_asp.plan` takes.
        repeat: How often ours runs.
    """
    costs = zip(problem.tail.tolist(), problem.head.tolist(), problem.cost.tolist(), strict=True)
    edges = [(problem.holds[tail], problem.holds[head], cost) for tail, head, cost in costs]
    ends = problem.holds[problem.start], problem.holds[problem.goals[0]]
    runs = [timed(make) for _ in range(repeat)]
    peers: dict[str, thesis_asp.PeerPlan] = {}
    for called, encoding in encodings.items():
        # In a process of its own: a heap that once held millions of rules slows down whoever comes next.
        with ProcessPoolExecutor(1, get_context("spawn")) as alone:
            peers[called] = alone.submit(thesis_asp.plan, edges, *ends, encoding, **options).result()
        runs += [timed(make) for _ in range(repeat)]
    plan, mine = runs[0][0], float(np.median([seconds for _, seconds in runs]))
    print(f"{name}: {plan.makespan} steps, cost {plan.cost}")
    print(f"  {'ours':10s} {mine:9.4f} s   {plan.stats.pairs} pairs, {plan.stats.moves} moves, all proved")
    for called, peer in peers.items():
        target = TARGETS[name.split(", ")[1]] if called == "literal" else None
        print(f"  {called:10s} {peer.seconds:9.4f} s   {peer.rules} rules, {peer.seconds / mine:.0f} times")
        if target:
            told = f"{1e3 * mine:.0f} ms and {peer.seconds:.1f} s"
            Row(f"{name}, against the thesis's encoding", peer.seconds / mine, "times", target, "at least", told).show()
        if (peer.makespan, peer.cost) != (plan.makespan, plan.cost):
            print(f"  DISAGREE: {called} has {peer.makespan} steps, cost {peer.cost}")
            return False
    return True


def splits(problem: Problem, most: int) -> Iterator[float]:
    """Times to answer after an inner stance of the plan was split and the way through it barred [s]."""
    rng = np.random.default_rng(0)
    planner = TaskPlanner([task(problem, problem.start, problem.goals)])
    plan = planner.plan()
    for _ in range(most):
        if not isinstance(plan, TaskPlan):
            return
        walk = plan.walks[0]
        place = int(rng.integers(3, plan.makespan - 3))
        began = time.perf_counter()
        at, entered, left = walk.vertices[place], walk.edges[place - 1], walk.edges[place]
        if walk.components[place] is None and planner.split(0, at):
            # What arrives there is in the one component, what leaves from there in the other.
            planner.forbid(0, entered, to_component=1)
            planner.forbid(0, left, from_component=0)
        else:
            planner.forbid(0, left, from_component=walk.components[place])
        plan = planner.plan()
        yield time.perf_counter() - began


def conflicts(make: Callable[[], TaskPlanner], most: int) -> Iterator[float]:
    """Times of a team to answer after two moves that it made at once were found in conflict [s]."""
    rng = np.random.default_rng(0)
    planner = make()
    plan = planner.plan()
    for _ in range(most):
        if not isinstance(plan, TaskPlan):
            return
        step = int(rng.integers(plan.makespan))
        a, b = (
            (robot, "move", walk.edges[step]) if walk.edges[step] >= 0 else (robot, "at", walk.vertices[step])
            for robot, walk in enumerate(plan.walks)
        )
        began = time.perf_counter()
        planner.conflict(a, b)
        plan = planner.plan()
        yield time.perf_counter() - began


def across(num_holds: int, repeat: int) -> None:
    """Prints how long the plan takes from the lowest stance of a scattered wall to the one farthest from there."""
    wall = bench_graph.scattered_wall(num_holds, np.random.default_rng(0))
    positions, reach = wall.positions[:, :2], np.full(4, 0.25)
    near = np.linalg.norm(positions - positions.mean(axis=0), axis=1).argsort()[:20]
    starts = near[find_poses(positions[near], reach, Rotations(4, 1, 2), {})]
    starts = starts[~np.isnan(hold_set_intervals(wall, starts, 2.0)[:, 0])]
    robot = Quadruped(reach)
    graphs = (build_stance_graph(wall, robot, Stance(tuple(start)), CostWeights()) for start in starts.tolist())
    graph = next(graph for graph in graphs if graph.num_edges)
    lowest = int(positions[graph.stances, 1].sum(axis=1).argmin())
    arrays = graph.num_vertices, graph.tail, graph.head, graph.cost
    distances = TaskPlanner(*arrays, lowest, [lowest]).layers[0].from_start
    farthest = int(np.where(distances < FAR, distances, -1).argmax())
    runs = [timed(lambda: TaskPlanner(*arrays, lowest, [farthest])) for _ in range(repeat)]
    plan, seconds = runs[0][0], float(np.median([seconds for _, seconds in runs]))
    note = f"{graph.num_vertices} stances, {graph.num_edges} moves; {plan.makespan} steps, cost {plan.cost}"
    print(f"across {num_holds} scattered holds: {seconds:.2f} s, {plan.stats.pairs} pairs; {note}")
    Row(f"task plan across the {num_holds}-hold graph, proved", seconds, "s", TARGET_ACROSS, note=note).show()


def told(name: str, seconds: list[float], target: float | None) -> None:
    median, worst = np.median(seconds), max(seconds)
    print(f"{name}: {len(seconds)} times, median {1e3 * median:.1f} ms, worst {1e3 * worst:.1f} ms")
    note = f"the worst of {len(seconds)} questions; median {1e3 * median:.0f} ms"
    Row(f"asking again after {name}", worst, "s", target, note=note).show()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wall", default="W3", choices=["W3"])
    parser.add_argument("--repeat", type=int, default=5, help="runs of ours before and after each of a peer's")
    parser.add_argument("--encodings", nargs="*", default=["literal", "lean"], choices=["literal", "lean"])
    parser.add_argument("--questions", type=int, default=60, help="most questions after splits")
    parser.add_argument("--holds", type=int, default=1000, help="size of the scattered wall")
    parser.add_argument("--skip-peers", action="store_true", help="only ours")
    arguments = parser.parse_args()
    encodings = [] if arguments.skip_peers else arguments.encodings
    data = wall_data(arguments.wall)
    poses, stances = problems(arguments.wall)

    way = vertex(poses, data["waypoint"])
    first = task(poses, poses.start, poses.goals)
    second = task(poses, vertex(poses, data["robot2"]["start"]), [vertex(poses, data["robot2"]["goal"])])
    agree = against_peers(
        f"{arguments.wall}, waypoint",
        poses,
        lambda: TaskPlanner([task(poses, poses.start, poses.goals, waypoints=[[way]])]),
        {name: name for name in encodings},
        {"waypoint": data["waypoint"]},
        arguments.repeat,
    )
    agree &= against_peers(
        f"{arguments.wall}, two robots",
        poses,
        lambda: TaskPlanner([first, second], handover=True),
        {name: f"two_{name}" for name in encodings},
        {"other": (data["robot2"]["start"], data["robot2"]["goal"])},
        arguments.repeat,
    )
    plan, seconds = timed(lambda: TaskPlanner([first, second]))
    Row(
        f"{arguments.wall}, two robots, no hold passed on within a step",
        seconds,
        "s",
        note=f"{plan.makespan} steps, cost {plan.cost}",
    ).show()
    for name, problem in (("poses", poses), ("stances", stances)):
        told(f"a split, {arguments.wall} {name}", list(splits(problem, arguments.questions)), TARGET_AGAIN)
    told(
        f"a conflict, {arguments.wall}, two robots",
        list(conflicts(lambda: TaskPlanner([first, second], handover=True), 10)),
        None,
    )
    across(arguments.holds, arguments.repeat)
    sys.exit(not agree)


if __name__ == "__main__":
    main()
