"""Small plans of a robot in space made from first principles, without the planner: see `plans`, whose kin they are.

`climb_plan`: a robot with a floating base hangs on four incut holds of a leaning wall, shifts, swings its right front
limb to a fifth, and shifts on. Its pelvis runs along straight lines in its positions, so that it turns as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import cvxpy
import numpy as np
from movers import Climber, step_phases
from plans import Ground, written

from climber.plan_file import Plan
from climber.robot import Model, Robot
from climber.wall import Wall

LEMUR = "package://climber/lemur/lemur.urdf"
KNEES_UP = (-0.5, 0.9, 0.7, 0.5, -0.9, 0.7, -0.5, 0.9, 0.7, 0.5, -0.9, 0.7)


@dataclass(frozen=True)
class Rock(Ground):
    """Holds that stick out of a wall in space."""

    friction: float = 0.7
    min_force: float = 0.5
    max_force: float = 60.0

    model: ClassVar[str] = LEMUR
    inclination_deg: ClassVar[float] = 100.0
    facets: ClassVar[str] = """\
  facets:
  - corners: [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]
"""
    obstacles: ClassVar[str] = """\
  - sphere: {center: [0.0, 0.22, 0.2], radius: 0.05}
  - polygon: {vertices: [[0.5, -0.3], [0.7, -0.3], [0.7, 0.3], [0.6, 0.0]]}
"""

    def room(self, forces: Sequence[cvxpy.Variable], holds: Sequence[int], room: cvxpy.Variable) -> list[object]:
        """Constraints: forces are within the two cones of their holds, with `room` [N] to the apexes of both.

        |f_t| <= mu (f_n - lo - room) and |f_t| <= mu (hi - room - f_n), lo and hi twice the least and greatest force
        along an edge times the cosine of the cone's half angle.
        """
        cos = np.cos(np.arctan(self.friction))
        low, high = 2.0 * self.min_force * cos, 2.0 * self.max_force * cos
        inside: list[object] = []
        for f, n in zip(forces, self.units[list(holds)], strict=True):
            across = cvxpy.norm(f - n * (n @ f))
            inside += [across <= self.friction * (n @ f - low - room), across <= self.friction * (high - room - n @ f)]
        return inside


INCUT = Rock(
    positions=np.array(
        [
            [0.20, 0.27, 0.04],
            [-0.21, 0.28, 0.04],
            [-0.22, -0.25, 0.05],
            [0.21, -0.26, 0.04],
            [0.24, 0.33, 0.06],
            [0.6, 0.6, 0.04],
        ]
    ),
    normals=np.array(
        [[0.1, 1.0, -0.5], [-0.1, 1.0, -0.4], [0.1, 1.0, 0.2], [-0.1, 1.0, 0.1], [0.0, 1.0, -0.5], [0.0, 1.0, 0.0]]
    ),
)
CLIMB_ROBOT = """\
  goal:
    holds: [1, 2, 3, 4]
    pelvis: {sphere: {center: [0.0, 0.03, 0.15], radius: 0.005}}
  waypoints:
  - {name: before the swing, pelvis: {circle: {center: [-0.02, 0.01], radius: 0.001}}}
  avoid:
    regions:
    - box: {center: [0.0, -0.5, 0.1], size: [0.2, 0.1, 0.2]}
"""
# Roll, pitch and yaw, then z, x and y in W, at the ends of the three phases.
CLIMB_PELVIS = [
    (0.05, 0.10, -0.10, 0.14, 0.01, -0.005),
    (-0.05, 0.05, 0.08, 0.15, -0.02, 0.01),
    (0.02, -0.06, 0.10, 0.14, -0.025, 0.015),
    (-0.04, 0.04, -0.05, 0.15, 0.0, 0.03),
]


@cache
def climb_plan(duration: float = 1.6) -> Plan:
    """A shift, a swing of the right front limb and a shift, each of `duration` [s]."""
    robot = Robot(Model.load(LEMUR), Wall((), inclination_deg=INCUT.inclination_deg).gravity)
    phases = step_phases(Climber(robot, KNEES_UP), INCUT, CLIMB_PELVIS, duration)
    stances = [(0, 1, 2, 3), (4, 1, 2, 3)]
    return written(INCUT.scenario("a step in space", CLIMB_ROBOT), LEMUR, robot, stances, phases)
