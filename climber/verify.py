"""Checks a plan from nothing but its file and the robot model.

A program that checks must not share the mistakes of the one that made the plan, so nothing of the planner is used here:
no stance graph, manifold, motion or program, only the file (`plan_file`), the scenario in it (`scenario`, `wall`) and
the model (`robot`). What is asked of a plan, and how exactly, is listed in `verify_rules`. What is *not* checked: that
the plan has the fewest moves or the least cost, and that cut moves are impossible.
"""

from __future__ import annotations

from pathlib import Path

from climber.exceptions import ModelError, PlanFileError, ScenarioError
from climber.plan_file import Plan
from climber.plan_parts import MARGIN_KINDS, RobotPlan
from climber.robot import Model, Robot
from climber.scenario import Scenario, check_against_robot, scenario_from_text
from climber.verdict import Check, Ledger, Verdict
from climber.verify_margins import MarginChecks
from climber.verify_model import Tree
from climber.verify_motion import MotionChecks
from climber.verify_objective import ObjectiveChecks
from climber.verify_rules import RULES
from climber.verify_structure import StructureChecks
from climber.verify_team import TeamChecks
from climber.verify_timing import TimingChecks
from climber.wall import Wall

__all__ = ["Check", "Verdict", "verify"]


def verify(plan: Plan | str | Path) -> Verdict:
    """Checks a plan.

    Args:
        plan: A plan file, or a plan, which is judged as the file that it would be saved as.

    Returns:
        Every check with its worst value, its limit and where.

    Raises:
        PlanFileError: If the file cannot be understood: not a plan file, names that are not the model's, a scenario
            that is none.
        ModelError: If the robot's model cannot be loaded, or is of a kind that cannot be checked yet.
    """
    source = "plan" if isinstance(plan, Plan) else str(plan)
    read = Plan.from_json(plan.to_json(), source) if isinstance(plan, Plan) else Plan.load(plan)
    try:
        folder = Path(read.scenario_path).absolute().parent
        scenario = scenario_from_text(read.scenario_text, f"{source}: scenario.text", folder)
    except ScenarioError as error:
        raise PlanFileError(str(error)) from error
    names = [spec.name for spec in scenario.robots]
    if [robot.name for robot in read.robots] != names:
        raise PlanFileError(f"{source}: robots: the scenario's robots are expected: {', '.join(names)}")
    wall = scenario.build_wall()
    ledger = Ledger(RULES)
    of_scenario = vars(scenario.min_margin)
    asked = {kind: max(of_scenario[kind], read.min_margin.get(kind, 0.0)) for kind in MARGIN_KINDS}
    robots = [_robot(scenario, number, robot_plan, wall, source) for number, robot_plan in enumerate(read.robots)]
    for number, (robot, robot_plan) in enumerate(zip(robots, read.robots, strict=True)):
        spec = scenario.robots[number]
        StructureChecks(robot, wall, spec, robot_plan, ledger).check()
        MotionChecks(robot, wall, spec, robot_plan, ledger).check()
        TimingChecks(robot, wall, scenario.budget.jerk_limit, robot_plan, ledger).check()
        MarginChecks(robot, wall, asked, robot_plan, ledger).check()
        ObjectiveChecks(robot, wall, robot_plan, ledger).check()
    if len(robots) > 1:
        TeamChecks(robots, read.robots, ledger).check()
    return Verdict(source, ledger.checks())


def _robot(scenario: Scenario, number: int, plan: RobotPlan, wall: Wall, source: str) -> Robot:
    """The robot that a plan is for, after making sure that the plan's names and hold numbers have a meaning."""
    at = f"{source}: robots[{number}]"
    if plan.model != scenario.robots[number].model:
        raise PlanFileError(f"{at}.model: the scenario says {scenario.robots[number].model} (given: {plan.model})")
    robot = Robot(Model.load(plan.model, scenario.folder), wall.gravity)
    if robot.planar and not Tree(robot).is_planar():
        raise ModelError(f"{robot.model.path}: the pelvis stays in the wall plane and its limbs leave it; let it float")
    try:
        check_against_robot(scenario, number, robot.limb_names, robot.joint_limits, robot.planar)
    except ScenarioError as error:
        raise PlanFileError(str(error)) from error
    if plan.limbs != robot.limb_names:
        raise PlanFileError(f"{at}.limbs: the model has {', '.join(robot.limb_names)}, in this order")
    columns = {
        "positions": (plan.positions, robot.position_names),
        "velocities": (plan.velocities, robot.velocity_names),
        "joints": (plan.joints, robot.joint_names),
    }
    for field, (given, expected) in columns.items():
        if sorted(given) != sorted(expected):
            raise PlanFileError(f"{at}.{field}: the model has {', '.join(expected)} (given: {', '.join(given)})")
    count = len(wall.holds)
    used = {f"stances[{i}].{limb}": hold for i, stance in enumerate(plan.stances) for limb, hold in stance.items()}
    for i, phase in enumerate(plan.phases):
        used |= {f"phases[{i}].contacts[{k}].hold": contact.hold for k, contact in enumerate(phase.contacts)}
    for where, hold in used.items():
        if hold >= count:
            raise PlanFileError(f"{at}.{where}: the wall has {count} holds, numbered from 0 (given: {hold})")
    return robot
