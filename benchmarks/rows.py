"""Rows of the table that `python -m benchmarks` ends with.

A part prints a row as one line, the word ROW and then JSON, among whatever else it prints; see `Row.show`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Literal

from rich.table import Table

MARK = "ROW "


@dataclass(frozen=True)
class Row:
    """One measurement beside its target.

    Attributes:
        what: What was measured.
        measured: The value; None if it could not be measured.
        unit: Its unit; "times" for ratios.
        target: The target in the same unit; None where there is none.
        sense: Whether more than the target is wanted or less.
        note: How it was measured, or why it was not.
    """

    what: str
    measured: float | None
    unit: str
    target: float | None = None
    sense: Literal["at least", "at most"] = "at most"
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None where there is none or nothing was measured."""
        if self.target is None or self.measured is None:
            return None
        return self.measured >= self.target if self.sense == "at least" else self.measured <= self.target

    def show(self) -> None:
        """Prints the row for `python -m benchmarks` to collect."""
        print(MARK + json.dumps(asdict(self)), flush=True)

    @staticmethod
    def read(line: str) -> Row | None:
        """The row that a line of output shows, or None if it shows none."""
        return Row(**json.loads(line.removeprefix(MARK))) if line.startswith(MARK) else None

    def cells(self) -> tuple[str, str, str, str, str]:
        """What, target, measured, met or not, and the note, as text."""
        target = "" if self.target is None else f"{self.sense} {_number(self.target)} {self.unit}"
        measured = "not measured" if self.measured is None else f"{_number(self.measured)} {self.unit}"
        met = {True: "met", False: "NOT MET", None: ""}[self.met]
        return self.what, target, measured, met, self.note


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


HEADINGS = ("what", "target", "measured", "", "how")


def table(rows: Iterable[Row], title: str) -> Table:
    """The rows as a table for the terminal."""
    result = Table(*HEADINGS, title=title, title_justify="left", show_lines=False)
    for row in rows:
        result.add_row(*row.cells(), style="red" if row.met is False else None)
    return result


def markdown(rows: Iterable[Row]) -> str:
    """The rows as a table for a page."""
    lines = [HEADINGS, ("---",) * len(HEADINGS), *(row.cells() for row in rows)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
