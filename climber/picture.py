"""What pictures of a climb are made of: holds with friction cones, support bands, robots. Each painter takes a canvas.

Lengths given in metres belong to the wall and grow with the view; widths in pixels are those of a pen.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike
from shapely.geometry import LineString, box
from shapely.geometry.base import BaseGeometry

from climber.canvas import Canvas, View
from climber.replay import Replay
from climber.silhouette import Outline, Silhouette
from climber.stance import Vector
from climber.wall import Hold, Wall

INK, PAPER, FAINT, GRID = "#22262d", "#ffffff", "#8b929c", "#e6e9ed"
ROCK, ROCK_EDGE, OBSTACLE = "#b9bec6", "#6b727c", "#7d858f"
CONES = {"friction": "#d9a02b", "pin": "#3f9193", "magnet": "#8c5cb5"}
CONE_FILLS = {"friction": "#fbe3a9", "pin": "#c3e3e3", "magnet": "#dfcbee"}
GOAL, AVOID, WAYPOINT, FORCE, FOOT_PATH = "#b5179e", "#cf3a3a", "#0f8b8d", "#9b1030", "#5a2ca0"
# Light: where the centre of mass may be with every limb in contact. Dark: with the limbs that hold during a swing.
BAND_ALL, BAND_HOLDING, BAND_ALPHA = "#a9cdf0", "#4d8fd1", 0.55

CONE_LENGTH = 0.045  # [m]


def bounds(wall: Wall, points: Iterable[ArrayLike] = (), margin: float = 0.07) -> tuple[Vector, Vector]:
    """Lower left and upper right corner [m] of the holds, the obstacles and `points`, with `margin` [m] around."""
    clouds = [wall.positions[:, :2]]
    clouds += [np.asarray(o.bounds, dtype=float).reshape(2, 2) for o in seen_obstacles(wall)]
    clouds += [np.asarray(p, dtype=float).reshape(-1, np.shape(p)[-1])[:, :2] for p in points]
    cloud = np.vstack(clouds)
    return cloud.min(axis=0) - margin, cloud.max(axis=0) + margin


def seen_obstacles(wall: Wall) -> list[BaseGeometry]:
    """What obstacles cover of the wall plane, those in space as seen from the climber's side."""
    return [*wall.obstacles, *(solid.outline() for solid in wall.solids)]


def fit(lower: Vector, upper: Vector, left: float, top: float, width: float, height: float) -> View:
    """The view of a part of the wall that fills as much of a box of the canvas [px] as equal scales allow."""
    size = upper - lower
    scale = float(min(width / size[0], height / size[1]))
    return View(
        (float(lower[0]), float(lower[1])),
        (float(upper[0]), float(upper[1])),
        left + (width - scale * size[0]) / 2.0,
        top + (height + scale * size[1]) / 2.0,
        scale,
    )


def corners(view: View) -> Vector:
    """The corners of what is seen [px], shape (4, 2)."""
    return view(np.array([view.lower, (view.upper[0], view.lower[1]), view.upper, (view.lower[0], view.upper[1])]))


def arrow(canvas: Canvas, tail: Vector, head: Vector, color: str, width: float) -> None:
    """A straight arrow between two pixels; only its head if it is shorter than that."""
    length = float(np.linalg.norm(head - tail))
    if length < 1e-6:
        return
    along = (head - tail) / length
    across = np.array([-along[1], along[0]])
    tip = min(3.5 * width, length)
    neck = head - tip * along
    if length > tip:
        canvas.line([tail, neck], color, width)
    canvas.polygon([head, neck + 0.5 * tip * across, neck - 0.5 * tip * across], color)


def wedge(hold: Hold) -> Vector:
    """Outline of the directions a hold can push in, in the wall plane [m], shape (n, 2).

    A sector of half-angle atan(friction) about the normal; a disk for a pin, which pushes and pulls every way, and for
    a normal that points out of the wall.
    """
    center, normal = np.array(hold.position[:2]), np.array(hold.normal[:2])
    if hold.grip == "pin" or np.linalg.norm(normal) < 0.1:
        angles = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
        return np.asarray(center + 0.45 * CONE_LENGTH * np.column_stack([np.cos(angles), np.sin(angles)]))
    middle, half = np.arctan2(normal[1], normal[0]), np.arctan(hold.friction)
    angles = np.linspace(middle - half, middle + half, 16)
    return np.vstack([center, center + CONE_LENGTH * np.column_stack([np.cos(angles), np.sin(angles)])])


def rock(hold: Hold, tangent: Vector) -> Vector:
    """Outline of the body of a hold: half a disk behind its patch [m], shape (n, 2)."""
    radius = max(1.15 * hold.half_width, 0.011)
    angles = np.linspace(0.0, np.pi, 16)[:, None]
    center, back = np.array(hold.position[:2]), -np.array(hold.normal[:2])
    result: Vector = center + radius * (np.cos(angles) * tangent[:2] + np.sin(angles) * back)
    return result


def paint_obstacles(canvas: Canvas, view: View, obstacles: Iterable[BaseGeometry]) -> None:
    """Obstacles, grey."""
    for obstacle in obstacles:
        with canvas.group("obstacle"):
            for part in getattr(obstacle, "geoms", [obstacle]):
                corners = np.asarray(part.exterior.coords[:-1] if part.geom_type == "Polygon" else part.coords)
                canvas.polygon(view(corners), OBSTACLE, 0.75, stroke=ROCK_EDGE, width=1.2)


def paint_hold_shape(canvas: Canvas, view: View, hold: Hold, tangent: Vector) -> None:
    """A hold without its number; `tangent` runs along its patch in W, shape (3,)."""
    canvas.polygon(view(wedge(hold)), CONE_FILLS[hold.grip], 0.85, stroke=CONES[hold.grip], width=0.8)
    canvas.polygon(view(rock(hold, tangent)), ROCK, stroke=ROCK_EDGE, width=0.8)
    patch = np.array(hold.position) + hold.half_width * np.outer([-1.0, 1.0], tangent)
    canvas.line(view(patch), INK, max(1.4, 0.0035 * view.scale))


def paint_wall(canvas: Canvas, view: View, wall: Wall) -> None:
    """Obstacles, the edges of facets, and holds without their numbers."""
    for facet in wall.facets:
        around = LineString(np.array([*facet.corners, facet.corners[0]])[:, :2]).intersection(
            box(*view.lower, *view.upper)
        )
        for edge in getattr(around, "geoms", [around]):
            if edge.geom_type == "LineString" and not edge.is_empty:
                canvas.line(view(np.asarray(edge.coords)), FAINT, 0.8)
    paint_obstacles(canvas, view, seen_obstacles(wall))
    for number, hold in enumerate(wall.holds):
        with canvas.group(f"hold {number}: {hold.grip}, friction {hold.friction:g}"):
            paint_hold_shape(canvas, view, hold, wall.tangents[number])


def paint_numbers(canvas: Canvas, view: View, wall: Wall, size: float, clear: float = 0.0) -> None:
    """The holds' numbers behind their patches in letters of `size` [px], at least `clear` [m] away."""
    for number, hold in enumerate(wall.holds):
        depth = float(np.ptp(rock(hold, wall.tangents[number]) @ np.array(hold.normal[:2])))
        away = max(depth, clear) * view.scale + 0.75 * size
        at = view(hold.position) + away * np.array([-hold.normal[0], hold.normal[1]])
        canvas.text(at, str(number), size, INK, bold=True, halo=True)


def paint_band(canvas: Canvas, view: View, interval: Vector, color: str, alpha: float) -> None:
    """A support interval [m], shape (2,), as a vertical band; an empty one (NaN) paints nothing."""
    low, high = np.clip(interval, view.lower[0], view.upper[0])
    if high > low:
        bottom, top = view.lower[1], view.upper[1]
        canvas.polygon(view([(low, bottom), (high, bottom), (high, top), (low, top)]), color, alpha)


def paint_support(canvas: Canvas, view: View, climb: Replay, phase: int) -> None:
    """Where the centre of mass may be: light with every limb in contact, dark once the moving limb has let go."""
    paint_band(canvas, view, climb.standing_support(phase), BAND_ALL, BAND_ALPHA)
    if climb.moving(phase) is not None:
        paint_band(canvas, view, climb.support[phase], BAND_HOLDING, BAND_ALPHA)


def paint_robot(
    canvas: Canvas, view: View, looks: Silhouette, outline: Outline, moving: int | None = None, alpha: float = 1.0
) -> None:
    """A robot; `moving` is the limb to highlight, `alpha` below 1 paints a ghost without joints."""
    width = looks.thickness * view.scale
    ghost = alpha < 1.0
    if moving is not None and not ghost:
        canvas.line(view(outline.limbs[moving]), "#ffe27a", 1.9 * width + 3.0)
    for limb, color in zip(outline.limbs, looks.limb_colors, strict=True):
        if not ghost:
            canvas.line(view(limb), INK, width + 1.6)
        canvas.line(view(limb), color, width, alpha)
    canvas.polygon(view(outline.pelvis), looks.pelvis_color, alpha, stroke=None if ghost else INK, width=0.8)
    if ghost:
        return
    for limb in outline.limbs:
        for joint in limb[:-1]:
            canvas.disk(view(joint), 0.42 * width, PAPER, stroke=INK, width=0.8)
        canvas.disk(view(limb[-1]), 0.5 * width, INK)


def paint_center_of_mass(canvas: Canvas, view: View, center: Vector, radius: float) -> None:
    """The usual quartered disk, `radius` in px, and a plumb line to the foot of the view."""
    at = view(center)
    foot = np.array([at[0], view.bottom])
    canvas.line([at, foot], INK, 0.9, dash=3.0)
    canvas.disk(at, radius, PAPER, stroke=INK, width=1.0)
    for start in (0.0, np.pi):
        angles = np.linspace(start, start + np.pi / 2.0, 7)
        canvas.polygon(np.vstack([at, at + radius * np.column_stack([np.cos(angles), np.sin(angles)])]), INK)


def tick_step(length: float) -> float:
    """A round distance between ticks [m] that puts four to ten of them on `length` [m]."""
    power = 10.0 ** np.floor(np.log10(length / 4.0))
    return float(next(step * power for step in (5.0, 2.0, 1.0) if length / (step * power) >= 4.0))


def paint_axes(canvas: Canvas, view: View, size: float) -> None:
    """A grid, a frame and ticks in metres around the view, labels in letters of `size` [px]."""
    lower, upper = np.array(view.lower), np.array(view.upper)
    short, long = np.sort(upper - lower)
    step = max(tick_step(float(short)), tick_step(float(long) / 2.5))
    decimals = max(0, int(-np.floor(np.log10(step) + 1e-9)))
    with canvas.group("axes in metres"):
        for axis in (0, 1):
            for value in step * np.arange(np.ceil(lower[axis] / step), np.floor(upper[axis] / step) + 1):
                ends = np.array([lower, upper])
                ends[:, axis] = value
                begin, end = view(ends)
                canvas.line([begin, end], GRID, 1.0)
                at = begin + (np.array([0.0, 1.1 * size]) if axis == 0 else np.array([-0.5 * size, 0.0]))
                canvas.text(at, f"{round(value, 9) + 0.0:.{decimals}f}", size, INK, "middle" if axis == 0 else "end")
        canvas.polygon(corners(view), None, stroke=FAINT, width=1.0)
        canvas.text((view.left + view.width / 2.0, view.bottom + 2.6 * size), "x [m]", size, INK)
        canvas.text((view.left - 0.5 * size, view.bottom - view.height - 0.9 * size), "y [m]", size, INK)
