"""A plan as a controller follows it: desired state and contact forces at any time of the plan's own clock."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from climber.exceptions import PlanFileError
from climber.plan_parts import MarginKind, Phase, RobotPlan
from climber.robot import Robot
from climber.scenario_fields import KEPT
from climber.stance import Vector

BLEND = 0.15  # forces go over to those of the next phase in this time [s], or in a third of the phase if that is less
# Errors that are not felt, so that forces are to do whatever they are: friction that is less, normals that are turned.
SPARED: tuple[MarginKind, ...] = ("friction", "normal")
SPARE = 0.7  # share of a phase's margins of these that forces keep to, more if the whole climb's are more
LIGHTLY = 0.1  # share of its force that a foot has when it lets go, and when it has just taken hold


@dataclass(frozen=True)
class Desired:
    """What a robot is to do at an instant.

    Attributes:
        q: Positions [m, rad], shape (nq,).
        v: Velocities [m/s, rad/s], shape (nv,).
        vd: Accelerations [m/s^2, rad/s^2], shape (nv,).
        force: Forces of the holds on the feet in W [N], shape (num_limbs, 3); zero for a limb that holds nothing.
        moment: Moments of the holds on the feet about z [N m], shape (num_limbs,).
        drop: Share of friction that is to be left unused.
        turn: Angle by which forces are to stay inside friction cones [rad].
    """

    q: Vector
    v: Vector
    vd: Vector
    force: Vector
    moment: Vector
    drop: float
    turn: float


class _Track:
    """One phase, columns in the robot's order."""

    def __init__(self, phase: Phase, plan: RobotPlan, robot: Robot, least: Mapping[MarginKind, float]) -> None:
        self.phase = phase
        q = phase.q[:, [plan.positions.index(name) for name in robot.position_names]]
        moving = [plan.velocities.index(name) for name in robot.velocity_names]
        v, vd = phase.v[:, moving], phase.vd[:, moving]
        K, limbs = len(phase.time), robot.limb_names
        force, moment = np.zeros((K, len(limbs), 3)), np.zeros((K, len(limbs)))
        for contact in phase.contacts:
            limb = limbs.index(contact.limb)
            force[:, limb] = phase.force[contact.limb]
            moment[:, limb] = phase.moment.get(contact.limb, 0.0)
        spared = [max(SPARE * _margin(phase, kind), least[kind]) for kind in SPARED]
        self.rows = np.hstack([q, v, vd, force.reshape(K, -1), moment, np.tile(spared, (K, 1))])
        self.time: list[float] = phase.time.tolist()
        self.begin: float = self.time[0]
        self.end: float = self.time[-1]

    def at(self, time: float) -> Vector:
        """The row at `time` [s], samples interpolated linearly."""
        k = min(max(bisect_right(self.time, time), 1), len(self.time) - 1)
        share = min(max((time - self.time[k - 1]) / (self.time[k] - self.time[k - 1]), 0.0), 1.0)
        row: Vector = (1.0 - share) * self.rows[k - 1] + share * self.rows[k]
        return row


class Reference:
    """The plan of one robot.

    Attributes:
        plan: The robot's plan.
        robot: The robot.
    """

    def __init__(self, plan: RobotPlan, robot: Robot) -> None:
        """Reads the plan.

        Raises:
            PlanFileError: If its columns are not those of the robot.
        """
        names = {
            "positions": (plan.positions, robot.position_names),
            "velocities": (plan.velocities, robot.velocity_names),
            "limbs": (plan.limbs, robot.limb_names),
        }
        for what, (planned, own) in names.items():
            if sorted(planned) != sorted(own):
                raise PlanFileError(
                    f"robot {plan.name!r}: its {what} are {list(planned)}, but those of the model {robot.model.path} "
                    f"are {list(own)}"
                )
        self.plan, self.robot = plan, robot
        least = {kind: min(_margin(phase, kind) for phase in plan.phases) for kind in SPARED}
        self._tracks = [_Track(phase, plan, robot, least) for phase in plan.phases]
        self._nq, self._nv = len(robot.position_names), len(robot.velocity_names)

    @property
    def num_phases(self) -> int:
        """How many phases there are."""
        return len(self._tracks)

    def phase(self, number: int) -> Phase:
        """A phase of the plan."""
        return self._tracks[number].phase

    def end(self, number: int) -> float:
        """When a phase ends [s]."""
        return self._tracks[number].end

    def contacts(self) -> Iterator[tuple[int, int, Vector]]:
        """Every limb on every hold that it ever holds, and where its foot is then in W [m]."""
        for track in self._tracks:
            for contact in track.phase.contacts:
                yield self.robot.limb_names.index(contact.limb), contact.hold, contact.point

    def at(self, number: int, time: float) -> Desired:
        """What is desired at `time` [s] within phase `number`.

        Forces jump in a plan where contacts change. Here they go over smoothly: towards the end of a phase to those
        that the next begins with, and after a touch-down from those that the phase before ended with, so that a foot
        is nearly unloaded when it lets go and takes its load little by little. Posture and contacts at the change are
        the same in both, and what lies between two sets of contact forces is as admissible as they are.
        """
        track = self._tracks[number]
        row = track.at(time)
        nq, nv, limbs = self._nq, self._nv, len(self.robot.limbs)
        state, loads = row[: nq + 2 * nv], row[nq + 2 * nv :]
        blend = min(BLEND, (track.end - track.begin) / 3.0)
        if number > 0 and time < track.begin + blend and self._new(number, number - 1):
            before = self._tracks[number - 1].rows[-1, nq + 2 * nv :]
            loads = before + max(_smooth((time - track.begin) / blend), LIGHTLY) * (loads - before)
        if number + 1 < len(self._tracks) and time > track.end - blend and self._new(number, number + 1):
            after = self._tracks[number + 1].rows[0, nq + 2 * nv :]
            loads = after + max(_smooth((track.end - time) / blend), LIGHTLY) * (loads - after)
        force, moment, (drop, turn) = loads[: 3 * limbs].reshape(limbs, 3), loads[3 * limbs : -2], loads[-2:].tolist()
        return Desired(state[:nq], state[nq : nq + nv], state[nq + nv :], force, moment, drop, turn)

    def _new(self, number: int, other: int) -> bool:
        """Whether a limb holds in one phase that does not in another."""
        limbs, others = ({c.limb for c in self._tracks[k].phase.contacts} for k in (number, other))
        return not limbs <= others


def _margin(phase: Phase, kind: MarginKind) -> float:
    """The error of a kind up to which there are contact forces throughout the phase."""
    return phase.margins[kind].value / KEPT if kind in phase.margins else 0.0


def _smooth(share: float) -> float:
    """From 0 to 1, level at both ends."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)
