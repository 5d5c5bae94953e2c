"""The checks of what a climb was chosen for: its value, worked out again from the samples, and the record."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from climber.plan_parts import Phase, RobotPlan
from climber.robot import Robot
from climber.stance import Vector
from climber.verdict import Ledger
from climber.verify_equilibrium import support_of
from climber.verify_model import Tree
from climber.verify_motion import Motion
from climber.wall import Wall


class ObjectiveChecks:
    """Looks at one robot's objective and record and takes down what it finds."""

    def __init__(self, robot: Robot, wall: Wall, plan: RobotPlan, ledger: Ledger) -> None:
        self._robot, self._wall, self._plan, self._ledger = robot, wall, plan, ledger

    def check(self) -> None:
        """Checks that the value is that of the phases, and that the record leads down to it."""
        plan, objective = self._plan, self._plan.objective
        if objective is None:
            wrong = [f"{plan.name}: a record of nothing in particular"] if plan.record else []
            self._ledger.faults("record", wrong)
            return
        off = abs(objective.value - self._value())
        self._ledger.note("objective", np.array([off]), [f"{plan.name}, {objective.kind}"])
        self._ledger.faults("record", [f"{plan.name}: {fault}" for fault in self._record(objective.value)])

    def _record(self, value: float) -> list[str]:
        record, found = self._plan.record, []
        if not record or record[-1][1] != value:
            found.append("the record does not end with the plan's value")
        if any(seconds < 0.0 for seconds, _ in record):
            found.append("the record begins before planning does")
        for entry, (before, after) in enumerate(pairwise(record), start=1):
            if after[0] < before[0]:
                found.append(f"entry {entry} of the record is earlier than the one before")
            if after[1] > before[1]:
                found.append(f"entry {entry} of the record is worse than the one before")
        return found

    def _value(self) -> float:
        plan = self._plan
        assert plan.objective is not None
        if plan.objective.kind == "length":
            return float(sum(np.linalg.norm(np.diff(phase.q, axis=0), axis=1).sum() for phase in plan.phases))
        if plan.objective.kind == "time":
            return float(sum(phase.time[-1] - phase.time[0] for phase in plan.phases))
        return -self._slack()

    def _slack(self) -> float:
        """The least slack: of equilibrium as a share of the limbs' mean reach, of torque as a share of its limit."""
        robot, phases = self._robot, self._plan.phases
        tree, reach, driven = Tree(robot), float(np.mean(robot.reach)), robot.effort > 0.0
        slack = 1.0
        for number, phase in enumerate(phases):
            motion = Motion.samples(phase, self._plan, robot)
            center = tree.center_of_mass(tree.poses(motion.q))
            over = [(phase, center)]
            if number > 0:
                over.append((phases[number - 1], center[:1]))
            if number + 1 < len(phases):
                over.append((phases[number + 1], center[-1:]))
            for holding, at in over:
                slack = min(slack, self._room(holding, at) / reach)
            used = np.abs(motion.torque[:, driven]) / robot.effort[driven]
            slack = min(slack, float((1.0 - used).min(initial=np.inf)))
        return slack

    def _room(self, holding: Phase, center: Vector) -> float:
        """How far the centre of mass is inside the support of a phase's contacts, at the least [m]."""
        points = np.array([contact.point for contact in holding.contacts]).reshape(-1, 3)
        holds = [contact.hold for contact in holding.contacts]
        support = support_of(self._wall, holds, points, self._robot.mass, self._robot.planar)
        return float(support.margin(center).min())
