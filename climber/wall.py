"""The wall: holds, what they can push back with, its surface, obstacles, and gravity in the wall frame.

The wall frame W has x to the right, y up along the wall and z out of the wall towards the climber. Planar robots live
in its x-y plane. A wall in space has facets, flat pieces of surface with rock behind, from which holds stick out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Point, Polygon
from shapely.geometry.base import BaseGeometry

from climber.solids import Facet, Solid
from climber.stance import Contact, Vector

GRAVITY = 9.81  # [m/s^2]
Grip = Literal["friction", "pin", "magnet"]
GRIPS: tuple[Grip, ...] = ("friction", "pin", "magnet")
OUT_OF_WALL = np.array([0.0, 0.0, 1.0])  # z of W
FACING = 0.5  # if the mean of the directions that a stance's holds face is no longer than this, they face all ways


@dataclass(frozen=True)
class Hold:
    """A surveyed hold.

    Attributes:
        position: Centre of the patch in W [m], (x, y, z).
        normal: Unit outward normal of the patch in W.
        friction: Coulomb coefficient of static friction.
        half_width: A foot may stand this far from the centre along the patch, which is a disk across the normal [m];
            to feet of planar robots it is the segment of that disk in the wall plane.
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

    def slippery(self, drop: float) -> Hold:
        """The hold with friction less by the share `drop`, and the least and greatest normal force as they were."""
        if self.grip == "pin":
            return self
        friction = (1.0 - drop) * self.friction
        # Along the edge of a narrower cone the same normal force is a smaller force.
        edge = float(np.hypot(1.0, friction) / np.hypot(1.0, self.friction))
        return replace(self, friction=friction, min_force=edge * self.min_force, max_force=edge * self.max_force)


class Closed(Protocol):
    """A region of a scenario."""

    @property
    def solid(self) -> Solid | None:
        """The region of space; None for a region of the wall plane."""

    def outline(self) -> Polygon:
        """A polygon of the wall plane that contains it."""


@dataclass(frozen=True)
class Wall:
    """Holds, surface and obstacles of one climbing wall.

    Attributes:
        holds: The holds; a hold's number is its place in this tuple. They stick out, and may be touched anywhere.
        obstacles: Regions of the wall plane that no part of a robot may touch. In space they reach through all z: the
            projection of a robot onto the plane must not touch them.
        inclination_deg: 90 is vertical, less is a slab, more an overhang; 0 is a floor, without gravity in its plane.
        solids: Obstacles in space.
        facets: The pieces of the surface. Planar robots move in front of them all.
    """

    holds: tuple[Hold, ...]
    obstacles: tuple[BaseGeometry, ...] = ()
    inclination_deg: float = 90.0
    solids: tuple[Solid, ...] = ()
    facets: tuple[Facet, ...] = ()

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
        """Unit directions along the patches and across z, so within the wall plane on a planar wall, (num_holds, 3)."""
        tangents = np.cross(self.normals, [0.0, 0.0, 1.0])
        lengths = np.linalg.norm(tangents, axis=1, keepdims=True)
        # A normal along z has no preferred direction in the plane; x serves.
        return np.where(lengths > 1e-9, tangents / np.maximum(lengths, 1e-9), [1.0, 0.0, 0.0])

    @cached_property
    def binormals(self) -> Vector:
        """The other unit directions along the patches, across the tangents, shape (num_holds, 3)."""
        result: Vector = np.cross(self.normals, self.tangents)
        return result

    @cached_property
    def outward(self) -> Vector:
        """Unit normal of the facet that each hold is nearest to; without facets that is z. Shape (num_holds, 3)."""
        if not self.facets:
            return np.tile(OUT_OF_WALL, (len(self.holds), 1))
        nearest = np.argmin([facet.distance(self.positions) for facet in self.facets], axis=0)
        result: Vector = np.array([facet.normal for facet in self.facets])[nearest]
        return result

    @cached_property
    def rock(self) -> tuple[Solid, ...]:
        """All that robots in space must keep clear of, besides `obstacles`: what is behind each facet, and solids."""
        return (*(facet.solid for facet in self.facets), *self.solids)

    def slippery(self, drop: float) -> Wall:
        """The wall with the friction of every hold less by the share `drop`."""
        return replace(self, holds=tuple(hold.slippery(drop) for hold in self.holds))

    def closing(self, regions: Iterable[Closed]) -> Wall:
        """The wall with regions closed to robots, no smaller than they are; a `RegionSpec` of a scenario is one."""
        regions = tuple(regions)
        return replace(
            self,
            obstacles=self.obstacles + tuple(region.outline() for region in regions if region.solid is None),
            solids=self.solids + tuple(region.solid for region in regions if region.solid is not None),
        )

    def facing(self, holds: NDArray[np.integer]) -> Vector:
        """The direction that stances are seen along, from the climber's side: how their holds face on the mean.

        A stance between two walls that face one another is seen along z: its holds face all ways.

        Args:
            holds: Hold numbers, shape (..., n).

        Returns:
            Unit vectors out of the wall, shape (..., 3).
        """
        mean = self.outward[holds].mean(axis=-2)
        length = np.linalg.norm(mean, axis=-1, keepdims=True)
        result: Vector = np.where(length > FACING + 1e-9, mean / np.maximum(length, 1e-9), OUT_OF_WALL)
        return result

    def projected(self, holds: NDArray[np.integer]) -> Vector:
        """Where the holds of stances are in the plane across `facing`, x to the right and y up along the wall.

        Args:
            holds: Hold numbers, shape (..., n).

        Returns:
            Points [m], shape (..., n, 2); x and y of W on a wall that faces along z.
        """
        positions = self.positions[holds]
        if (self.outward == OUT_OF_WALL).all():
            flat: Vector = positions[..., :2]
            return flat
        out = self.facing(holds)
        right = np.cross([0.0, 1.0, 0.0], out)
        length = np.linalg.norm(right, axis=-1, keepdims=True)
        right = np.where(length > 1e-6, right / np.maximum(length, 1e-6), [1.0, 0.0, 0.0])
        axes = np.stack([right, np.cross(out, right)], axis=-1)  # (..., 3, 2)
        result: Vector = positions @ axes
        return result

    @cached_property
    def gravity(self) -> Vector:
        """Gravity in W [m/s^2], shape (3,)."""
        a = np.radians(self.inclination_deg)
        # cos(90 degrees) is not quite zero in floating point; a vertical wall pulls exactly downwards.
        return -GRAVITY * np.array([0.0, np.sin(a), np.cos(a) if self.inclination_deg != 90.0 else 0.0])

    def point(self, contact: Contact) -> Vector:
        """Where the foot of `contact` stands in W [m], shape (3,)."""
        result: Vector = self.points([contact])[0]
        return result

    def points(self, contacts: Sequence[Contact]) -> Vector:
        """Where the feet of `contacts` stand in W [m], shape (len(contacts), 3)."""
        holds: NDArray[np.int64] = np.array([c.hold for c in contacts], dtype=int)
        along, across = np.array([(c.offset, c.across) for c in contacts], dtype=float).reshape(-1, 2).T
        result: Vector = self.positions[holds] + along[:, None] * self.tangents[holds]
        if across.any():
            result += across[:, None] * self.binormals[holds]
        return result


def circle(center: Sequence[float], radius: float) -> Polygon:
    """A disk in the wall plane as a polygon circumscribed about it, so that clearance is never overstated."""
    segments = 16
    return Point(center[0], center[1]).buffer(radius / np.cos(np.pi / (4 * segments)), quad_segs=segments)
