"""One robot's search for a climb: what is proposed, what fails and what is learnt from that, and what is kept of it.

`climber.plan` tells the story of it; `climber.team_plan` has one of these for each robot of a team.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
from shapely.geometry.base import BaseGeometry

from climber.demands import Demands
from climber.exceptions import NoPlanFound
from climber.graph import build_stance_graph
from climber.improve import Improver, Progress
from climber.lessons import Lessons, OnFailure
from climber.manifold import Body, Margins
from climber.margins import phase_margins
from climber.motion import DeadEnd, EmptyPiece, MotionPlanner, Regions
from climber.phase_motion import MotionBudget, PhaseMotion
from climber.phases import Way
from climber.plan_parts import Achieved, Cut, ObjectiveKind, Phase, RobotPlan
from climber.plan_phase import phase_of
from climber.prune import impossible_moves
from climber.regrasp import rigid, with_regrasps
from climber.robot import Model, Robot
from climber.scenario import Place, Scenario, check_against_robot
from climber.stance import Move, Stance
from climber.stance_graph import StanceGraph
from climber.start import start_postures
from climber.task import Impossible, OutOfTime, RobotTask, TaskPlan, TaskPlanner, Walk
from climber.transition import Failure
from climber.transitions import Effort, MoveFailure, TransitionFinder

Report = Callable[[str], None]
EFFORTS = (1, 4)  # multiples of the budget for postures and paths that are spent before giving up
ASKED_BALANCE = 0.001  # [m] from the border of the support, where the margins that count are asked for by name


@dataclass
class ClimbSearch:
    """One robot's search for a climb, and its record.

    Attributes:
        scenario: The scenario.
        seed: Of all random numbers.
        time_limit: [s].
        report: Called with news.
        index: Which of the scenario's robots.
        cuts: What was given up, in order.
    """

    scenario: Scenario
    seed: int
    time_limit: float
    report: Report
    index: int = 0
    cuts: list[Cut] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.began = clock.perf_counter()
        self.times = {"graph": 0.0, "task": 0.0, "improve": 0.0}
        scenario = self.scenario
        self.spec = scenario.robots[self.index]
        # What this robot must not enter is an obstacle to it.
        wall = scenario.planning_wall().closing(self.spec.avoid.regions)
        self.robot = Robot(Model.load(self.spec.model, scenario.folder), wall.gravity)
        if len(scenario.robots) > 1 and not self.robot.planar:
            allowed = "a planar robot, as several climb"
            raise scenario.error(f"robots[{self.index}].model", self.spec.model, allowed)
        check_against_robot(scenario, self.index, self.robot.limb_names, self.robot.joint_limits, self.robot.planar)
        self.demands = Demands.of(scenario.build_wall(), scenario.min_margin)
        self.body = Body(self.robot, wall, self.demands)
        usual = Margins()
        # Margins that are asked for by name take the place of the one that is kept for no reason given.
        asked = max(ASKED_BALANCE, self.demands.balance)
        margins = replace(usual, balance=asked) if self.demands.least else usual
        self.finder = TransitionFinder(self.body, np.random.default_rng(self.seed), Effort.of(scenario.budget), margins)
        objective = cast(ObjectiveKind, scenario.objective)
        self.planner = MotionPlanner(self.finder, MotionBudget.of(scenario.budget), objective)
        self.progress = Progress()
        self.replans = -1  # how often the task planner was asked again
        self.stance = Stance(tuple(self.spec.start[name] for name in self.robot.limb_names))
        self.start = start_postures(scenario, self.index, self.finder, self.stance)

    def timings(self) -> dict[str, float]:
        """Seconds spent in each stage, and in all."""
        spent = {**self.times, "transitions": self.finder.seconds, **self.planner.seconds}
        return {**spent, "total": clock.perf_counter() - self.began}

    def run(self) -> RobotPlan:
        """Plans, learns from what failed and plans again until a climb has a motion or there is none left."""
        began = clock.perf_counter()
        avoid = self.spec.avoid.holds
        self.graph = build_stance_graph(self.body.wall, self.robot, self.stance, self.scenario.cost, avoid)
        if rigid(self.body):  # no shift leads from one posture of a stance to another
            self.graph = with_regrasps(self.graph, self.body, self.scenario.cost)
        self.times["graph"] = clock.perf_counter() - began
        self.report(f"stance graph: {self.graph.num_vertices} stances, {self.graph.num_edges} moves")
        reason = ""
        for effort in EFFORTS:
            self.finder.try_harder(Effort.of(self.scenario.budget, effort))
            self.planner.budget = MotionBudget.of(self.scenario.budget, effort)
            answer = self._search()
            if isinstance(answer, RobotPlan):
                return answer
            reason = answer.reason
            if all(cut.kind == "proved" for cut in self.cuts):
                raise self._none(reason, proved=True, lessons=self.lessons)
            self.report(f"{reason}; where searches gave up, they are made again with more effort")
        raise self._none(reason, proved=False, lessons=self.lessons)

    def task(self) -> RobotTask:
        """What the task planner is asked for this robot."""
        graph, spec = self.graph, self.spec
        return RobotTask(
            graph.num_vertices,
            graph.tail,
            graph.head,
            graph.cost,
            graph.start,
            self.vertices(spec.goal),
            graph.stances,
            tuple(self.vertices(place) for place in spec.waypoints),
            spec.waypoint_order == "given",
        )

    def vertices(self, place: Place) -> np.typing.NDArray[np.int32]:
        """The vertices that a goal or waypoint stands for."""
        stance = None if place.stance is None else Stance(tuple(place.stance[name] for name in self.robot.limb_names))
        region = None if place.pelvis is None else place.pelvis.inside()
        return self.graph.goal_vertices(holds=place.holds, stance=stance, region=region)

    def _search(self) -> RobotPlan | Impossible:
        """Searches with the effort set, having forgotten what was given up on but not what was proved."""
        began = clock.perf_counter()
        tasks = TaskPlanner([self.task()])
        self.lessons = lessons = Lessons(self.graph, tasks, cast(OnFailure, self.scenario.on_failure), cuts=self.cuts)
        ends = None if self.spec.waypoints else self.vertices(self.spec.goal)
        tasks.cut(impossible_moves(self.graph, self.robot, self.body.wall, ends))
        self.times["task"] += clock.perf_counter() - began
        for _ in range(self.scenario.budget.replans + 1):
            proposal = self._propose(tasks)
            self.replans += 1
            if isinstance(proposal, Impossible):
                return proposal
            (walk,) = proposal.walks
            moves = decode(self.graph, self.stance, walk.edges)
            failures = self.finder.survey(self.start.contacts, moves)
            for failure in failures:
                self.record(moves, failure.index, failure.failure, failure.stage, failure.end)
                lessons.no_posture(walk, failure)
            if failures:
                continue
            self.report(f"{len(moves)} moves of cost {proposal.cost} have postures at every transition")
            stances = [self.stance, *(move.end for move in moves)]
            pieces = lessons.choices(walk, stances)
            free = not self.spec.start_posture
            outcome = self.planner.plan(self.start, moves, self.regions(walk), pieces, free)
            if isinstance(outcome, Way):
                return self.robot_plan(proposal, walk, moves, self.improved(outcome).chained())
            self.learn(lessons, walk, moves, outcome)
        raise self._none("the task planner was asked as often as the budget allows", proved=False)

    def improved(self, way: Way, share: float = 1.0) -> Way:
        """The climb after as many rounds of improvement, and as much time, as the budget allows.

        Args:
            way: The climb.
            share: What is there for this robot, of the time.
        """
        began, timing = clock.perf_counter(), self.planner.phases.timing
        improver = Improver(self.planner.phases, self.planner.budget, self.seed)
        budget = self.scenario.budget
        way, self.progress = improver.improve(way, self.began, budget.improve_rounds, share * budget.improve_s)
        self.times["improve"] += clock.perf_counter() - began
        self.planner.phases.timing = timing  # of the plan; what the improver timed is in its own time
        return way

    def regions(self, walk: Walk) -> Regions:
        """Where the pelvis must come to rest, by how many moves are complete: waypoints, and at last the goal."""
        stops: dict[int, list[BaseGeometry | None]] = {}
        visits = sorted(zip(walk.visits, self.spec.waypoints, strict=True), key=lambda visit: visit[0])
        for after, place in visits:
            if place.pelvis is not None:
                stops.setdefault(after, []).append(place.pelvis.inside())
        goal = self.spec.goal.pelvis
        stops.setdefault(len(walk.edges), []).append(None if goal is None else goal.inside())
        return stops

    def learn(
        self, lessons: Lessons, walk: Walk, moves: list[Move], outcome: MoveFailure | DeadEnd | EmptyPiece
    ) -> None:
        """Records why a climb has no motion, and tells the task planner."""
        if isinstance(outcome, MoveFailure):
            self.record(moves, outcome.index, outcome.failure, outcome.stage, outcome.end)
            lessons.no_posture(walk, outcome)
        elif isinstance(outcome, DeadEnd):
            failure = outcome.failure
            self.record(moves, failure.index, failure.failure, failure.stage, outcome.purpose)
            lessons.dead_end(walk, outcome)
        else:
            reason = Failure("budget", "no posture found in the piece of the stance's postures that was left")
            index = outcome.index - (outcome.missing == "swing")
            self.record(moves, index, reason, "motion", outcome.missing)
            lessons.empty_piece(walk, outcome)

    def _propose(self, tasks: TaskPlanner) -> TaskPlan | Impossible:
        """The cheapest of the shortest climbs on what is left of the graph."""
        left = self.time_limit - (clock.perf_counter() - self.began)
        answer = None
        if left > 0:
            began = clock.perf_counter()
            answer = tasks.plan(time_limit=left)
            self.times["task"] += clock.perf_counter() - began
        if answer is None or isinstance(answer, OutOfTime):
            raise self._none(f"the time limit of {self.time_limit:g} s came first", proved=False)
        return answer

    def _none(self, reason: str, *, proved: bool, lessons: Lessons | None = None) -> NoPlanFound:
        """The answer that there is no plan, with what was learned if the search came to its end."""
        budget = sum(cut.kind == "budget" for cut in self.cuts)
        verdict = (
            "no climb exists on the stance graph"
            if proved
            else "no climb was found, which does not prove that none exists"
        )
        cuts = (
            f"{len(self.cuts)} moves were given up, {budget} of them because a search ended without finding any motion"
        )
        given_up = cuts if self.cuts else "no move was given up"
        return NoPlanFound(
            f"{self.scenario.name}: {verdict}: {reason}; {given_up}{self._asked()}",
            proved=proved,
            cuts=self.cuts,
            removed=[] if lessons is None else lessons.moves_removed(),
            reached=None if lessons is None else lessons.reached(),
            counts=self.graph.counts,
            scenario=self.scenario,
            robot=self.index,
        )

    def _asked(self) -> str:
        """The margins asked for and one that was short, for the end of a sentence."""
        if not self.demands.least:
            return ""
        short = next((cut.reason for cut in self.cuts if "the margin of" in cut.reason), "")
        return f"; margins asked for: {self.demands.told()}" + (f"; {short}" if short else "")

    def record(self, moves: list[Move], index: int, failure: Failure, stage: str, where: str | None) -> None:
        """Notes a move that was given up, or the last one if the trouble is at the end."""
        if not moves:
            raise self._none(f"the pelvis cannot reach its goal: {failure.reason}", proved=False)
        move, limbs = moves[min(index, len(moves) - 1)], self.robot.limb_names
        told = {
            "leave": "letting go",
            "arrive": "taking hold",
            "let go": "shifting to let go",
            "swing": "swinging",
            "region": "bringing the pelvis where it must be",
        }.get(where or "", "on the way")
        self.cuts.append(
            Cut(
                stance=dict(zip(limbs, move.start.holds, strict=True)),
                limb=limbs[move.limb],
                hold=move.hold,
                reason=f"{told}: {failure.reason}",
                kind=failure.kind,
                stage=stage,  # type: ignore[arg-type]
            )
        )
        self.report(f"gave up {limbs[move.limb]} from {move.released} to {move.hold}, {told}: {failure.reason}")

    def robot_plan(self, proposal: TaskPlan, walk: Walk, moves: list[Move], motions: list[PhaseMotion]) -> RobotPlan:
        """The plan of this robot, as it goes into the file."""
        robot, limbs = self.robot, self.robot.limb_names
        objective = self.planner.objective
        value = objective.value(self.body, motions)
        progress = self.progress.ending(clock.perf_counter() - self.began, value)
        stances = [self.stance, *(move.end for move in moves)]
        return RobotPlan(
            name=self.spec.name,
            model=self.spec.model,
            limbs=limbs,
            positions=robot.position_names,
            velocities=robot.velocity_names,
            joints=robot.joint_names,
            moves=len(moves),
            cost=walk.cost,
            stances=tuple(dict(zip(limbs, stance.holds, strict=True)) for stance in stances),
            phases=self._phases(motions),
            cuts=tuple(self.cuts),
            counts={name: int(count) for name, count in self.graph.counts.items()},
            proofs={
                "moves": proposal.proofs.makespan_proved,
                "cost": proposal.proofs.cost_proved,
                "relative_to": "the stance graph less the cuts",
                "replans": self.replans,
            },
            objective=Achieved(objective.kind, value),
            record=progress.entries,
        )

    def _phases(self, motions: list[PhaseMotion]) -> tuple[Phase, ...]:
        began = clock.perf_counter()
        margins = phase_margins(self.robot, self.demands.wall, motions)
        self.times["margins"] = clock.perf_counter() - began
        return tuple(phase_of(self.robot, self.body.wall, *parts) for parts in zip(motions, margins, strict=True))


def decode(graph: StanceGraph, start: Stance, edges: tuple[int, ...]) -> list[Move]:
    """The moves of ordered stances that a walk through the graph stands for, from the start stance itself."""
    old, new = graph.released, graph.taken
    moves: list[Move] = []
    stance = start
    for edge in edges:
        move = Move(stance, stance.holds.index(int(old[edge])), int(new[edge]))
        moves.append(move)
        stance = move.end
    return moves
