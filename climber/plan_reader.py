"""Reads what a plan file says of a robot.

Reading settles that the file can be understood at all (names, shapes, finite numbers). Whether what it says is true is
the business of `climber.verify`.
"""

from __future__ import annotations

from typing import get_args

import numpy as np

from climber.plan_json import Node
from climber.plan_parts import (
    MARGIN_KINDS,
    OBJECTIVE_KINDS,
    RATES,
    Achieved,
    Cut,
    CutKind,
    CutStage,
    MarginKind,
    Phase,
    PhaseContact,
    PhaseKind,
    PhaseMargin,
    PhaseTiming,
    RobotPlan,
    TimingMethod,
)


def read_robot(node: Node) -> RobotPlan:
    """What a plan file says of one robot."""
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


def read_least(node: Node) -> dict[MarginKind, float]:
    """What a plan file says every phase was to survive, by kind."""
    least: dict[MarginKind, float] = {}
    for name, entry in node.entries().items():
        kind = next((known for known in MARGIN_KINDS if known == name), None)
        if kind is None:
            raise entry.error(f"margins are of {', '.join(MARGIN_KINDS)}")
        least[kind] = _size(entry)
    return least


def _size(node: Node) -> float:
    """How much a margin is."""
    value = node.number()
    if value < 0.0:
        raise node.error("a number, 0 or greater, is expected")
    return value


def _read_objective(node: Node) -> Achieved:
    fields = node.fields(["kind", "value"])
    return Achieved(fields["kind"].choice(OBJECTIVE_KINDS), fields["value"].number())


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
    for contact in fields["contacts"].items(at_least=1):
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
    value = _size(fields["value"])
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
