"""What a plan is made of: what a robot does, its phases with all that is sampled in them, and the moves given up.

`docs/plan-format.md` describes the same field by field; `climber.plan_file` writes it down.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from climber.scenario_fields import KEPT
from climber.stance import Vector

PhaseKind = Literal["shift", "swing"]
TimingMethod = Literal["conic", "paced"]
ObjectiveKind = Literal["length", "time", "margin"]
CutKind = Literal["proved", "budget"]
CutStage = Literal["transition", "motion", "torque"]
RATES = ("speed", "acceleration", "jerk")
MarginKind = Literal["friction", "push", "mass", "center", "place", "normal"]
MARGIN_KINDS: tuple[MarginKind, ...] = get_args(MarginKind)
OBJECTIVE_KINDS: tuple[ObjectiveKind, ...] = get_args(ObjectiveKind)
# Greater margins are not told apart: friction and mass as shares, push [N], center and place [m], normal [rad].
CAPS: dict[MarginKind, float] = {
    "friction": KEPT,
    "push": 1000.0 * KEPT,
    "mass": 0.7 * KEPT,
    "center": 0.02 * KEPT,
    "place": 0.02 * KEPT,
    "normal": 0.2 * KEPT,
}
Fact = bool | int | float | str


@dataclass(frozen=True)
class PhaseContact:
    """A foot that stays where it is throughout a phase.

    Attributes:
        limb: The limb's name.
        hold: Number of the hold it is on.
        point: Where the foot is in W [m], shape (3,).
    """

    limb: str
    hold: int
    point: Vector


@dataclass(frozen=True)
class PhaseTiming:
    """How a phase came by its duration.

    Attributes:
        method: "conic" if it is the fastest within its limits, "paced" if it runs by a law of fixed shape.
        limits: By kind ("speed", "acceleration", "jerk") and name of the velocity, the limits it was timed with [m/s,
            rad/s and their derivatives]. A velocity that is left out had none.
        active: Intervals of time [s] and the limit that keeps the motion from being faster there, in order of time.
    """

    method: TimingMethod = "paced"
    limits: dict[str, dict[str, float]] = field(default_factory=dict)
    active: tuple[tuple[float, float, str], ...] = ()

    def later(self, seconds: float) -> PhaseTiming:
        """The same timing, so many seconds later."""
        return replace(self, active=tuple((a + seconds, b + seconds, name) for a, b, name in self.active))

    def followed(self, after: float, other: PhaseTiming) -> PhaseTiming:
        """This timing and then another one, which begins so many seconds after it.

        Of limits that differ, since one of the two was slowed, the greater are told, and are active where they were; of
        two methods, one of which has no limits, there are none to be told.
        """
        if "paced" in (self.method, other.method):
            return PhaseTiming()
        limits = {
            kind: {name: max(limit, other.limits[kind][name]) for name, limit in own.items()}
            for kind, own in self.limits.items()
        }

        def active(timing: PhaseTiming) -> tuple[tuple[float, float, str], ...]:
            slowed = {
                f"{kind} {name}"
                for kind, own in limits.items()
                for name, limit in own.items()
                if timing.limits[kind][name] < limit
            }
            return tuple(interval for interval in timing.active if interval[2] not in slowed)

        return PhaseTiming("conic", limits, active(self) + active(other.later(after)))


@dataclass(frozen=True)
class PhaseMargin:
    """The greatest error of one kind that a phase's motion survives, with other forces and torques inside all limits.

    Attributes:
        value: friction and mass: share by which it is less, or mass off either way; push: force on the pelvis at the
            robot's centre of mass [N]; center: displacement of the centre of mass, fixed to the pelvis [m]; place:
            displacement of one hold [m]; normal: angle by which normals of holds are turned, each its own way [rad].
        time: The plan's time of the sample where it is least [s].
        direction: Unit vector in W of the push or displacement that is worst there, gravity's or against it for mass
            too great or small, shape (3,); None for friction and normal.
        limb: The limb on the hold that is worst there; None for errors that are not of one hold.
    """

    value: float
    time: float
    direction: tuple[float, float, float] | None = None
    limb: str | None = None


@dataclass(frozen=True)
class Phase:
    """A stretch of motion during which the contacts do not change, sampled at N instants.

    Attributes:
        kind: "shift" with every limb in contact, "swing" with one limb free.
        limb: Name of the swinging limb; None in a shift.
        stance: Which of the robot's stances the phase starts in.
        contacts: The contacts that hold from the first sample to the last.
        time: Time since the climb began [s], shape (N,), increasing.
        q: Positions [m, rad], columns as `RobotPlan.positions`, shape (N, nq). Angles do not wrap.
        v: Velocities [m/s, rad/s], columns as `RobotPlan.velocities`, shape (N, nv).
        vd: Accelerations [m/s^2, rad/s^2], columns as `RobotPlan.velocities`, shape (N, nv).
        torque: Joint torques [N m], columns as `RobotPlan.joints`, shape (N, nu).
        force: By limb name, the force that the hold exerts on the foot, in W [N], shape (N, 3). A limb that is left
            out exerts none.
        moment: By limb name, the moment about the wall plane's normal that a pin exerts on the gripper on it [N m],
            shape (N,). A limb that is left out feels none.
        timing: How the phase came by its duration.
        margins: What the motion survives, by kind.
    """

    kind: PhaseKind
    limb: str | None
    stance: int
    contacts: tuple[PhaseContact, ...]
    time: Vector
    q: Vector
    v: Vector
    vd: Vector
    torque: Vector
    force: dict[str, Vector]
    moment: dict[str, Vector] = field(default_factory=dict)
    timing: PhaseTiming = field(default_factory=PhaseTiming)
    margins: dict[MarginKind, PhaseMargin] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """`shift`, or `swing` and the name of the swinging limb."""
        return self.kind if self.limb is None else f"{self.kind} {self.limb}"


@dataclass(frozen=True)
class Cut:
    """A move that the task planner was told not to use again.

    Attributes:
        stance: The stance it starts in, hold by limb name.
        limb: The limb that was to move.
        hold: The hold it was to move to.
        reason: Why it was cut, in words.
        kind: "proved" if the move is impossible, "budget" if none was found within the budget.
        stage: The stage that gave up on it.
    """

    stance: dict[str, int]
    limb: str
    hold: int
    reason: str
    kind: CutKind
    stage: CutStage


@dataclass(frozen=True)
class Achieved:
    """What was to be little along a climb, and how little it is.

    Attributes:
        kind: length [rad, m], time [s] or margin.
        value: Its value; see `docs/plan-format.md`.
    """

    kind: ObjectiveKind
    value: float


@dataclass(frozen=True)
class RobotPlan:
    """What one robot does.

    Attributes:
        name: The robot's name in the scenario.
        model: Its model as the scenario names it.
        limbs: Limb names in limb order.
        positions: Names of the columns of `q`.
        velocities: Names of the columns of `v` and `vd`.
        joints: Names of the columns of `torque`.
        moves: How many times a limb changes holds.
        cost: Cost of the moves (Gönen eq. 4.22, rounded as the task planner does).
        stances: The stances in order, hold by limb name; one more than there are moves.
        phases: The motion.
        cuts: The moves given up on the way to this plan.
        counts: Size of the stance graph after each of its stages.
        proofs: What was proved about the plan, and relative to what.
        objective: What the motion was chosen for, and the value that it has; None if for nothing in particular.
        record: Seconds of planning and the best value by then, each less than the one before; the last is the plan's.
    """

    name: str
    model: str
    limbs: tuple[str, ...]
    positions: tuple[str, ...]
    velocities: tuple[str, ...]
    joints: tuple[str, ...]
    moves: int
    cost: float
    stances: tuple[dict[str, int], ...]
    phases: tuple[Phase, ...]
    cuts: tuple[Cut, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)
    proofs: dict[str, Fact] = field(default_factory=dict)
    objective: Achieved | None = None
    record: tuple[tuple[float, float], ...] = ()

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.phases[-1].time[-1] - self.phases[0].time[0])
