"""From a scenario to a plan: the whole story, stage by stage. Start reading here.

    scenario -> wall, robot -> stance graph -> task plan -> transitions -> motions -> plan
                                   ^                              |             |
                                   +---- cut the moves that failed, ask again --+

The task planner proposes the cheapest of the shortest climbs on the stance graph. Every move of it must have postures
to let go and to take hold in, and then a motion; a move that has not is cut, with the reason, and the task planner
asked again.
What it returns is shortest and cheapest on the graph less the cuts.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from platform import python_version

import numpy as np
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from climber.exceptions import NoPlanFound
from climber.graph import StanceGraph, build_stance_graph
from climber.manifold import Body
from climber.motion import MotionBudget, MotionPlanner, MoveFailure, PhaseMotion
from climber.plan_file import Cut, Phase, PhaseContact, Plan, RobotPlan
from climber.prune import impossible_moves
from climber.robot import Model, Robot
from climber.scenario import Scenario, check_against_robot
from climber.stance import Move, Stance
from climber.start import start_postures
from climber.task import Impossible, OutOfTime, TaskPlan, TaskPlanner

Report = Callable[[str], None]
SOFTWARE = ("climber-drake", "drake", "clingo", "clarabel", "numpy", "scipy", "shapely")


def plan_climb(
    scenario: Scenario,
    *,
    seed: int | None = None,
    time_limit: float | None = None,
    report: Report = lambda message: None,
) -> Plan:
    """Plans the climb that a scenario asks for.

    Args:
        scenario: The scenario, see `climber.load_scenario`.
        seed: Replaces the scenario's seed.
        time_limit: Replaces the scenario's time limit [s].
        report: Called with a sentence whenever there is something to tell.

    Returns:
        The plan. Whoever doubts it asks `climber.verify`.

    Raises:
        ScenarioError: If the scenario does not fit the robot, or its start cannot be held.
        ModelError: If the robot's model cannot be planned for.
        NoPlanFound: If there is no climb (`proved`), or none was found within the budget.
    """
    seed = scenario.seed if seed is None else seed
    search = _ClimbSearch(scenario, seed, scenario.budget.time_limit_s if time_limit is None else time_limit, report)
    robot_plan = search.run()
    return Plan(
        scenario_path=scenario.file,
        scenario_text=scenario.source,
        seed=seed,
        robots=(robot_plan,),
        software=_software(),
        timings={name: round(seconds, 4) for name, seconds in search.timings().items()},
    )


def _software() -> dict[str, str]:
    versions = {"python": python_version()}
    for name in SOFTWARE:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # run from a checkout that was never installed
            versions[name] = "unknown"
    return versions


@dataclass
class _ClimbSearch:
    """One robot's search for a climb, and its record."""

    scenario: Scenario
    seed: int
    time_limit: float
    report: Report
    cuts: list[Cut] = field(default_factory=list)
    times: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.began = clock.perf_counter()
        scenario = self.scenario
        _refuse_what_comes_later(scenario)
        self.spec = scenario.robots[0]
        wall = scenario.build_wall()
        # What this robot must not enter is an obstacle to it.
        off_limits = tuple(region.outline() for region in self.spec.avoid.regions)
        wall = replace(wall, obstacles=wall.obstacles + off_limits)
        self.robot = Robot(Model.load(self.spec.model, scenario.folder), wall.gravity)
        check_against_robot(scenario, 0, self.robot.limb_names, self.robot.joint_limits)
        self.body = Body(self.robot, wall)
        budget = scenario.budget
        self.planner = MotionPlanner(
            self.body,
            np.random.default_rng(self.seed),
            MotionBudget(
                samples=budget.posture_samples,
                postures=budget.postures,
                attempts=budget.path_attempts,
                iterations=budget.path_iterations,
                rate=budget.sample_rate_hz,
                slowest=budget.longest_phase_s,
            ),
        )
        self.start = Stance(tuple(self.spec.start[name] for name in self.robot.limb_names))
        self.region: BaseGeometry | None = None if self.spec.goal.pelvis is None else self.spec.goal.pelvis.inside()

    def timings(self) -> dict[str, float]:
        """Seconds spent in each stage, and in all."""
        return {**self.times, **self.planner.times, "total": clock.perf_counter() - self.began}

    def run(self) -> RobotPlan:
        """Plans, cuts and plans again until a climb has a motion or there is none left."""
        start = start_postures(self.scenario, 0, self.planner, self.start)
        graph, tasks = self._graph()
        for _ in range(self.scenario.budget.replans + 1):
            proposal = self._propose(graph, tasks)
            moves = decode(graph, self.start, proposal.edges)
            failures = self.planner.survey(start.contacts, moves)
            if not failures:
                self.report(f"{len(moves)} moves of cost {proposal.cost} have postures at every transition")
                outcome = self.planner.plan(start, moves, self.region)
                if not isinstance(outcome, MoveFailure):
                    return self._robot_plan(graph, proposal, moves, outcome)
                failures = [outcome]
            for failure in failures:
                self._cut(graph, tasks, proposal, moves, failure)
        raise self._none("the task planner was asked as often as the budget allows", graph, proved=False)

    def _graph(self) -> tuple[StanceGraph, TaskPlanner]:
        began = clock.perf_counter()
        graph = build_stance_graph(self.body.wall, self.robot, self.start, self.scenario.cost)
        goal = self.spec.goal
        stance = None if goal.stance is None else Stance(tuple(goal.stance[name] for name in self.robot.limb_names))
        goals = graph.goal_vertices(holds=goal.holds, stance=stance, region=self.region)
        tasks = TaskPlanner(graph.num_vertices, graph.tail, graph.head, graph.cost, graph.start, goals.tolist())
        tasks.cut(impossible_moves(graph, self.robot, self.body.wall, goals))
        if self.spec.avoid.holds:
            avoided = np.isin(graph.stances[graph.head], self.spec.avoid.holds).any(axis=1)
            tasks.cut(np.flatnonzero(avoided))
        self.times["graph"] = clock.perf_counter() - began
        self.times["task"] = 0.0
        self.report(f"stance graph: {graph.num_vertices} stances, {graph.num_edges} moves, {len(goals)} goal stances")
        return graph, tasks

    def _propose(self, graph: StanceGraph, tasks: TaskPlanner) -> TaskPlan:
        """The cheapest of the shortest climbs on what is left of the graph."""
        left = self.time_limit - (clock.perf_counter() - self.began)
        if left <= 0:
            raise self._none(f"the time limit of {self.time_limit:g} s came first", graph, proved=False)
        began = clock.perf_counter()
        answer = tasks.plan(time_limit=left)
        self.times["task"] += clock.perf_counter() - began
        if isinstance(answer, OutOfTime):
            raise self._none(f"the time limit of {self.time_limit:g} s came first", graph, proved=False)
        if isinstance(answer, Impossible):
            proved = all(cut.kind == "proved" for cut in self.cuts)
            raise self._none(answer.reason, graph, proved=proved)
        return answer

    def _none(self, reason: str, graph: StanceGraph, *, proved: bool) -> NoPlanFound:
        budget = sum(cut.kind == "budget" for cut in self.cuts)
        answer = "no climb exists" if proved else "no climb was found, which does not prove that none exists"
        cuts = (
            f"{len(self.cuts)} moves were given up, {budget} of them because a search ended without finding any motion"
        )
        return NoPlanFound(
            f"{self.scenario.name}: {answer}: {reason}; {cuts if self.cuts else 'no move was given up'}",
            proved=proved,
            cuts=self.cuts,
            counts=graph.counts,
        )

    def _cut(
        self, graph: StanceGraph, tasks: TaskPlanner, proposal: TaskPlan, moves: list[Move], failure: MoveFailure
    ) -> None:
        """Takes the failed move out of the graph, and with it every move that fails for the same reason."""
        # A final shift that fails condemns the stance it ends in, which is to say every move into it.
        index = min(failure.index, len(moves) - 1)
        if not moves:
            raise self._none(f"the pelvis cannot reach its goal: {failure.failure.reason}", graph, proved=False)
        edge, move = proposal.edges[index], moves[index]
        if failure.index == len(moves):
            edges = np.flatnonzero(graph.head == graph.head[edge])
        elif failure.end == "leave":
            # No posture lets this limb go here, wherever it goes.
            same = graph.tail == graph.tail[edge]
            edges = np.flatnonzero(same & (released(graph) == move.released))
        elif failure.end == "arrive":
            # No posture has this limb just arrived here, wherever it comes from.
            same = graph.head == graph.head[edge]
            edges = np.flatnonzero(same & (taken(graph) == move.hold))
        else:
            edges = np.array([edge])
        tasks.cut(edges)
        limbs = self.robot.limb_names
        self.cuts.append(
            Cut(
                stance=dict(zip(limbs, move.start.holds, strict=True)),
                limb=limbs[move.limb],
                hold=move.hold,
                reason=failure.failure.reason,
                kind=failure.failure.kind,
                stage=failure.stage,
            )
        )
        where = {"leave": "letting go", "arrive": "taking hold", None: "on the way"}[failure.end]
        self.report(f"cut {limbs[move.limb]} from {move.released} to {move.hold} ({where}): {failure.failure.reason}")

    def _robot_plan(
        self, graph: StanceGraph, proposal: TaskPlan, moves: list[Move], motions: list[PhaseMotion]
    ) -> RobotPlan:
        robot, limbs = self.robot, self.robot.limb_names
        stances = [self.start, *(move.end for move in moves)]
        return RobotPlan(
            name=self.spec.name,
            model=self.spec.model,
            limbs=limbs,
            positions=robot.position_names,
            velocities=robot.velocity_names,
            joints=robot.joint_names,
            moves=len(moves),
            cost=proposal.cost,
            stances=tuple(dict(zip(limbs, stance.holds, strict=True)) for stance in stances),
            phases=tuple(self._phase(motion) for motion in motions),
            cuts=tuple(self.cuts),
            counts={name: int(count) for name, count in graph.counts.items()},
            proofs={
                "moves": proposal.proofs.makespan_proved,
                "cost": proposal.proofs.cost_proved,
                "relative_to": "the stance graph less the cuts",
            },
        )

    def _phase(self, motion: PhaseMotion) -> Phase:
        limbs, wall = self.robot.limb_names, self.body.wall
        return Phase(
            kind="shift" if motion.limb is None else "swing",
            limb=None if motion.limb is None else limbs[motion.limb],
            stance=motion.move,
            contacts=tuple(PhaseContact(limbs[c.limb], c.hold, wall.point(c)) for c in motion.contacts),
            time=motion.samples.time,
            q=motion.samples.q,
            v=motion.samples.v,
            vd=motion.samples.vd,
            torque=motion.torque,
            force={limbs[c.limb]: motion.force[:, i] for i, c in enumerate(motion.contacts)},
            moment={limbs[c.limb]: motion.moment[:, i] for i, c in enumerate(motion.contacts) if motion.moment.any()},
        )


def released(graph: StanceGraph) -> NDArray[np.int32]:
    """The hold that each edge's limb leaves, shape (E,)."""
    result: NDArray[np.int32] = graph.stances[graph.tail, graph.limb]
    return result


def taken(graph: StanceGraph) -> NDArray[np.int32]:
    """The hold that each edge's limb takes, shape (E,)."""
    sums = graph.stances.sum(axis=1)
    result: NDArray[np.int32] = sums[graph.head] - sums[graph.tail] + released(graph)
    return result


def decode(graph: StanceGraph, start: Stance, edges: tuple[int, ...]) -> list[Move]:
    """The moves of ordered stances that a walk through the graph stands for, from the start stance itself."""
    old, new = released(graph), taken(graph)
    moves: list[Move] = []
    stance = start
    for edge in edges:
        move = Move(stance, stance.holds.index(int(old[edge])), int(new[edge]))
        moves.append(move)
        stance = move.end
    return moves


def _refuse_what_comes_later(scenario: Scenario) -> None:
    """Says so rather than ignore what is not planned for as yet."""
    if len(scenario.robots) > 1:
        raise scenario.error("robots", f"{len(scenario.robots)} robots", "one robot; teams are not planned for as yet")
    robot = scenario.robots[0]
    if robot.waypoints:
        raise scenario.error("robots[0].waypoints", len(robot.waypoints), "none; they are not planned for as yet")
    if taken_at_start := sorted(set(robot.start.values()) & set(robot.avoid.holds)):
        raise scenario.error("robots[0].avoid.holds", taken_at_start, "holds that the robot does not start on")
