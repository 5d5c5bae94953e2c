"""`climber robot`: the command that shows what is read from a robot model."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from climber.robot import Robot


def add_robot_command(commands: Any) -> argparse.ArgumentParser:
    """Adds `robot` to the subcommands of a parser."""
    parser: argparse.ArgumentParser = commands.add_parser("robot", help="show what is read from a robot model")
    parser.add_argument("model", help="URDF or SDF file, or package://climber/...")
    parser.set_defaults(run=_robot)
    return parser


def _robot(options: argparse.Namespace) -> int:
    robot = Robot(options.model)
    names = robot.limb_names
    if options.json:
        facts = {
            "name": robot.name,
            "mass": robot.mass,
            "planar": robot.planar,
            "positions": list(robot.position_names),
            "limbs": [
                {
                    "name": limb.name,
                    "foot": limb.foot,
                    "reach": limb.reach,
                    "joints": list(limb.joints),
                    "lower": _finite(limb.lower),
                    "upper": _finite(limb.upper),
                    "velocity": _finite(limb.velocity),
                    "effort": _finite(limb.effort),
                }
                for limb in robot.limbs
            ],
            "symmetries": [[names[i] for i in symmetry] for symmetry in robot.symmetries],
        }
        print(json.dumps(facts))
        return 0
    console = Console(highlight=False)
    base = "moves in the wall plane" if robot.planar else "floats freely"
    console.print(f"[bold]{robot.name}[/bold]: {robot.mass:.3g} kg, {len(names)} limbs, its pelvis {base}")
    names_column = [Column(header, no_wrap=True) for header in ("limb", "joint")]
    table = Table(*names_column, "position [rad]", "velocity [rad/s]", "effort [N m]", "reach [m]")
    for limb in robot.limbs:
        if not limb.joints:
            table.add_row(limb.name, "none", "", "", "", f"{limb.reach:.3g}")
        for i, joint in enumerate(limb.joints):
            table.add_row(
                limb.name if i == 0 else "",
                joint,
                f"{limb.lower[i]:.3g} to {limb.upper[i]:.3g}",
                f"{limb.velocity[i]:.3g}",
                f"{limb.effort[i]:.3g}",
                f"{limb.reach:.3g}" if i == 0 else "",
            )
    console.print(table)
    for symmetry in robot.symmetries[1:]:
        console.print("symmetric: " + ", ".join(f"{a} → {names[b]}" for a, b in zip(names, symmetry, strict=True)))
    return 0


def _finite(limits: Iterable[float]) -> list[float | None]:
    """Limits as JSON has them: null for none."""
    return [float(limit) if math.isfinite(limit) else None for limit in limits]
