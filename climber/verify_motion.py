"""The checks that look at every instant of a robot's motion: samples, and points between them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from climber.plan_parts import Phase, RobotPlan
from climber.robot import Robot
from climber.scenario import RobotSpec
from climber.solids import Solid
from climber.stance import Vector
from climber.verdict import Ledger
from climber.verify_clearance import Outlines
from climber.verify_equilibrium import Support, support_of
from climber.verify_grips import Grip
from climber.verify_model import DrakeModel, Poses, Tree
from climber.verify_polygon import Polygon
from climber.verify_rules import BETWEEN
from climber.verify_scene import DrakeClearance
from climber.verify_space import SpaceClearance
from climber.wall import Wall

# How far sampled derivatives may be from those that finite differences give; see `drift`.
KINKS_IN_VELOCITY = 5.0 / 12.0
KINKS_IN_POSITION = 0.1
SLACK = 1e-5  # [m/s, rad/s] for derivatives that were themselves computed numerically


@dataclass(frozen=True)
class Motion:
    """A phase at K instants, columns in the plant's order.

    Attributes:
        time: Time [s], shape (K,).
        q: Positions, shape (K, nq).
        v: Velocities, shape (K, nv).
        vd: Accelerations, shape (K, nv).
        torque: Torques in the order of `Robot.joint_names` [N m], shape (K, num_joints).
        force: Force on each foot in W, limbs in limb order [N], shape (K, num_limbs, 3).
        moment: Moment on each foot about W's z axis [N m], shape (K, num_limbs).
        sampled: Whether the instant is a sample of the file, shape (K,).
    """

    time: Vector
    q: Vector
    v: Vector
    vd: Vector
    torque: Vector
    force: Vector
    moment: Vector
    sampled: NDArray[np.bool_]

    @classmethod
    def samples(cls, phase: Phase, plan: RobotPlan, robot: Robot) -> Motion:
        """A phase's own samples."""
        count = len(phase.time)
        none = np.zeros((count, 3))
        velocities = _columns(plan.velocities, robot.velocity_names)
        return cls(
            time=phase.time,
            q=phase.q[:, _columns(plan.positions, robot.position_names)],
            v=phase.v[:, velocities],
            vd=phase.vd[:, velocities],
            torque=phase.torque[:, _columns(plan.joints, robot.joint_names)],
            force=np.stack([phase.force.get(limb, none) for limb in robot.limb_names], axis=1),
            moment=np.stack([phase.moment.get(limb, none[:, 0]) for limb in robot.limb_names], axis=1),
            sampled=np.ones(count, dtype=bool),
        )

    def filled(self, between: int) -> Motion:
        """The motion with `between` more instants between every two, everything interpolated linearly."""
        steps = between + 1
        part = np.arange(steps) / steps

        def fill(values: Vector) -> Vector:
            weight = part.reshape(1, -1, *(1,) * (values.ndim - 1))
            mixed = values[:-1, None] * (1.0 - weight) + values[1:, None] * weight
            return np.concatenate([mixed.reshape(-1, *values.shape[1:]), values[-1:]])

        return Motion(
            time=fill(self.time),
            q=fill(self.q),
            v=fill(self.v),
            vd=fill(self.vd),
            torque=fill(self.torque),
            force=fill(self.force),
            moment=fill(self.moment),
            sampled=np.arange((len(self.time) - 1) * steps + 1) % steps == 0,
        )


def _columns(given: tuple[str, ...], wanted: tuple[str, ...]) -> list[int]:
    return [given.index(name) for name in wanted]


class MotionChecks:
    """Goes through a robot's phases and takes down what it finds."""

    def __init__(self, robot: Robot, wall: Wall, spec: RobotSpec, plan: RobotPlan, ledger: Ledger) -> None:
        self._robot, self._wall, self._plan, self._ledger = robot, wall, plan, ledger
        self._tree = Tree(robot)
        self._drake = DrakeModel(robot)
        flat = [(f"obstacle {i}", outline) for i, outline in enumerate(wall.obstacles)]
        avoided = [(f"avoided region {i}", region) for i, region in enumerate(spec.avoid.regions)]
        flat += [(name, region.outline()) for name, region in avoided if region.solid is None]
        solid: list[tuple[str, Solid]] = [(f"facet {i}", facet.solid) for i, facet in enumerate(wall.facets)]
        solid += [(f"solid {i}", solid) for i, solid in enumerate(wall.solids)]
        solid += [(name, region.solid) for name, region in avoided if region.solid is not None]
        self._outlines = Outlines(robot, flat) if robot.planar else None
        self._space = None if robot.planar else SpaceClearance(robot, [*flat, *solid])
        self._drake_clearance = DrakeClearance(robot, flat if robot.planar else [*flat, *solid])
        self._grips = [Grip.of(hold, robot.planar) for hold in wall.holds]
        self._supports: dict[tuple[tuple[int, tuple[float, ...]], ...], Support | Polygon] = {}

    def check(self) -> None:
        """Checks every phase."""
        for number, phase in enumerate(self._plan.phases):
            samples = Motion.samples(phase, self._plan, self._robot)
            self._sampling(number, samples)
            motion = samples.filled(BETWEEN)
            poses = self._tree.poses(motion.q)
            feet, center = self._tree.feet(poses), self._tree.center_of_mass(poses)
            required = self._tree.required_force(poses, motion.v, motion.vd, motion.force, motion.moment)
            rates, _ = self._tree.rates(motion.q, motion.v, motion.vd)
            self._contacts(number, phase, motion, feet)
            self._limits(number, motion)
            self._touching(number, samples, motion, poses)
            self._equilibrium(number, phase, motion, center)
            self._forces(number, phase, motion)
            self._dynamics(number, motion, required)
            self._mechanics(number, motion, feet, center, required, rates)

    def _note(self, name: str, number: int, time: Vector, values: Vector, what: list[str] | None = None) -> None:
        """Takes down values, shape (K,) or (K, len(what)) where `what` names the columns."""
        label = self._plan.phases[number].label
        wide = values.reshape(len(time), -1)

        def where(place: int) -> str:
            row, column = divmod(place, wide.shape[1])
            at = f"{self._plan.name}, phase {number} ({label}), t = {time[row]:.4f} s"
            return at if what is None else f"{at}, {what[column]}"

        self._ledger.note(name, wide.ravel(), where)

    def _sampling(self, number: int, samples: Motion) -> None:
        """The samples are dense, and each series is the derivative of the one before."""
        self._note("sampling", number, samples.time[:-1], np.diff(samples.time))
        velocity, acceleration = drift(samples, self._tree.rates(samples.q, samples.v, samples.vd))
        self._note("velocity", number, samples.time[:-1], velocity, list(self._robot.position_names))
        self._note("acceleration", number, samples.time[:-1], acceleration, list(self._robot.velocity_names))

    def _contacts(self, number: int, phase: Phase, motion: Motion, feet: Vector) -> None:
        """Each holding foot is at its contact point."""
        limbs = [self._robot.limb_names.index(contact.limb) for contact in phase.contacts]
        if limbs:
            points = np.array([contact.point for contact in phase.contacts])
            away = np.linalg.norm(feet[:, limbs] - points, axis=2)
            self._note("contacts", number, motion.time, away, [contact.limb for contact in phase.contacts])

    def _limits(self, number: int, motion: Motion) -> None:
        """Joint positions, velocities and torques are within the model's limits."""
        limbs, names = self._robot.limbs, list(self._robot.joint_names)
        q = motion.q[:, np.concatenate([limb.q for limb in limbs])]
        lower, upper = (np.concatenate([getattr(limb, end) for limb in limbs]) for end in ("lower", "upper"))
        self._note("joint limits", number, motion.time, np.maximum(lower - q, q - upper), names)
        fastest = np.concatenate([limb.velocity for limb in limbs])
        self._note("speed limits", number, motion.time, np.abs(motion.v[:, self._robot.joint_v]) - fastest, names)
        self._note("torque limits", number, motion.time, np.abs(motion.torque) - self._robot.effort, names)

    def _touching(self, number: int, samples: Motion, motion: Motion, poses: Poses) -> None:
        """Nothing touches that should not: by outlines in the plane, by all steps in space, by Drake at the samples."""
        checks = ("self clearance", "obstacle clearance")
        if self._outlines is not None:
            for name, found in zip(checks, self._outlines.measure(poses), strict=True):
                self._note(name, number, motion.time, found.values, found.pairs)
        if self._space is not None:
            for name, least in zip(checks, self._space.least(samples.time, samples.q), strict=True):
                self._note(name, number, np.array([least.time]), np.array([least.value]), [least.pair])
        nearest = [self._drake_clearance.nearest(q) for q in samples.q]
        for which, name in enumerate(checks):
            distance = np.array([pair[which][0] for pair in nearest])
            place = int(np.argmin(distance))
            self._note(name, number, samples.time[[place]], distance[[place]], [nearest[place][which][1]])

    def _support(self, phase: Phase) -> Support | Polygon:
        """Where a phase's contacts support the centre of mass, remembered for each distinct set of them."""
        key = tuple(sorted((contact.hold, tuple(contact.point)) for contact in phase.contacts))
        if key not in self._supports:
            points = np.array([point for _, point in key]).reshape(-1, 3)
            holds, robot = [hold for hold, _ in key], self._robot
            self._supports[key] = support_of(self._wall, holds, points, robot.mass, robot.planar)
        return self._supports[key]

    def _equilibrium(self, number: int, phase: Phase, motion: Motion, center: Vector) -> None:
        """The centre of mass is over the support of the phase's contacts, and at its ends over the neighbours' too."""
        phases = self._plan.phases
        self._over(number, phase, motion.time, center)
        if number > 0:
            self._over(number, phases[number - 1], motion.time[:1], center[:1])
        if number + 1 < len(phases):
            self._over(number, phases[number + 1], motion.time[-1:], center[-1:])

    def _over(self, number: int, holding: Phase, time: Vector, center: Vector) -> None:
        support = self._support(holding)
        limbs = " ".join(contact.limb for contact in holding.contacts) or "nothing"
        self._note("equilibrium", number, time, support.margin(center), [f"support of {limbs}: {support.describe()}"])

    def _forces(self, number: int, phase: Phase, motion: Motion) -> None:
        """Contact forces and moments are what their holds can give; limbs that hold nothing feel none."""
        holds = {contact.limb: contact.hold for contact in phase.contacts}
        for i, limb in enumerate(self._robot.limb_names):
            if limb in holds:
                excess = self._grips[holds[limb]].excess(motion.force[:, i])
                self._note("friction", number, motion.time, excess, [f"{limb} on hold {holds[limb]}"])
                beyond = np.abs(motion.moment[:, i]) - self._grips[holds[limb]].moment
                self._note("moments", number, motion.time, beyond, [f"{limb} on hold {holds[limb]}"])
            else:
                size = np.linalg.norm(motion.force[:, i], axis=1) + np.abs(motion.moment[:, i])
                self._note("free limbs", number, motion.time, size, [limb])

    def _dynamics(self, number: int, motion: Motion, required: Vector) -> None:
        """Torques and contact forces produce the motion."""
        residual = required.copy()
        residual[:, self._robot.joint_v] -= motion.torque
        names = list(self._robot.velocity_names)
        for name, these in (("dynamics at samples", motion.sampled), ("dynamics between", ~motion.sampled)):
            self._note(name, number, motion.time[these], np.abs(residual[these]), names)

    def _mechanics(self, number: int, motion: Motion, *computed: Vector) -> None:
        """What `Tree` computed is what Drake's plant computes, at the samples."""
        at = np.flatnonzero(motion.sampled)
        differences = np.zeros(len(at))
        for row, k in enumerate(at):
            drake = self._drake.at(motion.q[k], motion.v[k], motion.vd[k], motion.force[k], motion.moment[k])
            differences[row] = max(float(np.abs(a[k] - b).max()) for a, b in zip(computed, drake, strict=True))
        self._note("mechanics", number, motion.time[at], differences)


class Sampled(Protocol):
    """Instants of a motion: time [s] (K,), and positions, velocities and accelerations at it, (K, nv) each."""

    @property
    def time(self) -> Vector: ...  # noqa: D102
    @property
    def q(self) -> Vector: ...  # noqa: D102
    @property
    def v(self) -> Vector: ...  # noqa: D102
    @property
    def vd(self) -> Vector: ...  # noqa: D102


def drift(samples: Sampled, rates: tuple[Vector, Vector] | None = None) -> tuple[Vector, Vector]:
    """How far sampled velocities and accelerations are from the derivatives of positions and velocities.

    Over a step h from sample 0 to 1 the trapezium rule leaves v1 - v0 - h/2 (a0 + a1) = -h^3/12 a''. The samples of a
    themselves say how large h^2 a'' is: bend = |a_-1 - a_0 - a_1 + a_2| / 2, at the ends of a phase
    |a_0 - 2 a_1 + a_2|. If a also has a kink between samples (a piecewise linear acceleration), the error is at most
    5/12 h times the greatest bend of the step and of two steps to either side, which is attained where the kink
    cancels the curve; and that is still below the h (or, at the ends, h/2) times the bend by which a single wrong
    sample of a is off. Acceleration that jumps within a phase is not allowed. Where the robot stands still, with no
    acceleration, the motion ends and another may begin, with its own step and bends: each is judged by itself.

    Likewise q1 - q0 - h/2 (q0' + q1') + h^2/12 (q1'' - q0''), the trapezium rule with its end correction, is at most
    0.016 h^2 times the bend of q'' for a kink and of higher order for smooth motion. The angles of a floating base are
    smooth functions of its attitude, so that a kink in its acceleration is one in theirs.

    Args:
        samples: The motion.
        rates: First and second derivatives of the positions, shape (N, nq) each; by default the velocities and
            accelerations, as for every robot without a floating base.

    Returns:
        Errors over the greatest that are allowed, of shapes (N - 1, nq) and (N - 1, nv).
    """
    h = np.diff(samples.time)[:, None]
    q, v, a = samples.q, samples.v, samples.vd
    first, second = (v, a) if rates is None else rates
    still = np.logical_not(v.any(axis=1) | a.any(axis=1))
    of_velocity = np.diff(v, axis=0) - h / 2 * (a[:-1] + a[1:])
    of_position = np.diff(q, axis=0) - h / 2 * (first[:-1] + first[1:]) + h**2 / 12 * np.diff(second, axis=0)
    position = np.abs(of_position) / (KINKS_IN_POSITION * h**2 * _bends(second, still) + SLACK * h)
    velocity = np.abs(of_velocity) / (KINKS_IN_VELOCITY * h * _bends(a, still) + SLACK)
    return position, velocity


def _bends(a: Vector, still: NDArray[np.bool_]) -> Vector:
    """How much accelerations (N, n) bend over each step, from one standstill, (N,), to the next; (N - 1, n)."""
    result = np.zeros((len(a) - 1, a.shape[1]))
    ends = np.unique([0, *np.flatnonzero(still), len(a) - 1])
    for begin, end in itertools.pairwise(ends):
        result[begin:end] = _bend(a[begin : end + 1])
    return result


def _bend(a: Vector) -> Vector:
    """How much accelerations (N, n) bend over each step, its two neighbours on either side counted in, (N - 1, n)."""
    bend = np.zeros((len(a) - 1, a.shape[1]))
    if len(a) > 3:
        inner = np.abs(a[:-3] - a[1:-2] - a[2:-1] + a[3:]) / 2
        # A kink can cancel the curve around it in its own step and in both neighbours, but not in those beyond.
        padded = np.pad(inner, ((2, 2), (0, 0)), mode="edge")
        bend[1:-1] = sliding_window_view(padded, 5, axis=0).max(axis=-1)
    if len(a) > 2:
        bend[0] = np.maximum(bend[min(1, len(bend) - 1)], np.abs(a[0] - 2 * a[1] + a[2]))
        bend[-1] = np.maximum(bend[max(-2, -len(bend))], np.abs(a[-1] - 2 * a[-2] + a[-3]))
    return bend
