"""A plan's robot as pictures need it: any instant of its climb, and where its centre of mass may be in each phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from climber.exceptions import PlanFileError
from climber.plan_parts import Phase, RobotPlan
from climber.programs.forces import wall_forces, weight_in_plane
from climber.programs.regions import support_regions
from climber.programs.support import support_intervals
from climber.robot import Robot
from climber.silhouette import Outline, Silhouette
from climber.stance import Vector
from climber.wall import GRAVITY, Wall


@dataclass(frozen=True)
class Moment:
    """A robot at one instant.

    Attributes:
        phase: Index of the phase.
        q: Positions of the plant [m, rad], shape (nq,).
        forces: By limb in contact, where it stands in W [m] and the force on the robot in W [N], each of shape (3,).
    """

    phase: int
    q: Vector
    forces: dict[str, tuple[Vector, Vector]]


class Replay:
    """One robot's climb.

    Attributes:
        plan: The robot's part of the plan.
        robot: The robot.
        looks: What it looks like.
        weight: Its weight [N], along the wall unless the wall is a floor.
        support: Support interval of the limbs in contact during each phase [m], NaN where empty, shape (num_phases, 2).
            In space it is how far the support polygon extends along x.
        polygons: In space, the corners in order of each phase's support polygon, at any height, in W [m], shape (n, 3);
            n is 0 where it is empty. None in the plane.
        start: Time at which the climb begins [s].
        end: Time at which it ends [s].
    """

    def __init__(self, wall: Wall, plan: RobotPlan, robot: Robot) -> None:
        """Reads off what the pictures need.

        Raises:
            PlanFileError: If the plan's positions are not those of the robot, or a hold is not on the wall.
        """
        if sorted(plan.positions) != sorted(robot.position_names):
            raise PlanFileError(
                f"robot {plan.name!r}: its positions are {list(plan.positions)}, but those of the model "
                f"{robot.model.path} are {list(robot.position_names)}"
            )
        beyond = {c.hold for phase in plan.phases for c in phase.contacts if c.hold >= len(wall.holds)}
        if beyond:
            raise PlanFileError(f"robot {plan.name!r}: no hold {min(beyond)}; the holds are 0 to {len(wall.holds) - 1}")
        if any(phase.limb is not None and phase.stance + 1 >= len(plan.stances) for phase in plan.phases):
            raise PlanFileError(f"robot {plan.name!r}: a limb swings out of the last of {len(plan.stances)} stances")
        self.plan, self.robot, self.looks = plan, robot, Silhouette(robot)
        self._columns = [plan.positions.index(name) for name in robot.position_names]
        along = weight_in_plane(wall, robot.mass)
        self.weight = along or robot.mass * GRAVITY
        self._forces = wall_forces(wall, robot.dimension)
        regions = self._regions(wall, plan.phases)
        self.support = np.array([ends for ends, _ in regions])
        self.polygons = None if robot.planar else tuple(polygon for _, polygon in regions)
        self._begins = np.array([phase.time[0] for phase in plan.phases])
        self.start, self.end = float(plan.phases[0].time[0]), float(plan.phases[-1].time[-1])

    def _regions(self, wall: Wall, phases: Sequence[Phase]) -> list[tuple[Vector, Vector]]:
        """The extents along x of where phases' contacts support the centre of mass; in space, their corners as well."""
        result = [(np.full(2, np.nan), np.zeros((0, 3)))] * len(phases)
        for count in {len(phase.contacts) for phase in phases}:  # many of a kind at once
            places = [i for i, phase in enumerate(phases) if len(phase.contacts) == count]
            some = [phases[i].contacts for i in places]
            holds = np.array([[contact.hold for contact in contacts] for contacts in some], dtype=int)
            points = np.array([[contact.point for contact in contacts] for contacts in some], dtype=float)
            points = points.reshape(len(some), count, 3)
            if self.robot.planar:
                ends = support_intervals(points, self._forces[holds], weight_in_plane(wall, self.robot.mass))
                for i, own in zip(places, ends, strict=True):
                    result[i] = own, np.zeros((0, 3))
                continue
            found = support_regions(points, self._forces[holds], self.robot.mass * wall.gravity)
            for i, empty, own in zip(places, found.empty, found.corners, strict=True):
                if not empty:
                    corners = own @ found.basis
                    result[i] = np.array([corners[:, 0].min(), corners[:, 0].max()]), corners
        return result

    def at(self, time: float) -> Moment:
        """The robot at `time` [s], samples interpolated linearly; before and after the climb it stands still."""
        place = max(0, int(np.searchsorted(self._begins, time, side="right")) - 1)
        phase = self.plan.phases[place]
        after = int(np.clip(np.searchsorted(phase.time, time), 1, len(phase.time) - 1))
        step = phase.time[after] - phase.time[after - 1]
        share = float(np.clip((time - phase.time[after - 1]) / step, 0.0, 1.0)) if step > 0.0 else 1.0

        def between(samples: Vector) -> Vector:
            result: Vector = (1.0 - share) * samples[after - 1] + share * samples[after]
            return result

        forces = {
            contact.limb: (np.asarray(contact.point, dtype=float), between(phase.force[contact.limb]))
            for contact in phase.contacts
            if contact.limb in phase.force
        }
        return Moment(place, between(phase.q)[self._columns], forces)

    def outline(self, moment: Moment) -> Outline:
        """What the robot looks like at a moment."""
        return self.looks.at(moment.q)

    def moving(self, phase: int) -> int | None:
        """Index of the limb that swings in a phase."""
        name = self.plan.phases[phase].limb
        return None if name is None else self.robot.limb_names.index(name)

    def standing_support(self, phase: int) -> Vector:
        """Support interval with every limb in contact, before the swing if it is one [m], shape (2,)."""
        result: Vector = self.support[phase if self.moving(phase) is None else max(phase - 1, 0)]
        return result

    def describe(self, phase: int) -> str:
        """What happens in a phase, in words."""
        plan = self.plan
        limb, stance = plan.phases[phase].limb, plan.phases[phase].stance
        if limb is None:
            return "shift on holds " + ", ".join(str(contact.hold) for contact in plan.phases[phase].contacts)
        number = self.moves.index(phase) + 1
        before, after = plan.stances[stance][limb], plan.stances[stance + 1][limb]
        holds = f"hold {before} to {after}" if before != after else f"hold {before} again"
        return f"move {number} of {len(self.moves)}: {limb.replace('_', ' ')}, {holds}"

    @cached_property
    def reached(self) -> Vector:
        """Points around all that the robot covers, sampled along the climb, in the wall plane [m], shape (n, 2)."""
        times = np.linspace(self.start, self.end, 4 * len(self.plan.phases))
        return np.vstack([self.outline(self.at(float(time))).points for time in times])

    @cached_property
    def moves(self) -> list[int]:
        """Indices of the phases in which a limb swings, in order."""
        return [place for place, phase in enumerate(self.plan.phases) if phase.limb is not None]
