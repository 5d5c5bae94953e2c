"""climber plans how robots with limbs climb walls of holds, and proves what it says."""

from climber.exceptions import ClimberError, ModelError, NoPlanFound, PlanFileError, ScenarioError
from climber.scenario import Scenario, load_scenario, scenario_from_text

__version__ = "0.1.0"

__all__ = [
    "ClimberError",
    "ModelError",
    "NoPlanFound",
    "PlanFileError",
    "Scenario",
    "ScenarioError",
    "__version__",
    "load_scenario",
    "scenario_from_text",
]
