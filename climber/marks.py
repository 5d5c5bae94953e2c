"""What is asked of a robot, marked on the picture of the wall: start, goal, waypoints and what to keep off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from climber import legend
from climber.canvas import Canvas, View
from climber.picture import AVOID, GOAL, WAYPOINT
from climber.scenario import Place, RegionSpec, RobotSpec
from climber.stance import Vector
from climber.wall import Wall

FOOT_RING, PLACE_RING = 0.019, 0.026  # radii of the rings around holds [m]
SIZE = 12.0  # of the letters [px]


def points(spec: RobotSpec) -> list[Vector]:
    """Corners of all regions asked for [m], each of shape (n, 2), for a picture to have room for."""
    places = [spec.goal, *spec.waypoints]
    regions = [place.pelvis for place in places if place.pelvis is not None] + spec.avoid.regions
    return [_outline(region) for region in regions]


def paint_goal_region(canvas: Canvas, view: View, spec: RobotSpec) -> None:
    """Where the pelvis is to end up."""
    if spec.goal.pelvis is not None:
        _region(canvas, view, spec.goal.pelvis, GOAL, "goal of the pelvis")


def paint_marks(canvas: Canvas, view: View, wall: Wall, spec: RobotSpec, colors: Mapping[str, str]) -> None:
    """What is asked of one robot, as goes under the holds; `colors` are those of its limbs by name."""
    for region in spec.avoid.regions:
        _region(canvas, view, region, AVOID, "region to keep out of")
    for number, waypoint in enumerate(spec.waypoints, start=1):
        _place(canvas, view, wall, waypoint, WAYPOINT, waypoint.name or f"waypoint {number}", colors)
    _place(canvas, view, wall, spec.goal, GOAL, "goal", colors)
    for limb, hold in spec.start.items():
        with canvas.group(f"{spec.name}: {limb} starts on hold {hold}"):
            canvas.disk(view(wall.positions[hold]), FOOT_RING * view.scale, None, stroke=colors[limb], width=3.0)


def paint_avoided_holds(canvas: Canvas, view: View, wall: Wall, spec: RobotSpec) -> None:
    """Crosses over the holds that one robot must keep off."""
    for hold in spec.avoid.holds:
        with canvas.group(f"{spec.name}: hold {hold} is to be avoided"):
            for slope in (-1.0, 1.0):
                arm = 0.7 * FOOT_RING * np.array([1.0, slope])
                ends = wall.positions[hold, :2] + np.outer([-1.0, 1.0], arm)
                canvas.line(view(ends), AVOID, 3.0)


def entries(specs: Sequence[RobotSpec], colors: Sequence[Mapping[str, str]]) -> list[legend.Entry]:
    """Legend entries for the marks of some robots."""
    result: list[legend.Entry] = []
    for spec, limbs in zip(specs, colors, strict=True):
        who = f"{spec.name}, " if len(specs) > 1 else ""
        result += [(legend.ring(limbs[limb]), f"{who}{limb.replace('_', ' ')} starts") for limb in spec.start]
    goals = [spec.goal for spec in specs]
    waypoints = [place for spec in specs for place in spec.waypoints]
    for places, color, word in ((goals, GOAL, "goal"), (waypoints, WAYPOINT, "waypoint")):
        if any(place.pelvis is not None for place in places):
            result.append((legend.box(color, 0.2, color), f"{word} of the pelvis"))
        if any(place.holds or place.stance for place in places):
            result.append((legend.ring(color, 1.8), f"{word} hold"))
    if any(spec.avoid.regions for spec in specs):
        result.append((legend.box(AVOID, 0.2, AVOID), "keep out"))
    if any(spec.avoid.holds for spec in specs):
        result.append((legend.cross(AVOID), "hold to avoid"))
    return result


def _outline(region: RegionSpec) -> Vector:
    return np.asarray(region.outline().exterior.coords[:-1])


def _region(canvas: Canvas, view: View, region: RegionSpec, color: str, word: str) -> None:
    corners = view(_outline(region))
    with canvas.group(word):
        canvas.polygon(corners, color, 0.16)
        canvas.line(np.vstack([corners, corners[:1]]), color, 1.6, dash=5.0)


def _place(
    canvas: Canvas, view: View, wall: Wall, place: Place, color: str, word: str, colors: Mapping[str, str]
) -> None:
    """A goal or a waypoint: the pelvis's region with `word` in it, and rings around its holds."""
    if place.pelvis is not None:
        _region(canvas, view, place.pelvis, color, word)
        corners = view(_outline(place.pelvis))
        middle, top = corners.mean(axis=0), corners[:, 1].min()
        narrow = np.ptp(corners[:, 0]) < 0.7 * SIZE * len(word)  # then the word goes above it
        at = (middle[0], top - SIZE) if narrow else middle
        canvas.text(at, word, SIZE, color, bold=True, halo=True)
    limbs = {hold: limb for limb, hold in (place.stance or {}).items()}
    for hold in sorted({*(place.holds or ()), *limbs}):
        at, radius = view(wall.positions[hold]), PLACE_RING * view.scale
        who = f" of {limbs[hold]}" if hold in limbs else ""
        with canvas.group(f"hold {hold}: {word}{who}"):
            canvas.disk(at, radius, None, stroke=color, width=1.8)
            if hold in limbs:  # the limb's own colour inside the ring
                canvas.disk(at, radius - 2.4, None, stroke=colors[limbs[hold]], width=1.4)
