"""The stance graph against the thesis's method on the same walls, and on walls far beyond it.

    python -m benchmarks.bench_graph [--walls W1 W2 W3] [--repeat 15] [--peer-seconds 60] [--skip-peer]
        [--holds 10000] [--space vertical inside_corner]

Ours and the peers run in turn in this process; a ratio is that of medians. The counts after every stage and the edges
between poses must be the same, or the exit code is 1. The plain peer takes minutes on W3; a stage that is stopped by
`--peer-seconds` is scaled up from the part that was done, and the table says so. Walls of `--holds` have the density of
W3, 35 holds to the square metre, and are built in a process of their own, so that its peak memory means something.
Walls in space are those of `climber wall --kind` with 300 holds, for a robot of LEMUR's reach.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import resource
import sys
import time
from dataclasses import replace

import numpy as np

from benchmarks.peers.thesis_graph import PeerGraph, ThesisGraph
from benchmarks.rows import Row
from benchmarks.thesis import Quadruped, graph_of, wall_data
from climber.graph import build_stance_graph
from climber.poses import Rotations, find_poses
from climber.programs.support import hold_set_intervals
from climber.scenario_fields import CostWeights
from climber.stance import Stance
from climber.stance_graph import StanceGraph
from climber.wall import Hold, Wall
from climber.wall_kinds import KINDS, make_wall

TARGET_RATIO = {"plain": 300.0, "with caches": 50.0}  # times faster, on W2 and W3
TARGET_SECONDS = {"W2": 0.030, "W3": 0.080}
TARGET_SCATTERED = {1000: (5.0, 1.0), 10_000: (60.0, 6.0)}  # [s], [GB] by number of holds
TARGET_SPACE = 10.0  # [s]
DENSITY, SPACING = 35.0, 0.12  # [1/m^2], [m] of W3


def ours(data: dict) -> tuple[StanceGraph, float]:
    """The graph of a wall as in `walls/`, and the time from the numbers in the file to it [s]."""
    began = time.perf_counter()
    graph = graph_of(data)
    return graph, time.perf_counter() - began


def against_peers(name: str, repeat: int, most_seconds: float, skip_peer: bool) -> bool:
    """Prints the comparison; False if the graphs differ."""
    data = wall_data(name)
    graph, _ = ours(data)  # the first call fills caches of numpy and scipy
    seconds = [ours(data)[1] for _ in range(repeat)]
    peers: dict[str, PeerGraph] = {}
    for kind in () if skip_peer else ("plain", "with caches"):
        peer = ThesisGraph(data, memo_sets=kind != "plain", lp_cache=kind != "plain")
        peers[kind] = peer.build(most_seconds)
        seconds += [ours(data)[1] for _ in range(repeat)]
    mine = float(np.median(seconds))
    print(f"{name}: {len(data['holds'])} holds")
    print("  " + ", ".join(f"{stage} {count}" for stage, count in graph.counts.items()))
    aim = f", target {1e3 * TARGET_SECONDS[name]:.0f} ms" if name in TARGET_SECONDS else ""
    print(f"  {'ours':12s} {1e3 * mine:9.2f} ms   median of {len(seconds)}{aim}")
    same = True
    for kind, peer in peers.items():
        note = f" (extrapolated: {', '.join(peer.extrapolated)})" if peer.extrapolated else ""
        aim = f", target {TARGET_RATIO[kind]:.0f}" if name in TARGET_SECONDS else ""
        print(f"  {kind:12s} {peer.total:9.2f} s    {peer.total / mine:.0f} times{aim}{note}")
        if name in TARGET_SECONDS:
            what = f"stance graph of {name}, against the thesis's method, {kind}"
            told = f"{1e3 * mine:.1f} ms and {peer.total:.1f} s{note}"
            Row(what, peer.total / mine, "times", TARGET_RATIO[kind], "at least", told).show()
        same &= compare(graph, peer)
    return same


def compare(graph: StanceGraph, peer: PeerGraph) -> bool:
    """Whether counts and edges between poses are equal; prints what differs."""
    poses = graph.pose_graph()
    holds = [tuple(pose) for pose in poses.poses.tolist()]
    edges = {
        (holds[tail], holds[head]): cost
        for tail, head, cost in zip(poses.tail.tolist(), poses.head.tolist(), poses.cost.tolist(), strict=True)
    }
    differ = {
        stage: (graph.counts[stage], count) for stage, count in peer.counts.items() if graph.counts[stage] != count
    }
    if differ or edges.keys() != peer.edges.keys():
        print(f"  DIFFER: counts (ours, theirs) {differ}, {len(edges.keys() ^ peer.edges.keys())} edges in one only")
        return False
    off = [
        (abs(edges[pair] - cost) / cost, edges[pair], cost) for pair, cost in peer.edges.items() if edges[pair] != cost
    ]
    worst = "; most, {1} for {2}".format(*max(off)) if off else ""
    print(f"    all counts and all {len(edges)} edges equal; {len(off)} costs differ by its polygons{worst}")
    return True


def scattered_wall(num_holds: int, rng: np.random.Generator) -> Wall:
    """Holds thrown on a square at the density of W3, no two closer than its spacing, and as steep and rough as its."""
    side, cell = math.sqrt(num_holds / DENSITY), SPACING / math.sqrt(2)
    cells = np.full((int(side / cell) + 6,) * 2, -1)  # at most one hold in each
    points = np.empty((num_holds, 2))
    placed = 0
    while placed < num_holds:
        point = rng.uniform(0, side, 2)
        i, j = (point / cell).astype(int) + 2
        near = cells[i - 2 : i + 3, j - 2 : j + 3]
        if (np.linalg.norm(points[near[near >= 0]] - point, axis=1) >= SPACING).all():
            cells[i, j], points[placed], placed = placed, point, placed + 1
    slope = np.radians(np.clip(rng.normal(0, 25, num_holds), -40, 40))
    friction = np.clip(rng.normal(0.6, 0.1, num_holds), 0.3, 0.9)
    normals = np.stack([-np.sin(slope), np.cos(slope)], axis=1)
    return Wall(
        tuple(
            Hold((*p, 0.0), (*n, 0.0), f, min_force=2.0, max_force=20.0)
            for p, n, f in zip(points.tolist(), normals.tolist(), friction.tolist(), strict=True)
        )
    )


def wide_wall(num_holds: int, seed: int) -> tuple[float, float, float, dict[str, int]]:
    """Of the graph of a scattered wall, from near its middle: time and processor time [s], growth of the peak memory
    [GB], counts.
    """
    wall = scattered_wall(num_holds, np.random.default_rng(seed))
    positions, reach = wall.positions[:, :2], np.full(4, 0.25)
    near = np.linalg.norm(positions - positions.mean(axis=0), axis=1).argsort()[:20]
    starts = near[find_poses(positions[near], reach, Rotations(4, 1, 2), {})]
    starts = starts[~np.isnan(hold_set_intervals(wall, starts, 2.0)[:, 0])]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    spent = busy = 0.0
    for start in starts.tolist():
        began, busy_before = time.perf_counter(), time.process_time()
        graph = build_stance_graph(wall, Quadruped(reach), Stance(tuple(start)), CostWeights())
        spent, busy = time.perf_counter() - began, time.process_time() - busy_before
        if graph.num_edges:
            break
    memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 2**20
    return spent, busy, memory, graph.counts


def wall_in_space(kind: str, num_holds: int = 300) -> tuple[float, float, dict[str, int]]:
    """Of the graph of a random wall in space, from near its bottom: time and processor time [s], counts."""
    wall = make_wall(replace(KINDS[kind], holds=num_holds))
    robot = Quadruped(np.full(4, 0.5), mass=7.0, dimension=3)
    low = np.argsort(wall.positions[:, 1])[:20]
    starts = low[find_poses(wall.positions[low], robot.reach, Rotations(4, 1, 2), {}, lambda s: wall.projected(low[s]))]
    spent = busy = 0.0
    for start in starts.tolist():
        began, busy_before = time.perf_counter(), time.process_time()
        graph = build_stance_graph(wall, robot, Stance(tuple(start)), CostWeights())
        spent, busy = time.perf_counter() - began, time.process_time() - busy_before
        if graph.num_edges:
            break
    return spent, busy, graph.counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--walls", nargs="*", default=["W1", "W2", "W3"], choices=["W1", "W2", "W3"])
    parser.add_argument("--repeat", type=int, default=15, help="runs of ours before and after each peer")
    parser.add_argument("--peer-seconds", type=float, default=math.inf, help="stop a stage of the peer after this [s]")
    parser.add_argument("--skip-peer", action="store_true", help="only ours")
    parser.add_argument("--holds", nargs="*", type=int, default=[1000], help="sizes of scattered walls")
    parser.add_argument("--space", nargs="*", default=["vertical"], help="kinds of walls in space")
    arguments = parser.parse_args()
    same = True
    for name in arguments.walls:
        same &= against_peers(name, arguments.repeat, arguments.peer_seconds, arguments.skip_peer)
    for num_holds in arguments.holds:
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            seconds, busy, memory, counts = pool.apply(wide_wall, (num_holds, 0))
        print(f"{num_holds} scattered holds: {seconds:.2f} s ({busy:.2f} s of processor), {memory:.2f} GB on top")
        most_seconds, most_memory = TARGET_SCATTERED.get(num_holds, (None, None))
        told = f"{counts['edges']} edges; {busy:.2f} s of processor"
        Row(f"stance graph of {num_holds} holds at the density of W3", seconds, "s", most_seconds, note=told).show()
        Row("  its memory", memory, "GB", most_memory, note="growth of the peak").show()
        print("  " + ", ".join(f"{stage} {count}" for stage, count in counts.items()))
    for kind in arguments.space:
        seconds, busy, counts = wall_in_space(kind)
        told = f"{counts['edges']} edges, {counts['supports']} support polygons; {busy:.2f} s of processor"
        Row(f"stance graph of 300 holds in space, {kind}", seconds, "s", TARGET_SPACE, note=told).show()
    sys.exit(not same)


if __name__ == "__main__":
    main()
