"""What a Meshcat page shows of a wall in space: surfaces, solids, holds with cones, and support polygons below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from climber.picture import CONES, OBSTACLE
from climber.stance import Vector
from climber.wall import Hold, Wall

ROCK_COLOR, HOLD_COLOR = "#eceae4", "#8d939c"
THICK = 0.006  # of the disks that stand for holds [m]
CONE = 0.035  # length of a friction cone [m]


def rgba(color: str, alpha: float = 1.0) -> Rgba:
    """A colour given as `#rrggbb`."""
    red, green, blue = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return Rgba(red, green, blue, alpha)


def add_rock(meshcat: Meshcat, root: str, wall: Wall) -> None:
    """The surface and the obstacles in space of a wall.

    Args:
        meshcat: Where to.
        root: Path of W.
        wall: The wall.
    """
    for number, solid in enumerate(wall.rock):
        path = f"{root}/wall/rock_{number}"
        shape, X_WS = solid.drake()
        meshcat.SetObject(path, shape, rgba(ROCK_COLOR if number < len(wall.facets) else OBSTACLE))
        meshcat.SetTransform(path, X_WS)


def add_holds(meshcat: Meshcat, root: str, holds: Sequence[Hold]) -> None:
    """Holds as disks with the cones that they can push in; a pin, which pushes every way, with a ball."""
    for number, hold in enumerate(holds):
        path = f"{root}/wall/hold_{number}"
        X_WH = RigidTransform(RotationMatrix.MakeFromOneVector(np.array(hold.normal), 2), np.array(hold.position))
        meshcat.SetTransform(path, X_WH)
        radius = max(hold.half_width, 0.011)
        meshcat.SetObject(path + "/rock", Cylinder(radius, THICK), rgba(HOLD_COLOR))
        meshcat.SetTransform(path + "/rock", RigidTransform(np.array([0.0, 0.0, -THICK / 2])))
        color = rgba(CONES[hold.grip], 0.5)
        if hold.grip == "pin":
            meshcat.SetObject(path + "/cone", Sphere(CONE / 2), color)
        else:
            wide = CONE * min(hold.friction, 2.0)
            meshcat.SetObject(path + "/cone", MeshcatCone(CONE, wide, wide), color)


def slab_of(polygon: Vector, up: Vector, level: float) -> tuple[Vector, NDArray[np.int32]]:
    """A convex polygon across gravity as a thin sheet that is seen from both sides.

    Args:
        polygon: Its corners in order, at any height, in W [m], shape (n, 3).
        up: Unit vector against gravity in W, shape (3,).
        level: How high along it the sheet is [m].

    Returns:
        Vertices [m], shape (3, n), and triangles, shape (3, m), as Meshcat takes them.
    """
    flat = polygon + np.outer(level - polygon @ up, up)
    fan = np.array([[0, i, i + 1] for i in range(1, len(flat) - 1)], dtype=np.int32).reshape(-1, 3)
    return np.asfortranarray(flat.T), np.asfortranarray(np.vstack([fan, fan[:, ::-1]]).T)
