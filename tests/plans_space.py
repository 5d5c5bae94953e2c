"""Small plans of a robot in space made from first principles, without the planner: see `plans`, whose kin they are.

`climb_plan`: a robot with a floating base hangs on four incut holds of a leaning wall, shifts, swings its right front
limb to a fifth, and shifts on. Its pelvis runs along straight lines in its positions, so that it turns as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cvxpy
import numpy as np
from movers import Climber, step_phases
from plans import written

from climber.plan_file import Plan
from climber.robot import Model, Robot
from climber.stance import Vector
from climber.wall import Wall

LEMUR = "package://climber/lemur/lemur.urdf"
KNEES_UP = (-0.5, 0.9, 0.7, 0.5, -0.9, 0.7, -0.5, 0.9, 0.7, 0.5, -0.9, 0.7)


@dataclass(frozen=True)
class Rock:
    """Holds that stick out of a wall in space, all alike but for where they are and how they lean.

    Attributes:
        positions: Centres of the patches [m], shape (num_holds, 3).
        normals: Outward normals of any length, shape (num_holds, 3).
        inclination_deg: Of the wall.
        friction: Coulomb coefficient.
        min_force: Least force along a cone edge [N].
        max_force: Greatest force along a cone edge [N].
    """

    positions: Vector
    normals: Vector
    inclination_deg: float = 100.0
    friction: float = 0.7
    min_force: float = 0.5
    max_force: float = 60.0

    @property
    def units(self) -> Vector:
        """Unit normals, shape (num_holds, 3)."""
        return self.normals / np.linalg.norm(self.normals, axis=1, keepdims=True)

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

    def scenario(self, name: str, robot: str) -> str:
        """The text of a scenario on this wall, with what it says of its robot."""
        places = zip(self.positions.tolist(), self.normals.tolist(), strict=True)
        holds = "\n".join(f"  - {{position: {position}, normal: {normal}}}" for position, normal in places)
        limits = f"min_force: {self.min_force}, max_force: {self.max_force}, friction: {self.friction}"
        return f"""\
name: {name}
seed: 7
wall:
  inclination_deg: {self.inclination_deg}
  hold_defaults: {{half_width: 0.01, {limits}}}
  facets:
  - corners: [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]
  holds:
{holds}
  obstacles:
  - sphere: {{center: [0.0, 0.22, 0.2], radius: 0.05}}
  - polygon: {{vertices: [[0.5, -0.3], [0.7, -0.3], [0.7, 0.3], [0.6, 0.0]]}}
robots:
- name: lemur
  model: {LEMUR}
  start: {{right_front: 0, left_front: 1, left_rear: 2, right_rear: 3}}
{robot}"""


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
