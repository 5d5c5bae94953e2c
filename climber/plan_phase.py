"""A phase of a motion as it goes into a plan: the names of limbs and holds instead of their numbers."""

from __future__ import annotations

from climber.phase_motion import PhaseMotion
from climber.plan_parts import MarginKind, Phase, PhaseContact, PhaseMargin
from climber.robot import Robot
from climber.wall import Wall


def phase_of(robot: Robot, wall: Wall, motion: PhaseMotion, margins: dict[MarginKind, PhaseMargin]) -> Phase:
    """The phase of a plan that a motion on a wall is.

    Args:
        robot: The robot.
        wall: The wall.
        motion: The motion, on the clock of the plan.
        margins: What it survives.
    """
    limbs = robot.limb_names
    return Phase(
        kind="shift" if motion.limb is None else "swing",
        limb=None if motion.limb is None else limbs[motion.limb],
        stance=motion.move,
        contacts=tuple(PhaseContact(limbs[c.limb], c.hold, wall.point(c)) for c in motion.contacts),
        time=motion.samples.time,
        q=motion.samples.q,
        v=motion.samples.v,
        vd=motion.samples.vd,
        torque=motion.torque,
        force={limbs[c.limb]: motion.force[:, i] for i, c in enumerate(motion.contacts)},
        moment={limbs[c.limb]: motion.moment[:, i] for i, c in enumerate(motion.contacts) if motion.moment.any()},
        timing=motion.timing.later(float(motion.samples.time[0])),
        margins=margins,
    )
