"""The figures of Gönen's table 5.1 for scenarios of ours, over several seeds, and the published ones."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from climber.exceptions import NoPlanFound
from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.scenario import Scenario

GRAPH, TASK, MOTION = ("graph",), ("task",), ("transitions", "motion", "torque", "improve", "team")


@dataclass(frozen=True)
class Published:
    """A row of table 5.1 of Gönen (2021), as printed; None where the copy at hand cannot be read.

    Attributes:
        number: Of the scenario.
        makespan: Time steps. Those of scenarios 2, 3 and 5 are from section 5.1; the plan that it prints for scenario 2
            has one move more than the 9 that it speaks of.
        states: Time of the state creator [s].
        edges: Time of the edge creator [s]; that of scenario 3 without its decimals.
        task: Time of task planning [s]; that of scenario 5 is from section 5.1.5.
        optimum: Optimum path length, by RRT*.
        length: Average path length by RRT-Connect and its standard deviation.
        motion: Average time of motion planning and its standard deviation [s].
        replans: Number of replannings; that of scenario 3 is from section 5.1.3.
    """

    number: int
    makespan: str
    states: str | None = None
    edges: str | None = None
    task: str | None = None
    optimum: str | None = None
    length: str | None = None
    motion: str | None = None
    replans: str | None = None


PUBLISHED = {
    "basic": Published(1, "12", "0.3", "0.5", "0.02", "32.205", "65.387 (6.867)", "141.5 (66.6)", "0"),
    "higher": Published(2, "9", None, "43.1", "1.4", "30.330", "55.507 (5.789)", "613.0 (225.3)", "0"),
    "wider": Published(3, "15", None, "152", "24.4", "49.187", "82.860 (6.363)", "688.4 (480.4)", "1"),
    "waypoint": Published(4, "15", "30.5", "152.3", "50.2", None, "72.081 (25.886)", "1647.7 (3118.2)", "0"),
    "team": Published(5, "15", task="63.3"),
}


@dataclass(frozen=True)
class Figures:
    """What planning a scenario came to, seed by seed.

    Attributes:
        scenario: Its name.
        seeds: The seeds that gave a plan.
        failed: Those that gave none.
        makespan: Moves, or steps of a team.
        graph: Time for the stance graph [s].
        task: Time for task planning [s].
        motion: Time for postures, paths, their refinement and their timing [s].
        length: Length in joint space, of all robots together [m, rad].
        duration: Of the motion [s].
        replans: How often the task planner was asked again.
    """

    scenario: str
    seeds: tuple[int, ...]
    failed: tuple[int, ...]
    makespan: tuple[int, ...]
    graph: tuple[float, ...]
    task: tuple[float, ...]
    motion: tuple[float, ...]
    length: tuple[float, ...]
    duration: tuple[float, ...]
    replans: tuple[int, ...]

    @property
    def optimum(self) -> float | None:
        """The least length of all seeds [m, rad]; None if none gave a plan."""
        return min(self.length, default=None)

    def to_dict(self) -> dict[str, Any]:
        """The figures seed by seed, their means and standard deviations, and what is published."""
        summary: dict[str, Any] = {"optimum_length": self.optimum}
        for name in ("makespan", "graph", "task", "motion", "length", "duration", "replans"):
            values = getattr(self, name)
            summary |= {f"mean_{name}": mean(values), f"deviation_{name}": deviation(values)}
        published = PUBLISHED.get(self.scenario)
        return {**asdict(self), **summary, "published": None if published is None else asdict(published)}


def mean(values: Sequence[float]) -> float | None:
    """The mean; None of nothing."""
    return statistics.fmean(values) if values else None


def deviation(values: Sequence[float]) -> float | None:
    """The standard deviation of a sample; None of fewer than two."""
    return statistics.stdev(values) if len(values) > 1 else None


def measure(
    scenario: Scenario,
    seeds: Sequence[int],
    improve: float | None = None,
    report: Callable[[str], None] = lambda message: None,
) -> Figures:
    """Plans a scenario once for every seed.

    Args:
        scenario: The scenario.
        seeds: The seeds.
        improve: Time for improving each climb; the scenario's if left out [s].
        report: Called with a sentence when a seed is done.
    """
    plans: dict[int, Plan] = {}
    failed = []
    for seed in seeds:
        try:
            plan = plans[seed] = plan_climb(scenario, seed=seed, improve=improve)
        except NoPlanFound:
            failed.append(seed)
            report(f"{scenario.name}, seed {seed}: no plan")
            continue
        report(f"{scenario.name}, seed {seed}: length {length(plan):.2f}, {plan.timings['total']:.1f} s")
    found = list(plans.values())
    return Figures(
        scenario=scenario.name,
        seeds=tuple(plans),
        failed=tuple(failed),
        makespan=tuple(_fact(plan, "steps", sum(robot.moves for robot in plan.robots)) for plan in found),
        graph=tuple(_seconds(plan, GRAPH) for plan in found),
        task=tuple(_seconds(plan, TASK) for plan in found),
        motion=tuple(_seconds(plan, MOTION) for plan in found),
        length=tuple(length(plan) for plan in found),
        duration=tuple(max(robot.duration for robot in plan.robots) for plan in found),
        replans=tuple(_fact(plan, "replans", 0) for plan in found),
    )


def length(plan: Plan) -> float:
    """Length in joint space of all robots' motions [m, rad]."""
    phases = [phase for robot in plan.robots for phase in robot.phases]
    return float(sum(np.linalg.norm(np.diff(phase.q, axis=0), axis=1).sum() for phase in phases))


def _seconds(plan: Plan, stages: tuple[str, ...]) -> float:
    return sum(plan.timings.get(stage, 0.0) for stage in stages)


def _fact(plan: Plan, name: str, otherwise: int) -> int:
    """A whole number among what was proved about a plan."""
    fact = plan.robots[0].proofs.get(name, otherwise)
    return int(fact) if isinstance(fact, int) else otherwise
