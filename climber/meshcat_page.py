"""The climb as a Meshcat page that replays in a browser without a connection to anything."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import (
    Box,
    Meshcat,
    MeshcatAnimation,
    MeshcatParams,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from shapely.geometry import Polygon

from climber.files import write_text
from climber.meshcat_space import add_holds, add_rock, rgba, slab_of
from climber.picture import CONES, OBSTACLE, bounds, rock, wedge
from climber.plan_file import Plan
from climber.replay import Replay
from climber.scene import Scene
from climber.stance import Vector
from climber.wall import Wall

FRAMES_PER_SECOND = 30.0
ROOT = "/climb"  # everything that stands in the wall frame is below this path
SLAB_COLOR, HOLD_COLOR, CENTER_COLOR = "#eceae4", "#8d939c", "#ffd21f"
BAND_ALL, BAND_HOLDING, BAND_SHARED = "#bfd9f4", "#93bdea", "#6ba3df"  # lit, they come out stronger than they are
# The robot moves in z = 0 and the slab is behind it. Front faces, along z in W [m].
SLAB, CONE, HOLD, OBSTACLE_FRONT = -0.030, -0.026, 0.010, 0.015
SLAB_DEPTH = 0.02  # [m]
BELOW = 0.15  # how far support polygons are below the holds [m]
CENTER_RADIUS, IN_FRONT = 0.008, np.array([0.0, 0.0, 0.022])  # [m]


Sheet = tuple[tuple[Vector, NDArray[np.int32]], str]  # a triangle mesh and its colour


def wall_pose(wall: Wall, lowest: float) -> RigidTransform:
    """Where the wall stands in Meshcat's world, whose z is up and whose -y is towards the viewer: X_GW.

    Args:
        wall: The wall; its inclination is turned about W's x axis, so that gravity points down in Meshcat.
        lowest: Ordinate in W of what rests on the ground [m].
    """
    R_GW = RotationMatrix.MakeXRotation(np.radians(wall.inclination_deg))
    p_GoWo_G = np.array([0.0, 0.0, -float(R_GW.multiply(np.array([0.0, lowest, 0.0]))[2])])
    return RigidTransform(R_GW, p_GoWo_G)


def prism(outline: Vector, back: float, front: float) -> tuple[Vector, NDArray[np.int32]]:
    """The solid between an outline at z = `back` and the same at z = `front`.

    Args:
        outline: Corners of a simple polygon in the plane [m], shape (n, 2).
        back: Lower z [m].
        front: Upper z [m].

    Returns:
        Vertices [m], shape (3, 2 n), and triangles, shape (3, m), as Meshcat takes them.
    """
    edge = np.asarray(Polygon(outline).exterior.coords[:-1])
    n = len(edge)
    number = {tuple(corner): i for i, corner in enumerate(edge)}
    triangles = shapely.constrained_delaunay_triangles(Polygon(edge))
    lid = np.array([[number[corner] for corner in triangle.exterior.coords[:3]] for triangle in triangles.geoms])
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    faces = np.vstack([lid, lid + n, np.column_stack([i, j, j + n]), np.column_stack([i, j + n, i + n])])
    vertices = np.vstack([np.column_stack([edge, np.full(n, z)]) for z in (back, front)])
    return np.asfortranarray(vertices.T), np.asfortranarray(faces.T.astype(np.int32))


def _add_wall(meshcat: Meshcat, wall: Wall, lower: Vector, upper: Vector) -> None:
    """The slab with its holds, their friction cones, and the obstacles."""
    width, height = upper - lower
    slab = ROOT + "/wall/slab"
    meshcat.SetObject(slab, Box(width, height, SLAB_DEPTH), rgba(SLAB_COLOR))
    meshcat.SetTransform(slab, RigidTransform(np.append((lower + upper) / 2.0, SLAB - SLAB_DEPTH / 2.0)))
    for number, hold in enumerate(wall.holds):
        path = f"{ROOT}/wall/hold_{number}"
        meshcat.SetTriangleMesh(path + "/rock", *prism(rock(hold, wall.tangents[number]), SLAB, HOLD), rgba(HOLD_COLOR))
        meshcat.SetTriangleMesh(path + "/cone", *prism(wedge(hold), SLAB, CONE), rgba(CONES[hold.grip]))
    for number, obstacle in enumerate(wall.obstacles):
        for part, polygon in enumerate(getattr(obstacle, "geoms", [obstacle])):
            solid = prism(np.asarray(polygon.exterior.coords[:-1]), SLAB, OBSTACLE_FRONT)
            meshcat.SetTriangleMesh(f"{ROOT}/wall/obstacle_{number}_{part}", *solid, rgba(OBSTACLE))


class _Stage:
    """The robots of a climb in a diagram of their own, and the markers that go with them."""

    def __init__(self, meshcat: Meshcat, scene: Scene) -> None:
        self._meshcat, self._climbs, self._start = meshcat, scene.climbs, scene.start
        builder = DiagramBuilder()
        self._plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        self._instances = [
            climb.robot.model.add_to(self._plant, scene_graph, climb.plan.name) for climb in scene.climbs
        ]
        self._plant.Finalize()
        params = MeshcatVisualizerParams()
        params.prefix, params.enable_alpha_slider = ROOT + "/robots", False
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()
        for i in range(len(scene.climbs)):
            meshcat.SetObject(self._center(i), Sphere(CENTER_RADIUS), rgba(CENTER_COLOR))

    @staticmethod
    def _center(robot: int) -> str:
        return f"{ROOT}/center_of_mass/{robot}"

    def show(self, time: float) -> None:
        """Puts robots and markers where they are at `time` [s] into the recording."""
        context = self._plant.GetMyMutableContextFromRoot(self._context)
        for i, (climb, instance) in enumerate(zip(self._climbs, self._instances, strict=True)):
            moment = climb.at(time)
            self._plant.SetPositions(context, instance, moment.q)
            center = climb.outline(moment).center_of_mass + (IN_FRONT if climb.robot.planar else 0.0)
            self._meshcat.SetTransform(self._center(i), RigidTransform(center), time - self._start)
        self._context.SetTime(time - self._start)
        self._diagram.ForcedPublish(self._context)


def _add_support(meshcat: Meshcat, climb: Replay, robot: int, lower: Vector, upper: Vector, start: float) -> None:
    """Support intervals as bands on the slab, or polygons below the robot, each seen during its phase only."""
    recording = meshcat.get_mutable_recording()
    for number, phase in enumerate(climb.plan.phases):
        sheets = _bands(climb, number, lower, upper) if climb.polygons is None else _polygons(climb, number, lower)
        for layer, (sheet, color) in enumerate(sheets):
            path = f"{ROOT}/support/{robot}/{number}_{layer}"
            meshcat.SetTriangleMesh(path, *sheet, rgba(color))
            begin, end = (round(FRAMES_PER_SECOND * (t - start)) for t in (phase.time[0], phase.time[-1]))
            if begin > 0:
                recording.SetProperty(0, path, "visible", False)
            recording.SetProperty(begin, path, "visible", True)
            if number + 1 < len(climb.plan.phases):
                recording.SetProperty(end, path, "visible", False)


def _bands(climb: Replay, number: int, lower: Vector, upper: Vector) -> Iterator[Sheet]:
    """The support intervals of a phase on the slab: with all limbs on, and if one swings, without it and with both."""
    every, holding = climb.standing_support(number), climb.support[number]
    bands = [(every, BAND_ALL)]
    if climb.moving(number) is not None:
        shared = np.array([max(every[0], holding[0]), min(every[1], holding[1])])
        bands += [(holding, BAND_HOLDING), (shared, BAND_SHARED)]
    for layer, (interval, color) in enumerate(bands):
        low, high = np.clip(interval, lower[0], upper[0])
        if high > low:  # neither empty nor beside the slab
            outline = np.array([[low, lower[1]], [high, lower[1]], [high, upper[1]], [low, upper[1]]])
            yield prism(outline, SLAB, SLAB + 0.001 * (layer + 1)), color


def _polygons(climb: Replay, number: int, lower: Vector) -> Iterator[Sheet]:
    """The support polygons of a phase below all that is seen: with all limbs on, and above it, if one swings, without.

    Polygons of a robot in space lie across gravity; the robot's centre of mass is to be above them.
    """
    assert climb.polygons is not None
    up = -climb.robot.gravity / np.linalg.norm(climb.robot.gravity)
    level = float(up @ [lower[0], lower[1], 0.0]) - BELOW
    standing = number if climb.moving(number) is None else max(number - 1, 0)
    for layer, (place, color) in enumerate(((standing, BAND_ALL), (number, BAND_HOLDING))[: 1 + (standing != number)]):
        if len(climb.polygons[place]) > 2:
            yield slab_of(climb.polygons[place], up, level + 0.002 * layer), color


@contextmanager
def _quiet() -> Iterator[None]:
    """Drake announces the address of its server, which nobody is to visit."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(level)


def meshcat_page(scene: Scene, title: str = "") -> str:
    """The page's HTML, under the scene's title or another.

    Raises:
        RuntimeError: If no port of this machine can be listened on, which Meshcat insists on.
    """
    title = title or scene.title
    lower, upper = bounds(scene.wall, scene.covered, margin=0.1)
    params = MeshcatParams()
    params.host, params.port, params.show_stats_plot = "localhost", 0, False
    with _quiet():
        meshcat = Meshcat(params)
    X_GW, camera, target = viewpoint(scene.wall, lower, upper)
    meshcat.SetTransform(ROOT, X_GW)
    meshcat.SetProperty("/Background", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background", "bottom_color", [1.0, 1.0, 1.0])
    meshcat.SetProperty("/Axes", "visible", False)
    if all(climb.robot.planar for climb in scene.climbs):
        _add_wall(meshcat, scene.wall, lower, upper)
    else:
        add_rock(meshcat, ROOT, scene.wall)
        add_holds(meshcat, ROOT, scene.wall.holds)
    stage = _Stage(meshcat, scene)
    meshcat.StartRecording(FRAMES_PER_SECOND, set_visualizations_while_recording=False)
    for frame in range(round(FRAMES_PER_SECOND * (scene.end - scene.start)) + 1):
        stage.show(scene.start + frame / FRAMES_PER_SECOND)
    for robot, climb in enumerate(scene.climbs):
        _add_support(meshcat, climb, robot, lower, upper, scene.start)
    recording = meshcat.get_mutable_recording()
    recording.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    meshcat.PublishRecording()
    meshcat.SetCameraPose(camera, target)
    html: str = meshcat.StaticHtml().replace("<title>Drake MeshCat</title>", f"<title>{escape(title)}</title>", 1)
    return html.replace("<body>", "<body>\n" + _caption(title), 1)


def viewpoint(wall: Wall, lower: Vector, upper: Vector) -> tuple[RigidTransform, Vector, Vector]:
    """Where the wall stands, where the camera is and what it looks at, in Meshcat's world.

    The camera is far enough for the slab to fit into its 75 degrees, a little to the right and above, halfway between
    facing the wall and looking level, so that a slab and an overhang look like what they are. A steep overhang is
    lifted off the ground for the camera to be above it.

    Args:
        wall: The wall.
        lower: Lower left corner of the slab in W's x-y plane [m].
        upper: Upper right corner [m].

    Returns:
        X_GW, the camera and its target [m], the latter two of shape (3,).
    """
    X_GW = wall_pose(wall, float(lower[1]))
    facing = X_GW.rotation().multiply(np.array([0.0, 0.0, 1.0])) + np.array([0.0, -1.0, 0.0])
    away = max((upper - lower)[1], 0.62 * (upper - lower)[0])
    target: Vector = X_GW.multiply(np.append((lower + upper) / 2.0, 0.0))
    camera: Vector = target + away * (facing / np.linalg.norm(facing) + np.array([0.1, 0.0, 0.12]))
    lift = np.array([0.0, 0.0, max(0.0, 0.1 * away - camera[2])])
    return RigidTransform(X_GW.rotation(), X_GW.translation() + lift), camera + lift, target + lift


def _caption(name: str) -> str:
    """What the colours mean, in a corner of the page."""
    words = (
        (BAND_ALL, "centre of mass may be here with every limb on"),
        (BAND_HOLDING, "... with the moving limb off"),
        (BAND_SHARED, "both: the limb may let go"),
        (CENTER_COLOR, "centre of mass"),
        (CONES["friction"], "friction cone"),
    )
    swatch = "display:inline-block;width:1em;height:0.7em;margin-right:0.5em;background:"
    rows = "".join(f'<div><span style="{swatch}{color}"></span>{word}</div>' for color, word in words)
    place = "position:fixed;left:16px;top:12px;z-index:1;font:13px/1.5 Helvetica,Arial,sans-serif;pointer-events:none"
    return f'<div style="{place}"><b style="font-size:16px">{escape(name)}</b>{rows}</div>\n'


def draw_page(plan: Plan | Scene, path: str | Path) -> None:
    """Writes the Meshcat page of a climb, whole or not at all.

    Raises:
        ClimberError: If the plan's scenario, or a robot's model, cannot be read or does not go with the plan.
    """
    write_text(path, meshcat_page(plan if isinstance(plan, Scene) else Scene.of(plan)))
