"""What `verify` found: each check with its worst value, its limit and where the worst value was."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult
from rich.padding import Padding
from rich.segment import Segment, Segments
from rich.table import Table
from rich.text import Text

from climber.stance import Vector

Sense = Literal["at most", "at least"]
WIDE = 130  # columns of a terminal on which a table has room for places as long as they come


@dataclass(frozen=True)
class Rule:
    """What a check asks for.

    Attributes:
        asks: What must be true, in words.
        sense: Whether the worst value must be at most or at least the limit.
        limit: The limit.
        unit: Unit of the worst value and of the limit.
    """

    asks: str
    sense: Sense
    limit: float
    unit: str

    def holds(self, value: float) -> bool:
        """Whether a value is within the limit; NaN is not."""
        return value <= self.limit if self.sense == "at most" else value >= self.limit

    def worse(self, value: float, than: float) -> bool:
        """Whether a value is worse than another; nothing is worse than NaN."""
        if math.isnan(value) or math.isnan(than):
            return not math.isnan(than)
        return value > than if self.sense == "at most" else value < than


@dataclass(frozen=True)
class Check:
    """A check and how it came out.

    Attributes:
        name: Short name.
        asks: What must be true, in words.
        ok: Whether it is.
        worst: The worst value found; None where there is no number, such as the margin to an empty interval.
        sense: Whether the worst value must be at most or at least the limit.
        limit: The limit.
        unit: Unit of the worst value and of the limit.
        where: Where the worst value is.
    """

    name: str
    asks: str
    ok: bool
    worst: float | None
    sense: Sense
    limit: float
    unit: str
    where: str


@dataclass(frozen=True)
class Verdict:
    """The outcome of all checks of a plan.

    Attributes:
        source: The plan's file, or what it is called.
        checks: The checks in the order they are best read.
    """

    source: str
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """Whether every check holds."""
        return all(check.ok for check in self.checks)

    @property
    def failures(self) -> tuple[Check, ...]:
        """The checks that do not hold."""
        return tuple(check for check in self.checks if not check.ok)

    def __getitem__(self, name: str) -> Check:
        """The check of that name."""
        for check in self.checks:
            if check.name == name:
                return check
        raise KeyError(name)

    def to_dict(self) -> dict[str, Any]:
        """The verdict as plain data."""
        return {"plan": self.source, "ok": self.ok, "checks": [asdict(check) for check in self.checks]}

    def to_json(self) -> str:
        """The verdict as JSON text."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The verdict as a table for a rich console; on a narrow one the places are on lines of their own."""
        yield Text(f"{self.source}: {'holds' if self.ok else 'DOES NOT HOLD'}", style="" if self.ok else "bold red")
        narrow = options.max_width < WIDE
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
        for heading, justify in (("", "left"), ("check", "left"), ("worst", "right"), ("limit", "right")):
            table.add_column(heading, justify=justify, no_wrap=True)  # type: ignore[arg-type]
        if not narrow:
            table.add_column("where")
        for check in self.checks:
            worst = "none" if check.worst is None else f"{check.worst:.3g}"
            sign = "\u2264" if check.sense == "at most" else "\u2265"
            limit = f"{sign} {check.limit:g} {check.unit}".strip()
            mark = Text("ok", "green") if check.ok else Text("FAIL", "bold red")
            table.add_row(mark, check.name, worst, limit, *([] if narrow else [Text(check.where)]))
        if not narrow:
            yield table
            return
        lines = console.render_lines(table, options, pad=False)
        for line, where in zip(lines, ["", *(check.where for check in self.checks)], strict=True):
            yield Segments([*line, Segment.line()])
            if where:
                yield Padding(Text(where, "dim"), (0, 0, 0, 8))

    def __str__(self) -> str:
        console = Console(file=io.StringIO(), width=160, color_system=None)
        console.print(self)
        file = console.file
        assert isinstance(file, io.StringIO)
        return file.getvalue().rstrip()


class Ledger:
    """Keeps the worst value of every check while a plan is gone through."""

    def __init__(self, rules: Mapping[str, Rule]) -> None:
        self._rules = rules
        self._worst: dict[str, tuple[float, str]] = {}

    def note(self, name: str, values: Vector, where: Sequence[str] | Callable[[int], str]) -> None:
        """Takes down the worst of `values`, shape (K,).

        Args:
            name: The check.
            values: What to compare with the check's limit.
            where: Where each of the values was found, K texts or a function of the place in `values`.
        """
        if not len(values):
            return
        # Both put the first NaN before everything else.
        place = int(np.argmax(values) if self._rules[name].sense == "at most" else np.argmin(values))
        value = float(values[place])
        if name not in self._worst or self._rules[name].worse(value, self._worst[name][0]):
            self._worst[name] = value, where(place) if callable(where) else where[place]

    def faults(self, name: str, found: list[str]) -> None:
        """Takes down faults of a check that counts them; the first is told where."""
        count, where = self._worst.get(name, (0.0, ""))
        self._worst[name] = count + len(found), where or (found[0] if found else "")

    def checks(self) -> tuple[Check, ...]:
        """The checks that something was taken down for, in the rules' order."""
        return tuple(
            Check(
                name=name,
                asks=rule.asks,
                ok=rule.holds(self._worst[name][0]),
                worst=self._worst[name][0] if math.isfinite(self._worst[name][0]) else None,
                sense=rule.sense,
                limit=rule.limit,
                unit=rule.unit,
                where=self._worst[name][1],
            )
            for name, rule in self._rules.items()
            if name in self._worst
        )
