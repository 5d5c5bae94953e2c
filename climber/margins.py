"""What the phases of a motion survive: less friction, pushes, wrong masses, holds out of place and turned.

The motion stays what it is planned to be; contact forces and torques may be others, within all limits. What every
sample of a phase survives in this sense of one kind alone is proved at all samples by forces that balance and keep to
the limits. It is the greatest up to `programs.margins.GAP`, in space 10 %, but for `place`, see
`programs.place_margin`. The margin is `KEPT` of it: a controller has to find such forces without being told, and feet
that use all of their friction creep. Greater margins than `CAPS` are not told apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from climber.phase_instants import Moving, PhaseInstants
from climber.plan_parts import CAPS, MARGIN_KINDS, MarginKind, PhaseMargin
from climber.programs.grip_margins import ErrorMargin, FrictionError, NormalError
from climber.programs.grips import wall_grips
from climber.programs.margins import GAP, DisturbanceMargin, Worst
from climber.programs.place_margin import PlaceMargin
from climber.programs.rays import rays
from climber.robot import Robot
from climber.scenario_fields import KEPT
from climber.stance import Vector
from climber.wall import Wall

SAFE = 1.0 - 1e-6  # for the rounding of who checks them


def phase_margins(
    robot: Robot,
    wall: Wall,
    phases: Sequence[Moving],
    kinds: Sequence[MarginKind] = MARGIN_KINDS,
    caps: Mapping[MarginKind, float] = CAPS,
) -> list[dict[MarginKind, PhaseMargin]]:
    """The margins of each phase.

    Args:
        robot: The robot.
        wall: The wall, whose friction is what it is.
        phases: The phases.
        kinds: Which margins to compute.
        caps: Greater ones are not looked for; the less, the sooner done.
    """
    result: list[dict[MarginKind, PhaseMargin]] = [{} for _ in phases]
    grips = wall_grips(wall, robot.dimension)
    counts = [len(phase.contacts) for phase in phases]
    for count in sorted(set(counts)):
        places = [p for p, k in enumerate(counts) if k == count]
        several = _Several(PhaseInstants(robot, grips, [phases[p] for p in places]))
        for kind in kinds:
            for p, margin in zip(places, several.margins(kind, caps[kind] / KEPT), strict=True):
                result[p][kind] = margin
    return result


class _Several:
    """Phases with as many contacts each."""

    def __init__(self, phases: PhaseInstants) -> None:
        self._phases = phases
        self._limbs = phases.robot.limb_names

    def margins(self, kind: MarginKind, cap: float) -> list[PhaseMargin]:
        """The margins of one kind; errors beyond `cap` are not looked at."""
        phases, dimension = self._phases, self._phases.robot.dimension
        if kind == "friction":
            return self._narrower(FrictionError(phases.grips, phases.num_contacts, dimension, cap))
        if kind == "normal":
            return self._narrower(NormalError(phases.grips, phases.num_contacts, dimension, cap))
        if kind == "place":
            worst, toward = PlaceMargin(phases.instants, phases.lever, dimension, cap).solve()
            return self._told(cap, worst, list(toward), [int(w) for w in worst.which])
        disturbance = {"push": phases.push, "mass": phases.mass, "center": phases.center}[kind]
        around = rays(disturbance.B.shape[2])
        worst, toward = DisturbanceMargin(phases.instants, disturbance.B, disturbance.C, cap, around).solve()
        if kind == "mass":  # heavier pulls down, lighter up
            toward = np.where(toward == 0.0, 1.0, toward)  # where neither is survived
            toward = toward * phases.robot.gravity / max(float(np.linalg.norm(phases.robot.gravity)), 1e-300)
        return self._told(cap, worst, list(toward), [None] * len(toward))

    def _narrower(self, error: FrictionError) -> list[PhaseMargin]:
        """The margins to an error that makes all cones narrower."""
        worst = ErrorMargin(self._phases.instants, error).solve()
        return self._told(error.cap, worst, [None] * len(worst.value), [None] * len(worst.value))

    def _told(
        self, cap: float, worst: Worst, directions: Sequence[Vector | None], contacts: Sequence[int | None]
    ) -> list[PhaseMargin]:
        margins = []
        for p, (direction, contact) in enumerate(zip(directions, contacts, strict=True)):
            if worst.value[p] >= (1.0 - 2.0 * GAP) * cap:  # nothing is worst
                direction = contact = None
            elif direction is not None and not np.any(direction):  # not survived at all, whatever the direction
                direction = np.eye(3)[0]
            x, y, z = (0.0, 0.0, 0.0) if direction is None else np.pad(direction, (0, 3 - len(direction))).tolist()
            margins.append(
                PhaseMargin(
                    value=float(worst.value[p]) * KEPT * SAFE,
                    time=float(self._phases.time[worst.instant[p]]),
                    direction=None if direction is None else (x, y, z),
                    limb=None if contact is None else self._limbs[self._phases.limbs[p, contact]],
                )
            )
        return margins
