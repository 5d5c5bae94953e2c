"""The checks of what a plan says about its timing: the limits it was timed with, and which of them it runs at."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climber.plan_parts import Phase, PhaseContact, RobotPlan
from climber.robot import Robot
from climber.stance import Vector
from climber.verdict import Ledger
from climber.verify_grips import Grip
from climber.verify_rules import SAME
from climber.wall import GRAVITY, Wall

RATES = ("speed", "acceleration", "jerk")
SMALLEST = 1e-9  # [m/s, rad/s and their derivatives] that a limit is taken for


class TimingChecks:
    """Goes through a robot's phases and takes down what their timing gets wrong."""

    def __init__(self, robot: Robot, wall: Wall, jerk_limit: float, plan: RobotPlan, ledger: Ledger) -> None:
        self._robot, self._wall, self._plan, self._ledger = robot, wall, plan, ledger
        fastest = np.concatenate([limb.velocity for limb in robot.limbs])
        swiftest = np.concatenate([limb.acceleration for limb in robot.limbs])
        names = [robot.velocity_names[place] for place in robot.joint_v]
        self._most = {
            "speed": dict(zip(names, fastest.tolist(), strict=True)),
            "acceleration": dict(zip(names, swiftest.tolist(), strict=True)),
            "jerk": dict.fromkeys(names, jerk_limit),
        }
        reach = float(np.mean(robot.reach))
        for place, turns in zip(robot.base_v, np.isin(robot.base_q, robot.angle_q), strict=True):
            self._most["jerk"][robot.velocity_names[place]] = jerk_limit * (1.0 if turns else reach)

    def check(self) -> None:
        """Checks every phase."""
        for number, phase in enumerate(self._plan.phases):
            where = f"{self._plan.name}, phase {number} ({phase.label})"
            self._ledger.faults("timing", [f"{where}: {fault}" for fault in self._faults(phase)])
            self._within(phase, where)
            for begin, end, name in phase.timing.active:
                self._in_use(phase, begin, end, name, where)

    def _faults(self, phase: Phase) -> Iterator[str]:
        """What makes no sense."""
        timing = phase.timing
        if timing.method == "paced" and (timing.active or timing.limits):
            yield "paced by a law of fixed shape, it has neither limits nor active ones"
        for kind, limits in timing.limits.items():
            for name, limit in limits.items():
                most = self._most[kind].get(name, np.inf)
                if not 0.0 < limit <= most + SAME:
                    whose = f", at most {most:g}" if limit > 0.0 else ""
                    yield f"its limit of {kind} of {name} is {limit:g}{whose}"
        before = -np.inf
        for begin, end, name in timing.active:
            if not (max(before, phase.time[0] - SAME) <= begin < end <= phase.time[-1] + SAME):
                yield f"{name} from {begin:g} to {end:g} s is not in order, or not within the phase"
            before = begin
            if self._kind(phase, name) is None:
                yield f"{name!r} is none of its limits"

    def _kind(self, phase: Phase, name: str) -> str | None:
        """What kind of limit a name means in this phase, if any."""
        kind, _, of = name.rpartition(" ")
        known = {
            **{rate: list(phase.timing.limits.get(rate, {})) for rate in RATES},
            "torque": list(self._plan.joints),
            "friction": [c.limb for c in phase.contacts if self._wall.holds[c.hold].grip != "pin"],
            "force limit": [c.limb for c in phase.contacts],
            "moment": [c.limb for c in phase.contacts if self._wall.holds[c.hold].max_moment > 0.0],
        }
        return kind if of in known.get(kind, []) else None

    def _rates(self, phase: Phase, kind: str, name: str) -> Vector:
        """Size of a velocity or its derivative at the samples, shape (N,); of jerk the mean over a step beside it."""
        column = self._plan.velocities.index(name)
        if kind == "jerk":
            steps = np.abs(np.diff(phase.vd[:, column])) / np.diff(phase.time)
            sizes: Vector = np.maximum(np.append(steps, steps[-1]), np.append(steps[0], steps))
        else:
            sizes = np.abs((phase.v if kind == "speed" else phase.vd)[:, column])
        return sizes

    def _shares(self, phase: Phase, kind: str, name: str) -> Vector:
        """A rate at the samples as a share of its limit, a very small one for limits that cannot be."""
        return self._rates(phase, kind, name) / max(phase.timing.limits[kind][name], SMALLEST)

    def _within(self, phase: Phase, where: str) -> None:
        """The motion keeps to the limits it was timed with."""
        for kind, limits in phase.timing.limits.items():
            for name in limits:
                use = self._shares(phase, kind, name)
                place = int(use.argmax())
                at = f"{where}, t = {phase.time[place]:.4f} s, {kind} {name}"
                self._ledger.note("timing jerk" if kind == "jerk" else "timing limits", use[[place]], [at])

    def _in_use(self, phase: Phase, begin: float, end: float, name: str, where: str) -> None:
        """A limit that is told as active is nearly reached all along."""
        kind, of = self._kind(phase, name), name.rpartition(" ")[2]
        inside = np.flatnonzero((phase.time >= begin - SAME) & (phase.time <= end + SAME))
        if kind is None or not len(inside):
            return
        told = [f"{where}, t = {phase.time[k]:.4f} s, {name}" for k in inside]
        if kind in RATES:
            share = self._shares(phase, kind, of)[inside]
        elif kind == "torque":
            column = self._robot.joint_names.index(of)
            share = np.abs(phase.torque[inside, self._plan.joints.index(of)]) / self._robot.effort[column]
        elif kind == "moment":
            (hold,) = (self._wall.holds[c.hold] for c in phase.contacts if c.limb == of)
            share = np.abs(phase.moment[of][inside]) / hold.max_moment if of in phase.moment else np.zeros(len(inside))
        else:
            (contact,) = (c for c in phase.contacts if c.limb == of)
            room = self._room(contact, kind, phase.force[of][inside])
            self._ledger.note("active contacts", room / (GRAVITY * self._robot.mass), told)
            return
        self._ledger.note("active limits", share, told)

    def _room(self, contact: PhaseContact, kind: str, force: Vector) -> Vector:
        """How far forces (K, 3) are inside a friction cone, or from the greatest force [N], shape (K,)."""
        hold = self._wall.holds[contact.hold]
        room = -Grip.of(hold, self._robot.planar).excess(force)
        if hold.grip == "pin":
            return room
        # In multiples of the cone's edges the cone begins at the least force and ends, upside down, at the greatest.
        adhesion = hold.adhesion if hold.grip == "magnet" else 0.0
        along = (force @ self._wall.normals[contact.hold] + adhesion) * np.hypot(1.0, hold.friction) / 2.0
        middle = (hold.min_force + hold.max_force) / 2.0
        other = along > middle if kind == "friction" else along < middle
        return np.asarray(np.where(other, room + 2.0 * np.abs(along - middle), room))
