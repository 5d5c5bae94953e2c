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


def plan(edges: Iterable[Edge], start: Sequence[int], goal: Sequence[int], encoding: str = "literal") -> PeerPlan:
    """The fewest moves between two poses, at least cost, proved.

    Args:
        edges: The graph of poses.
        start: Holds of the first pose.
        goal: Holds of the last pose.
        encoding: Name of the program beside this file.
    """
    began = time.perf_counter()
    facts = [f"edge({pose(before)},{pose(after)},{cost})." for before, after, cost in edges]
    facts += [f"init({pose(start)}).", f"goal({pose(goal)})."]
    control = clingo.Control(["--opt-mode=opt", "--models=0", "--warn=none"])
    control.add("base", [], (Path(__file__).parent / f"{encoding}.lp").read_text() + "\n".join(facts))
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
