"""What a robot looks like from the climber's side, read from its model: limbs as polylines, pelvis as an outline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    Mesh,
    Rgba,
    Role,
    SceneGraph,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from shapely.geometry import MultiPoint

from climber.robot import Robot
from climber.stance import Vector

# For limbs whose model gives them no colours of their own.
LIMB_COLORS = ("#d9543d", "#2980ba", "#33a166", "#e89929", "#8e5bb5", "#17a2a8", "#b0486f", "#7a6a4f")
PELVIS_COLOR = "#404552"


@dataclass(frozen=True)
class Outline:
    """A robot in one configuration, in W.

    Attributes:
        pelvis: Convex outline of the pelvis in the wall plane [m], shape (k, 2).
        limbs: For each limb, its joints from the pelvis outwards and its foot [m], shape (num_joints + 1, 3).
        center_of_mass: Centre of mass [m], shape (3,).
    """

    pelvis: Vector
    limbs: tuple[Vector, ...]
    center_of_mass: Vector

    @property
    def feet(self) -> Vector:
        """The feet [m], shape (num_limbs, 3)."""
        return np.array([limb[-1] for limb in self.limbs])

    @property
    def points(self) -> Vector:
        """Everything that is drawn, in the wall plane [m], shape (n, 2)."""
        return np.vstack([self.pelvis, *(limb[:, :2] for limb in self.limbs)])


class Silhouette:
    """Reads a robot's looks once, then gives its outline for any configuration.

    Attributes:
        robot: The robot.
        limb_colors: A colour for each limb, as `#rrggbb`: that of the limb's links in the model if every limb has
            its own, else from `LIMB_COLORS`.
        pelvis_color: The pelvis's colour in the model.
        thickness: Width to draw links with [m].
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._context = robot.context()
        plant = robot.plant
        self._chains = [
            [joint.frame_on_child() for joint in robot.chain(limb.foot) if joint.num_positions()]
            + [plant.GetFrameByName(limb.foot)]
            for limb in robot.limbs
        ]
        looks = _Looks(robot)
        self._pelvis = looks.points(robot.pelvis.name())
        if len(self._pelvis) < 3:  # a pelvis without geometry: what its limbs hang from
            plant.SetPositions(self._context, np.zeros(plant.num_positions()))
            roots = [chain[0].CalcPoseInWorld(self._context).translation() for chain in self._chains]
            X_PW = robot.pelvis.EvalPoseInWorld(self._context).inverse()
            self._pelvis = np.array([X_PW.multiply(root) for root in roots])
        colors = [looks.color([frame.body().name() for frame in chain]) for chain in self._chains]
        own = [color for color in colors if color is not None]
        distinct = len(set(own)) == len(self._chains)
        self.limb_colors = tuple(
            own if distinct else (LIMB_COLORS[i % len(LIMB_COLORS)] for i in range(len(self._chains)))
        )
        self.pelvis_color = looks.color([robot.pelvis.name()]) or PELVIS_COLOR
        self.thickness = 0.055 * float(robot.reach.mean())

    def at(self, q: Vector) -> Outline:
        """The outline in configuration `q`, shape (nq,)."""
        context = self._context
        self.robot.plant.SetPositions(context, q)
        limbs = tuple(
            np.array([frame.CalcPoseInWorld(context).translation() for frame in chain]) for chain in self._chains
        )
        X_WP = self.robot.pelvis.EvalPoseInWorld(context)
        # Corners shared by several shapes differ in the last digits; a micrometre apart they are the same.
        seen = np.round(X_WP.multiply(self._pelvis.T)[:2].T, 6)
        hull = MultiPoint(seen).convex_hull
        corners = np.asarray(hull.exterior.coords[:-1] if hull.geom_type == "Polygon" else hull.coords)
        return Outline(corners, limbs, self.robot.center_of_mass(context))


class _Looks:
    """The geometry of a robot's bodies; it takes a scene graph, which the planner's own plant does without."""

    def __init__(self, robot: Robot) -> None:
        self._plant = MultibodyPlant(0.0)
        scene_graph = SceneGraph()
        self._plant.RegisterAsSourceForSceneGraph(scene_graph)
        robot.model.add_to(self._plant, scene_graph)
        self._plant.Finalize()
        self._inspector: SceneGraphInspector = scene_graph.model_inspector()

    def _body(self, name: str) -> RigidBody:
        return self._plant.GetBodyByName(name)

    def points(self, body: str) -> Vector:
        """Points of the body's visual geometry (collision if it has none) in its frame [m], shape (n, 3)."""
        frame = self._plant.GetBodyFrameIdOrThrow(self._body(body).index())
        for role in (Role.kIllustration, Role.kProximity):
            clouds = [
                self._inspector.GetPoseInFrame(geometry).multiply(shape_points(self._inspector.GetShape(geometry)).T).T
                for geometry in self._inspector.GetGeometries(frame, role)
            ]
            if clouds:
                return np.vstack(clouds)
        return np.zeros((0, 3))

    def color(self, bodies: list[str]) -> str | None:
        """The colour of the first coloured visual geometry of the bodies, as `#rrggbb`."""
        for body in bodies:
            frame = self._plant.GetBodyFrameIdOrThrow(self._body(body).index())
            for geometry in self._inspector.GetGeometries(frame, Role.kIllustration):
                properties = self._inspector.GetIllustrationProperties(geometry)
                if properties is not None and properties.HasProperty("phong", "diffuse"):
                    rgba: Rgba = properties.GetProperty("phong", "diffuse")
                    return "#" + "".join(f"{round(255 * part):02x}" for part in (rgba.r(), rgba.g(), rgba.b()))
        return None


def shape_points(shape: Shape) -> Vector:
    """Points whose convex hull is close to that of a Drake shape, in the shape's frame [m], shape (n, 3)."""
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    sphere = np.vstack(
        [ring * [np.cos(a), np.cos(a), 0] + [0, 0, np.sin(a)] for a in np.linspace(-np.pi / 2, np.pi / 2, 9)]
    )
    if isinstance(shape, Box):
        signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
        return np.asarray(signs * shape.size())
    if isinstance(shape, Sphere):
        return np.asarray(sphere * shape.radius())
    if isinstance(shape, Ellipsoid):
        return np.asarray(sphere * [shape.a(), shape.b(), shape.c()])
    if isinstance(shape, Cylinder | Capsule):
        across = (ring if isinstance(shape, Cylinder) else sphere) * shape.radius()
        half = np.array([0.0, 0.0, shape.length() / 2.0])
        return np.vstack([across + half, across - half])
    if isinstance(shape, Mesh | Convex):
        hull = shape.GetConvexHull()
        return np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    return np.zeros((0, 3))
