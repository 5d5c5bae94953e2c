"""The pictures of a climb: the wall with what is asked for on it, the climb move by move, an animation, a 3D page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from climber import legend, marks
from climber.animation import draw_animation
from climber.canvas import Canvas, View
from climber.meshcat_page import draw_page
from climber.picture import (
    BAND_ALL,
    BAND_ALPHA,
    BAND_HOLDING,
    FAINT,
    FOOT_PATH,
    GOAL,
    INK,
    PAPER,
    arrow,
    bounds,
    corners,
    fit,
    paint_axes,
    paint_center_of_mass,
    paint_numbers,
    paint_robot,
    paint_support,
    paint_wall,
)
from climber.plan_file import Plan
from climber.raster import RasterCanvas
from climber.replay import Replay
from climber.robot import Model, Robot
from climber.scenario import Scenario
from climber.scene import Scene
from climber.side_view import SideView
from climber.silhouette import Silhouette
from climber.svg import SvgCanvas

FILES = ("wall.svg", "climb.svg", "climb.gif", "climb.html")
WALL_WIDTH, WALL_HEIGHT, LEGEND_WIDTH = 760.0, 620.0, 200.0  # [px]
PANEL_WIDTH, PANEL_HEIGHT = 330.0, 300.0  # the most a snapshot may take [px]
GAP, TITLE = 14.0, 22.0  # [px]

Surface = Callable[[float, float, str], Canvas]  # makes a canvas of a width and a height [px] with a title


def _surface(path: str | Path) -> Surface:
    """The kind of canvas that a path's suffix asks for."""
    if Path(path).suffix.lower() == ".png":
        return lambda width, height, title: RasterCanvas.blank(width, height, fineness=4, zoom=2)
    return SvgCanvas


def draw_wall(scenario: Scenario, path: str | Path) -> None:
    """Writes the wall of a scenario with where the robots start and where they are to go.

    Args:
        scenario: The scenario.
        path: The file, SVG or PNG by its suffix, which appears whole or not at all.

    Raises:
        ModelError: If a robot's model cannot be read.
    """
    wall_picture(scenario, _surface(path)).save(path)


def draw_climb(plan: Plan | Scene, path: str | Path) -> None:
    """Writes snapshots of a climb, one for every move, as SVG or PNG; see `climb_picture`.

    Raises:
        ClimberError: If the plan's scenario, or a robot's model, cannot be read or does not go with the plan.
    """
    climb_picture(plan if isinstance(plan, Scene) else Scene.of(plan), _surface(path)).save(path)


def draw_all(plan: Plan, folder: str | Path) -> list[Path]:
    """Writes every picture of a plan: `wall.svg`, `climb.svg`, `climb.gif` and `climb.html`.

    Args:
        plan: The plan.
        folder: Where to, made if it is not there.

    Returns:
        Their paths.

    Raises:
        ClimberError: If the plan's scenario, or a robot's model, cannot be read or does not go with the plan.
    """
    scene = Scene.of(plan)
    wall, climb, moving, page = paths = [Path(folder) / name for name in FILES]
    draw_wall(scene.scenario, wall)
    draw_climb(scene, climb)
    draw_animation(scene, moving)
    draw_page(scene, page)
    return paths


def wall_picture(scenario: Scenario, surface: Surface = SvgCanvas) -> Canvas:
    """Holds with friction cones, patches and numbers, obstacles, starts, goals, waypoints, and what to keep off.

    A wall in space is seen from the side as well.
    """
    wall = scenario.build_wall()
    colors = []
    for spec in scenario.robots:
        looks = Silhouette(Robot(Model.load(spec.model, scenario.folder), wall.gravity))
        colors.append(dict(zip(looks.robot.limb_names, looks.limb_colors, strict=True)))
    lower, upper = bounds(wall, [region for spec in scenario.robots for region in marks.points(spec)])
    scale = float(min(WALL_WIDTH / (upper - lower)[0], WALL_HEIGHT / (upper - lower)[1]))
    width, height = scale * (upper - lower)
    entries = legend.wall_entries(wall) + marks.entries(scenario.robots, colors)
    left, top = 58.0, 58.0
    tall = max(height + 48.0, 22.0 * len(entries) + GAP)
    side, beside = SideView(wall) if SideView.worthwhile(wall) else None, 0.0
    if side is not None:
        across, up = side.upper - side.lower
        beside = GAP + height * across / up
    canvas = surface(left + width + beside + GAP + LEGEND_WIDTH, top + tall, scenario.name)
    canvas.text((left, 20.0), scenario.name, 17.0, INK, "start", bold=True)
    view = fit(lower, upper, left, top, width, height)
    paint_axes(canvas, view, 12.0)
    for spec, limbs in zip(scenario.robots, colors, strict=True):
        marks.paint_marks(canvas, view, wall, spec, limbs)
    paint_wall(canvas, view, wall)
    for spec in scenario.robots:
        marks.paint_avoided_holds(canvas, view, wall, spec)
    paint_numbers(canvas, view, wall, 13.0, clear=marks.PLACE_RING)
    if side is not None:
        side.paint(canvas, left + width + GAP, top, beside - GAP, height)
    legend.paint_column(canvas, entries, left + width + beside + GAP, top)
    return canvas


def climb_picture(scene: Scene, surface: Surface = SvgCanvas) -> Canvas:
    """Snapshots of a climb: its start, every move at lift-off with the way the foot will go, and its end.

    As in Gönen 2021, fig. 5.3, the shaded band is where the centre of mass may lie: lighter with every limb in
    contact, darker once the moving limb has let go. Of a robot in space it is how far that region extends along x.
    """
    wall, climbs = scene.wall, scene.climbs
    moves = sorted(
        (climb.plan.phases[phase].time[0], robot, phase) for robot, climb in enumerate(climbs) for phase in climb.moves
    )
    lower, upper = bounds(wall, scene.covered, margin=0.05)
    size = (upper - lower) * min(PANEL_WIDTH / (upper - lower)[0], PANEL_HEIGHT / (upper - lower)[1])
    count = len(moves) + 2
    pitch = size + np.array([GAP, GAP + TITLE])
    columns = _columns(count, float(pitch[0] / pitch[1]))
    rows, width = -(-count // columns), columns * pitch[0] + GAP
    entries = _climb_entries(scene)
    top = 44.0 + legend.paint_row(SvgCanvas(0, 0, ""), entries, GAP, 0.0, width - 2 * GAP)
    canvas = surface(width, top + rows * pitch[1] + GAP, scene.title)
    canvas.text((GAP, 22.0), scene.title, 17.0, INK, "start", bold=True)
    legend.paint_row(canvas, entries, GAP, 40.0, width - 2 * GAP)

    def place(panel: int) -> View:
        row, column = divmod(panel, columns)
        return fit(lower, upper, GAP + column * pitch[0], top + row * pitch[1] + TITLE, size[0], size[1])

    _snapshot(canvas, place(0), scene, scene.start, "start")
    for panel, (time, robot, phase) in enumerate(moves, start=1):
        _snapshot(canvas, place(panel), scene, time, _title(climbs, robot, phase), (robot, phase))
    _snapshot(canvas, place(count - 1), scene, scene.end, "end")
    return canvas


def _columns(count: int, aspect: float) -> int:
    """As many columns of panels as bring the whole near to a landscape page and leave few places empty."""

    def distance(columns: int) -> float:
        rows = -(-count // columns)
        return abs(float(np.log(columns * aspect / rows / 1.4))) + 0.1 * (rows * columns - count)

    return min(range(1, count + 1), key=distance)


def _climb_entries(scene: Scene) -> list[legend.Entry]:
    limbs = {
        name: color
        for climb in scene.climbs
        for name, color in zip(climb.robot.limb_names, climb.looks.limb_colors, strict=True)
    }
    entries = [(legend.bar(color, 6.0), name.replace("_", " ")) for name, color in limbs.items()]
    light, dark = legend.box(BAND_ALL, BAND_ALPHA), legend.box(BAND_HOLDING, BAND_ALPHA)
    entries += [
        (light, "support interval, all limbs on"),
        (dark, "support interval, moving limb off"),
        (legend.both(light, dark), "both: it may let go"),
        (legend.center_of_mass(), "centre of mass"),
        (legend.bar(FOOT_PATH, 2.2), "way of the foot"),
    ]
    if any(spec.goal.pelvis is not None for spec in scene.scenario.robots):
        entries.append((legend.box(GOAL, 0.2, GOAL), "goal of the pelvis"))
    return entries


def _title(climbs: Sequence[Replay], robot: int, phase: int) -> str:
    who = f"{climbs[robot].plan.name}: " if len(climbs) > 1 else ""
    return who + climbs[robot].describe(phase)


def _snapshot(
    canvas: Canvas,
    view: View,
    scene: Scene,
    time: float,
    title: str,
    swing: tuple[int, int] | None = None,
) -> None:
    """One panel at `time` [s]; `swing` is the robot and its phase whose limb is about to move."""
    climbs = scene.climbs
    with canvas.group(f"{title}, at {time:.2f} s"):
        canvas.polygon(corners(view), PAPER)
        moments = [climb.at(time) for climb in climbs]
        phases = [swing[1] if swing and swing[0] == i else moment.phase for i, moment in enumerate(moments)]
        for climb, phase in zip(climbs, phases, strict=True):
            paint_support(canvas, view, climb, phase)
        for spec in scene.scenario.robots:
            marks.paint_goal_region(canvas, view, spec)
        paint_wall(canvas, view, scene.wall)
        for i, (climb, moment) in enumerate(zip(climbs, moments, strict=True)):
            moving = climb.moving(phases[i]) if swing and swing[0] == i else None
            if moving is not None:
                after = climb.outline(climb.at(float(climb.plan.phases[phases[i]].time[-1])))
                paint_robot(canvas, view, climb.looks, after, alpha=0.22)
            outline = climb.outline(moment)
            paint_robot(canvas, view, climb.looks, outline, moving)
            if moving is not None:
                _foot_path(canvas, view, climb, phases[i], moving)
            paint_center_of_mass(canvas, view, outline.center_of_mass, 5.0)
        paint_numbers(canvas, view, scene.wall, 10.0)
        canvas.polygon(corners(view), None, stroke=FAINT, width=1.0)
        at = (view.left, view.bottom - view.height - 0.5 * TITLE)
        canvas.text(at, title, 12.5, INK, "start", bold=True)


def _foot_path(canvas: Canvas, view: View, climb: Replay, phase: int, limb: int) -> None:
    """The way of a foot through a swing, ending in an arrow."""
    times = climb.plan.phases[phase].time
    path = view([climb.outline(climb.at(t)).limbs[limb][-1] for t in np.linspace(times[0], times[-1], 25)])
    far = np.linalg.norm(path - path[-1], axis=1) > 9.0
    last = int(np.flatnonzero(far)[-1]) if far.any() else 0
    canvas.line(path[: last + 1], FOOT_PATH, 2.2)
    arrow(canvas, path[last], path[-1], FOOT_PATH, 2.6)
