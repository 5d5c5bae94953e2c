"""One climb in one YAML file: the wall, the robots, where each starts, where it must go, and the seed.

A scenario file becomes the dataclasses of `climber.scenario_fields` by Drake's `yaml_load_typed`, after
`climber.yaml_tree` has compared it with them and before `climber.scenario_check` asks whether it makes sense.
"""

from __future__ import annotations

import dataclasses
from dataclasses import field
from pathlib import Path

import yaml
from pydrake.common.yaml import yaml_load_typed

from climber.exceptions import ScenarioError
from climber.resources import packaged_scenarios, resolve_model, resolve_scenario
from climber.scenario_check import check_against_robot, check_scenario
from climber.scenario_fields import (
    AvoidSpec,
    Budget,
    CostWeights,
    HoldDefaults,
    HoldSpec,
    MinMargin,
    Place,
    RobotSpec,
    ScenarioFields,
    WallSpec,
)
from climber.scenario_shapes import (
    BoxSpec,
    CircleSpec,
    ConvexSpec,
    CylinderSpec,
    FacetSpec,
    PolygonSpec,
    RegionSpec,
    SphereSpec,
)
from climber.wall import Wall
from climber.yaml_tree import check_tree, read_tree

__all__ = [
    "AvoidSpec",
    "BoxSpec",
    "Budget",
    "CircleSpec",
    "ConvexSpec",
    "CostWeights",
    "CylinderSpec",
    "FacetSpec",
    "HoldDefaults",
    "HoldSpec",
    "MinMargin",
    "Place",
    "PolygonSpec",
    "RegionSpec",
    "RobotSpec",
    "Scenario",
    "SphereSpec",
    "WallSpec",
    "check_against_robot",
    "load_scenario",
    "scenario_from_text",
]


@dataclasses.dataclass
class Scenario(ScenarioFields):
    """A climb to be planned: the fields of a file, and where they came from.

    Attributes:
        source: The text it was read from, verbatim.
        file: What errors call that text: its path, or the name given with it.
        folder: Where the relative paths of models start.
    """

    source: str = field(default="", compare=False)
    file: str = field(default="", compare=False)
    folder: Path = field(default=Path(), compare=False)

    def build_wall(self) -> Wall:
        """The wall with its holds completed from the defaults and obstacles no smaller than they are."""
        return Wall(
            holds=tuple(hold.build(self.wall.hold_defaults) for hold in self.wall.holds),
            inclination_deg=self.wall.inclination_deg,
            facets=tuple(facet.build() for facet in self.wall.facets),
        ).closing(self.wall.obstacles)

    def planning_wall(self) -> Wall:
        """The wall with as much less friction as every phase must survive."""
        wall = self.build_wall()
        return wall.slippery(self.min_margin.drop) if self.min_margin.friction else wall

    def model_path(self, robot_index: int) -> Path:
        """The model file of one robot."""
        return resolve_model(self.robots[robot_index].model, self.folder)

    def error(self, path: str, given: object, allowed: str) -> ScenarioError:
        """An error about one value of this scenario, for the caller to raise; see `ScenarioError.at`."""
        return ScenarioError.at(self.file, path, given, allowed)


def scenario_from_text(text: str, name: str = "scenario", folder: Path | None = None) -> Scenario:
    """Reads a scenario from YAML text.

    Args:
        text: The text of a scenario file.
        name: What errors call it; its stem names a scenario that does not name itself.
        folder: Where the relative paths of models start; the working directory by default.

    Raises:
        ScenarioError: If anything about it is wrong.
    """
    tree = read_tree(text, name)
    check_tree(tree, ScenarioFields, name)
    try:
        # Not the text again: what is loaded is what was checked.
        loaded = yaml_load_typed(schema=ScenarioFields, data=yaml.safe_dump(tree, allow_unicode=True, sort_keys=False))
    except (RuntimeError, ValueError, TypeError, AssertionError, yaml.YAMLError) as error:
        raise ScenarioError(f"{name}: Drake cannot read this scenario: {error}", file=name) from error
    scenario = Scenario(**vars(loaded), source=text, file=name, folder=folder or Path.cwd())
    scenario.name = scenario.name.strip() or Path(name).stem
    check_scenario(scenario)
    return scenario


def load_scenario(source: str | Path) -> Scenario:
    """Reads a scenario file.

    Args:
        source: A path, or the bare name of a scenario that comes with climber, such as `basic`.

    Raises:
        ScenarioError: If the file cannot be read or anything in it is wrong. The message names the file, the field,
            the value given and what is allowed.
    """
    path = resolve_scenario(source)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        come_along = ", ".join(packaged_scenarios())
        allowed = f"a readable UTF-8 file, or the name of a scenario that comes with climber ({come_along})"
        raise ScenarioError(f"{path}: {reason}; allowed: {allowed}", file=str(path), allowed=allowed) from error
    return scenario_from_text(text, str(path), path.absolute().parent)
