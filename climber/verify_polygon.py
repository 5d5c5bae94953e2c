"""Where the centre of mass of a robot in space may be: cvxpy's programs, asked again wherever that matters."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from climber.stance import Vector
from climber.verify_grips import ConeGrip, Grip, PinGrip

ACCURACIES = (1e-11, 1e-9)  # asked of the solver, the second where it does not get to the first
FIRST = 12  # directions asked to begin with
OUTSIDE = 1e-4  # [m] places outside by more than this, whatever the answers, need not be told exactly
EXACT = 1e-7  # [m] others that are not known to be inside are, to this
MOST = 1000  # directions asked for that
BESIDE = (0.0, 1e-3, -1e-3, 1e-2, -1e-2)  # [rad]
SAME = 1e-8  # [m] corners closer than this count as one
ROUNDING = 1e-9  # [m]


class _Reach:
    """How far the centre of mass can be in a direction across gravity, over r friction contacts and l pins.

    Variables: normal forces a (r,) and tangential ones in parts of friction, B (2, r); forces of pins F (3, l); the
    centre of mass c (2,) across gravity from the contacts' centroid [m]. Forces are in weights.

        maximise     direction . c
        subject to   sum of forces    = -weight                                  (3 rows)
                     sum of moments + c x weight = 0                             (3 rows)
                     |B_i| <= a_i - lower_i,  |B_i| <= upper_i - a_i             two cones, apex to apex
                     |F| <= most
    """

    def __init__(self, cones: int, pins: int) -> None:
        import cvxpy  # takes half a second, which planning need not wait for

        self.a, self.B = cvxpy.Variable(max(cones, 1)), cvxpy.Variable((2, max(cones, 1)))
        self.F, self.c = cvxpy.Variable(3 * max(pins, 1)), cvxpy.Variable(2)
        self.lower, self.upper = cvxpy.Parameter(max(cones, 1)), cvxpy.Parameter(max(cones, 1))
        self.most = cvxpy.Parameter(3 * max(pins, 1))
        self.along = cvxpy.Parameter((6, max(cones, 1)))
        self.aside = [cvxpy.Parameter((6, max(cones, 1))) for _ in range(2)]
        self.pins = cvxpy.Parameter((6, 3 * max(pins, 1)))
        self.lever, self.load = cvxpy.Parameter((6, 2)), cvxpy.Parameter(6)
        self.direction = cvxpy.Parameter(2)
        wrench = self.along @ self.a + self.aside[0] @ self.B[0] + self.aside[1] @ self.B[1] + self.pins @ self.F
        constraints = [
            wrench + self.lever @ self.c == self.load,
            cvxpy.SOC(self.a - self.lower, self.B),
            cvxpy.SOC(self.upper - self.a, self.B),
            self.F <= self.most,
            -self.F <= self.most,
        ]
        self.problem = cvxpy.Problem(cvxpy.Maximize(self.direction @ self.c), constraints)


@lru_cache
def _reach(cones: int, pins: int) -> _Reach:
    return _Reach(cones, pins)


@dataclass
class Polygon:
    """The polygon across gravity over some contacts, as far as it has been asked about.

    Attributes:
        grips: What each contact can exert, k of them.
        points: Where they are in W [m], shape (k, 3).
        weight: The weight in W [N], shape (3,).
        basis: Two unit vectors across gravity, shape (2, 3).
        status: What the solver said of the first direction; "optimal" if there is a polygon.
        directions: Those asked, in the basis.
        found: The farthest places in them, along the basis [m].
    """

    grips: Sequence[Grip]
    points: Vector
    weight: Vector
    basis: Vector = field(init=False)
    status: str = field(init=False, default="no contacts")
    directions: list[Vector] = field(init=False, default_factory=list)
    found: list[Vector] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        x = np.array([1.0, 0.0, 0.0]) if abs(self.weight[0]) < 0.9 * np.linalg.norm(self.weight) else np.eye(3)[1]
        down = self.weight / np.linalg.norm(self.weight)
        first = x - (x @ down) * down
        first /= np.linalg.norm(first)
        self.basis = np.stack([first, np.cross(down, first)])
        for angle in np.arange(FIRST if self.grips else 0) * 2 * np.pi / FIRST:
            if not self._ask(np.array([np.cos(angle), np.sin(angle)])):
                break

    @property
    def exists(self) -> bool:
        """Whether there is a polygon at all."""
        return self.status == "optimal"

    def _ask(self, direction: Vector) -> bool:
        """Asks in a direction; whether there was an answer."""
        import cvxpy

        size = float(np.linalg.norm(self.weight))
        cones = [(g, p) for g, p in zip(self.grips, self.points, strict=True) if isinstance(g, ConeGrip)]
        pins = [(g, p) for g, p in zip(self.grips, self.points, strict=True) if isinstance(g, PinGrip)]
        program, centroid = _reach(len(cones), len(pins)), self.points.mean(axis=0)
        along, aside = np.zeros((6, max(len(cones), 1))), np.zeros((2, 6, max(len(cones), 1)))
        lower, upper = np.full(max(len(cones), 1), -1.0), np.full(max(len(cones), 1), 1.0)
        load = np.append(-self.weight / size, np.zeros(3))
        for i, (grip, point) in enumerate(cones):
            tangents = np.linalg.svd(grip.normal[None])[2][1:] * grip.friction
            along[:, i] = _wrench(grip.normal, point - centroid)
            aside[:, :, i] = [_wrench(tangent, point - centroid) for tangent in tangents]
            lower[i], upper[i] = grip.lower / size, grip.upper / size
            load += grip.adhesion / size * along[:, i]
        at_pins, most = np.zeros((6, 3 * max(len(pins), 1))), np.ones(3 * max(len(pins), 1))
        for i, (pin, point) in enumerate(pins):
            at_pins[:, 3 * i : 3 * i + 3] = np.column_stack([_wrench(e, point - centroid) for e in np.eye(3)])
            most[3 * i : 3 * i + 3] = pin.most / size
        program.along.value, program.lower.value, program.upper.value = along, lower, upper
        program.aside[0].value, program.aside[1].value = aside
        program.pins.value, program.most.value = at_pins, most
        program.lever.value = np.vstack([np.zeros((3, 2)), np.cross(self.basis, self.weight / size).T])
        program.load.value, program.direction.value = load, direction
        for accuracy in ACCURACIES:
            tolerances = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), accuracy)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)  # an inaccurate solution is not taken
                    program.problem.solve(solver=cvxpy.CLARABEL, **tolerances)
                self.status = str(program.problem.status)
            except cvxpy.SolverError as error:
                self.status = str(error)
            if self.status in (cvxpy.OPTIMAL, cvxpy.INFEASIBLE):
                break
        if self.exists:
            self.directions.append(direction)
            self.found.append(self.basis @ centroid + program.c.value)
        return self.exists

    def margin(self, center: Vector) -> Vector:
        """How far places of the centre of mass, shape (K, 3), are inside [m], shape (K,); negative outside.

        A positive margin may be more than that. A negative one is right to `EXACT`, and one of less than -`OUTSIDE` may
        be more than that, but not more than -`OUTSIDE`. NaN if there is no polygon.
        """
        places = center @ self.basis.T
        if not self.exists:
            return np.full(len(center), np.nan)
        for _ in range(MOST):
            least, normal = self._inside(places)
            most = self._outside(places)
            doubtful = np.flatnonzero((least < 0.0) & (most > -OUTSIDE) & (most - least > EXACT))
            if not len(doubtful):
                break
            worst = int(doubtful[np.argmax((most - least)[doubtful])])
            x, y = normal[worst]
            # The solver has its weak spots; beside one it will do.
            if not any(self._ask(np.array([x - turn * y, y + turn * x]) / np.hypot(1.0, turn)) for turn in BESIDE):
                break
        self.status = "optimal"
        return least

    def _outside(self, places: Vector) -> Vector:
        """What the margins are at most, shape (K,)."""
        directions, found = np.array(self.directions), np.array(self.found)
        reach = (directions * found).sum(axis=1)
        return np.asarray((reach - places @ directions.T).min(axis=1))

    def _inside(self, places: Vector) -> tuple[Vector, Vector]:
        """What the margins are at least, shape (K,), and where to ask to know more, unit vectors of shape (K, 2)."""
        ring = _hull(np.array(self.found))
        start, along = ring, np.roll(ring, -1, axis=0) - ring
        length = np.maximum(np.linalg.norm(along, axis=1), 1e-100)
        normals = np.column_stack([along[:, 1], -along[:, 0]]) / length[:, None]
        away = places[:, None] - start
        share = np.clip((away * along).sum(axis=2) / length**2, 0.0, 1.0)
        offset = away - share[..., None] * along
        distance = np.linalg.norm(offset, axis=2)
        nearest = distance.argmin(axis=1)
        rows = np.arange(len(places))
        least = distance[rows, nearest]
        flat = len(ring) < 3
        beyond = np.asarray(((away * normals).sum(axis=2).max(axis=1) > ROUNDING) | flat)
        outward = offset[rows, nearest] / np.maximum(least, 1e-300)[:, None]
        ask = np.where((beyond & (least > ROUNDING))[:, None], outward, normals[nearest])
        ask[np.linalg.norm(ask, axis=1) < 0.5] = [1.0, 0.0]  # the polygon is a point
        return np.where(beyond, -least, least), ask

    def describe(self) -> str:
        """What it looks like, in words."""
        if not self.exists:
            return f"empty ({self.status})"
        ring = np.array(self.found)
        (left, low), (right, high) = ring.min(axis=0), ring.max(axis=0)
        return f"polygon in [{left:.4f}, {right:.4f}] x [{low:.4f}, {high:.4f}] m"


def _wrench(force: Vector, arm: Vector) -> Vector:
    """A force and its moment, shape (6,)."""
    return np.concatenate([force, np.cross(arm, force)])


def _hull(points: Vector) -> Vector:
    """The corners of the points' convex hull, counter-clockwise; one or two if they are in a line (monotone chain)."""
    ordered = sorted(set(map(tuple, points.tolist())))
    if len(ordered) < 3:
        return np.array(ordered)

    def chain(some: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
        kept: list[tuple[float, ...]] = []
        for x, y in some:
            while len(kept) > 1:
                (ax, ay), (bx, by) = kept[-2], kept[-1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                    break
                kept.pop()
            kept.append((x, y))
        return kept[:-1]

    ring = np.array(chain(ordered) + chain(ordered[::-1]))
    apart = np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1) > SAME
    ring = ring[apart] if apart.any() else ring[:1]
    x, y = ring.T
    twice_area = abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()))
    distance = np.linalg.norm(ring[:, None] - ring, axis=2)
    if twice_area < SAME * distance.max():  # as good as a segment
        return ring[list(np.unravel_index(distance.argmax(), distance.shape))]
    return ring
