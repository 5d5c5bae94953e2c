"""Where the centre of mass may be over sets of contacts, in a plane and in space, many sets at a time.

For a robot in the wall plane that is an interval of abscissas, for one in space a convex polygon across gravity. Both
are given as halfspaces A p <= b of the centre of mass p in W. `hold_set_regions`, `contact_regions`: these are to call.

A polygon is enclosed: every point of it is known to be held by forces within their limits, and no point outside its
bounds is, by weak duality. `climber.programs.equilibrium.RegionProgram` asks the same of one set as a program for
Drake's solvers; it must agree, and is the model to read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from climber.programs.forces import ContactForces, wall_forces, weight_in_plane
from climber.programs.outlines import Outlines, hulls, outline
from climber.programs.sections import EXACT, Section
from climber.programs.support import support_intervals
from climber.programs.wrenches import BALANCE, WIDER, Wrenches, across
from climber.robot import Indices
from climber.stance import Contact, Vector
from climber.wall import Wall

Mask = NDArray[np.bool_]
GAP = 1e-3  # [m] asked for between what is known to be held and what is known not to be
ROUGHLY = 1.0  # [m] size of a polygon; where two of its sides meet at an angle of gap over size, answers off by
FINE = 0.1  # of gap^2 over size put their corner off by this part of the gap
FINEST = 1e-9  # [m] that answers are ever asked to be off by at most
CHUNK = 4096  # sets handled at once


@dataclass(frozen=True)
class SupportRegions:
    """Where the centre of mass may be over each of M sets of contacts.

    Attributes:
        basis: Unit vectors across gravity, one for a robot in the wall plane, two in space; shape (1 or 2, 3).
        A: Unit normals of halfspaces A p <= b, in W and across gravity, shape (M, r, 3).
        b: Their right sides [m], shape (M, r). Every centre of mass within all of a set's can be held. NaN where none
            can; infinite where there is no weight to hold. Regions with fewer sides repeat their last one.
        corners: Corners of the regions in the coordinates of `basis` [m], repeated likewise, shape (M, r, 1 or 2).
        outer_A: Unit normals of halfspaces outside of which nothing can be held, shape (M, s, 3).
        outer_b: Their right sides [m], shape (M, s).
        gap: No point within the outer halfspaces is farther than this from the region [m], shape (M,).
        direction: In space, where nothing can be held, a unit direction in which the contacts fail; else NaN, shape
            (M, 3). In the plane `climber.programs.equilibrium.SupportProgram` tells it.
        turning: The turn about gravity that goes with it [1/m], shape (M,); see `shortfall`.
        shortfall: By how much they fail [N]: direction . (-weight) exceeds the greatest that the contacts can make
            direction . force + turning * moment, of their forces and of the moments of these about the direction of
            gravity through the contacts' mean. Shape (M,).
    """

    basis: Vector
    A: Vector
    b: Vector
    corners: Vector
    outer_A: Vector
    outer_b: Vector
    gap: Vector
    direction: Vector
    turning: Vector
    shortfall: Vector

    def __len__(self) -> int:
        return len(self.b)

    @property
    def empty(self) -> Mask:
        """Over which sets no centre of mass can be held, shape (M,)."""
        return np.asarray(np.isnan(self.b[:, 0]))

    def margin(self, p: Vector) -> Vector:
        """How far centres of mass, shape (M, 3) or (3,), are inside the sides' lines [m]; negative outside; (M,).

        Minus infinity where nothing can be held.
        """
        inside = (self.b - (self.A @ np.broadcast_to(p, (len(self), 3))[..., None])[..., 0]).min(axis=1)
        return np.where(self.empty, -np.inf, inside)


def hold_set_regions(
    wall: Wall, sets: NDArray[np.integer], mass: float, dimension: int = 2, section: Section = EXACT, gap: float = GAP
) -> SupportRegions:
    """Where the centre of mass may be over sets of holds stood on at the centres of their patches.

    Args:
        wall: The wall.
        sets: Hold numbers, shape (M, k).
        mass: The robot's mass [kg].
        dimension: 2 for a robot in the wall plane, 3 for one in space, `Robot.dimension`.
        section: In space, what stands for the circle across friction cones.
        gap: In space, how closely to enclose the polygons [m].
    """
    forces = wall_forces(wall, dimension, section)
    return support_regions(wall.positions[sets], forces[sets], mass * wall.gravity, gap)


def contact_regions(
    wall: Wall,
    contacts: Sequence[Sequence[Contact]],
    mass: float,
    dimension: int = 2,
    section: Section = EXACT,
    gap: float = GAP,
) -> SupportRegions:
    """`hold_set_regions` of feet at definite points of their patches: M sets of k contacts each."""
    holds = np.array([[c.hold for c in feet] for feet in contacts], dtype=int).reshape(len(contacts), -1)
    points = np.array([wall.points(feet) for feet in contacts]).reshape(*holds.shape, 3)
    return support_regions(points, wall_forces(wall, dimension, section)[holds], mass * wall.gravity, gap)


def hold_sets_carried(
    wall: Wall, sets: NDArray[np.integer], mass: float, dimension: int = 2, section: Section = EXACT
) -> Mask:
    """Whether any centre of mass at all can be held over sets of holds, shape (M, k); shape (M,)."""
    forces, pull = wall_forces(wall, dimension, section), mass * wall.gravity
    if dimension == 2:
        intervals = support_intervals(wall.positions[sets], forces[sets], weight_in_plane(wall, mass))
        return np.asarray(~np.isnan(intervals[:, 0]))
    carried = np.zeros(len(sets), dtype=bool)
    for first in range(0, len(sets) if sets.size else 0, CHUNK):
        holds = sets[first : first + CHUNK]
        _, most, _, _ = Wrenches.of(wall.positions[holds], forces[holds], pull).capacity(decided=True)
        carried[first : first + CHUNK] = most >= 1.0 - BALANCE
    return carried


def hold_sets_hold(
    wall: Wall, sets: NDArray[np.integer], mass: float, centers: Vector, dimension: int = 2, section: Section = EXACT
) -> Mask:
    """Whether a robot on each set of holds, shape (M, k), is held with its centre of mass in a place of W, (M, 3)."""
    forces, pull = wall_forces(wall, dimension, section), mass * wall.gravity
    if dimension == 2:
        ends = support_intervals(wall.positions[sets], forces[sets], weight_in_plane(wall, mass))
        return np.asarray((ends[:, 0] <= centers[:, 0]) & (centers[:, 0] <= ends[:, 1]))
    held = np.zeros(len(sets), dtype=bool)
    for first in range(0, len(sets) if sets.size else 0, CHUNK):
        rows = slice(first, first + CHUNK)
        wrenches = Wrenches.of(wall.positions[sets[rows]], forces[sets[rows]], pull)
        _, most, _, _ = wrenches.with_center(across(pull) @ centers[rows].T).capacity(decided=True)
        held[rows] = most >= 1.0 - BALANCE
    return held


def hold_set_supports(
    wall: Wall,
    sets: NDArray[np.integer],
    mass: float,
    directions: Vector,
    dimension: int = 2,
    section: Section = EXACT,
    gap: float = GAP,
) -> tuple[Vector, Vector]:
    """How far the centre of mass may be in fixed directions over sets of holds: the quick way round a polygon.

    Args:
        wall: The wall.
        sets: Hold numbers, shape (M, k).
        mass: The robot's mass [kg].
        directions: In W; what counts is their part across gravity, shape (D, 3).
        dimension: 2 for a robot in the wall plane, 3 for one in space.
        section: In space, what stands for the circle across friction cones.
        gap: In space, how near the two answers should be [m].

    Returns:
        directions . p of places p that can be held, and what it is at most for all that can, shapes (M, D); NaN where
        nothing can.
    """
    M, D = len(sets), len(directions)
    forces = wall_forces(wall, dimension, section)
    if dimension == 2:
        ends = support_intervals(wall.positions[sets], forces[sets], weight_in_plane(wall, mass))
        reach = np.where(directions[:, 0] > 0.0, ends[:, 1:], ends[:, :1]) * directions[:, 0]
        return reach, reach
    pull = mass * wall.gravity
    most, bound = np.full((M, D), np.nan), np.full((M, D), np.nan)
    flat = directions @ across(pull).T
    for first in range(0, M if sets.size else 0, CHUNK):
        holds = sets[first : first + CHUNK]
        wrenches, start, good, _ = _held(Wrenches.of(wall.positions[holds], forces[holds], pull))
        some = np.repeat(np.flatnonzero(good), D)
        asked = np.tile(flat, (int(good.sum()), 1))
        point, reach = wrenches.reach(some, asked, start[..., some], gap)
        most[first + np.flatnonzero(good)] = (point * asked).sum(axis=1).reshape(-1, D)
        bound[first + np.flatnonzero(good)] = reach.reshape(-1, D)
    return most, bound


def support_regions(points: Vector, forces: ContactForces, pull: Vector, gap: float = GAP) -> SupportRegions:
    """Where the centre of mass may be over each of M sets of contacts.

    Args:
        points: Contact points in W [m], shape (M, k, 3).
        forces: Forces of the contacts, leading shape (M, k); in the plane or in space as `wall_forces` has them.
        pull: The robot's weight in W [N], shape (3,). In the plane, what of it is in the plane is along -y.
        gap: In space, how closely to enclose the polygons [m].
    """
    if forces.round is None:
        ends = support_intervals(points, forces, float(np.hypot(*pull[:2])))
        return as_intervals(ends, ends, np.full(len(ends), np.nan))
    if not np.linalg.norm(pull) > 0.0:
        raise ValueError("without weight a robot in space has its centre of mass anywhere")
    M = len(points)
    direction, turning, shortfall = np.full((M, 3), np.nan), np.full(M, np.nan), np.full(M, np.nan)
    if not points.size:
        lines = outline(np.zeros(0, dtype=np.int64), M, lambda _, direction: (direction, direction[:, 0]), gap)
        direction[:], turning[:], shortfall[:] = -pull / np.linalg.norm(pull), 0.0, np.linalg.norm(pull)
        return as_polygons(lines, pull, direction, turning, shortfall)
    parts = []
    for first in range(0, M, CHUNK):
        rows = slice(first, first + CHUNK)
        wrenches = Wrenches.of(points[rows], forces[rows], pull)
        part, fails = _outlines(wrenches, gap)
        parts.append((first, part))
        empty = first + np.flatnonzero(np.isnan(part.gap))
        direction[empty], turning[empty], shortfall[empty] = (x[empty - first] for x in fails)
    lines = Outlines(
        np.concatenate([first + part.figure for first, part in parts]),
        *(
            np.concatenate([getattr(part, name) for _, part in parts])
            for name in ("direction", "point", "bound", "gap")
        ),
    )
    return as_polygons(lines, pull, direction, turning, shortfall)


def _held(wrenches: Wrenches) -> tuple[Wrenches, Vector, Mask, Vector]:
    """Sets with an inside to work in, a point of it, which sets carry the load, and a proof for those that do not."""
    can, most, start, y = wrenches.capacity()
    good = most >= 1.0 - BALANCE
    tight = good & (can < 1.0 + WIDER)
    if not tight.any():
        return wrenches, start, good, y
    # These can only just carry the load. Their limits are widened by less than anyone can tell.
    wider = wrenches.widened(np.where(tight, 3.0 * WIDER, 0.0))
    return wider, np.where(tight, wider.capacity()[2], start), good, y


def _outlines(wrenches: Wrenches, gap: float) -> tuple[Outlines, tuple[Vector, Vector, Vector]]:
    """The polygons of some sets, and what proves that those without one have none."""
    at_hand, start, good, y = _held(wrenches)

    def ask(sets: Indices, direction: Vector) -> tuple[Vector, Vector]:
        return at_hand.reach(sets, direction, start[..., sets], max(FINE * gap**2 / ROUGHLY, FINEST))

    return outline(np.flatnonzero(good), len(wrenches), ask, gap), wrenches.shortfall(y)


def as_polygons(lines: Outlines, pull: Vector, direction: Vector, turning: Vector, shortfall: Vector) -> SupportRegions:
    """Outlines as halfspaces in W.

    Args:
        lines: Outlines along the two vectors of `across`.
        pull: The weight in W [N], shape (3,).
        direction: See `SupportRegions`.
        turning: See `SupportRegions`.
        shortfall: See `SupportRegions`.
    """
    M, basis = len(lines.gap), across(pull)
    normals, sides, corners = hulls(lines, M)
    count = np.bincount(lines.figure, minlength=M)
    most = max(1, int(count.max(initial=0)))
    first = np.cumsum(count) - count
    places = first[:, None] + np.minimum(np.arange(most), np.maximum(count, 1)[:, None] - 1)
    outer, bound = np.full((M, most, 2), np.nan), np.full((M, most), np.nan)
    some = count > 0
    outer[some], bound[some] = lines.direction[places[some]], lines.bound[places[some]]
    return SupportRegions(
        basis, normals @ basis, sides, corners, outer @ basis, bound, lines.gap, direction, turning, shortfall
    )


def as_intervals(inner: Vector, outer: Vector, shortfall: Vector) -> SupportRegions:
    """The regions of a robot in the wall plane, from intervals inside and outside of them [m], shape (M, 2) each."""
    M = len(inner)
    x = np.array([1.0, 0.0, 0.0])
    A = np.broadcast_to(np.stack([-x, x]), (M, 2, 3))
    sides = np.array([-1.0, 1.0])
    apart = (np.subtract(outer, inner, out=np.zeros_like(inner), where=np.isfinite(inner)) * sides).max(axis=1)
    gap = np.where(np.isnan(inner[:, 0]), np.nan, apart)
    direction, turning = np.full((M, 3), np.nan), np.full(M, np.nan)
    return SupportRegions(
        x[None], A, inner * sides, inner[..., None], A, outer * sides, gap, direction, turning, shortfall
    )
