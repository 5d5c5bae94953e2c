"""The move that a person asks about: what they typed, checked against the scenario and completed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from climber.exceptions import ClimberError
from climber.reachable import Reached, RelaxedClimb
from climber.scenario import Scenario
from climber.stance import Move, Stance


@dataclass(frozen=True)
class MoveQuestion:
    """A move or a stance to be explained, as a person names it.

    Attributes:
        limb: Name of the limb; None to ask about the stance alone.
        released: The hold it leaves.
        hold: The hold it takes.
        stance: The hold of each limb, in limb order or by name; None for the start stance if the move can be asked
            about there, else the first stance to be reached where it can.
    """

    limb: str | None = None
    released: int = -1
    hold: int = -1
    stance: tuple[int, ...] | Mapping[str, int] | None = None

    @classmethod
    def parse(cls, scenario: Scenario, move: str | None, stance: str | None) -> MoveQuestion:
        """Reads `limb:from:to` and `hold,hold,...` or `limb=hold,...`.

        Raises:
            ScenarioError: If they are not of these forms.
        """
        limb, released, hold = None, -1, -1
        if move is not None:
            parts = move.split(":")
            if len(parts) != 3 or not parts[1].strip().isdecimal() or not parts[2].strip().isdecimal():
                raise scenario.error("--move", move, "limb:from_hold:to_hold, such as right_front:3:7")
            limb, released, hold = parts[0].strip(), int(parts[1]), int(parts[2])
        if stance is None:
            return cls(limb, released, hold)
        items = [item.strip() for item in stance.split(",")]
        if all(item.isdecimal() for item in items):
            return cls(limb, released, hold, tuple(int(item) for item in items))
        named: dict[str, int] = {}
        for item in items:
            name, equals, number = (part.strip() for part in item.partition("="))
            if not equals or not number.isdecimal():
                raise scenario.error("--stance", stance, "hold,hold,... in limb order, or limb=hold,limb=hold,...")
            if name in named:
                allowed = f"each limb once; it is on hold {named[name]} already"
                raise scenario.error(f"--stance.{name}", int(number), allowed)
            named[name] = int(number)
        return cls(limb, released, hold, named)


def reached_or_none(climb: RelaxedClimb) -> Reached | None:
    """What can be reached; None if the start cannot be stood on."""
    try:
        return climb.reached()
    except ClimberError:
        return None


def resolve(scenario: Scenario, climb: RelaxedClimb, reached: Reached | None, question: MoveQuestion) -> Stance | Move:
    """The stance or the move that a question means.

    Raises:
        ScenarioError: If it names what is not there, or what is no stance.
    """
    limbs, last = climb.robot.limb_names, len(climb.wall.holds) - 1
    given = None if question.stance is None else _given_stance(scenario, climb, question.stance)
    if question.limb is None:
        return climb.start if given is None else given
    if question.limb not in limbs:
        raise scenario.error("--move.limb", question.limb, f"a limb: {', '.join(limbs)}")
    for end, hold in (("from", question.released), ("to", question.hold)):
        if not 0 <= hold <= last:
            raise scenario.error(f"--move.{end}", hold, f"the number of a hold, 0 to {last}")
    if question.released == question.hold:
        raise scenario.error("--move.to", question.hold, "another hold than the one that is left")
    limb = limbs.index(question.limb)
    stance = given or _first_stance(climb, reached, limb, question)
    if stance is None:
        allowed = (
            f"a hold that {question.limb} can come to stand on from the start, with hold {question.hold} free; "
            "give --stance to ask about another stance"
        )
        raise scenario.error("--move.from", question.released, allowed)
    if stance.holds[limb] != question.released:
        allowed = f"the hold that {question.limb} is on in that stance, {stance.holds[limb]}"
        raise scenario.error("--move.from", question.released, allowed)
    if question.hold in stance.holds:
        other = limbs[stance.holds.index(question.hold)]
        raise scenario.error("--move.to", question.hold, f"a hold that is free in that stance; {other} is on this one")
    return Move(stance, limb, question.hold)


def _given_stance(scenario: Scenario, climb: RelaxedClimb, given: tuple[int, ...] | Mapping[str, int]) -> Stance:
    limbs, last = climb.robot.limb_names, len(climb.wall.holds) - 1
    if isinstance(given, Mapping):
        for name, hold in given.items():
            if name not in limbs:
                raise scenario.error(f"--stance.{name}", hold, f"a limb: {', '.join(limbs)}")
        for name in limbs:
            if name not in given:
                raise scenario.error(f"--stance.{name}", None, f"a hold for every limb: {', '.join(limbs)}")
        holds = [given[name] for name in limbs]
    else:
        holds = list(given)
    if len(holds) != len(limbs):
        raise scenario.error("--stance", holds, f"{len(limbs)} holds, one for each of {', '.join(limbs)}")
    for place, hold in enumerate(holds):
        if not 0 <= hold <= last:
            raise scenario.error(f"--stance.{limbs[place]}", hold, f"the number of a hold, 0 to {last}")
        if hold in holds[:place]:
            other = limbs[holds.index(hold)]
            raise scenario.error(f"--stance.{limbs[place]}", hold, f"a hold of its own; {other} is on this one")
    return Stance(tuple(holds))


def _first_stance(climb: RelaxedClimb, reached: Reached | None, limb: int, question: MoveQuestion) -> Stance | None:
    """The stance in fewest moves from the start in which the move can be asked about; the start itself if it is one."""

    def fits(stance: Stance) -> bool:
        return stance.holds[limb] == question.released and question.hold not in stance.holds

    if fits(climb.start):
        return climb.start
    if reached is None:
        return None
    nearest: list[tuple[int, Stance]] = []
    for vertex in reached.vertices[(reached.graph.stances[reached.vertices] == question.released).any(axis=1)]:
        images = reached.graph.images(Stance(tuple(reached.graph.stances[vertex].tolist())))
        nearest += [(int(reached.distance[vertex]), image) for image in images if fits(image)]
    return min(nearest, default=(0, None))[1]
