"""What holds can push with as rows of inequalities on contact forces, and how the rows change with holds' errors.

With the unit normal n, friction mu, and the least and greatest normal force lo and hi that belong to the limits along
the edges of the cone (lo = 2 min_force cos(atan mu), hi likewise), a hold pushes with f, whose part along the hold is
f_t, if

    |f_t| <= chi mu (n.f - lo),   |f_t| <= chi mu (hi - n.f)

where chi = 1; a drop of friction by d has chi = 1 - d and leaves lo and hi as they are, so that less friction never
allows a force that more does not. Forces that do whichever way the normal is turned by up to e, for who does not know
of it, are at an angle of at most atan(mu) - e from n: chi = tan(atan(mu) - e) / mu. For a magnet f is the force plus
the adhesion into the hold. In a plane that contains n this is the parallelogram of Gönen 2021, eqs. 4.8 to 4.11. In
space the round |f_t| <= r is replaced by a polygon inside it, so that what the rows allow can really be done. A pin
pushes with up to `max_force` along each axis of W and knows neither friction nor normal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climber.robot import Indices
from climber.stance import Vector
from climber.wall import Hold, Wall

EDGES = 16  # of the polygon inside a round cone


@dataclass(frozen=True)
class Grips:
    """The rows (base + chi along) . f <= most + chi more of k contacts, R of each.

    Attributes:
        base: Shape (k, R, 3).
        along: What friction adds, shape (k, R, 3).
        most: [N], shape (k, R).
        more: What friction adds [N], shape (k, R).
        friction: mu, zero for pins, shape (k,).
        width: Half width of the patch [m], shape (k,).
        moment: Greatest moment between contact and foot about z [N m], shape (k,).
    """

    base: Vector
    along: Vector
    most: Vector
    more: Vector
    friction: Vector
    width: Vector
    moment: Vector

    def __getitem__(self, index: object) -> Grips:
        """The contacts at `index`, which indexes the leading axis."""
        i: Indices = index  # type: ignore[assignment]
        return Grips(**{name: part[i] for name, part in vars(self).items()})

    def rows(self, chi: float | Vector = 1.0) -> tuple[Vector, Vector]:
        """Matrix (k, R, 3) and right side (k, R) of the rows at chi, one for all contacts or of shape (k,)."""
        each = np.asarray(chi, dtype=float).reshape(-1, 1)
        return self.base + each[:, :, None] * self.along, self.most + each * self.more


def wall_grips(wall: Wall, dimension: int) -> Grips:
    """The grips of all holds of a wall, for a robot in the wall plane (dimension 2) or in space (3)."""
    return _stacked([_grip(hold, dimension) for hold in wall.holds])


def _stacked(grips: list[Grips]) -> Grips:
    """One-contact grips as one; rows that a grip has less than others are 0 . f <= 1."""
    rows = max(grip.base.shape[1] for grip in grips)

    def padded(grip: Grips) -> Grips:
        lacking = rows - grip.base.shape[1]
        wide, flat = ((0, 0), (0, lacking), (0, 0)), ((0, 0), (0, lacking))
        return replace(
            grip,
            base=np.pad(grip.base, wide),
            along=np.pad(grip.along, wide),
            most=np.pad(grip.most, flat, constant_values=1.0),
            more=np.pad(grip.more, flat),
        )

    parts = [vars(padded(grip)) for grip in grips]
    return Grips(**{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def _grip(hold: Hold, dimension: int) -> Grips:
    """One hold's grip, leading shape (1,)."""
    if hold.grip == "pin":
        sides = np.concatenate([np.eye(3)[:dimension], -np.eye(3)[:dimension]])
        none, most = np.zeros_like(sides), np.full(len(sides), hold.max_force)
        return _alone(sides, none, most, np.zeros(len(sides)), 0.0, hold.half_width, hold.max_moment)
    normal, edge = np.array(hold.normal), 2.0 * np.cos(np.arctan(hold.friction))
    adhesion = hold.adhesion if hold.grip == "magnet" else 0.0
    least, greatest = edge * hold.min_force - adhesion, edge * hold.max_force - adhesion
    if dimension == 2:
        tangent = np.array([-normal[1], normal[0], 0.0])
        sides, friction = np.array([tangent, -tangent]), hold.friction
    else:
        first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        first /= np.linalg.norm(first)
        angle = 2.0 * np.pi * np.arange(EDGES) / EDGES
        sides = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(normal, first)
        friction = hold.friction * np.cos(np.pi / EDGES)
    ones, zeros = np.ones((len(sides), 1)), np.zeros((2, 3))
    return _alone(
        np.concatenate([sides, sides, [-normal, normal]]),
        np.concatenate([-friction * ones * normal, friction * ones * normal, zeros]),
        np.concatenate([np.zeros(2 * len(sides)), [-least, greatest]]),
        np.concatenate([-friction * least * ones[:, 0], friction * greatest * ones[:, 0], [0.0, 0.0]]),
        hold.friction,
        hold.half_width,
        0.0,
    )


def _alone(*parts: Vector | float) -> Grips:
    return Grips(*(np.asarray(part)[None] for part in parts))
