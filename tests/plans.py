"""Small plans made from first principles, without the planner, for whatever reads plans.

`step_plan`: the quadruped stands on four holds, shifts, swings its right front limb to a fifth, and shifts on.
`still_plan`: it stands still. How it moves is in `movers`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar, cast

import cvxpy
import numpy as np
from movers import LIMBS, Climber, Line, step_phases

from climber.least_margins import least_by_kind
from climber.margins import phase_margins
from climber.plan_file import Plan
from climber.plan_parts import Achieved, Cut, MarginKind, Phase, PhaseContact, RobotPlan
from climber.robot import Model, Robot
from climber.scenario import scenario_from_text
from climber.simulation import Perturbation
from climber.stance import Contact, Vector
from climber.timing import Samples
from climber.verify import verify

QUADRUPED = "package://climber/quadruped/quadruped.urdf"
PHASE = "robots/0/phases"  # where a plan file has them
KNEES_OUT = (-0.4, 1.2, 0.4, -1.2, -0.4, 1.2, 0.4, -1.2)


@dataclass(frozen=True)
class Ground:
    """Holds to stand on, all alike but for where they are and how they lean.

    Attributes:
        positions: Centres of the patches [m], shape (num_holds, d).
        normals: Outward normals of any length, shape (num_holds, d).
        friction: Coulomb coefficient.
        min_force: Least force along a cone edge [N].
        max_force: Greatest force along a cone edge [N].
    """

    positions: Vector
    normals: Vector
    friction: float = 0.6
    min_force: float = 1.0
    max_force: float = 20.0

    model: ClassVar[str] = QUADRUPED
    inclination_deg: ClassVar[float] = 90.0
    facets: ClassVar[str] = ""
    obstacles: ClassVar[str] = """\
  - circle: {center: [0.0, 0.16], radius: 0.02}
  - polygon: {vertices: [[0.26, -0.1], [0.40, -0.1], [0.40, 0.1], [0.33, 0.0]]}
"""

    @property
    def units(self) -> Vector:
        """Unit normals, shape (num_holds, d)."""
        return self.normals / np.linalg.norm(self.normals, axis=1, keepdims=True)

    def room(self, forces: Sequence[cvxpy.Variable], holds: Sequence[int], room: cvxpy.Variable) -> list[object]:
        """Constraints: forces along the edges are between the least and the greatest one, with `room` [N] to both."""
        half = np.arctan(self.friction)
        turn = np.array([[np.cos(half), -np.sin(half)], [np.sin(half), np.cos(half)]])
        inside: list[object] = []
        for f, normal in zip(forces, self.units[list(holds)], strict=True):
            t = np.linalg.inv(np.column_stack([turn @ normal, turn.T @ normal])) @ f
            inside += [t >= self.min_force + room, t <= self.max_force - room]
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
{self.facets}  holds:
{holds}
  obstacles:
{self.obstacles}robots:
- name: {Path(self.model).stem}
  model: {self.model}
  start: {{right_front: 0, left_front: 1, left_rear: 2, right_rear: 3}}
{robot}"""


STEP = Ground(
    positions=np.array([[0.13, 0.15], [-0.12, 0.16], [-0.13, -0.14], [0.12, -0.15], [0.14, 0.19], [0.30, 0.30]]),
    normals=np.array([[-0.1, 1.0], [0.2, 1.0], [0.1, 1.0], [-0.15, 1.0], [0.0, 1.0], [0.0, 1.0]]),
)
STEP_ROBOT = """\
  goal:
    holds: [1, 2, 3, 4]
    pelvis: {circle: {center: [0.0, 0.02], radius: 0.005}}
  waypoints:
  - {name: before the swing, pelvis: {circle: {center: [-0.012, 0.004], radius: 0.001}}}
"""
STEP_PELVIS = [(0.01, -0.005, 0.05), (-0.012, 0.004, 0.02), (-0.015, 0.008, 0.0), (0.0, 0.02, -0.03)]
STILL_ROBOT = """\
  goal:
    pelvis: {circle: {center: [0.0, 0.0], radius: 0.2}}
"""


def length(phases: Sequence[Phase]) -> float:
    """Of the polylines through the samples, over all positions."""
    return sum(float(np.linalg.norm(b - a)) for phase in phases for a, b in pairwise(phase.q))


def written(
    text: str, model: str, robot: Robot, stances: Sequence[Sequence[int]], phases: Sequence[Phase], **more: Any
) -> Plan:
    """The plan of one robot, with its margins.

    Args:
        text: The scenario's.
        model: Where the robot's model is.
        robot: The robot, called what its model is.
        stances: The hold of each limb, stance by stance.
        phases: How it moves.
        more: Further fields of its `RobotPlan`.
    """
    robot_plan = RobotPlan(
        name=robot.name,
        model=model,
        limbs=LIMBS,
        positions=robot.position_names,
        velocities=robot.velocity_names,
        joints=robot.joint_names,
        moves=len(stances) - 1,
        cost=60,
        stances=tuple(dict(zip(LIMBS, stance, strict=True)) for stance in stances),
        phases=tuple(phases),
        **more,
    )
    return with_margins(Plan("scenarios/small.yaml", text, 7, (robot_plan,), {"climber": "0.1.0"}, {"total": 1.5}))


def _plan(text: str, robot: Robot, stances: Sequence[Sequence[int]], phases: Sequence[Phase]) -> Plan:
    """Of the quadruped, with a cut and a record of how the plan became better."""
    return written(
        text,
        QUADRUPED,
        robot,
        stances,
        phases,
        cuts=(Cut(dict(zip(LIMBS, stances[0], strict=True)), LIMBS[1], 5, "out of reach", "proved", "transition"),),
        counts={"stances": 2, "moves": 1},
        proofs={"moves": True, "cost": True, "relative_to": "the stance graph less the cuts listed"},
        objective=Achieved("length", length(phases)),
        record=((0.5, length(phases) + 1.0), (1.25, length(phases))),
    )


def with_margins(plan: Plan) -> Plan:
    """The plan of one robot with the margins that its motion has on its own wall."""
    (own,) = plan.robots
    wall = scenario_from_text(plan.scenario_text).build_wall()
    robot = Robot(Model.load(own.model), wall.gravity)
    moving = [
        SimpleNamespace(
            contacts=tuple(Contact(own.limbs.index(c.limb), c.hold) for c in phase.contacts),
            samples=Samples(phase.time, phase.q, phase.v, phase.vd),
        )
        for phase in own.phases
    ]
    survived = phase_margins(robot, wall, moving)
    phases = tuple(replace(phase, margins=margins) for phase, margins in zip(own.phases, survived, strict=True))
    return replace(plan, robots=(replace(own, phases=phases),))


@cache
def step_plan(duration: float = 0.8) -> Plan:
    """A shift, a swing of the right front limb and a shift, each of `duration` [s]."""
    robot = Robot(Model.load(QUADRUPED))
    phases = step_phases(Climber(robot, KNEES_OUT), STEP, STEP_PELVIS, duration)
    return _plan(STEP.scenario("a step", STEP_ROBOT), robot, [(0, 1, 2, 3), (4, 1, 2, 3)], phases)


def still_plan(ground: Ground, pelvis: tuple[float, float, float], joints: Sequence[float] = KNEES_OUT) -> Plan:
    """The robot stands still on the first four holds for three samples.

    Args:
        ground: The holds.
        pelvis: Where the pelvis is (x, y, angle) [m, rad].
        joints: Joint angles near to those it stands with [rad].
    """
    robot = Robot(Model.load(QUADRUPED))
    feet, place = ground.positions[:4], np.array(pelvis)
    at = {limb: limb for limb in range(4)}
    phase = Climber(robot, joints).phase(ground, 0, at, Line(place, place), Line(feet, feet), 0.0, 0.02)
    return _plan(ground.scenario("standing", STILL_ROBOT), robot, [(0, 1, 2, 3)], [phase])


def through_straight_plan(bend: float = 0.6, duration: float = 0.8) -> Plan:
    """All feet hold, and the pelvis lets the right front limb go through straight to the opposite bend.

    Args:
        bend: The angle of its second joint, at the end that with the other sign [rad].
        duration: How long it takes [s].
    """
    robot, feet, held = Robot(Model.load(QUADRUPED)), STEP.positions[:4], range(4)
    climber, way, hip = Climber(robot, KNEES_OUT), np.array([0.8, 0.6]), np.array([0.025, 0.0433])
    time, rows = np.linspace(0.0, duration, 2 * int(50 * duration)), []
    for tau in time / duration:
        angle = Line(np.array(bend), np.array(-bend)).at(tau, duration)[0]
        climber.q[robot.limbs[0].q[1]] = angle
        # Both links are 0.1 m long.
        rows.append(climber.pose(np.array([*(feet[0] - 0.2 * np.cos(angle / 2) * way - hip), 0.0]), feet))
    q = np.array(rows)
    v = np.gradient(q, time, axis=0)
    vd = np.gradient(v, time, axis=0)
    wish, told = climber.centered(held, STEP, held), []
    for now in zip(q, v, vd, strict=True):
        robot.plant.SetPositionsAndVelocities(climber.context, np.concatenate(now[:2]))
        told.append(climber.forces(now[2], held, wish))
    force, torque = (np.array(column) for column in zip(*told, strict=True))
    points, force = np.pad(feet, ((0, 0), (0, 1))), np.pad(force, ((0, 0), (0, 0), (0, 1)))
    phase = Phase(
        kind="shift",
        limb=None,
        stance=0,
        contacts=tuple(PhaseContact(LIMBS[i], i, points[i]) for i in held),
        time=time,
        q=q,
        v=v,
        vd=vd,
        torque=torque,
        force={limb: force[:, i] for i, limb in enumerate(LIMBS)},
    )
    return _plan(STEP.scenario("through straight", STILL_ROBOT), robot, [(0, 1, 2, 3)], [phase])


# The centre of mass is 0.01 mm inside the support interval.
AT_THE_EDGE = Ground(
    positions=np.array([[0.12, 0.15], [-0.12, 0.16], [-0.13, -0.14], [0.12, -0.15]]),
    normals=np.array([[0.0, 1.0]] * 4),
    max_force=3.6,
)
AT_THE_EDGE_PELVIS = (0.0523069, 0.01, 0.05)
# The right front foot is 0.02 mm outside the line from the right rear foot to the left front one.
STRAIGHT = Ground(
    positions=np.array([[0.08663, -0.036], [0.027, 0.228], [-0.139, -0.205], [0.125, -0.206]]),
    normals=np.array([[0.0, 1.0]] * 4),
)
STRAIGHT_JOINTS = (-0.85, -2.01, -1.08, 0.6, 0.07, -0.28, 0.36, -0.62)


def edge_plan() -> Plan:
    """Standing still, about to fall to the right."""
    return still_plan(AT_THE_EDGE, AT_THE_EDGE_PELVIS)


def straight_plan() -> Plan:
    """Standing still, three feet almost in line."""
    return still_plan(STRAIGHT, (0.0, 0.0, -0.02), STRAIGHT_JOINTS)


def retold(plan: Plan, old: str, new: str) -> Plan:
    """The plan with one passage of its scenario's text replaced."""
    assert plan.scenario_text.count(old) == 1
    return replace(plan, scenario_text=plan.scenario_text.replace(old, new))


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


def failing(text: str) -> set[str]:
    """Names of the checks that a plan file fails."""
    return {check.name for check in verify(Plan.from_json(text)).failures}


def plus(amount: float) -> Callable[[float], float]:
    """A change of a number."""
    return lambda value: value + amount


def times(factor: float) -> Callable[[float], float]:
    """A change of a number by a factor."""
    return lambda value: value * factor


def told(old: str, new: str) -> Callable[[str], str]:
    """A change of the scenario's text."""

    def change(text: str) -> str:
        assert text.count(old) == 1
        return text.replace(old, new)

    return change


ERRORS = (
    "friction",
    "push",
    "worst push",
    "opposite push",
    "heavier",
    "lighter",
    "center",
    "worst center",
    "worst place",
    "opposite place",
    "normals",
)


def just_within(plan: Plan, error: str, seed: int) -> Perturbation:
    """An error as great as the plan of a single robot is certified to survive.

    Args:
        plan: The plan.
        error: One of `ERRORS`: the kind of error, and its direction if that is not drawn at random.
        seed: Of what is random.
    """
    (robot,) = plan.robots
    least = {margin.kind: margin for margin in least_by_kind(robot)}
    kinds: dict[str, MarginKind] = {"heavier": "mass", "lighter": "mass", "normals": "normal"}
    way, _, name = error.rpartition(" ")
    kind = kinds.get(name) or cast("MarginKind", name)
    margin = least[kind]
    size = margin.value * (1.0 - 1e-9)
    x, y, z = margin.direction or (1.0, 0.0, 0.0)
    direction = {"": None, "worst": (x, y, z), "opposite": (-x, -y, -z)}[way]
    hold = None
    if kind == "place":
        (hold,) = (contact.hold for contact in robot.phases[margin.phase].contacts if contact.limb == margin.limb)
    return Perturbation.of(kind, -size if name == "lighter" else size, direction, seed, hold)
