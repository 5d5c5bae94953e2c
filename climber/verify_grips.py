"""What a hold can exert, and how far a force is from that: Gönen's model in the plane, two cones in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climber.stance import Vector
from climber.wall import Hold

ASTRAY = 1e-9  # [N] a force across what a grip can exert at all is none if smaller


@dataclass(frozen=True)
class Grip:
    """What a hold can exert, besides a moment.

    Attributes:
        moment: Greatest moment about W's z, either way [N m]; none in space, where feet are points.
    """

    moment: float

    @staticmethod
    def of(hold: Hold, planar: bool = True) -> Grip:
        """A hold's grip on a robot in the wall plane, or on one in space."""
        moment = hold.max_moment if hold.grip == "pin" and planar else 0.0
        adhesion = hold.adhesion if hold.grip == "magnet" else 0.0
        normal, half_angle = np.array(hold.normal, dtype=float), float(np.arctan(hold.friction))
        if not planar:
            if hold.grip == "pin":
                return PinGrip(moment, hold.max_force)
            lower, upper = (2.0 * np.cos(half_angle) * most for most in (hold.min_force, hold.max_force))
            return ConeGrip(moment, normal, hold.friction, lower, upper, adhesion)
        if hold.grip == "pin":
            most = np.full(2, hold.max_force)
            return PlaneGrip(moment, np.zeros(2), np.eye(2), -most, most)
        tangent = np.array([normal[1], -normal[0]])
        edges = np.cos(half_angle) * normal[:2, None] + np.sin(half_angle) * np.outer(tangent, [1.0, -1.0])
        least, most = np.full(2, hold.min_force), np.full(2, hold.max_force)
        return PlaneGrip(moment, -adhesion * normal[:2], edges, least, most)

    def excess(self, force: Vector) -> Vector:
        """By how much forces (K, 3) break the grip's limits [N], shape (K,); negative inside them."""
        raise NotImplementedError


@dataclass(frozen=True)
class PlaneGrip(Grip):
    """A grip in the wall plane: f = offset + generators t with lower <= t <= upper (Gönen 4.8, 4.9).

    The generators are the cone's edges for friction, the axes for a pin; a magnet's cone is preloaded.

    Attributes:
        offset: Constant part [N], shape (2,).
        generators: Unit vectors as columns, shape (2, 2); they may coincide if there is no friction.
        lower: Least multiple of each generator [N], shape (2,).
        upper: Greatest multiple of each generator [N], shape (2,).
    """

    offset: Vector
    generators: Vector
    lower: Vector
    upper: Vector

    def excess(self, force: Vector) -> Vector:
        """By how much forces (K, 3) break the grip's limits [N], shape (K,); negative inside them.

        The in-plane force is resolved into its multiples of the two generators, and each of these compared with its
        limits. Nothing may push across the wall plane. Without friction the generators are one and the same direction,
        along which the force is shared equally; any force across it is in excess.
        """
        planar = force[:, :2] - self.offset
        multiples = planar @ np.linalg.pinv(self.generators).T
        beside = np.abs(planar - multiples @ self.generators.T).max(axis=1)
        outside = np.maximum(self.lower - multiples, multiples - self.upper).max(axis=1)
        astray = np.maximum(np.abs(force[:, 2]), beside)
        return np.asarray(np.where(astray > ASTRAY, np.maximum(outside, astray), outside))


@dataclass(frozen=True)
class PinGrip(Grip):
    """A pin in space: up to `most` along each axis, either way.

    Attributes:
        most: Greatest force along an axis [N].
    """

    most: float

    def excess(self, force: Vector) -> Vector:
        """By how much forces (K, 3) break the grip's limits [N], shape (K,); negative inside them."""
        return np.asarray(np.abs(force).max(axis=1) - self.most)


@dataclass(frozen=True)
class ConeGrip(Grip):
    """A friction contact in space: two cones, apex to apex (Bretl 2006, B1-B3, with a limit on the force).

    With f_n along the normal and f_t across it, of the force and a magnet's pull together,

        |f_t| <= friction (f_n - lower)  and  |f_t| <= friction (upper - f_n)

    Attributes:
        normal: Unit normal of the hold in W, shape (3,).
        friction: Coefficient of friction.
        lower: Least normal force of the first cone, at its apex [N].
        upper: Greatest normal force of the second [N].
        adhesion: A magnet's pull [N].
    """

    normal: Vector
    friction: float
    lower: float
    upper: float
    adhesion: float

    def excess(self, force: Vector) -> Vector:
        """By how much forces (K, 3) break the grip's limits [N], shape (K,); negative inside them.

        It is what both limits on the forces along the cone's edges would have to give way by, as in the plane. Without
        friction any force across the normal is in excess.
        """
        along = force @ self.normal + self.adhesion
        across = np.linalg.norm(force - np.outer(force @ self.normal, self.normal), axis=1)
        edge = 2.0 * np.cos(np.arctan(self.friction))  # normal force from a newton along both opposite edges
        outside = np.maximum(self.lower - along, along - self.upper) / edge
        if self.friction > 0.0:
            return np.asarray(outside + across / (edge * self.friction))
        return np.asarray(np.where(across > ASTRAY, np.maximum(outside, across), outside))
