"""The checks of a robot's plan that need no mechanics: stances, phases, start, goal, how the phases join."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from climber.plan_parts import RobotPlan
from climber.robot import Robot
from climber.scenario import Place, RobotSpec
from climber.stance import Vector
from climber.verdict import Ledger
from climber.verify_model import Tree
from climber.verify_motion import Motion
from climber.verify_rules import LENGTH, REST
from climber.wall import Wall


class StructureChecks:
    """Goes through the discrete side of a robot's plan and takes down what it finds."""

    def __init__(self, robot: Robot, wall: Wall, spec: RobotSpec, plan: RobotPlan, ledger: Ledger) -> None:
        self._robot, self._wall, self._spec, self._plan, self._ledger = robot, wall, spec, plan, ledger
        self._tree = Tree(robot)
        self._samples = [Motion.samples(phase, plan, robot) for phase in plan.phases]

    def check(self) -> None:
        """Makes all checks."""
        self._ledger.faults("stances", list(self._stance_faults()))
        self._ledger.faults("phases", list(self._phase_faults()))
        self._start()
        self._goal()
        if self._spec.waypoints:
            self._waypoints()
        self._ledger.faults("avoided", list(self._avoided()))
        self._limb_order()
        self._joints_between_phases()
        self._contact_points()

    def _at(self, number: int) -> str:
        return f"{self._plan.name}, phase {number} ({self._plan.phases[number].label})"

    def _stance_faults(self) -> Iterator[str]:
        plan = self._plan
        if plan.moves != len(plan.stances) - 1:
            yield f"{plan.name}: {plan.moves} moves, but {len(plan.stances)} stances"
        for number, stance in enumerate(plan.stances):
            if len(set(stance.values())) < len(stance):
                yield f"{plan.name}, stance {number}: two limbs on one hold: {stance}"
        for number, (before, after) in enumerate(pairwise(plan.stances)):
            moved = [limb for limb in plan.limbs if before[limb] != after[limb]]
            if not moved and self._regrasped(number) is not None:
                continue
            if len(moved) != 1:
                yield f"{plan.name}, stance {number} to {number + 1}: {', '.join(moved) or 'no limb'} moved"

    def _regrasped(self, stance: int) -> str | None:
        """The limb that, according to the swing after a stance, lets go of its hold and takes it again."""
        swings = (phase.limb for phase in self._plan.phases if phase.kind == "swing" and phase.stance == stance)
        return next((limb for limb in swings if limb in self._plan.limbs), None)

    def _phase_faults(self) -> Iterator[str]:
        """Phases go shift, swing, shift, ... and a shift ends it; each has the contacts that its stance says."""
        plan = self._plan
        expected = 2 * len(plan.stances) - 1
        if len(plan.phases) != expected:
            yield f"{plan.name}: {len(plan.phases)} phases, but {expected} belong to {len(plan.stances)} stances"
        for number, phase in enumerate(plan.phases):
            at, stance = self._at(number), plan.stances[phase.stance]
            kind = "swing" if number % 2 else "shift"
            if phase.kind != kind:
                yield f"{at}: a {kind} is due"
            if phase.stance != number // 2:
                yield f"{at}: stance {number // 2} is due, not {phase.stance}"
            mover = None
            if phase.kind == "swing" and phase.stance + 1 < len(plan.stances):
                after = plan.stances[phase.stance + 1]
                mover = next((limb for limb in plan.limbs if after[limb] != stance[limb]), None)
                mover = mover or self._regrasped(phase.stance)
            if phase.limb != mover:
                yield f"{at}: the stances have {mover or 'no limb'} swing"
            holding = {contact.limb: contact.hold for contact in phase.contacts}
            due = {limb: hold for limb, hold in stance.items() if limb != mover}
            if holding != due:
                yield f"{at}: contacts {holding}; the stances have {due}"

    def _start(self) -> None:
        plan, spec = self._plan, self._spec
        wrong = [] if plan.stances[0] == spec.start else [f"{plan.name}, stance 0: {plan.stances[0]}"]
        self._ledger.faults("start stance", wrong)
        if spec.start_posture:
            joints = list(spec.start_posture)
            places = dict(
                zip(self._robot.joint_names, np.concatenate([limb.q for limb in self._robot.limbs]), strict=True)
            )
            first = self._samples[0].q[0, [places[joint] for joint in joints]]
            off = np.abs(first - np.array(list(spec.start_posture.values())))
            self._ledger.note("start posture", off, [f"{plan.name}, {joint}" for joint in joints])

    def _goal(self) -> None:
        plan, goal = self._plan, self._spec.goal
        if goal.holds is not None or goal.stance is not None:
            last = plan.stances[-1]
            wrong = [] if _stands(goal, last) else [f"{plan.name}, stance {len(plan.stances) - 1}: {last}"]
            self._ledger.faults("goal", wrong)
        if goal.pelvis is not None:
            outside = goal.pelvis.distance(*self._pelvis(len(plan.phases) - 1)[-1])
            self._ledger.note("goal pelvis", np.array([outside]), [f"{plan.name}, the end"])

    def _pelvis(self, number: int) -> Vector:
        """The pelvis's origin in W at each sample of a phase [m], shape (N, 3)."""
        return self._tree.pelvis(self._tree.poses(self._samples[number].q))

    def _waypoints(self) -> None:
        """Each waypoint is met at rest with all limbs on; in the given order, the next one not before it."""
        missed, reached = [], (0, 0)
        for place in self._spec.waypoints:
            if self._spec.waypoint_order == "any":
                reached = (0, 0)
            found = next((moment for moment in self._rests(reached) if self._meets(place, moment)), None)
            if found is None:
                missed.append(f"{self._plan.name}: {place.name or 'a waypoint'} is not reached after its predecessors")
            else:
                reached = found
        self._ledger.faults("waypoints", missed)

    def _rests(self, after: tuple[int, int]) -> Iterator[tuple[int, int]]:
        """Phase and sample of each instant at which the robot is at rest with all limbs on, from `after` on."""
        for number, samples in enumerate(self._samples):
            if self._plan.phases[number].kind == "shift":
                for row in np.flatnonzero(np.abs(samples.v).max(axis=1) <= REST):
                    if (number, int(row)) >= after:
                        yield number, int(row)

    def _meets(self, place: Place, moment: tuple[int, int]) -> bool:
        number, row = moment
        near = place.pelvis is None or place.pelvis.distance(*self._pelvis(number)[row]) <= LENGTH
        return near and _stands(place, self._plan.stances[self._plan.phases[number].stance])

    def _avoided(self) -> Iterator[str]:
        avoided = set(self._spec.avoid.holds)
        for number, stance in enumerate(self._plan.stances):
            for limb, hold in stance.items():
                if hold in avoided:
                    yield f"{self._plan.name}, stance {number}: {limb} on hold {hold}"

    def _limb_order(self) -> None:
        """In limb order the feet of each stance make a convex polygon, counter-clockwise (Gönen eqs 4.6).

        The turns at the corners of such a polygon are to the left and add up to one full turn. Feet in space are seen
        against the way that the wall faces where they stand.
        """
        for number, stance in enumerate(self._plan.stances):
            feet = self._stood_on(number, stance)
            edges = np.roll(feet, -1, axis=0) - feet
            after = np.roll(edges, -1, axis=0)
            across = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
            turns = np.arctan2(across, (edges * after).sum(axis=1))
            if len(feet) < 3:
                turns = np.full(len(feet), np.pi)
            elif turns.sum() > 3.0 * np.pi:  # left turns all, but more than once around: the order crosses over
                turns = np.full(len(feet), -np.inf)
            at = f"{self._plan.name}, stance {number}"
            self._ledger.note("limb order", turns, [f"{at}, {limb}" for limb in np.roll(self._plan.limbs, -1)])

    def _stood_on(self, number: int, stance: dict[str, int]) -> Vector:
        """Where the feet of a stance are seen, x to the right, in limb order [m], shape (num_limbs, 2)."""
        feet = {limb: self._wall.positions[hold] for limb, hold in stance.items()}
        for phase in self._plan.phases:
            if phase.stance == number and phase.kind == "shift":
                feet |= {contact.limb: contact.point for contact in phase.contacts}
        points = np.array([feet[limb] for limb in self._plan.limbs])
        if self._robot.planar:
            return points[:, :2]
        toward = self._wall.facing(np.array(list(stance.values())))
        # Which way is up does not change how the feet turn.
        x = np.cross([0.0, 1.0, 0.0] if abs(toward[1]) < 0.9 else [0.0, 0.0, -1.0], toward)
        x = x / np.linalg.norm(x)
        seen: Vector = points @ np.stack([x, np.cross(toward, x)], axis=1)
        return seen

    def _joints_between_phases(self) -> None:
        """Each phase goes on where the one before it stopped, and begins and ends at rest."""
        ledger, samples = self._ledger, self._samples
        positions, velocities = self._robot.position_names, self._robot.velocity_names
        for number, (before, after) in enumerate(pairwise(samples), start=1):
            at = self._at(number)
            ledger.note("time", np.abs(after.time[:1] - before.time[-1:]), [at])
            ledger.note("posture", np.abs(after.q[0] - before.q[-1]), [f"{at}, {name}" for name in positions])
        for number, phase in enumerate(samples):
            for row, when in ((0, "start"), (-1, "end")):
                at = f"{self._at(number)}, {when}"
                ledger.note("rest", np.abs(phase.v[row]), [f"{at}, {name}" for name in velocities])

    def _contact_points(self) -> None:
        """Contact points lie on their holds' patches, and stay where they are as long as the limb holds on."""
        before: dict[str, Vector] = {}
        for number, phase in enumerate(self._plan.phases):
            points = {contact.limb: contact.point for contact in phase.contacts}
            for contact in phase.contacts:
                at = f"{self._at(number)}, {contact.limb} on hold {contact.hold}"
                off = np.array([_off_patch(self._wall, contact.hold, contact.point, self._robot.planar)])
                self._ledger.note("patches", off, [at])
                if contact.limb in before:
                    moved = np.array([np.linalg.norm(contact.point - before[contact.limb])])
                    self._ledger.note("anchors", moved, [at])
            before = points


def _stands(place: Place, stance: dict[str, int]) -> bool:
    """Whether a stance is what a goal or waypoint asks for; one that names no holds asks for nothing."""
    return (place.holds is None or sorted(place.holds) == sorted(stance.values())) and (
        place.stance is None or place.stance == stance
    )


def _off_patch(wall: Wall, hold: int, point: Vector, planar: bool) -> float:
    """Distance of a point from a hold's patch [m]: a disk across the normal, to planar robots its part in the plane."""
    from_center = point - wall.positions[hold]
    height = float(from_center @ wall.normals[hold])
    across = from_center - height * wall.normals[hold]
    if planar:
        across = float(from_center @ wall.tangents[hold]) * wall.tangents[hold]
    length = float(np.linalg.norm(across))
    nearest = across * min(1.0, wall.holds[hold].half_width / length) if length > 0.0 else across
    return float(np.linalg.norm(from_center - nearest))
