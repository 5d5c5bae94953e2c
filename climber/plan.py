"""From a scenario to a plan: the whole story, stage by stage. Start reading here.

    scenario -> wall, robot -> stance graph -> task plan -> transitions -> motions -> better ones -> margins -> plan
                                   ^                              |             |
                                   +---- what failed is learnt, and asked again +

The task planner (`task`) proposes the cheapest of the shortest climbs on the stance graph (`graph`). Every move of it
must have postures to let go and to take hold in (`transitions`), and then a motion (`motion`): paths, shortened along
with the postures they meet in, and timed to be as fast as contact forces inside their limits and torques inside theirs
allow (`timing`). What has not is cut, or barred from a piece of the stance's postures, with the reason (`lessons`), and
the task planner asked again. What it returns is shortest and cheapest on the graph less these. Where searches gave up
for want of time rather than by proof and nothing is left, all of it is tried again, harder.

Along these moves the motion is chosen for the scenario's objective, length, time or margin (`objective`), and made
better for as long as there is time (`improve`). What its phases survive that is not as planned is worked out at the end
(`margins`); margins that were asked for have a say in which postures and timings will do (`demands`).

`climb_search` goes through these stages for one robot, `team_plan` for several on one wall. Nobody has to believe what
comes out: `verify` checks the plan from its file, without any part of the planner, and `simulate` climbs it in contact
simulation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import python_version

from climber.climb_search import ClimbSearch, Report
from climber.plan_file import Plan
from climber.plan_parts import MARGIN_KINDS, ObjectiveKind
from climber.scenario import Scenario
from climber.scenario_fields import ScenarioFields
from climber.team_plan import plan_team
from climber.yaml_tree import check_given

SOFTWARE = ("climber-drake", "drake", "clingo", "clarabel", "numpy", "scipy", "shapely")


def plan_climb(
    scenario: Scenario,
    *,
    seed: int | None = None,
    time_limit: float | None = None,
    objective: ObjectiveKind | None = None,
    improve: float | None = None,
    min_margin: Mapping[str, float] | None = None,
    report: Report = lambda message: None,
) -> Plan:
    """Plans the climb that a scenario asks for.

    Args:
        scenario: The scenario, see `climber.load_scenario`.
        seed: Replaces the scenario's seed.
        time_limit: Replaces the scenario's time limit [s].
        objective: Replaces the scenario's objective.
        improve: Replaces the scenario's time for improving a climb once there is one [s].
        min_margin: What every phase must survive at least, by kind; the scenario may ask for more.
        report: Called with a sentence whenever there is something to tell.

    Returns:
        The plan. Whoever doubts it asks `climber.verify`.

    Raises:
        ScenarioError: If the scenario does not fit the robot, or its start cannot be held, or what replaces a field of
            it is not what the field may be.
        ModelError: If the robot's model cannot be planned for.
        NoPlanFound: If there is no climb (`proved`), or none was found within the budget.
    """
    _check(seed, time_limit, objective, improve, min_margin)
    seed = scenario.seed if seed is None else seed
    limit = scenario.budget.time_limit_s if time_limit is None else time_limit
    if objective is not None:
        scenario = replace(scenario, objective=objective)
    if improve is not None:
        scenario = replace(scenario, budget=replace(scenario.budget, improve_s=improve))
    if min_margin is not None:
        scenario = replace(scenario, min_margin=scenario.min_margin.raised(min_margin))
    if len(scenario.robots) > 1:
        robots, timings = plan_team(scenario, seed, limit, report)
    else:
        search = ClimbSearch(scenario, seed, limit, report)
        robots, timings = (search.run(),), search.timings()
    return Plan(
        scenario_path=str(scenario.folder / Path(scenario.file).name),
        scenario_text=scenario.source,
        seed=seed,
        robots=robots,
        min_margin={kind: min_margin[kind] for kind in MARGIN_KINDS if kind in min_margin} if min_margin else {},
        software=software(),
        timings={name: round(seconds, 4) for name, seconds in timings.items()},
    )


def _check(
    seed: int | None,
    time_limit: float | None,
    objective: ObjectiveKind | None,
    improve: float | None,
    min_margin: Mapping[str, float] | None,
) -> None:
    """What takes the place of a scenario's fields must be what they may be."""
    budget = _without_none(time_limit_s=time_limit, improve_s=improve)
    check_given(
        _without_none(seed=seed, objective=objective, budget=budget, min_margin=min_margin), ScenarioFields, "arguments"
    )


def _without_none(**fields: object) -> dict[str, object]:
    return {name: value for name, value in fields.items() if value is not None}


def software() -> dict[str, str]:
    """Version of each program that has a part in a plan."""
    versions = {"python": python_version()}
    for name in SOFTWARE:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # run from a checkout that was never installed
            versions[name] = "unknown"
    return versions
