"""The support interval of many sets of contacts at once, exactly, without a solver in the loop.

Equal to `climber.programs.equilibrium.SupportProgram` on each set; use that one for a single set and to read the model.

With s_j the amount of generator j above its lower limit, w_j its range and b the load left for the generators, the
greatest torque is a linear program with two equality rows, and its dual has two variables:

    max sum_j c_j s_j   s.t.  sum_j g_j s_j = b,  0 <= s_j <= w_j
        = min over y in R^2 of  y . b + sum_j w_j max(0, c_j - y . g_j).

(Reading y as a point turned by 90 degrees, c_j - y . g_j is the torque of generator j about that point.) The dual
objective is convex and piecewise linear with creases along the lines c_j = y . g_j, so its minimum, if there is one,
is at a crossing of two of them: try them all. There is a minimum exactly if b lies in the zonogon of the generators,
and a zonogon is the intersection of one strip per generator, parallel to that generator. The least torque is the same
with max over y and min(0, .). With a = sum_j w_j |c_j - y . g_j| both ends come from one sweep, since
max(0, v) = (v + |v|) / 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from climber.programs.forces import ContactForces, wall_forces, weight_in_plane
from climber.stance import Contact, Vector
from climber.wall import Wall

PARALLEL = 1e-9  # [rad] directions closer than this count as parallel; their lines cross too far away to matter
BALANCE = 1e-9  # a load this fraction outside the zonogon counts as on its border
CHUNK_WORK = 8192  # sets times crossings handled in one sweep, so that the sweep stays in the cache


def support_intervals(points: Vector, forces: ContactForces, weight: float) -> Vector:
    """Where the centre of mass may be over each of many sets of contacts.

    Args:
        points: Contact points in W [m], shape (M, k, 3).
        forces: Forces of the contacts, leading shape (M, k); generators in the plane.
        weight: The robot's weight along the wall, towards -y [N].

    Returns:
        Least and greatest abscissa of the centre of mass in W [m], shape (M, 2); NaN where no forces carry the weight,
        infinite where there is none to carry.
    """
    M, k, p = forces.lower.shape
    return _in_chunks(M, k * p, lambda rows: _sweep(points[rows], forces[rows], weight))


def hold_set_intervals(wall: Wall, sets: NDArray[np.integer], mass: float) -> Vector:
    """`support_intervals` of sets of holds stood on at the centres of their patches.

    Args:
        wall: The wall.
        sets: Hold numbers, shape (M, k).
        mass: The robot's mass [kg].

    Returns:
        Intervals of the centre of mass's abscissa in W [m], shape (M, 2), NaN where empty.
    """
    weight, forces, positions = weight_in_plane(wall, mass), wall_forces(wall), wall.positions

    def sweep(rows: slice) -> Vector:
        holds = sets[rows]
        return _sweep(positions[holds], forces[holds], weight)

    return _in_chunks(len(sets), sets.shape[1] * forces.lower.shape[1], sweep)


def contact_intervals(wall: Wall, contacts: Sequence[Sequence[Contact]], mass: float) -> Vector:
    """`support_intervals` of feet at definite points of their patches.

    Args:
        wall: The wall.
        contacts: M sets of k contacts each.
        mass: The robot's mass [kg].

    Returns:
        Intervals of the centre of mass's abscissa in W [m], shape (M, 2), NaN where empty.
    """
    holds = np.array([[c.hold for c in feet] for feet in contacts], dtype=int).reshape(len(contacts), -1)
    points = np.array([wall.points(feet) for feet in contacts]).reshape(*holds.shape, 3)
    return support_intervals(points, wall_forces(wall)[holds], weight_in_plane(wall, mass))


def _in_chunks(num_sets: int, num_generators: int, sweep: Callable[[slice], Vector]) -> Vector:
    """`sweep` over all sets, a cacheful at a time, shape (num_sets, 2)."""
    intervals = np.full((num_sets, 2), np.nan)
    if num_generators == 0:
        return intervals  # nothing to hold on to
    size = max(1, CHUNK_WORK // max(1, num_generators * (num_generators - 1) // 2))
    for first in range(0, num_sets, size):
        rows = slice(first, first + size)
        intervals[rows] = sweep(rows)
    return intervals


def _sweep(points: Vector, forces: ContactForces, weight: float) -> Vector:
    """`support_intervals` of a chunk of B sets. Inside, the sets are the last axis and m = k p generators the first."""
    B = len(points)
    arms = points - points.mean(axis=1, keepdims=True)  # (B, k, 3)
    base = forces.offset + np.einsum("bkdp,bkp->bkd", forces.generators, forces.lower)  # forces at the lower limits
    base_torque = (arms[..., 0] * base[..., 1] - arms[..., 1] * base[..., 0]).sum(axis=1)  # (B,)
    scaled = forces.generators * (forces.upper - forces.lower)[..., None, :]  # s_j then runs from 0 to 1
    torque = arms[..., 0, None] * scaled[..., 1, :] - arms[..., 1, None] * scaled[..., 0, :]  # (B, k, p)
    if forces.moments is not None:
        base_torque = base_torque + (forces.moments * forces.lower).sum(axis=(1, 2))
        torque = torque + forces.moments * (forces.upper - forces.lower)
    gx, gy, c = (np.ascontiguousarray(a.reshape(B, -1).T) for a in (scaled[..., 0, :], scaled[..., 1, :], torque))

    # Twice the load, measured from the middle of the zonogon.
    load_x = -2.0 * base[..., 0].sum(axis=1) - gx.sum(axis=0)
    load_y = 2.0 * (weight - base[..., 1].sum(axis=1)) - gy.sum(axis=0)
    length = np.hypot(gx, gy)
    slack = BALANCE * (length.sum(axis=0) + np.abs(load_x) + np.abs(load_y))

    i, j = _pairs(len(gx))
    det = gx[i] * gy[j] - gy[i] * gx[j]  # (pairs, B)
    parallel = np.abs(det) <= PARALLEL * length[i] * length[j]
    det[parallel] = 0.0
    half_width = _incidence(len(gx)) @ np.abs(det)  # of generator j's strip, times |g_j|, shape (m, B)
    carried = (np.abs(gx * load_y - gy * load_x) <= half_width + slack * length).all(axis=0)
    # Parallel lines do not cross; y = 0 serves in their place, for every y bounds the answer from the right side.
    det[parallel] = np.inf
    y0, y1 = (c[i] * gy[j] - c[j] * gy[i]) / det, (gx[i] * c[j] - gx[j] * c[i]) / det
    low, high = _best(y0, y1, gx, gy, c, load_x, load_y)

    flat = parallel.all(axis=0)
    if flat.any():
        low[flat], high[flat], carried[flat] = _flat_sweep(
            *(a[:, flat] for a in (gx, gy, c, length)), *(a[flat] for a in (load_x, load_y, slack))
        )
    middle = 0.5 * (low + high)
    low, high = np.minimum(low, middle), np.maximum(high, middle)  # they may pass each other by rounding on a border
    moments = base_torque + 0.5 * (c.sum(axis=0) + np.stack([low, high]))
    if weight == 0.0:  # then moments must cancel, wherever the centre of mass is
        carried &= (moments[0] <= BALANCE) & (moments[1] >= -BALANCE)
        ends = np.array([[-np.inf], [np.inf]])
    else:
        ends = points[..., 0].mean(axis=1) + moments / weight
    result: Vector = np.where(carried, ends, np.nan).T
    return result


def _best(
    y0: Vector, y1: Vector, gx: Vector, gy: Vector, c: Vector, load_x: Vector, load_y: Vector
) -> tuple[Vector, Vector]:
    """Twice the least and the greatest torque over the candidates (y0, y1), without the constant, each shape (B,)."""
    a, v, term = np.zeros_like(y0), np.empty_like(y0), np.empty_like(y0)
    for gx_j, gy_j, c_j in zip(gx, gy, c, strict=True):
        np.multiply(y0, gx_j, out=v)
        np.multiply(y1, gy_j, out=term)
        v += term
        np.subtract(c_j, v, out=v)
        a += np.abs(v, out=v)
    along = y0 * load_x + y1 * load_y
    return (along - a).max(axis=0), (along + a).min(axis=0)


def _flat_sweep(
    gx: Vector, gy: Vector, c: Vector, length: Vector, load_x: Vector, load_y: Vector, slack: Vector
) -> tuple[Vector, Vector, NDArray[np.bool_]]:
    """Sets whose generators are all parallel: the zonogon is a segment, the dual has one variable along it."""
    longest = length.argmax(axis=0), np.arange(length.shape[1])
    size = length[longest]
    ux = np.divide(gx[longest], size, out=np.ones_like(size), where=size > 0)  # no force at all leaves any direction
    uy = np.divide(gy[longest], size, out=np.zeros_like(size), where=size > 0)
    carried = (np.abs(ux * load_y - uy * load_x) <= slack) & (
        np.abs(ux * load_x + uy * load_y) <= np.abs(ux * gx + uy * gy).sum(axis=0) + slack
    )
    crease = np.divide(c, length**2, out=np.zeros_like(c), where=length > 0)
    low, high = _best(crease * gx, crease * gy, gx, gy, c, load_x, load_y)
    return low, high, carried


@cache
def _pairs(m: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """All pairs i < j below m."""
    pairs = np.array(list(combinations(range(m), 2)), dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


@cache
def _incidence(m: int) -> Vector:
    """1 where a generator is in a pair, shape (m, pairs)."""
    i, j = _pairs(m)
    rows = np.arange(m)[:, None]
    members: Vector = ((rows == i) | (rows == j)).astype(float)
    return members
