"""The wall: holds, what they can push back with, obstacles, and gravity in the wall frame.

The wall frame W has x to the right, y up along the wall and z out of the wall towards the climber.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Point, Polygon
from shapely.geometry.base import BaseGeometry

from climber.stance import Contact, Vector

GRAVITY = 9.81  # [m/s^2]
Grip = Literal["friction", "pin", "magnet"]
GRIPS: tuple[Grip, ...] = ("friction", "pin", "magnet")


@dataclass(frozen=True)
class Hold:
    """A surveyed hold.

    Attributes:
        position: Centre of the patch in W [m], (x, y, z).
        normal: Unit outward normal of the patch in W.
        friction: Coulomb coefficient of static friction.
        half_width: A foot may stand this far from the centre along the patch [m].
        min_force: Least force along each edge of the friction cone while a foot holds on [N] (Gönen eq. 4.9).
        max_force: Greatest force along each edge of the friction cone [N]; for a pin, along each axis.
        grip: "friction" pushes within its cone, "pin" also pulls in any direction, "magnet" is a friction contact
            preloaded by `adhesion`.
        adhesion: Force that pulls a foot onto a magnet along -normal [N].
        max_moment: Greatest moment about the wall plane's normal between a pin and the gripper on it [N m]; zero for a
            pin that a foot turns on freely. Other grips have none.
    """

    position: tuple[float, float, float]
    normal: tuple[float, float, float]
    friction: float
    half_width: float = 0.0
    min_force: float = 0.0
    max_force: float = 20.0
    grip: Grip = "friction"
    adhesion: float = 0.0
    max_moment: float = 0.0


@dataclass(frozen=True)
class Wall:
    """Holds and obstacles of one climbing wall.

    Attributes:
        holds: The holds; a hold's number is its place in this tuple.
        obstacles: Regions of the wall plane that no part of a robot may touch.
        inclination_deg: 90 is vertical, less is a slab, more an overhang; 0 is a floor, without gravity in its plane.
    """

    holds: tuple[Hold, ...]
    obstacles: tuple[BaseGeometry, ...] = ()
    inclination_deg: float = 90.0

    @cached_property
    def positions(self) -> Vector:
        """Centres of the patches in W [m], shape (num_holds, 3)."""
        return np.array([h.position for h in self.holds], dtype=float).reshape(-1, 3)

    @cached_property
    def normals(self) -> Vector:
        """Unit outward normals in W, shape (num_holds, 3)."""
        return np.array([h.normal for h in self.holds], dtype=float).reshape(-1, 3)

    @cached_property
    def tangents(self) -> Vector:
        """Unit directions along the patches within the wall plane, shape (num_holds, 3)."""
        tangents = np.cross(self.normals, [0.0, 0.0, 1.0])
        lengths = np.linalg.norm(tangents, axis=1, keepdims=True)
        # A normal along z has no preferred direction in the plane; x serves.
        return np.where(lengths > 1e-9, tangents / np.maximum(lengths, 1e-9), [1.0, 0.0, 0.0])

    @cached_property
    def gravity(self) -> Vector:
        """Gravity in W [m/s^2], shape (3,)."""
        a = np.radians(self.inclination_deg)
        # cos(90 degrees) is not quite zero in floating point; a vertical wall pulls exactly downwards.
        return -GRAVITY * np.array([0.0, np.sin(a), np.cos(a) if self.inclination_deg != 90.0 else 0.0])

    def point(self, contact: Contact) -> Vector:
        """Where the foot of `contact` stands in W [m], shape (3,)."""
        result: Vector = self.positions[contact.hold] + contact.offset * self.tangents[contact.hold]
        return result

    def points(self, contacts: Sequence[Contact]) -> Vector:
        """Where the feet of `contacts` stand in W [m], shape (len(contacts), 3)."""
        holds: NDArray[np.int64] = np.array([c.hold for c in contacts], dtype=int)
        offsets = np.array([c.offset for c in contacts], dtype=float)
        result: Vector = self.positions[holds] + offsets[:, None] * self.tangents[holds]
        return result


def circle(center: Sequence[float], radius: float) -> Polygon:
    """A disk in the wall plane as a polygon circumscribed about it, so that clearance is never overstated."""
    segments = 16
    return Point(center[0], center[1]).buffer(radius / np.cos(np.pi / (4 * segments)), quad_segs=segments)
