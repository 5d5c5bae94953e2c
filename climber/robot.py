"""The robot: a Drake plant in the wall frame, and what the planner asks of it.

Everything is read from the model (URDF or SDF) and from a small YAML file of the same stem beside it, which names the
pelvis, the limbs with their feet in counter-clockwise order, and the robot's symmetries. The plant's world frame is
the wall frame W, so an inclined wall only changes the plant's gravity vector.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydrake.geometry import SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, PlanarJoint, RevoluteJoint
from pydrake.systems.framework import Context

from climber.exceptions import ModelError
from climber.resources import package_map, resolve_model
from climber.stance import Vector
from climber.wall import GRAVITY

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Limb:
    """A serial chain of revolute joints from the pelvis to a point foot.

    Attributes:
        name: The limb's name, as scenarios use it.
        foot: Name of the foot's frame in the model; the foot is its origin.
        joints: Names of the joints from the pelvis outwards.
        q: Places of the joints in the plant's positions, shape (num_joints,).
        v: Places of the joints in the plant's velocities, shape (num_joints,).
        lower: Lower position limits [rad], shape (num_joints,).
        upper: Upper position limits [rad], shape (num_joints,).
        velocity: Velocity limits [rad/s], shape (num_joints,).
        effort: Effort limits [N m], shape (num_joints,).
        reach: Farthest that the foot can be from the pelvis's origin [m].
    """

    name: str
    foot: str
    joints: tuple[str, ...]
    q: Indices
    v: Indices
    lower: Vector
    upper: Vector
    velocity: Vector
    effort: Vector
    reach: float


@dataclass(frozen=True)
class Model:
    """A robot model as found on disk: the file Drake parses and the description beside it.

    Attributes:
        source: What the user wrote, a `package://` URL or a path.
        path: The model file.
        pelvis: Name of the body that carries the limbs.
        feet: Name of each limb's foot frame by limb name, in limb order.
        symmetries: Limb orders, each naming the limb that takes the place of each limb, that leave the robot the same.
    """

    source: str
    path: Path
    pelvis: str
    feet: dict[str, str]
    symmetries: tuple[tuple[str, ...], ...] = ()

    @classmethod
    def load(cls, source: str | Path, relative_to: Path | None = None) -> Model:
        """Reads the description beside a model.

        Args:
            source: A `package://climber/...` URL or a path to a URDF or SDF file.
            relative_to: The folder that a relative path starts from; the working directory by default.

        Raises:
            ModelError: If a file is missing or the description does not say what it must.
        """
        path = resolve_model(str(source), relative_to)
        beside = path.with_suffix(".yaml")
        if not path.is_file():
            raise ModelError(f"{path}: no such robot model (given as {source})")
        if not beside.is_file():
            raise ModelError(f"{beside}: missing; it must name the pelvis, the limbs and their feet of {path.name}")
        try:
            raw: Any = yaml.safe_load(beside.read_text())
            limbs = {str(limb["name"]): str(limb["foot"]) for limb in raw["limbs"]}
            symmetries = tuple(tuple(str(name) for name in order) for order in raw.get("symmetries") or ())
            pelvis = str(raw["pelvis"])
        except (yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
            raise ModelError(
                f"{beside}: expected `pelvis: body`, `limbs: [{{name, foot}}, ...]` and optionally "
                f"`symmetries: [[limb, ...], ...]`; {type(error).__name__}: {error}"
            ) from error
        for order in symmetries:
            if sorted(order) != sorted(limbs):
                raise ModelError(f"{beside}: symmetries: {list(order)} must name each of {list(limbs)} once")
        return cls(str(source), path, pelvis, limbs, symmetries)

    def add_to(
        self, plant: MultibodyPlant, scene_graph: SceneGraph | None = None, name: str | None = None
    ) -> ModelInstanceIndex:
        """Parses the model into a plant that is not yet finalised, under the instance name `name` if given."""
        parser = Parser(plant, scene_graph) if scene_graph is not None else Parser(plant)
        parser.package_map().AddMap(package_map())
        if name is not None:
            parser.SetAutoRenaming(True)
        try:
            (instance,) = parser.AddModels(str(self.path))
        except (RuntimeError, ValueError) as error:
            raise ModelError(f"{self.path}: Drake cannot read this model: {error}") from error
        if name is not None:
            plant.RenameModelInstance(instance, name)
        return instance


class Robot:
    """A model in a plant of its own, finalised, with gravity as the wall's inclination has it.

    Attributes:
        model: Where it came from.
        plant: The plant; its world frame is the wall frame W.
        pelvis: The pelvis's body.
        limbs: The limbs in limb order.
        mass: Total mass [kg].
        gravity: Gravity in W [m/s^2], shape (3,).
        planar: Whether the pelvis moves in W's x-y plane only.
        symmetries: Limb permutations, the identity first: limb `i` takes the place of limb `permutation[i]`.
        position_names: Name of each position, in the plant's order.
        velocity_names: Name of each velocity, in the plant's order.
    """

    def __init__(self, model: Model | str | Path, gravity: Sequence[float] | Vector = (0.0, -GRAVITY, 0.0)) -> None:
        self.model = model if isinstance(model, Model) else Model.load(model)
        self.gravity: Vector = np.asarray(gravity, dtype=float)
        self.plant = MultibodyPlant(0.0)
        instance = self.model.add_to(self.plant)
        self.plant.mutable_gravity_field().set_gravity_vector(self.gravity)
        self.plant.Finalize()
        self.name = self.plant.GetModelInstanceName(instance)
        if not self.plant.HasBodyNamed(self.model.pelvis):
            raise ModelError(f"{self.model.path}: no body is named {self.model.pelvis!r}, which should be the pelvis")
        self.pelvis = self.plant.GetBodyByName(self.model.pelvis)
        self._parents = {joint.child_body().index(): joint for joint in self._joints()}
        base = self._parents[self.pelvis.index()]
        self.planar = isinstance(base, PlanarJoint)
        self.base_q = np.arange(base.position_start(), base.position_start() + base.num_positions())
        self.base_v = np.arange(base.velocity_start(), base.velocity_start() + base.num_velocities())
        self.mass = float(self.plant.CalcTotalMass(self.plant.CreateDefaultContext()))
        self.position_names = tuple(self.plant.GetPositionNames(instance, False, False))
        self.velocity_names = tuple(self.plant.GetVelocityNames(instance, False, False))
        self.limbs = tuple(self._limb(name, foot) for name, foot in self.model.feet.items())
        names = [limb.name for limb in self.limbs]
        identity = tuple(range(len(names)))
        declared = (tuple(names.index(name) for name in order) for order in self.model.symmetries)
        self.symmetries = (identity, *(order for order in declared if order != identity))

    def _joints(self) -> list[Joint]:
        return [self.plant.get_joint(index) for index in self.plant.GetJointIndices()]

    def chain(self, foot: str) -> list[Joint]:
        """The joints, fixed ones too, from the pelvis out to the body that carries the frame `foot`."""
        if not self.plant.HasFrameNamed(foot):
            raise ModelError(f"{self.model.path}: no frame is named {foot!r}, which should be a foot")
        joints: list[Joint] = []
        body = self.plant.GetFrameByName(foot).body()
        while body.index() != self.pelvis.index():
            joint = self._parents.get(body.index())
            if joint is None or body.index() == self.plant.world_body().index():
                raise ModelError(f"{self.model.path}: the foot {foot!r} does not hang from the pelvis")
            joints.append(joint)
            body = joint.parent_body()
        return joints[::-1]

    def _limb(self, name: str, foot: str) -> Limb:
        chain = self.chain(foot)
        joints = [joint for joint in chain if joint.num_positions()]
        for joint in joints:
            if not isinstance(joint, RevoluteJoint):
                raise ModelError(f"{self.model.path}: joint {joint.name()!r} is {joint.type_name()}; limbs revolve only")
        # The pieces between successive joint axes; no chain reaches farther than their lengths together.
        frames = [joint.frame_on_child() for joint in joints] + [self.plant.GetFrameByName(foot)]
        context = self.plant.CreateDefaultContext()
        points = [self.pelvis.EvalPoseInWorld(context).translation()]
        points += [frame.CalcPoseInWorld(context).translation() for frame in frames]
        actuators = {
            self.plant.get_joint_actuator(index).joint().name(): self.plant.get_joint_actuator(index).effort_limit()
            for index in self.plant.GetJointActuatorIndices()
        }
        return Limb(
            name=name,
            foot=foot,
            joints=tuple(joint.name() for joint in joints),
            q=np.array([joint.position_start() for joint in joints], dtype=np.int64),
            v=np.array([joint.velocity_start() for joint in joints], dtype=np.int64),
            lower=np.array([joint.position_lower_limit() for joint in joints]),
            upper=np.array([joint.position_upper_limit() for joint in joints]),
            velocity=np.array([joint.velocity_upper_limit() for joint in joints]),
            effort=np.array([actuators.get(joint.name(), 0.0) for joint in joints]),
            reach=float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()),
        )

    @property
    def limb_names(self) -> tuple[str, ...]:
        """The limbs' names in limb order."""
        return tuple(limb.name for limb in self.limbs)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """All actuated limb joints, limb by limb."""
        return tuple(joint for limb in self.limbs for joint in limb.joints)

    @property
    def reach(self) -> Vector:
        """Each limb's reach from the pelvis's origin [m], shape (num_limbs,)."""
        return np.array([limb.reach for limb in self.limbs])

    @cached_property
    def joint_v(self) -> Indices:
        """Places of `joint_names` in the plant's velocities, shape (num_joints,)."""
        return np.concatenate([limb.v for limb in self.limbs])

    @cached_property
    def effort(self) -> Vector:
        """Effort limits of `joint_names` [N m], shape (num_joints,)."""
        return np.concatenate([limb.effort for limb in self.limbs])

    @cached_property
    def joint_limits(self) -> dict[str, tuple[float, float]]:
        """Lower and upper position limit of each limb joint by name [rad]."""
        return {
            joint: (float(low), float(high))
            for limb in self.limbs
            for joint, low, high in zip(limb.joints, limb.lower, limb.upper, strict=True)
        }

    def context(self) -> Context:
        """A fresh context of the plant."""
        return self.plant.CreateDefaultContext()

    def foot_positions(self, context: Context) -> Vector:
        """Where the feet are in W [m], shape (num_limbs, 3)."""
        frames = [self.plant.GetFrameByName(limb.foot) for limb in self.limbs]
        return np.array([frame.CalcPoseInWorld(context).translation() for frame in frames])

    def center_of_mass(self, context: Context) -> Vector:
        """The robot's centre of mass in W [m], shape (3,)."""
        return np.asarray(self.plant.CalcCenterOfMassPositionInWorld(context))
