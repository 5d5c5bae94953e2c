"""A wall in space seen from the side, along -x, with gravity pointing down: how it leans and what sticks out of it."""

from __future__ import annotations

import numpy as np
from shapely.geometry import MultiPoint, Point, box
from shapely.geometry.base import BaseGeometry

from climber.canvas import Canvas, View
from climber.picture import CONES, FAINT, INK, OBSTACLE, ROCK, ROCK_EDGE, corners, fit
from climber.solids import Solid, Sphere
from climber.stance import Vector
from climber.wall import Wall

MARGIN = 0.15  # of what is shown around the holds [m]
NORMAL = 0.06  # length of a hold's normal [m]


class SideView:
    """The picture of a wall from the side.

    Attributes:
        wall: The wall.
        lower: Lower left corner of what is shown [m], shape (2,).
        upper: Upper right corner [m], shape (2,).
    """

    def __init__(self, wall: Wall) -> None:
        self.wall = wall
        up = -wall.gravity / np.linalg.norm(wall.gravity)
        self._axes = np.stack([np.cross([1.0, 0.0, 0.0], up), up])  # out of the wall to the right, and up
        holds = self.seen(wall.positions)
        self.lower: Vector = holds.min(axis=0) - MARGIN
        self.upper: Vector = holds.max(axis=0) + MARGIN

    @staticmethod
    def worthwhile(wall: Wall) -> bool:
        """Whether a wall is one in space, with weight to show which way it leans."""
        return bool(wall.facets or wall.solids) and float(np.linalg.norm(wall.gravity[1:])) > 0.0

    def seen(self, points: Vector) -> Vector:
        """Points (..., 3) of W as they are seen, (..., 2) [m]."""
        result: Vector = np.asarray(points) @ self._axes.T
        return result

    def _outline(self, solid: Solid) -> BaseGeometry:
        if isinstance(solid, Sphere):
            return Point(self.seen(np.array(solid.center))).buffer(solid.radius)
        return MultiPoint(self.seen(solid.polyhedron.corners)).convex_hull

    def paint(self, canvas: Canvas, left: float, top: float, width: float, height: float) -> View:
        """Paints rock, obstacles, and holds with their normals into a box of the canvas [px]."""
        view, frame = fit(self.lower, self.upper, left, top, width, height), box(*self.lower, *self.upper)
        with canvas.group("seen from the side"):
            for number, solid in enumerate(self.wall.rock):
                shown = self._outline(solid).intersection(frame)
                if shown.geom_type == "Polygon" and not shown.is_empty:
                    color = ROCK if number < len(self.wall.facets) else OBSTACLE
                    outline = view(np.asarray(shown.exterior.coords[:-1]))
                    canvas.polygon(outline, color, 0.75, stroke=ROCK_EDGE, width=0.8)
            places, normals = self.seen(self.wall.positions), self.seen(self.wall.normals)
            for hold, at, normal in zip(self.wall.holds, places, normals, strict=True):
                canvas.line(view(np.array([at, at + NORMAL * normal])), CONES[hold.grip], 1.4)
                canvas.disk(view(at), 2.0, INK)
            canvas.polygon(corners(view), None, stroke=FAINT, width=1.0)
            canvas.text((view.left + view.width / 2, view.bottom + 14.0), "from the side", 12.0, INK)
        return view
