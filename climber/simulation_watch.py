"""Who watches a robot in simulation: how far its feet slip, how far it is from its plan, and whether it falls.

A robot has fallen when its pelvis is 50 mm from where it should be, or a holding foot 3 mm off its hold or 2 mm beyond
the edge of its patch. A foot slips by what its contact point moves along the hold after it has taken hold: the path of
the foot's centre less what it rolls, summed up as a vector, so that what it slips back does not count.
"""

from __future__ import annotations

import math

import numpy as np

from climber.controller import Command, Controller
from climber.simulation import RobotRun, Track
from climber.simulation_model import FOOT_RADIUS, World
from climber.stance import Vector
from climber.wall import Wall

OFF = 0.003  # a holding foot so far from its hold has left it [m]
BEYOND = 0.002  # or so far beyond the edge of the patch, rolling of the foot removed [m]
ASTRAY = 0.05  # a pelvis so far from where it should be is falling [m]


class Footing:
    """One foot on one hold, from when it is to hold until it lets go.

    Attributes:
        slip: How far its contact point is from where it took hold, along the hold [m].
        lost: Whether it has left the hold.
    """

    def __init__(self, wall: Wall, number: int) -> None:
        """A foot that is about to take hold of hold `number`."""
        self._hold, self._center = wall.holds[number], wall.positions[number]
        self._axes = np.array([wall.tangents[number], wall.binormals[number], wall.normals[number]])
        # Times the angular velocity: how fast the contact point moves by turning, along the tangent and the binormal.
        self._roll = FOOT_RADIUS * np.array([-wall.binormals[number], wall.tangents[number]])
        self.slip, self.lost = 0.0, False
        self._taken: tuple[float, float, float] | None = None  # where the foot took hold, in the hold's axes
        self._rolled = (0.0, 0.0)  # by how much the contact point has moved since by turning

    def look(self, place: Vector, turning: Vector, step: float) -> None:
        """Looks at the foot after a step of `step` [s].

        Args:
            place: Where its centre is in W [m], shape (3,).
            turning: Its angular velocity [rad/s], shape (3,).
            step: How long it has turned so [s].
        """
        s, t, gap = (self._axes @ (place - self._center)).tolist()
        if self._hold.grip == "pin":
            self._taken = self._taken or (s, t, gap)
            self.slip = math.dist((s, t, gap), self._taken)
            self.lost = self.slip > OFF
            return
        rolled_s, rolled_t = self._rolled
        self.lost = gap > OFF or math.hypot(s + rolled_s, t + rolled_t) > self._hold.half_width + BEYOND
        if self._taken is None:
            if gap <= 0.0:
                self._taken = (s, t, gap)
            return
        going_s, going_t = (self._roll @ turning).tolist()
        self._rolled = rolled_s, rolled_t = rolled_s + step * going_s, rolled_t + step * going_t
        self.slip = math.hypot(s - self._taken[0] + rolled_s, t - self._taken[1] + rolled_t)


class Watch:
    """Looks after one robot: what it did, how far its feet slipped, and whether it fell."""

    def __init__(self, number: int, controller: Controller, world: World) -> None:
        self.number, self.controller, self._world = number, controller, world
        self.fell = self.slipped = ""
        self.slip = self.pelvis_error = self.joint_error = 0.0
        self._torque = np.zeros(len(controller.robot.joint_names))
        self._footings: dict[int, Footing] = {}  # by limb that holds
        self._rows: list[tuple[float, int, Vector, Vector, Vector, Vector]] = []

    def enter(self) -> None:
        """A phase begins: a limb that lets go is not watched any more."""
        holding = self.controller.touches
        self._footings = {limb: footing for limb, footing in self._footings.items() if limb in holding}

    def record(self, now: float, q: Vector, v: Vector, command: Command) -> None:
        """Takes down what the robot does."""
        self._rows.append((now, self.controller.phase, q, v, command.torque, command.force))

    def look(self, now: float, command: Command) -> None:
        """Looks at the robot after a step."""
        controller = self.controller
        np.maximum(self._torque, np.abs(command.torque), out=self._torque)
        astray = math.hypot(*controller.error[controller.robot.origin_q].tolist())
        self.pelvis_error = max(self.pelvis_error, astray)
        free = controller.error[controller.free_joints].tolist()
        self.joint_error = max(self.joint_error, *map(abs, free), 0.0)
        if not astray < ASTRAY:
            self.fell = f"the pelvis is {1e3 * astray:.0f} mm from where it should be at {now:.2f} s"
        for limb, (hold, _) in controller.touches.items():
            self._look_at(limb, hold, now)

    def _look_at(self, limb: int, number: int, now: float) -> None:
        world = self._world
        footing = self._footings.get(limb)
        if footing is None:
            footing = self._footings[limb] = Footing(world.wall, number)
        footing.look(*world.foot(self.number, limb), world.time_step)
        name = self.controller.robot.limbs[limb].name
        if footing.lost:
            self.fell = self.fell or f"{name} has left hold {number} at {now:.2f} s"
        if footing.slip > self.slip:
            self.slip, self.slipped = footing.slip, f"{name} on hold {number} at {now:.2f} s"

    def result(self) -> RobotRun:
        """What came of it."""
        robot = self.controller.robot
        limbs = len(robot.limb_names)
        sizes = (), (), (len(robot.position_names),), (len(robot.velocity_names),), self._torque.shape, (limbs, 3)
        columns = [  # a robot that cannot even begin has no rows
            np.array([row[i] for row in self._rows]).reshape(len(self._rows), *size) for i, size in enumerate(sizes)
        ]
        return RobotRun(
            name=self.controller.reference.plan.name,
            limbs=robot.limb_names,
            positions=robot.position_names,
            velocities=robot.velocity_names,
            fell=self.fell,
            slip=self.slip,
            slipped=self.slipped,
            pelvis_error=self.pelvis_error,
            joint_error=self.joint_error,
            torque=dict(zip(robot.joint_names, self._torque.tolist(), strict=True)),
            effort=dict(zip(robot.joint_names, robot.effort.tolist(), strict=True)),
            track=Track(*columns),
        )
