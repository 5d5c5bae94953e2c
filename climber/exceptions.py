"""What climber raises. A message says what was received, where, and what is allowed."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from climber.scenario import Scenario
    from climber.stance import Move, Stance


class ClimberError(Exception):
    """Base of everything climber raises on purpose."""

    def __reduce__(self) -> tuple[object, ...]:
        # Worker processes hand their errors back by pickling, which by default knows of positional arguments only.
        return (_restored, (type(self), self.args, vars(self)))


def _restored(kind: type[ClimberError], arguments: tuple[object, ...], facts: dict[str, object]) -> ClimberError:
    error = kind.__new__(kind, *arguments)
    vars(error).update(facts)
    return error


class ScenarioError(ClimberError):
    """A scenario that cannot be planned for as it is written.

    Attributes:
        file: The scenario file, or the name its text goes by.
        path: Where in the file, such as `wall.holds[3].friction`; empty for the file as a whole.
        given: The value found there, as the message shows it; None where nothing was given.
        allowed: What would be accepted instead.
    """

    def __init__(
        self, message: str, *, file: str = "", path: str = "", given: str | None = None, allowed: str = ""
    ) -> None:
        super().__init__(message)
        self.file = file
        self.path = path
        self.given = given
        self.allowed = allowed

    @classmethod
    def at(cls, file: str | Path, path: str, given: object, allowed: str) -> ScenarioError:
        """The error of one value at one place.

        Args:
            file: The scenario file, or the name its text goes by.
            path: The field, such as `robots[0].start.right_front`; empty for the file as a whole.
            given: The value found there; None where nothing was given.
            allowed: What would be accepted, as the end of the sentence "allowed: ...".
        """
        shown = None if given is None else _short(given)
        where = f"{file}: {path}" if path else f"{file}"
        message = f"{where}: {'nothing given' if shown is None else f'given {shown}'}; allowed: {allowed}"
        return cls(message, file=str(file), path=path, given=shown, allowed=allowed)


_REPR = reprlib.Repr()
_REPR.maxlevel, _REPR.maxlist, _REPR.maxdict, _REPR.maxstring, _REPR.maxother = 3, 6, 6, 80, 80


def _short(value: object) -> str:
    """The value as one line that is never a page long, however deep the value."""
    return _REPR.repr(value)


class ModelError(ClimberError):
    """A robot model, or the description beside it, is not what climber can plan for."""


class PlanFileError(ClimberError):
    """A plan file that cannot be read, or is not of a version this climber knows."""


class NoPlanFound(ClimberError):
    """There is no plan to return, with the evidence.

    Attributes:
        proved: True when it is proved that no plan exists on this model; False when a budget ran out first.
        cuts: The moves given up on, each with its reason, in the order they were cut.
        removed: For each cut, the moves it took out of the graph; none if it was overcome, or told pieces of a stance
            apart. Empty if not known.
        reached: The stances that could still be reached when no climb was left; None if the search ended before.
        counts: Counts of each stage up to here.
        scenario: The scenario, if it is to be explained.
        robot: Number of the robot there that has no plan.
    """

    def __init__(
        self,
        message: str,
        *,
        proved: bool,
        cuts: Sequence[object] = (),
        removed: Sequence[Sequence[Move]] = (),
        reached: Sequence[Stance] | None = None,
        counts: Mapping[str, int] | None = None,
        scenario: Scenario | None = None,
        robot: int = 0,
    ) -> None:
        super().__init__(message)
        self.proved = proved
        self.cuts = tuple(cuts)
        self.removed = tuple(tuple(moves) for moves in removed)
        self.reached = None if reached is None else tuple(reached)
        self.counts = dict(counts or {})
        self.scenario, self.robot = scenario, robot
