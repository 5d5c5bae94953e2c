"""The world that a plan is simulated in: the robots and the holds in one Drake plant with discrete contact.

A foot is a small sphere about the origin of its frame, or as far as Drake is concerned several in the same place: where
a foot should stick, Drake's friction lets it creep in proportion to what a point of contact carries, and so they share
it. A hold is a thin box below its patch, lowered by the radius of the spheres, so that a foot that stands on the patch
has its centre there, as in the plan. Friction is the hold's own.
A pin is a ball joint that is closed while it is gripped, and a magnet pulls the foot that is on it. Nothing else
touches: limbs, pelvis and obstacles have no shapes here, since what a plan says of clearances `climber.verify` checks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
    ProximityProperties,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import ContactModel, CoulombFriction, DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyConstraintId, RigidBody, SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from climber.robot import Robot
from climber.stance import Vector
from climber.wall import Hold, Wall

FOOT_RADIUS = 0.0001  # little, as a foot that rolls is not where the plan has it [m]
THICKNESS = 0.004  # of the boxes [m]
RIM = 0.004  # the box reaches this far beyond the patch, so that a foot at its edge, or rolled off it, is on it [m]
DEPTH = 0.005  # least half extent of the box across the wall plane [m]
STEPS = 4  # of the plant to one of the controllers
# Spheres of a foot, all in one place: feet that should stick creep in proportion to what one sphere carries. By the
# axes that robots move in: in space they press harder on their holds, and longer.
POINTS = {2: 4, 3: 8}
# Of a foot's spheres together, and of a hold [N/m]; one gives way after the other. Friction within a step is bounded by
# the force along the normal at its beginning. Joints turn in the step, which brings the foot nearer or farther by some
# 0.06 um at 0.12 mm/s; that must be little beside the overlap, and the speed little beside the inverse of the
# dissipation, or friction is a few per cent less than it should be.
STIFFNESS = 1e6
DISSIPATION = 20.0  # of a contact [s/m]: an overlap goes down no faster than its inverse, or feet would bounce
STICTION = 1e-5  # foot that slips slower is held by as much less than friction could [m/s]


@dataclass(frozen=True)
class Touch:
    """A foot on a hold, or about to be.

    Attributes:
        robot: Index of the robot.
        limb: Index of the limb.
        hold: Number of the hold.
        point: Where the plan has the foot, in W [m], (x, y, z).
    """

    robot: int
    limb: int
    hold: int
    point: tuple[float, float, float]


class World:
    """Robots and holds in contact, stepped in time.

    Attributes:
        robots: The robots; their own plants have no contact.
        wall: The wall as it really is, holds displaced and friction scaled.
        time_step: From one command to the next [s]; the plant's own steps are shorter.
        plant: The plant that holds them all.
    """

    def __init__(
        self,
        wall: Wall,
        robots: Sequence[Robot],
        pins: Sequence[Touch],
        time_step: float,
        mass_scale: float = 1.0,
    ) -> None:
        """Builds the plant.

        Args:
            wall: The wall as it really is.
            robots: The robots.
            pins: Every grip on a pin that there will ever be; its point is where the pin's ball is.
            time_step: From one command to the next [s].
            mass_scale: Masses and inertias of all bodies, relative to the models'.
        """
        self.wall, self.robots, self.time_step = wall, tuple(robots), time_step
        builder: Any = DiagramBuilder()
        self.plant = builder.AddSystem(MultibodyPlant(time_step / STEPS))
        self._scene_graph = builder.AddSystem(SceneGraph())
        # Models first, geometry after: only what is added by hand can touch.
        self._instances = [robot.model.add_to(self.plant, None, f"robot_{i}") for i, robot in enumerate(robots)]
        self.plant.RegisterAsSourceForSceneGraph(self._scene_graph)
        self.plant.set_contact_model(ContactModel.kPoint)
        self.plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
        self.plant.set_stiction_tolerance(STICTION)
        self.plant.SetUseSampledOutputPorts(False)
        self.plant.mutable_gravity_field().set_gravity_vector(wall.gravity)
        self._points = POINTS[max(robot.dimension for robot in robots)]
        frames = [
            [self.plant.GetFrameByName(limb.foot, instance) for limb in robot.limbs]
            for robot, instance in zip(robots, self._instances, strict=True)
        ]
        self._frames = frames
        slippery = _Friction(wall)
        self._feet = [
            [self._add_foot(frame, f"foot_{i}_{j}", slippery.foot) for j, frame in enumerate(row)]
            for i, row in enumerate(frames)
        ]
        self._holds = [self._add_hold(hold, number, slippery.of(hold)) for number, hold in enumerate(wall.holds)]
        self._pins = self._add_pins(pins)
        self.plant.Finalize()
        builder.Connect(self._scene_graph.get_query_output_port(), self.plant.get_geometry_query_input_port())
        builder.Connect(
            self.plant.get_geometry_pose_output_port(),
            self._scene_graph.get_source_pose_port(self.plant.get_source_id()),
        )
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self._root)
        self._filters = self._scene_graph.collision_filter_manager(
            self._scene_graph.GetMyMutableContextFromRoot(self._root)
        )
        if mass_scale != 1.0:
            self._scale_masses(mass_scale)
        self._applied = self.plant.get_applied_generalized_force_input_port().FixValue(
            self.context, np.zeros(self.plant.num_velocities())
        )
        self._q = [self._places(robot.position_names, i, positions=True) for i, robot in enumerate(self.robots)]
        self._v = [self._places(robot.velocity_names, i, positions=False) for i, robot in enumerate(self.robots)]
        self.touch([])

    def _add_foot(self, frame: Any, name: str, friction: float) -> list[GeometryId]:
        pose, properties = frame.GetFixedPoseInBodyFrame(), _material(friction, self._points)
        add, sphere = self.plant.RegisterCollisionGeometry, Sphere(FOOT_RADIUS)
        return [add(frame.body(), pose, sphere, f"{name}_{k}", properties) for k in range(self._points)]

    def _add_hold(self, hold: Hold, number: int, friction: float) -> GeometryId:
        along, out = self.wall.tangents[number], self.wall.normals[number]
        R_WH = RotationMatrix(np.column_stack([along, out, np.cross(along, out)]))
        p_WH = self.wall.positions[number] - (FOOT_RADIUS + THICKNESS / 2) * out
        half = hold.half_width + RIM
        box = Box(2 * half, THICKNESS, 2 * max(half, DEPTH))
        body = self.plant.world_body()
        properties = _material(friction, self._points)
        return self.plant.RegisterCollisionGeometry(body, RigidTransform(R_WH, p_WH), box, f"hold_{number}", properties)

    def _add_pins(self, pins: Sequence[Touch]) -> dict[Touch, MultibodyConstraintId]:
        """A ball joint for each, to a body welded to the world: Drake's ball constraint does not take the world."""
        if not pins:
            return {}
        inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.01)
        pegs: RigidBody = self.plant.AddRigidBody("pegs", self.plant.AddModelInstance("pegs"), inertia)
        self.plant.WeldFrames(self.plant.world_frame(), pegs.body_frame())
        result = {}
        for pin in pins:
            frame = self._frames[pin.robot][pin.limb]
            foot = frame.GetFixedPoseInBodyFrame().translation()
            result[pin] = self.plant.AddBallConstraint(frame.body(), foot, pegs, np.array(pin.point))
        return result

    def _scale_masses(self, scale: float) -> None:
        for instance in self._instances:
            for index in self.plant.GetBodyIndices(instance):
                body = self.plant.get_body(index)
                inertia = body.CalcSpatialInertiaInBodyFrame(self.context)
                scaled = SpatialInertia(scale * inertia.get_mass(), inertia.get_com(), inertia.get_unit_inertia())
                body.SetSpatialInertiaInBodyFrame(self.context, scaled)

    def displace_center(self, robot: int, displacement: Vector) -> None:
        """Displaces a robot's centre of mass in W as it stands [m], shape (3,), fixed to its pelvis from then on.

        The pelvis's body moves, as heavy as it is, so far that the whole robot's centre does by that much.
        """
        name = self.robots[robot].pelvis.name()
        pelvis = self.plant.GetBodyByName(name, self._instances[robot])
        inertia = pelvis.CalcSpatialInertiaInBodyFrame(self.context)
        mass, whole = inertia.get_mass(), self.plant.CalcTotalMass(self.context, [self._instances[robot]])
        turned = pelvis.EvalPoseInWorld(self.context).rotation().inverse().multiply(displacement)
        center = inertia.get_com() + whole / mass * turned
        about_center = inertia.get_unit_inertia().ShiftToCenterOfMass(inertia.get_com())
        displaced = SpatialInertia(mass, center, about_center.ShiftFromCenterOfMass(center))
        pelvis.SetSpatialInertiaInBodyFrame(self.context, displaced)

    def weight(self, robot: int) -> Vector:
        """A robot's weight as generalised forces [N, N m], as in its own plant, shape (nv,)."""
        every = self.plant.CalcGravityGeneralizedForces(self.context)
        return np.asarray(every[self._v[robot]])

    def _places(self, names: Sequence[str], robot: int, *, positions: bool) -> Vector:
        """Where a robot's positions or velocities, named as in its own plant, are in this one."""
        instance = self._instances[robot]
        if positions:
            known = self.plant.GetPositionNames(instance, False, False)
            every = self.plant.GetPositionsFromArray(instance, np.arange(float(self.plant.num_positions())))
        else:
            known = self.plant.GetVelocityNames(instance, False, False)
            every = self.plant.GetVelocitiesFromArray(instance, np.arange(float(self.plant.num_velocities())))
        return np.array([int(every[list(known).index(name)]) for name in names])

    def touch(self, touches: Sequence[Touch]) -> None:
        """Lets these feet touch these holds, closes these pins, and lets nothing else touch or hold."""
        feet = GeometrySet([point for row in self._feet for foot in row for point in foot])
        declaration = CollisionFilterDeclaration().ExcludeBetween(feet, GeometrySet(self._holds)).ExcludeWithin(feet)
        for touch in touches:
            if self.wall.holds[touch.hold].grip != "pin":
                foot = GeometrySet(self._feet[touch.robot][touch.limb])
                declaration.AllowBetween(foot, GeometrySet([self._holds[touch.hold]]))
        self._filters.Apply(declaration)
        self._pulls = [
            (
                self._frames[touch.robot][touch.limb],
                -self.wall.holds[touch.hold].adhesion * self.wall.normals[touch.hold],
            )
            for touch in touches
            if self.wall.holds[touch.hold].adhesion > 0.0
        ]
        for pin, constraint in self._pins.items():
            self.plant.SetConstraintActiveStatus(self.context, constraint, pin in touches)

    def pressed(self, hold: int, force: Vector) -> Vector:
        """How far a foot at rest is moved by a force of the hold on it, in W [N], as their contact gives way [m]."""
        if self.wall.holds[hold].grip == "pin":
            return np.zeros(3)
        normal: Vector = self.wall.normals[hold]
        press = float(normal @ force) + self.wall.holds[hold].adhesion
        return -max(press, 0.0) / (STIFFNESS / 2) * normal

    def place(self, q: Sequence[Vector]) -> None:
        """Puts the robots into postures, at rest; positions as in their own plants."""
        every = self.plant.GetPositions(self.context)
        for places, mine in zip(self._q, q, strict=True):
            every[places] = mine
        self.plant.SetPositions(self.context, every)
        self.plant.SetVelocities(self.context, np.zeros(self.plant.num_velocities()))

    def state(self) -> list[tuple[Vector, Vector]]:
        """Positions and velocities of each robot, as in its own plant."""
        every = self.plant.GetPositionsAndVelocities(self.context)
        q, v = every[: self.plant.num_positions()], every[self.plant.num_positions() :]
        return [(q[mine], v[yours]) for mine, yours in zip(self._q, self._v, strict=True)]

    def step(self, forces: Sequence[Vector]) -> None:
        """Goes on by one time step under generalised forces of each robot [N, N m], shape (nv,) each."""
        every = np.zeros(self.plant.num_velocities())
        for places, mine in zip(self._v, forces, strict=True):
            every[places] = mine
        for frame, pull in self._pulls:
            every += self._jacobian(frame).T @ pull
        self._applied.GetMutableData().get_mutable_value().set_value(every)
        for _ in range(STEPS):
            self._root.SetDiscreteState(self._diagram.EvalUniquePeriodicDiscreteUpdate(self._root))

    def _jacobian(self, frame: Any) -> Vector:
        """Of the origin of a frame by the plant's velocities, shape (3, nv)."""
        world, origin = self.plant.world_frame(), np.zeros(3)
        wrt = JacobianWrtVariable.kV
        result: Vector = self.plant.CalcJacobianTranslationalVelocity(self.context, wrt, frame, origin, world, world)
        return result

    def foot(self, robot: int, limb: int) -> tuple[Vector, Vector]:
        """Place of a foot's centre in W [m] and its angular velocity [rad/s], shape (3,) each."""
        frame = self._frames[robot][limb]
        turning = frame.CalcSpatialVelocityInWorld(self.context).rotational()
        return frame.CalcPoseInWorld(self.context).translation(), turning


class _Friction:
    """Coefficients of feet and holds such that Drake's combination of the two is the hold's own.

    Drake combines m_1 and m_2 to 2 m_1 m_2 / (m_1 + m_2). With the feet rougher than every hold, m_2 follows.
    """

    def __init__(self, wall: Wall) -> None:
        self.foot = 1.0 + max(hold.friction for hold in wall.holds)

    def of(self, hold: Hold) -> float:
        return hold.friction * self.foot / (2 * self.foot - hold.friction)


def _material(friction: float, points: int) -> ProximityProperties:
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=DISSIPATION,
        point_stiffness=STIFFNESS / points,
        friction=CoulombFriction(friction, friction),
        properties=properties,
    )
    return properties
