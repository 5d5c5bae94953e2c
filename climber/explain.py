"""Why not? What keeps a scenario from having a climb, in sentences and as data.

Everything is said of the *stance graph* first, whose checks are relaxed: what cannot be reached on it is proved
impossible, with feet at the middles of their patches. If the planner was asked and gave moves up, the graph less those
moves is looked at as well, and what it *proved* is kept apart from what it merely *found no motion* for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from climber import telling
from climber.blocked import Frontier, GivenUp
from climber.changes import ChangeFinder, Planner
from climber.exceptions import NoPlanFound
from climber.explanation import Answer, Explanation, Missing
from climber.frontier import FrontierFinder
from climber.geometry import Mask
from climber.plan_parts import Cut
from climber.prune import out_of_reach
from climber.reachable import UNREACHED, Reached, RelaxedClimb, Target
from climber.relaxed import Check, RelaxedChecks
from climber.scenario import Scenario
from climber.scenario_fields import HoldSpec
from climber.stance import Move, Stance
from climber.stance_graph import StanceGraph

SECONDS = 10.0  # [s] for trying changes, unless told


def explain_climb(
    scenario: Scenario,
    robot: int = 0,
    *,
    failure: NoPlanFound | None = None,
    seconds: float = SECONDS,
    planner: Planner | None = None,
) -> Explanation:
    """Explains why a scenario has no climb, or says that it has one on the stance graph.

    Args:
        scenario: The scenario.
        robot: Which of its robots, looked at alone.
        failure: The planner's answer, if it was asked.
        seconds: For trying what change would make a climb [s]; 0 tries nothing.
        planner: Tries to plan what a change makes possible on the stance graph; not asked if not given.

    Raises:
        ScenarioError: If the scenario does not fit the robot.
        ModelError: If the robot's model cannot be planned for.
    """
    climb = RelaxedClimb.of(scenario, robot)
    told = _Told(scenario, robot, climb, seconds, planner)
    if (fault := told.start_fault()) is not None:
        return told.unstartable(fault)
    graph = climb.graph()
    reached = climb.reached(graph)
    if reached.moves is None:
        return told.no_climb(FrontierFinder(climb, reached), "no climb")
    barred = _proved_away(climb, graph)
    less = climb.reached(graph, _mask(graph, barred))
    if less.moves is None:
        return told.no_climb(FrontierFinder(climb, less, barred), "no climb", reached.moves, change=True)
    if failure is None:
        return told.climb_exists(less, reached.moves)
    if len(scenario.robots) > 1:  # what a team gave up, one robot alone may do
        return told.climb_exists(less, reached.moves, failure)
    cuts = tuple(cut for cut in failure.cuts if isinstance(cut, Cut))
    given_up = _given_up(graph, cuts, failure.removed, climb.robot.limb_names)
    proofs = {edge: why for edge, why in given_up.items() if why.kind == "proved"} | barred
    answer: Answer = "no climb"
    last = climb.reached(graph, _mask(graph, proofs))
    if last.moves is not None:
        last = _left(climb, graph, failure, given_up | barred)
        answer = "no climb" if failure.proved else "no motion found"
    if last.moves is not None:
        return replace(told.climb_exists(less, reached.moves, failure), cuts=cuts)
    # Why a move is barred from some pieces of a stance is told, too, where it stops one.
    reasons = _given_up(graph, cuts, (), climb.robot.limb_names) | given_up | barred
    return replace(told.no_climb(FrontierFinder(climb, last, reasons), answer, reached.moves), cuts=cuts)


def _left(climb: RelaxedClimb, graph: StanceGraph, failure: NoPlanFound, barred: Mapping[int, GivenUp]) -> Reached:
    """What is left to be reached after all that was given up, as the planner has it if it says."""
    left = climb.reached(graph, _mask(graph, barred))
    if failure.reached is None:
        return left
    distance = np.full(graph.num_vertices, UNREACHED)
    distance[[graph.vertex(stance) for stance in failure.reached]] = 0
    return Reached(graph, distance, None)


def _mask(graph: StanceGraph, barred: Mapping[int, GivenUp]) -> Mask:
    mask = np.zeros(graph.num_edges, dtype=bool)
    mask[list(barred)] = True
    return mask


def _proved_away(climb: RelaxedClimb, graph: StanceGraph) -> dict[int, GivenUp]:
    """The edges that `climber.prune` proves impossible, and why."""
    edges = np.flatnonzero(climb.impossible(graph))
    far = out_of_reach(climb.robot, climb.wall, graph.stances)
    reach = "at no angle of the pelvis do all limbs reach their holds in the stance that it {}"
    starts, ends = (GivenUp("proved", "transition", reach.format(verb)) for verb in ("starts in", "ends in"))
    reason = "at no angle of the pelvis is the centre of mass held up as the limb lets go, or as it takes hold"
    unbalanced = GivenUp("proved", "transition", reason)
    return {
        edge: ends if far[graph.head[edge]] else starts if far[graph.tail[edge]] else unbalanced
        for edge in edges.tolist()
    }


def ask(scenario: Scenario, robot: int, seconds: float) -> Explanation:
    """`explain_climb` with the planner asked: for the climb itself, and for what changes make possible.

    Args:
        scenario: The scenario.
        robot: Which of its robots is explained if there is no plan.
        seconds: For trying changes, and for each plan [s].

    Raises:
        ClimberError: As `plan_climb`, but for `NoPlanFound`.
    """
    from climber.plan import plan_climb  # which explains what it does not find

    def planner(changed: Scenario, limit: float) -> bool:
        try:
            plan_climb(changed, time_limit=limit)
        except NoPlanFound:
            return False
        return True

    try:
        plan = plan_climb(scenario, time_limit=seconds)
    except NoPlanFound as failure:
        return explain_climb(scenario, robot, failure=failure, seconds=seconds, planner=planner)
    told = explain_climb(scenario, robot, seconds=0.0)
    found = plan.robots[robot]
    line = f"The planner finds the whole climb: {found.moves} moves, {found.duration:.1f} s of motion."
    return replace(told, planned=True, sentences=(told.sentences[0], line))


def _given_up(
    graph: StanceGraph, cuts: Sequence[Cut], removed: Sequence[Sequence[Move]], limbs: Sequence[str]
) -> dict[int, GivenUp]:
    """The edges that the planner gave up, each with the first reason; of those with several, a proof comes first.

    If it is not known what was removed, these are the moves that the cuts name.
    """
    given_up: dict[int, GivenUp] = {}
    for number, cut in enumerate(cuts):
        why = GivenUp(cut.kind, cut.stage, cut.reason)
        named = Move(Stance(tuple(cut.stance[limb] for limb in limbs)), list(limbs).index(cut.limb), cut.hold)
        for move in removed[number] if removed else [named]:
            try:
                edge = graph.edge(graph.vertex(move.start), graph.vertex(move.end))
            except KeyError:  # no edge of this graph to begin with
                continue
            if edge not in given_up or (why.kind == "proved" and given_up[edge].kind == "budget"):
                given_up[edge] = why
    return given_up


@dataclass
class _Told:
    """Makes explanations of one climb."""

    scenario: Scenario
    index: int
    climb: RelaxedClimb
    seconds: float
    planner: Planner | None

    def __post_init__(self) -> None:
        self.name, self.limbs = self.scenario.robots[self.index].name, self.climb.robot.limb_names
        others = len(self.scenario.robots) - 1
        self.alone = [f"{self.name} is looked at alone, as if nobody else were on the wall."] if others else []

    def start_fault(self) -> Check | None:
        checks = RelaxedChecks(self.climb.wall, self.climb.robot, self.limbs, self.climb.avoid)
        return checks.first_failure(checks.of_stance(self.climb.start, "the start stance"))

    def unstartable(self, fault: Check) -> Explanation:
        first = f"There is no climb: the robot cannot even stand on its start. {telling.sentence(fault.sentence)}"
        changes = None
        lines = [first, *self.alone]
        if fault.name == "support" and self.seconds > 0:
            alone = Frontier(0, (), self.climb.start.holds[0], (self.climb.start,), (0.0,), ())
            changes = self._finder().find(alone, self.climb.goal, places=False)
            lines += telling.changes_told(changes)
        return Explanation(
            "no climb", self.name, self.limbs, None, start=fault, changes=changes, sentences=tuple(lines)
        )

    def climb_exists(self, less: Reached, moves: int, failure: NoPlanFound | None = None) -> Explanation:
        graph = less.graph
        size = f"{graph.num_vertices} stances, {graph.num_edges} moves"
        lines = [f"There is a climb of {moves} moves on the stance graph ({size})."]
        if less.moves != moves:
            lines.append(f"Less the moves that are proved impossible, the shortest has {less.moves}.")
        if failure is None:
            lines.append("The graph's checks are relaxed: whether its moves have motions, `climber solve` finds out.")
        else:
            who = (
                "The planner has no plan for the team" if self.alone else "The planner gave up before it had tried all"
            )
            lines.append(f"{who}: {_reason(self.scenario, failure)}.")
        return Explanation(
            "climb", self.name, self.limbs, moves, moves_possible=less.moves, sentences=(*lines, *self.alone)
        )

    def no_climb(
        self, finder: FrontierFinder, answer: Answer, moves: int | None = None, change: bool = False
    ) -> Explanation:
        """There is none on what can be reached; `moves` is what the stance graph alone has."""
        reached = finder.reached
        # From the start itself; whatever cannot be reached so cannot be reached by way of a waypoint either.
        missed = [t for t in self.climb.targets if (reached.distance[t.vertices(reached.graph)] == UNREACHED).all()]
        lines = [telling.verdict(answer, missed, moves, self.climb.in_order), *self.alone]
        missing = None
        # If each target can be reached and only not all in a row, the goal is what comes last.
        target = missed[0] if missed else self.climb.goal
        if missed:
            missing = self._what_is_missing(finder, target)
            lines += telling.missing_told(missing, self.limbs)
        frontier = finder.find(target)
        # A goal that is impossible by itself is no more possible for being nearer.
        possible = missing is None or missing.check is None
        lines += telling.frontier_told(frontier, target, self.limbs, onwards=possible)
        changes = None
        if self.seconds > 0 and (moves is None or change):
            # If the trouble is with the very holds asked for, other holds do not matter.
            changes = self._finder().find(frontier, target, places=possible)
            if self.planner is not None:
                changes = changes.asked(self.planner, self.scenario, self.seconds)
            lines += telling.changes_told(changes)
        return Explanation(
            answer,
            self.name,
            self.limbs,
            moves,
            missing=missing,
            frontier=frontier,
            changes=changes,
            sentences=tuple(lines),
        )

    def _what_is_missing(self, finder: FrontierFinder, target: Target) -> Missing:
        check = finder.standing(target)
        demanded, region_alone = target.demanded, not target.demanded
        never = tuple(hold for hold in sorted(demanded) if hold not in finder.reached.holds)
        return Missing(
            target=target,
            check=check,
            never_held=never,
            most_held=finder.most_held(target) if demanded else None,
            region_lacking=finder.region_lacking(target) if region_alone else None,
            no_way_in=finder.no_way_in(target) if demanded and check is None else None,
        )

    def _finder(self) -> ChangeFinder:
        new_hold = HoldSpec(position=[0.0, 0.0], normal=[0.0, 1.0]).build(self.scenario.wall.hold_defaults)
        return ChangeFinder(self.climb, new_hold, np.random.default_rng(self.scenario.seed), self.seconds)


def explain_failure(failure: NoPlanFound, seconds: float = 0.0) -> Explanation | None:
    """Why there is no plan, in sentences and as data, besides what `failure` says; None if the scenario is not known.

    Of a team it is the first robot that has no climb even alone, if there is one.

    Args:
        failure: What `plan_climb` raised.
        seconds: For trying what change of the wall would make a climb [s].
    """
    scenario = failure.scenario
    if scenario is None:
        return None
    told = explain_climb(scenario, failure.robot, failure=failure, seconds=seconds)
    for other in range(len(scenario.robots)):
        if told.answer == "climb" and other != failure.robot:
            told = explain_climb(scenario, other, failure=failure, seconds=seconds)
    known = f"{_reason(scenario, failure)}."
    return replace(told, sentences=tuple(line for line in told.sentences if not line.endswith(known)))


def _reason(scenario: Scenario, failure: NoPlanFound) -> str:
    """What the planner says, without the scenario's name before it."""
    return str(failure).removeprefix(f"{scenario.name}: ").rstrip(".")
