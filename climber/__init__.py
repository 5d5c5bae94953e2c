"""climber plans how robots with limbs climb walls of holds, and proves what it says."""

from climber.exceptions import ClimberError, ModelError, NoPlanFound, PlanFileError, ScenarioError
from climber.plan import plan_climb
from climber.plan_file import Plan
from climber.scenario import Scenario, load_scenario, scenario_from_text
from climber.verdict import Verdict
from climber.verify import verify

__version__ = "0.1.0"

__all__ = [
    "ClimberError",
    "ModelError",
    "NoPlanFound",
    "Plan",
    "PlanFileError",
    "Scenario",
    "ScenarioError",
    "Verdict",
    "__version__",
    "load_scenario",
    "plan_climb",
    "scenario_from_text",
    "verify",
]
