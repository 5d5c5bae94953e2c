"""Small plans made from first principles, without the planner, for whatever reads plans.

The quadruped stands on four holds, shifts, swings its right front limb to a fifth, and shifts on. Pelvis and feet run
along straight lines by the minimum-jerk law; joints follow by Newton's method on the plant's Jacobians, velocities and
accelerations from the contacts' constraints, forces as near as possible to ones well inside the cones, torques from
the plant's inverse dynamics.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from typing import Any

import cvxpy
import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces

from climber.plan_file import Cut, Phase, PhaseContact, Plan, RobotPlan
from climber.robot import Model, Robot
from climber.stance import Vector

QUADRUPED = "package://climber/quadruped/quadruped.urdf"
LIMBS = ("right_front", "left_front", "left_rear", "right_rear")
HOLDS = np.array([[0.13, 0.15], [-0.12, 0.16], [-0.13, -0.14], [0.12, -0.15], [0.14, 0.19], [0.30, 0.30]])
NORMALS = np.array([[-0.1, 1.0], [0.2, 1.0], [0.1, 1.0], [-0.15, 1.0], [0.0, 1.0], [0.0, 1.0]])
FRICTION = 0.6
RATE = 100.0  # [Hz]
PELVIS = {
    "start": (0.01, -0.005, 0.05),
    "lift": (-0.012, 0.004, 0.02),
    "land": (-0.015, 0.008, 0.0),
    "end": (0.0, 0.02, -0.03),
}

SCENARIO = """\
name: a step to the right
description: Four holds, and a fifth for the right front limb.
seed: 7
wall:
  inclination_deg: 90.0
  hold_defaults: {half_width: 0.01, min_force: 1.0, max_force: 20.0, friction: 0.6}
  holds:
HOLDS
  obstacles:
  - circle: {center: [0.0, 0.16], radius: 0.02}
  - polygon: {vertices: [[0.26, -0.1], [0.40, -0.1], [0.40, 0.1], [0.33, 0.0]]}
robots:
- name: quadruped
  model: MODEL
  start: {right_front: 0, left_front: 1, left_rear: 2, right_rear: 3}
  goal:
    holds: [1, 2, 3, 4]
    stance: {right_front: 4}
    pelvis: {circle: {center: [0.0, 0.02], radius: 0.005}}
  avoid: {holds: [5]}
"""


@dataclass(frozen=True)
class Line:
    """A straight line run from rest to rest by the minimum-jerk law."""

    start: Vector
    end: Vector

    def at(self, tau: float, duration: float) -> tuple[Vector, Vector, Vector]:
        """Place, velocity and acceleration at the fraction `tau` of `duration` [s]."""
        way = self.end - self.start
        return (
            self.start + way * tau**3 * (10 - 15 * tau + 6 * tau**2),
            way * 30 * tau**2 * (1 - tau) ** 2 / duration,
            way * 60 * tau * (1 - tau) * (1 - 2 * tau) / duration**2,
        )


class Climber:
    """The quadruped, posed and moved by its pelvis and feet."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.context = robot.context()
        self.joints = robot.joint_v  # positions and velocities of this robot have the same places
        self.q = np.zeros(robot.plant.num_positions())
        # Knees bent outwards.
        self.q[self.joints] = [-0.4, 1.2, 0.4, -1.2, -0.4, 1.2, 0.4, -1.2]

    def _jacobian(self) -> Vector:
        """Of the feet in the plane, limb by limb, shape (2 num_limbs, nv)."""
        plant, world = self.robot.plant, self.robot.plant.world_frame()
        frames = [plant.GetFrameByName(limb.foot) for limb in self.robot.limbs]
        wrt = JacobianWrtVariable.kV
        return np.vstack(
            [
                plant.CalcJacobianTranslationalVelocity(self.context, wrt, frame, np.zeros(3), world, world)[:2]
                for frame in frames
            ]
        )

    def pose(self, pelvis: Vector, feet: Vector) -> Vector:
        """Positions with the pelvis at (x, y, angle) and the feet at `feet`, shape (num_limbs, 2)."""
        plant = self.robot.plant
        self.q[self.robot.base_q] = pelvis
        for _ in range(50):
            plant.SetPositions(self.context, self.q)
            miss = (self.robot.foot_positions(self.context)[:, :2] - feet).ravel()
            if np.abs(miss).max() < 1e-13:
                break
            self.q[self.joints] -= np.linalg.solve(self._jacobian()[:, self.joints], miss)
        assert np.abs(miss).max() < 1e-12
        return self.q.copy()

    def rates(self, pelvis: tuple[Vector, Vector], feet: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
        """Velocities and accelerations for those of the pelvis (3,) and the feet (num_limbs, 2), at the last pose."""
        plant, world = self.robot.plant, self.robot.plant.world_frame()
        J, base = self._jacobian(), self.robot.base_v
        v, vd = np.zeros(plant.num_velocities()), np.zeros(plant.num_velocities())
        v[base], vd[base] = pelvis
        v[self.joints] = np.linalg.solve(J[:, self.joints], feet[0].ravel() - J[:, base] @ v[base])
        plant.SetVelocities(self.context, v)
        bias = np.concatenate(
            [
                plant.CalcBiasTranslationalAcceleration(
                    self.context, JacobianWrtVariable.kV, plant.GetFrameByName(limb.foot), np.zeros(3), world, world
                ).ravel()[:2]
                for limb in self.robot.limbs
            ]
        )
        vd[self.joints] = np.linalg.solve(J[:, self.joints], feet[1].ravel() - bias - J[:, base] @ vd[base])
        return v, vd

    def forces(self, vd: Vector, limbs: list[int], wish: Vector) -> tuple[Vector, Vector]:
        """Contact forces of `limbs` nearest to `wish` (len(limbs), 2) that carry the motion, and the torques."""
        plant = self.robot.plant
        applied = MultibodyForces(plant)
        plant.CalcForceElementsContribution(self.context, applied)
        needed = plant.CalcInverseDynamics(self.context, vd, applied)
        rows = [2 * limb + axis for limb in limbs for axis in (0, 1)]
        J = self._jacobian()[rows]
        carry = J[:, self.robot.base_v].T
        f = wish.ravel() + np.linalg.pinv(carry) @ (needed[self.robot.base_v] - carry @ wish.ravel())
        return f.reshape(-1, 2), (needed - J.T @ f)[self.joints]

    def centered(self, limbs: list[int], cones: Vector) -> Vector:
        """Static contact forces as deep inside the cones as can be, shape (len(limbs), 2).

        Args:
            limbs: The limbs that hold.
            cones: Cone edges under each of them as columns, shape (len(limbs), 2, 2).
        """
        plant = self.robot.plant
        plant.SetVelocities(self.context, np.zeros(plant.num_velocities()))
        gravity = plant.CalcGravityGeneralizedForces(self.context)[self.robot.base_v]
        rows = [2 * limb + axis for limb in limbs for axis in (0, 1)]
        carry = self._jacobian()[rows][:, self.robot.base_v].T
        edges = np.zeros((2 * len(limbs), 2 * len(limbs)))
        for i, cone in enumerate(cones):
            edges[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = cone
        t, least = cvxpy.Variable(2 * len(limbs)), cvxpy.Variable()
        problem = cvxpy.Problem(cvxpy.Maximize(least), [carry @ edges @ t == -gravity, t >= least])
        problem.solve(solver=cvxpy.CLARABEL)
        assert least.value > 1.5
        return np.asarray(edges @ t.value).reshape(-1, 2)


def _phase(
    climber: Climber,
    edges: Vector,
    number: int,
    pelvis: Line,
    feet: tuple[Vector, Vector],
    begin: float,
    duration: float,
) -> Phase:
    """The phase in which the pelvis runs along a line and the feet from the first to the second places.

    Args:
        climber: Poses the robot.
        edges: Cone edges of every hold as columns, shape (num_holds, 2, 2).
        number: Which phase it is; odd ones swing the right front limb.
        pelvis: Where the pelvis goes.
        feet: Where the feet are before and after [m], shape (num_limbs, 2) each.
        begin: When it begins [s].
        duration: How long it takes [s].
    """
    swings = number % 2 == 1
    holds = [0 if number < 2 else 4, 1, 2, 3]
    limbs = [i for i in range(4) if i > 0 or not swings]
    way = Line(*feet)
    count = int(np.ceil(duration * RATE)) + 1
    climber.pose(pelvis.at(0.5, duration)[0], way.at(0.5, duration)[0])
    wish = climber.centered(limbs, edges[[holds[i] for i in limbs]])
    rows = []
    for tau in np.linspace(0.0, 1.0, count):
        (x, xd, xdd), (p, pd, pdd) = pelvis.at(tau, duration), way.at(tau, duration)
        q = climber.pose(x, p)
        v, vd = climber.rates((xd, xdd), (pd, pdd))
        rows.append((q, v, vd, *climber.forces(vd, limbs, wish)))
    q, v, vd, force, torque = (np.array(column) for column in zip(*rows, strict=True))
    flat = np.concatenate([force, np.zeros((count, len(limbs), 1))], axis=2)
    return Phase(
        kind="swing" if swings else "shift",
        limb=LIMBS[0] if swings else None,
        stance=number // 2,
        contacts=tuple(PhaseContact(LIMBS[i], holds[i], np.array([*feet[0][i], 0.0])) for i in limbs),
        time=begin + np.linspace(0.0, duration, count),
        q=q,
        v=v,
        vd=vd,
        torque=torque,
        force={LIMBS[limb]: flat[:, place] for place, limb in enumerate(limbs)},
    )


def scenario(model: str = QUADRUPED) -> str:
    """The scenario's text with the holds and the robot's model filled in."""
    places = zip(HOLDS.tolist(), NORMALS.tolist(), strict=True)
    holds = "\n".join(f"  - {{position: {position}, normal: {normal}}}" for position, normal in places)
    return SCENARIO.replace("HOLDS", holds).replace("MODEL", model)


@cache
def step_plan(model: str = QUADRUPED, duration: float = 0.8) -> Plan:
    """The plan: shift, swing of the right front limb, shift; each phase lasts `duration` [s]."""
    robot = Robot(Model.load(model))
    climber = Climber(robot)
    half = np.arctan(FRICTION)
    turn = np.array([[np.cos(half), -np.sin(half)], [np.sin(half), np.cos(half)]])
    normals = NORMALS / np.linalg.norm(NORMALS, axis=1, keepdims=True)
    edges = np.stack([normals @ turn.T, normals @ turn], axis=2)
    before, after = HOLDS[[0, 1, 2, 3]], HOLDS[[4, 1, 2, 3]]
    poses = [np.array(PELVIS[name]) for name in ("start", "lift", "land", "end")]
    feet = [(before, before), (before, after), (after, after)]
    phases = tuple(
        _phase(climber, edges, i, Line(poses[i], poses[i + 1]), feet[i], i * duration, duration) for i in range(3)
    )
    start = dict(zip(LIMBS, range(4), strict=True))
    return Plan(
        scenario_path="scenarios/step.yaml",
        scenario_text=scenario(model),
        seed=7,
        robots=(
            RobotPlan(
                name="quadruped",
                model=model,
                limbs=LIMBS,
                positions=robot.position_names,
                velocities=robot.velocity_names,
                joints=robot.joint_names,
                moves=1,
                cost=60,
                stances=(start, start | {LIMBS[0]: 4}),
                phases=phases,
                cuts=(Cut(start, LIMBS[1], 5, "out of reach", "proved", "transition"),),
                counts={"stances": 2, "moves": 1},
                proofs={"moves": True, "cost": True, "relative_to": "the stance graph less the cuts listed"},
            ),
        ),
        software={"climber": "0.1.0"},
        timings={"total": 1.5},
    )


def edited(plan: Plan, path: str, value: object) -> str:
    """The text of a plan file in which one entry has another value.

    Args:
        plan: The plan to start from.
        path: Keys and places from the root, such as `robots/0/phases/1/q/5/2`.
        value: The new value; a callable is given the old one. `REMOVED` takes the entry out.
    """
    data = json.loads(plan.to_json())
    parent, last = entry(data, path)
    if value is REMOVED:
        del parent[last]
    else:
        parent[last] = value(parent[last]) if callable(value) else value
    return json.dumps(data)


REMOVED = object()


def entry(data: Any, path: str) -> tuple[Any, Any]:
    """The list or object that holds the entry at `path`, and the entry's place or key in it."""
    *way, last = path.split("/")
    for key in way:
        data = data[int(key) if isinstance(data, list) else key]
    return data, int(last) if isinstance(data, list) else last
