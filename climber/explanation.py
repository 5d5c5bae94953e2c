"""What an explanation says: whether a scenario has a climb, what of it is missing, and how far one gets. Types only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from climber.blocked import Blocked, Frontier
from climber.changes import Changes
from climber.plan_parts import Cut
from climber.reachable import Target
from climber.relaxed import Check
from climber.stance import Stance

Answer = Literal["climb", "no climb", "no motion found"]


@dataclass(frozen=True)
class Missing:
    """What of a target cannot be reached.

    Attributes:
        target: The goal or waypoint.
        check: The check that it fails by itself, wherever one comes from; None if it passes.
        never_held: Of the holds it asks for, those that no reached stance stands on.
        most_held: How many of them a reached stance stands on at most, and such a stance; None for a region.
        region_lacking: By how much too short the limbs are for a reached stance to have the pelvis in the region [m],
            and the stance that comes nearest; None if it is not a region alone that is asked for.
        no_way_in: If it passes by itself but no move at all leads into it, the move that misses by the least.
    """

    target: Target
    check: Check | None
    never_held: tuple[int, ...]
    most_held: tuple[int, Stance] | None
    region_lacking: tuple[float, Stance] | None
    no_way_in: Blocked | None


@dataclass(frozen=True)
class Explanation:
    """Whether there is a climb, and if not, why.

    Attributes:
        answer: "climb" if the graph, less what was given up, has one; "no climb" if it is proved that there is none
            with feet at the middles of their patches; "no motion found" if only a budget speaks against it.
        robot: Name of the robot, looked at alone.
        limbs: Its limbs.
        moves: Fewest moves of the climb on the stance graph, before anything was given up; None if it has none.
        moves_possible: Likewise, less the moves that are proved impossible all the same.
        start: The check that the start stance fails; None if it passes.
        missing: What cannot be reached; None if there is a climb, or each target can be reached but not all in a row.
        frontier: How far one gets.
        changes: What would make a climb; None if nothing was tried.
        cuts: What the planner had given up.
        planned: Whether the planner found the whole climb; None if it was not asked.
        sentences: All of it in words.
    """

    answer: Answer
    robot: str
    limbs: tuple[str, ...]
    moves: int | None
    moves_possible: int | None = None
    start: Check | None = None
    missing: Missing | None = None
    frontier: Frontier | None = None
    changes: Changes | None = None
    cuts: tuple[Cut, ...] = ()
    planned: bool | None = None
    sentences: tuple[str, ...] = ()

    @property
    def proved(self) -> bool:
        """Whether it is proved that there is no climb, with feet at the middles of their patches."""
        return self.answer == "no climb"

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        facts: dict[str, Any] = {
            "answer": self.answer,
            "proved": self.proved,
            "relative_to": "the stance graph, feet at the middles of their patches",
            "robot": self.robot,
            "moves": self.moves,
            "moves_possible": self.moves_possible,
            "planned": self.planned,
            "sentences": list(self.sentences),
            "cuts": {kind: sum(cut.kind == kind for cut in self.cuts) for kind in ("proved", "budget")},
            "start": None if self.start is None else self.start.to_dict(),
            "missing": None if self.missing is None else self._missing(self.missing),
        }
        if (front := self.frontier) is not None:
            facts["frontier"] = {
                "reached": front.reached,
                "holds": list(front.holds),
                "farthest_hold": front.farthest_hold,
                "stances": [self._named(stance) for stance in front.stances],
                "distances": list(front.distances),
                "blocked": [blocked.to_dict(self.limbs) for blocked in front.blocked],
            }
        facts["changes"] = None if self.changes is None else self.changes.to_dict()
        return facts

    def _named(self, stance: Stance) -> dict[str, int]:
        return dict(zip(self.limbs, stance.holds, strict=True))

    def _missing(self, missing: Missing) -> dict[str, Any]:
        target, most, lacking = missing.target, missing.most_held, missing.region_lacking
        return {
            "target": target.name,
            "holds": list(target.demanded),
            "region": target.region is not None,
            "check": None if missing.check is None else missing.check.to_dict(),
            "never_held": list(missing.never_held),
            "most_held": None if most is None else {"number": most[0], "stance": self._named(most[1])},
            "region_lacking": None if lacking is None else {"by": lacking[0], "stance": self._named(lacking[1])},
            "no_way_in": None if missing.no_way_in is None else missing.no_way_in.to_dict(self.limbs),
        }
