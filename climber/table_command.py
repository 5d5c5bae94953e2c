"""`climber table`: the command that plans scenarios for several seeds and prints Gönen's table 5.1 for them."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from climber.exceptions import ClimberError
from climber.table import PUBLISHED, Figures, Published, deviation, mean, measure

SEEDS = 3
LEAST = 80  # characters that the table takes in any case
UNBOUNDED = 1000  # characters: more than any table takes
NOTE = (
    "Published: table 5.1 of Gönen (2021), on walls that ours resemble but are not; - where the copy at hand cannot be "
    "read. Makespans of its scenarios 2, 3 and 5, replanning of 3 and task planning of 5 are from its section 5.1, "
    "which prints a plan of 10 moves for scenario 2. Its optimum lengths are by RRT*, its mean lengths and times by "
    "RRT-Connect; ours are the least and the mean over the seeds. Length: Euclidean over all positions, metres and "
    "radians alike, of all robots together. In parentheses: standard deviations."
)


def add_table_command(commands: Any) -> argparse.ArgumentParser:
    """Adds `table` to the subcommands of a parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "table",
        help="print the figures of planning, beside the published ones",
        description="Plans scenarios for several seeds and prints makespan, time of each stage, path lengths, duration "
        "and replans, as table 5.1 of Gönen (2021) does, with the published values beside.",
    )
    what = f"scenario files or names; {', '.join(PUBLISHED)} by default"
    parser.add_argument("scenario", nargs="*", default=list(PUBLISHED), help=what)
    parser.add_argument("--seeds", type=int, default=SEEDS, metavar="N", help=f"seeds 0 to N - 1; {SEEDS} by default")
    what = "time for improving each climb once there is one [s]; the scenario's by default"
    parser.add_argument("--improve", type=float, metavar="S", help=what)
    parser.set_defaults(run=_table)
    return parser


def _table(options: argparse.Namespace) -> int:
    from climber.scenario import load_scenario

    if options.seeds < 1:
        raise ClimberError(f"--seeds is {options.seeds}; allowed: 1 or greater")
    if options.improve is not None and not 0.0 <= options.improve < float("inf"):
        raise ClimberError(f"--improve is {options.improve:g}; allowed: a number of seconds, 0 or greater")
    scenarios = [load_scenario(name) for name in options.scenario]
    errors = Console(stderr=True, highlight=False, soft_wrap=True)
    figures = []
    for scenario in scenarios:
        with errors.status(f"planning {scenario.name} ..."):
            figures.append(
                measure(
                    scenario,
                    range(options.seeds),
                    options.improve,
                    lambda message: errors.print(f"  {message}", style="dim", markup=False),
                )
            )
    if options.json:
        print(json.dumps({"seeds": options.seeds, "scenarios": [each.to_dict() for each in figures], "note": NOTE}))
    else:
        console = Console(highlight=False)
        console.width = max(console.width, LEAST)
        console.print(rendered(figures, options.seeds, console.width))
        console.print(NOTE, style="dim")
    return 1 if any(each.failed for each in figures) else 0


def rendered(figures: Sequence[Figures], seeds: int, width: int = UNBOUNDED) -> Table:
    """The table: for every scenario a row of ours and, if there is one, the published one below.

    Args:
        figures: Of each scenario.
        seeds: How many each was planned with.
        width: Characters there are; where a line for a row is too long, rows take two.
    """
    wide = _laid_out(figures, seeds, wide=True)
    fits = Console(width=UNBOUNDED).measure(wide).maximum <= width
    return wide if fits else _laid_out(figures, seeds, wide=False)


def _laid_out(figures: Sequence[Figures], seeds: int, *, wide: bool) -> Table:
    """The table, with a line for each row or with standard deviations below what they are of."""
    title = f"{seeds} seed{'s' if seeds > 1 else ''} each"
    table = Table(title=title, title_justify="left", box=SIMPLE, padding=(0, 1 if wide else 0))
    table.add_column("scenario", no_wrap=True)
    heads = ["moves", "graph\n[s]", "task\n[s]", "motion planning\n[s]", "optimum\nlength", "mean\nlength"]
    for head in [*heads, "duration\n[s]", "replans"]:
        head = head if wide else head.replace(" ", "\n")
        table.add_column(head.replace("[", "\\["), justify="right", no_wrap=True)

    def add(cells: Sequence[str], style: str = "") -> None:
        folded = cells if wide else [cell.replace(" (", "\n(").replace(" + ", " +\n") for cell in cells]
        table.add_row(*folded, style=style)

    for each in figures:
        missing = f" ({len(each.failed)} failed)" if each.failed else ""
        ours = (
            f"[bold]{each.scenario}[/bold]{missing}",
            _number(each.makespan, 0),
            _number(each.graph, 3),
            _number(each.task, 2),
            _spread(each.motion, 1),
            "-" if each.optimum is None else f"{each.optimum:.3f}",
            _spread(each.length, 3),
            _spread(each.duration, 1),
            _number(each.replans, 0),
        )
        add(ours)
        if (published := PUBLISHED.get(each.scenario)) is not None:
            add(_published(published), "dim")
        table.add_section()
    return table


def _published(row: Published) -> list[str]:
    parts = row.states, row.edges
    graph = " + ".join(part or "-" for part in parts) if any(parts) else None
    cells = (row.makespan, graph, row.task, row.motion, row.optimum, row.length, None, row.replans)
    return [f"  Gönen {row.number}", *(cell or "-" for cell in cells)]


def _number(values: Sequence[float], digits: int) -> str:
    """The mean, with a digit more than wanted of whole numbers that differ."""
    middle = mean(values)
    if middle is None:
        return "-"
    return f"{middle:.{digits if digits or len(set(values)) == 1 else 1}f}"


def _spread(values: Sequence[float], digits: int) -> str:
    """The mean and, in parentheses, the standard deviation."""
    off = deviation(values)
    return _number(values, digits) + ("" if off is None else f" ({off:.{digits}f})")
