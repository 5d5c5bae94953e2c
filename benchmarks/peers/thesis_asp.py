"""The thesis's task planner: multi-shot answer set programming (Gönen 2021, section 4.3 and listing A.1) on poses.

Straight from the text: the whole graph as facts, one more step grounded for each number of moves from zero up, until
there is a plan. Kept plain on purpose; `literal.lp` is the listing, `lean.lp` the same problem in fewer rules.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import clingo

Edge = tuple[Sequence[int], Sequence[int], int]  # the holds of the pose before, those of the pose after, cost


@dataclass(frozen=True)
class PeerPlan:
    """What came out, and the time it took [s]."""

    makespan: int
    cost: int
    seconds: float
    ground_seconds: float
    rules: int


def pose(holds: Sequence[int]) -> str:
    return f"pose({','.join(str(hold) for hold in sorted(holds))})"


def plan(
    edges: Iterable[Edge],
    start: Sequence[int],
    goal: Sequence[int],
    encoding: str = "literal",
    waypoint: Sequence[int] | None = None,
    other: tuple[Sequence[int], Sequence[int]] | None = None,
) -> PeerPlan:
    """The fewest moves between two poses, at least cost, proved.

    Args:
        edges: The graph of poses.
        start: Holds of the first pose.
        goal: Holds of the last pose.
        encoding: Name of the program beside this file.
        waypoint: Holds of a pose to be visited on the way.
        other: Holds of the first and the last pose of a second robot on the same wall; takes a `two_` encoding.
    """
    began = time.perf_counter()
    facts = [f"edge({pose(before)},{pose(after)},{cost})." for before, after, cost in edges]
    if other is None:
        facts += [f"init({pose(start)}).", f"goal({pose(goal)})."]
    else:
        for robot, ends in enumerate(((start, goal), other)):
            facts += [f"robot({robot}).", f"init({robot},{pose(ends[0])}).", f"goal({robot},{pose(ends[1])})."]
    programs = [encoding] if waypoint is None else [encoding, "waypoint"]
    if waypoint is not None:
        facts.append(f"waypoint({pose(waypoint)}).")
    text = "\n".join((Path(__file__).parent / f"{program}.lp").read_text() for program in programs)
    control = clingo.Control(["--opt-mode=opt", "--models=0", "--warn=none"])
    control.add("base", [], text + "\n".join(facts))
    ground_seconds, step = 0.0, 0
    while True:
        t = clingo.Number(step)
        parts = [("check", [t]), ("step", [t]) if step else ("base", [])]
        before_grounding = time.perf_counter()
        if step:
            control.release_external(clingo.Function("query", [clingo.Number(step - 1)]))
        control.ground(parts)
        control.assign_external(clingo.Function("query", [t]), True)
        ground_seconds += time.perf_counter() - before_grounding
        costs: list[int] = []
        control.solve(on_model=lambda model, costs=costs: costs.append(sum(model.cost)))  # type: ignore[misc]
        if costs:
            rules = int(control.statistics["problem"]["lp"]["rules"])
            return PeerPlan(step, costs[-1], time.perf_counter() - began, ground_seconds, rules)
        step += 1
