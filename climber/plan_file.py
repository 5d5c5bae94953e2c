"""The plan file: everything a climb is, in one JSON file that a program without `climber` can check.

`docs/plan-format.md` describes the format field by field; this module writes it and has it read back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from climber.exceptions import PlanFileError
from climber.files import write_text
from climber.plan_json import parse, render
from climber.plan_parts import MarginKind, Phase, RobotPlan
from climber.plan_reader import read_least, read_robot

FORMAT = "climber-plan"
VERSION = 4


@dataclass(frozen=True)
class Plan:
    """A climb, self-contained: what was asked, what was found, and how.

    Attributes:
        scenario_path: Where the scenario was read from; relative models start in its folder.
        scenario_text: The scenario file, verbatim.
        seed: The seed that the plan came from.
        robots: One plan for each of the scenario's robots, in its order.
        software: Version of each program that had a part in it.
        timings: Seconds spent in each stage.
        min_margin: What every phase was to survive beyond what the scenario asks, by kind, in the kind's own unit.
    """

    scenario_path: str
    scenario_text: str
    seed: int
    robots: tuple[RobotPlan, ...]
    software: dict[str, str] = field(default_factory=dict)
    timings: dict[str, float] = field(default_factory=dict)
    min_margin: Mapping[MarginKind, float] = field(default_factory=dict)

    def to_json(self) -> str:
        """The plan as the text of a plan file."""
        return render(
            {
                "format": FORMAT,
                "version": VERSION,
                "scenario": {"path": self.scenario_path, "text": self.scenario_text},
                "software": self.software,
                "seed": self.seed,
                "min_margin": dict(self.min_margin),
                "timings": self.timings,
                "robots": [_robot_to_dict(robot) for robot in self.robots],
            }
        )

    @classmethod
    def from_json(cls, text: str, source: str = "plan") -> Plan:
        """Reads a plan from the text of a plan file.

        Args:
            text: The JSON text.
            source: What to call it in messages.

        Raises:
            PlanFileError: If the text is not a plan file of this version; the message says where and what is wrong.
        """
        root = parse(text, source)
        marks = root.some(["format", "version"])
        if marks["format"].value != FORMAT:
            raise marks["format"].error(f"{FORMAT!r} is expected; this is not a plan file")
        if marks["version"].value != VERSION or isinstance(marks["version"].value, bool):
            raise marks["version"].error(f"this program reads version {VERSION}")
        fields = root.fields(["format", "version", "scenario", "software", "seed", "min_margin", "timings", "robots"])
        scenario = fields["scenario"].fields(["path", "text"])
        robots = fields["robots"].items(at_least=1)
        return cls(
            scenario_path=scenario["path"].text(),
            scenario_text=scenario["text"].text(),
            seed=fields["seed"].integer(),
            min_margin=read_least(fields["min_margin"]),
            robots=tuple(read_robot(robot) for robot in robots),
            software={name: node.text() for name, node in fields["software"].entries().items()},
            timings={name: node.number() for name, node in fields["timings"].entries().items()},
        )

    def save(self, path: str | Path) -> None:
        """Writes the plan file, whole or not at all.

        Raises:
            PlanFileError: If the plan cannot be written down, for one because a number in it is not finite.
        """
        write_text(path, self.to_json())

    @classmethod
    def load(cls, path: str | Path) -> Plan:
        """Reads a plan file.

        Raises:
            PlanFileError: If there is no such file or it is not a plan file of this version.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise PlanFileError(f"{path}: cannot be read: {reason}") from error
        return cls.from_json(text, str(path))


def _robot_to_dict(robot: RobotPlan) -> dict[str, Any]:
    return {
        "name": robot.name,
        "model": robot.model,
        "limbs": list(robot.limbs),
        "positions": list(robot.positions),
        "velocities": list(robot.velocities),
        "joints": list(robot.joints),
        "counts": robot.counts,
        "moves": robot.moves,
        "cost": robot.cost,
        "proofs": robot.proofs,
        "objective": None if robot.objective is None else vars(robot.objective),
        "record": [list(entry) for entry in robot.record],
        "cuts": [vars(cut) for cut in robot.cuts],
        "stances": list(robot.stances),
        "phases": [_phase_to_dict(phase) for phase in robot.phases],
    }


def _phase_to_dict(phase: Phase) -> dict[str, Any]:
    return {
        "kind": phase.kind,
        "limb": phase.limb,
        "stance": phase.stance,
        "contacts": [{"limb": c.limb, "hold": c.hold, "point": c.point} for c in phase.contacts],
        "time": phase.time,
        "q": phase.q,
        "v": phase.v,
        "vd": phase.vd,
        "torque": phase.torque,
        "force": phase.force,
        "moment": phase.moment,
        "timing": {**vars(phase.timing), "active": [list(interval) for interval in phase.timing.active]},
        "margins": {kind: vars(margin) for kind, margin in phase.margins.items()},
    }
