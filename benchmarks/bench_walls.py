"""A wall of a thousand holds, stage by stage: graph, what is proved away, task plan; and the same on smaller walls.

    python -m benchmarks.bench_walls [--walls basic higher random_100 random_1000]

Each wall is taken in a process of its own, so that its peak memory means something. `bench_solve` times whole climbs.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import time

import numpy as np

from benchmarks.rows import Row
from climber.graph import build_stance_graph
from climber.prune import impossible_moves
from climber.random_wall import Recipe
from climber.robot import Model, Robot
from climber.scenario import load_scenario
from climber.stance import Stance
from climber.task import TaskPlan, TaskPlanner
from climber.wall_kinds import make_wall

TARGET_GRAPH, TARGET_MEMORY, TARGET_TASK = 5.0, 1.0, 5.0  # [s], [GB], [s], all on a thousand holds


def measure(name: str) -> dict[str, float]:
    """Times [s], counts and peak memory [GB] of one scenario, up to its first task plan."""
    began = time.perf_counter()
    scenario = load_scenario(name)
    wall, spec = scenario.build_wall(), scenario.robots[0]
    robot = Robot(Model.load(spec.model, scenario.folder), wall.gravity)
    start = Stance(tuple(spec.start[limb] for limb in robot.limb_names))
    loaded = time.perf_counter()
    graph = build_stance_graph(wall, robot, start, scenario.cost)
    built = time.perf_counter()
    region = None if spec.goal.pelvis is None else spec.goal.pelvis.inside()
    goals = graph.goal_vertices(holds=spec.goal.holds, region=region)
    graph_memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    found = time.perf_counter()
    impossible = impossible_moves(graph, robot, wall, goals)
    pruned = time.perf_counter()
    tasks = TaskPlanner(graph.num_vertices, graph.tail, graph.head, graph.cost, graph.start, goals.tolist())
    tasks.cut(impossible)
    plan = tasks.plan()
    planned = time.perf_counter()
    proved = isinstance(plan, TaskPlan) and plan.proofs.makespan_proved and plan.proofs.cost_proved
    return {
        "load": loaded - began,
        "graph": built - loaded,
        "graph_memory": graph_memory,
        "prune": pruned - found,
        "task": planned - pruned,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "stances": graph.num_vertices,
        "moves": graph.num_edges,
        "far": graph.counts["vertices_out_of_reach"],
        "cut": len(impossible),
        "length": len(plan.edges) if isinstance(plan, TaskPlan) else np.nan,
        "proved": proved,
    }


def report(name: str, found: dict[str, float]) -> bool:
    """Prints the rows of a scenario; False if its task plan was not proved."""
    large = name == "random_1000"
    size = f"{found['stances']:.0f} stances, {found['moves']:.0f} moves"
    Row(f"stance graph, {name}", found["graph"], "s", TARGET_GRAPH if large else None, note=size).show()
    if large:
        note = "peak of the process, Drake and all"
        Row(f"  memory with it, {name}", found["graph_memory"], "GB", TARGET_MEMORY, note=note).show()
    note = f"{found['far']:.0f} stances out of reach, {found['cut']:.0f} moves impossible"
    Row(f"  proved away, {name}", found["prune"], "s", note=note).show()
    note = f"{found['length']:.0f} moves, " + ("shortest and cheapest proved" if found["proved"] else "NOT PROVED")
    what = f"  task plan across it, proved, {name}"
    Row(what, found["task"], "s", TARGET_TASK if large else None, note=note).show()
    return bool(found["proved"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--walls", nargs="*", default=["basic", "higher", "random_100", "random_1000"])
    arguments = parser.parse_args()
    began = time.perf_counter()
    make_wall(Recipe(holds=10_000))
    Row("ten thousand holds at random, 35 to the square metre", time.perf_counter() - began, "s").show()
    good = True
    for name in arguments.walls:
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            found = pool.apply(measure, (name,))
        print(f"{name}: " + ", ".join(f"{key} {value:.4g}" for key, value in found.items()), flush=True)
        good &= report(name, found)
    raise SystemExit(not good)


if __name__ == "__main__":
    main()
