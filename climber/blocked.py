"""What blocks a move, and how far one gets: what a frontier is made of. Types only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from climber.plan_parts import CutKind, CutStage
from climber.relaxed import Check
from climber.stance import Move, Stance
from climber.words import listed, spoken


def on_holds(stance: Stance) -> str:
    """The holds of a stance in limb order, as `holds 1, 2 and 3`."""
    return listed([f"hold {hold}" for hold in stance.holds])


@dataclass(frozen=True)
class GivenUp:
    """Why a move that passes the relaxed checks is not to be used.

    Attributes:
        kind: "proved" if it is impossible, "budget" if no motion was found for it.
        stage: The stage that found out.
        reason: In words.
    """

    kind: CutKind
    stage: CutStage
    reason: str


@dataclass(frozen=True)
class Blocked:
    """A move that would lead on, and what is in its way.

    Attributes:
        move: The move, not possible.
        check: The first relaxed check that it fails; None if it passes all.
        given_up: Why it is not to be used, if it passes all.
    """

    move: Move
    check: Check | None
    given_up: GivenUp | None = None

    def sentence(self, limbs: tuple[str, ...]) -> str:
        """The move and its trouble in words."""
        name = spoken(limbs[self.move.limb])
        what = (
            f"{name} from hold {self.move.released} to hold {self.move.hold}, standing on {on_holds(self.move.start)}"
        )
        if self.check is not None:
            return f"{what}: {self.check.sentence}"
        assert self.given_up is not None
        how = "proved impossible" if self.given_up.kind == "proved" else "no motion found in the budget"
        return f"{what}: {how} ({self.given_up.reason})"

    def to_dict(self, limbs: tuple[str, ...]) -> dict[str, Any]:
        """As JSON has it."""
        facts: dict[str, Any] = {
            "stance": dict(zip(limbs, self.move.start.holds, strict=True)),
            "limb": limbs[self.move.limb],
            "from": self.move.released,
            "to": self.move.hold,
            "sentence": self.sentence(limbs),
        }
        if self.check is not None:
            return facts | {"kind": "proved", "stage": "graph", "why": self.check.to_dict()}
        why = self.given_up
        assert why is not None
        return facts | {"kind": why.kind, "stage": why.stage, "why": {"sentence": why.reason}}


@dataclass(frozen=True)
class Frontier:
    """How far towards a target one gets.

    Attributes:
        reached: Number of stances that can be reached.
        holds: The holds that they stand on, increasing.
        farthest_hold: Of these the one nearest to the target.
        stances: The reached stances nearest to the target, by the middle of their holds, nearest first, no two on the
            same holds.
        distances: How near they are [m].
        blocked: Moves from these stances that would lead nearer but are not possible, the nearest misses first.
    """

    reached: int
    holds: tuple[int, ...]
    farthest_hold: int
    stances: tuple[Stance, ...]
    distances: tuple[float, ...]
    blocked: tuple[Blocked, ...]
