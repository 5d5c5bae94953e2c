"""The loop of a simulation: controllers, world, watches and the plan's clock in turn."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from climber.controller import Controller
from climber.dynamics import Sampler
from climber.exceptions import PlanFileError
from climber.plan_file import Plan
from climber.reference import Reference
from climber.robot import Model, Robot
from climber.scenario import scenario_from_text
from climber.simulation import Perturbation, in_ball
from climber.simulation_model import Touch, World
from climber.simulation_watch import Watch
from climber.stance import Vector

STUCK = 2.0  # the plan's clock may stand still for so long [s]
SETTLE = 0.2  # how long the robots are watched after the plan's end [s]
CATCH_UP = 0.1  # time in which the clock goes from standing to its full pace [s]
TOUCH = 1e-5  # a foot so near to its hold has reached it [m]
# A foot that is farther off its hold at the end of its swing makes the clock stop; nearer it approaches slower [m].
NEAR = 0.0002
NEAR_PIN = 0.001  # likewise one that is to grip a pin: it has to meet it in every direction [m]
LATE = 0.06  # by how much the clock may pass the end of a swing before the foot has reached its hold [s]
GROWING = 0.5  # time in which a push, and weight that is not the model's, come on before the plan begins [s]
RECORD = 100.0  # samples of a recording [Hz]


class Setting:
    """What a plan is simulated with: its wall, its robots and what they are to do.

    Attributes:
        plan: The plan.
        wall: The wall that was planned for.
        references: What each robot is to do.
    """

    def __init__(self, plan: Plan) -> None:
        """Reads the scenario within the plan and the models.

        Raises:
            ClimberError: If they cannot be read, or the plan does not go with them.
        """
        folder = Path(plan.scenario_path).absolute().parent
        scenario = scenario_from_text(plan.scenario_text, plan.scenario_path, folder)
        self.plan, self.wall = plan, scenario.build_wall()
        robots = [Robot(Model.load(part.model, folder), self.wall.gravity) for part in plan.robots]
        self.references = [Reference(part, robot) for part, robot in zip(plan.robots, robots, strict=True)]
        holds = len(self.wall.holds)
        for number, part in enumerate(plan.robots):
            for j, phase in enumerate(part.phases):
                for k, contact in enumerate(phase.contacts):
                    if contact.hold >= holds:
                        raise PlanFileError(
                            f"robots[{number}].phases[{j}].contacts[{k}].hold: given {contact.hold}; allowed: 0 to "
                            f"{holds - 1}"
                        )

    @property
    def duration(self) -> float:
        """How long the plan takes [s]."""
        return max(robot.duration for robot in self.plan.robots)


class Loop:
    """A climb in simulation.

    Attributes:
        elapsed: Time since it began [s].
        clock: Time of the plan that it has come to [s].
        watches: Who looks after the robots.
        world: The world.
    """

    def __init__(self, setting: Setting, perturbation: Perturbation, time_step: float) -> None:
        robots = [reference.robot for reference in setting.references]
        wall = perturbation.wall(setting.wall, max(robot.dimension for robot in robots))
        moved = wall.positions - setting.wall.positions
        self._moved = moved
        pins = {
            self._touch(number, limb, hold, point)
            for number, reference in enumerate(setting.references)
            for limb, hold, point in reference.contacts()
            if wall.holds[hold].grip == "pin"
        }
        self.world = World(wall, robots, sorted(pins, key=str), time_step, perturbation.mass_scale)
        controllers = [Controller(reference, setting.wall, time_step) for reference in setting.references]
        self.watches = [Watch(i, controller, self.world) for i, controller in enumerate(controllers)]
        self._heavier = perturbation.mass_scale != 1.0 or perturbation.center_error > 0.0
        self._growing = GROWING if perturbation.push or self._heavier else 0.0
        self._end, self.clock = max(controller.last for controller in controllers), controllers[0].begin
        self.elapsed, self._quicker, self._stood, self._over = 0.0, 0.0, 0.0, 0.0
        self._rate = 0.0 if self._growing else 1.0
        rng = np.random.default_rng([perturbation.seed, 1])
        ways = [perturbation.toward(rng, robot.dimension) for robot in robots]
        self._pushes = [perturbation.push * way for way in ways]
        postures = [self._posture(watch, perturbation.start_error, rng) for watch in self.watches]
        self.world.place(postures)
        for controller, q in zip(controllers, postures, strict=True):
            controller.start(q)
        if perturbation.center_error > 0.0:
            for number, way in enumerate(ways):
                self.world.displace_center(number, perturbation.center_error * np.pad(way, (0, 3 - len(way))))
        self._touch_all()

    def _touch(self, robot: int, limb: int, hold: int, point: Vector) -> Touch:
        x, y, z = (point + self._moved[hold]).tolist()
        return Touch(robot, limb, hold, (x, y, z))

    def _touch_all(self) -> None:
        self.world.touch(
            [
                self._touch(watch.number, limb, hold, point)
                for watch in self.watches
                for limb, (hold, point) in watch.controller.touches.items()
            ]
        )

    def _posture(self, watch: Watch, error: float, rng: np.random.Generator) -> Vector:
        """The posture that the plan begins with, its pelvis displaced, its feet on the holds as they really are.

        They press on these as they do in the plan: feet that had yet to meet their holds would slide till they do.
        """
        controller = watch.controller
        robot, desired = controller.robot, controller.reference.at(0, controller.begin)
        q = desired.q.copy()
        q[robot.origin_q] += error * in_ball(rng, len(robot.origin_q))
        q[robot.angle_q] += 10.0 * error * in_ball(rng, len(robot.angle_q))
        touches = controller.touches
        pressed = [self.world.pressed(hold, desired.force[limb]) for limb, (hold, _) in touches.items()]
        goals = pressed + np.array([point + self._moved[hold] for hold, point in touches.values()])
        sampler = Sampler(robot, list(touches))
        axes = robot.dimension
        J = np.empty((sampler.num_rows, len(robot.velocity_names)))
        ease = np.ones(J.shape[1])
        ease[robot.base_v] = 1e-4  # limbs give way to the pelvis
        for _ in range(30):
            sampler.plant.SetPositions(sampler.context, q)
            miss = (goals - robot.foot_positions(sampler.context)[list(touches)])[:, :axes].ravel()
            if np.abs(miss).max() < 1e-9:
                break
            sampler.J(J)
            eased = ease[:, None] * J.T
            q += robot.qdot(q, eased @ np.linalg.solve(J @ eased + 1e-12 * np.eye(len(J)), miss))
        if np.abs(miss).max() > 1e-4:
            watch.fell = f"its feet do not reach the holds that it is to begin on, by {1e3 * np.abs(miss).max():.1f} mm"
        return q

    @property
    def going(self) -> bool:
        """Whether there is more to come."""
        return self._over < SETTLE and not any(watch.fell for watch in self.watches)

    def step(self) -> None:
        """Commands, one step of the world, a look at it, and the clock."""
        world, commands = self.world, []
        for watch, (q, v) in zip(self.watches, world.state(), strict=True):
            controller = watch.controller
            toward = self._toward(watch) if controller.landing else None
            command = controller.command(self.clock, self._rate, self._quicker, q, v, toward)
            commands.append(command)
            if round(self.elapsed / world.time_step) % round(1.0 / (RECORD * world.time_step)) == 0:
                watch.record(self.elapsed, q, v, command)
        world.step(
            [
                command.applied + self._disturbed(watch, push)
                for watch, command, push in zip(self.watches, commands, self._pushes, strict=True)
            ]
        )
        self.elapsed += world.time_step
        for watch, command in zip(self.watches, commands, strict=True):
            watch.look(self.elapsed, command)
        self._tick()

    def _disturbed(self, watch: Watch, push: Vector) -> Vector:
        """The push on a robot, and the hand that still carries what its weight is not the model's, shape (nv,)."""
        controller = watch.controller
        if not self._growing:
            return np.zeros(len(controller.robot.velocity_names))
        grown = min(self.elapsed / GROWING, 1.0)
        more = self.world.weight(watch.number) - controller.weight if self._heavier and grown < 1.0 else 0.0
        return controller.pushed(grown * push) - (1.0 - grown) * more

    def _toward(self, watch: Watch) -> Vector | None:
        """How a limb that ended its swing off its hold has to go on in W, shape (3,): 1 long, less when near.

        None if it has reached its hold.
        """
        way = self._way(watch)
        left = math.hypot(*way.tolist())
        return way / max(left, NEAR_PIN if self._grips_pin(watch) else NEAR) if left > TOUCH else None

    def _way(self, watch: Watch) -> Vector:
        """From the foot of the limb that is to take hold to its hold in W [m], shape (3,).

        It feels its way to a pin in every direction that it moves in, and to other holds along their normals.
        """
        controller, wall, way = watch.controller, self.world.wall, np.zeros(3)
        if controller.arriving is None:
            return way
        limb, hold = controller.arriving
        place, _ = self.world.foot(watch.number, limb)
        axes, off = controller.robot.dimension, place - wall.positions[hold]
        if self._grips_pin(watch):
            way[:axes] = -off[:axes]
            return way
        way -= float(wall.normals[hold] @ off) * controller.wall.normals[hold]
        return way

    def _grips_pin(self, watch: Watch) -> bool:
        """Whether the limb that is to take hold does so on a pin."""
        arriving = watch.controller.arriving
        return arriving is not None and self.world.wall.holds[arriving[1]].grip == "pin"

    def _tick(self) -> None:
        """The plan's clock goes on, as fast as the tracking allows, and phases change.

        Where a foot has yet to find its hold the clock stops, gently, for the sake of other robots on their way.
        """
        step = self.world.time_step
        lost = any(watch.controller.landing and math.hypot(*self._way(watch).tolist()) > NEAR for watch in self.watches)
        pace = 0.0 if lost or self.elapsed < self._growing else min(watch.controller.pace for watch in self.watches)
        change = min(max(pace - self._rate, -step / CATCH_UP), step / CATCH_UP)
        rate = min(max(self._rate + change, 0.0), 1.0)
        limit = min([self._end, *(watch.controller.end + LATE for watch in self.watches if not watch.controller.done)])
        after = min(self.clock + rate * step, limit)
        standing = after <= self.clock
        self._rate, self._quicker = (0.0, 0.0) if standing else (rate, change / step)
        self._stood = self._stood + step if standing else 0.0
        self.clock = after
        changed = False
        for watch in self.watches:
            if not watch.controller.done and self.clock >= watch.controller.end:
                watch.controller.landing = self._toward(watch) is not None
                if not watch.controller.landing:
                    watch.controller.advance()
                    watch.enter()
                    changed = True
        if changed:
            self._touch_all()
            self._stood = 0.0
        if self.clock >= self._end:
            self._over += step
        elif self._stood > STUCK:
            for watch in self.watches:
                watch.fell = f"the clock stands still at {self.clock:.2f} s of the plan: {watch.controller.waiting}"
