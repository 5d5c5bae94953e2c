"""Why not this move? The first check that fails and by how much, or the postures found for it.

The relaxed checks of the stance graph come first, then what the graph leaves out: whether the robot can stand still at
the moment its limb lets go, whether there are postures to let go and to take hold in, and a motion between them. A
failure is *proved*, or it is the end of a *budget*; these are never the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from climber.manifold import Body
from climber.motion import DeadEnd, EmptyPiece, MotionPlanner
from climber.move_question import MoveQuestion, reached_or_none, resolve
from climber.phase_motion import MotionBudget, PhaseMotion
from climber.phases import Way
from climber.reachable import Reached, RelaxedClimb
from climber.relaxed import Check, RelaxedChecks
from climber.scenario import Scenario
from climber.stance import Contact, Move, Stance
from climber.transition import Failure
from climber.transitions import Effort, TransitionFinder
from climber.words import listed, spoken

MoveAnswer = Literal["possible", "impossible", "no motion found"]
Where = Literal["stance", "graph", "letting go", "taking hold", "motion", "torque"]
AT: dict[Where, str] = {
    "stance": "standing there",
    "letting go": "at the moment of letting go",
    "taking hold": "at the moment of taking hold",
    "motion": "on the way",
    "torque": "on the way",
}


@dataclass(frozen=True)
class MoveExplanation:
    """Whether a move can be made, and if not, what fails first.

    Attributes:
        answer: "possible" if a motion was found; "impossible" if that is proved for feet at the middles of their
            patches; "no motion found" if only a budget speaks against it.
        move: The move; None if only a stance was asked about.
        stance: The stance it starts from.
        limbs: The robot's limbs.
        moves_to_stance: Fewest moves from the start to the stance on the stance graph; None if none lead there.
        where: The stage that fails first; None if none does.
        check: The relaxed check that fails; None if it is another stage.
        reason: What another stage had to say.
        posture: Configuration found in which the robot stands still, shape (nq,), if only a stance was asked about.
        letting_go: Configuration found in which the limb lets go, shape (nq,).
        taking_hold: Configuration found in which it takes hold, shape (nq,).
        seconds: Duration of the swing found [s].
        sentences: All of it in words.
    """

    answer: MoveAnswer
    move: Move | None
    stance: Stance
    limbs: tuple[str, ...]
    moves_to_stance: int | None
    where: Where | None = None
    check: Check | None = None
    reason: str = ""
    posture: tuple[float, ...] | None = None
    letting_go: tuple[float, ...] | None = None
    taking_hold: tuple[float, ...] | None = None
    seconds: float | None = None
    sentences: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        move = self.move
        return {
            "answer": self.answer,
            "proved": self.answer == "impossible",
            "stance": dict(zip(self.limbs, self.stance.holds, strict=True)),
            "moves_to_stance": self.moves_to_stance,
            "limb": None if move is None else self.limbs[move.limb],
            "from": None if move is None else move.released,
            "to": None if move is None else move.hold,
            "where": self.where,
            "check": None if self.check is None else self.check.to_dict(),
            "reason": self.reason,
            "posture": None if self.posture is None else list(self.posture),
            "letting_go": None if self.letting_go is None else list(self.letting_go),
            "taking_hold": None if self.taking_hold is None else list(self.taking_hold),
            "seconds": self.seconds,
            "sentences": list(self.sentences),
        }


def explain_move(scenario: Scenario, question: MoveQuestion, robot: int = 0) -> MoveExplanation:
    """Explains why a move cannot be made, or finds postures and a motion for it.

    Args:
        scenario: The scenario.
        question: The move, or the stance.
        robot: Which of the scenario's robots, looked at alone.

    Raises:
        ScenarioError: If the scenario does not fit the robot, or the question names what is not there.
        ModelError: If the robot's model cannot be planned for.
    """
    climb = RelaxedClimb.of(scenario, robot)
    reached = reached_or_none(climb)
    meant = resolve(scenario, climb, reached, question)
    move, stance = (meant, meant.start) if isinstance(meant, Move) else (None, meant)
    told = MoveExplanation("possible", move, stance, climb.robot.limb_names, _moves_to(reached, stance))
    checks = RelaxedChecks(climb.wall, climb.robot, climb.robot.limb_names, climb.avoid)
    failure = checks.first_failure(checks.of_stance(stance, "the stance"))
    if failure is not None:
        return _failed_check(told, failure, "stance")
    planner = _planner(scenario, robot, climb)
    if move is None:
        return _standing(told, planner)
    failure = checks.first_failure(checks.of_move(move))
    if failure is not None:
        return _failed_check(told, failure, "graph")
    leaving = checks.balance(move, after=False)
    if not leaving.ok:
        return _failed_check(told, leaving, "letting go")
    return _moving(told, move, planner)


def _moves_to(reached: Reached | None, stance: Stance) -> int | None:
    if reached is None or not reached.has(stance):
        return None
    return int(reached.distance[reached.graph.vertex(stance)])


def _planner(scenario: Scenario, index: int, climb: RelaxedClimb) -> MotionPlanner:
    wall = climb.wall.closing(scenario.robots[index].avoid.regions)
    rng = np.random.default_rng(scenario.seed)
    finder = TransitionFinder(Body(climb.robot, wall), rng, Effort.of(scenario.budget))
    return MotionPlanner(finder, MotionBudget.of(scenario.budget))


def _standing(told: MoveExplanation, planner: MotionPlanner) -> MoveExplanation:
    """What posture there is for a stance that passes all relaxed checks."""
    found = planner.transitions.standing(tuple(Contact(limb, hold) for limb, hold in enumerate(told.stance.holds)))
    if found.failure is not None:
        return _failed_search(told, found.failure, "stance")
    line = f"{_what(told)} is possible: a posture was found in which the robot stands still."
    return replace(told, posture=tuple(found.q[0].tolist()), sentences=(line, _where_stands(told)))


def _moving(told: MoveExplanation, move: Move, planner: MotionPlanner) -> MoveExplanation:
    """What postures and motion there are for a move that passes all relaxed checks."""
    contacts = tuple(Contact(limb, hold) for limb, hold in enumerate(move.start.holds))
    _, failures = planner.transitions.contacts_after(contacts, move)
    for failure in failures:  # letting go comes first
        return _failed_search(told, failure.failure, "letting go" if failure.end == "leave" else "taking hold")
    outcome = planner.plan(planner.transitions.transition(contacts, move.limb), [move], {})
    assert not isinstance(outcome, EmptyPiece)  # no piece was asked for
    if not isinstance(outcome, Way):
        failed = outcome.failure if isinstance(outcome, DeadEnd) else outcome
        return _failed_search(told, failed.failure, "torque" if failed.stage == "torque" else "motion")
    return _possible(told, outcome.chained())


def _possible(told: MoveExplanation, phases: list[PhaseMotion]) -> MoveExplanation:
    (swing,) = (phase for phase in phases if phase.limb is not None)
    time, q = swing.samples.time, swing.samples.q
    seconds = float(time[-1] - time[0])
    lines = [
        f"{_what(told)} is possible: there are postures to let go and to take hold in, and a swing of {seconds:.1f} s "
        "between them.",
        _where_stands(told),
    ]
    return replace(
        told,
        letting_go=tuple(q[0].tolist()),
        taking_hold=tuple(q[-1].tolist()),
        seconds=seconds,
        sentences=tuple(lines),
    )


def _failed_check(told: MoveExplanation, check: Check, where: Where) -> MoveExplanation:
    lines = [
        f"{_what(told)} is impossible: {check.sentence}.",
        f"(Proved, for feet at {'any point' if check.anywhere else 'the middles'} of their patches.)",
        _where_stands(told),
    ]
    return replace(told, answer="impossible", where=where, check=check, sentences=tuple(lines))


def _failed_search(told: MoveExplanation, failure: Failure, where: Where) -> MoveExplanation:
    proved = failure.kind == "proved"
    verdict = "is impossible" if proved else "was not found to be possible, which does not prove that it is not"
    lines = [
        f"{_what(told)} {verdict}: it passes every check of the stance graph, but {AT[where]}: {failure.reason}.",
        *(
            [f"(Proved, for feet at {'the middles' if where == 'stance' else 'any point'} of their patches.)"]
            if proved
            else []
        ),
        _where_stands(told),
    ]
    answer: MoveAnswer = "impossible" if proved else "no motion found"
    return replace(told, answer=answer, where=where, reason=failure.reason, sentences=tuple(lines))


def _what(told: MoveExplanation) -> str:
    on = listed([f"hold {hold}" for hold in told.stance.holds])
    if told.move is None:
        return f"The stance on {on}"
    name = spoken(told.limbs[told.move.limb])
    return f"The move of {name} from hold {told.move.released} to hold {told.move.hold}, standing on {on},"


def _where_stands(told: MoveExplanation) -> str:
    if told.moves_to_stance is None:
        return "The stance cannot be reached from the start on the stance graph."
    if told.moves_to_stance == 0:
        return "The stance is the start."
    plural = "s" if told.moves_to_stance != 1 else ""
    return f"The stance can be reached from the start in {told.moves_to_stance} move{plural} on the stance graph."
