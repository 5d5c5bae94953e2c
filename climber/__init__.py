"""climber plans how robots with limbs climb walls of holds, and proves what it says."""

from climber.exceptions import ClimberError, ModelError, NoPlanFound, PlanFileError, ScenarioError

__version__ = "0.1.0"

__all__ = [
    "ClimberError",
    "ModelError",
    "NoPlanFound",
    "PlanFileError",
    "ScenarioError",
    "__version__",
]
