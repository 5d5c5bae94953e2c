"""The plan file: everything a climb is, in one JSON file that a program without `climber` can check.

`docs/plan-format.md` describes the format field by field; this module holds its types, writes it and reads it back.
Reading settles that the file can be understood at all (names, shapes, finite numbers). Whether what it says is true is
the business of `climber.verify`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from climber.exceptions import PlanFileError
from climber.files import write_text
from climber.plan_json import Node, parse, render
from climber.stance import Vector

FORMAT = "climber-plan"
VERSION = 2

PhaseKind = Literal["shift", "swing"]
TimingMethod = Literal["conic", "paced"]
ObjectiveKind = Literal["length", "time", "margin"]
CutKind = Literal["proved", "budget"]
CutStage = Literal["transition", "motion", "torque"]
RATES = ("speed", "acceleration", "jerk")
MarginKind = Literal["friction", "push", "mass", "center", "place", "normal"]
MARGIN_KINDS: tuple[MarginKind, ...] = get_args(MarginKind)
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
        """This timing and then another one, which begins so many seconds after it."""
        method: TimingMethod = "conic" if self.method == other.method == "conic" else "paced"
        limits = self.limits if self.limits == other.limits else {}
        return PhaseTiming(method, limits, self.active + other.later(after).active)


@dataclass(frozen=True)
class PhaseMargin:
    """The greatest error of one kind that a phase's motion survives, with other forces and torques inside all limits.

    Attributes:
        value: friction and mass: share by which it is less, or mass off either way; push: force on the pelvis at the
            robot's centre of mass [N]; center: displacement of the centre of mass, fixed to the pelvis [m]; place:
            displacement of one hold [m]; normal: angle by which the normal of one hold is turned [rad].
        time: The plan's time of the sample where it is least [s].
        direction: Unit vector in W of the push or displacement that is worst there, gravity's or against it for mass
            too great or small, the axis for a normal, shape (3,); None for friction.
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


@dataclass(frozen=True)
class Plan:
    """A climb, self-contained: what was asked, what was found, and how.

    Attributes:
        scenario_path: Where the scenario was read from; relative models start in its folder.
        scenario_text: The scenario file, verbatim.
        seed: The seed that the plan came from.
        robots: One plan for each of the scenario's robots, in its order.
        software: Version of each program that had a part in it.
        timings: Seconds spent in each stage.
    """

    scenario_path: str
    scenario_text: str
    seed: int
    robots: tuple[RobotPlan, ...]
    software: dict[str, str] = field(default_factory=dict)
    timings: dict[str, float] = field(default_factory=dict)

    def to_json(self) -> str:
        """The plan as the text of a plan file."""
        return render(
            {
                "format": FORMAT,
                "version": VERSION,
                "scenario": {"path": self.scenario_path, "text": self.scenario_text},
                "software": self.software,
                "seed": self.seed,
                "timings": self.timings,
                "robots": [_robot_to_dict(robot) for robot in self.robots],
            }
        )

    @classmethod
    def from_json(cls, text: str, source: str = "plan") -> Plan:
        """Reads a plan from the text of a plan file.

        Args:
            text: The JSON text.
            source: What to call it in messages.

        Raises:
            PlanFileError: If the text is not a plan file of this version; the message says where and what is wrong.
        """
        root = parse(text, source)
        marks = root.some(["format", "version"])
        if marks["format"].value != FORMAT:
            raise marks["format"].error(f"{FORMAT!r} is expected; this is not a plan file")
        if marks["version"].value != VERSION or isinstance(marks["version"].value, bool):
            raise marks["version"].error(f"this program reads version {VERSION}")
        fields = root.fields(["format", "version", "scenario", "software", "seed", "timings", "robots"])
        scenario = fields["scenario"].fields(["path", "text"])
        robots = fields["robots"].items(at_least=1)
        return cls(
            scenario_path=scenario["path"].text(),
            scenario_text=scenario["text"].text(),
            seed=fields["seed"].integer(),
            robots=tuple(_read_robot(robot) for robot in robots),
            software={name: node.text() for name, node in fields["software"].entries().items()},
            timings={name: node.number() for name, node in fields["timings"].entries().items()},
        )

    def save(self, path: str | Path) -> None:
        """Writes the plan file, whole or not at all.

        Raises:
            PlanFileError: If the plan cannot be written down, for one because a number in it is not finite.
        """
        write_text(path, self.to_json())

    @classmethod
    def load(cls, path: str | Path) -> Plan:
        """Reads a plan file.

        Raises:
            PlanFileError: If there is no such file or it is not a plan file of this version.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise PlanFileError(f"{path}: cannot be read: {error}") from error
        return cls.from_json(text, str(path))


def _robot_to_dict(robot: RobotPlan) -> dict[str, Any]:
    return {
        "name": robot.name,
        "model": robot.model,
        "limbs": list(robot.limbs),
        "positions": list(robot.positions),
        "velocities": list(robot.velocities),
        "joints": list(robot.joints),
        "counts": robot.counts,
        "moves": robot.moves,
        "cost": robot.cost,
        "proofs": robot.proofs,
        "objective": None if robot.objective is None else vars(robot.objective),
        "record": [list(entry) for entry in robot.record],
        "cuts": [vars(cut) for cut in robot.cuts],
        "stances": list(robot.stances),
        "phases": [_phase_to_dict(phase) for phase in robot.phases],
    }


def _phase_to_dict(phase: Phase) -> dict[str, Any]:
    return {
        "kind": phase.kind,
        "limb": phase.limb,
        "stance": phase.stance,
        "contacts": [{"limb": c.limb, "hold": c.hold, "point": c.point} for c in phase.contacts],
        "time": phase.time,
        "q": phase.q,
        "v": phase.v,
        "vd": phase.vd,
        "torque": phase.torque,
        "force": phase.force,
        "moment": phase.moment,
        "timing": {**vars(phase.timing), "active": [list(interval) for interval in phase.timing.active]},
        "margins": {kind: vars(margin) for kind, margin in phase.margins.items()},
    }


def _read_robot(node: Node) -> RobotPlan:
    names = ["limbs", "positions", "velocities", "joints"]
    found = ["counts", "moves", "cost", "proofs", "objective", "record", "cuts", "stances", "phases"]
    fields = node.fields(["name", "model", *names, *found])
    limbs, positions, velocities, joints = (fields[name].names() for name in names)
    stances = fields["stances"].items(at_least=1)
    robot = RobotPlan(
        name=fields["name"].text(),
        model=fields["model"].text(),
        limbs=limbs,
        positions=positions,
        velocities=velocities,
        joints=joints,
        moves=fields["moves"].integer(at_least=0),
        cost=fields["cost"].number(),
        stances=tuple(_read_stance(stance, limbs) for stance in stances),
        phases=(),
        cuts=tuple(_read_cut(cut, limbs) for cut in fields["cuts"].items()),
        counts={name: count.integer(at_least=0) for name, count in fields["counts"].entries().items()},
        proofs={name: fact.scalar() for name, fact in fields["proofs"].entries().items()},
        objective=None if fields["objective"].value is None else _read_objective(fields["objective"]),
        record=tuple(_read_entry(entry) for entry in fields["record"].items()),
    )
    phases = tuple(_read_phase(phase, robot) for phase in fields["phases"].items(at_least=1))
    return RobotPlan(**{**vars(robot), "phases": phases})


def _read_objective(node: Node) -> Achieved:
    fields = node.fields(["kind", "value"])
    return Achieved(fields["kind"].choice(get_args(ObjectiveKind)), fields["value"].number())


def _read_entry(node: Node) -> tuple[float, float]:
    seconds, value = node.array(2).tolist()
    return seconds, value


def _read_stance(node: Node, limbs: tuple[str, ...]) -> dict[str, int]:
    return {limb: hold.integer(at_least=0) for limb, hold in node.fields(list(limbs)).items()}


def _read_cut(node: Node, limbs: tuple[str, ...]) -> Cut:
    fields = node.fields(["stance", "limb", "hold", "reason", "kind", "stage"])
    return Cut(
        stance=_read_stance(fields["stance"], limbs),
        limb=fields["limb"].choice(limbs),
        hold=fields["hold"].integer(at_least=0),
        reason=fields["reason"].text(),
        kind=fields["kind"].choice(get_args(CutKind)),
        stage=fields["stage"].choice(get_args(CutStage)),
    )


def _read_phase(node: Node, robot: RobotPlan) -> Phase:
    columns = {"q": robot.positions, "v": robot.velocities, "vd": robot.velocities, "torque": robot.joints}
    fields = node.fields(
        ["kind", "limb", "stance", "contacts", "time", *columns, "force", "moment", "timing", "margins"]
    )
    stance = fields["stance"].integer(at_least=0)
    if stance >= len(robot.stances):
        raise fields["stance"].error(f"there are {len(robot.stances)} stances, numbered from 0")
    contacts = []
    for contact in fields["contacts"].items():
        parts = contact.fields(["limb", "hold", "point"])
        limb = parts["limb"].choice(robot.limbs)
        contacts.append(PhaseContact(limb, parts["hold"].integer(at_least=0), parts["point"].array(3)))
    if len({contact.limb for contact in contacts}) < len(contacts):
        raise fields["contacts"].error("a limb is named twice")
    time = fields["time"].array(None)
    if len(time) < 2 or not bool(np.all(np.diff(time) > 0.0)):
        raise fields["time"].error("two instants or more are expected, each later than the one before")
    samples = {name: fields[name].array(len(time), len(names)) for name, names in columns.items()}
    forces = fields["force"].entries()
    for limb in set(forces) - set(robot.limbs):
        raise forces[limb].error(f"the limbs are {', '.join(robot.limbs)}")
    moments = fields["moment"].entries()
    for limb in set(moments) - {contact.limb for contact in contacts}:
        raise moments[limb].error("a moment is expected of limbs in contact only")
    for limb in {contact.limb for contact in contacts} - set(forces):
        raise fields["force"].error(f"{limb} is in contact, so its force is expected")
    return Phase(
        kind=fields["kind"].choice(get_args(PhaseKind)),
        limb=None if fields["limb"].value is None else fields["limb"].choice(robot.limbs),
        stance=stance,
        contacts=tuple(contacts),
        time=time,
        **samples,
        force={limb: forces[limb].array(len(time), 3) for limb in robot.limbs if limb in forces},
        moment={limb: moments[limb].array(len(time)) for limb in robot.limbs if limb in moments},
        timing=_read_timing(fields["timing"], robot),
        margins={
            kind: _read_margin(margin, robot.limbs)
            for kind, margin in zip(MARGIN_KINDS, fields["margins"].fields(MARGIN_KINDS).values(), strict=True)
        },
    )


def _read_margin(node: Node, limbs: tuple[str, ...]) -> PhaseMargin:
    fields = node.fields(["value", "time", "direction", "limb"])
    value = fields["value"].number()
    if value < 0.0:
        raise fields["value"].error("a number, 0 or greater, is expected")
    x, y, z = (0.0, 0.0, 0.0) if fields["direction"].value is None else fields["direction"].array(3).tolist()
    return PhaseMargin(
        value=value,
        time=fields["time"].number(),
        direction=None if fields["direction"].value is None else (x, y, z),
        limb=None if fields["limb"].value is None else fields["limb"].choice(limbs),
    )


def _read_timing(node: Node, robot: RobotPlan) -> PhaseTiming:
    fields = node.fields(["method", "limits", "active"])
    limits = {}
    for kind, of_kind in fields["limits"].entries().items():
        if kind not in RATES:
            raise of_kind.error(f"limits are of {', '.join(RATES)}")
        limits[kind] = {name: value.number() for name, value in of_kind.entries().items()}
        for name in set(limits[kind]) - set(robot.velocities):
            raise of_kind.error(f"the velocities are {', '.join(robot.velocities)} (given: {name})")
    active = []
    for interval in fields["active"].items():
        begin, end, limit = interval.items(exactly=3)
        active.append((begin.number(), end.number(), limit.text()))
    return PhaseTiming(fields["method"].choice(get_args(TimingMethod)), limits, tuple(active))
