"""Small plans of a robot in space made from first principles, without the planner: see `plans`, whose kin they are.

`climb_plan`: a robot with a floating base hangs on four incut holds of a leaning wall, shifts, swings its right front
limb to a fifth, and shifts on. Its pelvis runs along straight lines in its positions, so that it turns as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import cvxpy
import numpy as np
from plans import LIMBS, RATE, Line, with_margins
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces

from climber.plan_file import Plan
from climber.plan_parts import Phase, PhaseContact, RobotPlan
from climber.robot import Model, Robot
from climber.stance import Vector
from climber.wall import Wall

LEMUR = "package://climber/lemur/lemur.urdf"
KNEES_UP = (-0.5, 0.9, 0.7, 0.5, -0.9, 0.7, -0.5, 0.9, 0.7, 0.5, -0.9, 0.7)
ACCURATE = {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11}


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

    def room(self, forces: Sequence[cvxpy.Expression], holds: Sequence[int], room: cvxpy.Variable) -> list[object]:
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


class SpaceClimber:
    """A robot with a floating base and three joints a limb, posed and moved by its pelvis and feet."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.context = robot.context()
        self.joints = robot.joint_v  # positions and velocities of this robot have the same places
        self.q = np.zeros(robot.plant.num_positions())
        self.q[self.joints] = KNEES_UP

    def jacobian(self) -> Vector:
        """Of the feet, limb by limb, shape (3 num_limbs, nv)."""
        plant, world = self.robot.plant, self.robot.plant.world_frame()
        frames = [plant.GetFrameByName(limb.foot) for limb in self.robot.limbs]
        wrt = JacobianWrtVariable.kV
        return np.vstack(
            [
                plant.CalcJacobianTranslationalVelocity(self.context, wrt, frame, np.zeros(3), world, world)
                for frame in frames
            ]
        )

    def pose(self, base: Vector, feet: Vector) -> Vector:
        """Positions with the base's at `base` (6,) and the feet at `feet`, shape (num_limbs, 3)."""
        self.q[self.robot.base_q] = base
        for _ in range(100):
            self.robot.plant.SetPositions(self.context, self.q)
            miss = (self.robot.foot_positions(self.context) - feet).ravel()
            if np.abs(miss).max() < 1e-13:
                break
            step = np.linalg.solve(self.jacobian()[:, self.joints], miss)
            self.q[self.joints] -= step * min(1.0, 0.3 / np.abs(step).max())
        assert np.abs(miss).max() < 1e-12
        return self.q.copy()

    def rates(self, base: tuple[Vector, Vector], feet: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
        """Velocities and accelerations for the rates of base positions (6,) and feet (num_limbs, 3), at the last pose.

        Each is a pair of first and second derivatives by time.
        """
        robot, plant, world = self.robot, self.robot.plant, self.robot.plant.world_frame()
        J, at = self.jacobian(), robot.base_v
        first, second = np.zeros((2, plant.num_velocities()))
        first[robot.base_q], second[robot.base_q] = base
        v = robot.v_of(self.q[None], first[None])[0]
        vd = robot.vd_of(self.q[None], first[None], second[None])[0]
        v[self.joints] = np.linalg.solve(J[:, self.joints], feet[0].ravel() - J[:, at] @ v[at])
        plant.SetVelocities(self.context, v)
        bias = np.concatenate(
            [
                plant.CalcBiasTranslationalAcceleration(
                    self.context, JacobianWrtVariable.kV, plant.GetFrameByName(limb.foot), np.zeros(3), world, world
                ).ravel()
                for limb in robot.limbs
            ]
        )
        vd[self.joints] = np.linalg.solve(J[:, self.joints], feet[1].ravel() - bias - J[:, at] @ vd[at])
        return v, vd

    def _needed(self, vd: Vector, limbs: Sequence[int]) -> tuple[Vector, Vector]:
        """M vd + h (nv,), and the Jacobian of the feet that hold, shape (3 len(limbs), nv)."""
        applied = MultibodyForces(self.robot.plant)
        self.robot.plant.CalcForceElementsContribution(self.context, applied)
        rows = [3 * limb + axis for limb in limbs for axis in range(3)]
        return self.robot.plant.CalcInverseDynamics(self.context, vd, applied), self.jacobian()[rows]

    def centered(self, limbs: Sequence[int], rock: Rock, holds: Sequence[int]) -> Vector:
        """Static contact forces with as much room as can be, to cones and to torque limits, shape (len(limbs), 3)."""
        self.robot.plant.SetVelocities(self.context, np.zeros(self.robot.plant.num_velocities()))
        needed, J = self._needed(np.zeros(self.robot.plant.num_velocities()), limbs)
        forces, room = [cvxpy.Variable(3) for _ in limbs], cvxpy.Variable()
        left = needed - J.T @ cvxpy.hstack(forces)
        inside = [left[self.robot.base_v] == 0.0, *rock.room(forces, holds, room)]
        inside += [cvxpy.abs(left[self.joints]) <= self.robot.effort - 0.1 * room]
        problem = cvxpy.Problem(cvxpy.Maximize(room), inside)
        problem.solve(solver=cvxpy.CLARABEL, **ACCURATE)
        assert room.value > 0.0
        return np.array([force.value for force in forces])

    def phase(
        self, rock: Rock, stance: int, holds: dict[int, int], base: Line, feet: Line, begin: float, duration: float
    ) -> Phase:
        """The phase in which base and feet run along lines; see `plans.Climber.phase`."""
        limbs = sorted(holds)
        count = int(np.ceil(duration * RATE)) + 1
        self.pose(base.at(0.5, duration)[0], feet.at(0.5, duration)[0])
        wish = self.centered(limbs, rock, [holds[limb] for limb in limbs])
        rows = []
        for tau in np.linspace(0.0, 1.0, count):
            (x, xd, xdd), (p, pd, pdd) = base.at(tau, duration), feet.at(tau, duration)
            q = self.pose(x, p)
            v, vd = self.rates((xd, xdd), (pd, pdd))
            needed, J = self._needed(vd, limbs)
            carry = J[:, self.robot.base_v].T
            f = wish.ravel() + np.linalg.pinv(carry) @ (needed[self.robot.base_v] - carry @ wish.ravel())
            rows.append((q, v, vd, f.reshape(-1, 3), (needed - J.T @ f)[self.joints]))
        q, v, vd, force, torque = (np.array(column) for column in zip(*rows, strict=True))
        swinging = next((LIMBS[limb] for limb in range(4) if limb not in holds), None)
        return Phase(
            kind="swing" if swinging else "shift",
            limb=swinging,
            stance=stance,
            contacts=tuple(PhaseContact(LIMBS[i], holds[i], feet.start[i]) for i in limbs),
            time=begin + np.linspace(0.0, duration, count),
            q=q,
            v=v,
            vd=vd,
            torque=torque,
            force={LIMBS[limb]: force[:, place] for place, limb in enumerate(limbs)},
        )


@cache
def climb_plan(duration: float = 1.6) -> Plan:
    """A shift, a swing of the right front limb and a shift, each of `duration` [s]."""
    robot = Robot(Model.load(LEMUR), Wall((), inclination_deg=INCUT.inclination_deg).gravity)
    climber = SpaceClimber(robot)
    before, after = INCUT.positions[[0, 1, 2, 3]], INCUT.positions[[4, 1, 2, 3]]
    base = [Line(np.array(a), np.array(b)) for a, b in pairwise(CLIMB_PELVIS)]
    feet = [Line(before, before), Line(before, after), Line(after, after)]
    holds = [{0: 0, 1: 1, 2: 2, 3: 3}, {1: 1, 2: 2, 3: 3}, {0: 4, 1: 1, 2: 2, 3: 3}]
    phases = [climber.phase(INCUT, i // 2, holds[i], base[i], feet[i], i * duration, duration) for i in range(3)]
    stances = [(0, 1, 2, 3), (4, 1, 2, 3)]
    robot_plan = RobotPlan(
        name="lemur",
        model=LEMUR,
        limbs=LIMBS,
        positions=robot.position_names,
        velocities=robot.velocity_names,
        joints=robot.joint_names,
        moves=1,
        cost=60,
        stances=tuple(dict(zip(LIMBS, stance, strict=True)) for stance in stances),
        phases=tuple(phases),
    )
    text = INCUT.scenario("a step in space", CLIMB_ROBOT)
    return with_margins(Plan("scenarios/small.yaml", text, 7, (robot_plan,), {"climber": "0.1.0"}, {"total": 1.5}))
