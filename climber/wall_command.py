"""`climber wall`: the command that makes a random wall and writes it as a scenario."""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from climber.exceptions import ClimberError
from climber.random_wall import Recipe, Spread
from climber.wall_kinds import KINDS

MODEL = "package://climber/quadruped/quadruped.urdf"  # for the plane
SPACE_MODEL = "package://climber/lemur/lemur.urdf"
_PLAIN = KINDS["plane"]
_NUMBERS = {  # field of the recipe, how it is told, and what it is
    "seed": ("of all random numbers", int),
    "density": ("holds to the square metre; of a chimney, between its sides", float),
    "spacing": ("least distance of two holds [m]", float),
    "aspect": ("height over width", float),
    "half_width": ("of the holds' patches [m]", float),
    "min_force": ("along a friction cone's edge [N]", float),
    "max_force": ("along a friction cone's edge [N]", float),
    "inclination_deg": ("90 is vertical [degrees]", float),
    "standoff": ("how far holds stick out of the surface; in space [m]", float),
    "angle_deg": ("between the two sides of a corner [degrees]", float),
    "gap": ("between the holds on the two sides of a chimney [m]", float),
    "problem": ("holds in each row of a board that belong to the problem set on it", int),
}
_SPREADS = {
    "friction": "friction coefficients: normal, clipped",
    "incut": "angles of the normals into the wall from straight against gravity: normal, clipped; in space [degrees]",
}

_SPACE = tuple(kind for kind in KINDS if kind != "plane")
_SCATTERED = tuple(kind for kind in KINDS if kind not in ("chimney", "board"))
_LEDGES = tuple(kind for kind in _SPACE if kind != "chimney")
_ONLY = {  # options that only some kinds of wall have a use for
    "angle_deg": ("inside_corner", "outside_corner"),
    "gap": ("chimney",),
    "problem": ("board",),
    "standoff": _SPACE,
    "incut": _LEDGES,
    "incut_limits": _LEDGES,
    "aspect": _SCATTERED,
    "spacing": _SCATTERED,
    "density": tuple(kind for kind in KINDS if kind != "board"),
    "holds": tuple(kind for kind in KINDS if kind != "board"),
}


def add_wall_command(commands: Any) -> argparse.ArgumentParser:
    """Adds `wall` to the subcommands of a parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "wall",
        help="make a random wall",
        description="Makes a random wall with a climb on it, from the bottom to the top, and writes it as a scenario. "
        "The same arguments make the same file. Defaults are those of the kind of wall; shown are the plane's.",
    )
    words = "plane, for planar robots (default), or a kind of wall in space"
    parser.add_argument("--kind", choices=tuple(KINDS), default="plane", help=words)
    parser.add_argument("--holds", type=int, help="number of holds; a board has its own")
    for name, (what, kind) in _NUMBERS.items():
        flag = _flag(name)
        parser.add_argument(flag, dest=name, type=kind, help=f"{what} (default: {getattr(_PLAIN, name):g})")
    for name, what in _SPREADS.items():
        spread: Spread = getattr(_PLAIN, name)
        usual = f"(default: {spread.mean:g} {spread.deviation:g})"
        parser.add_argument(f"--{name}", type=float, nargs=2, metavar=("MEAN", "DEVIATION"), help=f"{what} {usual}")
        usual = f"where they are clipped (default: {spread.lower:g} {spread.upper:g})"
        parser.add_argument(f"--{name}-limits", type=float, nargs=2, metavar=("LEAST", "MOST"), help=usual)
    what = "angles of the normals from straight up: normal, clipped [degrees]"
    usual = f"(default: {_PLAIN.slope.deviation:g})"
    parser.add_argument("--slope", type=float, metavar="DEVIATION", help=f"{what} {usual}")
    what = f"where they are clipped, either way [degrees] (default: {_PLAIN.slope.upper:g})"
    parser.add_argument("--steepest", type=float, help=what)
    what = "the robot; a path starts from the folder of the scenario (default: the quadruped, in space lemur)"
    parser.add_argument("--model", help=what)
    parser.add_argument("--name", help="of the scenario; that of the file if left out")
    parser.add_argument("--out", type=Path, required=True, help="scenario file to write")
    parser.set_defaults(run=_wall)
    return parser


def _flag(name: str) -> str:
    """The option that gives a field of the recipe."""
    return f"--{name.removesuffix('_deg').replace('_', '-')}"


def recipe_of(options: argparse.Namespace) -> Recipe:
    """The recipe that the options of the command stand for.

    Raises:
        ClimberError: If it is not said how many holds there are, or something that the kind of wall has no use for.
    """
    for name, kinds in _ONLY.items():
        if getattr(options, name) is not None and options.kind not in kinds:
            raise ClimberError(f"{_flag(name)} is given for a wall of kind {options.kind}; allowed: {', '.join(kinds)}")
    base = KINDS[options.kind]
    if options.holds is None and options.kind != "board":
        raise ClimberError("--holds is not given; allowed: the number of holds")
    given = {name: getattr(options, name) for name in ("holds", *_NUMBERS)}
    recipe = replace(base, **{name: value for name, value in given.items() if value is not None})
    limits = None if options.steepest is None else (-options.steepest, options.steepest)
    slope = None if options.slope is None else (base.slope.mean, options.slope)
    return replace(
        recipe,
        friction=_spread(base.friction, options.friction, options.friction_limits),
        incut=_spread(base.incut, options.incut, options.incut_limits),
        slope=_spread(base.slope, slope, limits),
    )


def _spread(base: Spread, middle: Sequence[float] | None, limits: Sequence[float] | None) -> Spread:
    """A spread with its mean and deviation, or the limits, replaced."""
    mean, deviation = middle or (base.mean, base.deviation)
    lower, upper = limits or (base.lower, base.upper)
    return Spread(mean, deviation, lower, upper)


def _command(options: argparse.Namespace) -> str:
    """The command line that makes the same file in its folder."""
    words = ["climber", "wall"]
    for name, value in vars(options).items():
        if name in ("run", "json", "out") or value is None or (name, value) == ("kind", "plane"):
            continue
        values = value if isinstance(value, list) else [value]
        flag = _flag(name)
        words += [flag, *(f"{v:g}" if isinstance(v, float) else str(v) for v in values)]
    return shlex.join([*words, "--out", options.out.name])


def _wall(options: argparse.Namespace) -> int:
    from climber.files import write_text
    from climber.random_scenario import find_climb, scenario_text
    from climber.scenario import scenario_from_text

    out: Path = options.out
    if out.suffix not in (".yaml", ".yml"):
        raise ClimberError(f"--out is {out}; allowed: a .yaml file")
    recipe, folder = recipe_of(options), out.absolute().parent
    model = options.model or (MODEL if recipe.kind == "plane" else SPACE_MODEL)
    climb = find_climb(recipe, model, folder)
    text = scenario_text(recipe, model, climb, options.name or out.stem, _command(options))
    scenario_from_text(text, str(out), folder)  # what is written can be read
    write_text(out, text)
    width, height = recipe.size
    if options.json:
        facts = {
            "ok": True,
            "holds": recipe.holds,
            "size": [round(width, 4), round(height, 4)],
            "start": climb.start,
            "goal": {"center": climb.goal.center, "radius": climb.goal.radius},
            "least_moves": climb.moves,
            "file": str(out),
        }
        print(json.dumps(facts))
    else:
        Console(highlight=False, soft_wrap=True).print(
            f"{recipe.holds} holds on {width:.2f} m x {height:.2f} m; from bottom to top in {climb.moves} moves or more"
            f"\nwrote {out}",
            markup=False,
        )
    return 0
