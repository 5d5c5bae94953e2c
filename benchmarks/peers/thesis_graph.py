"""The thesis's feasibility graph (Gönen 2021, section 4.2), written as its text describes it. Kept plain on purpose.

State creator: all permutations of four holds; shapely disks around them must intersect (4.2); four cross products
against leg crossing (4.6). Edge creator: breadth first over ordered states one hold apart, poses are sorted states,
shapely again for reachability (4.7), two `linprog` calls for each support interval (4.12-4.17), costs (4.19-4.22).

`memo_sets` asks for the disks of a set of holds once and not for its 24 orders, and `lp_cache` for the interval of a
set once: what a careful programmer would do first. Shapely's disks are regular polygons *inside* the circles, here of
64 corners, so its areas are too small: by a sixth of a percent for a whole disk, by much more for a narrow overlap.
Costs differ from exact ones accordingly, and with them the cheapest of the shortest climbs can.
"""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from shapely.geometry import Point, Polygon

MASS, GRAVITY, MIN_FORCE, MAX_FORCE = 2.0, 9.81, 2.0, 20.0
W_REACH, W_STABILITY, W_ROBUSTNESS = 100.0, 1.0, 1.0

State = tuple[int, ...]
Interval = tuple[float, float] | None


@dataclass
class PeerGraph:
    """What came out, and the time it took.

    Attributes:
        edges: Rounded cost by start and end pose.
        counts: Candidates left after each stage.
        seconds: Time of each stage [s].
        extrapolated: Stages cut short at the time limit, whose seconds are scaled up from the part that was done.
    """

    edges: dict[tuple[State, State], int]
    counts: dict[str, int]
    seconds: dict[str, float]
    extrapolated: list[str]

    @property
    def total(self) -> float:
        return sum(self.seconds.values())


class ThesisGraph:
    """The method on one wall, a dictionary as in the files of `walls/`."""

    def __init__(self, wall: dict, memo_sets: bool = False, lp_cache: bool = False, quad_segs: int = 16) -> None:
        self.xy = [(h["x"], h["y"]) for h in wall["holds"]]
        self.start: State = tuple(wall["start"])
        reach = wall["robot"]["r"] + wall["robot"]["l1"] + wall["robot"]["l2"]
        self.disks = [Point(p).buffer(reach, quad_segs=quad_segs) for p in self.xy]
        self.cones = [_cone_edges(h["normal"], math.atan(h["mu"])) for h in wall["holds"]]
        self.memo_sets, self.lp_cache = memo_sets, lp_cache
        self.intervals: dict[State, Interval] = {}

    def build(self, most_seconds: float = math.inf) -> PeerGraph:
        """The whole graph; a stage that takes longer than `most_seconds` is finished with caches, outside the clock."""
        self.graph = PeerGraph({}, {}, {}, [])
        states = self._create_states(most_seconds)
        pairs = self._reachable_pairs(states)
        intervals = self._stable_edges(pairs, most_seconds)
        self._costs(intervals)
        return self.graph

    def _create_states(self, most_seconds: float) -> set[State]:
        counts, seconds = self.graph.counts, self.graph.seconds
        counts["tuples"], done = math.perm(len(self.xy), 4), 0
        began = time.perf_counter()
        valid: list[State] = []
        memo: dict[State, bool] = {}
        for state in itertools.permutations(range(len(self.xy)), 4):
            if self.memo_sets:
                key = tuple(sorted(state))
                if key not in memo:
                    memo[key] = self._overlap(key)
                meets = memo[key]
            else:
                meets = self._overlap(state)
            if meets:
                valid.append(state)
            done += 1
            if done % 20000 == 0 and time.perf_counter() - began > most_seconds:
                break
        spent = time.perf_counter() - began
        seconds["state validator"] = spent * counts["tuples"] / done
        if done < counts["tuples"]:
            self.graph.extrapolated.append("state validator")
            sets = (s for s in itertools.combinations(range(len(self.xy)), 4) if self._overlap(s))
            valid = [state for s in sets for state in itertools.permutations(s)]
        began = time.perf_counter()
        states = {state for state in valid if self._crossing_free(state)}
        seconds["leg crossing"] = time.perf_counter() - began
        counts["valid"], counts["non_crossing"] = len(valid), len(states)
        counts["poses"] = len({tuple(sorted(s)) for s in states})
        return states

    def _reachable_pairs(self, states: set[State]) -> list[tuple[State, State]]:
        counts, seconds = self.graph.counts, self.graph.seconds
        began = time.perf_counter()
        seen, queue, transitions = {self.start}, deque([self.start]), 0
        unique: dict[tuple[State, State], None] = {}
        while queue:
            state = queue.popleft()
            for leg, hold in itertools.product(range(4), range(len(self.xy))):
                if hold in state:
                    continue
                other = (*state[:leg], hold, *state[leg + 1 :])
                if other not in states:
                    continue
                transitions += 1
                pose, other_pose = tuple(sorted(state)), tuple(sorted(other))
                unique.setdefault((min(pose, other_pose), max(pose, other_pose)), None)
                if other not in seen:
                    seen.add(other)
                    queue.append(other)
        seconds["adjacency"] = time.perf_counter() - began
        counts["ordered_states_visited"], counts["ordered_transitions"] = len(seen), transitions
        counts["unique_transitions"] = len(unique)
        began = time.perf_counter()
        pairs = [(p, q) for p, q in unique if self._overlap(sorted({*p, *q}))]
        seconds["reachability"] = time.perf_counter() - began
        counts["reach_ok"] = len(pairs)
        return pairs

    def _stable_edges(
        self, pairs: list[tuple[State, State]], most_seconds: float
    ) -> dict[tuple[State, State], tuple[float, float]]:
        counts, seconds = self.graph.counts, self.graph.seconds
        edges: dict[tuple[State, State], tuple[float, float]] = {}
        stable, rejected, clock = set(), 0, 0.0
        timed, timed_pairs, cache = True, 0, self.lp_cache
        for p, q in pairs:
            began = time.perf_counter()
            for a, b in ((p, q), (q, p)):
                sr1, sr2 = self._interval(tuple(sorted({*p} & {*q})), cache), self._interval(b, cache)
                if sr1 is None:
                    continue
                if sr2 is None or max(sr1[0], sr2[0]) > min(sr1[1], sr2[1]) + 1e-9:
                    rejected += 1
                    continue
                edges[a, b] = sr1
                stable.add((p, q))
            if timed:
                clock, timed_pairs = clock + time.perf_counter() - began, timed_pairs + 1
                if clock > most_seconds:
                    timed, cache = False, True
        seconds["stability"] = clock * len(pairs) / max(1, timed_pairs)
        if not timed:
            self.graph.extrapolated.append("stability")
        counts["stable_pairs"], counts["stable_directed"] = len(stable), len(edges)
        counts["directed_where_SR2_clause_rejects"] = rejected
        counts["graph_nodes"] = len({pose for pair in edges for pose in pair})
        counts["graph_edges_undirected"] = len(stable)
        return edges

    def _costs(self, edges: dict[tuple[State, State], tuple[float, float]]) -> None:
        began = time.perf_counter()
        for (a, b), (lower, upper) in edges.items():
            held = sorted({*a} & {*b})
            (old,), (new,) = {*a} - {*b}, {*b} - {*a}
            area = self._intersection(held).area
            cost = W_REACH * math.dist(self.xy[old], self.xy[new])
            cost += W_STABILITY / max(upper - lower, 1e-3) + W_ROBUSTNESS / max(area, 1e-4)
            self.graph.edges[a, b] = round(cost)
        self.graph.seconds["costs"] = time.perf_counter() - began

    def _intersection(self, holds: Sequence[int]) -> Polygon:
        overlap = self.disks[holds[0]]
        for hold in holds[1:]:
            overlap = overlap.intersection(self.disks[hold])
            if overlap.is_empty:
                break
        return overlap

    def _overlap(self, holds: Sequence[int]) -> bool:
        return not self._intersection(holds).is_empty

    def _crossing_free(self, state: State) -> bool:
        (xi, yi), (xj, yj), (xk, yk), (xl, yl) = (self.xy[hold] for hold in state)
        return (
            (yi - yk) * (xl - xk) - (xi - xk) * (yl - yk) > 0
            and (yj - yk) * (xi - xk) - (xj - xk) * (yi - yk) > 0
            and (yj - yl) * (xi - xl) - (xj - xl) * (yi - yl) > 0
            and (yk - yl) * (xj - xl) - (xk - xl) * (yj - yl) > 0
        )

    def _interval(self, holds: State, cache: bool) -> Interval:
        if cache:
            if holds not in self.intervals:
                self.intervals[holds] = self.solve_interval(holds)
            return self.intervals[holds]
        return self.solve_interval(holds)

    def solve_interval(self, holds: State) -> Interval:
        num_forces = 2 * len(holds)
        A = np.zeros((3, num_forces + 1))
        for i, hold in enumerate(holds):
            x, y = self.xy[hold]
            for j, (fx, fy) in enumerate(self.cones[hold]):
                A[:, 2 * i + j] = (fx, fy, x * fy - y * fx)
        A[2, -1] = -MASS * GRAVITY
        b = np.array([0.0, MASS * GRAVITY, 0.0])
        c = np.zeros(num_forces + 1)
        c[-1] = 1.0
        bounds = [(MIN_FORCE, MAX_FORCE)] * num_forces + [(None, None)]
        least = linprog(c, A_eq=A, b_eq=b, bounds=bounds, method="highs")
        most = linprog(-c, A_eq=A, b_eq=b, bounds=bounds, method="highs")
        if least.status != 0 or most.status != 0:
            return None
        return float(least.x[-1]), float(most.x[-1])


def _cone_edges(normal: Sequence[float], half_angle: float) -> list[tuple[float, float]]:
    nx, ny = normal
    turns = ((math.cos(a), math.sin(a)) for a in (half_angle, -half_angle))
    return [(nx * c - ny * s, nx * s + ny * c) for c, s in turns]
