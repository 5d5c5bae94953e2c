"""A plan made ready to be shown: its wall, what was asked for, and each robot's climb."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from climber import marks
from climber.plan_file import Plan
from climber.replay import Replay
from climber.robot import Model, Robot
from climber.scenario import Scenario, scenario_from_text
from climber.stance import Vector
from climber.wall import Wall


@dataclass(frozen=True)
class Scene:
    """What every picture of a plan is drawn from.

    Attributes:
        scenario: What was asked for.
        wall: Its wall.
        climbs: The climb of each robot, in the plan's order.
    """

    scenario: Scenario
    wall: Wall
    climbs: tuple[Replay, ...]

    @classmethod
    def of(cls, plan: Plan) -> Scene:
        """Reads the scenario within the plan and the robots' models.

        Raises:
            ScenarioError: If the scenario within the plan is wrong.
            ModelError: If a robot's model cannot be read.
            PlanFileError: If the plan does not go with them.
        """
        folder = Path(plan.scenario_path).absolute().parent
        scenario = scenario_from_text(plan.scenario_text, plan.scenario_path, folder)
        wall = scenario.build_wall()
        robots = [Robot(Model.load(part.model, folder), wall.gravity) for part in plan.robots]
        climbs = tuple(Replay(wall, part, robot) for part, robot in zip(plan.robots, robots, strict=True))
        return cls(scenario, wall, climbs)

    @property
    def covered(self) -> list[Vector]:
        """Points that a picture must have room for besides the wall [m], each of shape (n, 2)."""
        regions = [outline for spec in self.scenario.robots for outline in marks.points(spec)]
        return [climb.reached for climb in self.climbs] + regions

    @property
    def title(self) -> str:
        """The scenario's name and the number of moves."""
        moves = sum(len(climb.moves) for climb in self.climbs)
        return f"{self.scenario.name}: {moves} move{'' if moves == 1 else 's'}"

    @property
    def start(self) -> float:
        """When the first robot starts [s]."""
        return min(climb.start for climb in self.climbs)

    @property
    def end(self) -> float:
        """When the last robot is done [s]."""
        return max(climb.end for climb in self.climbs)
