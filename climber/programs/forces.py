"""What holds can push with, in a plane and in space: one definition for every program.

With unit normal n, friction mu = tan(alpha), and the least and greatest force along each edge of the friction cone
(Gönen 2021, eqs. 4.8-4.9), a contact's force f = f_n n + f_t is in two cones, apex to apex (Bretl 2006, B1-B3, with a
limit on the force as well):

    |f_t| <= mu (f_n - 2 min_force cos(alpha))   and   |f_t| <= mu (2 max_force cos(alpha) - f_n)

In multiples, f = 2 cos(alpha) s n + 2 sin(alpha) (u_1 e_1 + u_2 e_2) with tangents e_1 and e_2, that is

    |u| <= s - min_force   and   |u| <= max_force - s

A plane through n cuts these cones in the parallelogram min_force <= t <= max_force of the multiples t = s +- u of the
cone's two edges, Gönen's model; a robot in a plane has these two variables instead, and no cones. A pin gives a force
within a box. In the plane a gripper on a pin may also turn it: a generator without direction then has a moment. In
space feet are points, which turn nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from climber.programs.sections import EXACT, Section
from climber.stance import Vector
from climber.wall import Wall

Mask = NDArray[np.bool_]

NOTHING = 1.0  # greatest multiple of a generator that has neither direction nor moment


@dataclass(frozen=True)
class ForceLimits:
    """Limits on the multiples t of k contacts, n = k p of them in a row: `R t <= g`, `d - C t` in second-order cones.

    A vector is in the cone if its first entry is at least the length of the rest.

    Attributes:
        R: Shape (r, n).
        g: Shape (r,) [N].
        C: Shape (c, 3, n); no cones (c = 0) in the plane and for pyramids.
        d: Shape (c, 3) [N].
    """

    R: Vector
    g: Vector
    C: Vector
    d: Vector


@dataclass(frozen=True)
class ContactForces:
    """What contacts can push with: `f = offset + generators @ t`, t within limits, forces in W.

    The leading shape `...` is whatever the contacts are indexed by: holds, or sets and places in a set.

    Attributes:
        offset: Force at t = 0 [N], shape (..., 3).
        generators: Force for each multiple, as columns, shape (..., 3, p).
        lower: Least multiple of each generator [N], shape (..., p).
        upper: Greatest multiple of each generator [N], shape (..., p).
        moments: Moment about z that comes with each multiple, shape (..., p): zero, or one for a generator whose
            direction is zero and whose multiples are [N m]; None for no such generators. Holds that take no moment
            beside others that do have a generator of nothing.
        round: In space, where the three multiples are (u_1, u_2, s) of a friction cone, `lower[..., 2]` and
            `upper[..., 2]` its two apexes, shape (...); elsewhere each multiple is limited alone. None in the plane.
        section: What stands for the circle across the cones.
    """

    offset: Vector
    generators: Vector
    lower: Vector
    upper: Vector
    moments: Vector | None = None
    round: Mask | None = None
    section: Section = EXACT

    def __getitem__(self, index: object) -> ContactForces:
        """The contacts at `index`, which indexes the leading axes."""
        i: NDArray[np.int64] = index  # type: ignore[assignment]
        return ContactForces(
            self.offset[i],
            self.generators[i],
            self.lower[i],
            self.upper[i],
            None if self.moments is None else self.moments[i],
            None if self.round is None else self.round[i],
            self.section,
        )

    def excess(self, t: Vector, lower: Vector | None = None, upper: Vector | None = None) -> Vector:
        """By how much multiples are outside their limits [N], shape (...); negative inside.

        It is the least by which all limits would have to give way, the apexes of a cone along its axis.

        Args:
            t: Multiples, shape (..., p), with any further axes before those of the contacts.
            lower: Other lower limits than the contacts' own, shape (..., p).
            upper: Other upper limits.
        """
        lower, upper = self.lower if lower is None else lower, self.upper if upper is None else upper
        result = np.maximum(lower - t, t - upper)
        if self.round is not None:
            across = self.section.size(t[..., :2])
            wide = np.broadcast_to(self.round, across.shape)
            result[..., 2][wide] += across[wide]
            result[..., :2][wide] = result[..., 2:3][wide]
        outside: Vector = result.max(axis=-1)
        return outside

    def greatest(self, c: Vector) -> Vector:
        """The greatest c . t within the limits for c of shape (..., p), in closed form; shape (...).

        Two cones apex to apex are what is between their apexes and the disk they share, so the greatest is there.
        """
        ends = np.maximum(c * self.lower, c * self.upper)
        if self.round is not None:
            half = 0.5 * (self.upper[..., 2] - self.lower[..., 2])
            middle = 0.5 * (self.upper[..., 2] + self.lower[..., 2])
            at_most = middle * c[..., 2] + half * np.maximum(np.abs(c[..., 2]), self.section.greatest(c[..., :2]))
            ends[..., 2] = np.where(self.round, at_most, ends[..., 2])
            ends[..., :2] = np.where(self.round[..., None], 0.0, ends[..., :2])
        result: Vector = ends.sum(axis=-1)
        return result

    def limits(self, lower: Vector | None = None, upper: Vector | None = None) -> ForceLimits:
        """The limits of k contacts, leading shape (k,), for programs.

        Args:
            lower: Other lower limits than the contacts' own, shape (k p,).
            upper: Other upper limits.
        """
        k, p = self.lower.shape
        lower = (self.lower if lower is None else lower).ravel()
        upper = (self.upper if upper is None else upper).ravel()
        n, every = k * p, np.eye(k * p)
        wide = np.zeros(k, dtype=bool) if self.round is None else self.round
        boxed = np.repeat(~wide, p)
        first = np.flatnonzero(wide) * p  # of each friction cone's multiples
        u1, u2, s = every[first], every[first + 1], every[first + 2]
        R, g = [every[boxed], -every[boxed]], [upper[boxed], -lower[boxed]]
        if self.section.edges:
            sideways = np.einsum("ea,acn->cen", self.section.sides, np.stack([u1, u2]))  # (c, edges, n)
            R += [(sideways - s[:, None]).reshape(-1, n), (sideways + s[:, None]).reshape(-1, n)]
            g += [np.repeat(-lower[first + 2], self.section.edges), np.repeat(upper[first + 2], self.section.edges)]
            return ForceLimits(np.concatenate(R), np.concatenate(g), np.zeros((0, 3, n)), np.zeros((0, 3)))
        C = np.concatenate([np.stack([-s, u1, u2], axis=1), np.stack([s, u1, u2], axis=1)])
        d = np.zeros((len(C), 3))
        d[:, 0] = np.concatenate([-lower[first + 2], upper[first + 2]])
        return ForceLimits(np.concatenate(R), np.concatenate(g), C, d)

    def scales(self) -> tuple[Vector, Vector]:
        """Half the range of each multiple [N], and how much its squared deviation weighs, shapes (..., p).

        The weights make deviations the same in a plane and in space: (s + u)^2 + (s - u)^2 = 2 (s^2 + u^2).
        """
        weight = np.ones_like(self.lower)
        if self.round is not None:
            weight[..., :3] += self.round[..., None]
        return 0.5 * (self.upper - self.lower), weight


def wall_forces(wall: Wall, dimension: int = 2, section: Section = EXACT) -> ContactForces:
    """The forces that each hold offers, leading shape (num_holds,); computed once for each wall.

    Args:
        wall: The wall.
        dimension: 2 for a robot in the wall plane, whose contacts exert no force across it; 3 for one in space.
        section: What stands for the circle across friction cones in space. In the plane cones are exact.

    Raises:
        ValueError: If, in the plane, the normal of a friction cone leaves it; the section of a tilted cone is not the
            cone of its section.
    """
    kept: dict[object, ContactForces] = vars(wall)  # type: ignore[assignment]  # as cached properties keep theirs
    key = ("forces", dimension, section if dimension == 3 else EXACT)
    if key not in kept:
        kept[key] = _in_space(wall, section) if dimension == 3 else _in_plane(wall)
    return kept[key]


def _pins(wall: Wall) -> Mask:
    return np.array([hold.grip == "pin" for hold in wall.holds], dtype=bool)


def _hold_numbers(wall: Wall) -> Mapping[str, Vector]:
    """By name, numbers of all holds, each of shape (num_holds,)."""
    holds, pin = wall.holds, _pins(wall)
    most = np.array([hold.max_force for hold in holds], dtype=float)
    return {
        "half angle": np.arctan(np.array([hold.friction for hold in holds], dtype=float)),
        "most": most,
        "least": np.where(pin, -most, np.array([hold.min_force for hold in holds], dtype=float)),
        "adhesion": np.array([hold.adhesion if hold.grip == "magnet" else 0.0 for hold in holds], dtype=float),
        "moment": np.array([hold.max_moment if hold.grip == "pin" else 0.0 for hold in holds], dtype=float),
    }


def _in_plane(wall: Wall) -> ContactForces:
    """Friction: the two edges of the cone. Pin: the axes of the plane. Magnet: the edges, shifted by `adhesion`."""
    pin, numbers, normals = _pins(wall), _hold_numbers(wall), wall.normals
    tilted = np.flatnonzero((np.abs(normals[:, 2]) > 1e-9) & ~pin)
    if len(tilted):
        normal = wall.holds[tilted[0]].normal
        raise ValueError(f"a planar friction cone needs a normal in the wall plane; hold {tilted[0]} has {normal}")
    half_angle = numbers["half angle"][:, None]
    across = np.stack([-normals[:, 1], normals[:, 0], np.zeros(len(normals))], axis=1)
    along, aside = np.cos(half_angle) * normals, np.sin(half_angle) * across
    edges = np.stack([along + aside, along - aside], axis=2)  # (num_holds, 3, 2)
    forces = ContactForces(
        -numbers["adhesion"][:, None] * normals,
        np.where(pin[:, None, None], np.eye(3)[:, :2], edges),
        np.repeat(numbers["least"][:, None], 2, axis=1),
        np.repeat(numbers["most"][:, None], 2, axis=1),
    )
    moment = numbers["moment"]
    turns = moment > 0.0
    if not turns.any():
        return forces
    # Where there is no moment a multiple of nothing takes its place: limits without room between them would leave
    # programs that look for forces strictly inside all limits with none.
    most = np.where(turns, moment, NOTHING)
    return replace(
        forces,
        generators=np.concatenate([forces.generators, np.zeros((len(moment), 3, 1))], axis=2),
        lower=np.column_stack([forces.lower, -most]),
        upper=np.column_stack([forces.upper, most]),
        moments=np.column_stack([np.zeros((len(moment), 2)), turns]),
    )


def _in_space(wall: Wall, section: Section) -> ContactForces:
    """Friction: (u_1, u_2, s), e_1 in the wall plane. Pin: the axes of W. Magnet: friction, shifted by `adhesion`."""
    pin, numbers, normals = _pins(wall), _hold_numbers(wall), wall.normals
    e1 = wall.tangents
    directions = np.stack([e1, np.cross(normals, e1), normals], axis=2)  # (num_holds, 3, 3)
    sine, cosine = np.sin(numbers["half angle"]), np.cos(numbers["half angle"])
    cones = 2.0 * directions * np.stack([sine, sine, cosine], axis=1)[:, None]
    least, most = numbers["least"], numbers["most"]
    half = 0.5 * (most - least) * section.radius
    lower = np.where(pin[:, None], least[:, None], np.column_stack([-half, -half, least]))
    upper = np.where(pin[:, None], most[:, None], np.column_stack([half, half, most]))
    return ContactForces(
        -numbers["adhesion"][:, None] * normals,
        np.where(pin[:, None, None], np.eye(3), cones),
        lower,
        upper,
        round=~pin,
        section=section,
    )


def weight_in_plane(wall: Wall, mass: float) -> float:
    """The pull on the robot down along the wall [N]; zero on a floor, where nothing ties the centre of mass."""
    weight = float(mass * np.hypot(*wall.gravity[:2]))
    return weight if weight > 1e-9 else 0.0
