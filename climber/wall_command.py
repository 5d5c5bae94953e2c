"""`climber wall`: the command that makes a random wall and writes it as a scenario."""

from __future__ import annotations

import argparse
import json
import shlex
from pathlib import Path
from typing import Any

from rich.console import Console

from climber.exceptions import ClimberError
from climber.random_wall import Recipe, Spread

MODEL = "package://climber/quadruped/quadruped.urdf"
_PLAIN = Recipe()


def add_wall_command(commands: Any) -> argparse.ArgumentParser:
    """Adds `wall` to the subcommands of a parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "wall",
        help="make a random wall",
        description="Makes a random wall with a climb on it, from the bottom to the top, and writes it as a scenario. "
        "The same arguments make the same file.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--holds", type=int, required=True, help="number of holds")
    parser.add_argument("--seed", type=int, default=_PLAIN.seed, help="of all random numbers")
    parser.add_argument("--density", type=float, default=_PLAIN.density, help="holds to the square metre")
    parser.add_argument("--spacing", type=float, default=_PLAIN.spacing, help="least distance of two holds [m]")
    parser.add_argument("--aspect", type=float, default=_PLAIN.aspect, help="height over width")
    parser.add_argument(
        "--friction",
        type=float,
        nargs=2,
        metavar=("MEAN", "DEVIATION"),
        default=[_PLAIN.friction.mean, _PLAIN.friction.deviation],
        help="friction coefficients: normal, clipped",
    )
    parser.add_argument(
        "--friction-limits",
        type=float,
        nargs=2,
        metavar=("LEAST", "MOST"),
        default=[_PLAIN.friction.lower, _PLAIN.friction.upper],
        help="where they are clipped",
    )
    parser.add_argument(
        "--slope",
        type=float,
        metavar="DEVIATION",
        default=_PLAIN.slope.deviation,
        help="angles of the normals from straight up: normal, clipped [degrees]",
    )
    parser.add_argument(
        "--steepest", type=float, default=_PLAIN.slope.upper, help="where they are clipped, either way [degrees]"
    )
    parser.add_argument("--half-width", type=float, default=_PLAIN.half_width, help="of the holds' patches [m]")
    parser.add_argument("--min-force", type=float, default=_PLAIN.min_force, help="along a friction cone's edge [N]")
    parser.add_argument("--max-force", type=float, default=_PLAIN.max_force, help="along a friction cone's edge [N]")
    parser.add_argument("--inclination", type=float, default=_PLAIN.inclination_deg, help="90 is vertical [degrees]")
    parser.add_argument("--model", default=MODEL, help="the robot; a path starts from the folder of the scenario")
    parser.add_argument("--name", help="of the scenario; that of the file if left out")
    parser.add_argument("--out", type=Path, required=True, help="scenario file to write")
    parser.set_defaults(run=_wall)
    return parser


def recipe_of(options: argparse.Namespace) -> Recipe:
    """The recipe that the options of the command stand for."""
    return Recipe(
        holds=options.holds,
        seed=options.seed,
        density=options.density,
        spacing=options.spacing,
        aspect=options.aspect,
        friction=Spread(*options.friction, *options.friction_limits),
        slope=Spread(0.0, options.slope, -options.steepest, options.steepest),
        half_width=options.half_width,
        min_force=options.min_force,
        max_force=options.max_force,
        inclination_deg=options.inclination,
    )


def _command(options: argparse.Namespace, parser: argparse.ArgumentParser) -> str:
    """The command line that makes the same file in its folder; defaults are left out."""
    words = ["climber", "wall"]
    for name, value in vars(options).items():
        if name in ("run", "json", "out") or (name != "holds" and value == parser.get_default(name)):
            continue
        values = value if isinstance(value, list) else [value]
        words += [f"--{name.replace('_', '-')}", *(f"{v:g}" if isinstance(v, float) else str(v) for v in values)]
    return shlex.join([*words, "--out", options.out.name])


def _wall(options: argparse.Namespace) -> int:
    from climber.files import write_text
    from climber.random_scenario import find_climb, scenario_text
    from climber.scenario import scenario_from_text

    out: Path = options.out
    if out.suffix not in (".yaml", ".yml"):
        raise ClimberError(f"--out is {out}; allowed: a .yaml file")
    recipe, folder = recipe_of(options), out.absolute().parent
    climb = find_climb(recipe, options.model, folder)
    made_by = _command(options, add_wall_command(argparse.ArgumentParser().add_subparsers()))
    text = scenario_text(recipe, options.model, climb, options.name or out.stem, made_by)
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
