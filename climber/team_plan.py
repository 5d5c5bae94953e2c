"""Plans for teams: several robots on one wall, each with its own stance graph, one task plan for all.

    each robot alone, until its own climb has a motion -> what fails anyway is known before they are asked together
    task plan for all -> every robot's motions -> all on one clock -> plan
          ^                       |                     |
          +---- what failed is learnt, and asked again -+

Stances whose outlines would overlap with the pelvis amid the feet are kept apart from the beginning; what else two
robots cannot do at the same time shows in their motions. Neither is proof that no other postures would do, so that what
is shortest and cheapest is so relative to the pairs kept apart.
"""

from __future__ import annotations

import itertools
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from climber.climb_search import ClimbSearch, Report, decode
from climber.crowding import Crowding
from climber.exceptions import NoPlanFound
from climber.graph import build_stance_graph
from climber.lessons import Lessons, OnFailure
from climber.meetings import Conflict
from climber.motion import MotionPlanner
from climber.phases import Way
from climber.plan_parts import Fact, RobotPlan
from climber.product import ProductPlanner
from climber.prune import impossible_moves
from climber.scenario import Scenario
from climber.states import WAIT
from climber.task import Impossible, OutOfTime, TaskPlan, TaskPlanner, Walk
from climber.team import SAME, Team, TeamMotion, by_step

ROOM = 0.02  # [m] that stars of straight limbs keep from one another, since knees stick out


def plan_team(
    scenario: Scenario, seed: int, time_limit: float, report: Report
) -> tuple[tuple[RobotPlan, ...], dict[str, float]]:
    """Plans for several robots; the plan of each, and seconds spent in each stage.

    Raises:
        ScenarioError: If the scenario does not fit a robot, or a start cannot be held.
        NoPlanFound: If there is no climb for all, or none was found within the budget.
    """
    search = TeamSearch(scenario, seed, time_limit, report)
    return search.run(), search.timings()


class Recorder:
    """Passes on to a task planner what it is told about its only robot, to tell another one the same."""

    def __init__(self, tasks: TaskPlanner) -> None:
        self._tasks = tasks
        self._told: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def tell(*arguments: Any, **named: Any) -> Any:
            self._told.append((name, arguments, named))
            return getattr(self._tasks, name)(*arguments, **named)

        return tell

    def repeat(self, tasks: TaskPlanner, robot: int) -> None:
        """Tells another task planner all of it, about a robot of that number there."""
        for name, arguments, named in self._told:
            if name in ("cut", "penalise"):
                getattr(tasks, name)(*arguments, **{**named, "robot": robot})
            elif name != "plan":
                getattr(tasks, name)(*(robot, *arguments[1:]), **named)


def without_waits(walk: Walk) -> Walk:
    """The walk as the robot would take it alone, going on where it waits."""
    moves = [t for t, edge in enumerate(walk.edges) if edge != WAIT]
    after = [0, *(t + 1 for t in moves)]
    return replace(
        walk,
        vertices=tuple(walk.vertices[t] for t in after),
        edges=tuple(walk.edges[t] for t in moves),
        components=tuple(walk.components[t] for t in after),
        visits=tuple(sum(t < visit for t in moves) for visit in walk.visits),
    )


class TeamSearch:
    """A team's search for a climb.

    Attributes:
        scenario: The scenario.
        members: The search of each robot, which keeps its record.
    """

    def __init__(self, scenario: Scenario, seed: int, time_limit: float, report: Report) -> None:
        self.began = clock.perf_counter()
        self.scenario, self._limit, self._report = scenario, time_limit, report
        count = len(scenario.robots)
        self.members = [ClimbSearch(scenario, seed, time_limit, report, index) for index in range(count)]
        for member in self.members:
            began = clock.perf_counter()
            member.graph = build_stance_graph(member.body.wall, member.robot, member.stance, scenario.cost)
            member.times["graph"] = clock.perf_counter() - began
        self._team = Team([member.body for member in self.members], rate=scenario.budget.sample_rate_hz)
        self._recorders = [Recorder(TaskPlanner([member.task()])) for member in self.members]
        on_failure = cast(OnFailure, scenario.on_failure)
        self._lessons = [
            Lessons(member.graph, cast(TaskPlanner, recorder), on_failure)
            for member, recorder in zip(self.members, self._recorders, strict=True)
        ]
        self._share()
        self._ways: list[dict[Any, Way]] = [{} for _ in self.members]
        self._kept_apart, self._replans = 0, 0
        self._times = {"task": 0.0, "team": 0.0}

    def timings(self) -> dict[str, float]:
        """Seconds spent in each stage by all robots together, and in all."""
        result, finders = dict(self._times), set()
        for member in self.members:
            for name, seconds in member.timings().items():
                if name != "transitions" or member.finder not in finders:  # robots that are alike share one
                    result[name] = result.get(name, 0.0) + seconds
            finders.add(member.finder)
        return {**result, "total": clock.perf_counter() - self.began}

    def run(self) -> tuple[RobotPlan, ...]:
        """Plans, learns from what failed and plans again until all have a motion on one clock."""
        for index in range(len(self.members)):
            self._alone(index)
        tasks = ProductPlanner([member.task() for member in self.members], Crowding(self.members, ROOM))
        for index, (recorder, lessons) in enumerate(zip(self._recorders, self._lessons, strict=True)):
            recorder.repeat(tasks, index)
            lessons.tasks, lessons.robot = tasks, index
        for number in range(self.scenario.budget.replans + 1):
            proposal, self._replans = self._propose(tasks), number
            self._report(f"the team needs {proposal.makespan} steps of cost {proposal.cost}")
            # Postures are quickly found missing, motions are not.
            surveyed = [self._surveyed(index, walk) for index, walk in enumerate(proposal.walks)]
            if not all(surveyed):
                continue
            moved = [self._moved(index, walk) for index, walk in enumerate(proposal.walks)]
            ways = [way for way in moved if way is not None]
            if len(ways) < len(moved):
                continue
            motion = self._together(proposal, ways)
            if isinstance(motion, TeamMotion):
                return self._plans(proposal, self._improved(proposal, ways, motion))
            for conflict in motion:
                self._keep_apart(tasks, proposal, conflict)
        raise self._none("the task planner was asked as often as the budget allows")

    def _together(self, proposal: TaskPlan, ways: Sequence[Way]) -> TeamMotion | tuple[Conflict, ...]:
        """The robots' motions on one clock, or what is in the way of that."""
        began = clock.perf_counter()
        steps = [
            by_step(way.chained(), [edge != WAIT for edge in walk.edges])
            for way, walk in zip(ways, proposal.walks, strict=True)
        ]
        motion = self._team.synchronise(steps)
        self._times["team"] += clock.perf_counter() - began
        return motion

    def _improved(self, proposal: TaskPlan, ways: list[Way], motion: TeamMotion) -> TeamMotion:
        """The team's motion with each robot's improved, where that keeps them clear; if time matters, no later."""
        for index, member in enumerate(self.members):
            better = member.improved(ways[index], 1.0 / len(ways))
            if better is ways[index]:
                continue
            tried = [better if other == index else way for other, way in enumerate(ways)]
            after = self._together(proposal, tried)
            if isinstance(after, TeamMotion):
                hurried = member.planner.objective.kind == "time"
                if not hurried or after.starts[-1] <= motion.starts[-1] + SAME:
                    ways, motion = tried, after
        return motion

    def _share(self) -> None:
        """Finds robots that are alike on the same graph: what one learns of postures the others need not find out."""
        self._alike = [[index] for index in range(len(self.members))]
        for i, j in itertools.combinations(range(len(self.members)), 2):
            one, two = self.members[i], self.members[j]
            same_model = one.spec.model == two.spec.model and one.spec.avoid == two.spec.avoid
            names = ("stances", "tail", "head", "limb")
            if same_model and all(np.array_equal(getattr(one.graph, name), getattr(two.graph, name)) for name in names):
                self._alike[i].append(j)
                self._alike[j].append(i)
                if two.finder is not one.finder:
                    two.finder = one.finder
                    two.planner = MotionPlanner(one.finder, two.planner.budget, two.planner.objective.kind)

    def _alone(self, index: int) -> None:
        """Searches a climb for one robot as if it were alone, for what is learnt."""
        member, recorder = self.members[index], self._recorders[index]
        if member.spec.avoid.holds:
            heads = member.graph.stances[member.graph.head]
            recorder.cut(np.flatnonzero(np.isin(heads, member.spec.avoid.holds).any(axis=1)))
        ends = None if member.spec.waypoints else member.vertices(member.spec.goal)
        recorder.cut(impossible_moves(member.graph, member.robot, member.body.wall, ends))
        for _ in range(self.scenario.budget.replans + 1):
            proposal = self._propose(cast(TaskPlanner, recorder))
            (walk,) = proposal.walks
            if self._surveyed(index, walk) and self._moved(index, walk) is not None:
                self._report(f"{member.spec.name} alone needs {proposal.makespan} moves")
                return
        raise self._none("the task planner was asked as often as the budget allows")

    def _propose(self, tasks: TaskPlanner) -> TaskPlan:
        """The cheapest of the shortest climbs on what is left of the graphs."""
        began = clock.perf_counter()
        left = self._limit - (began - self.began)
        answer = tasks.plan(time_limit=left) if left > 0 else None
        self._times["task"] += clock.perf_counter() - began
        if answer is None or isinstance(answer, OutOfTime):
            raise self._none(f"the time limit of {self._limit:g} s came first")
        if isinstance(answer, Impossible):
            raise self._none(answer.reason)
        return answer

    def _surveyed(self, index: int, walk: Walk) -> bool:
        """Whether one robot has postures to let go and to take hold in all along its walk; else it is learnt."""
        member, walk = self.members[index], without_waits(walk)
        moves = decode(member.graph, member.stance, walk.edges)
        failures = member.finder.survey(member.start.contacts, moves)
        for failure in failures:
            member.record(moves, failure.index, failure.failure, failure.stage, failure.end)
            for other in self._alike[index]:
                if other == index or failure.end is not None:
                    self._lessons[other].no_posture(walk, failure)
        return not failures

    def _moved(self, index: int, walk: Walk) -> Way | None:
        """The motion of one robot along its walk, or None if something was learnt instead."""
        member, lessons, walk = self.members[index], self._lessons[index], without_waits(walk)
        key = walk.edges, walk.components, walk.visits
        if key not in self._ways[index]:
            moves = decode(member.graph, member.stance, walk.edges)
            stances = [member.stance, *(move.end for move in moves)]
            regions, choices = member.regions(walk), lessons.choices(walk, stances)
            free = not member.spec.start_posture
            outcome = member.planner.plan(member.start, moves, regions, choices, free)
            if not isinstance(outcome, Way):
                member.learn(lessons, walk, moves, outcome)
                return None
            self._ways[index][key] = outcome
        return self._ways[index][key]

    def _keep_apart(self, tasks: ProductPlanner, proposal: TaskPlan, conflict: Conflict) -> None:
        """Tells the task planner of what two robots cannot do at the same time."""
        step, sides = conflict.step, (conflict.one, conflict.two)
        (i, _), (j, _) = sides
        one, two = proposal.walks[i], proposal.walks[j]
        self._kept_apart += 1
        names = " and ".join(self.members[robot].spec.name for robot in (i, j))
        links = " and ".join(conflict.encounter.links)
        self._report(f"in step {step + 1} {names} come too close, {links} ({conflict.standing or 'on the way'})")
        at = {"start": step, "end": step + 1, None: 0}[conflict.standing]
        if at:
            tasks.exclude((i, j), one.vertices[at], two.vertices[at])
            return
        deeds = [
            (robot, doing, walk.edges[step] if doing == "move" else walk.vertices[step])
            for (robot, doing), walk in zip(sides, (one, two), strict=True)
        ]
        tasks.conflict(deeds[0], deeds[1])

    def _plans(self, proposal: TaskPlan, motion: TeamMotion) -> tuple[RobotPlan, ...]:
        """The robots' plans as they go into the file."""
        self._report(f"the robots keep {1e3 * motion.nearest.distance:.0f} mm apart at least")
        plans = []
        for member, walk, phases in zip(self.members, proposal.walks, motion.phases, strict=True):
            own = without_waits(walk)
            plan = member.robot_plan(proposal, own, decode(member.graph, member.stance, own.edges), list(phases))
            relative = "the team's stance graphs less the cuts and the pairs of stances and moves kept apart"
            more: dict[str, Fact] = {
                "steps": proposal.makespan,
                "pairs_kept_apart": self._kept_apart,
                "replans": self._replans,
                "relative_to": relative,
            }
            plans.append(replace(plan, proofs={**plan.proofs, **more}))
        return tuple(plans)

    def _none(self, reason: str) -> NoPlanFound:
        cuts = [cut for member in self.members for cut in member.cuts]
        return NoPlanFound(
            f"{self.scenario.name}: no climb was found, which does not prove that none exists: {reason}; "
            f"{len(cuts)} moves were given up, {self._kept_apart} times robots came too close",
            proved=False,
            cuts=cuts,
            counts=self.members[0].graph.counts,
            scenario=self.scenario,
        )
