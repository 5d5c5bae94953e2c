"""Margins that every phase of a climb must have, looked at while it is planned.

Friction is asked for by planning on a wall with less of it; then the plan's own forces prove the margin. The others are
looked at where the robot stands still, so that postures without them are passed over, and again when a phase is timed:
a phase that lacks some of a margin only because it moves is made slower.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from climber.least_margins import with_unit
from climber.margins import phase_margins
from climber.phase_instants import Moving
from climber.plan_parts import CAPS, MarginKind
from climber.robot import Robot
from climber.scenario_fields import SURE, MinMargin
from climber.stance import Contact, Vector
from climber.timing import Samples
from climber.wall import Wall

if TYPE_CHECKING:
    from climber.manifold import Body

SEEN = 0.9  # share of the greatest margin looked for that is sure to be found where there is more


@dataclass(frozen=True)
class Standing:
    """A posture held for an instant, as a phase of a single sample."""

    contacts: tuple[Contact, ...]
    samples: Samples


@dataclass(frozen=True)
class Demands:
    """What phases must survive.

    Attributes:
        wall: The wall, with the friction that it has.
        least: The margins asked for by kind, without those that are zero.
    """

    wall: Wall
    least: Mapping[MarginKind, float]

    @classmethod
    def of(cls, wall: Wall, asked: MinMargin) -> Demands:
        """The demands of a scenario's `min_margin`."""
        return cls(wall, {kind: getattr(asked, kind) for kind in CAPS if getattr(asked, kind) > 0.0})

    @property
    def looked_at(self) -> bool:
        """Whether phases are to be looked at one by one."""
        return any(kind != "friction" for kind in self.least)

    @property
    def balance(self) -> float:
        """How far from the border of its support the centre of mass stays at least if it may be displaced [m]."""
        return self.least.get("center", 0.0)

    def told(self) -> str:
        """The demands in words."""
        return ", ".join(f"{kind} {with_unit(kind, value)}" for kind, value in self.least.items())

    def lacking(self, robot: Robot, phases: Sequence[Moving]) -> list[str]:
        """For each phase which of the margins is short and by how much, in words; "" if none is."""
        kinds: list[MarginKind] = [kind for kind in self.least if kind != "friction"]
        if not kinds or not phases:
            return ["" for _ in phases]
        caps: dict[MarginKind, float] = {kind: min(CAPS[kind], self.least[kind] / SURE / SEEN) for kind in kinds}
        result = []
        for margins in phase_margins(robot, self.wall, phases, kinds, caps):
            short = [kind for kind in kinds if margins[kind].value < min(self.least[kind] / SURE, 0.99 * CAPS[kind])]
            result.append(
                "; ".join(
                    f"the margin of {kind} is {with_unit(kind, margins[kind].value, 3)}, "
                    f"{with_unit(kind, self.least[kind])} asked for"
                    for kind in short
                )
            )
        return result

    def at_rest(self, robot: Robot, phase: Moving) -> str:
        """What a phase lacks though it be as slow as can be, "" if nothing."""
        samples = phase.samples
        rest = Samples(samples.time, samples.q, np.zeros_like(samples.v), np.zeros_like(samples.vd))
        return self.lacking(robot, [Standing(phase.contacts, rest)])[0]

    def standing(self, robot: Robot, q: Vector, contacts: Sequence[Contact]) -> NDArray[np.bool_]:
        """Which postures q, shape (K, nq), have the margins while they are held still; shape (K,)."""
        none = np.zeros((1, robot.plant.num_velocities()))
        postures = [Standing(tuple(contacts), Samples(np.zeros(1), own[None], none, none)) for own in q]
        return np.array([not words for words in self.lacking(robot, postures)], dtype=bool)


def can_stand(body: Body, q: Vector, contacts: Sequence[Contact]) -> NDArray[np.bool_]:
    """Which postures q, shape (K, nq), can be held still by contacts and motors, with the margins asked for; (K,)."""
    good, demands = body.held(q, contacts), body.demands
    if demands is not None and demands.least and good.any():
        good[good] = demands.standing(body.robot, q[good], contacts)
    return good
