"""What a controller works with that is fixed during a phase of its plan: who holds what, and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climber.dynamics import Sampler
from climber.force_control import ForceControl
from climber.reference import Reference
from climber.robot import Indices
from climber.stance import Vector
from climber.wall import Wall

Touches = dict[int, tuple[int, Vector]]


@dataclass(frozen=True)
class PhaseStance:
    """The stance of a phase.

    Attributes:
        touches: By limb that holds: its hold, and where the plan has the foot in W [m].
        arriving: The limb that takes hold when the phase ends, and its hold.
        free: Places in the velocities of the pelvis and of the joints of limbs that do not hold.
        alone: Velocities at which one of these is one and the others are zero, shape (nv, free).
        places: Places of the m components of contact forces among those of all feet, (x, y, z) each, shape (m,).
        few: The identity, shape (m, m).
        sampler: Has the Jacobian of the feet that hold.
        J: Room for it, shape (m, nv).
        Jdot_v: Room for the feet's accelerations, shape (m,).
        control: Chooses contact forces.
        gripping: The limbs whose pin takes a moment.
        most: That moment [N m], shape (gripping,).
    """

    touches: Touches
    arriving: tuple[int, int] | None
    free: Indices
    alone: Vector
    places: Indices
    few: Vector
    sampler: Sampler
    J: Vector
    Jdot_v: Vector
    control: ForceControl
    gripping: list[int]
    most: Vector

    @classmethod
    def of(cls, reference: Reference, number: int, wall: Wall) -> PhaseStance:
        """The stance of phase `number` on a wall as the plan knows it."""
        robot, axes, touches = reference.robot, reference.robot.dimension, _touches(reference, number)
        after = _touches(reference, number + 1) if number + 1 < reference.num_phases else {}
        arriving = [(limb, hold) for limb, (hold, _) in after.items() if limb not in touches]
        free = np.concatenate([robot.base_v, *(limb.v for i, limb in enumerate(robot.limbs) if i not in touches)])
        moments = {limb: wall.holds[hold].max_moment for limb, (hold, _) in touches.items()}
        gripping = [limb for limb, moment in moments.items() if moment > 0.0]
        m, nv = axes * len(touches), len(robot.velocity_names)
        return cls(
            touches=touches,
            arriving=arriving[0] if arriving else None,
            free=free,
            alone=np.eye(nv)[:, free],
            places=np.array([3 * limb + axis for limb in touches for axis in range(axes)]),
            few=np.eye(m),
            sampler=Sampler(robot, list(touches)),
            J=np.empty((m, nv)),
            Jdot_v=np.empty(m),
            control=ForceControl(wall, [hold for hold, _ in touches.values()], axes, len(gripping)),
            gripping=gripping,
            most=np.array([moments[limb] for limb in gripping]),
        )


def _touches(reference: Reference, number: int) -> Touches:
    place = {contact.limb: contact for contact in reference.phase(number).contacts}
    limbs = [(i, place[name]) for i, name in enumerate(reference.robot.limb_names) if name in place]
    return {i: (contact.hold, contact.point) for i, contact in limbs}
