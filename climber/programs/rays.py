"""Rays from the origin in one, two and three dimensions, and the ball inside the polytope of points on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from climber.robot import Indices
from climber.stance import Vector

IN_THE_PLANE = 32
LOOKED_AT = 8  # simplices in space that are measured at a time, those whose planes are nearest


@dataclass(frozen=True)
class Rays:
    """M rays, and the simplices between neighbours.

    Attributes:
        directions: Unit vectors, shape (M, D).
        faces: The rays at the corners of each simplex, shape (F, D).
        chords: Lists of rays m and of two others a and b amid which each lies, shape (3, T) each.
    """

    directions: Vector
    faces: Indices
    chords: tuple[Indices, ...]

    def inscribed(self, rho: Vector) -> tuple[Vector, Indices, Vector]:
        """The ball about the origin inside the polytopes with corners rho_m u_m.

        Args:
            rho: Distances along the rays, shape (K, M).

        Returns:
            Its radius, shape (K,); the face nearest to the origin, shape (K,); and distances along the rays, shape
            (K, M), greater where a chord between two other points passes farther out.
        """
        rho = self._raised(rho)
        distance = self._distances(rho[:, self.faces])
        nearest = distance.argmin(axis=1)
        return distance[np.arange(len(rho)), nearest], nearest, rho

    def _raised(self, rho: Vector) -> Vector:
        rho = rho.copy()
        with np.errstate(divide="ignore"):
            for m, a, b in self.chords:
                # In the middle the chord from point to point is as far out as the harmonic mean, times the cosine.
                turn = np.sqrt(0.5 + 0.5 * (self.directions[a] * self.directions[b]).sum(axis=1))
                rho[:, m] = np.maximum(rho[:, m], 2.0 * turn / (1.0 / rho[:, a] + 1.0 / rho[:, b]))
        return rho

    def _distances(self, rho: Vector) -> Vector:
        """Distances of simplices from the origin, or less, (K, F), for corners at `rho`, (K, F, D)."""
        if self.directions.shape[1] == 1:
            return rho[:, :, 0]
        if self.directions.shape[1] == 2:
            first, second = (rho[:, :, i, None] * self.directions[self.faces[:, i]] for i in (0, 1))
            return _segment(first, second)
        # The plane through points rho_i u_i is {x : y . x = 1} with y . u_i = 1 / rho_i; no simplex is nearer than it.
        with np.errstate(divide="ignore", invalid="ignore"):
            y = np.einsum("fxi,kfi->kfx", self._inverse, 1.0 / rho)
            length = np.linalg.norm(y, axis=2)
            # Its point nearest to the origin is y / y^2: a sum of the u_i with these factors, times y^2.
            inside = (np.einsum("fxi,kfx->kfi", self._inverse, y) >= 0.0).all(axis=2)
        point = ~np.isfinite(length)  # a corner at the origin
        result, measured = np.where(point, 0.0, 1.0 / np.maximum(length, 1e-300)), inside | point
        while True:  # until the nearest of all is itself measured, not only its plane
            unsure = np.flatnonzero(~measured[np.arange(len(rho)), result.argmin(axis=1)])
            if not len(unsure):
                return np.asarray(result)
            low = np.argpartition(np.where(measured[unsure], np.inf, result[unsure]), LOOKED_AT, axis=1)[:, :LOOKED_AT]
            place = unsure[:, None]
            border = _border(rho[place, low][..., None] * self.directions[self.faces[low]])
            result[place, low] = np.where(measured[place, low], result[place, low], border)
            measured[place, low] = True

    @cached_property
    def _inverse(self) -> Vector:
        return np.asarray(np.linalg.inv(self.directions[self.faces]))


def _border(corners: Vector) -> Vector:
    """Distance of the sides of triangles from the origin, shape (...), for corners of shape (..., 3, 3)."""
    a, b, c = (corners[..., i, :] for i in range(3))
    result: Vector = np.minimum.reduce([_segment(a, b), _segment(b, c), _segment(c, a)])
    return result


def _segment(a: Vector, b: Vector) -> Vector:
    """Distance of segments from the origin, shape (...)."""
    along = b - a
    share = -(a * along).sum(axis=-1) / np.maximum((along**2).sum(axis=-1), 1e-300)
    result: Vector = np.linalg.norm(a + np.clip(share, 0.0, 1.0)[..., None] * along, axis=-1)
    return result


@cache
def rays(dimension: int) -> Rays:
    """Rays all around in so many dimensions."""
    return {1: _line, 2: _circle, 3: _sphere}[dimension]()


def _line() -> Rays:
    return Rays(np.array([[1.0], [-1.0]]), np.array([[0], [1]]), ())


def _circle() -> Rays:
    M = IN_THE_PLANE
    every = np.arange(M)
    angle = 2.0 * np.pi * every / M
    chords = [np.array([every, (every - step) % M, (every + step) % M]) for step in (M // 8, M // 16, M // 32)]
    faces = np.stack([every, (every + 1) % M], axis=1)
    return Rays(np.stack([np.cos(angle), np.sin(angle)], axis=1), faces, tuple(chords))


def _sphere() -> Rays:
    """An octahedron whose faces are quartered twice; a ball inside it is 6 % smaller than the one about it."""
    points = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    faces = [(i, j, k) for i in (0, 1) for j in (2, 3) for k in (4, 5)]
    levels = []
    for _ in range(2):
        middles: dict[frozenset[int], int] = {}
        chords: list[tuple[int, int, int]] = []
        finer = []
        for corners in faces:
            halves = []
            for a, b in ((corners[0], corners[1]), (corners[1], corners[2]), (corners[2], corners[0])):
                if frozenset((a, b)) not in middles:
                    middles[frozenset((a, b))] = len(points)
                    chords.append((len(points), a, b))
                    points.append((points[a] + points[b]) / np.linalg.norm(points[a] + points[b]))
                halves.append(middles[frozenset((a, b))])
            ab, bc, ca = halves
            finer += [(corners[0], ab, ca), (corners[1], bc, ab), (corners[2], ca, bc), (ab, bc, ca)]
        faces = finer
        levels.append(np.array(chords).T)
    return Rays(np.array(points), np.array(faces), tuple(levels))
