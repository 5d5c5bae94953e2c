"""The checks of several robots on one wall: one clock, every hold for one at a time, room between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product

import numpy as np
import shapely

from climber.plan_parts import RobotPlan
from climber.robot import Indices, Robot
from climber.stance import Vector
from climber.verdict import Ledger
from climber.verify_clearance import Placed, outlines
from climber.verify_model import Tree
from climber.verify_motion import Motion
from climber.verify_rules import BETWEEN
from climber.verify_scene import Scene, gap
from climber.verify_space import Sweep

CHUNK = 5000  # instants measured at a time


@dataclass(frozen=True)
class Hold:
    """One robot's foot on one hold, for as long as it stays.

    Attributes:
        hold: The hold.
        robot: The robot's name.
        limb: The limb's name.
        begin: When the foot is first on it [s].
        end: When it is last on it [s].
    """

    hold: int
    robot: str
    limb: str
    begin: float
    end: float


class TeamChecks:
    """Goes through the plans of several robots and takes down how they meet."""

    def __init__(self, robots: Sequence[Robot], plans: Sequence[RobotPlan], ledger: Ledger) -> None:
        self._robots, self._plans, self._ledger = robots, plans, ledger

    def check(self) -> None:
        """Makes all checks."""
        self._clock()
        self._ledger.faults("holds of one", list(self._shared()))
        for i, j in combinations(range(len(self._plans)), 2):
            if self._robots[i].planar and self._robots[j].planar:
                self._apart(i, j)
            else:
                self._apart_in_space(i, j)

    def _clock(self) -> None:
        """All robots begin at time 0 and end when the last of them does."""
        ends = np.array([float(plan.phases[-1].time[-1]) for plan in self._plans])
        begins = np.array([float(plan.phases[0].time[0]) for plan in self._plans])
        self._ledger.note("clock", np.abs(begins), [f"{plan.name}, the start" for plan in self._plans])
        self._ledger.note("clock", ends.max() - ends, [f"{plan.name}, the end" for plan in self._plans])

    def _shared(self) -> Iterator[str]:
        """A hold that one robot leaves is free for another strictly later."""
        kept = [hold for plan in self._plans for hold in _kept(plan)]
        for one, two in combinations(kept, 2):
            if one.hold == two.hold and one.robot != two.robot:
                begin, end = max(one.begin, two.begin), min(one.end, two.end)
                if begin <= end:
                    who = f"{one.robot}, {one.limb} and {two.robot}, {two.limb}"
                    yield f"hold {one.hold}, {who}, t = {begin:.4f} s to {end:.4f} s"

    def _apart(self, i: int, j: int) -> None:
        """Distance of two robots at the samples of both and at points between every two of these."""
        tracks = [_track(self._plans[k], self._robots[k]) for k in (i, j)]
        instants = np.unique(np.concatenate([time for time, _ in tracks]))
        part = np.arange(BETWEEN + 1) / (BETWEEN + 1)
        between = (instants[:-1, None] + np.diff(instants)[:, None] * part).ravel()
        instants = np.append(between, instants[-1])
        trees = [Tree(self._robots[k]) for k in (i, j)]
        shapes = [outlines(self._robots[k]) for k in (i, j)]
        for first in range(0, len(instants), CHUNK):
            time = instants[first : first + CHUNK]
            sides = []
            for (known, q), tree, own in zip(tracks, trees, shapes, strict=True):
                at = np.stack([np.interp(time, known, column) for column in q.T], axis=1)
                poses = tree.poses(at)
                sides.append([outline.place(poses) for outline in own])
            distance, pair = _nearest(sides[0], sides[1])

            def where(k: int, pair: Indices = pair, sides: list[list[Placed]] = sides, time: Vector = time) -> str:
                links = [side[int(which)].outline.name for side, which in zip(sides, pair[k], strict=True)]
                who = " and ".join(f"{self._plans[r].name}, {link}" for r, link in zip((i, j), links, strict=True))
                return f"{who}, t = {time[k]:.4f} s"

            self._ledger.note("robot clearance", distance, where)

    def _apart_in_space(self, i: int, j: int) -> None:
        """Distance of two robots at every instant, from samples of both and bounds on what they do in between."""
        robots, tracks = [self._robots[k] for k in (i, j)], [_track(self._plans[k], self._robots[k]) for k in (i, j)]
        parts = [(owner, part) for owner, robot in enumerate(robots) for part in Scene(robot, ()).parts()]
        first = sum(owner == 0 for owner, _ in parts)
        sweep = Sweep(robots, parts, list(product(range(first), range(first, len(parts)))))
        time = np.unique(np.concatenate([time for time, _ in tracks]))
        q = np.column_stack([np.interp(time, known, column) for known, q in tracks for column in q.T])
        least = sweep.least(time, q, np.ones(len(sweep.pairs), dtype=bool))
        who = f"{self._plans[i].name} and {self._plans[j].name}, {least.pair}, t = {least.time:.4f} s"
        self._ledger.note("robot clearance", np.array([least.value]), [who])


def _kept(plan: RobotPlan) -> Iterator[Hold]:
    """Every stay of a foot on a hold: through all phases in a row in which the limb is in contact there."""
    for limb in plan.limbs:
        on = [next((c.hold for c in phase.contacts if c.limb == limb), None) for phase in plan.phases]
        changes = [0, *(k for k, (a, b) in enumerate(pairwise(on), start=1) if a != b), len(on)]
        for first, after in pairwise(changes):
            hold = on[first]
            if hold is not None:
                begin, end = plan.phases[first].time[0], plan.phases[after - 1].time[-1]
                yield Hold(hold, plan.name, limb, float(begin), float(end))


def _track(plan: RobotPlan, robot: Robot) -> tuple[Vector, Vector]:
    """All sample times of a robot [s], each once, and its positions then."""
    motions = [Motion.samples(phase, plan, robot) for phase in plan.phases]
    time, place = np.unique(np.concatenate([motion.time for motion in motions]), return_index=True)
    return time, np.concatenate([motion.q for motion in motions])[place]


def _nearest(one: Sequence[Placed], two: Sequence[Placed]) -> tuple[Vector, Indices]:
    """Least distance of two robots at K instants [m], shape (K,), and the places of the two parts, shape (K, 2).

    Disks around the parts tell which pairs can be the nearest; only these are measured.
    """
    pairs = [
        (i, j)
        for i, a in enumerate(one)
        for j, b in enumerate(two)
        if a.outline.extent[0] < b.outline.extent[1] and b.outline.extent[0] < a.outline.extent[1]
    ]
    count = len(one[0].middle)
    best, which = np.full(count, np.inf), np.zeros((count, 2), dtype=np.int64)
    apart = {(i, j): np.linalg.norm(one[i].middle - two[j].middle, axis=1) for i, j in pairs}
    sizes = {(i, j): one[i].outline.size + two[j].outline.size for i, j in pairs}
    for i, j in sorted(pairs, key=lambda pair: float((apart[pair] - sizes[pair]).min())):
        near = np.flatnonzero(apart[i, j] - sizes[i, j] < best)
        if len(near):
            a, b = one[i], two[j]
            found = gap(shapely.distance(a.shapes(near), b.shapes(near)), a.outline.radius + b.outline.radius)
            closer = found < best[near]
            best[near[closer]], which[near[closer]] = found[closer], (i, j)
    return best, which
